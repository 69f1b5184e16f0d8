"""Snapshots: the exact state of a simulation in a NumPy archive.

Its entries are `format_version`, `setup_*` (what the simulation must agree in), `place_*` (which
state it is), `integrator_*` (what the integrator remembers, see `checkpoint`) and `commands_*` (all
commands and failures in force and to come, see `commands`).
"""

import errno
import os
import struct
import zipfile
import zlib

import numpy as np

from tss_ros.core import TssError
from tss_ros.scenarios.files import open_regular
from tss_ros.simulator.checkpoint import Checkpoint

#: Raised whenever entries change. Version 1 had no number and the integrator's own names.
FORMAT_VERSION = 5
#: Arrays of commands: which share their length k, the shape of each of k, and its type.
_COMMANDS = {
    "when_and_where": ("commands", (3,), np.int64),
    "force_n": ("commands", (3,), float),
    "failures": ("failures", (4,), np.int64),
    "held": ("failures", (9,), float),
    "due": ("declared", (), bool),
    "reel_heads": ("reel commands", (5,), np.int64),
    "reel_limits": ("reel commands", (3,), float),
    "reel_points": ("points", (3,), float),
    "reel_since_ns": ("reels", (), np.int64),
    "reel_cubic": ("reels", (4,), float),
    "law_left": ("laws", (), np.int64),
}
#: What the entries of a snapshot may need besides their numbers [B].
MORE_BYTES = 2**20
#: What reading an archive raises, whatever it holds.
_UNREADABLE = (OSError, ValueError, TypeError, LookupError, EOFError, RuntimeError, MemoryError)
_UNREADABLE += (struct.error, zlib.error, zipfile.BadZipFile, SyntaxError)


def write(
    file: str,
    identity: dict[str, np.ndarray],
    place: dict[str, int],
    checkpoint: Checkpoint,
    commands: dict[str, np.ndarray],
) -> None:
    """Write a snapshot.

    Parameters
    ----------
    file : str
        Path ending in .npz of a file to be made.
    identity : dict of str to ndarray
        What must be equal where the snapshot is to be restored.
    place : dict of str to int
        `index` of the state that is kept, `base_ns`, the time [ns] of index 0, and `since_ns`, the
        same for the axes of forces from outside.
    checkpoint : Checkpoint
        Not later than that state.
    commands : dict of str to ndarray
        `CommandTable.arrays`, `due` of the watch for failures, and `law_left` of the law of reels.

    Raises
    ------
    TssError
        If there is such a file already, or if it cannot be made.
    """
    content = {f"setup_{name}": value for name, value in identity.items()}
    content |= {f"integrator_{name}": value for name, value in checkpoint.arrays.items()}
    content |= {f"place_{name}": value for name, value in place.items()}
    content |= {f"commands_{name}": value for name, value in commands.items()}
    try:
        with open(_checked(file), "xb") as stream:
            np.savez(
                stream,
                format_version=FORMAT_VERSION,
                place_from_index=checkpoint.index,
                **content,
            )
    except FileExistsError:
        raise TssError(f"snapshot {file!r:.200} exists already; allowed: a new file") from None
    except (OSError, ValueError) as error:
        raise TssError(f"snapshot {file!r:.200} cannot be written: {_reason(error)}") from None


def read(
    file: str, identity: dict[str, np.ndarray], like: Checkpoint, furthest: int
) -> tuple[dict[str, int], Checkpoint, dict[str, np.ndarray]]:
    """Read a snapshot and check that it fits.

    Parameters
    ----------
    file : str
    identity : dict of str to ndarray
        What must be equal in it.
    like : Checkpoint
        One of the same system.
    furthest : int
        Most states between a checkpoint and the state that is kept.

    Returns
    -------
    tuple of dict, Checkpoint and dict
        As they were given to `write`.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    TssError
        If it is no snapshot, or one of another version or another system.
    """
    if not os.path.lexists(_checked(file)):
        raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), file)
    most = MORE_BYTES + sum(
        np.asarray(array).nbytes for array in (*identity.values(), *like.arrays.values())
    )
    try:
        with open_regular(file) as stream, zipfile.ZipFile(stream) as packed:
            size = sum(member.file_size for member in packed.infolist())
            if size > most:
                raise ValueError(f"it would unpack to {size} bytes; allowed here: {most}")
            with np.load(stream, allow_pickle=False) as archive:
                content = {name: archive[name] for name in archive.files}
    except _UNREADABLE as error:
        raise TssError(f"snapshot {file!r:.200} cannot be read: {_reason(error)}") from None
    version = content.get("format_version", 1)
    if not np.array_equal(version, FORMAT_VERSION):
        raise TssError(
            f"snapshot {file!r:.200} has format version {version!s:.20}; allowed: {FORMAT_VERSION}"
        )
    for name, value in identity.items():
        if not np.array_equal(content.get(f"setup_{name}"), value):
            raise TssError(
                f"snapshot {file!r:.200} is of a simulation with another {name}; "
                "set the parameters as they were and reset first"
            )
    arrays = {name: content.get(f"integrator_{name}") for name in like.arrays}
    names = ("index", "base_ns", "since_ns", "from_index")
    numbers = [content.get(f"place_{name}") for name in names]
    commands = {name: content.get(f"commands_{name}") for name in _COMMANDS}
    counts = {_COMMANDS[name][0]: np.shape(array)[:1] for name, array in commands.items()}
    whole = all(_fits(array, like.arrays[name]) for name, array in arrays.items())
    for name, (group, shape, kind) in _COMMANDS.items():
        whole &= _fits(commands[name], np.empty((*counts[group], *shape), kind))
    if not (whole and all(_fits(number, np.array(0)) for number in numbers)):
        raise TssError(f"snapshot {file!r:.200} is damaged")
    index, base_ns, since_ns, from_index = map(int, numbers)
    if not 0 <= from_index <= index <= from_index + furthest:
        raise TssError(f"snapshot {file!r:.200} is damaged")
    place = {"index": index, "base_ns": base_ns, "since_ns": since_ns}
    return place, Checkpoint(from_index, arrays), commands


def _fits(array, like):
    same = array is not None and (array.shape, array.dtype) == (like.shape, like.dtype)
    return same and bool(np.isfinite(array).all())


def _checked(file):
    if not file.endswith(".npz"):
        raise TssError(f"file is {file!r:.200}; allowed: a path that ends in .npz")
    return file


def _reason(error):
    return getattr(error, "strerror", None) or " ".join(str(error).split()) or "it is cut short"
