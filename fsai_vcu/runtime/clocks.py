"""Wall-clock stamps of ROS messages and received frames to the monotonic clock and back, through steps of that clock.

Header stamps are wall-clock time, because that is what other people's nodes and recordings use; decisions are made
by the monotonic clock only (safety: a clock step never does anything). Pure: both clocks' readings are arguments.
"""

from __future__ import annotations

from dataclasses import dataclass

from fsai_vcu.core.supervision.config import BridgeConfig

WINDOW_NS = 1_000_000_000  # a stamp older than this is stale by any clock, so older offsets explain nothing
SAME_OFFSET_NS = 1_000_000  # differences under this are slewing and reading noise, not a step
# A stamp no further ahead of the clock is noise: it was made just now. One further ahead would hide how old data are.
AHEAD_NS = BridgeConfig().sensor_future_ns


@dataclass(slots=True)
class _Offset:
    ros_minus_steady_ns: int
    retired_at_ns: int | None = None  # steady time at which a step replaced it


class StampConverter:
    """Converts stamps by the offsets (ROS time - steady time) of the last second.

    After a step of the wall clock, stamps made shortly before it still arrive for a while; they are converted by the
    offset before the step. A stamp does not say to which offset it belongs: the offset that makes it youngest without
    putting it into the future is taken.
    """

    def __init__(self) -> None:
        self._offsets: list[_Offset] = []  # newest last

    def observe(self, ros_ns: int, steady_ns: int) -> None:
        """Both clocks, read at the same instant. To be called at every conversion, at least."""
        offset_ns = ros_ns - steady_ns
        if self._offsets and abs(offset_ns - self._offsets[-1].ros_minus_steady_ns) <= SAME_OFFSET_NS:
            self._offsets[-1].ros_minus_steady_ns = offset_ns
        else:
            if self._offsets:
                self._offsets[-1].retired_at_ns = steady_ns
            self._offsets.append(_Offset(offset_ns))
        self._offsets = [
            offset
            for offset in self._offsets
            if offset.retired_at_ns is None or steady_ns - offset.retired_at_ns <= WINDOW_NS
        ]

    def to_steady(self, stamp_ns: int, now_ns: int) -> int:
        """Steady time of a stamp.

        Up to AHEAD_NS ahead of `now_ns` (steady) it is `now_ns`, and never later than that. Further ahead it is what
        the stamp says, by the offset that puts it ahead the least: that is for the caller to refuse.
        """
        ages_ns = [now_ns - (stamp_ns - offset.ros_minus_steady_ns) for offset in self._offsets]
        believable_ns = [max(age_ns, 0) for age_ns in ages_ns if age_ns >= -AHEAD_NS]
        return now_ns - (min(believable_ns) if believable_ns else max(ages_ns, default=0))

    def to_ros(self, steady_ns: int) -> int:
        """ROS time of a steady instant, by today's offset; never before the epoch, which no stamp can express."""
        if not self._offsets:
            raise RuntimeError("no pair of clock readings has been observed yet")
        return max(0, steady_ns + self._offsets[-1].ros_minus_steady_ns)
