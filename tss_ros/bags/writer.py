"""Bags in MCAP, written so that ros2 bag, Foxglove, Rerun and others open them.

Log times are simulation times, so players replay at simulation pace; publish times are wall times.
What a file holds is on its way to the disk at each `flush`, and `tss_ros.bags.recover` makes a
whole bag of one whose recorder was killed.
"""

import os
import time
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import Any, BinaryIO

import yaml
from mcap.writer import CompressionType, Writer

from tss_ros.bags.directory import lock, sync_directory
from tss_ros.core import TssError

#: Small chunks and frequent flushes bound what a killed recorder loses.
CHUNK_BYTES = 256 * 1024
FSYNC_PERIOD_S = 1.0
#: Free space [B] at which a recording ends: its index and what comes between two flushes fit.
RESERVE_BYTES = 16 * 2**20
#: Name of the MCAP metadata record, and of the custom_data in metadata.yaml, with the bag's notes.
NOTES = "tss_ros"
#: The same as a file is begun, for `recover`.
FIRST_NOTES = "tss_ros_begun"


@dataclass
class BagFile:
    """What metadata.yaml says about one file of a bag.

    Attributes
    ----------
    name : str
    counts : dict of str to int
        Messages by topic.
    first_ns, last_ns : int or None
        Earliest and latest log time [ns].
    """

    name: str
    counts: dict = field(default_factory=dict)
    first_ns: int | None = None
    last_ns: int | None = None

    @property
    def message_count(self) -> int:
        """Messages of all topics."""
        return sum(self.counts.values())

    def add(self, topic: str, log_time_ns: int) -> None:
        """Count one message."""
        self.counts[topic] = self.counts.get(topic, 0) + 1
        if self.first_ns is None:
            self.first_ns = self.last_ns = log_time_ns
        elif log_time_ns > self.last_ns:
            self.last_ns = log_time_ns
        elif log_time_ns < self.first_ns:
            self.first_ns = log_time_ns


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
            self._writer.add_message(channel, log_time_ns, data, publish_time_ns, sequence)
        except OSError as error:
            raise self._failure(error) from error
        self._files[-1].add(self._topics[channel - 1][0]["name"], log_time_ns)
        self.message_count += 1

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
        self._writer = Writer(self._file, chunk_size=CHUNK_BYTES, compression=CompressionType.LZ4)
        self._writer.start(profile="ros2")
        self._writer.add_metadata(FIRST_NOTES, self.notes)
        for topic, definition in self._topics:
            self._register(topic, definition)
        sync_directory(self.directory)

    def _register(self, topic, definition):
        schema = self._writer.register_schema(topic["type"], "ros2msg", definition.encode())
        qos, type_hash = topic["offered_qos_profiles"], topic["type_description_hash"]
        return self._writer.register_channel(
            topic["name"],
            "cdr",
            schema,
            {"offered_qos_profiles": _dump(qos), "topic_type_hash": type_hash},
        )

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


def finish(
    writer: Writer,
    stream: BinaryIO,
    file: BagFile,
    topics: list[dict[str, Any]],
    ros_distro: str,
    notes: dict[str, str],
) -> None:
    """Complete one file: metadata, indexes, summary; safe on the disk when this returns.

    Parameters
    ----------
    writer : mcap.writer.Writer
    stream : file object
        What `writer` writes to.
    file : BagFile
    topics : list of dict
        In rosbag2's notation.
    ros_distro : str
    notes : dict of str to str
    """
    information = _information([file], topics, ros_distro, notes)
    writer.flush()  # else the metadata would precede the messages they speak of
    writer.add_metadata("rosbag2", {"serialized_metadata": _dump(information)})
    writer.add_metadata(NOTES, notes)
    writer.finish()
    stream.flush()
    os.fsync(stream.fileno())
    stream.close()


def write_metadata(
    directory: Path,
    files: list[BagFile],
    topics: list[dict[str, Any]],
    ros_distro: str,
    notes: dict[str, str],
) -> None:
    """Write a bag's metadata.yaml, which rosbag2 needs; whole or not at all.

    Parameters
    ----------
    directory : Path
    files : list of BagFile
    topics, ros_distro, notes
        As for `finish`.
    """
    text = _dump({"rosbag2_bagfile_information": _information(files, topics, ros_distro, notes)})
    fresh = directory / ".metadata.yaml"
    with fresh.open("w", encoding="utf-8") as stream:
        stream.write(text)
        stream.flush()
        os.fsync(stream.fileno())
    fresh.replace(directory / "metadata.yaml")
    sync_directory(directory)


def _information(files, topics, ros_distro, notes):
    """rosbag2's bag information, version 9."""
    spans = [_span(file.message_count, file.first_ns, file.last_ns) for file in files]
    firsts = [file.first_ns for file in files if file.first_ns is not None]
    lasts = [file.last_ns for file in files if file.last_ns is not None]
    total = sum(file.message_count for file in files)
    return {
        "version": 9,
        "storage_identifier": "mcap",
        "relative_file_paths": [file.name for file in files],
        **_span(total, min(firsts, default=None), max(lasts, default=None)),
        "topics_with_message_count": [
            {
                "topic_metadata": topic,
                "message_count": sum(file.counts.get(topic["name"], 0) for file in files),
            }
            for topic in topics
        ],
        "compression_format": "",
        "compression_mode": "",
        "files": [{"path": file.name, **span} for file, span in zip(files, spans)],
        "custom_data": {f"{NOTES}.{key}": value for key, value in notes.items()} or None,
        "ros_distro": ros_distro,
    }


def _span(message_count, first_ns, last_ns):
    first_ns = 0 if first_ns is None else first_ns
    return {
        "starting_time": {"nanoseconds_since_epoch": first_ns},
        "duration": {"nanoseconds": (first_ns if last_ns is None else last_ns) - first_ns},
        "message_count": message_count,
    }


class _PlainDumper(yaml.SafeDumper):
    """Writes every dict out: other YAML readers of bags do not follow anchors."""

    def ignore_aliases(self, data):
        return True


def _dump(data):
    return yaml.dump(data, Dumper=_PlainDumper, sort_keys=False)
