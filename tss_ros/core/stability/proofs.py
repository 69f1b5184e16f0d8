"""Proofs that a monodromy matrix carries: what it must agree with, measured beside it."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from scipy.optimize import linear_sum_assignment

from tss_ros.core.errors import Cancelled, IntegrationError
from tss_ros.core.model.feedback import follows_laws
from tss_ros.core.model.forces import jacobian
from tss_ros.core.model.kernel_arrays import ROW
from tss_ros.core.motion.displacements import carry_displacements
from tss_ros.core.motion.integrator import Integrator
from tss_ros.core.motion.state import IntegratorState
from tss_ros.core.stability.shooting import Turn, integrate_turn

#: Parts the turn is cut into beside the whole.
SEGMENTS = (3, 7)
#: Volumes may shrink by exp(-this) in a stretch of a turn whose determinant is taken.
DECAY = 4.0
#: Stretches spread evenly over the turn, beside those around switches, and most of the latter.
SPREAD, MOST_AROUND_SWITCHES = 8, 40
#: Gauss's nodes and weights in a stretch, from -1 to 1.
NODES, WEIGHTS = np.polynomial.legendre.leggauss(6)


def segment_error(
    turn: Turn,
    settled: Callable[[np.ndarray], np.ndarray],
    cancelled: Callable[[], bool] | None = None,
) -> float:
    """Disagreement of the multipliers of the same turn cut into 3 and 7 parts with the whole's.

    Parameters
    ----------
    turn : Turn
    settled : callable
        Which multipliers (k,) to compare, as a mask: those in Jordan blocks split like the root of
        the error and are left out.
    cancelled : callable, optional

    Returns
    -------
    float
        Largest distance between two multipliers that belong together; infinite where the other
        turn proves to be chaotic.
    """
    integrator = turn.integrator
    return max(_distance(turn, integrator, settled, cancelled, parts) for parts in SEGMENTS)


def convergence_error(
    turn: Turn,
    settled: Callable[[np.ndarray], np.ndarray],
    cancelled: Callable[[], bool] | None = None,
) -> float:
    """Change of the multipliers when the turn is integrated a hundred times more accurately.

    Parameters and value as `segment_error`.
    """
    integrator = turn.integrator
    finer = Integrator(
        integrator.system,
        integrator.spin,
        max(0.01 * integrator.rtol, 1e-12),
        integrator.settings.length,
    )
    finer.period_s = integrator.period_s
    return _distance(turn, finer.with_drive(integrator.drive), settled, cancelled)


def _distance(turn, integrator, settled, cancelled, parts=1):
    """Largest distance of multipliers; infinite where the other turn proves to be chaotic."""
    try:
        again = integrate_turn(integrator, turn.start, cancelled, parts)
    except IntegrationError:
        return math.inf
    one, other = np.linalg.eigvals(turn.matrix), np.linalg.eigvals(again.matrix)
    apart = np.abs(one[:, None] - other[None, :])
    rows, columns = linear_sum_assignment(apart)
    return float(np.max(apart[rows, columns][settled(one[rows])], initial=0.0))


def liouville_error(turn: Turn, cancelled: Callable[[], bool] | None = None) -> float:
    """Error of log|det| = -sum C (1/m_i + 1/m_j) (time taut), Liouville's formula.

    Laws of beads that depend on the velocity, thrusters and reels add what they take.

    Taken over stretches so short that the determinant does not vanish in rounding: around
    slack/taut switches and spread over the turn; all of the turn where damping is weak enough.

    Parameters
    ----------
    turn : Turn
    cancelled : callable, optional

    Returns
    -------
    float
        Largest error of a stretch.
    """
    integrator = turn.integrator
    period = integrator.period_s
    reels = bead_trace(integrator, integrator.begin(turn.start))
    rates = np.append(tether_rates(integrator), abs(reels))
    # The fastest mode may decay a little more than once in a step; that is what limits the length.
    width = min(period / SPREAD, DECAY / max(np.sum(rates), 1e-300))
    half = 3 * integrator.rows
    motion = integrator.begin(turn.start)
    worst = 0.0
    for begin in _stretches(turn, period, width):
        if cancelled is not None and cancelled():
            raise Cancelled(f"stopped at {motion.time:g} s of a turn of {period:g} s")
        if begin > motion.time:
            integrator.advance(motion, begin)
        before, end = motion.dissipation, min(begin + width, period)
        part, matrix = carry_displacements(integrator, motion, np.eye(2 * half), end)
        logarithm = np.linalg.slogdet(matrix)[1]
        beads = _bead_dissipation(integrator, motion, end)
        worst = max(worst, abs(logarithm + part.dissipation - before + beads))
    return worst


def _feel_velocity(system):
    return follows_laws(system) or any(law.by_velocity for law in system.acting_laws)


def tether_rates(integrator: Integrator) -> np.ndarray:
    """C (1/m_i + 1/m_j) of every tether [1/s], with 1/m of the reel it has, shape (m,)."""
    arrays = integrator.arrays
    weight = arrays.inv_mass[arrays.ends].sum(axis=1)
    if arrays.reel.size:
        row = arrays.reel[:, ROW].astype(int)
        weight += np.where(row >= 0, arrays.inv_mass[row], 0.0)
    return arrays.damping * weight


def bead_trace(integrator: Integrator, motion: IntegratorState) -> float:
    """Trace of the accelerations by velocity [1/s] where a motion is, less that of its tethers.

    Those count with the rest lengths as built, as `IntegratorState.dissipation` has them.
    """
    system, symbolic = integrator.system, integrator.symbolic
    if not _feel_velocity(system):
        return 0.0
    by_r, by_v = np.empty((2, symbolic.row.size, 3, 3))
    taut, state = np.zeros(system.m, dtype=bool), (motion.time, motion.v, motion.r)
    counted = 0.0
    if integrator.rows > system.n:
        # What is out of a tether tells its damping.
        taut = motion.taut
        counted = float(np.sum(tether_rates(integrator)[taut]))
    jacobian(integrator.arrays, symbolic.pair, taut, *state, by_r, by_v)
    return float(np.trace(by_v[: integrator.rows].sum(axis=0))) + counted


def _bead_dissipation(integrator, motion, end):
    """Minus the trace of the beads' accelerations by velocity, integrated until a time."""
    if not _feel_velocity(integrator.system):
        return 0.0
    none = np.empty((integrator.rows, 3, 0))
    motion = motion.with_variations(none, none)
    half, total = 0.5 * (end - motion.time), 0.0
    for time, weight in zip(motion.time + half * (NODES + 1.0), WEIGHTS):
        integrator.advance(motion, time)
        total -= half * weight * bead_trace(integrator, motion)
    return total


def _stretches(turn, period, width):
    """Increasing start times of the stretches."""
    if period / width <= SPREAD + MOST_AROUND_SWITCHES:
        return np.arange(math.ceil(period / width)) * width
    times = [np.arange(SPREAD) * period / SPREAD]
    if turn.switches:
        motion = turn.integrator.begin(turn.start)
        found = []
        while not turn.integrator.advance(motion, period, steps=1):
            if motion.switches > len(found):
                found.extend([motion.time] * (motion.switches - len(found)))
        found = np.unique(found)
        chosen = np.linspace(0, found.size - 1, min(found.size, MOST_AROUND_SWITCHES)).astype(int)
        times.append(np.maximum(found[chosen] - 0.5 * width, 0.0))
    return np.unique(np.concatenate(times))
