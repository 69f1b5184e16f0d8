"""Stability of formations that hang at rest in the orbit frame: a spin rate ratio of 0.

Displacements of an equilibrium obey linear equations with constant coefficients, so that the frozen
method, Eqs. (34)-(47), is exact there: the exponents are the eigenvalues of the Jacobian, and the
monodromy matrix over an orbit is exp(J T).
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import scipy.sparse

from tss_ros.core.errors import IntegrationError, NoSteadyState, TssError
from tss_ros.core.model.configurations import EQUILIBRIUM, InitialState
from tss_ros.core.model.equilibria import equilibrium, imbalance, laws_at_rest
from tss_ros.core.model.feedback import thrust
from tss_ros.core.model.forces import tether_state
from tss_ros.core.model.laws.reel import REEL_TENSION
from tss_ros.core.model.reel_law import (
    reel_tension_n,
    reels_that_yield,
    rests_in_rows,
    rows_of,
)
from tss_ros.core.model.system import State, System
from tss_ros.core.motion.displacements import carry_displacements
from tss_ros.core.motion.integrator import Integrator
from tss_ros.core.stability.frozen import frozen_jacobian
from tss_ros.core.stability.judge import judge_exponents
from tss_ros.core.stability.modes import label_hanging, multipliers, stays_in_plane
from tss_ros.core.stability.proofs import bead_trace, tether_rates
from tss_ros.core.stability.result import FloquetResult, asked
from tss_ros.core.stability.shooting import closure

#: Most cycles of the fastest mode that are integrated to certify the exponents, and after how many
#: e-foldings a mode counts as gone.
MOST_CYCLES, GONE = 200.0, 30.0
#: Thrust that an equilibrium may have by rounding, over forces of the gravity gradient.
BALANCED = 1e-6


def hanging_floquet(
    system: System,
    method: str,
    state: State | None,
    correct: bool,
    rtol: float,
    certify: bool,
    leading: int | None,
    cancelled: Callable[[], bool] | None = None,
) -> FloquetResult:
    """`compute_floquet` at a spin rate of 0; parameters, result and errors as there."""
    resting, left_out = laws_at_rest(system)
    try:
        start = _start(resting, state, correct and method != "frozen")
        _require_rest(resting, start)
    except NoSteadyState as error:
        return FloquetResult(
            **asked(method, system, 0.0), message=str(error),
            state=state or State(system.layout_m, np.zeros((system.n, 3))),
        )  # fmt: skip
    integrator = Integrator(resting, 0.0, rtol, np.max(np.linalg.norm(start.position_m, axis=1)))
    exponent, vectors, error = exponents(resting, start, integrator)
    family = label_hanging(resting, start, vectors, stays_in_plane(resting, start))
    judgement = judge_exponents(exponent, integrator.period_s, family, error)
    words = [f"start from {start.origin}"]
    if left_out:
        words.append(f"{', '.join(left_out)} left out: nothing rests in the orbit frame under it")
    _, tension, taut = tether_state(system, start.position_m, start.velocity_m_s)
    if not (taut | system.bilateral).all():
        names = (name for name, tight in zip(system.tether_name, taut) if not tight)
        words.append(f"never taut: {', '.join(names)}")
    proofs = {}
    if certify and leading is None:
        proofs, part = _proofs(integrator, start, exponent, vectors, cancelled)
        words.append(f"exponents compared with a matrix integrated over {part:.3g} of the orbit")
    if leading is not None:
        words.append(f"the {leading} that decay least of {exponent.size}, all of which were judged")
    with np.errstate(under="ignore", over="ignore"):
        multiplier = np.exp(exponent * integrator.period_s)  # Eq. (46)
    order = np.argsort(-exponent.real, kind="stable")[:leading]
    return FloquetResult(
        **asked(method, system, 0.0),
        **judgement.fields(multiplier, vectors, family, order),
        exponent=exponent[order],
        spin_loss=0.0,
        pushing_share=float(np.mean(tension < 0.0)),
        state=start,
        message="; ".join(words),
        **_closure(integrator, start, cancelled),
        **proofs,
    )


def _start(system, state, correct):
    """The equilibrium that is meant."""
    if state is not None and state.position_m.shape != (system.n, 3):
        raise TssError(
            f"state must be of {system.n} beads, got positions of shape {state.position_m.shape}"
        )
    if state is None or correct:
        place = equilibrium(system, None if state is None else state.position_m)
        return InitialState(place, np.zeros_like(place), EQUILIBRIUM)
    bead, force, share = imbalance(system, state.position_m)
    speed = float(np.max(np.abs(state.velocity_m_s)))
    if not share < 1.0 or speed:
        raise NoSteadyState(
            f"the given state is no equilibrium of the orbit frame: {system.bead_name[bead]} is"
            f" left out of balance by {force:.3g} N, and beads move at up to {speed:.3g} m/s"
        )
    rests = rests_in_rows(system, *rows_of(system, state))
    if rests[1].any() or not np.allclose(rests[0], system.rest_length_m, rtol=1e-12, atol=0.0):
        raise NoSteadyState(
            "the given state is no equilibrium of the orbit frame: its reels have paid out up to"
            f" {np.max(np.abs(rests[0] - system.rest_length_m)):.3g} m, at up to"
            f" {np.max(np.abs(rests[1])):.3g} m/s"
        )
    return InitialState(state.position_m, state.velocity_m_s, "the given state, an equilibrium")


def _require_rest(system, start):
    """Feedback and reels have to leave an equilibrium alone, which is found without them."""
    scale = np.max(system.mass_kg) * system.orbit_rate_rad_s**2 * np.max(np.abs(start.position_m))
    force = float(np.abs(thrust(system, 0.0, start)).max())
    if force > BALANCED * scale:
        words = f"feedback thrusts {force:.3g} N where the formation would hang at rest"
        raise NoSteadyState(words)
    if (moving := reels_that_yield(system)).size:
        tension = tether_state(system, start.position_m, start.velocity_m_s)[1][moving]
        aim = reel_tension_n(system, 0.0)
        worst = int(np.argmax(np.abs(tension - aim)))
        if abs(tension[worst] - aim[worst]) > BALANCED * scale:
            raise NoSteadyState(
                f"the reel of {system.tether_name[moving[worst]]} holds"
                f" {REEL_TENSION.name} {aim[worst]:.6g} N, where it would hang at rest with"
                f" {tension[worst]:.6g} N; 0 is that tension"
            )


def exponents(
    system: System, state: State, integrator: Integrator
) -> tuple[np.ndarray, np.ndarray, float]:
    """Eigenvalues [1/s] and vectors of the Jacobian at an equilibrium, Eq. (37).

    Parameters
    ----------
    system : System
    state : State
        The equilibrium.
    integrator : Integrator
        Its units.

    Returns
    -------
    exponent : ndarray, shape (k,), complex
        6n, and two for each rest length that is a state.
    vectors : ndarray, shape (6 rows, k), complex
        Columns of norm 1, scaled.
    error : float
        [1/s] about what rounding makes of an exponent: it grows with the fastest one.
    """
    settings = integrator.settings
    matrix = frozen_jacobian(system, state, settings.speed, settings.length)
    exponent, vectors = multipliers(matrix, stays_in_plane(system, state), integrator.real)
    real = integrator.real
    precise, rounding = _refined(matrix[np.ix_(real, real)], exponent, vectors[real])
    return precise, vectors, len(matrix) * rounding * float(np.max(np.abs(exponent)))


def _refined(matrix, exponent, vectors):
    """Exponents with what is left of J v = lambda v taken off, and the precision they have.

    It is computed in extended precision: slow modes beside stiff or strongly damped tethers, where
    double precision has lost half their digits, get them back.
    """
    precision, wide = np.finfo(float).eps, vectors.astype(np.clongdouble)
    left = scipy.sparse.csr_array(matrix.astype(np.longdouble)) @ wide - wide * exponent
    try:
        change = np.diag(np.linalg.solve(vectors, left.astype(complex)))
    except np.linalg.LinAlgError:  # a Jordan block to the last digit
        return exponent, precision
    # In a Jordan block it may be anything.
    small = np.abs(change) < 10.0 * np.linalg.norm(left.astype(complex), axis=0)
    return exponent + np.where(small, change, 0.0), float(np.finfo(np.longdouble).eps)


def _closure(integrator, start, cancelled):
    """How far the start is from closing, and switches on the way."""
    try:
        missed = closure(integrator, start, cancelled)
    except IntegrationError:
        return {"closure_residual": math.inf, "initial_closure_residual": math.inf}
    return {
        "closure_residual": missed.residual,
        "initial_closure_residual": missed.residual,
        "switches": missed.switches,
    }


def _proofs(integrator, start, exponent, vectors, cancelled):
    """Errors measured with a matrix that is integrated, and over what part of the orbit."""
    system, period = integrator.system, integrator.period_s
    alive = np.minimum(period, GONE / np.maximum(np.abs(exponent.real), 1e-300))
    cycles = np.max(np.abs(exponent.imag) * alive) / (2.0 * math.pi)
    part = min(1.0, MOST_CYCLES / cycles)
    _, matrix = carry_displacements(
        integrator, integrator.begin(start), np.eye(6 * integrator.rows), part * period, cancelled
    )
    with np.errstate(under="ignore"):
        after = np.exp(exponent * part * period)
    missed = np.linalg.norm(matrix @ vectors - vectors * after, axis=0)
    taut = tether_state(system, start.position_m, start.velocity_m_s)[2] | system.bilateral
    trace = bead_trace(integrator, integrator.begin(start)) - np.sum(tether_rates(integrator)[taut])
    return {
        "segment_error": float(np.max(missed / np.maximum(np.abs(after), 1.0))),
        "liouville_error": float(abs(np.sum(exponent.real) - trace) * period),
    }, part
