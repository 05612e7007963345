"""Figures of what a bus did. The verdict says whether that is as it should be (verdict/of_bus.py)."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, is_dataclass, replace
from enum import Enum
from itertools import pairwise
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from msgspec import structs

from fsai_vcu.diagnostics.decode.decoder import Decoder, MessageTable
from fsai_vcu.diagnostics.decode.error_frames import error_words
from fsai_vcu.diagnostics.decode.layouts import EXTENDED_KEY, MessageLayout
from fsai_vcu.diagnostics.log.frames import ERROR, EXTENDED, REMOTE, SENT, Frames, Ints, set_right
from fsai_vcu.diagnostics.statistics.echoes import EchoFault, echoes_of
from fsai_vcu.diagnostics.statistics.quantiles import quantile
from fsai_vcu.diagnostics.statistics.wire_bits import AT_ONCE, Halves, wire_bits
from fsai_vcu.interface.bus_table import BY_ID
from fsai_vcu.interface.specification import COMMS_LOST_NS
from fsai_vcu.interface.units import MS, S
from fsai_vcu.interface.values import Value

BITRATE: Final = 500_000  # interface specification v4.0: 500 kbit/s
NEVER_NS: Final = np.iinfo(np.int64).max
LOAD_WINDOW_NS: Final = 100 * MS

MISSING_PERIODS: Final = 1.8  # an interval from here on lacks at least one frame
_LOST_PERIODS = 10  # interface specification v4.0: ten in a row are a loss; used where the bus table names no timeout
_FROZEN_COUNTS_NS = S
_STATUS, _WHEELS = {"VCU2AI_Status", "AI2VCU_Status"}, {"VCU2AI_Speeds", "VCU2AI_Wheel_counts"}
_TURNING_RPM = 30  # a wheel as fast as this passes several teeth of its sensor in a second


def as_json(value: Any, digits: int) -> Any:
    """Values, tuples, words and bytes as JSON types; numbers with so many decimals, None where not finite."""
    if isinstance(value, float):
        return round(value, digits) if math.isfinite(value) else None
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, bytes):
        return value.hex()
    if isinstance(value, Mapping):
        return {name: as_json(each, digits) for name, each in value.items()}
    if isinstance(value, list | tuple):
        return [as_json(each, digits) for each in value]
    if isinstance(value, Value):
        return as_json(structs.asdict(value), digits)
    return as_json(asdict(value), digits) if is_dataclass(value) else value  # type: ignore[arg-type]


def keys_of(frames: Frames) -> npt.NDArray[np.int32]:
    """The key of each frame's message (layouts.EXTENDED_KEY); -1 for error frames."""
    keys = frames.can_id.astype(np.int32)
    keys[(frames.flags & EXTENDED) != 0] |= EXTENDED_KEY
    keys[(frames.flags & ERROR) != 0] = -1
    return keys


@dataclass(frozen=True, slots=True)
class TimeSpread:
    """A distribution of times in ms; None while there are none."""

    p50_ms: float | None
    p99_ms: float | None
    max_ms: float | None

    @classmethod
    def of(cls, ordered: Ints) -> TimeSpread:
        """Return the spread of times in ns, in ascending order."""
        found = [quantile(ordered, share) for share in (0.5, 0.99, 1.0)]  # type: ignore[arg-type]
        return cls(*(None if time_ns is None else time_ns / MS for time_ns in found))


@dataclass(frozen=True, slots=True)
class MessageStatistics:
    """One identifier. Times in ms, those of day in s of the log's clock, as if it had never been set back.

    jitter: by how much intervals miss the expected period (the median, where none is expected). gaps: intervals in
    which at least one frame is missing. lost: the frames that are, but for those of pauses (from ten periods on).
    frozen_ms: the longest time for which the payload stayed the same.
    """

    can_id: int
    extended: bool
    name: str | None
    count: int
    first_s: float
    last_s: float
    expected_length: int | None
    wrong_lengths: Mapping[int, int]
    wrong_length_at_s: float | None  # of the first
    remote: int
    remote_at_s: float | None  # of the first
    sent: int
    sent_at_s: float | None
    expected_ms: float | None
    interval_ms: TimeSpread
    mean_ms: float | None
    jitter_ms: TimeSpread
    gaps: int
    lost: int
    longest_gap_ms: float | None
    longest_gap_at_s: float | None
    silent_ms: float  # from its last frame to the bus's last one
    frozen_ms: float
    payloads: int
    bits: int
    load: float

    def as_dict(self) -> dict[str, Any]:
        names = {"can_id": "id", "name": "message"}
        return {"type": "message", **{names.get(name, name): value for name, value in as_json(self, 6).items()}}


@dataclass(frozen=True, slots=True)
class Handshake:
    """The AI computer's answers to the VCU: from a 0x520 with a new HANDSHAKE to the first 0x510 with that bit."""

    answered: int
    unanswered: int  # toggles whose bit did not come back for 100 ms
    response_ms: TimeSpread
    above_100_ms: int  # answers that took as long, or longer
    missed_at_s: float | None  # the first toggle of either kind
    missed_s: tuple[float, ...]  # and each of them
    echoes: int  # 0x510 that were held against the bit of the last 0x520
    wrong: int  # of them, those with another bit
    fault: EchoFault | None  # what that is, where it is nearly always so


@dataclass(frozen=True, slots=True)
class BusStatistics:
    """One channel."""

    channel: str
    frames: int
    duration_s: float
    messages: tuple[MessageStatistics, ...]
    missing: tuple[MessageLayout, ...]  # described with a period, and not received
    error_frames: Mapping[str, int]
    load: float
    peak_load: float
    bitrate: int
    handshake: Handshake | None
    frozen_counts: tuple[tuple[str, float, float], ...]  # (signal, since s, for s) while its wheel turned
    backwards: int  # frames with a time before that of their predecessor
    backwards_at_s: float | None  # the first

    def without(self, keys: frozenset[int]) -> BusStatistics:
        """The same where the messages of these keys are not missing: they were left out."""
        kept = (one for one in self.missing if (one.can_id | EXTENDED_KEY * one.extended) not in keys)
        return replace(self, missing=tuple(kept))

    def as_dict(self) -> dict[str, Any]:
        names = ("channel", "frames", "duration_s", "load", "peak_load", "bitrate", "error_frames", "handshake")
        found = as_json({name: getattr(self, name) for name in names}, 6)
        missing = [layout.name for layout in self.missing]
        back = {"backwards": self.backwards, "backwards_at_s": as_json(self.backwards_at_s, 6)}
        return {"type": "bus", **found, "missing": missing, **back}


# ---------------------------------------------------------------- measuring


def measure(
    frames: Frames,
    decoder: Decoder,
    *,
    revision: str | None,
    bitrate: int | None = None,
    off_ns: Sequence[tuple[int, int]] = (),
) -> list[BusStatistics]:
    """Figures of each channel in the log, in order of first appearance.

    revision: whose periods of the bus table count for its messages; None: only those of the databases. off_ns: (from,
    to) while the car was switched off: an interval with a part of that in it is none of a message.
    """
    found = []
    for index in np.flatnonzero(np.bincount(frames.channel)).tolist():
        of_channel = frames.only(frames.channel == index)
        rate = bitrate or decoder.databases.baudrate or BITRATE
        found.append(_measure_channel(of_channel, frames.channels[index], decoder, revision, rate, off_ns))
    return found


def _measure_channel(
    frames: Frames,
    channel: str,
    decoder: Decoder,
    revision: str | None,
    bitrate: int,
    off_ns: Sequence[tuple[int, int]],
) -> BusStatistics:
    """Measure one channel of a log."""
    backwards, backwards_at_s = 0, None
    if (frames.t_ns[1:] < frames.t_ns[:-1]).any():
        back = np.flatnonzero(frames.t_ns[1:] < frames.t_ns[:-1] - MS)  # less is two frames stamped on two processors
        frames = frames.at(set_right(frames.t_ns)[0])
        if len(back):
            backwards, backwards_at_s = len(back), int(frames.t_ns[back[0]]) / S
        frames = frames.only(np.argsort(frames.t_ns, kind="stable"))
    errors = (frames.flags & ERROR) != 0
    words: Counter[str] = Counter()
    for row in np.flatnonzero(errors).tolist():
        words[", ".join(error_words(int(frames.can_id[row]), frames.payload(row)))] += 1
    layouts = decoder.databases.layouts
    bits = np.zeros(len(frames), np.uint16)
    bus_ns = (int(frames.t_ns[0]), int(frames.t_ns[-1])) if len(frames) else (0, 0)

    def measured(part: tuple[Ints, int, Frames]) -> MessageStatistics:
        rows, key, of_message = part
        bits[rows] = its_bits = wire_bits(of_message)
        layout = layouts.get(key)
        expected_ns = expected_period_ns(key, layout, revision)
        return _measure_message(of_message, its_bits, layout, expected_ns, bus_ns, bitrate, off_ns)

    parts = list(_by_message(frames))
    with ThreadPoolExecutor() as pool:  # most of it is sorting, which needs no lock of the interpreter
        messages = dict(zip((key for _, key, _ in parts), pool.map(measured, parts), strict=True))
    compared = [rows for rows, key, _ in parts if key in layouts and layouts[key].name in _STATUS | _WHEELS]
    duration_ns = bus_ns[1] - bus_ns[0]
    few = frames.only(np.sort(np.concatenate([np.zeros(0, np.int64), *compared])))
    described = {} if layouts.keys().isdisjoint(messages) else layouts
    silent = {key: layout for key, layout in described.items() if key not in messages}
    return BusStatistics(
        channel=channel,
        frames=len(frames),
        duration_s=duration_ns / S,
        messages=tuple(messages.values()),
        missing=tuple(layout for key, layout in silent.items() if expected_period_ns(key, layout, revision)),
        error_frames=dict(words),
        load=share(bits, duration_ns, bitrate),
        peak_load=_peak_load(frames.t_ns, bits, bitrate),
        bitrate=bitrate,
        handshake=handshake_of(few, decoder, off_ns),
        frozen_counts=tuple(_frozen_counts(decoder.tables(few, _WHEELS))),
        backwards=backwards,
        backwards_at_s=backwards_at_s,
    )


def _by_message(frames: Frames) -> Iterator[tuple[Ints, int, Frames]]:
    """(rows, key, the frames there) of each message of one bus; of no error frame."""
    keys = keys_of(frames)
    few_bits = np.uint16 if keys.max(initial=0) < (1 << 16) - 1 else np.int32  # which are sorted quicker
    order = np.argsort((keys + 1).astype(few_bits), kind="stable")
    order = order[np.count_nonzero(keys < 0) :]
    keys = keys[order]
    # One column after the other: each fits a processor's cache, and all of them do not.
    t_ns, word = np.take(frames.t_ns, order), np.take(frames.word, order)
    flags, length = np.take(frames.flags, order), np.take(frames.length, order)
    begins = _runs(keys)
    for begin, end in pairwise([*begins.tolist(), len(keys)]):
        key, part = int(keys[begin]), slice(begin, end)
        can_id = np.full(end - begin, key & ~EXTENDED_KEY, np.uint32)
        channel = frames.channel[: end - begin]
        yield order[part], key, Frames(t_ns[part], can_id, flags[part], length[part], word[part], channel)


def expected_period_ns(key: int, layout: MessageLayout | None, revision: str | None) -> int | None:
    """Return the period from the bus table where the message is one of its, else from the database."""
    own = BY_ID.get(key)
    if own is not None and layout is not None and own.name == layout.name and revision is not None:
        return own.period_ns.get(revision)
    return layout.period_ms * MS if layout is not None and layout.period_ms else None


def _measure_message(
    frames: Frames,
    bits: Halves,
    layout: MessageLayout | None,
    expected_ns: int | None,
    bus_ns: tuple[int, int],
    bitrate: int,
    off_ns: Sequence[tuple[int, int]],
) -> MessageStatistics:
    """Measure the frames of one message, on a bus whose first and last frame came at these times."""
    t_ns, word, length, flags = frames.t_ns, frames.word, frames.length, frames.flags
    duration_ns = bus_ns[1] - bus_ns[0]
    words = np.sort(word)
    intervals, begins = np.diff(t_ns), t_ns[:-1]
    for since_ns, until_ns in off_ns:
        on = (begins + intervals <= since_ns) | (begins >= until_ns)
        intervals, begins = intervals[on], begins[on]
    ordered = np.sort(intervals)
    typical_ns = expected_ns or quantile(ordered, 0.5) or 0  # type: ignore[arg-type]
    timed = duration_ns > 0 and typical_ns > 0
    remote, sent = (flags & REMOTE) != 0, (flags & SENT) != 0
    no_pauses = ordered[: np.searchsorted(ordered, _LOST_PERIODS * typical_ns)]
    missing = math.floor(MISSING_PERIODS * typical_ns)
    strange: Ints | list[int] = np.flatnonzero((length != layout.length) & ~remote) if layout is not None else []
    lengths, counts = np.unique(length[strange], return_counts=True)
    longest = int(np.argmax(intervals)) if timed and len(intervals) else None
    return MessageStatistics(
        can_id=int(frames.can_id[0]),
        extended=bool(flags[0] & EXTENDED),
        name=layout.name if layout else None,
        count=len(frames),
        first_s=int(t_ns[0]) / S,
        last_s=int(t_ns[-1]) / S,
        expected_length=layout.length if layout else None,
        wrong_lengths=dict(zip(lengths.tolist(), counts.tolist(), strict=True)),
        wrong_length_at_s=int(t_ns[strange[0]]) / S if len(strange) else None,
        remote=int(remote.sum()),
        remote_at_s=int(t_ns[remote.argmax()]) / S if remote.any() else None,
        sent=int(sent.sum()),
        sent_at_s=int(t_ns[sent.argmax()]) / S if sent.any() else None,
        expected_ms=expected_ns / MS if expected_ns else None,
        interval_ms=TimeSpread.of(ordered if timed else ordered[:0]),
        mean_ms=float(intervals.mean()) / MS if timed and len(intervals) else None,
        # One run falls and one rises: "stable" only merges them.
        jitter_ms=TimeSpread.of(np.sort(np.abs(ordered - typical_ns), kind="stable") if timed else ordered[:0]),
        gaps=len(ordered) - int(np.searchsorted(ordered, missing, side="right")) if timed else 0,
        lost=max(0, round(int(no_pauses.sum()) / typical_ns) - len(no_pauses)) if timed else 0,
        longest_gap_ms=None if longest is None else int(intervals[longest]) / MS,
        longest_gap_at_s=None if longest is None else int(begins[longest]) / S,
        silent_ms=(bus_ns[1] - int(t_ns[-1])) / MS,
        frozen_ms=_longest_same(t_ns, word, length)[1] / MS,
        payloads=1 + int(np.count_nonzero(words[1:] != words[:-1])),
        bits=int(bits.sum()),
        load=share(bits, duration_ns, bitrate),
    )


def _runs(*columns: npt.NDArray[Any]) -> Ints:
    """Return where each run of rows begins in which all columns stay as they are."""
    changed = np.ones(len(columns[0]), np.bool_)
    changed[1:] = np.logical_or.reduce([column[1:] != column[:-1] for column in columns])
    return np.flatnonzero(changed)


def _longest_same(t_ns: Ints, *columns: Any) -> tuple[int, int]:
    """(since when, for how long) all columns together stayed as they were, at the longest."""
    if not len(t_ns):
        return 0, 0
    begins = _runs(*columns)
    ends = np.append(begins[1:] - 1, len(t_ns) - 1)
    lasted = t_ns[ends] - t_ns[begins]
    longest = int(np.argmax(lasted))
    return int(t_ns[begins[longest]]), int(lasted[longest])


def share(bits: Halves, duration_ns: int, bitrate: int) -> float:
    """Return the share of that time that the bits take on the wire."""
    return int(bits.sum()) / (bitrate * duration_ns / S) if duration_ns > 0 else 0.0


def _peak_load(t_ns: Ints, bits: Halves, bitrate: int) -> float:
    """Return the load in the busiest 100 ms; of a shorter log, as if it had lasted that long. `t_ns` must not go
    backwards.
    """
    if not len(t_ns):
        return 0.0
    parts = []
    for begin in range(0, len(t_ns), AT_ONCE):
        windows = (t_ns[begin : begin + AT_ONCE] - t_ns[0]) // LOAD_WINDOW_NS
        begins = _runs(windows)
        parts.append((windows[begins], np.add.reduceat(bits[begin : begin + AT_ONCE], begins, dtype=np.int64)))
    numbers, sums = map(np.concatenate, zip(*parts, strict=True))
    return float(np.add.reduceat(sums, _runs(numbers)).max()) / (bitrate * LOAD_WINDOW_NS / S)


def first_echoes(toggle_ns: Ints, bits: Ints, echo_ns: Ints, echo_bits: npt.NDArray[Any]) -> Ints:
    """Return when each bit was first sent back from its toggle on; NEVER_NS where it was not."""
    first_ns = np.full(len(toggle_ns), NEVER_NS)
    for bit in (0, 1):
        times = np.append(echo_ns[echo_bits == bit], NEVER_NS)
        first_ns[bits == bit] = times[np.searchsorted(times, toggle_ns[bits == bit])]
    return first_ns


def handshake_of(frames: Frames, decoder: Decoder, off_ns: Sequence[tuple[int, int]] = ()) -> Handshake | None:
    """Measure the answers to HANDSHAKE in frames of one bus, whose times must not go backwards.

    Returns None where one of the two has no HANDSHAKE there. off_ns: while the car was switched off; the last toggle
    before is owed no answer.
    """
    tables = decoder.tables(frames, _STATUS)
    both = [tables[name].series.get("HANDSHAKE") for name in ("VCU2AI_Status", "AI2VCU_Status") if name in tables]
    bits = [(series.t_ns, series.raw) for series in both if series is not None and len(series.t_ns)]
    if len(bits) < 2:
        return None
    (asked_ns, asked_bits), (answer_ns, answer_bits) = bits
    # The very first bit asks for an answer too. Where no 0x510 came for 100 ms there is nobody who could give one.
    toggles = np.append(0, np.flatnonzero(asked_bits[1:] != asked_bits[:-1]) + 1)
    next_ns = np.append(asked_ns[toggles[1:]], NEVER_NS)
    before = np.searchsorted(answer_ns, asked_ns[toggles], side="right") - 1
    alive = (before >= 0) & (asked_ns[toggles] - answer_ns[np.maximum(before, 0)] < COMMS_LOST_NS)
    for since_ns, until_ns in off_ns:
        alive &= (asked_ns[toggles] < since_ns - COMMS_LOST_NS) | (asked_ns[toggles] >= until_ns)
    spoken = np.searchsorted(answer_ns, asked_ns[toggles] + COMMS_LOST_NS) - np.maximum(before + 1, 0)
    alive &= (spoken > 0) | (asked_ns[toggles] + COMMS_LOST_NS > asked_ns[-1])  # who falls silent misses no echo
    toggles, next_ns = toggles[alive], next_ns[alive]
    toggle_ns, toggle_bits = asked_ns[toggles], asked_bits[toggles]
    first_ns = first_echoes(toggle_ns, toggle_bits, answer_ns, answer_bits)
    in_time = first_ns < next_ns
    if 2 * in_time.sum() < len(in_time):
        # Echoes a cycle late come when a VCU that does not wait for them has toggled again. Where most come at once,
        # such a one is rather that of the toggle after next, and its own was lost.
        in_time |= first_ns - toggle_ns < COMMS_LOST_NS
    waited = (first_ns - toggle_ns)[in_time]
    # Before that, or before the log's end, an echo that is not there may come, or be a frame that the recording lost.
    unanswered = ~in_time & (np.minimum(first_ns, asked_ns[-1]) - toggle_ns >= COMMS_LOST_NS)
    late = in_time & (first_ns - toggle_ns >= COMMS_LOST_NS)
    missed_ns = toggle_ns[unanswered | late]
    missed_s = tuple(int(t_ns) / S for t_ns in missed_ns)
    echoes = echoes_of(asked_ns, asked_bits, answer_ns, answer_bits)
    return Handshake(
        len(waited),
        int(unanswered.sum()),
        TimeSpread.of(np.sort(waited)),
        int(late.sum()),
        missed_s[0] if missed_s else None,
        missed_s,
        echoes.judged,
        echoes.wrong,
        echoes.fault,
    )


def _frozen_counts(tables: Mapping[str, MessageTable]) -> Iterator[tuple[str, float, float]]:
    """Pulse counters that stood while, by the wheel speeds, the wheel turned, and others with it.

    Where the others rest, it is rather the speed that is wrong.
    """
    if len(tables) < 2:
        return
    speeds, counts = tables["VCU2AI_Speeds"], tables["VCU2AI_Wheel_counts"]
    each = [speeds.series.get(f"{wheel}_WHEEL_SPEED") for wheel in ("FL", "FR", "RL", "RR")]
    known_speeds = [one.values for one in each if one is not None and len(one.t_ns)]
    middle = np.median(known_speeds, axis=0) if known_speeds else np.zeros(0)
    for wheel in ("FL", "FR", "RL", "RR"):
        speed, count = speeds.series.get(f"{wheel}_WHEEL_SPEED"), counts.series.get(f"{wheel}_PULSE_COUNT")
        if speed is None or count is None or not len(speed.t_ns) or not len(count.t_ns):
            continue
        last = np.searchsorted(speed.t_ns, count.t_ns, side="right") - 1
        known = (last >= 0) & (count.t_ns - speed.t_ns[np.maximum(last, 0)] < COMMS_LOST_NS)
        turning = known & (np.minimum(speed.values, middle)[np.maximum(last, 0)] >= _TURNING_RPM)
        # A wheel at rest breaks the run: while it rests, each frame counts as a change.
        since_ns, lasted_ns = _longest_same(
            count.t_ns, count.values, np.where(turning, -1, np.arange(len(turning), dtype=np.int64))
        )
        if lasted_ns >= _FROZEN_COUNTS_NS:
            yield count.name, since_ns / S, lasted_ns / S
