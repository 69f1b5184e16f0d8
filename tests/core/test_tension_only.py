"""Tethers that only pull: their switches, their variations, and what becomes of the formation."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tss_ros.core import (
    Propagator,
    TssError,
    compute_floquet,
    confirm,
    disturbed,
    find_critical_rates,
    initial_state,
    ring,
    tether_state,
)
from tss_ros.core.model import forces
from tss_ros.core.model.kernel_arrays import kernel_arrays
from tss_ros.core.motion.displacements import carry_displacements
from tss_ros.core.motion.integrator import Integrator

RATE, PUSH_M = -2.3, 10.0


@pytest.fixture(scope="module")
def pulling():
    """A ring whose tethers only pull, and a start from which they go slack and idle."""
    system = ring(tether_law="tension_only")
    return system, disturbed(initial_state(system, RATE), PUSH_M)


def turn_s(system, ratio=RATE):
    return 2.0 * math.pi / abs(system.spin_rate_rad_s(ratio))


def printed_motion(system, start, times, force):
    """The printed equations with any force of length and rate, by DOP853 with short steps."""
    rate, radius, mu = system.orbit_rate_rad_s, system.orbit_radius_m, 3.986e14
    up = np.array([0.0, radius, 0.0])

    def derivative(_, state):
        v, r = state.reshape(2, -1, 3)
        q = r + up
        a = -mu * q / np.linalg.norm(q, axis=1)[:, None] ** 3
        a[:, 0] += rate**2 * q[:, 0] + 2.0 * rate * v[:, 1]
        a[:, 1] += rate**2 * q[:, 1] - 2.0 * rate * v[:, 0]
        for k, (i, j) in enumerate(system.tether_ends):
            e = r[i] - r[j]
            length = np.linalg.norm(e)
            if length > system.rest_length_m[k]:
                along = force(length, e @ (v[i] - v[j]) / length, k) * e / length
                a[i] -= along / system.mass_kg[i]
                a[j] += along / system.mass_kg[j]
        return np.concatenate([a.ravel(), v.ravel()])

    state = np.concatenate([start.velocity_m_s.ravel(), start.position_m.ravel()])
    found = solve_ivp(
        derivative, (0.0, times[-1]), state, method="DOP853", rtol=1e-10, atol=1e-9, max_step=4.0,
        t_eval=times,
    )  # fmt: skip
    return found.y[state.size // 2 :].T.reshape(times.size, -1, 3)


def test_a_motion_is_that_of_the_greater_of_zero_and_spring_plus_damper(pulling):
    system, start = pulling
    times = np.linspace(0.0, 0.5 * turn_s(system), 40)
    propagator = Propagator(system, RATE, start, rtol=1e-11)
    position_m, _ = propagator.sample(times)
    stiffness = system.axial_stiffness_n / system.rest_length_m

    def force(length, growth, k):
        spring = stiffness[k] * (length - system.rest_length_m[k])
        return max(0.0, spring + system.damping_n_s_per_m[k] * growth)

    expected = printed_motion(system, start, times, force)
    assert propagator.switches > 20
    np.testing.assert_allclose(position_m, expected, rtol=0, atol=1e-5)
    pushing, _ = Propagator(ring(), RATE, start, rtol=1e-11).sample(times)
    assert np.max(np.abs(position_m - pushing)) > 10.0


@pytest.mark.parametrize("integrator", ["taylor", "radau"])
def test_both_kinds_of_steps_find_the_same_switches(pulling, integrator):
    system, start = pulling
    spin, ends = system.spin_rate_rad_s(RATE), []
    for kind in ("auto", integrator):
        flow = Integrator(system, spin, 1e-11, 5e3, integrator=kind)
        ends.append(flow.begin(start))
        flow.advance(ends[-1], 0.5 * turn_s(system))
    np.testing.assert_allclose(ends[1].r, ends[0].r, rtol=0, atol=1e-6)
    assert ends[1].switches == ends[0].switches > 20


def test_no_tether_ever_pushes_and_idle_ones_are_seen(pulling):
    system, start = pulling
    times = np.linspace(0.0, turn_s(system), 2000)
    position_m, velocity_m_s = Propagator(system, RATE, start).sample(times)
    length_m, tension_n, taut = tether_state(system, position_m, velocity_m_s)
    acting = forces.acting_tethers(system, position_m, velocity_m_s)
    assert tension_n.min() == 0.0
    assert np.count_nonzero(taut & ~acting) > 50  # longer than at rest, and yet without tension
    assert np.all(tension_n[taut & ~acting] == 0.0)
    assert forces.pushing_share(tension_n, taut) == 0.0


@pytest.mark.parametrize("integrator", ["taylor", "radau"])
def test_variations_pass_all_kinds_of_switches(pulling, integrator):
    system, start = pulling
    spin = system.spin_rate_rad_s(RATE)
    length = np.max(np.linalg.norm(start.position_m, axis=1))
    flow = Integrator(system, spin, 1e-12, length, integrator=integrator)
    stop, size = 0.35 * turn_s(system), 6 * system.n
    motion, matrix = carry_displacements(flow, flow.begin(start), np.eye(size), stop)
    assert motion.switches > 8
    rng, step = np.random.default_rng(3), 1e-7
    for _ in range(3):
        direction = rng.standard_normal(size)
        ends = []
        for sign in (1.0, -1.0):
            moved = flow.begin(start)
            d_v, d_r = (sign * step * direction).reshape(2, -1, 3)
            moved = moved._replace(
                v=moved.v + d_v * flow.settings.speed, r=moved.r + d_r * flow.settings.length
            )
            flow.advance(moved, stop)
            ends.append(flow.scaled(moved.v, moved.r))
        difference = (ends[0] - ends[1]) / (2.0 * step)
        expected = matrix @ direction
        np.testing.assert_allclose(
            difference, expected, rtol=0, atol=2e-4 * np.max(np.abs(expected))
        )


def test_without_damping_it_is_the_paper_s_law():
    start = disturbed(initial_state(ring(damping_n_s_per_m=0.0), RATE), PUSH_M)
    times = np.linspace(0.0, 600.0, 30)
    found = [
        Propagator(ring(damping_n_s_per_m=0.0, tether_law=law), RATE, start, rtol=1e-11).sample(
            times
        )[0]
        for law in ("kelvin_voigt", "tension_only")
    ]
    np.testing.assert_allclose(found[0], found[1], rtol=0, atol=1e-5)


def test_a_motion_that_begins_idle_waits_for_its_tension():
    system = ring(tether_law="tension_only")
    still = initial_state(system, -3.0)
    shrinking = still.velocity_m_s - 1e-3 * still.position_m
    flow = Integrator(system, system.spin_rate_rad_s(-3.0), 1e-10, 5e3)
    motion = flow.begin(type(still)(still.position_m, shrinking))
    assert motion.idle.all() and not motion.taut.any()
    paper = Integrator(ring(), system.spin_rate_rad_s(-3.0), 1e-10, 5e3)
    assert paper.begin(type(still)(still.position_m, shrinking)).taut.all()


def test_damping_buys_no_stability_beyond_the_slack_limit():
    for damping in (100.0, 1450.0, 3000.0):
        system = ring(damping_n_s_per_m=damping, tether_law="tension_only")
        held = compute_floquet(system, -2.6, certify=False)
        assert held.verdict == "asymptotically stable"
        assert (held.tether_law, held.pushing_share) == ("tension_only", 0.0)
        lost = compute_floquet(system, -2.3, certify=False)
        assert lost.verdict in ("unstable", "none found")
    paper = compute_floquet(ring(), -2.3, certify=False)
    assert paper.verdict == "asymptotically stable"
    assert 0.15 < paper.pushing_share < 0.3


def test_a_disturbed_motion_says_the_same_as_the_multipliers():
    system = ring(tether_law="tension_only")
    for rate, holds in ((-2.6, True), (-2.2, False)):
        seen, said = confirm(system, rate, turns=12), compute_floquet(system, rate, certify=False)
        assert seen.held is holds
        assert seen.agrees_with(said)
        assert seen.pushing_share == 0.0
    assert confirm(ring(), -2.2, turns=12).pushing_share > 0.1


def test_critical_rates_are_those_of_the_law():
    system = ring(tether_law="tension_only")
    found = find_critical_rates(system, -2.7, -2.3, tolerance=0.005)
    slack = [rate.spin_rate_ratio for rate in found if rate.cause == "first slack"]
    # Tension comes to zero at the rate at which that of a rigid ring does, whatever the damping.
    assert any(abs(rate + 2.58114) < 0.03 for rate in slack)
    assert all(rate.spin_rate_ratio < -2.45 for rate in found)


def test_a_matrix_through_idle_tethers_carries_its_proofs():
    result = compute_floquet(ring(tether_law="tension_only"), -2.55)
    assert result.switches > 10
    assert result.flow_error < 1e-6
    assert result.liouville_error < 1e-8
    assert result.det_z_error < 1e-8


def test_the_energy_of_idle_tethers_still_counts():
    system = ring(tether_law="tension_only", damping_n_s_per_m=1450.0)
    start = disturbed(initial_state(system, RATE), PUSH_M)
    energy = forces.elastic_energy(system, start.position_m, start.velocity_m_s)
    length, _, taut = tether_state(system, start.position_m, start.velocity_m_s)
    arrays = kernel_arrays(system, 0.0)
    stretch = np.where(taut, length - system.rest_length_m, 0.0)
    assert energy == pytest.approx(0.5 * np.sum(arrays.stiffness * stretch**2))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"tether_law": "tension-only"}, "did you mean 'tension_only'"),
        ({"tether_law": "tension_only", "bilateral": True}, "bilateral"),
        ({"stiffening": 3.0}, "stiffening is 3, which only tether_law stiffening uses"),
        ({"tether_law": "stiffening", "stiffening": -1.0}, "stiffening must be at least 0"),
        ({"j3": 1e-6}, "'j3' is no parameter"),
        ({"scale_height_m": 10.0}, "scale_height_m must be at least 1000, got 10"),
        ({"j2": math.nan}, "j2 must be a finite number"),
    ],
)
def test_what_no_law_allows_is_refused(options, words):
    with pytest.raises(TssError, match=words):
        ring(**options)
