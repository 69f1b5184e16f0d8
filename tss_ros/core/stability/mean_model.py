"""The modes of a formation with its forces averaged over a turn.

In the turning frame a formation hardly moves. What a small displacement does there, averaged over
the turn, is a linear system with constant coefficients, whose modes have frequencies, wave numbers
and shapes of their own: those of rings and chains under mean tension. The gravity gradient, which
turns against that frame, changes each of them a little and lets two of them meet in a resonance.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from tss_ros.core.model import forces
from tss_ros.core.model.axes import spin_axis_of
from tss_ros.core.model.frames import crossed, to_turning_frame, turn_about
from tss_ros.core.model.kernel_arrays import ROW
from tss_ros.core.model.symmetry import cyclic_symmetry
from tss_ros.core.model.system import State
from tss_ros.core.motion.integrator import Integrator
from tss_ros.core.stability.modes import in_turning_frame, label, multipliers, stays_in_plane

#: Times of a turn over which forces are averaged.
SAMPLES = 24


@dataclass(frozen=True)
class MeanModes:
    """Modes of the averaged system.

    Attributes
    ----------
    exponent : ndarray, shape (k,), complex
        [a turn] growth and, imaginary, 2 pi times frequency.
    vectors : ndarray, shape (6 rows, k), complex
        Columns in scaled coordinates, as seen in the frame that turns with the spin.
    wave_number : ndarray, shape (k,), int
        Around the formation; -1 where its cyclic symmetry is of an order below 3.
    family : ndarray, shape (k,), str
        As for multipliers.
    """

    exponent: np.ndarray
    vectors: np.ndarray
    wave_number: np.ndarray
    family: np.ndarray

    @property
    def frequency(self) -> np.ndarray:
        """Signed, in cycles a turn of the formation."""
        return self.exponent.imag / (2.0 * math.pi)


def mean_modes(integrator: Integrator, state: State) -> MeanModes:
    """Modes of the forces averaged over the turn from a state.

    Parameters
    ----------
    integrator : Integrator
    state : State
        Start of the turn.

    Returns
    -------
    MeanModes

    Raises
    ------
    IntegrationError
        If the motion cannot be continued.
    """
    axis = spin_axis_of(integrator.system, state, integrator.spin)
    matrix = mean_matrix(integrator, state, axis) * integrator.period_s
    planar = stays_in_plane(integrator.system, state)
    exponent, vectors = multipliers(matrix, planar, integrator.real)
    seen = in_turning_frame(integrator, axis, vectors, back=True)
    with np.errstate(over="ignore", under="ignore"):
        family = label(integrator, state, np.exp(exponent), seen, exponent)
    return MeanModes(exponent, vectors, wave_numbers(integrator, vectors, axis), family)


class _Turning:
    """The frame that turns with the spin about an axis, where forces are those of an integrator.

    Where the integrator's own frame does, forces are taken as they are; where it is the orbit
    frame, they are turned, and what the turning adds is added.
    """

    def __init__(self, integrator, axis):
        self.spin = 0.0 if integrator.arrays.spin else integrator.spin
        self.axis, self.cross = axis, self.spin * crossed(axis)

    def place(self, time, r):
        """Positions in the integrator's frame as seen in this one."""
        return r @ turn_about(self.axis, self.spin * time)

    def acceleration(self, arrays, taut, time, place):
        """Of beads at rest there, (n, 3)."""
        a, turn = np.empty_like(place), turn_about(self.axis, self.spin * time)
        v, r = place @ (turn @ self.cross).T, place @ turn.T
        forces.acceleration(arrays, taut, time, np.ascontiguousarray(v), r, a)
        return a @ turn - place @ (self.cross @ self.cross).T

    def jacobian(self, arrays, symbolic, taut, time, place):
        """Its blocks by place and velocity there, (b, 3, 3) each."""
        by_r, by_v = np.empty((2, symbolic.row.size, 3, 3))
        turn = turn_about(self.axis, self.spin * time)
        v, r = place @ (turn @ self.cross).T, place @ turn.T
        forces.jacobian(arrays, symbolic.pair, taut, time, v, r, by_r, by_v)
        by_r = turn.T @ (by_r @ turn + by_v @ turn @ self.cross)
        by_v = turn.T @ by_v @ turn
        own = symbolic.row == symbolic.column
        by_r[own] -= self.cross @ self.cross
        by_v[own] -= 2.0 * self.cross
        return by_r, by_v


def mean_matrix(integrator: Integrator, state: State, axis: np.ndarray) -> np.ndarray:
    """Jacobian [1/s] of scaled coordinates in the turning frame, at the mean places.

    Tethers lie as they do on average and pull with their mean tension, changed by the little that
    keeps the beads there. To average the Jacobian itself would stiffen tethers that sway.
    """
    system, symbolic, n = integrator.system, integrator.symbolic, integrator.rows
    times = integrator.period_s / SAMPLES * np.arange(SAMPLES)
    samples, motion = integrator.samples(times), integrator.begin(state)
    integrator.advance(motion, integrator.period_s, samples=samples)
    _, tension, taut = integrator.tethers(samples)
    for time, v, r in zip(times, samples.v, samples.r):
        to_turning_frame(integrator.arrays.spin, time, v[: system.n], r[: system.n])
    turning = _Turning(integrator, axis)
    place = np.mean([turning.place(time, r) for time, r in zip(times, samples.r)], axis=0)
    arrays = _in_balance(integrator.arrays, turning, times, place, np.mean(tension, axis=0))
    pulls = np.mean(taut, axis=0) + system.bilateral > 0.5
    sums = np.zeros((2, symbolic.row.size, 3, 3))
    for time in times:
        by_r, by_v = turning.jacobian(arrays, symbolic, pulls, time, place)
        sums[0] += by_v / SAMPLES
        sums[1] += by_r / SAMPLES
    speed, length = integrator.settings.speed, integrator.settings.length
    matrix = np.zeros((2, n, 3, 2, n, 3))
    matrix[0, symbolic.row, :, 0, symbolic.column, :] = sums[0]
    matrix[0, symbolic.row, :, 1, symbolic.column, :] = sums[1] * (length / speed)
    matrix = matrix.reshape(6 * n, 6 * n)
    matrix[3 * n :, : 3 * n] = np.eye(3 * n) * (speed / length)
    return matrix


def _in_balance(arrays, turning, times, place, tension):
    """The system with rest lengths at which tethers hold the beads at these places.

    Those that are states are changed in `place`.

    Of all tensions (m,) that do so as well as can be, those next to the given ones.
    """
    first, second = arrays.ends.T
    e = place[first] - place[second]
    length = np.linalg.norm(e, axis=1)
    pull, every = np.zeros((*place.shape, length.size)), np.arange(length.size)
    pull[first, :, every] = -e / length[:, None] * arrays.inv_mass[first][:, None]
    pull[second, :, every] = e / length[:, None] * arrays.inv_mass[second][:, None]
    yielding = np.flatnonzero(arrays.reel[:, ROW] >= 0.0)
    row = arrays.reel[yielding, ROW].astype(int)
    pull[row, 0, yielding] = arrays.inv_mass[row]
    pull = pull.reshape(-1, length.size)
    outside, slack = np.zeros_like(place), np.zeros(length.size, bool)
    for time in times:
        outside += turning.acceleration(arrays, slack, time, place) / times.size
    missing = -outside.ravel() - pull @ tension
    tension = tension + np.linalg.lstsq(pull, missing, rcond=1e-6)[0]
    there, slope = forces.tension_and_slopes(arrays, length, np.zeros_like(length))
    rest = arrays.rest + (there - tension) / slope
    place[row, 0] = rest[yielding]
    rest[yielding] = arrays.rest[yielding]
    return arrays._replace(rest=rest)


def wave_numbers(integrator: Integrator, vectors: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """Wave number of every vector (6 rows, k): how its phase changes from one place to the next.

    Turning the formation by 1/order of a circle and renaming its beads changes a mode of wave
    number k by the phase 2 pi k / order. Both directions count as one: 0 to order / 2.
    """
    symmetry = replace(cyclic_symmetry(integrator.system), axis=axis)
    if symmetry.order < 3:
        return np.full(vectors.shape[1], -1)
    steps = [vectors]
    for _ in range(symmetry.order - 1):
        steps.append(symmetry.back(False, steps[-1]))
    # The part of every wave number is the Fourier transform over the rotations.
    parts = np.fft.fft(np.array(steps), axis=0) / symmetry.order
    total = np.sum(np.abs(parts) ** 2, axis=1)
    folded = np.minimum(np.arange(symmetry.order), symmetry.order - np.arange(symmetry.order))
    share = np.array([np.sum(total[folded == k], axis=0) for k in range(symmetry.order // 2 + 1)])
    return np.argmax(share, axis=0)
