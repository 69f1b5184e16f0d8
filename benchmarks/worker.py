"""Measures one solver on one case, in a process of its own that can be ended from outside.

    python -m benchmarks.worker CASE SOLVER BEGUN

prints one JSON object a line: what each tolerance gave, and at last what counts. BEGUN is the time
(`time.time()`) at which the process was started, for the time to its first answer.
"""

import json
import os
import sys
import time

import numpy as np

from benchmarks import problems, solvers
from benchmarks.references import matrices_apart, stored

#: A matrix further than this from the reference, relative to its largest entry, is wrong.
MATRIX_ERROR = 1e-5
#: Timed runs of a solver: at least three unless one takes LONG_S, more while they take less than
#: ENOUGH_S together.
ENOUGH_S, LONG_S, MOST_RUNS = 0.3, 10.0, 50


def solvers_of(case):
    """The solvers that a case is measured with."""
    for cases, table in (
        (problems.MOTIONS, solvers.MOTION),
        (problems.LAW_MOTIONS, solvers.LAW_MOTION),
        (problems.FORMATION_MOTIONS, solvers.FORMATION_MOTION),
        (problems.ORBIT_MOTIONS, solvers.ORBIT_MOTION),
        (problems.LONG_MOTIONS, solvers.LONG_MOTION),
        (problems.TURNS, solvers.MONODROMY),
        (problems.FORMATION_TURNS, solvers.FORMATION_MONODROMY),
        (problems.ORBIT_TURNS, solvers.ORBIT_MONODROMY),
        (problems.LONG_TURNS, solvers.LONG_MONODROMY),
    ):
        if case in cases:
            return table
    raise KeyError(case)


def judge(problem, result, reference):
    """Errors of a result: of a motion its distance, of a matrix largest modulus and itself."""
    if isinstance(result, tuple):
        return {"error": problem.distance(result, (reference["position_m"], reference["velocity"]))}
    wanted = reference["modulus"]
    errors = {"error": abs(problems.largest_modulus(result) - wanted) / max(1.0, wanted)}
    if "matrix" in reference:
        errors["matrix_error"] = matrices_apart(result, reference["matrix"])
    return errors


def search(solver, problem, reference, tell):
    """The loosest tolerance whose error is small enough, to half a decade, and its run."""
    goal = problems.MODULUS_ERROR if "modulus" in reference else problems.MOTION_ERROR
    found, last = None, None

    def attempt(exponent):
        tolerance = 10.0**-exponent
        run = solver.make(problem, tolerance, **solver.options)
        begun = time.perf_counter()
        result = run()
        seconds = time.perf_counter() - begun
        switches = getattr(run, "switches", None)
        errors = judge(problem, result, reference)
        tell(tolerance=tolerance, first_run_s=seconds, switches=switches, **errors)
        return run, {"tolerance": tolerance, "switches": switches, **errors}

    def accurate(outcome):
        return outcome["error"] <= goal and outcome.get("matrix_error", 0.0) <= MATRIX_ERROR

    for exponent in range(solver.loosest, solver.tightest + 1):
        run, outcome = attempt(exponent)
        if accurate(outcome):
            found = run, outcome
            break
        if "matrix_error" in outcome and not solver.events:
            if last and outcome["matrix_error"] > 0.5 * last["matrix_error"]:
                return run, {**outcome, "wrong": True}  # no tolerance mends it
            last = outcome
    if found and exponent > solver.loosest:
        run, outcome = attempt(exponent - 0.5)
        if accurate(outcome):
            return run, outcome
    return found or (None, outcome)


def main(case, name, begun):
    """Measure, telling every step."""

    def tell(**what):
        if first:
            what["first_answer_s"] = time.time() - begun
            first.clear()
        print(json.dumps(what), flush=True)

    first = [True]
    problem, reference = problems.Problem(case), stored()[case]
    if os.environ.get("BENCHMARKS_COLD"):
        solver = solvers_of(case)[name]
        solver.make(problem, 1e-10, **solver.options)()
        tell()
        return
    run, outcome = search(solvers_of(case)[name], problem, reference, tell)
    if run is None:
        tell(note="not accurate enough", **outcome)
        return
    times = []
    while len(times) < 3 or (sum(times) < ENOUGH_S and len(times) < MOST_RUNS):
        start = time.perf_counter()
        run()
        times.append(time.perf_counter() - start)
        if times[-1] > LONG_S:
            break
    tell(ms=1e3 * min(times), median_ms=1e3 * float(np.median(times)), runs=len(times), **outcome)


if __name__ == "__main__":
    try:
        main(sys.argv[1], sys.argv[2], float(sys.argv[3]))
    except Exception as failure:
        print(json.dumps({"note": " ".join(f"{type(failure).__name__}: {failure}".split())[:100]}))
