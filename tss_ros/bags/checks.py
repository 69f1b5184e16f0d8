"""Every part of a bag's file against every other: what it holds, and what is wrong with it."""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from mcap.opcode import Opcode
from mcap.records import Channel, Schema

from tss_ros.bags.directory import METADATA, BagFiles
from tss_ros.bags.mcap_file import McapFile
from tss_ros.bags.metadata import NOTES, BagFile, information
from tss_ros.bags.records import Batch, Damage, index_entries
from tss_ros.bags.structure import McapStructure
from tss_ros.core import TssError
from tss_ros.scenarios.files import load_yaml


@dataclass
class CheckedFile:
    """What one file of a bag holds, and what is wrong with it.

    Attributes
    ----------
    path : Path
    entry : BagFile
        What metadata.yaml should say.
    topics : dict of str to dict
        In rosbag2's notation, by name.
    notes : dict of str to str
        Of the recorder.
    faults : list of Damage
    chunks, with_checksum : int
        Chunks, and how many of them have a checksum.
    data_checksum, summary_checksum : int
        0 where the file has none.
    missing : int
        Messages that the sequence numbers of topics leave out.
    time_goes_back : int
        How often log times of a topic do.
    """

    path: Path
    entry: BagFile
    topics: dict[str, dict[str, Any]] = field(default_factory=dict)
    notes: dict[str, str] = field(default_factory=dict)
    faults: list[Damage] = field(default_factory=list)
    chunks: int = 0
    with_checksum: int = 0
    data_checksum: int = 0
    summary_checksum: int = 0
    missing: int = 0
    time_goes_back: int = 0

    @property
    def lost(self) -> int | None:
        """Messages that the file had and that are not whole; None if nothing tells."""
        counts = [damage.lost for damage in self.faults]
        return None if None in counts else sum(counts)


def check_file(path: Path, follow: bool = True) -> CheckedFile:
    """Read all of a file and compare every part of it with every other.

    Parameters
    ----------
    path : Path
    follow : bool
        Whether it may be a link to a file.

    Returns
    -------
    CheckedFile

    Raises
    ------
    BagError
        If it is no MCAP file that can be read within bounds.
    """
    with McapFile(path, follow) as file:
        checked = CheckedFile(path, BagFile(path.name))
        chunks = [place.record for place in file.places if place.opcode == Opcode.CHUNK]
        checked.chunks = len(chunks)
        checked.with_checksum = sum(bool(chunk.uncompressed_crc) for chunk in chunks)
        counted, newest = _Counted(), {}
        for batch in file.batches():
            counted.take(batch, file)
            _take_numbers(batch, file, checked, newest)
            if batch.chunk is not None:
                _check_chunk(batch, file)
        checked.data_checksum, checked.summary_checksum = file.data_checksum, file.summary_checksum
        check_index(file)
        if not file.damage:
            _check_counts(file, counted)
        for channel in file.channels.values():
            checked.topics[channel.topic] = topic_of(channel, file.schemas.get(channel.schema_id))
            checked.entry.counts.setdefault(channel.topic, 0)
        for record in file.metadata:
            checked.notes |= record.metadata if record.name == NOTES else {}
        checked.entry.first_ns, checked.entry.last_ns = counted.first_ns, counted.last_ns
        checked.faults = file.damage
        if not file.damage:
            _check_notes(file, checked)
    return checked


class _Counted:
    """What statistics count."""

    def __init__(self):
        self.by_channel, self.first_ns, self.last_ns = Counter(), None, None

    def take(self, batch, file):
        numbers, counts = np.unique(batch.heads["channel"], return_counts=True)
        self.by_channel.update(dict(zip(numbers.tolist(), counts.tolist())))
        first, last = int(batch.heads["log_time"].min()), int(batch.heads["log_time"].max())
        self.first_ns = first if self.first_ns is None else min(self.first_ns, first)
        self.last_ns = last if self.last_ns is None else max(self.last_ns, last)


def _take_numbers(batch, file, checked, newest):
    """Count messages, gaps of sequence numbers, and times that go back, by topic."""
    for number in np.unique(batch.heads["channel"]).tolist():
        heads = batch.heads[batch.heads["channel"] == number]
        topic = file.channels[number].topic
        counts = checked.entry.counts
        counts[topic] = counts.get(topic, 0) + len(heads)
        before = newest.get(number, heads[:1])
        sequence = np.concatenate([before["sequence"], heads["sequence"]]).astype(np.int64)
        checked.missing += int(np.maximum(np.diff(sequence) - 1, 0).sum())
        log_time = np.concatenate([before["log_time"], heads["log_time"]])
        checked.time_goes_back += int((log_time[1:] < log_time[:-1]).sum())
        newest[number] = heads[-1:]


def _check_chunk(batch: Batch, file: McapFile):
    """Compare a chunk's head and its message indexes with its messages."""
    times, chunk = batch.heads["log_time"], batch.chunk
    if (int(times.min()), int(times.max())) != (chunk.message_start_time, chunk.message_end_time):
        file.note(batch.position, batch.position + 1, "a chunk's times are not its messages'", {})
    indexes = file.indexes_behind(batch.position)
    packed = len(batch.data) != chunk.uncompressed_size  # messages compressed one by one
    for place in indexes if not packed else ():
        channel, count = place.record
        chosen = batch.heads["channel"] == channel
        expected = np.column_stack([times[chosen], batch.offsets[chosen].astype("<u8")])
        found = index_entries(file.at(place.position, place.byte_count))
        if not np.array_equal(np.sort(found, axis=0), np.sort(expected, axis=0)):
            reason = f"the index of channel {channel} is not that of its messages"
            file.note(place.position, place.end, reason, {})
    channels = set(np.unique(batch.heads["channel"]).tolist())
    if indexes and {place.record[0] for place in indexes} != channels:
        file.note(batch.position, batch.position + 1, "a chunk's index lacks topics", {})


def check_index(file: McapStructure) -> None:
    """Compare the index in the summary with the chunks; adds to the file's damage."""
    if not file.chunk_indexes:
        return
    chunks = {place.position: place for place in file.places if place.opcode == Opcode.CHUNK}
    for index in file.chunk_indexes:
        place = chunks.get(index.chunk_start_offset)
        if place is None:
            if not file.damage:
                at = index.chunk_start_offset
                file.note(0, 0, f"its index names a chunk at byte {at}; there is none", {})
            continue
        head = place.record
        found = (place.byte_count, head.compression, head.uncompressed_size)
        found += (head.message_start_time, head.message_end_time)
        said = (index.chunk_length, index.compression, index.uncompressed_size)
        said += (index.message_start_time, index.message_end_time)
        offsets = {p.record[0]: p.position for p in file.indexes_behind(place.position)}
        is_as_said = index.message_index_offsets in ({}, offsets)
        if found != said or not is_as_said:
            file.note(place.position, place.end, "a chunk is not as the file's index says", {})
    unnamed = len(chunks) - len(file.chunk_indexes)
    if unnamed > 0:
        file.note(0, 0, f"{unnamed} chunks are not in the file's index", {})


def _check_counts(file, counted):
    """Compare the statistics with what is there."""
    said = file.statistics
    if said is None:
        return
    found = {
        "message_count": counted.by_channel.total(),
        "chunk_count": sum(p.opcode == Opcode.CHUNK for p in file.places),
    }
    if any(record.name == NOTES for record in file.metadata):
        found |= {"metadata_count": len(file.metadata), "schema_count": len(file.schemas)}
        found |= {"channel_count": len(file.channels)}
        # Other writers take a time of 0 for none, and count schemas and channels in their own way.
        if counted.first_ns is not None:
            found |= {"message_start_time": counted.first_ns, "message_end_time": counted.last_ns}
    for name, value in found.items():
        if getattr(said, name) != value:
            reason = f"its statistics say {name} {getattr(said, name)}; it is {value}"
            file.note(0, 0, reason, {})
    if {i: n for i, n in said.channel_message_counts.items() if n} != dict(counted.by_channel):
        file.note(0, 0, "its statistics count other messages of some topic", {})


def _check_notes(file, checked):
    """Compare what a file says for rosbag2 about itself with what it is."""
    for record in file.metadata:
        if record.name != "rosbag2" or not checked.notes:
            continue
        try:
            said = load_yaml(record.metadata.get("serialized_metadata", ""), "its metadata")
        except TssError as error:
            file.note(0, 0, str(error), {})
            continue
        compare(file.note, "its metadata record", said, expected_information([checked]))


def compare(note: Callable[..., None], where: str, said: Any, expected: dict[str, Any]) -> None:
    """Note each key whose value is not the expected one."""
    if not isinstance(said, dict):
        note(0, 0, f"{where} is no mapping", {})
        return
    for key in sorted({*said, *expected}):
        if said.get(key) != expected.get(key):
            is_, says = repr(expected.get(key)), repr(said.get(key))
            note(0, 0, f"{where} says {key} {says:.60}; it is {is_:.60}", {})


def topic_of(channel: Channel, schema: Schema | None) -> dict[str, Any]:
    """A topic in rosbag2's notation; what older recorders do not say is left empty."""
    qos = channel.metadata.get("offered_qos_profiles", "")
    try:
        profiles = load_yaml(qos, f"the QoS of {channel.topic!r:.200}") or []
    except TssError:
        profiles = []
    return {
        "name": channel.topic,
        "type": schema.name if schema else "",
        "serialization_format": channel.message_encoding,
        "offered_qos_profiles": profiles,
        "type_description_hash": channel.metadata.get("topic_type_hash", ""),
    }


def expected_information(files: Sequence[CheckedFile]) -> dict[str, Any]:
    """What metadata.yaml should say about files of our recorder."""
    topics, notes = {}, {}
    for file in files:
        topics |= file.topics
        notes |= file.notes
    distro = notes.get("ros_distro", "unknown")
    return information([file.entry for file in files], list(topics.values()), distro, notes)


def metadata_faults(files: BagFiles, checked: Sequence[CheckedFile]) -> list[Damage]:
    """What metadata.yaml says otherwise than the files, if there is one."""
    if not files.information:
        return []
    faults, said, expected = [], files.information, expected_information(checked)
    if not all(file.notes for file in checked):  # of others, who have other versions and say less
        keys = {"message_count", "relative_file_paths"} & said.keys()
        if any(file.path.name.endswith(".zstd") for file in checked):
            keys -= {"relative_file_paths"}  # named with or without the ending
        said, expected = ({key: x[key] for key in keys} for x in (said, expected))

    def note(_, __, reason, lost):
        faults.append(Damage(METADATA, 0, 0, reason, lost))

    compare(note, "it", said, expected)
    return faults
