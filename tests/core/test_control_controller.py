"""The controller: from plan and motion to a command."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace

from fsai_hil.simulator.car import Car, Pose
from fsai_hil.simulator.car_signals import Actuation
from fsai_vcu.core.command import VehicleCommand
from fsai_vcu.core.control.controller import FEEL_ITS_WAY_MPS, Controller
from fsai_vcu.core.control.pace import ANGLE_RAD, Pace
from fsai_vcu.core.control.path_tracking import STEP_M, PathLine, line_of
from fsai_vcu.core.control.settings import ControllerSettings
from fsai_vcu.core.control.sight import BEYOND_CONES_M, CLEAR, CLEAR_OVER_M
from fsai_vcu.core.control.speed_profile import braking_share, speed_profile
from fsai_vcu.core.driving import LOST, Motion, Plan, Run
from fsai_vcu.core.missions.settings import MissionSettings
from fsai_vcu.core.planning.pose import resampled
from fsai_vcu.core.planning.settings import PlannerSettings
from fsai_vcu.core.supervision.gate import constant_power_nm
from fsai_vcu.core.vehicle.forces import brake_for, throttle_for
from fsai_vcu.core.vehicle.parameters import (
    ADS_DV_2021,
    ADS_DV_2026,
    CARS,
    SLIP_LEAST_RADPMPS2,
    SLIP_MOST_RADPMPS2,
    VehicleParameters,
)
from fsai_vcu.interface.enums import Ami, AsState
from fsai_vcu.interface.units import MS

CAR = ADS_DV_2026
RUN = Run(3, Ami.AUTOCROSS, AsState.AS_DRIVING, may_move=True)
STRAIGHT = np.column_stack((np.arange(0.0, 20.0, 0.5), np.zeros(40)))
SETTINGS = ControllerSettings()
HELD = ControllerSettings(lap_max_speed_mps=7.0)
ON_AND_ON = replace(HELD, end_of_path_mps=7.0)
AT_5_MPS = ControllerSettings(lap_max_speed_mps=5.0, lateral_mps2=6.0, end_of_path_mps=5.0)


def arc(radius: float, length: float = 18.0) -> np.ndarray:
    a = np.arange(0.0, length, 0.5) / radius
    return np.column_stack((radius * np.sin(a), radius * (1.0 - np.cos(a))))


def moved(path: np.ndarray, x_m: float, y_m: float) -> np.ndarray:
    return path + np.array([x_m, y_m])


def bend_after(straight_m: float, radius: float) -> np.ndarray:
    """Straight on, then a left bend."""
    straight = np.column_stack((np.arange(0.0, straight_m, 0.5), np.zeros(round(2 * straight_m))))
    return np.concatenate((straight, moved(arc(radius, 9.0), straight_m, 0.0)))


def path_of(*pieces: tuple[float, float]) -> np.ndarray:
    """Pieces one after another, each a length (m) and a curvature (1/m)."""
    curvature = np.concatenate([np.full(round(length / 0.01), bend) for length, bend in pieces])
    heading = np.cumsum(curvature * 0.01)
    fine = np.cumsum(np.stack((np.cos(heading), np.sin(heading)), axis=-1) * 0.01, axis=0)
    return resampled(np.concatenate((np.zeros((1, 2)), fine)), 0.5)


class Drive:
    """The controller on a simulated car, with a plan every 50 ms that is as old when it comes; looked at every 10 ms.

    every: another number of ticks of 10 ms from plan to plan; silent_from_m: none is sent beyond that place;
    noise_m: the paths of successive plans move and bend by so much; stop_m: the stopping place; more: fields of every
    plan, or functions that return them of the place. Both are metres along the path.
    """

    def __init__(
        self,
        path: np.ndarray,
        settings: ControllerSettings,
        noise_m: float = 0.0,
        ahead_m: float | Callable[[float], float] = 20.0,
        mission: Ami = RUN.mission,
        stop_m: float | None = None,
        every: int = 5,
        silent_from_m: float = math.inf,
        **more: Any,
    ) -> None:
        run = replace(RUN, mission=mission)
        controller = reset_for(run, CAR, settings)
        car, plans, chance = Car(CAR, Pose()), [], np.random.default_rng(1)
        fine = resampled(path, 0.05)
        at = steer_deg = x = y = yaw = way = 0.0
        command = VehicleCommand(0, run.run_id)
        looks = []
        for tick in range(6000):
            now, truth = tick * 10 * MS, car.truth()
            speed, turned = truth.speed_mps, truth.yaw_rate_radps * 0.01
            step = speed * 0.01  # as wheels and yaw rate have it, which know nothing of slipping tyres
            x, y, yaw, way = x + step * math.cos(yaw), y + step * math.sin(yaw), yaw + turned, way + step
            head = fine[int(at) : int(at) + 60]
            at += float(((head - (truth.pose.x_m, truth.pose.y_m)) ** 2).sum(axis=1).argmin())
            if at > len(fine) - 80 or (command.brake > 0.0 and speed == 0.0):
                break
            if tick % every == 0 and at * 0.05 < silent_from_m:
                length_m = ahead_m(at * 0.05) if callable(ahead_m) else ahead_m
                ahead = path[int(at) // 10 :][: round(length_m / 0.5)]
                seen = np.column_stack(truth.pose.seen(*ahead.T))
                s, (a, b, c) = np.arange(len(seen)) / 40.0, chance.normal(0.0, noise_m, 3)
                seen[:, 1] += a + 2.0 * b * s + c * np.sin(8.0 * s)
                said = {name: value(at * 0.05) if callable(value) else value for name, value in more.items()}
                if stop_m is not None:
                    said |= {"stop_distance_m": stop_m - way, "finished": stop_m - way < 20.0}
                plans.append(plan_of(seen, now, mission=mission, **said))
            plan = plans[max(len(plans) - 2, 0)]
            if tick % 2 == 0:
                motion = Motion(now, x, y, yaw, speed, truth.yaw_rate_radps, way)
                command = controller.command(plan, motion, False, (0.0,) * 4, 0.0, run, now)
            wanted_deg = math.degrees(command.steering_rad)
            steer_deg = min(max(wanted_deg, steer_deg - 0.4), steer_deg + 0.4)
            brake = 100.0 * command.brake
            torque = command.throttle * constant_power_nm(round(truth.wheel_rpm[2]))
            car.advance(now + 10 * MS, Actuation(steer_deg, 0.0, torque, 4000, 4000, brake, brake, False, True))
            here, on = fine[int(at)], fine[int(at) + 1] - fine[int(at)]
            beside = ((truth.pose.y_m - here[1]) * on[0] - (truth.pose.x_m - here[0]) * on[1]) / 0.05
            looks.append((at * 0.05, beside, speed, command.throttle, command.brake, math.radians(truth.steer_deg)))
        self.along_m, self.beside_m, self.speed_mps, self.throttle, self.brake, self.road_rad = np.array(looks).T

    def rms_m(self, from_m: float) -> float:
        return float(np.sqrt((self.beside_m[self.along_m > from_m] ** 2).mean()))

    def braked_at_m(self) -> np.ndarray:
        """Places at which the brake is first touched each time."""
        return self.along_m[1:][(self.brake[1:] > 0.0) & (self.brake[:-1] == 0.0)]


def plan_of(path: np.ndarray, t_ns: int = 0, **more: object) -> Plan:
    return replace(Plan(t_ns, RUN.run_id, RUN.mission, path), **more)  # type: ignore[arg-type]


def reset_for(run: Run, car: VehicleParameters = CAR, settings: ControllerSettings | None = None) -> Controller:
    controller = Controller(car, settings)
    controller.reset(run)
    return controller


def ask(
    plan: Plan | None,
    speed_mps: float = 5.0,
    controller: Controller | None = None,
    run: Run = RUN,
    now_ns: int = 0,
    motion: Motion | None = None,
) -> VehicleCommand:
    controller = controller or reset_for(run)
    motion = motion or Motion(t_ns=now_ns, speed_mps=speed_mps)
    return controller.command(plan, motion, motion.speed_mps < 0.1, (0.0,) * 4, 0.0, run, now_ns)


def straight_on(t_ns: int, speed_mps: float) -> Motion:
    """A car that has driven straight on at that speed since time 0."""
    way = speed_mps * t_ns / 1e9
    return Motion(t_ns, x_m=way, speed_mps=speed_mps, distance_m=way)


def held(plan: Plan, controller: Controller, speed_mps: float = 0.0) -> VehicleCommand:
    """The command to a car that is held in its place for a second, with a plan that is ever the same."""
    for tick in range(50):
        now = tick * 20 * MS
        command = ask(replace(plan, t_sensor_ns=now), speed_mps, controller, now_ns=now)
    return command


def test_before_the_car_may_move_everything_is_zero() -> None:
    for mission in Ami:
        run = Run(3, mission, AsState.AS_DRIVING, may_move=False)
        command = ask(replace(plan_of(arc(8.0)), mission=mission), run=run)
        assert (command.throttle, command.brake, command.steering_rad, command.speed_limit_mps) == (0, 0, 0, 0)
        assert not command.mission_finished and not command.estop_request


def test_a_free_straight_is_accelerated_on() -> None:
    command = ask(plan_of(STRAIGHT), speed_mps=2.0)
    assert command.throttle > 0.9
    assert (command.brake, command.steering_rad) == (0.0, pytest.approx(0.0, abs=1e-9))


def test_a_car_askew_in_a_bend_gains_no_speed() -> None:
    """But pointing along it, or about at rest, it does."""
    along, (cos, sin) = arc(3.5), (math.cos(0.3), math.sin(0.3))
    away = plan_of(along @ np.array([[cos, sin], [-sin, cos]]))
    assert held(away, reset_for(RUN), 2.6).throttle < 0.15
    assert held(away, reset_for(RUN), 2.4).throttle > 0.5
    assert ask(plan_of(along), speed_mps=2.6).throttle > 0.5


def test_a_slow_car_gains_no_speed_until_its_steering_has_turned() -> None:
    """A car that stopped with its wheels turned one way, and whose path leads the other way."""
    controller = reset_for(RUN)
    held(plan_of(arc(3.5)), controller)
    right = plan_of(arc(3.5) * (1.0, -1.0))
    commands = [
        ask(replace(right, t_sensor_ns=now), 0.5, controller, now_ns=now)
        for now in range(1000 * MS, 4000 * MS, 20 * MS)
    ]
    steering = np.array([command.steering_rad for command in commands])
    throttle = np.array([command.throttle for command in commands])
    turning = steering > 0.8 * steering[-1]  # to the right is below 0
    assert steering[0] > 0.2 and 40 < turning.sum() < 80
    assert (throttle[10:][turning[10:]] < 0.15).all(), "but for the 0.2 s in which it is taken back"
    assert throttle[-1] > 0.5


def test_near_the_speed_that_is_set_the_throttle_only_holds_it() -> None:
    near, at = (ask(plan_of(STRAIGHT), mps, reset_for(RUN, CAR, HELD)) for mps in (HELD.lap_max_speed_mps - 0.1, 7.0))
    assert 0.0 < near.throttle < 0.15 and at.throttle == 0.0


@pytest.mark.parametrize("mission", Ami)
def test_max_speed_holds_in_every_mission(mission: Ami) -> None:
    controller = Controller(CAR, ControllerSettings(max_speed_mps=3.0))
    assert controller.max_speed_mps(mission) == controller.max_speed_mps(mission, mapped=True) == 3.0


@pytest.mark.parametrize(
    ("mission", "speed_mps", "mapped_mps"),
    [(Ami.AUTOCROSS, 5.1, 6.3), (Ami.TRACKDRIVE, 5.1, 6.3), (Ami.SKIDPAD, 4.2, 4.2), (Ami.ACCELERATION, 12.3, 12.3)],
)
@pytest.mark.parametrize("more", [{}, {"max_speed_mps": 20.0}])
def test_a_mission_is_driven_at_its_own_pace(
    mission: Ami, speed_mps: float, mapped_mps: float, more: dict[str, float]
) -> None:
    laps = {"lap_max_speed_mps": 5.1, "race_max_speed_mps": 6.3}
    own = {"skidpad_max_speed_mps": 4.2, "acceleration_max_speed_mps": 12.3}
    controller = Controller(CAR, ControllerSettings(**laps, **own, **more))
    assert controller.max_speed_mps(mission) == speed_mps
    assert controller.max_speed_mps(mission, mapped=True) == mapped_mps


def test_no_mission_is_faster_than_the_car() -> None:
    slow = CARS["official-simulator"]
    assert Controller(slow).max_speed_mps(Ami.ACCELERATION) == slow.speed_max_mps
    assert Controller(slow).max_speed_mps(Ami.AUTONOMOUS_DEMO) == slow.speed_max_mps


@pytest.mark.parametrize(
    ("mission", "needed_mps"),
    [(Ami.AUTONOMOUS_DEMO, 15 / 3.6), (Ami.STATIC_INSPECTION_A, 5.309), (Ami.STATIC_INSPECTION_B, 1.327)],
)
def test_a_limit_below_what_a_mission_needs_is_named(mission: Ami, needed_mps: float) -> None:
    def said(limit_mps: float) -> str | None:
        return Controller(CAR, ControllerSettings(max_speed_mps=limit_mps)).too_slow(mission)

    assert said(needed_mps + 0.01) is None
    line = said(needed_mps - 0.01)
    assert line is not None and mission.label in line and "\n" not in line
    assert f"{needed_mps - 0.01:.2f} m/s" in line


def test_missions_that_any_speed_fulfils_are_not_named() -> None:
    slow = Controller(CAR, ControllerSettings(max_speed_mps=0.5))
    for mission in (Ami.ACCELERATION, Ami.SKIDPAD, Ami.AUTOCROSS, Ami.TRACKDRIVE, Ami.NOT_SELECTED):
        assert slow.too_slow(mission) is None


def test_the_speed_limit_is_a_little_over_the_speed_that_is_set() -> None:
    controller = reset_for(RUN, CAR, ControllerSettings(max_speed_mps=4.0))
    assert ask(plan_of(STRAIGHT), controller=controller).speed_limit_mps == pytest.approx(5.0)
    controller.configure(ControllerSettings(max_speed_mps=3.0))
    assert ask(plan_of(STRAIGHT), controller=controller).speed_limit_mps == pytest.approx(4.0)


SLALOM = np.column_stack((np.arange(12.0, 60.0, 0.1), 0.66 * np.sin(np.arange(0.0, 48.0, 0.1) * math.tau / 12.0)))
BENDS = {
    "slalom": np.concatenate((STRAIGHT[:24], resampled(SLALOM, 0.5))),
    "hairpin": path_of((12.0, 0.0), (17.3, 1 / 5.5), (12.0, 0.0)),
    "eight": path_of((12.0, 0.0), (57.0, -1 / 9.1), (57.0, 1 / 9.1)),
    "chicane": path_of((12.0, 0.0), *((3.0, 0.11), (6.0, -0.11), (3.0, 0.11), (8.0, 0.0)) * 2),
}


@pytest.mark.parametrize("bend", BENDS)
def test_at_5_mps_the_car_stays_within_5_cm_rms(bend: str) -> None:
    drive = Drive(BENDS[bend], AT_5_MPS, 0.02)
    assert drive.rms_m(from_m=10.0) < 0.05
    assert np.abs(drive.beside_m).max() < 0.15


def test_at_10_mps_the_car_stays_within_10_cm_rms() -> None:
    path = path_of((45.0, 0.0), (8.0, 0.045), (16.0, -0.045), (8.0, 0.045), (20.0, 0.0))
    drive = Drive(path, ControllerSettings(lap_max_speed_mps=10.0, careful_mps=10.0, end_of_path_mps=10.0), 0.02)
    assert drive.speed_mps[drive.along_m > 43.0].min() > 9.7
    assert drive.rms_m(from_m=43.0) < 0.10


@pytest.mark.parametrize(
    ("car", "setting", "limit_rad"),
    [
        (ADS_DV_2021, {}, ADS_DV_2021.steer_max_rad),
        (ADS_DV_2026, {}, ADS_DV_2026.steer_max_rad),
        (CAR, {"max_steer_rad": 0.1}, 0.1),
    ],
)
@pytest.mark.parametrize("radius", [2.0, -2.0])
def test_steering_exceeds_neither_the_car_nor_a_lower_setting(
    car: VehicleParameters, setting: dict[str, float], limit_rad: float, radius: float
) -> None:
    controller = reset_for(RUN, car, ControllerSettings(**setting))
    assert held(plan_of(arc(radius, 6.0)), controller).steering_rad == pytest.approx(math.copysign(limit_rad, radius))


def test_the_car_beside_the_path_steers_back_to_it() -> None:
    assert ask(plan_of(moved(STRAIGHT, 0.0, 0.5))).steering_rad > 0.05
    assert ask(plan_of(moved(STRAIGHT, 0.0, -0.5))).steering_rad < -0.05


def test_a_plan_is_carried_from_its_sensor_stamp_to_the_present() -> None:
    """Half a second at 6 m/s is 3 m: the bend that was 5 m ahead when it was seen is 2 m ahead now."""
    bend = bend_after(5.0, 5.0)
    controller, again = reset_for(RUN), reset_for(RUN)
    for step in range(51):
        now = step * 10 * MS
        motion = straight_on(now, 6.0)
        late = ask(plan_of(bend, 0), controller=controller, now_ns=now, motion=motion)
        at_once = ask(plan_of(moved(bend, -motion.x_m, 0.0), now), controller=again, now_ns=now, motion=motion)
    assert late.steering_rad > 0.03
    assert late.steering_rad == pytest.approx(at_once.steering_rad, abs=0.01)


def test_the_steering_is_early_by_its_own_delay() -> None:
    bend = bend_after(3.0, 5.0)
    slow, quick = (reset_for(RUN, CAR, ControllerSettings(delay_s=delay)) for delay in (0.0, 0.2))
    assert ask(plan_of(bend), 6.0, quick).steering_rad > ask(plan_of(bend), 6.0, slow).steering_rad + 0.01


def test_a_bend_ahead_is_braked_for_in_time() -> None:
    """In one go, before the bend, to what the bend allows; nowhere else."""
    drive = Drive(path_of((40.0, 0.0), (15.0, 0.2), (25.0, 0.0)), ON_AND_ON, 0.02)
    assert len(drive.braked_at_m()) == 1
    assert 25.0 < drive.braked_at_m()[0] < 40.0
    in_bend = (drive.along_m > 41.0) & (drive.along_m < 53.0)
    assert drive.speed_mps[in_bend].max() < math.sqrt(SETTINGS.lateral_mps2 * 5.0) + 0.2
    assert drive.along_m[drive.brake > 0.0].max() < 44.0


def test_on_a_straight_the_speed_is_held_calmly() -> None:
    drive = Drive(path_of((70.0, 0.0)), ON_AND_ON, 0.02)
    there = (drive.along_m > 25.0) & (drive.along_m < 60.0)
    assert HELD.lap_max_speed_mps - 0.2 < drive.speed_mps[there].min()
    assert drive.speed_mps[there].max() < HELD.lap_max_speed_mps
    assert not drive.brake.any()
    most = SETTINGS.jerk_mps3 * 0.02 * CAR.rolling_radius_m * (CAR.mass_kg + CAR.rotating_mass_kg) / 195.0
    assert np.abs(np.diff(drive.throttle))[2:].max() < 1.05 * most


def test_between_throttle_and_brake_the_car_coasts() -> None:
    drive = Drive(path_of((30.0, 0.0), *((6.0, 0.2), (25.0, 0.0)) * 2), ON_AND_ON, 0.02)
    last = 0
    for tick in np.flatnonzero(drive.throttle + drive.brake):
        if drive.brake[last] * drive.throttle[tick] or drive.throttle[last] * drive.brake[tick]:
            assert tick - last > 4
        last = tick
    assert len(drive.braked_at_m()) == 2


def test_the_car_stands_at_the_stopping_place() -> None:
    drive = Drive(path_of((80.0, 0.0)), SETTINGS, stop_m=50.0)
    assert drive.speed_mps[-1] < 0.1
    assert 49.0 < drive.along_m[-1] < 50.5
    assert len(drive.braked_at_m()) == 1


def test_the_shorter_the_path_borne_out_the_slower() -> None:
    """The front wheels can stop on it; where hardly any is, the car feels its way."""

    def brakes(supported_m: float, speed_mps: float) -> bool:
        return ask(plan_of(STRAIGHT, supported_m=supported_m), speed_mps).brake > 0.0

    assert not brakes(15.0, 6.5)
    assert brakes(7.5, 6.5) and not brakes(7.5, 4.5)
    assert brakes(4.5, 4.5) and not brakes(4.5, 2.5)
    assert not brakes(1.0, FEEL_ITS_WAY_MPS) and brakes(1.0, FEEL_ITS_WAY_MPS + 1.0)


SEEN_M = 11.75  # of path borne out, as by a sensor that sees 13 m


OLDEST_S = 0.1  # of a plan, when the next one comes


def stopping_mps(supported_m: float, oldest_s: float = OLDEST_S) -> float:
    """Speed from which the front wheels stop so little beyond so much path, with the braking planned with."""
    braking = SETTINGS.sight_braking_mps2
    sight_m = supported_m - CAR.wheelbase_m + BEYOND_CONES_M
    late_mps = braking * (SETTINGS.reaction_s + oldest_s)
    return math.sqrt(late_mps**2 + 2.0 * braking * sight_m) - late_mps


def test_a_path_well_borne_out_is_driven_by_sight() -> None:
    """First with care, then as fast as the car stops on it."""
    drive = Drive(path_of((80.0, 0.0)), SETTINGS, 0.02, supported_m=SEEN_M)
    begun, later = drive.along_m < CLEAR_OVER_M, (drive.along_m > 55.0) & (drive.along_m < 60.0)
    assert drive.speed_mps[begun].max() < SETTINGS.careful_mps
    assert stopping_mps(SEEN_M) - 0.4 < drive.speed_mps[later].min()
    assert drive.speed_mps.max() < stopping_mps(SEEN_M) + 0.1


def test_where_sight_ends_the_car_stops_within_it() -> None:
    """From the speed that the sight allows, to the one at which it feels its way."""
    path = path_of((85.0, 0.0))
    drive = Drive(path, SETTINGS, ahead_m=85.0, supported_m=lambda at_m: max(0.0, min(SEEN_M, 65.0 - at_m)))
    on_its_way = drive.along_m < 65.0 - CAR.wheelbase_m + BEYOND_CONES_M
    assert drive.speed_mps[on_its_way].max() > stopping_mps(SEEN_M) - 0.5
    assert drive.speed_mps[~on_its_way].max() < FEEL_ITS_WAY_MPS + 0.5


def test_cones_that_come_into_sight_one_by_one_do_not_jolt() -> None:
    """Sight grows by 2.5 m at a time, in which the car drives 2.5 m."""
    drive = Drive(path_of((90.0, 0.0)), SETTINGS, 0.02, supported_m=lambda at_m: SEEN_M - at_m % 2.5)
    there = (drive.along_m > 45.0) & (drive.along_m < 68.0)
    assert not drive.brake[there].any()
    assert drive.speed_mps[there].min() > stopping_mps(SEEN_M - 2.5) - 0.4 and np.ptp(drive.speed_mps[there]) < 0.5


def test_sight_short_for_a_moment_is_braked_for_no_longer() -> None:
    """The speed falls to what the shortest sight allows at most, and grows again when that sight is 4 m behind."""
    short_m = 8.25  # just before the next ones of cones 5 m apart come into sight
    drive = Drive(path_of((90.0, 0.0)), SETTINGS, supported_m=lambda at_m: short_m if 60.0 < at_m < 60.6 else SEEN_M)
    there, after = (drive.along_m > 60.0) & (drive.along_m < 68.0), drive.along_m > 72.0
    assert drive.brake[there].max() > 0.5
    assert drive.speed_mps[there].min() > stopping_mps(short_m) - 0.4
    assert drive.speed_mps[after][0] > drive.speed_mps[there].min() + 0.2


@pytest.mark.parametrize("every", [8, 10, 12])
def test_a_slow_detector_makes_the_car_slower_and_no_brake_pulse(every: int) -> None:
    drive = Drive(path_of((90.0, 0.0)), SETTINGS, supported_m=SEEN_M, every=every)
    there = (drive.along_m > 50.0) & (drive.along_m < 68.0)
    assert not drive.brake[there].any()
    assert drive.speed_mps[there] == pytest.approx(stopping_mps(SEEN_M, 0.02 * every), abs=0.5)


def test_the_end_of_a_path_is_the_end_of_sight() -> None:
    """As it is for a planner that does not say how far cones bear out its path."""
    drive = Drive(path_of((90.0, 0.0)), SETTINGS, ahead_m=10.0, supported_m=math.inf)
    assert drive.along_m[drive.speed_mps > SETTINGS.careful_mps][0] > CLEAR_OVER_M
    assert drive.speed_mps.max() < stopping_mps(10.0) + 0.1


@pytest.mark.parametrize("seen_m", [SEEN_M, 14.0])
@pytest.mark.parametrize(
    ("radius_m", "end_m"), [(25.0, 62.0), (18.0, 58.0), (18.0, 65.0), (16.0, 56.0), (14.0, 65.0), (9.0, 70.0)]
)
def test_where_sight_ends_in_a_bend_the_car_stops_within_it(radius_m: float, end_m: float, seen_m: float) -> None:
    """The bend begins at 45 m, and is seen before or after its end is."""
    path = path_of((45.0, 0.0), (35.0, 1.0 / radius_m))
    drive = Drive(path, SETTINGS, ahead_m=80.0, supported_m=lambda at_m: max(0.0, min(seen_m, end_m - at_m)))
    beyond = drive.along_m > end_m - CAR.wheelbase_m + BEYOND_CONES_M
    assert drive.speed_mps[drive.along_m > 50.0].max() > SETTINGS.careful_mps
    assert beyond.any() and drive.speed_mps[beyond].max() < FEEL_ITS_WAY_MPS + 0.5


def test_on_a_straight_short_sight_is_braked_for_from_half_way() -> None:
    """From half-way between the braking planned with and the most that is used; every other look sees less."""
    controller, slow2 = Controller(CAR), FEEL_ITS_WAY_MPS**2
    half_mps2 = 0.5 * (SETTINGS.sight_braking_mps2 + SETTINGS.sight_braking_max_mps2)
    needed_m = (10.0**2 - slow2) / (2.0 * half_mps2) + 10.0 * SETTINGS.reaction_s
    assert controller._for_sight(needed_m + 0.01, 10.0) == math.inf
    assert controller._for_sight(needed_m - 0.01, 10.0) == pytest.approx(-half_mps2, rel=0.01)


NO_PATH_FROM = {"ahead_m": lambda at_m: 20.0 * (at_m < 55.0)}
A_LAST_LOOK = {"ahead_m": lambda at_m: 20.0 * (at_m < 53.0 or 54.4 < at_m < 55.0)}


@pytest.mark.parametrize(
    ("ends", "radius_m"),
    [(NO_PATH_FROM, 1e9), ({"silent_from_m": 55.0}, 1e9), (NO_PATH_FROM, 25.0), (A_LAST_LOOK, 1e9)],
    ids=["no path", "no plan", "no path in a bend", "no path but for a look"],
)
def test_a_car_by_sight_stops_within_what_it_last_saw(ends: dict[str, Any], radius_m: float) -> None:
    """Though nothing tells it the way any more: the speed was earned by that."""
    drive = Drive(path_of((45.0, 0.0), (50.0, 1.0 / radius_m)), SETTINGS, supported_m=SEEN_M, **ends)
    assert drive.speed_mps[drive.along_m > 50.0].max() > SETTINGS.careful_mps
    beyond = drive.along_m > 55.0 + SEEN_M - CAR.wheelbase_m + BEYOND_CONES_M
    assert drive.speed_mps[beyond].max(initial=0.0) < FEEL_ITS_WAY_MPS + 0.5 and drive.speed_mps[-1] < 0.1


def test_without_a_way_brakes_have_what_the_bend_leaves() -> None:
    brakes = []
    for yaw_rate_radps in (0.0, 0.4, 0.6, 0.9):
        controller = reset_for(RUN, CAR, SETTINGS)
        for tick in range(150):
            now = tick * 20 * MS
            ask(
                plan_of(STRAIGHT, now, supported_m=SEEN_M),
                controller=controller,
                now_ns=now,
                motion=straight_on(now, 9.0),
            )
        turning = straight_on(now + 20 * MS, 9.0)
        turning = replace(turning, yaw_rate_radps=yaw_rate_radps, distance_m=turning.distance_m + 7.0)
        no_way = plan_of(STRAIGHT[:0], now + 20 * MS)
        brakes.append(ask(no_way, controller=controller, now_ns=now + 20 * MS, motion=turning).brake)
    assert brakes == sorted(brakes, reverse=True) and len(set(brakes)) == len(brakes)
    assert brakes[0] > 0.5 and brakes[-1] == SETTINGS.gentle_brake


def test_after_a_look_without_a_path_the_speed_falls_gently() -> None:
    drive = Drive(
        path_of((90.0, 0.0)), SETTINGS, supported_m=SEEN_M, ahead_m=lambda at_m: 0.0 if 60.0 < at_m < 60.6 else 20.0
    )
    after = (drive.along_m > 60.0) & (drive.along_m < 66.0)
    assert drive.speed_mps[after].min() < stopping_mps(SEEN_M) - 0.5
    assert drive.brake[after].max() < 0.3


def test_where_every_other_look_finds_no_path_the_car_is_careful() -> None:
    found = itertools.count()
    drive = Drive(
        path_of((90.0, 0.0)),
        SETTINGS,
        supported_m=SEEN_M,
        ahead_m=lambda at_m: 0.0 if at_m > 40.0 and next(found) % 2 else 20.0,
    )
    assert drive.speed_mps[drive.along_m < 40.0].max() > SETTINGS.careful_mps
    assert drive.speed_mps[drive.along_m > 65.0].max(initial=0.0) < SETTINGS.careful_mps


def test_more_than_a_path_is_not_borne_out() -> None:
    """A planner of another team may say so."""
    drive = Drive(path_of((90.0, 0.0)), SETTINGS, ahead_m=10.0, supported_m=50.0)
    assert drive.speed_mps.max() < stopping_mps(10.0) + 0.1


def test_a_car_that_was_lost_is_careful_as_from_its_start() -> None:
    said = LOST + "where it is"
    drive = Drive(
        path_of((90.0, 0.0)), SETTINGS, supported_m=SEEN_M, note=lambda at_m: said if 40.0 < at_m < 40.7 else ""
    )
    before, after = (drive.along_m > 36.0) & (drive.along_m < 40.0), (drive.along_m > 52.0) & (drive.along_m < 55.0)
    assert drive.speed_mps[before].max() > SETTINGS.careful_mps > drive.speed_mps[after].max()
    assert drive.speed_mps[drive.along_m > 60.0].max() > SETTINGS.careful_mps


def test_where_looks_get_worse_the_speed_falls_gently() -> None:
    """To a careful one, also in the corner that follows."""
    path = path_of((80.0, 0.0), (20.0, 1 / 8.0))
    drive = Drive(path, SETTINGS, supported_m=SEEN_M, confidence=lambda at_m: 1.0 if at_m < 45.0 else CLEAR - 0.01)
    before, after = drive.along_m < 45.0, drive.along_m > 68.0
    assert drive.speed_mps[before].max() > SETTINGS.careful_mps + 1.0
    assert drive.speed_mps[after].max() < SETTINGS.careful_mps
    assert np.diff(drive.speed_mps[~after]).min() / 0.01 > -3.5
    assert drive.speed_mps[drive.along_m > 83.0].max() < math.sqrt(SETTINGS.lateral_mps2 * 8.0) + 0.2


def test_a_low_speed_limit_leaves_corners_careful() -> None:
    """A path borne out well is no reason to corner faster where no more than a careful speed is set."""
    controllers = [reset_for(RUN, CAR, settings) for settings in (HELD, SETTINGS)]
    for tick in range(200):
        now = tick * 20 * MS
        seen, motion = plan_of(arc(8.0), now, supported_m=SEEN_M), straight_on(now, 6.3)
        low, high = (ask(seen, controller=each, now_ns=now, motion=motion).throttle for each in controllers)
    assert low == 0.0 < high


def test_an_unsure_plan_is_driven_slowly_and_ends_in_a_stop() -> None:
    slow, unsure = 0.5 * SETTINGS.confidence_sure, 0.9 * SETTINGS.confidence_min
    assert ask(plan_of(STRAIGHT, confidence=SETTINGS.confidence_sure), 4.0).throttle > 0.5
    assert ask(plan_of(STRAIGHT, confidence=slow), 4.0).throttle == 0.0
    assert ask(plan_of(STRAIGHT, confidence=slow, supported_m=3.0), 1.5).brake == 0.0
    assert ask(plan_of(STRAIGHT, confidence=unsure, supported_m=1.0), 1.5).brake > 0.0


@pytest.mark.parametrize("age_ms", (0, 150, 300))
def test_a_doubtful_look_does_not_brake_but_lasting_doubt_slows(age_ms: int) -> None:
    controller, speed, way, first = reset_for(RUN), SETTINGS.careful_mps - 0.1, 0.0, None
    plan = plan_of(STRAIGHT)
    for tick in range(350):
        now = tick * 20 * MS
        if tick % 5 == 0 and now >= age_ms * MS:
            confidence = 0.5 if tick > 50 else 1.0
            plan = plan_of(STRAIGHT, now - age_ms * MS, confidence=confidence * SETTINGS.confidence_sure)
        command = ask(plan, controller=controller, now_ns=now, motion=Motion(now, speed_mps=speed, distance_m=way))
        if plan.confidence < SETTINGS.confidence_sure and first is None:
            first = command
        speed += 0.02 * (1.5 * command.throttle - (1.2 + 8.0 * command.brake if command.brake > 0.0 else 0.25))
        way += 0.02 * speed
    assert first is not None and first.throttle < 0.3 and first.brake == 0.0
    assert speed < 0.6 * SETTINGS.careful_mps


def test_the_car_stops_with_its_nose_where_its_path_ends() -> None:
    unsure, nose_m = 0.9 * SETTINGS.confidence_min, CAR.nose_ahead_of_rear_axle_m
    assert ask(plan_of(STRAIGHT, confidence=unsure, supported_m=nose_m + 3.0), 1.0).brake == 0.0
    assert ask(plan_of(STRAIGHT, confidence=unsure, supported_m=nose_m), 1.0).brake > 0.0
    stands = ask(plan_of(STRAIGHT, confidence=unsure, supported_m=nose_m, note="a fork"), 0.0)
    assert stands.note == "the path ends, and nothing confirms that it continues: a fork"


def test_a_mapped_path_is_driven_faster() -> None:
    assert ask(plan_of(STRAIGHT, mapped=True), 8.0).throttle > 0.5


def test_acceleration_is_as_fast_as_the_motor_and_stops() -> None:
    """Within 3 % of the car at full torque, and at rest within 100 m."""
    best, now = Car(CAR, Pose()), 0
    while best.truth().distance_m < 75.3:
        now += 10 * MS
        best.advance(now, Actuation(0.0, 0.0, 195.0, 4000, 4000, 0.0, 0.0, False, True))
    drive = Drive(path_of((250.0, 0.0)), SETTINGS, 0.0, 60.0, mission=Ami.ACCELERATION, stop_m=160.0)
    assert 0.01 * np.searchsorted(drive.along_m, 75.3) < 1.03 * now / 1e9
    assert drive.speed_mps[-1] < 0.1
    assert drive.along_m[-1] < 175.0


def line_through(path: np.ndarray) -> PathLine:
    line = line_of(path)
    assert line is not None
    return line


def profile(curvature: np.ndarray, end_mps: float = 50.0, stop_m: float | None = None) -> np.ndarray:
    end_m = STEP_M * len(curvature)
    return np.sqrt(
        speed_profile(curvature, np.full(len(curvature), 400.0), (end_m, end_mps), stop_m, (5.0, 4.0, 3.0), 0.5)
    )


def test_corner_speed_keeps_to_the_lateral_acceleration() -> None:
    assert profile(np.full(40, -0.2)) == pytest.approx(5.0)
    assert profile(np.zeros(40)) == pytest.approx(20.0)


def test_the_profile_brakes_before_a_corner_within_grip() -> None:
    """Braking and cornering share the tyres: on the way into the corner the braking ends as the bend begins."""
    curvature = np.concatenate((np.zeros(60), np.linspace(0.0, 0.2, 30), np.full(30, 0.2)))
    speed = profile(curvature)
    braking = -np.diff(speed**2) / (2.0 * STEP_M)
    lateral = speed[1:] ** 2 * curvature[1:]
    assert braking.max() == pytest.approx(4.0)
    assert ((braking / 4.0) ** 2 + (lateral / 5.0) ** 2).max() < 1.1
    assert speed[-1] == pytest.approx(5.0)


def test_the_profile_leaves_the_steering_time_to_turn() -> None:
    """0.2 1/m in 5 m at 0.5 1/(m s) is 12.5 m/s at most."""
    curvature = np.concatenate((np.zeros(40), np.linspace(0.0, 0.02, 2), np.full(40, 0.02)))
    steep = speed_profile(curvature, np.full(len(curvature), 400.0), (99.0, 50.0), None, (50.0, 50.0, 3.0), 0.05)
    assert math.sqrt(steep.min()) < 13.0
    assert math.sqrt(steep[10]) == pytest.approx(20.0)


def test_the_profile_stands_at_the_stop_and_is_slow_at_the_end() -> None:
    along = STEP_M * np.arange(80)
    stopping = profile(np.zeros(80), stop_m=30.0)
    braking = -np.diff(stopping**2) / (2.0 * STEP_M)
    gently = (along[1:] > 28.5 + 1e-9) & (along[1:] <= 30.0 + 1e-9)
    assert braking[gently] == pytest.approx(1.5), "no jolt at the end"
    assert braking[along[1:] < 28.0] == pytest.approx(3.0, abs=1e-6) and (stopping[along >= 30.0] == 0.0).all()
    assert profile(np.zeros(80), end_mps=4.0)[-1] == pytest.approx(math.sqrt(16.0 + 8.0 * STEP_M))


def test_curvature_is_that_of_the_circle() -> None:
    assert line_through(arc(5.0)).curvature_1pm == pytest.approx(0.2, rel=0.02)
    assert line_through(arc(5.0) * (1.0, -1.0)).curvature_1pm == pytest.approx(-0.2, rel=0.02)
    assert line_through(STRAIGHT).curvature_1pm == pytest.approx(np.zeros(40), abs=1e-9)
    assert line_of(STRAIGHT[:2]) is None


def test_noise_of_the_path_hardly_shows_in_the_profile() -> None:
    """Points that lie 1 cm beside the path change the speed by less than 5 %."""
    chance = np.random.default_rng(3)
    speeds = [
        profile(line_through(arc(8.0) + chance.normal(0.0, 0.01, (36, 2))).curvature_1pm)[5:25] for _ in range(50)
    ]
    assert np.std(speeds, axis=0).max() < 0.05 * math.sqrt(5.0 * 8.0)


NO_PATH = {
    "no plan": None,
    "no path": plan_of(np.zeros((0, 2))),
    "too short": plan_of(STRAIGHT[:2]),
    "no numbers": plan_of(np.full((20, 2), np.nan)),
    "behind the car": plan_of(moved(STRAIGHT, -30.0, 0.0)),
    "another run": plan_of(STRAIGHT, run_id=2),
    "another mission": plan_of(STRAIGHT, mission=Ami.SKIDPAD),
}


@pytest.mark.parametrize("plan", NO_PATH.values(), ids=NO_PATH)
def test_without_a_path_it_brakes_gently_with_steering_held(plan: Plan | None) -> None:
    controller = reset_for(RUN)
    steering = ask(plan_of(arc(8.0)), 4.0, controller).steering_rad
    assert steering > 0.05
    command = ask(plan, 4.0, controller)
    assert (command.throttle, command.brake, command.steering_rad) == (0.0, SETTINGS.gentle_brake, steering)


@pytest.mark.parametrize(
    ("plan", "note"),
    [
        (None, "no plan from the planner"),
        (plan_of(np.zeros((0, 2)), note="no lane among 7 cones"), "no path: no lane among 7 cones"),
        (plan_of(STRAIGHT[:3], note="doubted"), "no path: doubted"),
        (plan_of(STRAIGHT[:5] - (1.0, 0.0), note="doubted"), "the path ends 1.0 m ahead: doubted"),
        (plan_of(moved(STRAIGHT, 0.0, 5.0)), "the path is not where the car is"),
        (plan_of(moved(STRAIGHT, 10.0, 0.0)), "the path is not where the car is"),
        (plan_of(np.array([[0.0, 0.0], [5.0, 0.0], [1e12, 0.0]])), ""),
        (plan_of(STRAIGHT, note="doubted"), ""),
    ],
)
def test_what_keeps_the_controller_from_driving_is_told(plan: Plan | None, note: str) -> None:
    command = ask(plan, speed_mps=0.0)
    assert (command.note, command.throttle > 0.0) == (note, not note)
    assert ask(plan, run=replace(RUN, may_move=False)).note == ""


@pytest.mark.parametrize(
    ("plan", "why"),
    [
        (plan_of(np.zeros((0, 2)), note="no cones"), "no path: no cones"),
        (plan_of(STRAIGHT), "it does not follow the command"),
    ],
)
def test_a_car_that_stands_for_30_s_is_given_up_for_this_run(plan: Plan, why: str) -> None:
    controller, waits_ns = reset_for(RUN), round(SETTINGS.give_up_s * 1e9)
    for t_ns in (0, waits_ns - 1, waits_ns):
        command = ask(replace(plan, t_sensor_ns=t_ns), 0.0, controller, now_ns=t_ns)
        assert (command.estop_request, command.mission_finished) == (t_ns == waits_ns, False)
    assert command.note == f"the car has stood for 30 s: {why}"
    assert ask(plan_of(STRAIGHT), 0.0, controller).estop_request, "it stays so for this run"
    assert not ask(None, 0.0, controller, run=replace(RUN, run_id=4)).estop_request


def test_motion_gives_the_time_anew_and_the_finish_ends_it() -> None:
    controller = reset_for(RUN)
    lost, over = plan_of(np.zeros((0, 2))), plan_of(STRAIGHT, finished=True, stop_distance_m=0.0)
    for t_s, plan, speed_mps in ((0, lost, 0.0), (20, lost, 1.0), (40, lost, 0.0), (69, over, 0.0), (200, over, 0.0)):
        assert not ask(plan, speed_mps, controller, now_ns=t_s * 1000 * MS).estop_request


@pytest.mark.parametrize(
    ("age_s", "throttle", "brake"), [(0.39, True, False), (0.41, False, False), (0.81, False, True)]
)
def test_an_old_plan_first_ends_the_throttle_and_then_brakes(age_s: float, throttle: bool, brake: bool) -> None:
    command = ask(plan_of(STRAIGHT, 0), speed_mps=1.0, now_ns=round(age_s * 1000) * MS)
    assert (command.throttle > 0.0, command.brake > 0.0) == (throttle, brake)


def test_a_command_carries_its_sensor_stamp_and_its_run() -> None:
    command = ask(plan_of(STRAIGHT, 70 * MS), now_ns=100 * MS)
    assert (command.t_sensor_ns, command.run_id) == (70 * MS, RUN.run_id)
    command = ask(None, motion=Motion(t_ns=90 * MS), now_ns=100 * MS)
    assert command.t_sensor_ns == 90 * MS


def test_laps_and_cones_are_passed_on_and_kept_without_plans() -> None:
    controller = reset_for(RUN)
    plan = plan_of(STRAIGHT, laps=2, cones_count_actual=7, cones_count_all=90)
    for given_plan in (plan, None):
        command = ask(given_plan, controller=controller)
        assert (command.laps, command.cones_count_actual, command.cones_count_all) == (2, 7, 90)


@pytest.mark.parametrize(
    ("stop_m", "speed_mps", "finished"),
    [
        (19.0, 3.0, False),
        (10.0, 5.0, False),
        (0.2, 2.0, False),  # the full brake of a finished mission would jolt a car that moves
        (0.0, 3.0, True),  # one that is fast there is stopped at once
        (0.0, 0.0, True),
        (19.0, 0.0, True),  # at rest it is finished anywhere
        (19.0, 0.2, False),
        (19.0, 1.0, False),
    ],
)
def test_behind_the_last_line_no_throttle_is_given_until_the_end(
    stop_m: float, speed_mps: float, finished: bool
) -> None:
    command = ask(plan_of(STRAIGHT, finished=True, stop_distance_m=stop_m), speed_mps)
    assert (command.throttle, command.mission_finished) == (0.0, finished)


def test_a_mission_finished_at_the_stopping_place_stays_finished() -> None:
    controller = reset_for(RUN)
    moving = ask(plan_of(STRAIGHT, finished=True, stop_distance_m=0.2), 2.0, controller)
    assert 0.0 < moving.brake < brake_for(CAR, 2.0, 2.0)
    assert ask(plan_of(STRAIGHT, finished=False), 0.0, controller).mission_finished, "it stands where it was to stop"
    command = ask(plan_of(STRAIGHT, finished=False), 2.0, controller)
    assert (command.mission_finished, command.throttle, command.brake) == (True, 0.0, SETTINGS.final_brake)
    again = ask(plan_of(STRAIGHT, run_id=4), 1.0, controller, run=replace(RUN, run_id=4))
    assert not again.mission_finished


def test_a_car_that_does_not_come_to_rest_gently_is_stopped() -> None:
    controller, over = reset_for(RUN), plan_of(STRAIGHT, finished=True, stop_distance_m=0.0)
    for tick in range(31):
        assert not ask(over, 1.0, controller, now_ns=tick * 100 * MS).mission_finished
    assert ask(over, 1.0, controller, now_ns=3001 * MS).mission_finished


def test_distance_since_the_plan_counts_to_the_stopping_place() -> None:
    controller = reset_for(RUN)
    plan = plan_of(STRAIGHT, 0, finished=True, stop_distance_m=2.0)
    for step in range(31):
        now = step * 10 * MS
        command = ask(plan, controller=controller, now_ns=now, motion=straight_on(now, 6.0))
    assert command.mission_finished


@settings(max_examples=150)
@given(
    points=st.lists(st.tuples(st.floats(-60, 60), st.floats(-60, 60)), max_size=30),
    speed=st.floats(0, 25),
    yaw_rate=st.floats(-3, 3),
    age_ms=st.integers(0, 1500),
    end=st.fixed_dictionaries({"finished": st.booleans(), "stop_distance_m": st.none() | st.floats(0, 100)}),
    run=st.builds(Run, st.just(3), st.sampled_from(Ami), st.just(AsState.AS_DRIVING), st.booleans()),
)
def test_every_command_is_valid_and_never_has_throttle_and_brake(
    points: list[tuple[float, float]], speed: float, yaw_rate: float, age_ms: int, end: dict[str, Any], run: Run
) -> None:
    controller = reset_for(run)
    plan = Plan(0, 3, run.mission, np.array(points, dtype=np.float64).reshape(-1, 2), **end)
    for step in range(3):
        now = (age_ms + 20 * step) * MS
        motion = Motion(t_ns=now, speed_mps=speed, yaw_rate_radps=yaw_rate, distance_m=speed * now / 1e9)
        command = controller.command(plan, motion, False, (speed * 30,) * 4, 0.0, run, now)
        assert command.problems(CAR.steer_max_rad) == ()
        assert not (command.throttle > 0.0 and command.brake > 0.0)


@pytest.mark.parametrize(
    ("settings_class", "name", "value"),
    [
        (ControllerSettings, "max_speed_mps", 0.0),
        (ControllerSettings, "max_steer_rad", 1.0),
        (ControllerSettings, "delay_s", math.nan),
        (PlannerSettings, "beam", 0),
        (PlannerSettings, "smoothing_m", math.nan),
        (MissionSettings, "trackdrive_laps", 0),
        (MissionSettings, "demo_length_m", math.nan),
    ],
)
def test_a_setting_outside_its_range_is_refused_by_name(settings_class: Any, name: str, value: float) -> None:
    with pytest.raises(ValueError, match=name):
        settings_class(**{name: value})


def test_a_map_lost_in_a_corner_leaves_grip_for_the_corner() -> None:
    controller, speed = reset_for(RUN), 12.0
    for t_ms in (0, 20, 40):
        ask(plan_of(arc(20.0, 60.0), mapped=True), speed, controller, now_ns=t_ms * MS)
    brake = ask(plan_of(arc(20.0, 60.0)), speed, controller, now_ns=60 * MS).brake
    sideways = speed**2 / 20.0 / SETTINGS.race_lateral_mps2
    most = max(SETTINGS.braking_max_mps2 * braking_share(sideways), 1.2)
    assert 0.0 < brake * CAR.brake_full_mps2 <= 1.2 * most + 0.13 * CAR.brake_full_mps2


@pytest.mark.parametrize(("speed_mps", "pedal"), [(5.0, "throttle"), (14.0, "brake")])
def test_a_car_that_turns_at_its_grip_is_left_the_grip(speed_mps: float, pedal: str) -> None:
    """Though its path is straight: what the tyres carry sideways, they cannot carry along."""

    def asked(lateral_mps2: float) -> float:
        controller = reset_for(RUN)
        for tick in range(30):
            motion = Motion(t_ns=tick * 20 * MS, speed_mps=speed_mps, yaw_rate_radps=lateral_mps2 / speed_mps)
            command = ask(plan_of(STRAIGHT, tick * 20 * MS), now_ns=motion.t_ns, controller=controller, motion=motion)
        found: float = getattr(command, pedal)
        return found

    least = throttle_for(CAR, 0.0, speed_mps) if pedal == "throttle" else brake_for(CAR, 1.2, speed_mps)
    assert asked(0.0) > asked(6.5 if pedal == "brake" else 7.7) > asked(8.0) == asked(-8.0) == pytest.approx(least)


@cache
def raced_speed(slip_radpmps2: float, mapped: bool = True, yaw_rate_sd_radps: float = 0.03) -> float:
    """The speed at which throttle ends in a corner of 10 m, after 600 m with tyres that slip so."""
    controller, plan = reset_for(RUN), plan_of(arc(10.0, 50.0), mapped=mapped, slip_radpmps2=slip_radpmps2)
    for step in range(200):
        now = step * 300 * MS
        motion = Motion(t_ns=now, speed_mps=8.0, distance_m=3.0 * step, yaw_rate_sd_radps=yaw_rate_sd_radps)
        ask(replace(plan, t_sensor_ns=now), controller=controller, now_ns=now, motion=motion)
    assert controller._profile is not None
    return math.sqrt(float(controller._profile[20]))


def test_tyres_that_slip_less_are_asked_for_more() -> None:
    aimed_at = ANGLE_RAD / SETTINGS.race_lateral_mps2
    assert raced_speed(0.7 * aimed_at) > 1.05 * raced_speed(aimed_at) > 1.08 * raced_speed(1.25 * aimed_at)
    assert raced_speed(0.0) == pytest.approx(raced_speed(aimed_at), rel=0.01), "no more where it is not measured"
    assert raced_speed(0.008, mapped=False) == raced_speed(0.014, mapped=False), "nor off the map"
    blind = [raced_speed(0.7 * aimed_at, yaw_rate_sd_radps=sd) for sd in (0.031, 0.0)]
    assert 1.02 * max(blind) < raced_speed(0.7 * aimed_at), "and less where no sensor says how fast the car turns"


@pytest.mark.parametrize(
    ("said", "believed"), [(1e-300, SLIP_LEAST_RADPMPS2), (0.5, SLIP_MOST_RADPMPS2), (math.inf, SLIP_MOST_RADPMPS2)]
)
def test_a_slip_beyond_what_tyres_do_is_not_believed(said: float, believed: float) -> None:
    assert raced_speed(said) == raced_speed(believed)


@pytest.mark.parametrize("trouble", [None, plan_of(np.zeros((0, 2)))], ids=["no plan", "no path"])
def test_a_path_that_is_lost_takes_the_pace_back(trouble: Plan | None) -> None:
    controller = reset_for(RUN)
    controller._pace = Pace(1.2)
    ask(trouble, controller=controller, motion=Motion(speed_mps=8.0, distance_m=500.0))
    assert controller._pace == Pace(1.0, distance_m=500.0), "way without a path is none raced"


@pytest.mark.parametrize("speed", [12.2, 13.0])
def test_a_car_too_fast_for_its_corner_brakes(speed: float) -> None:
    command = held(plan_of(arc(20.0, 60.0)), reset_for(RUN), speed)
    assert command.brake > 0.0 and command.throttle == 0.0


def test_braking_near_the_limit_leaves_the_rear_axle_its_grip() -> None:
    assert braking_share(0.0) == 1.0
    assert braking_share(0.5) == pytest.approx(math.sqrt(0.75))
    assert braking_share(0.95) == pytest.approx(0.11) and braking_share(0.9) == pytest.approx(0.22)
    assert braking_share(1.3) == braking_share(1.0) == 0.05
