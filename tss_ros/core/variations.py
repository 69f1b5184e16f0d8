"""The variational equations over one step, Eq. (12), along the stages of the motion."""

import numpy as np
from numba import njit

from tss_ros.core.blocklu import solve_columns
from tss_ros.core.forces import jacobian
from tss_ros.core.radau import add, error_estimate, multiply

#: Largest linear system solved densely for the variations of one step.
DENSE_SIZE = 400


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _stage_jacobians(plant, symbolic, tables, taut, t, h, v0, r0, z, rise, stage_r, stage_v):
    """Jacobian blocks at every stage of a step."""
    v, r = v0.copy(), r0.copy()
    for j in range(tables.stages):
        for i in range(r.shape[0]):
            for p in range(3):
                v[i, p] = v0[i, p] + z[j, i, p]
                r[i, p] = r0[i, p] + rise[j, i, p]
        jacobian(
            plant, symbolic.pair, taut, t + tables.c[j] * h, v, r, stage_r[j], stage_v[j]
        )


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _solve_stages_directly(symbolic, tables, h, stage_r, stage_v, x_v, x_r, zx):
    """Stage increments of the variations from one dense linear system; for few beads."""
    s, n, k = tables.stages, x_v.shape[0], x_v.shape[2]
    size = 3 * n
    matrix = np.zeros((s * size, s * size))
    right = np.zeros((s, n, 3, k))
    place = np.empty((n, 3, k))
    for j in range(s):
        for q in range(s):
            for i in range(size):
                matrix[j * size + i, q * size + i] = tables.a_inverse[j, q] / h
        for e in range(symbolic.row.size):
            row, column = j * size + 3 * symbolic.row[e], 3 * symbolic.column[e]
            for p in range(3):
                for d in range(3):
                    matrix[row + p, j * size + column + d] -= stage_v[j, e, p, d]
                    for q in range(s):
                        matrix[row + p, q * size + column + d] -= (
                            h * tables.a[j, q] * stage_r[j, e, p, d]
                        )
        multiply(symbolic, stage_v[j], x_v, right[j])
        place[:] = x_r
        add(place.reshape(-1), tables.c[j] * h, x_v.reshape(-1))
        multiply(symbolic, stage_r[j], place, right[j])
    zx.reshape(s * size, k)[:] = np.linalg.solve(matrix, right.reshape(s * size, k))


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _solve_stages_by_iteration(
    symbolic, tables, control, h, stage_r, stage_v, real, cplx, x_v, x_r, zx
):
    """The same by simplified Newton iteration, with the motion's factors; for many beads.

    Returns False if it did not converge.
    """
    s, n, k, pairs = tables.stages, x_v.shape[0], x_v.shape[2], tables.value.size
    residual = np.empty((n, 3, k))
    total = np.empty((n, 3, k))
    real_sum = np.empty((n, 3, k))
    twist = np.empty((pairs, n, 3, k), dtype=np.complex128)
    lam = tables.real_value / h
    before = np.inf
    for _ in range(40):
        real_sum[:] = 0.0
        twist[:] = 0.0
        for j in range(s):
            residual[:] = 0.0
            total[:] = x_r
            add(total.reshape(-1), tables.c[j] * h, x_v.reshape(-1))
            for q in range(s):
                add(total.reshape(-1), h * tables.a[j, q], zx[q].reshape(-1))
                add(residual.reshape(-1), -tables.a_inverse[j, q] / h, zx[q].reshape(-1))
            multiply(symbolic, stage_r[j], total, residual)
            total[:] = x_v
            add(total.reshape(-1), 1.0, zx[j].reshape(-1))
            multiply(symbolic, stage_v[j], total, residual)
            add(real_sum.reshape(-1), lam * tables.real_left[j], residual.reshape(-1))
            for w in range(pairs):
                add(
                    twist[w].reshape(-1), tables.value[w] / h * tables.left[w, j],
                    residual.reshape(-1),
                )
        solve_columns(symbolic, real, real_sum)
        for w in range(pairs):
            solve_columns(symbolic, cplx[w], twist[w])
        size, largest = 0.0, control.speed
        for j in range(s):
            for i in range(n):
                for p in range(3):
                    for c in range(k):
                        change = tables.real_right[j] * real_sum[i, p, c]
                        for w in range(pairs):
                            value, right = twist[w, i, p, c], tables.right[w, j]
                            change += 2.0 * (value.real * right.real - value.imag * right.imag)
                        zx[j, i, p, c] += change
                        size = max(size, abs(change))
                        largest = max(largest, abs(zx[j, i, p, c]))
        if size <= control.accuracy * largest or (size > 0.3 * before and size < 1e-11 * largest):
            return True
        before = size
    return False


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def vary(
    plant, symbolic, tables, control, taut, t, h, v0, r0, z, rise, by_r, real, cplx, x_v, x_r
):
    """Carry the variations over a step along the stages just found, Eq. (12).

    Returns the scaled error estimate; x_v, x_r are advanced if it is within the tolerance.
    Columns are taken to be scaled like the state.
    """
    s, n, k = tables.stages, r0.shape[0], x_v.shape[2]
    stage_r = np.empty((s, by_r.shape[0], 3, 3))
    stage_v = np.empty((s, by_r.shape[0], 3, 3))
    _stage_jacobians(plant, symbolic, tables, taut, t, h, v0, r0, z, rise, stage_r, stage_v)
    zx = np.zeros((s, n, 3, k))
    if 3 * n * s <= DENSE_SIZE:
        _solve_stages_directly(symbolic, tables, h, stage_r, stage_v, x_v, x_r, zx)
    elif not _solve_stages_by_iteration(
        symbolic, tables, control, h, stage_r, stage_v, real, cplx, x_v, x_r, zx
    ):
        return np.inf
    rx = np.zeros((s, n, 3, k))
    for j in range(s):
        add(rx[j].reshape(-1), tables.c[j] * h, x_v.reshape(-1))
        for q in range(s):
            add(rx[j].reshape(-1), h * tables.a[j, q], zx[q].reshape(-1))
    f0 = np.zeros((n, 3, k))
    jacobian(plant, symbolic.pair, taut, t, v0, r0, stage_r[0], stage_v[0])
    multiply(symbolic, stage_r[0], x_r, f0)
    multiply(symbolic, stage_v[0], x_v, f0)
    error = error_estimate(symbolic, tables, control, h, by_r, f0, x_v, zx, rx, real)
    if error <= control.tolerance:
        add(x_v.reshape(-1), 1.0, zx[s - 1].reshape(-1))
        add(x_r.reshape(-1), 1.0, rx[s - 1].reshape(-1))
    return error
