"""Clocks that every node of this package shares at ROS's edge, and timers that a clock step cannot stop."""

from __future__ import annotations

import time
from collections.abc import Callable

from builtin_interfaces.msg import Time
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.timer import Timer

from fsai_nodes.complaints import complaints_of
from fsai_nodes.fields import listed
from fsai_vcu.core.supervision.config import BridgeConfig
from fsai_vcu.interface.units import S
from fsai_vcu.runtime.clocks import AHEAD_NS, StampConverter

# A command's data this old are half way to being stale (safety: 500 ms): time to say whose silence it is.
LATE_NS = BridgeConfig().sensor_stale_ns // 2
WATCH_S = 0.1  # how often a node looks whether its input has fallen silent
_READ_AGAIN = 3  # times at most
_STANDS_NS = S // 2  # a clock that has not moved for so long stands still
_ELSEWHERE_NS = S  # from this computer's


def nanoseconds(stamp: Time) -> int:
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


class Clocks:
    """A node's ROS clock beside the monotonic clock."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._ros_clock = node.get_clock()
        self._steady_clock = Clock(clock_type=ClockType.STEADY_TIME)
        self._stamps = StampConverter()
        self._ros_ns, self._moved_ns = self._ros_clock.now().nanoseconds, time.monotonic_ns()
        self._stamps.observe(self._ros_ns, self._moved_ns)

    def now_ns(self) -> int:
        """The monotonic clock; notes its offset to ROS time in passing."""
        for _ in range(_READ_AGAIN):
            before_ns = time.monotonic_ns()
            ros_ns = self._ros_clock.now().nanoseconds
            after_ns = time.monotonic_ns()
            if after_ns - before_ns < 500_000:  # else this thread was put aside between the readings: not one instant
                self._stamps.observe(ros_ns, (before_ns + after_ns) // 2)
                break
        if ros_ns != self._ros_ns:
            self._ros_ns, self._moved_ns = ros_ns, after_ns
        return after_ns

    def wrong(self, now_ns: int) -> str:
        """Say in words what is wrong with this node's own clock; empty where it is this computer's, or near it.

        It is another clock with use_sim_time: then it is what /clock says.
        """
        if not self._ros_clock.ros_time_is_active:
            return ""
        if now_ns - self._moved_ns >= _STANDS_NS:
            return (
                f"this node's own clock stands still at {self._ros_ns / 1e9:.0f} s: use_sim_time is set, and nothing "
                "comes on /clock"
            )
        ahead_ns = self._ros_ns - time.time_ns()
        if abs(ahead_ns) < _ELSEWHERE_NS:
            return ""
        where = "ahead of" if ahead_ns > 0 else "behind"
        return (
            f"this node's own clock is {abs(ahead_ns) / 1e9:.0f} s {where} this computer's: use_sim_time is set, and "
            "/clock says so"
        )

    def refused_by_own(self, topic: str, now_ns: int) -> str:
        """The sentence by which `topic` (whole) is refused where this node's own clock is wrong; empty where not."""
        words = self.wrong(now_ns)
        if words:
            words += f"; {topic} is refused, as its stamp is meaningless"
            complaints_of(self._node).say("clock", words, "error")
        return words

    def watch(self) -> None:
        """Watch the node's clock: from now on the node itself says it when the clock stands still."""
        self.every(_STANDS_NS / 1e9, self._watch)

    def _watch(self) -> None:
        now_ns = self.now_ns()
        if now_ns - self._moved_ns >= _STANDS_NS and (words := self.wrong(now_ns)):
            complaints_of(self._node).say("clock", words, "error")

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
        name = self._node.resolve_topic_name(topic)
        if self.refused_by_own(name, now_ns):
            return None
        words = (
            f"{name} refused: its stamp is {(t_ns - now_ns) / 1e6:.0f} ms ahead of this computer's clock "
            f"({AHEAD_NS / 1e6:.0f} ms at most); is the sender's clock right?"
        )
        complaints_of(self._node).say(name, words, "error")
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

    def __init__(
        self, node: Node, topic: str, *, silent_ns: int = LATE_NS, note: str = "", clocks: Clocks | None = None
    ) -> None:
        """`silent_ns`: without a message for so long it is silent. `note`: who else may be the cause.

        clocks: the node's; where its own clock is wrong, what it says of the ages of others is worth nothing.
        """
        self._node = node
        self._clocks = clocks
        self._refused: tuple[str, int] = "", 0  # the last refusal, in words, and when
        self._topic = topic
        self._silent_ns = silent_ns
        self._note = f" ({note})" if note else ""
        self._received_ns: int | None = None
        self._age_ns = 0
        self._said = False
        self._publishers: list[str] = []  # the last ones: a node that has ended is not in the ROS graph any more
        self._look_ns = 0  # the next time: the name of a publisher may stay unknown, and to ask at each message is slow

    def received(self, now_ns: int, age_ns: int = 0) -> None:
        """A message came, with data of that age; negative: stamped ahead of the clock."""
        self._received_ns, self._age_ns = now_ns, age_ns
        if not self._publishers and now_ns >= self._look_ns:
            self._look_ns = now_ns + S
            self._look()

    def refused(self, words: str) -> None:
        """A message came, and was refused: that is another thing than silence."""
        self._refused = words, time.monotonic_ns()

    def forget(self) -> None:
        """Forget that anything was ever received."""
        self._received_ns, self._age_ns, self._said = None, 0, False

    def silence(self, now_ns: int) -> str:
        """Say for how long nothing has come, in words; empty while something comes."""
        words, refused_ns = self._refused
        refused = words if now_ns - refused_ns < self._silent_ns else ""
        if self._received_ns is None:
            return refused or f"{self.who()}: nothing received yet{self._note}"
        silent_ns = now_ns - self._received_ns
        if silent_ns < self._silent_ns:
            return ""
        return refused or f"{self.who()}: nothing received for {silent_ns / 1e6:.0f} ms{self._note}"

    def old_data(self) -> str:
        """Say what is wrong with the data that came last, in words; empty if nothing is."""
        if self._age_ns < 0 or self._age_ns >= LATE_NS:
            wrong = "" if self._clocks is None else self._clocks.wrong(self._clocks.now_ns())
            if wrong:
                return wrong
        if self._age_ns < 0:
            return f"{self.who()} is stamped {-self._age_ns / 1e6:.0f} ms ahead of the clock{self._note}"
        if self._age_ns < LATE_NS:
            return ""
        return f"{self.who()} comes with data {self._age_ns / 1e6:.0f} ms old{self._note}"

    def late(self, now_ns: int) -> str:
        """Say in words why fresh data are missing; empty if they are not."""
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
        names = listed(self._publishers, "and")
        if there:
            return f"{topic} of {names}" if names else topic
        return f"{topic} of {names}, which has ended" if names else f"{topic}, which nobody publishes"

    def _look(self) -> tuple[str, bool]:
        """The topic's whole name, and whether anybody publishes it now."""
        topic = self._node.resolve_topic_name(self._topic)
        there = {each.node_name for each in self._node.get_publishers_info_by_topic(topic)}
        # A publisher is discovered before its node's name is.
        self._publishers = list(there - {"_NODE_NAME_UNKNOWN_"}) or self._publishers
        return topic, bool(there)
