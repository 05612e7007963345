"""Why did the AI computer ask: what the frames show before an ESTOP_REQUEST or before its service-brake stop.

The conditions and times are those of the supervisor (core/supervision): its own checks are run over the log.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from fsai_vcu.core.supervision.config import BridgeConfig
from fsai_vcu.core.supervision.plausibility import SteeringCheck, WheelCheck, check_steering, check_wheels
from fsai_vcu.core.supervision.reasons import Reason
from fsai_vcu.core.supervision.wheel_speeds import WheelBelief, on_counts, on_speeds
from fsai_vcu.diagnostics.explain import signals as sig
from fsai_vcu.diagnostics.explain.actuation import sampled
from fsai_vcu.diagnostics.explain.incident import Candidate, ChainLink, Sureness, candidate
from fsai_vcu.diagnostics.explain.link import dead_bus, gap_at, ms
from fsai_vcu.diagnostics.explain.record import Record, Signal, Values
from fsai_vcu.diagnostics.explain.signals import car_of, label
from fsai_vcu.diagnostics.log.frames import Ints
from fsai_vcu.interface.enums import Ami
from fsai_vcu.interface.messages import AiCommand, VcuSteer, WheelCounts, WheelSpeeds
from fsai_vcu.interface.specification import STANDING_RPM
from fsai_vcu.interface.units import MS, S

CONFIG: Final = BridgeConfig()
INTRUDER_NS: Final = 60 * MS  # the answer to an intruder leaves with the next cycle
BUS_NS: Final = 1 * S
JUDGED_NS: Final = 30 * S  # implausibility is looked for over so much of the drive
BELIEVED_NS: Final = 4 * S  # so much before is needed to compare wheel speeds with pulse counts
SLACK_NS: Final = 25 * MS


def found_before(record: Record, t_ns: int, drive_begin_ns: int, *, emergency: bool) -> list[Candidate]:
    """Everything on the bus that makes a careful AI computer ask for an emergency (or, else, stop) at `t_ns`."""
    config = CONFIG
    found: list[Candidate] = []

    def add(slug: str, since_ns: int, words: str, can_id: int | None = None, signal: str = "") -> None:
        found.append(candidate(slug, Sureness.SHOWN, [ChainLink(since_ns, words, can_id, signal)]))

    if emergency:
        for other in record.second_senders:
            if other.begin_ns <= t_ns and t_ns - other.begin_ns <= INTRUDER_NS:
                add(Reason.INTRUDER.slug, other.begin_ns, other.words, other.can_ids[0])
                break
        gap = gap_at(record, 0x520, t_ns, config.vcu_lost_ns)
        if gap is not None:
            add(
                Reason.VCU_SILENT.slug,
                gap.begin_ns,
                f"the last 0x520 before {_lasting(gap.end_ns, gap.length_ns)}",
                0x520,
            )
    patience = config.feedback_lost_ns if emergency else config.feedback_stale_ns
    for can_id, reason in ((0x525, Reason.WHEELS_STALE), (0x523, Reason.STEERING_STALE)):
        gap = gap_at(record, can_id, t_ns, patience)
        if gap is None and not emergency and not record.has(can_id):
            add(reason.slug, drive_begin_ns, f"0x{can_id:03X} never comes", can_id)
        elif gap is not None:
            add(
                reason.slug,
                gap.begin_ns,
                f"the last 0x{can_id:03X} before {_lasting(gap.end_ns, gap.length_ns)}",
                can_id,
            )
    found += _not_believed(record, t_ns, patience)
    found += dead_bus(record, t_ns, Sureness.SHOWN)
    found += _implausible(
        record, t_ns, drive_begin_ns, config.implausible_lost_ns if emergency else config.implausible_ns
    )
    pause = _own_pause(record, t_ns)
    if pause is not None:
        begin, length = pause
        add(
            Reason.LOOP_FAULT.slug, begin, f"the AI computer itself paused for {ms(length)} (its cycle is 10 ms)", 0x510
        )
    errors = record.error_ns[(record.error_ns >= t_ns - BUS_NS) & (record.error_ns <= t_ns)]
    if len(errors):
        add(
            Reason.BUS_LOST.slug,
            int(errors[0]),
            f"{len(errors)} error frames within {ms(t_ns - int(errors[0]))} before",
        )
    if emergency:
        found += _ineffective(record, t_ns)
    else:
        for signal, reason, falls in (
            (sig.GO, Reason.GO_OFF, True),
            (sig.FAULT_STATUS, Reason.FAULT_STATUS, False),
            (sig.AS_SWITCH, Reason.AS_SWITCH_OFF, True),
            (sig.TS_SWITCH, Reason.TS_SWITCH_OFF, True),
            (sig.SHUTDOWN_REQUEST, Reason.SHUTDOWN_REQUESTED, False),
            *((fault, Reason.FAULT_BIT, False) for fault in sig.FAULTS),
            (sig.SHUTDOWN_CAUSE, Reason.SHUTDOWN_CAUSE, False),
        ):
            for span in record.series(signal).changes(t_ns - 100 * MS, t_ns):
                if (span.value if falls else span.before) == 0.0:
                    words = f"{signal.name} becomes {label(signal, span.value)}"
                    add(reason.slug, span.begin_ns, words, signal.can_id, signal.name)
    return found


def _not_believed(record: Record, t_ns: int, patience_ns: int) -> list[Candidate]:
    """Wheel speeds that came and were not believed for so long, by the supervisor's own rules."""
    car = car_of(record)
    times, counts_ns = record.times(0x525), record.times(0x526)
    rows = range(int(np.searchsorted(times, t_ns - BELIEVED_NS)), int(np.searchsorted(times, t_ns, side="right")))
    speeds = [record.series(signal).values for signal in sig.WHEELS]
    pulses = [record.series(signal).values for signal in sig.PULSES]
    belief, believed_ns, doubt = WheelBelief(), None, ""
    place = int(np.searchsorted(counts_ns, t_ns - BELIEVED_NS))
    for row in rows:
        now_ns = int(times[row])
        while place < len(counts_ns) and counts_ns[place] <= now_ns and all(map(len, pulses)):
            counts = WheelCounts(*(int(column[place]) for column in pulses))
            belief = on_counts(CONFIG, car, belief, replace(counts, t_rx_ns=int(counts_ns[place])))
            place += 1
        turning = WheelSpeeds(*(int(column[row]) for column in speeds))
        belief, why = on_speeds(CONFIG, belief, replace(turning, t_rx_ns=now_ns))
        if why:
            doubt = why
        else:
            believed_ns = now_ns
    if not doubt or believed_ns is None or t_ns - believed_ns < patience_ns - SLACK_NS:
        return []
    words = f"{doubt}: 0x525 is not believed for {ms(t_ns - believed_ns)}"
    return [candidate(Reason.WHEELS_STALE.slug, Sureness.SHOWN, [ChainLink(believed_ns, words, 0x525)])]


def _lasting(end_ns: int | None, length_ns: int) -> str:
    return f"{ms(length_ns)} without it" + ("" if end_ns is not None else ", to the end of the log")


def _own_pause(record: Record, t_ns: int) -> tuple[int, int] | None:
    """A pause of the AI computer's cycle that ended just before it asked."""
    times = record.times(0x510)
    place = int(np.searchsorted(times, t_ns, side="right")) - 1
    for row in range(max(place - 3, 1), place + 1):
        length = int(times[row] - times[row - 1])
        if length >= CONFIG.send_lost_ns:
            return int(times[row - 1]), length
    return None


def _ineffective(record: Record, t_ns: int) -> list[Candidate]:
    """The service brake was asked for, and the wheels did not slow down."""
    wheels = record.fastest_wheel()
    now = wheels.at(t_ns)
    if now is None or now < STANDING_RPM:
        return []
    front = record.series(sig.BRAKE_REQ_F).span_at(t_ns - SLACK_NS)
    if front is None or front.value < CONFIG.stop_brake_pct - 1:
        return []
    asked_ns = t_ns - SLACK_NS - front.begin_ns
    before = wheels.at(t_ns - CONFIG.stop_window_ns)
    slow = before is not None and now > before - 2 * CONFIG.stop_min_drop_rpm
    if asked_ns < CONFIG.stop_timeout_ns - 100 * MS and not (slow and asked_ns >= CONFIG.stop_window_ns - SLACK_NS):
        return []
    words = (
        f"the brake is asked for at {front.value:g} % for {ms(asked_ns)}, and the wheels still turn at {now:.0f} rpm"
    )
    return [
        candidate(
            Reason.STOP_INEFFECTIVE.slug,
            Sureness.SHOWN,
            [sig.BRAKE_REQ_F.step(front.begin_ns, words)],
        )
    ]


def _implausible(record: Record, t_ns: int, drive_begin_ns: int, patience_ns: int) -> list[Candidate]:
    """The supervisor's plausibility checks, run over the log up to `t_ns`."""
    car = car_of(record)
    begin_ns = max(drive_begin_ns + CONFIG.launch_wait_ns, t_ns - JUDGED_NS)
    steer, wheel = SteeringCheck(), WheelCheck()
    times = record.times(0x513)
    times = times[(times >= begin_ns) & (times <= t_ns)]
    if not len(times):
        return []

    def column(signal: Signal) -> Values:
        return sampled(record.series(signal), times)

    def age_base(can_id: int) -> Ints:
        heard = record.times(can_id)
        places = np.searchsorted(heard, times, side="right") - 1
        return np.where(places >= 0, heard[np.maximum(places, 0)] if len(heard) else 0, -S)

    angle, angle_ns = column(sig.ANGLE), age_base(0x523)
    rpm = [column(signal) for signal in sig.WHEELS]
    rpm_ns = age_base(0x525)
    asked = column(sig.STEER)
    torque_f, torque_r = column(sig.TORQUE_F), column(sig.TORQUE_R)
    brake_f, brake_r = column(sig.BRAKE_REQ_F), column(sig.BRAKE_REQ_R)
    limit_f, limit_r = column(sig.SPEED_MAX_F), column(sig.SPEED_MAX_R)
    inspected = _inspection(record, t_ns)
    for row, now in enumerate(times.tolist()):
        measured = VcuSteer(float(angle[row]), t_rx_ns=int(angle_ns[row]))
        steer = check_steering(CONFIG, car, steer, float(asked[row]), measured, now)
        if inspected:
            continue
        command = AiCommand(
            front_torque_nm=float(torque_f[row]),
            rear_torque_nm=float(torque_r[row]),
            front_brake_pct=float(brake_f[row]),
            rear_brake_pct=float(brake_r[row]),
            front_motor_speed_max_rpm=int(limit_f[row]),
            rear_motor_speed_max_rpm=int(limit_r[row]),
        )
        turning = [int(column_of[row]) for column_of in rpm]
        speeds = replace(WheelSpeeds(*turning), t_rx_ns=int(rpm_ns[row]))
        wheel = check_wheels(CONFIG, car, wheel, command, speeds, measured, now)
    found = []
    for since_ns, slug, can_id, words in (
        (
            steer.implausible_since_ns,
            Reason.STEERING_IMPLAUSIBLE.slug,
            0x523,
            f"asked for {asked[-1]:.1f} deg, measured {angle[-1]:.1f} deg",
        ),
        (wheel.implausible_since_ns, Reason.WHEEL_IMPLAUSIBLE.slug, 0x525, wheel.detail),
    ):
        if since_ns is not None and t_ns - since_ns >= patience_ns - 2 * SLACK_NS:
            text = f"{words}: implausible for {ms(t_ns - since_ns)}"
            found.append(candidate(slug, Sureness.SHOWN, [ChainLink(since_ns, text, can_id)]))
    return found


def _inspection(record: Record, t_ns: int) -> bool:
    return record.series(sig.AMI).at(t_ns) in (Ami.STATIC_INSPECTION_A, Ami.STATIC_INSPECTION_B)
