"""Families of periodic motions, followed in a parameter by pseudo-arclength continuation.

The curve of solutions of `closing.ClosingEquations` is followed step by step: along its tangent,
and back to it by Newton's method across the tangent, so that it may turn round in the parameter
(E. L. Allgower and K. Georg, Numerical Continuation Methods, 1990). Steps grow where corrections
are few and shrink where they are not; they are measured over the parameter's unit. The bordered
determinant keeps its sign along a curve but for points where another one crosses: a long step that
changes it has led to another curve, or across such a point, and is taken again, shorter.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tss_ros.core.errors import Cancelled, IntegrationError
from tss_ros.core.stability.closing import (
    CLOSED,
    ClosingEquations,
    Linearised,
    Solution,
    solve,
)

#: First, longest and shortest step, over the parameter's unit, and the longest that may cross other
#: curves.
FIRST_STEP, LONGEST_STEP, SHORTEST_STEP, CROSSING_STEP = 0.02, 0.08, 1e-6, 1e-3
#: A step is taken back if the correction is a larger share of it, or the tangent turns by more than
#: this cosine tells.
FARTHEST_CORRECTION, STRAIGHT = 0.5, 0.9
#: Corrections after which the next step is longer, and after which it is shorter.
FEW, MANY = 6, 10


@dataclass(frozen=True)
class Point:
    """A point of a family.

    Attributes
    ----------
    solution : Solution
    linear : Linearised
        The closing equations there.
    tangent : ndarray
        Of the curve, by y; of length 1 with the parameter over its value.
    """

    solution: Solution
    linear: Linearised
    tangent: np.ndarray

    @property
    def parameter(self) -> float:
        """Value of the parameter."""
        return float(self.solution.y[-1])

    @property
    def side(self) -> float:
        """Sign of the bordered determinant, which changes where another curve crosses."""
        return float(np.linalg.slogdet(np.vstack([self.linear.jacobian, self.tangent]))[0])


class Ended(Exception):
    """A family could not be followed any further; the text says why."""


def begin(equations: ClosingEquations, y: np.ndarray, sense: float, whole: bool) -> Point:
    """The point of a closed motion, with the tangent that changes the parameter in a sense.

    Parameters
    ----------
    equations : ClosingEquations
    y : ndarray
        Where Newton's method starts.
    sense : float
        +1 or -1.
    whole : bool
        Find derivatives out of the plane as well (`ClosingEquations.linearise`).

    Returns
    -------
    Point

    Raises
    ------
    Ended
        If no closed motion was found there.
    IntegrationError, Cancelled
        As `solve`.
    """
    solution = solve(equations, y)
    if not solution.residual <= CLOSED:
        raise Ended(f"the motion closes to {solution.residual:.1e} only")
    linear = equations.linearise(solution.y, whole)
    row = np.zeros(y.size)
    row[-1] = sense
    return Point(solution, linear, _tangent(equations, linear, solution.y, row))


def weights(equations: ClosingEquations, y: np.ndarray) -> np.ndarray:
    """By which lengths of changes of y are measured."""
    weight = np.ones(y.size)
    weight[-1] = 1.0 / equations.unit(y)
    return weight


def _tangent(equations, linear, y, before):
    """Direction of the curve that goes on from the one before, of weighted length 1."""
    right = np.zeros(y.size)
    right[-1] = 1.0
    weight = weights(equations, y)
    matrix = np.vstack([linear.jacobian, weight**2 * before])
    tangent = np.linalg.lstsq(matrix, right, rcond=1e-14)[0]
    return tangent / np.linalg.norm(weight * tangent)


def arrived(
    equations: ClosingEquations, solution: Solution, before: np.ndarray, whole: bool
) -> Point:
    """The point of a solution, with the tangent that goes on in a direction.

    Parameters
    ----------
    equations : ClosingEquations
    solution : Solution
    before : ndarray
        That direction, by y.
    whole : bool
        See `begin`.

    Returns
    -------
    Point

    Raises
    ------
    IntegrationError, Cancelled
        As `ClosingEquations.linearise`.
    """
    linear = equations.linearise(solution.y, whole)
    return Point(solution, linear, _tangent(equations, linear, solution.y, before))


def beside(equations: ClosingEquations, point: Point, step: float, whole: bool) -> Point | None:
    """The point of the curve a step along the tangent of another, None if none was found there.

    Parameters
    ----------
    equations : ClosingEquations
    point : Point
    step : float
        Relative to the parameter.
    whole : bool

    Returns
    -------
    Point or None
    """
    y, tangent = point.solution.y, point.tangent
    weight, ahead = weights(equations, y), y + step * tangent
    try:
        solution = solve(equations, ahead, point.linear, weight**2 * tangent)
        if not solution.residual <= CLOSED:
            return None
        if np.linalg.norm(weight * (solution.y - ahead)) > FARTHEST_CORRECTION * abs(step):
            return None
        found = arrived(equations, solution, tangent, whole)
    except IntegrationError:
        return None
    turned = np.sum(weight**2 * found.tangent * tangent)
    return found if turned > STRAIGHT else None


class Curve:
    """A family under way: its latest point, and how long a step to try next.

    Parameters
    ----------
    equations : ClosingEquations
    first : Point
    whole : bool
        See `begin`.
    longest : float
        Longest step, over the parameter's unit.
    """

    def __init__(
        self,
        equations: ClosingEquations,
        first: Point,
        whole: bool = False,
        longest: float = LONGEST_STEP,
    ):
        self.equations, self.point, self.whole, self.longest = equations, first, whole, longest
        self._step = min(FIRST_STEP, longest)

    def advance(self) -> Point:
        """Go on to the next point.

        Raises
        ------
        Ended
            Where no next point was found however short the step.
        Cancelled
            If it was; the curve goes on from where it is.
        """
        while self._step >= SHORTEST_STEP:
            if self.equations.cancelled is not None and self.equations.cancelled():
                raise Cancelled(f"stopped at {self.point.parameter:.6g}")
            after = beside(self.equations, self.point, self._step, self.whole)
            crossing = after is not None and after.side != self.point.side
            if after is None or (crossing and self._step > CROSSING_STEP):
                self._step *= 0.5
                continue
            if after.solution.corrections <= FEW:
                self._step = min(1.5 * self._step, self.longest)
            elif after.solution.corrections > MANY:
                self._step *= 0.5
            self.point = after
            return after
        y, tangent = self.point.solution.y, self.point.tangent
        why = self.equations.ends(y, SHORTEST_STEP * float(tangent[-1]))
        words = f"no motion was found next to that at {self.point.parameter:.6g}"
        raise Ended(f"{words}: {why}" if why else words)


def bisected(
    curve: Curve, a: Point, b: Point, holds: Callable[[Point], bool], tolerance: float
) -> tuple[Point, Point]:
    """The two points next to where a condition ends that holds for the first and not the last.

    Parameters
    ----------
    curve : Curve
    a, b : Point
        Neighbours on the curve.
    holds : callable
        Whether the condition holds for a `Point`.
    tolerance : float
        Largest distance of the two along the tangent of `a`.

    Returns
    -------
    Point, Point
        The last for which it holds, and the first for which it does not.
    """
    equations, last, first = curve.equations, a, b
    low, high = 0.0, _ahead(equations, a, b)
    while high - low > tolerance:
        step = 0.5 * _ahead(equations, last, first)
        trial = beside(equations, last, step, curve.whole) if step > 0.0 else None
        if trial is None:
            break
        if holds(trial):
            last, low = trial, low + step
        else:
            first, high = trial, low + step
    return last, first


def _ahead(equations, a, b):
    """How far the point `b` lies ahead along the tangent of `a`."""
    weight = weights(equations, a.solution.y)
    return float(np.sum(weight**2 * a.tangent * (b.solution.y - a.solution.y)))
