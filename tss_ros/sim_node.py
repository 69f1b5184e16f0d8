"""The simulator node: integrates a formation's motion and publishes it step by step."""

import math
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from rclpy.duration import Duration

from tss_ros import parameters, translate
from tss_ros.core import Propagator, deviation, disturbed, initial_state, tether_state
from tss_ros.flow_control import FlowControl
from tss_ros.node_main import TssNode, run
from tss_ros.topics import read_topics

#: Steps integrated at a time, times beads, and the most steps: fixed, so that runs repeat exactly.
CHUNK_BEAD_STEPS, CHUNK_STEPS = 8192, 256
#: Simulation times are int32 seconds in every message.
MAX_TIME_S = 2**31 - 1
#: /clock is published at most this often [1/s of wall time]: faster starves those who follow it.
CLOCK_RATE_HZ = 200.0
#: A simulator this far [s] behind the wall clock stops trying to catch up.
MAX_LAG_S = 0.5
#: How often [s] to look whether the last recorder has left.
RECORDER_CHECK_S = 0.25
#: How long [s] a finished simulator waits for its recorders, and for others on each topic.
RECORDER_FINISH_S, LISTENER_FINISH_S = 10.0, 0.5
PROGRESS_PERIOD_S = 10.0


class SimNode(TssNode):
    """Publishes a step each `publish_period_s` of simulated time; see parameters.SIMULATOR."""

    def __init__(self):
        super().__init__("sim_node")
        tables = ((parameters.SCENARIO,), parameters.OVERRIDES, parameters.SIMULATOR)
        self._options = parameters.read_parameters(self, *tables)
        overrides = {
            p.name: self._options[p.name] for p in parameters.OVERRIDES if p.name in self._options
        }
        scenario = self._options["scenario"]
        self._system, spin_rate_ratio = parameters.build_system(scenario, overrides)
        undisturbed = initial_state(self._system, spin_rate_ratio)
        self._reference_radius_m = np.linalg.norm(undisturbed.position_m, axis=1)
        _, tension_n, _ = tether_state(
            self._system, undisturbed.position_m, undisturbed.velocity_m_s
        )
        start = disturbed(
            undisturbed, self._options["disturbance_m"], self._options["disturbance_seed"]
        )
        self._propagator = Propagator(self._system, spin_rate_ratio, start)
        self._turn_s = 2.0 * math.pi / abs(spin_rate_ratio * self._system.orbit_rate_rad_s)
        self._messages = translate.StepMessages(self._system, tension_n)

        topics = read_topics()
        self._publisher = {
            name: self.create_publisher(topic.message_class, name, topic.qos)
            for name, topic in topics.items()
            if topic.publisher == "sim_node"
        }
        self._recorded = [topics[name] for name in self._publisher if topics[name].recorded]
        depth = min(topic.depth for topic in self._recorded if topic.durability == "volatile")
        self._flow = FlowControl(max(1, depth // 4), self.get_logger())
        status = topics["recorder_status"]
        self._status = self.create_subscription(
            status.message_class, status.name, self._flow.on_status, status.qos
        )
        self.every(RECORDER_CHECK_S, self._check_recorders)
        self._stopping = threading.Event()
        self._clock_due = -math.inf
        self._publisher["system_description"].publish(
            translate.system_description(
                self._system, scenario, spin_rate_ratio, self._reference_radius_m, self._options
            )
        )
        self.get_logger().info(
            f"{scenario}: {self._system.is_satellite.sum()} satellites, {self._system.n} beads in "
            f"all, {self._system.m} tethers, spin {spin_rate_ratio:g} Omega, "
            f"one turn {self._turn_s:.1f} s"
        )

    def start(self):
        """Begin to simulate in a thread of its own."""
        self._thread = threading.Thread(target=self._simulate, daemon=True)
        self._thread.start()

    def stop(self):
        """End the simulation."""
        self._stopping.set()
        self._flow.stop()
        self._thread.join(timeout=1.0)

    def _check_recorders(self):
        if not self._status.get_publisher_count():
            self._flow.on_recorders_gone()

    def _is_connected(self):
        return all(self._publisher[t.name].get_subscription_count() for t in self._recorded)

    def _simulate(self):
        try:
            if self._options["wait_for_recorder"]:
                self.get_logger().info("waiting for a recorder")
                self._flow.wait_for_recorder(self._is_connected)
            with ThreadPoolExecutor(max_workers=1) as pool:
                self._publish_all(pool)
            self._finish_delivery()
        except Exception as error:
            if not self._stopping.is_set() and self.context.ok():
                self.finish(error)
        else:
            if not self._stopping.is_set():
                self.finish()

    def _publish_all(self, pool):
        """Publish every step, while the next chunk of the motion is integrated."""
        period_s, turns = self._options["publish_period_s"], self._options["turns"]
        end_s = min(turns * self._turn_s if turns else math.inf, MAX_TIME_S)
        # The allowance keeps a last step that falls on the end of the last turn.
        last = math.floor(end_s / period_s * (1.0 + 1e-12))
        chunk_steps = max(1, min(CHUNK_STEPS, CHUNK_BEAD_STEPS // self._system.n))
        step, begun = 0, time.monotonic()
        self._progress = begun
        chunk = pool.submit(self._integrate, 0, min(chunk_steps, last + 1))
        while step <= last:
            position_m, velocity_m_s = chunk.result()
            following = step + len(position_m)
            if following <= last:
                chunk = pool.submit(
                    self._integrate, following, min(chunk_steps, last + 1 - following)
                )
            lengths_m, tensions_n, tauts = tether_state(self._system, position_m, velocity_m_s)
            deviations = deviation(position_m, self._reference_radius_m)
            for row in zip(position_m, velocity_m_s, deviations, lengths_m, tensions_n, tauts):
                self._pace(step)
                if self._stopping.is_set():
                    return
                self._publish(step, round(step * period_s * 1e9), *row)
                self._flow.published = step
                self._log_progress(step)
                step += 1
        wall_s = time.monotonic() - begun
        self.get_logger().info(
            f"{step} steps, {(step - 1) * period_s / self._turn_s:.2f} turns, in {wall_s:.2f} s; "
            f"tethers switched between slack and taut {self._propagator.switches} times"
        )

    def _finish_delivery(self):
        """Let the last steps reach the recorders, and whoever else listens, before the end."""
        if not self._flow.wait_for_end(RECORDER_FINISH_S) and not self._stopping.is_set():
            self.get_logger().warning("a recorder did not confirm the last steps")
        for name in ("tether_states", "bead_states"):
            self._publisher[name].wait_for_all_acked(Duration(seconds=LISTENER_FINISH_S))

    def _integrate(self, first_step, count):
        """Positions and velocities of the next `count` steps, each (count, n, 3)."""
        times_s = np.arange(first_step, first_step + count) * self._options["publish_period_s"]
        return self._propagator.sample(times_s, cancelled=self._stopping.is_set)

    def _publish(
        self, step, time_ns, position_m, velocity_m_s, deviation, length_m, tension_n, taut
    ):
        make, publisher = self._messages, self._publisher
        publisher["tether_states"].publish(
            make.tether_states(step, time_ns, length_m, tension_n, taut)
        )
        if publisher["markers"].get_subscription_count():
            publisher["markers"].publish(make.markers(time_ns, position_m, tension_n, taut))
        if publisher["bead_cloud"].get_subscription_count():
            publisher["bead_cloud"].publish(
                make.bead_cloud(time_ns, position_m, velocity_m_s, deviation)
            )
        if publisher["tether_lengths"].get_subscription_count():
            publisher["tether_lengths"].publish(make.tether_lengths(time_ns, length_m, tension_n))
        # Last, so that a recorder that has got this one has got the whole step.
        publisher["bead_states"].publish(
            make.bead_states(step, time_ns, position_m, velocity_m_s, deviation)
        )
        now = time.monotonic()
        if now >= self._clock_due:
            publisher["/clock"].publish(translate.clock(time_ns))
            self._clock_due = now + 1.0 / CLOCK_RATE_HZ

    def _pace(self, step):
        """Return when `step` may be published, by the wall clock and by the recorders."""
        time_scale = self._options["time_scale"]
        if step == 0:
            self._wall_start, self._wall_start_step = time.monotonic(), 0
        elif time_scale:
            simulated_s = (step - self._wall_start_step) * self._options["publish_period_s"]
            wait_s = self._wall_start + simulated_s / time_scale - time.monotonic()
            if wait_s > 0:
                self._stopping.wait(wait_s)
            elif wait_s < -MAX_LAG_S:
                self.get_logger().warning(
                    f"time_scale {time_scale:g} is faster than this machine simulates or records",
                    throttle_duration_sec=PROGRESS_PERIOD_S,
                )
                self._wall_start, self._wall_start_step = time.monotonic(), step
        self._flow.wait()

    def _log_progress(self, step):
        now = time.monotonic()
        if now - self._progress > PROGRESS_PERIOD_S:
            self._progress = now
            turns = step * self._options["publish_period_s"] / self._turn_s
            self.get_logger().info(f"step {step}, {turns:.2f} turns simulated")


def main():
    """Executable `sim_node`."""
    run(SimNode)
