"""The way driven in this run, by rear wheels and steering, as the frames come."""

from __future__ import annotations

import math
from collections import deque
from typing import Final

import numpy as np

from fsai_vcu.diagnostics.explain import signals as sig
from fsai_vcu.diagnostics.explain.record import Record
from fsai_vcu.diagnostics.log.frames import Frames, frames_of, joined
from fsai_vcu.diagnostics.monitor.snapshot import Picture
from fsai_vcu.diagnostics.monitor.state_history import LONG_NS, Memory
from fsai_vcu.diagnostics.report.curves import way_of

SPACING_M: Final = 0.5
POINTS: Final = 1000  # 500 m: a lap; older ones go
_IDS: Final = (sig.ANGLE.can_id, sig.WHEELS[0].can_id)


class Trace:
    """`points` x, y (m) in a frame with its origin and x axis where the car began; pose: x, y (m), heading (rad)."""

    def __init__(self) -> None:
        self._t_ns: int | None = None
        self._state: str | None = None
        self._begin()

    def _begin(self) -> None:
        self.points: deque[tuple[float, float]] = deque([(0.0, 0.0)], maxlen=POINTS)
        self.pose = (0.0, 0.0, 0.0)
        self._last: Frames = frames_of(())  # the newest of each message

    def update(self, memory: Memory, picture: Picture) -> None:
        """Go on to the newest frame; anew where AS_DRIVING begins, and where time went back."""
        before_ns, self._t_ns = self._t_ns, memory.newest_ns or 0
        before, self._state = self._state, picture.as_state_heard
        begins = self._state == "AS_DRIVING" and before not in (None, "AS_DRIVING")
        if before_ns is None or begins or self._t_ns < before_ns:
            self._begin()
            return
        frames = memory.window(self._t_ns, min(self._t_ns - before_ns, LONG_NS))
        part = joined([self._last, frames.only(np.isin(frames.can_id, _IDS))])
        if len(part):
            newest = [np.flatnonzero(part.can_id == can_id)[-1:] for can_id in _IDS]
            self._last = part.only(np.sort(np.concatenate(newest)))
            self._go_on(Record(part, picture.revision))

    def _go_on(self, record: Record) -> None:
        way = way_of(record)
        if way is None:
            return
        x_m, y_m, heading = self.pose
        cos, sin = math.cos(heading), math.sin(heading)
        xs, ys = x_m + cos * way.x_m - sin * way.y_m, y_m + sin * way.x_m + cos * way.y_m
        for x_m, y_m in zip(xs.tolist(), ys.tolist(), strict=True):
            if math.dist(self.points[-1], (x_m, y_m)) >= SPACING_M:
                self.points.append((x_m, y_m))
        self.pose = (x_m, y_m, heading + float(way.heading_rad[-1]))
