"""The topics of measurements: relative states of satellites, and tethers' ranges and tensions."""

import dataclasses
from collections.abc import Mapping
from typing import Any

from geometry_msgs.msg import Vector3
from rclpy.node import Node
from rclpy.publisher import Publisher
from std_msgs.msg import Header
from tss_interfaces.msg import RelativeStates, TetherMeasurements

from tss_ros.core import System
from tss_ros.ros.messages import stamp
from tss_ros.ros.topics import Topic, create_publisher
from tss_ros.simulator import odometry
from tss_ros.simulator.sensors import Sensors
from tss_ros.simulator.setup import Setup
from tss_ros.simulator.trajectory import Sample

#: The topics, in recording.yaml.
RELATIVE, TETHERS = "~/{satellite}/relative_states", "~/tether_measurements"


def check(options: Mapping[str, Any], system: System) -> None:
    """Check the parameter `sensor_period_s`.

    Raises
    ------
    TssError
        If there are sensors, and names of satellites cannot be names of topics.
    """
    if options["sensor_period_s"]:
        odometry.check_names("sensor_period_s above 0", system)


class SensorPublishers:
    """Publishes what is measured, as often as `sensor_period_s` says; nothing if that is 0.

    Parameters
    ----------
    node : rclpy.node.Node
    topics : mapping of str to Topic
        `RELATIVE` and `TETHERS` among them.
    frame_id : str
        Name of the orbit frame.
    """

    def __init__(self, node: Node, topics: Mapping[str, Topic], frame_id: str) -> None:
        self._node, self._topics, self._frame_id = node, topics, frame_id
        self._publishers = {}  # by observer; that of tethers by None
        self._sensors = self._measured = None

    def begin(self, setup: Setup) -> None:
        """Publish what a run's parameters ask for."""
        self._setup, self._measured = setup, None
        self._sensors = Sensors(setup.system, setup.options)
        wanted = {}
        if not setup.options["sensor_period_s"]:
            for name, value in setup.options.items():
                if value and ("_noise_" in name or "_bias_" in name):
                    self._node.get_logger().warning(
                        f"{name} is {value:g}, but sensor_period_s is 0: there are no sensors"
                    )
        else:
            wanted = {i: self._name_of(i) for i in self._sensors.satellites}
            wanted[None] = TETHERS
        for i in [i for i, p in self._publishers.items() if wanted.get(i) != p[0]]:
            self._node.destroy_publisher(self._publishers.pop(i)[1])
        for i, name in wanted.items():
            if i not in self._publishers:
                topic = self._topics[TETHERS if i is None else RELATIVE]
                own = dataclasses.replace(topic, name=name)
                self._publishers[i] = name, create_publisher(self._node, own)

    def listeners(self) -> dict[str, int]:
        """How many listen to each topic, by its name."""
        return {name: p.get_subscription_count() for name, p in self._publishers.values()}

    def publish(self, sample: Sample) -> None:
        """Publish the measurements of a state, if it is time, for those who listen."""
        if not self._sensors.due(sample.time_ns, self._setup.publish_period_s):
            return
        self._measured = sample
        for observer, (_, publisher) in self._publishers.items():
            if publisher.get_subscription_count():
                publisher.publish(self._message(observer))

    def publish_again(self, _: Sample, name: str) -> None:
        """Publish the newest measurements on the topic of this name, if it is one of these."""
        for observer, (own, publisher) in self._publishers.items():
            if own == name and self._measured is not None:
                publisher.publish(self._message(observer))

    @property
    def publishers(self) -> list[Publisher]:
        """Those of the run at hand."""
        return [publisher for _, publisher in self._publishers.values()]

    def _name_of(self, i):
        return RELATIVE.format(satellite=self._setup.system.bead_name[i])

    def _message(self, observer):
        sample, sensors, system = self._measured, self._sensors, self._setup.system
        header = Header(stamp=stamp(sample.time_ns), frame_id=self._frame_id)
        if observer is None:
            tension_n = sample.states.tension_n[sample.row]
            range_m, tension_n = sensors.ranges_and_tensions(
                sample.time_ns, sample.position_m, tension_n
            )
            names = [tether.name for tether in sensors.tethers]
            return TetherMeasurements(
                header=header, name=names, range_m=range_m.tolist(), tension_n=tension_n.tolist()
            )
        others, position_m, velocity_m_s = sensors.relative_states(
            observer, sample.time_ns, sample.position_m, sample.velocity_m_s
        )
        return RelativeStates(
            header=header,
            observer=system.bead_name[observer],
            name=[system.bead_name[i] for i in others],
            position=[Vector3(**dict(zip("xyz", row))) for row in position_m.tolist()],
            velocity=[Vector3(**dict(zip("xyz", row))) for row in velocity_m_s.tolist()],
        )
