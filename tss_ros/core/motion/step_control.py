"""How long steps may be, and of which kind: every rule and number of it in one place.

Explicit steps (`taylor_motion`) are cheap, but no longer than the fastest motion of the tethers
allows, even where it has died away; implicit ones (`radau_motion`) then go on in far longer steps.
So: explicit from every start and switch on, implicit once nothing but the bound on explicit steps
holds them back, and explicit again where implicit steps do not grow.
"""

import math
from typing import NamedTuple

import numpy as np

from tss_ros.core.model.kernel_arrays import ROW
from tss_ros.core.numerics.simd import kernel

#: Kinds of steps, and what `StepSettings.kind` may allow: one kind only, or both.
IMPLICIT, EXPLICIT, BOTH = range(3)
#: Step sizes that say why there was no step: try again, switch first, or none possible.
REJECTED, AT_ONCE, TOO_SMALL = -1.0, -2.0, -3.0
#: Where Newton's iteration does not limit the step [s]; finite, so that it can be stored anywhere.
ANY_STEP = 1e300

#: A step that would end this near to where the motion stops, relative to its size, ends there.
ENDS_THERE = 1.01
#: Smallest step, relative to the time so far; and to its size, the smallest before a switch.
SMALLEST_STEP, SMALLEST_BEFORE_SWITCH = 1e-14, 1e-10
#: Share of the step size that the error allows, and the least and most that it changes at a time.
SAFETY, LEAST_GROWTH, MOST_GROWTH = 0.85, 0.1, 8.0
#: Of a step whose Newton iteration failed or whose error is infinite, the next one; and the bound
#: that steps then keep to for a while, and how it is lifted with every step that succeeds.
AFTER_FAILURE, NEWTON_BOUND, NEWTON_RELIEF = 0.4, 0.6, 1.2
#: Newton iterations beyond which longer steps do not pay: they would soon fail.
MANY_ITERATIONS = 8.0
#: Of a step in which a switch could not be located, the next one.
AFTER_LOST_SWITCH = 0.5
#: After a switch, the next implicit step: share of the one that led to it, and most it may be in
#: units of the tether's fastest motion.
AFTER_SWITCH, RINGING = 0.2, 2.0
#: First implicit step after explicit ones, in units of these.
FIRST_IMPLICIT = 6.0

#: Explicit steps that one implicit step costs, and each of its Newton iterations, of the motion
#: alone and with variations; those of more beads than this are always carried implicitly.
COST, COST_VARIED, FEW_BEADS = (1.6, 0.35), (3.3, 0.06), 8
#: Share of the longest step an explicit method can bear at the fastest rate, `StepSettings.bound`
#: over it, from which on a step counts as bounded by that rate alone.
BOUNDED = 0.75
#: Steps in a row that must speak for the other kind: for implicit ones, for explicit ones.
DOUBTS_FOR_IMPLICIT, DOUBTS_FOR_EXPLICIT = 2, 3
#: Fewest and most explicit steps after implicit ones, doubled each time.
LEAST_HOLD, MOST_HOLD = 64, 1024


class StepSettings(NamedTuple):
    """What steps keep to.

    Attributes
    ----------
    tolerance : float
        Largest estimated local error per implicit step, scaled.
    accuracy : float
        How far Newton iterations converge, scaled.
    length, speed : float
        [m] and [m/s], the scales of errors.
    longest : float
        [s] largest step.
    kind : int
        IMPLICIT, EXPLICIT or BOTH.
    order : int
        N, of explicit steps.
    explicit_tolerance : float
        Largest of the last two terms of an explicit step, scaled.
    bound : float
        N!^(1/N), the step that explicit steps bear where exp(-t) has died away.
    """

    tolerance: float
    accuracy: float
    length: float
    speed: float
    longest: float
    kind: int
    order: int
    explicit_tolerance: float
    bound: float


@kernel
def smallest_step(settings, time):
    """[s] the shortest step that still moves the time on."""
    return SMALLEST_STEP * max(time, settings.length / settings.speed)


@kernel
def growth_allowed(settings, stages, error):
    """Factor by which an error estimate of order `stages` lets a step grow."""
    return SAFETY * (settings.tolerance / max(error, 1e-300)) ** (1.0 / (stages + 1))


@kernel
def newton_failed(at, size):
    """Note that Newton's iteration, not the error, bounds the steps: come near that size slowly."""
    at.rejected += 1
    at.implicit_size = AFTER_FAILURE * size
    at.newton_limit = NEWTON_BOUND * size


@kernel
def newton_succeeded(at, size, iterations):
    """Lift the bound of Newton's iteration, or keep it where that takes long."""
    at.newton_limit = min(NEWTON_RELIEF * at.newton_limit, ANY_STEP)
    if iterations > MANY_ITERATIONS:
        at.newton_limit = min(at.newton_limit, size * MANY_ITERATIONS / iterations)


@kernel
def error_too_large(at, size, error, growth):
    """Note that a step of this size has too large an error."""
    at.rejected += 1
    at.implicit_size = size * max(LEAST_GROWTH, growth) if error < np.inf else AFTER_FAILURE * size


@kernel
def switch_lost(at, size):
    """Note that the switch in a step of this size could not be located."""
    at.rejected += 1
    at.implicit_size = AFTER_LOST_SWITCH * size


@kernel
def after_switch(at, natural, ringing):
    """Bound the next implicit step after a tether that rings this fast [1/s] has switched."""
    at.newton_limit = ANY_STEP
    at.implicit_size = min(at.implicit_size, AFTER_SWITCH * natural)
    if ringing > 0.0:
        at.implicit_size = min(at.implicit_size, RINGING / ringing)


@kernel
def start_anew(at):
    """Forget, after a switch, what spoke for one kind of step or the other."""
    at.next_kind = EXPLICIT
    at.doubts = at.hold = at.backoff = 0


@kernel
def choose_kind(at, rate, bound, natural, price):
    """Choose the kind of the next step.

    Parameters
    ----------
    at : record of `state.PROGRESS`
    rate : float
        [1/s] fastest at which taut tethers swing or decay, see `taut_rates`.
    bound : float
        See `StepSettings`.
    natural : float
        [s] size that the last step could have had without switch and stop.
    price : float
        What it cost, if implicit, in explicit steps.
    """
    if at.next_kind == EXPLICIT:
        at.hold = max(0, at.hold - 1)
        at.doubts = at.doubts + 1 if natural * rate > BOUNDED * bound else 0
        if at.doubts >= DOUBTS_FOR_IMPLICIT and at.hold == 0:
            at.next_kind, at.doubts = IMPLICIT, 0
            at.implicit_size, at.newton_limit = FIRST_IMPLICIT * natural, ANY_STEP
    else:
        at.doubts = at.doubts + 1 if at.step_size * rate < price * bound else 0
        if at.doubts >= DOUBTS_FOR_EXPLICIT:
            at.next_kind, at.doubts = EXPLICIT, 0
            at.backoff = min(MOST_HOLD, max(LEAST_HOLD, 2 * at.backoff))
            at.hold = at.backoff


@kernel
def ringing_rate(arrays, taut, guard):
    """Bound [1/s] of the rates at which the tether of a guard swings or decays; 0 if not taut."""
    k = guard % arrays.rest.size
    if not taut[k]:
        return 0.0
    i, j = arrays.ends[k, 0], arrays.ends[k, 1]
    weight = arrays.inv_mass[i] + arrays.inv_mass[j]
    return arrays.damping[k] * weight + math.sqrt(arrays.stiffness[k] * weight)


@kernel
def taut_rates(arrays, taut, sums):
    """What taut tethers do between two switches.

    Parameters
    ----------
    arrays : KernelArrays
    taut : ndarray, shape (m,), bool
    sums : ndarray, shape (n, 3)
        Overwritten.

    Returns
    -------
    fastest : float
        Bound [1/s] of the rates at which they swing or decay.
    dissipation : float
        Sum of C (1/m_i + 1/m_j) over them [1/s], and of C over the reels' masses.
    """
    for i in range(sums.shape[0]):
        sums[i, 0] = sums[i, 1] = 0.0
    for k in range(arrays.rest.size):
        if taut[k]:
            for side in range(2):
                end = arrays.ends[k, side]
                sums[end, 0] += arrays.inv_mass[end] * arrays.stiffness[k]
                sums[end, 1] += arrays.inv_mass[end] * arrays.damping[k]
    swing = decay = dissipation = 0.0
    for k in range(arrays.rest.size):
        if taut[k]:
            i, j = arrays.ends[k, 0], arrays.ends[k, 1]
            swing = max(swing, sums[i, 0] + sums[j, 0])
            decay = max(decay, sums[i, 1] + sums[j, 1])
            dissipation += arrays.damping[k] * (arrays.inv_mass[i] + arrays.inv_mass[j])
            if arrays.reel.size > 0 and arrays.reel[k, ROW] >= 0.0:
                dissipation += arrays.damping[k] * arrays.inv_mass[int(arrays.reel[k, ROW])]
    return max(decay, math.sqrt(swing)), dissipation
