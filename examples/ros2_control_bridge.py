"""
Fly a formation with ros2_control
=================================

Hardware components of ros2_control that use topics speak ``sensor_msgs/JointState``. This node
stands between them and a simulator. A satellite has the joints ``satellite_1_x``, ``_y`` and ``_z``
along the axes of the orbit frame: place, speed, and the thrust as effort. A tether is a joint of
its own name: the length out and its rate. Start it beside ``tss sim``.
"""

import contextlib
import signal

import numpy as np
import rclpy
from geometry_msgs.msg import Vector3, Wrench, WrenchStamped
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState
from tss_interfaces.msg import BeadStates, TetherStates


class Bridge(Node):
    """Turns states into those of joints, and efforts and reel commands of joints into commands."""

    def __init__(self):
        super().__init__("ros2_control_bridge")
        self.thrusters, self.thrusting, self.reeled = {}, set(), set()
        self.states = self.create_publisher(JointState, "formation_states", 10)
        self.reels = self.create_publisher(JointState, "sim_node/cmd_tether", 10)
        self.create_subscription(BeadStates, "bead_states", self.on_beads, 10)
        self.create_subscription(TetherStates, "tether_states", self.on_tethers, 10)
        self.create_subscription(JointState, "formation_commands", self.on_commands, 10)

    def on_beads(self, beads):
        """Publish every bead as three joints."""
        names = [f"{name}_{axis}" for name in beads.name for axis in "xyz"]
        self.thrusting.update(names)
        self.publish(beads.header.stamp, names, beads.position_m, beads.velocity_m_s)

    def on_tethers(self, tethers):
        """Publish every whole tether as one joint: what is out of all its segments."""
        whole = [name.partition("_segment_")[0] for name in tethers.name]
        names = list(dict.fromkeys(whole))
        self.reeled.update(names)
        of = [names.index(name) for name in whole]
        lengths, rates = (
            np.bincount(of, x) for x in (tethers.rest_length_m, tethers.rest_rate_m_s)
        )
        self.publish(tethers.header.stamp, names, lengths.tolist(), rates.tolist())

    def publish(self, stamp, names, position, velocity):
        """Publish the states of some joints."""
        message = JointState(name=names, position=position, velocity=velocity)
        message.header.stamp = stamp
        self.states.publish(message)

    def on_commands(self, commands):
        """Pass the commands of one hardware component on: thrusters', or reels'.

        Its stamps are of a wall clock. Without one a command holds from the next step on.
        """
        known = self.thrusting if commands.effort else self.reeled
        if not known:
            self.get_logger().warning("no states yet; commands are not passed on", once=True)
            return
        if unknown := sorted(set(commands.name) - known):
            kind = "thrust along" if commands.effort else "reel of"
            self.get_logger().error(
                f"no {kind} {', '.join(unknown)}; allowed: {', '.join(sorted(known))}."
                " Give thrusters and reels a hardware component each.",
                throttle_duration_sec=10.0,
            )
            return
        if not commands.effort:
            self.reels.publish(
                JointState(
                    name=commands.name, position=commands.position, velocity=commands.velocity
                )
            )
            return
        if len(commands.effort) != len(commands.name):
            self.get_logger().error(
                f"{len(commands.effort)} efforts are for {len(commands.name)} joints; allowed: one"
                " for each. Give thrusters and reels a hardware component each.",
                throttle_duration_sec=10.0,
            )
            return
        forces = {}
        for name, effort in zip(commands.name, commands.effort):
            satellite, _, axis = name.rpartition("_")
            forces.setdefault(satellite, {})[axis] = effort
        for satellite, force in forces.items():
            message = WrenchStamped(wrench=Wrench(force=Vector3(**force)))
            self.thruster(satellite).publish(message)

    def thruster(self, name):
        """The publisher of a satellite's commands."""
        if name not in self.thrusters:
            topic = f"sim_node/{name}/cmd_wrench"
            self.thrusters[name] = self.create_publisher(WrenchStamped, topic, 10)
        return self.thrusters[name]


if __name__ == "__main__":
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # ends as Ctrl-C does
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    executor = SingleThreadedExecutor()
    executor.add_node(Bridge())
    with contextlib.suppress(KeyboardInterrupt):
        while True:
            executor.spin_once(timeout_sec=0.1)
    rclpy.shutdown()
