"""One implicit step: Radau IIA collocation solved by simplified Newton iteration.

Positions are eliminated (r' = v holds exactly in every stage), so each iteration solves with
matrices lambda^2 I - lambda B - A of 3x3 blocks, one real and p complex ones, A and B being the
derivatives of the acceleration by position and velocity.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from tss_ros.core.model.forces import acceleration
from tss_ros.core.numerics.block_lu import factor, solve, solve_columns
from tss_ros.core.numerics.loops import add
from tss_ros.core.numerics.simd import kernel


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

    Attributes
    ----------
    real, complex : ndarray, shape (blocks, 3, 3) and (p, blocks, 3, 3)
        Factored matrices for the real eigenvalue of the method and the p complex ones.
    by_r, by_v : ndarray, shape (entries, 3, 3)
        Jacobian blocks A and B that the matrices are made of.
    v, r : ndarray, shape (n, 3)
        Velocity and position at a stage.
    residual : ndarray, shape (stages, n, 3)
    change, complex_change : ndarray, shape (n, 3) and (p, n, 3)
        Corrections in the coordinates in which the stages decouple.
    """

    real: np.ndarray
    complex: np.ndarray
    by_r: np.ndarray
    by_v: np.ndarray
    v: np.ndarray
    r: np.ndarray
    residual: np.ndarray
    change: np.ndarray
    complex_change: np.ndarray


@njit(cache=True, nogil=True, error_model="numpy")
def blank(symbolic, tables, beads):
    """A `Newton`."""
    entries, pairs = symbolic.row.size, tables.value.size
    return Newton(
        np.empty((symbolic.blocks, 3, 3)),
        np.empty((pairs, symbolic.blocks, 3, 3), dtype=np.complex128),
        np.empty((entries, 3, 3)),
        np.empty((entries, 3, 3)),
        np.empty((beads, 3)),
        np.empty((beads, 3)),
        np.empty((tables.stages, beads, 3)),
        np.empty((beads, 3)),
        np.empty((pairs, beads, 3), dtype=np.complex128),
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
    by_r, by_v, real = newton.by_r, newton.by_v, newton.real
    lam = tables.real_value / size
    real[:] = 0.0
    newton.complex[:] = 0.0
    for e in range(entries):
        for p in range(3):
            for q in range(3):
                real[e, p, q] = -lam * by_v[e, p, q] - by_r[e, p, q]
    for i in range(n):
        for p in range(3):
            real[i, p, p] += lam * lam
    factor(symbolic, real)
    for w in range(newton.complex.shape[0]):
        mu, matrix = tables.value[w] / size, newton.complex[w]
        for e in range(entries):
            for p in range(3):
                for q in range(3):
                    matrix[e, p, q] = -mu * by_v[e, p, q] - by_r[e, p, q]
        for i in range(n):
            for p in range(3):
                matrix[i, p, p] += mu * mu
        factor(symbolic, matrix)


@kernel
def _integrate_velocities(tables, step):
    """Increments of position at every stage, from r' = v, Eq. (31)."""
    for j in range(tables.stages):
        for i in range(step.v.shape[0]):
            for q in range(3):
                total = tables.c[j] * step.v[i, q]
                for k in range(tables.stages):
                    total += tables.a[j, k] * step.dv[k, i, q]
                step.dr[j, i, q] = step.size * total


@kernel
def solve_stages(arrays, symbolic, tables, settings, step, newton):
    """Solve the stage equations by simplified Newton iteration from the guess in `step.dv`.

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
    before = np.inf
    for iteration in range(1, 16):
        _integrate_velocities(tables, step)
        _stage_residuals(arrays, tables, step, newton)
        _solve_decoupled(symbolic, tables, step.size, newton)
        size = _apply_correction(tables, step, newton) / settings.speed
        if not size < 1e3:
            return -iteration
        ratio = size / before
        if size <= settings.accuracy and (ratio < 0.9 or size < 1e-2 * settings.accuracy):
            if iteration > 1 or size < 1e-3 * settings.accuracy:
                break
        elif iteration > 2 and ratio > 0.5 and size < 1e-12:
            break
        elif iteration > 3 and ratio > 0.8:
            return -iteration
        before = size
    else:
        return -15
    _integrate_velocities(tables, step)
    return iteration


@kernel
def _stage_residuals(arrays, tables, step, newton):
    """How far the increments are from the collocation equations, at every stage."""
    v, r, residual = newton.v, newton.r, newton.residual
    for j in range(tables.stages):
        for i in range(r.shape[0]):
            for q in range(3):
                r[i, q] = step.r[i, q] + step.dr[j, i, q]
                v[i, q] = step.v[i, q] + step.dv[j, i, q]
        acceleration(arrays, step.taut, step.time + tables.c[j] * step.size, v, r, residual[j])
        for k in range(tables.stages):
            weight = tables.a_inverse[j, k] / step.size
            for i in range(r.shape[0]):
                for q in range(3):
                    residual[j, i, q] -= weight * step.dv[k, i, q]


@kernel
def _solve_decoupled(symbolic, tables, size, newton):
    """Corrections in the coordinates in which the stages decouple, one real and p complex."""
    residual, change = newton.residual, newton.change
    lam = tables.real_value / size
    for i in range(change.shape[0]):
        for q in range(3):
            total = 0.0
            for j in range(tables.stages):
                total += tables.real_left[j] * residual[j, i, q]
            change[i, q] = lam * total
    solve(symbolic, newton.real, change)
    for w in range(tables.value.size):
        mu, complex_change = tables.value[w] / size, newton.complex_change[w]
        for i in range(change.shape[0]):
            for q in range(3):
                total_c = 0.0j
                for j in range(tables.stages):
                    total_c += tables.left[w, j] * residual[j, i, q]
                complex_change[i, q] = mu * total_c
        solve(symbolic, newton.complex[w], complex_change)


@kernel
def _apply_correction(tables, step, newton):
    """Correct the velocity increments; returns the largest change [m/s]."""
    size = 0.0
    for j in range(tables.stages):
        for i in range(step.v.shape[0]):
            for q in range(3):
                d = tables.real_right[j] * newton.change[i, q]
                for w in range(tables.value.size):
                    value, right = newton.complex_change[w, i, q], tables.right[w, j]
                    d += 2.0 * (value.real * right.real - value.imag * right.imag)
                step.dv[j, i, q] += d
                size = max(size, abs(d))
    return size


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def error_estimate(symbolic, tables, settings, step, newton, acceleration_at_start):
    """Largest scaled local error, from the embedded formula filtered by the Jacobian."""
    n = step.v.shape[0]
    b_v, b_r = acceleration_at_start.copy(), step.v.copy()
    for j in range(tables.stages):
        weight = tables.error[j] / step.size
        for i in range(n):
            for p in range(3):
                b_v[i, p] += weight * step.dv[j, i, p]
                b_r[i, p] += weight * step.dr[j, i, p]
    return filtered_error(
        symbolic, tables, settings, step.size, newton, b_v.reshape(n, 3, 1), b_r.reshape(n, 3, 1)
    )


@kernel
def filtered_error(symbolic, tables, settings, size, newton, b_v, b_r):
    """The same from the formula's sums of velocities and positions (n,3,k); b_v is overwritten."""
    lam = tables.real_value / size
    for i in range(b_v.shape[0]):
        add(b_v[i], lam - 1.0, b_v[i])
    multiply(symbolic, newton.by_r, b_r, b_v)
    solve_columns(symbolic, newton.real, b_v)
    largest = 0.0
    for i in range(b_v.shape[0]):
        for p in range(3):
            for c in range(b_v.shape[2]):
                largest = max(largest, abs(b_v[i, p, c]) / settings.speed)
                largest = max(largest, abs(b_v[i, p, c] + b_r[i, p, c]) / (lam * settings.length))
    return largest
