"""Adaptive integration of motion and variations; steps end exactly on slack/taut switches.

Two kinds of steps take turns. Explicit ones (`taylor`) are cheap, but no longer than the fastest
motion of the tethers allows, even where it has died away; implicit ones (`radau`) then go on in far
longer steps. So: explicit from every start and switch on, implicit once nothing but the bound on
explicit steps holds them back, and explicit again where implicit steps do not grow.
"""

import math

import numpy as np
from numba import njit

from tss_ros.core.model.forces import stretch
from tss_ros.core.motion import radau_motion, taylor_motion, taylor_variations
from tss_ros.core.motion.slack import toggle
from tss_ros.core.motion.step import (
    ANY_STEP,
    AT_ONCE,
    BACKOFF,
    BOTH,
    DOUBT,
    EXPLICIT,
    HOLD,
    IMPLICIT,
    LAST,
    NEXT,
    REJECTED,
    TOO_SMALL,
    Motion,
    Work,
    explicit_step,
    implicit_step,
    interpolate,
    to_orbit_frame,
)
from tss_ros.core.numerics.simd import WIDTH, kernel

REACHED, PAUSED, STEP_TOO_SMALL, TOO_MANY_SWITCHES = range(4)
#: Explicit steps that one implicit step costs, and each of its Newton iterations, of the motion
#: alone and with variations; those of more beads than this are always carried implicitly.
COST, COST_VARIED, FEW_BEADS = (3.0, 1.7), (3.5, 0.2), 8
#: Share of the longest step an explicit method can bear at the fastest rate, `Control.bound` over
#: it, from which on a step counts as bounded by that rate alone.
BOUNDED = 0.75


def begin(plant, tables, control, v, r, columns, first_step):
    """Start a `Motion` at time 0 from velocities and positions in the turning frame.

    Parameters
    ----------
    plant : forces.Plant
    tables : collocation.Tables
    control : radau_motion.Control
    v, r : ndarray, shape (n, 3)
    columns : int
        Number k of variation columns; the arrays start at zero.
    first_step : float
        [s] first implicit step size to try.

    Returns
    -------
    Motion
    """
    n, m, s = r.shape[0], plant.rest.size, tables.stages
    excess, growth = np.empty(m), np.empty(m)
    stretch(plant, v, r, excess, growth)
    taut = (excess > 0.0) | ((excess == 0.0) & (growth > 0.0)) | plant.bilateral
    count = np.zeros(10, dtype=np.int64)
    count[NEXT] = IMPLICIT if control.kind == IMPLICIT else EXPLICIT
    return Motion(
        np.array([0.0, first_step, 0.0, 0.0, ANY_STEP]),
        count,
        taut,
        np.array(v, dtype=float),
        np.array(r, dtype=float),
        np.array(v, dtype=float),
        np.array(r, dtype=float),
        np.zeros((s, n, 3)),
        np.zeros((s, n, 3)),
        np.zeros((-(-n // WIDTH), control.order + 1, 3, WIDTH)),
        np.zeros((n, 3, columns)),
        np.zeros((n, 3, columns)),
        np.zeros(1),
    )


@njit(cache=True, nogil=True, error_model="numpy")
def _sample(plant, tables, motion, times, out_v, out_r):
    """Write the states at all requested times up to now, in the orbit frame."""
    while motion.count[4] < times.size and times[motion.count[4]] <= motion.time[0]:
        index = motion.count[4]
        now = times[index]
        v, r = out_v[index], out_r[index]
        if motion.count[LAST] == EXPLICIT:
            taylor_motion.evaluate(motion.series, now - motion.time[2], v, r)
        else:
            v[:] = motion.v0
            r[:] = motion.r0
            if motion.time[3] > 0.0:
                fraction = (now - motion.time[2]) / motion.time[3]
                interpolate(tables, motion.z, fraction, v)
                interpolate(tables, motion.rise, fraction, r)
            to_orbit_frame(plant.spin, now, v, r, v, r)
        motion.count[4] += 1


@njit(cache=True, nogil=True, error_model="numpy")
def advance(
    plant, symbolic, tables, control, motion, stop, steps, switches, times, out_v, out_r
):
    """Integrate until `stop`, or until so many steps or switches were made.

    Parameters
    ----------
    plant : forces.Plant
    symbolic : blocklu.Symbolic
    tables : collocation.Tables
    control : radau_motion.Control
    motion : Motion
        Advanced in place.
    stop : float
        [s]. The last step ends there exactly; infinity to end with the step that covers `times`.
    steps, switches : int
        Largest number of accepted steps and of slack/taut switches in this call.
    times : ndarray, shape (k,)
        [s], increasing: where states are wanted. `motion.count[4]` counts those already written.
    out_v, out_r : ndarray, shape (k, n, 3)
        States at `times` in the orbit frame, written as the motion passes them.

    Returns
    -------
    int
        REACHED, PAUSED (out of steps), STEP_TOO_SMALL or TOO_MANY_SWITCHES.
    """
    s, n, order = tables.stages, motion.r.shape[0], control.order
    work = Work(
        np.empty((symbolic.blocks, 3, 3)),
        np.empty((tables.value.size, symbolic.blocks, 3, 3), dtype=np.complex128),
        radau_motion.blank(s, n, tables.value.size),
        np.empty((symbolic.row.size, 3, 3)),
        np.empty((symbolic.row.size, 3, 3)),
        np.zeros((s, n, 3)),
        np.zeros((s, n, 3)),
        np.zeros((s, n, 3)),
        np.empty((n, 3)),
        np.empty((n, 3)),
        np.empty(plant.rest.size),
        np.empty(plant.rest.size),
        taylor_motion.blank(plant, order),
        taylor_variations.blank(n, plant.rest.size, order, motion.x_r.shape[2]),
    )
    made, most_switches, iterations = 0, motion.count[3] + switches, motion.count[2]
    # Not plain True, a type of its own that everything would be compiled for once more.
    follows, both = motion.count[0] >= 0, control.kind == BOTH
    cost = COST_VARIED if motion.x_r.shape[2] > 0 else COST
    if both and n > FEW_BEADS and motion.x_r.shape[2] > 0:
        both, motion.count[NEXT] = False, IMPLICIT
    _sample(plant, tables, motion, times, out_v, out_r)
    while True:
        t = motion.time[0]
        if t >= stop or (stop == np.inf and motion.count[4] >= times.size):
            return REACHED
        if made >= steps:
            return PAUSED
        if motion.count[3] > most_switches:
            return TOO_MANY_SWITCHES
        kind = motion.count[NEXT]
        if kind == EXPLICIT:
            h, natural, which = explicit_step(plant, control, motion, work, stop)
        else:
            h, natural, which = implicit_step(
                plant, symbolic, tables, control, motion, work, stop, follows
            )
        follows = h > 0.0
        if h == REJECTED:
            continue
        if h == AT_ONCE:
            before = motion.count[3]
            toggle(plant, motion, which, 1e-12 * plant.rest[which], work.excess, work.growth)
            if motion.count[3] == before:
                return STEP_TOO_SMALL
            if both:
                _start_anew(motion)
            continue
        if h == TOO_SMALL:
            if t + natural >= stop:
                motion.time[0] = stop
                return REACHED
            return STEP_TOO_SMALL
        made += 1
        motion.count[0] += 1
        for k in range(plant.rest.size):
            if motion.taut[k]:
                weight = plant.inv_mass[plant.ends[k, 0]] + plant.inv_mass[plant.ends[k, 1]]
                motion.dissipation[0] += plant.damping[k] * weight * h
        motion.time[2], motion.time[3] = t, h
        motion.time[0] = stop if t + h >= stop or which < 0 and t + 1.01 * h >= stop else t + h
        motion.count[LAST] = kind
        if both:
            price = cost[0] + cost[1] * (motion.count[2] - iterations)
            _choose(plant, control, motion, work, natural, price)
            iterations = motion.count[2]
        if which >= 0:
            toggle(plant, motion, which, 1e-12 * plant.rest[which], work.excess, work.growth)
            motion.time[4] = ANY_STEP
            motion.time[1] = min(motion.time[1], 0.2 * natural)
            if motion.taut[which]:
                i, j = plant.ends[which]
                weight = plant.inv_mass[i] + plant.inv_mass[j]
                rate = plant.damping[which] * weight + math.sqrt(plant.stiffness[which] * weight)
                motion.time[1] = min(motion.time[1], 2.0 / rate)
            if both:
                _start_anew(motion)
        if motion.count[4] < times.size:
            _sample(plant, tables, motion, times, out_v, out_r)


@kernel
def _start_anew(motion):
    """Forget, after a switch, what spoke for one kind of step or the other."""
    motion.count[NEXT] = EXPLICIT
    motion.count[DOUBT] = motion.count[HOLD] = motion.count[BACKOFF] = 0


@kernel
def _choose(plant, control, motion, work, natural, price):
    """Choose the kind of the next step.

    `natural` is the size that the last one could have had, `price` what it cost if implicit.
    """
    count = motion.count
    rate, bound = _fastest_rate(plant, motion.taut, work.trial_v), control.bound
    if count[NEXT] == EXPLICIT:
        count[HOLD] = max(0, count[HOLD] - 1)
        count[DOUBT] = count[DOUBT] + 1 if natural * rate > BOUNDED * bound else 0
        if count[DOUBT] >= 2 and count[HOLD] == 0:
            count[NEXT], count[DOUBT] = IMPLICIT, 0
            motion.time[1], motion.time[4] = 6.0 * natural, ANY_STEP
    else:
        count[DOUBT] = count[DOUBT] + 1 if motion.time[3] * rate < price * bound else 0
        if count[DOUBT] >= 3:
            count[NEXT], count[DOUBT] = EXPLICIT, 0
            count[BACKOFF] = min(1024, max(64, 2 * count[BACKOFF]))
            count[HOLD] = count[BACKOFF]


@kernel
def _fastest_rate(plant, taut, sums):
    """Bound [1/s] of the rates at which taut tethers swing or decay. `sums` is overwritten."""
    for i in range(sums.shape[0]):
        sums[i, 0] = sums[i, 1] = 0.0
    for k in range(plant.rest.size):
        if taut[k]:
            for side in range(2):
                end = plant.ends[k, side]
                sums[end, 0] += plant.inv_mass[end] * plant.stiffness[k]
                sums[end, 1] += plant.inv_mass[end] * plant.damping[k]
    swing = decay = 0.0
    for k in range(plant.rest.size):
        if taut[k]:
            i, j = plant.ends[k, 0], plant.ends[k, 1]
            swing = max(swing, sums[i, 0] + sums[j, 0])
            decay = max(decay, sums[i, 1] + sums[j, 1])
    return max(decay, math.sqrt(swing))


