"""The public names of the core; `tss_ros.core` has them all and loads this when asked for one."""

from tss_ros.core.errors import Cancelled, IntegrationError, NoSteadyState, TssError
from tss_ros.core.model.commands import Commands
from tss_ros.core.model.configurations import averaged_state, deviation, disturbed, initial_state
from tss_ros.core.model.elements import orbit_elements
from tss_ros.core.model.failures import Failure
from tss_ros.core.model.forces import elastic_energy, pushing_share, tether_state
from tss_ros.core.model.formations import FORMATIONS, Satellite, Tether, assemble, formation, ring
from tss_ros.core.model.laws import LAW_PARAMETERS, PERTURBATIONS, TETHER_LAWS
from tss_ros.core.model.orbits import ReferenceOrbit
from tss_ros.core.model.parameters import PARAMETERS, parameter_of, with_parameter
from tss_ros.core.model.reel_plans import reel_plan, reel_profile
from tss_ros.core.model.reels import deployed_system, whole_state
from tss_ros.core.model.system import State, System
from tss_ros.core.motion.propagator import Propagator
from tss_ros.core.stability.confirmation import Confirmation, DisturbedMotion, confirm
from tss_ros.core.stability.critical_rates import CAUSES, CriticalRate, find_critical_rates
from tss_ros.core.stability.family import SPECIAL_KINDS, Family, FamilyPoint, SpecialPoint
from tss_ros.core.stability.floquet import compute_floquet
from tss_ros.core.stability.follow import follow
from tss_ros.core.stability.growth import GROWTH_VERDICTS, GrowthResult, lyapunov_exponents
from tss_ros.core.stability.mode_shapes import (
    DIRECTIONS,
    Mode,
    ModeMotion,
    compute_modes,
    mode_motion,
)
from tss_ros.core.stability.modes import FAMILIES
from tss_ros.core.stability.parallel import (
    ConfirmationJob,
    CriticalRatesJob,
    EnsembleJob,
    FamilyJob,
    FloquetJob,
    sweep,
)
from tss_ros.core.stability.resonances import name_resonance
from tss_ros.core.stability.result import METHODS, VERDICTS, FloquetResult, in_words
from tss_ros.core.stability.special_curves import CurvePoint, SpecialCurve, follow_special
from tss_ros.core.trajectory import Trajectory, simulate

__all__ = [
    "CAUSES",
    "DIRECTIONS",
    "FAMILIES",
    "FORMATIONS",
    "GROWTH_VERDICTS",
    "LAW_PARAMETERS",
    "METHODS",
    "SPECIAL_KINDS",
    "PARAMETERS",
    "PERTURBATIONS",
    "TETHER_LAWS",
    "VERDICTS",
    "Cancelled",
    "Commands",
    "ConfirmationJob",
    "Confirmation",
    "CriticalRate",
    "CurvePoint",
    "DisturbedMotion",
    "EnsembleJob",
    "Failure",
    "Family",
    "FamilyJob",
    "FamilyPoint",
    "FloquetResult",
    "GrowthResult",
    "IntegrationError",
    "CriticalRatesJob",
    "Mode",
    "ModeMotion",
    "NoSteadyState",
    "Propagator",
    "ReferenceOrbit",
    "FloquetJob",
    "Satellite",
    "SpecialCurve",
    "SpecialPoint",
    "State",
    "System",
    "Tether",
    "Trajectory",
    "TssError",
    "assemble",
    "averaged_state",
    "compute_floquet",
    "compute_modes",
    "confirm",
    "deployed_system",
    "deviation",
    "disturbed",
    "elastic_energy",
    "find_critical_rates",
    "follow",
    "follow_special",
    "formation",
    "in_words",
    "initial_state",
    "lyapunov_exponents",
    "mode_motion",
    "name_resonance",
    "orbit_elements",
    "parameter_of",
    "pushing_share",
    "reel_plan",
    "reel_profile",
    "ring",
    "simulate",
    "sweep",
    "tether_state",
    "whole_state",
    "with_parameter",
]

#: Old names of jobs, kept for one release.
OLD_NAMES = {"Rate": FloquetJob, "Interval": CriticalRatesJob, "Check": ConfirmationJob}
