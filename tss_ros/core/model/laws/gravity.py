"""Gravity, Eq. (2), with the centrifugal force of the orbit, Eq. (9).

The two cancel to about one part in a million. Their sum is written with
f = 1 - (1 + u)^(-3/2), u = (|q|^2 - R^2) / R^2, q = r + R up, which is free of that cancellation.
"""

from tss_ros.core.model.contract import BeadLaw, Moving, Vector
from tss_ros.core.numerics.expressions import dot, excess


def acceleration(m: Moving) -> Vector:
    """-mu q / |q|^3 + n^2 (q without its part along z), Eqs. (2) and (9)."""
    u = (2.0 * dot(m.position, m.up) + dot(m.position, m.position) / m.radius) / m.radius
    f = -excess(u, -1.5)
    x, y, z = (f * (r + m.radius * up) for r, up in zip(m.position, m.up))
    return m.mean_motion**2 * x, m.mean_motion**2 * y, m.mean_motion**2 * (z - m.position[2])


def linear_acceleration(m: Moving) -> Vector:
    """n^2 (3 (r . up) up - z): the same to first order in r / R."""
    height = dot(m.position, m.up)
    x, y, z = (3.0 * height * up for up in m.up)
    return m.mean_motion**2 * x, m.mean_motion**2 * y, m.mean_motion**2 * (z - m.position[2])


LAW = BeadLaw("gravity", "gravity and the orbit's centrifugal force", acceleration)
LINEAR_LAW = BeadLaw("linear_gravity", "the same, linearised at the centre", linear_acceleration)
