"""What recorders bear: kills, full and read-only disks, and messages that are lost."""

import contextlib
import itertools
import os
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
from recorded import recorded_steps, serialised_messages
from tss_interfaces.msg import BeadStates, RecorderStatus

from tss_ros.bags import recover

#: Wall time [s] that a killed recorder may lose.
ALLOWED_LOSS_S = 0.5
KILLS = 2
#: What takes a moment may take so long [s] on a busy machine.
SOON_S = 60


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
        steps = recorded_steps(bag, "/bead_states")
        gaps = [(one, two) for one, two in itertools.pairwise(steps) if two != one + 1]
        assert not gaps and len(steps) > 50, f"{gaps} of {len(steps)}: {stderr}{simulator.stderr}"
        lost = [step for step, at in arrived.items() if steps[-1] < step and at < killed]
        lost_s = killed - arrived[min(lost)] if lost else 0.0
        with capsys.disabled():
            print(f"\nkill -9: {len(steps)} steps recovered, {len(lost)} ({lost_s:.2f} s) lost")
        assert lost_s < ALLOWED_LOSS_S


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
        assert len(serialised_messages(disk / "bag")) == count > 5000
        assert simulator.stop() == 0
        with capsys.disabled():
            print(f"\nfull disk: {count} messages written, {count} readable")
        shutil.rmtree(disk / "bag")


@pytest.mark.skipif(os.geteuid() != 0, reason="only root may mount a file system")
@pytest.mark.parametrize("left", [0, 100_000])
def test_a_disk_that_is_filled_at_once_is_told_once_and_truly(start, tmp_path, left):
    """To the last byte, or nearly: the recording ends as the one line says."""
    with file_system(tmp_path / "disk", "size=40m") as disk:
        logger = start("logger_node", output=str(disk / "bag"))
        simulator = start("sim_node", time_scale=100, wait_for_recorder=True)
        file = disk / "bag" / "bag_0.mcap"
        ros_harness.wait_until(
            lambda: file.exists() and file.stat().st_size > 150_000, ros_harness.START_S, "steps"
        )
        with contextlib.suppress(OSError), (disk / "filler").open("wb", buffering=0) as filler:
            while filler.write(bytes(4096)):
                pass
        if left:
            os.truncate(disk / "filler", (disk / "filler").stat().st_size - left)
        assert logger.wait(ros_harness.START_S) == 1
        assert simulator.stop() == 0
        (said,) = [
            line
            for line in logger.stderr.splitlines()
            if re.search(r"complete|cannot be written", line)
        ]
        (disk / "filler").unlink()
        whole = (disk / "bag" / "metadata.yaml").exists()
        assert whole == ("ends here, complete" in said), said
        assert whole or "it ends incomplete, and `recover" in said
        if not whole:
            (account,) = recover.recover(disk / "bag")
            assert "messages recovered" in account
        assert len(serialised_messages(disk / "bag")) > 50
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
    assert len(serialised_messages(tmp_path / "bag")) == count == 5 * (2 * 2522 + 2) + 1


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
        spin_until(lambda: reports and reports[-1].messages, SOON_S, "the first message")
        logger.send(signal.SIGSTOP)
        for step in range(1, 3001):
            publisher.publish(BeadStates(step=step))
        logger.send(signal.SIGCONT)
        spin_until(lambda: reports[-1].lost, SOON_S, "a loss")
        publisher.publish(BeadStates(step=3001))
        spin_until(lambda: reports[-1].messages + reports[-1].lost == 3002, SOON_S, "the rest")
        told = f"{reports[-1].lost} messages were lost"
        spin_until(lambda: diagnostics and diagnostics[-1].status[0].message == told, SOON_S, told)
    assert logger.stop() == 0
    recorded = len(serialised_messages(tmp_path / "bag"))
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
