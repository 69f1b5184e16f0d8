"""Arguments held against type hints, and single values against bounds: a wrong one is named."""

import collections.abc
import functools
import inspect
import math
import numbers as numeric
import types
import typing
from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np

from tss_ros.core.errors import TssError

Function = TypeVar("Function", bound=Callable[..., Any])


def checked(function: Function) -> Function:
    """The function, which refuses arguments that are not what its type hints say.

    What is to be an array may be anything that numpy makes an array of numbers of.

    Parameters
    ----------
    function : callable
        With type hints.

    Returns
    -------
    callable

    Raises
    ------
    TssError
        When called: naming the argument, its value and what is allowed.
    """
    signature = inspect.signature(function)

    @functools.cache
    def hints():
        return typing.get_type_hints(function)

    @functools.wraps(function)
    def call(*args, **kwargs):
        try:
            given = signature.bind(*args, **kwargs)
        except TypeError:
            return function(*args, **kwargs)  # Python's own words name the function as well
        for name, value in given.arguments.items():
            kind = signature.parameters[name].kind
            if name not in hints() or kind is inspect.Parameter.VAR_POSITIONAL:
                continue
            if kind is inspect.Parameter.VAR_KEYWORD:
                for word, one in value.items():
                    _checked_value(word, one, hints()[name])
            else:
                given.arguments[name] = _checked_value(name, value, hints()[name])
        return function(*given.args, **given.kwargs)

    return typing.cast(Function, call)


def _checked_value(name, value, hint):
    """The value, an array where that is what is allowed."""
    kinds = _kinds(hint)
    if any(_is(value, kind) for kind in kinds):
        return value
    if np.ndarray in kinds and (array := _array(value)) is not None:
        return array
    allowed = " or ".join(dict.fromkeys(_in_words(kind) for kind in kinds))
    shown = value if isinstance(value, str | int | float | None) else _Shown(value)
    raise TssError(f"{name} must be {allowed}, got {shown!r:.80}")


class _Shown:
    """Another thing, in one line that begins with what it is."""

    def __init__(self, value):
        self.text = f"{type(value).__name__} {value!r}".replace("\n", " ")

    def __repr__(self):
        return self.text


def _kinds(hint):
    """The kinds that a hint allows, one by one."""
    if typing.get_origin(hint) in (typing.Union, types.UnionType):
        return typing.get_args(hint)
    return (hint,)


def _is(value, kind):
    """Whether a value is of a kind."""
    whole = typing.get_origin(kind) or kind
    if whole in (Any, object):
        return True
    if whole is collections.abc.Callable:
        return callable(value)
    if whole in (float, int):
        number = numeric.Real if whole is float else numeric.Integral
        if isinstance(value, np.ndarray) and value.ndim == 0:
            value = value[()]
        return isinstance(value, number) and not isinstance(value, bool)
    if whole is bool:
        return isinstance(value, bool | np.bool_)
    if not isinstance(value, whole):
        return False
    parts = typing.get_args(kind)
    if whole is tuple and parts and Ellipsis not in parts:
        return len(value) == len(parts) and all(map(_is, value, parts))
    if whole in (collections.abc.Sequence, tuple, list):
        return not isinstance(value, str) and all(
            any(_is(one, kind) for kind in _kinds(part)) for part in parts[:1] for one in value
        )
    return True


def _array(value):
    """The value as an array of real numbers, None if it is none."""
    try:
        array = np.asarray(value)
    except ValueError:
        return None
    return array if array.dtype.kind in "fiu" else None


_WORDS = {
    float: "a number", int: "a whole number", str: "a text", bool: "True or False",
    np.ndarray: "an array of numbers", type(None): "None",
    collections.abc.Callable: "a function",
}  # fmt: skip


def _in_words(kind):
    whole = typing.get_origin(kind) or kind
    if whole in _WORDS:
        return _WORDS[whole]
    if whole in (collections.abc.Sequence, collections.abc.Iterable, collections.abc.Mapping):
        parts = [_in_words(part).split(" ", 1)[-1] for part in typing.get_args(kind)[:1]]
        return _one(whole.__name__.lower()) + (f" of {parts[0]}s" if parts else "")
    return _one(whole.__name__)


def _one(noun):
    return f"{'an' if noun[0] in 'AEIOUaeiou' else 'a'} {noun}"


def numbers(name: str, values: object, kind: type | None = float) -> np.ndarray:
    """Return `values` as an array of numbers, itself if it is one.

    Raises
    ------
    TssError
        Naming the thing and its value.
    """
    try:
        array = np.asarray(values)
        if array.dtype.kind in "USb":  # text and truth values, which numpy would make numbers of
            raise TypeError
        return np.asarray(array, dtype=kind)
    except (TypeError, ValueError):
        shown = f"{values!r:.80}".replace("\n", " ")
        raise TssError(f"{name} must be an array of numbers, got {shown}") from None


def unit_vector(name: str, value: object) -> np.ndarray:
    """Return a vector of any length but zero as one of length 1, read-only.

    Raises
    ------
    TssError
        Naming the thing, its value and what is allowed.
    """
    vector = numbers(name, value)
    if vector.shape != (3,) or not np.isfinite(vector).all():
        raise TssError(f"{name} must be three finite numbers x, y, z, got {value!r:.80}")
    largest = np.max(np.abs(vector))
    if not largest:
        raise TssError(f"{name} must have a length above 0, got [0, 0, 0]")
    vector = vector / largest
    vector = vector / np.linalg.norm(vector)
    vector.flags.writeable = False
    return vector


def finite(
    name: str, value: object, above: float | None = None, at_least: float | None = None
) -> float:
    """Return `value` as a finite float within its bounds.

    Raises
    ------
    TssError
        Naming the thing, its value and what is allowed.
    """
    try:
        if isinstance(value, str | bytes | bool | np.bool_):
            raise TypeError
        number = float(value)
    except (TypeError, ValueError):
        raise TssError(f"{name} must be a number, got {value!r:.80}") from None
    if not math.isfinite(number):
        raise TssError(f"{name} must be a finite number, got {number}")
    if above is not None and not number > above:
        raise TssError(f"{name} must be greater than {above:g}, got {number:g}")
    if at_least is not None and not number >= at_least:
        raise TssError(f"{name} must be at least {at_least:g}, got {number:g}")
    return number
