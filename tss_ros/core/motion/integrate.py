"""Adaptive integration of motion and variations; steps end exactly on slack/taut switches.

Two kinds of steps take turns; `step_control` says which is next, and how long it is.
"""

import numpy as np

from tss_ros.core.errors import IntegrationError
from tss_ros.core.model.forces import stretch, tensions
from tss_ros.core.model.frames import to_orbit_frame, to_turning_frame
from tss_ros.core.model.kernel_arrays import KernelArrays
from tss_ros.core.motion import step, step_control, taylor_motion
from tss_ros.core.motion.slack import toggle
from tss_ros.core.motion.state import PROGRESS, IntegratorState, Samples
from tss_ros.core.motion.step_control import (
    ANY_STEP,
    AT_ONCE,
    BOTH,
    COST,
    COST_VARIED,
    ENDS_THERE,
    EXPLICIT,
    FEW_BEADS,
    IMPLICIT,
    REJECTED,
    TOO_SMALL,
    StepSettings,
)
from tss_ros.core.numerics.loops import assign
from tss_ros.core.numerics.radau_tables import Tables
from tss_ros.core.numerics.simd import WIDTH, python_allocating, python_kernel, rounded_kernel

#: Outcomes of `advance`.
REACHED, PAUSED, STEP_TOO_SMALL, TOO_MANY_SWITCHES = range(4)
#: Most slack/taut switches in one turn before a motion counts as chattering.
MOST_SWITCHES_PER_TURN = 20_000
#: How near to its rest length a tether switches together with another, relative to it.
ON_EDGE = 1e-12


def begin(
    arrays: KernelArrays,
    tables: Tables,
    settings: StepSettings,
    v: np.ndarray,
    r: np.ndarray,
    first_step: float,
) -> IntegratorState:
    """Start a motion at time 0, without variations.

    Parameters
    ----------
    arrays, tables, settings : KernelArrays, Tables, StepSettings
    v, r : ndarray, shape (n, 3)
        Velocities [m/s] and positions [m] in the orbit frame.
    first_step : float
        [s] first implicit step size to try.

    Returns
    -------
    IntegratorState
    """
    motion = blank(arrays, tables, settings)
    m = arrays.rest.size
    _start(arrays, settings, motion, v, r, first_step, np.empty(m), np.empty(m))
    return motion


def blank(arrays: KernelArrays, tables: Tables, settings: StepSettings) -> IntegratorState:
    """Room for a motion without variations."""
    n, m, s = arrays.inv_mass.size, arrays.rest.size, tables.stages
    state, steps, none = (n, 3), (s, n, 3), (n, 3, 0)
    return IntegratorState(
        progress=np.zeros(1, dtype=PROGRESS),
        taut=np.zeros(m, dtype=bool),
        idle=np.zeros(m, dtype=bool),
        v=np.empty(state),
        r=np.empty(state),
        start_v=np.empty(state),
        start_r=np.empty(state),
        dv=np.zeros(steps),
        dr=np.zeros(steps),
        series=np.zeros((-(-n // WIDTH), settings.order + 1, 3, WIDTH)),
        x_v=np.empty(none),
        x_r=np.empty(none),
    )


def check(status: int, motion: IntegratorState, which: str) -> None:
    """Raise IntegrationError if a motion, named in words, could not be continued."""
    if status in (REACHED, PAUSED):
        return
    where = f"at {motion.time:.6g} s, after {motion.steps} steps"
    if status == STEP_TOO_SMALL:
        raise IntegrationError(f"{which} could not be continued {where}: steps too small")
    raise IntegrationError(
        f"{which}'s tethers chatter {where}: more than {MOST_SWITCHES_PER_TURN} slack/taut switches"
        " without progress"
    )


@python_kernel
def _start(arrays, settings, motion, v, r, first_step, excess, growth):
    """Set a motion to time 0 and a state v, r (n,3) of the orbit frame; excess, growth: room."""
    at = motion.progress[0]
    at.time = at.step_start = at.step_size = at.dissipation = 0.0
    at.steps = at.rejected = at.newton_iterations = at.switches = at.sampled = 0
    at.last_kind = at.doubts = at.hold = at.backoff = 0
    at.implicit_size, at.newton_limit = first_step, ANY_STEP
    at.next_kind = IMPLICIT if settings.kind == IMPLICIT else EXPLICIT
    for i in range(r.shape[0]):
        for q in range(3):
            motion.r[i, q], motion.v[i, q] = r[i, q], v[i, q]
    to_turning_frame(arrays.spin, 0.0, motion.v[: arrays.beads], motion.r[: arrays.beads])
    for i in range(r.shape[0]):
        for q in range(3):
            motion.start_r[i, q], motion.start_v[i, q] = motion.r[i, q], motion.v[i, q]
    set_modes(arrays, motion, 0.0, motion.v, motion.r, excess, growth)


@python_kernel
def set_modes(arrays, motion, time, v, r, excess, growth):
    """Set the modes of all tethers to those of a state v, r (n,3) at a time [s].

    `excess` and `growth` (m,) are room.
    """
    stretch(arrays, time, v, r, excess, growth)
    for k in range(excess.size):
        # Eq. (5), and at the rest length whichever mode the motion is about to be in.
        longer = excess[k] > 0.0 or (excess[k] == 0.0 and growth[k] > 0.0) or arrays.bilateral
        motion.taut[k], motion.idle[k] = longer, False
    if not arrays.pushes:
        tensions(arrays, time, v, r, excess)
        for k in range(excess.size):
            motion.idle[k] = motion.taut[k] and excess[k] < 0.0
            motion.taut[k] = motion.taut[k] and not motion.idle[k]


@rounded_kernel
def _state_at(arrays, tables, motion, now, v, r):
    """Write the state at a time [s] within the last step, in the orbit frame."""
    at = motion.progress[0]
    if at.last_kind == EXPLICIT:
        taylor_motion.evaluate(motion.series, now - at.step_start, v, r)
    else:
        assign(v, motion.start_v)
        assign(r, motion.start_r)
        if at.step_size > 0.0:
            fraction = (now - at.step_start) / at.step_size
            step.interpolate(tables, motion.dv, fraction, v)
            step.interpolate(tables, motion.dr, fraction, r)
        beads_v, beads_r = v[: arrays.beads], r[: arrays.beads]
        to_orbit_frame(arrays.spin, now, beads_v, beads_r, beads_v, beads_r)


@rounded_kernel
def _sample(arrays, tables, motion, samples):
    """Write the states at all requested times up to now, in the orbit frame."""
    at = motion.progress[0]
    while at.sampled < samples.times.size and samples.times[at.sampled] <= at.time:
        now, v, r = samples.times[at.sampled], samples.v[at.sampled], samples.r[at.sampled]
        _state_at(arrays, tables, motion, now, v, r)
        at.sampled += 1


@python_allocating
def take_back(arrays, tables, motion):
    """Take the last step of a motion without variations back."""
    at, (n, m) = motion.progress[0], (motion.r.shape[0], arrays.rest.size)
    v, r, excess, growth = np.empty((n, 3)), np.empty((n, 3)), np.empty(m), np.empty(m)
    # No tether changes its mode within a step: in the middle, each is far from where it would.
    before = motion.taut.copy()
    middle = at.step_start + 0.5 * at.step_size
    _state_at(arrays, tables, motion, middle, v, r)
    set_modes(arrays, motion, middle, v, r, excess, growth)
    for k in range(m):
        at.switches -= motion.taut[k] != before[k]
    _, dissipation = step_control.taut_rates(arrays, motion.taut, v)
    at.dissipation -= dissipation * at.step_size
    if at.last_kind == EXPLICIT:
        taylor_motion.evaluate(motion.series, 0.0, motion.v, motion.r)
        to_turning_frame(arrays.spin, at.step_start, motion.v, motion.r)
    else:
        assign(motion.v, motion.start_v)
        assign(motion.r, motion.start_r)
    at.time, at.step_size = at.step_start, 0.0
    at.steps -= 1


@python_allocating
def advance(arrays, symbolic, tables, settings, motion, limits, samples):
    """Integrate until a time, or until so many steps or switches were made.

    Parameters
    ----------
    arrays, symbolic, tables, settings : KernelArrays, Symbolic, Tables, StepSettings
    motion : IntegratorState
        Advanced in place.
    limits : tuple of float, int, int
        Time [s] to end at exactly, or infinity to end with the step that covers the samples; most
        steps and most slack/taut switches in this call.
    samples : Samples
        States wanted, written as the motion passes them.

    Returns
    -------
    int
        REACHED, PAUSED (out of steps), STEP_TOO_SMALL or TOO_MANY_SWITCHES.
    """
    stop, most_steps, switches = limits
    at, n, columns = motion.progress[0], motion.r.shape[0], motion.x_r.shape[2]
    explicit = step.explicit_room(arrays, settings.order, columns)
    implicit = step.implicit_room(arrays, symbolic, tables)
    # Taken out of their tuples once, since each time would count references to them.
    taut, sums, excess, growth = motion.taut, implicit.v, implicit.excess, implicit.growth
    made, most_switches, iterations = 0, at.switches + switches, at.newton_iterations
    follows, both = at.steps >= 0, settings.kind == BOTH  # Not plain True: another type.
    cost = COST_VARIED if columns > 0 else COST
    if both and n > FEW_BEADS and columns > 0:
        both, at.next_kind = False, IMPLICIT
    fastest, dissipation = step_control.taut_rates(arrays, taut, sums)
    _sample(arrays, tables, motion, samples)
    while True:
        t, kind = at.time, at.next_kind
        if t >= stop or (stop == np.inf and at.sampled >= samples.times.size):
            return REACHED
        if made >= most_steps:
            return PAUSED
        if at.switches > most_switches:
            return TOO_MANY_SWITCHES
        if kind == EXPLICIT:
            h, natural, which = step.explicit_step(arrays, settings, motion, explicit, stop)
        else:
            h, natural, which = step.implicit_step(
                arrays, symbolic, tables, settings, motion, implicit, stop, follows
            )
        if h == REJECTED:
            continue
        follows = h > 0.0
        if h == AT_ONCE:
            if toggle(arrays, motion, which, ON_EDGE, excess, growth) == 0:
                return STEP_TOO_SMALL
            fastest, dissipation = step_control.taut_rates(arrays, taut, sums)
            if both:
                step_control.start_anew(at)
            continue
        if h == TOO_SMALL:
            if t + natural >= stop:
                at.time = stop
                return REACHED
            return STEP_TOO_SMALL
        made += 1
        at.steps += 1
        at.step_start, at.step_size, at.last_kind = t, h, kind
        at.dissipation += dissipation * h
        at.time = stop if t + h >= stop or which < 0 and t + ENDS_THERE * h >= stop else t + h
        if both:
            price = cost[0] + cost[1] * (at.newton_iterations - iterations)
            step_control.choose_kind(at, fastest, settings.bound, natural, price)
            iterations = at.newton_iterations
        if which >= 0:
            toggle(arrays, motion, which, ON_EDGE, excess, growth)
            fastest, dissipation = step_control.taut_rates(arrays, taut, sums)
            step_control.after_switch(at, natural, step_control.ringing_rate(arrays, taut, which))
            if both:
                step_control.start_anew(at)
        if at.sampled < samples.times.size:
            _sample(arrays, tables, motion, samples)


@python_allocating
def advance_each(arrays, symbolic, tables, settings, motion, limits, first_step, states):
    """Advance many motions one after another, each by itself.

    Parameters
    ----------
    arrays, symbolic, tables, settings : KernelArrays, Symbolic, Tables, StepSettings
    motion : IntegratorState
        Room for each of them in turn; the last one stays.
    limits : tuple of float, int, int
        As `advance`; the time is finite.
    first_step : float
        [s] first implicit step size to try.
    states : ndarray, shape (k, 2, n, 3)
        Velocities and positions in the orbit frame: where they start, overwritten by where they
        are at the end.

    Returns
    -------
    int, int
        The motion that could not be continued, or how many there are; and the last outcome.
    """
    m, status, none = arrays.rest.size, REACHED, np.empty((0, motion.v.shape[0], 3))
    excess, growth = np.empty(m), np.empty(m)
    samples = Samples(np.empty(0), none, none)
    for k in range(states.shape[0]):
        v, r = states[k, 0], states[k, 1]
        _start(arrays, settings, motion, v, r, first_step, excess, growth)
        status = advance(arrays, symbolic, tables, settings, motion, limits, samples)
        if status != REACHED:
            return k, status
        assign(v, motion.v)
        assign(r, motion.r)
        v, r = v[: arrays.beads], r[: arrays.beads]
        to_orbit_frame(arrays.spin, motion.progress[0].time, v, r, v, r)
    return states.shape[0], status
