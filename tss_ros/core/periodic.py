"""Variations over one turn and the correction of a start to a periodic motion by shooting."""

import contextlib
import math
from dataclasses import dataclass, replace

import numpy as np

from tss_ros.core.errors import IntegrationError
from tss_ros.core.linear_flow import carry, look
from tss_ros.core.motion import Flow
from tss_ros.core.symmetry import cyclic_symmetry
from tss_ros.core.system import State

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


def turn(flow, state, cancelled=None, segments=1, symmetry=None):
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
    symmetry : Symmetry, optional
        Integrate 1/order of a turn only, and rotate and rename its end so that a symmetric motion
        closes.

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
    half = 3 * flow.system.n
    scale = np.repeat([flow.control.speed, flow.control.length], half)
    motion, matrix = flow.begin(state), np.eye(2 * half)
    period = 2.0 * math.pi / abs(flow.plant.spin) / (symmetry.order if symmetry else 1)
    for segment in range(segments):
        stop = period * (segment + 1) / segments
        motion, part = carry(flow, motion, np.eye(2 * half), stop, cancelled)
        matrix = part @ matrix
    x = np.concatenate([motion.v.ravel(), motion.r.ravel()]) / scale
    if symmetry:
        x, matrix = (symmetry.back(flow.plant.spin < 0.0, part) for part in (x, matrix))
    return Turn(
        state, from_scaled(flow, x), matrix, x - to_scaled(flow, state), int(motion.count[3]),
        int(motion.count[0]), float(motion.dissipation[0]), flow,
    )


def closure(flow, state, cancelled=None, symmetry=None):
    """x(T) - x(0) of a start, scaled as in `Turn`, from the motion alone, and its switches.

    Parameters
    ----------
    flow, state, cancelled, symmetry
        As for `turn`.

    Returns
    -------
    residual : ndarray, shape (6n,)
    switches : int

    Raises
    ------
    IntegrationError, Cancelled
        As `turn`.
    """
    motion = flow.begin(state)
    period = 2.0 * math.pi / abs(flow.plant.spin) / (symmetry.order if symmetry else 1)
    while not flow.advance(motion, period, steps=500):
        look(motion, period, cancelled)
    x = np.concatenate(
        [motion.v.ravel() / flow.control.speed, motion.r.ravel() / flow.control.length]
    )
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

    Raises
    ------
    IntegrationError
        If no turn could be integrated from any start.
    Cancelled
        If `cancelled` said so.
    """
    shots, failure = [], None
    for start, symmetry in _attempts(flow, starts, cancelled):
        try:
            shots.append((_shoot(flow, start, cancelled, symmetry), start))
        except IntegrationError as error:
            failure = failure or error
            continue
        if shots[-1][0].residual <= CLOSED:
            break
    if not shots:
        raise failure
    shot, start = min(shots, key=lambda pair: pair[0].residual)
    whole = None if shot.symmetry else shot.turn
    return whole or turn(flow, shot.state, cancelled), start


def _attempts(flow, starts, cancelled):
    """Starts with the symmetry to use, and then those near closing once more without."""
    symmetry, tried = cyclic_symmetry(flow.system), []
    for start in starts:
        yield start, symmetry if symmetry.order > 1 else None
        tried.append(start)
    if symmetry.order > 1:
        yield from ((start, None) for start in tried if _near(flow, start, cancelled))


def _shoot(flow, state, cancelled, symmetry):
    """A shot for a part of the turn, if there is a symmetry, and for all of it if that closed."""
    calm = _with_enough_damping(flow.system)
    if calm is not flow.system:
        state = _Shot(flow.of(calm), state, cancelled, symmetry).improve().state
    shot = _Shot(flow, state, cancelled, symmetry).improve()
    if symmetry and shot.residual <= CLOSED:
        shot = _Shot(flow, shot.state, cancelled, None, whole_of=shot).improve()
    return shot


def _near(flow, state, cancelled):
    """Whether it is worth while to shoot for the whole turn from here."""
    try:
        return np.linalg.norm(closure(flow, state, cancelled)[0]) <= NEAR
    except IntegrationError:
        return False


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
    """A start that is improved by Newton's method, with matrices used for as long as they serve."""

    def __init__(self, flow, state, cancelled, symmetry, whole_of=None):
        self.flow, self.state, self.cancelled, self.symmetry = flow, state, cancelled, symmetry
        self.turn = None
        if whole_of is None:
            self._renew()
        else:
            parts = whole_of.symmetry.order
            self.matrix = np.linalg.matrix_power(whole_of.matrix, parts)
            self.matrix_switches = parts * whole_of.matrix_switches
            self.closure, self.switches = closure(flow, state, cancelled)

    @property
    def residual(self):
        return float(np.linalg.norm(self.closure))

    def _renew(self):
        self.turn = turn(self.flow, self.state, self.cancelled, symmetry=self.symmetry)
        self.matrix, self.closure = self.turn.matrix, self.turn.closure
        self.switches = self.matrix_switches = self.turn.switches

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
                    if gain > WORTH_IT and self.turn:
                        break
                    self._renew()
        return self

    def _correction(self):
        """Change of the scaled start, and the share of the residual that it is meant to remove."""
        u, s, vt = np.linalg.svd(self.matrix - np.eye(self.closure.size))
        bound = s > FREE_DIRECTION
        aim = u[:, bound].T @ self.closure
        change = -(vt[bound].T @ (aim / s[bound]))
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
            self.state, self.closure, self.switches, self.turn = state, after, switches, None
        return gain
