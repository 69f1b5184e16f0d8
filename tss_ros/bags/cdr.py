"""Numbers straight from serialised ROS messages (CDR): one at a time, or whole columns of them."""

import struct

import numpy as np

from tss_ros.core import TssError

_NUMBERS = {
    **{
        f"{kind}{bits}": f"{kind[0]}{bits // 8}"
        for kind in ("int", "uint")
        for bits in (8, 16, 32, 64)
    },
    **{"float32": "f4", "float64": "f8", "bool": "u1", "byte": "u1", "char": "u1"},
}
#: The fields of std_msgs/Header, written out.
_HEADER = (("int32", "stamp.sec"), ("uint32", "stamp.nanosec"), ("string", "frame_id"))


def stamp_ns(data: bytes, offset: int = 4) -> int:
    """Simulation time [ns] in the header stamp at `offset` of a message; never negative."""
    seconds, nanoseconds = struct.unpack_from(_byte_order(data) + "iI", data, offset)
    return max(0, seconds * 10**9 + nanoseconds)


def step_number(data: bytes) -> int:
    """The field `step` of serialised BeadStates or TetherStates: the uint64 after the header."""
    order = _byte_order(data)
    (frame_id_bytes,) = struct.unpack_from(order + "I", data, 12)
    return struct.unpack_from(order + "Q", data, _align(16 + frame_id_bytes, 8))[0]


class Layout:
    """Where the numbers of a message lie, for messages whose texts and array lengths are the same.

    Parameters
    ----------
    definition : str
        The type as an MCAP schema of encoding "ros2msg" has it. Its fields may be numbers, texts,
        headers, and sequences of numbers and texts.
    data : bytes
        The serialised message that shows the lengths.

    Raises
    ------
    TssError
        If the type has other fields, or if the message does not fit the type.
    """

    def __init__(self, definition: str, data: bytes) -> None:
        if len(data) < 4 or data[0] or data[1] > 1:
            raise TssError(f"a message begins with {data[:4].hex()}, which is no plain CDR")
        self._order, self._at = _byte_order(data), 4
        self._names, self._formats, self._offsets = [], [], []
        self._shape = np.zeros(len(data), dtype=bool)  # the bytes of texts and lengths
        try:
            for kind, name in _fields(definition):
                self._place(kind, name, data)
        except struct.error:
            raise TssError("a message does not fit the type it is said to have") from None
        # Serialisers may leave anything in the padding and behind the last field.
        self._first = np.frombuffer(data, np.uint8, self._at)
        self._shape = np.flatnonzero(self._shape)
        self._dtype = np.dtype(
            {
                "names": self._names,
                "formats": self._formats,
                "offsets": self._offsets,
                "itemsize": self._at,
            }
        )

    @property
    def names(self) -> tuple[str, ...]:
        """The fields that are numbers."""
        return tuple(self._names)

    def fits(self, rows: np.ndarray) -> np.ndarray:
        """Which messages of `rows`, (k, bytes), have these texts and lengths; (k,) of bool."""
        if rows.shape[1] < self._first.size:
            return np.zeros(len(rows), dtype=bool)
        return (rows[:, self._shape] == self._first[self._shape]).all(axis=1)

    def numbers(self, rows: np.ndarray) -> np.ndarray:
        """The numbers of messages that fit: a structured array, shape (k,)."""
        return np.ascontiguousarray(rows[:, : self._first.size]).view(self._dtype)[:, 0]

    def _place(self, kind, name, data):
        if kind in ("string", "string[]"):
            for _ in range(self._length(data) if kind == "string[]" else 1):
                length = self._length(data)
                self._shape[self._at : self._at + length] = True
                self._at += length
        else:
            base, is_sequence = kind.removesuffix("[]"), kind.endswith("[]")
            if base not in _NUMBERS:
                raise TssError(f"field {name!r} has type {kind!r}, which cannot be read in bulk")
            count = self._length(data) if is_sequence else 1
            item = np.dtype(self._order + _NUMBERS[base])
            if count:
                self._at = _align(self._at, item.itemsize)
            self._names.append(name)
            self._formats.append((item, (count,)) if is_sequence else item)
            self._offsets.append(self._at)
            self._at += count * item.itemsize
        if self._at > len(data):
            raise struct.error

    def _length(self, data):
        self._at = _align(self._at, 4)
        (length,) = struct.unpack_from(self._order + "I", data, self._at)
        self._shape[self._at : self._at + 4] = True
        self._at += 4
        return length


def _fields(definition):
    """(type, name) of each field of a type's own definition, headers written out."""
    root = definition.split("=" * 80)[0]
    lines = (line.partition("#")[0].split(maxsplit=2) for line in root.splitlines())
    for kind, name, *more in (line for line in lines if len(line) >= 2):
        if "=" in name or (more and more[0].startswith("=")):
            continue  # a constant
        if kind == "std_msgs/Header":
            yield from _HEADER
        else:
            yield kind, name


def _byte_order(data):
    return "<" if data[1] & 1 else ">"


def _align(offset, size):
    # CDR aligns each number to its size, counted from after the 4 bytes that name the encoding.
    return 4 + -(-(offset - 4) // size) * size
