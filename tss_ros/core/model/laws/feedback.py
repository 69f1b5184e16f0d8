"""Thrusters of satellites that hold the formation's turn and its shape.

With d the place of a satellite from the mean of all satellites, e its velocity there and s its
place in the steady shape, turned about z by the angle that fits the satellites best, the thruster
gives

    u = -c (e - omega z x d) - k (d - s),    F = u / sqrt(1 + |u|^2 / F_max^2),

F = u without a limit. Neither term knows where the formation is on its orbit, and the second one
not how far it has turned: without a limit the thrusts of all satellites sum up to zero, and the
second ones have no torque about z.

Measured against the orbit frame itself, -c v would drive the formation away: the centre of mass
would obey lambda (lambda^3 + 2 d lambda^2 + (d^2 + Omega^2) lambda - 3 d Omega^2) = 0 in the orbit
plane, d = c/m, which has a root next to 3 d.
"""

from tss_ros.core.model.contract import Guided, LawParameter, ThrustLaw, Vector
from tss_ros.core.numerics.expressions import Expression

ROTATION_DAMPING = LawParameter(
    "rotation_damping_n_s_per_m",
    "Thrust of every satellite over its speed against the rigid turn", "N s/m",
    minimum=0.0, maximum=1e3, default=0.0, note="0 is none",
)  # fmt: skip
SHAPE_KEEPING = LawParameter(
    "shape_keeping_n_per_m",
    "Thrust of every satellite over its distance from its place in the steady shape", "N/m",
    minimum=0.0, maximum=1e3, default=0.0, note="0 is none",
)  # fmt: skip
#: Of the thrust by all laws together.
THRUST_LIMIT = LawParameter(
    "thrust_limit_n", "Most that the feedback lets a satellite thrust", "N",
    minimum=0.0, maximum=1e6, default=0.0, note="0 is no limit",
)  # fmt: skip


def damping(g: Guided, rotation_damping_n_s_per_m: Expression) -> Vector:
    """-c (e - omega z x d)."""
    pairs = zip(g.velocity, g.rigid_velocity)
    return tuple(-rotation_damping_n_s_per_m * (own - rigid) for own, rigid in pairs)


def keeping(g: Guided, shape_keeping_n_per_m: Expression) -> Vector:
    """-k (d - s)."""
    return tuple(-shape_keeping_n_per_m * (own - there) for own, there in zip(g.place, g.shape))


ROTATION_DAMPING_LAW = ThrustLaw(
    "rotation_damping", "against the speed relative to the rigid turn", damping,
    (ROTATION_DAMPING,),
)  # fmt: skip
SHAPE_KEEPING_LAW = ThrustLaw(
    "shape_keeping", "towards the steady shape", keeping, (SHAPE_KEEPING,)
)
