"""One implicit step: Radau IIA collocation solved by simplified Newton iteration.

Positions are eliminated (r' = v holds exactly in every stage), so each iteration solves with
matrices lambda^2 I - lambda B - A of 3x3 blocks, one real and p complex ones, A and B being the
derivatives of the acceleration by position and velocity.
"""

from collections import namedtuple

import numpy as np
from numba import njit

from tss_ros.core.model.forces import acceleration
from tss_ros.core.numerics.block_lu import factor, solve, solve_columns
from tss_ros.core.numerics.simd import kernel

#: tolerance: largest estimated local error per implicit step, scaled. accuracy: how far Newton
#: iterations converge, scaled. length [m], speed [m/s]: the scales. longest [s]: largest step.
#: kind: which steps are allowed. order N, explicit_tolerance: of explicit steps. bound: N!^(1/N),
#: the step they can bear where exp(-t) has died away.
Control = namedtuple(
    "Control", "tolerance accuracy length speed longest kind order explicit_tolerance bound"
)


#: Room for Newton's iteration: velocity and position at a stage, residuals of all, and corrections
#: as real and complex numbers.
Room = namedtuple("Room", "v r residual change twist")


@njit(cache=True, nogil=True, error_model="numpy")
def blank(stages, beads, pairs):
    """A `Room`."""
    return Room(
        np.empty((beads, 3)),
        np.empty((beads, 3)),
        np.empty((stages, beads, 3)),
        np.empty((beads, 3)),
        np.empty((pairs, beads, 3), dtype=np.complex128),
    )


@kernel
def add(y, weight, x):
    """y += weight x on flat views; plain loops compile several times faster than array sums."""
    for i in range(y.size):
        y[i] += weight * x[i]


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
def newton_matrices(symbolic, tables, h, by_r, by_v, real, cplx):
    """Assemble and factor lambda^2 I - lambda B - A for every eigenvalue lambda of the method."""
    n, entries = symbolic.order.size, symbolic.row.size
    lam = tables.real_value / h
    real[:] = 0.0
    cplx[:] = 0.0
    for e in range(entries):
        for p in range(3):
            for q in range(3):
                real[e, p, q] = -lam * by_v[e, p, q] - by_r[e, p, q]
    for i in range(n):
        for p in range(3):
            real[i, p, p] += lam * lam
    factor(symbolic, real)
    for w in range(cplx.shape[0]):
        mu = tables.value[w] / h
        for e in range(entries):
            for p in range(3):
                for q in range(3):
                    cplx[w, e, p, q] = -mu * by_v[e, p, q] - by_r[e, p, q]
        for i in range(n):
            for p in range(3):
                cplx[w, i, p, p] += mu * mu
        factor(symbolic, cplx[w])


@kernel
def _climb(tables, h, v0, z, rise):
    """Increments of position at every stage, from r' = v."""
    for j in range(tables.stages):
        for i in range(v0.shape[0]):
            for q in range(3):
                total = tables.c[j] * v0[i, q]
                for k in range(tables.stages):
                    total += tables.a[j, k] * z[k, i, q]
                rise[j, i, q] = h * total


@kernel
def solve_stages(plant, symbolic, tables, control, taut, t, h, v0, r0, z, rise, real, cplx, room):
    """Solve the stage equations by simplified Newton iteration from the guess in `z`.

    Returns the number of iterations, negative if they did not converge.
    """
    s, n, pairs = tables.stages, r0.shape[0], tables.value.size
    v, r, residual, change, twist = room
    before = np.inf
    for iteration in range(1, 16):
        _climb(tables, h, v0, z, rise)
        for j in range(s):
            for i in range(n):
                for q in range(3):
                    r[i, q] = r0[i, q] + rise[j, i, q]
                    v[i, q] = v0[i, q] + z[j, i, q]
            acceleration(plant, taut, t + tables.c[j] * h, v, r, residual[j])
            for k in range(s):
                weight = tables.a_inverse[j, k] / h
                for i in range(n):
                    for q in range(3):
                        residual[j, i, q] -= weight * z[k, i, q]
        lam = tables.real_value / h
        for i in range(n):
            for q in range(3):
                total = 0.0
                for j in range(s):
                    total += tables.real_left[j] * residual[j, i, q]
                change[i, q] = lam * total
        solve(symbolic, real, change)
        for w in range(pairs):
            mu = tables.value[w] / h
            for i in range(n):
                for q in range(3):
                    total_c = 0.0j
                    for j in range(s):
                        total_c += tables.left[w, j] * residual[j, i, q]
                    twist[w, i, q] = mu * total_c
            solve(symbolic, cplx[w], twist[w])
        size = 0.0
        for j in range(s):
            for i in range(n):
                for q in range(3):
                    d = tables.real_right[j] * change[i, q]
                    for w in range(pairs):
                        value, right = twist[w, i, q], tables.right[w, j]
                        d += 2.0 * (value.real * right.real - value.imag * right.imag)
                    z[j, i, q] += d
                    size = max(size, abs(d))
        size /= control.speed
        if not size < 1e3:
            return -iteration
        ratio = size / before
        if size <= control.accuracy and (ratio < 0.9 or size < 1e-2 * control.accuracy):
            if iteration > 1 or size < 1e-3 * control.accuracy:
                break
        elif iteration > 2 and ratio > 0.5 and size < 1e-12:
            break
        elif iteration > 3 and ratio > 0.8:
            return -iteration
        before = size
    else:
        return -15
    _climb(tables, h, v0, z, rise)
    return iteration


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def error_estimate(symbolic, tables, control, h, by_r, f0, v0, z, rise, real):
    """Largest scaled local error of columns, from the embedded formula filtered by the Jacobian.

    f0, v0 (n,3,k): derivatives of velocity and position at the start; z, rise (s,n,3,k).
    """
    b_v, b_r = f0.copy(), v0.copy()
    for j in range(tables.stages):
        weight = tables.error[j] / h
        for i in range(v0.shape[0]):
            for p in range(3):
                for c in range(v0.shape[2]):
                    b_v[i, p, c] += weight * z[j, i, p, c]
                    b_r[i, p, c] += weight * rise[j, i, p, c]
    return filtered_error(symbolic, tables, control, h, by_r, b_v, b_r, real)


@kernel
def filtered_error(symbolic, tables, control, h, by_r, b_v, b_r, real):
    """The same from the formula's sums of velocities and positions (n,3,k); b_v is overwritten."""
    lam = tables.real_value / h
    add(b_v.reshape(-1), lam - 1.0, b_v.reshape(-1))
    multiply(symbolic, by_r, b_r, b_v)
    solve_columns(symbolic, real, b_v)
    largest = 0.0
    for i in range(b_v.shape[0]):
        for p in range(3):
            for c in range(b_v.shape[2]):
                largest = max(largest, abs(b_v[i, p, c]) / control.speed)
                largest = max(largest, abs(b_v[i, p, c] + b_r[i, p, c]) / (lam * control.length))
    return largest
