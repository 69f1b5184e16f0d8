"""Floquet multipliers of a formation: true, Eqs. (12)-(27), and frozen, Eqs. (34)-(47)."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from tss_ros.core.arguments import checked
from tss_ros.core.errors import IntegrationError, NoSteadyState, TssError
from tss_ros.core.model.axes import named
from tss_ros.core.model.configurations import initial_states
from tss_ros.core.model.frames import rigid_velocity
from tss_ros.core.model.reel_law import reels_that_yield
from tss_ros.core.model.system import State, System
from tss_ros.core.motion.displacements import carry_displacements
from tss_ros.core.motion.integrator import Integrator
from tss_ros.core.stability import families, harmonic_balance, leading_multipliers
from tss_ros.core.stability.acceptance import look
from tss_ros.core.stability.continuation import Ended
from tss_ros.core.stability.elliptic import floquet_over_orbits
from tss_ros.core.stability.formation_motion import driven_for, formation_motion, refused
from tss_ros.core.stability.frozen import frozen_jacobian
from tss_ros.core.stability.hanging import hanging_floquet
from tss_ros.core.stability.judge import (
    SMALLEST_DRIFT,
    SMALLEST_TOLERANCE,
    drift_radius,
    judge,
    judge_frozen,
)
from tss_ros.core.stability.modes import label, multipliers, stays_in_plane
from tss_ros.core.stability.own_motion import own_motion
from tss_ros.core.stability.proofs import convergence_error, liouville_error, segment_error
from tss_ros.core.stability.result import METHODS, FloquetResult, asked
from tss_ros.core.stability.shooting import (
    closure,
    flow_direction,
    from_scaled,
    integrate_turn,
    to_scaled,
)
from tss_ros.core.stability.spectrum import spectrum

#: Largest distance of a motion from the start given for it, over the radius and the rim speed.
NEAR_START = 0.2
#: Most beads of which all multipliers are computed unless asked, and how many of others.
MOST_BEADS, LEADING = 100, 12


@checked
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
        w = omega / Omega, negative for clockwise; 0 for a formation that hangs, see `hanging`.
    method : str
        "monodromy": variational equations along the motion over one turn, Eqs. (12)-(27).
        "frozen": the Jacobian at t = 0 as if the configuration stood still, Eqs. (34)-(47), the
        paper's analytic method; it shows no critical rate.
    state : State, optional
        Next to the motion that is meant; that of `formation_motion` if not given. Without
        correction, and for "frozen", the start itself, `initial_state` if not given.
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
    if not system.autonomous:
        how = method, correct, certify, leading
        return floquet_over_orbits(system, spin_rate_ratio, state, rtol, how, cancelled)
    spin = system.spin_rate_rad_s(spin_rate_ratio)
    leading = _how_many(system, leading)
    if not spin:
        return hanging_floquet(system, method, state, correct, rtol, certify, leading, cancelled)
    try:
        start = state or next(initial_states(system, spin_rate_ratio))
    except NoSteadyState as error:
        velocity = rigid_velocity(system.layout_m, spin, system.spin_axis)
        start = State(system.layout_m, velocity)
        if method == "frozen" or not correct or leading is not None:
            return _without_motion(method, system, spin, start, str(error))
    length = float(np.max(np.linalg.norm(start.position_m, axis=1)))
    integrator = Integrator(system, spin, rtol, length)
    if method == "frozen":
        return _frozen(integrator, start, cancelled)
    try:
        if leading is not None:
            return _leading(integrator, start, leading, correct, cancelled)
        if not correct:
            words = _origin(start)
            return _whole(integrator, start, words, math.nan, (certify, False), cancelled)
        return _of_motion(integrator, start, state, certify, cancelled)
    except IntegrationError as error:
        return _without_motion(method, system, spin, start, str(error))


def _how_many(system, leading):
    """How many leading multipliers are sought, None for all."""
    if leading is None and system.n > MOST_BEADS:
        leading = LEADING
    if leading is not None and reels_that_yield(system).size:
        raise TssError(
            f"all multipliers of reels that follow tension are found or none: of {system.n} beads"
            f" the leading {leading} would be; allowed: at most {MOST_BEADS} beads, and no leading"
        )
    if leading is not None and not 1 <= leading < 6 * system.n:
        raise TssError(f"leading must be from 1 to {6 * system.n - 1}, got {leading}")
    return leading


def _of_motion(integrator, start, state, certify, cancelled):
    """The result of the motion that is meant, found from a state or of the own family."""
    system, spin = integrator.system, integrator.spin
    missed_by = _missed_by(integrator, start, cancelled)
    motion, words = _search(integrator, state, cancelled)
    if motion is None:
        return _without_motion("monodromy", system, spin, start, words, missed_by)
    words = f"{words}, corrected from closure residual {missed_by:.1e}"
    driven = driven_for(integrator, motion)
    return _whole(driven, motion, words, missed_by, (certify, True), cancelled)


def _missed_by(integrator, start, cancelled):
    """Closure residual of a start, infinite if it cannot be integrated."""
    try:
        return closure(integrator, start, cancelled).residual
    except IntegrationError:
        return math.inf


def _search(integrator, state, cancelled):
    """The motion that a question is about, None if none was found; and words on it."""
    system = integrator.system
    ratio = integrator.spin / system.orbit_rate_rad_s
    if state is not None:
        return _near(integrator, ratio, state, cancelled)
    if integrator.spin and not integrator.arrays.spin:
        try:
            motion = formation_motion(system, ratio, cancelled)
        except Ended as end:
            return None, f"none found about {named(system.spin_axis)}: {end}"
        return motion, f"start from {motion.origin}; such axes are not followed from fast spin"
    if system.n > families.MOST_BEADS:
        motion, words = _first_of_starts(integrator, ratio, cancelled)
        words += f"; not followed from fast spin, having more than {families.MOST_BEADS} beads"
        return motion, words
    try:
        motion = own_motion(system, ratio, cancelled)
        return motion, f"start from {motion.origin}"
    except Ended as end:
        motion, words = _first_of_starts(integrator, ratio, cancelled)
        if motion is not None:
            words = f"another motion was found: {_in_brief(integrator, motion, cancelled)}, {words}"
        return None, f"none found of the formation's own family: {end}; {words}"


def _near(integrator, ratio, state, cancelled):
    """The motion next to a start that was given."""
    motion = families.nearest_motion(integrator.system, ratio, state, cancelled)
    if refusal := refused(integrator.system, ratio, motion):
        return None, f"none found next to the given state: {refusal}"
    apart = to_scaled(integrator, motion.state) - to_scaled(integrator, state)
    if (farthest := float(np.max(np.abs(apart)))) > NEAR_START:
        return None, (
            f"none found next to the given state; another motion was found,"
            f" {farthest:.2f} of the radius away: {_in_brief(integrator, motion, cancelled)}"
        )
    return motion, f"start from {motion.origin}"


def _first_of_starts(integrator, ratio, cancelled):
    """The first motion that is found from the formation's initial states; and words on it."""
    tried = []
    try:
        for start in initial_states(integrator.system, ratio):
            try:
                motion = families.nearest_motion(integrator.system, ratio, start, cancelled)
                refusal = refused(integrator.system, ratio, motion)
            except IntegrationError as error:
                refusal = str(error)
            if not refusal:
                return motion, f"start from {motion.origin}"
            tried.append(f"from {start.origin}: {refusal}")
    except NoSteadyState as error:
        tried.append(str(error))
    return None, f"tried {'; '.join(tried)}"


def _in_brief(integrator, motion, cancelled):
    """The verdict on a motion, in words."""
    driven = driven_for(integrator, motion)
    found = _whole(driven, motion, "", math.nan, (False, True), cancelled)
    return f"{found.verdict}, largest modulus {found.max_modulus:.6g}"


def _without_motion(method, system, spin, state, words, missed_by=math.nan):
    """The result where there is no configuration, no turn, or no motion that was found."""
    return FloquetResult(
        **asked(method, system, spin), state=state, message=words,
        initial_closure_residual=missed_by,
    )  # fmt: skip


def _result(method, integrator, spectrum, family, judgement, residual=(), **known):
    """The result of a judgement of multipliers and vectors, largest modulus first."""
    multiplier, vectors = spectrum
    order = np.argsort(-np.abs(multiplier), kind="stable")
    return FloquetResult(
        **asked(method, integrator.system, integrator.spin),
        **judgement.fields(multiplier, vectors, family, order),
        residual=np.asarray(residual)[order] if len(residual) else np.empty(0),
        **known,
    )


def _whole(integrator, motion, words, missed_by, how, cancelled):
    """The result of a motion with its whole matrix; how: whether to certify, whether it closes."""
    certify, corrected = how
    start, loss = (motion.state, motion.spin_loss) if corrected else (motion, 0.0)
    turn = integrate_turn(integrator, start, cancelled)
    seen = look(integrator, start)
    left = motion.residual if corrected else turn.closure_residual
    found = spectrum(integrator, start, turn.end, turn.matrix, left, loss)
    proofs = {}
    if certify:

        def settled(values):
            return np.abs(values - 1.0) > found.radius

        proofs = {
            "segment_error": segment_error(turn, settled, cancelled),
            "convergence_error": convergence_error(turn, settled, cancelled),
            "liouville_error": liouville_error(turn, cancelled),
        }
    if turn.switches:
        words += f"; {turn.switches} slack/taut switches in the turn"
    if seen.never_taut:
        words += f"; never taut: {', '.join(seen.never_taut)}"
    if loss and not integrator.lost(loss):
        aim = integrator.arrays.aim / integrator.system.orbit_rate_rad_s
        words += f"; feedback that aims at {aim:.8g} Omega gives the spin what is lost"
    if found.radius > SMALLEST_DRIFT:
        words += f"; growth of the spin below {found.radius:.1e} a turn is not told from its drift"
    which, judged = found.judgement.deciding, found.judgement
    if judged.verdict == "neutral" and which >= 0:
        beyond = abs(found.multiplier[which]) - 1.0
        if beyond > SMALLEST_TOLERANCE:
            words += (
                f"; the {found.family[which]} may grow: |rho| is {1.0 + beyond:.6f}, known to"
                f" {judged.tolerance[which]:.1e}"
            )
    return _result(
        "monodromy",
        integrator,
        (found.multiplier, found.vectors),
        found.family,
        found.judgement,
        closure_residual=left,
        initial_closure_residual=missed_by if corrected else left,
        spin_loss=loss,
        det_z_error=turn.det_z_error,
        flow_error=found.flow_error,
        switches=turn.switches,
        pushing_share=seen.pushing_share,
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
    periodic = closed_by <= harmonic_balance.CLOSED or not correct
    radius = drift_radius(closed_by)
    judgement = judge(multiplier, family, radius, periodic, error=residual, found=found)
    words = _origin(initial, initial_closure if correct else None)
    words += f"; {np.count_nonzero(found)} of {count} leading multipliers found in {turns} turns"
    return _result(
        "monodromy",
        integrator,
        (multiplier, vectors),
        family,
        judgement,
        residual,
        closure_residual=closed_by,
        initial_closure_residual=initial_closure,
        spin_loss=0.0,
        flow_error=float(np.max(np.abs(missed)) / np.max(np.abs(along))),
        switches=motion.switches,
        pushing_share=look(integrator, start).pushing_share,
        state=start,
        message=words,
    )


def _frozen(integrator, state, cancelled):
    """Eqs. (34)-(47): the multipliers are exp(lambda T) for the eigenvalues lambda of J_0.

    A defective J_0 (43)-(45) only changes the vectors: P(T) still has these eigenvalues.
    """
    missed = closure(integrator, state, cancelled)
    settings = integrator.settings
    units = settings.speed, settings.length
    matrix = frozen_jacobian(integrator.system, state, *units, integrator.spin)
    planar = stays_in_plane(integrator.system, state)
    value, vectors = multipliers(matrix, planar, integrator.real)  # Eq. (37)
    multiplier = np.exp(value * integrator.period_s)  # Eq. (46)
    family = label(integrator, state, multiplier, vectors)
    return _result(
        "frozen",
        integrator,
        (multiplier, vectors),
        family,
        judge_frozen(multiplier, family),
        closure_residual=missed.residual,
        spin_loss=0.0,
        initial_closure_residual=missed.residual,
        switches=missed.switches,
        pushing_share=look(integrator, state).pushing_share,
        state=state,
        message=f"{_origin(state)}; a turning configuration treated as if it stood"
        " still, its verdict says little about the motion",
    )


def _origin(start, corrected_from=None):
    words = f"start from {getattr(start, 'origin', '') or 'the given state'}"
    if corrected_from is not None:
        words += f", corrected from closure residual {corrected_from:.1e}"
    return words
