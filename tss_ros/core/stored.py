"""Results as .npz files, which numpy reads as well: every number comes back bit for bit."""

import json
import typing
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import MISSING, fields, is_dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from tss_ros.core.errors import TssError

Kind = TypeVar("Kind", bound="Stored")
#: What says which class a file is of.
KIND = "tss_ros"
_BROKEN = (zipfile.BadZipFile, zlib.error)


class Stored:
    """A result that is saved and loaded; its dataclass says of which parts it consists."""

    def save(self, path: str | Path) -> None:
        """Write the result to an .npz file, which appears as a whole.

        Parameters
        ----------
        path : str or Path

        Raises
        ------
        OSError
            If it cannot be written.
        """
        path = Path(path)
        new = path.with_name(f".{path.name}.new")
        try:
            with new.open("wb") as file:
                np.savez_compressed(file, **{KIND: type(self).__name__}, **_parts(type(self), self))
            new.replace(path)
        finally:
            new.unlink(missing_ok=True)

    @classmethod
    def load(cls: type[Kind], path: str | Path) -> Kind:
        """A result that `save` wrote.

        Parameters
        ----------
        path : str or Path

        Raises
        ------
        TssError
            If there is no such file, or it holds no such result.
        """
        words = f"{cls.__name__} {str(path)!r} cannot be read"
        try:
            with np.load(path, allow_pickle=False) as archive:
                parts = dict(archive)
        except (OSError, ValueError, EOFError, TypeError, *_BROKEN) as error:
            reason = getattr(error, "strerror", None) or "it is no .npz file"
            raise TssError(f"{words}: {reason}") from None
        if (kind := str(parts.get(KIND, "nothing of tss_ros"))) != cls.__name__:
            raise TssError(f"{words}: it holds {kind}")
        try:
            return _made(cls, parts, "")
        except KeyError as error:
            raise TssError(f"{words}: it lacks {error}") from None


def _parts(kind, thing, prefix=""):
    """Arrays by name of all fields of a dataclass, those of fields that are dataclasses too."""
    parts, hints = {}, typing.get_type_hints(kind)
    for field in fields(kind):
        value, name = getattr(thing, field.name), prefix + field.name
        if is_dataclass(hints[field.name]):
            parts |= _parts(hints[field.name], value, f"{name}.")
        else:
            parts[name] = np.array(
                json.dumps(dict(value)) if isinstance(value, Mapping) else value,
                dtype=str if typing.get_origin(hints[field.name]) is tuple else None,
            )
    return parts


def _made(kind, parts, prefix):
    """A dataclass from the arrays of its fields."""
    values, hints = {}, typing.get_type_hints(kind)
    for field in fields(kind):
        hint, name = hints[field.name], prefix + field.name
        if name not in parts and field.default_factory is not MISSING:
            continue  # a field that files of older releases do not have
        values[field.name] = (
            _made(hint, parts, f"{name}.") if is_dataclass(hint) else _value(hint, parts[name])
        )
    return kind(**values)


def _value(hint: Any, array: np.ndarray) -> Any:
    if hint is np.ndarray:
        return array
    if typing.get_origin(hint) is tuple:
        return tuple(array.tolist())
    return array.item() if isinstance(hint, type) else json.loads(str(array))
