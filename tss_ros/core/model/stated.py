"""What laws state, as expressions of symbols; `made` and `feedback_thrust` make kernels of them."""

from __future__ import annotations

from tss_ros.core.model.contract import (
    BeadLaw,
    Guided,
    Law,
    Moving,
    Reeled,
    ReelLaw,
    Stretched,
    TetherLaw,
    ThrustLaw,
)
from tss_ros.core.numerics.expressions import Expression, Symbol, add, cross, derivative, symbol


def _symbols(names: str, varies: bool = True) -> tuple[Symbol, ...]:
    return tuple(symbol(name, varies) for name in names.split())


STRETCHED = Stretched(
    *_symbols("length rate"), *_symbols("rest stiffness damping", varies=False)
)  # fmt: skip
R, V = _symbols("x y z"), _symbols("vx vy vz")
UP = _symbols("upx upy", varies=False)
#: What `sky.sky_at` tells of the centre of an orbit that is no circle, in its order.
SKY = _symbols(
    "sky_ux sky_uy sky_uz sky_radius sky_mean_motion sky_climb"
    " sky_vx sky_vy sky_vz sky_px sky_py sky_pz sky_sx sky_sy sky_sz", varies=False
)  # fmt: skip
RADIUS, MEAN_MOTION, TURNING, RATE = _symbols("radius mean_motion turning orbit_rate", varies=False)
#: A satellite from the mean of all: its place, its velocity in the frame of the kernels, its place
#: in the steady shape; its mass; how fast the frame turns in the orbit frame, and how much faster
#: the turn is that feedback aims at.
PLACE, SPEED, SHAPE = _symbols("dx dy dz"), _symbols("wx wy wz"), _symbols("sx sy sz")
MASS, SPIN, TURN = _symbols("mass spin turn", varies=False)
REELED = Reeled(*_symbols("paid_out reel_rate"))
#: All that laws of reels, tethers, beads on any orbit and satellites may use, beside their own
#: parameters.
OF_REELS = tuple(vars(REELED).values())
OF_TETHERS = tuple(vars(STRETCHED).values())
OF_BEADS = (*R, *V, *SKY, TURNING)
OF_SATELLITES = (*PLACE, *SPEED, *SHAPE, MASS, SPIN, TURN)


def of_parameters(law: Law) -> dict[str, Symbol]:
    """The symbols of a law's own parameters, by name."""
    return {p.name: symbol(p.name, varies=False) for p in law.parameters}


def tension_of(law: TetherLaw) -> Expression:
    """Tension of a law as an expression of `length`, `rate`, `rest`, `stiffness`, `damping`.

    Raises
    ------
    ValueError
        If its part with the rate is not damping * rate.
    """
    tension = add(law.tension(STRETCHED, **of_parameters(law)))
    if derivative(tension, STRETCHED.rate) is not STRETCHED.damping:
        raise ValueError(f"tether law {law.name!r}: the tension must grow by damping * rate")
    return tension


def energy_of(law: TetherLaw) -> Expression:
    """Elastic energy of a law, likewise."""
    return add(law.energy(STRETCHED, **of_parameters(law)))


def acceleration_of(law: BeadLaw, up: tuple) -> tuple[Expression, ...]:
    """Acceleration of a law on a circle, of x, y, z, vx, vy, vz, with `up` as given."""
    going = RADIUS * RATE
    centre, pole = (-going * up[1], going * up[0], add(0.0)), (0.0, 0.0, 1.0)
    moving = Moving(R, V, up, RADIUS, MEAN_MOTION, TURNING, add(0.0), centre, pole, sun=())
    return tuple(law.acceleration(moving, **of_parameters(law)))


def acceleration_in_sky(law: BeadLaw) -> tuple[Expression, ...]:
    """Acceleration of a law on any orbit, of x, y, z, vx, vy, vz and what `sky.sky_at` tells.

    Of the orbit's centrifugal force it has n^2 (x, y, 0) with gravity, and nothing else.
    """
    radius, mean_motion, climb = SKY[3:6]
    centre, pole, sun = SKY[6:9], SKY[9:12], SKY[12:15]
    moving = Moving(R, V, SKY[:3], radius, mean_motion, TURNING, climb, centre, pole, sun)
    x, y, z = law.acceleration(moving, **of_parameters(law))
    if law.orbit is None:
        return x, y, z
    share = law.orbit(radius, **of_parameters(law)) * mean_motion**2
    return x - share * R[0], y - share * R[1], z


def thrust_of(law: ThrustLaw) -> tuple[Expression, ...]:
    """Thrust of a law, of `PLACE`, `SPEED`, `SHAPE`, `MASS`, `SPIN` and `TURN`.

    What it takes from velocities is sorted by `TURN`: where a law asks for the velocity against the
    rigid turn, the turn of the frame drops out.
    """
    across = cross((0.0, 0.0, 1.0), PLACE)
    velocity = tuple(w + SPIN * c for w, c in zip(SPEED, across))
    rigid = tuple(SPIN * c + TURN * c for c in across)
    guided = Guided(PLACE, velocity, rigid, SHAPE, MASS)
    return tuple(map(add, law.thrust(guided, **of_parameters(law))))


def reel_force_of(law: ReelLaw) -> Expression:
    """Force of a law, of `REELED`."""
    return add(law.force(REELED, **of_parameters(law)))
