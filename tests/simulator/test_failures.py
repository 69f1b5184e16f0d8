"""Failures: cut tethers, dead and stuck thrusters, at times and on events, in all simulators."""

import threading

import numpy as np
import pytest
import ros_harness
import yaml
from builtin_interfaces.msg import Time
from pilot import Pilot
from ros_harness import motion, time_ns
from simulation_interfaces.msg import Result
from simulation_interfaces.srv import ResetSimulation, StepSimulation
from tss_interfaces.srv import CutTether, FailActuator, RestoreSnapshot, SaveSnapshot

from tss_ros.bags.recording import read_bag
from tss_ros.bags.verify import verify
from tss_ros.bags.wrenches import read_commands
from tss_ros.core import (
    Commands,
    Failure,
    Propagator,
    TssError,
    reel_plan,
    reel_profile,
    ring,
    simulate,
)
from tss_ros.core.model.failures import DEAD, HEALTHY, STUCK, Happened, reel_at, with_failures
from tss_ros.scenarios import scenario
from tss_ros.simulator import straight
from tss_ros.simulator.commands import Command, CommandTable
from tss_ros.simulator.reel_commands import RATE, Limits, ReelCommand, ReelStart
from tss_ros.simulator.simulation import Simulation
from tss_ros.simulator.straight import setup_of
from tss_ros.simulator.trajectory import edge_s
from tss_ros.sweeps.ensemble import ensemble

PERIOD_S, S = 2.0, 10**9
GIVEN = {"publish_period_s": PERIOD_S, "disturbance_m": 5.0, "disturbance_seed": 3}
RUN = {**GIVEN, "turns": 0.0}
PLAIN = setup_of("three_star", {"spin_rate_ratio": -2.9}, RUN)
SYSTEM = PLAIN.system
FORCE, OTHER = (0.4, -0.3, 0.2), (0.0, 0.5, 0.0)


def push(time_s, force_n=FORCE, bead=0, frame=0):
    return Command(round(time_s * S), bead, frame, force_n)


def acting(*forces, cut=()):
    """Commands of (bead, force) in the orbit frame."""
    return Commands.of(SYSTEM, [(SYSTEM.bead_name[b], "orbit", f) for b, f in forces], cut)


def scenario_file(folder, failures, **others):
    path = folder / "failing.yaml"
    content = {"formation": "ring", "satellites": 3, "spin_rate_ratio": -2.9, **others}
    path.write_text(yaml.safe_dump({**content, "failures": failures}))
    return str(path)


def setup(folder, failures, **others):
    return setup_of(scenario_file(folder, failures), {}, {**RUN, **others})


def run(setup, count, commands=()):
    """States, tensions and changes of a simulation to which commands are posted before a step."""
    live, states, commands = Simulation(setup, 0.0, threading.Event().set), [], dict(commands)
    for k in range(count):
        for command in commands.get(k, ()):
            if isinstance(command, (Command, ReelCommand)):
                assert live.commands.post(command)
            else:
                live.fail(command)
        states.append(live.take())
    changes = live.take_changes()
    live.close()
    return (
        np.array([[s.position_m, s.velocity_m_s] for s in states]),
        np.array([s.states.tension_n[s.row] for s in states]),
        changes,
    )


def made_again(changes, count, start=PLAIN.start):
    propagator = Propagator(SYSTEM, PLAIN.spin_rate_ratio, start)
    propagator.command([(edge_s(PLAIN, c.time), c.commands) for c in changes])
    return np.stack(propagator.sample(PERIOD_S * np.arange(count)), axis=1)


# -- what acts -------------------------------------------------------------------------------------


def test_a_dead_thruster_gives_nothing_and_a_stuck_one_what_it_gave():
    edges = [
        (0, acting((0, FORCE), (1, FORCE))),
        (20, acting((0, OTHER), (1, OTHER))),
        (40, acting()),
    ]
    happened = [Happened(10, 0, DEAD), Happened(15, 1, STUCK), Happened(30, 0, HEALTHY)]
    assert list(with_failures(SYSTEM, edges, happened)) == [
        (0, acting((0, FORCE), (1, FORCE)), ()),
        (10, acting((1, FORCE)), (("satellite_1", DEAD),)),
        (15, acting((1, FORCE)), (("satellite_1", DEAD), ("satellite_2", STUCK))),
        (20, acting((1, FORCE)), (("satellite_1", DEAD), ("satellite_2", STUCK))),
        (30, acting((0, OTHER), (1, FORCE)), (("satellite_2", STUCK),)),
        (40, acting((1, FORCE)), (("satellite_2", STUCK),)),
    ]  # fmt: skip


def test_what_sticks_is_what_the_thruster_gives_then():
    """The force of that time's command; nothing of a dead one; what a stuck one gives already."""
    edges = [(10, acting((0, FORCE))), (30, acting((0, OTHER)))]
    for happened, expected in (
        ([Happened(10, 0, STUCK)], acting((0, FORCE))),
        ([Happened(5, 0, STUCK)], acting()),
        ([Happened(20, 0, DEAD), Happened(25, 0, STUCK)], acting()),
        ([Happened(20, 0, STUCK), Happened(35, 0, STUCK)], acting((0, FORCE))),
        ([Happened(20, 0, STUCK), Happened(35, 0, DEAD)], acting()),
        ([Happened(20, 0, STUCK), Happened(35, 0, HEALTHY)], acting((0, OTHER))),
    ):
        assert list(with_failures(SYSTEM, edges, happened))[-1].commands == expected


def test_a_stuck_thruster_bears_new_commands_timeouts_and_their_changes():
    live = Simulation(PLAIN, 0.0, threading.Event().set)
    live.set_timeout(9.0)
    live.commands.post(push(4.0))
    live.commands.post(push(4.0, bead=1))
    live.fail(Happened(8 * S, 0, STUCK))
    for _ in range(5):
        live.take()
    live.commands.post(push(0.0, OTHER))
    for _ in range(3):
        live.take()
    live.set_timeout(2.0)  # by which the force would have ended before it stuck
    for _ in range(3):
        live.take()
    live.fail(Happened(0, 0, DEAD))
    live.take()
    assert live.acting == acting()
    live.fail(Happened(0, 0, HEALTHY))
    live.commands.post(push(0.0, OTHER))
    live.take()
    changes = live.take_changes()
    live.close()
    assert [(c.time / S, c.commands, c.failed) for c in changes] == [
        (4.0, acting((0, FORCE), (1, FORCE)), ()),
        (8.0, acting((0, FORCE), (1, FORCE)), (("satellite_1", STUCK),)),
        (13.0, acting((0, FORCE)), (("satellite_1", STUCK),)),
        (20.0, acting(), (("satellite_1", DEAD),)),
        (22.0, acting((0, OTHER)), ()),
    ]  # fmt: skip


def test_states_are_those_of_an_integration_that_knew_all_before():
    commands = {
        0: [push(0.0), push(30.0, OTHER, 1)],
        9: [Happened(0, 0, STUCK), push(0.0, OTHER)],
        25: [Happened(77 * S, 1, DEAD)],
        60: [Happened(0, 0, HEALTHY)],
    }
    states, _, changes = run(PLAIN, 150, commands)
    assert [c.time / S for c in changes] == [0.0, 16.0, 30.0, 77.0, 118.0]
    np.testing.assert_array_equal(states, made_again(changes, 150))


WIND = ReelCommand(10 * S, 0, RATE, ((0.0, 0.0, -0.5),))


def lengths(commands, count=60):
    """What is out of the first tether, from state to state, and what is told."""
    states, _, changes = run(PLAIN, count, {0: [WIND], **commands})
    np.testing.assert_array_equal(states, made_again(changes, count))
    rows = [(c.time, c.commands.reel[0]) for c in changes]
    at = [[reel_at(row, k * 2 * S, S) for t, row in rows if t <= k * 2 * S] for k in range(count)]
    return [round(float(found[-1][0]), 6) if found else 10_000.0 for found in at], changes


@pytest.mark.parametrize("commands, expected", [
    ({9: [Happened(20 * S, 3, DEAD)]}, {10: 9995.0, 59: 9995.0}),
    ({9: [Happened(20 * S, 3, STUCK)], 12: [WIND._replace(points=((0.0, 0.0, 2.0),))]},
     {12: 9993.0, 59: 9946.0}),
    ({9: [Happened(20 * S, 3, DEAD)], 15: [Happened(30 * S, 3, STUCK)]}, {59: 9995.0}),
    ({9: [Happened(20 * S, 3, STUCK)], 25: [Happened(0, 3, DEAD)]}, {24: 9981.0, 59: 9981.0}),
    # A repaired one stands until it is commanded again, whenever that was asked for.
    ({2: [Happened(40 * S, 3, HEALTHY), Happened(20 * S, 3, DEAD)]}, {20: 9995.0, 59: 9995.0}),
    ({9: [Happened(20 * S, 3, STUCK)], 21: [Happened(40 * S, 3, HEALTHY)],
      30: [WIND._replace(points=((0.0, 0.0, 1.0),))]}, {21: 9985.0, 29: 9985.0, 59: 10045.0}),
    ({9: [Happened(20 * S, 3, HEALTHY)]}, {59: 9946.0}),
])  # fmt: skip
def test_a_dead_reel_stands_and_a_stuck_one_goes_on(commands, expected):
    found, changes = lengths(commands)
    assert {k: found[k] for k in expected} == expected
    assert found[:5] == [10_000.0] * 5
    for change in changes:
        assert all(name == "tether_1" for name, _ in change.failed)


def test_a_stuck_reel_winds_in_no_more_than_it_can():
    start = ReelStart((40.0, 40.0, 40.0))
    table = CommandTable(SYSTEM, start)
    table.post(ReelCommand(0, 0, RATE, ((0.0, 0.0, -0.5),), Limits(shortest_m=20.0)))
    table.collect(0)
    table.fail(Happened(10 * S, 3, STUCK), 0)
    edges = table.edges(0)
    assert [t / S for t, _ in edges] == [0.0, 10.0, 40.0, 79.6]
    assert [float(reel_at(c.reel[0], t, S)[0]) for t, c in edges] == [40.0, 35.0, 20.0, 0.2]
    assert edges[-1][1].reel[0].tolist() == [0.0, 0.2, 0.0, 0.0, 0.0]
    kept = table.arrays
    again = CommandTable(SYSTEM, start)
    again.arrays = kept
    assert again.edges(0) == edges


def test_the_end_of_what_was_stuck_first_is_none_of_what_is_stuck_later():
    def paying(since_s, length_m, rate_m_s):
        row = [since_s, length_m, rate_m_s, 0.0, 0.0]
        return Commands.of(SYSTEM, [], [], {"tether_1": row})

    edges = [(0.0, paying(0.0, 1e4, -0.5)), (20.0, paying(0.0, 9990.0, 0.0))]
    happened = [Happened(10.0, 3, STUCK), Happened(25.0, 3, HEALTHY), Happened(30.0, 3, STUCK)]
    newest = list(with_failures(SYSTEM, edges, happened))[-1]
    assert newest.time == 10.0 + (9995.0 - 0.2) / 0.5  # where the first one would have ended
    assert newest.commands == edges[-1][1] and newest.failed == (("tether_1", STUCK),)


def test_failures_of_reels_survive_a_snapshot(tmp_path):
    live = Simulation(PLAIN, 0.0, threading.Event().set)
    live.commands.post(WIND)
    live.fail(Happened(15 * S, 3, STUCK))
    live.fail(Happened(22 * S, 4, DEAD))
    live.fail(Happened(50 * S, 3, HEALTHY))
    for _ in range(10):
        live.take()
    live.save(str(tmp_path / "a.npz"))
    ahead = [live.take() for _ in range(30)]
    live.restore(str(tmp_path / "a.npz"))
    live.take()
    again = [live.take() for _ in range(30)]
    live.close()
    for a, b in zip(ahead, again):
        np.testing.assert_array_equal(a.position_m, b.position_m)
    assert again[-1].alone.rest_length_m[0].tolist() == [9_980.0, 10_000.0, 10_000.0]


def test_declared_failures_of_reels_in_the_core_and_straight(tmp_path, capfd):
    """The same motion of the simulator, the straight run and an integration that knew all."""
    reels = {"all": {"time_s": [0.0, 100.0], "length_m": [10_000.0, 9_900.0]}}
    failures = [
        {"at_s": 31.0, "dead": "tether_2"},
        {"when": {"tether": "tether_3", "tension_n": 2.0}, "stuck": "tether_1"},
    ]
    given = setup_of(scenario_file(tmp_path, failures, reels=reels), {}, RUN)
    states, _, changes = run(given, 80)
    assert dict(changes[-1].failed) == {"tether_1": STUCK, "tether_2": DEAD}
    np.testing.assert_array_equal(states, made_again(changes, 80, given.start))
    words = [f"--{name.replace('_', '-')}={value}" for name, value in GIVEN.items()]
    words += ["--turns", str(79.5 * PERIOD_S / given.turn_s), "--output", str(tmp_path / "bag")]
    assert straight.main([given.options["scenario"], *words]) == 0
    recorded = read_bag(tmp_path / "bag")
    np.testing.assert_array_equal(recorded.position_m, states[: len(recorded.position_m), 0])
    again = [*words[:-1], str(tmp_path / "again"), "--commands", str(tmp_path / "bag")]
    capfd.readouterr()
    assert straight.main([given.options["scenario"], *again]) == 0
    assert capfd.readouterr().err == ""
    words = [*again[:-3], str(tmp_path / "other"), *again[-2:]]
    words += ["--disturbance-m=1", "--override", "spin_rate_ratio=-2.8", "eccentricity=0.01"]
    assert straight.main(["four_star", *words]) == 0
    told = capfd.readouterr().err
    for said in ("spin_rate_ratio -2.9, and this run has -2.8", "disturbance_m 5.0, and this run",
                 "eccentricity 0.0, and this run has 0.01", "tether_name ('tether_1'"):
        assert f"was flown with {said}" in told, told
    assert recorded.rests_m[-1].tolist() == [9_842.0, 9_969.0, 9_900.0]
    assert read_commands(tmp_path / "bag", SYSTEM)[-1].failed == changes[-1].failed
    plan = reel_plan(SYSTEM, dict.fromkeys(SYSTEM.tether_name, reel_profile([0, 100], [1e4, 9900])))
    failing = [Failure("dead", "tether_2", at_s=31.0), Failure("stuck", "tether_1", at_s=60.0)]
    turns = 140.0 / given.turn_s
    found = simulate(SYSTEM, -2.9, turns=turns, period_s=20.0, plan=plan, failures=failing)
    np.testing.assert_allclose(found.rests_m[-1], [9_860.0, 9_969.0, 9_900.0], rtol=1e-12)


# -- declared in a scenario ------------------------------------------------------------------------


@pytest.mark.parametrize(("entry", "said"), [
    ({"cut": "tether_1"}, r"failures\[0\] must have either at_s or when"),
    ({"at_s": 1.0}, r"failures\[0\] must have one of cut, dead, stuck"),
    ({"at_s": 1.0, "cut": "tether_1", "dead": "satellite_1"}, "must have one of cut, dead, stuck"),
    ({"at_s": -1.0, "cut": "tether_1"}, r"failures\[0\].at_s must be at least 0, got -1"),
    ({"at_s": 1e30, "cut": "tether_1"}, r"failures\[0\]: at_s is 1e\+30; allowed: 0 to 2147483647"),
    ({"at_s": "soon", "cut": "tether_1"}, r"failures\[0\].at_s must be a number, got 'soon'"),
    ({"at_s": 1.0, "cut": "tether_9"}, r"failures\[0\]: tether is 'tether_9'; allowed: tether_1"),
    ({"at_s": 1.0, "dead": "tether_9"}, "actuator is 'tether_9'; allowed: satellite_1, .*tether_3"),
    ({"at_s": 1.0, "cutt": "tether_1"}, r"has 'cutt'; did you mean 'cut'. Allowed are"),
    ({"when": {"tether": "tether_1"}, "dead": "satellite_1"}, "either tension_n or slack"),
    ({"when": {"tether": "t", "slack": True}, "cut": "tether_1"}, "tether is 't'; allowed: teth"),
    ({"when": {"tether": "tether_1", "slack": False}, "cut": "tether_1"}, "slack is False; all"),
    ({"when": {"tether": "tether_1", "tension_n": "x"}, "cut": "tether_1"}, "must be a number"),
    ({"when": {"slack": True}, "cut": "tether_1"}, r"failures\[0\].when lacks tether"),
    ("soon", r"failures\[0\] must be a mapping, got 'soon'"),
])  # fmt: skip
def test_what_cannot_fail_so_is_refused(tmp_path, entry, said):
    with pytest.raises(TssError, match=said):
        scenario.load(scenario_file(tmp_path, [entry]))


def test_failures_must_fit_the_system_that_is_simulated(tmp_path):
    path = scenario_file(tmp_path, [{"at_s": 1.0, "cut": "tether_4"}], satellites=4)
    assert scenario.load(path).failures == (Failure("cut", "tether_4", at_s=1.0),)
    with pytest.raises(TssError, match="tether is 'tether_4'; allowed: tether_1"):
        setup_of(path, {"satellites": 3}, RUN)
    with pytest.raises(TssError, match="has failures, which ensembles do not know"):
        ensemble(path, (-2.9, -2.9, 1), [1.0], (0, 0), turns=1)
    with pytest.raises(TssError, match="failures must be a list"):
        scenario.load(scenario_file(tmp_path, {"at_s": 1.0}))


COMMANDS = {3: [push(0.0, OTHER), push(0.0, FORCE, 2)], 250: [push(0.0, OTHER, 2)]}


def failing(folder, commands=COMMANDS, **others):
    """Failures by a time and by events: of a tension that passes its first maximum, and of slack.

    Returns
    -------
    tuple of Setup and int
        The state at which the tension passes it.
    """
    _, tension_n, _ = run(setup(folder, [], **others), 250, commands)
    before, behind = tension_n[:40].max(axis=0), tension_n[40:].max(axis=0)
    k = int((behind / before).argmax())
    limit_n = float(before[k] + behind[k]) / 2
    state = int((tension_n[:, k] > limit_n).argmax())
    assert 40 <= state < 250
    entries = [
        {"when": {"tether": SYSTEM.tether_name[k], "tension_n": limit_n}, "cut": "tether_2"},
        {"when": {"tether": "tether_2", "slack": True}, "dead": "satellite_1"},
        {"at_s": 51.5, "stuck": "satellite_3"},
    ]
    return setup(folder, entries, **others), state


def test_an_event_acts_from_the_first_step_that_shows_it(tmp_path):
    """A tension cuts a tether; that it is slack then kills a thruster, one step later."""
    declared, state = failing(tmp_path, disturbance_m=0.01)
    plain = run(setup(tmp_path, [], disturbance_m=0.01), 250, COMMANDS)
    states, tension_n, changes = run(declared, 300, COMMANDS)
    forces, cut = acting((0, OTHER), (2, FORCE)), ["tether_2"]
    assert [(c.time / S, c.commands, c.failed) for c in changes] == [
        (4.0, forces, ()),
        (51.5, forces, (("satellite_3", STUCK),)),
        (state * PERIOD_S, acting((0, OTHER), (2, FORCE), cut=cut), (("satellite_3", STUCK),)),
        ((state + 1) * PERIOD_S, acting((2, FORCE), cut=cut),
         (("satellite_1", DEAD), ("satellite_3", STUCK))),
    ]  # fmt: skip
    np.testing.assert_array_equal(states[: state + 1], plain[0][: state + 1])
    np.testing.assert_array_equal(states, made_again(changes, 300, declared.start))
    assert tension_n[state, 1] > 0.0 and not tension_n[state + 1 :, 1].any()


def test_a_snapshot_keeps_failures_that_are_to_come_and_those_that_are_past(tmp_path):
    declared, state = failing(tmp_path)
    for saved in (5, state + 1, state + 20):
        live = Simulation(declared, 0.0, threading.Event().set)
        for k in range(saved):
            assert all(map(live.commands.post, COMMANDS.get(k, ())))
            live.take()
        file = str(tmp_path / f"{saved}.npz")
        live.save(file)
        expected = [live.take() for _ in range(150)]
        other = Simulation(declared, 0.0, threading.Event().set)
        other.restore(file)
        other.take()
        found = [other.take() for _ in range(150)]
        for a, b in zip(found, expected):
            np.testing.assert_array_equal(a.position_m, b.position_m)
        assert other.take_changes()[-1][1:] == live.take_changes()[-1][1:]
        live.close()
        other.close()
    other = Simulation(setup(tmp_path, []), 0.0, threading.Event().set)
    with pytest.raises(TssError, match="with another failures"):
        other.restore(file)
    other.close()


def test_straight_simulations_and_the_core_obey_failures_too(tmp_path):
    declared, state = failing(tmp_path, {})
    states, tension_n, changes = run(declared, 400)
    turns = 399.5 * PERIOD_S / declared.turn_s
    straight.simulate(declared, turns, tmp_path / "bag")
    recorded = read_bag(tmp_path / "bag")
    assert not verify(tmp_path / "bag").faults
    np.testing.assert_array_equal(recorded.position_m, states[:, 0])
    np.testing.assert_array_equal(recorded.tension_n, tension_n)
    assert read_commands(tmp_path / "bag", SYSTEM) == changes
    # A bag says all: made again from it, without looking for events, the run is the same.
    straight.simulate(declared, turns, tmp_path / "again", commands=changes)
    np.testing.assert_array_equal(read_bag(tmp_path / "again").position_m, states[:, 0])
    assert read_commands(tmp_path / "again", SYSTEM) == changes
    motion = simulate(
        SYSTEM, -2.9, turns=turns, disturbance_m=5.0, seed=3, period_s=PERIOD_S,
        failures=declared.failures,
    )  # fmt: skip
    np.testing.assert_array_equal(motion.position_m, states[:, 0])
    np.testing.assert_array_equal(motion.tension_n, tension_n)
    assert not motion.taut[state + 1 :, 1].any() and motion.taut[state, 1]
    assert changes[0].time == 0 and changes[0].failed == (("satellite_1", DEAD),)
    with pytest.raises(TssError, match="tether is 'rope'; allowed: tether_1"):
        simulate(ring(), -2.9, turns=0.1, failures=[Failure("cut", "rope", at_s=1.0)])
    with pytest.raises(TssError, match="kind is 'melt'; allowed: cut, dead, stuck"):
        Failure("melt", "tether_1", at_s=1.0)
    with pytest.raises(TssError, match="at_s is None and tether ''; allowed: one of them"):
        Failure("cut", "tether_1")


# -- over the middleware ---------------------------------------------------------------------------


@pytest.fixture
def pilot(start, client):
    process = start("sim_node", start_paused=True, time_scale=0, **GIVEN)
    simulator = ros_harness.Simulator(*client)
    simulator.join()
    simulator.process = process
    yield Pilot(simulator)
    assert process.running and process.stop() == 0
    assert "Traceback" not in process.stderr, process.stderr


def told(message):
    return (
        time_ns(message.header.stamp) / 1e9, list(message.satellite), list(message.force_n),
        list(message.dead_actuator), list(message.stuck_actuator),
    )  # fmt: skip


def test_an_actuator_fails_by_a_request(pilot):
    code, reason = pilot.sim.refused(FailActuator, actuator="tether_9", mode="dead")
    assert code == Result.RESULT_NOT_FOUND and "actuator is 'tether_9'; allowed: sat" in reason
    code, reason = pilot.sim.refused(FailActuator, actuator="satellite_1", mode="melted")
    assert "mode is 'melted'; allowed: healthy, dead, stuck" in reason
    code, reason = pilot.sim.refused(
        FailActuator, actuator="satellite_1", mode="dead", stamp=Time(sec=2**31 - 1)
    )
    assert "allowed: up to 86400 s" in reason
    assert pilot.sim.set(command_timeout_s=5.0).successful
    one, two = list(FORCE), list(OTHER)
    pilot.send(FORCE)
    pilot.step(1)
    pilot.sim.do(FailActuator, actuator="satellite_1", mode=FailActuator.Request.MODE_STUCK)
    pilot.sim.do(FailActuator, actuator="satellite_2", mode="dead", stamp=Time(sec=5))
    pilot.send(OTHER)
    pilot.send(FORCE, satellite="satellite_2", stamp=Time(sec=7))
    pilot.step(5)
    pilot.sim.do(FailActuator, actuator="satellite_1", mode="healthy")
    pilot.send(OTHER)
    pilot.step(1)
    assert [told(m) for m in pilot.applied] == [
        (0.0, ["satellite_1"], one, [], []),
        (2.0, ["satellite_1"], one, [], ["satellite_1"]),
        (5.0, ["satellite_1"], one, ["satellite_2"], ["satellite_1"]),
        (12.0, ["satellite_1"], two, ["satellite_2"], []),
    ]
    events = [e for e in pilot.sim.events if e.kind == "fail"]
    assert [(e.text, e.step) for e in events] == [
        ("satellite_1: stuck at 2.000000000 s", pilot.applied[1].step),
        ("satellite_2: dead at 5.000000000 s", pilot.applied[2].step),
        ("satellite_1: healthy again at 12.000000000 s", pilot.applied[3].step),
    ]


def test_a_run_with_failures_is_recorded_made_again_and_begun_anew(start, client, tmp_path):
    """Declared ones, and a request while it runs; a reset brings back the declared ones alone."""
    declared, _ = failing(tmp_path, {20: [push(0.0, FORCE)]})
    logger = start("logger_node", output="bag")
    process = start(
        "sim_node", scenario=declared.options["scenario"], time_scale=0, start_paused=True,
        wait_for_recorder=True, service_folder="/", **GIVEN,
    )  # fmt: skip
    simulator = ros_harness.Simulator(*client)
    pilot = Pilot(simulator)
    while not (simulator.beads and simulator.status):
        pilot.sim.do(StepSimulation, steps=1)
    pilot.step(20)
    pilot.send(FORCE)
    simulator.do(FailActuator, actuator="satellite_1", mode="stuck", stamp=Time(sec=60))
    simulator.do(CutTether, tether="tether_3", stamp=Time(sec=300))
    pilot.step(380)
    simulator.do(SaveSnapshot, file=str(tmp_path / "a.npz"))
    on = motion(pilot.step(5))
    simulator.do(RestoreSnapshot, file=str(tmp_path / "a.npz"))
    assert motion(pilot.step(5)) == on
    simulator.do(ResetSimulation)
    position_m = run(declared, 91)[0][90, 0]
    assert motion(pilot.step(90))[0] == position_m.tobytes()
    assert process.stop() == 0 and logger.stop() == 0, process.stderr + logger.stderr
    said = [event.text.split(" at ")[0] for event in simulator.events if event.kind == "fail"]
    assert said == [
        *("satellite_1: dead", "satellite_3: stuck", "satellite_1: stuck"),
        *("satellite_1: dead", "satellite_3: stuck"),  # after the reset, which mends in silence
    ]
    recorded = read_bag(tmp_path / "bag", run=1)
    changes = read_commands(tmp_path / "bag", SYSTEM)
    assert changes[-1].failed and changes[-1].commands.cut.tolist() == [False, True, True]
    words = [f"--{name.replace('_', '-')}={value}" for name, value in GIVEN.items()]
    turns = 400.5 * PERIOD_S / declared.turn_s
    words += ["--turns", str(turns), "--commands", str(tmp_path / "bag")]
    name = declared.options["scenario"]
    assert straight.main([name, *words, "--output", str(tmp_path / "again")]) == 0
    again = read_bag(tmp_path / "again")
    np.testing.assert_array_equal(again.position_m, recorded.position_m[: len(again.position_m)])
    assert len(again.position_m) == 401
    assert read_commands(tmp_path / "again", SYSTEM) == changes
