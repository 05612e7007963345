"""Quality of service of every topic, in one place. The README's table says the same for people; a test compares."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

from fsai_nodes.middleware import without_events

# A command older than this is stale for the bridge too (safety: vehicle command stale after 100 ms), so the
# middleware need not deliver it. No deadline is asked for: a publisher that does not promise one would not be heard at
# all, and the CAN loop's own clock is what catches silence.
COMMAND_LIFESPAN_MS = 100
# Data older than this makes a command stale (safety: 500 ms), so a path that old is of no use.
PATH_LIFESPAN_MS = 500


def profile(depth: int, *, reliable: bool = True, kept: bool = False, **times_ms: int) -> QoSProfile:
    """The last `depth` messages; kept: also for readers that come later. times_ms: lifespan."""
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=depth,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if kept else DurabilityPolicy.VOLATILE,
        **{name: Duration(nanoseconds=time_ms * 1_000_000) for name, time_ms in times_ms.items()},
    )


COMMAND = profile(1, lifespan=COMMAND_LIFESPAN_MS)
PLAN = profile(1, lifespan=PATH_LIFESPAN_MS)
SENSOR = profile(1, reliable=False)
MOTION = profile(10)  # reliable, because RViz and others ask for that; a reader that asks for less gets it too
STATE = profile(1, kept=True)
CONFIRMATION = profile(10, kept=True)  # several nodes write it and none of their words may push out another's
VIEW = profile(1)  # reliable, as RViz asks for it; the next one replaces it
DIAGNOSTICS = profile(10)  # what the ecosystem's diagnostic tools expect

# By relative names, so that a namespace holds for all of them.
TOPICS: Mapping[str, QoSProfile] = MappingProxyType(
    {
        "raw_cones": SENSOR,
        "detected_cones": SENSOR,
        "path": PLAN,
        "planner_status": PLAN,
        "vehicle_cmd": COMMAND,
        "vehicle_state": STATE,
        "run_state": STATE,
        "reset_confirmation": CONFIRMATION,
        "odometry": MOTION,
        "imu": MOTION,
        "gps/fix": MOTION,
        "diagnostics": DIAGNOSTICS,
        "markers": VIEW,
        "robot_description": STATE,
    }
)
# Topics of tf2, outside of any namespace.
FRAMES: Mapping[str, QoSProfile] = MappingProxyType({"/tf": profile(100), "/tf_static": profile(10, kept=True)})


def publisher(node: Node, message_type: type[Any], topic: str) -> Publisher:
    """A publisher with the tables' quality of service."""
    return node.create_publisher(message_type, topic, {**TOPICS, **FRAMES}[topic], **without_events())
