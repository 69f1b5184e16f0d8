"""Bags of others are read, recovered or refused in one true line; hostile ones cost no more."""

import os
import resource
import struct
import subprocess
import sys
import time
import zlib

import foreign_bags
import lz4.frame
import numpy as np
import pytest
import yaml
from bag_fuzzer import ARRAYS, Corpus, fuzz
from mcap.data_stream import RecordBuilder
from mcap.records import Chunk
from mcap.writer import MCAP0_MAGIC
from rosbags.interfaces import ConnectionExtRosbag2
from rosbags.rosbag2 import Reader, StoragePlugin, Writer
from small_bag import Bag

from tss_ros.bags.recording import read_bag
from tss_ros.bags.records import BagError
from tss_ros.bags.recover import find_cut, recover
from tss_ros.bags.recover import main as recover_main
from tss_ros.bags.verify import main as verify_main
from tss_ros.bags.verify import verify
from tss_ros.core import TssError
from tss_ros.scenarios import scenario
from tss_ros.scenarios.files import load_yaml
from tss_ros.simulator import snapshot
from tss_ros.simulator.checkpoint import Checkpoint

STEPS = 120


@pytest.fixture(scope="module")
def ours(tmp_path_factory):
    """A bag, its messages, and what it holds."""
    bag = Bag(tmp_path_factory.mktemp("ours") / "bag")
    bag.fill(STEPS)
    return bag.writer.directory, foreign_bags.content(bag.writer.path), read_bag(bag.writer.path)


def assert_same(recording, expected):
    for name in ARRAYS:
        np.testing.assert_array_equal(getattr(recording, name), getattr(expected, name))


# --- of other recorders


@pytest.mark.parametrize("form", foreign_bags.WRITERS)
def test_bags_in_every_form_of_mcap_are_read(ours, tmp_path, form):
    path = tmp_path / "x.mcap"
    foreign_bags.write(path, ours[1], **foreign_bags.WRITERS[form])
    assert_same(read_bag(path), ours[2])
    found = verify(path)
    assert found.is_sound
    assert ("may have changed unseen" in found.lines[-1]) == (form != "all checksums")
    bag = foreign_bags.in_folder(tmp_path / "bag", path)
    assert recover(bag) == [] and verify(bag).is_sound


@pytest.mark.parametrize("change", sorted(set(foreign_bags.CHANGES) - {"no schema text"}))
def test_bags_of_other_recorders_are_read_and_recovered(ours, tmp_path, change):
    path = tmp_path / "x.mcap"
    foreign_bags.write(path, ours[1], foreign_bags.CHANGES[change])
    bag = foreign_bags.in_folder(tmp_path / "bag", path)
    assert_same(read_bag(bag), ours[2])
    (bag / "x.mcap").write_bytes(path.read_bytes()[:-200])
    (account,) = recover(bag)
    assert f": {2 * STEPS + 1} messages recovered" in account
    assert_same(read_bag(bag), ours[2])
    assert not list(bag.glob("*.recovering"))


def test_a_bag_without_texts_of_its_types_is_refused(ours, tmp_path):
    path = tmp_path / "x.mcap"
    foreign_bags.write(path, ours[1], foreign_bags.without_text)
    with pytest.raises(BagError, match="'/system_description': the file has no text of its type"):
        read_bag(path)
    assert verify(path).is_sound


def test_files_compressed_as_a_whole_are_read_and_recovered(ours, tmp_path):
    path, number = tmp_path / "x.mcap", iter(range(10**6))

    def later(schema, channel, message):
        message.publish_time = next(number)
        return schema, channel, message

    foreign_bags.write(path, ours[1] * 30, later)
    bag = foreign_bags.in_folder(tmp_path / "bag", path, compression_mode="FILE")
    packed = foreign_bags.pack_whole(bag / "x.mcap")
    assert verify(bag).is_sound and recover(bag) == []
    packed.write_bytes(packed.read_bytes()[:-5000])
    with pytest.raises(BagError, match="x.mcap.zstd: .*cut short"):
        read_bag(bag)
    (account,) = recover(bag)
    assert int(account.partition(": ")[2].split()[0]) > len(ours[1])
    assert sorted(p.name for p in bag.glob("x*")) == ["x.mcap", "x.mcap.zstd.damaged"]
    assert verify(bag).is_sound


def test_two_simulators_in_one_bag_are_two_runs(ours, tmp_path):
    path, sides = tmp_path / "x.mcap", ("left", "right")
    changes, turn = [foreign_bags.of_a_namespace(side) for side in sides], iter(range(10**6))
    messages = [message for message in ours[1] for _ in sides]
    foreign_bags.write(path, messages, lambda *parts: changes[next(turn) % 2](*parts))
    for number, side in enumerate(sides, 1):
        recording = read_bag(path, number)
        assert (recording.runs, recording.prefix) == (2, f"/{side}/")
        assert_same(recording, ours[2])


def test_two_simulators_on_the_same_topics_are_named(ours, tmp_path):
    path = tmp_path / "x.mcap"
    mixed = [part for pair in zip(ours[1], ours[1][40:]) for part in pair]
    foreign_bags.write(path, mixed)
    with pytest.raises(BagError, match="several simulators published on its topics at once"):
        read_bag(path)


def test_sqlite_is_refused_with_what_helps_and_comes_back_as_it_was(ours, tmp_path):
    database, back = tmp_path / "database", tmp_path / "back"
    for source, target, plugin in (
        (ours[0], database, StoragePlugin.SQLITE3),
        (database, back, StoragePlugin.MCAP),
    ):
        with Reader(source) as reader, Writer(target, version=9, storage_plugin=plugin) as writer:
            made = {}
            for connection in reader.connections:
                extra = connection.ext
                assert isinstance(extra, ConnectionExtRosbag2)
                made[connection.id] = writer.add_connection(
                    connection.topic,
                    connection.msgtype,
                    msgdef=connection.msgdef.data,
                    rihs01=connection.digest,
                    serialization_format=extra.serialization_format,
                    offered_qos_profiles=extra.offered_qos_profiles,
                )
            for connection, time_ns, data in reader.messages():
                writer.write(made[connection.id], time_ns, data)
    with pytest.raises(BagError, match=r"holds 'database.db3', which is not MCAP; `rosbags-conv"):
        read_bag(database)
    assert_same(read_bag(back), ours[2])
    assert verify(back).is_sound and recover(back) == []


# --- hostile


def limited(code, seconds=30, megabytes=700):
    """Run Python within bounds of time and memory; its last line."""
    memory = megabytes * 2**20

    def bound():
        resource.setrlimit(resource.RLIMIT_DATA, (memory, memory))

    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        timeout=seconds,
        preexec_fn=bound,
        env=environment,
    )
    assert "Traceback" not in done.stderr, done.stderr
    return done.returncode, (done.stdout + done.stderr).splitlines()[-1]


def chunk_of(data, **declared):
    """A chunk record that may lie about itself."""
    packed = lz4.frame.compress(data)
    said = {"uncompressed_size": len(data), "uncompressed_crc": zlib.crc32(data)} | declared
    builder = RecordBuilder()
    chunk = Chunk("lz4", packed, message_end_time=0, message_start_time=0, **said)
    chunk.write(builder)
    return builder.end()


@pytest.mark.parametrize("kind", ["a FIFO", "a device", "a directory"])
def test_what_is_no_file_is_refused_at_once(tmp_path, kind, capsys):
    for name in ("x.mcap", "x.yaml", "x.npz"):
        if kind == "a FIFO":
            os.mkfifo(tmp_path / name)
        elif kind == "a device":
            (tmp_path / name).symlink_to("/dev/zero")
        else:
            (tmp_path / name).mkdir()
    begun = time.monotonic()
    bag = tmp_path if kind == "a directory" else tmp_path / "x.mcap"
    with pytest.raises(BagError, match=f"is {kind}; allowed: a regular file"):
        read_bag(bag)
    assert verify_main([str(bag)]) == 1
    assert recover_main([str(tmp_path)]) == 1
    with pytest.raises(TssError, match=f"is {kind}"):
        scenario.load(tmp_path / "x.yaml")
    with pytest.raises(TssError, match=f"is {kind}"):
        snapshot.read(str(tmp_path / "x.npz"), {}, Checkpoint(0, {}), 1)
    assert time.monotonic() - begun < 60


@pytest.mark.parametrize("size", [2**50, 2**63, 2**64 - 1, 2**29])
def test_declared_sizes_are_not_believed(tmp_path, size):
    path = tmp_path / "x.mcap"
    path.write_bytes(MCAP0_MAGIC + chunk_of(b"x" * 1000, uncompressed_size=size))
    with pytest.raises(BagError, match="it says that it unpacks to|times its size"):
        read_bag(path)
    length = bytearray(path.read_bytes())
    length[9:17] = struct.pack("<Q", size)
    path.write_bytes(length)
    with pytest.raises(BagError):
        read_bag(path)


def test_a_small_file_that_unpacks_to_gigabytes_costs_neither_memory_nor_time(tmp_path):
    path = tmp_path / "x.mcap"
    content = (b"\x05" + struct.pack("<Q", 2**20) + bytes(2**20)) * 200
    block = chunk_of(content)
    path.write_bytes(MCAP0_MAGIC + block * 10)
    assert path.stat().st_size < 30e6
    begun = time.monotonic()
    code = f"from tss_ros.bags.verify import main; raise SystemExit(main([{str(path)!r}]))"
    status, line = limited(code, 60, 2000)
    assert status == 1 and ("times its size" in line or "faults" in line)
    assert time.monotonic() - begun < 60


def test_yaml_bombs_are_refused(ours, tmp_path):
    bomb = "a0: &a0 [x, x, x, x, x, x, x, x, x]\n"
    for i in range(1, 30):
        bomb += f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]\n"
    for text in (bomb, "[" * 100_000, "&a [*a]", "x: " + "1:" * 50_000 + "1", "x" * 2**23):
        with pytest.raises(TssError, match="^what "):
            load_yaml(text, "what")
    (tmp_path / "x.yaml").write_text(bomb)
    with pytest.raises(TssError, match="aliases"):
        scenario.load(tmp_path / "x.yaml")
    bag = foreign_bags.in_folder(tmp_path / "bag", ours[0] / "bag_0.mcap")
    (bag / "metadata.yaml").write_text(bomb)
    assert len(read_bag(bag, damaged=True).damage) == 1


def test_links_lead_recovery_to_no_other_file(ours, tmp_path):
    """In a folder that others can write to."""
    treasure = tmp_path / "treasure"
    treasure.write_text("mine")
    raw = (ours[0] / "bag_0.mcap").read_bytes()[:-100]
    for name in ("bag_0.mcap.recovering", ".metadata.yaml", "bag_0.mcap.damaged"):
        bag = tmp_path / "bag"
        bag.mkdir()
        (bag / "bag_0.mcap").write_bytes(raw)
        (bag / name).symlink_to(treasure)
        assert recover_main([str(bag)]) in (0, 1)
        assert treasure.read_text() == "mine" and treasure.is_file()
        subprocess.run(["rm", "-r", bag], check=True)
    bag.mkdir()
    (bag / "bag_0.mcap").symlink_to(treasure)
    with pytest.raises(BagError, match="is a link or no file"):
        recover(bag)
    (tmp_path / "elsewhere").symlink_to(bag)
    assert tmp_path / "elsewhere" not in find_cut(tmp_path)


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can give files away")
def test_bags_of_other_users_are_left_alone(ours, tmp_path):
    bag = tmp_path / "bag"
    bag.mkdir()
    (bag / "bag_0.mcap").write_bytes((ours[0] / "bag_0.mcap").read_bytes()[:-100])
    os.chown(bag / "bag_0.mcap", 12345, 12345)
    with pytest.raises(BagError, match="belongs to user 12345; recover it as that user"):
        recover(bag)
    os.chown(bag, 12345, 12345)
    assert find_cut(tmp_path) == []


def test_each_bag_is_recovered_on_its_own(ours, tmp_path, capsys):
    raw = (ours[0] / "bag_0.mcap").read_bytes()
    for name in ("a", "b", "c"):
        (tmp_path / name).mkdir()
        (tmp_path / name / f"{name}_0.mcap").write_bytes(raw[:-100] if name != "b" else b"text")
    assert recover_main([str(tmp_path / name) for name in "abc"]) == 1
    told = capsys.readouterr()
    assert len(told.out.splitlines()) == 2 and "'b_0.mcap' is not an MCAP" not in told.out
    assert "b_0.mcap' is not an MCAP file" in told.err
    assert verify(tmp_path / "a").is_sound and verify(tmp_path / "c").is_sound


def test_names_that_would_break_a_terminal_are_written_in_escapes(ours, tmp_path, capsys):
    path = tmp_path / "x\x1b[2J\n.mcap"
    path.write_bytes((ours[0] / "bag_0.mcap").read_bytes()[:-100])
    assert verify_main([str(path)]) == 1
    told = capsys.readouterr()
    assert "\x1b" not in told.out + told.err and "\\x1b[2J\\n" in told.out


def test_metadata_names_no_files_elsewhere(ours, tmp_path):
    bag = foreign_bags.in_folder(
        tmp_path / "bag", ours[0] / "bag_0.mcap", relative_file_paths=["../../etc/passwd"]
    )
    assert yaml.safe_load((bag / "metadata.yaml").read_text())
    with pytest.raises(BagError, match="'../../etc/passwd' is named in metadata.yaml, and is not"):
        read_bag(bag)


# --- mutated


@pytest.mark.parametrize("seed", range(4))
def test_any_mutation_gives_the_old_content_or_a_refusal(tmp_path, seed):
    """More by hand: `python tests/helpers/bag_fuzzer.py 10000`."""
    outcomes, broken = fuzz(60, seed, Corpus(tmp_path))
    assert broken == []
    assert len({check for check, _ in outcomes}) == 5
