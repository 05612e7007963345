"""The link between AI computer and VCU around a moment: which message, or which echo, was missing, and since when."""

from __future__ import annotations

from typing import Final

import numpy as np

from fsai_vcu.diagnostics.decode.error_frames import error_words
from fsai_vcu.diagnostics.explain import signals as sig
from fsai_vcu.diagnostics.explain.incident import Candidate, ChainLink, Sureness, candidate
from fsai_vcu.diagnostics.explain.record import Gap, Record
from fsai_vcu.diagnostics.explain.record import ms as ms
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
        if gap.begin_ns + least_ns - EARLY_NS <= t_ns and gap.over_ns >= t_ns - AT_ONCE_NS:
            return None if record.silence_in(gap) else gap
    return None


def silence_words(begin_ns: int, end_ns: int) -> str:
    return f"nothing at all is received for {ms(end_ns - begin_ns)}: the bus was dead, or the recording paused"


def dead_bus(record: Record, t_ns: int, sureness: Sureness) -> list[Candidate]:
    """Nothing was received just before `t_ns`: then no single message can be blamed."""
    for begin_ns, end_ns in record.silences:
        if begin_ns < t_ns and end_ns >= t_ns - AT_ONCE_NS:
            return [candidate("bus_lost", sureness, ChainLink(begin_ns, silence_words(begin_ns, end_ns)))]
    return []


def error_text(record: Record, t_ns: int) -> str:
    """What the error frame at `t_ns` says."""
    frames = record.frames
    rows = np.flatnonzero(((frames.flags & ERROR) != 0) & (frames.t_ns == t_ns))
    return ", ".join(error_words(int(frames.can_id[rows[0]]), frames.payload(int(rows[0]))))


def link_losses(record: Record, t_ns: int, said: Sureness) -> list[Candidate]:
    """What explains AI_COMMS_LOST at `t_ns`, the likeliest first. Empty where the frames show a sound link.

    `said`: how sure it is that the link was lost at all.
    """
    if found := dead_bus(record, t_ns, said):
        return found
    gaps = {can_id: gap for can_id in AI_IDS if (gap := gap_at(record, can_id, t_ns, COMMS_LOST_NS)) is not None}
    begins = [gap.begin_ns for gap in gaps.values()]
    if len(gaps) == len(AI_IDS) and max(begins) - min(begins) <= AT_ONCE_NS:
        return [_silent(record, t_ns, list(gaps.values()), said)]
    for can_id, gap in gaps.items():
        wrong = record.wrong_length.get(can_id)
        if wrong is not None and wrong[1] <= t_ns:
            slug, words = "ai_message_length", f"{BY_ID[can_id]} comes with the wrong length"
        else:
            length = "to the end of the log" if gap.end_ns is None else gap.words()
            slug = "ai_message_missing"
            words = f"the last {BY_ID[can_id]} before it is missing {length}, while others go on"
        found.append(candidate(slug, said, ChainLink(gap.begin_ns, words, can_id)))
    for can_id in AI_IDS if record.ai_speaks else ():
        if not record.has(can_id):
            begin_ns = min(int(record.times(i)[0]) for i in AI_IDS if record.has(i))
            wrong = record.wrong_length.get(can_id)
            slug = "ai_message_length" if wrong else "ai_message_missing"
            words = f"{BY_ID[can_id]} " + ("always has the wrong length" if wrong else "never comes")
            found.append(candidate(slug, said, ChainLink(begin_ns, words, can_id)))
    return found or _handshake(record, t_ns, said)


def _silent(record: Record, t_ns: int, gaps: list[Gap], said: Sureness) -> Candidate:
    """All five messages stopped together."""
    first = min(gap.begin_ns for gap in gaps)
    back = min((gap.end_ns for gap in gaps if gap.end_ns is not None), default=None)
    ends = "and did not come back" if back is None else f"for {ms(back - first)}"
    steps = [ChainLink(first, f"the last frame of the AI computer: 0x510 to 0x514 are silent {ends}", 0x510)]
    errors = record.errors_before(t_ns, LOOK_BACK_NS)
    if errors:
        many = f"{len(errors)} error frame{'s' if len(errors) > 1 else ''}"
        steps.append(ChainLink(errors[0], f"{many} on the bus: {error_text(record, errors[0])}"))
    if record.at(sig.ESTOP, first):
        steps.append(sig.ESTOP.step(first, "its last words were ESTOP_REQUEST 1: it was stopped on purpose"))
    # An adapter that goes bus-off silences a program that runs on.
    off = any("bus-off" in error_text(record, t_error_ns) for t_error_ns in errors)
    return candidate("bus_lost" if off else "ai_silent", said, *steps)


def _handshake(record: Record, t_ns: int, said: Sureness) -> list[Candidate]:
    for answer in record.answers:
        over_ns = record.end_ns if answer.echo_ns is None else answer.echo_ns
        due_ns = answer.toggle_ns + COMMS_LOST_NS - EARLY_NS
        if answer.waited_ns >= COMMS_LOST_NS - EARLY_NS and due_ns <= t_ns and over_ns >= t_ns - AT_ONCE_NS:
            words = (
                f"HANDSHAKE becomes {answer.bit}, and 0x510 keeps saying {1 - answer.bit} for {ms(answer.waited_ns)}"
            )
            return [candidate("handshake_lost", said, ChainLink(answer.toggle_ns, words, 0x520, "HANDSHAKE"))]
    return []


def timeouts_said(record: Record, begin_ns: int, end_ns: int) -> list[ChainLink]:
    """What 0x120 (2021) says was missing."""
    return [
        signal.step(span.begin_ns, f"the VCU misses {what}")
        for signal, what in sig.MISSED.items()
        for span in record.changes(signal, begin_ns, end_ns)
        if span.value
    ]
