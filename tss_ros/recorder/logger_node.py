"""The recorder node: writes every recorded topic to a bag, and shows it in Rerun while it does."""

import collections
import os
import subprocess
import sys
import threading
import time

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.duration import Duration
from rclpy.serialization import deserialize_message
from rclpy.time import Time
from tss_interfaces.msg import RecorderStatus, SimulationStatus

from tss_ros.bags.records import BagError
from tss_ros.bags.recover import find_cut
from tss_ros.bags.verify import check_quickly
from tss_ros.bags.writer import BagWriter
from tss_ros.core.errors import TssError
from tss_ros.messages import blocks
from tss_ros.messages.cdr import step_number
from tss_ros.messages.topics import STATE_TOPICS
from tss_ros.recorder.optional_topics import OptionalTopics
from tss_ros.recorder.recorded_topic import RecordedTopic
from tss_ros.recorder.run_order import RunOrder
from tss_ros.recorder.simulators import Simulators, is_told
from tss_ros.recorder.watch import Watch
from tss_ros.ros import diagnostics, parameters
from tss_ros.ros.node import TssNode, run
from tss_ros.ros.topics import read_topics
from tss_ros.ros.words import check_words

FLUSH_PERIOD_S = 0.25
#: How often [s] to look for topics that are published only where parameters ask for it.
FIND_PERIOD_S = 0.25
#: How long [s] a running simulator is looked for before a recorder subscribes.
ANNOUNCE_S = 0.5
#: Reports go out this often [s], to show that the recorder lives, and after this many steps.
STATUS_PERIOD_S, STATUS_STEPS = 0.05, 20
DIAGNOSTICS_PERIOD_S = 1.0
LEFT_OUT = "left out of "
#: What is shown live of each step.
LIVE_TOPICS = ("tether_states", "bead_states")


class LoggerNode(TssNode):
    """Records into the directory `output`; see parameters.LOGGER."""

    def __init__(self):
        super().__init__("logger_node")
        options = parameters.read_parameters(self, parameters.LOGGER)
        if options["earth"] and not options["rerun"]:
            raise TssError("earth is true, but rerun is false: there is no viewer to show it in")
        output = options["output"] or time.strftime("bag_%Y%m%d_%H%M%S")
        self._writer = BagWriter(
            output,
            os.environ.get("ROS_DISTRO", "jazzy"),
            options["split_size_mb"] * 1e6,
            options["split_duration_s"],
        )
        topics = read_topics()
        self._live = None
        if options["rerun"]:
            from tss_ros.recorder.live_feed import LiveFeed  # loads what draws

            self._live = LiveFeed(self.get_logger(), options["earth"])
        self._last_step = self._reported_step = -1
        self._incomplete = collections.deque()  # (time, step) that not every topic has reached
        self._newest_ns = 0
        everything = {name: topic for name, topic in topics.items() if topic.recorded}
        recorded = {name: topic for name, topic in everything.items() if not topic.optional}
        self._channels = {}
        for topic in recorded.values():
            self._add_channel(topic)
        heard = dict(recorded)
        if options["in_bulk"]:
            heard = {name: t for name, t in recorded.items() if name not in STATE_TOPICS}
            heard[blocks.TOPIC] = topics[blocks.TOPIC]
        self._topics = []
        self._status = self.create_publisher(
            RecorderStatus, "recorder_status", topics["recorder_status"].qos
        )
        self._announce()
        self._topics += [
            RecordedTopic(self, topic, self._on_messages, self._on_malformed)
            for topic in heard.values()
        ]
        (self._descriptions,) = (t for t in self._topics if t.name == "system_description")
        self._order = RunOrder(self._descriptions, self._record, self._begin_run)
        self._simulators = Simulators(self, self.get_logger())
        self._watch = Watch(self._topics, self.get_logger())
        reports = topics["simulation_status"]
        optional = [topic for topic in everything.values() if topic.optional]
        self._optional = OptionalTopics(self, optional, self._on_found)
        self._reports = RecordedTopic(self, reports, self._on_reports, self._on_malformed)
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self._note_lost()
        self.every(FLUSH_PERIOD_S, self._flush)
        self.every(DIAGNOSTICS_PERIOD_S, self._diagnose)
        self.every(FIND_PERIOD_S, self._optional.look)
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
        self._on_messages([message for topic in self._topics for message in topic.waiting()])
        self._order.release(at_once=True)
        self._note_lost()
        self._writer.close()
        self._reporter.join(timeout=0.5)
        self._report(recording=False)
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

    def _add_channel(self, topic):
        self._channels[topic.name] = self._writer.add_topic(
            self.resolve_topic_name(topic.name),
            topic.type,
            topic.definition,
            topic.type_hash,
            topic.offered_qos,
        )

    def _on_found(self, topic):
        self._topics.append(RecordedTopic(self, topic, self._on_messages, self._on_malformed))
        self.get_logger().info(f"recording {topic.name}, too")

    def _flush(self):
        self._order.release()
        self._writer.flush()

    def _note_lost(self):
        """Keep what the bag will say about messages that are not in it up to date."""
        notes = self._writer.notes
        for name in [name for name in notes if name.startswith(LEFT_OUT)]:
            del notes[name]  # the names of simulators may have become known meanwhile
        notes["lost"] = str(self._lost)
        for topic in self._topics:
            notes[f"lost {topic.full_name}"] = str(topic.lost)
            if topic.malformed:
                notes[f"malformed {topic.full_name}"] = str(topic.malformed)
            if topic.repeated:
                notes[f"repeated {topic.full_name}"] = str(topic.repeated)
        for name, count in self._simulators.left_out.items():
            notes[LEFT_OUT + name] = str(count)

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

    def _on_malformed(self, topic, reason):
        if topic in self._topics:
            self._note_lost()
        if is_told(topic.malformed):
            self.get_logger().error(
                f"malformed message of {topic.full_name} left out, {topic.malformed} so far: "
                f"{reason}"
            )

    def _on_reports(self, messages):
        for taken in (message.taken for message in messages):
            self._simulators.heard(taken.sender)
            self._watch.on_status(deserialize_message(taken.data, SimulationStatus))

    def _on_messages(self, messages):
        # A description is sent before all else of its run, so it is here by now.
        messages += self._descriptions.waiting()
        if any(message.topic is self._descriptions for message in messages):
            messages.sort(key=lambda message: message.taken.sent_ns)
        for message in self._simulators.recorded(messages):
            self._order.add(message)
        self._order.release()

    def _begin_run(self):
        self._writer.next_file()
        self._incomplete.clear()
        self._last_step = -1
        for topic in self._topics:
            topic.newest_ns = None

    def _record(self, message):
        topic, taken, block = message
        data = taken.data
        if (time_ns := topic.time_ns(data)) is not None:
            self._newest_ns = topic.newest_ns = time_ns
        if lost := topic.count_lost(taken):
            self._note_lost()
            self.get_logger().warning(
                f"{lost} messages of {topic.name} were lost, {self._lost} in all"
            )
        if topic.every_step and data == topic.newest:
            # A simulator that stands still repeats it for those who come late.
            topic.repeated += 1
            self._note_lost()
            return
        topic.newest = data
        if block:
            self._record_block(block, taken)
            return
        number = (taken.number or 0) % 2**32
        if topic.name not in self._channels:
            self._add_channel(topic.topic)
        channel = self._channels[topic.name]
        self._writer.write(channel, data, self._newest_ns, taken.sent_ns, number)
        if self._live:
            self._live.take(topic.name, data)
        if topic.name == "bead_states":
            if self._incomplete and topic.newest_ns < self._incomplete[-1][0]:
                # Steps that begin anew without a description: time cannot tell what is missing yet.
                self._incomplete.clear()
            self._incomplete.append((topic.newest_ns, step_number(data)))
        # A topic may lag behind the others by seconds when the middleware repeats a message.
        slowest_ns = min(t.reached_ns for t in self._topics if t.every_step)
        while self._incomplete and self._incomplete[0][0] <= slowest_ns:
            self._last_step = self._incomplete.popleft()[1]
        self._report_steps()

    def _record_block(self, block, taken):
        columns = {self._channels[name]: rows for name, rows in block.columns.items()}
        self._newest_ns = int(block.time_ns[-1])
        self._writer.write_columns(columns, block.time_ns, taken.sent_ns, block.first_step + 1)
        if self._live:
            for rows in zip(*(block.columns[name] for name in LIVE_TOPICS)):
                for name, row in zip(LIVE_TOPICS, rows):
                    self._live.take(name, row.tobytes())
        self._last_step = block.first_step + len(block.time_ns) - 1
        self._report_steps()

    def _announce(self):
        """Tell a simulator that runs already of the recorder, before anything is subscribed to.

        Else it runs on at full speed while topics are found one by one, and its queues overflow.
        """
        until = time.monotonic() + ANNOUNCE_S
        while not self._status.get_subscription_count() and time.monotonic() < until:
            time.sleep(0.01)
        if self._status.get_subscription_count():
            self._report()
            self._status.wait_for_all_acked(Duration(seconds=ANNOUNCE_S))

    def _report_steps(self):
        if abs(self._last_step - self._reported_step) >= STATUS_STEPS:
            self._report()

    def _report_regularly(self):
        while not self._stopping.wait(STATUS_PERIOD_S):
            self._report()

    def _report(self, recording=True):
        self._reported_step = self._last_step
        status = RecorderStatus(
            stamp=Time(nanoseconds=time.time_ns()).to_msg(),
            output=str(self._writer.directory.absolute()),
            recording=recording,
            matched=bool(self._topics)
            and all(
                topic.subscription.get_publisher_count()
                for topic in self._topics
                if topic.of_simulator and not topic.topic.optional
            ),
            last_step=self._reported_step,
            messages=self._writer.message_count,
            lost=self._lost,
        )
        self._status.publish(status)

    def _diagnose(self):
        self._watch.look()
        self._note_lost()
        self._diagnostics.publish(
            diagnostics.of_recorder(
                self.get_fully_qualified_name(),
                self.get_clock().now().to_msg(),
                str(self._writer.path),
                self._writer.message_count,
                self._writer.notes,
                self._watch.complaint,
            )
        )


def main() -> None:
    """Executable `logger_node`."""
    about = "Record every topic of a simulator in a bag."
    check_words("logger_node", about, parameters.LOGGER)
    run(LoggerNode)
