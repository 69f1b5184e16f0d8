"""The laws of the model, a file each; a new one is registered here and nowhere else.

Laws of users come with installed packages or from a file: see `model.own_laws`.
"""

from tss_ros.core.model.contract import BeadLaw, LawParameter, ReelLaw, TetherLaw, ThrustLaw
from tss_ros.core.model.laws import (
    drag,
    feedback,
    gravity,
    kelvin_voigt,
    oblateness,
    orbit,
    reel,
    solar_pressure,
    stiffening,
    tension_only,
)
from tss_ros.core.model.own_laws import own_laws

#: How tethers pull: one of them is chosen by `tether_law`.
TETHER_LAWS: tuple[TetherLaw, ...] = (kelvin_voigt.LAW, tension_only.LAW, stiffening.LAW)
#: What accelerates beads: those whose first parameter is not zero act together.
BEAD_LAWS: tuple[BeadLaw, ...] = (
    gravity.LAW, gravity.LINEAR_LAW, oblateness.LAW, drag.LAW, solar_pressure.LAW,
)  # fmt: skip
#: What thrusters of satellites do: likewise.
THRUST_LAWS: tuple[ThrustLaw, ...] = (feedback.ROTATION_DAMPING_LAW, feedback.SHAPE_KEEPING_LAW)
#: How reels hold their tethers: likewise.
REEL_LAWS: tuple[ReelLaw, ...] = (reel.YIELDING_LAW,)
#: Parameters that no law has for itself: of thrusters, of reels, and the elements of the orbit.
_OTHERS = (feedback.THRUST_LIMIT, reel.REEL_TENSION, reel.REEL_MASS, *orbit.ELEMENTS)


def _act_with():
    served = {
        p.name: [law for law in (*BEAD_LAWS, *THRUST_LAWS, *REEL_LAWS) if p in law.parameters]
        for p in LAW_PARAMETERS
    }
    served |= {feedback.THRUST_LIMIT.name: THRUST_LAWS}
    served |= dict.fromkeys((reel.REEL_TENSION.name, reel.REEL_MASS.name), REEL_LAWS)
    first = {name: tuple(law.parameters[0].name for law in laws) for name, laws in served.items()}
    return {name: others for name, others in first.items() if others and name not in others}


_OWN = own_laws((*TETHER_LAWS, *BEAD_LAWS, *THRUST_LAWS, *REEL_LAWS), _OTHERS)
TETHER_LAWS += tuple(law for law in _OWN if isinstance(law, TetherLaw))
BEAD_LAWS += tuple(law for law in _OWN if isinstance(law, BeadLaw))
THRUST_LAWS += tuple(law for law in _OWN if isinstance(law, ThrustLaw))
REEL_LAWS += tuple(law for law in _OWN if isinstance(law, ReelLaw))
_ALL = (*TETHER_LAWS, *BEAD_LAWS, *THRUST_LAWS, *REEL_LAWS)
#: All parameters of laws, each once, and the others.
LAW_PARAMETERS: tuple[LawParameter, ...] = (
    *dict.fromkeys(p for law in _ALL for p in law.parameters),
    *_OTHERS,
)
#: Parameters that have an effect only where one of others is not zero, with these others: the
#: first parameters of the laws that they serve.
ACT_WITH: dict[str, tuple[str, ...]] = _act_with()
#: Laws that may be chosen by their names alone: perturbations of the orbit.
PERTURBATIONS = {law.name: law for law in BEAD_LAWS if law.typical}
