"""Serialised messages beside those of the middleware, for every recorded type."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message

from tss_ros.core import TssError
from tss_ros.messages import types
from tss_ros.messages.cdr import Layout, serialised
from tss_ros.ros.topics import message_class, read_topics

TOPICS = read_topics()
TEXTS = st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=9)
DEFINITION = """
bool flag
string[] names   # a comment
Place[] places
uint8[3] three
Time stamp
string<=9 word
========
MSG: own/Place
float64 x
float64 y
========
MSG: own/Time
int32 sec
uint32 nanosec
uint8 UNUSED = 7
"""


@pytest.mark.parametrize("name", [name for name, topic in TOPICS.items() if topic.recorded])
def test_the_middleware_reads_an_empty_message_of_every_recorded_type(name):
    topic = TOPICS[name]
    message = deserialize_message(serialised(topic.definition, {}), topic.message_class)
    assert message == topic.message_class()


@settings(max_examples=100, deadline=None)
@given(
    names=st.lists(TEXTS, max_size=4),
    numbers=st.lists(st.floats(allow_nan=False), max_size=7),
    frame_id=st.sampled_from(["", "o", "orbit"]),
    step=st.integers(0, 2**64 - 1),
)
def test_texts_of_any_length_push_the_numbers_about(names, numbers, frame_id, step):
    kind = "tss_interfaces/msg/BeadStates"
    header = {"stamp": {"sec": 3, "nanosec": 4}, "frame_id": frame_id}
    values = {"header": header, "step": step, "name": names, "velocity_m_s": numbers}
    data = serialised(types.definition(kind), values)
    message = deserialize_message(data, message_class(kind))
    assert (message.step, message.name) == (step, names)
    assert (message.header.stamp.nanosec, message.header.frame_id) == (4, frame_id)
    assert message.velocity_m_s.tolist() == numbers and not message.position_m
    layout = Layout(types.definition(kind), data)
    rows, columns = layout.copies(2)
    assert rows.tobytes() == data[: rows.shape[1]] * 2
    assert columns["step"].tolist() == [step] * 2
    assert columns["velocity_m_s"].tolist() == [numbers] * 2


def test_numbers_within_messages_have_names_and_places():
    places = np.array([[1.0, 2.0], [3.0, 4.0]])
    values = {"flag": True, "names": ["a"], "places": places, "three": [1, 2, 3], "word": "é"}
    data = serialised(DEFINITION, values | {"stamp": {"nanosec": 9}})
    layout = Layout(DEFINITION, data)
    assert layout.names == ("flag", "places", "three", "stamp.sec", "stamp.nanosec")
    rows, columns = layout.copies(3)
    columns["places"][1] *= 2.0
    assert layout.numbers(rows)["places"][:2].tolist() == [[1, 2, 3, 4], [2, 4, 6, 8]]
    assert columns["three"][0].tolist() == [1, 2, 3] and columns["stamp.nanosec"][2] == 9
    assert layout.fits(rows).all()
    longer = serialised(DEFINITION, values | {"names": ["b"]})
    assert not layout.fits(np.frombuffer(longer, np.uint8)[None]).any()


@pytest.mark.parametrize(
    ("values", "reason"),
    [
        ({"flags": 1}, "no field 'flags'"),
        ({"word": "a\0b"}, "zero byte"),
        ({"stamp": {"second": 1}}, "no field 'second'"),
    ],
)
def test_what_a_message_cannot_hold_is_refused(values, reason):
    with pytest.raises(TssError, match=reason):
        serialised(DEFINITION, values)


def test_a_type_that_is_not_understood_is_refused():
    with pytest.raises(TssError, match="uses 'Unknown'"):
        Layout("Unknown field", b"\0\1\0\0")
    with pytest.raises(TssError, match="no plain CDR"):
        Layout(DEFINITION, b"\0\7\0\0")
    with pytest.raises(TssError, match="does not fit"):
        Layout(DEFINITION, serialised(DEFINITION, {"names": ["a"]})[:12])
