"""Real nodes for tests: processes started and stopped by pid, and conditions waited for."""

import contextlib
import itertools
import json
import signal
import subprocess
import time
from pathlib import Path

import rclpy
from ament_index_python.packages import get_package_prefix
from rclpy.executors import SingleThreadedExecutor

#: How long [s] a loaded machine may take to start a node; the first one may compile the core.
START_S = 90.0
_numbers = itertools.count()
#: How long [s] a node may take to end after SIGINT or SIGTERM.
STOP_S = 2.0


def wait_until(condition, timeout_s, what):
    """Return the first true value of `condition()`; fail when it takes longer than `timeout_s`."""
    deadline = time.monotonic() + timeout_s
    while not (value := condition()):
        assert time.monotonic() < deadline, f"waited {timeout_s:g} s for {what}"
        time.sleep(0.01)
    return value


class Process:
    """One executable of the package, with what it prints kept in files.

    Parameters
    ----------
    executable : str
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
            self.directory / f"{executable}_{time.time_ns()}.{s}" for s in ("out", "err")
        ]
        command = [Path(get_package_prefix("tss_ros")) / "lib" / "tss_ros" / executable, *arguments]
        with self._files[0].open("w") as out, self._files[1].open("w") as err:
            self._popen = subprocess.Popen(
                command, cwd=directory, stdout=out, stderr=err, start_new_session=True, **options
            )

    @property
    def stdout(self):
        return self._files[0].read_text()

    @property
    def stderr(self):
        return self._files[1].read_text()

    @property
    def running(self):
        return self._popen.poll() is None

    def wait(self, timeout_s):
        """Return the exit status; fail when the process takes longer."""
        try:
            return self._popen.wait(timeout_s)
        except subprocess.TimeoutExpired:
            raise AssertionError(
                f"{self.name} still runs after {timeout_s:g} s; {self.stdout}{self.stderr}"
            ) from None

    def send(self, number):
        """Send a signal."""
        self._popen.send_signal(number)

    def stop(self, number=signal.SIGINT):
        """Send a signal and return the exit status; fail when that takes longer than STOP_S."""
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


def _remove_unused(memory):
    """Remove what killed processes could not, unless others still use it."""
    running = [int(path.name) for path in Path("/proc").iterdir() if path.name.isdigit()]
    for path in memory.difference(*map(_shared_memory, running)):
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
        deadline = time.monotonic() + timeout_s
        while not (value := condition()):
            assert time.monotonic() < deadline, f"waited {timeout_s:g} s for {what}"
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
