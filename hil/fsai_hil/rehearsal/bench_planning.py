"""`python -m fsai_hil.rehearsal.bench_planning`: how well the planner finds the lane, under conditions detectors meet.

The car is carried once round a closed track at 5 m/s and looks every half metre; every second look is judged. The
planner remembers cones between looks, as on the car. A look fails if there is no path or one shorter than 5 m, or if
the path's first 10 m bring the 1.43 m wide car onto the line of cones. The error is the distance of those 10 m from the
middle, for a car without a nose (for the car's own sweep the planner moves the path inward in bends). A car beside the
middle begins its path there, so its first 3 m do not count.

    python -m fsai_hil.rehearsal.bench_planning [TRACK ...] [--json FILE] [-o FILE.md]

TRACK: a built-in track, a file (with its middle in NAME_midline.csv beside it, if there is one), or `hairpin-LANE-GAP`:
two lanes LANE m wide whose inner rows are GAP m apart (0: one row for both), with a hairpin of 9 m outside at each end.

Times are processor time of the planner's call. A peer to compare with is ft-fsd-path-planning (not on PyPI):
pip install --target DIR "fsd-path-planning @ git+https://github.com/papalotis/ft-fsd-path-planning.git".
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from msgspec.structs import replace

from fsai_hil.simulator.tracks import Track, TrackError, TrackKind, load_track
from fsai_vcu.core.arrays import Floats, Ints
from fsai_vcu.core.driving import ConeColor, ConeObservation, Motion, Run
from fsai_vcu.core.planning.planner import Planner
from fsai_vcu.core.planning.pose import NO_PATH, headings_along, lengths_along, resampled, to_odometry, to_vehicle
from fsai_vcu.core.vehicle.parameters import CARS
from fsai_vcu.interface.enums import Ami, AsState
from fsai_vcu.interface.units import S

_HOW = [part.replace("\n", " ") for part in (__doc__ or "").split("\n\n")[1:2]]
RANGE_M, HALF_VIEW_RAD, BLIND_M = 15.0, math.radians(60.0), 0.6
STEP_M, SPEED_MPS = 0.5, 5.0
JUDGED_M, SHORT_M, HALF_WIDTH_M = 10.0, 5.0, 1.43 / 2.0
HAIRPIN_OUTSIDE_M = 9.0  # the smallest of the rules
SEEN_BEFORE = 4  # looks from the start before the first is judged

Placed = tuple[Floats, Ints]
"""(N, 2) places, and colours."""


def _as_it_is(xy: Floats, color: Ints, _: object) -> Placed:
    return xy, color


@dataclass(frozen=True)
class Condition:
    """What differs from a perfect look from the middle: the cones that stand there, a look at them, the car's place."""

    name: str
    laid: Callable[[Floats, Ints, Floats], Placed] = _as_it_is  # the third: the middle, (N, 2)
    seen: Callable[[Floats, Ints, np.random.Generator], Placed] = _as_it_is
    off_m: float = 0.0
    off_rad: float = 0.0


def _swapped(xy: Floats, color: Ints, draw: np.random.Generator) -> Placed:
    wrong = (draw.random(len(xy)) < 0.05) & ((color == ConeColor.BLUE) | (color == ConeColor.YELLOW))
    return xy, np.where(wrong, ConeColor.BLUE + ConeColor.YELLOW - color, color)


def _always_swapped(xy: Floats, color: Ints, _: Floats) -> Placed:
    """The same cones in every look: the detector has a reason."""
    return _swapped(xy, color, np.random.default_rng(5))


def _cluttered(xy: Floats, color: Ints, line: Floats) -> Placed:
    """Besides, cones that belong to nothing, every 10 m or so, 4 to 6 m from the middle."""
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


def _noisy(xy: Floats, color: Ints, draw: np.random.Generator) -> Placed:
    return xy + 0.1 * draw.standard_normal(xy.shape), color


def _colourless(xy: Floats, color: Ints, _: object) -> Placed:
    return xy, np.full_like(color, ConeColor.UNKNOWN)


def _ghosts(xy: Floats, color: Ints, draw: np.random.Generator) -> Placed:
    """One look in two has a cone that is not there, anywhere in view."""
    count = int(draw.random() < 0.5)
    far, angle = RANGE_M * np.sqrt(draw.random(count)), HALF_VIEW_RAD * (2.0 * draw.random(count) - 1.0)
    places = np.stack((far * np.cos(angle), far * np.sin(angle)), axis=-1)
    return np.concatenate((xy, places)), np.concatenate((color, draw.integers(1, 3, count)))


TRACKS = ("small_oval", "autocross", "trackdrive", "random-2", "hairpin-3-0.5", "hairpin-3.5-0", "hairpin-4-1")

CONDITIONS = (
    Condition("ideal"),
    Condition("0.5 m and 5 deg off", off_m=0.5, off_rad=math.radians(5.0)),
    Condition("10 % missing", seen=_missing),
    Condition("no colours", seen=_colourless),
    Condition("noise 0.1 m", seen=_noisy),
    Condition("clutter", _cluttered),
    Condition("ghosts", seen=_ghosts),
    Condition("5 % swapped, by look", seen=_swapped),
    Condition("5 % swapped, by cone", _always_swapped),
)


@dataclass(frozen=True)
class Row:
    """Of one track, or of all, under one condition."""

    track: str
    condition: str
    looks: int
    failed_at_m: tuple[float, ...]  # along the middle
    error_m: float  # mean of all looks
    error_max_m: float
    took_ms: tuple[float, ...]  # processor time of each call of the planner


def middle_of(track: Track, name: str) -> Floats:
    """(N, 2) The middle every half metre in driving order: from NAME_midline.csv beside NAME.csv, or as laid out."""
    beside = Path(name).with_name(f"{Path(name).stem}_midline.csv")
    if beside.is_file():
        table = np.genfromtxt(beside, delimiter=",", names=True)
        line = np.stack((table["x"], table["y"]), axis=-1)
    elif track.centreline_m is not None and track.closed:
        line = track.centreline_m
    else:
        raise TrackError(f"{name}: not a closed lane")
    return resampled(np.concatenate((line, line[:1])), STEP_M)


def motions(line: Floats, condition: Condition) -> Iterator[Motion]:
    """The car at each point of a closed line, beside it by what the condition says, now left and now right."""
    cos, sin = headings_along(np.concatenate((line[-1:], line, line[:1])))
    yaws = np.unwrap(np.arctan2(sin, cos))[1:-1]
    rates = np.gradient(yaws) * SPEED_MPS / STEP_M
    for index, ((x, y), yaw) in enumerate(zip(line, yaws, strict=True)):
        side = 1.0 if (index // 8) % 2 else -1.0
        yield Motion(
            t_ns=round(index * STEP_M / SPEED_MPS * S),
            x_m=float(x - side * condition.off_m * math.sin(yaw)),
            y_m=float(y + side * condition.off_m * math.cos(yaw)),
            yaw_rad=float(yaw + side * condition.off_rad),
            speed_mps=SPEED_MPS,
            yaw_rate_radps=float(rates[index]),
            distance_m=index * STEP_M,
        )


def judged(track: Track, line: Floats, condition: Condition, name: str) -> Row:
    """The planner once round, from the first point of the line."""
    draw = np.random.default_rng(7)
    cones, colors = condition.laid(track.cones_xy_m, track.cone_colors, line)
    planner = Planner(replace(CARS["2026"], nose_ahead_of_rear_axle_m=0.0))
    planner.reset(Run(1, Ami.TRACKDRIVE, AsState.AS_DRIVING, may_move=True))
    half_m = _half_widths(track, line)
    errors: list[float] = []
    furthest: list[float] = []
    took_ms: list[float] = []
    failed_at_m: list[float] = []
    looks = 0
    for index, motion in enumerate(motions(line, condition)):
        here = to_vehicle(motion, cones)
        angle = np.abs(np.arctan2(here[:, 1], here[:, 0]))
        seen = (np.hypot(here[:, 0], here[:, 1]) < RANGE_M) & (angle < HALF_VIEW_RAD) & (here[:, 0] > BLIND_M)
        xy, color = condition.seen(here[seen], colors[seen], draw)
        began_s = time.thread_time()
        plan = planner.on_cones(ConeObservation(motion.t_ns, xy, color, np.ones(len(xy))), motion)
        took_ms.append(round(1e3 * (time.thread_time() - began_s), 3))
        if index < SEEN_BEFORE or index % 2:
            continue
        looks += 1
        path = plan.path_m if plan is not None else NO_PATH
        if len(path) < 2 or lengths_along(path)[-1] < SHORT_M:
            failed_at_m.append(index * STEP_M)
            continue
        along = lengths_along(path)
        first = to_odometry(motion, path[(along <= JUDGED_M) & (along >= (3.0 if condition.off_m else 0.0))])
        near = np.arange(index - 4, index + 34) % len(line)
        error_m = _distances(first, line[near])
        place = near[np.hypot(first[:, None, 0] - line[near, 0], first[:, None, 1] - line[near, 1]).argmin(axis=1)]
        errors.append(float(error_m.mean()))
        furthest.append(float(error_m.max()))
        if (error_m + HALF_WIDTH_M > half_m[place]).any():
            failed_at_m.append(index * STEP_M)
    mean_m, most_m = (float(np.mean(errors)), max(furthest)) if errors else (math.nan, math.nan)
    return Row(name, condition.name, looks, tuple(failed_at_m), mean_m, most_m, tuple(took_ms))


def _distances(points: Floats, line: Floats) -> Floats:
    """(N,) of each point from the polyline."""
    a, b = line[None, :-1], line[None, 1:]
    along = b - a
    share = ((points[:, None] - a) * along).sum(axis=-1) / np.maximum((along * along).sum(axis=-1), 1e-12)
    foot = a + np.clip(share, 0.0, 1.0)[..., None] * along
    away = points[:, None] - foot
    return np.asarray(np.hypot(away[..., 0], away[..., 1]).min(axis=1))


def _half_widths(track: Track, line: Floats) -> Floats:
    """(N,) from each point of the middle to the nearer of the two chains of border cones."""
    half = np.full(len(line), np.inf)
    for border in (track.left_border_m, track.right_border_m):
        if border is not None:
            half = np.minimum(half, _distances(line, np.concatenate((border, border[:1]))))
    return half


def hairpins(lane_m: float, gap_m: float) -> Track:
    """A closed circuit of two lanes beside each other, 25 m long, and a hairpin at each end.

    A hairpin wider than the two lanes is reached through a bend outward, as the bulb of a lamp from its neck.
    """
    turn_m, neck_m = 0.5 * (HAIRPIN_OUTSIDE_M - lane_m), 8.0  # radii of the middle
    spread = math.acos(min(1.0, (0.5 * (lane_m + gap_m) + neck_m) / (turn_m + neck_m)))
    neck, turn = (neck_m * spread, -spread), (turn_m * (math.pi + 2.0 * spread), math.pi + 2.0 * spread)
    at, yaw, due_m = np.zeros(2), 0.0, 0.0
    middle: list[Floats] = []
    yaws: list[float] = []
    stations: list[int] = []
    for length_m, angle in (((25.0, 0.0), neck, turn, neck)) * 2:
        count = round(length_m / 0.05)
        for _ in range(count):
            if due_m <= 0.0:
                stations.append(len(middle))
                due_m += 2.0 if angle > 0.0 else 3.5
            middle.append(at)
            yaws.append(yaw)
            at = at + length_m / count * np.array([math.cos(yaw), math.sin(yaw)])
            yaw += angle / count
            due_m -= length_m / count
    line, out = np.array(middle), 0.5 * lane_m * np.stack((-np.sin(yaws), np.cos(yaws)), axis=-1)
    xy: list[Floats] = []
    color = []
    for row, its_color in ((line + out, ConeColor.BLUE), (line - out, ConeColor.YELLOW)):
        for place in row[stations]:
            # Where both lanes have a cone in the same row one is laid.
            if all(np.hypot(*(place - other)) > 1.2 for other in xy):
                xy.append(place)
                color.append(its_color)
    return Track(
        f"hairpin-{lane_m:g}-{gap_m:g}",
        TrackKind.CIRCUIT,
        np.array(xy),
        np.array(color, dtype=np.int64),
        closed=True,
        centreline_m=line,
        left_border_m=line + out,
        right_border_m=line - out,
    )


def label(name: str) -> str:
    """A track's name in the table."""
    return Path(name).stem if name.endswith(".csv") else name


def track_named(name: str) -> Track:
    """As the command line has it; raises TrackError."""
    if not name.startswith("hairpin-"):
        return load_track(name)
    try:
        lane_m, gap_m = map(float, name.split("-")[1:])
    except ValueError:
        raise TrackError(f"{name}: not hairpin-LANE-GAP, in metres") from None
    return hairpins(lane_m, gap_m)


def bench(names: Sequence[str], conditions: Sequence[Condition] = CONDITIONS) -> list[Row]:
    """A row for each track and condition."""
    rows = []
    for name in names:
        track = track_named(name)
        line = middle_of(track, name)
        for condition in conditions:
            print(f"\r\033[K{label(name)}: {condition.name}", end="", file=sys.stderr, flush=True)
            rows.append(judged(track, line, condition, label(name)))
    print("\r\033[K", end="", file=sys.stderr)
    return rows


def table_of(rows: Sequence[Row]) -> str:
    """All tracks together, a line for each condition; then what failed where. As Markdown."""
    lines = [
        "| condition            |  looks |  mean m |  max m | failed % | p50 ms | p99 ms |",
        "|----------------------|-------:|--------:|-------:|---------:|-------:|-------:|",
    ]
    for name in dict.fromkeys(row.condition for row in rows):
        mine = [row for row in rows if row.condition == name]
        looks = sum(row.looks for row in mine)
        p50_ms, p99_ms = np.percentile([took for row in mine for took in row.took_ms], (50, 99))
        failed = 100.0 * sum(len(row.failed_at_m) for row in mine) / looks
        lines.append(
            f"| {name:<20} | {looks:>6} | {sum(row.error_m * row.looks for row in mine) / looks:>7.4f} "
            f"| {max(row.error_max_m for row in mine):>6.2f} | {failed:>8.2f} | {p50_ms:>6.2f} | {p99_ms:>6.2f} |"
        )
    lines.append("")
    for row in rows:
        if row.failed_at_m:
            first = ", ".join(f"{at:.0f}" for at in row.failed_at_m[:8])
            lines.append(f"- {row.track}, {row.condition}: {len(row.failed_at_m)} of {row.looks} failed, at {first} m")
    return "\n".join(lines).rstrip()


def document(rows: Sequence[Row]) -> str:
    """The tables as a page: generated circuits by themselves."""
    parts = ["# Planning", "Made by `python -m fsai_hil.rehearsal.bench_planning`; do not edit.", *_HOW]
    for title, made in (("Circuits made by the rules", True), ("Other layouts", False)):
        mine = [row for row in rows if row.track.startswith("generated-") == made]
        if mine:
            names = list(dict.fromkeys(row.track for row in mine))
            named = f"{names[0]} to {names[-1]}" if made else ", ".join(names)
            parts += [f"## {title}", f"{len(names)}: {named}.", table_of(mine)]
    return "\n\n".join(parts) + "\n"


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="bench_planning", description=__doc__.split("\n")[0] if __doc__ else "")
    parser.add_argument("tracks", nargs="*", metavar="TRACK", default=list(TRACKS))
    parser.add_argument("--json", type=Path, metavar="FILE", help="write every figure of every track there, too")
    parser.add_argument("-o", "--output", type=Path, metavar="FILE.md", help="write the tables as a page, too")
    parser.add_argument(
        "--condition", action="append", choices=[condition.name for condition in CONDITIONS], help="only this one"
    )
    args = parser.parse_args(argv)
    try:
        rows = bench(args.tracks, [one for one in CONDITIONS if not args.condition or one.name in args.condition])
    except TrackError as error:
        print(f"bench_planning: {error}", file=sys.stderr)
        return 2
    print(table_of(rows))
    if args.output:
        args.output.write_text(document(rows), encoding="utf-8")
    if args.json:
        args.json.write_text(json.dumps([asdict(row) for row in rows]))
    return 0


if __name__ == "__main__":
    sys.exit(main())
