"""Proofs that a monodromy matrix carries: what it must agree with, measured beside it."""

import math

import numpy as np
from scipy.optimize import linear_sum_assignment

from tss_ros.core.errors import Cancelled, IntegrationError
from tss_ros.core.motion.displacements import carry
from tss_ros.core.motion.propagator import Flow
from tss_ros.core.stability.shooting import turn

#: Parts the turn is cut into beside the whole.
SEGMENTS = (3, 7)
#: Volumes may shrink by exp(-this) in a stretch of a turn whose determinant is taken.
DECAY = 4.0
#: Stretches spread evenly over the turn, beside those around switches, and most of the latter.
SPREAD, MOST_AROUND_SWITCHES = 8, 40


def segment_error(latest, settled, cancelled=None):
    """Disagreement of the multipliers of the same turn cut into 3 and 7 parts with the whole's.

    Parameters
    ----------
    latest : Turn
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
    return max(_distance(latest, latest.flow, settled, cancelled, parts) for parts in SEGMENTS)


def convergence_error(latest, settled, cancelled=None):
    """Change of the multipliers when the turn is integrated a hundred times more accurately.

    Parameters and value as `segment_error`.
    """
    flow = latest.flow
    finer = Flow(flow.system, flow.plant.spin, max(0.01 * flow.rtol, 1e-12), flow.control.length)
    return _distance(latest, finer, settled, cancelled)


def _distance(latest, flow, settled, cancelled, parts=1):
    """Largest distance of multipliers; infinite where the other turn proves to be chaotic."""
    try:
        again = turn(flow, latest.start, cancelled, parts)
    except IntegrationError:
        return math.inf
    one, other = np.linalg.eigvals(latest.matrix), np.linalg.eigvals(again.matrix)
    apart = np.abs(one[:, None] - other[None, :])
    rows, columns = linear_sum_assignment(apart)
    return float(np.max(apart[rows, columns][settled(one[rows])], initial=0.0))


def liouville_error(latest, cancelled=None):
    """Error of log|det| = -sum C (1/m_i + 1/m_j) (time taut), Liouville's formula.

    Taken over stretches so short that the determinant does not vanish in rounding: around
    slack/taut switches and spread over the turn; all of the turn where damping is weak enough.

    Parameters
    ----------
    latest : Turn
    cancelled : callable, optional

    Returns
    -------
    float
        Largest error of a stretch.
    """
    flow = latest.flow
    period = 2.0 * math.pi / abs(flow.plant.spin)
    ends = flow.system.tether_ends
    inverse = 1.0 / flow.system.mass_kg
    rates = flow.system.damping_n_s_per_m * (inverse[ends[:, 0]] + inverse[ends[:, 1]])
    # The fastest mode may decay a little more than once in a step; that is what limits the length.
    width = min(period / SPREAD, DECAY / max(np.sum(rates), 1e-300))
    half = 3 * flow.system.n
    motion = flow.begin(latest.start)
    worst = 0.0
    for begin in _stretches(latest, period, width):
        if cancelled is not None and cancelled():
            raise Cancelled(f"stopped at {motion.time[0]:g} s of a turn of {period:g} s")
        if begin > motion.time[0]:
            flow.advance(motion, begin)
        before = float(motion.dissipation[0])
        part, matrix = carry(flow, motion, np.eye(2 * half), min(begin + width, period))
        logarithm = np.linalg.slogdet(matrix)[1]
        worst = max(worst, abs(logarithm + float(part.dissipation[0]) - before))
    return worst


def _stretches(latest, period, width):
    """Increasing start times of the stretches."""
    if period / width <= SPREAD + MOST_AROUND_SWITCHES:
        return np.arange(math.ceil(period / width)) * width
    times = [np.arange(SPREAD) * period / SPREAD]
    if latest.switches:
        motion = latest.flow.begin(latest.start)
        found = []
        while not latest.flow.advance(motion, period, steps=1):
            if motion.count[3] > len(found):
                found.extend([float(motion.time[0])] * int(motion.count[3] - len(found)))
        found = np.unique(found)
        chosen = np.linspace(0, found.size - 1, min(found.size, MOST_AROUND_SWITCHES)).astype(int)
        times.append(np.maximum(found[chosen] - 0.5 * width, 0.0))
    return np.unique(np.concatenate(times))
