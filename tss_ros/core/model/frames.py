"""Frames: the orbit frame, and the one that turns with the formation.

Both share the origin and the z axis. The turning frame rotates at the spin rate omega against the
orbit frame and coincides with it at time 0 and after whole turns:

    r_orbit = Q(omega t) r_turning,    v_orbit = Q(omega t) (v_turning + omega z x r_turning).
"""

import math

import numpy as np

from tss_ros.core.numerics.simd import inlined, kernel, python_kernel

#: The z axis.
Z_AXIS = np.array([0.0, 0.0, 1.0])
Z_AXIS.flags.writeable = False


def rigid_velocity(
    position_m: np.ndarray, spin_rate_rad_s: float, axis: np.ndarray = Z_AXIS
) -> np.ndarray:
    """Velocities omega s x r of a rigid turn about an axis s, the initial ones of section 2.1.

    Parameters
    ----------
    position_m : ndarray, shape (..., 3)
    spin_rate_rad_s : float
    axis : ndarray, shape (3,)
        Unit vector.

    Returns
    -------
    ndarray, shape (..., 3)
        [m/s]
    """
    return spin_rate_rad_s * (position_m @ crossed(axis).T)


def crossed(axis: np.ndarray) -> np.ndarray:
    """The matrix (3, 3) that takes r to axis x r."""
    x, y, z = axis
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def turn_about(axis: np.ndarray, angle: float) -> np.ndarray:
    """The turn (3, 3) counter-clockwise about a unit vector by an angle [rad]."""
    c, s = math.cos(angle), math.sin(angle)
    return c * np.eye(3) + s * crossed(axis) + (1.0 - c) * np.outer(axis, axis)


def turn_to(axis: np.ndarray, start: np.ndarray = Z_AXIS) -> np.ndarray:
    """The shortest turn (3, 3) from a unit vector to another; half a turn where they oppose."""
    cosine = float(np.dot(start, axis))
    if cosine <= -1.0 + 1e-15:
        across = np.eye(3)[np.argmin(np.abs(start))]
        across = across - (across @ start) * start
        return 2.0 * np.outer(across, across) / (across @ across) - np.eye(3)
    cross = crossed(np.cross(start, axis))
    return np.eye(3) + cross + cross @ cross / (1.0 + cosine)


def as_turned(position_m: np.ndarray, axis: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Positions in a frame that has turned about an axis, from those in the frame at rest.

    Parameters
    ----------
    position_m : ndarray, shape (k, n, 3)
    axis : ndarray, shape (3,)
        Unit vector.
    angle : ndarray, shape (k,)
        [rad] by which the frame has turned, counter-clockwise about the axis.

    Returns
    -------
    ndarray, shape (k, n, 3)
        [m] where the angle is 0, the positions given.
    """
    axis, angle = np.asarray(axis), np.asarray(angle)[:, None, None]
    along = (position_m @ axis)[..., None] * axis
    across = np.cross(axis, position_m)
    # 1 - cos(angle), without cancellation.
    versine = 2.0 * np.sin(0.5 * angle) ** 2
    return np.cos(angle) * position_m - np.sin(angle) * across + versine * along


@inlined
def _into_orbit(c, s, spin, x, y, vx, vy):
    """Plane components of one position and velocity, c = cos(omega t), s = sin(omega t)."""
    vx, vy = vx - spin * y, vy + spin * x
    return c * x - s * y, s * x + c * y, c * vx - s * vy, s * vx + c * vy


@inlined
def _into_turning(c, s, spin, x, y, vx, vy):
    """The inverse of `_into_orbit`."""
    x, y, vx, vy = c * x + s * y, c * y - s * x, c * vx + s * vy, c * vy - s * vx
    return x, y, vx + spin * y, vy - spin * x


@kernel
def to_orbit_frame(spin, time, v, r, out_v, out_r):
    """Turn velocities and positions of the turning frame into those of the orbit frame.

    Parameters
    ----------
    spin, time : float
        omega [rad/s] and t [s].
    v, r, out_v, out_r : ndarray, shape (n, 3)
        The outputs may be the inputs.
    """
    c, s = math.cos(spin * time), math.sin(spin * time)
    for i in range(r.shape[0]):
        out_r[i, 0], out_r[i, 1], out_v[i, 0], out_v[i, 1] = _into_orbit(
            c, s, spin, r[i, 0], r[i, 1], v[i, 0], v[i, 1]
        )
        out_r[i, 2], out_v[i, 2] = r[i, 2], v[i, 2]


@python_kernel
def to_turning_frame(spin, time, v, r):
    """The inverse of `to_orbit_frame`, in place."""
    c, s = math.cos(spin * time), math.sin(spin * time)
    for i in range(r.shape[0]):
        r[i, 0], r[i, 1], v[i, 0], v[i, 1] = _into_turning(
            c, s, spin, r[i, 0], r[i, 1], v[i, 0], v[i, 1]
        )


@kernel
def variations_to_orbit_frame(spin, time, x_v, x_r):
    """`to_orbit_frame` of variations (n, 3, k) of velocity and position, in place."""
    c, s = math.cos(spin * time), math.sin(spin * time)
    for i in range(x_r.shape[0]):
        for b in range(x_r.shape[2]):
            x_r[i, 0, b], x_r[i, 1, b], x_v[i, 0, b], x_v[i, 1, b] = _into_orbit(
                c, s, spin, x_r[i, 0, b], x_r[i, 1, b], x_v[i, 0, b], x_v[i, 1, b]
            )


@kernel
def variations_to_turning_frame(spin, time, x_v, x_r):
    """The inverse of `variations_to_orbit_frame`, in place."""
    c, s = math.cos(spin * time), math.sin(spin * time)
    for i in range(x_r.shape[0]):
        for b in range(x_r.shape[2]):
            x_r[i, 0, b], x_r[i, 1, b], x_v[i, 0, b], x_v[i, 1, b] = _into_turning(
                c, s, spin, x_r[i, 0, b], x_r[i, 1, b], x_v[i, 0, b], x_v[i, 1, b]
            )
