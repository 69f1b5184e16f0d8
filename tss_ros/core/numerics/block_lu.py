"""LU factorisation of matrices made of 3x3 blocks, one block row and column a bead.

Eliminating positions from a Newton iteration leaves one 3x3 block for every bead and one for every
tether. The elimination order and its fill are found once (minimum degree); the numbers are then
factored without any search, for real and complex matrices alike. On rings, chains and stars
work and memory grow linearly with the number of beads.
"""

import heapq
from collections import namedtuple

import numpy as np
from numba import njit

from tss_ros.core.numerics.simd import kernel

#: order (n,): bead eliminated at each stage. start (n+1,): range of that bead's later neighbours
#: in `neighbour`, `lower` and `upper` (their bead and the blocks left below and right of the
#: pivot). target: for every pair of them the block their product is subtracted from, from
#: target_start (n,). pair (m,2): blocks (i,j) and (j,i) of each tether. row, column (entries,): the
#: place of every block of the matrix itself, the n diagonal ones first. blocks: their number
#: together with those that only elimination fills.
Symbolic = namedtuple(
    "Symbolic", "order start neighbour lower upper target target_start pair row column blocks"
)


def analyse(beads, ends):
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
    return Symbolic(*as_array, np.array(pair, dtype=np.int64), row, column, len(index))


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


@kernel
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
    beads, columns = symbolic.order.size, b.shape[2]
    for k in range(beads):
        y = b[symbolic.order[k]]
        for p in range(symbolic.start[k], symbolic.start[k + 1]):
            low = factored[symbolic.lower[p]]
            out = b[symbolic.neighbour[p]]
            for row in range(3):
                a0, a1, a2 = low[row, 0], low[row, 1], low[row, 2]
                for c in range(columns):
                    out[row, c] -= a0 * y[0, c] + a1 * y[1, c] + a2 * y[2, c]
    for k in range(beads - 1, -1, -1):
        y = b[symbolic.order[k]]
        for p in range(symbolic.start[k], symbolic.start[k + 1]):
            up = factored[symbolic.upper[p]]
            x = b[symbolic.neighbour[p]]
            for row in range(3):
                a0, a1, a2 = up[row, 0], up[row, 1], up[row, 2]
                for c in range(columns):
                    y[row, c] -= a0 * x[0, c] + a1 * x[1, c] + a2 * x[2, c]
        inverse = factored[symbolic.order[k]]
        for c in range(columns):
            y0, y1, y2 = y[0, c], y[1, c], y[2, c]
            for row in range(3):
                y[row, c] = inverse[row, 0] * y0 + inverse[row, 1] * y1 + inverse[row, 2] * y2


@njit(cache=True, nogil=True, error_model="numpy")
def factor_wide(symbolic, matrix):
    """`factor` for blocks of any width.

    Parameters
    ----------
    symbolic : Symbolic
    matrix : ndarray, shape (blocks, w, w)
    """
    product = np.empty(matrix.shape[1:])
    for k in range(symbolic.order.size):
        inverse = matrix[symbolic.order[k]]
        inverse[:] = np.linalg.inv(inverse)
        first, last = symbolic.start[k], symbolic.start[k + 1]
        for p in range(first, last):
            low = matrix[symbolic.lower[p]]
            np.dot(low, inverse, product)
            low[:] = product
            goal = symbolic.target_start[k] + (p - first) * (last - first)
            for q in range(first, last):
                np.dot(low, matrix[symbolic.upper[q]], product)
                _subtract(matrix[symbolic.target[goal + q - first]], product)


@njit(cache=True, nogil=True, error_model="numpy")
def solve_wide(symbolic, factored, b):
    """`solve_columns` for blocks of any width.

    Parameters
    ----------
    symbolic : Symbolic
    factored : ndarray, shape (blocks, w, w)
    b : ndarray, shape (n, w, columns)
        Right-hand sides on entry, solutions on return.
    """
    beads = symbolic.order.size
    product = np.empty(b.shape[1:])
    for k in range(beads):
        for p in range(symbolic.start[k], symbolic.start[k + 1]):
            np.dot(factored[symbolic.lower[p]], b[symbolic.order[k]], product)
            _subtract(b[symbolic.neighbour[p]], product)
    for k in range(beads - 1, -1, -1):
        y = b[symbolic.order[k]]
        for p in range(symbolic.start[k], symbolic.start[k + 1]):
            np.dot(factored[symbolic.upper[p]], b[symbolic.neighbour[p]], product)
            _subtract(y, product)
        np.dot(factored[symbolic.order[k]], y, product)
        y[:] = product


@kernel
def _subtract(y, x):
    """y -= x; plain loops compile several times faster than array differences."""
    for i in range(y.shape[0]):
        for c in range(y.shape[1]):
            y[i, c] -= x[i, c]
