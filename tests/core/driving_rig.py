"""A small test rig for the driving chain: a kinematic bicycle among cones, with a simple cone detector.

It knows delays, rates and limits of the actuators but no tyres; the true car is simulated elsewhere. Random numbers
come from a seed only.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from fsai_hil.simulator import tracks
from fsai_vcu.core.command import VehicleCommand
from fsai_vcu.core.control.controller import Controller
from fsai_vcu.core.driving import ConeObservation, Motion, Plan, Run
from fsai_vcu.core.planning.planner import Planner
from fsai_vcu.core.vehicle.parameters import ADS_DV_2026, GRAVITY_MPS2, VehicleParameters
from fsai_vcu.interface.enums import Ami, AsState

STEP_NS = 10_000_000


@dataclass(frozen=True)
class Track:
    """xy_m (N, 2), color (N,) and the pose at which the rear axle starts. midline_m (M, 2): where known."""

    xy_m: NDArray[np.float64]
    color: NDArray[np.int64]
    start: tuple[float, float, float]
    midline_m: NDArray[np.float64] | None = None


@dataclass(frozen=True)
class Eyes:
    """The cone detector."""

    range_m: float = 15.0
    half_angle_rad: float = math.radians(60.0)
    noise_m: float = 0.05
    miss: float = 0.0
    false_per_look: float = 0.0
    colors: bool = True
    period_ns: int = 100_000_000
    latency_ns: int = 60_000_000


@dataclass
class Result:
    """How a run went. path_m: (N, 2) of the rear axle; hits: cones touched."""

    path_m: list[tuple[float, float]] = field(default_factory=list)
    speeds_mps: list[float] = field(default_factory=list)
    commands: list[VehicleCommand] = field(default_factory=list)
    plans: list[Plan] = field(default_factory=list)
    hits: set[int] = field(default_factory=set)
    hit_at: list[tuple[float, float, float]] = field(default_factory=list)
    laps: int = 0
    finished: bool = False
    estop: bool = False
    stands: bool = False
    time_s: float = 0.0
    motions: list[Motion] = field(default_factory=list)

    def off_line_m(self, line_m: NDArray[np.float64]) -> float:
        """The furthest that the rear axle was from a line."""
        path = np.array(self.path_m)[::5]
        gap = np.hypot(path[:, None, 0] - line_m[None, :, 0], path[:, None, 1] - line_m[None, :, 1])
        return float(gap.min(axis=1).max())


class Rig:
    """Car, detector, planner and controller on one virtual clock."""

    def __init__(
        self,
        track: Track,
        mission: Ami,
        car: VehicleParameters,
        planner: Planner,
        controller: Controller,
        eyes: Eyes | None = None,
        seed: int = 1,
        speed_error: float = 0.005,
        yaw_rate_error_radps: float = 0.002,
    ) -> None:
        self.track, self.car, self.planner, self.controller = track, car, planner, controller
        self.eyes = eyes or Eyes()
        self.random = np.random.default_rng(seed)
        self.speed_error, self.yaw_rate_error = 1.0 + speed_error, yaw_rate_error_radps
        self.t_ns = 0
        self.x, self.y, self.yaw = track.start
        self.speed = self.steer = self.yaw_rate = 0.0
        self.motion = Motion()
        self.run_state = Run(run_id=7, mission=mission, as_state=AsState.AS_OFF)
        self.steer_queue: deque[float] = deque([0.0] * round(car.steer_dead_time_s * 1e9 / STEP_NS))
        self.brake_queue: deque[float] = deque([0.0] * round(car.brake_dead_time_s * 1e9 / STEP_NS))
        self.in_sight: deque[tuple[int, ConeObservation, Motion]] = deque()
        self.plan: Plan | None = None
        self.result = Result()
        planner.reset(self.run_state)
        controller.reset(self.run_state)

    def look(self) -> ConeObservation:
        eyes, random = self.eyes, self.random
        dx, dy = self.track.xy_m[:, 0] - self.x, self.track.xy_m[:, 1] - self.y
        cos, sin = math.cos(self.yaw), math.sin(self.yaw)
        xy = np.column_stack((cos * dx + sin * dy, cos * dy - sin * dx))
        ahead = xy - np.array([1.0, 0.0])
        seen = (np.hypot(ahead[:, 0], ahead[:, 1]) < eyes.range_m) & (
            np.abs(np.arctan2(ahead[:, 1], ahead[:, 0])) < eyes.half_angle_rad
        )
        seen &= random.random(len(seen)) >= eyes.miss
        xy, color = xy[seen], self.track.color[seen]
        xy = xy + random.normal(0.0, eyes.noise_m, xy.shape)
        n_false = int(random.poisson(eyes.false_per_look))
        if n_false:
            reach = random.uniform(2.0, eyes.range_m, n_false)
            angle = random.uniform(-eyes.half_angle_rad, eyes.half_angle_rad, n_false)
            xy = np.concatenate((xy, np.column_stack((1.0 + reach * np.cos(angle), reach * np.sin(angle)))))
            color = np.concatenate((color, random.integers(1, 3, n_false)))
        if not eyes.colors:
            color = np.zeros(len(xy), dtype=np.int64)
        return ConeObservation(self.t_ns, xy, color.astype(np.int64), np.full(len(xy), 0.9))

    def drive(self, seconds: float, may_move_after_s: float = 1.0) -> Result:
        """Run on until the car stands at the end of its mission, or for so long."""
        result = self.result
        end_ns = self.t_ns + round(seconds * 1e9)
        while self.t_ns < end_ns:
            self.t_ns += STEP_NS
            if self.t_ns >= may_move_after_s * 1e9 and not self.run_state.may_move:
                self.run_state = replace(self.run_state, as_state=AsState.AS_DRIVING, may_move=True)
                self.planner.on_run(self.run_state)
            if self.t_ns % self.eyes.period_ns < STEP_NS:
                self.in_sight.append((self.t_ns + self.eyes.latency_ns, self.look(), self.motion))
            while self.in_sight and self.in_sight[0][0] <= self.t_ns:
                _, observation, _ = self.in_sight.popleft()
                self.plan = self.planner.on_cones(observation, self.motion)
                if self.plan is not None:
                    result.plans.append(self.plan)
            rpm = self.car.wheel_rpm_of_speed(self.speed)
            command = self.controller.command(
                self.plan,
                self.motion,
                self.speed < 0.2,
                (rpm,) * 4,
                math.degrees(self.steer),
                self.run_state,
                self.t_ns,
            )
            result.commands.append(command)
            self._move(command)
            self._touch()
            result.path_m.append((self.x, self.y))
            result.speeds_mps.append(self.speed)
            result.motions.append(self.motion)
            result.laps = max(result.laps, command.laps)
            result.finished |= command.mission_finished
            result.estop |= command.estop_request
            result.time_s = self.t_ns / 1e9
            if (result.finished or result.estop) and self.speed == 0.0:
                result.stands = True
                break
        return result

    def _move(self, command: VehicleCommand) -> None:
        car, dt = self.car, STEP_NS / 1e9
        self.steer_queue.append(command.steering_rad)
        self.brake_queue.append(command.brake)
        wanted, brake = self.steer_queue.popleft(), self.brake_queue.popleft()
        if command.mission_finished or command.estop_request:
            brake = max(brake, 0.4)  # as the bridge does
        most = car.steer_rate_radps * dt
        self.steer += min(max(wanted - self.steer, -most), most)
        motor_rpm = car.wheel_rpm_of_speed(self.speed) * car.gear_ratio
        available_nm = float(np.interp(motor_rpm, *zip(*car.torque_curve_rpm_nm, strict=True)))
        torque = min(command.throttle * car.axle_torque_max_nm, available_nm)
        force = torque * car.driven_axles / car.rolling_radius_m
        drag = car.rolling_resistance * car.mass_kg * GRAVITY_MPS2 + 0.6 * car.drag_area_m2 * self.speed**2
        slowing = 0.0 if brake <= 0.0 else max(brake * car.brake_excess, car.brake_minimum) * car.brake_full_mps2
        speed = self.speed + dt * ((force - drag) / (car.mass_kg + car.rotating_mass_kg) - slowing)
        if speed <= 0.0 or (force == 0.0 and speed < 0.05):
            speed = 0.0
        self.speed = speed
        self.yaw_rate = speed * math.tan(self.steer) / car.wheelbase_m
        middle = self.yaw + 0.5 * self.yaw_rate * dt
        self.x, self.y = self.x + speed * dt * math.cos(middle), self.y + speed * dt * math.sin(middle)
        self.yaw += self.yaw_rate * dt
        # Odometry, a little wrong.
        felt_speed = speed * self.speed_error
        felt_yaw_rate = self.yaw_rate + (self.yaw_rate_error if speed > 0.0 else 0.0)
        motion = self.motion
        middle = motion.yaw_rad + 0.5 * felt_yaw_rate * dt
        self.motion = Motion(
            self.t_ns,
            motion.x_m + felt_speed * dt * math.cos(middle),
            motion.y_m + felt_speed * dt * math.sin(middle),
            math.remainder(motion.yaw_rad + felt_yaw_rate * dt, 2.0 * math.pi),
            felt_speed,
            felt_yaw_rate,
            motion.distance_m + felt_speed * dt,
        )

    def _touch(self) -> None:
        car = self.car
        dx, dy = self.track.xy_m[:, 0] - self.x, self.track.xy_m[:, 1] - self.y
        cos, sin = math.cos(self.yaw), math.sin(self.yaw)
        u, v = cos * dx + sin * dy, cos * dy - sin * dx
        rear = car.nose_ahead_of_rear_axle_m - car.length_m
        out_u = np.maximum(np.maximum(rear - u, u - car.nose_ahead_of_rear_axle_m), 0.0)
        out_v = np.maximum(np.abs(v) - 0.5 * car.width_m, 0.0)
        radius = tracks.CONE_RADIUS_M[self.track.color]
        for index in np.flatnonzero(np.hypot(out_u, out_v) < radius):
            if int(index) not in self.result.hits:
                self.result.hits.add(int(index))
                self.result.hit_at.append((self.t_ns / 1e9, self.x, self.y))


def staged(track: tracks.Track, mission: Ami, back_m: float = 0.0) -> Track:
    """One of the simulator's tracks, the car staged for the mission on it or `back_m` behind that place."""
    pose = track.staging(mission, ADS_DV_2026.nose_ahead_of_rear_axle_m)
    start = (pose.x_m - back_m, pose.y_m, pose.yaw_rad)
    return Track(track.cones_xy_m, track.cone_colors, start, track.centreline_m)
