"""One turn of a motion: how far it is from closing, and with all its variations."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tss_ros.core.model import forces
from tss_ros.core.model.frames import rigid_velocity
from tss_ros.core.model.reel_law import rests_in_rows, rows_of, state_of
from tss_ros.core.model.system import State
from tss_ros.core.motion.displacements import carry_displacements, check_limits
from tss_ros.core.motion.integrator import Integrator
from tss_ros.core.motion.state import IntegratorState


@dataclass(frozen=True)
class Turn:
    """One turn of a motion with its variations, in the turning frame, scaled.

    Scaled coordinates are velocities over the rim speed, then positions over the radius, the
    paper's order (29). At whole turns the turning frame coincides with the orbit frame.

    Attributes
    ----------
    start, end : State
        In the orbit frame, before and after the turn.
    matrix : ndarray, shape (6 rows, 6 rows)
        Monodromy matrix, Eq. (26), with saltation at every slack/taut switch; `Integrator.real`
        tells which coordinates are some where rest lengths are states.
    closure : ndarray, shape (6 rows,)
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

    @property
    def det_z_error(self) -> float:
        """|det Z - 1| of the out-of-plane variations, if the motion stays in the orbit plane."""
        ends = [to_scaled(self.integrator, state) for state in (self.start, self.end)]
        if np.max(np.abs(np.stack(ends)[:, 2::3])) > 1e-12:
            return math.nan
        return float(abs(np.linalg.det(self.matrix[2::3, 2::3]) - 1.0))


def to_scaled(integrator: Integrator, state: State) -> np.ndarray:
    """Scaled coordinates (6 rows,) in the turning frame of a `State` at time 0 or a whole turn."""
    v, r = (np.array(x, dtype=float) for x in rows_of(integrator.system, state))
    if integrator.orbit:
        v = integrator.orbit.into_even_frame(v, r)
    n = integrator.system.n
    v[:n] -= rigid_velocity(r[:n], integrator.arrays.spin)
    return integrator.scaled(v, r)


def from_scaled(integrator: Integrator, x: np.ndarray) -> State:
    """Inverse of `to_scaled`."""
    v = x[: x.size // 2].reshape(-1, 3) * integrator.settings.speed
    r = x[x.size // 2 :].reshape(-1, 3) * integrator.settings.length
    n = integrator.system.n
    v[:n] += rigid_velocity(r[:n], integrator.arrays.spin)
    return state_of(
        integrator.system, integrator.orbit.from_even_frame(v, r) if integrator.orbit else v, r
    )


def flow_direction(integrator: Integrator, state: State) -> np.ndarray:
    """Scaled rate of change (6 rows,) of a state in the orbit frame, Eq. (28)."""
    arrays, n = integrator.arrays._replace(spin=0.0), integrator.system.n
    v, r = (np.ascontiguousarray(x) for x in rows_of(integrator.system, state))
    rests = rests_in_rows(integrator.system, v, r) if integrator.rows > n else None
    taut = forces.acting_tethers(integrator.system, r[:n], v[:n], rests)
    a = np.empty_like(r)
    forces.acceleration(arrays, taut, 0.0, v, r, a)
    return to_scaled(integrator, state_of(integrator.system, a, v))


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
    size = 6 * integrator.rows
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
class Shot:
    """How far a start is from closing.

    Attributes
    ----------
    difference : ndarray, shape (6n,)
        x at the end minus x(0), scaled as in `Turn`.
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
    integrator: Integrator, state: State, cancelled: Callable[[], bool] | None = None
) -> Shot:
    """x(T) - x(0) of a start, from the motion alone.

    Parameters
    ----------
    integrator, state, cancelled
        As for `integrate_turn`.

    Returns
    -------
    Shot

    Raises
    ------
    IntegrationError, Cancelled
        As `integrate_turn`.
    """
    motion = carried_motion(integrator, state, integrator.period_s, cancelled)
    x = integrator.scaled(motion.v, motion.r)
    return Shot(x - to_scaled(integrator, state), motion.switches)


def carried_motion(
    integrator: Integrator, state: State, stop: float, cancelled: Callable[[], bool] | None = None
) -> IntegratorState:
    """The motion from a state at a time [s]; errors as `integrate_turn`."""
    motion = integrator.begin(state)
    while not integrator.advance(motion, stop, steps=500):
        check_limits(motion, stop, cancelled)
    return motion
