"""The launch files, run by the real `launch` where there is one."""

import importlib.util
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
import ros_harness
from ament_index_python.packages import get_package_share_directory

LAUNCH = Path(get_package_share_directory("tss_ros")) / "launch"
#: What `ros2 launch` does with a file and arguments.
SCRIPT = """
import sys
from launch import LaunchDescription, LaunchService
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import AnyLaunchDescriptionSource
arguments = [tuple(word.split(":=", 1)) for word in sys.argv[2:]]
source = AnyLaunchDescriptionSource(sys.argv[1])
service = LaunchService(argv=sys.argv[2:])
service.include_launch_description(
    LaunchDescription([IncludeLaunchDescription(source, launch_arguments=arguments)])
)
sys.exit(service.run())
"""
needs_launch = pytest.mark.skipif(
    importlib.util.find_spec("launch_ros") is None,
    reason="launch and launch_ros are not installed; ROS 2's own packages have them",
)


@pytest.fixture
def launch(tmp_path):
    """A function that starts a launch file with arguments and returns its process."""
    started = []

    def start(file, *arguments):
        with (tmp_path / "log").open("a") as log:
            command = [sys.executable, "-c", SCRIPT, str(LAUNCH / file), *arguments]
            environ = {**os.environ, "ROS_LOG_DIR": str(tmp_path), "PYTHONUNBUFFERED": "1"}
            process = subprocess.Popen(
                command, cwd=tmp_path, stdout=log, stderr=log, env=environ, start_new_session=True
            )
        started.append(process)
        process.log = lambda: (tmp_path / "log").read_text()
        return process

    yield start
    for process in started:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()


@needs_launch
def test_all_end_when_the_simulator_ends(launch, tmp_path):
    process = launch(
        "simulation.launch.py", "turns:=0.05", "time_scale:=0", "record:=true", "output:=bag"
    )
    assert process.wait(ros_harness.START_S) == 0, process.log()
    log = process.log()
    assert "three_star: 3 satellites" in log and "disturbance" not in log
    assert "messages, 0 lost" in log and (tmp_path / "bag" / "metadata.yaml").is_file()
    assert "Traceback" not in log


@needs_launch
def test_a_scenario_is_a_name_or_a_file_and_nothing_else(launch, tmp_path):
    text = Path(ros_harness.__file__).parents[2] / "tss_ros" / "scenarios" / "six_bead.yaml"
    (tmp_path / "own.yaml").write_text(text.read_text().replace("-2.2", "-2.75"))
    process = launch("simulation.launch.py", "scenario:=own.yaml", "turns:=0.01", "time_scale:=0")
    assert process.wait(ros_harness.START_S) == 0, process.log()
    assert "own.yaml: 3 satellites, 6 beads in all" in process.log()
    assert "spin -2.75 Omega" in process.log()
    for word, expected in (
        ("scenario:=nosuch", "scenario is 'nosuch'; allowed: chain,"),
        ("params_file:=none.yaml", "params_file is 'none.yaml'; allowed: a file that exists"),
        ("record:=maybe", "Valid options are"),
        ("log_level:=loud", "Valid options are"),
    ):
        process = launch("simulation.launch.py", word)
        assert process.wait(20) == 1 and expected in process.log(), process.log()


@needs_launch
def test_arguments_count_beside_a_parameter_file(launch, client, tmp_path):
    (tmp_path / "mine.yaml").write_text(
        "/**:\n  ros__parameters:\n    scenario: six_bead\n    time_scale: 7.0\n    rerun: false\n"
        "    publish_clock: false\n"
    )
    process = launch(
        "simulation.launch.py",
        "params_file:=mine.yaml",
        "scenario:=four_star",
        "namespace:=/mine",
        "log_level:=warn",
    )
    simulator = ros_harness.Simulator(*client, namespace="/mine")
    simulator.wait_for_step(1)
    assert simulator.descriptions[-1].scenario == "four_star"
    simulator.spin_until(lambda: simulator.status, 10, "a status")
    assert simulator.status[-1].time_scale == 7.0
    assert client[0].count_publishers("/clock") == 0
    process.send_signal(signal.SIGINT)
    assert process.wait(20) == 0
    assert "satellites" not in process.log() and "Traceback" not in process.log()


@needs_launch
def test_the_review_starts_without_ros2(launch, tmp_path):
    process = launch("review.launch.xml", "recording:=no such bag")
    process.wait(ros_harness.START_S)
    assert "no such bag" in process.log() and "Traceback" not in process.log()
