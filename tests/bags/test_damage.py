"""Damage anywhere in a bag is found; what is whole is read and recovered, and nothing else."""

import contextlib
import io
import shutil

import foreign_bags
import numpy as np
import pytest
from bag_fuzzer import ARRAYS, contained, messages_of
from mcap.reader import make_reader
from small_bag import Bag

from tss_ros.bags import commands
from tss_ros.bags.mcap_file import McapFile
from tss_ros.bags.recording import read_bag
from tss_ros.bags.records import BagError
from tss_ros.bags.recover import main as recover_main
from tss_ros.bags.recover import recover
from tss_ros.bags.verify import main as verify_main
from tss_ros.bags.verify import verify

STEPS = 900


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A bag of a dozen chunks, and what it holds."""
    bag = Bag(tmp_path_factory.mktemp("whole") / "bag")
    bag.fill(STEPS, 75)
    return bag.writer.directory, read_bag(bag.writer.directory)


def copy_with(whole, folder, change, name="bag_0.mcap"):
    """A copy of the bag whose file is changed."""
    bag = folder / "bag"
    shutil.rmtree(bag, ignore_errors=True)
    shutil.copytree(whole[0], bag)
    (bag / name).write_bytes(change((bag / name).read_bytes()))
    return bag


def chunks_of(whole):
    return foreign_bags.chunk_positions((whole[0] / "bag_0.mcap").read_bytes())


def messages_in(raw, chunk):
    """How many messages a chunk has, as the library counts them in its index."""
    index = make_reader(io.BytesIO(raw)).get_summary().chunk_indexes[chunk]
    lengths = (raw[at + 11 : at + 15] for at in index.message_index_offsets.values())
    return sum(int.from_bytes(length, "little") // 16 for length in lengths)


def zeroed(at, count=512):
    return lambda raw: raw[:at] + bytes(min(count, len(raw) - at)) + raw[at + count :]


@pytest.mark.parametrize("chunk", [0, 5, -1], ids=["first", "middle", "last"])
@pytest.mark.parametrize("offset", [-100, 0, 100], ids=["before", "head", "data"])
def test_of_a_zeroed_chunk_nothing_else_is_lost(whole, tmp_path, chunk, offset, capsys):
    raw, (at, _) = (whole[0] / "bag_0.mcap").read_bytes(), chunks_of(whole)[chunk]
    bag = copy_with(whole, tmp_path, zeroed(at + offset))
    gone = messages_in(raw, chunk)
    with pytest.raises(BagError, match=f"; {gone} messages lost"):
        read_bag(bag)
    assert not verify(bag).is_sound
    assert commands.export([str(bag), "--csv", str(tmp_path / "tables")]) == 1
    told = capsys.readouterr().err
    assert told.startswith("export: ") and f"{gone} messages lost" in told
    (account,) = recover(bag)
    kept, original = (messages_of(place / "bag_0.mcap") for place in (bag, whole[0]))
    first = sum(messages_in(raw, i) for i in range(chunk % len(chunks_of(whole))))
    expected = original[:first] + original[first + gone :]
    if chunk == 0 and offset >= 0:  # the copy of the description stands before the chunk
        expected = original[:1] + expected
    assert kept == expected and f": {len(kept)} messages recovered" in account
    assert verify(bag).is_sound and recover(bag) == []


def test_in_a_cut_file_the_first_chunk_is_no_single_point_of_failure(whole, tmp_path):
    """Neither its schemas and channels nor those of the summary are there."""
    (first, _), *_, (last, _) = chunks_of(whole)
    raw = (whole[0] / "bag_0.mcap").read_bytes()
    for hole in (first - 300, first, first + 100):
        bag = copy_with(whole, tmp_path, lambda raw, hole=hole: zeroed(hole)(raw)[:last])
        (bag / "metadata.yaml").unlink()
        (account,) = recover(bag)
        kept = sum(messages_in(raw, chunk) for chunk in range(1, len(chunks_of(whole)) - 1))
        assert f": {kept + (hole >= first)} messages recovered" in account


def test_the_description_is_no_single_point_of_failure(whole, tmp_path):
    """It stands before its chunk as well, so the steps behind that are still of a known run."""
    (first, _), *_ = chunks_of(whole)
    bag = copy_with(whole, tmp_path, zeroed(first + 100))
    for damaged in (True, False):
        recording = read_bag(bag, damaged=damaged)
        assert contained(recording, whole[1]) and len(recording.step) == STEPS - 75
        assert recover(bag) or not damaged


def test_what_nothing_describes_is_counted(whole, tmp_path):
    (first, length), *_, (last, _) = chunks_of(whole)

    def change(raw):
        hidden = raw.replace(b"tss_ros_topics", b"tss_ros_topicz")
        return zeroed(first + 100)(hidden)[:last]

    bag = copy_with(whole, tmp_path, change)
    (account,) = recover(bag)
    assert ": 0 messages recovered" in account
    assert "are of channels that nothing describes any more" in account


def test_a_changed_byte_anywhere_is_found(whole, tmp_path):
    """Each byte of the parts that are not data of chunks, and every 97th of those."""
    small = Bag(tmp_path / "small")
    small.describe()
    for number in range(20):
        small.step(number)
        if number == 9:
            small.writer.flush()
    small.writer.close()
    path = small.writer.path
    raw = path.read_bytes()
    # After `writer.close`, in turn: the beginning, chunks, metadata, the summary, the end.
    places = sorted({*range(0, len(raw), 97), *range(len(raw) - 400, len(raw)), *range(300)})
    copied = tmp_path / "copied"
    shutil.copytree(small.writer.directory, copied)
    for at in places:
        changed = bytearray(raw)
        changed[at] ^= 1 << (at % 8)
        (copied / path.name).write_bytes(changed)
        with contextlib.suppress(BagError):
            assert not verify(copied).is_sound, at
    (copied / path.name).write_bytes(raw)
    assert verify(copied).lines[-1] == "The bag is sound"


def test_a_flipped_bit_in_a_chunk_is_never_read_as_a_number(whole, tmp_path):
    random = np.random.default_rng(15)
    chunks = chunks_of(whole)
    for _ in range(60):
        at, length = chunks[random.integers(1, len(chunks))]
        place, bit = at + int(random.integers(0, length)), 1 << int(random.integers(8))

        def flip(raw, place=place, bit=bit):
            return raw[:place] + bytes([raw[place] ^ bit]) + raw[place + 1 :]

        bag = copy_with(whole, tmp_path, flip)
        with pytest.raises(BagError, match="damaged"):
            read_bag(bag)
        recording = read_bag(bag, damaged=True)
        assert contained(recording, whole[1]) and len(recording.step) < STEPS or recording.damage


def test_metadata_that_does_not_fit_is_found_and_made_anew(whole, tmp_path, capsys):
    for old, new, words in (
        (b"message_count: 1801", b"message_count: 1802", "it says message_count 1802; it is 1801"),
        (b"- bag_0.mcap", b"- bag_1.mcap", "'bag_1.mcap' is named in metadata.yaml"),
        (b"version: 9", b"version: [", "is not valid YAML"),
        (b"version: 9", b"version: &a 9", None),  # a byte that means nothing
    ):
        bag = copy_with(
            whole, tmp_path, lambda raw, o=old, n=new: raw.replace(o, n), "metadata.yaml"
        )
        assert verify_main([str(bag)]) == (0 if words is None else 1)
        told = capsys.readouterr().out
        assert words is None or words in told
        assert len(told.splitlines()) < 20
        assert recover_main([str(bag)]) == 0
        assert verify(bag).is_sound
        assert np.array_equal(read_bag(bag).position_m, whole[1].position_m)


def test_a_file_that_is_gone_is_missed(tmp_path):
    bag = Bag(tmp_path / "bag")
    bag.writer._split_bytes = 1
    bag.fill(40, 10)
    directory = bag.writer.directory
    assert len(list(directory.glob("*.mcap"))) == 5 and verify(directory).is_sound
    assert read_bag(directory).runs == 1
    (directory / "bag_2.mcap").unlink()
    with pytest.raises(BagError, match="'bag_2.mcap' is named in metadata.yaml, and is not there"):
        read_bag(directory)
    # Behind the gap the run may be another: its description could be gone with the file.
    assert read_bag(directory, damaged=True).step.tolist() == list(range(20))


@pytest.mark.parametrize("repaired", [False, True])
@pytest.mark.parametrize("with_copy", [False, True])
def test_a_lost_description_lends_its_run_to_no_other(tmp_path, repaired, with_copy):
    """Steps count on after a reset, and the description is in the chunk that is damaged."""
    bag = Bag(tmp_path / "bag")
    for run in range(3):
        bag.describe(-2.0 - run, 10 * run * 250_000_000, run=run, first_step=10 * run)
        bag.writer.flush()
        for number in range(10):
            bag.step(10 * run + number)
        bag.writer.flush()
    bag.writer.close()
    raw = bag.writer.path.read_bytes()
    at, _ = foreign_bags.chunk_positions(raw)[2]
    begin = at + 60 if with_copy else at - 200
    bag.writer.path.write_bytes(zeroed(begin, at + 80 - begin)(raw))
    if repaired:
        recover(bag.writer.directory)
    found = [read_bag(bag.writer.directory, run, damaged=True) for run in range(1, 3 + with_copy)]
    assert found[-1].runs == len(found)
    expected = {-2.0: range(10), -3.0: range(10, 20), -4.0: range(20, 30)}
    if not with_copy:
        del expected[-3.0]
    assert {r.spin_rate_ratio: r.step.tolist() for r in found} == {
        ratio: list(steps) for ratio, steps in expected.items()
    }
    assert with_copy or any("steps behind" in line for line in found[0].damage)


def test_a_recording_without_a_summary_is_read_by_its_records(whole, tmp_path):
    raw = (whole[0] / "bag_0.mcap").read_bytes()
    with McapFile(whole[0] / "bag_0.mcap") as file:
        end = file.places[-1].position
    (tmp_path / "cut.mcap").write_bytes(raw[:end])
    recording = read_bag(tmp_path / "cut.mcap", damaged=True)
    for name in ARRAYS:
        np.testing.assert_array_equal(getattr(recording, name), getattr(whole[1], name))
    assert len(recording.damage) == 1 and "cut short" in recording.damage[0]
