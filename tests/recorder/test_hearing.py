"""What a recorder hears: malformed messages, other simulators, silence, and its own deafness."""

import itertools
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import ros_harness
import yaml
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import serialize_message
from recorded import recorded_steps, serialised_messages
from tss_interfaces.msg import BeadStates, StepBlock, SystemDescription
from visualization_msgs.msg import MarkerArray

from tss_ros.bags.recording import read_bag
from tss_ros.recorder.watch import SILENT_S
from tss_ros.ros import network

#: Longest time [s] until something is said of a fault, on a busy machine.
SAID_S = SILENT_S + 7.0


def notes_of(bag):
    """What metadata.yaml says of a bag, beside what rosbag2 wants to know."""
    content = yaml.safe_load((bag / "metadata.yaml").read_text())
    return content["rosbag2_bagfile_information"]["custom_data"]


def recorded_so_far(bag, size):
    """A condition: the first file of a bag has so many bytes."""
    file = bag / f"{bag.name}_0.mcap"
    return lambda: file.exists() and file.stat().st_size > size


# --- malformed messages


def test_malformed_messages_are_left_out_and_named(start, tmp_path):
    """On four topics, of every sort; what the simulator publishes meanwhile is all recorded."""
    logger = start("logger_node", output="bag")
    simulator = start("sim_node", time_scale=400, publish_period_s=1, wait_for_recorder=True)
    latched = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    whole = serialize_message(BeadStates(step=7, name=["a"], position_m=[1.0, 2.0, 3.0]))
    absurd = bytearray(serialize_message(BeadStates()))
    absurd[20:28] = b"\xff" * 8  # the step, after the header
    sent = {
        "bead_states": (BeadStates, QoSProfile(depth=1000), [
            b"\0\1\0\0", whole[:20], whole[:-30], b"\xff" * 200, whole + bytes(64),
            whole[:4] + b"\xff" * (len(whole) - 4), bytes(absurd),
        ]),
        "markers": (MarkerArray, QoSProfile(depth=1000), [b"\0\1\0\0\xff\xff\xff\x7f"]),
        "system_description": (SystemDescription, latched, [b"\0\1\0\0abc", b"\0\1\0\0" * 50]),
    }  # fmt: skip
    with ros_harness.client_node() as (node, spin_until):
        spin_until(recorded_so_far(tmp_path / "bag", 100_000), ros_harness.START_S, "a recording")
        for topic, (kind, qos, datas) in sent.items():
            publisher = node.create_publisher(kind, topic, qos)
            spin_until(publisher.get_subscription_count, 20, "the recorder")
            found = time.monotonic()  # here; the recorder finds the publisher in a moment
            spin_until(lambda f=found: time.monotonic() > f + 1.0, 5, "a moment")
            for data in datas:
                publisher.publish(data)
        logger.wait_for_line("malformed message of /system_description left out")
        size = (tmp_path / "bag" / "bag_0.mcap").stat().st_size
        spin_until(recorded_so_far(tmp_path / "bag", size + 100_000), 20, "more steps")
    assert simulator.stop() == 0
    assert logger.stop() == 0, logger.stderr
    assert " 0 lost" in logger.stdout
    for topic in ("bead_states", "markers", "system_description"):
        assert f"malformed message of /{topic} left out, 1 so far: " in logger.stderr
    notes = notes_of(tmp_path / "bag")
    assert int(notes["tss_ros.malformed /bead_states"]) == 7
    assert notes["tss_ros.malformed /markers"] == "1"
    assert notes["tss_ros.malformed /system_description"] == "2"
    recording = read_bag(tmp_path / "bag")
    assert (recording.step == range(len(recording.step))).all() and len(recording.step) > 100


def test_malformed_blocks_are_left_out_and_named(start, tmp_path):
    logger = start("logger_node", output="bag", in_bulk=True)
    simulator = start("sim_node", time_scale=400, publish_period_s=1, wait_for_recorder=True)
    datas = [b"\0\1\0\0", b"\xff" * 200, bytes(serialize_message(StepBlock()))]
    datas.append(bytes(serialize_message(StepBlock(time_ns=[1], size=[1] * 5, data=[0] * 5))))
    with ros_harness.client_node() as (node, spin_until):
        spin_until(recorded_so_far(tmp_path / "bag", 100_000), ros_harness.START_S, "a recording")
        publisher = node.create_publisher(StepBlock, "step_blocks", 100)
        spin_until(publisher.get_subscription_count, 20, "the recorder")
        found = time.monotonic()
        spin_until(lambda: time.monotonic() > found + 1.0, 5, "a moment")
        for data in datas:
            publisher.publish(data)
        logger.wait_for_line("malformed message of /step_blocks left out, 4 so far: ")
        size = (tmp_path / "bag" / "bag_0.mcap").stat().st_size
        spin_until(recorded_so_far(tmp_path / "bag", size + 100_000), 20, "more steps")
    assert simulator.stop() == 0
    assert logger.stop() == 0, logger.stderr
    assert notes_of(tmp_path / "bag")["tss_ros.malformed /step_blocks"] == "4"
    recording = read_bag(tmp_path / "bag")
    assert (recording.step == range(len(recording.step))).all() and len(recording.step) > 100


# --- simulators


def test_a_second_simulator_is_named_and_left_out(start, tmp_path):
    logger = start("logger_node", output="bag")
    first = start("sim_node", time_scale=400, publish_period_s=1, wait_for_recorder=True)
    ros_harness.wait_until(
        recorded_so_far(tmp_path / "bag", 100_000), ros_harness.START_S, "a recording"
    )
    second = start("sim_node", "-r", "__node:=stranger", time_scale=100, spin_rate_ratio=-3.0)
    logger.wait_for_line("another simulator, /stranger, publishes /")
    logger.wait_for_line("not recorded, 64 messages so far")
    first.wait_for_line("2 nodes publish /bead_states: /sim_node, /stranger;")
    second.wait_for_line("2 nodes publish /bead_states: /sim_node, /stranger;")
    assert second.stop() == 0 and first.stop() == 0 and logger.stop() == 0
    assert " 0 lost" in logger.stdout
    assert int(notes_of(tmp_path / "bag")["tss_ros.left out of /stranger"]) >= 64
    recording = read_bag(tmp_path / "bag")
    assert (recording.runs, recording.lost, recording.spin_rate_ratio) == (1, 0, -2.5)
    assert (recording.step == range(len(recording.step))).all()


@pytest.mark.long
def test_the_next_simulator_is_recorded_when_the_first_has_gone(start, tmp_path):
    """Ended or killed, and with the next one there before: each is described, none is mixed."""
    logger = start("logger_node", output="bag")
    bag = tmp_path / "bag"
    options = {"time_scale": 400, "publish_period_s": 1}
    first = start("sim_node", wait_for_recorder=True, **options)
    ros_harness.wait_until(recorded_so_far(bag, 100_000), ros_harness.START_S, "a recording")
    second = start("sim_node", "-r", "__node:=second", spin_rate_ratio=-3.0, **options)
    logger.wait_for_line("another simulator, /second, publishes /")
    first.kill()
    ros_harness.wait_until((bag / "bag_1.mcap").exists, 20, "the second's run")
    ros_harness.wait_until(
        lambda: (bag / "bag_1.mcap").stat().st_size > 100_000, 20, "steps of the second"
    )
    third = start("sim_node", "-r", "__node:=third", spin_rate_ratio=-3.5, **options)
    logger.wait_for_line("another simulator, /third, publishes /")
    assert second.stop() == 0
    ros_harness.wait_until((bag / "bag_2.mcap").exists, 20, "the third's run")
    size = (bag / "bag_2.mcap").stat().st_size
    ros_harness.wait_until(
        lambda: (bag / "bag_2.mcap").stat().st_size > size + 50_000, 20, "steps of the third"
    )
    assert third.stop() == 0 and logger.stop() == 0
    assert " 0 lost" in logger.stdout
    recordings = [read_bag(bag, run) for run in (1, 2, 3)]
    assert [r.spin_rate_ratio for r in recordings] == [-2.5, -3.0, -3.5]
    for recording in recordings:
        steps = recording.step.tolist()
        assert steps == list(range(steps[0], steps[-1] + 1)) and len(steps) > 20


# --- silence


def test_silence_is_told_on_both_sides(start):
    logger = start("logger_node", output="bag")
    simulator = start("sim_node", time_scale=100, wait_for_recorder=True)
    bag = logger.directory / "bag"
    ros_harness.wait_until(recorded_so_far(bag, 150_000), ros_harness.START_S, "a recording")
    simulator.send(signal.SIGSTOP)
    says = "though these have a publisher: /system_description, /bead_states"
    ros_harness.wait_until(lambda: says in logger.stderr, SAID_S, says)
    simulator.send(signal.SIGCONT)
    ros_harness.wait_until(lambda: "messages arrive again" in logger.stderr, SAID_S, "them")
    logger.send(signal.SIGSTOP)
    for says in ("is silent; going on without it", "publishes /recorder_status, but nothing comes"):
        ros_harness.wait_until(lambda s=says: s in simulator.stderr, SAID_S, says)
    logger.send(signal.SIGCONT)
    assert simulator.stop() == 0 and logger.stop() == 0


@pytest.mark.long
def test_a_simulator_that_publishes_elsewhere_is_told(start):
    """It runs, its reports are heard, and nobody publishes what is to be recorded."""
    logger = start("logger_node", output="bag")
    start("sim_node", "-r", "bead_states:=elsewhere", time_scale=100)
    says = "a simulator runs, but nobody publishes /bead_states to this recorder"
    logger.wait_for_line(says)
    assert logger.stop() == 0


# --- deafness


def shared_memory_of(pid):
    """Files of the ports at which a process listens through shared memory."""
    maps = Path(f"/proc/{pid}/maps").read_text()
    return {int(n): f for f, n in re.findall(r"(/dev/shm/fastrtps_port(\d+))$", maps, re.M)}


def test_a_recorder_that_turns_deaf_says_so_and_ends_complete(start, tmp_path):
    """Its port is taken away as another process does it that takes the port for a dead one's."""
    logger = start("logger_node", output="bag")
    before = set(shared_memory_of(os.getpid()))
    logger.wait_for_line("recording")
    own = set(shared_memory_of(logger.pid)) - before
    simulator = start("sim_node", time_scale=100, wait_for_recorder=True)
    bag = tmp_path / "bag"
    ros_harness.wait_until(recorded_so_far(bag, 150_000), ros_harness.START_S, "a recording")
    files = shared_memory_of(logger.pid)
    for port in own:
        os.unlink(files[port])
    assert logger.wait(SAID_S) == 1
    assert re.search(r"has replaced the shared memory of port [\d, ]+, so nothing", logger.stderr)
    assert "the recording ends here, complete" in logger.stderr
    steps = recorded_steps(bag, "/bead_states")
    assert all(b == a + 1 for a, b in itertools.pairwise(steps)) and len(steps) > 20
    assert serialised_messages(bag) and simulator.stop() == 0


def test_who_joins_takes_no_place_of_a_killed_one_that_others_still_hold(start):
    simulator = start("sim_node", time_scale=100)
    simulator.wait_for_line("three_star")
    before = set(shared_memory_of(simulator.pid))
    places = []
    for name in ("first", "second"):
        recorder = start("logger_node", output=name)
        bag = Path(recorder.directory) / name
        ros_harness.wait_until(recorded_so_far(bag, 50_000), ros_harness.START_S, "a recording")
        written_to = set(shared_memory_of(simulator.pid)) - before
        # Those of this domain: processes of other domains come and go at lower ones meanwhile.
        here = {port for port in shared_memory_of(recorder.pid) if port >= network.FIRST_PORT}
        places.append(here & written_to)
        recorder.kill()
    assert all(places) and not places[0] & places[1]
    assert simulator.stop() == 0


JOIN = """
import os, re, threading, time, rclpy
from pathlib import Path
from tss_ros.ros import network
network.stay_on_this_machine()
network.SETTLE_S = 1.5
before = set(os.listdir("/dev/shm"))
def take_away():
    while True:
        maps = Path("/proc/self/maps").read_text()
        own = {str(port) for _, port in network._own_sockets()}
        found = re.findall(r"(/dev/shm/fastrtps_port(\\d+))\\n", maps)
        found = [file for file, port in found if port in own]
        if found:
            time.sleep(0.1)
            os.unlink(found[0])
            return
threading.Thread(target=take_away).start()
rclpy.init()
with network.joined():
    node = rclpy.create_node("late")
print(network.lost_ports(), node.get_node_names())
"""


def test_who_joins_deaf_joins_anew():
    joined = subprocess.run(
        [sys.executable, "-c", JOIN], capture_output=True, text=True, timeout=60, check=True
    )
    # The middleware may say before it that another process had a port of its own just then.
    assert joined.stdout.splitlines()[-1].startswith("[] ['late'"), joined.stdout
    assert len(re.findall("joining anew", joined.stderr)) == 1, joined.stderr


# --- runs


def test_log_time_never_goes_back_in_a_file(start, tmp_path):
    """Runs that go back in time and on in time: each has its file, and so readers in any order."""
    process = start("sim_node", time_scale=800, wait_for_recorder=True, publish_period_s=2)
    logger = start("logger_node", output="bag")
    with ros_harness.client_node() as client:
        simulator = ros_harness.Simulator(*client)
        for _ in range(4):
            simulator.wait_for_step((simulator.beads[-1].step if simulator.beads else 0) + 100)
            simulator.do(ros_harness.ResetSimulation)
        last = simulator.wait_for_step(simulator.beads[-1].step + 50).step
    assert process.stop() == 0 and logger.stop() == 0
    assert " 0 lost" in logger.stdout
    files = sorted((tmp_path / "bag").glob("*.mcap"))
    assert len(files) == 5
    seen = []
    for run, file in enumerate(files):
        steps = recorded_steps(file, "/bead_states")
        assert steps == list(range(steps[0], steps[0] + len(steps)))
        assert read_bag(tmp_path / "bag", run + 1).step.tolist() == steps
        seen += steps
    assert seen == list(range(len(seen))) and seen[-1] >= last
