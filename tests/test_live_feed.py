"""The live view's feed: whole steps, in order, few enough, and never in the recorder's way."""

import numpy as np
import pytest
import ros_harness
from rclpy.serialization import serialize_message
from std_msgs.msg import Header
from tss_interfaces.msg import BeadStates

from tss_ros import live_feed, review
from tss_ros.core import TssError, initial_state, ring, tether_state
from tss_ros.translate import StepMessages, system_description


class Viewer:
    """Stands in for the Rerun viewer and notes what it gets."""

    def __init__(self):
        self.described, self.steps, self.closed = [], [], False

    def static(self, **description):
        self.described.append(description)

    def log(self, **step):
        self.steps.append(step)

    def close(self):
        self.closed = True


class Logger:
    def __init__(self):
        self.errors = []

    def error(self, text):
        self.errors.append(text)


def test_viewer_gets_whole_steps_in_order(monkeypatch):
    viewer = Viewer()
    monkeypatch.setattr(review, "LiveReview", lambda: viewer)
    system = ring()
    state = initial_state(system, -2.5)
    length_m, tension_n, taut = tether_state(system, state.position_m, state.velocity_m_s)
    make = StepMessages(system, tension_n)
    simulation = {"disturbance_m": 0.0, "disturbance_seed": 0, "publish_period_s": 1.0}
    described = system_description(system, "three_star", -2.5, np.ones(3), simulation)
    feed = live_feed.LiveFeed(Logger())
    feed.take("system_description", serialize_message(described))
    feed.start()
    for step in range(1000):
        time_ns = step * 10**9
        deviation = np.full(3, float(step))
        tethers = make.tether_states(step, time_ns, length_m, tension_n, taut)
        feed.take("tether_states", serialize_message(tethers))
        beads = make.bead_states(step, time_ns, state.position_m, state.velocity_m_s, deviation)
        feed.take("bead_states", serialize_message(beads))
        feed.take("markers", b"not wanted")
    feed.take("bead_states", serialize_message(BeadStates(header=Header(), step=5000)))
    ros_harness.wait_until(lambda: viewer.steps and viewer.steps[-1]["step"][-1] > 900, 20, "steps")
    feed.stop()
    assert viewer.closed
    (description,) = viewer.described
    assert description["bead_name"] == list(system.bead_name)
    np.testing.assert_array_equal(description["tether_ends"], system.tether_ends)
    assert description["turn_s"] == pytest.approx(2522.78, abs=0.01)  # 2 pi / (2.5 Omega)
    shown = {name: np.concatenate([s[name] for s in viewer.steps]) for name in viewer.steps[0]}
    numbers = shown.pop("step")
    assert len(numbers) < 1000 and np.all(np.diff(numbers) > 0)
    np.testing.assert_array_equal(shown.pop("t_s"), numbers)
    np.testing.assert_array_equal(shown.pop("deviation"), np.repeat(numbers[:, None], 3, axis=1))
    expected = {
        "position_m": state.position_m,
        "length_m": length_m,
        "tension_n": tension_n,
        "taut": taut,
    }
    assert shown.keys() == expected.keys()
    for name, values in shown.items():
        np.testing.assert_array_equal(values, np.broadcast_to(expected[name], values.shape))


def test_recording_goes_on_without_a_viewer(monkeypatch):
    def no_screen():
        raise TssError("no screen")

    monkeypatch.setattr(review, "LiveReview", no_screen)
    logger = Logger()
    feed = live_feed.LiveFeed(logger)
    feed.start()
    feed.take("bead_states", b"")
    ros_harness.wait_until(lambda: logger.errors, 20, "a word about it")
    assert "no screen" in logger.errors[0]
    feed.stop()
