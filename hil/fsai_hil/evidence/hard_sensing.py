"""Drives with a cone sensor so bad that the lane cannot always be known: the car drives, stops in its lane or leaves.

Stopping is right where the lane is not known; leaving it is not. A drive ends as soon as one of the three is certain.
"""

from __future__ import annotations

import math
import random
from enum import Enum
from typing import Final

import numpy as np
from msgspec.structs import replace

from fsai_hil.simulator.lockstep import Lockstep, LockstepResult, confident
from fsai_hil.simulator.sensing import SensorSettings
from fsai_hil.simulator.tracks import Track
from fsai_hil.simulator.world import WorldSetup
from fsai_vcu.core.driving import ConeObservation
from fsai_vcu.interface.enums import Ami, AsState
from fsai_vcu.interface.units import S
from fsai_vcu.interface.values import Value

STANDS_S: Final = 4.0  # at rest: it has stopped, and does not see its way again
LATEST_S: Final = 100.0  # in AS_DRIVING and moving; longer where the way is so long …
SLOWEST_MPS: Final = 2.0  # … that a car which drives no faster in the mean has not come to its end by then
LOOK_NS: Final = 50_000_000
BLIND_S: Final = 2.0
JUMP_M: Final = 0.5
CERTAIN: Final = 0.9  # confidence of a false cone


class DriveEnd(Enum):
    """The ways in which a drive ends."""

    DRIVEN = "driven"
    STOPPED = "stopped in lane"
    LEFT = "left the lane"  # with a second wheel
    NEITHER = "neither driven nor stopped"


class Trouble(Value, frozen=True):
    """A sensor, and what happens to it: it sees nothing from `blind_s` on, the pose jumps after `jump_m` of way."""

    range_m: float = 14.0
    view_deg: float = 110.0
    false_per_look: float = 0.0  # as sure as true ones
    colours: bool = True
    blind_s: float | None = None
    jump_m: float | None = None


def drawn(seed: int) -> Trouble:
    """Return the trouble of a seed, from hardly any to more than can be driven with."""
    draw = random.Random(seed)
    return Trouble(
        draw.uniform(6.0, 15.0),
        draw.uniform(60.0, 180.0),
        draw.choice((0, 1, 2, 3, 4)),
        draw.random() < 0.5,
        draw.choice((None, draw.uniform(3.0, 20.0))),
        draw.choice((None, draw.uniform(10.0, 100.0))),
    )


class HardDrive:
    """A drive in lockstep until its ending is certain."""

    def __init__(self, mission: Ami, track: Track, trouble: Trouble, seed: int = 0) -> None:
        """Drive it, to the end."""
        sensor = SensorSettings(
            range_m=trouble.range_m,
            field_of_view_deg=trouble.view_deg,
            false_per_scan=trouble.false_per_look,
            colours=trouble.colours,
        )
        setup = WorldSetup(missions=[mission], track=track, seed=seed, sensor=sensor, gps=False)
        self.lockstep = lockstep = Lockstep(setup)
        self._trouble, self._track, self._driving_ns = trouble, track, 0
        self.notes: list[str] = []  # of the plans of a car that is lost
        self.told: set[str] = set()  # to people, meanwhile
        lockstep.detector = self._detected
        world, stood_ns, moved_ns, next_look_ns = lockstep.world, 0, 0, 0
        wheels_off = 0
        latest_s = max(LATEST_S, track.length_m / SLOWEST_MPS)
        while not world.done and wheels_off < 2 and stood_ns < STANDS_S * S:
            lockstep.step()
            if lockstep.now_ns < next_look_ns:
                continue
            next_look_ns = lockstep.now_ns + LOOK_NS
            if world.vcu.state is AsState.AS_DRIVING:
                self._driving_ns = self._driving_ns or lockstep.now_ns
                wheels_off = self._look()
                stands = world.car.speed_mps < 0.05 and lockstep.now_ns > self._driving_ns + 6 * S
                stood_ns = stood_ns + LOOK_NS if stands else 0
                moved_ns += 0 if stands else LOOK_NS
                if moved_ns > latest_s * S:
                    break
        if wheels_off >= 2:
            self.ending = DriveEnd.LEFT
        elif stood_ns >= STANDS_S * S:
            self.ending = DriveEnd.STOPPED
        else:
            driven = world.done and world.verdict().passed
            self.ending = DriveEnd.DRIVEN if driven else DriveEnd.NEITHER

    def result(self) -> LockstepResult:
        """Return what the judge, the wire and the bridge have to say of the drive so far."""
        lockstep = self.lockstep
        world, setup = lockstep.world, lockstep.world.setup
        sim_s = (lockstep.now_ns - setup.start_ns) / S
        faults = world.vcu.faults.names
        return LockstepResult(
            world.verdict(), lockstep.wire, lockstep.computer.report(), sim_s, 0.0, setup.seed, faults
        )

    def _detected(self, seen: ConeObservation) -> ConeObservation:
        if self._trouble.false_per_look:
            seen = replace(seen, confidence=np.full(len(seen.xy_m), CERTAIN))
        blind_s = self._trouble.blind_s
        since_s = (seen.t_ns - self._driving_ns) / S if self._driving_ns else 0.0
        if blind_s is not None and blind_s < since_s < blind_s + BLIND_S:
            return replace(seen, xy_m=seen.xy_m[:0], color=seen.color[:0], confidence=seen.confidence[:0])
        return confident(seen)

    def _look(self) -> int:
        """Return how many wheels are off the lane."""
        lockstep = self.lockstep
        car = lockstep.world.car
        pose, half_m = car.pose, car.facts.track_m / 2.0
        self._jump()
        plan = lockstep.computer.plan
        if plan is not None and plan.lost:
            self.notes.append(plan.note)
            self.told.update(lockstep.computer.report().why_not_driving)
        wheels = ((x, y) for x in (0.0, car.facts.wheelbase_m) for y in (half_m, -half_m))
        return sum(not self._track.on_lane(*pose.ahead(*wheel)) for wheel in wheels)

    def _jump(self) -> None:
        """The pose jumps to the left: what stands behind it is the bridge's odometry."""
        bridge, jump_m = self.lockstep.bridge, self._trouble.jump_m
        motion = bridge._state.odometry.motion
        if jump_m is None or motion.distance_m < jump_m:
            return
        self._trouble = replace(self._trouble, jump_m=None)
        yaw = motion.yaw_rad
        there = replace(motion, x_m=motion.x_m - JUMP_M * math.sin(yaw), y_m=motion.y_m + JUMP_M * math.cos(yaw))
        bridge._state = replace(bridge._state, odometry=replace(bridge._state.odometry, motion=there))
