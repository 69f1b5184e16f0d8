"""The Earth's oblateness J2, for orbits in the plane of the equator."""

from typing import Any

from tss_ros.core.model.laws.contract import BeadLaw, LawParameter, Moving, Vector
from tss_ros.core.numerics.expressions import Expression, dot, power

#: Equatorial radius that belongs to J2 [m].
EQUATORIAL_RADIUS_M = 6378.137e3

J2 = LawParameter(
    "j2", "Oblateness of the Earth, 1.08263e-3 for the real one", "-",
    minimum=0.0, maximum=0.1, default=0.0, note="for an orbit in the plane of the equator",
)  # fmt: skip


def orbit(radius: Any, j2: Any) -> Any:
    """(Omega / n)^2 - 1 of a circular orbit: (3/2) J2 (Re/R)^2; of numbers or expressions."""
    return 1.5 * j2 * (EQUATORIAL_RADIUS_M / radius) ** 2


def acceleration(m: Moving, j2: Expression) -> Vector:
    """-(3/2) J2 mu Re^2/q^5 [(1 - 5 Z^2/q^2) (X, Y), (3 - 5 Z^2/q^2) Z], q from the Earth's centre.

    With the centrifugal force of the orbit as far as it goes faster round this Earth.
    """
    x, y, z = (r + m.radius * up for r, up in zip(m.position, m.up))
    square = dot((x, y, z), (x, y, z))
    faster = orbit(m.radius, j2) * m.mean_motion**2
    flat = faster * m.radius**5 * power(square, -2.5)
    tall = 5.0 * z**2 / square
    level = faster - flat * (1.0 - tall)
    return level * x, level * y, -flat * (3.0 - tall) * z


LAW = BeadLaw(
    "j2", "the Earth's oblateness J2", acceleration, (J2,), orbit=orbit, typical=1.08263e-3
)
