"""The timeline of a log: what changed, in the car's own words, one event after another."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import chain
from typing import Final

import numpy as np

from fsai_vcu.diagnostics.explain import signals as sig
from fsai_vcu.diagnostics.explain.endings import BRAKING, service_brakes
from fsai_vcu.diagnostics.explain.evidence import AT_ONCE_NS, error_text, silence_words
from fsai_vcu.diagnostics.explain.incident import TimelineEntry, Weight
from fsai_vcu.diagnostics.explain.record import GONE_NS, Gap, Record, Series
from fsai_vcu.diagnostics.explain.signals import Signal, label
from fsai_vcu.interface.bus_table import BY_ID, Flow
from fsai_vcu.interface.enums import OFF_LIKE, EbsState, EbsStatus, MissionStatus, TsState
from fsai_vcu.interface.reserved import AI_IDS, VCU_IDS
from fsai_vcu.interface.specification import COMMS_LOST_NS, STANDING_RPM
from fsai_vcu.interface.units import MS, S, ms

GAP_PERIODS: Final = 5  # of ten that are a loss: worth a line
MANY: Final = 12  # gaps of one message, or changes of one signal at short intervals, named one by one
# What one instant brings is listed with causes before effects.
ORDER: Final = (
    "bus", "link", "intruder", "switches", "Go", "mission", "fault", "AS state", "AI", "mode", "gate", "power", "EBS",
    "brakes", "steering", "warning", "motion",
)  # fmt: skip

NOTE, STATE, WARNING, FAULT = Weight
_REMOTE: Final = ("the remote's ESTOP_STATUS is 0", "the remote's ESTOP_STATUS is 1")
_ESTOP: Final = (
    "ESTOP_REQUEST 0: the request is taken back",
    "ESTOP_REQUEST 1: the AI computer asks for an emergency stop",
)
_STEERING: Final = ("the steering is off (STEERING_STATUS 0)", "the steering is active")
# signal, topic, what 0 and 1 mean to people, weight of 0 and of 1
SWITCHES: Final = (
    (sig.AS_SWITCH, "switches", ("ASMS off", "ASMS on"), (STATE, STATE)),
    (sig.TS_SWITCH, "switches", ("TSMS off", "TSMS on"), (STATE, STATE)),
    (sig.GO, "Go", ("Go off", "Go on"), (STATE, STATE)),
    (sig.REMOTE_ESTOP, "switches", _REMOTE, (STATE, STATE)),
    (sig.SHUTDOWN_REQUEST, "power", ("SHUTDOWN_REQUEST ends", "the car asks for shutdown"), (NOTE, STATE)),
    (sig.ESTOP, "AI", _ESTOP, (STATE, FAULT)),
    (sig.FAULT_STATUS, "fault", ("FAULT_STATUS 0", "FAULT_STATUS 1"), (STATE, FAULT)),
    (sig.WARNING_STATUS, "warning", ("WARNING_STATUS 0", "WARNING_STATUS 1"), (NOTE, WARNING)),
    (sig.STEERING_STATUS, "steering", _STEERING, (NOTE, NOTE)),
)
STATES: Final = (
    (sig.AS_STATE, "AS state", STATE),
    (sig.AMI, "mission", STATE),
    (sig.MISSION_STATUS, "AI", STATE),
    (sig.DIRECTION, "AI", NOTE),
    (sig.SHUTDOWN_CAUSE, "fault", FAULT),
    (sig.OP_STATE, "power", NOTE),
    (sig.TS_STATE, "power", NOTE),
    (sig.EBS_STATE, "EBS", NOTE),
    (sig.STATUS_EBS, "EBS", NOTE),
    (sig.STATUS_BRK, "brakes", NOTE),
)
GRAVE: Final = {
    (sig.AS_STATE, sig.EMERGENCY): FAULT,
    (sig.TS_STATE, float(TsState.TS_FAULT)): FAULT,
    (sig.EBS_STATE, float(EbsState.EBS_FAULT)): FAULT,
    (sig.EBS_STATE, float(EbsState.EBS_TRIGGERED)): WARNING,
    (sig.STATUS_EBS, float(EbsStatus.TRIGGERED)): WARNING,
    (sig.STATUS_BRK, 4.0): FAULT,
    (sig.SHUTDOWN_CAUSE, 0.0): NOTE,
}
SM_SYS_NAMES: Final = (  # interface specification v4.0: SM_SYS of 0x120
    "INITIAL_ACTIONS", "POWER_ON_SELF_TEST", "AUX", "POWERTRAIN_ENABLE", "DRIVE_AUTONOMOUS", "DRIVE_MANUAL", "CHARGE",
    "SHUTDOWN", "SHUTDOWN_OFF", "PUSHBAR_MODE",
)  # fmt: skip


def timeline(record: Record) -> list[TimelineEntry]:
    """Every event of the log in the order of time."""
    chapters = (
        _speakers, _switches, _states, _flags, _mode, _motion, _first_requests, _early_torque, _service_brakes, _link,
        _bus,
    )  # fmt: skip
    events = sorted((event for chapter in chapters for event in chapter(record)), key=_order)
    return sorted(_to_and_fro(events, record.begin_ns), key=_order)


def _order(event: TimelineEntry) -> tuple[int, int]:
    return event.t_ns, ORDER.index(event.topic)


def _to_and_fro(events: list[TimelineEntry], begin_ns: int) -> Iterator[TimelineEntry]:
    """One line for a signal that changes again and again, as with two senders: the first change, how many, the last."""
    runs: dict[object, list[list[TimelineEntry]]] = {}
    for event in events:
        of_one = runs.setdefault((event.topic, event.can_id, event.signal), [])
        if not of_one or event.t_ns - of_one[-1][-1].t_ns > GONE_NS:
            of_one.append([])
        of_one[-1].append(event)
    for run in chain.from_iterable(runs.values()):
        if len(run) > MANY:
            until_s = (run[-1].t_ns - begin_ns) / S
            text = f"{run[0].text}; {len(run) - 1} more changes of it up to {until_s:.3f} s, then {run[-1].text}"
            yield replace(run[0], text=text, weight=max(event.weight for event in run))
        else:
            yield from run


def _entry(signal: Signal, t_ns: int, topic: str, text: str, weight: Weight = NOTE) -> TimelineEntry:
    """An event which a frame with this signal shows."""
    return TimelineEntry(t_ns, topic, text, weight, signal.can_id, signal.name)


def _speakers(record: Record) -> Iterator[TimelineEntry]:
    """Yield the first frames of car and AI computer, with their times."""
    for can_id, topic, who in (
        (sig.STATUS, "power", "the first 0x520 of the car"),
        (0x510, "AI", "the first 0x510 of the AI computer"),
    ):
        times = record.times(can_id)
        if len(times):
            already = " (it was sending already)" if times[0] - record.begin_ns < 50 * MS else ""
            yield TimelineEntry(int(times[0]), topic, who + already, STATE, can_id)


def _switches(record: Record) -> Iterator[TimelineEntry]:
    for signal, topic, texts, weights in SWITCHES:
        for span in record.series(signal).spans:
            if span.before is not None or span.value:
                begins = " (from the first frame on)" if span.before is None else ""
                on = bool(span.value)
                yield _entry(signal, span.begin_ns, topic, texts[on] + begins, weights[on])


def _states(record: Record) -> Iterator[TimelineEntry]:
    """Yield the changes of the states that the car and the AI computer report."""
    for signal, topic, usual in STATES:
        if signal in (sig.STATUS_BRK, sig.STATUS_EBS) and not record.series(signal).values.any():
            continue
        for span in record.series(signal).spans:
            if span.before is None and signal is sig.SHUTDOWN_CAUSE and not span.value:
                continue
            weight = GRAVE.get((signal, span.value), usual)
            known = label(signal, span.value)
            if "not in the interface" in known and not (signal is sig.STATUS_EBS and span.value == 0):
                weight = max(weight, WARNING)
            text = f"{signal.name} {known}"
            if signal is sig.AS_STATE and span.before is not None:
                text = f"AS_STATE {label(signal, span.before)} → {known}"
            yield _entry(signal, span.begin_ns, topic, text, weight)
    for span in record.series(sig.SM_SYS).spans:
        name = SM_SYS_NAMES[int(span.value)] if span.value < len(SM_SYS_NAMES) else f"{span.value:.0f}"
        yield _entry(sig.SM_SYS, span.begin_ns, "power", f"SM_SYS {name}")


def _flags(record: Record) -> Iterator[TimelineEntry]:
    """Fault and warning bits, and what the VCU misses."""
    rows = [(signal, "fault", f"{signal.name} 1", FAULT) for signal in sig.FAULTS]
    rows += [(signal, "warning", f"{signal.name} 1", WARNING) for signal in (*sig.WARNINGS, *sig.SYSTEM_WARNINGS)]
    rows += [(signal, "link", f"the VCU misses {what} ({signal.name})", WARNING) for signal, what in sig.MISSED.items()]
    for signal, topic, text, weight in rows:
        for span in record.series(signal).spans:
            if span.value:
                yield _entry(signal, span.begin_ns, topic, text, weight)
            elif span.before is not None:
                yield _entry(signal, span.begin_ns, topic, f"{signal.name} 0")


def _mode(record: Record) -> Iterator[TimelineEntry]:
    """The AI side's mode is not on the bus; what it acknowledges is."""
    acknowledged = "mode: autonomous, as the AI computer acknowledges the mission"
    waits = "mode: manual, or the new mission is not confirmed yet (NOT_SELECTED 2 s after the choice)"
    for span in record.series(sig.MISSION_STATUS).spans:
        chosen = record.at(sig.AS_STATE, span.begin_ns) in OFF_LIKE and record.at(sig.AMI, span.begin_ns)
        if chosen and span.value == MissionStatus.SELECTED:
            yield _entry(sig.MISSION_STATUS, span.begin_ns, "mode", acknowledged, STATE)
    for span in record.series(sig.AMI).spans:
        later = span.begin_ns + 2 * S
        off = all(record.at(sig.AS_STATE, t_ns) in OFF_LIKE for t_ns in (span.begin_ns, later))
        if span.value and off and later < span.end_ns and record.at(sig.MISSION_STATUS, later) == 0:
            yield _entry(sig.MISSION_STATUS, later, "mode", waits, WARNING)


def _motion(record: Record) -> Iterator[TimelineEntry]:
    """Yield the times at which the car sets off and stands."""
    wheels = record.fastest_wheel
    turning = Series(wheels.t_ns, (wheels.values >= STANDING_RPM).astype(np.float64))
    for span in turning.spans:
        if span.before is None and span.value:
            yield TimelineEntry(span.begin_ns, "motion", "the wheels turn (from the first frame on)", STATE, 0x525)
        elif span.before is not None and span.value:
            yield TimelineEntry(span.begin_ns, "motion", "the wheels begin to turn", NOTE, 0x525)
        elif span.before is not None:
            begun = turning.span_at(span.begin_ns - 1)
            top = wheels.between(begun.begin_ns if begun else 0, span.begin_ns - 1).values.max()
            if top >= 3 * STANDING_RPM:
                text = f"the wheels stand (under 10 rpm), {top:.0f} rpm at most before"
                yield TimelineEntry(span.begin_ns, "motion", text, NOTE, 0x525)


def _first_requests(record: Record) -> Iterator[TimelineEntry]:
    """Yield what the AI side's gate lets through in AS_DRIVING: the first torque, the brake's release."""
    for span in record.series(sig.AS_STATE).spans:
        if span.value != sig.DRIVING or span.before is None:
            continue
        firsts = []
        for signal in (sig.TORQUE_F, sig.TORQUE_R):
            part = record.series(signal).between(span.begin_ns, span.end_ns)
            firsts += [(int(t_ns), signal) for t_ns in part.t_ns[part.values > 0][:1]]
        found = [(*min(firsts), "the first torque request")] if firsts else []
        part = record.series(sig.BRAKE_REQ_F).between(span.begin_ns, span.end_ns)
        if len(part) and part.values[0] != 0:
            released = part.t_ns[part.values == 0][:1].tolist()
            found += [(t_ns, sig.BRAKE_REQ_F, "the brake is released") for t_ns in released]
        for t_ns, signal, words in found:
            yield _entry(signal, t_ns, "gate", f"{words}, {ms(t_ns - span.begin_ns)} after AS_DRIVING began")


def _service_brakes(record: Record) -> Iterator[TimelineEntry]:
    for _, t_ns in service_brakes(record):
        if t_ns is not None:
            yield _entry(sig.BRAKE_REQ_F, t_ns, "gate", BRAKING, STATE)


def _early_torque(record: Record) -> Iterator[TimelineEntry]:
    """Torque before AS_DRIVING, and how far the steering may go."""
    for span in record.series(sig.AS_STATE).spans:
        for signal in (sig.TORQUE_F, sig.TORQUE_R) if span.value in (*OFF_LIKE, sig.READY) else ():
            asked = [s for s in record.changes(signal, span.begin_ns, span.end_ns) if s.value > 0 and s.before == 0]
            for first in asked[:1]:
                text = f"{signal.name} {first.value:g} Nm in {label(sig.AS_STATE, span.value)}"
                yield _entry(signal, first.begin_ns, "AI", text, WARNING)
    for span in record.series(sig.ANGLE_MAX).spans:
        if span.before is not None:
            yield _entry(sig.ANGLE_MAX, span.begin_ns, "steering", f"ANGLE_MAX {span.before:g} → {span.value:g} deg")


def _link(record: Record) -> Iterator[TimelineEntry]:
    """Messages that did not come, several that stopped together as one; echoes that did not; who else sends."""
    for begin_ns, end_ns in record.silences:
        yield TimelineEntry(begin_ns, "bus", silence_words(begin_ns, end_ns), WARNING)
    for ids, who in ((AI_IDS, "the AI computer"), (VCU_IDS, "the car")):
        together: dict[int, list[Gap]] = {}
        for can_id in ids:
            period_ns = BY_ID[can_id].period_ns[record.revision.name]
            gaps = [gap for gap in record.gaps(can_id, GAP_PERIODS * period_ns) if not record.silence_in(gap)]
            if len(gaps) > MANY:
                text = f"{BY_ID[can_id]} pauses {len(gaps)} times, {ms(max(g.length_ns for g in gaps))} at most"
                yield TimelineEntry(gaps[0].begin_ns, "link", text, WARNING, can_id)
                continue
            for gap in gaps:
                key = next((k for k in together if abs(k - gap.begin_ns) <= AT_ONCE_NS), gap.begin_ns)
                together.setdefault(key, []).append(gap)
        for begin_ns, missing in together.items():
            longest = max(missing, key=lambda gap: gap.length_ns)
            everything = len(missing) == sum(map(record.has, ids))
            gone = everything and longest.length_ns >= GONE_NS
            names = ", ".join(f"0x{can_id:03X}" for can_id in sorted(gap.can_id for gap in missing))
            text = f"{names} {'is' if len(missing) == 1 else 'are'} missing"
            if everything and len(missing) > 1:
                text = f"{who} is silent"
            if gone and ids is VCU_IDS:
                text += ": switched off, or unplugged"
            grave = longest.length_ns >= 10 * BY_ID[longest.can_id].period_ns[record.revision.name]
            weight = WARNING if grave else NOTE
            yield TimelineEntry(begin_ns, "link", f"{text} {longest.words()}", weight, longest.can_id)
            if longest.end_ns is not None and gone:
                yield TimelineEntry(longest.end_ns, "link", f"{who} is received again", STATE, longest.can_id)
    over_ns = 0
    for toggle_ns, _, waited_ns in record.answers.late(COMMS_LOST_NS):
        if toggle_ns >= over_ns:  # a car that toggles on waits on
            over_ns = toggle_ns + waited_ns
            text = f"the handshake's echo is missing for {ms(waited_ns)} (100 ms are a loss)"
            yield TimelineEntry(toggle_ns, "link", text, WARNING, 0x510, "HANDSHAKE")
    for other in (*record.second_senders, *record.second_cars):
        yield TimelineEntry(other.begin_ns, "intruder", other.sentence, FAULT, other.can_ids[0])


def _bus(record: Record) -> Iterator[TimelineEntry]:
    """Error frames (grouped), frames of wrong length, a clock that was set."""
    for burst in np.split(record.error_ns, np.flatnonzero(np.diff(record.error_ns) > GONE_NS) + 1):
        if len(burst):
            first, last = int(burst[0]), int(burst[-1])
            many = f"{len(burst)} error frames within {ms(last - first)}" if len(burst) > 1 else "an error frame"
            yield TimelineEntry(first, "bus", f"{many}: {error_text(record, first)}", FAULT)
    for can_id, wrong in record.wrong_length.items():
        known = BY_ID.get(can_id)
        grave = known is not None and known.flow in (Flow.TO_VCU, Flow.FROM_VCU)
        text = f"{known or f'0x{can_id:03X}'} has {wrong.words} ({wrong.frames} frames): it counts as missing"
        yield TimelineEntry(wrong.first_ns, "bus", text, FAULT if grave else WARNING, can_id)
    for t_ns, by_ns in sorted(record.clock_set):
        way = "back" if by_ns < 0 else "forward"
        text = f"the log's clock was set {way} by {ms(abs(by_ns))}: the times here are corrected"
        yield TimelineEntry(t_ns, "bus", text, WARNING)
