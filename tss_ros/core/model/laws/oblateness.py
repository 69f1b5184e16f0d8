"""The Earth's oblateness J2."""

from typing import Any

from tss_ros.core.model.contract import BeadLaw, LawParameter, Moving, Vector
from tss_ros.core.numerics.expressions import Expression, dot, power

#: Equatorial radius that belongs to J2 [m].
EQUATORIAL_RADIUS_M = 6378.137e3

J2 = LawParameter(
    "j2", "Oblateness of the Earth, 1.08263e-3 for the real one", "-",
    minimum=0.0, maximum=0.1, default=0.0,
)  # fmt: skip


def orbit(radius: Any, j2: Any) -> Any:
    """(Omega / n)^2 - 1 of a circular orbit: (3/2) J2 (Re/R)^2; of numbers or expressions."""
    return 1.5 * j2 * (EQUATORIAL_RADIUS_M / radius) ** 2


def acceleration(m: Moving, j2: Expression) -> Vector:
    """-(3/2) J2 mu Re^2/q^5 [(1 - 5 s^2) q + 2 Z pole], q from the Earth's centre, Z = q . pole.

    s = Z/|q|. Less the same at the centre of the orbit frame, and with the centrifugal force of an
    orbit in the plane of the equator as far as it goes faster round this Earth.
    """
    place = tuple(r + m.radius * up for r, up in zip(m.position, m.up))
    square, above, tilt = dot(place, place), dot(place, m.pole), dot(m.up, m.pole)
    faster = orbit(m.radius, j2) * m.mean_motion**2
    flat = faster * m.radius**5 * power(square, -2.5)
    level = faster - flat * (1.0 - 5.0 * above**2 / square)
    at_centre = faster * m.radius * tilt
    x, y, z = (
        level * q - 2.0 * flat * above * pole + at_centre * (2.0 * pole - 5.0 * tilt * up)
        for q, up, pole in zip(place, m.up, m.pole)
    )
    return x, y, z - faster * m.position[2]


LAW = BeadLaw(
    "j2", "the Earth's oblateness J2", acceleration, (J2,), orbit=orbit, feels_pole="axis",
    typical=1.08263e-3,
)  # fmt: skip
