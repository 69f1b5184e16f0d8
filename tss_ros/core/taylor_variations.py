"""The variations of an explicit step, Eqs. (12) and (52), as Taylor series beside `taylor`."""

from collections import namedtuple

import numpy as np
from numba import njit

from tss_ros.core.lanes import WIDTH, kernel
from tss_ros.core.taylor import longest

#: Taylor coefficients of k variations. x (N+1,n,3,k): of position. gradient (n,N+1,3,3) and terms
#: (n,): the gravity gradient at each bead and how many of its coefficients matter. Along every
#: tether, e (m,N+1,3,k): difference of the variations, q, eta (m,N+1,k): variation of the squared
#: length and of its logarithm, pull (m,N+1,k): of tension over length. force (3,k), room (4,N+1).
Varied = namedtuple("Varied", "x gradient terms e q eta pull force room")


@njit(cache=True, nogil=True, error_model="numpy")
def blank(beads, tethers, order, columns):
    """Room for a `Varied`; next to none where there are no columns."""
    size = order + 1 if columns > 0 else 0
    along = (tethers, size, columns)
    return Varied(
        np.empty((size, beads, 3, columns)),
        np.empty((beads, size, 3, 3)),
        np.empty(beads, dtype=np.int64),
        np.empty((tethers, size, 3, columns)),
        np.empty(along),
        np.empty(along),
        np.empty(along),
        np.empty((3, columns)),
        np.empty((4, size)),
    )


@kernel
def expand_variations(plant, taut, series, step, x_v, x_r, varied):
    """Fill `varied` with the variations that start at x_v, x_r along the motion of `series`.

    Parameters
    ----------
    plant, taut : Plant, ndarray
    series : Series
        As `expand` leaves it.
    step : float
        [s] longest time the result is used for: terms that do not matter by then are left out.
    x_v, x_r : ndarray, shape (n, 3, k)
        In the orbit frame.
    varied : Varied
    """
    out, gradient, terms, e, q, eta, pull, force, room = varied
    order, beads, columns = out.shape[0] - 1, out.shape[1], out.shape[3]
    tethers, coriolis = plant.rest.size, 2.0 * plant.rate
    for i in range(beads):
        for c in range(3):
            for b in range(columns):
                out[0, i, c, b], out[1, i, c, b] = x_r[i, c, b], x_v[i, c, b]
        terms[i] = _gravity_gradient(plant, series, i, step, gradient[i], room)
    for a in range(tethers):
        if taut[a]:
            for k in range(2):
                _along(series, plant, a, k, out, e[a], q[a], eta[a])
    for k in range(order - 1):
        for i in range(beads):
            new = out[k + 2, i]
            for b in range(columns):
                new[0, b] = coriolis * (k + 1) * out[k + 1, i, 1, b]
                new[1, b] = -coriolis * (k + 1) * out[k + 1, i, 0, b]
                new[2, b] = 0.0
            for term in range(min(k + 1, terms[i])):
                d, x = gradient[i, term], out[k - term, i]
                d00, d01, d02 = d[0, 0], d[0, 1], d[0, 2]
                d11, d12, d22 = d[1, 1], d[1, 2], d[2, 2]
                for b in range(columns):
                    new[0, b] += d00 * x[0, b] + d01 * x[1, b] + d02 * x[2, b]
                    new[1, b] += d01 * x[0, b] + d11 * x[1, b] + d12 * x[2, b]
                    new[2, b] += d02 * x[0, b] + d12 * x[1, b] + d22 * x[2, b]
        for a in range(tethers):
            if not taut[a]:
                continue
            if k > 0:
                _along(series, plant, a, k + 1, out, e[a], q[a], eta[a])
            i, j = plant.ends[a, 0], plant.ends[a, 1]
            block, lane = a // WIDTH, a % WIDTH
            elastic = 0.5 * plant.stiffness[a] * plant.rest[a]
            damped = 0.5 * plant.damping[a] * (k + 1)
            now, later = pull[a, k], eta[a, k + 1]
            for b in range(columns):
                now[b] = damped * later[b]
            for term in range(k + 1):
                weight, old = elastic * series.g[block, term, lane], eta[a, k - term]
                for b in range(columns):
                    now[b] += weight * old[b]
            force[:] = 0.0
            for c in range(3):
                total = force[c]
                for term in range(k + 1):
                    p, s = series.p[block, term, lane], series.e[block, term, c, lane]
                    x, y = e[a, k - term, c], pull[a, k - term]
                    for b in range(columns):
                        total[b] += p * x[b] + s * y[b]
            mi, mj = plant.inv_mass[i], plant.inv_mass[j]
            one, other = out[k + 2, i], out[k + 2, j]
            for c in range(3):
                for b in range(columns):
                    one[c, b] -= mi * force[c, b]
                    other[c, b] += mj * force[c, b]
        weight = 1.0 / ((k + 1) * (k + 2))
        flat = out[k + 2].reshape(-1)
        for b in range(flat.size):
            flat[b] *= weight


@kernel
def _along(series, plant, a, k, out, e, q, eta):
    """Coefficient k of one tether's differences, of q's variation and of its ratio to q."""
    i, j = plant.ends[a, 0], plant.ends[a, 1]
    block, lane, columns = a // WIDTH, a % WIDTH, out.shape[3]
    new, x, y = e[k], out[k, i], out[k, j]
    for c in range(3):
        for b in range(columns):
            new[c, b] = x[c, b] - y[c, b]
    now, ratio = q[k], eta[k]
    now[:] = 0.0
    for term in range(k + 1):
        s0 = 2.0 * series.e[block, term, 0, lane]
        s1 = 2.0 * series.e[block, term, 1, lane]
        s2, old = 2.0 * series.e[block, term, 2, lane], e[k - term]
        for b in range(columns):
            now[b] += s0 * old[0, b] + s1 * old[1, b] + s2 * old[2, b]
    for b in range(columns):
        ratio[b] = now[b]
    for term in range(1, k + 1):
        weight, old_ratio = series.q[block, term, lane], eta[k - term]
        for b in range(columns):
            ratio[b] -= weight * old_ratio[b]
    weight = 1.0 / series.q[block, 0, lane]
    for b in range(columns):
        ratio[b] *= weight


@kernel
def _gravity_gradient(plant, series, bead, step, out, room):
    """Coefficients of the gravity gradient at one bead, (terms, 3, 3), and how many there are."""
    block, lane = bead // WIDTH, bead % WIDTH
    r, u, f = series.r[block, :, :, lane], series.u[block, :, lane], series.f[block, :, lane]
    rate2 = plant.rate * plant.rate
    out[0] = 0.0
    if plant.linear_gravity:
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
                along[p, k] += w[b] * r[k - b, p] / plant.radius
        for p in range(3):
            for c in range(p, 3):
                total = along[p, k] if c == 1 else 0.0
                for b in range(k + 1):
                    total += along[p, b] * r[k - b, c] / plant.radius
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
def longest_step_of_variations(out, tolerance, speed):
    """The same as `longest_step` for variations (N+1, n, 3, k), scaled like the state."""
    order = out.shape[0] - 1
    last = before = 0.0
    for x in out[order].reshape(-1):
        last = max(last, abs(x))
    for x in out[order - 1].reshape(-1):
        before = max(before, abs(x))
    return longest(tolerance * speed, last, before, order)


@kernel
def evaluate_variations(out, time, x_v, x_r):
    """Write the variations of velocity and position at a time [s] since the start of the step."""
    order = out.shape[0] - 1
    place, rate = x_r.reshape(-1), x_v.reshape(-1)
    place[:] = 0.0
    rate[:] = 0.0
    for k in range(order, 0, -1):
        x = out[k].reshape(-1)
        for b in range(place.size):
            place[b] = place[b] * time + x[b]
            rate[b] = rate[b] * time + k * x[b]
    x = out[0].reshape(-1)
    for b in range(place.size):
        place[b] = place[b] * time + x[b]
