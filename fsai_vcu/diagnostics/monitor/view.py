"""Frames in, pictures out. No clock and no bus: times are those of the frames, and `now` is an argument."""

from __future__ import annotations

import copy
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

import numpy as np

from fsai_vcu.core.missions.settings import MissionSettings
from fsai_vcu.core.vehicle.parameters import ADS_DV_2026, CARS
from fsai_vcu.diagnostics.decode.databases import Databases
from fsai_vcu.diagnostics.decode.decoder import Decoder
from fsai_vcu.diagnostics.explain import signals as sig
from fsai_vcu.diagnostics.explain.endings import emergencies
from fsai_vcu.diagnostics.explain.evidence import error_text
from fsai_vcu.diagnostics.explain.incident import Incident, TimelineEntry
from fsai_vcu.diagnostics.explain.record import Record, Series
from fsai_vcu.diagnostics.explain.signals import Signal, label
from fsai_vcu.diagnostics.explain.starting import why_not_driving
from fsai_vcu.diagnostics.explain.timeline import timeline
from fsai_vcu.diagnostics.log.frames import Frames
from fsai_vcu.diagnostics.monitor.snapshot import Actuator, Freshness, History, MessagePicture, Picture
from fsai_vcu.diagnostics.monitor.state_history import LONG_NS, WINDOW_NS, Memory, bytes_of, changed_bytes, signals_of
from fsai_vcu.diagnostics.statistics.measure import BITRATE, expected_period_ns, handshake_of, keys_of, share
from fsai_vcu.diagnostics.statistics.wire_bits import wire_bits
from fsai_vcu.interface.bus_table import BUS_TABLE, BY_ID, Flow
from fsai_vcu.interface.enums import Ami, MissionStatus
from fsai_vcu.interface.reserved import AI_IDS
from fsai_vcu.interface.specification import STANDING_RPM
from fsai_vcu.interface.units import S, ms

EXPECTED: Final = tuple(
    message.can_id
    for message in BUS_TABLE
    if message.flow in (Flow.TO_VCU, Flow.FROM_VCU) and message.timeout_ns is not None
)
"""Messages on the car's bus whenever car and AI computer are up, received or not."""

_UNSUPERVISED_PERIODS: Final = 10  # interface specification v4.0: ten in a row are a loss
_LATE_PERIODS: Final = 5
_SLOW_ECHO_S: Final = 0.05  # half of the 100 ms that the VCU grants
_EVENTFUL: Final = frozenset({0x510, sig.STATUS, 0x524})  # messages all of whose changes are remembered
TREND_NS: Final = 10 * S
_SETTLED_NS: Final = 1 * S  # after so long the frames around an emergency brake are all there


_ACTUATORS: Final[Mapping[str, tuple[Signal, Signal, Signal | None, str]]] = {
    "steering": (sig.STEER, sig.ANGLE, sig.ANGLE_MAX, "deg"),
    "torque front": (sig.TORQUE_F, sig.CAR_TORQUE[0], sig.CAR_TORQUE_MAX[0], "Nm"),
    "torque rear": (sig.TORQUE_R, sig.CAR_TORQUE[1], sig.CAR_TORQUE_MAX[1], "Nm"),
    "brake front": (sig.BRAKE_REQ_F, sig.BRAKE_F, None, "%"),
    "brake rear": (sig.BRAKE_REQ_R, sig.BRAKE_R, None, "%"),
}
_RULES: Final = MissionSettings()
_LAPS: Final[Mapping[int, int]] = {
    Ami.SKIDPAD: 2 * _RULES.skidpad_laps_per_side,
    Ami.AUTOCROSS: _RULES.autocross_laps,
    Ami.TRACKDRIVE: _RULES.trackdrive_laps,
}
_WHEELS: Final = dict(zip(sig.WHEEL_NAMES, sig.WHEELS, strict=True))
_MOVING: Final = sorted(
    {signal.can_id for signals in _ACTUATORS.values() for signal in signals[:2]} | {sig.WHEELS[0].can_id}
)
_CAR_SPEED: Final = Signal("VCU2LOG_Dynamics1", "Speed_actual")
_STATES: Final = (sig.OP_STATE, sig.TS_STATE, sig.EBS_STATE, sig.STATUS_EBS, sig.STEERING_STATUS, sig.STATUS_BRK)


class View:
    """View of a bus, moment by moment. `revision` None: recognised from the frames. `databases` replace the built-in
    ones.
    """

    def __init__(self, channel: str = "", revision: str | None = None, databases: Databases | None = None) -> None:
        self.memory = Memory()
        self._channel = channel
        self._revision = revision
        self._databases = databases
        self._decoder: Decoder | None = None
        self._spoken: str | None = revision  # as the newest picture's frames tell
        self.emergency: Incident | None = None
        self._settled = False

    def copy(self) -> View:
        """Return a copy as it is now, whatever comes later."""
        found = copy.copy(self)
        found.memory = self.memory.copy()
        return found

    def explain_as(self, other: View) -> None:
        """Take the causes of the emergency brake that lasts from a view of the time when it began."""
        self.emergency, self._settled = other.emergency, True

    def update(self, frames: Frames) -> Frames:
        """Take in more frames of the bus, in the order of arrival, and return them with times that never go back."""
        return self.memory.update(frames)

    def picture(self, now_ns: int) -> Picture:
        """Return what there is to see at `now_ns`, on the clock of the frames."""
        frames = self.memory.condensed(self.memory.window(now_ns))
        if not len(frames):
            named, nothing = self._revision or "2026", ("nothing is received on this bus",)
            return Picture(now_ns, self._channel, named, "nothing received yet", 0, link=nothing)
        record = self._record(frames)
        self._decoder, self._spoken = record.decoder, record.revision.name
        self._look_for_emergency(record, now_ns)
        return _Moment(self.memory, record, now_ns).picture(self.emergency, self._channel)

    def trends(self, now_ns: int, length_ns: int = TREND_NS) -> dict[str, Series]:
        """Speed (m/s), and for each actuator 'NAME asked' and 'NAME given', over the time up to `now_ns`."""
        frames = self.memory.window(now_ns, length_ns)
        frames = frames.only(np.isin(frames.can_id, _MOVING))
        if not len(frames):
            return {}
        record = Record(frames, self._spoken, self._databases)
        wheels = [series for signal in sig.WHEELS if len(series := record.series(signal))]
        found = {}
        if wheels:
            speeds = _speed_mps(record, np.mean([wheel.values for wheel in wheels], axis=0))
            found["speed"] = Series(wheels[0].t_ns, speeds)
        for name, (asked, given, _, _) in _ACTUATORS.items():
            found |= {f"{name} asked": record.series(asked), f"{name} given": record.series(given)}
        return found

    def signals(self, patterns: Sequence[str], now_ns: int) -> list[History]:
        """The signals received whose names, or MESSAGE.SIGNAL, fit one of the patterns; by what the picture showed."""
        return [] if self._decoder is None else signals_of(self._long(now_ns), self._decoder, patterns, now_ns)

    def bytes(self, key: int, now_ns: int) -> list[History]:
        """The bytes of a message."""
        return bytes_of(self._long(now_ns), key, now_ns)

    def events(self) -> list[TimelineEntry]:
        """List what changed in the states of car and AI computer, from the beginning on."""
        frames = self._long(self.memory.newest_ns or 0)
        if not len(frames):
            return []
        record = self._record(frames)
        record.silences = ()  # of most messages only the newest frames are there
        return [one for one in timeline(record) if one.can_id in _EVENTFUL and one.topic != "link"]

    def _long(self, now_ns: int) -> Frames:
        return self.memory.condensed(self.memory.window(now_ns, LONG_NS))

    def _record(self, frames: Frames) -> Record:
        return Record(frames, self._revision, self._databases)

    def _look_for_emergency(self, record: Record, now_ns: int) -> None:
        """The causes of an emergency brake are found while the frames before it are remembered whole, and kept."""
        span = record.series(sig.AS_STATE).span_at(now_ns)
        if span is None or span.value != sig.EMERGENCY or span.before is None:
            self.emergency, self._settled = None, False
            return
        if self._settled:
            return
        found = [one for one in emergencies(self._record(self._long(now_ns))) if one.t_ns == span.begin_ns]
        self.emergency = found[0] if found else None
        self._settled = now_ns - span.begin_ns > _SETTLED_NS


def _speed_mps(record: Record, wheel_rpm: Any) -> Any:
    return wheel_rpm * CARS.get(record.revision.name, ADS_DV_2026).speed_of_wheel_rpm(1.0)


class _Moment:
    """One look at a record."""

    def __init__(self, memory: Memory, record: Record, now_ns: int) -> None:
        self._memory = memory
        self._record = record
        self._now_ns = now_ns
        self._window = record.frames.only(record.frames.t_ns > now_ns - WINDOW_NS)

    def picture(self, emergency: Incident | None, channel: str) -> Picture:
        """Return the picture of this moment; `emergency` is the brake that lasts, with its causes."""
        record, now_ns = self._record, self._now_ns
        span = record.series(sig.AS_STATE).span_at(now_ns)
        status = self._fresh(sig.STATUS)
        messages = self._messages()
        wheels = {name: value for name, signal in _WHEELS.items() if (value := self._value(signal)) is not None}
        times = record.times(sig.STATUS)
        return Picture(
            t_ns=now_ns,
            channel=channel or record.channel,
            revision=record.revision.name,
            revision_reason=record.revision_reason,
            frames=self._memory.frames,
            as_state=self._label(sig.AS_STATE),
            as_state_s=(now_ns - span.begin_ns) / S if span is not None and status else None,
            as_state_heard=None if span is None else label(sig.AS_STATE, span.value),
            status_age_s=(now_ns - int(times[-1])) / S if len(times) else None,
            mission=self._label(sig.AMI),
            mode=self._mode(),
            mission_status=self._label(sig.MISSION_STATUS),
            direction=self._label(sig.DIRECTION),
            estop_request=self._flag(sig.ESTOP),
            lap=self._count(sig.LAP),
            laps=None if (mission := self._count(sig.AMI)) is None else _LAPS.get(mission),
            lap_times_s=self._lap_times_s(),
            cones=self._count(sig.CONES),
            go=self._flag(sig.GO),
            as_switch=self._flag(sig.AS_SWITCH),
            ts_switch=self._flag(sig.TS_SWITCH),
            states=self._states(),
            driving=status and span is not None and span.value == sig.DRIVING,
            why_not_driving=tuple(why_not_driving(record, now_ns, emergency)),
            wheels_rpm=wheels,
            speed_mps=float(_speed_mps(record, np.mean(list(wheels.values())))) if wheels else None,
            speed_actual_kmh=self._value(_CAR_SPEED),
            actuators={
                name: Actuator(self._value(asked), self._value(given), limit and self._value(limit), unit)
                for name, (asked, given, limit, unit) in _ACTUATORS.items()
            },
            faults=tuple(signal.name for signal in sig.FAULTS if self._flag(signal)),
            warnings=tuple(signal.name for signal in (*sig.WARNINGS, *sig.SYSTEM_WARNINGS) if self._flag(signal)),
            shutdown_cause=self._label(sig.SHUTDOWN_CAUSE) if self._flag(sig.SHUTDOWN_CAUSE) else None,
            handshake=handshake_of(self._window, record.decoder),
            handshake_waiting_s=self._handshake_waiting_s(),
            load=self._load(),
            bitrate=self._bitrate,
            link=tuple(self._link(messages)),
            messages=messages,
        )

    # ------------------------------------------------------------ values

    def _value(self, signal: Signal) -> float | None:
        """The newest value, unless its message is lost."""
        return self._record.series(signal).at(self._now_ns) if self._fresh(signal.can_id) else None

    def _flag(self, signal: Signal) -> bool | None:
        value = self._value(signal)
        return None if value is None else bool(value)

    def _count(self, signal: Signal) -> int | None:
        value = self._value(signal)
        return None if value is None else int(value)

    def _label(self, signal: Signal) -> str | None:
        value = self._value(signal)
        return None if value is None else label(signal, value)

    def _mode(self) -> str:
        """The AI side's mode as far as the bus shows it: by what the AI computer acknowledges.

        A mission that is chosen and not acknowledged means manual mode, or planner and controller have yet to confirm.
        """
        if not self._fresh(0x510):
            return "unknown"
        if self._record.at(sig.MISSION_STATUS, self._now_ns) != MissionStatus.NOT_SELECTED:
            return "autonomous"
        return "manual or unconfirmed" if self._record.at(sig.AMI, self._now_ns) else "unknown before a mission"

    def _states(self) -> dict[str, str]:
        found = {signal.name: word for signal in _STATES if (word := self._label(signal)) is not None}
        if sig.EBS_STATE.name in found:
            found.pop(sig.STATUS_EBS.name, None)  # the older word for the same
        return found

    def _fresh(self, can_id: int) -> bool:
        """Return true where the message comes, whole, and is not missing for so long that it counts as lost."""
        times = self._record.times(can_id)
        return bool(len(times)) and self._now_ns - int(times[-1]) < self._lost_after_ns(can_id)

    def _lost_after_ns(self, key: int) -> int:
        own = BY_ID.get(key)
        if own is not None and own.timeout_ns is not None:
            return own.timeout_ns
        expected_ns = self._expected_ns(key)
        return _UNSUPERVISED_PERIODS * expected_ns if expected_ns else WINDOW_NS

    def _expected_ns(self, key: int) -> int | None:
        layout = self._record.decoder.databases.layouts.get(key)
        return expected_period_ns(key, layout, self._record.revision.name)

    def _load(self) -> float | None:
        if not len(self._window):
            return None
        return share(wire_bits(self._window), int(np.ptp(self._window.t_ns)), self._bitrate)

    @property
    def _bitrate(self) -> int:
        return self._record.decoder.databases.baudrate or BITRATE

    def _lap_times_s(self) -> tuple[float, ...]:
        """Return the times between the steps of LAP_COUNTER in the newest stay in AS_DRIVING."""
        run = self._record.series(sig.AS_STATE).last(self._now_ns, sig.DRIVING)
        if run is None or not len(wheel := self._record.fastest_wheel):
            return ()
        end_ns = min(run.end_ns, self._now_ns)
        turning = (wheel.t_ns >= run.begin_ns) & (wheel.values >= STANDING_RPM)
        steps = self._record.series(sig.LAP).begun(run.begin_ns, end_ns)
        ends = [span.begin_ns for span in steps if span.before is not None and span.value == span.before + 1.0]
        begins = [*wheel.t_ns[turning][:1].tolist(), *ends]
        return tuple((end - begin) / S for begin, end in zip(begins, ends, strict=False))

    # ------------------------------------------------------------ messages

    def _messages(self) -> tuple[MessagePicture, ...]:
        found, counted = np.unique(keys_of(self._window), return_counts=True)
        counts = dict(zip(found.tolist(), counted.tolist(), strict=True))
        order = {message.can_id: place for place, message in enumerate(BUS_TABLE)}
        keys = sorted({*EXPECTED, *self._memory.first_ns}, key=lambda key: (order.get(key, len(order)), key))
        changed = changed_bytes(self._window, self._now_ns - S)
        return tuple(self._message(key, counts.get(key, 0), changed.get(key, ())) for key in keys)

    def _message(self, key: int, count: int, changed: tuple[int, ...]) -> MessagePicture:
        """Return the picture of one message, of which `count` frames came in the last seconds."""
        layout = self._record.decoder.databases.layouts.get(key)
        newest = self._memory.newest.get(key)
        expected_ns = self._expected_ns(key)
        expected_hz = round(S / expected_ns, 2) if expected_ns else None
        name = layout.name if layout is not None else None
        if newest is None:
            return MessagePicture(key, False, name, 0.0, expected_hz, None, Freshness.NEVER, False)
        listened_ns = min(WINDOW_NS, max(self._now_ns - self._memory.first_ns[key], 1))
        # The first frame begins the time over which the others are counted.
        rate_hz = round(max(0, count - (listened_ns < WINDOW_NS)) * S / listened_ns, 2)
        age_ns = max(0, self._now_ns - newest.t_ns)
        freshness = Freshness.FRESH
        if age_ns >= self._lost_after_ns(key):
            freshness = Freshness.LOST
        elif expected_ns and age_ns >= _LATE_PERIODS * expected_ns:
            freshness = Freshness.LATE
        wrong = layout is not None and newest.length != layout.length
        seen = (newest.can_id, newest.extended, name, rate_hz, expected_hz, age_ns / S, freshness, wrong)
        return MessagePicture(*seen, newest.data, changed)

    # ------------------------------------------------------------ the link

    def _handshake_waiting_s(self) -> float | None:
        """Return how long (s) the newest toggle of the VCU has had no echo; None where it had one, or there is none."""
        answers = self._record.answers
        if answers.echoed[-1:].all() or not self._fresh(sig.STATUS):  # of no answers, too
            return None
        return (self._now_ns - int(answers.toggle_ns[-1])) / S

    def _link(self, messages: tuple[MessagePicture, ...]) -> Iterator[str]:
        """Yield what is wrong on the bus itself, the gravest first."""
        for others in (self._record.second_senders, self._record.second_cars):
            recent = [other.sentence for other in others if other.end_ns > self._now_ns - WINDOW_NS]
            yield from recent[-1:]
        lost = [m for m in messages if not m.extended and m.can_id in AI_IDS and m.freshness is Freshness.LOST]
        if len(lost) == len(AI_IDS):
            age_s = min(m.age_s or 0.0 for m in lost)
            yield f"the AI computer is silent for {ms(round(age_s * S))}: to the VCU that is AI_COMMS_LOST"
        else:
            for m in lost:
                missing = f"{BY_ID[m.can_id]} is missing for {ms(round((m.age_s or 0.0) * S))}"
                yield f"{missing}: to the VCU that is AI_COMMS_LOST"
        for m in messages:
            if m.wrong_length:
                yield f"{m.name} (0x{m.number}) has the wrong length: it counts as missing"
        waiting_s = self._handshake_waiting_s()
        if waiting_s is not None and waiting_s >= _SLOW_ECHO_S and len(lost) < len(AI_IDS):
            yield f"the handshake's echo is missing for {ms(round(waiting_s * S))} (100 ms are a loss)"
        errors = self._record.error_ns[self._record.error_ns > self._now_ns - WINDOW_NS].tolist()
        if errors:
            many = f"{len(errors)} error frame{'s' * (len(errors) > 1)} in {WINDOW_NS // S} s"
            yield f"{many}, the last: {error_text(self._record, errors[-1])}"
