"""Bags as other recorders, converters and accidents leave them, made of a bag of ours."""

import dataclasses
import io
import shutil
from pathlib import Path

import yaml
import zstandard
from mcap.reader import make_reader
from mcap.writer import CompressionType, IndexType, Writer

PLAIN = {"use_statistics": False, "repeat_channels": False, "repeat_schemas": False}
#: Name of a form, and how the mcap library is told to write it.
WRITERS = {
    "one to one": {},
    "unchunked": {"use_chunking": False},
    "unchunked, no summary": {
        "use_chunking": False,
        "index_types": IndexType.NONE,
        "use_summary_offsets": False,
        **PLAIN,
    },
    "no summary": {"index_types": IndexType.NONE, "use_summary_offsets": False, **PLAIN},
    "no message index": {"index_types": IndexType.CHUNK},
    "no statistics": {"use_statistics": False},
    "zstd chunks": {"compression": CompressionType.ZSTD},
    "plain chunks": {"compression": CompressionType.NONE},
    "no checksums": {"enable_crcs": False},
    "all checksums": {"enable_data_crcs": True},
}


def content(file):
    """Schema, channel and message of each message of a file."""
    with Path(file).open("rb") as stream:
        return list(make_reader(stream).iter_messages(log_time_order=False))


def write(path, messages, change=lambda *parts: parts, **how):
    """Write messages by the mcap library, each changed as told; None leaves one out."""
    how = {"chunk_size": 4096, "compression": CompressionType.LZ4} | how
    schemas, channels = {}, {}
    with Path(path).open("wb") as stream:
        writer = Writer(stream, **how)
        writer.start(profile="ros2", library="another")
        for parts in messages:
            changed = change(*map(dataclasses.replace, parts))
            if changed is None:
                continue
            schema, channel, message = changed
            described = (schema.name, schema.encoding, schema.data)
            if described not in schemas:
                schemas[described] = writer.register_schema(*described)
            named = (channel.topic, channel.message_encoding, *sorted(channel.metadata.items()))
            if (named, described) not in channels:
                channels[named, described] = writer.register_channel(
                    channel.topic, channel.message_encoding, schemas[described], channel.metadata
                )
            writer.add_message(
                channels[named, described],
                message.log_time,
                message.data,
                message.publish_time,
                message.sequence,
            )
        writer.finish()


def in_folder(folder, file, **information):
    """A bag directory of one file, with a metadata.yaml of the few words of older recorders."""
    bag = Path(folder)
    bag.mkdir()
    shutil.copy(file, bag / Path(file).name)
    said = {
        "version": 5,
        "storage_identifier": "mcap",
        "relative_file_paths": [Path(file).name],
        **information,
    }
    (bag / "metadata.yaml").write_text(yaml.safe_dump({"rosbag2_bagfile_information": said}))
    return bag


def without_text(schema, channel, message):
    schema.data = b""
    return schema, channel, message


def with_crlf(schema, channel, message):
    schema.data = schema.data.replace(b"\n", b"\r\n")
    return schema, channel, message


def of_older_rosbag2(schema, channel, message):
    channel.metadata = {}
    return schema, channel, message


def at_wall_clock(schema, channel, message):
    message.log_time = 1_700_000_000 * 10**9 + message.publish_time
    return schema, channel, message


def packed_one_by_one(schema, channel, message):
    message.data = zstandard.compress(message.data)
    return schema, channel, message


def of_a_namespace(prefix):
    def change(schema, channel, message):
        channel.topic = f"/{prefix}{channel.topic}"
        return schema, channel, message

    return change


CHANGES = {
    "no schema text": without_text,
    "CRLF schemas": with_crlf,
    "older rosbag2": of_older_rosbag2,
    "wall-clock log times": at_wall_clock,
    "messages compressed one by one": packed_one_by_one,
}


def pack_whole(path):
    """A file as rosbag2's mode FILE leaves it."""
    packed = Path(f"{path}.zstd")
    packed.write_bytes(zstandard.compress(Path(path).read_bytes()))
    Path(path).unlink()
    return packed


def chunk_positions(raw):
    """Where the chunks of a file begin, and their lengths."""
    summary = make_reader(io.BytesIO(raw)).get_summary()
    return sorted((c.chunk_start_offset, c.chunk_length) for c in summary.chunk_indexes)
