"""Results of the core's stability analysis as ROS messages."""

import array
import math

import numpy as np
from tss_interfaces.msg import (
    Confirmation,
    CriticalRate,
    FamilyPoint,
    FloquetResult,
    GrowthResult,
    Mode,
    SpecialPoint,
)

from tss_ros import core

#: Arrays of a GrowthResult and of its start.
_OF_GROWTH = ("exponent_per_s", "error_per_s", "history_per_s")
_OF_STATE = ("position_m", "velocity_m_s")


def floquet_result(
    result: core.FloquetResult,
    confirmation: core.Confirmation | None = None,
    mode: Mode | None = None,
) -> FloquetResult:
    """A core FloquetResult as a message, with a core Confirmation; fields have the same names."""
    return FloquetResult(
        mode=[mode] if mode else [],
        multiplier_real=doubles(result.multiplier.real),
        multiplier_imag=doubles(result.multiplier.imag),
        exponent_real=doubles(result.exponent.real),
        exponent_imag=doubles(result.exponent.imag),
        confirmation=[_same_fields(Confirmation, confirmation)] if confirmation else [],
        **{
            name: getattr(result, name)
            for name in FloquetResult.get_fields_and_field_types()
            if not name.startswith(("multiplier", "exponent", "confirmation", "mode"))
        },
    )


def deciding_mode(system: core.System, result: core.FloquetResult, samples: int) -> Mode:
    """The mode that decided a verdict, at so many times of a turn.

    Raises
    ------
    TssError, IntegrationError
        As `core.compute_modes`.
    """
    mode = core.compute_modes(system, result)[result.deciding]
    motion = core.mode_motion(system, result, result.deciding, samples)
    return _same_fields(
        Mode,
        mode,
        multiplier_real=mode.multiplier.real,
        multiplier_imag=mode.multiplier.imag,
        resonance=core.name_resonance(system, result),
        tether_ends=array.array("I", system.tether_ends.ravel().tolist()),
        turns=doubles(motion.turns),
        position_m=doubles(motion.position_m),
        shape_real=doubles(motion.shape.real),
        shape_imag=doubles(motion.shape.imag),
    )


def failed_floquet_result(
    system: core.System, spin_rate_ratio: float, message: str
) -> FloquetResult:
    """The message for a rate that could not be computed: NaN wherever there is no number."""
    kinds = FloquetResult.get_fields_and_field_types()
    unknown = dict.fromkeys((name for name, kind in kinds.items() if kind == "double"), math.nan)
    known = {
        "spin_rate_ratio": spin_rate_ratio,
        "spin_rate_rad_s": spin_rate_ratio * system.orbit_rate_rad_s,
        "tether_law": system.tether_law,
    }
    return FloquetResult(message=message, **{**unknown, **known})


def growth_result(result: core.GrowthResult) -> GrowthResult:
    """A core GrowthResult as a message; fields have the same names, arrays are flat."""
    arrays = {name: doubles(getattr(result, name)) for name in _OF_GROWTH}
    arrays |= {name: doubles(getattr(result.state, name)) for name in _OF_STATE}
    return _same_fields(GrowthResult, result, message="", **arrays)


def failed_growth_result(spin_rate_ratio: float, message: str) -> GrowthResult:
    """The message for a rate that could not be computed."""
    return GrowthResult(
        spin_rate_ratio=spin_rate_ratio,
        turn_s=math.nan,
        resolution_per_s=math.nan,
        message=message,
    )


def critical_rate(system: core.System, rate: core.CriticalRate) -> CriticalRate:
    """A core CriticalRate of a system as a message; fields have the same names."""
    return _same_fields(CriticalRate, rate, tether_law=system.tether_law)


def family_point(point: core.FamilyPoint) -> FamilyPoint:
    """A core FamilyPoint as a message; fields have the same names."""
    return _of_family(FamilyPoint, point, doubles)


def special_point(point: core.SpecialPoint) -> SpecialPoint:
    """A core SpecialPoint, likewise."""
    return _of_family(SpecialPoint, point, float)


def _of_family(kind, point, number):
    arrays = {n: doubles(getattr(point.state, n)) for n in ("position_m", "velocity_m_s")}
    parts = {f"multiplier_{n}": number(getattr(point.multiplier, n)) for n in ("real", "imag")}
    return _same_fields(kind, point, **arrays, **parts)


def _same_fields(kind, value, **others):
    """A message with the fields of `value`, and others by name."""
    names = kind.get_fields_and_field_types()
    return kind(**{n: others[n] if n in others else getattr(value, n) for n in names})


def doubles(values: np.ndarray | list[float]) -> array.array:
    """A flat float64[]; filling a message from array.array skips its element-by-element checks."""
    return array.array("d", np.ascontiguousarray(values, dtype=np.float64).tobytes())
