"""Reels over the middleware: rates, targets and profiles of a running simulator, and runs again."""

import math
import re
import time

import numpy as np
import pytest
import ros_harness
from builtin_interfaces.msg import Duration, Time
from pilot import LATCHED, Pilot, flown
from ros_harness import motion, time_ns
from sensor_msgs.msg import JointState
from simulation_interfaces.srv import SetEntityState
from std_msgs.msg import Header
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint
from tss_interfaces.msg import AppliedWrenches, TetherStates
from tss_interfaces.srv import CutTether, Disturb, FailActuator, RestoreSnapshot, SaveSnapshot

from tss_ros.bags.recording import read_bag
from tss_ros.bags.verify import verify
from tss_ros.bags.wrenches import read_commands
from tss_ros.core import TssError, ring
from tss_ros.simulator import straight
from tss_ros.simulator.reel_commands import RATE, TARGET, Limits, ReelCommand
from tss_ros.simulator.reel_topics import limited, read_tethers, read_trajectory

PERIOD_S, S = 2.0, 10**9
GIVEN = {"publish_period_s": PERIOD_S, "disturbance_m": 1.0, "disturbance_seed": 3}
DEPLOYED = """
description: three satellites whose tethers of four segments are partly out
formation: ring
spin_rate_ratio: -2.9
tether_length_m: 1000.0
damping_n_s_per_m: 100.0
beads_per_tether: 3
bead_mass_kg: 2.0
deployed_m: 430.0
"""


def rates(name, stamp_s=0, **columns):
    names = [name] if isinstance(name, str) else name
    return JointState(header=Header(stamp=Time(sec=stamp_s)), name=names, **columns)


def profile(name, *points, stamp_s=0, **others):
    """Points of (time, position) or (time, position, velocity)."""
    names = [name] if isinstance(name, str) else name
    rows = [
        JointTrajectoryPoint(
            positions=[float(p[1])] * len(names),
            velocities=[float(v) for v in p[2:] for _ in names],
            time_from_start=Duration(sec=int(p[0]), nanosec=round(p[0] % 1 * S)),
            **others,
        )
        for p in points
    ]
    header = Header(stamp=Time(sec=stamp_s))
    return JointTrajectory(header=header, joint_names=names, points=rows)


class Winch(Pilot):
    """A controller that moves reels and pushes satellites, and hears what comes of it."""

    def __init__(self, simulator):
        super().__init__(simulator)
        node = simulator.node
        self.tethers, reels = [], "/sim_node/cmd_tether"
        node.create_subscription(TetherStates, "/tether_states", self.tethers.append, 1000)
        self.publishers |= {
            "reels": node.create_publisher(JointState, reels, 1000),
            "profiles": node.create_publisher(JointTrajectory, f"{reels}_trajectory", 1000),
        }
        simulator.spin_until(
            lambda: (
                all(p.get_subscription_count() for p in self.publishers.values())
                and node.count_publishers("/tether_states")
            ),
            ros_harness.START_S, "the topics of reels",
        )  # fmt: skip

    def reel(self, *arguments, **columns):
        self.publishers["reels"].publish(rates(*arguments, **columns))

    def fly(self, *arguments, **others):
        self.publishers["profiles"].publish(profile(*arguments, **others))

    def step(self, count=1):
        newest = super().step(count)
        self.sim.spin_until(lambda: self.tethers[-1].step == newest.step, 10, "tether states")
        return newest

    def rests(self, count, tether=0):
        """Rest lengths of a tether after each of so many steps."""
        first = self.step(count).step - count
        return [m.rest_length_m[tether] for m in self.tethers if m.step > first]


@pytest.fixture
def winch(start, client):
    with flown(start, client, Winch, **GIVEN) as winch:
        yield winch


def test_a_rate_a_target_and_a_profile_hold_from_the_next_step(winch):
    winch.reel("tether_1", velocity=[-0.5])
    assert winch.rests(3) == [9_999.0, 9_998.0, 9_997.0]
    winch.reel("tether_1", position=[9_999.0], velocity=[0.8])
    np.testing.assert_allclose(winch.rests(2), [9_998.6, 9_999.0], rtol=1e-15)
    assert winch.rests(1) == [9_999.0]
    winch.fly("tether_1", (4.0, 9_995.0), (10.0, 9_998.0))
    np.testing.assert_allclose(winch.rests(5), [9_997, 9_995, 9_996, 9_997, 9_998], rtol=1e-15)
    newest = winch.tethers[-1]
    assert newest.rest_rate_m_s[0] == 0.5 and newest.rest_length_m[1:].tolist() == [10e3, 10e3]
    cubic = ((0.0, 9_998.0, 0.0), (20.0, 9_990.0, 0.0))
    winch.fly("tether_1", *cubic)
    u = np.arange(2.0, 22.0, PERIOD_S) / 20.0
    np.testing.assert_allclose(winch.rests(10), 9_998.0 - 8.0 * u * u * (3.0 - 2.0 * u), rtol=1e-14)
    assert winch.rests(2) == [9_990.0, 9_990.0]
    first = winch.applied[0]
    assert list(first.reel_tether) == ["tether_1"]
    assert list(first.reel) == [first.header.stamp.sec, 10e3, -0.5, 0.0, 0.0]
    assert list(winch.applied[-1].reel) == [0.0, 9_990.0, 0.0, 0.0, 0.0]
    winch.reel(["tether_3", "tether_2"], position=[9_999.0, 9_998.0])
    winch.rests(1)
    assert winch.tethers[-1].rest_length_m.tolist() == [9_990.0, 9_998.0, 9_999.0]


def test_a_rate_times_out_and_a_reel_stops_at_its_limits(winch):
    assert winch.sim.set(command_timeout_s=5.0, reel_shortest_m=9_985.0).successful
    winch.reel("tether_1", velocity=[-3.0])
    winch.sim.process.wait_for_line("tether_1: -3 m/s scaled back to reel_rate_limit_m_s, 1")
    assert winch.rests(4) == [9_998.0, 9_996.0, 9_995.0, 9_995.0]
    assert winch.sim.set(command_timeout_s=0.0, reel_rate_limit_m_s=0.0).successful
    winch.reel("tether_2", velocity=[-4.0])
    assert winch.rests(3, tether=1) == [9_992.0, 9_985.0, 9_985.0]
    winch.sim.process.wait_for_line("tether_2: its reel stopped at reel_shortest_m, 9985 m")
    last = winch.applied[-1]
    assert time_ns(last.header.stamp) - time_ns(winch.applied[-2].header.stamp) == 3.75 * S
    winch.reel("tether_3", position=[9_900.0], velocity=[7.0])
    winch.sim.process.wait_for_line("tether_3: 9900 m is beyond reel_shortest_m, 9985 m")
    assert winch.rests(3, tether=2)[-1] == 9_985.0
    for name, value in (("reel_shortest_m", 0.0), ("reel_longest_m", -1.0)):
        assert not winch.sim.set(**{name: value}).successful
    refused = winch.sim.set(reel_longest_m=9_000.0)
    assert not refused.successful and "is 9000 m and reel_shortest_m 9985 m" in refused.reason


def test_a_reel_fails_and_is_repaired(winch):
    def fail(mode, name="tether_1"):
        winch.sim.do(FailActuator, actuator=name, mode=mode)

    winch.reel("tether_1", velocity=[-0.5])
    winch.rests(2)
    fail("dead")
    assert winch.rests(3) == [9_998.0] * 3
    winch.reel("tether_1", velocity=[1.0])
    assert winch.rests(2) == [9_998.0] * 2 and list(winch.applied[-1].dead_actuator) == ["tether_1"]
    fail("healthy")
    assert winch.rests(2) == [9_998.0] * 2
    winch.reel("tether_1", velocity=[1.0])
    winch.rests(1)
    fail("stuck")
    winch.reel("tether_1", velocity=[-1.0])
    assert winch.rests(2) == [10_002.0, 10_004.0]
    assert list(winch.applied[-1].stuck_actuator) == ["tether_1"]
    winch.sim.do(CutTether, tether="tether_3")
    winch.rests(1)
    winch.reel("tether_3", velocity=[-0.1])
    winch.sim.process.wait_for_line("tether_3: command refused: tether_3 is cut; allowed")
    winch.rests(1)
    assert "tether_3" not in winch.applied[-1].reel_tether
    told = [event.text.split(" at ")[0] for event in winch.sim.events if event.kind == "fail"]
    assert told == ["tether_1: dead", "tether_1: healthy again", "tether_1: stuck"]


NAN, BIG = math.nan, 1e30
@pytest.mark.parametrize(
    ("kind", "length_m", "rate_m_s", "out_m", "said"),
    [
        (RATE, 0.0, 0.5, 900.0, "900 m are out, and reel_longest_m is 800 m: it does not move"),
        (RATE, 0.0, -0.5, 900.0, ""),
        (RATE, 0.0, -0.5, 400.0, "400 m are out, and reel_shortest_m is 400 m: it does not move"),
        (TARGET, 950.0, 0.5, 900.0, "900 m are out, and reel_longest_m is 800 m"),
        (TARGET, 850.0, 0.5, 900.0, ""),  # it comes nearer to what is allowed
        (TARGET, 850.0, 0.5, 700.0, "850 m is beyond reel_longest_m, 800 m, where it will stop"),
        (TARGET, 100.0, 0.5, 900.0, "100 m is beyond reel_shortest_m, 400 m, where it will stop"),
        (TARGET, 500.0, 0.5, 700.0, ""),
    ],
)
def test_what_limits_make_of_a_command_is_told(kind, length_m, rate_m_s, out_m, said):
    limits = Limits(0.0, 400.0, 800.0)
    command = ReelCommand(0, 0, kind, ((0.0, length_m, rate_m_s),), limits)
    words = limited(command, (out_m, 0.0))
    assert words.startswith(said) and bool(words) == bool(said)


OPTIONS = {"reel_rate_limit_m_s": 1.0, "reel_shortest_m": 1.0, "reel_longest_m": 0.0}
OPTIONS["command_timeout_s"] = 0.0
HOSTILE = [
    ({"name": "tether_9", "velocity": [1.0]}, "tether is 'tether_9'; allowed: tether_1"),
    ({"name": [], "velocity": []}, "name is empty; allowed: tether_1, tether_2, tether_3"),
    ({"name": ["tether_1"] * 2, "velocity": [1.0, 1.0]}, "name has tether_1 more than once"),
    ({"name": "tether_1"}, "position and velocity are empty; allowed: one of them or both"),
    ({"name": "tether_1", "velocity": [NAN]}, "velocity is [nan]; allowed: finite numbers"),
    ({"name": "tether_1", "position": [math.inf]}, "position is [inf]; allowed: finite"),
    ({"name": "tether_1", "velocity": [BIG]}, "velocity is 1e+30 m/s; allowed: 0, and 1e-09"),
    ({"name": "tether_1", "position": [-5.0]}, "position is -5 m; allowed: 0.2 to 1e+07"),
    ({"name": "tether_1", "velocity": [1.0, 2.0]}, "velocity has 2 values; allowed: 1, or none"),
    ({"name": "tether_1", "velocity": [1.0], "effort": [0.0]}, "effort is given; allowed: pos"),
    ({"name": "tether_1", "position": [9e3], "velocity": [0.0]}, "speed towards 9000 m is 0"),
    ({"name": "tether_1", "velocity": [1.0], "stamp_s": 10**6}, "allowed: up to 86400 s after"),
]
PROFILES = [
    (((0.0, 9e3),), {}, "tether_1 begins with 9000 m; allowed: 10000 m, which is out then"),
    ((), {}, "points are empty; allowed: one or more"),
    (((1.0, 9e3), (1.0, 9e3)), {}, "time_from_start is 1 s; allowed: from 0 on, increasing"),
    (((-1.0, 9e3),), {}, "time_from_start is -1 s; allowed"),
    (((1.0, NAN),), {}, "positions is [nan]; allowed: finite"),
    (((1.0, 9e3, 0.0), (2.0, 9e3)), {}, "velocities of some points are empty"),
    (((1.0, 9e3),), {"effort": [1.0]}, "effort are given; allowed: positions"),
    (tuple((1.0 + i, 9e3) for i in range(1001)), {}, "it has 1001 points; allowed: 1 to 1000"),
]


def test_hostile_commands_are_refused_in_words_and_change_nothing(start, client):
    """All of them at one simulator: the pause between warnings is that of another test."""
    process = start("sim_node", start_paused=True, time_scale=0, **GIVEN)
    simulator = ros_harness.Simulator(*client)
    simulator.join()
    simulator.process = process
    winch = Winch(simulator)
    plain = [motion(winch.step(3)) for _ in range(2)]
    winch.sim.join()
    for columns, _ in HOSTILE:
        winch.reel(**columns)
    for points, others, _ in PROFILES:
        winch.fly("tether_1", *points, **others)
    assert [motion(winch.step(3)) for _ in range(2)] == plain and not winch.applied
    # At most one warning about a tether, or about a topic, in a while.
    assert process.stderr.count("command refused") == 2
    process.wait_for_line("~/cmd_tether: command refused: tether is 'tether_9'")
    for i in range(3000):
        winch.reel("tether_2", velocity=[-i / 3000.0], stamp_s=1)
        if i % 100 == 0:
            winch.sim.spin_until(lambda: True, 1, "")
    winch.step(1)
    winch.sim.spin_until(lambda: winch.applied, 10, "what is applied")
    assert winch.applied[-1].reel[2] == -2999 / 3000.0 and len(winch.applied) == 1
    assert process.stop() == 0 and "Traceback" not in process.stderr


@pytest.mark.parametrize("columns, said", HOSTILE[:-1])
def test_a_refused_rate_says_what_is_allowed(columns, said):
    with pytest.raises(TssError, match=re.escape(said)):
        read_tethers(rates(**columns), ring(), 0, OPTIONS)


@pytest.mark.parametrize("points, others, said", PROFILES[1:])
def test_a_refused_profile_says_what_is_allowed(points, others, said):
    with pytest.raises(TssError, match=re.escape(said)):
        read_trajectory(profile("tether_1", *points, **others), ring(), 0, OPTIONS)


@pytest.mark.parametrize("given, said", [
    ({"stamp_s": 10**6, "velocity": [1.0]}, HOSTILE[-1][1]),
    (PROFILES[0][0], PROFILES[0][2]),
])  # fmt: skip
def test_what_only_a_running_simulator_can_refuse(winch, given, said):
    winch.reel("tether_1", **given) if isinstance(given, dict) else winch.fly("tether_1", *given)
    winch.sim.process.wait_for_line(said)


def test_a_run_with_reels_is_made_again_from_its_bag(start, client, tmp_path):
    """Tethers begin on their reels, beads leave and return, a thruster pushes."""
    (tmp_path / "deployed.yaml").write_text(DEPLOYED)
    scenario = str(tmp_path / "deployed.yaml")
    logger = start("logger_node", output="bag")
    process = start(
        "sim_node", scenario=scenario, service_folder="/", time_scale=200, turns=0.3,
        wait_for_recorder=True, reel_shortest_m=400.0, reel_longest_m=800.0, **GIVEN,
    )  # fmt: skip
    winch = Winch(ros_harness.Simulator(*client))
    rng, sent = np.random.default_rng(5), 0
    while process.running:
        tether, sent = f"tether_{rng.integers(1, 4)}", sent + 1
        stamp_s = int(rng.integers(700)) if rng.random() < 0.3 else 0
        if sent % 3 == 0:
            winch.fly(tether, (20.0, rng.uniform(400, 700)), (60.0, 460.0), stamp_s=stamp_s)
        elif sent % 3 == 1:
            winch.reel(tether, velocity=[rng.uniform(-0.2, 1.0)], stamp_s=stamp_s)
        else:
            winch.reel(tether, position=[rng.uniform(420.0, 700.0)], stamp_s=stamp_s)
        winch.send(rng.normal(scale=0.05, size=3).tolist(), frame="spinning")
        until = time.monotonic() + 0.1
        winch.sim.spin_until(lambda until=until: time.monotonic() > until, 1, "a while")
    assert process.wait(10) == 0, process.stderr
    assert logger.stop() == 0, logger.stderr
    recorded = read_bag(tmp_path / "bag")
    assert not verify(tmp_path / "bag").faults and recorded.lost == 0
    applied = read_commands(tmp_path / "bag", recorded.system)
    assert len(applied) > 10 and applied[0][0] == 0 and (applied[0][1].reel[:, 1] == 430.0).all()
    out = recorded.rests_m.sum(axis=1)
    assert np.unique((recorded.rests_m > 0.0).sum(axis=1)).size > 1, "beads left their reels"
    assert np.ptp(out) > 10.0 and (recorded.rest_rates_m_s != 0.0).any()
    words = [f"--{name.replace('_', '-')}={value}" for name, value in GIVEN.items()]
    words += ["--turns", "0.3", "--commands", str(tmp_path / "bag")]
    assert straight.main([scenario, *words, "--output", str(tmp_path / "again")]) == 0
    again = read_bag(tmp_path / "again")
    for name in ("position_m", "velocity_m_s", "tension_n", "rests_m", "rest_rates_m_s", "taut"):
        np.testing.assert_array_equal(getattr(again, name), getattr(recorded, name), name)
    assert read_commands(tmp_path / "again", again.system) == applied


def test_a_payout_goes_on_from_a_snapshot_and_through_a_disturbance(start, client, tmp_path):
    (tmp_path / "deployed.yaml").write_text(DEPLOYED)
    process = start(
        "sim_node", scenario=str(tmp_path / "deployed.yaml"), service_folder="/",
        start_paused=True, time_scale=0, **GIVEN,
    )  # fmt: skip
    simulator = ros_harness.Simulator(*client)
    simulator.join()
    winch = Winch(simulator)
    winch.step(1)
    winch.fly(["tether_1", "tether_2", "tether_3"], (70.0, 480.0, 1.0), (110.0, 520.0, 0.5))
    winch.send((0.02, 0.0, 0.0), frame="spinning")
    winch.step(5)
    file = str(tmp_path / "paying.npz")
    simulator.do(SaveSnapshot, file=file)
    expected = [motion(winch.step(10)) for _ in range(6)]
    rests = [list(m.rest_length_m) for m in winch.tethers[-60:]]
    assert sum(rests[0][k] > 0.0 for k in range(12)) < sum(rests[-1][k] > 0.0 for k in range(12))
    simulator.do(RestoreSnapshot, file=file)
    assert [motion(winch.step(10)) for _ in range(6)] == expected
    assert [list(m.rest_length_m) for m in winch.tethers[-60:]] == rests
    # A disturbance goes on with the rest lengths of its moment.
    simulator.do(RestoreSnapshot, file=file)
    winch.step(3)
    simulator.do(Disturb, random_offset_m=0.01, seed=4)
    winch.step(57)
    found = [m.rest_length_m for m in winch.tethers[-57:]]
    np.testing.assert_allclose(found, rests[3:], rtol=1e-12)
    code, reason = simulator.refused(
        SetEntityState, entity=_on_reel(winch), state=SetEntityState.Request().state
    )
    assert "is on a reel and rides with satellite" in reason, (code, reason)
    assert process.stop() == 0 and "Traceback" not in process.stderr


def _on_reel(winch):
    """A bead whose segment next to the reel is not out."""
    newest, names = winch.tethers[-1], winch.sim.beads[-1].name
    assert newest.rest_length_m[0] == 0.0 and newest.name[0] == "tether_1_segment_1"
    return next(name for name in names if name.startswith("tether_1_bead"))


def test_a_scenario_begins_on_its_reels_and_flies_its_profile(start, client, tmp_path):
    profile = "reels:\n  all: {time_s: [10, 60], length_m: [430, 460]}\n"
    (tmp_path / "flown.yaml").write_text(DEPLOYED + profile)
    scenario = str(tmp_path / "flown.yaml")
    process = start(
        "sim_node", scenario=scenario, service_folder="/", start_paused=True, time_scale=0, **GIVEN
    )
    simulator = ros_harness.Simulator(*client)
    winch = Winch(simulator)
    applied, node = [], simulator.node
    node.create_subscription(AppliedWrenches, "/applied_wrenches", applied.append, LATCHED)
    simulator.join()
    assert len(applied) == 2 and applied[0].step == 0 and applied[1].step == simulator.first_step
    assert time_ns(applied[1].header.stamp) == 0 and list(applied[1].reel[1::5]) == [430.0] * 3
    live = [motion(winch.step(10)) for _ in range(4)]
    simulator.spin_until(lambda: len(applied) == 4, 10, "the profile's beginning and end")
    assert [time_ns(m.header.stamp) / S for m in applied[2:]] == [10.0, 60.0]
    setup = straight.setup_of(scenario, {}, {**GIVEN, "turns": 0.0})
    straight.simulate(setup, 80.0 / setup.turn_s, tmp_path / "bag")
    bag = read_bag(tmp_path / "bag")
    own = [(r.tobytes(), v.tobytes()) for r, v in zip(bag.position_m, bag.velocity_m_s)]
    assert own[10::10] == live
    out = bag.rests_m.reshape(-1, 3, 4).sum(axis=2)
    expected = np.interp(bag.t_s, [10.0, 60.0], [430.0, 460.0])
    np.testing.assert_allclose(out, expected[:, None] * np.ones(3), rtol=1e-12)
    assert process.stop() == 0


def test_a_node_obeys_a_law_and_lets_go_of_a_commanded_reel(start, client, tmp_path):
    (tmp_path / "follows.yaml").write_text(
        "formation: ring\nspin_rate_ratio: -2.9\ndamping_n_s_per_m: 0.0\n"
        "reel_damping_n_s_per_m: 1000.0\nreel_sample_s: 4.0\n"
    )
    scenario = {"scenario": str(tmp_path / "follows.yaml"), "service_folder": "/"}
    with flown(start, client, Winch, **GIVEN, **scenario) as winch:

        def seen(count):
            """Rates of all reels at each sample of the run."""

            def of_run():
                return [m for m in winch.applied if m.run == winch.applied[-1].run]

            winch.sim.spin_until(lambda: len(of_run()) == count, 10, "rates of the law")
            return np.array([np.reshape(m.reel, (-1, 5))[:, 2] for m in of_run()])

        winch.step(7)
        free = seen(4)
        assert free.shape == (4, 3) and (np.diff(free, axis=0) != 0.0).all()
        winch.reel("tether_2", velocity=[-0.5])
        winch.step(6)
        assert (seen(8)[4:, 1] == -0.5).all() and (np.diff(seen(8)[4:, ::2], axis=0) != 0.0).all()
        refused = winch.sim.set(publish_period_s=3.0)
        assert not refused.successful
        assert "sample_s is 4 s; allowed: whole multiples of publish_period_s" in refused.reason
        assert winch.sim.set(reel_rate_limit_m_s=1e-6).successful
        winch.step(2)
        assert (np.abs(seen(9)[-1, ::2]) == 1e-6).all() and seen(9)[-1, 1] == -0.5


def test_a_node_refuses_commands_to_reels_that_follow_a_law_all_the_time(start, client, tmp_path):
    (tmp_path / "follows.yaml").write_text(
        "formation: ring\nspin_rate_ratio: -2.9\nreel_damping_n_s_per_m: 1000.0\n"
    )
    given = {"scenario": str(tmp_path / "follows.yaml"), "disturbance_m": 5.0}
    with flown(start, client, Winch, **GIVEN | given) as winch:
        winch.reel("tether_2", velocity=[-0.5])
        winch.step(30)
        winch.sim.process.wait_for_line("command refused: reel_damping_n_s_per_m moves the reels")
        rests = np.array([m.rest_length_m for m in winch.tethers])
        assert len(rests) >= 30 and (np.ptp(rests, axis=0) > 0.01).all()
