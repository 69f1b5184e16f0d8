"""The system as the compiled kernels see it: plain arrays and numbers."""

from typing import NamedTuple

import numpy as np

from tss_ros.core.model.laws import LAW_PARAMETERS
from tss_ros.core.model.made import TENSION_INDEX
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
    rate, mean_motion : float
        Omega and n [rad/s] of the orbit.
    radius : float
        R [m] of the orbit.
    spin : float
        omega [rad/s] of the turning frame against the orbit frame; 0 is the orbit frame itself.
    drive : float
        [1/s^2] about z, see `laws.inertia`; 0 but where motions are closed.
    drive_across : tuple of two float
        [1/s^2] the same about x and y, in the orbit frame only; 0 but for other axes than z.
    bilateral, pushes : bool
        Whether segments are always taut, and whether taut ones may push.
    tension : int
        Index into `made.TENSIONS` of what taut segments do.
    acting : int
        Which of `laws.BEAD_LAWS` act, one bit each.
    constants : tuple of float
        Values of `laws.LAW_PARAMETERS`.
    """

    ends: np.ndarray
    inv_mass: np.ndarray
    rest: np.ndarray
    stiffness: np.ndarray
    damping: np.ndarray
    rate: float
    mean_motion: float
    radius: float
    spin: float
    drive: float
    drive_across: tuple[float, float]
    bilateral: bool
    pushes: bool
    tension: int
    acting: int
    constants: tuple[float, ...]


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
        mean_motion=float(system.mean_motion_rad_s),
        radius=float(system.orbit_radius_m),
        spin=float(spin_rate_rad_s),
        drive=0.0,
        drive_across=(0.0, 0.0),
        bilateral=bool(system.bilateral),
        pushes=bool(system.law.pushes),
        tension=TENSION_INDEX[system.tether_law],
        acting=sum(1 << i for i, acts in enumerate(system.acting) if acts),
        constants=tuple(system.law_parameters[p.name] for p in LAW_PARAMETERS),
    )
