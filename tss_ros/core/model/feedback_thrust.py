"""Thrusters of satellites that hold the formation's turn and its shape: a law of the state alone.

With d the place of a satellite from the mean of all satellites, e its velocity there against a
rigid turn at the spin asked about, and s its place in the steady shape, turned about z by the angle
that fits the satellites best, the thruster gives

    u = -c (e - omega z x d) - k (d - s),    F = u / sqrt(1 + |u|^2 / F_max^2),

F = u without a limit. Neither term knows where the formation is on its orbit, and the second one
not how far it has turned: without a limit the thrusts of all satellites sum up to zero, and the
second ones have no torque about z. Linear but for that angle and the limit, so stated as code.

Measured against the orbit frame itself, -c v would drive the formation away: the centre of mass
would obey lambda (lambda^3 + 2 d lambda^2 + (d^2 + Omega^2) lambda - 3 d Omega^2) = 0 in the orbit
plane, d = c/m, which has a root next to 3 d.
"""

import math

from tss_ros.core.numerics.simd import kernel, python_kernel


@kernel
def _means(arrays, v, r):
    """Mean position and velocity of the satellites, along x, y and z."""
    x = y = z = vx = vy = vz = 0.0 * r[0, 0]
    for i in range(r.shape[0]):
        share = arrays.satellite[i]
        if share > 0.0:
            x += share * r[i, 0]
            y += share * r[i, 1]
            z += share * r[i, 2]
            vx += share * v[i, 0]
            vy += share * v[i, 1]
            vz += share * v[i, 2]
    return x, y, z, vx, vy, vz


@kernel
def _fit(arrays, r, x, y):
    """Sums whose direction is the angle by which the steady shape fits best about a mean place."""
    along = across = 0.0 * x
    for i in range(r.shape[0]):
        if arrays.satellite[i] > 0.0:
            sx, sy = arrays.shape[i, 0], arrays.shape[i, 1]
            dx, dy = r[i, 0] - x, r[i, 1] - y
            along += sx * dx + sy * dy
            across += sx * dy - sy * dx
    return along, across


@kernel
def _wanted(arrays, i, v, r, means, c, s):
    """The thrust u of a satellite before it is limited [N]; c, s: of the shape's angle."""
    damping, keeping, _ = arrays.gains
    turn = arrays.aim - arrays.spin
    x, y, z, vx, vy, vz = means
    dx, dy, dz = r[i, 0] - x, r[i, 1] - y, r[i, 2] - z
    sx, sy, sz = arrays.shape[i, 0], arrays.shape[i, 1], arrays.shape[i, 2]
    return (
        -damping * (v[i, 0] - vx + turn * dy) - keeping * (dx - c * sx + s * sy),
        -damping * (v[i, 1] - vy - turn * dx) - keeping * (dy - s * sx - c * sy),
        -damping * (v[i, 2] - vz) - keeping * (dz - sz),
    )


@kernel
def _angle(arrays, r, x, y):
    """Cosine and sine of the shape's angle, and the sums that give it."""
    along, across = _fit(arrays, r, x, y)
    size = math.sqrt(along * along + across * across)
    return along / size, across / size, along, across


@python_kernel
def add_thrust(arrays, v, r, a):
    """Add the accelerations of the satellites by their thrusters to a (n, 3) [m/s^2]."""
    means = _means(arrays, v, r)
    _, keeping, limit = arrays.gains
    c, s = 1.0 + 0.0 * means[0], 0.0 * means[0]
    if keeping > 0.0:
        c, s, _, _ = _angle(arrays, r, means[0], means[1])
    inverse = 1.0 / (limit * limit) if limit > 0.0 else 0.0
    for i in range(r.shape[0]):
        if arrays.satellite[i] > 0.0:
            x, y, z = _wanted(arrays, i, v, r, means, c, s)
            share = arrays.inv_mass[i] / math.sqrt(1.0 + inverse * (x * x + y * y + z * z))
            a[i, 0] += share * x
            a[i, 1] += share * y
            a[i, 2] += share * z


@python_kernel
def add_thrust_gradient(arrays, pair, v, r, by_r, by_v):
    """Add its derivatives by position and velocity to blocks (3, 3).

    Parameters
    ----------
    arrays : KernelArrays
    pair : ndarray, shape (k, 2)
        Where the blocks (i, j) and (j, i) of each pair of satellites i < j are stored.
    v, r : ndarray, shape (n, 3)
    by_r, by_v : ndarray, shape (blocks, 3, 3)
        Blocks i < n are the diagonal ones.
    """
    means = _means(arrays, v, r)
    damping, keeping, limit = arrays.gains
    c, s, along, across, size = 1.0, 0.0, 0.0, 0.0, 1.0
    if keeping > 0.0:
        c, s, along, across = _angle(arrays, r, means[0], means[1])
        size = along * along + across * across
    turn, inverse = arrays.aim - arrays.spin, 1.0 / (limit * limit) if limit > 0.0 else 0.0
    for i in range(r.shape[0]):
        if arrays.satellite[i] == 0.0:
            continue
        u = _wanted(arrays, i, v, r, means, c, s)
        square = 1.0 + inverse * (u[0] * u[0] + u[1] * u[1] + u[2] * u[2])
        share, less = arrays.inv_mass[i] / math.sqrt(square), inverse / square
        # A turn of the shape moves its places so.
        tx = -s * arrays.shape[i, 0] - c * arrays.shape[i, 1]
        ty = c * arrays.shape[i, 0] - s * arrays.shape[i, 1]
        for j in range(r.shape[0]):
            if arrays.satellite[j] == 0.0:
                continue
            block, part = i, (1.0 if i == j else 0.0) - arrays.satellite[j]
            if i != j:
                block = pair[_pair_of(arrays, min(i, j), max(i, j)), 0 if i < j else 1]
            c_part, k_part = damping * part, keeping * part
            # The shape's angle by the place of j, times what it does to the thrust.
            sx, sy = arrays.shape[j, 0], arrays.shape[j, 1]
            gx = -keeping * (along * sy + across * sx) / size
            gy = keeping * (along * sx - across * sy) / size
            to_r, to_v = by_r[block], by_v[block]
            _add_column(to_v, 0, share, less, u, -c_part, 0.0, 0.0)
            _add_column(to_v, 1, share, less, u, 0.0, -c_part, 0.0)
            _add_column(to_v, 2, share, less, u, 0.0, 0.0, -c_part)
            _add_column(to_r, 0, share, less, u, tx * gx - k_part, ty * gx + turn * c_part, 0.0)
            _add_column(to_r, 1, share, less, u, tx * gy - turn * c_part, ty * gy - k_part, 0.0)
            _add_column(to_r, 2, share, less, u, 0.0, 0.0, -k_part)


@kernel
def _add_column(matrix, q, share, less, u, x, y, z):
    """Add to column q what a change x, y, z of the thrust wanted makes of the acceleration."""
    along = less * (u[0] * x + u[1] * y + u[2] * z)
    matrix[0, q] += share * (x - along * u[0])
    matrix[1, q] += share * (y - along * u[1])
    matrix[2, q] += share * (z - along * u[2])


@kernel
def _pair_of(arrays, i, j):
    """Which of the pairs of satellites, in rising order, a pair i < j is."""
    count = a = b = 0
    for k in range(arrays.satellite.size):
        if arrays.satellite[k] > 0.0:
            a += k < i
            b += k < j
            count += 1
    return a * count - a * (a + 1) // 2 + b - a - 1
