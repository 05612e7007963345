"""A car without dynamics on a circuit: it follows the planner's path exactly, and its odometry drifts."""

from __future__ import annotations

import math

import numpy as np

from fsai_hil.simulator.car import Pose
from fsai_hil.simulator.sensing import ConeSensor, SensorSettings
from fsai_hil.simulator.tracks import Track
from fsai_vcu.core.arrays import Floats
from fsai_vcu.core.driving import ConeObservation, Motion, Plan, Run
from fsai_vcu.core.missions.settings import MissionSettings
from fsai_vcu.core.planning.planner import Planner
from fsai_vcu.core.vehicle.parameters import ADS_DV_2026
from fsai_vcu.interface.enums import Ami

CAR = ADS_DV_2026
STEP_M, STEP_NS = 0.5, 100_000_000
DRIFT_RADPM, SCALE = 0.0008, 1.01  # of odometry: some metres in a lap


class Ride:
    """`step` takes a look, plans, and moves on by `STEP_M`."""

    def __init__(self, track: Track, laps: int = 3, sensor: SensorSettings | None = None) -> None:
        self.track = track
        self.pose = track.staging(Ami.TRACKDRIVE, CAR.nose_ahead_of_rear_axle_m)
        self.motion = Motion()
        self.sensor = ConeSensor(track, sensor)
        self.planner = Planner(CAR, missions=MissionSettings(trackdrive_laps=laps))
        self.planner.reset(Run(1, Ami.TRACKDRIVE))
        for _ in range(3):  # a cone is believed after some looks
            self.planner.on_cones(self.see(), self.motion)

    def see(self) -> ConeObservation:
        return self.sensor.see(self.pose, self.motion.t_ns)

    def step(self) -> Plan:
        plan = self.planner.on_cones(self.see(), self.motion)
        assert plan is not None and len(plan.path_m) >= 3
        self.follow(plan.path_m)
        return plan

    def until_mapped(self) -> Plan:
        """Drive on until a path follows the map, in lap two at the latest."""
        while not (plan := self.step()).mapped:
            assert plan.laps < 2
        return plan

    def follow(self, path_m: Floats) -> None:
        """Move on along a path (vehicle frame)."""
        first = int(np.hypot(path_m[:, 0] - STEP_M, path_m[:, 1]).argmin())
        here, there = path_m[max(0, first - 1)], path_m[min(first + 1, len(path_m) - 1)]
        self.move(*path_m[first], math.atan2(*(there - here)[::-1]))

    def move(self, ahead_m: float, left_m: float, turn_rad: float) -> None:
        self.pose = Pose(*self.pose.ahead(ahead_m, left_m), self.pose.yaw_rad + turn_rad)
        was = self.motion
        way = SCALE * math.hypot(ahead_m, left_m)
        yaw = was.yaw_rad + turn_rad + DRIFT_RADPM * way
        toward = was.yaw_rad + math.atan2(left_m, ahead_m)
        self.motion = Motion(
            was.t_ns + STEP_NS,
            was.x_m + way * math.cos(toward),
            was.y_m + way * math.sin(toward),
            yaw,
            way / (STEP_NS / 1e9),
            (yaw - was.yaw_rad) / (STEP_NS / 1e9),
            was.distance_m + way,
        )


def clearance_m(pose: Pose, cones_xy_m: Floats) -> float:
    """From the car's body to the nearest cone's edge."""
    ahead, left = pose.seen(*cones_xy_m.T)
    rear, nose = CAR.nose_ahead_of_rear_axle_m - CAR.length_m, CAR.nose_ahead_of_rear_axle_m
    along = np.maximum(np.maximum(rear - ahead, ahead - nose), 0.0)
    across = np.maximum(np.abs(left) - 0.5 * CAR.width_m, 0.0)
    return float(np.hypot(along, across).min()) - 0.114
