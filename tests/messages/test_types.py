"""What is kept of message types for machines without ROS is what ROS has."""

import pytest

from tss_ros.core import TssError
from tss_ros.messages import types
from tss_ros.messages.cdr import Types
from tss_ros.messages.topics import read_topics

RECORDED = [t for t in read_topics().values() if t.recorded]


def test_kept_types_are_the_installed_ones(tmp_path):
    """`python -c "from tss_ros.messages import types; types.renew()"` mends it."""
    types.renew(tmp_path / "types.json")
    assert (tmp_path / "types.json").read_text() == types.KEPT.read_text()


@pytest.mark.parametrize("topic", RECORDED, ids=lambda topic: topic.name)
def test_without_ros_a_type_has_the_same_fields_and_hash(topic, monkeypatch):
    installed = Types(topic.definition), topic.type_hash
    monkeypatch.delenv("AMENT_PREFIX_PATH")
    assert "#" not in topic.definition
    assert (Types(topic.definition), topic.type_hash) == installed


def test_a_type_that_is_nowhere_is_refused(monkeypatch):
    monkeypatch.delenv("AMENT_PREFIX_PATH")
    with pytest.raises(TssError, match="'some/msg/Type' is not installed"):
        types.definition("some/msg/Type")
