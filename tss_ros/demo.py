"""The whole chain in one go: simulate, record, ask for stability, and leave pictures of it all."""

import argparse
import json
import math
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import rclpy
from ament_index_python.packages import get_package_prefix
from rclpy.signals import SignalHandlerOptions
from tss_interfaces.msg import RecorderStatus

from tss_ros import plots, review, scenario, stability
from tss_ros.core import TssError, deviation
from tss_ros.node_main import USER_ERRORS
from tss_ros.recording import read_bag
from tss_ros.topics import read_topics

SCENARIO, SPIN_RATE_RATIO, TURNS = "three_star", -2.5, 8
PUBLISH_PERIOD_S, DISTURBANCE_M, DISTURBANCE_SEED = 5.0, 10.0, 1
RATES = np.linspace(-1.5, -3.5, 12)
#: All that a demo leaves in its folder; nothing else is ever replaced.
FILES = (
    "bag",
    "review.rrd",
    "trajectories.png",
    "deviation.png",
    "stability.png",
    "stability.csv",
)
BAG_FILES = ("bag/bag_0.mcap", "bag/metadata.yaml")
#: A node that does not end this long [s] after SIGINT is killed.
STOP_S = 5.0
#: No new step for so long [s] ends the demo; compiling the integrator once takes a good part of it.
STALL_S = 150.0
LOG_LINES = 15


class Nodes:
    """The nodes as processes of their own, all of which are gone when the `with` block ends.

    Parameters
    ----------
    log_directory : Path
        Takes what the nodes print.
    """

    def __init__(self, log_directory):
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

    def start(self, name, **parameters):
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

    def check(self):
        """Raise TssError, with the last lines it printed, if a node has ended with an error."""
        for name, process in self._processes.items():
            if process.poll():
                raise TssError(f"{name} ended with status {process.returncode}{self._tail(name)}")

    def running(self, name):
        """Whether a node has not ended yet."""
        return self._processes[name].poll() is None

    def stop(self, name):
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
    """Looks after a running demo: call it several times a second while waiting for something.

    Shows how far things are, on one line of a terminal and elsewhere as a line per turn.
    Attribute `heard` tells whether the recorder has reported.

    Parameters
    ----------
    nodes : Nodes
    ros_node : rclpy.node.Node
        Hears the recorder's reports.
    turn_s : float
        Spin period [s].
    caught : list of int
        Signals that came in.
    """

    def __init__(self, nodes, ros_node, turn_s, caught):
        self._nodes, self._turn_s, self._caught = nodes, turn_s, caught
        self.heard = False
        self._turns, self._messages, self._rates = 0.0, 0, 0
        self._state = self._shown = None
        self._changed = time.monotonic()
        qos = read_topics()["recorder_status"].qos
        ros_node.create_subscription(RecorderStatus, "recorder_status", self._on_status, qos)

    def __call__(self, rates=None):
        """Note how many rates were answered, and show progress.

        Raises
        ------
        KeyboardInterrupt
            If a signal came in.
        TssError
            If a node ended with an error, or if nothing moved for `STALL_S`.
        """
        self._rates = self._rates if rates is None else rates
        if self._caught:
            raise KeyboardInterrupt
        self._nodes.check()
        state = (self._messages, self._rates)
        if state != self._state:
            self._state, self._changed = state, time.monotonic()
            self._show()
        if time.monotonic() - self._changed > STALL_S:
            raise TssError(f"nothing was recorded or computed for {STALL_S:g} s")

    def _on_status(self, status):
        self.heard = True
        if status.messages:
            self._turns = max(0, status.last_step) * PUBLISH_PERIOD_S / self._turn_s
            self._messages = status.messages

    def _show(self):
        turns = round(self._turns, 1)
        line = f"turn {turns} of {TURNS}, {self._messages} messages recorded; "
        line += f"stability of {self._rates} of {len(RATES)} rates"
        if sys.stdout.isatty():
            print(f"\r\033[K{line}", end="", flush=True)
        elif (int(turns), self._rates) != self._shown:
            self._shown = (int(turns), self._rates)
            print(line, flush=True)


def make(output, caught):
    """Run the demo, and at its end put the results into `output` instead of an earlier demo's.

    Parameters
    ----------
    output : Path
    caught : list of int
        Signals that came in; the demo ends at the first.

    Raises
    ------
    KeyboardInterrupt
        If a signal came in.
    TssError
        If a node fails, if messages were lost, or if `output` holds what no demo wrote.
    """
    output = output.resolve()
    _check_replaceable(output)
    output.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=f".{output.name}.", dir=output.parent) as scratch:
        fresh = Path(scratch) / "new"
        fresh.mkdir()
        system = scenario.load(SCENARIO).build({})
        turn_s = 2.0 * math.pi / abs(system.spin_rate_rad_s(SPIN_RATE_RATIO))
        results = _run_nodes(fresh, Path(scratch), turn_s, caught)
        recording = read_bag(fresh / "bag")
        steps = 1 + math.floor(TURNS * turn_s / PUBLISH_PERIOD_S)
        if not np.array_equal(recording.step, np.arange(steps)):
            raise TssError(f"{len(recording.step)} of {steps} steps were recorded")
        for draw in (_save_trajectories, _save_deviation, _save_review):
            if caught:
                raise KeyboardInterrupt
            draw(recording, fresh)
        stability.write_csv(results, fresh / "stability.csv")
        stability.figure(results, "").savefig(fresh / "stability.png")
        _check_replaceable(output)
        if output.exists():
            output.rename(Path(scratch) / "old")
        fresh.rename(output)
    print(stability.format_table(results, stability.TABLE[:-1]), end="\n\n")
    print(_summary(recording), end="\n\n")
    for name in FILES:
        print(os.path.relpath(output / name))


def _check_replaceable(output):
    if output.exists() and not output.is_dir():
        raise TssError(f"output {str(output)!r} is not a folder")
    for path in output.rglob("*"):
        own = path.relative_to(output).as_posix() in (*FILES, *BAG_FILES)
        if not own or path.is_dir() != (path == output / "bag"):
            raise TssError(
                f"output holds {str(path)!r}, which no demo wrote; move it away or choose another"
                " --output"
            )


def _run_nodes(directory, log_directory, turn_s, caught):
    """Simulate, record to `directory`/bag and return the stability results."""
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    try:
        ros_node = rclpy.create_node("demo")
        with Nodes(log_directory) as nodes:
            watch = Watch(nodes, ros_node, turn_s, caught)
            nodes.start("logger_node", output=str(directory / "bag"))
            nodes.start("stability_node", scenario=SCENARIO)
            while not watch.heard:  # else the first turns would go by unseen
                rclpy.spin_once(ros_node, timeout_sec=0.1)
                watch()
            nodes.start(
                "sim_node",
                scenario=SCENARIO,
                spin_rate_ratio=SPIN_RATE_RATIO,
                turns=float(TURNS),
                time_scale=0.0,
                publish_period_s=PUBLISH_PERIOD_S,
                disturbance_m=DISTURBANCE_M,
                disturbance_seed=DISTURBANCE_SEED,
                wait_for_recorder=True,
            )
            service = "stability_node/compute_floquet"
            results = stability.compute(ros_node, service, RATES, on_wait=watch, patience_s=STALL_S)
            running = True
            while running:
                # Once more after its end, for the recorder's last report.
                running = nodes.running("sim_node")
                rclpy.spin_once(ros_node, timeout_sec=0.1)
                watch(len(results))
            nodes.stop("stability_node")
            nodes.stop("logger_node")
        print()
        return results
    finally:
        rclpy.try_shutdown()


def _from_centre_of_mass(recording):
    """Eq. (53) measured from the instantaneous centre of mass, shape (k, n)."""
    centre_m = np.average(recording.position_m, axis=1, weights=recording.mass_kg)
    return deviation(recording.position_m - centre_m[:, None], recording.reference_radius_m)


def _save_trajectories(recording, directory):
    plots.trajectories(
        recording.position_m, recording.tether_ends, recording.bead_name, recording.is_satellite
    ).savefig(directory / "trajectories.png")


def _save_deviation(recording, directory):
    plots.deviation(
        recording.turns, recording.deviation, recording.bead_name, _from_centre_of_mass(recording)
    ).savefig(directory / "deviation.png")


def _save_review(recording, directory):
    review.save(recording, directory / "review.rrd", SCENARIO)


def _summary(recording):
    def percent(values):
        return f"{100 * values.max():.2g} %"

    from_centre = np.abs(_from_centre_of_mass(recording)).max(axis=1)
    last_turn = recording.turns >= recording.turns[-1] - 1.0
    return (
        f"{SCENARIO} at {SPIN_RATE_RATIO:g} Omega, disturbed by {DISTURBANCE_M:g} m: "
        f"{recording.turns[-1]:.2f} turns in {len(recording.step)} steps, none lost.\n"
        f"Deviation from the undisturbed radius: {percent(np.abs(recording.deviation))} at most; "
        f"measured from the centre of mass {percent(from_centre)} at most, "
        f"{percent(from_centre[last_turn])} in the last turn."
    )


def main(argv=None):
    """Executable `demo`.

    Returns
    -------
    int
        Exit status: 0, 1 if something failed, 128 + n when ended by signal n.
    """
    parser = argparse.ArgumentParser(prog="demo", description=__doc__)
    parser.add_argument(
        "--output",
        type=Path,
        default=Path("runs/demo"),
        help="folder for the results; an earlier demo's are replaced (default %(default)s)",
    )
    options = parser.parse_args(argv)
    # The demo talks to nobody but its own nodes.
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    os.environ.setdefault("ROS_DOMAIN_ID", str(1 + os.getpid() % 100))
    caught = []
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, lambda number, _: caught.append(number))
    try:
        make(options.output, caught)
    except USER_ERRORS as error:
        print(f"\ndemo: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("\ndemo: interrupted", file=sys.stderr)
        return 128 + caught[0]
    return 0
