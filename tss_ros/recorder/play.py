"""Plays a bag back into ROS, at the pace of simulation time; executable `play`."""

import argparse
import heapq
import math
import sys
import threading
import time
from pathlib import Path

import yaml
from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.utilities import remove_ros_args
from rosgraph_msgs.msg import Clock
from std_srvs.srv import SetBool

from tss_ros.bags.reader import bag_files, indexed_reader, open_complete
from tss_ros.command_line import Parser
from tss_ros.recorder.older import converter
from tss_ros.ros import messages
from tss_ros.ros.node import TssNode, run
from tss_ros.ros.topics import CLOCK_RATE_HZ, message_class

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
        for file in bag_files(options.bag):
            for channel, schema in _channels(file).values():
                if channel.topic in self._publisher:
                    continue
                qos = _qos(channel)
                self._renew[channel.topic] = converter(schema)
                self._publisher[channel.topic] = self.create_publisher(
                    message_class(schema.name), channel.topic, qos
                )
                if qos.durability == DurabilityPolicy.TRANSIENT_LOCAL:
                    self._latched.add(channel.topic)
        self._clock = self.create_publisher(Clock, "/clock", 1)
        self._clock_due = -math.inf
        self._stopping, self._playing = threading.Event(), threading.Event()
        if not options.paused:
            self._playing.set()
        self.create_service(SetBool, "~/pause", self._on_pause)
        self.get_logger().info(
            f"playing {options.bag} at {options.rate:g} times simulation time; service ~/pause"
        )

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
            count = sum(map(self._play_file, bag_files(self._options.bag)))
            deadline = time.monotonic() + LISTENER_FINISH_S
            for publisher in self._publisher.values():
                left_s = max(0.0, deadline - time.monotonic())
                publisher.wait_for_all_acked(Duration(seconds=left_s))
            if not self._stopping.is_set():
                print(f"{self._options.bag}: {count} messages played", flush=True)
                self.finish()
        except Exception as error:
            if not self._stopping.is_set() and self.context.ok():
                self.finish(error)

    def _play_file(self, file):
        count, begun, last_ns = 0, None, -1
        with file.open("rb") as stream:
            reader, _ = indexed_reader(stream)
            for topic, message in _as_published(reader):
                if self._stopping.is_set():
                    break
                if message.log_time < self._options.start * 1e9:
                    if topic in self._latched:
                        self._publish(topic, message.data)
                        count += 1
                    continue
                if begun is None or message.log_time < last_ns or not self._playing.is_set():
                    self._playing.wait()
                    begun = (time.monotonic(), message.log_time)
                last_ns = max(message.log_time, begun[1])
                simulated_s = (message.log_time - begun[1]) / 1e9
                wait_s = begun[0] + simulated_s / self._options.rate - time.monotonic()
                if wait_s > 0 and self._stopping.wait(wait_s):
                    break
                self._publish(topic, message.data)
                count += 1
                now = time.monotonic()
                if now >= self._clock_due:
                    self._clock.publish(messages.clock(message.log_time))
                    self._clock_due = now + 1.0 / CLOCK_RATE_HZ
        return count

    def _publish(self, topic, data):
        self._publisher[topic].publish(self._renew[topic](data))


def _as_published(reader):
    """Topic and message in the order of publication.

    Simulation time does not tell it, as a bag may hold several runs, each of which begins at 0, and
    a recorder takes many messages of one topic before it turns to the next.
    """
    waiting = []
    messages = reader.iter_messages(log_time_order=False)
    for i, (_, channel, message) in enumerate(messages):
        heapq.heappush(waiting, (message.publish_time, i, channel.topic, message))
        if len(waiting) > LOOKAHEAD:
            yield heapq.heappop(waiting)[2:]
    while waiting:
        yield heapq.heappop(waiting)[2:]


def _channels(file):
    """Channel and schema by channel number of a bag's file."""
    with open_complete(file) as stream:
        _, summary = indexed_reader(stream)
    return {i: (c, summary.schemas[c.schema_id]) for i, c in summary.channels.items()}


def _qos(channel):
    """The QoS a topic was recorded with; reliable and volatile if the bag does not say."""
    profiles = yaml.safe_load(channel.metadata.get("offered_qos_profiles", "")) or [{}]
    durability = profiles[0].get("durability", "volatile")
    if not isinstance(durability, str):  # rosbag2 before version 9 wrote numbers
        durability = "transient_local" if durability == 1 else "volatile"
    return QoSProfile(
        depth=max(1, profiles[0].get("depth", 10)),
        durability=DurabilityPolicy.get_from_short_key(durability),
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
