"""The verdict rule: from multipliers and what is known of their errors to a word."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from tss_ros.core.stability.modes import FAMILIES

#: Smallest distance from the unit circle that is ever called one.
SMALLEST_TOLERANCE = 1e-6
#: Smallest distance from 1 within which a multiplier may be part of a split Jordan block.
SMALLEST_DRIFT = 1e-3
#: How far the drive moves multipliers of the formation as a whole, over |w| and the spin's loss.
DRIVEN = 4.0
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

    def fields(
        self, multiplier: np.ndarray, vectors: np.ndarray, family: np.ndarray, order: np.ndarray
    ) -> dict[str, Any]:
        """What a `FloquetResult` says of the multipliers judged (k,), by name, in an order."""
        decided = self.deciding
        same = ("verdict", "trivial_error", "jordan_error", "max_modulus", "max_modulus_nontrivial")
        return {name: getattr(self, name) for name in same} | {
            "multiplier": multiplier[order],
            "vectors": vectors[:, order],
            "family": tuple(str(name) for name in family[order]),
            "deciding_modulus": float(abs(multiplier[decided])) if decided >= 0 else math.nan,
            "deciding_family": str(family[decided]) if decided >= 0 else "",
            "tolerance": float(self.tolerance[decided] if decided >= 0 else np.min(self.tolerance)),
        }


def drift_radius(closure_residual: float, drift: float = 0.0, error: float = 0.0) -> float:
    """Distance from 1 within which multipliers may belong to a Jordan block that is split.

    A motion that does not close, and the error of the matrix, split it by their roots; the drive of
    one that does splits it in proportion.

    Parameters
    ----------
    closure_residual : float
        What is left of the equations that the motion was to solve.
    drift : float
        `DRIVEN` times |w| times the share of the spin that the motion loses in a turn.
    error : float
        Of the matrix, as far as it is known.
    """
    splits = 2.0 * math.sqrt(closure_residual), 1.5 * drift, 3.0 * math.sqrt(error)
    return max(SMALLEST_DRIFT, *splits)


def judge(
    multiplier: np.ndarray,
    family: np.ndarray,
    radius: float,
    periodic: bool,
    *,
    drift: float = 0.0,
    above: np.ndarray | None = None,
    error: float | np.ndarray = 0.0,
    found: np.ndarray | None = None,
) -> Judgement:
    """Judge the multipliers of a turn by Eq. (47), all of them or the leading ones.

    Parameters
    ----------
    multiplier : ndarray, shape (k,), complex
    family : ndarray, shape (k,), str
        One of `FAMILIES` for each.
    radius : float
        `drift_radius` of the motion.
    periodic : bool
        Whether the motion counts as closed.
    drift : float
        As for `drift_radius`.
    above : ndarray, shape (k,), bool, optional
        Which of them are displacements out of the plane of a planar motion: these know nothing of
        a drive in the plane.
    error : float or ndarray, shape (k,)
        Known errors of the multipliers beside those that theory reveals.
    found : ndarray, shape (k,), bool, optional
        Which of them were found; all if not given.

    Returns
    -------
    Judgement
    """
    found = np.ones(multiplier.size, dtype=bool) if found is None else found
    above = np.zeros(multiplier.size, dtype=bool) if above is None else above
    on_circle, from_one = np.abs(np.abs(multiplier) - 1.0), np.abs(multiplier - 1.0)
    on_circle = np.where(above, on_circle, np.maximum(on_circle - drift, 0.0))
    simple, blocks = _rigid(family, from_one, radius, found)
    tolerance = np.full(multiplier.size, SMALLEST_TOLERANCE)
    tolerance[~above] = max(SMALLEST_TOLERANCE, drift)
    for part in (above, ~above):
        trivial = np.max(on_circle[simple & part], initial=0.0)
        tolerance[part] = np.maximum(tolerance, TRIVIAL_ERRORS * np.maximum(trivial, error))[part]
    # A spin that feedback holds decays to its rate: there is no block then.
    held = (family == "spin") & (np.abs(multiplier) < 1.0 - radius)
    jordan = float(np.max(on_circle[blocks & ~held], initial=0.0))
    # A double multiplier at 1 splits to both sides, so this is for those outside alone.
    near = (from_one <= radius) & (np.abs(multiplier) > 1.0)
    tolerance[near] = np.maximum(tolerance[near], min(JORDAN_ERRORS * jordan, radius))
    drifting = found & (family == "spin") & (np.abs(multiplier) > 1.0 + radius)
    errors = float(np.max(on_circle[simple], initial=0.0)), jordan
    return _verdict(multiplier, family, tolerance, periodic, drifting, found, errors)


def judge_measured(
    multiplier: np.ndarray, family: np.ndarray, error: float, radius: float
) -> Judgement:
    """Judge the multipliers of a closed motion on an ellipse, where theory puts none but at 1.

    Parameters
    ----------
    multiplier, family, radius
        As for `judge`. Those of the centre of mass are all at 1, in blocks.
    error : float
        Of the multipliers outside the blocks, measured.
    """
    tolerance = np.full(multiplier.size, max(SMALLEST_TOLERANCE, TRIVIAL_ERRORS * error))
    blocks = (family == FAMILIES[0]) | (family == FAMILIES[1])
    jordan = np.max(np.abs(np.abs(multiplier[blocks]) - 1.0), initial=0.0)
    drifting = (family == "spin") & (np.abs(multiplier) > 1.0 + radius)
    found = np.ones(multiplier.size, dtype=bool)
    errors = math.nan, float(jordan)
    return _verdict(multiplier, family, tolerance, True, drifting, found, errors)


def judge_frozen(multiplier: np.ndarray, family: np.ndarray) -> Judgement:
    """Judge the multipliers of a configuration that is taken to stand still, Eq. (47)."""
    tolerance = np.full(multiplier.size, SMALLEST_DRIFT)
    found = np.ones(multiplier.size, dtype=bool)
    drifting = np.zeros_like(found)
    return _verdict(multiplier, family, tolerance, True, drifting, found, (math.nan, math.nan))


def judge_exponents(
    exponent: np.ndarray, period_s: float, family: np.ndarray, error: float
) -> Judgement:
    """Judge a formation that hangs by its exponents: Eq. (47) where the matrix is exp(J T).

    Over an orbit all multipliers of the centre of mass are 1; its exponents, 0 and +-i Omega twice,
    lie apart.

    Parameters
    ----------
    exponent : ndarray, shape (k,), complex
        [1/s]
    period_s : float
        T [s].
    family : ndarray, shape (k,), str
        One of `FAMILIES` for each.
    error : float
        [1/s] known error of the exponents.

    Returns
    -------
    Judgement
        Tolerances count for real parts of exponents times T.
    """
    growth, found = exponent.real * period_s, np.ones(family.size, dtype=bool)
    simple, blocks = _rigid(family, np.abs(exponent) * period_s, math.pi, found)
    trivial = float(np.max(np.abs(growth[simple]), initial=0.0))
    jordan = float(np.max(np.abs(growth[blocks]), initial=0.0))
    nothing = max(SMALLEST_TOLERANCE, TRIVIAL_ERRORS * max(trivial, error * period_s))
    tolerance = np.full(family.size, nothing)
    with np.errstate(under="ignore", over="ignore"):
        modulus = np.exp(growth)
    drifting, errors = np.zeros_like(found), (trivial, jordan)
    return _verdict(modulus, family, tolerance, True, drifting, found, errors)


def _rigid(family, from_one, radius, found):
    """Which multipliers theory puts on the unit circle: simple ones, and those at 1 in blocks."""
    centre = np.flatnonzero(found & (family == FAMILIES[0]))
    centre = centre[np.argsort(-from_one[centre])]
    far = np.count_nonzero(from_one[centre] > radius)
    count = SIMPLE if centre.size == CENTRE else far
    simple, blocks = np.zeros((2, family.size), dtype=bool)
    simple[centre[:count]] = blocks[centre[count:]] = True
    return simple, blocks | (found & (family == "spin"))


def _verdict(multiplier, family, tolerance, periodic, drifting, found, errors):
    modulus, shape = np.abs(multiplier), family == "shape"
    nontrivial = found & np.isin(family, FAMILIES[2:])
    growing = nontrivial & (modulus > 1.0 + tolerance)
    if not periodic:
        verdict, among = "none found", np.zeros_like(shape)
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
