"""What a million orbits cost: processor time by regime, failures, bytes on disk, and Dask's share.

    . ./activate && python benchmarks/large_sweeps.py [--rates 25]

Prints what docs/howto/large_sweeps.md shows. Processor time is that of the threads that did the
jobs: on a busy machine it stays about the same, whereas what is done a second of wall time does
not.
"""

import argparse
import contextlib
import re
import sqlite3
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import psutil

from tss_ros.core import sweep
from tss_ros.sweeps import cluster
from tss_ros.sweeps.jobs import Question
from tss_ros.sweeps.store import Store
from tss_ros.sweeps.work import compute

#: Taut formations spin fast; slower than their critical rate tethers go slack.
FAST, SLOW = (-6.0, -3.3), (-2.0, -0.5)
REGIMES = [
    *(("three_star", damping, rates) for damping in (1, 100, 1450, 2000) for rates in (FAST, SLOW)),
    *((name, 1450, rates) for name in ("four_star", "six_star", "chain") for rates in (FAST, SLOW)),
    *(("six_bead", 1450, rates) for rates in (FAST, SLOW)),
]
MILLION = 1_000_000


@dataclass(frozen=True)
class Nothing:
    """A job that costs nothing."""

    def run(self, cancelled=None):
        """Do nothing."""


def question(name, damping, rates, count):
    """A sweep of the true multipliers only."""
    return Question(
        [name], "damping_n_s_per_m", [float(damping)], (*rates, count), ["monodromy"], None, 1e-3, 0
    )


def regimes(count):
    """A row of the first table for each regime."""
    print(
        "| formation | C [N s/m] | rates | ms per orbit: median | mean | largest | errors |"
        " none found | slack | core hours for a million |"
    )
    print("|---|---:|---|" + 7 * "---:|")
    for name, damping, rates in REGIMES:
        asked = question(name, damping, rates, count)
        with tempfile.TemporaryDirectory() as folder, Store(Path(folder), asked) as store:
            compute(asked, store)
            store.flush()
            with contextlib.closing(sqlite3.connect(Path(folder) / "manifest.sqlite")) as manifest:
                spent = np.array(manifest.execute("SELECT cpu_seconds FROM job").fetchall())
            rows = store.table("multipliers", ["verdict", "switches", "error"]).to_pylist()
            failed = store.failed
        none = sum(row["verdict"] == "none found" for row in rows)
        slack = sum(bool(row["switches"]) for row in rows)
        mean = spent.mean()
        print(
            f"| {name} | {damping} | {rates[0]:g} to {rates[1]:g} | {1e3 * np.median(spent):.1f} |"
            f" {1e3 * mean:.1f} | {1e3 * spent.max():.0f} | {failed / count:.0%} |"
            f" {none / count:.0%} | {slack / count:.0%} | {mean * MILLION / 3600:.1f} |",
            flush=True,
        )


def on_disk(count):
    """What so many orbits of the 3-star leave in a folder, and what recording them costs."""
    asked = question("three_star", 1450, FAST, count)
    with tempfile.TemporaryDirectory() as folder:
        with Store(Path(folder), asked) as store:
            begun = time.perf_counter()
            compute(asked, store)
            alone = list(sweep([asked.job(0)], 1))[0][1]
            took = time.perf_counter() - begun
        results = sum(path.stat().st_size for path in Path(folder).rglob("*.parquet"))
        with contextlib.closing(sqlite3.connect(Path(folder) / "manifest.sqlite")) as manifest:
            size, pages, free = (
                manifest.execute(f"PRAGMA {name}").fetchone()[0]
                for name in ("page_size", "page_count", "freelist_count")
            )
    print(f"\n{count} orbits of the 3-star, taut: {count / took:.0f} a second in threads")
    print(f"Parquet: {results / count:.0f} bytes per orbit")
    kept, passing = size * (pages - free) / count, size * free / count
    print(f"manifest: {kept:.0f} bytes per orbit, {passing:.0f} for one on its way to Parquet")
    with tempfile.TemporaryDirectory() as folder, Store(Path(folder), asked) as store:
        begun = time.thread_time()
        for number in range(count):
            store.record(number, *alone)
        store.flush()
        print(f"recording: {1e6 * (time.thread_time() - begun) / count:.0f} us of processor time")


@contextlib.contextmanager
def dask(workers):
    """The address of a scheduler with so many workers of one thread, all on the loopback."""
    local = ("--host", "127.0.0.1", "--no-dashboard")
    started = []

    def start(*command):
        started.append(
            subprocess.Popen(
                [sys.executable, "-m", "dask", *command, *local],
                stderr=subprocess.PIPE,
                text=True,
                cwd=folder,
            )  # fmt: skip
        )
        return started[-1]

    with tempfile.TemporaryDirectory() as folder:
        try:
            scheduler = start("scheduler", "--port", "0", "--no-show")
            address = next(
                found[1]
                for line in scheduler.stderr
                if (found := re.search(r"Scheduler at: +(\S+)", line))
            )
            for _ in range(workers):
                worker = start("worker", address, "--nthreads", "1", "--no-nanny")
                next(line for line in worker.stderr if "Registered to:" in line)
            yield address
        finally:
            for process in reversed(started):
                process.kill()
                process.wait()


def overhead(count):
    """What Dask adds to a job: alone in its batch, in batches, and to real ones."""
    with dask(2) as address:
        list(cluster.sweep([Nothing()] * 10, address))
        batch_s = cluster.BATCH_S
        for text, jobs, cluster.BATCH_S in (
            ("each in a batch of its own", count, 0.0),
            ("in batches", 50 * count, batch_s),
        ):
            begun = time.perf_counter()
            list(cluster.sweep([Nothing()] * jobs, address))
            each = (time.perf_counter() - begun) / jobs
            print(f"Dask, empty jobs {text}: {1e3 * each:.3f} ms per job")
        asked = question("three_star", 1450, FAST, count)
        jobs = [asked.job(number) for number in range(count)]
        list(cluster.sweep(jobs[:20], address))
        for text, run in (
            ("Dask, 2 workers", lambda: list(cluster.sweep(jobs, address))),
            ("2 threads", lambda: list(sweep(jobs, 2))),
        ):
            before, begun = processor_s(), time.perf_counter()
            in_jobs = sum(cpu_s for _, (_, _, cpu_s) in run())
            each = (time.perf_counter() - begun) / count
            beside = processor_s() - before - in_jobs
            print(
                f"{text}: {1 / each:.0f} orbits a second; processor time in a job"
                f" {1e3 * in_jobs / count:.1f} ms, beside it {1e3 * beside / count:.1f} ms"
            )


def processor_s():
    """Processor time [s] of this process and those it started."""
    own = psutil.Process()
    times = [process.cpu_times() for process in (own, *own.children(recursive=True))]
    return sum(t.user + t.system for t in times)


def main():
    """Print everything."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rates", type=int, default=25, help="of each regime")
    parser.add_argument("--count", type=int, default=1000, help="of the taut 3-star")
    options = parser.parse_args()
    regimes(options.rates)
    on_disk(options.count)
    overhead(options.count)


if __name__ == "__main__":
    main()
