"""Floquet multipliers of a spinning formation: true, Eqs. (12)-(27), and frozen, Eqs. (34)-(47)."""

import contextlib
import math
from dataclasses import dataclass, field

import numpy as np

from tss_ros.core.errors import IntegrationError, NoSteadyState, TssError
from tss_ros.core.model import forces
from tss_ros.core.model.configurations import averaged_state, initial_state, rotating
from tss_ros.core.model.system import State
from tss_ros.core.motion.displacements import carry
from tss_ros.core.motion.propagator import Flow
from tss_ros.core.stability import harmonic_balance, leading_multipliers
from tss_ros.core.stability.frozen import frozen_jacobian
from tss_ros.core.stability.modes import FAMILIES, label
from tss_ros.core.stability.proofs import convergence_error, liouville_error, segment_error
from tss_ros.core.stability.shooting import CLOSED, closure, corrected, from_scaled, to_scaled, turn

METHODS = ("monodromy", "frozen")
VERDICTS = ("unstable", "neutral", "asymptotically stable", "no periodic motion", "undecided")

#: Most beads of which all multipliers are computed unless asked, and how many of others.
MOST_BEADS, LEADING = 100, 12
#: Smallest distance from the unit circle that is ever called one.
SMALLEST_TOLERANCE = 1e-6
#: Smallest distance from 1 within which a multiplier may be part of a split Jordan block.
SMALLEST_DRIFT = 1e-3


@dataclass(frozen=True)
class FloquetResult:
    """Multipliers at one spin rate, with what is known of their accuracy.

    Attributes
    ----------
    method : str
        "monodromy" or "frozen".
    spin_rate_ratio : float
        w = omega / Omega.
    spin_rate_rad_s, period_s : float
        omega [rad/s] and T = 2 pi / |omega| [s].
    multiplier : ndarray, shape (6n,) or (leading,), complex
        Largest modulus first; empty if there is no configuration or the motion is chaotic.
    family : tuple of str, as long
        One of `FAMILIES` for each multiplier.
    max_modulus, max_modulus_nontrivial : float
        Over all, and over those of axis tilt and shape; of leading ones, over those found.
    verdict : str
        One of `VERDICTS`. "asymptotically stable" speaks of the shape: the tilt of the axis and
        the centre of mass never decay, so Eq. (47) cannot hold for them. "undecided": none of the
        leading multipliers that were found lies outside, but some were not found.
    tolerance : float
        Distance from the unit circle that the verdict counts as lying on it. Near 1, within
        twice the root of the closure residual, where the drift of a damped motion splits Jordan
        blocks, three times `jordan_error` counts instead, if that is more.
    closure_residual : float
        |x(T) - x(0)| of the motion analysed, positions over the radius, velocities over the rim
        speed.
    initial_closure_residual : float
        The same for the start as given, before any correction; infinite if that turn cannot be
        integrated.
    trivial_error : float
        Largest distance from the unit circle of the four simple centre-of-mass multipliers
        exp(+-i Omega T), which theory puts on it. NaN for "frozen".
    jordan_error : float
        The same for the multipliers at 1 that come in Jordan blocks; about the square root of the
        matrix's error. A distance beyond 1e-3 and twice the root of the closure residual is no
        such split, and the motion is called unstable. NaN for "frozen".
    det_z_error : float
        |det Z - 1| of the out-of-plane block of a planar motion; NaN otherwise or for "frozen".
    flow_error : float
        Scaled error of M f(x(0)) = f(x(T)), which holds on every motion of the autonomous orbit
        frame, closed or not, and through every switch. NaN for "frozen".
    segment_error, convergence_error : float
        Largest change of a multiplier outside the Jordan blocks when the turn is cut into 3 and 7
        parts whose matrices are multiplied, and when it is integrated a hundred times more
        accurately. NaN if not certified.
    liouville_error : float
        Error of Liouville's formula for log|det M|, see `certificate.liouville_error`. NaN if not
        certified.
    switches : int
        Slack/taut switches in the turn.
    state : State
        Start of the motion analysed.
    message : str
        Remarks for the reader.
    residual : ndarray, shape (leading,)
        |M v - rho v| / |v| of leading multipliers; empty where the whole matrix was computed.
    """

    method: str
    spin_rate_ratio: float
    spin_rate_rad_s: float
    period_s: float
    multiplier: np.ndarray
    family: tuple
    max_modulus: float
    max_modulus_nontrivial: float
    verdict: str
    tolerance: float
    closure_residual: float
    initial_closure_residual: float
    trivial_error: float
    jordan_error: float
    det_z_error: float
    flow_error: float
    switches: int
    state: State = field(repr=False)
    segment_error: float = math.nan
    convergence_error: float = math.nan
    liouville_error: float = math.nan
    message: str = ""
    residual: np.ndarray = field(default_factory=lambda: np.empty(0), repr=False)


def compute_floquet(
    system, spin_rate_ratio, method="monodromy", state=None, correct=True, rtol=1e-9,
    certify=True, cancelled=None, leading=None,
):
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
        `averaged_state`, unless both go slack and it closes no better.
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
        Also where no periodic motion exists: that is a verdict, not an error.

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
    given = state is not None
    try:
        start = state if given else initial_state(system, spin_rate_ratio)
    except NoSteadyState as error:
        state = State(system.layout_m, rotating(system.layout_m, spin))
        return _nothing(method, system, spin, state, str(error))
    flow = Flow(system, spin, rtol, np.max(np.linalg.norm(start.position_m, axis=1)))
    if method == "frozen":
        residual, switches = closure(flow, start, cancelled)
        return _frozen(flow, start, float(np.linalg.norm(residual)), switches)
    if leading is None and system.n > MOST_BEADS:
        leading = LEADING
    if leading is not None:
        if not 1 <= leading < 6 * system.n:
            raise TssError(f"leading must be from 1 to {6 * system.n - 1}, got {leading}")
        return _leading(flow, start, leading, correct, cancelled)
    try:
        if correct:
            starts = _starts(system, spin_rate_ratio, start, given)
            latest, start, missed_by = corrected(flow, starts, cancelled)
        else:
            latest = turn(flow, start, cancelled)
            missed_by = latest.closure_residual
    except IntegrationError as error:
        return _nothing(method, system, spin, start, str(error))
    return _judge(flow, latest, start, missed_by, correct, certify, cancelled)


def _starts(system, spin_rate_ratio, first, given):
    """The start, and where it is the paper's also the averaged one, should the first not do."""
    yield first
    if not given and first.origin.startswith("Eq"):
        with contextlib.suppress(NoSteadyState):
            yield averaged_state(system, spin_rate_ratio)


def _origin(start):
    return getattr(start, "origin", "") or "the given state"


def _nothing(method, system, spin, state, reason):
    """The result where there is no configuration, or no turn could be integrated."""
    return FloquetResult(
        method, spin / system.orbit_rate_rad_s, spin, 2.0 * math.pi / abs(spin),
        np.empty(0, dtype=complex), (), math.nan, math.nan, "no periodic motion", math.nan,
        math.nan, math.nan, math.nan, math.nan, math.nan, math.nan, 0, state, message=reason,
    )


def _judge(flow, latest, initial, initial_closure, correct, certify, cancelled):
    multiplier, vectors = np.linalg.eig(latest.matrix)
    family = label(flow.system, latest.start, multiplier, vectors)
    on_circle = np.abs(np.abs(multiplier) - 1.0)
    centre = np.flatnonzero(family == FAMILIES[0])
    far_from_one = centre[np.argsort(-np.abs(multiplier[centre] - 1.0))]
    trivial = float(np.max(on_circle[far_from_one[:4]]))
    jordan = float(np.max(on_circle[np.append(far_from_one[4:], np.flatnonzero(family == "spin"))]))
    residual = latest.closure_residual
    drift = max(SMALLEST_DRIFT, 2.0 * math.sqrt(residual))
    tolerance = np.where(
        np.abs(multiplier - 1.0) <= drift, max(SMALLEST_TOLERANCE, 3.0 * jordan), 0.0
    )
    tolerance = np.maximum(tolerance, max(SMALLEST_TOLERANCE, 10.0 * trivial))
    periodic = residual <= CLOSED or not correct
    proofs = {}
    if certify:

        def settled(values):
            return np.abs(values - 1.0) > drift

        proofs = {
            "segment_error": segment_error(latest, settled, cancelled),
            "convergence_error": convergence_error(latest, settled, cancelled),
            "liouville_error": liouville_error(latest, cancelled),
        }
    return _result(
        "monodromy", flow, multiplier, family, tolerance, periodic, jordan > drift,
        closure_residual=residual,
        initial_closure_residual=initial_closure,
        trivial_error=trivial,
        jordan_error=jordan,
        det_z_error=_det_z_error(latest),
        flow_error=_flow_error(latest),
        switches=latest.switches,
        state=latest.start,
        message=_remark(initial, initial_closure, latest, correct, periodic, tolerance),
        **proofs,
    )


def _leading(flow, initial, count, correct, cancelled):
    """The result of `krylov`, as far as its multipliers were found."""
    try:
        initial_closure = float(np.linalg.norm(closure(flow, initial, cancelled)[0]))
        start = harmonic_balance.closed(flow, initial, cancelled) if correct else initial
        multiplier, vectors, residual, turns = leading_multipliers.leading_multipliers(
            flow, start, count, cancelled
        )
        along = _flow_direction(flow, start)
        period = 2.0 * math.pi / abs(flow.plant.spin)
        motion, carried = carry(flow, flow.begin(start), along[:, None], period, cancelled)
    except IntegrationError as error:
        return _nothing("monodromy", flow.system, flow.plant.spin, initial, str(error))
    scale = np.repeat([flow.control.speed, flow.control.length], 3 * flow.system.n)
    end = np.concatenate([motion.v.ravel(), motion.r.ravel()]) / scale
    missed_by = float(np.linalg.norm(end - to_scaled(flow, start)))
    missed = _flow_direction(flow, from_scaled(flow, end)) - carried[:, 0]
    family = label(flow.system, start, multiplier, vectors)
    on_circle = np.abs(np.abs(multiplier) - 1.0)
    drift = max(SMALLEST_DRIFT, 2.0 * math.sqrt(missed_by))
    near = np.abs(multiplier - 1.0) <= drift
    found = residual <= leading_multipliers.CONVERGED * np.abs(multiplier)
    centre, spin = found & (family == FAMILIES[0]), found & (family == "spin")
    trivial = float(np.max(on_circle[centre & ~near], initial=0.0))
    jordan = float(np.max(on_circle[(centre & near) | spin], initial=0.0))
    tolerance = np.maximum(SMALLEST_TOLERANCE, 10.0 * np.maximum(trivial, residual))
    tolerance[near] = np.maximum(tolerance[near], 3.0 * jordan)
    periodic = missed_by <= CLOSED or not correct
    words = f"start from {_origin(initial)}"
    if correct:
        words += f", corrected from closure residual {initial_closure:.1e}"
    words += f"; {np.count_nonzero(found)} of {count} leading multipliers found in {turns} turns"
    return _result(
        "monodromy", flow, multiplier, family, tolerance, periodic, jordan > drift,
        residual=residual,
        closure_residual=missed_by,
        initial_closure_residual=initial_closure,
        trivial_error=trivial,
        jordan_error=jordan,
        det_z_error=math.nan,
        flow_error=float(np.max(np.abs(missed)) / np.max(np.abs(along))),
        switches=int(motion.count[3]),
        state=start,
        message=words,
    )


def _remark(initial, initial_closure, latest, correct, periodic, tolerance):
    words = f"start from {_origin(initial)}"
    if correct:
        words += f", corrected from closure residual {initial_closure:.1e}"
    if latest.switches:
        words += f"; {latest.switches} slack/taut switches in the turn"
    if not periodic:
        words += "; no motion that closes was found, the multipliers are those of the best turn"
    elif np.max(tolerance) > 1e-3:
        words += (
            f"; growth below {np.max(tolerance):.1e} a turn of multipliers near 1 is not told from"
            " the drift of the spin"
        )
    return words


def _frozen(flow, state, residual, switches):
    """Eqs. (34)-(47): the multipliers are exp(lambda T) for the eigenvalues lambda of J_0.

    A defective J_0 (43)-(45) only changes the vectors: P(T) still has these eigenvalues.
    """
    matrix = frozen_jacobian(flow.system, state, flow.control.speed, flow.control.length)
    value, vectors = np.linalg.eig(matrix)
    period = 2.0 * math.pi / abs(flow.plant.spin)
    multiplier = np.exp(value * period)
    family = label(flow.system, state, multiplier, vectors)
    return _result(
        "frozen", flow, multiplier, family, np.full(multiplier.size, 1e-3), True, False,
        closure_residual=residual,
        initial_closure_residual=residual,
        trivial_error=math.nan,
        jordan_error=math.nan,
        det_z_error=math.nan,
        flow_error=math.nan,
        switches=switches,
        state=state,
        message=f"start from {_origin(state)}; a turning configuration treated as if it stood"
        " still, its verdict says little about the motion",
    )


def _result(
    method, flow, multiplier, family, tolerance, periodic, drifting, residual=(), **rest
):
    order = np.argsort(-np.abs(multiplier), kind="stable")
    multiplier, family, tolerance = multiplier[order], family[order], tolerance[order]
    residual = np.asarray(residual)[order] if len(residual) else np.empty(0)
    modulus = np.abs(multiplier)
    found = residual <= leading_multipliers.CONVERGED * modulus if residual.size else modulus >= 0.0
    shape = family == "shape"
    nontrivial = found & (shape | (family == "axis tilt"))
    if not periodic:
        verdict = "no periodic motion"
    elif np.any(modulus[nontrivial] > 1.0 + tolerance[nontrivial]) or drifting:
        verdict = "unstable"
    elif not found.all():
        verdict = "undecided"
    elif shape.any() and np.all(modulus[shape] < 1.0 - tolerance[shape]):
        verdict = "asymptotically stable"
    else:
        verdict = "neutral"
    spin = flow.plant.spin
    return FloquetResult(
        method, spin / flow.system.orbit_rate_rad_s, spin, 2.0 * math.pi / abs(spin), multiplier,
        tuple(str(name) for name in family), float(np.max(modulus[found], initial=0.0)),
        float(np.max(modulus[nontrivial], initial=0.0)), verdict, float(np.min(tolerance)),
        residual=residual, **rest,
    )


def _det_z_error(latest):
    """|det Z - 1| of the out-of-plane variations, if the motion stays in the orbit plane."""
    x = np.stack([to_scaled(latest.flow, latest.start), to_scaled(latest.flow, latest.end)])
    if np.max(np.abs(x[:, 2::3])) > 1e-12:
        return math.nan
    return float(abs(np.linalg.det(latest.matrix[2::3, 2::3]) - 1.0))


def _flow_error(latest):
    """Scaled error of M f(x(0)) = f(x(T)) with f the orbit frame's autonomous flow, Eq. (28)."""
    before, after = (_flow_direction(latest.flow, s) for s in (latest.start, latest.end))
    return float(np.max(np.abs(latest.matrix @ before - after)) / np.max(np.abs(before)))


def _flow_direction(flow, state):
    plant = flow.plant._replace(spin=0.0)
    r, v = state.position_m, np.ascontiguousarray(state.velocity_m_s)
    taut = forces.tether_state(flow.system, r, v)[2] | flow.system.bilateral
    a = np.empty_like(r)
    forces.acceleration(plant, taut, 0.0, v, np.ascontiguousarray(r), a)
    return to_scaled(flow, State(v, a))
