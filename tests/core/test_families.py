"""Which motion is found: the formation's own family, what counts as a motion, and what is said."""

import math

import numpy as np
import pytest

from tss_ros.core import (
    State,
    TssError,
    compute_floquet,
    confirm,
    find_critical_rates,
    formation,
    initial_state,
    ring,
)
from tss_ros.core.stability.closing import CLOSED
from tss_ros.core.stability.follow import follow
from tss_ros.scenarios import scenario

#: Law of a rigid pendulum that turns in the orbit plane: the pair of PHYSICS 6, units of Omega.
SHORT_PAIR = formation(
    "chain", 2, tether_length_m=1000.0, axial_stiffness_n=5e5, damping_n_s_per_m=500.0
)
SIX_BEADS = ring(satellite_mass_kg=1000.0, beads_per_tether=1, bead_mass_kg=10.0)
UNDAMPED = {"damping_n_s_per_m": 0.0, "axial_stiffness_n": 5e6}


def found(system, w, **options):
    return compute_floquet(system, w, certify=False, **options)


@pytest.mark.parametrize("w", [-2.79, -2.76, -2.74, -2.72])
def test_six_beads_follow_their_family_where_newton_from_the_start_does_not(w):
    """An audit in long double continued it: neutral, no switch, a loss of 2.4e-4 a turn."""
    result = found(SIX_BEADS, w)
    assert result.verdict == "neutral"
    assert result.switches == 0
    assert result.spin_loss == pytest.approx(2.3e-4, rel=0.1)
    assert result.max_modulus_nontrivial == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize(
    "w, verdict, modulus",
    [
        (0.8, "asymptotically stable", 1.0),
        (1.0, "asymptotically stable", 1.0),
        (1.2, "unstable", 1.306288),
        (1.5, "asymptotically stable", 1.0),
    ],
)
def test_a_prograde_pair_turns_like_a_rigid_pendulum(w, verdict, modulus):
    """theta'' + 3 sin theta cos theta = 0, b'' + [(1 + theta')^2 + 3 cos^2 theta] b = 0."""
    result = found(SHORT_PAIR, w)
    assert (result.verdict, result.switches) == (verdict, 0)
    assert result.max_modulus_nontrivial == pytest.approx(modulus, abs=2e-5)
    assert rigid_pair_modulus(w) == pytest.approx(modulus, abs=1e-5)


def rigid_pair_modulus(w):
    """Largest modulus of the out-of-plane multipliers of a rigid pair."""
    from scipy.integrate import quad, solve_ivp
    from scipy.optimize import brentq

    def turn_s(rate):
        def slowness(a):
            return 1.0 / math.sqrt(rate**2 - 3.0 * math.sin(a) ** 2)

        return quad(slowness, 0.0, 2.0 * math.pi, epsabs=1e-12)[0]

    period = 2.0 * math.pi / w
    rate = brentq(lambda r: turn_s(r) - period, math.sqrt(3.0) * (1.0 + 1e-9), 10.0)

    def derivative(_, y):
        a, da, b = y[0], y[1], y[2:4]
        stiffness = (1.0 + da) ** 2 + 3.0 * math.cos(a) ** 2
        return [da, -3.0 * math.sin(a) * math.cos(a), *y[4:6], *(-stiffness * b)]

    start = [0.0, rate, 1.0, 0.0, 0.0, 1.0]
    end = solve_ivp(derivative, (0.0, period), start, rtol=1e-11, atol=1e-12).y[:, -1]
    return np.max(np.abs(np.linalg.eigvals([end[2:4], end[4:6]])))


@pytest.mark.parametrize("w", [-2.5, -3.0, -6.0])
def test_a_stiff_pair_closes(w):
    result = found(formation("chain", 2, axial_stiffness_n=5e7), w)
    assert result.verdict == "asymptotically stable"
    assert (result.switches, result.closure_residual < 1e-9) == (0, True)


@pytest.mark.parametrize("stiffness", [5e4, 5e5, 5e6, 5e7])
def test_critical_rate_of_a_hub_does_not_hang_on_its_stiffness(stiffness):
    hub = formation("hub_and_spoke", 3, axial_stiffness_n=stiffness)
    (rate,) = find_critical_rates(hub, -2.9, -2.7, spacing=0.1)
    assert rate.spin_rate_ratio == pytest.approx(-2.8141, abs=1.5e-3)
    assert rate.cause == "axis tilt"
    assert found(hub, -5.12).verdict == "neutral"


def test_a_prograde_chain_of_three_has_no_slack_boundary():
    chain = scenario.load("chain").build()
    for w in (1.6, 1.65, 1.7):
        assert (found(chain, w).verdict, found(chain, w).switches) == ("neutral", 0)
    assert find_critical_rates(chain, 1.6, 1.7) == []


@pytest.mark.parametrize("w", [-1.55, -1.05, -1.1])
def test_impostors_of_a_pair_are_refused(w):
    """Once both masses in one point, once a motion that turns the other way."""
    result = found(formation("chain", 2), w)
    assert result.verdict == "none found"
    assert "own family" in result.message and "tried" in result.message


def test_the_bending_of_a_chain_is_no_tilt_and_never_decays():
    result = found(scenario.load("chain").build(), -5.0)
    assert result.verdict == "neutral"
    assert result.deciding_family == "shape"


@pytest.mark.parametrize(
    "system, name",
    [
        (formation("double_pyramid", 4), "apex_up"),
        (formation("closed_hub_and_spoke", 3), "hub"),
    ],
    ids=["double pyramid about the orbit normal", "closed hub and spoke of equal lengths"],
)
def test_formations_that_no_tether_holds_are_refused_by_name(system, name):
    result = found(system, -5.0)
    assert result.verdict == "none found"
    assert f"no tether that is ever taut holds {name}" in result.message


def test_a_motion_far_from_the_start_given_is_not_its_own():
    start, tilt = initial_state(ring(), -3.0), math.radians(20.0)
    turn = np.array(
        [[1, 0, 0], [0, math.cos(tilt), -math.sin(tilt)], [0, math.sin(tilt), math.cos(tilt)]]
    )
    tilted = State(start.position_m @ turn.T, start.velocity_m_s @ turn.T)
    assert found(ring(), -3.0, state=tilted).verdict == "none found"
    assert found(ring(), -3.0, state=start).verdict == "asymptotically stable"


def test_what_decides_is_what_is_shown_beyond_the_slack_limit():
    result = found(ring(), -2.1356)
    assert result.verdict == "unstable"
    assert result.deciding_family == "spin" and result.deciding_modulus > 1.1
    assert result.max_modulus_nontrivial < 1.0 + 1e-6


def test_a_rope_loses_its_spin_from_the_slack_limit_on():
    """The drift of the spin once hid it between -2.553 and -2.523."""
    rope = ring(tether_law="tension_only")
    assert found(rope, -2.6).verdict == "asymptotically stable"
    for w in (-2.57, -2.55, -2.53):
        result = found(rope, w)
        assert (result.verdict, result.deciding_family) == ("unstable", "spin")


def test_the_same_question_gives_the_same_bits_in_any_order():
    rates = [-2.3, -4.1, -2.76, -9.0, -12.0]
    systems = [ring(damping_n_s_per_m=1400.0 + k) for k in range(2)]
    one = [found(systems[0], w).multiplier for w in rates]
    for w, multiplier in list(zip(rates, one))[::-1]:
        fresh = ring(damping_n_s_per_m=1400.0)
        np.testing.assert_array_equal(found(fresh, w).multiplier, multiplier)


@pytest.mark.parametrize("name", ["three_star", "five_star", "hub_and_spoke", "six_bead"])
def test_critical_rates_do_not_depend_on_spacing_or_direction(name):
    system = scenario.load(name).build()
    low, high = (-3.4, -2.9) if name == "six_bead" else (-4.4, -2.0)
    answers = [
        find_critical_rates(system, *ends, tolerance=1e-3, spacing=spacing)
        for ends in ((low, high), (high, low))
        for spacing in (0.05, 0.02)
    ]
    for other in answers[1:]:
        assert [r.cause for r in other] == [r.cause for r in answers[0]]
        for a, b in zip(answers[0], other):
            assert abs(a.spin_rate_ratio - b.spin_rate_ratio) <= a.uncertainty + b.uncertainty


def test_special_points_of_the_star_are_those_of_theory():
    """First slack: w^2 + 2 w + 3/2 = 3 / sqrt(1 + (2 w Omega tau)^2), PHYSICS 4."""
    family = follow(ring(), "spin_rate_ratio", -5.0, -2.12)
    kinds = {point.kind: point for point in family.special}
    tau = 1450.0 * 1e4 / 5e4 * ring().orbit_rate_rad_s

    def margin(w):
        return w * w + 2.0 * w + 1.5 - 3.0 / math.sqrt(1.0 + (2.0 * w * tau) ** 2)

    slack = kinds["first slack"]
    assert abs(margin(slack.parameter)) < 2e-2
    assert slack.uncertainty < 1e-6
    assert kinds["spin divergence"].parameter == pytest.approx(slack.parameter, abs=1e-3)
    assert family.ended == ""
    assert family.points[-1].parameter == -2.12
    assert all(point.closure_residual <= CLOSED for point in family.points)


@pytest.mark.parametrize("n, w", [(5, -4.2028), (6, -2.8141)])
def test_torus_points_are_the_combination_resonances(n, w):
    family = follow(ring(n), "spin_rate_ratio", w - 0.3, w + 0.2)
    (torus,) = (point for point in family.special if point.kind == "torus")
    assert torus.parameter == pytest.approx(w, abs=2e-4)
    assert torus.family == "axis tilt"


def test_a_family_goes_round_folds():
    family = follow(SIX_BEADS, "spin_rate_ratio", -3.6, -3.0)
    folds = [point.parameter for point in family.special if point.kind == "fold"]
    assert folds == pytest.approx([-3.24178, -3.51597], abs=2e-4)
    at = [point.parameter for point in family.points]
    assert min(at) < -3.5 and at[-1] == -3.0
    assert family.ended == ""


def test_families_are_followed_in_other_parameters():
    family = follow(ring(), "damping_n_s_per_m", 1450.0, 600.0, spin_rate_ratio=-2.4)
    (slack,) = (point for point in family.special if point.kind == "first slack")
    fresh = [found(ring(damping_n_s_per_m=slack.parameter + d), -2.4) for d in (1.0, -1.0)]
    assert [result.switches > 0 for result in fresh] == [False, True]


def test_followed_and_asked_motions_agree():
    family = follow(ring(5), "spin_rate_ratio", -5.0, -3.0)
    for point in family.points[::5]:
        asked = found(ring(5), point.parameter)
        assert asked.verdict == point.verdict
        assert asked.max_modulus_nontrivial == pytest.approx(point.max_modulus_nontrivial, abs=1e-7)


@pytest.mark.parametrize(
    "arguments, options, words",
    [
        (("mass", 1.0, 2.0), {}, "parameter 'mass' is not known; did you mean 'satellite_mass_kg'"),
        (("spin_rate_ratio", -3.0, -3.0), {}, "interval of spin_rate_ratio must not be empty"),
        (("spin_rate_ratio", -3.0, 3.0), {}, "spin_rate_ratio must keep its sign"),
        (("damping_n_s_per_m", 1.0, 2.0), {}, "spin_rate_ratio must be given"),
        (("spin_rate_ratio", -3.0, math.nan), {}, "finite"),
        (("spin_rate_ratio", -1.5, -3.0), {}, "no motion to follow was found"),
        (("bead_mass_kg", 1.0, 2.0), {"spin_rate_ratio": -3.0}, "the system has no such bead"),
    ],
)
def test_what_cannot_be_followed_is_refused(arguments, options, words):
    with pytest.raises(TssError, match=words):
        follow(ring(), *arguments, **options)


def test_what_was_found_before_a_cancel_is_kept():
    seen = []
    family = follow(
        ring(), "spin_rate_ratio", -5.0, -2.2, progress=lambda *point: seen.append(point),
        cancelled=lambda: len(seen) >= 3,
    )  # fmt: skip
    assert len(family.points) >= 3
    assert family.ended.startswith("canceled at")


def draw_systems():
    """Systems and rates drawn at random, each with a seed that names it."""
    for seed in range(12):
        rng = np.random.default_rng(seed)
        shape = rng.choice(["ring", "chain", "hub_and_spoke"])
        count = int(rng.integers(3, 6))
        masses = count + (shape == "hub_and_spoke")
        system = formation(
            str(shape), count,
            satellite_mass_kg=list(rng.uniform(30.0, 300.0, masses)),
            axial_stiffness_n=float(10 ** rng.uniform(4.5, 6.5)),
            damping_n_s_per_m=float(10 ** rng.uniform(2.5, 3.8)),
            orbit_altitude_m=float(rng.uniform(4e5, 2e6)),
        )  # fmt: skip
        yield pytest.param(system, float(-rng.uniform(2.2, 6.0)), id=f"{shape} {seed}")


@pytest.mark.parametrize("system, w", draw_systems())
def test_answers_agree_with_followed_ones_and_with_simulations(system, w):
    asked = found(system, w)
    if asked.verdict == "none found":
        with pytest.raises(TssError, match="no motion to follow"):
            follow(system, "spin_rate_ratio", w, w - 0.1)
        return
    followed = follow(system, "spin_rate_ratio", w - 0.5, w).points[-1]
    assert followed.verdict == asked.verdict
    assert followed.max_modulus_nontrivial == pytest.approx(asked.max_modulus_nontrivial, abs=1e-5)
    seen = confirm(system, w, asked.state, disturbance_m=1.0, turns=6)
    assert seen.agrees_with(asked) is not False, (asked.verdict, asked.decided_by, seen.held)
