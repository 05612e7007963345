"""Track files: from the rows of any format to a track, and from a track to a file.

No file holds borders: `walking` finds them, and lays the lines.
"""

from __future__ import annotations

import sys
from collections import Counter
from pathlib import Path
from typing import Final

import numpy as np

from fsai_hil.simulator.car import Pose
from fsai_hil.simulator.tracks.formats import LONGEST_WORD, number_of, rows_of
from fsai_hil.simulator.tracks.layout import LANE_M, TIMING_POSTS, Point, Track, TrackError, TrackKind, as_array
from fsai_hil.simulator.tracks.walking import laid_out
from fsai_vcu.core.driving import ConeColor

TAGS: Final = {color.name.lower(): color for color in ConeColor}
OTHER_NAMES: Final = {"small_orange": "orange", "orange_big": "big_orange", "time_keeping": "timekeeping"}
NO_CONES: Final = frozenset({"midpoint", "inactive", "invisible"})
FURTHEST_M: Final = 10_000.0  # no event's track is as large; degrees times 1e7 or millimetres look like this
FULL_TURN_RAD: Final = 6.3  # no direction is as large; degrees look like this
MOST_TAGS: Final = 20  # that are named as skipped
MOST_CONES: Final = 5_000  # the longest tracks have a tenth of it; borders are found in a time that grows faster


def parse_track(text: str, source: str) -> Track:
    """The track in a file's text; `source` is what messages call it. What was left out or assumed goes to stderr."""
    points: list[Point] = []
    colors: list[ConeColor] = []
    posts: list[Point] = []
    start: Pose | None = None
    skipped: Counter[str] = Counter()
    seen: set[tuple[float, float, str]] = set()
    doubled = 0
    notes: list[str] = []
    for at, tag, values in rows_of(text, source, notes.append):
        x, y = number_of(values, 0, "x", at), number_of(values, 1, "y", at)
        if max(abs(x), abs(y)) > FURTHEST_M:
            raise TrackError(f"{at}: {x:g}, {y:g} is further than {FURTHEST_M:g} m from the origin; are these metres?")
        name = tag.strip().lower().replace("-", "_").replace(" ", "_")
        name = OTHER_NAMES.get(name, name)
        if name == "car_start":
            if start is not None:
                raise TrackError(f"{at}: a second car_start")
            if len(values) < 3:
                notes.append("car_start has no direction: it is taken to be 0, along x")
            yaw_rad = number_of(values, 2, "direction", at) if len(values) > 2 else 0.0
            if abs(yaw_rad) > FULL_TURN_RAD:
                raise TrackError(f"{at}: direction is {yaw_rad:g}, more than a full turn; is it in rad?")
            start = Pose(x, y, yaw_rad)
        elif name == "timekeeping":
            posts.append((x, y))
        elif name in TAGS:
            if (x, y, name) in seen:
                doubled += 1
                continue
            seen.add((x, y, name))
            points.append((x, y))
            colors.append(TAGS[name])
        elif name not in NO_CONES:
            skipped[tag[:LONGEST_WORD] if len(skipped) < MOST_TAGS else "…"] += 1
        if len(points) + len(posts) > MOST_CONES:
            raise TrackError(f"{at}: more than {MOST_CONES} cones")
    notes += (f"skipped {count} row{'s' * (count > 1)} with tag {tag!r}" for tag, count in skipped.items())
    if doubled:
        notes.append(f"skipped {doubled} cone{'s' * (doubled > 1)} that stood in the file before")
    if not points:
        raise TrackError(f"{source}: no cones")
    colored = np.array(colors, dtype=np.int64)
    track = Track(Path(source).stem, TrackKind.CIRCUIT, as_array(points), colored, source=source)
    found = laid_out(track, start, as_array(posts), notes.append)
    for note in notes:
        print(f"{source}: {note}", file=sys.stderr)
    return found


def as_csv(track: Track, start: Pose) -> str:
    """The track as a CSV file has it, the car at `start`."""
    rows = ["tag,x,y,direction,x_variance,y_variance,xy_covariance"]
    for (x, y), color in zip(track.cones_xy_m, track.cone_colors, strict=True):
        rows.append(f"{ConeColor(color).name.lower()},{x:.4f},{y:.4f},0,0.01,0.01,0")
    if track.line_by.endswith(TIMING_POSTS):
        lines = dict.fromkeys(line for line in (track.start_line, track.finish_line) if line is not None)
        posts = (line.ahead(0.0, left_m) for line in lines for left_m in (LANE_M, -LANE_M))
        rows += (f"timekeeping,{x:.4f},{y:.4f},0,0,0,0" for x, y in posts)
    rows.append(f"car_start,{start.x_m:.4f},{start.y_m:.4f},{start.yaw_rad:.6f},0,0,0")
    return "\n".join(rows) + "\n"
