"""Failures of actuators over simulated time, as they are declared, asked for, and kept."""

from collections.abc import Iterable, Iterator

import numpy as np

from tss_ros.core import Commands, System, TssError
from tss_ros.core.model.failures import (
    HEALTHY,
    MODES,
    Change,
    Happened,
    actuator_name,
    reel_at,
    settled,
    with_failures,
)
from tss_ros.core.model.reels import reel_names

#: As in SimulationEvent.
KIND_CUT, KIND_FAIL = "cut", "fail"
#: Most failures that are kept.
MOST_KEPT = 1000
#: Nanoseconds in a second.
NS = 1e9
#: What is said of an actuator in an event.
_WORDS = {mode: mode for mode in MODES} | {HEALTHY: "healthy again"}


class FailureTable:
    """Dead, stuck and repaired actuators. For one thread.

    Parameters
    ----------
    system : System
    """

    def __init__(self, system: System) -> None:
        self._system, self._kept = system, []

    def __bool__(self) -> bool:
        return bool(self._kept)

    def add(self, failure: Happened) -> None:
        """Keep one more; its time is a simulation time [ns].

        Raises
        ------
        TssError
            If too many are kept already.
        """
        if len(self._kept) >= MOST_KEPT + self._system.n:
            raise TssError(f"{len(self._kept)} failures are kept already; it is not")
        self._kept.append(failure)

    def act_on(self, edges: Iterable[tuple[int, Commands]], before: Commands) -> Iterator[Change]:
        """What acts at and from the times [ns] of commands and failures, and before all of them."""
        return with_failures(self._system, edges, self._kept, before, NS)

    @property
    def repairs_of_reels(self) -> list[Happened]:
        """Those that are kept, in the order of time."""
        kept = [f for f in self._kept if f.kind == HEALTHY and f.place >= self._system.n]
        return sorted(kept, key=lambda repair: repair.time)

    def length_m(
        self, repair: Happened, edges: Iterable[tuple[int, Commands]], before: Commands
    ) -> float | None:
        """What is out [m] of a reel that is repaired; None if it has not failed by then.

        Other parameters as of `act_on`.
        """
        newest, others = None, [f for f in self._kept if f is not repair]
        for change in with_failures(self._system, edges, others, before, NS):
            if change.time <= repair.time:
                newest = change
        if newest is None or actuator_name(self._system, repair.place) not in dict(newest.failed):
            return None
        row = newest.commands.reel[repair.place - self._system.n]
        return float(reel_at(row, repair.time, NS)[0])

    def settle(self, now_ns: int, edges: Iterable[tuple[int, Commands]], before: Commands) -> None:
        """Note what the actuators do that have failed by now; forget what is past.

        Parameters
        ----------
        now_ns : int
            Simulation time [ns] of the newest state.
        edges : iterable of (int, Commands)
            What is commanded, from the earliest that may be stuck.
        before : Commands
            What acts before all of that.
        """
        if not self._kept:
            return
        newest, later = {}, []
        kept = settled(self._system, edges, self._kept, now_ns, before, NS)
        for failure in sorted(kept, key=lambda failure: failure.time):
            if failure.time > now_ns:
                later.append(failure)
            else:
                newest[failure.place] = failure
        self._kept = [f for f in newest.values() if f.kind != HEALTHY] + later

    def shift(self, by_ns: int) -> None:
        """Move all in time, as the clock is set anew."""
        self._kept = [failure._replace(time=failure.time + by_ns) for failure in self._kept]

    @property
    def arrays(self) -> dict[str, np.ndarray]:
        """All that it keeps, for a snapshot.

        Times, places, modes and whether it is known what they go on with, (k, 4); that, (k, 9).
        """
        rows, values = [], np.zeros((len(self._kept), 9))
        for i, f in enumerate(self._kept):
            known = f.held is not None
            rows.append((f.time, f.place, MODES.index(f.kind), known))
            if known:
                values[i, : f.held.size] = f.held.ravel()
        return {"failures": np.array(rows, dtype=np.int64).reshape(-1, 4), "held": values}

    @arrays.setter
    def arrays(self, arrays: dict[str, np.ndarray]) -> None:
        n, count = self._system.n, len(reel_names(self._system))
        allowed = {*np.flatnonzero(self._system.is_satellite).tolist(), *range(n, n + count)}
        self._kept = []
        for row, values in zip(arrays["failures"].tolist(), arrays["held"]):
            time_ns, place, mode, known = row
            if place not in allowed or not 0 <= mode < len(MODES) or known not in (0, 1):
                raise TssError(f"there is no failure {mode} of actuator {place}")
            values = values.reshape(3, 3) if place < n else values[:2]
            self._kept.append(Happened(time_ns, place, MODES[mode], values if known else None))


def news(
    system: System, before: Change | None, change: Change, begins_run: bool = False
) -> Iterator[tuple[str, str]]:
    """Tethers that have been cut and actuators that have failed or been repaired.

    Parameters
    ----------
    system : System
    before, change : Change
        What acted before, if anything did, and what acts now, from a simulation time [ns] on.
    begins_run : bool
        Whether a run begins by it; what that mends is not told.

    Yields
    ------
    tuple of str and str
        Kind of the event, as SimulationEvent has it, and what has happened, in words.
    """
    at = f"at {change.time / 1e9:.9f} s"
    cut = set(before.commands.cut.nonzero()[0]) if before else set()
    for k in np.flatnonzero(change.commands.cut):
        if k not in cut:
            yield KIND_CUT, f"{system.tether_name[k]}: cut {at}"
    old, new = dict(before.failed if before else ()), dict(change.failed)
    for name in sorted({*old, *new}):
        mode = new.get(name, HEALTHY)
        mended = begins_run and mode == HEALTHY
        if mode != old.get(name, HEALTHY) and not mended:
            yield KIND_FAIL, f"{name}: {_WORDS[mode]} {at}"
