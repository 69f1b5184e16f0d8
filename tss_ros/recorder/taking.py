"""Serialised messages with the name of who sent them, which Jazzy's rclpy keeps to itself.

A sender's name is the beginning of its GID, which all publishers of one process share.
"""

import ctypes
from typing import NamedTuple

from rclpy.subscription import Subscription

from tss_ros.core import TssError

#: Bytes of a publisher's GID, and how many of them are those of its process.
GID_BYTES, SENDER_BYTES = 16, 12
_OK, _NOTHING = 0, 401


class Taken(NamedTuple):
    """A serialised message.

    Attributes
    ----------
    data : bytes
    sent_ns : int
        Wall time of the publication [ns]; 0 if the middleware does not say.
    number : int or None
        How many messages its publisher had sent with this one; None if the middleware does not say.
    sender, publisher : bytes
        Process and publisher that sent it.
    """

    data: bytes
    sent_ns: int
    number: int | None
    sender: bytes
    publisher: bytes


class _Allocator(ctypes.Structure):
    _fields_ = [(f"member_{i}", ctypes.c_void_p) for i in range(5)]


class _SerializedMessage(ctypes.Structure):
    _fields_ = [
        ("buffer", ctypes.POINTER(ctypes.c_char)),
        ("length", ctypes.c_size_t),
        ("capacity", ctypes.c_size_t),
        ("allocator", _Allocator),
    ]


class _MessageInfo(ctypes.Structure):
    _fields_ = [
        ("source_timestamp", ctypes.c_int64),
        ("received_timestamp", ctypes.c_int64),
        ("publication_sequence_number", ctypes.c_uint64),
        ("reception_sequence_number", ctypes.c_uint64),
        ("implementation", ctypes.c_char_p),
        ("gid", ctypes.c_uint8 * GID_BYTES),
        ("from_intra_process", ctypes.c_bool),
    ]


_rcl, _rcutils = ctypes.CDLL("librcl.so"), ctypes.CDLL("librcutils.so")
_rcutils.rcutils_get_default_allocator.restype = _Allocator
_rcl.rcl_take_serialized_message.argtypes = [ctypes.c_void_p] * 4
#: What a middleware says that does not count.
_UNCOUNTED = 2**64 - 1


class Taker:
    """Takes what waits in a subscription."""

    def __init__(self, subscription: Subscription) -> None:
        self._subscription = subscription
        self._message = _SerializedMessage(allocator=_rcutils.rcutils_get_default_allocator())
        self._info = _MessageInfo()

    def take(self) -> Taken | None:
        """The next message, or None.

        Raises
        ------
        TssError
            If the middleware refuses.
        """
        message, info = self._message, self._info
        with self._subscription.handle:  # keeps it from being destroyed meanwhile
            status = _rcl.rcl_take_serialized_message(
                self._subscription.handle.pointer, ctypes.byref(message), ctypes.byref(info), None
            )
        if status == _NOTHING:
            return None
        if status != _OK:
            name = self._subscription.topic_name
            raise TssError(f"the middleware gives no message of {name}: rcl's status is {status}")
        number, gid = info.publication_sequence_number, bytes(info.gid)
        return Taken(
            message.buffer[: message.length],
            info.source_timestamp,
            None if number == _UNCOUNTED else number,
            gid[:SENDER_BYTES],
            gid,
        )
