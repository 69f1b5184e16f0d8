"""The nodes as real processes over the real middleware: recording, pacing, stopping, refusing."""

import math
import resource
import signal
import subprocess
import time

import numpy as np
import pytest
import ros_harness
from mcap.reader import make_reader
from ros_harness import time_ns
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosgraph_msgs.msg import Clock
from tss_interfaces.msg import RecorderStatus
from tss_interfaces.srv import ResetSimulation

from tss_ros.bags import recover

# Table 1 of the paper at -2.5 Omega, worked out here and not by the package.
ORBIT_RATE = math.sqrt(3.986e14 / 7378e3**3)
TURN_S = 2 * math.pi / (2.5 * ORBIT_RATE)

PERIOD_S = 5.0
STEPS = 1 + math.floor(TURN_S / PERIOD_S)


# --- a whole run, recorded


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """One turn at full speed, recorded: the directory with `bag`, and how the processes ended."""
    directory = tmp_path_factory.mktemp("run")
    with ros_harness.processes(directory) as start:
        logger = start("logger_node", output="bag")
        simulator = start(
            "sim_node",
            time_scale=0,
            turns=1,
            publish_period_s=PERIOD_S,
            disturbance_m=10,
            disturbance_seed=7,
            wait_for_recorder=True,
        )
        assert simulator.wait(ros_harness.START_S) == 0, simulator.stderr
        assert logger.stop() == 0, logger.stderr
    assert "Traceback" not in simulator.stderr + logger.stderr
    assert f"{5 * STEPS + 1} messages, 0 lost" in logger.stdout
    return directory


def read_with_rosbags(path):
    """Every message of a bag, decoded by an independent reader: {topic: [(log time, message)]}."""
    messages = {}
    with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
        for connection, log_time_ns, data in reader.messages():
            message = reader.deserialize(data, connection.msgtype)
            messages.setdefault(connection.topic, []).append((log_time_ns, message))
    return messages


@pytest.mark.parametrize("opened", ["bag", "bag/bag_0.mcap"])
def test_independent_reader_finds_every_step(run, opened):
    messages = read_with_rosbags(run / opened)
    assert len(messages.pop("/system_description")) == 1
    assert {topic: len(found) for topic, found in messages.items()} == dict.fromkeys(
        ("/bead_states", "/tether_states", "/markers", "/bead_cloud", "/tether_lengths"), STEPS
    )
    for topic in ("/bead_states", "/tether_states"):
        assert [message.step for _, message in messages[topic]] == list(range(STEPS))
    for found in messages.values():
        times_ns = [log_time_ns for log_time_ns, _ in found]
        assert times_ns == [round(step * PERIOD_S * 1e9) for step in range(STEPS)]


def test_messages_of_a_step_agree(run):
    messages = read_with_rosbags(run / "bag")
    (_, described), *_ = messages["/system_description"]
    ends = described.tether_ends.reshape(-1, 2)
    assert described.scenario == "three_star"
    assert described.bead_name == ["satellite_1", "satellite_2", "satellite_3"]
    assert sorted(map(sorted, ends.tolist())) == [[0, 1], [0, 2], [1, 2]]
    assert described.mass_kg.tolist() == [100.0] * 3
    assert described.axial_stiffness_n.tolist() == [5e4] * 3
    assert described.orbit_rate_rad_s == pytest.approx(ORBIT_RATE, rel=1e-12)
    assert described.spin_rate_ratio == -2.5
    for step in range(0, STEPS, 37):
        beads, tethers, joints, cloud, markers = (
            messages[topic][step][1]
            for topic in (
                "/bead_states",
                "/tether_states",
                "/tether_lengths",
                "/bead_cloud",
                "/markers",
            )
        )
        stamp = beads.header.stamp
        assert stamp.sec * 10**9 + stamp.nanosec == round(step * PERIOD_S * 1e9)
        for header in (beads, tethers, joints, cloud, *markers.markers):
            assert (header.header.stamp, header.header.frame_id) == (stamp, "orbit")
        position_m = beads.position_m.reshape(-1, 3)
        length_m = np.linalg.norm(position_m[ends[:, 0]] - position_m[ends[:, 1]], axis=1)
        radius_m = np.linalg.norm(position_m, axis=1)
        np.testing.assert_allclose(tethers.length_m, length_m, rtol=1e-12)
        np.testing.assert_array_equal(tethers.taut, length_m > described.rest_length_m)
        np.testing.assert_allclose(
            beads.deviation, radius_m / described.reference_radius_m - 1, atol=1e-12
        )
        assert joints.name == tethers.name
        np.testing.assert_array_equal(joints.position, tethers.length_m)
        np.testing.assert_array_equal(joints.effort, tethers.tension_n)
        fields = [field.name for field in cloud.fields]
        points = cloud.data.view(np.float32).reshape(cloud.width, len(fields))
        np.testing.assert_allclose(points[:, :3], position_m, rtol=1e-6)
        np.testing.assert_allclose(points[:, fields.index("deviation")], beads.deviation, rtol=1e-6)
        lines = next(marker for marker in markers.markers if marker.ns == "tethers")
        drawn = [(point.x, point.y, point.z) for point in lines.points]
        np.testing.assert_array_equal(drawn, position_m[ends.ravel()])
        grey = [(c.r, c.g, c.b) == (0.5, 0.5, 0.5) for c in lines.colors[::2]]
        np.testing.assert_array_equal(grey, ~np.array(tethers.taut, dtype=bool))


def test_disturbance_is_a_seeded_offset_of_the_given_size(run):
    messages = read_with_rosbags(run / "bag")
    _, first = messages["/bead_states"][0]
    _, described = messages["/system_description"][0]
    # Undisturbed, the satellites stand at pi/2 + i 2 pi/3 (Eq. 50).
    angle = math.pi / 2 + np.arange(3) * 2 * math.pi / 3
    radius_m = described.reference_radius_m
    undisturbed_m = np.column_stack([radius_m * np.cos(angle), radius_m * np.sin(angle), 0 * angle])
    offset_m = first.position_m.reshape(-1, 3) - undisturbed_m
    assert np.linalg.norm(offset_m) == pytest.approx(10.0, rel=1e-6)
    assert (described.disturbance_m, described.disturbance_seed) == (10.0, 7)


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


# --- pace, recorders that come late or die, viewers


def test_pace_follows_the_wall_clock(start):
    """In a namespace, for good measure."""
    scale, period_s = 200.0, 10.0
    logger = start("logger_node", "-r", "__ns:=/left", output="bag")
    simulator = start(
        "sim_node",
        "-r",
        "__ns:=/left",
        time_scale=scale,
        turns=0.2,
        publish_period_s=period_s,
        wait_for_recorder=True,
    )
    assert simulator.wait(ros_harness.START_S) == 0, simulator.stderr
    assert logger.stop() == 0
    with (logger.directory / "bag" / "bag_0.mcap").open("rb") as stream:
        messages = make_reader(stream).iter_messages(topics=["/left/bead_states"])
        times_ns = [(message.log_time, message.publish_time) for _, _, message in messages]
    simulated_s, wall_s = np.ptp(times_ns, axis=0) / 1e9
    assert simulated_s == math.floor(TURN_S * 0.2 / period_s) * period_s
    assert wall_s == pytest.approx(simulated_s / scale, rel=0.15)


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
    assert " 0 lost" in logger.stdout
    messages = read_with_rosbags(bag)
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


def test_clock_spares_its_followers(start):
    simulator = start("sim_node", time_scale=0)
    with ros_harness.client_node() as (node, spin_until):
        arrivals = []
        node.create_subscription(
            Clock, "/clock", lambda message: arrivals.append((time.monotonic(), message.clock)), 500
        )
        spin_until(lambda: len(arrivals) > 200, ros_harness.START_S, "200 clock messages")
        (began, _), (ended, _) = arrivals[0], arrivals[-1]
        assert len(arrivals) / (ended - began) < 220
        seconds = [stamp.sec + stamp.nanosec * 1e-9 for _, stamp in arrivals]
        assert seconds == sorted(seconds)
    assert simulator.stop() == 0


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
    assert time.monotonic() - begun < 15  # nothing holds the simulator back afterwards
    simulator.pause()
    last = simulator.settled().step
    simulator.spin_until(lambda: written and written[-1] == last, 20, "the recorder to have all")
    return last


def test_a_recording_survives_time_going_back(start, tmp_path):
    """Every step of every run is in the bag, and each run is described."""
    process = start("sim_node", time_scale=800, wait_for_recorder=True, publish_period_s=2)
    logger = start("logger_node", output="bag")
    with ros_harness.client_node() as client:
        last = reset_a_few_times(ros_harness.Simulator(*client))
    assert process.stop() == 0 and logger.stop(signal.SIGINT) == 0
    assert " 0 lost" in logger.stdout
    messages = read_with_rosbags(tmp_path / "bag")
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


# --- stopping


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM], ids=lambda n: n.name)
def test_signals_end_every_node(start, number):
    logger = start("logger_node", output="bag")
    stability = start("stability_node")
    simulator = start("sim_node", time_scale=0, wait_for_recorder=True)
    bag = logger.directory / "bag" / "bag_0.mcap"
    ros_harness.wait_until(
        lambda: bag.exists() and bag.stat().st_size > 200_000, ros_harness.START_S, "a recording"
    )
    stability.wait_for_line("ready")
    # The recorder first: it must close its bag in the middle of the stream.
    for process in (logger, simulator, stability):
        assert process.stop(number) == 0, process.stderr
        assert "rror" not in process.stderr, process.stderr
    steps = [message.step for _, message in read_with_rosbags(bag.parent)["/bead_states"]]
    assert steps == list(range(len(steps))) and len(steps) > 100


def test_full_disk_ends_the_recorder_with_one_line(start):
    def limit():
        # Python turns it into an OSError as a full disk gives; the middleware needs 550 kB itself.
        resource.setrlimit(resource.RLIMIT_FSIZE, (800_000, 800_000))

    logger = start("logger_node", output="bag", options={"preexec_fn": limit})
    simulator = start("sim_node", time_scale=0, wait_for_recorder=True)
    assert logger.wait(ros_harness.START_S) == 1
    (complaint,) = (line for line in logger.stderr.splitlines() if "[INFO]" not in line)
    assert "bag_0.mcap cannot be written: File too large" in complaint
    (account,) = recover.recover(logger.directory / "bag")
    assert "messages recovered" in account
    steps = [m.step for _, m in read_with_rosbags(logger.directory / "bag")["/bead_states"]]
    assert steps == list(range(len(steps))) and len(steps) > 100
    assert simulator.stop() == 0


# --- refusing wrong parameters


#: One for each way to be found out; tests/ros/test_parameters.py has the rest.
WRONG_PARAMETERS = [
    ("sim_node", {"satellites": 1_000_000}, ("satellites", "1000000", "2 to 1000")),
    ("sim_node", {"satellite_mass_kg": [1.0, 2.0]}, ("satellite_mass_kg", "2", "3")),
    ("sim_node", {"satellite_mass_kg": "[1, 2.5, 3]"}, ("satellite_mass_kg", "[1, 2.5, 3]")),
    ("sim_node", {"axial_stiffness_n": []}, ("axial_stiffness_n", "nothing")),
    ("sim_node", {"spin_rate_ratio": 0.0}, ("spin_rate_ratio", "0", "0.001")),
    ("sim_node", {"scenario": "nine_star"}, ("scenario", "four_star", "three_star")),
    ("sim_node", {"scenario": "/no/such.yaml"}, ("/no/such.yaml",)),
    ("sim_node", {"use_sim_time": 5}, ("use_sim_time", "5", "BOOL")),
    ("stability_node", {"satellites": 101}, ("satellites", "101", "100")),
    ("logger_node", {"output": "/proc/self/bag"}, ("output", "/proc/self/bag")),
]


def test_wrong_parameters_end_a_node_with_one_line(start):
    for first in range(0, len(WRONG_PARAMETERS), 3):
        batch = WRONG_PARAMETERS[first : first + 3]
        for process, (node, given, expected) in [
            (start(node, **given), (node, given, expected)) for node, given, expected in batch
        ]:
            assert process.wait(ros_harness.START_S) == 1, (given, process.stderr)
            assert process.stdout == ""
            (line,) = process.stderr.splitlines()
            assert line.startswith(f"{node}: ")
            assert all(part in line for part in expected), (line, expected)


def test_missing_parameters_file_ends_a_node_with_one_line(start):
    process = start("sim_node", "--params-file", "missing.yaml")
    assert process.wait(ros_harness.START_S) == 1
    (line,) = process.stderr.splitlines()
    assert line.startswith("sim_node: ") and "missing.yaml" in line


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
