"""The ROS environment of a test run: this machine only, and a domain of its own."""

import os
import random
import socket

import pytest

from tss_ros.ros.network import stay_on_this_machine


def _reserve_domain_id():
    """Return a ROS domain ID that no other test run has, and the socket that keeps it reserved.

    A bound port stands for a domain, with the port numbers of ROS 2's own `domain_coordinator`, so
    that its test runs are kept clear of as well.
    """
    for domain_id in random.sample(range(1, 101), 100):
        reservation = socket.socket()
        try:
            reservation.bind(("127.0.0.1", 32768 + domain_id))
            return domain_id, reservation
        except OSError:
            reservation.close()
    raise RuntimeError("all ROS domain IDs from 1 to 100 are taken by other test runs")


DOMAIN_ID, _reservation = _reserve_domain_id()
os.environ["ROS_DOMAIN_ID"] = str(DOMAIN_ID)
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
stay_on_this_machine()

import ros_harness  # noqa: E402, it starts ROS, which reads the environment


def pytest_xdist_auto_num_workers():
    """One more than there are processors: tests wait for nodes more than they compute."""
    return min((os.cpu_count() or 1) + 1, 4)


@pytest.fixture
def start(tmp_path):
    """A function that starts nodes in a folder of the test; they are gone when it ends."""
    with ros_harness.processes(tmp_path) as start:
        yield start


@pytest.fixture
def client():
    """A node of this process, and a function that spins it until something holds."""
    with ros_harness.client_node() as (node, spin_until):
        yield node, spin_until


@pytest.hookimpl(trylast=True)
def pytest_sessionfinish():
    """Leave nothing in shared memory: all nodes, and the workers of this run, are gone by now."""
    ros_harness.remove_left_behind()
