"""Control of a running simulator over the middleware: state, steps, resets, disturbances, time."""

from pathlib import Path

import numpy as np
import pytest
import ros_harness
from rclpy.parameter import Parameter
from ros_harness import motion, time_ns
from simulation_interfaces.msg import Result, SimulationState
from simulation_interfaces.srv import (
    GetSimulationState,
    ResetSimulation,
    SetSimulationState,
    StepSimulation,
)
from tss_interfaces.srv import Disturb, GetStates, RestoreSnapshot, SaveSnapshot

import tss_ros
from tss_ros.core import LAW_PARAMETERS, Propagator, State, ring
from tss_ros.simulator.control import Code, PlayState

TIME, STATE = ResetSimulation.Request.SCOPE_TIME, ResetSimulation.Request.SCOPE_STATE
PERIOD_S = 2.0
RING = ring(satellite_mass_kg=100.0)


GIVEN = {"publish_period_s": PERIOD_S, "disturbance_m": 10, "disturbance_seed": 3}
CHANGED = ("spin_rate_ratio", "satellites", "satellite_mass_kg", "axial_stiffness_n")
CHANGED += ("tether_law", "stiffening", "j2")


@pytest.fixture(scope="module")
def served(tmp_path_factory):
    """One simulator for many tests."""
    directory = tmp_path_factory.mktemp("simulator")
    with ros_harness.processes(directory) as start, ros_harness.client_node() as (node, spin_until):
        process = start("sim_node", start_paused=True, **GIVEN)
        simulator = ros_harness.Simulator(node, spin_until)
        simulator.start, simulator.directory = start, directory
        yield simulator
        assert process.stop() == 0
        assert "rror" not in process.stderr, process.stderr


@pytest.fixture
def paused(served):
    """A simulator that stands at the beginning of a run."""
    assert served.set(time_scale=0, **GIVEN, **dict.fromkeys(CHANGED)).successful
    if state_of(served) != SimulationState.STATE_PAUSED:
        served.pause()
    served.join()
    return served


@pytest.fixture
def started(tmp_path):
    """A function that starts a simulator of its own and returns its process and a Simulator."""
    with ros_harness.processes(tmp_path) as start, ros_harness.client_node() as (node, spin_until):

        def begin(**parameters):
            namespace = ("-r", "__ns:=/own")  # the other one may be running
            process = start("sim_node", *namespace, **{**GIVEN, **parameters})
            simulator = ros_harness.Simulator(node, spin_until, "/own")
            simulator.start = lambda executable, **given: start(executable, *namespace, **given)
            spin_until(lambda: simulator.status, ros_harness.START_S, "the simulator")
            return process, simulator

        yield begin


def state_of(simulator):
    return simulator.do(GetSimulationState).state.state


def test_codes_and_states_are_those_of_the_messages():
    for code in Code:
        owner = Result if code < 100 else SetSimulationState.Response
        assert getattr(owner, f"RESULT_{code.name}" if code < 100 else code.name) == code
    for state in PlayState:
        assert getattr(SimulationState, f"STATE_{state.name}") == state


def test_it_plays_pauses_steps_and_plays_on(paused):
    assert state_of(paused) == SimulationState.STATE_PAUSED
    first = paused.first_step
    paused.do(StepSimulation, steps=7)
    assert paused.settled().step == first + 7
    assert state_of(paused) == SimulationState.STATE_PAUSED
    assert paused.set(time_scale=100).successful
    paused.play()
    paused.wait_for_step(first + 20)
    assert paused.refused(StepSimulation, steps=1)[0] == Result.RESULT_OPERATION_FAILED
    already = SimulationState(state=SimulationState.STATE_PLAYING)
    answer = paused.ask(SetSimulationState, state=already)
    assert answer.result.result == SetSimulationState.Response.ALREADY_IN_TARGET_STATE
    paused.pause()
    stands = paused.settled().step
    assert paused.set(time_scale=0).successful
    paused.do(StepSimulation, steps=100)
    assert paused.settled().step == stands + 100
    # Nothing that was done shows in the motion.
    assert [message.step for message in paused.beads] == list(range(first, stands + 101))
    stamps = [time_ns(message.header.stamp) for message in paused.beads]
    assert stamps == [round(i * PERIOD_S * 1e9) for i in range(stands + 101 - first)]
    assert not paused.events and len(paused.descriptions) == 1


def test_steps_that_are_interrupted_say_so(paused):
    assert paused.set(publish_period_s=1e5).successful  # each step takes its time
    paused.do(ResetSimulation)
    answer = paused.begin(StepSimulation, steps=10_000)
    paused.wait_for_step(paused.first_step + 5)
    code, why = paused.refused(StepSimulation, steps=1)
    assert (code, why) == (Result.RESULT_INCORRECT_STATE, "another request is stepping")
    paused.do(ResetSimulation)
    paused.spin_until(answer.done, 10, "the answer")
    result = answer.result().result
    assert result.result == Result.RESULT_OPERATION_FAILED
    assert "of 10000 steps were taken: the motion began anew" in result.error_message


@pytest.mark.parametrize(
    ("state", "code"),
    [
        (SimulationState.STATE_NO_WORLD, Result.RESULT_FEATURE_UNSUPPORTED),
        (SimulationState.STATE_LOADING_WORLD, Result.RESULT_FEATURE_UNSUPPORTED),
        (6, Result.RESULT_OPERATION_FAILED),
        (255, Result.RESULT_OPERATION_FAILED),
    ],
)
def test_states_that_there_are_not(paused, state, code):
    refused = paused.refused(SetSimulationState, state=SimulationState(state=state))
    assert refused == (code, f"state is {state}; allowed: 0 to 3")


@pytest.mark.parametrize("steps", [0, 10_001, 2**64 - 1])
def test_numbers_of_steps_that_are_not_allowed(paused, steps):
    code, why = paused.refused(StepSimulation, steps=steps)
    assert code == Result.RESULT_OPERATION_FAILED
    assert why == f"steps is {steps}; allowed: a whole number from 1 to 10000"


def test_reset_repeats_the_run_bit_for_bit(paused):
    paused.do(StepSimulation, steps=30)
    paused.do(ResetSimulation)
    paused.do(StepSimulation, steps=30)
    paused.settled()
    first, second = paused.beads[:31], paused.beads[31:62]
    assert [m.step - paused.first_step for m in second] == list(range(31, 62))
    for before, after in zip(first, second, strict=True):
        assert motion(before) == motion(after)
        assert before.header.stamp == after.header.stamp
    described = paused.descriptions[-1]
    assert (described.run, described.first_step) == (paused.run + 1, second[0].step)
    (event,) = paused.events
    assert (event.kind, event.text) == ("reset", "time and state")
    assert (event.step, event.run) == (described.first_step, described.run)


def test_reset_of_time_leaves_the_motion_alone(paused):
    paused.do(StepSimulation, steps=5)
    before = paused.settled()
    paused.do(ResetSimulation, scope=TIME)
    after = paused.settled()
    assert motion(before) == motion(after)
    assert time_ns(after.header.stamp) == 0 and time_ns(paused.descriptions[-1].header.stamp) == 0
    paused.do(StepSimulation, steps=5)
    # A simulator that was left alone has the same states, five steps further on in time.
    assert time_ns(paused.settled().header.stamp) == round(5 * PERIOD_S * 1e9)
    paused.do(ResetSimulation)
    paused.do(StepSimulation, steps=10)
    paused.settled()
    assert [motion(m) for m in paused.beads[6:12]] == [motion(m) for m in paused.beads[-6:]]


def test_reset_of_the_state_leaves_time_alone_and_applies_parameters(paused):
    paused.do(StepSimulation, steps=5)
    assert paused.set(spin_rate_ratio=-3, satellites=4, publish_period_s=1).successful
    paused.do(StepSimulation, steps=1)
    assert len(paused.settled().name) == 3
    paused.do(ResetSimulation, scope=STATE)
    after = paused.settled()
    assert len(after.name) == 4 and time_ns(after.header.stamp) == round(6 * PERIOD_S * 1e9)
    assert paused.descriptions[-1].spin_rate_ratio == -3.0
    paused.do(StepSimulation, steps=1)
    assert time_ns(paused.settled().header.stamp) == round((6 * PERIOD_S + 1) * 1e9)


def test_reset_that_is_not_possible_changes_nothing(paused):
    paused.do(StepSimulation, steps=5)
    code, why = paused.refused(ResetSimulation, scope=ResetSimulation.Request.SCOPE_SPAWNED)
    assert code == Result.RESULT_FEATURE_UNSUPPORTED and why.startswith("scope is 4; allowed")
    assert paused.refused(ResetSimulation, scope=16)[0] == Result.RESULT_FEATURE_UNSUPPORTED
    # No ring balances at this rate: gravity pulls it apart.
    assert paused.set(satellite_mass_kg=1e9, axial_stiffness_n=1e-3, spin_rate_ratio=1e4).successful
    code, why = paused.refused(ResetSimulation)
    assert code == Result.RESULT_OPERATION_FAILED and "no steady configuration" in why
    paused.do(StepSimulation, steps=1)
    assert paused.settled().step == paused.first_step + 6


def test_stopping_resets_and_stands(paused):
    paused.do(StepSimulation, steps=5)
    paused.set_state(SimulationState.STATE_STOPPED)
    assert motion(paused.settled()) == motion(paused.beads[0])
    assert state_of(paused) == SimulationState.STATE_STOPPED
    assert paused.refused(StepSimulation, steps=1)[0] == Result.RESULT_OPERATION_FAILED
    assert paused.set(time_scale=100).successful
    paused.play()
    paused.wait_for_step(paused.beads[-1].step + 5)
    paused.pause()


def test_quitting_ends_the_node(started):
    process, simulator = started(start_paused=True)
    simulator.set_state(SimulationState.STATE_QUITTING)
    assert process.wait(ros_harness.STOP_S) == 0


def propagated(message, times_s, offset_m=0.0, impulse_m_s=0.0):
    """Where the core takes the state of a message, changed."""
    position_m, velocity_m_s = (
        np.reshape(values, (-1, 3)) for values in (message.position_m, message.velocity_m_s)
    )
    state = State(position_m + offset_m, velocity_m_s + impulse_m_s)
    return Propagator(RING, -2.5, state).sample(np.asarray(times_s))


def test_a_pushed_bead_moves_as_it_must(paused):
    paused.do(StepSimulation, steps=4)
    before = paused.settled()
    request = Disturb.Request(bead="satellite_2")
    request.offset_m.y, request.impulse_n_s.z = 25.0, 300.0
    paused.do(
        Disturb, bead="satellite_2", offset_m=request.offset_m, impulse_n_s=request.impulse_n_s
    )
    after = paused.do(GetStates).beads
    # It is no step: the next one shows it.
    assert paused.settled() == before
    assert (after.step, after.header.stamp) == (before.step, before.header.stamp)
    change = [
        np.reshape(np.subtract(a, b), (-1, 3))
        for a, b in (
            (after.position_m, before.position_m),
            (after.velocity_m_s, before.velocity_m_s),
        )
    ]
    np.testing.assert_allclose(change[0], [[0, 0, 0], [0, 25, 0], [0, 0, 0]], atol=1e-9)
    np.testing.assert_allclose(change[1], [[0, 0, 0], [0, 0, 3], [0, 0, 0]], atol=1e-12)
    paused.do(StepSimulation, steps=50)
    end = paused.settled()
    assert end.step == before.step + 50
    stamps = [time_ns(message.header.stamp) for message in paused.beads]
    assert stamps == [round(i * PERIOD_S * 1e9) for i in range(55)]
    unit = np.array([[0.0], [1.0], [0.0]])
    position_m, _ = propagated(
        before, [50 * PERIOD_S], unit * [0.0, 25.0, 0.0], unit * [0.0, 0.0, 3.0]
    )
    np.testing.assert_allclose(np.reshape(end.position_m, (-1, 3)), position_m[0], atol=1e-4)
    (event,) = paused.events
    assert (event.kind, event.step, event.run) == ("disturb", before.step + 1, paused.run)
    assert event.text == "satellite_2: offset [0.0, 25.0, 0.0] m, impulse [0.0, 0.0, 300.0] N s"


def test_random_disturbance_is_that_of_the_parameter(paused):
    assert paused.set(disturbance_m=0).successful
    paused.do(ResetSimulation)
    undisturbed = paused.settled()
    paused.do(Disturb, random_offset_m=12.0, seed=5)
    disturbed = paused.do(GetStates).beads
    offset_m = np.subtract(disturbed.position_m, undisturbed.position_m)
    assert np.linalg.norm(offset_m) == pytest.approx(12.0, rel=1e-9)
    assert paused.set(disturbance_m=12, disturbance_seed=5).successful
    paused.do(ResetSimulation)
    np.testing.assert_allclose(paused.settled().position_m, disturbed.position_m, rtol=0, atol=1e-9)


@pytest.mark.parametrize(
    ("fields", "code", "expected"),
    [
        ({"bead": "satellite_9"}, Result.RESULT_NOT_FOUND, "bead 'satellite_9' does not exist"),
        ({"bead": "satellite_1"}, 4, "offset_m and impulse_n_s are zero"),
        ({"bead": "satellite_1", "random_offset_m": 1.0}, 4, "random_offset_m is 1; allowed: 0"),
        ({}, 4, "random_offset_m is 0; allowed: a number above 0 to 100000"),
        ({"random_offset_m": float("nan")}, 4, "random_offset_m is nan; allowed"),
        ({"random_offset_m": 1.0, "seed": -1}, 4, "seed is -1; allowed: a whole number from 0"),
    ],
)
def test_disturbances_that_are_not_allowed(paused, fields, code, expected):
    got, why = paused.refused(Disturb, **fields)
    assert got == code and why.startswith(expected), why


# --- snapshots


def test_a_restored_run_continues_bit_for_bit(paused):
    """Also after a slack spell, in the middle of a run, and in another process."""
    assert paused.set(spin_rate_ratio=-1.6).successful
    paused.do(ResetSimulation)
    paused.do(StepSimulation, steps=777)
    paused.do(SaveSnapshot, file="exact.npz")
    saved = paused.settled()
    paused.do(StepSimulation, steps=400)
    paused.settled()
    original = [m for m in paused.beads if m.step >= saved.step]
    paused.do(RestoreSnapshot, file="exact.npz")
    paused.do(StepSimulation, steps=400)
    paused.settled()
    restored = paused.beads[-401:]
    assert [motion(m) for m in restored] == [motion(m) for m in original]
    assert [m.header.stamp for m in restored] == [m.header.stamp for m in original]
    assert restored[0].step == original[-1].step + 1
    assert (
        paused.events[-1].text == "snapshot exact.npz"
        and paused.descriptions[-1].run == paused.run + 2
    )

    other = paused.start(
        "sim_node",
        "-r",
        "__ns:=/other",
        publish_clock=False,
        publish_period_s=PERIOD_S,
        spin_rate_ratio=-1.6,
        start_paused=True,
    )
    simulator = ros_harness.Simulator(paused.node, paused.spin_until, "/other")
    simulator.join()
    simulator.do(RestoreSnapshot, file="exact.npz")
    simulator.do(StepSimulation, steps=400)
    simulator.settled()
    assert [motion(m) for m in simulator.beads[-401:]] == [motion(m) for m in original]
    assert other.stop() == 0


def test_services_reach_only_the_folder_of_their_own(paused):
    """Neither a path outside nor a link that leads there is written, read or told of."""
    folder, secret = paused.directory / "service_files", paused.directory / "secret.yaml"
    paused.do(SaveSnapshot, file="mine.npz")
    secret.write_text("password: hunter2")
    (folder / "link").symlink_to(paused.directory)
    (folder / "dangling.npz").symlink_to(paused.directory / "new.npz")
    outside = ("../new.npz", str(paused.directory / "new.npz"), "link/new.npz", "dangling.npz")
    for file in outside:
        for kind in (SaveSnapshot, RestoreSnapshot):
            code, why = paused.refused(kind, file=file)
            assert code == Result.RESULT_OPERATION_FAILED
            assert f"allowed: files in '{folder}', the node's service_folder" in why
    assert "File name too long" in paused.refused(SaveSnapshot, file="a" * 5000 + ".npz")[1]
    assert not (paused.directory / "new.npz").exists()
    for scenario in (str(secret), "secret.yaml", "service_files/link/secret.yaml"):
        answer = paused.set(scenario=scenario)
        assert not answer.successful and "the node's service_folder" in answer.reason
        assert "hunter2" not in answer.reason
    shipped = Path(tss_ros.__file__).parent / "scenarios" / "four_star.yaml"
    (folder / "own.yaml").write_text(shipped.read_text())
    assert paused.set(scenario="service_files/own.yaml").successful
    assert paused.set(scenario="six_star").successful


def test_the_folder_is_the_users_choice(start, tmp_path):
    process = start(
        "sim_node", "-r", "__ns:=/free", start_paused=True, publish_clock=False, service_folder="/"
    )
    with ros_harness.client_node() as client:
        simulator = ros_harness.Simulator(*client, "/free")
        simulator.do(SaveSnapshot, file=str(tmp_path / "anywhere.npz"))
        simulator.do(RestoreSnapshot, file=str(tmp_path / "anywhere.npz"))
    assert process.stop() == 0


def test_a_snapshot_of_another_law_is_refused(paused):
    paused.do(SaveSnapshot, file="of_law.npz")
    for values, name in (({"tether_law": "tension_only"}, "tether_law"), ({"j2": 1e-3}, "j2")):
        assert paused.set(**values).successful
        paused.do(ResetSimulation)
        code, why = paused.refused(RestoreSnapshot, file="of_law.npz")
        assert code == Result.RESULT_OPERATION_FAILED and f"with another {name};" in why
        assert paused.set(**dict.fromkeys(values)).successful
    paused.do(ResetSimulation)
    paused.do(RestoreSnapshot, file="of_law.npz")


def test_a_law_is_chosen_while_the_simulator_runs(paused):
    answer = paused.set(tether_law="tension_onyl")
    assert not answer.successful and "did you mean 'tension_only'?" in answer.reason
    answer = paused.set(stiffening=2.0)
    assert not answer.successful and "only tether_law stiffening uses" in answer.reason
    assert paused.set(tether_law="stiffening", stiffening=2.0, j2=1e-3).successful
    paused.do(ResetSimulation)
    paused.spin_until(lambda: paused.descriptions[-1].run > paused.run, 5, "the new run")
    described = paused.descriptions[-1]
    assert described.tether_law == "stiffening"
    laws = dict(zip(described.law_parameter_name, described.law_parameter))
    assert laws == {p.name: p.default for p in LAW_PARAMETERS} | {"stiffening": 2.0, "j2": 1e-3}


def test_snapshots_that_do_not_fit_are_refused(paused):
    paused.do(StepSimulation, steps=3)
    paused.do(SaveSnapshot, file="a.npz")
    assert "exists already" in paused.refused(SaveSnapshot, file="a.npz")[1]
    assert "allowed: a path that ends in .npz" in paused.refused(SaveSnapshot, file="a.txt")[1]
    assert "No such file" in paused.refused(SaveSnapshot, file="no/where.npz")[1]
    assert paused.refused(RestoreSnapshot, file="b.npz")[0] == Result.RESULT_NOT_FOUND
    whole = (paused.directory / "service_files" / "a.npz").read_bytes()
    for name, content in (("cut", whole[: len(whole) // 2]), ("empty", b""), ("text", b"hello")):
        (paused.directory / "service_files" / f"{name}.npz").write_bytes(content)
        assert "cannot be read" in paused.refused(RestoreSnapshot, file=f"{name}.npz")[1]
    arrays = dict(np.load(paused.directory / "service_files" / "a.npz"))
    for name, value, expected in (
        ("integrator_position_m", np.full((3, 3), np.nan), "damaged"),
        ("integrator_velocity_m_s", arrays["integrator_velocity_m_s"][:1], "damaged"),
        ("place_index", np.array(10**6), "damaged"),
        ("place_base_ns", np.array(2**62), "allowed: 0 to 2^31"),
        ("setup_mass_kg", 2 * arrays["setup_mass_kg"], "another mass_kg"),
    ):
        np.savez(paused.directory / "service_files" / f"bad_{name}.npz", **{**arrays, name: value})
        assert expected in paused.refused(RestoreSnapshot, file=f"bad_{name}.npz")[1]
    assert paused.set(publish_period_s=7).successful
    paused.do(ResetSimulation)
    assert "another publish_period_s" in paused.refused(RestoreSnapshot, file="a.npz")[1]


# --- time


def test_followers_of_the_clock_follow_through_pause_step_and_reset(paused):
    """Also one that comes while time stands still."""
    paused.do(StepSimulation, steps=4)
    with ros_harness.client_node() as (late, spin_until):
        late.set_parameters([Parameter("use_sim_time", value=True)])

        def wait_for(condition):
            spin_until(lambda: condition(late.get_clock().now().nanoseconds), 20, "its time")

        wait_for(lambda now: now == round(4 * PERIOD_S * 1e9))
        paused.do(StepSimulation, steps=3)
        wait_for(lambda now: now == round(7 * PERIOD_S * 1e9))
        paused.do(ResetSimulation)
        wait_for(lambda now: now == 0)
        assert paused.set(time_scale=100).successful
        paused.play()
        wait_for(lambda now: now > round(3 * PERIOD_S * 1e9))
        paused.pause()
        stands = time_ns(paused.settled().header.stamp)
        wait_for(lambda now: now == stands)


def test_time_scale_changes_at_once_and_is_reached(paused):
    def reach(factor):
        """As soon as this machine can keep up for a while."""
        paused.spin_until(
            lambda: paused.status[-1].real_time_factor == pytest.approx(factor, rel=0.15),
            ros_harness.START_S, f"a factor of {factor}",
        )  # fmt: skip

    assert paused.set(time_scale=20).successful
    paused.play()
    reach(20)
    assert paused.set(time_scale=80.0).successful
    reach(80)
    assert paused.status[-1].time_scale == 80.0
    assert paused.status[-1].step_cost_s > 0.0
    paused.pause()
    reach(0.0)
