"""Plans of reels from commands: against closed forms, and that nothing depends on what is kept."""

import math
import threading

import numpy as np
import pytest

from tss_ros.core import Propagator, TssError, ring
from tss_ros.core.model.reels import reels
from tss_ros.simulator.commands import Command, CommandTable
from tss_ros.simulator.reel_commands import (
    CUBICS,
    LINES,
    MOST_POINTS,
    RATE,
    TARGET,
    Limits,
    ReelCommand,
    ReelStart,
    planned,
)
from tss_ros.simulator.reel_table import MOST_KEPT_POINTS, ReelTable
from tss_ros.simulator.simulation import Simulation
from tss_ros.simulator.straight import setup_of
from tss_ros.simulator.trajectory import compute_states, edge_s

S = 10**9
FREE = Limits(0.0, 1.0, 0.0)
RING = ring(beads_per_tether=2)


def command(kind, *points, time_s=0.0, place=0, limits=FREE):
    return ReelCommand(round(time_s * S), place, kind, points, limits)


def length(edges, time_s):
    """Length out and rate under a plan."""
    newest = [edge for edge in edges if edge.time_ns <= time_s * S][-1]
    return newest.at(round(time_s * S))


def test_a_rate_lasts_until_its_time_is_over():
    edges = planned(command(RATE, (20.0, 0.0, -0.5), time_s=10.0), 100.0, 0.0)
    assert [edge.time_ns / S for edge in edges] == [10.0, 30.0]
    assert length(edges, 14.0) == (98.0, -0.5) and length(edges, 1e6) == (90.0, 0.0)


@pytest.mark.parametrize("rate, until_m", [(-0.7, 40.0), (0.3, 1234.5)])
def test_a_reel_stops_exactly_where_it_reaches_a_limit(rate, until_m):
    limits = Limits(1.0, 40.0, 1234.5)
    edges = planned(command(RATE, (0.0, 0.0, rate), limits=limits), 100.0, 0.0)
    assert len(edges) == 2 and edges[-1].cubic == (until_m, 0.0, 0.0, 0.0)
    assert abs(edges[-1].time_ns - (until_m - 100.0) / rate * S) <= 0.5
    outside = planned(command(RATE, (0.0, 0.0, rate), limits=limits), until_m + rate, 0.0)
    assert [edge.cubic[0] for edge in outside] == [until_m + rate], "it does not jump back"


def test_a_target_is_reached_at_its_speed_and_exactly():
    for target, rate in ((70.0, -0.3), (130.0, 0.3)):
        edges = planned(command(TARGET, (0.0, target, 0.3)), 100.0, 5.0)
        assert edges[0].cubic[:2] == (100.0, rate) and edges[1].cubic == (target, 0.0, 0.0, 0.0)
        assert edges[1].time_ns == 100 * S
    (still,) = planned(command(TARGET, (0.0, 100.0, 0.3)), 100.0, 5.0)
    assert still.cubic == (100.0, 0.0, 0.0, 0.0)


def test_profiles_are_lines_or_hermite_cubics_from_what_is_out():
    lines = planned(command(LINES, (10.0, 90.0, 0.0), (30.0, 100.0, 0.0)), 80.0, 0.2)
    assert [length(lines, t) for t in (0.0, 5.0, 20.0, 31.0)] == [
        (80.0, 1.0), (85.0, 1.0), (95.0, 0.5), (100.0, 0.0)
    ]  # fmt: skip
    cubics = planned(command(CUBICS, (10.0, 90.0, 0.5), (30.0, 100.0, 0.0)), 80.0, 0.2)
    for time_s, expected in ((0.0, (80.0, 0.2)), (10.0, (90.0, 0.5)), (30.0, (100.0, 0.0))):
        np.testing.assert_allclose(length(cubics, time_s), expected, rtol=1e-14, atol=1e-14)
    np.testing.assert_allclose(length(cubics, 10.0 - 1e-6)[1], 0.5, atol=1e-6)


def test_parts_that_are_too_fast_take_longer_and_the_rest_follows():
    limits = Limits(0.5, 1.0, 0.0)
    points = (10.0, 90.0, 0.0), (30.0, 92.0, 0.0)
    edges = planned(command(LINES, *points, limits=limits), 80.0, 0.0)
    assert [edge.time_ns / S for edge in edges] == [0.0, 20.0, 40.0]
    assert length(edges, 10.0) == (85.0, 0.5) and length(edges, 30.0) == (91.0, 0.1)
    cubics = planned(command(CUBICS, *points, limits=limits), 80.0, 0.0)
    rates = [abs(length(cubics, t)[1]) for t in np.linspace(0.0, 60.0, 2000)]
    assert 0.499 < max(rates) <= 0.5 + 1e-12
    assert cubics[-1].time_ns == 50 * S  # 1.5 m/s in the middle of the first part


def test_a_profile_beyond_a_limit_waits_there_until_it_comes_back():
    limits = Limits(0.0, 1.0, 95.0)
    edges = planned(command(LINES, (20.0, 100.0, 0.0), (60.0, 80.0, 0.0), limits=limits), 80.0, 0.0)
    assert [edge.time_ns / S for edge in edges] == [0.0, 15.0, 30.0, 60.0]
    found = [length(edges, t)[0] for t in np.arange(70.0)]
    expected = np.minimum(np.interp(np.arange(70.0), [0, 20, 60], [80, 100, 80]), 95.0)
    np.testing.assert_allclose(found, expected, atol=1e-9)


@pytest.mark.parametrize("points, kind, said", [
    (((0.0, math.nan, 0.0),), LINES, "position is nan m; allowed: 0.2 to 1e[+]07"),
    (((1.0, 50.0, 0.0), (1.0, 60.0, 0.0)), LINES, "time_from_start is 1 s; allowed: from 0"),
    (((0.0, 50.0, 1e9),), CUBICS, "velocity is 1e[+]09 m/s; allowed: 0, and 1e-09 to 1000 in"),
    (tuple((float(i), 50.0, 0.0) for i in range(MOST_POINTS + 1)), LINES, "it has 1001 points"),
    (((0.0, 0.0, 1e-300),), RATE, "velocity is 1e-300 m/s; allowed: 0, and 1e-09 to 1000"),
    (((0.0, 50.0, 0.0),), TARGET, "speed is 0 m/s; allowed: more than 0"),
])  # fmt: skip
def test_what_cannot_be_flown_is_refused(points, kind, said):
    with pytest.raises(TssError, match=said):
        command(kind, *points).check()


def commands(rng, count):
    """Commands of all kinds to all reels, in the order of time."""
    limits = Limits(1.5, 2.0, 9_990.0)
    for time_s in np.cumsum(rng.uniform(1.0, 60.0, count)):
        kind, place = int(rng.integers(4)), int(rng.integers(3))
        points = [(float(rng.integers(2)) * 30.0, 0.0, float(rng.uniform(-2.0, 2.0)))]
        if kind == TARGET:
            points = [(0.0, float(rng.uniform(9_900.0, 9_999.0)), 0.8)]
        elif kind in (LINES, CUBICS):
            times = np.cumsum(rng.uniform(5.0, 40.0, 3))
            rows = rng.uniform((9_900.0, -1.0), (9_999.0, 1.0), (3, 2))
            points = [(float(t), *row) for t, row in zip(times, rows.tolist())]
        yield command(kind, *points, time_s=float(time_s), place=place, limits=limits)


@pytest.mark.parametrize("seed", range(5))
def test_lengths_go_on_and_do_not_depend_on_what_is_forgotten(seed, tmp_path):
    start = ReelStart((9_950.0,) * 3)
    whole, kept = ReelTable(RING, start), ReelTable(RING, start)
    rng = np.random.default_rng(seed)
    given = list(commands(rng, 40))
    for one in given:
        assert whole.post(one)
    assert whole.collect(0)
    seen = []
    for one in given:
        assert kept.post(one) and kept.collect(one.time_ns)
        seen += [edge for edge in kept.edges if edge.time_ns == one.time_ns]
        other = ReelTable(RING, start)
        other.arrays = kept.arrays
        assert other.edges == kept.edges and other.base == kept.base
    assert len(kept.arrays["reel_heads"]) <= 3
    last = [edge for edge in whole.edges if edge.time_ns >= given[-1].time_ns]
    assert last == [edge for edge in kept.edges if edge.time_ns >= given[-1].time_ns]
    assert set(seen) <= set(whole.edges)
    for place in range(3):
        edges = [edge for edge in whole.edges if edge.place == place]
        for before, after in zip(edges, edges[1:]):
            gap = before.at(after.time_ns)[0] - after.cubic[0]
            assert abs(gap) < 1e-8
            assert 2.0 <= after.cubic[0] <= 9_990.0 + 1e-9 and abs(after.cubic[1]) <= 1.5 + 1e-9


def test_a_clock_that_is_set_anew_moves_plans_exactly():
    table = ReelTable(RING)
    assert table.post(command(CUBICS, (10.0, 9_990.0, 0.0), time_s=5.0)) and table.collect(0)
    before = table.edges
    table.shift(123 * S)
    assert [e._replace(time_ns=e.time_ns - 123 * S) for e in table.edges] == before


def test_reels_forces_and_cuts_stand_in_one_table():
    table = CommandTable(RING, ReelStart((9_000.0, 10e3, 10e3)))
    assert table and table.at(0).acts(RING)
    assert table.post(Command(10 * S, 0, 0, (1.0, 0.0, 0.0)))
    assert table.post(command(TARGET, (0.0, 9_100.0, 1.0), time_s=5.0)) and table.collect(0)
    assert [t / S for t, _ in table.edges(0)] == [5.0, 10.0, 105.0]
    last = table.at(200 * S)
    assert last.reel[0].tolist() == [0.0, 9_100.0, 0.0, 0.0, 0.0] and last.pushes
    assert table.at(4 * S).reel[0, 1] == 9_000.0 and not table.at(4 * S).pushes
    back = command(TARGET, (0.0, 10e3, 10.0), time_s=300.0)
    assert table.post(back) and table.collect(250 * S)
    assert np.array_equal(table.at(400 * S).reel, CommandTable(RING).at(0).reel)


def test_a_flood_of_profiles_is_refused():
    table = ReelTable(RING)
    profile = tuple((1.0 + i, 9_990.0, 0.0) for i in range(MOST_POINTS))
    taken = [table.post(command(LINES, *profile, time_s=float(i))) for i in range(20)]
    assert sum(taken) == MOST_KEPT_POINTS // MOST_POINTS and taken[0] and taken[1]
    assert table.collect(0) and not table.post(command(LINES, *profile, time_s=99.0))
    assert len(reels(RING)) == 3


def test_a_creeping_reel_has_a_plan():
    for kind, point in ((TARGET, (0.0, 50.0, 1e-9)), (RATE, (0.0, 0.0, 1e-9))):
        (edge,) = planned(command(kind, point), 100.0, 0.0)
        assert edge.at(10**18)[0] == pytest.approx(100.0 + math.copysign(1.0, edge.cubic[1]))


@pytest.mark.parametrize("taken", [1, 8])
def test_states_and_tensions_are_those_of_an_integration_that_knew_all_commands(taken):
    """A command of time 0 that comes after the first state is out does not show in it."""
    run = {"publish_period_s": 2.0, "disturbance_m": 5.0, "disturbance_seed": 3, "turns": 0.0}
    setup = setup_of("three_star", {"spin_rate_ratio": -2.9}, run)
    live = Simulation(setup, 0.0, threading.Event().set)
    found = [live.take().alone for _ in range(taken)]
    assert live.commands.post(command(RATE, (25.0, 0.0, -0.4), place=1))
    found += [live.take().alone for _ in range(40)]
    changes = live.take_changes()
    assert [t / S for t, *_ in changes] == [2.0 * (taken - 1), 2.0 * (taken - 1) + 25.0]
    propagator = Propagator(setup.system, setup.spin_rate_ratio, setup.start)
    propagator.command([(edge_s(setup, time_ns), acting) for time_ns, acting, _ in changes])
    again = compute_states(setup, propagator, 0, len(found))
    for name in ("position_m", "tension_n", "taut", "rest_length_m", "rest_rate_m_s"):
        column = np.concatenate([getattr(states, name) for states in found])
        np.testing.assert_array_equal(getattr(again, name), column, name)
    np.testing.assert_allclose(again.rest_length_m[-1], [10e3, 9_990.0, 10e3], rtol=1e-12)
    live.close()
