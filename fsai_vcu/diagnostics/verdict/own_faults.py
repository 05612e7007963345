"""Faults of the log itself, found before anything in it accuses a sender: its clock was set, frames are there twice.

A clock that was set forward looks like a pause. It is told apart by what goes on over the step without a break: each
message with its period, the HANDSHAKE bit with its toggling, the pulse counters of wheels that turn.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final, NamedTuple

import numpy as np

from fsai_vcu.diagnostics.explain.record import Record
from fsai_vcu.diagnostics.explain.signals import AS_STATE, HANDSHAKE, PULSES, STATUS
from fsai_vcu.diagnostics.finding import Finding
from fsai_vcu.diagnostics.log.frames import EPOCH_NS, ERROR, RECEIVED, SENT, Frames, Ints, Mask
from fsai_vcu.diagnostics.log.recorded import Recorded
from fsai_vcu.diagnostics.statistics.measure import BusStatistics, keys_of
from fsai_vcu.interface.reserved import AI_IDS
from fsai_vcu.interface.specification import COMMS_LOST_NS, PERIOD_NS
from fsai_vcu.interface.units import MS, S

_MOST_GAPS: Final = 100
_NEAR_NS: Final = 500 * MS  # before and after a gap: what is told of the messages' periods
_NEAR: Final = 20  # frames, of the counters
_FEW: Final = 5
_MESSAGES: Final = 3  # that go on, at least
_WINDOW_NS: Final = 100 * MS
_MORE: Final = 1.5
_APART: Final = 0.6  # of a period: what goes on over a step misses its turn by less
_NEARLY_ALL: Final = 0.9
_COUNTER: Final = 1 << 16
_PULSES: Final = 10  # more that a pause would have brought
_LONG_NEAR_NS: Final = 5 * S  # before and after a gap: what tells a period exactly
_EXACT_NS: Final = 20 * S  # a gap in which clocks do not drift apart by as much as …
_OFF_NS: Final = 2_500_000  # … a phase is off that is none of the bus's own
_STEADY_NS: Final = 1_500_000
_RESTART_NS: Final = 1 * S  # in less no VCU comes back

_COPY_NS: Final = 2 * MS
_TWICE: Final = 0.45  # of a message's frames are copies of others, where each is there twice
_ENOUGH: Final = 20  # frames
_PARTS, _PART = 5, 2000
_VARIED: Final = 5  # payloads
_EACH: Final = 0.49
_COMMANDS: Final = AI_IDS[1:]
_ECHO: Final = "its adapter's echo; each counts once"
_ECHO_OR_SECOND: Final = "its adapter's echo, or a second program that sends the same"

_BY_GAPS: Final = frozenset({"gap", "period", "handshake", "echo", "lossy"})
_BY_TIMES: Final = _BY_GAPS | {"intruder", "stopped", "load"}
_IMPOSSIBLE_LOAD: Final = 1.05
_ENOUGH_OF_LOAD: Final = 200  # frames


class ClockStep(NamedTuple):
    """The log's clock was set forward. row: of the first frame after it. t_ns: when that came, as if it had not been.

    proven: False where a pause of the recording could look the same.
    """

    row: int
    t_ns: int
    by_ns: int
    proven: bool

    def finding(self, channel: str) -> Finding:
        words = (
            f"the log's clock was set forward by {self.by_ns / S:.3f} s: periods, HANDSHAKE and counters go on without"
            " a break, and the times here are corrected"
        )
        return Finding("note", "clock", words, t_ns=self.t_ns, channel=channel)


# ---------------------------------------------------------------- a clock that was set


def steps_forward(record: Record, t_ns: Ints) -> list[ClockStep]:
    """Gaps of a log over which nothing breaks. `t_ns`: of all its frames, none before that of the one before it."""
    rows = np.flatnonzero(np.diff(t_ns) > COMMS_LOST_NS) + 1
    found, moved_ns = [], 0
    for row in rows[:_MOST_GAPS].tolist():
        step = _over(record, row, int(t_ns[row - 1]), int(t_ns[row]))
        if step is None:
            continue
        if step.proven:
            moved_ns += step.by_ns
        found.append(step._replace(t_ns=step.t_ns - moved_ns))
    return found


def moved_back(t_ns: Ints, steps: Sequence[ClockStep]) -> Ints:
    """The times of all frames as if the clock had not been set."""
    by_ns = np.zeros_like(t_ns)
    for step in steps:
        by_ns[step.row] += step.by_ns
    return t_ns - np.cumsum(by_ns)


def _over(record: Record, row: int, begin_ns: int, end_ns: int) -> ClockStep | None:
    """The gap from `begin_ns` to `end_ns` as a step of the clock; None where something breaks over it."""
    missing_ns = list(_missing(record, begin_ns, end_ns))
    undated = begin_ns < EPOCH_NS <= end_ns
    if len(missing_ns) < (1 if undated else _MESSAGES):
        return None
    by_ns = int(np.median([missing for missing, _ in missing_ns]))
    if by_ns <= 0 or any(abs(missing - by_ns) > _APART * max(period, PERIOD_NS) for missing, period in missing_ns):
        return None
    if _caught_up(record, begin_ns, end_ns) or _handshake_breaks(record, end_ns) or _changes(record, end_ns):
        return None
    counted = _counted(record, begin_ns, end_ns)
    if counted is None:
        return None
    turned, not_anew = counted
    by_phase = _off_phase(record, begin_ns, end_ns) and (not_anew or by_ns < _RESTART_NS)
    return ClockStep(row, end_ns, by_ns, turned or undated or by_phase)


def _missing(record: Record, begin_ns: int, end_ns: int) -> Iterator[tuple[int, float]]:
    """(by how much the gap is longer than its period, its period) of each message that comes on both sides, in ns."""
    frames = record.frames
    low, high = np.searchsorted(frames.t_ns, (begin_ns - _NEAR_NS, end_ns + _NEAR_NS)).tolist()
    near = frames.only(np.arange(low, high))
    keys = keys_of(near)
    for key in np.unique(keys[keys >= 0]).tolist():
        times = near.t_ns[keys == key]
        place = int(np.searchsorted(times, end_ns))
        before, after = times[:place], times[place:]
        intervals = max(len(before) - 1, 0) + max(len(after) - 1, 0)
        if not len(before) or not len(after) or not intervals:
            continue
        period_ns = (int(before[-1] - before[0]) + int(after[-1] - after[0])) / intervals
        yield round(int(after[0] - before[-1]) - period_ns), period_ns


def _caught_up(record: Record, begin_ns: int, end_ns: int) -> bool:
    """Return true where more frames come after the gap than before, or later: held back, their stamps are late."""
    windows = (end_ns, begin_ns - _WINDOW_NS, end_ns + 3 * _WINDOW_NS)
    t_ns = record.frames.t_ns
    after, before, later = (int(np.diff(np.searchsorted(t_ns, (low, low + _WINDOW_NS)))[0]) for low in windows)
    usual = max(before, later)
    return bool(usual) and after > _MORE * usual


def _handshake_breaks(record: Record, end_ns: int) -> bool:
    """True where the VCU's bit toggles with each frame and does not there, or stands and does not there."""
    bits = record.series(HANDSHAKE)
    place = int(np.searchsorted(bits.t_ns, end_ns))
    before, after = bits.values[max(place - _NEAR, 0) : place], bits.values[place : place + _NEAR]
    toggles = np.concatenate([np.diff(before), np.diff(after)]) != 0
    if not len(before) or not len(after) or len(toggles) < _FEW:
        return False
    share, here = float(toggles.mean()), bool(before[-1] != after[0])
    return (share >= _NEARLY_ALL and not here) or (share <= 1.0 - _NEARLY_ALL and here)


def _changes(record: Record, end_ns: int) -> bool:
    """True where the car's state is another one after it."""
    state = record.series(AS_STATE)
    place = int(np.searchsorted(state.t_ns, end_ns))
    return 0 < place < len(state) and state.values[place - 1] != state.values[place]


def _counted(record: Record, begin_ns: int, end_ns: int) -> tuple[bool, bool] | None:
    """(a wheel turned, a counter goes on that had counted); None where one breaks."""
    turned = not_anew = False
    for signal in PULSES:
        pulses = record.series(signal)
        place = int(np.searchsorted(pulses.t_ns, end_ns))
        before, after = pulses.values[max(place - _NEAR, 0) : place], pulses.values[place : place + _NEAR]
        if not len(before) or not len(after):
            continue
        sides = [np.diff(side) % _COUNTER for side in (before, after) if len(side) >= _FEW]
        if not sides:
            continue
        over = (after[0] - before[-1]) % _COUNTER
        if over > np.concatenate(sides).max() + 1:
            return None
        would_come = min(float(side.mean()) for side in sides) * (end_ns - begin_ns) / PERIOD_NS
        turned |= would_come - over >= _PULSES
        not_anew |= before[-1] > 0
    return turned, not_anew


def _off_phase(record: Record, begin_ns: int, end_ns: int) -> bool:
    """True where the car's messages come at other times after the gap than they would after a recording's pause."""
    if end_ns - begin_ns > _EXACT_NS:
        return False
    times = record.times(STATUS)
    low, place, high = np.searchsorted(times, (begin_ns - _LONG_NEAR_NS, end_ns, end_ns + _LONG_NEAR_NS)).tolist()
    intervals = np.concatenate([np.diff(times[low:place]), np.diff(times[place:high])])
    if not low < place < high or len(intervals) < _NEAR:
        return False
    usual = intervals[np.abs(intervals - np.median(intervals)) < _STEADY_NS]
    if len(usual) < _NEARLY_ALL * len(intervals):
        return False  # an adapter hands frames over in batches
    period_ns = float(usual.mean())
    if period_ns <= 0.0:
        return False  # the stamps are coarser than the period
    gap_ns = int(times[place] - times[place - 1])
    return abs(gap_ns - round(gap_ns / period_ns) * period_ns) > _OFF_NS


# ---------------------------------------------------------------- frames that are there twice


class Twice(NamedTuple):
    """Frames that are copies of others in the log. sure: False where a second sender could look the same."""

    copies: Mask
    words: str
    sure: bool


def twice(frames: Frames) -> Twice | None:
    """The copies in a log in which each frame, or each of the AI computer's, comes twice with the same content."""
    if len(frames) > _PARTS * _PART and not any(map(_twice, _parts(frames))):
        return None
    return _twice(frames)


def _parts(frames: Frames) -> Iterator[Frames]:
    """A few frames from several places: where each is there twice, these are too."""
    for part in range(_PARTS):
        begin = part * (len(frames) - _PART) // (_PARTS - 1)
        yield frames.only(np.arange(begin, begin + _PART))


def _twice(frames: Frames) -> Twice | None:
    """Find the frames that are copies of others: the same identifier, payload and nearly the same time."""
    keys = keys_of(frames).astype(np.int64) | frames.channel.astype(np.int64) << 32
    plain = np.flatnonzero((frames.flags & ERROR) == 0)
    order = plain[np.argsort(keys[plain], kind="stable")]
    keys, t_ns = keys[order], frames.t_ns[order]
    word, length, flags = frames.word[order], frames.length[order], frames.flags[order]
    same = np.zeros(len(order), np.bool_)
    same[1:] = (keys[1:] == keys[:-1]) & (word[1:] == word[:-1]) & (length[1:] == length[:-1])
    same[1:] &= np.abs(np.diff(t_ns)) <= _COPY_NS
    if same.sum() < _ENOUGH:
        return None
    places = np.arange(len(order))
    copies = (places - np.maximum.accumulate(np.where(same, 0, places))) % 2 == 1  # of a run every second one
    begins = np.flatnonzero(np.append(True, keys[1:] != keys[:-1]))
    counts, copied = np.diff(np.append(begins, len(order))), np.add.reduceat(copies.astype(np.int64), begins)
    lasts_ns = t_ns[np.append(begins[1:], len(order)) - 1] - t_ns[begins]
    ids = keys[begins] & 0x1FFF_FFFF
    # Frames that an adapter handed over together have one time as well, and are no more than their period allows.
    many = (counts - copied) * PERIOD_NS >= 0.8 * lasts_ns
    doubled = copied >= _TWICE * counts
    of_ai = np.isin(ids, AI_IDS)
    found = np.zeros(len(frames), np.bool_)
    often = counts >= _ENOUGH
    if often.sum() >= _MESSAGES and doubled[often].all() and (many | ~of_ai)[often].all() and many[often].any():
        found[order[copies]] = True
        words = "each frame is in the log twice: two recordings of one bus, or an adapter's echo; each counts once"
        return Twice(found, words, True)
    if of_ai.any() and (doubled & many)[of_ai].all():
        theirs = np.isin(keys & 0x1FFF_FFFF, AI_IDS) & copies
        marks = (flags[theirs] ^ flags[np.flatnonzero(theirs) - 1]) & (SENT | RECEIVED)
        marked = bool((marks != 0).mean() >= _NEARLY_ALL)
        commands = theirs & np.isin(keys & 0x1FFF_FFFF, _COMMANDS)
        varied = len(np.unique(word[commands])) >= _VARIED
        if marked or varied:
            found[order[theirs]] = True
            # Two programs with the same commands now and then sample them before and after a change.
            sure = marked and varied and bool((copied >= _EACH * counts)[of_ai].all())
            words = "each frame of the AI computer is in the log twice, with the same content: "
            words += _ECHO if sure else _ECHO_OR_SECOND
            return Twice(found, words, sure)
    return None


# ---------------------------------------------------------------- times that cannot be true


def impossible(buses: Sequence[BusStatistics]) -> str:
    """Say in a sentence why the times of a log cannot be true; '' where they can."""
    for bus in buses:
        if bus.load > _IMPOSSIBLE_LOAD and bus.frames >= _ENOUGH_OF_LOAD:
            return (
                f"the times cannot be true: {bus.frames} frames in {bus.duration_s:.3f} s are a load of {bus.load:.0%}"
                f" of {bus.bitrate // 1000} kbit/s; periods, pauses and senders are not judged"
            )
    return ""


def by_times(finding: Finding) -> bool:
    """True for a finding that rests on the times of the log alone."""
    return finding.kind in _BY_TIMES


def of_the_recording(finding: Finding, recorded: Recorded) -> bool:
    """True for a finding on gaps of a log whose computer lost frames, or stood still for as long as each gap lasts."""
    if finding.kind not in _BY_GAPS:
        return False
    silent = finding.silent_ns
    stood_still = bool(silent) and all(recorded.stall(*each) and recorded.explains(*each) for each in silent)
    return bool(recorded.lost) or stood_still
