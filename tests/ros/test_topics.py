"""Topics have the QoS of recording.yaml, unless the parameters of a node say otherwise."""

from pathlib import Path

import pytest
import ros_harness
from ament_index_python.packages import get_package_share_directory
from simulation_interfaces.srv import StepSimulation
from tss_interfaces.msg import (
    CriticalRate,
    FloquetResult,
    GrowthResult,
    Mode,
    SimulationEvent,
    SpecialPoint,
)

from tss_ros import core
from tss_ros.ros.topics import read_topics


def test_topics_have_the_qos_of_the_file_unless_overridden(start, client):
    node, spin_until = client
    simulator = start(
        "sim_node",
        **{
            "qos_overrides./markers.publisher.reliability": "best_effort",
            "qos_overrides./bead_states.publisher.depth": 77,
        },
    )
    expected = {
        name: (topic.depth, "RELIABLE", topic.durability)
        for name, topic in read_topics().items()
        if topic.publisher == "sim_node" and name != "/tf" and not topic.optional
    }
    expected["markers"] = (1000, "BEST_EFFORT", "volatile")
    expected["bead_states"] = (77, "RELIABLE", "volatile")

    def offered():
        found = {
            name: [
                (i.qos_profile.reliability.name, i.qos_profile.durability.name.lower())
                for i in node.get_publishers_info_by_topic(name)
            ]
            for name in expected
        }
        return all(found.values()) and found

    found = spin_until(offered, ros_harness.START_S, "every topic")
    assert found == {name: [qos[1:]] for name, qos in expected.items()}
    # The middleware does not tell depths to others; the node's parameters do.
    sim = ros_harness.Simulator(node, spin_until)
    refused = sim.set(**{"qos_overrides./bead_states.publisher.depth": 78})
    assert not refused.successful and "read-only" in refused.reason
    assert simulator.stop() == 0


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ({"qos_overrides./markers.publisher.reliability": "perhaps"}, "perhaps"),
        ({"qos_overrides./markers.publisher.depth": 0}, "depth is 0; allowed: 1 to 1000000"),
        ({"qos_overrides./markers.publisher.depth": "x"}, "depth"),
        ({"publish_tf": True}, "/tf needs the package tf2_msgs"),
    ],
)
def test_what_cannot_be_published_ends_the_node_with_one_line(start, given, expected):
    if "publish_tf" in given:
        try:
            import tf2_msgs  # noqa: F401

            pytest.skip("tf2_msgs is installed here")
        except ModuleNotFoundError:
            pass
    process = start("sim_node", **given)
    assert process.wait(ros_harness.START_S) == 1
    (line,) = process.stderr.splitlines()
    assert line.startswith("sim_node: ") and expected in line


@pytest.mark.parametrize(
    ("kind", "prefix", "texts"),
    [
        (FloquetResult, "VERDICT", core.VERDICTS),
        (FloquetResult, "FAMILY", core.FAMILIES),
        (GrowthResult, "VERDICT", core.GROWTH_VERDICTS),
        (CriticalRate, "CAUSE", core.CAUSES),
        (SpecialPoint, "KIND", core.SPECIAL_KINDS),
        (Mode, "DIRECTION", core.DIRECTIONS),
        (SimulationEvent, "KIND", ("reset", "restore", "disturb", "place", "cut", "fail")),
    ],
)
def test_texts_of_messages_have_constants(kind, prefix, texts):
    names = [f"{prefix}_{text.upper().replace(' ', '_')}" for text in texts]
    assert [getattr(kind, name) for name in names] == list(texts)
    path = Path(get_package_share_directory("tss_interfaces")) / "msg" / f"{kind.__name__}.msg"
    assert path.read_text().count(f"string {prefix}_") == len(texts)


def test_a_request_to_step_asks_for_one_step_unless_it_says_more():
    assert StepSimulation.Request().steps == 1
