"""What is not as it should be in the figures of one bus: they are held against the bus table and the databases."""

from __future__ import annotations

from collections.abc import Iterator

from msgspec.structs import replace

from fsai_vcu.diagnostics.finding import Finding
from fsai_vcu.diagnostics.remedies import remedy_of
from fsai_vcu.diagnostics.statistics.echoes import EchoFault
from fsai_vcu.diagnostics.statistics.measure import LOAD_WINDOW_NS, BusStatistics, Handshake, MessageStatistics
from fsai_vcu.interface.bus_table import BY_ID, Flow
from fsai_vcu.interface.reserved import AI_IDS, RESERVED_IDS
from fsai_vcu.interface.specification import COMMS_LOST_NS, PERIOD_NS
from fsai_vcu.interface.units import MS, S

_PERIOD_TOLERANCE = 0.1
_LONG_MS = 2000.0  # in which no frames that were held back shorten the mean by so much
_ENOUGH_INTERVALS = 20
_LOST_PERIODS = 10  # interface specification v4.0: ten in a row are a loss; used where the bus table names no timeout
_HIGH_LOAD = 0.7
_NOT_ON_THE_CAR = "the official simulator takes any, the car raises AI_COMMS_LOST within 100 ms"


def judge(bus: BusStatistics, *, theirs: bool = False) -> list[Finding]:
    """Everything that is not as it should be, the grave first. `theirs`: the AI computer's program is not this one."""
    found = [*_judge_bus(bus), *(finding for message in bus.messages for finding in _judge_message(message))]
    found.sort(key=lambda finding: finding.severity != "problem")
    if theirs:
        ours, other = (remedy_of("handshake", theirs=of) for of in (False, True))
        found = [replace(one, remedy=other) if one.remedy == ours else one for one in found]
    return [replace(finding, channel=bus.channel) for finding in found]


def _finding(
    grave: bool, kind: str, words: str, can_id: int | None = None, t_s: float | None = None, remedy: str = ""
) -> Finding:
    """`remedy`: its place in the table, where it is not the kind."""
    t_ns = None if t_s is None else round(t_s * S)
    ids = () if can_id is None else (can_id,)
    return Finding("problem" if grave else "note", kind, words, remedy_of(remedy or kind) if grave else "", t_ns, ids)


def _judge_bus(bus: BusStatistics) -> Iterator[Finding]:
    if not bus.frames:
        yield _finding(True, "silent", f"nothing was received on {bus.channel}")
        return
    if not bus.duration_s:
        yield _finding(False, "no-times", "no times to measure: the log has none, or is a single instant")
    if bus.backwards:
        often = f"{bus.backwards} times" if bus.backwards > 1 else "once"
        text = f"times go backwards {often}: a clock was set, logs joined, or frames not in order"
        yield _finding(False, "clock", text, t_s=bus.backwards_at_s)
    if bus.error_frames:
        count, kinds = sum(bus.error_frames.values()), len(bus.error_frames)
        which = (words if kinds == 1 else f"{n} {words}" for words, n in bus.error_frames.items())
        yield _finding(True, "error-frames", f"{count} error frame{'s' * (count > 1)}: {'; '.join(which)}")
    absent: dict[str, list[str]] = {}
    for layout in bus.missing:
        own = BY_ID.get(layout.can_id)
        name = _name(layout.can_id, layout.name, layout.extended)
        ours = own is not None and own.name == layout.name and own.flow in (Flow.TO_VCU, Flow.FROM_VCU)
        if own is not None and ours and own.timeout_ns is not None:
            yield _finding(True, "missing", f"{name} was never received", layout.can_id)
        else:
            absent.setdefault(", ".join(layout.senders), []).append(name)
    if absent:
        # Boxes that are not on this bus have many messages; their names are worth a line, and no list.
        words = (
            f"{len(names)} messages of {sender}" if sender and len(names) > 1 else ", ".join(names)
            for sender, names in absent.items()
        )
        yield _finding(False, "missing", f"never received: {', '.join(words)}")
    if bus.peak_load > _HIGH_LOAD:
        busiest = f"{bus.peak_load:.1%} in its busiest {LOAD_WINDOW_NS // MS} ms"
        yield _finding(False, "load", f"bus load {bus.load:.1%}, and {busiest}")
    if bus.handshake is not None:
        yield from _judge_handshake(bus.handshake)
    if bus.frozen_counts:
        names = ", ".join(name for name, _, _ in bus.frozen_counts)
        _, since_s, for_s = max(bus.frozen_counts, key=lambda frozen: frozen[2])
        text = f"{names} stood still for {for_s:.1f} s while its wheel turned"
        yield _finding(True, "frozen", text, 0x526, since_s, "pulses_stand")


def _judge_handshake(handshake: Handshake) -> Iterator[Finding]:
    if handshake.fault is not None:
        often = f"{handshake.wrong} of {handshake.echoes} echoes are wrong"
        if handshake.fault is EchoFault.LATE:
            yield _finding(False, "handshake", f"the AI computer sends back {handshake.fault.value}: {often}", 0x510)
        else:
            text = f"the AI computer sends back {handshake.fault.value}: {often}; {_NOT_ON_THE_CAR}"
            yield _finding(True, "echo", text, 0x510)
            return
    if handshake.above_100_ms or handshake.unanswered:
        late = f"{handshake.above_100_ms} answered after {COMMS_LOST_NS // MS} ms or more"
        text = f"{handshake.unanswered} handshakes without an answer and {late}: the VCU takes that for AI_COMMS_LOST"
        yield _finding(True, "handshake", text, 0x510, handshake.missed_at_s)
    elif handshake.response_ms.p99_ms is not None and handshake.response_ms.p99_ms * MS > PERIOD_NS:
        text = f"handshake answered within {handshake.response_ms.p99_ms:.1f} ms (p99): slow"
        yield _finding(False, "handshake", text, 0x510)


def _judge_message(message: MessageStatistics) -> Iterator[Finding]:
    can_id = message.can_id
    name = _name(can_id, message.name, message.extended)
    if message.name is None:
        yield _finding(False, "unknown", f"{name} is in no database: {message.count} frames", can_id, message.first_s)
    if message.wrong_lengths:
        which = ", ".join(f"{count} of {length} bytes" for length, count in message.wrong_lengths.items())
        text = f"{name} must have {message.expected_length} bytes: {which}"
        yield _finding(True, "wrong-length", text, can_id, message.wrong_length_at_s)
    if not message.extended and message.remote and can_id in AI_IDS:
        text = f"{name}: {message.remote} remote frames"
        yield _finding(True, "intruder", text, can_id, message.remote_at_s, "remote_frames")
    if not message.extended and message.sent and can_id in RESERVED_IDS:
        text = f"{name}: sent {message.sent} times by this computer, which must not"
        yield _finding(True, "reserved", text, can_id, message.sent_at_s)
    expected_ms, gap_ms, p50_ms = message.expected_ms, message.longest_gap_ms, message.interval_ms.p50_ms
    if expected_ms is None or gap_ms is None or p50_ms is None:
        return
    own = None if message.extended else BY_ID.get(can_id)
    own = own if own is not None and own.name == message.name else None
    supervised = own is None or own.timeout_ns is not None
    lost_ms = own.timeout_ns / MS if own is not None and own.timeout_ns else _LOST_PERIODS * expected_ms
    if message.silent_ms >= lost_ms:
        text = f"{name} is silent for the last {message.silent_ms:.0f} ms"
        yield _finding(supervised, "stopped", text, can_id, message.last_s)
    if gap_ms >= lost_ms:
        text = f"{name} was silent for {gap_ms:.1f} ms: {lost_ms:g} ms count as lost"
        yield _finding(supervised, "gap", text, can_id, message.longest_gap_at_s)
    elif message.gaps:
        text = f"{name}: frames missing {message.gaps} times, the longest gap {gap_ms:.1f} ms"
        yield _finding(False, "gap", text, can_id, message.longest_gap_at_s)
    # A gap moves the mean, and a rhythm of short and long moves the median: a wrong period moves both.
    off = min(abs(period_ms / expected_ms - 1.0) for period_ms in (p50_ms, message.mean_ms or 0.0))
    mean_ms = message.mean_ms or expected_ms
    if message.count * mean_ms > _LONG_MS and mean_ms < (1.0 - _PERIOD_TOLERANCE) * expected_ms:
        often = f"{1000 / mean_ms:.0f} times a second, but should {1000 / expected_ms:.0f} times"
        yield _finding(supervised, "period", f"{name} comes {often}: a wrong period, or a second sender", can_id)
    elif message.count > _ENOUGH_INTERVALS and off > _PERIOD_TOLERANCE:
        text = f"{name} comes every {p50_ms:.2f} ms, but should every {expected_ms:g} ms"
        yield _finding(supervised, "period", text, can_id)


def _name(can_id: int, name: str | None, extended: bool) -> str:
    number = f"0x{can_id:08X}" if extended else f"0x{can_id:03X}"
    return f"{name} ({number})" if name else number
