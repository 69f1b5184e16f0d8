"""Sweeps that are kept on disk: killed, gone on with, refused, and the same wherever they ran."""

import os
import re
import shutil
import signal
import sqlite3
import subprocess
import sys
import threading
from contextlib import closing
from pathlib import Path

import dask_cluster
import numpy as np
import pyarrow.parquet
import pytest
import ros_harness
from ros_harness import SWEEP

import tss_ros
from tss_ros.core import Cancelled, CriticalRatesJob, FloquetJob, TssError, compute_floquet, ring
from tss_ros.scenarios import scenario
from tss_ros.sweeps import cluster, command
from tss_ros.sweeps.jobs import Question
from tss_ros.sweeps.store import Store
from tss_ros.sweeps.work import compute

#: 2 systems by 3 rates by 2 methods, and an interval each; w = 1e-4 fails, slow spin goes slack.
ARGUMENTS = (
    "three_star", "--parameter", "damping_n_s_per_m", "--values", "1000", "1450",
    "--rates", "-2.5", "1e-4", "3", "--critical", "-2.18", "-2.16",
)  # fmt: skip
TOTAL, FAILING = 14, {4, 5, 11, 12}
#: The same command, but with results put into Parquet after every third job.
EAGER = [
    sys.executable, "-c",
    "import sys; from tss_ros.sweeps import command, store; store.FLUSH_JOBS = 3;"
    "sys.exit(command.main())",
]  # fmt: skip


def question(values=(1000.0, 1450.0), rates=(-2.5, 1e-4, 3), interval=(-2.18, -2.16)):
    return Question(
        ["three_star"], "damping_n_s_per_m", list(values), rates, ["monodromy", "frozen"],
        interval, 1e-3, 0,
    )  # fmt: skip


def files(folder):
    """The bytes of all Parquet files, each of which can be read."""
    paths = sorted(folder.rglob("*.parquet"))
    assert all(pyarrow.parquet.read_table(path).num_rows for path in paths)
    return {str(path.relative_to(folder)): path.read_bytes() for path in paths}


def manifest(folder):
    """Error and processor time of every recorded job, by number."""
    if not (folder / "manifest.sqlite").exists():
        return {}
    with closing(sqlite3.connect(f"file:{folder}/manifest.sqlite?mode=ro", uri=True)) as database:
        try:
            rows = database.execute("SELECT id, error, cpu_seconds FROM job").fetchall()
        except sqlite3.OperationalError:
            return {}  # about to be made
    assert len({number for number, *_ in rows}) == len(rows)
    return {number: rest for number, *rest in rows}


@pytest.fixture(scope="module")
def dask(tmp_path_factory):
    with dask_cluster.running(tmp_path_factory.mktemp("dask"), 2) as dask:
        yield dask


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """The folder of the sweep, done in one go by one thread."""
    folder = tmp_path_factory.mktemp("finished")
    with Store(folder, question()) as store:
        compute(question(), store, 1)
    return folder


def test_tables_hold_what_the_core_computes_in_the_order_of_the_question(finished):
    rows = pyarrow.parquet.read_table(finished / "multipliers").to_pylist()
    assert [row["job"] for row in rows] == [*range(6), *range(7, 13)]
    ratios = np.linspace(-2.5, 1e-4, 3)
    for row, ratio in zip(rows, np.tile(np.repeat(ratios, 2), 2)):
        assert row["spin_rate_ratio"] == ratio and row["scenario"] == "three_star"
        if row["job"] in FAILING:
            assert "got 0.0001" in row["error"] and row["verdict"] is None
            continue
        damping = {"damping_n_s_per_m": row["damping_n_s_per_m"]}
        system = scenario.load("three_star").build(damping)
        expected = compute_floquet(system, ratio, row["method"], certify=False)
        multiplier = np.array(row["multiplier_real"]) + 1j * np.array(row["multiplier_imag"])
        np.testing.assert_array_equal(multiplier, expected.multiplier)
        np.testing.assert_array_equal(row["family"], expected.family)
        np.testing.assert_array_equal(row["position_m"], expected.state.position_m.ravel())
        assert row["tether_law"] == "kelvin_voigt"
        names = ("verdict", "max_modulus", "period_s", "switches", "flow_error", "pushing_share")
        for name in (*names, "error"):
            np.testing.assert_equal(row[name], getattr(expected, name, None))
    assert [row["damping_n_s_per_m"] for row in rows] == [1000.0] * 6 + [1450.0] * 6
    (critical,) = pyarrow.parquet.read_table(finished / "critical_rates").to_pylist()[:1]
    assert critical["cause"] == "first slack"
    assert {number for number, (error, _) in manifest(finished).items() if error} == FAILING


def test_of_many_jobs_the_motions_own_verdicts_are_counted(finished, monkeypatch):
    monkeypatch.setattr(command, "MAX_LISTED", 1)
    with Store(finished, question()) as store:
        lines = [line.split(maxsplit=1) for line in command.table(question(), store).splitlines()]
    # At -2.5 both are stable, at -1.25 no motion is found; 1e-4 fails; frozen, all seem stable.
    assert lines[:2] == [["2", "asymptotically stable"], ["2", "none found"]]
    assert all(int(count) >= 1 for count, _ in lines[2:-1])
    assert re.fullmatch(r"law kelvin_voigt, taut tethers push .* % of the time", lines[-1][1])


@pytest.mark.parametrize("workers", [2, 3])
def test_files_are_the_same_to_the_last_bit_whatever_the_workers(tmp_path, finished, workers):
    with Store(tmp_path, question()) as store:
        compute(question(), store, workers)
    assert files(tmp_path) == files(finished)


def test_files_are_the_same_to_the_last_bit_on_a_cluster(tmp_path, finished, dask):
    with Store(tmp_path, question()) as store:
        compute(question(), store, scheduler=dask.address)
    assert files(tmp_path) == files(finished)


@pytest.mark.long
def test_killed_again_and_again_it_does_only_what_is_missing(tmp_path, finished):
    before = {}
    for enough in (3, 9):
        process = subprocess.Popen([*EAGER, *ARGUMENTS, "--output", str(tmp_path)])
        try:
            ros_harness.wait_until(
                lambda: len(manifest(tmp_path)) >= enough or process.poll() is not None,  # noqa: B023, E501
                60, f"{enough} jobs",
            )  # fmt: skip
        finally:
            process.kill()
            process.wait()
        after = manifest(tmp_path)
        files(tmp_path)
        assert before.items() <= after.items()
        before = after
    assert len(before) >= 9
    done = subprocess.run(
        [*SWEEP, *ARGUMENTS, "--output", str(tmp_path)],
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert done.returncode == 1 and "4 of 14 jobs failed" in done.stderr, done.stderr
    assert before.items() <= manifest(tmp_path).items()
    assert manifest(tmp_path).keys() == set(range(TOTAL))
    assert files(tmp_path) == files(finished)
    assert not list(tmp_path.rglob(".part*")) and (tmp_path / "map.png").exists()


def test_a_worker_killed_in_the_middle_costs_nothing(tmp_path, finished, dask):
    (victim,) = dask.add_workers(1)
    told = []

    def on_job():
        told.append(victim.running)
        if len(told) == 3:
            victim.send(signal.SIGKILL)

    with Store(tmp_path, question()) as store:
        compute(question(), store, scheduler=dask.address, on_job_done=on_job)
    assert victim.wait(10) == -signal.SIGKILL
    assert len(told) == TOTAL and manifest(tmp_path).keys() == set(range(TOTAL))
    assert files(tmp_path) == files(finished)


def test_failures_are_run_again_only_when_asked(tmp_path, finished):
    shutil.copytree(finished, tmp_path, dirs_exist_ok=True)
    before = manifest(tmp_path)
    with Store(tmp_path, question()) as store:
        assert store.missing(TOTAL) == [] and store.failed == len(FAILING)
        store.forget_failures()
        assert store.missing(TOTAL) == sorted(FAILING)
        compute(question(), store, 2)
    after = manifest(tmp_path)
    assert {number for number in after if after[number] != before[number]} == FAILING
    assert files(tmp_path) == files(finished)


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ({"rates": (-2.5, 0.0, 7)}, "rates is [-2.5, 0.0001, 3] there and [-2.5, 0.0, 7] here"),
        ({"values": (1000.0,)}, "values is [1000.0, 1450.0] there and [1000.0] here"),
        ({"interval": None}, "critical is [-2.18, -2.16] there and null here"),
    ],
)
def test_another_question_is_refused_and_what_differs_is_named(finished, options, named):
    before = files(finished)
    with pytest.raises(TssError) as refusal, Store(finished, question(**options)):
        pass
    assert named in str(refusal.value) and files(finished) == before


def test_another_core_or_system_is_another_question(tmp_path, finished, monkeypatch):
    changed = question()
    changed.description["version of core"] = "other"
    with pytest.raises(TssError, match='version of core is .* there and "other" here'):
        Store(finished, changed)
    changed = question()
    changed.description["scenario three_star"] += "satellites: 4"
    with pytest.raises(TssError, match="scenario three_star is another one"):
        Store(finished, changed)


def test_a_folder_in_use_and_a_file_that_is_no_manifest_are_refused(tmp_path, finished):
    with Store(finished, question()), pytest.raises(TssError, match="another sweep is at work in"):
        Store(finished, question())
    (tmp_path / "manifest.sqlite").write_text("something else entirely " * 99)
    with pytest.raises(TssError, match="manifest.sqlite: file is not a database"):
        Store(tmp_path, question())


LONG = [CriticalRatesJob(ring(), -2.1, -1.1, 1e-5)] * 8


def test_canceled_workers_stop_in_the_middle_of_a_job(dask):
    stop = threading.Event()
    timer = threading.Timer(1.0, stop.set)
    timer.start()
    with pytest.raises(Cancelled):
        list(cluster.sweep(LONG, dask.address, stop.is_set))
    # Each worker has one thread: only if that is free again does this end before its deadline.
    found = []
    job = FloquetJob(ring(), -2.5)
    quick = threading.Thread(
        target=lambda: found.extend(cluster.sweep([job], dask.address)), daemon=True
    )
    quick.start()
    quick.join(5.0)
    assert found[0][1].verdict == "asymptotically stable"


def test_a_worker_with_another_core_is_named(tmp_path, dask):
    copy = tmp_path / "tss_ros"
    shutil.copytree(Path(tss_ros.__file__).parent, copy)
    with (copy / "core" / "stability" / "parallel.py").open("a") as file:
        file.write("# another core\n")
    with dask_cluster.running(tmp_path, 0) as other:
        with pytest.raises(TssError, match=f"{other.address} has no worker"):
            list(cluster.sweep([FloquetJob(ring(), -2.5)], other.address))
        path = f"{tmp_path}:{os.environ.get('PYTHONPATH', '')}"
        other.add_workers(1, env={**os.environ, "PYTHONPATH": path})
        with pytest.raises(TssError, match="other software: core is .* there and .* here"):
            list(cluster.sweep([FloquetJob(ring(), -2.5)], other.address))


def test_a_worker_without_the_package_is_named(tmp_path):
    """Not waited for: it would die of the first job."""
    broken = tmp_path / "broken" / "tss_ros"
    broken.mkdir(parents=True)
    (broken / "__init__.py").write_text("raise ImportError('it is not here')")
    with dask_cluster.running(tmp_path, 0) as own:
        path = f"{broken.parent}:{os.environ.get('PYTHONPATH', '')}"
        (worker,) = own.add_workers(1, env={**os.environ, "PYTHONPATH": path})
        for _ in range(2):
            with pytest.raises(TssError, match="worker at .* cannot import tss_ros: .*it is not"):
                list(cluster.sweep([FloquetJob(ring(), -2.5)], own.address))
        assert worker.running


@pytest.mark.long
def test_a_cluster_that_loses_all_its_workers_is_given_up(tmp_path, monkeypatch, caplog):
    monkeypatch.setattr(cluster, "NO_WORKER_S", 2.0)
    with dask_cluster.running(tmp_path, 1) as own:
        outcomes = cluster.sweep([FloquetJob(ring(), -2.5)] + LONG, own.address)
        assert next(outcomes)[0] == 0
        own.workers[0].kill()
        with pytest.raises(TssError, match=f"{own.address} has had no worker for 2 s"):
            list(outcomes)
    assert "has lost all its workers; waiting for one, at most 2 s" in caplog.text


def test_nothing_of_a_cluster_is_reached_from_outside(dask):
    """Neither scheduler and workers nor their HTTP servers, by the options that the docs show."""
    documented = (Path(__file__).parents[2] / "docs/howto/large_sweeps.md").read_text()
    assert documented.count("--host 127.0.0.1 --dashboard-address 127.0.0.1:0") == 1
    assert documented.count("$LOCAL") == 2
    alive = [process for process in dask.workers if process.running]
    assert alive  # another test kills one
    for process in (dask.scheduler, *alive):
        rows = ros_harness.sockets_of(process.pid, "tcp")
        listening = [row[1] for row in rows if row[3] == "0A"]
        assert len(listening) >= 2
        assert [a for a in listening if not a.startswith("0100007F:")] == []


def test_a_scheduler_that_is_lost_is_named_and_what_is_done_is_kept(tmp_path, monkeypatch):
    monkeypatch.setattr(cluster, "CONNECT_S", 1.0)
    with dask_cluster.running(tmp_path, 1) as own:
        told = iter([own.scheduler.kill])
        with (
            Store(tmp_path / "kept", question()) as store,
            pytest.raises(TssError, match=f"scheduler at {own.address} is lost"),
        ):
            compute(question(), store, scheduler=own.address, on_job_done=lambda: next(told, int)())
        assert 1 <= len(manifest(tmp_path / "kept")) < TOTAL
        with pytest.raises(TssError, match=f"no Dask scheduler answers at {own.address}"):
            list(cluster.sweep([], own.address))
    with pytest.raises(TssError, match="scheduler is 'localhost'; allowed: tcp://HOST:PORT"):
        list(cluster.sweep([], "localhost"))
