"""The whole demo, as users run it."""

import contextlib
import csv
import os
import signal
import uuid

import numpy as np
import pytest
from rerun.chunk import RrdReader
from ros_harness import START_S, STOP_S, Process, wait_until

from tss_ros.bags.recording import read_bag
from tss_ros.core import TssError
from tss_ros.runs import demo
from tss_ros.runs.processes import STOP_S as NODE_STOP_S

PNG = b"\x89PNG\r\n\x1a\n"


@pytest.fixture
def run_demo(tmp_path):
    """A function that starts the demo in an empty folder, and one that finds what still runs."""
    mark = f"TSS_TEST={uuid.uuid4()}"

    def start(*arguments):
        name, _, value = mark.partition("=")
        environment = {**os.environ, name: value, "XDG_CACHE_HOME": str(tmp_path / "cache")}
        return Process("demo", tmp_path, arguments, env=environment)

    def survivors():
        found = []
        for process in filter(str.isdecimal, os.listdir("/proc")):
            with contextlib.suppress(OSError), open(f"/proc/{process}/environ", "rb") as file:
                if mark.encode() in file.read().split(b"\0"):
                    found.append(process)
        return found

    return start, survivors


def test_demo_leaves_everything_it_promises(run_demo, tmp_path):
    start, survivors = run_demo
    output = tmp_path / "runs" / "demo"
    process = start()
    status = process.wait(START_S)
    assert status == 0, process.stderr
    assert survivors() == []
    assert sorted(path.name for path in output.iterdir()) == sorted(demo.FILES)
    assert sorted(path.name for path in (output / "bag").iterdir()) == [
        "bag_0.mcap",
        "metadata.yaml",
    ]
    assert [path.name for path in output.parent.iterdir()] == ["demo"]
    for name in demo.FILES:
        assert f"runs/demo/{name}" in process.stdout.splitlines()
    assert "turn 8.0 of 8, " in process.stdout and "12 of 12 rates" in process.stdout

    recording = read_bag(output / "bag")
    np.testing.assert_array_equal(recording.step, np.arange(recording.step.size))
    # The last step falls on the end of the eighth turn or less than a period before it.
    assert 8 - 5 / 2523 < recording.turns[-1] <= 8
    assert recording.spin_rate_ratio == -2.5 and recording.disturbance_m == 10

    shown = [
        chunk.num_rows
        for chunk in RrdReader(output / "review.rrd").stream().to_chunks()
        if str(chunk.entity_path) == "/formation/tethers" and not chunk.is_static
    ]
    assert sum(shown) == recording.step.size
    with (output / "stability.csv").open(newline="") as file:
        rates = [float(row["spin_rate_ratio"]) for row in csv.DictReader(file)]
    np.testing.assert_allclose(rates, np.linspace(-1.5, -3.5, 12))
    for name in ("trajectories", "deviation", "stability"):
        assert (output / f"{name}.png").read_bytes().startswith(PNG)

    # Again: interrupted half way it leaves the earlier results alone, and nothing else.
    before = {path: path.stat().st_mtime_ns for path in output.rglob("*")}
    process = start()
    wait_until(lambda: "turn " in process.stdout, START_S, "the first turn")
    process.send(signal.SIGINT)
    assert process.wait(NODE_STOP_S + STOP_S) == 130
    assert survivors() == []
    assert {path: path.stat().st_mtime_ns for path in output.rglob("*")} == before
    assert [path.name for path in output.parent.iterdir()] == ["demo"]


def test_demo_replaces_only_what_a_demo_wrote(tmp_path):
    for foreign in ("notes.txt", "bag/extra.mcap", "review.rrd/x"):
        output = tmp_path / foreign.replace("/", "_")
        (output / foreign).parent.mkdir(parents=True)
        (output / foreign).write_text("mine")
        with pytest.raises(TssError, match="which no demo wrote"):
            demo.make(output, [])
        assert (output / foreign).read_text() == "mine"
    with pytest.raises(TssError, match="is not a folder"):
        demo.make(tmp_path / "notes.txt" / "notes.txt", [])
