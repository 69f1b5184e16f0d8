"""The variational equations over one step, Eq. (12), along the stages of the motion."""

import numpy as np
from numba import njit

from tss_ros.core.model.forces import jacobian
from tss_ros.core.motion.radau_motion import add, filtered_error, multiply
from tss_ros.core.numerics.block_lu import factor_wide, solve_wide

#: Axes whose variations are coupled: all of them, or, along a motion that stays in the orbit plane,
#: those in the plane and the one out of it apart.
COUPLED = np.array([0, 1, 2])
IN_PLANE, OUT_OF_PLANE = np.array([0, 1]), np.array([2])


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _stage_jacobians(plant, symbolic, tables, taut, t, h, v0, r0, z, rise, stage_r, stage_v):
    """Jacobian blocks at every stage of a step."""
    v, r = v0.copy(), r0.copy()
    for j in range(tables.stages):
        for i in range(r.shape[0]):
            for p in range(3):
                v[i, p] = v0[i, p] + z[j, i, p]
                r[i, p] = r0[i, p] + rise[j, i, p]
        jacobian(plant, symbolic.pair, taut, t + tables.c[j] * h, v, r, stage_r[j], stage_v[j])


@njit(cache=True, nogil=True, error_model="numpy")
def _planar(v0, r0, z, rise):
    """Whether a step stays in the orbit plane exactly."""
    for i in range(r0.shape[0]):
        if v0[i, 2] != 0.0 or r0[i, 2] != 0.0:
            return False
        for j in range(z.shape[0]):
            if z[j, i, 2] != 0.0 or rise[j, i, 2] != 0.0:
                return False
    return True


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _solve_stages(symbolic, tables, h, axes, stage_r, stage_v, x_v, x_r, zx):
    """Stage increments of the variations along some axes: one linear system for all stages.

    The unknowns of a bead at all stages make one block, so that the system has the tether graph's
    pattern and is factored in time proportional to the number of beads.
    """
    s, n, k, a = tables.stages, x_v.shape[0], x_v.shape[2], axes.size
    start = np.empty((n, 2 * a, k))
    largest = 0.0
    for i in range(n):
        for p in range(a):
            for c in range(k):
                start[i, p, c] = x_v[i, axes[p], c]
                start[i, a + p, c] = x_r[i, axes[p], c]
                largest = max(largest, max(abs(start[i, p, c]), abs(start[i, a + p, c])))
    if largest == 0.0:
        return
    matrix = np.zeros((symbolic.blocks, s * a, s * a))
    right = np.zeros((n, s * a, k))
    drive, product = np.empty((s * a, 2 * a)), np.empty((s * a, k))
    for e in range(symbolic.row.size):
        block = matrix[e]
        for j in range(s):
            for p in range(a):
                for d in range(a):
                    by_v = stage_v[j, e, axes[p], axes[d]]
                    by_r = stage_r[j, e, axes[p], axes[d]]
                    drive[j * a + p, d] = by_v + tables.c[j] * h * by_r
                    drive[j * a + p, a + d] = by_r
                    block[j * a + p, j * a + d] -= by_v
                    for q in range(s):
                        block[j * a + p, q * a + d] -= h * tables.a[j, q] * by_r
        np.dot(drive, start[symbolic.column[e]], product)
        add(right[symbolic.row[e]].reshape(-1), 1.0, product.reshape(-1))
    for i in range(n):
        for j in range(s):
            for q in range(s):
                for p in range(a):
                    matrix[i, j * a + p, q * a + p] += tables.a_inverse[j, q] / h
    factor_wide(symbolic, matrix)
    solve_wide(symbolic, matrix, right)
    for i in range(n):
        for j in range(s):
            for p in range(a):
                zx[i, j, axes[p]] = right[i, j * a + p]


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def vary(plant, symbolic, tables, control, taut, t, h, v0, r0, z, rise, by_r, real, x_v, x_r):
    """Carry the variations over a step along the stages just found, Eq. (12).

    Returns the scaled error estimate; x_v, x_r are advanced if it is within the tolerance.
    Columns are taken to be scaled like the state.
    """
    s, n, k = tables.stages, r0.shape[0], x_v.shape[2]
    stage_r = np.empty((s, by_r.shape[0], 3, 3))
    stage_v = np.empty((s, by_r.shape[0], 3, 3))
    _stage_jacobians(plant, symbolic, tables, taut, t, h, v0, r0, z, rise, stage_r, stage_v)
    zx = np.zeros((n, s, 3, k))
    if _planar(v0, r0, z, rise):
        _solve_stages(symbolic, tables, h, IN_PLANE, stage_r, stage_v, x_v, x_r, zx)
        _solve_stages(symbolic, tables, h, OUT_OF_PLANE, stage_r, stage_v, x_v, x_r, zx)
    else:
        _solve_stages(symbolic, tables, h, COUPLED, stage_r, stage_v, x_v, x_r, zx)
    end_v, end_r = x_v.copy(), x_r.copy()
    b_v, b_r = np.zeros((n, 3, k)), x_v.copy()
    jacobian(plant, symbolic.pair, taut, t, v0, r0, stage_r[0], stage_v[0])
    multiply(symbolic, stage_r[0], x_r, b_v)
    multiply(symbolic, stage_v[0], x_v, b_v)
    # r' = v holds in every stage, so the stages' sums of positions are sums of their velocities.
    weight = tables.error @ tables.a
    for i in range(n):
        add(end_v[i].reshape(-1), 1.0, zx[i, s - 1].reshape(-1))
        add(end_r[i].reshape(-1), h, x_v[i].reshape(-1))
        add(b_r[i].reshape(-1), tables.error @ tables.c, x_v[i].reshape(-1))
        for j in range(s):
            add(end_r[i].reshape(-1), h * tables.a[s - 1, j], zx[i, j].reshape(-1))
            add(b_v[i].reshape(-1), tables.error[j] / h, zx[i, j].reshape(-1))
            add(b_r[i].reshape(-1), weight[j], zx[i, j].reshape(-1))
    error = filtered_error(symbolic, tables, control, h, by_r, b_v, b_r, real)
    if error <= control.tolerance:
        x_v[:] = end_v
        x_r[:] = end_r
    return error
