"""Reels, which pay out tethers and take them in, and the beads that are out or still on a reel.

A whole tether runs from one satellite to another and may be cut into segments. Its reel sits at the
first of the two. The length that is out fills the segments from the far end on: those next to the
far end have their whole rest length, one is being paid out, and the rest are on the reel together
with their beads, which ride with the satellite. What is paid out keeps EA and its material, so that
stiffness and damping change like 1/L.

A bead leaves the reel where the next segment is `SHARE_OUT` of its rest length long, and is taken
in there again.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from tss_ros.core.errors import TssError, index_of
from tss_ros.core.model.system import State, System

#: Share of its rest length at which the segment next to the reel is given a bead of its own.
SHARE_OUT = 1e-3
#: Least length [m] that a reel leaves out.
SHORTEST_M = 0.1
#: Shortest length [m] that a reel may be told to leave out.
LEAST_M = 2.0 * SHORTEST_M
#: Rest length [m] of a tether that is cut: it never becomes taut.
NEVER_M = 1e15


class Reel(NamedTuple):
    """A whole tether with its reel.

    Attributes
    ----------
    name : str
        Of the tether; of its first segment without "_segment_1" if it is cut.
    segments : tuple of int
        From the reel to the far end.
    beads : tuple of int
        The satellite that has the reel, the beads, and the satellite or junction at the far end.
    edges_m : tuple of float
        Length out at which segment 1, 2, ... from the far end is followed by the next one.
    """

    name: str
    segments: tuple[int, ...]
    beads: tuple[int, ...]
    edges_m: tuple[float, ...]

    def segments_out(self, length_m: float) -> int:
        """How many segments are out at a length [m], with the one that is being paid out."""
        return 1 + sum(length_m > edge for edge in self.edges_m)


def reels(system: System) -> tuple[Reel, ...]:
    """The whole tethers of a system, in the order of their first segments.

    Parameters
    ----------
    system : System

    Returns
    -------
    tuple of Reel
    """
    if (kept := vars(system).get("_reels")) is not None:
        return kept
    joined = [[] for _ in range(system.n)]
    for k, ends in enumerate(system.tether_ends):
        for end in ends:
            joined[end].append(k)
    inner = [len(k) == 2 and not s for k, s in zip(joined, system.is_satellite)]
    found, seen = [], set()
    for k, (a, b) in enumerate(system.tether_ends.tolist()):
        if k in seen:
            continue
        segments, beads = [k], [a, b]
        while inner[beads[-1]] and beads[-1] != a:
            segments.append(next(i for i in joined[beads[-1]] if i != segments[-1]))
            beads.append(int(system.tether_ends[segments[-1]].sum()) - beads[-1])
        while inner[beads[0]] and beads[0] != beads[-1]:
            segments.insert(0, next(i for i in joined[beads[0]] if i != segments[0]))
            beads.insert(0, int(system.tether_ends[segments[0]].sum()) - beads[0])
        seen.update(segments)
        name = system.tether_name[segments[0]]
        if len(segments) > 1:
            name = name.removesuffix("_segment_1")
        lengths = system.rest_length_m[segments[::-1]]
        edges = np.cumsum(lengths)[:-1] + SHARE_OUT * lengths[1:]
        found.append(Reel(name, tuple(segments), tuple(beads), tuple(edges.tolist())))
    vars(system)["_reels"] = tuple(found)  # as a cached property of a frozen class is kept
    return tuple(found)


def reel_names(system: System) -> tuple[str, ...]:
    """Names of the whole tethers."""
    return tuple(reel.name for reel in reels(system))


def reel_index(system: System, name: str) -> int:
    """Index into `reels` of a tether.

    Raises
    ------
    TssError
        If there is none of that name.
    """
    return index_of("tether", name, reel_names(system))


def whole_lengths(system: System) -> np.ndarray:
    """Rest length [m] of each whole tether with nothing on its reel, shape (p,)."""
    return np.array([system.rest_length_m[list(reel.segments)].sum() for reel in reels(system)])


def deployed_lengths(
    system: System, deployed_m: Mapping[str, float] | float | None = None
) -> np.ndarray:
    """Rest length [m] that is out of each whole tether, shape (p,).

    Parameters
    ----------
    system : System
    deployed_m : dict of str to float, or float, optional
        [m] by name of the tether, or of all alike; those left out are out as a whole.

    Raises
    ------
    TssError
        If there is no tether of a name, or if a length is less than `SHORTEST_M`.
    """
    lengths = whole_lengths(system)
    if deployed_m is None:
        return lengths
    if not isinstance(deployed_m, Mapping):
        deployed_m = dict.fromkeys(reel_names(system), deployed_m)
    for name, length_m in deployed_m.items():
        place = reel_index(system, name)
        if not SHORTEST_M <= length_m < NEVER_M:
            raise TssError(
                f"deployed length of {name} must be at least {SHORTEST_M:g} m, got {length_m!r:.40}"
            )
        lengths[place] = length_m
    return lengths


def segment_rests(
    system: System, length_m: np.ndarray, rate_m_s: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Rest length and its rate of every segment.

    Parameters
    ----------
    system : System
    length_m, rate_m_s : ndarray, shape (..., p)
        Of each whole tether, what is out [m] and how fast it is paid out [m/s].

    Returns
    -------
    rest_length_m, rest_rate_m_s : ndarray, shape (..., m)
        0 for segments on a reel.
    """
    length_m, rate_m_s = np.asarray(length_m, dtype=float), np.asarray(rate_m_s, dtype=float)
    rest, rate = np.zeros((2, *length_m.shape[:-1], system.m))
    for i, reel in enumerate(reels(system)):
        far, out = 0.0, length_m[..., i]
        lowest = -np.inf
        for q, k in enumerate(reversed(reel.segments)):
            highest = reel.edges_m[q] if q < len(reel.edges_m) else np.inf
            whole = system.rest_length_m[k]
            paying = (out > lowest) & (out <= highest)
            rest[..., k] = np.where(paying, out - far, np.where(out > highest, whole, 0.0))
            rate[..., k] = np.where(paying, rate_m_s[..., i], 0.0)
            far, lowest = far + whole, highest
    return rest, rate


class Deployment(NamedTuple):
    """What of a system is out: the part of it that moves by itself.

    Attributes
    ----------
    whole, system : System
        The whole one, and that of the beads that are out. Those on a reel are part of their
        satellite. Rest lengths are those of whole segments.
    beads, segments : ndarray of int
        Which beads and segments of the whole system these are.
    carrier : ndarray, shape (n,), int
        Index among the beads out of the one that each bead rides with: itself where it is out.
    """

    whole: System
    system: System
    beads: np.ndarray
    segments: np.ndarray
    carrier: np.ndarray


def deployment(system: System, out: Sequence[int]) -> Deployment:
    """The part of a system that is out.

    Parameters
    ----------
    system : System
    out : sequence of int
        Segments out of each of `reels`, `Reel.segments_out`.
    """
    rides = np.arange(system.n)
    ends, on_reel = np.array(system.tether_ends), np.zeros(system.m, dtype=bool)
    for reel, count in zip(reels(system), out):
        inside = len(reel.segments) - count
        rides[list(reel.beads[1 : inside + 1])] = reel.beads[0]
        on_reel[list(reel.segments[:inside])] = True
    beads, segments = np.flatnonzero(rides == np.arange(system.n)), np.flatnonzero(~on_reel)
    place = np.full(system.n, -1)
    place[beads] = np.arange(beads.size)
    carrier = place[rides]
    if beads.size == system.n:
        return Deployment(system, system, beads, segments, carrier)
    part = replace(
        system,
        bead_name=tuple(system.bead_name[i] for i in beads),
        is_satellite=system.is_satellite[beads],
        mass_kg=np.bincount(carrier, system.mass_kg),
        tether_name=tuple(system.tether_name[k] for k in segments),
        tether_ends=carrier[ends[segments]],
        layout_m=system.layout_m[beads],
        **{
            name: getattr(system, name)[segments]
            for name in ("rest_length_m", "axial_stiffness_n", "damping_n_s_per_m")
        },
    )
    return Deployment(system, part, beads, segments, carrier)


def deployed_system(
    system: System, deployed_m: Mapping[str, float] | float
) -> tuple[System, Deployment]:
    """A system of its own of what is out at given lengths, as one asks about steady states of it.

    Parameters
    ----------
    system : System
    deployed_m : dict of str to float, or float
        As in `deployed_lengths`.

    Returns
    -------
    System
        Of the beads that are out, with the rest lengths that are out, and a layout scaled along.
    Deployment
    """
    lengths = deployed_lengths(system, deployed_m)
    out = [reel.segments_out(length) for reel, length in zip(reels(system), lengths)]
    part = deployment(system, out)
    rest = segment_rests(system, lengths, np.zeros_like(lengths))[0][part.segments]
    share = np.sum(lengths) / np.sum(whole_lengths(system))
    damping = part.system.damping_n_s_per_m * part.system.rest_length_m / rest
    alone = replace(
        part.system,
        rest_length_m=rest,
        damping_n_s_per_m=damping,
        layout_m=share * part.system.layout_m,
    )
    return alone, part


def whole_state(part: Deployment, state: State) -> State:
    """The state of the whole system: beads on a reel are where their satellite is."""
    return State(state.position_m[part.carrier], state.velocity_m_s[part.carrier])


def pay_out(
    before: Deployment,
    after: Deployment,
    reel: Reel,
    turning_rad_s: float,
    motion: tuple[np.ndarray, np.ndarray],
    paying: tuple[float, float],
) -> tuple[np.ndarray, np.ndarray]:
    """Velocities and positions as one bead leaves its reel, or is taken in by it.

    Centre of mass, momentum and angular momentum stay. A bead leaves on the line to its
    neighbour, where both segments have the strain and the strain rate that the one before had.

    Parameters
    ----------
    before, after : Deployment
        With one bead of the reel more or less.
    reel : Reel
    turning_rad_s : float
        Rate of the frame against the stars, about z.
    motion : tuple of two ndarray, shape (n', 3)
        Velocities [m/s] and positions [m] of the beads out before, in a frame that turns.
    paying : tuple of two float
        Rest length [m] of the segment that was being paid out before, and its rate [m/s].

    Returns
    -------
    tuple of two ndarray
        Those of the beads out after.
    """
    v, r = (x[before.carrier] for x in motion)
    system = before.whole
    leaves = after.beads.size > before.beads.size
    bead, far = _bead_and_neighbour(after if leaves else before, reel)
    home = reel.beads[0]
    mass, held = system.mass_kg[bead], before.system.mass_kg[before.carrier[home]]
    if leaves:
        apart_r, apart_v = _on_the_line(r[far] - r[home], v[far] - v[home], system, reel, bead,
                                        paying)  # fmt: skip
        share = mass / held
    else:
        apart_r, apart_v = r[bead] - r[home], v[bead] - v[home]
        share = mass / (held + mass)
        r[home], v[home] = r[home] + share * apart_r, v[home] + share * apart_v
    # The turn of the two about each other goes into the pair of their centre and the neighbour.
    inertial = apart_v + turning_rad_s * np.array([-apart_r[1], apart_r[0], 0.0])
    reduced = mass * (1.0 - share)
    turn = np.cross(apart_r, inertial) * (-reduced if leaves else reduced)
    line = r[far] - r[home]
    push = np.cross(turn, line) / (line @ line)
    both = held if leaves else held + mass
    v[home] = v[home] - push / both
    v[far] = v[far] + push / before.system.mass_kg[before.carrier[far]]
    if leaves:
        r[bead], v[bead] = r[home] + (1.0 - share) * apart_r, v[home] + (1.0 - share) * apart_v
        r[home], v[home] = r[home] - share * apart_r, v[home] - share * apart_v
    return v[after.beads], r[after.beads]


def _bead_and_neighbour(part, reel):
    """Of the beads of a reel that are out, the one next to it, and the one after that."""
    out = [bead for bead in reel.beads[1:] if part.beads[part.carrier[bead]] == bead]
    return out[0], out[1]


def _on_the_line(line, line_rate, system, reel, bead, paying):
    """Place [m] and velocity [m/s] from the satellite of a bead that leaves."""
    rest, unreeling = paying
    place = reel.beads.index(bead)
    share = 1.0 - system.rest_length_m[reel.segments[place]] / rest
    length = np.linalg.norm(line)
    along = line / length
    faster = line_rate @ along
    rate = share * (faster - unreeling) + unreeling
    return share * line, rate * along + share * (line_rate - faster * along)
