"""A motion under way: what the integrator remembers of it from one call to the next."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tss_ros.core.errors import TssError
from tss_ros.core.model.reel_law import rows_of
from tss_ros.core.model.system import State, System

#: Numbers of a motion under way, by name, inside compiled kernels as well as outside:
#:
#: * time: now [s]; implicit_size: next implicit step to try [s];
#: * step_start, step_size: the last step [s]; newton_limit: longest step that Newton's iteration
#:   bears [s];
#: * steps, rejected: steps made and tried in vain; newton_iterations; switches: of tethers between
#:   pulling and not, Eq. (5); sampled: requested states already written;
#: * next_kind, last_kind: IMPLICIT or EXPLICIT; doubts: steps in a row that speak for the other
#:   kind; hold: explicit steps still to be made whatever speaks against them; backoff: how many
#:   that will be next time;
#: * dissipation: integral of the trace of the damping matrix over time, for Liouville's formula.
PROGRESS = np.dtype(
    [
        ("time", "f8"),
        ("implicit_size", "f8"),
        ("step_start", "f8"),
        ("step_size", "f8"),
        ("newton_limit", "f8"),
        ("steps", "i8"),
        ("rejected", "i8"),
        ("newton_iterations", "i8"),
        ("switches", "i8"),
        ("sampled", "i8"),
        ("next_kind", "i8"),
        ("last_kind", "i8"),
        ("doubts", "i8"),
        ("hold", "i8"),
        ("backoff", "i8"),
        ("dissipation", "f8"),
    ],
    align=True,
)


class IntegratorState(NamedTuple):
    """A motion under way in the turning frame, with k variations of it (k may be 0).

    Attributes
    ----------
    progress : ndarray, shape (1,), `PROGRESS`
    taut : ndarray, shape (m,), bool
        Which tethers pull or push, the switch s of Eq. (5).
    idle : ndarray, shape (m,), bool
        Which do nothing although they are longer than at rest: their law never pushes.
    v, r : ndarray, shape (rows, 3)
        Velocities [m/s] and positions [m] now; as `KernelArrays` has rows, here and below.
    start_v, start_r : ndarray, shape (n, 3)
        Where the last implicit step began.
    dv, dr : ndarray, shape (stages, n, 3)
        Increments of velocity and position at its nodes.
    series : ndarray
        `taylor_motion.Series.r` of the last explicit step.
    x_v, x_r : ndarray, shape (n, 3, k)
        Variations of velocity [m/s] and position [m], Eq. (12).
    """

    progress: np.ndarray
    taut: np.ndarray
    idle: np.ndarray
    v: np.ndarray
    r: np.ndarray
    start_v: np.ndarray
    start_r: np.ndarray
    dv: np.ndarray
    dr: np.ndarray
    series: np.ndarray
    x_v: np.ndarray
    x_r: np.ndarray

    @property
    def time(self) -> float:
        """[s] now."""
        return float(self.progress["time"][0])

    @property
    def steps(self) -> int:
        """Steps made so far."""
        return int(self.progress["steps"][0])

    @property
    def switches(self) -> int:
        """Slack/taut switches so far."""
        return int(self.progress["switches"][0])

    @property
    def dissipation(self) -> float:
        """Integral so far of sum C (1/m_i + 1/m_j) over the taut tethers."""
        return float(self.progress["dissipation"][0])

    def with_variations(self, x_v: np.ndarray, x_r: np.ndarray) -> IntegratorState:
        """A copy that carries other variations."""
        return IntegratorState(*map(np.array, self))._replace(x_v=x_v, x_r=x_r)


def velocities_and_positions(system: System, state: State) -> tuple[np.ndarray, np.ndarray]:
    """Velocities [m/s] and positions [m] of a state in the orbit frame, as kernels have them.

    Of shape (rows, 3), with rest lengths that are states after the beads.

    Raises
    ------
    TssError
        If they are not finite or not ones of this system.
    """
    shapes = state.position_m.shape, state.velocity_m_s.shape
    if set(shapes) != {(system.n, 3)}:
        raise TssError(
            f"a state of {system.n} beads needs positions and velocities of shape"
            f" ({system.n}, 3), got {shapes[0]} and {shapes[1]}"
        )
    v, r = (np.ascontiguousarray(x, dtype=float) for x in rows_of(system, state))
    if not (np.isfinite(r).all() and np.isfinite(v).all()):
        raise TssError("positions and velocities must be finite, got NaN or infinity")
    return v, r


class Samples(NamedTuple):
    """States wanted of a motion.

    Attributes
    ----------
    times : ndarray, shape (k,)
        [s], increasing. `PROGRESS` counts those already written.
    v, r : ndarray, shape (k, n, 3)
        [m/s] and [m] in the orbit frame, written as the motion passes them.
    """

    times: np.ndarray
    v: np.ndarray
    r: np.ndarray
