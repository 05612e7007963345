"""The map of a lap: closed over odometry's drift, and kept to afterwards."""

from __future__ import annotations

import math

import numpy as np
import pytest
from lap_rig import CAR, Ride
from msgspec.structs import replace

from fsai_hil.simulator.car import Pose
from fsai_hil.simulator.sensing import ConeSensor, SensorSettings
from fsai_hil.simulator.tracks import Track, random_circuit
from fsai_hil.simulator.tracks.built_in import circuit_from
from fsai_vcu.core.arrays import Floats
from fsai_vcu.core.driving import ConeColor, Motion
from fsai_vcu.core.missions.laps import advance_laps, staged
from fsai_vcu.core.planning.cone_map import SHARED_M, ConeMap, fit_of, located
from fsai_vcu.core.planning.pose import NO_PATH
from fsai_vcu.core.planning.racing import Racing
from fsai_vcu.core.planning.settings import PlannerSettings
from fsai_vcu.interface.enums import Ami

CIRCUIT = random_circuit(1)


class Mapping(Ride):
    """Drives along the middle of the lane and maps."""

    def __init__(self, track: Track = CIRCUIT) -> None:
        super().__init__(track)
        self.map = ConeMap(PlannerSettings(), self.motion)
        self.start = self.pose
        self.line_at_m: list[float] = []

    def drive(self, way_m: float) -> None:
        end_m = self.motion.distance_m + way_m
        middle = self.track.centreline_m
        while self.motion.distance_m < end_m:
            self.map.add(self.see().xy_m, self.motion)
            nearest = int(np.hypot(*(middle - (self.pose.x_m, self.pose.y_m)).T).argmin())
            ahead = np.take(middle, np.arange(nearest, nearest + 20), axis=0, mode="wrap")
            before = self.pose.x_m
            self.follow(np.column_stack(self.pose.seen(*ahead.T)))
            if before < 0.0 <= self.pose.x_m and abs(self.pose.y_m) < 3.0:
                self.line_at_m.append(self.motion.distance_m)

    def truth(self, xy_m: Floats) -> Floats:
        """Of the world, in the frame of the run's beginning."""
        return np.column_stack(self.start.seen(*xy_m.T))

    def error_m(self, motion: Motion) -> float:
        at = self.truth(np.array([[self.pose.x_m, self.pose.y_m]]))[0]
        return math.hypot(motion.x_m - at[0], motion.y_m - at[1])


def test_the_map_closes_over_the_drift_of_odometry() -> None:
    ride = Mapping()
    ride.drive(CIRCUIT.length_m + 26.0)
    assert ride.error_m(ride.motion) > 3.0 and not ride.map.closed
    begun_m, ended_m = ride.line_at_m
    assert ride.map.close(begun_m, ended_m - 4.0, (0.0, 0.0))  # where odometry believed the line
    lap = ride.map.lap_xy_m
    assert np.hypot(*np.diff(np.vstack((lap, lap[:1])), axis=0).T).max() < 1.5  # a ring without a fold
    assert np.hypot(*np.diff(lap, axis=0).T).sum() == pytest.approx(CIRCUIT.length_m, abs=4.0)
    ride.drive(2.0)
    assert ride.error_m(ride.map.here) < 0.5
    cones, there = ride.map.take(), ride.truth(CIRCUIT.cones_xy_m)
    gap = np.hypot(*(there[:, None] - cones).transpose(2, 0, 1))
    assert gap.min(axis=1).max() < 1.2  # every cone is in the map …
    assert len(cones) <= len(there) + 3  # … once
    # Laps later the car is where the map says, wherever odometry is.
    ride.drive(CIRCUIT.length_m)
    assert ride.error_m(ride.motion) > 6.0 and ride.error_m(ride.map.here) < 1.0 and ride.map.fit > 0.8


def test_a_map_closed_after_two_laps_has_both_borders() -> None:
    ride = Mapping()
    ride.drive(2.0 * CIRCUIT.length_m + 26.0)
    begun_m, ended_m = ride.line_at_m[-2:]
    assert ride.map.close(begun_m, ended_m - 4.0, (0.0, 0.0))
    assert len(ride.map.take()) == pytest.approx(len(CIRCUIT.cones_xy_m), abs=8)


def two_straights(*extra_m: tuple[float, float]) -> Mapping:
    """The map of a lap of two straights side by side, 10 m apart, closed on the first one. extra_m: further cones."""
    turn = np.linspace(-0.5, 0.5, 24, endpoint=False) * math.pi
    end = np.column_stack((25.0 + 5.0 * np.cos(turn), 5.0 + 5.0 * np.sin(turn)))
    along = np.column_stack((np.linspace(-25.0, 25.0, 50, endpoint=False), np.zeros(50)))
    half = np.concatenate((along, end))
    track = circuit_from("two straights", np.concatenate((half, (0.0, 10.0) - half)), 25.0, 3.5)
    colors = np.append(track.cone_colors, [ConeColor.UNKNOWN] * len(extra_m))
    cones = np.vstack((track.cones_xy_m, *extra_m))
    ride = Mapping(replace(track, cones_xy_m=cones, cone_colors=colors))
    ride.drive(ride.track.length_m + 26.0)
    begun_m, ended_m = ride.line_at_m
    assert ride.map.close(begun_m, ended_m - 4.0, (0.0, 0.0))
    return ride


def test_a_cone_seen_from_two_parts_of_the_lap_is_one() -> None:
    ride = two_straights()
    assert len(ride.map.take()) <= len(ride.track.cones_xy_m)


def test_another_part_of_the_lap_puts_no_cones_into_the_map() -> None:
    ride = two_straights()
    ride.drive(ride.track.length_m - 28.0)  # on the first straight again, past the turn's sight
    cones = ride.track.cones_xy_m
    second = (cones[:, 1] > 5.0) & (np.abs(cones[:, 0]) < 12.0)
    known = ride.map.take()
    moved = np.where(second[:, None], cones - (0.0, 1.0), cones)  # as odometry has drifted between the two
    ride.sensor = ConeSensor(replace(ride.track, cones_xy_m=moved))
    ride.drive(15.0)
    there = ride.truth(cones[second])
    near = [np.hypot(*(xy[:, None] - there).transpose(2, 0, 1)).min(axis=1) < 2.0 for xy in (known, ride.map.take())]
    assert near[0].sum() == near[1].sum() and ride.map.fit > 0.8


def test_a_cone_across_the_border_of_two_parts_is_kept_once() -> None:
    border_m = 5.0 + SHARED_M / 2.0  # up to where a cone counts to the first straight
    ride = two_straights((0.0, border_m + 0.15))
    ride.drive(ride.track.length_m - 28.0)
    moved = ride.track.cones_xy_m.copy()
    moved[-1, 1] = border_m - 0.15  # as it is seen with some noise
    ride.sensor = ConeSensor(replace(ride.track, cones_xy_m=moved))
    ride.drive(15.0)
    there = ride.truth(moved[-1:])
    assert (np.hypot(*(ride.map.take() - there).T) < 1.0).sum() == 1


def test_cones_of_another_place_close_no_map() -> None:
    ride = Mapping()
    ride.drive(100.0)
    half = ride.motion.distance_m - 20.0
    assert not ride.map.close(ride.line_at_m[0], half, (0.0, 0.0))
    assert not ride.map.closed


def test_a_car_that_skids_is_lost_not_found_among_new_cones() -> None:
    ride = Mapping()
    ride.drive(CIRCUIT.length_m + 26.0)
    begun_m, ended_m = ride.line_at_m
    assert ride.map.close(begun_m, ended_m - 4.0, (0.0, 0.0))
    ride.sensor = ConeSensor(CIRCUIT, SensorSettings(false_per_scan=1.0), seed=3)
    ride.drive(20.0)
    for _ in range(120):
        ride.drive(0.4)
        was = ride.motion
        aside_x_m, aside_y_m = -0.03 * math.sin(was.yaw_rad), 0.03 * math.cos(was.yaw_rad)
        ride.motion = replace(was, x_m=was.x_m + aside_x_m, y_m=was.y_m + aside_y_m, yaw_rad=was.yaw_rad + 0.01)
        assert ride.map.fit < 0.5 or ride.error_m(ride.map.here) < 2.0


def test_a_displaced_car_is_found_in_the_map() -> None:
    cones = CIRCUIT.cones_xy_m
    pose = Pose(10.0, 0.3, 0.1)
    local = np.column_stack(pose.seen(*cones.T))
    seen = local[(np.hypot(*local.T) < 14.0) & (local[:, 0] > 0.0)]
    found = located(Motion(x_m=11.0, y_m=-0.7, yaw_rad=0.0), 2.0, seen, cones)
    assert found is not None
    assert (found.x_m, found.y_m, found.yaw_rad) == pytest.approx((pose.x_m, pose.y_m, pose.yaw_rad), abs=0.02)
    # Without knowing about where it is, it may as well be one cone further on the straight.
    assert located(replace(found, x_m=found.x_m + 2.0), 20.0, seen, cones) is None
    assert fit_of(found, seen, cones) > 0.99
    assert fit_of(replace(found, y_m=found.y_m + 0.8), seen, cones) < 0.3


def test_a_cone_taken_away_leaves_the_map() -> None:
    cones = CIRCUIT.cones_xy_m
    known = ConeMap(PlannerSettings(), Motion())
    seen = cones[(np.hypot(*cones.T) < 14.0) & (cones[:, 0] > 3.0)]
    nearest = int(np.hypot(*seen.T).argmin())
    for _ in range(10):
        known.add(seen, Motion())
    assert len(known.take()) == len(seen)
    for _ in range(15):
        known.add(np.delete(seen, nearest, axis=0), Motion())
    assert len(known.take()) == len(seen) - 1


def stadium(straight_m: float, radius_m: float, apart_m: float) -> Track:
    """Two half circles and two straights, evenly set with cones, without a gate."""
    angle = np.linspace(-0.5, 0.5, 200) * math.pi
    bend = np.column_stack([straight_m + radius_m * np.cos(angle), radius_m * (1.0 + np.sin(angle))])
    way = np.column_stack([np.arange(0.0, straight_m, 0.25), np.zeros(int(4 * straight_m))])
    half = np.vstack([way, bend])
    track = circuit_from("stadium", np.vstack([half, [straight_m, 2.0 * radius_m] - half]), 12.0, 3.5, apart_m)
    kept = track.cone_colors != ConeColor.BIG_ORANGE
    return replace(track, cones_xy_m=track.cones_xy_m[kept], cone_colors=track.cone_colors[kept])


class Laps(Mapping):
    """Drives along the middle of the lane, counts laps by odometry, and closes the map as a racing planner does."""

    def __init__(self, track: Track) -> None:
        super().__init__(track)
        self.racing = Racing(CAR, PlannerSettings(), self.motion)
        self.state = staged(self.motion, CAR.nose_ahead_of_rear_axle_m + 6.0)

    def follow(self, path_m: Floats) -> None:
        here = self.racing.see(self.see().xy_m, self.motion)
        self.state = self.racing.close(advance_laps(self.state, here, 20.0), here)
        self.racing.path(NO_PATH, here)
        super().follow(path_m)


@pytest.mark.parametrize(
    ("straight_m", "radius_m", "apart_m"),
    [
        pytest.param(60.0, 10.0, 3.0, marks=pytest.mark.long),
        pytest.param(75.0, 10.0, 3.0, marks=pytest.mark.long),
        (75.0, 10.0, 4.5),
        (78.0, 9.0, 2.5),  # cones as far apart as they may be, and as near: the others lie between
    ],
)
def test_a_lap_begun_in_an_even_straight_is_closed_behind_it(
    straight_m: float, radius_m: float, apart_m: float
) -> None:
    """A cone further on the cones of the straight fit as well: what comes behind it tells where the car is."""
    ride = Laps(stadium(straight_m, radius_m, apart_m))
    ride.drive(ride.track.length_m + straight_m + 10.0)
    assert ride.racing.located
    assert ride.error_m(ride.racing.see(ride.see().xy_m, ride.motion)) < 0.4 * apart_m, (
        "at its cones, not the next ones"
    )
    assert ride.state.line.x_m == pytest.approx(8.17, abs=0.6), "the line is where the first lap began"
    ride.drive(15.0)  # in a turn there may be no room for the way onto the race line
    assert ride.racing.located and ride.racing.note == ""


def test_a_lap_that_cannot_be_closed_is_said() -> None:
    """On a circle that is evenly set with cones no place is another than the next."""
    track, angle = stadium(0.0, 25.0, 4.5), np.linspace(0.0, 2.0 * math.pi, 36, endpoint=False)
    rings = [r * np.column_stack([np.sin(angle), np.cos(angle)]) + (0.0, 25.0) for r in (23.25, 26.75)]
    colors = np.repeat([int(ConeColor.BLUE), int(ConeColor.YELLOW)], 36)
    ride = Laps(replace(track, cones_xy_m=np.vstack(rings), cone_colors=colors))
    ride.drive(ride.track.length_m + 60.0)
    assert ride.state.laps == 1 and ride.racing.note == ""
    ride.drive(40.0)
    assert not ride.racing.located and ride.racing.note.startswith("no race: ")


@pytest.mark.parametrize("off_m", [(0.0, 0.0), (7.5, -7.0), (-10.0, 3.0), (1.0, 10.5)])
def test_the_car_is_found_as_far_off_as_it_is_in_doubt(off_m: tuple[float, float]) -> None:
    at = CIRCUIT.staging(Ami.TRACKDRIVE, CAR.nose_ahead_of_rear_axle_m)
    around = np.array(CIRCUIT.cones_xy_m[np.hypot(*(CIRCUIT.cones_xy_m - (at.x_m, at.y_m)).T) < 40.0])
    ahead, left = at.seen(*around.T)
    seen = np.column_stack((ahead, left))[(ahead > 0.0) & (ahead < 30.0)]
    guess = Motion(x_m=at.x_m + off_m[0], y_m=at.y_m + off_m[1], yaw_rad=at.yaw_rad + 0.1)
    found = located(guess, 12.0, seen, around)
    assert found is not None
    assert (found.x_m, found.y_m, found.yaw_rad) == pytest.approx((at.x_m, at.y_m, at.yaw_rad), abs=0.05)
