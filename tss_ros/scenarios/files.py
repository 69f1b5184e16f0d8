"""Files as others hand them over: regular ones only, of a bounded size, in plain YAML."""

import os
import re
import stat
from collections.abc import Collection
from pathlib import Path
from typing import Any, BinaryIO

import yaml

from tss_ros.core import TssError
from tss_ros.core.errors import allowed_words

#: Bounds of a YAML text: bytes, levels of lists and mappings, values with aliases written out, and
#: digits of a number.
MAX_TEXT_BYTES, MAX_DEPTH, MAX_NODES, MAX_DIGITS = 4 * 2**20, 50, 1_000_000, 100
_KINDS = (
    (stat.S_ISDIR, "a directory"),
    (stat.S_ISFIFO, "a FIFO"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
)
_NUMBER = re.compile(r"[-+.:_0-9a-fA-FxXoO]+")
#: What PyYAML raises at what it cannot take.
_INVALID = (yaml.YAMLError, ValueError, TypeError, LookupError, AttributeError, OverflowError)


class _Loader(getattr(yaml, "CSafeLoader", yaml.SafeLoader)):
    """PyYAML's loader, which would let the last one of duplicate keys win."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict:
        """The mapping of a node; refuses a key that comes twice."""
        seen = set()
        for key, _ in node.value:
            if isinstance(key, yaml.ScalarNode) and key.tag != "tag:yaml.org,2002:merge":
                if key.value in seen:
                    line = key.start_mark.line + 1
                    raise ValueError(f"duplicate key {key.value!r:.80} in line {line}")
                seen.add(key.value)
        return super().construct_mapping(node, deep)


# PyYAML takes 1e3 for a text, ROS for a number.
_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(r"[-+]?(\d+\.?\d*|\.\d+)[eE][-+]?\d+$"),
    list("-+.0123456789"),
)


def open_regular(path: str | Path, follow: bool = True) -> BinaryIO:
    """Open a file to be read, if it is a regular one; never wait for what is none.

    Parameters
    ----------
    path : str or Path
    follow : bool
        Whether it may be a link to a regular file.

    Returns
    -------
    file object

    Raises
    ------
    TssError
        If it is something else, or if it cannot be read.
    """
    flags = os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC | (0 if follow else os.O_NOFOLLOW)
    try:
        descriptor = os.open(path, flags)
    except (OSError, ValueError) as error:  # a name with a zero byte in it
        reason = getattr(error, "strerror", None) or str(error)
        if not follow and os.path.islink(path):
            reason = "it is a link"
        raise TssError(f"{str(path)!r} cannot be read: {reason}") from None
    mode = os.fstat(descriptor).st_mode
    if not stat.S_ISREG(mode):
        os.close(descriptor)
        kind = next((words for is_kind, words in _KINDS if is_kind(mode)), "no file")
        raise TssError(f"{str(path)!r} is {kind}; allowed: a regular file")
    return open(descriptor, "rb")


def read_text(path: str | Path) -> str:
    """The text of a regular file.

    Raises
    ------
    TssError
        If it is none, is too large or is no text.
    """
    with open_regular(path) as stream:
        try:
            content = stream.read(MAX_TEXT_BYTES + 1)
        except OSError as error:
            raise TssError(f"{str(path)!r} cannot be read: {error.strerror}") from None
    if len(content) > MAX_TEXT_BYTES:
        raise TssError(f"{str(path)!r} is too large; allowed: {MAX_TEXT_BYTES} bytes")
    try:
        return content.decode()
    except UnicodeDecodeError:
        raise TssError(f"{str(path)!r} cannot be read: it is not text") from None


def load_yaml(text: str, what: str) -> Any:
    """The content of a YAML text whose size, nesting and repetitions are within bounds.

    Parameters
    ----------
    text : str
    what : str
        Names the text in errors.

    Returns
    -------
    dict, list, str, number, bool or None

    Raises
    ------
    TssError
        If it is not valid, or beyond the bounds.
    """
    if len(text) > MAX_TEXT_BYTES:
        raise TssError(f"{what} is too large; allowed: {MAX_TEXT_BYTES} characters")
    try:
        _check_events(text, what)
        return yaml.load(text, Loader=_Loader)
    except TssError:
        raise
    except _INVALID as error:
        raise TssError(f"{what} is not valid YAML: {' '.join(str(error).split())}") from None


def _check_events(text, what):
    """Refuse what would grow beyond bounds: depth, long numbers, parts that repeat parts."""
    anchors, sizes = {}, [0]  # nodes behind each anchor; of the collections that are open
    open_anchors = []
    for event in yaml.parse(text, Loader=_Loader):
        if isinstance(event, yaml.CollectionStartEvent):
            sizes.append(1)
            open_anchors.append(event.anchor)
        elif isinstance(event, yaml.CollectionEndEvent):
            size = sizes.pop()
            sizes[-1] += size
            anchors[open_anchors.pop()] = size
        elif isinstance(event, yaml.AliasEvent):
            if event.anchor not in anchors:
                raise TssError(f"{what} repeats a part inside of itself (*{event.anchor})")
            sizes[-1] += anchors[event.anchor]
        elif isinstance(event, yaml.ScalarEvent):
            sizes[-1] += 1
            anchors[event.anchor] = 1
            if len(event.value) > MAX_DIGITS and _NUMBER.fullmatch(event.value):
                raise TssError(f"{what} has a number of {len(event.value)} digits")
        if len(sizes) > MAX_DEPTH:
            raise TssError(f"{what} nests deeper than {MAX_DEPTH} levels")
        if sizes[-1] > MAX_NODES:
            raise TssError(f"{what} repeats parts by aliases to more than {MAX_NODES} values")


def check_keys(
    where: str, entry: object, needed: Collection[str], optional: Collection[str] = ()
) -> None:
    """Refuse what is no mapping, has a key that is not known, or lacks one that is needed."""
    if not isinstance(entry, dict):
        raise TssError(f"{where} must be a mapping, got {entry!r}")
    known = sorted({*needed, *optional})
    for key in entry:
        if key not in known:
            raise TssError(f"{where} has {key!r}{allowed_words(key, known)}")
    for key in sorted(needed):
        if key not in entry:
            raise TssError(f"{where} lacks {key}")
