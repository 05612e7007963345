"""The bench of planning measures how well and how fast the lane is found, under conditions that detectors meet.

The car is carried once round a closed track at 5 m/s and looks every half metre; every second look is judged. The
planner remembers cones between looks, as on the car. A look fails if there is no path or one shorter than 5 m, or if
the path's first 10 m bring the 1.43 m wide car onto the line of cones. The error is the distance of those 10 m from the
middle, for a car without a nose (for the car's own sweep the planner moves the path inward in bends). A car beside the
middle begins its path there, so its first 3 m do not count. A planner that is lost is counted, and begins again there
like one of a car that has stopped; that look is judged by what it finds then.

A track is built in, generated, or a file, with its middle in NAME_midline.csv beside it, if there is one.
Times are processor time of the planner's call.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from itertools import groupby
from pathlib import Path
from typing import NamedTuple

import numpy as np
from msgspec.structs import replace

from fsai_hil.bench.rows import table
from fsai_hil.simulator.tracks import Track, TrackError, load_track
from fsai_vcu.core.arrays import Floats, Ints
from fsai_vcu.core.driving import ConeColor, ConeObservation, Motion, Run
from fsai_vcu.core.planning.planner import Planner
from fsai_vcu.core.planning.pose import NO_PATH, gaps, headings_along, lengths_along, resampled, to_odometry, to_vehicle
from fsai_vcu.core.vehicle.odometry import slipped
from fsai_vcu.core.vehicle.parameters import CARS
from fsai_vcu.interface.enums import Ami, AsState
from fsai_vcu.interface.units import S

RANGE_M, HALF_VIEW_RAD, BLIND_M = 15.0, math.radians(60.0), 0.6
STEP_M, SPEED_MPS = 0.5, 5.0
JUDGED_M, SHORT_M, HALF_WIDTH_M = 10.0, 5.0, 1.43 / 2.0
RUN = Run(1, Ami.TRACKDRIVE, AsState.AS_DRIVING, may_move=True)
SEEN_ALONE = 2  # times that a look without others is taken in: a cone seen once is none yet
SEEN_BEFORE = 4  # looks from the start before the first is judged
# The last two have lanes beside each other, and hairpins between them.
TRACKS = ("small_oval", "autocross", "trackdrive", "random-2", "generated-1-tight", "generated-1-islands")
HEADS = ("condition", "looks", "mean m", "max m", "failed %", "lost", "p50 ms", "p99 ms")

Placed = tuple[Floats, Ints]
"""(N, 2) places, and colours."""


def _as_it_is(xy: Floats, color: Ints, _: object) -> Placed:
    return xy, color


class Disturbance(NamedTuple):
    """A difference from a perfect look from the middle: the cones that stand there, a look at them, the car's place."""

    name: str
    seen: Callable[[Floats, Ints, np.random.Generator], Placed] = _as_it_is
    laid: Callable[[Floats, Ints, Floats], Placed] = _as_it_is  # the third: the middle, (N, 2)
    off_m: float = 0.0
    off_rad: float = 0.0
    alone: bool = False  # each look by itself: nothing is remembered of the others


def _swapped(xy: Floats, color: Ints, draw: np.random.Generator) -> Placed:
    wrong = (draw.random(len(xy)) < 0.05) & ((color == ConeColor.BLUE) | (color == ConeColor.YELLOW))
    return xy, np.where(wrong, ConeColor.BLUE + ConeColor.YELLOW - color, color)


def _cluttered(xy: Floats, color: Ints, line: Floats) -> Placed:
    """Add cones that belong to nothing, every 10 m or so, 4 to 6 m from the middle."""
    draw = np.random.default_rng(1)
    cos, sin = headings_along(line)
    at = np.arange(0, len(line), 20)
    aside = draw.uniform(4.0, 6.0, len(at)) * draw.choice((-1.0, 1.0), len(at))
    places = np.stack((line[at, 0] - aside * sin[at], line[at, 1] + aside * cos[at]), axis=-1)
    places = places[_distances(places, line) > 3.5]
    return np.concatenate((xy, places)), np.concatenate((color, draw.integers(0, 3, len(places))))


def _missing(xy: Floats, color: Ints, draw: np.random.Generator) -> Placed:
    kept = draw.random(len(xy)) >= 0.1
    return xy[kept], color[kept]


def _colourless(xy: Floats, color: Ints, _: object) -> Placed:
    return xy, np.full_like(color, ConeColor.UNKNOWN)


def _ghosts(xy: Floats, color: Ints, draw: np.random.Generator) -> Placed:
    """Add to one look in two a cone that is not there, anywhere in view."""
    count = int(draw.random() < 0.5)
    far, angle = RANGE_M * np.sqrt(draw.random(count)), HALF_VIEW_RAD * (2.0 * draw.random(count) - 1.0)
    places = np.stack((far * np.cos(angle), far * np.sin(angle)), axis=-1)
    return np.concatenate((xy, places)), np.concatenate((color, draw.integers(1, 3, count)))


CONDITIONS = (
    Disturbance("ideal"),
    Disturbance("0.5 m and 5 deg off", off_m=0.5, off_rad=math.radians(5.0)),
    Disturbance("10 % missing", _missing),
    Disturbance("no colours", _colourless),
    Disturbance("no colours, look alone", _colourless, alone=True),
    Disturbance("noise 0.1 m", lambda xy, color, draw: (xy + 0.1 * draw.standard_normal(xy.shape), color)),
    Disturbance("clutter", laid=_cluttered),
    Disturbance("ghosts", _ghosts),
    Disturbance("5 % swapped, by look", _swapped),
    # The same cones in every look: the detector has a reason.
    Disturbance("5 % swapped, by cone", laid=lambda xy, color, line: _swapped(xy, color, np.random.default_rng(5))),
)


class LaneFigures(NamedTuple):
    """The result of one track under one condition."""

    track: str
    condition: str
    looks: int
    failed_at_m: tuple[float, ...]  # along the middle
    error_m: float  # mean of all looks
    error_max_m: float
    lost: int  # times
    took_ms: tuple[float, ...]  # processor time of each call of the planner


def middle_of(track: Track, name: str) -> Floats:
    """(N, 2) The middle every half metre in driving order: from NAME_midline.csv beside NAME.csv, or as laid out."""
    beside = Path(name).with_name(f"{Path(name).stem}_midline.csv")
    if beside.is_file():
        columns = np.genfromtxt(beside, delimiter=",", names=True)
        line = np.stack((columns["x"], columns["y"]), axis=-1)
    elif track.centreline_m is not None and track.closed:
        line = track.centreline_m
    else:
        raise TrackError(f"{name}: not a closed lane")
    return resampled(np.concatenate((line, line[:1])), STEP_M)


def motions(line: Floats, condition: Disturbance) -> Iterator[Motion]:
    """Yield the car at each point of a closed line, beside it by what the condition says, now left and now right."""
    cos, sin = headings_along(np.concatenate((line[-1:], line, line[:1])))
    yaws = np.unwrap(np.arctan2(sin, cos))[1:-1]
    rates = np.gradient(yaws) * SPEED_MPS / STEP_M
    for index, ((x, y), yaw, rate) in enumerate(zip(line, yaws, rates, strict=True)):
        side = 1.0 if (index // 8) % 2 else -1.0
        yield Motion(
            t_ns=round(index * STEP_M / SPEED_MPS * S),
            x_m=float(x - side * condition.off_m * math.sin(yaw)),
            y_m=float(y + side * condition.off_m * math.cos(yaw)),
            yaw_rad=float(yaw + side * condition.off_rad),
            speed_mps=SPEED_MPS,
            yaw_rate_radps=float(rate),
            distance_m=index * STEP_M,
        )


def by_odometry(places: Iterator[Motion]) -> Iterator[tuple[Motion, Motion]]:
    """Yield each place of the car, and where odometry has it: where it points to, as if its tyres did not slip."""
    last = by_wheels = Motion()
    for place in places:
        assumed = slipped(by_wheels, last, place)  # moves the car outward in a corner, which has to end at its place
        by_wheels = replace(
            place,
            x_m=by_wheels.x_m + 2.0 * (place.x_m - last.x_m) - (assumed.x_m - by_wheels.x_m),
            y_m=by_wheels.y_m + 2.0 * (place.y_m - last.y_m) - (assumed.y_m - by_wheels.y_m),
        )
        last = place
        yield place, by_wheels


def judged(track: Track, line: Floats, condition: Disturbance, name: str) -> LaneFigures:
    """Carry the planner once round, from the first point of the line."""
    draw = np.random.default_rng(7)
    cones, colors = condition.laid(track.cones_xy_m, track.cone_colors, line)
    planner = Planner(replace(CARS["2026"], nose_ahead_of_rear_axle_m=0.0))
    planner.reset(RUN)
    borders = [border for border in (track.left_border_m, track.right_border_m) if border is not None]
    # From each point of the middle to the nearer line of cones.
    away = [_distances(line, np.concatenate((border, border[:1]))) for border in borders]
    half_m = np.min([np.full(len(line), np.inf), *away], axis=0)
    errors: list[Floats] = []
    took_ms: list[float] = []
    failed_at_m: list[float] = []
    looks = lost = 0
    for index, (motion, told) in enumerate(by_odometry(motions(line, condition))):
        here = to_vehicle(motion, cones)
        ahead, aside = here.T
        seen = (np.hypot(ahead, aside) < RANGE_M) & (abs(np.arctan2(aside, ahead)) < HALF_VIEW_RAD) & (ahead > BLIND_M)
        xy, color = condition.seen(here[seen], colors[seen], draw)
        look = ConeObservation(motion.t_ns, xy, color, np.ones(len(xy)))
        if condition.alone:
            begin_again(planner, look, told)
        began_s = time.thread_time()
        plan = planner.on_cones(look, told)
        took_ms.append(round(1e3 * (time.thread_time() - began_s), 3))
        if plan is not None and plan.lost:
            lost += 1
            begin_again(planner, look, told)
            plan = planner.on_cones(look, told)
        if index < SEEN_BEFORE or index % 2:
            continue
        looks += 1
        path = plan.path_m if plan is not None else NO_PATH
        along = lengths_along(path)
        if len(path) < 2 or along[-1] < SHORT_M:
            failed_at_m.append(index * STEP_M)
            continue
        first = to_odometry(motion, path[(along <= JUDGED_M) & (along >= (3.0 if condition.off_m else 0.0))])
        near = np.arange(index - 4, index + 34) % len(line)
        error_m = _distances(first, line[near])
        errors.append(error_m)
        if (error_m + HALF_WIDTH_M > half_m[near[gaps(first, line[near]).argmin(axis=1)]]).any():
            failed_at_m.append(index * STEP_M)
    mean_m = float(np.mean([error_m.mean() for error_m in errors])) if errors else math.nan
    most_m = max((float(error_m.max()) for error_m in errors), default=math.nan)
    return LaneFigures(name, condition.name, looks, tuple(failed_at_m), mean_m, most_m, lost, tuple(took_ms))


def begin_again(planner: Planner, look: ConeObservation, told: Motion) -> None:
    """Let the planner forget all, and take this look in so often that the next one has a lane."""
    planner.reset(RUN)
    for _ in range(SEEN_ALONE - 1):
        planner.on_cones(look, told)


def _distances(points: Floats, line: Floats) -> Floats:
    """(N,) distances of points from the polyline."""
    a, b = line[None, :-1], line[None, 1:]
    along = b - a
    share = ((points[:, None] - a) * along).sum(axis=-1) / np.maximum((along * along).sum(axis=-1), 1e-12)
    away = points[:, None] - (a + np.clip(share, 0.0, 1.0)[..., None] * along)
    return np.asarray(np.hypot(away[..., 0], away[..., 1]).min(axis=1))


def bench(names: Sequence[str], conditions: Sequence[Disturbance] = CONDITIONS) -> list[LaneFigures]:
    """Return a row for each track and condition."""
    rows = []
    for name in names:
        track = load_track(name)
        line = middle_of(track, name)
        label = Path(name).stem if name.endswith(".csv") else name
        for condition in conditions:
            print(f"\r\033[K{label}: {condition.name}", end="", file=sys.stderr, flush=True)
            rows.append(judged(track, line, condition, label))
    print("\r\033[K", end="", file=sys.stderr)
    return rows


def table_of(rows: Sequence[LaneFigures]) -> str:
    """Return all tracks together, a line for each condition; then what failed where. As Markdown."""
    lines = []
    for name in dict.fromkeys(row.condition for row in rows):
        mine = [row for row in rows if row.condition == name]
        looks = sum(row.looks for row in mine)
        mean_m, most_m = sum(row.error_m * row.looks for row in mine) / looks, max(row.error_max_m for row in mine)
        failed = 100.0 * sum(len(row.failed_at_m) for row in mine) / looks
        times = np.percentile([took for row in mine for took in row.took_ms], (50, 99))
        lost = str(sum(row.lost for row in mine))
        p50_ms, p99_ms = (f"{time_ms:.2f}" for time_ms in times)
        lines.append((name, str(looks), f"{mean_m:.4f}", f"{most_m:.2f}", f"{failed:.2f}", lost, p50_ms, p99_ms))
    failures = [
        f"- {row.track}, {row.condition}: {len(row.failed_at_m)} of {row.looks} failed, "
        f"at {', '.join(f'{at:.0f}' for at in row.failed_at_m[:8])} m"
        for row in rows
        if row.failed_at_m
    ]
    return "\n".join([table(HEADS, lines), *[""] * bool(failures), *failures])


def document(rows: Sequence[LaneFigures]) -> str:
    """Return the tables as a page: generated circuits by themselves."""
    how = (__doc__ or "").split("\n\n")[1].replace("\n", " ")
    parts = ["# Planning", "Made by `make planning`; do not edit.", how]
    for title, made in (("Circuits made by the rules", True), ("Other layouts", False)):
        mine = [row for row in rows if row.track.startswith("generated-") == made]
        if mine:
            names = list(dict.fromkeys(row.track for row in mine))
            named = ", ".join(named_together(names)) if made else ", ".join(names)
            parts += [f"## {title}", f"{len(names)}: {named}.", table_of(mine)]
    return "\n\n".join(parts) + "\n"


def named_together(names: Sequence[str]) -> Iterator[str]:
    """Yield `generated-1 to generated-50` for the generated circuits of each style, which stand beside each other."""
    for _, group in groupby(names, key=lambda name: name.partition("-")[2].partition("-")[2]):
        first, *others = group
        yield f"{first} to {others[-1]}" if others else first


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("tracks", nargs="*", metavar="TRACK", default=list(TRACKS))
    parser.add_argument("-o", dest="out", type=Path, metavar="FILE.md", help="write the tables as a page, too")
    names = [condition.name for condition in CONDITIONS]
    parser.add_argument("--condition", action="append", choices=names, help="only this one")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> str:
    rows = bench(args.tracks, [one for one in CONDITIONS if not args.condition or one.name in args.condition])
    print(table_of(rows))
    if args.out:
        args.out.write_text(document(rows), encoding="utf-8")
    return ""
