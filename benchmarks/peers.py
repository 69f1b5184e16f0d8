"""Public solvers of stiff and non-stiff motions: scipy, CVODE (scikit-sundae) and CyRK."""

import functools

import numpy as np
from numba import njit
from scipy import sparse

from tss_ros.core.model import forces
from tss_ros.core.model.kernel_arrays import kernel_arrays
from tss_ros.core.numerics import block_lu

#: A switch that is located must leave its tether this near to its rest length, relative.
ON_EDGE = 1e-7


class Compiled:
    """The equations of a problem as compiled functions of time and state (6n,), velocities first.

    In the turning frame.

    Parameters
    ----------
    problem : Problem

    Attributes
    ----------
    derivative : f(t, x, taut, out)
    stretch : f(x, excess, growth)
    by_length : f(x, taut)
        Sets `taut` from the lengths, as those do who locate no switches.
    jacobian : f(t, x, taut, values)
        Nonzero values in the order of `rows`, `columns`.
    right_hand_side : f(out, t, x, taut)
        Both `by_length` and `derivative`.
    """

    def __init__(self, problem):
        if problem.reference:
            arrays = problem.reference.arrays(problem.turning_rate)
            if not problem.reference.repeats:
                arrays = problem.reference.with_table(arrays, 0.0, problem.end_s)
        else:
            arrays = kernel_arrays(problem.system, problem.turning_rate)
        n, size = problem.n, 3 * problem.n
        acceleration, stretch, jacobian = forces.acceleration, forces.stretch, forces.jacobian
        symbolic = block_lu.analyse(n, problem.system.tether_ends)
        blocks = n + 2 * problem.system.m
        row, column, pair = symbolic.row[:blocks], symbolic.column[:blocks], symbolic.pair
        inner = np.arange(3)
        block_rows = 3 * row[:, None, None] + inner[:, None] + np.zeros((3, 3), dtype=int)
        block_columns = 3 * column[:, None, None] + inner + np.zeros((3, 3), dtype=int)
        self.rows = np.concatenate([block_rows.ravel(), block_rows.ravel(), size + np.arange(size)])
        self.columns = np.concatenate(
            [block_columns.ravel(), size + block_columns.ravel(), np.arange(size)]
        )

        @njit(error_model="numpy")
        def derivative(t, x, taut, out):
            acceleration(
                arrays,
                taut,
                t,
                x[:size].reshape(n, 3),
                x[size:].reshape(n, 3),
                out[:size].reshape(n, 3),
            )
            out[size:] = x[:size]

        @njit(error_model="numpy")
        def lengths(x, excess, growth):
            stretch(arrays, 0.0, x[:size].reshape(n, 3), x[size:].reshape(n, 3), excess, growth)

        @njit(error_model="numpy")
        def by_length(x, taut):
            excess, growth = np.empty(taut.size), np.empty(taut.size)
            lengths(x, excess, growth)
            for k in range(taut.size):
                taut[k] = excess[k] > 0.0

        @njit(error_model="numpy")
        def values(t, x, taut, out):
            by_r, by_v = np.empty((row.size, 3, 3)), np.empty((row.size, 3, 3))
            jacobian(
                arrays, pair, taut, t, x[:size].reshape(n, 3), x[size:].reshape(n, 3), by_r, by_v
            )
            out[: by_v.size] = by_v.reshape(-1)
            out[by_v.size : 2 * by_v.size] = by_r.reshape(-1)
            out[2 * by_v.size :] = 1.0

        @njit(error_model="numpy")
        def right_hand_side(out, t, x, taut):
            by_length(x, taut)
            derivative(t, x, taut, out)

        self.right_hand_side = right_hand_side
        self.derivative, self.stretch = derivative, lengths
        self.by_length, self.jacobian = by_length, values

    def matrix(self, values, kind="dense"):
        """The Jacobian (6n, 6n) made of its nonzero values."""
        size = 2 * (self.rows.max() + 1) // 2
        matrix = sparse.csc_matrix((values, (self.rows, self.columns)), shape=(size, size))
        return matrix if kind == "sparse" else matrix.toarray()


@functools.cache
def compiled(problem):
    """The equations, compiled once for all tolerances."""
    return Compiled(problem)


def scipy_compiled(problem, tolerance, method):
    """solve_ivp in the turning frame with compiled equations, and Jacobian where it is used."""
    from scipy.integrate import solve_ivp

    equations, units = compiled(problem), problem.units()
    taut, values = problem.taut(), np.empty(equations.rows.size)

    def right_hand_side(t, x):
        out = np.empty(x.size)
        equations.right_hand_side(out, t, x, taut)
        return out

    def jacobian(t, x):
        equations.by_length(x, taut)
        equations.jacobian(t, x, taut, values)
        return equations.matrix(values, "dense" if problem.n < 20 else "sparse")

    given = {"jac": jacobian} if method == "Radau" else {}

    def run():
        solution = solve_ivp(
            right_hand_side,
            (0.0, problem.end_s),
            problem.turning(),
            method,
            rtol=max(tolerance, 3e-14),
            atol=tolerance * units,
            t_eval=[problem.end_s],
            **given,
        )
        if solution.status < 0:
            raise RuntimeError(solution.message)
        return problem.from_turning(solution.y[:, -1])

    return run


def scipy_numpy(problem, tolerance, method):
    """solve_ivp as a user writes it first: orbit frame, numpy, tethers switched by their length."""
    from scipy.integrate import solve_ivp

    s, n = problem.system, problem.n
    first, second = s.tether_ends.T
    rate, radius = s.orbit_rate_rad_s, s.orbit_radius_m
    mu = rate**2 * radius**3

    def right_hand_side(t, x):
        v, r = x.reshape(2, n, 3)
        away = r + np.array([0.0, radius, 0.0])
        a = -mu * away / np.linalg.norm(away, axis=1)[:, None] ** 3
        a[:, 0] += rate**2 * r[:, 0] + 2.0 * rate * v[:, 1]
        a[:, 1] += rate**2 * away[:, 1] - 2.0 * rate * v[:, 0]
        d = r[first] - r[second]
        length = np.linalg.norm(d, axis=1)
        growth = np.sum(d * (v[first] - v[second]), axis=1) / length
        tension = s.axial_stiffness_n * (length / s.rest_length_m - 1.0)
        tension = (tension + s.damping_n_s_per_m * growth) * (length > s.rest_length_m)
        pull = (tension / length)[:, None] * d
        np.subtract.at(a, first, pull / s.mass_kg[first][:, None])
        np.add.at(a, second, pull / s.mass_kg[second][:, None])
        return np.concatenate([a.ravel(), x[: 3 * n]])

    def run():
        solution = solve_ivp(
            right_hand_side,
            (0.0, problem.end_s),
            problem.orbit(),
            method,
            rtol=max(tolerance, 3e-14),
            atol=tolerance * problem.units(),
            t_eval=[problem.end_s],
        )
        return problem.from_orbit(solution.y[:, -1])

    return run


def cyrk(problem, tolerance, method):
    """CyRK in the turning frame with compiled equations."""
    from CyRK import pysolve_ivp

    equations, units = compiled(problem), problem.units()
    taut = problem.taut()

    def right_hand_side(out, t, x):
        equations.right_hand_side(out, t, x, taut)

    def run():
        solution = pysolve_ivp(
            right_hand_side,
            (0.0, problem.end_s),
            problem.turning(),
            method=method,
            rtol=tolerance,
            atol=tolerance * units,
            pass_dy_as_arg=True,
            max_num_steps=100_000_000,
        )
        if not solution.success:
            raise RuntimeError(solution.message)
        return problem.from_turning(solution.y[:, -1])

    return run


def cvode(problem, tolerance, method="BDF"):
    """CVODE in the turning frame, compiled equations and Jacobian, switches located and held."""
    from sksundae.cvode import CVODE

    equations, units = compiled(problem), problem.units()
    taut = problem.taut()
    m, rest = problem.system.m, problem.system.rest_length_m
    growth, excess = np.empty((2, m))
    values = np.empty(equations.rows.size)
    large = problem.n >= 20
    if large:
        pattern = equations.matrix(np.ones(values.size), "sparse")
        pattern.data[:] = np.arange(pattern.nnz)
        order = np.asarray(pattern[equations.rows, equations.columns]).ravel().astype(int)
        pattern.data[:] = 1.0

    def right_hand_side(t, x, out):
        equations.derivative(t, x, taut, out)

    def jacobian(t, x, derivative, out):
        equations.jacobian(t, x, taut, values)
        if large:
            out[order] = values
        else:
            out[equations.rows, equations.columns] = values

    def lengths(t, x, events):
        equations.stretch(x, events, growth)

    lengths.terminal = [True] * m
    given = {"linsolver": "sparse", "sparsity": pattern} if large else {}
    solver = CVODE(
        right_hand_side,
        rtol=tolerance,
        atol=tolerance * units,
        method=method,
        eventsfn=lengths,
        num_events=m,
        max_num_steps=10_000_000,
        jacfn=jacobian,
        **given,
    )

    def run():
        taut[:] = problem.taut()
        now, x, run.switches = 0.0, problem.turning(), 0
        while now < problem.end_s:
            middle = 0.5 * (now + problem.end_s)  # with two times every step would be kept
            solution = solver.solve(np.array([now, middle, problem.end_s]), x)
            if solution.status < 0:
                raise RuntimeError(solution.message)
            now, x = solution.t[-1], np.array(solution.y[-1])
            equations.stretch(x, excess, growth)
            edge = np.abs(excess) <= ON_EDGE * rest
            run.switches += int(np.count_nonzero(edge & (taut != (growth > 0.0))))
            taut[edge] = growth[edge] > 0.0
        return problem.from_turning(x)

    return run
