"""The observation of a run from outside: what the checker saw on the bus, the car's true motion and its AS states.

Nothing of the bridge is looked at. Of the AI computer's inside only one thing is noted: whether the controller reports
by itself that the mission is over, for then a stop is no reaction.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

from fsai_hil.simulator.lockstep import Lockstep
from fsai_vcu.interface.enums import AsState, MissionStatus
from fsai_vcu.interface.units import MS

LOOK_NS: Final = 10 * MS
MOVING_RPM: Final = 10.0  # interface specification v4.0: under it a wheel stands
MOVING_MPS: Final = 0.25


@dataclass(slots=True)
class Observation:
    """A run as it was seen, on the bus since the fault where there was one; times are its own, in ns; None: never."""

    states: list[tuple[int, AsState]] = field(default_factory=list)  # true AS states and when they began
    had_torque: bool = False  # before the fault
    estop_ns: int | None = None
    finished_ns: int | None = None
    pause_ns: int | None = None  # the first cycle without torque
    idle_ns: int | None = None  # since when there has been no torque, to the end
    braking_ns: int | None = None  # since when the brake that ended the drive was on
    early_ns: int | None = None  # the car moved before it may, as the judge of the drive sees it
    rest_ns: int | None = None  # since when it has truly stood, to the end
    certain_ns: Mapping[int, int] = field(default_factory=dict)  # when steering or a wheel was certainly implausible
    speed_mps: float = 0.0  # at the fault
    mission_over_ns: int | None = None  # the controller reported so by itself
    left_course: int = 0  # times since the fault
    ran_out: bool = False  # the run lasted for as long as any may
    ended_ns: int = 0

    def state_at(self, t_ns: int) -> AsState:
        return next((state for since_ns, state in reversed(self.states) if since_ns <= t_ns), self.states[0][1])

    def entered(self, state: AsState, from_ns: int) -> int | None:
        """Return when `state` was first entered from a time on."""
        return next((t_ns for t_ns, one in self.states if one is state and t_ns >= from_ns), None)


class Observer:
    """Watches one run in lockstep. Call `look` after each step."""

    def __init__(self, rig: Lockstep) -> None:
        self.seen = Observation(states=rig.world.vcu.history, certain_ns=rig.wire.certain_ns)
        self._rig = rig
        self._cycles = rig.wire.cycles
        self._next_ns = rig.now_ns

    def fault_begins(self) -> None:
        """Forget what was on the bus until now: it is before the fault."""
        seen = self.seen
        seen.estop_ns = seen.finished_ns = seen.pause_ns = seen.idle_ns = seen.braking_ns = None
        seen.speed_mps = round(self._rig.world.car.speed_mps, 2)

    def look(self, fault_ns: int | None) -> None:
        """Look at the bus and the car once; fault_ns: when the fault began, None before it."""
        rig, seen = self._rig, self.seen
        seen.ended_ns = now_ns = rig.now_ns
        if rig.wire.cycles != self._cycles:
            self._cycles = rig.wire.cycles
            self._on_cycle(now_ns, fault_ns)
        if seen.mission_over_ns is None:
            command, ends_so = rig.computer.commanded, rig.world.run.judge.ends_in is AsState.EMERGENCY_BRAKE
            if command is not None and (command.mission_finished or (ends_so and command.estop_request)):
                seen.mission_over_ns = now_ns
        if now_ns < self._next_ns:
            return
        self._next_ns = now_ns + LOOK_NS
        if seen.early_ns is None:
            seen.early_ns = rig.world.run.judge.early_ns
        truth = rig.world.car.truth()
        if truth.speed_mps > MOVING_MPS or max(truth.wheel_rpm) >= MOVING_RPM:
            seen.rest_ns = None
        elif seen.rest_ns is None:
            seen.rest_ns = now_ns

    def _on_cycle(self, now_ns: int, fault_ns: int | None) -> None:
        """Note a command cycle as it left the AI computer."""
        seen, wire = self.seen, self._rig.wire
        torque, brake = max(wire.seen.torque_nm) > 0.0, max(wire.seen.brake_pct) > 0.0
        over = seen.finished_ns is not None or seen.entered(AsState.EMERGENCY_BRAKE, fault_ns or 0) is not None
        if wire.ai.estop_request and seen.estop_ns is None:
            seen.estop_ns = now_ns
        if not over:
            seen.braking_ns = (seen.braking_ns or now_ns) if brake else None
        if wire.ai.mission_status is MissionStatus.FINISHED and seen.finished_ns is None:
            seen.finished_ns = now_ns
        if fault_ns is None:
            seen.had_torque = seen.had_torque or torque
        if torque:
            seen.idle_ns = None
        else:
            seen.idle_ns, seen.pause_ns = seen.idle_ns or now_ns, seen.pause_ns or now_ns
