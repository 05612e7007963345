"""The link between AI computer and VCU around a moment: which message, or which echo, was missing, and since when."""

from __future__ import annotations

from typing import Final

import numpy as np

from fsai_vcu.diagnostics.decode.error_frames import error_words
from fsai_vcu.diagnostics.explain import signals as sig
from fsai_vcu.diagnostics.explain.incident import Candidate, ChainLink, Sureness, candidate
from fsai_vcu.diagnostics.explain.record import Gap, Record
from fsai_vcu.diagnostics.explain.signals import is_on
from fsai_vcu.diagnostics.log.frames import ERROR
from fsai_vcu.interface.bus_table import BY_ID
from fsai_vcu.interface.reserved import AI_IDS
from fsai_vcu.interface.specification import COMMS_LOST_NS
from fsai_vcu.interface.units import MS, S

EARLY_NS: Final = 15 * MS  # the VCU counts from when it missed the first one; the log's stamps differ a little
AT_ONCE_NS: Final = 30 * MS  # messages that stop within this time stop together
GONE_NS: Final = 1 * S  # no 0x520 for so long: switched off …
REBOOT_NS: Final = 3 * S  # … unless it is back by then: a VCU that restarted by itself
LOOK_BACK_NS: Final = 2 * S


def gap_at(record: Record, can_id: int, t_ns: int, least_ns: int) -> Gap | None:
    """The gap of that message which had lasted `least_ns` (or nearly) at `t_ns`, or had ended shortly before."""
    for gap in record.gaps(can_id, least_ns - EARLY_NS):
        over_ns = record.end_ns if gap.end_ns is None else gap.end_ns
        if gap.begin_ns + least_ns - EARLY_NS <= t_ns and over_ns >= t_ns - AT_ONCE_NS:
            return None if record.silence_in(gap) else gap
    return None


def dead_bus(record: Record, t_ns: int, sureness: Sureness) -> list[Candidate]:
    """Nobody was heard just before `t_ns`: then no single message can be blamed."""
    for begin_ns, end_ns in record.silences:
        if begin_ns < t_ns and end_ns >= t_ns - AT_ONCE_NS:
            words = f"nothing at all is received for {ms(end_ns - begin_ns)}: the bus was dead, or the recording paused"
            return [candidate("bus_lost", sureness, [ChainLink(begin_ns, words)])]
    return []


def ms(length_ns: int) -> str:
    """A length of time as people read it."""
    if length_ns < S:
        return f"{length_ns / MS:.0f} ms" if length_ns >= 10 * MS else f"{length_ns / MS:.1f} ms"
    return f"{length_ns / S:.2f} s"


def error_text(record: Record, t_ns: int) -> str:
    """What the error frame at `t_ns` says."""
    frames = record.frames
    rows = np.flatnonzero(((frames.flags & ERROR) != 0) & (frames.t_ns == t_ns))
    if not len(rows):
        return "unspecified"
    return ", ".join(error_words(int(frames.can_id[rows[0]]), frames.payload(int(rows[0]))))


def link_losses(record: Record, t_ns: int, said: Sureness) -> list[Candidate]:
    """What explains AI_COMMS_LOST at `t_ns`, the likeliest first. Empty where the frames show a sound link.

    `said`: how sure it is that the link was lost at all.
    """
    found = dead_bus(record, t_ns, said)
    if found:
        return found
    gaps = {can_id: gap for can_id in AI_IDS if (gap := gap_at(record, can_id, t_ns, COMMS_LOST_NS)) is not None}
    errors = record.error_ns[(record.error_ns >= t_ns - LOOK_BACK_NS) & (record.error_ns <= t_ns)]
    if len(gaps) == len(AI_IDS) and _together(gaps):
        first = min(gap.begin_ns for gap in gaps.values())
        back = min((gap.end_ns for gap in gaps.values() if gap.end_ns is not None), default=None)
        ends = "and did not come back" if back is None else f"for {ms(back - first)}"
        steps = [ChainLink(first, f"the last frame of the AI computer: 0x510 to 0x514 are silent {ends}", 0x510)]
        if len(errors):
            steps.append(_error_step(record, int(errors[0]), len(errors)))
        if is_on(record, sig.ESTOP, first):
            steps.append(sig.ESTOP.step(first, "its last words were ESTOP_REQUEST 1: it was stopped on purpose"))
        # An adapter that goes bus-off silences a program that runs on.
        off = any("bus-off" in error_text(record, int(t_error_ns)) for t_error_ns in errors)
        return [candidate("bus_lost" if off else "ai_silent", said, steps)]
    for can_id, gap in gaps.items():
        wrong = record.wrong_length.get(can_id)
        if wrong is not None and wrong[1] <= t_ns:
            words = f"{BY_ID[can_id]} comes with the wrong length"
            found.append(candidate("ai_message_length", said, [ChainLink(gap.begin_ns, words, can_id)]))
            continue
        length = "to the end of the log" if gap.end_ns is None else f"for {ms(gap.length_ns)}"
        words = f"the last {BY_ID[can_id]} before it is missing {length}, while others go on"
        found.append(candidate("ai_message_missing", said, [ChainLink(gap.begin_ns, words, can_id)]))
    if record.has(0x510) or record.ai_speaks:
        for can_id in AI_IDS:
            if not record.has(can_id):
                begin = min(int(record.times(i)[0]) for i in AI_IDS if record.has(i))
                wrong = record.wrong_length.get(can_id)
                slug = "ai_message_length" if wrong else "ai_message_missing"
                words = f"{BY_ID[can_id]} " + ("always has the wrong length" if wrong else "never comes")
                found.append(candidate(slug, said, [ChainLink(begin, words, can_id)]))
    if not found:
        found += _handshake(record, t_ns, said)
    return found


def _together(gaps: dict[int, Gap]) -> bool:
    begins = [gap.begin_ns for gap in gaps.values()]
    return max(begins) - min(begins) <= AT_ONCE_NS


def _error_step(record: Record, t_ns: int, count: int) -> ChainLink:
    return ChainLink(t_ns, f"{count} error frame{'s' if count > 1 else ''} on the bus: {error_text(record, t_ns)}")


def _handshake(record: Record, t_ns: int, said: Sureness) -> list[Candidate]:
    for answer in record.answers:
        over_ns = record.end_ns if answer.echo_ns is None else answer.echo_ns
        due_ns = answer.toggle_ns + COMMS_LOST_NS - EARLY_NS
        if answer.waited_ns >= COMMS_LOST_NS - EARLY_NS and due_ns <= t_ns and over_ns >= t_ns - AT_ONCE_NS:
            words = (
                f"HANDSHAKE becomes {answer.bit}, and 0x510 keeps saying {1 - answer.bit} for {ms(answer.waited_ns)}"
            )
            return [candidate("handshake_lost", said, [ChainLink(answer.toggle_ns, words, 0x520, "HANDSHAKE")])]
    return []


def timeouts_said(record: Record, begin_ns: int, end_ns: int) -> list[ChainLink]:
    """What 0x120 (2021) says was missing."""
    steps = []
    for signal, can_id in {**sig.TIMEOUTS, sig.HANDSHAKE_TIMEOUT: 0x510}.items():
        for span in record.series(signal).changes(begin_ns, end_ns):
            if span.value:
                what = "the handshake's echo" if signal == sig.HANDSHAKE_TIMEOUT else str(BY_ID[can_id])
                steps.append(signal.step(span.begin_ns, f"the VCU misses {what}"))
    return steps
