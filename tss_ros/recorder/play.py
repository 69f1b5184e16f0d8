"""Plays a bag back into ROS, at the pace of simulation time; executable `play`."""

import argparse
import heapq
import itertools
import math
import sys
import threading
import time
from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from rclpy.exceptions import InvalidTopicNameException
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.utilities import remove_ros_args
from rosgraph_msgs.msg import Clock
from std_srvs.srv import SetBool

from tss_ros.bags.directory import find_files
from tss_ros.bags.mcap_file import McapFile
from tss_ros.bags.recording import damage_in_words
from tss_ros.bags.records import BagError
from tss_ros.command_line import Parser
from tss_ros.core import TssError
from tss_ros.recorder.older import converter
from tss_ros.ros import messages
from tss_ros.ros.node import TssNode, run
from tss_ros.ros.topics import CLOCK_RATE_HZ, MAX_DEPTH, message_class, wait_until_acked
from tss_ros.scenarios.files import load_yaml

RCLError = rclpy_implementation.RCLError
#: ROS has 31 bits for seconds.
LATEST_NS = 2**31 * 10**9

#: Messages that are put into order: as many as wait for a recorder at most, in all topics.
LOOKAHEAD = 8000
#: How long [s] to wait at the end for those who listen.
LISTENER_FINISH_S = 2.0


class PlayNode(TssNode):
    """Publishes what a bag holds.

    Parameters
    ----------
    options : argparse.Namespace
        As `main` makes it.
    """

    def __init__(self, options: argparse.Namespace) -> None:
        super().__init__("play")
        self._options = options
        self._publisher, self._latched, self._renew = {}, set(), {}
        self._files, self._left_out = find_files(options.bag), {}
        for path in self._files.paths:
            with McapFile(path) as file:
                file.find_channels()
                for channel in file.channels.values():
                    if channel.topic not in (*self._publisher, *self._left_out):
                        self._offer(path, channel, file.schemas.get(channel.schema_id))
        for topic, reason in self._left_out.items():
            self.get_logger().warning(f"{topic!r:.200} is not played: {reason}")
        # A bag that has a clock of its own is played by that one.
        own = "/clock" in self._publisher
        self._clock = None if own else self.create_publisher(Clock, "/clock", 1)
        self._clock_due = -math.inf
        self._stopping, self._playing = threading.Event(), threading.Event()
        if not options.paused:
            self._playing.set()
        self.create_service(SetBool, "~/pause", self._on_pause)
        self.get_logger().info(
            f"playing {options.bag} at {options.rate:g} times simulation time; service ~/pause"
        )

    def _offer(self, path, channel, schema):
        """Make the publisher of a topic, or say why there is none."""
        kind = _class_of(schema.name) if schema else None
        if kind is None or channel.message_encoding != "cdr":
            name = schema.name if schema else "nothing that the file describes"
            self._left_out[channel.topic] = f"its type, {name!r:.200}, is not installed here"
            return
        try:
            qos = _qos(path, channel)
            publisher = self.create_publisher(kind, channel.topic, qos)
        except (InvalidTopicNameException, RCLError) as error:
            self._left_out[channel.topic] = " ".join(str(error).split())[:200]
            return
        self._renew[channel.topic] = converter(schema)
        self._publisher[channel.topic] = publisher
        if qos.durability == DurabilityPolicy.TRANSIENT_LOCAL:
            self._latched.add(channel.topic)

    def start(self) -> None:
        """Begin to play in a thread of its own."""
        self._thread = threading.Thread(target=self._play, daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """End playing."""
        self._stopping.set()
        self._playing.set()
        self._thread.join(timeout=0.5)

    def _on_pause(self, request, response):
        (self._playing.clear if request.data else self._playing.set)()
        response.success = True
        response.message = "paused" if request.data else "playing"
        return response

    def _play(self):
        try:
            self._stopping.wait(self._options.delay)
            damage = list(self._files.damage)
            count = sum(self._play_file(path, damage) for path in self._files.paths)
            wait_until_acked(self._publisher.values(), LISTENER_FINISH_S)
            if not self._stopping.is_set():
                print(f"{self._options.bag}: {count} messages played", flush=True)
                self.finish(BagError(damage_in_words(damage)) if damage else None)
        except Exception as error:
            if not self._stopping.is_set():
                self.finish(error)

    def _play_file(self, path, damage):
        count, begun, last_ns = 0, None, -1
        with McapFile(path) as file:
            for topic, log_time, data in _as_published(file, self._publisher):
                if self._stopping.is_set():
                    break
                if log_time < self._options.start * 1e9:
                    if topic in self._latched:
                        self._publish(topic, data)
                        count += 1
                    continue
                if begun is None or log_time < last_ns or not self._playing.is_set():
                    self._playing.wait()
                    begun = (time.monotonic(), log_time)
                last_ns = max(log_time, begun[1])
                simulated_s = (log_time - begun[1]) / 1e9
                wait_s = begun[0] + simulated_s / self._options.rate - time.monotonic()
                if wait_s > 0 and self._stopping.wait(min(wait_s, threading.TIMEOUT_MAX)):
                    break
                self._publish(topic, data)
                count += 1
                now = time.monotonic()
                if self._clock and now >= self._clock_due:
                    self._clock.publish(messages.clock(log_time))
                    self._clock_due = now + 1.0 / CLOCK_RATE_HZ
            damage += file.damage
        return count

    def _publish(self, topic, data):
        self._publisher[topic].publish(self._renew[topic](data))


def _as_published(file, topics):
    """Topic, log time and data of the messages of some topics, in the order of publication.

    Simulation time does not tell it, as a bag may hold several runs, each of which begins at 0, and
    a recorder takes many messages of one topic before it turns to the next.
    """
    waiting, number = [], itertools.count()
    for batch in file.batches():
        latest_ns = int(batch.heads["log_time"].max())
        if latest_ns >= LATEST_NS:
            raise BagError(
                f"{str(file.path)!r} has a message of {latest_ns / 1e9:g} s; allowed: less than "
                f"{LATEST_NS / 1e9:g} s"
            )
        for i, head in enumerate(batch.heads[["channel", "publish_time", "log_time"]].tolist()):
            channel, publish_time, log_time = head
            if (topic := file.channels[channel].topic) in topics:
                entry = (publish_time, next(number), topic, log_time, batch.payload(i))
                heapq.heappush(waiting, entry)
        while len(waiting) > LOOKAHEAD:
            yield heapq.heappop(waiting)[2:]
    while waiting:
        yield heapq.heappop(waiting)[2:]


def _class_of(type_name):
    """The class of a type, if it is one of an installed package of ROS; nothing else is loaded."""
    try:
        package, _, name = type_name.split("/")
        folder = Path(get_package_share_directory(package)) / "msg"
        return message_class(type_name) if (folder / f"{name}.msg").is_file() else None
    except (ValueError, LookupError, ImportError, AttributeError):
        return None


def _qos(path, channel):
    """The QoS a topic was recorded with; reliable and volatile if the bag does not say."""
    text = channel.metadata.get("offered_qos_profiles", "")
    profile = {}
    try:
        profiles = load_yaml(text, f"the QoS of {channel.topic!r:.200} in {str(path)!r}")
        profile = profiles[0] if profiles else {}
        durability, depth = profile.get("durability", "volatile"), profile.get("depth", 10)
    except (TssError, LookupError, TypeError, AttributeError) as error:
        raise BagError(f"{str(path)!r}: QoS of {channel.topic!r:.200}: {error}") from None
    if not isinstance(durability, str):  # rosbag2 before version 9 wrote numbers
        durability = "transient_local" if durability == 1 else "volatile"
    latched = durability == "transient_local"
    return QoSProfile(
        depth=min(max(1, depth), MAX_DEPTH) if isinstance(depth, int) else 10,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


def main() -> None:
    """Executable `play`."""
    parser = Parser(
        prog="play",
        description="Play a bag back into ROS. Pause and go on with "
        "`ros2 service call /play/pause std_srvs/srv/SetBool '{data: true}'`.",
    )
    parser.add_argument("bag", type=Path, help="bag directory or .mcap file")
    parser.add_argument(
        "--rate",
        type=float,
        default=1.0,
        help="simulated seconds per wall second; inf: as fast as it goes (default %(default)g)",
    )
    parser.add_argument(
        "--start", type=float, default=0.0, help="simulation time to start at [s] (default 0)"
    )
    parser.add_argument(
        "--delay",
        type=float,
        default=1.0,
        help="wall time before the first message, for listeners to join [s] (default %(default)g)",
    )
    parser.add_argument("--paused", action="store_true", help="start paused")
    options = parser.parse_args(remove_ros_args(sys.argv)[1:])
    if not options.rate > 0:
        parser.error(f"argument --rate is {options.rate:g}; allowed: more than 0")

    class Configured(PlayNode):
        def __init__(self):
            super().__init__(options)

    run(Configured)
