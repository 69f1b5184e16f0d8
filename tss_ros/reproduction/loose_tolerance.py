"""A general-purpose integrator on Eq. (1), to see what a loose tolerance does.

scipy's LSODA, used as one uses such a solver: SI units, orbit frame, slack and taut left to the
step control. The forces are those of the core's laws; nothing else is shared with its integrators,
and nothing else in the package computes with this one.
"""

from collections.abc import Callable, Iterable

import numpy as np
from scipy.integrate import odeint

from tss_ros.core import Cancelled, System, disturbed, initial_state
from tss_ros.core.model.forces import acceleration, stretch, tensions
from tss_ros.core.model.kernel_arrays import kernel_arrays
from tss_ros.core.numerics.simd import python_allocating
from tss_ros.reproduction.claims import DISTURBANCE_M, LOST, SEED, bisect, system

TURNS, SAMPLES_PER_TURN = 8, 50


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
    turn_s = of.period_s(rate)
    arrays = kernel_arrays(of, 0.0)

    def derivative(state, _):
        if cancelled():
            raise Cancelled(f"stopped at rate {rate:g}")
        return _derivative(arrays, state)

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


@python_allocating
def _derivative(arrays, state):
    """Eq. (30): velocities and positions of all beads, in this order, to their derivatives."""
    n, m = arrays.inv_mass.size, arrays.rest.size
    v, r = state[: 3 * n].reshape(n, 3), state[3 * n :].reshape(n, 3)
    excess, growth, pull = np.empty(m), np.empty(m), np.empty(m)
    stretch(arrays, 0.0, v, r, excess, growth)
    tensions(arrays, 0.0, v, r, pull)
    change = np.empty(6 * n)
    acts = (excess > 0.0) & (arrays.pushes | (pull > 0.0))
    acceleration(arrays, acts, 0.0, v, r, change[: 3 * n].reshape(n, 3))
    change[3 * n :] = state[: 3 * n]
    return change
