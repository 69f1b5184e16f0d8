"""The feedback of a system at one spin rate: what its kernels and matrices need for it.

Thrusters are here, reels in `reel_law`.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np

from tss_ros.core.errors import TssError
from tss_ros.core.model.configurations import averaged_state
from tss_ros.core.model.contract import ThrustLaw
from tss_ros.core.model.equilibria import equilibrium
from tss_ros.core.model.feedback_thrust import THRUSTS, add_thrust, turn_damping
from tss_ros.core.model.kernel_arrays import KernelArrays, kernel_arrays
from tss_ros.core.model.laws import THRUST_LAWS
from tss_ros.core.model.reel_law import reels_that_yield, with_reels
from tss_ros.core.model.stated import SHAPE
from tss_ros.core.model.system import State, System
from tss_ros.core.numerics import block_lu
from tss_ros.core.numerics.block_lu import Symbolic
from tss_ros.core.numerics.expressions import symbols


def acting_thrusts(system: System) -> tuple[ThrustLaw, ...]:
    """The laws by which thrusters of the satellites act on what the formation does."""
    return tuple(law for law in THRUST_LAWS if system.law_parameters[law.parameters[0].name])


def feeds_back(system: System) -> bool:
    """Whether there are such laws."""
    return bool(acting_thrusts(system))


def follows_laws(system: System) -> bool:
    """Whether thrusters or reels act on what the formation does."""
    return feeds_back(system) or bool(reels_that_yield(system).size)


def damping_time_s(arrays: KernelArrays, system: System) -> float:
    """Mass of the satellites over their damping against the rigid turn [s]; 0 without any."""
    if not arrays.satellite.size:
        return 0.0
    chosen = system.is_satellite
    damping = turn_damping(arrays, system.layout_m - np.mean(system.layout_m[chosen], axis=0))
    return float(np.mean(system.mass_kg[chosen])) / damping if damping else 0.0


def with_feedback(arrays: KernelArrays, system: System, spin_rate_rad_s: float) -> KernelArrays:
    """The arrays with the system's feedback, if it has one.

    Parameters
    ----------
    arrays : KernelArrays
    system : System
    spin_rate_rad_s : float
        omega [rad/s] that it aims at, and whose steady shape it keeps; 0 for a formation that
        hangs.

    Raises
    ------
    TssError
        If the formation does not spin about the orbit normal.
    NoSteadyState
        If there is no steady shape.
    """
    if not feeds_back(system):
        return with_reels(arrays, system, spin_rate_rad_s)
    aim = system.turning_rad_s(spin_rate_rad_s)
    if spin_rate_rad_s and not aim:
        raise TssError(
            "feedback aims at a turn about the orbit normal, [0, 0, 1], but spin_axis is"
            f" {np.array2string(system.spin_axis, precision=6, separator=', ')}"
        )
    acting = acting_thrusts(system)
    shape = np.empty((0, 3))
    if any(set(SHAPE) & symbols(*THRUSTS[THRUST_LAWS.index(law)]) for law in acting):
        if aim:
            ratio = spin_rate_rad_s / system.orbit_rate_rad_s
            place = averaged_state(system, ratio).position_m
        else:
            place = equilibrium(system)
        shape = place - np.mean(place[system.is_satellite], axis=0)
    share = system.is_satellite / np.count_nonzero(system.is_satellite)
    thrusting = sum(1 << THRUST_LAWS.index(law) for law in acting)
    arrays = arrays._replace(satellite=share, shape=shape, aim=aim, thrusting=thrusting)
    return with_reels(arrays, system, spin_rate_rad_s)


def analysed(system: System) -> Symbolic:
    """Elimination order and fill of the system's matrices.

    Rest lengths that are states are coupled with the ends of their tethers; their pairs follow the
    tethers. Feedback couples every satellite with every other one; their pairs come last.
    """
    ends, rows = [system.tether_ends], system.n + reels_that_yield(system).size
    for row, k in enumerate(reels_that_yield(system), system.n):
        ends.append([(end, row) for end in system.tether_ends[k]])
    if feeds_back(system):
        pairs = combinations(np.flatnonzero(system.is_satellite), 2)
        ends.append(np.array(list(pairs), dtype=np.int64).reshape(-1, 2))
    return block_lu.analyse(rows, np.concatenate(ends))


def thrust(system: System, spin_rate_ratio: float, state: State) -> np.ndarray:
    """Thrust of every bead by the feedback.

    Parameters
    ----------
    system : System
    spin_rate_ratio : float
        w = omega / Omega that the feedback aims at.
    state : State

    Returns
    -------
    ndarray, shape (n, 3)
        [N] in the orbit frame; 0 for beads that are no satellites.
    """
    spin, acceleration = system.spin_rate_rad_s(spin_rate_ratio), np.zeros((system.n, 3))
    arrays = with_feedback(kernel_arrays(system, 0.0), system, spin)
    if arrays.satellite.size:
        add_thrust(arrays, state.velocity_m_s, state.position_m, acceleration)
    return system.mass_kg[:, None] * acceleration
