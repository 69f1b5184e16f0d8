"""Topics that simulators publish only where their parameters ask for it: found as they appear."""

import dataclasses
import re
from collections.abc import Callable, Iterable

from rclpy.node import Node

from tss_ros.ros.topics import Topic


class OptionalTopics:
    """Looks for them in a recorder's namespace.

    Parameters
    ----------
    node : rclpy.node.Node
        The recorder.
    topics : iterable of Topic
        Each name begins with "~/", for any node of the namespace, and may hold "{satellite}".
    on_found : callable
        Called with a Topic of full name when it is first seen.
    """

    def __init__(
        self, node: Node, topics: Iterable[Topic], on_found: Callable[[Topic], None]
    ) -> None:
        self._node, self._on_found, self._known = node, on_found, set()
        namespace = re.escape(node.get_namespace().rstrip("/"))
        self._topics = []
        for topic in topics:
            tail = re.escape(topic.name.removeprefix("~")).replace(r"\{satellite\}", "[^/]+")
            self._topics.append((re.compile(f"{namespace}/[^/]+{tail}"), topic))

    def look(self) -> None:
        """Find those that have come."""
        for name, types in self._node.get_topic_names_and_types():
            for pattern, topic in () if name in self._known else self._topics:
                if (
                    topic.type in types
                    and pattern.fullmatch(name)
                    and self._node.count_publishers(name)
                ):
                    self._known.add(name)
                    self._on_found(dataclasses.replace(topic, name=name))
