"""Blocks of steps: what goes in comes out, and nothing else passes."""

import numpy as np
import pytest

from tss_ros.core import Propagator, TssError, initial_state, ring
from tss_ros.messages.blocks import MAX_STEP, Block, Unpacker, pack
from tss_ros.messages.steps import States, StepMessages
from tss_ros.messages.topics import STATE_TOPICS


def block(first_step=7, count=4, **system):
    formation = ring(**system)
    start = initial_state(formation, -2.5)
    times_s = np.arange(count) * 2.0
    sampled = Propagator(formation, -2.5, start).sample(times_s)
    time_ns = np.rint(times_s * 1e9).astype(np.int64)
    states = States.of(formation, np.ones(formation.n), time_ns, *sampled)
    make = StepMessages(formation, states.tension_n[0])
    return Block(first_step, time_ns, {t: make.rows(t, first_step, states) for t in STATE_TOPICS})


@pytest.mark.parametrize("system", [{}, {"satellites": 4, "beads_per_tether": 2}])
def test_what_goes_in_comes_out(system):
    unpacker = Unpacker()
    for first_step, count in ((0, 1), (MAX_STEP - 9, 9), (7, 4)):
        made = block(first_step, count, **system)
        found = unpacker.unpack(pack(made))
        assert found.first_step == first_step and (found.time_ns == made.time_ns).all()
        assert list(found.columns) == list(STATE_TOPICS)
        for name in STATE_TOPICS:
            assert (found.columns[name] == made.columns[name]).all()


def test_another_system_may_follow():
    unpacker = Unpacker()
    for satellites in (3, 5, 3):
        found = unpacker.unpack(pack(block(satellites=satellites)))
        assert found.columns["bead_states"].shape[0] == 4


def changed(**columns):
    made = block()
    return made._replace(columns=made.columns | columns)


def text_changed():
    rows = block().columns["tether_states"].copy()
    rows[2, rows[2].tobytes().find(b"orbit")] = ord("x")
    return changed(tether_states=rows)


@pytest.mark.parametrize(
    ("made", "reason"),
    [
        (lambda: block(MAX_STEP), "4 steps from 9223372036854775807"),
        (lambda: block()._replace(first_step=8), "tether_states are not steps 8 to 11"),
        (lambda: block()._replace(time_ns=np.arange(4)), "times are not those"),
        (lambda: block()._replace(time_ns=np.arange(3)), "bytes for 3 steps"),
        (lambda: changed(markers=np.zeros((4, 6), np.uint8)), "does not fit"),
        (lambda: changed(markers=np.full((4, 9), 7, np.uint8)), "no plain CDR"),
        (text_changed, "tether_states differ"),
        (lambda: Block(0, np.arange(0), dict.fromkeys(STATE_TOPICS, np.zeros((0, 9)))), "0 steps"),
    ],
)
def test_what_is_no_block_is_refused(made, reason):
    with pytest.raises(TssError, match=reason):
        Unpacker().unpack(pack(made()))
