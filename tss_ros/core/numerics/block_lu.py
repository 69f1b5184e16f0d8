"""LU factorisation of matrices made of 3x3 blocks, one block row and column a bead.

Eliminating positions from a Newton iteration leaves one 3x3 block for every bead and one for every
tether. The elimination order and its fill are found once (minimum degree); the numbers are then
factored without any search, for real and complex matrices alike. On rings, chains and stars
work and memory grow linearly with the number of beads.
"""

import heapq
from typing import NamedTuple

import numpy as np
from numba import njit

from tss_ros.core.numerics.loops import add, assign
from tss_ros.core.numerics.simd import allocating, kernel, python_allocating, python_kernel


class Symbolic(NamedTuple):
    """Elimination order and fill of a matrix of blocks.

    Attributes
    ----------
    order : ndarray, shape (n,), int
        Bead eliminated at each stage.
    start : ndarray, shape (n + 1,), int
        Range of that bead's later neighbours in `neighbour`, `lower` and `upper`.
    neighbour, lower, upper : ndarray, shape (pairs,), int
        Their bead, and the blocks left below and right of the pivot.
    target, target_start : ndarray, int
        For every pair of them the block their product is subtracted from, from `target_start` (n,).
    pair : ndarray, shape (m, 2), int
        Blocks (i, j) and (j, i) of each tether.
    row, column : ndarray, shape (entries,), int
        The place of every block of the matrix itself, the n diagonal ones first.
    blocks : int
        Their number together with those that only elimination fills.
    """

    order: np.ndarray
    start: np.ndarray
    neighbour: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    target: np.ndarray
    target_start: np.ndarray
    pair: np.ndarray
    row: np.ndarray
    column: np.ndarray
    blocks: int


def analyse(beads: int, ends: np.ndarray) -> Symbolic:
    """Find elimination order and fill for a tether graph.

    Parameters
    ----------
    beads : int
        Number of beads n.
    ends : ndarray, shape (m, 2), int
        The two beads each tether joins.

    Returns
    -------
    Symbolic
    """
    index = {(i, i): i for i in range(beads)}

    def block(i, j):
        return index.setdefault((i, j), len(index))

    pair = [(block(i, j), block(j, i)) for i, j in ends]
    row, column = np.array(list(index), dtype=np.int64).T.copy()
    adjacent = [set() for _ in range(beads)]
    for i, j in ends:
        adjacent[i].add(int(j))
        adjacent[j].add(int(i))
    order, start, neighbour, lower, upper, target, target_start = [], [0], [], [], [], [], []
    queue = [(len(adjacent[i]), i) for i in range(beads)]
    heapq.heapify(queue)
    while queue:
        degree, pivot = heapq.heappop(queue)
        if adjacent[pivot] is None or degree != len(adjacent[pivot]):
            continue
        later, adjacent[pivot] = sorted(adjacent[pivot]), None
        order.append(pivot)
        target_start.append(len(target))
        for i in later:
            adjacent[i].discard(pivot)
            adjacent[i].update(j for j in later if j != i)
            heapq.heappush(queue, (len(adjacent[i]), i))
            neighbour.append(i)
            lower.append(block(i, pivot))
            upper.append(block(pivot, i))
        target.extend(block(i, j) for i in later for j in later)
        start.append(len(neighbour))
    as_array = [
        np.array(values, dtype=np.int64)
        for values in (order, start, neighbour, lower, upper, target, target_start)
    ]
    return Symbolic(
        *as_array, pair=np.array(pair, dtype=np.int64), row=row, column=column, blocks=len(index)
    )


@njit(inline="always")  # For lanes and for numbers, whose kernels allocate.
def _substitute(symbolic, factored, b, room, subtract_product, apply):
    """Forward and backward substitution in place, for right-hand sides of any kind."""
    for k in range(symbolic.order.size):
        y = b[symbolic.order[k]]
        for p in range(symbolic.start[k], symbolic.start[k + 1]):
            subtract_product(b[symbolic.neighbour[p]], factored[symbolic.lower[p]], y, room)
    for k in range(symbolic.order.size - 1, -1, -1):
        y = b[symbolic.order[k]]
        for p in range(symbolic.start[k], symbolic.start[k + 1]):
            subtract_product(y, factored[symbolic.upper[p]], b[symbolic.neighbour[p]], room)
        apply(factored[symbolic.order[k]], y, room)


@python_kernel
def factor(symbolic, matrix):
    """Factor in place: diagonal blocks become their inverses, lower blocks the multipliers.

    Parameters
    ----------
    symbolic : Symbolic
    matrix : ndarray, shape (blocks, 3, 3), float or complex
        Blocks of the matrix; blocks that are pure fill must be zero on entry.
    """
    for k in range(symbolic.order.size):
        inverse = matrix[symbolic.order[k]]
        _invert3(inverse)
        first, last = symbolic.start[k], symbolic.start[k + 1]
        for p in range(first, last):
            low = matrix[symbolic.lower[p]]
            for row in range(3):
                a, b, c = low[row, 0], low[row, 1], low[row, 2]
                for col in range(3):
                    low[row, col] = a * inverse[0, col] + b * inverse[1, col] + c * inverse[2, col]
            goal = symbolic.target_start[k] + (p - first) * (last - first)
            for q in range(first, last):
                up = matrix[symbolic.upper[q]]
                out = matrix[symbolic.target[goal + q - first]]
                for row in range(3):
                    a, b, c = low[row, 0], low[row, 1], low[row, 2]
                    for col in range(3):
                        out[row, col] -= a * up[0, col] + b * up[1, col] + c * up[2, col]


@python_kernel
def solve(symbolic, factored, b):
    """Solve for one right-hand side in place.

    Parameters
    ----------
    symbolic : Symbolic
    factored : ndarray, shape (blocks, 3, 3)
        As `factor` leaves it.
    b : ndarray, shape (n, 3)
        Right-hand side on entry, solution on return.
    """
    # The loops of `_substitute` once more: Newton's iteration spends its time here, and a sum that
    # stays in registers is quicker.
    beads = symbolic.order.size
    for k in range(beads):
        y = b[symbolic.order[k]]
        y0, y1, y2 = y[0], y[1], y[2]
        for p in range(symbolic.start[k], symbolic.start[k + 1]):
            low = factored[symbolic.lower[p]]
            out = b[symbolic.neighbour[p]]
            for row in range(3):
                out[row] -= low[row, 0] * y0 + low[row, 1] * y1 + low[row, 2] * y2
    for k in range(beads - 1, -1, -1):
        y = b[symbolic.order[k]]
        y0, y1, y2 = y[0], y[1], y[2]
        for p in range(symbolic.start[k], symbolic.start[k + 1]):
            up = factored[symbolic.upper[p]]
            x = b[symbolic.neighbour[p]]
            y0 -= up[0, 0] * x[0] + up[0, 1] * x[1] + up[0, 2] * x[2]
            y1 -= up[1, 0] * x[0] + up[1, 1] * x[1] + up[1, 2] * x[2]
            y2 -= up[2, 0] * x[0] + up[2, 1] * x[1] + up[2, 2] * x[2]
        inverse = factored[symbolic.order[k]]
        for row in range(3):
            y[row] = inverse[row, 0] * y0 + inverse[row, 1] * y1 + inverse[row, 2] * y2


@kernel
def solve_columns(symbolic, factored, b):
    """Solve for many right-hand sides in place.

    Parameters
    ----------
    symbolic : Symbolic
    factored : ndarray, shape (blocks, 3, 3)
    b : ndarray, shape (n, 3, columns)
        Right-hand sides on entry, solutions on return.
    """
    _substitute(symbolic, factored, b, 0, _subtract_product3, _apply_to_columns3)


@python_allocating
def factor_wide(symbolic, matrix):
    """`factor` for blocks of any width.

    Parameters
    ----------
    symbolic : Symbolic
    matrix : ndarray, shape (blocks, w, w)
    """
    room = np.empty(matrix.shape[1:])
    for k in range(symbolic.order.size):
        inverse = matrix[symbolic.order[k]]
        assign(inverse, np.linalg.inv(inverse))
        first, last = symbolic.start[k], symbolic.start[k + 1]
        for p in range(first, last):
            low = matrix[symbolic.lower[p]]
            np.dot(low, inverse, room)
            assign(low, room)
            goal = symbolic.target_start[k] + (p - first) * (last - first)
            for q in range(first, last):
                out = matrix[symbolic.target[goal + q - first]]
                _subtract_product(out, low, matrix[symbolic.upper[q]], room)


@python_allocating
def solve_wide(symbolic, factored, b):
    """`solve_columns` for blocks of any width.

    Parameters
    ----------
    symbolic : Symbolic
    factored : ndarray, shape (blocks, w, w)
    b : ndarray, shape (n, w, columns)
        Right-hand sides on entry, solutions on return.
    """
    room = np.empty(b.shape[1:])
    _substitute(symbolic, factored, b, room, _subtract_product, _apply)


@kernel
def _invert3(a):
    c00 = a[1, 1] * a[2, 2] - a[1, 2] * a[2, 1]
    c01 = a[1, 2] * a[2, 0] - a[1, 0] * a[2, 2]
    c02 = a[1, 0] * a[2, 1] - a[1, 1] * a[2, 0]
    d = 1.0 / (a[0, 0] * c00 + a[0, 1] * c01 + a[0, 2] * c02)
    c10 = a[0, 2] * a[2, 1] - a[0, 1] * a[2, 2]
    c11 = a[0, 0] * a[2, 2] - a[0, 2] * a[2, 0]
    c12 = a[0, 1] * a[2, 0] - a[0, 0] * a[2, 1]
    c20 = a[0, 1] * a[1, 2] - a[0, 2] * a[1, 1]
    c21 = a[0, 2] * a[1, 0] - a[0, 0] * a[1, 2]
    c22 = a[0, 0] * a[1, 1] - a[0, 1] * a[1, 0]
    a[0, 0], a[0, 1], a[0, 2] = c00 * d, c10 * d, c20 * d
    a[1, 0], a[1, 1], a[1, 2] = c01 * d, c11 * d, c21 * d
    a[2, 0], a[2, 1], a[2, 2] = c02 * d, c12 * d, c22 * d


@kernel
def _subtract_product3(out, a, b, _):
    """out -= a @ b for a (3, 3), b and out (3, columns)."""
    for row in range(3):
        a0, a1, a2 = a[row, 0], a[row, 1], a[row, 2]
        for c in range(b.shape[1]):
            out[row, c] -= a0 * b[0, c] + a1 * b[1, c] + a2 * b[2, c]


@kernel
def _apply_to_columns3(inverse, y, _):
    for c in range(y.shape[1]):
        y0, y1, y2 = y[0, c], y[1, c], y[2, c]
        for row in range(3):
            y[row, c] = inverse[row, 0] * y0 + inverse[row, 1] * y1 + inverse[row, 2] * y2


@allocating
def _subtract_product(out, a, b, room):
    np.dot(a, b, room)
    add(out, -1.0, room)


@allocating
def _apply(inverse, y, room):
    np.dot(inverse, y, room)
    assign(y, room)
