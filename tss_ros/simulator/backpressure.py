"""Keeps a simulator from running further ahead of its recorders than their queues hold."""

import threading
import time
from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

from tss_interfaces.msg import RecorderStatus

#: A recorder that says nothing for this long [s] is gone.
SILENCE_S = 2.0
#: While a recorder joins, steps go out this far [s] apart, so that what the middleware repeats, as
#: late as 3 s after it was lost, is still there; after so many steps it is not waited for any more.
JOIN_STEP_S, JOIN_STEPS = 0.05, 100
#: Steps that have not reached a joining recorder after this long [s] never will.
JOIN_S = 5.0


class Recorder(NamedTuple):
    """One recorder.

    step : newest step it has, or while it joins the newest one published when it was first heard
    heard : when it was last heard [s]
    lost : messages that it missed
    matched : whether it has found the simulator's topics
    joining : whether nothing of this run has reached it yet
    """

    step: int
    heard: float
    lost: int
    matched: bool
    joining: bool


class Logger(Protocol):
    """What is asked of a logger; rclpy's has it."""

    def info(self, message: str, **options: Any) -> object:
        """Log what goes as it should."""

    def warning(self, message: str, **options: Any) -> object:
        """Log what a user may want to change."""

    def error(self, message: str, **options: Any) -> object:
        """Log what has gone wrong."""


class FlowControl:
    """What is published, and how far each recorder has come.

    Parameters
    ----------
    window : int
        Most steps that the simulator may be ahead.
    logger : Logger
        Gets a warning when a recorder is given up.
    on_change : callable
        Called, in any thread, when `ready` may have become true.
    """

    def __init__(self, window: int, logger: Logger, on_change: Callable[[], None]) -> None:
        self._published, self._published_at = -1, time.monotonic()
        self._window = window
        self._logger = logger
        self._on_change = on_change
        self._recorders = {}
        self._lock = threading.Lock()

    @property
    def published(self) -> int:
        """The newest step that is published, -1 before the first."""
        return self._published

    @published.setter
    def published(self, step: int) -> None:
        self._published, self._published_at = step, time.monotonic()

    @property
    def recorders(self) -> dict[str, Recorder]:
        """Copy of the recorders by output."""
        with self._lock:
            return dict(self._recorders)

    def on_status(self, status: RecorderStatus) -> None:
        """Take a RecorderStatus, in any thread."""
        now, output = time.monotonic(), status.output
        with self._lock:
            if not status.recording:
                self._recorders.pop(output, None)
            elif status.matched and 0 <= status.last_step <= self.published:
                self._recorders[output] = Recorder(
                    status.last_step, now, status.lost, matched=True, joining=False
                )
            else:
                # Nothing of this run has reached it: count from where it was first heard.
                known = self._recorders.get(output)
                step = known.step if known and known.joining else self.published
                self._recorders[output] = Recorder(
                    step, now, status.lost, status.matched, joining=True
                )
        self._on_change()

    def on_recorders_gone(self) -> None:
        """Go on without recorders, as the middleware says that the last one has left."""
        with self._lock:
            self._recorders.clear()
        self._on_change()

    def ready(self, drain: bool = False) -> bool:
        """Whether the next step may be published; with `drain`, whether all have everything."""
        if not self._recorders:
            return True
        with self._lock:
            self._forget_silent()
            recorders = list(self._recorders.values())
        ahead = 0 if drain else self._window - 1
        since_s = time.monotonic() - self._published_at
        for recorder in recorders:
            behind = self.published - recorder.step
            if recorder.joining:
                if behind > JOIN_STEPS or drain and not behind:
                    continue
                if since_s < (JOIN_S if drain else JOIN_STEP_S):
                    return False
            elif behind > ahead:
                return False
        return True

    def _forget_silent(self):
        for output, recorder in list(self._recorders.items()):
            if time.monotonic() - recorder.heard > SILENCE_S:
                del self._recorders[output]
                self._logger.warning(f"the recorder of {output!r} is silent; going on without it")
