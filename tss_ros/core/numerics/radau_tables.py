"""Coefficients of the Radau IIA collocation methods, any odd number of stages (order 2 s - 1).

Reference: E. Hairer and G. Wanner, "Stiff differential equations solved by Radau methods",
J. Comput. Appl. Math. 111 (1999) 93-111.
"""

from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.polynomial import legendre

from tss_ros.core.numerics.bernstein import from_monomials
from tss_ros.core.numerics.simd import WIDTH


class Tables(NamedTuple):
    """Coefficients of a method of s = 2 p + 1 stages.

    Attributes
    ----------
    stages : int
    c : ndarray, shape (s,)
        Nodes.
    a, a_inverse : ndarray, shape (s, s)
        Runge-Kutta matrix and its inverse.
    nodes : ndarray, shape (S,)
        Nodes once more, 0 after the last one: stages side by side in lanes, S a multiple of W.
    integral, derivative : ndarray, shape (S, S)
        Transposes of `a` and `a_inverse`, with rows and columns of 0 alike.
    value : ndarray, shape (g, 2, W)
        Eigenvalues of `a_inverse`, real and imaginary parts, side by side in g blocks of lanes: the
        real one first, the p with positive imaginary part, the real one again where lanes are idle.
    left : ndarray, shape (g, S, 2, W)
        Their rows of the inverse eigenvector matrix, times them; 0 in idle lanes.
    right : ndarray, shape (g, 2, W, S)
        Columns of the eigenvector matrix so that its product is the sum over all lanes.
    error : ndarray, shape (s,)
        Weights of the stage increments in the error estimate.
    error_of_integral : ndarray, shape (s,)
        Of the derivative's increments, in that of the integral.
    error_of_line : float
        Of a constant derivative.
    power : ndarray, shape (s + 1, s + 1)
        From a polynomial's values at (0, c) to its monomial coefficients.
    bernstein : ndarray, shape (s + 1, s + 1)
        From these values to Bernstein coefficients on [0, 1].
    """

    stages: int
    c: np.ndarray
    a: np.ndarray
    a_inverse: np.ndarray
    nodes: np.ndarray
    integral: np.ndarray
    derivative: np.ndarray
    value: np.ndarray
    left: np.ndarray
    right: np.ndarray
    error: np.ndarray
    error_of_integral: np.ndarray
    error_of_line: float
    power: np.ndarray
    bernstein: np.ndarray


@cache
def radau(stages: int) -> Tables:
    """Coefficients of the Radau IIA method.

    Parameters
    ----------
    stages : int
        Odd number of stages s from 3 to 9; the order is 2 s - 1.

    Returns
    -------
    Tables
    """
    if stages % 2 == 0 or not 3 <= stages <= 9:
        raise ValueError(f"stages must be 3, 5, 7 or 9, got {stages}")
    c = _nodes(stages)
    gauss, weight = np.polynomial.legendre.leggauss(stages)
    at_nodes = legendre.legvander(2.0 * c - 1.0, stages - 1)
    points = 0.5 * c[:, None] * (gauss + 1.0)
    integrals = (
        0.5
        * c[:, None]
        * np.einsum("g,igk->ik", weight, legendre.legvander(2.0 * points - 1.0, stages - 1))
    )
    a = np.linalg.solve(at_nodes.T, integrals.T).T
    a_inverse = np.linalg.inv(a)

    value, right = np.linalg.eig(a_inverse)
    left = np.linalg.inv(right)
    real = np.argmin(abs(value.imag))
    upper = np.flatnonzero(value.imag > 1e-8 * abs(value))
    upper = upper[np.argsort(value[upper].imag)]
    phase = right[0, real] / abs(right[0, real])
    left[real], right[:, real] = (left[real] * phase).real, (right[:, real] / phase).real
    chosen = [real, *upper]
    values, lefts, rights = _side_by_side(value[chosen], left[chosen], right[:, chosen].T)
    idle = (0, -stages % WIDTH)

    # The embedded formula adds f(x0) with weight 1 / real_value so that it has order s.
    powers = np.vander(c, stages, increasing=True).T
    wanted = 1.0 / np.arange(1, stages + 1)
    wanted[0] -= 1.0 / value[real].real
    embedded = np.linalg.solve(powers, wanted)
    error = value[real].real * (a_inverse.T @ (embedded - a[-1]))

    grid = np.concatenate([[0.0], c])
    monomial = np.linalg.inv(np.vander(grid, stages + 1, increasing=True))
    return Tables(
        stages=stages,
        c=c,
        a=a,
        a_inverse=a_inverse,
        nodes=np.pad(c, idle),
        integral=np.pad(a, (idle, idle)).T.copy(),
        derivative=np.pad(a_inverse, (idle, idle)).T.copy(),
        value=values,
        left=lefts,
        right=rights,
        error=error,
        error_of_integral=error @ a,
        error_of_line=float(error @ c),
        power=monomial,
        bernstein=from_monomials(stages) @ monomial,
    )


def _side_by_side(value, left, right):
    """`Tables.value`, `left` and `right` from eigenvalues (k,), the real one first, and vectors."""
    count, stages = left.shape
    lanes, size = count + -count % WIDTH, stages + -stages % WIDTH
    values = np.full(lanes, value[0].real, dtype=complex)
    lefts, rights = np.zeros((size, lanes), dtype=complex), np.zeros((lanes, size), dtype=complex)
    values[:count] = value
    lefts[:stages, :count] = (value[:, None] * left).T
    # The real vector counts once, a conjugate pair twice: x + conj(x) is 2 Re x.
    rights[:count, :stages] = 2.0 * right.conj()
    rights[0] *= 0.5
    values, lefts, rights = (np.stack([x.real, x.imag]) for x in (values, lefts, rights))
    return (
        values.reshape(2, -1, WIDTH).transpose(1, 0, 2).copy(),
        lefts.reshape(2, size, -1, WIDTH).transpose(2, 1, 0, 3).copy(),
        rights.reshape(2, -1, WIDTH, size).transpose(1, 0, 2, 3).copy(),
    )


def _nodes(stages):
    """Zeros of P_s - P_(s-1) on [0, 1], refined by Newton's method in extended precision."""
    series = np.zeros(stages + 1)
    series[stages], series[stages - 1] = 1.0, -1.0
    x = np.sort(legendre.legroots(series).real).astype(np.longdouble)
    slope = legendre.legder(series)
    for _ in range(3):
        inner = x[:-1]
        x[:-1] = inner - legendre.legval(inner, series) / legendre.legval(inner, slope)
    x[-1] = 1.0
    return ((x + 1.0) / 2.0).astype(float)
