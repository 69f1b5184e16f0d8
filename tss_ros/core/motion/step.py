"""One step of the motion with its variations, up to the first slack/taut switch, of either kind."""

from typing import NamedTuple

import numpy as np

from tss_ros.core.model.forces import acceleration, jacobian, stretch
from tss_ros.core.model.frames import (
    to_orbit_frame,
    to_turning_frame,
    variations_to_orbit_frame,
    variations_to_turning_frame,
)
from tss_ros.core.motion import radau_motion, step_control, taylor_motion, taylor_variations
from tss_ros.core.motion.radau_motion import ImplicitStep, newton_matrices, solve_stages
from tss_ros.core.motion.radau_variations import vary
from tss_ros.core.motion.slack import first_switch, first_switch_of_series
from tss_ros.core.motion.step_control import (
    AT_ONCE,
    ENDS_THERE,
    IMPLICIT,
    REJECTED,
    SMALLEST_BEFORE_SWITCH,
    TOO_SMALL,
)
from tss_ros.core.numerics.bernstein import DEEPEST
from tss_ros.core.numerics.lane_arrays import in_lanes
from tss_ros.core.numerics.loops import add, sum_of
from tss_ros.core.numerics.simd import (
    WIDTH,
    allocating,
    inlined,
    inlined_by_llvm,
    kernel,
    load,
    rounded_kernel,
    splat,
    store,
)

#: Most attempts to end a step on a switch.
MOST_ATTEMPTS = 6


class ExplicitRoom(NamedTuple):
    """Room that explicit steps work in.

    Attributes
    ----------
    v, r : ndarray, shape (n, 3)
        A state in the orbit frame.
    series : taylor_motion.Series
    variations : taylor_variations.Varied
    """

    v: np.ndarray
    r: np.ndarray
    series: taylor_motion.Series
    variations: taylor_variations.Varied


class ImplicitRoom(NamedTuple):
    """Room that implicit steps work in.

    Attributes
    ----------
    newton : radau_motion.Newton
    dv, dr : ndarray, shape (stages, n, 3)
        Increments of the step.
    v, r : ndarray, shape (n, 3)
        A trial state.
    excess, growth : ndarray, shape (m,)
        Stretch of the tethers [m] and its rate [m/s].
    margins : ndarray, shape (2, stages + 1, m)
        Stretch [m] and tension [N] of the tethers at the start and the nodes.
    pieces : ndarray, shape (DEEPEST + 2, stages + 3)
        Room for `bernstein.first_zero`.
    """

    newton: radau_motion.Newton
    dv: np.ndarray
    dr: np.ndarray
    v: np.ndarray
    r: np.ndarray
    excess: np.ndarray
    growth: np.ndarray
    margins: np.ndarray
    pieces: np.ndarray


@allocating
def explicit_room(arrays, order, columns):
    """An `ExplicitRoom` for so many columns of variations."""
    n, m = arrays.inv_mass.size, arrays.rest.size
    return ExplicitRoom(
        np.empty((n, 3)),
        np.empty((n, 3)),
        taylor_motion.blank(arrays, order),
        taylor_variations.blank(n, m, order, columns),
    )


@allocating
def implicit_room(arrays, symbolic, tables):
    """An `ImplicitRoom`."""
    s, n, m = tables.stages, arrays.inv_mass.size, arrays.rest.size
    return ImplicitRoom(
        radau_motion.blank(symbolic, tables, n),
        np.zeros((s, n, 3)),
        np.zeros((s, n, 3)),
        np.empty((n, 3)),
        np.empty((n, 3)),
        np.empty(m),
        np.empty(m),
        np.zeros((2, s + 1, m)),
        np.empty((DEEPEST + 2, s + 3)),
    )


@kernel
def interpolate(tables, increments, fraction, out):
    """Add the collocation polynomial of `increments` (s,n,3), at a fraction of the step, to out."""
    s = tables.stages
    for j in range(s):
        weight = 0.0
        for i in range(s, -1, -1):
            weight = weight * fraction + tables.power[i, j + 1]
        add(out, weight, increments[j])


@kernel
def _guess(tables, old, offset, scale, base, newton):
    """Fill `newton.dv` with the polynomial of `old` at offset + scale c_j, less that at `base`."""
    s = tables.stages
    for g in range(newton.dv.shape[0]):
        dv = in_lanes(newton.dv, g)
        fractions = offset + scale * load(tables.nodes, WIDTH * g)
        for k in range(s):
            there, here = splat(0.0), 0.0
            for i in range(s, -1, -1):
                there = there * fractions + tables.power[i, k + 1]
                here = here * base + tables.power[i, k + 1]
            weight = there - here
            for i in range(old.shape[1]):
                for q in range(3):
                    term = weight * old[k, i, q]
                    dv[i, q] = term if k == 0 else dv[i, q] + term


@inlined_by_llvm
def explicit_step(arrays, settings, motion, room, stop):
    """One step by Taylor series, up to the first switch.

    Parameters
    ----------
    arrays, settings, motion, room : KernelArrays, StepSettings, IntegratorState, ExplicitRoom
    stop : float
        [s] time not to step over.

    Returns
    -------
    size, natural : float
        [s] of the step, or why there was none (`step_control`); and of the step that could have
        been made without switch and stop.
    which : int
        The guard that is reached at its end (see `slack`), or -1.
    """
    at, series, columns = motion.progress[0], room.series, motion.x_r.shape[2]
    t, v, r = at.time, room.v, room.r
    to_orbit_frame(arrays.spin, t, motion.v, motion.r, v, r)
    taylor_motion.expand(arrays, motion.taut, motion.idle, v, r, series)
    natural = min(
        settings.longest,
        taylor_motion.longest_step(series.r, settings.explicit_tolerance, settings.speed),
    )
    if columns > 0:
        variations_to_orbit_frame(arrays.spin, t, motion.x_v, motion.x_r)
        taylor_variations.expand_variations(
            arrays, motion.taut, series, natural, motion.x_v, motion.x_r, room.variations
        )
        natural = min(
            natural,
            taylor_variations.longest_step_of_variations(
                room.variations.x, settings.explicit_tolerance, settings.speed
            ),
        )
    h, which = natural, -1
    if t + ENDS_THERE * h >= stop:
        h = stop - t
    if not arrays.bilateral:
        earliest, which = first_switch_of_series(arrays, motion.taut, motion.idle, series, h)
    if which >= 0:
        h = AT_ONCE if earliest < SMALLEST_BEFORE_SWITCH * h else min(earliest, h)
    elif h <= step_control.smallest_step(settings, t):
        h = TOO_SMALL
    end = h if h > 0.0 else 0.0
    if columns > 0:
        if end > 0.0:
            taylor_variations.evaluate_variations(room.variations.x, end, motion.x_v, motion.x_r)
        variations_to_turning_frame(arrays.spin, t + end, motion.x_v, motion.x_r)
    if end > 0.0:
        for i in range(0, series.r.size, WIDTH):
            store(motion.series, i, load(series.r, i))
        taylor_motion.evaluate(series.r, end, motion.v, motion.r)
        to_turning_frame(arrays.spin, t + end, motion.v, motion.r)
    return h, natural, which


@rounded_kernel
def implicit_step(arrays, symbolic, tables, settings, motion, room, stop, follows):
    """One step by Radau collocation, up to the first switch.

    Parameters
    ----------
    arrays, symbolic, tables, settings : KernelArrays, Symbolic, Tables, StepSettings
    motion, room : IntegratorState, ImplicitRoom
    stop : float
        [s] time not to step over.
    follows : bool
        Only failed attempts came after the last step, so that its polynomial is a good guess.

    Returns
    -------
    size, natural, which
        As `explicit_step`.
    """
    at, newton, s = motion.progress[0], room.newton, tables.stages
    natural = min(at.implicit_size, settings.longest, at.newton_limit)
    last = at.time + ENDS_THERE * natural >= stop
    full = stop - at.time if last else natural
    if full <= step_control.smallest_step(settings, at.time):
        return TOO_SMALL, ENDS_THERE * natural, -1
    step = ImplicitStep(at.time, full, motion.taut, motion.v, motion.r, room.dv, room.dr)
    _prepare(arrays, symbolic, tables, motion, room, step, follows)
    iterations = solve_stages(arrays, symbolic, tables, settings, step, newton)
    at.newton_iterations += abs(iterations)
    if iterations < 0:
        step_control.newton_failed(at, full)
        return REJECTED, full, -1
    acceleration(arrays, motion.taut, at.time, motion.v, motion.r, room.v)
    error = radau_motion.error_estimate(symbolic, tables, settings, step, newton, room.v)
    growth = step_control.growth_allowed(settings, s, error)
    if not error <= settings.tolerance:
        step_control.error_too_large(at, full, error, growth)
        return REJECTED, full, -1
    step_control.newton_succeeded(at, full, iterations)
    fraction, which, h = 2.0, -1, full
    if not arrays.bilateral:
        fraction, which = first_switch(arrays, tables, step, motion.idle, room)
    if which >= 0:
        h, target, iterations = _end_on_switch(
            arrays, symbolic, tables, settings, step, room, which, fraction
        )
        at.newton_iterations += abs(iterations)
        if target < SMALLEST_BEFORE_SWITCH * full:
            at.implicit_size = full
            return AT_ONCE, full, which
        if iterations < 0:
            step_control.switch_lost(at, h)
            return REJECTED, h, -1
        step = ImplicitStep(at.time, h, motion.taut, motion.v, motion.r, room.dv, room.dr)
    if motion.x_v.shape[2] > 0:
        error = vary(arrays, symbolic, tables, settings, step, newton, motion.x_v, motion.x_r)
        scaled = step_control.growth_allowed(settings, s, error)
        if not error <= settings.tolerance:
            step_control.error_too_large(at, h, error, scaled)
            return REJECTED, h, -1
        growth = min(growth, scaled * h / full)
    _advance(motion, step, s)
    if which >= 0 or not last:
        at.implicit_size = full * min(
            max(growth, step_control.LEAST_GROWTH), step_control.MOST_GROWTH
        )
    return h, full, which


@inlined
def _advance(motion, step, stages):
    """Move on to the end of a step, and keep how it went."""
    v, r, start_v, start_r, dv, dr = (
        motion.v,
        motion.r,
        motion.start_v,
        motion.start_r,
        motion.dv,
        motion.dr,
    )
    for i in range(r.shape[0]):
        for q in range(3):
            start_v[i, q], start_r[i, q] = v[i, q], r[i, q]
            for j in range(stages):
                dv[j, i, q], dr[j, i, q] = step.dv[j, i, q], step.dr[j, i, q]
            v[i, q] += step.dv[stages - 1, i, q]
            r[i, q] += step.dr[stages - 1, i, q]


@kernel
def _prepare(arrays, symbolic, tables, motion, room, step, follows):
    """Guess the increments of a step, and factor its Newton matrices there."""
    at, v, r, newton = motion.progress[0], room.v, room.r, room.newton
    middle = tables.stages // 2
    if at.step_size > 0.0 and follows and at.last_kind == IMPLICIT:
        _guess(tables, motion.dv, 1.0, step.size / at.step_size, 1.0, newton)
    else:
        newton.dv[:] = 0.0
    for i in range(r.shape[0]):
        for q in range(3):
            v[i, q] = step.v[i, q] + newton.dv[middle // WIDTH, i, q, middle % WIDTH]
            r[i, q] = step.r[i, q] + tables.c[middle] * step.size * v[i, q]
    time = step.time + tables.c[middle] * step.size
    jacobian(arrays, symbolic.pair, step.taut, time, v, r, newton.by_r, newton.by_v)
    newton_matrices(symbolic, tables, step.size, newton)


@kernel
def _end_on_switch(arrays, symbolic, tables, settings, step, room, which, fraction):
    """Make a step once more so that it ends where a tether switches, near a fraction of it.

    Returns the step's size [s], the size aimed at last [s], less than the smallest one if the
    switch is due at once; and the Newton iterations it took, negative if they failed.
    """
    full, s, v, r, tethers = step.size, tables.stages, room.v, room.r, arrays.rest.size
    h, target, total = full, fraction * full, 0
    for attempt in range(MOST_ATTEMPTS):
        if attempt:
            target = h - room.excess[which] / room.growth[which]
        if not 0.0 < target <= full * (1.0 + 1e-9) or target < SMALLEST_BEFORE_SWITCH * full:
            break
        _guess(tables, step.dv, 0.0, target / h, 0.0, room.newton)
        h = target
        shorter = ImplicitStep(step.time, h, step.taut, step.v, step.r, step.dv, step.dr)
        newton_matrices(symbolic, tables, h, room.newton)
        iterations = solve_stages(arrays, symbolic, tables, settings, shorter, room.newton)
        total += abs(iterations)
        if iterations < 0:
            return h, target, -total
        if which >= tethers:  # The force is continuous there, so that once is near enough.
            break
        sum_of(step.v, step.dv[s - 1], v)
        sum_of(step.r, step.dr[s - 1], r)
        stretch(arrays, step.time + h, v, r, room.excess, room.growth)
        miss = abs(room.excess[which])
        if miss <= 4e-15 * arrays.rest[which] or miss <= 1e-15 * full * abs(room.growth[which]):
            break
    return h, target, total
