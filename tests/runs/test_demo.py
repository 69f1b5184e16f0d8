"""The client against a live stability node, and the whole demo, as users run them."""

import contextlib
import csv
import os
import signal
import uuid

import numpy as np
import pytest
from rerun.chunk import RrdReader
from ros_harness import START_S, STOP_S, Process, client_node, processes, wait_until

from tss_ros.bags.recording import read_bag
from tss_ros.core import TssError
from tss_ros.runs import demo
from tss_ros.runs.processes import STOP_S as NODE_STOP_S
from tss_ros.runs.processes import Nodes
from tss_ros.stability_service import client

PNG = b"\x89PNG\r\n\x1a\n"


@pytest.fixture(scope="module")
def stability_node(tmp_path_factory):
    with processes(tmp_path_factory.mktemp("stability_node")) as start:
        node = start("stability_node")
        node.wait_for_line("ready")
        yield node


@pytest.fixture
def ask(stability_node, capsys):
    """Run the client in this process; return its exit status, output and error output."""

    def run(*arguments):
        status = client.main([str(argument) for argument in arguments])
        return status, *capsys.readouterr()

    return run


def columns(table):
    """The cells of each row of a table, cut at the column edges of its heading."""
    heading, *rows = table.splitlines()
    edges = [heading.index(name) for name in ("verdict", "closure", "message")]
    numbers = [row[: edges[0]].split() for row in rows]
    words = [[row[a:b].strip() for a, b in zip(edges, (*edges[1:], None))] for row in rows]
    return [[*n, *w] for n, w in zip(numbers, words)]


def test_table_has_a_row_for_each_rate_in_order(stability_node, tmp_path):
    client = Process("stability", tmp_path, ["-1.5", "-3e0", "2.75"])
    assert client.wait(START_S) == 0, client.stderr
    rows = columns(client.stdout)
    assert [row[0] for row in rows] == ["-1.5", "-3", "2.75"]
    # Turns of the paper's orbit (mu, R_E and H of Table 1): 2 pi / (|w| sqrt(mu / R^3)).
    orbit_s = 2 * np.pi * np.sqrt(7.378e6**3 / 3.986e14)
    for row, rate in zip(rows, (1.5, 3, 2.75)):
        assert float(row[1]) == pytest.approx(orbit_s / rate, abs=0.06)
    # Slow clockwise spin loses its plane and its tension; fast spin keeps both.
    assert rows[0][4] in ("unstable", "no periodic motion") and float(rows[0][2]) > 2
    assert all(row[4].endswith("stable") and float(row[3]) < 1.0001 for row in rows[1:])


def test_range_csv_and_plot(ask, tmp_path):
    status, out, _ = ask(
        *("--from", "-3.5", "--to", "-2.9", "--count", 4),
        *("--csv", tmp_path / "a.csv", "--plot", tmp_path / "a.png"),
    )
    assert status == 0
    with (tmp_path / "a.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    np.testing.assert_allclose(
        [float(row["spin_rate_ratio"]) for row in rows], [-3.5, -3.3, -3.1, -2.9]
    )
    for row, shown in zip(rows, columns(out)):
        assert float(row["max_modulus"]) == pytest.approx(float(shown[2]), abs=1e-6)
        assert row["verdict"] == shown[4]
    assert (tmp_path / "a.png").read_bytes().startswith(PNG)


def test_overrides_and_method_reach_the_node(ask):
    plain, heavy, frozen, each = (
        ask("-2", *more)[1]
        for more in (
            [],
            ["--override", "satellite_mass_kg=1000", "orbit_altitude_m=2e6"],
            ["--method", "frozen"],
            ["--override", "satellite_mass_kg=[100,100.0,100]", "satellites=3"],
        )
    )
    assert len({plain, heavy, frozen}) == 3
    assert each == plain
    # Turns get longer with the orbit's radius to the power of 3/2.
    ratio = float(columns(heavy)[0][1]) / float(columns(plain)[0][1])
    assert ratio == pytest.approx((8.378 / 7.378) ** 1.5, rel=1e-4)


@pytest.mark.parametrize(
    "arguments, expected",
    [
        (["-2", "--override", "satellite_mass_kg=-1"], "satellite_mass_kg"),
        (["-2", "--override", "colour=3"], "colour"),
        (["-2", "--method", "guess"], "guess"),
    ],
)
def test_a_refusal_is_one_line_and_a_failure(ask, arguments, expected):
    status, out, err = ask(*arguments)
    assert (status, out) == (1, "")
    assert err.startswith("stability: ") and expected in err and err.count("\n") == 1


def test_a_rate_that_fails_leaves_the_others_their_results(ask):
    status, out, _ = ask("0", "-2.5", "nan")
    zero, good, nan = columns(out)
    assert status == 1
    assert good[4] and float(good[2]) > 0
    assert "spin_rate_ratio" in zero[-1] and "spin_rate_ratio" in nan[-1]


@pytest.mark.parametrize(
    "arguments",
    [
        [],
        ["fast"],
        ["--from", "-2"],
        ["--from", "-2", "--to", "-3", "--count", "0"],
        ["-2", "--override", "satellite_mass_kg"],
        ["-2", "--override", "satellite_mass_kg=heavy"],
    ],
)
def test_a_wrong_command_line_is_explained(arguments, capsys):
    with pytest.raises(SystemExit) as exit:
        client.main(arguments)
    assert exit.value.code == 2
    assert "stability: error: " in capsys.readouterr().err


def test_without_a_node_the_client_says_how_to_start_one():
    with client_node() as (node, _):
        service = "nobody/compute_floquet"
        with pytest.raises(TssError, match="/nobody/compute_floquet.*ros2 run tss_ros"):
            client.compute(node, service, [-2.0], patience_s=0.5)


# --- the demo


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


def test_a_node_that_fails_is_named_with_its_last_lines(tmp_path):
    with Nodes(tmp_path) as nodes:
        nodes.start("stability_node", satellite_mass_kg=-1.0)
        reason = "(?s)stability_node ended with status 1.*satellite_mass_kg"
        with pytest.raises(TssError, match=reason):
            wait_until(nodes.check, START_S, "the node to end")
