"""Four readers that share no code with the recorder find the same messages in a bag."""

import hashlib
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
import ros_harness
from mcap_ros2.reader import read_ros2_messages
from rerun.chunk import McapReader
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

NODE_PACKAGES = (
    "@mcap/core@2",
    "@mcap/support@1",
    "@foxglove/rosmsg@5",
    "@foxglove/rosmsg2-serialization@3",
)


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    """A short run, recorded by the real nodes, and how many messages they say it has."""
    directory = tmp_path_factory.mktemp("run")
    with ros_harness.processes(directory) as start:
        logger = start("logger_node", output="bag")
        simulator = start(
            "sim_node", time_scale=0, turns=0.1, disturbance_m=10, wait_for_recorder=True
        )
        assert simulator.wait(ros_harness.START_S) == 0, simulator.stderr
        assert logger.stop() == 0, logger.stderr
    count = int(re.search(r"(\d+) messages, 0 lost", logger.stdout)[1])
    return directory / "bag", count


def numbers(value):
    """Every number of a message in the order of its fields, whatever kind of object it is."""
    if isinstance(value, (bool, int, float, np.generic)):
        yield float(value)
    elif isinstance(value, (list, tuple)):
        for part in value:
            yield from numbers(part)
    elif isinstance(value, (np.ndarray, bytes, bytearray)):
        yield from map(float, value)
    elif isinstance(value, dict):
        yield from numbers(list(value.values()))
    elif hasattr(value, "__slots__") or hasattr(value, "__dict__"):
        fields = getattr(value, "__dict__", None) or {
            name: getattr(value, name) for name in value.__slots__
        }
        # rosbags keeps the constants of a type among its fields.
        yield from numbers([v for k, v in fields.items() if not (k.isupper() or k[:2] == "__")])


def digests(messages):
    """Of (topic, message): {topic: (count, digest of all numbers)}."""
    found = {}
    for topic, message in messages:
        count, digest = found.get(topic, (0, hashlib.sha256()))
        digest.update(np.fromiter(numbers(message), float).tobytes())
        found[topic] = (count + 1, digest)
    return {topic: (count, digest.hexdigest()) for topic, (count, digest) in found.items()}


def by_rosbags(bag):
    with AnyReader([bag], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
        return digests(
            (c.topic, reader.deserialize(data, c.msgtype)) for c, _, data in reader.messages()
        )


def by_mcap_ros2_support(bag):
    messages = read_ros2_messages(str(bag / "bag_0.mcap"))
    return digests((m.channel.topic, m.ros_msg) for m in messages)


def by_rerun(bag):
    found = []
    reader = McapReader(str(bag / "bag_0.mcap"), decoders=["ros2_reflection"])
    for chunk in reader.stream().to_chunks():
        batch = chunk.to_record_batch()
        for name, column in zip(batch.schema.names, batch.columns):
            if name.endswith(":message") and not chunk.is_static:
                found += [(str(chunk.entity_path), row[0]) for row in column.to_pylist()]
    return digests(found)


@pytest.fixture(scope="module")
def node_modules(tmp_path_factory):
    """A folder with the packages that Foxglove reads MCAP with."""
    folder = tmp_path_factory.mktemp("node")
    if not (shutil.which("node") and shutil.which("npm")):
        pytest.skip("needs node and npm")
    command = ["npm", "install", "--no-audit", "--no-fund", "--ignore-scripts", *NODE_PACKAGES]
    if subprocess.run(command, cwd=folder, capture_output=True, timeout=120).returncode:
        pytest.skip("npm cannot install the packages here")
    return folder


def test_three_readers_in_python_agree_on_every_message(bag):
    path, count = bag
    expected = by_rosbags(path)
    assert sum(n for n, _ in expected.values()) == count
    assert by_mcap_ros2_support(path) == expected
    assert by_rerun(path) == expected


def test_the_reader_of_foxglove_agrees(bag, node_modules):
    path, _ = bag
    program = Path(__file__).parents[1] / "helpers" / "read_bag.mjs"
    done = subprocess.run(
        ["node", program, path / "bag_0.mcap"], cwd=node_modules, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    rows = (line.split() for line in done.stdout.splitlines())
    found = {topic: (int(count), digest) for topic, count, digest in rows if count != "0"}
    assert found == by_rosbags(path)
