"""Where another family crosses: branches at branch points, and doubled ones at period doublings.

At such a point the derivatives of the closing equations leave two directions free: that of the
family followed, and one more, in which the branch leaves. The branch may lack what the family has:
it may leave the orbit plane, lose the formation's symmetry, or close after two turns only.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from tss_ros.core.errors import IntegrationError, TssError
from tss_ros.core.model.system import System
from tss_ros.core.stability import continuation, families
from tss_ros.core.stability.closing import CLOSED, ClosingEquations, Solution, solve
from tss_ros.core.stability.continuation import Curve, Point
from tss_ros.core.stability.family import SpecialPoint
from tss_ros.core.stability.modes import stays_in_plane

#: Turns after which the motions of a branch close, by the kind of point it leaves at.
TURNS = {"branch point": 1, "period doubling": 2}
BRANCH_KINDS = tuple(TURNS)
#: Least singular value, over the largest, that leaves a direction free; and how much less it may
#: be with displacements out of the plane for the direction to lie in the plane.
FREE, IN_PLANE = 1e-4, 30.0
#: First steps that are tried along a branch, and the farthest motion that may be found, in steps.
FIRST_STEPS, FARTHEST = (0.01, 0.003, 0.001), 3.0


def crossing_curve(
    at: Callable[[float], tuple[System, float]],
    parameter: str,
    ends: tuple[float, float],
    point: SpecialPoint,
    longest_step: float,
    cancelled: Callable[[], bool] | None = None,
) -> tuple[tuple[float, float], Curve]:
    """The curve that crosses a family at a special point.

    Parameters
    ----------
    at : callable
        System and spin rate [rad/s] of a value of the parameter.
    parameter : str
    ends : tuple of float
        The interval in which it is to be followed.
    point : SpecialPoint
    longest_step : float
        As for `follow`.
    cancelled : callable, optional

    Returns
    -------
    ends : tuple of float
        The same, or turned round if the branch goes the other way on both its sides.
    curve : Curve
        At the first motion beside the special point.

    Raises
    ------
    TssError
        If no branch leaves there.
    Cancelled
        If `cancelled` said so.
    """
    if point.kind not in TURNS:
        raise TssError(
            f"branch must be a {' or a '.join(BRANCH_KINDS)}, got a {point.kind} at {parameter}"
            f" {point.parameter:g}"
        )
    low, high = sorted(ends)
    if not low <= point.parameter <= high:
        raise TssError(
            f"branch must lie from {ends[0]:g} to {ends[1]:g}, got one at {parameter}"
            f" {point.parameter:g}"
        )
    scale = None if low * high > 0.0 else high - low
    equations, here, direction = _free(at, point, scale, cancelled)
    sides = [_beside(equations, here, sign * direction) for sign in (1.0, -1.0)]
    sides = [side for side in sides if side is not None]
    if not sides:
        raise TssError(
            f"no motion was found on a branch at {parameter} {point.parameter:g}, with first steps"
            f" of {', '.join(f'{step:g}' for step in FIRST_STEPS)}"
        )
    sense = np.sign(ends[1] - ends[0])
    onward = [side for side in sides if (side.parameter - here.parameter) * sense > 0.0]
    chosen = (onward or sides)[0]
    return (ends if onward else ends[::-1]), Curve(equations, chosen, True, longest_step)


def _free(at, point, scale, cancelled):
    """Equations, point and direction of the branch that leaves at a special point."""
    system, _ = at(point.parameter)
    tried = []
    for planar in (True, False) if stays_in_plane(system, point.state) else (False,):
        equations = ClosingEquations(
            at, families.size_of(system), planar, families.no_symmetry(system), families.RTOL,
            cancelled, scale, TURNS[point.kind] * point.turns,
        )  # fmt: skip
        here = _at_point(equations, point)
        weight = continuation.weights(equations, here.solution.y)
        _, size, directions = np.linalg.svd(here.linear.jacobian / weight)
        # The last direction is that of the family.
        tried.append((size[-1] / size[0], equations, here, directions[-2] / weight))
    if len(tried) == 2 and tried[0][0] > IN_PLANE * tried[1][0]:
        tried.pop(0)
    least, *found = tried[0]
    if not least <= FREE:
        raise TssError(
            f"no branch leaves at {point.kind} {point.parameter:g}: the least singular value is"
            f" {least:.1e} of the largest, {FREE:g} would do"
        )
    return found


def _at_point(equations, point):
    """The closed motion of a special point; only its drive is sought, for all else is free."""
    y = equations.vector(point.state, point.parameter)
    for _ in range(3):
        left, switches = equations.shoot(y)
        linear = equations.linearise(y, True)
        k = left.size
        y[k : k + 2] -= np.linalg.lstsq(linear.jacobian[:k, k : k + 2], left, rcond=None)[0]
    left, switches = equations.shoot(y)
    solution = Solution(y, float(np.linalg.norm(left)), switches, 0)
    return Point(solution, equations.linearise(y, True), np.zeros(y.size))


def _beside(equations, here, direction):
    """A point of the branch next to where it leaves in a direction, None if none was found."""
    y = here.solution.y
    weight = continuation.weights(equations, y)
    for step in FIRST_STEPS:
        ahead = y + step * direction
        try:
            solution = solve(equations, ahead, None, weight**2 * direction)
            if not solution.residual <= CLOSED:
                continue
            if np.linalg.norm(weight * (solution.y - y)) > FARTHEST * step:
                continue
            return continuation.arrived(equations, solution, solution.y - y, True)
        except IntegrationError:
            continue
    return None
