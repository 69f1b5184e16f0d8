"""Slack/taut switches, Eq. (5): finding the first one of a step, and what it does to variations.

Within a step every tether keeps its mode. The collocation polynomial of its stretch is searched for
zeros in Bernstein form, where none can hide between sampling points.
"""

import math

import numpy as np
from numba import njit

from tss_ros.core.model.forces import stretch
from tss_ros.core.model.made import SQUARE, TETHER_SLOTS
from tss_ros.core.numerics.bernstein import DEEPEST, first_zero
from tss_ros.core.numerics.loops import add
from tss_ros.core.numerics.simd import WIDTH, fabs, inlined, kernel, load, number, smaller, splat, store

#: From one order of `Series.tethers` to the next.
ORDER = TETHER_SLOTS * WIDTH


@njit(cache=True, nogil=True, error_model="numpy")
def first_switch(arrays, tables, step):
    """Earliest point of a step, as a fraction, where a tether leaves its mode, Eq. (5); 2 if none.

    Returns the fraction and the tether.
    """
    s, m = tables.stages, arrays.rest.size
    sample = np.empty((s + 1, m))
    growth = np.empty(m)
    r = step.r.copy()
    stretch(arrays, step.v, r, sample[0], growth)
    for j in range(s):
        r[:] = step.r
        add(r, 1.0, step.dr[j])
        stretch(arrays, step.v, r, sample[j + 1], growth)
    earliest, which = 2.0, -1
    coefficient, pieces = np.empty(s + 1), np.empty((DEEPEST + 2, s + 3))
    for k in range(m):
        sign = 1.0 if step.taut[k] else -1.0
        lowest = np.inf
        for i in range(s + 1):
            total = 0.0
            for j in range(s + 1):
                total += tables.bernstein[i, j] * sample[j, k]
            coefficient[i] = sign * total
            lowest = min(lowest, coefficient[i])
        if lowest < 0.0:
            zero = first_zero(coefficient, pieces)
            if zero < earliest:
                earliest, which = zero, k
    return earliest, which


@inlined
def first_switch_of_series(rest, taut, series, h):
    """Earliest time [s] within a step h of Taylor series where a tether leaves its mode.

    Returns the time, exact to rounding, or infinity if there is none; and the tether.
    """
    size, margin, earliest, which = series.r.shape[1], series.margin, np.inf, -1
    for block in range(series.e.shape[0]):
        first = WIDTH * (TETHER_SLOTS * size * block + SQUARE)
        change, power = splat(0.0), h
        for i in range(1, size):
            change += power * fabs(load(series.tethers, first + ORDER * i))
            power *= h
        store(margin, 0, change)
        open_lanes = 0
        for lane in range(min(WIDTH, rest.size - WIDTH * block)):
            k = WIDTH * block + lane
            sign, length = 1.0 if taut[k] else -1.0, math.sqrt(series.tethers[block, 0, SQUARE, lane])
            start = sign * (length - rest[k]) * (length + rest[k])
            if start > margin[0, lane]:
                margin[0, lane] = 0.0
                continue
            # Where the first three terms say that the switch comes early, search there first.
            slope = sign * series.tethers[block, 1, SQUARE, lane]
            bend, guess = sign * series.tethers[block, 2, SQUARE, lane], h
            if bend < 0.0 < slope:
                root = math.sqrt(max(0.0, slope * slope - 4.0 * bend * start))
                guess = min(h, 0.5 * (slope + root) / -bend)
            margin[0, lane], margin[1, lane] = sign, max(start, 0.0)
            margin[2, lane], margin[3, lane] = min(h, 1.3 * guess), guess
            open_lanes += 1
        while open_lanes > 0:
            lowest = _to_bernstein(series, first)
            store(margin, 4 * WIDTH, lowest)
            for lane in range(min(WIDTH, rest.size - WIDTH * block)):
                sign, part = margin[0, lane], margin[2, lane]
                if sign == 0.0:
                    continue
                k, zero = WIDTH * block + lane, np.inf
                if margin[4, lane] < 0.0:
                    zero = _zero_of_series(rest, series, k, h)
                if zero < earliest:
                    earliest, which = zero, k
                if zero < np.inf or part >= h:
                    margin[0, lane] = 0.0
                    open_lanes -= 1
                margin[2, lane] = h
    return earliest, which


@kernel
def _to_bernstein(series, first):
    """Write the Bernstein coefficients of a block's margins, and return the lowest ones."""
    size, margin, bernstein = series.r.shape[1], series.margin, series.bernstein
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
def _zero_of_series(rest, series, k, h):
    """The first zero [s] of a tether's margin as `_to_bernstein` left it, infinity if none."""
    lane, margin = k % WIDTH, series.margin
    size, low, high, changes, positive = series.r.shape[1], 0.0, margin[2, lane], 0, True
    for i in range(1, size):
        if (series.bernstein[i, lane] >= 0.0) != positive:
            positive = not positive
            changes += 1
    time = margin[3, lane]
    if changes > 1:
        zero = first_zero(series.bernstein[:, lane], series.pieces)
        if zero > 1.0:
            return np.inf
        time, reach = zero * high, 1e-6 * high
        low, high = max(0.0, time - reach), min(high, time + reach)
    # The very vectors that tell where the beads are, not the squares: these are cut off elsewhere.
    sign, square = margin[0, lane], rest[k] * rest[k]
    e, first = series.e, WIDTH * 3 * size * (k // WIDTH) + lane
    for _ in range(60):
        x = y = z = vx = vy = vz = 0.0
        for i in range(first + 3 * WIDTH * (size - 1), first - 1, -3 * WIDTH):
            vx, vy, vz = vx * time + x, vy * time + y, vz * time + z
            x = x * time + number(e, i)
            y = y * time + number(e, i + WIDTH)
            z = z * time + number(e, i + 2 * WIDTH)
        value, slope = x * x + y * y + z * z - square, 2.0 * (x * vx + y * vy + z * vz)
        if abs(value) <= 8e-15 * square or abs(value) <= 1e-15 * h * abs(slope):
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
    return time


@kernel
def toggle(arrays, motion, which, length_tolerance, excess, growth):
    """Switch tether `which`, and any other on its edge and leaving its mode, at this instant.

    `excess` and `growth` (m,) are overwritten. Returns how many switched.

    Variations are multiplied by the saltation matrix, which for Eqs. (5)-(6) only adds the damping
    of the relative displacement along the tether to the velocities (S = I for C = 0).
    """
    before = motion.progress[0].switches
    stretch(arrays, motion.v, motion.r, excess, growth)
    for k in range(arrays.rest.size):
        leaving = (growth[k] < 0.0) == motion.taut[k]
        if k != which and not (abs(excess[k]) <= length_tolerance and leaving):
            continue
        if not leaving:
            continue
        sign = -1.0 if motion.taut[k] else 1.0
        motion.taut[k] = not motion.taut[k]
        motion.progress[0].switches += 1
        i, j = arrays.ends[k, 0], arrays.ends[k, 1]
        if motion.x_v.shape[2] == 0:
            continue
        length2 = 0.0
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
    return motion.progress[0].switches - before
