"""Bags read by readers that are not ours, and a run to read: one turn, recorded by real nodes."""

import math

import ros_harness
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

# Table 1 of the paper at -2.5 Omega, worked out here and not by the package.
ORBIT_RATE = math.sqrt(3.986e14 / 7378e3**3)
TURN_S = 2 * math.pi / (2.5 * ORBIT_RATE)

PERIOD_S = 5.0
STEPS = 1 + math.floor(TURN_S / PERIOD_S)


def record_one_turn(directory):
    """Record one turn at full speed to `bag` in a directory, which is returned."""
    with ros_harness.processes(directory) as start:
        logger = start("logger_node", output="bag")
        simulator = start(
            "sim_node",
            time_scale=0,
            turns=1,
            publish_period_s=PERIOD_S,
            disturbance_m=10,
            disturbance_seed=7,
            wait_for_recorder=True,
        )
        assert simulator.wait(ros_harness.START_S) == 0, simulator.stderr
        assert logger.stop() == 0, logger.stderr
    assert "Traceback" not in simulator.stderr + logger.stderr
    assert f"{5 * STEPS + 1} messages, 0 lost" in logger.stdout
    return directory


def messages_by_topic(bag):
    """Every message of a bag: {topic: [(log time, message)]}."""
    messages = {}
    with AnyReader([bag], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
        for connection, log_time_ns, data in reader.messages():
            message = reader.deserialize(data, connection.msgtype)
            messages.setdefault(connection.topic, []).append((log_time_ns, message))
    return messages


def serialised_messages(bag):
    """(topic, log time, data) of every message of a bag."""
    with AnyReader([bag]) as reader:
        return [
            (connection.topic, time_ns, data) for connection, time_ns, data in reader.messages()
        ]


def recorded_steps(bag, topic):
    """The steps of a topic's messages, in the order of the bag."""
    with AnyReader([bag]) as reader:
        connections = [c for c in reader.connections if c.topic == topic]
        return [
            reader.deserialize(data, connection.msgtype).step
            for connection, _, data in reader.messages(connections=connections)
        ]
