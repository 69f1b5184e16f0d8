"""A general-purpose integrator on Eq. (1) as printed, to see what a loose tolerance does.

scipy's LSODA, written down as a user of such a solver would: SI units, orbit frame, slack and taut
left to the step control. Nothing else in the package computes with it.
"""

import math
from collections.abc import Callable, Iterable
from typing import NamedTuple

import numpy as np
from numba import njit
from scipy.integrate import odeint

from tss_ros.core import Cancelled, System, disturbed, initial_state
from tss_ros.core.model.system import MU_EARTH
from tss_ros.reproduction.claims import DISTURBANCE_M, LOST, SEED, bisect, system

TURNS, SAMPLES_PER_TURN = 8, 50


class _Constants(NamedTuple):
    """Constants of Eq. (1) in SI units.

    Attributes
    ----------
    mass : ndarray, shape (n,)
    first, second : ndarray, shape (m,), int
        Beads at the two ends of each segment.
    rest, stiffness, damping : ndarray, shape (m,)
        L [m], EA [N] and C [N s/m].
    rate, radius : float
        Of the orbit [rad/s], [m].
    """

    mass: np.ndarray
    first: np.ndarray
    second: np.ndarray
    rest: np.ndarray
    stiffness: np.ndarray
    damping: np.ndarray
    rate: float
    radius: float


def held_edges(
    names: Iterable[str], damping: float, tolerances: Iterable[float], cancelled: Callable[[], bool]
) -> list[list]:
    """Rates at which a disturbed motion is first held, with a half-width of 0.025.

    Parameters
    ----------
    names : iterable of str
        Scenarios.
    damping : float
        C [N s/m].
    tolerances : iterable of float
        Relative tolerances of the integrator.
    cancelled : callable

    Returns
    -------
    list of [str, float, float or None]
        Scenario, tolerance and rate; None where no rate between 2.0 and 2.9 separates lost from
        held.
    """
    rows = []
    for name in names:
        of = system(name, damping)
        for rtol in tolerances:

            def held(rate, of=of, rtol=rtol):
                return largest_deviation(of, rate, rtol, cancelled) < LOST

            rows.append([name, rtol, bisect(held, -2.0, -2.9, 0.025)])
    return rows


def largest_deviation(of: System, rate: float, rtol: float, cancelled: Callable[[], bool]) -> float:
    """Largest change of a distance from the centre of mass, over itself, in `TURNS` turns."""
    start = disturbed(initial_state(of, rate), DISTURBANCE_M, SEED)
    turn_s = 2 * math.pi / abs(of.spin_rate_rad_s(rate))
    first, second = np.ascontiguousarray(of.tether_ends.T)
    constants = _Constants(
        mass=of.mass_kg,
        first=first,
        second=second,
        rest=of.rest_length_m,
        stiffness=of.axial_stiffness_n,
        damping=of.damping_n_s_per_m,
        rate=of.orbit_rate_rad_s,
        radius=of.orbit_radius_m,
    )

    def derivative(state, _):
        if cancelled():
            raise Cancelled(f"stopped at rate {rate:g}")
        return _derivative(state, constants)

    states = odeint(
        derivative,
        np.concatenate([start.velocity_m_s.ravel(), start.position_m.ravel()]),
        np.linspace(0, TURNS * turn_s, TURNS * SAMPLES_PER_TURN + 1),
        rtol=rtol,
        atol=1e-3 * rtol,
        mxstep=10**7,
    )
    position_m = states[:, 3 * of.n :].reshape(-1, of.n, 3)
    centre_m = np.average(position_m, axis=1, weights=of.mass_kg)
    distance_m = np.linalg.norm(position_m - centre_m[:, None], axis=2)
    return float(np.max(np.abs(distance_m / distance_m[0] - 1)))


@njit(cache=True)
def _derivative(state, constants):
    mass, first, second, rest, stiffness, damping, rate, radius = constants
    n = mass.size
    change = np.empty(6 * n)
    change[3 * n :] = state[: 3 * n]
    for i in range(n):
        u, v = state[3 * i], state[3 * i + 1]
        x, y, z = state[3 * (n + i)], state[3 * (n + i) + 1] + radius, state[3 * (n + i) + 2]
        gravity = MU_EARTH / (x * x + y * y + z * z) ** 1.5
        change[3 * i] = (rate**2 - gravity) * x + 2 * rate * v
        change[3 * i + 1] = (rate**2 - gravity) * y - 2 * rate * u
        change[3 * i + 2] = -gravity * z
    for j in range(rest.size):
        a, b = 3 * first[j], 3 * second[j]
        e = state[3 * n + a : 3 * n + a + 3] - state[3 * n + b : 3 * n + b + 3]
        length = math.sqrt(np.sum(e * e))
        if length > rest[j]:
            growth = np.sum(e * (state[a : a + 3] - state[b : b + 3])) / length
            tension = stiffness[j] * (length / rest[j] - 1) + damping[j] * growth
            change[a : a + 3] -= tension / length / mass[first[j]] * e
            change[b : b + 3] += tension / length / mass[second[j]] * e
    return change
