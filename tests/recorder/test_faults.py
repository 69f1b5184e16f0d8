"""What recordings bear: killed recorders, cut and damaged files, full and read-only disks."""

import contextlib
import itertools
import os
import random
import re
import shutil
import signal
import subprocess
import time

import pytest
import ros_harness
import yaml
from diagnostic_msgs.msg import DiagnosticArray
from mcap.reader import make_reader
from rclpy.qos import QoSProfile
from rosbags.highlevel import AnyReader
from small_bag import Bag
from tss_interfaces.msg import BeadStates, RecorderStatus

from tss_ros.bags import recover
from tss_ros.core import TssError

#: Wall time [s] that a killed recorder may lose.
ALLOWED_LOSS_S = 0.5
KILLS, CUTS = 3, 60


def messages(bag):
    """(topic, sequence number, data) of every message of a bag, by an independent reader."""
    with AnyReader([bag]) as reader:
        return [
            (connection.topic, time_ns, data) for connection, time_ns, data in reader.messages()
        ]


# --- a recorder that is killed


@contextlib.contextmanager
def arrivals_of_steps():
    """A function that waits for something, and the wall time [s] of each step's arrival here."""
    with ros_harness.client_node() as (node, spin_until):
        arrived = {}
        node.create_subscription(
            BeadStates,
            "bead_states",
            lambda message: arrived.setdefault(message.step, time.monotonic()),
            QoSProfile(depth=1000),
        )
        yield spin_until, arrived


def test_a_killed_recorder_loses_less_than_half_a_second(start, tmp_path, capsys):
    """Recovered by the next recorder, which is killed in its turn; the last one by hand."""
    simulator = start("sim_node", time_scale=400, publish_period_s=1)
    rows = []
    with arrivals_of_steps() as (spin_until, arrived):
        for kill in range(KILLS):
            bag = tmp_path / f"bag_{kill}"
            file = bag / f"{bag.name}_0.mcap"
            logger = start("logger_node", output=bag.name)
            spin_until(lambda f=file: f.exists() and f.stat().st_size > 0, 90, "a recording")
            if kill:
                earlier = f"bag_{kill - 1}_0.mcap: "
                spin_until(lambda p=logger, e=earlier: e in p.stderr, 30, "the recovery")
                assert "messages recovered, up to " in logger.stderr
            begun = time.monotonic()
            # Anywhere between two flushes.
            spin_until(lambda b=begun, k=kill: time.monotonic() > b + 1.5 + 0.1 * k, 10, "a moment")
            spin_until(lambda f=file: f.stat().st_size > 200_000, 60, "steps on the disk")
            logger.kill()
            killed = time.monotonic()
            spin_until(lambda k=killed: time.monotonic() > k + 0.3, 10, "what is on its way")
            rows.append((bag, killed, dict(arrived), logger.stderr))
    assert simulator.stop() == 0
    (account,) = recover.recover(bag)
    assert recover.recover(bag) == []
    for bag, killed, arrived, stderr in rows:
        assert sorted(path.name for path in bag.iterdir()) == [
            f"{bag.name}_0.mcap",
            f"{bag.name}_0.mcap.damaged",
            "metadata.yaml",
        ]
        with AnyReader([bag]) as reader:
            beads = [c for c in reader.connections if c.topic == "/bead_states"]
            found = reader.messages(connections=beads)
            steps = [reader.deserialize(data, c.msgtype).step for c, _, data in found]
        gaps = [(one, two) for one, two in itertools.pairwise(steps) if two != one + 1]
        assert not gaps and len(steps) > 50, f"{gaps} of {len(steps)}: {stderr}{simulator.stderr}"
        lost = [step for step, at in arrived.items() if steps[-1] < step and at < killed]
        lost_s = killed - arrived[min(lost)] if lost else 0.0
        with capsys.disabled():
            print(f"\nkill -9: {len(steps)} steps recovered, {len(lost)} ({lost_s:.2f} s) lost")
        assert lost_s < ALLOWED_LOSS_S


# --- files that are cut or damaged


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A bag's file, and for each of its chunks where it ends and the messages up to there."""
    bag = Bag(tmp_path_factory.mktemp("whole") / "bag")
    bag.describe()
    for number in range(3000):
        bag.step(number)
        if number % 50 == 0:
            bag.writer.flush()
    bag.writer.close()
    with bag.writer.path.open("rb") as stream:
        reader = make_reader(stream)
        summary, count, ends = reader.get_summary(), 0, [(0, 0)]
        for index in sorted(summary.chunk_indexes, key=lambda index: index.chunk_start_offset):
            count += _count(stream, index)
            ends.append((index.chunk_start_offset + index.chunk_length, count))
    return bag.writer.path.read_bytes(), ends, messages(bag.writer.directory)


def _count(stream, index):
    """Messages of a chunk, from the lengths of its message indexes: 16 bytes each."""
    count = 0
    for place in index.message_index_offsets.values():
        stream.seek(place + 1 + 8 + 2)
        count += int.from_bytes(stream.read(4), "little") // 16
    return count


def damaged(folder, name, content):
    bag = folder / name
    bag.mkdir()
    (bag / f"{name}_0.mcap").write_bytes(content)
    return bag


def test_of_a_cut_file_every_whole_chunk_is_recovered(whole, tmp_path, capsys):
    content, ends, written = whole
    places = random.Random(1).sample(range(len(content)), CUTS)
    lost = []
    for cut in (0, 1, 8, len(content) - 1, *places):
        # What the file system had not yet put on the disk when power was lost reads as zeros.
        for kind, tail in (("cut", b""), ("zeros", bytes(min(50_000, len(content) - cut)))):
            bag = damaged(tmp_path, f"{kind}_{cut}", content[:cut] + tail)
            (account,) = recover.recover(bag)
            expected = max(count for end, count in ends if end <= cut)
            assert f": {expected} messages recovered" in account
            assert messages(bag) == written[:expected]
            assert (bag / f"{bag.name}_0.mcap.damaged").read_bytes() == content[:cut] + tail
            lost.append(len(written) - expected)
    with capsys.disabled():
        print(f"\ncut: {len(lost)} files of {len(written)} messages, {sum(lost)} lost in all")


def test_what_lies_behind_damage_is_recovered_too(whole, tmp_path):
    """Holes anywhere, and in the head of a chunk, which then reads like an empty one."""
    content, ends, written = whole
    head = ends[2][0] + content[ends[2][0] :].index(b"lz4") - 41
    heads = range(head, head + 48, 3)
    places = [random.Random(seed).randrange(ends[1][0], ends[-2][0]) for seed in range(10)]
    for at in [*places, *heads]:
        bag = damaged(tmp_path, f"hole_{at}", content[:at] + bytes(512) + content[at + 512 :])
        recover.recover(bag)
        # One chunk is gone, or two that the hole touches both.
        before = max(count for end, count in ends if end <= at)
        after = min(count for end, count in ends if end >= at + 512)
        found = messages(bag)
        assert found[:before] == written[:before] and len(found) > before
        kept_behind = len(written) - after
        assert found[len(found) - kept_behind :] == written[after:]
        shutil.rmtree(bag)


def test_recovery_that_is_stopped_can_be_repeated(whole, tmp_path):
    content, _, written = whole
    bag = damaged(tmp_path, "bag", content[:-100])
    expected = len(written)
    # As if it had ended between putting the damaged file aside and putting the new one in place.
    (bag / "bag_0.mcap").rename(bag / "bag_0.mcap.damaged")
    (bag / "bag_0.mcap.recovering").write_bytes(content[:50])
    assert recover.find_cut(tmp_path) == [bag]
    recover.recover(bag)
    assert messages(bag) == written and len(written) == expected
    assert recover.find_cut(tmp_path) == []


def test_metadata_alone_that_is_missing_is_made(whole, tmp_path):
    content, _, written = whole
    bag = damaged(tmp_path, "bag", content)
    (account,) = recover.recover(bag)
    assert "metadata.yaml was missing; no message was lost" in account
    assert messages(bag) == written and not list(bag.glob("*.damaged"))


def test_a_bag_in_use_and_what_is_no_bag_are_left_alone(tmp_path):
    bag = Bag(tmp_path / "bag")
    bag.describe()
    bag.writer.flush()
    assert recover.find_cut(tmp_path) == []
    with pytest.raises(TssError, match="bag' is being recorded"):
        recover.recover(tmp_path / "bag")
    bag.writer.close()
    with pytest.raises(TssError, match="missing' is not a bag directory"):
        recover.recover(tmp_path / "missing")
    (tmp_path / "empty").mkdir()
    with pytest.raises(TssError, match="empty' holds no .mcap file"):
        recover.recover(tmp_path / "empty")


# --- disks


@contextlib.contextmanager
def file_system(folder, options):
    """A small file system of its own, where the user may mount one."""
    folder.mkdir()
    mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", options, "tmpfs", folder])
    if mounted.returncode:
        pytest.skip("only root may mount a file system")
    try:
        yield folder
    finally:
        subprocess.run(["umount", folder], check=True)


@pytest.mark.skipif(os.geteuid() != 0, reason="only root may mount a file system")
def test_a_recording_ends_complete_before_the_disk_is_full(start, tmp_path, capsys):
    with file_system(tmp_path / "disk", "size=18m") as disk:
        logger = start("logger_node", output=str(disk / "bag"))
        simulator = start("sim_node", time_scale=0, wait_for_recorder=True)
        assert logger.wait(ros_harness.START_S) == 1
        assert "the disk is nearly full, so the recording ends here, complete" in logger.stderr
        count = int(re.search(r"(\d+) messages, 0 lost", logger.stdout)[1])
        assert len(messages(disk / "bag")) == count > 5000
        assert simulator.stop() == 0
        with capsys.disabled():
            print(f"\nfull disk: {count} messages written, {count} readable")
        shutil.rmtree(disk / "bag")


@pytest.mark.skipif(os.geteuid() != 0, reason="only root may mount a file system")
def test_a_read_only_disk_is_refused(start, tmp_path):
    with file_system(tmp_path / "disk", "ro") as disk:
        logger = start("logger_node", output=str(disk / "bag"))
        assert logger.wait(ros_harness.START_S) == 1
        (line,) = logger.stderr.splitlines()
        assert "bag' cannot be made: Read-only file system" in line


@pytest.mark.parametrize("fate", ["moved", "removed"])
def test_a_bag_that_is_taken_away_ends_the_recording(start, tmp_path, fate):
    logger = start("logger_node", output="bag")
    simulator = start("sim_node", time_scale=0, wait_for_recorder=True)
    file = tmp_path / "bag" / "bag_0.mcap"
    ros_harness.wait_until(
        lambda: file.exists() and file.stat().st_size > 200_000, ros_harness.START_S, "a recording"
    )
    if fate == "moved":
        (tmp_path / "bag").rename(tmp_path / "elsewhere")
    else:
        shutil.rmtree(tmp_path / "bag")
    assert logger.wait(ros_harness.START_S) == 1
    assert "bag_0.mcap was moved or removed while it was recorded" in logger.stderr
    assert simulator.stop() == 0
    if fate == "moved":
        # The file is complete where it is now.
        with (tmp_path / "elsewhere" / "bag_0.mcap").open("rb") as stream:
            assert make_reader(stream).get_summary().statistics.message_count > 100


def test_splitting_gives_whole_files_and_one_bag(start, tmp_path):
    logger = start("logger_node", output="bag", split_size_mb=0.1)
    simulator = start(
        "sim_node", time_scale=0, turns=1, publish_period_s=0.5, wait_for_recorder=True
    )
    assert simulator.wait(ros_harness.START_S) == 0, simulator.stderr
    assert logger.stop() == 0, logger.stderr
    files = sorted((tmp_path / "bag").glob("*.mcap"))
    count = int(re.search(r"(\d+) messages, 0 lost", logger.stdout)[1])
    assert len(files) > 2
    with contextlib.ExitStack() as stack:
        readers = [make_reader(stack.enter_context(path.open("rb"))) for path in files]
        assert sum(r.get_summary().statistics.message_count for r in readers) == count
    assert len(messages(tmp_path / "bag")) == count == 5 * (2 * 2522 + 2) + 1


# --- messages that the middleware drops


def test_losses_are_counted_wherever_one_looks(start, tmp_path):
    """A recorder that is stopped for a while gets the newest 1000 of 3000 messages."""
    logger = start("logger_node", output="bag")
    reports, diagnostics = [], []
    with ros_harness.client_node() as (node, spin_until):
        publisher = node.create_publisher(BeadStates, "bead_states", QoSProfile(depth=1000))
        node.create_subscription(RecorderStatus, "recorder_status", reports.append, 10)
        node.create_subscription(DiagnosticArray, "/diagnostics", diagnostics.append, 10)
        spin_until(publisher.get_subscription_count, ros_harness.START_S, "the recorder")
        publisher.publish(BeadStates(step=0))
        spin_until(lambda: reports and reports[-1].messages, 10, "the first message")
        logger.send(signal.SIGSTOP)
        for step in range(1, 3001):
            publisher.publish(BeadStates(step=step))
        logger.send(signal.SIGCONT)
        spin_until(lambda: reports[-1].lost, 10, "a loss")
        publisher.publish(BeadStates(step=3001))
        spin_until(lambda: reports[-1].messages + reports[-1].lost == 3002, 10, "the last message")
        told = f"{reports[-1].lost} messages were lost"
        spin_until(lambda: diagnostics and diagnostics[-1].status[0].message == told, 10, told)
    assert logger.stop() == 0
    recorded = len(messages(tmp_path / "bag"))
    lost = 3002 - recorded
    assert lost > 0 and reports[-1].lost == lost
    assert f"{recorded} messages, {lost} lost" in logger.stdout
    assert f"messages of bead_states were lost, {lost} in all" in logger.stderr
    information = yaml.safe_load((tmp_path / "bag" / "metadata.yaml").read_text())
    notes = information["rosbag2_bagfile_information"]["custom_data"]
    assert notes["tss_ros.lost"] == notes["tss_ros.lost /bead_states"] == str(lost)
    with (tmp_path / "bag" / "bag_0.mcap").open("rb") as stream:
        records = [r.metadata for r in make_reader(stream).iter_metadata() if r.name == "tss_ros"]
    assert records[-1]["lost"] == str(lost)
