"""Commands to reels: from what is commanded over time to rest lengths, one cubic after another."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from tss_ros.core import System, TssError
from tss_ros.core.model.cubics import cubic_at, cubic_crossings, cubic_from
from tss_ros.core.model.laws.reel import REEL_DAMPING
from tss_ros.core.model.reel_law import what_yields
from tss_ros.core.model.reels import LEAST_M, NEVER_M, whole_lengths
from tss_ros.scenarios.parameters import REEL_LIMITS
from tss_ros.scenarios.reels import Reels
from tss_ros.scenarios.scenario import Scenario

#: What a command may be: a rate, a length to be reached, or a profile, with straight lines between
#: its points or with cubics; or the length at which a reel stands that is repaired.
RATE, TARGET, LINES, CUBICS, STAND = range(5)
#: Time [s] from which on nothing is planned, beyond that of all simulations.
NEVER_S = 1e10
#: Most points of a profile.
MOST_POINTS = 1000
#: Longest length [m], and smallest and largest rate [m/s] that a command may have.
MAX_LENGTH_M, MIN_RATE_M_S, MAX_RATE_M_S = 1e7, 1e-9, 1e3
#: What squares and cubes of time may be left out [m].
NOTHING_M = 1e-9
#: What is out over time [s]: length [m], rate [m/s], and the coefficients of square and cube.
Cubic = tuple[float, float, float, float]


class Limits(NamedTuple):
    """What a reel does not exceed.

    Attributes
    ----------
    rate_m_s : float
        Largest rate in or out; 0: none.
    shortest_m, longest_m : float
        Lengths out at which it stops; 0: no longest one.
    """

    rate_m_s: float = 0.0
    shortest_m: float = LEAST_M
    longest_m: float = 0.0

    @classmethod
    def of(cls, options: Mapping[str, Any]) -> Limits:
        """Those of a simulator's parameters, by name.

        Raises
        ------
        TssError
            If the longest length is not above the shortest.
        """
        limits = cls(*(options[parameter.name] for parameter in REEL_LIMITS))
        if 0.0 < limits.longest_m <= limits.shortest_m:
            raise TssError(
                f"reel_longest_m is {limits.longest_m:g} m and reel_shortest_m"
                f" {limits.shortest_m:g} m; allowed: 0, or more than the shortest"
            )
        return limits


class ReelCommand(NamedTuple):
    """One command to one reel.

    Attributes
    ----------
    time_ns : int
        Simulation time [ns] from which it holds.
    place : int
        Index into `reels.reels`.
    kind : int
        RATE, TARGET, LINES, CUBICS or STAND.
    points : tuple of (float, float, float)
        Times from then on [s], lengths [m], rates [m/s]. A rate has its duration, 0 for any, and no
        length. A target has no time, and a speed.
    limits : Limits
    from_law : bool
        Whether the law of the reel gave it, `reel_law`.
    """

    time_ns: int
    place: int
    kind: int
    points: tuple[tuple[float, float, float], ...]
    limits: Limits = Limits()
    from_law: bool = False

    @property
    def key(self) -> tuple[int, int, bool]:
        """When and where, and whether it goes before others of that time."""
        return self.time_ns, self.place, self.kind == STAND

    def check(self) -> None:
        """Raise TssError, with what is allowed, if it cannot be carried out."""
        last_s = -math.inf
        for time_s, length_m, rate_m_s in self.points:
            if self.kind != RATE and not LEAST_M <= length_m <= MAX_LENGTH_M:
                raise TssError(
                    f"position is {length_m:g} m; allowed: {LEAST_M:g} to {MAX_LENGTH_M:g}"
                )
            if rate_m_s != 0.0 and not MIN_RATE_M_S <= abs(rate_m_s) <= MAX_RATE_M_S:
                raise TssError(
                    f"velocity is {rate_m_s:g} m/s; allowed: 0, and {MIN_RATE_M_S:g} to"
                    f" {MAX_RATE_M_S:g} in or out"
                )
            if not max(last_s, 0.0) <= time_s < math.inf or time_s == last_s:
                raise TssError(f"time_from_start is {time_s:g} s; allowed: from 0 on, increasing")
            last_s = time_s
        if self.kind == TARGET and not self.points[0][2] > 0.0:
            raise TssError(f"speed is {self.points[0][2]:g} m/s; allowed: more than 0")
        if not 1 <= len(self.points) <= (MOST_POINTS if self.kind in (LINES, CUBICS) else 1):
            raise TssError(f"it has {len(self.points)} points; allowed: 1 to {MOST_POINTS}")


class ReelStart(NamedTuple):
    """What reels do as a run begins.

    Attributes
    ----------
    length_m : tuple of float
        Out of each of `reels.reels`.
    commands : tuple of ReelCommand
        Counted from the beginning of the run.
    every : int
        Published states from one sample of the law of all reels to the next; 0 if none is sampled.
    """

    length_m: tuple[float, ...]
    commands: tuple[ReelCommand, ...] = ()
    every: int = 0


class ReelEdge(NamedTuple):
    """From a simulation time [ns] on a reel pays out so, as a cubic of the time since."""

    time_ns: int
    place: int
    cubic: Cubic

    @property
    def row(self) -> np.ndarray:
        """As in `Commands.reel`."""
        since_s = self.time_ns / 1e9 if any(self.cubic[1:]) else 0.0
        return np.array([since_s, *self.cubic])

    def at(self, time_ns: int) -> tuple[float, float]:
        """Length [m] and rate [m/s] at a simulation time [ns]."""
        return cubic_at(self.cubic, (time_ns - self.time_ns) / 1e9)


def planned(command: ReelCommand, length_m: float, rate_m_s: float) -> list[ReelEdge]:
    """What a reel does under a command that nothing follows.

    Parts of a profile that are faster than the limit take longer, so that they are not. Where the
    reel would pass a limit of its length it stops, until the command leads it back.

    Parameters
    ----------
    command : ReelCommand
    length_m, rate_m_s : float
        Length out [m] as it comes, and the rate [m/s] until then.

    Returns
    -------
    list of ReelEdge
    """
    limits, begun_s, edges = command.limits, 0.0, []
    low = min(limits.shortest_m, length_m)
    high = max(limits.longest_m or NEVER_M, length_m)
    for duration_s, cubic in _pieces(command, length_m, rate_m_s):
        for since_s, part in _clamped(cubic, duration_s, low, high):
            if begun_s + since_s > NEVER_S:
                return edges
            time_ns = command.time_ns + round((begun_s + since_s) * 1e9)
            if edges and edges[-1].time_ns == time_ns:
                edges.pop()
            if not edges or any(part[1:]) or part != edges[-1].cubic:
                edges.append(ReelEdge(time_ns, command.place, part))
        begun_s += duration_s
    return edges


def is_limited(command: ReelCommand, length_m: float, rate_m_s: float) -> bool:
    """Whether limits make something else of a command; parameters as for `planned`."""
    free = command._replace(limits=Limits())
    return planned(command, length_m, rate_m_s) != planned(free, length_m, rate_m_s)


def _pieces(command, length_m, rate_m_s):
    """Durations [s] and cubics, the last one without end, before there is a limit of lengths."""
    first_s, first_m, speed = command.points[0]
    if command.kind in (RATE, TARGET):
        speed = math.copysign(min(abs(speed), command.limits.rate_m_s or math.inf), speed)
    if command.kind == STAND:
        yield math.inf, (first_m, 0.0, 0.0, 0.0)
        return
    if command.kind == RATE:
        yield first_s or math.inf, (length_m, speed, 0.0, 0.0)
        if first_s:
            yield math.inf, (length_m + first_s * speed, 0.0, 0.0, 0.0)
        return
    if command.kind == TARGET:
        rate = math.copysign(speed, first_m - length_m)
        yield (first_m - length_m) / rate, (length_m, rate, 0.0, 0.0)
        yield math.inf, (first_m, 0.0, 0.0, 0.0)
        return
    points = list(command.points)
    points[0] = first_s, length_m if first_s == 0.0 else first_m, speed
    if first_s > 0.0:
        points.insert(0, (0.0, length_m, rate_m_s))
    for (t, a, va), (end, b, vb) in zip(points, points[1:]):
        h = end - t
        mean = (b - a) / h
        cubic = (a, mean, 0.0, 0.0)
        if command.kind == CUBICS:
            c, d = (3.0 * mean - 2.0 * va - vb) / h, (va + vb - 2.0 * mean) / h**2
            c, d = (0.0 if abs(x) * h**i < NOTHING_M else x for i, x in ((2, c), (3, d)))
            cubic = (a, va, c, d)
        slower = _fastest(cubic, h) / (command.limits.rate_m_s or math.inf)
        if slower > 1.0 + 1e-12:
            h, cubic = h * slower, tuple(c / slower**i for i, c in enumerate(cubic))
        yield h, cubic
    yield math.inf, (points[-1][1], 0.0, 0.0, 0.0)


def _fastest(cubic, duration_s):
    """Largest rate [m/s] of a cubic, in or out."""
    times = [0.0, duration_s]
    if cubic[3] and 0.0 < (turn := -cubic[2] / (3.0 * cubic[3])) < duration_s:
        times.append(turn)
    return max(abs(cubic_at(cubic, t)[1]) for t in times)


def _clamped(cubic, duration_s, low, high):
    """Parts of a cubic between two lengths [m], with the times [s] at which they begin."""
    cuts = {0.0}
    for limit in (low, high):
        cuts |= {t for t in cubic_crossings(cubic, limit) if 0.0 < t < duration_s}
    ordered = [*sorted(cuts), duration_s]
    for begin, end in zip(ordered, ordered[1:]):
        middle, _ = cubic_at(cubic, 0.5 * (begin + end) if end < math.inf else begin + 1.0)
        limit = low if middle < low else high if middle > high else None
        yield begin, cubic_from(cubic, begin) if limit is None else (limit, 0.0, 0.0, 0.0)


def reel_start(loaded: Scenario, system: System, publish_period_s: float) -> ReelStart | None:
    """What reels do as a run of a scenario begins; None if all tethers are out and stay so.

    Parameters
    ----------
    loaded : Scenario
    system : System
        What it builds.
    publish_period_s : float

    Raises
    ------
    TssError
        If the scenario names tethers that the system has not, or if what it says cannot be done.
    """
    given = loaded.reels or Reels({}, {})
    lengths, profiles = given.of(system)
    every = 0
    if acting := what_yields(system):
        law = f"{acting} lets reels follow tension"
        if profiles:
            raise TssError(f"reels are given and {law}; allowed: profiles, or their law")
        if given.sample_s is None:
            if not np.array_equal(lengths, whole_lengths(system)):
                raise TssError(
                    f"deployed_m is given and {law}; allowed: the whole length, or reel_sample_s"
                )
            return None
        if acting != REEL_DAMPING.name:
            raise TssError(
                f"reel_sample_s is given and {law}; allowed: {REEL_DAMPING.name} alone, which a"
                " controller can sample"
            )
        every = _states_between(given.sample_s, publish_period_s)
    elif given.sample_s is not None:
        raise TssError(
            f"reel_sample_s is {given.sample_s:g} s, but there is no law to sample; allowed: with"
            f" {REEL_DAMPING.name} above 0"
        )
    elif loaded.reels is None:
        return None
    commands = []
    for place, profile in profiles.items():
        begun_s, rates = profile.time_s[0], profile.rate_m_s or (0.0,) * len(profile.time_s)
        times = [time_s - begun_s for time_s in profile.time_s]
        points = tuple(zip(times, profile.length_m, rates))
        kind = CUBICS if profile.rate_m_s else LINES
        commands.append(ReelCommand(round(begun_s * 1e9), place, kind, points))
        commands[-1].check()
    return ReelStart(tuple(lengths.tolist()), tuple(commands), every)


def _states_between(sample_s, publish_period_s):
    """Published states from one sample of a law to the next."""
    share = sample_s / publish_period_s
    every = max(1, round(share))
    if abs(share - every) > 1e-9 * every:
        below = int(share)
        near = " or ".join(f"{k * publish_period_s:.12g}" for k in (below, below + 1) if k)
        raise TssError(
            f"reel_sample_s is {sample_s:.12g} s; allowed: whole multiples of"
            f" publish_period_s, {publish_period_s:.12g} s, as {near}"
        )
    return every
