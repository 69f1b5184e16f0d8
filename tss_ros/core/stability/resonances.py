"""Which modes meet where a formation loses stability, and the condition that they meet.

Forces on a spinning formation change with the turn: gravity pulls twice a turn along the same
tether. Two modes whose frequencies add up to a multiple of the spin then feed each other; their
multipliers meet and leave the unit circle together. Out of the plane, where damping does not reach,
this ends the stability of rings.
"""

from __future__ import annotations

import math

import numpy as np

from tss_ros.core.arguments import checked
from tss_ros.core.model.system import System
from tss_ros.core.stability.mode_shapes import compute_modes
from tss_ros.core.stability.modes import LOST
from tss_ros.core.stability.result import FloquetResult

#: How far apart [turns] phases of multipliers may be that met.
SAME_PHASE = 1e-3
#: Multiples of the spin, in words.
TIMES = {1: "the spin", 2: "twice the spin"}


@checked
def name_resonance(system: System, result: FloquetResult) -> str:
    """The modes that resonate in an unstable motion and their condition, in words.

    Parameters
    ----------
    system : System
        That the result is of.
    result : FloquetResult

    Returns
    -------
    str
        "" if no multiplier leaves the circle.

    Raises
    ------
    TssError, IntegrationError
        As `compute_modes`.
    """
    leaving = result.deciding
    if result.verdict != "unstable" or leaving < 0:
        return ""
    modes = compute_modes(system, result)
    mode, partner = modes[leaving], _partner(modes, leaving)
    rho = mode.multiplier
    if partner is None:
        return f"{mode.in_words}: {_alone(rho)}"
    how, cycles = "add up to", mode.frequency + partner.frequency
    if abs(cycles - round(cycles)) > 2.0 * SAME_PHASE:
        how, cycles = "differ by", abs(mode.frequency - partner.frequency)
    if round(cycles) == 0:
        return f"{mode.in_words}: {_alone(rho)}"
    multiple = TIMES.get(round(cycles), f"{round(cycles)} times the spin")
    if _kind(mode) == _kind(partner):
        return f"{mode.in_words}: twice its frequency is {multiple}"
    return f"{mode.in_words} and {partner.in_words}: frequencies {how} {multiple}"


def _kind(mode):
    return mode.family, mode.direction, mode.wave_number, round(mode.frequency, 3)


def _partner(modes, leaving):
    """The other mode of the resonance: of the same phase, as far inside as this one is outside."""
    rho = np.array([mode.multiplier for mode in modes])
    same = np.abs(np.angle(rho / rho[leaving])) < 2.0 * math.pi * SAME_PHASE
    same &= np.array([mode.direction == modes[leaving].direction for mode in modes])
    same &= (np.abs(rho) < 1.0) & (np.abs(rho) > LOST)
    if not same.any():
        return None
    farther = np.abs(np.log(np.abs(rho[same] * rho[leaving])))
    return modes[np.flatnonzero(same)[np.argmin(farther)]]


def _alone(rho):
    if abs(rho.imag) > abs(rho) * SAME_PHASE:
        return "a pair of multipliers leaves by itself"
    return "divergence, a real multiplier above 1" if rho.real > 0.0 else "the period doubles"
