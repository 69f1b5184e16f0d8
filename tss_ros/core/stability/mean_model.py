"""The modes of a formation with its forces averaged over a turn.

In the turning frame a formation hardly moves. What a small displacement does there, averaged over
the turn, is a linear system with constant coefficients, whose modes have frequencies, wave numbers
and shapes of their own: those of rings and chains under mean tension. The gravity gradient, which
turns against that frame, changes each of them a little and lets two of them meet in a resonance.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from tss_ros.core.model import forces
from tss_ros.core.model.frames import to_turning_frame
from tss_ros.core.model.symmetry import cyclic_symmetry
from tss_ros.core.model.system import State
from tss_ros.core.motion.propagator import Integrator
from tss_ros.core.stability.modes import label, multipliers, stays_in_plane

#: Times of a turn over which forces are averaged.
SAMPLES = 24


@dataclass(frozen=True)
class MeanModes:
    """Modes of the averaged system.

    Attributes
    ----------
    exponent : ndarray, shape (6n,), complex
        [a turn] growth and, imaginary, 2 pi times frequency.
    vectors : ndarray, shape (6n, 6n), complex
        Columns in scaled coordinates.
    wave_number : ndarray, shape (6n,), int
        Around the formation; -1 where its cyclic symmetry is of an order below 3.
    family : ndarray, shape (6n,), str
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
    matrix = mean_matrix(integrator, state) * integrator.period_s
    exponent, vectors = multipliers(matrix, stays_in_plane(integrator.system, state))
    with np.errstate(over="ignore", under="ignore"):
        family = label(integrator, state, np.exp(exponent), vectors, exponent)
    return MeanModes(exponent, vectors, wave_numbers(integrator, vectors), family)


def mean_matrix(integrator: Integrator, state: State) -> np.ndarray:
    """Jacobian (6n, 6n) [1/s] of scaled coordinates in the turning frame, at the mean places.

    Tethers lie as they do on average and pull with their mean tension, changed by the little that
    keeps the beads there. To average the Jacobian itself would stiffen tethers that sway.
    """
    system, symbolic, n = integrator.system, integrator.symbolic, integrator.system.n
    times = integrator.period_s / SAMPLES * np.arange(SAMPLES)
    samples, motion = integrator.samples(times), integrator.begin(state)
    integrator.advance(motion, integrator.period_s, samples=samples)
    _, tension, taut = forces.tether_state(system, samples.r, samples.v)
    for time, v, r in zip(times, samples.v, samples.r):
        to_turning_frame(integrator.arrays.spin, time, v, r)
    place, still = np.mean(samples.r, axis=0), np.zeros((n, 3))
    arrays = _in_balance(integrator.arrays, times, place, np.mean(tension, axis=0))
    pulls = np.mean(taut, axis=0) + system.bilateral > 0.5
    by_v, by_r, *sums = np.zeros((4, symbolic.row.size, 3, 3))
    for time in times:
        forces.jacobian(arrays, symbolic.pair, pulls, time, still, place, by_r, by_v)
        sums[0] += by_v / SAMPLES
        sums[1] += by_r / SAMPLES
    speed, length = integrator.settings.speed, integrator.settings.length
    matrix = np.zeros((2, n, 3, 2, n, 3))
    matrix[0, symbolic.row, :, 0, symbolic.column, :] = sums[0]
    matrix[0, symbolic.row, :, 1, symbolic.column, :] = sums[1] * (length / speed)
    matrix = matrix.reshape(6 * n, 6 * n)
    matrix[3 * n :, : 3 * n] = np.eye(3 * n) * (speed / length)
    return matrix


def _in_balance(arrays, times, place, tension):
    """The system with rest lengths at which tethers hold the beads at these places.

    Of all tensions (m,) that do so as well as can be, those next to the given ones.
    """
    first, second = arrays.ends.T
    e = place[first] - place[second]
    length = np.linalg.norm(e, axis=1)
    pull, every = np.zeros((*place.shape, length.size)), np.arange(length.size)
    pull[first, :, every] = -e / length[:, None] * arrays.inv_mass[first][:, None]
    pull[second, :, every] = e / length[:, None] * arrays.inv_mass[second][:, None]
    pull = pull.reshape(-1, length.size)
    outside, still, a = np.zeros_like(place), np.zeros_like(place), np.empty_like(place)
    for time in times:
        forces.acceleration(arrays, np.zeros(length.size, bool), time, still, place, a)
        outside += a / times.size
    missing = -outside.ravel() - pull @ tension
    tension = tension + np.linalg.lstsq(pull, missing, rcond=1e-6)[0]
    there, slope = forces.tension_and_slopes(arrays, length, np.zeros_like(length))
    return arrays._replace(rest=arrays.rest + (there - tension) / slope)


def wave_numbers(integrator: Integrator, vectors: np.ndarray) -> np.ndarray:
    """Wave number of every vector (6n, k): how its phase changes from one place to the next.

    Turning the formation by 1/order of a circle and renaming its beads changes a mode of wave
    number k by the phase 2 pi k / order. Both directions count as one: 0 to order / 2.
    """
    symmetry = cyclic_symmetry(integrator.system)
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
