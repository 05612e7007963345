"""The skidpad: its figure of eight as a path, where on it the car is, and where it is in the odometry frame.

Course frame: origin where the two circles touch, x along the way in and out, y to the left. The right circle is driven
first. The path crosses itself, so the car's place on it is advanced by the way driven and corrected only nearby.
Position is corrected by every cone seen: a cone must stand on one of the four circles or beside the lanes in and out.
Where on its circle it stands does not matter, so the course may be laid with any number of cones.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from fsai_vcu.core.arrays import Floats
from fsai_vcu.core.driving import Motion
from fsai_vcu.core.missions.settings import MissionSettings
from fsai_vcu.interface.immutable import Immutable

STEP_M = 0.25  # of the path's table
LEAD_M = 10.0  # of path before the staging place
EXIT_M = 60.0

CONE_SIGMA_M = 0.15
FEATURE_GATE_M = 0.9  # a cone further from every feature is none of the course's
DRIFT_SIGMA_M = 0.05  # of odometry between two observations, generously
DRIFT_SIGMA_RAD = 0.01
AMBIGUOUS_M = 0.7  # a cone about as near to a second feature says less
ITERATIONS = 4


@dataclass(frozen=True, slots=True, eq=False)
class SkidpadCourse:
    """The path as a table. xy_m: (N, 2) course frame, one point every `STEP_M`; entry_m and lap_m: lengths."""

    xy_m: Floats
    heading_rad: Floats
    staged_at_m: float  # of path where the staged car's rear axle stands
    entry_m: float  # of path up to the first passage of the origin
    lap_m: float
    laps: int
    circle_y_m: float
    inner_m: float
    outer_m: float
    half_lane_m: float

    @property
    def finish_m(self) -> float:
        """Length of path at the last passage of the origin."""
        return self.entry_m + self.laps * self.lap_m


def skidpad_course(settings: MissionSettings, nose_m: float) -> SkidpadCourse:
    """The course of these settings for a car whose nose is `nose_m` ahead of its rear axle."""
    circle_y = 0.5 * settings.skidpad_centres_m
    inner = 0.5 * settings.skidpad_inner_diameter_m
    radius = inner + 0.5 * settings.skidpad_lane_m
    lap = 2.0 * math.pi * radius
    entry = settings.skidpad_staging_m + nose_m + LEAD_M
    per_side = settings.skidpad_laps_per_side
    laps = 2 * per_side
    s = np.arange(0.0, entry + laps * lap + EXIT_M, STEP_M)
    on_circles = s - entry
    right, left = on_circles < per_side * lap, on_circles < laps * lap
    sign = np.where(right, -1.0, 1.0)
    turn = on_circles / radius
    x = np.where(on_circles < 0.0, on_circles, np.where(left, radius * np.sin(turn), on_circles - laps * lap))
    circling = (on_circles >= 0.0) & left
    y = np.where(circling, sign * radius * (1.0 - np.cos(turn)), 0.0)
    heading = np.where(circling, sign * turn, 0.0)
    # The circles touch where their centres' distance says, which need not be twice the driven radius.
    y += np.where(circling, sign * (circle_y - radius) * 0.5 * (1.0 - np.cos(turn)), 0.0)
    return SkidpadCourse(
        xy_m=np.column_stack((x, y)),
        heading_rad=heading,
        staged_at_m=LEAD_M,
        entry_m=entry,
        lap_m=lap,
        laps=laps,
        circle_y_m=circle_y,
        inner_m=inner,
        outer_m=inner + settings.skidpad_lane_m,
        half_lane_m=0.5 * settings.skidpad_lane_m,
    )


@dataclass(frozen=True, slots=True)
class SkidpadState(Immutable):
    """Where the odometry frame lies in the course frame, and how far along the path the car is."""

    x_m: float
    y_m: float
    yaw_rad: float
    progress_m: float
    distance_m: float  # driven when `progress_m` was found
    placed: int = 0  # observations by which the start was searched

    def course_pose(self, motion: Motion) -> tuple[float, float, float]:
        """The car's pose in the course frame."""
        cos, sin = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        return (
            self.x_m + cos * motion.x_m - sin * motion.y_m,
            self.y_m + sin * motion.x_m + cos * motion.y_m,
            self.yaw_rad + motion.yaw_rad,
        )


def staged_on(course: SkidpadCourse, motion: Motion) -> SkidpadState:
    """The state of a car that stands at the staging place, straight."""
    cos, sin = math.cos(-motion.yaw_rad), math.sin(-motion.yaw_rad)
    at = course.staged_at_m - course.entry_m
    return SkidpadState(
        x_m=at - (cos * motion.x_m - sin * motion.y_m),
        y_m=-(sin * motion.x_m + cos * motion.y_m),
        yaw_rad=-motion.yaw_rad,
        progress_m=course.staged_at_m,
        distance_m=motion.distance_m,
    )


def _residuals(course: SkidpadCourse, q: Floats) -> tuple[Floats, Floats, Floats]:
    """Distance of each point from its nearest feature (signed), the feature's normal there, and a weight 0…1."""
    found: list[Floats] = []
    normals: list[Floats] = []
    for centre_y in (-course.circle_y_m, course.circle_y_m):
        out = q - np.array([0.0, centre_y])
        reach = np.maximum(np.hypot(out[:, 0], out[:, 1]), 1e-6)
        normal = out / reach[:, None]
        for radius in (course.inner_m, course.outer_m):
            found.append(reach - radius)
            normals.append(normal)
    across = np.tile(np.array([0.0, 1.0]), (len(q), 1))
    in_lane = np.abs(q[:, 0]) > 0.75 * course.inner_m  # the lanes in and out end where the circles begin
    for side_y in (-course.half_lane_m, course.half_lane_m):
        found.append(np.where(in_lane, q[:, 1] - side_y, np.inf))
        normals.append(across)
    table = np.stack(found)
    size = np.abs(table)
    best = size.argmin(axis=0)
    rows = np.arange(len(q))
    ordered = np.sort(size, axis=0)
    weight = np.where(ordered[1] - ordered[0] < AMBIGUOUS_M, 0.3, 1.0)
    return table[best, rows], np.stack(normals)[best, rows], weight


def _registered(
    course: SkidpadCourse, state: SkidpadState, motion: Motion, odometry_xy_m: Floats, gate_m: float, drift: float
) -> SkidpadState:
    """The state moved so that the cones (odometry frame) stand on the course, not further than drift explains."""
    current = state
    car = np.array([motion.x_m, motion.y_m])
    total = np.zeros(3)  # moved so far: x, y at the car, and yaw
    prior = np.diag([1.0 / (drift * DRIFT_SIGMA_M) ** 2] * 2 + [1.0 / (drift * DRIFT_SIGMA_RAD) ** 2])
    for _ in range(ITERATIONS):
        cos, sin = math.cos(current.yaw_rad), math.sin(current.yaw_rad)
        rotation = np.array([[cos, -sin], [sin, cos]])
        origin = np.array([current.x_m, current.y_m])
        q, here = odometry_xy_m @ rotation.T + origin, rotation @ car + origin
        residual, normal, weight = _residuals(course, q)
        weight = np.where(np.abs(residual) < gate_m, weight / CONE_SIGMA_M**2, 0.0)
        weight = weight * np.minimum(1.0, 2.0 * CONE_SIGMA_M / np.maximum(np.abs(residual), 1e-9))  # Huber's
        arm = q - here
        jacobian = np.column_stack((normal, normal[:, 1] * arm[:, 0] - normal[:, 0] * arm[:, 1]))
        weighted = jacobian * weight[:, None]
        step = np.linalg.solve(weighted.T @ jacobian + prior, -(weighted.T @ residual) - prior @ total)
        total += step
        turn = float(step[2])
        cos, sin = math.cos(turn), math.sin(turn)
        away = origin - here  # the whole turns about the car
        origin = here + np.array([cos * away[0] - sin * away[1], sin * away[0] + cos * away[1]]) + step[:2]
        current = replace(current, x_m=float(origin[0]), y_m=float(origin[1]), yaw_rad=current.yaw_rad + turn)
        if float(np.abs(step).max()) < 1e-4:
            break
    return current


def _misfit(course: SkidpadCourse, state: SkidpadState, odometry_xy_m: Floats) -> float:
    cos, sin = math.cos(state.yaw_rad), math.sin(state.yaw_rad)
    q = odometry_xy_m @ np.array([[cos, sin], [-sin, cos]]) + np.array([state.x_m, state.y_m])
    residual, _, _ = _residuals(course, q)
    return float(np.minimum(residual**2, FEATURE_GATE_M**2).sum())


def place_start(course: SkidpadCourse, state: SkidpadState, motion: Motion, odometry_xy_m: Floats) -> SkidpadState:
    """Before the car has driven: find where on the way in it really stands, some metres either way."""
    best, best_misfit = state, math.inf
    for ahead in np.arange(-4.0, 4.01, 0.8):
        for yaw in (-0.08, 0.0, 0.08):
            x, y, _ = state.course_pose(motion)
            cos, sin = math.cos(yaw), math.sin(yaw)
            dx, dy = state.x_m - x, state.y_m - y
            moved = replace(
                state,
                x_m=x + cos * dx - sin * dy + float(ahead),
                y_m=y + sin * dx + cos * dy,
                yaw_rad=state.yaw_rad + yaw,
            )
            misfit = _misfit(course, moved, odometry_xy_m) + 0.02 * float(ahead) ** 2 + 10.0 * yaw * yaw
            if misfit < best_misfit:
                best, best_misfit = moved, misfit
    best = _registered(course, best, motion, odometry_xy_m, 1.5 * FEATURE_GATE_M, drift=8.0)
    x, _, _ = best.course_pose(motion)
    return replace(best, progress_m=course.entry_m + x, distance_m=motion.distance_m, placed=state.placed + 1)


def advance_skidpad(course: SkidpadCourse, state: SkidpadState, motion: Motion, odometry_xy_m: Floats) -> SkidpadState:
    """The state with the car at `motion`, which sees these cones (odometry frame)."""
    if len(odometry_xy_m) >= 2:
        state = _registered(course, state, motion, odometry_xy_m, FEATURE_GATE_M, drift=1.0)
    x, y, heading = state.course_pose(motion)
    expected = state.progress_m + max(0.0, motion.distance_m - state.distance_m)
    low = max(0, round((expected - 2.0) / STEP_M))
    high = min(len(course.xy_m), round((expected + 2.0) / STEP_M) + 1)
    if low >= high:
        return replace(state, progress_m=expected, distance_m=motion.distance_m)
    near = course.xy_m[low:high]
    turned = np.cos(course.heading_rad[low:high] - heading)
    cost = np.hypot(near[:, 0] - x, near[:, 1] - y) + 1.0 * (1.0 - turned)
    index = low + int(cost.argmin())
    tangent = course.heading_rad[index]
    rest = (x - course.xy_m[index, 0]) * math.cos(tangent) + (y - course.xy_m[index, 1]) * math.sin(tangent)
    progress = index * STEP_M + min(max(rest, -STEP_M), STEP_M)
    return replace(state, progress_m=max(state.progress_m, progress), distance_m=motion.distance_m)


def path_ahead(course: SkidpadCourse, state: SkidpadState, length_m: float, step_m: float) -> Floats:
    """(M, 2) of the path from the car on, in the odometry frame."""
    at = state.progress_m + np.arange(0.0, length_m + 1e-9, step_m)
    stations = np.arange(len(course.xy_m)) * STEP_M
    at = at[at <= stations[-1]]
    xy = np.column_stack((np.interp(at, stations, course.xy_m[:, 0]), np.interp(at, stations, course.xy_m[:, 1])))
    cos, sin = math.cos(state.yaw_rad), math.sin(state.yaw_rad)
    moved = xy - np.array([state.x_m, state.y_m])
    return np.column_stack((cos * moved[:, 0] + sin * moved[:, 1], cos * moved[:, 1] - sin * moved[:, 0]))


def laps_done(course: SkidpadCourse, state: SkidpadState) -> int:
    return min(course.laps, max(0, int((state.progress_m - course.entry_m + 0.01) // course.lap_m)))
