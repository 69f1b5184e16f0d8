"""Bags that were cut short or damaged are made whole, with every chunk that is intact."""

import random
import shutil

import pytest
from mcap.reader import make_reader
from recorded import serialised_messages
from small_bag import Bag

from tss_ros.bags import recover
from tss_ros.core import TssError

#: Places where files are cut.
CUTS = 60


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A bag's file, and for each of its chunks where it ends and the messages up to there."""
    bag = Bag(tmp_path_factory.mktemp("whole") / "bag")
    bag.describe()
    for number in range(3000):
        bag.step(number)
        if number % 50 == 0:
            bag.writer.flush()
    bag.writer.close()
    with bag.writer.path.open("rb") as stream:
        reader = make_reader(stream)
        summary, count, ends = reader.get_summary(), 0, [(0, 0)]
        for index in sorted(summary.chunk_indexes, key=lambda index: index.chunk_start_offset):
            count += _count(stream, index)
            ends.append((index.chunk_start_offset + index.chunk_length, count))
    return bag.writer.path.read_bytes(), ends, serialised_messages(bag.writer.directory)


def _count(stream, index):
    """Messages of a chunk, from the lengths of its message indexes: 16 bytes each."""
    count = 0
    for place in index.message_index_offsets.values():
        stream.seek(place + 1 + 8 + 2)
        count += int.from_bytes(stream.read(4), "little") // 16
    return count


def _leading_zeros(content):
    return len(content) - len(content.lstrip(b"\0"))


def _has_copy(content):
    """Whether the copy of the description is whole, which stands before the first chunk: 0 or 1."""
    begin = content.index(b"\x0f\0\0\0tss_ros_latched") - 9
    return int(begin + 9 + int.from_bytes(content[begin + 1 : begin + 9], "little") <= len(content))


def damaged(folder, name, content):
    bag = folder / name
    bag.mkdir()
    (bag / f"{name}_0.mcap").write_bytes(content)
    return bag


def test_of_a_cut_file_every_whole_chunk_is_recovered(whole, tmp_path, capsys):
    content, ends, written = whole
    places = random.Random(1).sample(range(len(content)), CUTS)
    lost = []
    for cut in (0, 1, 8, len(content) - 1, *places):
        # What the file system had not yet put on the disk when power was lost reads as zeros.
        for kind, tail in (("cut", b""), ("zeros", bytes(min(50_000, len(content) - cut)))):
            bag = damaged(tmp_path, f"{kind}_{cut}", content[:cut] + tail)
            (account,) = recover.recover(bag)
            damaged_at = cut + (len(tail) and _leading_zeros(content[cut:]))  # these are as before
            expected = max(count for end, count in ends if end <= damaged_at)
            if not expected and b"\x0f\0\0\0tss_ros_latched" in content[:cut]:
                expected = _has_copy(content[:cut])
            assert f": {expected} messages recovered" in account
            assert serialised_messages(bag) == written[:expected]
            assert (bag / f"{bag.name}_0.mcap.damaged").read_bytes() == content[:cut] + tail
            lost.append(len(written) - expected)
    with capsys.disabled():
        print(f"\ncut: {len(lost)} files of {len(written)} messages, {sum(lost)} lost in all")


def test_what_lies_behind_damage_is_recovered_too(whole, tmp_path):
    """Holes anywhere, and in the head of a chunk, which then reads like an empty one."""
    content, ends, written = whole
    head = ends[2][0] + content[ends[2][0] :].index(b"lz4") - 41
    heads = range(head, head + 48, 3)
    places = [random.Random(seed).randrange(ends[1][0], ends[-2][0]) for seed in range(10)]
    for at in [*places, *heads]:
        bag = damaged(tmp_path, f"hole_{at}", content[:at] + bytes(512) + content[at + 512 :])
        recover.recover(bag)
        # One chunk is gone, or two that the hole touches both.
        before = max(count for end, count in ends if end <= at)
        after = min(count for end, count in ends if end >= at + 512)
        found = serialised_messages(bag)
        assert found[:before] == written[:before] and len(found) > before
        kept_behind = len(written) - after
        assert found[len(found) - kept_behind :] == written[after:]
        shutil.rmtree(bag)


def test_recovery_that_is_stopped_can_be_repeated(whole, tmp_path):
    content, _, written = whole
    bag = damaged(tmp_path, "bag", content[:-100])
    expected = len(written)
    # As if it had ended between putting the damaged file aside and putting the new one in place.
    (bag / "bag_0.mcap").rename(bag / "bag_0.mcap.damaged")
    (bag / "bag_0.mcap.recovering").write_bytes(content[:50])
    assert recover.find_cut(tmp_path) == [bag]
    recover.recover(bag)
    assert serialised_messages(bag) == written and len(written) == expected
    assert recover.find_cut(tmp_path) == []


def test_metadata_alone_that_is_missing_is_made(whole, tmp_path):
    content, _, written = whole
    bag = damaged(tmp_path, "bag", content)
    (account,) = recover.recover(bag)
    assert "metadata.yaml was missing; no message was lost" in account
    assert serialised_messages(bag) == written and not list(bag.glob("*.damaged"))


def test_a_bag_in_use_and_what_is_no_bag_are_left_alone(tmp_path):
    bag = Bag(tmp_path / "bag")
    bag.describe()
    bag.writer.flush()
    assert recover.find_cut(tmp_path) == []
    with pytest.raises(TssError, match="bag' is being recorded"):
        recover.recover(tmp_path / "bag")
    bag.writer.close()
    with pytest.raises(TssError, match="missing' is not a bag directory"):
        recover.recover(tmp_path / "missing")
    (tmp_path / "empty").mkdir()
    with pytest.raises(TssError, match="empty' holds no .mcap file"):
        recover.recover(tmp_path / "empty")
