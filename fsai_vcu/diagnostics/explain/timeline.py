"""The timeline of a log: what changed, in the car's own words, one event after another."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np

from fsai_vcu.diagnostics.explain import signals as sig
from fsai_vcu.diagnostics.explain.incident import TimelineEntry, Weight
from fsai_vcu.diagnostics.explain.link import AT_ONCE_NS, GONE_NS, error_text, ms
from fsai_vcu.diagnostics.explain.record import Record
from fsai_vcu.diagnostics.explain.signals import label
from fsai_vcu.interface.bus_table import BY_ID, Flow
from fsai_vcu.interface.enums import OFF_LIKE, EbsState, EbsStatus, MissionStatus, TsState
from fsai_vcu.interface.reserved import AI_IDS, VCU_IDS
from fsai_vcu.interface.specification import STANDING_RPM
from fsai_vcu.interface.units import MS, S

GAP_PERIODS: Final = 5  # of ten that are a loss: worth a line
MANY: Final = 12  # gaps of one message told singly
# What one instant brings is told with causes before effects.
ORDER: Final = (
    "bus", "link", "intruder", "switches", "Go", "mission", "fault", "AS state", "AI", "mode", "gate", "power", "EBS",
    "brakes", "steering", "warning", "motion",
)  # fmt: skip

# signal, topic, what 0 and 1 mean to people, weight of 0 and of 1
SWITCHES: Final = (
    (sig.AS_SWITCH, "switches", "ASMS off", "ASMS on", Weight.STATE, Weight.STATE),
    (sig.TS_SWITCH, "switches", "TSMS off", "TSMS on", Weight.STATE, Weight.STATE),
    (sig.GO, "Go", "Go off", "Go on", Weight.STATE, Weight.STATE),
    (
        sig.REMOTE_ESTOP,
        "switches",
        "the remote's ESTOP_STATUS is 0",
        "the remote's ESTOP_STATUS is 1",
        Weight.STATE,
        Weight.STATE,
    ),
    (sig.SHUTDOWN_REQUEST, "power", "SHUTDOWN_REQUEST ends", "the car asks for shutdown", Weight.NOTE, Weight.STATE),
    (
        sig.ESTOP,
        "AI",
        "ESTOP_REQUEST 0: the request is taken back",
        "ESTOP_REQUEST 1: the AI computer asks for an emergency stop",
        Weight.STATE,
        Weight.FAULT,
    ),
    (sig.FAULT_STATUS, "fault", "FAULT_STATUS 0", "FAULT_STATUS 1", Weight.STATE, Weight.FAULT),
    (sig.WARNING_STATUS, "warning", "WARNING_STATUS 0", "WARNING_STATUS 1", Weight.NOTE, Weight.WARNING),
    (
        sig.STEERING_STATUS,
        "steering",
        "the steering is off (STEERING_STATUS 0)",
        "the steering is active",
        Weight.NOTE,
        Weight.NOTE,
    ),
)
STATES: Final = (
    (sig.AS_STATE, "AS state", Weight.STATE),
    (sig.AMI, "mission", Weight.STATE),
    (sig.MISSION_STATUS, "AI", Weight.STATE),
    (sig.DIRECTION, "AI", Weight.NOTE),
    (sig.SHUTDOWN_CAUSE, "fault", Weight.FAULT),
    (sig.OP_STATE, "power", Weight.NOTE),
    (sig.TS_STATE, "power", Weight.NOTE),
    (sig.EBS_STATE, "EBS", Weight.NOTE),
    (sig.STATUS_EBS, "EBS", Weight.NOTE),
    (sig.STATUS_BRK, "brakes", Weight.NOTE),
)
GRAVE: Final = {
    (sig.AS_STATE, sig.EMERGENCY): Weight.FAULT,
    (sig.TS_STATE, float(TsState.TS_FAULT)): Weight.FAULT,
    (sig.EBS_STATE, float(EbsState.EBS_FAULT)): Weight.FAULT,
    (sig.EBS_STATE, float(EbsState.EBS_TRIGGERED)): Weight.WARNING,
    (sig.STATUS_EBS, float(EbsStatus.TRIGGERED)): Weight.WARNING,
    (sig.STATUS_BRK, 4.0): Weight.FAULT,
    (sig.SHUTDOWN_CAUSE, 0.0): Weight.NOTE,
}
SM_SYS_NAMES: Final = (  # interface specification v4.0: SM_SYS of 0x120
    "INITIAL_ACTIONS", "POWER_ON_SELF_TEST", "AUX", "POWERTRAIN_ENABLE", "DRIVE_AUTONOMOUS", "DRIVE_MANUAL", "CHARGE",
    "SHUTDOWN", "SHUTDOWN_OFF", "PUSHBAR_MODE",
)  # fmt: skip


def timeline(record: Record) -> list[TimelineEntry]:
    """Every event of the log in the order of time."""
    events = [
        *_speakers(record),
        *_switches(record),
        *_states(record),
        *_flags(record),
        *_mode(record),
        *_motion(record),
        *_gate(record),
        *_gaps(record),
        *_handshake(record),
        *_strangers(record),
        *_bus(record),
    ]
    return sorted(events, key=lambda event: (event.t_ns, ORDER.index(event.topic)))


def _speakers(record: Record) -> Iterator[TimelineEntry]:
    """Who speaks first, and when."""
    for can_id, who in (
        (sig.STATUS, "the car speaks: the first 0x520"),
        (0x510, "the AI computer speaks: the first 0x510"),
    ):
        times = record.times(can_id)
        if len(times):
            already = " (it did when the log began)" if times[0] - record.begin_ns < 50 * MS else ""
            yield TimelineEntry(
                int(times[0]), "power" if can_id == sig.STATUS else "AI", who + already, Weight.STATE, can_id
            )


def _switches(record: Record) -> Iterator[TimelineEntry]:
    for signal, topic, off, on, weight_off, weight_on in SWITCHES:
        for span in record.series(signal).spans:
            if span.before is None and not span.value:
                continue
            begins = " (since the log began)" if span.before is None else ""
            text, weight = (on, weight_on) if span.value else (off, weight_off)
            yield TimelineEntry(span.begin_ns, topic, text + begins, weight, signal.can_id, signal.name)


def _states(record: Record) -> Iterator[TimelineEntry]:
    for signal, topic, usual in STATES:
        if signal in (sig.OP_STATE, sig.TS_STATE, sig.EBS_STATE) and record.revision.name == "2021":
            continue
        if signal in (sig.STATUS_BRK, sig.STATUS_EBS) and not record.series(signal).values.any():
            continue
        for span in record.series(signal).spans:
            if span.before is None and signal is sig.SHUTDOWN_CAUSE and not span.value:
                continue
            weight = GRAVE.get((signal, span.value), usual)
            known = label(signal, span.value)
            if "not in the interface" in known and not (signal is sig.STATUS_EBS and span.value == 0):
                weight = max(weight, Weight.WARNING)
            text = f"{signal.name} {known}"
            if signal is sig.AS_STATE and span.before is not None:
                text = f"AS_STATE {label(signal, span.before)} → {known}"
            yield TimelineEntry(span.begin_ns, topic, text, weight, signal.can_id, signal.name)
    for span in record.series(sig.SM_SYS).spans:
        name = SM_SYS_NAMES[int(span.value)] if span.value < len(SM_SYS_NAMES) else f"{span.value:.0f}"
        yield TimelineEntry(span.begin_ns, "power", f"SM_SYS {name}", Weight.NOTE, sig.SM_SYS.can_id, sig.SM_SYS.name)


def _flags(record: Record) -> Iterator[TimelineEntry]:
    """Fault and warning bits."""
    missed = {signal: f"the VCU misses {BY_ID[can_id]}" for signal, can_id in sig.TIMEOUTS.items()}
    missed[sig.HANDSHAKE_TIMEOUT] = "the VCU misses the handshake's echo"
    groups = (
        (sig.FAULTS, "fault", Weight.FAULT),
        (sig.WARNINGS, "warning", Weight.WARNING),
        (sig.SYSTEM_WARNINGS, "warning", Weight.WARNING),
        (tuple(missed), "link", Weight.WARNING),
    )
    for signals, topic, weight in groups:
        for signal in signals:
            for span in record.series(signal).spans:
                if span.before is None and not span.value:
                    continue
                what = missed.get(signal)
                text = f"{what} ({signal.name})" if what and span.value else f"{signal.name} {span.value:.0f}"
                yield TimelineEntry(
                    span.begin_ns, topic, text, weight if span.value else Weight.NOTE, signal.can_id, signal.name
                )


def _mode(record: Record) -> Iterator[TimelineEntry]:
    """The AI side's mode is not on the bus; what it acknowledges is."""
    ami, state = record.series(sig.AMI), record.series(sig.AS_STATE)
    for span in record.series(sig.MISSION_STATUS).spans:
        if state.at(span.begin_ns) not in OFF_LIKE or not ami.at(span.begin_ns):
            continue
        if span.value == MissionStatus.SELECTED:
            text = "mode: autonomous, as the AI computer acknowledges the mission"
            yield TimelineEntry(span.begin_ns, "mode", text, Weight.STATE, 0x510, sig.MISSION_STATUS.name)
    chosen = [s for s in ami.spans if s.value and state.at(s.begin_ns) in OFF_LIKE]
    for span in chosen:
        later = span.begin_ns + 2 * S
        if later < span.end_ns and record.series(sig.MISSION_STATUS).at(later) == 0 and state.at(later) in OFF_LIKE:
            text = "mode: manual, or the new mission is not confirmed yet (NOT_SELECTED 2 s after the choice)"
            yield TimelineEntry(later, "mode", text, Weight.WARNING, 0x510, sig.MISSION_STATUS.name)


def _motion(record: Record) -> Iterator[TimelineEntry]:
    """When the car sets off and when it stands."""
    wheels = record.fastest_wheel()
    if not len(wheels):
        return
    turning = (wheels.values >= STANDING_RPM).astype(np.int8)
    changes = np.flatnonzero(np.diff(turning)) + 1
    begun: int | None = 0 if turning[0] else None
    if begun is not None:
        yield TimelineEntry(int(wheels.t_ns[0]), "motion", "the wheels turn when the log begins", Weight.STATE, 0x525)
    for row in changes.tolist():
        if turning[row]:
            begun = row
            yield TimelineEntry(int(wheels.t_ns[row]), "motion", "the wheels begin to turn", Weight.NOTE, 0x525)
        else:
            top = wheels.values[begun or 0 : row].max()
            if top >= 3 * STANDING_RPM:
                text = f"the wheels stand (under 10 rpm), {top:.0f} rpm at most before"
                yield TimelineEntry(int(wheels.t_ns[row]), "motion", text, Weight.NOTE, 0x525)
            begun = None


def _gate(record: Record) -> Iterator[TimelineEntry]:
    """What the AI side's gate lets through: the first torque of a drive, brake pressures that mean a stop."""
    for span in record.series(sig.AS_STATE).spans:
        if span.value != sig.DRIVING:
            continue
        for name, signals, words in (
            ("torque", (sig.TORQUE_F, sig.TORQUE_R), "the first torque request"),
            ("brake", (sig.BRAKE_REQ_F,), "the brake is released"),
        ):
            firsts = []
            for signal in signals:
                part = record.series(signal).between(span.begin_ns, span.end_ns)
                hits = np.flatnonzero(part.values > 0 if name == "torque" else part.values == 0)
                if len(hits) and not (name == "brake" and hits[0] == 0):
                    firsts.append((int(part.t_ns[hits[0]]), signal))
            if firsts and span.before is not None:
                t_ns, signal = min(firsts)
                text = f"{words}, {ms(t_ns - span.begin_ns)} after AS_DRIVING began"
                yield TimelineEntry(t_ns, "gate", text, Weight.NOTE, signal.can_id, signal.name)
    for span in record.series(sig.AS_STATE).spans:
        if span.value not in (*OFF_LIKE, sig.READY):
            continue
        for signal in (sig.TORQUE_F, sig.TORQUE_R):
            for asked in record.series(signal).changes(span.begin_ns, span.end_ns):
                if asked.value > 0 and asked.before == 0:
                    text = f"{signal.name} {asked.value:g} Nm in {label(sig.AS_STATE, span.value)}"
                    yield TimelineEntry(asked.begin_ns, "AI", text, Weight.WARNING, signal.can_id, signal.name)
                    break
    for span in record.series(sig.ANGLE_MAX).spans:
        if span.before is not None:
            text = f"ANGLE_MAX {span.before:g} → {span.value:g} deg"
            yield TimelineEntry(span.begin_ns, "steering", text, Weight.NOTE, sig.ANGLE_MAX.can_id, sig.ANGLE_MAX.name)


def _gaps(record: Record) -> Iterator[TimelineEntry]:
    """Messages that did not come, several that stopped together as one."""
    for quiet_ns, heard_ns in record.silences:
        text = f"nothing at all is received for {ms(heard_ns - quiet_ns)}: the bus was dead, or the recording paused"
        yield TimelineEntry(quiet_ns, "bus", text, Weight.WARNING)
    for ids, who in ((AI_IDS, "the AI computer"), (VCU_IDS, "the car")):
        together: dict[int, list[tuple[int, int, int | None]]] = {}
        for can_id in ids:
            period = BY_ID[can_id].period_ns[record.revision.name]
            gaps = [gap for gap in record.gaps(can_id, GAP_PERIODS * period) if not record.silence_in(gap)]
            if len(gaps) > MANY:
                text = f"{BY_ID[can_id]} pauses {len(gaps)} times, {ms(max(g.length_ns for g in gaps))} at most"
                yield TimelineEntry(gaps[0].begin_ns, "link", text, Weight.WARNING, can_id)
                continue
            for gap in gaps:
                key = next((k for k in together if abs(k - gap.begin_ns) <= AT_ONCE_NS), gap.begin_ns)
                together.setdefault(key, []).append((can_id, gap.length_ns, gap.end_ns))
        for begin_ns, missing in together.items():
            can_id, length_ns, end_ns = max(missing, key=lambda m: m[1])
            lasts = f"to the end of the log ({ms(length_ns)})" if end_ns is None else f"for {ms(length_ns)}"
            whole = len(missing) == sum(record.has(i) for i in ids)
            names = f"{who} is silent" if whole and len(missing) > 1 else _named(sorted(m[0] for m in missing))
            weight = Weight.WARNING if length_ns >= 10 * BY_ID[can_id].period_ns[record.revision.name] else Weight.NOTE
            if whole and length_ns >= GONE_NS and ids is VCU_IDS:
                names += ": switched off, or unplugged"
            yield TimelineEntry(begin_ns, "link", f"{names} {lasts}", weight, can_id)
            if end_ns is not None and length_ns >= GONE_NS and whole:
                yield TimelineEntry(end_ns, "link", f"{who} speaks again", Weight.STATE, can_id)


def _named(ids: list[int]) -> str:
    names = ", ".join(f"0x{can_id:03X}" for can_id in ids)
    return f"{names} {'is' if len(ids) == 1 else 'are'} missing"


def _handshake(record: Record) -> Iterator[TimelineEntry]:
    for answer in record.answers:
        if answer.lost:
            text = f"the handshake's echo is missing for {ms(answer.waited_ns)} (100 ms are a loss)"
            yield TimelineEntry(answer.toggle_ns, "link", text, Weight.WARNING, 0x510, "HANDSHAKE")


def _strangers(record: Record) -> Iterator[TimelineEntry]:
    for other in record.second_senders:
        text = f"somebody else sends on the AI computer's ids: {other.words}"
        yield TimelineEntry(other.begin_ns, "intruder", text, Weight.FAULT, other.can_ids[0])


def _bus(record: Record) -> Iterator[TimelineEntry]:
    """Error frames (grouped), frames of wrong length, a clock that was set back."""
    for first, last, count in _bursts(record):
        many = f"{count} error frames within {ms(last - first)}" if count > 1 else "an error frame"
        yield TimelineEntry(first, "bus", f"{many}: {error_text(record, first)}", Weight.FAULT)
    for can_id, (count, first) in record.wrong_length.items():
        owner = BY_ID[can_id].flow if can_id in BY_ID else Flow.OTHER
        weight = Weight.FAULT if owner in (Flow.TO_VCU, Flow.FROM_VCU) else Weight.WARNING
        name = BY_ID.get(can_id, f"0x{can_id:03X}")
        yield TimelineEntry(
            first, "bus", f"{name} with the wrong length ({count} frames): it counts as missing", weight, can_id
        )
    for t_ns, back_ns in record.set_back:
        if back_ns < MS:
            continue  # two frames stamped on two processors
        yield TimelineEntry(
            t_ns, "bus", f"the log's clock was set back by {ms(back_ns)}: what follows is moved on", Weight.WARNING
        )


def _bursts(record: Record) -> Iterator[tuple[int, int, int]]:
    times = record.error_ns
    if not len(times):
        return
    cuts = np.flatnonzero(np.diff(times) > GONE_NS) + 1
    for part in np.split(times, cuts):
        yield int(part[0]), int(part[-1]), len(part)
