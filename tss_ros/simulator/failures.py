"""Failures of actuators over simulated time, as they are declared, asked for, and kept."""

from collections.abc import Iterable, Iterator

import numpy as np

from tss_ros.core import Commands, System, TssError
from tss_ros.core.model.failures import HEALTHY, MODES, STUCK, Change, Happened, with_failures

#: As in SimulationEvent.
KIND_CUT, KIND_FAIL = "cut", "fail"
#: Most failures that are kept.
MOST_KEPT = 1000
#: What is said of an actuator in an event.
_WORDS = {mode: mode for mode in MODES} | {HEALTHY: "healthy again"}


class FailureTable:
    """Dead, stuck and repaired thrusters. For one thread.

    Only thrusters can fail so far, each by the index of its satellite's bead.

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
        return with_failures(self._system, edges, self._kept, before)

    def settle(self, now_ns: int, edges: Iterable[tuple[int, Commands]], before: Commands) -> None:
        """Note the forces of the thrusters that are stuck by now; forget what is past.

        Parameters
        ----------
        now_ns : int
            Simulation time [ns] of the newest state.
        edges : iterable of (int, Commands)
            What is commanded, from the earliest force that may be stuck.
        before : Commands
            What acts before all of that.
        """
        if not self._kept:
            return
        changes = {change.time: change.commands for change in self.act_on(edges, before)}
        newest, later = {}, []
        for failure in sorted(self._kept, key=lambda failure: failure.time):
            if failure.time > now_ns:
                later.append(failure)
                continue
            if failure.kind == STUCK and failure.force_n is None:
                force_n = changes[failure.time].force_n[:, failure.place]
                failure = failure._replace(force_n=force_n)
            newest[failure.place] = failure
        self._kept = [f for f in newest.values() if f.kind != HEALTHY] + later

    def shift(self, by_ns: int) -> None:
        """Move all in time, as the clock is set anew."""
        self._kept = [failure._replace(time=failure.time + by_ns) for failure in self._kept]

    @property
    def arrays(self) -> dict[str, np.ndarray]:
        """All that it keeps, for a snapshot.

        Times, places, modes and whether the force is known, (k, 4); forces (k, 3, 3).
        """
        known = [f.force_n is not None for f in self._kept]
        rows = [(f.time, f.place, MODES.index(f.kind), k) for f, k in zip(self._kept, known)]
        force_n = [f.force_n if k else np.zeros((3, 3)) for f, k in zip(self._kept, known)]
        return {
            "failures": np.array(rows, dtype=np.int64).reshape(-1, 4),
            "stuck_force_n": np.array(force_n, dtype=float).reshape(-1, 3, 3),
        }

    @arrays.setter
    def arrays(self, arrays: dict[str, np.ndarray]) -> None:
        satellites = np.flatnonzero(self._system.is_satellite)
        self._kept = []
        for row, force_n in zip(arrays["failures"].tolist(), arrays["stuck_force_n"]):
            time_ns, place, mode, known = row
            if place not in satellites or not 0 <= mode < len(MODES) or known not in (0, 1):
                raise TssError(f"there is no failure {mode} of bead {place}")
            self._kept.append(Happened(time_ns, place, MODES[mode], force_n if known else None))


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
