"""The recorder as a real process: bags that every reader opens, with every step of every run."""

import resource
import signal
import subprocess
import time

import pytest
import ros_harness
from recorded import PERIOD_S, STEPS, messages_by_topic, record_one_turn
from ros_harness import time_ns
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from simulation_interfaces.srv import ResetSimulation
from tss_interfaces.msg import RecorderStatus

from tss_ros.bags import recover


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """The folder of one recorded turn."""
    return record_one_turn(tmp_path_factory.mktemp("run"))


@pytest.mark.parametrize("opened", ["bag", "bag/bag_0.mcap"])
def test_independent_reader_finds_every_step(run, opened):
    messages = messages_by_topic(run / opened)
    assert len(messages.pop("/system_description")) == 1
    assert {topic: len(found) for topic, found in messages.items()} == dict.fromkeys(
        ("/bead_states", "/tether_states", "/markers", "/bead_cloud", "/tether_lengths"), STEPS
    )
    for topic in ("/bead_states", "/tether_states"):
        assert [message.step for _, message in messages[topic]] == list(range(STEPS))
    for found in messages.values():
        times_ns = [log_time_ns for log_time_ns, _ in found]
        assert times_ns == [round(step * PERIOD_S * 1e9) for step in range(STEPS)]


def test_bag_says_what_its_types_are(run):
    with AnyReader([run / "bag"]) as reader:
        for connection in reader.connections:
            text = connection.msgdef.data
            typestore = get_typestore(Stores.EMPTY)
            typestore.register(get_types_from_msg(text, connection.msgtype))
            assert connection.digest == typestore.hash_rihs01(connection.msgtype)
            (qos,) = connection.ext.offered_qos_profiles
            assert (qos.history.name, qos.reliability.name) == ("KEEP_LAST", "RELIABLE")
            latched = connection.topic in (
                "/system_description",
                "/simulation_events",
                "/applied_wrenches",
                "/stability_results",
            )
            assert qos.durability.name == ("TRANSIENT_LOCAL" if latched else "VOLATILE")


def test_rerun_accepts_the_file(run):
    check = subprocess.run(
        ["rerun", "mcap", "check", run / "bag" / "bag_0.mcap"],
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert check.returncode == 0, check.stdout + check.stderr
    # The exit status does not tell: a row per topic says "ok" or "PROBLEM".
    rows = [line.split() for line in check.stdout.splitlines() if " /" in line]
    assert len(rows) == 6 and all(row[0] == "ok" for row in rows), check.stdout


def reset_a_few_times(simulator):
    """Let it begin anew in every way while it is recorded; return the last step, once written."""
    written = []
    simulator.node.create_subscription(
        RecorderStatus, "/recorder_status", lambda m: written.append(m.last_step), 10
    )
    simulator.wait_for_step(200)
    simulator.do(ResetSimulation)
    simulator.wait_for_step(simulator.beads[-1].step + 200)
    assert simulator.set(satellites=4).successful
    simulator.do(ResetSimulation)
    simulator.wait_for_step(simulator.beads[-1].step + 200)
    simulator.do(ResetSimulation, scope=ResetSimulation.Request.SCOPE_TIME)
    begun = time.monotonic()
    simulator.wait_for_step(simulator.beads[-1].step + 500)
    assert time.monotonic() - begun < 40  # nothing holds the simulator back afterwards
    simulator.pause()
    last = simulator.settled().step
    simulator.spin_until(lambda: written and written[-1] == last, 20, "the recorder to have all")
    return last


@pytest.mark.parametrize("in_bulk", [False, pytest.param(True, marks=pytest.mark.long)])
def test_a_recording_survives_time_going_back(start, tmp_path, in_bulk):
    """Every step of every run is in the bag, and each run is described."""
    process = start("sim_node", time_scale=800, wait_for_recorder=True, publish_period_s=2)
    logger = start("logger_node", output="bag", in_bulk=in_bulk)
    with ros_harness.client_node() as client:
        last = reset_a_few_times(ros_harness.Simulator(*client))
    assert process.stop() == 0 and logger.stop(signal.SIGINT) == 0
    assert " 0 lost" in logger.stdout
    messages = messages_by_topic(tmp_path / "bag")
    for topic in ("/bead_states", "/tether_states"):
        assert sorted(m.step for _, m in messages[topic]) == list(range(last + 1))
        assert all(t == time_ns(m.header.stamp) for t, m in messages[topic])
    described = sorted(
        (m.run, m.first_step, len(m.bead_name)) for _, m in messages["/system_description"]
    )
    assert [(run, beads) for run, _, beads in described] == [(0, 3), (1, 3), (2, 4), (3, 4)]
    firsts = {m.step: t for t, m in messages["/bead_states"]}
    assert all(firsts[first_step] == 0 for _, first_step, _ in described)
    assert [m.kind for _, m in messages["/simulation_events"]] == ["reset"] * 3


def test_full_disk_ends_the_recorder_with_one_line(start):
    def limit():
        # Python turns it into an OSError as a full disk gives; the middleware needs 550 kB itself.
        resource.setrlimit(resource.RLIMIT_FSIZE, (800_000, 800_000))

    logger = start("logger_node", output="bag", options={"preexec_fn": limit})
    simulator = start("sim_node", time_scale=0, wait_for_recorder=True)
    assert logger.wait(ros_harness.START_S) == 1
    # Before it a node may warn, as of silence on a busy machine.
    (complaint,) = (x for x in logger.stderr.splitlines() if x.startswith("logger_node: "))
    assert "bag_0.mcap cannot be written: File too large" in complaint
    (account,) = recover.recover(logger.directory / "bag")
    assert "messages recovered" in account
    steps = [m.step for _, m in messages_by_topic(logger.directory / "bag")["/bead_states"]]
    assert steps == list(range(len(steps))) and len(steps) > 100
    assert simulator.stop() == 0


def test_existing_output_is_left_alone(start, tmp_path):
    bag = tmp_path / "bag"
    bag.mkdir()
    (bag / "bag_0.mcap").write_text("precious")
    process = start("logger_node", output="bag")
    assert process.wait(ros_harness.START_S) == 1
    (line,) = process.stderr.splitlines()
    assert line.startswith("logger_node: output 'bag' exists already")
    assert [path.name for path in bag.iterdir()] == ["bag_0.mcap"]
    assert (bag / "bag_0.mcap").read_text() == "precious"


def test_the_earth_without_a_viewer_to_show_it_in_is_refused(start, tmp_path):
    process = start("logger_node", output="bag", earth=True)
    assert process.wait(ros_harness.START_S) == 1
    (line,) = process.stderr.splitlines()
    assert line.startswith("logger_node: earth is true, but rerun is false")
    assert not (tmp_path / "bag").exists()
