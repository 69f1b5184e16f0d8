"""Files that users name: only such are read as cannot block or fill who reads them."""

import os
import stat
from pathlib import Path
from typing import BinaryIO

from tss_ros.core import TssError


def open_file(path: str | Path, most_bytes: int) -> BinaryIO:
    """Open a file for reading.

    Parameters
    ----------
    path : str or Path
    most_bytes : int
        Its largest size.

    Returns
    -------
    binary file

    Raises
    ------
    OSError
        If it cannot be opened.
    TssError
        If it is a pipe, a device or the like, or too large.
    """
    descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)  # a pipe would block
    stream = os.fdopen(descriptor, "rb")
    try:
        status = os.fstat(descriptor)
        if not stat.S_ISREG(status.st_mode):
            raise TssError("it is not a file; allowed: a regular file")
        if status.st_size > most_bytes:
            raise TssError(f"it has {status.st_size} bytes; allowed: at most {most_bytes}")
    except TssError:
        stream.close()
        raise
    return stream
