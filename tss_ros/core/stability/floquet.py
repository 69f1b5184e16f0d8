"""Floquet multipliers of a spinning formation: true, Eqs. (12)-(27), and frozen, Eqs. (34)-(47)."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable

import numpy as np

from tss_ros.core.errors import IntegrationError, NoSteadyState, TssError
from tss_ros.core.model import forces
from tss_ros.core.model.configurations import initial_states
from tss_ros.core.model.frames import rigid_velocity
from tss_ros.core.model.system import State, System
from tss_ros.core.motion.displacements import carry_displacements
from tss_ros.core.motion.propagator import Integrator
from tss_ros.core.stability import harmonic_balance, leading_multipliers
from tss_ros.core.stability.frozen import frozen_jacobian
from tss_ros.core.stability.judge import drift_radius, judge, judge_frozen
from tss_ros.core.stability.modes import flow_direction, label, multipliers, stays_in_plane
from tss_ros.core.stability.proofs import convergence_error, liouville_error, segment_error
from tss_ros.core.stability.result import METHODS, FloquetResult
from tss_ros.core.stability.shooting import (
    CLOSED,
    close_by_shooting,
    closure,
    from_scaled,
    integrate_turn,
    to_scaled,
)

#: Samples of a turn that tell how often taut tethers push.
PUSHING_SAMPLES = 360
#: Most beads of which all multipliers are computed unless asked, and how many of others.
MOST_BEADS, LEADING = 100, 12


def compute_floquet(
    system: System,
    spin_rate_ratio: float,
    method: str = "monodromy",
    state: State | None = None,
    *,
    correct: bool = True,
    rtol: float = 1e-9,
    certify: bool = True,
    cancelled: Callable[[], bool] | None = None,
    leading: int | None = None,
) -> FloquetResult:
    """Floquet multipliers at one spin rate.

    Parameters
    ----------
    system : System
    spin_rate_ratio : float
        w = omega / Omega, negative for clockwise.
    method : str
        "monodromy": variational equations along the motion over one turn, Eqs. (12)-(27).
        "frozen": the Jacobian at t = 0 as if the configuration stood still, Eqs. (34)-(47), the
        paper's analytic method; it shows no critical rate.
    state : State, optional
        Start; if not given `initial_state`, and where that leads to no motion that closes also
        `averaged_state`, unless tethers go slack from both and that one closes no better.
    correct : bool
        Correct the start to a periodic motion first ("monodromy" only).
    rtol : float
        Accuracy aimed at in state and matrix.
    certify : bool
        Measure the matrix also against the same turn cut into segments, a finer integration and
        Liouville's formula: some four times the work of the matrix itself ("monodromy" only).
    cancelled : callable, optional
        Asked now and then; a true answer stops the work.
    leading : int, optional
        Find so many multipliers of largest modulus without the matrix ("monodromy" only): the
        default, with `LEADING`, above `MOST_BEADS` beads. Not certified.

    Returns
    -------
    FloquetResult
        Also where no periodic motion was found: that is a verdict, not an error.

    Raises
    ------
    TssError
        For a value that is not allowed.
    Cancelled
        If `cancelled` said so.
    """
    if method not in METHODS:
        raise TssError(f"method must be one of {', '.join(METHODS)}, got {method!r}")
    spin = system.spin_rate_rad_s(spin_rate_ratio)
    starts = iter([state]) if state is not None else initial_states(system, spin_rate_ratio)
    try:
        start = next(starts)
    except NoSteadyState as error:
        start = State(system.layout_m, rigid_velocity(system.layout_m, spin))
        return _without_motion(method, system, spin, start, error)
    integrator = Integrator(system, spin, rtol, np.max(np.linalg.norm(start.position_m, axis=1)))
    if method == "frozen":
        return _frozen(integrator, start, cancelled)
    if leading is None and system.n > MOST_BEADS:
        leading = LEADING
    try:
        if leading is not None:
            if not 1 <= leading < 6 * system.n:
                raise TssError(f"leading must be from 1 to {6 * system.n - 1}, got {leading}")
            return _leading(integrator, start, leading, correct, cancelled)
        if correct:
            starts = itertools.chain([start], starts)
            turn, start, missed_by = close_by_shooting(integrator, starts, cancelled)
        else:
            turn = integrate_turn(integrator, start, cancelled)
            missed_by = turn.closure_residual
    except IntegrationError as error:
        return _without_motion(method, system, spin, start, error)
    return _whole(turn, start, missed_by, correct, certify, cancelled)


def _without_motion(method, system, spin, state, reason):
    """The result where there is no configuration, or no turn could be integrated."""
    return FloquetResult(**_question(method, system, spin), state=state, message=str(reason))


def _question(method, system, spin):
    return {
        "method": method,
        "spin_rate_ratio": spin / system.orbit_rate_rad_s,
        "spin_rate_rad_s": spin,
        "period_s": 2.0 * math.pi / abs(spin),
        "tether_law": system.tether_law,
    }


def _pushing_share(integrator, start):
    """Share of the time that taut tethers push in the turn from a start."""
    system = integrator.system
    if not system.law.pushes or not np.any(system.damping_n_s_per_m):
        return 0.0
    times = integrator.period_s / PUSHING_SAMPLES * np.arange(PUSHING_SAMPLES)
    samples, motion = integrator.samples(times), integrator.begin(start)
    integrator.advance(motion, integrator.period_s, samples=samples)
    _, tension, taut = forces.tether_state(system, samples.r, samples.v)
    return forces.pushing_share(tension, taut)


def _result(method, integrator, spectrum, family, judgement, residual=(), **known):
    """The result of a judgement of multipliers and vectors, largest modulus first."""
    multiplier, vectors = spectrum
    order, decided = np.argsort(-np.abs(multiplier), kind="stable"), judgement.deciding
    return FloquetResult(
        **_question(method, integrator.system, integrator.arrays.spin),
        multiplier=multiplier[order],
        family=tuple(str(name) for name in family[order]),
        max_modulus=judgement.max_modulus,
        max_modulus_nontrivial=judgement.max_modulus_nontrivial,
        verdict=judgement.verdict,
        deciding_modulus=float(abs(multiplier[decided])) if decided >= 0 else math.nan,
        deciding_family=str(family[decided]) if decided >= 0 else "",
        tolerance=float(np.min(judgement.tolerance)),
        trivial_error=judgement.trivial_error,
        jordan_error=judgement.jordan_error,
        residual=np.asarray(residual)[order] if len(residual) else np.empty(0),
        vectors=vectors[:, order],
        **known,
    )


def _whole(turn, initial, initial_closure, correct, certify, cancelled):
    """The result of a turn with its whole matrix."""
    integrator, closed_by = turn.integrator, turn.closure_residual
    planar = stays_in_plane(integrator, turn.start)
    multiplier, vectors = multipliers(turn.matrix, planar)  # Eqs. (25) and (27)
    family = label(integrator, turn.start, multiplier, vectors)
    periodic = closed_by <= CLOSED or not correct
    judgement = judge(multiplier, family, closed_by, periodic)
    proofs = {}
    if certify:

        def settled(values):
            return np.abs(values - 1.0) > drift_radius(closed_by)

        proofs = {
            "segment_error": segment_error(turn, settled, cancelled),
            "convergence_error": convergence_error(turn, settled, cancelled),
            "liouville_error": liouville_error(turn, cancelled),
        }
    words = _origin(initial, initial_closure if correct else None)
    if turn.switches:
        words += f"; {turn.switches} slack/taut switches in the turn"
    if not periodic:
        words += "; no motion that closes was found, the multipliers are those of the best turn"
    elif (widest := np.max(judgement.tolerance)) > 1e-3:
        words += (
            f"; growth below {widest:.1e} a turn of multipliers near 1 is not told from"
            " the drift of the spin"
        )
    return _result(
        "monodromy", integrator, (multiplier, vectors), family, judgement,
        closure_residual=closed_by,
        initial_closure_residual=initial_closure,
        det_z_error=_det_z_error(turn),
        flow_error=_flow_error(turn),
        switches=turn.switches,
        pushing_share=_pushing_share(integrator, turn.start),
        state=turn.start,
        message=words,
        **proofs,
    )


def _leading(integrator, initial, count, correct, cancelled):
    """The result of `leading_multipliers`, as far as they were found."""
    start, initial_closure = initial, closure(integrator, initial, cancelled).residual
    if correct:
        start = harmonic_balance.close_by_harmonic_balance(integrator, initial, cancelled)
    multiplier, vectors, residual, turns = leading_multipliers.leading_multipliers(
        integrator, start, count, cancelled
    )
    along = flow_direction(integrator, start)
    motion, carried = carry_displacements(
        integrator, integrator.begin(start), along[:, None], integrator.period_s, cancelled
    )
    end = integrator.scaled(motion.v, motion.r)
    closed_by = float(np.linalg.norm(end - to_scaled(integrator, start)))
    missed = flow_direction(integrator, from_scaled(integrator, end)) - carried[:, 0]
    family = label(integrator, start, multiplier, vectors)
    found = residual <= leading_multipliers.CONVERGED * np.abs(multiplier)
    periodic = closed_by <= CLOSED or not correct
    judgement = judge(multiplier, family, closed_by, periodic, residual, found)
    words = _origin(initial, initial_closure if correct else None)
    words += f"; {np.count_nonzero(found)} of {count} leading multipliers found in {turns} turns"
    return _result(
        "monodromy", integrator, (multiplier, vectors), family, judgement, residual,
        closure_residual=closed_by,
        initial_closure_residual=initial_closure,
        flow_error=float(np.max(np.abs(missed)) / np.max(np.abs(along))),
        switches=motion.switches,
        pushing_share=_pushing_share(integrator, start),
        state=start,
        message=words,
    )


def _frozen(integrator, state, cancelled):
    """Eqs. (34)-(47): the multipliers are exp(lambda T) for the eigenvalues lambda of J_0.

    A defective J_0 (43)-(45) only changes the vectors: P(T) still has these eigenvalues.
    """
    missed = closure(integrator, state, cancelled)
    settings = integrator.settings
    matrix = frozen_jacobian(integrator.system, state, settings.speed, settings.length)
    value, vectors = multipliers(matrix, stays_in_plane(integrator, state))  # Eq. (37)
    multiplier = np.exp(value * integrator.period_s)  # Eq. (46)
    family = label(integrator, state, multiplier, vectors)
    return _result(
        "frozen", integrator, (multiplier, vectors), family, judge_frozen(multiplier, family),
        closure_residual=missed.residual,
        initial_closure_residual=missed.residual,
        switches=missed.switches,
        pushing_share=_pushing_share(integrator, state),
        state=state,
        message=f"{_origin(state)}; a turning configuration treated as if it stood"
        " still, its verdict says little about the motion",
    )


def _origin(start, corrected_from=None):
    words = f"start from {getattr(start, 'origin', '') or 'the given state'}"
    if corrected_from is not None:
        words += f", corrected from closure residual {corrected_from:.1e}"
    return words


def _det_z_error(turn):
    """|det Z - 1| of the out-of-plane variations, if the motion stays in the orbit plane."""
    x = np.stack([to_scaled(turn.integrator, turn.start), to_scaled(turn.integrator, turn.end)])
    if np.max(np.abs(x[:, 2::3])) > 1e-12:
        return math.nan
    return float(abs(np.linalg.det(turn.matrix[2::3, 2::3]) - 1.0))


def _flow_error(turn):
    """Scaled error of M f(x(0)) = f(x(T)) with f the orbit frame's autonomous flow, Eq. (28)."""
    before, after = (flow_direction(turn.integrator, s) for s in (turn.start, turn.end))
    return float(np.max(np.abs(turn.matrix @ before - after)) / np.max(np.abs(before)))
