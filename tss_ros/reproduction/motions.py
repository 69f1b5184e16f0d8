"""What becomes of single motions: verdicts, how far beads leave their places, who pushes.

The functions take motions read from a bag and motions simulated here alike.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from tss_ros.bags.recording import Recording
from tss_ros.core import (
    Propagator,
    System,
    compute_floquet,
    confirm,
    deviation,
    disturbed,
    initial_state,
    pushing_share,
    tether_state,
)
from tss_ros.reproduction.claims import (
    DISTURBANCE_M,
    LOST,
    SAMPLES_PER_TURN,
    SEED,
    PaperMotion,
    system,
)


@dataclass(frozen=True)
class Simulated:
    """A motion that is in no bag; attributes are those of the same names of `Recording`.

    Attributes
    ----------
    is_satellite : ndarray, shape (n,), bool
    rest_length_m : ndarray, shape (m,)
    turns : ndarray, shape (k,)
    position_m : ndarray, shape (k, n, 3)
    deviation_from_centre : ndarray, shape (k, n)
    length_m, tension_n : ndarray, shape (k, m)
    taut : ndarray, shape (k, m), bool
    """

    is_satellite: np.ndarray
    rest_length_m: np.ndarray
    turns: np.ndarray
    position_m: np.ndarray
    deviation_from_centre: np.ndarray
    length_m: np.ndarray
    tension_n: np.ndarray
    taut: np.ndarray


def simulate(of: System, motion: PaperMotion, cancelled: Callable[[], bool]) -> Simulated:
    """The motion that a bag of it would hold, with the system as given."""
    undisturbed = start = initial_state(of, motion.rate)
    if motion.disturbance_m:
        start = disturbed(undisturbed, motion.disturbance_m, SEED)
    turns = np.linspace(0, motion.turns, motion.turns * SAMPLES_PER_TURN + 1)
    turn_s = of.period_s(motion.rate)
    propagator = Propagator(of, motion.rate, start, rtol=1e-12)
    position_m, velocity_m_s = propagator.sample(turns * turn_s, cancelled)
    length_m, tension_n, taut = tether_state(of, position_m, velocity_m_s)
    centre_m = np.average(position_m, axis=1, weights=of.mass_kg)
    radius_m = np.linalg.norm(undisturbed.position_m, axis=1)
    return Simulated(
        is_satellite=of.is_satellite,
        rest_length_m=of.rest_length_m,
        turns=turns,
        position_m=position_m,
        deviation_from_centre=deviation(position_m - centre_m[:, None], radius_m),
        length_m=length_m,
        tension_n=tension_n,
        taut=taut,
    )


def outcome(
    of: System, motion: PaperMotion, seen: Recording | Simulated, cancelled: Callable[[], bool]
) -> dict[str, Any]:
    """Everything that the report says of a motion.

    Returns
    -------
    dict
        What `fate` says; "recorded" and "lost_after" of the motion seen: the largest change of a
        distance from the centre of mass and the turn when it first passes `LOST`, or None;
        "pushing_share": of the time that tethers are taut; "oscillation" where there are tether
        beads.
    """
    change = np.abs(seen.deviation_from_centre - seen.deviation_from_centre[0]).max(axis=1)
    lost = seen.turns[change > LOST]
    result = fate(of, motion, cancelled) | {
        "recorded": float(change.max()),
        "lost_after": float(lost[0]) if lost.size else None,
        "pushing_share": pushing_share(seen.tension_n, seen.taut),
    }
    if not of.is_satellite.all():
        result["oscillation"] = oscillation(seen)
    return result


def fate(of: System, motion: PaperMotion, cancelled: Callable[[], bool]) -> dict[str, Any]:
    """Verdict of both Floquet methods and of the disturbed simulation for one motion."""
    true = compute_floquet(of, motion.rate, cancelled=cancelled)
    frozen = compute_floquet(of, motion.rate, "frozen", cancelled=cancelled)
    seen = confirm(
        of,
        motion.rate,
        disturbance_m=motion.disturbance_m or DISTURBANCE_M,
        seed=SEED,
        turns=motion.turns,
        cancelled=cancelled,
    )
    return {
        "frozen": frozen.max_modulus,
        "frozen_verdict": frozen.verdict,
        "verdict": true.verdict,
        "nontrivial": true.max_modulus_nontrivial,
        "closure": true.closure_residual,
        "held": seen.held,
        "settle": seen.turns_to_settle,
        "from_centre": seen.deviation_from_centre,
        "from_origin": seen.deviation_from_origin,
    }


def fates_by_damping(
    motion: PaperMotion, dampings: Iterable[float], cancelled: Callable[[], bool]
) -> list[list]:
    """Whether the disturbed motion is held and settles, at each damping."""
    rows = []
    for damping in dampings:
        seen = confirm(
            system(motion.scenario, damping),
            motion.rate,
            disturbance_m=motion.disturbance_m,
            seed=SEED,
            turns=motion.turns,
            cancelled=cancelled,
        )
        rows.append([damping, seen.held, seen.turns_to_settle])
    return rows


def oscillation(seen: Recording | Simulated, from_turn: float = 2.0) -> dict[str, Any]:
    """What lengths and shape of a motion do after `from_turn`.

    The shape is the kink of each tether in its middle: the signed angle in the orbital plane
    between its halves, at the bead; 0 where the tether is straight.

    Returns
    -------
    dict
        "length_first", "length_last": largest |l / L - 1| of the first and the last turn;
        "settled_share": part of the last four turns in which every |l / L - 1| is below 1e-3;
        "kink_first_deg", "kink_last_deg": peak-to-peak kink in a turn after `from_turn` and in the
        last; "peaks": strongest spectral lines of the kink as [cycles per turn, amplitude in deg].
    """
    turns = seen.turns
    strain = np.abs(seen.length_m / seen.rest_length_m - 1.0).max(axis=1)
    position = seen.position_m
    beads = np.flatnonzero(~seen.is_satellite)
    n = position.shape[1]
    x, y, _ = np.moveaxis(position[:, beads] - position[:, (beads - 1) % n], 2, 0)
    x_next, y_next, _ = np.moveaxis(position[:, (beads + 1) % n] - position[:, beads], 2, 0)
    kink = np.degrees(np.arctan2(x * y_next - y * x_next, x * x_next + y * y_next))
    first = (turns >= from_turn) & (turns < from_turn + 1)
    last = turns >= turns[-1] - 1
    late = kink[turns >= from_turn]
    window = np.hanning(len(late))[:, None]
    spectrum = 2 * np.abs(np.fft.rfft((late - late.mean(axis=0)) * window, axis=0)) / window.sum()
    per_turn = np.fft.rfftfreq(len(late), turns[1] - turns[0])
    line = spectrum.max(axis=1)
    peaks = 1 + np.flatnonzero((line[1:-1] > line[:-2]) & (line[1:-1] > line[2:]))
    peaks = peaks[np.argsort(-line[peaks])][:3]
    return {
        "length_first": float(strain[turns < 1].max()),
        "length_last": float(strain[last].max()),
        "settled_share": float(np.mean(strain[turns >= turns[-1] - 4] < 1e-3)),
        "kink_first_deg": float(np.ptp(kink[first], axis=0).max()),
        "kink_last_deg": float(np.ptp(kink[last], axis=0).max()),
        "peaks": [[float(per_turn[i]), float(line[i])] for i in peaks],
    }
