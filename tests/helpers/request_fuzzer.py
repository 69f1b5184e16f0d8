"""Random requests to running nodes: valid, invalid and absurd, each with what its answer must be.

By hand, in a ROS domain of its own: ``ROS_DOMAIN_ID=77 python tests/helpers/request_fuzzer.py
10000`` starts a simulator, a stability node and a recorder, asks that many times, and prints what
became of it. A seed may follow.
"""

import collections
import math
import os
import random
import sys
import tempfile
import time
from pathlib import Path

import ros_harness
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Vector3
from rcl_interfaces.msg import Parameter, ParameterValue
from rcl_interfaces.srv import DescribeParameters, GetParameters, ListParameters, SetParameters
from rclpy.parameter import parameter_value_to_python
from simulation_interfaces.msg import (
    Bounds,
    EntityCategory,
    EntityFilters,
    EntityState,
    Result,
    SimulationState,
    TagsFilter,
)
from simulation_interfaces.srv import (
    GetEntities,
    GetEntitiesStates,
    GetEntityInfo,
    GetEntityState,
    GetSimulationState,
    ResetSimulation,
    SetEntityState,
    SetSimulationState,
    StepSimulation,
)
from tss_interfaces.srv import (
    ComputeFloquet,
    CutTether,
    Disturb,
    FailActuator,
    FindCriticalRates,
    RestoreSnapshot,
    SaveSnapshot,
)

OK, FAILED = Result.RESULT_OK, Result.RESULT_OPERATION_FAILED
STOPPED, PLAYING, PAUSED = range(3)
#: Parameters that may change: values that fit, and values that do not.
CHANGEABLE = {
    "time_scale": ([0, 500.0, 1000, 1e6], [-1.0, 1e7, math.nan, "fast", True, [1.0]]),
    "publish_period_s": ([0.5, 1, 2.0, 10], [0.0, -3, math.inf, "1"]),
    "disturbance_m": ([0, 1.0, 50.0], [-1.0, 1e6, math.nan]),
    "disturbance_seed": ([0, 7, 2**31 - 1], [-1, 2**40, 1.5, "x"]),
    "spin_rate_ratio": ([-2.5, -3, 2.2, -1.6], [0.0, 2e4, math.nan, "left"]),
    "satellites": ([2, 3, 4, 6], [1, 0, -5, 10**6, 3.5, 2**63 - 1]),
    "satellite_mass_kg": ([50, 100.0, 1e3], [0.0, -1.0, 1e12, [], ["a"], math.inf]),
    "beads_per_tether": ([0, 1, 2], [-1, 10**5, 0.5]),
    "damping_n_s_per_m": ([0, 500.0, 1450.0], [-1.0, 1e10]),
    "tether_law": (["kelvin_voigt", "tension_only"], ["", "tension", 5, True]),
    "j2": ([0, 1e-3], [-1.0, math.nan, "much"]),
    "scenario": (["three_star", "six_bead"], ["", "nine_star", "/dev/null", "../x.yaml", 5]),
}
FIXED = ("turns", "wait_for_recorder", "recorder_patience_s", "start_paused", "service_folder")
FIXED += ("publish_clock", "frame_prefix")
EXPRESSIONS = ("satellite", "^s.*[0-9]$", "(a*)*" * 50, "(((a{99}){99}){99})", "[", "\\d", "((")
NAMES = ("", "x" * 5000, "satellite_1", "satellite_2", "bead 1", "Ω", "'; DROP", "\n", "/", "a.npz")


def parameter_value(value):
    """A ParameterValue; unlike rclpy's Parameter it takes any content."""
    kinds = {bool: (1, "bool_value"), int: (2, "integer_value"), float: (3, "double_value")}
    kinds |= {str: (4, "string_value"), list: (8, "double_array_value")}
    if value == ["a"]:
        return ParameterValue(type=9, string_array_value=value)
    number, field = kinds[type(value)]
    return ParameterValue(type=number, **{field: value})


class Fuzzer:
    """Makes requests, and judges answers by what it knows of the nodes' rules.

    Parameters
    ----------
    node, spin_until
        As `ros_harness.client_node` gives them.
    seed : int
    """

    def __init__(self, node, spin_until, seed):
        self._node, self._spin_until = node, spin_until
        self._random = random.Random(seed)
        self._clients = {}
        self.counts = collections.Counter()
        self.slowest_s = collections.Counter()
        self.state = None
        self._parts = (
            (self._set_state, 10),
            (self._step, 10),
            (self._reset, 8),
            (self._disturb, 12),
            (self._cut, 4),
            (self._fail, 8),
            (self._entities, 8),
            (self._place, 6),
            (self._snapshot, 8),
            (self._set_parameter, 30),
            (self._read_parameters, 8),
            (self._floquet, 3),
            (self._critical, 3),
        )

    def ask(self):
        """Make one request; fail if its answer is neither right nor a clear refusal."""
        parts, weights = zip(*self._parts)
        (part,) = self._random.choices(parts, weights)
        begun = time.monotonic()
        part()
        name = part.__name__.strip("_")
        self.counts[name] += 1
        self.slowest_s[name] = max(self.slowest_s[name], time.monotonic() - begun)

    def call(self, kind, name, **fields):
        """Call a service and return its answer."""
        if name not in self._clients:
            self._clients[name] = self._node.create_client(kind, name)
            ready = self._clients[name].service_is_ready
            self._spin_until(ready, ros_harness.START_S, name)
        answer = self._clients[name].call_async(kind.Request(**fields))
        self._spin_until(answer.done, 60, f"an answer of {name} to {str(fields):.300}")
        return answer.result()

    def _result(self, kind, name, *allowed, **fields):
        """Call a service; its Result must be one of those allowed, with a reason if not OK."""
        result = self.call(kind, f"/sim_node/{name}", **fields).result
        shown = f"{name} {str(fields):.300}: {result.result} {result.error_message!r:.300}"
        assert result.result in allowed, f"{shown}, expected {allowed}"
        assert bool(result.error_message) == (result.result != OK), shown
        assert "internal" not in result.error_message, shown
        self.counts["done" if result.result == OK else "refused"] += 1
        return result.result

    def _set_state(self):
        target = self._random.choice([0, 1, 1, 2, 2, 4, 77, 255])
        state = SimulationState(state=target)
        if target == self.state:
            allowed = (101,)
        elif target == PLAYING:
            allowed = (OK, 102)  # the motion may not be continuable
        else:
            unsupported = Result.RESULT_FEATURE_UNSUPPORTED
            allowed = {STOPPED: (OK, 102), PAUSED: (OK,), 4: (unsupported,)}
            allowed = allowed.get(target, (FAILED,))
        if self._result(SetSimulationState, "set_simulation_state", *allowed, state=state) == OK:
            self.state = target
        self.read_state()

    def read_state(self):
        """Ask for the state, which may only have changed because the motion cannot be continued."""
        answer = self.call(GetSimulationState, "/sim_node/get_simulation_state")
        state = answer.state.state
        assert answer.result.result == OK
        assert self.state in (None, state) or (self.state, state) == (PLAYING, PAUSED)
        self.state = state

    def _step(self):
        steps = self._random.choice([0, 1, 2, 10, 50, 10_001, 2**40, 2**64 - 1])
        self.read_state()
        if self.state != PAUSED:
            allowed = (FAILED,)
        else:
            allowed = (OK, FAILED) if 1 <= steps <= 10_000 else (FAILED,)
        self._result(StepSimulation, "step_simulation", *allowed, steps=steps)

    def _reset(self):
        scope = self._random.choice([0, 1, 2, 3, 255, 4, 8, 100, 254])
        works = scope in (0, 1, 2, 3, 255)
        allowed = (OK, FAILED) if works else (Result.RESULT_FEATURE_UNSUPPORTED,)
        self._result(ResetSimulation, "reset_simulation", *allowed, scope=scope)

    def _disturb(self):
        pick = self._random.choice
        numbers = [0.0, 0.0, 0.1, -5.0, 1e9, -1e300, math.nan, math.inf]
        request = Disturb.Request(
            bead=pick(NAMES), random_offset_m=pick(numbers), seed=pick([0, 3, -1, 2**62])
        )
        for vector in (request.offset_m, request.impulse_n_s):
            for axis in "xyz":
                setattr(vector, axis, pick(numbers) if pick([True, False]) else 0.0)
        vectors = [
            getattr(v, axis) for v in (request.offset_m, request.impulse_n_s) for axis in "xyz"
        ]
        if request.bead:
            fits = request.random_offset_m == 0.0 and any(vectors)
            fits = fits and all(abs(x) < 1e5 for x in vectors)
            missing = not request.bead.startswith("satellite")
            allowed = (Result.RESULT_NOT_FOUND,) if missing else (OK,) if fits else (FAILED,)
        else:
            fits = not any(vectors) and 0.0 < request.random_offset_m <= 1e5
            allowed = (OK,) if fits and request.seed >= 0 else (FAILED,)
        fields = {name: getattr(request, name) for name in request.get_fields_and_field_types()}
        self._result(Disturb, "disturb", *allowed, **fields)

    def _stamp(self):
        """A stamp, and whether it is surely not too far ahead."""
        pick = self._random.choice
        sec, nanosec = (
            pick([0, 0, 1, -1, -(2**31), 2**31 - 1]),
            pick([0, 0, 999_999_999, 2**32 - 1]),
        )
        return Time(sec=sec, nanosec=nanosec), sec < 2**31 - 1

    def _cut(self):
        tether = self._random.choice(["tether_1", "tether_2", *NAMES])
        stamp, fits = self._stamp()
        allowed = (Result.RESULT_NOT_FOUND,)
        if tether.startswith("tether"):  # beads rename the tethers
            allowed += (OK if fits else FAILED,)
        self._result(CutTether, "cut_tether", *allowed, tether=tether, stamp=stamp)

    def _fail(self):
        pick = self._random.choice
        actuator, mode = pick(["satellite_2", "tether_1", *NAMES]), pick(
            ["dead", "stuck", "healthy", "healthy", *NAMES]
        )  # fmt: skip
        stamp, fits = self._stamp()
        known = mode in ("dead", "stuck", "healthy")
        allowed = (FAILED,) if not (fits and known) else (OK,)
        if actuator == "tether_1":
            allowed += (Result.RESULT_NOT_FOUND,)  # other scenarios have no such reel
        elif not actuator.startswith("satellite"):
            allowed = (Result.RESULT_NOT_FOUND,)
        self._result(
            FailActuator, "fail_actuator", *allowed, actuator=actuator, mode=mode, stamp=stamp
        )

    def _entities(self):
        """Ask which entities fit filters, of which some are wrong, and for one of them."""
        pick = self._random.choice
        filters = EntityFilters(
            filter=pick(["", "", *EXPRESSIONS, *NAMES]),
            categories=[EntityCategory(category=pick([4, 4, 0, 3, 255]))] * pick([0, 0, 1, 5]),
            tags=TagsFilter(tags=pick([[], ["satellite"], ["x"] * 99]), filter_mode=pick([0, 7])),
            bounds=Bounds(type=pick([0, 0, 1, 2, 3, 9])),
        )
        numbers = [0.0, 1e3, -1e3, 1e300, math.nan, math.inf]
        points = [Vector3(x=pick(numbers), y=pick(numbers)) for _ in range(pick([0, 2, 2, 50]))]
        filters.bounds.points = points if filters.bounds.type or pick([True, False]) else []
        allowed = (OK, FAILED, Result.RESULT_FEATURE_UNSUPPORTED)
        self._result(GetEntities, "get_entities", *allowed, filters=filters)
        self._result(GetEntitiesStates, "get_entities_states", *allowed, filters=filters)
        name = pick(NAMES)
        found = (OK,) if name.startswith("satellite") else (Result.RESULT_NOT_FOUND,)
        self._result(GetEntityInfo, "get_entity_info", *found, entity=name)
        self._result(GetEntityState, "get_entity_state", *found, entity=name)

    def _place(self):
        pick = self._random.choice
        numbers = [0.0, 0.0, 100.0, -500.0, 1e9, math.nan, math.inf]
        state = EntityState()
        state.header.frame_id = pick(["", "", "", "orbit", "inertial", *NAMES])
        for vector in (state.pose.position, state.twist.linear):
            vector.x, vector.y = pick(numbers), pick(numbers)
        state.pose.orientation.w = pick([1.0, 1.0, 1.0, -1.0, 0.0, math.nan])
        state.twist.angular.z = pick([0.0, 0.0, 0.0, 1.0])
        pose = state.pose.position
        fits = all(abs(x) <= 1e6 for x in (pose.x, pose.y)) and abs(state.pose.orientation.w) == 1
        twist = state.twist.linear
        moves = all(abs(x) <= 1e4 for x in (twist.x, twist.y)) and not state.twist.angular.z
        name = pick(NAMES)
        if not name.startswith("satellite"):
            allowed = (Result.RESULT_NOT_FOUND,)
        elif state.header.frame_id not in ("", "orbit"):
            allowed = (FAILED,)
        else:
            allowed = (OK,) if fits and moves else (101, FAILED)
            # Beads that are joined may not be in one place.
            allowed = (OK, FAILED) if allowed == (OK,) else allowed
        self._result(SetEntityState, "set_entity_state", *allowed, entity=name, state=state)

    def _snapshot(self):
        file = self._random.choice([*NAMES, *(f"s{i}.npz" for i in range(5)), "no/such.npz"])
        if self._random.random() < 0.5:
            self._result(SaveSnapshot, "save_snapshot", OK, FAILED, file=file)
        else:
            allowed = (OK, FAILED, Result.RESULT_NOT_FOUND)
            self._result(RestoreSnapshot, "restore_snapshot", *allowed, file=file)

    def _set_parameter(self):
        pick = self._random.choice
        if self._random.random() < 0.7:
            name = pick(list(CHANGEABLE))
            fits = self._random.random() < 0.6
            value = parameter_value(pick(CHANGEABLE[name][0 if fits else 1]))
        else:
            name, fits = pick([*FIXED, *NAMES, "time_scale"]), False
            value = ParameterValue(type=self._random.randrange(-1, 256) % 256)
            if name == "time_scale":
                value.type = pick([0, 10, 77, 255])
        target = pick(["sim_node"] * 4 + ["stability_node", "logger_node"])
        given = [Parameter(name=name, value=value)]
        answer = self.call(SetParameters, f"/{target}/set_parameters", parameters=given)
        (result,) = answer.results
        shown = f"{target} {name:.50} {str(value):.200}: {result}"
        assert result.successful or result.reason, shown
        # What fits by itself may not fit the rest: a scenario has its own number of beads.
        if result.successful and not (fits and target == "sim_node"):
            # What is fixed may be given the value that it has.
            (present,) = self.call(GetParameters, f"/{target}/get_parameters", names=[name]).values
            assert parameter_value_to_python(present) == parameter_value_to_python(value), shown
        lone = name in ("time_scale", "publish_period_s", "disturbance_m", "disturbance_seed")
        assert result.successful or not (fits and lone and target == "sim_node"), shown
        self.counts["set" if result.successful else "not set"] += 1

    def _read_parameters(self):
        target = self._random.choice(["sim_node", "stability_node", "logger_node"])
        names = self._random.choices([*CHANGEABLE, *NAMES], k=self._random.randrange(4))
        if self._random.random() < 0.5:
            answer = self.call(GetParameters, f"/{target}/get_parameters", names=names)
            assert len(answer.values) <= len(names)
        else:
            answer = self.call(DescribeParameters, f"/{target}/describe_parameters", names=names)
            assert len(answer.descriptors) <= len(names)
        depth = self._random.choice([0, 1, 2**63])
        listed = self.call(
            ListParameters, f"/{target}/list_parameters", prefixes=names, depth=depth
        ).result
        assert len(listed.names) < 200

    def _floquet(self):
        rates = self._random.choice([[], [0.0], [math.nan], [-2.5], [-2.5, 1e9], [1.0] * 20_000])
        method = self._random.choice(["", "frozen", "frozen", "magic"])
        answer = self.call(
            ComputeFloquet, "/stability_node/compute_floquet", spin_rate_ratio=rates, method=method
        )
        fits = rates and len(rates) < 10_000 and method != "magic"
        assert answer.success == bool(fits) and (answer.success or answer.message)
        assert len(answer.results) == (len(rates) if fits else 0)
        for rate, result in zip(rates, answer.results):
            assert result.message if rate != -2.5 else result.verdict, result

    def _critical(self):
        low, high = self._random.choice([(0.0, 0.0), (math.nan, 1.0), (-1e9, 1.0), (-1e3, 1e3)])
        answer = self.call(
            FindCriticalRates,
            "/stability_node/find_critical_rates",
            spin_rate_ratio_from=low,
            spin_rate_ratio_to=high,
        )
        assert not answer.success and answer.message


def resident_kib(process):
    """Memory [KiB] that a process holds."""
    status = Path(f"/proc/{process.pid}/status").read_text()
    return int(status.split("VmRSS:")[1].split()[0])


def run(directory, requests, seed, report=lambda text: None):
    """Ask running nodes that many times.

    Returns
    -------
    dict
        Growth of memory [KiB] of each node after the first fifth of the requests.

    Raises
    ------
    AssertionError
        If a node ends, or an answer is neither right nor a clear refusal.
    """
    with ros_harness.processes(directory) as start, ros_harness.client_node() as (node, spin_until):
        nodes = {
            "sim_node": start("sim_node"),
            "stability_node": start("stability_node"),
            "logger_node": start("logger_node", output="bag"),
        }
        fuzzer, begin = Fuzzer(node, spin_until, seed), {}
        fuzzer.read_state()
        # The first request loads the compiled integrator, which is no growth.
        fuzzer.call(ComputeFloquet, "/stability_node/compute_floquet", spin_rate_ratio=[-2.5])
        for i in range(requests):
            fuzzer.ask()
            assert all(process.running for process in nodes.values())
            if i == requests // 5:
                begin = {name: resident_kib(process) for name, process in nodes.items()}
            if i % max(1, requests // 10) == 0:
                now = {name: resident_kib(process) // 1024 for name, process in nodes.items()}
                report(f"{i} requests, memory [MiB] {now}")
        growth = {name: resident_kib(process) - begin[name] for name, process in nodes.items()}
        # They do not only live, they work.
        if fuzzer.state != PAUSED:
            fuzzer.call(
                SetSimulationState,
                "/sim_node/set_simulation_state",
                state=SimulationState(state=PAUSED),
            )
        given = {"scenario": "three_star", "spin_rate_ratio": -2.5, "satellites": 3}
        given |= {"beads_per_tether": 0, "satellite_mass_kg": 100.0}
        simulator = ros_harness.Simulator(node, spin_until)
        outcome = simulator.set(**given)
        assert outcome.successful, outcome.reason
        simulator.do(ResetSimulation)
        simulator.do(StepSimulation, steps=10)
        for name in ("sim_node", "stability_node", "logger_node"):
            assert nodes[name].stop() == 0, name
            assert "Traceback" not in nodes[name].stderr, nodes[name].stderr
        lines = {name: len(process.stderr.splitlines()) for name, process in nodes.items()}
        report(f"{dict(fuzzer.counts)}")
        report(f"slowest [s] { {k: round(v, 3) for k, v in fuzzer.slowest_s.items()} }")
        report(f"lines logged {lines}; {nodes['logger_node'].stdout.strip()}")
        assert ", 0 lost" in nodes["logger_node"].stdout
    return growth


def main():
    """Run from the command line."""
    if "ROS_DOMAIN_ID" not in os.environ:
        sys.exit("set ROS_DOMAIN_ID to a domain that nothing else uses, as: ROS_DOMAIN_ID=77")

    requests = int(sys.argv[1])
    seed = int(sys.argv[2]) if len(sys.argv) > 2 else 1
    with tempfile.TemporaryDirectory() as directory:
        growth = run(Path(directory), requests, seed, lambda text: print(text, flush=True))
    print(
        f"growth of memory after the first fifth [MiB] { {k: v / 1024 for k, v in growth.items()} }"
    )


if __name__ == "__main__":
    main()
