"""Commands to thrusters and reels, and failures, over simulated time, as they are given."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from tss_ros.core import Commands, System, TssError
from tss_ros.core.model.commands import FRAMES
from tss_ros.core.model.failures import Change, Happened
from tss_ros.simulator.failures import FailureTable
from tss_ros.simulator.reel_commands import STAND, ReelCommand, ReelEdge, ReelStart
from tss_ros.simulator.reel_table import ReelTable

#: Most commands that are kept besides those that hold.
MOST_KEPT = 1000
#: Frame number of a tether that is cut, whose index is the place.
CUT = -1


class Command(NamedTuple):
    """One command.

    Attributes
    ----------
    time_ns : int
        Simulation time [ns] from which it holds.
    place : int
        Index of the bead, or of the tether.
    frame : int
        Index into `commands.FRAMES`; `CUT` for a tether that fails.
    force_n : tuple of float
        [N] along x, y and z.
    """

    time_ns: int
    place: int
    frame: int
    force_n: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def key(self) -> tuple[int, int, bool]:
        """What no other command has beside it: when, where, and whether it is a cut."""
        return self.time_ns, *self.actuator

    @property
    def actuator(self) -> tuple[int, bool]:
        """The bead or the tether."""
        return self.place, self.frame == CUT


class CommandTable:
    """All commands that hold or are to come. `post` is for any thread, the rest for one.

    Parameters
    ----------
    system : System
    start : ReelStart, optional
        What reels do from time 0 on.
    """

    #: Simulated time [ns] after which a force ends that is not commanded anew; 0: never.
    timeout_ns = 0

    def __init__(self, system: System, start: ReelStart | None = None) -> None:
        self._system, self.reels = system, ReelTable(system, start)
        self._made = None
        self._commands = {}  # by key
        self._waiting, self._lock = {}, threading.Lock()
        self._failures = FailureTable(system)

    def __bool__(self) -> bool:
        return bool(self._commands or self._failures or self.reels)

    def post(self, command: Command | ReelCommand) -> bool:
        """Leave a command to be collected; false if too many are kept already."""
        if isinstance(command, ReelCommand):
            return self.reels.post(command)
        with self._lock:
            full = len(self._waiting) + len(self._commands) >= MOST_KEPT + self._system.n
            if full and command.key not in self._waiting:
                return False
            self._waiting.pop(command.key, None)
            self._waiting[command.key] = command
        return True

    def collect(self, now_ns: int) -> bool:
        """Take what was posted; whether there was anything.

        Parameters
        ----------
        now_ns : int
            Simulation time [ns] of the newest state: what should have held before holds from here.
        """
        if not (self._waiting or self.reels.waits):
            return False
        self.settle(now_ns)
        if self.reels.collect(now_ns):
            self._made = None
        with self._lock:
            waiting, self._waiting = self._waiting, {}
        for command in waiting.values():
            command = command._replace(time_ns=max(command.time_ns, now_ns))
            self._commands[command.key] = command
        ordered = sorted(self._commands.values(), key=lambda c: c.time_ns)
        newest = {c.actuator: c for c in ordered if c.time_ns <= now_ns}
        kept = [c for c in ordered if c.time_ns > now_ns or newest[c.actuator] is c]
        self._commands, self._made = {c.key: c for c in kept}, None
        return True

    def fail(self, failure: Happened, now_ns: int) -> None:
        """Let an actuator fail, or repair it, at a simulation time [ns]; a past one is now.

        A reel that is repaired stands until it is commanded again.

        Raises
        ------
        TssError
            If too many failures are kept already.
        """
        self.settle(now_ns)
        self._failures.add(failure._replace(time=max(failure.time, now_ns)))
        for repair in self._failures.repairs_of_reels:
            length_m = self._failures.length_m(repair, self._edges(), self._without_commands)
            if length_m is not None:
                place, point = repair.place - self._system.n, ((0.0, length_m, 0.0),)
                self.reels.post(ReelCommand(repair.time, place, STAND, point))
                self.reels.collect(now_ns)
                self._made = None
        self.settle(now_ns)

    def settle(self, now_ns: int) -> None:
        """Note what stuck actuators do by now, before anything is changed."""
        self._failures.settle(now_ns, self._edges(), self._without_commands)

    def change(self, time_ns: int) -> Change:
        """What acts from a simulation time [ns] on, and what has failed by then."""
        newest = Change(time_ns, base := self._without_commands)
        for change in self._failures.act_on(self._edges(), base):
            if change.time > time_ns:
                break
            newest = change._replace(time=time_ns)
        return newest

    def at(self, time_ns: int) -> Commands:
        """What acts from a simulation time [ns] on."""
        return self.change(time_ns).commands

    def edges(self, now_ns: int) -> list[tuple[int, Commands]]:
        """When [ns] something changes from a time on, and what acts from then on."""
        changes = self._failures.act_on(self._edges(), self._without_commands)
        return [change[:2] for change in changes if change.time >= now_ns]

    def shift(self, by_ns: int) -> None:
        """Move all in time, as the clock is set anew."""
        moved = [c._replace(time_ns=c.time_ns + by_ns) for c in self._commands.values()]
        self._commands, self._made = {c.key: c for c in moved}, None
        self._failures.shift(by_ns)
        self.reels.shift(by_ns)

    @property
    def arrays(self) -> dict[str, np.ndarray]:
        """All that it keeps, for a snapshot: times, places and frames, (k, 3); forces (k, 3).

        Those of failures are `FailureTable.arrays`, those of reels `ReelTable.arrays`.
        """
        commands = self._commands.values()
        return (
            self._failures.arrays
            | self.reels.arrays
            | {
                "when_and_where": np.array([c[:3] for c in commands], dtype=np.int64).reshape(
                    -1, 3
                ),
                "force_n": np.array([c.force_n for c in commands], dtype=float).reshape(-1, 3),
            }
        )

    @arrays.setter
    def arrays(self, arrays: dict[str, np.ndarray]) -> None:
        n, m = self._system.n, self._system.m
        for _, place, frame in arrays["when_and_where"].tolist():
            if not (CUT <= frame < len(FRAMES) and 0 <= place < (m if frame == CUT else n)):
                raise TssError(f"there is no frame {frame} of bead or tether {place}")
        rows = zip(arrays["when_and_where"].tolist(), arrays["force_n"].tolist())
        commands = [Command(*whole, tuple(force)) for whole, force in rows]
        self._waiting, self._commands, self._made = {}, {c.key: c for c in commands}, None
        self._failures.arrays = arrays
        self.reels.arrays = arrays

    @property
    def _without_commands(self) -> Commands:
        """What acts before all that is kept."""
        acting = Commands.none(self._system)
        for edge in self.reels.base:
            acting.reel[edge.place] = edge.row
        return acting

    def _edges(self) -> list[tuple[int, Commands]]:
        """All instants [ns] at which something is commanded or ends, and what is from then on."""
        if self._made is None or self._made[0] != self.timeout_ns:
            self._made = self.timeout_ns, list(self._changes())
        return self._made[1]

    def _changes(self) -> Iterator[tuple[int, Commands]]:
        events = [(c.time_ns, 1, c) for c in self._commands.values()]
        if self.timeout_ns:
            forces = [c for c in self._commands.values() if c.frame != CUT]
            events += [(c.time_ns + self.timeout_ns, 0, c) for c in forces]
        events += [(edge.time_ns, 1, edge) for edge in self.reels.edges]
        events.sort(key=lambda event: event[:2])  # what ends goes before what begins
        acting, newest = self._without_commands, {}
        for i, (time_ns, begins, command) in enumerate(events):
            if isinstance(command, ReelEdge):
                acting.reel[command.place] = command.row
            elif command.frame == CUT:
                acting.cut[command.place] = True
            elif begins:
                newest[command.place] = command
                acting.force_n[:, command.place] = 0.0
                acting.force_n[command.frame, command.place] = command.force_n
            elif newest[command.place] is command:
                acting.force_n[:, command.place] = 0.0
            if i + 1 == len(events) or events[i + 1][0] > time_ns:
                yield time_ns, acting.checked(self._system)
