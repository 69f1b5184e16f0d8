"""A bag's directory: its files, marked as being written, and safe on the disk."""

import contextlib
import fcntl
import os
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO

from tss_ros.bags.records import BagError, Damage
from tss_ros.core import TssError
from tss_ros.scenarios.files import load_yaml, read_text

METADATA = "metadata.yaml"
#: Endings of files that are read: MCAP, and MCAP that rosbag2 compressed as a whole.
ENDINGS = (".mcap", ".mcap.zstd")
#: Most files of a bag.
MAX_FILES = 100_000


@dataclass
class BagFiles:
    """The files of a bag.

    Attributes
    ----------
    paths : list of Path
        In the order of recording.
    information : dict
        What metadata.yaml says, without its outermost key; empty if there is none.
    gaps : set of int
        Before which of them one is missing.
    damage : list of Damage
        What is wrong with metadata.yaml, or with the files beside what it says.
    """

    paths: list[Path]
    information: dict[str, Any] = field(default_factory=dict)
    gaps: set[int] = field(default_factory=set)
    damage: list[Damage] = field(default_factory=list)

    def counted(self, path: Path) -> int | None:
        """How many messages metadata.yaml says that a file has, if it does."""
        for entry in self.information.get("files") or ():
            if isinstance(entry, dict) and entry.get("path") == path.name:
                return entry.get("message_count")
        return None


def find_files(path: str | Path) -> BagFiles:
    """The files of a bag.

    Parameters
    ----------
    path : str or Path
        Bag directory, or one of its files.

    Returns
    -------
    BagFiles

    Raises
    ------
    BagError
        If there is none.
    """
    path = Path(path)
    if not path.is_dir():
        return BagFiles([path])
    try:
        names = [entry.name for entry in os.scandir(path)]
    except OSError as error:
        raise BagError(f"{str(path)!r} cannot be read: {error.strerror}") from error
    files = [path / name for name in names if name.endswith(ENDINGS)]
    if not files:
        others = sorted(name for name in names if name.endswith((".db3", ".db3.zstd", ".bag")))
        if others:
            raise BagError(
                f"{str(path)!r} holds {others[0]!r}, which is not MCAP; `rosbags-convert --src "
                "BAG --dst NEW --dst-storage mcap` of the Python package rosbags makes MCAP of it"
            )
        raise BagError(f"{str(path)!r} holds no .mcap file")
    if len(files) > MAX_FILES:
        raise BagError(f"{str(path)!r} holds {len(files)} files; allowed: {MAX_FILES}")
    found = BagFiles(sorted(files, key=_place_in_bag))
    if METADATA in names:
        try:
            found.information = read_information(path)
        except BagError as error:
            found.damage.append(Damage(METADATA, 0, 0, str(error), {}))
        _compare_names(found)
    return found


def read_information(directory: Path) -> dict[str, Any]:
    """What a bag's metadata.yaml says, without its outermost key.

    Raises
    ------
    BagError
        If it cannot be read, or is something else.
    """
    shown = str(directory / METADATA)
    try:
        content = load_yaml(read_text(shown), shown)
    except TssError as error:
        raise BagError(str(error)) from None
    information = content.get("rosbag2_bagfile_information") if isinstance(content, dict) else None
    if not isinstance(information, dict):
        raise BagError(f"{shown!r} is not the metadata of a bag")
    for key in ("relative_file_paths", "files"):
        if not isinstance(information.setdefault(key, []), list | None):
            raise BagError(f"{shown!r}: {key} is no list")
    return information


def _compare_names(found):
    named = found.information.get("relative_file_paths") or []
    if not named:
        return
    # rosbag2 names the packed file or what it unpacks to, depending on its version.
    there = {name for p in found.paths for name in (p.name, p.name.removesuffix(".zstd"))}
    for name in map(str, named):
        if name not in there:
            reason = f"{name!r:.200} is named in {METADATA}, and is not there"
            found.damage.append(Damage(METADATA, 0, 0, reason, None))
            missing = _place_in_bag(Path(name))
            found.gaps.add(sum(_place_in_bag(path) < missing for path in found.paths))
    for path in found.paths:
        if not {path.name, path.name.removesuffix(".zstd")} & set(map(str, named)):
            reason = f"{path.name!r} is not named in {METADATA}"
            found.damage.append(Damage(path.name, 0, 0, reason, {}))


def _place_in_bag(path):
    number = re.search(r"_(\d+)\.mcap(\.zstd)?$", path.name)
    return int(number[1]) if number else -1, path.name


def lock(directory: str | Path) -> int:
    """Mark a bag as being written, until the returned file descriptor is closed.

    Raises
    ------
    BlockingIOError
        If another process has marked it.
    """
    descriptor = os.open(directory, os.O_RDONLY | os.O_DIRECTORY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(descriptor)
        raise
    except OSError:  # a file system without locks
        pass
    return descriptor


def sync_directory(directory: str | Path) -> None:
    """Make new and renamed files of a directory outlive a power cut."""
    descriptor = os.open(directory, os.O_RDONLY | os.O_DIRECTORY)
    try:
        with contextlib.suppress(OSError):  # some file systems do not sync directories
            os.fsync(descriptor)
    finally:
        os.close(descriptor)


def create(path: Path) -> BinaryIO:
    """Make a file anew and open it to be written; one left there before is removed, a link too.

    Raises
    ------
    FileExistsError
        If somebody else makes one meanwhile.
    """
    with contextlib.suppress(FileNotFoundError):
        path.unlink()
    return path.open("xb")
