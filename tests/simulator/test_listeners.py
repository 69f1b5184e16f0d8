"""A simulator among recorders and subscribers that come late, are slow, stop or die."""

import signal
import sys
import time

import numpy as np
import pytest
import ros_harness
from recorded import messages_by_topic, recorded_steps
from rosgraph_msgs.msg import Clock
from simulation_interfaces.srv import StepSimulation
from tss_interfaces.srv import Disturb, GetStates

from tss_ros.bags.verify import verify
from tss_ros.ros.topics import read_topics
from tss_ros.simulator.sim_node import STATE_TOPICS

SUBSCRIBER = f"""#!{sys.executable}
import rclpy
from tss_interfaces.msg import BeadStates
rclpy.init()
node = rclpy.create_node("subscriber")
node.create_subscription(BeadStates, "bead_states", lambda message: print("got", flush=True), 10)
rclpy.spin(node)
"""


def test_late_and_slow_recorder_gets_every_step_from_then_on(start):
    """Without a recorder the simulator runs freely; with one it waits for it when need be."""
    simulator = start("sim_node", time_scale=0)
    bag = simulator.directory / "bag" / "bag_0.mcap"
    with ros_harness.client_node() as (node, spin_until):
        arrivals = {}  # when each time arrived first
        node.create_subscription(
            Clock,
            "/clock",
            lambda m: arrivals.setdefault((m.clock.sec, m.clock.nanosec), time.monotonic()),
            10,
        )
        spin_until(lambda: len(arrivals) > 5, ros_harness.START_S, "a running clock")
        logger = start("logger_node", output="bag")
        recorded = ros_harness.START_S, "a recording"
        spin_until(lambda: bag.exists() and bag.stat().st_size > 200_000, *recorded)
        logger.send(signal.SIGSTOP)
        newest = lambda: max(arrivals.values())  # noqa: E731
        spin_until(lambda: time.monotonic() - newest() > 0.3, 1.5, "the simulator to wait")
        logger.send(signal.SIGCONT)
        spin_until(lambda: bag.stat().st_size > 500_000, *recorded)
    assert simulator.stop() == 0
    assert logger.stop() == 0
    assert " 0 lost" in logger.stdout, (logger.stdout, logger.stderr, simulator.stderr)
    messages = messages_by_topic(bag)
    for topic in ("/bead_states", "/tether_states"):
        steps = np.array([message.step for _, message in messages[topic]])
        assert steps[0] > 0 and len(steps) > 100
        np.testing.assert_array_equal(np.diff(steps), 1)


def test_simulator_outlives_a_killed_recorder(start):
    logger = start("logger_node", output="bag")
    simulator = start("sim_node", time_scale=0, wait_for_recorder=True)
    bag = logger.directory / "bag" / "bag_0.mcap"
    ros_harness.wait_until(
        lambda: bag.exists() and bag.stat().st_size > 200_000, ros_harness.START_S, "a recording"
    )
    logger.kill()
    with ros_harness.client_node() as (node, spin_until):
        clocks = []
        node.create_subscription(Clock, "/clock", lambda message: clocks.append(message.clock), 10)
        spin_until(lambda: clocks, 30, "the clock")
        simulator.wait_for_line("is silent; going on without it")
        seen = len(clocks)
        spin_until(lambda: len(clocks) > seen + 10, 10, "the clock going on")
    assert simulator.stop() == 0


@pytest.mark.long
def test_subscribers_that_stop_or_die_leave_no_gap(start, tmp_path):
    script = tmp_path / "subscriber"
    script.write_text(SUBSCRIBER)
    script.chmod(0o755)
    slow, dying = start(str(script)), start(str(script))
    logger = start("logger_node", output="bag")
    simulator = start("sim_node", time_scale=0, wait_for_recorder=True)
    bag = tmp_path / "bag" / "bag_0.mcap"
    for subscriber in (slow, dying):
        subscriber.wait_for_line("got")

    def grows(size):
        ros_harness.wait_until(lambda: bag.stat().st_size > size, 60, "the recording")
        return bag.stat().st_size

    size = grows(300_000)
    slow.send(signal.SIGSTOP)
    size = grows(size + 1_000_000)
    dying.kill()
    late = start(str(script))
    late.wait_for_line("got")
    grows(size + 1_000_000)
    slow.send(signal.SIGCONT)
    assert simulator.stop() == 0 and logger.stop() == 0
    assert " 0 lost" in logger.stdout
    for topic in ("/bead_states", "/tether_states"):
        steps = recorded_steps(tmp_path / "bag", topic)
        assert steps == list(range(len(steps))) and len(steps) > 1000


def test_who_comes_while_time_stands_still_gets_the_newest_step(start, client):
    """Also what is made for viewers only, and nothing twice in a bag."""
    node, spin_until = client
    logger = start("logger_node", output="bag")
    process = start("sim_node", start_paused=True, wait_for_recorder=True, publish_tf=False)
    simulator = ros_harness.Simulator(node, spin_until)
    simulator.do(StepSimulation, steps=4)
    newest = simulator.settled()
    with ros_harness.client_node() as (late, spin_late_until):
        got = {name: [] for name in STATE_TOPICS}
        for name, kept in got.items():
            late.create_subscription(read_topics()[name].message_class, name, kept.append, 10)
        spin_late_until(lambda: all(got.values()), 10, "the newest step on each topic")
        assert got["bead_states"] == [newest]
        assert got["tether_states"][0].step == newest.step
        for name in ("bead_cloud", "tether_lengths"):
            assert got[name][0].header.stamp == newest.header.stamp
        joints, (a, b) = got["tether_lengths"][0], np.reshape(newest.position_m, (-1, 3))[:2]
        u, v = np.reshape(newest.velocity_m_s, (-1, 3))[:2]
        length_m = np.linalg.norm(a - b)
        np.testing.assert_allclose(joints.position[0], length_m, rtol=1e-12)
        np.testing.assert_allclose(joints.velocity[0], (a - b) @ (u - v) / length_m, atol=1e-9)
    states = simulator.do(GetStates)
    assert states.beads == newest and states.tethers == got["tether_states"][0]
    simulator.do(Disturb, random_offset_m=1.0)
    disturbed = simulator.do(GetStates).beads
    shift_m = np.subtract(disturbed.position_m, newest.position_m)
    np.testing.assert_allclose(np.linalg.norm(shift_m), 1.0, rtol=1e-9)
    assert (disturbed.step, disturbed.header.stamp) == (newest.step, newest.header.stamp)
    simulator.do(StepSimulation, steps=2)
    simulator.settled()
    assert logger.stop() == 0 and process.stop() == 0
    assert " 0 lost" in logger.stdout
    assert verify(logger.directory / "bag").faults == ()
    for topic in ("/bead_states", "/tether_states"):
        assert recorded_steps(logger.directory / "bag", topic) == list(range(7))
