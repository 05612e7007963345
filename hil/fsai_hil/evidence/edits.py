"""Editor of logs: the frames of a good run, changed as another car or another AI computer would have sent them.

    log = good_run("acceleration")
    log = edited(log, put(sig.TS_SWITCH, 0, driving(4.0)), gone(0x181))

An act takes a log and returns one. Times are instants: so many seconds after a state of the car began, or before the
log's end; they are those of the log as it came, so that the order of acts does not matter to them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from typing import Final, NamedTuple

import numpy as np

from fsai_hil.simulator.lockstep import Lockstep
from fsai_hil.simulator.tracks import load_track
from fsai_hil.simulator.world import WorldSetup
from fsai_vcu.diagnostics.explain import signals as sig
from fsai_vcu.diagnostics.explain.record import Record, Values
from fsai_vcu.diagnostics.explain.signals import Signal
from fsai_vcu.diagnostics.log.frames import Frames, LogFrame, Mask, frames_of, joined
from fsai_vcu.interface.enums import Ami, AsState, Direction, EbsState, MissionStatus, TsState
from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.reserved import AI_IDS
from fsai_vcu.interface.units import MS, S

CHANNEL: Final = "can0"
STOPS_IN_S: Final = 1.5
AFTER_S: Final = 3.0  # of a log behind what ended its drive


class Instant(NamedTuple):
    """A time in a log: seconds after the first frame of a state, after the log's begin or (negative) before its end."""

    state: AsState | None
    seconds: float


def off(seconds: float) -> Instant:
    return Instant(AsState.AS_OFF, seconds)


def ready(seconds: float) -> Instant:
    return Instant(AsState.AS_READY, seconds)


def driving(seconds: float) -> Instant:
    return Instant(AsState.AS_DRIVING, seconds)


def whole(seconds: float) -> Instant:
    return Instant(None, seconds)


BEGIN: Final = whole(0.0)
END: Final = whole(-1e-9)


@dataclass(frozen=True)
class EditedLog:
    """A log under the editor's hands, and the record of the run as it was driven, which its instants are of."""

    frames: Frames
    run: Record

    def at(self, instant: Instant) -> int:
        """An instant in ns of the log's clock."""
        seconds_ns = round(instant.seconds * S)
        if instant.state is None:
            return (self.run.begin_ns if instant.seconds >= 0 else self.run.end_ns) + seconds_ns
        states = self.run.series(sig.AS_STATE)
        return int(states.t_ns[states.values == instant.state][0]) + seconds_ns

    def rows(self, can_id: int, since: Instant, until: Instant) -> Mask:
        """The frames of a message from one instant up to another."""
        inside: Mask = self.between(since, until) & (self.frames.can_id == can_id)
        return inside

    def between(self, since: Instant, until: Instant) -> Mask:
        begin_ns, end_ns = self.at(since), self.at(until) + (until == END)
        inside: Mask = (self.frames.t_ns >= begin_ns) & (self.frames.t_ns <= end_ns)
        return inside

    @cached_property
    def record(self) -> Record:
        """The frames as they are now."""
        return Record(self.frames, self.run.revision.name)

    def said(self, frames: Frames) -> EditedLog:
        """The same log with other frames, sorted by time."""
        if (frames.t_ns[1:] < frames.t_ns[:-1]).any():
            frames = frames.only(np.argsort(frames.t_ns, kind="stable"))
        return EditedLog(frames, self.run)


Act = Callable[[EditedLog], EditedLog]
Changed = Callable[[Values, Values], Values]  # values, seconds since the first of them -> values


def edited(log: EditedLog, *acts: Act) -> EditedLog:
    for act in acts:
        log = act(log)
    return log


# ---------------------------------------------------------------- good runs


@cache
def good_run(name: str) -> EditedLog:
    """A run of the simulated car and this software's AI side in which nothing went wrong."""
    mission, track, revision = RUNS[name]
    setup = WorldSetup(missions=[mission], track=load_track(track) if track else None, gps=False, revision=revision)
    sent: list[Frame] = []
    lockstep = Lockstep(setup, on_frame=sent.append)
    lockstep.wire.on_frames = lambda frames: None  # type: ignore[method-assign]
    while not lockstep.world.done:
        lockstep.step()
    frames = frames_of(LogFrame(f.t_ns, CHANNEL, f.can_id, f.data, extended=f.extended) for f in sent)
    return EditedLog(frames, Record(frames, revision))


RUNS: Final = {
    "acceleration": (Ami.ACCELERATION, "", "2026"),
    "acceleration 2021": (Ami.ACCELERATION, "", "2021"),
    "bends": (Ami.AUTOCROSS, "small_oval", "2026"),
}


# ---------------------------------------------------------------- values


def put(signal: Signal, value: float | Changed, since: Instant = BEGIN, until: Instant = END) -> Act:
    """A signal has that value from then to then, or what a function makes of the values that it had."""

    def act(log: EditedLog) -> EditedLog:
        """Write the value into the signal's frames, where this car sends it."""
        layout = log.run.decoder.databases.by_name(signal.message)
        if layout is None:
            return log
        names = (signal.name, f"{signal.name}_Nm")
        place = next((one for one in layout.signals if one.name in names), None)
        rows = log.rows(layout.can_id, since, until)
        if place is None or not rows.any():  # this car does not send it
            return log
        if callable(value):
            values = log.record.series(signal).sampled(log.frames.t_ns[rows])
            t_ns = log.frames.t_ns[rows]
            wanted = value(values, (t_ns - t_ns[0]) / S)
        else:
            wanted = np.full(int(rows.sum()), float(value))
        raw = np.round((wanted - place.offset) / place.scale).astype(np.int64).astype(np.uint64)
        mask = np.uint64((1 << place.length) - 1)
        word = log.frames.word.copy()
        shift = np.uint64(place.start)
        word[rows] = word[rows] & ~(mask << shift) | (raw & mask) << shift
        return log.said(replace(log.frames, word=word))

    return act


def puts(values: dict[Signal, float | Changed], since: Instant = BEGIN, until: Instant = END) -> Act:
    """Several signals at once."""
    return together(*(put(signal, value, since, until) for signal, value in values.items()))


def together(*acts: Act) -> Act:
    return lambda log: edited(log, *acts)


def scaled(signal: Signal, factor: float, since: Instant = BEGIN, until: Instant = END) -> Act:
    return put(signal, lambda values, seconds: values * factor, since, until)


def added(signal: Signal, what: float, since: Instant = BEGIN, until: Instant = END) -> Act:
    return put(signal, lambda values, seconds: values + what, since, until)


def held(signal: Signal, since: Instant, until: Instant = END) -> Act:
    """The signal stays as it was at the first instant."""
    return put(signal, lambda values, seconds: np.full_like(values, values[0]), since, until)


def swapped(one: Signal, other: Signal, since: Instant = BEGIN, until: Instant = END) -> Act:
    """Two signals of a message change places."""

    def act(log: EditedLog) -> EditedLog:
        return edited(
            log,
            put(one, lambda values, seconds: _at(log, other, since, until), since, until),
            put(other, lambda values, seconds: _at(log, one, since, until), since, until),
        )

    return act


def _at(log: EditedLog, signal: Signal, since: Instant, until: Instant) -> Values:
    return log.record.series(signal).sampled(log.frames.t_ns[log.rows(signal.can_id, since, until)])


def echo(kind: str, since: Instant = BEGIN, until: Instant = END) -> Act:
    """The AI computer's HANDSHAKE: 'inverted', 'late' (of the 0x520 before), 'constant'."""

    def act(log: EditedLog) -> EditedLog:
        asked = log.record.series(sig.HANDSHAKE)

        def bits(values: Values, seconds: Values) -> Values:
            times = log.frames.t_ns[log.rows(0x510, since, until)]
            newest = np.searchsorted(asked.t_ns, times, side="right") - 1
            if kind == "constant":
                return np.zeros_like(values)
            said = asked.values[np.maximum(newest - (kind == "late"), 0)]
            return 1.0 - said if kind == "inverted" else said

        return edited(log, put(sig.ECHO, bits, since, until))

    return act


# ---------------------------------------------------------------- frames


def gone(ids: int | Iterable[int], since: Instant = BEGIN, until: Instant = END) -> Act:
    """These messages are missing from then to then."""
    chosen = [ids] if isinstance(ids, int) else [*ids]
    return lambda log: log.said(log.frames.only(~(np.isin(log.frames.can_id, chosen) & log.between(since, until))))


def only(since: Instant, until: Instant) -> Act:
    """The log begins and ends then."""
    return lambda log: log.said(log.frames.only(log.between(since, until)))


def short(can_id: int, length: int, since: Instant = BEGIN, until: Instant = END) -> Act:
    """Frames of another length."""

    def act(log: EditedLog) -> EditedLog:
        rows = log.rows(can_id, since, until)
        mask = np.uint64((1 << 8 * length) - 1)
        return log.said(
            replace(
                log.frames,
                length=np.where(rows, np.uint8(length), log.frames.length).astype(np.uint8),
                word=np.where(rows, log.frames.word & mask, log.frames.word),
            )
        )

    return act


def ordered(ids: Sequence[int], apart_us: int = 250, late_us: int = 0) -> Act:
    """The AI computer sends its five messages in this order, so far apart, and so much later."""

    def act(log: EditedLog) -> EditedLog:
        t_ns = log.frames.t_ns.copy()
        first = log.frames.t_ns[log.frames.can_id == AI_IDS[0]]
        for place, can_id in enumerate(ids):
            rows = log.frames.can_id == can_id
            t_ns[rows] = first[: rows.sum()] + (place * apart_us + late_us) * 1000
        return log.said(log.frames.at(t_ns))

    return act


def sent(can_id: int, period_ms: int, payload: Callable[[float], bytes], since: Instant, until: Instant = END) -> Act:
    """Another message, which the simulated car does not send; payload: by the seconds since the first instant."""

    def act(log: EditedLog) -> EditedLog:
        begin_ns, end_ns = log.at(since), log.at(until)
        times = range(begin_ns, end_ns, period_ms * MS)
        new = frames_of(LogFrame(t_ns, CHANNEL, can_id, payload((t_ns - begin_ns) / S)) for t_ns in times)
        return log.said(joined([log.frames, new]))

    return act


def error(can_id: int, data: str, at: Instant) -> Act:
    """An error frame of SocketCAN."""

    def act(log: EditedLog) -> EditedLog:
        new = frames_of([LogFrame(log.at(at), CHANNEL, can_id, bytes.fromhex(data), error=True)])
        return log.said(joined([log.frames, new]))

    return act


def paced(period_ms: float, jitter_ms: float = 0.0) -> Act:
    """The AI computer sends every so often, early or late by up to the jitter, what it had to say by then."""

    def act(log: EditedLog) -> EditedLog:
        frames, rng = log.frames, np.random.default_rng(0)
        of_ai = np.isin(frames.can_id, AI_IDS)
        begin_ns, end_ns = (int(frames.t_ns[of_ai][place]) for place in (0, -1))
        grid = begin_ns + np.arange(0, end_ns - begin_ns, round(period_ms * MS))
        grid = grid + rng.integers(-round(jitter_ms * MS), round(jitter_ms * MS) + 1, len(grid))
        parts = [frames.only(~of_ai)]
        for place, can_id in enumerate(AI_IDS):
            rows = np.flatnonzero(frames.can_id == can_id)
            newest = rows[np.maximum(np.searchsorted(frames.t_ns[rows], grid, side="right") - 1, 0)]
            copied = {name: getattr(frames, name)[newest] for name in ("can_id", "flags", "length", "word", "channel")}
            parts.append(replace(frames, t_ns=grid + place * 200_000, **copied, long={}))
        paced = log.said(joined(parts))
        return paced if jitter_ms else edited(paced, echo("as asked"))

    return act


def batched(every_ms: int) -> Act:
    """An adapter hands frames over so often, with the time of the handing over."""
    return lambda log: log.said(log.frames.at((log.frames.t_ns // (every_ms * MS) + 1) * every_ms * MS))


def before_a_good_one(dark_s: float) -> Act:
    """After this run the car is switched off for so long, and a good one follows."""

    def act(log: EditedLog) -> EditedLog:
        good = log.run.frames
        behind_ns = int(log.frames.t_ns[-1]) + round(dark_s * S) - int(good.t_ns[0])
        return log.said(joined([log.frames, good.at(good.t_ns + behind_ns)]))

    return act


def again(dark_s: float, *, ai_goes_on: bool = False) -> Act:
    """A second run like this one, after the car was switched off for so long."""

    def act(log: EditedLog) -> EditedLog:
        frames = log.frames
        length_ns = int(frames.t_ns[-1] - frames.t_ns[0]) + round(dark_s * S)
        first = frames.t_ns[frames.can_id == 0x520][0]
        second = frames.only((frames.t_ns >= first) | ~np.isin(frames.can_id, AI_IDS))
        parts = [frames, second.at(second.t_ns + length_ns)]
        if ai_goes_on:
            cycle = frames.only(np.isin(frames.can_id, AI_IDS) & (frames.t_ns > frames.t_ns[-1] - 10 * MS))
            count = int((length_ns + first - frames.t_ns[-1]) // (10 * MS)) - 1
            parts += [cycle.at(cycle.t_ns + number * 10 * MS) for number in range(1, count)]
        return log.said(joined(parts))

    return act


# ---------------------------------------------------------------- what cars and AI computers do


FAULTS: Final[dict[Signal, float | Changed]] = dict.fromkeys((sig.FAULT_STATUS, sig.SHUTDOWN_CAUSE, *sig.FAULTS), 0.0)
BARE: Final = puts(FAULTS)
"""A car without fault bits, as with some databases and other VCUs."""


def stops(at: Instant, **bits: float) -> Act:
    """EMERGENCY_BRAKE from then on; bits: further signals of 0x520 by name. The log ends soon after."""

    def slower(values: Values, seconds: Values) -> Values:
        return values[0] * np.clip(1.0 - seconds / STOPS_IN_S, 0.0, 1.0)

    end = Instant(at.state, at.seconds + AFTER_S)
    car: dict[Signal, float | Changed] = {
        sig.AS_STATE: float(AsState.EMERGENCY_BRAKE),
        sig.EBS_STATE: float(EbsState.EBS_TRIGGERED),
        sig.TS_STATE: float(TsState.TS_SHUTDOWN),
        sig.STATUS_EBS: 3.0,
        **dict.fromkeys(sig.WHEELS, slower),
        **dict.fromkeys(sig.CAR_TORQUE, 0.0),
        **{Signal("VCU2AI_Status", name): value for name, value in bits.items()},
    }
    asked: dict[Signal, float | Changed] = {
        **dict.fromkeys((sig.TORQUE_F, sig.TORQUE_R, sig.BRAKE_REQ_F, sig.BRAKE_REQ_R, sig.DIRECTION), 0.0),
        sig.MISSION_STATUS: float(MissionStatus.RUNNING),
    }
    soon, stands = (Instant(at.state, at.seconds + later_s) for later_s in (0.02, STOPS_IN_S))
    return together(puts(car, at), *(held(count, stands) for count in sig.PULSES), puts(asked, soon), only(BEGIN, end))


def turned_away(at: Instant) -> Act:
    """AS_READY is left for AS_OFF until the end; nothing is asked, and the log ends some seconds later."""
    end = Instant(at.state, at.seconds + 7.0)
    car: dict[Signal, float | Changed] = {sig.AS_STATE: float(AsState.AS_OFF), sig.GO: 0.0, sig.REMOTE_GO: 0.0}
    return together(puts(car, at), waits(at), only(BEGIN, end))


def waits(since: Instant) -> Act:
    """The car rests and the AI computer asks for nothing, as before a start."""
    rests: dict[Signal, float | Changed] = {
        **dict.fromkeys((*sig.WHEELS, *sig.CAR_TORQUE, sig.ANGLE), 0.0),
        **dict.fromkeys((sig.TORQUE_F, sig.TORQUE_R, sig.SPEED_MAX_F, sig.SPEED_MAX_R, sig.STEER), 0.0),
        sig.MISSION_STATUS: float(MissionStatus.SELECTED),
        sig.DIRECTION: float(Direction.NEUTRAL),
    }
    return together(puts(rests, since), *(held(count, since) for count in sig.PULSES))


def stays(state: AsState, seconds: float) -> Act:
    """The car never leaves a state; the log ends so many seconds after that began."""
    since, end = Instant(state, 0.0), Instant(state, seconds)
    go: dict[Signal, float | Changed] = {sig.AS_STATE: float(state), sig.GO: 0.0, sig.REMOTE_GO: 0.0}
    return together(puts(go, since), waits(since), only(BEGIN, end))


def never_moves(seconds: float = 10.0) -> Act:
    """No wheel turns and no torque is measured in AS_DRIVING; the log ends so many seconds after that began."""
    since = driving(0.0)
    rests: dict[Signal, float | Changed] = dict.fromkeys((*sig.WHEELS, *sig.CAR_TORQUE, sig.TORQUE_R), 0.0)
    brakes: dict[Signal, float | Changed] = dict.fromkeys(
        (sig.BRAKE_F, sig.BRAKE_R, sig.BRAKE_REQ_F, sig.BRAKE_REQ_R), 0.0
    )
    return together(
        puts(rests, since),
        *(held(count, since) for count in sig.PULSES),
        puts({**brakes, sig.SPEED_MAX_R: 3000.0}, driving(3.2)),
        only(BEGIN, driving(seconds)),
    )


def asks(torque_nm: float, *, since: Instant | None = None) -> Act:
    """The AI computer asks for that torque of the rear axle, once the start is over."""
    return put(sig.TORQUE_R, torque_nm, since or driving(3.2))


def parks(since: Instant, seconds: float) -> Act:
    """The car drove, and stands from that instant on in AS_DRIVING, without a request; the log ends so much later."""
    rests: dict[Signal, float | Changed] = dict.fromkeys(
        (*sig.WHEELS, *sig.CAR_TORQUE, *(sig.TORQUE_F, sig.TORQUE_R, sig.SPEED_MAX_R)), 0.0
    )
    car: dict[Signal, float | Changed] = {
        sig.AS_STATE: float(AsState.AS_DRIVING),
        sig.MISSION_STATUS: float(MissionStatus.RUNNING),
        sig.DIRECTION: float(Direction.FORWARD),
        sig.GO: 1.0,
    }
    until = Instant(since.state, since.seconds + seconds)
    return together(puts({**rests, **car}, since), *(held(count, since) for count in sig.PULSES), only(BEGIN, until))
