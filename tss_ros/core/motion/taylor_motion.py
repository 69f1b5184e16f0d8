"""One explicit step: Taylor series of the motion, Eqs. (1) to (6).

The orbit frame is used, where the equations do not contain time. Coefficients follow from
recurrences (A. Jorba and M. Zou, "A software package for the numerical integration of ODEs by means
of high-order Taylor methods", Exp. Math. 14 (2005) 99-117) and describe the whole step.
"""

import math
from typing import NamedTuple

import numpy as np

from tss_ros.core.model.laws.inertia import inertia
from tss_ros.core.model.made import BEAD_SLOTS, SQUARE, TETHER_SLOTS, bead_series, tether_series
from tss_ros.core.numerics.bernstein import DEEPEST
from tss_ros.core.numerics.simd import (
    WIDTH,
    allocating,
    inlined,
    kernel,
    lane,
    load,
    load3,
    number,
    only_where,
    python_kernel,
    splat,
    store,
    store3,
)


class Links(NamedTuple):
    """For every block of lanes what acts on it.

    Attributes
    ----------
    start, stop : ndarray, shape (blocks,) and (blocks + 1,), int
        Range of entries of each block.
    place : ndarray, shape (entries,), int
        Where the first number of the bead or tether that acts lies in its flat array.
    weight : ndarray, shape (entries, W)
        What each lane takes of it.
    """

    start: np.ndarray
    stop: np.ndarray
    place: np.ndarray
    weight: np.ndarray


class Series(NamedTuple):
    """Taylor coefficients by powers of time since the start of a step, up to the order N.

    Beads and tethers lie in blocks of W = `WIDTH` lanes, the last of which may be idle.

    Attributes
    ----------
    r : ndarray, shape (n/W, N+1, 3, W)
        Positions.
    e : ndarray, shape (m/W, N+1, 3, W)
        Vectors along tethers.
    tethers : ndarray, shape (m/W, N+1, TETHER_SLOTS, W)
        What tether laws need of them: first SQUARE, PULL and BY_LOGARITHM of `model.made`.
    beads : ndarray, shape (n/W, N+1, BEAD_SLOTS, W)
        What the laws of beads need.
    tether : ndarray, shape (m/W, 7, W)
        1 where taut, stiffness, damping, rest length, and room for three components.
    margin, bernstein, pieces : ndarray, shape (10, W), (N+1, W) and (DEEPEST + 2, N+3)
        Room for `slack`.
    ends : Links
        Which bead lies at which end of a block's tethers.
    pulls : Links
        Which tether pulls at a block's beads.
    """

    r: np.ndarray
    e: np.ndarray
    tethers: np.ndarray
    beads: np.ndarray
    tether: np.ndarray
    margin: np.ndarray
    bernstein: np.ndarray
    pieces: np.ndarray
    ends: Links
    pulls: Links


#: Rows of `Series.tether`: the first, the first of the pull's three, and how many there are.
TAUT, PULL, ROWS = 0, 4 * WIDTH, 7


def order_for(rtol: float) -> int:
    """Order of the series: four more than Jorba and Zou's, for tethers that swing undamped."""
    return math.ceil(5.0 - 0.5 * math.log(rtol))


@allocating
def blank(arrays, order):
    """Room for a `Series`, with idle lanes at rest."""
    beads, tethers, size = arrays.inv_mass.size, arrays.rest.size, order + 1
    n, m = -(-beads // WIDTH), -(-tethers // WIDTH)
    ends, pulls = _no_links(m, tethers), _no_links(n, tethers)
    for a in range(tethers):
        ends.stop[a // WIDTH + 1] += 2
        for side in range(2):
            pulls.stop[arrays.ends[a, side] // WIDTH + 1] += 1
    for links in (ends, pulls):
        for block in range(links.start.size):
            links.stop[block + 1] += links.stop[block]
            links.start[block] = links.stop[block]
    for a in range(tethers):
        for side in range(2):
            i, sign = arrays.ends[a, side], 1.0 - 2.0 * side
            _link(ends, a, 3 * WIDTH * size * (i // WIDTH) + i % WIDTH, sign)
            _link(pulls, i, ROWS * WIDTH * (a // WIDTH) + a % WIDTH, -sign * arrays.inv_mass[i])
    return Series(
        np.zeros((n, size, 3, WIDTH)), np.zeros((m, size, 3, WIDTH)),
        np.ones((m, size, TETHER_SLOTS, WIDTH)), np.zeros((n, size, BEAD_SLOTS, WIDTH)),
        np.zeros((m, ROWS, WIDTH)),
        np.zeros((10, WIDTH)), np.zeros((size, WIDTH)), np.empty((DEEPEST + 2, size + 2)),
        ends, pulls,
    )  # fmt: skip


@allocating
def _no_links(blocks, tethers):
    start, stop = np.zeros(blocks, dtype=np.int64), np.zeros(blocks + 1, dtype=np.int64)
    return Links(start, stop, np.zeros(2 * tethers, np.int64), np.zeros((2 * tethers, WIDTH)))


@kernel
def _link(links, to, place, weight):
    """Let a bead or tether take so much of a tether or bead."""
    block = to // WIDTH
    entry = links.start[block]
    while entry < links.stop[block] and links.place[entry] != place:
        entry += 1
    if entry == links.stop[block]:
        links.stop[block] += 1
        links.place[entry] = place
    links.weight[entry, to % WIDTH] += weight


@inlined
def expand(arrays, taut, idle, v, r, series):
    """Fill `series` with the motion that starts at v, r (n,3) [m/s, m] in the orbit frame.

    The tension of idle tethers, which do nothing, is filled in, too.
    """
    order, beads, tethers = series.r.shape[1] - 1, r.shape[0], arrays.rest.size
    for i in range(beads):
        for c in range(3):
            series.r[i // WIDTH, 0, c, i % WIDTH] = r[i, c]
            series.r[i // WIDTH, 1, c, i % WIDTH] = v[i, c]
    any_taut = False
    for a in range(tethers):
        i, j = arrays.ends[a, 0], arrays.ends[a, 1]
        block, at, square = a // WIDTH, a % WIDTH, 0.0
        for c in range(3):
            x = r[i, c] - r[j, c]
            series.e[block, 0, c, at] = x
            square += x * x
        series.tethers[block, 0, SQUARE, at] = square
        series.tether[block, 0, at] = 1.0 if taut[a] else 0.0
        series.tether[block, 1, at] = arrays.stiffness[a]
        series.tether[block, 2, at] = arrays.damping[a]
        series.tether[block, 3, at] = arrays.rest[a]
        any_taut |= taut[a] | idle[a]
    for k in range(order - 1):
        weight = 1.0 / ((k + 1) * (k + 2))
        for block in range(series.r.shape[0]):
            _beads(arrays, series, block, k, weight)
        for block in range(series.e.shape[0]):
            _difference(series, block, k + 1)
            if any_taut:
                _tethers(arrays, series, block, k)
            else:
                _square(series, block, k + 1)
        if any_taut:
            for block in range(series.r.shape[0]):
                _pull(series, block, k + 2, weight)
    for block in range(series.e.shape[0]):
        _difference(series, block, order)
        _square(series, block, order)


@inlined
def _beads(arrays, series, block, k, weight):
    """Write what the laws of beads and inertia do to coefficient k + 2 of r."""
    size = series.r.shape[1]
    now, at = 3 * WIDTH * (block * size + k), WIDTH * BEAD_SLOTS * size * block
    gx, gy, gz = bead_series(arrays, series.r, 3 * WIDTH * size * block, series.beads, at, k)
    x, y, _ = load3(series.r, now)
    vx, vy, _ = load3(series.r, now + 3 * WIDTH)
    fx, fy = inertia(x, y, vx, vy, 0.0, 2.0 * arrays.rate * (k + 1), arrays.drive)
    store3(series.r, now + 6 * WIDTH, weight * (gx + fx), weight * (gy + fy), weight * gz)


@inlined
def _difference(series, block, k):
    """Coefficient k of the vectors along tethers."""
    r, ends = series.r, series.ends
    x = y = z = splat(0.0)
    for entry in range(ends.start[block], ends.stop[block]):
        at, sign = ends.place[entry] + 3 * WIDTH * k, load(ends.weight, WIDTH * entry)
        x += sign * number(r, at)
        y += sign * number(r, at + WIDTH)
        z += sign * number(r, at + 2 * WIDTH)
    store3(series.e, 3 * WIDTH * (block * series.e.shape[1] + k), x, y, z)


@inlined
def _pull(series, block, k, share):
    """Add what tethers do to coefficient k of the positions."""
    tether, pulls = series.tether, series.pulls
    now = 3 * WIDTH * (block * series.r.shape[1] + k)
    x, y, z = load3(series.r, now)
    for entry in range(pulls.start[block], pulls.stop[block]):
        at, weight = pulls.place[entry] + PULL, share * load(pulls.weight, WIDTH * entry)
        x += weight * number(tether, at)
        y += weight * number(tether, at + WIDTH)
        z += weight * number(tether, at + 2 * WIDTH)
    store3(series.r, now, x, y, z)


@inlined
def _square(series, block, k):
    """Coefficient k of the squared lengths."""
    size = series.r.shape[1]
    one, square = block * size * WIDTH, splat(0.0)
    for b in range(k + 1):
        xb, yb, zb = load3(series.e, 3 * (one + WIDTH * b))
        xc, yc, zc = load3(series.e, 3 * (one + WIDTH * (k - b)))
        square += xb * xc + yb * yc + zb * zc
    store(series.tethers, WIDTH * (TETHER_SLOTS * (size * block + k) + SQUARE), square)


@inlined
def _tethers(arrays, series, block, k):
    """Coefficient k of the tethers' pull, and coefficient k + 1 of their squared lengths."""
    size, row = series.r.shape[1], block * ROWS * WIDTH
    x, y, z = tether_series(
        arrays, series.e, 3 * WIDTH * size * block, series.tether, row,
        series.tethers, WIDTH * TETHER_SLOTS * size * block, k,
    )  # fmt: skip
    taut = load(series.tether, row + TAUT)
    store3(series.tether, row + PULL, only_where(taut, x), only_where(taut, y), only_where(taut, z))


@kernel
def longest_step(series_r, tolerance, speed):
    """Step [s] whose last two terms are within the tolerance, relative to a speed [m/s]."""
    order = series_r.shape[1] - 1
    last = before = 0.0
    for block in range(series_r.shape[0]):
        for c in range(3):
            for at in range(WIDTH):
                last = max(last, abs(series_r[block, order, c, at]))
                before = max(before, abs(series_r[block, order - 1, c, at]))
    return longest(tolerance * speed, last, before, order)


@kernel
def longest(allowed, last, before, order):
    """Step whose last two terms of velocity are `allowed` [m/s], given the positions' largest.

    Those of position are then smaller still, in units of the formation, for steps below a turn.
    """
    step = _reach(allowed, last * order, order - 1)
    return min(step, _reach(allowed, before * (order - 1), order - 2))


@kernel
def _reach(allowed, coefficient, power):
    return (allowed / coefficient) ** (1.0 / power) if coefficient > 0.0 else np.inf


@python_kernel
def evaluate(series_r, time, v, r):
    """Write velocity and position (n,3) at a time [s] since the start of the step."""
    size = series_r.shape[1]
    for block in range(series_r.shape[0]):
        first = 3 * WIDTH * size * block
        x = y = z = vx = vy = vz = splat(0.0)
        for k in range(size - 1, -1, -1):
            ax, ay, az = load3(series_r, first + 3 * WIDTH * k)
            vx, vy, vz = vx * time + x, vy * time + y, vz * time + z
            x, y, z = x * time + ax, y * time + ay, z * time + az
        for i in range(WIDTH * block, min(WIDTH * (block + 1), r.shape[0])):
            at = i % WIDTH
            r[i, 0], r[i, 1], r[i, 2] = lane(x, at), lane(y, at), lane(z, at)
            v[i, 0], v[i, 1], v[i, 2] = lane(vx, at), lane(vy, at), lane(vz, at)
