"""Tracks: cones, lines, the lane between the borders, and where the car is staged.

Built-in tracks are laid out by rule geometry; others are read from CSV files in the format of the public simulators:
header `tag,x,y[,direction,x_variance,y_variance,xy_covariance]`, metres, x forward or east, y left or north; tag is
blue (left border), yellow (right border), orange, big_orange (start and finish gates) or car_start, whose direction is
the yaw in radians at the rear axle. A file holds no borders, so they are found by walking between blue and yellow.
"""

from __future__ import annotations

import csv
import math
import random
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from itertools import groupby
from pathlib import Path
from typing import Final

import numpy as np

from fsai_hil.simulator.car import Pose
from fsai_vcu.core.arrays import Floats, Ints
from fsai_vcu.core.driving import ConeColor
from fsai_vcu.interface.enums import Ami
from fsai_vcu.interface.immutable import Immutable

Point = tuple[float, float]

# General FS rules, in metres; missions.md repeats them
LANE_M: Final = 3.0
ACCELERATION_RUN_M: Final = 75.0
ACCELERATION_STOP_M: Final = 100.0
SKIDPAD_INNER_DIAMETER_M: Final = 15.25
SKIDPAD_CENTRES_APART_M: Final = 18.25
SKIDPAD_STOP_M: Final = 25.0
CIRCUIT_STOP_M: Final = 30.0
STAGED_BEFORE_LINE_M: Final[Mapping[Ami, float]] = {
    Ami.ACCELERATION: 0.30,
    Ami.SKIDPAD: 15.0,
    Ami.AUTOCROSS: 6.0,
    Ami.TRACKDRIVE: 6.0,
}
CIRCUIT_LANE_M: Final = 3.5
CIRCUIT_MIN_RADIUS_M: Final = 6.0
CONE_RADIUS_M: Final = np.array([0.114, 0.114, 0.114, 0.114, 0.1425])  # by ConeColor


class TrackError(ValueError):
    """A track that cannot be used; the message is one line that says which and why."""


class TrackKind(Enum):
    """What can be driven on a track."""

    STATIC = "static"  # no cones: static inspections and the demonstration
    ACCELERATION = "acceleration"
    SKIDPAD = "skidpad"
    CIRCUIT = "circuit"


Rings = tuple[tuple[Point, ...], ...]


@dataclass(frozen=True)
class Track(Immutable):
    """A laid-out track. Arrays must not be written to.

    `lane` is the drivable area: a union of shapes, each made of rings whose insides cancel (a ring-shaped lane is two).
    An empty lane means that the borders are not known, and nothing is off course. `centreline` is the route in driving
    order, for the skidpad with all four laps.
    """

    name: str
    kind: TrackKind
    cones_xy_m: Floats
    cone_colors: Ints
    car_start: Pose | None = None
    closed: bool = False
    start_line: Pose | None = None  # its middle, and the direction in which cars cross it
    finish_line: Pose | None = None
    centreline_m: Floats | None = None
    left_border_m: Floats | None = None
    right_border_m: Floats | None = None
    lane: tuple[Rings, ...] = ()
    source: str = field(default="", compare=False)  # the file or the name from which load_track makes it again

    @property
    def length_m(self) -> float:
        """Length of the centreline; 0 where none is known."""
        line = self.centreline_m
        if line is None or len(line) < 2:
            return 0.0
        length = float(np.hypot(*np.diff(line, axis=0).T).sum())
        return length + float(np.hypot(*(line[0] - line[-1]))) if self.closed else length

    def on_lane(self, x_m: float, y_m: float) -> bool:
        """Whether a point is between the borders; always so where no borders are known."""
        return not self.lane or any(_inside(rings, x_m, y_m) for rings in self.lane)

    def staging(self, mission: Ami, nose_m: float) -> Pose:
        """Where the car (its nose `nose_m` ahead of the rear axle) stands before a mission.

        A file's own car_start wins; otherwise the foremost part is staged before the start line as the mission asks.
        """
        if self.car_start is not None:
            return self.car_start
        before_m = STAGED_BEFORE_LINE_M.get(mission)
        if self.start_line is None or before_m is None:
            return Pose()
        return Pose(*self.start_line.ahead(-before_m - nose_m), self.start_line.yaw_rad)


def _inside(rings: Rings, x: float, y: float) -> bool:
    """Even-odd rule over all rings together."""
    inside = False
    for ring in rings:
        x0, y0 = ring[-1]
        for x1, y1 in ring:
            if (y0 > y) != (y1 > y) and x < (x1 - x0) * (y - y0) / (y1 - y0) + x0:
                inside = not inside
            x0, y0 = x1, y1
    return inside


def _cones(groups: Sequence[tuple[ConeColor, Sequence[Point]]]) -> tuple[Floats, Ints]:
    colors = [int(color) for color, points in groups for _ in points]
    return _array([point for _, points in groups for point in points]), np.array(colors, dtype=np.int64)


def _array(points: Sequence[Point]) -> Floats:
    return np.array(points, dtype=np.float64).reshape(-1, 2)


# ---------------------------------------------------------------- built-in tracks


def acceleration_track() -> Track:
    """75 m straight from the start line at x = 0, and 100 m of exit lane to stop in."""
    half = LANE_M / 2.0
    finish = ACCELERATION_RUN_M
    rows = [5.0 * i for i in range(1, 15)]
    exits = [finish + 5.0 * i for i in range(1, int(ACCELERATION_STOP_M / 5.0) + 2)]
    gate = [(x, y) for line in (0.0, finish) for x in (line - 0.3, line + 0.3) for y in (half, -half)]
    xy, colors = _cones(
        (
            (ConeColor.BLUE, [(x, half) for x in rows]),
            (ConeColor.YELLOW, [(x, -half) for x in rows]),
            (ConeColor.BIG_ORANGE, gate),
            (ConeColor.ORANGE, [(x, y) for x in exits for y in (half, -half)]),
            (ConeColor.ORANGE, [(exits[-1], y) for y in (0.5, -0.5)]),
        )
    )
    track = Track("acceleration", TrackKind.ACCELERATION, xy, colors, source="acceleration")
    return _with_straight(track, (0.0, 0.0), (finish, 0.0), half)


def _with_straight(track: Track, start: Point, finish: Point, half_m: float) -> Track:
    """The track with lines and lane of a straight, the exit lane behind the finish included.

    It begins in the staging area, so that a car that waits there is on the track.
    """
    line = Pose(*start, math.atan2(finish[1] - start[1], finish[0] - start[0]))
    run_m = math.dist(start, finish)
    begin, end = -10.0, run_m + ACCELERATION_STOP_M
    ring = ((begin, -half_m), (end + 10.0, -half_m), (end + 10.0, half_m), (begin, half_m))
    return replace(
        track,
        start_line=line,
        finish_line=Pose(*finish, line.yaw_rad),
        centreline_m=_array([line.ahead(begin + 0.5 * i) for i in range(int((end - begin) * 2) + 1)]),
        left_border_m=_array([line.ahead(begin, half_m), line.ahead(end, half_m)]),
        right_border_m=_array([line.ahead(begin, -half_m), line.ahead(end, -half_m)]),
        lane=((tuple(line.ahead(*corner) for corner in ring),),),
    )


def skidpad_track() -> Track:
    """Two circles side by side; cars come along x, cross the timing line at x = 0, and turn right first."""
    inner = SKIDPAD_INNER_DIAMETER_M / 2.0
    outer = inner + LANE_M
    middle = SKIDPAD_CENTRES_APART_M / 2.0  # also the radius of the driven circle
    half = LANE_M / 2.0
    steps = 16  # inner cones of a circle; of the outer ones the three at the crossing are left out
    blue: list[Point] = []
    yellow: list[Point] = []
    for side, inner_cones, outer_cones in ((1.0, blue, yellow), (-1.0, yellow, blue)):
        for i in range(steps):
            angle = 2.0 * math.pi * i / steps  # from the side of the crossing
            dx, dy = math.sin(angle), -side * math.cos(angle)
            inner_cones.append((inner * dx, side * middle + inner * dy))
            if min(i, steps - i) > 1:
                outer_cones.append((outer * dx, side * middle + outer * dy))
    gate_x = 1.75
    gate_y = middle - math.sqrt(inner**2 - gate_x**2)
    entry = [-9.0 - 2.0 * i for i in range(6)]
    leave = [9.0 + 2.0 * i for i in range(10)]
    end = leave[-1] + 1.0
    xy, colors = _cones(
        (
            (ConeColor.BLUE, blue),
            (ConeColor.YELLOW, yellow),
            (ConeColor.BIG_ORANGE, [(x, y) for x in (-gate_x, gate_x) for y in (gate_y, -gate_y)]),
            (ConeColor.ORANGE, [(x, y) for x in entry + leave for y in (half + 0.14, -half - 0.14)]),
            (ConeColor.ORANGE, [(end, y) for y in (0.5, -0.5)]),
        )
    )
    begin = -22.0

    def circle(centre_y: float, radius: float) -> tuple[Point, ...]:
        angles = (2.0 * math.pi * i / 180 for i in range(180))
        return tuple((radius * math.cos(a), centre_y + radius * math.sin(a)) for a in angles)

    route: list[Point] = [(begin + 0.25 * i, 0.0) for i in range(int(-begin * 4))]
    per_lap = int(2.0 * math.pi * middle * 4)
    for side in (-1.0, -1.0, 1.0, 1.0):
        for i in range(per_lap):
            angle = 2.0 * math.pi * i / per_lap
            route.append((middle * math.sin(angle), side * middle * (1.0 - math.cos(angle))))
    route += [(0.25 * i, 0.0) for i in range(int(end * 4) + 1)]
    straight = ((begin, -half), (end, -half), (end, half), (begin, half))
    lane = (
        (circle(middle, inner), circle(middle, outer)),
        (circle(-middle, inner), circle(-middle, outer)),
        (straight,),
    )
    track = Track("skidpad", TrackKind.SKIDPAD, xy, colors, centreline_m=_array(route), lane=lane, source="skidpad")
    return _with_line(track, Pose())


def _with_line(track: Track, line: Pose) -> Track:
    """The track with one line for start and finish."""
    return replace(track, start_line=line, finish_line=line)


def _resampled(line: Floats, step_m: float) -> Floats:
    """A closed line at even steps."""
    ring = np.vstack([line, line[:1]])
    s = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(ring, axis=0).T))])
    at = np.linspace(0.0, s[-1], max(8, round(s[-1] / step_m)), endpoint=False)
    return np.column_stack([np.interp(at, s, ring[:, 0]), np.interp(at, s, ring[:, 1])])


def _smoothed(line: Floats, window_m: float, step_m: float = 0.25) -> Floats:
    """A closed, evenly sampled line without the zigzag that midpoints between cones make."""
    half = round(window_m / step_m / 2.0)
    padded = np.vstack([line[-half:], line, line[:half]])
    kernel = np.ones(2 * half + 1) / (2 * half + 1)
    return np.column_stack([np.convolve(padded[:, i], kernel, "valid") for i in (0, 1)])


def _curvature(line: Floats) -> Floats:
    """Signed curvature of a closed, evenly sampled line (left positive)."""
    ahead, behind = np.roll(line, -1, axis=0), np.roll(line, 1, axis=0)
    first = (ahead - behind) / 2.0
    second = ahead - 2.0 * line + behind
    cross = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
    return np.asarray(cross / np.maximum(1e-9, np.hypot(*first.T)) ** 3, dtype=np.float64)


def _border(centreline: Floats, offset_m: float) -> Floats:
    tangent = np.roll(centreline, -1, axis=0) - np.roll(centreline, 1, axis=0)
    tangent /= np.hypot(*tangent.T)[:, None]
    return np.asarray(centreline + offset_m * np.column_stack([-tangent[:, 1], tangent[:, 0]]), dtype=np.float64)


def _stretched(ring: Floats, straight_m: float) -> Floats:
    """The ring with a straight put in at its first point, and its twin where the tangent is opposite."""
    tangent = np.roll(ring, -1, axis=0) - np.roll(ring, 1, axis=0)
    angle = np.unwrap(np.arctan2(tangent[:, 1], tangent[:, 0]))
    far = int(np.argmin(np.abs(angle - angle[0] - math.pi)))
    along = tangent[0] / np.hypot(*tangent[0])
    steps = np.arange(0.25, straight_m, 0.25)[:, None]
    first_straight = ring[0] + steps * along
    outward = ring[1 : far + 1] + straight_m * along
    back_straight = ring[far] + straight_m * along - steps * along
    return np.vstack([ring[:1], first_straight, ring[:1] + straight_m * along, outward, back_straight, ring[far:]])


def _circuit_from(name: str, centreline: Floats, line_at_m: float, lane_m: float) -> Track:
    """A closed circuit round a centreline that begins at the start of its straight."""
    step = 0.25
    middle = _resampled(centreline, step)
    middle = np.roll(middle, -round(line_at_m / step), axis=0)
    toward = middle[1] - middle[-1]
    heading = math.atan2(toward[1], toward[0])
    # the start line becomes the origin, crossed along x
    c, s = math.cos(-heading), math.sin(-heading)
    middle = (middle - middle[0]) @ np.array([[c, s], [-s, c]])
    left, right = _border(middle, lane_m / 2.0), _border(middle, -lane_m / 2.0)
    curvature = np.abs(_curvature(middle))
    smooth = np.convolve(np.concatenate([curvature[-12:], curvature, curvature[:12]]), np.ones(25) / 25.0, "valid")
    rows: list[list[Point]] = []
    for border, phase in ((left, 0.0), (right, 0.4)):
        steps = np.hypot(*(np.roll(border, -1, axis=0) - border).T)
        row: list[Point] = []
        due = phase * 3.0
        for i, point in enumerate(border):
            if due <= 0.0:
                row.append((float(point[0]), float(point[1])))
                # Cones stand closer in tight corners; 5 m is the rules' most.
                due += min(4.5, max(2.0, 0.35 / max(float(smooth[i]), 1e-3)))
            due -= float(steps[i])
        if math.dist(row[0], row[-1]) < 1.2:
            row.pop()
        rows.append([p for p in row if not (abs(p[0]) < 1.2 and abs(p[1]) < lane_m)])
    gate = [(x, y) for x in (-0.4, 0.4) for y in (lane_m / 2.0, -lane_m / 2.0)]
    xy, colors = _cones(((ConeColor.BLUE, rows[0]), (ConeColor.YELLOW, rows[1]), (ConeColor.BIG_ORANGE, gate)))
    return _with_circuit(Track(name, TrackKind.CIRCUIT, xy, colors, source=name), Pose(), middle, left, right)


def _with_circuit(track: Track, line: Pose, middle: Floats, left: Floats, right: Floats) -> Track:
    """The track with the lane between two closed borders."""
    rings = tuple(tuple((float(x), float(y)) for x, y in border) for border in (left, right))
    circuit = replace(track, closed=True, centreline_m=middle, left_border_m=left, right_border_m=right, lane=(rings,))
    return _with_line(circuit, line)


def small_oval() -> Track:
    """Two half circles of 10 m and two straights of 20 m: 103 m."""
    angles = np.linspace(-math.pi / 2.0, 1.5 * math.pi, 252, endpoint=False)
    circle = 10.0 * np.column_stack([np.cos(angles), np.sin(angles)])
    return _circuit_from("small_oval", _stretched(circle, 20.0), 12.0, CIRCUIT_LANE_M)


def random_circuit(seed: int, name: str = "", length_m: float = 250.0, straight_m: float = 24.0) -> Track:
    """A closed circuit of about `length_m`, always the same for a seed, no centreline tighter than 6 m + half a lane.

    A circle bent by a few harmonics, then stretched by a starting straight and its twin on the far side.
    """
    draw = random.Random(seed)
    angles = np.linspace(-math.pi / 2.0, 1.5 * math.pi, 720, endpoint=False)
    while True:
        radius = np.ones_like(angles)
        for harmonic, size in ((2, 0.25), (3, 0.22), (4, 0.13), (5, 0.08)):
            amplitude, phase = draw.uniform(0.3, 1.0) * size, draw.uniform(0.0, 2.0 * math.pi)
            radius += amplitude * np.cos(harmonic * angles + phase)
        shape = radius[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])
        perimeter = float(np.hypot(*np.diff(np.vstack([shape, shape[:1]]), axis=0).T).sum())
        shape = _resampled(shape * (length_m - 2.0 * straight_m) / perimeter, 0.25)
        # the straight goes where the circle bends least to the left, so that no kink is left behind
        bend = _curvature(shape)
        flattest = int(np.argmin(np.abs(bend - 0.01)))
        whole = _resampled(_stretched(np.roll(shape, -flattest, axis=0), straight_m), 0.25)
        if draw.random() < 0.5:
            whole[:, 1] *= -1.0  # the other way round
        if _drivable(whole):
            return _circuit_from(name or f"random-{seed}", whole, straight_m * 0.55, CIRCUIT_LANE_M)


def _drivable(middle: Floats) -> bool:
    """No corner too tight, and no two parts of the lane so close that their cones mix."""
    tightest = CIRCUIT_MIN_RADIUS_M + CIRCUIT_LANE_M / 2.0
    if float(np.abs(_curvature(middle)).max()) > 1.0 / tightest:
        return False
    thin = middle[::4]
    count = len(thin)
    apart = np.hypot(thin[:, None, 0] - thin[None, :, 0], thin[:, None, 1] - thin[None, :, 1])
    index = np.arange(count)
    along = np.abs(index[:, None] - index[None, :])
    along = np.minimum(along, count - along)
    return float(apart[along > 20].min()) > CIRCUIT_LANE_M + 4.5


AUTOCROSS_SEED: Final = 4
TRACKDRIVE_SEED: Final = 11

BUILT_IN: Final[Mapping[str, Callable[[], Track]]] = {
    "static": lambda: Track("static", TrackKind.STATIC, *_cones(()), source="static"),  # open ground
    "acceleration": acceleration_track,
    "skidpad": skidpad_track,
    "autocross": lambda: random_circuit(AUTOCROSS_SEED, "autocross", 230.0),
    "trackdrive": lambda: random_circuit(TRACKDRIVE_SEED, "trackdrive", 290.0),
    "small_oval": small_oval,
}

MISSION_TRACK: Final[Mapping[Ami, str]] = {
    Ami.ACCELERATION: "acceleration",
    Ami.SKIDPAD: "skidpad",
    Ami.AUTOCROSS: "autocross",
    Ami.TRACKDRIVE: "trackdrive",
}  # the others need no track: "static"


# ---------------------------------------------------------------- files


TAGS: Final = {color.name.lower(): color for color in ConeColor if color is not ConeColor.UNKNOWN}
FURTHEST_M: Final = 10_000.0  # no event's track is as large; degrees times 1e7 or millimetres look like this
UNUSED_TAGS: Final = frozenset({"midpoint", "inactive"})  # some public files have them; they are no cones


def load_track(path_or_name: str | Path) -> Track:
    """The built-in track of that name (also `random-SEED`), or the one in a CSV file.

    Raises TrackError with one line that names the file, the line and what is wrong.
    """
    name = str(path_or_name)
    maker = BUILT_IN.get(name)
    if maker is not None:
        return maker()
    if name.startswith("random-") and name[7:].isdigit():
        return random_circuit(int(name[7:]))
    path = Path(path_or_name)
    if not path.suffix and not path.exists():
        known = ", ".join((*BUILT_IN, "random-SEED"))
        raise TrackError(f"{name}: no such track; built in are {known}; or name a CSV file")
    try:
        text = path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise TrackError(f"{path}: cannot be read: {error.strerror or error}") from None
    except UnicodeDecodeError:
        raise TrackError(f"{path}: not a text file") from None
    return replace(parse_track(text, str(path)), source=str(path.resolve()))


def parse_track(text: str, source: str) -> Track:
    """The track in a CSV text; `source` is what error messages call it."""
    reader = csv.reader(text.splitlines())
    header = [column.strip() for column in next(reader, [])]
    if header[:3] != ["tag", "x", "y"]:
        found = ",".join(header)[:60] or "nothing"
        raise TrackError(f"{source}: line 1: the header must begin with tag,x,y but is {found!r}")
    points: list[Point] = []
    colors: list[ConeColor] = []
    start: Pose | None = None
    for row in reader:
        if not row or (len(row) == 1 and not row[0].strip()):
            continue
        at = f"{source}: line {reader.line_num}"
        if len(row) < 3:
            raise TrackError(f"{at}: {len(row)} columns where at least tag, x and y are needed")
        tag = row[0].strip()
        x, y = _number(row, 1, "x", at), _number(row, 2, "y", at)
        if max(abs(x), abs(y)) > FURTHEST_M:
            raise TrackError(f"{at}: {x:g}, {y:g} is further than {FURTHEST_M:g} m from the origin; are these metres?")
        if tag == "car_start":
            if start is not None:
                raise TrackError(f"{at}: a second car_start")
            start = Pose(x, y, _number(row, 3, "direction", at) if len(row) > 3 else 0.0)
        elif tag in TAGS:
            points.append((x, y))
            colors.append(TAGS[tag])
        elif tag not in UNUSED_TAGS:
            raise TrackError(f"{at}: unknown tag {tag!r}; known are {', '.join(TAGS)} and car_start")
    if not points:
        raise TrackError(f"{source}: no cones")
    if start is None:
        raise TrackError(f"{source}: no car_start, so nobody knows where the car begins and which way it points")
    colored = np.array(colors, dtype=np.int64)
    track = Track(Path(source).stem, TrackKind.CIRCUIT, _array(points), colored, car_start=start, source=source)
    return _measured(track, start)


def _number(row: Sequence[str], column: int, name: str, at: str) -> float:
    text = row[column].strip()
    try:
        value = float(text)
    except ValueError:
        raise TrackError(f"{at}: {name} is {text!r}, not a number") from None
    if not math.isfinite(value):
        raise TrackError(f"{at}: {name} is {text}, not a finite number")
    return value


def _measured(track: Track, start: Pose) -> Track:
    """Find out what kind of track the cones make, its lines and its borders."""
    gates = _gates(track, start)
    line = Pose(*gates[0].mean(axis=0).tolist(), start.yaw_rad) if gates else start
    if gates and _skidpad_like(track, line):
        return _with_skidpad(track, line, gates[0])
    if (walked := _walk(track, start)) is not None:
        left, right, middle = walked
        middle = _smoothed(_resampled(middle, 0.25), 2.0)
        nearest = int(np.argmin(np.hypot(middle[:, 0] - line.x_m, middle[:, 1] - line.y_m)))
        middle = np.roll(middle, -nearest, axis=0)
        toward = middle[2] - middle[-2]
        line = Pose(float(middle[0, 0]), float(middle[0, 1]), math.atan2(toward[1], toward[0]))
        return _with_circuit(track, line, middle, left, right)
    if len(gates) >= 2:
        first, finish = (line.x_m, line.y_m), gates[-1].mean(axis=0).tolist()
        ahead_m, left_m = line.seen(*track.cones_xy_m.T)
        beside = (ahead_m > 0.0) & (ahead_m < math.dist(first, finish))
        half = float(np.median(np.abs(left_m[beside]))) if beside.any() else LANE_M / 2.0
        return _with_straight(replace(track, kind=TrackKind.ACCELERATION), first, finish, half)
    # cones that make no circuit which can be walked: it can be driven and timed, but nothing is off course
    return _with_line(track, line)


def _gates(track: Track, start: Pose) -> list[Floats]:
    """Big orange cones in groups no more than 8 m apart along the starting direction: those in front of the car."""
    big = track.cones_xy_m[track.cone_colors == ConeColor.BIG_ORANGE]
    ahead_m = start.seen(*big.T)[0]
    order = np.argsort(ahead_m, kind="stable")
    breaks = np.flatnonzero(np.diff(ahead_m[order]) >= 8.0) + 1
    return [big[group] for group in np.split(order, breaks) if len(group) and ahead_m[group[-1]] > 0.0]


def _skidpad_like(track: Track, gate: Pose) -> bool:
    """Two rings of blue and yellow cones to the left and to the right of the first gate."""
    apart, inner = SKIDPAD_CENTRES_APART_M / 2.0, SKIDPAD_INNER_DIAMETER_M / 2.0
    for side, color in ((1.0, ConeColor.BLUE), (-1.0, ConeColor.YELLOW)):
        from_centre = track.cones_xy_m[track.cone_colors == color] - gate.ahead(0.0, side * apart)
        if np.count_nonzero(np.abs(np.hypot(*from_centre.T) - inner) < 0.75) < 10:
            return False
    return True


def _with_skidpad(track: Track, line: Pose, gate: Floats) -> Track:
    """The rules' skidpad, laid over the cones of a file."""
    ideal = skidpad_track()
    # the gate's own direction: across is from its rightmost to its leftmost cone, so that a start askew does no harm
    on_left = line.seen(*gate.T)[1] > 0.0
    heading = line.yaw_rad
    if on_left.any() and not on_left.all():
        x, y = gate[on_left].mean(axis=0) - gate[~on_left].mean(axis=0)
        heading = math.atan2(y, x) - math.pi / 2.0
    origin = Pose(line.x_m, line.y_m, heading)
    assert ideal.centreline_m is not None  # skidpad_track always has one
    route = _array([origin.ahead(float(x), float(y)) for x, y in ideal.centreline_m])
    lane = tuple(tuple(tuple(origin.ahead(x, y) for x, y in ring) for ring in rings) for rings in ideal.lane)
    return _with_line(replace(track, kind=TrackKind.SKIDPAD, centreline_m=route, lane=lane), origin)


def _walk(track: Track, start: Pose) -> tuple[Floats, Floats, Floats] | None:
    """Walk the lane from triangle to triangle through the edges that join a left cone to a right one.

    In a triangulation of all cones each triangle inside the lane has exactly two such edges, so the way on is always
    the other one. Left border, right border (the cones passed on either side) and the middle between them; None where
    the walk does not come back to its beginning.
    """
    colors = track.cone_colors
    ahead_m, left_m = start.seen(*track.cones_xy_m.T)
    sides = (colors == ConeColor.BLUE).astype(int) - (colors == ConeColor.YELLOW)
    gate = (colors == ConeColor.BIG_ORANGE) & (ahead_m > -15.0)
    sides[gate] = np.where(left_m[gate] > 0.0, 1, -1)
    xy, ahead_m, left_m, sides = (each[sides != 0] for each in (track.cones_xy_m, ahead_m, left_m, sides))
    if min(np.count_nonzero(sides > 0), np.count_nonzero(sides < 0)) < 3:
        return None
    from scipy.spatial import Delaunay, QhullError  # type: ignore[import-untyped]  # slow to import, for files only

    try:
        triangles = Delaunay(xy).simplices
    except QhullError:
        return None
    onward: dict[tuple[int, int], list[tuple[int, int]]] = defaultdict(list)  # the edges with a triangle in common
    begin: tuple[float, tuple[int, int], tuple[int, int]] | None = None  # the edge which the car's axis crosses first
    for triangle in triangles.tolist():
        edges = [(a, b) for a in triangle if sides[a] > 0 for b in triangle if sides[b] < 0]
        for (a, b), following in zip(edges, reversed(edges), strict=True):
            onward[a, b].append(following)
            if left_m[a] * left_m[b] > 0.0 or abs(left_m[a]) + abs(left_m[b]) > 8.0:
                continue
            share = left_m[a] / (left_m[a] - left_m[b]) if left_m[a] != left_m[b] else 0.5
            crossing = (1.0 - share) * ahead_m[a] + share * ahead_m[b]
            (opposite,) = {*triangle} - {a, b}
            # this triangle lies behind the edge as the car sees it
            if 0.0 < crossing < ahead_m[opposite] and (begin is None or crossing < begin[0]):
                begin = (crossing, (a, b), following)
    if begin is None:
        return None
    _, before, edge = begin
    walked = [before]
    while edge != walked[0]:
        walked.append(edge)
        further = [other for other in onward[edge] if other != before]
        if not further:
            return None
        before, edge = edge, further[0]
    borders = [[cone for cone, _ in groupby(side)] for side in zip(*walked, strict=True)]
    for border in borders:
        if border[0] == border[-1]:
            border.pop()
    passed = np.array(walked)
    return xy[borders[0]], xy[borders[1]], (xy[passed[:, 0]] + xy[passed[:, 1]]) / 2.0
