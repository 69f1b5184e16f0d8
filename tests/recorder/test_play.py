"""A bag played back into ROS."""

import math
import time

import numpy as np
import old_bag
import pytest
import ros_harness
from ros_harness import START_S, Process
from rosgraph_msgs.msg import Clock
from small_bag import Bag
from std_srvs.srv import SetBool
from tss_interfaces.msg import BeadStates, SystemDescription

from tss_ros.ros.topics import read_topics

#: Steps of the bag, of which the first are passed over, and their period [s] of simulation time.
STEPS, FIRST, PERIOD_S = 400, 20, 0.25


@pytest.fixture
def bag(tmp_path):
    """A bag of two beads, with steps of simulation time."""
    bag = Bag(tmp_path / "bag")
    bag.describe()
    for number in range(STEPS):
        bag.step(number)
    bag.writer.close()
    return bag


def paused_player(node, spin_until):
    """A client of a paused player's service, once both sides of its topics know each other."""
    client = node.create_client(SetBool, "/play/pause")
    spin_until(client.service_is_ready, START_S, "the player")
    spin_until(lambda: node.count_publishers("/bead_states"), 10, "its topics")
    begun = time.monotonic()
    spin_until(lambda: time.monotonic() > begun + 1.5, 5, "its patience")
    return client


def test_playback_pauses_keeps_pace_and_repeats_every_message(bag, tmp_path):
    rate, begin_s = 50.0, FIRST * PERIOD_S
    with ros_harness.client_node() as (node, spin_until):
        got, described, clocks = [], [], []
        topics = read_topics()
        for name, kind, act in (
            ("bead_states", BeadStates, lambda m: got.append((time.monotonic(), m))),
            ("system_description", SystemDescription, described.append),
        ):
            node.create_subscription(kind, name, act, topics[name].qos)
        node.create_subscription(Clock, "/clock", clocks.append, 10)
        arguments = [str(bag.writer.directory), "--rate", str(rate), "--start", str(begin_s)]
        player = Process("play", tmp_path, [*arguments, "--paused"])
        try:
            client = paused_player(node, spin_until)
            assert got == []
            answer = client.call_async(SetBool.Request(data=False))
            spin_until(answer.done, 10, "an answer")
            spin_until(lambda: not player.running, 30, "the end")
            spin_until(lambda: got and got[-1][1].step == STEPS - 1, 10, "the last step")
        finally:
            player.kill()
    assert player.wait(0) == 0, player.stderr
    assert [message.step for _, message in got] == list(range(FIRST, STEPS))
    sent = np.array([message.position_m for _, message in got])
    written = np.array([beads.position_m for beads, _ in bag.written[FIRST:]])
    np.testing.assert_array_equal(sent, written)
    assert described[0].scenario == "pair" and clocks
    wall_s = got[-1][0] - got[0][0]
    pace = wall_s / ((STEPS - 1 - FIRST) * PERIOD_S / rate)
    assert 0.8 < pace < 4.0  # a busy machine may hold it up


def test_a_bag_made_before_the_laws_is_played_as_one_of_the_papers_law(tmp_path):
    bag = old_bag.make(tmp_path / "old", 5)
    with ros_harness.client_node() as (node, spin_until):
        beads, described, results = [], [], []
        topics = read_topics()
        for name, kept in (
            ("bead_states", beads),
            ("system_description", described),
            ("stability_results", results),
        ):
            topic = topics[name]
            node.create_subscription(topic.message_class, name, kept.append, topic.qos)
        player = Process("play", tmp_path, [str(bag.writer.directory), "--paused"])
        try:
            paused_player(node, spin_until).call_async(SetBool.Request(data=False))
            spin_until(lambda: not player.running, START_S, "the end")
            spin_until(lambda: len(beads) == 5 and described and results, 10, "every message")
        finally:
            player.kill()
    assert player.wait(0) == 0, player.stderr
    assert [message.step for message in beads] == list(range(5))
    assert beads[3].position_m == bag.written[3][0].position_m
    assert described[0].tether_law == "kelvin_voigt"
    assert len(described[0].law_parameter) == len(described[0].law_parameter_name) == 0
    assert described[0].damping_n_s_per_m.tolist() == [30.0]
    assert described[0].publish_period_s == 0.25
    (result,), expected = results, old_bag.RESULT
    assert result.tether_law == "kelvin_voigt" and math.isnan(result.pushing_share)
    assert result.family == expected.family
    assert result.multiplier_real == expected.multiplier_real
    (confirmation,) = result.confirmation
    assert confirmation.switches == 7 and math.isnan(confirmation.pushing_share)
    for name in ("spin_rate_ratio", "max_modulus", "verdict", "switches"):
        assert getattr(result, name) == getattr(expected, name)
