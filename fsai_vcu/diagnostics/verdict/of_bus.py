"""Findings in the figures of one bus, which are held against the bus table and the databases.

What the explanation has told already (`KnownOfBus`) is not said a second time: each finding is made once, with all that
goes with it, and none is taken back.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Final, Literal, NamedTuple

from msgspec.structs import replace

from fsai_vcu.diagnostics.explain.evidence import AT_ONCE_NS
from fsai_vcu.diagnostics.explain.record import DEAD_NS
from fsai_vcu.diagnostics.finding import Finding
from fsai_vcu.diagnostics.log.recorded import is_virtual
from fsai_vcu.diagnostics.remedies import OURS, Setting, remedy_of
from fsai_vcu.diagnostics.statistics.echoes import EchoFault
from fsai_vcu.diagnostics.statistics.measure import (
    LOAD_WINDOW_NS,
    MISSING_PERIODS,
    BusStatistics,
    Handshake,
    MessageStatistics,
)
from fsai_vcu.interface.bus_table import BY_ID, BusMessage, Flow
from fsai_vcu.interface.reserved import AI_IDS, RESERVED_IDS, VCU_IDS
from fsai_vcu.interface.specification import COMMS_LOST_NS, PERIOD_NS
from fsai_vcu.interface.units import MS, S

_PERIOD_TOLERANCE = 0.1
_LONG_MS = 2000.0  # in which no frames that were held back shorten the mean by so much
_ENOUGH_INTERVALS = 20
_LOST_PERIODS = 10  # interface specification v4.0: ten in a row are a loss; used where the bus table names no timeout
_HIGH_LOAD = 0.7
_NOT_ON_THE_CAR = "the official simulator takes any, the car raises AI_COMMS_LOST within 100 ms"
STATUS: Final = 0x520
MANY: Final = 3
MOST_NAMED: Final = 8
LOSSY: Final = 5  # messages that miss frames again and again
LOST_SHARE: Final = 0.01  # of all frames: more is no log to judge by
ECHO_NS: Final = 1 * S  # echoes that are missing so close to a cause are what it says
WITH_IT_NS: Final = 1 * S  # what falls silent so close to the car is switched off with it


@dataclass(frozen=True)
class KnownOfBus:
    """Knowledge of a bus from its explanation, which is not said a second time.

    told: (identifier, moment) that a cause names as missing, foreign or an error. lengths: identifiers whose length one
    names. echoes_ns: moments of causes that name a missing echo. mixed: two cars speak, so that no echo means anything.
    shared: identifiers on which more than one sends. absent: those whose absence is said already. errors_ns: the first
    error frame; errors_told: a cause names them all. setting: what chooses the remedies. active: the car was about to
    drive when the log ended. others: it is another bus than the car's, which has other messages. perhaps_set_ns: the
    ends of pauses that may be the log's clock, set forward.
    """

    told: frozenset[tuple[int | None, int]] = frozenset()
    lengths: frozenset[int] = frozenset()
    echoes_ns: tuple[int, ...] = ()
    mixed: bool = False
    shared: frozenset[int] = frozenset()
    absent: frozenset[int] = frozenset()
    errors_ns: int | None = None
    errors_told: bool = False
    setting: Setting = OURS
    active: bool = False
    others: bool = False
    perhaps_set_ns: tuple[int, ...] = ()


def judge(bus: BusStatistics, known: KnownOfBus | None = None) -> list[Finding]:
    """Everything that is not as it should be, the grave first."""
    said = known or KnownOfBus()
    found = list(_Judge(bus, said).findings())
    found.sort(key=lambda finding: finding.severity != "problem")
    return found


class _Pause(NamedTuple):
    """The longest pause of a message. lost: longer than its loss; grave: and the message must not be lost."""

    message: MessageStatistics
    words: str
    grave: bool

    @property
    def begin_ns(self) -> int:
        return round((self.message.longest_gap_at_s or 0.0) * S)

    @property
    def length_ns(self) -> int:
        return round((self.message.longest_gap_ms or 0.0) * MS)

    def same(self, other: _Pause) -> bool:
        """True where both were missing at one time: most of the shorter pause lies within the longer one."""
        begins, lasts = (self.begin_ns, other.begin_ns), (self.length_ns, other.length_ns)
        shared = min(self.begin_ns + self.length_ns, other.begin_ns + other.length_ns) - max(begins)
        return abs(begins[0] - begins[1]) <= AT_ONCE_NS or shared > 0.5 * min(lasts)


@dataclass
class _Judge:
    """One bus, and what is known of it."""

    bus: BusStatistics
    known: KnownOfBus
    gone: frozenset[int] = field(default_factory=frozenset)

    def findings(self) -> Iterator[Finding]:
        """Yield the findings on the bus, none of them twice."""
        bus = self.bus
        if not bus.frames:
            yield self._finding(True, "silent", f"nothing was received on {bus.channel}")
            return
        yield from self._times()
        stopped = list(self._together_stopped())
        self.gone = frozenset(can_id for finding in stopped for can_id in finding.can_ids)
        # An AI computer that fell silent is a cause; a log that ends without the car is said beside it.
        yield from (
            one for one in stopped if AI_IDS[0] not in one.can_ids or not self._is_told(AI_IDS[0], (one.t_ns or 0) / S)
        )
        yield from self._missing()
        if bus.handshake is not None:
            yield from self._handshake(bus.handshake)
        if bus.frozen_counts:
            names = ", ".join(name for name, _, _ in bus.frozen_counts)
            _, since_s, for_s = max(bus.frozen_counts, key=lambda frozen: frozen[2])
            text = f"{names} stood still for {for_s:.1f} s while its wheel turned"
            yield self._finding(True, "frozen", text, 0x526, since_s, "pulses_stand")
        yield from self._unknown()
        for message in bus.messages:
            yield from self._message(message)
        yield from self._lost()

    def _finding(
        self,
        grave: bool,
        kind: str,
        words: str,
        ids: int | tuple[int, ...] = (),
        t_s: float | None = None,
        remedy: str = "",
        silent_ns: tuple[tuple[int, int], ...] = (),
    ) -> Finding:
        """Make a finding; `remedy`: its place in the table, where it is not the kind."""
        t_ns = None if t_s is None else round(t_s * S)
        to_do = remedy_of(remedy or kind, self.known.setting) if grave else ""
        can_ids = (ids,) if isinstance(ids, int) else ids
        return Finding("problem" if grave else "note", kind, words, to_do, t_ns, can_ids, self.bus.channel, silent_ns)

    def _times(self) -> Iterator[Finding]:
        bus = self.bus
        if not bus.duration_s:
            yield self._finding(False, "no-times", "no times to measure: the log has none, or is a single instant")
        if bus.backwards:
            often = f"{bus.backwards} times" if bus.backwards > 1 else "once"
            text = f"times go backwards {often}: a clock was set, logs joined, or frames not in order"
            yield self._finding(False, "clock", text, t_s=bus.backwards_at_s)
        if bus.peak_load > _HIGH_LOAD:
            busiest = f"{bus.peak_load:.1%} in its busiest {LOAD_WINDOW_NS // MS} ms"
            yield self._finding(False, "load", f"bus load {bus.load:.1%}, and {busiest}")

    def _missing(self) -> Iterator[Finding]:
        """Messages that were never received; those of another bus, and those that are said to be unknown, are not."""
        if self.known.others:
            return
        absent: dict[str, list[str]] = {}
        for layout in self.bus.missing:
            own = BY_ID.get(layout.can_id)
            name = _name(layout.can_id, layout.name, layout.extended)
            ours = own is not None and own.name == layout.name and own.flow in (Flow.TO_VCU, Flow.FROM_VCU)
            if own is not None and ours and own.timeout_ns is not None:
                if layout.can_id not in self.known.absent:
                    yield self._finding(True, "missing", f"{name} was never received", layout.can_id)
            else:
                absent.setdefault(", ".join(layout.senders), []).append(name)
        if absent:
            # Boxes that are not on this bus have many messages: their count is enough.
            words = [
                (f"{len(names)} messages" if len(names) > MOST_NAMED else ", ".join(names))
                + (f" of {sender}" if sender else "")
                for sender, names in absent.items()
            ]
            why = " (usual in a simulation)" if is_virtual(self.bus.channel) else ""
            yield self._finding(False, "missing", f"never received: {'; '.join(words)}{why}")

    def _handshake(self, handshake: Handshake) -> Iterator[Finding]:
        """Yield the findings on how the AI computer answers the HANDSHAKE."""
        if handshake.fault is not None:
            often = f"{handshake.wrong} of {handshake.echoes} echoes are wrong"
            text = f"the AI computer sends back {handshake.fault.value}: {often}"
            if handshake.fault is not EchoFault.LATE:
                if self.known.echoes_ns:
                    return
                yield self._finding(True, "echo", f"{text}; {_NOT_ON_THE_CAR}", 0x510)
                return
            yield self._finding(False, "handshake", text, 0x510)
        lost = handshake.unanswered + handshake.above_100_ms
        if lost:
            missed_ns = (handshake.missed_at_s or 0.0) * S
            told = any(abs(missed_ns - t_ns) <= ECHO_NS for t_ns in self.known.echoes_ns)
            if told or lost <= len(self.known.echoes_ns) or self.known.mixed:
                return
            late = f"{handshake.above_100_ms} answered after {COMMS_LOST_NS // MS} ms or more"
            text = (
                f"{handshake.unanswered} handshakes without an answer and {late}: the VCU takes that for AI_COMMS_LOST"
            )
            silent_ns = tuple((round(t_s * S), round(t_s * S) + COMMS_LOST_NS) for t_s in handshake.missed_s)
            yield self._finding(True, "handshake", text, 0x510, handshake.missed_at_s, silent_ns=silent_ns)
        elif handshake.response_ms.p99_ms is not None and handshake.response_ms.p99_ms * MS > PERIOD_NS:
            text = f"handshake answered within {handshake.response_ms.p99_ms:.1f} ms (p99): slow"
            yield self._finding(False, "handshake", text, 0x510)

    def _unknown(self) -> Iterator[Finding]:
        found = [message for message in self.bus.messages if message.name is None]
        if len(found) < MANY:
            for message in found:
                text = f"{_of(message)} is in no database: {message.count} frames"
                yield self._finding(False, "unknown", text, message.can_id, message.first_s)
            return
        ids = tuple(sorted(message.can_id for message in found))
        names = ", ".join(f"0x{can_id:03X}" for can_id in ids[:MOST_NAMED]) + (" …" if len(ids) > MOST_NAMED else "")
        first_s = min(message.first_s for message in found)
        yield self._finding(False, "unknown", f"{len(ids)} identifiers are in no database: {names}", ids, first_s)

    def _message(self, message: MessageStatistics) -> Iterator[Finding]:
        """Findings on one message, but for its pauses."""
        can_id, name = message.can_id, _of(message)
        if message.wrong_lengths and can_id not in self.known.lengths:
            which = ", ".join(f"{count} of {length} bytes" for length, count in message.wrong_lengths.items())
            text = f"{name} must have {message.expected_length} bytes: {which}"
            yield self._finding(True, "wrong-length", text, can_id, message.wrong_length_at_s)
        if not message.extended and message.remote and can_id in AI_IDS:
            text = f"{name}: {message.remote} remote frames"
            yield self._finding(True, "remote-frames", text, can_id, message.remote_at_s, "remote_frames")
        if not message.extended and message.sent and can_id in RESERVED_IDS:
            text = f"{name}: sent {message.sent} times by this computer, which must never send it"
            yield self._finding(True, "reserved", text, can_id, message.sent_at_s)
        expected_ms, p50_ms = message.expected_ms, message.interval_ms.p50_ms
        if expected_ms is None or p50_ms is None or message.longest_gap_ms is None:
            return
        supervised, lost_ms = _supervised(message, expected_ms)
        if message.silent_ms >= lost_ms and can_id not in self.gone and not self._is_told(can_id, message.last_s):
            text = f"{name} is silent for the last {message.silent_ms:.0f} ms"
            yield self._finding(supervised, "stopped", text, can_id, message.last_s)
        if can_id in self.known.shared:
            return
        off = _off(message, expected_ms, p50_ms)
        mean_ms = message.mean_ms or expected_ms
        if message.count * mean_ms > _LONG_MS and mean_ms < (1.0 - _PERIOD_TOLERANCE) * expected_ms:
            rates = f"{1000 / mean_ms:.0f} Hz instead of {1000 / expected_ms:.0f} Hz"
            text = f"{name} comes at {rates}: a wrong period, or a second sender"
            yield self._finding(supervised, "period", text, can_id)
        elif message.count > _ENOUGH_INTERVALS and off > _PERIOD_TOLERANCE:
            text = f"{name} comes every {p50_ms:.2f} ms instead of every {expected_ms:g} ms"
            yield self._finding(supervised, "period", text, can_id)

    # ------------------------------------------------------------ silence

    def _together_stopped(self) -> Iterator[Finding]:
        """All messages of the car, or of the AI computer, that end together before the log does: one finding.

        Where the car was not about to drive somebody switched it off, or ended the program: that is no problem.
        """
        for ids, who, cause in ((AI_IDS, "the AI computer", "ai_silent"), (VCU_IDS, "the car", "vcu_reboot")):
            silent = {m.can_id: m for m in self.bus.messages if m.can_id in ids and not m.extended}
            lost = [m for m in silent.values() if m.silent_ms * MS >= COMMS_LOST_NS]
            if len(lost) > 1 and len(lost) == len(silent):
                text = f"{who} is silent for the last {min(m.silent_ms for m in lost) / 1000:.1f} s"
                last_s = max(m.last_s for m in lost)
                with_it = [m.can_id for m in self.bus.messages if abs(m.last_s - last_s) * S < WITH_IT_NS]
                gone = tuple(sorted({*silent, *with_it}))  # its other devices, too
                yield self._finding(self.known.active, "stopped", text, gone, last_s, cause)

    def _lost(self) -> Iterator[Finding]:
        """Frames that are missing: again and again, or in pauses, with the error frames of the same time."""
        lossy = self._lossy()
        if lossy:
            yield lossy
        errors = self._errors()
        for pause in self._pauses(lossy.can_ids if lossy else ()):
            finding = self._pause(pause)
            whole = len(pause) >= MANY and len(pause) == len(self.bus.messages)
            begin_ns, length_ns = _shared(pause)
            if whole and errors is not None and 0 <= (errors.t_ns or 0) - begin_ns <= length_ns:
                words = f"{finding.words.partition(':')[0]}, and {errors.words}"
                yield self._finding(True, errors.kind, words, finding.can_ids, begin_ns / S, "bus_lost")
                errors = None
            else:
                yield finding
        if errors is not None:
            yield errors

    def _errors(self) -> Finding | None:
        kinds = self.bus.error_frames
        if not kinds or self.known.errors_told:
            return None
        count = sum(kinds.values())
        which = (words if len(kinds) == 1 else f"{n} {words}" for words, n in kinds.items())
        text = f"{count} error frame{'s' * (count > 1)}: {'; '.join(which)}"
        first = self.known.errors_ns
        return self._finding(True, "error-frames", text, t_s=None if first is None else first / S, remedy="bus_lost")

    def _lossy(self) -> Finding | None:
        """Many messages that miss single frames again and again: nothing is wrong with each of them."""
        found = [message for message in self.bus.messages if message.gaps and message.lost and _in_its_period(message)]
        if sum(min(message.gaps, message.lost) >= MANY for message in found) < LOSSY:
            return None
        lost = {message.can_id: message.lost for message in found}
        part = sum(lost.values()) / (self.bus.frames + sum(lost.values()))
        some = f"{len(lost)} of {len(self.bus.messages)} messages"
        text = f"frames of {some} are missing again and again, {part:.1%} of all"
        severity: Literal["problem", "note"] = "problem" if part > LOST_SHARE else "note"
        return Finding(
            severity, "lossy", text, remedy_of("lossy", self.known.setting), None, tuple(sorted(lost)), self.bus.channel
        )

    def _pauses(self, lossy: Iterable[int]) -> list[list[_Pause]]:
        """The longest pause of each message, those of one time together; not what a cause names."""
        together: list[list[_Pause]] = []
        for pause in sorted(self._each_pause(), key=lambda pause: not pause.grave):
            can_id = pause.message.can_id
            if self._is_told(can_id, pause.begin_ns / S) or (not pause.grave and can_id in lossy):
                continue
            group = next((group for group in together if group[0].same(pause)), None)
            if group is None:
                together.append([pause])
            else:
                group.append(pause)
        return together

    def _is_told(self, can_id: int, since_s: float) -> bool:
        """True where a cause names the message, or what is silent with it, as missing since then."""
        return any(_covers(at, can_id) and abs(t_ns - since_s * S) <= AT_ONCE_NS for at, t_ns in self.known.told)

    def _each_pause(self) -> Iterator[_Pause]:
        for message in self.bus.messages:
            expected_ms, gap_ms = message.expected_ms, message.longest_gap_ms
            if expected_ms is None or gap_ms is None or message.interval_ms.p50_ms is None:
                continue
            supervised, lost_ms = _supervised(message, expected_ms)
            if gap_ms >= lost_ms:
                words = f"{_of(message)} was silent for {gap_ms:.1f} ms: {lost_ms:g} ms count as lost"
                yield _Pause(message, words, supervised)
            elif message.gaps and _in_its_period(message):
                words = f"{_of(message)}: frames missing {message.gaps} times, the longest gap {gap_ms:.1f} ms"
                yield _Pause(message, words, False)

    def _pause(self, pause: list[_Pause]) -> Finding:
        """Return the finding on messages that paused at one time; a pause of many is told as one of the bus."""
        ids = tuple(sorted(one.message.can_id for one in pause))
        grave = any(one.grave for one in pause)
        text, messages = pause[0].words, len(self.bus.messages)
        begin_ns, length_ns = pause[0].begin_ns, pause[0].length_ns
        if len(pause) >= MANY:
            begin_ns, length_ns = _shared(pause)
            text = f"a pause of {length_ns / MS:.0f} ms in {_whose(ids, messages)}"
            if any(abs(end_ns - begin_ns - length_ns) <= DEAD_NS for end_ns in self.known.perhaps_set_ns):
                text += ", or the log's clock was set forward"
        silent_ns = ((begin_ns, begin_ns + length_ns),)
        finding = self._finding(grave, "gap", text, ids, begin_ns / S, silent_ns=silent_ns)
        if len(pause) < MANY or len(ids) < messages or not grave:
            return finding
        both = f"{remedy_of('recorder')}; {remedy_of('bus_lost', self.known.setting)}"
        return replace(finding, remedy=both)


def _covers(named: int | None, can_id: int) -> bool:
    """Return true where a message is silent with one that a cause names: a VCU's with its status, all five of an AI."""
    if named == STATUS:
        return can_id not in AI_IDS
    return can_id in AI_IDS if named == AI_IDS[0] else can_id == named


def _shared(pause: list[_Pause]) -> tuple[int, int]:
    """(since when, for how long) all of them were missing: before and after it a slow message has no turn."""
    begin_ns = max(one.begin_ns for one in pause)
    length_ns = min(one.begin_ns + one.length_ns for one in pause) - begin_ns
    if length_ns <= 0:
        return pause[0].begin_ns, max(one.length_ns for one in pause)
    return begin_ns, length_ns


def _off(message: MessageStatistics, expected_ms: float, p50_ms: float) -> float:
    """Return the share by which a message misses its period.

    A gap moves the mean, and a rhythm of short and long the median: the smaller share counts.
    """
    return min(abs(period_ms / expected_ms - 1.0) for period_ms in (p50_ms, message.mean_ms or 0.0))


def periods_kept(bus: BusStatistics) -> str:
    """The sentence on a bus whose messages all come in their periods, without a gap; '' for any other."""
    timed = [(m, m.expected_ms, m.interval_ms.p50_ms) for m in bus.messages if m.expected_ms is not None]
    for message, expected_ms, p50_ms in timed:
        if p50_ms is None or message.gaps or message.silent_ms >= _LOST_PERIODS * expected_ms:
            return ""
        if _off(message, expected_ms, p50_ms) > _PERIOD_TOLERANCE:
            return ""
    if len(timed) == 1:
        return "the 1 periodic message comes in its period, without gaps"
    return f"all {len(timed)} periodic messages come in their periods, without gaps" if timed else ""


def _in_its_period(message: MessageStatistics) -> bool:
    """True where it comes in its period at all: a message with another period lacks no frames."""
    expected_ms, p50_ms = message.expected_ms, message.interval_ms.p50_ms
    return expected_ms is not None and p50_ms is not None and p50_ms < MISSING_PERIODS * expected_ms


def _supervised(message: MessageStatistics, expected_ms: float) -> tuple[bool, float]:
    """(True where somebody acts on the loss of that message, the ms without it that are a loss)."""
    own: BusMessage | None = None if message.extended else BY_ID.get(message.can_id)
    own = own if own is not None and own.name == message.name else None
    lost_ms = own.timeout_ns / MS if own is not None and own.timeout_ns else _LOST_PERIODS * expected_ms
    return own is None or own.timeout_ns is not None, lost_ms


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


def _of(message: MessageStatistics) -> str:
    return _name(message.can_id, message.name, message.extended)


def _name(can_id: int, name: str | None, extended: bool) -> str:
    number = f"0x{can_id:08X}" if extended else f"0x{can_id:03X}"
    return f"{name} ({number})" if name else number
