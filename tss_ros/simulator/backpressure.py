"""Keeps a simulator from running further ahead of its recorders than their queues hold."""

import math
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
#: Recorders that are kept account of.
MOST_RECORDERS = 100
#: A recorder that has come and says nothing yet is waited for in the same way for so long [s]; how
#: often [s] to look whether one has come; after so long [s] it is said that nothing comes.
COME_S, LOOK_S, UNHEARD_S = 2.0, 0.002, 3.0
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
    patience_s : float
        How long [s] a recorder that has no more steps than before may hold the simulator; 0: none
        may.
    present : callable
        How many recorders the middleware has found.
    """

    def __init__(
        self,
        window: int,
        logger: Logger,
        on_change: Callable[[], None],
        patience_s: float = math.inf,
        present: Callable[[], int] = lambda: 0,
    ) -> None:
        self._published, self._published_at = -1, time.monotonic()
        self._window = window
        self._logger = logger
        self._on_change = on_change
        self._patience_s = patience_s
        self._present, self._were_present = present, 0
        self._looked_at = self._come_at = -math.inf
        self._recorders = {}
        self._holding = {}  # by output: at which step it has held the simulator, and since when
        self._unheard = set()  # outputs of recorders that are known to get nothing
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
            elif output not in self._recorders and len(self._recorders) >= MOST_RECORDERS:
                return
            elif status.matched and 0 <= status.last_step <= self.published:
                self._recorders[output] = Recorder(
                    status.last_step, now, status.lost, matched=True, joining=False
                )
                self._unheard.discard(output)
            else:
                # Nothing of this run has reached it: count from where it was first heard.
                known = self._recorders.get(output)
                step = known.step if known and known.joining else self.published
                self._recorders[output] = Recorder(
                    step, now, status.lost, status.matched, joining=True
                )
        self._on_change()

    def check(self, topic: str) -> None:
        """Forget recorders if the last one has left; say if one is there but silent on `topic`."""
        self._look()
        if not self._were_present:
            with self._lock:
                self._recorders.clear()
            self._on_change()
        elif not self._recorders and time.monotonic() - self._come_at > UNHEARD_S:
            self._logger.warning(
                f"somebody publishes {topic}, but nothing comes; not waiting for that recorder",
                throttle_duration_sec=10.0,
            )

    def ready(self, drain: bool = False) -> bool:
        """Whether the next step may be published; with `drain`, whether all have everything."""
        if not self._patience_s:
            return True
        since_s = time.monotonic() - self._published_at
        if self._awaits_word() and since_s < JOIN_STEP_S:
            return False
        if not self._recorders:
            return True
        with self._lock:
            self._forget_silent()
            recorders = list(self._recorders.items())
        ahead = 0 if drain else self._window - 1
        for output, recorder in recorders:
            behind = self.published - recorder.step
            if recorder.joining:
                if behind > JOIN_STEPS:
                    self._say_unheard(output)
                    continue
                if drain and not behind:
                    continue
                if since_s < (JOIN_S if drain else JOIN_STEP_S):
                    return False
            elif behind > ahead and self._waits_for(output, recorder.step):
                return False
        return True

    def _awaits_word(self):
        """Whether a recorder came a moment ago and has not said where it stands."""
        now = time.monotonic()
        if now - self._looked_at > LOOK_S:
            self._look()
        return self._were_present > len(self._recorders) and now - self._come_at < COME_S

    def _look(self):
        self._looked_at, before = time.monotonic(), self._were_present
        self._were_present = self._present()
        if self._were_present > before:
            self._come_at = self._looked_at

    def _waits_for(self, output, step):
        """Whether a recorder that stands at this step has not held the simulator too long."""
        now = time.monotonic()
        held_at, since = self._holding.get(output, (None, now))
        if held_at != step:
            since = now
        elif 0.0 <= since < now - self._patience_s:
            since = -1.0
            self._logger.warning(
                f"the recorder of {output!r:.200} has been at step {step} for "
                f"{self._patience_s:g} s; going on without waiting for it"
            )
        self._holding[output] = step, since
        return since >= 0.0

    def _say_unheard(self, output):
        if output not in self._unheard:
            self._unheard.add(output)
            self._logger.warning(
                f"the recorder of {output!r:.200} reports, but has got none of the last "
                f"{JOIN_STEPS} steps; going on without waiting for it"
            )

    def _forget_silent(self):
        for output, recorder in list(self._recorders.items()):
            if time.monotonic() - recorder.heard > SILENCE_S:
                del self._recorders[output]
                self._holding.pop(output, None)
                self._unheard.discard(output)
                self._logger.warning(f"the recorder of {output!r} is silent; going on without it")
