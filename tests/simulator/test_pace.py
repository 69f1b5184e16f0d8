"""Simulated time never runs ahead of `time_scale`, whatever a simulator is asked for."""

import random
import time

import pytest
import ros_harness
from diagnostic_msgs.msg import DiagnosticArray
from ros_harness import time_ns
from simulation_interfaces.msg import SimulationState
from simulation_interfaces.srv import ResetSimulation, SetSimulationState, StepSimulation
from tss_interfaces.msg import BeadStates, SimulationStatus
from tss_interfaces.srv import Disturb

from tss_ros.ros import diagnostics

PERIOD_S = 0.1
#: Steps before the first request.
QUIET = 20
#: What is asked for, at random; a reset begins a period anew, so there are not too many of them.
REQUESTS = (
    (Disturb, {"random_offset_m": 1.0}),
    (SetSimulationState, {"state": SimulationState(state=SimulationState.STATE_PAUSED)}),
    (SetSimulationState, {"state": SimulationState(state=SimulationState.STATE_PLAYING)}),
    (StepSimulation, {"steps": 1}),
    (StepSimulation, {"steps": 3}),
    (ResetSimulation, {}),
)
WEIGHTS = (6, 3, 6, 2, 2, 1)


def ask_at_random(simulator, seed, duration_s):
    """Ask for something 20 times a second; return the futures of the answers."""
    chance, end, answers = random.Random(seed), time.monotonic() + duration_s, []
    while time.monotonic() < end:
        ((kind, fields),) = chance.choices(REQUESTS, WEIGHTS)
        answers.append(simulator.begin(kind, **fields))
        until = time.monotonic() + chance.expovariate(20.0)
        simulator.spin_until(lambda until=until: time.monotonic() > until, 10, "a moment")
    return answers


def simulated_and_ahead_s(published, first_steps, scale):
    """Simulated time [s] of steps, given as (wall time, message), and how far [s] ahead at most.

    What begins a run jumps to a time of its own, which is none that has been simulated. The first
    steps go out undisturbed, and those of them that were not late tell when it began.
    """
    begun = min(wall_s - i * PERIOD_S / scale for i, (wall_s, _) in enumerate(published[:QUIET]))
    simulated_s, furthest_s, before = 0.0, 0.0, published[0][1]
    for wall_s, message in published[1:]:
        assert message.step == before.step + 1
        if message.step not in first_steps:
            advance_s = (time_ns(message.header.stamp) - time_ns(before.header.stamp)) / 1e9
            assert advance_s == pytest.approx(PERIOD_S)
            simulated_s += advance_s
        furthest_s = max(furthest_s, simulated_s - (wall_s - begun) * scale)
        before = message
    return simulated_s, furthest_s


def run(start, client, scale, duration_s, seed=16):
    """Simulated time, how far it was ahead, and what the requests became, as numbers and texts."""
    node, spin_until = client
    process = start("sim_node", time_scale=scale, publish_period_s=PERIOD_S, disturbance_m=10.0)
    simulator, published, reports = ros_harness.Simulator(node, spin_until), [], []

    def keep(message, info):
        published.append((info["source_timestamp"] / 1e9, message))

    node.create_subscription(BeadStates, "bead_states", keep, 1000)
    node.create_subscription(DiagnosticArray, "/diagnostics", reports.append, 100)
    simulator.wait_for_step(1)
    del published[:]
    spin_until(lambda: len(published) >= QUIET, 20, "the first steps")
    answers = ask_at_random(simulator, seed, duration_s)
    spin_until(lambda: all(answer.done() for answer in answers), 10, "every answer")
    simulator.settled()
    first_steps = {message.first_step for message in simulator.descriptions}
    told = {status.message for report in reports for status in report.status}
    assert process.stop() == 0, process.stderr
    results = [answer.result().result for answer in answers]
    return *simulated_and_ahead_s(published, first_steps, scale), results, told


@pytest.mark.parametrize("duration_s", [6.0, pytest.param(60.0, marks=pytest.mark.long)])
@pytest.mark.parametrize("scale", [1.0, pytest.param(10.0, marks=pytest.mark.long)])
def test_time_is_never_ahead_by_more_than_a_step(start, client, scale, duration_s):
    simulated_s, ahead_s, results, told = run(start, client, scale, duration_s)
    assert simulated_s > 0.1 * duration_s * scale
    assert ahead_s < PERIOD_S + 0.002 * scale
    done = sum(result.result == result.RESULT_OK for result in results)
    assert len(results) > 10 * duration_s and done > 5 * duration_s
    assert "faster than time_scale asks for" not in told  # slower it may be on a busy machine


def test_diagnostics_know_faster_and_slower():
    """What keeps a simulator from being too fast leaves only the judgement to be tested."""

    def told(factor, late=False, state=SimulationState.STATE_PLAYING):
        status = SimulationStatus(time_scale=10.0, real_time_factor=factor)
        status.state.state = state
        report = diagnostics.of_simulator("/sim_node", status, late, 1.0, [], {})
        return report.status[0].message

    assert told(10.0) == told(11.9) == "playing" and told(8.9, late=False) == "playing"
    assert told(12.1) == "faster than time_scale asks for"
    assert told(5.0, late=True) == "slower than time_scale asks for"
    assert told(0.0, state=SimulationState.STATE_PAUSED) == "paused"


def test_a_simulator_that_cannot_keep_up_says_so(start, client):
    node, spin_until = client
    process, messages = start("sim_node", beads_per_tether=30, time_scale=1e6), []

    def keep(report):
        messages.extend(s.message for s in report.status if s.name.endswith("motion"))

    node.create_subscription(DiagnosticArray, "/diagnostics", keep, 10)
    wanted = "slower than time_scale asks for"
    spin_until(lambda: wanted in messages, ros_harness.START_S, wanted)
    assert process.stop() == 0
