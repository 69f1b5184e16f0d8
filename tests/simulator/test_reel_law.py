"""Reels that follow tension in a simulation: against multipliers, and alike in all simulators."""

import threading

import numpy as np
import pytest
import yaml

from tss_ros import core
from tss_ros.bags.recording import read_bag
from tss_ros.bags.wrenches import read_commands
from tss_ros.core import TssError, ring
from tss_ros.core.motion.integrator import Integrator
from tss_ros.core.stability import shooting
from tss_ros.scenarios import scenario
from tss_ros.simulator import straight
from tss_ros.simulator.reel_commands import RATE, TARGET, Limits, ReelCommand
from tss_ros.simulator.simulation import Simulation
from tss_ros.sweeps.ensemble import ensemble

S = 10**9
LAW = {"reel_damping_n_s_per_m": 1000.0, "reel_sample_s": 2.0}
ALWAYS = {"reel_damping_n_s_per_m": 1000.0}
STAR = {"formation": "ring", "spin_rate_ratio": -2.9, "damping_n_s_per_m": 0.0}
RUN = {"publish_period_s": 2.0, "disturbance_m": 5.0, "disturbance_seed": 3, "turns": 0.0}


def scenario_file(folder, law=LAW, **others):
    path = folder / "follows.yaml"
    path.write_text(yaml.safe_dump({**STAR, **law, **others}))
    return str(path)


def setup_in(folder, law=LAW, run=RUN, **others):
    return straight.setup_of(scenario_file(folder, law, **others), {}, run)


def simulation(setup, turns=0.0):
    return Simulation(setup, turns, threading.Event().set)


def taken(live, count):
    return [live.take() for _ in range(count)]


def motion(samples):
    return [
        np.array([getattr(s, name) for s in samples]) for name in ("position_m", "velocity_m_s")
    ]


def same(some, others):
    return all(map(np.array_equal, motion(some), motion(others)))


def rates(live):
    return live.acting.reel[:, 2]


def test_the_swing_decays_as_multipliers_and_sampling_say(tmp_path):
    """What is held for h lags by h / 2: of a swing at w it damps sin(w h) / (w h) as much."""
    system, steps = ring(damping_n_s_per_m=0.0, **ALWAYS), 800
    result = core.compute_floquet(system, -2.9, certify=False)
    integrator = Integrator(system, system.spin_rate_rad_s(-2.9), 1e-10, 1e4)
    integrator = integrator.driven(result.spin_loss)
    matrix = shooting.integrate_turn(integrator, result.state).matrix
    plane = np.flatnonzero(integrator.real & (np.arange(len(matrix)) % 3 != 2))
    rho, vectors = np.linalg.eig(matrix[np.ix_(plane, plane)])
    order = np.argsort(-np.abs(rho))
    np.testing.assert_allclose(np.abs(rho[order[6:9]]), 0.1136, atol=2e-4)
    swings = order[9:15]  # of three shapes, a pair of each

    def seen(sample, sign):
        """By left eigenvectors: how much there is of each multiplier."""
        rests = sample.alone
        state = core.State(
            sign * sample.position_m, sign * sample.velocity_m_s,
            reel_length_m=rests.rest_length_m[0], reel_rate_m_s=rests.rest_rate_m_s[0],
        )  # fmt: skip
        return np.linalg.inv(vectors) @ shooting.to_scaled(integrator, state)[plane]

    period_s = system.period_s(-2.9) / steps
    law, run = {**LAW, "reel_sample_s": 2.0 * period_s}, RUN | {"disturbance_m": 0.0}
    live = simulation(setup_in(tmp_path, law, run | {"publish_period_s": period_s}))
    taken(live, steps + 1)
    live.save(str(tmp_path / "settled.npz"))
    push_m = np.array([[0.01, -0.004, 0.0], [-0.03, -0.02, 0.0], [0.02, 0.024, 0.0]])
    found = []
    for share in (0.0, 1.0):
        live.restore(str(tmp_path / "settled.npz"))
        live.take()
        live.disturb(share * push_m, np.zeros((3, 3)))
        # After half a turn the formation is turned by 180 degrees, and gravity is as before.
        found.append([seen(live.newest, 1.0), seen(taken(live, steps // 2)[-1], -1.0)])
    begun, later = np.abs(np.subtract(*found))[:, swings]
    slow, fast = (np.sqrt(x * 5.0 / 100.0) * 2.0 * period_s for x in (1.5, 3.0))
    shares = np.log((later / begun) ** 2) / np.log(np.abs(rho[swings]))
    expected = [np.sin(x) / x for x in (fast, slow, slow)]
    np.testing.assert_allclose(np.sort(shares[::2]), expected, rtol=0.02)


def test_every_sample_gives_the_rate_of_the_law_until_the_next(tmp_path):
    law = {**LAW, "reel_stiffness_n_per_m": 7.0, "reel_tension_n": 1.5, "reel_sample_s": 6.0}
    live = simulation(setup_in(tmp_path, law, beads_per_tether=1, deployed_m=8000.0))
    samples = taken(live, 30)
    changes = {change.time: change.commands.reel for change in live.take_changes()}
    assert list(changes) == [6 * S * k for k in range(10)]
    for sample in samples[:-1:3]:
        states, reel = sample.alone, changes[sample.time_ns]
        # The reel is at the first satellite: the first of two segments is being paid out.
        out_m = states.rest_length_m[0].reshape(3, 2).sum(axis=1)
        pull_n = states.tension_n[0, ::2]
        np.testing.assert_allclose(reel[:, 1], out_m, rtol=1e-14)
        np.testing.assert_allclose(
            reel[:, 2], (pull_n - 1.5 - 7.0 * (out_m - 8e3)) / 1e3, rtol=1e-9
        )
    assert np.abs(changes[0][:, 2]).max() > 1e-4


@pytest.mark.parametrize("more", [
    {},
    {"beads_per_tether": 2, "deployed_m": {"tether_1": 3333.5}, "tether_length_m": 5000.0},
    {"failures": [{"at_s": 13.0, "dead": "satellite_1"}, {"at_s": 171.0, "cut": "tether_2"}]},
    {"failures": [{"when": {"tether": "tether_3", "tension_n": 1.9}, "cut": "tether_1"}]},
    {"failures": [{"at_s": 31.0, "dead": "tether_1"}, {"at_s": 47.0, "stuck": "tether_2"},
                  {"when": {"tether": "tether_3", "tension_n": 1.9}, "dead": "satellite_3"}]},
])  # fmt: skip
@pytest.mark.parametrize("every", [1, 5])
def test_straight_runs_and_runs_made_again_are_the_same_bit_for_bit(tmp_path, more, every):
    setup = setup_in(tmp_path, {**LAW, "reel_sample_s": 2.0 * every}, **more)
    live, count = simulation(setup, 0.1), 109
    samples = taken(live, count)
    assert live.at_end
    straight.simulate(setup, 0.1, tmp_path / "straight")
    commands = read_commands(tmp_path / "straight", setup.system)
    assert [c[:] for c in commands] == [c[:] for c in live.take_changes()]
    straight.simulate(setup, 0.1, tmp_path / "again", commands=commands)
    for bag in map(read_bag, (tmp_path / "straight", tmp_path / "again")):
        position_m, velocity_m_s = motion(samples)
        assert np.array_equal(bag.position_m, position_m)
        assert np.array_equal(bag.velocity_m_s, velocity_m_s)
    assert len(commands) >= (count - 1) // every
    assert [c[:] for c in read_commands(tmp_path / "again", setup.system)] == [
        c[:] for c in commands
    ]


def test_a_law_at_rest_says_nothing_and_a_failure_keeps_its_time(tmp_path):
    """Rates of 0 are no news: what came to act earlier than the first one stays as it is."""
    law = {"reel_damping_n_s_per_m": 1e12, "reel_stiffness_n_per_m": 0.0, "reel_sample_s": 20.0}
    setup = setup_in(tmp_path, law, failures=[{"at_s": 13.0, "cut": "tether_2"}])
    live = simulation(setup, 0.05)
    samples = taken(live, 55)
    straight.simulate(setup, 0.05, tmp_path / "bag")
    commands = read_commands(tmp_path / "bag", setup.system)
    assert [c.time for c in commands] == [13 * S] == [c.time for c in live.take_changes()]
    assert np.array_equal(read_bag(tmp_path / "bag").position_m, motion(samples)[0])


def test_snapshots_and_resets_go_on_with_the_law(tmp_path):
    file = str(tmp_path / "mid.npz")
    setup = setup_in(tmp_path, {**LAW, "reel_sample_s": 14.0}, beads_per_tether=1)
    live = simulation(setup)
    first = taken(live, 17)
    live.commands.post(ReelCommand(60 * S, 1, TARGET, ((0.0, 9_999.0, 0.5),)))
    live.save(file)
    after = taken(live, 40)
    other = simulation(setup)
    taken(other, 3)
    other.restore(file)
    again = taken(other, 41)
    assert same(again[1:], after)
    assert np.array_equal(other.acting.reel, live.acting.reel)
    live.reset(setup)
    assert same(taken(live, 17), first)
    live.reset(time=True)
    assert live.newest.time_ns == 0 and same([live.take()], first[-1:])
    with pytest.raises(TssError, match="another reel_sample_s"):
        others = setup_in(tmp_path, {**LAW, "reel_sample_s": 12.0}, beads_per_tether=1)
        simulation(others).restore(file)
    content = dict(np.load(file))
    for damage in (np.array([8]), np.array([0]), np.array([], dtype=np.int64)):
        np.savez(tmp_path / "damaged.npz", **content | {"commands_law_left": damage})
        with pytest.raises(TssError, match="damaged: its law of reels has"):
            other.restore(str(tmp_path / "damaged.npz"))


def test_samples_keep_their_times_when_a_motion_is_disturbed(tmp_path):
    live = simulation(setup_in(tmp_path, {**LAW, "reel_sample_s": 10.0}))
    taken(live, 4)
    live.disturb(0.1, 0.0)
    taken(live, 9)
    assert [change.time // S for change in live.take_changes()] == [0, 10, 20]


def test_a_command_takes_its_reel_from_the_law_until_a_reset(tmp_path):
    setup = setup_in(tmp_path)
    live = simulation(setup)
    taken(live, 3)
    live.commands.post(ReelCommand(7 * S, 1, RATE, ((0.0, 0.0, -0.25),)))
    seen = []
    for _ in range(6):
        live.take()
        seen.append(rates(live))
    seen = np.array(seen)
    assert seen[0, 1] != -0.25 and (seen[1:, 1] == -0.25).all()
    assert all(len(set(seen[:, place])) == 6 for place in (0, 2))
    live.reset(setup)
    taken(live, 6)
    assert rates(live)[1] != -0.25


def test_the_law_keeps_the_limits_of_reels(tmp_path):
    law = {"reel_damping_n_s_per_m": 1.0, "reel_stiffness_n_per_m": 0.0, "reel_tension_n": 1e-9}
    law["reel_sample_s"] = 2.0
    given = {"reel_rate_limit_m_s": 0.1, "reel_longest_m": 10_001.0}
    live = simulation(setup_in(tmp_path, law, RUN | given, spin_rate_ratio=-29.0))
    taken(live, 4)
    assert (rates(live) == 0.1).all()
    live.set_timeout(0.0, Limits(0.2, 1.0, 10_001.0))
    live.take()
    assert (rates(live) == 0.2).all()
    taken(live, 4)
    assert (live.acting.reel[:, 1] == 10_001.0).all() and not rates(live).any()
    words = ["three_star", "--turns=1", f"--output={tmp_path}/bag", "--reel-shortest-m=0.1"]
    with pytest.raises(SystemExit):
        straight.parse(words)
    pulls = {**law, "reel_tension_n": 1e9}
    live = simulation(setup_in(tmp_path, pulls, RUN | {"reel_rate_limit_m_s": 0.0}))
    taken(live, 2)
    assert (rates(live) == -1000.0).all(), "no command is faster"


@pytest.mark.parametrize("change, said", [
    ({"reel_damping_n_s_per_m": -1.0}, "reel_damping_n_s_per_m must be at least 0, got -1"),
    ({"reel_stiffness_n_per_m": "much"}, "reel_stiffness_n_per_m must be a number, got 'much'"),
    ({"reel_mass_kg": 0.0}, "reel_mass_kg must be at least 0.001, got 0"),
    ({"reel_sample_s": 0.0}, "reel_sample_s must be greater than 0, got 0"),
    ({"reel_sample_s": "often"}, "reel_sample_s must be a number, got 'often'"),
    ({"reels": {"all": {"time_s": [0, 1], "length_m": [10e3, 9e3]}}},
     "reels are given and reel_damping_n_s_per_m lets reels follow tension; allowed: profiles"),
    ({"shape_keeping_n_per_m": 0.001}, "shape_keeping_n_per_m keeps one shape"),
    ({"reel_sample_s": 5.0},
     "reel_sample_s is 5 s; allowed: whole multiples of publish_period_s, 2 s, as 4 or 6"),
    ({"reel_sample_s": 0.5}, "publish_period_s, 2 s, as 2"),
    ({"reel_damping_n_s_per_m": 0.0},
     "reel_sample_s is 2 s, but there is no law to sample; allowed: with reel_damping_n_s_per_m"),
    ({"reel_sample_s": None, "deployed_m": 5e3},
     "deployed_m is given and reel_damping_n_s_per_m lets reels follow tension; allowed: the whole"
     " length, or reel_sample_s"),
    ({"reel_sample_s": None, "failures": [{"at_s": 1.0, "dead": "tether_1"}]},
     "actuator is 'tether_1', a reel that follows tension all the time"),
])  # fmt: skip
def test_what_is_wrong_is_named(tmp_path, change, said):
    with pytest.raises(TssError) as caught:
        setup_in(tmp_path, {k: v for k, v in {**LAW, **change}.items() if v is not None})
    assert said in str(caught.value)


def test_a_law_that_is_sampled_aims_at_the_tension_of_the_one_that_acts_all_the_time(tmp_path):
    """Not at the tension of the start, which the gravity gradient stretches: lengths stay."""
    run = RUN | {"disturbance_m": 0.0, "publish_period_s": 4.0}
    live = simulation(setup_in(tmp_path, {**LAW, "reel_sample_s": 4.0}, run))
    rests = np.array([s.alone.rest_length_m[0] for s in taken(live, 1200)])
    turn = round(live.setup.turn_s / 4.0)
    assert abs(rests[-turn:].mean() - 1e4) < 0.02
    assert np.ptp(rests[-turn:]) > 0.2


def test_a_multiple_of_a_period_with_digits_is_one(tmp_path):
    law = {**LAW, "reel_sample_s": 0.3}
    assert setup_in(tmp_path, law, RUN | {"publish_period_s": 0.1}).reels.every == 3
    assert scenario.load(scenario_file(tmp_path)).reels.sample_s == 2.0
    with pytest.raises(
        TssError, match="has reels that move or are out in part; allowed: reels at rest"
    ):
        ensemble(scenario_file(tmp_path), (-3.0, -2.9, 2), [1.0], (0, 1), 1)


def test_a_law_that_acts_all_the_time_is_part_of_the_motion(tmp_path):
    """Live, straight, out of a snapshot and in the core: the same motion, rest lengths included."""
    setup = setup_in(tmp_path, ALWAYS, failures=[{"at_s": 151.0, "cut": "tether_2"}])
    live = simulation(setup, 0.1)
    samples = taken(live, 60)
    live.save(str(tmp_path / "mid.npz"))
    samples += taken(live, 49)
    straight.simulate(setup, 0.1, tmp_path / "bag")
    bag = read_bag(tmp_path / "bag")
    assert np.array_equal(bag.position_m, motion(samples)[0])
    rests = np.array([s.alone.rest_length_m[0] for s in samples])
    assert np.array_equal(bag.rests_m, rests)
    assert np.ptp(rests[:, 0]) > 0.05 and not rests[76:, 1].any() and rests[75, 1]
    other = simulation(setup, 0.1)
    other.restore(str(tmp_path / "mid.npz"))
    assert same(taken(other, 50)[1:], samples[60:])
    whole = core.simulate(
        setup.system, -2.9, turns=0.1, period_s=2.0, state=setup.start,
        failures=setup.failures,
    )  # fmt: skip
    assert np.array_equal(whole.position_m, bag.position_m)
    assert np.array_equal(whole.rests_m, rests)
    assert whole.state(30).reel_length_m.tolist() == rests[30].tolist()


def test_a_law_that_acts_all_the_time_bears_pushes_but_no_commands(tmp_path):
    live = simulation(setup_in(tmp_path, ALWAYS, RUN | {"publish_period_s": 0.01}))
    taken(live, 100)
    before = live.newest.alone
    live.disturb(0.01, 0.0)
    after = live.newest.alone
    assert np.array_equal(after.rest_length_m, before.rest_length_m)
    assert np.array_equal(after.rest_rate_m_s, before.rest_rate_m_s)
    speeds, accelerations = [], []
    for _ in range(4):
        speeds.append(live.take().velocity_m_s)
        accelerations.append(live.acceleration_m_s2)
    expected = (speeds[3] - speeds[1]) / 0.02
    np.testing.assert_allclose(accelerations[2], expected, atol=1e-6)
    live.commands.post(ReelCommand(live.newest.time_ns + S, 1, RATE, ((0.0, 0.0, -0.25),)))
    with pytest.raises(TssError, match="reel_damping_n_s_per_m moves the reels"):
        live.take()
