"""Records of MCAP files: taken apart, checked and unpacked within bounds."""

import base64
import functools
import io
import json
import struct
import zlib
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import lz4.frame
import numpy as np
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Message,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
)

from tss_ros.core import TssError

#: Most bytes of a record, and of a chunk when it is unpacked.
MAX_RECORD_BYTES = 256 * 2**20
#: A file may unpack to so many times its size, and to SPARE_BYTES more; recordings reach 20.
MAX_RATIO, SPARE_BYTES = 100, 64 * 2**20
#: Names of metadata records that repeat schemas and channels, and a message of a latched topic.
TOPICS, LATCHED = "tss_ros_topics", "tss_ros_latched"
#: Name of the one that says, in a recovered file, where messages were lost, and of which topics.
GAP = "tss_ros_gap"
#: What the libraries raise at damaged data.
DAMAGE = (McapError, ValueError, TypeError, LookupError, RuntimeError, struct.error, EOFError)
DAMAGE += (zstandard.ZstdError,)
#: Opcode and length of a record; the length does not count these.
HEAD = struct.Struct("<BQ")
#: A message record, up to its data.
MESSAGE_HEAD = np.dtype(
    [("opcode", "u1"), ("length", "<u8"), ("channel", "<u2"), ("sequence", "<u4")]
    + [("log_time", "<u8"), ("publish_time", "<u8")]
)
_LEAST_MESSAGE = MESSAGE_HEAD.itemsize - HEAD.size
_ZSTD_MAGIC = np.frombuffer(b"\x28\xb5\x2f\xfd", np.uint8)
_INDEX_HEAD = struct.Struct("<HI")  # channel and bytes of a message index
_INDEX_ENTRY_BYTES = 16
_CHUNK_HEAD_BYTES = 64  # enough for any chunk's head
_KINDS = {
    Opcode.HEADER: Header,
    Opcode.FOOTER: Footer,
    Opcode.SCHEMA: Schema,
    Opcode.CHANNEL: Channel,
    Opcode.CHUNK_INDEX: ChunkIndex,
    Opcode.STATISTICS: Statistics,
    Opcode.METADATA: Metadata,
    Opcode.METADATA_INDEX: MetadataIndex,
    Opcode.DATA_END: DataEnd,
}
_OPCODES = frozenset(map(int, Opcode))
#: Opcodes from here on are for records of anybody's own.
PRIVATE = 0x80


class BagError(TssError):
    """What a bag's files hold cannot be read, or is not what they say; names file and reason."""


@dataclass(frozen=True)
class Damage:
    """A part of a bag that is not intact.

    Attributes
    ----------
    file : str
        Name of the file.
    position, byte_count : int
        Where in it; no bytes where it is about the whole file.
    reason : str
    lost_in : dict of int to int, or None
        Messages that are lost by it, by channel; None if nothing tells.
    chunk : int or None
        Number of the chunk, from 1.
    """

    file: str
    position: int
    byte_count: int
    reason: str
    lost_in: dict[int, int] | None
    chunk: int | None = None

    @property
    def lost(self) -> int | None:
        """Messages that are lost by it; None if nothing tells."""
        return None if self.lost_in is None else sum(self.lost_in.values())

    def __str__(self) -> str:
        where = [] if self.chunk is None else [f"chunk {self.chunk}"]
        where += [f"{self.byte_count} bytes from byte {self.position}"] if self.byte_count else []
        lost = "; nothing tells how many messages are lost"
        if self.lost is not None:
            lost = f"; {self.lost} messages lost" if self.lost else ""
        return ": ".join([self.file, *filter(None, [", ".join(where)]), self.reason + lost])


@dataclass(frozen=True)
class Batch:
    """Messages that lie in one buffer: those of a chunk, or some outside of chunks.

    Attributes
    ----------
    data : ndarray of uint8
    offsets : ndarray of int, shape (k,)
        Where in `data` the message records begin.
    heads : ndarray of MESSAGE_HEAD, shape (k,)
    position : int
        Where in the file.
    chunk : mcap.records.Chunk or None
    """

    data: np.ndarray
    offsets: np.ndarray
    heads: np.ndarray
    position: int
    chunk: Chunk | None = None

    @classmethod
    def of(cls, data: bytes, offsets: Sequence[int], position: int, chunk: Chunk | None) -> "Batch":
        """Messages at offsets of a buffer."""
        data, offsets = np.frombuffer(data, np.uint8), np.array(offsets, dtype=int)
        heads = data[offsets[:, None] + np.arange(MESSAGE_HEAD.itemsize)].view(MESSAGE_HEAD)
        return cls(data, offsets, heads.reshape(-1), position, chunk)

    @functools.cached_property
    def sizes(self) -> np.ndarray:
        """Bytes of each message."""
        return self.heads["length"].astype(int) - _LEAST_MESSAGE

    def payload(self, i: int) -> bytes:
        """The i-th message."""
        begin = self.offsets[i] + MESSAGE_HEAD.itemsize
        return self.data[begin : begin + self.sizes[i]].tobytes()

    def only(self, chosen: np.ndarray) -> "Batch":
        """Some of the messages."""
        return Batch(self.data, self.offsets[chosen], self.heads[chosen], self.position, self.chunk)


class Unpacker:
    """Unpacks chunks and messages of a file, in all to no more than its size allows.

    Parameters
    ----------
    shown : str
        Names the file.
    file_bytes : int
    """

    def __init__(self, shown: str, file_bytes: int) -> None:
        self._shown, self._room = shown, MAX_RATIO * file_bytes + SPARE_BYTES

    def take(self, count: int) -> None:
        """Count bytes that were unpacked."""
        self._room -= count
        if self._room < 0:
            raise BagError(f"{self._shown} would unpack to more than {MAX_RATIO} times its size")

    def chunk(self, chunk: Chunk) -> bytes:
        """The records in a chunk, whose size and checksum are as it says."""
        size = chunk.uncompressed_size
        if size > MAX_RECORD_BYTES:
            raise ValueError(f"it says that it unpacks to {size} bytes")
        self.take(size)
        if chunk.compression == "lz4":
            unpacker = lz4.frame.LZ4FrameDecompressor()
            data = unpacker.decompress(chunk.data, max_length=size + 1)
        elif chunk.compression == "zstd":
            data = _unzstd(chunk.data, size + 1)
        elif chunk.compression == "":
            data = chunk.data
        else:
            raise ValueError(f"its compression {chunk.compression!r:.40} is not known")
        if len(data) != size:
            raise ValueError("it does not unpack to the size it says")
        if chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
            raise ValueError("its checksum is wrong")
        return data

    def messages(self, batch: Batch) -> Batch:
        """A batch with its messages unpacked, should they be compressed one by one."""
        if not len(batch.offsets):
            return batch
        firsts = np.minimum(batch.offsets + MESSAGE_HEAD.itemsize, len(batch.data) - 1)
        packed = np.flatnonzero(batch.data[firsts] == _ZSTD_MAGIC[0])
        packed = packed[batch.sizes[packed] >= len(_ZSTD_MAGIC)]
        begins = batch.offsets[packed, None] + MESSAGE_HEAD.itemsize + np.arange(4)
        packed = set(packed[(batch.data[begins] == _ZSTD_MAGIC).all(axis=1)].tolist())
        if not packed:
            return batch
        parts, offsets, at = [], [], 0
        for i in range(len(batch.offsets)):
            data = batch.payload(i)
            if i in packed:
                data = _unzstd(data, min(MAX_RECORD_BYTES, self._room + 1))
                self.take(len(data))
            head = batch.heads[i : i + 1].copy()
            head["length"] = _LEAST_MESSAGE + len(data)
            parts += [head.tobytes(), data]
            offsets.append(at)
            at += MESSAGE_HEAD.itemsize + len(data)
        return Batch.of(b"".join(parts), offsets, batch.position, batch.chunk)


def records(data: bytes) -> Iterator[tuple[int, int, int]]:
    """Opcode, offset and length of each record in a buffer that records fill."""
    at, end, unpack = 0, len(data), HEAD.unpack_from
    while at < end:
        opcode, length = unpack(data, at)
        yield opcode, at, length
        at += 9 + length
    if at != end:
        raise ValueError("its records do not fit into it")


def messages_in(data: bytes) -> tuple[list[int], list[McapRecord]]:
    """Where the messages in a chunk begin, and the schemas and channels in it."""
    offsets, definitions = [], []
    for opcode, at, length in records(data):
        if opcode == Opcode.MESSAGE:
            if length < _LEAST_MESSAGE:
                raise ValueError("a message in it is too short")
            offsets.append(at)
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            definitions.append(parsed(opcode, data[at : at + HEAD.size + length]))
        elif opcode < PRIVATE or length < _LEAST_MESSAGE:
            raise ValueError(f"there is a record of kind {opcode} in it")
    return offsets, definitions


def leading_messages(data: bytes) -> int:
    """How many bytes at the beginning of a buffer are whole message records."""
    at = 0
    while at + MESSAGE_HEAD.itemsize <= len(data):
        opcode, length = HEAD.unpack_from(data, at)
        after = at + HEAD.size + length
        if opcode != Opcode.MESSAGE or length < _LEAST_MESSAGE or after > len(data):
            break
        at = after
    return at


def parsed(opcode: int, raw: bytes) -> McapRecord | None:
    """A record that fills its bytes; None for kinds that nobody asks for.

    Raises
    ------
    one of DAMAGE
        If it does not.
    """
    kind, stream = _KINDS.get(opcode), stream_of(raw)
    if kind is None:
        if not is_plausible(opcode):
            raise ValueError(f"there is no record of kind {opcode}")
        return None
    record = kind.read(stream)
    if HEAD.size + stream.count != len(raw):
        raise ValueError("a record is not as long as it says")
    return record


def is_plausible(opcode: int) -> bool:
    """Whether records of this kind may stand outside of chunks."""
    return opcode >= PRIVATE or opcode in _OPCODES


def chunk_head(raw: bytes, byte_count: int) -> Chunk:
    """What a chunk record of so many bytes says about its data, from its first bytes."""
    stream = stream_of(raw[:_CHUNK_HEAD_BYTES])
    first, last, size, checksum = stream.read8(), stream.read8(), stream.read8(), stream.read4()
    compression = stream.read_prefixed_string()
    stored = stream.read8()
    if HEAD.size + stream.count + stored != byte_count:
        raise ValueError("a chunk is not as long as it says")
    return Chunk(compression, b"", last, first, checksum, size)


def index_head(raw: bytes, byte_count: int) -> tuple[int, int]:
    """Channel and number of messages of a message index of so many bytes."""
    channel, stored = _INDEX_HEAD.unpack_from(raw, HEAD.size)
    if HEAD.size + _INDEX_HEAD.size + stored != byte_count or stored % _INDEX_ENTRY_BYTES:
        raise ValueError("a message index is not as long as it says")
    return channel, stored // _INDEX_ENTRY_BYTES


def index_entries(raw: bytes) -> np.ndarray:
    """Log times and offsets of a message index, shape (k, 2)."""
    return np.frombuffer(raw, "<u8", offset=HEAD.size + _INDEX_HEAD.size).reshape(-1, 2)


def stream_of(raw: bytes) -> ReadDataStream:
    """A record's content, for the readers of the mcap library."""
    return ReadDataStream(io.BytesIO(raw[HEAD.size :]))


def pack_topics(schemas: Iterable[Schema], channels: Iterable[Channel]) -> dict[str, str]:
    """Schemas and channels as the content of a metadata record TOPICS."""
    schemas = [[s.id, s.name, s.encoding, s.data.decode("latin-1")] for s in schemas]
    names = ("id", "topic", "message_encoding", "metadata", "schema_id")
    channels = [[getattr(channel, name) for name in names] for channel in channels]
    return _packed([schemas, channels])


def unpack_topics(content: dict[str, str]) -> list[McapRecord]:
    """The schemas and channels of a metadata record TOPICS; none if it is not intact."""
    try:
        schemas, channels = _unpacked(content)
        return [
            *(Schema(i, d.encode("latin-1"), encoding, name) for i, name, encoding, d in schemas),
            *(Channel(*channel) for channel in channels),
        ]
    except (AttributeError, *DAMAGE):
        return []


def pack_message(message: Message) -> dict[str, str]:
    """A message as the content of a metadata record LATCHED."""
    data = base64.b64encode(message.data).decode()
    place = [message.channel_id, message.log_time, message.publish_time, message.sequence]
    return _packed([*place, data])


def unpack_message(content: dict[str, str]) -> Message | None:
    """The message of a metadata record LATCHED; None if it is not intact."""
    try:
        channel, log_time, publish_time, sequence, data = _unpacked(content)
        return Message(channel, log_time, base64.b64decode(data), publish_time, sequence)
    except (AttributeError, *DAMAGE):
        return None


def pack_gap(topics: Iterable[str] | None) -> dict[str, str]:
    """The topics that lost messages, None for any, as the content of a metadata record GAP."""
    return _packed(None if topics is None else sorted(topics))


def unpack_gap(content: dict[str, str]) -> set[str] | None:
    """The topics of a metadata record GAP; None for any, and if it is not intact."""
    try:
        topics = _unpacked(content)
        return None if topics is None else set(topics)
    except (AttributeError, *DAMAGE):
        return None


def _packed(content):
    text = json.dumps(content)
    return {"content": text, "crc32": str(zlib.crc32(text.encode()))}


def _unpacked(packed):
    text = packed["content"]
    if packed["crc32"] != str(zlib.crc32(text.encode())):
        raise ValueError("a copy is damaged")
    return json.loads(text)


def one_line(text: object) -> str:
    """A text as terminals can show it in one line: what is not printable is written in escapes."""
    return "".join(c if c.isprintable() else repr(c)[1:-1] for c in str(text))


def _unzstd(data, most):
    """The first bytes of what was compressed, at most so many."""
    with zstandard.ZstdDecompressor().stream_reader(data) as stream:
        return stream.read(most)
