"""The system as the compiled kernels see it: plain arrays and numbers."""

from typing import NamedTuple

import numpy as np

from tss_ros.core.model.system import System


class KernelArrays(NamedTuple):
    """A `System` in the frame that turns at one spin rate.

    Attributes
    ----------
    ends : ndarray, shape (m, 2), int
        Indices of the two beads that each tether segment joins, Eq. (4).
    inv_mass : ndarray, shape (n,)
        1/m_i [1/kg].
    rest, stiffness, damping : ndarray, shape (m,)
        L [m], EA/L [N/m] and C [N s/m] of each segment, Eqs. (3) and (6).
    rate : float
        Omega [rad/s] of the orbit.
    radius : float
        R [m] of the orbit.
    spin : float
        omega [rad/s] of the turning frame against the orbit frame; 0 is the orbit frame itself.
    linear_gravity, bilateral : bool
        See `System`.
    """

    ends: np.ndarray
    inv_mass: np.ndarray
    rest: np.ndarray
    stiffness: np.ndarray
    damping: np.ndarray
    rate: float
    radius: float
    spin: float
    linear_gravity: bool
    bilateral: bool


def kernel_arrays(system: System, spin_rate_rad_s: float) -> KernelArrays:
    """Lay a `System` out for the kernels.

    Parameters
    ----------
    system : System
    spin_rate_rad_s : float
        omega [rad/s] of the turning frame.

    Returns
    -------
    KernelArrays
    """
    return KernelArrays(
        ends=np.array(system.tether_ends),
        inv_mass=1.0 / system.mass_kg,
        rest=np.array(system.rest_length_m),
        stiffness=system.axial_stiffness_n / system.rest_length_m,
        damping=np.array(system.damping_n_s_per_m),
        rate=float(system.orbit_rate_rad_s),
        radius=float(system.orbit_radius_m),
        spin=float(spin_rate_rad_s),
        linear_gravity=bool(system.linear_gravity),
        bilateral=bool(system.bilateral),
    )
