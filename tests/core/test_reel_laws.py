"""Reels that follow tension: their multipliers, variations through switches, and energy."""

import numpy as np
import pytest

from tss_ros import core
from tss_ros.core import Commands, Propagator, State, TssError
from tss_ros.core.model.laws.reel import REEL_DAMPING, REEL_MASS, REEL_STIFFNESS, REEL_TENSION
from tss_ros.core.model.reel_law import reel_tension_n
from tss_ros.core.motion.displacements import carry_displacements
from tss_ros.core.motion.integrator import Integrator
from tss_ros.core.stability.shooting import carried_motion, from_scaled, to_scaled

LAW = {"reel_damping_n_s_per_m": 1000.0}
STAR = core.ring(damping_n_s_per_m=0.0, **LAW)
SHAKEN = {"damping_n_s_per_m": 50.0, "reel_damping_n_s_per_m": 300.0, "reel_mass_kg": 30.0}


def largest(result, out_of_plane):
    """Largest modulus of the shape's multipliers in the orbit plane or out of it."""
    out = np.any(result.vectors[2::3] != 0.0, axis=0) == out_of_plane
    return np.max(np.abs(result.multiplier[out & (np.array(result.family) == "shape")]))


def test_a_reel_that_hardly_moves_is_a_fixed_tether():
    fixed = core.compute_floquet(core.ring(damping_n_s_per_m=0.0), -2.9)
    law = {"reel_damping_n_s_per_m": 1e10, "reel_stiffness_n_per_m": 1e3}
    found = core.compute_floquet(core.ring(damping_n_s_per_m=0.0, **law), -2.9, certify=False)
    for rho in fixed.multiplier[np.abs(fixed.multiplier - 1.0) > 1e-2]:
        assert np.min(np.abs(found.multiplier - rho)) < 1e-4
    # What a reel adds: its rest length comes back with k / c, its rate is lost at once.
    rest = np.exp(-1e3 / 1e10 * found.period_s)
    assert np.count_nonzero(np.abs(found.multiplier - rest) < 1e-4) >= 3
    assert np.count_nonzero(np.abs(found.multiplier) < 1e-12) == 3


def test_reels_damp_what_stretches_and_nothing_out_of_the_plane():
    """Out of the plane tethers are not stretched to first order: mirror images pull alike."""
    pentagon = core.ring(satellites=5, damping_n_s_per_m=0.0, **LAW)
    found = core.compute_floquet(pentagon, -4.5)
    assert found.closure_residual < 1e-8 and len(found.multiplier) == 6 * 5 + 2 * 5
    assert largest(found, False) == pytest.approx(0.999284, abs=1e-5)
    assert largest(found, True) == pytest.approx(1.0, abs=1e-6)
    assert found.verdict == "neutral"


def test_reels_make_an_undamped_star_asymptotically_stable():
    fixed = core.ring(damping_n_s_per_m=0.0)
    assert core.compute_floquet(fixed, -2.9, certify=False).verdict == "neutral"
    found = core.compute_floquet(STAR, -2.9)
    assert found.verdict == "asymptotically stable"
    assert np.max(np.abs(found.multiplier[np.array(found.family) == "shape"])) == pytest.approx(
        0.113645, abs=1e-5
    )
    # Liouville's formula with the reels' own damping, the turn cut in pieces, a finer integration.
    assert max(found.segment_error, found.convergence_error, found.liouville_error) < 1e-8
    assert found.state.reel_length_m.shape == (3,)
    again = core.compute_floquet(STAR, -2.9, state=found.state, certify=False)
    apart = np.abs(again.multiplier[:, None] - found.multiplier[12:])
    assert np.max(np.min(apart, axis=0)) < 1e-7


@pytest.mark.parametrize("ratio, apart_m, time_s, more", [
    (-2.9, 5.0, 300.0, {"rotation_damping_n_s_per_m": 20.0}),
    (-1.2, 40.0, 600.0, {"beads_per_tether": 1}),
    (-1.2, 40.0, 900.0, {"tether_law": "tension_only"}),
    (-2.2, 40.0, 900.0, {"tether_law": "stiffening"}),
])  # fmt: skip
def test_variations_through_switches_are_those_of_differences(ratio, apart_m, time_s, more):
    system = core.ring(**SHAKEN, **more)
    start = core.disturbed(core.initial_state(system, ratio), apart_m, 3)
    size = float(np.max(np.linalg.norm(start.position_m, axis=1)))
    integrator = Integrator(system, system.spin_rate_rad_s(ratio), 1e-12, size)
    x = to_scaled(integrator, start)
    motion, matrix = carry_displacements(
        integrator, integrator.begin(start), np.eye(x.size), time_s
    )
    assert motion.switches >= 3
    for column in np.flatnonzero(integrator.real):
        ends = []
        for sign in (1.0, -1.0):
            beside = x.copy()
            beside[column] += sign * 1e-6
            end = carried_motion(integrator, from_scaled(integrator, beside), time_s)
            assert end.switches == motion.switches
            ends.append(integrator.scaled(end.v, end.r))
        expected = (ends[0] - ends[1])[integrator.real] / 2e-6
        scale = max(1.0, np.max(np.abs(expected)))
        found = matrix[integrator.real, column]
        np.testing.assert_allclose(found, expected, atol=1e-5 * scale)


def test_what_the_energy_loses_is_what_brakes_take():
    """Of tethers without damping: c L'^2 of each reel, nothing else."""
    law = {"reel_stiffness_n_per_m": 3.0, "reel_tension_n": 2.5, "reel_mass_kg": 40.0}
    system = core.ring(damping_n_s_per_m=0.0, reel_damping_n_s_per_m=200.0, **law)
    found = core.simulate(system, -2.9, turns=0.3, disturbance_m=5.0, seed=1, period_s=0.05)
    out, rate = found.rests_m - 1e4, found.rest_rates_m_s
    reels = np.sum(0.5 * 40.0 * rate**2 + 0.5 * 3.0 * out**2 + 2.5 * out, axis=1)
    energy = found.energy_j + reels
    power = np.sum(200.0 * rate**2, axis=1)
    taken = np.append(0.0, np.cumsum(0.5 * (power[1:] + power[:-1]) * np.diff(found.t_s)))
    assert taken[-1] > 1.0
    np.testing.assert_allclose(energy[0] - energy, taken, atol=2e-4 * taken[-1])


def test_commands_at_short_intervals_come_to_the_law():
    end_s, names = 60.0, [reel.name for reel in core.model.reels.reels(STAR)]
    start = core.disturbed(core.initial_state(STAR, -2.9), 0.05, 2)
    lawful = Propagator(STAR, -2.9, start)
    expected = lawful.sample(np.linspace(0.0, end_s, 61))[0][-1]
    fixed, aim_n = core.ring(damping_n_s_per_m=0.0), reel_tension_n(STAR, -2.9)
    missed = []
    for count in (120, 480):
        edges, rest = np.linspace(0.0, end_s, count + 1), np.full(3, 1e4)
        plan = [(0.0, Commands.of(fixed, reel={n: (0.0, a) for n, a in zip(names, rest)}))]
        motion = Propagator(fixed, -2.9, start, plan=plan)
        for begin, end in zip(edges, edges[1:]):
            position_m, velocity_m_s = motion.sample(np.array([begin]))
            rests = rest[None], np.zeros((1, 3))
            tension = core.tether_state(fixed, position_m, velocity_m_s, rests)[1][0]
            rate = (tension - aim_n - (rest - 10e3)) / 1000.0
            reel = {name: (begin, a, b) for name, a, b in zip(names, rest, rate)}
            motion.command([(begin, Commands.of(fixed, reel=reel))])
            rest = rest + rate * (end - begin)
        missed.append(np.max(np.abs(motion.sample(np.array([end_s]))[0][0] - expected)))
    assert missed[1] < 0.35 * missed[0]
    assert missed[1] < 2e-3


def test_families_critical_rates_and_modes_are_those_of_the_loop():
    damped = core.ring(damping_n_s_per_m=20.0, **LAW)
    family = core.follow(
        damped, "reel_damping_n_s_per_m", 1000.0, 3000.0, spin_rate_ratio=-2.9
    )
    assert len(family.points) > 3 and family.points[-1].parameter == pytest.approx(3000.0)
    here = core.compute_floquet(damped, -2.9, certify=False)
    first = family.points[0]
    assert first.verdict == here.verdict
    modes = core.compute_modes(damped, here)
    assert len(modes) == len(here.multiplier) == 24
    swings = [m for m in modes if m.family == "shape" and m.direction == "in plane"]
    assert len(swings) == 12
    motion = core.mode_motion(damped, here, 0, 8)
    assert motion.shape.shape == (9, 3, 3) and np.isfinite(motion.shape).all()


@pytest.mark.parametrize("change, words", [
    ({"shape": "chain", "ratio": 0.0}, "spins about the orbit normal, but spin_rate_ratio is 0"),
    ({"spin_axis": [0.0, 1.0, 0.0]}, "spins about the orbit normal"),
    ({"eccentricity": 0.1}, r"a reel that follows tension .* needs forces that rest"),
    ({"leading": 4}, "all multipliers of reels that follow tension are found or none"),
])  # fmt: skip
def test_what_cannot_be_asked_is_refused(change, words):
    change = {"shape": "ring", "ratio": -2.9, "leading": None} | change
    ratio, leading = change.pop("ratio"), change.pop("leading")
    with pytest.raises(TssError, match=words):
        core.compute_floquet(core.formation(**LAW, **change), ratio, leading=leading)


def test_states_have_the_rest_lengths_of_their_system():
    start = core.initial_state(STAR, -2.9)
    wrong = State(start.position_m, start.velocity_m_s, reel_length_m=[1e4], reel_rate_m_s=[0.0])
    with pytest.raises(TssError, match="has 3 rest lengths of reels that follow tension, got 1"):
        Propagator(STAR, -2.9, wrong)
    with pytest.raises(TssError, match="a number each for every reel"):
        State(start.position_m, start.velocity_m_s, reel_length_m=[1e4])
    with pytest.raises(TssError, match="reel_damping_n_s_per_m moves the reels, but a command"):
        slower = Commands.of(STAR, reel={"tether_1": (0.0, 9e3)})
        Propagator(STAR, -2.9, start, plan=[(0.0, slower)])
    own = {p.name for p in (REEL_DAMPING, REEL_MASS, REEL_STIFFNESS, REEL_TENSION)}
    assert own <= set(core.PARAMETERS)


def test_each_reel_holds_its_own_steady_tension():
    """Spokes and rim of a hub pull unlike: nothing is paid out in the steady turn even so."""
    lengths = [10e3] * 6 + [10.0001e3] * 6
    hub = core.formation(
        "closed_hub_and_spoke", 6, tether_length_m=lengths, damping_n_s_per_m=100.0, **LAW
    )
    aim_n = reel_tension_n(hub, -6.0)
    assert np.ptp(aim_n) > 0.4
    found = core.compute_floquet(hub, -6.0, certify=False)
    assert found.closure_residual < 1e-8 and found.verdict != "none found"
    assert np.max(np.abs(found.state.reel_length_m - hub.rest_length_m)) < 1.0
    given = core.ring(reel_tension_n=2.5, **LAW)
    assert reel_tension_n(given, -2.9).tolist() == [2.5] * 3


def test_reels_run_away_where_a_longer_tether_pulls_harder_than_they_draw_back():
    """In a turn T grows with L like T / L: a spring k of the reels below that does not hold."""
    system = core.ring(damping_n_s_per_m=20.0, **LAW)
    limit = reel_tension_n(system, -2.9)[0] / 1e4
    family = core.follow(
        system, "reel_stiffness_n_per_m", 0.02, 0.0, spin_rate_ratio=-2.9, longest_step=0.05,
        most_points=60,
    )  # fmt: skip
    last = family.points[-1].parameter
    assert family.ended and last == pytest.approx(limit, rel=1e-3)
    below = core.ring(damping_n_s_per_m=20.0, reel_stiffness_n_per_m=0.5 * limit, **LAW)
    found = core.compute_floquet(below, -2.9, certify=False)
    assert "the shape may grow: |rho| is 1.00" in found.message
    growth = np.exp(0.5 * limit / 1000.0 * found.period_s)
    shape = np.abs(found.multiplier[np.array(found.family) == "shape"])
    assert np.max(shape) == pytest.approx(growth, rel=1e-4) and np.max(shape) > 1.0


def test_families_end_with_words_where_a_law_ends():
    system = core.ring(damping_n_s_per_m=20.0, **LAW)
    parameter = "reel_damping_n_s_per_m"
    family = core.follow(system, parameter, 100.0, 0.0, spin_rate_ratio=-2.9)
    assert family.points[-1].parameter < 0.01
    assert "reel_damping_n_s_per_m must be at least 0" in family.ended
    with pytest.raises(TssError, match="reels follow tension only where their law acts"):
        core.follow(system, parameter, 0.0, 100.0, spin_rate_ratio=-2.9)
    damped = core.follow(core.ring(damping_n_s_per_m=20.0), "damping_n_s_per_m", 20.0, 0.0,
                         spin_rate_ratio=-2.9)  # fmt: skip
    assert not damped.ended and damped.points[-1].parameter == 0.0
    assert damped.points[-1].verdict == "neutral"
