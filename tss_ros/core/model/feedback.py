"""The feedback of a system at one spin rate: what its kernels and matrices need for it."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from tss_ros.core.errors import TssError
from tss_ros.core.model.configurations import averaged_state
from tss_ros.core.model.equilibria import equilibrium
from tss_ros.core.model.feedback_thrust import add_thrust
from tss_ros.core.model.kernel_arrays import KernelArrays, kernel_arrays
from tss_ros.core.model.laws.feedback import (
    PARAMETERS,
    ROTATION_DAMPING,
    SHAPE_KEEPING,
)
from tss_ros.core.model.system import State, System
from tss_ros.core.numerics import block_lu
from tss_ros.core.numerics.block_lu import Symbolic


def feeds_back(system: System) -> bool:
    """Whether satellites have thrusters that act on what the formation does."""
    return any(system.law_parameters[p.name] for p in (ROTATION_DAMPING, SHAPE_KEEPING))


def damping_time_s(system: System) -> float:
    """Mass of the satellites over the damping against the rigid turn [s]; 0 without any."""
    damping = system.law_parameters[ROTATION_DAMPING.name]
    return float(np.mean(system.mass_kg[system.is_satellite])) / damping if damping else 0.0


def feedback_dissipation(system: System) -> float:
    """Minus the trace of the accelerations by velocity [1/s] that feedback adds, unlimited."""
    beads = np.count_nonzero(system.is_satellite)
    inverse = np.sum(1.0 / system.mass_kg[system.is_satellite])
    return 3.0 * system.law_parameters[ROTATION_DAMPING.name] * inverse * (1.0 - 1.0 / beads)


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
        return arrays
    aim = system.turning_rad_s(spin_rate_rad_s)
    if spin_rate_rad_s and not aim:
        raise TssError(
            "feedback aims at a turn about the orbit normal, [0, 0, 1], but spin_axis is"
            f" {np.array2string(system.spin_axis, precision=6, separator=', ')}"
        )
    gains = tuple(system.law_parameters[p.name] for p in PARAMETERS)
    place = np.zeros((system.n, 3))
    if system.law_parameters[SHAPE_KEEPING.name]:
        if aim:
            ratio = spin_rate_rad_s / system.orbit_rate_rad_s
            place = averaged_state(system, ratio).position_m
        else:
            place = equilibrium(system)
    shape = place - np.mean(place[system.is_satellite], axis=0)
    share = system.is_satellite / np.count_nonzero(system.is_satellite)
    return arrays._replace(satellite=share, shape=shape, aim=aim, gains=gains)


def analysed(system: System) -> Symbolic:
    """Elimination order and fill of the system's matrices.

    Feedback couples every satellite with every other one; their pairs follow the tethers.
    """
    ends = system.tether_ends
    if feeds_back(system):
        pairs = combinations(np.flatnonzero(system.is_satellite), 2)
        ends = np.concatenate([ends, np.array(list(pairs), dtype=np.int64).reshape(-1, 2)])
    return block_lu.analyse(system.n, ends)


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
