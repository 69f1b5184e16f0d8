"""What a recorder takes for a message of its type, against the middleware's own reader."""

import random

import numpy as np
import pytest
from geometry_msgs.msg import Vector3
from rclpy.serialization import deserialize_message, serialize_message
from tss_interfaces.msg import (
    AppliedWrenches,
    FloquetResult,
    RelativeStates,
    SystemDescription,
    TetherMeasurements,
)

from tss_ros.core import initial_state
from tss_ros.messages.steps import States, StepMessages
from tss_ros.messages.topics import STATE_TOPICS
from tss_ros.recorder.wellformed import Form, Malformed
from tss_ros.ros.messages import simulation_event
from tss_ros.ros.topics import read_topics
from tss_ros.scenarios import scenario

#: Damaged messages tried of each type.
TRIES = 600


def messages():
    """A message of each recorded type: what a simulator publishes, and filled ones of the rest."""
    loaded = scenario.load("six_bead")
    system = loaded.build()
    state = initial_state(system, loaded.spin_rate_ratio)
    moved = state.position_m[None], state.velocity_m_s[None]
    states = States.of(system, np.ones(system.n), np.array([10]), *moved)
    make = StepMessages(system, states.tension_n[0])
    return {
        **{
            name: deserialize_message(make.rows(name, 1, states)[0].tobytes(), t.message_class)
            for name, t in read_topics().items()
            if name in STATE_TOPICS
        },
        "simulation_events": simulation_event(10, 1, 0, "reset", "time and Ω", "orbit"),
        "stability_results": FloquetResult(verdict="stable", message="", tether_law="x"),
        "applied_wrenches": AppliedWrenches(
            step=3,
            satellite=["a"],
            frame=["orbit"],
            force_n=[1.0, 2.0, 3.0],
            cut_tether=["é"],
            dead_actuator=["b"],
            stuck_actuator=["é", "c"],
        ),
        "~/{satellite}/relative_states": RelativeStates(
            observer="a", name=["b", "é"], position=[Vector3(x=1.0)] * 2, velocity=[Vector3()] * 2
        ),
        "~/tether_measurements": TetherMeasurements(
            name=["t", "ü"], range_m=[1.0, 2.0], tension_n=[0.5, 0.25]
        ),
        "system_description": SystemDescription(
            bead_name=["a", "bc"], is_satellite=[True, False], tether_ends=[0, 1], versions=["é"]
        ),
    }


MESSAGES = messages()


def test_every_recorded_type_is_tried():
    assert MESSAGES.keys() == {name for name, topic in read_topics().items() if topic.recorded}


def readable(data, kind):
    """Whether the middleware can make a message of it."""
    try:
        deserialize_message(data, kind)
    except Exception:
        return False
    return True


def accepted(form, data):
    """Whether it is taken for a message of the type."""
    try:
        form.check(data)
    except Malformed:
        return False
    return True


def damaged(data, chance):
    """The same, cut off, or with a changed bit, or with four random bytes somewhere."""
    kind, place = chance.random(), chance.randrange(len(data) - 4)
    if kind < 0.3:
        return data[:place]
    changed = bytearray(data)
    if kind < 0.6:
        changed[place] ^= 1 << chance.randrange(8)
    else:
        changed[place : place + 4] = chance.randbytes(4)
    return bytes(changed)


@pytest.mark.parametrize("name", MESSAGES)
def test_nothing_is_accepted_that_the_middleware_cannot_read(name):
    """Whether a message of the same shape has been seen before or not."""
    topic, message = read_topics()[name], MESSAGES[name]
    data = message if isinstance(message, bytes) else serialize_message(message)
    seen, chance = Form(topic.type), random.Random(3)
    assert accepted(seen, data) and accepted(seen, data)
    refused = 0
    for _ in range(TRIES):
        tried = damaged(data, chance)
        taken = accepted(seen, tried)
        assert taken == accepted(Form(topic.type), tried)
        assert not taken or readable(tried, topic.message_class)
        refused += not taken
        assert accepted(seen, data)
    assert 0.25 * TRIES < refused < TRIES


def test_the_reason_names_type_and_fault():
    data = serialize_message(MESSAGES["simulation_events"])
    form = Form("tss_interfaces/msg/SimulationEvent")
    for tried, reason in (
        (data[:20], "SimulationEvent: it ends after 20 bytes, too early"),
        (b"\0\7" + data[2:], "it begins with '0007'"),
        (data + bytes(20), "bytes stand behind its last field"),
        (data.replace("Ω".encode(), b"\xff\xff"), "is no text"),
    ):
        with pytest.raises(Malformed, match=reason):
            form.check(tried)
