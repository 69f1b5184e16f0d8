"""The messages of a bag in bulk: a million steps in the time the disk and numpy take."""

import contextlib
import os
import re
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import SeekingReader
from mcap.records import Chunk
from mcap.stream_reader import get_chunk_data_stream
from mcap.summary import Summary
from mcap_ros2.decoder import DecoderFactory

from tss_ros.bags.cdr import Layout
from tss_ros.bags.writer import NOTES
from tss_ros.core import TssError

STATES = ("BeadStates", "TetherStates")
OTHERS = ("SystemDescription", "FloquetResult")
#: What the libraries raise at damaged data.
DAMAGE = (McapError, ValueError, RuntimeError, struct.error)
#: Beginning and end marks with a header and a footer between them.
MIN_FILE_BYTES = 64
#: What precedes the data of a message record in a chunk of an MCAP file.
_MESSAGE_HEAD = np.dtype(
    [("opcode", "u1"), ("length", "<u8"), ("channel", "<u2"), ("sequence", "<u4")]
    + [("log_time", "<u8"), ("publish_time", "<u8")]
)
_RECORD_HEAD_BYTES = 9  # of opcode and length, which the length does not count


def bag_files(path: str | Path) -> list[Path]:
    """The .mcap files of a bag in the order of recording.

    Parameters
    ----------
    path : str or Path
        Bag directory or .mcap file.

    Returns
    -------
    list of Path

    Raises
    ------
    TssError
        If there is none.
    """
    path = Path(path)
    files = list(path.glob("*.mcap")) if path.is_dir() else [path]
    if not files:
        raise TssError(f"{str(path)!r} holds no .mcap file")
    return sorted(files, key=lambda f: [int(n) for n in re.findall(r"_(\d+)\.mcap$", f.name)])


@contextlib.contextmanager
def open_complete(file: Path) -> Iterator[BinaryIO]:
    """Open an MCAP file to be read, for a `with` block that needs it complete.

    Parameters
    ----------
    file : Path

    Yields
    ------
    file object

    Raises
    ------
    TssError
        If it cannot be read, or if the block finds it damaged.
    """
    try:
        with file.open("rb") as stream:
            yield stream
    except OSError as error:
        raise TssError(f"{str(file)!r} cannot be read: {error.strerror}") from error
    except DAMAGE as error:
        reason = str(error) or type(error).__name__
        raise TssError(
            f"{str(file)!r} is not a complete MCAP file: {reason}; if its recorder was "
            "killed, `recover` makes a whole bag of it"
        ) from error


def indexed_reader(stream: BinaryIO) -> tuple[SeekingReader, Summary]:
    """The reader and the summary of a complete MCAP file.

    Raises
    ------
    one of DAMAGE
        If it is not complete.
    """
    if stream.seek(0, os.SEEK_END) < MIN_FILE_BYTES:
        raise McapError("it is too short")
    stream.seek(0)
    reader = SeekingReader(stream)
    summary = reader.get_summary()
    if summary is None or summary.statistics is None:
        raise McapError("it has no summary")
    return reader, summary


class BagContent:
    """Collects what a bag's files hold, file by file."""

    def __init__(self, shown: str) -> None:
        self.shown = shown
        self._blocks = {name: [] for name in STATES}  # serialised messages, (k, bytes) each
        self._definition = {}
        self.others = {name: [] for name in OTHERS}  # (bead states before it, message)
        self._bead_count = 0
        self.lost = None

    def read(self, stream: BinaryIO) -> None:
        """Take the messages of the next file."""
        reader, summary = indexed_reader(stream)
        if summary.statistics.message_count and not summary.chunk_indexes:
            raise McapError("it has no chunks with an index")
        for record in reader.iter_metadata():
            if record.name == NOTES and "lost" in record.metadata:
                self.lost = int(record.metadata["lost"])  # of all files up to this one
        types = {
            channel: summary.schemas[c.schema_id]
            for channel, c in summary.channels.items()
            if c.schema_id in summary.schemas
        }
        wanted = {f"tss_interfaces/msg/{name}": name for name in (*STATES, *OTHERS)}
        for index in sorted(summary.chunk_indexes, key=lambda index: index.chunk_start_offset):
            found = {
                wanted[types[channel].name]: (channel, offset)
                for channel, offset in index.message_index_offsets.items()
                if channel in types and types[channel].name in wanted
            }
            if found:
                self._read_chunk(stream, index, found, types)

    def _read_chunk(self, stream, index, found, types):
        stream.seek(index.chunk_start_offset + _RECORD_HEAD_BYTES)
        data, size = get_chunk_data_stream(Chunk.read(ReadDataStream(stream)))
        chunk = np.frombuffer(data.read(size), np.uint8)
        beads = np.empty(0, int)
        for name in (*STATES, *OTHERS):
            if name not in found:
                continue
            channel, place = found[name]
            offsets = _offsets(stream, place)
            if name in STATES:
                beads = offsets if name == "BeadStates" else beads
                self._definition.setdefault(name, types[channel].data.decode())
                self._blocks[name] += _rows(chunk, offsets)
                continue
            decode = DecoderFactory().decoder_for("cdr", types[channel])
            for offset in offsets:
                ((message,),) = _rows(chunk, np.array([offset]))
                before = self._bead_count + int((beads < offset).sum())
                self.others[name].append((before, decode(message.tobytes())))
        self._bead_count += len(beads)

    def runs(self, name: str) -> list[np.ndarray]:
        """The numbers of each run's messages, as structured arrays with rising steps.

        A simulator that is started anew counts steps from 0; one that is reset goes on counting,
        and says in the new run's description with which step it begins.
        """
        runs, layout, joined = [], None, []

        def split():
            if joined:
                numbers = np.concatenate([layout.numbers(rows) for rows in joined])
                anew = np.flatnonzero(numbers["step"][1:] <= numbers["step"][:-1]) + 1
                runs.extend(np.split(numbers, anew))
                joined.clear()

        for rows in self._blocks[name]:
            while len(rows):
                count = 0 if layout is None else _leading(layout.fits(rows))
                if not count:
                    split()
                    layout, count = Layout(self._definition[name], rows[0].tobytes()), 1
                joined.append(rows[:count])
                rows = rows[count:]
        split()
        if not runs:
            raise TssError(f"{self.shown!r} holds no message of type {name}")
        simulators = self._first_steps()
        if len(simulators) != len(runs):
            return runs
        parts = []
        for numbers, first_steps in zip(runs, simulators):
            parts += np.split(numbers, np.searchsorted(numbers["step"], first_steps))
        return [part for part in parts if len(part)]

    def _first_steps(self):
        """For each simulator the first steps of its runs; bags made before resets have only 0."""
        simulators, last = [], -1
        for _, message in self.others["SystemDescription"]:
            run = getattr(message, "run", 0)
            if not simulators or run <= last:
                simulators.append([])
            simulators[-1].append(getattr(message, "first_step", 0))
            last = run
        return simulators

    def description(self, first_bead: int, number: int, runs: int) -> Any:
        """The description of a run: the newest one before its first bead state."""
        descriptions = self.others["SystemDescription"]
        if not descriptions:
            raise TssError(f"{self.shown!r} holds no message of type SystemDescription")
        if len(descriptions) == runs:
            return descriptions[number - 1][1]
        earlier = [message for before, message in descriptions if before <= first_bead]
        return earlier[-1] if earlier else descriptions[0][1]


def _leading(fits):
    """How many of the first elements are true."""
    return len(fits) if fits.all() else int(fits.argmin())


def _offsets(stream, place):
    """Where in its chunk the messages of one channel begin, from the message index at `place`."""
    stream.seek(place)
    data = ReadDataStream(stream)
    if data.read1() != Opcode.MESSAGE_INDEX:
        raise McapError("its message index is damaged")
    data.read8()
    data.read2()
    pairs = np.frombuffer(data.read(data.read4()), "<u8").reshape(-1, 2)
    return pairs[:, 1].astype(int)


def _rows(chunk, offsets):
    """Messages at `offsets` of a chunk as arrays (k, bytes), a new one where the length changes."""
    heads = chunk[offsets[:, None] + np.arange(_MESSAGE_HEAD.itemsize)].view(_MESSAGE_HEAD)[:, 0]
    lengths = heads["length"].astype(int) + _RECORD_HEAD_BYTES - _MESSAGE_HEAD.itemsize
    changes = np.flatnonzero(np.diff(lengths)) + 1
    return [
        chunk[part[:, None] + _MESSAGE_HEAD.itemsize + np.arange(length[0])]
        for part, length in zip(np.split(offsets, changes), np.split(lengths, changes))
    ]
