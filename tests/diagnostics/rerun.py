"""A recorded run once more: the car's frames of a log, and the commands of then, to a bridge of today.

In virtual time and without a bus. The bridge hears what it heard then, at the instants of then; what it sends is
compared with what was sent then, frame by frame and byte by byte. A difference is a decision that is made otherwise
today, so a log of a good run is a regression test.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, cast

from fsai_hil.simulator.ai_computer import OnboardComputer
from fsai_vcu.core.bridge import Bridge
from fsai_vcu.core.command import VehicleCommand
from fsai_vcu.core.control.controller import Controller
from fsai_vcu.core.driving import ConeObservation, Motion, Plan, Run
from fsai_vcu.core.planning.planner import Planner
from fsai_vcu.interface.codec import Codec
from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.reserved import AI_IDS

STEP_NS = 1_000_000  # how often the clock is looked at: as in the lockstep simulation, whose logs are exact to the byte


class RecordedCommands:
    """Stands where planner and controller stood: confirms every run, and commands what was commanded then."""

    def __init__(self, commands: Iterable[tuple[int, VehicleCommand]]) -> None:
        """(when it was given, command), in order of time."""
        self._given = deque(commands)

    def reset(self, run: Run) -> None:
        """Nothing is remembered."""

    def on_run(self, run: Run) -> None:
        """The run goes as it went."""

    def on_cones(self, observation: ConeObservation, motion: Motion) -> Plan | None:
        """Cones were seen then: what came of them is in the commands."""
        return None

    def command(self, *seen: Any) -> VehicleCommand:
        """As a controller is asked, with the run and the instant last; `given` decides what becomes of it."""
        run, now_ns = cast(Run, seen[-2]), cast(int, seen[-1])
        return VehicleCommand(now_ns, run.run_id)

    def given(self, command: VehicleCommand, now_ns: int) -> VehicleCommand | None:
        """What was commanded by now and has not been passed on; None where there was silence."""
        newest = None
        while self._given and self._given[0][0] <= now_ns:
            newest = self._given.popleft()[1]
        return newest


def rerun(
    bridge: Bridge,
    codec: Codec,
    commands: Iterable[tuple[int, VehicleCommand]],
    car_frames: Sequence[Frame],
    start_ns: int,
    end_ns: int,
) -> list[Frame]:
    """What `bridge`, begun at `start_ns`, sends while it hears `car_frames`, which are in order of time."""
    stack = RecordedCommands(commands)
    computer = OnboardComputer(bridge, codec, cast(Planner, stack), cast(Controller, stack), start_ns)
    computer.command_filter = stack.given
    sent: list[Frame] = []
    asked_autonomous = False
    heard = 0
    for now_ns in range(start_ns + STEP_NS, end_ns + 1, STEP_NS):
        while heard < len(car_frames) and car_frames[heard].t_ns <= now_ns:
            computer.on_frame(car_frames[heard])
            heard += 1
        if not asked_autonomous:
            asked_autonomous = bridge.set_mode("autonomous", now_ns)[0]
        sent += computer.advance(now_ns)
    return sent


@dataclass(frozen=True, slots=True)
class Difference:
    """One frame of then against one of now; None: there was, or is, none. Compared are time, id and all bytes."""

    t_ns: int
    can_id: int
    then: bytes | None
    now: bytes | None

    def __str__(self) -> str:
        then, now = ("nothing" if data is None else data.hex(" ").upper() for data in (self.then, self.now))
        return f"{self.t_ns / 1e9:.3f} s 0x{self.can_id:03X}: then {then}, now {now}"


@dataclass(frozen=True, slots=True)
class Comparison:
    """How the frames of the AI computer compare. same: by id, how many are equal."""

    same: Counter[int]
    differences: tuple[Difference, ...]

    @property
    def equal(self) -> bool:
        return not self.differences


def compare(then: Iterable[Frame], now: Iterable[Frame]) -> Comparison:
    """The AI computer's five messages, each at its instant."""
    recorded = {(f.t_ns, f.can_id): f.data for f in then if f.can_id in AI_IDS}
    again = {(f.t_ns, f.can_id): f.data for f in now if f.can_id in AI_IDS}
    same: Counter[int] = Counter()
    differences = []
    for key in sorted(recorded.keys() | again.keys()):
        before, after = recorded.get(key), again.get(key)
        if before == after:
            same[key[1]] += 1
        else:
            differences.append(Difference(*key, before, after))
    return Comparison(same, tuple(differences))
