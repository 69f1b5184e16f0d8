"""Reels: rest lengths that change, beads that leave and return, against closed forms and DOP853."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicHermiteSpline

from tss_ros import core
from tss_ros.core import Commands, Propagator, State, TssError, reel_plan, reel_profile
from tss_ros.core.model.reels import reels

MU = 3.986e14
OMEGA = math.sqrt(MU / 7378e3**3)
PAIR = core.formation(
    "chain", 2, tether_length_m=1000.0, damping_n_s_per_m=100.0, linear_gravity=True
)
BEADED = core.ring(beads_per_tether=4, bead_mass_kg=10.0, damping_n_s_per_m=100.0)


def exponential(length_m, a, end_s, points=200):
    """L = L_0 exp(a t) as cubics."""
    times = np.linspace(0.0, end_s, points)
    lengths = length_m * np.exp(a * times)
    return CubicHermiteSpline(times, lengths, a * lengths)


def hanging(length_m, angle):
    """Start of a pair at an angle from the vertical, positive like Omega, at rest there."""
    up = length_m * np.array([-math.sin(angle), math.cos(angle), 0.0])
    first = 1.0 if PAIR.layout_m[0, 1] > 0.0 else -1.0
    return 0.5 * first * np.stack([up, -up])


def angle_of(position_m):
    line = position_m[..., 0, :] - position_m[..., 1, :]
    line = line * np.sign(PAIR.layout_m[0, 1])
    return np.arctan2(-line[..., 0], line[..., 1])


@pytest.mark.parametrize("share", [0.2, 0.5, 0.7])
def test_exponential_deployment_keeps_its_angle(share):
    a = share * OMEGA
    angle = -0.5 * math.asin(4.0 / 3.0 * share)
    profile = exponential(1000.0, a, 2.0 / a)
    start = hanging(1000.0 + 1e-3, angle)
    plan = reel_plan(PAIR, {"tether_1": profile})
    motion = Propagator(PAIR, 0.0, State(start, a * start), plan=plan)
    times = np.linspace(0.0, 2.0 / a, 50)
    position_m, _ = motion.sample(times)
    line = np.linalg.norm(position_m[:, 0] - position_m[:, 1], axis=1)
    np.testing.assert_allclose(line, profile(times), rtol=1e-3)
    np.testing.assert_allclose(angle_of(position_m), angle, atol=2e-4)


@pytest.mark.parametrize("share, grows", [(0.3, False), (-0.3, True)])
def test_deployment_damps_swings_and_retrieval_drives_them(share, grows):
    a = share * OMEGA
    angle = -0.5 * math.asin(4.0 / 3.0 * share)
    profile = exponential(1000.0, a, 2.0 / abs(a))
    start = hanging(1000.0, angle + 0.02)
    plan = reel_plan(PAIR, {"tether_1": profile})
    motion = Propagator(PAIR, 0.0, State(start, a * start), plan=plan)
    off = np.abs(angle_of(motion.sample(np.linspace(0.0, 2.0 / abs(a), 400))[0]) - angle)
    # The swing's amplitude follows exp(-a t).
    first, last = np.max(off[:200]), np.max(off[200:])
    assert (last > 1.5 * first) if grows else (last < 0.7 * first)


def test_a_reel_that_moves_agrees_with_another_integrator():
    ring = core.ring(damping_n_s_per_m=100.0)
    start = core.initial_state(ring, -2.9)
    times = np.array([0.0, 50.0, 300.0, 500.0, 600.0])
    profiles = {
        "tether_1": reel_profile([50.0, 300.0, 500.0], [10e3, 10.1e3, 10.06e3]),
        "tether_3": CubicHermiteSpline([0.0, 600.0], [10e3, 9.99e3], [0.0, -0.05]),
    }
    motion = Propagator(ring, -2.9, start, rtol=1e-12)
    motion.command(reel_plan(ring, profiles))
    position_m, velocity_m_s = motion.sample(times)
    names = [reel.name for reel in reels(ring)]

    def rest(t):
        found = [(10e3, 0.0)] * 3
        for name, profile in profiles.items():
            inside = min(max(t, profile.x[0]), profile.x[-1])
            rate = float(profile(t, 1)) if profile.x[0] <= t < profile.x[-1] else 0.0
            found[names.index(name)] = float(profile(inside)), rate
        return np.array(found).T

    def rates(t, y):
        r, v = y.reshape(2, 3, 3)
        up = r + [0.0, 7378e3, 0.0]
        a = -MU * up / np.linalg.norm(up, axis=1)[:, None] ** 3
        a += OMEGA**2 * up * [1.0, 1.0, 0.0]
        a -= 2.0 * OMEGA * np.stack([-v[:, 1], v[:, 0], 0.0 * v[:, 0]], axis=1)
        lengths, unreeling = rest(t)
        for k, (i, j) in enumerate(ring.tether_ends):
            e, w = r[i] - r[j], v[i] - v[j]
            length = np.linalg.norm(e)
            if length > lengths[k]:
                pull = ring.axial_stiffness_n[k] / lengths[k] * (length - lengths[k])
                damping = ring.damping_n_s_per_m[k] * 10e3 / lengths[k]
                pull += damping * (e @ w / length - unreeling[k])
                a[i] -= pull * e / length / ring.mass_kg[i]
                a[j] += pull * e / length / ring.mass_kg[j]
        return np.concatenate([v.ravel(), a.ravel()])

    state = np.concatenate([start.position_m.ravel(), start.velocity_m_s.ravel()])
    for begin, end in zip(times, times[1:]):
        found = solve_ivp(rates, (begin, end), state, "DOP853", rtol=1e-12, atol=1e-9)
        state = found.y[:, -1]
        k = list(times).index(end)
        np.testing.assert_allclose(position_m[k], state[:9].reshape(3, 3), atol=1e-5)
        np.testing.assert_allclose(velocity_m_s[k], state[9:].reshape(3, 3), atol=1e-7)


# -- beads -----------------------------------------------------------------------------------------


def momenta(system, position_m, velocity_m_s):
    """Centre of mass, momentum and angular momentum against the stars, on a circle."""
    inertial = velocity_m_s + OMEGA * np.stack(
        [-position_m[..., 1], position_m[..., 0], 0.0 * position_m[..., 0]], axis=-1
    )
    mass = system.mass_kg[:, None]
    return (
        np.sum(mass * position_m, axis=-2),
        np.sum(mass * inertial, axis=-2),
        np.sum(mass * np.cross(position_m, inertial), axis=-2),
    )


@pytest.mark.parametrize("begin_m, end_m", [(5e3, 7e3), (7e3, 5e3)])
def test_beads_leave_and_return_without_a_jump_in_momentum(begin_m, end_m):
    alone, part = core.deployed_system(BEADED, begin_m)
    start = core.whole_state(part, core.initial_state(alone, -2.9))
    names = [reel.name for reel in reels(BEADED)]
    profile = reel_profile([0.0, 800.0], [begin_m, end_m])
    plan = reel_plan(BEADED, dict.fromkeys(names, profile))
    motion = Propagator(BEADED, -2.9, start, plan=plan)
    edges = [t for t, _ in motion.plan]
    assert len(edges) == 1 + 1  # one bead of each tether at the same time, and the end
    before = motion.segments_out
    around = edges[0] + np.array([0.0, 1e-7])
    position_m, velocity_m_s = motion.sample(around)
    assert motion.segments_out != before
    assert np.any(np.abs(velocity_m_s[1] - velocity_m_s[0]) > 1e-4)
    first, second = zip(*momenta(BEADED, position_m, velocity_m_s))
    scale = np.sum(BEADED.mass_kg) * np.array([1e4, 25.0, 25e4])
    for a, b, unit in zip(first, second, scale):
        np.testing.assert_allclose(a, b, atol=3e-12 * unit)
    assert [np.ptp(t) for t in momenta(BEADED, position_m, velocity_m_s)]


def test_beads_on_a_reel_ride_with_their_satellite():
    alone, part = core.deployed_system(BEADED, 2.5e3)
    start = core.whole_state(part, core.initial_state(alone, -2.9))
    names = [reel.name for reel in reels(BEADED)]
    profile = reel_profile([0.0, 2000.0, 4000.0], [2.5e3, 9.5e3, 2.6e3])
    plan = reel_plan(BEADED, dict.fromkeys(names, profile))
    motion = Propagator(BEADED, -2.9, start, plan=plan)
    times = np.linspace(0.0, 4000.0, 81)
    out, position_m, velocity_m_s = [], [], []
    for t in times:
        r, v = motion.sample(np.array([t]))
        out.append(motion.segments_out[0])
        position_m.append(r[0])
        velocity_m_s.append(v[0])
    assert out[0] == 2 and max(out) == 5 and out[-1] == 2
    for reel in reels(BEADED):
        for r, count in zip(position_m, out):
            inside = list(reel.beads[1 : len(reel.segments) - count + 1])
            assert (r[inside] == r[reel.beads[0]]).all()


def test_a_reel_stops_where_it_comes_to_its_end():
    motion = Propagator(PAIR, 0.0, core.initial_state(PAIR, 0.0))
    motion.command([(10.0, Commands.of(PAIR, reel={"tether_1": (10.0, 1000.0, -10.0)}))])
    (_, moving), (end_s, stopped) = motion.plan
    assert moving.unreels and not stopped.unreels
    assert end_s == pytest.approx(10.0 + (1000.0 - 0.1) / 10.0)
    assert stopped.lengths_out(end_s)[0] == pytest.approx([0.1])


@pytest.mark.parametrize(
    "plan, words",
    [
        ([(5.0, (5.0, 900.0))], "must go on from 1000 m at 5 s, got 900"),
        ([(5.0, (5.0, 1000.0, -10.0)), (500.0, (500.0, 0.1))], "shorter than 0.1 m from 104.99 s"),
        ([(5.0, (5.0, np.nan))], "reel must be finite"),
    ],
)
def test_reels_that_cannot_be_are_refused(plan, words):
    motion = Propagator(PAIR, 0.0, core.initial_state(PAIR, 0.0))
    with pytest.raises(TssError, match=words):
        motion.command([(t, Commands.of(PAIR, reel={"tether_1": row})) for t, row in plan])


def test_names_and_profiles_that_are_not_there_are_named():
    with pytest.raises(TssError, match="tether is 'tether_2'; allowed: tether_1"):
        Commands.of(PAIR, reel={"tether_2": (0.0, 1000.0)})
    with pytest.raises(TssError, match="time_s must increase"):
        reel_profile([1.0, 1.0], [10.0, 20.0])
    with pytest.raises(TssError, match="at least 0.1 m, got 0"):
        core.deployed_system(PAIR, 0.0)
    with pytest.raises(TssError, match="bears no reels that move"):
        Propagator(
            PAIR, 0.0, core.initial_state(PAIR, 0.0), integrator="taylor",
            plan=reel_plan(PAIR, {"tether_1": reel_profile([0.0, 10.0], [1000.0, 1010.0])}),
        )  # fmt: skip


def test_a_motion_that_begins_on_its_reels_has_the_rest_lengths_of_its_plan():
    alone, part = core.deployed_system(BEADED, 5e3)
    start = core.whole_state(part, core.initial_state(alone, -2.9))
    profile = reel_profile([0.0, 100.0], [5e3, 5e3])
    plan = reel_plan(BEADED, {reel.name: profile for reel in reels(BEADED)})
    motion = core.simulate(BEADED, -2.9, turns=0.01, period_s=4.0, state=start, plan=plan)
    np.testing.assert_allclose(motion.rests_m.reshape(-1, 3, 5).sum(axis=2), 5e3, rtol=1e-14)
    out = motion.rests_m > 0.0
    assert motion.taut[out].all() and not motion.tension_n[~out].any()
    np.testing.assert_allclose(motion.energy_j, motion.energy_j[0], rtol=1e-5)
