"""The system as the compiled kernels see it: plain arrays and numbers."""

from typing import NamedTuple

import numpy as np

from tss_ros.core.model.laws import LAW_PARAMETERS
from tss_ros.core.model.made import TENSION_INDEX
from tss_ros.core.model.system import MU_EARTH, System

#: Columns of `KernelArrays.reel` behind the cubics.
ROW, AIM = 4, 5


class KernelArrays(NamedTuple):
    """A `System` in the frame that turns at one spin rate.

    Attributes
    ----------
    beads : int
        n. Kernels' states have a row for each of them, and one more for each reel that follows
        tension: its rest length [m] and rate [m/s] are the first numbers there, the others are 0.
    ends : ndarray, shape (m, 2), int
        Indices of the two beads that each tether segment joins, Eq. (4).
    inv_mass : ndarray, shape (rows,)
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
    thrust : ndarray, shape (3, n, 3)
        [m/s^2] of each bead by thrusters, in each of `commands.FRAMES`; (0, 0, 0) where none acts.
    thrust_axis : tuple of float
        Unit vector in the orbit frame about which the axes of `thrust` that spin turn.
    thrust_spin : float
        omega [rad/s] of these axes against the orbit frame.
    reel : ndarray, shape (m, 6)
        Rest length of each segment as a cubic of the time since `reel_since`: [m], [m/s] and so
        on; EA stays, so that stiffness and damping change like 1/L. Then, in column `ROW`, the row
        of a rest length that is a state, whose cubic counts only if it says `NEVER_M`; -1 for
        others. Then T_0 [N] of such a reel, in column `AIM`. Empty where no rest length changes.
    reel_since : float
        [s]
    reeling : int
        Which of `laws.REEL_LAWS` act, one bit each.
    bilateral, pushes : bool
        Whether segments are always taut, and whether taut ones may push.
    tension : int
        Index into `made.TENSIONS` of what taut segments do.
    acting : int
        Which of `laws.BEAD_LAWS` act, one bit each.
    constants : tuple of float
        Values of `laws.LAW_PARAMETERS`.
    satellite : ndarray, shape (rows,)
        One over the number of satellites for each of them, 0 for other beads; empty where no
        feedback acts, see `model.feedback_thrust`.
    shape : ndarray, shape (rows, 3)
        [m] places in the steady shape from the mean of the satellites, which the feedback keeps.
    aim : float
        omega [rad/s] about z that the feedback aims at.
    thrusting : int
        Which of `laws.THRUST_LAWS` act, one bit each.
    orbit_starts : ndarray, shape (k + 1,)
        [s] where the pieces of the orbit's table begin, and where the last one ends; empty on a
        circle, which needs no table.
    orbit_table : ndarray, shape (k, degree + 1, 3)
        [m] polynomials of the centre's place from the Earth's, in axes fixed among the stars that
        are those of the orbit frame at time 0, by a time from -1 to 1 in each piece.
    orbit_period, orbits_per_s : float
        [s] after which the table serves again, and 1 over it; 0 if it does not.
    mu : float
        [m^3/s^2] of the Earth.
    pole, sun : tuple of float
        Unit vectors to the north and to the Sun, in the same axes.
    """

    beads: int
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
    thrust: np.ndarray
    thrust_axis: tuple[float, float, float]
    thrust_spin: float
    reel: np.ndarray
    reel_since: float
    reeling: int
    bilateral: bool
    pushes: bool
    tension: int
    acting: int
    constants: tuple[float, ...]
    satellite: np.ndarray
    shape: np.ndarray
    aim: float
    thrusting: int
    orbit_starts: np.ndarray
    orbit_table: np.ndarray
    orbit_period: float
    orbits_per_s: float
    mu: float
    pole: tuple[float, float, float]
    sun: tuple[float, float, float]


def kernel_arrays(system: System, spin_rate_rad_s: float) -> KernelArrays:
    """Lay a `System` out for the kernels, on a circle; `orbits.ReferenceOrbit` knows others.

    Without what `feedback.with_feedback` and `reel_law.with_reels` add.

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
        beads=int(system.n),
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
        thrust=np.empty((0, 0, 0)),
        thrust_axis=(0.0, 0.0, 1.0),
        thrust_spin=0.0,
        reel=np.empty((0, 6)),
        reel_since=0.0,
        reeling=0,
        bilateral=bool(system.bilateral),
        pushes=bool(system.law.pushes),
        tension=TENSION_INDEX[system.tether_law],
        acting=sum(1 << i for i, acts in enumerate(system.acting) if acts),
        constants=tuple(system.law_parameters[p.name] for p in LAW_PARAMETERS),
        satellite=np.empty(0),
        shape=np.empty((0, 3)),
        aim=0.0,
        thrusting=0,
        orbit_starts=np.empty(0),
        orbit_table=np.empty((0, 0, 3)),
        orbit_period=0.0,
        orbits_per_s=0.0,
        mu=MU_EARTH,
        pole=(0.0, 0.0, 1.0),
        sun=(0.0, 0.0, 0.0),
    )
