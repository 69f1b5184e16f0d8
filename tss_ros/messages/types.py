"""Message types as text: from packages that are installed, else as they are kept here."""

import functools
import json
import os
import re
from pathlib import Path

from tss_ros.core import TssError
from tss_ros.messages.cdr import Types

#: Types of recorded messages, without comments, for machines without ROS; `renew` renews them.
KEPT = Path(__file__).with_name("types.json")


def definition(type_name: str) -> str:
    """A type's text and, after it, that of each type it uses: MCAP's "ros2msg" schema.

    Parameters
    ----------
    type_name : str
        "package/msg/Type".

    Returns
    -------
    str

    Raises
    ------
    TssError
        If the type is neither installed nor kept.
    """
    if not _file(type_name, "msg"):
        return _kept(type_name)["definition"]
    texts, queue = {}, [type_name]
    while queue:
        name = queue.pop(0)
        if name not in texts:
            texts[name] = _file(name, "msg").read_text(encoding="utf-8")
            queue += [_full(used, name) for used in Types(texts[name]).used]
    root = texts.pop(type_name)
    parts = [
        f"{'=' * 80}\nMSG: {name.replace('/msg/', '/')}\n{text}" for name, text in texts.items()
    ]
    return "\n".join([root, *parts])


def type_hash(type_name: str) -> str:
    """The RIHS01 hash of a type, from the JSON file installed beside its definition.

    Parameters
    ----------
    type_name : str
        "package/msg/Type".

    Returns
    -------
    str

    Raises
    ------
    TssError
        If the type is neither installed nor kept.
    """
    path = _file(type_name, "json")
    if not path:
        return _kept(type_name)["hash"]
    hashes = json.loads(path.read_text(encoding="utf-8"))["type_hashes"]
    return next(h["hash_string"] for h in hashes if h["type_name"] == type_name)


def share(package: str) -> Path | None:
    """The folder share/<package> of an installed ROS package, or None."""
    for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep):
        folder = Path(prefix) / "share" / package
        if prefix and folder.is_dir():
            return folder
    return None


def renew(path: Path = KEPT) -> None:
    """Write what is installed of the types that are kept."""
    kept = {
        name: {
            "hash": type_hash(name),
            "definition": re.sub(r"\s*#.*|(?<=\n)\s+", "", definition(name)).lstrip(),
        }
        for name in _kept_types()
    }
    path.write_text(json.dumps(kept, indent=1) + "\n", encoding="utf-8")


@functools.cache
def _kept_types():
    return json.loads(KEPT.read_text(encoding="utf-8"))


def _kept(type_name):
    kept = _kept_types()
    if type_name not in kept:
        raise TssError(f"type {type_name!r} is not installed; known without ROS: {sorted(kept)}")
    return kept[type_name]


def _file(type_name, suffix):
    package, _, name = type_name.split("/")
    folder = share(package)
    path = folder and folder / "msg" / f"{name}.{suffix}"
    return path if path and path.is_file() else None


def _full(used, user):
    package, _, name = used.rpartition("/")
    return f"{package or user.split('/')[0]}/msg/{name}"
