"""Every executable as a process: words that it knows and words that it does not, early signals."""

import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import ros_harness
from ament_index_python.packages import get_package_prefix

from tss_ros.executables import EXECUTABLES

NODES = [name for name in EXECUTABLES if name.endswith("_node")]
FOLDER = Path(get_package_prefix("tss_ros")) / "lib" / "tss_ros"


#: Runs all executables one after the other with a word, as to load each of them anew takes long.
ALL = """
import contextlib, io, json, sys
from tss_ros import executables
found = {}
needed = json.loads(sys.argv[2])
for name in executables.EXECUTABLES:
    out, errors, words = io.StringIO(), io.StringIO(), [sys.argv[1], *needed.get(name, [])]
    sys.argv[:] = [name, *words]
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(errors):
        try:
            status = executables.run(name)
        except SystemExit as end:
            status = end.code
    found[name] = status, out.getvalue(), errors.getvalue()
    sys.argv[:] = ["", words[0], json.dumps(needed)]
print(json.dumps(found))
"""


def answers(*lines):
    """Exit status, output and errors of command lines that run side by side."""
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    running = [subprocess.Popen([FOLDER / name, *words], **pipes) for name, *words in lines]
    outputs = [process.communicate(timeout=ros_harness.START_S) for process in running]
    return [(process.returncode, *output) for process, output in zip(running, outputs)]


def answers_of_all(word, **needed):
    """The same of every executable, by name; `needed` are words that some need besides."""
    command = [sys.executable, "-c", ALL, word, json.dumps(needed)]
    shown = subprocess.run(command, capture_output=True, text=True, timeout=ros_harness.START_S)
    assert shown.returncode == 0, shown.stderr
    return json.loads(shown.stdout)


def test_every_executable_tells_what_it_is():
    found = answers_of_all("--help")
    assert found.keys() == EXECUTABLES.keys()
    for name, (status, out, errors) in found.items():
        assert (status, errors) == (0, ""), name
        assert out.startswith("usage: ") and name in out and "--version" in out
    lines = [(name, "--version") for name in NODES]
    assert answers(*lines) == [(0, "tss_ros 0.1.0\n", "")] * len(NODES)


@pytest.mark.parametrize(
    ("word", "expected"),
    [
        ("--verison", "'--verison' is not known; did you mean '--version'?"),
        ("--no-such-word", "'--no-such-word' is not known"),
    ],
)
def test_every_executable_refuses_words_that_it_does_not_know(word, expected):
    # Where something is missing, that is said first.
    bag = dict.fromkeys(("review", "recover", "verify", "play", "summary", "plot", "page"), ["bag"])
    needed = {**bag, "export": ["bag", "--csv", "x"], "stability": ["-2"], "sweep": ["x"]}
    needed["follow"] = ["--from=-3", "--to=-2"]
    needed["simulate"] = ["--turns", "1", "--output", "x"]
    needed["ensemble"] = ["--rates", "-3", "-2", "2", "--pushes", "1"]
    for name, (status, out, errors) in answers_of_all(word, **needed).items():
        assert (status, out) == (2, ""), (name, out, errors)
        assert expected in errors.splitlines()[-1], (name, errors)


def test_parameters_without_ros_args_are_refused_and_ros_args_are_left_to_ros(start):
    lines = [
        ("sim_node", "--scenario", "six_bead"),
        ("sim_node", "scenario:=six_bead"),
        ("sim_node", "--ros-args", "-p", "start_paused:=true", "--", "paused"),
    ]
    for (status, _, errors), near in zip(answers(*lines), ("scenario", "scenario", "start_paused")):
        assert status == 2
        assert "parameters go after --ros-args, as -p name:=value" in errors
        assert f"did you mean {near!r}?" in errors
    process = start("sim_node", "--log-level", "warn", "--enable-stdout-logs", start_paused=True)
    with ros_harness.client_node() as client:
        simulator = ros_harness.Simulator(*client)
        simulator.spin_until(lambda: simulator.status, ros_harness.START_S, "the simulator")
    assert process.stop() == 0 and process.stderr == ""


def handles_signals(process):
    """Whether a process catches SIGTERM; Python alone does not."""
    status = Path(f"/proc/{process.pid}/status").read_text()
    return int(status.split("SigCgt:")[1].split()[0], 16) >> (signal.SIGTERM - 1) & 1


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM], ids=lambda n: n.name)
@pytest.mark.parametrize("node", NODES)
def test_a_signal_while_a_node_starts_ends_it_in_silence(start, node, number):
    for delay_s in (0.0, 0.1, 0.3, 0.6, 1.0, 1.5):
        given = {"output": f"bag_{delay_s}"} if node == "logger_node" else {}
        process = start(node, **given)
        ros_harness.wait_until(lambda p=process: handles_signals(p), 30, "the handlers")
        time.sleep(delay_s)
        process.send(number)
        assert process.wait(10) == 0, process.stderr
        assert "Traceback" not in process.stderr, (delay_s, process.stderr)
        assert len(process.stderr.splitlines()) <= 4, (delay_s, process.stderr)


def test_a_signal_while_a_command_loads_ends_it_in_silence(tmp_path):
    for delay_s in (0.0, 0.3):
        with subprocess.Popen(
            [FOLDER / "summary", tmp_path], stdout=subprocess.PIPE, stderr=subprocess.STDOUT
        ) as process:
            ros_harness.wait_until(lambda p=process: handles_signals(p), 30, "the handlers")
            time.sleep(delay_s)
            process.send_signal(signal.SIGINT)
            out, _ = process.communicate(timeout=30)
            if process.returncode != 1:  # which it is once it has said that there is no bag
                assert (process.returncode, out) == (128 + signal.SIGINT, b"")


def test_the_recorder_needs_no_numerical_libraries():
    code = (
        "import sys, tss_ros.recorder.logger_node, tss_ros.ros.parameters\n"
        "print([name for name in ('numba', 'llvmlite', 'scipy', 'rerun') if name in sys.modules])"
    )
    shown = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert shown.stdout == "[]\n", shown
