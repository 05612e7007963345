"""The layout of a track: cones, lines, the lane between the borders, and where the car is staged."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from enum import Enum
from typing import Final

import numpy as np
from msgspec.structs import replace

from fsai_hil.simulator.car import Pose
from fsai_vcu.core.arrays import Floats, Ints
from fsai_vcu.core.driving import ConeColor
from fsai_vcu.core.missions.settings import MissionSettings
from fsai_vcu.core.vehicle.parameters import ADS_DV_2026
from fsai_vcu.interface.enums import Ami
from fsai_vcu.interface.values import Value

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
    Ami.ACCELERATION: MissionSettings().acceleration_staging_m,
    Ami.SKIDPAD: 15.0,
    Ami.AUTOCROSS: MissionSettings().lap_staging_m,
    Ami.TRACKDRIVE: MissionSettings().lap_staging_m,
}
NOSE_M: Final = ADS_DV_2026.nose_ahead_of_rear_axle_m  # the same for all cars
CIRCUIT_LANE_M: Final = 3.5
CIRCUIT_MIN_RADIUS_M: Final = 6.0
OWN_GATE: Final = "its gate of big orange cones"
BETWEEN_RINGS: Final = "between its two rings"
TIMING_POSTS: Final = "timing posts"
CONE_RADIUS_M: Final = np.array([0.114, 0.114, 0.114, 0.114, 0.1425])  # by ConeColor


class TrackError(ValueError):
    """A track that cannot be used; the message is one line that says which and why."""


class TrackKind(Enum):
    """The kinds of track, by what can be driven on them."""

    STATIC = "static"  # no cones: static inspections and the demonstration
    ACCELERATION = "acceleration"
    SKIDPAD = "skidpad"
    CIRCUIT = "circuit"


KIND_IS: Final[Mapping[TrackKind, str]] = {
    TrackKind.STATIC: "no cones",
    TrackKind.ACCELERATION: "a straight between two gates of big orange cones, or between two pairs of timing posts",
    TrackKind.SKIDPAD: (
        f"two whole rings of cones {SKIDPAD_INNER_DIAMETER_M:g} m wide, "
        f"their middles {SKIDPAD_CENTRES_APART_M:g} m apart"
    ),
    TrackKind.CIRCUIT: "a lane between blue and yellow cones",
}
Rings = tuple[tuple[Point, ...], ...]


class Track(Value, frozen=True):
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
    line_by: str = ""  # what the start line is known by, in words
    centreline_m: Floats | None = None
    left_border_m: Floats | None = None
    right_border_m: Floats | None = None
    lane: tuple[Rings, ...] = ()
    source: str = ""  # the file or the name from which load_track makes it again

    @property
    def length_m(self) -> float:
        """Length of the centreline; 0 where none is known."""
        line = self.centreline_m
        if line is None or len(line) < 2:
            return 0.0
        length = float(np.hypot(*np.diff(line, axis=0).T).sum())
        return length + float(np.hypot(*(line[0] - line[-1]))) if self.closed else length

    def on_lane(self, x_m: float, y_m: float) -> bool:
        """Return whether a point is between the borders; always so where no borders are known."""
        return not self.lane or any(_inside(rings, x_m, y_m) for rings in self.lane)

    def staging(self, mission: Ami, nose_m: float) -> Pose:
        """Return where the car (its nose `nose_m` ahead of the rear axle) stands before a mission.

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


def cones_of(groups: Sequence[tuple[ConeColor, Sequence[Point]]]) -> tuple[Floats, Ints]:
    colors = [int(color) for color, points in groups for _ in points]
    return as_array([point for _, points in groups for point in points]), np.array(colors, dtype=np.int64)


def as_array(points: Sequence[Point]) -> Floats:
    return np.array(points, dtype=np.float64).reshape(-1, 2)


def with_straight(track: Track, start: Point, finish: Point, half_m: float) -> Track:
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
        line_by=OWN_GATE,
        centreline_m=as_array([line.ahead(begin + 0.5 * i) for i in range(int((end - begin) * 2) + 1)]),
        left_border_m=as_array([line.ahead(begin, half_m), line.ahead(end, half_m)]),
        right_border_m=as_array([line.ahead(begin, -half_m), line.ahead(end, -half_m)]),
        lane=((tuple(line.ahead(*corner) for corner in ring),),),
    )


def with_line(track: Track, line: Pose, by: str) -> Track:
    """The track with one line for start and finish, and what it is known by."""
    return replace(track, start_line=line, finish_line=line, line_by=by)


def with_circuit(track: Track, line: Pose, middle: Floats, left: Floats, right: Floats, by: str = OWN_GATE) -> Track:
    """The track with the lane between two closed borders."""
    rings = tuple(tuple((float(x), float(y)) for x, y in border) for border in (left, right))
    circuit = replace(track, closed=True, centreline_m=middle, left_border_m=left, right_border_m=right, lane=(rings,))
    return with_line(circuit, line, by)


def smoothed(line: Floats, window_m: float, step_m: float = 0.25) -> Floats:
    """A closed, evenly sampled line without the zigzag that midpoints between cones make."""
    half = round(window_m / step_m / 2.0)
    padded = np.vstack([line[-half:], line, line[:half]])
    kernel = np.ones(2 * half + 1) / (2 * half + 1)
    return np.column_stack([np.convolve(padded[:, i], kernel, "valid") for i in (0, 1)])


def offset_line(centreline: Floats, offset_m: float) -> Floats:
    tangent = np.roll(centreline, -1, axis=0) - np.roll(centreline, 1, axis=0)
    tangent /= np.hypot(*tangent.T)[:, None]
    return np.asarray(centreline + offset_m * np.column_stack([-tangent[:, 1], tangent[:, 0]]), dtype=np.float64)


def closest_m(middle: Floats, further_m: float) -> float:
    """Return how near a closed line sampled every 0.25 m comes to itself, further along it than that."""
    thin = middle[::4]
    count = len(thin)
    apart = np.hypot(thin[:, None, 0] - thin[None, :, 0], thin[:, None, 1] - thin[None, :, 1])
    index = np.arange(count)
    along = np.abs(index[:, None] - index[None, :])
    return float(apart[np.minimum(along, count - along) > further_m].min())
