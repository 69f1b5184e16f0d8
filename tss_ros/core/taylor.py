"""One explicit step: Taylor series of the motion and of its variations, Eqs. (1), (12) and (52).

The orbit frame is used, where the equations do not contain time. Coefficients follow from
recurrences (A. Jorba and M. Zou, "A software package for the numerical integration of ODEs by means
of high-order Taylor methods", Exp. Math. 14 (2005) 99-117) and describe the whole step.
"""

import math
from collections import namedtuple

import numpy as np
from numba import njit

#: Taylor coefficients by powers of time since the start of the step, up to N, the order. r
#: (n,3,N+1): positions. e (m,3,N+1), q (m,N+1): vectors along tethers and their squared lengths;
#: where taut also d: the rate of log q, g: q to the power -1/2, p: tension over length. u, f
#: (n,N+1): gravity's distance variable and factor as in `forces.acceleration`.
Series = namedtuple("Series", "r e q d g p u f")


def order_for(rtol):
    """Order of the series: four more than Jorba and Zou's, for tethers that swing undamped."""
    return math.ceil(5.0 - 0.5 * math.log(rtol))


@njit(cache=True, nogil=True, error_model="numpy")
def blank(beads, tethers, order):
    """Room for a `Series`."""
    size = order + 1
    tether = np.empty((5, tethers, size))
    return Series(
        np.empty((beads, 3, size)), np.empty((tethers, 3, size)), tether[0], tether[1], tether[2],
        tether[3], np.empty((beads, size)), np.empty((beads, size)),
    )


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def expand(plant, taut, v, r, series):
    """Fill `series` with the motion that starts at v, r (n,3) [m/s, m] in the orbit frame."""
    order = series.r.shape[2] - 1
    beads, tethers = r.shape[0], plant.rest.size
    for i in range(beads):
        for c in range(3):
            series.r[i, c, 0] = r[i, c]
            series.r[i, c, 1] = v[i, c]
    for a in range(tethers):
        i, j = plant.ends[a, 0], plant.ends[a, 1]
        square = 0.0
        for c in range(3):
            series.e[a, c, 0] = r[i, c] - r[j, c]
            square += series.e[a, c, 0] * series.e[a, c, 0]
        series.q[a, 0] = square
    for k in range(order - 1):
        _gravity(plant, series.r, series.u, series.f, k)
        _tension(plant, taut, series, k)
        weight = 1.0 / ((k + 1) * (k + 2))
        for i in range(beads):
            for c in range(3):
                series.r[i, c, k + 2] *= weight
    for a in range(tethers):
        i, j = plant.ends[a, 0], plant.ends[a, 1]
        square = 0.0
        for c in range(3):
            series.e[a, c, order] = series.r[i, c, order] - series.r[j, c, order]
            for b in range(order + 1):
                square += series.e[a, c, b] * series.e[a, c, np.uintp(order - b)]
        series.q[a, order] = square


@njit(inline="always", error_model="numpy", fastmath={"contract"})
def _gravity(plant, r, u, f, k):
    """Write coefficient k of gravity, centrifugal and Coriolis acceleration into r[:, :, k + 2]."""
    rate2, coriolis, radius = plant.rate * plant.rate, 2.0 * plant.rate * (k + 1), plant.radius
    # Divisions are what takes longest here, so there are few.
    curvature, share = 1.0 / radius, 1.0 / max(k, 1)
    for i in range(r.shape[0]):
        x0, y0, z0 = r[i, 0, 0], r[i, 1, 0], r[i, 2, 0]
        xk, yk, zk = r[i, 0, k], r[i, 1, k], r[i, 2, k]
        gx = gy = gz = 0.0
        if plant.linear_gravity:
            gy = 3.0 * yk
        elif k == 0:
            u0 = (2.0 * y0 + (x0 * x0 + y0 * y0 + z0 * z0) * curvature) * curvature
            p = (1.0 + u0) * math.sqrt(1.0 + u0)
            f0 = u0 * (3.0 + u0 * (3.0 + u0)) / (p * (1.0 + p))
            u[i, 0], f[i, 0] = u0, f0
            gx, gy, gz = f0 * x0, f0 * (y0 + radius), f0 * z0
        else:
            square = 2.0 * (x0 * xk + y0 * yk + z0 * zk)
            total, weight = 0.0, float(k)
            for b in range(1, k):
                c = np.uintp(k - b)
                xc, yc, zc, fb = r[i, 0, c], r[i, 1, c], r[i, 2, c], f[i, b]
                square += r[i, 0, b] * xc + r[i, 1, b] * yc + r[i, 2, b] * zc
                gx += fb * xc
                gy += fb * yc
                gz += fb * zc
                weight += 0.5
                total += weight * u[i, b] * f[i, c]
            f0, uk = f[i, 0], (2.0 * yk + square * curvature) * curvature
            fk = (1.5 * uk * (1.0 - f0) - total * share) / (1.0 + u[i, 0])
            u[i, k], f[i, k] = uk, fk
            gx += f0 * xk + fk * x0
            gy += f0 * yk + fk * (y0 + radius)
            gz += f0 * zk + fk * z0
        r[i, 0, k + 2] = rate2 * gx + coriolis * r[i, 1, k + 1]
        r[i, 1, k + 2] = rate2 * gy - coriolis * r[i, 0, k + 1]
        r[i, 2, k + 2] = rate2 * (gz - zk)


@njit(inline="always", error_model="numpy", fastmath={"contract"})
def _tension(plant, taut, series, k):
    """Add coefficient k of the tethers' acceleration to r[:, :, k + 2], and find q[:, k + 1]."""
    r, e, q, d, g, p, _, _ = series
    share = -0.5 / max(k, 1)
    for a in range(q.shape[0]):
        i, j = plant.ends[a, 0], plant.ends[a, 1]
        x0, y0, z0 = e[a, 0, 0], e[a, 1, 0], e[a, 2, 0]
        xn, yn = r[i, 0, k + 1] - r[j, 0, k + 1], r[i, 1, k + 1] - r[j, 1, k + 1]
        zn = r[i, 2, k + 1] - r[j, 2, k + 1]
        e[a, 0, k + 1], e[a, 1, k + 1], e[a, 2, k + 1] = xn, yn, zn
        square = 2.0 * (x0 * xn + y0 * yn + z0 * zn)
        if not taut[a]:
            for b in range(1, k + 1):
                c = np.uintp(k + 1 - b)
                square += (
                    e[a, 0, b] * e[a, 0, c] + e[a, 1, b] * e[a, 1, c] + e[a, 2, b] * e[a, 2, c]
                )
            q[a, k + 1] = square
            continue
        rate = inverse = fx = fy = fz = 0.0
        for b in range(1, k + 1):
            c, before = np.uintp(k + 1 - b), np.uintp(k - b)
            xc, yc, zc, pb = e[a, 0, c], e[a, 1, c], e[a, 2, c], p[a, b - 1]
            square += e[a, 0, b] * xc + e[a, 1, b] * yc + e[a, 2, b] * zc
            fx += pb * xc
            fy += pb * yc
            fz += pb * zc
            rate += q[a, b] * d[a, before]
            inverse += d[a, b - 1] * g[a, before]
        q[a, k + 1] = square
        dk = ((k + 1) * square - rate) / q[a, 0]
        d[a, k] = dk
        if k == 0:
            length = math.sqrt(q[a, 0])
            g[a, 0] = 1.0 / length
            pk = plant.stiffness[a] * (length - plant.rest[a]) / length
        else:
            g[a, k] = share * inverse
            pk = -plant.stiffness[a] * plant.rest[a] * g[a, k]
        pk += 0.5 * plant.damping[a] * dk
        p[a, k] = pk
        fx, fy, fz = fx + pk * x0, fy + pk * y0, fz + pk * z0
        mi, mj = plant.inv_mass[i], plant.inv_mass[j]
        r[i, 0, k + 2] -= mi * fx
        r[i, 1, k + 2] -= mi * fy
        r[i, 2, k + 2] -= mi * fz
        r[j, 0, k + 2] += mj * fx
        r[j, 1, k + 2] += mj * fy
        r[j, 2, k + 2] += mj * fz


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def longest_step(series_r, tolerance, speed):
    """Step [s] whose last two terms are within the tolerance, relative to a speed [m/s]."""
    order = series_r.shape[2] - 1
    last = before = 0.0
    for i in range(series_r.shape[0]):
        for c in range(3):
            last = max(last, abs(series_r[i, c, order]))
            before = max(before, abs(series_r[i, c, order - 1]))
    return _longest(tolerance * speed, last, before, order)


@njit(cache=True, nogil=True, error_model="numpy")
def _longest(allowed, last, before, order):
    """Step whose last two terms of velocity are `allowed` [m/s], given the positions' largest.

    Those of position are then smaller still, in units of the formation, for steps below a turn.
    """
    step = _reach(allowed, last * order, order - 1)
    return min(step, _reach(allowed, before * (order - 1), order - 2))


@njit(cache=True, nogil=True, error_model="numpy")
def _reach(allowed, coefficient, power):
    return (allowed / coefficient) ** (1.0 / power) if coefficient > 0.0 else np.inf


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def evaluate(series_r, time, v, r):
    """Write velocity and position (n,3) at a time [s] since the start of the step."""
    order = series_r.shape[2] - 1
    for i in range(r.shape[0]):
        for c in range(3):
            x = series_r[i, c]
            place, rate = x[order], order * x[order]
            for k in range(order - 1, 0, -1):
                place = place * time + x[k]
                rate = rate * time + k * x[k]
            r[i, c] = place * time + x[0]
            v[i, c] = rate


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def expand_variations(plant, taut, series, step, x_v, x_r, out):
    """Fill `out` with the variations that start at x_v, x_r along the motion of `series`.

    Parameters
    ----------
    plant, taut : Plant, ndarray
    series : Series
        As `expand` leaves it.
    step : float
        [s] longest time the result is used for: terms that do not matter by then are left out.
    x_v, x_r : ndarray, shape (n, 3, k)
        In the orbit frame.
    out : ndarray, shape (N+1, n, 3, k)
        Coefficients of the variations of position.
    """
    order, beads, columns = out.shape[0] - 1, out.shape[1], out.shape[3]
    tethers = plant.rest.size
    coriolis = 2.0 * plant.rate
    out[0] = x_r
    out[1] = x_v
    terms = np.empty(beads, dtype=np.int64)
    gradient = np.empty((beads, order + 1, 3, 3))
    for i in range(beads):
        terms[i] = _gravity_gradient(
            plant, series.r[i], series.u[i], series.f[i], step, gradient[i]
        )
    # Along every tether: difference e of the variations, logarithmic variation eta of the squared
    # length and variation of tension over length.
    e = np.empty((tethers, order + 1, 3, columns))
    q = np.empty((tethers, order + 1, columns))
    eta = np.empty((tethers, order + 1, columns))
    pull = np.empty((tethers, order + 1, columns))
    force = np.empty((3, columns))
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
            elastic = 0.5 * plant.stiffness[a] * plant.rest[a]
            damped = 0.5 * plant.damping[a] * (k + 1)
            now, later = pull[a, k], eta[a, k + 1]
            for b in range(columns):
                now[b] = damped * later[b]
            for term in range(k + 1):
                weight, old = elastic * series.g[a, term], eta[a, k - term]
                for b in range(columns):
                    now[b] += weight * old[b]
            force[:] = 0.0
            for c in range(3):
                total = force[c]
                for term in range(k + 1):
                    p, s = series.p[a, term], series.e[a, c, term]
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


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _along(series, plant, a, k, out, e, q, eta):
    """Coefficient k of one tether's differences, of q's variation and of its ratio to q."""
    i, j = plant.ends[a, 0], plant.ends[a, 1]
    columns = out.shape[3]
    new, x, y = e[k], out[k, i], out[k, j]
    for c in range(3):
        for b in range(columns):
            new[c, b] = x[c, b] - y[c, b]
    now, ratio = q[k], eta[k]
    now[:] = 0.0
    for term in range(k + 1):
        s0, s1 = 2.0 * series.e[a, 0, term], 2.0 * series.e[a, 1, term]
        s2, old = 2.0 * series.e[a, 2, term], e[k - term]
        for b in range(columns):
            now[b] += s0 * old[0, b] + s1 * old[1, b] + s2 * old[2, b]
    ratio[:] = now
    for term in range(1, k + 1):
        weight, old_ratio = series.q[a, term], eta[k - term]
        for b in range(columns):
            ratio[b] -= weight * old_ratio[b]
    weight = 1.0 / series.q[a, 0]
    for b in range(columns):
        ratio[b] *= weight


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _gravity_gradient(plant, r, u, f, step, out):
    """Coefficients of the gravity gradient at one bead, (terms, 3, 3), and how many there are."""
    rate2 = plant.rate * plant.rate
    out[0] = 0.0
    if plant.linear_gravity:
        out[0, 1, 1], out[0, 2, 2] = 3.0 * rate2, -rate2
        return 1
    order = r.shape[1] - 1
    w = np.empty(order)
    along = np.empty((3, order))
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
                along[p, k] += w[b] * r[p, k - b] / plant.radius
        for p in range(3):
            for c in range(p, 3):
                total = along[p, k] if c == 1 else 0.0
                for b in range(k + 1):
                    total += along[p, b] * r[c, k - b] / plant.radius
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


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def longest_step_of_variations(out, tolerance, speed):
    """The same as `longest_step` for variations (N+1, n, 3, k), scaled like the state."""
    order = out.shape[0] - 1
    last = before = 0.0
    for x in out[order].reshape(-1):
        last = max(last, abs(x))
    for x in out[order - 1].reshape(-1):
        before = max(before, abs(x))
    return _longest(tolerance * speed, last, before, order)


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
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
