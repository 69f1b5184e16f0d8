"""Cubics of time: coefficients from that of 1 to that of the cube, as rest lengths follow them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

import numpy as np

#: A number, or an array of as many as there are cubics.
Number = TypeVar("Number", float, np.ndarray)


def cubic_at(cubic: Sequence[Number], time: Number) -> tuple[Number, Number]:
    """Value and rate of a cubic at a time."""
    a, b, c, d = cubic
    value = ((d * time + c) * time + b) * time + a
    return value, (3.0 * d * time + 2.0 * c) * time + b


def cubic_from(cubic: Sequence[float], time: float) -> tuple[float, float, float, float]:
    """The same cubic of the time since a time."""
    _, _, c, d = cubic
    return *cubic_at(cubic, time), 3.0 * d * time + c, d


def cubic_crossings(cubic: Sequence[float], value: float) -> list[float]:
    """Times at which a cubic has a value, in order; none if it rests."""
    a, *others = cubic
    if not any(others):
        return []
    if not any(others[1:]):
        return [(value - a) / others[0]]
    roots = np.polynomial.Polynomial([a - value, *others]).roots()
    real = np.abs(np.imag(roots)) <= 1e-9 * (1.0 + np.abs(roots))
    return sorted(float(time) for time in np.real(roots[real]))
