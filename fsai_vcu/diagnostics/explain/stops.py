"""Drives that ended regularly, but early: the AI computer stopped the car by its service brake.

How it brakes tells why: commands that fall silent leave torque 0 and the steering held for 200 ms before the brake
comes; everything else brakes at once.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from fsai_vcu.core.supervision.reasons import Reason
from fsai_vcu.diagnostics.explain import signals as sig
from fsai_vcu.diagnostics.explain.evidence import CONFIG, found_before
from fsai_vcu.diagnostics.explain.incident import (
    Candidate,
    ChainLink,
    Incident,
    IncidentKind,
    Sureness,
    candidate,
    ranked,
)
from fsai_vcu.diagnostics.explain.record import Record
from fsai_vcu.interface.enums import Ami
from fsai_vcu.interface.units import MS

FAST_RPM: Final = 80  # 2 m/s: a mission that is done brakes by command to less than this before it stops for good
HELD_NS: Final = 150 * MS  # of the 200 ms between torque 0 and the brake
SLACK_NS: Final = 25 * MS


def early_stops(record: Record) -> list[Incident]:
    """Every service-brake stop from speed in a drive that was not ended by an emergency brake."""
    found = []
    spans = record.series(sig.AS_STATE).spans
    for place, span in enumerate(spans):
        if span.value != sig.DRIVING:
            continue
        if place + 1 < len(spans) and spans[place + 1].value == sig.EMERGENCY:
            continue
        began_ns = _service_brake(record, span.begin_ns, span.end_ns)
        if began_ns is None or record.series(sig.ESTOP).at(began_ns):
            continue
        stop = _stop(record, began_ns, span.begin_ns)
        in_the_air = record.series(sig.AMI).at(began_ns) == Ami.STATIC_INSPECTION_A
        if in_the_air and stop.candidates[0].slug == "stop_asked":
            continue  # this mission is done at speed: its wheels come to rest within 5 s
        found.append(stop)
    return found


def _service_brake(record: Record, begin_ns: int, end_ns: int) -> int | None:
    """When the brake first went to the service-brake stop's pressure, at speed, with the motors' speed limit at 0."""
    brake = record.series(sig.BRAKE_REQ_F).between(begin_ns, end_ns)
    wheels = record.fastest_wheel()
    if not len(brake) or not len(wheels):
        return None
    for row in np.flatnonzero(np.abs(brake.values - CONFIG.stop_brake_pct) < 1.0):
        t_ns = int(brake.t_ns[row])
        if (wheels.at(t_ns) or 0) < FAST_RPM:
            return None  # the first such brake is the one that counts
        if record.series(sig.SPEED_MAX_R).at(t_ns) == 0:
            return t_ns
    return None


def _stop(record: Record, t_ns: int, drive_begin_ns: int) -> Incident:
    brake = sig.BRAKE_REQ_F.step(t_ns, f"the brake goes to {CONFIG.stop_brake_pct:g} %, torque 0: stopping for good")
    candidates = [
        Candidate(c.slug, c.sureness, (*c.steps, brake))
        for c in found_before(record, t_ns, drive_begin_ns, emergency=False)
    ]
    held_ns = _held_before(record, t_ns)
    if held_ns is not None:
        step = sig.TORQUE_R.step(
            held_ns, f"torque 0 and the steering held: no fresh command for {CONFIG.command_stale_ns // MS} ms by then"
        )
        lost = ChainLink(held_ns - CONFIG.command_stale_ns, "about when the last fresh command came (not on the bus)")
        candidates.append(candidate(Reason.COMMAND_STALE.slug, Sureness.FITS, [lost, step, brake]))
    candidates.append(candidate("stop_asked", Sureness.POSSIBLE, [brake]))
    wheels = record.fastest_wheel().at(t_ns) or 0
    what = f"service-brake stop from {wheels:.0f} rpm"
    return Incident(IncidentKind.STOP, t_ns, what, ranked(candidates))


def _held_before(record: Record, t_ns: int) -> int | None:
    """Since when torque was 0 and steering and brake stood still, if for about the 200 ms of stale commands."""
    begin_ns = t_ns - HELD_NS
    for signal in (sig.TORQUE_F, sig.TORQUE_R, sig.STEER):
        values = record.series(signal).between(begin_ns, t_ns - SLACK_NS).values
        if len(values) and (values.max() != values.min() or (signal is not sig.STEER and values.max() > 0)):
            return None
    span = record.series(sig.STEER).span_at(t_ns - SLACK_NS)
    zero = [record.series(signal).span_at(t_ns - SLACK_NS) for signal in (sig.TORQUE_F, sig.TORQUE_R)]
    begins = [s.begin_ns for s in (span, *zero) if s is not None]
    latest = max(begins, default=begin_ns)
    longest_ns = CONFIG.command_lost_ns - CONFIG.command_stale_ns
    return max(latest, t_ns - longest_ns)
