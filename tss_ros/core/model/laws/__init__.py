"""The laws of the model, a file each; a new one is registered here and nowhere else."""

from tss_ros.core.model.laws import (
    drag,
    feedback,
    gravity,
    kelvin_voigt,
    oblateness,
    orbit,
    solar_pressure,
    stiffening,
    tension_only,
)
from tss_ros.core.model.laws.contract import BeadLaw, LawParameter, TetherLaw

#: How tethers pull: one of them is chosen by `tether_law`.
TETHER_LAWS: tuple[TetherLaw, ...] = (kelvin_voigt.LAW, tension_only.LAW, stiffening.LAW)
#: What accelerates beads: those whose first parameter is not zero act together.
BEAD_LAWS: tuple[BeadLaw, ...] = (
    gravity.LAW, gravity.LINEAR_LAW, oblateness.LAW, drag.LAW, solar_pressure.LAW,
)  # fmt: skip
#: All parameters of laws, each once, those of the feedback and the elements of the orbit.
LAW_PARAMETERS: tuple[LawParameter, ...] = (
    *dict.fromkeys(p for law in (*TETHER_LAWS, *BEAD_LAWS) for p in law.parameters),
    *feedback.PARAMETERS,
    *orbit.ELEMENTS,
)
#: Laws that may be chosen by their names alone: perturbations of the orbit.
PERTURBATIONS = {law.name: law for law in BEAD_LAWS if law.typical}
