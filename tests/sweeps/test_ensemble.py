"""Ensembles: which motions they are of, what is kept, and how probably a formation holds."""

import math
import shutil
import signal
import sqlite3
import subprocess
import sys
from contextlib import closing

import dask_cluster
import numpy as np
import pyarrow as pa
import pyarrow.parquet
import pytest
import ros_harness

from tss_ros.core import (
    Cancelled,
    EnsembleJob,
    IntegrationError,
    Propagator,
    TssError,
    confirm,
    disturbed,
    initial_state,
    ring,
)
from tss_ros.core.motion import integrate
from tss_ros.scenarios import scenario
from tss_ros.sweeps.ensemble import (
    MOTIONS,
    MOTIONS_PER_JOB,
    EnsembleQuestion,
    ensemble,
    probabilities,
    story,
)

ENSEMBLE = [sys.executable, "-m", "tss_ros", "ensemble"]
#: Beyond the critical rate and short of it: after 3 turns the first holds, the other is lost.
ASKED = ("three_star", (-2.5, -1.9, 2), [10.0, 200.0], (3, 62), 3)
WORDS = [
    "three_star",
    "--rates",
    "-2.5",
    "-1.9",
    "2",
    "--pushes",
    "10",
    "200",
    "--seeds",
    "3",
    "62",
]
WORDS += ["--turns", "3"]


def files(folder):
    """The bytes of all Parquet files."""
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*.parquet")}


def done_in(folder):
    """How many jobs are recorded."""
    if not (folder / "manifest.sqlite").exists():
        return 0
    with closing(sqlite3.connect(f"file:{folder}/manifest.sqlite?mode=ro", uri=True)) as database:
        try:
            return database.execute("SELECT count(*) FROM job").fetchone()[0]
        except sqlite3.OperationalError:
            return 0  # about to be made


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """The folder of the ensemble, done in one go by one thread."""
    folder = tmp_path_factory.mktemp("finished")
    ensemble(*ASKED, output=folder, workers=1)
    return folder


@pytest.fixture(scope="module")
def rows(finished):
    return pyarrow.parquet.read_table(finished / MOTIONS).to_pylist()


def test_there_is_a_row_for_every_rate_push_and_seed_in_their_order(rows):
    about = [(r["spin_rate_ratio"], r["disturbance_m"], r["disturbance_seed"]) for r in rows]
    expected = [
        (w, push, seed) for w in (-2.5, -1.9) for push in (10, 200) for seed in range(3, 63)
    ]
    assert about == expected
    assert {(r["scenario"], r["tether_law"], r["error"]) for r in rows} == {
        ("three_star", "kelvin_voigt", None)
    }
    assert all(row["held"] for row in rows[:120]) and not any(row["held"] for row in rows[120:])


def test_a_row_is_of_the_motion_with_its_seed(rows):
    for row in (rows[0], rows[70], rows[239]):
        system = scenario.load("three_star").build()
        ratio, push, seed = (
            row[n] for n in ("spin_rate_ratio", "disturbance_m", "disturbance_seed")
        )
        start = disturbed(initial_state(system, ratio), push, seed)
        motion = Propagator(system, ratio, start)
        position, _ = motion.sample(np.linspace(0.0, 3 * motion.period_s, 601))
        assert row["switches"] == motion.switches
        arms = position - np.average(position, axis=1, weights=system.mass_kg)[:, None]
        distance = np.linalg.norm(arms, axis=2)
        largest = np.max(np.abs(distance - distance[0])) / math.hypot(*system.layout_m[0])
        assert row["deviation_from_centre"] == pytest.approx(largest, rel=2e-3)
        ends = position[:, system.tether_ends]
        length = np.linalg.norm(ends[:, :, 0] - ends[:, :, 1], axis=2)
        slack = np.mean(length <= system.rest_length_m)
        assert row["slack_share"] == pytest.approx(slack, abs=1e-12)
        assert (row["slack_share"] > 0.2) == (ratio == -1.9)


def test_held_is_what_a_confirmation_calls_so():
    (of_ensemble,) = EnsembleJob(ring(), -2.3, 50.0, (7,), 8).run()
    alone = confirm(ring(), -2.3, disturbance_m=50.0, seed=7, turns=8)
    assert of_ensemble.held is alone.held is True
    assert of_ensemble.turns_to_settle == alone.turns_to_settle
    assert of_ensemble.slack_share == alone.slack_share
    assert of_ensemble.deviation_from_centre == pytest.approx(alone.deviation_from_centre, rel=1e-6)


@pytest.mark.parametrize("where", ["threads", pytest.param("cluster", marks=pytest.mark.long)])
def test_files_are_the_same_to_the_last_bit_wherever_the_motions_were_made(
    tmp_path, finished, where
):
    if where == "threads":
        ensemble(*ASKED, output=tmp_path / "own", workers=3)
    else:
        with dask_cluster.running(tmp_path, 2) as dask:
            ensemble(*ASKED, output=tmp_path / "own", scheduler=dask.address)
    assert files(tmp_path / "own") == files(finished)


@pytest.mark.long
def test_interrupted_it_keeps_what_is_done_and_the_same_command_goes_on(tmp_path, finished):
    slow = [*WORDS[:-1], "300"]
    process = subprocess.Popen(
        [*ENSEMBLE, *slow, "--output", tmp_path, "--workers", "1"],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    try:
        ros_harness.wait_until(lambda: done_in(tmp_path) or process.poll() is not None, 90, "a job")
        process.send_signal(signal.SIGINT)
        out, error = process.communicate(timeout=60)
    finally:
        process.kill()
        process.wait()
    assert process.returncode == 130, error
    done = done_in(tmp_path)
    assert 1 <= done < 8
    assert f"interrupted; {done} of 8 jobs are done; the same command goes on" in error
    kept = pyarrow.parquet.read_table(tmp_path / MOTIONS)
    assert kept.num_rows in range(10 * done, 50 * done + 1) and kept["error"].null_count == len(
        kept
    )
    assert "three_star, kelvin_voigt, 300 turns, seeds 3 to 62" in out
    with pytest.raises(TssError, match="turns is 300 there and 3 here"):
        ensemble(*ASKED, output=tmp_path)

    # Of the ensemble that is done already, what was lost is done again, and nothing else.
    part = tmp_path / "part"
    shutil.copytree(finished, part)
    with closing(sqlite3.connect(part / "manifest.sqlite")) as database, database:
        database.execute("DELETE FROM job WHERE id >= 5")
        before = database.execute("SELECT * FROM job").fetchall()
    again = subprocess.run([*ENSEMBLE, *WORDS, "--output", part], capture_output=True, text=True)
    assert again.returncode == 0, again.stderr
    with closing(sqlite3.connect(part / "manifest.sqlite")) as database:
        assert database.execute("SELECT * FROM job WHERE id < 5").fetchall() == before
    assert done_in(part) == 8 and files(part) == files(finished)
    assert "All" not in again.stdout and "most hold at -2.5, most are lost at -1.9" in again.stdout
    assert (part / "map.png").stat().st_size > 10_000


def test_a_motion_that_cannot_go_on_is_a_row_with_its_reason(monkeypatch):
    monkeypatch.setattr(integrate, "MOST_SWITCHES_PER_TURN", 2)
    asked = ("three_star", (-2.3, -2.3, 1), [300.0], (0, 7), 4)
    motions = ensemble(*asked)
    failed = [row["disturbance_seed"] for row in motions.to_pylist() if row["error"]]
    assert failed == [2, 3, 5]
    assert all("tethers chatter at" in motions["error"][seed].as_py() for seed in failed)
    assert motions["held"].null_count == 3
    (found,) = probabilities(motions)
    assert (found.held, found.lost, found.failed, found.probability) == (5, 0, 3, 1.0)
    system = scenario.load("three_star").build()
    alone = EnsembleJob(system, -2.3, 300.0, (1, 2), 4).run()
    assert alone[0].held and isinstance(alone[1], IntegrationError)


def test_a_rate_without_a_start_fails_row_by_row_and_others_do_not():
    motions = ensemble("three_star", (-2.5, 0.0, 2), [10.0], (0, 1), 2)
    rows = motions.to_pylist()
    assert [row["held"] for row in rows] == [True, True, None, None]
    assert [row["disturbance_seed"] for row in rows] == [0, 1, 0, 1]
    assert all("spin_rate_ratio" in row["error"] and "0" in row["error"] for row in rows[2:])
    kept, none = probabilities(motions)
    assert (kept.held, none.held, none.lost, none.failed) == (2, 0, 0, 2)
    assert math.isnan(none.probability) and math.isnan(none.median_turns_to_settle)


def made_up(*groups):
    """A table of motions from (rate, push, held or None of each motion)."""
    return pa.Table.from_pylist(
        [
            {"spin_rate_ratio": w, "disturbance_m": push, "held": held,
             "turns_to_settle": float(k), "deviation_from_centre": 0.01 * k}
            for w, push, motions in groups for k, held in enumerate(motions)
        ],
        SCHEMA,
    )  # fmt: skip


SCHEMA = pa.schema(
    [
        ("spin_rate_ratio", pa.float64()), ("disturbance_m", pa.float64()), ("held", pa.bool_()),
        ("turns_to_settle", pa.float64()), ("deviation_from_centre", pa.float64()),
    ]
)  # fmt: skip


def test_probabilities_are_a_hand_count_with_wilsons_interval():
    found = probabilities(
        made_up(
            (-3.0, 5.0, [True] * 7 + [False] * 2 + [None]),
            (-3.0, 9.0, [False, True, True]),
            (-2.0, 9.0, [False] * 4),
        )
    )
    assert [(f.spin_rate_ratio, f.disturbance_m) for f in found] == [(-3, 5), (-3, 9), (-2, 9)]
    assert [(f.held, f.lost, f.failed) for f in found] == [(7, 2, 1), (2, 1, 0), (0, 4, 0)]
    assert [f.median_turns_to_settle for f in found[:2]] == [3.0, 2.0]
    assert [f.largest_deviation for f in found[:2]] == [0.06, 0.02]
    z = 1.959963984540054
    for one, (k, n) in zip(found, ((7, 9), (2, 3), (0, 4))):
        p, wide = k / n, z**2 / n
        middle = (p + wide / 2) / (1 + wide)
        half = math.sqrt(p * (1 - p) * wide + wide**2 / 4) / (1 + wide)
        assert one.probability == p
        assert (one.low, one.high) == pytest.approx((middle - half, middle + half), abs=1e-12)
    assert probabilities(made_up()) == []


def test_the_title_says_where_motions_hold():
    yes, no = [True] * 4, [False] * 4
    mixed = [True, True, True, False]
    edge = [(w, push, yes if w < -2.2 else no) for w in (-3.0, -2.25, -2.15) for push in (5.0, 9.0)]
    assert story(probabilities(made_up(*edge))) == (
        "After pushes of 5, 9 m: most hold at -2.25, most are lost at -2.15"
    )
    turned = [(-w, push, motions) for w, push, motions in edge[::-1]]
    assert story(probabilities(made_up(*turned))) == (
        "After pushes of 9, 5 m: most hold at 2.25, most are lost at 2.15"
    )
    assert story(probabilities(made_up((-3.0, 5.0, yes), (-3.0, 9.0, mixed)))) == (
        "After pushes of 5 m: all hold; 9 m: 75.0% hold"
    )
    many = [(-3.0, push, yes) for push in (1.0, 2.0, 3.0)] + [(-3.0, 4.0, no)]
    assert story(probabilities(made_up(*many))) == (
        "After pushes of 1 to 3 m: all hold; 4 m: none hold"
    )
    assert story(probabilities(made_up((-3.0, 5.0, no)))) == "None of 4 disturbed motions held"
    assert story([]) == "No motion could be simulated"


def test_a_push_that_counts_as_lost_by_itself_is_warned_of():
    with pytest.warns(scenario.ImplausibleValue, match="push of 2000 m: .* more than 1155 m"):
        EnsembleQuestion("three_star", (-2.5, -2.5, 1), [10.0, 2000.0], (0, 0), 1)


@pytest.mark.parametrize(
    ("changed", "named"),
    [
        ({"pushes": [0.0]}, "push is 0 m; allowed: more than 0"),
        ({"pushes": [1e6]}, "disturbance_m is 1000000.0; allowed"),
        ({"pushes": [5.0, 5.0]}, "allowed: one or more, all different"),
        ({"pushes": []}, "allowed: one or more"),
        ({"seeds": (-1, 5)}, "disturbance_seed is -1; allowed: a whole number from 0"),
        ({"seeds": (9, 5)}, "seeds are 9 to 5"),
        ({"turns": 0}, "turns is 0; allowed: a whole number from 1 to 10000"),
        ({"rates": (-1e5, -2.0, 2)}, "spin_rate_ratio is -100000.0; allowed"),
        ({"scenario_name": "three_stars"}, "three_star"),
        ({"overrides": {"spin_rate_ratio": -2.0}}, "it cannot be overridden"),
        (
            {"scenario_name": "deploy_3_star"},
            "has reels that move or are out in part; allowed: reels at rest with all tethers out",
        ),
        ({"overrides": {"satellite": 4}}, "satellites"),
        ({"critical": True, "rates": (-2.5, -2.5, 1)}, "there is only one"),
    ],
)
def test_a_question_that_cannot_be_asked_is_refused(changed, named):
    asked = {
        "scenario_name": "three_star", "rates": (-2.5, -2.0, 2), "pushes": [10.0], "seeds": (0, 1),
        "turns": 1,
    }  # fmt: skip
    with pytest.raises(TssError) as refusal:
        EnsembleQuestion(**(asked | changed))
    assert named in str(refusal.value)


def test_jobs_are_shared_out_evenly_and_none_is_missed():
    question = EnsembleQuestion("three_star", (-2.5, -2.0, 3), [1.0, 2.0], (10, 119), 1)
    seen = [
        (job.spin_rate_ratio, job.disturbance_m, seed)
        for job in (question.job(number).job.ensemble for number in range(len(question)))
        for seed in job.seeds
    ]
    assert len(question) == 3 * 2 * math.ceil(110 / MOTIONS_PER_JOB)
    assert len(seen) == len(set(seen)) == question.motions == 3 * 2 * 110
    assert {seed for *_, seed in seen} == set(range(10, 120))


def test_canceled_it_stops_in_the_middle_of_a_job():
    asked = 0

    def cancelled():
        nonlocal asked
        asked += 1
        return asked > 5

    with pytest.raises(Cancelled):
        ensemble("three_star", (-2.5, -2.5, 1), [10.0], (0, 49), 500, cancelled=cancelled)
