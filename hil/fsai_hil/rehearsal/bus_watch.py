"""A watch on the bus of a rehearsal, by candump: while it is logged, and of the log."""

from __future__ import annotations

import math
import os
import shutil
import signal
import subprocess
import time
from collections.abc import Callable, Iterable, Mapping
from itertools import pairwise
from pathlib import Path
from typing import TypeVar

from fsai_hil.rehearsal.stack import await_condition, holds_within
from fsai_hil.rules.checker import checker_for
from fsai_hil.rules.response import ResponseTimes
from fsai_vcu.interface.codec import Codec
from fsai_vcu.interface.enums import AsState
from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.messages import AiBrake, AiDriveFront, AiDriveRear, AiStatus, VcuStatus, WheelSpeeds
from fsai_vcu.interface.revisions import revision
from fsai_vcu.interface.specification import STANDING_RPM

CODEC = Codec(revision("2026"))
HOUR_NS = 3600 * 1_000_000_000
_BUFFER_BYTES = 16 << 20  # ten seconds of a full bus: everything else here goes before the logger
_LISTENS_S = 60.0
_DRAINED_S = 0.1  # when nothing has come for so long, nothing is left to come
_POLL_S = 0.05

Image = TypeVar("Image", AiStatus, AiDriveFront, AiDriveRear, AiBrake, VcuStatus, WheelSpeeds)


def listeners(interface: str) -> int:
    """Return how many filters of all sockets are on the interface, as the kernel counts them."""
    return sum(path.read_text().split().count(interface) for path in Path("/proc/net/can").glob("rcvlist_*"))


def send_signal(pid: int, number: signal.Signals) -> tuple[int, int]:
    """Send a signal; return when, at the earliest, by the clock of the bus log, and how much later it may have been."""
    before_ns = time.time_ns()
    os.kill(pid, number)
    return before_ns, time.time_ns() - before_ns


class Wire:
    """Frames in the order of the bus, and what they show. Every time is in nanoseconds."""

    def __init__(self, frames: Iterable[Frame] = ()) -> None:
        self._frames = list(frames)

    @property
    def frames(self) -> list[Frame]:
        return self._frames

    def images(self, kind: type[Image], since_ns: int = 0) -> list[tuple[int, Image]]:
        """Each message of a kind, decoded, and when it was on the bus."""
        can_id = CODEC.encode(kind()).can_id
        wanted = [frame for frame in self.frames if frame.can_id == can_id and frame.t_ns >= since_ns]
        decoded = [(frame.t_ns, CODEC.decode(frame).image) for frame in wanted]
        return [(t_ns, image) for t_ns, image in decoded if isinstance(image, kind)]

    def first(self, kind: type[Image], since_ns: int, condition: Callable[[Image], bool] = lambda _: True) -> float:
        """Return how long after `since_ns` the first of this kind with `condition` was on the bus; infinite if none."""
        return next((t_ns - since_ns for t_ns, image in self.images(kind, since_ns) if condition(image)), math.inf)

    def estop_after(self, since_ns: int) -> float:
        return self.first(AiStatus, since_ns, lambda status: status.estop_request)

    def brakes_after(self, since_ns: int) -> float:
        return self.first(AiBrake, since_ns, lambda brake: brake.front_pct > 0)

    def torque_ends(self, since_ns: int) -> int:
        """Return how long after `since_ns` torque was last asked for; 0 if it was not."""
        front = [(t_ns, image.torque_nm) for t_ns, image in self.images(AiDriveFront, since_ns)]
        rear = [(t_ns, image.torque_nm) for t_ns, image in self.images(AiDriveRear, since_ns)]
        return max((t_ns - since_ns for t_ns, torque_nm in (*front, *rear) if torque_nm > 0), default=0)

    def rests_after(self, since_ns: int) -> float:
        """Time after `since_ns` from which the car stands to the end; infinite if it moves then or no wheel is seen."""
        wheels = self.images(WheelSpeeds, since_ns)
        if not wheels or not standing(wheels[-1][1]):
            return math.inf
        return max((t_ns - since_ns for t_ns, image in wheels if not standing(image)), default=0)

    def longest_gap(self, since_ns: int) -> int:
        """Return the longest time between two frames with the AI computer's status, in ns; 0 where there are none."""
        times = [t_ns for t_ns, _ in self.images(AiStatus, since_ns)]
        return max((later - earlier for earlier, later in pairwise(times)), default=0)


def responses_in(
    frames: Iterable[Frame], codec: Codec, windows: Mapping[str, tuple[float, float]]
) -> dict[str, tuple[ResponseTimes, list[str]]]:
    """Return how long echoes took in each window, by the stamps of both frames, and the rules that were broken there.

    windows: from and to, by the clock of the frames; they follow one another.
    """
    checker, remaining, found = checker_for(codec, busy_machine=True), iter(frames), {}
    for name, window in windows.items():
        for until_ns in window:
            checker.responses, known = ResponseTimes(), len(checker.violations)
            for frame in remaining:
                checker.on_frame(frame)
                if frame.t_ns >= until_ns:
                    break
        found[name] = checker.responses, list(checker.violations[known:])
    return found


def standing(wheels: WheelSpeeds) -> bool:
    return fastest_rpm(wheels) < STANDING_RPM


def fastest_rpm(wheels: WheelSpeeds) -> float:
    return max(map(abs, wheels.all_rpm))


class BusWatch(Wire):
    """Everything (or these ids `only`) that passes on the bus from now on, by a clock that is never stepped.

    The log is in memory at `path` first, for candump writes each line by itself, and in the end at `kept`.
    """

    def __init__(self, interface: str, path: Path, kept: Path | None = None, only: Iterable[int] = ()) -> None:
        super().__init__()
        self.path = path
        self._kept = kept
        self._read_bytes = 0
        self._began_ns = time.time_ns()
        self.as_state: AsState | None = None
        self.fastest_rpm = 0.0
        before = listeners(interface)
        filters = "".join(f",{can_id:X}:7FF" for can_id in only)
        command = ["candump", "-L", "-D", "-r", str(_BUFFER_BYTES), interface + filters]
        with path.open("wb") as file:
            self._candump = subprocess.Popen(command, stdout=file, stdin=subprocess.DEVNULL)
        await_condition(lambda: listeners(interface) > before, _LISTENS_S, "candump listens")

    @property
    def frames(self) -> list[Frame]:
        """All until now; error frames and remote ones are no part of it."""
        now_ns, grown_s = self._unstepped(time.time_ns()), time.monotonic()
        while time.monotonic() - grown_s < _DRAINED_S:
            if self.read():
                grown_s = time.monotonic()
            if self._candump.poll() is not None or (self._frames and self._frames[-1].t_ns >= now_ns):
                break
            time.sleep(_POLL_S / 5)
        return self._frames

    def _unstepped(self, t_ns: int) -> int:
        """Steps of the wall clock are whole hours here."""
        return t_ns - round((t_ns - self._began_ns) / HOUR_NS) * HOUR_NS

    def read(self) -> bool:
        """Read on in the log; whether there was more of it."""
        with self.path.open("rb") as log:
            log.seek(self._read_bytes)
            whole, newline, _ = log.read().rpartition(b"\n")
        self._read_bytes += len(whole + newline)
        newest: dict[int, Frame] = {}
        for line in whole.splitlines():
            stamp, _, text = line.split()[:3]
            can_id, _, data = text.partition(b"#")
            if data.startswith(b"R") or (len(can_id) == 8 and can_id[:1] >= b"2"):
                continue
            seconds, _, micros = stamp[1:-1].partition(b".")
            t_ns = self._unstepped((int(seconds) * 1_000_000 + int(micros)) * 1000)
            frame = Frame(int(can_id, 16), bytes.fromhex(data.decode()), t_ns, extended=len(can_id) == 8)
            self._frames.append(frame)
            newest[frame.can_id] = frame
        for frame in newest.values():
            image = CODEC.decode(frame).image
            if isinstance(image, VcuStatus):
                self.as_state = image.as_state
            elif isinstance(image, WheelSpeeds):
                self.fastest_rpm = fastest_rpm(image)
        return bool(newline)

    def wait(self, condition: Callable[[], bool], patience_s: float) -> bool:
        """Watch until `condition` holds; False when it does not in time."""

        def holds() -> bool:
            self.read()
            return condition()

        return holds_within(holds, patience_s, lambda: time.sleep(_POLL_S))

    def at_rest_in(self, state: AsState) -> bool:
        return self.as_state is state and self.fastest_rpm < STANDING_RPM

    def stop(self) -> None:
        """The log is complete, and where it is kept. Idempotent."""
        self._candump.terminate()
        self._candump.wait()
        if self._kept is not None and self.path != self._kept:
            shutil.move(self.path, self._kept)
            self.path = self._kept
