"""Branches at branch points and period doublings, and special points in a second parameter."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tss_ros.core import (
    TssError,
    find_critical_rates,
    follow,
    follow_special,
    formation,
    ring,
    with_parameter,
)
from tss_ros.core.model.symmetry import cyclic_symmetry
from tss_ros.core.motion.integrator import Integrator
from tss_ros.core.stability.closing import CLOSED
from tss_ros.core.stability.shooting import carried_motion, to_scaled

PAIR = formation("chain", 2, tether_length_m=1000.0, axial_stiffness_n=5e5, damping_n_s_per_m=500.0)
SIX_BEADS = ring(satellite_mass_kg=1000.0, beads_per_tether=1, bead_mass_kg=10.0)


@pytest.fixture(scope="module")
def pair_family():
    return follow(PAIR, "spin_rate_ratio", 1.3, 1.0)


def closure_of_a_rigid_pair(state, w, turns=1):
    """What a turn of a rigid pair in linear gravity leaves open, from the direction of a tether.

    On the unit sphere u'' = f - (u.f + |u'|^2) u, f = (2 u_y', 3 u_y - 2 u_x', -u_z).
    """
    orbit = PAIR.orbit_rate_rad_s
    arm, speed = (x[0] - x[1] for x in (state.position_m, state.velocity_m_s))
    length = np.linalg.norm(arm)
    u = arm / length
    rate = (speed - (speed @ u) * u) / (length * orbit)

    def derivative(_, y):
        place, moving = y[:3], y[3:]
        f = np.array([2.0 * moving[1], 3.0 * place[1] - 2.0 * moving[0], -place[2]])
        return [*moving, *(f - (place @ f + moving @ moving) * place)]

    start = [*u, *rate]
    end = solve_ivp(
        derivative, (0.0, turns * 2.0 * math.pi / abs(w)), start, rtol=1e-10, atol=1e-11
    ).y[:, -1]  # fmt: skip
    return float(np.linalg.norm(end - start))


@pytest.mark.parametrize("number", [0, 1])
def test_branches_of_a_pair_are_motions_of_a_rigid_one_out_of_the_plane(pair_family, number):
    point = pair_family.special[number]
    assert (point.kind, point.family) == ("branch point", "axis tilt")
    branch = follow(PAIR, "spin_rate_ratio", 1.6, 1.1, branch=point, most_points=60)
    assert abs(branch.points[0].parameter - point.parameter) < 1e-3
    for chosen in branch.points[:: max(1, len(branch.points) // 5)]:
        assert chosen.closure_residual <= CLOSED
        assert closure_of_a_rigid_pair(chosen.state, chosen.parameter) < 2e-3
    tilted = branch.points[-1].state
    out = np.hypot(tilted.position_m[0, 2] / 500.0, tilted.velocity_m_s[0, 2] / 0.5)
    assert out > 0.5


def test_a_branch_that_loses_the_symmetry_of_a_ring():
    """Every motion of the family is mapped on itself by a sixth of a turn, none of the branch."""
    family = follow(ring(6), "spin_rate_ratio", -2.33, -2.3)
    (point,) = (point for point in family.special if point.kind == "branch point")
    branch = follow(ring(6), "spin_rate_ratio", -2.5, -2.2, branch=point, most_points=12)
    heights = branch.points[-1].state.position_m[:, 2]
    assert np.max(np.abs(heights)) > 10.0
    assert all(point.closure_residual <= CLOSED for point in branch.points)
    left = [sixth_of_a_turn(points[-1]) for points in (family.points, branch.points)]
    assert left[0] < 1e-5 < 1e-3 < left[1]


def sixth_of_a_turn(point):
    """How far a sixth of a turn, beads renamed, leads from a motion's start."""
    system = ring(6)
    integrator = Integrator(system, system.spin_rate_rad_s(point.spin_rate_ratio), 1e-10, 1e4)
    driven = integrator.driven(point.spin_loss)
    motion = carried_motion(driven, point.state, driven.period_s / 6)
    end = cyclic_symmetry(system).back(True, driven.scaled(motion.v, motion.r))
    return float(np.linalg.norm(end - to_scaled(driven, point.state)))


@pytest.mark.long
def test_beyond_a_period_doubling_motions_close_after_two_turns():
    family = follow(SIX_BEADS, "spin_rate_ratio", -2.68, -2.715, longest_step=0.005)
    (point, *_) = (point for point in family.special if point.kind == "period doubling")
    branch = follow(SIX_BEADS, "spin_rate_ratio", -2.8, -2.6, branch=point, most_points=8)
    assert branch.turns == 2
    assert all(point.closure_residual <= CLOSED for point in branch.points)


def test_a_chain_turns_round_where_gravity_takes_its_pitchfork_apart():
    """Steps of any length keep to the family that folds, and do not jump to the straight chain."""
    chain = formation("chain", 3)
    for step in (0.08, 0.02):
        family = follow(chain, "spin_rate_ratio", -4.5, -4.0, longest_step=step)
        (fold,) = (point for point in family.special if point.kind == "fold")
        assert fold.parameter == pytest.approx(-4.27101, abs=1e-4)
        assert family.ended.startswith("the family came back past -4.5")
    (rate,) = find_critical_rates(chain, -4.4, -4.1)
    assert rate.spin_rate_ratio == pytest.approx(-4.27101, abs=1.1e-3)


@pytest.mark.parametrize(
    "kind, at, words",
    [
        ("first slack", -2.2, "branch must be a branch point or a period doubling, got a first sl"),
        ("branch point", -4.0, "branch must lie from -2.3 to -2.1, got one at spin_rate_ratio -4"),
        ("branch point", -2.25, "no branch leaves at branch point -2.25: the least singular value"),
    ],
)
def test_where_no_branch_leaves_none_is_followed(kind, at, words):
    family = follow(ring(), "spin_rate_ratio", -2.25, -2.15)
    point = replace(family.special[0], kind=kind, parameter=at, state=family.points[0].state)
    with pytest.raises(TssError, match=words):
        follow(ring(), "spin_rate_ratio", -2.3, -2.1, branch=point)


def special(system, w, width, kind):
    family = follow(system, "spin_rate_ratio", w - width, w + width)
    return next(point for point in family.special if point.kind == kind)


def test_first_slack_in_the_damping_is_where_the_closed_form_puts_it():
    """w^2 + 2 w + 3/2 = 3 / sqrt(1 + (2 w Omega tau)^2), tau = C L / EA."""
    point = special(ring(), -2.17, 0.03, "first slack")
    curve = follow_special(ring(), "spin_rate_ratio", point, "damping_n_s_per_m", 1000.0)
    assert curve.ended == "" and curve.points[-1].second == 1000.0
    for found in curve.points:
        w, lag = found.parameter, found.second * 1e4 / 5e4 * ring().orbit_rate_rad_s
        margin = w * w + 2.0 * w + 1.5 - 3.0 / math.sqrt(1.0 + (2.0 * w * lag) ** 2)
        assert abs(margin) < 2e-3
    fresh = ring(damping_n_s_per_m=1000.0)
    (rate, *_) = find_critical_rates(fresh, -2.33, -2.28, tolerance=1e-4)
    assert curve.points[-1].parameter == pytest.approx(rate.spin_rate_ratio, abs=2e-4)


@pytest.mark.long
@pytest.mark.parametrize(
    "system, w, kind, second, stop",
    [
        (ring(), -2.17, "spin divergence", "damping_n_s_per_m", 1600.0),
        (ring(5), -4.2028, "torus", "axial_stiffness_n", 8e4),
        (SIX_BEADS, -3.2418, "fold", "bead_mass_kg", 10.3),
        (PAIR, 1.2421, "branch point", "orbit_altitude_m", 2e6),
    ],
    ids=["spin divergence", "torus", "fold", "branch point"],
)
def test_curves_of_special_points_agree_with_families_at_fixed_values(
    system, w, kind, second, stop
):
    point = special(system, w, 0.02, kind)
    curve = follow_special(system, "spin_rate_ratio", point, second, stop)
    assert curve.ended == ""
    at = curve.points[-1]
    assert at.second == stop
    again = special(with_parameter(system, second, stop), at.parameter, 0.02, kind)
    assert at.parameter == pytest.approx(again.parameter, abs=2e-6)


@pytest.mark.parametrize(
    "second, stop, words",
    [
        ("spin_rate_ratio", -3.0, "second must be another parameter than spin_rate_ratio"),
        ("damping_n_s_per_m", 1450.0, "interval of damping_n_s_per_m must not be empty"),
        ("damping_n_s_per_m", -5.0, "damping"),
        ("mass", 1.0, "parameter 'mass' is not known; did you mean"),
    ],
)
def test_curves_that_cannot_be_followed_are_refused(second, stop, words):
    point = special(ring(), -2.17, 0.03, "first slack")
    with pytest.raises(TssError, match=words):
        follow_special(ring(), "spin_rate_ratio", point, second, stop)
