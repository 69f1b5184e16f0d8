"""The recorder node: writes every recorded topic to a bag, and shows it in Rerun while it does."""

import collections
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from tss_interfaces.msg import RecorderStatus

from tss_ros.bags.cdr import stamp_ns, step_number
from tss_ros.bags.records import BagError
from tss_ros.bags.recover import find_cut
from tss_ros.bags.verify import check_quickly
from tss_ros.bags.writer import BagWriter
from tss_ros.recorder.live_feed import LiveFeed
from tss_ros.ros import diagnostics, parameters
from tss_ros.ros.messages import stamp
from tss_ros.ros.node import TssNode, run
from tss_ros.ros.topics import Topic, read_topics

#: A topic with more messages than this waiting lets the others have their turn.
DRAIN_LIMIT = 50
FLUSH_PERIOD_S = 0.25
#: Reports go out this often [s], to show that the recorder lives, and after this many steps.
STATUS_PERIOD_S, STATUS_STEPS = 0.05, 20
DIAGNOSTICS_PERIOD_S = 1.0


class RecordedTopic:
    """A subscription to serialised messages whose callback takes all that wait, not one at a time.

    Parameters
    ----------
    node : rclpy.node.Node
    topic : Topic
    writer : BagWriter
    on_message : callable
        Called with this object, the serialised message and its middleware information.
    """

    def __init__(
        self,
        node: Node,
        topic: Topic,
        writer: BagWriter,
        on_message: Callable[["RecordedTopic", bytes, dict[str, Any]], None],
    ) -> None:
        self.name = topic.name
        self.stamp_offset = topic.stamp_offset
        self.of_simulator = topic.publisher == "sim_node"
        self.every_step = self.of_simulator and topic.durability == "volatile"
        self.lost = 0
        self._depth = topic.depth
        self._message_class = topic.message_class
        self._on_message = on_message
        self._next_number = None
        self.newest_ns = None
        self.subscription = node.create_subscription(
            topic.message_class, topic.name, self._take_waiting, topic.qos, raw=True
        )
        self.channel = writer.add_topic(
            self.subscription.topic_name,
            topic.type,
            topic.definition,
            topic.type_hash,
            topic.offered_qos,
        )

    def count_lost(self, number: int | None) -> int:
        """Return, and add up, the messages that were dropped before the one with this number.

        Numbers that begin anew belong to a new publisher, and what was published before the first
        message that arrived was never meant for this recorder.
        """
        if number is None:  # not every middleware counts
            return 0
        expected, self._next_number = self._next_number, number + 1
        lost = number - expected if expected is not None and number > expected else 0
        self.lost += lost
        return lost

    def take(self, limit: int | None = None) -> None:
        """Handle the messages that wait, up to `limit` of them."""
        for _ in range(limit or self._depth):
            taken = self.subscription.handle.take_message(self._message_class, True)
            if taken is None:
                return
            self._on_message(self, *taken)

    def _take_waiting(self, data, info):
        self._on_message(self, data, info)
        self.take(DRAIN_LIMIT)


class LoggerNode(TssNode):
    """Records into the directory `output`; see parameters.LOGGER."""

    def __init__(self):
        super().__init__("logger_node")
        options = parameters.read_parameters(self, parameters.LOGGER)
        output = options["output"] or time.strftime("bag_%Y%m%d_%H%M%S")
        self._writer = BagWriter(
            output,
            os.environ.get("ROS_DISTRO", "jazzy"),
            options["split_size_mb"] * 1e6,
            options["split_duration_s"],
        )
        topics = read_topics()
        self._live = LiveFeed(self.get_logger()) if options["rerun"] else None
        self._last_step = self._reported_step = -1
        self._incomplete = collections.deque()  # (time, step) that not every topic has reached
        self._newest_ns = 0
        self._topics = [
            RecordedTopic(self, topic, self._writer, self._on_message)
            for topic in topics.values()
            if topic.recorded
        ]
        self._status = self.create_publisher(
            RecorderStatus, "recorder_status", topics["recorder_status"].qos
        )
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self._note_lost()
        self.every(FLUSH_PERIOD_S, self._writer.flush)
        self.every(DIAGNOSTICS_PERIOD_S, self._diagnose)
        self._stopping = threading.Event()
        # Not a timer of the executor: a recorder that waits for its disk must be heard, too.
        self._reporter = threading.Thread(target=self._report_regularly, daemon=True)
        self._recovery = None
        self.get_logger().info(f"recording {len(self._topics)} topics to {self._writer.path}")

    def start(self) -> None:
        """Begin to report, to show, and to recover what earlier recorders left cut short."""
        self._reporter.start()
        if cut := find_cut(self._writer.directory.absolute().parent):
            threading.Thread(target=self._recover, args=(cut,), daemon=True).start()
        if self._live:
            self._live.start()

    def stop(self) -> None:
        """Write what has arrived and close the bag."""
        self._stopping.set()
        if self._recovery:
            self._recovery.terminate()  # the next start begins it anew
        for topic in self._topics:
            topic.take()
        self._writer.close()
        self._reporter.join(timeout=0.5)
        if self._live:
            self._live.stop()
        print(
            f"{self._writer.path}: {self._writer.message_count} messages, {self._lost} lost",
            flush=True,
        )
        if self._writer.is_complete:
            faults = check_quickly(self._writer.directory, self._writer.message_count)
            if faults:
                raise BagError(f"{self._writer.directory} is not as it was written: {faults[0]}")

    @property
    def _lost(self):
        return sum(topic.lost for topic in self._topics)

    def _note_lost(self):
        """Keep what the bag will say about losses up to date."""
        self._writer.notes["lost"] = str(self._lost)
        for topic in self._topics:
            self._writer.notes[f"lost {topic.subscription.topic_name}"] = str(topic.lost)

    def _recover(self, cut):
        """Recover bags in a process of its own, which does not slow the recording down."""
        self.get_logger().info(f"recovering {', '.join(map(str, cut))}")
        self._recovery = subprocess.Popen(
            [sys.executable, "-m", "tss_ros.bags.recover", *cut],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        for line in self._recovery.communicate()[0].splitlines():
            self.get_logger().warning(line)

    def _on_message(self, topic, data, info):
        if topic.stamp_offset is not None:
            self._newest_ns = topic.newest_ns = stamp_ns(data, topic.stamp_offset)
        number = info["publication_sequence_number"]
        if lost := topic.count_lost(number):
            self._note_lost()
            self.get_logger().warning(
                f"{lost} messages of {topic.name} were lost, {self._lost} in all"
            )
        sent_ns = info["source_timestamp"]
        self._writer.write(topic.channel, data, self._newest_ns, sent_ns, (number or 0) % 2**32)
        if self._live:
            self._live.take(topic.name, data)
        if topic.name == "bead_states":
            if self._incomplete and topic.newest_ns < self._incomplete[-1][0]:
                # The simulator was reset or started anew: time cannot tell what is missing yet.
                self._incomplete.clear()
            self._incomplete.append((topic.newest_ns, step_number(data)))
        # A topic may lag behind the others by seconds when the middleware repeats a message.
        newest = [t.newest_ns for t in self._topics if t.every_step]
        slowest_ns = min((time for time in newest if time is not None), default=-1)
        while self._incomplete and self._incomplete[0][0] <= slowest_ns:
            self._last_step = self._incomplete.popleft()[1]
        if abs(self._last_step - self._reported_step) >= STATUS_STEPS:
            self._report()

    def _report_regularly(self):
        while not self._stopping.wait(STATUS_PERIOD_S):
            self._report()

    def _report(self):
        self._reported_step = self._last_step
        status = RecorderStatus(
            stamp=stamp(time.time_ns()),
            output=str(self._writer.directory.absolute()),
            recording=True,
            matched=all(
                topic.subscription.get_publisher_count()
                for topic in self._topics
                if topic.of_simulator
            ),
            last_step=self._reported_step,
            messages=self._writer.message_count,
            lost=self._lost,
        )
        try:
            self._status.publish(status)
        except Exception:
            if self.context.ok():  # else a signal ended the context a moment ago
                raise

    def _diagnose(self):
        self._diagnostics.publish(
            diagnostics.of_recorder(
                self.get_fully_qualified_name(),
                self.get_clock().now().to_msg(),
                str(self._writer.path),
                self._writer.message_count,
                self._writer.notes,
            )
        )


def main() -> None:
    """Executable `logger_node`."""
    run(LoggerNode)
