"""The bench of laps drives autocross and trackdrive in lockstep, and holds laps against the least time possible.

The bound is what a car with the simulated one's forces takes in quasi-steady state, on the quickest line it can find:
grip, motors, brakes and the drag of sliding tyres; no margins, no delays, and borders that only the sides of the car's
middle keep to. Lap one begins at rest before the line, best laps at speed. The car has its yaw-rate sensor.
"""

from __future__ import annotations

import argparse
import math
from functools import cache
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import minimize

from fsai_hil.bench.rows import table
from fsai_hil.simulator import car as model
from fsai_hil.simulator.judge import check_track
from fsai_hil.simulator.lockstep import Lockstep
from fsai_hil.simulator.tracks import Track, TrackError, load_track
from fsai_hil.simulator.tracks.layout import STAGED_BEFORE_LINE_M
from fsai_hil.simulator.world import WorldSetup, mission_named
from fsai_vcu.core.arrays import Floats
from fsai_vcu.core.planning.pose import gaps, resampled_ring
from fsai_vcu.core.planning.race_line import LineSearch
from fsai_vcu.core.vehicle.forces import axle_torque_nm
from fsai_vcu.core.vehicle.parameters import CARS, GRAVITY_MPS2, VehicleParameters
from fsai_vcu.interface.enums import Ami

STEP_M, COARSE, KNOTS_M = 0.5, 2, 4.0  # of the line, of it while searched (steps), and of the places where it is moved
NUDGE_M, ITERATIONS = 1e-3, 60
GRIP_MPS2 = model.FRICTION * GRAVITY_MPS2
TRACKS = ("autocross", "trackdrive", *(f"generated-{seed}" for seed in range(1, 7)))
HEADS = ("drive", "lap one s", "bound s", "ratio", "best s", "bound s", "ratio", "cones hit", "off course")


class Forces:
    """Accelerations that the simulated car has at its limits; all methods take and return arrays."""

    def __init__(self, facts: VehicleParameters) -> None:
        """Tabulate the motors by speed."""
        car, self._facts = model.Car(facts), facts
        self._speeds = np.linspace(0.0, facts.speed_max_mps, 400)
        ratio = facts.gear_ratio * facts.wheel_rpm_of_speed(1.0)
        axle_nm = [min(car.available_torque_nm(ratio * v), axle_torque_nm(facts, v)) for v in self._speeds]
        newton = np.array(axle_nm) * facts.driven_axles * model.DRIVELINE_EFFICIENCY / facts.rolling_radius_m
        held = model.ROLLING_RESISTANCE * facts.mass_kg * GRAVITY_MPS2 + 0.6 * model.DRAG_AREA_M2 * self._speeds**2
        mass_kg = facts.mass_kg + model.ROTATING_MASS_KG
        self._driven, self._held = newton / mass_kg, held / mass_kg

    def gained(self, speed: Floats, lateral: Floats) -> Floats:
        """Return the acceleration at full throttle, or what the driven tyres leave of it, m/s2; below 0: they slide."""
        facts = self._facts
        front, rear = (on / facts.driven_axles for on in (facts.driven_front, facts.driven_rear))
        left = self._left((front, rear), lateral, 1.0)
        return np.minimum(np.interp(speed, self._speeds, self._driven), left) - self._lost(speed, lateral)

    def braked(self, speed: Floats, lateral: Floats) -> Floats:
        """Return the deceleration with both axles at their grip, or the brakes at full pressure, m/s2."""
        share = model.BRAKE_FRONT_SHARE
        left = self._left((share, 1.0 - share), lateral, -1.0)
        return np.minimum(self._facts.brake_full_mps2, left) + self._lost(speed, lateral)

    def _lost(self, speed: Floats, lateral: Floats) -> Floats:
        """Return the deceleration by air, rolling and the slip angle at which tyres hold the car in its bend, m/s2."""
        used = np.minimum(lateral / GRIP_MPS2, 1.0)
        sliding = lateral * np.tan(np.arcsin(used) / model.TYRE_C) / model.TYRE_B
        return np.interp(speed, self._speeds, self._held) + sliding

    def _left(self, shares: tuple[float, float], lateral: Floats, forward: float) -> Floats:
        """Return the longitudinal acceleration at which the first axle with a share is at its grip, by its load."""
        facts, least = self._facts, np.full(np.shape(lateral), math.inf)
        ahead = facts.cog_ahead_of_rear_axle_m / facts.wheelbase_m
        for share, weight, way in ((shares[0], ahead, -forward), (shares[1], 1.0 - ahead, forward)):
            if share:
                shift = way * model.FRICTION * facts.cog_height_m / facts.wheelbase_m
                square, half = share**2 - shift**2, weight * GRIP_MPS2 * shift
                room = weight**2 * np.maximum(GRIP_MPS2**2 - lateral**2, 0.0)
                least = np.minimum(least, (half + np.sqrt(half**2 + square * room)) / square)
        return least

    def lap_s(self, lines: Floats, standing_m: float | None = None) -> Floats:
        """(K,) least time along each of (K, N, 2) closed lines; standing_m: from rest so far before its start."""
        ring = lines[..., 0].T + 1j * lines[..., 1].T
        chord = np.roll(ring, -1, axis=0) - ring
        step, turn = np.abs(chord), np.abs(np.angle(chord * np.roll(chord, 1, axis=0).conj()))
        bend = 2.0 * turn / (step + np.roll(step, 1, axis=0))
        square = np.minimum(GRIP_MPS2 / np.maximum(bend, 1e-9), self._facts.speed_max_mps**2)
        count, last = len(square), 2 * len(square) - 1
        if standing_m is not None:
            square[0], last = 2.0 * standing_m * self.gained(np.zeros(1), np.zeros(1)), len(square) - 1
        for at, there in ((at % count, (at + 1) % count) for at in range(last)):
            gained = self.gained(np.sqrt(square[at]), square[at] * bend[at])
            square[there] = np.minimum(square[there], np.maximum(square[at] + 2.0 * step[at] * gained, 0.01))
        for at, there in ((at % count, (at - 1) % count) for at in range(last, 0, -1)):
            braked = self.braked(np.sqrt(square[at]), square[at] * bend[at])
            square[there] = np.minimum(square[there], square[at] + 2.0 * step[there] * braked)
        speed = np.sqrt(square)
        after = np.roll(speed, -1, axis=0)
        after[-1] = speed[-1] if standing_m is not None else after[-1]
        times: Floats = (2.0 * step / (speed + after)).sum(axis=0)
        return times


def quickest_line(track: Track, facts: VehicleParameters, iterations: int = ITERATIONS) -> Floats:
    """(N, 2) closed line of least time between the borders, from the line of least curvature on."""
    assert track.centreline_m is not None and track.left_border_m is not None and track.right_border_m is not None
    search, forces = LineSearch(track.centreline_m, track.cones_xy_m, facts, STEP_M), Forces(facts)
    while (race := search.advance()) is None:
        pass
    base, normal = race.xy_m, np.stack((-race.sin, race.cos), axis=-1)
    every = round(KNOTS_M / STEP_M)
    knots = np.append(np.arange(0, len(base) - every // 2, every), len(base))
    each = np.eye(len(knots) - 1)
    shape = CubicSpline(knots, np.vstack((each, each[:1])), bc_type="periodic")(np.arange(len(base)))
    left, right = (
        np.maximum(gaps(base[knots[:-1]], resampled_ring(border, 0.1)).min(axis=1) - 0.5 * facts.width_m, 0.0)
        for border in (track.left_border_m, track.right_border_m)
    )

    def moved(aside: Floats) -> Floats:
        return base + (aside @ shape.T)[..., None] * normal

    def time_and_slope(aside: Floats) -> tuple[float, Floats]:
        times = forces.lap_s(moved(aside + np.vstack((0.0 * aside, NUDGE_M * each))))
        return float(times[0]), (times[1:] - times[0]) / NUDGE_M

    bounds, options = np.stack((-right, left), axis=-1), {"maxiter": iterations}
    found = minimize(time_and_slope, 0.0 * left, jac=True, bounds=bounds, method="L-BFGS-B", options=options)
    line = moved(found.x)
    assert track.start_line is not None
    at = int(np.hypot(*(line - (track.start_line.x_m, track.start_line.y_m)).T).argmin())
    return np.roll(line, -at, axis=0)


@cache
def bounds_s(track: str, revision: str, mission: Ami) -> tuple[float, float]:
    """Least time of a lap from rest before the line, and of one at speed."""
    facts = CARS[revision]
    line, forces = quickest_line(load_track(track), facts)[None], Forces(facts)
    return float(forces.lap_s(line, STAGED_BEFORE_LINE_M[mission])[0]), float(forces.lap_s(line)[0])


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("tracks", nargs="*", default=TRACKS, help=f"default: {', '.join(TRACKS)}")
    parser.add_argument("--mission", choices=("autocross", "trackdrive"), default="trackdrive")
    parser.add_argument("--laps", type=int, default=4, metavar="N", help="of trackdrive (default: 4)")
    parser.add_argument("--seeds", type=int, default=1, metavar="N", help="drives of each track (default: 1)")
    parser.add_argument("-o", dest="out", type=Path, metavar="FILE.md", help="write the table as a page, too")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> str:
    """Drive, print laps beside their bounds, and write them as a page if asked; say which drives did not pass."""
    mission, lines, failed = mission_named(args.mission), [], []
    for name in args.tracks:
        track = load_track(name)
        if problem := check_track(track, mission):
            raise TrackError(problem)
        standing_s, flying_s = bounds_s(name, "2026", mission)
        for seed in range(args.seeds):
            setup = WorldSetup(missions=[mission], track=track, seed=seed, laps=args.laps)
            result = Lockstep(setup).run()
            verdict, drive = result.verdict, f"{args.mission} {name} {seed}"
            first_s, *others_s = verdict.lap_times_s or (math.nan,)
            best_s = min(others_s, default=math.nan)
            figures = (first_s, standing_s, first_s / standing_s, best_s, flying_s, best_s / flying_s)
            shown = ("-" if math.isnan(each) else f"{each:.3f}" for each in figures)
            lines.append((drive, *shown, f"{verdict.cones_hit}", f"{verdict.off_course}"))
            failed += [drive] * (not result.passed)
            print(f"{drive}: {', '.join(f'{lap_s:.2f}' for lap_s in verdict.lap_times_s)} s", flush=True)
    figures = table(HEADS, lines)
    print(figures)
    problem = f"not passed: {', '.join(failed)}" if failed else ""
    if args.out:
        how = (__doc__ or "").split("\n\n")[1].strip().replace("\n", " ")
        laps = f", {args.laps} lap{'s' * (args.laps > 1)}" * (mission is Ami.TRACKDRIVE)
        parts = ("# Laps", "Made by `make missions`; do not edit.", how, f"The drives: {args.mission}{laps}.", figures)
        args.out.write_text("\n\n".join((*parts, *[f"**{problem}**"] * bool(problem))) + "\n", encoding="utf-8")
    return problem
