"""The variations of an explicit step, Eqs. (12) and (52), as series beside `taylor_motion`."""

from typing import NamedTuple

import numpy as np
from numba import njit

from tss_ros.core.motion.taylor_motion import longest
from tss_ros.core.numerics.simd import WIDTH, kernel, lane, load, load3, splat, store, store3


class Varied(NamedTuple):
    """Taylor coefficients of k variations, in blocks of W = `WIDTH` lanes.

    Attributes
    ----------
    x : ndarray, shape (k/W, N+1, n, 3, W)
        Variations of position.
    gradient, terms : ndarray, shape (n, N+1, 3, 3) and (n,)
        The gravity gradient at each bead, and how many of its coefficients matter.
    e : ndarray, shape (m, N+1, 3, W)
        For one block at a time, difference of the variations along every tether.
    eta, pull : ndarray, shape (m, N+1, W)
        Likewise, variation of the logarithm of the squared length and of tension over length.
    room : ndarray, shape (4, N+1)
    """

    x: np.ndarray
    gradient: np.ndarray
    terms: np.ndarray
    e: np.ndarray
    eta: np.ndarray
    pull: np.ndarray
    room: np.ndarray


@njit(cache=True, nogil=True, error_model="numpy")
def blank(beads, tethers, order, columns):
    """Room for a `Varied`; next to none where there are no columns."""
    size = order + 1 if columns > 0 else 0
    return Varied(
        np.zeros((-(-columns // WIDTH), size, beads, 3, WIDTH)),
        np.empty((beads, size, 3, 3)),
        np.empty(beads, dtype=np.int64),
        np.empty((tethers, size, 3, WIDTH)),
        np.empty((tethers, size, WIDTH)),
        np.empty((tethers, size, WIDTH)),
        np.empty((4, size)),
    )


@kernel
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
    x, gradient, terms, room = varied.x, varied.gradient, varied.terms, varied.room
    size, beads = x.shape[1], x.shape[2]
    for i in range(beads):
        terms[i] = _gravity_gradient(arrays, series, i, step, gradient[i], room)
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
                _gravity(arrays, varied, first, i, k)
            for a in range(arrays.rest.size):
                if taut[a]:
                    _tension(arrays, series, varied, first, a, k)


@kernel
def _gravity(arrays, varied, first, bead, k):
    """Write what gravity and Coriolis acceleration do to coefficient k + 2 of one bead."""
    x, gradient = varied.x, varied.gradient
    row = 3 * WIDTH * x.shape[2]  # from one coefficient to the next
    now = first + row * k + 3 * WIDTH * bead
    coriolis, weight = 2.0 * arrays.rate * (k + 1), 1.0 / ((k + 1) * (k + 2))
    vx, vy, _ = load3(x, now + row)
    ax, ay, az = coriolis * vy, -coriolis * vx, splat(0.0)
    for term in range(min(k + 1, varied.terms[bead])):
        px, py, pz = load3(x, now - row * term)
        d = gradient[bead, term]
        xx, xy, xz, yy, yz, zz = d[0, 0], d[0, 1], d[0, 2], d[1, 1], d[1, 2], d[2, 2]
        ax += xx * px + xy * py + xz * pz
        ay += xy * px + yy * py + yz * pz
        az += xz * px + yz * py + zz * pz
    store3(x, now + 2 * row, weight * ax, weight * ay, weight * az)


@kernel
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
    store(varied.eta, WIDTH * size * a, (2.0 / series.q[block, 0, at]) * along)


@kernel
def _tension(arrays, series, varied, first, a, k):
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
    ratio = elastic = fx = fy = fz = splat(0.0)
    sx = sy = sz = 0.0  # the pull that goes with s0 is not known yet
    for term in range(k + 1):
        before = now - WIDTH * term
        ex, ey, ez = load3(e, 3 * before)
        share, p = load(eta, before), series.p[block, term, at]
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
        ratio += series.q[block, term + 1, at] * share
        elastic += series.g[block, term, at] * share
    share = (1.0 / series.q[block, 0, at]) * (2.0 * along - ratio)
    store(eta, now + WIDTH, share)
    strength = (0.5 * arrays.damping[a] * (k + 1)) * share
    strength += (0.5 * arrays.stiffness[a] * arrays.rest[a]) * elastic
    store(pull, now, strength)
    fx, fy, fz = fx + s0x * strength, fy + s0y * strength, fz + s0z * strength
    weight = 1.0 / ((k + 1) * (k + 2))
    mi, mj = weight * arrays.inv_mass[i], weight * arrays.inv_mass[j]
    xi, yi, zi = load3(x, one + row)
    store3(x, one + row, xi - mi * fx, yi - mi * fy, zi - mi * fz)
    xj, yj, zj = load3(x, two + row)
    store3(x, two + row, xj + mj * fx, yj + mj * fy, zj + mj * fz)


@kernel
def _gravity_gradient(arrays, series, bead, step, out, room):
    """Coefficients of the gravity gradient at one bead, (terms, 3, 3), and how many there are."""
    block, lane = bead // WIDTH, bead % WIDTH
    r, u, f = series.r[block, :, :, lane], series.u[block, :, lane], series.f[block, :, lane]
    rate2 = arrays.rate * arrays.rate
    out[0] = 0.0
    if arrays.linear_gravity:
        out[0, 1, 1], out[0, 2, 2] = 3.0 * rate2, -rate2
        return 1
    order = r.shape[0] - 1
    along, w = room[:3], room[3]
    reach, small = 1.0, 0
    for k in range(order - 1):
        if k == 0:
            w[0] = 3.0 * rate2 * (1.0 - f[0]) / (1.0 + u[0])
        else:
            total = 0.0
            for b in range(1, k + 1):
                total -= (k + 1.5 * b) * u[b] * w[k - b]
            w[k] = total / (k * (1.0 + u[0]))
        size = 0.0
        for p in range(3):
            along[p, k] = w[k] if p == 1 else 0.0
            for b in range(k + 1):
                along[p, k] += w[b] * r[k - b, p] / arrays.radius
        for p in range(3):
            for c in range(p, 3):
                total = along[p, k] if c == 1 else 0.0
                for b in range(k + 1):
                    total += along[p, b] * r[k - b, c] / arrays.radius
                if p == c:
                    total += rate2 * f[k]
                    if p == 2 and k == 0:
                        total -= rate2
                out[k, p, c] = total
                out[k, c, p] = total
                size = max(size, abs(total))
        if size * reach * step * step < 1e-17:
            small += 1
            if small == 2:
                return k - 1
        else:
            small = 0
        reach *= step
    return order - 1


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
