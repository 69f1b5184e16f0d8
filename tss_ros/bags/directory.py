"""A bag's directory: marked as being written, and safe on the disk."""

import contextlib
import fcntl
import os
from pathlib import Path
from typing import BinaryIO


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
