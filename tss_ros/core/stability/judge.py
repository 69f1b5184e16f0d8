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
#: How far multipliers at 1 move, in units of the drift.
DRIFTS = 10.0
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
    """

    verdict: str
    tolerance: np.ndarray
    trivial_error: float
    jordan_error: float
    max_modulus: float
    max_modulus_nontrivial: float


def drift_radius(drift: float) -> float:
    """Distance from 1 within which multipliers may belong to a Jordan block that is split.

    What makes up for the spin that damping takes splits it by some times the share of the spin,
    and the error of the matrix by its root.
    """
    return max(SMALLEST_DRIFT, DRIFTS * drift)


def judge(
    multiplier: np.ndarray,
    family: np.ndarray,
    drift: float,
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
    drift : float
        Share of the spin that the motion loses in a turn, or by how much it misses closing.
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
    trivial, jordan = _rigid_errors(multiplier, family, drift, found)
    tolerance = np.maximum(SMALLEST_TOLERANCE, TRIVIAL_ERRORS * np.maximum(trivial, error))
    tolerance = np.broadcast_to(tolerance, multiplier.shape).copy()
    near = np.abs(multiplier - 1.0) <= drift_radius(drift)
    tolerance[near] = np.maximum(tolerance[near], JORDAN_ERRORS * jordan)
    drifting = jordan > drift_radius(drift)
    return _verdict(multiplier, family, tolerance, periodic, drifting, found, (trivial, jordan))


def judge_frozen(multiplier: np.ndarray, family: np.ndarray) -> Judgement:
    """Judge the multipliers of a configuration that is taken to stand still, Eq. (47)."""
    tolerance = np.full(multiplier.size, SMALLEST_DRIFT)
    found = np.ones(multiplier.size, dtype=bool)
    return _verdict(multiplier, family, tolerance, True, False, found, (math.nan, math.nan))


def _rigid_errors(multiplier, family, drift, found):
    """Distances from the unit circle of those that theory puts on it: simple ones, others."""
    on_circle, from_one = np.abs(np.abs(multiplier) - 1.0), np.abs(multiplier - 1.0)
    centre = np.flatnonzero(found & (family == FAMILIES[0]))
    centre = centre[np.argsort(-from_one[centre])]
    if centre.size == CENTRE:
        simple = SIMPLE
    else:
        simple = np.count_nonzero(from_one[centre] > drift_radius(drift))
    blocks = np.append(centre[simple:], np.flatnonzero(found & (family == "spin")))
    return (
        float(np.max(on_circle[part], initial=0.0)) for part in (centre[:simple], blocks)
    )


def _verdict(multiplier, family, tolerance, periodic, drifting, found, errors):
    modulus, shape = np.abs(multiplier), family == "shape"
    nontrivial = found & (shape | (family == "axis tilt"))
    if not periodic:
        verdict = "none found"
    elif np.any(modulus[nontrivial] > 1.0 + tolerance[nontrivial]) or drifting:
        verdict = "unstable"
    elif not found.all():
        verdict = "undecided"
    elif shape.any() and np.all(modulus[shape] < 1.0 - tolerance[shape]):
        verdict = "asymptotically stable"
    else:
        verdict = "neutral"
    return Judgement(
        verdict,
        tolerance,
        *errors,
        max_modulus=float(np.max(modulus[found], initial=0.0)),
        max_modulus_nontrivial=float(np.max(modulus[nontrivial], initial=0.0)),
    )
