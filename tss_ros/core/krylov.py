"""Leading multipliers and periodic motions of long rings, without ever forming the matrix.

The monodromy matrix is known by its action: displacements carried over a turn. Block Arnoldi
iteration (Y. Saad, Numerical Methods for Large Eigenvalue Problems, ch. 6) finds the multipliers
that stand out of the others; where a long ring's all lie on the unit circle, none does.
"""

import contextlib
import math

import numpy as np

from tss_ros.core.errors import IntegrationError
from tss_ros.core.linear_flow import carry
from tss_ros.core.periodic import FREE_DIRECTION, from_scaled, to_scaled
from tss_ros.core.steady_state import rotating
from tss_ros.core.symmetry import cyclic_symmetry

#: Displacements carried together, half of them in the orbit plane and half out of it.
BLOCK = 16
#: Most turns that are integrated for the multipliers, and parts of turns for one correction.
MOST_TURNS, MOST_PARTS = 40, 64
#: Applications of the map between two looks at what the space holds.
LOOK = 4
#: Residual |M v - rho v| at which a multiplier counts as found, |v| = 1, over |rho|.
CONVERGED = 1e-6
#: Scaled closure of a part of a turn that is not corrected further.
CLOSED = 1e-6
#: Share of the closure that the linear equations of a correction may leave.
FORCING = 0.1


def arnoldi(apply, start, most):
    """Block Krylov space of a linear map, one application at a time.

    Parameters
    ----------
    apply : callable
        From displacements (N, b) to their images (N, b).
    start : ndarray, shape (N, b)
    most : int
        Number of applications.

    Yields
    ------
    basis : ndarray, shape (N, k)
        Orthonormal, k growing by at most b.
    image : ndarray, shape (N, k)
        What the map makes of it.
    """
    basis, image = np.empty((2, start.shape[0], 0))
    block = start
    for _ in range(most):
        for _ in range(2):
            block, _ = np.linalg.qr(block - basis @ (basis.T @ block))
        block = block[:, : start.shape[0] - basis.shape[1]]
        if not block.size:
            return
        basis = np.hstack([basis, block])
        block = apply(block)
        image = np.hstack([image, block])
        yield basis, image


def leading_multipliers(flow, state, count, cancelled=None):
    """The multipliers of largest modulus, as far as they stand out.

    Parameters
    ----------
    flow : Flow
    state : State
        Start of the turn.
    count : int
    cancelled : callable, optional

    Returns
    -------
    multiplier : ndarray, shape (count,), complex
        Largest modulus first.
    vectors : ndarray, shape (6n, count), complex
        Of norm 1.
    residual : ndarray, shape (count,)
        |M v - rho v|.
    turns : int
        That were integrated.

    Raises
    ------
    IntegrationError, Cancelled
        As `linear_flow.carry`.
    """
    half = 3 * flow.system.n
    period = 2.0 * math.pi / abs(flow.plant.spin)
    start = np.random.default_rng(0).standard_normal((2, half // 3, 3, BLOCK))
    start[:, :, 2, : BLOCK // 2] = start[:, :, :2, BLOCK // 2 :] = 0.0

    def over_a_turn(block):
        return carry(flow, flow.begin(state), block, period, cancelled, BLOCK // 2)[1]

    space = arnoldi(over_a_turn, start.reshape(2 * half, BLOCK), MOST_TURNS)
    for turns, (basis, image) in enumerate(space, 1):
        if turns % LOOK and basis.shape[1] < 2 * half:
            continue
        multiplier, vectors = np.linalg.eig(basis.T @ image)
        largest = np.argsort(-np.abs(multiplier), kind="stable")[:count]
        multiplier, vectors = multiplier[largest], vectors[:, largest]
        residual = np.linalg.norm(image @ vectors - (basis @ vectors) * multiplier, axis=0)
        if np.all(residual <= CONVERGED * np.abs(multiplier)):
            break
    return multiplier, basis @ vectors, residual, turns


def closed(flow, state, cancelled=None, iterations=8):
    """Shoot for the periodic motion next to `state`, or the one of least residual.

    Newton's iteration as in `periodic.corrected`, each correction from the Krylov space of the
    closure alone. Where equal satellites make the formation symmetric, a part of the turn is shot
    for.

    Parameters
    ----------
    flow : Flow
    state : State
    cancelled : callable, optional
    iterations : int
        Most corrections.

    Returns
    -------
    State
        Start of the best motion found.
    """
    symmetry = cyclic_symmetry(flow.system)
    part_s = 2.0 * math.pi / abs(flow.plant.spin) / symmetry.order
    scale = np.repeat([flow.control.speed, flow.control.length], 3 * flow.system.n)

    def over_a_part(state, block):
        motion, block = carry(flow, flow.begin(state), block, part_s, cancelled)
        end = np.concatenate([motion.v.ravel(), motion.r.ravel()]) / scale
        return [symmetry.back(flow.plant.spin < 0.0, x) for x in (end, block)]

    def closure(state):
        end, _ = over_a_part(state, np.empty((scale.size, 0)))
        return end - to_scaled(flow, state)

    left = closure(state)
    for _ in range(iterations):
        size = np.linalg.norm(left)
        if size < CLOSED:
            break
        start = np.column_stack([left, _rates(flow, state, symmetry.order > 1)])
        space = arnoldi(lambda x, at=state: over_a_part(at, x)[1], start, MOST_PARTS)
        for parts, (basis, image) in enumerate(space, 1):
            if parts % LOOK and basis.shape[1] < scale.size:
                continue
            u, s, vt = np.linalg.svd(image - basis, full_matrices=False)
            bound = s > FREE_DIRECTION
            along = u[:, bound].T @ left
            if np.linalg.norm(left - u[:, bound] @ along) <= FORCING * size:
                break
        change = -basis @ (vt[bound].T @ (along / s[bound]))
        change *= min(1.0, 0.2 / max(np.max(np.abs(change)), 1e-300))
        found = False
        for share in (1.0, 0.5, 0.25, 0.125):
            trial = from_scaled(flow, to_scaled(flow, state) + share * change)
            with contextlib.suppress(IntegrationError):
                after = closure(trial)
                if found := np.linalg.norm(after) < 0.9 * size:
                    break
        if not found:
            break
        state, left = trial, after
    return state


def _rates(flow, state, symmetric):
    """Displacements that make a motion drift, scaled (6n, k): spin, size, and whole formation.

    Where a motion comes back displaced along itself, what to change is its rate, which the Krylov
    space of that closure does not hold (Jordan blocks at 1).
    """
    r = state.position_m / flow.control.length
    around, zero = rotating(r, 1.0), np.zeros_like(r)
    pairs = [(around, zero), (zero, r)]
    if not symmetric:
        for axis in np.eye(3)[:2]:
            along = np.tile(axis, (len(r), 1))
            pairs += [(along, zero), (zero, along)]
    return np.stack([np.concatenate(pair).ravel() for pair in pairs], axis=1)
