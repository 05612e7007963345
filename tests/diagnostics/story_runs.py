"""Runs with a known end: the simulated car and the real AI side in lockstep, and one thing that goes wrong.

A run is driven once to a moment (in AS_DRIVING, say) and branches there: each end goes on in a copy, so that a dozen
ends cost one drive.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from copy import deepcopy
from dataclasses import dataclass, field
from functools import cache

import numpy as np
from msgspec.structs import replace

from fsai_hil.simulator.faults import FaultyWire, FrameFault
from fsai_hil.simulator.lockstep import Lockstep
from fsai_hil.simulator.world import WorldSetup
from fsai_vcu.diagnostics.decode.databases import Databases
from fsai_vcu.diagnostics.explain import Explanation, Record, explained
from fsai_vcu.diagnostics.log.frames import Frames, LogFrame, frames_of, joined
from fsai_vcu.diagnostics.page.document import of_log
from fsai_vcu.diagnostics.verdict.judging import judged
from fsai_vcu.interface.enums import Ami, AsState
from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.units import MS, S

Act = Callable[["Run"], None]


def _unjudged(_frames: Iterable[Frame]) -> None:
    """The rules of the wire are nothing to a story, and a quarter of what a run takes."""


@dataclass(eq=False)
class Run:
    """A lockstep run, the frames seen on its bus so far, and when its end was brought about."""

    lockstep: Lockstep
    frames: list[Frame] = field(default_factory=list)
    injected_ns: int = 0

    def __post_init__(self) -> None:
        self.lockstep.on_frame = self.frames.append
        self.lockstep.wire.on_frames = _unjudged  # type: ignore[method-assign]

    @classmethod
    def of(cls, setup: WorldSetup) -> Run:
        return cls(Lockstep(setup))

    @property
    def now_ns(self) -> int:
        return self.lockstep.now_ns

    def go_on(self, seconds: float) -> None:
        until_ns = self.now_ns + round(seconds * 1e9)
        while self.now_ns < until_ns:
            self.lockstep.step()

    def until(self, condition: Callable[[], bool], seconds: float = 60.0) -> None:
        until_ns = self.now_ns + round(seconds * 1e9)
        while not condition():
            assert self.now_ns < until_ns, "the car never got there"
            self.lockstep.step()

    def switch(self, **values: object) -> None:
        for name, value in values.items():
            assert hasattr(self.lockstep.world.vcu.switches, name)
            setattr(self.lockstep.world.vcu.switches, name, value)

    def spoil(self, *faults: FrameFault) -> None:
        """From now on the AI computer's frames go through these faults before anybody sees them."""
        wire, send = FaultyWire(faults), self.lockstep.computer.advance
        self.lockstep.computer.advance = lambda now_ns: wire.through(send(now_ns), now_ns)  # type: ignore[method-assign]

    def state_is(self, state: AsState) -> bool:
        return self.lockstep.world.vcu.state is state


@dataclass(frozen=True)
class Ended:
    """The log of a run, and when its end was brought about."""

    frames: Frames
    injected_ns: int


def log_of(frames: Iterable[Frame]) -> Frames:
    return frames_of(
        LogFrame(f.t_ns, "vcan0", f.can_id, f.data, extended=f.extended, remote=f.remote, error=f.error) for f in frames
    )


@cache
def _log_so_far(run: Run) -> Frames:
    return log_of(run.frames)


def branch(run: Run, act: Act, seconds: float) -> Ended:
    """What becomes of `run` when `act` is done to it now and `seconds` pass. The run itself stays where it is."""
    end = Run(deepcopy(run.lockstep), injected_ns=run.now_ns)
    act(end)
    end.go_on(seconds)
    return Ended(joined([_log_so_far(run), log_of(end.frames)]), end.injected_ns)


# ---------------------------------------------------------------- where runs branch


def setup(**changes: object) -> WorldSetup:
    chosen = WorldSetup(missions=[Ami.ACCELERATION], gps=False)
    return replace(chosen, **changes)


@cache
def driving(revision: str = "2026", profile: str = "specification") -> Run:
    """In AS_DRIVING at 3 m/s, accelerating. Cones are first seen 4 s into AS_READY: to plan earlier shows nothing."""
    run = Run.of(setup(revision=revision, profile=profile))
    run.lockstep.detects = False
    run.until(lambda: run.state_is(AsState.AS_READY) and run.lockstep.world.vcu.in_state_ns >= 4 * S)
    run.lockstep.detects = True
    run.until(lambda: run.state_is(AsState.AS_DRIVING) and run.lockstep.world.car.speed_mps >= 3.0)
    return run


def _with_everything_off() -> Run:
    """A car with everything off, an AI computer that has just begun to send."""
    run = Run.of(setup(auto=False))
    run.go_on(0.5)
    return run


parked = cache(_with_everything_off)


@cache
def off() -> Run:
    """In AS_OFF with everything up, nobody at the switches, and no mission chosen."""
    run = _with_everything_off()
    run.switch(lvms=True, asms=True, tsms=True)
    run.until(lambda: run.state_is(AsState.AS_OFF))
    return run


@cache
def ready() -> Run:
    """Half a second into AS_READY, nobody at the switches; of the mission without a path, where nobody plans one."""
    run = _with_everything_off()
    run.switch(lvms=True, asms=True, tsms=True, ami=Ami.AUTONOMOUS_DEMO)
    run.until(lambda: run.state_is(AsState.AS_READY))
    run.go_on(0.5)
    return run


def after(frames: Frames, begin_ns: int) -> Frames:
    """What a log has from `begin_ns` on: recording began late."""
    return frames.only(frames.t_ns >= begin_ns)


def cut(frames: Frames, end_ns: int) -> Frames:
    """What a log has up to `end_ns`: recording ended early."""
    return frames.only(frames.t_ns <= end_ns)


def of_ids(frames: Frames, ids: Sequence[int], since_ns: int = 0) -> Frames:
    return frames.only(np.isin(frames.can_id, ids) & (frames.t_ns >= since_ns))


def without(frames: Frames, *ids: int) -> Frames:
    return frames.only(~np.isin(frames.can_id, ids))


def in_order(*parts: Frames) -> Frames:
    whole = joined(parts)
    return whole.only(np.argsort(whole.t_ns, kind="stable"))


def twice(frames: Frames, again: Frames, late_ns: int = 4 * MS) -> Frames:
    """With some of its frames, or others, once more, so much later."""
    return in_order(frames, again.at(again.t_ns + late_ns))


def hand_made(lines: Sequence[tuple[float, int, str]]) -> Frames:
    """Frames of (seconds, identifier, payload as hex)."""
    return frames_of(LogFrame(round(t_s * 1e9), "can0", can_id, bytes.fromhex(data)) for t_s, can_id, data in lines)


def tell(frames: Frames, databases: Databases | None = None) -> Explanation:
    """What explain makes of these frames."""
    return explained(Record(frames, databases=databases))


def page(frames: Frames, name: str) -> str:
    """The report's page on these frames."""
    return of_log(judged(frames), name)
