"""Forces on the beads and their derivatives, Eqs. (1)-(11) and (52), as compiled kernels.

The kernels work in a frame that turns with the formation: it shares the orbit frame's origin and
z axis and rotates at the spin rate omega against it. With rho the position there,

    rho'' = g + (omega^2 + 2 Omega omega) rho_xy - 2 (Omega + omega) z x rho' + tethers,

g being gravity plus the centrifugal force of the orbital motion, Eqs. (2) and (9). A spinning
formation is nearly at rest in this frame, and setting omega = 0 gives the orbit frame itself.
"""

import math

import numpy as np

from tss_ros.core.model.system import System
from tss_ros.core.numerics.simd import kernel


@kernel
def acceleration(arrays, taut, time, v, r, a):
    """Accelerations of all beads, Eqs. (1) and (32), in the turning frame.

    Parameters
    ----------
    arrays : KernelArrays
    taut : ndarray, shape (m,), bool
        The switch s of Eq. (5), held fixed by the caller.
    time : float
        [s]; at 0 the turning frame coincides with the orbit frame.
    v, r : ndarray, shape (n, 3)
        Velocities [m/s] and positions [m].
    a : ndarray, shape (n, 3)
        Overwritten with the accelerations [m/s^2].

    Notes
    -----
    Gravity and centrifugal force cancel to about one part in a million. Their sum is written with
    f = 1 - (1 + u)^(-3/2), u = (|q|^2 - R^2) / R^2, in a form free of that cancellation.
    """
    upx, upy = math.sin(arrays.spin * time), math.cos(arrays.spin * time)
    rate2 = arrays.rate * arrays.rate
    centrifugal = arrays.spin * (arrays.spin + 2.0 * arrays.rate)
    coriolis = 2.0 * (arrays.rate + arrays.spin)
    # On every bead: gravity, Eq. (2), with the orbit's centrifugal force, Eq. (9); Coriolis force,
    # Eq. (11), and the forces of the turning frame.
    for i in range(r.shape[0]):
        x, y, z = r[i, 0], r[i, 1], r[i, 2]
        up = x * upx + y * upy
        if arrays.linear_gravity:
            gx, gy, gz = 3.0 * up * upx, 3.0 * up * upy, -z
        else:
            u = (2.0 * up + (x * x + y * y + z * z) / arrays.radius) / arrays.radius
            p = (1.0 + u) * math.sqrt(1.0 + u)
            f = u * (3.0 + u * (3.0 + u)) / (p * (1.0 + p))
            gx = f * (x + arrays.radius * upx)
            gy = f * (y + arrays.radius * upy)
            gz = f * z - z
        a[i, 0] = rate2 * gx + centrifugal * x + coriolis * v[i, 1]
        a[i, 1] = rate2 * gy + centrifugal * y - coriolis * v[i, 0]
        a[i, 2] = rate2 * gz
    # In every tether that is taut, Eq. (5): elastic force, Eq. (3), and damping, Eq. (6).
    for k in range(arrays.ends.shape[0]):
        if taut[k]:
            i, j = arrays.ends[k, 0], arrays.ends[k, 1]
            ex, ey, ez = r[i, 0] - r[j, 0], r[i, 1] - r[j, 1], r[i, 2] - r[j, 2]
            length = math.sqrt(ex * ex + ey * ey + ez * ez)
            closing = (
                ex * (v[i, 0] - v[j, 0]) + ey * (v[i, 1] - v[j, 1]) + ez * (v[i, 2] - v[j, 2])
            ) / length
            pull = arrays.stiffness[k] * (length - arrays.rest[k]) + arrays.damping[k] * closing
            pull /= length
            pi, pj = pull * arrays.inv_mass[i], pull * arrays.inv_mass[j]
            a[i, 0] -= pi * ex
            a[i, 1] -= pi * ey
            a[i, 2] -= pi * ez
            a[j, 0] += pj * ex
            a[j, 1] += pj * ey
            a[j, 2] += pj * ez


@kernel
def jacobian(arrays, pair, taut, time, v, r, by_r, by_v):
    """Derivatives of `acceleration` by position and velocity, the blocks A and B of Eq. (52).

    Parameters
    ----------
    arrays, taut, time, v, r
        As for `acceleration`.
    pair : ndarray, shape (m, 2)
        Where the blocks (i, j) and (j, i) of each tether are stored (`block_lu.Symbolic.pair`).
    by_r, by_v : ndarray, shape (at least n + 2m, 3, 3)
        Overwritten: da/dr [1/s^2] and da/dv [1/s]; block i < n is the diagonal one of bead i.
    """
    upx, upy = math.sin(arrays.spin * time), math.cos(arrays.spin * time)
    rate2 = arrays.rate * arrays.rate
    centrifugal = arrays.spin * (arrays.spin + 2.0 * arrays.rate)
    coriolis = 2.0 * (arrays.rate + arrays.spin)
    by_r[:] = 0.0
    by_v[:] = 0.0
    # Derivatives of gravity with centrifugal force, Eqs. (2) and (9), and of Coriolis force, (11).
    for i in range(r.shape[0]):
        d = by_r[i]
        if arrays.linear_gravity:
            d[0, 0] = 3.0 * rate2 * upx * upx + centrifugal
            d[1, 1] = 3.0 * rate2 * upy * upy + centrifugal
            d[0, 1] = d[1, 0] = 3.0 * rate2 * upx * upy
            d[2, 2] = -rate2
        else:
            x, y, z = r[i, 0], r[i, 1], r[i, 2]
            up = x * upx + y * upy
            u = (2.0 * up + (x * x + y * y + z * z) / arrays.radius) / arrays.radius
            root = math.sqrt(1.0 + u)
            p = (1.0 + u) * root
            f = u * (3.0 + u * (3.0 + u)) / (p * (1.0 + p))
            steep = 3.0 * rate2 / (p * (1.0 + u))
            qx, qy, qz = x / arrays.radius + upx, y / arrays.radius + upy, z / arrays.radius
            d[0, 0] = rate2 * f + steep * qx * qx + centrifugal
            d[1, 1] = rate2 * f + steep * qy * qy + centrifugal
            d[2, 2] = rate2 * (f - 1.0) + steep * qz * qz
            d[0, 1] = d[1, 0] = steep * qx * qy
            d[0, 2] = d[2, 0] = steep * qx * qz
            d[1, 2] = d[2, 1] = steep * qy * qz
        by_v[i, 0, 1] = coriolis
        by_v[i, 1, 0] = -coriolis
    for k in range(arrays.ends.shape[0]):
        if taut[k]:
            i, j = arrays.ends[k, 0], arrays.ends[k, 1]
            # Derivatives of the elastic force, Eq. (3), and of damping, Eq. (6).
            e = (r[i, 0] - r[j, 0], r[i, 1] - r[j, 1], r[i, 2] - r[j, 2])
            w = (v[i, 0] - v[j, 0], v[i, 1] - v[j, 1], v[i, 2] - v[j, 2])
            length2 = e[0] * e[0] + e[1] * e[1] + e[2] * e[2]
            closing = e[0] * w[0] + e[1] * w[1] + e[2] * w[2]
            length = math.sqrt(length2)
            damping = arrays.damping[k]
            across = (
                arrays.stiffness[k] * (length - arrays.rest[k]) + damping * closing / length
            ) / length
            along = arrays.stiffness[k] - across - damping * closing / length2
            mi, mj = arrays.inv_mass[i], arrays.inv_mass[j]
            ij, ji = pair[k, 0], pair[k, 1]
            for p in range(3):
                for q in range(3):
                    ee = e[p] * e[q] / length2
                    kr = along * ee + damping * e[p] * w[q] / length2
                    kv = damping * ee
                    if p == q:
                        kr += across
                    by_r[i, p, q] -= mi * kr
                    by_r[j, p, q] -= mj * kr
                    by_r[ij, p, q] += mi * kr
                    by_r[ji, p, q] += mj * kr
                    by_v[i, p, q] -= mi * kv
                    by_v[j, p, q] -= mj * kv
                    by_v[ij, p, q] += mi * kv
                    by_v[ji, p, q] += mj * kv


@kernel
def stretch(arrays, v, r, excess, growth):
    """Length beyond the rest length and its rate for every tether, g = l - L and l' of Eq. (6).

    Parameters
    ----------
    arrays : KernelArrays
    v, r : ndarray, shape (n, 3)
    excess, growth : ndarray, shape (m,)
        Overwritten: [m] and [m/s].
    """
    for k in range(arrays.ends.shape[0]):
        i, j = arrays.ends[k, 0], arrays.ends[k, 1]
        ex, ey, ez = r[i, 0] - r[j, 0], r[i, 1] - r[j, 1], r[i, 2] - r[j, 2]
        length = math.sqrt(ex * ex + ey * ey + ez * ez)
        excess[k] = length - arrays.rest[k]
        growth[k] = (
            ex * (v[i, 0] - v[j, 0]) + ey * (v[i, 1] - v[j, 1]) + ez * (v[i, 2] - v[j, 2])
        ) / length


def tether_state(
    system: System, position_m: np.ndarray, velocity_m_s: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Length, tension and tautness of every tether segment, Eqs. (3), (5), (6).

    Parameters
    ----------
    system : System
    position_m, velocity_m_s : ndarray, shape (..., n, 3)

    Returns
    -------
    length_m : ndarray, shape (..., m)
    tension_n : ndarray, shape (..., m)
        [N] elastic plus damping force, 0 where slack. Eq. (6) lets damping make it negative.
    taut : ndarray, shape (..., m), bool
    """
    first, second = system.tether_ends.T
    e = position_m[..., first, :] - position_m[..., second, :]
    w = velocity_m_s[..., first, :] - velocity_m_s[..., second, :]
    length = np.sqrt(np.sum(e * e, axis=-1))
    growth = np.sum(e * w, axis=-1) / length
    taut = length > system.rest_length_m  # Eq. (5)
    pull = (
        system.axial_stiffness_n * (length / system.rest_length_m - 1.0)  # Eq. (3)
        + system.damping_n_s_per_m * growth  # Eq. (6)
    )
    return length, np.where(taut | system.bilateral, pull, 0.0), taut
