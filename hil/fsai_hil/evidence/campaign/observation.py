"""The observation of a run from outside: the frames on the bus, the car's true motion, its AS states.

Nothing of the bridge is looked at. Of the AI computer's inside only one thing is noted: whether the controller reports
by itself that the mission is over, for then a stop is no reaction.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import takewhile
from typing import Final

from fsai_hil.rules.wheels import Belief, Wheels
from fsai_hil.simulator.lockstep import Lockstep
from fsai_vcu.core.vehicle.parameters import VehicleParameters
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
        """Return when `state` was first entered after a time."""
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
        """Note the command cycles, requests and measurements that a frame carries."""
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
            command, ends_so = rig.computer.commanded, rig.world.run.judge.ends_in is AsState.EMERGENCY_BRAKE
            if command is not None and (command.mission_finished or (ends_so and command.estop_request)):
                seen.mission_over_ns = now_ns
        if now_ns < self._next_ns:
            return
        self._next_ns = now_ns + LOOK_NS
        truth = rig.world.car.truth()
        seen.moving.append((now_ns, truth.speed_mps > MOVING_MPS or max(truth.wheel_rpm) >= MOVING_RPM))


# ---------------------------------------------------------------- since when something is certainly implausible

# Worked out from the frames and nothing else. Sure means: by more than the rules' own margin, so that a correct
# supervisor cannot overlook it.

# The official simulator's steering: 50 ms dead time, 40 deg/s (the true rate was never published), 0.9 deg play.
STEER_DEAD_NS: Final = 50 * MS
STEER_RATES_DEGPS: Final = (30.0, 50.0)
STEER_SURE_DEG: Final = 0.9 + 2.0 + 0.6

WHEEL_SURE_RPM: Final = 80.0
WHEEL_SURE_SHARE: Final = 0.40
SLIP_NS: Final = 1050 * MS  # torque or brake so long ago still explains a slipping wheel

Streak = tuple[int, int]


def steering_streaks(seen: Observation, car: VehicleParameters, from_ns: int) -> list[Streak]:
    """Return when, in AS_DRIVING, the measured angle was certainly not where the requests can have brought it."""
    streaks: list[Streak] = []
    slow = fast = None
    target = 0.0
    index = 0
    before_ns = from_ns
    for t_ns, angle in seen.angles:
        while index < len(seen.requests) and seen.requests[index][0] + STEER_DEAD_NS <= t_ns:
            target = seen.requests[index][1]
            index += 1
        if slow is None or fast is None or t_ns < from_ns or t_ns - before_ns > 50 * MS:
            slow = fast = angle
            before_ns = t_ns
            continue
        step_s = (t_ns - before_ns) / 1e9
        before_ns = t_ns
        slow = _toward(slow, target, STEER_RATES_DEGPS[0] * step_s)
        fast = _toward(fast, target, STEER_RATES_DEGPS[1] * step_s)
        off = not min(slow, fast) - STEER_SURE_DEG <= angle <= max(slow, fast) + STEER_SURE_DEG
        if off and seen.state_at(t_ns) is AsState.AS_DRIVING:
            _extend(streaks, t_ns)
    return streaks


def wheel_streaks(seen: Observation, car: VehicleParameters, from_ns: int) -> list[Streak]:
    """Return when one wheel was certainly off the other three, and neither wheelspin nor locking could explain it."""
    driven = (car.driven_front, car.driven_front, car.driven_rear, car.driven_rear)
    odd: dict[tuple[int, bool], list[Streak]] = {}
    angles = iter(seen.angles)
    angle_ns, angle = next(angles, (0, 0.0))
    upcoming = next(angles, None)
    for t_ns, rpm in seen.wheels:
        while upcoming is not None and upcoming[0] <= t_ns:
            angle_ns, angle = upcoming
            upcoming = next(angles, None)
        if t_ns < from_ns or seen.state_at(t_ns) is not AsState.AS_DRIVING or angle_ns > t_ns:
            continue
        rolling = [value / factor for value, factor in zip(rpm, _factors(car, angle), strict=True)]
        for wheel in range(4):
            middle = sorted(rolling[:wheel] + rolling[wheel + 1 :])[1]
            beyond = rolling[wheel] - middle
            if abs(beyond) > WHEEL_SURE_RPM + WHEEL_SURE_SHARE * middle:
                _extend(odd.setdefault((wheel, beyond > 0), []), t_ns)
    found: list[Streak] = []
    for (wheel, too_fast), streaks in odd.items():
        for start_ns, end_ns in streaks:
            sure_ns = start_ns
            for cycle in seen.cycles:
                if cycle.t_ns > sure_ns:
                    break  # what is asked for once a wheel is odd explains nothing any more
                torque = cycle.torque_nm > 0.0 and driven[wheel]  # spins it, or drags it at its speed limit
                if torque or (cycle.brake_pct > 0.0 and not too_fast):
                    sure_ns = max(sure_ns, cycle.t_ns + SLIP_NS)
            if sure_ns < end_ns:
                found.append((sure_ns, end_ns))
    return sorted(found)


def count_streaks(seen: Observation, car: VehicleParameters, from_ns: int) -> list[Streak]:
    """Return when, in AS_DRIVING, wheel speeds came that certainly may not be believed."""
    wheels = Wheels(car.wheel_pulses_per_rev)
    streaks: list[Streak] = []
    frames = [(t_ns, 0, rpm) for t_ns, rpm in seen.wheels] + [(t_ns, 1, counts) for t_ns, counts in seen.counts]
    for t_ns, kind, values in sorted(frames):
        if kind:
            wheels.on_counts(values, t_ns)
        elif (
            wheels.on_speeds(values, t_ns) is Belief.NO
            and t_ns >= from_ns
            and (seen.state_at(t_ns) is AsState.AS_DRIVING)
        ):
            _extend(streaks, t_ns)
    return streaks


def _factors(car: VehicleParameters, steer_deg: float) -> tuple[float, float, float, float]:
    """Return by how much faster each wheel rolls on its own circle than the middle of the rear axle."""
    curvature = math.tan(math.radians(steer_deg)) / car.wheelbase_m
    left, right = 1.0 - curvature * car.track_m / 2.0, 1.0 + curvature * car.track_m / 2.0
    ahead = curvature * car.wheelbase_m
    return math.hypot(left, ahead), math.hypot(right, ahead), left, right


def _extend(streaks: list[Streak], t_ns: int) -> None:
    if streaks and t_ns - streaks[-1][1] <= 15 * MS:
        streaks[-1] = (streaks[-1][0], t_ns)
    else:
        streaks.append((t_ns, t_ns))


def _toward(value: float, target: float, most: float) -> float:
    return max(value - most, min(value + most, target))
