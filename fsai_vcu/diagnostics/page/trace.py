"""The driven path of this run, by rear wheels and steering, as the frames come."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable
from typing import Final

import numpy as np

from fsai_vcu.diagnostics.explain import signals as sig
from fsai_vcu.diagnostics.explain.record import Record
from fsai_vcu.diagnostics.log.frames import Frames, frames_of, joined
from fsai_vcu.diagnostics.monitor.state_history import LONG_NS, Memory
from fsai_vcu.diagnostics.page.curves import way_of

SPACING_M: Final = 0.5
POINTS: Final = 1000  # 500 m: a lap; older ones go
_IDS: Final = (sig.STATUS, sig.ANGLE.can_id, sig.WHEELS[0].can_id)


class DrawnLine:
    """Trace of the car, thinned out."""

    def __init__(self, *points: tuple[float, float]) -> None:
        self.points: deque[tuple[float, float]] = deque(points, maxlen=POINTS)

    def go_on(self, points: Iterable[tuple[float, float]]) -> None:
        """x, y (m)."""
        for point in points:
            if not self.points or math.dist(self.points[-1], point) >= SPACING_M:
                self.points.append(point)

    @property
    def way_cm(self) -> list[int]:
        """x, y, x, y, …"""
        return [round(100 * each) for point in list(self.points) for each in point]


class Trace:
    """`line` in a frame with its origin and x axis where the car began; `pose`: x, y (m), heading (rad).

    It begins again where AS_DRIVING begins, and where time went back; `run` counts that.
    """

    def __init__(self) -> None:
        self.run = 0
        self._t_ns: int | None = None
        self._begin(frames_of(()))

    def _begin(self, last: Frames) -> None:
        self.run += 1
        self.line = DrawnLine((0.0, 0.0))
        self.pose = (0.0, 0.0, 0.0)
        self._last = last  # the newest of each message

    def update(self, memory: Memory, revision: str) -> None:
        """Go on to the newest frame. Over more than LONG_NS frames are missing: then it begins again, too."""
        before_ns, self._t_ns = self._t_ns, memory.newest_ns or 0
        if before_ns is None or not 0 <= self._t_ns - before_ns <= LONG_NS:
            self._begin(frames_of(()))
            return
        frames = memory.window(self._t_ns, self._t_ns - before_ns)
        part = joined([self._last, frames.only(np.isin(frames.can_id, _IDS))])
        if not len(part):
            return
        states = Record(part, revision).series(sig.AS_STATE).spans
        runs = [span.begin_ns for span in states if span.value == sig.DRIVING and span.before is not None]
        if runs:
            self._begin(_newest(part.only(part.t_ns < runs[-1])))
            part = joined([self._last, part.only(part.t_ns >= runs[-1])])
        self._last = _newest(part)
        self._go_on(Record(part, revision))

    def _go_on(self, record: Record) -> None:
        way = way_of(record)
        if way is None:
            return
        x_m, y_m, heading = self.pose
        cos, sin = math.cos(heading), math.sin(heading)
        xs, ys = x_m + cos * way.x_m - sin * way.y_m, y_m + sin * way.x_m + cos * way.y_m
        self.line.go_on(zip(xs.tolist(), ys.tolist(), strict=True))
        self.pose = (float(xs[-1]), float(ys[-1]), heading + float(way.heading_rad[-1]))


def _newest(frames: Frames) -> Frames:
    newest = [np.flatnonzero(frames.can_id == can_id)[-1:] for can_id in _IDS]
    return frames.only(np.sort(np.concatenate(newest)))
