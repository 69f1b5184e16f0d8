"""Bags without nodes: what is written can be read, by others too, and what is broken is refused."""

import numpy as np
import pytest
from mcap.exceptions import McapError
from mcap.records import Chunk, Message
from mcap.stream_reader import StreamReader, breakup_chunk
from rclpy.serialization import serialize_message
from rosbags.highlevel import AnyReader
from small_bag import TOPICS, Bag
from std_msgs.msg import Header
from tss_interfaces.msg import AppliedWrenches, BeadStates, TetherStates

from tss_ros.bags.recording import read_bag
from tss_ros.bags.records import BagError
from tss_ros.bags.writer import BagWriter
from tss_ros.core import TssError, initial_state, ring
from tss_ros.messages.cdr import Layout, stamp_ns, step_number
from tss_ros.messages.steps import States, StepMessages, system_description
from tss_ros.messages.topics import STATE_TOPICS
from tss_ros.ros.messages import simulation_event, stamp


@pytest.fixture
def bag(tmp_path):
    return Bag(tmp_path / "some" / "bag")


def test_reading_gives_back_what_was_written(bag):
    bag.describe()
    for number in range(100):
        bag.step(number)
    bag.writer.close()
    assert sorted(path.name for path in bag.writer.directory.iterdir()) == [
        "bag_0.mcap",
        "metadata.yaml",
    ]
    for path in (bag.writer.directory, bag.writer.path):
        recording = read_bag(path)
        assert recording.scenario == "pair"
        assert recording.bead_name == ("a", "bb") and recording.tether_name == ("t",)
        assert recording.is_satellite.tolist() == [True, False]
        assert recording.tether_ends.tolist() == [[0, 1]]
        assert recording.mass_kg.tolist() == [1.0, 2.0]
        assert recording.reference_radius_m.tolist() == [3.0, 4.0]
        assert recording.damping_n_s_per_m.tolist() == [30.0]
        assert (recording.disturbance_m, recording.disturbance_seed) == (0.5, 8)
        assert recording.step.tolist() == list(range(100))
        np.testing.assert_allclose(recording.t_s, 0.25 * np.arange(100), rtol=1e-15)
        # -2 Omega at 1e-3 rad/s: 24.75 s are 0.0495 rad.
        assert recording.turns[-1] == pytest.approx(0.0495 / (2 * np.pi))
        for field in ("position_m", "velocity_m_s", "deviation"):
            sent = [getattr(beads, field) for beads, _ in bag.written]
            np.testing.assert_array_equal(getattr(recording, field).reshape(100, -1), sent)
        for field in ("length_m", "tension_n", "taut"):
            sent = [getattr(tethers, field) for _, tethers in bag.written]
            np.testing.assert_array_equal(getattr(recording, field), sent)
        assert recording.position_m.shape == (100, 2, 3)
        assert recording.taut.dtype == bool


def test_only_whole_steps_are_read(bag):
    bag.describe()
    for number in range(10):
        bag.step(number, with_tether=number != 4)
    bag.writer.close()
    assert read_bag(bag.writer.path).step.tolist() == [0, 1, 2, 3, 5, 6, 7, 8, 9]


def test_counts_and_times_stand_in_the_metadata(bag):
    bag.describe()
    for number in range(4, 9):
        bag.step(number)
    bag.writer.close()
    assert bag.writer.message_count == 11
    with AnyReader([bag.writer.directory]) as reader:
        assert reader.message_count == 11
        assert {c.topic: c.msgcount for c in reader.connections} == {
            "/system_description": 1,
            "/bead_states": 5,
            "/tether_states": 5,
        }
        assert (reader.start_time, reader.end_time - 1) == (0, 2_000_000_000)


def test_an_empty_bag_is_a_whole_bag(bag):
    bag.writer.close()
    with AnyReader([bag.writer.directory]) as reader:
        assert reader.message_count == 0
    with pytest.raises(TssError, match="no message of type BeadStates"):
        read_bag(bag.writer.directory)


def test_what_was_flushed_survives_the_recorder(bag):
    bag.describe()
    for number in range(50):
        bag.step(number)
    bag.writer.flush()
    bag.step(50)
    found = []
    with bag.writer.path.open("rb") as stream, pytest.raises(McapError):
        for record in StreamReader(stream, emit_chunks=True).records:
            if isinstance(record, Chunk):
                found += breakup_chunk(record, validate_crc=True)
    assert sum(isinstance(record, Message) for record in found) == 101


def test_a_cut_file_is_refused_in_words(bag):
    bag.describe()
    bag.step(0)
    bag.writer.flush()
    with pytest.raises(BagError, match="bag_0.mcap: it is cut short, .* not a complete MCAP file"):
        read_bag(bag.writer.path)
    recording = read_bag(bag.writer.path, damaged=True)
    assert recording.step.tolist() == [0] and len(recording.damage) == 1


def test_other_files_are_refused_in_words(tmp_path):
    (tmp_path / "notes.mcap").write_text("not a recording, but long enough to look like one")
    with pytest.raises(BagError, match="notes.mcap' is not an MCAP file"):
        read_bag(tmp_path / "notes.mcap")
    with pytest.raises(TssError, match="missing' cannot be read: No such file"):
        read_bag(tmp_path / "missing")
    (tmp_path / "empty").mkdir()
    with pytest.raises(TssError, match="empty' holds no .mcap file"):
        read_bag(tmp_path / "empty")


def test_a_simulation_that_began_anew_is_read_run_by_run(bag):
    bag.describe(spin_rate_ratio=-2.0)
    for number in (0, 1, 2):
        bag.step(number)
    bag.describe(spin_rate_ratio=-3.0)
    for number in (0, 1):
        bag.step(number)
    bag.writer.close()
    last, first = read_bag(bag.writer.directory), read_bag(bag.writer.directory, run=1)
    assert (last.run, last.runs, last.spin_rate_ratio, last.step.tolist()) == (2, 2, -3.0, [0, 1])
    assert (first.run, first.spin_rate_ratio, first.step.tolist()) == (1, -2.0, [0, 1, 2])
    for recording, written in ((first, bag.written[:3]), (last, bag.written[3:])):
        sent = [beads.position_m for beads, _ in written]
        np.testing.assert_array_equal(recording.position_m.reshape(len(written), -1), sent)
    with pytest.raises(TssError, match="run is 3; allowed for .* 1 to 2"):
        read_bag(bag.writer.directory, run=3)


def test_events_and_changes_are_those_of_the_run(tmp_path):
    """A simulator that is reset, and one that is started anew and counts from 0 again."""

    class Told(Bag):
        topics = (*Bag.topics, "simulation_events", "applied_wrenches")

    bag = Told(tmp_path / "bag")
    runs = (0, "fail", (0, 1)), (1, "reset", (2, 3)), (0, "cut", (0, 1))
    for number, (run, kind, steps) in enumerate(runs):
        bag.describe(-2.0 - number, run=run, first_step=steps[0])
        if run == 0:
            bag.write("applied_wrenches", AppliedWrenches(run=run), 0)
        bag.step(steps[0])
        event = simulation_event(0, steps[1], run, kind, f"{kind} it", "orbit")
        bag.write("simulation_events", event, 0)
        bag.write("applied_wrenches", AppliedWrenches(run=run, step=steps[1]), 0)
        bag.step(steps[1])
    bag.writer.close()
    told = [read_bag(bag.writer.directory, run) for run in (1, 2, 3)]
    assert [r.events for r in told] == [((k, f"{k} it"),) for k in ("fail", "reset", "cut")]
    assert [r.changes for r in told] == [2, 1, 2]


def test_states_that_share_no_step_are_refused(bag):
    bag.describe()
    for number in range(4):
        bag.step(number, with_beads=number < 2, with_tether=number >= 2)
    bag.writer.close()
    with pytest.raises(TssError, match="no step of both: BeadStates 0 to 1, TetherStates 2 to 3"):
        read_bag(bag.writer.directory)


def test_an_existing_directory_is_never_written_to(tmp_path):
    (tmp_path / "bag").mkdir()
    with pytest.raises(TssError, match="bag' exists already"):
        BagWriter(tmp_path / "bag", "jazzy")
    assert list((tmp_path / "bag").iterdir()) == []


@pytest.mark.parametrize("frame_id", ["", "o", "orbit", "a_long_frame_name"])
def test_numbers_are_found_in_serialised_messages(frame_id):
    header = Header(stamp=stamp(12_345_678_901_234), frame_id=frame_id)
    for message in (BeadStates(header=header, step=2**40 + 7), TetherStates(header=header, step=9)):
        data = bytes(serialize_message(message))
        assert step_number(data) == message.step
        assert stamp_ns(data) == 12_345_678_901_234


def test_every_recorded_topic_has_its_stamp_where_it_is_looked_for():
    system = ring()
    state = initial_state(system, -2.5)
    make, ones = StepMessages(system, np.ones(3)), np.ones(3)
    time_ns = 98_765_432_100
    moved = state.position_m[None], state.velocity_m_s[None]
    states = States.of(system, ones, np.array([time_ns]), *moved)
    event = simulation_event(time_ns, 4, 0, "reset", "time", "orbit")
    messages = {name: make.rows(name, 4, states)[0].tobytes() for name in STATE_TOPICS}
    messages["simulation_events"] = bytes(serialize_message(event))
    for name, data in messages.items():
        assert stamp_ns(data, TOPICS[name].stamp_offset) == time_ns, name
    simulation = {"scenario": "three_star", "publish_period_s": 1.0}
    simulation |= {"disturbance_m": 0.0, "disturbance_seed": 0}
    assert stamp_ns(system_description(system, -2.5, ones, simulation), 4) == 0
    recorded = {name for name, topic in TOPICS.items() if topic.recorded}
    others = {"system_description", "stability_results", "applied_wrenches"}
    sensors = {name for name, topic in TOPICS.items() if topic.recorded and topic.optional}
    assert recorded == {*messages, *others, *sensors} and len(sensors) == 2
    assert {TOPICS[name].stamp_offset for name in sensors} == {4}


def test_a_file_is_completed_after_a_time(tmp_path):
    writer = BagWriter(tmp_path / "bag", "jazzy", split_s=1e-6)
    topic = TOPICS["bead_states"]
    description = (topic.type, topic.definition, topic.type_hash, topic.offered_qos)
    channel = writer.add_topic("/bead_states", *description)
    data = bytes(serialize_message(BeadStates()))
    for number in range(3):
        writer.write(channel, data, number, number, number)
        writer.flush()
    writer.close()
    assert len(list((tmp_path / "bag").glob("*.mcap"))) == 4  # the last one is empty
    with AnyReader([tmp_path / "bag"]) as reader:
        assert [time_ns for _, time_ns, _ in reader.messages()] == [0, 1, 2]


def test_columns_are_what_each_message_says_by_itself():
    """Whatever lies in the padding, and with texts that push the numbers about."""
    message = BeadStates(
        header=Header(stamp=stamp(7), frame_id="abc"),
        step=5,
        name=["", "long name", "x"],
        position_m=[1.5, -2.5, 3.5],
        deviation=[0.25],
    )
    data = bytes(serialize_message(message))
    layout = Layout(TOPICS["bead_states"].definition, data)
    rows = np.frombuffer(data * 2, np.uint8).reshape(2, -1)
    (first, second) = layout.numbers(rows)
    assert first == second and first["step"] == 5 and first["header.stamp.nanosec"] == 7
    assert first["position_m"].tolist() == [1.5, -2.5, 3.5]
    assert first["velocity_m_s"].size == 0 and first["deviation"].tolist() == [0.25]
    other = bytes(serialize_message(BeadStates(header=message.header, name=["", "LONG name", "x"])))
    padded = np.zeros((1, len(data)), np.uint8)
    padded[0, : min(len(other), len(data))] = np.frombuffer(other, np.uint8)[: len(data)]
    assert layout.fits(rows).all() and not layout.fits(padded).any()
    with pytest.raises(TssError, match="does not fit"):
        Layout(TOPICS["bead_states"].definition, data[:40])


def test_a_run_begins_with_its_file_though_its_steps_go_on(tmp_path):
    """Another simulator, which counts higher, follows one that ended early."""
    bag = Bag(tmp_path / "bag")
    bag.describe()
    for number in range(10):
        bag.step(number)
    bag.writer.next_file()
    bag.describe(spin_rate_ratio=-3.0)
    for number in range(20, 30):
        bag.step(number)
    bag.writer.close()
    runs = [read_bag(tmp_path / "bag", run) for run in (1, 2)]
    assert [run.step.tolist() for run in runs] == [list(range(10)), list(range(20, 30))]
    assert [run.spin_rate_ratio for run in runs] == [-2.0, -3.0]
