"""The judge: what passes, and what fails and why, from the car's true motion alone."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import pytest

from fsai_hil.simulator.car import CarTruth, Pose, car_model
from fsai_hil.simulator.judge import Judge, JudgeSettings, JudgeVerdict
from fsai_hil.simulator.tracks import Track, acceleration_track, load_track, skidpad_track, small_oval
from fsai_vcu.interface.enums import Ami, AsState, ShutdownCause

MODEL = car_model("2026")
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
            rpm = self.rpm if self.air else self.speed_mps / (2.0 * math.pi * MODEL.wheel_radius_m) * 60.0
            wheels = (0.0, 0.0, rpm, rpm) if self.air else (rpm, rpm, rpm, rpm)
            truth = CarTruth(
                self.t_ns, self.pose, self.speed_mps, 0.0, self.steer_deg, wheels, (0.0, 0.0), self.distance_m
            )
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
    judge = Judge(track, mission, MODEL, JudgeSettings(**settings))  # type: ignore[arg-type]
    return Puppet(judge, track.staging(mission, MODEL.nose_m), air=mission.name.startswith("STATIC"))


def why(verdict: JudgeVerdict) -> str:
    return "; ".join(verdict.reasons)


# ------------------------------------------------------------ acceleration


def test_a_straight_run_that_stops_in_time_passes_with_its_time() -> None:
    car = puppet(acceleration_track(), Ami.ACCELERATION)
    car.start()
    car.go(75.0 + 50.0 - MODEL.nose_m, 0.0, 0.0, 10.0)
    verdict = car.finish()
    assert verdict.passed, why(verdict)
    assert verdict.lap_times_s == pytest.approx((7.5,), abs=0.02)
    assert verdict.stop_distance_m == pytest.approx(50.0, abs=0.01)
    assert verdict.top_speed_mps == pytest.approx(10.0)
    assert verdict.mean_speed_mps == pytest.approx(10.0, rel=0.01)


@pytest.mark.parametrize(("beyond_m", "passes"), [(99.9, True), (100.1, False)])
def test_the_car_must_stop_within_100_m_after_the_finish_line(beyond_m: float, passes: bool) -> None:
    car = puppet(acceleration_track(), Ami.ACCELERATION)
    car.start()
    car.go(75.0 + beyond_m - MODEL.nose_m, 0.0, 0.0, 15.0)
    verdict = car.finish()
    assert verdict.passed is passes, why(verdict)
    assert passes or "100.1 m after the finish line" in why(verdict)


def test_a_car_that_stops_before_the_finish_line_fails() -> None:
    car = puppet(acceleration_track(), Ami.ACCELERATION)
    car.start()
    car.go(60.0, 0.0, 0.0)
    assert "finish line was never crossed" in why(car.finish())


# ------------------------------------------------------------ when the car may move


@pytest.mark.parametrize(("wait_s", "passes"), [(2.9, False), (3.02, True)])
def test_the_car_must_not_move_in_the_first_3_s_of_driving(wait_s: float, passes: bool) -> None:
    car = puppet(acceleration_track(), Ami.ACCELERATION)
    car.start(wait_s)
    car.go(75.0 + 20.0, 0.0, 0.0, 10.0)
    verdict = car.finish()
    assert verdict.passed is passes, why(verdict)
    assert passes or "must wait 3 s" in why(verdict)


@pytest.mark.parametrize("state", [AsState.AS_OFF, AsState.AS_READY])
def test_a_car_that_moves_before_driving_fails(state: AsState) -> None:
    car = puppet(acceleration_track(), Ami.ACCELERATION)
    car.look(0.2)
    car.state = state
    car.look(0.2)
    car.go(car.pose.x_m + 0.15, 0.0, 0.0, 1.0)
    car.speed_mps = 0.0
    car.start()
    car.go(75.0 + 20.0, 0.0, 0.0, 10.0)
    assert f"moved in {state.label}" in why(car.finish())


def test_a_car_that_rolls_on_in_as_finished_fails() -> None:
    car = puppet(acceleration_track(), Ami.ACCELERATION)
    car.start()
    car.go(75.0 + 20.0, 0.0, 0.0, 10.0)
    car.state = AsState.AS_FINISHED
    car.go(75.0 + 22.0, 0.0, 0.0, 1.0)
    assert "moved in AS_FINISHED" in why(car.finish())


# ------------------------------------------------------------ how it ends


def test_an_emergency_brake_fails_a_run_and_the_cause_is_named() -> None:
    car = puppet(acceleration_track(), Ami.ACCELERATION)
    car.start()
    car.go(75.0 + 20.0, 0.0, 0.0, 10.0)
    verdict = car.finish(AsState.EMERGENCY_BRAKE, ShutdownCause.AI_COMMS_FAULT)
    assert not verdict.passed
    assert "AI_COMMS_FAULT" in why(verdict)
    assert verdict.shutdown_cause == "AI_COMMS_FAULT"


def test_a_run_that_never_starts_ends_by_its_time_limit() -> None:
    car = puppet(acceleration_track(), Ami.ACCELERATION, start_timeout_s=20.0)
    car.look(20.1)
    assert car.judge.done
    assert "no AS_DRIVING within 20 s" in why(car.judge.verdict())


def test_a_car_that_never_finishes_ends_by_its_time_limit() -> None:
    car = puppet(acceleration_track(), Ami.ACCELERATION, drive_timeout_s=30.0)
    car.start()
    car.look(28.0)
    assert car.judge.done
    assert "still in AS_DRIVING after 30 s" in why(car.judge.verdict())


def test_an_unfinished_run_is_no_pass() -> None:
    car = puppet(acceleration_track(), Ami.ACCELERATION)
    car.start()
    assert "the run is not over" in why(car.judge.verdict())


def test_the_verdict_as_json_lists_the_as_states_with_times() -> None:
    car = puppet(acceleration_track(), Ami.ACCELERATION)
    car.start()
    car.go(75.0 + 20.0, 0.0, 0.0, 10.0)
    found = car.finish().as_dict()
    assert [each["state"] for each in found["as_states"]] == ["AS_OFF", "AS_READY", "AS_DRIVING", "AS_FINISHED"]
    assert [each["t_s"] for each in found["as_states"]][:3] == pytest.approx([0.01, 0.51, 6.01])
    wanted = {
        "mission", "result", "reasons", "as_states", "laps", "lap_times_s", "cones_hit", "off_course",
        "max_lateral_error_m", "mean_speed_mps", "top_speed_mps",
    }  # fmt: skip
    assert wanted <= set(found)


# ------------------------------------------------------------ the track


def test_a_car_with_all_four_wheels_off_the_track_fails() -> None:
    car = puppet(acceleration_track(), Ami.ACCELERATION)
    car.start()
    car.go(20.0, 0.0, 0.0)
    car.go(30.0, 2.2, 0.0)
    car.go(40.0, 0.0, 0.0)
    car.go(75.0 + 20.0, 0.0, 0.0, 10.0)
    verdict = car.finish()
    assert verdict.off_course == 1
    assert "off course once" in why(verdict)
    assert verdict.max_lateral_error_m == pytest.approx(2.2, abs=0.05)


def test_two_wheels_on_the_track_are_enough() -> None:
    car = puppet(acceleration_track(), Ami.ACCELERATION)
    car.start()
    car.go(20.0, 0.0, 0.0)
    car.go(30.0, 2.05, 0.0)
    car.go(75.0 + 20.0, 0.0, 0.0, 10.0)
    verdict = car.finish()
    assert verdict.off_course == 0
    assert verdict.passed, why(verdict)


def test_a_cone_hit_counts_once_and_costs_2_s_but_no_pass() -> None:
    car = puppet(acceleration_track(), Ami.ACCELERATION)
    car.start()
    car.go(18.0, 0.0, 0.0)
    car.go(18.0, 0.65, 0.0)  # side at 1.365 m: the cones at 1.5 m have a radius of 0.114 m
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


@pytest.mark.parametrize("laps", [1, 3])
def test_laps_are_counted_and_timed_from_line_to_line(laps: int) -> None:
    car, line = circuit(laps)
    car.start()
    for _ in range(laps):
        car.along(line, speed_mps=5.0)  # a whole number of looks between two points
    car.along(line[:40])
    verdict = car.finish()
    assert verdict.passed, why(verdict)
    assert verdict.laps == laps
    assert verdict.lap_times_s == pytest.approx([small_oval().length_m / 5.0] * laps, abs=0.25)
    assert verdict.max_lateral_error_m < 0.05


def test_a_lap_too_few_and_a_lap_too_many_fail() -> None:
    few, line = circuit(2)
    few.start()
    few.along(line)
    few.along(line[:40])
    assert "1 of 2 laps" in why(few.finish())
    many, _ = circuit(1)
    many.start()
    many.along(line)
    many.along(line)
    many.along(line[:40])
    assert "2 laps driven where 1" in why(many.finish())


def test_a_circuit_must_be_stopped_on_within_30_m() -> None:
    car, line = circuit(1)
    car.start()
    car.along(line)
    car.along(line[:150])
    verdict = car.finish()
    assert "after the finish line, allowed are 30 m" in why(verdict)


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


def test_a_circuit_driven_beside_its_middle_reports_how_far() -> None:
    car, line = circuit(1)
    car.start()
    car.along(line, offset_m=0.6)
    car.along(line[:40])
    verdict = car.finish()
    assert verdict.passed, why(verdict)
    assert verdict.max_lateral_error_m == pytest.approx(0.6, abs=0.06)


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
    car.go(stop_at_m - MODEL.nose_m, 0.0, 0.0)
    return car.finish()


def test_two_laps_right_two_left_and_a_stop_in_the_exit_pass() -> None:
    verdict = skidpad_run("RRLL")
    assert verdict.passed, why(verdict)
    assert verdict.laps == 4
    assert verdict.lap_times_s == pytest.approx([math.pi * 18.25 / 6.0] * 4, abs=0.4)
    assert verdict.stop_distance_m == pytest.approx(10.0, abs=0.01)


@pytest.mark.parametrize("sides", ["LLRR", "RRL", "RLLL", "RRRLL", ""])
def test_any_other_order_of_laps_fails(sides: str) -> None:
    assert "laps driven" in why(skidpad_run(sides))


def test_the_skidpad_must_be_stopped_on_within_25_m() -> None:
    assert "allowed are 25 m" in why(skidpad_run("RRLL", 25.5))


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


def test_inspection_a_passes_with_full_sweep_and_200_rpm_in_time() -> None:
    verdict = inspection_a()
    assert verdict.passed, why(verdict)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"sweep_deg": 20.0}, "steered 20.0 deg to the left"),
        ({"end_deg": 5.0}, "instead of straight"),
        ({"rpm": 150.0}, "reached 150 of 200 rpm"),
        ({"up_s": 12.0}, "to reach 200 rpm"),
        ({"down_s": 6.5}, "to come to rest"),
    ],
)
def test_inspection_a_fails_where_it_falls_short(changes: dict[str, float], words: str) -> None:
    assert words in why(inspection_a(**changes))


def inspection_b(rpm: float, state: AsState, cause: ShutdownCause | None) -> JudgeVerdict:
    car = puppet(load_track("static"), Ami.STATIC_INSPECTION_B)
    car.start()
    car.rpm = rpm
    car.look(2.0)
    car.state, car.cause = state, cause
    car.look(0.3)
    car.rpm = 0.0
    return car.finish(state, cause)


def test_inspection_b_passes_with_50_rpm_and_an_estop_request() -> None:
    verdict = inspection_b(50.0, AsState.EMERGENCY_BRAKE, ShutdownCause.AI_COMPUTER_REQUEST)
    assert verdict.passed, why(verdict)


def test_inspection_b_fails_too_slow_or_ended_by_anything_else() -> None:
    slow = inspection_b(40.0, AsState.EMERGENCY_BRAKE, ShutdownCause.AI_COMPUTER_REQUEST)
    assert "40 of 50 rpm" in why(slow)
    other = inspection_b(50.0, AsState.EMERGENCY_BRAKE, ShutdownCause.AI_COMMS_FAULT)
    assert "AI_COMMS_FAULT" in why(other)
    by_button = inspection_b(50.0, AsState.EMERGENCY_BRAKE, None)
    assert "shutdown circuit" in why(by_button)


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


def test_the_demonstration_passes_as_the_rules_describe_it() -> None:
    verdict = demo()
    assert verdict.passed, why(verdict)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"sweep_deg": 4.0}, "steered 4.0 deg to the left"),
        ({"fast_m": 10.5}, "acceleration 1 took"),
        ({"stop_m": 21.0}, "the first stop came after"),
        ({"second_mps": 3.5}, "acceleration 2 did not reach 15 km/h"),
    ],
)
def test_the_demonstration_fails_where_it_falls_short(changes: dict[str, float], words: str) -> None:
    assert words in why(demo(**changes))


# ------------------------------------------------------------ bad questions


@pytest.mark.parametrize(
    ("make", "mission", "words"),
    [
        (small_oval, Ami.SKIDPAD, "needs a track of kind skidpad"),
        (skidpad_track, Ami.TRACKDRIVE, "needs a track of kind circuit"),
        (small_oval, Ami.NOT_SELECTED, "is no mission"),
    ],
)
def test_a_mission_on_the_wrong_track_is_refused_in_one_line(
    make: Callable[[], Track], mission: Ami, words: str
) -> None:
    with pytest.raises(ValueError, match=words):
        Judge(make(), mission, MODEL)
