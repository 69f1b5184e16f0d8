"""Where multipliers out of the orbit plane may meet between two spin rates.

Displacements out of the plane of a planar motion are a Hamiltonian system: their multipliers leave
the unit circle only where two of opposite kind meet there (M. G. Krein; V. A. Yakubovich and V. M.
Starzhinskii, Linear Differential Equations with Periodic Coefficients, 1975). So a pair that
passes each other between two samples tells of a band of instability that may lie between them,
however narrow.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import linear_sum_assignment

from tss_ros.core.model.system import System
from tss_ros.core.stability.result import FloquetResult

#: Distance from the circle within which a multiplier counts as lying on it.
ON_CIRCLE = 1e-5
#: How far apart [rad] two of opposite kind may be before and after they pass each other.
NEAR = 1.0


def may_meet(system: System, a: FloquetResult, b: FloquetResult) -> bool:
    """Whether multipliers of opposite kind pass each other between two results.

    Parameters
    ----------
    system : System
    a, b : FloquetResult
        At rates next to each other, of planar motions.

    Returns
    -------
    bool
        False if one of them has multipliers out of the plane that are off the circle.
    """
    before, after = _first_kind(system, a), _first_kind(system, b)
    if before is None or after is None:
        return False
    (phase, vectors), (later, also) = before, after
    rows, columns = linear_sum_assignment(-np.abs(_form(system, vectors, also)))
    if rows.size < phase.size:
        return False
    later = later[columns[np.argsort(rows)]]
    sums, then = (_wrapped(p[:, None] + p[None, :]) for p in (phase, later))
    passed = (sums * then < 0.0) & (np.abs(sums) < NEAR) & (np.abs(then) < NEAR)
    return bool(np.any(passed))


def _first_kind(system, result):
    """Phases (n,) and vectors (2n, n) of the multipliers of first kind, out of the plane."""
    out, rows = np.empty((0, 0)), len(result.vectors) // 6
    if rows:
        out = result.vectors.reshape(2, rows, 3, -1)[:, : system.n, 2].reshape(2 * system.n, -1)
    whole = np.sum(np.abs(result.vectors) ** 2, axis=0) if out.size else np.empty(0)
    above = np.flatnonzero(np.sum(np.abs(out) ** 2, axis=0) > 0.999 * whole) if out.size else []
    if len(above) != 2 * system.n:
        return None
    rho, vectors = result.multiplier[above], out[:, above]
    if np.max(np.abs(np.abs(rho) - 1.0)) > ON_CIRCLE:
        return None
    first = np.flatnonzero(np.imag(np.diag(_form(system, vectors, vectors))) > 0.0)
    return (np.angle(rho[first]), vectors[:, first]) if first.size == system.n else None


def _form(system, one, other):
    """The Hermitian symplectic form of columns (2n, j) and (2n, k), velocities first: (j, k)."""
    n, mass = system.n, system.mass_kg[:, None]
    return one[n:].conj().T @ (mass * other[:n]) - one[:n].conj().T @ (mass * other[n:])


def _wrapped(angle):
    return (angle + np.pi) % (2.0 * np.pi) - np.pi
