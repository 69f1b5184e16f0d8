"""Frames: those on /tf stand where the geometry of the orbit puts them."""

import numpy as np
from ros_harness import time_ns

from tss_ros.core import ring
from tss_ros.ros import frames


def test_frames_turn_with_the_orbit():
    """Against the orbit's own geometry: position and velocity of the centre, and of a bead."""
    system = ring()
    quarter_ns = round(2 * np.pi / np.sqrt(3.986e14 / 7378e3**3) / 4 * 1e9)
    bead_m = np.array([[100.0, 20.0, 3.0]] * 3)
    for now_ns, centre, bead in (
        (0, [0.0, 7378e3, 0.0], [100.0, 20.0, 3.0]),
        # A quarter of an orbit later x points where y did: up has become -x.
        (quarter_ns, [-7378e3, 0.0, 0.0], [-20.0, 100.0, 3.0]),
    ):
        orbit, *beads = frames.transforms(system, now_ns, bead_m, "left/")
        assert (orbit.header.frame_id, orbit.child_frame_id) == ("left/inertial", "left/orbit")
        move, turn = orbit.transform.translation, orbit.transform.rotation
        assert time_ns(orbit.header.stamp) == now_ns
        np.testing.assert_allclose([move.x, move.y, move.z], centre, atol=0.1)
        names = [f"left/{name}" for name in system.bead_name]
        assert [frame.child_frame_id for frame in beads] == names
        assert {frame.header.frame_id for frame in beads} == {"left/orbit"}
        place = beads[1].transform.translation
        # The rotation of a vector by the quaternion (0, 0, z, w).
        c, s = turn.w**2 - turn.z**2, 2 * turn.w * turn.z
        turned = [c * place.x - s * place.y, s * place.x + c * place.y, place.z]
        np.testing.assert_allclose(turned, bead, atol=1e-3)
