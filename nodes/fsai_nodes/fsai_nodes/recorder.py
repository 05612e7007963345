"""ROS messages for a recording, as they come over the wire: raw, whatever their type, with its definition.

Used by `fsai-vcu record --ros`, which runs in a process of its own. Subscriptions are best effort, but for what is
published once and kept (transient local), which is only to be had reliably.
"""

from __future__ import annotations

import os
import re
import sys
import time
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.subscription import Subscription

from fsai_nodes.door import Door
from fsai_nodes.fields import shown
from fsai_nodes.listener import Listener
from fsai_nodes.qos import TOPICS, profile
from fsai_vcu.diagnostics.export.mcap_file import RosMessage, RosTopic

LOOK_AGAIN_S = 0.5  # for topics that were not there before
DEPTH = 200
PROJECT_TOPICS = (*TOPICS, "/tf", "/tf_static")
_RULE = "=" * 80
_TYPE = re.compile(r"[a-z]\w*/msg/[A-Z]\w*", re.ASCII)


class TopicRecorder(Listener):
    """Receives topics from `start` to `stop`; `fetch` gives what was received, `news` what people should know."""

    def __init__(self, topics: Iterable[str] = PROJECT_TOPICS, namespace: str = "/") -> None:
        """A topic without a / at its beginning is one of `namespace`. Raises ValueError where that is invalid."""
        self._received: deque[RosMessage] = deque()
        self._news: deque[str] = deque()
        self._told = False  # that receiving has failed
        self._subscriptions: dict[str, Subscription] = {}
        self._refused: set[str] = set()
        super().__init__("recorder", namespace)
        self._door = Door(self._node, publishes=False)
        self._wanted = {self._node.resolve_topic_name(topic) for topic in topics}
        self._node.create_timer(LOOK_AGAIN_S, self._look, clock=Clock(clock_type=ClockType.STEADY_TIME))

    @property
    def topics(self) -> list[str]:
        """Topics that are being recorded."""
        return sorted(self._subscriptions)

    def start(self) -> None:
        self._look()
        super().start()

    def fetch(self) -> list[RosMessage]:
        return [self._received.popleft() for _ in range(len(self._received))]

    def news(self) -> list[str]:
        if self.error is not None and not self._told:
            self._told = True
            self._news.append(f"ROS messages are not recorded any more: {self.error!r}")
        return [self._news.popleft() for _ in range(len(self._news))]

    def _look(self) -> None:
        for name, types in self._node.get_topic_names_and_types():
            if name not in self._wanted or name in self._subscriptions or name in self._refused:
                continue
            if self._node.count_publishers(name):
                self._subscribe(name, types)

    def _subscribe(self, name: str, types: Sequence[str]) -> None:
        try:
            if len(types) > 1:
                raise LookupError(f"it has several types: {', '.join(map(shown, types[:5]))}")
            message_type = class_of(types[0])
            definition = definition_of(types[0])
        except LookupError as error:
            self._refused.add(name)
            self._news.append(f"{name} is not recorded: {error.args[0]}")
            return
        qos = self._qos_for(name)
        topic = RosTopic(name, types[0], definition, _yaml(qos))
        self._subscriptions[name] = self._door.recorded(message_type, name, self._taker(topic), qos)

    def _taker(self, topic: RosTopic) -> Callable[[bytes, dict[str, Any]], None]:
        def take(data: bytes, info: dict[str, Any]) -> None:
            taken_ns = time.time_ns()
            self._received.append(
                RosMessage(topic, bytes(data), taken_ns, int(info.get("source_timestamp", 0)) or taken_ns)
            )

        return take

    def _qos_for(self, name: str) -> QoSProfile:
        publishers = self._node.get_publishers_info_by_topic(name)
        kept = all(each.qos_profile.durability is DurabilityPolicy.TRANSIENT_LOCAL for each in publishers)
        return profile(DEPTH, reliable=kept, kept=kept)


def class_of(type_name: str) -> type[Any]:
    """The Python class of 'package/msg/Type'. Raises LookupError with words for people."""
    if _TYPE.fullmatch(type_name) is None:  # a program of plain DDS may name it as it likes
        raise LookupError(f"its type {shown(type_name)} is not a ROS type")
    package, _, name = type_name.split("/")
    try:
        found: type[Any] = getattr(import_module(f"{package}.msg"), name)
    except (ImportError, AttributeError):
        raise LookupError(f"its type {type_name} is not installed here") from None
    return found


def definition_of(type_name: str) -> str:
    """The .msg text of a type and, behind rules, of all types in it: what bags keep. Raises LookupError."""
    texts: dict[str, str] = {}
    waiting = [type_name]
    while waiting:
        name = waiting.pop(0)
        if name not in texts:
            texts[name] = _msg_text(name)
            waiting += _types_in(name)
    first, *others = texts
    parts = [texts[first], *(f"{_RULE}\nMSG: {name.replace('/msg/', '/')}\n{texts[name]}" for name in others)]
    return "\n".join(part.rstrip("\n") for part in parts) + "\n"


def _msg_text(type_name: str) -> str:
    package, _, name = type_name.split("/")
    prefixes = [part for part in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if part]
    for prefix in (*prefixes, sys.prefix):
        path = Path(prefix) / "share" / package / "msg" / f"{name}.msg"
        if path.is_file():
            return path.read_text(encoding="utf-8")
    raise LookupError(f"there is no definition of {type_name} under share/ of {' or '.join((*prefixes, sys.prefix))}")


def _types_in(type_name: str) -> list[str]:
    """Return the message types of a type's fields: 'float64', 'std_msgs/Header', 'sequence<geometry_msgs/Point>'."""
    fields = " ".join(class_of(type_name).get_fields_and_field_types().values())
    return [f"{package}/msg/{name}" for package, name in re.findall(r"(\w+)/(\w+)", fields)]


def _yaml(qos: QoSProfile) -> str:
    """Return the offered profiles of a topic as rosbag2 writes them."""
    forever = "sec: 9223372036\n    nsec: 854775807"
    return (
        f"- history: keep_last\n  depth: {qos.depth}\n  reliability: {qos.reliability.name.lower()}\n"
        f"  durability: {qos.durability.name.lower()}\n  deadline:\n    {forever}\n  lifespan:\n    {forever}\n"
        f"  liveliness: automatic\n  liveliness_lease_duration:\n    {forever}\n"
        "  avoid_ros_namespace_conventions: false"
    )
