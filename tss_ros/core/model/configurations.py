"""Initial configurations: the paper's, Eqs. (50), (51), (54), and the averaged rotating state."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.optimize import root

from tss_ros.core.arguments import checked, finite
from tss_ros.core.errors import NoSteadyState, TssError
from tss_ros.core.model import forces
from tss_ros.core.model.averaged_balance import AveragedBalance
from tss_ros.core.model.axes import resting_state
from tss_ros.core.model.elements import on_mean_circle
from tss_ros.core.model.equilibria import equilibrium
from tss_ros.core.model.frames import rigid_velocity, turn_to
from tss_ros.core.model.kernel_arrays import kernel_arrays
from tss_ros.core.model.orbits import reference_orbit
from tss_ros.core.model.system import State, System

#: Where a formation that hangs starts.
EQUILIBRIUM = "equilibrium of the orbit frame"
#: Beads with less than this share of the largest radius are near the centre.
NEAR_CENTRE = 0.1


@dataclass(frozen=True, repr=False)
class InitialState(State):
    """A `State` to start from, with where it comes from.

    Attributes
    ----------
    origin : str
        "Eqs. 50-51", "Eq. 54", "averaged gravity gradient", with the axis if that was found, or
        `EQUILIBRIUM`.
    """

    origin: str = ""

    def _headline(self):
        return f"{super()._headline()}; {self.origin}"


@checked
def initial_state(system: System, spin_rate_ratio: float) -> InitialState:
    """Steady configuration to start from at time 0: the paper's where it has one.

    Parameters
    ----------
    system : System
    spin_rate_ratio : float
        w = omega / Omega, negative for clockwise; 0 for a formation that hangs at rest in the
        orbit frame.

    Returns
    -------
    InitialState

    Raises
    ------
    TssError
        If the rate is not allowed.
    NoSteadyState
        If no steady configuration was found.
    """
    return next(initial_states(system, spin_rate_ratio))


def initial_states(system: System, spin_rate_ratio: float) -> Iterator[InitialState]:
    """Steady configurations to start from, the best known one first.

    Parameters and errors as `initial_state`; the errors are those of the first.

    Yields
    ------
    InitialState
        The paper's where it has one, then that of the averaged gravity gradient; at a rate of 0
        the equilibrium of the orbit frame.
    """
    spin = system.spin_rate_rad_s(spin_rate_ratio)
    if not system.autonomous:
        # At rest in the frame that turns evenly: the orbit frame itself does not.
        orbit = reference_orbit(system)
        for state in initial_states(on_mean_circle(system), spin_rate_ratio):
            r, v = state.position_m, state.velocity_m_s
            yield InitialState(r, orbit.from_even_frame(v, r), f"{state.origin}, on a circle")
        return
    if not spin:
        place = equilibrium(system)
        yield InitialState(place, np.zeros_like(place), EQUILIBRIUM)
        return
    units = ring_units(system) if (turning := system.turning_rad_s(spin)) else 0
    if not units or system.n // units > 2 or not _bead_in_the_middle(system, units):
        yield averaged_state(system, spin_rate_ratio)
        return
    yield _paper_configuration(system, turning, units)
    with contextlib.suppress(NoSteadyState):
        averaged = averaged_state(system, spin_rate_ratio)
        yield averaged


def ring_units(system: System) -> int:
    """Number of satellites if the system is a ring of equal units, Eq. (4), else 0."""
    n, units = system.n, int(np.count_nonzero(system.is_satellite))
    if system.m != n or units < 3 or n % units:
        return 0
    if not np.array_equal(system.tether_ends, np.stack([np.arange(n), np.arange(1, n + 1) % n], 1)):
        return 0
    for values in (
        system.is_satellite,
        system.mass_kg,
        system.rest_length_m,
        system.axial_stiffness_n,
        system.damping_n_s_per_m,
    ):
        if not np.array_equal(values, np.roll(values, n // units)):
            return 0
    return units


def _bead_in_the_middle(system, units):
    """Whether a bead between two satellites, if there is one, halves its tether as in Eq. (54)."""
    per_unit = system.n // units
    lengths = system.rest_length_m[:per_unit], system.axial_stiffness_n[:per_unit]
    return all(np.ptp(values) == 0.0 for values in lengths)


def _paper_configuration(system, spin, units):
    """Solve Eq. (51), or (54) with one bead between satellites, for the radii R_1 (and R_2)."""
    per_unit = system.n // units
    angle = math.pi / 2 + 2.0 * math.pi * np.arange(system.n) / system.n
    outward = np.stack([np.cos(angle), np.sin(angle), np.zeros(system.n)], axis=1)  # Eq. (50)
    if system.spin_axis[2] < 0.0:
        outward = outward @ turn_to(system.spin_axis).T
    arrays = kernel_arrays(system, 0.0)
    taut = np.ones(system.m, dtype=bool)
    acceleration = np.empty((system.n, 3))

    def state(radii):
        position = np.tile(radii, units)[:, None] * outward
        return position, rigid_velocity(position, spin)

    def imbalance(radii):
        position, velocity = state(radii)
        forces.acceleration(arrays, taut, 0.0, velocity, position, acceleration)
        radial = np.sum(acceleration * outward, axis=1)[:per_unit]
        return radial + spin**2 * radii  # Eq. (51), and (54) with a bead on each tether

    length = np.sum(system.rest_length_m[:per_unit])
    guess = np.full(per_unit, length / (2.0 * math.sin(math.pi / units)))
    if per_unit == 2:
        guess[1] *= math.cos(math.pi / units)
    stiffness = system.axial_stiffness_n / system.rest_length_m
    guess *= 1.0 + min(spin**2 * np.max(system.mass_kg) / np.min(stiffness), 0.1)
    solution = root(imbalance, guess, tol=1e-14)
    error = np.max(np.abs(imbalance(solution.x))) / (spin**2 * np.max(solution.x))
    rounding = 16 * np.finfo(float).eps * np.max(stiffness) / np.min(system.mass_kg) / spin**2
    if not error < 1e-8 + rounding or np.min(solution.x) <= 0.0:
        raise NoSteadyState(
            "no steady configuration found for spin_rate_ratio"
            f" {spin * system.spin_axis[2] / system.orbit_rate_rad_s:g}:"
            f" Eq. (51) is left with a relative imbalance of {error:.1e}"
        )
    return InitialState(*state(solution.x), "Eqs. 50-51" if per_unit == 1 else "Eq. 54")


@checked
def averaged_state(system: System, spin_rate_ratio: float) -> InitialState:
    """Rotating equilibrium under the gravity gradient averaged over one turn.

    That is 1.5 Omega^2 in plane for an axis along the orbit normal. Another axis is found with the
    shape, next to that of the system: the one of a family of `axes` at which it rests.

    Parameters
    ----------
    system : System
    spin_rate_ratio : float

    Returns
    -------
    InitialState

    Raises
    ------
    TssError
        If the rate is not allowed.
    NoSteadyState
        If none was found near the system's layout and axis.
    """
    spin = system.spin_rate_rad_s(spin_rate_ratio)
    if not spin:
        raise TssError("spin_rate_ratio of a rotating state must not be 0, got 0")
    turning = system.turning_rad_s(spin)
    if not turning:
        state, axis = resting_state(system, spin)
        origin = f"averaged gravity gradient, {axis}"
        return InitialState(state.position_m, state.velocity_m_s, origin)
    place = AveragedBalance(system, system.layout_m, turning).solved(spin_rate_ratio)
    return InitialState(place, rigid_velocity(place, turning), "averaged gravity gradient")


@checked
def disturbed(state: State, disturbance_m: float, seed: int = 0) -> State:
    """Displace every bead by a seeded random vector.

    Parameters
    ----------
    state : State
    disturbance_m : float
        [m] Euclidean norm of all displacements together.
    seed : int

    Returns
    -------
    State
        Velocities unchanged.
    """
    size = finite("disturbance_m", disturbance_m, at_least=0.0)
    push = np.random.default_rng(seed).standard_normal(state.position_m.shape)
    return State(
        state.position_m + size * push / np.linalg.norm(push), np.array(state.velocity_m_s),
        reel_length_m=state.reel_length_m, reel_rate_m_s=state.reel_rate_m_s,
    )  # fmt: skip


@checked
def deviation(position_m: np.ndarray, reference_radius_m: float | np.ndarray) -> np.ndarray:
    """Relative deviation d_i = |r_i| / R_0 - 1, Eq. (53).

    A bead at or near the centre has no radius to compare with. Where R_0 is less than a tenth of
    the largest one R_max, d_i = (|r_i| - R_0) / R_max.

    Parameters
    ----------
    position_m : ndarray, shape (..., n, 3)
    reference_radius_m : float or ndarray, shape (n,)
        Distance of each bead from the centre in the undisturbed initial state.

    Returns
    -------
    ndarray, shape (..., n)
    """
    radius_m = np.asarray(reference_radius_m, dtype=float)
    near = radius_m < NEAR_CENTRE * np.max(radius_m)
    compared_m = np.where(near, np.max(radius_m), radius_m)
    return np.linalg.norm(position_m, axis=-1) / compared_m - np.where(
        near, radius_m / compared_m, 1.0
    )
