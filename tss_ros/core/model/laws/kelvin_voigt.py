"""The paper's tether: a spring and a damper side by side, Eqs. (3) and (6).

A taut tether that shortens fast enough pushes: the damper may outweigh the spring.
"""

from tss_ros.core.model.contract import Stretched, TetherLaw
from tss_ros.core.numerics.expressions import Expression


def tension(t: Stretched) -> Expression:
    """EA/L (l - L) + C l', Eqs. (3) and (6)."""
    return t.stiffness * (t.length - t.rest) + t.damping * t.rate


def energy(t: Stretched) -> Expression:
    """EA/L (l - L)^2 / 2."""
    return 0.5 * t.stiffness * (t.length - t.rest) ** 2


LAW = TetherLaw("kelvin_voigt", "spring and damper, which may push", tension, energy, pushes=True)
