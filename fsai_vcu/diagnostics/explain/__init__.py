"""A run explained: what happened on the car's bus, and why.

    explanation = explained(Record(frames))     # frames.Frames of a whole log; (from, to) in ns: of a part of it
    explanation.events, explanation.incidents       # timeline; emergency brakes, refusals to start, early stops, causes
    text_lines(explanation, …), json_lines(…)       # render.py

`record.py` sorts a log into signals; `timeline.py` names what changed; `endings.py` and `starting.py`
find causes by rules, with `causes.py` as the table of their words; nothing here knows where frames come from.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import islice
from typing import Final

import numpy as np

from fsai_vcu.diagnostics.explain.actuation import mismatches
from fsai_vcu.diagnostics.explain.endings import early_stops, emergencies
from fsai_vcu.diagnostics.explain.evidence import AT_ONCE_NS
from fsai_vcu.diagnostics.explain.incident import (
    ALWAYS,
    Candidate,
    ChainLink,
    Explanation,
    Incident,
    IncidentKind,
    Sureness,
    TimelineEntry,
    TimeRange,
    candidate,
    within,
)
from fsai_vcu.diagnostics.explain.proof import proved
from fsai_vcu.diagnostics.explain.record import GONE_NS, Record
from fsai_vcu.diagnostics.explain.signals import AS_STATE, FINISHED, LAP, MISSION_STATUS, STATUS, label
from fsai_vcu.diagnostics.explain.starting import refusals
from fsai_vcu.diagnostics.explain.timeline import timeline
from fsai_vcu.interface.bus_table import BY_ID
from fsai_vcu.interface.enums import MissionStatus
from fsai_vcu.interface.reserved import AI_IDS, VCU_IDS
from fsai_vcu.interface.units import MS, ms

__all__ = ["Explanation", "Incident", "IncidentKind", "Record", "TimelineEntry", "explained"]


OF_A_STAND: Final = frozenset(
    ("torque_not_given", "no_motion", "brake_unasked", "derated", "derated_hot", "derated_empty")
)
# Silences, which a computer makes too that runs nothing for a while.
OF_TIMES: Final = frozenset(
    (
        *("ai_silent", "ai_message_missing", "ai_comms_lost", "ai_unheard", "handshake_lost", "handshake_stands"),
        *("vcu_silent", "vcu_hung", "wheels_stale", "steering_stale", "command_stale", "bus_lost", "backlog"),
    )
)
BACK_AT_ONCE_NS: Final = 300 * MS  # after a stall what it silenced is there again
SEPARATE: Final = 5  # of a kind and cause are told one by one
MOST_INCIDENTS: Final = 100  # of a kind: a log with more is none of a car
_TOO_MANY: Final = (
    f"more than {MOST_INCIDENTS} incidents of a kind: only the first ones are explained; is this the car's bus?"
)


def explained(record: Record, part_ns: TimeRange = ALWAYS) -> Explanation:
    """Explain what happened in a log, and why.

    It tells of what happened and lasted within `part_ns`, with causes from the whole log.
    """
    begin_ns, end_ns = part_ns
    mixed = [*within(part_ns, record.second_cars)]
    # The car can follow only one of two senders.
    asked = () if mixed or any(within(part_ns, record.second_senders)) else mismatches(record, part_ns)
    kinds = (emergencies(record), refusals(record), early_stops(record), asked)
    found = [list(islice(within(part_ns, kind), MOST_INCIDENTS + 1)) for kind in kinds]
    incidents = [
        incident
        for kind in found
        for incident in kind[:MOST_INCIDENTS]
        if not any(car.begin_ns <= incident.t_ns <= car.end_ns for car in mixed)
    ]
    incidents = [_of_a_busy_computer(record, proved(record, one)) for one in incidents]
    incidents = [one for one in incidents if not any(_told_by(other, one) for other in incidents)]
    if any(record.setting):
        incidents = [_in_its_setting(record, incident) for incident in incidents]
    no_state = "" if len(record.series(AS_STATE)) else "without the AS state"
    return Explanation(
        heading={
            "revision": record.revision.name,
            "revision_reason": record.revision_reason,
            "channel": record.channel,
            "frames": len(record.frames),
            "begin_ns": record.begin_ns,
            "seconds": round((record.end_ns - record.begin_ns) / 1e9, 6),
        },
        timeline=lambda: [event for event in timeline(record) if begin_ns <= event.t_ns <= end_ns],
        incidents=tuple(_grouped(sorted(incidents, key=lambda incident: incident.t_ns), record.begin_ns)),
        closing=_closing(record, part_ns),
        end_ns=int(min(part_ns[1], record.end_ns)),
        problems=(*_missing(record, part_ns), *([_TOO_MANY] if max(map(len, found)) > MOST_INCIDENTS else [])),
        unknown=no_state or ("with two cars on the bus" if mixed else ""),
        recorded=frozenset(np.unique(record.frames.can_id).tolist()),
    )


def _in_its_setting(record: Record, incident: Incident) -> Incident:
    candidates = (replace(one, setting=record.setting) for one in incident.candidates)
    return replace(incident, candidates=tuple(candidates))


def _of_a_busy_computer(record: Record, incident: Incident) -> Incident:
    """Return the incident with the computer that stood still or lost frames as its cause, where that explains it."""
    first = incident.candidates[0]
    if first.slug not in OF_TIMES:
        return incident
    stall = record.recorded.stall(first.t_ns, incident.t_ns)
    if stall is not None:
        words = f"a processor of this computer stands still for {ms(stall[1] - stall[0])}"
        link = ChainLink(stall[0], words)
        if not _explains(record, stall, first, incident.t_ns):
            possible = candidate("stood_still", Sureness.POSSIBLE, link)
            return replace(incident, candidates=(*incident.candidates, possible))
        cause = candidate("stood_still", Sureness.SHOWN, link, *first.steps)
    elif record.recorded.lost and first.slug == "bus_lost":
        cause = candidate("frames_lost_here", Sureness.FITS, *first.steps)
    else:
        return incident
    others = (one for one in incident.candidates if one.slug not in OF_TIMES)
    return replace(incident, candidates=(cause, *others))


def _explains(record: Record, stall: tuple[int, int], first: Candidate, t_ns: int) -> bool:
    """True where the silence is that of the stalls, and ends with the longest of them."""
    silent = first.steps[0].can_id
    times = record.frames.t_ns if silent is None else record.times(silent)
    back = np.searchsorted(times, stall[1] + BACK_AT_ONCE_NS) > np.searchsorted(times, stall[1])
    return record.recorded.explains(first.t_ns, t_ns) and bool(back)


def _told_by(other: Incident, one: Incident) -> bool:
    """Return true where the other incident tells the same.

    What the car does not do as asked is why an AI computer stops it, and why it stands; a stand is why somebody ends
    it.
    """
    if one.kind is IncidentKind.MISMATCH and other.kind is IncidentKind.STAND:
        return one.candidates[0].slug in OF_A_STAND and one.begin_ns <= other.end_ns and other.begin_ns <= one.end_ns
    if one.kind is IncidentKind.STAND:
        same = other.kind is IncidentKind.EMERGENCY and other.candidates[0].slug == one.candidates[0].slug
        return same and one.begin_ns <= other.t_ns <= one.end_ns + GONE_NS
    if one.kind is not IncidentKind.MISMATCH or other.kind is IncidentKind.MISMATCH:
        return False
    causes = (other.candidates[0].cause, one.candidates[0].cause)
    return causes[0].remedy == causes[1].remedy and one.begin_ns <= other.t_ns <= one.end_ns + AT_ONCE_NS


def _grouped(incidents: list[Incident], begin_ns: int) -> Iterator[Incident]:
    """Yield the first of many incidents of one kind and cause, with how many follow: two cars on a bus make many."""
    alike: dict[object, list[Incident]] = {}
    for incident in incidents:
        alike.setdefault((incident.kind, incident.planned, incident.candidates[0].slug), []).append(incident)
    for incident in incidents:
        group = alike[incident.kind, incident.planned, incident.candidates[0].slug]
        if len(group) <= SEPARATE:
            yield incident
        elif incident is group[0]:
            last_s = (group[-1].t_ns - begin_ns) / 1e9
            yield replace(incident, what=f"{incident.what}; {len(group) - 1} more like it up to {last_s:.3f} s")


def _closing(record: Record, part_ns: TimeRange) -> str:
    what, end_ns = ("log", record.end_ns) if part_ns[1] >= record.end_ns else ("part", int(part_ns[1]))
    state = record.series(AS_STATE)
    if not len(state):
        return f"the {what} ends; it has no AS state"
    before = int(np.searchsorted(state.t_ns, end_ns, side="right")) - 1
    if before < 0:
        return f"the {what} ends before the first AS state"
    away_ns = end_ns - int(state.t_ns[before])
    silent = f", silent for the last {away_ns / 1e9:.1f} s" if away_ns >= 1_000_000_000 else ""
    last = float(state.values[before])
    done = _done(record, end_ns) if last == FINISHED else ""
    return f"the {what} ends with the car in {label(AS_STATE, last)}{silent}{done}"


def _done(record: Record, end_ns: int) -> str:
    """Say since when the AI computer says that its mission is done, and after how many laps."""
    said = record.series(MISSION_STATUS)
    until = int(np.searchsorted(said.t_ns, end_ns, side="right"))
    others = np.flatnonzero(said.values[:until] != float(MissionStatus.FINISHED))
    first = int(others[-1]) + 1 if len(others) else 0
    if first >= until:
        return ""
    laps = record.series(LAP).at(end_ns)
    count = f" after lap {laps:.0f}" if laps else ""
    return f": mission complete at {(int(said.t_ns[first]) - record.begin_ns) / 1e9:.1f} s{count}"


def _missing(record: Record, part_ns: TimeRange) -> Iterator[str]:
    """Say what this log lacks to be explained whole, and which part of it is told."""
    if part_ns != ALWAYS:
        low_ns, high_ns = max(part_ns[0], record.begin_ns), min(part_ns[1], record.end_ns)
        low_s, high_s = ((t_ns - record.begin_ns) / 1e9 for t_ns in (low_ns, high_ns))
        yield f"only the part from {low_s:.3f} s to {high_s:.3f} s is explained; causes may lie before it"
    short = {can_id: record.wrong_length[can_id] for can_id in (STATUS, *AI_IDS) if record.never_right(can_id)}
    if STATUS in short:
        yield "every 0x520 of this log has the wrong length: AS state, switches and faults are not known"
    elif record.lacks(STATUS):
        yield "no 0x520 (the VCU's status) in this log: AS state, switches and faults are not known"
    for can_id, wrong in short.items():
        if can_id != STATUS:
            yield f"every 0x{can_id:03X} of this log has {wrong.words}: its signals are not known"
    absent = [f"0x{can_id:03X}" for can_id in AI_IDS if record.lacks(can_id) and can_id not in short]
    if len(absent) == len(AI_IDS):
        yield "no frame of the AI computer (0x510 to 0x514): what it asked for is not known"
    elif absent:
        yield f"the AI computer never sends {', '.join(absent)}"
    if unnamed := [f"0x{can_id:03X}" for can_id in (*AI_IDS, *VCU_IDS) if can_id in record.unknown_ids]:
        yield f"the database does not name {', '.join(unnamed)}: their signals are not known; is it the car's database?"
    if record.lacks(0x525):
        yield "no 0x525: whether the wheels turned is not known"
    if record.has(STATUS) and len(record.series(AS_STATE)) and record.series(AS_STATE).values[0] > 1:
        first = label(AS_STATE, float(record.series(AS_STATE).values[0]))
        yield f"the log begins in {first}, and does not show what led to it"
    for mixed in within(part_ns, record.second_cars):
        begin_s, end_s = ((t_ns - record.begin_ns) / 1e9 for t_ns in (mixed.begin_ns, mixed.end_ns))
        yield f"two cars were on the bus from {begin_s:.3f} s to {end_s:.3f} s: causes are not named from their frames"
    for name, count in record.other_channels.items():
        yield f"{count} frames of another bus ({name}) are left out"
    strange = {f"0x{i:03X}": n for i, n in record.unknown_ids.items() if i not in BY_ID}
    if strange:
        some = ", ".join(list(strange)[:6]) + (" …" if len(strange) > 6 else "")
        yield f"{sum(strange.values())} frames with ids that the databases do not name: {some}"
