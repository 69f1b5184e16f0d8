"""Kernels of the thrusters: the thrust laws summed and limited, and the derivatives of that.

What a law states of one satellite depends on all of them: through their mean place and velocity,
and through the angle of the steady shape. The chain rule through these is here, the derivatives of
the laws are made of their statements.
"""

import math

from tss_ros.core.model.laws import LAW_PARAMETERS, THRUST_LAWS
from tss_ros.core.model.laws.feedback import THRUST_LIMIT
from tss_ros.core.model.made import CONSTANT_SOURCES, sum_of_laws
from tss_ros.core.model.stated import MASS, PLACE, SHAPE, SPEED, SPIN, TURN, thrust_of
from tss_ros.core.numerics.expressions import derivative
from tss_ros.core.numerics.simd import inlined, kernel, python_kernel

_LIMIT = LAW_PARAMETERS.index(THRUST_LIMIT)
#: What the made functions are given of a satellite.
_SEEN = (*PLACE, *SPEED, *SHAPE, MASS, TURN)
_VALUE = "arrays, seen"
_INPUTS = {s: f"seen[{k}]" for k, s in enumerate(_SEEN)} | {SPIN: "arrays.spin"} | CONSTANT_SOURCES
#: Thrusts of all laws, in their order.
THRUSTS = tuple(map(thrust_of, THRUST_LAWS))


def _sum(name, outputs):
    return sum_of_laws(name, THRUST_LAWS, outputs, (_VALUE, _INPUTS), "arrays.thrusting")


def _slopes(by):
    """Row by row, the derivatives of all laws by a vector."""
    return [[derivative(a, b) for a in thrust for b in by] for thrust in THRUSTS]


#: Thrust wanted of a satellite [N], and its derivatives by place, velocity and shape (9 each).
_wanted = _sum("thrust", THRUSTS)
_by_place = _sum("thrust_by_place", _slopes(PLACE))
_by_speed = _sum("thrust_by_speed", _slopes(SPEED))
_by_shape = _sum("thrust_by_shape", _slopes(SHAPE))
#: How it changes with the rate that is aimed at.
_by_turn = _sum("thrust_by_turn", _slopes((TURN,)))


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
    """Cosine and sine of the angle by which the steady shape fits best about a mean place.

    And the sums whose direction it is; without a shape there is nothing to turn.
    """
    along = across = 0.0 * x
    if arrays.shape.shape[0] == 0:
        return 1.0 + along, across, 1.0 + along, across
    for i in range(r.shape[0]):
        if arrays.satellite[i] > 0.0:
            sx, sy = arrays.shape[i, 0], arrays.shape[i, 1]
            dx, dy = r[i, 0] - x, r[i, 1] - y
            along += sx * dx + sy * dy
            across += sx * dy - sy * dx
    size = math.sqrt(along * along + across * across)
    return along / size, across / size, along, across


@inlined
def _shape(arrays, i):
    """Place of a satellite in the steady shape, 0 where no law asks for it."""
    if arrays.shape.shape[0] == 0:
        return 0.0, 0.0, 0.0
    return arrays.shape[i, 0], arrays.shape[i, 1], arrays.shape[i, 2]


@inlined
def _seen(arrays, i, v, r, means, c, s):
    """What the laws see of a satellite: the numbers of `_SEEN`."""
    x, y, z, vx, vy, vz = means
    sx, sy, sz = _shape(arrays, i)
    return (
        r[i, 0] - x, r[i, 1] - y, r[i, 2] - z, v[i, 0] - vx, v[i, 1] - vy, v[i, 2] - vz,
        c * sx - s * sy, s * sx + c * sy, sz, 1.0 / arrays.inv_mass[i], arrays.aim - arrays.spin,
    )  # fmt: skip


@inlined
def _inverse_limit(arrays):
    """One over the square of the most that a satellite may thrust; 0 without a limit."""
    limit = arrays.constants[_LIMIT]
    return 1.0 / (limit * limit) if limit > 0.0 else 0.0


@python_kernel
def add_thrust(arrays, v, r, a):
    """Add the accelerations of the satellites by their thrusters to a (n, 3) [m/s^2]."""
    means = _means(arrays, v, r)
    c, s, _, _ = _fit(arrays, r, means[0], means[1])
    inverse = _inverse_limit(arrays)
    for i in range(r.shape[0]):
        if arrays.satellite[i] > 0.0:
            x, y, z = _wanted(arrays, _seen(arrays, i, v, r, means, c, s))
            share = arrays.inv_mass[i] / math.sqrt(1.0 + inverse * (x * x + y * y + z * z))
            a[i, 0] += share * x
            a[i, 1] += share * y
            a[i, 2] += share * z


@kernel
def _limited(u, share, less, x, y, z):
    """What a change x, y, z of the thrust wanted, u, makes of the acceleration."""
    along = less * (u[0] * x + u[1] * y + u[2] * z)
    return share * (x - along * u[0]), share * (y - along * u[1]), share * (z - along * u[2])


@kernel
def _columns(u, share, less, d):
    """The same of each column of a matrix, given row by row."""
    return (
        _limited(u, share, less, d[0], d[3], d[6]),
        _limited(u, share, less, d[1], d[4], d[7]),
        _limited(u, share, less, d[2], d[5], d[8]),
    )


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
    c, s, along, across = _fit(arrays, r, means[0], means[1])
    size, inverse = along * along + across * across, _inverse_limit(arrays)
    for i in range(r.shape[0]):
        if arrays.satellite[i] == 0.0:
            continue
        seen = _seen(arrays, i, v, r, means, c, s)
        u = _wanted(arrays, seen)
        square = 1.0 + inverse * (u[0] * u[0] + u[1] * u[1] + u[2] * u[2])
        share, less = arrays.inv_mass[i] / math.sqrt(square), inverse / square
        by_place = _columns(u, share, less, _by_place(arrays, seen))
        by_speed = _columns(u, share, less, _by_speed(arrays, seen))
        b = _columns(u, share, less, _by_shape(arrays, seen))
        # A turn of the shape moves its places across them, and changes the acceleration so.
        sx, sy = seen[6], seen[7]
        tx, ty = sx * b[1][0] - sy * b[0][0], sx * b[1][1] - sy * b[0][1]
        tz = sx * b[1][2] - sy * b[0][2]
        for j in range(r.shape[0]):
            if arrays.satellite[j] == 0.0:
                continue
            block, part = i, (1.0 if i == j else 0.0) - arrays.satellite[j]
            if i != j:
                block = pair[_pair_of(arrays, min(i, j), max(i, j)), 0 if i < j else 1]
            # The shape's angle by the place of j.
            sx, sy, _ = _shape(arrays, j)
            angle = (-(along * sy + across * sx) / size, (along * sx - across * sy) / size, 0.0)
            for q in range(3):
                for p in range(3):
                    by_r[block, p, q] += part * by_place[q][p]
                    by_v[block, p, q] += part * by_speed[q][p]
                by_r[block, 0, q] += tx * angle[q]
                by_r[block, 1, q] += ty * angle[q]
                by_r[block, 2, q] += tz * angle[q]


@python_kernel
def turn_damping(arrays, place):
    """Thrust [N] along a rigid turn over a speed [m/s] that the turn lacks, both small.

    Parameters
    ----------
    arrays : KernelArrays
    place : ndarray, shape (n, 3)
        [m] of the beads in the turn, from the mean of the satellites.
    """
    along = square = 0.0
    for i in range(place.shape[0]):
        if arrays.satellite[i] > 0.0:
            x, y, z = place[i, 0], place[i, 1], place[i, 2]
            mass = 1.0 / arrays.inv_mass[i]
            ux, uy, _ = _by_turn(arrays, (x, y, z, 0.0, 0.0, 0.0, x, y, z, mass, 0.0))
            along += x * uy - y * ux
            square += x * x + y * y
    return along / square


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
