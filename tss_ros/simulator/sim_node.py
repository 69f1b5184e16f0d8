"""The simulator node: publishes a formation's motion step by step, and lets others control it."""

import contextlib
import math
import threading
import time
from collections.abc import Sequence

import numpy as np
from rcl_interfaces.msg import SetParametersResult
from rclpy.parameter import Parameter
from rclpy.serialization import deserialize_message
from tss_interfaces.msg import BeadStates, TetherStates

from tss_ros.core import TssError
from tss_ros.messages import blocks
from tss_ros.messages.steps import FRAME_ID, StepMessages, system_description
from tss_ros.messages.topics import STATE_TOPICS
from tss_ros.messages.wrenches import TOPIC as APPLIED
from tss_ros.ros import diagnostics, frames, messages, parameters, systems
from tss_ros.ros.files import inside
from tss_ros.ros.node import Finished, TssNode, run
from tss_ros.ros.topics import (
    CLOCK_RATE_HZ,
    create_publisher,
    publishers,
    read_topics,
    wait_until_acked,
)
from tss_ros.ros.words import check_words
from tss_ros.scenarios import scenario
from tss_ros.simulator import odometry
from tss_ros.simulator.backpressure import FlowControl
from tss_ros.simulator.command_topics import CommandTopics
from tss_ros.simulator.control import STOP_S, Control
from tss_ros.simulator.entity_services import EntityServices
from tss_ros.simulator.for_listeners import ForListeners, check
from tss_ros.simulator.pacing import Pace
from tss_ros.simulator.reel_commands import Limits
from tss_ros.simulator.services import SimulationServices
from tss_ros.simulator.setup import Setup, declared
from tss_ros.simulator.simulation import Simulation
from tss_ros.simulator.step_publisher import StepPublisher
from tss_ros.simulator.steps_action import StepsAction

#: /clock is published at least this often [s]: who comes while time stands still must learn it.
CLOCK_PERIOD_S = 0.1
#: /tf is published at most this often [1/s of wall time].
TF_RATE_HZ = 50.0
#: How often [s] to look whether the last recorder has left, and to report.
RECORDER_CHECK_S, STATUS_PERIOD_S, DIAGNOSTICS_PERIOD_S = 0.25, 0.5, 1.0
#: How long [s] a simulator that ends waits for those who listen.
LISTENER_FINISH_S = 0.5
PROGRESS_PERIOD_S = 10.0


class SimNode(TssNode):
    """Publishes a step each `publish_period_s` of simulated time; see parameters.SIMULATOR."""

    def __init__(self):
        super().__init__("sim_node")
        given = parameters.read_parameters(self, parameters.SIMULATOR)
        self._options = systems.without_scenario_values(given)
        systems.declare_scenario_values(self, parameters.SIMULATOR, self._options)
        setup = self._make_setup()
        self._frame_id = self._options["frame_prefix"] + FRAME_ID
        topics = read_topics()
        asked = {"/clock": "publish_clock", "/tf": "publish_tf"}
        self._publisher = {
            name: create_publisher(self, topic)
            for name, topic in topics.items()
            if topic.publisher == "sim_node"
            and not topic.optional
            and self._options.get(asked.get(name), True)
        }
        self._steps = StepPublisher(self._publisher, self._frame_id)
        self._for_listeners = ForListeners(self, topics, self._options["frame_prefix"])
        self._recorded = [name for name in self._publisher if topics[name].recorded]
        depth = min(
            self._publisher[name].qos_profile.depth
            for name in self._recorded
            if topics[name].durability == "volatile"
        )
        wake = threading.Event()
        simulation = Simulation(setup, self._options["turns"], wake.set)
        simulation.set_timeout(self._options["command_timeout_s"])
        self._commands = CommandTopics(
            self, topics, self._publisher[APPLIED], simulation, lambda: self._options
        )
        self._flow = FlowControl(
            max(1, depth // 4),
            self.get_logger(),
            wake.set,
            self._options["recorder_patience_s"],
            lambda: self._recorder_status.get_publisher_count(),
        )
        self._pace = Pace(self._options["time_scale"])
        self._control = Control(
            simulation,
            self._pace,
            self._flow,
            wake,
            begin=self._may_begin,
            publish=self._publish,
            on_idle=self._on_idle,
            logger=self.get_logger(),
            play=not self._options["start_paused"],
            batch=self._options["turns"] > 0.0,
        )
        status = topics["recorder_status"]
        self._recorder_status = self.create_subscription(
            status.message_class, status.name, self._flow.on_status, status.qos
        )
        services = SimulationServices(
            self,
            self._control,
            make_setup=self._make_setup,
            newest_states=self._newest_states,
            on_event=self._on_event,
            on_answer=self._report_status,
            folder=self._options["service_folder"],
            on_request=self._commands.drain,
        )
        EntityServices(self, self._control, services.ask, self._on_event, self._frame_id)
        self._steps_action = StepsAction(self, self._control, services.ask)
        self.every(RECORDER_CHECK_S, self._check_recorders)
        self.every(STATUS_PERIOD_S, self._report_regularly)
        self.every(DIAGNOSTICS_PERIOD_S, self._report_diagnostics)
        self._measured, self._lags_s = (0.0, math.nan), (0.0, 0.0)
        self._clock_ns, self._clock_due, self._tf_due = None, -math.inf, -math.inf
        self._progress = time.monotonic()
        self._events = []
        self._shown, self._listeners = None, {}
        self._commands.begin(setup.system)
        self._describe(0, 0)

    def start(self) -> None:
        """Begin to simulate in a thread of its own."""
        self._thread = threading.Thread(target=self._simulate, daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """End the simulation."""
        self._control.stop()
        deadline = time.monotonic() + 2.0 * STOP_S + 1.0
        with contextlib.suppress(Finished):
            # Recorders must be heard until they have the last step.
            while self._thread.is_alive() and time.monotonic() < deadline:
                self.executor.spin_once(timeout_sec=CLOCK_PERIOD_S)
        # destroy_node leaves action servers, and they the node's shared memory.
        self._steps_action.close()

    def set_parameters_atomically(self, parameter_list: Sequence[Parameter]) -> SetParametersResult:
        """Check before anything is set, so that what is refused is refused with our reason."""
        try:
            options = parameters.check_changes(parameters.SIMULATOR, self._options, parameter_list)
            name = options["scenario"]
            # Other names than those of shipped scenarios and YAML files are refused unread.
            if name != self._options["scenario"] and name.endswith((".yaml", ".yml")):
                inside(options["service_folder"], name, "scenario")
            system, *_ = systems.build_system(*systems.split_options(options))
            check(options, system)
            declared(scenario.load(options["scenario"]), system, options["publish_period_s"])
            options = systems.without_scenario_values(options)
        except TssError as error:
            return SetParametersResult(successful=False, reason=str(error))
        values = systems.declare_scenario_values(self, parameters.SIMULATOR, options)
        own = {parameter.name for parameter in parameters.SIMULATOR}
        others = [parameter for parameter in parameter_list if parameter.name not in own]
        changed = [value for value in values if not self._has_value(value)]
        outcome = super().set_parameters_atomically(changed + others)
        if outcome.successful:
            if options["time_scale"] != self._pace.time_scale:
                self._pace.time_scale = options["time_scale"]
                self._control.meter.read()  # which begins to measure anew
            self._options = options
            timeout_s, limits = options["command_timeout_s"], Limits.of(options)
            self._control.request(self._control.set_timeout, timeout_s, limits)
        return outcome

    def _make_setup(self):
        built = systems.build_system(*systems.split_options(self._options))
        check(self._options, built[0])
        loaded = scenario.load(self._options["scenario"])
        happens = declared(loaded, built[0], self._options["publish_period_s"])
        return Setup.of(self._options, *built, **happens)

    # --- in the simulation's thread

    def _simulate(self):
        try:
            self._control.run_until_end()
            self._steps.flush()
            wait_until_acked(self._for_listeners.recorded, STOP_S)  # no recorder tells of these
            if not self._control.stopping:
                last = [self._publisher[name] for name in ("tether_states", "bead_states")]
                wait_until_acked(last, LISTENER_FINISH_S)
            self.finish()
        except Exception as error:
            self.finish(error)

    def _may_begin(self):
        if not self._options["wait_for_recorder"]:
            return True
        self.get_logger().info("waiting for a recorder", once=True)
        in_bulk = self._publisher[blocks.TOPIC].get_subscription_count()
        names = [name for name in self._recorded if not (in_bulk and name in STATE_TOPICS)]
        return (
            any(recorder.matched for recorder in self._flow.recorders.values())
            and all(self._publisher[name].get_subscription_count() for name in names)
            and self._for_listeners.recorder_listens
        )

    def _on_event(self, kind, text):
        self._events.append((kind, text))
        self.get_logger().info(f"{kind}: {text}")
        if not self._control.begins_run:
            self._publish_events(self._control.step + 1)

    def _describe(self, step, time_ns):
        """Announce a run that begins with this step."""
        setup = self._control.simulation.setup
        self._run = self._control.run
        self._steps.begin(setup)
        self._for_listeners.begin(setup)
        self._publisher["system_description"].publish(
            system_description(
                setup.system,
                setup.spin_rate_ratio,
                setup.reference_radius_m,
                setup.options,
                self._run,
                step,
                time_ns,
                self._frame_id,
            )
        )
        self.get_logger().info(
            f"{setup.options['scenario']}: {setup.system.is_satellite.sum()} satellites, "
            f"{setup.system.n} beads in all, {setup.system.m} tethers, "
            f"spin {setup.spin_rate_ratio:g} Omega, "
            f"one {setup.turn} {setup.turn_s:.1f} s, "
            f"tether law {setup.system.tether_law}"
        )

    def _publish(self, step, sample):
        new_run = self._run != self._control.run
        system = self._control.simulation.setup.system
        if new_run:
            self._describe(step, sample.time_ns)
            self.executor.create_task(self._commands.begin, system)
        self._events += self._commands.publish(system, step, self._control.run, self._frame_id)
        self._publish_events(step)
        self._shown = step, sample
        self._steps.publish(step, sample, new_run)
        self._for_listeners.publish(sample)
        if "/tf" in self._publisher and time.monotonic() >= self._tf_due:
            self._publish_frames()
        self._keep_clock()
        if time.monotonic() - self._progress > PROGRESS_PERIOD_S:
            self._progress = time.monotonic()
            setup = self._control.simulation.setup
            turns = sample.time_ns / 1e9 / setup.turn_s
            self.get_logger().info(f"step {step}, {turns:.2f} {setup.turn}s simulated")

    def _publish_events(self, step):
        time_ns = self._control.simulation.newest.time_ns
        if self._events:
            self._steps.flush()
        while self._events:
            kind, text = self._events.pop(0)
            self._publisher["simulation_events"].publish(
                messages.simulation_event(time_ns, step, self._run, kind, text, self._frame_id)
            )

    def _publish_frames(self):
        sample = self._shown[1]
        self._tf_due = time.monotonic() + 1.0 / TF_RATE_HZ
        setup = self._control.simulation.setup
        points = dict(zip(setup.system.bead_name, sample.position_m))
        if setup.options["odometry"] == odometry.CENTRE_OF_MASS:
            centre_m = odometry.centre_of_mass(setup.system, sample.position_m)
            points[odometry.CENTRE_OF_MASS] = centre_m
        transforms = frames.transforms(
            setup.orbit, sample.time_ns, points, self._options["frame_prefix"]
        )
        publisher = self._publisher["/tf"]
        publisher.publish(publisher.msg_type(transforms=transforms))

    def _on_idle(self):
        self._steps.flush()
        self._tell_latecomers()
        return self._keep_clock()

    def _tell_latecomers(self):
        """Publish the newest step again for those who came while the simulation stands still."""
        if self._shown is None or self._control.begins_run:
            return
        names = (*STATE_TOPICS, blocks.TOPIC, "/tf")
        names = [name for name in names if name in self._publisher]
        listeners = {name: self._publisher[name].get_subscription_count() for name in names}
        listeners |= self._for_listeners.listeners()
        step, before = self._shown[0], self._listeners
        self._listeners = {"step": step, **listeners}
        if self._control.moving or before.get("step") != step:
            return
        for name in [name for name, count in listeners.items() if count > before.get(name, 0)]:
            if name == "/tf":
                self._publish_frames()
            elif name in self._publisher:
                self._steps.publish_topic(name)
            else:
                self._for_listeners.publish_again(self._shown[1], name)

    def _newest_states(self):
        """BeadStates and TetherStates of the newest state, as messages of their own."""
        control, setup = self._control, self._control.simulation.setup
        make = StepMessages(setup.system, setup.tension_n, self._frame_id)
        step, states = max(control.step, 0), control.simulation.newest.alone
        return tuple(
            deserialize_message(make.rows(name, step, states)[0].tobytes(), kind)
            for name, kind in (("bead_states", BeadStates), ("tether_states", TetherStates))
        )

    def _keep_clock(self):
        """Publish /clock if it may and should be; return how soon [s] to look again."""
        if "/clock" not in self._publisher or self._control.step < 0:
            return CLOCK_PERIOD_S
        now, time_ns = time.monotonic(), self._control.simulation.newest.time_ns
        wait_s = self._clock_due - now
        if time_ns == self._clock_ns:
            wait_s += CLOCK_PERIOD_S
        if wait_s > 0.0:
            return wait_s
        self._publisher["/clock"].publish(messages.clock(time_ns))
        self._clock_ns, self._clock_due = time_ns, now + 1.0 / CLOCK_RATE_HZ
        return CLOCK_PERIOD_S

    # --- in the executor's thread

    def _check_recorders(self):
        self._flow.check(self._recorder_status.topic_name)
        self._check_alone()

    def _check_alone(self):
        """Say which other simulators publish what this one does."""
        states = self._publisher["bead_states"]
        names = sorted(publishers(self, states.topic_name).values())
        if len(names) > 1 and all(names):
            self.get_logger().error(
                f"{len(names)} nodes publish {states.topic_name}: {', '.join(names)}; "
                "give each simulator a namespace of its own",
                throttle_duration_sec=10.0,
            )

    def _report_regularly(self):
        self._measured = self._control.meter.read()
        self._lags_s = self._lags_s[1], self._control.lag_s
        self._report_status()

    def _report_status(self):
        control, (real_time_factor, step_cost_s) = self._control, self._measured
        self._status = messages.simulation_status(
            time.time_ns(),
            state=control.state,
            time_ns=control.simulation.newest.time_ns,
            step=max(control.step, 0),
            run=control.run,
            time_scale=self._pace.time_scale,
            real_time_factor=real_time_factor,
            step_cost_s=step_cost_s,
            message=control.failure,
        )
        self._publisher["simulation_status"].publish(self._status)

    def _report_diagnostics(self):
        simulation = self._control.simulation
        names, newest = simulation.setup.system.tether_name, simulation.newest.alone
        published = self._flow.published
        self._publisher["/diagnostics"].publish(
            diagnostics.of_simulator(
                self.get_fully_qualified_name(),
                self._status,
                self._control.late,
                # In a while that begins late more may go out, and a step more or less.
                (simulation.setup.publish_period_s + self._lags_s[0] * self._pace.time_scale)
                / STATUS_PERIOD_S,
                [names[i] for i in np.flatnonzero(~newest.taut[0]) if i < len(names)],
                {
                    output: (published - recorder.step, recorder.lost)
                    for output, recorder in self._flow.recorders.items()
                },
            )
        )


def main() -> None:
    """Executable `sim_node`."""
    check_words("sim_node", "Simulate one formation and publish its motion.", parameters.SIMULATOR)
    run(SimNode)
