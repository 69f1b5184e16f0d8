"""Confirmation of a verdict by direct simulation of a disturbed motion."""

import math
from dataclasses import dataclass

import numpy as np

from tss_ros.core.errors import TssError
from tss_ros.core.motion import Propagator
from tss_ros.core.steady_state import deviation, disturbed, initial_state
from tss_ros.core.system import finite

#: Samples in each turn.
SAMPLES = 200
#: A formation is lost when a bead's distance from the centre of mass leaves its start by this much.
LOST = 0.2


@dataclass(frozen=True)
class Confirmation:
    """What became of a disturbed formation.

    Attributes
    ----------
    held : bool
        No bead left its distance from the centre of mass by more than `LOST`.
    turns_to_settle : float
        Turns after which the deviation from the undisturbed motion, measured from the centre of
        mass, stays below a tenth of its largest value; infinity if it does not.
    tilt_per_turn : float
        Factor by which the largest distance from the orbit plane grows a turn, fitted over the
        second half of the run: to be compared with the axis tilt's multiplier. NaN for a
        disturbance within the plane.
    deviation_from_origin, deviation_from_centre : float
        Largest |d_i| of Eq. (53), measured from the frame's origin and from the instantaneous
        centre of mass.
    switches : int
        Slack/taut switches of the disturbed motion.
    turns : ndarray, shape (k,)
        Sample times in turns.
    history : ndarray, shape (k,)
        Largest difference of the beads' distances from the centre of mass between the disturbed
        and the undisturbed motion, over the radius.
    """

    held: bool
    turns_to_settle: float
    tilt_per_turn: float
    deviation_from_origin: float
    deviation_from_centre: float
    switches: int
    turns: np.ndarray
    history: np.ndarray


def confirm(
    system, spin_rate_ratio, state=None, disturbance_m=10.0, seed=0, turns=8, cancelled=None
):
    """Simulate a disturbed formation beside the undisturbed one.

    Parameters
    ----------
    system : System
    spin_rate_ratio : float
    state : State, optional
        Undisturbed start, e.g. `FloquetResult.state`; `initial_state` if not given.
    disturbance_m : float
        [m] see `disturbed`.
    seed : int
    turns : int
        How long to simulate.
    cancelled : callable, optional
        Asked now and then; a true answer stops the work.

    Returns
    -------
    Confirmation

    Raises
    ------
    TssError
        For values that are not allowed.
    Cancelled
        If `cancelled` said so.
    """
    finite("disturbance_m", disturbance_m, above=0.0)
    if not 1 <= turns <= 10_000:
        raise TssError(f"turns must be from 1 to 10000, got {turns}")
    if state is None:
        state = initial_state(system, spin_rate_ratio)
    period = 2.0 * math.pi / abs(system.spin_rate_rad_s(spin_rate_ratio))
    times = np.linspace(0.0, turns * period, turns * SAMPLES + 1)
    weight = system.mass_kg / np.sum(system.mass_kg)

    def run(start):
        motion = Propagator(system, spin_rate_ratio, start)
        position, _ = motion.sample(times, cancelled)
        centre = np.einsum("i,kic->kc", weight, position)
        return position, np.linalg.norm(position - centre[:, None], axis=2), motion.switches

    _, calm, _ = run(state)
    position, pushed, switches = run(disturbed(state, disturbance_m, seed))
    radius = np.linalg.norm(state.position_m, axis=1)
    size = np.max(radius)
    beyond = radius > 1e-6 * size
    history = np.max(np.abs(pushed - calm), axis=1) / size
    from_centre = np.max(np.abs(pushed - pushed[0]), initial=0.0) / size
    height = np.max(np.abs(position[:-1, :, 2]).reshape(turns, -1), axis=1)
    late = np.arange(turns // 2, turns)
    tilt = math.nan
    if late.size > 1 and np.all(height[late] > 0.0):
        tilt = math.exp(np.polyfit(late, np.log(height[late]), 1)[0])
    loud = np.flatnonzero(history > 0.1 * np.max(history))
    settled = loud[-1] + 1 < len(times) - SAMPLES // 2
    return Confirmation(
        bool(from_centre < LOST),
        float(times[loud[-1] + 1] / period) if settled else math.inf,
        tilt,
        float(np.max(np.abs(deviation(position[:, beyond], radius[beyond])))),
        float(from_centre),
        switches,
        times / period,
        history,
    )
