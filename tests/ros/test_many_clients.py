"""Many clients at once: each request is answered, if only by the word that the node is busy."""

import contextlib
import time

import pytest
import rclpy
import ros_harness
from action_msgs.msg import GoalStatus
from rclpy.action import ActionClient
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile
from simulation_interfaces.msg import SimulationState
from simulation_interfaces.srv import (
    GetEntitiesStates,
    GetSimulationState,
    SetSimulationState,
    StepSimulation,
)
from tss_interfaces.action import Follow, Sweep
from tss_interfaces.srv import ComputeFloquet, Disturb, GetStates

CLIENTS = 20
#: Answers that a client of these tests keeps unread: one process on a busy machine reads them all.
KEPT = QoSProfile(depth=1000)


@contextlib.contextmanager
def client_nodes(count):
    """Nodes of this process, and a function that spins them all until a condition holds."""
    context = rclpy.Context()
    rclpy.init(context=context)
    nodes = [rclpy.create_node(f"one_of_many_{i}", context=context) for i in range(count)]
    executor = SingleThreadedExecutor(context=context)
    for node in nodes:
        executor.add_node(node)

    def spin_until(condition, timeout_s, what):
        deadline = time.monotonic() + timeout_s
        while not condition():
            assert time.monotonic() < deadline, f"waited {timeout_s:g} s for {what}"
            executor.spin_once(timeout_sec=0.01)

    try:
        yield nodes, spin_until
    finally:
        for node in nodes:
            node.destroy_node()
        context.try_shutdown()


def ready_clients(nodes, spin_until, kind, name):
    """A client of each node, which the server has found as well."""
    clients = [node.create_client(kind, name, qos_profile=KEPT) for node in nodes]
    for client in clients:
        spin_until(client.service_is_ready, ros_harness.START_S, name)
        spin_until(ros_harness.ask_until_answered(client, kind.Request()), 30, "a first answer")
    return clients


def asked_at_once(spin_until, clients, request, each=1, timeout_s=20):
    """The answers to requests that all clients make before the first is answered."""
    answers = [client.call_async(request) for _ in range(each) for client in clients]
    spin_until(lambda: all(a.done() for a in answers), timeout_s, f"{len(answers)} answers")
    return [answer.result() for answer in answers]


def test_the_simulator_answers_all_of_twenty_clients(start):
    process = start("sim_node", start_paused=True, time_scale=0)
    with client_nodes(CLIENTS) as (nodes, spin_until):
        for kind, name, request in (
            (GetSimulationState, "get_simulation_state", GetSimulationState.Request()),
            (GetStates, "get_states", GetStates.Request()),
            (GetEntitiesStates, "get_entities_states", GetEntitiesStates.Request()),
            (Disturb, "disturb", Disturb.Request(random_offset_m=1.0)),
            (StepSimulation, "step_simulation", StepSimulation.Request(steps=2)),
        ):
            clients = ready_clients(nodes, spin_until, kind, f"/sim_node/{name}")
            answers = asked_at_once(spin_until, clients, request)
            results = [answer.result for answer in answers]
            assert len(results) == CLIENTS
            assert all(r.result == r.RESULT_OK or r.error_message for r in results)
            assert any(result.result == result.RESULT_OK for result in results)
    assert process.stop() == 0, process.stderr


def test_the_stability_node_answers_all_and_says_when_it_is_busy(start):
    process = start("stability_node")
    with client_nodes(CLIENTS) as (nodes, spin_until):
        clients = ready_clients(
            nodes, spin_until, ComputeFloquet, "/stability_node/compute_floquet"
        )
        quick = ComputeFloquet.Request(spin_rate_ratio=[-2.5], method="frozen")
        assert all(answer.success for answer in asked_at_once(spin_until, clients, quick))
        answers = asked_at_once(spin_until, clients, quick, each=10)
        busy = [answer.message for answer in answers if not answer.success]
        assert len(answers) == 10 * CLIENTS
        assert all(message.startswith("busy: 50 requests wait") for message in busy), busy
    assert process.stop() == 0, process.stderr


SWEEP = Sweep.Goal(spin_rate_ratio=[-2.5] * 10, method="frozen")
FOLLOW = Follow.Goal(start=-2.5, stop=-3.0)


@pytest.mark.parametrize(
    ("name", "kind", "goal", "count"),
    [("sweep", Sweep, SWEEP, 20), ("sweep", Sweep, SWEEP, 100), ("follow", Follow, FOLLOW, 60)],
)
def test_a_storm_of_goals_and_cancellations_is_answered(start, client, name, kind, goal, count):
    node, spin_until = client
    process, first = start("stability_node"), []
    services = ("goal_service", "result_service", "cancel_service")
    qos = {f"{service}_qos_profile": KEPT for service in services}
    actions = ActionClient(node, kind, f"/stability_node/{name}", **qos)
    spin_until(actions.server_is_ready, ros_harness.START_S, "the action")

    def accepted():  # the node may not yet have found who asks
        if len(first) < time.monotonic() - begun:
            first.append(actions.send_goal_async(goal))
        return any(future.done() for future in first)

    begun = time.monotonic()
    spin_until(accepted, 30, "a first goal")
    sent = [actions.send_goal_async(goal) for _ in range(count)]
    spin_until(lambda: all(future.done() for future in sent), 20, "every acceptance")
    handles = [future.result() for future in sent]
    results = [handle.get_result_async() for handle in handles]
    canceled = [handle.cancel_goal_async() for handle in handles for _ in range(2)]
    spin_until(lambda: all(future.done() for future in canceled), 20, "every cancellation")
    spin_until(lambda: all(future.done() for future in results), 20, "every result")
    statuses = {future.result().status for future in results}
    done = {GoalStatus.STATUS_SUCCEEDED, GoalStatus.STATUS_CANCELED, GoalStatus.STATUS_ABORTED}
    assert statuses <= done
    assert all(f.result().result.message or f.result().result.success for f in results)
    assert process.stop() == 0, process.stderr


def test_pausing_by_twenty_clients_pauses_once(start):
    process = start("sim_node", time_scale=10)
    with client_nodes(CLIENTS) as (nodes, spin_until):
        clients = ready_clients(
            nodes, spin_until, SetSimulationState, "/sim_node/set_simulation_state"
        )
        paused = SimulationState(state=SimulationState.STATE_PAUSED)
        request = SetSimulationState.Request(state=paused)
        results = [a.result.result for a in asked_at_once(spin_until, clients, request)]
        already = SetSimulationState.Response.ALREADY_IN_TARGET_STATE
        assert sorted(results) == [1] + [already] * (CLIENTS - 1)
    assert process.stop() == 0, process.stderr
