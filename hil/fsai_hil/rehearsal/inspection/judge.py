"""The judge of a rehearsal: what the frames of an AI-side program show of each item. Pure; every time is in ns.

It is told what is on the bus, what people and faults do, and what the car makes of it. What it does not see it does
not call passed.

Its criteria are its own, not those of `rules/`: these hold this project's bridge to safety rules that are stricter than
the event's, while of another team's program an inspector asks item by item, and each needs what was seen of it.
"""

from __future__ import annotations

import re
from array import array
from collections import Counter
from collections.abc import Iterable, Sequence
from enum import Enum
from typing import Any, Final, NamedTuple

import numpy as np

from fsai_hil.rehearsal.inspection.items import BY_SLUG, SILENCES, Item
from fsai_hil.rules.numbers import LAUNCH_NS
from fsai_hil.rules.response import ResponseTimes
from fsai_hil.simulator.judge import JudgeVerdict
from fsai_hil.simulator.profiles import Profile
from fsai_hil.simulator.vcu import Transition
from fsai_vcu.diagnostics.statistics.echoes import EchoFault, echoes_of
from fsai_vcu.diagnostics.statistics.quantiles import quantile
from fsai_vcu.interface.bus_table import BY_ID
from fsai_vcu.interface.codec import Codec, Decoded
from fsai_vcu.interface.enums import OFF_LIKE, Ami, AsState, Direction, MissionStatus, ShutdownCause
from fsai_vcu.interface.errors import did_you_mean
from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.messages import (
    AiBrake,
    AiDriveFront,
    AiDriveRear,
    AiStatus,
    AiSteer,
    VcuDriveFront,
    VcuDriveRear,
    VcuStatus,
    VcuSteer,
    WheelSpeeds,
)
from fsai_vcu.interface.reserved import AI_IDS, OPTIONAL_AI_ID, RESERVED_IDS, STATUS_ID, VCU_IDS
from fsai_vcu.interface.specification import COMMS_LOST_NS, PERIOD_NS, STANDING_RPM
from fsai_vcu.interface.units import MS, S

REACTS_NS: Final = 200 * MS  # so long a program may take to follow a change of the AS state
SAYS_NS: Final = 500 * MS  # and to say so in MISSION_STATUS
CYCLE_SLACK_NS: Final = 10 * MS
PERIOD_TOLERANCE: Final = 0.1
JITTER_MS: Final = 15.0
IN_ORDER: Final = 0.98  # of all cycles
SWEEP_DEG: Final = 5.0
END_S: Final = 5.0
TINY: Final = 1e-6
ALL_SCENES: Final = "all"
LOOKED_AT: Final = frozenset((0x521, 0x522, 0x523, 0x525))  # of what the car sends, besides 0x520
MOST_KNOWN: Final = 4096
_CAUSES: Final = {
    ShutdownCause.AI_COMMS_FAULT: "response",
    ShutdownCause.BRAKE_PLAUSIBILITY_FAULT: "torque-brake",
    ShutdownCause.AUTONOMOUS_BRAKING_FAULT: "rest",
    ShutdownCause.MISSION_STATUS_FAULT: "rest",
}
_NUMBERS: Final = re.compile(r"[\d.]+")


class Verdict(Enum):
    """The verdict on an item."""

    PASS = "pass"
    NOTE = "note"
    FAIL = "fail"
    NOT_SEEN = "not seen"


class Result(NamedTuple):
    """The sightings and the verdict of one item."""

    item: Item
    verdict: Verdict
    seen: tuple[str, ...]

    def as_dict(self) -> dict[str, Any]:
        item = self.item
        return {
            "item": item.slug,
            "title": item.title,
            "asks": item.asks,
            "source": item.source,
            "result": self.verdict.value,
            "seen": list(self.seen),
        }


class Sighting:
    """Something wrong, as it was seen first, and how often."""

    def __init__(self, words: str, grave: bool, scene: str, t_ns: int) -> None:
        self.words, self.grave, self.scene, self.t_ns = words, grave, scene, t_ns
        self.count = 0

    def __str__(self) -> str:
        often = f", {self.count} frames in all" if self.count > 1 else ""
        if self.scene == ALL_SCENES:
            return self.words
        return f"{self.words} (scene {self.scene}, at {self.t_ns / S:.2f} s{often})"


class Silence:
    """A message of the car that is silent, and what was asked for meanwhile."""

    def __init__(self, can_id: int, t_ns: int, torque: bool) -> None:
        self.can_id, self.t_ns, self.torque = can_id, t_ns, torque
        self.torque_ns: int | None = t_ns if torque else None  # the last torque asked for
        self.estop_ns: int | None = None
        self.brake_ns: int | None = None
        self.limited = False  # torque was gone only once the car's own limit was


class InspectionJudge:
    """See the module. `start_ns`: of the rehearsal, from which people count its time."""

    def __init__(self, codec: Codec, profile: Profile, start_ns: int = 0) -> None:
        """Begin with a bus on which nothing has been seen."""
        self._codec, self._profile, self._start_ns = codec, profile, start_ns
        self._now_ns = start_ns
        self._wrong: dict[str, dict[str, Sighting]] = {}
        self._shown: set[str] = set()
        self._facts: dict[str, list[str]] = {}
        self.why_not: dict[str, str] = {}  # a scene did not get to what it was to show
        self.scene = ""
        self.loaded = False  # the computer is kept busy
        # the car, as the bus shows it
        self.state: AsState | None = None
        self._state_ns = start_ns
        self._ami = Ami.NOT_SELECTED
        self._ami_ns = start_ns
        self._ami_taken_back = False
        self._max_nm: dict[type, float] = {}
        self._had_motor: dict[type, bool] = {}
        self._angle_max_deg: float | None = None
        self._rpm = 0
        self._standing_ns: int | None = None
        self._emergencies = 0
        self._car_sent: dict[int, bytes] = {}  # the last payload of each message
        # the program
        self.frames = 0
        self._known: dict[tuple[int, bytes], Decoded] = {}
        self._last_ns: dict[int, int] = {}
        self._intervals_ns: dict[int, array[int]] = {can_id: array("q") for can_id in AI_IDS}
        self._counts: Counter[int] = Counter()
        self._cycle: list[int] = []
        self._orders: Counter[tuple[int, ...]] = Counter()
        self._asked: tuple[array[int], array[int]] = (array("q"), array("q"))  # of HANDSHAKE: times and bits
        self._echoed: tuple[array[int], array[int]] = (array("q"), array("q"))
        self._torque_nm = {AiDriveFront: 0.0, AiDriveRear: 0.0}
        self._brake_pct = 0.0
        self._met: tuple[int, float, float] | None = None  # since when torque and brake are together, and how much
        self._asked_torque = False  # in this drive
        self.steers = False
        self.steer_deg = 0.0  # the last request
        self._swept: str | None = None
        self._running_ns: int | None = None
        self._silence: Silence | None = None
        self.status = AiStatus()
        self.ended_ns: int | None = None

    # ------------------------------------------------------------ what it is told

    def begin(self, scene: str, t_ns: int) -> None:
        self._end_silence()
        self._end_meeting(t_ns)
        self.scene, self._now_ns = scene, t_ns
        self._forget_drive()

    def wrong(self, slug: str, words: str, *, grave: bool = True) -> None:
        """Something that the item does not allow."""
        key = _NUMBERS.sub("", words)
        found = self._wrong.setdefault(slug, {})
        if key not in found:
            found[key] = Sighting(words, grave, self.scene, self._now_ns - self._start_ns)
        found[key].count += 1

    def is_wrong(self, slug: str) -> bool:
        return slug in self._wrong

    def show(self, slug: str, fact: str = "") -> None:
        """The item could be seen; `fact`: what was seen, where nothing is wrong with it."""
        self._shown.add(slug)
        if fact:
            self._facts.setdefault(slug, []).append(fact)

    def stuck(self, why: str) -> None:
        """The scene did not get on."""
        self.why_not[self.scene] = why

    def silence(self, can_id: int, t_ns: int) -> None:
        """Note that the car no longer sends that message from now on."""
        self._silence = Silence(can_id, t_ns, self.asks_torque)

    @property
    def asks_torque(self) -> bool:
        return max(self._torque_nm.values()) > 0.0

    def responses(self, times_ns: Sequence[int], losses: int, *, loaded: bool) -> None:
        """The VCU's measurement of the echoes over a while."""
        slug = "load" if loaded else "response"
        times = ResponseTimes(times_ns)
        found = times.as_dict()
        if losses:
            self.wrong(slug, f"the VCU raised AI_COMMS_LOST {losses} times")
        if not len(times):
            self.wrong(slug, "the VCU saw no echo at all")
            return
        words = (
            f"{len(times)} echoes, p50 {found['p50_ms']:.1f} ms, p99 {found['p99_ms']:.1f}, max {found['max_ms']:.1f}"
        )
        self.show(slug, words)
        if found["max_ms"] * MS >= COMMS_LOST_NS:
            self.wrong(slug, f"an echo took {found['max_ms']:.0f} ms")
        elif found["p99_ms"] * MS > PERIOD_NS:
            self.wrong(slug, f"{found['above_ms']['10']} of {len(times)} echoes took more than a cycle", grave=False)

    def on_transition(self, transition: Transition, cause: ShutdownCause) -> None:
        """The car's AS state has changed."""
        if transition.target is not AsState.EMERGENCY_BRAKE:
            return
        self._emergencies += 1
        slug = _CAUSES.get(cause)
        if slug is not None and self._silence is None:
            self.wrong(slug, f"the VCU stopped the car from {transition.source.label}: {transition.why}")

    def mission(self, slug: str, verdict: JudgeVerdict) -> None:
        """A mission was driven, and judged from the car's true motion."""
        self.show(slug)
        for reason in verdict.reasons:
            self.wrong(slug, reason)
        if verdict.passed:
            self.show(slug, f"driven in {verdict.driving_time_s:.1f} s, ended in {verdict.as_states[-1][0]}")
        if slug == "demo" and self._swept == "right":
            self.wrong(slug, "it steers to the right first: is the sign of STEER_REQUEST swapped? Positive turns left")

    def program_ended(self, status: int, took_s: float | None) -> None:
        """The program has ended; `took_s`: since it was asked to, None: by itself."""
        self.ended_ns = self._now_ns
        self.show("end")
        if took_s is None:
            self.wrong("end", f"the program ended by itself with status {status}")
        else:
            self.show("end", f"it ended {took_s:.1f} s after SIGTERM, with status {status}")

    def program_would_not_end(self) -> None:
        self.ended_ns = self._now_ns
        self.show("end")
        self.wrong("end", f"the program still ran {END_S:g} s after SIGTERM, and was killed")

    # ------------------------------------------------------------ the car

    def on_car(self, frame: Frame) -> None:
        """A frame of the car is on the bus."""
        can_id, self._now_ns = frame.can_id, frame.t_ns
        if can_id != STATUS_ID and (can_id not in LOOKED_AT or self._car_sent.get(can_id) == frame.data):
            return
        self._car_sent[can_id] = frame.data
        image = self._codec.decode(frame).image
        match image:
            case VcuStatus():
                self._on_status(image, frame.t_ns)
            case VcuDriveFront():
                self._on_limit(AiDriveFront, image.torque_max_nm)
            case VcuDriveRear():
                self._on_limit(AiDriveRear, image.torque_max_nm)
            case VcuSteer():
                self._angle_max_deg = image.angle_max_deg
            case WheelSpeeds():
                self._rpm = max(image.all_rpm)
                if self._rpm > STANDING_RPM:
                    self._standing_ns = None
                elif self._standing_ns is None:
                    self._standing_ns = frame.t_ns

    def _on_status(self, status: VcuStatus, t_ns: int) -> None:
        if self.scene == "handshake":
            self._asked[0].append(t_ns)
            self._asked[1].append(int(status.handshake))
        if status.as_state is not self.state:
            if status.as_state is AsState.AS_DRIVING:
                self._forget_drive()
            self.state, self._state_ns = status.as_state, t_ns
        if status.ami is not self._ami:
            self._ami_taken_back = status.ami is Ami.NOT_SELECTED and self.state is AsState.AS_OFF
            self._ami, self._ami_ns = status.ami, t_ns

    def _on_limit(self, axle: type, most_nm: float) -> None:
        self._max_nm[axle] = most_nm
        if most_nm > 0.0:
            self._had_motor[axle] = True

    def _forget_drive(self) -> None:
        self._asked_torque = self.steers = False
        self._swept = None
        self._running_ns = None

    def car_is_off(self, t_ns: int) -> None:
        """Low voltage is off: the car says nothing, and what it says next is new."""
        self.state, self._state_ns = None, t_ns
        self._ami, self._ami_ns, self._ami_taken_back = Ami.NOT_SELECTED, t_ns, False

    # ------------------------------------------------------------ the program

    def on_ai(self, frame: Frame) -> None:
        """A frame of somebody else than the car has been received."""
        if frame.error:
            return
        self._now_ns = t_ns = frame.t_ns
        self.frames += 1
        if frame.extended or frame.remote or frame.can_id not in AI_IDS:
            self._foreign(frame)
            return
        if self.ended_ns is not None and t_ns - self.ended_ns >= REACTS_NS:
            self.wrong("end", f"0x{frame.can_id:03X} was sent after the program had ended")
        self._time(frame.can_id, t_ns)
        decoded = self._decoded(frame)
        for problem in decoded.problems:
            self.wrong("messages", problem)
        match decoded.image:
            case AiStatus() as status:
                self._on_ai_status(status, t_ns)
            case AiDriveFront() | AiDriveRear() as axle:
                self._on_axle(axle, frame.can_id, t_ns)
            case AiSteer() as steer:
                self._on_steer(steer)
            case AiBrake() as brake:
                self._on_brake(brake, t_ns)

    def _decoded(self, frame: Frame) -> Decoded:
        """A program that stands sends the same over and over."""
        key = frame.can_id, frame.data
        if key not in self._known:
            if len(self._known) >= MOST_KNOWN:
                self._known.clear()
            self._known[key] = self._codec.decode(frame)
        return self._known[key]

    def _foreign(self, frame: Frame) -> None:
        name = f"{'extended ' * frame.extended}{'remote ' * frame.remote}0x{frame.can_id:03X}"
        if frame.can_id in RESERVED_IDS or frame.can_id in VCU_IDS:
            self.wrong("messages", f"{name} was sent, which is the car's: an AI computer must never transmit it")
        elif frame.can_id in AI_IDS:
            self.wrong("messages", f"{name} was sent")
        elif frame.can_id != OPTIONAL_AI_ID:
            self.wrong("messages", f"{name} was sent, which is not an id of this car", grave=False)

    def _time(self, can_id: int, t_ns: int) -> None:
        self._counts[can_id] += 1
        last_ns = self._last_ns.get(can_id)
        if last_ns is not None and not self.loaded:
            self._intervals_ns[can_id].append(t_ns - last_ns)
        self._last_ns[can_id] = t_ns
        if can_id in self._cycle:
            self._orders[tuple(self._cycle)] += 1
            self._cycle = []
        self._cycle.append(can_id)

    def _on_ai_status(self, ai: AiStatus, t_ns: int) -> None:
        """Hold a 0x510 against the AS state that the car has shown."""
        self.status = ai
        if self.scene == "handshake":
            self._echoed[0].append(t_ns)
            self._echoed[1].append(int(ai.handshake))
        state, said = self.state, ai.mission_status
        in_state_ns = t_ns - self._state_ns
        if self._silence is not None and ai.estop_request and self._silence.estop_ns is None:
            self._silence.estop_ns = t_ns
        if state is None or (self._silence is not None and self._silence.can_id == STATUS_ID):
            return  # what it cannot know is not held against it
        if state in OFF_LIKE:
            self._on_off(ai, t_ns)
        if state is not AsState.AS_DRIVING:
            if (state in OFF_LIKE or state is AsState.AS_READY) and in_state_ns >= REACTS_NS:
                self._on_idle(ai, state)
            if state is AsState.AS_FINISHED and in_state_ns >= SAYS_NS and said is not MissionStatus.FINISHED:
                self.wrong("rest", f"MISSION_STATUS {said.label} in AS_FINISHED", grave=False)
            return
        self._look_at_axles()
        if said is MissionStatus.RUNNING and self._running_ns is None:
            self._running_ns = in_state_ns
            self.show("running", f"RUNNING {in_state_ns / MS:.0f} ms after AS_DRIVING began")
        if self._rpm > STANDING_RPM:
            self.show("rest")
            if ai.direction is Direction.NEUTRAL:
                self.wrong("rest", f"NEUTRAL with a wheel at {self._rpm} rpm")
            if said is MissionStatus.FINISHED:
                self.wrong("rest", f"FINISHED with a wheel at {self._rpm} rpm")
        elif said is MissionStatus.FINISHED and self._running_ns is not None and self._standing_ns is not None:
            since_s = (t_ns - max(self._standing_ns, self._state_ns)) / S
            self._running_ns = None
            self.show("rest", f"FINISHED after {since_s:.2f} s with every wheel under {STANDING_RPM:g} rpm")
        if in_state_ns < SAYS_NS:
            return
        self.show("running")
        if said not in (MissionStatus.RUNNING, MissionStatus.FINISHED):
            self.wrong("running", f"MISSION_STATUS {said.label} in AS_DRIVING")
        if ai.direction is Direction.REVERSE:
            self.wrong("running", "DIRECTION_REQUEST REVERSE in AS_DRIVING")
        if ai.direction is Direction.NEUTRAL and said is MissionStatus.RUNNING and in_state_ns >= S:
            self.wrong("running", "DIRECTION_REQUEST NEUTRAL in AS_DRIVING")

    def _on_off(self, ai: AiStatus, t_ns: int) -> None:
        shown_ns = t_ns - max(self._ami_ns, self._state_ns)
        if self._ami is not Ami.NOT_SELECTED:
            if ai.mission_status is MissionStatus.SELECTED:
                self.show("selected")
            return
        if shown_ns < SAYS_NS or self.scene == "handshake":
            return
        slug = "ami" if self._ami_taken_back else "selected"
        if ai.mission_status is not MissionStatus.NOT_SELECTED:
            self.wrong(slug, f"MISSION_STATUS {ai.mission_status.label} in AS_OFF while the AMI shows no mission")

    def _on_idle(self, ai: AiStatus, state: AsState) -> None:
        if state is AsState.AS_READY:
            self.show("before-go")
            if ai.estop_request:
                slug = "power-cycle" if self._emergencies else "before-go"
                self.wrong(slug, "ESTOP_REQUEST 1 in AS_READY: the car brakes as soon as it gets Go")
        if ai.direction is not Direction.NEUTRAL:
            self.wrong("before-go", f"DIRECTION_REQUEST {ai.direction.label} in {state.label}")
        if ai.mission_status in (MissionStatus.RUNNING, MissionStatus.FINISHED) and (
            state is AsState.AS_READY or self._now_ns - self._state_ns >= SAYS_NS
        ):
            self.wrong("before-go", f"MISSION_STATUS {ai.mission_status.label} in {state.label}")

    def _on_axle(self, axle: AiDriveFront | AiDriveRear, can_id: int, t_ns: int) -> None:
        """Hold a torque request against the AS state, the pedals and what the car allows."""
        kind, nm, state = type(axle), axle.torque_nm, self.state
        self._torque_nm[kind] = nm
        self._meet(t_ns)
        if nm <= 0.0:
            if self._silence is not None and self._max_nm.get(kind) == 0.0 and self._had_motor.get(kind):
                self._silence.limited = True
            return
        name = f"0x{can_id:03X} asks for {nm:.1f} Nm"
        if self._silence is not None:
            self._silence.torque_ns = t_ns
            self._silence.limited = False
            if self._silence.can_id == STATUS_ID:
                return
        in_state_ns = t_ns - self._state_ns
        if state is None or state in OFF_LIKE or state is AsState.AS_READY:
            if state is AsState.AS_READY or in_state_ns >= REACTS_NS:
                self.wrong("before-go", f"{name} in {'no AS state' if state is None else state.label}")
        elif state is not AsState.AS_DRIVING:
            if in_state_ns >= REACTS_NS:
                self.wrong("estop" if state is AsState.EMERGENCY_BRAKE else "rest", f"{name} in {state.label}")
        else:
            self._asked_torque = True
            for slug in ("launch", "torque-brake", "limits", "axle"):
                self.show(slug)
            if in_state_ns < LAUNCH_NS - CYCLE_SLACK_NS:
                self.wrong("launch", f"{name} {in_state_ns / S:.2f} s after AS_DRIVING began")
            most_nm = self._max_nm.get(kind)
            if most_nm and nm > most_nm + TINY:
                self.wrong("limits", f"{name}, and the car takes at most {most_nm:.1f} Nm")

    def _look_at_axles(self) -> None:
        """Both as the last cycle has them. An AXLE_TRQ_MAX of 0 where the other axle has some: no motor there."""
        for kind, other, can_id in ((AiDriveFront, AiDriveRear, 0x511), (AiDriveRear, AiDriveFront, 0x512)):
            asked_nm, others_nm = self._torque_nm[kind], self._torque_nm[other]
            if asked_nm <= 0.0 or self._max_nm.get(kind) != 0.0 or not self._max_nm.get(other):
                continue
            lost = "nothing of the driven one" if others_nm <= 0.0 else f"{others_nm:.1f} Nm of the driven one"
            share = f": {asked_nm / (asked_nm + others_nm):.0%} of the torque is lost on this car"
            self.wrong(
                "axle", f"0x{can_id:03X} asks for {asked_nm:.1f} Nm of an axle without a motor, and {lost}{share}"
            )

    def _on_steer(self, steer: AiSteer) -> None:
        """Hold a steering request against the AS state and what the car allows."""
        deg, state = steer.steer_deg, self.state
        self.steer_deg = deg
        if deg == 0.0:
            return
        if state is None or state in OFF_LIKE or state is AsState.AS_READY:
            if state is AsState.AS_READY or self._now_ns - self._state_ns >= REACTS_NS:
                where = "no AS state" if state is None else state.label
                self.wrong("before-go", f"0x513 asks for {deg:.1f} deg in {where}")
            return
        if state is not AsState.AS_DRIVING:
            return
        self.steers = True
        self.show("limits")
        if self._swept is None and abs(deg) >= SWEEP_DEG:
            self._swept = "left" if deg > 0.0 else "right"
        if self._angle_max_deg is not None and abs(deg) > self._angle_max_deg + TINY:
            self.wrong("limits", f"0x513 asks for {deg:.1f} deg, and ANGLE_MAX is {self._angle_max_deg:.1f} deg")

    def _on_brake(self, brake: AiBrake, t_ns: int) -> None:
        self._brake_pct = max(brake.front_pct, brake.rear_pct)
        if self._silence is not None and self._brake_pct > 0.0 and self._silence.brake_ns is None:
            self._silence.brake_ns = t_ns
        self._meet(t_ns)

    def _meet(self, t_ns: int) -> None:
        """The VCU sees the messages one after another: what meets between two of them has met."""
        torque_nm = max(self._torque_nm.values())
        if self.state is not AsState.AS_DRIVING or torque_nm <= 0.0 or self._brake_pct <= 0.0:
            self._end_meeting(t_ns)
        elif self._met is None:
            self._met = t_ns, torque_nm, self._brake_pct

    def _end_meeting(self, t_ns: int) -> None:
        if self._met is None:
            return
        (since_ns, torque_nm, brake_pct), self._met = self._met, None
        together = f"{torque_nm:.1f} Nm and {brake_pct:.1f} % of brake together for {(t_ns - since_ns) / MS:.1f} ms"
        if t_ns - since_ns >= PERIOD_NS:
            self.wrong("torque-brake", together)
        else:
            words = f"{together}: changed in one call; a cycle with both at 0 has to lie between them"
            if not self._profile.pedals_judged_by_frame:
                words += " (a VCU that judges once a cycle may not see it)"
            self.wrong("torque-brake", words, grave=self._profile.pedals_judged_by_frame)

    # ------------------------------------------------------------ silences

    def _end_silence(self) -> None:
        """Note how the program reacted to a message that was missing."""
        silence, self._silence = self._silence, None
        if silence is None:
            return
        slug = f"silence-{silence.can_id:x}"
        within_ms = SILENCES[silence.can_id][1]
        reactions = [
            f"{what} after {(t_ns - silence.t_ns) / MS:.0f} ms"
            for what, t_ns in (("ESTOP_REQUEST", silence.estop_ns), ("brake", silence.brake_ns))
            if t_ns is not None
        ]
        torque_ms = None if silence.torque_ns is None else (silence.torque_ns - silence.t_ns) / MS
        if torque_ms is not None:
            reactions.insert(0, f"torque for {torque_ms:.0f} ms more")
        self.show(slug, ", ".join(reactions) or "no torque, no brake, no ESTOP_REQUEST")
        if within_ms is None or torque_ms is None:
            return
        after = f"{torque_ms:.0f} ms after the last 0x{silence.can_id:03X}"
        if torque_ms > within_ms:
            self.wrong(slug, f"torque is still asked for {after}")
        elif silence.torque and silence.limited and silence.estop_ns is None and silence.brake_ns is None:
            self.wrong(slug, f"no reaction: torque went only when AXLE_TRQ_MAX fell to 0, {after}")

    # ------------------------------------------------------------ what it found

    def results(self, items: Iterable[Item]) -> list[Result]:
        """Return the result of each item. Nothing more is to be told after it."""
        self._end_silence()
        self._end_meeting(self._now_ns)
        self._judge_messages()
        self._judge_handshake()
        return [self._result(item) for item in items]

    def _result(self, item: Item) -> Result:
        found = sorted(self._wrong.get(item.slug, {}).values(), key=lambda one: (not one.grave, one.t_ns))
        facts = self._facts.get(item.slug, [])
        words = tuple(map(str, found))
        if any(one.grave for one in found):
            return Result(item, Verdict.FAIL, words)
        if item.slug not in self._shown:
            why = self.why_not.get(item.scene) or "the rehearsal ended before this item"
            return Result(item, Verdict.NOT_SEEN, (*words, why))
        shown = tuple({_NUMBERS.sub("", each): each for each in reversed(facts)}.values())[::-1][
            :3
        ]  # the first of a kind
        return Result(item, Verdict.NOTE if found else Verdict.PASS, (*words, *shown))

    def _judge_messages(self) -> None:
        """Judge whether every message came, at its period and in its order."""
        if not self.frames:
            return
        self.show("messages")
        self.scene = ALL_SCENES
        periods = []
        for can_id in AI_IDS:
            if not self._counts[can_id]:
                self.wrong("messages", f"0x{can_id:03X} was never received")
                continue
            intervals = np.sort(np.asarray(self._intervals_ns[can_id]))
            if not len(intervals):
                continue
            p50_ms, p99_ms, max_ms = (quantile(intervals, share) / MS for share in (0.5, 0.99, 1.0))  # type: ignore[operator]
            mean_ms = float(intervals.mean()) / MS
            periods.append((mean_ms, max_ms))
            wanted_ms = PERIOD_NS / MS
            if min(abs(p50_ms / wanted_ms - 1.0), abs(mean_ms / wanted_ms - 1.0)) > PERIOD_TOLERANCE:
                self.wrong("messages", f"0x{can_id:03X} comes every {p50_ms:.1f} ms")
            elif max_ms * MS >= COMMS_LOST_NS:
                self.wrong("messages", f"0x{can_id:03X} was silent for {max_ms:.0f} ms")
            elif p99_ms > JITTER_MS:
                words = f"0x{can_id:03X} comes up to {p99_ms:.1f} ms apart (p99), the longest {max_ms:.1f} ms"
                self.wrong("messages", words, grave=False)
        if periods:
            means, longest = zip(*periods, strict=True)
            lengths = ", ".join(str(BY_ID[can_id].dlc) for can_id in AI_IDS)
            self.show(
                "messages",
                f"every {max(means):.2f} ms, {max(longest):.1f} ms apart at most; {lengths} bytes",
            )
        if sum(self._orders.values()) < 10:
            return
        self.show("order")
        (usual, often), all_of_them = self._orders.most_common(1)[0], sum(self._orders.values())
        words = " ".join(f"{can_id:03X}" for can_id in usual)
        if often < IN_ORDER * all_of_them:
            self.wrong(
                "order", f"{len(self._orders)} different orders; {words} in {often} of {all_of_them}", grave=False
            )
        elif set(usual) == set(AI_IDS) and usual != AI_IDS:
            self.wrong("order", f"{words}, where the car's library sends 510 first and 514 last", grave=False)
        elif usual != AI_IDS:
            self.wrong("order", f"a cycle brings {words} only", grave=False)
        else:
            self.show("order", f"{words} in {often} of {all_of_them} cycles")

    def _judge_handshake(self) -> None:
        """Judge the echoes of the handshake: their bits, and how long they took."""
        (asked_ns, asked), (echo_ns, echoes) = self._asked, self._echoed
        if not len(echo_ns):
            return
        found = echoes_of(*(np.asarray(each) for each in (asked_ns, asked, echo_ns, echoes)))
        self.scene = "handshake"
        if found.judged:
            self.show("handshake", f"{found.judged - found.wrong} of {found.judged} echoes are the last bit received")
        if found.fault is None:
            if found.wrong > 0.1 * found.judged:
                words = f"{found.wrong} of {found.judged} echoes are not the last bit received"
                self.wrong("handshake", words, grave=False)
            return
        words = f"it sends back {found.fault.value}: {found.wrong} of {found.judged} echoes are wrong"
        if found.fault is not EchoFault.LATE:
            words += "; the official simulator takes any echo, the car raises AI_COMMS_LOST within 100 ms"
        self.wrong("handshake", words)


def items_named(names: Sequence[str]) -> tuple[Item, ...]:
    """Return the named items, all for no name, in the order of the table. Raises ValueError for an unknown name."""
    unknown = [name for name in names if name not in BY_SLUG]
    if unknown:
        raise ValueError(f"no item '{unknown[0]}'{did_you_mean(unknown[0], BY_SLUG) or '; --list shows them'}")
    return tuple(item for slug, item in BY_SLUG.items() if not names or slug in names)
