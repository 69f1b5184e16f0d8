"""Critical rates against closed forms, and verdicts against disturbed simulations."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import brentq

from tss_ros.core import (
    Cancelled,
    Propagator,
    State,
    TssError,
    compute_floquet,
    confirm,
    disturbed,
    find_critical_rates,
    formation,
    initial_state,
    ring,
)


def slack_edge(system, low, high):
    """Rate at which the damped tethers of the 3-star first go slack (rigid triangle)."""
    tau = system.damping_n_s_per_m[0] * system.rest_length_m[0] / system.axial_stiffness_n[0]
    rate = system.orbit_rate_rad_s
    return brentq(
        lambda w: w * w + 2 * w + 1.5 - 3 / math.hypot(1, 2 * w * rate * tau), low, high
    )


@pytest.mark.parametrize(
    "system, low, high, near",
    [
        (ring(damping_n_s_per_m=1000.0), -2.5, -2.2, -2.306),
        (ring(damping_n_s_per_m=1452.0), -2.5, -2.1, -2.17),
        (ring(damping_n_s_per_m=2000.0), -2.5, -2.015, -2.036),
        (ring(satellite_mass_kg=50.0), -2.5, -2.1, -2.17),
        (ring(satellite_mass_kg=1000.0), -2.5, -2.1, -2.17),
        (ring(axial_stiffness_n=5e6, damping_n_s_per_m=300.0), -2.8, -2.56, -2.58114),
        (ring(axial_stiffness_n=5e6, damping_n_s_per_m=300.0), 0.57, 0.8, 0.58114),
    ],
    ids=["C 1000", "C 1452", "C 2000", "50 kg", "1000 kg", "stiff", "stiff, counter-clockwise"],
)
def test_first_slack_is_where_the_closed_form_puts_it(system, low, high, near):
    edge = slack_edge(system, low, high)
    assert edge == pytest.approx(near, abs=3e-3)
    found = find_critical_rates(system, low, high, tolerance=1e-3, spacing=0.1)
    slack = [rate for rate in found if rate.cause == "first slack"]
    assert len(slack) == 1
    assert slack[0].spin_rate_ratio == pytest.approx(edge, abs=3e-3)
    assert slack[0].uncertainty <= 1e-3
    assert slack[0].stable_side == (-1 if edge < 0 else 1)


def test_for_strong_damping_the_axis_tilt_is_lost_at_exactly_two():
    (rate,) = find_critical_rates(ring(damping_n_s_per_m=3000.0), -2.1, -1.95, tolerance=1e-4)
    assert rate.cause == "axis tilt"
    assert rate.spin_rate_ratio == pytest.approx(-2.0, abs=5e-4)
    assert rate.stable_side == -1


@pytest.mark.parametrize(
    "w, held", [(-2.0, False), (-2.1, False), (-2.19, True), (-2.5, True)]
)
def test_disturbed_formation_does_what_the_verdict_says(w, held):
    """The paper's Figs. 6-8 on Table 1: lost at 2.0, restored at 2.5."""
    verdict = compute_floquet(ring(), w).verdict
    assert (verdict == "asymptotically stable") == held
    for seed in (0, 1):
        seen = confirm(ring(), w, seed=seed)
        assert seen.held == held
        assert (seen.turns_to_settle < 2.5) == held


def test_tilt_of_a_disturbed_formation_grows_by_its_multiplier():
    system = ring(damping_n_s_per_m=3000.0)
    result = compute_floquet(system, -1.9)
    tilt = max(abs(m) for m, f in zip(result.multiplier, result.family) if f == "axis tilt")
    seen = confirm(system, -1.9, result.state, turns=12)
    assert tilt > 1.5
    assert not seen.held
    assert seen.growth_per_turn == pytest.approx(tilt, rel=2e-2)


@pytest.mark.parametrize(
    "system, w, verdict",
    [
        (ring(satellites=5), -3.0, "neutral"),
        (formation("chain", 2), -3.0, "asymptotically stable"),
        (formation("hub_and_spoke", 3), -3.0, "neutral"),
    ],
    ids=["ring of 5", "pair", "hub and spoke"],
)
def test_other_formations_are_judged_and_hold(system, w, verdict):
    result = compute_floquet(system, w)
    assert result.trivial_error < 1e-6
    assert result.flow_error < 1e-6
    if result.verdict in ("neutral", "asymptotically stable"):
        assert result.verdict == verdict
        assert confirm(system, w, result.state, disturbance_m=1.0).held
    else:
        assert result.verdict != "asymptotically stable"


def test_search_reports_progress_and_can_be_cancelled():
    seen = []
    find_critical_rates(ring(), -2.4, -2.3, progress=lambda done, found: seen.append(done))
    assert seen == sorted(seen) and seen[-1] == 1.0
    with pytest.raises(Cancelled):
        find_critical_rates(ring(), -2.4, -2.1, cancelled=lambda: len(seen) > 2)


@pytest.mark.parametrize(
    "arguments, named",
    [
        ((math.nan, -2.0), "spin_rate_ratio_from must be a finite number, got nan"),
        ((-2.0, -2.0), "must not be empty"),
        ((-2.0, -1e9), "spin_rate_ratio must be 0 or have a size"),
        ((-2.5, -2.0, 0.0), "tolerance must be at least 1e-06, got 0"),
    ],
)
def test_bad_intervals_are_named(arguments, named):
    with pytest.raises(TssError, match=named):
        find_critical_rates(ring(), *arguments)


spins = st.floats(-4.0, -2.4)
seeds = st.integers(0, 2**31)


@settings(max_examples=15, deadline=None)
@given(spins, seeds)
def test_mirror_image_in_the_orbit_plane_moves_as_the_mirror_image(w, seed):
    system = ring(damping_n_s_per_m=100.0)
    start = disturbed(initial_state(system, w), 5.0, seed)
    flip = np.array([1.0, 1.0, -1.0])
    mirrored = State(start.position_m * flip, start.velocity_m_s * flip)
    times = np.array([100.0, 200.0])
    ours, other = (Propagator(system, w, s).sample(times)[0] for s in (start, mirrored))
    np.testing.assert_allclose(other, ours * flip, atol=1e-6)


@settings(max_examples=15, deadline=None)
@given(spins, seeds)
def test_undamped_motion_runs_back_in_time(w, seed):
    """Reversal: t -> -t with x -> -x keeps Eqs. (1)-(11) at C = 0, slack included."""
    system = ring(damping_n_s_per_m=0.0)
    start = disturbed(initial_state(system, w), 1.0, seed)
    position, velocity = Propagator(system, w, start, rtol=1e-12).sample(np.array([40.0]))
    turned = np.array([-1.0, 1.0, 1.0])
    back = State(position[-1] * turned, -velocity[-1] * turned)
    position, _ = Propagator(system, w, back, rtol=1e-12).sample(np.array([40.0]))
    np.testing.assert_allclose(position[-1] * turned, start.position_m, atol=1e-5)


@settings(max_examples=10, deadline=None)
@given(spins, st.floats(0.2, 5.0), st.floats(0.2, 5.0))
def test_only_dimensionless_groups_matter(w, longer, heavier):
    """Linear gravity: lengths times a, masses times b, EA times a b, C times b."""
    plain = ring(linear_gravity=True)
    scaled = ring(
        linear_gravity=True,
        tether_length_m=1e4 * longer,
        satellite_mass_kg=100.0 * heavier,
        axial_stiffness_n=5e4 * longer * heavier,
        damping_n_s_per_m=1450.0 * heavier,
    )
    a, b = (compute_floquet(system, w) for system in (plain, scaled))
    assert a.verdict == b.verdict
    shape = [
        sorted(abs(m) for m, f in zip(r.multiplier, r.family) if f == "shape") for r in (a, b)
    ]
    np.testing.assert_allclose(*shape, atol=1e-8)
