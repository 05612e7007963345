"""Kind, line, start and borders of a track, from the cones of a file.

The line is at the posts of the file's timing; else at its gate of big orange cones; on a circuit else at one of small
ones; else where the planner lays it, so far ahead of the staged car. That of a skidpad is between its two rings. The
car is staged at the file's car_start where its nose stands before the line there, else as the rules stage it. The
borders are found by walking the lane.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Sequence
from itertools import combinations, groupby
from typing import Final

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from fsai_hil.simulator.car import Pose
from fsai_hil.simulator.tracks.built_in import skidpad_track
from fsai_hil.simulator.tracks.layout import (
    BETWEEN_RINGS,
    LANE_M,
    NOSE_M,
    SKIDPAD_CENTRES_APART_M,
    SKIDPAD_INNER_DIAMETER_M,
    STAGED_BEFORE_LINE_M,
    TIMING_POSTS,
    Point,
    Track,
    TrackError,
    TrackKind,
    as_array,
    smoothed,
    with_circuit,
    with_line,
    with_straight,
)
from fsai_vcu.core.arrays import Floats, Ints
from fsai_vcu.core.driving import ConeColor, Motion
from fsai_vcu.core.missions.laps import GATE_DEPTH_M, gate_middle, staged
from fsai_vcu.core.planning.pose import resampled_ring
from fsai_vcu.interface.enums import Ami

GATE_M, POSTS_M = 8.0, 15.0  # no two cones, no two posts of one line stand further apart, be it across the lane
STRAIGHT_M, STRAIGHT_SHARE = 1.0, 0.8  # so near its borders are so many of the cones beside a straight
ASTRAY_RAD, BACKWARDS_RAD = math.radians(60.0), math.radians(120.0)  # a car points out of its lane, or the other way
ACROSS_M = 15.0  # no two cones across the lane stand further apart
OFF_LANE_M = 6.0  # further from the lane's middle, what is between them is no line of it
TOUCHING_M = 0.05  # a nose so near before the line is not before it
UNSEEN_OFF_M = 1.5  # from where the rules stage it, a car at a line that no gate shows may stand further or less far
BEFORE_M: Final = STAGED_BEFORE_LINE_M[Ami.AUTOCROSS] + NOSE_M  # where the rules stage the rear axle on a circuit
GATE_BEHIND_M: Final = 15.0  # further behind the car, a gate is not the one that it stands at
GATE_CONES: Final = "big orange cones"
SMALL_GATE_CONES: Final = "small orange cones, as no big ones and no timing posts mark it"
UNMARKED: Final = f"{BEFORE_M:.1f} m ahead of where the car starts, as no gate and no timing posts mark it"
FIRST_PAIR: Final = "its first pair of cones, as no gate and no timing posts mark it"
RING_M: Final = SKIDPAD_INNER_DIAMETER_M / 2.0
# A ring of a skidpad: its neighbours at most so far apart, its cones so near its circle, its radius and the distance
# of the two so near to the rules', no part of it without cones wider than that.
RING_NEXT_M, RING_NEAR_M, RING_WRONG_M, RINGS_WRONG_M, RING_GAP_RAD = 6.5, 0.5, 0.6, 1.0, math.radians(80.0)
RING_CONES, RING_GUESSES = 6, 20_000  # fewer make no ring; more guesses than a skidpad gives are of no skidpad

Places = NDArray[np.complex128]
Told = Callable[[str], None]  # takes what a person should know of the file


def laid_out(track: Track, start: Pose | None, posts_m: Floats, told: Told) -> Track:
    """The track with its kind, lines and borders, and where the car is staged.

    `start` is the file's car_start, `posts_m` (N, 2) are its timing posts. Raises TrackError where nobody knows which
    way the car goes.
    """
    found = _laid_out(track, start, posts_m, told)
    given = None if start is None else (start.x_m, start.y_m)
    if found.car_start is not None and (found.car_start.x_m, found.car_start.y_m) == given:
        _tell_of_start(found, found.car_start, told)
    return found


def _laid_out(track: Track, start: Pose | None, posts_m: Floats, told: Told) -> Track:
    if (middle := _between_rings(track.cones_xy_m)) is not None:
        return _with_skidpad(track, middle, start, told)
    gates, small_gates = (
        _groups(track.cones_xy_m[track.cone_colors == color], GATE_M)
        for color in (ConeColor.BIG_ORANGE, ConeColor.ORANGE)
    )
    posts = [group for group in _groups(posts_m, POSTS_M) if len(group) > 1]
    if alone := len(posts_m) - sum(map(len, posts)):
        told(f"{alone} of its timing posts stand{'s' * (alone == 1)} alone: one post marks no line")
    axis = start if start is not None else _beginning(track, posts or gates)
    if start is None:
        told("no car_start: the car is staged before the line")
    if start is None:
        walked = _walked(track, axis)
    else:
        walked, start = _walked_from(track, start, told)
        axis = start
    if walked is not None:
        return _with_circuit(track, walked, axis, start, (posts, gates, small_gates), told)
    lines = posts if len(posts) >= 2 else gates
    if len(lines) >= 2:
        first, *_, last = sorted(lines, key=lambda group: math.hypot(*axis.seen(*group.mean(axis=0))))
        line = _across(first, axis)
        straight = _with_straight(track, line, last.mean(axis=0).tolist())
        if straight is not None:
            return replace(
                _started(straight, start, told), line_by=_marks(first, TIMING_POSTS if lines is posts else GATE_CONES)
            )
    # Cones that make no circuit which can be walked.
    told(
        f"its cones make no closed lane{' ahead of car_start' * (start is not None)}: "
        "laps are counted at the line alone, and nothing is off course"
    )
    ahead = [group for group in posts or gates if axis.seen(*group.T)[0].max() > 0.0]
    if ahead:
        group = min(ahead, key=lambda each: math.hypot(*axis.seen(*each.mean(axis=0))))
        return _started(
            with_line(track, _across(group, axis), _marks(group, TIMING_POSTS if posts else GATE_CONES)), start, told
        )
    line, by = (_staged_line(start), UNMARKED) if start is not None else (axis, FIRST_PAIR)
    return replace(with_line(track, line, by), car_start=start)


def _with_straight(track: Track, line: Pose, finish: Point) -> Track | None:
    """The track with the straight from a line to the finish; None where the cones beside the way make no straight."""
    from_xy = line.x_m, line.y_m
    axis = Pose(*from_xy, math.atan2(finish[1] - from_xy[1], finish[0] - from_xy[0]))
    ahead_m, left_m = axis.seen(*track.cones_xy_m.T)
    beside_m = np.abs(left_m[(ahead_m > 0.0) & (ahead_m < math.dist(from_xy, finish))])
    half_m = float(np.median(beside_m)) if len(beside_m) else LANE_M / 2.0
    if np.count_nonzero(np.abs(beside_m - half_m) < STRAIGHT_M) < STRAIGHT_SHARE * len(beside_m):
        return None
    return with_straight(replace(track, kind=TrackKind.ACCELERATION), from_xy, finish, half_m)


def _walked_from(track: Track, start: Pose, told: Told) -> tuple[tuple[Floats, Floats, Floats] | None, Pose]:
    """The lane walked from car_start, and where the car stands: turned into the lane where it points across it."""
    walked, into = _walked(track, start), _into_the_lane(track, start)
    if into is None:
        return walked, start
    walked = walked or _walked(track, into)
    if walked is None:
        return None, start
    middle = smoothed(resampled_ring(walked[2], 0.25), 2.0)
    there = _at(middle, _on(middle, start.x_m, start.y_m))
    yaw_rad = math.remainder(there.yaw_rad if _left_of(there, walked[0]) else there.yaw_rad + math.pi, 2.0 * math.pi)
    off_rad = abs(math.remainder(start.yaw_rad - yaw_rad, 2.0 * math.pi))
    if off_rad > BACKWARDS_RAD:  # the lane may be driven so
        return walked, start
    turned = _turned_into(start, yaw_rad, told)
    return _walked(track, turned) or walked, turned


def _turned_into(start: Pose, yaw_rad: float, told: Told) -> Pose:
    """The car_start, turned into a lane of that direction where it points out of it."""
    off_rad = abs(math.remainder(start.yaw_rad - yaw_rad, 2.0 * math.pi))
    if off_rad <= ASTRAY_RAD:
        return start
    told(f"car_start points {math.degrees(off_rad):.0f} deg out of the lane: the car is turned into it")
    return Pose(start.x_m, start.y_m, yaw_rad)


def _into_the_lane(track: Track, start: Pose) -> Pose | None:
    """The start, turned so that blue cones are left and yellow ones right of it; None away from such cones."""
    at = np.array((start.x_m, start.y_m))
    blue, yellow = (
        _nearest(track.cones_xy_m[track.cone_colors == color], at)[:2] for color in (ConeColor.BLUE, ConeColor.YELLOW)
    )
    if any(len(side) == 0 or math.dist(side[0], at) > ACROSS_M for side in (blue, yellow)):
        return None
    x, y = blue.mean(axis=0) - yellow.mean(axis=0)
    return Pose(start.x_m, start.y_m, math.atan2(y, x) - math.pi / 2.0)


def _spans(group: Floats, there: Pose) -> bool:
    """Return whether cones stand on both sides of a place on the lane, and no further along it than those of a gate."""
    ahead_m, left_m = there.seen(*group.T)
    return bool(left_m.min() < 0.0 < left_m.max() and np.ptp(ahead_m) < GATE_DEPTH_M)


def _left_of(there: Pose, border: Floats) -> bool:
    """Return whether a border is left of a place on the lane and its direction there."""
    return bool(there.seen(*border[_on(border, there.x_m, there.y_m)])[1] > 0.0)


def _tell_of_start(track: Track, start: Pose, told: Told) -> None:
    """Tell where the car stands as the file has it, if that is away from the cones or out of the lane."""
    away_m = float(np.hypot(*(track.cones_xy_m - (start.x_m, start.y_m)).T).min())
    if away_m > ACROSS_M:
        told(f"car_start is {away_m:.0f} m from the nearest cone")
    elif not track.on_lane(start.x_m, start.y_m):
        told("car_start is not between the borders")


def _marks(group: Floats, what: str) -> str:
    """The mark of a line, in words."""
    count = len(group)
    return f"{count} {what}" if what == TIMING_POSTS else f"its gate of {count} {what if count > 1 else what[:-1]}"


def _started(track: Track, start: Pose | None, told: Told) -> Track:
    """The track with the car at the file's car_start, if its nose is before the line there."""
    line = track.start_line
    assert line is not None  # callers have laid it
    if start is not None:
        start = _turned_into(start, line.yaw_rad, told)
    past_m = -math.inf if start is None else float(line.seen(*start.ahead(NOSE_M))[0])
    if past_m <= -TOUCHING_M:
        return replace(track, car_start=start)
    told(f"{_before_or_past(past_m)}: the car is staged as the rules have it")
    return track


def _before_or_past(past_m: float) -> str:
    """The place of the car's nose at car_start, in words."""
    side = "past" if past_m > 0.0 else "before"
    where = "on the line" if abs(past_m) <= TOUCHING_M else f"{abs(past_m):.1f} m {side} the line"
    return f"car_start has the car's nose {where}"


def _beginning(track: Track, lines: Sequence[Floats]) -> Pose:
    """The lane's beginning in a file that does not say where the car starts: the first line, else the first cones."""
    blue, yellow = (track.cones_xy_m[track.cone_colors == color] for color in (ConeColor.BLUE, ConeColor.YELLOW))
    if min(len(blue), len(yellow)) == 0:
        raise TrackError(f"{track.source}: no car_start, so nobody knows where the car begins and which way it points")
    at = (lines[0] if lines else np.stack((blue[0], _nearest(yellow, blue[0])[0]))).mean(axis=0)
    x, y = _nearest(blue, at)[:2].mean(axis=0) - _nearest(yellow, at)[:2].mean(axis=0)
    axis = Pose(float(at[0]), float(at[1]), math.atan2(y, x) - math.pi / 2.0)
    # Of several lines the first one.
    return _across(_first(lines, axis), axis) if lines else axis


def _first(lines: Sequence[Floats], axis: Pose) -> Floats:
    """The line that comes first along the axis."""
    return min(lines, key=lambda group: float(axis.seen(*group.mean(axis=0))[0]))


def _nearest(cones: Floats, at: Floats) -> Floats:
    """The cones, those nearest to a point first."""
    return np.asarray(cones[np.argsort(np.hypot(*(cones - at).T))])


def _groups(places: Floats, within_m: float) -> list[Floats]:
    """The places (N, 2) in groups, in each of which everyone has another within that distance."""
    groups: list[Floats] = []
    rest = places
    while len(rest):
        group, waiting, rest = [rest[0]], [rest[0]], rest[1:]
        while waiting and len(rest):
            near = np.hypot(*(rest - waiting.pop()).T) <= within_m
            group += list(rest[near])
            waiting += list(rest[near])
            rest = rest[~near]
        groups.append(np.array(group))
    return groups


def _at(middle: Floats, index: int) -> Pose:
    """A point of a closed line, and its direction there."""
    count = len(middle)
    toward = middle[(index + 2) % count] - middle[(index - 2) % count]
    return Pose(float(middle[index, 0]), float(middle[index, 1]), math.atan2(toward[1], toward[0]))


def _on(middle: Floats, x_m: float, y_m: float) -> int:
    """The nearest point of a closed line."""
    return int(np.argmin(np.hypot(middle[:, 0] - x_m, middle[:, 1] - y_m)))


def _staged_line(start: Pose) -> Pose:
    """The line that the planner lays for a staged car that sees no gate."""
    line = staged(Motion(x_m=start.x_m, y_m=start.y_m, yaw_rad=start.yaw_rad), BEFORE_M).line
    return Pose(line.x_m, line.y_m, line.yaw_rad)


def _across(gate: Floats, axis: Pose) -> Pose:
    """The middle between a gate's left and its right cones, in the direction of the axis."""
    x, y = gate_middle(gate, axis.seen(*gate.T)[1] > 0.0).tolist()
    return Pose(x, y, axis.yaw_rad)


# ---------------------------------------------------------------- circuits


def _with_circuit(
    track: Track,
    walked: tuple[Floats, Floats, Floats],
    axis: Pose,
    start: Pose | None,
    lines: tuple[Sequence[Floats], Sequence[Floats], Sequence[Floats]],
    told: Told,
) -> Track:
    """The track with the lane that was walked. `lines`: groups of timing posts, of big and of small orange cones."""
    left, right, middle = walked
    middle = smoothed(resampled_ring(middle, 0.25), 2.0)
    count = len(middle)
    nose = _on(middle, *(axis if start is None else Pose(*start.ahead(NOSE_M))).ahead(0.0))
    found: list[tuple[Pose, str]] = []
    for groups, what in zip(lines, (TIMING_POSTS, GATE_CONES, SMALL_GATE_CONES), strict=True):
        small = what == SMALL_GATE_CONES
        of_lane: list[tuple[int, Floats]] = []  # how many points from the nose, either way
        for group in groups:
            x, y = group.mean(axis=0).tolist()
            at = _on(middle, x, y)
            if math.dist(middle[at], (x, y)) < OFF_LANE_M and not (
                small and (found or not _spans(group, _at(middle, at)))
            ):
                steps = abs(at - nose)
                of_lane.append((min(steps, count - steps), group))
        if of_lane:
            group = min(of_lane, key=lambda each: each[0])[1]
            there = _at(middle, _on(middle, *group.mean(axis=0).tolist()))
            found.append((_across(group, there), _marks(group, what)))
        elif groups and not small:
            told(f"its {what} stand more than {OFF_LANE_M:g} m from the middle of the lane: they mark no line")
    if not found:
        found = [(axis, FIRST_PAIR)] if start is None else [(_staged_line(start), UNMARKED)]
    apart_m = math.dist(*((line.x_m, line.y_m) for line, _ in found[:2])) if len(found) > 1 else 0.0
    if apart_m > GATE_DEPTH_M:
        told(f"its timing posts stand {apart_m:.1f} m from its gate: laps are judged at the posts, a car sees the gate")
    line, by = found[0]
    index = _on(middle, line.x_m, line.y_m)
    middle = np.roll(middle, -index, axis=0)
    there = _at(middle, 0)  # the line is across the lane, and as far along it as its mark
    line = Pose(*there.ahead(float(there.seen(line.x_m, line.y_m)[0])), there.yaw_rad)
    if not _left_of(there, left):
        told("its blue cones stand right of the car's way: by the rules they are its left border")
    track = with_circuit(track, line, middle, left, right, by)
    assert track.start_line is not None  # with_circuit has laid it
    step_m = track.length_m / count
    past_m = ((nose - index + count // 2) % count - count // 2) * step_m
    if start is not None and abs(past_m) < BEFORE_M:  # more exactly than by points of the line
        past_m = float(track.start_line.seen(*start.ahead(NOSE_M))[0])
    staged_m = STAGED_BEFORE_LINE_M[Ami.AUTOCROSS]
    # A planner takes a line that no big orange cones show to be where the rules have it.
    unseen = len(found) == 1 and by.endswith((TIMING_POSTS, SMALL_GATE_CONES))
    if start is not None and past_m <= -TOUCHING_M and not (unseen and abs(past_m + staged_m) > UNSEEN_OFF_M):
        return replace(track, car_start=start)
    if start is not None:
        seen = "" if past_m > -TOUCHING_M else ", which no gate shows to the car"
        told(f"{_before_or_past(past_m)}{seen}: the car is staged {staged_m:g} m before it")
    return replace(track, car_start=_at(middle, -round(BEFORE_M / step_m)))


def _walked(track: Track, axis: Pose) -> tuple[Floats, Floats, Floats] | None:
    """Left border, right border and the middle between them, as `_walk` finds them from the axis on.

    The cones of a gate are of the side of the lane on which they stand, as the lane without them shows it: it may be
    round a bend. Where there is no lane without them, the axis shows it.
    """
    xy, colors = track.cones_xy_m, track.cone_colors
    sides = (colors == ConeColor.BLUE).astype(int) - (colors == ConeColor.YELLOW)
    gate = np.flatnonzero(colors == ConeColor.BIG_ORANGE)
    alone = _walk(xy, sides, axis)
    if not len(gate):
        return alone
    if alone is None:
        ahead_m, left_m = axis.seen(*xy[gate].T)
        sides[gate] = np.where(ahead_m > -GATE_BEHIND_M, np.where(left_m > 0.0, 1, -1), 0)
        return _walk(xy, sides, axis)
    middle = resampled_ring(alone[2], 0.25)
    for cone in gate:
        x, y = xy[cone].tolist()
        there = _on(middle, x, y)
        if math.dist(middle[there], (x, y)) < OFF_LANE_M:
            sides[cone] = 1 if _at(middle, there).seen(x, y)[1] > 0.0 else -1
    return _walk(xy, sides, axis) or alone


# ---------------------------------------------------------------- skidpads


def _between_rings(xy_m: Floats) -> Pose | None:
    """The middle between a skidpad's two inner rings, square to them, whatever their colours; None without any."""
    best: tuple[float, complex, complex] | None = None
    for one, other in combinations(_ring_centres(xy_m), 2):
        wrong_m = abs(abs(one - other) - SKIDPAD_CENTRES_APART_M)
        if wrong_m < RINGS_WRONG_M and (best is None or wrong_m < best[0]):
            best = wrong_m, one, other
    if best is None:
        return None
    _, one, other = best
    middle, toward = (one + other) / 2.0, other - one
    return Pose(middle.real, middle.imag, math.atan2(toward.imag, toward.real) - math.pi / 2.0)


def _ring_centres(xy_m: Floats) -> list[complex]:
    """The middles of rings of cones (N, 2) that are as wide as a skidpad's inner ones and go all the way round.

    Two neighbours of a ring leave two places for its middle; where it is, many more cones are as far away.
    """
    at: Places = xy_m @ np.array((1.0, 1j))
    if len(at) * len(at) > RING_GUESSES * 50:
        return []
    apart = np.abs(at[:, None] - at)
    one, other = ((apart > 0.5) & (apart < RING_NEXT_M)).nonzero()
    if len(one) > RING_GUESSES:
        return []
    chord = at[other] - at[one]
    half = np.abs(chord) / 2.0
    guesses = (at[one] + at[other]) / 2.0 + 0.5j * chord / half * np.sqrt(RING_M**2 - half**2)
    votes = np.array([np.count_nonzero(np.abs(np.abs(at - guess) - RING_M) < RING_NEAR_M) for guess in guesses])
    found: list[complex] = []
    for guess in guesses[np.argsort(-votes, kind="stable")][: np.count_nonzero(votes >= RING_CONES)]:
        if any(abs(guess - centre) < RING_M for centre in found):
            continue
        fitted = _circle(at, complex(guess))
        if fitted is not None:
            found.append(fitted)
    return found


def _circle(at: Places, centre: complex) -> complex | None:
    """The middle of the ring around a guess of it; None where its cones make no whole ring of a skidpad's size."""
    radius_m = RING_M
    for _ in range(3):
        on = at[np.abs(np.abs(at - centre) - radius_m) < RING_NEAR_M]
        if len(on) < RING_CONES:
            return None
        rows = np.column_stack((2.0 * on.real, 2.0 * on.imag, np.ones(len(on))))
        (x, y, rest), *_ = np.linalg.lstsq(rows, np.abs(on) ** 2, rcond=None)
        centre, radius_m = complex(x, y), math.sqrt(max(0.0, rest + x * x + y * y))
    angles = np.sort(np.angle(on - centre))
    gap = np.diff(angles, append=angles[0] + 2.0 * math.pi).max()
    return centre if abs(radius_m - RING_M) < RING_WRONG_M and gap < RING_GAP_RAD else None


def _with_skidpad(track: Track, middle: Pose, start: Pose | None, told: Told) -> Track:
    """The rules' skidpad, laid over the cones of a file."""
    if start is None:
        told("no car_start: the car is staged before the rings")
    way_in = _way_in(track, middle) if start is None else math.cos(start.yaw_rad - middle.yaw_rad)
    if start is not None and abs(way_in) < math.cos(ASTRAY_RAD):  # it comes in from where it stands
        way_in = -float(middle.seen(start.x_m, start.y_m)[0])
    origin = middle if way_in > 0.0 else Pose(middle.x_m, middle.y_m, middle.yaw_rad + math.pi)
    origin = Pose(origin.x_m, origin.y_m, math.remainder(origin.yaw_rad, 2.0 * math.pi))
    ideal = skidpad_track()
    assert ideal.centreline_m is not None  # skidpad_track always has one
    route = as_array([origin.ahead(float(x), float(y)) for x, y in ideal.centreline_m])
    lane = tuple(tuple(tuple(origin.ahead(x, y) for x, y in ring) for ring in rings) for rings in ideal.lane)
    found = with_line(replace(track, kind=TrackKind.SKIDPAD, centreline_m=route, lane=lane), origin, BETWEEN_RINGS)
    return _started(found, start, told)


def _way_in(track: Track, middle: Pose) -> float:
    """More than 0 where cars come in along the direction of the middle: the way out is closed by orange cones.

    Where it is not, the left ring is the blue one.
    """
    ahead_m, left_m = middle.seen(*track.cones_xy_m.T)
    closing = (
        (track.cone_colors == ConeColor.ORANGE) & (np.abs(left_m) < LANE_M / 2.0 - 0.2) & (np.abs(ahead_m) > RING_M)
    )
    if closing.any():
        return float(ahead_m[closing].mean())
    x, y = middle.ahead(0.0, SKIDPAD_CENTRES_APART_M / 2.0)
    inner = np.abs(np.hypot(track.cones_xy_m[:, 0] - x, track.cones_xy_m[:, 1] - y) - RING_M) < RING_NEAR_M
    colors = track.cone_colors[inner]
    return 0.5 + float(np.count_nonzero(colors == ConeColor.BLUE)) - float(np.count_nonzero(colors == ConeColor.YELLOW))


# ---------------------------------------------------------------- the walk


def _walk(xy: Floats, sides: Ints, axis: Pose) -> tuple[Floats, Floats, Floats] | None:
    """Walk the lane from triangle to triangle through the edges that join a left cone (side 1) to a right one (-1).

    In a triangulation of all cones each triangle inside the lane has exactly two such edges, so the way on is always
    the other one. Left border, right border (the cones passed on either side) and the middle between them; None where
    the walk does not come back to its beginning.
    """
    xy, sides = xy[sides != 0], sides[sides != 0]
    ahead_m, left_m = axis.seen(*xy.T)
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
        if math.dist(xy[edge[0]], xy[edge[1]]) > ACROSS_M:
            return None  # over the end of an open lane, to its beginning
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
