"""What every node of this package shares at ROS's edge: the two clocks, and timers that a clock step cannot stop."""

from __future__ import annotations

import time
from collections.abc import Callable

from builtin_interfaces.msg import Time
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.timer import Timer

from fsai_nodes.stamps import AHEAD_NS, StampConverter

_READ_AGAIN = 3  # times at most
_SAME_REFUSAL_EVERY_NS = 1_000_000_000


def nanoseconds(stamp: Time) -> int:
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


class Clocks:
    """A node's ROS clock beside the monotonic clock."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._ros_clock = node.get_clock()
        self._steady_clock = Clock(clock_type=ClockType.STEADY_TIME)
        self._stamps = StampConverter()
        self._refusal_said_ns: dict[str, int] = {}  # by topic
        self._stamps.observe(self._ros_clock.now().nanoseconds, time.monotonic_ns())

    def now_ns(self) -> int:
        """The monotonic clock; notes its offset to ROS time in passing."""
        for _ in range(_READ_AGAIN):
            before_ns = time.monotonic_ns()
            ros_ns = self._ros_clock.now().nanoseconds
            after_ns = time.monotonic_ns()
            if after_ns - before_ns < 500_000:  # else this thread was put aside between the readings: not one instant
                self._stamps.observe(ros_ns, (before_ns + after_ns) // 2)
                break
        return after_ns

    def steady_of(self, stamp: Time, now_ns: int) -> int:
        """Monotonic time of a header stamp; later than `now_ns` only if the stamp is more than 20 ms ahead."""
        return self._stamps.to_steady(nanoseconds(stamp), now_ns)

    def measured_ns(self, stamp: Time, topic: str, now_ns: int) -> int | None:
        """Monotonic time of the stamp of a message on `topic`, never later than `now_ns`.

        None where the stamp is more than 20 ms ahead: the message is to be refused, and the log has been told.
        """
        t_ns = self.steady_of(stamp, now_ns)
        if t_ns <= now_ns:
            return t_ns
        said_ns = self._refusal_said_ns.get(topic)
        if said_ns is None or now_ns - said_ns >= _SAME_REFUSAL_EVERY_NS:
            self._refusal_said_ns[topic] = now_ns
            self._node.get_logger().error(
                f"{self._node.resolve_topic_name(topic)} refused: its stamp is {(t_ns - now_ns) / 1e6:.0f} ms ahead "
                f"of this computer's clock ({AHEAD_NS / 1e6:.0f} ms at most); is the sender's clock right?"
            )
        return None

    def stamp_of(self, steady_ns: int) -> Time:
        """The header stamp of a monotonic instant."""
        sec, nanosec = divmod(self._stamps.to_ros(steady_ns), 1_000_000_000)
        return Time(sec=sec, nanosec=nanosec)

    def every(self, period_s: float, callback: Callable[[], None]) -> Timer:
        """A timer by the monotonic clock: rclpy's default timers stand still when the wall clock is set back."""
        return self._node.create_timer(period_s, callback, clock=self._steady_clock)
