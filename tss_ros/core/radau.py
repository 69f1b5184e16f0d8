"""Implicit integration of the motion and its variations, with slack/taut switches as events.

A Radau IIA collocation step is solved by simplified Newton iteration. Positions are eliminated
(r' = v holds exactly in every stage), so each iteration solves with matrices
lambda^2 I - lambda B - A of 3x3 blocks, one real and p complex ones. Within a step every tether
keeps its switch s of Eq. (5); the collocation polynomial of each tether's stretch is searched for
zeros, none of which can hide between sampling points, and the step is cut to end on the first.
"""

import math
from collections import namedtuple

import numpy as np
from numba import njit

from tss_ros.core.blocklu import factor, solve, solve_columns
from tss_ros.core.forces import acceleration, jacobian, stretch

#: Largest linear system solved densely for the variations of one step.
DENSE_SIZE = 400

REACHED, PAUSED, STEP_TOO_SMALL, TOO_MANY_SWITCHES = range(4)

#: tolerance: largest estimated local error per step, scaled. accuracy: how far Newton iterations
#: converge, scaled. length [m], speed [m/s]: the scales. longest [s]: largest step.
Control = namedtuple("Control", "tolerance accuracy length speed longest")

#: What `advance` carries from call to call. time (4,): now, next step size, start and size of the
#: step `z` and `rise` describe. count (5,): accepted steps, rejected steps, Newton iterations,
#: switches, sampled times. taut (m,). v, r (n,3): state now. v0, r0 (n,3), z, rise (s,n,3): start
#: of the last step and the increments of velocity and position at its nodes. x_v, x_r (n,3,k):
#: variations of velocity and position, k may be 0. dissipation (1,): integral of the trace of the
#: damping matrix over time.
Motion = namedtuple(
    "Motion", "time count taut v r v0 r0 z rise x_v x_r dissipation"
)


def begin(plant, tables, v, r, columns, first_step):
    """Start a `Motion` at time 0 from velocities and positions in the turning frame.

    Parameters
    ----------
    plant : forces.Plant
    tables : collocation.Tables
    v, r : ndarray, shape (n, 3)
    columns : int
        Number k of variation columns; the arrays start at zero.
    first_step : float
        [s] first step size to try.

    Returns
    -------
    Motion
    """
    n, m, s = r.shape[0], plant.rest.size, tables.stages
    excess, growth = np.empty(m), np.empty(m)
    stretch(plant, v, r, excess, growth)
    taut = (excess > 0.0) | ((excess == 0.0) & (growth > 0.0)) | plant.bilateral
    return Motion(
        np.array([0.0, first_step, 0.0, 0.0]),
        np.zeros(5, dtype=np.int64),
        taut,
        np.array(v, dtype=float),
        np.array(r, dtype=float),
        np.array(v, dtype=float),
        np.array(r, dtype=float),
        np.zeros((s, n, 3)),
        np.zeros((s, n, 3)),
        np.zeros((n, 3, columns)),
        np.zeros((n, 3, columns)),
        np.zeros(1),
    )


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _multiply(symbolic, blocks, x, y):
    """y += blocks @ x for x, y of shape (n, 3, k)."""
    for e in range(symbolic.row.size):
        block, xe, ye = blocks[e], x[symbolic.column[e]], y[symbolic.row[e]]
        for p in range(3):
            b0, b1, b2 = block[p, 0], block[p, 1], block[p, 2]
            for c in range(x.shape[2]):
                ye[p, c] += b0 * xe[0, c] + b1 * xe[1, c] + b2 * xe[2, c]


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _newton_matrices(symbolic, tables, h, by_r, by_v, real, cplx):
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


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _stages(plant, symbolic, tables, control, taut, t, h, v0, r0, z, rise, real, cplx):
    """Solve the stage equations by simplified Newton iteration from the guess in `z`.

    Returns the number of iterations, negative if they did not converge.
    """
    s, n, pairs = tables.stages, r0.shape[0], tables.value.size
    v = np.empty((n, 3))
    r = np.empty((n, 3))
    residual = np.empty((s, n, 3))
    change = np.empty((n, 3))
    twist = np.empty((pairs, n, 3), dtype=np.complex128)
    before = np.inf
    for iteration in range(1, 16):
        for j in range(s):
            for i in range(n):
                for q in range(3):
                    total = tables.c[j] * v0[i, q]
                    for k in range(s):
                        total += tables.a[j, k] * z[k, i, q]
                    rise[j, i, q] = h * total
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
    for j in range(s):
        for i in range(n):
            for q in range(3):
                total = tables.c[j] * v0[i, q]
                for k in range(s):
                    total += tables.a[j, k] * z[k, i, q]
                rise[j, i, q] = h * total
    return iteration


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _error(symbolic, tables, control, h, by_r, f0, v0, z, rise, real):
    """Largest scaled local error of columns, from the embedded formula filtered by the Jacobian.

    f0, v0 (n,3,k): derivatives of velocity and position at the start; z, rise (s,n,3,k).
    """
    lam = tables.real_value / h
    b_v, b_r = f0.copy(), v0.copy()
    for j in range(tables.stages):
        weight = tables.error[j] / h
        for i in range(v0.shape[0]):
            for p in range(3):
                for c in range(v0.shape[2]):
                    b_v[i, p, c] += weight * z[j, i, p, c]
                    b_r[i, p, c] += weight * rise[j, i, p, c]
    w = np.zeros(v0.shape)
    _add(w.reshape(-1), lam, b_v.reshape(-1))
    _multiply(symbolic, by_r, b_r, w)
    solve_columns(symbolic, real, w)
    largest = 0.0
    for i in range(v0.shape[0]):
        for p in range(3):
            for c in range(v0.shape[2]):
                largest = max(largest, abs(w[i, p, c]) / control.speed)
                largest = max(largest, abs(w[i, p, c] + b_r[i, p, c]) / (lam * control.length))
    return largest


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _add(y, weight, x):
    """y += weight x on flat views; plain loops compile several times faster than array sums."""
    for i in range(y.size):
        y[i] += weight * x[i]


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
        _multiply(symbolic, stage_v[j], x_v, right[j])
        place[:] = x_r
        _add(place.reshape(-1), tables.c[j] * h, x_v.reshape(-1))
        _multiply(symbolic, stage_r[j], place, right[j])
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
            _add(total.reshape(-1), tables.c[j] * h, x_v.reshape(-1))
            for q in range(s):
                _add(total.reshape(-1), h * tables.a[j, q], zx[q].reshape(-1))
                _add(residual.reshape(-1), -tables.a_inverse[j, q] / h, zx[q].reshape(-1))
            _multiply(symbolic, stage_r[j], total, residual)
            total[:] = x_v
            _add(total.reshape(-1), 1.0, zx[j].reshape(-1))
            _multiply(symbolic, stage_v[j], total, residual)
            _add(real_sum.reshape(-1), lam * tables.real_left[j], residual.reshape(-1))
            for w in range(pairs):
                _add(
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
def _variations(
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
        _add(rx[j].reshape(-1), tables.c[j] * h, x_v.reshape(-1))
        for q in range(s):
            _add(rx[j].reshape(-1), h * tables.a[j, q], zx[q].reshape(-1))
    f0 = np.zeros((n, 3, k))
    jacobian(plant, symbolic.pair, taut, t, v0, r0, stage_r[0], stage_v[0])
    _multiply(symbolic, stage_r[0], x_r, f0)
    _multiply(symbolic, stage_v[0], x_v, f0)
    error = _error(symbolic, tables, control, h, by_r, f0, x_v, zx, rx, real)
    if error <= control.tolerance:
        _add(x_v.reshape(-1), 1.0, zx[s - 1].reshape(-1))
        _add(x_r.reshape(-1), 1.0, rx[s - 1].reshape(-1))
    return error


@njit(cache=True, nogil=True, error_model="numpy")
def first_zero(coefficient):
    """First point of [0, 1] where a polynomial in Bernstein form becomes negative, or 2.

    The polynomial is taken to start at or above zero. The convex hull of the coefficients bounds
    it, so a piece is passed over only when it provably has no zero.

    Parameters
    ----------
    coefficient : ndarray, shape (degree + 1,)

    Returns
    -------
    float
    """
    count = coefficient.size
    pieces = np.empty((64, count))
    place = np.empty((64, 2))
    pieces[0] = coefficient
    pieces[0, 0] = max(coefficient[0], 0.0)
    place[0] = 0.0, 1.0
    depth = 1
    while depth > 0:
        depth -= 1
        low, width = place[depth]
        lowest = pieces[depth, 0]
        for value in pieces[depth]:
            lowest = min(lowest, value)
        if lowest >= 0.0:
            continue
        if width < 1e-10 or depth > 61:
            return low + width
        left = np.empty(count)
        work = pieces[depth].copy()
        for level in range(count):
            left[level] = work[0]
            for i in range(count - 1 - level):
                work[i] = 0.5 * (work[i] + work[i + 1])
        pieces[depth] = work
        place[depth] = low + 0.5 * width, 0.5 * width
        pieces[depth + 1] = left
        place[depth + 1] = low, 0.5 * width
        depth += 2
    return 2.0


@njit(cache=True, nogil=True, error_model="numpy")
def _first_switch(plant, tables, taut, v0, r0, rise):
    """Earliest point of a step, as a fraction of it, where a tether leaves its mode; 2 if none.

    Returns the fraction and the tether.
    """
    s, m = tables.stages, plant.rest.size
    sample = np.empty((s + 1, m))
    growth = np.empty(m)
    r = r0.copy()
    stretch(plant, v0, r, sample[0], growth)
    for j in range(s):
        r[:] = r0
        _add(r.reshape(-1), 1.0, rise[j].reshape(-1))
        stretch(plant, v0, r, sample[j + 1], growth)
    earliest, which = 2.0, -1
    coefficient = np.empty(s + 1)
    for k in range(m):
        sign = 1.0 if taut[k] else -1.0
        lowest = np.inf
        for i in range(s + 1):
            total = 0.0
            for j in range(s + 1):
                total += tables.bernstein[i, j] * sample[j, k]
            coefficient[i] = sign * total
            lowest = min(lowest, coefficient[i])
        if lowest < 0.0:
            zero = first_zero(coefficient)
            if zero < earliest:
                earliest, which = zero, k
    return earliest, which


@njit(cache=True, nogil=True, error_model="numpy")
def _interpolate(tables, increments, fraction, out):
    """Add the collocation polynomial of `increments` (s,n,3), at a fraction of the step, to out."""
    s = tables.stages
    for j in range(s):
        weight = 0.0
        for i in range(s, -1, -1):
            weight = weight * fraction + tables.power[i, j + 1]
        _add(out.reshape(-1), weight, increments[j].reshape(-1))


@njit(cache=True, nogil=True, error_model="numpy")
def _guess(tables, old, offset, scale, base, z):
    """Fill `z` with the polynomial of `old` at offset + scale c_j, less its value at `base`."""
    start = np.zeros(z.shape[1:])
    if base != 0.0:
        _interpolate(tables, old, base, start)
    for j in range(tables.stages):
        z[j] = 0.0
        _add(z[j].reshape(-1), -1.0, start.reshape(-1))
        _interpolate(tables, old, offset + scale * tables.c[j], z[j])


@njit(cache=True, nogil=True, error_model="numpy")
def _toggle(plant, motion, which, length_tolerance):
    """Switch tether `which`, and any other on its edge and leaving its mode, at this instant.

    Variations are multiplied by the saltation matrix, which for Eqs. (5)-(6) only adds the damping
    of the relative displacement along the tether to the velocities (PHYSICS: S = I for C = 0).
    """
    m = plant.rest.size
    excess, growth = np.empty(m), np.empty(m)
    stretch(plant, motion.v, motion.r, excess, growth)
    for k in range(m):
        leaving = (growth[k] < 0.0) == motion.taut[k]
        if k != which and not (abs(excess[k]) <= length_tolerance and leaving):
            continue
        if not leaving:
            continue
        sign = -1.0 if motion.taut[k] else 1.0
        motion.taut[k] = not motion.taut[k]
        motion.count[3] += 1
        i, j = plant.ends[k, 0], plant.ends[k, 1]
        e = motion.r[i] - motion.r[j]
        e /= math.sqrt(e[0] * e[0] + e[1] * e[1] + e[2] * e[2])
        for c in range(motion.x_v.shape[2]):
            jump = 0.0
            for p in range(3):
                jump += e[p] * (motion.x_r[i, p, c] - motion.x_r[j, p, c])
            jump *= sign * plant.damping[k]
            for p in range(3):
                motion.x_v[i, p, c] -= jump * e[p] * plant.inv_mass[i]
                motion.x_v[j, p, c] += jump * e[p] * plant.inv_mass[j]


@njit(cache=True, nogil=True, error_model="numpy")
def _sample(plant, tables, motion, times, out_v, out_r):
    """Write the states at all requested times up to now, in the orbit frame."""
    while motion.count[4] < times.size and times[motion.count[4]] <= motion.time[0]:
        index = motion.count[4]
        now = times[index]
        v, r = out_v[index], out_r[index]
        v[:] = motion.v0
        r[:] = motion.r0
        if motion.time[3] > 0.0:
            fraction = (now - motion.time[2]) / motion.time[3]
            _interpolate(tables, motion.z, fraction, v)
            _interpolate(tables, motion.rise, fraction, r)
        c, s = math.cos(plant.spin * now), math.sin(plant.spin * now)
        for i in range(r.shape[0]):
            x, y = r[i, 0], r[i, 1]
            vx, vy = v[i, 0] - plant.spin * y, v[i, 1] + plant.spin * x
            r[i, 0], r[i, 1] = c * x - s * y, s * x + c * y
            v[i, 0], v[i, 1] = c * vx - s * vy, s * vx + c * vy
        motion.count[4] += 1


@njit(cache=True, nogil=True, error_model="numpy")
def advance(
    plant, symbolic, tables, control, motion, stop, steps, switches, times, out_v, out_r
):
    """Integrate until `stop`, or until so many steps or switches were made.

    Parameters
    ----------
    plant : forces.Plant
    symbolic : blocklu.Symbolic
    tables : collocation.Tables
    control : Control
    motion : Motion
        Advanced in place.
    stop : float
        [s]. The last step ends there exactly; infinity to end with the step that covers `times`.
    steps, switches : int
        Largest number of accepted steps and of slack/taut switches in this call.
    times : ndarray, shape (k,)
        [s], increasing: where states are wanted. `motion.count[4]` counts those already written.
    out_v, out_r : ndarray, shape (k, n, 3)
        States at `times` in the orbit frame, written as the motion passes them.

    Returns
    -------
    int
        REACHED, PAUSED (out of steps), STEP_TOO_SMALL or TOO_MANY_SWITCHES.
    """
    s, n = tables.stages, motion.r.shape[0]
    real = np.empty((symbolic.blocks, 3, 3))
    cplx = np.empty((tables.value.size, symbolic.blocks, 3, 3), dtype=np.complex128)
    by_r = np.empty((symbolic.row.size, 3, 3))
    by_v = np.empty((symbolic.row.size, 3, 3))
    z = np.zeros((s, n, 3))
    rise = np.zeros((s, n, 3))
    old = np.zeros((s, n, 3))
    f0 = np.zeros((n, 3))
    excess, growth = np.empty(plant.rest.size), np.empty(plant.rest.size)
    middle = s // 2
    trial_v, trial_r = np.empty((n, 3)), np.empty((n, 3))
    made, most_switches = 0, motion.count[3] + switches
    grown = True
    _sample(plant, tables, motion, times, out_v, out_r)
    while True:
        t = motion.time[0]
        if t >= stop or (stop == np.inf and motion.count[4] >= times.size):
            return REACHED
        if made >= steps:
            return PAUSED
        if motion.count[3] > most_switches:
            return TOO_MANY_SWITCHES
        h = min(motion.time[1], control.longest)
        last = t + 1.01 * h >= stop
        if last:
            h = stop - t
        if h <= 1e-14 * max(t, control.length / control.speed):
            if last:
                motion.time[0] = stop
                return REACHED
            return STEP_TOO_SMALL
        v0, r0 = motion.v, motion.r
        z[:] = 0.0
        if motion.time[3] > 0.0 and grown:
            _guess(tables, motion.z, 1.0, h / motion.time[3], 1.0, z)
        trial_v[:] = v0
        trial_r[:] = r0
        _add(trial_v.reshape(-1), 1.0, z[middle].reshape(-1))
        _add(trial_r.reshape(-1), tables.c[middle] * h, trial_v.reshape(-1))
        jacobian(
            plant, symbolic.pair, motion.taut, t + tables.c[middle] * h, trial_v, trial_r,
            by_r, by_v,
        )
        _newton_matrices(symbolic, tables, h, by_r, by_v, real, cplx)
        iterations = _stages(
            plant, symbolic, tables, control, motion.taut, t, h, v0, r0, z, rise, real, cplx
        )
        motion.count[2] += abs(iterations)
        if iterations < 0:
            motion.count[1] += 1
            motion.time[1] = 0.4 * h
            grown = False
            continue
        acceleration(plant, motion.taut, t, v0, r0, f0)
        error = _error(
            symbolic, tables, control, h, by_r, f0.reshape(n, 3, 1),
            v0.reshape(n, 3, 1), z.reshape(s, n, 3, 1), rise.reshape(s, n, 3, 1), real,
        )
        factor_of = 0.85 * (control.tolerance / max(error, 1e-300)) ** (1.0 / (s + 1))
        if not error <= control.tolerance:
            motion.count[1] += 1
            motion.time[1] = h * max(0.1, factor_of) if error < np.inf else 0.4 * h
            grown = False
            continue
        fraction, which = 2.0, -1
        if not plant.bilateral:
            fraction, which = _first_switch(plant, tables, motion.taut, v0, r0, rise)
        full = h
        if which >= 0:
            converged = False
            for attempt in range(6):
                target = fraction * full if attempt == 0 else h - excess[which] / growth[which]
                if not 0.0 < target <= full * (1.0 + 1e-9):
                    break
                if target < 1e-10 * full:
                    break
                old[:] = z
                _guess(tables, old, 0.0, target / h, 0.0, z)
                h = target
                _newton_matrices(symbolic, tables, h, by_r, by_v, real, cplx)
                iterations = _stages(
                    plant, symbolic, tables, control, motion.taut, t, h, v0, r0, z, rise,
                    real, cplx,
                )
                motion.count[2] += abs(iterations)
                if iterations < 0:
                    break
                trial_v[:] = v0
                trial_r[:] = r0
                _add(trial_v.reshape(-1), 1.0, z[s - 1].reshape(-1))
                _add(trial_r.reshape(-1), 1.0, rise[s - 1].reshape(-1))
                stretch(plant, trial_v, trial_r, excess, growth)
                miss = abs(excess[which])
                if miss <= 1e-13 * plant.rest[which] or miss <= 1e-15 * full * abs(growth[which]):
                    converged = True
                    break
            if not converged and target < 1e-10 * full:
                _toggle(plant, motion, which, 1e-12 * plant.rest[which])
                motion.time[1] = full
                continue
            if not converged and iterations < 0:
                motion.count[1] += 1
                motion.time[1] = 0.5 * h
                grown = False
                continue
            last = last and h >= full
        if motion.x_v.shape[2] > 0:
            error_x = _variations(
                plant, symbolic, tables, control, motion.taut, t, h, v0, r0, z, rise, by_r,
                real, cplx, motion.x_v, motion.x_r,
            )
            scaled = 0.85 * (control.tolerance / max(error_x, 1e-300)) ** (1.0 / (s + 1))
            if not error_x <= control.tolerance:
                motion.count[1] += 1
                motion.time[1] = h * max(0.1, scaled) if error_x < np.inf else 0.4 * h
                grown = False
                continue
            factor_of = min(factor_of, scaled * h / full)
        grown = True
        made += 1
        motion.count[0] += 1
        for k in range(plant.rest.size):
            if motion.taut[k]:
                weight = plant.inv_mass[plant.ends[k, 0]] + plant.inv_mass[plant.ends[k, 1]]
                motion.dissipation[0] += plant.damping[k] * weight * h
        motion.time[2], motion.time[3] = t, h
        motion.v0[:] = v0
        motion.r0[:] = r0
        motion.z[:] = z
        motion.rise[:] = rise
        _add(motion.v.reshape(-1), 1.0, z[s - 1].reshape(-1))
        _add(motion.r.reshape(-1), 1.0, rise[s - 1].reshape(-1))
        motion.time[0] = stop if last else t + h
        if which >= 0 or not last:
            motion.time[1] = full * min(max(factor_of, 0.1), 8.0)
        if which >= 0:
            _toggle(plant, motion, which, 1e-12 * plant.rest[which])
            motion.time[1] = min(motion.time[1], 0.2 * full)
        _sample(plant, tables, motion, times, out_v, out_r)
