"""A part of a log: from one moment to another, and messages by name."""

from __future__ import annotations

import math
import re
from datetime import datetime, timedelta, timezone
from typing import Final

import numpy as np
import numpy.typing as npt

from fsai_vcu.diagnostics.log.frames import EPOCH_NS, Frames, Mask
from fsai_vcu.interface.errors import WrongUse

_CLOCK: Final = re.compile(r"(\d{1,2}):(\d\d)(?::([0-5]\d(?:\.\d+)?))?")
_SECOND_NS: Final = 1_000_000_000


class Part:
    """Part of a log from `begin` to `end`, each a time into the log or a time of day (UTC); None: no bound.

    A time into the log is a number of seconds, or 1:30 for a minute and a half. 14:03:30 is a time of day, and so is
    14:03 where the log, from its first frame to its last, has that minute. ids: the identifiers of the messages;
    None: all of them.
    """

    def __init__(self, begin: str | None = None, end: str | None = None, ids: frozenset[int] | None = None) -> None:
        """Read the times. Raises ValueError with one clear line."""
        for name, text in (("--from", begin), ("--to", end)):
            try:
                if (_seconds(text, 0, 0) or 0.0) < 0.0:
                    raise ValueError(text)
            except ValueError:
                raise ValueError(
                    f"{name} is {text}: neither seconds from 0 on, nor minutes and seconds such as 1:30, nor a time of "
                    "day such as 14:03:30"
                ) from None
        begin_s, end_s = (None if each is None or ":" in each else float(each) for each in (begin, end))
        if begin_s is not None and end_s is not None and begin_s > end_s:
            raise ValueError(f"--from {begin} is after --to {end}")
        self._begin, self._end, self._ids = begin, end, ids
        self._last_ns: int | None = None
        self._bounds: tuple[float, float] | None = None

    def __bool__(self) -> bool:
        """Return true where anything is left out at all."""
        return self._begin is not None or self._end is not None or self._ids is not None

    @property
    def chooses_messages(self) -> bool:
        """True where only messages by name are in the part."""
        return self._ids is not None

    def has(self, can_ids: npt.NDArray[np.uint32]) -> Mask:
        """Select the identifiers whose messages are in the part."""
        if self._ids is None:
            return np.ones(len(can_ids), np.bool_)
        return np.isin(can_ids, np.fromiter(self._ids, np.uint32))

    @property
    def needs_the_end(self) -> bool:
        """True where a bound depends on when the log ends; `ends_at` then says so."""
        return self._last_ns is None and any(each and each.count(":") == 1 for each in (self._begin, self._end))

    def ends_at(self, last_ns: int) -> None:
        """The log's last frame is at `last_ns`. Where nobody says so, 1:30 is a minute and a half into the log."""
        self._last_ns = last_ns

    def bounds(self, first_ns: int) -> tuple[float, float]:
        """(from, to) in ns of the log's clock; its first frame was at `first_ns`. Raises WrongUse for an empty one."""
        last_ns = first_ns if self._last_ns is None else self._last_ns
        low, high = (_seconds(each, first_ns, last_ns) for each in (self._begin, self._end))
        if low is not None and high is not None and low > high:
            raise WrongUse(f"--from {self._begin} is after --to {self._end}")
        return (
            -math.inf if low is None else first_ns + low * _SECOND_NS,
            math.inf if high is None else first_ns + high * _SECOND_NS,
        )

    def always(self) -> Part:
        """Return a part with the same messages, at all times."""
        return Part(ids=self._ids)

    def of(self, frames: Frames) -> Frames:
        """The frames of the part; the first ones ever given begin the log."""
        if not self or not len(frames):
            return frames
        if self._bounds is None:
            self._bounds = self.bounds(int(frames.t_ns[0]))
        inside = (frames.t_ns >= self._bounds[0]) & (frames.t_ns <= self._bounds[1])
        return frames.only(inside & self.has(frames.can_id) if self._ids is not None else inside)


def _seconds(text: str | None, first_ns: int, last_ns: int) -> float | None:
    """Return the seconds since the log's first frame. Raises ValueError for what is no time."""
    if text is None:
        return None
    clock = _CLOCK.fullmatch(text)
    if clock is None:
        minutes, _, seconds = text.rpartition(":")
        into_s = 60 * int(minutes or 0) + float(seconds)
        if not math.isfinite(into_s) or (minutes and not 0.0 <= float(seconds) < 60.0):
            raise ValueError(text)
        return into_s
    hour, minute, second = clock.groups()
    into_s = 60.0 * int(hour) + int(minute)
    if second is None and int(hour) > 23:
        return into_s
    first = datetime.fromtimestamp(first_ns / _SECOND_NS, timezone.utc)
    time_of_day = first.replace(hour=int(hour), minute=int(minute), second=0, microsecond=0)  # or a ValueError
    moment = time_of_day + timedelta(seconds=float(second or 0))
    if first - moment > timedelta(hours=12):  # a log over midnight
        moment += timedelta(days=1)
    since_s = (moment - first).total_seconds()
    has_minute = first_ns >= EPOCH_NS and -60.0 < since_s <= (last_ns - first_ns) / _SECOND_NS
    return since_s if second is not None or has_minute else into_s
