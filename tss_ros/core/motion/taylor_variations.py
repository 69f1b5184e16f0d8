"""The variations of an explicit step, Eqs. (12) and (52), as series beside `taylor_motion`."""

from typing import NamedTuple

import numpy as np

from tss_ros.core.model.laws.inertia import inertia
from tss_ros.core.model.made import (
    BEAD_SLOTS,
    BY_LOGARITHM,
    GRADIENT_SLOTS,
    PULL,
    SQUARE,
    TETHER_SLOTS,
    bead_gradient_series,
)
from tss_ros.core.motion.taylor_motion import longest
from tss_ros.core.numerics.simd import (
    WIDTH,
    allocating,
    fabs,
    inlined,
    kernel,
    lane,
    larger,
    leaf,
    load,
    load3,
    number,
    separate_kernel,
    splat,
    store,
    store3,
)

#: What a coefficient of a Jacobian may do within a step, relatively, and still be left out.
NEGLIGIBLE = 1e-17


class Varied(NamedTuple):
    """Taylor coefficients of k variations, in blocks of W = `WIDTH` lanes.

    Attributes
    ----------
    x : ndarray, shape (k/W, N+1, n, 3, W)
        Variations of position.
    by_r, by_v : ndarray, shape (n/W, N+1, 3, 3, W)
        Derivatives of the beads' laws by position and velocity.
    terms : ndarray, shape (2, n/W)
        How many of their coefficients matter.
    e : ndarray, shape (m, N+1, 3, W)
        For one block at a time, difference of the variations along every tether.
    eta, pull : ndarray, shape (m, N+1, W)
        Likewise, variation of the logarithm of the squared length and of tension over length.
    room : ndarray, shape (N+1, GRADIENT_SLOTS, W)
    """

    x: np.ndarray
    by_r: np.ndarray
    by_v: np.ndarray
    terms: np.ndarray
    e: np.ndarray
    eta: np.ndarray
    pull: np.ndarray
    room: np.ndarray


@allocating
def blank(beads, tethers, order, columns):
    """Room for a `Varied`; next to none where there are no columns."""
    size, blocks = order + 1 if columns > 0 else 0, -(-beads // WIDTH)
    return Varied(
        np.zeros((-(-columns // WIDTH), size, beads, 3, WIDTH)),
        np.empty((blocks, size, 3, 3, WIDTH)),
        np.empty((blocks, size, 3, 3, WIDTH)),
        np.empty((2, blocks), dtype=np.int64),
        np.empty((tethers, size, 3, WIDTH)),
        np.empty((tethers, size, WIDTH)),
        np.empty((tethers, size, WIDTH)),
        np.empty((size, GRADIENT_SLOTS, WIDTH)),
    )


@separate_kernel
def expand_variations(arrays, taut, series, step, x_v, x_r, varied):
    """Fill `varied` with the variations that start at x_v, x_r along the motion of `series`.

    Parameters
    ----------
    arrays, taut : KernelArrays, ndarray
    series : Series
        As `expand` leaves it.
    step : float
        [s] longest time the result is used for: terms that do not matter by then are left out.
    x_v, x_r : ndarray, shape (n, 3, k)
        In the orbit frame.
    varied : Varied
    """
    x, (size, beads) = varied.x, varied.x.shape[1:3]
    for block in range(varied.terms.shape[1]):
        _bead_gradients(arrays, series, block, step, varied)
    for i in range(beads):
        for c in range(3):
            for b in range(x_r.shape[2]):
                x[b // WIDTH, 0, i, c, b % WIDTH] = x_r[i, c, b]
                x[b // WIDTH, 1, i, c, b % WIDTH] = x_v[i, c, b]
    for block in range(x.shape[0]):
        first = 3 * WIDTH * beads * size * block
        for a in range(arrays.rest.size):
            if taut[a]:
                _begin_tether(arrays, series, varied, first, a)
        for k in range(size - 2):
            for i in range(beads):
                _bead(arrays, varied, first, i, k)
            for a in range(arrays.rest.size):
                if taut[a]:
                    _tether(arrays, series, varied, first, a, k)


@inlined
def _bead(arrays, varied, first, bead, k):
    """Write what the laws of beads and inertia do to coefficient k + 2 of one bead."""
    x, block, at = varied.x, bead // WIDTH, bead % WIDTH
    row = 3 * WIDTH * x.shape[2]  # from one coefficient to the next
    now = first + row * k + 3 * WIDTH * bead
    weight, entry = 1.0 / ((k + 1) * (k + 2)), 9 * WIDTH * block * x.shape[1] + at
    px, py, _ = load3(x, now)
    vx, vy, _ = load3(x, now + row)
    ax, ay = inertia(px, py, vx, vy, 0.0, 2.0 * arrays.rate * (k + 1), arrays.drive)
    az = splat(0.0)
    for term in range(min(k + 1, varied.terms[0, block])):
        px, py, pz = load3(x, now - row * term)
        dx, dy, dz = _apply(varied.by_r, entry + 9 * WIDTH * term, px, py, pz)
        ax, ay, az = ax + dx, ay + dy, az + dz
    for term in range(min(k + 1, varied.terms[1, block])):
        px, py, pz = load3(x, now + row - row * term)
        dx, dy, dz = _apply(varied.by_v, entry + 9 * WIDTH * term, px, py, pz)
        share = k + 1.0 - term
        ax, ay, az = ax + share * dx, ay + share * dy, az + share * dz
    store3(x, now + 2 * row, weight * ax, weight * ay, weight * az)


@leaf
def _apply(matrix, one, x, y, z):
    """A matrix, whose entries lie `WIDTH` apart, times a vector of lanes."""
    w, two, last = WIDTH, one + 3 * WIDTH, one + 6 * WIDTH
    return (
        number(matrix, one) * x + number(matrix, one + w) * y + number(matrix, one + 2 * w) * z,
        number(matrix, two) * x + number(matrix, two + w) * y + number(matrix, two + 2 * w) * z,
        number(matrix, last) * x + number(matrix, last + w) * y + number(matrix, last + 2 * w) * z,
    )


@inlined
def _begin_tether(arrays, series, varied, first, a):
    """Coefficients 0 of one tether's differences and logarithmic variation."""
    i, j = arrays.ends[a, 0], arrays.ends[a, 1]
    size, block, at = varied.x.shape[1], a // WIDTH, a % WIDTH
    xi, yi, zi = load3(varied.x, first + 3 * WIDTH * i)
    xj, yj, zj = load3(varied.x, first + 3 * WIDTH * j)
    ex, ey, ez = xi - xj, yi - yj, zi - zj
    store3(varied.e, 3 * WIDTH * size * a, ex, ey, ez)
    along = (
        series.e[block, 0, 0, at] * ex
        + series.e[block, 0, 1, at] * ey
        + series.e[block, 0, 2, at] * ez
    )
    store(varied.eta, WIDTH * size * a, (2.0 / series.tethers[block, 0, SQUARE, at]) * along)


@inlined
def _tether(arrays, series, varied, first, a, k):
    """Add what one tether does to coefficient k + 2 of the beads at its ends."""
    x, e, eta, pull = varied.x, varied.e, varied.eta, varied.pull
    i, j = arrays.ends[a, 0], arrays.ends[a, 1]
    block, at, row = a // WIDTH, a % WIDTH, 3 * WIDTH * x.shape[2]
    one, two = first + row * (k + 1) + 3 * WIDTH * i, first + row * (k + 1) + 3 * WIDTH * j
    now = WIDTH * (x.shape[1] * a + k)
    xi, yi, zi = load3(x, one)
    xj, yj, zj = load3(x, two)
    ex, ey, ez = xi - xj, yi - yj, zi - zj
    store3(e, 3 * (now + WIDTH), ex, ey, ez)
    s0x, s0y, s0z = series.e[block, 0, 0, at], series.e[block, 0, 1, at], series.e[block, 0, 2, at]
    along = s0x * ex + s0y * ey + s0z * ez
    tethers, size = series.tethers, x.shape[1]
    order, square = TETHER_SLOTS * WIDTH, (TETHER_SLOTS * size * block + SQUARE) * WIDTH + at
    pulls = square + (PULL - SQUARE) * WIDTH
    by_logarithm = square + (BY_LOGARITHM - SQUARE) * WIDTH
    ratio = elastic = fx = fy = fz = splat(0.0)
    sx = sy = sz = 0.0  # the pull that goes with s0 is not known yet
    for term in range(k + 1):
        before = now - WIDTH * term
        ex, ey, ez = load3(e, 3 * before)
        share, p = load(eta, before), number(tethers, pulls + order * term)
        if term > 0:
            strength = load(pull, before)
            fx += sx * strength
            fy += sy * strength
            fz += sz * strength
        fx += p * ex
        fy += p * ey
        fz += p * ez
        sx = series.e[block, term + 1, 0, at]
        sy = series.e[block, term + 1, 1, at]
        sz = series.e[block, term + 1, 2, at]
        along += sx * ex + sy * ey + sz * ez
        ratio += number(tethers, square + order * (term + 1)) * share
        elastic += number(tethers, by_logarithm + order * term) * share
    share = (1.0 / number(tethers, square)) * (2.0 * along - ratio)
    store(eta, now + WIDTH, share)
    strength = (0.5 * arrays.damping[a] * (k + 1)) * share + elastic
    store(pull, now, strength)
    fx, fy, fz = fx + s0x * strength, fy + s0y * strength, fz + s0z * strength
    weight = 1.0 / ((k + 1) * (k + 2))
    mi, mj = weight * arrays.inv_mass[i], weight * arrays.inv_mass[j]
    xi, yi, zi = load3(x, one + row)
    store3(x, one + row, xi - mi * fx, yi - mi * fy, zi - mi * fz)
    xj, yj, zj = load3(x, two + row)
    store3(x, two + row, xj + mj * fx, yj + mj * fy, zj + mj * fz)


@inlined
def _bead_gradients(arrays, series, block, step, varied):
    """Coefficients of the derivatives of a block's laws, and how many there are of each."""
    by_r, by_v, size = varied.by_r, varied.by_v, series.r.shape[1]
    three, from_ = 3 * WIDTH * size * block, WIDTH * BEAD_SLOTS * size * block
    reach, small, terms, terms_v = 1.0, 0, 0, 0
    for k in range(size - 2):
        to = 9 * WIDTH * (size * block + k)
        for i in range(to, to + 9 * WIDTH, WIDTH):
            store(by_r, i, splat(0.0))
            store(by_v, i, splat(0.0))
        bead_gradient_series(
            arrays, series.r, three, series.beads, from_, varied.room, 0, k, by_r, by_v, to
        )
        largest = largest_v = splat(0.0)
        for i in range(to, to + 9 * WIDTH, WIDTH):
            largest = larger(largest, fabs(load(by_r, i)))
            largest_v = larger(largest_v, fabs(load(by_v, i)))
        matters = _largest_lane(largest) * reach * step * step >= NEGLIGIBLE
        matters_v = _largest_lane(largest_v) * reach * step >= NEGLIGIBLE
        terms = k + 1 if matters else terms
        terms_v = k + 1 if matters_v else terms_v
        small = 0 if matters or matters_v else small + 1
        if small == 2:
            break
        reach *= step
    varied.terms[0, block], varied.terms[1, block] = terms, terms_v


@leaf
def _largest_lane(x):
    return max(max(lane(x, 0), lane(x, 1)), max(lane(x, 2), lane(x, 3)))


@kernel
def longest_step_of_variations(x, tolerance, speed):
    """The same as `longest_step` for variations (k/W,N+1,n,3,W), scaled like the state."""
    order, beads = x.shape[1] - 1, x.shape[2]
    last = before = 0.0
    for block in range(x.shape[0]):
        for i in range(beads):
            for c in range(3):
                for at in range(WIDTH):
                    last = max(last, abs(x[block, order, i, c, at]))
                    before = max(before, abs(x[block, order - 1, i, c, at]))
    return longest(tolerance * speed, last, before, order)


@kernel
def evaluate_variations(x, time, x_v, x_r):
    """Write the variations of velocity and position at a time [s] since the start of the step."""
    size, beads = x.shape[1], x.shape[2]
    for block in range(x.shape[0]):
        columns = min(WIDTH, x_r.shape[2] - WIDTH * block)
        for i in range(beads):
            for c in range(3):
                place = rate = splat(0.0)
                for k in range(size - 1, -1, -1):
                    rate = rate * time + place
                    place = place * time + load(
                        x, WIDTH * (((block * size + k) * beads + i) * 3 + c)
                    )
                for at in range(columns):
                    x_r[i, c, WIDTH * block + at] = lane(place, at)
                    x_v[i, c, WIDTH * block + at] = lane(rate, at)
