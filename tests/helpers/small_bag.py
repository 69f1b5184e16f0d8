"""A bag of two beads and one tether, written without nodes."""

import array

import numpy as np
from rclpy.serialization import serialize_message
from std_msgs.msg import Header
from tss_interfaces.msg import BeadStates, SystemDescription, TetherStates

from tss_ros.bags.writer import BagWriter
from tss_ros.ros.messages import stamp
from tss_ros.ros.topics import read_topics

TOPICS = read_topics()
NUMBERS = np.random.default_rng(3)


class Bag:
    """A writer with the topics that carry numbers, and messages of two beads and one tether."""

    topics = ("system_description", "bead_states", "tether_states")

    def __init__(self, directory):
        self.writer = BagWriter(directory, "jazzy")
        self.written = []
        self._channel = {
            name: self.writer.add_topic(
                f"/{name}",
                topic.type,
                self.definition(topic),
                topic.type_hash,
                topic.offered_qos,
            )
            for name, topic in TOPICS.items()
            if name in self.topics
        }

    def fill(self, steps, chunk=0):
        """Describe the pair and write so many steps of it, the writer flushed after each chunk."""
        self.describe()
        for number in range(steps):
            self.step(number)
            if chunk and number % chunk == chunk - 1:
                self.writer.flush()
        self.writer.close()

    def definition(self, topic):
        return topic.definition

    def describe(self, spin_rate_ratio=-2.0, time_ns=0, **others):
        self.write(
            "system_description",
            SystemDescription(
                header=Header(stamp=stamp(time_ns), frame_id="orbit"),
                scenario="pair",
                bead_name=["a", "bb"],
                is_satellite=[True, False],
                mass_kg=[1.0, 2.0],
                tether_name=["t"],
                tether_ends=array.array("I", [0, 1]),
                rest_length_m=[10.0],
                axial_stiffness_n=[20.0],
                damping_n_s_per_m=[30.0],
                tether_law="kelvin_voigt",
                orbit_altitude_m=5e5,
                orbit_rate_rad_s=1e-3,
                spin_rate_ratio=spin_rate_ratio,
                reference_radius_m=[3.0, 4.0],
                disturbance_m=0.5,
                disturbance_seed=8,
                publish_period_s=0.25,
                **others,
            ),
            time_ns,
        )

    def step(self, number, with_beads=True, with_tether=True):
        time_ns = number * 250_000_000
        header = Header(stamp=stamp(time_ns), frame_id="orbit")
        beads = BeadStates(
            header=header,
            step=number,
            name=["a", "bb"],
            position_m=NUMBERS.normal(size=6).tolist(),
            velocity_m_s=NUMBERS.normal(size=6).tolist(),
            deviation=NUMBERS.normal(size=2).tolist(),
        )
        tethers = TetherStates(
            header=header,
            step=number,
            name=["t"],
            length_m=NUMBERS.normal(size=1).tolist(),
            tension_n=NUMBERS.normal(size=1).tolist(),
            taut=[bool(number % 2)],
        )
        if with_beads:
            self.write("bead_states", beads, time_ns)
        if with_tether:
            self.write("tether_states", tethers, time_ns)
        self.written.append((beads, tethers))

    def write(self, name, message, time_ns):
        data = message if isinstance(message, bytes) else bytes(serialize_message(message))
        self.writer.write(self._channel[name], data, time_ns, time_ns, 0)
