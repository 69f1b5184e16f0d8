"""What the modes behind Floquet multipliers are: direction, frequency, wave number and shape."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import linear_sum_assignment

from tss_ros.core.arguments import checked
from tss_ros.core.errors import TssError
from tss_ros.core.model.axes import spin_axis_of
from tss_ros.core.model.elements import require_autonomous
from tss_ros.core.model.frames import turn_about
from tss_ros.core.model.system import System
from tss_ros.core.motion.displacements import carry_displacements
from tss_ros.core.motion.integrator import Integrator
from tss_ros.core.presentation import Presented, a_turn, found
from tss_ros.core.stability.mean_model import mean_modes, wave_numbers
from tss_ros.core.stability.modes import (
    FAMILIES,
    LOST,
    NEAR_ONE,
    in_turning_frame,
    of_beads,
    stays_in_plane,
)
from tss_ros.core.stability.result import FloquetResult

DIRECTIONS = ("in plane", "out of plane", "mixed")
#: Accuracy of the motion that modes are told by.
RTOL = 1e-9
#: Times of a turn at which a mode's phase is looked at; the least modulus of a multiplier whose
#: mode is counted, and the least share of its largest part that the mode keeps.
COUNTS, COUNTABLE, CLEAR = 32, 1e-3, 0.05


@dataclass(frozen=True, repr=False)
class Mode(Presented):
    """The mode behind one multiplier.

    Attributes
    ----------
    multiplier : complex
    family : str
        One of `FAMILIES`.
    direction : str
        One of `DIRECTIONS`: where beads move to, seen from the plane across the spin axis, the
        orbit plane if that is its normal.
    frequency : float
        [cycles a turn] in the frame that turns with the formation. The multiplier tells it up to
        whole cycles and the mode of the mean forces how many. NaN if the multiplier is lost in
        rounding. Of the centre of mass it is that in the orbit frame. A formation that hangs turns
        once an orbit: it is the frequency over Omega there, from the exponents.
    wave_number : int
        Waves around the formation, from 0 to half the order of its cyclic symmetry; -1 if that
        order is below 3.
    shape : ndarray, shape (n, 3), complex
        Displacements at the start of the turn, the largest of size 1. They oscillate as the real
        part of `shape` times exp(2 pi i frequency t / T), and grow by the modulus of the
        multiplier a turn.
    hangs : bool
        Whether the formation hangs, whose turn is an orbit.
    """

    multiplier: complex
    family: str
    direction: str
    frequency: float
    wave_number: int
    shape: np.ndarray
    hangs: bool = False

    @property
    def in_words(self) -> str:
        """E.g. "axis tilt (k = 1, 0.775 a turn)"."""
        either = self.family in (FAMILIES[3], FAMILIES[4])
        where = f"{self.direction.replace(' ', '-')} " if either else ""
        known = [f"k = {self.wave_number}"] if self.wave_number >= 0 else []
        if not math.isnan(self.frequency):
            known.append(f"{self.frequency:.3f} {a_turn(not self.hangs)}")
        return f"{where}{self.family}" + (f" ({', '.join(known)})" if known else "")

    def _headline(self):
        return f"{self.in_words}: ρ = {self.multiplier:.6g}, |ρ| = {abs(self.multiplier):.6f}"

    def _facts(self):
        return {
            "family": self.family,
            "direction": self.direction,
            "multiplier": f"{self.multiplier:.8g}, modulus {abs(self.multiplier):.8f}",
            "frequency": f"{self.frequency:.6g} {a_turn(not self.hangs)}",
            "wave number": self.wave_number if self.wave_number >= 0 else "-",
        }


@checked
def compute_modes(system: System, result: FloquetResult) -> list[Mode]:
    """The modes behind the multipliers of a result, in their order.

    Multipliers are paired, family by family, with the modes of the forces averaged over the turn:
    with those whose shape and phase after a turn are nearest. How often a mode oscillates in a turn
    is counted along it, as its part in that of the mean forces goes round.

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
        If the result is of another system, or not of the motion.
    IntegrationError
        If its motion cannot be continued.
    """
    if not result.family:
        return []
    integrator = _integrator(system, result)
    rho, axis = result.multiplier, spin_axis_of(system, result.state, integrator.spin)
    vectors = in_turning_frame(integrator, axis, result.vectors)
    family = np.array(result.family)
    if result.exponent.size:
        frequency = np.abs(result.exponent.imag) * integrator.period_s / (2.0 * math.pi)
        wave_number = wave_numbers(integrator, vectors, axis)
    else:
        mean = mean_modes(integrator, result.state)
        paired = _pairs(integrator, result, mean, vectors, axis)
        frequency = _frequencies(integrator, result, mean, paired)
        wave_number = mean.wave_number[paired]
    position = of_beads(integrator, vectors)[1]
    above = _above(vectors, axis)
    kinds = np.where(above > 0.5, DIRECTIONS[1], DIRECTIONS[0])
    if not stays_in_plane(system, result.state):
        kinds[(above > 0.01) & (above < 0.99)] = DIRECTIONS[2]
    return [
        Mode(
            complex(rho[k]),
            str(family[k]),
            str(kinds[k]),
            float(frequency[k]),
            int(wave_number[k]),
            position[:, :, k] * _to_size_one(position[:, :, k]),
            not result.spin_rate_ratio,
        )
        for k in range(rho.size)
    ]


def _integrator(system, result):
    require_autonomous(system, "the shapes of modes")
    if result.method != "monodromy" and not result.exponent.size:
        raise TssError(f"modes are those of the motion, but the result's method is {result.method}")
    size = np.max(np.linalg.norm(result.state.position_m, axis=1))
    axis = spin_axis_of(system, result.state, result.spin_rate_rad_s)
    integrator = Integrator(system, result.spin_rate_rad_s, RTOL, size)
    if len(result.vectors) != 6 * integrator.rows:
        raise TssError(
            f"the result has vectors of {len(result.vectors) // 6} beads and reels that yield, the"
            f" system has {integrator.rows}"
        )
    return integrator.driven(result.spin_loss, axis)


def _above(vectors, axis):
    """Share of every vector's motion that is along the spin axis."""
    parts = vectors.reshape(-1, 3, vectors.shape[1])
    along = np.sum(np.abs(np.einsum("q,iqk->ik", axis, parts)) ** 2, axis=0)
    return along / np.sum(np.abs(parts) ** 2, axis=(0, 1))


@dataclass(frozen=True, repr=False)
class ModeMotion(Presented):
    """A mode along one turn, in the frame that turns with the formation.

    Attributes
    ----------
    turns : ndarray, shape (k,)
        Times from 0 to 1, over the period.
    position_m : ndarray, shape (k, n, 3)
        Undisturbed positions [m].
    shape : ndarray, shape (k, n, 3), complex
        Displacements, the largest at the start of size 1. A turn later they are the same times the
        multiplier.
    multiplier : complex
    family : str
        One of `FAMILIES`.
    tether_ends : ndarray, shape (m, 2), int
        As of the system.
    spins_about : ndarray, shape (3,), or None
        Unit vector of the spin's axis in the orbit frame; None if the formation hangs, whose turn
        is an orbit.
    """

    turns: np.ndarray
    position_m: np.ndarray
    shape: np.ndarray
    multiplier: complex
    family: str
    tether_ends: np.ndarray
    spins_about: np.ndarray | None

    def plot(self) -> Any:
        """The mode in the turning formation, `plots.mode_shape`, a Matplotlib figure."""
        plots = found("tss_ros.plots", "plot")
        return plots.mode_shape(plots.shown_motion(self))

    def _headline(self):
        along = a_turn(self.spins_about is not None)
        return f"{self.family} along {along}: |ρ| = {abs(self.multiplier):.6f}"

    def _facts(self):
        return {
            "family": self.family,
            "multiplier": f"{self.multiplier:.8g}, modulus {abs(self.multiplier):.8f}",
            "samples": len(self.turns),
            "beads": self.position_m.shape[1],
        }


@checked
def mode_motion(system: System, result: FloquetResult, which: int, samples: int = 48) -> ModeMotion:
    """How the mode behind one multiplier moves along the turn.

    Parameters
    ----------
    system : System
        That the result is of.
    result : FloquetResult
    which : int
        Index of the multiplier, e.g. `FloquetResult.deciding`.
    samples : int
        In the turn; its end is added.

    Returns
    -------
    ModeMotion

    Raises
    ------
    TssError
        If there is no such multiplier, or the result is of another system.
    IntegrationError
        If its motion cannot be continued.
    """
    if not 0 <= which < len(result.family):
        raise TssError(f"the result has {len(result.family)} multipliers, none of index {which}")
    integrator = _integrator(system, result)
    vector = result.vectors[:, which : which + 1]
    if result.exponent.size:
        turns = np.arange(samples + 1)[:, None, None] / samples
        place = np.tile(result.state.position_m, (samples + 1, 1, 1))
        carried = np.exp(result.exponent[which] * integrator.period_s * turns) * vector
    else:
        place, carried = _carried(integrator, result.state, vector, samples)
    shape = carried.reshape(samples + 1, 2, integrator.rows, 3)[:, 1, : system.n]
    return ModeMotion(
        np.arange(samples + 1) / samples, place, shape * _to_size_one(shape[0]),
        complex(result.multiplier[which]), result.family[which], system.tether_ends,
        system.spin_axis if result.spin_rate_ratio else None,
    )  # fmt: skip


def _carried(integrator, state, vectors, samples):
    """Positions (s + 1, n, 3) and vectors (s + 1, 6 rows, k) carried along the turn from a state.

    As seen in the frame that turns with the spin.
    """
    motion, axis = integrator.begin(state), spin_axis_of(integrator.system, state, integrator.spin)
    n, carried = integrator.system.n, [in_turning_frame(integrator, axis, vectors)]
    place = [motion.r[:n].copy()]
    spin = 0.0 if integrator.arrays.spin else integrator.spin
    parts = np.concatenate([vectors.real, vectors.imag], axis=1)
    for k in range(1, samples + 1):
        stop = integrator.period_s * k / samples
        motion, parts = carry_displacements(integrator, motion, parts, stop)
        real, imaginary = np.split(parts, 2, axis=1)
        turn = turn_about(axis, spin * stop)
        turned = turn.T @ (real + 1j * imaginary).reshape(2, integrator.rows, 3, -1)
        place.append(motion.r[:n] @ turn)
        carried.append(in_turning_frame(integrator, axis, turned.reshape(vectors.shape)))
    return np.array(place), np.array(carried)


def _frequencies(integrator, result, mean, paired):
    """Cycles a turn (k,) of the multipliers' modes, alike for complex conjugates."""
    rho, family = result.multiplier, np.array(result.family)
    about = _counted(integrator, result, mean, paired)
    about[family == FAMILIES[1]] = 0.0
    centre = family == FAMILIES[0]
    about[centre] = (np.abs(rho[centre] - 1.0) > NEAR_ONE) / abs(result.spin_rate_ratio)
    cycles = np.angle(rho) / (2.0 * math.pi)
    either = [cycles + np.round(sign * about - cycles) for sign in (1.0, -1.0)]
    nearer = np.argmin([np.abs(np.abs(f) - np.abs(about)) for f in either], axis=0)
    frequency = np.abs(np.choose(nearer, either))
    frequency[np.abs(rho) <= LOST] = math.nan
    for k in np.flatnonzero(rho.imag < 0.0):
        alike = np.flatnonzero((family == family[k]) & (rho.imag > 0.0))
        if alike.size:
            frequency[k] = frequency[alike[np.argmin(np.abs(rho[alike].conj() - rho[k]))]]
    return frequency


def _counted(integrator, result, mean, paired):
    """Signed frequencies (k,) by counting; those of the mean forces where counts mean nothing."""
    frequency = mean.frequency[paired]
    rho = result.multiplier
    counted = np.isin(result.family, FAMILIES[2:]) & (np.abs(rho) > COUNTABLE)
    counted &= (rho.imag >= 0.0) & (np.abs(frequency) < COUNTS / 4)
    if not counted.any():
        return frequency
    _, carried = _carried(integrator, result.state, result.vectors[:, counted], COUNTS)
    weight = np.tile(np.repeat(1.0 / integrator.arrays.inv_mass, 3), 2)[:, None]
    part = np.sum((weight * mean.vectors[:, paired[counted]]).conj() * carried, axis=1)
    part *= np.abs(rho[counted]) ** -(np.arange(COUNTS + 1)[:, None] / COUNTS)
    angle = np.unwrap(np.angle(part), axis=0)
    clear = np.min(np.abs(part), axis=0) > CLEAR * np.max(np.abs(part), axis=0)
    cycles = (angle[-1] - angle[0]) / (2.0 * math.pi)
    frequency[counted] = np.where(clear, cycles, frequency[counted])
    return frequency


def _pairs(integrator, result, mean, vectors, axis):
    """The mode of the mean forces (k,) that each multiplier belongs to."""
    weight = np.tile(np.repeat(integrator.arrays.inv_mass**-0.5, 3), 2)[:, None]

    def units(vectors):
        weighted = vectors * weight
        return weighted / np.linalg.norm(weighted, axis=0)

    alike = np.abs(units(mean.vectors).conj().T @ units(vectors)) ** 2
    rho = np.where(np.abs(result.multiplier) > LOST, result.multiplier, LOST)
    phase = np.angle(np.exp(1j * (mean.exponent.imag[:, None] - np.angle(rho)))) / math.pi
    size = np.abs(np.maximum(mean.exponent.real[:, None], math.log(LOST)) - np.log(np.abs(rho)))
    cost = (1.0 - alike) + np.abs(phase) + np.minimum(size, 1.0)
    family, above, also = np.array(result.family), _above(vectors, axis), _above(mean.vectors, axis)
    # Another family or direction is taken only where its own has none left.
    cost += 10.0 * (mean.family[:, None] != family)
    cost += 10.0 * np.abs(also[:, None] - above)
    rows, columns = linear_sum_assignment(cost)
    return rows[np.argsort(columns)]


def _to_size_one(shape):
    """The factor that makes a shape's largest displacement real and of size 1."""
    largest = np.unravel_index(np.argmax(np.abs(shape)), shape.shape)
    size = max(np.max(np.linalg.norm(shape, axis=1)), 1e-300)
    return np.exp(-1j * np.angle(shape[largest])) / size
