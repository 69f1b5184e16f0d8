"""Floquet multipliers where forces in the orbit frame depend on time: on an ellipse.

The system is periodic with the orbit, and the formation's motion may be so only if it makes k turns
in l orbits, or hangs. Elsewhere nothing is periodic, and the question is that of growth over many
turns (`growth.lyapunov_exponents`).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from fractions import Fraction

import numpy as np
from scipy.optimize import linear_sum_assignment

from tss_ros.core.errors import IntegrationError, NoSteadyState
from tss_ros.core.model.elements import require_autonomous, why_not_autonomous
from tss_ros.core.model.system import State, System
from tss_ros.core.motion.integrator import Integrator
from tss_ros.core.stability.acceptance import look
from tss_ros.core.stability.closing import CLOSED
from tss_ros.core.stability.judge import SMALLEST_DRIFT, drift_radius, judge_measured
from tss_ros.core.stability.modes import FAMILIES, FLAT, multipliers, of_beads, stays_in_plane
from tss_ros.core.stability.orbit_motions import ClosedMotion, motion_over_orbits, start_on_orbit
from tss_ros.core.stability.proofs import convergence_error, liouville_error, segment_error
from tss_ros.core.stability.result import METHODS, FloquetResult, asked
from tss_ros.core.stability.shooting import closure, from_scaled, integrate_turn, to_scaled

#: Most orbits after which a motion may close, and how near w must be to such a ratio.
MOST_ORBITS, SAME_RATIO = 12, 1e-9
#: Largest distance of a motion from the start given for it, over the radius and the rim speed.
NEAR_START = 0.2
#: Error of a matrix over its norm and the accuracy aimed at, where it is not measured: as seen.
ERROR = 10.0


def turns_and_orbits(spin_rate_ratio: float) -> tuple[int, int] | None:
    """k and l of a motion that makes k turns in l orbits, None if l would be too large."""
    for orbits in range(1, MOST_ORBITS + 1):
        turns = round(spin_rate_ratio * orbits)
        if abs(spin_rate_ratio * orbits - turns) <= SAME_RATIO * orbits:
            return turns, orbits
    return None


def why_not_periodic(system: System, spin_rate_ratio: float) -> str:
    """Why a formation has no periodic motion on an orbit that is no circle; "" if it may."""
    law = next((law for law in system.acting_laws if law.by_velocity or law.feels_stars), None)
    if law is not None:
        return f"{law.name} pushes the formation off its orbit for good"
    if not system.on_circle and system.law_parameters["j2"]:
        return f"{why_not_autonomous(system)}, and j2 never lets an orbit repeat itself"
    spin = system.spin_rate_rad_s(spin_rate_ratio)
    if spin and not system.turning_rad_s(spin):
        return f"{why_not_autonomous(system)}, and the spin axis is not the orbit normal"
    if turns_and_orbits(spin_rate_ratio) is None:
        below, above = _neighbours(spin_rate_ratio)
        return (
            f"{why_not_autonomous(system)}, and spin_rate_ratio {spin_rate_ratio:.10g} is no ratio"
            f" k/l of turns to orbits with l up to {MOST_ORBITS}: the nearest are {below} and"
            f" {above}"
        )
    return ""


def _neighbours(ratio):
    """The nearest ratios k/l below and above."""
    lower = max(Fraction(math.floor(ratio * n), n) for n in range(1, MOST_ORBITS + 1))
    upper = min(Fraction(math.ceil(ratio * n), n) for n in range(1, MOST_ORBITS + 1))
    return lower, upper


def floquet_over_orbits(
    system: System,
    spin_rate_ratio: float,
    state: State | None,
    rtol: float,
    how: tuple[str, bool, bool, int | None],
    cancelled: Callable[[], bool] | None = None,
) -> FloquetResult:
    """`compute_floquet` where forces in the orbit frame depend on time.

    Parameters
    ----------
    system, spin_rate_ratio, state, rtol, cancelled
        As for `compute_floquet`.
    how : tuple
        method, correct, certify and leading of `compute_floquet`.

    Returns
    -------
    FloquetResult
        Its period is l orbits.

    Raises
    ------
    TssError
        If it was asked for the frozen method or for leading multipliers.
    """
    method, correct, certify, leading = how
    if method != METHODS[0] or leading is not None:
        require_autonomous(system, f"method {method}" if leading is None else "leading")
    spin = system.spin_rate_rad_s(spin_rate_ratio)
    question = asked(method, system, spin)
    none = State(system.layout_m, np.zeros_like(system.layout_m))
    if reason := why_not_periodic(system, spin_rate_ratio):
        words = f"{reason}; lyapunov_exponents tells how fast displacements grow"
        return FloquetResult(**question, state=state or none, message=words)
    turns, orbits = turns_and_orbits(spin_rate_ratio)
    question |= {"orbits": orbits, "period_s": 2.0 * math.pi * orbits / system.orbit_rate_rad_s}
    missed_by = math.nan
    try:
        start, integrator = start_on_orbit(system, spin_rate_ratio, rtol, state)
        integrator.period_s = question["period_s"]
        missed_by = closure(integrator, start, cancelled).residual
        found = ClosedMotion(to_scaled(integrator, start), 0.0, missed_by, 0.0)
        if correct:
            found = motion_over_orbits(integrator, start, state is None, cancelled)
        motion = integrator.driven(found.drive)
        refusal = look(motion, from_scaled(motion, found.x), abs(turns)).refusal if correct else ""
        if found.residual > CLOSED and correct:
            refusal = f"the best motion over {orbits} orbits closes to {found.residual:.1e} only"
        apart = float(np.max(np.abs(found.x - to_scaled(integrator, start))))
        if state is not None and apart > NEAR_START and not refusal:
            refusal = f"that next to the given state is {apart:.2f} of the radius away"
        if refusal:
            return FloquetResult(
                **question, state=start, initial_closure_residual=missed_by,
                message=f"none found over {orbits} orbits: {refusal}",
            )  # fmt: skip
        return _judged(motion, found, question, turns, missed_by, certify, cancelled)
    except (IntegrationError, NoSteadyState) as error:
        return FloquetResult(
            **question, state=state or none, initial_closure_residual=missed_by, message=str(error)
        )


# -- multipliers -----------------------------------------------------------------------------------


def _judged(integrator, found, question, turns, missed_by, certify, cancelled):
    """The result of a motion."""
    system, start = integrator.system, from_scaled(integrator, found.x)
    turn = integrate_turn(integrator, start, cancelled)
    planar = stays_in_plane(system, start)
    multiplier, vectors = multipliers(turn.matrix, planar, integrator.real)
    family = families_over_orbits(integrator, start, turn.matrix, multiplier, vectors)
    error = ERROR * integrator.rtol * float(np.linalg.norm(turn.matrix, 2))
    radius = drift_radius(found.residual, error=error)
    proofs = {}
    if certify:

        def settled(values):
            return np.abs(values - 1.0) > radius

        proofs = {
            "segment_error": segment_error(turn, settled, cancelled),
            "convergence_error": convergence_error(turn, settled, cancelled),
            "liouville_error": liouville_error(turn, cancelled),
        }
        error = max(proofs["segment_error"], proofs["convergence_error"])
        radius = max(radius, drift_radius(0.0, error=error))
    judgement = judge_measured(multiplier, family, error, radius)
    seen = look(integrator, start, abs(turns))
    orbits = question["orbits"]
    words = f"over {orbits} orbit{'s' if orbits > 1 else ''} of eccentricity"
    words += f" {system.law_parameters['eccentricity']:g}, {turns} turns"
    words += f"; the centre of mass is kicked by {found.kick:.1e} of the radius and rim speed"
    if turn.switches:
        words += f"; {turn.switches} slack/taut switches"
    if radius > SMALLEST_DRIFT and integrator.spin:
        words += f"; growth of the spin below {radius:.1e} is not told from its drift"
    order = np.argsort(-np.abs(multiplier), kind="stable")
    return FloquetResult(
        **question,
        **judgement.fields(multiplier, vectors, family, order),
        closure_residual=found.residual,
        initial_closure_residual=missed_by,
        spin_loss=found.drive / max(abs(turns), 1),
        det_z_error=turn.det_z_error,
        switches=turn.switches,
        pushing_share=seen.pushing_share,
        state=start,
        message=words,
        **proofs,
    )


def families_over_orbits(
    integrator: Integrator,
    state: State,
    matrix: np.ndarray,
    multiplier: np.ndarray,
    vectors: np.ndarray,
) -> np.ndarray:
    """Family of every multiplier; those that rest lengths add count as shape.

    The centre of mass has all its six at 1, where the spin's are too, so that vectors there are any
    mixture. The matrix is seen in two parts, the centre and the beads against it, which do not mix
    but for the gradient's change over the formation; their own multipliers are told apart, and each
    multiplier is of the family of the one that it is next to. A formation that hangs has librations
    in the plane and out of it instead of spin and tilts.
    """
    system = integrator.system
    n, planar = system.n, stays_in_plane(system, state)
    root = np.sqrt(system.mass_kg / system.mass_kg.sum())
    rows = np.append(root, np.ones(integrator.rows - n))
    centre = np.append(root, np.zeros(integrator.rows - n))
    others = np.delete(np.eye(rows.size), n - 1, axis=1)
    apart = np.linalg.qr(np.column_stack([centre, others]))[0][:, 1:]
    weight = np.tile(np.repeat(rows, 3), 2)
    weighted = weight[:, None] * matrix / weight
    value, own = [], []
    every, coordinates = np.ones(6, dtype=bool), _without_one(integrator)
    for basis, real in ((centre[:, None], every), (apart, coordinates)):
        basis = np.kron(np.eye(2), np.kron(basis, np.eye(3)))
        part = multipliers(basis.T @ weighted @ basis, planar, real)
        value.append(part[0])
        own.append(basis @ part[1])
    of_formation = of_beads(integrator, own[1]).reshape(6 * n, -1)
    names = np.concatenate([np.full(6, FAMILIES[0], dtype=object),
                            _rigid_families(integrator, state, of_formation, planar)])  # fmt: skip
    known, level = np.concatenate(value), _out_of_plane(np.concatenate(own, axis=1))
    distance = np.abs(multiplier[:, None] - known)
    if planar:
        distance += 1e3 * (_out_of_plane(vectors)[:, None] != level)
    rows, columns = linear_sum_assignment(distance)
    family = np.empty(multiplier.size, dtype=object)
    family[rows] = names[columns]
    return family


def _without_one(integrator):
    """`Integrator.real` of all rows but one bead's."""
    return integrator.real.reshape(2, -1, 3)[:, 1:].ravel()


def _out_of_plane(vectors):
    size = np.abs(vectors) ** 2
    return size[2::3].sum(axis=0) > 0.5 * size.sum(axis=0)


def _rigid_families(integrator, state, vectors, planar):
    """Families of weighted vectors (6n, k) of the beads against the centre of mass."""
    mass = integrator.system.mass_kg
    above = _out_of_plane(vectors)
    arm = state.position_m - np.average(state.position_m, axis=0, weights=mass)
    x, y, z = ((np.sqrt(mass)[:, None] * np.cross(axis, arm)).reshape(1, -1) for axis in np.eye(3))
    names = np.full(above.size, FAMILIES[3], dtype=object)
    about_normal, across = FAMILIES[1:3] if integrator.spin else (FAMILIES[4], FAMILIES[4])
    halves = vectors.reshape(2, arm.size, -1)
    for turns, family, allowed in (
        (z, about_normal, ~above),
        (np.vstack([x, y]), across, above),
    ):
        _, size, turns = np.linalg.svd(turns, full_matrices=False)
        turns = turns[size > FLAT * np.linalg.norm(arm * np.sqrt(mass)[:, None])]
        share = np.sum(np.abs(turns @ halves) ** 2, axis=(0, 1))
        free = np.flatnonzero((names == FAMILIES[3]) & (allowed | (not planar)))
        names[free[np.argsort(-share[free], kind="stable")[: 2 * len(turns)]]] = family
    return names
