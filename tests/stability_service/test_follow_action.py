"""The stability node's action `~/follow`: families of motions, feedback, cancellation, starts."""

import math

import numpy as np
import pytest
import ros_harness
from action_msgs.msg import GoalStatus
from paper import tension
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rclpy.action import ActionClient
from rclpy.qos import QoSProfile
from released_pair import SCENARIO
from scipy.optimize import brentq
from tss_interfaces.action import Follow, Sweep
from tss_interfaces.msg import SpecialPoint
from tss_interfaces.srv import ComputeFloquet, FindCriticalRates

from tss_ros.core import compute_floquet, follow
from tss_ros.scenarios import scenario

TO_FIRST_SLACK = {"start": -2.2, "stop": -2.14}


class Client:
    """Sends goals to a stability node."""

    def __init__(self, node, spin_until, namespace):
        self.node, self.spin_until = node, spin_until
        self.services = f"{namespace}/stability_node"
        qos = QoSProfile(depth=1000)
        self.actions = {
            kind: ActionClient(node, kind, f"{self.services}/{name}", feedback_sub_qos_profile=qos)
            for kind, name in ((Follow, "follow"), (Sweep, "sweep"))
        }
        for action in self.actions.values():
            spin_until(action.server_is_ready, ros_harness.START_S, "the action")

    def send(self, goal):
        """An accepted goal, its feedback as it comes, and a future of its result."""
        feedback, action = [], self.actions[Follow if isinstance(goal, Follow.Goal) else Sweep]
        sent = action.send_goal_async(goal, lambda message: feedback.append(message.feedback))
        self.spin_until(sent.done, 10, "the goal's acceptance")
        assert sent.result().accepted
        return sent.result(), feedback, sent.result().get_result_async()

    def run(self, **fields):
        """Status, result and feedback of a goal."""
        _, feedback, answer = self.send(Follow.Goal(**fields))
        self.spin_until(answer.done, 120, "the result")
        return answer.result().status, answer.result().result, feedback

    def ask(self, kind, name, request):
        return ros_harness.call(
            self.node, self.spin_until, kind, f"{self.services}/{name}", request, timeout_s=60
        )


@pytest.fixture(scope="module")
def clients(tmp_path_factory):
    directory = tmp_path_factory.mktemp("follow")
    (directory / "own.yaml").write_text(SCENARIO)
    with (
        ros_harness.processes(directory) as start,
        ros_harness.client_node() as (node, spin_until),
    ):
        plain = start("stability_node", "-r", "__ns:=/plain")
        own = start("stability_node", "-r", "__ns:=/own", scenario=str(directory / "own.yaml"))
        yield Client(node, spin_until, "/plain"), Client(node, spin_until, "/own")
        for process in (plain, own):
            assert process.stop() == 0, process.stderr
            assert "Traceback" not in process.stderr


def double(name, value):
    value = ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=value)
    return Parameter(name=name, value=value)


def test_a_family_past_first_slack_with_all_its_points_fed_back(clients):
    client, _ = clients
    status, result, feedback = client.run(**TO_FIRST_SLACK)
    assert status == GoalStatus.STATUS_SUCCEEDED and result.success, result.message
    assert result.message == result.ended == ""
    assert (result.points[0].parameter, result.points[-1].parameter) == (-2.2, -2.14)
    special, spin = result.special
    assert spin.kind == SpecialPoint.KIND_SPIN_DIVERGENCE
    edge = brentq(tension, -2.4, -1.9, args=(1450.0,))
    assert special.kind == "first slack" and special.parameter == pytest.approx(edge, abs=1e-3)
    assert math.isnan(special.multiplier_real) and 0.0 < special.uncertainty < 1e-6
    sides = result.points[special.after : special.after + 2]
    assert [point.slack for point in sides] == [False, True]

    system = scenario.load("three_star").build()
    expected, _ = follow(system, "spin_rate_ratio", -2.2, -2.14).special
    assert expected.after == special.after
    assert expected.parameter == pytest.approx(special.parameter, abs=special.uncertainty)
    first = result.points[0]
    alone = compute_floquet(system, -2.2, certify=False)
    assert first.verdict == alone.verdict and first.spin_rate_ratio == pytest.approx(-2.2)
    np.testing.assert_allclose(
        np.sort(np.hypot(first.multiplier_real, first.multiplier_imag)),
        np.sort(np.abs(alone.multiplier)),
        atol=1e-3,
    )
    assert len(first.position_m) == len(first.velocity_m_s) == 3 * system.n

    told = [point for message in feedback for point in message.points]
    own = [str(point) for point in result.points]
    assert [str(point) for point in told] == own[1 : len(told) + 1] and told
    assert all(0.0 <= message.done <= 1.0 for message in feedback)


def test_another_parameter_at_the_scenarios_own_rate_with_overrides(clients):
    client, _ = clients
    status, result, _ = client.run(
        parameter="damping_n_s_per_m",
        start=1400.0,
        stop=1500.0,
        overrides=[double("satellite_mass_kg", 90.0), double("spin_rate_ratio", -2.6)],
    )
    assert status == GoalStatus.STATUS_SUCCEEDED and result.message == ""
    assert {round(point.spin_rate_ratio, 9) for point in result.points} == {-2.6}
    assert result.points[-1].parameter == 1500.0


def test_a_start_leads_to_the_motion_it_is_next_to(clients):
    client, _ = clients
    _, taut, _ = client.run(**TO_FIRST_SLACK)
    near = taut.points[0]
    given = {"position_m": near.position_m, "velocity_m_s": near.velocity_m_s}
    status, again, _ = client.run(**TO_FIRST_SLACK, **given)
    assert status == GoalStatus.STATUS_SUCCEEDED
    np.testing.assert_allclose(again.points[0].position_m, near.position_m, atol=1e-2)
    request = ComputeFloquet.Request(spin_rate_ratio=[-2.2], certify=False, **given)
    answer = client.ask(ComputeFloquet, "compute_floquet", request)
    assert answer.success and answer.results[0].verdict == near.verdict
    assert "given" in answer.results[0].message
    request.velocity_m_s = [1.0]
    answer = client.ask(ComputeFloquet, "compute_floquet", request)
    assert not answer.success and "velocity_m_s has 1 numbers; allowed: 9" in answer.message


def test_a_scenario_with_velocities_of_its_own_is_a_start_everywhere(clients):
    _, client = clients
    status, result, _ = client.run(start=-3.0, stop=-2.95)
    assert status == GoalStatus.STATUS_SUCCEEDED, result.message
    request = ComputeFloquet.Request(spin_rate_ratio=[-3.0], certify=False)
    answer = client.ask(ComputeFloquet, "compute_floquet", request)
    assert "scenario's velocities" in answer.results[0].message
    assert answer.results[0].verdict == result.points[0].verdict
    request = FindCriticalRates.Request(spin_rate_ratio_from=-3.0, spin_rate_ratio_to=-2.95)
    answer = client.ask(FindCriticalRates, "find_critical_rates", request)
    assert "velocities have no effect" in answer.message


@pytest.mark.parametrize(
    "fields, expected",
    [
        ({}, ("interval", "empty")),
        ({"start": -3.0, "stop": 3.0}, ("must keep its sign",)),
        ({"start": -3.0, "stop": math.nan}, ("nan",)),
        ({"start": -3.0, "stop": -2.0, "spin_rate_ratio": -2.0}, ("spin_rate_ratio is followed",)),
        ({"parameter": "mass", "start": 1.0, "stop": 2.0}, ("'mass'", "satellite_mass_kg")),
        ({**TO_FIRST_SLACK, "longest_step": 2.0}, ("longest_step is 2.0", "0.0001 to 1")),
        ({**TO_FIRST_SLACK, "most_points": 10_001}, ("most_points is 10001", "1 to 10000")),
        ({**TO_FIRST_SLACK, "position_m": [1.0] * 9}, ("velocity_m_s has 0 numbers",)),
        ({**TO_FIRST_SLACK, "overrides": [double("mass", 2.0)]}, ("'mass'",)),
    ],
)
def test_a_wrong_goal_is_aborted_in_words(clients, fields, expected):
    status, result, feedback = clients[0].run(**fields)
    assert status == GoalStatus.STATUS_ABORTED and not result.success
    assert all(part in result.message for part in expected), result.message
    assert len(result.points) == 0 and feedback == []


def test_a_canceled_goal_keeps_what_was_found_and_the_next_one_has_its_turn(clients):
    client, _ = clients
    long = Follow.Goal(start=-9.0, stop=-2.3, longest_step=1e-4, most_points=10_000)
    first, told, answer = client.send(long)
    client.spin_until(lambda: told, 30, "feedback")
    _, _, sweep = client.send(Sweep.Goal(spin_rate_ratio=[-2.5]))
    assert not sweep.done()
    first.cancel_goal_async()
    client.spin_until(answer.done, 10, "the end of a canceled goal")
    status, result = answer.result().status, answer.result().result
    assert status == GoalStatus.STATUS_CANCELED and not result.success
    assert result.message == f"canceled with {len(result.points)} points found"
    assert result.ended.startswith("canceled at -") and 1 <= len(result.points) < 10_000
    client.spin_until(sweep.done, 20, "the sweep that waited")
    assert sweep.result().status == GoalStatus.STATUS_SUCCEEDED
