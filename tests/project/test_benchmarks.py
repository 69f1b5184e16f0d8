"""The benchmarks' own machinery; nothing here is timed."""

import json
import sys

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from benchmarks import ensemble, peers, problems, processes, references, report, solvers, worker
from tss_ros.core import initial_state


@pytest.fixture(scope="module")
def measured():
    """What a process of its own tells of this package's motion A2000."""
    return processes.measured(sys.executable, "A2000", solvers.OURS, limit_s=120.0)


def test_a_solver_is_measured_in_a_process_of_its_own(measured):
    assert 0.0 < measured["error"] <= problems.MOTION_ERROR
    assert 0.0 < measured["ms"] < 1e3 * measured["first_answer_s"]


def test_a_solver_that_hangs_is_ended_and_said_so():
    found = processes.measured(sys.executable, "B100", "scipy Radau, numpy", limit_s=0.5)
    assert found["note"] == "> 0.5 s" and "ms" not in found


def test_a_solver_that_fails_says_why():
    found = processes.measured(sys.executable, "A1", "heyoka, orbit frame", limit_s=60.0)
    assert "heyoka" in found["note"]


@pytest.mark.parametrize("name", ["A100", "B1", "30 beads"])
def test_the_stored_references_are_those_of_an_independent_solver(name):
    """On a stretch as short as DOP853 takes for it: the frames, starts and scales agree."""
    problem = problems.Problem(name)
    problem.end_s *= 1e-3
    problem.turns *= 1e-3
    result = solvers.ours(problem, 1e-10)()
    other = peers.scipy_numpy(problem, 1e-10, "DOP853")()
    assert problem.distance(result, other) < 1e-8


def test_a_wrong_reference_is_noticed():
    problem, kept = problems.Problem("A2000"), references.stored()["A2000"]
    result = solvers.ours(problem, 1e-9)()
    assert references.apart(problem, kept, result) < 1e-8
    kept["position_m"][0][0] += 1e-3 * problem.radius
    assert references.apart(problem, kept, result) == pytest.approx(1e-3, rel=1e-3)


def test_every_case_has_a_reference_and_the_two_of_each_agree():
    kept = references.stored()
    for name in problems.CASES:
        apart = {k: d for k, d in kept[name]["distance"].items() if "80 bits" in k or "CVODE" in k}
        assert all(distance < problems.MOTION_ERROR for distance in apart.values()), name


def test_matrices_of_both_frames_are_scaled_alike():
    """A matrix exp(A t) of a free particle in the orbit frame is a Coriolis motion in the other."""
    problem = problems.Problem("M2000")
    problem.system = type("One", (), {"n": 3})()
    time, spin = 2.0 * np.pi / abs(problem.spin), problem.spin
    orbit = np.eye(18)
    orbit[9:, :9] = time * np.eye(9)

    def turning(_, x):
        v, r = x[:2], x[2:]
        return [*(2.0 * spin * np.array([v[1], -v[0]]) + spin**2 * r), *v]

    end = solve_ivp(turning, (0.0, time), [0.0, 0.0, 1.0, 0.0], rtol=1e-11, atol=1e-14).y[:, -1]
    found = problem.scaled(orbit, "orbit")[[0, 1, 9, 10], 9]
    np.testing.assert_allclose(
        found,
        end
        * [1 / problem.speed, 1 / problem.speed, 1, 1]
        / [1 / problem.radius, 1 / problem.radius, 1, 1],
        atol=1e-8,
    )


def test_motions_of_an_ensemble_are_those_of_each_by_itself():
    """In one call, on threads and one after another; each start is disturbed as much."""
    problem = ensemble.one_turn("B1")
    x = ensemble.starts(problem, "B1", 5)
    offset = x[:, 1] - initial_state(problem.system, -2.2).position_m
    np.testing.assert_allclose(np.linalg.norm(offset, axis=(1, 2)), 10.0)
    one = ensemble.ours(problem, 1e-10, x, None)()
    for threads in (1, 2):
        many = ensemble.ours_at_once(problem, 1e-10, x, None, threads)()
        assert ensemble.distances(problem, many, one).max() < 1e-12


def test_a_report_names_the_quickest_that_is_right(measured, tmp_path):
    about = {
        "date": "today",
        "processor": "p",
        "cores": 2,
        "python": "3",
        "load": [0.0],
        "load_after": [0.0],
        "took_s": 1.0,
        "versions": {"numpy": "2"},
    }
    slower = {**measured, "ms": 2.0 * measured["ms"]}
    wrong = {**measured, "ms": 0.1 * measured["ms"], "wrong": True, "matrix_error": 0.5}
    failed = {"note": "not accurate enough", "error": 2e-7, "tolerance": 1e-13}
    cases = {
        "B100": {solvers.OURS: failed, "CVODE BDF": slower},
        "A2000": {solvers.OURS: measured, "CVODE BDF": slower, "CyRK Radau": wrong},
    }
    results = json.loads(json.dumps({"motion": {"cases": cases, "machine": about}}))
    row = {"per_s": 1000.0, "per_processor_s": 1234.5}
    failed = {"note": "not accurate enough"}
    cases = {"A1": {"one": row, "other": row}, "B1": {"one": row, "other": failed}}
    results["ensemble"] = {"count": 7, "cases": cases, "machine": about}
    report.write(results, tmp_path)
    text = (tmp_path / "benchmarks.md").read_text()
    assert "2 times faster than the next, CVODE BDF" in text and "wrong: 5e-01" in text
    assert "B100: not solved to this error here; first is CVODE BDF" in text
    assert "| other | 1000 / 1234 | not accurate enough |" in text
    assert (tmp_path / "benchmarks.png").stat().st_size > 10_000
    assert worker.solvers_of("A2000") is solvers.MOTION
