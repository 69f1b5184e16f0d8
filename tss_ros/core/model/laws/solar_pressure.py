"""The pressure of sunlight on beads that absorb all of it.

The Sun stays where it is: it moves by a degree in a day. Nothing is ever in the Earth's shadow.
"""

from tss_ros.core.model.contract import BeadLaw, LawParameter, Moving, Vector
from tss_ros.core.numerics.expressions import Expression

#: Pressure of sunlight on a black surface at the Earth's distance from the Sun [N/m^2].
PRESSURE_N_M2 = 4.56e-6
#: Tilt of the equator against the ecliptic [deg].
OBLIQUITY_DEG = 23.44

PARAMETERS = (
    LawParameter(
        "solar_pressure_m2_per_kg",
        "Radiation pressure coefficient times area over mass, of every bead", "m^2/kg",
        minimum=0.0, maximum=1e3, default=0.0, note="0 is no sunlight",
    ),
    LawParameter(
        "sun_longitude_deg", "Longitude of the Sun on the ecliptic, from the vernal equinox", "deg",
        minimum=-360.0, maximum=360.0, default=0.0,
    ),
)  # fmt: skip


def acceleration(
    m: Moving, solar_pressure_m2_per_kg: Expression, sun_longitude_deg: Expression
) -> Vector:
    """-P (Cr A/m) along the unit vector to the Sun, which its longitude makes (`model.orbits`)."""
    x, y, z = (-PRESSURE_N_M2 * solar_pressure_m2_per_kg * s for s in m.sun)
    return x, y, z


LAW = BeadLaw(
    "solar_pressure", "pressure of sunlight, without shadow", acceleration, PARAMETERS,
    keeps_plane=False, feels_stars=True, typical=0.01,
)  # fmt: skip
