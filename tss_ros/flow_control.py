"""Keeps a simulator from running further ahead of its recorders than their queues hold."""

import math
import threading
import time

#: A recorder that says nothing for this long [s] is gone.
SILENCE_S = 2.0
#: A recorder that has got nothing for this long [s] is not connected yet.
JOIN_S = 1.0


class FlowControl:
    """What is published, and how far each recorder has come.

    Parameters
    ----------
    window : int
        Most steps that the simulator may be ahead.
    logger : rclpy logger
        Told when a recorder is given up.
    """

    def __init__(self, window, logger):
        self.published = -1
        self._window = window
        self._logger = logger
        self._recorders = {}
        self._stopped = False
        self._changed = threading.Condition()

    def on_status(self, status):
        """Take a RecorderStatus, in any thread."""
        now = time.monotonic()
        with self._changed:
            if not (status.recording and status.matched):
                self._recorders.pop(status.output, None)
            elif 0 <= status.last_step <= self.published:
                self._recorders[status.output] = (status.last_step, now, now)
            else:
                # Nothing of this run has reached it: count from here, and again if that lasts,
                # because steps published before the middleware has joined both ends never arrive.
                begin = (self.published, now, now)
                step, _, since = self._recorders.get(status.output, begin)
                if now - since > JOIN_S:
                    step, since = self.published, now
                self._recorders[status.output] = (step, now, since)
            self._changed.notify_all()

    def on_recorders_gone(self):
        """Go on without recorders, as the middleware says that the last one has left."""
        with self._changed:
            self._recorders.clear()
            self._changed.notify_all()

    def stop(self):
        """Let everyone who waits go."""
        with self._changed:
            self._stopped = True
            self._changed.notify_all()

    def wait_for_recorder(self, is_connected):
        """Return when a recorder records and `is_connected()` is true."""
        with self._changed:
            while not self._stopped and not (self._recorders and is_connected()):
                self._changed.wait(0.05)

    def wait(self):
        """Return when the next step may be published."""
        if self._recorders:
            self._wait(self._window - 1, math.inf)

    def wait_for_end(self, timeout_s):
        """Wait until the recorders have all that is published; say whether they have, in time."""
        return self._wait(0, timeout_s)

    def _wait(self, ahead, timeout_s):
        deadline = time.monotonic() + timeout_s
        with self._changed:
            while not self._stopped and time.monotonic() < deadline:
                self._forget_silent()
                if all(self.published - step <= ahead for step, _, _ in self._recorders.values()):
                    return True
                self._changed.wait(0.1)
        return False

    def _forget_silent(self):
        for output, (_, heard, _) in list(self._recorders.items()):
            if time.monotonic() - heard > SILENCE_S:
                del self._recorders[output]
                self._logger.warning(f"the recorder of {output!r} is silent; going on without it")
