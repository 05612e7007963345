"""Evidence that the frames give of the moments before: how the link was lost, and why the AI computer asked.

The conditions and times of an ESTOP_REQUEST or a service-brake stop are those of the supervisor (core/supervision): its
own checks are run over the log.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable
from itertools import pairwise
from typing import Any, Final

import numpy as np

from fsai_vcu.core.supervision.config import BridgeConfig, Reason
from fsai_vcu.core.supervision.plausibility import SteeringCheck, WheelCheck, check_steering, check_wheels
from fsai_vcu.core.supervision.wheel_speeds import WheelBelief, on_counts, on_speeds
from fsai_vcu.diagnostics.decode.error_frames import error_words
from fsai_vcu.diagnostics.explain import signals as sig
from fsai_vcu.diagnostics.explain.incident import Candidate, ChainLink, Sureness, candidate, shown
from fsai_vcu.diagnostics.explain.record import Gap, Record, Span, Values
from fsai_vcu.diagnostics.explain.signals import Signal, label
from fsai_vcu.diagnostics.log.frames import ERROR
from fsai_vcu.interface import messages
from fsai_vcu.interface.bus_table import BY_ID
from fsai_vcu.interface.enums import Ami, EbsState, OpState, TsState
from fsai_vcu.interface.fields import fields_of
from fsai_vcu.interface.reserved import AI_IDS
from fsai_vcu.interface.specification import COMMS_LOST_NS, STANDING_RPM
from fsai_vcu.interface.units import MS, S, ms

EARLY_NS: Final = 15 * MS  # the VCU counts from when it missed the first one; the log's stamps differ a little
AT_ONCE_NS: Final = 30 * MS  # messages that stop within this time stop together
LOOK_BACK_NS: Final = 2 * S
CONFIG: Final = BridgeConfig()
INTRUDER_NS: Final = 60 * MS  # the answer to an intruder leaves with the next cycle
BUS_NS: Final = 1 * S
JUDGED_NS: Final = 30 * S  # implausibility is looked for over so much of the drive
BELIEVED_NS: Final = 4 * S  # so much before is needed to compare wheel speeds with pulse counts
SLACK_NS: Final = 25 * MS
ECHOES: Final = 5
MOSTLY_WRONG: Final = 0.9
SAG_SHARE: Final = 0.75  # of a supply's voltage: less starts no VCU again
PRESSURE_NS: Final = 5 * S
FELL_SHARE: Final = 0.8


# ---------------------------------------------------------------- the link


def gap_at(record: Record, can_id: int, t_ns: int, least_ns: int) -> Gap | None:
    """The gap of that message which had lasted `least_ns` (or nearly) at `t_ns`, or had ended shortly before."""
    gaps = record.gaps(can_id, least_ns - EARLY_NS)
    place = bisect_left(gaps, t_ns - AT_ONCE_NS, key=lambda gap: gap.over_ns)
    if place == len(gaps) or gaps[place].begin_ns + least_ns - EARLY_NS > t_ns or record.silence_in(gaps[place]):
        return None
    return gaps[place]


def silence_words(begin_ns: int, end_ns: int) -> str:
    return f"nothing at all is received for {ms(end_ns - begin_ns)}: the bus was dead, or the recording paused"


def dead_bus(record: Record, t_ns: int, sureness: Sureness) -> list[Candidate]:
    """Nothing was received just before `t_ns`: then no single message can be blamed."""
    for begin_ns, end_ns in record.silences:
        if begin_ns < t_ns and end_ns >= t_ns - AT_ONCE_NS:
            return [candidate("bus_lost", sureness, ChainLink(begin_ns, silence_words(begin_ns, end_ns)))]
    return []


def frozen_words(record: Record, span: Span) -> str:
    """Describe a stretch of the record with a frozen 0x520."""
    state = label(sig.AS_STATE, record.at(sig.AS_STATE, span.begin_ns))
    length = ms(span.end_ns - span.begin_ns)
    return f"0x520 repeats itself for {length} in {state}, HANDSHAKE stands though it is echoed"


def error_text(record: Record, t_ns: int) -> str:
    """Return what the error frame at `t_ns` says."""
    frames = record.frames
    rows = np.flatnonzero(((frames.flags & ERROR) != 0) & (frames.t_ns == t_ns))
    return ", ".join(error_words(int(frames.can_id[rows[0]]), frames.payload(int(rows[0]))))


def link_losses(record: Record, t_ns: int, sureness: Sureness) -> list[Candidate]:
    """Return what explains AI_COMMS_LOST at `t_ns`, the likeliest first. Empty where the frames show a sound link.

    `sureness`: how sure it is that the link was lost at all.
    """
    if found := dead_bus(record, t_ns, sureness):
        return found
    gaps = {can_id: gap for can_id in AI_IDS if (gap := gap_at(record, can_id, t_ns, COMMS_LOST_NS)) is not None}
    begins = [gap.begin_ns for gap in gaps.values()]
    if len(gaps) == len(AI_IDS) and max(begins) - min(begins) <= AT_ONCE_NS:
        return [_silent(record, t_ns, list(gaps.values()), sureness)]
    for can_id, gap in gaps.items():
        wrong = record.wrong_length.get(can_id)
        if wrong is not None and wrong.first_ns <= t_ns:
            slug, words = "ai_message_length", f"{BY_ID[can_id]} comes with {wrong.words}"
        else:
            length = "to the end of the log" if gap.end_ns is None else gap.words()
            slug = "ai_message_missing"
            words = f"the last {BY_ID[can_id]} before it is missing {length}, while others go on"
        found.append(candidate(slug, sureness, ChainLink(gap.begin_ns, words, can_id)))
    for can_id in AI_IDS if record.ai_speaks else ():
        if not record.has(can_id):
            begin_ns = min(int(record.times(i)[0]) for i in AI_IDS if record.has(i))
            wrong = record.wrong_length.get(can_id)
            slug = "ai_message_length" if wrong else "ai_message_missing"
            words = f"{BY_ID[can_id]} " + (f"always has {wrong.words}" if wrong else "never comes")
            found.append(candidate(slug, sureness, ChainLink(begin_ns, words, can_id)))
    return found or _handshake(record, t_ns, sureness)


def _silent(record: Record, t_ns: int, gaps: list[Gap], sureness: Sureness) -> Candidate:
    """All five messages stopped together."""
    first = min(gap.begin_ns for gap in gaps)
    back = min((gap.end_ns for gap in gaps if gap.end_ns is not None), default=None)
    ends = "and did not come back" if back is None else f"for {ms(back - first)}"
    steps = [ChainLink(first, f"the last frame of the AI computer: 0x510 to 0x514 are silent {ends}", 0x510)]
    errors = record.errors_before(t_ns, LOOK_BACK_NS)
    if errors:
        many = f"{len(errors)} error frame{'s' if len(errors) > 1 else ''}"
        steps.append(ChainLink(errors[0], f"{many} on the bus: {error_text(record, errors[0])}"))
    if record.at(sig.ESTOP, first):
        steps.append(sig.ESTOP.step(first, "its last 0x510 has ESTOP_REQUEST 1: it was stopped on purpose"))
    # An adapter that goes bus-off silences a program that runs on; the others go on.
    off_ns = next((t_error_ns for t_error_ns in errors if "bus-off" in error_text(record, t_error_ns)), None)
    if off_ns is None:
        return candidate("ai_silent", sureness, *steps)
    steps.append(ChainLink(off_ns, f"an error frame: {error_text(record, off_ns)}"))
    heard = record.times(sig.STATUS)
    count = int(np.searchsorted(heard, t_ns, side="right") - np.searchsorted(heard, first))
    if not count:
        return candidate("bus_lost", sureness, *steps)
    goes_on = ChainLink(first, f"0x520 goes on: {count} come meanwhile, so the bus itself is alive", sig.STATUS)
    return candidate("ai_bus_off", sureness, *steps, goes_on)


def _handshake(record: Record, t_ns: int, sureness: Sureness) -> list[Candidate]:
    late_ns = COMMS_LOST_NS - EARLY_NS
    for toggle_ns, bit, waited_ns in record.answers.late(late_ns):
        if toggle_ns + late_ns <= t_ns <= toggle_ns + waited_ns + AT_ONCE_NS:
            words = f"HANDSHAKE becomes {bit}, and 0x510 keeps saying {1 - bit} for {ms(waited_ns)}"
            return [candidate("handshake_lost", sureness, ChainLink(toggle_ns, words, 0x520, "HANDSHAKE"))]
    return _contradicted(record, t_ns, sureness)


def _contradicted(record: Record, t_ns: int, sureness: Sureness) -> list[Candidate]:
    """The echoes of the last 100 ms said another bit than the last 0x520 before each of them."""
    asked, echo = record.series(sig.HANDSHAKE), record.series(sig.ECHO).between(t_ns - LOOK_BACK_NS, t_ns)
    before = echo.t_ns[echo.t_ns < t_ns]
    wrong = echo.values[: len(before)] != asked.sampled(before)
    lately = before > t_ns - COMMS_LOST_NS
    if not len(asked) or lately.sum() < ECHOES or wrong[lately].mean() < MOSTLY_WRONG:
        return []
    right = np.flatnonzero(~wrong & ~lately)
    first = int(before[right[-1] + 1] if len(right) and right[-1] + 1 < len(before) else before[lately][0])
    bits = [
        (int(asked.at(at_ns) or 0), int(value))
        for at_ns, value in zip(before, echo.values, strict=False)
        if at_ns >= first
    ]
    count = sum(said != bit for bit, said in bits)
    kind = (
        "always the same bit" if len({said for _, said in bits}) == 1 else "the inverse, or the bit of the 0x520 before"
    )
    words = (
        f"{count} of {len(bits)} 0x510 contradict the last 0x520 before them, for {ms(t_ns - first)}: they say {kind}"
    )
    return [candidate("echo_wrong", sureness, sig.ECHO.step(first, words))]


# ---------------------------------------------------------------- voltages and pressures beside them


def sag(record: Record, gap: Gap) -> list[ChainLink]:
    """The supply's voltage before the VCU fell silent, where the log has it and it fell."""
    volts = record.series(sig.SUPPLY).between(gap.begin_ns - LOOK_BACK_NS, gap.over_ns)
    if len(volts) < 2 or volts.values.min() > SAG_SHARE * volts.values.max():
        return []
    low = int(volts.values.argmin())
    high = float(volts.values[: low + 1].max())
    words = f"VBAT_ADC falls from {high:.1f} to {volts.values[low]:.1f} V"
    return [
        sig.SUPPLY.step(int(volts.t_ns[low]), words, sig.SUPPLY.was(float(volts.values[low]), int(volts.t_ns[low])))
    ]


def accumulators(record: Record, t_ns: int) -> list[ChainLink]:
    """The pressure in the EBS accumulators (0x301): how it fell, or what it was."""
    found = []
    for signal in sig.ACCUMULATORS:
        part = record.series(signal).between(t_ns - PRESSURE_NS, t_ns)
        if not len(part):
            continue
        now = float(part.values[-1])
        fell = now < FELL_SHARE * part.values.max()
        since = int(np.flatnonzero(part.values == part.values.max())[-1]) if fell else len(part) - 1
        at_ns = int(part.t_ns[since])
        words = f"{signal.name} falls from {part.values[since]:.1f} to {now:.1f} bar in {ms(t_ns - at_ns)}"
        words = words if fell else f"{signal.name} is {now:.1f} bar"
        found.append(signal.step(at_ns, words, signal.was(now, t_ns)))
    return found


# ---------------------------------------------------------------- why the AI computer asked


def found_before(record: Record, t_ns: int, drive_begin_ns: int, *, emergency: bool) -> list[Candidate]:
    """Everything on the bus that makes a careful AI computer ask for an emergency (or, else, stop) at `t_ns`."""
    found: list[Candidate] = []
    feedback_ns, implausible_ns = CONFIG.feedback_stale_ns, CONFIG.implausible_ns
    if emergency:
        feedback_ns, implausible_ns = CONFIG.feedback_lost_ns, CONFIG.implausible_lost_ns
        found += _intruder(record, t_ns)
        found += _missing(record, t_ns, 0x520, Reason.VCU_SILENT, CONFIG.vcu_lost_ns)
    for can_id, reason in ((0x525, Reason.WHEELS_STALE), (0x523, Reason.STEERING_STALE)):
        missing = _missing(record, t_ns, can_id, reason, feedback_ns)
        if not missing and not emergency and not record.has(can_id):
            missing = [shown(reason.slug, ChainLink(drive_begin_ns, f"0x{can_id:03X} never comes", can_id))]
        found += missing
    found += _not_believed(record, t_ns, feedback_ns)
    found += dead_bus(record, t_ns, Sureness.SHOWN)
    found += _implausible(record, t_ns, drive_begin_ns, implausible_ns)
    found += _paused(record, t_ns)
    if errors := record.errors_before(t_ns, BUS_NS):
        words = f"{len(errors)} error frames within {ms(t_ns - errors[0])} before"
        found.append(shown(Reason.BUS_LOST.slug, ChainLink(errors[0], words)))
    return found + (_ineffective(record, t_ns) if emergency else _changed(record, t_ns))


def _intruder(record: Record, t_ns: int) -> list[Candidate]:
    """The first sender besides the AI computer that came just before `t_ns`."""
    for other in record.second_senders:
        if 0 <= t_ns - other.begin_ns <= INTRUDER_NS:
            return [shown(Reason.INTRUDER.slug, ChainLink(other.begin_ns, other.words, other.can_ids[0]))]
    return []


def _missing(record: Record, t_ns: int, can_id: int, reason: Reason, patience_ns: int) -> list[Candidate]:
    """A message of the car that was missing for that long."""
    gap = gap_at(record, can_id, t_ns, patience_ns)
    if gap is None:
        return []
    end = ", to the end of the log" if gap.end_ns is None else ""
    words = f"the last 0x{can_id:03X} before {ms(gap.length_ns)} without it{end}"
    return [shown(reason.slug, ChainLink(gap.begin_ns, words, can_id))]


def _paused(record: Record, t_ns: int) -> list[Candidate]:
    """The first pause of the AI computer's own cycle among its last five 0x510."""
    times = record.times(0x510)
    recent = times[: np.searchsorted(times, t_ns, side="right")][-5:].tolist()
    for begin_ns, end_ns in pairwise(recent):
        if end_ns - begin_ns >= CONFIG.send_lost_ns:
            words = f"the AI computer itself paused for {ms(end_ns - begin_ns)} (its cycle is 10 ms)"
            return [shown(Reason.LOOP_FAULT.slug, ChainLink(begin_ns, words, 0x510))]
    return []


def _falls(span: Span) -> bool:
    return span.value == 0.0


def _rises(span: Span) -> bool:
    return span.before == 0.0


def _to_none_of(*sound: float) -> Callable[[Span], bool]:
    return lambda span: span.value not in sound


_BECOMES, _FROM_TO = "{name} becomes {after}", "{name} {before} → {after}"
# Changes for which the AI computer stops: the signal, the reason, the test of a change, and its words
_CHANGES: Final[tuple[tuple[Signal, Reason, Callable[[Span], bool], str], ...]] = (
    (sig.GO, Reason.GO_OFF, _falls, _BECOMES),
    (sig.FAULT_STATUS, Reason.FAULT_STATUS, _rises, _BECOMES),
    (sig.AS_SWITCH, Reason.AS_SWITCH_OFF, _falls, _BECOMES),
    (sig.TS_SWITCH, Reason.TS_SWITCH_OFF, _falls, _BECOMES),
    (sig.SHUTDOWN_REQUEST, Reason.SHUTDOWN_REQUESTED, _rises, _BECOMES),
    *((fault, Reason.FAULT_BIT, _rises, _BECOMES) for fault in sig.FAULTS),
    (sig.SHUTDOWN_CAUSE, Reason.SHUTDOWN_CAUSE, _rises, _BECOMES),
    (sig.EBS_STATE, Reason.STATE_FAULT, _to_none_of(*set(EbsState) - {EbsState.EBS_FAULT}), _FROM_TO),
    (sig.TS_STATE, Reason.STATE_FAULT, _to_none_of(*set(TsState) - {TsState.TS_FAULT}), _FROM_TO),
    (sig.OP_STATE, Reason.STATE_FAULT, _to_none_of(*set(OpState) - {OpState.OP_FAULT}), _FROM_TO),
    (sig.AMI, Reason.AMI_CHANGED, _to_none_of(), _FROM_TO),
)


def _changed(record: Record, t_ns: int) -> list[Candidate]:
    """Changes in 0x520 just before `t_ns` for which the AI computer stops."""
    found = []
    for signal, reason, stops, words in _CHANGES:
        for span in filter(stops, record.changes(signal, t_ns - 100 * MS, t_ns)):
            before, after = label(signal, span.before), label(signal, span.value)
            step = signal.step(span.begin_ns, words.format(name=signal.name, before=before, after=after))
            found.append(shown(reason.slug, step))
    return found


def _not_believed(record: Record, t_ns: int, patience_ns: int) -> list[Candidate]:
    """Wheel speeds that came and were not believed for so long, by the supervisor's own rules."""
    if (record.fastest_wheel.between(t_ns - BELIEVED_NS, t_ns).values >= CONFIG.wheel_max_rpm + 1).all():
        return []  # none of them was, nor is a frame that never came
    frames: list[Any] = []
    for kind, can_id, signals in ((messages.WheelCounts, 0x526, sig.PULSES), (messages.WheelSpeeds, 0x525, sig.WHEELS)):
        times = record.times(can_id)
        part = slice(*np.searchsorted(times, (t_ns - BELIEVED_NS, t_ns + 1)))
        columns = [record.series(signal).values[part].astype(np.int64).tolist() for signal in signals]
        frames += [kind(*each) for each in zip(*columns, times[part].tolist(), strict=False)]
    belief, believed_ns, doubt = WheelBelief(), None, ""
    for frame in sorted(frames, key=lambda frame: frame.t_rx_ns):
        if isinstance(frame, messages.WheelCounts):
            belief = on_counts(CONFIG, record.car, belief, frame)
            continue
        belief, why = on_speeds(CONFIG, belief, frame)
        if why:
            doubt = why
        else:
            believed_ns = frame.t_rx_ns
    if not doubt or believed_ns is None or t_ns - believed_ns < patience_ns - SLACK_NS:
        return []
    words = f"{doubt}: 0x525 is not believed for {ms(t_ns - believed_ns)}"
    return [shown(Reason.WHEELS_STALE.slug, ChainLink(believed_ns, words, 0x525))]


def _ineffective(record: Record, t_ns: int) -> list[Candidate]:
    """The service brake was asked for, and the wheels did not slow down."""
    wheels = record.fastest_wheel
    now = wheels.at(t_ns)
    if now is None or now < STANDING_RPM:
        return []
    front = record.span_at(sig.BRAKE_REQ_F, t_ns - SLACK_NS)
    if front is None or front.value < CONFIG.stop_brake_pct - 1:
        return []
    asked_ns = t_ns - SLACK_NS - front.begin_ns
    before = wheels.at(t_ns - CONFIG.stop_window_ns)
    slow = before is not None and now > before - 2 * CONFIG.stop_min_drop_rpm
    if asked_ns < CONFIG.stop_timeout_ns - 100 * MS and not (slow and asked_ns >= CONFIG.stop_window_ns - SLACK_NS):
        return []
    others = record.middle_wheel.at(t_ns) or 0.0
    alone = others < STANDING_RPM  # a brake holds all wheels or none
    reason = Reason.WHEEL_IMPLAUSIBLE if alone else Reason.STOP_INEFFECTIVE
    turn = f"one wheel reads {now:.0f} rpm, the others {others:.0f}" if alone else f"the wheels turn at {now:.0f} rpm"
    words = f"the brake is asked for at {front.value:g} % for {ms(asked_ns)}, and still {turn}"
    return [shown(reason.slug, sig.BRAKE_REQ_F.step(front.begin_ns, words))]


def _implausible(record: Record, t_ns: int, drive_begin_ns: int, patience_ns: int) -> list[Candidate]:
    """The supervisor's plausibility checks, run over the log up to `t_ns`."""
    car, shown_ns = record.car, patience_ns - 2 * SLACK_NS
    begin_ns = max(drive_begin_ns + CONFIG.launch_wait_ns, t_ns - JUDGED_NS)
    steer, wheel = SteeringCheck(), WheelCheck()
    times = record.times(0x513)
    times = times[(times >= begin_ns) & (times <= t_ns)]
    if not len(times):
        return []

    def column(signal: Signal) -> Values:
        return record.series(signal).sampled(times)

    angle, angle_ns, asked = column(sig.ANGLE), record.newest_ns(0x523, times), column(sig.STEER)
    rpm, rpm_ns = np.stack([column(signal) for signal in sig.WHEELS]).astype(np.int64), record.newest_ns(0x525, times)
    alike = (np.ptp(rpm, axis=0) <= CONFIG.wheel_margin_rpm) & (times - rpm_ns < CONFIG.feedback_stale_ns)
    # Wheels that turned alike within the time that counts have not been odd for all of it.
    inspected = record.at(sig.AMI, t_ns) in (Ami.STATIC_INSPECTION_A, Ami.STATIC_INSPECTION_B)
    odd = not inspected and not alike[times > t_ns - shown_ns].any()
    wheels = list(map(messages.WheelSpeeds, *rpm.tolist(), rpm_ns.tolist())) if odd else []
    requests: dict[Any, list[Any]] = {
        one.command: column(Signal(message.dbc_name, one.signal)).astype(one.holds).tolist()
        for message in (messages.AiDriveFront, messages.AiDriveRear, messages.AiBrake)
        for one in fields_of(message)
        if odd
    }
    steering = zip(times.tolist(), asked.tolist(), angle.tolist(), angle_ns.tolist(), strict=True)
    for row, (now_ns, asked_deg, angle_deg, measured_ns) in enumerate(steering):
        measured = messages.VcuSteer(angle_deg, t_rx_ns=measured_ns)
        steer = check_steering(CONFIG, car, steer, asked_deg, measured, now_ns)
        if odd:
            command = messages.AiCommand(**{name: values[row] for name, values in requests.items()})
            wheel = check_wheels(CONFIG, car, wheel, command, wheels[row], measured, now_ns)
    found = []
    words = f"asked for {asked[-1]:.1f} deg, measured {angle[-1]:.1f} deg"
    for since_ns, reason, can_id, what in (
        (steer.implausible_since_ns, Reason.STEERING_IMPLAUSIBLE, 0x523, words),
        (wheel.implausible_since_ns, Reason.WHEEL_IMPLAUSIBLE, 0x525, wheel.detail),
    ):
        if since_ns is not None and t_ns - since_ns >= shown_ns:
            text = f"{what}: implausible for {ms(t_ns - since_ns)} until then"
            found.append(shown(reason.slug, ChainLink(since_ns, text, can_id)))
    return found
