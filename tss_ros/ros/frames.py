"""The frames on /tf: the orbit frame in the inertial one, and every bead in the orbit frame."""

import math
from collections.abc import Mapping
from types import MappingProxyType

import numpy as np
from geometry_msgs.msg import TransformStamped
from std_msgs.msg import Header

from tss_ros.core import System
from tss_ros.messages.steps import FRAME_ID
from tss_ros.ros.messages import stamp

#: The frame at rest in the Earth's centre whose axes the orbit frame has at time 0.
INERTIAL_FRAME_ID = "inertial"


def transforms(
    system: System,
    time_ns: int,
    position_m: np.ndarray,
    prefix: str = "",
    others: Mapping[str, np.ndarray] = MappingProxyType({}),
) -> list[TransformStamped]:
    """Frames as TransformStamped: orbit in inertial, every bead in orbit, named with a prefix.

    Parameters
    ----------
    system : System
    time_ns : int
    position_m : ndarray, shape (n, 3)
    prefix : str
    others : mapping of str to ndarray, shape (3,)
        Other points of the orbit frame [m] that have a frame, by its name.

    Returns
    -------
    list of geometry_msgs.msg.TransformStamped
        n + 1 of them, and those of the others. The orbit frame turns about z with the orbital rate,
        y pointing away from the Earth; beads have no attitude.
    """
    angle = math.fmod(system.orbit_rate_rad_s * time_ns / 1e9, 2.0 * math.pi)
    centre_m = system.orbit_radius_m * np.array([-math.sin(angle), math.cos(angle), 0.0])
    names = [FRAME_ID, *system.bead_name, *others]
    points_m = [centre_m, *position_m, *others.values()]
    header = Header(stamp=stamp(time_ns), frame_id=prefix + FRAME_ID)
    frames = [TransformStamped(header=header, child_frame_id=prefix + name) for name in names]
    frames[0].header = Header(stamp=header.stamp, frame_id=prefix + INERTIAL_FRAME_ID)
    frames[0].transform.rotation.z = math.sin(angle / 2.0)
    frames[0].transform.rotation.w = math.cos(angle / 2.0)
    for frame, (x, y, z) in zip(frames, map(np.ndarray.tolist, points_m)):
        place = frame.transform.translation
        place.x, place.y, place.z = x, y, z
    return frames
