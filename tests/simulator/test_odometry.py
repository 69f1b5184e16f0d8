"""Odometry of satellites, relative to one of them or to the centre of mass."""

import numpy as np
import pytest
import ros_harness
from nav_msgs.msg import Odometry
from ros_harness import time_ns
from simulation_interfaces.srv import ResetSimulation, StepSimulation

from tss_ros.core import ReferenceOrbit, ring
from tss_ros.ros import frames
from tss_ros.simulator import odometry

SATELLITES = [f"satellite_{i}" for i in (1, 2, 3)]


def rows(values):
    return np.array(values).reshape(-1, 3)


def xyz(vector):
    return [vector.x, vector.y, vector.z]


@pytest.mark.parametrize("reference", ["satellite_2", "centre_of_mass"])
def test_odometry_is_the_motion_as_the_reference_sees_it(start, client, reference):
    node, spin_until = client
    given = {"satellite_mass_kg": [100.0, 300.0, 50.0], "spin_rate_ratio": -3.0}
    process = start("sim_node", odometry=reference, frame_prefix="a/", start_paused=True,
                    disturbance_m=20, time_scale=0, **given)  # fmt: skip
    simulator = ros_harness.Simulator(node, spin_until)
    simulator.join()
    others = [name for name in SATELLITES if name != reference]
    heard = {name: [] for name in others}
    for name in others:
        node.create_subscription(Odometry, f"/{name}/odom", heard[name].append, 100)
    # Who comes while it stands still gets the newest step.
    spin_until(lambda: all(heard.values()), ros_harness.START_S, "the step that stands")
    simulator.do(StepSimulation, steps=10)
    newest = simulator.settled()
    stamp = time_ns(newest.header.stamp)
    spin_until(lambda: all(time_ns(m[-1].header.stamp) == stamp for m in heard.values()), 10, "all")
    mass_kg = np.array(given["satellite_mass_kg"])
    for name, messages in heard.items():
        assert len(messages) >= 11
        message = messages[-1]
        assert message.header.frame_id == f"a/{reference}"
        assert message.child_frame_id == f"a/{name}"
        assert message.pose.pose.orientation.w == 1.0 and not message.pose.covariance.any()
        for values, vector in (
            (newest.position_m, message.pose.pose.position),
            (newest.velocity_m_s, message.twist.twist.linear),
        ):
            bead = dict(zip(newest.name, rows(values)))
            centre = sum(m * bead[n] for m, n in zip(mass_kg, SATELLITES)) / mass_kg.sum()
            expected = bead[name] - bead.get(reference, centre)
            np.testing.assert_allclose(xyz(vector), expected, rtol=1e-12, atol=1e-9)
    topics = {name for name, _ in node.get_topic_names_and_types() if name.endswith("/odom")}
    assert topics == {f"/{name}/odom" for name in others}
    assert process.stop() == 0, process.stderr


def test_odometry_follows_the_formation_and_the_parameter(start, client):
    node, spin_until = client
    process = start("sim_node", start_paused=True)
    simulator = ros_harness.Simulator(node, spin_until)
    simulator.join()

    def topics():
        names = node.get_topic_names_and_types()
        return sorted(name for name, _ in names if name.endswith("/odom"))

    assert topics() == []
    refused = simulator.set(odometry="satellite_4")
    assert not refused.successful
    assert refused.reason == (
        "odometry is 'satellite_4'; allowed: '', 'centre_of_mass' or a satellite of satellite_1, "
        "satellite_2, satellite_3"
    )
    assert simulator.set(odometry="satellite_4", satellites=4).successful
    assert not simulator.set(satellites=3).successful
    simulator.do(ResetSimulation)
    expected = [f"/{name}/odom" for name in SATELLITES]
    spin_until(lambda: topics() == expected, 10, f"{expected}, not {topics()}")
    assert simulator.set(odometry="centre_of_mass", satellites=5).successful
    simulator.do(ResetSimulation)
    expected = [f"/satellite_{i}/odom" for i in (1, 2, 3, 4, 5)]
    spin_until(lambda: topics() == expected, 10, f"{expected}, not {topics()}")
    assert simulator.set(odometry="").successful
    simulator.do(ResetSimulation)
    spin_until(lambda: topics() == [], 10, f"none, not {topics()}")
    assert process.stop() == 0, process.stderr


@pytest.mark.parametrize(
    ("name", "reference", "text"),
    [
        ("a", "c", "odometry is 'c'; allowed: '', 'centre_of_mass' or a satellite of a, b"),
        ("my craft", "b", "odometry needs names that topics may have; 'my craft' is none"),
    ],
)
def test_odometry_that_cannot_be_ends_the_node_with_one_line(
    start, tmp_path, name, reference, text
):
    (tmp_path / "pair.yaml").write_text(
        f"spin_rate_ratio: -3.0\nbodies:\n"
        f"  - {{name: {name}, mass_kg: 100, position_m: [0, 500, 0]}}\n"
        f"  - {{name: b, mass_kg: 100, position_m: [0, -500, 0]}}\n"
        f"tethers:\n  - {{between: [{name}, b], length_m: 1000.0, axial_stiffness_n: 5.0e4,"
        " damping_n_s_per_m: 500.0}\n"
    )
    process = start("sim_node", scenario=str(tmp_path / "pair.yaml"), odometry=reference)
    assert process.wait(ros_harness.START_S) == 1
    (line,) = process.stderr.splitlines()
    assert line.startswith("sim_node: ") and text in line


def test_the_centre_of_mass_has_a_frame():
    system = ring()
    beads_m = np.arange(9.0).reshape(3, 3)
    centre_m = odometry.centre_of_mass(system, beads_m)
    np.testing.assert_allclose(centre_m, beads_m.mean(axis=0))
    points = {**dict(zip(system.bead_name, beads_m)), odometry.CENTRE_OF_MASS: centre_m}
    last = frames.transforms(ReferenceOrbit(system), 0, points, "a/")[-1]
    assert (last.header.frame_id, last.child_frame_id) == ("a/orbit", "a/centre_of_mass")
    assert xyz(last.transform.translation) == centre_m.tolist()
