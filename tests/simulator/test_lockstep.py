"""The whole AI side against the whole car: every mission passes, and what breaks on the way ends as the rules say."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace

from fsai_hil.simulator.car import Pose
from fsai_hil.simulator.car_signals import CarFeedback
from fsai_hil.simulator.lockstep import Lockstep, confident
from fsai_hil.simulator.tracks import Track, as_csv, parse_track, skidpad_track, small_oval
from fsai_hil.simulator.world import WorldSetup
from fsai_vcu.core.command import VehicleCommand
from fsai_vcu.core.control.settings import ControllerSettings
from fsai_vcu.core.driving import ConeColor, ConeObservation
from fsai_vcu.core.limits import OperationalLimits
from fsai_vcu.core.vehicle.parameters import ADS_DV_2026
from fsai_vcu.diagnostics.explain import Record, explained
from fsai_vcu.diagnostics.log.frames import LogFrame, frames_of
from fsai_vcu.interface.enums import Ami, AsState
from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.units import S

OVAL, NOSE_M = small_oval(), ADS_DV_2026.nose_ahead_of_rear_axle_m


def oval(**changes: object) -> WorldSetup:
    """A short lap: the quickest run that has everything in it."""
    setup = WorldSetup(missions=[Ami.AUTOCROSS], track=OVAL, gps=False)
    return replace(setup, **changes)  # type: ignore[arg-type]


def drive_until(lockstep: Lockstep, speed_mps: float) -> None:
    """To the moment in AS_DRIVING when the car has reached a speed."""
    while lockstep.world.vcu.state is not AsState.AS_DRIVING or lockstep.world.car.speed_mps < speed_mps:
        lockstep.step()
        assert lockstep.now_ns < 60 * S, "the car never drove"


def without_gate() -> Track:
    """The oval as a file has it that knows nothing of a gate."""
    kept = OVAL.cone_colors != ConeColor.BIG_ORANGE
    track = replace(OVAL, cones_xy_m=OVAL.cones_xy_m[kept], cone_colors=OVAL.cone_colors[kept])
    return parse_track(as_csv(track, OVAL.staging(Ami.AUTOCROSS, NOSE_M)), "loop.csv")


def unsure(seen: ConeObservation) -> ConeObservation:
    """A detector that reports false cones, too."""
    return seen


def colourless(seen: ConeObservation) -> ConeObservation:
    return replace(confident(seen), color=np.zeros_like(confident(seen).color))


def drifting(feedback: CarFeedback, _now_ns: int) -> CarFeedback:
    """Wheels that are 3 % smaller than thought."""
    fl, fr, rl, rr = (1.03 * rpm for rpm in feedback.wheel_rpm)
    return replace(feedback, wheel_rpm=(fl, fr, rl, rr))


DISPLACED = replace(skidpad_track(), car_start=Pose(-15.0 - NOSE_M - 2.8, 0.0, 0.0))


@pytest.mark.parametrize(
    ("setup", "detector", "sensors", "power_cycles"),
    [
        (WorldSetup(missions=[Ami.ACCELERATION, Ami.STATIC_INSPECTION_B]), confident, (), 1),
        (WorldSetup(missions=[Ami.STATIC_INSPECTION_A, Ami.AUTONOMOUS_DEMO], revision="2021"), confident, (), 0),
        (WorldSetup(missions=[Ami.SKIDPAD], track=DISPLACED, revision="2021", gps=False), colourless, (drifting,), 0),
        pytest.param(oval(), confident, (), 0, marks=pytest.mark.long),  # on vcan0, and with examples/, it is driven
        pytest.param(
            *(oval(missions=[Ami.TRACKDRIVE], track=without_gate(), laps=2, revision="2021"), unsure, (), 0),
            marks=pytest.mark.long,
        ),
    ],
    ids=lambda value: value.missions[0].name.lower() if isinstance(value, WorldSetup) else "",
)
def test_every_mission_passes_by_the_rules_with_no_guard_acting(
    setup: WorldSetup, detector: Any, sensors: tuple[Any, ...], power_cycles: int
) -> None:
    """In one revision each, some with a PCAN-GPS; a second mission follows without a restart of ours.

    Planner and judge find the circles of the skidpad from elsewhere, without colours and in drift, and count laps
    where no gate is. The campaign's full-length runs drive all in both revisions.
    """
    lockstep = Lockstep(setup)
    lockstep.detector = detector
    lockstep.world.sensor_faults += sensors
    result, world = lockstep.run(), lockstep.world
    assert [verdict.result for verdict in world.verdicts] == ["pass"] * len(setup.missions), world.verdicts
    assert sum(verdict.cones_hit for verdict in world.verdicts) == 0
    assert result.wire.ok, result.wire
    assert result.report.reason_counts == {}, "a guard acted in a nominal run"
    assert result.report.problem_counts == {}
    assert world.vcu.power_cycles == power_cycles


def test_the_official_simulators_quirks_are_coped_with() -> None:
    result = Lockstep(WorldSetup(missions=[Ami.AUTONOMOUS_DEMO], profile="official-simulator", gps=False)).run()
    assert result.verdict.result == "pass", result.verdict.reasons
    assert not any("brake" in violation and "together" in violation for violation in result.wire.violations)


def test_the_same_seed_is_the_same_run_and_another_seed_another() -> None:
    runs = []
    for seed in (3, 3, 4):
        lockstep = Lockstep(WorldSetup(missions=[Ami.ACCELERATION], gps=False, seed=seed))
        drive_until(lockstep, 1.0)
        runs.append((replace(lockstep.world.truth, seed=0), lockstep.computer.report()))
    assert runs[0] == runs[1]
    assert runs[0] != runs[2]


def test_a_car_that_sees_no_track_says_so_and_ends() -> None:
    frames: list[LogFrame] = []

    def log(frame: Frame) -> None:
        frames.append(LogFrame(frame.t_ns, "vcan0", frame.can_id, frame.data))

    lockstep = Lockstep(oval(), controller=ControllerSettings(give_up_s=6.0), on_frame=log)
    lockstep.detector = lambda seen: replace(
        seen, xy_m=seen.xy_m[:0], color=seen.color[:0], confidence=seen.xy_m[:0, 0]
    )
    told: set[str] = set()
    result = lockstep.run(lambda _world, report: told.update(report.why_not_driving))
    assert any(words.startswith("the controller reports: no path: ") for words in told), told
    assert lockstep.world.vcu.state is AsState.EMERGENCY_BRAKE and result.wire.ok, result.wire
    assert "the car has stood for 6 s: no path: " in (result.report.emergency or "")
    (incident,) = explained(Record(frames_of(frames))).incidents
    assert incident.candidates[0].slug == "brake_held"


def test_operational_limits_are_never_exceeded() -> None:
    limits = OperationalLimits(max_speed_mps=3.0, max_axle_torque_nm=60.0, max_steer_deg=8.0)
    asked: list[tuple[float, float, float]] = []
    lockstep = Lockstep(oval(), limits=limits)

    def watch(command: VehicleCommand, now_ns: int) -> VehicleCommand:
        sent = lockstep.bridge.report(now_ns).command
        asked.append((sent.rear_torque_nm, abs(sent.steer_deg), lockstep.world.car.speed_mps))
        return replace(command, speed_limit_mps=20.0)  # the driver does not keep to it

    lockstep.computer.command_filter = watch
    drive_until(lockstep, 2.0)
    into_a_bend_ns = lockstep.now_ns + 8 * S
    while lockstep.now_ns < into_a_bend_ns:
        lockstep.step()
    assert lockstep.world.vcu.state is AsState.AS_DRIVING
    # Torque and steering come to their limits, and no further.
    assert 59.0 < max(torque for torque, _, _ in asked) <= 60.0
    assert 7.9 < max(steer for _, steer, _ in asked) <= 8.0
    assert 2.5 < max(speed for _, _, speed in asked) <= 3.0 * 1.05


@pytest.mark.parametrize(
    "mission",
    [Ami.ACCELERATION, Ami.STATIC_INSPECTION_A, Ami.AUTONOMOUS_DEMO],  # along a path, on stands, by itself
    ids=lambda ami: ami.name.lower(),
)
def test_max_speed_is_kept_by_each_kind_of_control(mission: Ami) -> None:
    lockstep = Lockstep(
        WorldSetup(missions=[mission], laps=1, gps=False), controller=ControllerSettings(max_speed_mps=3.0)
    )
    speeds = [0.0]
    on_stands = mission is Ami.STATIC_INSPECTION_A

    def watch(command: VehicleCommand, now_ns: int) -> VehicleCommand:
        wheels = lockstep.bridge.report(now_ns).vehicle.speeds
        rpm = max(wheels.all_rpm) if wheels is not None else 0
        speeds.append(ADS_DV_2026.speed_of_wheel_rpm(rpm) if on_stands else lockstep.world.car.speed_mps)
        return command

    lockstep.computer.command_filter = watch
    reached_ns = 0
    while not reached_ns or lockstep.now_ns < reached_ns + 3 * S:
        lockstep.step()
        assert lockstep.now_ns < 60 * S, "it never came near its limit"
        reached_ns = reached_ns or (lockstep.now_ns if max(speeds) > 2.5 else 0)
    assert max(speeds) < 3.0 * 1.03
