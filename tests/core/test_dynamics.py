"""The model against closed forms and conserved quantities, not against its own output."""

import math
from dataclasses import replace

import numpy as np
import pytest
from paper import paper_acceleration
from scipy.integrate import solve_ivp

from tss_ros.core import (
    IntegrationError,
    Propagator,
    State,
    TssError,
    averaged_state,
    deviation,
    disturbed,
    formation,
    initial_state,
    ring,
    tether_state,
)
from tss_ros.core.model import forces
from tss_ros.core.model.kernel_arrays import kernel_arrays
from tss_ros.core.model.system import MU_EARTH
from tss_ros.core.motion import integrate
from tss_ros.core.motion.integrator import Integrator
from tss_ros.scenarios import scenario


def kernel_acceleration(system, position, velocity, spin=0.0, time=0.0):
    a = np.empty_like(position)
    taut = tether_state(system, position, velocity)[2] | system.bilateral
    forces.acceleration(kernel_arrays(system, spin), taut, time, velocity, position, a)
    return a


def random_system(seed, **options):
    rng = np.random.default_rng(seed)
    system = ring(
        satellites=4,
        satellite_mass_kg=rng.uniform(50, 500, 4),
        beads_per_tether=[0, 1, 2, 0],
        bead_mass_kg=rng.uniform(1, 20, 3),
        axial_stiffness_n=rng.uniform(1e4, 1e5, 4),
        damping_n_s_per_m=rng.uniform(0, 2000, 4),
        **options,
    )
    position = np.array(system.layout_m) * 1.01 + rng.normal(0, 30, (system.n, 3))
    return system, position, rng.normal(0, 10, (system.n, 3))


@pytest.mark.parametrize("seed", range(5))
def test_acceleration_is_the_sum_of_the_papers_terms(seed):
    system, position, velocity = random_system(seed)
    ours = kernel_acceleration(system, position, velocity)
    # The printed gravity loses about 8 digits to cancellation: 8 m/s^2 times 1e-16 times a few.
    np.testing.assert_allclose(ours, paper_acceleration(system, position, velocity), atol=2e-14 * 8)


def test_gravity_gradient_does_not_cancel():
    """Against exact rational arithmetic at 1 mm from the centre, where Eq. (2) keeps no digits."""
    from decimal import Decimal, getcontext

    getcontext().prec = 60
    system = ring()
    position = np.zeros((3, 3))
    position[0] = 1e-3, 2e-3, -1e-3
    position[1:, 0] = 1.0, 2.0
    a = kernel_acceleration(system, position, np.zeros((3, 3)))[0]
    radius, mu = Decimal(system.orbit_radius_m), Decimal(MU_EARTH)
    q = [Decimal(c) for c in position[0]]
    q[1] += radius
    cube = sum(c * c for c in q).sqrt() ** 3
    rate2 = mu / radius**3
    exact = [-mu * c / cube for c in q]
    exact[0] += rate2 * q[0]
    exact[1] += rate2 * q[1]
    np.testing.assert_allclose(a, [float(c) for c in exact], rtol=1e-12)


@pytest.mark.parametrize("linear", [False, True])
@pytest.mark.parametrize("seed", range(3))
def test_jacobian_is_the_derivative_of_the_acceleration(seed, linear):
    system, position, velocity = random_system(seed, linear_gravity=linear)
    from tss_ros.core.numerics import block_lu

    symbolic = block_lu.analyse(system.n, system.tether_ends)
    by_r, by_v = np.empty((2, symbolic.row.size, 3, 3))
    taut = tether_state(system, position, velocity)[2]
    arrays, time = kernel_arrays(system, -2.5e-3), 321.0
    forces.jacobian(arrays, symbolic.pair, taut, time, velocity, position, by_r, by_v)
    rng = np.random.default_rng(seed)
    for blocks, h in ((by_r, 1e-2), (by_v, 1e-3)):
        direction = rng.normal(size=(system.n, 3))
        sides = []
        for sign in (1, -1):
            r = position + sign * h * direction * (blocks is by_r)
            v = velocity + sign * h * direction * (blocks is by_v)
            a = np.empty_like(r)
            forces.acceleration(arrays, taut, time, v, r, a)
            sides.append(a)
        expected = np.zeros((system.n, 3))
        for block, i, j in zip(blocks, symbolic.row, symbolic.column):
            expected[i] += block @ direction[j]
        difference = (sides[0] - sides[1]) / (2 * h)
        np.testing.assert_allclose(difference, expected, atol=1e-7 * np.abs(expected).max())


@pytest.mark.parametrize("seed", range(3))
def test_internal_forces_change_neither_momentum_nor_angular_momentum(seed):
    system, position, velocity = random_system(seed)
    free = replace(system, axial_stiffness_n=system.axial_stiffness_n * 1e-12,
                   damping_n_s_per_m=system.damping_n_s_per_m * 0.0)
    tethers = kernel_acceleration(system, position, velocity) - kernel_acceleration(
        free, position, velocity
    )
    force = system.mass_kg[:, None] * tethers
    scale = np.abs(force).sum()
    assert np.abs(force.sum(axis=0)).max() < 1e-9 * scale
    assert np.abs(np.cross(position, force).sum(axis=0)).max() < 1e-9 * scale * 1e4
    moved = position + np.array([3e3, -2e3, 1e3])
    shifted = tether_state(system, moved, velocity)[1]
    np.testing.assert_allclose(shifted, tether_state(system, position, velocity)[1], atol=1e-6)


def test_first_configuration_balances_satellite_one_only():
    """Eqs. (50)-(51), and what PHYSICS 2 says of the others: they feel another gradient."""
    system = ring()
    spin = system.spin_rate_rad_s(-2.5)
    state = initial_state(system, -2.5)
    a = paper_acceleration(system, state.position_m, state.velocity_m_s)
    wanted = -(spin**2) * state.position_m
    assert abs(a[0, 1] - wanted[0, 1]) < 1e-10 * abs(wanted[0, 1])
    assert np.linalg.norm(a[1] - wanted[1]) > 1e-3 * np.linalg.norm(wanted[1])
    np.testing.assert_allclose(np.linalg.norm(state.position_m, axis=1), state.position_m[0, 1])


def test_six_bead_configuration_solves_eq_54():
    system = ring(satellite_mass_kg=1000.0, beads_per_tether=1, bead_mass_kg=10.0)
    spin = system.spin_rate_rad_s(-2.2)
    state = initial_state(system, -2.2)
    a = paper_acceleration(system, state.position_m, state.velocity_m_s)
    for bead, angle in ((0, math.pi / 2), (1, math.pi / 2 + math.pi / 3)):
        outward = np.array([math.cos(angle), math.sin(angle), 0.0])
        radius = np.linalg.norm(state.position_m[bead])
        np.testing.assert_allclose(state.position_m[bead], radius * outward, atol=1e-8)
        assert abs(a[bead] @ outward + spin**2 * radius) < 1e-9 * spin**2 * radius


@pytest.mark.parametrize(
    "system",
    [
        ring(satellites=5),
        ring(satellites=3, satellite_mass_kg=[100.0, 120.0, 90.0], beads_per_tether=2),
        formation("chain", 3),
        formation("hub_and_spoke", 4),
    ],
    ids=["ring of 5", "uneven ring", "chain", "hub and spoke"],
)
def test_averaged_state_balances_the_mean_force_over_a_turn(system):
    """The mean of the turning frame's linearised forces over one turn vanishes on it."""
    spin = system.spin_rate_rad_s(-2.9)
    state = averaged_state(system, -2.9)
    arrays = kernel_arrays(replace(system, linear_gravity=True), spin)
    taut = np.ones(system.m, dtype=bool)
    mean, a = np.zeros((system.n, 3)), np.empty((system.n, 3))
    for time in np.arange(8) * (2 * math.pi / abs(spin)) / 8:
        forces.acceleration(arrays, taut, time, np.zeros((system.n, 3)), state.position_m, a)
        mean += a / 8
    scale = spin**2 * np.abs(state.position_m).max()
    assert np.abs(mean).max() < 1e-8 * scale


@pytest.mark.parametrize("integrator", ["auto", "radau", "taylor"])
@pytest.mark.parametrize("damping, disturbance", [(0.0, 1.0), (100.0, 10.0), (2000.0, 10.0)])
def test_motion_agrees_with_scipy_on_the_printed_equations(damping, disturbance, integrator):
    """100 s at -2.2 with slack switches, before chaos parts the two; scipy in the orbit frame."""
    system = ring(damping_n_s_per_m=damping)
    start = disturbed(initial_state(system, -2.2), disturbance, seed=3)
    end = 100.0

    def derivative(_, x):
        r, v = x[:9].reshape(3, 3), x[9:].reshape(3, 3)
        return np.concatenate([v.ravel(), paper_acceleration(system, r, v).ravel()])

    x0 = np.concatenate([start.position_m.ravel(), start.velocity_m_s.ravel()])
    method = "Radau" if damping > 1000 else "DOP853"
    solution = solve_ivp(derivative, (0, end), x0, method, rtol=1e-9, atol=1e-8, max_step=0.5)
    motion = Propagator(system, -2.2, start, integrator=integrator)
    position, velocity = motion.sample(np.array([0.5 * end, end]))
    assert np.abs(position[-1].ravel() - solution.y[:9, -1]).max() < 2e-3
    assert np.abs(velocity[-1].ravel() - solution.y[9:, -1]).max() < 2e-4


@pytest.mark.parametrize(
    "system, turns",
    [
        (ring(damping_n_s_per_m=1.0), 0.5),
        (ring(damping_n_s_per_m=100.0), 0.5),
        (ring(damping_n_s_per_m=100.0, linear_gravity=True), 0.5),
        (ring(satellites=5, damping_n_s_per_m=20.0), 0.1),
        (formation("hub_and_spoke", 4, damping_n_s_per_m=20.0), 0.1),
        (ring(satellites=3, beads_per_tether=2, damping_n_s_per_m=20.0), 0.05),
    ],
    ids=["C = 1", "C = 100", "linear gravity", "ring of 5", "hub and spoke", "9 beads"],
)
def test_implicit_and_explicit_steps_agree_through_slack(system, turns):
    """Two methods that share no formula, of up to three blocks of lanes."""
    start = disturbed(initial_state(system, -2.2), 10.0, seed=3)
    radius = np.linalg.norm(start.position_m[0])
    seen = []
    for integrator in ("radau", "taylor", "auto"):
        motion = Propagator(system, -2.2, start, rtol=1e-12, integrator=integrator)
        seen.append(motion.sample(np.linspace(0.0, turns * motion.period_s, 7))[0])
        assert motion.switches > 3
    assert np.abs(seen[0] - seen[1]).max() < 1e-9 * radius
    assert np.abs(seen[2] - seen[1]).max() < 1e-9 * radius


def test_an_unknown_integrator_is_refused():
    system = ring()
    with pytest.raises(TssError, match="integrator must be one of radau, taylor, auto, got 'rk4'"):
        Propagator(system, -2.5, initial_state(system, -2.5), integrator="rk4")


def jacobi_energy(system, position, velocity):
    """E_J of the orbit frame with the exact potential, (k,) [J]."""
    rate, radius = system.orbit_rate_rad_s, system.orbit_radius_m
    u = (2 * position[..., 1] + np.sum(position**2, -1) / radius) / radius
    inverse = np.expm1(-0.5 * np.log1p(u))  # R/|q| - 1, without cancellation
    centrifugal = 0.5 * (2 * position[..., 1] / radius
                         + (position[..., 0] ** 2 + position[..., 1] ** 2) / radius**2)
    potential = -(rate**2) * radius**2 * (inverse + centrifugal)
    energy = np.sum(system.mass_kg * (0.5 * np.sum(velocity**2, -1) + potential), -1)
    length, _, taut = tether_state(system, position, velocity)
    stiffness = system.axial_stiffness_n / system.rest_length_m
    return energy + np.sum(
        np.where(taut, 0.5 * stiffness * (length - system.rest_length_m) ** 2, 0.0), -1
    )


def test_jacobi_energy_is_kept_without_damping_through_slack():
    system = ring(damping_n_s_per_m=0.0)
    motion = Propagator(system, -2.2, disturbed(initial_state(system, -2.2), 5.0, 1), rtol=1e-12)
    position, velocity = motion.sample(np.linspace(0, 0.5 * motion.period_s, 50))
    energy = jacobi_energy(system, position, velocity)
    assert motion.switches > 5
    assert np.ptp(energy) < 1e-8 * np.sum(system.mass_kg) * 0.5 * np.max(velocity) ** 2


def test_jacobi_energy_falls_by_what_the_dampers_take():
    """dE_J/dt = -sum s C l'^2, integrated over a quarter turn with slack."""
    system = ring(damping_n_s_per_m=100.0)
    motion = Propagator(system, -2.2, disturbed(initial_state(system, -2.2), 5.0, 1), rtol=1e-12)
    times = np.linspace(0, 200.0, 400_001)
    position, velocity = motion.sample(times)
    energy = jacobi_energy(system, position[[0, -1]], velocity[[0, -1]])
    first, second = system.tether_ends.T
    e = position[:, first] - position[:, second]
    w = velocity[:, first] - velocity[:, second]
    growth = np.sum(e * w, -1) / np.linalg.norm(e, axis=-1)
    taut = tether_state(system, position, velocity)[2]
    loss = np.trapezoid(np.sum(np.where(taut, 100.0 * growth**2, 0.0), -1), times)
    assert loss > 1.0
    assert energy[0] - energy[1] == pytest.approx(loss, rel=1e-3)


def test_damped_motion_needs_no_more_steps_than_undamped_smooth_motion():
    """Stiffness is no cost: as many steps at C = 2000 (60 per second) as at C = 100."""
    steps = []
    for damping in (100.0, 2000.0):
        system = ring(damping_n_s_per_m=damping)
        motion = Propagator(system, -2.9, initial_state(system, -2.9))
        motion.sample(np.array([10 * motion.period_s]))
        steps.append(motion.steps)
    assert steps[1] < 2 * steps[0]


def test_no_switch_is_skipped():
    """Slack intervals seen in dense output are each bracketed by two counted switches."""
    system = ring(damping_n_s_per_m=0.0)
    motion = Propagator(system, -2.2, disturbed(initial_state(system, -2.2), 10.0, 2))
    times = np.linspace(0, 0.3 * motion.period_s, 60_001)
    taut = tether_state(system, *motion.sample(times))[2]
    changes = np.count_nonzero(taut[1:] != taut[:-1])
    assert changes > 10
    assert motion.switches >= changes
    assert motion.switches <= changes + 2


def test_samples_do_not_depend_on_how_they_are_asked_for():
    system = ring()
    start = disturbed(initial_state(system, -2.5), 1.0, 0)
    times = np.linspace(0, 3000.0, 301)
    whole = Propagator(system, -2.5, start).sample(times)
    piecewise = Propagator(system, -2.5, start)
    parts = [piecewise.sample(part) for part in np.array_split(times, 17)]
    assert np.array_equal(whole[0], np.concatenate([p for p, _ in parts]))
    assert np.array_equal(whole[1], np.concatenate([v for _, v in parts]))


def test_disturbance_is_seeded_and_of_the_size_asked_for():
    state = initial_state(ring(), -2.5)
    a, b, c = (disturbed(state, 3.0, seed) for seed in (1, 1, 2))
    assert np.array_equal(a.position_m, b.position_m)
    assert not np.array_equal(a.position_m, c.position_m)
    assert np.linalg.norm(a.position_m - state.position_m) == pytest.approx(3.0)
    radius = np.linalg.norm(state.position_m, axis=1)
    np.testing.assert_allclose(deviation(state.position_m * 1.01, radius), 0.01)


@pytest.mark.parametrize(
    ("name", "near"),
    [
        ("hub_and_spoke", ["hub"]),
        ("double_pyramid", ["apex_up", "apex_down"]),
        ("vertical_chain_3", ["satellite_2"]),
        ("six_bead", []),
    ],
)
def test_beads_near_the_centre_are_compared_with_the_largest_radius(name, near):
    formation = scenario.load(name)
    system = formation.build()
    place = initial_state(system, formation.spin_rate_ratio).position_m
    radius = np.linalg.norm(place, axis=1)
    is_near = np.isin(system.bead_name, near)
    with np.errstate(all="raise"):
        np.testing.assert_allclose(deviation(place, radius), 0.0, atol=1e-14)
        moved = deviation(np.stack([1.5 * place, -place]), radius)
        away = deviation(place + 0.02 * radius.max() * np.eye(3)[2], radius)
    np.testing.assert_array_equal(
        moved[0, ~is_near], np.linalg.norm(1.5 * place[~is_near], axis=1) / radius[~is_near] - 1.0
    )
    np.testing.assert_allclose(moved[0, is_near], 0.5 * radius[is_near] / radius.max(), atol=1e-12)
    np.testing.assert_allclose(away[is_near], 0.02, atol=2e-3)


@pytest.mark.parametrize(
    "change, named",
    [
        ({"satellites": 2}, "satellites must be a whole number from 3"),
        ({"satellites": 1_000_000}, "from 3 to 20000, got 1000000"),
        ({"satellite_mass_kg": -1.0}, "satellite_mass_kg must be greater than 0, got -1"),
        ({"satellite_mass_kg": [1.0, 2.0]}, "1 or 3 values (one per satellite), got 2"),
        ({"tether_length_m": math.nan}, "tether_length_m must be a finite number, got nan"),
        ({"damping_n_s_per_m": -0.1}, "damping_n_s_per_m must be at least 0"),
        ({"beads_per_tether": 1.5}, "beads_per_tether must be a whole number"),
        ({"orbit_altitude_m": -1.0}, "orbit_altitude_m must be at least 0"),
        ({"satellite_mass_kg": "heavy"}, "satellite_mass_kg must be a number, got 'heavy'"),
    ],
)
def test_bad_parameters_are_named_with_value_and_range(change, named):
    with pytest.raises(TssError) as error:
        ring(**change)
    assert named in str(error.value)


@pytest.mark.parametrize("ratio", [1e-4, math.nan, math.inf, 1e9, "fast"])
def test_bad_spin_rates_are_refused(ratio):
    with pytest.raises(TssError, match="spin_rate_ratio"):
        initial_state(ring(), ratio)


def test_bad_states_are_refused():
    system = ring()
    with pytest.raises(TssError, match="finite"):
        Propagator(system, -2.5, State(np.full((3, 3), np.nan), np.zeros((3, 3))))
    with pytest.raises(TssError, match="shape"):
        Propagator(system, -2.5, State(np.zeros((2, 3)), np.zeros((2, 3))))
    motion = Propagator(system, -2.5, initial_state(system, -2.5))
    with pytest.raises(TssError, match="increasing"):
        motion.sample(np.array([1.0, 0.5]))
    integrator, one = Integrator(system, 1e-3, 1e-9, 5773.0), np.ones((1, 3, 3))
    for r, v, stop, named in (
        (one[:0], one[:0], 1.0, "shape"),
        (one, one[0], 1.0, "shape"),
        (one, one * np.inf, 1.0, "finite"),
        (one, one, np.inf, "finite"),
    ):
        with pytest.raises(TssError, match=named):
            integrator.ends(r, v, stop)


def test_a_motion_of_many_that_cannot_be_continued_is_named(monkeypatch):
    monkeypatch.setattr(integrate, "MOST_SWITCHES_PER_TURN", 3)
    system = ring(damping_n_s_per_m=1.0)
    start = initial_state(system, -2.2)
    r = start.position_m + 10.0 * np.sin(np.arange(9.0)).reshape(3, 3)
    r, v = np.stack([r, r]), np.stack([start.velocity_m_s] * 2)
    integrator = Integrator(system, system.spin_rate_rad_s(-2.2), 1e-9, 5773.0)
    with pytest.raises(IntegrationError, match="motion 0's tethers chatter at"):
        integrator.ends(r, v, 1e4)
