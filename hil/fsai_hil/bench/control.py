"""The bench of control measures how well the car follows paths and speeds, beside plain pure pursuit.

Both drive the same paths through the same gate, bus and simulated car. The paths are given exactly, and with the few
centimetres by which a lane finder's move and bend from plan to plan. Deviations are those of the true rear axle from
the true path, speeds those of the true car; a call's time is processor time.
"""

from __future__ import annotations

import argparse
import math
import time
from itertools import product
from typing import Any

import numpy as np

from fsai_hil.bench.rows import table
from fsai_hil.simulator.lockstep import Lockstep
from fsai_hil.simulator.tracks.generator import Arc, line_of
from fsai_hil.simulator.world import WorldSetup
from fsai_vcu.core.arrays import Floats
from fsai_vcu.core.command import VehicleCommand
from fsai_vcu.core.control.controller import Controller
from fsai_vcu.core.control.path_tracking import STEP_M
from fsai_vcu.core.control.settings import ControllerSettings
from fsai_vcu.core.driving import ConeObservation, Motion, Plan, Run
from fsai_vcu.core.planning.pose import lengths_along, resampled, to_odometry, to_vehicle
from fsai_vcu.core.vehicle.parameters import CARS
from fsai_vcu.interface.enums import Ami
from fsai_vcu.interface.units import MS, S

AHEAD_M = 20.0
LATERAL_MPS2 = 4.5  # of the bends at the speed driven
RUN_UP_M = {5.0: 12.0, 10.0: 45.0}  # straight, by the speed to reach on it
NOISE_M = 0.02
PLACES_M = 0.05  # between the points by which the car's place is told
LONGEST_NS = 90 * S
HEADS = ("path", "RMS m", "max m", "under", "over", "p50 ms", "p99 ms")
COURSE = ((40.0, 0.0), (16.0, 0.19), (25.0, 0.0), (12.0, -0.12), (30.0, 0.0), (8.0, 0.15), (8.0, -0.15), (30.0, 0.0))
"""Straights and bends of a lap, m and 1/m, whose speed is the controller's own."""


def arcs(*pieces: Arc) -> Floats:
    """(N, 2) points every 0.5 m of pieces, each a length (m) and a curvature (1/m), from the origin along x."""
    return resampled(line_of(pieces, 0.01), 0.5)


def paths(speed_mps: float) -> dict[str, Floats]:
    """Return what is driven at a speed, by name: a run-up, then bends."""
    radius = speed_mps**2 / LATERAL_MPS2
    run_up, on = (RUN_UP_M[speed_mps], 0.0), (12.0, 0.0)
    length = 2.4 * speed_mps
    along = np.arange(0.0, 6.0 * length, 0.1)
    wave = 0.5 * (length / math.tau) ** 2 / radius * (1.0 - np.cos(along * math.tau / length))
    slalom = np.stack((RUN_UP_M[speed_mps] + along, wave), axis=-1)
    circle, chicane = math.tau * 1.6 * radius, 0.5 * radius
    swerve = ((chicane, 0.6 / radius), (2.0 * chicane, -0.6 / radius), (chicane, 0.6 / radius), on)
    return {
        "slalom": resampled(np.concatenate((arcs(run_up), slalom)), 0.5),
        "hairpin": arcs(run_up, (math.pi * radius, 1.0 / radius), on),
        "eight": arcs(run_up, (circle, -0.625 / radius), (circle, 0.625 / radius), on),
        "chicanes": arcs(run_up, *swerve, *swerve),
    }


class Watched(Controller):
    """The product's controller, with how long its calls take and how much faster the car is than its speed profile."""

    def __init__(self, *args: Any) -> None:
        super().__init__(*args)
        self.calls_ms: list[float] = []
        self.over_mps: list[float] = []

    def command(
        self, plan: Plan | None, motion: Motion, standing: bool, rpm: Any, steer_deg: float, run: Run, now_ns: int
    ) -> VehicleCommand:
        """Command as the product does; keep the call's time and the speed above the profile."""
        began_s = time.thread_time()
        command = super().command(plan, motion, standing, rpm, steer_deg, run, now_ns)
        if run.may_move and plan is not None and self._profile is not None:
            self.calls_ms.append(1e3 * (time.thread_time() - began_s))
            along_m = STEP_M * np.arange(len(self._profile))
            here_m = motion.speed_mps * (now_ns - plan.t_sensor_ns) / S
            self.over_mps.append(motion.speed_mps - math.sqrt(float(np.interp(here_m, along_m, self._profile))))
        return command


class Pursuit(Watched):
    """Plain pure pursuit, towards a point of the path that is further ahead the faster the car goes.

    The speed is controlled as in the product.
    """

    def _drive(self, plan: Plan | None, motion: Motion, run: Run, now_ns: int) -> tuple[float, float]:
        found = super()._drive(plan, motion, run, now_ns)
        there = self._history.at(plan.t_sensor_ns) if plan is not None else None
        if plan is not None and there is not None and len(plan.path_m):
            here = to_vehicle(motion, to_odometry(there, plan.path_m))
            along, nearest = lengths_along(here), int((here**2).sum(axis=1)[:24].argmin())
            reach = along[nearest] + 1.0 + 0.25 * motion.speed_mps
            x, y = np.interp(reach, along, here[:, 0]), np.interp(reach, along, here[:, 1])
            self._steering_rad = self._within(math.atan(2.0 * self._car.wheelbase_m * y / (x * x + y * y)))
        return found


class GivenPath:
    """A stand-in for the planner: it gives a path of the world, as the car sees it."""

    def __init__(self, lockstep: Lockstep, path_m: Floats, noise_m: float) -> None:
        self._world, self._path_m, self._noise_m = lockstep.world, path_m, noise_m
        self._chance = np.random.default_rng(1)
        self._plans: dict[int, Floats] = {}
        self._at = 0
        self.on_run(Run(0))

    def on_run(self, run: Run) -> None:
        self._run = run

    reset = on_run

    def look(self, observation: ConeObservation) -> ConeObservation:
        """See the path from where the car is now; the observation comes to `on_cones` later."""
        pose = self._world.car.pose
        away = self._path_m[self._at : self._at + 24] - (pose.x_m, pose.y_m)
        self._at += int((away**2).sum(axis=1).argmin())
        ahead = self._path_m[self._at : self._at + round(AHEAD_M / 0.5)]
        self._plans[observation.t_ns] = np.stack(pose.seen(*ahead.T), axis=-1)
        return observation

    def on_cones(self, observation: ConeObservation, motion: Motion) -> Plan:
        path = self._plans.pop(observation.t_ns)
        s, (a, b, c) = np.arange(len(path)) * 0.5 / AHEAD_M, self._chance.normal(0.0, self._noise_m, 3)
        path[:, 1] += a + 2.0 * b * s + c * np.sin(8.0 * s)
        return Plan(observation.t_ns, self._run.run_id, self._run.mission, path)


def drive(
    kind: type[Watched], path_m: Floats, settings: ControllerSettings, noise_m: float, from_m: float
) -> tuple[float, ...]:
    """Drive along a path, and return the figures of `HEADS` from so far on."""
    lockstep = Lockstep(WorldSetup(missions=[Ami.TRACKDRIVE]), controller=settings)
    car, computer = lockstep.world.car, lockstep.computer
    path_m = to_odometry(Motion(x_m=car.pose.x_m, y_m=car.pose.y_m, yaw_rad=car.pose.yaw_rad), path_m)
    given = GivenPath(lockstep, path_m, noise_m)
    computer.controller = watched = kind(CARS["2026"], settings)
    computer.planner = given  # type: ignore[assignment]
    lockstep.detector = given.look
    places = resampled(path_m, PLACES_M)
    looks, at = [], 0
    while at < len(places) - round(6.0 / PLACES_M):
        lockstep.step()
        assert lockstep.now_ns < LONGEST_NS, "the car does not come to the path's end"
        if lockstep.now_ns % (10 * MS) or car.speed_mps <= 0.0:
            continue
        away = places[at : at + 60] - (car.pose.x_m, car.pose.y_m)
        nearest = int((away**2).sum(axis=1).argmin())
        at += nearest
        (x, y), (dx, dy) = away[nearest], places[at + 1] - places[at]
        looks.append((at * PLACES_M, (y * dx - x * dy) / PLACES_M, car.speed_mps))
    _, aside, speed = np.array([look for look in looks if look[0] > from_m]).T
    under_mps, over_mps = float(settings.lap_max_speed_mps - speed.min()), max(watched.over_mps)
    rms_m, max_m = float(np.sqrt((aside**2).mean())), float(np.abs(aside).max())
    return rms_m, max_m, under_mps, over_mps, *np.quantile(watched.calls_ms, (0.5, 0.99))


def held(speed_mps: float, **more: float) -> ControllerSettings:
    """Return settings with which no more than that is driven, however well the path is borne out."""
    return ControllerSettings(lap_max_speed_mps=speed_mps, careful_mps=speed_mps, **more)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--path", action="append", help="only this path (slalom, hairpin, eight, chicanes, course)")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> str:
    """Drive every path with both controllers, exact and moving; print what was counted."""
    given = [
        (f"{name} {v:g} m/s", path, held(v, lateral_mps2=6.0, end_of_path_mps=v), begin)
        for v, begin in RUN_UP_M.items()
        for name, path in paths(v).items()
    ]
    given.append(("course", arcs(*COURSE), held(7.0), 10.0))
    lines = []
    for (name, path_m, settings, from_m), kind, noise_m in product(given, (Watched, Pursuit), (0.0, NOISE_M)):
        if args.path and name.split()[0] not in args.path:
            continue
        label = f"{name}, {'pure pursuit' if kind is Pursuit else 'ours'}{' ~' * bool(noise_m)}"
        print(label, flush=True)
        lines.append((label, *(f"{round(value, 3):g}" for value in drive(kind, path_m, settings, noise_m, from_m))))
    print(table(HEADS, lines))
    print(f"~: paths that move by {NOISE_M} m; under: below the speed limit, over: above the profile, m/s")
    return ""
