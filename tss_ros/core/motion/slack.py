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
from tss_ros.core.model.kernel_arrays import ROW
from tss_ros.core.model.made import PULL, SQUARE, TETHER_SLOTS
from tss_ros.core.numerics.bernstein import first_zero
from tss_ros.core.numerics.loops import add, assign
from tss_ros.core.numerics.simd import (
    WIDTH,
    fabs,
    inlined,
    kernel,
    leaf,
    load,
    load3,
    number,
    rounded_kernel,
    smaller,
    splat,
    store,
)

#: From one order of `Series.tethers` to the next.
ORDER = TETHER_SLOTS * WIDTH
#: Rows of `Series.margin` in which zeros are searched: the sign of a margin that is searched, or 0;
#: where, from where, to where [s]; and what it is there, and its rate.
TIME, SEARCHED, LOW, HIGH, VALUE, SLOPE = 3, 5, 6, 7, 8, 9
#: A step of Newton's method this short, relative to the step of the motion, is the last one.
SURE = 1e-8
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


@rounded_kernel
def first_switch(arrays, tables, step, idle, room):
    """Earliest point of a step, as a fraction, where a tether leaves its mode; 2 if none.

    `room` is a `step.ImplicitRoom`. Returns the fraction and the guard.
    """
    s, m, v, r, pieces = tables.stages, arrays.rest.size, room.v, room.r, room.pieces
    excess, pull, growth = room.margins[0], room.margins[1], room.growth
    for j in range(s + 1):
        assign(r, step.r)
        assign(v, step.v)
        if j > 0:
            add(r, 1.0, step.dr[j - 1])
            add(v, 1.0, step.dv[j - 1])
        time = step.time if j == 0 else step.time + tables.c[j - 1] * step.size
        stretch(arrays, time, v, r, excess[j], growth)
        if not arrays.pushes:
            tensions(arrays, time, v, r, pull[j])
    earliest, which = 2.0, -1
    for guard in range(m if arrays.pushes else 2 * m):
        k, at_rest = guard % m, guard < m
        sign, lowest = _sign(arrays.pushes, step.taut[k], idle[k], at_rest), np.inf
        if sign == 0.0:
            continue
        for i in range(s + 1):
            total = 0.0
            for j in range(s + 1):
                total += tables.bernstein[i, j] * (excess[j, k] if at_rest else pull[j, k])
            pieces[0, i] = sign * total
            lowest = min(lowest, pieces[0, i])
        if lowest < 0.0:
            zero = first_zero(pieces, s + 1)
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
            lowest, searched = _to_bernstein(series, first, size), 0
            store(margin, 4 * WIDTH, lowest)
            for lane in range(min(WIDTH, rest.size - WIDTH * block)):
                margin[SEARCHED, lane] = 0.0
                if margin[0, lane] != 0.0 and margin[4, lane] < 0.0:
                    searched += _bracket_zero(series, lane, size)
            if searched > 0:
                zero, lane = _earliest_zero(
                    margin, series.e, series.tethers, rest, block, first, h, at_rest
                )
                if zero < earliest:
                    earliest, which = zero, WIDTH * block + lane
            for lane in range(min(WIDTH, rest.size - WIDTH * block)):
                part = margin[2, lane]
                if margin[0, lane] != 0.0 and part >= min(h, earliest):
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
def _bracket_zero(series, lane, size):
    """Note where the first zero of a margin lies that `_to_bernstein` left; 0 if there is none."""
    margin, changes, positive, zero = series.margin, 0, True, 0.0
    low, high = 0.0, margin[2, lane]
    for i in range(1, size):
        if (series.bernstein[i, lane] >= 0.0) != positive:
            positive = not positive
            changes += 1
    if changes > 1:
        for i in range(size):
            series.pieces[0, i] = series.bernstein[i, lane]
        zero = first_zero(series.pieces, size)
        margin[TIME, lane], reach = zero * high, 1e-6 * high
        low, high = max(0.0, zero * high - reach), min(high, zero * high + reach)
    if zero > 1.0:
        return 0
    margin[LOW, lane], margin[HIGH, lane] = low, high
    margin[SEARCHED, lane] = margin[0, lane]
    return 1


@kernel
def _earliest_zero(margin, e, tethers, rest, block, first, h, at_rest):
    """The first of the zeros [s] that a block's margins are bracketed at, and its lane.

    Newton's method for all lanes at once. One whose zero must be later than another's is left.
    """
    earliest, which, lanes = np.inf, -1, min(WIDTH, rest.size - WIDTH * block)
    size = e.shape[1] if at_rest else e.shape[1] - SHORTER
    for _ in range(60):
        _margins_at(margin, e, tethers, block, first, size, at_rest)
        bound = earliest
        for lane in range(lanes):
            if margin[SEARCHED, lane] == 0.0:
                continue
            if _newton(margin, tethers, rest[WIDTH * block + lane], first, h, lane, at_rest):
                margin[SEARCHED, lane] = 0.0
                if margin[TIME, lane] < earliest:
                    earliest, which = margin[TIME, lane], lane
            bound = min(bound, earliest, margin[HIGH, lane])
        left = 0
        for lane in range(lanes):
            if margin[LOW, lane] > bound:
                margin[SEARCHED, lane] = 0.0
            left += margin[SEARCHED, lane] != 0.0
        if left == 0:
            return earliest, which
    for lane in range(lanes):
        if margin[SEARCHED, lane] != 0.0 and margin[TIME, lane] < earliest:
            earliest, which = margin[TIME, lane], lane
    return earliest, which


@leaf
def _newton(margin, tethers, rest, first, h, lane, at_rest):
    """Improve a lane's time by the margin there and its rate; whether it is exact to rounding."""
    sign, time = margin[SEARCHED, lane], margin[TIME, lane]
    value, slope = margin[VALUE, lane], margin[SLOPE, lane]
    if at_rest:
        scale = rest * rest
        value -= scale
    else:
        start, rate = number(tethers, first + lane), number(tethers, first + ORDER + lane)
        scale = abs(start) + h * abs(rate)
    if abs(value) <= 8e-15 * scale or abs(value) <= 1e-15 * h * abs(slope):
        return True
    if sign * value >= 0.0:
        margin[LOW, lane] = time
    else:
        margin[HIGH, lane] = time
    low, high = margin[LOW, lane], margin[HIGH, lane]
    there = time - value / slope if sign * slope < 0.0 else -1.0
    if low <= there <= high:
        # What such a step leaves is of the order of its square, far below rounding.
        exact = abs(there - time) <= SURE * h
    else:
        there = 0.5 * (low + high)
        exact = there == time
    margin[TIME, lane] = there
    return exact


@leaf
def _margins_at(margin, e, tethers, block, first, size, at_rest):
    """Squared lengths, or tensions over length, and their rates at each lane's time [s].

    Squared lengths are of the very vectors that tell where the beads are; the squares' own series
    is cut off elsewhere.
    """
    time = load(margin, TIME * WIDTH)
    x = y = z = vx = vy = vz = splat(0.0)
    if at_rest:
        for i in range(size - 1, -1, -1):
            ax, ay, az = load3(e, 3 * WIDTH * (size * block + i))
            vx, vy, vz = vx * time + x, vy * time + y, vz * time + z
            x, y, z = x * time + ax, y * time + ay, z * time + az
        vx = 2.0 * (x * vx + y * vy + z * vz)
        x = x * x + y * y + z * z
    else:
        for i in range(size - 1, -1, -1):
            vx = vx * time + x
            x = x * time + load(tethers, first + ORDER * i)
    store(margin, VALUE * WIDTH, x)
    store(margin, SLOPE * WIDTH, vx)


@kernel
def toggle(arrays, motion, which, edge, excess, growth):
    """Switch the tether whose guard is reached, and any other that leaves its mode at this instant.

    Tethers within `edge` of their rest length, relative to it, leave their mode together.
    `excess` and `growth` (m,) are overwritten. Returns how many modes changed.

    Variations are multiplied by the saltation matrix. Where a force jumps by C l', at the rest
    length, that only adds the damping of the relative displacement along the tether to the
    velocities (S = I for C = 0); a rest length that is a state has its share in both. A tension
    that comes to zero does not jump, and S = I.
    """
    at, taut, idle, m = motion.progress[0], motion.taut, motion.idle, arrays.rest.size
    if which >= m:
        k = which - m
        taut[k], idle[k] = not taut[k], not idle[k]
        at.switches += 1
        return 1
    changed = 0
    stretch(arrays, at.time, motion.v, motion.r, excess, growth)
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
    row, damping = -1, arrays.damping[k]
    if arrays.reel.size > 0 and arrays.reel[k, ROW] >= 0.0:
        row = int(arrays.reel[k, ROW])
        damping *= arrays.rest[k] / motion.r[row, 0]
    length = math.sqrt(length2)
    for c in range(motion.x_v.shape[2]):
        jump = 0.0 if row < 0 else -length * motion.x_r[row, 0, c]
        for p in range(3):
            e = motion.r[i, p] - motion.r[j, p]
            jump += e * (motion.x_r[i, p, c] - motion.x_r[j, p, c])
        jump *= sign * damping / length2
        if row >= 0:
            motion.x_v[row, 0, c] += jump * length * arrays.inv_mass[row]
        for p in range(3):
            e = motion.r[i, p] - motion.r[j, p]
            motion.x_v[i, p, c] -= jump * e * arrays.inv_mass[i]
            motion.x_v[j, p, c] += jump * e * arrays.inv_mass[j]
