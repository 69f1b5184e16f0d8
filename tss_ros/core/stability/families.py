"""The motion that a question about a spin rate is about: that of the formation's own family.

Several periodic motions may exist at one rate. The formation's own is the one that comes down from
fast spin without a break: fast enough, every formation that is taut turns nearly as a rigid body.
Its family is followed once for every system, always from the same start by the same steps, so that
the answer for a rate does not depend on what was asked before.
"""

from __future__ import annotations

import bisect
import threading
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from tss_ros.core.errors import IntegrationError, NoSteadyState
from tss_ros.core.model.configurations import averaged_state
from tss_ros.core.model.symmetry import Symmetry, cyclic_symmetry, no_symmetry
from tss_ros.core.model.system import State, System
from tss_ros.core.stability import continuation
from tss_ros.core.stability.acceptance import look
from tss_ros.core.stability.closing import CLOSED, ClosingEquations, Solution, solve
from tss_ros.core.stability.continuation import Ended
from tss_ros.core.stability.modes import stays_in_plane

#: Rates over Omega at which a family may begin, tried in this order.
FAST = (10.0, 7.0, 5.0, 15.0, 20.0, 4.0, 30.0, 3.0, 50.0, 100.0)
#: Accuracy of the motions of a family.
RTOL = 1e-10
#: Largest share of the spin that damping may take in a turn: motions that lose more are not nearly
#: periodic.
MOST_LOSS = 0.01
#: Most points of a family, and most beads of a system whose family is followed.
MOST_POINTS, MOST_BEADS = 400, 30
#: Points without going farther after which a family is said to turn round for good.
MOST_IDLE = 60
#: How near to its end a family is followed, over the rate.
END_TOLERANCE = 1e-6


@dataclass(frozen=True)
class Closed:
    """A motion that closes.

    Attributes
    ----------
    state : State
        Its start in the orbit frame.
    spin_loss : float
        Share of the spin that damping takes in a turn, which a drive gives back.
    residual : float
        Norm of what is left of the closing equations.
    origin : str
        Where it comes from, in words.
    """

    state: State
    spin_loss: float
    residual: float
    origin: str


def rate_equations(
    system: System,
    state: State,
    symmetry: Symmetry | None = None,
    cancelled: Callable[[], bool] | None = None,
) -> ClosingEquations:
    """The closing equations of a system along the spin rate, for motions like that of a state.

    Parameters
    ----------
    system : System
    state : State
        Says whether they stay in the orbit plane.
    symmetry : Symmetry, optional
        That of the system if not given.
    cancelled : callable, optional

    Returns
    -------
    ClosingEquations
    """
    return ClosingEquations(
        lambda ratio: (system, system.spin_rate_rad_s(ratio)),
        size_of(system),
        stays_in_plane(system, state),
        symmetry or cyclic_symmetry(system),
        RTOL,
        cancelled,
    )


def size_of(system: System) -> float:
    """[m] largest distance of a bead from the layout's centre of mass."""
    centre = np.average(system.layout_m, axis=0, weights=system.mass_kg)
    return float(np.max(np.linalg.norm(system.layout_m - centre, axis=1)))


class OwnFamily:
    """The motions of a system that come down from fast spin, one sense of the spin.

    Where the family turns round in a fold it is followed on, for it may turn once more and go on.
    Of several of its motions at one rate the one that is met first is meant.

    Parameters
    ----------
    system : System
    sense : int
        +1 or -1, that of the spin.
    """

    def __init__(self, system: System, sense: int):
        self.system, self.sense = system, sense
        self.lock = threading.Lock()
        self._equations, self._no_start = None, ""
        self._slower, self._faster = _Front(-sense), _Front(sense)

    def at(self, ratio: float, cancelled: Callable[[], bool] | None = None) -> Closed:
        """The motion at a rate over Omega.

        Raises
        ------
        Ended
            If the family does not reach that rate, or does not begin; the text says why.
        Cancelled
            If `cancelled` said so.
        """
        with self.lock:
            if self._equations is None and not self._no_start:
                self._begin(cancelled)
            if self._no_start:
                raise Ended(self._no_start)
            self._equations.cancelled = cancelled
            start = self._slower.start
            front = self._slower if abs(ratio) <= abs(start) else self._faster
            a, b = front.around(ratio)
            folds = front.folds_before(ratio)
            equations = self._equations.copied(cancelled)
        solution = _between(equations, a, b, _interpolated(a, b, ratio))
        origin = f"the formation's own family, followed from {start:g}"
        if folds:
            origin += f" and round folds at {', '.join(f'{fold:.5g}' for fold in folds)}"
        return closed(equations, solution, origin)

    def _begin(self, cancelled):
        """Find the motion from which the family is followed both ways."""
        failure = ""
        for size in FAST:
            ratio = self.sense * size
            try:
                state = averaged_state(self.system, ratio)
                equations = rate_equations(self.system, state, cancelled=cancelled)
                y = equations.vector(state, ratio)
                first = continuation.begin(equations, y, -self.sense, False)
                refusal = "tethers go slack in it" if first.solution.switches else ""
                y = first.solution.y
                refusal = refusal or look(equations.integrator(y), equations.state(y)).refusal
            except (Ended, NoSteadyState, IntegrationError) as error:
                refusal = str(error)
            if not refusal:
                self._equations = equations
                self._slower.begin(equations, first)
                self._faster.begin(equations, replace(first, tangent=-first.tangent))
                return
            failure = failure or f"at {ratio:g}: {refusal}"
        self._no_start = (
            f"no motion to follow from fast spin was found at any of {len(FAST)} rates tried;"
            f" {failure}"
        )


class _Front:
    """How far a family has been followed in one direction, by the segments that went farther."""

    def __init__(self, sense):
        self._sense = sense
        self._segments, self._folds, self._end = [], [], ""

    def begin(self, equations, first):
        self.start, self._first = first.parameter, first
        self._curve = continuation.Curve(equations, first)
        self._farthest, self._idle, self._made = first.parameter, 0, 0

    def around(self, ratio):
        """The points between which a rate lies; raises `Ended` where the family does not reach."""
        if ratio == self.start:
            return self._first, self._first
        while (self._farthest - ratio) * self._sense < 0.0:
            if self._end:
                raise Ended(self._end)
            try:
                self._extend()
            except Ended as end:
                self._end = str(end)
        ends = [b.parameter * self._sense for _, b in self._segments]
        return self._segments[bisect.bisect_left(ends, ratio * self._sense)]

    def folds_before(self, ratio):
        """Where the family turned round on the way to a rate."""
        return [fold for farthest, fold in self._folds if (farthest - ratio) * self._sense < 0.0]

    def _extend(self):
        """Follow the family by one more point."""
        before, point = self._curve.point, self._curve.advance()
        self._made += 1
        turned = before.tangent[-1] * point.tangent[-1] < 0.0
        if turned:
            sign = before.tangent[-1]
            middle = self._bisected(before, point, lambda p: p.tangent[-1] * sign > 0.0)
            self._folds.append((self._farthest, middle.parameter))
            if before.tangent[-1] * self._sense > 0.0:
                self._reach(before, middle)
                self._folds[-1] = (self._farthest, middle.parameter)
        lost = self._curve.equations.lost
        if lost(point.solution.y) > MOST_LOSS:
            last = self._bisected(before, point, lambda p: lost(p.solution.y) <= MOST_LOSS)
            self._reach(before, last)
            raise Ended(
                f"damping takes more than {MOST_LOSS:.0%} of the spin in a turn"
                f" from {last.parameter:.5g} on"
            )
        self._idle = 0 if self._reach(before, point) else self._idle + 1
        if self._idle >= MOST_IDLE:
            raise Ended(
                f"it turns round in a fold at {self._farthest:.5g} and was followed"
                f" {MOST_IDLE} points beyond"
            )
        if self._made >= MOST_POINTS:
            raise Ended(f"it was followed to {self._farthest:.5g}, {MOST_POINTS} points")

    def _reach(self, a, b):
        """Take in the segment between two points if it goes farther than any before."""
        onward = (b.parameter - a.parameter) * self._sense > 0.0
        if onward and (b.parameter - self._farthest) * self._sense > 0.0:
            self._segments.append((a, b))
            self._farthest = b.parameter
            return True
        return False

    def _bisected(self, before, point, holds):
        """The last point between two for which a condition holds that holds for the first."""
        return continuation.bisected(self._curve, before, point, holds, END_TOLERANCE)[0]


def _between(equations, a, b, guess):
    """Solve at a rate between two points, next to a guess or else to one of them."""
    near = 1e-3 + 0.5 * np.linalg.norm(a.solution.y[:-3] - b.solution.y[:-3])
    for start, linear in (
        (guess, a.linear), (a.solution.y, a.linear), (b.solution.y, b.linear)
    ):  # fmt: skip
        y = np.append(start[:-1], guess[-1])
        try:
            solution = solve(equations, y, linear)
        except IntegrationError:
            continue
        if solution.residual <= CLOSED and np.linalg.norm((solution.y - y)[:-3]) <= near:
            return solution
    raise Ended(f"no motion was found between those at {a.parameter:.6g} and {b.parameter:.6g}")


def _interpolated(a, b, ratio):
    """y at a rate between two points, by the cubic that has their tangents."""
    p, q = a.solution.y, b.solution.y
    weight = np.ones(p.size)
    weight[-1] = 1.0 / abs(p[-1])  # as tangents are
    chord = np.linalg.norm(weight * (q - p))

    def y(t):
        return (
            (1 + 2 * t) * (1 - t) ** 2 * p + t * (1 - t) ** 2 * chord * a.tangent
            + t**2 * (3 - 2 * t) * q - t**2 * (1 - t) * chord * b.tangent
        )  # fmt: skip

    low, high = (0.0, 1.0) if p[-1] < q[-1] else (1.0, 0.0)
    for _ in range(50):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if y(middle)[-1] < ratio else (low, middle)
    guess = y(0.5 * (low + high))
    guess[-1] = ratio
    return guess


def closed(equations: ClosingEquations, solution: Solution, origin: str) -> Closed:
    """The motion of a solution."""
    y = solution.y
    return Closed(equations.state(y), float(y[-3]), solution.residual, origin)


def nearest_motion(
    system: System, ratio: float, start: State, cancelled: Callable[[], bool] | None = None
) -> Closed:
    """The motion to which Newton's method leads from a start.

    Where equal satellites make the formation symmetric, symmetric motions are sought first.

    Parameters
    ----------
    system : System
    ratio : float
    start : State
    cancelled : callable, optional

    Returns
    -------
    Closed
        Of least residual found; that says whether it closes.

    Raises
    ------
    IntegrationError
        If no turn could be integrated from the start.
    Cancelled
        If `cancelled` said so.
    """
    symmetry = cyclic_symmetry(system)
    none = no_symmetry(system)
    origin = getattr(start, "origin", "") or "the given state"
    found, failure = [], None
    for part in (symmetry, none) if symmetry.order > 1 else (none,):
        equations = rate_equations(system, start, part, cancelled)
        try:
            solution = solve(equations, equations.vector(start, ratio))
            found.append(closed(equations, solution, origin))
        except IntegrationError as error:
            failure = error
            continue
        if found[-1].residual <= CLOSED:
            break
    if not found:
        raise failure
    return min(found, key=lambda motion: motion.residual)
