"""Odometry: every satellite as another one, or the centre of mass, sees it."""

import dataclasses
import re

import numpy as np
from nav_msgs.msg import Odometry
from rclpy.node import Node

from tss_ros.core import System, TssError
from tss_ros.ros.messages import stamp
from tss_ros.ros.topics import Topic, create_publisher
from tss_ros.simulator.setup import Setup
from tss_ros.simulator.trajectory import Sample

#: The topic of a satellite's odometry.
TOPIC = "{satellite}/odom"
#: What odometry may be relative to besides a satellite, and the name of its frame.
CENTRE_OF_MASS = "centre_of_mass"
_TOPIC_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")


def check(reference: str, system: System) -> None:
    """Check the parameter `odometry`.

    Raises
    ------
    TssError
        If it is no satellite, or if names of satellites cannot be names of topics.
    """
    if not reference:
        return
    names = satellites(system)
    if reference not in (CENTRE_OF_MASS, *names):
        raise TssError(
            f"odometry is {reference!r:.80}; allowed: '', {CENTRE_OF_MASS!r} or a satellite of "
            f"{', '.join(names):.200}"
        )
    check_names("odometry", system)


def check_names(what: str, system: System) -> None:
    """Check that topics may have the names of all satellites, as `what` needs.

    Raises
    ------
    TssError
        If one is no name of a topic.
    """
    for name in satellites(system):
        if not is_topic_name(name):
            raise TssError(
                f"{what} needs names that topics may have; {name!r:.80} is none: letters, "
                "digits and _ only, no digit first"
            )


def is_topic_name(name: str) -> bool:
    """Whether a topic may have the name of a satellite."""
    return bool(_TOPIC_NAME.fullmatch(name))


def satellites(system: System) -> list[str]:
    """Names of the satellites."""
    return [system.bead_name[i] for i in np.flatnonzero(system.is_satellite)]


def centre_of_mass(system: System, values: np.ndarray) -> np.ndarray:
    """Mean of vectors, shape (n, 3), weighted by the masses of the beads."""
    return system.mass_kg @ values / system.mass_kg.sum()


class OdometryPublishers:
    """A publisher for each satellite but the one that the others are relative to.

    Parameters
    ----------
    node : rclpy.node.Node
    topic : Topic
        Its name holds "{satellite}".
    frame_prefix : str
        Put before the name of every frame.
    """

    def __init__(self, node: Node, topic: Topic, frame_prefix: str) -> None:
        self._node, self._topic, self._prefix = node, topic, frame_prefix
        self._publishers, self._messages = {}, {}

    def begin(self, setup: Setup) -> None:
        """Publish what a run's parameter `odometry` asks for."""
        system, reference = setup.system, setup.options["odometry"]
        self._system, self._reference = system, reference
        names = [name for name in satellites(system) if reference and name != reference]
        topics = {self._topic.name.format(satellite=name): name for name in names}
        for name in set(self._publishers) - set(topics):
            self._node.destroy_publisher(self._publishers.pop(name))
        for name in topics:
            if name not in self._publishers:
                own = dataclasses.replace(self._topic, name=name)
                self._publishers[name] = create_publisher(self._node, own)
        self._messages = {name: self._message(satellite) for name, satellite in topics.items()}

    def listeners(self) -> dict[str, int]:
        """How many listen to each topic, by its name."""
        return {name: p.get_subscription_count() for name, p in self._publishers.items()}

    def publish(self, sample: Sample) -> None:
        """Publish a state for those who listen."""
        self._publish(sample, [name for name, count in self.listeners().items() if count])

    def publish_again(self, sample: Sample, name: str) -> None:
        """Publish a state on the topic of this name, if it is one of these."""
        self._publish(sample, [name] if name in self._publishers else [])

    def _publish(self, sample, wanted):
        if not wanted:
            return
        r0, v0 = map(self._of_reference, (sample.position_m, sample.velocity_m_s))
        for topic in wanted:
            index, message = self._messages[topic]
            message.header.stamp = stamp(sample.time_ns)
            for vector, values in (
                (message.pose.pose.position, sample.position_m[index] - r0),
                (message.twist.twist.linear, sample.velocity_m_s[index] - v0),
            ):
                vector.x, vector.y, vector.z = values.tolist()
            self._publishers[topic].publish(message)

    def _of_reference(self, values):
        if self._reference == CENTRE_OF_MASS:
            return centre_of_mass(self._system, values)
        return values[self._system.bead_name.index(self._reference)]

    def _message(self, satellite):
        message = Odometry(child_frame_id=self._prefix + satellite)
        message.header.frame_id = self._prefix + self._reference
        return self._system.bead_name.index(satellite), message
