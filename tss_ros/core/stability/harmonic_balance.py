"""Periodic motions by harmonic balance: the whole turn at once instead of shooting along it.

A taut formation answers the gravity gradient slowly, with a few harmonics of the spin, while its
tethers' waves are fast and hardly damped. Values at equally spaced times of the turn carry the
first and know nothing of the second (Fourier collocation; L. N. Trefethen, Spectral Methods in
MATLAB, ch. 3). Newton's equations have the tether graph's pattern, one block a bead, so that time
and memory grow linearly with the number of beads.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tss_ros.core.errors import Cancelled, IntegrationError
from tss_ros.core.model import forces
from tss_ros.core.model.axes import spin_axis_of
from tss_ros.core.model.frames import rigid_velocity, turn_about
from tss_ros.core.model.system import State
from tss_ros.core.motion.integrator import Integrator
from tss_ros.core.numerics import block_lu
from tss_ros.core.numerics.fourier import differentiation, resampled
from tss_ros.core.stability.shooting import closure

#: Largest closure residual of a motion that still counts as periodic: without a drive it is what
#: damping takes of the spin.
CLOSED = 1e-3
#: Harmonics of the spin, tried one after the other until the closure residual is below this.
HARMONICS, ENOUGH = (8, 16, 32), 0.1 * CLOSED
#: Most Newton iterations, the change in one at which it is given up, and that of the last one,
#: over the radius.
ITERATIONS, FARTHEST, SETTLED = 20, 0.2, 1e-6


def close_by_harmonic_balance(
    integrator: Integrator, state: State, cancelled: Callable[[], bool] | None = None
) -> State:
    """Start of the periodic motion next to a rigid turn, as far as tethers stay taut on it.

    With damping no motion with varying lengths closes exactly: the spin slows down. Starting as
    fast as brings the formation back to its angle leaves only that loss of speed.

    Parameters
    ----------
    integrator : Integrator
    state : State
        Its positions, turning with the spin, are where the iteration begins.
    cancelled : callable, optional
        Asked now and then; a true answer stops the work.

    Returns
    -------
    State
        Start of least closure residual, `state` itself where no better one was found.

    Raises
    ------
    IntegrationError
        If the motion from `state` cannot be continued, or if reels follow tension.
    Cancelled
        If `cancelled` said so.
    """
    if integrator.rows > integrator.system.n:
        raise IntegrationError("harmonic balance knows no reels that follow tension")
    best, left = state, closure(integrator, state, cancelled).residual
    known = rigid = _rigid_turn(integrator, state)
    for harmonics in HARMONICS:
        found = _balanced(integrator, known, harmonics, cancelled)
        known = found or rigid
        if found is None:
            continue
        with contextlib.suppress(IntegrationError):
            after = closure(integrator, found.start, cancelled).residual
            if after < left:
                best, left = found.start, after
        if left < ENOUGH:
            break
    return best


@dataclass(frozen=True)
class _Orbit:
    """Positions (count, n, 3) in the integrator's frame and tensions (count, m) along a turn."""

    r: np.ndarray
    tension: np.ndarray
    start: State


def _rigid_turn(integrator, state):
    r, v = state.position_m[None], np.zeros((1, integrator.system.n, 3))
    if not integrator.arrays.spin:
        axis = spin_axis_of(integrator.system, state, integrator.spin)
        angles = math.copysign(2.0 * math.pi / 3.0, integrator.spin) * np.arange(3)
        r = np.array([r[0] @ turn_about(axis, angle).T for angle in angles])
        v = rigid_velocity(r, integrator.spin, axis)
    none = np.zeros_like(r)
    return _Orbit(r, _tension(integrator.arrays, r, v, none, none), state)


def _balanced(integrator, known, harmonics, cancelled):
    """The motion with so many harmonics next to a known one, None if Newton's iteration fails."""
    n, count, axes = integrator.system.n, 2 * harmonics + 1, 3 if known.r[:, :, 2].any() else 2
    arrays, rate = integrator.arrays._replace(bilateral=True), abs(integrator.spin)
    axis = spin_axis_of(integrator.system, known.start, integrator.spin)
    time = 2.0 * math.pi / rate * np.arange(count) / count
    slope = differentiation(count) * rate
    r, tension = (resampled(x, count) for x in (known.r, known.tension))
    v = np.tensordot(slope, r, 1)
    pinned = int(np.argmax(np.linalg.norm(np.cross(axis, r[0]), axis=1)))
    free = _free_directions(arrays, axis, r[:, pinned], time, axes)
    for _ in range(ITERATIONS):
        if cancelled is not None and cancelled():
            raise Cancelled(f"stopped while balancing {harmonics} harmonics")
        motion = r, v, tension, rigid_velocity(r, 1.0, axis)
        matrix, right = _equations(arrays, integrator.symbolic, time, slope, motion, axes)
        matrix[pinned] += np.max(np.abs(matrix[pinned])) * (free.T @ free)
        block_lu.factor_wide(integrator.symbolic, matrix)
        block_lu.solve_wide(integrator.symbolic, matrix, right)
        # Damping takes of the spin; this angular acceleration makes up for it.
        turned = free[0] @ right[pinned]
        drive = -turned[0] / turned[1]
        change = np.zeros_like(r)
        change[:, :, :axes] = (right @ [1.0, drive]).reshape(n, count, axes).transpose(1, 0, 2)
        size = np.max(np.abs(change)) / integrator.settings.length
        if not size < FARTHEST:
            return None
        tension = _tension(arrays, r, v, change, np.tensordot(slope, change, 1))
        r = r + change
        v = np.tensordot(slope, r, 1)
        if size < SETTLED:
            extra = rigid_velocity(r[0], drive * math.pi / rate, axis)
            turning = rigid_velocity(r[0], integrator.arrays.spin)
            return _Orbit(r, tension, State(r[0], v[0] + turning + extra))
    return None


def _free_directions(arrays, axis, place, time, axes):
    """Phase of the spin and of the orbit, told by no force: of one bead, (2, count * axes)."""
    free = np.zeros((2, time.size, axes))
    along = rigid_velocity(place if not arrays.spin else place[:1], 1.0, axis)
    free[0] = (along / np.linalg.norm(along, axis=1, keepdims=True))[:, :axes]
    free[1, :, 0], free[1, :, 1] = np.cos(arrays.spin * time), -np.sin(arrays.spin * time)
    return free.reshape(2, -1) / math.sqrt(time.size)


def _tension(arrays, r, v, change, rate):
    """Tension (count, m) of every tether to first order in changes of r and v."""
    first, second = arrays.ends.T
    e, w, by_r, by_v = (x[:, first] - x[:, second] for x in (r, v, change, rate))
    length = np.linalg.norm(e, axis=2)
    growth = np.sum(e * w, axis=2) / length
    longer = np.sum(e * by_r, axis=2) / length
    faster = (np.sum(e * by_v + w * by_r, axis=2) - growth * longer) / length
    tension, slope = forces.tension_and_slopes(arrays, length, growth)
    return tension + slope * longer + arrays.damping * faster


def _equations(arrays, symbolic, time, slope, motion, axes):
    """Newton's equations for r'' = a: matrix (blocks, w, w), right sides (n, w, 2) of a and s x r.

    Tethers are too stiff for their lengths to say how they pull while beads still move sideways:
    tensions are unknowns, too, already eliminated. What remains of them is that the derivatives
    belong to the tension, not the length, as if each tether's rest length were another.
    """
    r, v, tension, around = motion
    count, n = r.shape[:2]
    taut = np.ones(arrays.rest.size, dtype=bool)
    known = symbolic.row.size
    force, by_r, by_v = np.empty_like(r), *np.empty((2, count, symbolic.blocks, 3, 3))
    none = np.zeros_like(r)
    apart = (_tension(arrays, r, v, none, none) - tension) / arrays.stiffness
    for k, at in enumerate(time):
        forces.acceleration(arrays, taut, at, v[k], r[k], force[k])
        pulling = arrays._replace(rest=arrays.rest + apart[k])
        forces.jacobian(pulling, symbolic.pair, taut, at, v[k], r[k], by_r[k], by_v[k])
    force -= np.tensordot(slope @ slope, r, 1)
    by_r, by_v = (x[:, :known, :axes, :axes].transpose(1, 0, 2, 3) for x in (by_r, by_v))
    matrix = np.zeros((symbolic.blocks, count, axes, count, axes))
    matrix[:known] = -by_v[:, :, :, None] * slope[:, None, :, None]
    here = np.arange(count)
    matrix[:known, here, :, here] -= by_r.transpose(1, 0, 2, 3)
    for axis in range(axes):
        matrix[:n, :, axis, :, axis] += slope @ slope
    width = count * axes
    right = np.stack([force, around], axis=3)[:, :, :axes].transpose(1, 0, 2, 3)
    return matrix.reshape(symbolic.blocks, width, width), right.reshape(n, width, 2)
