"""Search for a second sender on the AI computer's ids, or on the VCU's, by how many frames come and by what they say.

Spacing alone proves nothing: a USB adapter hands frames over in batches, and a program that was held up sends two at
once. What proves it: the log's own marks of direction, more frames in a second than one sender's period allows, or a
frame between two others which says something else than both.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import numpy.typing as npt

from fsai_vcu.diagnostics.decode.databases import Databases
from fsai_vcu.diagnostics.decode.decoder import raw_of
from fsai_vcu.diagnostics.decode.layouts import MessageLayout
from fsai_vcu.diagnostics.log.frames import RECEIVED, SENT, Frames, Ints, Mask
from fsai_vcu.diagnostics.statistics.measure import NEVER_NS
from fsai_vcu.interface.reserved import AI_IDS, VCU_IDS
from fsai_vcu.interface.specification import PERIOD_NS
from fsai_vcu.interface.units import MS, S

SHORT_NS: Final = 200 * MS
LONG_NS: Final = 1 * S  # a sender that catches up after a pause sends no more than its period allows in this time
SHORT_EXCESS: Final = 1.5
CLOSE: Final = 0.75  # of a period
LONG_EXCESS: Final = 1.09
SLOW_NS: Final = 2 * S  # in which one is told that sends less often than the other, and the same
SLOW_EXCESS: Final = 1.08
AROUND: Final = 3  # frames before and after a frame that contradicts them
EXTRA_NS: Final = 5 * MS  # by which so many frames come sooner than one sender's would
_BATCHED_SHARE: Final = 0.05  # of frames under a millisecond after the one before
REPEATED: Final = 3  # contradictions that prove a second sender where stamps do not
APART: Final = 40  # raw steps: 4 degrees, 4 Nm, 20 % of brake; the noise of one sender's commands is below
FEW_BITS: Final = 4  # a signal this short is a flag, a state or a counter: any other value of it is another word
ECHO: Final = "HANDSHAKE"  # follows the VCU, so it may well change and change back
BEFORE: Final = 300  # frames: after a longer pause than these take, a sender that catches up may contradict itself
AHEAD_NS: Final = 5 * PERIOD_NS
TOGETHER_NS: Final = 500 * MS


@dataclass(frozen=True, slots=True)
class SecondSender:
    """Frames on the AI computer's ids, or on the VCU's, which one sender cannot all have sent."""

    can_ids: tuple[int, ...]
    begin_ns: int
    end_ns: int
    proof: str
    payloads: tuple[bytes, ...] = ()  # of the first contradiction: the frame before, and the one that contradicts it

    @property
    def words(self) -> str:
        """Proof of the second sender, with the ids."""
        ids = ", ".join(f"0x{can_id:03X}" for can_id in self.can_ids)
        which = f" ({', then '.join(payload.hex().upper() for payload in self.payloads)})" if self.payloads else ""
        return f"{ids}: {self.proof}{which}"

    @property
    def sentence(self) -> str:
        does = "sends the car's messages" if self.can_ids[0] in VCU_IDS else "uses the AI computer's ids"
        return f"a second sender {does}: {self.words}"


def second_senders(frames: Frames, databases: Databases) -> list[SecondSender]:
    """Every stretch with a second sender in a log of one bus, in the order of time. `t_ns` must not go backwards."""
    found = [one for can_id in AI_IDS for one in _of_id(frames, can_id, databases.layouts.get(can_id))]
    return _joined(found)


def second_cars(times: Mapping[int, Ints]) -> list[SecondSender]:
    """Every stretch in which more of the VCU's messages come than one VCU sends; `times` of each, in order."""
    found: list[SecondSender] = []
    for can_id, t_ns in times.items():
        many = _too_many(t_ns, SHORT_NS, SHORT_EXCESS, PERIOD_NS, LONG_EXCESS) if len(t_ns) > 1 else t_ns > t_ns
        for part in _together(t_ns, np.flatnonzero(many)):
            proof = f"{_rate(t_ns, part):.0f} frames a second"
            found.append(SecondSender((can_id,), int(t_ns[part[0]]), int(t_ns[part[-1]]), proof))
    sends = f"but one car sends {S // PERIOD_NS}"
    return [
        replace(one, proof=f"{one.proof} for {(one.end_ns - one.begin_ns) / S:.1f} s, {sends}")
        for one in _joined(found)
    ]


def _joined(found: list[SecondSender]) -> list[SecondSender]:
    """Join those of the same time, and return them in the order of time."""
    joined: list[SecondSender] = []
    for one in sorted(found, key=lambda one: one.begin_ns):
        last = joined[-1] if joined else None
        if last is None or one.begin_ns - last.end_ns > TOGETHER_NS:
            joined.append(one)
            continue
        joined[-1] = replace(
            last,
            can_ids=tuple(sorted({*last.can_ids, *one.can_ids})),
            end_ns=max(last.end_ns, one.end_ns),
            payloads=last.payloads or one.payloads,
        )
    return joined


def _of_id(frames: Frames, can_id: int, layout: MessageLayout | None) -> list[SecondSender]:
    """Find stretches in which more than one sender used an identifier."""
    rows = np.flatnonzero(frames.can_id == can_id)
    rows = rows[(frames.flags[rows] | RECEIVED | SENT) == RECEIVED | SENT]
    if len(rows) < 2 or frames.t_ns[rows[0]] == frames.t_ns[rows[-1]]:
        return []
    flags = frames.flags[rows]
    t_ns = frames.t_ns[rows]
    if (flags & SENT).any() and (flags & RECEIVED).any():
        ours = int(((flags & SENT) != 0).sum())
        proof = f"received, not sent, by the computer that wrote this log, beside {ours} of its own"
        return _stretches(frames, rows, (flags & RECEIVED) != 0, proof)
    many = _too_many(t_ns, SHORT_NS, SHORT_EXCESS, PERIOD_NS, LONG_EXCESS)
    if not many.any():
        contradicting = _contradicting(frames, rows, layout)
        if contradicting.any():
            proof = "a frame comes between two others and says something else than both"
            return _stretches(frames, rows, contradicting, proof, payloads=True)
        # A second sender may send less often: count by the message's real period, for a little fast is not two.
        period_ns = min(PERIOD_NS, _period_ns(t_ns))
        many = _too_many(t_ns, SLOW_NS, SLOW_EXCESS, period_ns)
        if many.any():  # the windows begin before it and end after it
            many &= _around(t_ns) >= (1.0 + SLOW_EXCESS) / 2 * LONG_NS / period_ns
    if not many.any():
        return []
    proof = f"{_rate(t_ns, many):.0f} frames a second, but one sender sends {S // PERIOD_NS}"
    # The windows begin before it does: with it there are frames closer to the next one than one sender's.
    close = np.append(np.diff(t_ns) < CLOSE * PERIOD_NS, False)
    return [_begun(one, t_ns[close]) for one in _stretches(frames, rows, many, proof)]


def _begun(one: SecondSender, close_ns: Ints) -> SecondSender:
    """Return the same second sender from the first of these times in it on."""
    first_ns = int(np.append(close_ns, NEVER_NS)[np.searchsorted(close_ns, one.begin_ns)])
    return replace(one, begin_ns=first_ns) if first_ns <= one.end_ns else one


def batched(t_ns: Ints) -> bool:
    """Return true where an adapter handed these frames of one message over together.

    Their stamps are then not the times at which they were sent.
    """
    return bool((np.diff(t_ns) < MS).mean() > _BATCHED_SHARE) if len(t_ns) > 1 else False


def _around(t_ns: Ints) -> Ints:
    """Count the frames in the second around the short window that begins with each."""
    middle = t_ns + SHORT_NS // 2
    return np.searchsorted(t_ns, middle + LONG_NS // 2) - np.searchsorted(t_ns, middle - LONG_NS // 2)


def _rate(t_ns: Ints, many: Mask | Ints) -> float:
    """Frames a second where there are too many; at the edges of such a stretch there are fewer."""
    return float(np.percentile(_around(t_ns)[many], 75))


def _too_many(t_ns: Ints, window_ns: int, excess: float, period_ns: float, around: float = 0.0) -> Mask:
    """Select frames within windows in which `excess` times as many come as the period allows.

    That is too many even for a sender that catches up; in the second around them come `around` times as many.
    """
    count = len(t_ns)
    least = math.ceil(excess * window_ns / period_ns)
    hits = np.flatnonzero(t_ns[least - 1 :] < t_ns[: max(count - least + 1, 0)] + window_ns)
    if around and len(hits):
        hits = hits[_around(t_ns)[hits] >= around * LONG_NS / period_ns]
    if not len(hits):
        return np.zeros(count, np.bool_)
    # Frames that were held back, however long, bring one sender no further ahead of its period than it ever was; and
    # those of one instant, with which a log may begin, are an adapter's.
    ahead_ns = np.arange(count) * period_ns - (t_ns - t_ns[0])
    ends = np.searchsorted(t_ns, t_ns[hits] + window_ns)
    at_once = np.searchsorted(t_ns, t_ns[hits], "right") - 1
    far = ahead_ns[ends - 1] - np.maximum.accumulate(ahead_ns)[at_once] >= AHEAD_NS
    begun, ended = (np.bincount(places[far], minlength=count + 1) for places in (hits, ends))
    within: Mask = np.cumsum(begun - ended)[:-1] > 0
    return within


def _period_ns(t_ns: Ints) -> float:
    """The period of most of a message's frames, in the mean over a second; the expected one where there are too few."""
    every = round(LONG_NS / PERIOD_NS)
    return float(np.median(np.diff(t_ns[::every]))) / every if len(t_ns) > 2 * every else float(PERIOD_NS)


def _contradicting(frames: Frames, rows: Ints, layout: MessageLayout | None) -> Mask:
    """Frames that are far from both neighbours while these agree, and for which there was no room."""
    t_ns, count = frames.t_ns[rows], len(rows)
    hits = np.zeros(count, np.bool_)
    signals = [signal for signal in layout.signals if signal.name != ECHO] if layout and layout.plain else []
    if count < 2 * AROUND + 1 or not signals:
        return hits
    steps = [1 if signal.length > FEW_BITS else APART for signal in signals]
    raw = [raw_of(signal, frames.word[rows]).astype(np.int64) for signal in signals]
    values = np.stack([step * column for step, column in zip(steps, raw, strict=True)])
    change = np.abs(values[:, 1:] - values[:, :-1]).max(axis=0)
    across = np.abs(values[:, 2:] - values[:, :-2]).max(axis=0)
    hits[1:-1] = np.minimum(change[:-1], change[1:]) > 3 * across + APART - 1
    if not hits.any():
        return hits
    if batched(t_ns):
        places = np.flatnonzero(hits)
        near = [(np.abs(t_ns[places] - t_ns[place]) < LONG_NS).sum() for place in places]
        alone = np.array(near, np.int64) < REPEATED
        hits[places[alone]] = False
        return hits
    # One too many here, and not made up for by a pause before: by the period that the sender really has.
    index = np.arange(count)
    ahead_ns = index * _period_ns(t_ns) - (t_ns - t_ns[0])
    low, high = np.maximum(index - AROUND, 1), np.minimum(index + AROUND, count - 1)
    hits &= ahead_ns[high] - _most_before(ahead_ns)[low] >= EXTRA_NS
    return hits


def _most_before(values: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """The greatest of the BEFORE values before each: of one block's end and of the beginning of the next."""
    count = len(values)
    blocks = np.full((count // BEFORE + 2, BEFORE), -np.inf)
    blocks.ravel()[BEFORE : BEFORE + count] = values
    begins, ends = np.maximum.accumulate(blocks, axis=1), np.maximum.accumulate(blocks[:, ::-1], axis=1)[:, ::-1]
    return np.maximum(ends.ravel()[:count], begins.ravel()[BEFORE - 1 : BEFORE - 1 + count])


def _stretches(frames: Frames, rows: Ints, hits: Mask, proof: str, *, payloads: bool = False) -> list[SecondSender]:
    t_ns = frames.t_ns[rows]
    can_id = int(frames.can_id[rows[0]])
    return [
        SecondSender(
            (can_id,),
            int(t_ns[part[0]]),
            int(t_ns[part[-1]]),
            proof,
            tuple(frames.payload(int(rows[place])) for place in (part[0] - 1, part[0])) if payloads else (),
        )
        for part in _together(t_ns, np.flatnonzero(hits))
    ]


def _together(t_ns: Ints, places: Ints) -> list[Ints]:
    """The places in parts with pauses between them."""
    if not len(places):
        return []
    parts: list[Ints] = np.split(places, np.flatnonzero(np.diff(t_ns[places]) > TOGETHER_NS) + 1)
    return parts
