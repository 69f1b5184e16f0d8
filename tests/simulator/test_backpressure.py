"""How a simulator keeps step with its recorders, without any middleware."""

import threading
import time
from types import SimpleNamespace

import pytest
from ros_harness import wait_until

from tss_ros.simulator import backpressure
from tss_ros.simulator.backpressure import FlowControl

WINDOW = 10


class Run:
    """A flow control whose simulator publishes as fast as it may, in a thread."""

    def __init__(self, patience_s=60.0):
        self.warnings = []
        self._wake = threading.Event()
        self.present = 0
        logger = SimpleNamespace(warning=lambda text, **_: self.warnings.append(text))
        self.flow = FlowControl(WINDOW, logger, self._wake.set, patience_s, lambda: self.present)
        self.stopped, self.ended = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._publish, daemon=True)

    def start(self, last):
        self._last = last
        self._thread.start()

    def report(self, last_step, output="a", recording=True, matched=True):
        self.flow.on_status(
            SimpleNamespace(
                output=output, recording=recording, matched=matched, last_step=last_step, lost=0
            )
        )

    def reaches(self, step):
        wait_until(lambda: self.flow.published >= step, 5, f"step {step}")

    def stays_at(self, step):
        """Whether the simulator waits at `step`, told by its not having ended long after."""
        self.reaches(step)
        self.ended.wait(0.2)
        return self.flow.published == step

    def _publish(self):
        while self.flow.published < self._last and not self.stopped.is_set():
            self._wake.clear()
            if self.flow.ready():
                self.flow.published += 1
            else:
                self._wake.wait(0.05)
        self.ended.set()


@pytest.fixture
def run(request):
    run = Run(*getattr(request, "param", ()))
    yield run
    run.stopped.set()
    if run._thread.is_alive():
        run._thread.join(5)


def test_without_recorders_nothing_holds_it(run):
    run.start(1_000_000)
    assert run.ended.wait(20)


def test_it_stays_within_the_window_of_the_slowest_recorder(run):
    run.flow.published = 0
    run.report(0)
    run.report(0, output="b")
    run.start(100)
    assert run.stays_at(WINDOW)
    run.report(5)
    run.report(9, output="b")
    assert run.stays_at(5 + WINDOW)
    run.report(0, output="b", recording=False)
    run.report(89)
    assert run.ended.wait(5)


@pytest.mark.parametrize(
    "report", [{"last_step": -1, "matched": False}, {"last_step": -1}, {"last_step": 123_456}]
)
def test_while_a_recorder_joins_steps_go_out_slowly(run, report):
    """Not connected, without any step, and with one of an earlier simulator's steps only."""
    run.report(**report)
    run.start(1000)
    run.reaches(3)
    begun = time.monotonic()
    run.reaches(8)
    assert time.monotonic() - begun > 4 * backpressure.JOIN_STEP_S
    run.report(7)
    assert run.stays_at(7 + WINDOW)


def test_a_recorder_that_came_is_waited_for_before_its_first_word(run, monkeypatch):
    """Steps go out slowly meanwhile, and as before if none comes."""
    monkeypatch.setattr(backpressure, "COME_S", 0.5)
    monkeypatch.setattr(backpressure, "UNHEARD_S", 0.5)
    run.present = 1
    begun = time.monotonic()
    run.start(100_000)
    run.reaches(5)
    assert time.monotonic() - begun > 4 * backpressure.JOIN_STEP_S
    run.flow.check("recorder_status")
    assert not run.warnings
    assert run.ended.wait(20)
    run.flow.check("recorder_status")
    assert len(run.warnings) == 1 and "but nothing comes" in run.warnings[0]


def test_a_recorder_that_gets_nothing_holds_it_only_for_a_while(run, monkeypatch):
    monkeypatch.setattr(backpressure, "JOIN_STEPS", 5)
    run.start(100_000)
    while not run.ended.wait(0.02):
        run.report(-1)
    assert len(run.warnings) == 1 and "'a' reports, but has got none" in run.warnings[0]


def test_a_silent_recorder_is_given_up(run, monkeypatch):
    monkeypatch.setattr(backpressure, "SILENCE_S", 0.3)
    run.flow.published = 0
    run.report(0)
    begun = time.monotonic()
    run.start(100)
    assert run.ended.wait(5)
    assert time.monotonic() - begun > 0.25
    assert len(run.warnings) == 1 and "'a' is silent" in run.warnings[0]


def test_recorders_that_left_are_forgotten(run):
    run.flow.published = 0
    run.report(0)
    run.start(100)
    assert run.stays_at(WINDOW)
    run.flow.check("recorder_status")
    assert run.ended.wait(5)


def test_drained_means_that_every_recorder_has_everything(run, monkeypatch):
    run.report(-1)
    assert run.flow.ready(drain=True)
    run.flow.published = 3
    run.report(3, output="b")
    assert not run.flow.ready(drain=True)
    run.report(2)
    assert run.flow.ready() and not run.flow.ready(drain=True)
    run.report(3)
    assert run.flow.ready(drain=True)
    run.report(-1, output="c")
    assert run.flow.ready(drain=True)
    run.flow.published = 4
    run.report(4)
    run.report(4, output="b")
    assert not run.flow.ready(drain=True)
    monkeypatch.setattr(backpressure, "JOIN_S", 0.0)
    assert run.flow.ready(drain=True)


@pytest.mark.parametrize("run", [(0.5,)], indirect=True)
def test_whoever_reports_no_progress_holds_it_only_for_a_while(run):
    """A recorder that hangs, or a stranger that only says it records."""
    run.flow.published = 0
    run.report(0)
    begun = time.monotonic()
    run.start(100)
    while not run.ended.wait(0.02):
        run.report(0)
        assert time.monotonic() - begun < 60
    assert time.monotonic() - begun > 0.4
    assert len(run.warnings) == 1 and "'a' has been at step 0 for 0.5 s" in run.warnings[0]


@pytest.mark.parametrize("run", [(0.5,)], indirect=True)
def test_a_recorder_that_gets_further_is_waited_for_however_long(run):
    run.flow.published = 0
    run.report(0)
    run.start(100)
    for step in range(0, 100, WINDOW):
        run.report(step)
        assert run.stays_at(min(step + WINDOW, 100)) or step + WINDOW >= 100
    assert run.ended.wait(5) and not run.warnings


@pytest.mark.parametrize("run", [(0.0,)], indirect=True)
def test_without_patience_nobody_holds_it(run):
    run.report(0)
    run.start(100_000)
    assert run.ended.wait(10) and not run.warnings


def test_many_strangers_cost_no_memory(run):
    for number in range(10_000):
        run.report(0, output=str(number))
    assert len(run.flow.recorders) == backpressure.MOST_RECORDERS
