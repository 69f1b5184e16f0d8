"""The integrator of this checkout beside that of another revision, in one run.

    python -m benchmarks.against REVISION [--cases A1 B100 ...] [--rounds N]

checks the revision out into a temporary folder, compiles both cores, lets the two run each case in
turns, pair by pair, and prints the ratio of their processor times and whether they gave the same
numbers, bit for bit.
"""

import argparse
import contextlib
import hashlib
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parent.parent
CASES = (
    *("A1", "A100", "A2000", "B1", "B100", "B2000", "6-bead"),
    *("30 beads", "100 beads", "300 beads"),
    *("M2000", "M100", "M1", "S2000", "S100", "S1", "6-bead turn", "30 beads turn"),
)
TOLERANCE = 1e-10
#: Shortest time [s] that one of a pair takes: quick cases run several times.
LEAST_S = 0.05


def work():
    """Run cases as they are named on standard input; a line of JSON for each."""
    from benchmarks import problems, solvers, worker

    runs = {}
    for line in sys.stdin:
        case = line.strip()
        if case not in runs:
            ours = worker.solvers_of(case)[solvers.OURS]
            run = ours.make(problems.Problem(case), TOLERANCE)
            result = run()
            begun = time.process_time()
            run()
            once = time.process_time() - begun
            digest = hashlib.sha256(b"".join(np.ascontiguousarray(x) for x in result)).hexdigest()
            runs[case] = run, max(1, int(LEAST_S / max(once, 1e-6))), digest
        run, times, digest = runs[case]
        begun = time.process_time()
        for _ in range(times):
            run()
        print(json.dumps([(time.process_time() - begun) / times, digest]), flush=True)


@contextlib.contextmanager
def worker(tree):
    """A function that runs a case with the core and the benchmarks of a tree."""
    environment = {**os.environ, "PYTHONPATH": str(tree)}
    command = [sys.executable, "-c", f"import runpy; runpy.run_path({__file__!r})['work']()"]
    process = subprocess.Popen(
        command, cwd=tree, env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )

    def run(case):
        print(case, file=process.stdin, flush=True)
        return json.loads(process.stdout.readline())

    try:
        yield run
    finally:
        process.stdin.close()
        process.wait()


@contextlib.contextmanager
def checked_out(revision):
    """A folder with the files of a revision."""
    with tempfile.TemporaryDirectory() as folder:
        archive = subprocess.run(
            ["git", "archive", revision], cwd=ROOT, check=True, stdout=subprocess.PIPE
        ).stdout
        subprocess.run(["tar", "-x", "-C", folder], input=archive, check=True)
        yield Path(folder)


def main():
    """Compare, printing a row a case."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.against")
    parser.add_argument("revision", help="that this checkout is compared with")
    parser.add_argument("--cases", nargs="+", default=CASES, metavar="CASE")
    parser.add_argument("--rounds", type=int, default=9, help="pairs of each case")
    options = parser.parse_args()
    print(f"{'case':12} {'there':>9} {'here':>9} {'here / there':>13}   same bits")
    with checked_out(options.revision) as tree, worker(tree) as there, worker(ROOT) as here:
        for case in options.cases:
            there(case), here(case)
            pairs = [(there(case), here(case)) for _ in range(options.rounds)]
            old, new = ([pair[i][0] for pair in pairs] for i in range(2))
            ratio = statistics.median(b / a for a, b in zip(old, new))
            same = pairs[0][0][1] == pairs[0][1][1]
            milliseconds = (f"{1e3 * min(x):6.3f} ms" for x in (old, new))
            print(f"{case:12} {' '.join(milliseconds)} {ratio:13.3f}   {'yes' if same else 'NO'}",
                  flush=True)


if __name__ == "__main__":
    main()
