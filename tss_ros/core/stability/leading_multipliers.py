"""Leading multipliers of long rings, without ever forming the matrix.

The monodromy matrix is known by its action: displacements carried over a turn. Block Arnoldi
iteration (Y. Saad, Numerical Methods for Large Eigenvalue Problems, ch. 6) finds the multipliers
that stand out of the others; where a long ring's all lie on the unit circle, none does.
"""

import math

import numpy as np

from tss_ros.core.motion.displacements import carry

#: Displacements carried together, half of them in the orbit plane and half out of it.
BLOCK = 16
#: Most turns that are integrated for the multipliers.
MOST_TURNS = 40
#: Applications of the map between two looks at what the space holds.
LOOK = 4
#: Residual |M v - rho v| at which a multiplier counts as found, |v| = 1, over |rho|.
CONVERGED = 1e-6


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
