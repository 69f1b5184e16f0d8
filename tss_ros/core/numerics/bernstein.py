"""Polynomials in Bernstein form on [0, 1], where no zero can hide between sampling points."""

import numpy as np
from scipy.special import comb

from tss_ros.core.numerics.simd import kernel

#: Most bisections in the search for a zero.
DEEPEST = 34


@kernel
def first_zero(pieces, count):
    """First point of [0, 1] where a polynomial in Bernstein form becomes negative, or 2.

    The polynomial is taken to start at or above zero. The convex hull of the coefficients bounds
    it, so a piece is passed over only when it provably has no zero; where they change sign once,
    there is one (Descartes), and Newton's method finds it.

    Parameters
    ----------
    pieces : ndarray, shape (DEEPEST + 2, at least count + 2)
        In the first row, the coefficients. Overwritten by those of each piece, with its beginning
        and width.
    count : int
        How many there are: degree + 1.

    Returns
    -------
    float
    """
    low, width = count, count + 1
    pieces[0, 0] = max(pieces[0, 0], 0.0)
    pieces[0, low], pieces[0, width] = 0.0, 1.0
    depth = 1
    while depth > 0:
        depth -= 1
        changes, positive = 0, pieces[depth, 0] >= 0.0
        for i in range(1, count):
            if (pieces[depth, i] >= 0.0) != positive:
                positive = not positive
                changes += 1
        if changes == 0 and positive:
            continue
        if changes == 1 and not positive:
            return pieces[depth, low] + pieces[depth, width] * _only_zero(pieces, depth, count - 1)
        if depth == DEEPEST:
            return pieces[depth, low] + pieces[depth, width]
        # De Casteljau's division: the left half goes on top, the right half stays.
        half = 0.5 * pieces[depth, width]
        for i in range(count):
            pieces[depth + 1, i] = pieces[depth, i]
        left = depth + 1
        for level in range(1, count):
            for i in range(count - 1, level - 1, -1):
                pieces[left, i] = 0.5 * (pieces[left, i] + pieces[left, i - 1])
            pieces[depth, count - 1 - level] = pieces[left, count - 1]
        pieces[left, low], pieces[left, width] = pieces[depth, low], half
        pieces[depth, low] += half
        pieces[depth, width] = half
        depth += 2
    return 2.0


@kernel
def _only_zero(pieces, which, degree):
    """The zero in [0, 1] of a polynomial whose Bernstein coefficients become negative once."""
    low, high, room = 0.0, 1.0, DEEPEST + 1
    x = pieces[which, 0] / (pieces[which, 0] - pieces[which, degree])
    for _ in range(60):
        for i in range(degree + 1):
            pieces[room, i] = pieces[which, i]
        for level in range(degree - 1):
            for i in range(degree - level):
                pieces[room, i] += x * (pieces[room, i + 1] - pieces[room, i])
        slope = pieces[room, 1] - pieces[room, 0]
        value = pieces[room, 0] + x * slope
        if value >= 0.0:
            low = x
        else:
            high = x
        before, x = x, x - value / (degree * slope) if slope < 0.0 else 0.5 * (low + high)
        if not low <= x <= high:
            x = 0.5 * (low + high)
        if abs(x - before) <= 1e-10:
            break
    return x


def from_monomials(degree: int) -> np.ndarray:
    """Matrix from monomial to Bernstein coefficients on [0, 1]."""
    i, k = np.mgrid[0 : degree + 1, 0 : degree + 1]
    return np.where(k <= i, comb(i, k) / comb(degree, k), 0.0)
