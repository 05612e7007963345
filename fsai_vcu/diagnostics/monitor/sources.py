"""Sources of pictures: a bus as it is now, or a log at any of its moments."""

from __future__ import annotations

import math
import time
from bisect import bisect_right
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import suppress
from dataclasses import replace
from datetime import datetime
from typing import Final, NamedTuple

import numpy as np

from fsai_vcu.diagnostics.explain.incident import TimelineEntry
from fsai_vcu.diagnostics.log.frames import Frames
from fsai_vcu.diagnostics.monitor.snapshot import Picture
from fsai_vcu.diagnostics.monitor.view import View
from fsai_vcu.interface.units import S

_RECENT_CHUNKS: Final = 8
_FAR_OFF_NS: Final = 60 * S  # a stamp so far from now is of a device's own clock
_LAG_NS: Final = S // 2


class TimedPicture(NamedTuple):
    """A picture, and the view that it is of. The time as a number for programs (s), and in words."""

    view: View
    picture: Picture
    time_s: float
    words: str


def lag_words(heard_ns: int, now_ns: int) -> str:
    """Say that a display has taken only what came until `heard_ns`; '' where that is near enough to the present."""
    lag_ns = now_ns - heard_ns
    return f"this display lags by {lag_ns / S:.1f} s: this machine is too busy" if lag_ns > _LAG_NS else ""


class Live:
    """A bus as it is now: a thread takes its frames. Ages are those of the monotonic clock: a step of the wall clock
    changes none. What is late or lost is judged at the time until which everything was taken: while this program gets
    no time to take frames, it says so, and not that the car is silent."""

    def __init__(
        self,
        chunks: Iterator[Frames],
        view: View,
        notice: Callable[[], str] = lambda: "",
        heard_ns: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        """notice: what there is to say of the link beside its frames, or ''. heard_ns: the last chunk holds everything
        until then (monotonic clock)."""
        self.playing = True
        self._notice = notice
        self._chunks = chunks
        self._view = view
        self._heard_ns = heard_ns
        self._shown_ns = time.monotonic_ns()
        self._waiting: deque[tuple[Frames, int]] = deque()
        self._held: TimedPicture | None = None
        self._stop = False
        self._receiving = ThreadPoolExecutor(1).submit(self._receive)

    @property
    def ended(self) -> bool:
        return self._receiving.done()

    def advance(self, seconds: float = 0.0) -> None:
        """Time goes on by itself; what came is taken."""
        while self._waiting:
            frames, self._shown_ns = self._waiting.popleft()
            self._view.update(frames)

    def wait(self, seconds: float) -> None:
        """Wait until that time is over, or the bus."""
        wait([self._receiving], seconds)

    def pause(self) -> None:
        """Hold the picture, or go on. Meanwhile nothing is lost."""
        now = self.look()
        self.playing = not self.playing
        self._held = None if self.playing else now._replace(view=now.view.copy(), words=f"paused at {now.words}")

    def look(self) -> TimedPicture:
        self.advance()
        if self._held:
            return self._held
        now_ns = time.monotonic_ns()
        picture = self._view.picture(self._shown_ns)
        notices = filter(None, (lag_words(self._shown_ns, now_ns), self._notice()))
        picture = replace(picture, link=(*picture.link, *notices))
        return TimedPicture(self._view, picture, time.time(), self.clock(picture.t_ns)[:8])

    def clock(self, t_ns: int) -> str:
        """The time of day."""
        return datetime.fromtimestamp(time.time() - (time.monotonic_ns() - t_ns) / S).strftime("%H:%M:%S.%f")[:-3]

    def events(self) -> list[TimelineEntry]:
        """Return the events until now."""
        return self._view.events()

    def close(self) -> None:
        """Close the bus; raise what ended it."""
        self._stop = True
        # It ends when the chunk now being taken is over; a second Ctrl-C changes nothing.
        while not self._receiving.done():
            with suppress(KeyboardInterrupt):
                wait([self._receiving])
        self._receiving.result()

    def _receive(self) -> None:
        for frames in self._chunks:
            if self._stop:
                break
            heard_ns = self._heard_ns()
            self._waiting.append((_on_our_clock(frames, time.time_ns(), time.monotonic_ns(), heard_ns), heard_ns))


def _on_our_clock(frames: Frames, wall_ns: int, now_ns: int, latest_ns: int) -> Frames:
    """Stamps of the wall clock (or of a device's own) as times of the monotonic clock, none after `latest_ns`."""
    if not len(frames):
        return frames
    newest_ns = int(frames.t_ns.max())
    reference_ns = wall_ns if abs(wall_ns - newest_ns) < _FAR_OFF_NS else newest_ns
    return frames.at(np.minimum(frames.t_ns - reference_ns + now_ns, latest_ns))


class PlayedLog:
    """A log at `position_ns`, read as far as was looked, and to its end where `findings` judge it.

    Before each chunk of it the view is kept: any moment takes one chunk and no more.
    """

    def __init__(
        self, chunks: Iterator[Frames], view: View, at_s: float | None, rate: float | None, *, keep: bool = True
    ) -> None:
        """Plays from its start or `at_s` on; where `rate` is None, it stands still at `at_s` or at its end.

        keep: it can be moved back in; else only the newest is held, however long it is.
        """
        self._keep = keep
        self._chunks = chunks
        self._view = view
        self._pieces: list[tuple[View, Frames]] = []
        self._rate = rate
        self._looked: TimedPicture | None = None
        self.findings: Callable[[int], Sequence[str]] | None = None  # up to a time; for what judges logs to be set
        self.playing = rate is not None
        self.empty = not self._read_to(-math.inf)
        self.begin_ns = self.position_ns = view.memory.begin_ns or 0
        if at_s is not None:
            self.seek(self.begin_ns + round(at_s * S))
        elif rate is None:
            self.seek(self.end_ns)
        self._played_from_ns = self.begin_ns if rate is None else self.position_ns

    @property
    def end_ns(self) -> int:
        """Time (ns) of the last frame: for that the whole log is read."""
        self.read_all()
        return self._view.memory.newest_ns or 0

    @property
    def ended(self) -> bool:
        """Nothing comes behind the position."""
        return not self._read_to(self.position_ns + 1)

    def read_all(self) -> None:
        """Read the log to its end."""
        self._read_to(math.inf)

    def seek(self, t_ns: int) -> None:
        """Go to that time, or to the end that is nearer."""
        self.position_ns = max(self.begin_ns, t_ns if self._read_to(t_ns) else self.end_ns)

    def advance(self, seconds: float) -> None:
        """Let so much of the viewer's time pass."""
        if self.playing:
            self.seek(self.position_ns + round(seconds * (self._rate or 1.0) * S))
            self.playing = not self.ended

    def wait(self, seconds: float) -> None:
        """Wait as the rate asks for."""
        if self._rate:
            time.sleep(seconds)

    def pause(self) -> None:
        """Hold the picture, or play on; at the end again."""
        self.playing = not self.playing
        if self.playing and self.ended:
            self.seek(self._played_from_ns)

    def look(self) -> TimedPicture:
        if self._looked is None or self._looked.picture.t_ns != self.position_ns:
            view, picture = self._at(self.position_ns)
            age_s = picture.as_state_s or 0.0
            if picture.as_state == "EMERGENCY_BRAKE" and age_s > 1.0 and view.emergency is not None:
                view.explain_as(self._at(self.position_ns - round((age_s - 1.0) * S))[0])
                picture = view.picture(self.position_ns)
            if self.findings:
                picture = replace(picture, findings=tuple(self.findings(self.position_ns)))
            words = f"{(self.position_ns - self.begin_ns) / S:.1f} s into the log"
            self._looked = TimedPicture(view, picture, self.position_ns / S, words)
        return self._looked

    def clock(self, t_ns: int) -> str:
        """Seconds since its first frame."""
        return f"{(t_ns - self.begin_ns) / S:.3f} s"

    def events(self) -> list[TimelineEntry]:
        """Return the events of the whole log."""
        self.read_all()
        return self._view.events()

    def close(self) -> None:
        """Do nothing: there is nothing to be closed."""

    def _at(self, t_ns: int) -> tuple[View, Picture]:
        place = bisect_right(self._pieces, t_ns, key=lambda piece: int(piece[1].t_ns[0])) - 1
        before, frames = self._pieces[max(0, place)]
        view = before.copy()
        view.update(frames.head(int(np.searchsorted(frames.t_ns, t_ns, side="right"))))
        return view, view.picture(t_ns)

    def _read_to(self, t_ns: float) -> bool:
        """Return true where there is a frame at that time or later, as far as reading on tells."""
        memory = self._view.memory
        while memory.newest_ns is None or memory.newest_ns < t_ns:
            frames = next(self._chunks, None)
            if frames is None:
                return False
            if len(frames):
                before = self._view.copy()
                self._pieces.append((before, self._view.update(frames)))
                if not self._keep:
                    del self._pieces[:-_RECENT_CHUNKS]
        return True


Source = Live | PlayedLog
