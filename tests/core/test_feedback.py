"""Feedback by thrusters: the law, its derivatives, and the closed loop against closed forms."""

import math
from dataclasses import replace

import numpy as np
import pytest
from differences import assert_variations_are_differences, differences
from scipy.integrate import solve_ivp

from tss_ros.core import (
    Propagator,
    State,
    TssError,
    averaged_state,
    compute_floquet,
    disturbed,
    find_critical_rates,
    formation,
    initial_state,
    ring,
)
from tss_ros.core.model import forces
from tss_ros.core.model.feedback import analysed, thrust
from tss_ros.core.motion.integrator import Integrator

SPIN = -2.5
#: What the satellites do, alone and together, without a limit and far beyond it.
GAINS = {
    "damping": {"rotation_damping_n_s_per_m": 0.3},
    "keeping": {"shape_keeping_n_per_m": 2e-3},
    "both": {"rotation_damping_n_s_per_m": 0.3, "shape_keeping_n_per_m": 2e-3},
    "limited": {
        "rotation_damping_n_s_per_m": 0.3, "shape_keeping_n_per_m": 2e-3, "thrust_limit_n": 0.02,
    },
}  # fmt: skip
by_gains = pytest.mark.parametrize("gains", GAINS.values(), ids=GAINS)


def a_ring(**options):
    """Six beads, five of them satellites of several masses, under linear gravity."""
    options = {"linear_gravity": True, "bilateral": True} | options
    return ring(
        satellites=5, satellite_mass_kg=[100.0, 150.0, 80.0, 200.0, 120.0],
        beads_per_tether=[1, 0, 0, 0, 0], bead_mass_kg=15.0, damping_n_s_per_m=40.0, **options,
    )  # fmt: skip


def a_state(system, metres, spin=SPIN, seed=1):
    start, rng = initial_state(system, spin), np.random.default_rng(seed)
    r = start.position_m + rng.normal(0.0, metres, (system.n, 3))
    v = start.velocity_m_s + rng.normal(0.0, 1e-3 * metres, (system.n, 3))
    return State(r, v)


def printed_thrust(system, spin, shape, r, v):
    """The law as the documentation prints it, its angle found by a singular value decomposition."""
    law, chosen, z = system.law_parameters, system.is_satellite, np.array([0.0, 0.0, 1.0])
    nominal = shape[chosen] - shape[chosen].mean(axis=0)
    d, e = (x[chosen] - x[chosen].mean(axis=0) for x in (r, v))
    left, _, right = np.linalg.svd(d[:, :2].T @ nominal[:, :2])
    turn = np.eye(3)
    turn[:2, :2] = left @ np.diag([1.0, np.linalg.det(left @ right)]) @ right
    u = -law["rotation_damping_n_s_per_m"] * (e - system.spin_rate_rad_s(spin) * np.cross(z, d))
    u -= law["shape_keeping_n_per_m"] * (d - nominal @ turn.T)
    if limit := law["thrust_limit_n"]:
        u /= np.sqrt(1.0 + np.sum(u**2, axis=1, keepdims=True) / limit**2)
    result = np.zeros_like(r)
    result[chosen] = u
    return result


# -- the law ---------------------------------------------------------------------------------------


@by_gains
def test_the_thrust_is_the_printed_formula(gains):
    system = a_ring(**gains)
    state = a_state(system, 30.0)
    shape = initial_state(system, SPIN).position_m
    expected = printed_thrust(system, SPIN, shape, state.position_m, state.velocity_m_s)
    found = thrust(system, SPIN, state)
    assert np.abs(expected).max() > 5e-3
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-9 * np.abs(expected).max())
    assert not found[~system.is_satellite].any()


@by_gains
def test_the_closed_loop_moves_as_an_independent_integration_says(gains):
    """scipy's DOP853 in the orbit frame: linear gravity, Coriolis force, tethers, printed law."""
    system = a_ring(**gains)
    state, n2 = a_state(system, 30.0), system.mean_motion_rad_s**2
    shape = initial_state(system, SPIN).position_m
    first, second = system.tether_ends.T
    stiffness = system.axial_stiffness_n / system.rest_length_m

    def derivative(_, x):
        r, v = x.reshape(2, system.n, 3)
        force = printed_thrust(system, SPIN, shape, r, v)
        arm, w = r[first] - r[second], v[first] - v[second]
        length = np.linalg.norm(arm, axis=1)
        pull = stiffness * (length - system.rest_length_m)
        pull += system.damping_n_s_per_m * np.sum(arm * w, axis=1) / length
        np.add.at(force, first, -(pull / length)[:, None] * arm)
        np.add.at(force, second, (pull / length)[:, None] * arm)
        a = force / system.mass_kg[:, None] + n2 * r * [0.0, 3.0, -1.0]
        a[:, 0] += 2.0 * math.sqrt(n2) * v[:, 1]
        a[:, 1] -= 2.0 * math.sqrt(n2) * v[:, 0]
        return np.concatenate([v.ravel(), a.ravel()])

    x = np.concatenate([state.position_m.ravel(), state.velocity_m_s.ravel()])
    end = 300.0
    solution = solve_ivp(derivative, (0.0, end), x, "DOP853", rtol=1e-11, atol=1e-8)
    assert solution.success
    r, v = solution.y[:, -1].reshape(2, system.n, 3)
    ours, speed = Propagator(system, SPIN, state, rtol=1e-11).sample([end])
    np.testing.assert_allclose(ours[0], r, rtol=0.0, atol=2e-5)
    np.testing.assert_allclose(speed[0], v, rtol=0.0, atol=2e-7)
    without = Propagator(a_ring(), SPIN, state).sample([end])[0]
    assert np.abs(without[0] - r).max() > 1.0


@pytest.mark.parametrize("turning", [True, False])
@by_gains
def test_the_jacobian_of_feedback_is_the_limit_of_differences(gains, turning):
    """All of it, of satellites that no tether joins, too, in both frames of the kernels."""
    system = a_ring(**gains)
    state, symbolic = a_state(system, 30.0), analysed(system)
    integrator = Integrator(system, system.spin_rate_rad_s(SPIN), 1e-9, 1e4)
    arrays = integrator.arrays._replace(acting=0)
    if not turning:
        arrays = arrays._replace(spin=0.0)
    r, none = state.position_m, np.zeros(system.m, dtype=bool)
    v = state.velocity_m_s - arrays.spin * np.cross([0.0, 0.0, 1.0], r)
    by_r, by_v = np.empty((2, symbolic.row.size, 3, 3))
    forces.jacobian(arrays, symbolic.pair, none, 0.0, v, r, by_r, by_v)

    def acceleration(v, r):
        a = np.empty_like(r)
        forces.acceleration(arrays, none, 0.0, v, r, a)
        return a

    for blocks, x, of, step in (
        (by_r, r, lambda r: acceleration(v, r), 0.2),
        (by_v, v, lambda v: acceleration(v, r), 4e-4),
    ):
        matrix = np.zeros((system.n, 3, system.n, 3))
        matrix[symbolic.row, :, symbolic.column, :] = blocks
        expected = differences(of, x, step).reshape(matrix.shape)
        np.testing.assert_allclose(matrix, expected, atol=2e-7 * np.abs(expected).max())
    assert symbolic.row.size == system.n + 2 * 12  # ten pairs of satellites, two of the bead


@pytest.mark.parametrize("gains", ["both", "limited"])
def test_variations_of_the_closed_loop_are_differences_of_motions(gains):
    """With the limit the thrust comes from far beyond it, and the matrix has no jump to make."""
    system = a_ring(**GAINS[gains])
    spin = system.spin_rate_rad_s(SPIN)
    integrator = Integrator(system, spin, 1e-13, 1e4)
    state = a_state(system, 30.0)
    with_it = assert_variations_are_differences(integrator, state, 400.0, 3e-5, 1e-8)
    free = Integrator(a_ring(), spin, 1e-13, 1e4)
    without = assert_variations_are_differences(free, state, 400.0, 3e-5, 1e-8)
    assert np.abs(with_it - without).max() > 0.1


def test_thrusts_have_no_sum_and_those_that_keep_the_shape_no_torque():
    for name in ("damping", "keeping", "both"):
        system = a_ring(**GAINS[name])
        state = a_state(system, 30.0)
        force = thrust(system, SPIN, state)
        assert np.abs(force.sum(axis=0)).max() < 1e-13 * np.abs(force).sum()
        torque = np.cross(state.position_m, force).sum(axis=0)[2]
        arm = np.abs(state.position_m).max() * np.abs(force).sum()
        assert (abs(torque) < 1e-12 * arm) == (name == "keeping")


def test_a_formation_that_is_moved_and_turned_is_thrust_alike():
    system = a_ring(**GAINS["limited"])
    state, angle = a_state(system, 30.0), 0.7
    c, s = math.cos(angle), math.sin(angle)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    moved = State(
        state.position_m @ turn.T + [1e3, -2e3, 500.0], state.velocity_m_s @ turn.T + [3.0, 1.0, -2]
    )
    expected = thrust(system, SPIN, state) @ turn.T
    np.testing.assert_allclose(thrust(system, SPIN, moved), expected, rtol=0.0, atol=1e-12)


def test_a_rigid_turn_at_the_rate_asked_about_needs_no_thrust():
    system = ring(satellites=3, beads_per_tether=1, **GAINS["both"])
    for spin in (SPIN, 3.0):
        assert np.abs(thrust(system, spin, averaged_state(system, spin))).max() < 1e-9


def test_no_thrust_exceeds_its_limit():
    system = a_ring(**GAINS["limited"])
    size = np.linalg.norm(thrust(system, SPIN, a_state(system, 3e3)), axis=1)
    assert 0.0199 < size[system.is_satellite].min() <= size.max() < 0.02


def test_what_feedback_cannot_do_is_refused():
    system = a_ring(**GAINS["both"])
    with pytest.raises(TssError, match="'taylor' needs forces .* thrusters or reels follow laws"):
        Integrator(system, system.spin_rate_rad_s(SPIN), 1e-9, 1e4, integrator="taylor")
    tilted = replace(system, spin_axis=[0.6, 0.0, 0.8])
    with pytest.raises(TssError, match=r"orbit normal, \[0, 0, 1\], but spin_axis is \[0.6, 0"):
        Integrator(tilted, system.spin_rate_rad_s(SPIN), 1e-9, 1e4)


# -- closed loops ----------------------------------------------------------------------------------


def stiff_ring(**options):
    """Three equal satellites that move as a rigid body, but for tethers that hardly stretch."""
    return ring(
        satellites=3, axial_stiffness_n=5e6, damping_n_s_per_m=200.0, linear_gravity=True,
        bilateral=True, **options,
    )  # fmt: skip


def of_family(result, family):
    """Multipliers of a family, largest modulus first."""
    return result.multiplier[np.array(result.family) == family]


def rigid_tilt(ratio, damping, keeping):
    """Exponents over Omega of the axis of a flat rigid ring, c/m over Omega and k/m over Omega^2.

    With z = p X + q Y of a bead at X, Y in the orbit plane, the torques of gravity and of thrusters
    that see p' + w q and q' - w p give two coupled equations of the second order.
    """
    one = np.array([1.0, damping, 1.0 + 2.0 * ratio + keeping])
    other = np.array([1.0, damping, 4.0 + 2.0 * ratio + keeping])
    across = ratio * np.array([2.0, damping])
    return np.roots(np.polyadd(np.polymul(one, other), np.polymul(across, across)))


@pytest.mark.parametrize("ratio", [-3.0, -2.3, -1.5, -0.8, 1.2])
@pytest.mark.parametrize(("damping", "keeping"), [(0.2, 0.0), (1.2, 0.0), (0.3, 0.7)])
def test_the_axis_of_a_rigid_ring_obeys_its_closed_form(ratio, damping, keeping):
    system = stiff_ring()
    rate, mass = system.orbit_rate_rad_s, 100.0
    gains = {
        "rotation_damping_n_s_per_m": damping * mass * rate,
        "shape_keeping_n_per_m": keeping * mass * rate**2,
    }
    result = compute_floquet(stiff_ring(**gains), ratio, certify=False)
    expected = np.exp(rigid_tilt(ratio, damping, keeping) * 2.0 * math.pi / abs(ratio))
    found = of_family(result, "axis tilt")
    assert found.size == 4
    for sort in (np.abs, np.real):
        np.testing.assert_allclose(np.sort(sort(found)), np.sort(sort(expected)), rtol=2e-3,
                                   atol=2e-3)  # fmt: skip
    grows = np.abs(expected).max() > 1.001
    assert (result.verdict == "unstable") == grows


def test_feedback_leaves_the_centre_of_mass_alone_and_brings_the_spin_back():
    """1, 1 and exp(+-i Omega T) twice for the one, 1 and exp(-c T/m) for the other."""
    system = stiff_ring(rotation_damping_n_s_per_m=0.05)
    result = compute_floquet(system, SPIN)
    angle = 2.0 * math.pi / SPIN
    centre = of_family(result, "centre of mass")
    expected = np.exp(1j * angle * np.array([1, 1, -1, -1, 0, 0]))
    apart = np.abs(centre[:, None] - expected).min(axis=0)
    assert apart[:4].max() < 1e-6 and apart[4:].max() < 1e-3
    held = math.exp(-0.05 / 100.0 * result.period_s)
    np.testing.assert_allclose(np.abs(of_family(result, "spin")), [1.0, held], atol=2e-4)
    assert result.verdict == "asymptotically stable"


def test_the_band_of_unstable_axes_shrinks_as_its_closed_form_says():
    """(1 + 2 w) (4 + 2 w) + (w c/(m Omega))^2 = 0 at its faster end; -2 without feedback."""
    damping = 0.5
    system = stiff_ring()
    gain = damping * 100.0 * system.orbit_rate_rad_s
    found = find_critical_rates(
        stiff_ring(rotation_damping_n_s_per_m=gain), -2.2, -1.6, spacing=0.2
    )
    edge = (-10.0 - math.sqrt(100.0 - 16.0 * (4.0 + damping**2))) / (2.0 * (4.0 + damping**2))
    assert len(found) == 1 and edge == pytest.approx(-1.842, abs=1e-3)
    assert found[0].spin_rate_ratio == pytest.approx(edge, abs=2e-3)


@by_gains
def test_a_closed_loop_carries_its_proofs(gains):
    """Through slack and with limited thrust the motion closes, and the matrix adds up."""
    result = compute_floquet(ring(damping_n_s_per_m=1000.0, **gains), -2.2)
    assert result.switches == 12 and result.closure_residual < 1e-8
    assert result.liouville_error < 1e-6
    assert max(result.segment_error, result.convergence_error, result.flow_error) < 1e-6


@pytest.mark.parametrize("gains", ["damping", "both"])
def test_multipliers_with_limited_thrust_are_those_of_differences_through_switches(gains):
    """The thrust comes into its limit and out of it, and the tethers switch twelve times."""
    limit = 0.02
    system = ring(damping_n_s_per_m=1000.0, **GAINS[gains], thrust_limit_n=limit)
    result = compute_floquet(system, -2.2, certify=False)
    assert result.switches == 12
    times = np.linspace(0.0, result.period_s, 100)
    r, v = Propagator(system, -2.2, result.state).sample(times)
    size = np.linalg.norm([thrust(system, -2.2, State(*x)) for x in zip(r, v)], axis=2)
    assert size.min() < 0.4 * limit and 0.99 * limit < size.max() < limit
    integrator = Integrator(system, result.spin_rate_rad_s, 1e-13, 1e4).driven(result.spin_loss)
    matrix = assert_variations_are_differences(
        integrator, result.state, result.period_s, 5e-8, 1e-6, switches=12
    )
    found, expected = (np.sort(np.abs(x)) for x in (np.linalg.eigvals(matrix), result.multiplier))
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-6)
    assert result.deciding_modulus < 0.2


def test_feedback_gives_back_the_spin_that_is_lost():
    """What the message says it aims at closes the true motion: nothing else drives it.

    But for the orbit, which gives the torque of gravity: the formation drifts along it as a whole.
    """
    system = ring(rotation_damping_n_s_per_m=0.2, damping_n_s_per_m=1000.0)
    result = compute_floquet(system, -2.2, certify=False)
    assert result.spin_loss > 5e-3
    aim = float(result.message.split("aims at ")[1].split()[0])
    length = np.abs(result.state.position_m).max()

    def left(aim):
        motion = Propagator(system, aim, result.state, rtol=1e-11)
        r, v = motion.sample([result.period_s])
        r, v = r[0] - result.state.position_m, v[0] - result.state.velocity_m_s
        assert np.abs(r.mean(axis=0)).max() < 0.1
        r, v = (np.abs(x - x.mean(axis=0)).max() / length for x in (r, v))
        return max(r, v / abs(result.spin_rate_rad_s))

    assert left(aim) < 1e-7 < 1e-3 < left(-2.2)


def test_the_shape_swings_for_ever_without_feedback_and_settles_with_it():
    """Six beads at -2.9: multipliers, and a disturbed motion after twenty turns."""
    swings = []
    for gain, verdict in ((0.0, "neutral"), (20.0, "asymptotically stable")):
        system = ring(
            satellites=3, satellite_mass_kg=1000.0, beads_per_tether=1, bead_mass_kg=10.0,
            damping_n_s_per_m=100.0, rotation_damping_n_s_per_m=gain,
        )  # fmt: skip
        result = compute_floquet(system, -2.9, certify=False)
        assert result.verdict == verdict
        shape = np.abs(of_family(result, "shape")).max()
        start, turns = disturbed(result.state, 10.0, seed=1), 40
        r, _ = Propagator(system, -2.9, start).sample(
            result.period_s * np.linspace(0.0, turns, 40 * turns + 1)
        )
        out = np.abs(r[..., 2] - r[..., 2].mean(axis=1, keepdims=True)).max(axis=1)
        swings.append((shape, out[:80].max(), out[-80:].max()))
    (neutral, at_first, at_last), (settling, begun, settled) = swings
    assert neutral == pytest.approx(1.0, abs=1e-6) and at_last > 0.9 * at_first
    assert settling < 0.985 and settled < 2.0 * settling**36 * begun


@pytest.mark.parametrize("keeping", [0.0, 0.5])
def test_a_hanging_dumbbell_obeys_its_closed_form(keeping):
    """Librations lambda^2 + d lambda + 3 = 0 in the plane and, with k, + 4 + k/m out of it."""
    dumbbell = formation("chain", satellites=2, damping_n_s_per_m=100.0, linear_gravity=True)
    rate = dumbbell.orbit_rate_rad_s
    system = replace(dumbbell, law_parameters={
        "rotation_damping_n_s_per_m": 0.4 * dumbbell.mass_kg[0] * rate,
        "shape_keeping_n_per_m": keeping * dumbbell.mass_kg[0] * rate**2,
    })  # fmt: skip
    result = compute_floquet(system, 0.0)
    found = result.exponent[np.array(result.family) == "libration"] / rate
    expected = np.concatenate([np.roots([1.0, 0.4, 3.0]), np.roots([1.0, 0.4, 4.0 + keeping])])
    np.testing.assert_allclose(np.sort_complex(found), np.sort_complex(expected), atol=2e-3)
    assert result.liouville_error < 1e-6 and result.segment_error < 1e-6
