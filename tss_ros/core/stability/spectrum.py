"""The multipliers of a motion with all that is said of them: family, errors, verdict."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from tss_ros.core.model.system import State
from tss_ros.core.motion.integrator import Integrator
from tss_ros.core.stability.judge import DRIVEN, Judgement, drift_radius, judge
from tss_ros.core.stability.modes import label, multipliers, stays_in_plane
from tss_ros.core.stability.shooting import flow_direction


@dataclass(frozen=True)
class Spectrum:
    """Multipliers of one turn.

    Attributes
    ----------
    multiplier : ndarray, shape (6n,), complex
    vectors : ndarray, shape (6n, 6n), complex
        Columns in scaled coordinates, velocities first.
    family : ndarray, shape (6n,), str
    judgement : Judgement
    radius : float
        See `judge.drift_radius`.
    flow_error : float
        See `FloquetResult`.
    """

    multiplier: np.ndarray
    vectors: np.ndarray
    family: np.ndarray
    judgement: Judgement
    radius: float
    flow_error: float

    @property
    def outside(self) -> np.ndarray:
        """Which multipliers lie outside the unit circle, centre of mass left out; (6n,) bool."""
        beyond, family = np.abs(self.multiplier) - 1.0, self.family
        held = (family == "axis tilt") | (family == "shape")
        return (held & (beyond > self.judgement.tolerance)) | (
            (family == "spin") & (beyond > self.radius)
        )


def spectrum(
    integrator: Integrator,
    start: State,
    end: State | None,
    matrix: np.ndarray,
    residual: float,
    loss: float,
) -> Spectrum:
    """The multipliers of a turn and what is said of them.

    Parameters
    ----------
    integrator : Integrator
        With the drive that closes the motion, if there is one.
    start : State
    end : State or None
        After the turn, to measure the matrix's error by; None if it is not to be measured.
    matrix : ndarray, shape (6 rows, 6 rows)
        Monodromy matrix, Eq. (26).
    residual : float
        Of the equations that the motion was to solve.
    loss : float
        Share of the spin that the drive, or feedback, gives in a turn.

    Returns
    -------
    Spectrum
    """
    planar = stays_in_plane(integrator.system, start)
    multiplier, vectors = multipliers(matrix, planar, integrator.real)  # Eqs. (25) and (27)
    family = label(integrator, start, multiplier, vectors)
    error, flow_error = integrator.rtol, math.nan
    if end is not None:
        before, after = (flow_direction(integrator, state) for state in (start, end))
        # M f(x(0)) = f(x(T)) with f the orbit frame's autonomous flow, Eq. (28).
        left = matrix @ before - after
        error = flow_error = float(np.max(np.abs(left)) / np.max(np.abs(before)))
    ratio = integrator.spin / integrator.system.orbit_rate_rad_s
    drift = DRIVEN * abs(ratio) * integrator.lost(loss)
    radius = drift_radius(residual, drift, error * float(np.linalg.norm(matrix, 2)))
    above = planar & (vectors[2::3] != 0.0).any(axis=0)
    judgement = judge(multiplier, family, radius, True, drift=drift, above=above)
    return Spectrum(multiplier, vectors, family, judgement, radius, flow_error)
