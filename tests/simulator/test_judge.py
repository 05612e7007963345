"""The judge: what passes, and what fails and why, from the car's true motion alone."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
import pytest

from fsai_hil.simulator.car import CarTruth, Pose
from fsai_hil.simulator.judge import Judge, JudgeVerdict, _Surroundings
from fsai_hil.simulator.tracks import Track, acceleration_track, load_track, skidpad_track, small_oval
from fsai_vcu.core.vehicle.parameters import ADS_DV_2026 as CAR
from fsai_vcu.interface.enums import Ami, AsState, ShutdownCause

NOSE_M = CAR.nose_ahead_of_rear_axle_m
LOOK_NS = 10_000_000


@dataclass
class Puppet:
    """A car moved by strings: it is where the test puts it, look by look."""

    judge: Judge
    pose: Pose
    t_ns: int = 0
    distance_m: float = 0.0
    speed_mps: float = 0.0
    rpm: float = 0.0
    steer_deg: float = 0.0
    state: AsState = AsState.AS_OFF
    cause: ShutdownCause | None = None
    air: bool = field(default=False)

    def look(self, seconds: float = 0.01) -> None:
        for _ in range(round(seconds / 0.01)):
            self.t_ns += LOOK_NS
            rpm = self.rpm if self.air else self.speed_mps / (2.0 * math.pi * CAR.rolling_radius_m) * 60.0
            wheels = (0.0, 0.0, rpm, rpm) if self.air else (rpm, rpm, rpm, rpm)
            truth = CarTruth(self.t_ns, self.pose, self.speed_mps, 0.0, self.steer_deg, wheels, self.distance_m)
            self.judge.observe(truth, self.state, self.cause)

    def start(self, wait_s: float = 3.1) -> None:
        """Ready, Go, and the wait."""
        self.look(0.5)
        self.state = AsState.AS_READY
        self.look(5.5)
        self.state = AsState.AS_DRIVING
        self.look(wait_s)

    def go(self, x_m: float, y_m: float, yaw_rad: float, speed_mps: float = 6.0) -> None:
        """To a place, straight, in looks at a speed."""
        metres = math.dist((self.pose.x_m, self.pose.y_m), (x_m, y_m))
        count = max(1, round(metres / (speed_mps * 0.01)))
        x0, y0 = self.pose.x_m, self.pose.y_m
        self.speed_mps = speed_mps
        for i in range(1, count + 1):
            self.pose = Pose(x0 + (x_m - x0) * i / count, y0 + (y_m - y0) * i / count, yaw_rad)
            self.distance_m += metres / count
            self.look()

    def along(self, line: np.ndarray, offset_m: float = 0.0, speed_mps: float = 6.0) -> None:
        """Along a line of points, so far to the left of it."""
        for i in range(1, len(line) - 1, 2):
            dx, dy = line[i + 1] - line[i - 1]
            yaw = math.atan2(dy, dx)
            x, y = line[i, 0] - offset_m * math.sin(yaw), line[i, 1] + offset_m * math.cos(yaw)
            self.go(float(x), float(y), yaw, speed_mps)

    def finish(self, state: AsState = AsState.AS_FINISHED, cause: ShutdownCause | None = None) -> JudgeVerdict:
        self.speed_mps = 0.0
        self.look(0.6)
        self.state, self.cause = state, cause
        self.look(1.5)
        assert self.judge.done
        return self.judge.verdict()


def puppet(track: Track, mission: Ami, **settings: object) -> Puppet:
    judge = Judge(track, mission, CAR, **settings)  # type: ignore[arg-type]
    return Puppet(judge, track.staging(mission, NOSE_M), air=mission.name.startswith("STATIC"))


def why(verdict: JudgeVerdict) -> str:
    return "; ".join(verdict.reasons)


# ------------------------------------------------------------ acceleration


def straight(*places: tuple[float, float, float], wait_s: float = 3.1) -> Puppet:
    """On the acceleration track, from place to place (x and y in m, the speed in m/s)."""
    car = puppet(acceleration_track(), Ami.ACCELERATION)
    car.start(wait_s)
    for x_m, y_m, speed_mps in places:
        car.go(x_m, y_m, 0.0, speed_mps)
    return car


TO_THE_END = (75.0 + 20.0, 0.0, 10.0)


def test_a_straight_run_that_stops_in_time_passes_with_its_time() -> None:
    verdict = straight((75.0 + 50.0 - NOSE_M, 0.0, 10.0)).finish()
    assert verdict.passed, why(verdict)
    assert verdict.lap_times_s == pytest.approx((7.5,), abs=0.02)
    assert verdict.stop_distance_m == pytest.approx(50.0, abs=0.01)
    assert verdict.top_speed_mps == pytest.approx(10.0)
    assert verdict.mean_speed_mps == pytest.approx(10.0, rel=0.01)
    found = verdict.as_dict()["as_states"]
    assert [each["state"] for each in found] == ["AS_OFF", "AS_READY", "AS_DRIVING", "AS_FINISHED"]
    assert [each["t_s"] for each in found][:3] == pytest.approx([0.01, 0.51, 6.01])


@pytest.mark.parametrize(
    ("to_m", "words"),
    [
        (75.0 + 99.9 - NOSE_M, ""),
        (75.0 + 100.1 - NOSE_M, "100.1 m after the finish line"),
        (60.0, "finish line was never crossed"),
    ],
)
def test_the_car_must_stop_within_100_m_after_the_finish_line(to_m: float, words: str) -> None:
    verdict = straight((to_m, 0.0, 15.0)).finish()
    assert verdict.passed is (not words) and words in why(verdict)


# ------------------------------------------------------------ when the car may move


@pytest.mark.parametrize(("wait_s", "passes"), [(2.9, False), (3.02, True)])
def test_the_car_must_not_move_in_the_first_3_s_of_driving(wait_s: float, passes: bool) -> None:
    car = straight(TO_THE_END, wait_s=wait_s)
    verdict = car.finish()
    assert verdict.passed is passes, why(verdict)
    assert passes or "must wait 3 s" in why(verdict)
    assert (car.judge.early_ns is None) is passes


@pytest.mark.parametrize("state", [AsState.AS_OFF, AsState.AS_READY])
def test_a_car_that_moves_before_driving_fails(state: AsState) -> None:
    car = puppet(acceleration_track(), Ami.ACCELERATION)
    car.look(0.2)
    car.state = state
    car.look(0.2)
    stood_ns = car.t_ns
    car.go(car.pose.x_m + 0.15, 0.0, 0.0, 1.0)
    moved_ns = car.t_ns
    car.speed_mps = 0.0
    car.start()
    car.go(75.0 + 20.0, 0.0, 0.0, 10.0)
    assert f"moved in {state.label}" in why(car.finish())
    assert car.judge.early_ns is not None and stood_ns < car.judge.early_ns <= moved_ns


def test_a_car_that_rolls_on_in_as_finished_fails() -> None:
    car = straight(TO_THE_END)
    car.state = AsState.AS_FINISHED
    car.go(75.0 + 22.0, 0.0, 0.0, 1.0)
    assert "moved in AS_FINISHED" in why(car.finish())
    assert car.judge.early_ns is None


# ------------------------------------------------------------ how it ends


def test_an_emergency_brake_fails_a_run_and_the_cause_is_named() -> None:
    verdict = straight(TO_THE_END).finish(AsState.EMERGENCY_BRAKE, ShutdownCause.AI_COMMS_FAULT)
    assert not verdict.passed
    assert "AI_COMMS_FAULT" in why(verdict)
    assert verdict.shutdown_cause == "AI_COMMS_FAULT"


@pytest.mark.parametrize(
    ("starts", "words"),
    [(False, "no AS_DRIVING within 20 s"), (True, "still in AS_DRIVING after 60 s")],
)
def test_a_run_ends_by_its_time_limits_and_before_is_no_pass(starts: bool, words: str) -> None:
    car = puppet(acceleration_track(), Ami.ACCELERATION, start_timeout_s=20.0)
    if starts:
        car.start()
    assert "the run is not over" in why(car.judge.verdict())
    car.look(58.0 if starts else 21.0)
    assert car.judge.done
    assert words in why(car.judge.verdict())


# ------------------------------------------------------------ the track


@pytest.mark.parametrize(("beside_m", "times", "words"), [(2.2, 1, "off course once"), (2.05, 0, "")])
def test_two_wheels_on_the_track_are_enough_but_none_fails(beside_m: float, times: int, words: str) -> None:
    verdict = straight((20.0, 0.0, 6.0), (30.0, beside_m, 6.0), (40.0, 0.0, 6.0), TO_THE_END).finish()
    assert verdict.off_course == times
    assert why(verdict) == words
    assert verdict.max_lateral_error_m == pytest.approx(beside_m, abs=0.05)


def test_a_cone_hit_counts_once_and_costs_2_s_but_no_pass() -> None:
    car = straight((18.0, 0.0, 6.0), (18.0, 0.65, 6.0))  # side at 1.365 m: the cones at 1.5 m have a radius of 0.114 m
    car.look(0.1)
    assert car.judge.verdict().cones_hit == 0
    car.go(18.0, 0.70, 0.0)
    car.look(0.5)
    car.go(18.0, 0.0, 0.0)
    car.go(75.0 + 20.0, 0.0, 0.0, 10.0)
    verdict = car.finish()
    assert verdict.cones_hit == 1  # the nose is at 20.2 m, the tail at 17.4: only the cone at 20 m was beside the car
    assert verdict.penalty_s == 2.0
    assert verdict.passed, why(verdict)


# ------------------------------------------------------------ circuits


def circuit(laps: int = 1) -> tuple[Puppet, np.ndarray]:
    track = small_oval()
    assert track.centreline_m is not None
    return puppet(track, Ami.TRACKDRIVE, laps=laps), track.centreline_m


@pytest.mark.parametrize(("laps", "offset_m"), [(1, 0.6), (3, 0.0)])
def test_laps_are_counted_and_timed_from_line_to_line(laps: int, offset_m: float) -> None:
    car, line = circuit(laps)
    car.start()
    for _ in range(laps):
        car.along(line, offset_m, speed_mps=5.0)  # a whole number of looks between two points
    car.along(line[:40])
    verdict = car.finish()
    assert verdict.passed, why(verdict)
    assert verdict.laps == laps
    assert verdict.max_lateral_error_m == pytest.approx(offset_m, abs=0.06)
    if not offset_m:
        assert verdict.lap_times_s == pytest.approx([small_oval().length_m / 5.0] * laps, abs=0.25)


@pytest.mark.parametrize(
    ("wanted", "driven", "beyond", "words"),
    [
        (2, 1, 40, "1 of 2 laps"),
        (1, 2, 40, "2 laps driven where 1"),
        (1, 1, 150, "after the finish line, allowed are 30 m"),
    ],
)
def test_too_few_or_many_laps_or_a_late_stop_fail(wanted: int, driven: int, beyond: int, words: str) -> None:
    car, line = circuit(wanted)
    car.start()
    for _ in range(driven):
        car.along(line)
    car.along(line[:beyond])
    assert words in why(car.finish())


def test_driving_back_and_forth_over_the_line_makes_no_lap() -> None:
    car, _ = circuit(1)
    car.start()
    for _ in range(6):
        car.go(5.0, 0.0, 0.0)
        car.go(-9.0, 0.0, 0.0)
    car.go(5.0, 0.0, 0.0)
    assert "0 of 1 laps" in why(car.finish())


def test_a_short_cut_through_the_infield_is_off_course_no_lap() -> None:
    car, line = circuit(1)
    car.start()
    car.along(line[:40])
    far = len(line) * 3 // 4
    car.go(float(line[far, 0]), float(line[far, 1]), math.pi)
    car.along(line[far:])
    car.along(line[:20])
    verdict = car.finish()
    assert verdict.laps == 0
    assert verdict.off_course >= 1


# ------------------------------------------------------------ skidpad


def skidpad_run(sides: str, stop_at_m: float = 10.0) -> JudgeVerdict:
    car = puppet(skidpad_track(), Ami.SKIDPAD)
    car.start()
    car.go(0.0, 0.0, 0.0)
    radius = 18.25 / 2
    for side in sides:
        sign = 1.0 if side == "L" else -1.0
        angles = np.linspace(0.0, 2.0 * math.pi, 240)
        car.along(np.column_stack([radius * np.sin(angles), sign * radius * (1.0 - np.cos(angles))]))
    car.go(stop_at_m - NOSE_M, 0.0, 0.0)
    return car.finish()


def test_two_laps_right_two_left_and_a_stop_in_the_exit_pass() -> None:
    verdict = skidpad_run("RRLL")
    assert verdict.passed, why(verdict)
    assert verdict.laps == 4
    assert verdict.lap_times_s == pytest.approx([math.pi * 18.25 / 6.0] * 4, abs=0.4)
    assert verdict.stop_distance_m == pytest.approx(10.0, abs=0.01)


@pytest.mark.parametrize(
    ("sides", "stop_at_m", "words"),
    [
        *((sides, 10.0, "laps driven") for sides in ("LLRR", "RRL", "RLLL", "RRRLL", "")),
        ("RRLL", 25.5, "allowed are 25 m"),
    ],
)
def test_another_order_of_laps_or_a_late_stop_fails(sides: str, stop_at_m: float, words: str) -> None:
    assert words in why(skidpad_run(sides, stop_at_m))


# ------------------------------------------------------------ static inspections


def inspection_a(
    sweep_deg: float = 29.1, rpm: float = 200.0, up_s: float = 6.0, down_s: float = 3.0, end_deg: float = 0.0
) -> JudgeVerdict:
    car = puppet(load_track("static"), Ami.STATIC_INSPECTION_A)
    car.start()
    for steer in (sweep_deg, -sweep_deg, end_deg):
        car.steer_deg = steer
        car.look(1.0)
    for i in range(round(up_s * 100)):
        car.rpm = rpm * (i + 1) / (up_s * 100)
        car.look()
    car.look(1.0)
    for i in range(round(down_s * 100)):
        car.rpm = max(0.0, rpm * (1.0 - (i + 1) / (down_s * 100)))
        car.look()
    return car.finish()


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({}, ""),
        ({"sweep_deg": 20.0}, "steered 20.0 deg to the left"),
        ({"end_deg": 5.0}, "instead of straight"),
        ({"rpm": 150.0}, "reached 150 of 200 rpm"),
        ({"up_s": 12.0}, "to reach 200 rpm"),
        ({"down_s": 6.5}, "to come to rest"),
    ],
)
def test_inspection_a_fails_where_it_falls_short(changes: dict[str, float], words: str) -> None:
    verdict = inspection_a(**changes)
    assert verdict.passed is (not words) and words in why(verdict)


@pytest.mark.parametrize(
    ("rpm", "cause", "words"),
    [
        (50.0, ShutdownCause.AI_COMPUTER_REQUEST, ""),
        (40.0, ShutdownCause.AI_COMPUTER_REQUEST, "40 of 50 rpm"),
        (50.0, ShutdownCause.AI_COMMS_FAULT, "AI_COMMS_FAULT"),
        (50.0, None, "shutdown circuit"),
    ],
)
def test_inspection_b_needs_50_rpm_and_an_estop_request(rpm: float, cause: ShutdownCause | None, words: str) -> None:
    car = puppet(load_track("static"), Ami.STATIC_INSPECTION_B)
    car.start()
    car.rpm = rpm
    car.look(2.0)
    car.state, car.cause = AsState.EMERGENCY_BRAKE, cause
    car.look(0.3)
    car.rpm = 0.0
    verdict = car.finish(AsState.EMERGENCY_BRAKE, cause)
    assert verdict.passed is (not words) and words in why(verdict)


# ------------------------------------------------------------ demonstration


def demo(sweep_deg: float = 15.0, fast_m: float = 6.0, stop_m: float = 14.0, second_mps: float = 4.5) -> JudgeVerdict:
    car = puppet(load_track("static"), Ami.AUTONOMOUS_DEMO)
    car.start()
    for steer in (sweep_deg, -sweep_deg, 0.0):
        car.steer_deg = steer
        car.look(1.0)
    car.go(fast_m, 0.0, 0.0, 3.0)
    car.go(fast_m + 1.0, 0.0, 0.0, 4.5)
    car.go(stop_m, 0.0, 0.0, 3.0)
    car.speed_mps = 0.0
    car.look(0.5)
    car.go(stop_m + 6.0, 0.0, 0.0, 3.0)
    car.go(stop_m + 7.0, 0.0, 0.0, second_mps)
    return car.finish(AsState.EMERGENCY_BRAKE, ShutdownCause.AI_COMPUTER_REQUEST)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({}, ""),
        ({"sweep_deg": 4.0}, "steered 4.0 deg to the left"),
        ({"fast_m": 10.5}, "acceleration 1 took"),
        ({"stop_m": 21.0}, "the first stop came after"),
        ({"second_mps": 3.5}, "acceleration 2 did not reach 15 km/h"),
    ],
)
def test_the_demonstration_fails_where_it_falls_short(changes: dict[str, float], words: str) -> None:
    verdict = demo(**changes)
    assert verdict.passed is (not words) and words in why(verdict)


def test_cones_hit_are_found_however_the_car_moves() -> None:
    """A look that trusts an earlier one finds what a look at every cone finds."""
    track = small_oval()
    line = track.centreline_m
    assert line is not None
    draw = np.random.default_rng(1)
    careful, missed = _Surroundings(track, CAR), 0
    found: set[int] = set()
    for (x_m, y_m), (next_x_m, next_y_m) in pairwise(line.tolist()):
        way_rad = math.atan2(next_y_m - y_m, next_x_m - x_m)
        for share in (0.0, 0.4, 0.8):
            aside_m, turned_rad = draw.normal(0.0, 0.5), draw.normal(0.0, 0.2)
            at = Pose(x_m + share * (next_x_m - x_m), y_m + share * (next_y_m - y_m), way_rad)
            pose = Pose(*at.ahead(0.0, aside_m), way_rad + turned_rad)
            careful.look(pose, 0.0)
            anew = _Surroundings(track, CAR)
            anew.look(pose, 0.0)
            missed += len(anew.hit - careful.hit)
            found |= anew.hit
    assert len(found) > 10
    assert missed == 0
