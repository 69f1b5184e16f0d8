"""Block Arnoldi iteration (Y. Saad, Numerical Methods for Large Eigenvalue Problems, ch. 6)."""

from collections.abc import Callable, Iterator

import numpy as np


def arnoldi(
    apply: Callable[[np.ndarray], np.ndarray], start: np.ndarray, most: int
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
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
