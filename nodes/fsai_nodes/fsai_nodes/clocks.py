"""What every node of this package shares at ROS's edge: the two clocks, and timers that a clock step cannot stop."""

from __future__ import annotations

import time
from collections.abc import Callable

from builtin_interfaces.msg import Time
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.timer import Timer

from fsai_vcu.core.supervision.config import BridgeConfig
from fsai_vcu.interface.units import S
from fsai_vcu.runtime.clocks import AHEAD_NS, StampConverter

# A command's data this old are half way to being stale (safety: 500 ms): time to say whose silence it is.
LATE_NS = BridgeConfig().sensor_stale_ns // 2
WATCH_S = 0.1  # how often a node looks whether its input has fallen silent
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

        None where the stamp is more than 20 ms ahead: the message is to be refused, and the log says so.
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


class Input:
    """A topic that a node reads: when a message last came, and how old the data in it were.

    Times are the monotonic clock's. What it says is for people: which node is silent, or sends old data.
    """

    def __init__(self, node: Node, topic: str, *, silent_ns: int = LATE_NS, note: str = "") -> None:
        """`silent_ns`: without a message for so long it is silent. `note`: who else may be the cause."""
        self._node = node
        self._topic = topic
        self._silent_ns = silent_ns
        self._note = f" ({note})" if note else ""
        self._received_ns: int | None = None
        self._age_ns = 0
        self._said = False
        self._publishers: list[str] = []  # who did last: one that has ended is not in the ROS graph any more
        self._look_ns = 0  # the next time: the name of a publisher may stay unknown, and to ask at each message is slow

    def received(self, now_ns: int, age_ns: int = 0) -> None:
        """A message came, with data of that age; negative: stamped ahead of the clock."""
        self._received_ns, self._age_ns = now_ns, age_ns
        if not self._publishers and now_ns >= self._look_ns:
            self._look_ns = now_ns + S
            self._look()

    def forget(self) -> None:
        """As if nothing had ever been received."""
        self._received_ns, self._age_ns, self._said = None, 0, False

    def silence(self, now_ns: int) -> str:
        """In words for how long nothing has come; empty while something comes."""
        if self._received_ns is None:
            return f"{self.who().rstrip(',')}: nothing received yet{self._note}"
        silent_ns = now_ns - self._received_ns
        if silent_ns < self._silent_ns:
            return ""
        return f"{self.who()} has been silent for {silent_ns / 1e6:.0f} ms{self._note}"

    def old_data(self) -> str:
        """In words what is wrong with the data that came last; empty if nothing is."""
        if self._age_ns < 0:
            return f"{self.who()} is stamped {-self._age_ns / 1e6:.0f} ms ahead of the clock{self._note}"
        if self._age_ns < LATE_NS:
            return ""
        return f"{self.who()} comes with data {self._age_ns / 1e6:.0f} ms old{self._note}"

    def late(self, now_ns: int) -> str:
        """Why fresh data are missing, in words; empty if they are not."""
        return self.silence(now_ns) or self.old_data()

    def watch(self, now_ns: int) -> str:
        """`late`, and a line in the log when it begins and when it ends."""
        late = self.late(now_ns)
        if late and not self._said:
            self._node.get_logger().warning(late)
        elif self._said and not late:
            self._node.get_logger().info(f"{self.who()} is in time again")
        self._said = bool(late)
        return late

    def who(self) -> str:
        """The topic, and which nodes publish it, or did."""
        topic, there = self._look()
        names = " and ".join(self._publishers)
        if there:
            return f"{topic} of {names}" if names else topic
        return f"{topic} of {names}, which has ended," if names else f"{topic}, which nobody publishes,"

    def _look(self) -> tuple[str, bool]:
        """The topic's whole name, and whether anybody publishes it now."""
        topic = self._node.resolve_topic_name(self._topic)
        there = {each.node_name for each in self._node.get_publishers_info_by_topic(topic)}
        # A publisher is discovered before its node's name is.
        self._publishers = sorted(there - {"_NODE_NAME_UNKNOWN_"}) or self._publishers
        return topic, bool(there)
