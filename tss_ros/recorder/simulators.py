"""Which of several simulators on one graph is recorded, and what is said of the others."""

import collections
import time

from rclpy.impl.rcutils_logger import RcutilsLogger
from rclpy.node import Node

from tss_ros.recorder.recorded_topic import Message
from tss_ros.recorder.run_order import HOLD_S
from tss_ros.recorder.taking import SENDER_BYTES
from tss_ros.ros.topics import publishers

#: A simulator that is not heard for so long [s] has ended, whatever the graph says: it reports more
#: often than that. How often [s] the graph is asked at most.
GONE_S, ASK_S = 1.5, 0.2
#: Simulators whose latched messages are kept, for the case that they are recorded later.
MOST_OTHERS = 10
UNKNOWN = "a node of unknown name"


def is_told(count: int) -> bool:
    """Whether the log has a line for so many faults of one kind: for 1, 2, 4, 8, ... of them."""
    return count & (count - 1) == 0


class Simulators:
    """Lets the messages of one simulator pass: the first that is heard, until it has gone.

    Parameters
    ----------
    node : rclpy.node.Node
    logger : rclpy logger
    """

    def __init__(self, node: Node, logger: RcutilsLogger) -> None:
        self._left_out = collections.Counter()  # by sender
        self._node, self._logger = node, logger
        self._followed, self._heard, self._asked = None, 0.0, 0.0
        self._followed_before, self._changed = None, 0.0
        self._names = {}
        self._latched = collections.defaultdict(list)

    @property
    def left_out(self) -> dict[str, int]:
        """Messages of other simulators that were not recorded, by node."""
        counts = collections.Counter()
        for sender, count in self._left_out.items():
            counts[self._names.get(sender) or UNKNOWN] += count
        return counts

    def heard(self, sender: bytes) -> None:
        """Note that a process has reported."""
        if sender == self._followed:
            self._heard = time.monotonic()

    def recorded(self, messages: list[Message]) -> list[Message]:
        """Those of `messages` that are recorded, after older ones of a simulator that is new."""
        kept = []
        for message in messages:
            if message.topic.of_simulator and message.taken.sender != self._followed:
                if self._is_late(message):
                    kept.append(message)
                    continue
                if not self._follows(message):
                    self._leave_out(message)
                    continue
                kept += self._latched.pop(message.taken.sender, ())
            if message.topic.of_simulator:
                self._heard = time.monotonic()
            kept.append(message)
        return kept

    def _is_late(self, message):
        """Whether a message was on its way when the simulator that sent it had gone."""
        late = time.monotonic() - self._changed < HOLD_S
        return late and message.taken.sender == self._followed_before

    def _follows(self, message):
        """Follow the sender of a message if nobody is followed any more."""
        now, sender = time.monotonic(), message.taken.sender
        gone = self._followed is None or now - self._heard > GONE_S
        if not gone and now - self._asked > ASK_S:
            self._asked = now
            gone = self._followed not in self._senders(message.topic.full_name)
        if gone:
            self._followed_before, self._changed = self._followed, now
            self._followed = sender
        return gone

    def _leave_out(self, message):
        sender, topic = message.taken.sender, message.topic
        self._left_out[sender] += 1
        if topic.topic.durability == "transient_local":
            latched = self._latched[sender]
            latched.append(message)
            del latched[: -topic.topic.depth]
            if len(self._latched) > MOST_OTHERS:
                del self._latched[next(iter(self._latched))]
        if is_told(self._left_out[sender]):
            if not self._names.get(sender):
                self._senders(topic.full_name)
            name = self._names.get(sender) or UNKNOWN
            self._logger.error(
                f"another simulator, {name}, publishes {topic.full_name} as well; it is not "
                f"recorded, {self._left_out[sender]} messages so far; give each a namespace of "
                "its own"
            )

    def _senders(self, topic):
        """Senders of a topic; also learns their names."""
        names = {gid[:SENDER_BYTES]: name for gid, name in publishers(self._node, topic).items()}
        self._names.update(names)
        return names
