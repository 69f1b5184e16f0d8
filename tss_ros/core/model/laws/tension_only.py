"""A tether that only pulls: the greater of zero and spring plus damper."""

from tss_ros.core.model.contract import TetherLaw
from tss_ros.core.model.laws.kelvin_voigt import energy, tension

LAW = TetherLaw("tension_only", "spring and damper, never pushing", tension, energy, pushes=False)
