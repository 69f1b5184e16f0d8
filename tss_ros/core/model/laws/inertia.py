"""What a frame that turns about z adds to motion seen from it: linear, so stated as code alone."""

from tss_ros.core.numerics.simd import leaf


@leaf
def inertia(x, y, vx, vy, centrifugal, coriolis, drive):
    """Accelerations along x and y by centrifugal and Coriolis force, Eqs. (9), (11), and a drive.

    The drive is an Euler force, drive z x r: it makes up for the spin that damping takes, so that
    motions of damped formations close (`stability.closing`). Simulations have none. That about
    other axes than z stands in `forces`.

    Linear in what it takes, so that it serves values, coefficients of series and variations alike.

    Parameters
    ----------
    x, y, vx, vy : float or Lanes
        Position [m] and velocity [m/s] in the frame.
    centrifugal, coriolis : float
        [1/s^2] and [1/s], 2 times the rate at which the frame turns.
    drive : float
        [1/s^2] angular acceleration about the frame's origin.
    """
    return (
        centrifugal * x + coriolis * vy - drive * y,
        centrifugal * y - coriolis * vx + drive * x,
    )
