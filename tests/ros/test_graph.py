"""The nodes among others: names, QoS, parameters, diagnostics, subscribers and nodes that die."""

import itertools
import signal
import sys
import time

import pytest
import request_fuzzer
import ros_harness
from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import Parameter, ParameterValue
from rcl_interfaces.srv import DescribeParameters, SetParameters
from ros_harness import time_ns
from rosbags.highlevel import AnyReader
from tss_interfaces.msg import BeadStates, SimulationState
from tss_interfaces.srv import (
    ComputeFloquet,
    GetSimulationState,
    ResetSimulation,
    SetSimulationState,
    StepSimulation,
)

from tss_ros.ros import parameters
from tss_ros.ros.topics import read_topics

SUBSCRIBER = f"""#!{sys.executable}
import rclpy
from tss_interfaces.msg import BeadStates
rclpy.init()
node = rclpy.create_node("subscriber")
node.create_subscription(BeadStates, "bead_states", lambda message: print("got", flush=True), 10)
rclpy.spin(node)
"""


def recorded_steps(bag, topic):
    with AnyReader([bag]) as reader:
        connections = [c for c in reader.connections if c.topic == topic]
        return [
            reader.deserialize(data, connection.msgtype).step
            for connection, _, data in reader.messages(connections=connections)
        ]


# --- names


def test_two_simulators_side_by_side(start, client, tmp_path):
    """Each with its namespace, recorder and pace; one of them gives the time."""
    left = start("sim_node", "-r", "__ns:=/left", time_scale=50, spin_rate_ratio=-2.2)
    right = start(
        "sim_node", "-r", "__ns:=/right", time_scale=10, scenario="six_bead", publish_clock=False
    )
    logger = start("logger_node", "-r", "__ns:=/right", output="bag")
    two = [ros_harness.Simulator(*client, namespace=name) for name in ("/left", "/right")]
    for simulator, beads in zip(two, (3, 6)):
        assert len(simulator.wait_for_step(20).name) == beads
    two[1].pause()
    before = two[0].settled().step
    two[0].wait_for_step(before + 50)
    stands = two[1].settled().step
    assert client[0].count_publishers("/clock") == 1
    # /clock is the left one's time, which runs on while the right one stands.
    last = time_ns(two[1].beads[-1].header.stamp)
    client[1](lambda: two[0].clocks and time_ns(two[0].clocks[-1].clock) > last, 10, "/clock")
    assert two[0].set(time_scale=20).successful
    for process in (left, right, logger):
        assert process.stop() == 0 and "rror" not in process.stderr
    steps = recorded_steps(tmp_path / "bag", "/right/bead_states")
    assert steps == list(range(steps[0], stands + 1))


def test_names_can_be_remapped(start, client):
    node, spin_until = client
    simulator = start(
        "sim_node", "-r", "__node:=formation", "-r", "bead_states:=satellites", start_paused=True
    )
    messages = []
    node.create_subscription(BeadStates, "/satellites", messages.append, 10)
    formation = ros_harness.Simulator(node, spin_until, name="formation")
    while not messages:
        formation.do(StepSimulation, steps=1)
    assert not formation.beads and simulator.stop() == 0


# --- QoS


def test_topics_have_the_qos_of_the_file_unless_overridden(start, client):
    node, spin_until = client
    simulator = start(
        "sim_node",
        **{
            "qos_overrides./markers.publisher.reliability": "best_effort",
            "qos_overrides./bead_states.publisher.depth": 77,
        },
    )
    expected = {
        name: (topic.depth, "RELIABLE", topic.durability)
        for name, topic in read_topics().items()
        if topic.publisher == "sim_node" and name != "/tf"
    }
    expected["markers"] = (1000, "BEST_EFFORT", "volatile")
    expected["bead_states"] = (77, "RELIABLE", "volatile")

    def offered():
        found = {
            name: [
                (i.qos_profile.reliability.name, i.qos_profile.durability.name.lower())
                for i in node.get_publishers_info_by_topic(name)
            ]
            for name in expected
        }
        return all(found.values()) and found

    found = spin_until(offered, ros_harness.START_S, "every topic")
    assert found == {name: [qos[1:]] for name, qos in expected.items()}
    # The middleware does not tell depths to others; the node's parameters do.
    sim = ros_harness.Simulator(node, spin_until)
    refused = sim.set(**{"qos_overrides./bead_states.publisher.depth": 78})
    assert not refused.successful and "read-only" in refused.reason
    assert simulator.stop() == 0


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ({"qos_overrides./markers.publisher.reliability": "perhaps"}, "perhaps"),
        ({"qos_overrides./markers.publisher.depth": 0}, "depth is 0; allowed: 1 to 1000000"),
        ({"qos_overrides./markers.publisher.depth": "x"}, "depth"),
        ({"publish_tf": True}, "/tf needs the package tf2_msgs"),
    ],
)
def test_what_cannot_be_published_ends_the_node_with_one_line(start, given, expected):
    if "publish_tf" in given:
        try:
            import tf2_msgs  # noqa: F401

            pytest.skip("tf2_msgs is installed here")
        except ModuleNotFoundError:
            pass
    process = start("sim_node", **given)
    assert process.wait(ros_harness.START_S) == 1
    (line,) = process.stderr.splitlines()
    assert line.startswith("sim_node: ") and expected in line


# --- parameters


def test_parameters_are_described_and_changed_or_refused_with_a_reason(start, client):
    node, spin_until = client
    process = start("sim_node", start_paused=True)
    simulator = ros_harness.Simulator(node, spin_until)
    names = [parameter.name for parameter in parameters.SIMULATOR]
    request = DescribeParameters.Request(names=names)
    answer = ros_harness.call(
        node, spin_until, DescribeParameters, "/sim_node/describe_parameters", request
    )
    assert [descriptor.name for descriptor in answer.descriptors] == names
    described = {descriptor.name: descriptor for descriptor in answer.descriptors}
    for descriptor in answer.descriptors:
        assert descriptor.description and descriptor.additional_constraints
    (limits,) = described["time_scale"].floating_point_range
    assert (limits.from_value, limits.to_value) == (0.0, 1e6)
    fixed = {name for name, descriptor in described.items() if descriptor.read_only}
    assert fixed == {
        "turns",
        "wait_for_recorder",
        "start_paused",
        "publish_clock",
        "publish_tf",
        "frame_prefix",
    }
    for given, expected in (
        ({"time_scale": -1.0}, "time_scale is -1.0; allowed: a number from 0 to 1000000"),
        ({"time_scale": None}, "time_scale is nothing; allowed: a number from 0 to 1000000"),
        ({"time_scale": "x"}, "time_scale is 'x'; allowed: a number from 0 to 1000000"),
        ({"turns": 2.0}, "turns is fixed when the node starts"),
        ({"satellite_mass_kg": [1.0, 2.0]}, "satellite_mass_kg must have 1 or 3 values"),
        ({"scenario": "nine_star"}, "scenario must be one of"),
        ({"satellites": 500, "beads_per_tether": 9}, "make 5000 satellites and beads; allowed"),
        ({"nonesuch": 1}, "nonesuch"),
        # Together or not at all.
        ({"time_scale": 7.0, "satellites": 0}, "satellites is 0; allowed: a whole number from 2"),
    ):
        result = simulator.set(**given)
        assert not result.successful and expected in result.reason, (given, result.reason)
    # Values that fit only together are accepted only together.
    assert simulator.set(satellites=4, satellite_mass_kg=[1.0, 2.0, 1.0, 2.0]).successful
    assert not simulator.set(satellites=3).successful
    # Taken away, a parameter has the scenario's value again, and may be set once more.
    assert simulator.set(satellite_mass_kg=None).successful
    assert simulator.set(satellites=None).successful
    assert simulator.set(satellite_mass_kg=5).successful
    simulator.join()
    assert list(simulator.descriptions[-1].mass_kg) == [5.0, 5.0, 5.0]
    assert simulator.descriptions[-1].header.frame_id == "orbit"
    # A type that no parameter has.
    wrong = Parameter(name="time_scale", value=ParameterValue(type=99))
    good = Parameter(name="time_scale", value=ParameterValue(type=3, double_value=3.0))
    request = SetParameters.Request(parameters=[good, wrong, good])
    name = "/sim_node/set_parameters"
    answer = ros_harness.call(node, spin_until, SetParameters, name, request)
    assert [result.successful for result in answer.results] == [True, False, True]
    assert "99" in answer.results[1].reason
    assert process.stop() == 0 and "rror" not in process.stderr


# --- diagnostics


def test_diagnostics_tell_pace_slack_and_recorders(start, client):
    node, spin_until = client
    reports = {}

    def keep(message):
        reports.update({status.name: status for status in message.status})

    node.create_subscription(DiagnosticArray, "/diagnostics", keep, 10)
    process = start("sim_node", spin_rate_ratio=-1.2, time_scale=1000, publish_period_s=5)

    def report(task, condition):
        def look():
            status = reports.get(f"/sim_node: {task}")
            return status if status and condition(status) else None

        return spin_until(look, ros_harness.START_S, f"diagnostics of {task}")

    assert report("recorders", lambda s: s.message == "no recorder").level == b"\x00"
    slack = report("tethers", lambda s: "slack" in s.message)
    assert slack.level == b"\x01"
    (names,) = (value.value for value in slack.values if value.key == "slack")
    assert set(names.split(", ")) <= {"tether_1", "tether_2", "tether_3"}, names
    motion = report("motion", lambda s: float(s.values[0].value) > 500)
    assert {v.key for v in motion.values} > {"real-time factor", "step cost [ms]"}
    logger = start("logger_node", output="bag")
    recorders = report("recorders", lambda s: s.message == "recording")
    assert recorders.values[0].key.endswith("/bag")
    assert recorders.values[0].value.endswith("0 messages lost")
    assert logger.stop() == 0 and process.stop() == 0
    assert len(process.stderr.splitlines()) < 10, process.stderr


# --- other subscribers, and nodes that die


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


def test_killed_nodes_are_not_missed_and_can_come_back(start, client, tmp_path):
    node, spin_until = client
    bags = (f"bag{i}" for i in itertools.count())
    given = {
        "sim_node": lambda: {"time_scale": 200},
        "stability_node": dict,
        "logger_node": lambda: {"output": next(bags)},
    }
    running = {name: start(name, **parameters()) for name, parameters in given.items()}
    simulator = ros_harness.Simulator(node, spin_until)
    floquet = node.create_client(ComputeFloquet, "/stability_node/compute_floquet")

    def simulates():
        del simulator.beads[:]
        simulator.wait_for_step(1)

    def computes():
        # Until the middleware gives up a killed node, it may get the requests for the new one.
        request = ComputeFloquet.Request(spin_rate_ratio=[-2.5])
        answered = ros_harness.ask_until_answered(floquet, request)
        spin_until(answered, ros_harness.START_S, "multipliers")

    def records():
        def newest():
            return max(tmp_path.glob("bag*/*.mcap"), key=lambda file: file.parent.name)

        file = ros_harness.wait_until(newest, ros_harness.START_S, "a bag")
        size = file.stat().st_size
        spin_until(lambda: file.stat().st_size > size, ros_harness.START_S, "more in the bag")

    works = {"sim_node": simulates, "stability_node": computes, "logger_node": records}
    for work in works.values():
        work()
    for victim in running:
        running[victim].kill()
        others = set(works) - {victim} - ({"logger_node"} if victim == "sim_node" else set())
        for name in others:  # without a simulator there is nothing to record
            works[name]()
        running[victim] = start(victim, **given[victim]())
        if victim == "logger_node":
            spin_until(lambda: (tmp_path / "bag1").exists(), ros_harness.START_S, "a new bag")
        for work in works.values():
            work()
    for process in running.values():
        assert process.stop() == 0, process.stderr


# --- under load


def test_requests_are_answered_while_a_stiff_system_is_integrated(start, client):
    """999 beads, of which every step costs a second: nobody waits for it."""
    process = start(
        "sim_node", beads_per_tether=332, time_scale=0, publish_period_s=5, disturbance_m=10
    )
    simulator = ros_harness.Simulator(*client)
    simulator.spin_until(lambda: simulator.status, ros_harness.START_S, "the simulator")
    times = {}

    def timed(name, work):
        work()  # finds the service
        begun = time.monotonic()
        work()
        times[name] = time.monotonic() - begun

    timed("state", lambda: simulator.do(GetSimulationState))
    timed("parameter", lambda: simulator.set(disturbance_m=5.0))
    paused = SimulationState(state=SimulationState.STATE_PAUSED)
    timed("pause", lambda: simulator.ask(SetSimulationState, state=paused))
    simulator.play()
    timed("time", lambda: simulator.do(ResetSimulation, scope=1))
    assert max(times.values()) < 0.5, times
    timed("reset", lambda: simulator.do(ResetSimulation))
    assert times["reset"] < 5.0, times  # the equilibrium of 999 beads has to be found
    assert process.stop() == 0, process.stderr


def test_random_requests_are_answered_rightly_or_refused(tmp_path):
    growth = request_fuzzer.run(tmp_path, 400, seed=20)
    assert all(kib < 20 * 1024 for kib in growth.values()), growth
