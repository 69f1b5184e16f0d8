"""The package's nodes as processes of their own: started, watched, recorded and ended together."""

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from ament_index_python.packages import get_package_prefix
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from tss_interfaces.msg import RecorderStatus

from tss_ros.bags.recording import Recording, read_bag
from tss_ros.core import Cancelled, TssError
from tss_ros.ros.network import stay_on_this_machine
from tss_ros.ros.node import USER_ERRORS
from tss_ros.ros.topics import read_topics
from tss_ros.simulator.simulation import last_index

#: A node that does not end this long [s] after SIGINT is killed.
STOP_S = 5.0
#: No new step for so long [s] is an error; compiling the integrator once takes a good part of it.
STALL_S = 150.0
#: How long [s] to wait, at the end, for the recorder's last report, which only shows progress.
LAST_REPORT_S = 2.0
LOG_LINES = 15
#: Progress is shown at least so often [s], even where there is none.
SHOW_S = 2.5


class Nodes:
    """The nodes as processes of their own, all of which are gone when the `with` block ends.

    Parameters
    ----------
    log_directory : Path
        Takes what the nodes print.
    """

    def __init__(self, log_directory: Path) -> None:
        self._log_directory = log_directory
        self._processes = {}

    def __enter__(self):
        return self

    def __exit__(self, *_):
        for process in self._processes.values():
            if process.poll() is None:
                process.send_signal(signal.SIGINT)
        for process in self._processes.values():
            try:
                process.wait(STOP_S)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()

    def start(self, name: str, **parameters: Any) -> None:
        """Start the executable `name` of this package with these ROS parameters."""
        command = [Path(get_package_prefix("tss_ros")) / "lib" / "tss_ros" / name, "--ros-args"]
        for key, value in parameters.items():
            command += ["-p", f"{key}:={json.dumps(value)}"]
        with self._log(name).open("wb") as log:
            # In a session of its own: Ctrl-C reaches this process, which then stops them in order.
            self._processes[name] = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )

    def check(self) -> None:
        """Raise TssError, with the last lines it printed, if a node has ended with an error."""
        for name, process in self._processes.items():
            if process.poll():
                raise TssError(f"{name} ended with status {process.returncode}{self._tail(name)}")

    def running(self, name: str) -> bool:
        """Whether a node has not ended yet."""
        return self._processes[name].poll() is None

    def stop(self, name: str) -> None:
        """End a node with SIGINT.

        Raises
        ------
        TssError
            If it does not end in time, or not with status 0.
        """
        process = self._processes[name]
        process.send_signal(signal.SIGINT)
        try:
            process.wait(STOP_S)
        except subprocess.TimeoutExpired:
            raise TssError(
                f"{name} did not end within {STOP_S:g} s of SIGINT{self._tail(name)}"
            ) from None
        self.check()

    def _log(self, name):
        return self._log_directory / f"{name}.log"

    def _tail(self, name):
        lines = self._log(name).read_text(encoding="utf-8", errors="replace").splitlines()
        return "".join(f"\n  {line}" for line in ["; it printed last:", *lines[-LOG_LINES:]])


class Watch:
    """Looks after running nodes: call it several times a second while waiting for something.

    Attributes `last_step` and `messages` tell what the recorder has reported, `reported_s` when.

    Parameters
    ----------
    nodes : Nodes
    ros_node : rclpy.node.Node
        Hears the recorder's reports.
    caught : list of int
        Signals that came in.
    show : callable
        Called with this object and the caller's own progress when either moved, and every `SHOW_S`.
    """

    def __init__(
        self, nodes: Nodes, ros_node: Node, caught: list[int], show: Callable[["Watch", int], None]
    ) -> None:
        self._nodes, self._caught, self._show = nodes, caught, show
        self.last_step, self.messages, self.reported_s = 0, 0, 0.0
        self._done, self._state = 0, None
        self._changed = self._shown = time.monotonic()
        qos = read_topics()["recorder_status"].qos
        ros_node.create_subscription(RecorderStatus, "recorder_status", self._on_status, qos)

    def __call__(self, done=None):
        """Note how much else was done, and show progress.

        Raises
        ------
        KeyboardInterrupt
            If a signal came in.
        TssError
            If a node ended with an error, or if nothing moved for `STALL_S`.
        """
        self._done = self._done if done is None else done
        if self._caught:
            raise KeyboardInterrupt
        self._nodes.check()
        state, clock = (self.messages, self._done), time.monotonic()
        if state != self._state or clock - self._shown > SHOW_S:
            if state != self._state:
                self._state, self._changed = state, clock
            self._shown = clock
            self._show(self, self._done)
        if clock - self._changed > STALL_S:
            raise TssError(f"nothing was recorded or computed for {STALL_S:g} s")

    def _on_status(self, status):
        self.reported_s = status.stamp.sec + status.stamp.nanosec * 1e-9
        if status.messages:
            self.last_step, self.messages = max(0, status.last_step), status.messages


@contextlib.contextmanager
def watched_nodes(
    name: str, log_directory: Path, caught: list[int], show: Callable[[Watch, int], None]
) -> Iterator[tuple[Nodes, Node, Watch]]:
    """Start nodes and watch over them in a `with` block, at whose end all are gone.

    Parameters
    ----------
    name : str
        Of this process's own ROS node.
    log_directory : Path
        Takes what the nodes print.
    caught : list of int
        Signals that came in.
    show : callable
        As for `Watch`.

    Yields
    ------
    tuple of Nodes, rclpy.node.Node and Watch
    """
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    try:
        ros_node = rclpy.create_node(name)
        with Nodes(log_directory) as nodes:
            yield nodes, ros_node, Watch(nodes, ros_node, caught, show)
    finally:
        rclpy.try_shutdown()


def record(
    nodes: Nodes,
    ros_node: Node,
    watch: Watch,
    bag: Path,
    meanwhile: Callable[[], None] | None = None,
    **simulator: Any,
) -> Recording:
    """Simulate as fast as the recorder writes, and read the recording back.

    Parameters
    ----------
    nodes, ros_node, watch
        From `watched_nodes`.
    bag : Path
        Directory to be made.
    meanwhile : callable, optional
        Work of this process while the simulator runs; it has to call `watch`.
    **simulator
        Parameters of `sim_node`; `turns` and `publish_period_s` are required.

    Returns
    -------
    tss_ros.bags.recording.Recording
        With every step.

    Raises
    ------
    KeyboardInterrupt
        If a signal came in.
    TssError
        If a node fails or messages were lost.
    """
    nodes.start("logger_node", output=str(bag))
    nodes.start("sim_node", time_scale=0.0, wait_for_recorder=True, **simulator)
    if meanwhile:
        meanwhile()
    while nodes.running("sim_node"):
        rclpy.spin_once(ros_node, timeout_sec=0.1)
        watch()
    ended_s = time.time()
    while watch.reported_s < ended_s and time.time() < ended_s + LAST_REPORT_S:
        rclpy.spin_once(ros_node, timeout_sec=0.1)
        watch()
    nodes.stop("logger_node")
    recording = read_bag(bag)
    duration_s = simulator["turns"] * recording.turn_s
    steps = 1 + last_index(duration_s, simulator["publish_period_s"])
    if not np.array_equal(recording.step, np.arange(steps)):
        raise TssError(f"{len(recording.step)} of {steps} steps were recorded")
    return recording


def run_command(name: str, work: Callable[[list[int]], None]) -> int:
    """Run a command that starts nodes, and return its exit status.

    Parameters
    ----------
    name : str
        Executable, for messages.
    work : callable
        Called with a list that takes the signals which come in; it has to end at the first.

    Returns
    -------
    int
        0, 1 if something failed that the user can put right, 128 + n when ended by signal n.
    """
    # Such a command talks to nobody but its own nodes.
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    stay_on_this_machine()
    os.environ.setdefault("ROS_DOMAIN_ID", str(1 + os.getpid() % 100))
    caught = []
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, lambda number, _: caught.append(number))
    try:
        work(caught)
    except (KeyboardInterrupt, Cancelled):
        print(f"\n{name}: interrupted", file=sys.stderr)
        return 128 + caught[0]
    except USER_ERRORS as error:
        print(f"\n{name}: {error}", file=sys.stderr)
        return 1
    return 0
