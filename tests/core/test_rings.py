"""Long rings: the matrix-free analysis against whole matrices, closed forms and differences."""

import math
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from tss_ros.core import (
    Cancelled,
    TssError,
    averaged_state,
    compute_floquet,
    disturbed,
    ring,
    tether_state,
)
from tss_ros.core.model.frames import rigid_velocity
from tss_ros.core.motion import displacements
from tss_ros.core.motion.displacements import carry_displacements
from tss_ros.core.motion.integrator import Integrator
from tss_ros.core.motion.propagator import Propagator
from tss_ros.core.numerics.arnoldi import arnoldi
from tss_ros.core.stability.families import nearest_motion
from tss_ros.core.stability.harmonic_balance import close_by_harmonic_balance
from tss_ros.core.stability.shooting import closure, integrate_turn


def long_ring(beads, satellites=3, **options):
    """10 kg of tether on each side, cut into beads."""
    mass = 10.0 * satellites / (beads - satellites)
    return ring(satellites, beads_per_tether=beads // satellites - 1, bead_mass_kg=mass, **options)


def flow_of(system, ratio, state, rtol=1e-9):
    length = np.max(np.linalg.norm(state.position_m, axis=1))
    return Integrator(system, system.spin_rate_rad_s(ratio), rtol, length)


@pytest.mark.parametrize("count", [3, 300, 10_000])
def test_equilibrium_of_a_hoop_is_the_closed_form(count):
    """2 T sin(pi/n) = m (w^2 + 2 w + 3/2) Omega^2 R with T = EA (2 R sin(pi/n) / L - 1)."""
    system = ring(count, satellite_mass_kg=300.0 / count, tether_length_m=3e4 / count)
    state = averaged_state(system, -3.0)
    sine = math.sin(math.pi / count)
    outward = 300.0 / count * 4.5 * system.orbit_rate_rad_s**2
    radius = 2.0 * 5e4 * sine / (4.0 * 5e4 * sine**2 / (3e4 / count) - outward)
    np.testing.assert_allclose(np.linalg.norm(state.position_m, axis=1), radius, rtol=1e-8)


def test_equilibrium_of_a_heavy_tether_is_that_of_a_whirling_string():
    """T + mu (w^2 + 2 w + 3/2) Omega^2 r^2 / 2 is the same everywhere, mu the mass of a metre."""
    system = long_ring(3000)
    state = averaged_state(system, -3.0)
    _, tension, taut = tether_state(system, state.position_m, state.velocity_m_s)
    i, j = system.tether_ends[:1000].T
    middle = np.linalg.norm(state.position_m[i] + state.position_m[j], axis=1) / 2.0
    density = 10.0 / 999 / system.rest_length_m[0]
    centrifugal = density * 4.5 * system.orbit_rate_rad_s**2 * middle**2 / 2.0
    assert taut.all()
    assert np.ptp(tension[:1000]) > 0.03 * tension.max()
    np.testing.assert_allclose(tension[:1000] + centrifugal, tension[0] + centrifugal[0], rtol=1e-5)


def test_variations_of_a_coupled_motion_are_its_differences():
    """Central differences of the nonlinear motion of 12 beads that leaves the orbit plane."""
    system = long_ring(12)
    start = disturbed(averaged_state(system, -6.0), 30.0, seed=2)
    integrator = flow_of(system, -6.0, start, 1e-11)
    scale = np.repeat([integrator.settings.speed, integrator.settings.length], 36)
    along = np.random.default_rng(1).standard_normal((72, 3))
    _, carried = carry_displacements(integrator, integrator.begin(start), along, 300.0)

    def end(column, size):
        motion = integrator.begin(start)
        step = size * along[:, column] * scale
        motion.v[:] += step[:36].reshape(12, 3)
        motion.r[:] += step[36:].reshape(12, 3)
        integrator.advance(motion, 300.0)
        return np.concatenate([motion.v.ravel(), motion.r.ravel()]) / scale

    for column in range(3):
        difference = (end(column, 1e-7) - end(column, -1e-7)) / 2e-7
        error = np.abs(difference - carried[:, column]).max()
        assert error < 1e-4 * np.abs(carried[:, column]).max()


def test_columns_in_blocks_on_any_number_of_cores(monkeypatch):
    """The same bits from one worker and four, and the matrix of one block within its accuracy."""
    system = long_ring(30)
    start = averaged_state(system, -10.0)
    integrator = flow_of(system, -10.0, start)
    matrices = []
    for workers in (1, 4):
        with ThreadPoolExecutor(workers) as pool:
            monkeypatch.setattr(displacements, "_pool", lambda pool=pool: pool)
            matrices.append(integrate_turn(integrator, start).matrix)
    assert np.array_equal(*matrices)
    monkeypatch.setattr(displacements, "BLOCK", 180)
    period = 2.0 * math.pi / abs(integrator.arrays.spin)
    begin, identity = integrator.begin(start), np.eye(180)
    whole = carry_displacements(integrator, begin, identity, period, width=180)[1]
    np.testing.assert_allclose(matrices[0], whole, atol=1e-7 * np.abs(whole).max())
    flat = np.arange(180) % 3 != 2
    assert not matrices[0][np.ix_(flat, ~flat)].any()  # a planar motion


@pytest.mark.parametrize("beads, satellites, ratio", [(12, 3, -2.9), (24, 6, -2.3)])
def test_leading_multipliers_are_those_of_the_whole_matrix(beads, satellites, ratio):
    system = long_ring(beads, satellites)
    start = averaged_state(system, ratio)
    found = compute_floquet(system, ratio, state=start, correct=False, rtol=1e-7, leading=5)
    whole = compute_floquet(system, ratio, state=start, correct=False, rtol=1e-7, certify=False)
    assert found.residual.shape == found.multiplier.shape == (5,)
    assert np.all(found.residual < 1e-6 * np.abs(found.multiplier))
    for multiplier in found.multiplier:
        error = np.min(np.abs(whole.multiplier - multiplier))
        assert error < 1e-4 * abs(multiplier)
    np.testing.assert_allclose(np.abs(found.multiplier), np.abs(whole.multiplier[:5]), rtol=1e-4)
    assert found.max_modulus > 1.3
    assert found.verdict == whole.verdict == "unstable"
    assert found.flow_error < 1e-4


def test_leading_multiplier_of_the_axis_tilt_is_the_closed_form():
    """Largest multiplier of a rigid ring's tilt at -1.75 Omega, PHYSICS: 3.47819."""
    system = ring(damping_n_s_per_m=0.0, linear_gravity=True, bilateral=True, axial_stiffness_n=5e5)
    result = compute_floquet(system, -1.75, leading=2)
    assert abs(result.multiplier[0]) == pytest.approx(3.47819, rel=1e-4)
    assert result.family[0] == "axis tilt"
    assert result.verdict == "unstable"


@pytest.mark.parametrize(
    "beads, satellites, ratio", [(12, 3, -6.0), (60, 4, -10.0), (60, 5, -6.0), (150, 3, -10.0)]
)
def test_harmonic_balance_closes_a_motion(beads, satellites, ratio):
    system = long_ring(beads, satellites)
    start = averaged_state(system, ratio)
    integrator = flow_of(system, ratio, start)
    before = closure(integrator, start).residual
    after = closure(integrator, close_by_harmonic_balance(integrator, start)).residual
    assert after < 1e-4
    assert before > 50.0 * after


def test_harmonic_balance_finds_the_motion_that_shooting_does():
    system = long_ring(12)
    start = averaged_state(system, -10.0)
    integrator = flow_of(system, -10.0, start)
    balanced = close_by_harmonic_balance(integrator, start)
    whole = nearest_motion(system, -10.0, start).state
    # The phase of the spin is free.
    around = rigid_velocity(whole.position_m, 1.0).ravel()
    apart = (balanced.position_m - whole.position_m).ravel()
    apart -= apart @ around / (around @ around) * around
    away = (start.position_m - whole.position_m).ravel()
    assert np.linalg.norm(apart) < 0.02 * np.linalg.norm(away)
    assert closure(integrator, balanced).residual < 4.0 * closure(integrator, whole).residual


def test_what_a_long_ring_leaves_open_is_the_spin_that_damping_takes():
    """Sum of C l'^2 over a turn, taken from the energy I w^2 / 2 of the spin, as loss of speed."""
    system = long_ring(102)
    state = averaged_state(system, -10.0)
    integrator = flow_of(system, -10.0, state)
    start = close_by_harmonic_balance(integrator, state)
    residual = closure(integrator, start).residual
    motion = Propagator(system, -10.0, start)
    r, v = motion.sample(motion.period_s * np.arange(200) / 200)
    first, second = system.tether_ends.T
    e, w = r[:, first] - r[:, second], v[:, first] - v[:, second]
    growth = np.sum(e * w, axis=2) / np.linalg.norm(e, axis=2)
    loss = np.mean(np.sum(system.damping_n_s_per_m * growth**2, axis=1)) * motion.period_s
    inertia = system.mass_kg @ np.sum(r[0] ** 2, axis=1)
    slower = loss / (inertia * integrator.arrays.spin**2)
    predicted = slower * np.linalg.norm(r[0]) / integrator.settings.length
    assert residual == pytest.approx(predicted, rel=0.05)
    assert residual < 1e-5


def test_harmonic_balance_is_cancelled():
    system = long_ring(102)
    state = averaged_state(system, -10.0)
    looks = iter([False])
    with pytest.raises(Cancelled, match="balancing 8 harmonics"):
        close_by_harmonic_balance(flow_of(system, -10.0, state), state, lambda: next(looks, True))


def test_nothing_is_called_stable_while_multipliers_are_missing(monkeypatch):
    """Most multipliers of a long ring lie on the unit circle, where Krylov spaces find none."""
    monkeypatch.setattr("tss_ros.core.stability.leading_multipliers.MOST_TURNS", 4)
    system = long_ring(30)
    result = compute_floquet(system, -10.0, correct=False, leading=6)
    assert result.verdict == "undecided"
    assert "of 6 leading multipliers found in 4 turns" in result.message
    assert np.any(result.residual > 1e-6)


def test_krylov_space_of_a_known_matrix():
    values = np.concatenate([[3.0, -2.5, 2.0], np.linspace(-1.0, 1.0, 57)])
    turned = np.linalg.qr(np.random.default_rng(3).standard_normal((60, 60)))[0]
    matrix = turned * values @ turned.T
    start = np.random.default_rng(4).standard_normal((60, 2))
    *_, (basis, image) = arnoldi(lambda x: matrix @ x, start, 14)
    np.testing.assert_allclose(basis.T @ basis, np.eye(28), atol=1e-12)
    np.testing.assert_allclose(image, matrix @ basis, atol=1e-12)
    ritz = np.sort(np.abs(np.linalg.eigvals(basis.T @ image)))[::-1]
    np.testing.assert_allclose(ritz[:3], [3.0, 2.5, 2.0], atol=1e-6)


def test_number_of_leading_multipliers_is_checked():
    with pytest.raises(TssError, match="leading must be from 1 to 17, got 18"):
        compute_floquet(ring(), -2.5, leading=18)
