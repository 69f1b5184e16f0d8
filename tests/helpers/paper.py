"""The paper's equations as printed, and closed forms: what results are held against."""

import math

import numpy as np

from tss_ros.core import ring
from tss_ros.core.model.system import MU_EARTH

ORBIT_RATE = ring().orbit_rate_rad_s


def paper_acceleration(system, position, velocity):
    """Eqs. (1)-(11) term by term in the orbit frame, as printed; returns (n, 3)."""
    rate, radius = system.orbit_rate_rad_s, system.orbit_radius_m
    q = position + np.array([0.0, radius, 0.0])
    a = -MU_EARTH * q / np.linalg.norm(q, axis=1)[:, None] ** 3
    a += rate**2 * np.stack([position[:, 0], position[:, 1] + radius, 0 * position[:, 0]], 1)
    a += 2 * rate * np.stack([velocity[:, 1], -velocity[:, 0], 0 * velocity[:, 0]], 1)
    for k, (i, j) in enumerate(system.tether_ends):
        e, w = position[i] - position[j], velocity[i] - velocity[j]
        length = np.linalg.norm(e)
        if length > system.rest_length_m[k]:
            force = (
                -system.axial_stiffness_n[k] * (1 / system.rest_length_m[k] - 1 / length) * e
                - system.damping_n_s_per_m[k] * (e @ w / length) / length * e
            )
            a[i] += force / system.mass_kg[i]
            a[j] -= force / system.mass_kg[j]
    return a


def tension(ratio, damping_n_s_per_m):
    """Smallest tension over a turn, to a factor, of Table 1's ring: its first zero is slackness.

    Spin and the mean of gravity pull with w^2 + 2 w + 3/2; the gravity gradient turns twice a turn
    with amplitude 3/2 + 3/2, which a tether with damping follows with the lag tau = C L / EA.
    """
    lag = 2.0 * ratio * ORBIT_RATE * damping_n_s_per_m * 1e4 / 5e4
    return ratio**2 + 2.0 * ratio + 1.5 - 3.0 / math.hypot(1.0, lag)
