"""Starts of motions on orbits that are no circles, and motions over l orbits by shooting.

Time counts from the place on the orbit that is given, so nothing is left free. The whole formation
drifts with its orbit, and its size turns its perigee a little: no start in the middle brings the
centre of mass back. A kick after the l orbits does, whose size is told.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from tss_ros.core.errors import IntegrationError, TssError
from tss_ros.core.model.configurations import initial_state
from tss_ros.core.model.elements import on_mean_circle
from tss_ros.core.model.reel_law import rows_of
from tss_ros.core.model.system import State, System
from tss_ros.core.motion.displacements import carry_displacements
from tss_ros.core.motion.integrator import Integrator
from tss_ros.core.stability.closing import CLOSED, LARGEST_CHANGE, NOTHING_LEFT, SMALL_LOSS
from tss_ros.core.stability.shooting import carried_motion, from_scaled, to_scaled

#: First step of the eccentricity from the circle, and the smallest one that is tried.
FIRST_STEP, SMALLEST_STEP = 0.05, 1e-3
#: Most corrections of a start; singular values, over the largest, that count as none; and what
#: share of the residual a correction must leave at most.
MOST_CORRECTIONS, SINGULAR, WORTH_IT = 40, 1e-8, 0.9
#: A motion closes without a drive, locked to the orbit, if no more than this is left.
WITHOUT_DRIVE = 1e-9


def start_on_orbit(
    system: System, spin_rate_ratio: float, rtol: float, state: State | None = None
) -> tuple[State, Integrator]:
    """A start at time 0, in the orbit frame, and the integrator of motions from there.

    If none is given, that of the circle with the same semi-major axis, at rest in the frame that
    turns evenly.

    Raises
    ------
    NoSteadyState
        If no configuration was found on the circle.
    """
    spin = system.spin_rate_rad_s(spin_rate_ratio)
    start = initial_state(system, spin_rate_ratio) if state is None else state
    length = float(np.max(np.linalg.norm(start.position_m, axis=1), initial=0.0))
    if not length:
        raise TssError("state must have a bead away from the frame's origin")
    return start, Integrator(system, spin, rtol, length)


# -- shooting --------------------------------------------------------------------------------------


@dataclass(frozen=True)
class ClosedMotion:
    """A motion that closes as far as it could be made to.

    Attributes
    ----------
    x : ndarray, shape (6 rows,)
        Scaled start.
    drive : float
        Share of the spin that a drive gives in a turn.
    residual : float
        Norm of what is left of the equations.
    kick : float
        Norm of the scaled kick of the whole formation.
    """

    x: np.ndarray
    drive: float
    residual: float
    kick: float


class Closing:
    """The equations of a motion that closes after l orbits, but for a kick of the whole formation.

    They are those of the beads against the centre of mass. Six more hold the centre at the start in
    the middle, with a speed along the orbit that brings it back there.
    """

    def __init__(self, integrator: Integrator, cancelled: Callable[[], bool] | None = None):
        self.integrator, self.cancelled = integrator, cancelled
        mass = integrator.system.mass_kg
        # Rest lengths that are states follow the beads and are no part of the whole formation.
        share, bead = np.zeros((2, integrator.rows))
        share[: mass.size], bead[: mass.size] = mass / mass.sum(), 1.0
        mean = np.kron(np.eye(2), np.kron(share, np.eye(3)))
        every = np.kron(np.eye(2), np.kron(bead[:, None], np.eye(3)))
        self.mean = mean
        self.relative = np.eye(6 * integrator.rows) - every @ mean
        #: Of the centre: the velocity along the orbit at the start is free.
        self.held = mean[[1, 2, 3, 4, 5]]
        self.back = mean[[3]]

    def left(self, x: np.ndarray, drive: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
        """What is left of the equations, and the kick (6,)."""
        motion = carried_motion(
            self.integrator.driven(drive), from_scaled(self.integrator, x),
            self.integrator.period_s, self.cancelled,
        )  # fmt: skip
        return self._of_end(self.integrator.scaled(motion.v, motion.r), x)

    def _of_end(self, end, x):
        change = end - x
        left = np.concatenate([self.relative @ change, self.held @ x, self.back @ change])
        return left, self.mean @ change

    def linearised(self, x: np.ndarray, drive: float = 0.0) -> np.ndarray:
        """Their derivatives by x."""
        integrator, size = self.integrator.driven(drive), x.size
        begin = integrator.begin(from_scaled(integrator, x))
        _, matrix = carry_displacements(
            integrator, begin, np.eye(size), integrator.period_s, self.cancelled
        )
        matrix = matrix - np.eye(size)
        return np.vstack([self.relative @ matrix, self.held, self.back @ matrix])

    def solve(self, x: np.ndarray, driven: bool = False, drive: float = 0.0) -> ClosedMotion:
        """The motion next to a start, as far as Newton's method leads; with a drive or without."""
        phase = np.zeros(x.size)
        if driven:  # the drive takes the place of the phase of the spin, which it leaves open
            arm = x.reshape(2, -1, 3)[1, : self.integrator.system.n]
            along = phase.reshape(2, -1, 3)[1, : self.integrator.system.n]
            along[:] = np.cross([0.0, 0.0, 1.0], arm)
            phase /= np.linalg.norm(phase)
        left, kick = self.left(x, drive)
        residual = np.linalg.norm(left)
        for _ in range(MOST_CORRECTIONS):
            if residual <= NOTHING_LEFT:
                break
            matrix = self.linearised(x, drive)
            if driven:
                by_drive = (self.left(x, drive + SMALL_LOSS)[0] - left) / SMALL_LOSS
                matrix = np.block([[matrix, by_drive[:, None]], [phase, 0.0]])
                left = np.append(left, 0.0)
            change = -np.linalg.lstsq(matrix, left, rcond=SINGULAR)[0]
            change *= min(1.0, LARGEST_CHANGE / max(np.max(np.abs(change[: x.size])), 1e-300))
            for size in (1.0, 0.5, 0.25):
                step = size * change
                trial = x + step[: x.size]
                more = drive + float(step[-1]) if driven else 0.0
                after, also = self.left(trial, more)
                if (gain := np.linalg.norm(after) / residual) < WORTH_IT:
                    break
            if gain >= WORTH_IT:
                break
            x, drive, left, kick = trial, more, after, also
            residual = np.linalg.norm(left)
        return ClosedMotion(x, drive, float(residual), float(np.linalg.norm(kick)))


def motion_over_orbits(
    integrator: Integrator, start: State, own: bool, cancelled: Callable[[], bool] | None = None
) -> ClosedMotion:
    """The motion next to a start; a hanging formation's own comes from the circle, step by step.

    Found with damped tethers first: those that ring lead Newton's method astray from afar.

    Parameters
    ----------
    integrator : Integrator
        Its period is that of the l orbits.
    start : State
    own : bool
        Whether it is the formation's own start, of `start_on_orbit`.
    cancelled : callable, optional
        Asked now and then; a true answer stops the work.

    Returns
    -------
    ClosedMotion
        Of least residual; whether that is small enough is for the caller to say.

    Raises
    ------
    IntegrationError, Cancelled
        If a motion cannot be continued, or was cancelled.
    """
    near = ClosedMotion(to_scaled(integrator, start), 0.0, math.inf, 0.0)
    if integrator.spin or not own:
        near = _best(_of(integrator, damped(integrator.system)), near, cancelled)
    if near.residual > CLOSED and own:
        near = _followed(integrator, start, cancelled)
    return _best(integrator, near, cancelled)


def _best(integrator, near, cancelled):
    """The motion next to another one, with a drive if it closes with one only."""
    closing = Closing(integrator, cancelled)
    found = closing.solve(near.x)
    for x in (near.x, found.x):
        if found.residual > WITHOUT_DRIVE and integrator.spin:
            driven = closing.solve(x, True, near.drive)
            found = min(found, driven, key=lambda one: one.residual)
    return found


def _of(integrator, system):
    """The same integrator of another system."""
    other = Integrator(system, integrator.spin, integrator.rtol, integrator.settings.length)
    other.period_s = integrator.period_s
    return other


def damped(system: System) -> System:
    """The system with tethers damped so that none rings."""
    i, j = system.tether_ends.T
    inverse = 1.0 / system.mass_kg
    critical = 2.0 * np.sqrt(
        system.axial_stiffness_n / system.rest_length_m / (inverse[i] + inverse[j])
    )
    return replace(system, damping_n_s_per_m=np.maximum(system.damping_n_s_per_m, critical))


def _followed(integrator, start, cancelled):
    """The motion of the damped formation, followed from the circle in the eccentricity."""
    system, target = integrator.system, integrator.system.law_parameters["eccentricity"]
    _, r = rows_of(system, start)
    before, x, e = None, integrator.scaled(np.zeros_like(r), r), 0.0
    step, drive = FIRST_STEP, 0.0
    while e < target:
        trial = min(e + step, target)
        there = on_mean_circle(system, trial) if trial < target else system
        guess = x if before is None else x + (x - before[1]) * (trial - e) / (e - before[0])
        residual, why = math.inf, ""
        try:
            guess = ClosedMotion(guess, drive, math.inf, 0.0)
            found = _best(_of(integrator, damped(there)), guess, cancelled)
            residual = found.residual
        except IntegrationError as error:
            why = f": {error}"
        if residual > CLOSED:
            step *= 0.5
            if step < SMALLEST_STEP:
                raise IntegrationError(
                    f"the motion was followed from the circle to an eccentricity of {e:.4g},"
                    f" not beyond{why}"
                )
            continue
        before, x, e, drive = (e, x), found.x, trial, found.drive
    return found
