"""The simulator as a real process: what it publishes, when, by which names, and its parameters."""

import array
import math
import time

import numpy as np
import pytest
import ros_harness
import yaml
from diagnostic_msgs.msg import DiagnosticArray
from mcap.reader import make_reader
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import DescribeParameters, GetParameters, ListParameters, SetParameters
from rclpy.parameter import parameter_value_to_python
from recorded import (
    ORBIT_RATE,
    PERIOD_S,
    STEPS,
    TURN_S,
    messages_by_topic,
    record_one_turn,
    recorded_steps,
)
from ros_harness import time_ns
from rosgraph_msgs.msg import Clock
from simulation_interfaces.msg import SimulationState
from simulation_interfaces.srv import (
    GetSimulationState,
    ResetSimulation,
    SetSimulationState,
    StepSimulation,
)
from tss_interfaces.msg import BeadStates

from tss_ros.ros import parameters

# --- what a step consists of


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """The folder of one recorded turn."""
    return record_one_turn(tmp_path_factory.mktemp("run"))


def test_messages_of_a_step_agree(run):
    messages = messages_by_topic(run / "bag")
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
    messages = messages_by_topic(run / "bag")
    _, first = messages["/bead_states"][0]
    _, described = messages["/system_description"][0]
    # Undisturbed, the satellites stand at pi/2 + i 2 pi/3 (Eq. 50).
    angle = math.pi / 2 + np.arange(3) * 2 * math.pi / 3
    radius_m = described.reference_radius_m
    undisturbed_m = np.column_stack([radius_m * np.cos(angle), radius_m * np.sin(angle), 0 * angle])
    offset_m = first.position_m.reshape(-1, 3) - undisturbed_m
    assert np.linalg.norm(offset_m) == pytest.approx(10.0, rel=1e-6)
    assert (described.disturbance_m, described.disturbance_seed) == (10.0, 7)


# --- time


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
    assert 0.85 < wall_s * scale / simulated_s < 4.0  # a busy machine may hold it up


def test_clock_spares_its_followers(start):
    simulator = start("sim_node", time_scale=0)
    with ros_harness.client_node() as (node, spin_until):
        arrivals = []
        node.create_subscription(
            Clock, "/clock", lambda message: arrivals.append(message.clock), 500
        )
        spin_until(lambda: arrivals, ros_harness.START_S, "a clock")
        arrivals.clear()
        began = time.monotonic()
        spin_until(lambda: len(arrivals) > 500, ros_harness.START_S, "500 clock messages")
        # 200 a second, and those that waited for a busy machine; it takes some thousand steps.
        assert len(arrivals) / (time.monotonic() - began) < 400
        seconds = [stamp.sec + stamp.nanosec * 1e-9 for stamp in arrivals]
        assert seconds == sorted(seconds)
    assert simulator.stop() == 0


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


# --- parameters and diagnostics


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
        "recorder_patience_s",
        "service_folder",
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
    # One that has the scenario's value follows the scenario.
    assert value_of(simulator, "satellite_mass_kg") == 5.0
    assert simulator.set(satellite_mass_kg=100, scenario="three_star_50kg").successful
    assert value_of(simulator, "satellite_mass_kg") == 100.0
    assert simulator.set(satellite_mass_kg=50.0).successful
    assert simulator.set(scenario="three_star_1000kg").successful
    assert value_of(simulator, "satellite_mass_kg") == 1000.0
    assert simulator.set(scenario="three_star").successful
    # A type that no parameter has.
    wrong = Parameter(name="time_scale", value=ParameterValue(type=99))
    good = Parameter(name="time_scale", value=ParameterValue(type=3, double_value=3.0))
    request = SetParameters.Request(parameters=[good, wrong, good])
    name = "/sim_node/set_parameters"
    answer = ros_harness.call(node, spin_until, SetParameters, name, request)
    assert [result.successful for result in answer.results] == [True, False, True]
    assert "99" in answer.results[1].reason
    assert process.stop() == 0 and "rror" not in process.stderr


def value_of(simulator, name):
    """The value that the simulator has for a parameter."""
    request = GetParameters.Request(names=[name])
    node, spin_until = simulator.node, simulator.spin_until
    answer = ros_harness.call(node, spin_until, GetParameters, "/sim_node/get_parameters", request)
    return parameter_value_to_python(answer.values[0])


def dumped(simulator):
    """All parameters of the simulator, as `ros2 param dump` writes them."""
    node, spin_until = simulator.node, simulator.spin_until
    listed = ros_harness.call(
        node, spin_until, ListParameters, "/sim_node/list_parameters", ListParameters.Request()
    )
    names = sorted(listed.result.names)
    request = GetParameters.Request(names=names)
    answer = ros_harness.call(node, spin_until, GetParameters, "/sim_node/get_parameters", request)
    assert len(answer.values) == len(names)
    assert all(value.type != ParameterType.PARAMETER_NOT_SET for value in answer.values)
    return dict(zip(names, answer.values))


def test_parameters_go_round(start, client, tmp_path):
    """All of them have values: written to a file they start the same simulator, or are loaded."""
    own = tmp_path / "own.yaml"
    own.write_text(
        "spin_rate_ratio: -5.0\norbit_altitude_m: 1.0e+6\nbodies:\n"
        "  - {name: a, mass_kg: 100.0, position_m: [0.0, 5000.0, 0.0]}\n"
        "  - {name: b, mass_kg: 100.0, position_m: [0.0, -5000.0, 0.0]}\n"
        "tethers:\n  - {between: [a, b], length_m: 10000.0, axial_stiffness_n: 50000.0,"
        " damping_n_s_per_m: 1450.0}\n"
    )
    masses_kg = [100.0, 200.0, 100.0, 200.0]
    given = {"spin_rate_ratio": -5, "satellites": 4, "satellite_mass_kg": masses_kg}
    first = start("sim_node", start_paused=True, turns=3, service_folder=str(tmp_path), **given)
    simulator = ros_harness.Simulator(*client)
    simulator.do(GetSimulationState)
    values = dumped(simulator)
    assert parameter_value_to_python(values["satellites"]) == 4
    assert parameter_value_to_python(values["tether_length_m"]) == 10e3
    assert parameter_value_to_python(values["spin_rate_ratio"]) == -5.0
    # Another formation has other parameters, and all of them at once bring the first one back.
    assert simulator.set(scenario="six_bead", **dict.fromkeys(given)).successful
    assert value_of(simulator, "beads_per_tether") == 1
    assert simulator.set(scenario=str(own)).successful
    assert "satellites" not in dumped(simulator) and value_of(simulator, "spin_rate_ratio") == -5.0
    load = [Parameter(name=name, value=value) for name, value in values.items()]
    request = SetParameters.Request(parameters=load)
    node, spin_until = client
    answer = ros_harness.call(node, spin_until, SetParameters, "/sim_node/set_parameters", request)
    assert all(result.successful for result in answer.results), answer.results
    assert dumped(simulator) == values
    assert first.stop() == 0, first.stderr
    plain = {name: parameter_value_to_python(value) for name, value in values.items()}
    plain = {n: list(v) if isinstance(v, array.array) else v for n, v in plain.items()}
    file = tmp_path / "dump.yaml"
    file.write_text(yaml.safe_dump({"/sim_node": {"ros__parameters": plain}}))
    second = start("sim_node", "--params-file", str(file))
    again = ros_harness.Simulator(*client)
    again.do(GetSimulationState)
    assert dumped(again) == values
    assert second.stop() == 0, second.stderr


def test_diagnostics_tell_pace_slack_and_recorders(start, client):
    node, spin_until = client
    reports = {}

    def keep(message):
        reports.update({status.name: status for status in message.status})

    node.create_subscription(DiagnosticArray, "/diagnostics", keep, 10)
    process = start("sim_node", spin_rate_ratio=-1.2, time_scale=1000, publish_period_s=5)

    def report(task, condition):
        def look():
            status = reports.get(f"sim_node: {task}")
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
    assert max(times.values()) < max(0.5, simulator.status[-1].step_cost_s / 2.0), times
    simulator.do(ResetSimulation)
    assert process.stop() == 0, process.stderr


def test_a_scenario_with_velocities_is_where_the_motion_starts(start, client, tmp_path):
    (tmp_path / "released.yaml").write_text(
        "spin_rate_ratio: -3.0\nbodies:\n"
        "  - {name: a, mass_kg: 100, position_m: [0, 500, 0], velocity_m_s: [1.5, 0.0, 0.4]}\n"
        "  - {name: b, mass_kg: 100, position_m: [0, -500, 0], velocity_m_s: [-1.5, 0.0, -0.4]}\n"
        "tethers:\n  - {between: [a, b], length_m: 1000.0, axial_stiffness_n: 5.0e4,"
        " damping_n_s_per_m: 500.0}\n"
    )
    scenario = str(tmp_path / "released.yaml")
    start("sim_node", scenario=scenario, start_paused=True, disturbance_m=0.0)
    simulator = ros_harness.Simulator(*client)
    simulator.do(ResetSimulation)
    first = simulator.spin_until(lambda: simulator.beads, ros_harness.START_S, "a state")[0]
    assert first.position_m.tolist() == [0, 500, 0, 0, -500, 0]
    assert first.velocity_m_s.tolist() == [1.5, 0.0, 0.4, -1.5, 0.0, -0.4]
