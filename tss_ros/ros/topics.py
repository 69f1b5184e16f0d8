"""The topics named in recording.yaml in the middleware: QoS, classes of messages, publishers."""

import functools
import importlib
import time
import warnings
from collections.abc import Iterable

from rcl_interfaces.msg import SetParametersResult
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSPolicyKind, QoSProfile
from rclpy.qos_overriding_options import InvalidQosOverridesError, QoSOverridingOptions

from tss_ros.core import TssError
from tss_ros.messages import topics

#: /clock is published at most this often [1/s of wall time]: faster starves those who follow it.
CLOCK_RATE_HZ = 200.0
#: Most messages that a topic may be told to keep.
MAX_DEPTH = 1_000_000
#: What a user may change by the parameters qos_overrides.<topic>.<publisher or subscription>.*.
OVERRIDABLE = (QoSPolicyKind.DEPTH, QoSPolicyKind.RELIABILITY, QoSPolicyKind.DURABILITY)


class Topic(topics.Topic):
    """A topic with what the middleware needs to know of it."""

    @property
    def message_class(self) -> type:
        """The Python class of the topic's messages."""
        return message_class(self.type)

    @property
    def qos(self) -> QoSProfile:
        """The QoS of publishers and subscriptions: reliable, keeping the last `depth`."""
        durability = DurabilityPolicy.get_from_short_key(self.durability)
        return QoSProfile(depth=self.depth, durability=durability)

    @property
    def stamp_offset(self) -> int | None:
        """Bytes from the start of a serialised message to its (first) header's stamp; None without.

        A CDR message starts with 4 bytes that name the encoding, a sequence with the 4 bytes of its
        length: the first header of a MarkerArray lies 4 bytes further in than that of a JointState.
        """
        offset, name = 4, self.type
        while True:
            first = next(iter(message_class(name).get_fields_and_field_types().values()))
            if first == "std_msgs/Header":
                return offset
            if not (first.startswith("sequence<") and "/" in first):
                return None
            offset, name = offset + 4, base_type(first)


def create_publisher(node: Node, topic: Topic) -> Publisher:
    """Publish a topic, with its QoS as the parameters `qos_overrides.*` of the node say.

    Parameters
    ----------
    node : rclpy.node.Node
    topic : Topic

    Returns
    -------
    rclpy.publisher.Publisher

    Raises
    ------
    TssError
        If an override is not possible, or if the topic's message package is not installed.
    """
    try:
        message_class = topic.message_class
    except ModuleNotFoundError as error:
        raise TssError(f"{topic.name} needs the package {error.name}, not installed here") from None
    options = QoSOverridingOptions(OVERRIDABLE, callback=_check_depth)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # a depth of 0 is an error here
            return node.create_publisher(
                message_class, topic.name, topic.qos, qos_overriding_options=options
            )
    except (RuntimeError, InvalidQosOverridesError) as error:
        raise TssError(f"qos_overrides of {topic.name}: {error}") from None


def publishers(node: Node, topic: str) -> dict[bytes, str]:
    """Who publishes a topic: full node name by GID, empty as long as it is not known."""
    names = {}
    for info in node.get_publishers_info_by_topic(topic):
        known = "_UNKNOWN_" not in info.node_name
        name = f"{info.node_namespace.rstrip('/')}/{info.node_name}" if known else ""
        names[bytes(info.endpoint_gid)] = name
    return names


def wait_until_acked(publishers: Iterable[Publisher], timeout_s: float) -> bool:
    """Wait, so long [s] at most, until all that was published has arrived; whether it has."""
    deadline = time.monotonic() + timeout_s
    arrived = True
    for publisher in publishers:
        left_s = max(0.0, deadline - time.monotonic())
        arrived &= publisher.wait_for_all_acked(Duration(seconds=left_s))
    return arrived


def _check_depth(qos):
    fits = 1 <= qos.depth <= MAX_DEPTH
    return SetParametersResult(
        successful=fits, reason=f"depth is {qos.depth}; allowed: 1 to {MAX_DEPTH}"
    )


@functools.cache
def read_topics() -> dict[str, Topic]:
    """The topics named in recording.yaml by relative name; TssError if an entry is wrong."""
    return topics.read_topics(Topic)


def message_class(type_name: str) -> type:
    """The Python class of "package/msg/Type"."""
    package, _, name = type_name.split("/")
    return getattr(importlib.import_module(f"{package}.msg"), name)


def used_types(type_name: str) -> dict[str, str]:
    """Names and types of a type's fields that are messages themselves, or sequences of them."""
    fields = message_class(type_name).get_fields_and_field_types()
    return {name: field for name, field in fields.items() if "/" in field}


def base_type(field: str) -> str:
    """ "sequence<pkg/Name, 3>" or "pkg/Name[3]" or "pkg/Name" as "pkg/msg/Name"."""
    package, name = (
        field.removeprefix("sequence<").rstrip(">").split(",")[0].split("[")[0].split("/")
    )
    return f"{package}/msg/{name}"
