"""Formations that hang at rest in the orbit frame, a spin rate of 0, against closed forms."""

import math
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tss_ros.core import (
    FloquetJob,
    FloquetResult,
    NoSteadyState,
    Propagator,
    Satellite,
    State,
    Tether,
    TssError,
    assemble,
    averaged_state,
    compute_floquet,
    compute_modes,
    confirm,
    disturbed,
    find_critical_rates,
    follow,
    formation,
    initial_state,
    mode_motion,
    name_resonance,
    ring,
    simulate,
    sweep,
    tether_state,
)
from tss_ros.core.model.equilibria import equilibrium
from tss_ros.core.model.system import MU_EARTH
from tss_ros.core.motion.displacements import carry_displacements
from tss_ros.core.motion.integrator import Integrator
from tss_ros.core.stability.confirmation import UndisturbedMotion
from tss_ros.scenarios.files import load_yaml

#: Stiff and light: the closed forms are those of tethers that do not stretch.
STIFF = {"axial_stiffness_n": 5e6, "tether_length_m": 1000.0, "damping_n_s_per_m": 0.0}


def chain(masses, lengths=(1000.0,), **more):
    return formation(
        "chain", len(masses), satellite_mass_kg=list(masses),
        **{**STIFF, "tether_length_m": list(lengths), "linear_gravity": True, **more},
    )  # fmt: skip


def laid_out(places, tethers, **more):
    """A system of 100 kg satellites; tethers as (ends, rest length)."""
    satellites = [Satellite(f"s{i}", 100.0, tuple(map(float, r))) for i, r in enumerate(places)]
    joined = [
        Tether(f"t{k}", ends, (length,), (5e4,), (0.0,)) for k, (ends, length) in enumerate(tethers)
    ]
    return assemble(satellites, joined, **more)


def frequencies(system, result, direction):
    """Frequencies over Omega of librations and bending, slowest first; stretch is left out."""
    modes = compute_modes(system, result)
    found = [
        mode.frequency
        for mode in modes
        if mode.direction == direction and mode.multiplier.imag >= 0.0
        and mode.family in ("libration", "shape") and mode.frequency < 50.0
    ]  # fmt: skip
    rates = result.exponent.imag / system.orbit_rate_rad_s
    assert all(min(abs(rates - f)) < 1e-12 for f in found)
    return np.unique(np.round(found, 9))


def left(system, state):
    """Largest acceleration of a bead that should rest [m/s^2], by the motion's own integrator."""
    end = 1.0
    position, _ = Propagator(system, 0.0, state, rtol=1e-12).sample(np.array([end]))
    return np.max(np.abs(position[0] - state.position_m)) * 2.0 / end**2


# --- equilibria


@pytest.mark.parametrize("count", [2, 3, 4, 5])
def test_tension_is_three_omega_squared_times_the_masses_heights_above(count):
    system = chain([100.0] * count)
    state = initial_state(system, 0.0)
    assert state.origin == "equilibrium of the orbit frame" and not state.velocity_m_s.any()
    _, tension, taut = tether_state(system, state.position_m, state.velocity_m_s)
    heights = state.position_m[:, 1]
    expected = 3.0 * 100.0 * system.orbit_rate_rad_s**2 * np.cumsum(heights)[:-1]
    np.testing.assert_allclose(tension, expected, rtol=1e-8)
    assert taut.all() and left(system, state) < 1e-12


@pytest.mark.parametrize("linear", [True, False], ids=["linear gravity", "full gravity"])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_layout_that_is_somewhat_off_leads_to_the_same_equilibrium(linear, seed):
    system = formation("chain", 4, satellite_mass_kg=[50.0, 400.0, 20.0, 100.0],
                       beads_per_tether=2, bead_mass_kg=3.0, linear_gravity=linear)  # fmt: skip
    rested = initial_state(system, 0.0).position_m
    noise = np.random.default_rng(seed).standard_normal(rested.shape)
    moved = system.layout_m + 0.02 * np.max(np.abs(rested)) * noise
    np.testing.assert_allclose(equilibrium(replace(system, layout_m=moved)), rested, atol=1e-6)
    tilt = math.radians(25.0)
    turn = [[math.cos(tilt), -math.sin(tilt), 0], [math.sin(tilt), math.cos(tilt), 0], [0, 0, 1]]
    tilted = replace(system, layout_m=system.layout_m @ np.array(turn).T)
    np.testing.assert_allclose(equilibrium(tilted), rested, atol=1e-6)


def test_in_full_gravity_the_centre_of_mass_lies_off_the_origin():
    """Each bead in balance by mu/q^2, Omega^2 q and tension alone, summed in the vertical."""
    system = chain([300.0, 500.0], [20e3], linear_gravity=False)
    state = initial_state(system, 0.0)
    _, (tension,), _ = tether_state(system, state.position_m, state.velocity_m_s)
    q = state.position_m[:, 1] + system.orbit_radius_m
    outward = system.mass_kg * (MU_EARTH / system.orbit_radius_m**3 * q - MU_EARTH / q**2)
    np.testing.assert_allclose(outward, [tension, -tension], rtol=1e-7)
    assert abs(np.average(state.position_m[:, 0], weights=system.mass_kg)) < 1e-9
    centre = np.average(state.position_m[:, 1], weights=system.mass_kg)
    # To second order: sum m (3 y - 3 y^2 / R) = 0 in units of Omega^2.
    second = np.average(state.position_m[:, 1] ** 2, weights=system.mass_kg)
    assert centre == pytest.approx(second / system.orbit_radius_m, rel=0.01) and centre > 10.0


def test_a_heavy_tether_hangs_as_its_catenary_does():
    """d tension / d height = -3 Omega^2 (density) height: a parabola, in linear gravity."""
    system = chain([100.0, 100.0], [1000.0], beads_per_tether=39, bead_mass_kg=10.0)
    state = initial_state(system, 0.0)
    _, tension, _ = tether_state(system, state.position_m, state.velocity_m_s)
    first, second = system.tether_ends.T
    height = 0.5 * (state.position_m[first, 1] + state.position_m[second, 1])
    # The sum over the beads above is the integral from this height to half a segment below the end.
    rate, density, end, last = system.orbit_rate_rad_s, 10.0 / 25.0, 500.0, 487.5
    parabola = 3.0 * rate**2 * (100.0 * end + 0.5 * density * (last**2 - height**2))
    np.testing.assert_allclose(tension, parabola, rtol=1e-6)


def test_a_tether_that_is_too_long_hangs_slack_and_is_named():
    system = laid_out(
        [(0, 1000, 0), (0, 0, 0), (0, -1000, 0)],
        [((0, 1), 1000.0), ((1, 2), 1000.0), ((0, 2), 2500.0)], linear_gravity=True,
    )  # fmt: skip
    result = compute_floquet(system, 0.0)
    assert result.verdict == "neutral" and "never taut: t2" in result.message
    without = laid_out([(0, 1000, 0), (0, 0, 0), (0, -1000, 0)],
                       [((0, 1), 1000.0), ((1, 2), 1000.0)], linear_gravity=True)  # fmt: skip
    np.testing.assert_allclose(
        np.sort_complex(result.exponent), np.sort_complex(compute_floquet(without, 0.0).exponent),
        atol=1e-8,
    )  # fmt: skip


# --- refusals

ALONG = [(0, 0, 0), (1000, 0, 0), (2000, 0, 0)]
LINKS = [((0, 1), 1000.0), ((1, 2), 1000.0)]


@pytest.mark.parametrize(
    "system, named",
    [
        (laid_out(ALONG, LINKS, linear_gravity=True), "nothing pulls t"),
        (laid_out(ALONG, LINKS), "nothing pulls t"),
        (laid_out([(0, 0, 0), (0, 0, 1000)], LINKS[:1]), "push, t0 by 0.0496 N"),
        (ring(), r"tethers would have to push, tether_2 by 0\.\d+ N"),
        (ring(4), "no equilibrium found"),
        (formation("double_pyramid", 4, tether_length_m=[1000.0] * 4 + [3000.0] * 8,
                   spin_axis=[0.0, 1.0, 0.0]), "would have to push, tether_.* and 1 more"),
    ],
    ids=["along the orbit", "the same, full gravity", "across it", "triangle", "square",
         "pyramid"],
)  # fmt: skip
def test_where_nothing_hangs_the_reason_is_named(system, named):
    with pytest.raises(NoSteadyState, match=named) as refused:
        initial_state(system, 0.0)
    assert "spin_rate_ratio 0" in str(refused.value)
    result = compute_floquet(system, 0.0)
    assert result.verdict == "none found" and result.message == str(refused.value)
    assert not result.family and result.exponent.size == 0


@pytest.mark.parametrize(
    "orbit, named",
    [
        ({"eccentricity": 0.1}, "the orbit is an ellipse of eccentricity 0.1"),
        ({"inclination_deg": 30.0, "j2": 1e-3}, "j2 acts on .* inclined by 30"),
        ({"perturbations": ["solar_pressure"]}, "solar_pressure acts, whose"),
    ],
)
def test_nothing_rests_where_forces_depend_on_time(orbit, named):
    with pytest.raises(NoSteadyState, match=named):
        equilibrium(formation("chain", 2, **orbit))


def test_the_force_across_the_orbit_is_that_of_the_closed_form():
    """Two satellites of 100 kg at z = +-500 m are pressed together by m Omega^2 z each."""
    system = laid_out([(0, 0, 0), (0, 0, 1000)], LINKS[:1], linear_gravity=True)
    push = 100.0 * system.orbit_rate_rad_s**2 * 500.0
    with pytest.raises(NoSteadyState, match=f"t0 by {push:.3g} N"):
        initial_state(system, 0.0)


def test_what_only_a_spin_has_is_refused_without_one():
    system = formation("chain", 3)
    with pytest.raises(TssError, match="spin_rate_ratio of a rotating state must not be 0"):
        averaged_state(system, 0.0)
    with pytest.raises(TssError, match="spin_rate_ratio must not be 0 to follow"):
        follow(system, "damping_n_s_per_m", 1.0, 2.0, spin_rate_ratio=0.0)
    with pytest.raises(TssError, match="spin_rate_ratio must keep its sign, got 0 to 1"):
        follow(system, "spin_rate_ratio", 0.0, 1.0)
    assert find_critical_rates(system, -0.04, 0.04) == []  # slower than any that is looked at


def test_a_start_that_does_not_rest_is_refused_where_it_is_not_to_be_corrected():
    system = chain([100.0, 100.0])
    state = initial_state(system, 0.0)
    kept = compute_floquet(system, 0.0, state=state, correct=False)
    assert kept.verdict == "neutral" and "the given state" in kept.message
    pushed = disturbed(state, 1.0, 3)
    bad = compute_floquet(system, 0.0, state=pushed, correct=False)
    assert bad.verdict == "none found" and "left out of balance by" in bad.message
    moving = State(state.position_m, np.full((2, 3), 0.5))
    bad = compute_floquet(system, 0.0, state=moving, correct=False)
    assert "move at up to 0.5 m/s" in bad.message
    mended = compute_floquet(system, 0.0, state=pushed)
    np.testing.assert_allclose(mended.state.position_m, state.position_m, atol=1e-7)
    with pytest.raises(TssError, match="state must be of 2 beads"):
        compute_floquet(system, 0.0, state=State(np.zeros((3, 3)), np.zeros((3, 3))))
    with pytest.raises(TssError, match="leading must be from 1 to 11, got 12"):
        compute_floquet(system, 0.0, leading=12)


# --- exponents


@pytest.mark.parametrize("count", [2, 3, 4, 5])
def test_chains_of_equal_masses_swing_as_misra_and_modi_say(count):
    system = chain([100.0] * count)
    result = compute_floquet(system, 0.0)
    k = np.arange(1, count)
    inside = np.sqrt(1.5 * k * (k + 1.0))
    assert frequencies(system, result, "in plane") == pytest.approx(inside, rel=2e-6)
    outside = np.sqrt(inside**2 + 1.0)
    assert frequencies(system, result, "out of plane") == pytest.approx(outside, rel=2e-6)
    counts = Counter(result.family)
    assert counts == {"centre of mass": 6, "libration": 4, "shape": 6 * count - 10}
    assert result.verdict == "neutral" and result.max_modulus_nontrivial - 1.0 < 1e-9
    assert result.trivial_error < 1e-9 and result.segment_error < 1e-7
    assert result.liouville_error < 1e-6 and result.closure_residual < 1e-9


@pytest.mark.parametrize("seed", range(4))
def test_out_of_the_plane_every_chain_swings_faster_by_one(seed):
    """omega_out^2 = omega_in^2 + Omega^2 whatever the masses and lengths."""
    random = np.random.default_rng(seed)
    count = int(random.integers(3, 6))
    system = chain(random.uniform(20.0, 500.0, count), random.uniform(300.0, 3000.0, count - 1),
                   axial_stiffness_n=5e7)  # fmt: skip
    result = compute_floquet(system, 0.0, certify=False)
    inside, outside = (frequencies(system, result, d) for d in ("in plane", "out of plane"))
    assert inside.size == count - 1
    assert inside[0] == pytest.approx(math.sqrt(3.0), rel=1e-6)
    np.testing.assert_allclose(outside**2, inside**2 + 1.0, rtol=1e-6)


def test_in_full_gravity_they_swing_nearly_so():
    system = chain([100.0] * 3, linear_gravity=False)
    result = compute_floquet(system, 0.0)
    assert frequencies(system, result, "in plane") == pytest.approx([math.sqrt(3), 3], rel=1e-5)
    outside = frequencies(system, result, "out of plane")
    assert outside == pytest.approx([2.0, math.sqrt(10.0)], rel=1e-5)
    assert result.verdict == "neutral" and result.segment_error < 1e-7


def test_the_hanging_pair_of_the_shared_cases():
    content = load_yaml(HANGING_PAIR, "the pair")
    bodies = [
        Satellite(body["name"], body["mass_kg"], tuple(body["position_m"]))
        for body in content["bodies"]
    ]
    (tether,) = content["tethers"]
    joined = Tether("tether", (0, 1), (tether["length_m"],), (tether["axial_stiffness_n"],),
                    (tether["damping_n_s_per_m"],))  # fmt: skip
    system = assemble(bodies, [joined], content["orbit_altitude_m"])
    result = compute_floquet(system, content["spin_rate_ratio"])
    assert frequencies(system, result, "in plane") == pytest.approx([math.sqrt(3.0)], rel=1e-6)
    assert frequencies(system, result, "out of plane") == pytest.approx([2.0], rel=1e-6)
    _, (tension,), _ = tether_state(system, result.state.position_m, result.state.velocity_m_s)
    assert tension == pytest.approx(3.0 * 250.0 * system.orbit_rate_rad_s**2 * 1000.0, rel=1e-5)
    assert result._facts()["librations"] == "1.73205, 2 an orbit"


HANGING_PAIR = """
spin_rate_ratio: 0.0
orbit_altitude_m: 400000.0
bodies:
  - {name: upper, mass_kg: 500.0, position_m: [0.0, 500.0, 0.0]}
  - {name: lower, mass_kg: 500.0, position_m: [0.0, -500.0, 0.0]}
tethers:
  - {between: [upper, lower], length_m: 1000.0, axial_stiffness_n: 5.0e6,
     damping_n_s_per_m: 0.0}
"""


def test_damping_makes_stretch_decay_and_leaves_swings_out_of_the_plane_alone():
    damping, stiffness, mass = 2000.0, 5e4, 100.0
    system = chain([mass, mass], damping_n_s_per_m=damping, axial_stiffness_n=stiffness)
    result = compute_floquet(system, 0.0)
    assert result.verdict == "asymptotically stable" and result.deciding_family == "shape"
    # The relative length: l'' = -(2/m) (C l' + (EA/L) l), over damped.
    half, square = damping / mass, 2.0 * stiffness / 1000.0 / mass
    root = math.sqrt(half**2 - square)
    stretch = np.sort(result.exponent[np.array(result.family) == "shape"].real)
    # The orbit changes the slow one by (3 + 4) Omega^2 / (2 half), the rest is rounding.
    assert stretch == pytest.approx([-half - root, -half + root], rel=1e-5)
    assert result.multiplier[-1] == 0.0 and result.exponent[-1].real < -30.0
    swings = result.exponent[np.array(result.family) == "libration"]
    out = np.abs(swings.imag / system.orbit_rate_rad_s - 2.0) < 0.01
    assert np.count_nonzero(out | (np.abs(swings.imag / system.orbit_rate_rad_s + 2) < 0.01)) == 2
    assert np.max(np.abs(swings[np.abs(swings.imag) > 1.9 * system.orbit_rate_rad_s].real)) < 1e-14
    # In the plane Coriolis force stretches the tether as it swings, and damping takes a little.
    inside = swings[np.abs(swings.imag) < 1.9 * system.orbit_rate_rad_s].real
    assert np.all(inside < 0.0) and np.all(inside > -1e-4 * system.orbit_rate_rad_s)
    assert result.liouville_error < 1e-6 and result.segment_error < 1e-8


def test_the_in_plane_swing_of_a_damped_pair_decays_as_its_stretch_says():
    """The tension's swing 4 m_r Omega L theta' over the spring: first order in C."""
    damping, mass, length = 10.0, 100.0, 1000.0
    system = chain([mass, mass], damping_n_s_per_m=damping, axial_stiffness_n=5e5)
    result = compute_floquet(system, 0.0, certify=False)
    rate, spring, reduced = system.orbit_rate_rad_s, 5e5 / length, mass / 2.0
    # Stretch s = reduced 2 Omega L theta' / k; power C s'^2 over twice the swing's energy.
    swing = math.sqrt(3.0) * rate
    stretch = 2.0 * reduced * rate * length * swing / spring
    expected = -damping * (stretch * swing) ** 2 / (2.0 * reduced * (length * swing) ** 2)
    found = [
        x.real
        for x, family in zip(result.exponent, result.family)
        if family == "libration" and abs(abs(x.imag) - swing) < 0.01 * rate
    ]
    assert found == pytest.approx([expected] * 2, rel=0.01)


# --- what the exponents agree with


@pytest.mark.parametrize("more", [{}, {"linear_gravity": False}, {"beads_per_tether": 2}])
def test_multipliers_are_those_of_a_matrix_integrated_over_the_orbit(more):
    system = chain([100.0, 300.0], damping_n_s_per_m=50.0, axial_stiffness_n=5e3, **more)
    result = compute_floquet(system, 0.0)
    size = float(np.max(np.linalg.norm(result.state.position_m, axis=1)))
    integrator = Integrator(system, 0.0, 1e-12, size)
    _, matrix = carry_displacements(
        integrator, integrator.begin(result.state), np.eye(6 * system.n), integrator.period_s
    )
    for part in (np.s_[2::3], np.delete(np.arange(6 * system.n), np.s_[2::3])):
        rho = np.linalg.eigvals(matrix[part][:, part])
        inside = (np.abs(result.vectors[part]) ** 2).sum(axis=0) > 0.5
        trivial = np.array(result.family) == "centre of mass"
        for multiplier in result.multiplier[inside & ~trivial]:
            assert np.min(np.abs(rho - multiplier)) < 1e-9


def test_an_independent_integration_of_a_swing_has_the_same_multiplier():
    """The vector of a mode, integrated by scipy with equations written down here."""
    mass, length, stiffness, damping = np.array([100.0, 300.0]), 1000.0, 5e3, 50.0
    system = chain(mass, damping_n_s_per_m=damping, axial_stiffness_n=stiffness)
    result = compute_floquet(system, 0.0)
    rate, reduced = system.orbit_rate_rad_s, 75.0
    # T = 3 Omega^2 m_r l and T = EA (l / L - 1).
    stretched = stiffness / (stiffness / length - 3.0 * rate**2 * reduced)
    np.testing.assert_allclose(np.ptp(result.state.position_m[:, 1]), stretched, rtol=1e-12)
    across = 3.0 * rate**2 * reduced
    spring = np.array([across, stiffness / length, across])

    def flow(_, x):
        v, r = x.reshape(2, 2, 3)
        a = np.stack([2 * rate * v[:, 1], 3 * rate**2 * r[:, 1] - 2 * rate * v[:, 0],
                      -(rate**2) * r[:, 2]], axis=1)  # fmt: skip
        pull = spring * (r[0] - r[1]) + [0.0, damping * (v[0, 1] - v[1, 1]), 0.0]
        a += np.outer([-1.0, 1.0], pull) / mass[:, None]
        return np.concatenate([a.ravel(), v.ravel()])

    size = np.max(np.linalg.norm(result.state.position_m, axis=1))
    scale = np.repeat([size * rate, size], 6)
    for k in np.flatnonzero(np.array(result.family) == "libration"):
        after = 0.0
        for unit in (1.0, 1.0j):
            x = scale * (result.vectors[:, k] / unit).real
            end = solve_ivp(flow, (0.0, result.period_s), x, "DOP853", rtol=1e-12, atol=1e-12)
            after = after + unit * end.y[:, -1] / scale
        missed = after - result.multiplier[k] * result.vectors[:, k]
        assert np.linalg.norm(missed) < 1e-9


def test_frozen_is_exact():
    system = formation("chain", 3, beads_per_tether=1)
    true, frozen = (compute_floquet(system, 0.0, method) for method in ("monodromy", "frozen"))
    np.testing.assert_array_equal(true.multiplier, frozen.multiplier)
    assert (true.verdict, frozen.method) == (frozen.verdict, "frozen")
    assert len(compute_modes(system, frozen)) == 6 * system.n


def test_some_exponents_are_the_leading_ones_of_all():
    system = chain([100.0, 50.0, 70.0])
    every, some = (compute_floquet(system, 0.0, leading=k) for k in (None, 5))
    np.testing.assert_array_equal(some.exponent, every.exponent[:5])
    assert some.vectors.shape == (18, 5) and some.verdict == every.verdict


def test_slow_modes_keep_their_digits_beside_strong_damping():
    """A tether cut into 31 segments with dampers 1e8 times faster than the orbit."""
    system = formation("chain", 2, beads_per_tether=30, linear_gravity=True)
    result = compute_floquet(system, 0.0, certify=False)
    rate = system.orbit_rate_rad_s
    assert result.exponent.real.min() < -1e6 * rate
    centre = result.exponent[np.array(result.family) == "centre of mass"] / rate
    np.testing.assert_allclose(np.sort(np.abs(centre))[2:], 1.0, atol=1e-7)
    assert result.trivial_error < 1e-7
    swings = np.abs(result.exponent[np.array(result.family) == "libration"].imag) / rate
    assert np.sort(swings) == pytest.approx([math.sqrt(3.0)] * 2 + [2.0] * 2, rel=1e-4)


@pytest.mark.long
def test_long_chains_show_the_exponents_that_decay_least():
    system = formation("chain", 2, beads_per_tether=120)
    result = compute_floquet(system, 0.0)
    assert len(result.family) == 12 and result.vectors.shape == (6 * 122, 12)
    assert "the 12 that decay least of 732" in result.message and result.verdict == "neutral"


# --- verdicts


@pytest.mark.parametrize(
    "places, growth",
    [
        # theta'' = 3 Omega^2 theta of a rod along the orbit.
        ([(0, 0, 0), (1000, 0, 0)], [math.sqrt(3.0)]),
        # A rod across the orbit, see below.
        ([(0, 0, 0), (0, 0, 1000)], None),
    ],
    ids=["along the orbit", "across it"],
)  # fmt: skip
def test_rods_that_can_push_are_unstable_where_rods_are(places, growth):
    system = laid_out(places, LINKS[:1], linear_gravity=True, bilateral=True)
    result = compute_floquet(system, 0.0)
    assert result.verdict == "unstable" and result.deciding_family == "libration"
    rate = system.orbit_rate_rad_s
    if growth is None:
        # Of the relative place, constrained to length: x'' = 2 y' + x, y'' = -2 x' + 4 y.
        matrix = np.array([[0, 0, 1, 0], [0, 0, 0, 1], [1, 0, 0, 2], [0, 4, -2, 0.0]])
        growth = np.linalg.eigvals(matrix).real
    assert result.exponent[0].real / rate == pytest.approx(max(growth), rel=1e-5)
    assert result.max_modulus == pytest.approx(math.exp(2 * math.pi * max(growth)), rel=1e-4)
    assert name_resonance(system, result).startswith(
        ("in-plane libration", "out-of-plane libration")
    )
    seen = confirm(system, 0.0, turns=6)
    assert not seen.held and seen.agrees_with(result)


def test_a_hanging_chain_holds_and_a_small_push_does_not_grow():
    system = formation("chain", 3)
    result = compute_floquet(system, 0.0)
    assert result.verdict == "neutral" and result.deciding_family == "shape"
    seen = confirm(system, 0.0)
    assert seen.held and seen.agrees_with(result) and seen.turned == pytest.approx(1.0, abs=0.01)
    assert seen.growth_per_turn == pytest.approx(1.0, abs=1e-2)


def test_a_formation_that_tumbles_in_the_plane_is_lost():
    system = formation("chain", 2)
    state = initial_state(system, 0.0)
    # From theta' = sqrt(3) Omega at the vertical a swing passes the horizontal; this has 2.2.
    x = state.position_m[:, 1] * 2.2 * system.orbit_rate_rad_s
    tumbling = State(state.position_m, np.stack([-x, 0 * x, 0 * x], axis=1))
    seen = UndisturbedMotion(system, 0.0, None, 4).compare(tumbling)
    assert not seen.held and seen.turned > 1.25


def test_a_flat_formation_that_hangs_in_the_plane_has_the_three_librations_of_a_plate():
    system = laid_out([(0, 1000, 0), (300, -500, 0), (-300, -500, 0)],
                      [((0, 1), 1529.7), ((0, 2), 1529.7), ((1, 2), 600.0)],
                      linear_gravity=True, bilateral=True)  # fmt: skip
    result = compute_floquet(system, 0.0)
    assert Counter(result.family) == {"centre of mass": 6, "libration": 6, "shape": 6}
    # Inertia about the flight axis, the vertical and the orbit normal: A, B and A + B.
    place = result.state.position_m
    a, b = system.mass_kg @ place[:, 1] ** 2, system.mass_kg @ place[:, 0] ** 2
    pitch, roll, yaw = math.sqrt(3.0 * (a - b) / (a + b)), 2.0, 1.0
    rates = [
        abs(x.imag) / system.orbit_rate_rad_s
        for x, family in zip(result.exponent, result.family)
        if family == "libration"
    ]
    np.testing.assert_allclose(np.sort(rates), np.repeat(sorted((pitch, roll, yaw)), 2), rtol=1e-4)


def test_drag_is_left_out_and_named():
    system = formation("chain", 2, perturbations=["drag", "j2"])
    result = compute_floquet(system, 0.0)
    assert "drag left out" in result.message and "j2 left out" not in result.message
    without = compute_floquet(formation("chain", 2, perturbations=["j2"]), 0.0)
    np.testing.assert_array_equal(result.multiplier, without.multiplier)


# --- the rest of the interface


def test_modes_move_along_the_orbit_as_their_multiplier_says():
    system = chain([100.0, 100.0, 100.0])
    result = compute_floquet(system, 0.0)
    for k, mode in enumerate(compute_modes(system, result)):
        motion = mode_motion(system, result, k)
        np.testing.assert_allclose(motion.shape[-1], motion.shape[0] * result.multiplier[k],
                                   atol=1e-12)  # fmt: skip
        np.testing.assert_allclose(motion.shape[0], mode.shape, atol=1e-12)
        assert mode.wave_number == -1 and f"{mode.frequency:.3f} an orbit" in mode.in_words
    swing = next(m for m in compute_modes(system, result) if abs(m.frequency - 2.0) < 1e-3)
    assert swing.in_words == "out-of-plane libration (2.000 an orbit)"


def test_exponents_are_saved_and_shown(tmp_path):
    result = compute_floquet(chain([100.0, 100.0]), 0.0)
    result.save(tmp_path / "result.npz")
    again = FloquetResult.load(tmp_path / "result.npz")
    np.testing.assert_array_equal(again.exponent, result.exponent)
    frame = pytest.importorskip("pandas") and result.to_pandas()
    assert list(frame["exponent"]) == list(result.exponent)
    assert compute_floquet(ring(), -2.5, certify=False).exponent.size == 0
    assert "librations" in result._repr_html_()


def test_a_motion_of_a_hanging_formation_is_simulated_in_orbits():
    system = formation("chain", 2, damping_n_s_per_m=0.0)
    motion = simulate(system, 0.0, turns=2.0)
    assert motion.t_s[-1] == pytest.approx(2.0 * 2.0 * math.pi / system.orbit_rate_rad_s)
    np.testing.assert_allclose(
        motion.position_m, motion.position_m[:1] + np.zeros((201, 1, 1)), atol=1e-6
    )
    np.testing.assert_array_equal(motion.turning_m, motion.position_m)
    pushed = simulate(system, 0.0, turns=1.0, disturbance_m=50.0)
    assert np.ptp(pushed.energy_j) < 1e-6 * np.ptp(
        0.5 * np.sum(pushed.velocity_m_s**2, axis=2) @ system.mass_kg
    )


def test_a_sweep_answers_for_hanging_systems_beside_others():
    jobs = [FloquetJob(formation("chain", 2), 0.0), FloquetJob(ring(), 0.0)]
    outcomes = dict(sweep(jobs))
    assert outcomes[0].verdict == "asymptotically stable"
    assert outcomes[1].verdict == "none found"
