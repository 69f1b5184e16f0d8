"""Keeps simulation time in step with the wall clock, and measures how well that goes."""

import math
import threading
import time

#: A simulator this far [s] behind the wall clock stops trying to catch up.
MAX_LAG_S = 0.5


class Pace:
    """A clock of simulation time that states must not overtake; for any thread.

    It runs while states follow each other and stands while they do not.

    Parameters
    ----------
    time_scale : float
        Simulated seconds per wall second; 0: as fast as possible.
    """

    def __init__(self, time_scale: float) -> None:
        self._lock = threading.Lock()
        self._scale, self._running = time_scale, False
        self._time_s, self._read_at = 0.0, time.monotonic()
        self._state_s, self._state_at = self._time_s, self._read_at
        self._late = False

    @property
    def time_scale(self) -> float:
        """As given; what is set applies from then on."""
        return self._scale

    @time_scale.setter
    def time_scale(self, value: float) -> None:
        with self._lock:
            self._read()
            self._scale = value

    def run(self, running: bool) -> None:
        """Let the clock run, or stand."""
        with self._lock:
            self._read()
            self._running = running

    def jump(self, time_s: float) -> None:
        """A state of this time [s] begins a run."""
        with self._lock:
            self._state_s, self._state_at = time_s, time.monotonic()
            self._time_s, self._read_at = time_s, self._state_at

    def reached(self, time_s: float) -> None:
        """The state of this time [s] is out."""
        with self._lock:
            self._read()
            self._state_s, self._state_at = time_s, self._read_at
            self._time_s = max(self._time_s, time_s)

    def hasten(self, time_s: float) -> None:
        """Make time [s] due when it would be had the clock run since the last state."""
        with self._lock:
            self._read()
            earned_s = self._state_s + (self._read_at - self._state_at) * self._scale
            self._time_s = max(self._time_s, min(time_s, earned_s))

    def give_up(self, time_s: float) -> None:
        """Make time [s] due now: what is late will not be caught up with."""
        with self._lock:
            self._read()
            self._time_s, self._late = time_s, True

    def wait_s(self, time_s: float) -> float:
        """How long [s] to wait until simulation time `time_s` is due; below 0 when it is late."""
        with self._lock:
            self._read()
            return (time_s - self._time_s) / self._scale if self._scale else 0.0

    def was_late(self) -> bool:
        """Whether anything was given up since the last call."""
        late, self._late = self._late, False
        return late

    def _read(self):
        now = time.monotonic()
        if self._running:
            self._time_s += (now - self._read_at) * self._scale
        self._read_at = now


class Meter:
    """How fast simulation time runs and what a step costs; for any thread."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._begin()

    def _begin(self):
        self._begun = time.monotonic()
        self._simulated_s = self._cost_s = 0.0
        self._steps = 0

    def add(self, simulated_s: float, cost_s: float) -> None:
        """Count one step: simulation time [s] that it took, and wall time [s]."""
        with self._lock:
            self._simulated_s += simulated_s
            self._cost_s += cost_s
            self._steps += 1

    def read(self) -> tuple[float, float]:
        """Real-time factor [-] and wall time per step [s] since the last call; NaN without one."""
        with self._lock:
            factor = self._simulated_s / max(time.monotonic() - self._begun, 1e-9)
            cost_s = self._cost_s / self._steps if self._steps else math.nan
            self._begin()
        return factor, cost_s
