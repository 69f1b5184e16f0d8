"""A topic that is recorded: takes all messages that wait, and knows losses and malformed ones."""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

from rclpy.callback_groups import CallbackGroup
from rclpy.node import Node
from rclpy.waitable import NumberOfEntities, Waitable

from tss_ros.core import TssError
from tss_ros.messages import blocks
from tss_ros.messages.blocks import MAX_STEP, Block
from tss_ros.messages.cdr import stamp_ns, step_number
from tss_ros.recorder.taking import Taken, Taker
from tss_ros.recorder.wellformed import Form, Malformed
from tss_ros.ros.topics import Topic

#: A topic with more messages than this waiting lets the others have their turn.
DRAIN_LIMIT = 50
#: Publishers whose numbers are remembered.
MOST_PUBLISHERS = 100


class Message(NamedTuple):
    """A well-formed message, with the topic it came by, and its steps if it is a block of them."""

    topic: "RecordedTopic"
    taken: Taken
    block: Block | None = None


class _TakenElsewhere(CallbackGroup):
    """Keeps the executor from taking messages itself, as it would drop who sent them."""

    def can_execute(self, entity: Any) -> bool:
        """Never."""
        return False

    def beginning_execution(self, entity: Any) -> bool:
        """Never."""
        return False


class RecordedTopic(Waitable):
    """A subscription to serialised messages that hands over all that wait, not one at a time.

    Parameters
    ----------
    node : rclpy.node.Node
    topic : Topic
    on_messages : callable
        Called with a list of Message.
    on_malformed : callable
        Called with this object and the reason.

    Attributes
    ----------
    lost, malformed, repeated : int
        Messages that were lost on their way, those that were none of the type, and those that were
        recorded already.
    heard : int
        Messages that came.
    newest, newest_ns : bytes and int, or None
        Newest message that was recorded, and newest simulation time [ns] of the run at hand.
    """

    def __init__(
        self,
        node: Node,
        topic: Topic,
        on_messages: Callable[[list[Message]], None],
        on_malformed: Callable[["RecordedTopic", str], None],
    ) -> None:
        super().__init__(node.default_callback_group)
        self.topic, self.name = topic, topic.name
        self.of_simulator = topic.publisher == "sim_node"
        self.every_step = (
            self.of_simulator and topic.durability == "volatile" and not topic.optional
        )
        self.lost = self.malformed = self.repeated = self.heard = 0
        self.newest = self.newest_ns = None
        self._form, self._stamp_offset = Form(topic.type), topic.stamp_offset
        self._has_step = topic.name in ("bead_states", "tether_states")
        self._unpacker = blocks.Unpacker() if topic.name == blocks.TOPIC else None
        self._on_messages, self._on_malformed = on_messages, on_malformed
        self._next_number = {}
        self.subscription = node.create_subscription(
            topic.message_class,
            topic.name,
            lambda _: None,
            topic.qos,
            raw=True,
            callback_group=_TakenElsewhere(),
        )
        self._taker = Taker(self.subscription)
        node.add_waitable(self)

    @property
    def full_name(self) -> str:
        """Name with namespace."""
        return self.subscription.topic_name

    @property
    def reached_ns(self) -> float:
        """Simulation time [ns] up to which this topic holds nothing back.

        Before its first message that is -inf if somebody publishes it, as the middleware may repeat
        it seconds later than the others.
        """
        if self.newest_ns is not None:
            return self.newest_ns
        return -math.inf if self.subscription.get_publisher_count() else math.inf

    def waiting(self, limit: int | None = None) -> list[Message]:
        """Take the well-formed messages that wait, among the first `limit` of them."""
        messages = []
        for _ in range(limit or self.topic.depth):
            if (taken := self._taker.take()) is None:
                break
            self.heard += 1
            try:
                block = self._check(taken.data)
            except Malformed as error:
                self.malformed += 1
                self._on_malformed(self, str(error))
                self.count_lost(taken)  # itself it is not lost
            else:
                messages.append(Message(self, taken, block))
        return messages

    def time_ns(self, data: bytes) -> int | None:
        """Simulation time [ns] of a message, None where the type has no stamp."""
        return None if self._stamp_offset is None else stamp_ns(data, self._stamp_offset)

    def count_lost(self, taken: Taken) -> int:
        """Return, and add up, the messages that were dropped before this one.

        What was published before the first message of a publisher that arrived was never meant for
        this recorder.
        """
        if taken.number is None:
            return 0
        if len(self._next_number) > MOST_PUBLISHERS:
            self._next_number.clear()
        expected = self._next_number.get(taken.publisher, taken.number)
        self._next_number[taken.publisher] = taken.number + 1
        lost = max(0, taken.number - expected)
        self.lost += lost
        return lost

    def _check(self, data):
        self._form.check(data)
        if self._has_step and step_number(data) > MAX_STEP:
            raise Malformed(f"step is {step_number(data)}; allowed: 0 to {MAX_STEP}")
        try:
            return self._unpacker and self._unpacker.unpack(data)
        except TssError as error:
            raise Malformed(str(error)) from None

    # --- for the executor

    def is_ready(self, wait_set: Any) -> bool:
        """Whether there are messages."""
        return wait_set.is_ready("subscription", self._index)

    def take_data(self) -> list[Message]:
        """Take some of them."""
        return self.waiting(DRAIN_LIMIT)

    async def execute(self, taken_data: list[Message]) -> None:
        """Hand them over."""
        if taken_data:
            self._on_messages(taken_data)

    def get_num_entities(self) -> NumberOfEntities:
        """One subscription."""
        return NumberOfEntities(num_subs=1)

    def add_to_wait_set(self, wait_set: Any) -> None:
        """Wait for it."""
        self._index = wait_set.add_subscription(self.subscription.handle)
