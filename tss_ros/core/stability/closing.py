"""The equations of motions that close, and Newton's method for them (shooting)."""

from __future__ import annotations

import contextlib
import copy
import math
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tss_ros.core.errors import IntegrationError, NoSteadyState, TssError
from tss_ros.core.model.axes import spin_axis_of
from tss_ros.core.model.elements import require_autonomous
from tss_ros.core.model.symmetry import Symmetry
from tss_ros.core.model.system import State, System
from tss_ros.core.motion.displacements import carry_displacements
from tss_ros.core.motion.integrator import Integrator
from tss_ros.core.stability.shooting import (
    carried_motion,
    flow_direction,
    from_scaled,
    to_scaled,
)

#: Largest norm of what is left of the closing equations of a motion that counts as closed, and
#: what is not worth a correction.
CLOSED, NOTHING_LEFT = 1e-6, 1e-10
#: A correction must leave at most this share of the residual to be taken, and at most the smaller
#: one for the matrix to serve again.
WORTH_IT, STILL_SERVES = 0.9, 0.3
#: Largest change of a scaled coordinate in one correction, most corrections of one start, and
#: singular values, over the largest, that count as none.
LARGEST_CHANGE, MOST_CORRECTIONS, SINGULAR = 0.2, 24, 1e-8
#: Steps of the drive's share of the spin and of p over its value, for derivatives.
SMALL_LOSS, SMALL_CHANGE = 1e-5, 1e-5


class ClosingEquations:
    """The equations of motions that close, along a parameter p: as many as unknowns but p.

    With damping no motion with varying lengths closes by itself, and without it the energy makes
    one equation follow from the others. Both are mended by unknowns of their own (F. J.
    Munoz-Almaraz and others, Physica D 181, 2003): a drive, an angular acceleration that gives the
    spin in a turn what damping takes of it, and a kick along the orbit, which takes away the
    momentum that the drive brings. Without damping they come out as 0. Two conditions fix what the
    autonomous orbit frame leaves free, the phase of the spin and the place along the orbit.

    Unknowns are gathered in a vector y: the scaled start (only in the orbit plane for motions that
    stay there), the share of the spin that the drive gives in a turn, the kick, and p.

    Parameters
    ----------
    at : callable
        System and spin rate [rad/s] of a value of p.
    length_m : float
        [m] scale of positions; with the rate, that of velocities.
    planar : bool
        Whether the motions stay in the orbit plane.
    symmetry : Symmetry
        Integrate 1/order of a turn only, and rename its end so that a symmetric motion closes.
    rtol : float
        Of the integration.
    cancelled : callable, optional
        Asked now and then; a true answer stops the work.
    scale : float, optional
        By which changes of p are measured; by its value if not given.
    turns : int
        After which the motions close.
    """

    def __init__(
        self,
        at: Callable[[float], tuple[System, float]],
        length_m: float,
        planar: bool,
        symmetry: Symmetry,
        rtol: float,
        cancelled: Callable[[], bool] | None = None,
        scale: float | None = None,
        turns: int = 1,
    ):
        self.scale, self.turns = scale, turns
        self.at, self.length, self.rtol, self.cancelled = at, length_m, rtol, cancelled
        self.symmetry, self.size = symmetry, 6 * symmetry.successor.size
        self.free = np.arange(self.size)
        part, beads = np.arange(3 * symmetry.successor.size), 3 * symmetry.beads
        some = ((part < beads) | (part % 3 == 0)) & ~(planar & (part % 3 == 2))
        self.free = self.free[np.tile(some, 2)]
        half = np.zeros((2, self.size))
        half[0, :beads:3] = half[1, part.size : part.size + beads : 3] = 1.0
        #: Velocities, and places, of all beads along the orbit, of norm 1.
        self.kick, self.along = (half / math.sqrt(symmetry.beads))[:, self.free]
        self._integrators = OrderedDict()

    def copied(self, cancelled: Callable[[], bool] | None) -> ClosingEquations:
        """The same equations for another thread, to be cancelled by its own."""
        other = copy.copy(self)
        other.cancelled, other._integrators = cancelled, OrderedDict()
        return other

    def unit(self, y: np.ndarray) -> float:
        """By which changes of p at y are measured."""
        return self.scale or abs(float(y[-1]))

    def integrator(self, y: np.ndarray) -> Integrator:
        """That of a vector y, with its drive about the axis of the motion."""
        integrator = self._undriven(float(y[-1]))
        if integrator.arrays.spin:
            return integrator.driven(float(y[-3]))
        start = from_scaled(integrator, self._start(y))
        axis = spin_axis_of(integrator.system, start, integrator.spin)
        return integrator.driven(float(y[-3]), axis)

    def _undriven(self, p):
        if p not in self._integrators:
            try:
                system, spin = self.at(p)
            except TssError as error:  # beyond what is allowed
                raise IntegrationError(str(error)) from None
            require_autonomous(system, "a family of periodic motions")
            try:
                self._integrators[p] = Integrator(system, spin, self.rtol, self.length)
            except NoSteadyState as error:  # feedback has no shape to keep there
                raise IntegrationError(str(error)) from None
            if self._integrators[p].rows != self.symmetry.successor.size:
                del self._integrators[p]
                raise IntegrationError("reels follow tension only where their law acts")
            if len(self._integrators) > 2:
                self._integrators.popitem(last=False)
        return self._integrators[p]

    def ends(self, y: np.ndarray, change: float) -> str:
        """Why p cannot be changed by so much at y; "" if it can."""
        try:
            self._undriven(float(y[-1]) + change)
        except IntegrationError as error:
            return str(error)
        return ""

    def vector(self, state: State, p: float, loss: float = 0.0) -> np.ndarray:
        """y of a start in the orbit frame."""
        start = to_scaled(self._undriven(float(p)), state)
        return np.concatenate([start[self.free], [loss, 0.0, p]])

    def state(self, y: np.ndarray) -> State:
        """The start of a vector y, in the orbit frame."""
        return from_scaled(self._undriven(float(y[-1])), self._start(y))

    def lost(self, y: np.ndarray) -> float:
        """Share of the spin that a motion loses in a turn and no feedback gives back."""
        return self._undriven(float(y[-1])).lost(float(y[-3]))

    def time_s(self, integrator: Integrator) -> float:
        """[s] that is integrated."""
        return self.turns * integrator.period_s / self.symmetry.order

    def _start(self, y):
        x = np.zeros(self.size)
        x[self.free] = y[:-3]
        return x

    def shoot(self, y: np.ndarray) -> tuple[np.ndarray, int]:
        """What is left of the equations (k,), and the switches on the way."""
        integrator, x = self.integrator(y), self._start(y)
        stop = self.time_s(integrator)
        motion = carried_motion(integrator, from_scaled(integrator, x), stop, self.cancelled)
        return self._left(integrator, motion, x, y), motion.switches

    def _left(self, integrator, motion, x, y):
        end = self._back(integrator, integrator.scaled(motion.v, motion.r))
        return (end - x)[self.free] + y[-2] * self.kick

    def _back(self, integrator, x):
        if self.symmetry.order == 1:
            return x
        turning = integrator.arrays.spin != 0.0
        back = self.symmetry.back if turning else self.symmetry.renamed
        return back(integrator.spin < 0.0, x)

    def linearise(self, y: np.ndarray, whole: bool = False) -> Linearised:
        """Their derivatives there.

        Parameters
        ----------
        y : ndarray
        whole : bool
            Carry displacements out of the plane of a planar motion, too.

        Returns
        -------
        Linearised
        """
        integrator, x = self.integrator(y), self._start(y)
        state, stop = from_scaled(integrator, x), self.time_s(integrator)
        columns = np.eye(self.size) if whole else np.eye(self.size)[:, self.free]
        motion, carried = carry_displacements(
            integrator, integrator.begin(state), columns, stop, self.cancelled
        )
        left, matrix = self._left(integrator, motion, x, y), self._back(integrator, carried)
        part = matrix[np.ix_(self.free, self.free)] if whole else matrix[self.free]
        k = self.free.size
        jacobian = np.zeros((k + 2, k + 3))
        jacobian[:k, :k] = part - np.eye(k)
        change = SMALL_CHANGE * self.unit(y)
        if why := self.ends(y, change):
            change = -change
            if self.ends(y, change):
                raise IntegrationError(why)
        for column, step in ((k, SMALL_LOSS), (k + 2, change)):
            beside = np.array(y)
            beside[column] += step
            jacobian[:k, column] = (self.shoot(beside)[0] - left) / step
        jacobian[:k, k + 1] = self.kick
        flow = flow_direction(integrator, state)[self.free]
        jacobian[k, :k], jacobian[k + 1, :k] = flow / np.linalg.norm(flow), self.along
        return Linearised(jacobian, matrix if whole else None, motion.switches)


@dataclass(frozen=True)
class Linearised:
    """The derivatives of the closing equations.

    Attributes
    ----------
    jacobian : ndarray, shape (k + 2, k + 3)
        Of them and of the two conditions, by y.
    matrix : ndarray, shape (6 rows, 6 rows), or None
        Variations over the part of the turn that is integrated, renamed.
    switches : int
        On the way.
    """

    jacobian: np.ndarray
    matrix: np.ndarray | None
    switches: int


@dataclass(frozen=True)
class Solution:
    """A vector y that solves the closing equations as far as they could be.

    Attributes
    ----------
    y : ndarray
    residual : float
        Norm of what is left.
    switches : int
        On the part of the turn that is integrated.
    corrections : int
        That it took.
    """

    y: np.ndarray
    residual: float
    switches: int
    corrections: int


def solve(
    equations: ClosingEquations,
    y: np.ndarray,
    known: Linearised | None = None,
    row: np.ndarray | None = None,
) -> Solution:
    """Newton's method from a vector y, with matrices used for as long as they serve.

    Parameters
    ----------
    equations : ClosingEquations
    y : ndarray
    known : Linearised, optional
        Derivatives near y to begin with.
    row : ndarray, optional
        Direction in which y must not move; if not given, p stays as it is.

    Returns
    -------
    Solution
        Of least residual; whether that is small enough is for the caller to say.

    Raises
    ------
    IntegrationError
        If the motion from y cannot be continued.
    Cancelled
        If it was.
    """
    if row is None:
        row = np.zeros(y.size)
        row[-1] = 1.0
    left, switches = equations.shoot(y)
    fresh, corrections = known is None, 0
    if fresh:
        known = equations.linearise(y)
    residual = np.linalg.norm(left)
    while residual > NOTHING_LEFT and corrections < MOST_CORRECTIONS:
        corrections += 1
        matrix = np.vstack([known.jacobian, row])
        right = np.concatenate([left, [0.0, 0.0, 0.0]])
        change = -np.linalg.lstsq(matrix, right, rcond=SINGULAR)[0]
        change *= min(1.0, LARGEST_CHANGE / max(np.max(np.abs(change[:-3])), 1e-300))
        gain = math.inf
        for size in (1.0, 0.5, 0.25) if fresh else (1.0,):
            with contextlib.suppress(IntegrationError):
                trial = y + size * change
                after, also = equations.shoot(trial)
                gain = np.linalg.norm(after) / residual
                if gain < WORTH_IT:
                    break
        if gain >= WORTH_IT:
            if fresh:
                break
        else:
            y, left, residual, switches = trial, after, residual * gain, also
            fresh = False
        if gain > STILL_SERVES or switches != known.switches:
            if residual <= NOTHING_LEFT:
                break
            try:
                known, fresh = equations.linearise(y), True
            except IntegrationError:
                break
    return Solution(y, float(residual), switches, corrections)
