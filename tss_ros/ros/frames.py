"""The frames on /tf: the orbit frame in the inertial one, and every bead in the orbit frame.

Axes follow REP 103: right-handed, metres. `inertial` has its origin in the Earth's centre, x to the
vernal equinox and z to the north. `orbit` has y up and z along the orbit normal.
"""

from collections.abc import Mapping

import numpy as np
from geometry_msgs.msg import TransformStamped
from scipy.spatial.transform import Rotation
from std_msgs.msg import Header

from tss_ros.core.model.orbits import ReferenceOrbit
from tss_ros.messages.steps import FRAME_ID
from tss_ros.ros.messages import stamp

#: The frame at rest in the Earth's centre.
INERTIAL_FRAME_ID = "inertial"


def transforms(
    orbit: ReferenceOrbit, time_ns: int, point_m: Mapping[str, np.ndarray], prefix: str = ""
) -> list[TransformStamped]:
    """Frames as TransformStamped: orbit in inertial, every point in orbit, named with a prefix.

    Parameters
    ----------
    orbit : ReferenceOrbit
        That of the formation's nominal centre.
    time_ns : int
    point_m : mapping of str to ndarray, shape (3,)
        Beads and other points of the orbit frame [m], which have no attitude, by name.
    prefix : str

    Returns
    -------
    list of geometry_msgs.msg.TransformStamped
        One more than there are points.
    """
    time_s = np.array([time_ns / 1e9])
    centre_m, attitude = orbit.inertial_state(time_s)[0][0], orbit.inertial_axes(time_s)[0]
    header = Header(stamp=stamp(time_ns), frame_id=prefix + FRAME_ID)
    frames = [
        TransformStamped(header=header, child_frame_id=prefix + name)
        for name in (FRAME_ID, *point_m)
    ]
    frames[0].header = Header(stamp=header.stamp, frame_id=prefix + INERTIAL_FRAME_ID)
    turn = frames[0].transform.rotation
    turn.x, turn.y, turn.z, turn.w = Rotation.from_matrix(attitude).as_quat().tolist()
    for frame, (x, y, z) in zip(frames, map(np.ndarray.tolist, (centre_m, *point_m.values()))):
        place = frame.transform.translation
        place.x, place.y, place.z = x, y, z
    return frames
