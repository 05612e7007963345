"""One judgement of a log, shared by check, explain, report, monitor, compare: findings, and their exit status.

record, buses, verdict = judged(frames)       # explain.Record and statistics.measure of the part that is asked for
verdict.explanation                           # explain.explained
verdict.findings                              # the gravest first, each with its moment and what to do
verdict.status, verdict.line()                # 0 only where everything is known and nothing is wrong
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime, timezone
from itertools import groupby, islice
from typing import Any, Final, NamedTuple

import numpy as np

from fsai_vcu.diagnostics.decode.databases import Databases
from fsai_vcu.diagnostics.decode.revision import told_revision
from fsai_vcu.diagnostics.explain import Explanation, Incident, IncidentKind, explained
from fsai_vcu.diagnostics.explain.conditions import sentence
from fsai_vcu.diagnostics.explain.evidence import AT_ONCE_NS, frozen_words
from fsai_vcu.diagnostics.explain.incident import ALWAYS, Sureness, TimeRange, within
from fsai_vcu.diagnostics.explain.record import REBOOT_NS, Record
from fsai_vcu.diagnostics.explain.signals import (
    AS_STATE,
    CAR_TORQUE_MAX,
    DRIVING,
    GO,
    PULSES,
    READY,
    STATUS,
    WARNINGS,
    label,
)
from fsai_vcu.diagnostics.finding import Finding
from fsai_vcu.diagnostics.log.frames import EPOCH_NS, Frames, straightened
from fsai_vcu.diagnostics.log.part import Part
from fsai_vcu.diagnostics.log.recorded import IN_ORDER, Recorded
from fsai_vcu.diagnostics.remedies import remedy_of
from fsai_vcu.diagnostics.statistics.measure import (
    MISSING_PERIODS,
    BusStatistics,
    MessageStatistics,
    measure,
)
from fsai_vcu.diagnostics.statistics.senders import SecondSender
from fsai_vcu.diagnostics.verdict.ai_side import mistakes
from fsai_vcu.diagnostics.verdict.of_bus import Known, judge
from fsai_vcu.diagnostics.verdict.own_faults import (
    by_times,
    impossible,
    moved_back,
    of_the_recording,
    steps_forward,
    twice,
)
from fsai_vcu.interface.enums import AsState
from fsai_vcu.interface.reserved import AI_IDS, VCU_IDS
from fsai_vcu.interface.specification import COMMS_LOST_NS, PERIOD_NS
from fsai_vcu.interface.units import MS, S, ms

OFF: Final = float(AsState.AS_OFF)
NEARLY_FULL: Final = 65_000  # a counter of 16 bits goes on at 0
FEW_PULSES: Final = 10
OUT_OF_ORDER_NS: Final = 2 * PERIOD_NS
LOW_SHARE: Final = 0.5  # of the most that TRQ_MAX was in AS_DRIVING
UNREAD: Final = "not everything could be read"
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


@dataclass(frozen=True, slots=True)
class Verdict:
    """`unknown`: what could not be judged, and why; where there is such a thing nothing is called OK."""

    begin_ns: int
    explanation: Explanation
    findings: tuple[Finding, ...]
    unknown: tuple[str, ...] = ()

    @property
    def problems(self) -> int:
        return sum(finding.severity == "problem" for finding in self.findings)

    @property
    def ok(self) -> bool:
        return not self.problems and not self.unknown

    @property
    def status(self) -> int:
        """The exit status of every verb that judges a log."""
        return 0 if self.ok else 1

    def unread(self, unread: bool) -> Verdict:
        """The same of a log that could not be read whole, where that is so."""
        return replace(self, unknown=(UNREAD, *self.unknown)) if unread else self

    def line(self) -> str:
        """Return the verdict in one line, without findings."""
        notes = len(self.findings) - self.problems
        end = f" ({notes} note{'s' * (notes > 1)})" if notes else ""
        if self.problems:
            return f"NOT OK: {self.problems} problem{'s' * (self.problems > 1)}{end}"
        if self.unknown:
            return f"UNKNOWN: {self.unknown[0]}{end}"
        return f"OK{end}"

    def lines(self, *, remedies: bool = True) -> Iterator[str]:
        """The findings as people read them, and what to do: once for those beside each other with one remedy."""
        yield from (f"unknown: {why}" for why in self.unknown)
        for remedy, findings in groupby(self.findings, lambda finding: finding.remedy):
            yield from (f"{finding.severity}: {self.moment(finding)}{finding.words}" for finding in findings)
            if remedy and remedies:
                yield f"    what to do: {remedy}."

    def moment(self, finding: Finding) -> str:
        """Return the moment: seconds since the log's first frame, and the time of day where the log has one."""
        if finding.t_ns is None:
            return ""
        clock = (
            f" ({datetime.fromtimestamp(finding.t_ns / S, timezone.utc):%H:%M:%S} UTC)"
            if self.begin_ns > EPOCH_NS
            else ""
        )
        return f"at {(finding.t_ns - self.begin_ns) / S:.3f} s{clock}: "

    def as_dicts(self) -> Iterator[dict[str, Any]]:
        """The findings, then the verdict, for JSON."""
        for finding in self.findings:
            yield {
                "type": "finding",
                "severity": finding.severity,
                "kind": finding.kind,
                "text": finding.words,
                "t_s": None if finding.t_ns is None else round((finding.t_ns - self.begin_ns) / S, 6),
                "t_ns": finding.t_ns,
                "remedy": finding.remedy or None,
                "ids": list(finding.can_ids),
                "channel": finding.channel,
            }
        word = "ok" if self.ok else "not ok" if self.problems else "unknown"
        notes = len(self.findings) - self.problems
        yield {
            "type": "verdict",
            "verdict": word,
            "problems": self.problems,
            "notes": notes,
            "unknown": list(self.unknown),
            "words": self.line(),
        }


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
) -> Judged:
    """All frames of a log, measured and judged; of those of a part with what came before and behind it as causes.

    Figures are of the part alone; of what happened, what has a moment in it counts. begin_ns: when the log began, where
    its first frame is not among these. recorded: what the computer that recorded says of itself. Raises
    explain.record.NoFrames.
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
    verdict = _verdict(whole, part_ns, record, buses)
    unknown = [words for words in (impossible(buses),) if words]
    findings = [
        one for one in verdict.findings if not ((unknown and by_times(one)) or of_the_recording(one, whole.recorded))
    ]
    unknown += whole.recorded.sentences()
    findings = sorted([*findings, *notes], key=lambda one: (one.severity != "problem", one.t_ns or 0))
    unknown += [copies.words] if copies is not None and not copies.sure else []
    verdict = replace(verdict, findings=tuple(findings), unknown=(*unknown, *verdict.unknown))
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


def _verdict(whole: Record, part_ns: TimeRange, record: Record, buses: Sequence[BusStatistics]) -> Verdict:
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
        findings += [one for one in _in_passing(whole, part_ns) if blamed.isdisjoint(SAID_BY.get(one.kind, ()))]
        findings += _frozen(whole, part_ns, explanation)
        findings += [
            one for one in mistakes(whole, part_ns) if blamed.isdisjoint((one.kind, *SAID_BY.get(one.kind, ())))
        ]
    findings.sort(key=lambda finding: (finding.severity != "problem", finding.t_ns or 0))
    unknown = (*_unknown(record), *_perhaps_frozen(whole, part_ns), *_not_judged(whole, buses))
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
) -> Known:
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
    return Known(
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


def _in_passing(record: Record, part_ns: TimeRange) -> Iterator[Finding]:
    """Yield what the car did beside the matter of incidents: the first of each kind, and how often."""
    state = record.series(AS_STATE)
    found: list[tuple[int, str, str, int]] = []
    for kind, signal in (*(("torque-limit", each) for each in CAR_TORQUE_MAX), ("go", GO)):
        series = record.series(signal)
        most = series.values[state.sampled(series.t_ns) == DRIVING].max(initial=0.0)
        below = series.values <= (LOW_SHARE * most if kind == "torque-limit" else 0.0)
        spans = replace(series, values=below.astype(np.float64)).spans
        drives = [state.sampled(spans.begin_ns + later_ns) == DRIVING for later_ns in (0, COMMS_LOST_NS)]
        rows = np.flatnonzero(np.logical_and.reduce([spans.values * most > 0.0, ~spans.apart[:-1], *drives]))
        falls = [*within(part_ns, (spans[row] for row in rows.tolist()))]
        for span in falls[:1]:
            least = series.between(span.begin_ns, max(span.begin_ns, span.end_ns - 1)).values.min()
            length = ms(span.end_ns - span.begin_ns)
            words = f"{signal.name} falls to {least:g} in AS_DRIVING for {length}, and the state stays"
            found.append((span.begin_ns, kind, words, len(falls)))
    for warning in WARNINGS:
        spans = record.series(warning).spans
        warned = [*within(part_ns, spans.of(1.0))]
        for span in warned[:1]:
            where = label(AS_STATE, state.at(span.begin_ns))
            words = f"{warning.name} is 1 for {ms(span.end_ns - span.begin_ns)}, from {where} on"
            found.append((span.begin_ns, "warning", words, len(warned)))
    for cycle in list(within(part_ns, record.power_cycles))[:1]:
        found.append((cycle.begin_ns, "power-cycle", cycle.words, len(record.power_cycles)))
    off = np.array([gap.end_ns or 0 for gap in record.gaps(STATUS, REBOOT_NS)])  # switched off: it has to start again
    off = np.append(off, [cycle.end_ns for cycle in record.power_cycles])
    for signal in (AS_STATE, *PULSES):
        t_ns, values = record.series(signal).t_ns, record.series(signal).values
        # Frames out of order are made up for at once, and a wheel that rolls back does not begin near 0.
        if signal == AS_STATE:
            was, low = values == OFF, values - 1
        else:
            was, low = values < NEARLY_FULL, np.minimum(values / 2, values - FEW_PULSES)
        rows = np.flatnonzero(was[:-1] & (values[1:] <= low[:-1])) + 1
        rows = rows[record.series(signal).sampled(t_ns[rows] + OUT_OF_ORDER_NS) <= low[rows - 1]]
        rows = rows[~(np.abs(t_ns[rows, None] - off) < REBOOT_NS).any(axis=1)]
        rows = rows[(t_ns[rows] >= part_ns[0]) & (t_ns[rows] <= part_ns[1])]
        if len(rows):
            before, after = (label(signal, float(value)) for value in values[rows[0] - 1 : rows[0] + 1])
            words = f"the VCU started again: {signal.name} {before} → {after}"
            found.append((int(t_ns[rows[0]]), "restart", words, len(rows)))
    for kind in ("power-cycle", "torque-limit", "warning", "go", "restart"):
        for begin_ns, _, words, count in sorted(each for each in found if each[1] == kind)[:1]:
            remedy = remedy_of("vcu_reboot", record.setting) if kind == "restart" else ""
            more = f", {count} times in all" if count > 1 else ""
            yield Finding("note", kind, f"{words}{more}", remedy, begin_ns, channel=record.channel)


def _frozen(record: Record, part_ns: TimeRange, explanation: Explanation) -> Iterator[Finding]:
    """0x520 that comes and repeats itself: the first time, and how many; not what an incident has for its cause."""
    told_ns = [incident.t_ns for incident in explanation.incidents]
    found = [
        span
        for span in within(part_ns, record.frozen)
        if not any(span.begin_ns <= t_ns <= span.end_ns + AT_ONCE_NS for t_ns in told_ns)
    ]
    for span in found[:1]:
        more = f", {len(found)} times in all" if len(found) > 1 else ""
        where = (remedy_of("status_frozen"), span.begin_ns, (STATUS,), record.channel)
        text = f"{frozen_words(record, span)}: the VCU hung, or its 0x520 froze{more}"
        yield Finding("problem", "frozen", text, *where)


def _perhaps_frozen(record: Record, part_ns: TimeRange) -> Iterator[str]:
    for span in islice(within(part_ns, record.perhaps_frozen), 1):
        yield (
            f"{frozen_words(record, span)}, with the ASMS off: the VCU froze, or does not ask while the car is driven "
            "by hand; a log with the ASMS on would tell"
        )


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


def _unknown(record: Record) -> Iterator[str]:
    """Say why this log cannot be called well even if nothing in it is wrong."""
    if STATUS in record.unknown_ids:
        yield "the database does not name 0x520, so the car's state is not known: use the car's own, or --revision"
    elif STATUS in record.wrong_length and not record.has(STATUS):
        yield "every 0x520 has the wrong length, so the car's state is not known"
    elif not record.has(STATUS):
        yield "no 0x520 was received, so the car's state is not known: is this the car's bus, and was the car on?"
    elif not len(record.series(AS_STATE)):
        yield "the database has no AS_STATE in 0x520, so the car's state is not known: it is not the car's"
    elif record.end_ns - record.begin_ns < SHORT_NS:
        yield "less than a second was recorded"
    elif not record.ai_speaks and record.unknown_ids.keys() & set(AI_IDS):
        yield "the database does not name the AI computer's messages (0x510 to 0x514): use the car's own, or --revision"
    elif not record.ai_speaks:
        yield "no frame of the AI computer (0x510 to 0x514): it did not run, or one direction only was recorded"
    seen = told_revision(record.frames)
    if seen is not None and seen[0].name != record.revision.name:
        yield (
            f"the frames are of interface revision {seen[0].name} ({seen[1]}), and were read as {record.revision.name}"
        )
