"""Failures: tethers that are cut, actuators that are dead or stuck; at a time or on an event.

An actuator is the thruster of a satellite, named as that is, or a reel, named as its whole tether.
"""

from __future__ import annotations

import heapq
import itertools
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from tss_ros.core.arguments import finite
from tss_ros.core.errors import TssError, index_of
from tss_ros.core.model.commands import Commands
from tss_ros.core.model.cubics import cubic_at
from tss_ros.core.model.reel_law import reels_that_yield, what_yields
from tss_ros.core.model.reels import LEAST_M, reel_names
from tss_ros.core.model.system import System

#: What becomes of an actuator. It obeys; it does nothing: no force, a reel under its brake; or it
#: goes on with what it does: the same force, or the same rate of a reel, down to LEAST_M out.
HEALTHY, DEAD, STUCK = MODES = ("healthy", "dead", "stuck")
#: What becomes of a tether segment.
CUT = "cut"
#: What a failure may do to the thing that it names.
KINDS = (CUT, DEAD, STUCK)
#: Latest time [s] of a failure: simulation times are int32 seconds in every message.
LATEST_S = 2**31 - 1


@dataclass(frozen=True)
class Failure:
    """One failure that is to come.

    Attributes
    ----------
    kind : str
        One of "cut", "dead" and "stuck".
    target : str
        Name of the tether segment that is cut, or of the actuator that fails.
    at_s : float, optional
        [s] from the beginning of the motion. If it is not given, an event of `tether` is waited
        for.
    tether : str
        Name of a tether segment.
    tension_n : float, optional
        The event is a tension [N] above this. If it is not given, the event is that the segment
        is slack.
    """

    kind: str
    target: str
    at_s: float | None = None
    tether: str = ""
    tension_n: float | None = None

    def __post_init__(self):
        if self.kind not in KINDS:
            raise TssError(f"kind is {self.kind!r:.80}; allowed: {', '.join(KINDS)}")
        if (self.at_s is None) != bool(self.tether):
            raise TssError(
                f"at_s is {self.at_s} and tether {self.tether!r:.80}; allowed: one of them"
            )
        if self.at_s is not None:
            if finite("at_s", self.at_s, at_least=0.0) > LATEST_S:
                raise TssError(f"at_s is {self.at_s:g}; allowed: 0 to {LATEST_S}")
            if self.tension_n is not None:
                raise TssError("tension_n needs a tether whose tension it is")
        if self.tension_n is not None:
            finite("tension_n", self.tension_n)

    def place(self, system: System) -> int:
        """Index of the tether segment or of the actuator.

        Raises
        ------
        TssError
            If there is none of its name.
        """
        if self.kind == CUT:
            return index_of("tether", self.target, system.tether_name)
        return actuator(system, self.target)

    def check(self, system: System) -> None:
        """Raise TssError if it does not fit a system."""
        place = self.place(system)
        if self.kind != CUT:
            require_obedient(system, place)
        if self.tether:
            index_of("tether", self.tether, system.tether_name)

    def shows(self, system: System, tension_n: np.ndarray, taut: np.ndarray) -> np.ndarray:
        """Whether states show its event: shape (k,) for tensions and modes of shape (k, m)."""
        if not self.tether:
            return np.zeros(len(taut), dtype=bool)
        segment = system.tether_name.index(self.tether)
        if self.tension_n is None:
            return ~taut[:, segment]
        return tension_n[:, segment] > self.tension_n


class Happened(NamedTuple):
    """A failure that has a time, or the repair of an actuator.

    Attributes
    ----------
    time : float or int
        When, in the unit of the edges that it is put between.
    place : int
        Index of the tether segment that is cut, or of the actuator, see `actuator`.
    kind : str
        One of `KINDS`, or "healthy".
    held : ndarray, optional
        What a failed actuator goes on with: of a stuck thruster [N] along the axes of each of
        `commands.FRAMES`, (3, 3), of a reel length [m] and rate [m/s], (2,). As it is at that time
        if not given.
    """

    time: float
    place: int
    kind: str
    held: np.ndarray | None = None


class Change(NamedTuple):
    """What acts from a time on, and which actuators are dead or stuck then."""

    time: float
    commands: Commands
    failed: tuple[tuple[str, str], ...] = ()


def actuator(system: System, name: str) -> int:
    """Index of an actuator: that of its satellite's bead, or n and more for reels.

    A name that a satellite and a tether share is the satellite's.

    Raises
    ------
    TssError
        If no satellite and no whole tether has it.
    """
    satellites = np.flatnonzero(system.is_satellite).tolist()
    names = [*(system.bead_name[i] for i in satellites), *reel_names(system)]
    place = index_of("actuator", name, names)
    return satellites[place] if place < len(satellites) else system.n + place - len(satellites)


def require_obedient(system: System, place: int) -> None:
    """Raise TssError if an actuator, given by its index, is a reel that follows tension."""
    if place >= system.n and reels_that_yield(system).size:
        raise TssError(
            f"actuator is {actuator_name(system, place)!r}, a reel that follows tension all the"
            f" time ({what_yields(system)}); allowed: reels that obey commands, as with"
            " reel_sample_s"
        )


def actuator_name(system: System, place: int) -> str:
    """Name of the actuator of an index."""
    return (*system.bead_name, *reel_names(system))[place]


def with_failures(
    system: System,
    edges: Iterable[tuple[float, Commands]],
    happened: Sequence[Happened],
    before: Commands | None = None,
    per_s: float = 1.0,
) -> Iterator[Change]:
    """What acts once failures are taken into account.

    Of one time, commands come first: a thruster that is stuck goes on with the force that is
    commanded for that time. A reel that is repaired does again what the edges say of it.

    Parameters
    ----------
    system : System
    edges : iterable of (float, Commands)
        Times, and what is commanded from then on.
    happened : sequence of Happened
        Of one time and actuator the last one counts.
    before : Commands, optional
        What acts before the first of these times; nothing if not given.
    per_s : float
        Unit of the times, which are whole numbers where it is not 1: so many of it are a second.

    Yields
    ------
    Change
    """
    numbers = itertools.count()
    events = [(time, 0, next(numbers), commands) for time, commands in edges]
    events += [(h.time, 1, next(numbers), h) for h in happened]
    heapq.heapify(events)
    commanded, cut, failed = before or Commands.none(system), set(), {}
    while events:
        time = events[0][0]
        while events and events[0][0] == time:
            _, order, _, event = heapq.heappop(events)
            if order == 0:
                commanded = event
            elif order == 2:
                stuck, stop = event
                if failed[stuck.place] is stuck:  # else something has become of it since
                    failed[stuck.place] = stop
            elif event.kind == CUT:
                cut.add(event.place)
            else:
                acting = _acting(system, commanded, cut, failed, per_s)
                event = failed[event.place] = _held(system, acting, event, per_s)
                if stop := _stop(system, event, per_s):
                    heapq.heappush(events, (stop.time, 2, next(numbers), (event, stop)))
        named = [(actuator_name(system, i), failed[i].kind) for i in sorted(failed)]
        yield Change(
            time,
            _acting(system, commanded, cut, failed, per_s),
            tuple(pair for pair in named if pair[1] != HEALTHY),
        )


def reel_at(row: np.ndarray, time: float, per_s: float = 1.0) -> np.ndarray:
    """Length [m] and rate [m/s] of a reel at a time.

    Parameters
    ----------
    row : ndarray, shape (5,)
        As in `Commands.reel`.
    time : float
    per_s : float
        Unit of the time, as of `with_failures`.
    """
    begun = row[0] if per_s == 1.0 else round(row[0] * per_s)
    return np.array(cubic_at(row[1:], (time - begun) / per_s if row[2:].any() else 0.0))


def settled(
    system: System,
    edges: Iterable[tuple[float, Commands]],
    happened: Sequence[Happened],
    now: float,
    before: Commands | None = None,
    per_s: float = 1.0,
) -> list[Happened]:
    """Failures, with what the actuators go on with that have failed by now.

    After it edges before now may be forgotten. Parameters are those of `with_failures`.
    """
    acting = {c.time: c.commands for c in with_failures(system, edges, happened, before, per_s)}
    return [_held(system, acting[h.time], h, per_s) if h.time <= now else h for h in happened]


def _held(system, acting, event, per_s):
    """A failure with what its actuator goes on with, which is what acts as it fails."""
    if event.held is not None or event.kind in (HEALTHY, CUT):
        return event
    if event.place < system.n:
        return event._replace(held=acting.force_n[:, event.place])
    length_m, rate_m_s = reel_at(acting.reel[event.place - system.n], event.time, per_s)
    return event._replace(held=np.array([length_m, rate_m_s if event.kind == STUCK else 0.0]))


def _stop(system, event, per_s):
    """When a stuck reel has wound in what it can; None if it does not."""
    if event.place < system.n or event.kind != STUCK or event.held[1] >= 0.0:
        return None
    time = event.time + per_s * max(0.0, event.held[0] - LEAST_M) / -event.held[1]
    time = time if per_s == 1.0 else round(time)
    return event._replace(time=time, held=np.array([LEAST_M, 0.0]))


def _acting(system, commanded, cut, failed, per_s):
    force_n, gone = np.array(commanded.force_n), np.array(commanded.cut)
    reel = np.array(commanded.reel)
    for place, failure in failed.items():
        if failure.kind == HEALTHY:
            continue
        if place >= system.n:
            length_m, rate_m_s = failure.held
            since_s = failure.time / per_s if rate_m_s else 0.0
            reel[place - system.n] = since_s, length_m, rate_m_s, 0.0, 0.0
        elif failure.kind == DEAD:
            force_n[:, place] = 0.0
        else:
            force_n[:, place] = failure.held
    gone[list(cut)] = True
    return commanded._replace(force_n=force_n, cut=gone, reel=reel)


def news_alone(
    acting: Commands, edges: Iterable[tuple[float, Commands]]
) -> list[tuple[float, Commands]]:
    """The edges at which something else comes to act than before, at first than `acting`."""
    kept = []
    for time, commands in edges:
        if commands != acting:
            kept.append((time, commands))
            acting = commands
    return kept


class FailureWatch:
    """Looks for the events of failures in states, in their order.

    Parameters
    ----------
    system : System
    failures : sequence of Failure

    Attributes
    ----------
    due : ndarray, shape (k,), bool
        Which of them wait for their events.

    Raises
    ------
    TssError
        If one does not fit the system.
    """

    def __init__(self, system: System, failures: Sequence[Failure]) -> None:
        for failure in failures:
            failure.check(system)
        self._system, self._failures = system, tuple(failures)
        self.due = np.array([bool(failure.tether) for failure in failures], dtype=bool)

    def resume(self, due: np.ndarray) -> None:
        """Go on where another watch for the same failures was.

        Raises
        ------
        TssError
            If its `due` does not fit.
        """
        if due.shape != self.due.shape or (due & ~self.due).any():
            raise TssError("it waits for other events of failures")
        self.due = np.array(due, dtype=bool)

    def timed(self) -> list[Happened]:
        """Those that have a time, in seconds from the beginning of the motion."""
        timed = (f for f in self._failures if f.at_s is not None)
        return [Happened(f.at_s, f.place(self._system), f.kind) for f in timed]

    def look(self, tension_n: np.ndarray, taut: np.ndarray) -> tuple[int, list[Failure]]:
        """Find the first state that shows an event, and what fails by it from then on.

        Parameters
        ----------
        tension_n, taut : ndarray, shape (k, m)
            Of states that follow those that were looked at before.

        Returns
        -------
        tuple of int and list of Failure
            Number of the state, k and nothing if there is none. States behind it are to be looked
            at anew.
        """
        first = {}
        for i in np.flatnonzero(self.due):
            shown = self._failures[i].shows(self._system, tension_n, taut)
            if shown.any():
                first[i] = int(shown.argmax())
        if not first:
            return len(taut), []
        state = min(first.values())
        found = [i for i, k in first.items() if k == state]
        self.due[found] = False
        return state, [self._failures[i] for i in found]
