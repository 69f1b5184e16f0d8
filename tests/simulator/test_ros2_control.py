"""The topics that hardware components of ros2_control use, through the bridge of the examples."""

import signal
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import ros_harness
from pilot import LATCHED
from rclpy.qos import QoSProfile, qos_profile_sensor_data
from sensor_msgs.msg import JointState
from simulation_interfaces.srv import StepSimulation
from tss_interfaces.msg import AppliedWrenches

BRIDGE = Path(__file__).parents[2] / "examples" / "ros2_control_bridge.py"
SATELLITES = [f"satellite_{i}_{axis}" for i in (1, 2, 3) for axis in "xyz"]


class Component:
    """What JointStateTopicSystem of ros2_control does: latest states, commands of all its joints.

    Commands carry the wall clock's time, and only the arrays of the joints' own interfaces.
    """

    def __init__(self, simulator, joints, interface):
        self.joints, self.interface, self.latest = joints, interface, {}
        node = self.node = simulator.node
        self.commands = node.create_publisher(
            JointState, "/formation_commands", QoSProfile(depth=1)
        )
        node.create_subscription(
            JointState, "/formation_states", self._on_states, qos_profile_sensor_data
        )

    def _on_states(self, states):
        self.latest |= dict(zip(states.name, zip(states.position, states.velocity)))

    def write(self, values):
        message = JointState(name=self.joints, **{self.interface: list(map(float, values))})
        now = time.time_ns()
        message.header.stamp.sec, message.header.stamp.nanosec = now // 10**9, now % 10**9
        self.commands.publish(message)


@pytest.fixture
def bridge(tmp_path):
    process = ros_harness.Process(sys.executable, tmp_path, [BRIDGE])
    yield process
    assert process.stop(signal.SIGTERM) == 0


def test_hardware_components_push_satellites_and_move_reels(start, client, bridge):
    process = start("sim_node", start_paused=True, time_scale=0)
    simulator = ros_harness.Simulator(*client)
    simulator.join()
    applied = []
    simulator.node.create_subscription(
        AppliedWrenches, "/applied_wrenches", applied.append, LATCHED
    )
    thrusters = Component(simulator, SATELLITES, "effort")
    reels = Component(simulator, ["tether_1", "tether_2", "tether_3"], "velocity")

    def seen(wanted, what):
        """Step on, as the component's joints are written, until something shows."""

        def shows():
            thrusters.write([0.5, 0.0, -0.25] + 6 * [0.0])
            reels.write([-0.2, 0.0, 0.1])
            simulator.do(StepSimulation, steps=1)
            return wanted()

        simulator.spin_until(shows, ros_harness.START_S, what)

    seen(lambda: {*SATELLITES, *reels.joints} <= reels.latest.keys(), "states of all joints")
    seen(
        lambda: applied and any(applied[-1].force_n) and len(applied[-1].reel) == 10,
        "commands that act",
    )
    acts = applied[-1]
    assert acts.satellite == ["satellite_1"] and acts.force_n.tolist() == [0.5, 0.0, -0.25]
    rates = dict(zip(acts.reel_tether, np.reshape(acts.reel, (-1, 5))[:, 2]))
    assert rates == {"tether_1": -0.2, "tether_3": 0.1}
    seen(lambda: reels.latest["tether_1"][0] < 9_999.5, "a shorter tether")
    newest = simulator.settled()
    simulator.spin_until(
        lambda: reels.latest["satellite_3_z"] == (newest.position_m[8], newest.velocity_m_s[8]),
        10.0, "the joints of the newest state",
    )  # fmt: skip
    assert reels.latest["tether_1"][1] == -0.2 and reels.latest["tether_3"][0] > 10_000.0
    mixed = Component(simulator, [*SATELLITES, "tether_1"], "effort")

    def refused():
        mixed.commands.publish(JointState(name=mixed.joints, effort=[0.0] * 9, velocity=[0.1]))
        mixed.commands.publish(JointState(name=SATELLITES, effort=[0.0] * 8))
        words = "no thrust along tether_1; allowed: satellite_1_x", "8 efforts are for 9 joints"
        return all(word in bridge.stderr for word in words)

    simulator.spin_until(refused, ros_harness.START_S, "refusals of the bridge")
    thrusters.write(9 * [float("nan")])
    process.wait_for_line("command refused: force")
    assert process.running and bridge.running
    assert process.stop() == 0
