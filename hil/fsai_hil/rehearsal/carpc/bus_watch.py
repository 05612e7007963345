"""What the bus of the rehearsed car PC shows."""

from __future__ import annotations

import subprocess
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

from fsai_vcu.interface.codec import Codec
from fsai_vcu.interface.enums import AsState
from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.messages import AiBrake, AiDriveFront, AiDriveRear, AiStatus, VcuStatus, WheelSpeeds
from fsai_vcu.interface.reserved import AI_IDS
from fsai_vcu.interface.revisions import revision
from fsai_vcu.interface.specification import COMMS_LOST_NS, STANDING_RPM

CODEC = Codec(revision("2026"))
HOUR_NS = 3600 * 1_000_000_000
AI_STATUS = min(AI_IDS)
_VCU_STATUS, _WHEELS = 0x520, 0x525
_BUFFER_BYTES = 16 << 20
_POLL_S = 0.05


@dataclass(frozen=True, slots=True)
class Seen:
    """One frame of the bus, decoded; the time is the wall clock's."""

    t_ns: int
    image: object


class BusWatch:
    """Everything that passes on the bus from now on, by candump; read while it grows."""

    def __init__(self, interface: str, path: Path) -> None:
        self.path = path
        self._writing = path.open("wb")
        command = ["candump", "-L", "-D", "-r", str(_BUFFER_BYTES), interface]
        self._candump = subprocess.Popen(command, stdout=self._writing, stdin=subprocess.DEVNULL)
        self._reading = path.open("rb")
        self._part = b""
        self._began_ns = time.time_ns()
        self.frames: list[Frame] = []  # of the AI computer, and 0x520 and 0x525
        self.as_state: AsState | None = None
        self.fastest_rpm = 0.0
        self.received_s = time.monotonic()  # when 0x520 was last received

    def read(self) -> None:
        *lines, self._part = (self._part + self._reading.read()).split(b"\n")
        newest: dict[int, Frame] = {}
        for line in lines:
            stamp, _, text = line.split()[:3]
            can_id, _, data = text.partition(b"#")
            if len(can_id) != 3 or (number := int(can_id, 16)) not in (*AI_IDS, _VCU_STATUS, _WHEELS):
                continue
            seconds, _, micros = stamp[1:-1].partition(b".")
            t_ns = (int(seconds) * 1_000_000 + int(micros)) * 1000
            # By a clock that was never stepped: steps are whole hours here.
            t_ns -= round((t_ns - self._began_ns) / HOUR_NS) * HOUR_NS
            frame = Frame(number, bytes.fromhex(data.decode()), t_ns)
            self.frames.append(frame)
            newest[number] = frame
        if _VCU_STATUS in newest:
            status = CODEC.decode(newest[_VCU_STATUS]).image
            assert isinstance(status, VcuStatus)
            self.as_state, self.received_s = status.as_state, time.monotonic()
        if _WHEELS in newest:
            self.fastest_rpm = fastest_rpm(CODEC.decode(newest[_WHEELS]).image)

    def wait(self, condition: Callable[[], bool], patience_s: float) -> bool:
        """Watch until `condition` holds; False when it does not in time."""
        until = time.monotonic() + patience_s
        while True:
            self.read()
            if condition():
                return True
            if time.monotonic() >= until:
                return False
            time.sleep(_POLL_S)

    def silent_for_s(self) -> float:
        """So long no 0x520 has been received."""
        return time.monotonic() - self.received_s

    def at_rest_in(self, state: AsState) -> bool:
        return self.as_state is state and self.fastest_rpm < STANDING_RPM

    def since(self, t_ns: int) -> list[Seen]:
        """What was on the bus since then, decoded."""
        self.read()
        return [Seen(frame.t_ns, CODEC.decode(frame).image) for frame in self.frames if frame.t_ns >= t_ns]

    def close(self) -> None:
        self._candump.terminate()
        self._candump.wait()
        self._writing.close()
        self.read()
        self._reading.close()


def fastest_rpm(image: object) -> float:
    assert isinstance(image, WheelSpeeds)
    return max(map(abs, image.all_rpm))


def torque_ends_s(seen: list[Seen], since_ns: int) -> float:
    """How long after `since_ns` torque was last asked for; 0 if it was not."""
    drives = ((each.t_ns, each.image) for each in seen)
    asked = [t_ns for t_ns, image in drives if isinstance(image, AiDriveFront | AiDriveRear) and image.torque_nm > 0]
    return (max(asked) - since_ns) / 1e9 if asked else 0.0


def first_s(seen: list[Seen], since_ns: int, condition: Callable[[object], bool]) -> float | None:
    """How long after `since_ns` the first of them with `condition` was on the bus."""
    return next(((each.t_ns - since_ns) / 1e9 for each in seen if condition(each.image)), None)


def in_state(*states: AsState) -> Callable[[object], bool]:
    return lambda image: isinstance(image, VcuStatus) and image.as_state in states


def standing(image: object) -> bool:
    return isinstance(image, WheelSpeeds) and fastest_rpm(image) < STANDING_RPM


def rest_s(seen: list[Seen], since_ns: int) -> float | None:
    """How long after `since_ns` the car stood for good; None if it still moves in the end, or no wheel was seen."""
    wheels = [each for each in seen if isinstance(each.image, WheelSpeeds)]
    moving = [each.t_ns for each in wheels if not standing(each.image)]
    if not wheels or not standing(wheels[-1].image):
        return None
    return (max(moving) - since_ns) / 1e9 if moving else 0.0


def wants_emergency(image: object) -> bool:
    return isinstance(image, AiStatus) and image.estop_request


def brakes(image: object) -> bool:
    return isinstance(image, AiBrake) and image.front_pct > 0


def longest_gap_s(seen: list[Seen]) -> float:
    """Between two frames with the AI computer's status."""
    times = [each.t_ns for each in seen if isinstance(each.image, AiStatus)]
    return max((later - earlier for earlier, later in pairwise(times)), default=0) / 1e9


def car_was_deaf(frames: Sequence[Frame]) -> bool:
    """The simulated VCU raised AI_COMMS_LOST although every message of the AI computer, and its echo, was on the bus.

    It was too busy to take them in: such a run shows nothing, neither for nor against the AI computer.
    """
    lost = next((frame for frame in frames if frame.can_id == _VCU_STATUS and _comms_lost(frame)), None)
    if lost is None:
        return False
    since_ns = lost.t_ns - COMMS_LOST_NS
    before = [frame for frame in frames if since_ns <= frame.t_ns < lost.t_ns]
    for can_id in AI_IDS:
        times = [since_ns, *(frame.t_ns for frame in before if frame.can_id == can_id), lost.t_ns]
        if max(later - earlier for earlier, later in pairwise(times)) >= COMMS_LOST_NS // 2:
            return False
    return _echoed([CODEC.decode(frame).image for frame in before])


def _echoed(images: list[object]) -> bool:
    """At least one status of the AI computer has the handshake bit that the VCU had sent before it."""
    bit: bool | None = None
    for image in images:
        if isinstance(image, VcuStatus):
            bit = image.handshake
        elif isinstance(image, AiStatus) and image.handshake is bit:
            return True
    return False


def _comms_lost(frame: Frame) -> bool:
    status = CODEC.decode(frame).image
    return isinstance(status, VcuStatus) and status.faults.ai_comms_lost is True
