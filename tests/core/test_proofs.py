"""What every result carries as its proof, and the symmetry, bounds and sweeps of the analysis."""

import math
import threading
from dataclasses import replace

import numpy as np
import pytest

from tss_ros.core import (
    Cancelled,
    ConfirmationJob,
    CriticalRatesJob,
    FloquetJob,
    Propagator,
    TssError,
    compute_floquet,
    follow,
    formation,
    initial_state,
    ring,
    sweep,
)
from tss_ros.core.model.frames import rigid_velocity
from tss_ros.core.model.symmetry import cyclic_symmetry
from tss_ros.core.motion.integrator import Integrator
from tss_ros.core.stability.proofs import liouville_error, segment_error
from tss_ros.core.stability.shooting import integrate_turn
from tss_ros.scenarios import scenario


@pytest.mark.parametrize(
    "system, w, fewest_switches",
    [
        (ring(), -2.5, 0),
        (ring(damping_n_s_per_m=100.0), -2.5, 5),
        (ring(), -2.14, 10),
        (ring(damping_n_s_per_m=1.0), -2.569, 10),
        (formation("chain", 3), -1.95, 1),
        (formation("hub_and_spoke", 4), -3.0, 0),
        (formation("chain", 3), -3.0, 0),
    ],
    ids=["taut", "C 100", "slack", "C 1, slack", "chain, slack", "hub", "chain"],
)
def test_every_matrix_proves_itself_through_slack_too(system, w, fewest_switches):
    start = None
    if system.m < system.n:
        # The straight chain, which is not on the own family any more.
        fast = initial_state(system, -3.5)
        start = follow(system, "spin_rate_ratio", -3.5, w, state=fast).points[-1].state
    result = compute_floquet(system, w, state=start)
    assert result.switches >= fewest_switches
    largest = max(1.0, result.max_modulus)
    assert result.segment_error < 1e-6 * largest
    assert result.convergence_error < 1e-6 * largest
    assert result.liouville_error < 1e-6
    assert result.det_z_error < 1e-6
    assert result.flow_error < 1e-6 * largest


def test_the_proofs_fail_where_they_should():
    system = ring(damping_n_s_per_m=100.0)
    result = compute_floquet(system, -2.5, certify=False)
    latest = integrate_turn(Integrator(system, result.spin_rate_rad_s, 1e-9, 5773.0), result.state)
    assert segment_error(latest, np.isfinite) < 1e-3
    wrong = replace(latest, matrix=latest.matrix * 1.01)
    assert segment_error(wrong, np.isfinite) > 5e-3
    loose = Integrator(system, result.spin_rate_rad_s, 1e-3, 5773.0)
    assert liouville_error(replace(latest, integrator=loose)) > 10 * liouville_error(latest)


@pytest.mark.parametrize(
    "system, order",
    [
        (ring(), 3),
        (ring(5, beads_per_tether=2), 5),
        (formation("hub_and_spoke", 4), 4),
        (formation("chain", 3), 2),
        (formation("double_pyramid", 4), 4),
        (ring(satellite_mass_kg=[100.0, 100.0, 101.0]), 1),
        (ring(4, satellite_mass_kg=[100.0, 90.0, 100.0, 90.0]), 2),
        (ring(damping_n_s_per_m=[1000.0, 1000.0, 1500.0]), 1),
    ],
)
def test_symmetry_is_that_of_equal_parts(system, order):
    assert cyclic_symmetry(system).order == order


@pytest.mark.parametrize("w", [-3.0, 1.5])
def test_equal_satellites_follow_each_other(w):
    """After a third of the turn each is where another began; found by simulation alone."""
    system = ring(damping_n_s_per_m=0.0)
    result = compute_floquet(system, w, certify=False)
    assert result.closure_residual < 1e-6
    position, _ = Propagator(system, w, result.state).sample(np.array([result.period_s / 3]))
    apart = np.linalg.norm(position[0][:, None] - result.state.position_m[None], axis=2)
    assert sorted(np.argmin(apart, axis=1)) == [0, 1, 2]
    assert np.all(np.argmin(apart, axis=1) != np.arange(3))
    assert np.min(apart, axis=1).max() < 1e-2  # of 5773 m


def test_symmetry_finds_motions_that_start_far_from_closing():
    """A hexagon swings through its rest shape; the paper's start misses its motion by far."""
    result = compute_floquet(ring(6), -2.9, certify=False)
    assert result.initial_closure_residual > 0.1
    start = initial_state(ring(6), -2.9)
    position, velocity = Propagator(ring(6), -2.9, start).sample(np.array([result.period_s]))
    position, velocity = position[0] - start.position_m, velocity[0] - start.velocity_m_s
    velocity -= rigid_velocity(position, result.spin_rate_rad_s)
    size = np.max(np.linalg.norm(start.position_m, axis=1))
    missed_by = np.hypot(
        np.linalg.norm(position) / size,
        np.linalg.norm(velocity) / (size * abs(result.spin_rate_rad_s)),
    )
    assert abs(result.initial_closure_residual / missed_by - 1.0) < 1e-6
    assert result.closure_residual < 1e-4
    assert result.verdict == "neutral"


def test_no_motion_is_a_verdict_that_says_what_was_tried():
    result = compute_floquet(ring(damping_n_s_per_m=1.0), -2.5)
    assert result.verdict == "none found"
    assert result.multiplier.size == 0 and result.family == ()
    assert "own family: no motion was found next to that at -2.56" in result.message
    assert "Eqs. 50-51" in result.message and "averaged gravity gradient" in result.message
    assert math.isnan(result.max_modulus)


def test_a_matrix_that_proves_chaotic_is_judged_with_infinite_error():
    """Variations that grow by more than 1/rtol are chaos: with a tolerance of a half, twofold."""
    system = ring(damping_n_s_per_m=1.0)
    result = compute_floquet(system, -2.2, correct=False, certify=False)
    assert result.max_modulus > 1e3
    integrator = Integrator(system, result.spin_rate_rad_s, 1e-9, 5773.0)
    latest = integrate_turn(integrator, result.state)
    assert segment_error(latest, np.isfinite) < 1e-6 * result.max_modulus
    loose = Integrator(system, result.spin_rate_rad_s, 1e-9, 5773.0)
    loose.rtol = 0.5
    assert segment_error(replace(latest, integrator=loose), np.isfinite) == math.inf


def test_no_steady_configuration_is_a_verdict():
    result = compute_floquet(ring(axial_stiffness_n=1e-3, damping_n_s_per_m=0.1), -3.0)
    assert result.verdict == "none found"
    assert "no steady configuration" in result.message


@pytest.mark.parametrize(
    "name, low, high, at, cause, stable_side",
    [
        ("four_star", -6.0, -5.0, None, None, None),
        ("five_star", -4.3, -4.1, -4.2028, "axis tilt", -1),
        ("six_star", -2.9, -2.7, -2.8141, "axis tilt", -1),
        ("hub_and_spoke", -2.9, -2.7, -2.8141, "axis tilt", -1),
        ("chain", -4.35, -4.2, -4.2710, "none found", -1),
        ("six_bead", -3.22, -3.1, -3.1651, "shape", -1),
    ],
)
def test_critical_rates_of_other_formations_agree_with_simulations(
    name, low, high, at, cause, stable_side
):
    system = scenario.load(name).build()
    jobs = [CriticalRatesJob(system, low, high, 2e-3)]
    ((_, found),) = sweep(jobs)
    if at is None:
        assert found == []
        return
    (rate,) = found
    assert rate.cause == cause
    assert rate.stable_side == stable_side
    assert rate.spin_rate_ratio == pytest.approx(at, abs=4e-3)
    beside = (rate.spin_rate_ratio + side * 0.06 for side in (-1, 1))
    checks = [ConfirmationJob(system, ratio, turns=16) for ratio in beside]
    outcomes = dict(sweep(checks))
    for side, index in ((-1, 0), (1, 1)):
        result, seen = outcomes[index]
        stable = result.verdict in ("neutral", "asymptotically stable")
        assert stable == (side == stable_side)
        assert seen.agrees_with(result) is not False, (result.verdict, seen)


def test_square_without_diagonals_is_never_stable():
    """m (a^2 + b^2) of a rhombus is constant: nothing holds its angle but the orbit's curvature."""
    curved = compute_floquet(ring(4, damping_n_s_per_m=0.0), -5.0)
    flat = compute_floquet(ring(4, damping_n_s_per_m=0.0, linear_gravity=True), -5.0, rtol=1e-11)
    assert curved.verdict == "unstable"
    assert 1.0005 < curved.max_modulus_nontrivial < 1.002
    # What is left of the closure splits the double multiplier 1 by its root.
    assert flat.closure_residual < 1e-8
    assert flat.max_modulus_nontrivial < 1.0 + 1e-5 + 2.0 * math.sqrt(flat.closure_residual)


def test_a_sweep_gives_the_same_whatever_the_workers():
    jobs = [FloquetJob(ring(damping_n_s_per_m=c), w) for c in (500.0, 1450.0) for w in (-2.9, -2.3)]
    alone, together = (dict(sweep(jobs, workers)) for workers in (1, 3))
    assert sorted(alone) == sorted(together) == [0, 1, 2, 3]
    for index, job in enumerate(jobs):
        direct = compute_floquet(job.system, job.spin_rate_ratio, certify=False)
        np.testing.assert_array_equal(alone[index].multiplier, direct.multiplier)
        np.testing.assert_array_equal(together[index].multiplier, direct.multiplier)


def test_a_job_that_fails_stops_no_other():
    outcomes = dict(sweep([FloquetJob(ring(), 1e-4), FloquetJob(ring(), -2.9)]))
    assert isinstance(outcomes[0], TssError) and "spin_rate_ratio" in str(outcomes[0])
    assert outcomes[1].verdict == "asymptotically stable"


def test_a_sweep_is_cancelled_with_what_it_has():
    stop = threading.Event()
    done = []
    with pytest.raises(Cancelled):
        jobs = [FloquetJob(ring(), -3.0 - 0.001 * i) for i in range(10_000)]
        for index, _ in sweep(jobs, 2, stop.is_set):
            done.append(index)
            if len(done) == 5:
                stop.set()
    assert 5 <= len(done) < 100


def test_bad_workers_are_named():
    with pytest.raises(TssError, match="workers must be at least 1, got 0"):
        list(sweep([], 0))
