"""Critical spin rates: where in an interval tethers first let go or stability is lost."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tss_ros.core.arguments import checked, finite
from tss_ros.core.errors import TssError
from tss_ros.core.model.elements import require_autonomous
from tss_ros.core.model.system import System
from tss_ros.core.presentation import Presented
from tss_ros.core.stability.floquet import compute_floquet
from tss_ros.core.stability.judge import SMALLEST_TOLERANCE
from tss_ros.core.stability.krein import may_meet
from tss_ros.core.stability.resonances import name_resonance
from tss_ros.core.stability.result import FloquetResult

CAUSES = ("first slack", "axis tilt", "shape", "spin", "none found")

#: Slower spin than this is left out of an interval: one turn becomes longer than twenty orbits.
SLOWEST = 0.05


@dataclass(frozen=True, repr=False)
class CriticalRate(Presented):
    """A boundary of stability, or of the range where no tether ever lets go.

    Attributes
    ----------
    spin_rate_ratio : float
        w = omega / Omega in the middle of the bracket.
    uncertainty : float
        Half the width of the bracket, whose ends were found different.
    cause : str
        One of `CAUSES`: "first slack" if tethers let go on one side and on the other do not, that
        is, go slack or, where their law never pushes, stop pulling (the motion may stay stable a
        little further); "none found" where the family of the formation's motions ends; else the
        family of the multiplier that leaves the unit circle.
    stable_side : int
        +1 if the formation is stable and taut at larger (more positive) w, -1 if at smaller.
    pushing_share : float
        Share of the time that taut tethers push, on the motion at the bracket's stable end.
    resonance : str
        Where multipliers leave the unit circle: the modes that meet and their condition, see
        `name_resonance`, and whether a multiplier lies outside on the stable side, too, by no more
        than it is known to. Where the family ends: how. Else "".
    """

    spin_rate_ratio: float
    uncertainty: float
    cause: str
    stable_side: int
    pushing_share: float = math.nan
    resonance: str = ""

    def _headline(self):
        side = "larger" if self.stable_side > 0 else "smaller"
        return (
            f"ω = {self.spin_rate_ratio:.6g} ± {self.uncertainty:.1g} Ω: {self.cause};"
            f" stable at {side} ω"
        )

    def _facts(self):
        return {
            "spin rate": f"{self.spin_rate_ratio:.8g} ± {self.uncertainty:.1g} Ω",
            "cause": self.cause,
            "stable": f"at {'larger' if self.stable_side > 0 else 'smaller'} ω",
            **({"why": self.resonance} if self.resonance else {}),
            "taut tethers push": f"{self.pushing_share:.2%} of the time",
        }


@checked
def find_critical_rates(
    system: System,
    ratio_from: float,
    ratio_to: float,
    tolerance: float = 1e-3,
    spacing: float = 0.05,
    progress: Callable[[float, tuple[CriticalRate, ...]], None] | None = None,
    cancelled: Callable[[], bool] | None = None,
) -> list[CriticalRate]:
    """All boundaries in an interval of spin rates, bracketed by bisection.

    Parameters
    ----------
    system : System
    ratio_from, ratio_to : float
        The interval of w = omega / Omega; |w| < `SLOWEST` is left out.
    tolerance : float
        Half-width to which every boundary is bracketed.
    spacing : float
        Distance of the first samples. Narrower bands of instability out of the orbit plane are
        found as well, where multipliers pass each other between two samples; other pockets that are
        narrower may be missed.
    progress : callable, optional
        Called with the fraction of the work done, from 0 to 1, and the boundaries found so far.
    cancelled : callable, optional
        Asked now and then; a true answer stops the work.

    Returns
    -------
    list of CriticalRate
        In increasing order.

    Raises
    ------
    TssError
        For values that are not allowed.
    Cancelled
        If `cancelled` said so.
    """
    low, high = sorted(
        (finite("spin_rate_ratio_from", ratio_from), finite("spin_rate_ratio_to", ratio_to))
    )
    require_autonomous(system, "find_critical_rates")
    finite("tolerance", tolerance, at_least=1e-6)
    finite("spacing", spacing, at_least=1e-3)
    if not low < high:
        raise TssError(f"the interval of spin rates must not be empty, got {low:g} to {high:g}")
    for end in (low, high):
        system.spin_rate_rad_s(end if abs(end) > SLOWEST else SLOWEST)
    pieces = [(low, min(high, -SLOWEST)), (max(low, SLOWEST), high)]
    grids = [
        np.linspace(a, b, max(2, int(np.ceil((b - a) / spacing)) + 1)) for a, b in pieces if a < b
    ]
    if (total := sum(len(grid) for grid in grids)) > 100_000:
        raise TssError(f"the interval holds {total} samples at spacing {spacing:g}, at most 100000")
    found, done = [], 0
    for grid in grids:
        before = None
        for ratio in grid:
            after = _sample_at(system, float(ratio), cancelled)
            if before is not None:
                found.extend(_bracket(system, before, after, tolerance, cancelled))
            before = after
            done += 1
            if progress is not None:
                progress(done / total, tuple(found))
    return found


@dataclass(frozen=True)
class _Sample:
    ratio: float
    stable: bool
    slack: bool
    result: FloquetResult

    @property
    def cause(self):
        return self.result.deciding_family or "none found"


def _sample_at(system, ratio, cancelled):
    result = compute_floquet(system, ratio, certify=False, cancelled=cancelled)
    stable = result.verdict in ("neutral", "asymptotically stable")
    return _Sample(ratio, stable, result.switches > 0, result)


def _bracket(system, a, b, tolerance, cancelled):
    """Boundaries between two samples, in order; none where both are alike."""
    if not (a.stable or b.stable):
        return []
    alike = (a.stable, a.slack) == (b.stable, b.slack)
    if alike and not may_meet(system, a.result, b.result):
        return []
    if b.ratio - a.ratio > 2.0 * tolerance:
        middle = _sample_at(system, 0.5 * (a.ratio + b.ratio), cancelled)
        return [
            *_bracket(system, a, middle, tolerance, cancelled),
            *_bracket(system, middle, b, tolerance, cancelled),
        ]
    if alike:
        return []
    better, worse = (a, b) if (a.stable, not a.slack) > (b.stable, not b.slack) else (b, a)
    slack = worse.stable or (
        worse.slack and not better.slack and worse.cause not in ("axis tilt", "none found")
    )
    return [
        CriticalRate(
            0.5 * (a.ratio + b.ratio),
            0.5 * (b.ratio - a.ratio),
            "first slack" if slack else worse.cause,
            1 if better is b else -1,
            better.result.pushing_share,
            "" if slack else _why(system, worse.result, better.result),
        )
    ]


def _why(system, result, beside):
    """What ends stability at a result that is not stable, in words, and the one beside it."""
    if result.verdict != "unstable":
        return result.message.split(";")[0]
    words = [name_resonance(system, result)]
    if (modulus := beside.deciding_modulus) > 1.0 + SMALLEST_TOLERANCE:
        words.append(
            f"stability may end on the stable side already: |rho| is {modulus:.6f} there, no more"
            " beyond 1 than it is known to"
        )
    return "; ".join(filter(None, words))
