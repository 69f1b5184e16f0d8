"""The variational equations over one step, Eq. (12), along the stages of the motion."""

from typing import NamedTuple

import numpy as np

from tss_ros.core.model.forces import jacobian
from tss_ros.core.motion.radau_motion import filtered_error, multiply
from tss_ros.core.numerics.block_lu import factor_wide, solve_wide
from tss_ros.core.numerics.loops import add, assign
from tss_ros.core.numerics.simd import allocating_contracted, kernel

#: Axes whose variations are coupled: all of them, or, along a motion that stays in the orbit plane,
#: those in the plane and the one out of it apart.
COUPLED = np.array([0, 1, 2])
IN_PLANE, OUT_OF_PLANE = np.array([0, 1]), np.array([2])


class StageJacobians(NamedTuple):
    """Jacobian blocks at every stage of a step.

    Attributes
    ----------
    by_r, by_v : ndarray, shape (stages, entries, 3, 3)
        da/dr [1/s^2] and da/dv [1/s], Eq. (52).
    """

    by_r: np.ndarray
    by_v: np.ndarray


@allocating_contracted
def _stage_jacobians(arrays, symbolic, tables, step):
    """`StageJacobians` of a step."""
    shape = (tables.stages, symbolic.row.size, 3, 3)
    stages = StageJacobians(np.empty(shape), np.empty(shape))
    v, r = step.v.copy(), step.r.copy()
    for j in range(tables.stages):
        for i in range(r.shape[0]):
            for p in range(3):
                v[i, p] = step.v[i, p] + step.dv[j, i, p]
                r[i, p] = step.r[i, p] + step.dr[j, i, p]
        time = step.time + tables.c[j] * step.size
        jacobian(arrays, symbolic.pair, step.taut, time, v, r, stages.by_r[j], stages.by_v[j])
    return stages


@kernel
def _planar(step):
    """Whether a step stays in the orbit plane exactly."""
    for i in range(step.r.shape[0]):
        if step.v[i, 2] != 0.0 or step.r[i, 2] != 0.0:
            return False
        for j in range(step.dv.shape[0]):
            if step.dv[j, i, 2] != 0.0 or step.dr[j, i, 2] != 0.0:
                return False
    return True


@allocating_contracted
def _solve_stages(symbolic, tables, h, axes, stages, x_v, x_r, zx):
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
                    by_v = stages.by_v[j, e, axes[p], axes[d]]
                    by_r = stages.by_r[j, e, axes[p], axes[d]]
                    drive[j * a + p, d] = by_v + tables.c[j] * h * by_r
                    drive[j * a + p, a + d] = by_r
                    block[j * a + p, j * a + d] -= by_v
                    for q in range(s):
                        block[j * a + p, q * a + d] -= h * tables.a[j, q] * by_r
        np.dot(drive, start[symbolic.column[e]], product)
        add(right[symbolic.row[e]], 1.0, product)
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
                for c in range(k):
                    zx[i, j, axes[p], c] = right[i, j * a + p, c]


@allocating_contracted
def vary(arrays, symbolic, tables, settings, step, newton, x_v, x_r):
    """Carry variations over a step along the stages just found, Eq. (12).

    Parameters
    ----------
    arrays, symbolic, tables, settings : KernelArrays, Symbolic, Tables, StepSettings
    step : ImplicitStep
    newton : Newton
        Of that step.
    x_v, x_r : ndarray, shape (n, 3, k)
        Columns scaled like the state; advanced if the error is within the tolerance.

    Returns
    -------
    float
        The scaled error estimate.
    """
    s, n, k, h = tables.stages, step.r.shape[0], x_v.shape[2], step.size
    stages = _stage_jacobians(arrays, symbolic, tables, step)
    zx = np.zeros((n, s, 3, k))
    if _planar(step):
        _solve_stages(symbolic, tables, h, IN_PLANE, stages, x_v, x_r, zx)
        _solve_stages(symbolic, tables, h, OUT_OF_PLANE, stages, x_v, x_r, zx)
    else:
        _solve_stages(symbolic, tables, h, COUPLED, stages, x_v, x_r, zx)
    end_v, end_r = x_v.copy(), x_r.copy()
    b_v, b_r = np.zeros((n, 3, k)), x_v.copy()
    by_r, by_v = stages.by_r[0], stages.by_v[0]
    jacobian(arrays, symbolic.pair, step.taut, step.time, step.v, step.r, by_r, by_v)
    multiply(symbolic, by_r, x_r, b_v)
    multiply(symbolic, by_v, x_v, b_v)
    # r' = v holds in every stage, so the stages' sums of positions are sums of their velocities.
    for i in range(n):
        add(end_v[i], 1.0, zx[i, s - 1])
        add(end_r[i], h, x_v[i])
        add(b_r[i], tables.error_of_line, x_v[i])
        for j in range(s):
            add(end_r[i], h * tables.a[s - 1, j], zx[i, j])
            add(b_v[i], tables.error[j] / h, zx[i, j])
            add(b_r[i], tables.error_of_integral[j], zx[i, j])
    error = filtered_error(symbolic, tables, settings, h, newton, b_v, b_r)
    if error <= settings.tolerance:
        for i in range(n):
            assign(x_v[i], end_v[i])
            assign(x_r[i], end_r[i])
    return error
