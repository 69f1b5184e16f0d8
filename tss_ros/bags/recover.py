"""Makes a whole bag of one that was cut short: recorder killed, disk full, power lost.

Every chunk that is intact is kept, also behind a damaged one. The damaged file stays beside the new
one as `<name>.mcap.damaged`, and is never changed.
"""

import mmap
import os
import struct
import sys
from collections.abc import Sequence
from pathlib import Path

import yaml
from mcap.records import Channel, Chunk, Metadata, Schema
from mcap.stream_reader import StreamReader, breakup_chunk, get_chunk_data_stream
from mcap.writer import CompressionType, Writer

from tss_ros.bags.directory import lock, sync_directory
from tss_ros.bags.reader import DAMAGE, bag_files, indexed_reader
from tss_ros.bags.writer import (
    CHUNK_BYTES,
    FIRST_NOTES,
    NOTES,
    BagFile,
    finish,
    write_metadata,
)
from tss_ros.command_line import Parser
from tss_ros.core import TssError

DAMAGED_SUFFIX = ".damaged"
#: What stands in each chunk record of our files, and how far behind its beginning.
_CHUNK_MARK, _CHUNK_MARK_OFFSET = struct.pack("<I", 3) + b"lz4", 37


def find_cut(folder: str | Path) -> list[Path]:
    """Bags in a folder that were begun by a recorder of ours that is gone, and never completed.

    Parameters
    ----------
    folder : Path

    Returns
    -------
    list of Path
    """
    begun = {
        bag
        for bag in Path(folder).iterdir()
        for suffix in ("", DAMAGED_SUFFIX)
        if os.path.exists(bag / f"{bag.name}_0.mcap{suffix}")
    }
    return sorted(b for b in begun if not (b / "metadata.yaml").exists() and not _in_use(b))


def recover(bag: str | Path) -> list[str]:
    """Make a bag whole, in place.

    Parameters
    ----------
    bag : str or Path
        Bag directory.

    Returns
    -------
    list of str
        What was done, and what was lost: a line for each file that was not complete.

    Raises
    ------
    TssError
        If there is no such bag, if it is being recorded, or if the disk is full.
    """
    bag = Path(bag)
    if not bag.is_dir():
        raise TssError(f"{str(bag)!r} is not a bag directory")
    try:
        mark = lock(bag)
    except BlockingIOError:
        raise TssError(f"{str(bag)!r} is being recorded") from None
    try:
        return _recover(bag)
    except OSError as error:
        raise TssError(f"{str(bag)!r} cannot be recovered: {error.strerror}") from error
    finally:
        os.close(mark)


def _in_use(bag):
    try:
        os.close(lock(bag))
    except OSError:  # by a recorder, or it belongs to another user
        return True
    return False


def _recover(bag):
    for damaged in bag.glob(f"*.mcap{DAMAGED_SUFFIX}"):
        # An earlier recovery was stopped between its last two steps.
        if not (original := damaged.with_suffix("")).exists():
            damaged.rename(original)
    done, files, topics, notes = [], [], {}, {}
    for path in bag_files(bag):
        try:
            file, found = _whole_file(path, topics)
        except DAMAGE:
            file, found, account = _rewrite(path, topics, notes)
            done.append(account)
        files.append(file)
        notes = {**notes, **found}
    if done or not (bag / "metadata.yaml").exists():
        distro = notes.get("ros_distro", "unknown")
        write_metadata(bag, files, list(topics.values()), distro, notes)
        done = done or [f"{bag}: metadata.yaml was missing; no message was lost"]
    return done


def _whole_file(path, topics):
    """The entry and the notes of a file that is complete."""
    with path.open("rb") as stream:
        reader, summary = indexed_reader(stream)
        statistics, notes = summary.statistics, {}
        for record in reader.iter_metadata():
            notes |= record.metadata if record.name == NOTES else {}
        stream.seek(0)
        records = StreamReader(stream, emit_chunks=True).records
        chunks = (record for record in records if isinstance(record, Chunk))
        indexes = sorted(summary.chunk_indexes, key=lambda index: index.chunk_start_offset)
        for chunk, index in zip(chunks, indexes, strict=True):
            # One whose head is blank reads like an empty chunk without a checksum.
            indexed = index.uncompressed_size, index.compression
            if (chunk.uncompressed_size, chunk.compression) != indexed:
                raise ValueError(f"a chunk of {path} is not as the file's index says")
            get_chunk_data_stream(chunk, validate_crc=True)
    file = BagFile(path.name)
    for channel in summary.channels.values():
        topics[channel.topic] = _topic(channel, summary.schemas[channel.schema_id])
        file.counts[channel.topic] = statistics.channel_message_counts.get(channel.id, 0)
    if statistics.message_count:
        file.first_ns, file.last_ns = statistics.message_start_time, statistics.message_end_time
    return file, notes


def _rewrite(path, topics, notes):
    """Replace a damaged file by one with all that is intact; return its entry, notes, account."""
    fresh = path.with_suffix(".mcap.recovering")
    file, lost = BagFile(path.name), 0
    schemas, channels, last_number, newest_ns = {}, {}, {}, None
    damage = _Damage()
    with path.open("rb") as source, fresh.open("wb") as stream:
        size, written_ns = os.fstat(source.fileno()).st_size, os.fstat(source.fileno()).st_mtime_ns
        writer = Writer(stream, chunk_size=CHUNK_BYTES, compression=CompressionType.LZ4)
        writer.start(profile="ros2")
        for record in _intact_records(source, size, damage):
            if isinstance(record, Metadata):
                if record.name in (NOTES, FIRST_NOTES):
                    notes = {**notes, **record.metadata}
            elif isinstance(record, Schema):
                number = writer.register_schema(record.name, record.encoding, record.data)
                schemas[record.id] = (number, record)
            elif isinstance(record, Channel):
                number, schema = schemas[record.schema_id]
                topics[record.topic] = _topic(record, schema)
                file.counts.setdefault(record.topic, 0)
                channels[record.id] = (
                    record.topic,
                    writer.register_channel(
                        record.topic, record.message_encoding, number, record.metadata
                    ),
                )
            elif record.channel_id in channels:
                topic, channel = channels[record.channel_id]
                writer.add_message(
                    channel, record.log_time, record.data, record.publish_time, record.sequence
                )
                file.add(topic, record.log_time)
                newest_ns = record.publish_time
                expected = last_number.get(channel, record.sequence - 1) + 1
                lost += max(0, record.sequence - expected)
                last_number[channel] = record.sequence
        account = f"{path}: {file.message_count} messages recovered"
        if newest_ns is not None:
            late_s = max(0.0, (written_ns - newest_ns) / 1e9)
            account += f", up to {file.last_ns / 1e9:.3f} s of simulation time, the newest sent "
            account += f"{late_s:.2f} s before the file was last written to"
        account += f"; {lost} missing in between, {damage.byte_count} bytes unreadable"
        notes = {
            **notes,
            "lost": str(int(notes.get("lost", 0)) + lost),
            f"recovered {path.name}": account.partition(": ")[2],
        }
        distro = notes.get("ros_distro", "unknown")
        finish(writer, stream, file, list(topics.values()), distro, notes)
    aside = _free_name(path.with_name(path.name + DAMAGED_SUFFIX))
    path.rename(aside)
    fresh.rename(path)
    sync_directory(path.parent)
    return file, notes, f"{account}; the damaged file is now {aside.name}"


class _Damage:
    """Counts the bytes that hold no intact record."""

    byte_count = 0


def _intact_records(source, size, damage):
    """Every intact metadata record, and the records of every intact chunk, of a damaged file."""
    if not size:
        return
    position = search = 0
    with mmap.mmap(source.fileno(), 0, access=mmap.ACCESS_READ) as content:
        while True:
            source.seek(position)
            reader = StreamReader(
                source, skip_magic=position > 0, emit_chunks=True, record_size_limit=size
            )
            good = position
            try:
                for record in reader.records:
                    if isinstance(record, Chunk):
                        yield from breakup_chunk(record, validate_crc=True)
                    elif isinstance(record, Metadata):
                        yield record
                    good = source.tell()
                return
            except DAMAGE:
                search = max(search, good) + 1
            found = content.find(_CHUNK_MARK, search + _CHUNK_MARK_OFFSET)
            position = size if found < 0 else found - _CHUNK_MARK_OFFSET
            damage.byte_count += position - good
            if found < 0:
                return
            search = position


def _topic(channel, schema):
    """A topic in rosbag2's notation."""
    return {
        "name": channel.topic,
        "type": schema.name,
        "serialization_format": channel.message_encoding,
        "offered_qos_profiles": yaml.safe_load(channel.metadata["offered_qos_profiles"]),
        "type_description_hash": channel.metadata["topic_type_hash"],
    }


def _free_name(path):
    """`path`, or the first of `path.1` and so on that does not exist yet."""
    number = 0
    while (free := path if not number else path.with_name(f"{path.name}.{number}")).exists():
        number += 1
    return free


def main(argv: Sequence[str] | None = None) -> int:
    """Executable `recover`: exit status 0, or 1 with one line why for each bag that failed."""
    parser = Parser(
        prog="recover", description="Make whole bags of recordings that were cut short."
    )
    parser.add_argument("bag", type=Path, nargs="+", help="bag directory")
    status = 0
    for bag in parser.parse_args(argv).bag:
        try:
            print("\n".join(recover(bag) or [f"{bag}: complete, nothing to recover"]), flush=True)
        except TssError as error:
            print(f"recover: {error}", file=sys.stderr)
            status = 1
    return status


if __name__ == "__main__":
    sys.exit(main())
