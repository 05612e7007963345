"""One judgement of a log, shared by check, explain, report, monitor, compare: findings, and their exit status.

record, buses, verdict = judged(frames)       # explain.Record and statistics.measure of the part that is asked for
verdict.explanation                           # explain.explained
verdict.findings                              # the gravest first, each with its moment and what to do
verdict.status, verdict.line()                # 0 only where everything is known and nothing is wrong
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np

from fsai_vcu.diagnostics.decode.databases import Databases
from fsai_vcu.diagnostics.decode.revision import told_revision
from fsai_vcu.diagnostics.explain import Explanation, Incident, IncidentKind, explained
from fsai_vcu.diagnostics.explain.conditions import sentence
from fsai_vcu.diagnostics.explain.incident import ALWAYS, Sureness, TimeRange, within
from fsai_vcu.diagnostics.explain.record import Record
from fsai_vcu.diagnostics.explain.signals import (
    AS_STATE,
    DRIVING,
    READY,
    STATUS,
)
from fsai_vcu.diagnostics.finding import Finding
from fsai_vcu.diagnostics.log.frames import Frames, straightened
from fsai_vcu.diagnostics.log.part import Part
from fsai_vcu.diagnostics.log.recorded import IN_ORDER, Recorded, lost_words
from fsai_vcu.diagnostics.remedies import remedy_of
from fsai_vcu.diagnostics.statistics.measure import (
    MISSING_PERIODS,
    BusStatistics,
    MessageStatistics,
    measure,
)
from fsai_vcu.diagnostics.statistics.senders import SecondSender
from fsai_vcu.diagnostics.verdict.ai_side import mistakes
from fsai_vcu.diagnostics.verdict.in_passing import frozen, in_passing, perhaps_frozen
from fsai_vcu.diagnostics.verdict.of_bus import KnownOfBus, judge
from fsai_vcu.diagnostics.verdict.own_faults import (
    by_times,
    impossible,
    moved_back,
    of_the_recording,
    steps_forward,
    twice,
)
from fsai_vcu.diagnostics.verdict.verdict import Verdict
from fsai_vcu.interface.reserved import AI_IDS, VCU_IDS
from fsai_vcu.interface.units import MS, S

# A mistake, or what is noted in passing: said by one of these causes.
SAID_BY: Final[Mapping[str, tuple[str, ...]]] = {
    "one-call": ("torque_with_brake",),
    "torque-brake": ("torque_with_brake",),
    "torque-limit": ("torque_limit_zero", "derated", "derated_hot", "derated_empty"),
    "warning": ("derated_hot", "derated_empty"),
}
# in which a handshake is lost too
NO_ECHO: Final = frozenset({"ai_silent", "ai_bus_off", "bus_lost", "handshake_lost", "echo_wrong", "vcu_hung"})
SHORT_NS: Final = 1 * S


class Judged(NamedTuple):
    """The frames of a part of a log, sorted and measured; and the verdict on it."""

    record: Record
    buses: list[BusStatistics]
    verdict: Verdict

    @property
    def bus(self) -> BusStatistics:
        """The figures of the record's own channel."""
        return next(bus for bus in self.buses if bus.channel == self.record.channel)


def judged(
    frames: Frames,
    revision: str | None = None,
    databases: Databases | None = None,
    part: Part | None = None,
    *,
    bitrate: int | None = None,
    begin_ns: int | None = None,
    recorded: Recorded = IN_ORDER,
    left_out: frozenset[int] = frozenset(),
) -> Judged:
    """All frames of a log, measured and judged; of those of a part with what came before and behind it as causes.

    Figures are of the part alone; of what happened, what has a moment in it counts. begin_ns: when the log began, where
    its first frame is not among these. recorded: what the computer that recorded says of itself. left_out: keys of the
    messages that a filter took away, which are not missing. Raises explain.record.NoFrames.
    """
    part = part or Part()
    frames = part.always().of(frames)
    notes: list[Finding] = []
    copies = twice(frames)
    if copies is not None:
        frames = frames.only(~copies.copies)
        notes += [Finding("note", "twice", copies.words)] if copies.sure else []
    record = whole = Record(frames, revision, databases)
    steps = steps_forward(whole, straightened(frames.t_ns)[0])
    whole.perhaps_set = tuple(step.t_ns for step in steps if not step.proven)
    steps = [step for step in steps if step.proven]
    if steps:
        frames, perhaps_set = frames.at(moved_back(frames.t_ns, steps)), whole.perhaps_set
        record = whole = Record(frames, whole.revision.name, databases)
        whole.perhaps_set = perhaps_set
        whole.clock_set += [(step.t_ns, step.by_ns) for step in steps]
    whole.begin_ns = whole.begin_ns if begin_ns is None else begin_ns
    part_ns = part.bounds(whole.begin_ns)
    whole.recorded = recorded.within(max(part_ns[0], whole.begin_ns), min(part_ns[1], whole.end_ns))
    if whole.clock_set:  # the stalls have the clock's first times
        whole.recorded = whole.recorded._replace(stalls_ns=())
    notes += [step.finding(whole.channel) for step in steps if part_ns[0] <= step.t_ns <= part_ns[1]]
    if part_ns != ALWAYS:
        t_ns, back_ns = straightened(frames.t_ns)
        inside = (t_ns >= part_ns[0]) & (t_ns <= part_ns[1])
        set_back_ns = int(back_ns[: inside.argmax()].sum())  # before the part: it has the times of the whole
        frames = frames.at(frames.t_ns + set_back_ns).only(inside)
        record = Record(frames, whole.revision.name, databases)
        record.perhaps_set, record.recorded = whole.perhaps_set, whole.recorded
    off_ns = [cycle[:2] for cycle in whole.power_cycles]
    buses = measure(frames, record.decoder, revision=record.revision.name, bitrate=bitrate, off_ns=off_ns)
    buses = [_with_gaps_before(bus, whole, part_ns) if bus.channel == whole.channel else bus for bus in buses]
    buses = [bus.without(left_out) for bus in buses] if left_out else buses
    verdict = _verdict(whole, part_ns, record, buses, left_out)
    unknown = [words for words in (impossible(buses),) if words]
    findings = [
        one for one in verdict.findings if not ((unknown and by_times(one)) or of_the_recording(one, whole.recorded))
    ]
    unknown += [lost_words(whole.recorded.lost)] if whole.recorded.lost else []
    if standstill := whole.recorded.standstill:
        causes = (incident.candidates[0].slug for incident in verdict.explanation.incidents)
        touched = len(findings) < len(verdict.findings) or "stood_still" in causes
        unknown += [f"{standstill}: it was too busy, so this run is not judged"] if touched else []
        notes += [] if touched else [Finding("note", "busy", standstill)]
    findings = sorted([*findings, *notes], key=lambda one: (one.severity != "problem", one.t_ns or 0))
    unknown += [copies.words] if copies is not None and not copies.sure else []
    unknown += verdict.unknown
    verdict = replace(verdict, findings=tuple(findings), unknown=tuple(unknown), chosen=bool(left_out))
    return Judged(record, buses, verdict)


def _with_gaps_before(bus: BusStatistics, whole: Record, part_ns: TimeRange) -> BusStatistics:
    """Return the statistics with the gap of each message that lasts into the part."""

    def whole_gap(message: MessageStatistics) -> MessageStatistics:
        times = whole.times(message.can_id)
        first = int(np.searchsorted(times, part_ns[0]))
        if message.extended or not message.expected_ms or not 0 < first < len(times):
            return message
        since_ns = int(times[first - 1])
        if any(cycle.begin_ns < times[first] and cycle.end_ns > since_ns for cycle in whole.power_cycles):
            return message
        gap_ms = (int(times[first]) - since_ns) / MS
        if gap_ms <= max(MISSING_PERIODS * message.expected_ms, message.longest_gap_ms or 0.0):
            return message
        return replace(message, gaps=message.gaps + 1, longest_gap_ms=gap_ms, longest_gap_at_s=since_ns / S)

    return replace(bus, messages=tuple(map(whole_gap, bus.messages)))


def _verdict(
    whole: Record, part_ns: TimeRange, record: Record, buses: Sequence[BusStatistics], left_out: frozenset[int]
) -> Verdict:
    """Every finding on a part of a log; `record` and `buses`: of its frames alone."""
    explanation = explained(whole, part_ns)
    senders, cars = ([*within(part_ns, found)] for found in (whole.second_senders, whole.second_cars))
    findings = [_of_incident(incident) for incident in explanation.incidents if not incident.planned]
    # A second sender that is an incident's cause is told by it.
    causes = [incident.candidates[0] for incident in explanation.incidents]
    told = _told(explanation)
    others = [other for other in (*senders, *cars) if (other.can_ids[0], other.begin_ns) not in told]
    findings += [_of_second(other, whole.channel) for other in others]
    for bus in buses:
        findings += judge(bus, _known(bus, whole, record, explanation, senders, cars))
    if not cars:
        blamed = {cause.slug for cause in causes}
        findings += [one for one in in_passing(whole, part_ns) if blamed.isdisjoint(SAID_BY.get(one.kind, ()))]
        findings += frozen(whole, part_ns, explanation)
        findings += [
            one for one in mistakes(whole, part_ns) if blamed.isdisjoint((one.kind, *SAID_BY.get(one.kind, ())))
        ]
    findings.sort(key=lambda finding: (finding.severity != "problem", finding.t_ns or 0))
    unknown = (*_unknown(record, left_out), *perhaps_frozen(whole, part_ns), *_not_judged(whole, buses))
    return Verdict(whole.begin_ns, explanation, tuple(findings), unknown)


def _of_second(other: SecondSender, channel: str) -> Finding:
    remedy = remedy_of("second_car" if other.can_ids[0] in VCU_IDS else "intruder")
    return Finding("problem", "intruder", other.sentence, remedy, other.begin_ns, other.can_ids, channel)


def _known(
    bus: BusStatistics,
    whole: Record,
    record: Record,
    explanation: Explanation,
    senders: Sequence[SecondSender],
    cars: Sequence[SecondSender],
) -> KnownOfBus:
    """The knowledge of a bus that its explanation brings."""
    own = bus.channel == record.channel
    causes = [incident.candidates[0] for incident in explanation.incidents]
    told = _told(explanation)
    shared = {can_id for other in senders for can_id in other.can_ids} | (set(VCU_IDS) if cars else set())
    absent = set() if record.ai_speaks else set(AI_IDS)
    if not record.has(STATUS):
        absent |= {STATUS} if any(map(record.has, VCU_IDS)) else set(VCU_IDS)
    lengths = {
        step.can_id
        for cause in causes
        for step in cause.steps
        if cause.slug == "ai_message_length" and step.can_id is not None and not step.signal
    }
    state = record.series(AS_STATE)
    first_ns = int(record.error_ns[0]) if len(record.error_ns) else None
    return KnownOfBus(
        told=frozenset(told),
        lengths=frozenset(lengths),
        echoes_ns=tuple(cause.t_ns for cause in causes if cause.slug in NO_ECHO),
        mixed=bool(cars) and bus.channel == whole.channel,
        shared=frozenset(shared),
        absent=frozenset(absent),
        errors_ns=first_ns,
        errors_told=own and bool(len(record.error_ns)) and _all_told(record, told),
        setting=record.setting,
        active=bool(len(state)) and state.values[-1] in (READY, DRIVING),
        others=not own,
        perhaps_set_ns=tuple(record.perhaps_set),
    )


def _told(explanation: Explanation) -> set[tuple[int | None, int]]:
    """(identifier, moment) of messages that the first causes name as missing or foreign, and of error frames."""
    causes = [incident.candidates[0] for incident in explanation.incidents]
    return {(step.can_id, step.t_ns) for cause in causes for step in cause.steps if not step.signal}


def _all_told(record: Record, told: set[tuple[int | None, int]]) -> bool:
    """True where all error frames are near the error frame that a cause cites."""
    cited = [t_ns for can_id, t_ns in told if can_id is None and t_ns in record.error_ns]
    return any(record.error_ns[-1] - S <= t_ns <= record.error_ns[0] + S for t_ns in cited)


def _of_incident(incident: Incident) -> Finding:
    first = incident.candidates[0]
    # Each unmet condition is named, since all have to be met.
    refused = incident.kind is IncidentKind.REFUSAL
    each = [one for one in incident.candidates[1:] if refused and one.sureness >= Sureness.SHOWN]
    named = dict.fromkeys(sentence(one) if refused else one.cause.words for one in (first, *each))
    return Finding(
        "note" if first.slug == "stood_still" else "problem",
        incident.kind.slug,
        f"{incident.what}, because {'; and '.join(named)}",
        first.cause.remedy,
        incident.t_ns,
        tuple(sorted({step.can_id for step in first.steps if step.can_id is not None})),
    )


def _not_judged(whole: Record, buses: Sequence[BusStatistics]) -> Iterator[str]:
    """A second car, on another bus than the log's: its periods are judged, and nothing of what it did."""
    cars = [bus.channel for bus in buses if any(m.can_id == STATUS and not m.extended for m in bus.messages)]
    others = ", ".join(channel for channel in cars if channel != whole.channel)
    if others:
        yield f"0x520 is on {others} too: only the car on {whole.channel} was judged; judge each bus by itself"


def _unknown(record: Record, left_out: frozenset[int]) -> Iterator[str]:
    """Say why this log cannot be called well even if nothing in it is wrong."""
    of_car = STATUS not in left_out  # else nobody asks for the car's state
    if of_car and STATUS in record.unknown_ids:
        yield "the database does not name 0x520, so the car's state is not known: use the car's, or --revision"
    elif of_car and STATUS in record.wrong_length and not record.has(STATUS):
        yield "every 0x520 has the wrong length, so the car's state is not known"
    elif of_car and not record.has(STATUS):
        yield "no 0x520 was received, so the car's state is not known: is this the car's bus, and was the car on?"
    elif of_car and not len(record.series(AS_STATE)):
        yield "the database has no AS_STATE in 0x520, so the car's state is not known: this is not the car's database"
    elif record.end_ns - record.begin_ns < SHORT_NS:
        yield "less than a second was recorded"
    elif not record.ai_speaks and record.unknown_ids.keys() & set(AI_IDS):
        yield "this database does not name 0x510 to 0x514 (the AI computer's): use the car's database, or --revision"
    elif not record.ai_speaks and not left_out.issuperset(AI_IDS):
        yield "no frame of the AI computer (0x510 to 0x514): it did not run, or one direction only was recorded"
    seen = told_revision(record.frames)
    if seen is not None and seen[0].name != record.revision.name:
        yield (
            f"the frames are of interface revision {seen[0].name} ({seen[1]}), and were read as {record.revision.name}"
        )
