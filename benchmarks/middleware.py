"""States a second of the simulator, from the bare motion to a recording, so that costs are seen.

Needs the activated shell. `time_scale` is 0, one state for every second of simulated time.
"""

import contextlib
import json
import re
import sys
import tempfile
import threading
import time
from pathlib import Path

import numpy as np
import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from simulation_interfaces.msg import SimulationState
from simulation_interfaces.srv import SetSimulationState
from tss_interfaces.msg import BeadStates

from benchmarks.problems import cut
from tss_ros.core import Propagator, initial_state, ring
from tss_ros.messages.topics import STATE_TOPICS
from tss_ros.runs.processes import Nodes
from tss_ros.simulator import straight

RATE = -2.9
#: Beads in all, and simulated turns.
RUNS = {3: 20.0, 30: 2.0, 300: 0.3}
#: States a call asks the propagator for.
SLICE = 500
WAIT_S = 300.0


def without_ros(system, turns):
    """States a second of `core.Propagator` alone, sampled each second of simulated time."""
    spin = system.spin_rate_rad_s(RATE)
    times = np.arange(0.0, turns * 2.0 * np.pi / abs(spin), 1.0)
    propagator = Propagator(system, RATE, initial_state(system, RATE))
    begun = time.perf_counter()
    for k in range(0, times.size, SLICE):
        propagator.sample(times[k : k + SLICE])
    return times.size / (time.perf_counter() - begun)


def _ended(nodes, name):
    deadline = time.monotonic() + WAIT_S
    while nodes.running(name):
        if time.monotonic() > deadline:
            raise RuntimeError(f"{name} runs longer than {WAIT_S:g} s")
        nodes.check()
        time.sleep(0.05)
    nodes.check()


class Subscriber:
    """A subscriber to the states, in this process; it lets a paused simulator play."""

    def __enter__(self):
        self._context = rclpy.Context()
        rclpy.init(context=self._context)
        self._node = rclpy.create_node("benchmark_subscriber", context=self._context)
        self.arrivals = []
        self._node.create_subscription(BeadStates, "bead_states", self._arrived, 1000)
        self._play = self._node.create_client(SetSimulationState, "sim_node/set_simulation_state")
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._thread = threading.Thread(target=self._spin)
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._executor.shutdown()
        self._thread.join()
        self._node.destroy_node()
        self._context.shutdown()

    def _spin(self):
        with contextlib.suppress(ExternalShutdownException):
            self._executor.spin()

    def _arrived(self, _):
        self.arrivals.append(time.monotonic())

    def play(self):
        """Start the motion once the simulator is there; the time [s] at which it began."""
        deadline = time.monotonic() + WAIT_S
        while not self._node.count_publishers("bead_states"):
            if time.monotonic() > deadline:
                raise RuntimeError("sim_node did not start")
            time.sleep(0.01)
        if not self._play.wait_for_service(WAIT_S):
            raise RuntimeError("sim_node does not answer")
        begun = time.monotonic()
        self._play.call_async(
            SetSimulationState.Request(state=SimulationState(state=SimulationState.STATE_PLAYING))
        )
        return begun


def straight_into_a_bag(beads, turns):
    """States a second that `simulate` writes, without ROS."""
    words = ["three_star", "--turns", str(turns), "--override", f"spin_rate_ratio={RATE}"]
    words += [f"{name}={value}" for name, value in cut(beads).items()]
    with tempfile.TemporaryDirectory() as name:
        options = straight.parse([*words, "--output", f"{name}/bag"])
        setup = straight.make_setup(options)
        begun = time.perf_counter()
        writer = straight.simulate(setup, turns, options.output)
        seconds = time.perf_counter() - begun
    return {"states_per_s": writer.message_count / len(STATE_TOPICS) / seconds}


def with_ros(beads, turns, recorded=False, in_bulk=False, subscriber=None):
    """States a second that `sim_node` publishes, or that arrive, and how many of how many."""
    parameters = {
        "spin_rate_ratio": RATE,
        "turns": turns,
        "time_scale": 0.0,
        "publish_period_s": 1.0,
        "wait_for_recorder": recorded,
        "start_paused": subscriber is not None,
        **cut(beads),
    }
    with tempfile.TemporaryDirectory() as name, Nodes(Path(name)) as nodes:
        if recorded:
            nodes.start("logger_node", output=str(Path(name) / "bag"), in_bulk=in_bulk)
        nodes.start("sim_node", **parameters)
        begun = subscriber and subscriber.play()
        _ended(nodes, "sim_node")
        if recorded:
            nodes.stop("logger_node")
        told = (Path(name) / "sim_node.log").read_text(encoding="utf-8")
        steps, seconds = re.search(r"(\d+) steps, .* turns, in ([\d.]+) s", told).groups()
        steps, seconds = int(steps), float(seconds)
        if subscriber:
            arrived = len(subscriber.arrivals)
            return {
                "states_per_s": arrived / (subscriber.arrivals[-1] - begun),
                "states": steps,
                "received": arrived,
            }
        found = {"states_per_s": steps / seconds, "states": steps}
        if recorded:
            told = (Path(name) / "logger_node.log").read_text(encoding="utf-8")
            found["recorder"] = told.strip().splitlines()[-1].rpartition(": ")[2]
    return found


def measure(tell=lambda _: None):
    """All runs, by the number of beads."""
    table = {}
    for beads, turns in RUNS.items():
        system = ring(**cut(beads))
        without_ros(system, 0.01)
        rows = table[str(beads)] = {}
        rows["without ROS"] = {"states_per_s": without_ros(system, turns)}
        rows["published, nobody listens"] = with_ros(beads, turns)
        with Subscriber() as subscriber:
            rows["published to a subscriber"] = with_ros(beads, turns, subscriber=subscriber)
        rows["recorded"] = with_ros(beads, turns, recorded=True)
        rows["recorded in bulk"] = with_ros(beads, turns, recorded=True, in_bulk=True)
        straight_into_a_bag(beads, 0.01)
        rows["straight into a bag"] = straight_into_a_bag(beads, turns)
        for name, row in rows.items():
            tell(f"    {beads:4} beads, {name:26} {row['states_per_s']:9.0f} states/s")
    return table


if __name__ == "__main__":
    print(json.dumps(measure(lambda text: print(text, file=sys.stderr, flush=True))))
