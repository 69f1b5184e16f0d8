"""Families of motion that Floquet multipliers belong to, told by the structure of the motion.

In a motion that stays in the orbit plane, displacements in the plane and out of it know nothing of
each other: the matrix falls into two, each with multipliers and vectors of its own. What a rigid
body does is known in each. A displacement of the whole formation stays one, exactly in linear
gravity. A shift along the motion itself comes back after a turn, so that its multiplier is 1; with
the spin rate it makes a Jordan block. Out of the plane a tilt moves beads in proportion to their
place in the plane. What is left is shape.

A formation that hangs at rest in the orbit frame has librations instead of spin and tilt: it swings
as a rigid body about its equilibrium, in the orbit plane and out of it.
"""

from __future__ import annotations

import numpy as np

from tss_ros.core.model.axes import spin_axis_of
from tss_ros.core.model.feedback import feeds_back
from tss_ros.core.model.frames import crossed, turn_to
from tss_ros.core.model.system import State, System
from tss_ros.core.motion.integrator import Integrator
from tss_ros.core.stability.shooting import flow_direction

FAMILIES = ("centre of mass", "spin", "axis tilt", "shape", "libration")
#: How near to 1 the spin's multipliers are, in |ln rho|, and how near counts as no distance: those
#: of overdamped tethers come close, and then turn with the spin as they relax.
NEAR_ONE, AT_ONE = 0.01, 1e-4
#: Multipliers that are lost in rounding, and so their vectors.
LOST = 1e-10
#: A formation this flat, over its radius, has no axis about which to tilt that way: the line of a
#: chain is bent by this and less.
FLAT = 0.05
#: Relative distance from the circle, and from each other's mirror images there, by which
#: multipliers that meet in a resonance are told.
SAME = 1e-4


def multipliers(
    matrix: np.ndarray, planar: bool, real: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Eigenvalues and eigenvectors of a monodromy matrix, Eqs. (25) and (27).

    Parameters
    ----------
    matrix : ndarray, shape (6 rows, 6 rows)
        In scaled coordinates, velocities first.
    planar : bool
        Whether the motion stays in the orbit plane: vectors are in it or out of it, then.
    real : ndarray, shape (6 rows,), bool, optional
        Which of the coordinates are some, `Integrator.real`; all if not given.

    Returns
    -------
    multiplier : ndarray, shape (k,), complex
        One for each of them: 6n, and two for each rest length that is a state.
    vectors : ndarray, shape (6 rows, k), complex
        Columns, of norm 1.
    """
    real = np.ones(len(matrix), dtype=bool) if real is None else real
    above, count = (np.arange(len(matrix)) % 3 == 2) & planar, np.count_nonzero(real)
    value, vectors = np.empty(count, complex), np.zeros((len(matrix), count), complex)
    first = 0
    for rows in (np.flatnonzero(real & ~above), np.flatnonzero(real & above)):
        part = slice(first, first + rows.size)
        value[part], vectors[rows, part] = np.linalg.eig(matrix[np.ix_(rows, rows)])
        first += rows.size
    return value, vectors


def stays_in_plane(system: System, state: State) -> bool:
    """Whether the motion from a state stays in the orbit plane."""
    flat = not (state.position_m[:, 2].any() or state.velocity_m_s[:, 2].any())
    return bool(system.keeps_plane and flat)


def label(
    integrator: Integrator,
    state: State,
    multiplier: np.ndarray,
    vectors: np.ndarray,
    exponent: np.ndarray | None = None,
) -> np.ndarray:
    """Family of every multiplier.

    Parameters
    ----------
    integrator : Integrator
    state : State
        At which the vectors are taken.
    multiplier : ndarray, shape (k,), complex
        All of them or some.
    vectors : ndarray, shape (6 rows, k), complex
        Eigenvectors, columns in scaled coordinates, velocities first.
    exponent : ndarray, shape (k,), complex, optional
        ln of the multipliers where it is known to whole cycles; else the nearest to zero.

    Returns
    -------
    ndarray, shape (k,), str
        Values of `FAMILIES`. A planar formation has 6, 2, 4 (a straight one 2) and the rest. What
        rest lengths add counts as shape.
    """
    n, planar = integrator.system.n, stays_in_plane(integrator.system, state)
    weight = np.sqrt(integrator.system.mass_kg / np.mean(integrator.system.mass_kg))[:, None]
    axis = spin_axis_of(integrator.system, state, integrator.spin)
    turning = of_beads(integrator, in_turning_frame(integrator, axis, vectors))
    halves = (turning * weight[None, :, :, None]).reshape(2, 3 * n, -1)
    whole = np.sum(np.abs(halves) ** 2, axis=(0, 1))
    above = np.sum(np.abs(halves[:, 2::3]) ** 2, axis=(0, 1)) > 0.5 * whole
    moves = (weight[None] * np.eye(3)[:, None]).reshape(3, -1)
    every = multiplier.size == np.count_nonzero(integrator.real)
    alive = (np.abs(multiplier) > LOST) & (whole > 0.0)
    whole = np.where(whole > 0.0, whole, 1.0)
    names = np.full(multiplier.size, FAMILIES[3], dtype=object)

    def take(family, score, room, sure, allowed):
        """Name the best of the shapes that are allowed, the sure ones if not all are known."""
        free = np.flatnonzero((names == FAMILIES[3]) & alive & allowed)
        best = free[np.argsort(-score[free], kind="stable")][:room]
        names[best if every else best[sure[best]]] = family

    moved = _share(moves, halves) / whole
    for allowed, room in ((~above, 4), (above, 2)) if planar else ((alive, 6),):
        take(FAMILIES[0], moved, room, moved > 0.5, allowed)
    if exponent is None:
        exponent = np.log(np.where(alive, multiplier, 1.0))
    along = _along(integrator, state, axis, weight, halves) / whole
    at_one = (FLAT + along) / (AT_ONE + np.abs(exponent))
    sure = (along > 0.5) & (np.abs(exponent) < NEAR_ONE)
    # Thrusters may let spin and tilt decay until they are lost: then nothing takes their place.
    fed_back = feeds_back(integrator.system)
    there = (along > 0.5) | (np.abs(exponent) < NEAR_ONE) | (not fed_back)
    take(FAMILIES[1], at_one, 2, sure, there & (~above if planar else alive))
    tilts = _tilts(integrator.system.mass_kg, state.position_m, axis, weight)
    tilted = _one_in_resonance(multiplier, _share(tilts, halves) / whole)
    there = (tilted > 0.5) | (not fed_back)
    take(FAMILIES[2], tilted, 2 * len(tilts), tilted > 0.5, there & (above if planar else alive))
    return names


def label_hanging(system: System, state: State, vectors: np.ndarray, planar: bool) -> np.ndarray:
    """Family of every mode of a formation that hangs.

    Parameters
    ----------
    system : System
    state : State
        The equilibrium.
    vectors : ndarray, shape (6 rows, k), complex
        Columns in scaled coordinates, velocities first.
    planar : bool
        Whether they are in the orbit plane or out of it.

    Returns
    -------
    ndarray, shape (k,), str
        6 of the centre of mass, 6 librations (a straight chain 4), and the rest shape, as what rest
        lengths add.
    """
    n = system.n
    weight = np.sqrt(system.mass_kg / np.mean(system.mass_kg))[:, None]
    beads = vectors.reshape(2, len(vectors) // 6, 3, -1)[:, :n]
    halves = (beads * weight[None, :, :, None]).reshape(2, 3 * n, -1)
    whole = np.sum(np.abs(halves) ** 2, axis=(0, 1))
    whole = np.where(whole > 0.0, whole, 1.0)
    above = np.sum(np.abs(halves[:, 2::3]) ** 2, axis=(0, 1)) > 0.5 * whole
    arm = state.position_m - np.average(state.position_m, axis=0, weights=system.mass_kg)
    about = (weight * np.cross(np.eye(3)[:, None], arm)).reshape(3, -1)
    moves = (weight[None] * np.eye(3)[:, None]).reshape(3, -1)
    every = np.ones(3, dtype=bool)
    parts = [(above, [False, False, True], [True, True, False])]
    parts.append((~above, ~np.array(parts[0][1]), ~np.array(parts[0][2])))
    names = np.full(vectors.shape[1], FAMILIES[3], dtype=object)
    for allowed, along, turns in parts if planar else [(every.any(), every, every)]:
        _, size, axes = np.linalg.svd(about[turns], full_matrices=False)
        turned = axes[size > FLAT * np.linalg.norm(about) / 3.0]
        for family, basis in ((FAMILIES[0], moves[along]), (FAMILIES[4], turned)):
            free = np.flatnonzero((names == FAMILIES[3]) & allowed)
            share = _share(basis, halves[:, :, free]) / whole[free]
            names[free[np.argsort(-share, kind="stable")][: 2 * len(basis)]] = family
    return names


def _share(basis, halves):
    """Squared length of the part of every vector that lies in rows (b, 3n), positions and speeds.

    Rows are made orthonormal.
    """
    basis = np.linalg.qr(basis.T)[0].T
    return np.sum(np.abs(basis @ halves) ** 2, axis=(0, 1))


def of_beads(integrator: Integrator, vectors: np.ndarray) -> np.ndarray:
    """The part of vectors (6 rows, k) that is of beads, (2, n, 3, k)."""
    return vectors.reshape(2, integrator.rows, 3, -1)[:, : integrator.system.n]


def in_turning_frame(
    integrator: Integrator, axis: np.ndarray, vectors: np.ndarray, back: bool = False
) -> np.ndarray:
    """Vectors (6 rows, ...) as seen in the frame that turns with the spin about an axis.

    Those of an integrator whose frame turns are so already. Frames coincide at the time of the
    vectors, so that velocities alone differ. `back` does the inverse.
    """
    if integrator.arrays.spin or not integrator.spin:
        return vectors
    v, r = vectors.reshape(2, integrator.rows, 3, -1)
    share = integrator.spin * integrator.settings.length / integrator.settings.speed
    share *= -1.0 if back else 1.0
    return np.stack([v - share * (crossed(axis) @ r), r]).reshape(vectors.shape)


def _along(integrator, state, axis, weight, halves):
    """The same for the part along the motion, the whole formation's displacement left out."""
    flow = in_turning_frame(integrator, axis, flow_direction(integrator, state))
    flow = of_beads(integrator, flow)[..., 0]
    flow = weight * (flow - np.mean(weight**2 * flow, axis=1, keepdims=True))
    return np.abs(flow.ravel() @ halves.reshape(flow.size, -1)) ** 2 / np.sum(flow**2)


def _tilts(mass, position, axis, weight):
    """Weighted displacements (b, 3n) of turns about axes across the spin, of those there are."""
    arm = position - np.average(position, axis=0, weights=mass)
    fields = np.array([np.cross(across, arm) for across in turn_to(axis)[:, :2].T])
    _, size, axes = np.linalg.svd((weight * fields).reshape(2, -1), full_matrices=False)
    return axes[size > FLAT * size[0]]


def _one_in_resonance(multiplier, score):
    """The score of modes that meet in a resonance is one, a little more for those that grow.

    Off the circle multipliers of a motion in the plane come by four, or two if real, made of two
    modes in equal parts.
    """
    shared, modulus = score.copy(), np.abs(multiplier)
    for i in np.flatnonzero((np.abs(modulus - 1.0) > SAME) & (modulus > LOST) & (score > 0.0)):
        rho = multiplier[i]
        partners = (rho, rho.conjugate(), 1.0 / rho, 1.0 / rho.conjugate())
        apart = np.min([np.abs(multiplier / other - 1.0) for other in partners], axis=0)
        shared[i] = np.mean(score[apart < SAME]) + SAME * (modulus[i] > 1.0)
    return shared
