"""What is published only where parameters ask for it and somebody listens: odometry, sensors."""

from collections.abc import Mapping
from typing import Any

from rclpy.node import Node
from rclpy.publisher import Publisher

from tss_ros.core import System
from tss_ros.messages.steps import FRAME_ID
from tss_ros.ros.topics import Topic
from tss_ros.simulator import odometry, sensor_topics
from tss_ros.simulator.reel_commands import Limits
from tss_ros.simulator.setup import Setup
from tss_ros.simulator.trajectory import Sample


def check(options: Mapping[str, Any], system: System) -> None:
    """Check the parameters that ask for it, and the limits of reels.

    Raises
    ------
    TssError
        If one does not fit the system, or another one.
    """
    Limits.of(options)
    odometry.check(options["odometry"], system)
    sensor_topics.check(options, system)


class ForListeners:
    """Publishes odometry and measurements; for the simulation's thread.

    Parameters
    ----------
    node : rclpy.node.Node
    topics : mapping of str to Topic
    frame_prefix : str
        Put before the name of every frame.
    """

    def __init__(self, node: Node, topics: Mapping[str, Topic], frame_prefix: str) -> None:
        self._sensors = sensor_topics.SensorPublishers(node, topics, frame_prefix + FRAME_ID)
        own = odometry.OdometryPublishers(node, topics[odometry.TOPIC], frame_prefix)
        self._all = own, self._sensors

    @property
    def recorder_listens(self) -> bool:
        """Whether somebody listens to each topic that is recorded."""
        return all(self._sensors.listeners().values())

    def begin(self, setup: Setup) -> None:
        """Publish what a run's parameters ask for."""
        for publishers in self._all:
            publishers.begin(setup)

    def listeners(self) -> dict[str, int]:
        """How many listen to each topic, by its name."""
        return {name: n for publishers in self._all for name, n in publishers.listeners().items()}

    def publish(self, sample: Sample) -> None:
        """Publish a state for those who listen."""
        for publishers in self._all:
            publishers.publish(sample)

    def publish_again(self, sample: Sample, name: str) -> None:
        """Publish the newest state on one topic, for those who come late."""
        for publishers in self._all:
            publishers.publish_again(sample, name)

    @property
    def recorded(self) -> list[Publisher]:
        """Publishers of what is recorded."""
        return self._sensors.publishers
