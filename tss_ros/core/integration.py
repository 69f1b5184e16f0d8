"""Adaptive integration of motion and variations; steps end exactly on slack/taut switches."""

import math
from collections import namedtuple

import numpy as np
from numba import njit

from tss_ros.core.forces import acceleration, jacobian, stretch
from tss_ros.core.radau import add, error_estimate, newton_matrices, solve_stages
from tss_ros.core.switching import first_switch, toggle
from tss_ros.core.variations import vary

#: Where Newton's iteration does not limit the step [s]; finite, so that it can be stored anywhere.
ANY_STEP = 1e300
REACHED, PAUSED, STEP_TOO_SMALL, TOO_MANY_SWITCHES = range(4)

#: What `advance` carries from call to call. time (5,): now, next step size, start and size of the
#: step `z` and `rise` describe, largest step that Newton's iteration bears. count (5,): accepted
#: steps, rejected steps, Newton iterations, switches, sampled times. taut (m,). v, r (n,3): state
#: now. v0, r0 (n,3), z, rise (s,n,3): start of the last step and the increments of velocity and
#: position at its nodes. x_v, x_r (n,3,k): variations of velocity and position, k may be 0.
#: dissipation (1,): integral of the trace of the damping matrix over time.
Motion = namedtuple("Motion", "time count taut v r v0 r0 z rise x_v x_r dissipation")


def begin(plant, tables, v, r, columns, first_step):
    """Start a `Motion` at time 0 from velocities and positions in the turning frame.

    Parameters
    ----------
    plant : forces.Plant
    tables : collocation.Tables
    v, r : ndarray, shape (n, 3)
    columns : int
        Number k of variation columns; the arrays start at zero.
    first_step : float
        [s] first step size to try.

    Returns
    -------
    Motion
    """
    n, m, s = r.shape[0], plant.rest.size, tables.stages
    excess, growth = np.empty(m), np.empty(m)
    stretch(plant, v, r, excess, growth)
    taut = (excess > 0.0) | ((excess == 0.0) & (growth > 0.0)) | plant.bilateral
    return Motion(
        np.array([0.0, first_step, 0.0, 0.0, ANY_STEP]),
        np.zeros(5, dtype=np.int64),
        taut,
        np.array(v, dtype=float),
        np.array(r, dtype=float),
        np.array(v, dtype=float),
        np.array(r, dtype=float),
        np.zeros((s, n, 3)),
        np.zeros((s, n, 3)),
        np.zeros((n, 3, columns)),
        np.zeros((n, 3, columns)),
        np.zeros(1),
    )


@njit(cache=True, nogil=True, error_model="numpy")
def _interpolate(tables, increments, fraction, out):
    """Add the collocation polynomial of `increments` (s,n,3), at a fraction of the step, to out."""
    s = tables.stages
    for j in range(s):
        weight = 0.0
        for i in range(s, -1, -1):
            weight = weight * fraction + tables.power[i, j + 1]
        add(out.reshape(-1), weight, increments[j].reshape(-1))


@njit(cache=True, nogil=True, error_model="numpy")
def _guess(tables, old, offset, scale, base, z):
    """Fill `z` with the polynomial of `old` at offset + scale c_j, less its value at `base`."""
    start = np.zeros(z.shape[1:])
    if base != 0.0:
        _interpolate(tables, old, base, start)
    for j in range(tables.stages):
        z[j] = 0.0
        add(z[j].reshape(-1), -1.0, start.reshape(-1))
        _interpolate(tables, old, offset + scale * tables.c[j], z[j])


@njit(cache=True, nogil=True, error_model="numpy")
def _sample(plant, tables, motion, times, out_v, out_r):
    """Write the states at all requested times up to now, in the orbit frame."""
    while motion.count[4] < times.size and times[motion.count[4]] <= motion.time[0]:
        index = motion.count[4]
        now = times[index]
        v, r = out_v[index], out_r[index]
        v[:] = motion.v0
        r[:] = motion.r0
        if motion.time[3] > 0.0:
            fraction = (now - motion.time[2]) / motion.time[3]
            _interpolate(tables, motion.z, fraction, v)
            _interpolate(tables, motion.rise, fraction, r)
        c, s = math.cos(plant.spin * now), math.sin(plant.spin * now)
        for i in range(r.shape[0]):
            x, y = r[i, 0], r[i, 1]
            vx, vy = v[i, 0] - plant.spin * y, v[i, 1] + plant.spin * x
            r[i, 0], r[i, 1] = c * x - s * y, s * x + c * y
            v[i, 0], v[i, 1] = c * vx - s * vy, s * vx + c * vy
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
    control : Control
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
    s, n = tables.stages, motion.r.shape[0]
    real = np.empty((symbolic.blocks, 3, 3))
    cplx = np.empty((tables.value.size, symbolic.blocks, 3, 3), dtype=np.complex128)
    by_r = np.empty((symbolic.row.size, 3, 3))
    by_v = np.empty((symbolic.row.size, 3, 3))
    z = np.zeros((s, n, 3))
    rise = np.zeros((s, n, 3))
    old = np.zeros((s, n, 3))
    f0 = np.zeros((n, 3))
    excess, growth = np.empty(plant.rest.size), np.empty(plant.rest.size)
    middle = s // 2
    trial_v, trial_r = np.empty((n, 3)), np.empty((n, 3))
    made, most_switches = 0, motion.count[3] + switches
    grown = True
    _sample(plant, tables, motion, times, out_v, out_r)
    while True:
        t = motion.time[0]
        if t >= stop or (stop == np.inf and motion.count[4] >= times.size):
            return REACHED
        if made >= steps:
            return PAUSED
        if motion.count[3] > most_switches:
            return TOO_MANY_SWITCHES
        h = min(motion.time[1], control.longest, motion.time[4])
        last = t + 1.01 * h >= stop
        if last:
            h = stop - t
        if h <= 1e-14 * max(t, control.length / control.speed):
            if last:
                motion.time[0] = stop
                return REACHED
            return STEP_TOO_SMALL
        v0, r0 = motion.v, motion.r
        z[:] = 0.0
        if motion.time[3] > 0.0 and grown:
            _guess(tables, motion.z, 1.0, h / motion.time[3], 1.0, z)
        trial_v[:] = v0
        trial_r[:] = r0
        add(trial_v.reshape(-1), 1.0, z[middle].reshape(-1))
        add(trial_r.reshape(-1), tables.c[middle] * h, trial_v.reshape(-1))
        jacobian(
            plant, symbolic.pair, motion.taut, t + tables.c[middle] * h, trial_v, trial_r,
            by_r, by_v,
        )
        newton_matrices(symbolic, tables, h, by_r, by_v, real, cplx)
        iterations = solve_stages(
            plant, symbolic, tables, control, motion.taut, t, h, v0, r0, z, rise, real, cplx
        )
        motion.count[2] += abs(iterations)
        if iterations < 0:
            motion.count[1] += 1
            motion.time[1] = 0.4 * h
            # Newton's iteration, not the error, bounds the steps here: come near that size slowly.
            grown, motion.time[4] = False, 0.6 * h
            continue
        acceleration(plant, motion.taut, t, v0, r0, f0)
        error = error_estimate(
            symbolic, tables, control, h, by_r, f0.reshape(n, 3, 1),
            v0.reshape(n, 3, 1), z.reshape(s, n, 3, 1), rise.reshape(s, n, 3, 1), real,
        )
        factor_of = 0.85 * (control.tolerance / max(error, 1e-300)) ** (1.0 / (s + 1))
        if not error <= control.tolerance:
            motion.count[1] += 1
            motion.time[1] = h * max(0.1, factor_of) if error < np.inf else 0.4 * h
            grown = False
            continue
        fraction, which = 2.0, -1
        if not plant.bilateral:
            fraction, which = first_switch(plant, tables, motion.taut, v0, r0, rise)
        full = h
        if which >= 0:
            converged = False
            for attempt in range(6):
                target = fraction * full if attempt == 0 else h - excess[which] / growth[which]
                if not 0.0 < target <= full * (1.0 + 1e-9):
                    break
                if target < 1e-10 * full:
                    break
                old[:] = z
                _guess(tables, old, 0.0, target / h, 0.0, z)
                h = target
                newton_matrices(symbolic, tables, h, by_r, by_v, real, cplx)
                iterations = solve_stages(
                    plant, symbolic, tables, control, motion.taut, t, h, v0, r0, z, rise,
                    real, cplx,
                )
                motion.count[2] += abs(iterations)
                if iterations < 0:
                    break
                trial_v[:] = v0
                trial_r[:] = r0
                add(trial_v.reshape(-1), 1.0, z[s - 1].reshape(-1))
                add(trial_r.reshape(-1), 1.0, rise[s - 1].reshape(-1))
                stretch(plant, trial_v, trial_r, excess, growth)
                miss = abs(excess[which])
                if miss <= 1e-13 * plant.rest[which] or miss <= 1e-15 * full * abs(growth[which]):
                    converged = True
                    break
            if not converged and target < 1e-10 * full:
                before = motion.count[3]
                toggle(plant, motion, which, 1e-12 * plant.rest[which])
                if motion.count[3] == before:
                    return STEP_TOO_SMALL
                motion.time[1] = full
                continue
            if not converged and iterations < 0:
                motion.count[1] += 1
                motion.time[1] = 0.5 * h
                grown = False
                continue
            last = last and h >= full
        if motion.x_v.shape[2] > 0:
            error_x = vary(
                plant, symbolic, tables, control, motion.taut, t, h, v0, r0, z, rise, by_r, real,
                motion.x_v, motion.x_r,
            )
            scaled = 0.85 * (control.tolerance / max(error_x, 1e-300)) ** (1.0 / (s + 1))
            if not error_x <= control.tolerance:
                motion.count[1] += 1
                motion.time[1] = h * max(0.1, scaled) if error_x < np.inf else 0.4 * h
                grown = False
                continue
            factor_of = min(factor_of, scaled * h / full)
        grown = True
        made += 1
        motion.count[0] += 1
        for k in range(plant.rest.size):
            if motion.taut[k]:
                weight = plant.inv_mass[plant.ends[k, 0]] + plant.inv_mass[plant.ends[k, 1]]
                motion.dissipation[0] += plant.damping[k] * weight * h
        motion.time[2], motion.time[3] = t, h
        motion.v0[:] = v0
        motion.r0[:] = r0
        motion.z[:] = z
        motion.rise[:] = rise
        add(motion.v.reshape(-1), 1.0, z[s - 1].reshape(-1))
        add(motion.r.reshape(-1), 1.0, rise[s - 1].reshape(-1))
        motion.time[0] = stop if last else t + h
        motion.time[4] = min(1.2 * motion.time[4], ANY_STEP)
        if which >= 0 or not last:
            motion.time[1] = full * min(max(factor_of, 0.1), 8.0)
        if which >= 0:
            toggle(plant, motion, which, 1e-12 * plant.rest[which])
            motion.time[4] = ANY_STEP
            motion.time[1] = min(motion.time[1], 0.2 * full)
            if motion.taut[which]:
                i, j = plant.ends[which]
                weight = plant.inv_mass[i] + plant.inv_mass[j]
                rate = plant.damping[which] * weight + math.sqrt(plant.stiffness[which] * weight)
                motion.time[1] = min(motion.time[1], 2.0 / rate)
        _sample(plant, tables, motion, times, out_v, out_r)
