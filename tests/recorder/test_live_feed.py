"""The live view's feed: whole steps, in order, few enough, and never in the recorder's way."""

import numpy as np
import pytest
import ros_harness
from rclpy.serialization import serialize_message
from std_msgs.msg import Header
from tss_interfaces.msg import BeadStates, FloquetResult

from tss_ros.core import TssError, initial_state, ring, tether_state
from tss_ros.messages.steps import States, StepMessages, system_description
from tss_ros.recorder import live_feed
from tss_ros.review import review


class Viewer:
    """Stands in for the Rerun viewer and notes what it gets."""

    def __init__(self):
        self.runs, self.stability, self.closed, self.earth = [[]], (), False, None

    def begun(self, earth):
        self.earth = earth
        return self

    def begin(self):
        self.runs.append([])

    def show(self, recording):
        self.runs[-1].append(recording)

    def show_stability(self, results):
        self.stability = results

    def close(self):
        self.closed = True

    def has_shown(self, step):
        return bool(self.runs[-1]) and self.runs[-1][-1].step[-1] > step


class Logger:
    def __init__(self):
        self.errors = []

    def error(self, text):
        self.errors.append(text)


@pytest.fixture
def fed(monkeypatch):
    """A viewer and a function that feeds it some steps of a formation that stands still."""
    viewer = Viewer()
    monkeypatch.setattr(review, "LiveReview", viewer.begun)
    system = ring()
    state = initial_state(system, -2.5)
    tethers = tether_state(system, state.position_m, state.velocity_m_s)
    make = StepMessages(system, tethers[1])
    feed = live_feed.LiveFeed(Logger(), earth=True)

    def describe():
        simulation = {"scenario": "three_star", "publish_period_s": 1.0}
        simulation |= {"disturbance_m": 0.0, "disturbance_seed": 0}
        described = system_description(system, -2.5, np.ones(3), simulation)
        feed.take("system_description", described)

    def publish(steps):
        for step in steps:
            moved = state.position_m[None], state.velocity_m_s[None]
            states = States.of(system, np.ones(3), np.array([step * 10**9]), *moved)
            states = states._replace(deviation=np.full((1, 3), float(step)))
            for name in ("tether_states", "bead_states"):
                feed.take(name, make.rows(name, step, states)[0].tobytes())
            feed.take("markers", b"not wanted")

    feed.start()
    yield viewer, feed, describe, publish, (system, state, tethers)
    feed.stop()
    assert viewer.closed and viewer.earth


def test_viewer_gets_whole_steps_in_order(fed):
    viewer, feed, describe, publish, (system, state, tethers) = fed
    describe()
    publish(range(1000))
    feed.take("bead_states", serialize_message(BeadStates(header=Header(), step=5000)))
    ros_harness.wait_until(lambda: viewer.has_shown(900), 20, "steps")
    (shown,) = viewer.runs
    assert shown[0].bead_name == tuple(system.bead_name)
    np.testing.assert_array_equal(shown[0].tether_ends, system.tether_ends)
    assert shown[0].turn_s == pytest.approx(2522.78, abs=0.01)  # 2 pi / (2.5 Omega)
    numbers = np.concatenate([part.step for part in shown])
    assert len(numbers) < 1000 and np.all(np.diff(numbers) > 0)
    np.testing.assert_array_equal(np.concatenate([part.t_s for part in shown]), numbers)
    for part in shown:
        np.testing.assert_array_equal(part.deviation, np.repeat(part.step[:, None], 3, axis=1))
        for name, expected in zip(("length_m", "tension_n", "taut"), tethers):
            values = getattr(part, name)
            np.testing.assert_array_equal(values, np.broadcast_to(expected, values.shape))
        for name in ("position_m", "velocity_m_s"):
            values = getattr(part, name)
            np.testing.assert_array_equal(
                values, np.broadcast_to(getattr(state, name), values.shape)
            )


def test_a_simulation_that_begins_anew_is_shown_anew(fed):
    viewer, feed, describe, publish, _ = fed
    describe()
    publish(range(40, 50))
    ros_harness.wait_until(lambda: viewer.has_shown(48), 20, "the first run")
    publish(range(5))
    ros_harness.wait_until(lambda: len(viewer.runs) == 2 and viewer.has_shown(3), 20, "the second")
    assert viewer.runs[1][0].step[0] == 0


def test_stability_results_are_shown_when_they_come(fed):
    viewer, feed, describe, publish, _ = fed
    describe()
    publish(range(3))
    ros_harness.wait_until(lambda: viewer.has_shown(1), 20, "steps")
    for rate in (-2.0, -3.0):
        result = FloquetResult(spin_rate_ratio=rate, verdict="neutral")
        feed.take("stability_results", serialize_message(result))
    ros_harness.wait_until(lambda: len(viewer.stability) == 2, 20, "both results")
    assert [result.spin_rate_ratio for result in viewer.stability] == [-2.0, -3.0]


def test_recording_goes_on_without_a_viewer(monkeypatch):
    def no_screen(earth):
        raise TssError("no screen")

    monkeypatch.setattr(review, "LiveReview", no_screen)
    logger = Logger()
    feed = live_feed.LiveFeed(logger)
    feed.start()
    feed.take("bead_states", b"")
    ros_harness.wait_until(lambda: logger.errors, 20, "a word about it")
    assert "no screen" in logger.errors[0]
    feed.stop()
