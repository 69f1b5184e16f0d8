"""Switches of tethers, Eq. (5): finding the first one of a step, and what it does to variations.

A tether is slack, taut, or idle: longer than at rest, but not pulling, since its law would have it
push and never lets it. Within a step every tether keeps its mode. Two guards end it: tether k
comes to its rest length (guard k), or its tension comes to zero (guard m + k, for laws that never
push). Polynomials of both are searched for zeros in Bernstein form, where none can hide between
sampling points.
"""

import math

import numpy as np

from tss_ros.core.model.forces import stretch, tensions
from tss_ros.core.model.made import PULL, SQUARE, TETHER_SLOTS
from tss_ros.core.numerics.bernstein import DEEPEST, first_zero
from tss_ros.core.numerics.loops import add, assign
from tss_ros.core.numerics.simd import (
    WIDTH,
    allocating,
    fabs,
    inlined,
    kernel,
    leaf,
    load,
    number,
    smaller,
    splat,
    store,
)

#: From one order of `Series.tethers` to the next.
ORDER = TETHER_SLOTS * WIDTH
#: Series of tensions have so many orders less than those of positions.
SHORTER = 2


@leaf
def _sign(pushes, taut, idle, at_rest):
    """What a guard is multiplied with so that it is positive in the mode; 0 if it ends no mode."""
    if pushes:
        sign = 1.0 if taut else -1.0
        return sign if at_rest else 0.0
    if at_rest:
        return 0.0 if taut else 1.0 if idle else -1.0
    return 1.0 if taut else -1.0 if idle else 0.0


@allocating
def first_switch(arrays, tables, step, idle):
    """Earliest point of a step, as a fraction, where a tether leaves its mode; 2 if none.

    Returns the fraction and the guard.
    """
    s, m = tables.stages, arrays.rest.size
    excess, pull = np.empty((s + 1, m)), np.zeros((s + 1, m))
    growth = np.empty(m)
    r, v = step.r.copy(), step.v.copy()
    for j in range(s + 1):
        if j > 0:
            assign(r, step.r)
            add(r, 1.0, step.dr[j - 1])
            assign(v, step.v)
            add(v, 1.0, step.dv[j - 1])
        stretch(arrays, v, r, excess[j], growth)
        if not arrays.pushes:
            tensions(arrays, v, r, pull[j])
    earliest, which = 2.0, -1
    coefficient, pieces = np.empty(s + 1), np.empty((DEEPEST + 2, s + 3))
    for guard in range(m if arrays.pushes else 2 * m):
        k, at_rest = guard % m, guard < m
        sign, lowest = _sign(arrays.pushes, step.taut[k], idle[k], at_rest), np.inf
        if sign == 0.0:
            continue
        for i in range(s + 1):
            total = 0.0
            for j in range(s + 1):
                total += tables.bernstein[i, j] * (excess[j, k] if at_rest else pull[j, k])
            coefficient[i] = sign * total
            lowest = min(lowest, coefficient[i])
        if lowest < 0.0:
            zero = first_zero(coefficient, pieces)
            if zero < earliest:
                earliest, which = zero, guard
    return earliest, which


@inlined
def first_switch_of_series(arrays, taut, idle, series, h):
    """Earliest time [s] within a step h of Taylor series where a tether leaves its mode.

    Returns the time, exact to rounding, or infinity if there is none; and the guard.
    """
    earliest, which, m = np.inf, -1, arrays.rest.size
    for kind in range(1 if arrays.pushes else 2):
        zero, guard = _first_guard(arrays.rest, arrays.pushes, taut, idle, series, h, kind == 0)
        if zero < earliest:
            earliest, which = zero, guard + kind * m
    return earliest, which


@inlined
def _first_guard(rest, pushes, taut, idle, series, h, at_rest):
    """The same for the guards of one kind; returns the tether."""
    margin, earliest, which = series.margin, np.inf, -1
    size, slot = series.r.shape[1], SQUARE
    stride = TETHER_SLOTS * size
    if not at_rest:
        size, slot = size - SHORTER, PULL
    for block in range(series.e.shape[0]):
        first = WIDTH * (stride * block + slot)
        change, power = splat(0.0), h
        for i in range(1, size):
            change += power * fabs(load(series.tethers, first + ORDER * i))
            power *= h
        store(margin, 0, change)
        open_lanes = 0
        for lane in range(min(WIDTH, rest.size - WIDTH * block)):
            k = WIDTH * block + lane
            sign = _sign(pushes, taut[k], idle[k], at_rest)
            start = number(series.tethers, first + lane)
            if at_rest:
                length = math.sqrt(start)
                start = (length - rest[k]) * (length + rest[k])
            start *= sign
            if sign == 0.0 or start > margin[0, lane]:
                margin[0, lane] = 0.0
                continue
            # Where the first three terms say that the switch comes early, search there first.
            slope = sign * number(series.tethers, first + ORDER + lane)
            bend, guess = sign * number(series.tethers, first + 2 * ORDER + lane), h
            if bend < 0.0 < slope:
                root = math.sqrt(max(0.0, slope * slope - 4.0 * bend * start))
                guess = min(h, 0.5 * (slope + root) / -bend)
            margin[0, lane], margin[1, lane] = sign, max(start, 0.0)
            margin[2, lane], margin[3, lane] = min(h, 1.3 * guess), guess
            open_lanes += 1
        while open_lanes > 0:
            lowest = _to_bernstein(series, first, size)
            store(margin, 4 * WIDTH, lowest)
            for lane in range(min(WIDTH, rest.size - WIDTH * block)):
                sign, part = margin[0, lane], margin[2, lane]
                if sign == 0.0:
                    continue
                k, zero = WIDTH * block + lane, np.inf
                if margin[4, lane] < 0.0:
                    zero = _zero_of_series(rest[k], series, k, h, first + lane, size, at_rest)
                if zero < earliest:
                    earliest, which = zero, k
                if zero < np.inf or part >= h:
                    margin[0, lane] = 0.0
                    open_lanes -= 1
                margin[2, lane] = h
    return earliest, which


@kernel
def _to_bernstein(series, first, size):
    """Write the Bernstein coefficients of a block's margins, and return the lowest ones."""
    margin, bernstein = series.margin, series.bernstein
    power, part, share = load(margin, 0), load(margin, 2 * WIDTH), 1.0
    lowest = load(margin, WIDTH)
    store(bernstein, 0, lowest)
    for i in range(1, size):
        power *= part
        share *= i / (size - i)
        store(bernstein, WIDTH * i, share * power * load(series.tethers, first + ORDER * i))
    for level in range(1, size):
        before = load(bernstein, WIDTH * (level - 1))
        for i in range(level, size):
            now = load(bernstein, WIDTH * i)
            store(bernstein, WIDTH * i, now + before)
            before = now
        lowest = smaller(lowest, load(bernstein, WIDTH * level))
    return lowest


@inlined
def _zero_of_series(rest, series, k, h, first, size, at_rest):
    """The first zero [s] of a tether's margin as `_to_bernstein` left it, infinity if none."""
    lane, margin = k % WIDTH, series.margin
    low, high, changes, positive = 0.0, margin[2, lane], 0, True
    for i in range(1, size):
        if (series.bernstein[i, lane] >= 0.0) != positive:
            positive = not positive
            changes += 1
    time, zero = margin[3, lane], 0.0
    if changes > 1:
        zero = first_zero(series.bernstein[:size, lane], series.pieces)
        time, reach = zero * high, 1e-6 * high
        low, high = max(0.0, time - reach), min(high, time + reach)
    sign, scale = margin[0, lane], rest * rest
    if not at_rest:
        scale = abs(number(series.tethers, first)) + h * abs(number(series.tethers, first + ORDER))
    for _ in range(60 if zero <= 1.0 else 0):
        if at_rest:
            value, slope = _square_at(series, k, time)
            value -= scale
        else:
            value = slope = 0.0
            for i in range(size - 1, -1, -1):
                slope = slope * time + value
                value = value * time + number(series.tethers, first + ORDER * i)
        if abs(value) <= 8e-15 * scale or abs(value) <= 1e-15 * h * abs(slope):
            break
        if sign * value >= 0.0:
            low = time
        else:
            high = time
        before, time = time, time - value / slope if sign * slope < 0.0 else 0.5 * (low + high)
        if not low <= time <= high:
            time = 0.5 * (low + high)
        if time == before:
            break
    return time if zero <= 1.0 else np.inf


@inlined
def _square_at(series, k, time):
    """Squared length of a tether and its rate at a time [s], from the very vectors that tell where
    the beads are; the squares' own series is cut off elsewhere.
    """
    size, x = series.r.shape[1], 0.0
    y = z = vx = vy = vz = 0.0
    first, step = 3 * WIDTH * size * (k // WIDTH) + k % WIDTH, 3 * WIDTH
    for i in range(first + step * (size - 1), first - 1, -step):
        vx, vy, vz = vx * time + x, vy * time + y, vz * time + z
        x = x * time + number(series.e, i)
        y = y * time + number(series.e, i + WIDTH)
        z = z * time + number(series.e, i + 2 * WIDTH)
    return x * x + y * y + z * z, 2.0 * (x * vx + y * vy + z * vz)


@kernel
def toggle(arrays, motion, which, edge, excess, growth):
    """Switch the tether whose guard is reached, and any other that leaves its mode at this instant.

    Tethers within `edge` of their rest length, relative to it, leave their mode together.
    `excess` and `growth` (m,) are overwritten. Returns how many modes changed.

    Variations are multiplied by the saltation matrix. Where a force jumps by C l', at the rest
    length, that only adds the damping of the relative displacement along the tether to the
    velocities (S = I for C = 0). A tension that comes to zero does not jump, and S = I.
    """
    at, taut, idle, m = motion.progress[0], motion.taut, motion.idle, arrays.rest.size
    if which >= m:
        k = which - m
        taut[k], idle[k] = not taut[k], not idle[k]
        at.switches += 1
        return 1
    changed = 0
    stretch(arrays, motion.v, motion.r, excess, growth)
    for k in range(m):
        if k != which and abs(excess[k]) > edge * arrays.rest[k]:
            continue
        sign = _sign(arrays.pushes, taut[k], idle[k], True)
        if sign == 0.0 or (growth[k] < 0.0) != (sign > 0.0):
            continue
        changed += 1
        if idle[k]:
            idle[k] = False
            continue
        taut[k] = not taut[k]
        at.switches += 1
        _saltation(arrays, motion, k, -sign)
    return changed


@inlined
def _saltation(arrays, motion, k, sign):
    """What it does to variations that damping sets in (sign 1) or ends (-1) at the rest length."""
    i, j, length2 = arrays.ends[k, 0], arrays.ends[k, 1], 0.0
    for p in range(3):
        length2 += (motion.r[i, p] - motion.r[j, p]) ** 2
    for c in range(motion.x_v.shape[2]):
        jump = 0.0
        for p in range(3):
            e = motion.r[i, p] - motion.r[j, p]
            jump += e * (motion.x_r[i, p, c] - motion.x_r[j, p, c])
        jump *= sign * arrays.damping[k] / length2
        for p in range(3):
            e = motion.r[i, p] - motion.r[j, p]
            motion.x_v[i, p, c] -= jump * e * arrays.inv_mass[i]
            motion.x_v[j, p, c] += jump * e * arrays.inv_mass[j]
