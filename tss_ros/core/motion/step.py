"""One step of the motion with its variations, up to the first slack/taut switch, of either kind."""

import math
from collections import namedtuple

import numpy as np
from numba import njit

from tss_ros.core.model.forces import acceleration, jacobian, stretch
from tss_ros.core.motion import taylor_motion, taylor_variations
from tss_ros.core.motion.radau_motion import add, error_estimate, newton_matrices, solve_stages
from tss_ros.core.motion.radau_variations import vary
from tss_ros.core.motion.slack import first_switch, first_switch_of_series
from tss_ros.core.numerics.simd import WIDTH, kernel, load, store

#: Where Newton's iteration does not limit the step [s]; finite, so that it can be stored anywhere.
ANY_STEP = 1e300
#: Kinds of steps, and what `Control.kind` may allow: one kind only, or both.
IMPLICIT, EXPLICIT, BOTH = range(3)
#: Places in `Motion.count` beyond the plain counts: kind of the next and of the last step, steps in
#: a row that speak for the other kind, explicit steps still to be made whatever speaks against
#: them, and how many that will be next time.
NEXT, LAST, DOUBT, HOLD, BACKOFF = range(5, 10)

#: What `advance` carries from call to call. time (5,): now, next implicit step size, start and size
#: of the last step, largest step that Newton's iteration bears. count (10,): accepted steps,
#: rejected steps, Newton iterations, switches, sampled times, and as above. taut (m,). v, r (n,3):
#: state now. v0, r0 (n,3), z, rise (s,n,3): start of the last implicit step and the increments of
#: velocity and position at its nodes. series: `Series.r` of the last explicit step.
#: x_v, x_r (n,3,k): variations of velocity and position, k may be 0. dissipation (1,): integral of
#: the trace of the damping matrix over time.
Motion = namedtuple("Motion", "time count taut v r v0 r0 z rise series x_v x_r dissipation")
#: Room that steps work in: Newton matrices and `radau.Room`, Jacobian blocks, stage increments, a
#: trial state, stretch of the tethers and its rate, the Taylor series of motion and variations.
Work = namedtuple(
    "Work", "real cplx room by_r by_v z rise old trial_v trial_r excess growth series variations"
)
#: Step sizes that say why there was no step: try again, switch first, or none possible.
REJECTED, AT_ONCE, TOO_SMALL = -1.0, -2.0, -3.0


@kernel
def to_orbit_frame(spin, time, v, r, out_v, out_r):
    """Turn velocities and positions (n,3) of the turning frame into those of the orbit frame."""
    c, s = math.cos(spin * time), math.sin(spin * time)
    for i in range(r.shape[0]):
        x, y = r[i, 0], r[i, 1]
        vx, vy = v[i, 0] - spin * y, v[i, 1] + spin * x
        out_r[i, 0], out_r[i, 1], out_r[i, 2] = c * x - s * y, s * x + c * y, r[i, 2]
        out_v[i, 0], out_v[i, 1], out_v[i, 2] = c * vx - s * vy, s * vx + c * vy, v[i, 2]


@kernel
def to_turning_frame(spin, time, v, r):
    """The other way round, in place."""
    c, s = math.cos(spin * time), math.sin(spin * time)
    for i in range(r.shape[0]):
        x, y = c * r[i, 0] + s * r[i, 1], c * r[i, 1] - s * r[i, 0]
        vx, vy = c * v[i, 0] + s * v[i, 1], c * v[i, 1] - s * v[i, 0]
        r[i, 0], r[i, 1] = x, y
        v[i, 0], v[i, 1] = vx + spin * y, vy - spin * x


@kernel
def turn_variations(spin, time, x_v, x_r, back):
    """`to_orbit_frame` of variations (n,3,k), or if `back` to the turning frame; in place."""
    c, s, rate = math.cos(spin * time), math.sin(spin * time), 0.0 if back else spin
    if back:
        s = -s
    for i in range(x_r.shape[0]):
        for b in range(x_r.shape[2]):
            x, y = x_r[i, 0, b], x_r[i, 1, b]
            vx, vy = x_v[i, 0, b] - rate * y, x_v[i, 1, b] + rate * x
            x, y, vx, vy = c * x - s * y, s * x + c * y, c * vx - s * vy, s * vx + c * vy
            x_r[i, 0, b], x_r[i, 1, b] = x, y
            x_v[i, 0, b], x_v[i, 1, b] = vx, vy
            if back:
                x_v[i, 0, b] += spin * y
                x_v[i, 1, b] -= spin * x


@kernel
def interpolate(tables, increments, fraction, out):
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
        interpolate(tables, old, base, start)
    for j in range(tables.stages):
        z[j] = 0.0
        add(z[j].reshape(-1), -1.0, start.reshape(-1))
        interpolate(tables, old, offset + scale * tables.c[j], z[j])


@kernel
def explicit_step(plant, control, motion, work, stop):
    """One step by Taylor series, up to the first switch.

    Returns its size, the size it could have had without switch and stop, and the tether that
    switches at its end or -1.
    """
    t, series, columns = motion.time[0], work.series, motion.x_r.shape[2]
    v, r = work.trial_v, work.trial_r
    to_orbit_frame(plant.spin, t, motion.v, motion.r, v, r)
    taylor_motion.expand(plant, motion.taut, v, r, series)
    natural = min(
        control.longest,
        taylor_motion.longest_step(series.r, control.explicit_tolerance, control.speed),
    )
    if columns > 0:
        turn_variations(plant.spin, t, motion.x_v, motion.x_r, False)
        taylor_variations.expand_variations(
            plant, motion.taut, series, natural, motion.x_v, motion.x_r, work.variations
        )
        natural = min(
            natural,
            taylor_variations.longest_step_of_variations(
                work.variations.x, control.explicit_tolerance, control.speed
            ),
        )
    h, which = natural, -1
    if t + 1.01 * h >= stop:
        h = stop - t
    if not plant.bilateral:
        earliest, which = first_switch_of_series(plant, motion.taut, series, h)
    if which >= 0:
        h = AT_ONCE if earliest < 1e-10 * h else min(earliest, h)
    elif h <= 1e-14 * max(t, control.length / control.speed):
        h = TOO_SMALL
    end = h if h > 0.0 else 0.0
    if columns > 0:
        if end > 0.0:
            taylor_variations.evaluate_variations(work.variations.x, end, motion.x_v, motion.x_r)
        turn_variations(plant.spin, t + end, motion.x_v, motion.x_r, True)
    if end > 0.0:
        for i in range(0, series.r.size, WIDTH):
            store(motion.series, i, load(series.r, i))
        taylor_motion.evaluate(series.r, end, motion.v, motion.r)
        to_turning_frame(plant.spin, t + end, motion.v, motion.r)
    return h, natural, which


@njit(cache=True, nogil=True, error_model="numpy")
def implicit_step(plant, symbolic, tables, control, motion, work, stop, follows):
    """One step by Radau collocation, up to the first switch. Returns as `explicit_step`.

    `follows` says that the last attempt was a step, so that its polynomial is a good guess.
    """
    s, n, t = tables.stages, motion.r.shape[0], motion.time[0]
    z, rise, v0, r0 = work.z, work.rise, motion.v, motion.r
    trial_v, trial_r, middle = work.trial_v, work.trial_r, tables.stages // 2
    h = min(motion.time[1], control.longest, motion.time[4])
    last = t + 1.01 * h >= stop
    if last:
        h = stop - t
    if h <= 1e-14 * max(t, control.length / control.speed):
        return TOO_SMALL, 1.01 * min(motion.time[1], control.longest, motion.time[4]), -1
    z[:] = 0.0
    if motion.time[3] > 0.0 and follows and motion.count[LAST] == IMPLICIT:
        _guess(tables, motion.z, 1.0, h / motion.time[3], 1.0, z)
    trial_v[:] = v0
    trial_r[:] = r0
    add(trial_v.reshape(-1), 1.0, z[middle].reshape(-1))
    add(trial_r.reshape(-1), tables.c[middle] * h, trial_v.reshape(-1))
    jacobian(
        plant,
        symbolic.pair,
        motion.taut,
        t + tables.c[middle] * h,
        trial_v,
        trial_r,
        work.by_r,
        work.by_v,
    )
    newton_matrices(symbolic, tables, h, work.by_r, work.by_v, work.real, work.cplx)
    iterations = solve_stages(
        plant, symbolic, tables, control, motion.taut, t, h, v0, r0, z, rise, work.real,
        work.cplx, work.room,
    )
    motion.count[2] += abs(iterations)
    if iterations < 0:
        motion.count[1] += 1
        motion.time[1] = 0.4 * h
        # Newton's iteration, not the error, bounds the steps here: come near that size slowly.
        motion.time[4] = 0.6 * h
        return REJECTED, h, -1
    f0 = trial_v
    acceleration(plant, motion.taut, t, v0, r0, f0)
    error = error_estimate(
        symbolic,
        tables,
        control,
        h,
        work.by_r,
        f0.reshape(n, 3, 1),
        v0.reshape(n, 3, 1),
        z.reshape(s, n, 3, 1),
        rise.reshape(s, n, 3, 1),
        work.real,
    )
    growth = 0.85 * (control.tolerance / max(error, 1e-300)) ** (1.0 / (s + 1))
    if not error <= control.tolerance:
        motion.count[1] += 1
        motion.time[1] = h * max(0.1, growth) if error < np.inf else 0.4 * h
        return REJECTED, h, -1
    fraction, which = 2.0, -1
    if not plant.bilateral:
        fraction, which = first_switch(plant, tables, motion.taut, v0, r0, rise)
    full = h
    if which >= 0:
        converged = False
        for attempt in range(6):
            target = h - work.excess[which] / work.growth[which] if attempt else fraction * full
            if not 0.0 < target <= full * (1.0 + 1e-9):
                break
            if target < 1e-10 * full:
                break
            work.old[:] = z
            _guess(tables, work.old, 0.0, target / h, 0.0, z)
            h = target
            newton_matrices(symbolic, tables, h, work.by_r, work.by_v, work.real, work.cplx)
            iterations = solve_stages(
                plant,
                symbolic,
                tables,
                control,
                motion.taut,
                t,
                h,
                v0,
                r0,
                z,
                rise,
                work.real,
                work.cplx,
                work.room,
            )
            motion.count[2] += abs(iterations)
            if iterations < 0:
                break
            trial_v[:] = v0
            trial_r[:] = r0
            add(trial_v.reshape(-1), 1.0, z[s - 1].reshape(-1))
            add(trial_r.reshape(-1), 1.0, rise[s - 1].reshape(-1))
            stretch(plant, trial_v, trial_r, work.excess, work.growth)
            miss = abs(work.excess[which])
            if miss <= 4e-15 * plant.rest[which] or miss <= 1e-15 * full * abs(work.growth[which]):
                converged = True
                break
        if not converged and target < 1e-10 * full:
            motion.time[1] = full
            return AT_ONCE, full, which
        if not converged and iterations < 0:
            motion.count[1] += 1
            motion.time[1] = 0.5 * h
            return REJECTED, h, -1
    if motion.x_v.shape[2] > 0:
        error_x = vary(
            plant,
            symbolic,
            tables,
            control,
            motion.taut,
            t,
            h,
            v0,
            r0,
            z,
            rise,
            work.by_r,
            work.real,
            motion.x_v,
            motion.x_r,
        )
        scaled = 0.85 * (control.tolerance / max(error_x, 1e-300)) ** (1.0 / (s + 1))
        if not error_x <= control.tolerance:
            motion.count[1] += 1
            motion.time[1] = h * max(0.1, scaled) if error_x < np.inf else 0.4 * h
            return REJECTED, h, -1
        growth = min(growth, scaled * h / full)
    motion.v0[:] = v0
    motion.r0[:] = r0
    motion.z[:] = z
    motion.rise[:] = rise
    add(motion.v.reshape(-1), 1.0, z[s - 1].reshape(-1))
    add(motion.r.reshape(-1), 1.0, rise[s - 1].reshape(-1))
    motion.time[4] = min(1.2 * motion.time[4], ANY_STEP)
    if which >= 0 or not last:
        motion.time[1] = full * min(max(growth, 0.1), 8.0)
    return h, full, which
