"""A tether that only pulls and gets stiffer as it is stretched, as woven ones do."""

from tss_ros.core.model.contract import LawParameter, Stretched, TetherLaw
from tss_ros.core.numerics.expressions import Expression

STIFFENING = LawParameter(
    "stiffening", "Growth of EA with strain: EA (1 + stiffening strain)", "-",
    minimum=0.0, maximum=1e6, default=0.0, note="only for tether_law stiffening",
)  # fmt: skip


def tension(t: Stretched, stiffening: Expression) -> Expression:
    """EA (1 + b s) s + C l', s = (l - L) / L the strain and b the stiffening."""
    strain = (t.length - t.rest) / t.rest
    return t.stiffness * (t.length - t.rest) * (1.0 + stiffening * strain) + t.damping * t.rate


def energy(t: Stretched, stiffening: Expression) -> Expression:
    """EA L (s^2 / 2 + b s^3 / 3)."""
    strain = (t.length - t.rest) / t.rest
    return 0.5 * t.stiffness * (t.length - t.rest) ** 2 * (1.0 + stiffening * strain / 1.5)


LAW = TetherLaw(
    "stiffening", "spring that stiffens and damper, never pushing", tension, energy,
    pushes=False, parameters=(STIFFENING,),
)  # fmt: skip
