"""Serialised ROS messages (CDR): made from values, and read and filled a column at a time."""

import struct
from typing import Any

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
#: What a message begins with: plain CDR, little-endian.
_LITTLE_ENDIAN = b"\0\1\0\0"


def stamp_ns(data: bytes, offset: int = 4) -> int:
    """Simulation time [ns] in the header stamp at `offset` of a message; never negative."""
    seconds, nanoseconds = struct.unpack_from(_byte_order(data) + "iI", data, offset)
    return max(0, seconds * 10**9 + nanoseconds)


def step_number(data: bytes) -> int:
    """The field `step` of serialised BeadStates or TetherStates: the uint64 after the header."""
    order = _byte_order(data)
    (frame_id_bytes,) = struct.unpack_from(order + "I", data, 12)
    return struct.unpack_from(order + "Q", data, _align(16 + frame_id_bytes, 8))[0]


def serialised(definition: str, values: dict[str, Any]) -> bytes:
    """A message of a type, little-endian.

    Parameters
    ----------
    definition : str
        The type as an MCAP schema of encoding "ros2msg" has it.
    values : dict
        By name of the field: numbers, texts, sequences of them, dicts for messages. Messages that
        consist of numbers of one kind, such as points and colours, may be rows of an array. Fields
        that are not named are zero or empty.

    Returns
    -------
    bytes

    Raises
    ------
    TssError
        If the type has no such field, or if a text has a zero byte.
    """
    data = bytearray(_LITTLE_ENDIAN)
    _put_message(Types(definition), "", values, data)
    return bytes(data)


class Layout:
    """Where the numbers of a message lie, for messages whose texts and array lengths are the same.

    The fields of messages within a message are named as in "header.stamp.sec" and
    "markers[0].color". Messages that consist of numbers of one kind, such as points and colours,
    count as arrays of them.

    Parameters
    ----------
    definition : str
        The type as an MCAP schema of encoding "ros2msg" has it.
    data : bytes
        The serialised message that shows the lengths.

    Raises
    ------
    TssError
        If the message does not fit the type, or if the type is not understood.
    """

    def __init__(self, definition: str, data: bytes) -> None:
        if len(data) < 4 or data[0] or data[1] > 1:
            raise TssError(f"a message begins with {data[:4].hex()}, which is no plain CDR")
        self._order, self._at = _byte_order(data), 4
        self._names, self._formats, self._offsets = [], [], []
        self._shape = np.zeros(len(data), dtype=bool)  # the bytes of texts and lengths
        self._types = Types(definition)
        try:
            self._place_message("", "", data)
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

    def copies(self, count: int) -> tuple[np.ndarray, np.ndarray]:
        """So many copies of the message, (count, bytes), and their numbers, to be filled in."""
        rows = np.empty((count, self._first.size), np.uint8)
        rows[:] = self._first
        return rows, rows.view(self._dtype)[:, 0]

    def _place_message(self, kind, name, data):
        for inner, field in self._types[kind]:
            self._place(inner, f"{name}.{field}" if name else field, data)

    def _place(self, kind, name, data):
        base, length = _parts(kind)
        if length == "":
            length = self._length(data)
        count = 1 if length is None else length
        if base == "string":
            for _ in range(count):
                size = self._length(data)
                self._shape[self._at : self._at + size] = True
                self._at += size
        elif number := self._types.number(base):
            item, items = np.dtype(self._order + number[0]), count * number[1]
            if items:
                self._at = _align(self._at, item.itemsize)
            self._names.append(name)
            single = length is None and base in _NUMBERS
            self._formats.append(item if single else (item, (items,)))
            self._offsets.append(self._at)
            self._at += items * item.itemsize
        else:
            for i in range(count):
                self._place_message(base, name if length is None else f"{name}[{i}]", data)
                if self._at > len(data):
                    break
        if self._at > len(data):
            raise struct.error

    def _length(self, data):
        self._at = _align(self._at, 4)
        (length,) = struct.unpack_from(self._order + "I", data, self._at)
        self._shape[self._at : self._at + 4] = True
        self._at += 4
        return length


class Types:
    """The fields, (type, name), of a type and of the types that it uses, by name; "" is itself.

    Parameters
    ----------
    definition : str
        As an MCAP schema of encoding "ros2msg" has it, or its first part alone.
    """

    def __init__(self, definition: str) -> None:
        self._fields, name = {"": []}, ""
        for line in definition.splitlines():
            words = line.partition("#")[0].split(maxsplit=2)
            if words[:1] == ["MSG:"]:
                name = words[1]
                self._fields[name] = []
            elif len(words) >= 2 and not ("=" in words[1] or "".join(words[2:]).startswith("=")):
                self._fields[name].append((words[0], words[1]))
        # A type may be used without its package's name.
        self._full = {full.rpartition("/")[2]: full for full in self._fields}

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Types) and self._fields == other._fields

    def __getitem__(self, name: str) -> list[tuple[str, str]]:
        full = name if name in self._fields else self._full.get(name)
        if full is None:
            raise TssError(f"a type uses {name!r}, which its definition lacks")
        return self._fields[full]

    @property
    def used(self) -> list[str]:
        """Types that its own fields have, but numbers and texts."""
        kinds = dict.fromkeys(_parts(kind)[0] for kind, _ in self._fields[""])
        return [kind for kind in kinds if kind not in _NUMBERS and kind != "string"]

    def number(self, base: str) -> tuple[str, int] | None:
        """(NumPy's name, count) of a type that is a number, or numbers of one kind; else None."""
        if base in _NUMBERS:
            return _NUMBERS[base], 1
        kinds = {kind for kind, _ in self[base]}
        if len(kinds) == 1 and (kind := kinds.pop()) in _NUMBERS:
            return _NUMBERS[kind], len(self[base])
        return None


def _put_message(types, kind, values, data):
    fields = types[kind]
    if unknown := values.keys() - {name for _, name in fields}:
        raise TssError(f"there is no field {sorted(unknown)[0]!r}; allowed: {fields}")
    for inner, name in fields:
        _put(types, inner, values.get(name), data)


def _put(types, kind, value, data):
    base, length = _parts(kind)
    number = None if base == "string" else types.number(base)
    if number and not (length is None and isinstance(value, dict)):
        per_item = number[1]
        count = 1 if length is None else length
        if value is None:
            value = [0] * (per_item * (count or 0))
        numbers = np.asarray(value, dtype="<" + number[0]).ravel()
        if length == "":
            _put_length(numbers.size // per_item, data)
        if numbers.size:
            _pad(data, numbers.itemsize)
        data += numbers.tobytes()
        return
    items = [value] if length is None else value if value is not None else ()
    if length == "":
        _put_length(len(items), data)
    for item in items:
        if base == "string":
            text = (item or "").encode() + b"\0"
            if b"\0" in text[:-1]:
                raise TssError(f"text {item!r:.100} has a zero byte")
            _put_length(len(text), data)
            data += text
        else:
            _put_message(types, base, item or {}, data)


def _put_length(count, data):
    _pad(data, 4)
    data += struct.pack("<I", count)


def _pad(data, size):
    data += bytes(_align(len(data), size) - len(data))


def _parts(kind):
    """Type without array, and its length: None for a single value, "" for a sequence, a number."""
    base, bracket, length = kind.partition("[")
    if not bracket:
        return base.partition("<=")[0], None
    length = length.rstrip("]")
    return base.partition("<=")[0], "" if not length or length.startswith("<=") else int(length)


def _byte_order(data):
    return "<" if data[1] & 1 else ">"


def _align(offset, size):
    # CDR aligns each number to its size, counted from after the 4 bytes that name the encoding.
    return 4 + -(-(offset - 4) // size) * size
