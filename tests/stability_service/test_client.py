"""The client of the stability node, as users run it: tables, files, refusals."""

import csv
import json

import numpy as np
import pytest
from PIL import Image
from ros_harness import START_S, Process, client_node, processes

from tss_ros.core import TssError, initial_state, ring
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
    names = ("decided by", "verdict", "tether law", "closure", "message")
    edges = [heading.index(name) for name in names]
    numbers = [row[: edges[0]].split() for row in rows]
    words = [[row[a:b].strip() for a, b in zip(edges, (*edges[1:], None))] for row in rows]
    return [[*n, *w] for n, w in zip(numbers, words)]


def test_table_has_a_row_for_each_rate_in_order(stability_node, tmp_path):
    client = Process("stability", tmp_path, ["-2.1", "-3e0", "2.75"])
    assert client.wait(START_S) == 0, client.stderr
    rows = columns(client.stdout)
    assert [row[0] for row in rows] == ["-2.1", "-3", "2.75"]
    # Turns of the paper's orbit (mu, R_E and H of Table 1): 2 pi / (|w| sqrt(mu / R^3)).
    orbit_s = 2 * np.pi * np.sqrt(7.378e6**3 / 3.986e14)
    for row, rate in zip(rows, (2.1, 3, 2.75)):
        assert float(row[1]) == pytest.approx(orbit_s / rate, abs=0.06)
    # Slow clockwise spin loses its plane and its tension; fast spin keeps both.
    # Faster than 1 + sqrt(5/2) spin alone holds the tethers taut.
    assert all(row[5].split()[0] == "kelvin_voigt" for row in rows)
    pushed = [float(row[5].split()[1].rstrip("%")) for row in rows]
    assert 20.0 < pushed[0] < 60.0 and pushed[1:] == [0.0, 0.0]
    assert rows[0][4] == "unstable"
    for row in rows[1:]:
        family, modulus = row[3].split()
        assert row[4].endswith("stable") and family == "shape" and float(modulus) < 1.0


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
        assert f"{row['deciding_family']} {float(row['deciding_modulus']):.6f}" == shown[3]
        assert row["tether_law"] == "kelvin_voigt"
        assert f"{float(row['pushing_share']):.1%}" == shown[5].split()[1]
    assert (tmp_path / "a.png").read_bytes().startswith(PNG)


@pytest.mark.long
def test_the_mode_that_decided_is_drawn_and_animated(ask, tmp_path):
    """A hexagon's tilt meets its wave k = 3 at -2.8: the picture is of that mode."""
    hexagon = ("-2.8", "--override", "satellites=6")
    for name in ("mode.png", "mode.gif"):
        status, out, err = ask(*hexagon, "--mode-shape", tmp_path / name)
        assert status == 0, err
        assert columns(out)[0][3].startswith("axis tilt 1.1") and columns(out)[0][4] == "unstable"
    assert (tmp_path / "mode.png").read_bytes().startswith(PNG)
    with Image.open(tmp_path / "mode.gif") as moving:
        assert moving.n_frames > 20
        first = np.asarray(moving.convert("RGB"), dtype=int)
        moving.seek(moving.n_frames // 2)
        assert np.abs(np.asarray(moving.convert("RGB")) - first).max() > 100
    status, _, err = ask("0", "--mode-shape", tmp_path / "none.png")
    assert status == 1 and "no multiplier decided at 0" in err
    assert not (tmp_path / "none.png").exists()


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
    pulling = ask("-2.5", "--override", "tether_law=tension_only", "damping_n_s_per_m=100.0")[1]
    assert columns(pulling)[0][5].split() == ["tension_only", "0.0%"]
    # Turns get longer with the orbit's radius to the power of 3/2.
    ratio = float(columns(heavy)[0][1]) / float(columns(plain)[0][1])
    assert ratio == pytest.approx((8.378 / 7.378) ** 1.5, rel=1e-4)


@pytest.mark.parametrize(
    "arguments, expected",
    [
        (["-2", "--override", "satellite_mass_kg=-1"], "satellite_mass_kg"),
        (["-2", "--override", "colour=3"], "colour"),
        (["-2", "--override", "tether_law=tension"], "did you mean 'tension_only'?"),
        (["-2", "--override", "stiffening=2"], "only tether_law stiffening uses"),
        (["-2", "--method", "guess"], "guess"),
    ],
)
def test_a_refusal_is_one_line_and_a_failure(ask, arguments, expected):
    status, out, err = ask(*arguments)
    assert (status, out) == (1, "")
    assert err.startswith("stability: ") and expected in err and err.count("\n") == 1


def test_a_start_from_a_file_reaches_the_node(ask, tmp_path):
    start = initial_state(ring(), -2.5)
    content = {name: getattr(start, name).tolist() for name in ("position_m", "velocity_m_s")}
    (tmp_path / "start.json").write_text(json.dumps(content))
    status, out, err = ask("-2.5", "--start", tmp_path / "start.json")
    assert status == 0, err
    (row,) = columns(out)
    assert row[4] == "asymptotically stable" and "the start that was given" in row[-1]
    (tmp_path / "start.json").write_text(json.dumps({**content, "position_m": [1.0]}))
    status, out, err = ask("-2.5", "--start", tmp_path / "start.json")
    assert (status, out) == (1, "") and "position_m has 1 numbers; allowed: 9" in err


def test_a_rate_that_fails_leaves_the_others_their_results(ask):
    status, out, _ = ask("0.0001", "-2.5", "nan")
    tiny, good, nan = columns(out)
    assert status == 1
    assert good[4] and float(good[2]) > 0
    assert "spin_rate_ratio" in tiny[-1] and "spin_rate_ratio" in nan[-1]


@pytest.mark.parametrize(
    "arguments",
    [
        [],
        ["fast"],
        ["--from", "-2"],
        ["-2", "-3", "--mode-shape", "x.png"],
        ["-2", "--plot", "x.bmpp"],
        ["-2", "--csv", "no/such/folder.csv"],
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
