"""One judgement of a log, shared by check, explain, report, monitor, compare: findings, and their exit status.

record, buses, verdict = judged(frames)       # explain.Record and statistics.measure of the part that is asked for
verdict.explanation                           # explain.explained
verdict.findings                              # the gravest first, each with its moment and what to do
verdict.status, verdict.line()                # 0 only where everything is known and nothing is wrong
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import datetime, timezone
from itertools import groupby, islice
from typing import Any, Final, NamedTuple

import numpy as np
from msgspec import structs

from fsai_vcu.diagnostics.decode.databases import Databases
from fsai_vcu.diagnostics.decode.revision import told_revision
from fsai_vcu.diagnostics.explain import Explanation, Incident, explained
from fsai_vcu.diagnostics.explain.endings import REBOOT_NS
from fsai_vcu.diagnostics.explain.evidence import AT_ONCE_NS, frozen_words
from fsai_vcu.diagnostics.explain.incident import ALWAYS, TimeRange, within
from fsai_vcu.diagnostics.explain.record import Record
from fsai_vcu.diagnostics.explain.render import EPOCH_NS
from fsai_vcu.diagnostics.explain.signals import (
    AS_STATE,
    CAR_TORQUE_MAX,
    DRIVING,
    GO,
    PULSES,
    READY,
    STATUS,
    label,
)
from fsai_vcu.diagnostics.finding import Finding
from fsai_vcu.diagnostics.log.frames import Frames, straightened
from fsai_vcu.diagnostics.log.part import Part
from fsai_vcu.diagnostics.remedies import remedy_of
from fsai_vcu.diagnostics.statistics.measure import (
    MISSING_PERIODS,
    BusStatistics,
    MessageStatistics,
    measure,
)
from fsai_vcu.diagnostics.verdict.ai_side import mistakes
from fsai_vcu.diagnostics.verdict.of_bus import judge
from fsai_vcu.diagnostics.verdict.own_faults import by_times, impossible, moved_back, steps_forward, twice
from fsai_vcu.interface.enums import AsState
from fsai_vcu.interface.reserved import AI_IDS, VCU_IDS
from fsai_vcu.interface.specification import COMMS_LOST_NS, PERIOD_NS
from fsai_vcu.interface.units import MS, S, ms

OFF: Final = float(AsState.AS_OFF)
NEARLY_FULL: Final = 65_000  # a counter of 16 bits goes on at 0
FEW_PULSES: Final = 10
OUT_OF_ORDER_NS: Final = 2 * PERIOD_NS
MANY: Final = 3
MOST_NAMED: Final = 8
LOSSY: Final = 5  # messages that miss frames again and again
LOST_SHARE: Final = 0.01  # of all frames: more is no log to judge by
UNREAD: Final = "not everything could be read"
NOT_SAID: Final[frozenset[str]] = frozenset()
SAID_BY: Final = dict.fromkeys(("one-call", "torque-brake"), frozenset({"torque_with_brake"}))  # a mistake, by a cause
NO_ECHO: Final = frozenset({"ai_silent", "bus_lost", "handshake_lost", "vcu_hung"})  # in which a handshake is lost too
SHORT_NS: Final = 1 * S
WITH_IT_NS: Final = 1 * S  # what falls silent so close to the car is switched off with it


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

    def unread(self, status: int, lost: str) -> Verdict:
        """The same of a log that could not be read whole, where that is the status of reading it. `lost`: a sentence on
        what this machine lost of it, or ''."""
        why = (lost,) if lost else (UNREAD,) if status else ()
        return replace(self, unknown=(*why, *self.unknown))

    def line(self) -> str:
        """In one line, without findings."""
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
        """When: seconds since the log's first frame, and the time of day where the log has one."""
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
) -> Judged:
    """All frames of a log, measured and judged; of those of a part with what came before and behind it as causes.

    Figures are of the part alone; of what happened, what has a moment in it counts. begin_ns: when the log began, where
    its first frame is not among these. Raises explain.record.NoFrames.
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
    notes += [step.finding(whole.channel) for step in steps if part_ns[0] <= step.t_ns <= part_ns[1]]
    if part_ns != ALWAYS:
        t_ns, back_ns = straightened(frames.t_ns)
        inside = (t_ns >= part_ns[0]) & (t_ns <= part_ns[1])
        set_back_ns = int(back_ns[: inside.argmax()].sum())  # before the part: it has the times of the whole
        frames = frames.at(frames.t_ns + set_back_ns).only(inside)
        record = Record(frames, whole.revision.name, databases)
        record.perhaps_set = whole.perhaps_set
    buses = measure(frames, record.decoder, revision=record.revision.name, bitrate=bitrate)
    buses = [_with_gaps_before(bus, whole, part_ns) if bus.channel == whole.channel else bus for bus in buses]
    verdict = _verdict(whole, part_ns, record, buses)
    unknown = [words for words in (impossible(buses),) if words]
    findings = [one for one in verdict.findings if not (unknown and by_times(one))]
    findings = sorted([*findings, *notes], key=lambda one: (one.severity != "problem", one.t_ns or 0))
    unknown += [copies.words] if copies is not None and not copies.sure else []
    verdict = replace(verdict, findings=tuple(findings), unknown=(*unknown, *verdict.unknown))
    return Judged(record, buses, verdict)


def _with_gaps_before(bus: BusStatistics, whole: Record, part_ns: TimeRange) -> BusStatistics:
    """The same, with the gap of each message that lasts into the part."""

    def whole_gap(message: MessageStatistics) -> MessageStatistics:
        times = whole.times(message.can_id)
        first = int(np.searchsorted(times, part_ns[0]))
        if message.extended or not message.expected_ms or not 0 < first < len(times):
            return message
        since_ns = int(times[first - 1])
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
    firsts = [incident.candidates[0] for incident in explanation.incidents]
    # (a message, since when) that an incident's cause names as missing or foreign, and how often an echo was with it
    roots = {(first.steps[0].can_id, first.t_ns) for first in firsts}
    echoes = sum(first.slug in NO_ECHO for first in firsts)
    for one in senders:
        if (one.can_ids[0], one.begin_ns) in roots:
            continue
        where = (remedy_of("intruder"), one.begin_ns, one.can_ids, whole.channel)
        findings.append(Finding("problem", "intruder", one.sentence, *where))
    shared = {can_id for other in senders for can_id in other.can_ids}
    for mixed in cars:
        where = (remedy_of("second_car"), mixed.begin_ns, mixed.can_ids, whole.channel)
        findings.append(Finding("problem", "intruder", mixed.sentence, *where))
        shared |= set(VCU_IDS)
    absent = set() if record.ai_speaks else set(AI_IDS)
    if not record.has(STATUS):
        absent |= {STATUS} if any(map(record.has, VCU_IDS)) else set(VCU_IDS)

    def told(bus: BusStatistics, finding: Finding) -> bool:
        if finding.kind == "handshake" and finding.severity == "problem" and bus.handshake is not None:
            if cars and bus.channel == whole.channel:
                return True
            return bus.handshake.unanswered + bus.handshake.above_100_ms <= echoes
        begun_ns = finding.t_ns or 0
        return finding.kind == "gap" and any(
            can_id in finding.can_ids and abs(t_ns - begun_ns) <= AT_ONCE_NS for can_id, t_ns in roots
        )

    for bus in buses:
        stopped = list(_stopped(record, bus))
        findings += stopped
        gone = {can_id for finding in stopped for can_id in finding.can_ids}
        findings += [
            finding
            for finding in _of_bus(bus, record)
            # What follows from a second sender, or is named as unknown or as a cause, is not named again.
            if not told(bus, finding)
            and not (finding.kind == "stopped" and gone.issuperset(finding.can_ids))
            and not (finding.kind == "period" and shared.issuperset(finding.can_ids))
            and not (finding.kind == "missing" and finding.can_ids and absent.issuperset(finding.can_ids))
            and not (finding.kind == "missing" and bus.channel != record.channel)  # another bus has other messages
        ]
    if not cars:
        findings += [*_in_passing(whole, part_ns), *_frozen(whole, part_ns, explanation)]
        blamed = {incident.candidates[0].slug for incident in explanation.incidents}
        findings += [one for one in mistakes(whole, part_ns) if not blamed & SAID_BY.get(one.kind, NOT_SAID)]
    findings.sort(key=lambda finding: (finding.severity != "problem", finding.t_ns or 0))
    unknown = (*_unknown(record), *_perhaps_frozen(whole, part_ns), *_not_judged(whole, buses))
    return Verdict(whole.begin_ns, explanation, tuple(findings), unknown)


def _in_passing(record: Record, part_ns: TimeRange) -> Iterator[Finding]:
    """What the car did beside what incidents are made of: the first of each kind, and how often."""
    state = record.series(AS_STATE)
    found: list[tuple[int, str, str, int]] = []
    for kind, signal in (*(("torque-limit", each) for each in CAR_TORQUE_MAX), ("go", GO)):
        spans = record.series(signal).spans
        drives = [state.sampled(spans.begin_ns + later_ns) == DRIVING for later_ns in (0, COMMS_LOST_NS)]
        rows = np.flatnonzero(np.logical_and.reduce([spans.values == 0, ~spans.apart[:-1], *drives]))
        falls = [*within(part_ns, (spans[row] for row in rows.tolist()))]
        for span in falls[:1]:
            words = f"{signal.name} falls to 0 in AS_DRIVING for {ms(span.end_ns - span.begin_ns)}, and the state stays"
            found.append((span.begin_ns, kind, words, len(falls)))
    off = np.array([gap.end_ns or 0 for gap in record.gaps(STATUS, REBOOT_NS)])  # switched off: it has to start anew
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
            words = f"the VCU started anew: {signal.name} {before} → {after}"
            found.append((int(t_ns[rows[0]]), "restart", words, len(rows)))
    for kind in ("torque-limit", "go", "restart"):
        for begin_ns, _, words, count in sorted(each for each in found if each[1] == kind)[:1]:
            remedy = remedy_of("vcu_reboot") if kind == "restart" else ""
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
    return Finding(
        "problem",
        incident.kind.slug,
        f"{incident.what}, because {first.cause.words}",
        first.cause.remedy,
        incident.t_ns,
        tuple(sorted({step.can_id for step in first.steps if step.can_id is not None})),
    )


def _losing(bus: BusStatistics) -> Finding | None:
    """Many messages that miss single frames again and again, by how many came: nothing is wrong with each of them."""
    found = [message for message in bus.messages if message.gaps and message.lost and message.expected_ms]
    if sum(min(message.gaps, message.lost) >= MANY for message in found) < LOSSY:
        return None
    lost = {message.can_id: message.lost for message in found}
    part = sum(lost.values()) / (bus.frames + sum(lost.values()))
    text = f"frames of {len(lost)} of {len(bus.messages)} messages are missing again and again, {part:.1%} of all"
    grave = part > LOST_SHARE
    where = (remedy_of("lossy"), None, tuple(sorted(lost)), bus.channel)
    return Finding("problem" if grave else "note", "lossy", text, *where)


def _of_bus(bus: BusStatistics, record: Record) -> Iterator[Finding]:
    """A channel's findings; the pauses of several messages at one moment are one, with the error frames of it."""
    pauses: list[list[Finding]] = []
    unknown: list[Finding] = []
    gaps = {message.can_id: message.longest_gap_ms or 0.0 for message in bus.messages}
    lost = _losing(bus)
    if lost:
        yield lost
    errors: Finding | None = None

    def same(one: Finding, other: Finding) -> bool:
        """Whether two messages were missing at one time: most of the shorter pause lies within the longer one."""
        begins = [finding.t_ns or 0 for finding in (one, other)]
        lasts = [gaps[finding.can_ids[0]] * MS for finding in (one, other)]
        within = min(b + length for b, length in zip(begins, lasts, strict=True)) - max(begins)
        return abs(begins[0] - begins[1]) <= AT_ONCE_NS or within > 0.5 * min(lasts)

    for finding in judge(bus, theirs=record.ai_is_theirs):
        if finding.kind == "error-frames" and len(record.error_ns):
            errors = structs.replace(finding, t_ns=int(record.error_ns[0]), remedy=remedy_of("bus_lost"))
            continue
        if finding.kind == "unknown":
            unknown.append(finding)
            continue
        if finding.kind != "gap":
            yield finding
            continue
        if lost and finding.severity == "note" and finding.can_ids[0] in lost.can_ids:
            continue
        together: list[Finding] = next((pause for pause in pauses if same(pause[0], finding)), [])
        if not together:
            pauses.append(together)
        together.append(finding)
    if len(unknown) < MANY:
        yield from unknown
    else:
        ids = tuple(sorted(finding.can_ids[0] for finding in unknown))
        named = ", ".join(f"0x{can_id:03X}" for can_id in ids[:MOST_NAMED]) + (" …" if len(ids) > MOST_NAMED else "")
        first = min(unknown, key=lambda finding: finding.t_ns or 0)
        yield structs.replace(first, words=f"{len(ids)} identifiers are in no database: {named}", can_ids=ids)
    for pause in pauses:
        ids = tuple(sorted(finding.can_ids[0] for finding in pause))
        worst = min(pause, key=lambda finding: finding.severity != "problem")
        text, begin_ns = pause[0].words, pause[0].t_ns
        if len(pause) >= MANY:
            # While all of them were missing: before and after it a slow message has no turn.
            spans = [(finding.t_ns or 0, round(gaps[finding.can_ids[0]] * MS)) for finding in pause]
            shared_ns = min(begin + length for begin, length in spans) - max(begin for begin, _ in spans)
            if shared_ns <= 0:
                shared_ns = max(length for _, length in spans)
            else:
                begin_ns = max(begin for begin, _ in spans)
            text = f"a pause of {shared_ns / MS:.0f} ms of {_whose(ids, len(bus.messages))}"
            if record.perhaps_set_at((begin_ns or 0) + shared_ns):
                text += ", or the log's clock was set forward"
            if len(ids) == len(bus.messages):
                if errors is not None and 0 <= (errors.t_ns or 0) - (begin_ns or 0) <= shared_ns:
                    worst, text, errors = errors, f"{text.partition(':')[0]}, and {errors.words}", None
                elif worst.remedy:
                    worst = structs.replace(worst, remedy=f"{remedy_of('recorder')}; {remedy_of('bus_lost')}")
        yield structs.replace(worst, words=text, t_ns=begin_ns, can_ids=ids)
    if errors is not None:
        yield errors


def _stopped(record: Record, bus: BusStatistics) -> Iterator[Finding]:
    """All messages of the car, or of the AI computer, that end together before the log does: one finding.

    Where the car was not about to drive somebody switched it off, or ended the program: that is no problem.
    """
    state = record.series(AS_STATE)
    active = bool(len(state)) and state.values[-1] in (READY, DRIVING)
    for ids, who, cause in ((AI_IDS, "the AI computer", "ai_silent"), (VCU_IDS, "the car", "vcu_reboot")):
        silent = {m.can_id: m for m in bus.messages if m.can_id in ids and not m.extended}
        lost = [m for m in silent.values() if m.silent_ms * MS >= COMMS_LOST_NS]
        if len(lost) > 1 and len(lost) == len(silent):
            text = f"{who} is silent for the last {min(m.silent_ms for m in lost) / 1000:.1f} s"
            last_s = max(m.last_s for m in lost)
            with_it = [m.can_id for m in bus.messages if abs(m.last_s - last_s) * S < WITH_IT_NS]  # its other devices
            gone = tuple(sorted({*silent, *with_it}))
            remedy = remedy_of(cause, theirs=record.ai_is_theirs) if active else ""
            where = (remedy, round(last_s * S), gone, bus.channel)
            yield Finding("problem" if active else "note", "stopped", text, *where)


def _whose(ids: tuple[int, ...], messages: int) -> str:
    if len(ids) == messages:
        return f"all {messages} messages: the bus was dead, or the recording paused"
    if set(ids) == set(AI_IDS):
        return "the AI computer's five messages"
    if set(ids) <= set(VCU_IDS) and STATUS in ids:
        return f"{len(ids)} of the VCU's messages"
    if STATUS in ids and set(ids).isdisjoint(AI_IDS):
        return f"{len(ids)} of the car's messages"
    if len(ids) > messages // 2:
        return f"{len(ids)} of {messages} messages"
    return f"{len(ids)} messages ({', '.join(f'0x{can_id:03X}' for can_id in ids)})"


def _not_judged(whole: Record, buses: Sequence[BusStatistics]) -> Iterator[str]:
    """A second car, on another bus than the log's: its periods are judged, and nothing of what it did."""
    cars = [bus.channel for bus in buses if any(m.can_id == STATUS and not m.extended for m in bus.messages)]
    others = ", ".join(channel for channel in cars if channel != whole.channel)
    if others:
        yield f"0x520 is on {others} too: only the car on {whole.channel} was judged; judge each bus by itself"


def _unknown(record: Record) -> Iterator[str]:
    """Why this log cannot be called well even if nothing in it is wrong."""
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
