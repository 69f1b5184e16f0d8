"""Commands of a simulation: when they hold, for how long, and that nothing else changes."""

import threading

import numpy as np
import pytest

from tss_ros.core import Commands, Propagator
from tss_ros.simulator.commands import CUT, MOST_KEPT, Command, CommandTable
from tss_ros.simulator.simulation import Simulation
from tss_ros.simulator.straight import setup_of
from tss_ros.simulator.trajectory import edge_s

PERIOD_S = 2.0
RUN = {"publish_period_s": PERIOD_S, "disturbance_m": 5.0, "disturbance_seed": 3, "turns": 0.0}
SETUP = setup_of("three_star", {"spin_rate_ratio": -2.9}, RUN)
SYSTEM, S = SETUP.system, 10**9
FORCE = (0.4, -0.3, 0.2)


def simulation():
    return Simulation(SETUP, 0.0, threading.Event().set)


def push(time_s=0.0, bead=0, frame=0, force_n=FORCE):
    return Command(round(time_s * S), bead, frame, force_n)


def acting(*commands):
    """Commands of (bead, frame, force)."""
    forces = [
        (SYSTEM.bead_name[b], ("orbit", "inertial", "spinning")[f], x) for b, f, x in commands
    ]
    return Commands.of(SYSTEM, forces)


def states(simulation, count):
    taken = [simulation.take() for _ in range(count)]
    return np.stack([np.stack([s.position_m, s.velocity_m_s]) for s in taken])


def made_again(changes, count):
    """States of an integration that is told everything at its beginning."""
    propagator = Propagator(SYSTEM, SETUP.spin_rate_ratio, SETUP.start)
    propagator.command([(edge_s(SETUP, time_ns), commands) for time_ns, commands, *_ in changes])
    return np.stack(propagator.sample(PERIOD_S * np.arange(count)), axis=1)


# -- the table -------------------------------------------------------------------------------------


def table(*commands, timeout_s=0.0, now_s=0.0):
    table = CommandTable(SYSTEM)
    table.timeout_ns = round(timeout_s * S)
    assert all(map(table.post, commands)) and table.collect(round(now_s * S))
    return table


def test_a_command_holds_until_the_next_one_of_its_satellite():
    kept = table(push(10), push(30, force_n=(1.0, 0.0, 0.0), frame=2), push(20, bead=2, frame=1))
    first, third = (0, 0, FORCE), (2, 1, FORCE)
    assert kept.edges(0) == [
        (10 * S, acting(first)),
        (20 * S, acting(first, third)),
        (30 * S, acting((0, 2, (1.0, 0.0, 0.0)), third)),
    ]
    assert kept.at(10 * S - 1) == acting() and kept.at(25 * S) == acting(first, third)


def test_what_should_have_held_before_holds_from_the_newest_state():
    assert table(push(3), now_s=7.0).edges(0) == [(7 * S, acting((0, 0, FORCE)))]


def test_a_force_times_out_unless_it_is_commanded_anew():
    kept = table(push(10), push(14), push(11, bead=1), timeout_s=5.0)
    ends = dict(kept.edges(0))
    assert ends[16 * S] == acting((0, 0, FORCE)) and ends[19 * S] == acting()
    assert kept.at(15 * S) == acting((0, 0, FORCE), (1, 0, FORCE))


def test_a_flood_is_refused_and_the_newest_of_one_instant_counts():
    kept, more = CommandTable(SYSTEM), 0
    for i in range(5 * MOST_KEPT):
        more += not kept.post(push(1.0 + i))
    assert more == 4 * MOST_KEPT - SYSTEM.n and kept.collect(0)
    assert not kept.post(push(9e9))
    kept = CommandTable(SYSTEM)
    assert all(kept.post(push(0.0, force_n=(float(i), 0.0, 0.0))) for i in range(5 * MOST_KEPT))
    assert kept.collect(0) and kept.at(0) == acting((0, 0, (5.0 * MOST_KEPT - 1, 0.0, 0.0)))


def test_a_cut_is_for_ever():
    kept = table(Command(5 * S, 1, CUT), push(7, bead=1), timeout_s=3.0)
    assert kept.at(5 * S - 1) == acting()
    assert kept.at(100 * S) == Commands.of(SYSTEM, cut=[SYSTEM.tether_name[1]])


# -- the simulation --------------------------------------------------------------------------------


def test_states_are_those_of_an_integration_that_knew_all_commands_before():
    """Commands come while chunks of states are integrated ahead, some of them between states."""
    live, found = simulation(), []
    for i, command in enumerate(
        [push(), push(0.0, 1, 1), push(51.25, 2, 2), push(0.0, 0, 0, (0.0, 0.0, 0.0)),
         Command(0, 1, CUT), push(0.0, 2, 1, (-0.2, 0.0, 0.4))]
    ):  # fmt: skip
        found.append(states(live, 7 + i))
        assert live.commands.post(command)
    found = np.concatenate([*found, states(live, 300)])
    changes = live.take_changes()
    assert [t / S for t, *_ in changes] == [12.0, 28.0, 51.25, 66.0, 88.0, 112.0]
    np.testing.assert_array_equal(found, made_again(changes, len(found)))
    plain = simulation()
    np.testing.assert_array_equal(found[:7], states(plain, 7))
    assert np.abs(found[-1] - states(plain, len(found) - 7)[-1]).max() > 100.0
    live.close()
    plain.close()


def test_a_tether_that_is_cut_is_told_to_be_slack():
    live = simulation()
    before = states(live, 5)
    live.commands.post(Command(0, 0, CUT))
    assert live.newest.alone.taut[0, 0] and len(before) == 5
    for _ in range(100):
        newest = live.take().alone
        assert not newest.taut[0, 0] and newest.tension_n[0, 0] == 0.0
    assert newest.taut[0, 1:].any() and newest.length_m[0, 0] > SYSTEM.rest_length_m[0]
    live.close()


def test_a_timeout_is_a_change_at_its_time():
    live = simulation()
    live.set_timeout(7.5)
    states(live, 3)
    live.commands.post(push())
    found = states(live, 60)
    changes = live.take_changes()
    assert [t / S for t, *_ in changes] == [4.0, 11.5]
    assert [c.pushes for _, c, _ in changes] == [True, False]
    np.testing.assert_array_equal(found, made_again(changes, 63)[3:])
    live.close()


def test_a_snapshot_holds_forces_in_effect_and_to_come(tmp_path):
    live = simulation()
    live.set_timeout(100.0)
    states(live, 5)
    for command in (push(), push(60.0, 1, 1), Command(40 * S, 2, CUT)):
        live.commands.post(command)
    states(live, 8)
    file = str(tmp_path / "kept.npz")
    live.save(file)
    expected = states(live, 200)
    live.restore(file)
    live.take()
    np.testing.assert_array_equal(states(live, 200), expected)
    other = simulation()
    other.set_timeout(100.0)
    other.restore(file)
    other.take()
    np.testing.assert_array_equal(states(other, 200), expected)
    changes = other.take_changes()
    assert [t / S for t, *_ in changes] == [24.0, 40.0, 60.0, 108.0, 160.0]
    other.close()
    live.close()


def test_disturbances_keep_commands_and_resets_end_them():
    live = simulation()
    states(live, 3)
    live.commands.post(push(0.0, 0, 1))
    states(live, 3)
    live.disturb(0.0, 0.0)
    found = states(live, 50)
    whole = simulation()
    states(whole, 3)
    whole.commands.post(push(0.0, 0, 1))
    expected = states(whole, 53)[3:]
    np.testing.assert_allclose(found, expected, atol=1e-5)
    assert len(live.take_changes()) == 1, "a disturbance changes no command"
    live.reset(SETUP)
    again = states(live, 50)
    np.testing.assert_array_equal(again, states(simulation(), 50))
    (change,) = live.take_changes()
    assert change == (0, Commands.none(SYSTEM), ())
    live.close()
    whole.close()


@pytest.mark.parametrize("time_s", [0.0, 1e-9, 1.0, 1.999999999, 2.0, 123.456])
def test_times_in_nanoseconds_are_times_of_states_where_they_are_theirs(time_s):
    index = time_s / PERIOD_S
    assert edge_s(SETUP, round(time_s * S)) == (time_s if index % 1 else index * PERIOD_S)
