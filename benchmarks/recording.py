"""How fast recording stays lossless, its memory, and how long a large bag takes to open.

    . ./activate && python -m benchmarks --only recording

or, with fewer messages, `python -m benchmarks.recording [--steps 1000000] [--millions 10]`; what is
seen goes to the screen, and at last as JSON to standard output.

Every message is of the 3-star formation. The bare writer writes the same messages in equal chunks
with the same compression, but no counts, no metadata.yaml and no flushes to the disk.
"""

import argparse
import json
import re
import resource
import signal
import subprocess
import sys
import tempfile
import time
import zlib
from pathlib import Path

import numpy as np
from ament_index_python.packages import get_package_prefix
from mcap.records import Chunk
from mcap.stream_reader import StreamReader, get_chunk_data_stream
from mcap.writer import CompressionType, Writer

from tss_ros.bags.recording import read_bag
from tss_ros.bags.verify import verify
from tss_ros.bags.writer import CHUNK_BYTES, BagWriter
from tss_ros.core import Propagator, disturbed, initial_state, ring
from tss_ros.messages.steps import States, StepMessages, system_description
from tss_ros.messages.topics import STATE_TOPICS
from tss_ros.review import review
from tss_ros.ros.network import stay_on_this_machine
from tss_ros.ros.topics import read_topics

RATE, POOL, FLUSH_PERIOD_S = -2.5, 1000, 0.25
STATES = ("tether_states", "bead_states")


def messages():
    """The description, and the messages of POOL steps: a list of {topic: bytes}."""
    system = ring()
    start = initial_state(system, RATE)
    radius_m = np.linalg.norm(start.position_m, axis=1)
    propagator = Propagator(system, RATE, disturbed(start, 10.0, 1))
    position_m, velocity_m_s = propagator.sample(np.arange(POOL, dtype=float))
    times_ns = np.arange(POOL) * 10**9
    states = States.of(system, radius_m, times_ns, position_m, velocity_m_s)
    make = StepMessages(system, states.tension_n[0])
    rows = {name: make.rows(name, 0, states) for name in STATE_TOPICS}
    steps = [{name: row[i].tobytes() for name, row in rows.items()} for i in range(POOL)]
    options = {"scenario": "three_star", "disturbance_m": 10.0, "disturbance_seed": 1}
    described = system_description(system, RATE, radius_m, {**options, "publish_period_s": 1.0})
    return described, steps


def renumbered(data, step):
    """A state with another step number and the time that belongs to it."""
    changed = bytearray(data)
    changed[4:8] = step.to_bytes(4, "little")
    changed[28:36] = step.to_bytes(8, "little")  # behind the stamp and "orbit"
    return bytes(changed)


def bare_writer(path, described, steps, count):
    """Messages a second of the library's own writer."""
    with path.open("wb") as stream:
        writer = Writer(stream, chunk_size=CHUNK_BYTES, compression=CompressionType.LZ4)
        writer.start(profile="ros2")
        channels = {}
        for name in STATE_TOPICS:
            topic = read_topics()[name]
            schema = writer.register_schema(topic.type, "ros2msg", topic.definition.encode())
            channels[name] = writer.register_channel(f"/{name}", "cdr", schema)
        begun = time.perf_counter()
        for i in range(count):
            for name in STATE_TOPICS:
                writer.add_message(channels[name], i * 10**9, steps[i % POOL][name], i, i)
        writer.finish()
        return len(STATE_TOPICS) * count / (time.perf_counter() - begun)


def bag(directory, described, steps, count, names=STATE_TOPICS, on_million=None, **split):
    """Messages a second of our writer."""
    writer = BagWriter(directory, "jazzy", **split)
    channels = {}
    for name in ("system_description", *names):
        t = read_topics()[name]
        channels[name] = writer.add_topic(
            f"/{name}", t.type, t.definition, t.type_hash, t.offered_qos
        )
    writer.write(channels["system_description"], described, 0, 0, 1)
    begun = flushed = time.perf_counter()
    for i in range(count):
        for name in names:
            data = steps[i % POOL][name]
            if names is STATES:
                data = renumbered(data, i)
            writer.write(channels[name], data, i * 10**9, i, i)
        if time.perf_counter() - flushed > FLUSH_PERIOD_S:
            writer.flush()
            flushed = time.perf_counter()
        if on_million and i * len(names) % 1_000_000 < len(names):
            on_million(writer.message_count)
    writer.close()
    return writer.message_count / (time.perf_counter() - begun)


def checksums(path):
    """Seconds that the checksums of a file take by themselves: of its chunks, and of its bytes."""
    with path.open("rb") as stream:
        chunks = [
            get_chunk_data_stream(record)[0].read(record.uncompressed_size)
            for record in StreamReader(stream, emit_chunks=True).records
            if isinstance(record, Chunk)
        ]
    content = path.read_bytes()
    begun = time.process_time()
    for part in (content, *chunks):
        zlib.crc32(part)
    return time.process_time() - begun


def nodes(folder):
    """What sim_node and logger_node say about a run as fast as the two together go."""
    programs = Path(get_package_prefix("tss_ros")) / "lib" / "tss_ros"
    logger = subprocess.Popen(
        [programs / "logger_node", "--ros-args", "-p", f"output:={folder / 'nodes'}"],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )
    parameters = {"time_scale": 0.0, "turns": 20.0, "wait_for_recorder": "true"}
    arguments = [a for k, v in parameters.items() for a in ("-p", f"{k}:={v}")]
    simulator = subprocess.run(
        [programs / "sim_node", "--ros-args", *arguments], capture_output=True, text=True
    )
    logger.send_signal(signal.SIGINT)
    told = logger.communicate()[0].strip().rpartition(": ")[2]
    count, wall_s = int(told.split()[0]), float(re.search(r"in ([\d.]+) s", simulator.stderr)[1])
    return count / wall_s, told


def memory_mb():
    """Resident memory of this process [MB]."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize() / 1e6


def main():
    """Tell every figure."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=int, default=1_000_000, help="of the bag that is opened")
    parser.add_argument("--millions", type=int, default=10, help="of messages, for the memory")
    options = parser.parse_args()
    stay_on_this_machine()
    lines = []

    def tell(text):
        lines.append(text)
        print(f"    {text}", file=sys.stderr, flush=True)

    described, steps = messages()
    size = sum(map(len, steps[0].values()))
    tell(f"one step: {len(STATE_TOPICS)} messages, {size} bytes")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for repeat in range(3):
            bare = bare_writer(folder / f"bare_{repeat}.mcap", described, steps, 40_000)
            ours = bag(folder / f"ours_{repeat}", described, steps, 40_000)
            tell(f"bare mcap writer {bare:8.0f} messages/s, BagWriter {ours:8.0f} messages/s")
        rate, told = nodes(folder)
        tell(f"sim_node to logger_node {rate:.0f} messages/s: {told}")
        count = options.millions * 1_000_000 // len(STATE_TOPICS)

        def show(written):
            tell(f"{written} messages written, {memory_mb():.0f} MB")

        bag(folder / "long", described, steps, count, on_million=show, split_bytes=100_000_000)
        bag(folder / "large", described, steps, options.steps, names=STATES)
        begun, begun_cpu = time.perf_counter(), time.process_time()
        recording = read_bag(folder / "large")
        read_s, read_cpu_s = time.perf_counter() - begun, time.process_time() - begun_cpu
        begun_cpu = time.process_time()
        verify(folder / "large")
        verify_cpu_s = time.process_time() - begun_cpu
        tell(
            f"{len(recording.step)} steps: read in {read_cpu_s:.2f} s of processor time, of which "
            f"checksums take {checksums(folder / 'large' / 'large_0.mcap'):.2f} s; verified in "
            f"{verify_cpu_s:.2f} s"
        )
        begun = time.perf_counter()
        review.save(recording, folder / "large.rrd", "large")
        tell(
            f"{len(recording.step)} steps: read in {read_s:.1f} s, made a Rerun file of "
            f"{(folder / 'large.rrd').stat().st_size / 1e6:.0f} MB in "
            f"{time.perf_counter() - begun:.1f} s"
        )
    print(json.dumps({"lines": lines}))


if __name__ == "__main__":
    main()
