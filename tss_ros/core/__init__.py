"""Dynamics and stability of spinning tethered satellite systems; usable without ROS.

SI units. States are (n, 3) arrays in the orbit frame: y radially up, z along the orbit normal.
"""

from tss_ros.core.confirmation import Confirmation, confirm
from tss_ros.core.critical import CAUSES, CriticalRate, find_critical_rates
from tss_ros.core.errors import Cancelled, IntegrationError, NoSteadyState, TssError
from tss_ros.core.families import FAMILIES
from tss_ros.core.floquet import METHODS, VERDICTS, FloquetResult, compute_floquet
from tss_ros.core.forces import tether_state
from tss_ros.core.formations import FORMATIONS, Satellite, Tether, assemble, formation, ring
from tss_ros.core.motion import Propagator
from tss_ros.core.steady_state import averaged_state, deviation, disturbed, initial_state
from tss_ros.core.sweep import Check, Interval, Rate, sweep
from tss_ros.core.system import State, System

__all__ = [
    "CAUSES",
    "FAMILIES",
    "FORMATIONS",
    "METHODS",
    "VERDICTS",
    "Cancelled",
    "Check",
    "Confirmation",
    "CriticalRate",
    "FloquetResult",
    "IntegrationError",
    "Interval",
    "NoSteadyState",
    "Propagator",
    "Rate",
    "Satellite",
    "State",
    "System",
    "Tether",
    "TssError",
    "assemble",
    "averaged_state",
    "compute_floquet",
    "confirm",
    "deviation",
    "disturbed",
    "find_critical_rates",
    "formation",
    "initial_state",
    "ring",
    "sweep",
    "tether_state",
]
