"""Simulator, stability node and, if asked for, recorder; all end when one of them does.

As in: ros2 launch tss_ros simulation.launch.py scenario:=six_bead record:=true rerun:=true
"""

from pathlib import Path

import yaml
from ament_index_python.packages import get_package_share_directory
from launch.actions import DeclareLaunchArgument, OpaqueFunction, Shutdown
from launch_ros.actions import Node

from launch import LaunchContext, LaunchDescription

YES_OR_NO = ("", "true", "false")
#: What may be given, with its default, what is allowed, and its meaning. Empty: as in params_file,
#: or the node's own default.
ARGUMENTS = (
    ("scenario", "", None, "shipped scenario or path of a scenario file; empty: three_star"),
    ("params_file", "", None, "parameters of all nodes, instead of those in config/"),
    ("turns", "", None, "spin turns after which all ends"),
    ("time_scale", "", None, "simulated seconds per wall second"),
    ("namespace", "", None, "namespace of all nodes"),
    ("publish_clock", "", YES_OR_NO, "false for all but one simulator in a graph"),
    ("publish_tf", "", YES_OR_NO, "publish the frames of the orbit and of every bead"),
    ("record", "false", YES_OR_NO[1:], "record a bag"),
    ("output", "", None, "bag directory to be made; empty: named by date and time"),
    ("rerun", "", YES_OR_NO, "show the motion in Rerun while it is recorded"),
    ("log_level", "info", ("debug", "info", "warn", "error", "fatal"), "of all nodes"),
)
#: Arguments that are parameters of a node under the same name.
OF_SIMULATOR = ("turns", "time_scale", "publish_clock", "publish_tf")
OF_RECORDER = ("output", "rerun")


def common_parameters(given: dict[str, str]) -> list:
    """The parameters of all nodes: a file, and the scenario where it is a path or given besides."""
    config = Path(get_package_share_directory("tss_ros")) / "config"
    scenario, file = given["scenario"], given["params_file"]
    shipped = sorted(path.stem for path in config.glob("*.yaml"))
    own = Path(scenario).suffix in (".yaml", ".yml") and Path(scenario).is_file()
    if scenario and not own and scenario not in shipped:
        raise RuntimeError(
            f"scenario is {scenario!r}; allowed: {', '.join(shipped)}, or a scenario file (.yaml)"
        )
    if file and not Path(file).is_file():
        raise RuntimeError(f"params_file is {file!r}; allowed: a file that exists")
    chosen = [{"scenario": str(Path(scenario).resolve()) if own else scenario}] if scenario else []
    if not file and not own:
        file = str(config / f"{scenario or 'three_star'}.yaml")
    return [file] * bool(file) + chosen


def nodes(context: LaunchContext) -> list[Node]:
    """The nodes that the arguments ask for."""
    given = {name: context.launch_configurations[name] for name, *_ in ARGUMENTS}
    common = common_parameters(given)
    simulator = {name: yaml.safe_load(given[name]) for name in OF_SIMULATOR if given[name]}
    recorder = {name: yaml.safe_load(given[name]) for name in OF_RECORDER if given[name]}
    wanted = {"sim_node": [*common, simulator], "stability_node": common}
    if given["record"] == "true":
        wanted["sim_node"].append({"wait_for_recorder": True})
        wanted["logger_node"] = [*common, recorder]
    return [
        Node(
            package="tss_ros",
            executable=name,
            namespace=given["namespace"],
            parameters=parameters,
            ros_arguments=["--log-level", given["log_level"]],
            output="screen",
            on_exit=Shutdown(reason=f"{name} has ended"),
        )
        for name, parameters in wanted.items()
    ]


def generate_launch_description() -> LaunchDescription:
    """What `ros2 launch` asks for."""
    declared = [
        DeclareLaunchArgument(name, default_value=default, choices=choices, description=meaning)
        for name, default, choices, meaning in ARGUMENTS
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=nodes)])
