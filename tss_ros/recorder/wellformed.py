"""Whether a serialised message is one of its type: what a recorder asks before it keeps it."""

import contextlib
import functools
from collections.abc import Callable

import numpy as np

from tss_ros.core import TssError
from tss_ros.ros.topics import base_type, message_class

#: Bytes of the numbers of messages, by the names that ROS's Python classes have for them.
_SIZES = {
    **{f"{sign}int{8 * size}": size for sign in ("", "u") for size in (1, 2, 4, 8)},
    **{"boolean": 1, "octet": 1, "char": 1, "byte": 1, "float": 4, "double": 8},
}
#: Shapes of messages that are remembered for each type: one for each of so many lengths.
SHAPES = 200
#: Most bytes behind the last field: serialisers make room for up to 4 before each empty sequence of
#: doubles, and fill messages up to a multiple of 8 or so.
PADDING = 16


class Malformed(TssError):
    """A message is none of its type."""


class Form:
    """The form of a type's messages.

    Messages of one topic hardly differ but in their numbers. So the places of texts and lengths are
    found once, and compared from then on.

    Parameters
    ----------
    type_name : str
        "package/msg/Type".
    """

    def __init__(self, type_name: str) -> None:
        self._type_name = type_name
        self._read = _reader(type_name)
        self._shapes = {}

    def check(self, data: bytes) -> None:
        """Raise Malformed, with the reason, if this is no message of the type."""
        known = self._shapes.get(len(data))
        if known and np.frombuffer(data, np.uint8)[known[0]].tobytes() == known[1]:
            return
        if data[:2] not in (b"\0\0", b"\0\1"):
            raise Malformed(f"{self._type_name}: it begins with {data[:2].hex()!r}, as no CDR does")
        walk = _Walk(data)
        try:
            self._read(walk)
        except Malformed as error:
            raise Malformed(f"{self._type_name}: {error}") from None
        if len(data) - walk.at > PADDING:
            surplus = len(data) - walk.at
            raise Malformed(f"{self._type_name}: {surplus} bytes stand behind its last field")
        if len(self._shapes) >= SHAPES:
            self._shapes.clear()
        places = np.concatenate([np.arange(0, 2), *(np.arange(*part) for part in walk.shape)])
        self._shapes[len(data)] = places, np.frombuffer(data, np.uint8)[places].tobytes()


class _Walk:
    """A place in a message, and where the texts and lengths before it are."""

    def __init__(self, data):
        self.data, self.at, self.shape = data, 4, []
        self._order = "little" if data[1] else "big"

    def skip(self, size, count=1):
        """Go over so many numbers."""
        if count:
            # CDR aligns each number to its size, counted from after the first 4 bytes.
            self.at = 4 + -(-(self.at - 4) // size) * size + size * count
            self._check()

    def length(self):
        """Read a length."""
        self.skip(4)
        self.shape.append((self.at - 4, self.at))
        return int.from_bytes(self.data[self.at - 4 : self.at], self._order)

    def text(self):
        """Go over a text."""
        size = self.length()
        begin, self.at = self.at, self.at + size
        self._check()
        if size:
            self.shape.append((begin, self.at))
            self._check_text(self.data[begin : self.at])

    def _check_text(self, text):
        with contextlib.suppress(UnicodeDecodeError):
            if text.decode() and text.find(b"\0") == len(text) - 1:
                return
        raise Malformed(f"{text[:40]!r} is no text")

    def _check(self):
        if self.at > len(self.data):
            raise Malformed(f"it ends after {len(self.data)} bytes, too early")


@functools.cache
def _reader(type_name: str) -> Callable[[_Walk], None]:
    """What goes over a message of a type."""
    fields = message_class(type_name).get_fields_and_field_types().values()
    parts = [_field(field) for field in fields]

    def read(walk):
        for part in parts:
            part(walk)

    return read


def _field(field):
    """What goes over a field, whose type is written as in "sequence<geometry_msgs/Point, 3>"."""
    if field.startswith("sequence<"):
        return _many(field.removeprefix("sequence<").rstrip(">").split(",")[0], None)
    if field.endswith("]"):
        inner, _, count = field.rstrip("]").partition("[")
        return _many(inner, int(count))
    if "/" in field:
        return _reader(base_type(field))
    if field.startswith("string"):
        return _Walk.text
    size = _SIZES[field]
    return lambda walk: walk.skip(size)


def _many(inner, count):
    """What goes over an array, or over a sequence where `count` is None."""
    if inner in _SIZES:
        size = _SIZES[inner]
        return lambda walk: walk.skip(size, walk.length() if count is None else count)
    one = _field(inner)

    def read(walk):
        for _ in range(walk.length() if count is None else count):
            one(walk)

    return read
