"""Monodromy matrices by scipy on the augmented system, and by finite differences of any motion."""

import copy
import functools

import numpy as np
from numba import njit

from benchmarks.peers import compiled
from tss_ros.core import State


@functools.cache
def _augmented_equations(problem):
    equations, size = compiled(problem), 6 * problem.n
    derivative, by_length, jacobian = equations.derivative, equations.by_length, equations.jacobian
    rows, columns = equations.rows, equations.columns
    m, count = problem.system.m, equations.rows.size

    @njit(error_model="numpy")
    def right_hand_side(t, y):
        out = np.zeros(y.size)
        taut, values = np.empty(m, dtype=np.bool_), np.empty(count)
        by_length(y[:size], taut)
        derivative(t, y[:size], taut, out[:size])
        jacobian(t, y[:size], taut, values)
        x, rate = y[size:].reshape(size, size), out[size:].reshape(size, size)
        for e in range(count):
            for c in range(size):
                rate[rows[e], c] += values[e] * x[columns[e], c]
        return out

    return right_hand_side


def augmented(problem, tolerance, method):
    """solve_ivp of motion and variations, compiled, turning frame; no saltation at switches.

    Radau takes the block-diagonal Jacobian of the variations for all of it.
    """
    from scipy.integrate import solve_ivp
    from scipy.sparse import block_diag, csc_matrix

    equations, units, size = compiled(problem), problem.units(), 6 * problem.n
    right_hand_side, m = _augmented_equations(problem), problem.system.m
    count = equations.rows.size

    def block_jacobian(t, y):
        taut, values = np.empty(m, dtype=bool), np.empty(count)
        equations.by_length(y[:size], taut)
        equations.jacobian(t, y[:size], taut, values)
        block = equations.matrix(values)
        spread = np.kron(block, np.eye(size))
        return csc_matrix(block_diag([block, spread]))

    start = np.concatenate([problem.turning(), np.diag(units).ravel()])
    scale = np.concatenate([units, np.repeat(units, size)])
    given = {"jac": block_jacobian} if method == "Radau" else {}

    def run():
        solution = solve_ivp(
            right_hand_side,
            (0.0, problem.end_s),
            start,
            method,
            rtol=max(tolerance, 3e-14),
            atol=tolerance * scale,
            t_eval=[problem.end_s],
            **given,
        )
        if solution.status < 0:
            raise RuntimeError(solution.message)
        return solution.y[size:, -1].reshape(size, size) / units[:, None]

    return run


def differences(problem, tolerance, motion, step=1e-5, **options):
    """Central differences of a motion's end, one pair of runs for every coordinate.

    Parameters
    ----------
    motion : callable
        Makes the run of a problem, as for the motions.
    step : float
        Displacement, relative to the radius and the rim speed.
    """
    displaced = copy.copy(problem)
    one = motion(displaced, tolerance, **options)
    start, units = problem.orbit(), problem.units()

    def end(k, change):
        x = start.copy()
        x[k] += change * units[k]
        v, r = x.reshape(2, -1, 3)
        displaced.start = State(r, v)
        r, v = one()
        return np.concatenate([v.ravel(), r.ravel()])

    def run():
        columns = [(end(k, step) - end(k, -step)) / (2.0 * step) for k in range(units.size)]
        return problem.scaled(np.transpose(columns) / units, "orbit")

    return run
