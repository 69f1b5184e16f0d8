"""Failures: tethers that are cut, thrusters that are dead or stuck; at a time or on an event."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from tss_ros.core.errors import TssError, index_of
from tss_ros.core.model.commands import Commands
from tss_ros.core.model.system import System, finite

#: What becomes of an actuator: it obeys, gives no force, or goes on with the force that it gives.
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
        Name of the tether segment that is cut, or of the satellite whose thruster fails.
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
        """Index of the tether segment or of the bead.

        Raises
        ------
        TssError
            If there is none of its name.
        """
        if self.kind == CUT:
            return index_of("tether", self.target, system.tether_name)
        return thruster(system, self.target)

    def check(self, system: System) -> None:
        """Raise TssError if it does not fit a system."""
        self.place(system)
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
        Index of the tether segment that is cut, or of the satellite's bead.
    kind : str
        One of `KINDS`, or "healthy".
    force_n : ndarray, shape (3, 3), optional
        [N] along the axes of each of `commands.FRAMES`, of a stuck thruster; as it is at that
        time if not given.
    """

    time: float
    place: int
    kind: str
    force_n: np.ndarray | None = None


class Change(NamedTuple):
    """What acts from a time on, and which satellites' thrusters are dead or stuck then."""

    time: float
    commands: Commands
    failed: tuple[tuple[str, str], ...] = ()


def thruster(system: System, name: str) -> int:
    """Index of the bead of the satellite whose thruster has this name.

    Raises
    ------
    TssError
        If no satellite has it.
    """
    satellites = [system.bead_name[i] for i in np.flatnonzero(system.is_satellite)]
    index_of("satellite", name, satellites)
    return system.bead_name.index(name)


def with_failures(
    system: System,
    edges: Iterable[tuple[float, Commands]],
    happened: Sequence[Happened],
    before: Commands | None = None,
) -> Iterator[Change]:
    """What acts once failures are taken into account.

    Of one time, commands come first: a thruster that is stuck goes on with the force that is
    commanded for that time.

    Parameters
    ----------
    system : System
    edges : iterable of (float, Commands)
        Times, and what is commanded from then on.
    happened : sequence of Happened
        Of one time and actuator the last one counts.
    before : Commands, optional
        What acts before the first of these times; nothing if not given.

    Yields
    ------
    Change
    """
    first = [(time, 0, commands) for time, commands in edges]
    merged = sorted(first + [(h.time, 1, h) for h in happened], key=lambda event: event[:2])
    commanded, cut, failed = before or Commands.none(system), set(), {}
    for time, group in itertools.groupby(merged, key=lambda event: event[0]):
        for _, is_failure, event in group:
            if not is_failure:
                commanded = event
            elif event.kind == CUT:
                cut.add(event.place)
            else:
                given_n = _acting(commanded, cut, failed).force_n[:, event.place]
                if event.kind == STUCK and event.force_n is None:
                    event = event._replace(force_n=given_n)
                failed[event.place] = event
        named = tuple((system.bead_name[i], failed[i].kind) for i in sorted(failed))
        yield Change(
            time,
            _acting(commanded, cut, failed),
            tuple(pair for pair in named if pair[1] != HEALTHY),
        )


def _acting(commanded, cut, failed):
    force_n, gone = np.array(commanded.force_n), np.array(commanded.cut)
    for bead, failure in failed.items():
        if failure.kind == DEAD:
            force_n[:, bead] = 0.0
        elif failure.kind == STUCK:
            force_n[:, bead] = failure.force_n
    gone[list(cut)] = True
    return commanded._replace(force_n=force_n, cut=gone)


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
