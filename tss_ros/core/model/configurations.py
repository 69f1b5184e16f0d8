"""Initial configurations: the paper's, Eqs. (50), (51), (54), and the averaged rotating state."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.optimize import root

from tss_ros.core.arguments import checked
from tss_ros.core.errors import NoSteadyState
from tss_ros.core.model import forces
from tss_ros.core.model.elements import on_mean_circle
from tss_ros.core.model.frames import rigid_velocity
from tss_ros.core.model.kernel_arrays import kernel_arrays
from tss_ros.core.model.orbits import reference_orbit
from tss_ros.core.model.system import State, System, finite
from tss_ros.core.numerics import block_lu

#: Most changes of which tethers are taut in the averaged balance, and most corrections of each.
MOST_MODE_CHANGES, MOST_CORRECTIONS = 10, 200
#: Largest force left, over the mean centrifugal force, of a configuration in balance.
BALANCED = 1e-7
#: Most steps of the relaxation where Newton's method alone does not find the balance.
MOST_RELAXATIONS = 300


@dataclass(frozen=True, repr=False)
class InitialState(State):
    """A `State` to start from, with where it comes from.

    Attributes
    ----------
    origin : str
        "Eqs. 50-51", "Eq. 54" or "averaged gravity gradient".
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
        w = omega / Omega, negative for clockwise.

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
        The paper's where it has one, then that of the averaged gravity gradient.
    """
    spin = system.spin_rate_rad_s(spin_rate_ratio)
    if not system.autonomous:
        # At rest in the frame that turns evenly: the orbit frame itself does not.
        orbit = reference_orbit(system)
        for state in initial_states(on_mean_circle(system), spin_rate_ratio):
            r, v = state.position_m, state.velocity_m_s
            yield InitialState(r, orbit.from_even_frame(v, r), f"{state.origin}, on a circle")
        return
    units = ring_units(system)
    if not units or system.n // units > 2:
        yield averaged_state(system, spin_rate_ratio)
        return
    yield _paper_configuration(system, spin, units)
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


def _paper_configuration(system, spin, units):
    """Solve Eq. (51), or (54) with one bead between satellites, for the radii R_1 (and R_2)."""
    per_unit = system.n // units
    angle = math.pi / 2 + 2.0 * math.pi * np.arange(system.n) / system.n
    outward = np.stack([np.cos(angle), np.sin(angle), np.zeros(system.n)], axis=1)  # Eq. (50)
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
            f"no steady configuration found for spin_rate_ratio {spin / system.orbit_rate_rad_s:g}:"
            f" Eq. (51) is left with a relative imbalance of {error:.1e}"
        )
    return InitialState(*state(solution.x), "Eqs. 50-51" if per_unit == 1 else "Eq. 54")


@checked
def averaged_state(system: System, spin_rate_ratio: float) -> InitialState:
    """Rotating equilibrium under the gravity gradient averaged over one turn, 1.5 Omega^2 in plane.

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
        If none was found near the system's layout.
    """
    spin = system.spin_rate_rad_s(spin_rate_ratio)
    balance = _AveragedBalance(system, spin)
    place, force = balance.balanced(start := balance.start())
    if np.max(np.abs(force)) > BALANCED * balance.scale:
        place, force = balance.balanced(balance.settled(start))
    left = np.max(np.abs(force), axis=1)
    worst = int(np.argmax(left))
    if not left[worst] < balance.scale * (BALANCED + balance.rounding):
        raise NoSteadyState(
            f"no steady configuration found for spin_rate_ratio {spin_rate_ratio:g}:"
            f" {system.bead_name[worst]} is left out of balance by {left[worst]:.3g} N,"
            f" {left[worst] / balance.scale:.1e} of the mean centrifugal force"
        )
    return InitialState(place, rigid_velocity(place, spin), "averaged gravity gradient")


class _AveragedBalance:
    """The forces of a rigid turn under averaged gravity, and Newton's method for their balance."""

    def __init__(self, system, spin):
        rate, self.mass = system.orbit_rate_rad_s, system.mass_kg
        self.outward = spin**2 + 2.0 * rate * spin + 1.5 * rate**2
        # Without an orbit the turning frame leaves centrifugal force and tethers alone, so a spin
        # of sqrt(outward) with the orbital rate at zero has the averaged in-plane balance.
        arrays = kernel_arrays(system, math.sqrt(self.outward))
        self.arrays = arrays._replace(rate=0.0, bilateral=True, acting=0)
        self.system, self.inward = system, rate**2
        self.symbolic = block_lu.analyse(system.n, system.tether_ends)
        self.taut = np.ones(system.m, dtype=bool)
        self.still = np.zeros((system.n, 3))
        self.by_r, self.by_v = np.empty((2, self.symbolic.blocks, 3, 3))

    def start(self):
        """The layout, stretched by about what the spin does."""
        place = np.array(self.system.layout_m)
        place -= np.average(place, axis=0, weights=self.mass)
        self.radius = np.max(np.linalg.norm(place, axis=1))
        strain = np.sum(self.mass) * self.outward * self.radius
        strain /= np.min(self.system.axial_stiffness_n)
        place *= 1.0 + min(max(strain, 1e-9), 0.05)
        self.scale = self.outward * self.radius * np.mean(self.mass)
        stiffest = np.max(self.arrays.stiffness)
        self.rounding = 8 * np.finfo(float).eps * self.radius * stiffest / self.scale
        self.pinned = int(np.argmax(np.linalg.norm(place, axis=1)))
        return place

    def force(self, place):
        """What is left of all forces, (n, 3) [N]."""
        acceleration = np.empty_like(place)
        forces.acceleration(self.arrays, self.taut, 0.0, self.still, place, acceleration)
        acceleration[:, 2] -= self.inward * place[:, 2]
        return self.mass[:, None] * acceleration

    def factor(self, place, slow=0.0):
        """Factor the derivatives of the accelerations there, less `slow` [1/s^2] times the unit."""
        by_r, n = self.by_r, self.system.n
        forces.jacobian(
            self.arrays, self.symbolic.pair, self.taut, 0.0, self.still, place, by_r, self.by_v
        )
        by_r[:n, 2, 2] -= self.inward
        by_r[:n] -= slow * np.eye(3)
        # The equilibrium may lie at any angle, and no force tells: a spring holds one bead's.
        pinned = slice(self.pinned, self.pinned + 1)
        along = rigid_velocity(place[pinned], 1.0)[0] / self.radius
        by_r[self.pinned] -= np.max(np.abs(by_r[self.pinned])) * np.outer(along, along)
        block_lu.factor(self.symbolic, by_r)

    def correction(self, force):
        """Change of the places that would make this force vanish, by the factored derivatives."""
        step = -force / self.mass[:, None]
        block_lu.solve(self.symbolic, self.by_r, step)
        return step

    def balanced(self, place):
        """Places where forces balance with the tethers that are taut there, and the force left."""
        self.taut[:] = True
        for _ in range(MOST_MODE_CHANGES):
            place, force = self.newton(place)
            stretched = forces.acting_tethers(self.system, place, self.still)
            if np.array_equal(stretched, self.taut):
                break
            self.taut = stretched
        return place, force

    def settled(self, place):
        """Places to which beads settle in a thick fluid: near a balance that is stable.

        Implicit steps along the forces, longer as these fall (pseudo-transient continuation; C. T.
        Kelley and D. E. Keyes, SIAM J. Numer. Anal. 35, 1998).
        """
        force = self.force(place)
        first = np.max(np.abs(force))
        for _ in range(MOST_RELAXATIONS):
            size = np.max(np.abs(force))
            if not size > BALANCED * self.scale:
                break
            self.factor(place, slow=self.outward * size / first)
            step = self.correction(force)
            if not np.isfinite(step).all():
                break
            place = place + step * min(1.0, 0.1 * self.radius / np.max(np.abs(step)))
            force = self.force(place)
        return place

    def newton(self, place):
        """Places where forces balance, as far as Newton's method leads, and the force left."""
        force = self.force(place)
        for _ in range(MOST_CORRECTIONS):
            if np.max(np.abs(force)) < 1e-12 * self.scale:
                break
            self.factor(place)
            step = self.correction(force)
            if not np.isfinite(step).all():
                break
            # Forces tell nothing of the distance to go where tethers are stiff; corrections do.
            size = min(1.0, 0.3 * self.radius / max(np.max(np.abs(step)), 1e-300))
            best = np.sum(step * step)
            trial = self.force(place + size * step)
            while size > 1e-6 and not np.sum(self.correction(trial) ** 2) < (1.0 - size / 2) * best:
                size *= 0.5
                trial = self.force(place + size * step)
            if size <= 1e-6:
                break
            place, force = place + size * step, trial
        return place, force


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
        state.position_m + size * push / np.linalg.norm(push), np.array(state.velocity_m_s)
    )


@checked
def deviation(position_m: np.ndarray, reference_radius_m: float | np.ndarray) -> np.ndarray:
    """Relative deviation d_i = |r_i| / R_0 - 1, Eq. (53).

    Parameters
    ----------
    position_m : ndarray, shape (..., n, 3)
    reference_radius_m : float or ndarray, shape (n,)
        Distance of each bead from the centre in the undisturbed initial state.

    Returns
    -------
    ndarray, shape (..., n)
    """
    return np.linalg.norm(position_m, axis=-1) / reference_radius_m - 1.0
