"""Where the centre of the formation is on an orbit that is no circle, as kernels ask for it.

The orbit is a table of polynomials in time, in axes fixed among the stars that are those of the
orbit frame at time 0. The kernels' frame turns about their z axis.
"""

import math

from tss_ros.core.numerics.simd import kernel, lane_by_lane

#: Where in what `sky_at` tells the rate n = sqrt(mu / R^3) is, and where the centre's velocity is.
MEAN_MOTION, CENTRE_VELOCITY = 4, 6


@kernel
def _turned(c, s, x, y):
    """Components along axes turned by an angle of this cosine and sine."""
    return c * x + s * y, c * y - s * x


@kernel
def _sky_at(arrays, time):
    starts, table = arrays.orbit_starts, arrays.orbit_table
    # One orbit's table serves for all if they are alike.
    t = time - arrays.orbit_period * math.floor(time * arrays.orbits_per_s)
    low, high = 0, table.shape[0]
    while high - low > 1:
        middle = (low + high) // 2
        if starts[middle] <= t:
            low = middle
        else:
            high = middle
    half = 0.5 * (starts[low + 1] - starts[low])
    s = (t - starts[low]) / half - 1.0
    x = y = z = vx = vy = vz = 0.0
    for k in range(table.shape[1] - 1, -1, -1):
        vx, vy, vz = vx * s + x, vy * s + y, vz * s + z
        x, y, z = x * s + table[low, k, 0], y * s + table[low, k, 1], z * s + table[low, k, 2]
    angle = (arrays.rate + arrays.spin) * time
    c, s = math.cos(angle), math.sin(angle)
    x, y = _turned(c, s, x, y)
    vx, vy = _turned(c, s, vx / half, vy / half)
    radius = math.sqrt(x * x + y * y + z * z)
    px, py = _turned(c, s, arrays.pole[0], arrays.pole[1])
    sx, sy = _turned(c, s, arrays.sun[0], arrays.sun[1])
    return (
        x / radius, y / radius, z / radius, radius, math.sqrt(arrays.mu / radius) / radius,
        radius - arrays.radius, vx, vy, vz / half, px, py, arrays.pole[2], sx, sy, arrays.sun[2],
    )  # fmt: skip


#: What laws are told of the centre at a time [s], or at lanes of times, in the kernels' frame: up,
#: R, n, the climb, the centre's velocity, the pole and the Sun (`contract.Moving`).
sky_at = lane_by_lane(_sky_at)
