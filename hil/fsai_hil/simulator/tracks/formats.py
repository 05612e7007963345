"""The formats of track files: how each is recognised by its content, and what reads it.

A new format is one row of FORMATS, with its reader above it. A reader yields rows: where each stands, its tag, and x, y
and perhaps the direction, in metres and rad, x forward or east, y left or north. Tags: blue (left border), yellow
(right border), orange, big_orange (gates), unknown; car_start, with the yaw at the rear axle; timekeeping, a post of
the timing.
"""

from __future__ import annotations

import csv
import json
import math
import reprlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from fsai_hil.simulator.car import Pose
from fsai_hil.simulator.tracks.layout import LANE_M, NOSE_M, TrackError
from fsai_vcu.core.vehicle.parameters import ADS_DV_2026
from fsai_vcu.files import TRACK_BYTES, read_named

LONGEST_WORD: Final = 100  # of a YAML file, in characters
COG_M: Final = ADS_DV_2026.cog_ahead_of_rear_axle_m
FSSIM_LISTS: Final = {
    "cones_left": "blue",
    "cones_right": "yellow",
    "cones_orange": "orange",
    "cones_orange_big": "big_orange",
    "tk_device": "timekeeping",
}
FSSIM_STARTS: Final = {"starting_pose_front_wing": NOSE_M, "starting_pose_cg": COG_M}  # ahead of the rear axle, m
LAYOUT_MERCHANT_COLORS: Final = ("unknown", "yellow", "blue", "orange", "big_orange")
BOUNDARIES, CONE_MAP = "boundaries", "cone_map"  # in the names of StarkStrom's two files of a track
FIRST_TAGS: Final = ("blue", "yellow", "orange", "big_orange", "unknown", "car_start")  # first of a table, no header

Row = tuple[str, str, Sequence[Any]]
Told = Callable[[str], None]  # takes what a person should know of the file


@dataclass(frozen=True, slots=True)
class Format:
    """One format: a table, told by the first columns of its header, or a mapping in JSON or YAML, told by its keys."""

    name: str
    header: tuple[str, ...] = ()
    keys: tuple[str, ...] = ()
    rows: Callable[[Mapping[Any, Any], str], Iterator[Row]] | None = (
        None  # of a mapping and what messages call the file
    )


# ---------------------------------------------------------------- mappings


def _pacsim_rows(found: Mapping[Any, Any], source: str) -> Iterator[Row]:
    """PacSim: cones by side with their class, the pose of the centre of gravity, and the posts of the timing."""
    track = found["track"]
    for side in ("left", "right", "unknown"):
        for number, cone in enumerate(_list_in(track, side, f"{source}: track"), 1):
            at = f"{source}: {side} {number}"
            tag = _entry(cone, "class", at)
            if not isinstance(tag, str):
                raise TrackError(f"{at}: class is {shown(tag)}, not a text")
            yield at, tag, _numbers(_entry(cone, "position", at), 2, f"{at}: position")
    for number, post in enumerate(_list_in(track, "time_keeping", f"{source}: track"), 1):
        at = f"{source}: time_keeping {number}"
        yield at, "timekeeping", _numbers(_entry(post, "position", at), 2, f"{at}: position")
    if start := track.get("start"):
        at = f"{source}: start"
        place, turn = (
            _numbers(_entry(start, name, at), count, f"{at}: {name}")
            for name, count in (("position", 2), ("orientation", 3))
        )
        yield _staged([*place, turn[2]], COG_M, at)


def _fssim_rows(found: Mapping[Any, Any], source: str) -> Iterator[Row]:
    """fssim: lists of points by colour, and a pose of the front wing or of the centre of gravity."""
    for name, tag in FSSIM_LISTS.items():
        for number, point in enumerate(_list_in(found, name, source), 1):
            at = f"{source}: {name} {number}"
            yield at, tag, _numbers(point, 2, at)
    for name, ahead_m in FSSIM_STARTS.items():
        if pose := found.get(name):
            at = f"{source}: {name}"
            yield _staged(_numbers(pose, 3, at), ahead_m, at)
            return


def _layout_merchant_rows(found: Mapping[Any, Any], source: str) -> Iterator[Row]:
    """layout-merchant: columns of cones with the number of their colour; start and timing line, angles in degrees."""
    columns = [_list_in(found, name, source) for name in ("x", "y", "color")]
    if len({len(column) for column in columns}) > 1:
        raise TrackError(f"{source}: x, y and color have {', '.join(str(len(column)) for column in columns)} entries")
    for number, (x, y, color) in enumerate(zip(*columns, strict=True), 1):
        at = f"{source}: cone {number}"
        if color not in range(len(LAYOUT_MERCHANT_COLORS)):
            raise TrackError(f"{at}: color is {shown(color)}, not 0 to {len(LAYOUT_MERCHANT_COLORS) - 1}")
        yield at, LAYOUT_MERCHANT_COLORS[int(color)], [x, y]
    if "start_position" in found:
        yield f"{source}: start", "car_start", _turned(found, "start", source)
    if "timing_line_position" in found:
        x, y, yaw_rad = _turned(found, "timing_line", source)
        half_m = number_of([found.get("timing_line_width", LANE_M)], 0, "timing_line_width", source) / 2.0
        for side in (half_m, -half_m):
            yield f"{source}: timing_line", "timekeeping", Pose(x, y, yaw_rad).ahead(0.0, side)


def _turned(found: Mapping[Any, Any], name: str, source: str) -> tuple[float, float, float]:
    """x, y and the direction in rad of what a file has as a position, and an orientation in degrees."""
    at = f"{source}: {name}"
    given = [*_numbers(found[f"{name}_position"], 2, f"{at}: position"), found.get(f"{name}_orientation", 0.0)]
    x, y, deg = (number_of(given, i, what, at) for i, what in enumerate(("x", "y", "orientation")))
    return x, y, math.radians(math.remainder(deg, 360.0))


def _starkstrom_rows(found: Mapping[Any, Any], source: str) -> Iterator[Row]:
    """StarkStrom: the numbers of the cones along each border; where they are stands in a file beside."""
    path = Path(source)
    if BOUNDARIES not in path.name:
        raise TrackError(
            f"{source}: borders by the numbers of cones, but not named {BOUNDARIES}_N.yaml beside {CONE_MAP}_N.yaml"
        )
    beside = path.with_name(path.name.replace(BOUNDARIES, CONE_MAP))
    cones = _beside(beside, source)
    for side, tag in (("left", "blue"), ("right", "yellow")):
        for number in _list_in(found, side, source):
            if type(number) is not int or number not in cones:
                raise TrackError(f"{source}: {side}: cone {shown(number)} is not in {beside.name}")
            at = f"{beside}: {number}"
            yield at, tag, _numbers(cones[number], 2, at)


def _starkstrom_map_rows(_: Mapping[Any, Any], source: str) -> Iterator[Row]:
    """StarkStrom: where each cone is by its number; which of them make a border stands in a file beside."""
    path = Path(source)
    if CONE_MAP not in path.name:
        raise TrackError(f"{source}: cones by number, but not named {CONE_MAP}_N.yaml beside {BOUNDARIES}_N.yaml")
    beside = path.with_name(path.name.replace(CONE_MAP, BOUNDARIES))
    yield from _starkstrom_rows(_beside(beside, source), str(beside))


def _beside(path: Path, source: str) -> Mapping[Any, Any]:
    """The mapping in the other file of a track."""
    try:
        found = _yaml_of(read_named(path, TRACK_BYTES, "utf-8-sig"), str(path))
    except (OSError, UnicodeDecodeError) as error:
        why = getattr(error, "strerror", None) or "not a text file"
        raise TrackError(f"{source}: {path.name}, which belongs to it, cannot be read: {why}") from None
    if not isinstance(found, Mapping):
        raise TrackError(f"{path}: not laid out as YAML of StarkStrom is")
    return found


def _staged(pose: Sequence[Any], ahead_m: float, at: str) -> Row:
    """The row of a car whose place (x, y, direction) is given so far ahead of its rear axle."""
    x, y, yaw_rad = (number_of(pose, column, name, at) for column, name in enumerate(("x", "y", "direction")))
    return at, "car_start", (*Pose(x, y, yaw_rad).ahead(-ahead_m), yaw_rad)


# ---------------------------------------------------------------- the table

EUFS: Final = Format("CSV of EUFS and FSDS", header=("tag", "x", "y"))
FORMATS: Final = (
    EUFS,
    Format("CSV of EPFL", header=("cone_type", "x", "y")),
    Format("YAML of PacSim", keys=("track",), rows=_pacsim_rows),
    Format("YAML of fssim", keys=("cones_left",), rows=_fssim_rows),
    Format("JSON of layout-merchant", keys=("x", "y", "color"), rows=_layout_merchant_rows),
    Format("YAML of StarkStrom", keys=("left", "right"), rows=_starkstrom_rows),
)
FILES: Final = ", ".join(each.name for each in FORMATS)
CONES_BY_NUMBER: Final = Format("YAML of StarkStrom", rows=_starkstrom_map_rows)  # its keys are the cones' numbers


def rows_of(text: str, source: str, told: Told) -> Iterator[Row]:
    """The rows of a file's text. `told` takes what a person should know. Raises TrackError."""
    suffix = Path(source).suffix.lower()
    if suffix in (".yaml", ".yml"):
        return _mapping_rows(_yaml_of, text, source)
    if suffix == ".json" or text.lstrip().startswith("{"):
        return _mapping_rows(_json_of, text, source)
    return _table_rows(text, source, told)


def _mapping_rows(read: Callable[[str, str], Any], text: str, source: str) -> Iterator[Row]:
    """Yield the rows of a file that is a mapping, by the format whose keys it has."""
    form: Format | None = None
    try:
        found = read(text, source)
        if isinstance(found, Mapping):
            form = next((each for each in FORMATS if each.keys and all(key in found for key in each.keys)), None)
            if form is None and found and all(type(key) is int for key in found):
                form = CONES_BY_NUMBER
        if form is None or form.rows is None:
            known = [f"{each.name} ({', '.join(each.keys)})" for each in FORMATS if each.keys]
            raise TrackError(f"{source}: neither {', '.join(known[:-1])} nor {known[-1]}")
        yield from form.rows(found, source)
    except RecursionError:
        raise TrackError(f"{source}: its lists are too deep in one another") from None
    except (AttributeError, IndexError, KeyError, TypeError, ValueError) as error:
        if isinstance(error, TrackError) or form is None:
            raise
        raise TrackError(f"{source}: not laid out as {form.name} is: {repr(error)[:200]}") from None


def _json_of(text: str, source: str) -> Any:
    try:
        return json.loads(text)
    except ValueError as error:
        raise TrackError(f"{source}: not valid JSON: {str(error)[:200]}") from None


def _yaml_of(text: str, source: str) -> Any:
    """Return what a YAML file holds; raises TrackError where it is no plain data."""
    try:
        import yaml  # type: ignore[import-untyped]  # optional
    except ImportError:
        raise TrackError(f"{source}: reading YAML needs PyYAML; install it with: pip install pyyaml") from None
    try:
        loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)(text)
        try:
            root = loader.get_single_node()
            _check_plain(root, source)
            return None if root is None else loader.construct_document(root)
        finally:
            loader.dispose()
    except yaml.YAMLError as error:
        mark, *words = (getattr(error, name, None) for name in ("problem_mark", "context", "problem"))
        at = f"{source}: line {mark.line + 1}" if mark is not None else source
        why = " ".join(filter(None, words)) or str(error)
        raise TrackError(f"{at}: not valid YAML: {' '.join(why.split())}") from None
    except TrackError:
        raise
    except (AttributeError, KeyError, TypeError, ValueError) as error:  # of a value that its tag does not fit
        raise TrackError(f"{source}: not valid YAML: {repr(error)[:200]}") from None


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


# ---------------------------------------------------------------- tables


def _table_rows(text: str, source: str, told: Told) -> Iterator[Row]:
    """Yield the rows of a table, by the format that its header names or its columns show."""
    reader = csv.reader(text.splitlines())
    form: Format | None = None
    columns: tuple[int, ...] = (1, 2, 3)  # that hold x, y and perhaps the direction
    at, first = f"{source}: line 1", "nothing"
    for row in _whole_rows(reader, source):
        names = [column.strip().lower() for column in row]
        if not any(names) or names[0].startswith("#"):
            continue
        at = f"{source}: line {reader.line_num}"
        named = next((each for each in FORMATS if each.header and each.header == tuple(names[:3])), None)
        if named is not None:
            if form is not None:
                told(f"line {reader.line_num} is a second header: what follows it is taken as part of the same track")
            form = named
            columns = (1, 2, names.index("direction")) if "direction" in names else (1, 2)
            continue
        if form is None:
            if names[0] not in FIRST_TAGS:  # FSDS's has no header
                first = repr(text.splitlines()[reader.line_num - 1][:60])
                break
            form = EUFS
        if len(row) < 3:
            count = f"{len(row)} column{'s' * (len(row) > 1)}"
            raise TrackError(f"{at}: {count} where at least {', '.join(form.header)} are needed")
        yield at, row[0].strip(), [row[column] for column in columns if column < len(row)]
    else:
        if form is not None:
            return
    known = " or ".join(f"{','.join(each.header)} ({each.name})" for each in FORMATS if each.header)
    raise TrackError(f"{at}: the header must begin with {known} but is {first}")


def _whole_rows(reader: Any, source: str) -> Iterator[list[str]]:
    try:
        yield from reader
    except csv.Error as error:
        raise TrackError(f"{source}: line {reader.line_num}: {error}") from None


# ---------------------------------------------------------------- values


def number_of(values: Sequence[Any], column: int, name: str, at: str) -> float:
    """The finite number in a column; raises TrackError."""
    given = values[column]
    if isinstance(given, str):
        given = given.strip()
    try:
        value = float(given)
    except (TypeError, ValueError, OverflowError):
        raise TrackError(f"{at}: {name} is {shown(given)}, not a number") from None
    if not math.isfinite(value):
        raise TrackError(f"{at}: {name} is {value}, not a finite number")
    return value


def shown(value: object) -> str:
    """A value from a file, cut to a length that a message can have."""
    return "nothing" if value is None else reprlib.repr(value)


def _entry(found: object, key: str, at: str) -> Any:
    """The value that a mapping has under a key; raises TrackError."""
    if not isinstance(found, Mapping):
        raise TrackError(f"{at} is {shown(found)}, not a mapping")
    if key not in found:
        raise TrackError(f"{at}: has no {key}")
    return found[key]


def _list_in(found: object, key: str, at: str) -> Sequence[Any]:
    """The list that a mapping has under a key, an empty one where there is none; raises TrackError."""
    if not isinstance(found, Mapping):
        raise TrackError(f"{at} is {shown(found)}, not a mapping")
    given = found.get(key)
    if given is not None and not isinstance(given, list):
        raise TrackError(f"{at}: {key} is {shown(given)}, not a list")
    return given or ()


def _numbers(given: object, count: int, at: str) -> Sequence[Any]:
    """The first so many entries of a list; raises TrackError where it has fewer."""
    if not isinstance(given, list) or len(given) < count:
        raise TrackError(f"{at} is {shown(given)}, not a list of {count} numbers")
    return given[:count]
