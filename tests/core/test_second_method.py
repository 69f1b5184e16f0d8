"""Families held against a second method that shares no code with the first: collocation.

Fourier collocation of the whole turn finds the motion, an explicit Runge-Kutta method of the
equations' own derivatives, by complex steps, the multipliers.
"""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tss_ros.core import formation
from tss_ros.core.stability.follow import follow

pytestmark = pytest.mark.long

MU, EARTH, ALTITUDE = 3.986e14, 6378e3, 1e6
RADIUS = EARTH + ALTITUDE
OMEGA = math.sqrt(MU / RADIUS**3)
MASS, LENGTH, STIFFNESS = 100.0, 1e4, 5e4
HARMONICS = 24


def acceleration(r, v, spin, time, tethers):
    """Of beads (..., n, 3) in the frame that turns with the spin, Eqs. (2), (3), (9) and (11)."""
    up = np.stack([np.sin(spin * time), np.cos(spin * time), 0.0 * time], axis=-1)
    place = r + RADIUS * up[..., None, :]
    square = np.sum(place * place, axis=-1, keepdims=True)
    rate = OMEGA + spin
    a = -MU * place / square**1.5
    a = a + OMEGA**2 * RADIUS * up[..., None, :]
    a[..., 0] += rate**2 * r[..., 0] + 2.0 * rate * v[..., 1]
    a[..., 1] += rate**2 * r[..., 1] - 2.0 * rate * v[..., 0]
    for i, j in tethers:
        e = r[..., i, :] - r[..., j, :]
        length = np.sqrt(np.sum(e * e, axis=-1, keepdims=True))
        pull = STIFFNESS * (1.0 / LENGTH - 1.0 / length) * e / MASS
        a[..., i, :] -= pull
        a[..., j, :] += pull
    return a


def derivatives(r, v, spin, time, tethers):
    """By positions and velocities: two arrays (..., 3n, 3n), by complex steps."""
    n, out = r.shape[-2], []
    for which in range(2):
        columns = []
        for k in range(3 * n):
            step = np.zeros((n, 3), complex)
            step[k // 3, k % 3] = 1e-30j
            args = (r + step, v + 0j) if which == 0 else (r + 0j, v + step)
            columns.append(acceleration(*args, spin, time, tethers).imag / 1e-30)
        out.append(np.stack(columns, axis=-1).reshape(*time.shape, 3 * n, 3 * n))
    return out


def periodic_motion(start, w, tethers):
    """Fourier coefficients (k, n, 3) of the motion next to places, and the wave numbers.

    Places are (n, 3) for a rigid turn, or (k, n, 3) at times of the turn.
    """
    spin, count, n = w * OMEGA, 2 * HARMONICS + 1, start.shape[-2]
    time = 2.0 * math.pi / abs(spin) * np.arange(count) / count
    waves = np.fft.fftfreq(count, 1.0 / count)
    basis = np.exp(1j * abs(spin) * time[:, None] * waves)
    slope = (basis @ np.diag(1j * abs(spin) * waves) @ basis.conj().T).real / count
    r = np.array(np.broadcast_to(start, (count, n, 3)))
    for _ in range(12):
        v = np.tensordot(slope, r, 1)
        left = np.tensordot(slope @ slope, r, 1) - acceleration(r, v, spin, time, tethers)
        by_r, by_v = derivatives(r, v, spin, time, tethers)
        matrix = np.einsum("st,ij->sitj", slope @ slope, np.eye(3 * n))
        matrix -= np.einsum("sij,st->sitj", by_v, slope)
        at = np.arange(count)
        matrix[at, :, at, :] -= by_r
        matrix = matrix.reshape(3 * n * count, -1)
        change = np.linalg.lstsq(matrix, left.ravel(), rcond=1e-9)[0].reshape(r.shape)
        r = r - change
        if np.max(np.abs(change)) < 1e-7:
            break
    return np.fft.fft(r, axis=0) / count, waves


def moduli(start, w, tethers):
    """Moduli of the multipliers of the motion next to places, largest first."""
    coefficients, waves = periodic_motion(start, w, tethers)
    spin, n = w * OMEGA, start.shape[-2]

    def derivative(time, y):
        phase = np.exp(1j * abs(spin) * time * waves)
        r = np.tensordot(phase, coefficients, 1).real
        v = np.tensordot(1j * abs(spin) * waves * phase, coefficients, 1).real
        by_r, by_v = derivatives(r, v, spin, np.asarray(time), tethers)
        y = y.reshape(6 * n, -1)
        return np.concatenate([y[3 * n :], by_r @ y[: 3 * n] + by_v @ y[3 * n :]]).ravel()

    scale = np.repeat([1.0, OMEGA], 3 * n)
    end = solve_ivp(
        derivative, (0.0, 2.0 * math.pi / abs(spin)), np.diag(scale).ravel(), "DOP853",
        rtol=1e-11, atol=1e-16,
    ).y[:, -1]  # fmt: skip
    matrix = end.reshape(6 * n, 6 * n) / scale[:, None]
    return np.sort(np.abs(np.linalg.eigvals(matrix)))[::-1]


def motion_at_times(w, tethers, n):
    """Places (k, n, 3) of the motion of a pair, followed from fast spin to a rate."""
    r = np.zeros((1, n, 3))
    r[0, :, 1] = 0.5 * LENGTH, -0.5 * LENGTH
    for rate in np.append(np.arange(4.0, w, -0.1), w):
        coefficients, waves = periodic_motion(r, rate, tethers)
        r = np.fft.ifft(coefficients * len(waves), axis=0).real
    return r


def undamped(shape, n):
    system = formation(shape, n, damping_n_s_per_m=0.0)
    return system, [tuple(ends) for ends in system.tether_ends]


@pytest.mark.parametrize(
    "shape, n, low, high", [("chain", 2, 1.15, 1.22), ("ring", 5, -4.0, -3.9)]
)
def test_multipliers_along_a_family(shape, n, low, high):
    system, tethers = undamped(shape, n)
    family = follow(system, "spin_rate_ratio", low, high, longest_step=0.02)
    for point in family.points[:: max(1, len(family.points) // 3)]:
        if point.max_modulus_nontrivial < 1.0 + 1e-6:
            continue
        start = point.state.position_m
        if n == 2:
            start = motion_at_times(point.parameter, tethers, n)
        largest = moduli(start, point.parameter, tethers)[0]
        assert largest == pytest.approx(point.max_modulus_nontrivial, abs=1e-8)


def test_the_place_of_a_special_point():
    """Where the out-of-plane pair of a pair's tilt leaves the circle."""
    system, tethers = undamped("chain", 2)
    family = follow(system, "spin_rate_ratio", 1.4, 1.2)
    (special,) = (point for point in family.special if point.kind == "branch point")
    start = motion_at_times(special.parameter, tethers, 2)

    def growth(w):
        # Real multipliers near 1 move like the root of the distance.
        return (moduli(start, w, tethers)[0] - 1.0) ** 2

    inside = [special.parameter - d for d in (4e-4, 2e-4)]
    squares = [growth(w) for w in inside]
    slope = (squares[0] - squares[1]) / (inside[0] - inside[1])
    assert inside[1] - squares[1] / slope == pytest.approx(special.parameter, abs=2e-5)
