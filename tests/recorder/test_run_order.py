"""Runs stay apart in whatever order messages arrive; no middleware."""

from types import SimpleNamespace
from typing import NamedTuple

import pytest

from tss_ros.recorder import run_order
from tss_ros.recorder.recorded_topic import Message
from tss_ros.recorder.run_order import RunOrder


class Topic(NamedTuple):
    """What is asked of a topic."""

    name: str
    every_step: bool


DESCRIPTIONS = Topic("descriptions", False)
BEADS, TETHERS = Topic("beads", True), Topic("tethers", True)


class Files:
    """Sent times in each file that a RunOrder makes of messages."""

    def __init__(self):
        self.files = [[]]
        self.order = RunOrder(
            DESCRIPTIONS,
            lambda message: self.files[-1].append(message.taken.sent_ns),
            lambda: self.files.append([]),
        )

    def take(self, *messages):
        for topic, sent_ns, *sender in messages:
            sender = sender[0] if sender else "first"
            self.order.add(Message(topic, SimpleNamespace(sent_ns=sent_ns, sender=sender)))
        self.order.release()
        return self.files


def test_what_arrives_in_order_is_handed_on_at_once():
    files = Files()
    assert files.take((DESCRIPTIONS, 1), (BEADS, 2), (TETHERS, 3)) == [[1, 2, 3]]
    assert files.take((DESCRIPTIONS, 4), (BEADS, 5), (TETHERS, 6)) == [[1, 2, 3], [4, 5, 6]]


def test_a_run_waits_for_the_rest_of_the_one_before():
    files = Files()
    files.take((DESCRIPTIONS, 1), (BEADS, 2), (TETHERS, 2))
    assert files.take((DESCRIPTIONS, 10), (BEADS, 11), (BEADS, 12)) == [[1, 2, 2]]
    assert files.take((TETHERS, 3), (TETHERS, 4)) == [[1, 2, 2, 3, 4]]
    assert files.take((TETHERS, 11)) == [[1, 2, 2, 3, 4], [10, 11, 11, 12]]


def test_runs_that_are_held_back_are_told_apart():
    files = Files()
    files.take((DESCRIPTIONS, 1), (BEADS, 2), (TETHERS, 2))
    files.take((DESCRIPTIONS, 10), (BEADS, 11), (DESCRIPTIONS, 20), (BEADS, 21))
    assert files.take((TETHERS, 3)) == [[1, 2, 2, 3]]
    assert files.take((TETHERS, 11), (TETHERS, 21)) == [[1, 2, 2, 3], [10, 11, 11], [20, 21, 21]]


def test_it_does_not_wait_for_ever(monkeypatch):
    files = Files()
    files.take((DESCRIPTIONS, 1), (BEADS, 2), (TETHERS, 2))
    assert len(files.take((DESCRIPTIONS, 10), (BEADS, 11))) == 1
    monkeypatch.setattr(run_order, "HOLD_S", 0.0)
    assert files.take() == [[1, 2, 2], [10, 11]]


def test_what_another_simulator_sent_before_the_end_of_the_first_is_kept_apart(monkeypatch):
    """Both ran at the same time; the first's last steps arrive when the second is followed."""
    files = Files()
    files.take((DESCRIPTIONS, 3), (BEADS, 4), (TETHERS, 4))
    files.take((DESCRIPTIONS, 1, "second"), (BEADS, 6, "second"), (TETHERS, 6, "second"))
    assert files.take((BEADS, 7), (TETHERS, 7)) == [[3, 4, 4, 7, 7]]
    monkeypatch.setattr(run_order, "HOLD_S", 0.0)
    assert files.take() == [[3, 4, 4, 7, 7], [1, 6, 6]]


def test_nothing_is_kept_back_at_the_end():
    files = Files()
    files.take((DESCRIPTIONS, 1), (BEADS, 2), (TETHERS, 2), (DESCRIPTIONS, 10), (BEADS, 11))
    files.order.release(at_once=True)
    assert files.files == [[1, 2, 2], [10, 11]]


@pytest.mark.parametrize("late", [[(DESCRIPTIONS, 1)], [(DESCRIPTIONS, 0), (DESCRIPTIONS, 1)]])
def test_who_joins_late_hears_of_the_run_after_its_steps(late):
    """That begins no new file."""
    assert len(Files().take((BEADS, 5), (TETHERS, 5), *late, (BEADS, 6))) == 1
