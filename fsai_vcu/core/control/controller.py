"""The controller: plan, motion and run in, one vehicle command out.

`mission_finished` means "stop now, until the run ends": it is set once the plan says the last line is crossed, the
stopping place is reached (or the car is about at rest) and the car stands, so that the full brake holds a car and does
not jolt it; a car that is fast there, or does not come to rest in time, is stopped at once. It stays set for the run.
`estop_request` stays set as well:
the mission ends so, or the car has stood for too long where it should drive. FINISHED would claim a mission that was
not fulfilled. `note` says in words why it does not drive. Throttle and brake are never asked for together.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from fsai_vcu.core.arrays import Floats
from fsai_vcu.core.command import VehicleCommand
from fsai_vcu.core.control.pace import Pace, Signs, axle_slip
from fsai_vcu.core.control.path_tracking import STEP_M, PathLine, line_of, steering_rate
from fsai_vcu.core.control.settings import ControllerSettings
from fsai_vcu.core.control.sight import BEYOND_CONES_M, Sight, stopping_m
from fsai_vcu.core.control.speed_profile import braking_share, speed_profile
from fsai_vcu.core.driving import Motion, Plan, Run
from fsai_vcu.core.missions.demo import DemoState, advance_demo
from fsai_vcu.core.missions.request import CarView, MissionRequest
from fsai_vcu.core.missions.settings import MissionSettings
from fsai_vcu.core.missions.static_inspection import InspectionState, advance_inspection, inspection_of
from fsai_vcu.core.vehicle.forces import brake_for, most_mps2, throttle_for, traction_mps2
from fsai_vcu.core.vehicle.odometry import CARRIED_NS, MotionHistory, motion_at
from fsai_vcu.core.vehicle.odometry import SETTINGS as ODOMETRY
from fsai_vcu.core.vehicle.parameters import (
    SLIP_LEAST_RADPMPS2,
    SLIP_MOST_RADPMPS2,
    SLIP_RADPMPS2,
    VehicleParameters,
)
from fsai_vcu.interface.enums import Ami

WITHOUT_PATH = frozenset({Ami.STATIC_INSPECTION_A, Ami.STATIC_INSPECTION_B, Ami.AUTONOMOUS_DEMO})
SPEED_LIMIT_MARGIN_MPS = 1.0  # the motors' own limit, over the speed aimed at: it guards, it does not control
HELD_BELOW_MPS = 0.1  # so that a speed held does not exceed the one that is set
NEARLY_AT_REST_MPS = 0.3
# At the stopping place a car that is slower than this brakes to rest gently, for so long at most.
GENTLE_END_MPS, GENTLE_END_MPS2, GENTLE_END_S = 2.5, 1.5, 3.0
ASIDE_MAX_M = 4.0  # a path further beside the car …
AHEAD_MAX_M = 6.0  # … or that begins further ahead of it is not one from where it is
# A car that turns so much and moves so far off its path's direction gains no speed beyond this: on its way out of a
# hairpin, where the steering was at its end, the steering needs all its rate to get back.
ASKEW_1PM, ASKEW_RAD, ASKEW_MPS = 0.2, 0.07, 2.5  # a slower one gains none while its steering turns at its full rate
FEEL_ITS_WAY_MPS = 1.5  # so slow it drives on where hardly any path is borne out
IN_DOUBT_MPS2 = 0.7  # at once less than what the brake is used for
PRESET = frozenset({Ami.ACCELERATION, Ami.SKIDPAD})  # paths whose whole course is known beforehand
STEER_RATE_SHARE = 0.75  # planned with; the rest is for corrections
PREDICTED_IN = 5  # steps
STEERED_KEPT = 50  # commands: half a second at 100 Hz
LONGEST_STEP_S = 0.1  # between two commands; a longer one counts as this
TAKEN_BACK = 0.02  # of the pace at once: trouble, and no slow change
BEYOND_GRIP_MPS2 = 1.2  # braked with where the path asks for all the grip that there is, or more
GRIP_MPS2 = 7.5  # sideways, believed of the tyres on a path that follows no map
TURNS_IN = 1.1  # times its path's bend: a car that brakes turns in more, and that takes of its brakes
LEFT_FOR_SURPRISES = 1.05  # times the grip planned with: what throttle and brake share with the corner as it is driven
LEAST_BRAKE = 0.005  # the request's resolution: the brake makes its own least of it


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
        self._planned: Plan | None = None  # what line and profile were made of
        self._line: PathLine | None = None
        self._profile: Floats | None = None
        self._sight = Sight()
        self._sight_end_m = math.inf  # along the line, of the rear axle when the front wheels are where sight ends
        self._bend_1pm = 0.0  # of the line up to there
        self._seen_until_m = math.inf  # how far driven when the front wheels are where the last sight of all ends
        self._pace, self._axle_slip = Pace(), 0.0  # of racing laps; as the wheels turn now
        self._doubted: tuple[float, float] | None = None  # how far driven, and how fast, when the path was last sure
        self._steering_rad = 0.0
        self._steered = deque([(-1.0, 0.0)], STEERED_KEPT)  # when (s) which road angle (rad) was asked for
        self._turned_rad = 0.0  # follows it, but for small changes to and fro
        self._taken_up_rad = 0.0  # asked for beyond it, as the backlash is taken up to one side
        self._acceleration_mps2 = 0.0  # asked for last …
        self._accelerated_ns: int | None = None  # … and when
        self._braking = False
        self._ending_since_ns: int | None = None  # at the stopping place, braking to rest
        self._finished = False
        self._estop = False
        self._note = ""
        self._stood_since_ns: int | None = None  # where it should drive
        self._inspection = InspectionState()
        self._demo = DemoState()

    def configure(self, settings: ControllerSettings) -> None:
        """Other settings from now on; the run goes on."""
        self._settings = settings
        self._planned = None
        self._max_steer_rad = min(self._car.steer_max_rad, settings.max_steer_rad)

    def max_speed_mps(self, mission: Ami, mapped: bool = False) -> float:
        """The most that is driven in a mission, on a path that follows a map or not."""
        settings = self._settings
        lap = settings.race_max_speed_mps if mapped else settings.lap_max_speed_mps
        own = {
            Ami.AUTOCROSS: lap,
            Ami.TRACKDRIVE: lap,
            Ami.SKIDPAD: settings.skidpad_max_speed_mps,
            Ami.ACCELERATION: settings.acceleration_max_speed_mps,
        }
        return min(settings.max_speed_mps, self._car.speed_max_mps, own.get(mission, math.inf))

    def too_slow(self, mission: Ami) -> str | None:
        """Say in one line why a mission that needs a certain speed will not be fulfilled; None where it can be."""
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
        self._axle_slip = axle_slip(wheel_speeds_rpm)
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
        """Return the command of a mission without a path: the demo or an inspection."""
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
        """Return the command of a mission with a path, for the newest plan that there is."""
        if plan is not None:
            self._last_plan = plan
        last = self._last_plan
        throttle, brake = 0.0, 0.0
        limit = self.max_speed_mps(run.mission, last is not None and last.mapped) + SPEED_LIMIT_MARGIN_MPS
        self._note = ""
        if not run.may_move:
            self._steering_rad, self._braking, limit = 0.0, False, 0.0
            self._steered.append((now_ns / 1e9, 0.0))
            self._accelerated_ns = now_ns
        else:
            throttle, brake = self._drive(plan, motion, run, now_ns)
            if plan is not None and plan.lost:
                self._note, throttle, brake = plan.note, 0.0, max(brake, self._settings.final_brake)
            self._finish(vehicle_standing, motion.speed_mps, now_ns)
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

    def _finish(self, vehicle_standing: bool, speed: float, now_ns: int) -> None:
        """Set the mission's end where the car stands at its stopping place, or does not come to rest there gently."""
        since_ns = self._ending_since_ns
        if since_ns is not None:
            overdue = speed > GENTLE_END_MPS or now_ns - since_ns > GENTLE_END_S * 1e9
            self._finished |= vehicle_standing or overdue

    def _end_brake(self, speed: float) -> float:
        """Return the brake at the stopping place: gentle while the car is slow and moves, else firm."""
        if self._finished or speed > GENTLE_END_MPS:
            return self._settings.final_brake
        return max(brake_for(self._car, GENTLE_END_MPS2, speed), LEAST_BRAKE)

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
            self._note = f"the car has stood for {stood_s:.0f} s: {self._note or 'it does not follow the command'}"

    def _drive(self, plan: Plan | None, motion: Motion, run: Run, now_ns: int) -> tuple[float, float]:
        """Throttle and brake; the steering is left in `_steering_rad`."""
        settings = self._settings
        speed = motion.speed_mps
        there = self._history.at(plan.t_sensor_ns) if plan is not None else None
        if plan is None or there is None:
            return self._no_way(motion, "no plan from the planner")
        driven = motion_at(motion, now_ns).distance_m - there.distance_m
        stop_m = None if plan.stop_distance_m is None else plan.stop_distance_m - driven
        there_now = speed < NEARLY_AT_REST_MPS or (stop_m is not None and stop_m <= 0.1 * speed + 0.3)
        if plan.finished and there_now and self._ending_since_ns is None:
            self._ending_since_ns = now_ns
        if plan is not self._planned:
            oldest_s = (now_ns - (self._planned or plan).t_sensor_ns) / 1e9  # the plan before was, until this one came
            self._planned, self._line = plan, line_of(np.asarray(plan.path_m, dtype=np.float64).reshape(-1, 2))
            self._profile = None
            if self._line is not None:
                self._profile = self._profile_of(plan, self._line, speed, there.distance_m, driven, oldest_s)
            else:
                self._sight.look_without_path(there.distance_m, oldest_s)
        line = self._line
        if line is None:
            return self._no_way(motion, f"no path: {plan.note or f'{plan.cones_count_actual} cones are seen'}")

        x, y, course, travel = self._predicted(plan, there, motion, now_ns)
        station, left = line.beside(x, y, driven)
        if abs(left) > ASIDE_MAX_M or station < -AHEAD_MAX_M:
            return self._no_way(motion, "the path is not where the car is")
        length_m = line.along_m[-1] - station
        if length_m < settings.path_min_m:
            return self._no_way(
                motion, f"the path ends {length_m:.1f} m ahead" + (f": {plan.note}" if plan.note else "")
            )
        angle_rad = slip_of(plan) * settings.race_lateral_mps2 if plan.slip_radpmps2 > 0.0 else 0.0
        sure = plan.mapped and plan.confidence >= settings.confidence_sure
        turn_sensed = 0.0 < motion.yaw_rate_sd_radps <= ODOMETRY.yaw_rate_sd_radps
        pace = self._pace.after(Signs(motion.distance_m, left, self._axle_slip, angle_rad, sure, turn_sensed))
        if pace.gain < self._pace.gain - TAKEN_BACK:
            self._planned = None  # the next cycle's profile is of the new pace
        self._pace = pace
        curvature = math.tan(self._steered[-1][1]) / self._car.wheelbase_m
        rate_1pms = steering_rate(line, station, left, course, curvature, speed)
        self._steer(curvature, rate_1pms, now_ns)
        if self._ending_since_ns is not None:
            return 0.0, self._end_brake(speed)
        age_s = (now_ns - plan.t_sensor_ns) / 1e9
        if plan.confidence < settings.confidence_min and speed < NEARLY_AT_REST_MPS:
            self._note = "the path ends, and nothing confirms that it continues" + (
                f": {plan.note}" if plan.note else ""
            )
        if age_s > settings.plan_old_s:
            self._note = f"the plan is {age_s:.1f} s old"
        askew = math.remainder(course - float(np.interp(station, line.along_m, line.heading_rad)), 2.0 * math.pi)
        late = not plan.mapped and abs(curvature) > ASKEW_1PM and abs(askew) > ASKEW_RAD
        if speed <= ASKEW_MPS:
            late = abs(rate_1pms) * self._car.wheelbase_m > self._car.steer_rate_radps
        throttle, brake = self._accelerate(line, station - travel, motion, late, now_ns)
        if age_s > settings.plan_lost_s:
            return 0.0, max(brake, settings.gentle_brake)
        return 0.0 if plan.finished or age_s > settings.plan_old_s else throttle, brake

    def _profile_of(
        self, plan: Plan, line: PathLine, speed: float, seen_from_m: float, driven_m: float, oldest_s: float
    ) -> Floats:
        """Square of the speed along the line.

        The plan is of the place `seen_from_m`, the car `driven_m` further. When it came, the plan before it was
        `oldest_s` old.
        """
        settings, car = self._settings, self._car
        here = line.beside(0.0, 0.0)[0]
        sure = min(1.0, plan.confidence / settings.confidence_sure)
        stops = plan.confidence < settings.confidence_min
        length_m, supported_m = float(line.along_m[-1]) - here, plan.supported_m
        if math.isfinite(supported_m):
            # Resampled, a path is up to a step shorter, and its first point up to half a step behind the car.
            supported_m = min(supported_m, length_m + 1.5 * STEP_M)
        # The nose of a car that stops must not pass the end of the supported path.
        ahead_m = supported_m - (car.nose_ahead_of_rear_axle_m if stops else 0.0)
        end = min(float(line.along_m[-1]), here + ahead_m), 0.0 if stops else settings.end_of_path_mps * sure
        stop_m = None if plan.stop_distance_m is None else here + plan.stop_distance_m

        def profile(ceiling: Floats, lateral: float, braking: float, end: tuple[float, float] = end) -> Floats:
            rate_1pms = STEER_RATE_SHARE * car.steer_rate_radps / car.wheelbase_m
            grip_mps2 = lateral, braking, settings.stopping_mps2
            return speed_profile(line.curvature_1pm, ceiling, end, stop_m, grip_mps2, rate_1pms)

        known = plan.mapped or plan.mission in PRESET
        most = self.max_speed_mps(plan.mission, plan.mapped) - HELD_BELOW_MPS
        allowed = most if known else min(most, settings.careful_mps - HELD_BELOW_MPS)
        lateral, braking = self._grip_mps2(plan.mapped, known)
        at_m = seen_from_m + line.along_m - here  # along the driven path
        now_m, borne_out_m = seen_from_m + driven_m, supported_m - car.wheelbase_m
        slowest = profile(self._careful(sure, allowed, now_m, speed, at_m), lateral, braking)
        # The front wheels can stop on what cones bear out.
        left_m = seen_from_m + borne_out_m - at_m
        slowest = np.minimum(slowest, np.maximum(2.0 * settings.stopping_mps2 * left_m, FEEL_ITS_WAY_MPS**2))
        self._sight_end_m = math.inf
        if known or allowed == most or plan.lost:
            self._sight, self._seen_until_m = Sight(), math.inf
            return slowest
        supported_m = supported_m if math.isfinite(supported_m) else length_m
        sight_m = supported_m - car.wheelbase_m + BEYOND_CONES_M
        self._sight.look(plan.confidence, supported_m, sight_m, seen_from_m, oldest_s)
        braking = settings.sight_braking_mps2
        # A bend that opens takes more of the grip at first, when the car is fastest.
        bends = [
            np.abs(line.curvature_1pm[(line.along_m >= here) & (line.along_m <= here + share * sight_m)])
            for share in (0.5, 1.0)
        ]
        self._bend_1pm = TURNS_IN * max(float(bend.mean()) if len(bend) else 0.0 for bend in bends)
        by_sight = self._sight.ceiling(braking, settings.reaction_s, self._bend_1pm, now_m, speed, at_m)
        if by_sight.max() <= FEEL_ITS_WAY_MPS**2:
            self._seen_until_m = math.inf
            return slowest
        self._sight_end_m, self._seen_until_m = here + sight_m, seen_from_m + sight_m
        end = end[0], 0.0 if stops else most  # the car can stop before it
        faster: Floats = profile(np.minimum(by_sight, most**2), settings.sight_lateral_mps2, braking, end)
        return np.maximum(slowest, faster)

    def _careful(self, sure: float, allowed_mps: float, now_m: float, speed: float, at_m: Floats) -> Floats:
        """(N,) square of the speed allowed at places along the driven path on a path that is so sure, from 0 to 1.

        From where doubt began the car slows gently: a single doubtful look, soon outweighed, must not brake.
        """
        if sure == 1.0 or self._doubted is None:
            self._doubted = now_m, speed
        doubted_m, began_mps = self._doubted
        rolling = began_mps**2 - 2.0 * IN_DOUBT_MPS2 * (at_m - doubted_m)
        ceiling: Floats = np.minimum(np.maximum((allowed_mps * max(sure, 0.3)) ** 2, rolling), allowed_mps**2)
        return ceiling

    def _grip_mps2(self, mapped: bool, known: bool) -> tuple[float, float]:
        """Return what is asked of the tyres: lateral in corners, and braking before them.

        mapped: the path follows a map; known: its whole course is known, by a map or beforehand.
        """
        settings, gain = self._settings, self._pace.gain
        lateral = gain * settings.race_lateral_mps2 if mapped else settings.lateral_mps2
        return lateral, gain * settings.race_braking_mps2 if known else settings.braking_mps2

    def _predicted(self, plan: Plan, there: Motion, motion: Motion, now_ns: int) -> tuple[float, float, float, float]:
        """Predict the rear axle when the steering answers: x, y (m), course (rad), and the distance until then (m).

        All are in the vehicle frame of `there`. The steering has been told what the car will do until then. Tyres slip,
        so the axle moves further outward than the car points.
        """
        delay_s = self._settings.delay_s + slip_of(plan) * motion.speed_mps  # the tyres' answer, too
        t_s = min(now_ns - motion.t_ns, CARRIED_NS) / 1e9 + delay_s
        steps = np.arange(PREDICTED_IN) + 0.5
        asked = np.array(self._steered)
        told_s = motion.t_ns / 1e9 - delay_s + steps * t_s / PREDICTED_IN
        speed, way = motion.speed_mps, motion.speed_mps * t_s / PREDICTED_IN
        turns = way * np.tan(np.interp(told_s, asked[:, 0], asked[:, 1])) / self._car.wheelbase_m
        slip = slip_of(plan) * speed * motion.yaw_rate_radps
        course = motion.yaw_rad - there.yaw_rad - slip
        courses = course + turns.cumsum() - 0.5 * turns
        dx, dy = motion.x_m - there.x_m, motion.y_m - there.y_m
        cos, sin = math.cos(there.yaw_rad), math.sin(there.yaw_rad)
        x = dx * cos + dy * sin + way * float(np.cos(courses).sum())
        y = dy * cos - dx * sin + way * float(np.sin(courses).sum())
        y -= slip * (motion.distance_m - there.distance_m)
        return x, y, course + float(turns.sum()), speed * delay_s

    def _steer(self, curvature_1pm: float, rate_1pms: float, now_ns: int) -> None:
        """Change the curvature asked for last, as fast as the actuator turns, and beyond its backlash."""
        car, settings = self._car, self._settings
        last_s, last_rad = self._steered[-1]
        now_s = now_ns / 1e9
        if now_s - last_s > LONGEST_STEP_S:  # asked for until now
            last_s = now_s - LONGEST_STEP_S
            self._steered.append((last_s, last_rad))
        step_s = now_s - last_s
        wanted = self._within(math.atan(car.wheelbase_m * (curvature_1pm + rate_1pms * step_s)))
        most = car.steer_rate_radps * step_s
        road = min(max(wanted, last_rad - most), last_rad + most)
        self._steered.append((now_s, road))
        turned = road - self._turned_rad
        if abs(turned) > settings.steer_play_rad:
            self._turned_rad = road - math.copysign(settings.steer_play_rad, turned)
            self._taken_up_rad = math.copysign(settings.backlash_share * car.steer_backlash_rad, turned)
        self._steering_rad = self._within(road + self._taken_up_rad)

    def _accelerate(
        self, line: PathLine, here_m: float, motion: Motion, late: bool, now_ns: int
    ) -> tuple[float, float]:
        """Return throttle and brake that meet the profile a moment ahead: of bounded jerk, and no throttle if late."""
        settings, speed = self._settings, motion.speed_mps
        assert self._profile is not None
        later = speed + self._acceleration_mps2 * settings.reaction_s
        ahead_m = here_m + speed * settings.reaction_s + max(later, 0.0) * settings.preview_s
        aim = math.sqrt(float(np.interp(ahead_m, line.along_m, self._profile)))
        wanted = (aim - later) / settings.preview_s
        # A profile that sinks at once (a map that is lost), or a car that turns more than its path, asks for no more
        # than the tyres have left in the corner.
        curvature = abs(float(np.interp(here_m, line.along_m, line.curvature_1pm)))
        lateral = speed * max(speed * curvature, abs(motion.yaw_rate_radps))
        mapped = self._planned is not None and self._planned.mapped
        grip = LEFT_FOR_SURPRISES * (self._grip_mps2(mapped, known=True)[0] if mapped else GRIP_MPS2)
        most_braking = settings.sight_braking_max_mps2 if self._sight_end_m < math.inf else settings.braking_max_mps2
        hardest = max(most_braking * braking_share(lateral / grip), BEYOND_GRIP_MPS2)
        left = traction_mps2(self._car, grip, speed * motion.yaw_rate_radps)
        most = 0.0 if late else min(most_mps2(self._car, speed), left)
        wanted = min(max(wanted, -hardest), most)
        if self._accelerated_ns is not None:
            change = settings.jerk_mps3 * min((now_ns - self._accelerated_ns) / 1e9, LONGEST_STEP_S)
            wanted = min(wanted, self._acceleration_mps2 + change)
            if wanted > -hardest:  # what nobody could foresee is braked for at once
                wanted = max(wanted, self._acceleration_mps2 - change)
        self._acceleration_mps2, self._accelerated_ns = wanted, now_ns
        # Sight too short for a moment is braked for as long as it is, and no longer: the next look may see further.
        for_sight = max(self._for_sight(self._sight_end_m - here_m, speed), -hardest)
        if for_sight < wanted:
            self._acceleration_mps2, wanted = min(wanted, 0.0), for_sight  # after it throttle comes gradually
        self._braking = wanted < -(settings.brake_off_mps2 if self._braking else settings.brake_on_mps2)
        if self._braking and speed > 0.3:
            return 0.0, max(brake_for(self._car, -wanted, speed), LEAST_BRAKE)
        return throttle_for(self._car, wanted, speed), 0.0

    def _for_sight(self, sight_m: float, speed: float) -> float:
        """Return the acceleration that brings the car within sight to a speed at which it feels its way, or inf.

        It is inf as long as less is needed than half-way from the braking planned with to the most that is used; in a
        bend, which leaves the brakes little to make up with, sooner.
        """
        planned_mps2, most_mps2 = self._settings.sight_braking_mps2, self._settings.sight_braking_max_mps2
        spare = braking_share(speed * speed * self._bend_1pm / planned_mps2)
        grip_mps2 = planned_mps2 + 0.5 * spare * max(most_mps2 - planned_mps2, 0.0)
        left_m = max(sight_m - speed * self._settings.reaction_s, 0.0)
        slow_mps = min(speed, FEEL_ITS_WAY_MPS)
        stop_m = stopping_m(speed * speed, self._bend_1pm, grip_mps2)
        needed_m = stop_m - stopping_m(slow_mps * slow_mps, self._bend_1pm, grip_mps2)
        return -grip_mps2 * needed_m / max(left_m, 0.1) if needed_m > left_m else math.inf

    def _no_way(self, motion: Motion, why: str) -> tuple[float, float]:
        """No path to drive on: brake, steering as it was."""
        self._braking, self._note = True, why
        self._pace = self._pace.taken_back(motion.distance_m)
        self._acceleration_mps2 = 0.0
        if self._ending_since_ns is not None:
            return 0.0, self._end_brake(motion.speed_mps)
        return 0.0, max(self._settings.gentle_brake, self._sight_brake(motion))

    def _sight_brake(self, motion: Motion) -> float:
        """Return the brake by which a car that drives by sight stops within what it last saw; 0 while less will do.

        It is no more than what the bend leaves of the grip.
        """
        speed = motion.speed_mps
        wanted = -self._for_sight(self._seen_until_m - motion.distance_m, speed)
        used = speed * abs(motion.yaw_rate_radps) / (LEFT_FOR_SURPRISES * GRIP_MPS2)
        hardest = max(self._settings.sight_braking_max_mps2 * braking_share(used), BEYOND_GRIP_MPS2)
        return brake_for(self._car, min(wanted, hardest), speed) if wanted > 0.0 else 0.0

    def _within(self, steering_rad: float) -> float:
        return min(max(steering_rad, -self._max_steer_rad), self._max_steer_rad)


def slip_of(plan: Plan) -> float:
    """Return the slip angle of the rear axle by lateral acceleration: as measured, within what tyres do; or assumed."""
    if not plan.slip_radpmps2 > 0.0:
        return SLIP_RADPMPS2
    return min(max(plan.slip_radpmps2, SLIP_LEAST_RADPMPS2), SLIP_MOST_RADPMPS2)
