"""A car that does not know where the lane is: it stops in it, whatever the sensor, and says so."""

from __future__ import annotations

import math
import random

import numpy as np
import pytest
from msgspec.structs import replace

from fsai_hil.simulator.lockstep import Lockstep, confident
from fsai_hil.simulator.sensing import SensorSettings
from fsai_hil.simulator.tracks import Track, generated_circuit, load_track
from fsai_hil.simulator.world import WorldSetup
from fsai_vcu.core.driving import LOST, ConeObservation
from fsai_vcu.interface.enums import Ami, AsState
from fsai_vcu.interface.units import S
from fsai_vcu.interface.values import Value

STANDS_S, LATEST_S = 2.0, 100.0  # at rest, it has stopped; in AS_DRIVING
LOOK_NS = 50_000_000
BLIND_S = 2.0
JUMP_M = 0.5


class Trouble(Value, frozen=True):
    """A sensor, and what happens to it: it sees nothing from `blind_s` on, the pose jumps after `jump_m` of way."""

    range_m: float = 14.0
    view_deg: float = 110.0
    false_per_look: float = 0.0  # as sure as true ones
    colours: bool = True
    blind_s: float | None = None
    jump_m: float | None = None


def drawn(seed: int) -> Trouble:
    draw = random.Random(seed)
    return Trouble(
        draw.uniform(6.0, 15.0),
        draw.uniform(60.0, 180.0),
        draw.choice((0, 1, 2, 3, 4)),
        draw.random() < 0.5,
        draw.choice((None, draw.uniform(3.0, 20.0))),
        draw.choice((None, draw.uniform(10.0, 100.0))),
    )


class Drive:
    """A drive in lockstep to its end, or until the car stands, or leaves the lane."""

    def __init__(self, mission: Ami, track: Track, trouble: Trouble, seed: int = 0) -> None:
        sensor = SensorSettings(
            range_m=trouble.range_m,
            field_of_view_deg=trouble.view_deg,
            false_per_scan=trouble.false_per_look,
            colours=trouble.colours,
        )
        self._lockstep = lockstep = Lockstep(
            WorldSetup(missions=[mission], track=track, seed=seed, sensor=sensor, gps=False)
        )
        self._trouble, self._track, self._driving_ns = trouble, track, 0
        self.wheels_off, self.driven = 0, False
        self.notes: list[str] = []  # of the plans
        self.told: set[str] = set()
        lockstep.detector = self._detected
        world, stood_ns, next_look_ns = lockstep.world, 0, 0
        while not world.done and self.wheels_off < 2 and stood_ns < STANDS_S * S:
            lockstep.step()
            if lockstep.now_ns < next_look_ns:
                continue
            next_look_ns = lockstep.now_ns + LOOK_NS
            if world.vcu.state is AsState.AS_DRIVING:
                self._driving_ns = self._driving_ns or lockstep.now_ns
                self._look()
                stands = world.car.speed_mps < 0.05 and lockstep.now_ns > self._driving_ns + 6 * S
                stood_ns = stood_ns + LOOK_NS if stands else 0
                if lockstep.now_ns > self._driving_ns + LATEST_S * S:
                    break
        self.driven = world.done and world.verdict().passed
        self.stands = stood_ns >= STANDS_S * S

    def _detected(self, seen: ConeObservation) -> ConeObservation:
        if self._trouble.false_per_look:
            seen = replace(seen, confidence=np.full(len(seen.xy_m), 0.9))
        blind_s = self._trouble.blind_s
        since_s = (seen.t_ns - self._driving_ns) / S if self._driving_ns else 0.0
        if blind_s is not None and blind_s < since_s < blind_s + BLIND_S:
            return replace(seen, xy_m=seen.xy_m[:0], color=seen.color[:0], confidence=seen.confidence[:0])
        return confident(seen)

    def _look(self) -> None:
        lockstep = self._lockstep
        car = lockstep.world.car
        pose, half_m = car.pose, car.facts.track_m / 2.0
        wheels = ((x, y) for x in (0.0, car.facts.wheelbase_m) for y in (half_m, -half_m))
        self.wheels_off = sum(not self._track.on_lane(*pose.ahead(*wheel)) for wheel in wheels)
        self._jump()
        plan = lockstep.computer.plan
        if plan is not None and plan.lost:
            self.notes.append(plan.note)
            self.told.update(lockstep.computer.report().why_not_driving)

    def _jump(self) -> None:
        """The pose jumps to the left: what stands behind it is the bridge's odometry."""
        bridge, jump_m = self._lockstep.bridge, self._trouble.jump_m
        motion = bridge._state.odometry.motion
        if jump_m is None or motion.distance_m < jump_m:
            return
        self._trouble = replace(self._trouble, jump_m=None)
        yaw = motion.yaw_rad
        there = replace(motion, x_m=motion.x_m - JUMP_M * math.sin(yaw), y_m=motion.y_m + JUMP_M * math.cos(yaw))
        bridge._state = replace(bridge._state, odometry=replace(bridge._state.odometry, motion=there))


@pytest.mark.parametrize(
    ("mission", "track", "trouble"),
    [
        (Ami.AUTOCROSS, "generated-15", Trouble(6.0, 90.0, 4.0, colours=False, jump_m=10.0)),
        (Ami.SKIDPAD, "skidpad", Trouble(12.0, 60.0, 4.0, blind_s=8.0)),
    ],
    ids=lambda value: value.name.lower() if isinstance(value, Ami) else "",
)
def test_a_lost_car_stops_in_its_lane_and_says_why(mission: Ami, track: str, trouble: Trouble) -> None:
    drive = Drive(mission, load_track(track), trouble, seed=6)
    assert drive.stands and drive.wheels_off < 2
    assert all(note.startswith(LOST) and len(note) > len(LOST) for note in drive.notes)
    assert any(words.startswith(f"the controller reports: {LOST}") for words in drive.told), drive.told


@pytest.mark.long
@pytest.mark.parametrize("seed", range(60))
@pytest.mark.parametrize("mission", [Ami.AUTOCROSS, Ami.SKIDPAD, Ami.ACCELERATION], ids=lambda ami: ami.name.lower())
def test_with_any_sensor_the_car_drives_or_stops_in_its_lane(mission: Ami, seed: int) -> None:
    track = generated_circuit(seed) if mission is Ami.AUTOCROSS else load_track(mission.name.lower())
    assert Drive(mission, track, drawn(seed), seed).wheels_off < 2


@pytest.mark.long
@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("colours", [True, False])
def test_an_ordinary_sensor_is_never_lost(seed: int, colours: bool) -> None:
    drive = Drive(Ami.AUTOCROSS, generated_circuit(seed), Trouble(colours=colours), seed)
    assert drive.driven and not drive.notes
