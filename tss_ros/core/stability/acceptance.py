"""What a turn must be to count as a motion of the formation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tss_ros.core.model import forces
from tss_ros.core.model.axes import spin_axis_of
from tss_ros.core.model.equilibria import COLLAPSED, loose_beads
from tss_ros.core.model.frames import Z_AXIS, turn_to
from tss_ros.core.model.system import State, System
from tss_ros.core.motion.integrator import Integrator

#: Samples of a turn.
SAMPLES = 360
#: Beads nearer to the axis than this share of the farthest may circle it as they like.
NEAR_CENTRE = 0.1


@dataclass(frozen=True)
class Look:
    """A turn, as its samples show it.

    Attributes
    ----------
    pushing_share : float
        Share of the time that taut tethers push.
    never_taut : tuple of str
        Tethers that are slack in every sample.
    refusal : str
        Why the turn does not count as a motion of the formation; "" if it does.
    """

    pushing_share: float
    never_taut: tuple[str, ...]
    refusal: str


def look(integrator: Integrator, start: State, turns: int = 1) -> Look:
    """Look at the motion from a start over the integrator's period.

    It must turn once in the sense of the spin, keep its tethers near their lengths, and hold every
    bead by tethers that are taut at some time.

    Parameters
    ----------
    integrator : Integrator
    start : State
    turns : int
        That it must make instead, 0 if it hangs.

    Returns
    -------
    Look

    Raises
    ------
    IntegrationError
        If the motion cannot be continued.
    """
    system = integrator.system
    count = SAMPLES * max(turns, 1)
    times = integrator.period_s / count * np.arange(count + 1)
    samples, motion = integrator.samples(times), integrator.begin(start)
    integrator.advance(motion, integrator.period_s * (1.0 + 1e-9), samples=samples)
    length, tension, taut = integrator.tethers(samples)
    held = taut.any(axis=0)
    never_taut = tuple(name for name, ever in zip(system.tether_name, held) if not ever)
    loose = loose_beads(system, held)
    axis = spin_axis_of(system, start, integrator.spin)
    refusal = (
        _turned(system, samples.r[:, : system.n], integrator.spin or 1.0, axis, turns)
        or _collapsed(system, length)
        or (loose and f"no tether that is ever taut holds {loose}")
    )
    return Look(forces.pushing_share(tension[:-1], taut[:-1]), never_taut, refusal)


def _turned(system: System, r: np.ndarray, spin: float, axis: np.ndarray, wanted: int) -> str:
    """Why positions (k, n, 3) do not turn so often about an axis in the sense of the spin."""
    turns = turns_made(r - np.average(r, axis=1, weights=system.mass_kg)[:, None], spin, axis)
    for name, made in zip(system.bead_name, turns):
        if not np.isnan(made) and round(made) != wanted:
            return (
                f"it turns {name} {made:.2f} times about the centre of mass in the sense of the"
                f" spin, not {'once' if wanted == 1 else f'{wanted} times'}"
            )
    return ""


def turns_made(arm: np.ndarray, spin: float, axis: np.ndarray = Z_AXIS) -> np.ndarray:
    """Turns (n,) about an axis in the sense of the spin; NaN for beads that are near it.

    Parameters
    ----------
    arm : ndarray, shape (k, n, 3)
        [m] from the centre of mass, in the orbit frame, at least eight a turn.
    spin : float
        Of which the sign counts.
    axis : ndarray, shape (3,)
    """
    arm = arm @ turn_to(axis)
    distance = np.mean(np.hypot(arm[:, :, 0], arm[:, :, 1]), axis=0)
    angle = np.unwrap(np.arctan2(arm[:, :, 1], arm[:, :, 0]), axis=0)
    turns = (angle[-1] - angle[0]) / (2.0 * np.pi) * np.sign(spin)
    return np.where(distance > NEAR_CENTRE * np.max(distance), turns, np.nan)


def _collapsed(system: System, length: np.ndarray) -> str:
    """Why lengths (k, m) are not those of the formation."""
    share = np.min(length / system.rest_length_m, axis=0)
    worst = int(np.argmin(share))
    if share[worst] >= COLLAPSED:
        return ""
    return (
        f"its tether {system.tether_name[worst]} shrinks to {share[worst]:.3g} of its rest length"
    )
