"""Variations over one turn and the correction of a start to a periodic motion by shooting."""

import contextlib
import math
from dataclasses import dataclass, replace

import numpy as np

from tss_ros.core.errors import IntegrationError
from tss_ros.core.model.symmetry import cyclic_symmetry
from tss_ros.core.model.system import State
from tss_ros.core.motion.displacements import carry, look
from tss_ros.core.motion.propagator import Flow

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
    flow : Flow
    """

    start: State
    end: State
    matrix: np.ndarray
    closure: np.ndarray
    switches: int
    steps: int
    dissipation: float
    flow: Flow

    @property
    def closure_residual(self):
        """|x(T) - x(0)|, scaled, root of the sum of squares over all beads."""
        return float(np.linalg.norm(self.closure))


def to_scaled(flow, state):
    """Scaled coordinates (6n,) in the turning frame of a `State` at time 0 or a whole turn."""
    spin, r, v = flow.plant.spin, state.position_m, np.array(state.velocity_m_s)
    v[:, 0] += spin * r[:, 1]
    v[:, 1] -= spin * r[:, 0]
    return np.concatenate([v.ravel() / flow.control.speed, r.ravel() / flow.control.length])


def from_scaled(flow, x):
    """Inverse of `to_scaled`."""
    v = x[: x.size // 2].reshape(-1, 3) * flow.control.speed
    r = x[x.size // 2 :].reshape(-1, 3) * flow.control.length
    spin = flow.plant.spin
    return State(r, v + spin * np.stack([-r[:, 1], r[:, 0], np.zeros(len(r))], axis=1))


def turn(flow, state, cancelled=None, segments=1):
    """Integrate one turn with all variations, Eqs. (12)-(16).

    Parameters
    ----------
    flow : Flow
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
    size = 6 * flow.system.n
    motion, matrix = flow.begin(state), np.eye(size)
    for segment in range(segments):
        stop = _period(flow) * (segment + 1) / segments
        motion, part = carry(flow, motion, np.eye(size), stop, cancelled)
        matrix = part @ matrix
    x = _scaled_end(flow, motion)
    return Turn(
        state, from_scaled(flow, x), matrix, x - to_scaled(flow, state), int(motion.count[3]),
        int(motion.count[0]), float(motion.dissipation[0]), flow,
    )


def _period(flow, symmetry=None):
    """[s] one turn, or the part of it after which a symmetric motion closes."""
    return 2.0 * math.pi / abs(flow.plant.spin) / (symmetry.order if symmetry else 1)


def _scaled_end(flow, motion):
    return np.concatenate(
        [motion.v.ravel() / flow.control.speed, motion.r.ravel() / flow.control.length]
    )


def closure(flow, state, cancelled=None, symmetry=None):
    """x(T) - x(0) of a start, scaled as in `Turn`, from the motion alone, and its switches.

    Parameters
    ----------
    flow, state, cancelled
        As for `turn`.
    symmetry : Symmetry, optional
        Integrate 1/order of a turn only, and rotate and rename its end so that a symmetric motion
        closes.

    Returns
    -------
    residual : ndarray, shape (6n,)
    switches : int

    Raises
    ------
    IntegrationError, Cancelled
        As `turn`.
    """
    motion, period = flow.begin(state), _period(flow, symmetry)
    while not flow.advance(motion, period, steps=500):
        look(motion, period, cancelled)
    x = _scaled_end(flow, motion)
    if symmetry:
        x = symmetry.back(flow.plant.spin < 0.0, x)
    return x - to_scaled(flow, state), int(motion.count[3])


def corrected(flow, starts, cancelled=None):
    """Shoot for the periodic motion next to the first start that leads to one.

    Where equal satellites make the formation symmetric, a part of the turn is shot for first: that
    is cheaper and keeps the motion symmetric. With damping no motion with varying lengths closes
    exactly (the Jacobi energy falls); the iteration then stops where only directions are left that
    theory leaves free. Weakly damped tethers ring for many turns when started off their slow
    motion, so these are first corrected with added damping.

    Parameters
    ----------
    flow : Flow
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
    for start, missed_by, symmetry in _attempts(flow, starts, cancelled):
        try:
            shots.append((_shoot(flow, start, cancelled, symmetry), start, missed_by))
        except IntegrationError as error:
            failure = failure or error
            continue
        if shots[-1][0].residual <= CLOSED:
            break
    if not shots:
        raise failure
    shot, start, missed_by = min(shots, key=lambda attempt: attempt[0].residual)
    return turn(flow, shot.state, cancelled), start, missed_by


def _attempts(flow, starts, cancelled):
    """Starts with the symmetry to use, and then those near closing once more without.

    Where tethers go slack from both, a start that closes no better than the first is left out: at
    some two thousand rates of different rings none of these led to a motion that closes.
    """
    symmetry, tried = cyclic_symmetry(flow.system), []
    part = symmetry if symmetry.order > 1 else None
    for start in starts:
        if tried:
            first, slack = _missed_by(flow, tried[0][0], cancelled, part)
            other, also_slack = _missed_by(flow, start, cancelled, part)
            if slack and also_slack and other >= first:
                continue
        tried.append((start, _missed_by(flow, start, cancelled)[0]))
        yield *tried[-1], part
    if part:
        yield from ((*attempt, None) for attempt in tried if attempt[1] <= NEAR)


def _missed_by(flow, start, cancelled, symmetry=None):
    """Closure residual of a start, infinite if it cannot be integrated, and its switches."""
    try:
        residual, switches = closure(flow, start, cancelled, symmetry)
    except IntegrationError:
        return math.inf, 0
    return float(np.linalg.norm(residual)), switches


def _shoot(flow, state, cancelled, symmetry):
    """A shot for a part of the turn, if there is a symmetry, and for all of it if that closed."""
    calm = _with_enough_damping(flow.system)
    if calm is not flow.system:
        state = _Shot(flow.of(calm), state, cancelled, symmetry).improve().state
    shot = _Shot(flow, state, cancelled, symmetry).improve()
    if symmetry and shot.residual <= CLOSED:
        shot = _Shot(flow, shot.state, cancelled, None, whole_of=shot)
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


class _Shot:
    """A start that is improved by Newton's method, with matrices used for as long as they serve.

    A motion in the orbit plane stays there, so that only its variations in the plane are needed.
    """

    def __init__(self, flow, state, cancelled, symmetry, whole_of=None):
        self.flow, self.state, self.cancelled, self.symmetry = flow, state, cancelled, symmetry
        x = to_scaled(flow, state)
        self.free = np.arange(x.size)
        if not x[2::3].any():
            self.free = np.delete(self.free, np.s_[2::3])
        if whole_of is None:
            self._renew()
        else:
            parts = whole_of.symmetry.order
            self.closure, self.switches = closure(flow, state, cancelled)
            self._use(
                np.linalg.matrix_power(whole_of.matrix, parts), parts * whole_of.matrix_switches
            )
            self.fresh = False

    @property
    def residual(self):
        return float(np.linalg.norm(self.closure))

    def _renew(self):
        """Find closure and matrix of the present start."""
        begin = self.flow.begin(self.state)
        x, varied = to_scaled(self.flow, self.state), np.eye(6 * self.flow.system.n)[:, self.free]
        stop = _period(self.flow, self.symmetry)
        motion, varied = carry(self.flow, begin, varied, stop, self.cancelled)
        end = _scaled_end(self.flow, motion)
        if self.symmetry:
            end, varied = (
                self.symmetry.back(self.flow.plant.spin < 0.0, part) for part in (end, varied)
            )
        self.closure, self.switches = end - x, int(motion.count[3])
        self._use(varied[self.free], self.switches)
        self.fresh = True

    def _use(self, matrix, switches):
        self.matrix, self.matrix_switches = matrix, switches
        self.decomposed = np.linalg.svd(matrix - np.eye(self.free.size))

    def improve(self):
        """Correct the start as far as it goes; returns itself."""
        with contextlib.suppress(IntegrationError):
            for _ in range(MOST_CORRECTIONS):
                if self.switches != self.matrix_switches:
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
        aim = u[:, bound].T @ self.closure[self.free]
        change = np.zeros(self.closure.size)
        change[self.free] = -(vt[bound].T @ (aim / s[bound]))
        share = np.linalg.norm(aim) / max(self.residual, 1e-300)
        return change * min(1.0, 0.2 / max(np.max(np.abs(change)), 1e-300)), share

    def _try(self, change):
        """Move the start if that makes the residual smaller; returns by what factor it would."""
        state = from_scaled(self.flow, to_scaled(self.flow, self.state) + change)
        try:
            after, switches = closure(self.flow, state, self.cancelled, self.symmetry)
        except IntegrationError:
            return math.inf
        gain = np.linalg.norm(after) / self.residual
        if gain <= (WORTH_IT if switches >= self.switches else 1.0):
            self.state, self.closure, self.switches, self.fresh = state, after, switches, False
        return gain
