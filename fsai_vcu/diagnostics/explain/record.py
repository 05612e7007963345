"""A log as a story reads it: signals over time, gaps, the handshake, and who else was on the bus.

Everything here comes from the frames alone, of both directions. Times are nanoseconds of the log's clock, made
monotonic: where that clock was set back, what follows is moved forward by as much.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from fsai_vcu.diagnostics.decode.databases import Databases, load_databases
from fsai_vcu.diagnostics.decode.decoder import Decoder, MessageTable
from fsai_vcu.diagnostics.explain.incident import ChainLink
from fsai_vcu.diagnostics.log.frames import ERROR, Frames, Ints
from fsai_vcu.diagnostics.statistics.senders import SecondSender, second_senders
from fsai_vcu.interface.bus_table import BY_ID, BY_NAME, Flow
from fsai_vcu.interface.reserved import AI_IDS
from fsai_vcu.interface.revisions import Revision
from fsai_vcu.interface.specification import COMMS_LOST_NS
from fsai_vcu.interface.units import MS, S

Values = npt.NDArray[np.float64]

DEAD_NS: Final = 50 * MS  # five cycles of everybody
DEAD_SHARE: Final = 0.8
_NAME_TAILS: Final = ("", "_Nm")  # 2026 names in 0x522 carry the unit


def ms(length_ns: int) -> str:
    """A length of time as people read it."""
    if length_ns < S:
        return f"{length_ns / MS:.0f} ms" if length_ns >= 10 * MS else f"{length_ns / MS:.1f} ms"
    return f"{length_ns / S:.2f} s"


class Signal(NamedTuple):
    """A signal by the names of the databases."""

    message: str
    name: str

    @property
    def can_id(self) -> int:
        return BY_NAME[self.message].can_id

    def step(self, t_ns: int, words: str) -> ChainLink:
        """A link of a cause chain which a frame with this signal shows."""
        return ChainLink(t_ns, words, self.can_id, self.name)


@dataclass(frozen=True)
class Span:
    """A value that held from `begin_ns` until the frame at `end_ns` said another, or until the last frame."""

    begin_ns: int
    end_ns: int
    value: float
    before: float | None = None  # None: the first value of the log


@dataclass(frozen=True)
class Series:
    """One signal over time, a value for each frame that carried it."""

    t_ns: Ints
    values: Values

    def __len__(self) -> int:
        return len(self.t_ns)

    def at(self, t_ns: int) -> float | None:
        """The newest value at `t_ns`; None before the first frame."""
        place = int(np.searchsorted(self.t_ns, t_ns, side="right")) - 1
        return float(self.values[place]) if place >= 0 else None

    @cached_property
    def spans(self) -> Sequence[Span]:
        """What was sent, change by change."""
        if not len(self.t_ns):
            return ()
        starts = np.concatenate(([0], np.flatnonzero(np.diff(self.values)) + 1))
        begins, values = self.t_ns[starts].tolist(), self.values[starts].tolist()
        ends, before = [*begins[1:], int(self.t_ns[-1])], [None, *values[:-1]]
        return tuple(map(Span, begins, ends, values, before))

    def span_at(self, t_ns: int) -> Span | None:
        """The span in force at `t_ns`."""
        return next((span for span in reversed(self.spans) if span.begin_ns <= t_ns), None)

    def changes(self, begin_ns: int, end_ns: int) -> list[Span]:
        """Spans that begin with a change (not with the log) from `begin_ns` up to and including `end_ns`."""
        return [s for s in self.spans if s.before is not None and begin_ns <= s.begin_ns <= end_ns]

    def between(self, begin_ns: int, end_ns: int) -> Series:
        """The part from `begin_ns` up to and including `end_ns`."""
        low, high = np.searchsorted(self.t_ns, (begin_ns, end_ns + 1))
        return Series(self.t_ns[low:high], self.values[low:high])


NOTHING: Final = Series(np.zeros(0, np.int64), np.zeros(0))


@dataclass(frozen=True)
class Gap:
    """A message that did not come. `end_ns` None: it never came back in this log."""

    can_id: int
    begin_ns: int  # its last frame before
    end_ns: int | None
    length_ns: int

    @property
    def over_ns(self) -> int:
        """When it ended, or the log did."""
        return self.begin_ns + self.length_ns

    def words(self) -> str:
        """How long it lasted."""
        return f"to the end of the log ({ms(self.length_ns)})" if self.end_ns is None else f"for {ms(self.length_ns)}"


@dataclass(frozen=True)
class HandshakeToggle:
    """A toggle of the VCU's handshake and the AI computer's echo. `echo_ns` None: it never came."""

    toggle_ns: int
    bit: int
    echo_ns: int | None
    waited_ns: int

    @property
    def lost(self) -> bool:
        return self.waited_ns >= COMMS_LOST_NS


@dataclass
class Record:
    """The frames of one car's bus, by message and signal. Made by `record_of`."""

    revision: Revision
    revision_reason: str
    channel: str
    begin_ns: int
    end_ns: int
    frames: Frames = field(repr=False)  # of that bus, with the monotonic times
    decoder: Decoder = field(repr=False)
    error_ns: Ints = field(repr=False)
    set_back: Sequence[tuple[int, int]] = ()  # where the log's clock was set back, and by how much
    wrong_length: Mapping[int, tuple[int, int]] = field(default_factory=dict)  # id: how often, first time
    unknown_ids: Mapping[int, int] = field(default_factory=dict)
    other_channels: Mapping[str, int] = field(default_factory=dict)
    _rows: dict[int, Ints] = field(default_factory=dict, repr=False)  # by key, as in MessageLayout
    _tables: dict[str, MessageTable] = field(default_factory=dict, repr=False)
    _series: dict[Signal, Series] = field(default_factory=dict, repr=False)

    # ------------------------------------------------------------ signals

    def has(self, can_id: int) -> bool:
        """Whether the log has that message, whole."""
        return can_id in self._rows

    @property
    def ai_speaks(self) -> bool:
        """Whether the log has any whole message of the AI computer."""
        return any(map(self.has, AI_IDS))

    def times(self, can_id: int) -> Ints:
        """When that message came."""
        rows = self._rows.get(can_id)
        return NOTHING.t_ns if rows is None else self.frames.t_ns[rows]

    def series(self, signal: Signal) -> Series:
        """A signal in physical units; empty if the log or the database does not have it."""
        if signal not in self._series:
            self._series[signal] = self._read(signal)
        return self._series[signal]

    def _read(self, signal: Signal) -> Series:
        layout = self.decoder.databases.by_name(signal.message)
        rows = self._rows.get(layout.key) if layout is not None else None
        if layout is None or rows is None:
            return NOTHING
        if layout.name not in self._tables:
            self._tables[layout.name] = self.decoder.table(layout, self.frames, rows)
        named = self._tables[layout.name].series
        found = next((named[signal.name + tail] for tail in _NAME_TAILS if signal.name + tail in named), None)
        return NOTHING if found is None else Series(found.t_ns, found.values.astype(np.float64))

    def matching(self, patterns: Sequence[str]) -> dict[str, list[tuple[str, Series]]]:
        """By unit, (MESSAGE.NAME, series) of all signals in the log that a NAME or MESSAGE.NAME with * and ? means."""
        groups: dict[str, list[tuple[str, Series]]] = {}
        for layout in self.decoder.databases.layouts.values():
            for signal in layout.signals_like(patterns):
                series = self.series(Signal(layout.name, signal.name))
                if len(series):
                    groups.setdefault(signal.unit, []).append((f"{layout.name}.{signal.name}", series))
        return groups

    def at(self, signal: Signal, t_ns: int) -> float | None:
        """The signal's newest value at `t_ns`; None before its first frame."""
        return self.series(signal).at(t_ns)

    def span_at(self, signal: Signal, t_ns: int) -> Span | None:
        """The signal's value in force at `t_ns`, and since when."""
        return self.series(signal).span_at(t_ns)

    def changes(self, signal: Signal, begin_ns: int, end_ns: int, to: float | None = None) -> list[Span]:
        """The signal's changes (to a value, if one is named) from `begin_ns` up to and including `end_ns`."""
        return [s for s in self.series(signal).changes(begin_ns, end_ns) if to is None or s.value == to]

    def errors_before(self, t_ns: int, length_ns: int) -> list[int]:
        """The times of error frames in the `length_ns` up to `t_ns`."""
        found: list[int] = self.error_ns[(self.error_ns >= t_ns - length_ns) & (self.error_ns <= t_ns)].tolist()
        return found

    def fastest_wheel(self) -> Series:
        """The fastest of the four wheels, rpm."""
        key = Signal("VCU2AI_Speeds", "fastest")
        if key not in self._series:
            wheels = [self.series(Signal("VCU2AI_Speeds", f"{w}_WHEEL_SPEED")) for w in ("FL", "FR", "RL", "RR")]
            values = np.maximum.reduce([wheel.values for wheel in wheels])
            self._series[key] = Series(wheels[0].t_ns, values)
        return self._series[key]

    # ------------------------------------------------------------ the link

    def gaps(self, can_id: int, longest_ns: int) -> list[Gap]:
        """Where that message was missing for more than `longest_ns`, within the log and at its end."""
        times = self.times(can_id)
        waits = np.diff(np.append(times, self.end_ns))
        found = np.flatnonzero(waits > longest_ns).tolist() if len(times) else []
        ends = [int(times[place + 1]) if place + 1 < len(times) else None for place in found]
        return [Gap(can_id, int(times[p]), end, int(waits[p])) for p, end in zip(found, ends, strict=True)]

    @cached_property
    def silences(self) -> Sequence[tuple[int, int]]:
        """(from, to) where nobody at all was heard: the bus was dead, or the recording paused."""
        times = self.frames.t_ns
        return tuple((int(times[place]), int(times[place + 1])) for place in np.flatnonzero(np.diff(times) > DEAD_NS))

    def silence_in(self, gap: Gap) -> tuple[int, int] | None:
        """The silence of everybody that is nearly all of this gap of one message."""
        for begin_ns, end_ns in self.silences:
            if min(end_ns, gap.over_ns) - max(begin_ns, gap.begin_ns) > DEAD_SHARE * gap.length_ns:
                return begin_ns, end_ns
        return None

    @cached_property
    def answers(self) -> Sequence[HandshakeToggle]:
        """Every toggle of the VCU's handshake while the AI computer speaks, and its echo."""
        asked = self.series(Signal("VCU2AI_Status", "HANDSHAKE"))
        echo = self.series(Signal("AI2VCU_Status", "HANDSHAKE"))
        times = {bit: echo.t_ns[echo.values == bit] for bit in (0, 1)}
        found = []
        for span in asked.spans if len(echo) else ():
            if span.before is not None and span.begin_ns >= echo.t_ns[0]:
                bit = int(span.value)
                first = int(np.searchsorted(times[bit], span.begin_ns))
                echo_ns = int(times[bit][first]) if first < len(times[bit]) else None
                waited_ns = (self.end_ns if echo_ns is None else echo_ns) - span.begin_ns
                found.append(HandshakeToggle(span.begin_ns, bit, echo_ns, waited_ns))
        return tuple(found)

    @cached_property
    def second_senders(self) -> Sequence[SecondSender]:
        """Where somebody else sends on the AI computer's ids, in the order of time."""
        return second_senders(self.frames, self.decoder.databases)


def record_of(frames: Frames, revision: Revision, reason: str = "given", databases: Databases | None = None) -> Record:
    """Sort the frames of a log by message. Where it has several buses, the one with the car's messages counts.

    `databases` replaces the revision's own. Raises ValueError for a log without a frame.
    """
    if not len(frames):
        raise ValueError("there is no frame to tell about")
    chosen = _car_channel(frames)
    straight, set_back = _monotonic(frames.t_ns)
    bus = replace(frames, t_ns=straight).only(frames.channel == chosen)
    decoder = Decoder(databases or _own_databases(revision.name))
    rows_of: dict[int, Ints] = {}
    wrong: dict[int, tuple[int, int]] = {}
    unknown: Counter[int] = Counter()
    for layout, rows in decoder.by_message(bus):
        if layout is None:
            unknown.update(bus.can_id[rows].tolist())
            continue
        right = bus.length[rows] == layout.length
        if not right.all():
            strange = rows[~right]
            wrong[layout.can_id] = (len(strange), int(bus.t_ns[strange[0]]))
        if right.any():
            rows_of[layout.key] = rows[right]
    return Record(
        revision,
        reason,
        frames.channels[chosen],
        int(straight[0]),
        int(straight[-1]),
        bus,
        decoder,
        bus.t_ns[(bus.flags & ERROR) != 0],
        set_back,
        wrong,
        unknown,
        {
            name: int((frames.channel == number).sum())
            for number, name in enumerate(frames.channels)
            if number != chosen and (frames.channel == number).any()
        },
        rows_of,
    )


@cache
def _own_databases(revision: str) -> Databases:
    return load_databases(revision=revision)


def _car_channel(frames: Frames) -> int:
    """The bus on which most of the VCU's and the AI computer's messages are."""
    known = [can_id for can_id, message in BY_ID.items() if message.flow in (Flow.TO_VCU, Flow.FROM_VCU)]
    ours = frames.channel[np.isin(frames.can_id, known)]
    counted = ours if len(ours) else frames.channel
    return int(np.bincount(counted).argmax()) if len(counted) else 0


def _monotonic(t_ns: Ints) -> tuple[Ints, Sequence[tuple[int, int]]]:
    """The times with every step back taken out, and where the steps were."""
    steps = np.diff(t_ns)
    back = np.flatnonzero(steps < 0)
    if not len(back):
        return t_ns, ()
    moved = np.zeros(len(t_ns), np.int64)
    moved[back + 1] = -steps[back]
    straight = t_ns + np.cumsum(moved)
    return straight, tuple((int(straight[place + 1]), int(-steps[place])) for place in back)
