"""The benchmarks' own machinery; nothing here is timed."""

import json
import sys

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from benchmarks import (
    ensemble,
    heyoka_peer,
    peers,
    problems,
    processes,
    references,
    report,
    solvers,
    worker,
)
from tss_ros.core import initial_state
from tss_ros.core.motion.integrator import Integrator
from tss_ros.core.stability.shooting import closure


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


@pytest.mark.parametrize("name", ["A100", "B1", "30 beads", "chain", "pyramid"])
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
        distances = kept[name].get("matrix_distance", kept[name]["distance"])
        apart = {k: d for k, d in distances.items() if "80 bits" in k or "CVODE" in k}
        assert all(distance < problems.MOTION_ERROR for distance in apart.values()), name


@pytest.mark.parametrize("name", [*problems.OTHER_MOTIONS, *problems.OTHER_TURNS])
def test_other_formations_and_orbits_agree_with_an_independent_integrator_to_1e_9(name):
    """heyoka in inertial axes, 80 bits, beside the centre's orbit; computed when it was stored."""
    problem, kept = problems.Problem(name), references.stored()[name]
    assert kept["source"].startswith("heyoka, inertial, 80 bits")
    if name in problems.OTHER_TURNS:
        matrix = solvers.our_monodromy(problem, 1e-12)()
        assert references.matrices_apart(matrix, kept["matrix"]) < 1e-9
    else:
        assert references.apart(problem, kept, solvers.ours(problem, 1e-12)()) < 1e-9


@pytest.mark.parametrize("name", ["ellipse", "inclined J2"])
def test_the_orbit_beside_the_beads_is_integrated_from_the_elements_alone(name):
    """Start and end in the orbit frame by heyoka's side, against the core's own orbit."""
    problem = problems.Problem(name)
    q, v = (np.array(x) for x in heyoka_peer.centre(problem, float))
    np.testing.assert_allclose(q, problem.reference.state(np.zeros(1))[0][0], atol=1e-8)
    np.testing.assert_allclose(v, problem.reference.state(np.zeros(1))[1][0], atol=1e-11)
    x = heyoka_peer._inertial_start(problem, float)
    r, v = heyoka_peer._from_inertial(problem, float, x)
    np.testing.assert_allclose(r, problem.start.position_m, atol=1e-9)
    np.testing.assert_allclose(v, problem.start.velocity_m_s, atol=1e-12)
    axes, turning = heyoka_peer._between_frames(problem, float, x[-6:])
    wanted_axes, wanted = problem.reference.frame(np.zeros(1))
    np.testing.assert_allclose(axes, wanted_axes[0], atol=1e-15)
    np.testing.assert_allclose(turning, wanted[0], atol=1e-16)


def test_the_dumbbell_of_the_ellipse_librates_and_closes():
    """In a closed motion ends meet but for the drift of the centre."""
    problem = problems.Problem("ellipse turn")
    missed = closure(Integrator(problem.system, 0.0, 1e-12, problem.radius), problem.start)
    change = missed.difference.reshape(2, 2, 3)
    apart = change[:, 0] - change[:, 1]
    assert np.abs(apart).max() < 1e-9 < np.abs(change.sum(axis=1)).max()


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
    cases = {"chain": {solvers.OURS: measured, "heyoka, inertial": slower}}
    results["formations"] = {"cases": cases, "machine": about}
    row = {"per_s": 1000.0, "per_processor_s": 1234.5}
    failed = {"note": "not accurate enough"}
    cases = {"A1": {"one": row, "other": row}, "B1": {"one": row, "other": failed}}
    results["ensemble"] = {"count": 7, "cases": cases, "machine": about}
    report.write(results, tmp_path)
    text = (tmp_path / "benchmarks.md").read_text()
    assert "2 times faster than the next, CVODE BDF" in text and "wrong: 5e-01" in text
    assert "B100: not solved to this error here; first is CVODE BDF" in text
    told = references.stored()["chain"]["distance"]["ours, nine stages, 1e-13"]
    assert f"afresh: chain {told:.0e}." in text and "* chain: 2 times faster" in text
    assert "| other | 1000 / 1234 | not accurate enough |" in text
    assert (tmp_path / "benchmarks.png").stat().st_size > 10_000
    assert worker.solvers_of("A2000") is solvers.MOTION
