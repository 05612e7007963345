"""The bus checker finds each rule broken, says when, and finds nothing where nothing is wrong."""

from __future__ import annotations

import gzip
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path

import pytest

from fsai_hil.rules.checker import LogError, WireChecker, WireReport, check_candump, read_candump
from fsai_vcu.core.vehicle.parameters import CARS
from fsai_vcu.interface.codec import Codec
from fsai_vcu.interface.enums import Ami, AsState, Direction, MissionStatus
from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.messages import (
    AiCommand,
    VcuBrake,
    VcuDriveFront,
    VcuDriveRear,
    VcuStatus,
    VcuSteer,
    WheelSpeeds,
)
from fsai_vcu.interface.revisions import revision

MS = 1_000_000
CODEC = Codec(revision("2026"))


class Bus:
    """Writes a log by hand: the car every 10 ms, the AI computer one millisecond after it.

    The attributes are what both say from the next cycle on; tests change them.
    """

    def __init__(self) -> None:
        self.t_ns = 1_000 * MS
        self.frames: list[Frame] = []
        self.status = VcuStatus(as_state=AsState.AS_OFF, ami=Ami.TRACKDRIVE)
        self.speeds = WheelSpeeds()
        self.angle_max_deg = 30.0
        self.torque_max_nm = 195.0
        self.command: AiCommand | None = AiCommand()
        self.answer_ns = MS
        self.echo_lag = 0
        self.car_speaks = True
        self.edit: Callable[[list[Frame]], Iterable[Frame]] = list
        self._bits = [False] * 8
        self._last = AiCommand()

    def run(self, seconds: float) -> Bus:
        for _ in range(round(seconds * 100)):
            self._cycle()
        return self

    def _cycle(self) -> None:
        if self.car_speaks:
            bit = not self.status.handshake
            self.status = replace(self.status, handshake=bit)
            self._bits.append(bit)
            self._say(self.status, self.t_ns)
            self._say(VcuDriveFront(0.0, self._last.front_torque_nm, self.torque_max_nm), self.t_ns)
            self._say(VcuDriveRear(0.0, self._last.rear_torque_nm, self.torque_max_nm), self.t_ns)
            self._say(VcuSteer(0.0, self.angle_max_deg, 0.0), self.t_ns)
            self._say(
                VcuBrake(0.0, self._last.front_brake_pct, 0.0, self._last.rear_brake_pct),
                self.t_ns,
            )
            self._say(self.speeds, self.t_ns)
        if self.command is not None:
            self._last = replace(self.command, handshake=self._bits[-1 - self.echo_lag])
            self.frames += self.edit(list(CODEC.encode_command(self._last, self.t_ns + self.answer_ns)))
        self.t_ns += 10 * MS

    def _say(
        self, image: VcuStatus | VcuDriveFront | VcuDriveRear | VcuSteer | VcuBrake | WheelSpeeds, t_ns: int
    ) -> None:
        self.frames.append(CODEC.encode(replace(image, t_rx_ns=t_ns)))

    def says(self, **changes: object) -> Bus:
        self.command = replace(self.command or AiCommand(), **changes)  # type: ignore[arg-type]
        return self

    def car(self, **changes: object) -> Bus:
        self.status = replace(self.status, **changes)  # type: ignore[arg-type]
        return self

    def rolls(self, rpm: int) -> Bus:
        self.speeds = WheelSpeeds(rpm, rpm, rpm, rpm)
        return self

    # the stations of a nominal run

    def off(self) -> Bus:
        self.car(as_state=AsState.AS_OFF, go_signal=False).run(0.1)
        return self.says(mission_status=MissionStatus.SELECTED).run(0.1)

    def ready(self) -> Bus:
        self.car(as_state=AsState.AS_READY).run(0.05)
        return self.says(front_brake_pct=20.0, rear_brake_pct=20.0).run(4.9)

    def go(self) -> Bus:
        self.car(as_state=AsState.AS_DRIVING, go_signal=True)
        return self.says(mission_status=MissionStatus.RUNNING, direction=Direction.FORWARD)

    def driving(self) -> Bus:
        self.go().run(3.0)
        self.says(front_brake_pct=0.0, rear_brake_pct=0.0).run(0.03)
        return self.drive(100.0)

    def drive(self, torque_nm: float) -> Bus:
        self.says(rear_torque_nm=torque_nm, rear_motor_speed_max_rpm=1000, steer_deg=5.0).run(0.1)
        return self.rolls(100).run(0.5)

    def stop(self) -> Bus:
        self.says(rear_torque_nm=0.0, steer_deg=0.0).run(0.02)
        self.says(front_brake_pct=50.0, rear_brake_pct=50.0).run(0.5)
        return self.rolls(9).run(0.55)

    def finish(self) -> Bus:
        self.says(mission_status=MissionStatus.FINISHED, direction=Direction.NEUTRAL).run(0.05)
        return self.car(as_state=AsState.AS_FINISHED).run(0.2)

    def check(self) -> WireReport:
        checker = WireChecker(CODEC)
        for frame in self.frames:
            checker.on_frame(frame)
        return checker.report()


def until_driving() -> Bus:
    return Bus().off().ready().driving()


def rules(report: WireReport) -> list[str]:
    return [violation.split(": ")[1] for violation in report.violations]


# ---------------------------------------------------------------- nothing wrong


def test_a_run_from_off_to_finished_breaks_no_rule() -> None:
    report = until_driving().stop().finish().check()
    assert report.violations == ()
    assert report.ok
    assert [state for _, state in report.as_states] == ["AS_OFF", "AS_READY", "AS_DRIVING", "AS_FINISHED"]
    assert report.incomplete_cycles == 0
    assert report.cycles == len([one for one in until_driving().stop().finish().frames if one.can_id == 0x510])


def test_a_second_run_and_an_emergency_brake_break_no_rule() -> None:
    bus = until_driving().stop().finish()
    bus.car(as_state=AsState.AS_OFF, go_signal=False)
    bus.says(mission_status=MissionStatus.NOT_SELECTED, front_brake_pct=0.0, rear_brake_pct=0.0)
    bus.rolls(0).off().ready().driving()
    bus.says(estop_request=True, rear_torque_nm=0.0, steer_deg=0.0).run(0.02)
    bus.car(as_state=AsState.EMERGENCY_BRAKE).run(1.0)
    bus.rolls(0).car(as_state=AsState.AS_OFF, go_signal=False)
    bus.says(mission_status=MissionStatus.NOT_SELECTED, direction=Direction.NEUTRAL).run(0.1)
    bus.says(estop_request=False).run(0.1)
    assert bus.check().violations == ()


@pytest.mark.parametrize(("rpm", "seen"), [(0, []), (100, ["output table"])])
def test_a_log_that_begins_with_a_car_braked_to_rest_does_not_know_for_how_long_it_has_stood(
    rpm: int, seen: list[str]
) -> None:
    bus = Bus().rolls(rpm).car(as_state=AsState.EMERGENCY_BRAKE)
    bus.says(mission_status=MissionStatus.RUNNING, direction=Direction.NEUTRAL, estop_request=True).run(0.1)
    assert rules(bus.check()) == seen


def test_what_the_sender_cannot_have_seen_yet_is_no_violation() -> None:
    bus = until_driving()
    bus.car(as_state=AsState.EMERGENCY_BRAKE).run(0.02)
    bus.says(rear_torque_nm=0.0, steer_deg=0.0).run(0.1)
    assert bus.check().violations == ()


def test_response_times_are_measured_from_each_toggle_to_its_echo() -> None:
    bus = Bus()
    bus.run(1.0)
    bus.answer_ns = 3 * MS
    bus.run(0.02)
    report = bus.check()
    assert report.responses == 101  # the toggles before the first command of all are nobody's delay
    assert report.response_p50_ms == pytest.approx(1.0)
    assert report.response_max_ms == pytest.approx(3.0)


def test_silence_of_the_ai_computer_is_not_a_response_time() -> None:
    bus = Bus().run(0.5)
    bus.command = None
    bus.run(2.0)
    bus.command = AiCommand()
    report = bus.run(0.5).check()
    assert report.response_max_ms == pytest.approx(1.0)


# ---------------------------------------------------------------- rule 1


def test_torque_and_brake_in_one_cycle_break_rule_1() -> None:
    bus = until_driving()
    report = bus.says(front_brake_pct=0.5).run(0.1).check()
    assert "rule 1" in rules(report)
    assert any("torque 100.0 Nm and brake 0.5 % together" in violation for violation in report.violations)


def test_torque_that_the_vcu_sees_before_the_brake_is_released_breaks_rule_1() -> None:
    bus = Bus().off().ready().go().run(3.1)
    bus.says(front_brake_pct=0.0, rear_brake_pct=0.0, rear_torque_nm=10.0).run(0.05)
    assert any("together" in violation for violation in bus.check().violations)


def test_torque_after_a_cycle_that_was_not_sent_whole_breaks_rule_1() -> None:
    bus = Bus().off().ready().go().run(3.1)
    bus.says(front_brake_pct=0.0, rear_brake_pct=0.0)
    bus.edit = lambda frames: [frames[0], frames[1], frames[4]]  # 0x512 and 0x513 are lost
    bus.run(0.01)
    bus.edit = list
    report = bus.says(rear_torque_nm=10.0).run(0.05).check()
    assert rules(report) == ["rule 1"]
    assert "torque rose after 0 complete cycles" in report.violations[0]
    assert report.incomplete_cycles == 1


def test_one_quiet_cycle_is_enough_only_when_the_car_echoes_it() -> None:
    def rise(cycles: int, *, echo: bool) -> WireReport:
        bus = Bus().off().ready().go().run(3.1)
        bus.says(front_brake_pct=0.0, rear_brake_pct=0.0)
        if not echo:
            bus.car_speaks = False
        bus.run(cycles / 100)
        return bus.says(rear_torque_nm=10.0).run(0.01).check()

    assert rules(rise(1, echo=True)) == []
    assert rules(rise(1, echo=False)) == ["rule 1"]
    assert rules(rise(2, echo=False)) == []


def test_a_brake_that_rises_without_a_torqueless_cycle_breaks_rule_1() -> None:
    bus = until_driving()
    report = bus.says(rear_torque_nm=0.0, front_brake_pct=50.0).run(0.1).check()
    assert rules(report) == ["rule 1"]
    assert "brake rose before a complete cycle without torque" in report.violations[0]


# ---------------------------------------------------------------- rule 2 and 10


@pytest.mark.parametrize("state", [AsState.AS_OFF, AsState.AS_READY, AsState.EMERGENCY_BRAKE, AsState.AS_FINISHED])
def test_torque_outside_as_driving_breaks_rule_2(state: AsState) -> None:
    bus = Bus().run(0.1).car(as_state=state).run(0.1)
    report = bus.says(front_torque_nm=0.1).run(0.1).check()
    assert "rule 2" in rules(report)
    assert any(f"front torque in {state.label}" in violation for violation in report.violations)


def test_torque_in_the_first_three_seconds_breaks_rule_2() -> None:
    def torque_after(seconds: float) -> WireReport:
        bus = Bus().off().car(as_state=AsState.AS_READY).run(5.0).go().run(seconds)
        return bus.says(rear_torque_nm=10.0).run(0.05).check()

    early = torque_after(2.98)
    assert rules(early) == ["rule 2"]
    assert "2.981 s after AS_DRIVING began" in early.violations[0]
    assert torque_after(3.0).ok


def test_torque_without_go_breaks_rule_2() -> None:
    report = until_driving().car(go_signal=False).run(0.1).check()
    assert rules(report) == ["rule 2"]
    assert "rear torque without the Go signal" in report.violations[0]


def test_torque_without_forward_breaks_rule_2() -> None:
    bus = until_driving()
    report = bus.says(direction=Direction.REVERSE).run(0.1).check()
    assert rules(report) == ["output table", "rule 2"]


def test_torque_with_an_emergency_latched_breaks_rule_2() -> None:
    report = until_driving().says(estop_request=True).run(0.1).check()
    assert rules(report) == ["rule 2"]


def test_torque_with_a_stale_0x520_breaks_rule_2() -> None:
    bus = until_driving()
    bus.car_speaks = False
    assert bus.run(0.05).check().ok
    assert rules(bus.run(0.06).check()) == ["rule 2"]


def test_torque_after_a_restart_in_the_middle_of_a_drive_breaks_rule_10() -> None:
    bus = until_driving()
    bus.says(rear_torque_nm=0.0).run(0.1)
    driving = bus.command
    bus.command = None
    bus.run(0.3)
    bus.command = driving
    bus.run(0.05)
    report = bus.says(rear_torque_nm=10.0).run(0.05).check()
    assert rules(report) == ["rule 10"]


def test_a_log_that_begins_in_the_middle_of_a_drive_is_judged_only_by_what_it_shows() -> None:
    bus = until_driving().run(0.2)
    bus.frames = bus.frames[-150:]
    assert bus.check().ok


# ---------------------------------------------------------------- rule 3


@pytest.mark.parametrize(
    "said", [{"direction": Direction.NEUTRAL}, {"mission_status": MissionStatus.FINISHED}], ids=["neutral", "finished"]
)
def test_neutral_or_finished_before_standstill_breaks_rule_3(said: dict[str, object]) -> None:
    bus = until_driving()
    bus.says(rear_torque_nm=0.0, steer_deg=0.0).run(0.05)
    assert rules(bus.says(**said).run(0.05).check()) == ["rule 3"]


def test_half_a_second_under_10_rpm_on_every_wheel_is_standstill() -> None:
    def finish_after(seconds: float, speeds: WheelSpeeds) -> list[str]:
        bus = until_driving()
        bus.says(rear_torque_nm=0.0, steer_deg=0.0).run(0.02)
        bus.speeds = speeds
        bus.run(seconds)
        return rules(bus.says(mission_status=MissionStatus.FINISHED).run(0.01).check())

    assert finish_after(0.49, WheelSpeeds(9, 9, 9, 9)) == ["rule 3"]
    assert finish_after(0.50, WheelSpeeds(9, 9, 9, 9)) == []
    assert finish_after(1.0, WheelSpeeds(9, 9, 10, 9)) == ["rule 3"]


def test_stale_wheel_speeds_are_no_standstill() -> None:
    def finish_without_speeds_for(seconds: float) -> list[str]:
        bus = until_driving().stop()
        until = len(bus.frames)
        bus.run(seconds).says(mission_status=MissionStatus.FINISHED).run(0.01)
        bus.frames = bus.frames[:until] + [one for one in bus.frames[until:] if one.can_id != 0x525]
        return rules(bus.check())

    assert finish_without_speeds_for(0.08) == []
    assert finish_without_speeds_for(0.10) == ["rule 3"]


# ---------------------------------------------------------------- rule 4


def test_steering_beyond_the_live_limit_breaks_rule_4() -> None:
    bus = until_driving()
    bus.angle_max_deg = 21.0
    bus.run(0.05)
    assert bus.says(steer_deg=21.0).run(0.05).check().ok
    assert rules(bus.says(steer_deg=-21.1).run(0.05).check()) == ["rule 4"]


def test_steering_out_of_as_driving_breaks_a_rule() -> None:
    ready = Bus().off().ready()
    assert rules(ready.says(steer_deg=0.1).run(0.05).check()) == ["rule 5"]
    finished = until_driving().stop().finish()
    assert rules(finished.says(steer_deg=0.1).run(0.05).check()) == ["rule 4"]


def test_torque_beyond_the_live_limit_breaks_rule_4() -> None:
    bus = until_driving()
    bus.torque_max_nm = 100.0
    assert bus.run(0.1).check().ok
    assert rules(bus.says(rear_torque_nm=100.1).run(0.05).check()) == ["rule 4"]


@pytest.mark.parametrize(("silent_s", "broken"), [(0.11, []), (0.14, ["rule 4"])])
def test_torque_by_a_limit_that_stopped_coming_100_ms_ago_breaks_rule_4(silent_s: float, broken: list[str]) -> None:
    bus = until_driving()
    last_ns = bus.t_ns - 10 * MS
    bus.run(silent_s)
    bus.frames = [frame for frame in bus.frames if frame.can_id != 0x522 or frame.t_ns <= last_ns]
    assert rules(bus.check()) == broken


@pytest.mark.parametrize("drives_anew", [True, False])
def test_steering_may_be_zero_at_once_where_a_drive_began_between_two_cycles(drives_anew: bool) -> None:
    bus = Bus().off().ready().driving()
    bus.says(steer_deg=16.0).run(0.5)
    spoken, bus.command = bus.command, None
    for state in (AsState.AS_OFF, AsState.AS_READY) if drives_anew else ():
        bus.car(as_state=state).run(0.01)
    bus.car(as_state=AsState.AS_DRIVING).run(0.05)
    bus.command = spoken
    bus.says(steer_deg=0.0).run(0.1)
    checker = WireChecker(CODEC, in_flight_ns=2 * MS, car=CARS["2026"])
    for frame in bus.frames:
        checker.on_frame(frame)
    assert any("turned by 16.0 deg" in violation for violation in checker.violations) is not drives_anew


def test_a_steering_limit_that_was_lowered_is_obeyed_at_once_and_is_no_turn_that_is_too_fast() -> None:
    for lowered_to_deg, too_fast in ((4.0, False), (30.0, True)):
        bus = until_driving()
        for step in range(41):
            bus.says(steer_deg=0.5 * step).run(0.02)
        bus.angle_max_deg = lowered_to_deg
        bus.says(steer_deg=4.0).run(0.05)
        checker = WireChecker(CODEC, in_flight_ns=2 * MS, car=CARS["2026"])
        for frame in bus.frames:
            checker.on_frame(frame)
        assert any("turned by 16.0 deg" in violation for violation in checker.violations) is too_fast


def test_a_limit_younger_than_20_ms_may_be_unseen() -> None:
    bus = until_driving()
    bus.torque_max_nm = 50.0
    assert bus.run(0.02).check().ok
    assert rules(bus.run(0.02).check()) == ["rule 4"]


@pytest.mark.parametrize(
    ("rpm", "most_nm"), [(300, 195.0), (301, 150.0), (401, 120.0), (501, 100.0), (601, 85.0), (701, 50.0)]
)
def test_torque_above_the_constant_power_schedule_breaks_rule_4(rpm: int, most_nm: float) -> None:
    bus = until_driving().says(rear_torque_nm=50.0).rolls(rpm).run(0.1)
    assert bus.says(rear_torque_nm=most_nm).run(0.05).check().ok
    if most_nm < 195.0:
        assert rules(bus.says(rear_torque_nm=most_nm + 0.1).run(0.05).check()) == ["rule 4"]


# ---------------------------------------------------------------- rules 5 to 9


@pytest.mark.parametrize("state", [AsState.AS_INIT, AsState.AS_OFF, AsState.AS_READY])
def test_more_than_selected_or_a_direction_in_an_idle_state_breaks_rule_5(state: AsState) -> None:
    bus = Bus().car(as_state=state).run(0.1)
    assert rules(bus.says(direction=Direction.FORWARD).run(0.05).check()) == ["rule 5"]
    bus = Bus().car(as_state=state).run(0.1)
    assert rules(bus.says(mission_status=MissionStatus.RUNNING).run(0.05).check()) == ["rule 5"]


def test_an_emergency_request_that_is_released_breaks_rule_6() -> None:
    bus = until_driving().says(rear_torque_nm=0.0, estop_request=True).run(0.05)
    assert rules(bus.says(estop_request=False).run(0.05).check()) == ["rule 6"]


def test_a_new_process_knows_nothing_of_the_old_ones_emergency() -> None:
    bus = until_driving().says(rear_torque_nm=0.0, steer_deg=0.0, estop_request=True).run(0.05)
    bus.car(as_state=AsState.EMERGENCY_BRAKE)
    bus.command = None
    bus.run(0.5)
    bus.says(estop_request=False, mission_status=MissionStatus.RUNNING, direction=Direction.FORWARD)
    assert bus.run(0.05).check().ok


def test_a_frame_of_the_ai_computer_that_makes_no_sense_breaks_rule_7() -> None:
    bus = Bus().run(0.1)
    bus.frames.append(Frame(0x511, b"\x00", bus.t_ns))
    assert rules(bus.check()) == ["rule 7"]


@pytest.mark.parametrize(
    "frame",
    [Frame(0x7FF, b""), Frame(0x120, bytes(8)), Frame(0x510, bytes(8), extended=True), Frame(0x520, b"", remote=True)],
    ids=str,
)
def test_what_nobody_on_the_bus_should_send_breaks_rule_8(frame: Frame) -> None:
    bus = Bus().run(0.1)
    bus.frames.append(replace(frame, t_ns=bus.t_ns))
    report = bus.check()
    assert rules(report) == ["rule 8"]
    assert f"0x{frame.can_id:03X}" in report.violations[0]


def test_a_handshake_that_is_not_the_last_one_received_breaks_rule_9() -> None:
    bus = Bus().run(0.2)
    bus.answer_ns = 2 * MS
    bus.echo_lag = 1
    assert rules(bus.run(0.05).check()) == ["rule 9"]


def test_a_handshake_bit_that_came_less_than_2_ms_before_may_be_unseen() -> None:
    bus = Bus().run(0.2)
    bus.answer_ns = 2 * MS - 1
    bus.echo_lag = 1
    assert bus.run(0.05).check().ok


@pytest.mark.parametrize(("age_ns", "broken"), [(2 * MS - 1, []), (2 * MS, ["rule 9"])])
def test_the_very_first_handshake_bit_may_be_unseen_for_2_ms_too(age_ns: int, broken: list[str]) -> None:
    """The AI computer spoke before the car did, and its frame crosses the car's first one."""
    checker = WireChecker(CODEC)
    first = CODEC.encode(VcuStatus(handshake=True, as_state=AsState.AS_OFF))
    checker.on_frame(replace(first, t_ns=1_000 * MS))
    for frame in CODEC.encode_command(AiCommand(), 1_000 * MS + age_ns):
        checker.on_frame(frame)
    assert rules(checker.report()) == broken


def test_two_cycles_less_than_8_ms_apart_are_found() -> None:
    bus = Bus().run(0.1)
    bus.answer_ns = 8 * MS
    bus.run(0.01)
    bus.answer_ns = MS
    report = bus.run(0.05).check()
    assert rules(report) == ["interval"]
    assert report.shortest_cycle_ms == pytest.approx(3.0)


def test_a_lasting_violation_is_reported_once_and_again_when_it_comes_back() -> None:
    bus = until_driving()
    for _ in range(2):
        bus.car(go_signal=False).run(0.2).car(go_signal=True).run(0.2)
    assert rules(bus.check()) == ["rule 2", "rule 2"]


def test_error_frames_are_counted_and_are_nobodys_violation() -> None:
    bus = Bus().run(0.1)
    bus.frames.append(Frame(0x040, bytes(8), bus.t_ns, error=True))
    report = bus.check()
    assert report.ok
    assert report.error_frames == 1


# ---------------------------------------------------------------- logs


def candump(frames: Iterable[Frame], suffix: str = "") -> str:
    return "".join(f"({one.t_ns / 1e9:.6f}) vcan0 {one}{suffix}\n" for one in frames)


@pytest.mark.parametrize("suffix", ["", " R", " T"], ids=["candump", "received", "sent"])
def test_a_candump_log_is_checked_like_the_bus_itself(tmp_path: Path, suffix: str) -> None:
    bus = until_driving().stop().finish()
    log = tmp_path / "run.log"
    log.write_text(candump(bus.frames, suffix))
    assert check_candump(log, CODEC) == bus.check()


def test_a_gzipped_log_is_read_as_it_is(tmp_path: Path) -> None:
    log = tmp_path / "run.log.gz"
    with gzip.open(log, "wt") as out:
        out.write(candump(Bus().run(0.1).frames))
    assert check_candump(log, CODEC).cycles == 10


def test_the_kinds_of_lines_of_a_log(tmp_path: Path) -> None:
    log = tmp_path / "kinds.log"
    log.write_text(
        "(1436509052.249713) vcan0 511#9E07A00F\n"
        "\n"
        "(1436509052.249714) vcan0 00000510#00 R\n"
        "(1436509052.249715) vcan0 520#R8\n"
        "(1436509052.249716) can0 20000004#0001000000000000\n"
        "(1.5) can0 080#\n"
    )
    first = 1436509052_249713000
    assert list(read_candump(log)) == [
        Frame(0x511, bytes.fromhex("9E07A00F"), first),
        Frame(0x510, b"\x00", first + 1000, extended=True),
        Frame(0x520, b"", first + 2000, remote=True),
        Frame(0x004, bytes.fromhex("0001000000000000"), first + 3000, error=True),
        Frame(0x080, b"", 1_500_000_000),
    ]


@pytest.mark.parametrize("line", ["rubbish", "(1.0) vcan0 511", "(1.0) vcan0 5G1#00", "(x) vcan0 511#00"])
def test_a_line_that_is_no_log_is_refused_with_its_number(tmp_path: Path, line: str) -> None:
    log = tmp_path / "bad.log"
    log.write_text(f"(1.0) vcan0 511#9E07A00F\n{line}\n")
    with pytest.raises(LogError, match=r"bad\.log:2: "):
        check_candump(log, CODEC)


def test_the_report_reads_as_sentences() -> None:
    good = str(until_driving().stop().finish().check())
    assert "no rule broken" in good
    assert "AS_DRIVING at" in good
    bad = str(until_driving().says(estop_request=True).run(0.1).check())
    assert "s: rule 2: rear torque with ESTOP_REQUEST" in bad
