"""A system that differs from another in one parameter, named as in scenario files."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from tss_ros.core.arguments import checked, finite
from tss_ros.core.errors import TssError, allowed_words, near_match
from tss_ros.core.model.laws import LAW_PARAMETERS, PERTURBATIONS
from tss_ros.core.model.system import System

_OF_BEADS = {"satellite_mass_kg": True, "bead_mass_kg": False}
_OF_TETHERS = ("tether_length_m", "axial_stiffness_n", "damping_n_s_per_m")
SPIN_RATE_RATIO = "spin_rate_ratio"
#: Parameters of systems along which families of motions are followed, beside the spin rate.
PARAMETERS = (
    *_OF_BEADS, *_OF_TETHERS, "orbit_altitude_m", *(law.name for law in LAW_PARAMETERS)
)  # fmt: skip


@checked
def parameter_of(system: System, name: str) -> float:
    """Value of a parameter, that of the first satellite, bead or tether where each has its own.

    Raises
    ------
    TssError
        If there is no such parameter, or the system has no such part.
    """
    if name in _OF_BEADS:
        return float(system.mass_kg[_beads(system, name)][0])
    if name in _OF_TETHERS:
        first = tether_of_segments(system) == 0
        if name == "tether_length_m":
            return float(np.sum(system.rest_length_m[first]))
        if name == "axial_stiffness_n":
            return float(system.axial_stiffness_n[first][0])
        with np.errstate(divide="ignore"):
            return float(1.0 / np.sum(1.0 / system.damping_n_s_per_m[first]))
    if name == "orbit_altitude_m":
        return system.orbit_altitude_m
    if name in system.law_parameters:
        return float(system.law_parameters[name])
    raise TssError(f"parameter {name!r} is not known{allowed_words(name, PARAMETERS)}")


@checked
def with_parameter(system: System, name: str, value: float) -> System:
    """The system with another value of a parameter.

    Parts that have values of their own keep their proportions: the first one gets the value. The
    damping of a tether cut into segments is that from end to end, its length the whole.

    Parameters
    ----------
    system : System
    name : str
        One of `PARAMETERS`.
    value : float

    Returns
    -------
    System

    Raises
    ------
    TssError
        If there is no such parameter, or the value is not allowed.
    """
    before, value = parameter_of(system, name), finite(name, value)
    if name == "orbit_altitude_m":
        return replace(system, orbit_altitude_m=value)
    if name in system.law_parameters:
        return replace(system, law_parameters={**system.law_parameters, name: value})
    if name in _OF_BEADS:
        mass, chosen = np.array(system.mass_kg), _beads(system, name)
        mass[chosen] *= value / before
        return replace(system, mass_kg=mass)
    if name == "tether_length_m":
        share = finite(name, value, above=0.0) / before
        return replace(
            system, rest_length_m=system.rest_length_m * share, layout_m=system.layout_m * share
        )
    if name == "axial_stiffness_n":
        return replace(system, axial_stiffness_n=system.axial_stiffness_n * (value / before))
    if before > 0.0:
        return replace(system, damping_n_s_per_m=system.damping_n_s_per_m * (value / before))
    tether = tether_of_segments(system)
    return replace(system, damping_n_s_per_m=value * np.bincount(tether)[tether].astype(float))


def _beads(system, name):
    chosen = system.is_satellite == _OF_BEADS[name]
    if not chosen.any():
        raise TssError(f"{name} has no effect: the system has no such bead")
    return chosen


def tether_of_segments(system: System) -> np.ndarray:
    """The tether (m,) that each segment is part of, numbered by their first segments.

    Segments that meet in a bead which is no satellite belong to one tether.
    """
    tether = np.arange(system.m)
    for bead in np.flatnonzero(~system.is_satellite):
        meeting = np.flatnonzero((system.tether_ends == bead).any(axis=1))
        for other in meeting[1:]:
            tether[tether == tether[other]] = tether[meeting[0]]
    return np.unique(tether, return_inverse=True)[1]


def named_perturbations(
    named: Sequence[str], law_parameters: Mapping[str, float]
) -> dict[str, float]:
    """Parameters of laws with those of perturbations that are chosen by name.

    Raises
    ------
    TssError
        If there is no such perturbation, or its own parameter says that it does not act.
    """
    values = dict(law_parameters)
    if not isinstance(named, (list, tuple)) or not all(isinstance(name, str) for name in named):
        raise TssError(f"perturbations must be a list of names, got {named!r:.80}")
    for name in named:
        if name not in PERTURBATIONS:
            raise TssError(
                f"perturbations must be of {', '.join(PERTURBATIONS)}, got {name!r:.80}"
                f"{near_match(name, PERTURBATIONS)}"
            )
        law = PERTURBATIONS[name]
        strength = law.parameters[0].name
        if values.setdefault(strength, law.typical) == 0.0:
            raise TssError(f"perturbations has {name!r}, but {strength} is 0")
    return values


def check_parameter(parameter: str, spin_rate_ratio: float | None) -> None:
    """Refuse a parameter that there is not, a rate that is followed or 0, or one that is missing.

    Raises
    ------
    TssError
    """
    if parameter == SPIN_RATE_RATIO:
        if spin_rate_ratio is not None:
            raise TssError(f"spin_rate_ratio is followed, so it has no fixed value;"
                           f" got {spin_rate_ratio:g}")  # fmt: skip
    elif parameter not in PARAMETERS:
        known = (SPIN_RATE_RATIO, *PARAMETERS)
        raise TssError(f"parameter {parameter!r} is not known{allowed_words(parameter, known)}")
    elif not spin_rate_ratio:
        given = "be given" if spin_rate_ratio is None else "not be 0"
        raise TssError(f"spin_rate_ratio must {given} to follow {parameter}")


def systems_along(
    system: System, parameter: str, spin_rate_ratio: float | None
) -> Callable[[float], tuple[System, float]]:
    """The function that makes system and spin rate [rad/s] of a value of a parameter.

    Raises
    ------
    TssError
        As `check_parameter`.
    """
    check_parameter(parameter, spin_rate_ratio)
    if parameter == SPIN_RATE_RATIO:
        return lambda value: (system, system.spin_rate_rad_s(value))

    def at(value):
        varied = with_parameter(system, parameter, value)
        return varied, varied.spin_rate_rad_s(spin_rate_ratio)

    return at
