"""States a second of the simulator, from the bare motion to a recording, so that costs are seen.

Needs the activated shell. `time_scale` is 0, one state for every second of simulated time.
"""

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
from tss_interfaces.msg import BeadStates

from benchmarks.problems import cut
from tss_ros.core import Propagator, initial_state, ring
from tss_ros.processes import Nodes

RATE = -2.9
#: Beads in all, and simulated turns.
RUNS = {3: 4.0, 30: 2.0, 300: 0.3}
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


def with_ros(beads, turns, subscriber=False, recorded=False):
    """States a second that `sim_node` reports, and how many arrived or were recorded."""
    beads_per_tether = cut(beads)["beads_per_tether"]
    parameters = {"spin_rate_ratio": RATE, "turns": turns, "time_scale": 0.0}
    parameters |= {"beads_per_tether": beads_per_tether, "publish_period_s": 1.0}
    received = [0]
    with tempfile.TemporaryDirectory() as name, Nodes(Path(name)) as nodes:
        if subscriber:
            context = rclpy.Context()
            rclpy.init(context=context)
            node = rclpy.create_node("benchmark_subscriber", context=context)

            def count(_):
                received[0] += 1

            node.create_subscription(BeadStates, "bead_states", count, 1000)
            executor = SingleThreadedExecutor(context=context)
            executor.add_node(node)
            thread = threading.Thread(target=_spin, args=(executor,))
            thread.start()
        if recorded:
            nodes.start("logger_node", output=str(Path(name) / "bag"))
            parameters["wait_for_recorder"] = True
        nodes.start("sim_node", **parameters)
        _ended(nodes, "sim_node")
        found = {}
        if recorded:
            nodes.stop("logger_node")
            told = (Path(name) / "logger_node.log").read_text(encoding="utf-8")
            found["recorder"] = told.strip().splitlines()[-1].rpartition(": ")[2]
        if subscriber:
            executor.shutdown()
            thread.join()
            node.destroy_node()
            context.shutdown()
            found["received"] = received[0]
        told = (Path(name) / "sim_node.log").read_text(encoding="utf-8")
    steps, seconds = re.search(r"(\d+) steps, .* turns, in ([\d.]+) s", told).groups()
    return {"states_per_s": int(steps) / float(seconds), "states": int(steps), **found}


def _spin(executor):
    try:
        executor.spin()
    except ExternalShutdownException:
        pass


def measure(tell=lambda _: None):
    """All runs, by the number of beads."""
    table = {}
    for beads, turns in RUNS.items():
        system = ring(**cut(beads))
        without_ros(system, 0.01)
        rows = table[str(beads)] = {}
        rows["without ROS"] = {"states_per_s": without_ros(system, turns)}
        rows["published, nobody listens"] = with_ros(beads, turns)
        rows["published to a subscriber"] = with_ros(beads, turns, subscriber=True)
        rows["recorded"] = with_ros(beads, turns, recorded=True)
        for name, row in rows.items():
            tell(f"    {beads:4} beads, {name:26} {row['states_per_s']:9.0f} states/s")
    return table


if __name__ == "__main__":
    print(json.dumps(measure(lambda text: print(text, file=sys.stderr, flush=True))))
