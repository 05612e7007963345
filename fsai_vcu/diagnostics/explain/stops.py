"""Drives that ended regularly, but early: the AI computer stopped the car by its service brake.

How it brakes tells why: commands that fall silent leave torque 0 and the steering held for 200 ms before the brake
comes; everything else brakes at once.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import zip_longest
from typing import Final

import numpy as np

from fsai_vcu.core.supervision.reasons import Reason
from fsai_vcu.diagnostics.explain import signals as sig
from fsai_vcu.diagnostics.explain.actuation import sampled
from fsai_vcu.diagnostics.explain.evidence import CONFIG, found_before
from fsai_vcu.diagnostics.explain.incident import (
    Candidate,
    ChainLink,
    Incident,
    IncidentKind,
    Sureness,
    candidate,
    ranked,
    shown,
)
from fsai_vcu.diagnostics.explain.record import Record, Span, ms
from fsai_vcu.interface.enums import Ami
from fsai_vcu.interface.specification import READY_WAIT_NS, STANDING_RPM
from fsai_vcu.interface.units import MS, S

FAST_RPM: Final = 80  # 2 m/s: a mission that is done brakes by command to less than this before it stops for good
IDLE_NS: Final = 8 * S  # 3 s of standing still, and as long again for the first torque
NOT_SHOWN: Final = (Reason.COMMAND_STALE.slug, "stop_asked")  # causes that no frame shows
HELD_NS: Final = 150 * MS  # of the 200 ms between torque 0 and the brake
SLACK_NS: Final = 25 * MS


def early_stops(record: Record) -> list[Incident]:
    """Every service-brake stop from speed in a drive that was not ended by an emergency brake."""
    found = []
    spans = record.series(sig.AS_STATE).spans
    for span, after in zip_longest(spans, spans[1:]):
        if span.value != sig.DRIVING or (after is not None and after.value == sig.EMERGENCY):
            continue
        began_ns = _service_brake(record, span.begin_ns, span.end_ns)
        if began_ns is None or record.at(sig.ESTOP, began_ns):
            found += _without_a_stop(record, span)
            continue
        stop = _stop(record, began_ns, span.begin_ns)
        # Slow after a drive, or on stands, a mission that is done stops like this: then only what the bus shows counts.
        wheels = record.fastest_wheel().between(span.begin_ns, began_ns).values
        slow = len(wheels) and wheels[-1] < FAST_RPM <= wheels.max()
        on_stands = record.at(sig.AMI, began_ns) == Ami.STATIC_INSPECTION_A
        if any(one.slug not in NOT_SHOWN for one in stop.candidates) or not (slow or on_stands):
            found.append(stop)
    return found


def _without_a_stop(record: Record, span: Span) -> list[Incident]:
    """AS_DRIVING that was over before it drove, or that the AI computer does not take for a drive of its own."""
    wheels = record.fastest_wheel().between(span.begin_ns, span.end_ns).values
    asked = [record.series(signal).between(span.begin_ns, span.end_ns) for signal in (sig.TORQUE_F, sig.TORQUE_R)]
    if span.before is None or not len(wheels) or not all(map(len, asked)):
        return []
    finished = bool(record.changes(sig.AS_STATE, span.end_ns, span.end_ns, to=sig.FINISHED))
    over = record.span_at(sig.MISSION_STATUS, span.end_ns) if finished else None
    over_ns = span.end_ns if over is None else over.begin_ns
    candidates = found_before(record, over_ns, span.begin_ns, emergency=False) if finished else []
    idle = span.end_ns - span.begin_ns >= IDLE_NS and not any(series.values.any() for series in asked)
    if wheels.max() < STANDING_RPM and (finished or idle):
        candidates += _start_was_wrong(record, span)
        if record.at(sig.AMI, span.end_ns) not in (Ami.STATIC_INSPECTION_A, Ami.STATIC_INSPECTION_B):
            step = ChainLink(span.begin_ns, "the AI computer does not drive in AS_DRIVING", 0x512)
            candidates.append(candidate("stop_asked", Sureness.POSSIBLE, step))
    if not candidates:
        return []
    what = f"AS_DRIVING for {ms(span.end_ns - span.begin_ns)}, and not faster than {wheels.max():.0f} rpm"
    return [Incident(IncidentKind.STOP, over_ns, what, ranked(candidates))]


def _start_was_wrong(record: Record, span: Span) -> list[Candidate]:
    if not record.at(sig.AMI, span.begin_ns):
        return [shown(Reason.NO_MISSION.slug, sig.AMI.step(span.begin_ns, "AMI_STATE is 0: no mission is chosen"))]
    ready = record.span_at(sig.AS_STATE, span.begin_ns - 1)
    go = record.span_at(sig.GO, span.begin_ns)
    if ready is None or ready.value != sig.READY:
        return []
    waited_ns = span.begin_ns - ready.begin_ns
    if waited_ns < READY_WAIT_NS - SLACK_NS:
        step = sig.AS_STATE.step(ready.begin_ns, f"AS_READY for {ms(waited_ns)}: 5 s have to pass")
    elif go is not None and go.value and go.begin_ns <= ready.begin_ns:
        step = sig.GO.step(go.begin_ns, "GO_SIGNAL is 1 since before AS_READY began: no Go was given in it")
    else:
        return []
    return [shown(Reason.SEQUENCE_SHORT.slug, step)]


def _service_brake(record: Record, begin_ns: int, end_ns: int) -> int | None:
    """When the brake went to the service-brake stop's pressure, with the motors' speed limit at 0 from then on."""
    brake = record.series(sig.BRAKE_REQ_F).between(begin_ns, end_ns)
    limited = sampled(record.series(sig.SPEED_MAX_R), brake.t_ns) == 0
    driven = np.flatnonzero(~limited)
    if not len(driven):
        return None
    stopping = np.flatnonzero(np.abs(brake.values[driven[-1] :] - CONFIG.stop_brake_pct) < 1.0)
    return int(brake.t_ns[driven[-1] + stopping[0]]) if len(stopping) else None


def _stop(record: Record, t_ns: int, drive_begin_ns: int) -> Incident:
    brake = sig.BRAKE_REQ_F.step(t_ns, f"the brake goes to {CONFIG.stop_brake_pct:g} %, torque 0: stopping for good")
    before = found_before(record, t_ns, drive_begin_ns, emergency=False)
    candidates = [replace(one, steps=(*one.steps, brake)) for one in before]
    held_ns = _held_before(record, t_ns)
    if held_ns is not None:
        stale_ms = CONFIG.command_stale_ns // MS
        words = f"torque 0 and the steering held: no fresh command for {stale_ms} ms by then"
        lost = ChainLink(held_ns - CONFIG.command_stale_ns, "about when the last fresh command came (not on the bus)")
        step = sig.TORQUE_R.step(held_ns, words)
        candidates.append(candidate(Reason.COMMAND_STALE.slug, Sureness.FITS, lost, step, brake))
    candidates.append(candidate("stop_asked", Sureness.POSSIBLE, brake))
    what = f"service-brake stop from {record.fastest_wheel().at(t_ns) or 0:.0f} rpm"
    return Incident(IncidentKind.STOP, t_ns, what, ranked(candidates))


def _held_before(record: Record, t_ns: int) -> int | None:
    """Since when torque was 0 and steering and brake stood still, if for about the 200 ms of stale commands."""
    signals, until_ns = (sig.TORQUE_F, sig.TORQUE_R, sig.STEER), t_ns - SLACK_NS
    for signal in signals:
        values = record.series(signal).between(t_ns - HELD_NS, until_ns).values
        if len(values) and (values.max() != values.min() or (signal is not sig.STEER and values.max() > 0)):
            return None
    spans = [record.span_at(signal, until_ns) for signal in signals]
    latest = max((span.begin_ns for span in spans if span is not None), default=t_ns - HELD_NS)
    return max(latest, t_ns - (CONFIG.command_lost_ns - CONFIG.command_stale_ns))
