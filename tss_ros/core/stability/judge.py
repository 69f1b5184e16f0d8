"""The verdict rule: from multipliers and what is known of their errors to a word."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from tss_ros.core.stability.modes import FAMILIES

#: Smallest distance from the unit circle that is ever called one.
SMALLEST_TOLERANCE = 1e-6
#: Smallest distance from 1 within which a multiplier may be part of a split Jordan block.
SMALLEST_DRIFT = 1e-3
#: Distances that count as none: in units of the error of simple multipliers, and of Jordan blocks.
TRIVIAL_ERRORS, JORDAN_ERRORS = 10.0, 3.0
#: Multipliers of the centre of mass, and the simple ones among them, exp(+-i Omega T) twice.
CENTRE, SIMPLE = 6, 4


@dataclass(frozen=True)
class Judgement:
    """A verdict and what it was judged on.

    Attributes
    ----------
    verdict : str
        One of `result.VERDICTS`.
    tolerance : ndarray, shape (k,)
        Distance of each multiplier from the unit circle that counts as lying on it.
    trivial_error, jordan_error : float
        See `FloquetResult`.
    max_modulus, max_modulus_nontrivial : float
        Over the multipliers that were found.
    deciding : int
        Index of the multiplier that decided; -1 if none did.
    """

    verdict: str
    tolerance: np.ndarray
    trivial_error: float
    jordan_error: float
    max_modulus: float
    max_modulus_nontrivial: float
    deciding: int


def drift_radius(closure_residual: float) -> float:
    """Distance from 1 within which multipliers may belong to a Jordan block that is split.

    The drift of a damped motion splits it by about twice the root of the closure residual.
    """
    return max(SMALLEST_DRIFT, 2.0 * math.sqrt(closure_residual))


def judge(
    multiplier: np.ndarray,
    family: np.ndarray,
    closure_residual: float,
    periodic: bool,
    error: float | np.ndarray = 0.0,
    found: np.ndarray | None = None,
) -> Judgement:
    """Judge the multipliers of a turn by Eq. (47), all of them or the leading ones.

    Parameters
    ----------
    multiplier : ndarray, shape (k,), complex
    family : ndarray, shape (k,), str
        One of `FAMILIES` for each.
    closure_residual : float
        Of the motion, see `FloquetResult`.
    periodic : bool
        Whether the motion counts as closed.
    error : float or ndarray, shape (k,)
        Known errors of the multipliers beside those that theory reveals.
    found : ndarray, shape (k,), bool, optional
        Which of them were found; all if not given.

    Returns
    -------
    Judgement
    """
    found = np.ones(multiplier.size, dtype=bool) if found is None else found
    trivial, jordan = _rigid_errors(multiplier, family, closure_residual, found)
    tolerance = np.maximum(SMALLEST_TOLERANCE, TRIVIAL_ERRORS * np.maximum(trivial, error))
    tolerance = np.broadcast_to(tolerance, multiplier.shape).copy()
    near = np.abs(multiplier - 1.0) <= drift_radius(closure_residual)
    tolerance[near] = np.maximum(tolerance[near], JORDAN_ERRORS * jordan)
    rigid = (family == FAMILIES[0]) | (family == "spin")
    drifting = found & rigid & (np.abs(multiplier) > 1.0 + drift_radius(closure_residual))
    return _verdict(multiplier, family, tolerance, periodic, drifting, found, (trivial, jordan))


def judge_frozen(multiplier: np.ndarray, family: np.ndarray) -> Judgement:
    """Judge the multipliers of a configuration that is taken to stand still, Eq. (47)."""
    tolerance = np.full(multiplier.size, SMALLEST_DRIFT)
    found = np.ones(multiplier.size, dtype=bool)
    drifting = np.zeros_like(found)
    return _verdict(multiplier, family, tolerance, True, drifting, found, (math.nan, math.nan))


def _rigid_errors(multiplier, family, closure_residual, found):
    """Distances from the unit circle of those that theory puts on it: simple ones, others."""
    on_circle, from_one = np.abs(np.abs(multiplier) - 1.0), np.abs(multiplier - 1.0)
    centre = np.flatnonzero(found & (family == FAMILIES[0]))
    centre = centre[np.argsort(-from_one[centre])]
    if centre.size == CENTRE:
        simple = SIMPLE
    else:
        simple = np.count_nonzero(from_one[centre] > drift_radius(closure_residual))
    blocks = np.append(centre[simple:], np.flatnonzero(found & (family == "spin")))
    return (
        float(np.max(on_circle[part], initial=0.0)) for part in (centre[:simple], blocks)
    )


def _verdict(multiplier, family, tolerance, periodic, drifting, found, errors):
    modulus, shape = np.abs(multiplier), family == "shape"
    nontrivial = found & (shape | (family == "axis tilt"))
    growing = nontrivial & (modulus > 1.0 + tolerance)
    if not periodic:
        verdict, among = "no periodic motion", np.zeros_like(shape)
    elif growing.any():
        verdict, among = "unstable", growing
    elif drifting.any():
        verdict, among = "unstable", drifting
    elif not found.all():
        verdict, among = "undecided", nontrivial
    elif shape.any() and np.all(modulus[shape] < 1.0 - tolerance[shape]):
        verdict, among = "asymptotically stable", shape
    else:
        verdict, among = "neutral", shape if shape.any() else nontrivial
    return Judgement(
        verdict,
        tolerance,
        *errors,
        max_modulus=float(np.max(modulus[found], initial=0.0)),
        max_modulus_nontrivial=float(np.max(modulus[nontrivial], initial=0.0)),
        deciding=int(np.argmax(np.where(among, modulus, -1.0))) if among.any() else -1,
    )
