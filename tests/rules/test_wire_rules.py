"""The bus checker as the sender's own witness: exact, with car and venue known, and from the first frame on."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from fsai_hil.rules.checker import WireChecker
from fsai_vcu.core.limits import OperationalLimits
from fsai_vcu.core.vehicle.parameters import CARS
from fsai_vcu.interface.codec import Codec
from fsai_vcu.interface.enums import Ami, AsState, Direction, MissionStatus, ShutdownCause
from fsai_vcu.interface.messages import (
    AiCommand,
    Faults,
    Image,
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
SELECTED = AiCommand(mission_status=MissionStatus.SELECTED)
RUNNING = AiCommand(mission_status=MissionStatus.RUNNING, direction=Direction.FORWARD)


class Sender:
    """Car and AI computer by hand, a cycle every 10 ms; the checker sees what the AI computer sees."""

    def __init__(self, **options: Any) -> None:
        self.now_ns = 1000 * MS
        self.checker = WireChecker(
            CODEC,
            in_flight_ns=0,
            handshake_in_flight_ns=0,
            clock_slack_ns=0,
            car=CARS["2026"],
            from_start=True,
            **options,
        )
        self.status = VcuStatus(as_state=AsState.AS_OFF, ami=Ami.TRACKDRIVE)
        self.rpm = 0
        self.torque_max_nm = 195.0
        self.last = AiCommand()

    def hears(self, image: Image) -> None:
        self.checker.on_frame(CODEC.encode(replace(image, t_rx_ns=self.now_ns)))

    def cycle(self, command: AiCommand, cycles: int = 1, *, car: bool = True, frames: int = 5) -> Sender:
        for _ in range(cycles):
            self.now_ns += 10 * MS
            if car:
                self.status = replace(self.status, handshake=not self.status.handshake)
                self.hears(self.status)
                self.hears(VcuDriveFront(torque_max_nm=self.torque_max_nm))
                self.hears(VcuDriveRear(torque_max_nm=self.torque_max_nm))
                self.hears(VcuSteer(angle_max_deg=30.0))
                self.hears(VcuBrake(0.0, self.last.front_brake_pct, 0.0, self.last.rear_brake_pct))
                self.hears(WheelSpeeds(self.rpm, self.rpm, self.rpm, self.rpm))
            said = replace(command, handshake=self.status.handshake)
            for frame in CODEC.encode_command(said, self.now_ns)[:frames]:
                self.checker.on_frame(frame)
            self.last = command
        return self

    def state(self, as_state: AsState) -> Sender:
        self.status = replace(self.status, as_state=as_state, go_signal=as_state is AsState.AS_DRIVING)
        return self

    def driving(self) -> Sender:
        self.cycle(SELECTED, 3).state(AsState.AS_READY).cycle(SELECTED, 495)
        return self.state(AsState.AS_DRIVING).cycle(RUNNING, 301)

    @property
    def rules(self) -> list[str]:
        return [violation.split(": ")[1] for violation in self.checker.violations]


def drive(torque_nm: float = 50.0, steer_deg: float = 0.0, rpm: int = 500) -> AiCommand:
    return replace(RUNNING, rear_torque_nm=torque_nm, rear_motor_speed_max_rpm=rpm, steer_deg=steer_deg)


def test_an_ordinary_drive_breaks_no_rule() -> None:
    sender = Sender().driving().cycle(drive(), 20)
    sender.rpm = 100
    assert sender.cycle(drive(), 50).rules == []


# ---------------------------------------------------------------- rule 4, by car and venue


def test_steering_faster_than_the_car_turns_breaks_rule_4() -> None:
    assert Sender().driving().cycle(drive(steer_deg=0.4)).cycle(drive(steer_deg=0.8)).rules == []
    assert Sender().driving().cycle(drive(steer_deg=0.6)).rules == ["rule 4"]


def test_a_limit_that_the_car_lowers_is_no_haste() -> None:
    sender = Sender().driving()
    for step in range(1, 26):
        sender.cycle(drive(steer_deg=round(0.4 * step, 1)))
    sender.now_ns += 10 * MS
    sender.hears(VcuSteer(angle_max_deg=2.0))
    sender.cycle(drive(steer_deg=2.0), car=False)
    assert sender.rules == []


def test_at_the_orderly_end_at_rest_steering_is_zero_at_once() -> None:
    sender = Sender().driving().cycle(drive(0.0, 0.4)).cycle(drive(0.0, 0.8))
    assert sender.cycle(replace(RUNNING, direction=Direction.NEUTRAL)).rules == []
    assert sender.cycle(replace(RUNNING, direction=Direction.NEUTRAL, steer_deg=0.8)).rules == ["rule 4"]


def test_steering_torque_and_motor_speed_beyond_what_the_venue_allows_break_rule_4() -> None:
    limits = OperationalLimits(max_speed_mps=2.0, max_axle_torque_nm=40.0, max_steer_deg=0.3)
    assert Sender(limits=limits).driving().cycle(drive(40.0, 0.3, 260)).rules == []
    for beyond in (drive(40.1, 0.3, 260), drive(40.0, 0.4, 260), drive(40.0, 0.3, 270)):
        assert Sender(limits=limits).driving().cycle(beyond).rules == ["rule 4"]


def test_torque_on_an_axle_without_a_motor_breaks_rule_4() -> None:
    assert Sender().driving().cycle(replace(drive(), front_torque_nm=1.0)).rules == ["rule 4"]


# ---------------------------------------------------------------- rules 1, 2, 6, 9, 10, from the first frame on


def test_an_echo_that_is_older_than_the_quiet_cycle_does_not_release_torque() -> None:
    braked = replace(RUNNING, front_brake_pct=30.0, rear_brake_pct=30.0)

    def rise(*, echo_after: bool) -> list[str]:
        sender = Sender().driving().cycle(braked, 3)
        sender.hears(VcuBrake())
        sender.cycle(RUNNING, car=False)
        sender.now_ns += 10 * MS
        if echo_after:
            sender.hears(VcuBrake())
        return sender.cycle(drive(), car=False).rules

    assert rise(echo_after=True) == []
    assert rise(echo_after=False) == ["rule 1"]


def test_the_first_brake_of_a_process_waits_for_a_whole_cycle_without_torque() -> None:
    braked = replace(AiCommand(), front_brake_pct=30.0, rear_brake_pct=30.0)
    assert Sender().state(AsState.AS_READY).cycle(braked).rules == ["rule 1"]
    assert Sender().state(AsState.AS_READY).cycle(AiCommand(), frames=4).cycle(braked).rules == ["rule 1"]
    assert Sender().state(AsState.AS_READY).cycle(AiCommand()).cycle(braked).rules == []


def test_a_second_without_0x520_breaks_the_sequence() -> None:
    def after_silence(cycles: int) -> list[str]:
        sender = Sender().driving().cycle(RUNNING, cycles, car=False)
        return sender.cycle(RUNNING, 301).cycle(drive()).rules

    assert after_silence(98) == []
    assert after_silence(99) == ["rule 10"]


def test_a_lost_bus_and_a_restart_break_the_sequence() -> None:
    lost = Sender().driving()
    lost.checker.on_bus_lost()
    assert lost.cycle(drive()).rules == ["rule 10"]
    restarted = Sender().driving()
    restarted.checker.restarted()
    # What was acknowledged by the process before it is not known to this one either.
    assert restarted.cycle(RUNNING, 301).cycle(drive()).rules == ["rule 2", "rule 10"]


def test_the_vcu_keeps_the_torque_of_a_process_that_died() -> None:
    sender = Sender().driving().cycle(drive(), 3)
    sender.checker.restarted()
    assert sender.cycle(replace(RUNNING, front_brake_pct=80.0, rear_brake_pct=80.0)).rules == ["rule 1"]


def test_before_anything_is_heard_there_is_nothing_to_echo_and_nothing_to_drive_on() -> None:
    checker = Sender().checker
    for frame in CODEC.encode_command(replace(drive(), handshake=True, steer_deg=1.0), 1000 * MS):
        checker.on_frame(frame)
    found = {violation.split(": ")[1] for violation in checker.violations}
    assert {"rule 9", "rule 5", "rule 4", "rule 2"} <= found


def test_an_emergency_cleared_in_as_off_may_first_be_missing_in_the_next_state() -> None:
    asking = replace(AiCommand(), estop_request=True)
    assert Sender().cycle(asking).state(AsState.AS_READY).cycle(AiCommand()).rules == []
    still = Sender().cycle(asking).state(AsState.AS_READY).cycle(asking).cycle(AiCommand())
    assert still.rules == ["rule 6"]


# ---------------------------------------------------------------- output table


@pytest.mark.parametrize(
    ("as_state", "said"),
    [
        (AsState.AS_FINISHED, RUNNING),
        (AsState.AS_FINISHED, replace(RUNNING, mission_status=MissionStatus.FINISHED)),
        (AsState.EMERGENCY_BRAKE, replace(RUNNING, mission_status=MissionStatus.FINISHED)),
        (AsState.EMERGENCY_BRAKE, replace(RUNNING, front_brake_pct=1.0)),
        (AsState.AS_OFF, replace(AiCommand(), front_brake_pct=1.0)),
        (AsState.AS_INIT, replace(AiCommand(), rear_brake_pct=1.0)),
        (AsState.AS_DRIVING, replace(RUNNING, mission_status=MissionStatus.SELECTED)),
        (AsState.AS_DRIVING, replace(RUNNING, direction=Direction.REVERSE)),
    ],
)
def test_what_the_output_table_does_not_say_is_found(as_state: AsState, said: AiCommand) -> None:
    sender = Sender().cycle(AiCommand(), 3)
    sender.rpm = 100
    assert "output table" in sender.state(as_state).cycle(said, 2).rules


def test_in_emergency_brake_neutral_is_for_wheels_that_stand() -> None:
    neutral = replace(RUNNING, direction=Direction.NEUTRAL)
    assert Sender().cycle(AiCommand(), 60).state(AsState.EMERGENCY_BRAKE).cycle(neutral).rules == []
    moving = Sender().cycle(AiCommand(), 60).state(AsState.EMERGENCY_BRAKE)
    moving.rpm = 10
    assert moving.cycle(neutral).rules == ["output table"]


# ---------------------------------------------------------------- how a drive begins, and what 0x520 shows


def test_torque_without_an_acknowledged_mission_breaks_rule_2() -> None:
    sender = Sender()
    sender.status = replace(sender.status, ami=Ami.NOT_SELECTED)
    assert sender.driving().cycle(drive()).rules == ["rule 2"]
    unsaid = Sender().cycle(AiCommand(), 3).state(AsState.AS_READY).cycle(AiCommand(), 495)
    assert unsaid.state(AsState.AS_DRIVING).cycle(RUNNING, 301).cycle(drive()).rules == ["rule 2"]


@pytest.mark.parametrize(
    ("cycles", "go", "rules"), [(491, False, []), (490, False, ["rule 10"]), (495, True, ["rule 10"])]
)
def test_less_than_5_s_of_as_ready_without_go_is_no_sequence(cycles: int, go: bool, rules: list[str]) -> None:
    sender = Sender().cycle(SELECTED, 3).state(AsState.AS_READY)
    sender.status = replace(sender.status, go_signal=go)
    sender.cycle(SELECTED, cycles).state(AsState.AS_DRIVING).cycle(RUNNING, 301)
    assert sender.cycle(drive()).rules == rules


def test_torque_after_an_unknown_as_state_breaks_rule_2() -> None:
    sender = Sender().driving().cycle(drive())
    sender.now_ns += 10 * MS
    frame = CODEC.encode(replace(sender.status, t_rx_ns=sender.now_ns))
    sender.checker.on_frame(replace(frame, data=frame.data[:2] + b"\x4f" + frame.data[3:]))
    assert sender.cycle(drive(), car=False).rules == ["rule 2"]


@pytest.mark.parametrize(
    "shown",
    [
        {"as_switch": False},
        {"ts_switch": False},
        {"shutdown_request": True},
        {"faults": Faults(ebs=True)},
        {"shutdown_cause": ShutdownCause.EBS_FAULT},
    ],
    ids=lambda shown: next(iter(shown)),
)
def test_torque_after_a_mark_turned_in_as_driving_breaks_a_rule(shown: dict[str, Any]) -> None:
    turning = Sender()
    turning.status = replace(turning.status, as_switch=True, ts_switch=True)
    turning.driving().cycle(drive())
    turning.status = replace(turning.status, **shown)
    assert turning.cycle(drive()).rules == ["reactions"]
    old = Sender()
    old.status = replace(old.status, **{"as_switch": True, "ts_switch": True, **shown})
    assert old.driving().cycle(drive()).rules == []
