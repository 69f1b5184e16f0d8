"""One explicit step: Taylor series of the motion, Eqs. (1) to (6).

The orbit frame is used, where the equations do not contain time. Coefficients follow from
recurrences (A. Jorba and M. Zou, "A software package for the numerical integration of ODEs by means
of high-order Taylor methods", Exp. Math. 14 (2005) 99-117) and describe the whole step.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from tss_ros.core.numerics.bernstein import DEEPEST
from tss_ros.core.numerics.simd import (
    WIDTH,
    kernel,
    lane,
    load,
    load3,
    only_where,
    splat,
    sqrt,
    store,
    store3,
)


class Links(NamedTuple):
    """For every block of lanes what acts on it.

    Attributes
    ----------
    start, stop : ndarray, shape (blocks,) and (blocks + 1,), int
        Range of entries of each block.
    index : ndarray, shape (entries,), int
        The bead or tether that acts.
    weight : ndarray, shape (entries, W)
        What each lane takes of it.
    """

    start: np.ndarray
    stop: np.ndarray
    index: np.ndarray
    weight: np.ndarray


class Series(NamedTuple):
    """Taylor coefficients by powers of time since the start of a step, up to the order N.

    Beads and tethers lie in blocks of W = `WIDTH` lanes, the last of which may be idle.

    Attributes
    ----------
    r : ndarray, shape (n/W, N+1, 3, W)
        Positions.
    e, q : ndarray, shape (m/W, N+1, 3, W) and (m/W, N+1, W)
        Vectors along tethers and their squared lengths.
    d, g, p : ndarray, shape (m/W, N+1, W)
        Where taut: the rate of log q, q to the power -1/2, and tension over length, Eqs. (3), (6).
    u, f : ndarray, shape (n/W, N+1, W)
        Gravity's distance variable and factor as in `forces.acceleration`, Eq. (2).
    tether : ndarray, shape (m/W, 7, W)
        1 where taut, stiffness, half the damping, rest length, and room for three components.
    margin, bernstein, pieces : ndarray, shape (5, W), (N+1, W) and (DEEPEST + 2, N+3)
        Room for `slack`.
    ends : Links
        Which bead lies at which end of a block's tethers.
    pulls : Links
        Which tether pulls at a block's beads.
    """

    r: np.ndarray
    e: np.ndarray
    q: np.ndarray
    d: np.ndarray
    g: np.ndarray
    p: np.ndarray
    u: np.ndarray
    f: np.ndarray
    tether: np.ndarray
    margin: np.ndarray
    bernstein: np.ndarray
    pieces: np.ndarray
    ends: Links
    pulls: Links


#: Rows of `Series.tether`, times WIDTH.
TAUT, STIFFNESS, DAMPING, REST, PULL = 0, WIDTH, 2 * WIDTH, 3 * WIDTH, 4 * WIDTH
ROWS = 7


def order_for(rtol: float) -> int:
    """Order of the series: four more than Jorba and Zou's, for tethers that swing undamped."""
    return math.ceil(5.0 - 0.5 * math.log(rtol))


@njit(cache=True, nogil=True, error_model="numpy")
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
            _link(ends, a, i, sign)
            _link(pulls, i, a, -sign * arrays.inv_mass[i])
    return Series(
        np.zeros((n, size, 3, WIDTH)), np.zeros((m, size, 3, WIDTH)), np.ones((m, size, WIDTH)),
        np.zeros((m, size, WIDTH)), np.zeros((m, size, WIDTH)), np.zeros((m, size, WIDTH)),
        np.zeros((n, size, WIDTH)), np.zeros((n, size, WIDTH)), np.zeros((m, ROWS, WIDTH)),
        np.zeros((5, WIDTH)), np.zeros((size, WIDTH)), np.empty((DEEPEST + 2, size + 2)),
        ends, pulls,
    )  # fmt: skip


@njit(cache=True, nogil=True, error_model="numpy")
def _no_links(blocks, tethers):
    start, stop = np.zeros(blocks, dtype=np.int64), np.zeros(blocks + 1, dtype=np.int64)
    return Links(start, stop, np.zeros(2 * tethers, np.int64), np.zeros((2 * tethers, WIDTH)))


@kernel
def _link(links, to, index, weight):
    """Let a bead or tether take so much of a tether or bead."""
    block = to // WIDTH
    entry = links.start[block]
    while entry < links.stop[block] and links.index[entry] != index:
        entry += 1
    if entry == links.stop[block]:
        links.stop[block] += 1
        links.index[entry] = index
    links.weight[entry, to % WIDTH] += weight


@kernel
def expand(arrays, taut, v, r, series):
    """Fill `series` with the motion that starts at v, r (n,3) [m/s, m] in the orbit frame."""
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
        series.q[block, 0, at] = square
        series.tether[block, 0, at] = 1.0 if taut[a] else 0.0
        series.tether[block, 1, at] = arrays.stiffness[a]
        series.tether[block, 2, at] = 0.5 * arrays.damping[a]
        series.tether[block, 3, at] = arrays.rest[a]
        any_taut |= taut[a]
    for k in range(order - 1):
        weight = 1.0 / ((k + 1) * (k + 2))
        for block in range(series.r.shape[0]):
            _gravity(arrays, series, block, k, weight)
        for block in range(series.e.shape[0]):
            _difference(series, block, k + 1)
            if any_taut:
                _tension(series, block, k)
            else:
                _square(series, block, k + 1)
        if any_taut:
            for block in range(series.r.shape[0]):
                _pull(series, block, k + 2, weight)
    for block in range(series.e.shape[0]):
        _difference(series, block, order)
        _square(series, block, order)


@njit(inline="always", error_model="numpy", fastmath={"contract"})
def _gravity(arrays, series, block, k, weight):
    """Write what gravity, centrifugal and Coriolis acceleration do to coefficient k + 2 of r."""
    r, u, f = series.r, series.u, series.f
    rate2, coriolis = weight * arrays.rate * arrays.rate, weight * 2.0 * arrays.rate * (k + 1)
    curvature = 1.0 / arrays.radius
    one = block * u.shape[1] * WIDTH  # where the block begins in u and f, and so
    three = 3 * one  # in r
    now = three + 3 * WIDTH * k
    x0, y0, z0 = load3(r, three)
    xk, yk, zk = load3(r, now)
    gx = gy = gz = splat(0.0)
    if arrays.linear_gravity:
        gy = 3.0 * yk
    elif k == 0:
        u0 = (2.0 * y0 + (x0 * x0 + y0 * y0 + z0 * z0) * curvature) * curvature
        p = (1.0 + u0) * sqrt(1.0 + u0)
        f0 = u0 * (3.0 + u0 * (3.0 + u0)) / (p * (1.0 + p))
        store(u, one, u0)
        store(f, one, f0)
        gx, gy, gz = f0 * x0, f0 * (y0 + arrays.radius), f0 * z0
    else:
        square = 2.0 * (x0 * xk + y0 * yk + z0 * zk)
        total, share, inverse = splat(0.0), float(k), 1.0 / (1.0 + load(u, one))
        for b in range(1, k):
            here, there = one + WIDTH * b, one + WIDTH * (k - b)
            xb, yb, zb = load3(r, three + 3 * WIDTH * b)
            xc, yc, zc = load3(r, three + 3 * WIDTH * (k - b))
            fb = load(f, here)
            square += xb * xc + yb * yc + zb * zc
            gx += fb * xc
            gy += fb * yc
            gz += fb * zc
            share += 0.5
            total += share * load(u, here) * load(f, there)
        f0, uk = load(f, one), (2.0 * yk + square * curvature) * curvature
        fk = (1.5 * uk * (1.0 - f0) - total * (1.0 / k)) * inverse
        store(u, one + WIDTH * k, uk)
        store(f, one + WIDTH * k, fk)
        gx += f0 * xk + fk * x0
        gy += f0 * yk + fk * (y0 + arrays.radius)
        gz += f0 * zk + fk * z0
    vx, vy, _ = load3(r, now + 3 * WIDTH)
    ax, ay, az = rate2 * gx + coriolis * vy, rate2 * gy - coriolis * vx, rate2 * (gz - zk)
    store3(r, now + 6 * WIDTH, ax, ay, az)


@njit(inline="always", error_model="numpy", fastmath={"contract"})
def _difference(series, block, k):
    """Coefficient k of the vectors along tethers."""
    r, ends = series.r, series.ends
    x = y = z = splat(0.0)
    for entry in range(ends.start[block], ends.stop[block]):
        i, sign = ends.index[entry], load(ends.weight, WIDTH * entry)
        x += sign * r[i // WIDTH, k, 0, i % WIDTH]
        y += sign * r[i // WIDTH, k, 1, i % WIDTH]
        z += sign * r[i // WIDTH, k, 2, i % WIDTH]
    store3(series.e, 3 * WIDTH * (block * series.e.shape[1] + k), x, y, z)


@njit(inline="always", error_model="numpy", fastmath={"contract"})
def _pull(series, block, k, share):
    """Add what tethers do to coefficient k of the positions."""
    tether, pulls = series.tether, series.pulls
    now = 3 * WIDTH * (block * series.r.shape[1] + k)
    x, y, z = load3(series.r, now)
    for entry in range(pulls.start[block], pulls.stop[block]):
        a, weight = pulls.index[entry], share * load(pulls.weight, WIDTH * entry)
        x += weight * tether[a // WIDTH, 4, a % WIDTH]
        y += weight * tether[a // WIDTH, 5, a % WIDTH]
        z += weight * tether[a // WIDTH, 6, a % WIDTH]
    store3(series.r, now, x, y, z)


@njit(inline="always", error_model="numpy", fastmath={"contract"})
def _square(series, block, k):
    """Coefficient k of the squared lengths."""
    one = block * series.q.shape[1] * WIDTH
    square = splat(0.0)
    for b in range(k + 1):
        xb, yb, zb = load3(series.e, 3 * (one + WIDTH * b))
        xc, yc, zc = load3(series.e, 3 * (one + WIDTH * (k - b)))
        square += xb * xc + yb * yc + zb * zc
    store(series.q, one + WIDTH * k, square)


@njit(inline="always", error_model="numpy", fastmath={"contract"})
def _tension(series, block, k):
    """Coefficient k of the tethers' pull, and coefficient k + 1 of their squared lengths."""
    e, q, d, g, p, tether = series.e, series.q, series.d, series.g, series.p, series.tether
    one, row = block * q.shape[1] * WIDTH, block * ROWS * WIDTH
    x0, y0, z0 = load3(e, 3 * one)
    xn, yn, zn = load3(e, 3 * (one + WIDTH * (k + 1)))
    square = 2.0 * (x0 * xn + y0 * yn + z0 * zn)
    rate = inverse = fx = fy = fz = splat(0.0)
    shorter = 1.0 / load(q, one)
    for b in range(1, k + 1):
        here, there = one + WIDTH * b, one + WIDTH * (k - b)
        xb, yb, zb = load3(e, 3 * here)
        xc, yc, zc = load3(e, 3 * (there + WIDTH))
        before = load(p, here - WIDTH)
        square += xb * xc + yb * yc + zb * zc
        fx += before * xc
        fy += before * yc
        fz += before * zc
        rate += load(q, here) * load(d, there)
        inverse += load(d, here - WIDTH) * load(g, there)
    store(q, one + WIDTH * (k + 1), square)
    dk = ((k + 1.0) * square - rate) * shorter
    store(d, one + WIDTH * k, dk)
    stiffness, rest = load(tether, row + STIFFNESS), load(tether, row + REST)
    if k == 0:
        length = sqrt(load(q, one))
        store(g, one, 1.0 / length)
        pk = stiffness * (length - rest) / length
    else:
        gk = (-0.5 / k) * inverse
        store(g, one + WIDTH * k, gk)
        pk = 0.0 - stiffness * rest * gk
    pk = only_where(load(tether, row + TAUT), pk + load(tether, row + DAMPING) * dk)
    store(p, one + WIDTH * k, pk)
    store3(tether, row + PULL, fx + pk * x0, fy + pk * y0, fz + pk * z0)


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


@kernel
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
