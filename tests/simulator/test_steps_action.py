"""The action SimulateSteps: every step told, every goal answered, whatever becomes of it."""

import pytest
import ros_harness
from action_msgs.msg import GoalStatus
from rclpy.action import ActionClient
from rclpy.qos import QoSProfile
from simulation_interfaces.action import SimulateSteps
from simulation_interfaces.msg import Result, SimulationState
from simulation_interfaces.srv import GetSimulationState, ResetSimulation, StepSimulation

KEPT = QoSProfile(depth=1000)
DONE, CANCELED = GoalStatus.STATUS_SUCCEEDED, GoalStatus.STATUS_CANCELED
ABORTED = GoalStatus.STATUS_ABORTED
FAILED = Result.RESULT_OPERATION_FAILED


@pytest.fixture
def served(start, client):
    """A paused simulator, and a function that sends a goal and returns its handle and feedback."""
    node, spin_until = client
    process = start("sim_node", start_paused=True, time_scale=0)
    simulator = ros_harness.Simulator(node, spin_until)
    simulator.join()
    names = ("goal_service", "result_service", "cancel_service")
    qos = {f"{name}_qos_profile": KEPT for name in names}
    qos["feedback_sub_qos_profile"] = KEPT
    steps = ActionClient(node, SimulateSteps, "/sim_node/simulate_steps", **qos)
    spin_until(steps.server_is_ready, ros_harness.START_S, "the action")

    def send(count):
        told = []
        goal = SimulateSteps.Goal(steps=count)
        sent = steps.send_goal_async(goal, feedback_callback=lambda m: told.append(m.feedback))
        spin_until(sent.done, 20, "acceptance")
        assert sent.result().accepted
        return sent.result(), told

    simulator.send = send
    yield simulator
    steps.destroy()
    assert process.stop() == 0
    assert "Traceback" not in process.stderr, process.stderr


def outcome(simulator, handle, timeout_s=20):
    """Status, code and reason of a goal."""
    future = handle.get_result_async()
    simulator.spin_until(future.done, timeout_s, "a result")
    result = future.result().result.result
    return future.result().status, result.result, result.error_message


def test_every_step_is_told(served):
    assert served.set(time_scale=50).successful
    handle, told = served.send(20)
    assert outcome(served, handle) == (DONE, Result.RESULT_OK, "")
    assert [(f.completed_steps, f.remaining_steps) for f in told] == [
        (i, 20 - i) for i in range(1, 21)
    ]
    assert served.settled().step == served.first_step + 20
    state = served.do(GetSimulationState).state.state
    assert state == SimulationState.STATE_PAUSED


def test_a_canceled_goal_stops_and_says_how_far_it_came(served):
    assert served.set(time_scale=10).successful
    handle, told = served.send(10_000)
    served.spin_until(lambda: len(told) > 3, 20, "some steps")
    canceled = handle.cancel_goal_async()
    served.spin_until(canceled.done, 10, "an answer")
    status, code, why = outcome(served, handle)
    stood = served.settled().step - served.first_step
    assert (status, code) == (CANCELED, FAILED)
    assert why == f"{stood} of 10000 steps were taken: the goal was canceled"
    assert told[-1].completed_steps == stood < 1000
    served.do(StepSimulation, steps=2)
    assert served.settled().step == served.first_step + stood + 2


def test_goals_that_are_refused_say_why(served):
    for steps in (0, 10_001, 2**64 - 1):
        why = f"steps is {steps}; allowed: a whole number from 1 to 10000"
        assert outcome(served, served.send(steps)[0]) == (ABORTED, FAILED, why)
    assert served.set(time_scale=1).successful
    running, _ = served.send(100)
    busy = (ABORTED, Result.RESULT_INCORRECT_STATE, "another request is stepping")
    assert outcome(served, served.send(1)[0]) == busy
    assert served.refused(StepSimulation, steps=1) == busy[1:]
    served.do(ResetSimulation)
    status, code, why = outcome(served, running)
    assert (status, code) == (ABORTED, FAILED) and why.endswith("taken: the motion began anew")
    served.play()
    why = "it is playing; stepping needs paused"
    assert outcome(served, served.send(1)[0]) == (ABORTED, FAILED, why)
    assert served.refused(StepSimulation, steps=1) == (FAILED, why)


@pytest.mark.parametrize(("time_scale", "period_s"), [(1, 0.1), (0, 1000.0)])
def test_a_simulator_that_is_told_to_stop_while_it_steps_stops_in_silence(
    served, time_scale, period_s
):
    """The fixture looks at its exit status and at what it prints."""
    assert served.set(time_scale=time_scale, publish_period_s=period_s).successful
    served.do(ResetSimulation)
    _, told = served.send(10_000)
    served.spin_until(lambda: told, 20, "a step")
    # It ends when the test does, with most of the steps to come.
    assert told[-1].remaining_steps > 0


def test_a_storm_of_goals_and_cancellations_is_answered(served):
    assert served.set(time_scale=100).successful
    handles = [served.send(50)[0] for _ in range(30)]
    canceled = [handle.cancel_goal_async() for handle in handles for _ in range(2)]
    results = [handle.get_result_async() for handle in handles]
    served.spin_until(lambda: all(f.done() for f in canceled + results), 30, "every answer")
    statuses = [future.result().status for future in results]
    assert set(statuses) <= {DONE, CANCELED, ABORTED}
    assert all(f.result().result.result.error_message or f.result().status == DONE for f in results)
    served.do(StepSimulation, steps=1)
