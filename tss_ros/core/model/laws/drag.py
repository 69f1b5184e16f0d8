"""Drag in an atmosphere that thins out exponentially and turns with the Earth."""

from tss_ros.core.model.contract import BeadLaw, LawParameter, Moving, Vector
from tss_ros.core.numerics.expressions import Expression, cross, dot, excess, exp, sqrt

#: Rate at which the Earth turns [rad/s].
EARTH_RATE_RAD_S = 7.2921159e-5

PARAMETERS = (
    LawParameter(
        "drag_m2_per_kg", "Drag coefficient times area over mass, of every bead", "m^2/kg",
        minimum=0.0, maximum=1e3, default=0.0, note="0 is no drag",
    ),
    LawParameter(
        "air_density_kg_m3", "Density of the air at `orbit_altitude_m`", "kg/m^3",
        minimum=0.0, maximum=2.0, default=3e-15,
    ),
    LawParameter(
        "scale_height_m", "Height over which the air's density falls to 1/e", "m",
        minimum=1e3, maximum=1e6, default=268e3,
    ),
)  # fmt: skip


def acceleration(
    m: Moving, drag_m2_per_kg: Expression, air_density_kg_m3: Expression, scale_height_m: Expression
) -> Vector:
    """-1/2 rho(h) (Cd A/m) |v| v, with v relative to the air and rho = rho_0 exp(-h/H)."""
    earth = tuple(EARTH_RATE_RAD_S * pole for pole in m.pole)
    spin = (-earth[0], -earth[1], m.turning - earth[2])
    turned, carried = cross(spin, m.position), cross(earth, m.up)
    v = tuple(
        own + more + centre - m.radius * air
        for own, more, centre, air in zip(m.velocity, turned, m.centre_velocity, carried)
    )
    u = (2.0 * dot(m.position, m.up) + dot(m.position, m.position) / m.radius) / m.radius
    thinner = exp(-(m.radius * excess(u, 0.5) + m.climb) / scale_height_m)
    strength = -0.5 * drag_m2_per_kg * air_density_kg_m3 * thinner * sqrt(dot(v, v))
    return strength * v[0], strength * v[1], strength * v[2]


LAW = BeadLaw(
    "drag", "drag of an exponential atmosphere", acceleration, PARAMETERS,
    by_velocity=True, from_potential=False, feels_pole="sense", typical=0.01,
)  # fmt: skip
