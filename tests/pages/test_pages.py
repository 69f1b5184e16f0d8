"""Pages hold all that they need, and their charts show what is in bags and sweeps."""

import dataclasses
import json
import re
from base64 import b64decode
from html.parser import HTMLParser

import numpy as np
import pytest

from tss_ros.bags.commands import describe
from tss_ros.bags.recording import read_bag
from tss_ros.command_line import why_not_written
from tss_ros.pages import bag, html, page
from tss_ros.simulator import ensemble, straight
from tss_ros.sweeps import command


class Page(HTMLParser):
    """A page taken apart: places it loads from, ids, and the cells of its tables by row."""

    def __init__(self, path):
        super().__init__()
        self.loads, self.ids, self.rows, self.text = [], [], [], path.read_text(encoding="utf-8")
        self._cell = None
        self.feed(self.text)

    def handle_starttag(self, tag, attributes):
        attributes = dict(attributes)
        if tag in ("script", "img", "link", "iframe"):
            self.loads += [attributes[name] for name in ("src", "href") if name in attributes]
        if "id" in attributes:
            self.ids.append(attributes["id"])
        if tag == "tr":
            self.rows.append([])
        self._cell = "" if tag in ("td", "th") else self._cell

    def handle_data(self, data):
        if self._cell is not None:
            self._cell += data

    def handle_endtag(self, tag):
        if tag in ("td", "th"):
            self.rows[-1].append(self._cell)
            self._cell = None


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with a bag of two turns and a sweep of one scenario."""
    folder = tmp_path_factory.mktemp("pages")
    words = ["three_star", "--turns", "2", "--disturbance-m", "10", "--output", str(folder / "bag")]
    assert straight.main(words) == 0
    words = ["--rates", "-2.5", "-2.2", "2", "--critical", "-2.18", "-2.16", "--methods"]
    assert command.main([*words, "monodromy", "--output", str(folder / "sweep")]) == 0
    return folder


def test_a_page_of_a_bag_needs_nothing_else_and_shows_the_motion(folder, tmp_path, capsys):
    path = tmp_path / "bag.html"
    assert page.main([str(folder / "bag"), "--output", str(path)]) == 0
    assert capsys.readouterr().out == f"{path}\n"
    made, recording = Page(path), read_bag(folder / "bag")
    assert made.loads == []
    charts = {"shape", "drift", "lengths", "tensions", "orbit_frame", "turning_frame", "centre"}
    assert charts | {"energy"} == set(made.ids)
    facts = dict(row for row in made.rows if len(row) == 2)
    assert facts["steps"].startswith(f"{len(recording.step)}, 0 to")
    assert facts["tether law"].startswith("kelvin_voigt")


def chart(parts, name):
    """A chart among parts of a page: its curves by name, the last of each, and its layout."""
    (drawn,) = [part for part in parts if f'id="{name}"' in part]
    text = drawn.partition("Plotly.newPlot(")[2].partition(",")[2].lstrip()
    data, end = json.JSONDecoder().raw_decode(text)
    layout, _ = json.JSONDecoder().raw_decode(text[end:].lstrip(", \n"))
    for curve in data:
        for axis in "xy":
            if isinstance(curve[axis], dict):
                curve[axis] = np.frombuffer(b64decode(curve[axis]["bdata"]))
    return {curve["name"]: (np.array(curve["x"]), np.array(curve["y"])) for curve in data}, layout


def test_paths_in_the_turning_frame_stand_still_where_the_shape_holds(folder):
    recording = read_bag(folder / "bag")
    paths, _ = chart(bag._paths(recording), "turning_frame")  # their last turns
    for name in recording.bead_name:
        x, y = paths[name]
        np.testing.assert_allclose(np.hypot(x, y), 5.77, atol=0.02)
        assert np.ptp(x) < 0.1 and np.ptp(y) < 0.1


def test_paths_about_a_tilted_axis_are_shown_along_it_and_from_the_side(folder):
    """The recorded ring, turned by 45 degrees about x."""
    recording, half = read_bag(folder / "bag"), np.sqrt(0.5)
    flat = recording.only(np.arange(0, len(recording.step), 4))  # so few that all are drawn
    tilt = np.array([[1.0, 0.0, 0.0], [0.0, half, half], [0.0, -half, half]])
    tilted = dataclasses.replace(
        flat, spin_axis=tilt @ [0.0, 0.0, 1.0], position_m=flat.position_m @ tilt.T
    )
    parts = list(bag._paths(tilted))
    last = tilted.turns >= tilted.turns[-1] - 1.0
    along, _ = chart(parts, "orbit_frame")
    side, layout = chart(parts, "side")
    turning, _ = chart(parts, "turning_frame")
    assert layout["xaxis"]["title"]["text"] == "z, orbit normal [km]"
    for i, name in enumerate(flat.bead_name):
        place_km = tilted.position_m[last, i] / 1e3
        np.testing.assert_allclose(along[name], flat.position_m[last, i, :2].T / 1e3, atol=1e-9)
        np.testing.assert_allclose(side[name], place_km[:, [2, 1]].T)
        assert max(map(np.ptp, turning[name])) < 0.1
    x, y = side["spin axis"]
    np.testing.assert_allclose(x, y)


def test_a_chain_that_hangs_is_shown_in_orbits_from_the_north_and_from_ahead(tmp_path):
    words = ["vertical_chain_2", "--turns", "0.5", "--disturbance-m", "30"]
    assert straight.main([*words, "--output", str(tmp_path / "bag")]) == 0
    assert page.main([str(tmp_path / "bag"), "--output", str(tmp_path / "bag.html")]) == 0
    made, recording = Page(tmp_path / "bag.html"), read_bag(tmp_path / "bag")
    assert {"orbit_frame", "side"} <= set(made.ids) and "turning_frame" not in made.ids
    parts = list(bag.parts(recording))
    for name, across in (("orbit_frame", 0), ("side", 2)):
        paths, layout = chart(parts, name)
        assert "[m]" in layout["xaxis"]["title"]["text"]
        assert "not to scale" in layout["title"]["text"] and "scaleanchor" not in layout["yaxis"]
        for i, bead in enumerate(recording.bead_name):
            x, y = paths[bead]
            np.testing.assert_allclose(x, recording.position_m[-len(x) :, i, across])
            np.testing.assert_allclose(1e3 * y, recording.position_m[-len(y) :, i, 1])
    told = [line for line in describe(recording).splitlines() if "simulated by" not in line]
    assert not re.search(r"\bturns?\b", "\n".join(told)) and "0.50 orbits" in told[7]
    for name in ("shape", "tensions", "energy"):
        assert chart(parts, name)[1]["xaxis"]["title"]["text"] == "orbits [-]"


def test_a_page_of_a_sweep_has_verdicts_and_critical_rates_with_their_cause(folder, tmp_path):
    path = tmp_path / "sweep.html"
    assert page.main([str(folder / "sweep"), "--output", str(path)]) == 0
    made = Page(path)
    assert made.loads == [] and made.ids == ["moduli"]
    (stable,) = [row for row in made.rows if "-2.5" in row]
    assert "asymptotically stable" in stable
    assert any(cell.startswith("shape 0.000") for cell in stable)
    (critical,) = [row for row in made.rows if "first slack" in row]
    assert critical[1].startswith("-2.17")
    assert "below" in critical


def test_a_page_of_an_ensemble_says_how_probably_the_formation_holds(tmp_path):
    words = ["three_star", "--rates", "-2.5", "-2.1", "2", "--pushes", "300"]
    words += ["--seeds", "0", "4", "--turns", "6", "--output"]
    assert ensemble.main([*words, str(tmp_path / "pushed")]) == 0
    assert page.main([str(tmp_path / "pushed"), "--output", str(tmp_path / "page.html")]) == 0
    made = Page(tmp_path / "page.html")
    assert made.loads == [] and made.ids == ["held"]
    (holds,) = [row for row in made.rows if row[:2] == ["-2.5", "300"]]
    assert holds[2:5] == ["5", "0", "0"] and holds[5] == "56.55% to 100.00%"


def test_a_page_that_exists_is_not_replaced_unless_told_so(folder, tmp_path, capsys):
    path = tmp_path / "bag.html"
    path.write_text("mine")
    with pytest.raises(SystemExit) as ended:
        page.main([str(folder / "bag"), "--output", str(path)])
    assert ended.value.code == 2 and path.read_text() == "mine"
    assert "exists already; give another name, or --overwrite" in capsys.readouterr().err
    assert page.main([str(folder / "bag"), "--output", str(path), "--overwrite"]) == 0
    assert path.read_text().startswith("<!DOCTYPE html>")


@pytest.mark.parametrize(
    ("name", "endings", "words"),
    [
        ("x.bmpp", (".png", ".svg"), "has no known ending; allowed: .png, .svg"),
        ("missing/x.png", (".png",), "there is no folder"),
        ("there.png", (".png",), "exists already"),
        ("folder.png", (".png",), "is a folder"),
        ("there.png", (), "is no folder"),
        ("there.png/deeper", (), "is no folder"),
        ("new/deeper", (), ""),
        ("X.PNG", (".png",), ""),
    ],
)
def test_outputs_are_refused_for_a_reason_that_is_said(tmp_path, name, endings, words):
    (tmp_path / "there.png").write_text("mine")
    (tmp_path / "folder.png").mkdir()
    why = why_not_written(tmp_path / name, endings)
    assert words in why and bool(why) == bool(words)


def test_what_stands_for_many_points_keeps_every_extreme_and_every_gap():
    rng = np.random.default_rng(5)
    x, y = np.arange(100_000.0), rng.normal(size=100_000)
    y[[12_345, 77_777]] = 50.0, -60.0
    y[40_000:40_100] = np.nan
    kept_x, kept_y, per_part = html.envelope(x, y, 2000)
    assert len(kept_x) <= 2000 * 1.5 and per_part == 100
    assert np.all(np.diff(kept_x) > 0)
    np.testing.assert_array_equal(kept_y, y[kept_x.astype(int)])
    assert (np.nanmax(kept_y), np.nanmin(kept_y)) == (50.0, -60.0)
    assert np.isnan(kept_y).sum() == 1
    for first in range(0, 40_000, 100):
        part = kept_y[(kept_x >= first) & (kept_x < first + 100)]
        assert (part.min(), part.max()) == (
            y[first : first + 100].min(),
            y[first : first + 100].max(),
        )


def test_many_curves_are_cut_to_those_that_swing_the_most_and_it_is_said():
    turns, sizes = np.linspace(0, 1, 11), np.arange(100)
    drawn = html.figure("", "", "")
    said = html.curves(drawn, turns, np.sin(7 * turns)[:, None] * sizes, [str(i) for i in sizes])
    assert said == "The 40 of 100 curves that swing the most."
    assert [curve.name for curve in drawn.data] == [str(i) for i in range(60, 100)]


def test_moduli_of_what_is_no_motion_are_not_drawn():
    rows = [
        {"spin_rate_ratio": rate, "max_modulus": top, "deciding_modulus": own, "verdict": verdict}
        for rate, top, own, verdict in (
            (-2.5, 1.1, 0.1, "asymptotically stable"), (-2.0, 9.0, np.nan, "none found"),
            (-1.5, 8.0, np.nan, None),
        )
    ]  # fmt: skip
    drawn = bag.moduli(rows, [(-2.2, "first slack")])
    curves = {curve.name: curve for curve in drawn.data}
    np.testing.assert_array_equal(curves["largest of all"].y, [1.1, np.nan, np.nan])
    assert list(curves["asymptotically stable"].y) == [0.1]
    assert list(curves["none found"].x) == [-2.0]
    np.testing.assert_array_equal(curves["what decided"].y, [0.1, np.nan, np.nan, np.nan])
    assert drawn.layout.annotations[0].text == "first slack"


def test_words_from_a_bag_are_no_markup():
    assert "<script>alert" not in html.table(["<b>"], [["<script>alert(1)</script>"]])
