"""What a bag's metadata.yaml says."""

import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from tss_ros.bags.directory import create, sync_directory

#: Name of the MCAP metadata record, and of the custom_data in metadata.yaml, with the bag's notes.
NOTES = "tss_ros"


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

    def add(self, topic: str, first_ns: int, last_ns: int, count: int = 1) -> None:
        """Count messages between two log times [ns]."""
        self.counts[topic] = self.counts.get(topic, 0) + count
        if self.first_ns is None:
            self.first_ns, self.last_ns = first_ns, last_ns
        else:
            self.first_ns, self.last_ns = min(first_ns, self.first_ns), max(last_ns, self.last_ns)


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
        As for `writer.finish`.
    """
    text = dump({"rosbag2_bagfile_information": information(files, topics, ros_distro, notes)})
    fresh = directory / ".metadata.yaml"
    with create(fresh) as stream:
        stream.write(text.encode())
        stream.flush()
        os.fsync(stream.fileno())
    fresh.replace(directory / "metadata.yaml")
    sync_directory(directory)


def information(
    files: list[BagFile], topics: list[dict[str, Any]], ros_distro: str, notes: dict[str, str]
) -> dict[str, Any]:
    """rosbag2's bag information, version 9; parameters as for `write_metadata`."""
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


def dump(data: Any) -> str:
    """A text in YAML, for bags."""
    return yaml.dump(data, Dumper=_PlainDumper, sort_keys=False)
