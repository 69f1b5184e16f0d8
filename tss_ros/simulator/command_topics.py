"""The topics of commands: what a wrench may be, and what becomes of all that are given."""

import math
import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from geometry_msgs.msg import WrenchStamped
from rclpy.node import Node
from rclpy.publisher import Publisher

from tss_ros.core import System, TssError
from tss_ros.core.model.commands import FRAMES
from tss_ros.messages.wrenches import applied_wrenches
from tss_ros.ros.topics import Topic
from tss_ros.simulator.commands import Command
from tss_ros.simulator.failures import news
from tss_ros.simulator.odometry import is_topic_name, satellites
from tss_ros.simulator.reel_topics import ReelTopics
from tss_ros.simulator.simulation import Simulation

#: The topic of a satellite's wrenches.
WRENCH = "~/{satellite}/cmd_wrench"
#: Largest component of a force [N].
MAX_FORCE_N = 1e6
#: How far ahead [s] of the newest state a command may be.
FURTHEST_S = 86400.0
#: How long [s] nothing is said of one topic after a warning.
QUIET_S = 10.0


def read_time(stamp: Any, now_ns: int) -> int:
    """Simulation time [ns] of a command's stamp; one in the past stands for now.

    Raises
    ------
    TssError
        If it is too far ahead.
    """
    time_ns = stamp.sec * 10**9 + stamp.nanosec
    if time_ns > now_ns + FURTHEST_S * 1e9:
        raise TssError(
            f"stamp is {time_ns / 1e9:.9g} s; allowed: up to {FURTHEST_S:g} s after the newest"
            f" step's {now_ns / 1e9:.9g} s"
        )
    return max(time_ns, 0)


def read_wrench(message: WrenchStamped, prefix: str) -> tuple[int, np.ndarray]:
    """Index into `FRAMES` and force [N] of a command.

    Raises
    ------
    TssError
        If it is none that can be applied.
    """
    name = message.header.frame_id.removeprefix(prefix) or FRAMES[0]
    if name not in FRAMES:
        raise TssError(
            f"frame_id is {message.header.frame_id!r:.80}; allowed: {', '.join(FRAMES)}, or ''"
            f" for {FRAMES[0]}"
        )
    torque, force = ([v.x, v.y, v.z] for v in (message.wrench.torque, message.wrench.force))
    if any(torque):
        raise TssError(f"torque is {torque}; allowed: 0, for beads have no attitude")
    if not all(abs(value) <= MAX_FORCE_N for value in force):
        raise TssError(f"force is {force}; allowed: -{MAX_FORCE_N:g} to {MAX_FORCE_N:g} N in each")
    return FRAMES.index(name), np.array(force)


class CommandTopics:
    """Takes `~/<satellite>/cmd_wrench` and commands to reels, and publishes what acts.

    Parameters
    ----------
    node : rclpy.node.Node
    topics : mapping of str to Topic
        All of recording.yaml.
    publisher : Publisher
        Of AppliedWrenches.
    simulation : Simulation
    options : callable
        The node's parameters by name.
    """

    def __init__(
        self,
        node: Node,
        topics: Mapping[str, Topic],
        publisher: Publisher,
        simulation: Simulation,
        options: Callable[[], Mapping[str, Any]],
    ) -> None:
        self._node, self._topic, self._publisher = node, topics[WRENCH], publisher
        self._simulation, self._options = simulation, options
        self._subscriptions, self._said = {}, {}
        self._before, self._run = None, 0
        self._reels = ReelTopics(node, topics, simulation, options, read_time, self._warn)

    def begin(self, system: System) -> None:
        """Listen for a run's satellites; in the executor's thread, or before it spins."""
        names = satellites(system)
        for name in set(self._subscriptions) - set(names):
            self._node.destroy_subscription(self._subscriptions.pop(name))
        for name in names:
            if not is_topic_name(name):
                self._warn(name, "takes no commands: a topic may not have its name")
            elif name not in self._subscriptions:
                self._subscriptions[name] = self._node.create_subscription(
                    WrenchStamped,
                    self._topic.name.format(satellite=name),
                    lambda message, name=name: self._on_wrench(name, message),
                    self._topic.qos,
                )

    def drain(self) -> None:
        """Take all commands that have arrived; the executor takes one at a time."""
        for name, subscription in self._subscriptions.items():
            with subscription.handle:
                while taken := subscription.handle.take_message(WrenchStamped, False):
                    self._on_wrench(name, taken[0])
        self._reels.drain()

    def publish(self, system: System, step: int, run: int, frame_id: str) -> list[tuple[str, str]]:
        """Publish what has come to act since the step before; in the simulation's thread.

        Returns
        -------
        list of (str, str)
            Kinds and texts of events: tethers that were cut, actuators that failed.
        """
        events = []
        for change in self._simulation.take_changes():
            self._publisher.publish(applied_wrenches(system, change, step, run, frame_id))
            self._reels.tell(system, change.commands)
            events += news(system, self._before, change, run != self._run)
            self._before, self._run = change, run
        return events

    def _on_wrench(self, name, message):
        options, simulation = self._options(), self._simulation
        system = simulation.setup.system
        try:
            frame, force_n = read_wrench(message, options["frame_prefix"])
            time_ns = read_time(message.header.stamp, simulation.newest.time_ns)
            if name not in system.bead_name:
                raise TssError("there is no such satellite any more")
            size, limit = float(np.linalg.norm(force_n)), options["command_limit_n"]
            if 0.0 < limit < size:
                force_n *= limit / size
                self._warn(name, f"{size:g} N scaled back to command_limit_n, {limit:g} N")
            place = system.bead_name.index(name)
            if not simulation.commands.post(
                Command(time_ns, place, frame, tuple(force_n.tolist()))
            ):
                raise TssError("too many commands of the future are kept; it is not")
        except TssError as error:
            self._warn(name, f"command refused: {error}")

    def _warn(self, name, text):
        """Log a warning, unless there was one about this satellite or tether just now.

        What is refused and what limits make of a command do not keep each other quiet.
        """
        now, about = time.monotonic(), (name, text.startswith("command refused"))
        due, more = self._said.get(about, (-math.inf, 0))
        if now < due:
            self._said[about] = due, more + 1
            return
        self._said[about] = now + QUIET_S, 0
        before = f"; {more} more about it were not shown" if more else ""
        self._node.get_logger().warning(f"{name}: {text}{before}")
