"""Periodic functions by their values at equal steps.

Reference: L. N. Trefethen, Spectral Methods in MATLAB, ch. 3.
"""

import math

import numpy as np


def resampled(x: np.ndarray, count: int) -> np.ndarray:
    """The trigonometric polynomials through values at equal steps, at odd `count` other ones."""
    return np.fft.irfft(np.fft.rfft(x, axis=0), count, axis=0) * (count / len(x))


def differentiation(count: int) -> np.ndarray:
    """Derivatives at odd `count` equal steps of a circle by the values there, (count, count)."""
    apart = np.subtract.outer(np.arange(count), np.arange(count))
    half = math.pi / count * apart + np.eye(count)
    return np.where(apart == 0, 0.0, 0.5 * (-1.0) ** apart / np.sin(half))
