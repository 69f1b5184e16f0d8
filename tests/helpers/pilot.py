"""A controller of a simulator over the middleware, for tests."""

from contextlib import contextmanager

import ros_harness
from geometry_msgs.msg import Vector3, Wrench, WrenchStamped
from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, QoSProfile
from simulation_interfaces.srv import StepSimulation
from tss_interfaces.msg import AppliedWrenches

LATCHED = QoSProfile(depth=1000, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def wrench(force=(0.0, 0.0, 0.0), frame="", stamp=None, torque=(0.0, 0.0, 0.0)):
    message = WrenchStamped(
        wrench=Wrench(
            force=Vector3(**dict(zip("xyz", force))), torque=Vector3(**dict(zip("xyz", torque)))
        )
    )
    message.header.frame_id = frame
    if stamp is not None:
        message.header.stamp = stamp
    return message


@contextmanager
def flown(start, client, controller, **parameters):
    """A controller of a paused simulator that goes as fast as it can, and ends well."""
    process = start("sim_node", start_paused=True, time_scale=0, **parameters)
    simulator = ros_harness.Simulator(*client)
    simulator.join()
    simulator.process, simulator.start = process, start
    yield controller(simulator)
    assert process.running and process.stop() == 0
    assert "Traceback" not in process.stderr, process.stderr


class Pilot:
    """A controller: it sends wrenches and hears what is applied."""

    def __init__(self, simulator, names=("satellite_1", "satellite_2", "satellite_3")):
        self.sim, self.applied = simulator, []
        node = simulator.node
        self.publishers = {
            name: node.create_publisher(WrenchStamped, f"/sim_node/{name}/cmd_wrench", 1000)
            for name in names
        }
        node.create_subscription(AppliedWrenches, "/applied_wrenches", self.applied.append, LATCHED)
        simulator.spin_until(
            lambda: all(p.get_subscription_count() for p in self.publishers.values()),
            ros_harness.START_S, "the topics of commands",
        )  # fmt: skip

    def send(self, *arguments, satellite="satellite_1", **options):
        self.publishers[satellite].publish(wrench(*arguments, **options))

    def step(self, count=1):
        """Take steps once all commands have arrived, and return the state after them."""
        for publisher in self.publishers.values():
            assert publisher.wait_for_all_acked(Duration(seconds=ros_harness.START_S))
        self.sim.do(StepSimulation, steps=count)
        return self.sim.settled()
