"""One MCAP file, read record by record: every checksum is checked, and what is damaged is named.

Nothing is believed that a checksum contradicts, and nothing is needed but the records themselves:
files without an index, a summary, chunks or an end are read all the same.
"""

import zlib
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from mcap.opcode import Opcode
from mcap.records import Chunk, Schema
from mcap.writer import MCAP0_MAGIC as MAGIC

from tss_ros.bags.records import (
    DAMAGE,
    MESSAGE_HEAD,
    BagError,
    Batch,
    index_entries,
    messages_in,
    stream_of,
)
from tss_ros.bags.structure import McapStructure


@dataclass(frozen=True)
class Gap:
    """Where messages are lost.

    Attributes
    ----------
    position, end : int
    topics : set of str or None
        Of which topics; None for any.
    lost_in : dict of int to int
        How many, by channel, as far as anything tells.
    """

    position: int
    end: int
    topics: set[str] | None
    lost_in: dict[int, int]


class McapFile(McapStructure):
    """The messages of an MCAP file, in addition to its structure."""

    def batches(self) -> Iterator[Batch]:
        """All intact messages in the order of the file; adds to `damage` what is not intact.

        Messages of channels that nothing describes are counted, and left out.
        """
        chunks = [place.record for place in self.places if place.opcode == Opcode.CHUNK]
        self._with_checksums = any(chunk.uncompressed_crc for chunk in chunks)
        checksum, is_gapless = zlib.crc32(self.at(0, len(MAGIC))), not self.damage
        seen, self._seen = 0, set()
        for place in self.places:
            if place.opcode == Opcode.DATA_END:
                self.data_checksum = place.record.data_section_crc
                is_wrong = is_gapless and self.data_checksum not in (0, checksum)
                if is_wrong and not self.damage:
                    self.note(0, 0, "bytes outside of its chunks are not as they were", {})
                break
            raw = self.at(place.position, place.byte_count)
            checksum = zlib.crc32(raw, checksum)
            if place.opcode in (Opcode.CHUNK, Opcode.MESSAGE):
                batch = self._batch(place, raw)
                if batch is not None:
                    seen += len(batch.offsets)
                    if len((batch := self._placed(batch)).offsets):
                        yield batch
        self._compare_counts(seen)

    def batches_and_gaps(self) -> Iterator[Batch | Gap]:
        """The same, with a Gap wherever messages are lost, or were before a recovery."""
        gaps = [self._gap(damage) for damage in self.damage]
        gaps += [Gap(position, position, topics, {}) for position, topics in self.gaps]
        gaps.sort(key=lambda gap: gap.position)
        known, passed = len(self.damage), 0
        for batch in self.batches():
            while passed < len(gaps) and gaps[passed].position < batch.position:
                yield gaps[passed]
                passed += 1
            yield from map(self._gap, self.damage[known:])
            known = len(self.damage)
            yield batch
        yield from gaps[passed:]
        yield from map(self._gap, self.damage[known:])

    def _gap(self, damage):
        lost, topics = damage.lost_in, None
        if lost is not None and lost.keys() <= self.channels.keys():
            topics = {self.channels[number].topic for number, count in lost.items() if count}
        return Gap(damage.position, damage.position + damage.byte_count, topics, lost or {})

    def find_channels(self) -> None:
        """Have all schemas and channels, for which a file without a whole summary is read."""
        if not (self.summary_checksum and self.statistics and self.channels):
            for _ in self.batches():
                pass

    def _batch(self, place, raw):
        """The messages at a place; None, and noted, if they are damaged."""
        chunk = None
        try:
            if place.opcode == Opcode.CHUNK:
                chunk = Chunk.read(stream_of(raw))
                if self._with_checksums and not chunk.uncompressed_crc:
                    raise ValueError("it has lost its checksum")
                raw = self._unpacker.chunk(chunk)
                mark = chunk.uncompressed_crc, len(raw), chunk.message_start_time
                # Where statistics tell how many there are, all may be there.
                if self.statistics is None and chunk.uncompressed_crc and mark in self._seen:
                    self.note(place.position, place.end, "it repeats another chunk", {})
                    return None
                self._seen.add(mark)
            batch = self._indexed_batch(place, raw, chunk)
            if batch is None:
                offsets, definitions = messages_in(raw)
                for definition in definitions:
                    self._define(definition)
                batch = Batch.of(raw, offsets, place.position, chunk)
            return self._unpacker.messages(batch)
        except BagError:
            raise
        except DAMAGE as error:
            reason = str(error) if isinstance(error, ValueError) else "it does not unpack"
            lost = dict(index.record for index in self.indexes_behind(place.position)) or None
            self.note(place.position, place.end, reason, lost)
            return None

    def _indexed_batch(self, place, raw, chunk):
        """A chunk's messages where its indexes say, if just these fill it; spares going through."""
        indexes = self.indexes_behind(place.position) if chunk is not None else []
        if not indexes:
            return None
        found = [index_entries(self.at(p.position, p.byte_count))[:, 1] for p in indexes]
        offsets = np.sort(np.concatenate(found))
        if not len(offsets) or offsets[0] or offsets[-1] > len(raw) - MESSAGE_HEAD.itemsize:
            return None
        batch = Batch.of(raw, offsets, place.position, chunk)
        ends = batch.offsets + MESSAGE_HEAD.itemsize + batch.sizes
        fills = ends[-1] == len(raw) and (ends[:-1] == batch.offsets[1:]).all()
        is_message = batch.heads["opcode"] == Opcode.MESSAGE
        return batch if fills and is_message.all() and batch.sizes.min() >= 0 else None

    def _placed(self, batch):
        """A batch without the messages of channels that nothing describes."""
        is_known = self._is_known(batch)
        if not is_known.all() and self._unchecked:
            # A summary without a checksum is believed where nothing else tells.
            for record in self._unchecked:
                known = self.schemas if isinstance(record, Schema) else self.channels
                known.setdefault(record.id, record)
            self._unchecked = []
            is_known = self._is_known(batch)
        self.unplaced += int((~is_known).sum())
        return batch if is_known.all() else batch.only(is_known)

    def _is_known(self, batch):
        known = [
            i for i, c in self.channels.items() if not c.schema_id or c.schema_id in self.schemas
        ]
        return (batch.heads["channel"][:, None] == known).any(axis=1)

    def _compare_counts(self, seen):
        """Note messages that the file counts, but does not have."""
        if self.unplaced:
            reason = f"{self.unplaced} messages are of channels that nothing describes"
            self.note(0, 0, reason, {0: self.unplaced})
        if self.statistics is None or self.statistics.message_count == seen:
            return
        told = [damage.lost for damage in self.damage]
        if None in told or self.statistics.message_count - seen != sum(told) - self.unplaced:
            reason = f"it counts {self.statistics.message_count} messages, and {seen} are whole"
            self.note(0, 0, reason, {})
