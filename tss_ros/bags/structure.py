"""The records of an MCAP file, found one by one, also behind damage."""

import bisect
import itertools
import os
import re
import tempfile
import zlib
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import zstandard
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    ChunkIndex,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
)
from mcap.writer import MCAP0_MAGIC as MAGIC

from tss_ros.bags.records import (
    DAMAGE,
    GAP,
    HEAD,
    LATCHED,
    MAX_RECORD_BYTES,
    PRIVATE,
    TOPICS,
    BagError,
    Damage,
    Unpacker,
    chunk_head,
    index_head,
    is_plausible,
    leading_messages,
    parsed,
    records,
    stream_of,
    unpack_gap,
    unpack_message,
    unpack_topics,
)
from tss_ros.core import TssError
from tss_ros.scenarios.files import open_regular

_FOOTER_BYTES = HEAD.size + 20
#: Where reading may go on behind damage: at records whose length lies below 4 GiB.
_IN_CHUNKS = re.compile(
    rb"\x06.{4}\0{4}.{28}(?:\x03\0\0\0lz4|\x04\0\0\0zstd|\0{4})|\x0c.{4}\0{4}|\x0f\x04\0{7}", re.S
)
_OUTSIDE = re.compile(rb"[\x03\x04\x05\x0c].{4}\0{4}|\x0f\x04\0{7}", re.S)
_CUT = "it is cut short, so it is not a complete MCAP file"
_MARK_BYTES, _WINDOW_BYTES, _BLOCK_BYTES = 64, 2**16, 2**20


@dataclass(frozen=True)
class Place:
    """Where a record is; for messages outside of chunks, where some in a row are.

    Attributes
    ----------
    opcode, position, byte_count : int
    record : McapRecord, or what is worth knowing of one, or None
        Of a chunk the head, of a message index its channel and how many messages it has.
    """

    opcode: int
    position: int
    byte_count: int
    record: McapRecord | tuple[int, int] | None = None

    @property
    def end(self) -> int:
        """The position behind it."""
        return self.position + self.byte_count


class McapStructure:
    """An MCAP file, or one that is compressed as a whole (`.mcap.zstd`); a context manager.

    Parameters
    ----------
    path : str or Path
    follow : bool
        Whether it may be a link to a file.

    Attributes
    ----------
    path : Path
    size : int
        Bytes, unpacked.
    places : list of Place
        Of the records of the data section.
    header : mcap.records.Header or None
    schemas, channels : dict
    metadata : list of mcap.records.Metadata
    copies : list of tuple of int and mcap.records.Message
        Copies of latched messages, which stand before the chunks that have them; and where.
    gaps : list of tuple of int and set of str or None
        Where messages were lost before the file was recovered, and of which topics, None for any.
    statistics : mcap.records.Statistics or None
        As the summary says, if there is an intact one.
    chunk_indexes : list of mcap.records.ChunkIndex
        As the summary says.
    damage : list of Damage
        What was found so far.
    is_ended : bool
        Whether the file has its end.
    summary_checksum, data_checksum : int
        As the file says; 0 where it has none.
    unplaced : int
        Messages of channels that nothing describes.

    Raises
    ------
    BagError
        If it is no regular file, or none of MCAP.
    """

    def __init__(self, path: str | Path, follow: bool = True) -> None:
        self.path = Path(path)
        self.damage, self.schemas, self.channels, self.metadata = [], {}, {}, []
        self.header, self.statistics, self.chunk_indexes, self._resumes = None, None, [], []
        self.places, self.copies, self.gaps = [], [], []
        self.is_ended, self._chunked, self._end = False, None, 0
        self._chunk_starts, self._unchecked = [], []
        self.summary_checksum = self.data_checksum = self.unplaced = 0
        self._window, self._window_at = b"", 0
        try:
            self._stream = open_regular(path, follow)
        except TssError as error:
            raise BagError(str(error)) from None
        try:
            if self.path.suffix == ".zstd":
                self._stream = self._whole_unpacked(self._stream)
            self.size = self._stream.seek(0, os.SEEK_END)
            self._unpacker = Unpacker(repr(str(path)), self.size)
            self._read_summary(self.size - len(MAGIC) - _FOOTER_BYTES)
            self.places.extend(self._skim())
            self._positions = [place.position for place in self.places]
        except BaseException:
            self._stream.close()
            raise

    def __enter__(self) -> "McapStructure":
        return self

    def __exit__(self, *error: object) -> None:
        self._stream.close()

    def at(self, position: int, count: int) -> bytes:
        """Bytes of the file, through a window that spares small reads."""
        begin = position - self._window_at
        if begin < 0 or begin + count > len(self._window):
            try:
                self._stream.seek(position)
                if count >= _WINDOW_BYTES:
                    return self._stream.read(count)
                self._window, self._window_at = self._stream.read(_WINDOW_BYTES), position
            except OSError as error:
                raise BagError(f"{str(self.path)!r} cannot be read: {error.strerror}") from error
            begin = 0
        return self._window[begin : begin + count]

    def note(self, begin: int, end: int, reason: str, lost: dict[int, int] | None) -> None:
        """Add to what is damaged; `lost` counts messages by channel, None if nothing tells."""
        starts = self._chunk_starts
        if not starts:
            starts = [place.position for place in self.places if place.opcode == Opcode.CHUNK]
        i = bisect.bisect_left(starts, begin)
        chunk = i + 1 if i < len(starts) and begin <= starts[i] < end else None
        self.damage.append(Damage(self.path.name, begin, end - begin, reason, lost, chunk))

    # --- structure

    def _read_summary(self, at, needs_magic=True):
        """Take what the summary says, if there is a footer at this place, and it is intact."""
        raw = self.at(at, _FOOTER_BYTES) if at >= len(MAGIC) else b""
        if len(raw) != _FOOTER_BYTES:
            return
        if needs_magic and self.at(at + _FOOTER_BYTES, len(MAGIC)) != MAGIC:
            return
        if HEAD.unpack_from(raw) != (Opcode.FOOTER, _FOOTER_BYTES - HEAD.size):
            return
        self.is_ended, self._end = True, at
        footer = Footer.read(stream_of(raw))
        begin, self.summary_checksum = footer.summary_start, footer.summary_crc
        if not begin:  # there is none
            begin = at
        if not len(MAGIC) <= begin <= at or at - begin > MAX_RECORD_BYTES:
            self.note(at, self.size, "its footer is damaged", {})
            return
        summary = self.at(begin, at - begin)
        try:
            if self.summary_checksum not in (0, zlib.crc32(summary + raw[:-4])):
                raise ValueError
            found = [
                parsed(opcode, summary[place : place + HEAD.size + length])
                for opcode, place, length in records(summary)
            ]
        except DAMAGE:
            self.note(begin, self.size, "its summary is damaged", {})
            return
        for record in found:
            if isinstance(record, Schema | Channel):
                if self.summary_checksum:
                    self._define(record)
                else:
                    self._unchecked.append(record)
            elif isinstance(record, Statistics):
                self.statistics = record
            elif isinstance(record, ChunkIndex):
                self.chunk_indexes.append(record)
                self._resumes.append(record.chunk_start_offset)
            elif isinstance(record, MetadataIndex):
                self._resumes.append(record.offset)
        self.chunk_indexes.sort(key=lambda index: index.chunk_start_offset)
        self._chunk_starts = [index.chunk_start_offset for index in self.chunk_indexes]
        self._resumes.sort()

    def _skim(self):
        """The places of all records of the data section; those of damage are noted."""
        position = len(MAGIC)
        if self.at(0, len(MAGIC)) != MAGIC:
            if self._resume(0, self.size) < self.size:
                self.note(0, len(MAGIC), "its first bytes are damaged", {})
            elif not MAGIC.startswith(self.at(0, _BLOCK_BYTES).rstrip(b"\0")):
                raise BagError(f"{str(self.path)!r} is not an MCAP file")
        while position < (end := self._end or self.size):
            place = self._place(position, end)
            if place is None:
                after = self._resume(position + 1, end)
                if after < end or self.is_ended:
                    reason = "there is no intact record"
                    self.note(position, after, reason, self._lost_between(position, after))
                elif after > position:
                    self._note_cut(position)
                position = after
                continue
            self._take(place)
            yield place
            position = place.end
            if place.opcode == Opcode.DATA_END:
                if not self.is_ended:
                    self._find_end(position)
                return
        if self.is_ended:
            self.note(self._end, self._end, "its data have no end", {})
        elif not self.damage or self.damage[-1].reason != _CUT:
            self._note_cut(self.size)

    def _note_cut(self, position):
        self.note(position, self.size, _CUT, None)

    def _find_end(self, position):
        """Look for the end of a file whose last bytes are not those of an end."""
        while (place := self._place(position, self.size)) and place.opcode != Opcode.FOOTER:
            position = place.end
        if place is None:
            return self._note_cut(position)
        self._read_summary(place.position, needs_magic=False)
        if self.at(place.end, len(MAGIC)) != MAGIC:
            self.note(place.end, self.size, "its last bytes are damaged", {})
        else:
            self.note(place.end + len(MAGIC), self.size, "these bytes stand behind its end", {})

    def _place(self, position, end):
        """The record at a position, if there is a plausible one that ends before `end`."""
        head = self.at(position, HEAD.size)
        if position + HEAD.size > end or len(head) < HEAD.size:
            return None
        opcode, length = HEAD.unpack(head)
        byte_count = HEAD.size + length
        if position + byte_count > end or byte_count > MAX_RECORD_BYTES:
            return None
        if opcode == Opcode.MESSAGE:
            raw = self.at(position, min(max(byte_count, _BLOCK_BYTES), end - position))
            byte_count = leading_messages(raw)
            return Place(opcode, position, byte_count) if byte_count else None
        try:
            if opcode == Opcode.CHUNK:
                record = chunk_head(self.at(position, _MARK_BYTES), byte_count)
            elif opcode == Opcode.MESSAGE_INDEX:
                record = index_head(self.at(position, _MARK_BYTES), byte_count)
            elif is_plausible(opcode) and not self._is_lost_chunk(opcode, position):
                record = parsed(opcode, self.at(position, byte_count))
            else:
                return None
        except DAMAGE:
            return None
        return Place(opcode, position, byte_count, record)

    def _is_lost_chunk(self, opcode, position):
        """Whether a record of somebody's own is rather a chunk whose first byte was changed."""
        if opcode < PRIVATE:
            return False
        i = bisect.bisect_left(self._chunk_starts, position)
        return not self.is_ended or self._chunk_starts[i : i + 1] == [position]

    def _take(self, place):
        if isinstance(place.record, Schema | Channel):
            self._define(place.record)
        elif isinstance(place.record, Header):
            self.header = place.record
        elif isinstance(place.record, Metadata):
            self.metadata.append(place.record)
            if place.record.name == TOPICS:
                for definition in unpack_topics(place.record.metadata):
                    self._define(definition)
            elif place.record.name == LATCHED:
                message = unpack_message(place.record.metadata)
                self.copies += [(place.position, message)] if message else []
            elif place.record.name == GAP:
                self.gaps.append((place.position, unpack_gap(place.record.metadata)))

    def _define(self, record):
        """Take a schema or a channel, unless another of its number is known."""
        known = self.schemas if isinstance(record, Schema) else self.channels
        if known.setdefault(record.id, record) != record:
            kind = type(record).__name__.lower()
            raise BagError(f"{str(self.path)!r} describes {kind} {record.id} in two ways")

    def _resume(self, position, end):
        """Where behind damage the next record is that can be told from others; or `end`.

        In a file with chunks no definition or message outside of them is: it could be of a damaged
        chunk, without the checksum that covers it.
        """
        if self._chunked is None:
            found = self._search(_IN_CHUNKS, 0, end, Opcode.CHUNK) < end
            self._chunked = bool(self.chunk_indexes) or found
        i = bisect.bisect_left(self._resumes, position)
        known = (p for p in itertools.islice(self._resumes, i, None) if p < end)
        until = next((p for p in known if self._place(p, end)), end)
        return self._search(_IN_CHUNKS if self._chunked else _OUTSIDE, position, until)

    def _search(self, mark, position, end, opcode=None):
        while position < end:
            block = self.at(position, min(_BLOCK_BYTES, end - position))
            for found in mark.finditer(block):
                place = self._place(position + found.start(), end)
                if place and opcode in (None, place.opcode) and self._is_followed(place, end):
                    return place.position
            if len(block) < _BLOCK_BYTES:
                break
            position += len(block) - _MARK_BYTES
        return end

    def _is_followed(self, place, end):
        known = place.opcode in (Opcode.CHUNK, Opcode.DATA_END)
        return known or place.end == end or self._place(place.end, end) is not None

    def _whole_unpacked(self, packed):
        """A temporary file with the content of one that is compressed as a whole."""
        room = Unpacker(repr(str(self.path)), os.fstat(packed.fileno()).st_size)
        plain = tempfile.TemporaryFile()  # noqa: SIM115
        try:
            with packed, zstandard.ZstdDecompressor().stream_reader(packed) as stream:
                while block := stream.read(_BLOCK_BYTES):
                    room.take(len(block))
                    plain.write(block)
        except (zstandard.ZstdError, OSError) as error:
            self.note(plain.tell(), plain.tell(), f"it does not unpack: {error}", None)
        except BaseException:
            plain.close()
            raise
        return plain

    # --- what is lost

    def _lost_between(self, begin, end):
        """Messages by channel of the chunks that begin in a part of the file, if indexes say."""
        first, last = (bisect.bisect_left(self._chunk_starts, place) for place in (begin, end))
        counts = [self._indexed(index) for index in self.chunk_indexes[first:last]]
        if None in counts or not self.chunk_indexes:
            return None
        return dict(sum(map(Counter, counts), Counter()))

    def indexes_behind(self, position: int) -> list[Place]:
        """The message indexes that follow the chunk at a position."""
        i = bisect.bisect_right(self._positions, position)
        following = itertools.islice(self.places, i, None)
        return list(itertools.takewhile(lambda p: p.opcode == Opcode.MESSAGE_INDEX, following))

    def _indexed(self, index):
        """Messages by channel of a chunk, as the message indexes say that the summary names."""
        counts = {}
        for channel, position in index.message_index_offsets.items():
            place = self._place(position, self.size)
            if place is None or place.opcode != Opcode.MESSAGE_INDEX or place.record[0] != channel:
                return None
            counts[channel] = place.record[1]
        return counts or None
