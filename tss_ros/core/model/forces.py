"""Forces on the beads and their derivatives, Eqs. (1)-(11) and (52): all laws summed.

The kernels work in a frame that turns with the formation: it shares the orbit frame's origin and
z axis and rotates at the spin rate omega against it. With rho the position there,

    rho'' = g + (omega^2 + 2 Omega omega) rho_xy - 2 (Omega + omega) z x rho' + tethers,

g being the laws of `laws.BEAD_LAWS`, which take in the centrifugal force of the orbital motion. A
spinning formation is nearly at rest in this frame, and setting omega = 0 gives the orbit frame.

On an orbit that is no circle the frame turns just so, Omega being the mean rate, and the direction
and distance of the Earth change in it (`model.sky`).
"""

import math

import numpy as np

from tss_ros.core.arguments import checked
from tss_ros.core.model.commands import add_commanded_thrust
from tss_ros.core.model.feedback_thrust import add_thrust, add_thrust_gradient
from tss_ros.core.model.kernel_arrays import ROW, KernelArrays, kernel_arrays
from tss_ros.core.model.laws.inertia import inertia
from tss_ros.core.model.made import (
    acceleration_of_bead_in_sky,
    bead_acceleration,
    bead_jacobian,
    energy_of_arrays,
    jacobian_of_bead_in_sky,
    tension,
    tension_and_slope,
    tension_and_slope_of_arrays,
    tension_by_rest,
)
from tss_ros.core.model.reel_yield import let_reels_go, linearise_forces, linearise_reel
from tss_ros.core.model.reels import NEVER_M
from tss_ros.core.model.sky import MEAN_MOTION, sky_at
from tss_ros.core.model.system import System
from tss_ros.core.numerics.simd import inlined, kernel, leaf, python_kernel


@leaf
def _tether(v, r, i, j):
    """Vector e [m] between two beads, its length l [m] and l' [m/s], Eqs. (3) and (6)."""
    ex, ey, ez = r[i, 0] - r[j, 0], r[i, 1] - r[j, 1], r[i, 2] - r[j, 2]
    length = math.sqrt(ex * ex + ey * ey + ez * ez)
    closing = ex * (v[i, 0] - v[j, 0]) + ey * (v[i, 1] - v[j, 1]) + ez * (v[i, 2] - v[j, 2])
    return ex, ey, ez, length, closing / length


@kernel
def rest_at(arrays, k, time, v, r):
    """L [m] of a tether and L' [m/s] at a time [s]."""
    if arrays.reel.size == 0:
        return arrays.rest[k], 0.0
    past, reel = time - arrays.reel_since, arrays.reel[k]
    if reel[ROW] >= 0.0 and reel[0] < NEVER_M:
        return r[int(reel[ROW]), 0], v[int(reel[ROW]), 0]
    length = ((reel[3] * past + reel[2]) * past + reel[1]) * past + reel[0]
    return length, (3.0 * reel[3] * past + 2.0 * reel[2]) * past + reel[1]


@kernel
def _tether_at(arrays, k, time, v, r):
    """L [m], L' [m/s], EA/L [N/m] and C [N s/m] of a tether at a time [s]."""
    rest, unreeling = rest_at(arrays, k, time, v, r)
    if arrays.reel.size == 0:
        return rest, unreeling, arrays.stiffness[k], arrays.damping[k]
    share = arrays.rest[k] / rest
    return rest, unreeling, share * arrays.stiffness[k], share * arrays.damping[k]


@kernel
def _accelerate_in_sky(arrays, time, v, r, a):
    """Accelerations (n, 3) of the beads without tethers, on an orbit that is no circle.

    The laws have n^2 of the orbit's centrifugal force in them, n now; the frame turns evenly.
    """
    sky, turning = sky_at(arrays, time), arrays.rate + arrays.spin
    centrifugal = turning * turning - sky[MEAN_MOTION] * sky[MEAN_MOTION]
    for i in range(arrays.beads):
        x, y, z, vx, vy, vz = r[i, 0], r[i, 1], r[i, 2], v[i, 0], v[i, 1], v[i, 2]
        gx, gy, gz = acceleration_of_bead_in_sky(arrays, x, y, z, vx, vy, vz, sky, turning)
        fx, fy = inertia(x, y, vx, vy, centrifugal, 2.0 * turning, arrays.drive)
        a[i, 0] = gx + fx
        a[i, 1] = gy + fy
        a[i, 2] = gz


@inlined
def _linearise_inertia(arrays, centrifugal, turning, by_r, by_v):
    """Derivatives (3, 3) of inertia. It is linear: they are what it makes of unit vectors."""
    by_r[0, 0], by_r[1, 0] = inertia(1.0, 0.0, 0.0, 0.0, centrifugal, 2.0 * turning, arrays.drive)
    by_r[0, 1], by_r[1, 1] = inertia(0.0, 1.0, 0.0, 0.0, centrifugal, 2.0 * turning, arrays.drive)
    by_v[0, 1], _ = inertia(0.0, 0.0, 0.0, 1.0, centrifugal, 2.0 * turning, arrays.drive)
    _, by_v[1, 0] = inertia(0.0, 0.0, 1.0, 0.0, centrifugal, 2.0 * turning, arrays.drive)


@kernel
def _linearise_in_sky(arrays, time, v, r, by_r, by_v):
    """Derivatives of `_accelerate_in_sky`, into the diagonal blocks (3, 3) of zeros."""
    sky, turning = sky_at(arrays, time), arrays.rate + arrays.spin
    centrifugal = turning * turning - sky[MEAN_MOTION] * sky[MEAN_MOTION]
    for i in range(arrays.beads):
        _linearise_inertia(arrays, centrifugal, turning, by_r[i], by_v[i])
        x, y, z, vx, vy, vz = r[i, 0], r[i, 1], r[i, 2], v[i, 0], v[i, 1], v[i, 2]
        jacobian_of_bead_in_sky(arrays, x, y, z, vx, vy, vz, sky, turning, by_r[i], by_v[i])


@python_kernel
def acceleration(arrays, taut, time, v, r, a):
    """Accelerations of all beads, Eqs. (1) and (32), in the turning frame.

    Parameters
    ----------
    arrays : KernelArrays
    taut : ndarray, shape (m,), bool
        Which tethers pull or push, the switch s of Eq. (5), held fixed by the caller.
    time : float
        [s]; at 0 the turning frame coincides with the orbit frame.
    v, r : ndarray, shape (rows, 3)
        Velocities [m/s] and positions [m], and rest lengths that are states.
    a : ndarray, shape (rows, 3)
        Overwritten with the accelerations [m/s^2].
    """
    if arrays.orbit_starts.size > 0:
        _accelerate_in_sky(arrays, time, v, r, a)
    else:
        upx, upy = math.sin(arrays.spin * time), math.cos(arrays.spin * time)
        centrifugal = arrays.spin * (arrays.spin + 2.0 * arrays.rate)
        turning = arrays.rate + arrays.spin
        for i in range(arrays.beads):
            x, y, z, vx, vy, vz = r[i, 0], r[i, 1], r[i, 2], v[i, 0], v[i, 1], v[i, 2]
            gx, gy, gz = bead_acceleration(arrays, x, y, z, vx, vy, vz, upx, upy, turning)
            fx, fy = inertia(x, y, vx, vy, centrifugal, 2.0 * turning, arrays.drive)
            a[i, 0] = gx + fx
            a[i, 1] = gy + fy
            a[i, 2] = gz
    dx, dy = arrays.drive_across
    if dx != 0.0 or dy != 0.0:
        for i in range(arrays.beads):
            a[i, 0] += dy * r[i, 2]
            a[i, 1] -= dx * r[i, 2]
            a[i, 2] += dx * r[i, 1] - dy * r[i, 0]
    if arrays.satellite.size > 0:
        add_thrust(arrays, v, r, a)
    if arrays.thrust.size > 0:
        add_commanded_thrust(arrays, time, a)
    changing = arrays.reel.size > 0
    if changing:
        let_reels_go(arrays, v, r, a)
    for k in range(arrays.ends.shape[0]):
        if taut[k]:
            i, j = arrays.ends[k, 0], arrays.ends[k, 1]
            ex, ey, ez, length, growth = _tether(v, r, i, j)
            rest, unreeling, stiffness, damping = _tether_at(arrays, k, time, v, r)
            pull = tension(arrays, length, growth - unreeling, rest, stiffness, damping) / length
            pi, pj = pull * arrays.inv_mass[i], pull * arrays.inv_mass[j]
            a[i, 0] -= pi * ex
            a[i, 1] -= pi * ey
            a[i, 2] -= pi * ez
            a[j, 0] += pj * ex
            a[j, 1] += pj * ey
            a[j, 2] += pj * ez
            if changing and arrays.reel[k, ROW] >= 0.0:
                row = int(arrays.reel[k, ROW])
                a[row, 0] += arrays.inv_mass[row] * pull * length


@python_kernel
def jacobian(arrays, pair, taut, time, v, r, by_r, by_v):
    """Derivatives of `acceleration` by position and velocity, the blocks A and B of Eq. (52).

    Parameters
    ----------
    arrays, taut, time, v, r
        As for `acceleration`.
    pair : ndarray, shape (m, 2) or more
        Where the blocks (i, j) and (j, i) of each tether are stored (`block_lu.Symbolic.pair`);
        then those of each end of the tethers whose rest lengths are states with these; then those
        of each pair of satellites if feedback couples them.
    by_r, by_v : ndarray, shape (at least as many as blocks, 3, 3)
        Overwritten: da/dr [1/s^2] and da/dv [1/s]; block i < n is the diagonal one of bead i.
    """
    by_r[:] = 0.0
    by_v[:] = 0.0
    if arrays.orbit_starts.size > 0:
        _linearise_in_sky(arrays, time, v, r, by_r, by_v)
    else:
        upx, upy = math.sin(arrays.spin * time), math.cos(arrays.spin * time)
        centrifugal = arrays.spin * (arrays.spin + 2.0 * arrays.rate)
        turning = arrays.rate + arrays.spin
        for i in range(arrays.beads):
            _linearise_inertia(arrays, centrifugal, turning, by_r[i], by_v[i])
            x, y, z, vx, vy, vz = r[i, 0], r[i, 1], r[i, 2], v[i, 0], v[i, 1], v[i, 2]
            bead_jacobian(arrays, x, y, z, vx, vy, vz, upx, upy, turning, by_r[i], by_v[i])
    dx, dy = arrays.drive_across
    if dx != 0.0 or dy != 0.0:
        for i in range(arrays.beads):
            by_r[i, 0, 2] += dy
            by_r[i, 1, 2] -= dx
            by_r[i, 2, 0] -= dy
            by_r[i, 2, 1] += dx
    changing = arrays.reel.size > 0
    if changing:
        linearise_forces(arrays, v, r, by_r, by_v)
    if arrays.satellite.size > 0:
        others = pair[arrays.ends.shape[0] + 2 * (arrays.inv_mass.size - arrays.beads) :]
        add_thrust_gradient(arrays, others, v, r, by_r, by_v)
    for k in range(arrays.ends.shape[0]):
        if taut[k]:
            i, j = arrays.ends[k, 0], arrays.ends[k, 1]
            e = (r[i, 0] - r[j, 0], r[i, 1] - r[j, 1], r[i, 2] - r[j, 2])
            w = (v[i, 0] - v[j, 0], v[i, 1] - v[j, 1], v[i, 2] - v[j, 2])
            length2 = e[0] * e[0] + e[1] * e[1] + e[2] * e[2]
            length = math.sqrt(length2)
            growth = (e[0] * w[0] + e[1] * w[1] + e[2] * w[2]) / length
            rest, unreeling, stiffness, damping = _tether_at(arrays, k, time, v, r)
            across, slope = tension_and_slope(
                arrays, length, growth - unreeling, rest, stiffness, damping
            )
            if changing and arrays.reel[k, ROW] >= 0.0:
                by_rest = tension_by_rest(
                    arrays, length, growth - unreeling, rest, stiffness, damping
                )
                state, slopes = (e, w, length, growth), (slope, by_rest, damping)
                linearise_reel(arrays, pair, k, state, slopes, by_r, by_v)
            # Derivatives of tension over length times e, by e and w, which l and l' depend on.
            across /= length
            along = slope - across - damping * growth / length
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


@python_kernel
def stretch(arrays, time, v, r, excess, growth):
    """Length beyond the rest length and its rate for every tether, g = l - L and g', Eq. (6).

    Parameters
    ----------
    arrays : KernelArrays
    time : float
        [s]
    v, r : ndarray, shape (n, 3)
    excess, growth : ndarray, shape (m,)
        Overwritten: [m] and [m/s].
    """
    for k in range(arrays.ends.shape[0]):
        _, _, _, length, faster = _tether(v, r, arrays.ends[k, 0], arrays.ends[k, 1])
        rest, unreeling = rest_at(arrays, k, time, v, r)
        excess[k], growth[k] = length - rest, faster - unreeling


@kernel
def _tension_at(arrays, k, time, v, r):
    """Tension [N] that the law gives a tether at a time [s]."""
    _, _, _, length, growth = _tether(v, r, arrays.ends[k, 0], arrays.ends[k, 1])
    rest, unreeling, stiffness, damping = _tether_at(arrays, k, time, v, r)
    return tension(arrays, length, growth - unreeling, rest, stiffness, damping)


@python_kernel
def tensions(arrays, time, v, r, pull):
    """Tension [N] that the law gives every tether at a time [s], taut or not."""
    for k in range(arrays.ends.shape[0]):
        pull[k] = _tension_at(arrays, k, time, v, r)


def tension_and_slopes(
    arrays: KernelArrays, length: np.ndarray, growth: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Tension of taut tethers [N] and its derivative by length [N/m]; shapes (..., m)."""
    return tension_and_slope_of_arrays(
        arrays, length, growth, arrays.rest, arrays.stiffness, arrays.damping
    )


@checked
def tether_state(
    system: System,
    position_m: np.ndarray,
    velocity_m_s: np.ndarray,
    rests: tuple[np.ndarray, np.ndarray] | None = None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Length, tension and tautness of every tether segment, Eqs. (3), (5), (6).

    Parameters
    ----------
    system : System
    position_m, velocity_m_s : ndarray, shape (..., n, 3)
    rests : tuple of two ndarray, shape (..., m), optional
        Rest lengths [m] and their rates [m/s] where reels have changed them, `Commands.rests`;
        a length of 0 for what pulls nothing, as it is on a reel or cut.

    Returns
    -------
    length_m : ndarray, shape (..., m)
    tension_n : ndarray, shape (..., m)
        [N] elastic plus damping force, 0 where slack. Eq. (6) lets damping make it negative; a
        tether law that never pushes has 0 there.
    taut : ndarray, shape (..., m), bool
        Longer than the rest length, Eq. (5).
    """
    length, growth = lengths_and_rates(system, position_m, velocity_m_s)
    arrays = kernel_arrays(system, 0.0)
    if rests is None:
        rests = system.rest_length_m, 0.0
    else:
        arrays = _with_rests(arrays, system, rests[0])
    out = rests[0] > 0.0
    taut, growth = out & (length > rests[0]), growth - rests[1]  # Eq. (5)
    pull, _ = tension_and_slopes(arrays, length, growth)
    if not system.law.pushes:
        pull = np.maximum(pull, 0.0)
    pushes = out & (rests[0] < NEVER_M) & system.bilateral
    return length, np.where(taut | pushes, pull, 0.0), taut


def acting_tethers(
    system: System,
    position_m: np.ndarray,
    velocity_m_s: np.ndarray,
    rests: tuple[np.ndarray, np.ndarray] | None = None,
) -> np.ndarray:
    """Which tethers exert a force, the switch s of Eq. (5); shapes as `tether_state`, bool."""
    length, growth = lengths_and_rates(system, position_m, velocity_m_s)
    arrays = kernel_arrays(system, 0.0)
    if rests is not None:
        arrays, growth = _with_rests(arrays, system, rests[0]), growth - rests[1]
    acts = (length > arrays.rest) | system.bilateral
    if not system.law.pushes:
        acts &= tension_and_slopes(arrays, length, growth)[0] >= 0.0
    return acts


@checked
def elastic_energy(
    system: System,
    position_m: np.ndarray,
    velocity_m_s: np.ndarray,
    rests: tuple[np.ndarray, np.ndarray] | None = None,
) -> np.ndarray:
    """Elastic energy [J] of all taut tethers together, shape (...); all else as `tether_state`."""
    length, growth = lengths_and_rates(system, position_m, velocity_m_s)
    arrays, out = kernel_arrays(system, 0.0), True
    if rests is not None:
        arrays, out = _with_rests(arrays, system, rests[0]), rests[0] > 0.0
        growth = growth - rests[1]
    energy = energy_of_arrays(arrays, length, growth, arrays.rest, arrays.stiffness, arrays.damping)
    taut = out & ((length > arrays.rest) | system.bilateral)
    return np.sum(np.where(taut, energy, 0.0), axis=-1)


def _with_rests(arrays, system, rest):
    """Kernels' arrays for other rest lengths [m], (..., m); 0 on a reel."""
    share = system.rest_length_m / np.where(rest > 0.0, rest, system.rest_length_m)
    stiffness, damping = share * arrays.stiffness, share * arrays.damping
    return arrays._replace(rest=rest, stiffness=stiffness, damping=damping)


@checked
def pushing_share(tension_n: np.ndarray, taut: np.ndarray) -> float:
    """Share of the time that taut tethers spend pushing: of the samples taut, those below 0 N."""
    return float(np.count_nonzero(taut & (tension_n < 0.0)) / max(np.count_nonzero(taut), 1))


def lengths_and_rates(
    system: System, position_m: np.ndarray, velocity_m_s: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Lengths [m] and their rates [m/s], (..., m)."""
    first, second = system.tether_ends.T
    e = position_m[..., first, :] - position_m[..., second, :]
    w = velocity_m_s[..., first, :] - velocity_m_s[..., second, :]
    length = np.sqrt(np.sum(e * e, axis=-1))
    along = np.sum(e * w, axis=-1)
    return length, np.divide(along, length, out=np.zeros_like(length), where=length > 0.0)
