"""Files for viewers and parameters: they fit the nodes."""

import json
from pathlib import Path

import ros_harness
import yaml
from ament_index_python.packages import get_package_share_directory
from diagnostic_msgs.msg import DiagnosticArray

from tss_ros import scenarios
from tss_ros.messages.steps import FRAME_ID
from tss_ros.ros.topics import read_topics
from tss_ros.scenarios.scenario import shipped

SHARE = Path(get_package_share_directory("tss_ros"))
SCENARIOS = ("three_star", "three_star_50kg", "three_star_1000kg", "six_bead")


def test_every_scenario_has_a_parameter_file():
    files = {path.stem for path in (SHARE / "config").glob("*.yaml")}
    assert files - {"diagnostics_aggregator"} == set(shipped())


def test_the_aggregator_sorts_every_status_once(start, client):
    """By the names that its analyzers look for, as diagnostic_aggregator does."""
    file = SHARE / "config" / "diagnostics_aggregator.yaml"
    analyzers = yaml.safe_load(file.read_text())["analyzers"]["ros__parameters"]
    assert analyzers.pop("path")
    node, spin_until = client
    start("sim_node", "-r", "__ns:=/left")
    start("logger_node", "-r", "__ns:=/left", output="bag")
    found = {}

    def keep(message):
        assert message.header.stamp.sec > 0
        found.update({status.name: status.hardware_id for status in message.status})

    node.create_subscription(DiagnosticArray, "/diagnostics", keep, 10)
    spin_until(lambda: len(found) == 4, ros_harness.START_S, "all tasks")
    expected = {
        "left/sim_node: motion": ["simulators"],
        "left/sim_node: tethers": ["simulators"],
        "left/sim_node: recorders": ["simulators"],
        "left/logger_node: recording": ["recorders"],
    }
    assert {
        status: [
            name
            for name, analyzer in analyzers.items()
            if analyzer["type"] == "diagnostic_aggregator/GenericAnalyzer"
            and any(text in status for text in analyzer["contains"])
        ]
        for status in found
    } == expected


def test_parameter_files_start_every_node(start, client):
    processes, simulators = [], {}
    for scenario in SCENARIOS:
        file = str(SHARE / "config" / f"{scenario}.yaml")
        given = ("-r", f"__ns:=/{scenario}", "--params-file", file)
        processes.append(start("sim_node", *given, start_paused=True, publish_clock=False))
        simulators[scenario] = ros_harness.Simulator(*client, namespace=f"/{scenario}")
    processes.append(start("stability_node", "--params-file", file))
    processes.append(start("logger_node", "--params-file", file, output="bag"))
    for scenario, simulator in simulators.items():
        simulator.spin_until(lambda s=simulator: s.descriptions, ros_harness.START_S, scenario)
        (message,) = simulator.descriptions
        assert (message.scenario, message.disturbance_m) == (scenario, 10.0)
        assert message.spin_rate_ratio == spin_rate_ratio(scenario)
    processes[-2].wait_for_line("requests about six_bead")
    processes[-1].wait_for_line("recording")
    for process in processes:
        assert process.stop() == 0, process.stderr


def spin_rate_ratio(name):
    """Spin rate in the shipped scenario file, read as plain YAML."""
    text = (Path(scenarios.__file__).with_name(f"{name}.yaml")).read_text()
    return yaml.safe_load(text)["spin_rate_ratio"]


# --- what is shipped for viewers


def test_layouts_show_what_is_published():
    topics = {f"/{name.lstrip('/')}": topic.type for name, topic in read_topics().items()}
    rviz = yaml.safe_load((SHARE / "layouts" / "tss.rviz").read_text())["Visualization Manager"]
    shown = {d["Class"]: d["Topic"]["Value"] for d in rviz["Displays"] if "Topic" in d}
    assert {topics[value].split("/")[-1]: value for value in shown.values()} == {
        kind.split("/")[-1]: value for kind, value in shown.items()
    }
    assert rviz["Global Options"]["Fixed Frame"] == FRAME_ID
    panels = json.loads((SHARE / "layouts" / "tss_foxglove.json").read_text())
    scene = panels["configById"]["3D!formation"]
    assert scene["followTf"] == FRAME_ID and set(scene["topics"]) < set(topics)
    plots = [p for name, p in panels["configById"].items() if name.startswith("Plot!")]
    for path in (path["value"] for plot in plots for path in plot["paths"]):
        topic, field = path.split(".")
        message = next(t for name, t in read_topics().items() if f"/{name}" == topic).message_class
        assert field.removesuffix("[:]") in message.get_fields_and_field_types()

    def leaves(layout):
        if isinstance(layout, str):
            return {layout}
        return leaves(layout["first"]) | leaves(layout["second"])

    assert leaves(panels["layout"]) == set(panels["configById"])
