"""`python -m fsai_hil.rehearsal.bench_control`: how well the car follows paths and speeds, beside plain pure pursuit.

    python -m fsai_hil.rehearsal.bench_control -o out/bench

Both drive the same paths through the same gate, bus and simulated car. The paths are given exactly, and with the few
centimetres by which a lane finder's move and bend from plan to plan. Deviations are those of the true rear axle from
the true path, speeds those of the true car; a call's time is processor time.
"""

from __future__ import annotations

import argparse
import json
import math
import time
from collections.abc import Sequence
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from fsai_hil.simulator.car import Pose
from fsai_hil.simulator.lockstep import Lockstep
from fsai_hil.simulator.world import World, WorldSetup
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
BRAKES_MPS2 = 0.3  # a profile that falls by less does not brake
LOOKED_AHEAD_S = 0.6  # the controller looks so far: the brakes' reaction and its preview
PLACES_M = 0.05  # between the points by which the car's place is told
LONGEST_NS = 90 * S


def bend_path(*pieces: tuple[float, float]) -> Floats:
    """(N, 2) points every 0.5 m of pieces, each a length (m) and a curvature (1/m), from the origin along x."""
    curvature = np.concatenate([np.full(round(length / 0.01), bend) for length, bend in pieces])
    heading = np.cumsum(curvature * 0.01)
    fine = np.cumsum(np.stack((np.cos(heading), np.sin(heading)), axis=-1) * 0.01, axis=0)
    return resampled(np.concatenate((np.zeros((1, 2)), fine)), 0.5)


def paths(speed_mps: float) -> dict[str, Floats]:
    """What is driven at a speed: a run-up, then bends."""
    radius = speed_mps**2 / LATERAL_MPS2
    run_up, on = (RUN_UP_M[speed_mps], 0.0), (12.0, 0.0)
    length = 2.4 * speed_mps
    along = np.arange(0.0, 6.0 * length, 0.1)
    wave = 0.5 * (length / math.tau) ** 2 / radius * (1.0 - np.cos(along * math.tau / length))
    slalom = np.stack((RUN_UP_M[speed_mps] + along, wave), axis=-1)
    circle, chicane = math.tau * 1.6 * radius, 0.5 * radius
    swerve = ((chicane, 0.6 / radius), (2.0 * chicane, -0.6 / radius), (chicane, 0.6 / radius), on)
    return {
        "slalom": resampled(np.concatenate((bend_path(run_up), slalom)), 0.5),
        "hairpin": bend_path(run_up, (math.pi * radius, 1.0 / radius), on),
        "eight": bend_path(run_up, (circle, -0.625 / radius), (circle, 0.625 / radius), on),
        "chicanes": bend_path(run_up, *swerve, *swerve),
    }


def course() -> Floats:
    """Straights and bends of a lap, whose speed is the controller's own."""
    return bend_path(
        (40.0, 0.0), (16.0, 0.19), (25.0, 0.0), (12.0, -0.12), (30.0, 0.0), (8.0, 0.15), (8.0, -0.15), (30.0, 0.0)
    )


class Pursuit(Controller):
    """Plain pure pursuit, for comparison: from where the car is towards a point of the path that is further ahead the
    faster it goes. The speed is controlled as ever."""

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


class Timed:
    """A controller, with how long its calls take and what it asks for beside its own speed profile."""

    def __init__(self, controller: Controller) -> None:
        self._controller = controller
        self.calls_ms: list[float] = []
        self.over_mps: list[float] = []  # the speed above the profile's
        self.brakings = self.brakings_outside = 0
        self._braked = False

    def __getattr__(self, name: str) -> Any:
        return getattr(self._controller, name)

    def command(
        self, plan: Plan | None, motion: Motion, standing: bool, rpm: Any, steer_deg: float, run: Run, now_ns: int
    ) -> VehicleCommand:
        began = time.thread_time()
        command = self._controller.command(plan, motion, standing, rpm, steer_deg, run, now_ns)
        profile = self._controller._profile
        if not run.may_move or plan is None or profile is None:
            return command
        self.calls_ms.append(1e3 * (time.thread_time() - began))
        along = STEP_M * np.arange(len(profile))
        here = motion.speed_mps * (now_ns - plan.t_sensor_ns) / S
        self.over_mps.append(motion.speed_mps - math.sqrt(float(np.interp(here, along, profile))))
        if command.brake > 0.0 and not self._braked:
            ahead = profile[(along > here - STEP_M) & (along < here + LOOKED_AHEAD_S * motion.speed_mps + STEP_M)]
            self.brakings += 1
            self.brakings_outside += not bool((np.diff(ahead) < -2.0 * BRAKES_MPS2 * STEP_M).any())
        self._braked = command.brake > 0.0
        return command


class GivenPath:
    """In the planner's place: a path of the world, as the car sees it."""

    def __init__(self, world: World, path_m: Floats, noise_m: float) -> None:
        self._world, self._path_m, self._noise_m = world, path_m, noise_m
        self._chance = np.random.default_rng(1)
        self._seen: dict[int, tuple[Pose, int]] = {}
        self._at = 0
        self._run = Run(0)

    def reset(self, run: Run) -> None:
        self._run = run

    def on_run(self, run: Run) -> None:
        self._run = run

    def look(self, observation: ConeObservation) -> ConeObservation:
        """The sensor looks now; its observation comes to `on_cones` later."""
        pose = self._world.car.pose
        away = self._path_m[self._at : self._at + 24] - (pose.x_m, pose.y_m)
        self._at += int((away**2).sum(axis=1).argmin())
        self._seen[observation.t_ns] = pose, self._at
        return observation

    def on_cones(self, observation: ConeObservation, motion: Motion) -> Plan:
        pose, at = self._seen.pop(observation.t_ns)
        path = np.stack(pose.seen(*self._path_m[at : at + round(AHEAD_M / 0.5)].T), axis=-1)
        s, (a, b, c) = np.arange(len(path)) * 0.5 / AHEAD_M, self._chance.normal(0.0, self._noise_m, 3)
        path[:, 1] += a + 2.0 * b * s + c * np.sin(8.0 * s)
        return Plan(observation.t_ns, self._run.run_id, self._run.mission, path)


def at_speed(speed_mps: float) -> ControllerSettings:
    """One speed all the way."""
    return ControllerSettings(lap_max_speed_mps=speed_mps, lateral_mps2=6.0, end_of_path_mps=speed_mps)


def drive(
    kind: type[Controller], path_m: Floats, settings: ControllerSettings, noise_m: float, from_m: float
) -> dict[str, float]:
    """What is counted along a path, from so far on."""
    lockstep = Lockstep(WorldSetup(missions=[Ami.TRACKDRIVE]), controller=settings)
    car, computer = lockstep.world.car, lockstep.computer
    start = Motion(x_m=car.pose.x_m, y_m=car.pose.y_m, yaw_rad=car.pose.yaw_rad)
    given = GivenPath(lockstep.world, to_odometry(start, path_m), noise_m)
    timed = Timed(kind(CARS["2026"], settings))
    computer.controller, computer.planner = timed, given  # type: ignore[assignment]
    lockstep.detector = given.look
    places = resampled(to_odometry(start, path_m), PLACES_M)
    looks, at = [], 0
    while at < len(places) - round(6.0 / PLACES_M):
        lockstep.step()
        assert lockstep.now_ns < LONGEST_NS, "the car does not come to the path's end"
        if lockstep.now_ns % (10 * MS) or car.speed_mps <= 0.0:
            continue
        pose = car.pose
        at += int(((places[at : at + 60] - (pose.x_m, pose.y_m)) ** 2).sum(axis=1).argmin())
        (x, y), (dx, dy) = places[at] - (pose.x_m, pose.y_m), places[at + 1] - places[at]
        looks.append((at * PLACES_M, (y * dx - x * dy) / PLACES_M, car.speed_mps))
    along, aside, speed = np.array(looks).T
    counted = along > from_m
    aside, speed = aside[counted], speed[counted]
    return {
        "rms_m": float(np.sqrt((aside**2).mean())),
        "max_m": float(np.abs(aside).max()),
        "under_limit_mps": float(settings.lap_max_speed_mps - speed.min()),
        "over_profile_mps": max(timed.over_mps),
        "brakings": timed.brakings,
        "brakings_outside_profile": timed.brakings_outside,
        "p50_ms": float(np.quantile(timed.calls_ms, 0.5)),
        "p99_ms": float(np.quantile(timed.calls_ms, 0.99)),
    }


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="bench_control", description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--output", type=Path, default=Path("out/bench"), help="folder of control.json")
    parser.add_argument("--path", action="append", help="only this path (slalom, hairpin, eight, chicanes)")
    args = parser.parse_args(argv)
    rows = []
    heads = ("RMS m", "max m", "under", "over", "brakings", "outside", "p50 ms", "p99 ms")
    print(" " * 34 + "".join(f"{head:>10}" for head in heads))
    given = [(f"{name} {v:g} m/s", path, at_speed(v), RUN_UP_M[v]) for v in RUN_UP_M for name, path in paths(v).items()]
    given.append(("course", course(), ControllerSettings(), 10.0))
    for name, path_m, settings, from_m in given:
        if args.path and name.split()[0] not in args.path:
            continue
        for kind, noise_m in product((Controller, Pursuit), (0.0, NOISE_M)):
            found = drive(kind, path_m, settings, noise_m, from_m)
            who = "ours" if kind is Controller else "pure pursuit"
            rows.append({"path": name, "noise_m": noise_m, "controller": who, **found})
            words = f"{name}, {who}" + (" ~" if noise_m else "")
            print(f"{words:<34}" + "".join(f"{round(value, 3):10g}" for value in found.values()), flush=True)
    args.output.mkdir(parents=True, exist_ok=True)
    (args.output / "control.json").write_text(json.dumps(rows, indent=1) + "\n")
    print(f"~: paths that move by {NOISE_M} m; under: below the speed limit, over: above the profile, m/s")
    print(f"saved {args.output / 'control.json'}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
