"""What thrusters of the satellites do that spin alone does not: numbers for the page on feedback.

The paper ends on the need of a way to suppress vibrations other than the spin.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from tss_ros import core
from tss_ros.core import FloquetResult, State, System
from tss_ros.core.model.commands import FRAMES
from tss_ros.core.model.feedback import thrust
from tss_ros.core.model.frames import Z_AXIS, turn_about
from tss_ros.core.motion.integrator import Integrator
from tss_ros.scenarios import scenario

#: Parameters of the laws that are varied.
DAMPING, KEEPING = "rotation_damping_n_s_per_m", "shape_keeping_n_per_m"
REELS = "reel_damping_n_s_per_m"
#: The paper's six beads: rate over Omega, C of the tethers [N s/m], and the scenario of that ring
#: with another C; gains tried [N s/m], and the one that is watched.
RATE, TETHER_DAMPING, SHIPPED = -2.9, 100.0, "six_bead"
GAINS = (0.1, 0.2, 0.5, 1.0, 2.0, 3.0, 5.0, 7.0, 10.0, 15.0, 20.0, 25.0, 30.0, 50.0, 100.0, 200.0)
WATCHED = 20.0
#: Push [m], turns that are watched, samples of each, and the share of its first swing at which a
#: motion counts as settled.
PUSH_M, TURNS, SAMPLES, SETTLED = 10.0, 200, 40, 0.1
#: Damping of tethers that is tried instead [N s/m], and changes of all masses.
TETHERS, MASSES = (1e2, 1e3, 1e4, 1e5), (0.8, 0.9, 1.0, 1.1, 1.2)
#: Rings whose reels follow tension: satellites and rate; damping of the reels [N s/m].
REELED = ((3, -2.9), (5, -4.5))
REEL_DAMPINGS = (1e2, 2e2, 5e2, 1e3, 2e3, 5e3, 1e4, 2e4, 5e4, 1e5)
#: Motions of the first of these rings: dampings of the reels, 0 for fixed ones, pushes [m], turns.
REELS_WATCHED, REELS_PUSHES_M, REELS_TURNS = (0.0, 1e4, 1e3), (0.1, 5.0), 12
#: A controller that samples: gains [N s/m], periods and delays [s], push [m], most turns, and the
#: swing [m] at which a motion is given up.
SAMPLED_GAINS, PERIODS_S = (5.0, WATCHED, 50.0), (20.0, 40.0, 80.0)
DELAYS_S = (0.0, 10.0, 20.0, 30.0, 40.0, 50.0, 60.0, 80.0)
SAMPLED_PUSH_M, SAMPLED_TURNS, LOST_M = 1.0, 60, 100.0
#: The three satellites: rate over Omega inside the unstable band, the gain [N s/m] to begin with,
#: by how much it is lowered, and how precisely the least one is found.
SLOW, FIRST_GAIN, STEP, PRECISELY = -1.5, 5.0, 0.9, 1e-3
#: Gains of simulations [N s/m], and how many turns they take.
SIMULATED, SLOW_TURNS = (0.01, 0.02, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.5, 1.0, 2.0, 5.0), 30


def six_beads(gain: float, damping: float = TETHER_DAMPING, mass: float = 1.0) -> System:
    """The paper's ring of section 3.3 with feedback; masses times a factor."""
    return core.ring(
        satellites=3, satellite_mass_kg=1000.0 * mass, beads_per_tether=1,
        bead_mass_kg=10.0 * mass, damping_n_s_per_m=damping, **{DAMPING: gain},
    )  # fmt: skip


def shipped(gain: float) -> System:
    """The ring of the scenario `SHIPPED` with feedback."""
    return scenario.load(SHIPPED).build({DAMPING: gain})


def three_star(gain: float) -> System:
    """The paper's three satellites, their tethers pulling only."""
    return core.ring(damping_n_s_per_m=1450.0, tether_law="tension_only", **{DAMPING: gain})


def moduli(result: FloquetResult, family: str, above: bool | None = None) -> np.ndarray:
    """Moduli of a family's multipliers, largest first; out of the orbit plane, in it, or all."""
    chosen = np.array(result.family) == family
    if above is not None:
        out = np.sum(np.abs(result.vectors[2::3]) ** 2, axis=0) > 0.5
        chosen &= out == above
    return np.sort(np.abs(result.multiplier[chosen]))[::-1]


# -- six beads -------------------------------------------------------------------------------------


def gains(stopped: Callable[[], bool]) -> dict[str, Any]:
    """Multipliers of the six beads without feedback and over its gain, and of the scenario's."""
    rows = []
    for gain in (0.0, *GAINS):
        result = core.compute_floquet(six_beads(gain), RATE, certify=False, cancelled=stopped)
        rows.append({"gain": gain, "result": result})
    found = rows[1:]
    best = min(found, key=lambda row: row["result"].max_modulus_nontrivial)
    own = core.compute_floquet(shipped(WATCHED), RATE, certify=False, cancelled=stopped)
    return {"open": rows[0]["result"], "rows": found, "best": best, "shipped": own}


def watched(system: System, result: FloquetResult, ratio: float, turns: int) -> dict[str, Any]:
    """A motion disturbed by a push: its swing out of the plane by turns, and what thrusters did.

    Impulses [N s] and energies [J] are of all satellites together, by turns.
    """
    start = core.disturbed(result.state, PUSH_M, seed=1)
    times = result.period_s * np.arange(turns * SAMPLES + 1) / SAMPLES
    r, v = core.Propagator(system, ratio, start).sample(times)
    force = np.array([thrust(system, ratio, State(*state)) for state in zip(r, v)])
    size = np.linalg.norm(force, axis=2)
    step = np.diff(times)[:, None]
    impulse, energy = size.sum(axis=1), np.abs(np.sum(force * v, axis=2)).sum(axis=1)

    def by_turns(x):
        return (0.5 * (x[1:] + x[:-1])[:, None] * step).reshape(turns, SAMPLES).sum(axis=1)

    centre = np.average(r, axis=1, weights=system.mass_kg)[:, None]
    swing = np.abs((r - centre)[:, :, 2]).max(axis=1)[1:].reshape(turns, SAMPLES).max(axis=1)
    arm = np.linalg.norm((r - centre)[:, system.is_satellite], axis=2)
    return {
        "swing": swing, "impulse": by_turns(impulse), "energy": by_turns(energy),
        "thrust": size.max(), "thrust_at_last": size[-SAMPLES:].max(),
        "arm": arm[1:].reshape(turns, -1), "turns": _turns(system, r - centre),
    }  # fmt: skip


def _turns(system, arm):
    """Turns that the first satellite has made about the centre of mass."""
    x, y = arm[:, np.flatnonzero(system.is_satellite)[0], :2].T
    return float(np.ptp(np.unwrap(np.arctan2(y, x))[[0, -1]]) / (2.0 * math.pi))


def settling(stopped: Callable[[], bool]) -> dict[str, Any]:
    """The same push without feedback, with tethers that damp more, and with feedback."""
    cases = {
        "no feedback": six_beads(0.0), "no feedback, C = 10 000 N s/m": six_beads(0.0, 1e4),
        f"c = {WATCHED:g} N s/m": six_beads(WATCHED),
    }  # fmt: skip
    found = {}
    for name, system in cases.items():
        result = core.compute_floquet(system, RATE, certify=False, cancelled=stopped)
        found[name] = watched(system, result, RATE, TURNS)
    motion = found[name]
    calm = np.flatnonzero(motion["swing"] > SETTLED * motion["swing"][0])
    return {
        "cases": found,
        "settled": int(calm[-1]) + 2,
        "own": motion,
        "period_s": result.period_s,
    }


def tethers(stopped: Callable[[], bool]) -> list[dict[str, Any]]:
    """Multipliers of the shape in the plane and out of it over the damping of the tethers."""
    rows = []
    for damping in TETHERS:
        result = core.compute_floquet(six_beads(0.0, damping), RATE, certify=False,
                                      cancelled=stopped)  # fmt: skip
        out, inside = moduli(result, "shape", True), moduli(result, "shape", False)
        rows.append({
            "damping": damping, "verdict": result.verdict, "in": inside[0],
            "out": float(np.max(np.abs(out - 1.0))),
        })  # fmt: skip
    return rows


def masses(stopped: Callable[[], bool]) -> list[dict[str, Any]]:
    """Verdicts with the same gain where all masses, or the satellites' alone, are others."""
    rows = []
    for change in MASSES:
        system = six_beads(WATCHED, mass=change)
        result = core.compute_floquet(system, RATE, certify=False, cancelled=stopped)
        rows.append(
            {"mass": change, "verdict": result.verdict, "slowest": result.max_modulus_nontrivial}
        )
    return rows


# -- a controller that samples ---------------------------------------------------------------------


def sampled_swing(gain: float, period_s: float, delay_s: float, start: State) -> np.ndarray:
    """The swing of the six beads out of the plane, driven by a controller that samples.

    It sees the state every period. The thrust that follows from it acts a delay later, and until
    the next one does, in axes that turn with the formation.

    Parameters
    ----------
    gain : float
        [N s/m]
    period_s, delay_s : float
    start : State

    Returns
    -------
    ndarray
        [m] root of the mean square in each turn, before the one in which it exceeds `LOST_M`.
    """
    free, law = six_beads(0.0), six_beads(gain)
    spin, spinning = free.spin_rate_rad_s(RATE), FRAMES.index("spinning")
    motion, plan, swing = core.Propagator(free, RATE, start), [], []
    step_s, time = free.period_s(RATE) / SAMPLES, 0
    looks, whole = 0, core.Commands.none(free)
    while len(swing) < SAMPLED_TURNS:
        square = 0.0
        for _ in range(SAMPLES):
            while looks * period_s <= time * step_s:
                now = looks * period_s
                r, v = (x[0] for x in motion.sample([now]))
                force = np.zeros((len(FRAMES), free.n, 3))
                force[spinning] = thrust(law, RATE, State(r, v)) @ turn_about(Z_AXIS, spin * now)
                plan = [held for held in plan if held[0] > motion.commanded_s]
                plan.append((now + delay_s, whole._replace(force_n=force)))
                motion.command(plan)
                looks += 1
            z = motion.sample([time * step_s])[0][0, :, 2]
            z -= np.average(z, weights=free.mass_kg)
            if np.abs(z).max() > LOST_M:
                return np.array(swing)
            square += np.mean(z**2) / SAMPLES
            time += 1
        swing.append(math.sqrt(square))
    return np.array(swing)


def _growth(swing):
    """How a swing, by turns, grows in a turn: in its later half, when what decays fast is gone."""
    late = np.log(swing[len(swing) // 2 if len(swing) > 5 else 0 :])
    slope = np.polyfit(np.arange(len(late)), late, 1)[0] if len(late) > 1 else math.inf
    return math.exp(slope)


def delays(stopped: Callable[[], bool]) -> dict[str, Any]:
    """How the swing grows in a turn over gain, period and delay of a controller that samples.

    And with feedback that does not sample, after the same push.
    """
    rows, continuous = [], {}
    for gain in SAMPLED_GAINS:
        system = six_beads(gain)
        result = core.compute_floquet(system, RATE, certify=False, cancelled=stopped)
        start = core.disturbed(result.state, SAMPLED_PUSH_M, seed=1)
        times = result.period_s * np.arange(SAMPLED_TURNS * SAMPLES) / SAMPLES
        z = core.Propagator(system, RATE, start).sample(times)[0][..., 2]
        z -= np.average(z, axis=1, weights=system.mass_kg)[:, None]
        square = np.mean(z.reshape(SAMPLED_TURNS, -1) ** 2, axis=1)
        continuous[gain] = _growth(np.sqrt(square))
        for period in PERIODS_S:
            growth = [
                _growth(sampled_swing(gain, period, delay, start))
                for delay in DELAYS_S if not stopped()
            ]  # fmt: skip
            rows.append({"gain": gain, "period": period, "growth": growth})
    open_loop = core.compute_floquet(six_beads(0.0), RATE, certify=False)
    modes = core.compute_modes(six_beads(0.0), open_loop)
    return {"rows": rows, "continuous": continuous, "modes": modes}


# -- three satellites in the unstable band ---------------------------------------------------------


def aim(system: System, result: FloquetResult) -> float:
    """Rate over Omega that feedback aims at so as to give the spin what is lost."""
    length = float(np.max(np.abs(result.state.position_m)))
    integrator = Integrator(system, result.spin_rate_rad_s, 1e-9, length)
    return integrator.driven(result.spin_loss).arrays.aim / system.orbit_rate_rad_s


def slow(stopped: Callable[[], bool]) -> dict[str, Any]:
    """The least gain at which the slow ring has a motion that is held, and simulations.

    Every motion is sought next to that of the gain before.
    """

    def sought(gain, state):
        result = core.compute_floquet(three_star(gain), SLOW, state=state, certify=False,
                                      cancelled=stopped)  # fmt: skip
        rows.append({"gain": gain, "result": result})
        return result if result.verdict == "asymptotically stable" else None

    rows, high = [], FIRST_GAIN
    best = sought(high, core.initial_state(three_star(high), SLOW))
    if best is None:
        raise core.TssError(f"no motion is held at {SLOW:g} with a gain of {high:g}")
    low = high
    while (result := sought(low := STEP * low, best.state)) is not None:
        high, best = low, result
    while high - low > PRECISELY * high:
        middle = 0.5 * (low + high)
        if (result := sought(middle, best.state)) is None:
            low = middle
        else:
            high, best = middle, result
    simulated = []
    for gain in SIMULATED:
        system = three_star(gain)
        start = core.compute_floquet(system, SLOW, "frozen")
        simulated.append({"gain": gain} | watched(system, start, SLOW, SLOW_TURNS))
    return {"gain": high, "result": best, "rows": rows, "simulated": simulated,
            "aim": aim(three_star(high), best)}  # fmt: skip


def rigid_gain(system: System, ratio: float) -> float:
    """Gain [N s/m] from which the axis of a flat rigid ring stays: -(1 + 2 w)(4 + 2 w) = (w d)^2.

    d is the gain over mass and Omega.
    """
    share = math.sqrt(-(1.0 + 2.0 * ratio) * (4.0 + 2.0 * ratio)) / abs(ratio)
    return share * float(system.mass_kg[0]) * system.orbit_rate_rad_s


def reeled(satellites: int, damping: float) -> System:
    """A ring of undamped tethers whose reels follow tension, with a damping of the reels."""
    return core.ring(satellites, damping_n_s_per_m=0.0, **{REELS: damping})


def reels(stopped: Callable[[], bool]) -> dict[str, Any]:
    """What reels that follow the tension of undamped tethers do, over the damping of the reels."""
    rows, motions, (first, at) = [], {}, REELED[0]
    for damping in REELS_WATCHED:
        ring = reeled(first, damping)
        start = core.compute_floquet(ring, at, certify=False, cancelled=stopped).state
        shown = {"turns": REELS_TURNS, "cancelled": stopped}
        calm, *moved = (
            core.simulate(ring, at, state=start, disturbance_m=push, seed=1, **shown).length_m
            for push in (0.0, *REELS_PUSHES_M)
        )
        for push, length_m in zip(REELS_PUSHES_M, moved):
            apart = np.max(np.abs(length_m - calm), axis=1)[1:].reshape(REELS_TURNS, -1)
            motions[push, damping] = np.max(apart, axis=1)
    for satellites, rate in REELED:
        for damping in REEL_DAMPINGS:
            ring = reeled(satellites, damping)
            found = core.compute_floquet(ring, rate, certify=False, cancelled=stopped)
            turn = core.simulate(ring, rate, turns=1, state=found.state, cancelled=stopped)
            rows.append({
                "satellites": satellites, "rate": rate, "damping": damping, "found": found,
                "stroke": float(np.max(np.ptp(turn.rests_m, axis=0))),
            })  # fmt: skip
    return {"rows": rows, "motions": motions}
