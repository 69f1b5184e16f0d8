"""Keeps a simulator from running further ahead of its recorders than their queues hold."""

import threading
import time
from typing import NamedTuple

#: A recorder that says nothing for this long [s] is gone.
SILENCE_S = 2.0
#: A recorder that has got nothing for this long [s] is not connected yet.
JOIN_S = 1.0


class Recorder(NamedTuple):
    """One recorder: newest step it has, when it was heard and since when it stands there [s]."""

    step: int
    heard: float
    since: float
    lost: int


class FlowControl:
    """What is published, and how far each recorder has come.

    Parameters
    ----------
    window : int
        Most steps that the simulator may be ahead.
    logger : rclpy logger
        Told when a recorder is given up.
    on_change : callable
        Called, in any thread, when `ready` may have become true.
    """

    def __init__(self, window, logger, on_change):
        self.published = -1
        self._window = window
        self._logger = logger
        self._on_change = on_change
        self._recorders = {}
        self._lock = threading.Lock()

    @property
    def recorders(self):
        """Copy of the recorders by output."""
        with self._lock:
            return dict(self._recorders)

    def on_status(self, status):
        """Take a RecorderStatus, in any thread."""
        now = time.monotonic()
        with self._lock:
            if not (status.recording and status.matched):
                self._recorders.pop(status.output, None)
            elif 0 <= status.last_step <= self.published:
                self._recorders[status.output] = Recorder(status.last_step, now, now, status.lost)
            else:
                # Nothing of this run has reached it: count from here, and again if that lasts,
                # because steps published before the middleware has joined both ends never arrive.
                begin = Recorder(self.published, now, now, 0)
                step, _, since, _ = self._recorders.get(status.output, begin)
                if now - since > JOIN_S:
                    step, since = self.published, now
                self._recorders[status.output] = Recorder(step, now, since, status.lost)
        self._on_change()

    def on_recorders_gone(self):
        """Go on without recorders, as the middleware says that the last one has left."""
        with self._lock:
            self._recorders.clear()
        self._on_change()

    def ready(self, drain=False):
        """Whether the next step may be published; with `drain`, whether all have everything."""
        if not self._recorders:
            return True
        ahead = 0 if drain else self._window - 1
        with self._lock:
            self._forget_silent()
            steps = [recorder.step for recorder in self._recorders.values()]
        return all(self.published - step <= ahead for step in steps)

    def _forget_silent(self):
        for output, recorder in list(self._recorders.items()):
            if time.monotonic() - recorder.heard > SILENCE_S:
                del self._recorders[output]
                self._logger.warning(f"the recorder of {output!r} is silent; going on without it")
