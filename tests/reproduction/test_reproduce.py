"""The reproduction command as users run it: figures from recordings, resumed, and interrupted."""

import contextlib
import json
import os
import signal
import uuid

import numpy as np
import pytest
from ros_harness import START_S, STOP_S, Process, wait_until

from tss_ros.bags.recording import read_bag
from tss_ros.core import confirm
from tss_ros.reproduction import (
    claims,
    loose_tolerance,
    motions,
    pages,
    paper_figures,
    pulling,
    reproduce,
    verdicts,
)
from tss_ros.runs.processes import STOP_S as NODE_STOP_S

PNG, PDF = b"\x89PNG\r\n\x1a\n", b"%PDF"


@pytest.fixture
def run(tmp_path):
    """A function that starts the command, and one that finds what still runs of it."""
    mark = str(uuid.uuid4())

    def start(*arguments):
        environment = {**os.environ, "TSS_TEST": mark}
        return Process("reproduce", tmp_path, arguments, env=environment)

    def survivors():
        found = []
        for process in filter(str.isdecimal, os.listdir("/proc")):
            with contextlib.suppress(OSError), open(f"/proc/{process}/environ", "rb") as file:
                if f"TSS_TEST={mark}".encode() in file.read().split(b"\0"):
                    found.append(process)
        return found

    return start, survivors


@pytest.mark.long
def test_a_figure_is_drawn_from_its_recording_and_not_made_again(run, tmp_path):
    start, survivors = run
    output = tmp_path / "out"
    process = start("--figure", "8", "--output", "out")
    wait_until(lambda: "motion figure_06 ... " in process.stdout, START_S, "the first motion")
    process.send(signal.SIGINT)
    assert process.wait(NODE_STOP_S + STOP_S) == 130
    assert survivors() == []
    assert "interrupted" in process.stderr and "Traceback" not in process.stderr
    assert not (output / "figure_08.png").exists()
    assert [path.name for path in output.iterdir() if path.name.startswith(".")] == []
    identified = output / "numbers" / "damping.json"
    before = identified.stat().st_mtime_ns

    process = start("--figure", "8", "--output", "out")
    assert process.wait(START_S) == 0, process.stderr
    assert "damping ... done before" in process.stdout
    assert identified.stat().st_mtime_ns == before
    assert (output / "figure_08.png").read_bytes().startswith(PNG)
    assert (output / "figure_08.pdf").read_bytes().startswith(PDF)
    # The bag holds the very motion that the verdict speaks of: lost at 2.0, held at 2.5.
    for name, held in (("figure_06", False), ("figure_07", True)):
        recording = read_bag(output / "bags" / name)
        motion = claims.MOTIONS[name]
        damping = recording.damping_n_s_per_m[0]
        seen = confirm(
            claims.system("three_star", damping),
            motion.rate,
            disturbance_m=motion.disturbance_m,
            seed=claims.SEED,
            turns=motion.turns,
        )
        assert recording.step.size == motion.turns * claims.SAMPLES_PER_TURN + 1
        change = np.abs(recording.deviation_from_centre - recording.deviation_from_centre[0])
        assert change.max() == pytest.approx(seen.deviation_from_centre, rel=1e-2)
        assert seen.held == held
        of = claims.system("three_star", damping)
        here = motions.simulate(of, motion, lambda: False)
        first = recording.turns < 1.0
        np.testing.assert_allclose(here.position_m[first], recording.position_m[first], atol=1e-3)
        told = motions.outcome(of, motion, recording, lambda: False)
        assert told["held"] == held and (told["lost_after"] is None) == held
        assert 0.01 < told["pushing_share"] < 0.5
        title = paper_figures.orbit(recording).get_suptitle()
        assert "kelvin_voigt" in title and f"{100 * told['pushing_share']:.0f} %" in title

    files = {p: p.stat().st_mtime_ns for p in output.rglob("*") if p.is_file()}
    process = start("--figure", "8", "--output", "out")
    assert process.wait(START_S) == 0
    assert process.stdout.count("done before") == 4
    assert {p: p.stat().st_mtime_ns for p in output.rglob("*") if p.is_file()} == files


@pytest.mark.long
def test_what_other_sources_made_is_made_again(tmp_path):
    work = reproduce.Workshop(tmp_path, [])
    work.make(["damping"])
    file = tmp_path / "numbers" / "damping.json"
    made = json.loads(file.read_text())
    file.write_text(json.dumps(made | {"made_from": "other sources"}))
    work.make(["damping"])
    assert json.loads(file.read_text()) == made
    file.write_text("{")
    work.make(["damping"])
    assert json.loads(file.read_text()) == made


@pytest.mark.parametrize("number", ["12", "2", "99", "eight", "-3"])
def test_an_unknown_figure_is_refused_in_one_line(number, capsys):
    with pytest.raises(SystemExit) as exit:
        reproduce.main([f"--figure={number}"])
    assert exit.value.code == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert repr(number) in error and "3, 4, 5, 6, 7, 8, 9, 10, 11, 13, 14, 15" in error


def test_the_damping_identified_yields_the_claimed_rates():
    """Against the closed form of a rigid, damped triangle."""
    found = claims.identify_damping(lambda: False)
    assert found["three_star_50kg"]["damping"] is None  # 2.79 lies beyond 1 + sqrt(5/2)
    for name, near in (("three_star", 1450), ("three_star_1000kg", 1850)):
        damping = found[name]["damping"]
        assert damping == pytest.approx(near, abs=10)
        edge = claims.slack_edge(damping, claims.system(name, damping))
        assert edge == pytest.approx(claims.CRITICAL[name], abs=2e-3)
    edges = claims.simulated_edges(
        "three_star", found["three_star"]["damping"], lambda: False, 0.1, ("settled",)
    )
    assert edges["settled"] == pytest.approx(-2.17, abs=0.02)


def test_a_general_integrator_agrees_when_its_tolerance_is_strict():
    of = claims.system("three_star", 1450.0)
    for rate, held in ((-2.0, False), (-2.5, True)):
        deviation = loose_tolerance.largest_deviation(of, rate, 1e-8, lambda: False)
        assert (deviation < 0.2) == held


def test_a_damped_ring_that_holds_by_pushing_is_lost_where_tethers_only_pull():
    """By the core and by the general integrator; above the slack limit both laws hold."""
    for rate, law, held in (
        (-2.4, claims.PAPER_LAW, True),
        (-2.4, claims.PULLING_LAW, False),
        (-2.6, claims.PULLING_LAW, True),
    ):
        of, motion = claims.system("three_star", 1450.0, law), claims.PaperMotion("", rate)
        seen = motions.simulate(of, motion, lambda: False)
        told = motions.outcome(of, motion, seen, lambda: False)
        assert told["held"] == held and (told["lost_after"] is None) == held
        assert (told["pushing_share"] > 0.1) == (law == claims.PAPER_LAW)
        deviation = loose_tolerance.largest_deviation(of, rate, 1e-8, lambda: False)
        assert (deviation < claims.LOST) == held


def test_tethers_that_only_pull_first_let_go_at_the_rigid_limit():
    """Whatever the damping: Eq. (6) keeps them taut to slower rates the more it damps."""
    for damping in (100.0, 1450.0):
        found = claims.boundaries(
            "three_star", damping, -2.62, -2.56, lambda: False, tether_law=claims.PULLING_LAW
        )
        assert tuple(found[0][1:]) == ("first slack", -1)
        assert {cause for _, cause, _ in found[1:]} <= {"spin"}
        assert found[0][0] == pytest.approx(claims.RIGID_EDGE, abs=5e-3)
    assert claims.boundaries("three_star", 1450.0, -2.62, -2.56, lambda: False) == []


def test_rates_of_tethers_that_only_pull_bracket_what_single_motions_do():
    row = pulling.critical_rates("three_star_1000kg", (1450.0,), (), lambda: False)[0]
    assert row["held_long"] is None
    of = claims.system("three_star_1000kg", 1450.0, claims.PULLING_LAW)
    for beyond, held in ((-0.01, True), (0.01, False)):
        motion = claims.PaperMotion("", row["held"] + beyond, pulling.SHORT)
        assert motions.fate(of, motion, lambda: False)["held"] == held


def test_every_claim_has_a_complete_row():
    """Against the list of claims in the paper's figures, with made-up numbers."""
    rows = verdicts.claim_rows(made_up, 1451.0)
    assert all(len(row) == len(verdicts.HEADING) and all(map(str, row)) for row in rows)
    text = " ".join(" ".join(row) for row in rows)
    for claim in ("2.17", "2.79", "2.07", "2.08", "2.0", "2.5", "2.9", "1.5", "2.2", "oscillates"):
        assert claim in text
    where = " ".join(row[2] for row in rows)
    for figure in ("3", "4", "5", "6", "7", "8", "9", "10", "11", "13", "14", "15"):
        assert f" {figure}" in f" {where}".replace(",", " ").replace(".", " ")
    told = {row[1]: row[-1] for row in rows}
    assert told["critical rate 2.17"] == "reproduced at C = 1451"
    assert told["critical rate 2.07"].startswith("reproduced at C = 1848")
    assert told["critical rate 2.79"].startswith("not reproduced: ")
    assert all(verdict.startswith(("reproduced", "not reproduced: ")) for verdict in told.values())
    column = verdicts.HEADING.index("with tethers that only pull")
    pulled = {row[1]: row[column] for row in rows}
    assert all(text.startswith(("reproduced: ", "not reproduced: ")) for text in pulled.values())
    assert pulled["critical rate 2.17"].startswith("not reproduced: held for 12 turns beyond 2.505")
    assert pulled["lost at 2.0"].startswith("reproduced: ")
    shares = [row[column + 1] for row in rows]
    assert all("%" in share or share == "–" for share in shares)


def made_up_motion(held):
    return {
        "frozen": 1.003,
        "frozen_verdict": "neutral",
        "verdict": "neutral",
        "nontrivial": 1.0,
        "closure": 1e-5,
        "held": held,
        "settle": 0.25,
        "from_centre": 0.01,
        "from_origin": 0.02,
        "recorded": 0.01,
        "lost_after": None if held else 2.0,
        "pushing_share": 0.13,
        "oscillation": {"length_last": 1e-5, "kink_last_deg": 3.0, "settled_share": 1.0},
    }


def made_up(item):
    """Numbers like those of `claims`: critical at 2.17, held wherever faster; pulling, at 2.505."""
    kind, _, name = item.partition(" ")
    if kind == "motion":
        rate = claims.MOTIONS[name].rate
        pulls = made_up_motion(rate < -2.505) | {"turns": 12}
        return made_up_motion(rate < -2.17) | {"pulling": pulls}
    simulated = {"settled": -2.16, "held": -2.14, "origin": -2.14}
    return {
        "boundaries": [[-2.171, "first slack", -1], [-2.16, "spin", -1]],
        "claimed": {
            claims.PAPER_LAW: made_up_motion(True),
            claims.PULLING_LAW: made_up_motion(False),
        },
        "pulling": [
            {
                "damping": 1451.0,
                "held": -2.505,
                "settled": -2.52,
                "held_long": None if name == "six_bead" else -2.555,
                "boundaries": [[-2.582, "first slack", -1], [-2.523, "spin", -1]],
            }
        ],
        "curve": [{"frozen": 1.003, "frozen_nontrivial": 1.0}],
        "damping": {
            "three_star": {"damping": 1451.0},
            "three_star_50kg": {"damping": None},
            "three_star_1000kg": {"damping": 1848.0},
        },
        "scan": [{"damping": 1451.0, "simulated": simulated}],
        "six": [[1451.0, [[-2.82, "none found", -1]], -2.8]],
        "fates": {"figure_10_2.5": [[1.0, False, 9.0], [1451.0, True, 1.0]]},
    }[kind]


def test_the_page_holds_its_pictures(tmp_path):
    (tmp_path / "a.png").write_bytes(PNG)
    text = "# T\n\n| a | b |\n|---|---|\n| 1 | 2 |\n\n![x](a.png)"
    page = pages.html(text, tmp_path)
    assert "<table>" in page and "data:image/png;base64,iVBORw0KGgo" in page
    assert 'src="a.png"' not in page
