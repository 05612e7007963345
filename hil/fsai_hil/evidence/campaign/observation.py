"""What was seen of a run from outside: the frames on the bus, the car's true motion, its AS states.

Nothing of the bridge is looked at. Of the AI computer's inside only one thing is noted: whether the controller reports
by itself that the mission is over, for then a stop is no reaction.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import takewhile
from typing import Final

from fsai_hil.simulator.lockstep import Lockstep
from fsai_vcu.interface.enums import AsState, MissionStatus
from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.messages import (
    AiBrake,
    AiDriveFront,
    AiDriveRear,
    AiStatus,
    AiSteer,
    VcuSteer,
    WheelCounts,
    WheelSpeeds,
)
from fsai_vcu.interface.units import MS

LOOK_NS: Final = 10 * MS
MOVING_RPM: Final = 10.0  # interface specification v4.0: under it a wheel stands
MOVING_MPS: Final = 0.25


@dataclass(slots=True)
class Cycle:
    """One command cycle as it was on the bus."""

    t_ns: int
    estop: bool
    finished: bool
    torque_nm: float = 0.0
    brake_pct: float = 0.0


@dataclass(slots=True)
class Observation:
    """Everything seen since the observer began. Times are the run's own, in ns."""

    cycles: list[Cycle] = field(default_factory=list)
    requests: list[tuple[int, float]] = field(default_factory=list)  # steering, deg
    angles: list[tuple[int, float]] = field(default_factory=list)  # steering as measured, deg
    wheels: list[tuple[int, tuple[int, int, int, int]]] = field(default_factory=list)
    counts: list[tuple[int, tuple[int, int, int, int]]] = field(default_factory=list)
    moving: list[tuple[int, bool]] = field(default_factory=list)  # the car's true motion
    states: list[tuple[int, AsState]] = field(default_factory=list)  # true AS states and when they began
    speed_mps: float = 0.0  # at the fault
    mission_over_ns: int | None = None  # the controller reported so by itself
    left_course: int = 0  # times since the fault
    ran_out: bool = False  # the run lasted for as long as any may
    ended_ns: int = 0

    def state_at(self, t_ns: int) -> AsState:
        return next((state for since_ns, state in reversed(self.states) if since_ns <= t_ns), self.states[0][1])

    def entered(self, state: AsState, after_ns: int) -> int | None:
        """When `state` was first entered after a time."""
        return next((t_ns for t_ns, one in self.states if one is state and t_ns > after_ns), None)

    def resting_since(self) -> int | None:
        """Since when the car has truly stood, to the end; None: it moves."""
        standing = list(takewhile(lambda look: not look[1], reversed(self.moving)))
        return standing[-1][0] if standing else None

    def cycles_after(self, t_ns: int) -> Sequence[Cycle]:
        return self.cycles[bisect_right(self.cycles, t_ns, key=lambda cycle: cycle.t_ns) :]


class Observer:
    """Watches one run in lockstep. Call `look` after each step."""

    def __init__(self, rig: Lockstep) -> None:
        self.seen = Observation(states=rig.world.vcu.history)
        self._rig = rig
        self._next_ns = rig.now_ns
        rig.watch = self._on_frame

    def _on_frame(self, frame: Frame) -> None:
        can_id = frame.can_id
        if not (0x510 <= can_id <= 0x514 or can_id in (0x523, 0x525, 0x526)) or frame.extended or frame.error:
            return
        image = self._rig.world.codec.decode(frame).image
        seen = self.seen
        if isinstance(image, AiStatus):
            finished = image.mission_status is MissionStatus.FINISHED
            seen.cycles.append(Cycle(frame.t_ns, image.estop_request, finished))
        elif isinstance(image, AiSteer):
            seen.requests.append((frame.t_ns, image.steer_deg))
        elif isinstance(image, VcuSteer):
            seen.angles.append((frame.t_ns, image.angle_deg))
        elif isinstance(image, WheelSpeeds):
            seen.wheels.append((frame.t_ns, image.all_rpm))
        elif isinstance(image, WheelCounts):
            seen.counts.append((frame.t_ns, (image.fl, image.fr, image.rl, image.rr)))
        elif seen.cycles:
            cycle = seen.cycles[-1]
            if isinstance(image, AiDriveFront | AiDriveRear):
                cycle.torque_nm = max(cycle.torque_nm, image.torque_nm)
            elif isinstance(image, AiBrake):
                cycle.brake_pct = max(image.front_pct, image.rear_pct)

    def look(self) -> None:
        rig, seen = self._rig, self.seen
        now_ns = rig.now_ns
        seen.ended_ns = now_ns
        if seen.mission_over_ns is None:
            command = rig.computer.commanded
            if command is not None and (command.mission_finished or command.estop_request):
                seen.mission_over_ns = now_ns
        if now_ns < self._next_ns:
            return
        self._next_ns = now_ns + LOOK_NS
        truth = rig.world.car.truth()
        seen.moving.append((now_ns, truth.speed_mps > MOVING_MPS or max(truth.wheel_rpm) >= MOVING_RPM))
