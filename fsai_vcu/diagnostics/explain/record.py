"""A log as explanations read it: signals over time, gaps, the handshake, and who else was on the bus.

Everything here comes from the frames alone, of both directions. Times are nanoseconds of the log's clock, made
monotonic: where that clock was set back, what follows is moved forward by as much. Where it was set forward, the judge
of the log has moved the frames (verdict/own_faults.py).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import chain, repeat
from typing import Final, NamedTuple, overload

import numpy as np
import numpy.typing as npt

from fsai_vcu.core.vehicle.parameters import CARS, VehicleParameters
from fsai_vcu.diagnostics.decode.databases import Databases, load_databases
from fsai_vcu.diagnostics.decode.decoder import Decoder, MessageTable, values_of
from fsai_vcu.diagnostics.decode.revision import guess_revision
from fsai_vcu.diagnostics.explain import signals as sig
from fsai_vcu.diagnostics.explain.signals import Signal
from fsai_vcu.diagnostics.log.frames import ERROR, Frames, Ints, Mask, straightened
from fsai_vcu.diagnostics.log.recorded import Recorded
from fsai_vcu.diagnostics.remedies import Setting
from fsai_vcu.diagnostics.statistics.measure import NEVER_NS, first_echoes
from fsai_vcu.diagnostics.statistics.senders import SecondSender, second_cars, second_senders
from fsai_vcu.interface.bus_table import BY_ID, Flow
from fsai_vcu.interface.enums import OFF_LIKE, AsState
from fsai_vcu.interface.reserved import AI_IDS, VCU_IDS
from fsai_vcu.interface.revisions import revision as revision_named
from fsai_vcu.interface.specification import COMMS_LOST_NS, PERIOD_NS
from fsai_vcu.interface.units import MS, S, ms

Values = npt.NDArray[np.float64]

GONE_NS: Final = 1 * S  # no 0x520 for so long: switched off
REBOOT_NS: Final = 3 * S  # a VCU that is back by then restarted by itself; after that it was switched off
DEAD_NS: Final = 50 * MS  # five cycles of everybody
DEAD_SHARE: Final = 0.8
_AT_ONCE: Final = 1000  # spans
_ENOUGH_OF_AI: Final = 250  # frames: half a second
_NAME_TAILS: Final = ("", "_Nm")  # 2026 names in 0x522 carry the unit


class Span(NamedTuple):
    """A value that held from `begin_ns` until the frame at `end_ns` had another, or until the last frame.

    before, after: the values that it followed and that followed it; None at the log's ends, and at a pause.
    """

    begin_ns: int
    end_ns: int
    value: float
    before: float | None
    after: float | None


@dataclass(frozen=True, eq=False)
class Spans(Sequence[Span]):
    """Spans as columns. apart: where the log begins or a pause was before a span, and True for the log's end."""

    begin_ns: Ints
    end_ns: Ints
    values: Values
    apart: Mask

    def __len__(self) -> int:
        return len(self.begin_ns)

    @overload
    def __getitem__(self, place: int) -> Span: ...
    @overload
    def __getitem__(self, place: slice) -> list[Span]: ...
    def __getitem__(self, place: int | slice) -> Span | list[Span]:
        if isinstance(place, slice):
            return list(self.between(*place.indices(len(self))[:2]))
        at = range(len(self))[place]
        before = None if self.apart[at] else float(self.values[at - 1])
        after = None if self.apart[at + 1] else float(self.values[at + 1])
        return Span(int(self.begin_ns[at]), int(self.end_ns[at]), float(self.values[at]), before, after)

    def __iter__(self) -> Iterator[Span]:
        # Some at a time: who looks for the first few need not wait for all.
        return chain.from_iterable(self.between(low, low + _AT_ONCE) for low in range(0, len(self), _AT_ONCE))

    def of(self, value: float) -> Iterator[Span]:
        """Yield the spans of this value."""
        return map(self.__getitem__, np.flatnonzero(self.values == value).tolist())

    def beginning(self, begin_ns: Ints, which: Mask) -> list[Span]:
        """Return the spans selected, each beginning at its time in `begin_ns`."""
        return [self[row]._replace(begin_ns=int(begin_ns[row])) for row in np.flatnonzero(which).tolist()]

    def between(self, low: int, high: int) -> Iterator[Span]:
        """Return the spans of the slice."""
        apart = self.apart[low : high + 1].tolist()
        values = [*([] if low else [None]), *self.values[max(low - 1, 0) : high + 1].tolist(), None]
        before = [None if alone else value for alone, value in zip(apart, values, strict=False)]
        after = [None if alone else value for alone, value in zip(apart[1:], values[2:], strict=False)]
        return map(Span, self.begin_ns[low:high].tolist(), self.end_ns[low:high].tolist(), values[1:], before, after)


NO_SPANS: Final = Spans(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0), np.ones(1, np.bool_))


@dataclass(frozen=True, eq=False)
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
    def spans(self) -> Spans:
        """Spans of what was sent, change by change."""
        return self.spans_within(np.iinfo(np.int64).max)

    def spans_within(self, longest_ns: int) -> Spans:
        """Return the spans of what was sent, change by change.

        Where no frame came for longer than `longest_ns`, a span ends with the last frame before.
        """
        if not len(self.t_ns):
            return NO_SPANS
        missing = np.diff(self.t_ns, prepend=self.t_ns[0]) > longest_ns
        starts = np.flatnonzero(np.append(True, np.diff(self.values) != 0) | missing)
        ends = np.append(self.t_ns[starts[1:] - missing[starts[1:]]], self.t_ns[-1])
        apart = np.concatenate(([True], missing[starts[1:]], [True]))
        return Spans(self.t_ns[starts], ends, self.values[starts], apart)

    def span_at(self, t_ns: int) -> Span | None:
        """The span in force at `t_ns`."""
        place = int(np.searchsorted(self.spans.begin_ns, t_ns, side="right")) - 1
        return self.spans[place] if place >= 0 else None

    def since(self, times: Ints) -> Ints:
        """Return when (ns) the value in force at each of `times` began, or the first value after it; 0 without the
        signal.
        """
        begin_ns = self.spans.begin_ns
        places = np.maximum(np.searchsorted(begin_ns, times, side="right") - 1, 0)
        return begin_ns[places] if len(self) else np.zeros_like(times)

    def last(self, t_ns: int, *values: float) -> Span | None:
        """The last span with one of these values (none named: any but 0) that begins up to and including `t_ns`."""
        begun = self.spans.values[: np.searchsorted(self.spans.begin_ns, t_ns, side="right")]
        places = np.flatnonzero(np.isin(begun, values) if values else begun)
        return self.spans[int(places[-1])] if len(places) else None

    def begun(self, begin_ns: int, end_ns: int) -> Iterator[Span]:
        """Spans that begin from `begin_ns` up to and including `end_ns`."""
        low, high = np.searchsorted(self.spans.begin_ns, (begin_ns, end_ns + 1)).tolist()
        return self.spans.between(low, high)

    def between(self, begin_ns: int, end_ns: int) -> Series:
        """The part from `begin_ns` up to and including `end_ns`."""
        low, high = np.searchsorted(self.t_ns, (begin_ns, end_ns + 1))
        return Series(self.t_ns[low:high], self.values[low:high])

    def sampled(self, times: Ints) -> Values:
        """The newest value at each of `times`, the first one before; zeros where the log does not have the signal."""
        if not len(self):
            return np.zeros(len(times))
        return self.values[np.maximum(np.searchsorted(self.t_ns, times, side="right") - 1, 0)]


NOTHING: Final = Series(np.zeros(0, np.int64), np.zeros(0))


class Gap(NamedTuple):
    """A message that did not come. `end_ns` None: it never came back in this log."""

    can_id: int
    begin_ns: int  # its last frame before
    end_ns: int | None
    length_ns: int

    @property
    def over_ns(self) -> int:
        """Time (ns) at which it ended, or the log did."""
        return self.begin_ns + self.length_ns

    def words(self) -> str:
        """Words for how long it lasted."""
        return f"to the end of the log ({ms(self.length_ns)})" if self.end_ns is None else f"for {ms(self.length_ns)}"


class WrongLengths(NamedTuple):
    """Frames of one message that have another length than the message, which counts as if they did not come."""

    frames: int
    first_ns: int
    lengths: tuple[int, ...]
    right: int

    @property
    def words(self) -> str:
        """The length they have, and the one they should have."""
        return f"{' or '.join(map(str, self.lengths))} bytes, and must have {self.right}"


class PowerCycle(NamedTuple):
    """The car was switched off after its last 0x520 at `begin_ns`, and on again before the first one at `end_ns`."""

    begin_ns: int
    end_ns: int
    before: float
    after: float

    @property
    def words(self) -> str:
        states = " and ".join(sig.label(sig.AS_STATE, state) for state in (self.before, self.after))
        return f"the car was switched off and on: no 0x520 for {ms(self.end_ns - self.begin_ns)} between {states}"


class Answers(NamedTuple):
    """Toggles of the VCU's handshake as columns. waited_ns: until the AI computer's echo, or else the log's end."""

    toggle_ns: Ints
    bit: Ints
    waited_ns: Ints
    echoed: Mask

    def late(self, least_ns: int) -> Iterator[tuple[int, int, int]]:
        """(toggle_ns, bit, waited_ns) of those that waited for so long."""
        rows = np.flatnonzero(self.waited_ns >= least_ns)
        return zip(*(column[rows].tolist() for column in self[:3]), strict=True)


class NoFrames(ValueError):
    """There is nothing to be explained."""


class Record:
    """The frames of one car's bus, by message and signal.

    frames: of the one bus that has the car's messages, with the monotonic times; error_ns: when an error frame came.
    wrong_length: of each message that came so. clock_set: when the log's clock was, and by how much
    (back: less than 0). perhaps_set: the ends of pauses over which nothing breaks, so that it may have been set there.
    recorded: what the computer that recorded did to the log.
    """

    def __init__(self, frames: Frames, revision: str | None = None, databases: Databases | None = None) -> None:
        """revision: guessed from the frames where none is given. `databases` replaces the revision's own.

        Raises NoFrames, and ValueError for an unknown revision.
        """
        if not len(frames):
            raise NoFrames("there is no frame to be explained")
        self.revision, self.revision_reason = (
            (revision_named(revision), "given") if revision else guess_revision(frames)
        )
        chosen = _car_channel(frames)
        self.channel = frames.channels[chosen]
        counts = np.bincount(frames.channel, minlength=len(frames.channels)).tolist()
        others = zip(frames.channels, counts, strict=True)
        self.other_channels = {name: count for name, count in others if count and name != self.channel}
        straight, back_ns = straightened(frames.t_ns)
        self.clock_set = [(int(straight[row]), -int(back_ns[row])) for row in np.flatnonzero(back_ns)]
        self.perhaps_set: Sequence[int] = ()
        self.recorded = Recorded()
        self.begin_ns, self.end_ns = int(straight[0]), int(straight[-1])
        self.frames = frames.at(straight).only(frames.channel == chosen)
        self.error_ns = self.frames.t_ns[(self.frames.flags & ERROR) != 0]
        self.decoder = Decoder(databases or load_databases(revision=self.revision.name))
        self.wrong_length: dict[int, WrongLengths] = {}
        self.unknown_ids: Counter[int] = Counter()
        self._rows: dict[int, Ints] = {}  # by key, as in MessageLayout
        self._tables: dict[str, MessageTable] = {}
        self._series: dict[Signal, Series] = {}
        self._times: dict[int, Ints] = {}
        self._gaps: dict[tuple[int, int], list[Gap]] = {}
        for layout, rows in self.decoder.by_message(self.frames):
            if layout is None:
                self.unknown_ids.update(self.frames.can_id[rows].tolist())
                continue
            right = self.frames.length[rows] == layout.length
            if not right.all():
                strange = rows[~right]
                lengths = tuple(np.unique(self.frames.length[strange]).tolist())
                self.wrong_length[layout.can_id] = WrongLengths(
                    len(strange), int(self.frames.t_ns[strange[0]]), lengths, layout.length
                )
            if right.any():
                self._rows[layout.key] = rows[right]

    # ------------------------------------------------------------ signals

    def has(self, can_id: int) -> bool:
        """Return true where the log has that message, whole."""
        return can_id in self._rows

    def lacks(self, can_id: int) -> bool:
        """Return true where no whole frame of that message came.

        A frame that the database does not name counts as received.
        """
        return not self.has(can_id) and can_id not in self.unknown_ids

    def never_right(self, can_id: int) -> bool:
        """True where that message came, and always with a wrong length."""
        return can_id in self.wrong_length and not self.has(can_id)

    @property
    def ai_speaks(self) -> bool:
        """Return true where the log has any whole message of the AI computer."""
        return any(map(self.has, AI_IDS))

    @property
    def setting(self) -> Setting:
        """The circumstances that choose what is to be done about a cause."""
        return Setting(self.ai_is_theirs, self.recorded.virtual)

    @cached_property
    def ai_is_theirs(self) -> bool:
        """Return true where another program than this software's bridge drives: by its order or its rhythm.

        The bridge sends 0x510 to 0x514 in the order of their ids, together, every 10 ms. Where two programs send, or
        too little was heard, that is not told.
        """
        of_ai = np.isin(self.frames.can_id, AI_IDS)
        ids, cycles = self.frames.can_id[of_ai].astype(np.int64), len(self.times(AI_IDS[0]))
        if len(ids) < _ENOUGH_OF_AI or self.second_senders:
            return False
        turns = int((np.diff(ids) <= 0).sum()) + 1
        period_ns = float(np.median(np.diff(self.times(AI_IDS[0])))) if cycles > 1 else 0.0
        return not (0.9 <= turns / max(cycles, 1) <= 1.1 and 0.8 <= period_ns / PERIOD_NS <= 1.2)

    def times(self, can_id: int) -> Ints:
        """Return when (ns) that message came."""
        if can_id not in self._times:
            rows = self._rows.get(can_id)
            self._times[can_id] = NOTHING.t_ns if rows is None else self.frames.t_ns[rows]
        return self._times[can_id]

    def newest_ns(self, can_id: int, at_ns: Ints | int) -> Ints:
        """Return when (ns) that message came last, before or at each of these times; -1 s: never."""
        times = np.append(-S, self.times(can_id))
        return np.asarray(times[np.searchsorted(times, at_ns, side="right") - 1])

    def series(self, signal: Signal) -> Series:
        """A signal in physical units; empty if the log or the database does not have it."""
        if signal not in self._series:
            silent = signal.name in self.revision.says_nothing
            self._series[signal] = NOTHING if silent else self._read(signal)
        return self._series[signal]

    def _read(self, signal: Signal) -> Series:
        """Return the series of a signal; empty where the log or the database does not have it."""
        layout = self.decoder.databases.by_name(signal.message)
        rows = self._rows.get(layout.key) if layout is not None else None
        if layout is None or rows is None:
            return NOTHING
        described = {one.name: one for one in layout.signals}
        asked = next((described[signal.name + tail] for tail in _NAME_TAILS if signal.name + tail in described), None)
        if asked is None:
            return NOTHING
        if layout.plain:  # then no more is decoded than is asked for
            values, _ = values_of(asked, self.frames.word[rows])
            return Series(self.times(layout.key), values.astype(np.float64))
        if layout.name not in self._tables:
            self._tables[layout.name] = self.decoder.table(layout, self.frames, rows)
        found = self._tables[layout.name].series[asked.name]
        return Series(found.t_ns, found.values.astype(np.float64))

    def matching(self, patterns: Sequence[str]) -> dict[str, list[tuple[str, Series]]]:
        """Group (MESSAGE.NAME, series) of the log's signals that a NAME or MESSAGE.NAME with * and ? means, by unit."""
        groups: dict[str, list[tuple[str, Series]]] = {}
        for layout in self.decoder.databases.layouts.values():
            for signal in layout.signals_like(patterns):
                series = self._read(Signal(layout.name, signal.name))
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
        """Spans that begin with a change (to a value, if one is named) from `begin_ns` up to and including `end_ns`."""
        changes = [span for span in self.series(signal).begun(begin_ns, end_ns) if span.before is not None]
        return [span for span in changes if to is None or span.value == to]

    def errors_before(self, t_ns: int, length_ns: int) -> list[int]:
        """The times of error frames in the `length_ns` up to `t_ns`."""
        found: list[int] = self.error_ns[(self.error_ns >= t_ns - length_ns) & (self.error_ns <= t_ns)].tolist()
        return found

    @cached_property
    def fastest_wheel(self) -> Series:
        """The fastest of the four wheels, rpm."""
        wheels = [self.series(signal) for signal in sig.WHEELS]
        return Series(wheels[0].t_ns, np.maximum.reduce([wheel.values for wheel in wheels]))

    @cached_property
    def middle_wheel(self) -> Series:
        """The median of the four wheels, rpm: a wheel that reads wrong does not change it much."""
        wheels = [self.series(signal) for signal in sig.WHEELS]
        return Series(wheels[0].t_ns, np.median([wheel.values for wheel in wheels], axis=0))

    @cached_property
    def like_official_simulator(self) -> bool:
        """The official simulator sends STATUS_BRK and STATUS_EBS as 0, always; a car in AS_READY never does."""
        brake, ebs = self.series(sig.STATUS_BRK), self.series(sig.STATUS_EBS)
        beyond_off = (self.series(sig.AS_STATE).values >= sig.READY).any()
        return bool(beyond_off and len(brake) and not brake.values.any() and not ebs.values.any())

    @property
    def car(self) -> VehicleParameters:
        """The figures of the car that wrote the log."""
        return CARS["official-simulator" if self.like_official_simulator else self.revision.name]

    # ------------------------------------------------------------ the link

    def gaps(self, can_id: int, longest_ns: int) -> list[Gap]:
        """Return the gaps in which that message was missing for longer than `longest_ns`, also at the log's end."""
        if (can_id, longest_ns) not in self._gaps:
            self._gaps[can_id, longest_ns] = self._find_gaps(can_id, longest_ns)
        return self._gaps[can_id, longest_ns]

    def _find_gaps(self, can_id: int, longest_ns: int) -> list[Gap]:
        times = self.times(can_id)
        waits = np.diff(np.append(times, self.end_ns))
        found = np.flatnonzero(waits > longest_ns) if len(times) else np.zeros(0, np.int64)
        ends: list[int | None] = times[found[found + 1 < len(times)] + 1].tolist()
        ends += [None] * (len(found) - len(ends))
        return list(map(Gap, repeat(can_id), times[found].tolist(), ends, waits[found].tolist()))

    @cached_property
    def power_cycles(self) -> Sequence[PowerCycle]:
        """Times in which the car was switched off and on, before or after its runs: as it has to be, and no fault.

        It comes back in AS_INIT or AS_OFF, and what it counts begins again. A car that was about to drive, or is back
        within 3 s with its switches on, restarted by itself.
        """
        found = []
        for gap in self.gaps(sig.STATUS, GONE_NS):
            before, after = (self.at(sig.AS_STATE, t_ns) for t_ns in (gap.begin_ns, gap.over_ns))
            if gap.end_ns is None or before is None or after is None or before in (sig.READY, sig.DRIVING):
                continue
            switched = any(self.at(signal, gap.end_ns) for signal in (sig.AS_SWITCH, sig.TS_SWITCH))
            begun = after == AsState.AS_INIT != before or self._counts_from_zero(gap.begin_ns, gap.end_ns)
            if after in OFF_LIKE and begun and (gap.length_ns >= REBOOT_NS or not switched):
                found.append(PowerCycle(gap.begin_ns, gap.end_ns, before, after))
        return tuple(found)

    def _counts_from_zero(self, begin_ns: int, end_ns: int) -> bool:
        counts = [(self.at(signal, begin_ns), self.at(signal, end_ns + DEAD_NS)) for signal in sig.PULSES]
        return any(before for before, _ in counts) and not any(after for _, after in counts)

    @cached_property
    def silences(self) -> Sequence[tuple[int, int]]:
        """(from, to) where no frame at all was received: the bus was dead, or the recording paused."""
        times = self.frames.t_ns
        return tuple((int(times[place]), int(times[place + 1])) for place in np.flatnonzero(np.diff(times) > DEAD_NS))

    def silence_in(self, gap: Gap) -> bool:
        """Return true where a silence of everybody is nearly all of this gap of one message."""
        shared = (min(end_ns, gap.over_ns) - max(begin_ns, gap.begin_ns) for begin_ns, end_ns in self.silences)
        return any(length_ns > DEAD_SHARE * gap.length_ns for length_ns in shared)

    @cached_property
    def answers(self) -> Answers:
        """Every toggle of the VCU's handshake while the AI computer speaks (the first bit counts), and its echo."""
        asked, echo = self.series(sig.HANDSHAKE).spans, self.series(sig.ECHO)
        begin = int(np.searchsorted(asked.begin_ns, echo.t_ns[0])) if len(echo) else len(asked)
        toggle_ns, bit = asked.begin_ns[begin:], asked.values[begin:].astype(np.int64)
        echo_ns = first_echoes(toggle_ns, bit, echo.t_ns, echo.values)
        echoed = echo_ns < NEVER_NS
        return Answers(toggle_ns, bit, np.where(echoed, echo_ns, self.end_ns) - toggle_ns, echoed)

    @property
    def frozen(self) -> Sequence[Span]:
        """Spans in which 0x520 came and repeated itself: for 100 ms and more HANDSHAKE stood though its echo was there.

        It may stand where the VCU misses the echo (AI_COMMS_LOST), where the car does not drive itself (0x120 says so),
        after a drive, and while the VCU comes up: for a second where the log has no toggle before, at 0 in AS_INIT for
        as long as it likes. Of a log that has every second 0x520 only, this is not known.
        """
        return self._standing[0]

    @property
    def perhaps_frozen(self) -> Sequence[Span]:
        """Spans like `frozen` of a second and more with the ASMS off: it froze, or the car is driven by hand.

        Nothing else in 0x520 changed meanwhile either, and 0x120 does not say that the car does not drive itself.
        """
        return self._standing[1]

    @cached_property
    def _standing(self) -> tuple[Sequence[Span], Sequence[Span]]:
        """Find the spans of `frozen` and those of `perhaps_frozen`: spans of HANDSHAKE, each from its echo on."""
        asked, times = self.series(sig.HANDSHAKE).spans, self.times(sig.STATUS)
        if len(times) < 2 or np.median(np.diff(times)) > 1.5 * PERIOD_NS:
            return (), ()
        last_ns = asked.end_ns - 1  # of each span
        toggled = np.arange(len(asked)) > 0  # the first span does not begin with a toggle
        due, by_hand = self._toggle_due(asked, toggled, last_ns)
        echo, state, switch = map(self.series, (sig.ECHO, sig.AS_STATE, sig.AS_SWITCH))
        echoed_ns = first_echoes(asked.begin_ns, asked.values.astype(np.int64), echo.t_ns, echo.values)
        since_ns = np.maximum.reduce([echoed_ns, state.since(last_ns), switch.since(last_ns)])
        frozen = due & (self._came_ns(since_ns, asked.end_ns) >= np.where(toggled, COMMS_LOST_NS, S))
        # When 0x520 last came with another content than before
        changes_ns = times[np.diff(self.frames.word[self._rows[sig.STATUS]], prepend=np.uint64(0)) != 0]
        changed_ns = np.append(-S, changes_ns)[np.searchsorted(changes_ns, last_ns, side="right")]
        same_ns = np.maximum(since_ns, changed_ns)
        perhaps = by_hand & (self._came_ns(same_ns, asked.end_ns) >= S)
        return asked.beginning(since_ns, frozen), asked.beginning(same_ns, perhaps)

    def _toggle_due(self, asked: Spans, toggled: Mask, last_ns: Ints) -> tuple[Mask, Mask]:
        """Select the spans of HANDSHAKE that must end soon after their echo, and those that must unless driven by hand.

        The state and the switches are those at `last_ns` of each span.
        """
        state, on, lost = (
            self.series(signal).sampled(last_ns) for signal in (sig.AS_STATE, sig.AS_SWITCH, sig.COMMS_LOST)
        )
        over = np.isin(state, (sig.EMERGENCY, sig.FINISHED))
        coming_up = ~toggled & (asked.values == 0) & (state == AsState.AS_INIT)
        may = ~over & ~coming_up
        system = self.series(sig.SM_SYS)
        if len(system):
            may &= system.sampled(last_ns) == sig.DRIVE_AUTONOMOUS
        due = may & (on != 0) | np.isin(state, (sig.READY, sig.DRIVING))
        missed = lost != 0  # the VCU waits for an echo that it did not receive
        return due & ~missed, may & ~due & ~missed

    def _came_ns(self, begin_ns: Ints, end_ns: Ints) -> Ints:
        """Return how long 0x520 came between these times: a cycle for each frame, an adapter's batch being one."""
        times = self.times(sig.STATUS)
        spread = times[np.diff(times, prepend=-PERIOD_NS) > PERIOD_NS // 2]
        came = np.searchsorted(spread, end_ns) - np.searchsorted(spread, begin_ns)
        return np.asarray(np.minimum(end_ns - begin_ns, came * PERIOD_NS))

    @cached_property
    def second_senders(self) -> Sequence[SecondSender]:
        """Senders besides the AI computer on its ids, in the order of time."""
        return second_senders(self.frames, self.decoder.databases)

    @cached_property
    def second_cars(self) -> Sequence[SecondSender]:
        """Times in which somebody else sends the car's messages too: what these say then is of no one car."""
        return second_cars({can_id: self.times(can_id) for can_id in VCU_IDS})


def _car_channel(frames: Frames) -> int:
    """The bus on which most of the VCU's and the AI computer's messages are."""
    if len(frames.channels) == 1:
        return 0
    known = [can_id for can_id, message in BY_ID.items() if message.flow in (Flow.TO_VCU, Flow.FROM_VCU)]
    ours = frames.channel[np.isin(frames.can_id, known)]
    counted = ours if len(ours) else frames.channel
    return int(np.bincount(counted).argmax()) if len(counted) else 0
