"""Track files, as other simulators have them.

- CSV (EUFS, FSDS): `tag,x,y[,direction,…]`, metres, x forward or east, y left or north. `tag` is blue (left border),
  yellow (right border), orange, big_orange (gates), unknown, or car_start, whose `direction` is the yaw in rad at the
  rear axle.
- YAML of PacSim: `track` with the lists `left`, `right` and `unknown` of `position` and `class`, and the pose `start`
  of the centre of gravity.
- YAML of fssim: lists of points `cones_left`, `cones_right`, `cones_orange`, `cones_orange_big`, and the pose
  `starting_pose_front_wing` or `starting_pose_cg`.

No file holds borders: `walking` finds them.
"""

from __future__ import annotations

import csv
import math
import reprlib
import sys
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from fsai_hil.simulator.car import Pose
from fsai_hil.simulator.tracks.layout import NOSE_M, Point, Track, TrackError, TrackKind, as_array
from fsai_hil.simulator.tracks.walking import measured, staged_before
from fsai_vcu.core.driving import ConeColor
from fsai_vcu.core.vehicle.parameters import ADS_DV_2026

TAGS: Final = {color.name.lower(): color for color in ConeColor}
OTHER_NAMES: Final = {"small_orange": "orange", "orange_big": "big_orange"}
NO_CONES: Final = frozenset({"midpoint", "inactive", "timekeeping", "invisible"})
FURTHEST_M: Final = 10_000.0  # no event's track is as large; degrees times 1e7 or millimetres look like this
LONGEST_WORD: Final = 100  # of a YAML file, in characters
MOST_TAGS: Final = 20  # that are named as skipped
MOST_CONES: Final = 5_000  # the longest tracks have a tenth of it; borders are found in a time that grows faster
FSSIM_LISTS: Final = {
    "cones_left": "blue",
    "cones_right": "yellow",
    "cones_orange": "orange",
    "cones_orange_big": "big_orange",
}
COG_M: Final = ADS_DV_2026.cog_ahead_of_rear_axle_m
FSSIM_STARTS: Final = {"starting_pose_front_wing": NOSE_M, "starting_pose_cg": COG_M}  # ahead of the rear axle, m

Row = tuple[str, str, Sequence[Any]]  # where it stands, the tag, and x, y and perhaps the direction


def parse_track(text: str, source: str) -> Track:
    """The track in a file's text; `source` is what messages call it. What was left out or assumed goes to stderr."""
    yaml = Path(source).suffix.lower() in (".yaml", ".yml")
    points: list[Point] = []
    colors: list[ConeColor] = []
    start: Pose | None = None
    skipped: Counter[str] = Counter()
    for at, tag, values in _yaml_rows(text, source) if yaml else _csv_rows(text, source):
        x, y = _number(values, 0, "x", at), _number(values, 1, "y", at)
        if max(abs(x), abs(y)) > FURTHEST_M:
            raise TrackError(f"{at}: {x:g}, {y:g} is further than {FURTHEST_M:g} m from the origin; are these metres?")
        name = tag.strip().lower().replace("-", "_")
        name = OTHER_NAMES.get(name, name)
        if name == "car_start":
            if start is not None:
                raise TrackError(f"{at}: a second car_start")
            start = Pose(x, y, _number(values, 2, "direction", at) if len(values) > 2 else 0.0)
        elif name in TAGS:
            points.append((x, y))
            colors.append(TAGS[name])
            if len(points) > MOST_CONES:
                raise TrackError(f"{at}: more than {MOST_CONES} cones")
        elif name not in NO_CONES:
            skipped[tag[:LONGEST_WORD] if len(skipped) < MOST_TAGS else "…"] += 1
    for tag, count in skipped.items():
        print(f"{source}: skipped {count} row{'s' * (count > 1)} with tag {tag!r}", file=sys.stderr)
    if not points:
        raise TrackError(f"{source}: no cones")
    colored = np.array(colors, dtype=np.int64)
    track = Track(Path(source).stem, TrackKind.CIRCUIT, as_array(points), colored, car_start=start, source=source)
    if start is not None:
        return measured(track, start)
    placed, where = staged_before(track)
    print(f"{source}: no car_start: the car is staged before the {where}", file=sys.stderr)
    return placed


def _csv_rows(text: str, source: str) -> Iterator[Row]:
    reader = csv.reader(text.splitlines())
    for row in _whole_rows(reader, source):
        if not any(column.strip() for column in row):
            continue
        at, head = f"{source}: line {reader.line_num}", [column.strip() for column in row[:3]]
        if reader.line_num == 1:
            if head == ["tag", "x", "y"]:
                continue
            if head[0] not in TAGS:  # FSDS writes no header
                break
        if len(row) < 3:
            raise TrackError(f"{at}: {len(row)} columns where at least tag, x and y are needed")
        yield at, row[0].strip(), row[1:]
    else:
        if reader.line_num:
            return
    found = text.splitlines()[0][:60] if text.strip() else "nothing"
    raise TrackError(f"{source}: line 1: the header must begin with tag,x,y but is {found!r}")


def _whole_rows(reader: Any, source: str) -> Iterator[list[str]]:
    try:
        yield from reader
    except csv.Error as error:
        raise TrackError(f"{source}: line {reader.line_num}: {error}") from None


def _yaml_rows(text: str, source: str) -> Iterator[Row]:
    try:
        import yaml  # type: ignore[import-untyped]  # optional
    except ImportError:
        raise TrackError(f"{source}: reading YAML needs PyYAML; install it with: pip install pyyaml") from None
    try:
        loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)(text)
        try:
            root = loader.get_single_node()
            _check_plain(root, source)
            found = None if root is None else loader.construct_document(root)
        finally:
            loader.dispose()
        if "track" in found:
            yield from _pacsim_rows(found["track"], source)
        elif "cones_left" in found:
            yield from _fssim_rows(found, source)
        else:
            raise TrackError(f"{source}: neither a track of PacSim (track:) nor one of fssim (cones_left:)")
    except yaml.YAMLError as error:
        raise TrackError(f"{source}: not valid YAML: {' '.join(str(error).split())}") from None
    except RecursionError:
        raise TrackError(f"{source}: its lists are too deep in one another") from None
    except (AttributeError, IndexError, KeyError, TypeError, ValueError) as error:
        if isinstance(error, TrackError):
            raise
        raise TrackError(f"{source}: not laid out as PacSim or fssim have it: {repr(error)[:200]}") from None


def _check_plain(root: Any, source: str) -> None:
    """Raises TrackError for YAML that is larger than its text, by naming what stands elsewhere, or by a long number."""
    seen: set[int] = set()
    waiting = [root]
    while waiting:
        node = waiting.pop()
        content = getattr(node, "value", None)
        at = f"{source}: line {node.start_mark.line + 1}" if node is not None else source
        if isinstance(content, list):
            if id(node) in seen:
                raise TrackError(f"{at}: is named again elsewhere, as no track needs it")
            seen.add(id(node))
            waiting += (each for entry in content for each in (entry if isinstance(entry, tuple) else (entry,)))
        elif isinstance(content, str) and len(content) > LONGEST_WORD:
            raise TrackError(f"{at}: a word of more than {LONGEST_WORD} characters")


def _pacsim_rows(track: Mapping[str, Any], source: str) -> Iterator[Row]:
    for side in ("left", "right", "unknown"):
        for number, cone in enumerate(track.get(side) or (), 1):
            at = f"{source}: {side} {number}"
            if not isinstance(cone["class"], str):
                raise TrackError(f"{at}: class is {_shown(cone['class'])}, not a text")
            yield at, cone["class"], [cone["position"][0], cone["position"][1]]
    if start := track.get("start"):
        pose = [start["position"][0], start["position"][1], start["orientation"][2]]
        yield _staged(pose, COG_M, f"{source}: start")


def _fssim_rows(found: Mapping[str, Any], source: str) -> Iterator[Row]:
    for name, tag in FSSIM_LISTS.items():
        for number, point in enumerate(found.get(name) or (), 1):
            yield f"{source}: {name} {number}", tag, [point[0], point[1]]
    for name, ahead_m in FSSIM_STARTS.items():
        if pose := found.get(name):
            yield _staged(pose, ahead_m, f"{source}: {name}")
            return


def _staged(pose: Sequence[Any], ahead_m: float, at: str) -> Row:
    """The row of a car whose place (x, y, direction) is given so far ahead of its rear axle."""
    x, y, yaw_rad = (_number(pose, column, name, at) for column, name in enumerate(("x", "y", "direction")))
    return at, "car_start", (*Pose(x, y, yaw_rad).ahead(-ahead_m), yaw_rad)


def _number(values: Sequence[Any], column: int, name: str, at: str) -> float:
    given = values[column]
    if isinstance(given, str):
        given = given.strip()
    try:
        value = float(given)
    except (TypeError, ValueError, OverflowError):
        raise TrackError(f"{at}: {name} is {_shown(given)}, not a number") from None
    if not math.isfinite(value):
        raise TrackError(f"{at}: {name} is {value}, not a finite number")
    return value


def _shown(value: object) -> str:
    return reprlib.repr(value)


def as_csv(track: Track, start: Pose) -> str:
    """The track as a CSV file has it, the car at `start`."""
    rows = ["tag,x,y,direction,x_variance,y_variance,xy_covariance"]
    for (x, y), color in zip(track.cones_xy_m, track.cone_colors, strict=True):
        rows.append(f"{ConeColor(color).name.lower()},{x:.4f},{y:.4f},0,0.01,0.01,0")
    rows.append(f"car_start,{start.x_m:.4f},{start.y_m:.4f},{start.yaw_rad:.6f},0,0,0")
    return "\n".join(rows) + "\n"
