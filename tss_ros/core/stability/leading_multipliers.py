"""Leading multipliers of long rings, without ever forming the matrix.

The monodromy matrix is known by its action: displacements carried over a turn. Block Arnoldi
iteration finds the multipliers
that stand out of the others; where a long ring's all lie on the unit circle, none does.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from tss_ros.core.model.system import State
from tss_ros.core.motion.displacements import carry_displacements
from tss_ros.core.motion.integrator import Integrator
from tss_ros.core.numerics.arnoldi import arnoldi

#: Displacements carried together, half of them in the orbit plane and half out of it.
BLOCK = 16
#: Most turns that are integrated for the multipliers.
MOST_TURNS = 40
#: Applications of the map between two looks at what the space holds.
LOOK = 4
#: Residual |M v - rho v| at which a multiplier counts as found, |v| = 1, over |rho|.
CONVERGED = 1e-6


def leading_multipliers(
    integrator: Integrator, state: State, count: int, cancelled: Callable[[], bool] | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray, int]:
    """The multipliers of largest modulus, as far as they stand out.

    Parameters
    ----------
    integrator : Integrator
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
        As `carry_displacements`.
    """
    half = 3 * integrator.system.n
    start = np.random.default_rng(0).standard_normal((2, half // 3, 3, BLOCK))
    start[:, :, 2, : BLOCK // 2] = start[:, :, :2, BLOCK // 2 :] = 0.0

    def over_a_turn(block):
        begin, period = integrator.begin(state), integrator.period_s
        return carry_displacements(integrator, begin, block, period, cancelled, BLOCK // 2)[1]

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
