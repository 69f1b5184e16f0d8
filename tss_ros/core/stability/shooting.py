"""Variations over one turn and the correction of a start to a periodic motion by shooting."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np

from tss_ros.core.errors import IntegrationError
from tss_ros.core.model.frames import rigid_velocity
from tss_ros.core.model.symmetry import Symmetry, cyclic_symmetry
from tss_ros.core.model.system import State
from tss_ros.core.motion.displacements import carry_displacements, check_limits
from tss_ros.core.motion.propagator import Integrator

#: Directions in which one turn changes a displacement by less than this are not corrected: they
#: are the phases and rates that theory leaves free (multipliers 1 in Jordan blocks).
FREE_DIRECTION = 1e-2
#: Largest scaled closure residual of a motion that is still called periodic.
CLOSED = 1e-3
#: Largest one of a start that is shot from for the whole turn where its symmetric part did not do.
NEAR = 0.1
#: A correction must leave at most this share of the residual to be taken, and at most the smaller
#: one for the matrix to serve again; it is not tried if it aims at less than the smallest.
WORTH_IT, STILL_SERVES, NOTHING_LEFT = 0.9, 0.5, 0.05
#: Largest change of a scaled coordinate in one correction.
LARGEST_CHANGE = 0.2
#: Most corrections of one start.
MOST_CORRECTIONS = 24


@dataclass(frozen=True)
class Turn:
    """One turn of a motion with its variations, in the turning frame, scaled.

    Scaled coordinates are velocities over the rim speed, then positions over the radius, the
    paper's order (29). At whole turns the turning frame coincides with the orbit frame.

    Attributes
    ----------
    start, end : State
        In the orbit frame, before and after the turn.
    matrix : ndarray, shape (6n, 6n)
        Monodromy matrix, Eq. (26), with saltation at every slack/taut switch.
    closure : ndarray, shape (6n,)
        Scaled x(T) - x(0).
    switches, steps : int
        Slack/taut switches and integration steps during the turn.
    dissipation : float
        Sum over tethers of C (1/m_i + 1/m_j) times the time spent taut: minus the logarithm of
        det(matrix) by Liouville's formula.
    integrator : Integrator
    """

    start: State
    end: State
    matrix: np.ndarray
    closure: np.ndarray
    switches: int
    steps: int
    dissipation: float
    integrator: Integrator

    @property
    def closure_residual(self) -> float:
        """|x(T) - x(0)|, scaled, root of the sum of squares over all beads."""
        return float(np.linalg.norm(self.closure))


def to_scaled(integrator: Integrator, state: State) -> np.ndarray:
    """Scaled coordinates (6n,) in the turning frame of a `State` at time 0 or a whole turn."""
    r = state.position_m
    v = state.velocity_m_s - rigid_velocity(r, integrator.arrays.spin)
    return integrator.scaled(v, r)


def from_scaled(integrator: Integrator, x: np.ndarray) -> State:
    """Inverse of `to_scaled`."""
    v = x[: x.size // 2].reshape(-1, 3) * integrator.settings.speed
    r = x[x.size // 2 :].reshape(-1, 3) * integrator.settings.length
    return State(r, v + rigid_velocity(r, integrator.arrays.spin))


def integrate_turn(
    integrator: Integrator,
    state: State,
    cancelled: Callable[[], bool] | None = None,
    segments: int = 1,
) -> Turn:
    """Integrate one turn with all variations, Eqs. (12)-(16).

    Parameters
    ----------
    integrator : Integrator
    state : State
        At the start of the turn, in the orbit frame.
    cancelled : callable, optional
        Asked now and then; a true answer stops the work.
    segments : int
        Cut the turn into equal parts, each with variations of its own, and multiply.

    Returns
    -------
    Turn

    Raises
    ------
    IntegrationError
        If the motion cannot be continued.
    Cancelled
        If `cancelled` said so.
    """
    size = 6 * integrator.system.n
    # The fundamental solutions start from the identity, Eq. (14); at T they are the monodromy
    # matrix, Eq. (26).
    motion, matrix = integrator.begin(state), np.eye(size)
    for segment in range(segments):
        stop = integrator.period_s * (segment + 1) / segments
        motion, part = carry_displacements(integrator, motion, np.eye(size), stop, cancelled)
        matrix = part @ matrix
    x = integrator.scaled(motion.v, motion.r)
    return Turn(
        start=state,
        end=from_scaled(integrator, x),
        matrix=matrix,
        closure=x - to_scaled(integrator, state),
        switches=motion.switches,
        steps=motion.steps,
        dissipation=motion.dissipation,
        integrator=integrator,
    )


@dataclass(frozen=True)
class Closure:
    """How far a motion is from closing.

    Attributes
    ----------
    difference : ndarray, shape (6n,)
        x(T) - x(0), scaled as in `Turn`.
    switches : int
        Slack/taut switches on the way.
    """

    difference: np.ndarray
    switches: int

    @property
    def residual(self) -> float:
        """Norm of the difference."""
        return float(np.linalg.norm(self.difference))


def closure(
    integrator: Integrator,
    state: State,
    cancelled: Callable[[], bool] | None = None,
    symmetry: Symmetry | None = None,
) -> Closure:
    """x(T) - x(0) of a start, from the motion alone.

    Parameters
    ----------
    integrator, state, cancelled
        As for `turn`.
    symmetry : Symmetry, optional
        Integrate 1/order of a turn only, and rotate and rename its end so that a symmetric motion
        closes.

    Returns
    -------
    Closure

    Raises
    ------
    IntegrationError, Cancelled
        As `turn`.
    """
    motion = integrator.begin(state)
    period = integrator.period_s / (symmetry.order if symmetry else 1)
    while not integrator.advance(motion, period, steps=500):
        check_limits(motion, period, cancelled)
    x = integrator.scaled(motion.v, motion.r)
    if symmetry:
        x = symmetry.back(integrator.arrays.spin < 0.0, x)
    return Closure(x - to_scaled(integrator, state), motion.switches)


def close_by_shooting(
    integrator: Integrator, starts: Iterable[State], cancelled: Callable[[], bool] | None = None
) -> tuple[Turn, State, float]:
    """Shoot for the periodic motion next to the first start that leads to one.

    Where equal satellites make the formation symmetric, a part of the turn is shot for first: that
    is cheaper and keeps the motion symmetric. With damping no motion with varying lengths closes
    exactly (the Jacobi energy falls); the iteration then stops where only directions are left that
    theory leaves free. Weakly damped tethers ring for many turns when started off their slow
    motion, so these are first corrected with added damping.

    Parameters
    ----------
    integrator : Integrator
    starts : iterable of State
        Tried in this order, at least one.
    cancelled : callable, optional

    Returns
    -------
    turn : Turn
        That of least residual; its residual says whether it is periodic.
    start : State
        The one that led to it.
    missed_by : float
        Closure residual of that start, infinite if its own turn cannot be integrated.

    Raises
    ------
    IntegrationError
        If no turn could be integrated from any start.
    Cancelled
        If `cancelled` said so.
    """
    shots, failure = [], None
    for start, missed_by, symmetry in _attempts(integrator, starts, cancelled):
        try:
            shots.append((_shoot(integrator, start, cancelled, symmetry), start, missed_by))
        except IntegrationError as error:
            failure = failure or error
            continue
        if shots[-1][0].residual <= CLOSED:
            break
    if not shots:
        raise failure
    shot, start, missed_by = min(shots, key=lambda attempt: attempt[0].residual)
    return integrate_turn(integrator, shot.state, cancelled), start, missed_by


def _attempts(integrator, starts, cancelled):
    """Starts with the symmetry to use, and then those near closing once more without.

    Where tethers go slack from both, a start that closes no better than the first is left out: at
    some two thousand rates of different rings none of these led to a motion that closes.
    """
    symmetry, tried = cyclic_symmetry(integrator.system), []
    part = symmetry if symmetry.order > 1 else None
    for start in starts:
        if tried:
            first, slack = _missed_by(integrator, tried[0][0], cancelled, part)
            other, also_slack = _missed_by(integrator, start, cancelled, part)
            if slack and also_slack and other >= first:
                continue
        tried.append((start, _missed_by(integrator, start, cancelled)[0]))
        yield *tried[-1], part
    if part:
        yield from ((*attempt, None) for attempt in tried if attempt[1] <= NEAR)


def _missed_by(integrator, start, cancelled, symmetry=None):
    """Closure residual of a start, infinite if it cannot be integrated, and its switches."""
    try:
        missed = closure(integrator, start, cancelled, symmetry)
    except IntegrationError:
        return math.inf, 0
    return missed.residual, missed.switches


def _shoot(integrator, state, cancelled, symmetry):
    """A shot for a part of the turn, if there is a symmetry, and for all of it if that closed."""
    calm = _with_enough_damping(integrator.system)
    if calm is not integrator.system:
        state = _NewtonShooting(integrator.of(calm), state, cancelled, symmetry).improve().state
    shot = _NewtonShooting(integrator, state, cancelled, symmetry).improve()
    if symmetry and shot.residual <= CLOSED:
        shot = _NewtonShooting(integrator, shot.state, cancelled, None, whole_of=shot)
        if shot.residual <= NEAR:
            shot.improve()
    return shot


def _with_enough_damping(system):
    """The system itself, or with every segment damped at least critically."""
    first, second = system.tether_ends.T
    reduced = 1.0 / (1.0 / system.mass_kg[first] + 1.0 / system.mass_kg[second])
    critical = 2.0 * np.sqrt(system.axial_stiffness_n / system.rest_length_m * reduced)
    if np.all(system.damping_n_s_per_m >= 0.5 * critical):
        return system
    return replace(
        system, damping_n_s_per_m=np.maximum(system.damping_n_s_per_m, critical)
    )


class _NewtonShooting:
    """A start that is improved by Newton's method, with matrices used for as long as they serve.

    Where a motion in the orbit plane stays there, only its variations in the plane are needed.
    """

    def __init__(self, integrator, state, cancelled, symmetry, whole_of=None):
        self.integrator, self.state = integrator, state
        self.cancelled, self.symmetry = cancelled, symmetry
        x = to_scaled(integrator, state)
        self.free = np.arange(x.size)
        if integrator.system.keeps_plane and not x[2::3].any():
            self.free = np.delete(self.free, np.s_[2::3])
        if whole_of is None:
            self._renew()
        else:
            parts = whole_of.symmetry.order
            self.closure = closure(integrator, state, cancelled)
            self._use(
                np.linalg.matrix_power(whole_of.matrix, parts), parts * whole_of.matrix_switches
            )
            self.fresh = False

    @property
    def residual(self):
        return self.closure.residual

    def _renew(self):
        """Find closure and matrix of the present start."""
        integrator, parts = self.integrator, self.symmetry.order if self.symmetry else 1
        x = to_scaled(integrator, self.state)
        motion, varied = carry_displacements(
            integrator, integrator.begin(self.state), np.eye(x.size)[:, self.free],
            integrator.period_s / parts, self.cancelled,
        )
        end = integrator.scaled(motion.v, motion.r)
        if self.symmetry:
            clockwise = integrator.arrays.spin < 0.0
            end, varied = (self.symmetry.back(clockwise, part) for part in (end, varied))
        self.closure = Closure(end - x, motion.switches)
        self._use(varied[self.free], motion.switches)
        self.fresh = True

    def _use(self, matrix, switches):
        self.matrix, self.matrix_switches = matrix, switches
        self.decomposed = np.linalg.svd(matrix - np.eye(self.free.size))

    def improve(self):
        """Correct the start as far as it goes; returns itself."""
        with contextlib.suppress(IntegrationError):
            for _ in range(MOST_CORRECTIONS):
                if self.closure.switches != self.matrix_switches:
                    self._renew()
                change, share = self._correction()
                if share < NOTHING_LEFT or self.residual < 1e-12:
                    break
                gain = self._try(change)
                if gain > STILL_SERVES:
                    if gain > WORTH_IT and self.fresh:
                        break
                    self._renew()
        return self

    def _correction(self):
        """Change of the scaled start, and the share of the residual that it is meant to remove."""
        u, s, vt = self.decomposed
        bound = s > FREE_DIRECTION
        aim = u[:, bound].T @ self.closure.difference[self.free]
        change = np.zeros(self.closure.difference.size)
        change[self.free] = -(vt[bound].T @ (aim / s[bound]))
        share = np.linalg.norm(aim) / max(self.residual, 1e-300)
        return change * min(1.0, LARGEST_CHANGE / max(np.max(np.abs(change)), 1e-300)), share

    def _try(self, change):
        """Move the start if that makes the residual smaller; returns by what factor it would."""
        integrator = self.integrator
        state = from_scaled(integrator, to_scaled(integrator, self.state) + change)
        try:
            after = closure(integrator, state, self.cancelled, self.symmetry)
        except IntegrationError:
            return math.inf
        gain = after.residual / self.residual
        if gain <= (WORTH_IT if after.switches >= self.closure.switches else 1.0):
            self.state, self.closure, self.fresh = state, after, False
        return gain
