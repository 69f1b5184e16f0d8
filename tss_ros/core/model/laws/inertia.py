"""What a frame that turns about z adds to motion seen from it: linear, so stated as code alone."""

from tss_ros.core.numerics.simd import leaf


@leaf
def inertia(x, y, vx, vy, centrifugal, coriolis):
    """Accelerations along x and y by centrifugal force and Coriolis force, Eqs. (9) and (11).

    Linear in what it takes, so that it serves values, coefficients of series and variations alike.

    Parameters
    ----------
    x, y, vx, vy : float or Lanes
        Position [m] and velocity [m/s] in the frame.
    centrifugal, coriolis : float
        [1/s^2] and [1/s], 2 times the rate at which the frame turns.
    """
    return centrifugal * x + coriolis * vy, centrifugal * y - coriolis * vx
