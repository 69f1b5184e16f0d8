"""Snapshots: the exact state of a simulation in a NumPy archive.

Its entries are `format_version`, `setup_*` (what the simulation must agree in), `place_*` (which
state it is) and `integrator_*` (what the integrator remembers, see `checkpoint`).
"""

import zipfile

import numpy as np

from tss_ros.core import TssError
from tss_ros.scenarios.files import open_file
from tss_ros.simulator.checkpoint import Checkpoint

#: Raised whenever entries change. Version 1 had no number and the integrator's own names.
FORMAT_VERSION = 3
#: Largest size [bytes] of a snapshot, packed and unpacked; one of 1000 beads has a few million.
MOST_BYTES = 100_000_000


def write(
    file: str, identity: dict[str, np.ndarray], place: dict[str, int], checkpoint: Checkpoint
) -> None:
    """Write a snapshot.

    Parameters
    ----------
    file : str
        Path ending in .npz of a file to be made.
    identity : dict of str to ndarray
        What must be equal where the snapshot is to be restored.
    place : dict of str to int
        `index` of the state that is kept, and `base_ns`, the time [ns] of index 0.
    checkpoint : Checkpoint
        Not later than that state.

    Raises
    ------
    TssError
        If there is such a file already, or if it cannot be made.
    """
    content = {f"setup_{name}": value for name, value in identity.items()}
    content |= {f"integrator_{name}": value for name, value in checkpoint.arrays.items()}
    content |= {f"place_{name}": value for name, value in place.items()}
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
) -> tuple[dict[str, int], Checkpoint]:
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
    tuple of dict and Checkpoint
        As they were given to `write`.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    TssError
        If it is no snapshot, or one of another version or another system.
    """
    try:
        with open_file(_checked(file), MOST_BYTES) as stream:
            content = _unpack(stream)
    except FileNotFoundError:
        raise
    except (OSError, ValueError, EOFError, MemoryError, zipfile.BadZipFile) as error:
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
    numbers = [content.get(f"place_{name}") for name in ("index", "base_ns", "from_index")]
    whole = all(_fits(array, like.arrays[name]) for name, array in arrays.items())
    if not (whole and all(_fits(number, np.array(0)) for number in numbers)):
        raise TssError(f"snapshot {file!r:.200} is damaged")
    index, base_ns, from_index = map(int, numbers)
    if not 0 <= from_index <= index <= from_index + furthest:
        raise TssError(f"snapshot {file!r:.200} is damaged")
    return {"index": index, "base_ns": base_ns}, Checkpoint(from_index, arrays)


def _unpack(stream):
    with zipfile.ZipFile(stream) as archive:
        if (size := sum(entry.file_size for entry in archive.infolist())) > MOST_BYTES:
            raise TssError(f"it holds {size} bytes; allowed: at most {MOST_BYTES}")
    stream.seek(0)
    with np.load(stream, allow_pickle=False) as arrays:
        return {name: arrays[name] for name in arrays.files}


def _fits(array, like):
    same = array is not None and (array.shape, array.dtype) == (like.shape, like.dtype)
    return same and bool(np.isfinite(array).all())


def _checked(file):
    if not file.endswith(".npz"):
        raise TssError(f"file is {file!r:.200}; allowed: a path that ends in .npz")
    return file


def _reason(error):
    return getattr(error, "strerror", None) or " ".join(str(error).split()) or "it is cut short"
