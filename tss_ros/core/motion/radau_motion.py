"""One implicit step: Radau IIA collocation solved by simplified Newton iteration.

Positions are eliminated (r' = v holds exactly in every stage), so each iteration solves with
matrices lambda^2 I - lambda B - A of 3x3 blocks, one real and p complex ones, A and B being the
derivatives of the acceleration by position and velocity.
"""

import math
from typing import NamedTuple

import numpy as np

from tss_ros.core.model.forces import acceleration
from tss_ros.core.numerics.block_lu import factor, solve, solve_columns
from tss_ros.core.numerics.lane_arrays import complex_lanes, in_lanes
from tss_ros.core.numerics.loops import add
from tss_ros.core.numerics.simd import (
    WIDTH,
    allocating,
    fabs,
    inlined,
    kernel,
    load,
    splat,
    worse,
    worst,
)


class ImplicitStep(NamedTuple):
    """One implicit step: its start, and its increments at the nodes as far as they are known.

    Attributes
    ----------
    time, size : float
        [s] start t and size h.
    taut : ndarray, shape (m,), bool
    v, r : ndarray, shape (n, 3)
        Velocities [m/s] and positions [m] at the start.
    dv, dr : ndarray, shape (stages, n, 3)
        Increments of velocity and position at the nodes.
    """

    time: float
    size: float
    taut: np.ndarray
    v: np.ndarray
    r: np.ndarray
    dv: np.ndarray
    dr: np.ndarray


class Newton(NamedTuple):
    """Room for Newton's iteration.

    Stages lie side by side in G blocks of lanes, as do, in g blocks, the systems that the stages
    decouple into: see `Tables`.

    Attributes
    ----------
    matrix : ndarray, shape (g, blocks, 3, 3, 2, W)
        Factored matrices for the eigenvalues of the method.
    real : ndarray, shape (blocks, 3, 3)
        The one for the real eigenvalue once more.
    by_r, by_v : ndarray, shape (entries, 3, 3)
        Jacobian blocks A and B that the matrices are made of.
    dv, dr : ndarray, shape (G, n, 3, W)
        Increments of velocity and position at the stages.
    v, r, residual : ndarray, shape (G, n, 3, W)
        Velocities and positions there, and how far they are from the collocation equations.
    change : ndarray, shape (g, n, 3, 2, W)
        Corrections in the coordinates in which the stages decouple.
    error_v, error_r : ndarray, shape (n, 3)
        Room for the error estimate.
    """

    matrix: np.ndarray
    real: np.ndarray
    by_r: np.ndarray
    by_v: np.ndarray
    dv: np.ndarray
    dr: np.ndarray
    v: np.ndarray
    r: np.ndarray
    residual: np.ndarray
    change: np.ndarray
    error_v: np.ndarray
    error_r: np.ndarray


@allocating
def blank(symbolic, tables, beads):
    """A `Newton`."""
    blocks, entries, systems = symbolic.blocks, symbolic.row.size, tables.value.shape[0]
    stages = (tables.nodes.size // WIDTH, beads, 3, WIDTH)
    return Newton(
        np.empty((systems, blocks, 3, 3, 2, WIDTH)),
        np.empty((blocks, 3, 3)),
        np.empty((entries, 3, 3)),
        np.empty((entries, 3, 3)),
        np.zeros(stages),
        np.empty(stages),
        np.empty(stages),
        np.empty(stages),
        np.empty(stages),
        np.empty((systems, beads, 3, 2, WIDTH)),
        np.empty((beads, 3)),
        np.empty((beads, 3)),
    )


@kernel
def multiply(symbolic, blocks, x, y):
    """y += blocks @ x for x, y of shape (n, 3, k)."""
    for e in range(symbolic.row.size):
        block, xe, ye = blocks[e], x[symbolic.column[e]], y[symbolic.row[e]]
        for p in range(3):
            b0, b1, b2 = block[p, 0], block[p, 1], block[p, 2]
            for c in range(x.shape[2]):
                ye[p, c] += b0 * xe[0, c] + b1 * xe[1, c] + b2 * xe[2, c]


@kernel
def newton_matrices(symbolic, tables, size, newton):
    """Assemble and factor lambda^2 I - lambda B - A for every eigenvalue lambda of the method."""
    n, entries = symbolic.order.size, symbolic.row.size
    by_r, by_v, real, value = newton.by_r, newton.by_v, newton.real, tables.value
    zero = complex_lanes(splat(0.0), splat(0.0))
    for g in range(value.shape[0]):
        matrix = in_lanes(newton.matrix, g)
        first = load(value, 2 * WIDTH * g), load(value, 2 * WIDTH * g + WIDTH)
        lam = (1.0 / size) * complex_lanes(first[0], first[1])
        negative, square = -1.0 * lam, lam * lam
        for e in range(entries):
            for p in range(3):
                for q in range(3):
                    matrix[e, p, q] = negative * by_v[e, p, q] - by_r[e, p, q]
        for i in range(n):
            for p in range(3):
                matrix[i, p, p] += square
        for e in range(entries, symbolic.blocks):
            for p in range(3):
                for q in range(3):
                    matrix[e, p, q] = zero
        factor(symbolic, matrix)
    for e in range(symbolic.blocks):
        for p in range(3):
            for q in range(3):
                real[e, p, q] = newton.matrix[0, e, p, q, 0, 0]


@kernel
def solve_stages(arrays, symbolic, tables, settings, step, newton):
    """Solve the stage equations by simplified Newton iteration from the guess in `newton.dv`.

    Parameters
    ----------
    arrays, symbolic, tables, settings : KernelArrays, Symbolic, Tables, StepSettings
    step : ImplicitStep
        Its increments are overwritten.
    newton : Newton
        With matrices as `newton_matrices` leaves them.

    Returns
    -------
    int
        The number of iterations, negative if they did not converge.
    """
    before = last = np.inf
    for iteration in range(1, 16):
        _place_stages(tables, step, newton)
        _stage_residuals(arrays, tables, step, newton)
        _solve_decoupled(symbolic, tables, step.size, newton)
        size = _apply_correction(tables, newton) / settings.speed
        if not size < 1e3:
            return -iteration
        # Corrections may shrink by turns only, so that two of them tell the pace.
        pace = math.sqrt(size / before) if iteration > 2 else size / last
        if size <= settings.accuracy and (pace < 0.9 or size < 1e-2 * settings.accuracy):
            if iteration > 1 or size < 1e-3 * settings.accuracy:
                break
        elif iteration > 3 and pace > 0.7:
            if size < 1e-12:
                break
            return -iteration
        before, last = last, size
    else:
        return -15
    _place_stages(tables, step, newton)
    for j in range(tables.stages):
        for i in range(step.v.shape[0]):
            for q in range(3):
                step.dv[j, i, q] = newton.dv[j // WIDTH, i, q, j % WIDTH]
                step.dr[j, i, q] = newton.dr[j // WIDTH, i, q, j % WIDTH]
    return iteration


@inlined
def _product(matrix, g, x, i, q):
    """Block g of lanes of the product of a number at each stage with a matrix of `Tables`."""
    width, total = matrix.shape[1], splat(0.0)
    for block in range(x.shape[0]):
        for k in range(WIDTH):
            row = (WIDTH * block + k) * width
            total += load(matrix, row + WIDTH * g) * x[block, i, q, k]
    return total


@kernel
def _place_stages(tables, step, newton):
    """Increments of position at every stage, from r' = v, Eq. (31), and the states there."""
    for g in range(newton.dv.shape[0]):
        dv, dr = in_lanes(newton.dv, g), in_lanes(newton.dr, g)
        v, r, share = in_lanes(newton.v, g), in_lanes(newton.r, g), load(tables.nodes, WIDTH * g)
        for i in range(step.v.shape[0]):
            for q in range(3):
                total = share * step.v[i, q] + _product(tables.integral, g, newton.dv, i, q)
                total *= step.size
                dr[i, q] = total
                r[i, q] = step.r[i, q] + total
                v[i, q] = step.v[i, q] + dv[i, q]


@kernel
def _stage_residuals(arrays, tables, step, newton):
    """How far the increments are from the collocation equations, at every stage."""
    for g in range(newton.dv.shape[0]):
        v, r, residual = (
            in_lanes(newton.v, g),
            in_lanes(newton.r, g),
            in_lanes(newton.residual, g),
        )
        times = step.time + step.size * load(tables.nodes, WIDTH * g)
        acceleration(arrays, step.taut, times, v, r, residual)
        for i in range(step.v.shape[0]):
            for q in range(3):
                total = _product(tables.derivative, g, newton.dv, i, q)
                residual[i, q] -= (1.0 / step.size) * total


@kernel
def _solve_decoupled(symbolic, tables, size, newton):
    """Corrections in the coordinates in which the stages decouple."""
    residual, left = newton.residual, tables.left
    for g in range(newton.change.shape[0]):
        change = in_lanes(newton.change, g)
        for i in range(residual.shape[1]):
            for q in range(3):
                real = imag = splat(0.0)
                for block in range(residual.shape[0]):
                    for k in range(WIDTH):
                        row = 2 * WIDTH * (g * left.shape[1] + WIDTH * block + k)
                        x = residual[block, i, q, k]
                        real += load(left, row) * x
                        imag += load(left, row + WIDTH) * x
                change[i, q] = (1.0 / size) * complex_lanes(real, imag)
        solve(symbolic, in_lanes(newton.matrix, g), change)


@kernel
def _apply_correction(tables, newton):
    """Correct the velocity increments; returns the largest change [m/s]."""
    change, width, most = newton.change, tables.nodes.size, splat(0.0)
    for g in range(newton.dv.shape[0]):
        dv = in_lanes(newton.dv, g)
        for i in range(change.shape[1]):
            for q in range(3):
                total = splat(0.0)
                for block in range(change.shape[0]):
                    for part in range(2):
                        for k in range(WIDTH):
                            row = ((2 * block + part) * WIDTH + k) * width
                            weight = load(tables.right, row + WIDTH * g)
                            total += weight * change[block, i, q, part, k]
                dv[i, q] += total
                most = worse(most, fabs(total))
    return worst(most)


@kernel
def error_estimate(symbolic, tables, settings, step, newton, acceleration_at_start):
    """Largest scaled local error, from the embedded formula filtered by the Jacobian."""
    b_v, b_r, by_r = newton.error_v, newton.error_r, newton.by_r
    lam, share = tables.value[0, 0, 0] / step.size, 1.0 / step.size
    for i in range(b_v.shape[0]):
        for p in range(3):
            total_v = total_r = 0.0
            for j in range(tables.stages):
                total_v += tables.error[j] * step.dv[j, i, p]
                total_r += tables.error[j] * step.dr[j, i, p]
            b_v[i, p] = lam * (acceleration_at_start[i, p] + share * total_v)
            b_r[i, p] = step.v[i, p] + share * total_r
    for e in range(symbolic.row.size):
        row, column = symbolic.row[e], symbolic.column[e]
        x, y, z = b_r[column, 0], b_r[column, 1], b_r[column, 2]
        for p in range(3):
            b_v[row, p] += by_r[e, p, 0] * x + by_r[e, p, 1] * y + by_r[e, p, 2] * z
    solve(symbolic, newton.real, b_v)
    largest_error = 0.0
    for i in range(b_v.shape[0]):
        for p in range(3):
            scaled = _scaled(settings, lam, b_v[i, p], b_r[i, p])
            largest_error = max(largest_error, scaled)
    return largest_error


@kernel
def filtered_error(symbolic, tables, settings, size, newton, b_v, b_r):
    """The same of variations, from the formula's sums (n,3,k); b_v is overwritten."""
    lam = tables.value[0, 0, 0] / size
    for i in range(b_v.shape[0]):
        add(b_v[i], lam - 1.0, b_v[i])
    multiply(symbolic, newton.by_r, b_r, b_v)
    solve_columns(symbolic, newton.real, b_v)
    largest_error = 0.0
    for i in range(b_v.shape[0]):
        for p in range(3):
            for c in range(b_v.shape[2]):
                scaled = _scaled(settings, lam, b_v[i, p, c], b_r[i, p, c])
                largest_error = max(largest_error, scaled)
    return largest_error


@inlined
def _scaled(settings, lam, error_v, b_r):
    """Scaled error of a velocity and its position."""
    return max(abs(error_v) / settings.speed, abs(error_v + b_r) / (lam * settings.length))
