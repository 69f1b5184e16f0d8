"""Real nodes for tests: processes started and stopped by pid, and conditions waited for."""

import contextlib
import itertools
import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import rclpy
from ament_index_python.packages import get_package_prefix
from rcl_interfaces.srv import SetParametersAtomically
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from rosgraph_msgs.msg import Clock
from simulation_interfaces.msg import Result, SimulationState
from simulation_interfaces.srv import (
    GetSimulationState,
    ResetSimulation,
    SetSimulationState,
    StepSimulation,
)
from tss_interfaces.msg import BeadStates, SimulationEvent, SimulationStatus, SystemDescription

#: How long [s] a loaded machine may take to start a node; the first one may compile the core.
START_S = 90.0
#: How many times as long as a quiet machine conditions are waited for.
PATIENCE = 3
_numbers = itertools.count()
#: How long [s] a node may take to end after SIGINT or SIGTERM.
STOP_S = 6
#: What Fast DDS prints before it takes the next port: port 7000 and those after it serve all
#: domains of a machine, so tests that run side by side come upon each other there.
_NEXT_PORT = re.compile(r"^.*RTPS_TRANSPORT_SHM.*Failed init_port.*\n", re.MULTILINE)
#: The command `sweep`; it needs no ROS.
SWEEP = [
    sys.executable, "-c", "import sys; from tss_ros.sweeps.command import main; sys.exit(main())"
]  # fmt: skip


def wait_until(condition, timeout_s, what):
    """Return the first true value of `condition()`; fail after `PATIENCE` times `timeout_s`."""
    deadline = time.monotonic() + PATIENCE * timeout_s
    while not (value := condition()):
        assert time.monotonic() < deadline, f"waited {PATIENCE} x {timeout_s:g} s for {what}"
        time.sleep(0.01)
    return value


class Process:
    """One executable of the package, with what it prints kept in files.

    Parameters
    ----------
    executable : str
        Name in the package, or path.
    directory : Path
        Where it runs and where its output goes.
    arguments : sequence of str
        Command line after the executable's name.
    **options
        For subprocess.Popen.
    """

    def __init__(self, executable, directory, arguments, **options):
        self.name, self.directory = executable, Path(directory)
        self.left_behind = set()
        self._files = [
            self.directory / f"{Path(executable).name}_{time.time_ns()}.{s}" for s in ("out", "err")
        ]
        command = [Path(get_package_prefix("tss_ros")) / "lib" / "tss_ros" / executable, *arguments]
        with self._files[0].open("w") as out, self._files[1].open("w") as err:
            self._popen = subprocess.Popen(
                command, cwd=directory, stdout=out, stderr=err, start_new_session=True, **options
            )

    @property
    def stdout(self):
        return _NEXT_PORT.sub("", self._files[0].read_text())

    @property
    def stderr(self):
        return _NEXT_PORT.sub("", self._files[1].read_text())

    @property
    def pid(self):
        return self._popen.pid

    @property
    def running(self):
        return self._popen.poll() is None

    def wait(self, timeout_s):
        """Return the exit status; fail when the process takes `PATIENCE` times as long."""
        try:
            return self._popen.wait(PATIENCE * timeout_s)
        except subprocess.TimeoutExpired:
            raise AssertionError(
                f"{self.name} still runs after {PATIENCE} x {timeout_s:g} s;"
                f" {self.stdout}{self.stderr}"
            ) from None

    def send(self, number):
        """Send a signal."""
        self._popen.send_signal(number)

    def stop(self, number=signal.SIGINT):
        """Send a signal and return the exit status; fail when that takes far longer than STOP_S."""
        self.send(number)
        return self.wait(STOP_S)

    def kill(self):
        """End the process, whatever it does."""
        if self.running:
            self.left_behind = _shared_memory(self._popen.pid)
            self._popen.kill()
            self._popen.wait()

    def wait_for_line(self, text):
        """Return when the process has printed `text`; fail when it ends without it."""
        seen = wait_until(
            lambda: (text in self.stderr + self.stdout) or not self.running, START_S, repr(text)
        )
        assert seen and text in self.stderr + self.stdout, f"no {text!r} in {self.stderr}"


def _shared_memory(pid):
    """The middleware's shared memory that a process uses."""
    with contextlib.suppress(OSError):  # it has ended meanwhile
        lines = Path(f"/proc/{pid}/maps").read_text().splitlines()
        return {Path(line.split()[-1]) for line in lines if "/dev/shm/fastrtps_" in line}
    return set()


def _segments():
    """The middleware's shared memory on this machine."""
    return {p for p in Path("/dev/shm").glob("fastrtps_*") if not p.name.endswith("_el")}


#: What was there before this test run.
_before = _segments()


def remove_left_behind():
    """Remove what killed processes of this test run could not, if nobody but this one uses it."""
    _remove_unused(_segments() - _before, but_for={os.getpid()})


def _remove_unused(memory, but_for=frozenset()):
    """Remove what killed processes could not, unless others still use it."""
    running = {int(path.name) for path in Path("/proc").iterdir() if path.name.isdigit()}
    for path in memory.difference(*map(_shared_memory, running - but_for)):
        lock, mutex = path.with_name(path.name + "_el"), path.with_name(f"sem.{path.name}_mutex")
        for leftover in (path, lock, mutex):
            leftover.unlink(missing_ok=True)


@contextlib.contextmanager
def processes(directory):
    """A function that starts nodes, `start(executable, *arguments, **parameters)`.

    Parameters become `-p name:=value`. What still runs at the end is killed.
    """
    started = []

    def start(executable, *arguments, options=None, **parameters):
        line = ["--ros-args", *arguments]
        for name, value in parameters.items():
            line += ["-p", f"{name}:={value if isinstance(value, str) else json.dumps(value)}"]
        started.append(Process(executable, directory, line, **(options or {})))
        return started[-1]

    try:
        yield start
    finally:
        for process in started:
            process.kill()
        _remove_unused(set().union(*(process.left_behind for process in started)))


@contextlib.contextmanager
def client_node():
    """A node in this process, with a function that spins it until a condition holds."""
    context = rclpy.Context()
    rclpy.init(context=context)
    node = rclpy.create_node(f"test_client_{next(_numbers)}", context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)

    def spin_until(condition, timeout_s, what):
        deadline = time.monotonic() + PATIENCE * timeout_s
        while not (value := condition()):
            assert time.monotonic() < deadline, f"waited {PATIENCE} x {timeout_s:g} s for {what}"
            executor.spin_once(timeout_sec=0.01)
        return value

    try:
        yield node, spin_until
    finally:
        node.destroy_node()
        context.try_shutdown()


def call(node, spin_until, service_type, name, request, timeout_s=60.0):
    """Call a service once it is there, and return the response."""
    client = node.create_client(service_type, name)
    try:
        spin_until(client.service_is_ready, START_S, name)
        answer = client.call_async(request)
        spin_until(answer.done, timeout_s, f"an answer of {name}")
        return answer.result()
    finally:
        node.destroy_client(client)


def ask_until_answered(client, request):
    """A condition that asks anew each second, and is true once there is an answer."""
    begun, answers = time.monotonic(), []

    def answered():
        if time.monotonic() - begun > len(answers):
            answers.append(client.call_async(request))
        return any(answer.done() for answer in answers)

    return answered


def set_parameters(node, spin_until, target, **values):
    """Set parameters of a node in one go and return the answer; None takes one away."""
    given = [Parameter(name, value=value).to_parameter_msg() for name, value in values.items()]
    request = SetParametersAtomically.Request(parameters=given)
    name = f"{target}/set_parameters_atomically"
    return call(node, spin_until, SetParametersAtomically, name, request).result


class Simulator:
    """What a user sees of a simulator and can ask of it.

    Parameters
    ----------
    node, spin_until
        As `client_node` gives them.
    namespace, name : str
        Of the simulator.
    """

    def __init__(self, node, spin_until, namespace="", name="sim_node"):
        self.node, self.spin_until = node, spin_until
        self.beads, self.events, self.status, self.descriptions, self.clocks = [], [], [], [], []
        self._name, self._clients = f"{namespace}/{name}", {}
        latched = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        for kind, topic, kept, qos in (
            (BeadStates, "bead_states", self.beads, 1000),
            (SimulationEvent, "simulation_events", self.events, latched),
            (SimulationStatus, "simulation_status", self.status, latched),
            (SystemDescription, "system_description", self.descriptions, latched),
            (Clock, "/clock", self.clocks, 1000),
        ):
            name = topic if topic.startswith("/") else f"{namespace}/{topic}"
            node.create_subscription(kind, name, kept.append, qos)

    def ask(self, kind, timeout_s=60.0, **fields):
        """Call the simulator's service of this type and return its answer."""
        answer = self.begin(kind, **fields)
        self.spin_until(answer.done, timeout_s, f"an answer to {kind.__name__} {fields}")
        return answer.result()

    def begin(self, kind, **fields):
        """Call the simulator's service of this type and return the future of its answer."""
        if not self._clients:
            # A node that has only just been found may not yet have found those who ask it.
            found = self._client(GetSimulationState)
            answered = ask_until_answered(found, GetSimulationState.Request())
            self.spin_until(answered, START_S, "an answer")
        return self._client(kind).call_async(kind.Request(**fields))

    def _client(self, kind):
        if kind not in self._clients:
            self._clients[kind] = self._new_client(kind)
        made_at = time.monotonic()

        def ready():
            nonlocal made_at
            # On a busy machine the middleware may miss a client for good.
            if time.monotonic() - made_at > START_S / 4:
                self.node.destroy_client(self._clients[kind])
                self._clients[kind], made_at = self._new_client(kind), time.monotonic()
            return self._clients[kind].service_is_ready()

        self.spin_until(ready, START_S, kind.__name__)
        return self._clients[kind]

    def _new_client(self, kind):
        snake = re.sub("(?<!^)(?=[A-Z])", "_", kind.__name__).lower()
        return self.node.create_client(kind, f"{self._name}/{snake}")

    def do(self, kind, **fields):
        """Call a service and expect it to do what it is asked for."""
        answer = self.ask(kind, **fields)
        assert answer.result.result == Result.RESULT_OK, answer.result.error_message
        assert answer.result.error_message == ""
        return answer

    def refused(self, kind, **fields):
        """Call a service, expect it to refuse, and return code and reason."""
        result = self.ask(kind, **fields).result
        assert result.result != Result.RESULT_OK and result.error_message
        return result.result, result.error_message

    def set_state(self, state):
        self.do(SetSimulationState, state=SimulationState(state=state))

    def pause(self):
        self.set_state(SimulationState.STATE_PAUSED)

    def play(self):
        self.set_state(SimulationState.STATE_PLAYING)

    def set(self, **values):
        """Set parameters in one go and return the answer."""
        return set_parameters(self.node, self.spin_until, self._name, **values)

    def join(self):
        """With a paused simulator: begin a run of which every step arrives; forget all before."""
        while not (self.beads and self.status):
            self.do(StepSimulation, steps=1)
        self.do(ResetSimulation)
        newest = self.settled()
        self.spin_until(lambda: self.events and self.events[-1].step == newest.step, 5, "an event")
        self.spin_until(lambda: self.descriptions[-1].first_step == newest.step, 5, "the run")
        self.run, self.first_step = self.descriptions[-1].run, newest.step
        del self.beads[:-1], self.events[:], self.descriptions[:-1]

    def wait_for_step(self, step, timeout_s=START_S):
        """Return the BeadStates of this step, or of a later one if it was before our time."""
        self.spin_until(
            lambda: self.beads and self.beads[-1].step >= step, timeout_s, f"step {step}"
        )
        return next(message for message in self.beads if message.step >= step)

    def settled(self):
        """The newest BeadStates, once all that was published until now is here."""
        now_ns = time.time_ns()
        self.do(GetSimulationState)  # a status goes before every answer
        self.spin_until(
            lambda: (
                time_ns(self.status[-1].stamp) >= now_ns
                and self.beads[-1].step == self.status[-1].step
            ),
            10,
            "the step that the status names",
        )
        return self.beads[-1]


def time_ns(stamp):
    """A message's stamp in nanoseconds."""
    return stamp.sec * 10**9 + stamp.nanosec


def motion(message):
    """Positions and velocities of BeadStates, bit for bit."""
    return bytes(message.position_m), bytes(message.velocity_m_s)


def sockets_of(pid, protocol):
    """Rows of the kernel's tables, split, of a process's sockets; protocol is "tcp" or "udp"."""
    links = set()
    for path in Path(f"/proc/{pid}/fd").iterdir():
        with contextlib.suppress(FileNotFoundError):  # closed meanwhile
            links.add(os.readlink(path))
    rows = []
    for table in (protocol, f"{protocol}6"):
        lines = Path(f"/proc/{pid}/net/{table}").read_text().splitlines()[1:]
        rows += [line.split() for line in lines]
    return [row for row in rows if f"socket:[{row[9]}]" in links]
