"""Reels that give way to the tension of their tethers.

A reel pays out the segment next to it, of rest length L at tension T, as

    m L'' = T - T_0 - F,    F = c L' + k (L - L_0),

L_0 being the rest length of the segment. m is the inertia of the drum over the square of its
radius, c what its brake or motor does against the rate, and k draws the rest length back. L and L'
are states of the system: each reel adds two multipliers. Laws of users add other forces F.

Fast changes of tension meet c and m; what is slower than c / k is left to the tether. In a turn a
longer tether pulls harder, by T/L for each metre: k has to be above that, or reels run away.
"""

from tss_ros.core.model.contract import LawParameter, Reeled, ReelLaw
from tss_ros.core.numerics.expressions import Expression

REEL_DAMPING = LawParameter(
    "reel_damping_n_s_per_m", "Tension of every reel over the rate at which it pays out", "N s/m",
    minimum=0.0, maximum=1e12, default=0.0, note="0 is fixed tethers",
)  # fmt: skip
REEL_STIFFNESS = LawParameter(
    "reel_stiffness_n_per_m", "Tension of every reel over the rest length that it paid out", "N/m",
    minimum=0.0, maximum=1e9, default=1.0,
)  # fmt: skip
REEL_TENSION = LawParameter(
    "reel_tension_n", "Tension at which every reel has paid out nothing", "N",
    minimum=0.0, maximum=1e9, default=0.0,
    note="0 is the steady tension next to each reel",
)  # fmt: skip
REEL_MASS = LawParameter(
    "reel_mass_kg", "Inertia of every reel's drum over the square of its radius", "kg",
    minimum=1e-3, maximum=1e6, default=1.0,
)  # fmt: skip


def giving(
    r: Reeled, reel_damping_n_s_per_m: Expression, reel_stiffness_n_per_m: Expression
) -> Expression:
    """c L' + k (L - L_0)."""
    return reel_damping_n_s_per_m * r.rate + reel_stiffness_n_per_m * r.paid_out


YIELDING_LAW = ReelLaw(
    "yielding", "gives way to tension as a spring and a damper", giving,
    (REEL_DAMPING, REEL_STIFFNESS),
)  # fmt: skip
