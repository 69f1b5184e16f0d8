"""The one command `tss`: what it lists, refuses, completes and paints, and how quick it is."""

import os
import pty
import resource
import subprocess
import sys

import pytest

from tss_ros.__main__ import COMMANDS
from tss_ros.executables import EXECUTABLES

TSS = [sys.executable, "-m", "tss_ros"]
NAMES = [name for group in COMMANDS.values() for name in group]


def run(*words, **options):
    return subprocess.run([*TSS, *words], capture_output=True, text=True, timeout=120, **options)


def test_it_has_every_executable_and_says_what_each_does():
    executables = [entry[0] for group in COMMANDS.values() for entry in group.values()]
    assert sorted([*executables, "sim_node"]) == sorted(EXECUTABLES)  # `tss sim` is two of them
    shown = run("--help")
    assert (shown.returncode, shown.stderr) == (0, "")
    assert run().stdout == shown.stdout
    for group in COMMANDS.values():
        for name, (_, about) in group.items():
            assert f"  {name.ljust(15)} {about}\n" in shown.stdout


def test_help_takes_less_than_half_a_second_of_processor_time():
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    run("--help")
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    assert after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime < 0.5


def test_a_command_is_called_as_it_was_given():
    shown = run("verify", "--help")
    assert shown.stdout.startswith("usage: tss verify [-h] [--version]")
    refused = run("verify", "bag", "--deep")
    assert refused.returncode == 2 and "tss verify: error: '--deep' is not known" in refused.stderr
    assert run("sim", "--help").stdout.startswith("usage: tss sim ")


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["swep", "--rates"], "tss: error: 'swep' is not known; did you mean 'sweep'?"),
        (["sumary", "bag"], "did you mean 'summary'?"),
        (["--hepl"], "did you mean '--help'?"),
    ],
)
def test_a_wrong_command_is_answered_with_the_nearest(words, expected):
    refused = run(*words)
    assert (refused.returncode, refused.stdout) == (2, "")
    assert expected in refused.stderr


def test_benchmarks_are_in_a_checkout_only(tmp_path):
    assert run("bench", "--help").stdout.startswith("usage: tss bench")
    code = (
        "from pathlib import Path; from tss_ros.runs import tools\n"
        f"tools.CHECKOUT = Path({str(tmp_path)!r}); raise SystemExit(tools.bench([]))"
    )
    refused = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert refused.returncode == 1
    assert refused.stderr == "bench: the benchmarks are in a checkout of the source only\n"


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("tss swe", ["sweep"]),
        ("tss s", ["sim", "stability", "stability_node", "summary", "sweep"]),
        ("tss sweep --me", ["--methods"]),
        ("tss sweep three_star --methods f", ["frozen"]),
        ("tss completion b", ["bash"]),
    ],
)
def test_bash_completes_commands_options_and_choices(tmp_path, line, expected):
    (tmp_path / "tss").write_text(f'#!/bin/sh\nexec {sys.executable} -m tss_ros "$@"\n')
    (tmp_path / "tss").chmod(0o755)
    words = line.split(" ")
    script = (
        'eval "$(tss completion bash)"\n'
        f"COMP_WORDS=({line}); COMP_CWORD={len(words) - 1}; COMP_TYPE=9\n"
        f"COMP_LINE='{line}'; COMP_POINT={len(line)}; _python_argcomplete tss\n"
        'printf "%s\\n" "${COMPREPLY[@]}"'
    )
    path = f"{tmp_path}:{os.environ['PATH']}"
    shown = subprocess.run(
        ["bash", "-c", script], env={**os.environ, "PATH": path}, capture_output=True, text=True
    )
    found = [word.strip() for word in shown.stdout.splitlines() if word.strip()]
    assert sorted(found) == expected, shown.stderr


def on_a_terminal(*words, **environ):
    """What a terminal gets, of output and errors alike."""
    controller, terminal = pty.openpty()
    surroundings = {**os.environ, "TERM": "xterm", **environ}
    process = subprocess.Popen([*TSS, *words], stdout=terminal, stderr=terminal, env=surroundings)
    os.close(terminal)
    text = b""
    while True:
        try:
            part = os.read(controller, 4096)
        except OSError:  # Linux's end of a terminal
            part = b""
        if not part:
            break
        text += part
    process.wait(60)
    os.close(controller)
    return text.decode()


def test_terminals_get_colours_unless_nobody_wants_them():
    assert "\033[36msweep" in on_a_terminal("--help", NO_COLOR="")
    assert "\033[31mtss: error:\033[0m 'swep'" in on_a_terminal("swep", NO_COLOR="")
    for plain in (on_a_terminal("--help", NO_COLOR="1"), run("--help").stdout):
        assert "\033" not in plain and "sweep" in plain
