"""What the modes behind Floquet multipliers are: direction, frequency, wave number and shape."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from tss_ros.core.errors import TssError
from tss_ros.core.model.system import System
from tss_ros.core.motion.propagator import Integrator
from tss_ros.core.stability.mean_model import mean_modes
from tss_ros.core.stability.modes import FAMILIES, LOST, NEAR_ONE, stays_in_plane
from tss_ros.core.stability.result import FloquetResult

DIRECTIONS = ("in plane", "out of plane", "mixed")
#: Accuracy of the motion that modes are told by.
RTOL = 1e-9


@dataclass(frozen=True)
class Mode:
    """The mode behind one multiplier.

    Attributes
    ----------
    multiplier : complex
    family : str
        One of `FAMILIES`.
    direction : str
        One of `DIRECTIONS`: where beads move to, seen from the orbit plane.
    frequency : float
        [cycles a turn] in the frame that turns with the formation. The multiplier tells it up to
        whole cycles and the mode of the mean forces how many. NaN if the multiplier is lost in
        rounding. Of the centre of mass it is that in the orbit frame.
    wave_number : int
        Waves around the formation, from 0 to half the order of its cyclic symmetry; -1 if that
        order is below 3.
    shape : ndarray, shape (n, 3), complex
        Displacements at the start of the turn, the largest of size 1. They oscillate as the real
        part of `shape` times exp(2 pi i frequency t / T), and grow by the modulus of the
        multiplier a turn.
    """

    multiplier: complex
    family: str
    direction: str
    frequency: float
    wave_number: int
    shape: np.ndarray

    @property
    def in_words(self) -> str:
        """E.g. "axis tilt (k = 1, 0.775 a turn)"."""
        where = f"{self.direction.replace(' ', '-')} " if self.family == FAMILIES[3] else ""
        known = [f"k = {self.wave_number}"] if self.wave_number >= 0 else []
        if not math.isnan(self.frequency):
            known.append(f"{self.frequency:.3f} a turn")
        return f"{where}{self.family}" + (f" ({', '.join(known)})" if known else "")


def compute_modes(system: System, result: FloquetResult) -> list[Mode]:
    """The modes behind the multipliers of a result, in their order.

    Multipliers are paired, family by family, with the modes of the forces averaged over the turn:
    with those whose shape and phase after a turn are nearest.

    Parameters
    ----------
    system : System
        That the result is of.
    result : FloquetResult

    Returns
    -------
    list of Mode
        Empty if it has no multipliers.

    Raises
    ------
    TssError
        If the result is of another system.
    IntegrationError
        If its motion cannot be continued.
    """
    if not result.family:
        return []
    integrator = _integrator(system, result)
    mean = mean_modes(integrator, result.state)
    rho, vectors = result.multiplier, result.vectors
    paired = _pairs(integrator, result, mean)
    frequency = np.full(rho.size, math.nan)
    alive = np.abs(rho) > LOST
    cycles = np.angle(rho) / (2.0 * math.pi)
    family = np.array(result.family)
    centre, spin = family == FAMILIES[0], family == FAMILIES[1]
    of_mean = mean.frequency[paired]
    of_mean[spin] = 0.0
    of_mean[centre] = (np.abs(rho[centre] - 1.0) > NEAR_ONE) / abs(result.spin_rate_ratio)
    frequency[alive] = (cycles + np.round(of_mean - cycles))[alive]
    position = vectors.reshape(2, system.n, 3, -1)[1]
    above = _above(vectors)
    kinds = np.where(above > 0.5, DIRECTIONS[1], DIRECTIONS[0])
    if not stays_in_plane(integrator, result.state):
        kinds[(above > 0.01) & (above < 0.99)] = DIRECTIONS[2]
    return [
        Mode(
            complex(rho[k]),
            str(family[k]),
            str(kinds[k]),
            float(abs(frequency[k])),
            int(mean.wave_number[paired[k]]),
            _of_size_one(position[:, :, k]),
        )
        for k in range(rho.size)
    ]


def _integrator(system, result):
    if result.vectors.shape[0] != 6 * system.n:
        raise TssError(
            f"the result has vectors of {result.vectors.shape[0] // 6} beads, the system has"
            f" {system.n}"
        )
    size = np.max(np.linalg.norm(result.state.position_m, axis=1))
    return Integrator(system, result.spin_rate_rad_s, RTOL, size)


def _above(vectors):
    """Share of every vector's motion that is out of the orbit plane."""
    square = np.abs(vectors.reshape(-1, 3, vectors.shape[1])) ** 2
    return np.sum(square[:, 2], axis=0) / np.sum(square, axis=(0, 1))


def _pairs(integrator, result, mean):
    """The mode of the mean forces (k,) that each multiplier belongs to."""
    weight = np.repeat(np.sqrt(integrator.system.mass_kg), 3)
    weight = np.concatenate([weight, weight])[:, None]

    def units(vectors):
        weighted = vectors * weight
        return weighted / np.linalg.norm(weighted, axis=0)

    alike = np.abs(units(mean.vectors).conj().T @ units(result.vectors)) ** 2
    rho = np.where(np.abs(result.multiplier) > LOST, result.multiplier, LOST)
    phase = np.angle(np.exp(1j * (mean.exponent.imag[:, None] - np.angle(rho)))) / math.pi
    size = np.abs(np.maximum(mean.exponent.real[:, None], math.log(LOST)) - np.log(np.abs(rho)))
    cost = (1.0 - alike) + np.abs(phase) + np.minimum(size, 1.0)
    family, above, also = np.array(result.family), _above(result.vectors), _above(mean.vectors)
    # Another family or direction is taken only where its own has none left.
    cost += 10.0 * (mean.family[:, None] != family)
    cost += 10.0 * np.abs(also[:, None] - above)
    rows, columns = linear_sum_assignment(cost)
    return rows[np.argsort(columns)]


def _of_size_one(shape):
    """A shape with its phase so that its largest displacement is real and of size 1."""
    largest = np.unravel_index(np.argmax(np.abs(shape)), shape.shape)
    turned = shape * np.exp(-1j * np.angle(shape[largest]))
    return turned / max(np.max(np.linalg.norm(turned, axis=1)), 1e-300)
