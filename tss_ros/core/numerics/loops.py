"""Plain loops over arrays: they compile several times faster than array expressions.

They take arrays of two dimensions as they are; to reshape one costs as much as a short loop.
"""

from tss_ros.core.numerics.simd import kernel


@kernel
def add(y, weight, x):
    """y += weight * x for arrays of two dimensions."""
    for i in range(y.shape[0]):
        for j in range(y.shape[1]):
            y[i, j] += weight * x[i, j]


@kernel
def sum_of(x, y, out):
    """Write x + y for arrays of two dimensions."""
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            out[i, j] = x[i, j] + y[i, j]


@kernel
def assign(out, x):
    """Write x; `out[:] = x` would also compile the words that say which shapes do not fit."""
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            out[i, j] = x[i, j]
