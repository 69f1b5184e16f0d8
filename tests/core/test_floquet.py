"""The stability analysis against closed forms and identities the code does not produce."""

import math
from collections import Counter

import numpy as np
import pytest
from paper import paper_acceleration
from scipy.linalg import expm

from tss_ros.core import (
    Cancelled,
    Propagator,
    State,
    TssError,
    compute_floquet,
    disturbed,
    initial_state,
    ring,
    tether_state,
)
from tss_ros.core.motion.integrator import Integrator
from tss_ros.core.stability.frozen import frozen_jacobian
from tss_ros.core.stability.shooting import integrate_turn


def one_turn(system, ratio, state=None, rtol=1e-10):
    state = initial_state(system, ratio) if state is None else state
    length = np.max(np.linalg.norm(state.position_m, axis=1))
    return integrate_turn(Integrator(system, system.spin_rate_rad_s(ratio), rtol, length), state)


def moduli(result, family):
    return np.array([abs(m) for m, f in zip(result.multiplier, result.family) if f == family])


def tilt_growth(w):
    """Largest multiplier of the axis tilt of a symmetric rigid ring (inertia ratio 2)."""
    s = 1 + w
    squares = np.roots([1.0, (2 * s - 1) ** 2 + 4, (2 * s - 1) * (2 * s + 2)])
    return math.exp(2 * math.pi * np.sqrt(squares.astype(complex)).real.max() / abs(w))


@pytest.mark.parametrize(
    "w, known", [(-1.95, 1.63574), (-1.75, 3.47819), (-1.5, 7.87221), (-1.0, 46.2321)]
)
def test_axis_tilt_grows_as_the_closed_form_says(w, known):
    assert tilt_growth(w) == pytest.approx(known, rel=1e-5)
    # Stiff tethers: at Table 1's EA the ring breathes, which shifts the growth by 2e-4 to 4e-4.
    system = ring(
        damping_n_s_per_m=0.0, linear_gravity=True, bilateral=True, axial_stiffness_n=5e5
    )
    result = compute_floquet(system, w, certify=False)
    assert moduli(result, "axis tilt").max() == pytest.approx(known, rel=1e-4)
    assert result.verdict == "unstable"


@pytest.mark.parametrize(
    "w, stable", [(-2.02, True), (-1.98, False), (-0.48, True), (-0.52, False)]
)
def test_axis_tilt_is_stable_outside_minus_two_to_minus_half(w, stable):
    system = ring(damping_n_s_per_m=0.0, linear_gravity=True, bilateral=True)
    largest = moduli(compute_floquet(system, w, certify=False), "axis tilt").max()
    assert (largest < 1 + 1e-6) == stable


@pytest.mark.parametrize("damping", [0.0, 1.0, 1450.0, 2000.0])
def test_multipliers_known_to_be_on_the_unit_circle_are(damping):
    result = compute_floquet(ring(damping_n_s_per_m=damping), -2.9)
    assert Counter(result.family) == {
        "centre of mass": 6, "spin": 2, "axis tilt": 4, "shape": 6,
    }
    assert result.trivial_error < 1e-8
    assert np.abs(moduli(result, "axis tilt") - 1).max() < 1e-8
    rate = 2 * math.pi / 2.9  # exp(+-i Omega T)
    centre = [m for m, f in zip(result.multiplier, result.family) if f == "centre of mass"]
    phases = np.sort(np.abs(np.angle(centre)))[-4:]
    folded = abs(math.remainder(rate, 2 * math.pi))
    np.testing.assert_allclose(phases, folded, atol=1e-5)
    assert result.det_z_error < 1e-8
    assert result.flow_error < 1e-8


@pytest.mark.parametrize("mass, damping", [(50.0, 1e4), (100.0, 1e5), (1000.0, 3e5)])
def test_tethers_that_relax_slowly_are_not_taken_for_the_spin(mass, damping):
    """Overdamped stretch relaxes at the rate EA / (C L): its modes reach for the unit circle."""
    result = compute_floquet(
        ring(satellite_mass_kg=mass, damping_n_s_per_m=damping), -2.5, certify=False
    )
    assert result.verdict == "asymptotically stable"
    assert result.jordan_error < 1e-3
    slow = math.exp(-5e4 / (1e4 * damping) * result.period_s)
    np.testing.assert_allclose(moduli(result, "shape")[:3], slow, rtol=0.02)


@pytest.mark.parametrize("w", [-2.9, -3.5])
def test_six_bead_system_has_neutral_beads_and_exact_trivial_multipliers(w):
    """The tethers' stretch decays, the swing of the light beads does not (paper, section 3.3)."""
    system = ring(satellite_mass_kg=1000.0, beads_per_tether=1, bead_mass_kg=10.0)
    result = compute_floquet(system, w, certify=False)
    assert Counter(result.family) == {
        "centre of mass": 6, "spin": 2, "axis tilt": 4, "shape": 24,
    }
    assert result.verdict == "neutral"
    shape = moduli(result, "shape")
    assert np.count_nonzero(shape < 0.1) == 12  # six stretched segments
    assert np.abs(shape[:6] - 1).max() < 1e-8  # three beads swinging out of the plane
    assert result.trivial_error < 1e-8
    assert result.det_z_error < 1e-8
    assert result.flow_error < 1e-8


def test_shape_decays_with_damping_and_only_then():
    assert compute_floquet(ring(), -2.5).verdict == "asymptotically stable"
    assert compute_floquet(ring(damping_n_s_per_m=0.0), -2.9).verdict == "neutral"


@pytest.mark.parametrize("damping, edge", [(1000.0, 2.306), (1450.0, 2.17), (2000.0, 2.036)])
def test_corrected_motion_goes_slack_at_the_damped_edge(damping, edge):
    """PHYSICS 4: taut iff w^2 + 2 w + 3/2 >= 3 / sqrt(1 + (2 w Omega tau)^2)."""
    system = ring(damping_n_s_per_m=damping)
    tau = damping * 1e4 / 5e4

    def margin(w):
        return w * w + 2 * w + 1.5 - 3 / math.hypot(1, 2 * w * system.orbit_rate_rad_s * tau)

    assert margin(-edge - 0.005) > 0 > margin(-edge + 0.005)
    assert compute_floquet(system, -edge - 0.02).switches == 0
    inside = compute_floquet(system, -edge + 0.02)
    assert inside.switches > 0 or inside.verdict in ("unstable", "none found")


def test_critical_rate_of_table_1_lies_at_the_papers():
    held = compute_floquet(ring(), -2.19)
    lost = compute_floquet(ring(), -2.1)
    assert held.verdict == "asymptotically stable"
    assert lost.verdict in ("unstable", "none found")


def test_with_strong_damping_the_axis_tilt_sets_the_edge_at_two():
    system = ring(damping_n_s_per_m=2200.0)
    assert compute_floquet(system, -2.02).verdict == "asymptotically stable"
    below = compute_floquet(system, -1.98, certify=False)
    assert below.verdict == "unstable"
    assert moduli(below, "axis tilt").max() > 1.1


@pytest.mark.parametrize("kind", ["radau", "taylor", "auto"])
@pytest.mark.parametrize(
    "system, end_s",
    [
        (ring(damping_n_s_per_m=1.0), 60.0),
        (ring(damping_n_s_per_m=100.0), 350.0),
        (ring(satellites=5, damping_n_s_per_m=20.0), 250.0),
    ],
    ids=["C = 1", "C = 100", "ring of 5"],
)
def test_matrix_is_the_derivative_of_the_motion_through_slack(system, end_s, kind):
    """Central differences of the nonlinear flow, column by column; fails without saltation."""
    start = disturbed(initial_state(system, -2.2), 10.0, seed=4)
    length, half = np.max(np.linalg.norm(start.position_m, axis=1)), 3 * system.n
    spin = system.spin_rate_rad_s(-2.2)
    integrator = Integrator(system, spin, 1e-11, length, integrator=kind)
    scale = np.repeat([integrator.settings.speed, integrator.settings.length], half)
    x = (np.eye(2 * half) * scale).reshape(2, system.n, 3, 2 * half)
    motion = integrator.begin(start).with_variations(*x)
    integrator.advance(motion, end_s)
    assert motion.switches >= 2
    matrix = np.concatenate([motion.x_v, motion.x_r]).reshape(2 * half, -1) / scale[:, None]

    def end(column, size):
        other = integrator.begin(start)
        part = other.v if column < half else other.r
        part.reshape(-1)[column % half] += size * scale[column]
        integrator.advance(other, end_s)
        return np.concatenate([other.v.ravel(), other.r.ravel()]) / scale

    for column in range(2 * half):
        size = 1e-7
        difference = (end(column, size) - end(column, -size)) / (2 * size)
        error = np.abs(difference - matrix[:, column]).max() / np.abs(matrix[:, column]).max()
        assert error < 1e-4, f"column {column}"


def test_liouville_through_slack_switches():
    """log|det| = -sum C (1/m_i + 1/m_j) (time taut), in steps that resolve the fast modes."""
    system = ring(damping_n_s_per_m=1.0)
    start = disturbed(initial_state(system, -2.2), 10.0, seed=4)
    integrator = Integrator(system, system.spin_rate_rad_s(-2.2), 1e-10, 5773.0)
    integrator.settings = integrator.settings._replace(longest=2.0)
    scale = np.repeat([integrator.settings.speed, integrator.settings.length], 9)
    identity = np.eye(18) * scale
    logarithm = 0.0
    motion = integrator.begin(start).with_variations(*np.empty((2, 3, 3, 18)))
    while motion.time < 400.0:
        motion.x_v[:] = identity[:9].reshape(3, 3, 18)
        motion.x_r[:] = identity[9:].reshape(3, 3, 18)
        integrator.advance(motion, 400.0, steps=1)
        step = np.concatenate([motion.x_v, motion.x_r]).reshape(18, 18) / scale[:, None]
        logarithm += np.linalg.slogdet(step)[1]
    assert motion.switches >= 4
    assert motion.dissipation > 5.0
    assert logarithm == pytest.approx(-motion.dissipation, abs=1e-6)


@pytest.mark.parametrize("ratio, damping", [(-2.5, 1450.0), (-2.9, 1.0)])
def test_segments_give_the_same_multipliers(ratio, damping):
    system = ring(damping_n_s_per_m=damping)
    result = compute_floquet(system, ratio)
    integrator = Integrator(system, system.spin_rate_rad_s(ratio), 1e-9, 5773.0)
    integrator = integrator.driven(result.spin_loss)
    for segments in (3, 7):
        matrix = integrate_turn(integrator, result.state, segments=segments).matrix
        other = np.sort(np.abs(np.linalg.eigvals(matrix)))[::-1]
        # Jordan pairs split like the square root of the error.
        np.testing.assert_allclose(other, np.abs(result.multiplier), atol=1e-4)


@pytest.mark.parametrize("w", [-1.5, -2.2, -2.9, -4.5])
@pytest.mark.parametrize("damping", [0.0, 100.0, 1e5])
def test_frozen_method_shows_no_critical_rate(w, damping):
    """PHYSICS 3: max|rho| = 1.00x for every rate and damping."""
    result = compute_floquet(ring(damping_n_s_per_m=damping), w, "frozen")
    assert 1.0 <= result.max_modulus < 1.02


def test_frozen_multipliers_are_those_of_the_matrix_exponential():
    """Eqs. (34)-(46) by an independent route; J_0 from differences of the printed equations."""
    system = ring(damping_n_s_per_m=0.1)
    state = initial_state(system, -2.5)
    x0 = np.concatenate([state.velocity_m_s.ravel(), state.position_m.ravel()])

    def derivative(x):
        v, r = x[:9].reshape(3, 3), x[9:].reshape(3, 3)
        return np.concatenate([paper_acceleration(system, r, v).ravel(), v.ravel()])

    numeric = np.empty((18, 18))
    for column in range(18):
        step = np.zeros(18)
        step[column] = 1e-2
        numeric[:, column] = (derivative(x0 + step) - derivative(x0 - step)) / 2e-2
    ours = frozen_jacobian(system, state)
    np.testing.assert_allclose(ours, numeric, atol=1e-9 * np.abs(numeric).max() + 1e-9)
    result = compute_floquet(system, -2.5, "frozen")
    units = np.repeat([16.0, 5773.0], 9)
    matrix = expm((ours * units / units[:, None]) * result.period_s)
    expected = np.sort(np.abs(np.linalg.eigvals(matrix)))[::-1]
    np.testing.assert_allclose(np.abs(result.multiplier)[:12], expected[:12], atol=1e-5)


def test_growth_seen_in_a_disturbed_motion_is_the_multipliers():
    """Out-of-plane motion of the nonlinear system grows by |rho| a turn (bilateral, C = 0)."""
    system = ring(damping_n_s_per_m=0.0, linear_gravity=True, bilateral=True)
    result = compute_floquet(system, -1.75, certify=False)
    offset = np.zeros((3, 3))
    offset[:, 2] = [1e-4, -2e-4, 1e-4]
    start = State(result.state.position_m + offset, np.array(result.state.velocity_m_s))
    motion = Propagator(system, -1.75, start)
    position, _ = motion.sample(np.arange(9) * result.period_s)
    height = np.linalg.norm(position[:, :, 2], axis=1)
    assert height[8] / height[7] == pytest.approx(moduli(result, "axis tilt").max(), rel=1e-2)


@pytest.mark.parametrize("shift", [1, 2])
def test_numbering_of_the_satellites_does_not_matter(shift):
    masses = np.array([100.0, 150.0, 120.0])
    system, renamed = (ring(satellite_mass_kg=m) for m in (masses, np.roll(masses, shift)))
    state = initial_state(system, -2.6)
    rolled = State(*(np.roll(x, shift, axis=0) for x in (state.position_m, state.velocity_m_s)))
    first, second = one_turn(system, -2.6, state), one_turn(renamed, -2.6, rolled)
    assert first.switches == second.switches
    same = np.roll(first.matrix.reshape(2, 3, 3, 2, 3, 3), (shift, shift), axis=(1, 4))
    scale = np.abs(first.matrix).max()
    np.testing.assert_allclose(second.matrix, same.reshape(18, 18), atol=1e-7 * scale)


def test_bad_requests_are_named():
    with pytest.raises(TssError, match="method must be one of monodromy, frozen, got 'magic'"):
        compute_floquet(ring(), -2.5, "magic")
    with pytest.raises(TssError, match="spin_rate_ratio"):
        compute_floquet(ring(), 1e-4)
    with pytest.raises(Cancelled):
        compute_floquet(ring(damping_n_s_per_m=0.5), -2.2, cancelled=lambda: True)


def test_slack_motion_carries_no_tension():
    system = ring(damping_n_s_per_m=100.0)
    motion = Propagator(system, -2.2, disturbed(initial_state(system, -2.2), 10.0, 4))
    position, velocity = motion.sample(np.linspace(0.0, 500.0, 501))
    length, tension, taut = tether_state(system, position, velocity)
    assert np.any(~taut) and np.any(taut)
    assert np.all(tension[~taut] == 0.0)
    assert np.all((length > system.rest_length_m) == taut)
