"""Reels that follow tension: their multipliers, variations through switches, and energy."""

from collections import Counter

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tss_ros import core
from tss_ros.core import Commands, IntegrationError, Propagator, State, TssError
from tss_ros.core.model.laws.reel import REEL_DAMPING, REEL_MASS, REEL_STIFFNESS, REEL_TENSION
from tss_ros.core.model.orbits import ReferenceOrbit
from tss_ros.core.model.reel_law import pull_per_metre, reel_tension_n
from tss_ros.core.model.system import MU_EARTH
from tss_ros.core.motion.displacements import carry_displacements
from tss_ros.core.motion.integrator import Integrator
from tss_ros.core.stability.harmonic_balance import close_by_harmonic_balance
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
    family = core.follow(damped, "reel_damping_n_s_per_m", 1000.0, 3000.0, spin_rate_ratio=-2.9)
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


def test_leading_multipliers_are_refused():
    with pytest.raises(TssError, match="all multipliers of reels that follow tension are found or"):
        core.compute_floquet(STAR, -2.9, leading=4)
    with pytest.raises(TssError, match="of 101 beads the leading 12 would be; allowed: at most"):
        core.compute_floquet(core.ring(101, tether_length_m=1000.0, **LAW), -6.0)


def test_harmonic_balance_refuses_reels_that_it_does_not_know():
    integrator = Integrator(STAR, STAR.spin_rate_rad_s(-2.9), 1e-9, 1e4)
    with pytest.raises(IntegrationError, match="knows no reels"):
        close_by_harmonic_balance(integrator, core.initial_state(STAR, -2.9))


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


def test_soft_reels_are_softened_where_they_hold():
    """At -2.9 they hold; no family connects that with fast spin, where a longer tether pulls more.

    What decays slowest are the rest lengths themselves, as exp(-(k - T/L) t / c).
    """
    soft = {"damping_n_s_per_m": 20.0, "reel_stiffness_n_per_m": 5e-4}
    system = core.ring(**LAW | soft)
    pull = pull_per_metre(system, -2.9)
    assert pull == pytest.approx(reel_tension_n(system, -2.9)[0] / 1e4, rel=1e-12)
    assert pull < 5e-4 < pull_per_metre(system, -10.0)
    found = core.compute_floquet(system, -2.9, certify=False)
    assert found.verdict == "asymptotically stable" and "softened there from" in found.message
    decay = np.exp(-(5e-4 - pull) / 1000.0 * found.period_s)
    assert found.deciding_modulus == pytest.approx(decay, rel=3e-5)
    stiffer = core.ring(**LAW | soft | {"reel_stiffness_n_per_m": 0.004})
    family = core.follow(
        stiffer, "reel_stiffness_n_per_m", 0.004, 5e-4, spin_rate_ratio=-2.9, longest_step=0.2
    )
    there = family.points[-1]
    assert there.parameter == 5e-4 and there.verdict == found.verdict
    assert there.deciding_modulus == pytest.approx(found.deciding_modulus, rel=1e-6)
    np.testing.assert_allclose(there.state.reel_length_m, found.state.reel_length_m, atol=1e-3)


def test_a_boundary_within_errors_is_told_so():
    """The reels hold below 4.82 in size; growth beyond is so slow that it is told later only."""
    system = core.ring(**LAW | {"reel_stiffness_n_per_m": 5e-4, "damping_n_s_per_m": 1450.0})
    (critical,) = core.find_critical_rates(system, -5.6, -4.6, 0.02, 0.2)
    assert critical.cause == "shape" and critical.spin_rate_ratio < -4.9
    assert "stability may end on the stable side already: |rho| is 1.000" in critical.resonance


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


# --- hanging, on ellipses, about other axes


def pair(**more):
    """Two satellites on a reel of 3 kg that draws back with 0.002 N/m."""
    law = {"reel_damping_n_s_per_m": 10.0, "reel_stiffness_n_per_m": 0.002, "reel_mass_kg": 3.0}
    tether = {"tether_length_m": [1000.0], "axial_stiffness_n": 5e4, "damping_n_s_per_m": 5.0}
    return core.formation(
        "chain", 2, satellite_mass_kg=[100.0, 50.0], **(tether | law | more)
    )  # fmt: skip


def closed_form(system):
    """Exponents over Omega of a hanging pair in its plane: stretch, angle and rest length.

    l'' - 2 Omega l theta' - 3 Omega^2 l = -T / mu and theta'' + 2 Omega l' / l + 3 Omega^2 theta =
    0 with m L'' = T - T_0 - c L' - k (L - L_0) and T = EA (l - L) / L + C (l' - L').
    """
    orbit, values, (mass, other) = system.orbit_rate_rad_s, system.law_parameters, system.mass_kg
    mu, m = mass * other / (mass + other), values["reel_mass_kg"]
    c, k = values["reel_damping_n_s_per_m"], values["reel_stiffness_n_per_m"]
    [ea], [damping] = system.axial_stiffness_n, system.damping_n_s_per_m
    [rest], gradient = system.rest_length_m, 3.0 * orbit**2
    length = ea / (ea / rest - gradient * mu)
    by_l, by_rest = ea / rest, -ea * length / rest**2
    a = np.zeros((6, 6))
    a[:3, 3:] = np.eye(3)
    a[3] = [gradient - by_l / mu, 0, -by_rest / mu, -damping / mu, 2 * orbit * length, damping / mu]
    a[4] = [0, -gradient, 0, -2 * orbit / length, 0, 0]
    a[5] = [by_l / m, 0, (by_rest - k) / m, damping / m, 0, -(c + damping) / m]
    return np.linalg.eigvals(a) / orbit


@pytest.mark.parametrize("change", [
    {}, {"damping_n_s_per_m": 0.0, "reel_damping_n_s_per_m": 3000.0},
    {"reel_damping_n_s_per_m": 1.0, "reel_stiffness_n_per_m": 3e-4, "reel_mass_kg": 1.0},
])  # fmt: skip
def test_a_reel_damps_the_libration_of_a_hanging_pair_in_the_plane_alone(change):
    system = pair(linear_gravity=True, **change)
    found = core.compute_floquet(system, 0.0)
    exponent, family = found.exponent / system.orbit_rate_rad_s, np.array(found.family)
    for wanted in closed_form(system):
        assert np.min(np.abs(exponent / wanted - 1.0)) < 1e-6, wanted
    assert Counter(family) == {"centre of mass": 6, "libration": 4, "shape": 4}
    librations = exponent[family == "libration"]
    across = np.abs(np.abs(librations.imag) - 2.0) < 1e-6
    assert np.count_nonzero(across) == 2 and np.max(np.abs(librations[across].real)) < 1e-9
    assert np.all(librations[~across].real < -1e-5)
    assert max(found.segment_error, found.closure_residual) < 1e-7 and found.liouville_error < 1e-7


def test_a_hanging_reel_runs_away_where_gravity_grows_faster_than_it_draws_back():
    limit = reel_tension_n(pair(linear_gravity=True), 0.0)[0] / 1000.0
    verdicts = [
        core.compute_floquet(pair(linear_gravity=True, reel_stiffness_n_per_m=k * limit), 0.0)
        for k in (0.98, 1.02)
    ]
    assert [found.verdict for found in verdicts] == ["unstable", "asymptotically stable"]


def test_a_reel_must_hold_the_tension_of_what_hangs():
    found = core.compute_floquet(pair(reel_tension_n=0.2), 0.0)
    assert found.verdict == "none found"
    assert "the reel of tether_1 holds reel_tension_n 0.2 N, where it would hang" in found.message
    rest = core.initial_state(pair(), 0.0)
    moved = State(rest.position_m, rest.velocity_m_s, reel_length_m=[999.0], reel_rate_m_s=[0.0])
    found = core.compute_floquet(pair(), 0.0, state=moved, correct=False)
    assert "its reels have paid out up to 1 m" in found.message


def test_on_an_ellipse_beads_and_reels_move_as_among_the_stars():
    """Against another program: masses, tether and reel in inertial axes."""
    system, end = pair(eccentricity=0.1), 2000.0
    start, orbit = core.disturbed(core.initial_state(system, 0.0), 5.0, 1), ReferenceOrbit(system)
    [aim_n], [ea], [damping] = reel_tension_n(system, 0.0), system.axial_stiffness_n, [5.0]

    def rates(_, y):
        place, velocity, (length, rate) = y[:6].reshape(2, 3), y[6:12].reshape(2, 3), y[12:]
        apart = place[1] - place[0]
        distance = np.linalg.norm(apart)
        along = apart / distance
        growth = (velocity[1] - velocity[0]) @ along
        tension = ea * (distance - length) / length + damping * (growth - rate)
        tension *= distance > length
        a = -MU_EARTH * place / np.linalg.norm(place, axis=1)[:, None] ** 3
        a += tension * np.array([along, -along]) / system.mass_kg[:, None]
        pull = tension - aim_n - 10.0 * rate - 0.002 * (length - 1000.0)
        return np.concatenate([velocity.ravel(), a.ravel(), [rate, pull / 3.0]])

    centre, speed = orbit.state(np.zeros(1))
    turning = orbit.frame(np.zeros(1))[1]
    velocity = start.velocity_m_s + np.cross(turning, start.position_m) + speed
    begin = np.concatenate([(start.position_m + centre).ravel(), velocity.ravel(), [1000.0, 0.0]])
    y = solve_ivp(rates, (0.0, end), begin, "DOP853", rtol=1e-12, atol=1e-8).y[:, -1]
    axes, _ = orbit.frame(np.array([end]))
    place = (y[:6].reshape(2, 3) - orbit.state(np.array([end]))[0]) @ axes[0].T
    motion = Propagator(system, 0.0, start, rtol=1e-12)
    position, _ = motion.sample(np.array([end]))
    np.testing.assert_allclose(position[0], place, rtol=0.0, atol=1e-6)
    assert motion.rests[0][0, 0] == pytest.approx(y[12], abs=1e-7)
    assert abs(y[12] - 1000.0) > 1.0


def test_a_reel_damps_a_pair_that_hangs_on_an_ellipse():
    system = pair(eccentricity=0.05)
    found = core.compute_floquet(system, 0.0)
    family = np.array(found.family)
    assert found.verdict == "asymptotically stable" and len(family) == 6 * 2 + 2
    assert max(found.segment_error, found.convergence_error, found.liouville_error) < 1e-8
    assert found.closure_residual < 1e-9 and found.state.reel_length_m.shape == (1,)
    swings = np.sort(np.abs(found.multiplier[family == "libration"]))
    assert swings[2] == pytest.approx(1.0, abs=1e-6) and swings[1] < 0.97
    # A swing next to the motion comes to what its multiplier says.
    mode = int(np.flatnonzero((family == "libration") & (np.abs(found.multiplier) < 0.97))[0])
    integrator = Integrator(system, 0.0, 1e-11, 700.0)
    integrator.period_s = found.period_s
    x = to_scaled(integrator, found.state)
    pushed = x + 1e-4 * found.vectors[:, mode].real
    ends = [
        carried_motion(integrator, from_scaled(integrator, begin), found.period_s)
        for begin in (pushed, x)
    ]
    after = np.subtract(*(integrator.scaled(end.v, end.r) for end in ends)) / 1e-4
    wanted = (found.multiplier[mode] * found.vectors[:, mode]).real
    assert np.linalg.norm(after - wanted) < 1e-3 * np.linalg.norm(wanted)


@pytest.mark.parametrize("eccentricity", [0.01, 0.05])
def test_reels_hold_a_star_that_turns_with_its_ellipse(eccentricity):
    system = core.ring(damping_n_s_per_m=0.0, eccentricity=eccentricity, **LAW)
    found = core.compute_floquet(system, -3.0, certify=False)
    assert found.verdict == "asymptotically stable" and found.closure_residual < 1e-9
    circle = core.compute_floquet(STAR, -3.0, certify=False)
    slowest, per_turn = (
        np.max(np.abs(one.multiplier[np.array(one.family) == "shape"])) for one in (found, circle)
    )
    # Three turns of the circle are one orbit.
    assert slowest == pytest.approx(per_turn**3, rel=10.0 * eccentricity)


def test_reels_follow_tension_about_a_conical_axis():
    rigid = {"axial_stiffness_n": 5e5, "damping_n_s_per_m": 100.0, "bilateral": True}
    system = core.ring(
        tether_length_m=1000.0, spin_axis=(0.0, 0.5, 0.9), linear_gravity=True, **rigid, **LAW
    )
    found = core.compute_floquet(system, -1.8)
    assert "conical axis" in found.message and found.verdict == "asymptotically stable"
    assert found.closure_residual < 1e-9 and len(found.multiplier) == 6 * 3 + 2 * 3
    assert max(found.segment_error, found.convergence_error, found.liouville_error) < 1e-8
    # What a reel adds comes back with k / c, as about any axis.
    modulus = np.abs(found.multiplier)
    slowest = np.exp(-1.0 / 1000.0 * found.period_s)
    assert np.count_nonzero(np.abs(modulus / slowest - 1.0) < 0.02) == 3
