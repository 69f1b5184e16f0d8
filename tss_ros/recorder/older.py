"""Messages of earlier revisions as those of today, so that their bags can be played."""

import re
from collections.abc import Callable
from typing import Any

from mcap.records import Schema

from tss_ros.bags.older import UNSAID
from tss_ros.bags.reader import decoded
from tss_ros.bags.records import BagError
from tss_ros.messages.types import definition
from tss_ros.ros.topics import base_type, message_class, used_types


def converter(schema: Schema) -> Callable[[bytes], Any]:
    """What makes messages of a bag publishable.

    Parameters
    ----------
    schema : mcap.records.Schema
        Their type as the bag has it.

    Returns
    -------
    callable
        Of a serialised message: the same, or, where the type of this package was another when the
        bag was made, a message of today's.
    """
    known = schema.name.startswith("tss_interfaces/") and schema.encoding == "ros2msg"
    if not known or not schema.data.strip():
        return lambda data: data
    if _bare(schema.data.decode(errors="replace")) == _bare(definition(schema.name)):
        return lambda data: data

    def renew(data):
        try:
            return _renewed(schema.name, decoded(schema, data))
        except (TypeError, AssertionError, OverflowError, ValueError) as error:
            raise BagError(f"a message of {schema.name} is not one: {error}") from error

    return renew


def _renewed(type_name, decoded):
    """A message with the fields of a decoded one; fields that it lacks are left empty or unsaid."""
    message, inner = message_class(type_name)(), used_types(type_name)
    for name, kind in message.get_fields_and_field_types().items():
        if not hasattr(decoded, name):
            value = UNSAID.get(name, getattr(message, name))
        elif name not in inner:
            value = getattr(decoded, name)
        elif kind.startswith("sequence<") or kind.endswith("]"):
            value = [_renewed(base_type(kind), part) for part in getattr(decoded, name)]
        else:
            value = _renewed(base_type(kind), getattr(decoded, name))
        setattr(message, name, value)
    return message


def _bare(text):
    """A definition without comments and blank space."""
    lines = (re.sub(r"\s+", " ", line.partition("#")[0]).strip() for line in text.splitlines())
    return [line for line in lines if line]
