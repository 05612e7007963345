"""What every node of this package shares at ROS's edge: the two clocks, and timers that a clock step cannot stop."""

from __future__ import annotations

import time
from collections.abc import Callable

from builtin_interfaces.msg import Time
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.timer import Timer

from fsai_vcu.runtime.clocks import StampConverter


def nanoseconds(stamp: Time) -> int:
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


class Clocks:
    """A node's ROS clock beside the monotonic clock."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._ros_clock = node.get_clock()
        self._steady_clock = Clock(clock_type=ClockType.STEADY_TIME)
        self._stamps = StampConverter()
        self._stamps.observe(self._ros_clock.now().nanoseconds, time.monotonic_ns())

    def now_ns(self) -> int:
        """The monotonic clock; notes its offset to ROS time in passing."""
        before_ns = time.monotonic_ns()
        ros_ns = self._ros_clock.now().nanoseconds
        after_ns = time.monotonic_ns()
        if after_ns - before_ns < 500_000:  # else this thread was put aside between the readings: not one instant
            self._stamps.observe(ros_ns, (before_ns + after_ns) // 2)
        return after_ns

    def steady_of(self, stamp: Time, now_ns: int) -> int:
        """Monotonic time of a header stamp, never later than `now_ns`."""
        return self._stamps.to_steady(nanoseconds(stamp), now_ns)

    def stamp_of(self, steady_ns: int) -> Time:
        """The header stamp of a monotonic instant."""
        sec, nanosec = divmod(self._stamps.to_ros(steady_ns), 1_000_000_000)
        return Time(sec=sec, nanosec=nanosec)

    def every(self, period_s: float, callback: Callable[[], None]) -> Timer:
        """A timer by the monotonic clock: rclpy's default timers stand still when the wall clock is set back."""
        return self._node.create_timer(period_s, callback, clock=self._steady_clock)
