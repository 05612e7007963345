"""Why the car is not driving at this moment, from the bus alone: the rules that explain a log, asked about now."""

from __future__ import annotations

from typing import Final

from fsai_vcu.diagnostics.explain import signals as sig
from fsai_vcu.diagnostics.explain.causes import CAUSES
from fsai_vcu.diagnostics.explain.incident import Candidate, Incident, Sureness
from fsai_vcu.diagnostics.explain.link import ms
from fsai_vcu.diagnostics.explain.record import Record
from fsai_vcu.diagnostics.explain.signals import label
from fsai_vcu.diagnostics.explain.starting import TO_DRIVING, TO_READY, unmet
from fsai_vcu.diagnostics.monitor.snapshot import Obstacle
from fsai_vcu.interface.bus_table import BY_ID
from fsai_vcu.interface.enums import OFF_LIKE, MissionStatus
from fsai_vcu.interface.specification import COMMS_LOST_NS, READY_WAIT_NS
from fsai_vcu.interface.units import S

_WAIT_S: Final = READY_WAIT_NS // S


def why_not_driving(record: Record, now_ns: int, emergency: Incident | None) -> tuple[Obstacle, ...]:
    """What stands between now and driving, what must be put right first in front. Empty in AS_DRIVING.

    emergency: the newest entry into EMERGENCY_BRAKE with its causes, where that was seen.
    """
    span = record.series(sig.AS_STATE).span_at(now_ns)
    if span is None:
        return (_silent_car(record),)
    silent_ns = now_ns - int(record.times(sig.STATUS)[-1])
    if silent_ns >= COMMS_LOST_NS:
        return (_lost_car(silent_ns, label(sig.AS_STATE, span.value)),)
    if span.value == sig.DRIVING:
        return ()
    if span.value == sig.EMERGENCY:
        return tuple(_braked(emergency))
    if span.value == sig.FINISHED:
        return (Obstacle("the mission is finished (AS_FINISHED)", remedy="ASMS off ends the run"),)
    if span.value == sig.READY:
        return tuple(_in_ready(record, now_ns, now_ns - span.begin_ns))
    found = [_obstacle(one) for one in unmet(TO_READY, record, now_ns)]
    state = label(sig.AS_STATE, span.value)
    if span.value not in OFF_LIKE:
        return (Obstacle(f"AS_STATE is {state}"), *found)
    return tuple(found) or (Obstacle(f"{state}: all that the bus shows is met; the VCU goes to AS_READY by itself"),)


def mode(record: Record, now_ns: int, fresh: bool) -> str:
    """The AI side's mode as far as the bus shows it: by what the AI computer acknowledges. `fresh`: it sends.

    A mission that is chosen and not acknowledged means manual mode, or planner and controller have yet to confirm.
    """
    if not fresh:
        return "unknown"
    if record.series(sig.MISSION_STATUS).at(now_ns) != MissionStatus.NOT_SELECTED:
        return "autonomous"
    if not record.series(sig.AMI).at(now_ns):
        return "unknown before a mission"
    return "manual or unconfirmed"


def _silent_car(record: Record) -> Obstacle:
    if record.wrong_length.get(sig.STATUS):
        return Obstacle(f"{BY_ID[sig.STATUS]} has the wrong length: it counts as missing")
    return Obstacle(
        "no 0x520 from the car yet",
        remedy="LVMS on; then check the CAN plug, the bit rate and the interface (ip -details link show)",
    )


def _lost_car(silent_ns: int, state: str) -> Obstacle:
    cause = CAUSES["power_off" if silent_ns >= S else "vcu_silent"]
    remedy = "switched off, or unplugged: LVMS, CAN plug" if silent_ns >= S else cause.remedy
    return Obstacle(f"0x520 is missing for {ms(silent_ns)}: the car is silent", f"the last one was {state}", remedy)


def _braked(emergency: Incident | None) -> list[Obstacle]:
    candidates = emergency.candidates if emergency is not None else ()
    found = []
    for one in candidates[:2]:
        evidence = "" if one.sureness >= Sureness.SHOWN else one.sureness.words
        found.append(Obstacle(one.cause.words, evidence, one.cause.remedy, follows=one.sureness < Sureness.FITS))
    if not found:
        words = "the car is in EMERGENCY_BRAKE, and was before this began to listen"
        found.append(Obstacle(words, remedy=CAUSES["before_the_log"].remedy))
    return found


def _in_ready(record: Record, now_ns: int, waited_ns: int) -> list[Obstacle]:
    found = [_obstacle(one) for one in unmet(TO_DRIVING, record, now_ns) if one.slug != "go_too_early"]
    begin_seen = record.series(sig.AS_STATE).span_at(now_ns)
    left_ns = READY_WAIT_NS - waited_ns
    if left_ns > 0 and begin_seen is not None and begin_seen.before is not None:
        found.append(Obstacle(f"waiting in AS_READY: {left_ns / S:.1f} s of {_WAIT_S} s left"))
    go = record.series(sig.GO).span_at(now_ns)
    if go is not None and go.value:
        found.append(Obstacle(CAUSES["go_held"].words, "GO_SIGNAL is 1", CAUSES["go_held"].remedy))
    else:
        found.append(Obstacle("waiting for Go", "GO_SIGNAL is 0", CAUSES["no_go"].remedy, follows=left_ns > 0))
    return found


def _obstacle(one: Candidate) -> Obstacle:
    evidence = "; ".join(step.words for step in one.steps[-2:])
    return Obstacle(one.cause.words, evidence, one.cause.remedy, follows=one.sureness < Sureness.SHOWN)
