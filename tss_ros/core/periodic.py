"""Variations over one turn and the correction of a start to a periodic motion by shooting."""

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
#: Residual of a part of a turn from which on the whole turn is not corrected again.
NEARLY_CLOSED = 1e-3


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


def closure_residual(flow, state, cancelled=None):
    """|x(T) - x(0)| of a start, scaled as in `Turn`, from the motion alone, and its switches.

    Parameters
    ----------
    flow : Flow
    state : State
    cancelled : callable, optional

    Returns
    -------
    residual : float
    switches : int

    Raises
    ------
    IntegrationError, Cancelled
        As `turn`.
    """
    motion = flow.begin(state)
    period = 2.0 * math.pi / abs(flow.plant.spin)
    while not flow.advance(motion, period, steps=500):
        look(motion, period, cancelled)
    x = np.concatenate(
        [motion.v.ravel() / flow.control.speed, motion.r.ravel() / flow.control.length]
    )
    return float(np.linalg.norm(x - to_scaled(flow, state))), int(motion.count[3])


def corrected(flow, state, cancelled=None, iterations=8):
    """Shoot for the periodic motion next to `state`, or the one of least residual.

    Where equal satellites make the formation symmetric, a part of the turn is shot for first: that
    is cheaper and keeps the motion symmetric. With damping no motion with varying lengths closes
    exactly (the Jacobi energy falls); the iteration then stops where the residual no longer falls.
    Weakly damped tethers ring for many turns when started off their slow motion, so these are
    first corrected with added damping.

    Parameters
    ----------
    flow : Flow
    state : State
    cancelled : callable, optional
    iterations : int
        Most corrections.

    Returns
    -------
    Turn
        The turn of least residual found; its residual says whether it is periodic.

    Raises
    ------
    IntegrationError
        If not even the first turn could be integrated.
    Cancelled
        If `cancelled` said so.
    """
    symmetry = cyclic_symmetry(flow.system)
    symmetry = symmetry if symmetry.order > 1 else None
    calm = _with_enough_damping(flow.system)
    if calm is not flow.system:
        state = _shoot(flow.of(calm), state, cancelled, iterations, symmetry).start
    if symmetry:
        best = _shoot(flow, state, cancelled, iterations, symmetry)
        if best.closure_residual <= NEARLY_CLOSED:
            state = best.start
    return _shoot(flow, state, cancelled, iterations)


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


def _shoot(flow, state, cancelled, iterations, symmetry=None):
    latest = best = turn(flow, state, cancelled, symmetry=symmetry)
    for _ in range(iterations):
        u, s, vt = np.linalg.svd(latest.matrix - np.eye(latest.closure.size))
        bound = s > FREE_DIRECTION
        change = -(vt[bound].T @ ((u[:, bound].T @ latest.closure) / s[bound]))
        change *= min(1.0, 0.2 / max(np.max(np.abs(change)), 1e-300))
        state = from_scaled(flow, to_scaled(flow, latest.start) + change)
        try:
            latest = turn(flow, state, cancelled, symmetry=symmetry)
        except IntegrationError:
            break
        gain = latest.closure_residual / best.closure_residual
        if gain < 1.0:
            best = latest
        if gain > 0.9 or best.closure_residual < 1e-12:
            break
    return best
