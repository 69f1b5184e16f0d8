"""The topics named in recording.yaml, and what a bag says about them."""

import functools
import importlib.metadata
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import yaml

from tss_ros.core import TssError
from tss_ros.messages import types

#: rosbag2's way to write "no limit" for deadlines, lifespans and leases.
UNLIMITED = {"sec": 9223372036, "nsec": 854775807}
#: What a step consists of. A recorder that has got the last of them has got the whole step.
STATE_TOPICS = ("tether_states", "markers", "bead_cloud", "tether_lengths", "bead_states")
_PLACE = "msg_configs/recording.yaml"


@dataclass(frozen=True)
class Topic:
    """One topic as recording.yaml describes it; see there for the meaning of each field."""

    name: str
    type: str
    recorded: bool
    durability: str
    depth: int
    publisher: str = "sim_node"
    optional: bool = False

    def __post_init__(self):
        if self.durability not in ("volatile", "transient_local"):
            allowed = "volatile or transient_local"
            raise TssError(f"durability of {self.name} is {self.durability!r}; allowed: {allowed}")
        if not (isinstance(self.depth, int) and self.depth >= 1):
            raise TssError(f"depth of {self.name} is {self.depth!r}; allowed: 1 or more")

    @property
    def definition(self) -> str:
        """The type's `definition`."""
        return types.definition(self.type)

    @property
    def type_hash(self) -> str:
        """The type's RIHS01 hash."""
        return types.type_hash(self.type)

    @property
    def offered_qos(self) -> dict[str, Any]:
        """The QoS of publishers as the dict that rosbag2 stores as `offered_qos_profiles`."""
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


TopicClass = TypeVar("TopicClass", bound=Topic)


@functools.cache
def read_topics(topic_class: type[TopicClass] = Topic) -> dict[str, TopicClass]:
    """Read recording.yaml.

    Parameters
    ----------
    topic_class : type
        Topic, or what is derived from it.

    Returns
    -------
    dict of str to Topic
        By relative name, in the file's order.

    Raises
    ------
    TssError
        If an entry is not as it should be.
    """
    path = _path()
    entries = yaml.safe_load(path.read_text(encoding="utf-8"))
    try:
        return {name: topic_class(name=name, **entry) for name, entry in entries.items()}
    except TypeError as error:
        raise TssError(f"{path}: {error}; see its first lines") from error


def _path():
    """recording.yaml: of the workspace that is active, of the checkout, or as pip installed it."""
    checkout = Path(__file__).parents[2]
    for folder in (types.share("tss_ros"), checkout):
        if folder and (folder / _PLACE).is_file():
            return folder / _PLACE
    files = importlib.metadata.files("tss_ros") or ()
    return Path(next(file for file in files if file.as_posix().endswith(_PLACE)).locate())
