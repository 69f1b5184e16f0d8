"""Frames: those on /tf stand where the geometry of the orbit puts them."""

import numpy as np
import pytest
from ros_harness import time_ns
from scipy.spatial.transform import Rotation

from tss_ros.core import ring
from tss_ros.core.model.orbits import ReferenceOrbit
from tss_ros.ros import frames

QUARTER_S = 2 * np.pi / np.sqrt(3.986e14 / 7378e3**3) / 4


def read(transform):
    """Translation, and rotation as a matrix."""
    move, turn = transform.translation, transform.rotation
    quaternion = [turn.x, turn.y, turn.z, turn.w]
    return np.array([move.x, move.y, move.z]), Rotation.from_quat(quaternion).as_matrix()


@pytest.mark.parametrize(
    ("elements", "turned_by", "axis"),
    [
        # At the ascending node, which is the vernal equinox: up is x, the flight goes along y.
        ({}, 0.0, [0, 0, 1]),
        ({}, QUARTER_S, [0, 0, 1]),
        # Over the poles: the flight from the node goes north.
        ({"inclination_deg": 90.0}, 0.0, [0, -1, 0]),
        ({"inclination_deg": 90.0, "raan_deg": 90.0}, QUARTER_S, [1, 0, 0]),
        ({"argument_of_perigee_deg": 40.0, "true_anomaly_deg": 50.0}, 0.0, [0, 0, 1]),
    ],
)
def test_frames_stand_where_the_orbit_puts_them(elements, turned_by, axis):
    """Against geometry by hand: axes of both frames, the centre, and a bead."""
    system, now_ns = ring(**elements), round(turned_by * 1e9)
    node = np.radians(elements.get("raan_deg", 0.0))
    node = np.array([np.cos(node), np.sin(node), 0.0])
    ahead = np.cross(axis, node)
    latitude = turned_by / QUARTER_S * 90.0 + sum(
        elements.get(name, 0.0) for name in ("argument_of_perigee_deg", "true_anomaly_deg")
    )
    up = np.cos(np.radians(latitude)) * node + np.sin(np.radians(latitude)) * ahead
    bead_m = np.array([100.0, 20.0, 3.0])
    points = {"a": bead_m, "b": -bead_m}
    orbit, *beads = frames.transforms(ReferenceOrbit(system), now_ns, points, "left/")
    assert (orbit.header.frame_id, orbit.child_frame_id) == ("left/inertial", "left/orbit")
    assert time_ns(orbit.header.stamp) == now_ns
    centre_m, attitude = read(orbit.transform)
    np.testing.assert_allclose(centre_m, 7378e3 * up, atol=0.1)
    expected = np.stack([np.cross(up, axis), up, axis], axis=1)
    np.testing.assert_allclose(attitude, expected, atol=1e-8)
    assert [frame.child_frame_id for frame in beads] == ["left/a", "left/b"]
    assert {frame.header.frame_id for frame in beads} == {"left/orbit"}
    for frame, place in zip(beads, points.values()):
        found, attitude = read(frame.transform)
        np.testing.assert_array_equal(found, place)
        np.testing.assert_array_equal(attitude, np.eye(3))


def test_frames_follow_an_ellipse():
    system = ring(eccentricity=0.5, inclination_deg=30.0, argument_of_perigee_deg=90.0)
    orbit = ReferenceOrbit(system)
    for share in (0.0, 0.25, 0.5, 0.9):
        frame, *_ = frames.transforms(orbit, round(share * orbit.period_s * 1e9), {})
        centre_m, attitude = read(frame.transform)
        # Up goes through the centre, and the normal stays that of the elements.
        np.testing.assert_allclose(attitude[:, 1], centre_m / np.linalg.norm(centre_m), atol=1e-12)
        np.testing.assert_allclose(attitude[:, 2], [0.0, -0.5, np.sqrt(0.75)], atol=1e-12)
    apogee_m = np.linalg.norm(read(frames.transforms(orbit, round(orbit.period_s * 5e8), {})[0]
                                   .transform)[0])  # fmt: skip
    np.testing.assert_allclose(apogee_m, 3.0 * 7378e3, rtol=1e-9)
