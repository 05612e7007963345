"""The recording itself: candump segments, an MCAP beside each, and a sidecar that says what was in force.

A candump log has no place for remarks that all of its readers survive (python-can's does not), so what belongs to a
segment without being a frame is in a JSON file of the same name: interface, revision, operational limits with their
content, when it began and ended.
"""

from __future__ import annotations

import errno
import json
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from fsai_vcu.diagnostics.decode.decoder import Decoder
from fsai_vcu.diagnostics.export.tables import Tables
from fsai_vcu.diagnostics.log.frames import frames_of
from fsai_vcu.diagnostics.log.live import Received, log_frame
from fsai_vcu.diagnostics.log.recorded import LOST_HERE
from fsai_vcu.diagnostics.recorder.durable import DurableFile, replace_durably
from fsai_vcu.diagnostics.recorder.repair import repair_mcap, repair_text
from fsai_vcu.diagnostics.recorder.segments import SegmentFolder
from fsai_vcu.runtime.recording import candump_line

if TYPE_CHECKING:
    from fsai_vcu.diagnostics.export.mcap_file import McapTables, RosMessage

AGAIN_NS: Final = 1_000_000_000
"""Pause (ns) before the next try after a write that failed."""

_MOST_WAITING: Final = 200_000  # frames kept for a disk that takes nothing: two minutes of a busy bus
_PART: Final = 20_000  # frames written in one go
_NO_ROOM: Final = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG, None})


@dataclass
class _Segment:
    """`opened` are its files, the log first. tables, writer: of the MCAP, if there is one."""

    opened: ExitStack
    files: list[DurableFile]
    about: dict[str, Any]
    sidecar: Path
    began_ns: int
    tables: Tables | None = None
    writer: McapTables | None = None
    frames: int = 0
    dropped: int = 0  # before it began, see Recording
    unpushed: int = 0  # of these, frames that are not on the disk yet

    def open(self, path: Path) -> DurableFile:
        file = DurableFile(path)
        self.opened.callback(file.close)
        self.files.append(file)
        return file


class Recording:
    """Takes what was received; `turn` has it on the disk. Not thread-safe."""

    def __init__(
        self,
        place: SegmentFolder,
        bus: str,
        about: Mapping[str, Any],
        report: Callable[[str], None],
        *,
        decoder: Decoder | None = None,
        wall_ns: Callable[[], int],
        now_ns: int,
    ) -> None:
        """Begin a recording. about: for the sidecars. decoder: an MCAP is written too. Raises OSError where nothing can
        be written.
        """
        self._place = place
        self._bus = bus
        self._about = dict(about)
        self._report = report
        self._decoder = decoder
        self._wall_ns = wall_ns
        self._frames: deque[Received] = deque(maxlen=_MOST_WAITING)
        self._messages: deque[RosMessage] = deque(maxlen=_MOST_WAITING)
        self._channels = [bus]
        self._again_ns: int | None = None
        self.taken = 0
        self.messages = 0
        self.lost = 0
        self.dropped = 0  # frames that never came here, for the kernel had no room for them: the listener knows
        self._repair_last()
        self._segment: _Segment | None = self._begin(now_ns)

    @property
    def in_trouble(self) -> bool:
        return self._again_ns is not None

    def take(self, received: Sequence[Received]) -> None:
        self.lost += max(0, len(self._frames) + len(received) - _MOST_WAITING)
        self._frames.extend(received)

    def take_messages(self, messages: Sequence[RosMessage]) -> None:
        self._messages.extend(messages)

    def turn(self, now_ns: int) -> None:
        """Put everything taken so far on the disk; a failure is reported once, and the write is tried again later."""
        if self._again_ns is not None and now_ns < self._again_ns:
            return
        try:
            self._write(now_ns)
        except OSError as error:
            self._fail(error, now_ns)
            return
        if self._again_ns is not None:
            self._again_ns = None
            lost = f"; {self.lost} frames were lost" if self.lost else ""
            self._report(f"writing again in {self._place.path}{lost}")

    def close(self, now_ns: int) -> None:
        """Write what waits, and end the files properly, as far as the disk lets."""
        self._again_ns = None if self._again_ns is None else now_ns
        self.turn(now_ns)
        segment = self._segment
        with suppress(OSError):  # a disk that takes no more: reported, and what is there is whole
            self._end()
        if segment is not None:
            self._count_lost(segment)
        self.lost += len(self._frames)
        self._place.close()

    # ------------------------------------------------------------ segments

    def _repair_last(self) -> None:
        """A power cut may have torn the newest segment."""
        place = self._place
        if place.single or not place.number:
            return
        log = place.file(".log")
        with self._left_as_it_is(log):
            if cut := repair_text(log):
                self._report(f"{log} was cut off in its last line: {cut} bytes removed")
        # A disk that was full can have left any of them without an end.
        for mcap in place.all_files(".mcap") if self._decoder is not None else ():
            with self._left_as_it_is(mcap):
                if (repaired := repair_mcap(mcap)) is not None:
                    removed = f", {repaired} bytes removed" if repaired else ""
                    self._report(f"{mcap} had no end; an end was added{removed}")

    @contextmanager
    def _left_as_it_is(self, path: Path) -> Iterator[None]:
        """Let a recording begin beside files that cannot be repaired, or are no recorder's."""
        try:
            yield
        except FileNotFoundError:
            pass
        except OSError as error:
            self._report(f"{path} is left as it is: {error.strerror or error}")

    def _begin(self, now_ns: int) -> _Segment:
        """Begin a segment: make room, write its sidecar, and open its files."""
        place = self._place
        place.begin_segment()
        place.make_room(0)
        now = {
            "segment": place.number or 1,
            "began": _date(self._wall_ns()),
            "ended": None,
            "frames": None,
            LOST_HERE: None,
        }
        about = self._about | now
        replace_durably(place.file(".json"), _text(about))
        with ExitStack() as opened:
            segment = _Segment(opened, [], about, place.file(".json"), now_ns, dropped=self.dropped)
            segment.open(place.file(".log"))
            if self._decoder is not None:
                from fsai_vcu.diagnostics.export.mcap_file import McapTables

                mcap = segment.open(place.file(".mcap"))
                words = {name: value if isinstance(value, str) else json.dumps(value) for name, value in about.items()}
                segment.tables, segment.writer = Tables(self._decoder, several_buses=False), McapTables(mcap, words)
                mcap.push()
            segment.opened = opened.pop_all()
        return segment

    def _end(self) -> None:
        """End the segment. Raises OSError; the segment is closed all the same."""
        segment, self._segment = self._segment, None
        if segment is None:
            return
        with segment.opened:
            if segment.writer is not None:
                segment.writer.finish()
            for file in segment.files:
                file.push()
            lost = self.dropped - segment.dropped
            segment.about.update({"ended": _date(self._wall_ns()), "frames": segment.frames, LOST_HERE: lost})
            replace_durably(segment.sidecar, _text(segment.about))

    def _over(self, segment: _Segment, now_ns: int) -> bool:
        bounds = self._place.bounds
        if self._place.single or not segment.frames:
            return False
        most = self._place.segment_bytes
        return (most is not None and sum(file.tell() for file in segment.files) >= most) or (
            bounds.segment_ns is not None and now_ns - segment.began_ns >= bounds.segment_ns
        )

    # ------------------------------------------------------------ writing

    def _write(self, now_ns: int) -> None:
        """Write what waits, and go from segment to segment as their bounds ask for."""
        while True:
            segment = self._segment
            if segment is not None:
                if any(file.removed for file in segment.files):
                    self._segment = None
                    self._count_lost(segment)
                    segment.opened.close()
                    self._report(f"{segment.files[0].path} has been deleted; going on in a new one")
                    continue
                if any(file.waiting for file in segment.files):
                    self._push(segment)
            if not (self._frames or self._messages):
                return
            if segment is not None and self._over(segment, now_ns):
                self._end()
                continue
            if segment is None:
                if self._place.single and self._place.path.exists():
                    raise FileExistsError(errno.EEXIST, "this recording ended and cannot be continued")
                segment = self._segment = self._begin(now_ns)
            self._put(segment)
            self._push(segment)

    def _push(self, segment: _Segment) -> None:
        self._place.make_room(sum(file.waiting for file in segment.files))
        for file in segment.files:
            file.push()
        segment.unpushed = 0

    def _put(self, segment: _Segment) -> None:
        """Write some of what waits to the segment's files, from where no full disk can lose it."""
        taken = [self._frames.popleft() for _ in range(min(_PART, len(self._frames)))]
        lines = "".join(f"{candump_line(frame, self._bus, stamp_ns)}\n" for frame, stamp_ns in taken)
        segment.files[0].write(lines.encode("ascii"))
        segment.frames += len(taken)
        segment.unpushed += len(taken)
        self.taken += len(taken)
        if segment.writer is None or segment.tables is None:
            return
        frames = frames_of((log_frame(each, self._bus) for each in taken), self._channels)
        segment.writer.write_together(list(segment.tables.rows(frames)))
        while self._messages:
            segment.writer.write_message(self._messages.popleft())
            self.messages += 1
        segment.writer.flush()

    def _fail(self, error: OSError, now_ns: int) -> None:
        if self._again_ns is None:
            reason = error.strerror or str(error)
            self._report(f"cannot write in {self._place.path}: {reason}; trying again every second")
        self._again_ns = now_ns + AGAIN_NS
        segment = self._segment
        if error.errno not in _NO_ROOM and segment is not None and not self._place.single:
            # Not a matter of room: these files may be lost, a new one need not.
            self._segment = None
            self._count_lost(segment)
            segment.opened.close()

    def _count_lost(self, segment: _Segment) -> None:
        """Count the frames that wait for a file into which nothing more is written."""
        if segment.files[0].waiting:
            self.lost += segment.unpushed
            self.taken -= segment.unpushed
            segment.unpushed = 0


def _date(wall_ns: int) -> str:
    return datetime.fromtimestamp(wall_ns / 1e9, timezone.utc).isoformat(timespec="milliseconds")


def _text(about: Mapping[str, Any]) -> str:
    return json.dumps(about, indent=2, ensure_ascii=False) + "\n"
