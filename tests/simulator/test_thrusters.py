"""Thrusters over the middleware: real controllers, real commands, and the same run once more."""

import math
import signal
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import ros_harness
from builtin_interfaces.msg import Time
from pilot import LATCHED, Pilot, flown
from ros_harness import motion, time_ns
from simulation_interfaces.msg import Result
from simulation_interfaces.srv import GetEntityState, StepSimulation
from tss_interfaces.msg import AppliedWrenches
from tss_interfaces.srv import CutTether, RestoreSnapshot, SaveSnapshot

from tss_ros.bags.recording import read_bag
from tss_ros.bags.verify import verify
from tss_ros.bags.wrenches import read_commands
from tss_ros.core import TssError
from tss_ros.simulator import straight

PERIOD_S = 2.0
GIVEN = {"publish_period_s": PERIOD_S, "disturbance_m": 5.0, "disturbance_seed": 3}


@pytest.fixture
def pilot(start, client):
    with flown(start, client, Pilot, **GIVEN) as pilot:
        yield pilot


def test_commands_hold_from_the_step_that_is_asked_for_next(pilot):
    first = pilot.step(3)
    pilot.send((0.5, 0.0, -0.25), frame="inertial")
    pilot.step(2)
    pilot.send((0.0, 1.0, 0.0), satellite="satellite_2", frame="spinning")
    pilot.send((0.0, 0.0, 0.0))
    pilot.step(1)
    assert [(m.step, time_ns(m.header.stamp) / 1e9) for m in pilot.applied] == [
        (first.step + 1, 6.0), (first.step + 3, 10.0)
    ]  # fmt: skip
    one, two = pilot.applied
    assert (list(one.satellite), list(one.frame), list(one.force_n), list(one.cut_tether)) == (
        ["satellite_1"], ["inertial"], [0.5, 0.0, -0.25], []
    )  # fmt: skip
    assert (list(two.satellite), list(two.frame)) == (["satellite_2"], ["spinning"])
    assert list(two.force_n) == [0.0, 1.0, 0.0] and one.run == two.run == pilot.sim.run
    late = []
    pilot.sim.node.create_subscription(AppliedWrenches, "/applied_wrenches", late.append, LATCHED)
    pilot.sim.spin_until(lambda: len(late) == 2, 10, "what acts, for those who come late")
    assert late == pilot.applied
    # The force shows in the acceleration that the simulator tells: 1 N on 100 kg.
    before = pilot.sim.do(GetEntityState, entity="satellite_2").state.acceleration.linear
    pilot.send(satellite="satellite_2")
    pilot.step(1)
    after = pilot.sim.do(GetEntityState, entity="satellite_2").state.acceleration.linear
    assert 0.005 < math.dist(*[(a.x, a.y, a.z) for a in (before, after)]) < 0.02


def test_hostile_commands_are_refused_with_a_warning_and_change_nothing(pilot):
    plain = []
    for _ in range(3):
        plain.append(motion(pilot.step(5)))
    pilot.sim.join()
    nan, hour = math.nan, 3600
    hostile = [
        ({"force": (nan, 0.0, 0.0)}, "force is [nan"),
        ({"force": (0.0, math.inf, 0.0)}, "force is [0.0, inf"),
        ({"force": (1e30, 0.0, 0.0)}, "allowed: -1e+06 to 1e+06 N"),
        ({"frame": "base_link"}, "frame_id is 'base_link'; allowed: orbit, inertial, spinning"),
        ({"torque": (0.0, 0.0, 1e-9)}, "torque is [0.0, 0.0, 1e-09]; allowed: 0"),
        ({"torque": (nan, 0.0, 0.0)}, "torque is [nan"),
        ({"stamp": Time(sec=2**31 - 1)}, "stamp is 2.14748365e+09 s; allowed: up to 86400 s"),
    ]
    # One warning for each satellite in a while: three of these are seen as lines.
    for k, (options, _) in enumerate(hostile):
        pilot.send(**{"force": (1.0, 0.0, 0.0), **options}, satellite=f"satellite_{k % 3 + 1}")
    again = [motion(pilot.step(5)) for _ in range(3)]
    assert again == plain and not pilot.applied
    for _, said in hostile[:3]:
        pilot.sim.process.wait_for_line(said)
    assert pilot.sim.process.stderr.count("command refused") == 3
    # Late stamps count as the next step; a flood of good commands leaves the last one.
    for i in range(3000):
        pilot.send((i / 1000.0, 0.0, 0.0), stamp=Time(sec=1))
        if i % 100 == 0:
            pilot.sim.spin_until(lambda: True, 1, "")
    pilot.step(1)
    pilot.sim.spin_until(lambda: pilot.applied, ros_harness.START_S, "what is applied")
    assert list(pilot.applied[-1].force_n) == [2.999, 0.0, 0.0] and len(pilot.applied) == 1
    pilot.send((5.0, 0.0, 0.0), stamp=Time(sec=hour))
    pilot.step(1)
    assert len(pilot.applied) == 1


@pytest.mark.parametrize(("options", "said"), [
    ({"force": (1.0, math.nan, 0.0)}, "force is [1.0, nan, 0.0]; allowed: -1e+06 to 1e+06"),
    ({"frame": "map"}, "frame_id is 'map'; allowed: orbit, inertial, spinning, or '' for orbit"),
    ({"torque": (0.0, 1.0, 0.0)}, "torque is [0.0, 1.0, 0.0]; allowed: 0, for beads have no"),
    ({"stamp": Time(sec=10**6)}, "allowed: up to 86400 s after the newest step's"),
])  # fmt: skip
def test_a_refusal_says_what_is_allowed(pilot, options, said):
    pilot.send(**options)
    pilot.sim.process.wait_for_line(said)


def test_limits_and_timeouts_apply_at_once(pilot):
    assert pilot.sim.set(command_limit_n=2.0, command_timeout_s=5.0).successful
    pilot.send((3.0, 0.0, 4.0))
    first = pilot.step(6)
    pilot.sim.process.wait_for_line("satellite_1: 5 N scaled back to command_limit_n, 2 N")
    one, two = pilot.applied
    np.testing.assert_allclose(one.force_n, [1.2, 0.0, 1.6])
    assert (time_ns(two.header.stamp) - time_ns(one.header.stamp)) / 1e9 == 5.0
    assert not two.satellite and two.step == one.step + 2 < first.step
    assert not pilot.sim.set(command_limit_n=-1.0).successful


def test_a_tether_is_cut_at_its_time(pilot):
    code, reason = pilot.sim.refused(CutTether, tether="rope")
    assert code == Result.RESULT_NOT_FOUND and "tether_1" in reason
    first = pilot.step(1)
    at = time_ns(first.header.stamp) + 5 * 10**9
    pilot.sim.do(CutTether, tether="tether_2", stamp=Time(sec=at // 10**9))
    pilot.step(4)
    (message,) = pilot.applied
    assert list(message.cut_tether) == ["tether_2"] and time_ns(message.header.stamp) == at
    event = pilot.sim.events[-1]
    assert event.kind == "cut" and event.step == message.step == first.step + 3
    assert event.text == f"tether_2: cut at {at / 1e9:.9f} s"


def test_a_run_is_made_again_from_its_bag(start, client, tmp_path, monkeypatch):
    """A controller flies while a recorder records; commands come whenever they come."""
    logger = start("logger_node", output="bag")
    process = start(
        "sim_node", time_scale=400, turns=0.6, wait_for_recorder=True, command_timeout_s=150.0,
        **GIVEN,
    )  # fmt: skip
    simulator = ros_harness.Simulator(*client)
    pilot = Pilot(simulator)
    rng, names = np.random.default_rng(5), list(pilot.publishers)
    while process.running:
        frame = ("", "orbit", "inertial", "spinning")[rng.integers(4)]
        pilot.send(
            rng.normal(size=3).tolist(), frame=frame, satellite=names[rng.integers(3)],
            stamp=Time(sec=int(rng.integers(2000))) if rng.random() < 0.3 else None,
        )  # fmt: skip
        until = time.monotonic() + 0.05
        simulator.spin_until(lambda until=until: time.monotonic() > until, 1, "a while")
    assert process.wait(10) == 0, process.stderr
    assert logger.stop() == 0, logger.stderr
    recorded = read_bag(tmp_path / "bag")
    assert not verify(tmp_path / "bag").faults
    applied = read_commands(tmp_path / "bag", recorded.system)
    assert len(applied) > 10 and recorded.lost == 0
    words = [f"--{name.replace('_', '-')}={value}" for name, value in GIVEN.items()]
    words += ["--turns", "0.6", "--commands", str(tmp_path / "bag")]
    assert straight.main(["three_star", *words, "--output", str(tmp_path / "again")]) == 0
    again = read_bag(tmp_path / "again")
    np.testing.assert_array_equal(again.position_m, recorded.position_m)
    np.testing.assert_array_equal(again.velocity_m_s, recorded.velocity_m_s)
    np.testing.assert_array_equal(again.tension_n, recorded.tension_n)
    assert read_commands(tmp_path / "again", again.system) == applied
    other = replace(recorded.system, bead_name=("a", "b", "c"))
    with pytest.raises(TssError, match="has commands of another system: bead is 'satellite_"):
        read_commands(tmp_path / "bag", other)


def test_a_restored_run_goes_on_with_its_forces(pilot):
    pilot.step(2)
    pilot.send((0.7, 0.1, 0.0), frame="spinning")
    pilot.step(5)
    pilot.sim.do(SaveSnapshot, file="pushed.npz")
    expected = [motion(pilot.step(4)) for _ in range(3)]
    pilot.sim.do(RestoreSnapshot, file="pushed.npz")
    assert [motion(pilot.step(4)) for _ in range(3)] == expected
    one, two = pilot.applied
    assert two.run == one.run + 1 and two.force_n == one.force_n and two.frame == one.frame


def swing_m_s(position_m, velocity_m_s):
    """How fast satellites move against the rigid turn that fits them best: a norm over all."""
    r, v = (x - x.mean(axis=1, keepdims=True) for x in (position_m, velocity_m_s))
    inertia = np.einsum("kij,kij->k", r, r)[:, None, None] * np.eye(3)
    inertia -= np.einsum("kip,kiq->kpq", r, r)
    spin = np.linalg.solve(inertia, np.cross(r, v).sum(axis=1)[..., None])[..., 0]
    return np.sqrt(((v - np.cross(spin[:, None], r)) ** 2).sum(axis=(1, 2)))


def test_the_example_damps_the_swing_of_six_beads(start, client, tmp_path):
    given = {"publish_period_s": 10.0, "disturbance_m": 300.0, "disturbance_seed": 1, "turns": 4.0}
    setup = straight.setup_of("six_bead", {"spin_rate_ratio": -2.9}, given)
    straight.simulate(setup, 4.0, tmp_path / "alone")
    process = start(
        "sim_node", scenario="six_bead", spin_rate_ratio=-2.9, time_scale=400, start_paused=True,
        **given,
    )  # fmt: skip
    example = Path(__file__).parents[2] / "examples" / "damp_six_beads.py"
    damper = ros_harness.Process(sys.executable, tmp_path, [example])
    try:
        simulator = ros_harness.Simulator(*client)
        simulator.do(StepSimulation, steps=2)  # the controller finds out whom to push
        topics = [f"/sim_node/satellite_{i}/cmd_wrench" for i in (1, 2, 3)]
        simulator.spin_until(
            lambda: (
                simulator.do(StepSimulation, steps=1)
                and all(simulator.node.count_publishers(topic) for topic in topics)
            ),
            ros_harness.START_S, "the controller",
        )  # fmt: skip
        simulator.play()
        simulator.spin_until(lambda: not process.running, 100.0, "the end of the run")
        assert process.wait(1) == 0 and damper.running
        assert damper.stop(signal.SIGTERM) == 0 and damper.stderr == ""
    finally:
        damper.kill()
    satellites = np.flatnonzero(setup.system.is_satellite)
    last = round(setup.turn_s / given["publish_period_s"])
    damped = [
        np.array([np.reshape(x, (-1, 3))[satellites] for x in column])
        for column in zip(*((m.position_m, m.velocity_m_s) for m in simulator.beads[-last:]))
    ]
    alone = read_bag(tmp_path / "alone")
    alone = alone.position_m[-last:, satellites], alone.velocity_m_s[-last:, satellites]
    with_thrusters, without = (math.sqrt(np.mean(swing_m_s(*x) ** 2)) for x in (damped, alone))
    assert simulator.beads[-1].step == 869 and len(simulator.beads) > last
    assert with_thrusters < 0.7 * without
