"""The rules on the wire, judged by one who stands beside the bus and knows nothing of supervisor and gate.

`WireChecker` is fed with what was on the bus, of the car and of the AI computer, in the order of time: as frames, or as
their decoded images. That is enough for a log. Who drives the process itself also passes on what the process is given
(commands, modes, confirmations, lost buses) by a `Process`; what can be known only so is checked only then. And where
nothing is hidden that can stop a drive (`nothing_hidden`), each output has exactly one right value, and is held to it.

`bus_view.py` is what is known, `reactions.py` what is due, `frame_rules.py` the rules, `numbers.py` their numbers.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, Final

from fsai_hil.rules.bus_view import HEEDED_IDS, OFF, RESTART_GAP_NS
from fsai_hil.rules.frame_rules import CHECKS, RULES
from fsai_hil.rules.numbers import CAR_PATIENCE_NS, MS, S
from fsai_hil.rules.reactions import Reactions
from fsai_hil.rules.seen import Violation
from fsai_vcu.diagnostics.log.frames import LogFrame
from fsai_vcu.diagnostics.log.reader import LogError, open_log
from fsai_vcu.interface.bus_table import BY_ID
from fsai_vcu.interface.codec import Codec, Decoded
from fsai_vcu.interface.enums import MissionStatus
from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.messages import AiBrake, AiDriveFront, AiDriveRear, AiImage, AiStatus, AiSteer, Image
from fsai_vcu.interface.reserved import AI_IDS

from cantools.database.errors import EncodeError  # isort: skip  after ours, which load no more of cantools than needed

__all__ = ["MS", "RULES", "WireChecker", "check_candump", "checker_for", "read_candump"]

STATUS_ID: Final = 0x520
AXLES: Final = (AiDriveFront, AiDriveRear)
_DIGITS: Final = re.compile(r"[\d.,]+")


class WireChecker(Reactions):
    """Feed it with `on_frame`; read what was found at any time: `ok` means that no rule was seen broken. Times are ns.

    `handshake_in_flight_ns` is how young a 0x520 may be and not yet be echoed; `clock_slack_ns` covers the difference
    between a sender's clock reading and the time stamp on the bus. All three at 0 is the view of the sender itself.

    `car` and `limits` add what rule 4 says of steering rate, driven axles and the venue. `from_start`: the first frame
    is the first that the sending process could receive, and `restarted` says when another takes its place; without it
    what was before the log is not judged. `motor_brakes`: the car on which torque against a motor speed limit of zero
    is the brake, which rule 2 does not mean. `short_sequence`: the car whose VCU does not keep to the 5 s in AS_READY.

    With a `process` the caller passes on what the process is given and asked, by the methods `on_…`, and when a cycle
    is over (`simulator.watched_bridge` does). An intruder on the AI computer's own ids cannot be told apart on a log; a
    caller who knows it keeps its frames from `on_frame`, or uses `received` and `sent`.
    """

    # ------------------------------------------------------------ what was found

    @property
    def violations(self) -> list[str]:
        """Say what broke a rule, with its time in the log."""
        start_ns = self.start_ns or 0
        return [
            f"{(t_ns - start_ns) / S:.3f} s: {'rule ' if one.rule.isdigit() else ''}{one.rule}: {one.words}"
            for t_ns, one in self.found
        ]

    @property
    def ok(self) -> bool:
        return self.violation_count == 0

    def __str__(self) -> str:
        """Print the figures of the log, then what was odd and every broken rule."""
        start_ns = self.start_ns or 0
        states = ", ".join(f"{state.label} at {(t_ns - start_ns) / S:.3f} s" for t_ns, state in self.as_states)
        lines = [
            f"{self.frames} frames in {(self.now_ns - start_ns) / S:.3f} s, {self.cycles} command cycles"
            f" ({self.incomplete} incomplete), {self.error_frames} error frames",
            f"AS states: {states or 'none received'}",
        ]
        if len(self.responses):
            shares = {"p50": 0.5, "p99": 0.99, "p99.9": 0.999, "max": 1.0}
            times = (f"{name} {self.responses.quantile_ms(share):.2f} ms" for name, share in shares.items())
            lines.append(f"response time: {len(self.responses)} echoes, {', '.join(times)}")
        lines += [f"{count} x {problem}" for problem, count in self._problems.items()]
        lines += self.violations or ["no rule broken"]
        if self.violation_count > len(self.found):
            lines.append(f"… and {self.violation_count - len(self.found)} more")
        return "\n".join(lines)

    def taken(self) -> tuple[Violation, ...]:
        """Return what has been found since the last time, which is forgotten."""
        found, self._broken = tuple(one for _, one in self.found), {}
        self.found = []
        return found

    def _judge(self, kind: str, image: Any, can_id: int) -> None:
        """Hold a frame against its rules: what turns wrong is reported once, not for as long as it stays."""
        wrong: set[str] = set()
        before = self._broken.get((kind, can_id), ())
        for rule, check in CHECKS[self.process is not None][kind]:
            for words in check(self, image):
                key = rule + _DIGITS.sub("", words)
                if key not in wrong and key not in before:
                    self.wrong(rule, words)
                wrong.add(key)
        if wrong or before:
            self._broken[kind, can_id] = wrong

    # ------------------------------------------------------------ what is on the bus

    def on_frames(self, frames: Iterable[Frame]) -> None:
        """Frames of the bus, in the order of time."""
        sound = self._sound
        for frame in frames:
            if sound.get(frame.can_id) == frame.data and not (frame.extended or frame.remote or frame.error):
                self.now_ns = frame.t_ns
                self.frames += 1
            else:
                self.on_frame(frame)

    def on_frame(self, frame: Frame) -> Image | None:
        """One frame of the bus, at `frame.t_ns`. Returns what it carries, None for nothing that may be believed."""
        if self.start_ns is None:
            self.start_ns = frame.t_ns
        self.now_ns = frame.t_ns
        self.frames += 1
        if frame.error:
            self.error_frames += 1
            return None
        if frame.extended or frame.remote or frame.can_id not in self._known_ids:
            self._strange(frame)
            return None
        decoded = self.codec.decode(frame)
        if frame.can_id in HEEDED_IDS or decoded.problems:
            return self.on_decoded(frame.can_id, decoded, frame.t_ns)
        self._sound[frame.can_id] = frame.data
        return decoded.image

    def on_decoded(self, can_id: int, decoded: Decoded, t_ns: int) -> Image | None:
        """The same, decoded already."""
        self.now_ns = t_ns
        image = decoded.image
        for problem in decoded.problems:
            self._problems[problem] += 1
        if can_id == STATUS_ID:
            self.on_any_status(decoded, t_ns)
        if can_id in AI_IDS:
            if image is None:
                self.wrong("7", f"0x{can_id:03X} cannot be believed: {'; '.join(decoded.problems)}")
            else:
                self.on_ai(can_id, image, t_ns)  # type: ignore[arg-type]
            return image
        self.on_car(image, t_ns)
        return image

    def _strange(self, frame: Frame) -> None:
        """Safety rule 8: a log does not name senders, so: what nobody on this bus should send."""
        kind = "extended " if frame.extended else "remote " if frame.remote else ""
        if frame.can_id in self._strange_ids:
            self.violation_count += 1
            return
        self._strange_ids.add(frame.can_id)
        self.wrong("8", f"{kind}identifier 0x{frame.can_id:03X}, which nobody on this bus should send")

    def on_ai(self, can_id: int, image: AiImage, t_ns: int) -> None:
        """A frame of the AI computer, which carries `image`."""
        self.now_ns, s = t_ns, self.seen
        if self.in_flight_ns:
            self.states = tuple(self.possible("state", None))
        else:
            self.states = () if s.as_state is None else (s.as_state,)
        cycle = self.cycle
        if isinstance(image, AiStatus):
            self._begin_cycle(t_ns)
            self.ai = image
            self.cycle.selected = image.mission_status is MissionStatus.SELECTED
            if s.ended is not None:
                s.ended += 1
            self._judge("0x510", image, can_id)
            self._answered(image.handshake, t_ns)
            s.latched = image.estop_request or (s.latched and self.process is not None)
            self.was_off = bool(self.states) and self.states[-1] in OFF
            return
        cycle.ids.append(can_id)
        if isinstance(image, AXLES):
            front = isinstance(image, AiDriveFront)
            s.torque_nm = (image.torque_nm, s.torque_nm[1]) if front else (s.torque_nm[0], image.torque_nm)
            cycle.motor_rpm = max(cycle.motor_rpm, image.motor_speed_max_rpm)
            self._judge("drive", image, can_id)
            if image.torque_nm > 0.0:
                self._judge("torque", image, can_id)
                cycle.torque = s.torque_runs = s.torque_may_be_there = True
                s.zeros, s.echoed = 0, False
            else:
                self._broken.pop(("torque", can_id), None)
        elif isinstance(image, AiSteer):
            self._judge("0x513", image, can_id)
            s.steer_deg, s.steered_ns = image.steer_deg, t_ns
            if self._plausibility is not None:
                self._plausibility.on_steer_request(image.steer_deg, t_ns)
        elif isinstance(image, AiBrake):
            s.brake_pct = image.front_pct, image.rear_pct
            self._judge("0x514", image, can_id)
            s.braked_pct = max(s.brake_pct)
            if any(s.brake_pct):
                cycle.brake = True
                s.zeros, s.echoed = 0, False

    def _begin_cycle(self, t_ns: int) -> None:
        if self.cycle.ids:
            self.cycle_over(t_ns)
        self.interval_ns = None if self.cycle_ns is None else t_ns - self.cycle_ns
        if self.interval_ns is not None and self.interval_ns >= RESTART_GAP_NS and not self.from_start:
            self.seen.latched = False  # another process
        self.cycle_ns = t_ns
        self.cycles += 1
        self.cycle.ids.append(AI_IDS[0])

    def _answered(self, bit: bool, t_ns: int) -> None:
        """Note how long the car waited for its echo."""
        if self.toggle is not None and bit == self.toggle[1]:
            self.responses.add(t_ns - self.toggle[0])
            self.toggle = None

    # ------------------------------------------------------------ the process

    def received(self, frames: Iterable[Frame]) -> None:
        """Frames that reached the process, of any sender, in the order of time."""
        self.on_frames(filter(self._of_the_car, frames))

    def _of_the_car(self, frame: Frame) -> bool:
        """Return whether the process believes that the car sent it; an intruder's frame is noted."""
        if frame.error or frame.extended:
            return False
        if frame.can_id in AI_IDS:
            self.on_intruder(f"0x{frame.can_id:03X} of somebody else was received")
            return False
        return not frame.remote and self.codec.knows(frame.can_id)

    def sent(self, frame: Frame) -> AiImage | None:
        """A frame of the process went out. Returns what it carries, None for what should never have been sent."""
        self.now_ns = frame.t_ns
        self.on_sending()
        if not self.well_formed(frame):
            return None
        image = self.on_frame(frame)
        return image if isinstance(image, AiStatus | AiDriveFront | AiDriveRear | AiSteer | AiBrake) else None

    def well_formed(self, frame: Frame) -> bool:
        """Safety rules 7 and 8: one of the five ids, its length, and values that cantools takes and gives back."""
        key = (frame.can_id, frame.data)
        if key in self._well_formed:
            return True
        if frame.extended or frame.remote or frame.error or frame.can_id not in AI_IDS:
            self.wrong("8", f"0x{frame.can_id:X} was sent")
            return False
        if len(frame.data) != BY_ID[frame.can_id].dlc:
            self.wrong("8", f"0x{frame.can_id:03X} was sent with {len(frame.data)} bytes")
            return False
        message = self.codec.database.get_message_by_frame_id(frame.can_id)
        values = message.decode(frame.data, decode_choices=False, allow_truncated=False)
        try:
            encoded = message.encode(values, strict=True)
        except EncodeError as error:
            self.wrong("7", f"0x{frame.can_id:03X} carries a value outside its range: {error}")
            return False
        if bytes(encoded) != frame.data:
            self.wrong("7", f"0x{frame.can_id:03X} carries bits of no signal: {frame.data.hex(' ')}")
            return False
        if len(self._well_formed) < 200_000:
            self._well_formed.add(key)
        return True


# ---------------------------------------------------------------- logs


def read_candump(path: Path | str) -> Iterator[Frame]:
    """The frames of a log, with their times in nanoseconds. Raises LogError, also for what cannot be read of it."""
    with open_log(path) as log:
        yield from map(on_wire, log.frames())
        if log.problems:
            raise LogError(log.problems.summary())


def on_wire(one: LogFrame) -> Frame:
    """A frame of a log as it was on the bus."""
    return Frame(one.can_id, one.data, one.t_ns, extended=one.extended, remote=one.remote, error=one.error)


def check_candump(path: Path | str, codec: Codec, *, busy_machine: bool = False) -> WireChecker:
    """Check a whole log; for `busy_machine` see `checker_for`."""
    checker = checker_for(codec, busy_machine=busy_machine)
    checker.on_frames(read_candump(path))
    return checker


def checker_for(codec: Codec, *, busy_machine: bool) -> WireChecker:
    """A checker for a bus of processes in real time.

    busy_machine: sender and receiver shared their processors with much else, so a frame on the bus may not have been
    received for some time. An echo is then missed when the car itself would call it missed, after 100 ms.
    """
    if not busy_machine:
        return WireChecker(codec)
    return WireChecker(codec, in_flight_ns=CAR_PATIENCE_NS // 2, handshake_in_flight_ns=CAR_PATIENCE_NS)
