"""The stability node's action `~/sweep`: many systems and rates, feedback, cancellation."""

import contextlib
import math
import re
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import dask_cluster
import numpy as np
import pytest
import ros_harness
from action_msgs.msg import GoalStatus
from paper import tension
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rclpy.action import ActionClient
from rclpy.qos import QoSProfile
from scipy.optimize import brentq
from tss_interfaces.action import Sweep
from tss_interfaces.msg import FloquetResult
from tss_interfaces.srv import ComputeFloquet

from tss_ros.core import compute_floquet
from tss_ros.scenarios import scenario

CANCEL_S = 5.0


class Client:
    """Sends goals to a stability node and keeps what it publishes."""

    def __init__(self, node, spin_until, process, namespace):
        self.node, self.spin_until, self.process = node, spin_until, process
        self._services = f"{namespace}/stability_node"
        self.published = []
        node.create_subscription(
            FloquetResult, f"{namespace}/stability_results", self.published.append, 100
        )
        qos = QoSProfile(depth=1000)
        name = f"{self._services}/sweep"
        self._sweeps = ActionClient(node, Sweep, name)
        # Not by the client, which takes no feedback any more once it has the result.
        kind, self._told = Sweep.Impl.FeedbackMessage, {}
        node.create_subscription(kind, f"{name}/_action/feedback", self._keep_feedback, qos)
        spin_until(self._sweeps.server_is_ready, ros_harness.START_S, "the action")

    def send(self, goal):
        """An accepted goal, its feedback as it comes, and a future of its result."""
        sent = self._sweeps.send_goal_async(goal)
        self.spin_until(sent.done, 10, "the goal's acceptance")
        handle = sent.result()
        assert handle.accepted
        told = self._told.setdefault(bytes(handle.goal_id.uuid), [])
        return handle, told, handle.get_result_async()

    def _keep_feedback(self, message):
        self._told.setdefault(bytes(message.goal_id.uuid), []).append(message.feedback)

    def run(self, **fields):
        """Status, result and feedback of a goal."""
        _, feedback, answer = self.send(Sweep.Goal(**fields))
        self.spin_until(answer.done, 120, "the result")
        result = answer.result().result
        if result.success:
            told = self.spin_until(lambda: feedback, 5, "feedback")
            self.spin_until(lambda: told[-1].done == told[-1].total, 5, "the last feedback")
        return answer.result().status, result, feedback

    def cancel(self, handle, answer):
        """The status and result of a canceled goal."""
        handle.cancel_goal_async()
        self.spin_until(answer.done, CANCEL_S, "the end of a canceled goal")
        return answer.result().status, answer.result().result

    def compute(self, rate):
        """A result of the service, which answers whatever the sweeps do."""
        request = ComputeFloquet.Request(spin_rate_ratio=[rate])
        name = f"{self._services}/compute_floquet"
        response = ros_harness.call(
            self.node, self.spin_until, ComputeFloquet, name, request, timeout_s=20
        )
        assert response.success and self.process.running
        return response.results[0]


@contextlib.contextmanager
def started(directory, namespace, **parameters):
    with (
        ros_harness.processes(directory) as start,
        ros_harness.client_node() as (node, spin_until),
    ):
        process = start("stability_node", "-r", f"__ns:={namespace}", **parameters)
        yield Client(node, spin_until, process, namespace)
        if process.running:
            assert process.stop() == 0, process.stderr
        assert "Traceback" not in process.stderr


@pytest.fixture(scope="module")
def client(tmp_path_factory):
    with started(tmp_path_factory.mktemp("sweep"), "/sweeping") as client:
        yield client


def override(name, value):
    value = ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=value)
    return Parameter(name=name, value=value)


def texts(messages):
    """Messages to be compared: as they stand, those with NaN differ from themselves."""
    return sorted(map(str, messages))


@pytest.fixture
def another_process():
    """Runs functions in a process that computes nothing else, as a node does.

    What compiled functions round in the last bits depends on which of them a process loads first.
    """
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as executor:
        yield executor


def test_rows_are_what_the_core_computes_in_the_order_of_the_request(client, another_process):
    client.published.clear()
    values, rates = [1450.0, 3000.0], [-2.5, 1.5, -3.0]
    status, result, feedback = client.run(
        parameter="damping_n_s_per_m",
        value=values,
        spin_rate_ratio=rates,
        spin_rate_ratio_from=-2.14,
        spin_rate_ratio_to=-2.2,
        tolerance=0.005,
    )
    assert status == GoalStatus.STATUS_SUCCEEDED and result.success and result.message == ""
    assert [row.value for row in result.rows] == values
    for row in result.rows:
        system = scenario.load("three_star").build({"damping_n_s_per_m": row.value})
        assert [r.spin_rate_ratio for r in row.results] == rates
        for found in row.results:
            ratio = found.spin_rate_ratio
            computed = another_process.submit(compute_floquet, system, ratio, certify=False)
            expected = computed.result()
            assert found.verdict == expected.verdict and found.period_s == expected.period_s
            multiplier = np.array(found.multiplier_real) + 1j * np.array(found.multiplier_imag)
            np.testing.assert_array_equal(multiplier, expected.multiplier)
            assert math.isnan(found.segment_error) and not found.confirmation
    # With the stronger damping the tethers stay taut throughout this interval.
    slack, taut = (row.rates for row in result.rows)
    edge = brentq(tension, -2.4, -1.9, args=(1450.0,))
    assert slack[0].cause == "first slack" and slack[0].stable_side == -1
    assert slack[0].spin_rate_ratio == pytest.approx(edge, abs=slack[0].uncertainty + 0.001)
    assert tension(-2.14, 3000.0) > 0.0 and len(taut) == 0

    assert [told.total for told in feedback] == [8] * len(feedback)
    assert [told.done for told in feedback] == sorted(told.done for told in feedback)
    for row in result.rows:
        parts = [told.row for told in feedback if told.row.value == row.value]
        assert texts(r for part in parts for r in part.results) == texts(row.results)
        assert texts(r for part in parts for r in part.rates) == texts(row.rates)
    client.spin_until(lambda: len(client.published) >= 6, 5, "the published results")
    assert texts(client.published) == texts(r for row in result.rows for r in row.results)


def test_whatever_the_service_computes_is_published(client):
    client.published.clear()
    result = client.compute(-2.75)
    client.spin_until(lambda: client.published, 5, "the published result")
    assert texts(client.published) == texts([result])


def test_one_system_without_a_parameter_makes_one_row(client):
    status, result, _ = client.run(
        spin_rate_ratio=[-2.5, 1e-4, -3.0],
        method="frozen",
        overrides=[override("satellite_mass_kg", 50.0), override("spin_rate_ratio", -3.0)],
    )
    assert status == GoalStatus.STATUS_SUCCEEDED
    assert "spin_rate_ratio in overrides has no effect" in result.message
    (row,) = result.rows
    assert math.isnan(row.value) and row.message == ""
    good, bad, also_good = row.results
    assert good.verdict and also_good.verdict and math.isnan(good.flow_error)
    assert bad.verdict == "" and "spin_rate_ratio" in bad.message
    system = scenario.load("three_star").build({"satellite_mass_kg": 50.0})
    assert good.max_modulus == compute_floquet(system, -2.5, "frozen").max_modulus


def test_a_value_that_makes_no_system_spoils_only_its_own_row(client):
    values = [3.0, 1.0, 2.5, 4.0, 101.0]
    status, result, feedback = client.run(
        parameter="satellites", value=values, spin_rate_ratio=[-2.5], method="frozen"
    )
    assert status == GoalStatus.STATUS_SUCCEEDED
    assert result.message == "3 of 5 values make no system"
    assert [row.value for row in result.rows] == values
    assert [len(row.results) for row in result.rows] == [1, 0, 0, 1, 0]
    assert [len(row.results[0].family) for row in result.rows if row.results] == [18, 24]
    messages = [row.message for row in result.rows]
    assert messages[0] == messages[3] == ""
    assert "satellites is 1" in messages[1] and "2 to 1000" in messages[1]
    assert "satellites is 2.5" in messages[2] and "whole number" in messages[2]
    assert "101" in messages[4] and "at most 100" in messages[4]
    assert feedback[-1].total == 2


def test_a_sweep_varies_the_tether_law(client):
    laws = ["tension_only", "kelvin_voigt"]
    status, result, feedback = client.run(
        parameter="tether_law", text_value=laws, spin_rate_ratio=[-2.4, -2.3]
    )
    assert status == GoalStatus.STATUS_SUCCEEDED and result.success, result.message
    assert [row.text_value for row in result.rows] == laws
    assert all(math.isnan(row.value) for row in result.rows)
    for row in result.rows:
        assert [found.tether_law for found in row.results] == [row.text_value] * 2
        pushes = row.text_value == "kelvin_voigt"
        assert all((found.pushing_share > 0) == pushes for found in row.results)
    assert {told.row.text_value for told in feedback} <= {"", *laws}


RATES = {"spin_rate_ratio": [-2.5]}


@pytest.mark.parametrize(
    ("fields", "expected"),
    [
        ({}, ("spin_rate_ratio is empty", "rates, an interval, or both")),
        ({**RATES, "method": "exact"}, ("method is 'exact'", "frozen")),
        (
            {**RATES, "parameter": "damping", "value": [1.0]},
            ("parameter is 'damping'", "damping_n_s_per_m"),
        ),
        (
            {**RATES, "parameter": "spin_rate_ratio", "value": [1.0]},
            ("parameter is 'spin_rate_ratio'", "damping_n_s_per_m"),
        ),
        ({**RATES, "parameter": "satellites"}, ("'satellites'", "0 values", "both or neither")),
        ({**RATES, "value": [1.0, 2.0]}, ("parameter is ''", "2 values", "both or neither")),
        ({**RATES, "parameter": "satellites", "value": [1.0]}, ("satellites is 1", "2 to 1000")),
        (
            {**RATES, "parameter": "tether_law", "value": [1.0]},
            ("'tether_law'", "text_value has 0 values", "both or neither"),
        ),
        (
            {**RATES, "parameter": "satellites", "value": [3.0], "text_value": ["a"]},
            ("'satellites'", "text_value has 1 values", "none"),
        ),
        (
            {**RATES, "parameter": "tether_law", "text_value": ["tension"]},
            ("tether_law is 'tension'", "did you mean 'tension_only'?"),
        ),
        (
            {**RATES, "parameter": "tether_law", "text_value": [""]},
            ("tether_law is ''", "one of kelvin_voigt"),
        ),
        (
            {
                **RATES,
                "parameter": "damping_n_s_per_m",
                "value": [1.0],
                "overrides": [override("damping_n_s_per_m", 2.0)],
            },
            ("parameter is 'damping_n_s_per_m', also in overrides",),
        ),
        ({**RATES, "overrides": [override("mass", 2.0)]}, ("'mass'", "satellite_mass_kg")),
        ({"spin_rate_ratio": [-2.5] * 10_001}, ("10001 jobs", "at most 10000")),
        (
            {"parameter": "satellites", "value": [100.0] * 11, "spin_rate_ratio": [-2.5] * 100},
            ("1100 jobs", "100000 beads"),
        ),
        ({"spin_rate_ratio_from": 1e3, "spin_rate_ratio_to": -1e3}, ("2000 apart", "1000")),
        ({"spin_rate_ratio_to": math.nan}, ("spin_rate_ratio_to is nan", "10000")),
        (
            {"spin_rate_ratio_from": -2.0, "spin_rate_ratio_to": -1.9, "tolerance": 1.0},
            ("tolerance is 1.0", "1e-06 to 0.1"),
        ),
    ],
)
def test_a_wrong_goal_is_aborted_in_words(client, fields, expected):
    status, result, feedback = client.run(**fields)
    assert status == GoalStatus.STATUS_ABORTED and not result.success
    assert all(part in result.message for part in expected), result.message
    assert len(result.rows) == 0 and feedback == []
    assert client.compute(-2.5).verdict


def test_sweeps_wait_for_each_other_and_can_be_canceled(client):
    rates = np.linspace(-3.5, -2.5, 10_000).tolist()
    first, told, first_answer = client.send(Sweep.Goal(spin_rate_ratio=rates))
    client.spin_until(lambda: told, 30, "feedback")
    second, _, second_answer = client.send(Sweep.Goal(spin_rate_ratio=[-2.5]))
    third, told_third, third_answer = client.send(Sweep.Goal(spin_rate_ratio=[-2.5]))
    wrong = client.run()
    assert wrong[0] == GoalStatus.STATUS_ABORTED
    status, result = client.cancel(second, second_answer)
    assert status == GoalStatus.STATUS_CANCELED and not result.success
    assert result.message == "canceled before it began" and len(result.rows) == 0
    assert client.compute(-2.5).verdict and not first_answer.done() and not told_third

    status, result = client.cancel(first, first_answer)
    assert status == GoalStatus.STATUS_CANCELED and not result.success
    done = int(re.fullmatch(r"canceled with (\d+) of 10000 jobs done", result.message)[1])
    (row,) = result.rows
    assert 0 < len(row.results) == done < 10_000
    found = [r.spin_rate_ratio for r in row.results]
    assert (
        found == sorted(found) and set(found) < set(rates) and all(r.verdict for r in row.results)
    )
    client.spin_until(lambda: told[-1].done == done, 5, "the last feedback")
    assert sum(len(message.row.results) for message in told) == done

    client.spin_until(third_answer.done, 20, "the third goal's result")
    assert third_answer.result().status == GoalStatus.STATUS_SUCCEEDED


def test_a_sweep_ends_with_the_node(tmp_path):
    with started(tmp_path, "/ending") as client:
        interval = {"spin_rate_ratio_from": -2.1, "spin_rate_ratio_to": -1.1}
        rates = np.linspace(-2.4, -1.5, 1000).tolist()
        _, told, _ = client.send(Sweep.Goal(spin_rate_ratio=rates, **interval))
        client.spin_until(lambda: told, 30, "feedback")
        assert client.process.stop() == 0, client.process.stderr


@pytest.mark.long
def test_a_cluster_sweeps_as_well_as_the_node_and_its_loss_is_told(client, tmp_path):
    goal = {"spin_rate_ratio": [-2.5, 1e-4, -3.0], "parameter": "satellites", "value": [3.0, 1.0]}
    interval = {"spin_rate_ratio_from": -2.1, "spin_rate_ratio_to": -1.1, "tolerance": 1e-5}
    here = client.run(**goal)[1]
    with (
        dask_cluster.running(tmp_path, 2) as dask,
        started(tmp_path, "/clustered", scheduler=dask.address) as clustered,
    ):
        status, result, feedback = clustered.run(**goal)
        assert status == GoalStatus.STATUS_SUCCEEDED and str(result) == str(here)
        assert feedback[-1].done == feedback[-1].total == 3
        handle, told, answer = clustered.send(Sweep.Goal(**interval, **goal))
        clustered.spin_until(lambda: told, 30, "feedback")
        status, result = clustered.cancel(handle, answer)
        assert status == GoalStatus.STATUS_CANCELED and "of 4 jobs done" in result.message
        _, told, answer = clustered.send(Sweep.Goal(**interval, **goal))
        clustered.spin_until(lambda: told, 30, "feedback")
        dask.scheduler.kill()
        clustered.spin_until(answer.done, 30, "the end of a goal whose cluster is lost")
        lost = answer.result()
        assert lost.status == GoalStatus.STATUS_ABORTED
        assert lost.result.message == f"the Dask scheduler at {dask.address} is lost"
        assert sum(len(row.results) for row in lost.result.rows) >= 1
        assert clustered.compute(-2.5).verdict


def test_a_wrong_scheduler_is_refused_when_the_node_starts(tmp_path):
    with ros_harness.processes(tmp_path) as start:
        process = start("stability_node", scheduler="localhost")
        assert process.wait(ros_harness.START_S) == 1
    assert "scheduler is 'localhost'; allowed: tcp://HOST:PORT" in process.stderr
