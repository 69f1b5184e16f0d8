"""How every node starts and ends: signals, wrong parameters, kills, and requests at random."""

import itertools
import signal

import pytest
import request_fuzzer
import ros_harness
from recorded import recorded_steps
from tss_interfaces.srv import ComputeFloquet

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
    steps = recorded_steps(bag.parent, "/bead_states")
    assert steps == list(range(len(steps))) and len(steps) > 100


@pytest.mark.long
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
            last = max(tmp_path.glob("bag*"), key=lambda bag: bag.name)
            return sum(file.stat().st_size for file in last.glob("*.mcap"))

        size = ros_harness.wait_until(newest, ros_harness.START_S, "a bag")
        spin_until(lambda: newest() > size, ros_harness.START_S, "more in the bag")

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


# --- refusing wrong parameters

#: One for each way to be found out; tests/ros/test_parameters.py has the rest.
WRONG_PARAMETERS = [
    ("sim_node", {"satellites": 1_000_000}, ("satellites", "1000000", "2 to 1000")),
    ("sim_node", {"satellite_mass_kg": [1.0, 2.0]}, ("satellite_mass_kg", "2", "3")),
    ("sim_node", {"satellite_mass_kg": "[1, 2.5, 3]"}, ("satellite_mass_kg", "[1, 2.5, 3]")),
    ("sim_node", {"axial_stiffness_n": []}, ("axial_stiffness_n", "nothing")),
    ("sim_node", {"spin_rate_ratio": 0.0001}, ("spin_rate_ratio", "0.0001", "0.001")),
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


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--params-file", "missing.yaml"), "missing.yaml"),
        (("spin_rate_ratio:=-2.9",), "'spin_rate_ratio:=-2.9']; a parameter is given as -p NAME"),
    ],
)
def test_wrong_arguments_of_ros_end_a_node_with_one_line(start, arguments, said):
    process = start("sim_node", *arguments)
    assert process.wait(ros_harness.START_S) == 1
    (line,) = process.stderr.splitlines()
    assert line.startswith("sim_node: ") and said in line


# --- requests


@pytest.mark.parametrize("requests", [400, pytest.param(10_000, marks=pytest.mark.long)])
def test_random_requests_are_answered_rightly_or_refused(tmp_path, requests):
    growth = request_fuzzer.run(tmp_path, requests, seed=20)
    assert all(kib < 20 * 1024 + 2 * requests for kib in growth.values()), growth
