"""The Jacobian of a configuration as if it stood still, Eqs. (34) and (52)."""

import numpy as np

from tss_ros.core.model import forces
from tss_ros.core.model.feedback import analysed, with_feedback
from tss_ros.core.model.kernel_arrays import kernel_arrays
from tss_ros.core.model.reel_law import rests_in_rows, rows_of
from tss_ros.core.model.system import State, System


def frozen_jacobian(
    system: System,
    state: State,
    speed: float = 1.0,
    length: float = 1.0,
    spin_rate_rad_s: float = 0.0,
) -> np.ndarray:
    """J_0 = dF/dx, Eq. (35), of Eq. (52) in the orbit frame at t = 0, Eq. (33).

    States are ordered as in Eq. (29).

    Parameters
    ----------
    system : System
    state : State
    speed, length : float
        Units of velocity [m/s] and position [m]; 1 gives SI.
    spin_rate_rad_s : float
        omega that feedback aims at.

    Returns
    -------
    ndarray, shape (6 rows, 6 rows), as `KernelArrays` has rows
        [1/s] in these units.
    """
    arrays = with_feedback(kernel_arrays(system, 0.0), system, spin_rate_rad_s)
    symbolic, n = analysed(system), arrays.inv_mass.size
    v, r = rows_of(system, state)
    by_r, by_v = np.empty((2, symbolic.row.size, 3, 3))
    rests = rests_in_rows(system, v, r) if n > system.n else None
    taut = forces.acting_tethers(system, state.position_m, state.velocity_m_s, rests)
    forces.jacobian(arrays, symbolic.pair, taut, 0.0, v, r, by_r, by_v)
    matrix = np.zeros((2, n, 3, 2, n, 3))
    matrix[0, symbolic.row, :, 0, symbolic.column, :] = by_v
    matrix[0, symbolic.row, :, 1, symbolic.column, :] = by_r * (length / speed)
    matrix = matrix.reshape(6 * n, 6 * n)
    matrix[3 * n :, : 3 * n] = np.eye(3 * n) * (speed / length)
    return matrix
