"""The controller: from plan and motion to a command."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fsai_vcu.core.command import VehicleCommand
from fsai_vcu.core.control.controller import Controller
from fsai_vcu.core.control.settings import ControllerSettings
from fsai_vcu.core.control.speed_profile import curvature_along, speed_demand
from fsai_vcu.core.driving import Motion, Plan, Run
from fsai_vcu.core.missions.settings import MissionSettings
from fsai_vcu.core.planning.settings import PlannerSettings
from fsai_vcu.core.vehicle.parameters import ADS_DV_2021, ADS_DV_2026, CARS, VehicleParameters
from fsai_vcu.interface.enums import Ami, AsState
from fsai_vcu.interface.units import MS

CAR = ADS_DV_2026
RUN = Run(3, Ami.AUTOCROSS, AsState.AS_DRIVING, may_move=True)
STRAIGHT = np.column_stack((np.arange(0.0, 20.0, 0.5), np.zeros(40)))
SETTINGS = ControllerSettings()


def arc(radius: float, length: float = 18.0) -> np.ndarray:
    a = np.arange(0.0, length, 0.5) / radius
    return np.column_stack((radius * np.sin(a), radius * (1.0 - np.cos(a))))


def moved(path: np.ndarray, x_m: float, y_m: float) -> np.ndarray:
    return path + np.array([x_m, y_m])


def bend_after(straight_m: float, radius: float) -> np.ndarray:
    """Straight on, then a left bend."""
    straight = np.column_stack((np.arange(0.0, straight_m, 0.5), np.zeros(round(2 * straight_m))))
    return np.concatenate((straight, moved(arc(radius, 9.0), straight_m, 0.0)))


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


def test_no_throttle_at_the_speed_that_is_set() -> None:
    assert ask(plan_of(STRAIGHT), speed_mps=SETTINGS.lap_max_speed_mps).throttle == 0.0
    assert ask(plan_of(STRAIGHT), speed_mps=SETTINGS.lap_max_speed_mps - 0.3).throttle > 0.0


@pytest.mark.parametrize("mission", Ami)
def test_max_speed_holds_in_every_mission(mission: Ami) -> None:
    assert Controller(CAR, ControllerSettings(max_speed_mps=3.0)).max_speed_mps(mission) == 3.0


@pytest.mark.parametrize(
    ("mission", "speed_mps"),
    [(Ami.AUTOCROSS, 5.1), (Ami.TRACKDRIVE, 5.1), (Ami.SKIDPAD, 4.2), (Ami.ACCELERATION, 12.3)],
)
def test_a_mission_is_driven_at_its_own_pace(mission: Ami, speed_mps: float) -> None:
    own = {"lap_max_speed_mps": 5.1, "skidpad_max_speed_mps": 4.2, "acceleration_max_speed_mps": 12.3}
    assert Controller(CAR, ControllerSettings(**own)).max_speed_mps(mission) == speed_mps
    assert Controller(CAR, ControllerSettings(max_speed_mps=20.0, **own)).max_speed_mps(mission) == speed_mps


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


@pytest.mark.parametrize("radius", [12.0, -12.0, 6.0, -6.0])
def test_on_a_circle_the_steering_is_the_circles_own(radius: float) -> None:
    command = ask(plan_of(arc(radius)), speed_mps=0.0)
    assert command.steering_rad == pytest.approx(math.atan(CAR.wheelbase_m / radius), rel=0.03)


@pytest.mark.parametrize("car", [ADS_DV_2021, ADS_DV_2026])
@pytest.mark.parametrize("radius", [2.0, -2.0])
def test_steering_never_exceeds_the_cars_limit(car: VehicleParameters, radius: float) -> None:
    controller = reset_for(RUN, car)
    limit = car.steer_max_rad
    assert ask(plan_of(arc(radius, 6.0)), 2.0, controller).steering_rad == pytest.approx(math.copysign(limit, radius))


def test_steering_never_exceeds_a_lower_setting() -> None:
    controller = reset_for(RUN, CAR, ControllerSettings(max_steer_rad=0.1))
    assert ask(plan_of(arc(3.0)), 2.0, controller).steering_rad == pytest.approx(0.1)


def test_the_car_beside_the_path_steers_back_to_it() -> None:
    assert ask(plan_of(moved(STRAIGHT, 0.0, 0.5))).steering_rad > 0.05
    assert ask(plan_of(moved(STRAIGHT, 0.0, -0.5))).steering_rad < -0.05


def test_a_plan_is_carried_from_its_sensor_stamp_to_the_present() -> None:
    """Half a second at 6 m/s is 3 m: the bend that was 4 m ahead when it was seen is 1 m ahead now."""
    bend = bend_after(4.0, 5.0)
    controller = reset_for(RUN)
    for step in range(51):
        motion = Motion(t_ns=step * 10 * MS, x_m=step * 0.06, speed_mps=6.0, distance_m=step * 0.06)
        late = ask(plan_of(bend, 0), controller=controller, now_ns=step * 10 * MS, motion=motion)
    at_once = ask(plan_of(moved(bend, -3.0, 0.0), 0), speed_mps=6.0)
    assert late.steering_rad == pytest.approx(at_once.steering_rad, abs=0.01)
    assert ask(plan_of(bend, 0), speed_mps=6.0).steering_rad < 0.5 * late.steering_rad


def test_the_steering_is_early_by_its_own_delay() -> None:
    bend = bend_after(2.0, 5.0)
    slow, quick = (reset_for(RUN, CAR, ControllerSettings(delay_s=delay, lookahead_s=0.01)) for delay in (0.0, 0.2))
    assert ask(plan_of(bend), 6.0, quick).steering_rad > ask(plan_of(bend), 6.0, slow).steering_rad + 0.02


def test_a_bend_ahead_is_braked_for_in_time() -> None:
    bend = bend_after(8.0, 4.0)
    far = bend_after(19.5, 4.0)
    assert ask(plan_of(bend), speed_mps=8.0).brake > 0.1
    assert ask(plan_of(far), speed_mps=6.5).brake == 0.0


def test_corner_speed_keeps_to_the_lateral_acceleration() -> None:
    corner = arc(6.0)
    allowed = math.sqrt(SETTINGS.lateral_mps2 * 6.0)
    allowed_mps, _ = speed_demand(corner, np.arange(len(corner)) * 0.5, 5.0, 20.0, None, SETTINGS)
    assert allowed_mps <= math.sqrt(SETTINGS.end_of_path_mps**2 + 2 * SETTINGS.braking_mps2 * 18.0)
    assert allowed_mps == pytest.approx(allowed, rel=0.05)


def test_curvature_is_that_of_the_circle() -> None:
    assert curvature_along(arc(5.0)) == pytest.approx(np.full(36, 0.2), rel=0.01)
    assert curvature_along(STRAIGHT) == pytest.approx(np.zeros(40), abs=1e-9)
    assert curvature_along(STRAIGHT[:2]) == pytest.approx(np.zeros(2))


def test_the_brake_is_held_until_much_less_is_needed() -> None:
    """Between the two thresholds it stays as it was, so that it does not chatter."""
    controller = reset_for(RUN)
    between = 0.5 * (SETTINGS.brake_on_mps2 + SETTINGS.brake_off_mps2)
    speed = 5.0
    stop = speed * SETTINGS.reaction_s + speed**2 / (2.0 * between)
    assert ask(plan_of(STRAIGHT, stop_distance_m=stop), speed, controller).brake == 0.0
    assert ask(plan_of(STRAIGHT, stop_distance_m=0.5 * stop), speed, controller).brake > 0.0
    assert ask(plan_of(STRAIGHT, stop_distance_m=stop), speed, controller).brake > 0.0
    assert ask(plan_of(STRAIGHT, stop_distance_m=4.0 * stop), speed, controller).brake == 0.0


@pytest.mark.parametrize("path", [None, np.zeros((0, 2)), STRAIGHT[:2], np.full((20, 2), np.nan)])
def test_without_a_path_it_brakes_gently_with_steering_held(path: np.ndarray | None) -> None:
    controller = reset_for(RUN)
    steering = ask(plan_of(arc(8.0)), 4.0, controller).steering_rad
    assert steering > 0.1
    command = ask(None if path is None else plan_of(path), 4.0, controller)
    assert (command.throttle, command.brake) == (0.0, SETTINGS.gentle_brake)
    assert command.steering_rad == steering


@pytest.mark.parametrize(
    ("plan", "note"),
    [
        (None, "no plan from the planner"),
        (plan_of(np.zeros((0, 2)), note="no lane among 7 cones"), "no path: no lane among 7 cones"),
        (plan_of(STRAIGHT[:3], note="doubted"), "the path ends 1.0 m ahead: doubted"),
        (plan_of(STRAIGHT, note="doubted"), ""),
    ],
)
def test_what_keeps_the_controller_from_driving_is_told(plan: Plan | None, note: str) -> None:
    command = ask(plan, speed_mps=0.0)
    assert (command.note, command.throttle > 0.0) == (note, not note)
    assert ask(plan, run=replace(RUN, may_move=False)).note == ""


def test_a_car_that_stands_without_a_path_is_given_up() -> None:
    controller, lost = reset_for(RUN), plan_of(np.zeros((0, 2)), note="no cones")
    waits_ns = round(SETTINGS.give_up_s * 1e9)
    for t_ns in (0, waits_ns - 1):
        assert not ask(lost, 0.0, controller, now_ns=t_ns).estop_request
    command = ask(lost, 0.0, controller, now_ns=waits_ns)
    assert command.estop_request and not command.mission_finished
    assert command.note == "the car has stood for 30 s: no path: no cones"
    assert ask(plan_of(STRAIGHT), 0.0, controller).estop_request, "it stays so for this run"
    assert not ask(None, 0.0, controller, run=replace(RUN, run_id=4)).estop_request


def test_motion_gives_the_time_anew_and_the_finish_ends_it() -> None:
    controller = reset_for(RUN)
    lost, over = plan_of(np.zeros((0, 2))), plan_of(STRAIGHT, finished=True, stop_distance_m=0.0)
    for t_s, plan, speed_mps in ((0, lost, 0.0), (20, lost, 1.0), (40, lost, 0.0), (69, over, 0.0), (200, over, 0.0)):
        assert not ask(plan, speed_mps, controller, now_ns=t_s * 1000 * MS).estop_request


def test_a_car_that_does_not_move_as_asked_is_given_up_too() -> None:
    controller = reset_for(RUN)
    for t_ns in (0, round(SETTINGS.give_up_s * 1e9)):
        command = ask(plan_of(STRAIGHT, t_ns), 0.0, controller, now_ns=t_ns)
    assert command.estop_request and command.note.endswith("it does not do what it is asked")


def test_a_plan_of_another_run_or_mission_is_no_plan() -> None:
    for plan in (plan_of(STRAIGHT, run_id=2), plan_of(STRAIGHT, mission=Ami.SKIDPAD)):
        assert ask(plan, 2.0).throttle == 0.0


def test_a_plan_that_lies_behind_the_car_is_no_path() -> None:
    assert ask(plan_of(moved(STRAIGHT, -30.0, 0.0)), 4.0).brake == SETTINGS.gentle_brake


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


def test_a_mission_finished_at_the_stopping_place_stays_finished() -> None:
    controller = reset_for(RUN)
    assert not ask(plan_of(STRAIGHT, finished=True, stop_distance_m=10.0), 5.0, controller).mission_finished
    command = ask(plan_of(STRAIGHT, finished=True, stop_distance_m=0.2), 2.0, controller)
    assert command.mission_finished
    assert (command.throttle, command.brake > 0.0) == (0.0, True)
    command = ask(plan_of(STRAIGHT, finished=False), 2.0, controller)
    assert command.mission_finished
    assert command.throttle == 0.0


def test_distance_since_the_plan_counts_to_the_stopping_place() -> None:
    controller = reset_for(RUN)
    plan = plan_of(STRAIGHT, 0, finished=True, stop_distance_m=2.0)
    for step in range(31):
        motion = Motion(t_ns=step * 10 * MS, x_m=step * 0.06, speed_mps=6.0, distance_m=step * 0.06)
        command = ask(plan, controller=controller, now_ns=step * 10 * MS, motion=motion)
    assert command.mission_finished


def test_after_the_finish_there_is_no_throttle() -> None:
    assert ask(plan_of(STRAIGHT, finished=True, stop_distance_m=19.0), 3.0).throttle == 0.0


def test_nearly_at_rest_after_the_finish_is_finished_anywhere() -> None:
    assert ask(plan_of(STRAIGHT, finished=True, stop_distance_m=19.0), 0.3).mission_finished


def test_another_run_clears_the_finished_state() -> None:
    controller = reset_for(RUN)
    assert ask(plan_of(STRAIGHT, finished=True, stop_distance_m=0.0), 1.0, controller).mission_finished
    again = replace(RUN, run_id=4)
    assert not ask(plan_of(STRAIGHT, run_id=4), 1.0, controller, run=again).mission_finished


@settings(max_examples=150, deadline=None)
@given(
    data=st.lists(st.tuples(st.floats(-60, 60), st.floats(-60, 60)), min_size=0, max_size=30),
    speed=st.floats(0, 25),
    yaw_rate=st.floats(-3, 3),
    age_ms=st.integers(0, 1500),
    finished=st.booleans(),
    stop=st.none() | st.floats(0, 100),
    mission=st.sampled_from(list(Ami)),
    may_move=st.booleans(),
)
def test_every_command_is_valid_and_never_has_throttle_and_brake(
    data: list[tuple[float, float]],
    speed: float,
    yaw_rate: float,
    age_ms: int,
    finished: bool,
    stop: float | None,
    mission: Ami,
    may_move: bool,
) -> None:
    run = Run(3, mission, AsState.AS_DRIVING, may_move)
    controller = reset_for(run)
    path = np.array(data, dtype=np.float64).reshape(-1, 2)
    plan = Plan(0, 3, mission, path, finished=finished, stop_distance_m=stop)
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
