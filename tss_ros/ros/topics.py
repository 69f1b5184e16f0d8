"""The topics named in recording.yaml: QoS, message types and what a bag says about them."""

import functools
import importlib
import json
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml
from ament_index_python.packages import get_package_share_directory
from rcl_interfaces.msg import SetParametersResult
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSPolicyKind, QoSProfile
from rclpy.qos_overriding_options import InvalidQosOverridesError, QoSOverridingOptions

from tss_ros.core import TssError

#: /clock is published at most this often [1/s of wall time]: faster starves those who follow it.
CLOCK_RATE_HZ = 200.0
#: rosbag2's way to write "no limit" for deadlines, lifespans and leases.
UNLIMITED = {"sec": 9223372036, "nsec": 854775807}
#: Most messages that a topic may be told to keep.
MAX_DEPTH = 1_000_000
#: What a user may change by the parameters qos_overrides.<topic>.<publisher or subscription>.*.
OVERRIDABLE = (QoSPolicyKind.DEPTH, QoSPolicyKind.RELIABILITY, QoSPolicyKind.DURABILITY)


@dataclass(frozen=True)
class Topic:
    """One topic as recording.yaml describes it; see there for the meaning of each field."""

    name: str
    type: str
    recorded: bool
    durability: str
    depth: int
    publisher: str = "sim_node"

    def __post_init__(self):
        if self.durability not in ("volatile", "transient_local"):
            allowed = "volatile or transient_local"
            raise TssError(f"durability of {self.name} is {self.durability!r}; allowed: {allowed}")
        if not (isinstance(self.depth, int) and self.depth >= 1):
            raise TssError(f"depth of {self.name} is {self.depth!r}; allowed: 1 or more")

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
    def offered_qos(self) -> dict[str, Any]:
        """The same as the dict that rosbag2 stores as `offered_qos_profiles`."""
        return {
            "history": "keep_last",
            "depth": self.depth,
            "reliability": "reliable",
            "durability": self.durability,
            "deadline": UNLIMITED,
            "lifespan": UNLIMITED,
            "liveliness": "automatic",
            "liveliness_lease_duration": UNLIMITED,
            "avoid_ros_namespace_conventions": False,
        }

    @property
    def type_hash(self) -> str:
        """The RIHS01 hash of the type, from the JSON file installed beside its definition."""
        described = json.loads(_interface_file(self.type, "json").read_text(encoding="utf-8"))
        return next(
            h["hash_string"] for h in described["type_hashes"] if h["type_name"] == self.type
        )

    @property
    def definition(self) -> str:
        """The type's `definition`."""
        return definition(self.type)

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


def _check_depth(qos):
    fits = 1 <= qos.depth <= MAX_DEPTH
    return SetParametersResult(
        successful=fits, reason=f"depth is {qos.depth}; allowed: 1 to {MAX_DEPTH}"
    )


@functools.cache
def read_topics() -> dict[str, Topic]:
    """Read recording.yaml.

    Returns
    -------
    dict of str to Topic
        By relative name, in the file's order.

    Raises
    ------
    TssError
        If an entry is not as it should be.
    """
    path = Path(get_package_share_directory("tss_ros")) / "msg_configs" / "recording.yaml"
    entries = yaml.safe_load(path.read_text(encoding="utf-8"))
    try:
        return {name: Topic(name=name, **entry) for name, entry in entries.items()}
    except TypeError as error:
        raise TssError(f"{path}: {error}; see its first lines") from error


def message_class(type_name: str) -> type:
    """The Python class of "package/msg/Type"."""
    package, _, name = type_name.split("/")
    return getattr(importlib.import_module(f"{package}.msg"), name)


def definition(type_name: str) -> str:
    """A type's text and, after it, that of each type it uses: MCAP's "ros2msg" schema."""
    texts, queue = {}, [type_name]
    while queue:
        name = queue.pop(0)
        if name not in texts:
            texts[name] = _interface_file(name, "msg").read_text(encoding="utf-8")
            queue += [base_type(field) for field in used_types(name).values()]
    root = texts.pop(type_name)
    parts = [
        f"{'=' * 80}\nMSG: {name.replace('/msg/', '/')}\n{text}" for name, text in texts.items()
    ]
    return "\n".join([root, *parts])


def _interface_file(type_name, suffix):
    package, _, name = type_name.split("/")
    return Path(get_package_share_directory(package)) / "msg" / f"{name}.{suffix}"


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
