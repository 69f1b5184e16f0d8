"""Keeps the runs of a recording apart, whatever order their messages arrive in."""

import time
from collections.abc import Callable

from tss_ros.recorder.recorded_topic import Message, RecordedTopic

#: How long [s] a new run is held back for what is missing of the old one: as late as the middleware
#: repeats what was lost on its way.
HOLD_S = 3.0


class RunOrder:
    """Hands messages on, all of a run before the first of the next.

    A description that was sent after steps of the run at hand begins the next run. Each topic's
    messages arrive in the order in which they were sent, so the old run is complete once each topic
    with steps has one of the new run. Where another simulator follows, the new run waits for the
    whole of HOLD_S.

    Parameters
    ----------
    descriptions : RecordedTopic
    record : callable
        Called with each message.
    begin_run : callable
        Called before the first message of every run but the first.
    """

    def __init__(
        self,
        descriptions: RecordedTopic,
        record: Callable[[Message], None],
        begin_run: Callable[[], None],
    ) -> None:
        self._descriptions, self._record, self._begin_run = descriptions, record, begin_run
        self._in_run, self._first_sent_ns = set(), 0  # topics with steps; when the first was sent
        self._held, self._begun_ns, self._awaited = [], 0, set()
        self._held_at, self._sender = 0.0, b""  # who sent the steps of the run at hand

    def add(self, message: Message) -> None:
        """Take the next message."""
        topic, sent_ns, sender = message.topic, message.taken.sent_ns, message.taken.sender
        if self._held:
            another = self._held[0].taken.sender != self._sender
            if sender != self._sender if another else sent_ns >= self._begun_ns:
                self._held.append(message)
                if not another:
                    self._awaited.discard(topic)
                return
        # Who joins a run may hear of it after its first steps here.
        elif (
            topic is self._descriptions
            and self._in_run
            and (sent_ns > self._first_sent_ns or sender != self._sender)
        ):
            self._held, self._begun_ns, self._awaited = [message], sent_ns, self._in_run
            self._held_at = time.monotonic()
            return
        elif topic.every_step:
            if not self._in_run:
                self._first_sent_ns, self._sender = sent_ns, sender
            self._in_run.add(topic)
        self._record(message)

    def release(self, at_once: bool = False) -> None:
        """Go on to the next run if the old one is complete, or late, or `at_once` is true."""
        while self._held:
            late = time.monotonic() - self._held_at > HOLD_S
            if self._awaited and not (late or at_once):
                return
            held, self._held, self._in_run = self._held, [], set()
            self._begin_run()
            for message in sorted(held, key=lambda message: message.taken.sent_ns):
                self.add(message)
