"""Families of periodic motions followed in the spin rate or a parameter, with their special points.

Between two points of a family something may have happened: it turned round in a fold, multipliers
left the unit circle or came back, tethers began to go slack. Each such point is located between
them by bisection along the curve.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tss_ros.core.arguments import checked, finite
from tss_ros.core.errors import Cancelled, IntegrationError, TssError
from tss_ros.core.model.parameters import SPIN_RATE_RATIO, systems_along
from tss_ros.core.model.symmetry import Symmetry, cyclic_symmetry
from tss_ros.core.model.system import State, System
from tss_ros.core.stability import continuation, families
from tss_ros.core.stability.acceptance import look
from tss_ros.core.stability.branches import crossing_curve
from tss_ros.core.stability.closing import CLOSED, ClosingEquations, solve
from tss_ros.core.stability.continuation import Curve, Ended, Point
from tss_ros.core.stability.family import Family, FamilyPoint, SpecialPoint
from tss_ros.core.stability.formation_motion import formation_motion
from tss_ros.core.stability.modes import stays_in_plane
from tss_ros.core.stability.spectrum import Spectrum, spectrum

#: Largest step if not given, and distance to which special points are located, over the parameter.
LONGEST_STEP, TOLERANCE = 0.02, 1e-7
#: How near to its end a family is that goes no farther, over the parameter, to be solved there.
NEAR_STOP = 1e-5
#: Least uncertainty of a special point, over the parameter: motions close to about that.
ROUNDING = 1e-9
#: Imaginary part, over the modulus, of multipliers that count as real.
REAL = 1e-6


@checked
def follow(
    system: System,
    parameter: str,
    start: float,
    stop: float,
    *,
    spin_rate_ratio: float | None = None,
    state: State | None = None,
    branch: SpecialPoint | None = None,
    longest_step: float = LONGEST_STEP,
    most_points: int = 2000,
    progress: Callable[[float, FamilyPoint], None] | None = None,
    cancelled: Callable[[], bool] | None = None,
) -> Family:
    """Follow a family of periodic motions from one value of a parameter to another.

    Parameters
    ----------
    system : System
    parameter : str
        "spin_rate_ratio" or one of `PARAMETERS`, see `with_parameter`.
    start, stop : float
        Values of it. Where the family turns round in a fold it is followed on, until it passes
        `stop` or comes back past `start`.
    spin_rate_ratio : float, optional
        w = omega / Omega for other parameters.
    state : State, optional
        Next to the motion to begin with; that of the formation's own family if not given.
    branch : SpecialPoint, optional
        A branch point or period doubling of a family in the same parameter, between `start` and
        `stop`: the family that crosses there is followed, on the side that goes to `stop`, or else
        on the one that goes to `start`.
    longest_step : float
        Of the parameter, over its value (over the width of the interval if that holds 0).
    most_points : int
    progress : callable, optional
        Called with the share of the interval that is done and the latest point.
    cancelled : callable, optional
        Asked now and then; a true answer ends the family there, and what was found is kept.

    Returns
    -------
    Family

    Raises
    ------
    TssError
        For values that are not allowed, or if no motion closes at the start.
    """
    at = systems_along(system, parameter, spin_rate_ratio)
    start, stop = (finite(f"{parameter} to {word}", value)
                   for word, value in (("start from", start), ("stop at", stop)))  # fmt: skip
    finite("longest_step", longest_step, above=0.0)
    if start == stop:
        raise TssError(f"the interval of {parameter} must not be empty, got {start:g} to {stop:g}")
    if parameter == SPIN_RATE_RATIO and start * stop <= 0.0:
        raise TssError(f"spin_rate_ratio must keep its sign, got {start:g} to {stop:g}")
    for value in (start, stop):
        at(value)
    if branch is not None:
        if state is not None:
            raise TssError("state and branch must not both be given: a branch has its own start")
        ends, curve = crossing_curve(at, parameter, (start, stop), branch, longest_step, cancelled)
    else:
        ends = (start, stop)
        curve = _own_curve(at, parameter, ends, state, longest_step, cancelled)
    return Run(at, parameter, *ends, curve, cancelled).follow(most_points, progress)


def _own_curve(at, parameter, ends, state, longest_step, cancelled):
    """The curve of motions that begins at the start of an interval."""
    (start, stop), (system, spin) = ends, at(ends[0])
    ratio = spin / system.orbit_rate_rad_s
    motion = _first(system, ratio, state, cancelled)
    equations = ClosingEquations(
        at, families.size_of(system), stays_in_plane(system, motion.state),
        symmetry_of(system, motion, ratio, cancelled), families.RTOL, cancelled,
        None if start * stop > 0.0 else abs(stop - start),
    )  # fmt: skip
    y = equations.vector(motion.state, start, motion.spin_loss)
    if state is not None and (why := look(equations.integrator(y), motion.state).refusal):
        raise TssError(f"no motion to follow was found from the given state: {why}")
    first = continuation.begin(equations, y, math.copysign(1.0, stop - start), True)
    return Curve(equations, first, True, longest_step)


def _first(system, ratio, state, cancelled):
    if state is None:
        try:
            return formation_motion(system, ratio, cancelled)
        except Ended as end:
            raise TssError(
                f"no motion to follow was found at spin_rate_ratio {ratio:g}: {end}"
            ) from None
    try:
        motion = families.nearest_motion(system, ratio, state, cancelled)
    except IntegrationError as error:
        raise TssError(f"no motion to follow was found from the given state: {error}") from None
    if not motion.residual <= CLOSED:
        raise TssError(
            "no motion to follow was found from the given state: the best turn closes to"
            f" {motion.residual:.1e}, {CLOSED:g} is enough"
        )
    return motion


def symmetry_of(
    system: System,
    motion: families.Closed,
    ratio: float,
    cancelled: Callable[[], bool] | None = None,
) -> Symmetry:
    """The formation's symmetry if the motion has it, else none."""
    symmetry = cyclic_symmetry(system)
    equations = families.rate_equations(system, motion.state, symmetry, cancelled)
    y = equations.vector(motion.state, ratio, motion.spin_loss)
    left = np.linalg.norm(equations.shoot(y)[0])
    return symmetry if left <= 10.0 * CLOSED else families.no_symmetry(system)


class Run:
    """One family under way.

    Parameters
    ----------
    at : callable
        As for `ClosingEquations`.
    parameter : str
        What it is called.
    start, stop : float
        The interval.
    curve : Curve
        With derivatives out of the plane.
    cancelled : callable, optional
    """

    def __init__(
        self,
        at: Callable[[float], tuple[System, float]],
        parameter: str,
        start: float,
        stop: float,
        curve: Curve,
        cancelled: Callable[[], bool] | None = None,
    ):
        self.at, self.parameter, self.start, self.stop = at, parameter, start, stop
        self.sense, self.cancelled = math.copysign(1.0, stop - start), cancelled
        self.equations, self.curve = curve.equations, curve
        self.points, self.special = [], []

    def follow(
        self,
        most_points: int,
        progress: Callable[[float, FamilyPoint], None] | None = None,
    ) -> Family:
        """The family, as far as it goes."""
        ended, before = "", self._seen(self.curve.point)
        self._keep(before)
        try:
            while len(self.points) < most_points:
                after = self._seen(self.curve.advance())
                self._locate(before, after)
                if self.equations.lost(after.point.solution.y) > families.MOST_LOSS:
                    ended = (
                        f"damping takes more than {families.MOST_LOSS:.0%} of the spin in a turn"
                        f" beyond {before.point.parameter:.6g}"
                    )
                    break
                value = after.point.parameter
                if (value - self.stop) * self.sense >= 0.0:
                    self._keep(self._last(before, after))
                    break
                self._keep(after)
                if progress is not None:
                    share = (value - self.start) / (self.stop - self.start)
                    progress(float(np.clip(share, 0.0, 1.0)), self.points[-1])
                if (value - self.start) * self.sense < 0.0:
                    ended = f"the family came back past {self.start:g}"
                    break
                before = after
            else:
                ended = f"{most_points} points were found, the last at {before.point.parameter:.6g}"
        except Ended as end:
            ended = str(end)
            if (last := self._at_stop(before.point)) is not None:
                self._keep(last)
                ended = ""
        except Cancelled:
            ended = f"canceled at {before.point.parameter:.6g}"
        turns = self.equations.turns
        return Family(self.parameter, tuple(self.points), tuple(self.special), ended, turns)

    def nearest(self, kind: str, most_points: int) -> SpecialPoint | None:
        """The special point of a kind that is nearest to 0, where the parameter is a distance.

        Raises
        ------
        Ended, Cancelled
            As `Curve.advance`.
        """
        before, best = self._seen(self.curve.point), None
        for _ in range(most_points):
            after = self._seen(self.curve.advance())
            self._locate(before, after)
            found = [special for special in self.special if special.kind == kind]
            best = min(found, key=lambda special: abs(special.parameter), default=None)
            farthest = self.stop if best is None else abs(best.parameter)
            if abs(after.point.parameter) >= farthest and after.point.parameter * self.sense > 0.0:
                break
            if (after.point.parameter - self.start) * self.sense < 0.0:
                break
            before = after
        return best

    def _seen(self, point):
        """A point with its spectrum."""
        y, equations = point.solution.y, self.equations
        integrator, state = equations.integrator(y), equations.state(y)
        loss = float(y[-3]) * equations.turns
        matrix = np.linalg.matrix_power(point.linear.matrix, equations.symmetry.order)
        return _Seen(
            point, spectrum(integrator, state, None, matrix, point.solution.residual, loss)
        )

    def _last(self, before, beyond):
        """The motion at the end that was asked for, next to one beyond it."""
        last, _ = continuation.bisected(
            self.curve, before.point, beyond.point,
            lambda point: (point.parameter - self.stop) * self.sense < 0.0, TOLERANCE,
        )  # fmt: skip
        return self._at_stop(last) or self._seen(last)

    def _at_stop(self, point):
        """The motion at the end that was asked for, next to another; None if none was found."""
        y = np.array(point.solution.y)
        if abs(y[-1] - self.stop) > NEAR_STOP * self.equations.unit(y):
            return None
        y[-1] = self.stop
        try:
            solution = solve(self.equations, y, point.linear)
            if not solution.residual <= CLOSED:
                return None
            linear = self.equations.linearise(solution.y, True)
        except IntegrationError:
            return None
        return self._seen(Point(solution, linear, point.tangent))

    def _keep(self, seen):
        y, judgement = seen.point.solution.y, seen.spectrum.judgement
        multiplier, decided = seen.spectrum.multiplier, judgement.deciding
        order = np.argsort(-np.abs(multiplier), kind="stable")
        system, spin = self.at(float(y[-1]))
        self.points.append(
            FamilyPoint(
                float(y[-1]),
                spin / system.orbit_rate_rad_s,
                judgement.verdict,
                float(abs(multiplier[decided])) if decided >= 0 else math.nan,
                str(seen.spectrum.family[decided]) if decided >= 0 else "",
                judgement.max_modulus_nontrivial,
                int(np.count_nonzero(seen.outside)),
                seen.slack,
                float(y[-3]),
                seen.point.solution.residual,
                multiplier[order],
                self.equations.state(y),
            )
        )

    def _locate(self, a, b):
        """Find what happens between two points of the curve."""
        found = []
        if a.point.tangent[-1] * b.point.tangent[-1] < 0.0:
            sign = a.point.tangent[-1]
            found.append(self._bracket("fold", a, b, lambda p: p.tangent[-1] * sign > 0.0))
        if a.slack != b.slack:
            found.append(
                self._bracket("first slack", a, b, lambda p: (p.linear.switches > 0) == a.slack)
            )
        count = np.count_nonzero(a.outside)
        if count != np.count_nonzero(b.outside):
            found.append(
                self._bracket("", a, b, lambda p: np.count_nonzero(self._seen(p).outside) == count)
            )
        folds = [point.parameter for point in found if point.kind == "fold"]
        for point in found:
            # At a fold a multiplier passes 1; that is the fold, nothing beside it.
            near = 1e-4 * self.equations.unit(a.point.solution.y)
            at_one = point.kind in ("branch point", "spin divergence")
            if not at_one or all(abs(point.parameter - fold) > near for fold in folds):
                self.special.append(point)

    def _bracket(self, kind, a, b, holds):
        last, first = continuation.bisected(self.curve, a.point, b.point, holds, TOLERANCE)
        multiplier, family = complex(math.nan, math.nan), ""
        if not kind:
            inner, outer = sorted(
                (self._seen(last), self._seen(first)), key=lambda s: np.count_nonzero(s.outside)
            )
            kind, multiplier, family = _leaving(outer.spectrum, outer.outside)
        y = last.solution.y
        middle = 0.5 * (last.parameter + first.parameter)
        rounding = ROUNDING * self.equations.unit(y)
        system, spin = self.at(middle)
        return SpecialPoint(
            kind, middle, max(0.5 * abs(last.parameter - first.parameter), rounding),
            spin / system.orbit_rate_rad_s, multiplier, family, len(self.points) - 1,
            self.equations.state(y), self.equations.turns,
        )  # fmt: skip


@dataclass(frozen=True)
class _Seen:
    """A point of the curve and its multipliers."""

    point: Point
    spectrum: Spectrum

    @property
    def slack(self):
        return self.point.linear.switches > 0

    @property
    def outside(self):
        """Which multipliers lie outside the unit circle, (6n,) bool."""
        return self.spectrum.outside


def _leaving(found, outside):
    """Kind of the special point at which multipliers have just left the circle."""
    candidates = np.flatnonzero(outside)
    which = candidates[np.argmin(np.abs(found.multiplier[candidates]))]
    rho = complex(found.multiplier[which])
    if found.family[which] == "spin":
        kind = "spin divergence"
    elif abs(rho.imag) > REAL * abs(rho):
        kind = "torus"
    else:
        kind = "branch point" if rho.real > 0.0 else "period doubling"
    return kind, rho, str(found.family[which])
