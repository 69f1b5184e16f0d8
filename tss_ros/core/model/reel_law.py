"""The reels of a system that give way to tension, `laws.reel`, as its kernels need them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tss_ros.core.errors import TssError
from tss_ros.core.model.configurations import averaged_state
from tss_ros.core.model.contract import ReelLaw
from tss_ros.core.model.elements import on_mean_circle
from tss_ros.core.model.equilibria import equilibrium
from tss_ros.core.model.forces import tether_state
from tss_ros.core.model.kernel_arrays import AIM, ROW, KernelArrays
from tss_ros.core.model.laws import REEL_LAWS
from tss_ros.core.model.laws.reel import REEL_MASS, REEL_TENSION
from tss_ros.core.model.reels import reels
from tss_ros.core.model.system import State, System


def acting_reel_laws(system: System) -> tuple[ReelLaw, ...]:
    """The laws by which reels follow the tension of their tethers."""
    return tuple(law for law in REEL_LAWS if system.law_parameters[law.parameters[0].name])


def what_yields(system: System) -> str:
    """The parameters that let reels follow tension, for words."""
    return ", ".join(law.parameters[0].name for law in acting_reel_laws(system))


def reels_that_yield(system: System) -> np.ndarray:
    """Segments (p,) next to reels that follow tension: of every whole tether one, or none at all.

    Their rest lengths are states of the system.
    """
    if not acting_reel_laws(system):
        return np.empty(0, dtype=np.int64)
    return np.array([reel.segments[0] for reel in reels(system)], dtype=np.int64)


def with_fixed_reels(system: System) -> System:
    """The same system with reels that do not yield."""
    acting = {law.parameters[0].name: 0.0 for law in acting_reel_laws(system)}
    if not acting:
        return system
    return replace(system, law_parameters=system.law_parameters | acting)


def reel_tension_n(system: System, spin_rate_ratio: float) -> np.ndarray:
    """T_0 [N] of each reel's law, shape (p,).

    On an orbit that is no circle the steady tension is that of the circle with its mean motion.

    Raises
    ------
    NoSteadyState
        If it is to be the steady tension, but there is no steady shape.
    """
    given, moving = system.law_parameters[REEL_TENSION.name], reels_that_yield(system)
    if given:
        return np.full(moving.size, given)
    circle = system if system.autonomous else on_mean_circle(system)
    if spin_rate_ratio:
        place = averaged_state(circle, spin_rate_ratio).position_m
    else:
        place = equilibrium(circle)
    # Shapes of both kinds are rigid: no tether has a rate of its own.
    return tether_state(system, place, np.zeros_like(place))[1][moving]


def pull_per_metre(system: System, spin_rate_ratio: float) -> float:
    """T/L [N/m], how much harder a longer tether pulls in a turn: the largest of all reels'.

    Raises
    ------
    NoSteadyState
        If there is no steady shape.
    """
    place = averaged_state(system, spin_rate_ratio).position_m
    tension_n = tether_state(system, place, np.zeros_like(place))[1][reels_that_yield(system)]
    lengths_m = [np.sum(system.rest_length_m[list(reel.segments)]) for reel in reels(system)]
    return float(np.max(tension_n / lengths_m))


def with_reels(arrays: KernelArrays, system: System, spin_rate_rad_s: float) -> KernelArrays:
    """The arrays with the rest lengths that are states, if the system has such reels.

    Parameters
    ----------
    arrays : KernelArrays
    system : System
    spin_rate_rad_s : float
        omega [rad/s] at whose steady tension they pay out nothing; 0 for a formation that hangs.

    Raises
    ------
    NoSteadyState
        If there is no steady shape to tell the tension.
    """
    moving = reels_that_yield(system)
    if not moving.size:
        return arrays
    mass, rows = system.law_parameters[REEL_MASS.name], moving.size
    reel = np.zeros((system.m, 6))
    reel[:, 0], reel[:, ROW] = system.rest_length_m, -1.0
    reel[moving, ROW] = system.n + np.arange(rows)
    reel[moving, AIM] = reel_tension_n(system, spin_rate_rad_s / system.orbit_rate_rad_s)
    padded = {}
    if arrays.satellite.size:
        padded["satellite"] = np.append(arrays.satellite, np.zeros(rows))
    if arrays.shape.size:
        padded["shape"] = np.append(arrays.shape, np.zeros((rows, 3)), axis=0)
    return arrays._replace(
        inv_mass=np.append(arrays.inv_mass, np.full(rows, 1.0 / mass)),
        reel=reel,
        reeling=sum(1 << REEL_LAWS.index(law) for law in acting_reel_laws(system)),
        **padded,
    )


def rows_of(system: System, state: State) -> tuple[np.ndarray, np.ndarray]:
    """Velocities and positions (rows, 3) of a state with its rest lengths, as kernels have them.

    Raises
    ------
    TssError
        If it has rest lengths of another number of reels.
    """
    v, r = state.velocity_m_s, state.position_m
    moving = reels_that_yield(system)
    length, rate = state.reel_length_m, state.reel_rate_m_s
    if not length.size:
        length, rate = system.rest_length_m[moving], np.zeros(moving.size)
    if length.size != moving.size:
        raise TssError(
            f"a state of this system has {moving.size} rest lengths of reels that follow tension,"
            f" got {length.size}"
        )
    if not moving.size:
        return v, r
    rows = np.zeros((2, moving.size, 3))
    rows[0, :, 0], rows[1, :, 0] = rate, length
    return np.concatenate([v, rows[0]]), np.concatenate([r, rows[1]])


def state_of(system: System, v: np.ndarray, r: np.ndarray) -> State:
    """The inverse of `rows_of`."""
    n = system.n
    return State(r[:n], v[:n], reel_length_m=r[n:, 0], reel_rate_m_s=v[n:, 0])


def rests_in_rows(system: System, v: np.ndarray, r: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rest lengths [m] and their rates [m/s] of all segments, (..., m), from rows of the kernels.

    Parameters
    ----------
    system : System
    v, r : ndarray, shape (..., rows, 3)
        Rates and states, `KernelArrays.beads`.
    """
    rest = np.tile(system.rest_length_m, (*r.shape[:-2], 1))
    rate, moving = np.zeros_like(rest), reels_that_yield(system)
    rest[..., moving], rate[..., moving] = r[..., system.n :, 0], v[..., system.n :, 0]
    return rest, rate
