"""A simulated motion: the states of the propagator, what follows from them, tables of them."""

import dataclasses
import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tss_ros import core
from tss_ros.bags.commands import tables
from tss_ros.bags.recording import read_bag
from tss_ros.scenarios import scenario
from tss_ros.simulator.setup import Setup
from tss_ros.simulator.straight import simulate

RING = core.ring()


def test_states_are_those_of_the_propagator():
    motion = core.simulate(RING, -2.2, turns=1.5, disturbance_m=10.0, seed=3, period_s=50.0)
    still = core.initial_state(RING, -2.2)
    propagator = core.Propagator(RING, -2.2, core.disturbed(still, 10.0, 3))
    position_m, velocity_m_s = propagator.sample(motion.t_s)
    np.testing.assert_array_equal(motion.position_m, position_m)
    np.testing.assert_array_equal(motion.velocity_m_s, velocity_m_s)
    length_m, tension_n, taut = core.tether_state(RING, position_m, velocity_m_s)
    np.testing.assert_array_equal(motion.length_m, length_m)
    np.testing.assert_array_equal(motion.tension_n, tension_n)
    np.testing.assert_array_equal(motion.taut, taut)
    radius_m = np.linalg.norm(still.position_m, axis=1)
    np.testing.assert_array_equal(motion.deviation, core.deviation(position_m, radius_m))
    assert motion.switches == propagator.switches > 0
    assert np.all(np.diff(motion.t_s) == 50.0) and motion.t_s[0] == 0.0
    assert 1.5 * propagator.period_s - 50.0 < motion.t_s[-1] <= 1.5 * propagator.period_s


def test_whole_turns_end_with_a_state():
    for ratio, turns in ((-2.5, 8.0), (-2.2, 3.0), (3.7, 0.1)):
        motion = core.simulate(RING, ratio, turns=turns)
        assert len(motion) == round(100 * turns) + 1
        assert motion.turns[-1] == pytest.approx(turns, rel=1e-14)


def test_an_undisturbed_ring_stands_still_in_the_frame_that_turns():
    motion = core.simulate(core.ring(linear_gravity=True), 50.0, turns=1.0)
    moved = np.linalg.norm(motion.turning_m - motion.turning_m[0], axis=-1).max()
    assert moved < 1e-2 * motion.reference_radius_m.min()
    np.testing.assert_array_equal(motion.turning_m[0], motion.position_m[0])


def turning(axis, ratio):
    """A stiff ring about an axis, whatever the forces: turned by SciPy, not by the package."""
    unit = np.array(axis) / np.linalg.norm(axis)
    motion = core.simulate(RING, ratio, turns=2.0)
    angle = 2.0 * np.pi * np.sign(ratio) * motion.turns
    place_m = [Rotation.from_rotvec(x * unit).apply(motion.position_m[0]) for x in angle]
    system = dataclasses.replace(RING, spin_axis=unit)
    return dataclasses.replace(motion, system=system, position_m=np.array(place_m))


@pytest.mark.parametrize(("axis", "ratio"), [((0, 1, 1), 3.0), ((0.3, -2, 0.5), -2.5)])
def test_a_stiff_ring_about_any_axis_stands_still_in_the_frame_that_turns(axis, ratio):
    motion = turning(axis, ratio)
    np.testing.assert_allclose(motion.turning_m - motion.position_m[0], 0.0, atol=1e-8)
    assert np.ptp(motion.position_m, axis=0).max() > 1e3
    np.testing.assert_array_equal(motion.spins_about, motion.system.spin_axis)


def test_a_chain_that_hangs_is_counted_in_orbits_and_its_frame_is_the_orbit_frame():
    system = scenario.load("vertical_chain_2").build()
    motion = core.simulate(system, 0.0, turns=0.5, disturbance_m=10.0)
    assert motion.turning_m.tolist() == motion.position_m.tolist()
    assert motion.spins_about is None
    assert motion.turns[-1] == pytest.approx(motion.t_s[-1] * system.orbit_rate_rad_s / 2 / np.pi)
    assert "0.5 orbits" in repr(motion) and "turn" not in repr(motion)
    for figure in ("deviation", "tethers", "balance"):
        assert motion.plot(figure).axes[-1].get_xlabel() == "orbits [-]"


def test_an_undamped_motion_keeps_its_energy():
    motion = core.simulate(core.ring(damping_n_s_per_m=0.0), -2.2, turns=2.0, disturbance_m=50.0)
    energy = motion.energy_j
    assert np.ptp(energy) < 1e-6 * np.abs(energy).max()


def test_it_goes_on_from_its_last_state():
    first = core.simulate(RING, -2.5, turns=1.0, disturbance_m=10.0)
    again = core.simulate(RING, -2.5, turns=1.0, state=first.state(0))
    np.testing.assert_array_equal(again.position_m, first.position_m)
    assert first.state().position_m.tolist() == first.position_m[-1].tolist()


def test_its_tables_are_those_of_a_recording_of_it(small_bag):
    recording = small_bag
    exported = tables(recording)
    for name in ("beads", "tethers"):
        expected = exported[name].to_pandas()
        found = recording.to_pandas(name)
        assert list(found.columns) == list(expected.columns)
        for column in expected:
            assert (found[column].to_numpy() == expected[column].to_numpy()).all()


@pytest.fixture
def small_bag(tmp_path):
    """A recording of a simulated run."""
    options = {
        "scenario": "three_star", "publish_period_s": 50.0, "disturbance_m": 10.0,
        "disturbance_seed": 3,
    }  # fmt: skip
    system = scenario.load("three_star").build()
    simulate(Setup.of(options, system, -2.2), 1.5, tmp_path / "bag")
    return read_bag(tmp_path / "bag")


def test_it_is_what_the_nodes_would_record(small_bag):
    system = scenario.load("three_star").build()
    motion = core.simulate(system, -2.2, turns=1.5, disturbance_m=10.0, seed=3, period_s=50.0)
    for name in (
        "t_s", "turns", "position_m", "velocity_m_s", "deviation", "length_m", "tension_n", "taut",
        "deviation_from_centre", "energy_j", "centre_of_mass_m", "step",
    ):  # fmt: skip
        np.testing.assert_array_equal(getattr(motion, name), getattr(small_bag, name))
    assert repr(small_bag) == repr(motion).replace("Trajectory", "Recording")
    for figure in ("trajectories", "deviation", "tethers", "balance"):
        assert small_bag.plot(figure).get_suptitle() == motion.plot(figure).get_suptitle()


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"turns": 0.0}, "turns must be greater than 0, got 0"),
        ({"turns": math.inf}, "turns must be a finite number, got inf"),
        ({"period_s": -1.0}, "period_s must be greater than 0, got -1"),
        ({"period_s": 1e-9}, "states 1e-09 s apart; allowed: at most 16666666"),
        ({"disturbance_m": -1.0}, "disturbance_m must be at least 0, got -1"),
        ({"integrator": "euler"}, "integrator must be one of radau, taylor, auto, got 'euler'"),
    ],
)
def test_values_that_are_not_allowed_are_named(given, words):
    with pytest.raises(core.TssError, match=words):
        core.simulate(RING, -2.5, **given)


def test_figures_and_tables_that_there_are_not_are_named():
    motion = core.simulate(RING, -2.5, turns=0.1)
    with pytest.raises(core.TssError, match="figure must be one of traj.*, got 'energy'"):
        motion.plot("energy")
    with pytest.raises(core.TssError, match="table must be one of beads, tethers, got 'bead'"):
        motion.to_pandas("bead")
