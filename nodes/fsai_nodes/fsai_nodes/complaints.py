"""Complaints of a node: each at once in the log and in /diagnostics, then at most once a second."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Literal

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node

from fsai_nodes.qos import publisher
from fsai_vcu.interface.units import S

SAME_EVERY_NS = S
MOST = 100  # kinds of complaints that are told apart
ANSWERS = 5  # lines on requests of one kind within a second: more than a person asks

Level = Literal["info", "warning", "error"]


@dataclass(slots=True)
class _Kind:
    since_ns: int | None = None  # the second in hand began
    said: int = 0  # in it
    unsaid: int = 0
    count: int = 0


class Complaints:
    """One node's. A kind that comes again within a second is counted, and said with its count."""

    def __init__(self, node: Node, *, publishes: bool = True) -> None:
        """publishes: also in /diagnostics."""
        self._node = node
        self._kinds: dict[str, _Kind] = {}
        self._diagnostics = publisher(node, DiagnosticArray, "diagnostics") if publishes else None

    def say(
        self, kind: str, text: str, level: Level = "warning", now_ns: int | None = None, *, at_once: int = 1
    ) -> None:
        """Say a complaint. `kind`: what is complained of, such as a topic; `text`: one sentence.

        at_once: how many of a kind are said within a second. An "info" is none, and is for the log alone.
        """
        now_ns = time.monotonic_ns() if now_ns is None else now_ns
        if kind not in self._kinds and len(self._kinds) >= MOST:
            kind = "more"
        one = self._kinds.setdefault(kind, _Kind())
        one.count += 1
        one.unsaid += 1
        if one.since_ns is None or now_ns - one.since_ns >= SAME_EVERY_NS:
            one.since_ns, one.said = now_ns, 0
        if one.said >= at_once:
            return
        line = text if one.unsaid == 1 else f"{text} [{one.unsaid} times]"
        one.said, one.unsaid = one.said + 1, 0
        # One line of source for each: rclpy ties a severity to it.
        if level == "error":
            self._node.get_logger().error(line)
        elif level == "warning":
            self._node.get_logger().warning(line)
        else:
            self._node.get_logger().info(line)
            return
        self._publish(kind, line, level, one.count)

    def count(self, kind: str) -> int:
        """Return how often there was a complaint of this kind."""
        return self._kinds[kind].count if kind in self._kinds else 0

    def _publish(self, kind: str, line: str, level: Level, count: int) -> None:
        if self._diagnostics is None:
            return
        status = DiagnosticStatus(
            level=DiagnosticStatus.ERROR if level == "error" else DiagnosticStatus.WARN,
            name=f"{self._node.get_name()}: {kind}",
            message=line,
            hardware_id="ADS-DV",
            values=[KeyValue(key="count", value=str(count))],
        )
        message = DiagnosticArray(status=[status])
        message.header.stamp = self._node.get_clock().now().to_msg()
        self._diagnostics.publish(message)


def complaints_of(node: Node, *, publishes: bool = True) -> Complaints:
    """The node's one, made at the first call."""
    found: Complaints | None = getattr(node, "complaints", None)
    if found is None:
        found = node.complaints = Complaints(node, publishes=publishes)
    return found
