"""Formations of the literature: rings, chains, hub-and-spoke, closed hub-and-spoke, double pyramid.

Every formation is made of satellites and the tethers between them. A tether may be cut by beads
that carry its mass; its segments then take its name (section 2.1 of the paper, Fig. 1).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tss_ros.core.arguments import finite, unit_vector
from tss_ros.core.errors import TssError, near_match
from tss_ros.core.model.frames import turn_to
from tss_ros.core.model.laws import TETHER_LAWS
from tss_ros.core.model.parameters import named_perturbations
from tss_ros.core.model.system import ORBIT_NORMAL, System

#: Most beads, satellites included, that a system may have.
MOST_BEADS = 20_000


@dataclass(frozen=True)
class Satellite:
    """A satellite of a formation: its mass [kg] and its place [m] in the nominal shape."""

    name: str
    mass_kg: float
    position_m: tuple[float, float, float]


@dataclass(frozen=True)
class Tether:
    """A tether between two satellites, cut into len(bead_mass_kg) + 1 segments.

    Attributes
    ----------
    name : str
    ends : tuple of two int
        Indices of the satellites it joins.
    length_m, axial_stiffness_n, damping_n_s_per_m : tuple of float
        Rest length L, EA and C of every segment.
    bead_mass_kg : tuple of float
    """

    name: str
    ends: tuple[int, int]
    length_m: tuple[float, ...]
    axial_stiffness_n: tuple[float, ...]
    damping_n_s_per_m: tuple[float, ...]
    bead_mass_kg: tuple[float, ...] = ()


def assemble(
    satellites: Sequence[Satellite],
    tethers: Sequence[Tether],
    orbit_altitude_m: float = 1.0e6,
    linear_gravity: bool = False,
    bilateral: bool = False,
    tether_law: str = TETHER_LAWS[0].name,
    spin_axis: Sequence[float] = ORBIT_NORMAL,
    perturbations: Sequence[str] = (),
    **law_parameters: float,
) -> System:
    """Build the `System` of any tether graph.

    In a ring the beads are numbered along it, satellite 1, its tether's beads, satellite 2, ...,
    as in Eq. (4); otherwise the tether beads follow all satellites.

    Parameters
    ----------
    satellites : sequence of Satellite
    tethers : sequence of Tether
    orbit_altitude_m, linear_gravity, bilateral, tether_law, spin_axis, **law_parameters
        See `System`.
    perturbations : sequence of str
        Names of `laws.PERTURBATIONS` that act, with typical strengths if no others are given.

    Returns
    -------
    System

    Raises
    ------
    TssError
        If the graph or a value is not physical.
    """
    _check(satellites, tethers)
    count = len(satellites)
    cyclic = [t.ends for t in tethers] == [(i, (i + 1) % count) for i in range(count)]
    names, is_satellite, masses, places = [], [], [], []

    def add(*bead):
        for values, value in zip((names, is_satellite, masses, places), bead):
            values.append(value)
        return len(names) - 1

    def add_beads(tether):
        first, last = (np.asarray(satellites[end].position_m, float) for end in tether.ends)
        along = np.cumsum(tether.length_m) / np.sum(tether.length_m)
        return [
            add(f"{tether.name}_bead_{j + 1}", False, mass, first + along[j] * (last - first))
            for j, mass in enumerate(tether.bead_mass_kg)
        ]

    place_of, inner = [], []
    for i, satellite in enumerate(satellites):
        place_of.append(add(satellite.name, True, satellite.mass_kg, satellite.position_m))
        if cyclic:
            inner.append(add_beads(tethers[i]))
    if not cyclic:
        inner = [add_beads(tether) for tether in tethers]
    segment_names, ends = _segments(tethers, place_of, inner)
    return System(
        tuple(names),
        is_satellite,
        masses,
        tuple(segment_names),
        np.array(ends, dtype=np.int64).reshape(-1, 2),
        *(
            [value for tether in tethers for value in getattr(tether, field)]
            for field in ("length_m", "axial_stiffness_n", "damping_n_s_per_m")
        ),
        places,
        orbit_altitude_m,
        linear_gravity,
        bilateral,
        tether_law,
        named_perturbations(perturbations, law_parameters),
        spin_axis,
    )


def _check(satellites, tethers):
    """Raise TssError unless these are satellites, and tethers that join them."""
    for name, parts, kind in (("satellites", satellites, Satellite), ("tethers", tethers, Tether)):
        if not isinstance(parts, Sequence) or not all(isinstance(part, kind) for part in parts):
            words = f"{name} must be a sequence of {kind.__name__}s"
            raise TssError(f"{words}, got {type(parts).__name__} {parts!r:.80}")
    for tether in tethers:
        for end in tether.ends:
            if not 0 <= end < len(satellites):
                raise TssError(f"tether {tether.name!r} joins satellite {end}, which is not there")


def _segments(tethers, place_of, inner):
    """Names of all segments, and the two beads that each joins, Eq. (4)."""
    names, ends = [], []
    for tether, beads in zip(tethers, inner):
        path = [place_of[tether.ends[0]], *beads, place_of[tether.ends[1]]]
        cut = len(path) > 2
        for j in range(len(path) - 1):
            names.append(f"{tether.name}_segment_{j + 1}" if cut else tether.name)
            ends.append((path[j], path[j + 1]))
    return names, ends


#: The formations, by name: the fewest satellites each makes sense with (the hub is extra).
FORMATIONS = {
    "ring": 3,
    "chain": 2,
    "hub_and_spoke": 2,
    "closed_hub_and_spoke": 3,
    "double_pyramid": 3,
}

_EXTRA_MASSES = {"hub_and_spoke": 1, "closed_hub_and_spoke": 1, "double_pyramid": 2}


#: Table 1: masses [kg], tether length [m], EA [N] and altitude [m]. It states no damping; with this
#: one [N s/m] tethers of the 3-star first go slack at the paper's critical rate.
MASS_KG, BEAD_MASS_KG = 100.0, 10.0
LENGTH_M, STIFFNESS_N, ALTITUDE_M = 1.0e4, 5.0e4, 1.0e6
DAMPING_N_S_PER_M = 1450.0
#: One value for all, or several.
Values = "float | Sequence[float]"


def formation(
    shape: str,
    satellites: int = 3,
    *,
    satellite_mass_kg: Values = MASS_KG,
    tether_length_m: Values = LENGTH_M,
    axial_stiffness_n: Values = STIFFNESS_N,
    damping_n_s_per_m: Values = DAMPING_N_S_PER_M,
    beads_per_tether: int | Sequence[int] = 0,
    bead_mass_kg: Values = BEAD_MASS_KG,
    orbit_altitude_m: float = ALTITUDE_M,
    linear_gravity: bool = False,
    bilateral: bool = False,
    tether_law: str = TETHER_LAWS[0].name,
    spin_axis: Sequence[float] = ORBIT_NORMAL,
    perturbations: Sequence[str] = (),
    **law_parameters: float,
) -> System:
    """Build one of the named formations; the defaults are Table 1.

    Parameters
    ----------
    shape : str
        "ring": satellites joined into a closed loop. "chain": an open line through the centre.
        "hub_and_spoke": a hub (the first mass) with a tether to each satellite around it.
        "closed_hub_and_spoke": the same, and the satellites joined into a ring; the spokes come
        first in every list. "double_pyramid": a ring and two apexes (the last masses) on the spin
        axis, each tethered to every ring satellite; ring tethers first, then upper, then lower.
    satellites : int
        Number of satellites; hub and apexes not counted.
    satellite_mass_kg : float or sequence
        [kg] one for all, or one per mass, hub and apexes included.
    tether_length_m : float or sequence
        [m] rest length: one for all, one per tether (shared equally by its segments), or one per
        segment.
    axial_stiffness_n : float or sequence
        EA [N]: one for all, one per tether, or one per segment.
    damping_n_s_per_m : float or sequence
        C [N s/m] from end to end: one for all or one per tether (each of its k segments in series
        then has k times as much, so that cutting a tether finer does not change it), or one per
        segment.
    beads_per_tether : int or sequence
        One for all or one per tether.
    bead_mass_kg : float or sequence
        [kg] one for all, one per tether (of each of its beads), or one per bead.
    orbit_altitude_m, linear_gravity, bilateral, tether_law, perturbations, **law_parameters
        See `assemble`.
    spin_axis : sequence of float
        See `System`; the formation is built about it.

    Returns
    -------
    System

    Raises
    ------
    TssError
        Naming the parameter, its value and what is allowed.
    """
    if shape not in FORMATIONS:
        known = f"{', '.join(FORMATIONS)}, got {shape!r}{near_match(shape, FORMATIONS)}"
        raise TssError(f"formation must be one of {known}")
    count = _whole("satellites", satellites, FORMATIONS[shape], MOST_BEADS)
    graph = _graph(shape, count)
    spread = _spread("beads_per_tether", beads_per_tether, {"tether": [1] * len(graph)})
    beads = [_whole("beads_per_tether", value, 0, MOST_BEADS) for value in spread]
    masses = count + _EXTRA_MASSES.get(shape, 0)
    _whole("satellites and beads_per_tether together", masses + sum(beads), 1, MOST_BEADS)
    mass = _spread("satellite_mass_kg", satellite_mass_kg, {"satellite": [1] * masses}, above=0.0)
    by_segment = {"tether": [b + 1 for b in beads]}
    stiffness = _spread("axial_stiffness_n", axial_stiffness_n, by_segment, above=0.0)
    damping = _spread("damping_n_s_per_m", damping_n_s_per_m, by_segment, series=1, at_least=0.0)
    lengths = _spread("tether_length_m", tether_length_m, by_segment, series=-1, above=0.0)
    bead_mass = _spread("bead_mass_kg", bead_mass_kg, {"tether": beads}, above=0.0)
    tethers = _tethers(graph, beads, (lengths, stiffness, damping), bead_mass)
    total = [math.fsum(tether.length_m) for tether in tethers]
    places, names = _shape(shape, count, total, unit_vector("spin_axis", spin_axis))
    nodes = [Satellite(*node) for node in zip(names, mass, places)]
    chosen = linear_gravity, bilateral, tether_law, spin_axis, perturbations
    return assemble(nodes, tethers, orbit_altitude_m, *chosen, **law_parameters)


def ring(
    satellites: int = 3,
    *,
    satellite_mass_kg: Values = MASS_KG,
    tether_length_m: Values = LENGTH_M,
    axial_stiffness_n: Values = STIFFNESS_N,
    damping_n_s_per_m: Values = DAMPING_N_S_PER_M,
    beads_per_tether: int | Sequence[int] = 0,
    bead_mass_kg: Values = BEAD_MASS_KG,
    orbit_altitude_m: float = ALTITUDE_M,
    linear_gravity: bool = False,
    bilateral: bool = False,
    tether_law: str = TETHER_LAWS[0].name,
    spin_axis: Sequence[float] = ORBIT_NORMAL,
    perturbations: Sequence[str] = (),
    **law_parameters: float,
) -> System:
    """Build a ring of n satellites, the paper's formation, Eq. (48); see `formation`."""
    return formation(
        "ring",
        satellites,
        satellite_mass_kg=satellite_mass_kg,
        tether_length_m=tether_length_m,
        axial_stiffness_n=axial_stiffness_n,
        damping_n_s_per_m=damping_n_s_per_m,
        beads_per_tether=beads_per_tether,
        bead_mass_kg=bead_mass_kg,
        orbit_altitude_m=orbit_altitude_m,
        linear_gravity=linear_gravity,
        bilateral=bilateral,
        tether_law=tether_law,
        spin_axis=spin_axis,
        perturbations=perturbations,
        **law_parameters,
    )


def _tethers(graph, beads, by_segment, bead_mass):
    """The tethers of a graph, from values by segment (lengths, EA, C) and the masses of beads."""
    tethers, segment, bead = [], 0, 0
    for k, (ends, inner) in enumerate(zip(graph, beads)):
        own = slice(segment, segment + inner + 1)
        values = (tuple(value[own]) for value in by_segment)
        tethers.append(
            Tether(f"tether_{k + 1}", ends, *values, tuple(bead_mass[bead : bead + inner]))
        )
        segment, bead = own.stop, bead + inner
    return tethers


def _graph(shape, n):
    loop = [(i, (i + 1) % n) for i in range(n)]
    if shape == "ring":
        return loop
    if shape == "chain":
        return [(i, i + 1) for i in range(n - 1)]
    spokes = [(0, i + 1) for i in range(n)]
    if shape == "hub_and_spoke":
        return spokes
    if shape == "closed_hub_and_spoke":
        return spokes + [(i + 1, j + 1) for i, j in loop]
    return loop + [(i, n) for i in range(n)] + [(i, n + 1) for i in range(n)]


def _shape(shape, n, total, axis):
    """Nominal places [m] and names; about z satellite 1 is on the y axis as in Eq. (50)."""
    angle = math.pi / 2 + 2.0 * math.pi * np.arange(n) / n
    circle = np.stack([np.cos(angle), np.sin(angle), np.zeros(n)], axis=1)
    names = [f"satellite_{i + 1}" for i in range(n)]
    if shape == "chain":
        y = np.concatenate([[0.0], np.cumsum(total)])
        places = np.zeros((n, 3))
        places[:, 1] = y[-1] / 2.0 - y
    elif shape in ("hub_and_spoke", "closed_hub_and_spoke"):
        places = np.concatenate([np.zeros((1, 3)), np.array(total[:n])[:, None] * circle])
        names = ["hub", *names]
    else:
        radius = np.mean(total[:n]) / (2.0 * math.sin(math.pi / n))
        places = radius * circle
        if shape == "double_pyramid":
            slant = np.mean(total[n:])
            if slant <= radius:
                raise TssError(
                    f"tether_length_m of a double pyramid's apex tethers must exceed the ring's"
                    f" radius of {radius:g}, got {slant:g}"
                )
            height = math.sqrt(slant**2 - radius**2)
            places = np.concatenate([places, [[0.0, 0.0, height], [0.0, 0.0, -height]]])
            names = [*names, "apex_up", "apex_down"]
    return [tuple(place) for place in (np.array(places) @ turn_to(axis).T).tolist()], names


def _whole(name, value, least, most):
    number = finite(name, value)
    if number != int(number) or not least <= number <= most:
        raise TssError(f"{name} must be a whole number from {least} to {most}, got {value}")
    return int(number)


def _spread(name, values, owners, series=0, **bounds):
    """One value per part, from one for all, one per owner, or one per part.

    `owners` maps the owner's word to how many parts each of them has; an owner's value is given to
    its k parts times k ** series.
    """
    ((word, parts),) = owners.items()
    given = np.atleast_1d(np.asarray(values, dtype=object)).ravel()
    if given.size == 0:
        raise TssError(f"{name} must have at least one value, got none")
    numbers = [finite(name, value, **bounds) for value in given]
    total = sum(parts)
    if len(numbers) == total and total != len(parts):
        return numbers
    if len(numbers) == 1:
        numbers = numbers * len(parts)
    if len(numbers) != len(parts):
        allowed = f"1 or {len(parts)} values (one per {word})"
        if total != len(parts):
            allowed = f"1, {len(parts)} (one per {word}) or {total} values"
        raise TssError(f"{name} must have {allowed}, got {len(numbers)}")
    return [x * float(count) ** series for x, count in zip(numbers, parts) for _ in range(count)]
