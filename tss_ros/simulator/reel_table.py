"""All commands to reels of a run, and what the reels come to do."""

from __future__ import annotations

import threading
from collections.abc import Iterator, Sequence

import numpy as np

from tss_ros.core import System, TssError
from tss_ros.core.model.reels import whole_lengths
from tss_ros.simulator.reel_commands import (
    RATE,
    STAND,
    Limits,
    ReelCommand,
    ReelEdge,
    ReelStart,
    planned,
)

#: Most points of all commands that are kept; a rate and a target count as one.
MOST_KEPT_POINTS = 2000


class ReelTable:
    """All commands to reels that hold or are to come.

    `post` and `at` are for any thread, the rest for one.

    Parameters
    ----------
    system : System
    start : ReelStart, optional
        Without it all tethers are out.
    """

    def __init__(self, system: System, start: ReelStart | None = None) -> None:
        whole = whole_lengths(system).tolist()
        start = start or ReelStart(tuple(whole))
        self._whole = [(length, 0.0, 0.0, 0.0) for length in whole]
        # What each reel does until the first of its commands that are kept.
        lengths = enumerate(start.length_m)
        self._base = [ReelEdge(0, i, (float(length), 0.0, 0.0, 0.0)) for i, length in lengths]
        self._commands = {c.key: c for c in start.commands}
        self._waiting, self._lock, self._made = {}, threading.Lock(), None

    def __bool__(self) -> bool:
        return bool(self._commands) or [edge.cubic for edge in self._base] != self._whole

    def post(self, command: ReelCommand) -> bool:
        """Leave a command to be collected; false if too many are kept already."""
        with self._lock:
            kept = [*self._waiting.values(), *self._commands.values()]
            size = sum(len(c.points) for c in kept if c.key != command.key)
            full = size + len(command.points) > MOST_KEPT_POINTS + len(self._base)
            if full and not command.from_law:
                return False
            self._waiting.pop(command.key, None)
            self._waiting[command.key] = command
        return True

    @property
    def waits(self) -> bool:
        """Whether there is something to collect."""
        return bool(self._waiting)

    def collect(self, now_ns: int) -> bool:
        """Take what was posted, whose time is now [ns] at the earliest; whether there was any."""
        if not self._waiting:
            return False
        with self._lock:
            waiting, self._waiting = self._waiting, {}
            commands = dict(self._commands)
        for command in waiting.values():
            command = command._replace(time_ns=max(command.time_ns, now_ns))
            commands[command.key] = command
        self._commands, self._made = commands, None
        self._forget(now_ns)
        return True

    @property
    def base(self) -> list[ReelEdge]:
        """What reels do before all edges."""
        return self._base

    @property
    def edges(self) -> list[ReelEdge]:
        """What reels come to do, in the order of time."""
        if self._made is None:
            parts = [edge for i in range(len(self._base)) for edge in self._plan(i)]
            self._made = sorted(parts, key=lambda edge: edge.time_ns)
        return self._made

    def at(self, place: int, time_ns: int) -> ReelEdge:
        """What a reel does at a simulation time [ns]."""
        # In any thread: no plan is kept here.
        newest = self._base[place]
        for edge in self._plan(place):
            if edge.time_ns <= time_ns:
                newest = edge
        return newest

    def follows_law(self, place: int, time_ns: int) -> bool:
        """Whether no command but those of its law has come to a reel by a time [ns]."""
        mine = [c for c in self._of(place) if c.time_ns <= time_ns and c.kind != STAND]
        return all(c.from_law for c in mine)

    def shift(self, by_ns: int) -> None:
        """Move all in time, as the clock is set anew."""
        moved = [c._replace(time_ns=c.time_ns + by_ns) for c in self._commands.values()]
        self._commands = {c.key: c for c in moved}
        self._base = [edge._replace(time_ns=edge.time_ns + by_ns) for edge in self._base]
        self._made = None

    @property
    def arrays(self) -> dict[str, np.ndarray]:
        """All that it keeps, for a snapshot."""
        commands = self._commands.values()
        heads = [(*c[:3], len(c.points), c.from_law) for c in commands]
        points = [point for c in commands for point in c.points]
        return {
            "reel_heads": np.array(heads, dtype=np.int64).reshape(-1, 5),
            "reel_limits": np.array([c.limits for c in commands], dtype=float).reshape(-1, 3),
            "reel_points": np.array(points, dtype=float).reshape(-1, 3),
            "reel_since_ns": np.array([edge.time_ns for edge in self._base], dtype=np.int64),
            "reel_cubic": np.array([edge.cubic for edge in self._base], dtype=float),
        }

    @arrays.setter
    def arrays(self, arrays: dict[str, np.ndarray]) -> None:
        heads, limits, points = (
            arrays[f"reel_{name}"].tolist() for name in ("heads", "limits", "points")
        )
        since, cubics = arrays["reel_since_ns"].tolist(), arrays["reel_cubic"].tolist()
        count = len(self._base)
        if len(since) != count or sum(head[3] for head in heads) != len(points):
            raise TssError(f"it has {len(since)} reels and {len(points)} points of commands")
        commands, taken = [], 0
        for (time_ns, place, kind, size, law), limit in zip(heads, limits):
            known = RATE <= kind <= STAND and law in (0, 1)
            if not (known and 0 <= place < count and size >= 1):
                raise TssError(f"there is no command of kind {kind} to reel {place}")
            part = tuple(map(tuple, points[taken : taken + size]))
            commands.append(ReelCommand(time_ns, place, kind, part, Limits(*limit), bool(law)))
            commands[-1].check()
            taken += size
        base = zip(since, range(count), map(tuple, cubics))
        self._base, self._waiting, self._made = [ReelEdge(*edge) for edge in base], {}, None
        self._commands = {c.key: c for c in commands}

    def _of(self, place: int) -> Sequence[ReelCommand]:
        """The commands to a reel, in order."""
        mine = [c for c in self._commands.values() if c.place == place]
        return sorted(mine, key=lambda c: (c.time_ns, c.kind != STAND))

    def _plan(self, place: int) -> Iterator[ReelEdge]:
        """What a reel comes to do."""
        newest, commands = self._base[place], self._of(place)
        for command, following in zip(commands, [*commands[1:], None]):
            for edge in planned(command, *newest.at(command.time_ns)):
                if following is not None and edge.time_ns >= following.time_ns:
                    break
                yield edge
                newest = edge

    def _forget(self, now_ns):
        """Keep of the commands up to now [ns] only the newest of each reel, and what was before."""
        base, over = list(self._base), set()
        for place in range(len(base)):
            begun = [c for c in self._of(place) if c.time_ns <= now_ns]
            if len(begun) > 1:
                before = [e for e in self.edges if e.place == place]
                base[place] = [e for e in before if e.time_ns < begun[-1].time_ns][-1]
                over |= {c.key for c in begun[:-1]}
        # `post` reads the commands meanwhile.
        self._commands = {key: c for key, c in self._commands.items() if key not in over}
        self._base, self._made = base, None
