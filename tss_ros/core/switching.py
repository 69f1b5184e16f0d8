"""Slack/taut switches, Eq. (5): finding the first one of a step, and what it does to variations.

Within a step every tether keeps its mode. The collocation polynomial of its stretch is searched for
zeros in Bernstein form, where none can hide between sampling points.
"""

import math

import numpy as np
from numba import njit

from tss_ros.core.forces import stretch
from tss_ros.core.radau import add

#: Most bisections in the search for a zero.
DEEPEST = 34


@njit(cache=True, nogil=True, error_model="numpy")
def first_zero(coefficient):
    """First point of [0, 1] where a polynomial in Bernstein form becomes negative, or 2.

    The polynomial is taken to start at or above zero. The convex hull of the coefficients bounds
    it, so a piece is passed over only when it provably has no zero; where they change sign once,
    there is one (Descartes), and Newton's method finds it.

    Parameters
    ----------
    coefficient : ndarray, shape (degree + 1,)

    Returns
    -------
    float
    """
    count = coefficient.size
    pieces = np.empty((DEEPEST + 2, count))
    low, width = np.empty(DEEPEST + 2), np.empty(DEEPEST + 2)
    pieces[0] = coefficient
    pieces[0, 0] = max(coefficient[0], 0.0)
    low[0], width[0] = 0.0, 1.0
    depth = 1
    while depth > 0:
        depth -= 1
        changes, positive = 0, pieces[depth, 0] >= 0.0
        for i in range(1, count):
            if (pieces[depth, i] >= 0.0) != positive:
                positive = not positive
                changes += 1
        if changes == 0 and positive:
            continue
        if changes == 1 and not positive:
            return low[depth] + width[depth] * _only_zero(pieces, depth)
        if depth == DEEPEST:
            return low[depth] + width[depth]
        # De Casteljau's division: the left half goes on top, the right half stays.
        half = 0.5 * width[depth]
        for i in range(count):
            pieces[depth + 1, i] = pieces[depth, i]
        left = depth + 1
        for level in range(1, count):
            for i in range(count - 1, level - 1, -1):
                pieces[left, i] = 0.5 * (pieces[left, i] + pieces[left, i - 1])
            pieces[depth, count - 1 - level] = pieces[left, count - 1]
        low[left], width[left] = low[depth], half
        low[depth], width[depth] = low[depth] + half, half
        depth += 2
    return 2.0


@njit(cache=True, nogil=True, error_model="numpy")
def _only_zero(pieces, which):
    """The zero in [0, 1] of a polynomial whose Bernstein coefficients become negative once."""
    low, high, degree = 0.0, 1.0, pieces.shape[1] - 1
    work = np.empty(degree + 1)
    x = pieces[which, 0] / (pieces[which, 0] - pieces[which, degree])
    for _ in range(60):
        for i in range(degree + 1):
            work[i] = pieces[which, i]
        for level in range(degree - 1):
            for i in range(degree - level):
                work[i] += x * (work[i + 1] - work[i])
        slope = work[1] - work[0]
        value = work[0] + x * slope
        if value >= 0.0:
            low = x
        else:
            high = x
        before, x = x, x - value / (degree * slope) if slope < 0.0 else 0.5 * (low + high)
        if not low <= x <= high:
            x = 0.5 * (low + high)
        if abs(x - before) <= 1e-10:
            break
    return x


@njit(cache=True, nogil=True, error_model="numpy")
def first_switch(plant, tables, taut, v0, r0, rise):
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
        add(r.reshape(-1), 1.0, rise[j].reshape(-1))
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
def first_switch_of_series(plant, taut, q, h):
    """The same for a step h [s] of Taylor series q (m,N+1) of squared lengths."""
    order = q.shape[1] - 1
    end, which = h, -1
    for k in range(plant.rest.size):
        sign = 1.0 if taut[k] else -1.0
        length = math.sqrt(q[k, 0])
        start = sign * (length - plant.rest[k]) * (length + plant.rest[k])
        change, power = 0.0, 1.0
        for i in range(1, order + 1):
            power *= end
            change += abs(q[k, i]) * power
        if start > change:
            continue
        # Where the first three terms say that the switch comes early, search that part alone first.
        slope, bend = sign * q[k, 1], sign * q[k, 2]
        part = end
        if bend < 0.0 < slope:
            root = math.sqrt(max(0.0, slope * slope - 4.0 * bend * start))
            part = min(end, 0.65 * (slope + root) / -bend)
        zero = _first_zero_of_series(q, k, sign, start, part)
        if zero > 1.0 and part < end:
            part = end
            zero = _first_zero_of_series(q, k, sign, start, part)
        if zero <= 1.0:
            end, which = zero * part, k
    return end / h if which >= 0 else 2.0, which


@njit(cache=True, nogil=True, error_model="numpy")
def _first_zero_of_series(q, k, sign, start, h):
    """`first_zero` of sign (q_k - L^2), which begins with `start`, over a time h [s]."""
    order = q.shape[1] - 1
    # From powers of time to Bernstein form, by summing up differences.
    coefficient = np.empty(order + 1)
    power, choose = sign, 1.0
    coefficient[0] = start
    for i in range(1, order + 1):
        power *= h
        choose *= (order - i + 1) / i
        coefficient[i] = q[k, i] * power / choose
    for level in range(1, order + 1):
        for i in range(order, level - 1, -1):
            coefficient[i] += coefficient[i - 1]
    return first_zero(coefficient)


@njit(cache=True, nogil=True, error_model="numpy")
def toggle(plant, motion, which, length_tolerance):
    """Switch tether `which`, and any other on its edge and leaving its mode, at this instant.

    Variations are multiplied by the saltation matrix, which for Eqs. (5)-(6) only adds the damping
    of the relative displacement along the tether to the velocities (S = I for C = 0).
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
        if motion.x_v.shape[2] == 0:
            continue
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
