"""The controller: plan, motion and run in, one vehicle command out.

`mission_finished` means "stop now, for good": it is set once the plan says the last line is crossed and the stopping
place is reached (or the car is about at rest), and stays set for the run. `estop_request` stays set likewise: the
mission ends so, or the car has stood for too long where it should drive. FINISHED would claim a mission that was not
fulfilled. `note` says in words why it does not drive. Throttle and brake are never asked for together.
"""

from __future__ import annotations

import math

import numpy as np

from fsai_vcu.core.command import VehicleCommand
from fsai_vcu.core.control.path_tracking import lookahead_m, pursue
from fsai_vcu.core.control.settings import ControllerSettings
from fsai_vcu.core.control.speed_profile import speed_demand
from fsai_vcu.core.driving import Motion, Plan, Run
from fsai_vcu.core.missions.demo import DemoState, advance_demo
from fsai_vcu.core.missions.request import CarView, MissionRequest
from fsai_vcu.core.missions.settings import MissionSettings
from fsai_vcu.core.missions.static_inspection import InspectionState, advance_inspection, inspection_of
from fsai_vcu.core.planning.pose import lengths_along, to_odometry, to_vehicle
from fsai_vcu.core.vehicle.odometry import MotionHistory, motion_at
from fsai_vcu.core.vehicle.parameters import GRAVITY_MPS2, VehicleParameters
from fsai_vcu.interface.enums import Ami

WITHOUT_PATH = frozenset({Ami.STATIC_INSPECTION_A, Ami.STATIC_INSPECTION_B, Ami.AUTONOMOUS_DEMO})
SPEED_LIMIT_MARGIN_MPS = 1.0  # the motors' own limit, over the speed aimed at: it guards, it does not control
NEARLY_AT_REST_MPS = 1.5
AIR_DENSITY_KGPM3 = 1.2


class Controller:
    """Turns plans into commands, for the run in hand. `reset` forgets everything."""

    def __init__(
        self,
        car: VehicleParameters,
        settings: ControllerSettings | None = None,
        missions: MissionSettings | None = None,
    ) -> None:
        self._car = car
        self._settings = settings or ControllerSettings()
        self._missions = missions or MissionSettings()
        self._max_steer_rad = min(car.steer_max_rad, self._settings.max_steer_rad)
        self._history = MotionHistory()
        self.reset(Run(run_id=0))

    def reset(self, run: Run) -> None:
        """Forget everything: `run` begins."""
        self._run_id = run.run_id
        self._mission = run.mission
        self._history.clear()
        self._last_plan: Plan | None = None  # for the logging fields
        self._steering_rad = 0.0
        self._braking = False
        self._finished = False
        self._estop = False
        self._note = ""
        self._stood_since_ns: int | None = None  # where it should drive
        self._inspection = InspectionState()
        self._demo = DemoState()

    def configure(self, settings: ControllerSettings) -> None:
        """Other settings from now on; the run goes on."""
        self._settings = settings
        self._max_steer_rad = min(self._car.steer_max_rad, settings.max_steer_rad)

    def max_speed_mps(self, mission: Ami) -> float:
        """The most that is driven in a mission."""
        settings = self._settings
        own = {
            Ami.AUTOCROSS: settings.lap_max_speed_mps,
            Ami.TRACKDRIVE: settings.lap_max_speed_mps,
            Ami.SKIDPAD: settings.skidpad_max_speed_mps,
            Ami.ACCELERATION: settings.acceleration_max_speed_mps,
        }
        return min(settings.max_speed_mps, self._car.speed_max_mps, own.get(mission, math.inf))

    def too_slow(self, mission: Ami) -> str | None:
        """Why a mission that needs a certain speed will not be fulfilled, in one line; None where it can be."""
        missions = self._missions
        needed = {
            Ami.AUTONOMOUS_DEMO: missions.demo_speed_mps,
            Ami.STATIC_INSPECTION_A: self._car.speed_of_wheel_rpm(missions.inspection_a_rpm),
            Ami.STATIC_INSPECTION_B: self._car.speed_of_wheel_rpm(missions.inspection_b_rpm),
        }.get(mission, 0.0)
        allowed = self.max_speed_mps(mission)
        if needed <= allowed:
            return None
        return f"{mission.label} needs {needed:.2f} m/s, but the speed limit is {allowed:.2f} m/s: it stays below that"

    def command(
        self,
        plan: Plan | None,
        motion: Motion,
        vehicle_standing: bool,
        wheel_speeds_rpm: tuple[float, float, float, float],
        steer_deg: float,
        run: Run,
        now_ns: int,
    ) -> VehicleCommand:
        """The command at `now_ns`. `steer_deg` is the measured angle, `wheel_speeds_rpm` are FL, FR, RL, RR."""
        if run.run_id != self._run_id or run.mission != self._mission:
            self.reset(run)
        self._history.add(motion)
        if plan is not None and (plan.run_id != run.run_id or plan.mission != run.mission):
            plan = None
        if run.mission in WITHOUT_PATH:
            if not run.may_move:
                return VehicleCommand(t_sensor_ns=motion.t_ns, run_id=run.run_id)
            steer_rad = math.radians(steer_deg) if math.isfinite(steer_deg) else 0.0
            view = CarView(now_ns, motion, wheel_speeds_rpm, steer_rad, vehicle_standing)
            return self._without_path(view, run)
        return self._along_path(plan, motion, vehicle_standing, run, now_ns)

    def _without_path(self, view: CarView, run: Run) -> VehicleCommand:
        request: MissionRequest
        limit = self.max_speed_mps(run.mission)
        if run.mission is Ami.AUTONOMOUS_DEMO:
            self._demo, request = advance_demo(self._demo, view, self._max_steer_rad, self._missions, limit)
        else:
            self._inspection, request = advance_inspection(
                inspection_of(run.mission, self._missions),
                self._inspection,
                view,
                self._car,
                self._max_steer_rad,
                self._missions,
                limit,
            )
        self._finished |= request.finished
        self._estop |= request.estop
        return VehicleCommand(
            t_sensor_ns=view.motion.t_ns,
            run_id=run.run_id,
            steering_rad=self._within(request.steering_rad),
            throttle=request.throttle,
            brake=request.brake,
            speed_limit_mps=request.speed_limit_mps,
            mission_finished=self._finished,
            estop_request=self._estop,
        )

    def _along_path(
        self, plan: Plan | None, motion: Motion, vehicle_standing: bool, run: Run, now_ns: int
    ) -> VehicleCommand:
        if plan is not None:
            self._last_plan = plan
        last = self._last_plan
        throttle, brake = 0.0, 0.0
        limit = self.max_speed_mps(run.mission) + SPEED_LIMIT_MARGIN_MPS
        self._note = ""
        if not run.may_move:
            self._steering_rad, self._braking, limit = 0.0, False, 0.0
        else:
            throttle, brake = self._drive(plan, motion, run, now_ns)
            self._give_up(vehicle_standing, now_ns)
        return VehicleCommand(
            t_sensor_ns=plan.t_sensor_ns if plan is not None else motion.t_ns,
            run_id=run.run_id,
            steering_rad=self._steering_rad,
            throttle=throttle,
            brake=brake,
            speed_limit_mps=limit,
            mission_finished=self._finished,
            estop_request=self._estop,
            laps=last.laps if last is not None else 0,
            cones_count_actual=last.cones_count_actual if last is not None else 0,
            cones_count_all=last.cones_count_all if last is not None else 0,
            note=self._note,
        )

    def _give_up(self, vehicle_standing: bool, now_ns: int) -> None:
        """Ask for the end, with the reason, where the car has stood for too long instead of driving."""
        if self._finished or not vehicle_standing:
            self._stood_since_ns = None
            return
        if self._stood_since_ns is None:
            self._stood_since_ns = now_ns
        stood_s = (now_ns - self._stood_since_ns) / 1e9
        if stood_s >= self._settings.give_up_s:
            self._estop = True
            self._note = f"the car has stood for {stood_s:.0f} s: {self._note or 'it does not do what it is asked'}"

    def _drive(self, plan: Plan | None, motion: Motion, run: Run, now_ns: int) -> tuple[float, float]:
        """Throttle and brake; the steering is left in `_steering_rad`."""
        settings = self._settings
        speed = motion.speed_mps
        there = self._history.at(plan.t_sensor_ns) if plan is not None else None
        if plan is None or there is None:
            return self._no_way("no plan from the planner")
        driven = motion_at(motion, now_ns).distance_m - there.distance_m
        stop_m = None if plan.stop_distance_m is None else plan.stop_distance_m - driven
        if plan.finished and (speed < NEARLY_AT_REST_MPS or (stop_m is not None and stop_m <= 0.1 * speed + 0.3)):
            self._finished = True

        path = np.asarray(plan.path_m, dtype=np.float64).reshape(-1, 2)
        if len(path) < 3 or not np.isfinite(path).all():
            return self._no_way(f"no path: {plan.note or f'{plan.cones_count_actual} cones are seen'}")
        predicted = motion_at(motion, now_ns + round(settings.delay_s * 1e9))
        here = to_vehicle(predicted, to_odometry(there, path))
        along = lengths_along(here)
        nearest = int((here[:, 0] ** 2 + here[:, 1] ** 2).argmin())
        length_m = along[-1] - along[nearest]
        if length_m < settings.path_min_m:
            return self._no_way(f"the path ends {length_m:.1f} m ahead" + (f": {plan.note}" if plan.note else ""))
        steering = pursue(here, along, nearest, lookahead_m(speed, settings), self._car.wheelbase_m)
        if steering is not None:
            self._steering_rad = self._within(steering)
        if self._finished:
            return 0.0, settings.final_brake
        age_s = (now_ns - plan.t_sensor_ns) / 1e9
        if age_s > settings.plan_lost_s:
            return 0.0, settings.gentle_brake

        allowed_mps, needed_mps2 = speed_demand(
            here[nearest:],
            along[nearest:] - along[nearest],
            speed,
            self.max_speed_mps(run.mission),
            stop_m,
            settings,
        )
        threshold = settings.brake_off_mps2 if self._braking else settings.brake_on_mps2
        self._braking = needed_mps2 > threshold and speed > 0.3
        if self._braking:
            return 0.0, self._brake_for(min(needed_mps2, settings.braking_max_mps2))
        if plan.finished or age_s > settings.plan_old_s or speed >= allowed_mps:
            return 0.0, 0.0
        return self._throttle_for(settings.speed_gain_1ps * (allowed_mps - speed), speed), 0.0

    def _no_way(self, why: str) -> tuple[float, float]:
        """No path to drive on: brake, steering as it was."""
        self._braking, self._note = True, why
        return 0.0, self._settings.final_brake if self._finished else self._settings.gentle_brake

    def _within(self, steering_rad: float) -> float:
        return min(max(steering_rad, -self._max_steer_rad), self._max_steer_rad)

    def _brake_for(self, deceleration_mps2: float) -> float:
        return min(max(deceleration_mps2 / (self._car.brake_full_mps2 * self._car.brake_excess), 0.0), 1.0)

    def _throttle_for(self, acceleration_mps2: float, speed_mps: float) -> float:
        """Fraction of the full axle torque that gives an acceleration on the level."""
        car = self._car
        force = (
            (car.mass_kg + car.rotating_mass_kg) * acceleration_mps2
            + car.rolling_resistance * car.mass_kg * GRAVITY_MPS2
            + 0.5 * AIR_DENSITY_KGPM3 * car.drag_area_m2 * speed_mps**2
        )
        per_axle_nm = force * car.rolling_radius_m / max(car.driven_axles, 1)
        return min(max(per_axle_nm / car.axle_torque_max_nm, 0.0), 1.0)
