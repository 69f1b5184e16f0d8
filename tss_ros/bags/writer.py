"""Bags in MCAP, written so that ros2 bag, Foxglove, Rerun and others open them.

Log times are simulation times, so players replay at simulation pace; publish times are wall times.
What a file holds is on its way to the disk at each `flush`, and `tss_ros.bags.recover` makes a
whole bag of one whose recorder was killed.
"""

import os
import time
from importlib.metadata import version
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from mcap.records import Channel, Message, Schema
from mcap.writer import CompressionType

from tss_ros.bags.columns import ColumnWriter
from tss_ros.bags.directory import lock, sync_directory
from tss_ros.bags.metadata import NOTES, BagFile, dump, information, write_metadata
from tss_ros.bags.records import LATCHED, TOPICS, pack_message, pack_topics
from tss_ros.core import TssError

#: Small chunks and frequent flushes bound what a killed recorder loses.
CHUNK_BYTES = 256 * 1024
FSYNC_PERIOD_S = 1.0
#: Schemas and channels, which the format has once only, are written again after so many seconds.
TOPICS_PERIOD_S = 60.0
#: Free space [B] at which a recording ends: its index and what comes between two flushes fit.
RESERVE_BYTES = 16 * 2**20
#: The same as a file is begun, for `recover`.
FIRST_NOTES = "tss_ros_begun"


class BagWriter:
    """Writes serialised messages into a new bag: `<name>_0.mcap` ... and, last, metadata.yaml.

    Parameters
    ----------
    directory : str or Path
        The bag, to be made; parents are made as needed.
    ros_distro : str
        Stored in the metadata.
    split_bytes, split_s : float
        A file this large, or open for so long [s], is completed and the next one begun; 0: never.
        The index of a file is kept in memory until then.

    Attributes
    ----------
    notes : dict of str to str
        Written into each file as it is completed, and into metadata.yaml.
    is_complete : bool
        Whether the bag is.

    Raises
    ------
    TssError
        If `directory` exists already or cannot be made.
    """

    def __init__(
        self, directory: str | Path, ros_distro: str, split_bytes: float = 0, split_s: float = 0.0
    ) -> None:
        self.directory = Path(directory)
        self.notes = {"recorder": f"tss_ros {version('tss_ros')}", "ros_distro": ros_distro}
        self.message_count = 0
        self.is_complete = False
        self._ros_distro = ros_distro
        self._split_bytes, self._split_s = split_bytes, split_s
        self._topics = []
        self._files = []
        self._ended = False
        try:
            self.directory.mkdir(parents=True)
            self._lock = lock(self.directory)
            self._begin_file()
            sync_directory(self.directory.absolute().parent)
        except FileExistsError:
            raise TssError(
                f"output {str(directory)!r} exists already; give a directory that does not exist"
            ) from None
        except OSError as error:
            raise TssError(f"output {str(directory)!r} cannot be made: {error.strerror}") from error

    @property
    def path(self) -> Path:
        """The file that is being written."""
        return self.directory / self._files[-1].name

    def add_topic(
        self,
        name: str,
        type_name: str,
        definition: str,
        type_hash: str,
        offered_qos: dict[str, Any],
    ) -> int:
        """Announce a topic.

        Parameters
        ----------
        name : str
            Full name, e.g. "/bead_states".
        type_name, definition, type_hash : str
            "package/msg/Type", its text with the texts of the types it uses, its RIHS01 hash.
        offered_qos : dict
            One QoS profile in rosbag2's notation.

        Returns
        -------
        int
            The topic's number, for `write`.
        """
        topic = {
            "name": name,
            "type": type_name,
            "serialization_format": "cdr",
            "offered_qos_profiles": [offered_qos],
            "type_description_hash": type_hash,
        }
        self._topics.append((topic, definition))
        return self._register(topic, definition)

    def write(
        self, channel: int, data: bytes, log_time_ns: int, publish_time_ns: int, sequence: int
    ) -> None:
        """Write one serialised message of a topic announced before. After a failure, do nothing.

        Parameters
        ----------
        channel : int
            The topic's number, from `add_topic`.
        data : bytes
        log_time_ns, publish_time_ns : int
            Simulation time and wall time [ns].
        sequence : int
            Number of the message in its topic.

        Raises
        ------
        TssError
            Here, in `flush` and in `close`: if the disk does not take it.
        """
        if self._ended:
            return
        try:
            if not self._repeated:
                self._repeat_topics()
            if self._is_latched(channel):  # a description that is lost makes steps worth nothing
                message = Message(channel, log_time_ns, data, publish_time_ns, sequence)
                self._writer.add_metadata(LATCHED, pack_message(message))
            self._writer.add_message(channel, log_time_ns, data, publish_time_ns, sequence)
        except OSError as error:
            raise self._failure(error) from error
        self._count(channel, log_time_ns, log_time_ns, 1)

    def write_columns(
        self,
        columns: dict[int, np.ndarray],
        log_time_ns: np.ndarray,
        publish_time_ns: int,
        sequence: int,
    ) -> None:
        """Write messages of several topics that belong to the same times, as a chunk of their own.

        Parameters
        ----------
        columns : dict of int to ndarray, shape (k, bytes), uint8
            Serialised messages by the topic's number; at each time, topics come in this order.
        log_time_ns : ndarray, shape (k,)
            Simulation times [ns].
        publish_time_ns, sequence : int
            Wall time [ns] of all; number of the first in each topic.

        Raises
        ------
        TssError
            As `write` does.
        """
        if self._ended or not len(log_time_ns):
            return
        try:
            if not self._repeated:
                self._repeat_topics()
            self._writer.add_columns(columns, log_time_ns, publish_time_ns, sequence)
        except OSError as error:
            raise self._failure(error) from error
        for channel in columns:
            self._count(channel, log_time_ns.min(), log_time_ns.max(), len(log_time_ns))

    def _count(self, channel, first_ns, last_ns, count):
        topic = self._topics[channel - 1][0]["name"]
        self._files[-1].add(topic, int(first_ns), int(last_ns), count)
        self.message_count += count

    def flush(self) -> None:
        """Hand all that is written to the operating system and, each second, to the disk.

        Raises
        ------
        TssError
            Also if the disk is nearly full or the file has been taken away; `close` comes next.
        """
        if self._ended:
            return
        try:
            self._writer.flush()
            now = time.monotonic()
            if self._repeated == 1 or now - self._topics_written > TOPICS_PERIOD_S:
                self._repeat_topics()
            if now - self._synced > FSYNC_PERIOD_S:
                os.fsync(self._file.fileno())
                self._synced = now
            size = self._file.tell()
            if (0 < self._split_bytes <= size) or (0 < self._split_s <= now - self._begun):
                self.next_file()
            disk = os.fstatvfs(self._file.fileno())
        except OSError as error:
            raise self._failure(error) from error
        if disk.f_bavail * disk.f_frsize < RESERVE_BYTES + size // 100:
            self.close()  # which says so where it fails
            raise TssError(
                f"{self.path}: the disk is nearly full, so the recording ends here, complete"
            )
        if not self._is_in_place():
            raise TssError(f"{self.path} was moved or removed while it was recorded")

    def next_file(self) -> None:
        """Complete the file and begin the next one, as for a new run: log times may go back.

        Raises
        ------
        TssError
            If the disk does not take it.
        """
        if self._ended:
            return
        try:
            self._finish_file()
            self._begin_file()
        except OSError as error:
            raise self._failure(error) from error

    def close(self) -> None:
        """Complete the bag: indexes, summary, metadata.yaml. After a failure, do nothing.

        A file that was moved is completed where it is now.
        """
        if self._ended:
            return
        self._ended = True
        try:
            in_place = self._is_in_place()
            self._finish_file()
            if in_place:
                topics = [topic for topic, _ in self._topics]
                write_metadata(self.directory, self._files, topics, self._ros_distro, self.notes)
                self.is_complete = True
        except OSError as error:
            raise self._failure(error) from error
        finally:
            os.close(self._lock)

    def _begin_file(self):
        name = f"{self.directory.absolute().name}_{len(self._files)}.mcap"
        self._file = (self.directory / name).open("xb")
        self._files.append(BagFile(name))
        self._begun = time.monotonic()
        self._synced = self._begun - FSYNC_PERIOD_S
        self._repeated, self._topics_written = 0, self._begun
        self._schemas, self._channels = [], []
        self._writer = begin(self._file)
        self._writer.add_metadata(FIRST_NOTES, self.notes)
        for topic, definition in self._topics:
            self._register(topic, definition)
        sync_directory(self.directory)

    def _is_latched(self, channel):
        (qos,) = self._topics[channel - 1][0]["offered_qos_profiles"]
        return qos.get("durability") == "transient_local"

    def _repeat_topics(self):
        """Write schemas and channels outside of chunks: before the first one, behind it, and on."""
        self._writer.add_metadata(TOPICS, pack_topics(self._schemas, self._channels))
        self._repeated += 1
        self._topics_written = time.monotonic()

    def _register(self, topic, definition):
        schema = self._writer.register_schema(topic["type"], "ros2msg", definition.encode())
        qos, type_hash = topic["offered_qos_profiles"], topic["type_description_hash"]
        metadata = {"offered_qos_profiles": dump(qos), "topic_type_hash": type_hash}
        channel = self._writer.register_channel(topic["name"], "cdr", schema, metadata)
        self._schemas.append(Schema(schema, definition.encode(), "ros2msg", topic["type"]))
        self._channels.append(Channel(channel, topic["name"], "cdr", metadata, schema))
        self._repeated = 0
        return channel

    def _finish_file(self):
        file = self._files[-1]
        file.counts = {
            topic["name"]: file.counts.get(topic["name"], 0) for topic, _ in self._topics
        }
        topics = [topic for topic, _ in self._topics]
        finish(self._writer, self._file, file, topics, self._ros_distro, self.notes)

    def _is_in_place(self):
        try:
            return os.path.samestat(os.stat(self.path), os.fstat(self._file.fileno()))
        except OSError:
            return False

    def _failure(self, error):
        self._ended = True
        return TssError(
            f"{self.path} cannot be written: {error.strerror}; it ends incomplete, and "
            f"`recover {self.directory}` makes a whole bag of it"
        )


def begin(stream: BinaryIO) -> ColumnWriter:
    """A writer of chunks and checksums, as files of bags have them."""
    writer = ColumnWriter(
        stream, chunk_size=CHUNK_BYTES, compression=CompressionType.LZ4, enable_data_crcs=True
    )
    writer.start(profile="ros2")
    return writer


def finish(
    writer: ColumnWriter,
    stream: BinaryIO,
    file: BagFile,
    topics: list[dict[str, Any]],
    ros_distro: str,
    notes: dict[str, str],
) -> None:
    """Complete one file: metadata, indexes, summary; safe on the disk when this returns.

    Parameters
    ----------
    writer : ColumnWriter
    stream : file object
        What `writer` writes to.
    file : BagFile
    topics : list of dict
        In rosbag2's notation.
    ros_distro : str
    notes : dict of str to str
    """
    said = information([file], topics, ros_distro, notes)
    writer.flush()  # else the metadata would precede the messages they speak of
    writer.add_metadata("rosbag2", {"serialized_metadata": dump(said)})
    writer.add_metadata(NOTES, notes)
    writer.finish()
    stream.flush()
    os.fsync(stream.fileno())
    stream.close()
