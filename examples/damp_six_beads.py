"""
Damp the swing of a ring with thrusters
=======================================

A controller is a node of its own. It hears where the satellites are and pushes them against their
motion relative to the ring that turns. Start it beside
``tss sim --ros-args -p scenario:=six_bead -p spin_rate_ratio:=-2.9 -p disturbance_m:=300.0``.
"""

import contextlib
import signal

import numpy as np
import rclpy
from geometry_msgs.msg import Vector3, Wrench, WrenchStamped
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from tss_interfaces.msg import BeadStates

GAIN_N_S_PER_M = 1.0


class Damper(Node):
    """Pushes each satellite against its velocity in the rigid turn that fits theirs best."""

    def __init__(self):
        super().__init__("damper")
        self.thrusters = {}
        self.create_subscription(BeadStates, "bead_states", self.on_states, 10)

    def on_states(self, states):
        """Push each satellite once."""
        satellites = [i for i, name in enumerate(states.name) if name.startswith("satellite")]
        r, v = (np.reshape(x, (-1, 3)) for x in (states.position_m, states.velocity_m_s))
        r, v = (x[satellites] - x[satellites].mean(axis=0) for x in (r, v))
        inertia = np.sum(r**2) * np.eye(3) - r.T @ r
        swing = v - np.cross(np.linalg.solve(inertia, np.cross(r, v).sum(axis=0)), r)
        for i, (x, y, z) in zip(satellites, (-GAIN_N_S_PER_M * swing).tolist()):
            message = WrenchStamped(wrench=Wrench(force=Vector3(x=x, y=y, z=z)))
            self.thruster(states.name[i]).publish(message)

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
    executor.add_node(Damper())
    with contextlib.suppress(KeyboardInterrupt):
        while True:
            executor.spin_once(timeout_sec=0.1)
    rclpy.shutdown()
