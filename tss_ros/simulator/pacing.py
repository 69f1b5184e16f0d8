"""Keeps simulation time in step with the wall clock, and measures how well that goes."""

import math
import threading
import time

#: A simulator this far [s] behind the wall clock stops trying to catch up.
MAX_LAG_S = 0.5


class Pace:
    """Says when a state is due; `time_scale` may be changed at any time, in any thread.

    Parameters
    ----------
    time_scale : float
        Simulated seconds per wall second; 0: as fast as possible.
    """

    def __init__(self, time_scale: float) -> None:
        self.time_scale = time_scale
        self._held_scale = None

    def restart(self) -> None:
        """Count from the next time that `wait_s` is asked about."""
        self._held_scale = None

    def wait_s(self, time_s: float) -> float:
        """How long [s] to wait until simulation time `time_s` is due; below 0 when it is late."""
        now, scale = time.monotonic(), self.time_scale
        if scale != self._held_scale:
            self._held_scale, self._begin = scale, (now, time_s)
        begin_wall_s, begin_s = self._begin
        return begin_wall_s + (time_s - begin_s) / scale - now if scale else 0.0


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
