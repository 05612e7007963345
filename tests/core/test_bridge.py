"""The bridge end to end: frames in, frames out, in virtual time; every cycle is held to the rules on the wire."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from typing import Any

import pytest
from msgspec.structs import replace
from supervision_rig import CYCLE, MS, Rig, S, codec_of, driven

from fsai_vcu.core.bridge import Bridge, BridgeConfig
from fsai_vcu.core.command import VehicleCommand
from fsai_vcu.core.report import IDS_KEPT
from fsai_vcu.core.vehicle.parameters import ADS_DV_2026
from fsai_vcu.interface.codec import Codec
from fsai_vcu.interface.database import dbc_dir
from fsai_vcu.interface.enums import Ami, AsState, Direction, EbsState, MissionStatus, OpState, ShutdownCause, TsState
from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.messages import (
    AiCommand,
    Faults,
    RotationB,
    VcuStatus,
    VcuSteer,
    VcuSystemStatus,
    WheelSpeeds,
)
from fsai_vcu.interface.revisions import revision

DRIVING = AsState.AS_DRIVING
READY = AsState.AS_READY


def brake_to_rest(rig: Rig) -> None:
    """The wheels slow down with 4 m/s2 while the car is asked to brake."""
    asked = rig.asked
    if asked is not None and asked.brake_requested:
        rig.rpm = max(0, rig.wheels_rpm[0] - 2)


AS_STATE, AMI = (2, 0), (2, 4)
"""Byte and shift of a field of 0x520."""


def say_raw(rig: Rig, byte: int, shift: int, raw: int) -> None:
    """A 0x520 in which one field of four bits is `raw`, whatever its table has."""
    data = bytearray(rig.codec.encode(rig.status).data)
    data[byte] = data[byte] & ~(0xF << shift) | raw << shift
    rig.receive(Frame(0x520, bytes(data), rig.now_ns))


# ---------------------------------------------------------------- the life of a run


@pytest.mark.parametrize("revision_name", ["2021", "2026"])
def test_a_run_from_as_off_to_as_finished_reports_no_reason(revision_name: str) -> None:
    rig = Rig(revision_name=revision_name).ready()
    assert rig.sent.brake_requested and rig.sent.direction is Direction.NEUTRAL
    rig.say_state(DRIVING, go_signal=True)
    asked = rig.step()
    assert asked is not None
    assert (asked.mission_status, asked.direction) == (MissionStatus.RUNNING, Direction.FORWARD)
    rig.command = VehicleCommand(0, 0, throttle=0.4, speed_limit_mps=8.0, steering_rad=0.1)
    rig.run_ms(2990)
    assert not rig.sent.torque_requested and rig.sent.brake_requested and rig.sent.steer_deg == 0.0
    rig.run_ms(500)
    assert rig.sent.torque_requested and rig.sent.steer_deg == 5.7 and not rig.sent.brake_requested
    rig.rpm = 300
    rig.run_ms(5000)
    rig.command = replace(rig.command, throttle=0.0, mission_finished=True, laps=1)
    rig.alive = brake_to_rest
    rig.run_ms(4000)
    assert (rig.sent.mission_status, rig.sent.direction) == (MissionStatus.FINISHED, Direction.NEUTRAL)
    rig.say_state(AsState.AS_FINISHED)
    rig.run_ms(1000)
    assert rig.sent.mission_status is MissionStatus.FINISHED and rig.sent.lap_counter == 1
    assert dict(rig.report.reason_counts) == {}
    assert rig.report.mode == "autonomous"


def test_the_next_mission_needs_no_restart() -> None:
    rig = driven()
    first_run = rig.report.run.run_id
    rig.run_ms(2000)
    assert rig.report.motion.distance_m > 5.0
    rig.alive = brake_to_rest
    rig.command = replace(rig.command, mission_finished=True)  # type: ignore[type-var]
    rig.run_ms(3000)
    rig.command = VehicleCommand(0, 0)
    for as_state in (AsState.AS_FINISHED, AsState.AS_OFF):
        rig.say_state(as_state, go_signal=False)
        rig.step(2)
    assert rig.report.run.run_id == first_run + 1 and rig.report.motion.distance_m < 0.1
    assert rig.sent.mission_status is MissionStatus.SELECTED
    rig.say_state(AsState.AS_OFF, ami=Ami.SKIDPAD)
    rig.confirming = False
    rig.step(2)
    assert rig.report.run.mission is Ami.SKIDPAD and rig.sent.mission_status is MissionStatus.NOT_SELECTED
    rig.confirming = True
    rig.step(2)
    assert rig.sent.mission_status is MissionStatus.SELECTED
    rig.driving()
    assert dict(rig.report.reason_counts) == {}


# ---------------------------------------------------------------- start, listening, silence


def test_a_bridge_that_is_given_a_state_goes_on_from_it() -> None:
    one, other = driven(), Rig()
    other.bridge.on_frame(Frame(0x525, bytes(8), 0))  # what it has received itself is forgotten
    other.bridge.state = one.bridge.state
    other, other.bridge = one.copied(), other.bridge
    for rig in (one, other):
        rig.log.clear()
        rig.run_ms(200)
        rig.mute.add(VcuSteer)
        rig.run_ms(500)
    assert one.log == other.log
    assert one.bridge.state == other.bridge.state
    assert one.sent.estop_request


def test_on_start_a_process_listens_for_200_ms_and_then_sends() -> None:
    rig = Rig(start_ns=5 * S)
    for _ in range(20):
        assert rig.step() is None
    rig.now_ns = 5 * S + 10 * MS + 200 * MS - 1
    assert rig.cycle() is None
    rig.now_ns += 1
    assert rig.cycle() is not None


def test_started_in_as_driving_it_brakes_the_car_to_rest() -> None:
    rig = Rig()
    rig.say_state(DRIVING, go_signal=True)
    rig.rpm = 300
    rig.alive = brake_to_rest
    rig.command = VehicleCommand(0, 0, throttle=1.0, speed_limit_mps=10.0)
    rig.run_ms(230)
    assert (rig.sent.mission_status, rig.sent.direction) == (MissionStatus.RUNNING, Direction.FORWARD)
    rig.step()
    assert rig.sent.brake_requested
    rig.run_ms(3000)
    assert (rig.sent.mission_status, rig.sent.direction) == (MissionStatus.FINISHED, Direction.NEUTRAL)
    assert not any(asked.torque_requested for _, asked in rig.log)
    assert rig.report.emergency is None


def test_a_process_that_only_listens_never_sends() -> None:
    rig = Rig(BridgeConfig(listen_only=True, autonomous_at_power_up=True))
    for as_state in AsState:
        rig.say_state(as_state)
        rig.run_ms(500)
    rig.receive(Frame(0x510, bytes(8), rig.now_ns))  # of the bridge that drives: no intruder
    assert rig.log == [] and rig.report.listen_only and "intruder" not in rig.report.reason_counts
    done, message = rig.bridge.emergency_brake("now", rig.now_ns)
    assert not done and "listen_only" in message


def test_before_the_car_speaks_nothing_but_zeros_go_out() -> None:
    rig = Rig()
    rig.off = True
    rig.run_ms(1000)
    assert rig.sent == AiCommand()


# ---------------------------------------------------------------- the handshake (rule 9)


def test_the_handshake_of_an_invalid_0x520_is_echoed_at_once() -> None:
    rig = Rig().wake()
    for bit in (False, True, False, True):
        rig.now_ns += CYCLE
        rig.status = replace(rig.status, handshake=bit)
        say_raw(rig, *AS_STATE, 15)
        assert rig.cycle() is not None and rig.sent.handshake == bit
    assert rig.report.problem_counts


def test_the_response_time_is_measured() -> None:
    rig = Rig().wake()
    rig.step()
    assert rig.report.response_ns == 0
    rig.now_ns += 7 * MS
    rig.say(replace(rig.status, handshake=True))
    rig.now_ns += 3 * MS
    rig.cycle()
    assert rig.report.response_ns == 3 * MS
    rig.step()
    assert (rig.report.response_ns, rig.report.response_max_ns) == (0, 3 * MS)


# ---------------------------------------------------------------- graded reactions, on the bus


def zero_torque(asked: AiCommand) -> bool:
    return not asked.torque_requested


def braking(asked: AiCommand) -> bool:
    return asked.brake_requested


def estop(asked: AiCommand) -> bool:
    return asked.estop_request


@pytest.mark.parametrize(
    ("lost", "latencies_ms"),
    [
        (VehicleCommand, {zero_torque: 100, braking: 300}),
        (VcuStatus, {zero_torque: 50, braking: 100, estop: 100}),
        (WheelSpeeds, {zero_torque: 100, braking: 110, estop: 300}),  # a cycle of zeros between torque and brake
        (VcuSteer, {zero_torque: 100, braking: 110, estop: 300}),
    ],
)
def test_what_is_lost_is_answered_in_its_time(lost: type, latencies_ms: dict[Callable[[AiCommand], bool], int]) -> None:
    """Counted on the bus, from the last good 10 ms on."""
    rig = driven()
    last_good_ns = rig.now_ns
    if lost is VehicleCommand:
        rig.command = None
    rig.mute = {lost}
    rig.run_ms(700)
    for until, latency_ms in latencies_ms.items():
        assert rig.latency_ns(last_good_ns, until) == latency_ms * MS


def test_a_lost_command_stops_the_car_and_ends_in_manual_at_rest() -> None:
    rig = driven(rpm=300)
    rig.command = None
    rig.alive = brake_to_rest
    rig.run_ms(200)
    assert rig.report.reasons == ("command_stale",)
    assert rig.report.sentences == (
        "the vehicle command is stale: it stopped coming, or the data behind it is too old (no command for 200 ms)",
    )
    rig.run_ms(3000)
    assert (rig.sent.mission_status, rig.report.mode) == (MissionStatus.FINISHED, "manual")
    assert rig.report.emergency is None and rig.report.reason_counts == {"command_stale": 1}


def test_a_stuck_steering_stops_the_car_then_is_an_emergency() -> None:
    rig = driven()
    rig.angle_deg = 0.0
    rig.command = replace(rig.command, steering_rad=math.radians(20.0))  # type: ignore[type-var]
    rig.alive = brake_to_rest
    since_ns = rig.now_ns
    rig.run_ms(1200)
    stop_ns, estop_ns = rig.latency_ns(since_ns, braking), rig.latency_ns(since_ns, estop)
    assert stop_ns is not None and 300 * MS < stop_ns < 550 * MS
    assert estop_ns is not None and 600 * MS < estop_ns < 850 * MS
    assert "steering_implausible" in rig.report.reason_counts


def test_an_odd_wheel_stops_the_car_then_is_an_emergency() -> None:
    rig = driven(rpm=300)
    rig.run_ms(1000)  # the holding brake is long forgotten
    rig.rpm = (0, 300, 300, 300)
    since_ns = rig.now_ns + CYCLE
    rig.run_ms(700)
    assert rig.latency_ns(since_ns, zero_torque) == 300 * MS
    assert rig.latency_ns(since_ns, braking) == 310 * MS
    assert rig.latency_ns(since_ns, estop) == 600 * MS
    assert "front left 0 rpm of 0, " in (rig.report.emergency or "")


def test_in_static_inspections_each_wheel_turns_for_itself() -> None:
    rig = Rig()
    rig.status = replace(rig.status, ami=Ami.STATIC_INSPECTION_A)
    rig.driving(rpm=200)
    rig.command = replace(rig.command, throttle=0.0)  # type: ignore[type-var]
    for rpm in (250, 500, 750, 1000):
        rig.rpm = (0, 0, rpm, 0)
        rig.step()
    rig.run_ms(2500)
    assert rig.report.stopping is None and dict(rig.report.reason_counts) == {}


# ---------------------------------------------------------------- what was believed without being asked for


EDGES: list[tuple[dict[str, Any], str, str]] = [
    ({"as_switch": False}, "as_switch_off", ""),
    ({"ts_switch": False}, "ts_switch_off", ""),
    ({"shutdown_request": True}, "shutdown_requested", ""),
    ({"faults": Faults(hvil_open=True)}, "fault_bit", "HVIL_OPEN_FAULT"),
    ({"shutdown_cause": ShutdownCause.EBS_FAULT}, "shutdown_cause", "EBS_FAULT"),
    ({"ts_state": TsState.TS_FAULT, "op_state": OpState.OP_FAULT}, "state_fault", "TS_STATE, OP_STATE"),
]
AMI_TURNED: tuple[dict[str, Any], str, str] = ({"ami": Ami.SKIDPAD}, "ami_changed", "TRACKDRIVE to SKIDPAD")


@pytest.mark.parametrize(("change", "slug", "detail"), [*EDGES, AMI_TURNED])
def test_what_changes_in_as_driving_stops_the_car(change: dict[str, Any], slug: str, detail: str) -> None:
    rig = driven()
    since_ns = rig.now_ns + CYCLE
    rig.status = replace(rig.status, **change)
    rig.step(2)
    assert rig.latency_ns(since_ns, zero_torque) == 0 and rig.latency_ns(since_ns, braking) == CYCLE
    assert rig.report.reason_counts == {slug: 1} and rig.report.reason_details == {slug: detail}
    assert rig.report.stopping is not None and rig.report.stopping.endswith(detail)


def test_what_changes_before_as_driving_stops_nothing() -> None:
    rig = Rig().ready()
    for change, _, _ in EDGES:
        rig.status = replace(rig.status, **change)
        rig.step(2)
    rig.say_state(DRIVING, go_signal=True)
    rig.run_ms(3200)
    assert dict(rig.report.reason_counts) == {} and rig.report.stopping is None


def test_an_unknown_as_state_takes_torque_away_at_once() -> None:
    rig = driven()
    rig.alive = lambda rig: say_raw(rig, *AS_STATE, 15)
    rig.step()
    assert not rig.sent.torque_requested and rig.report.reasons == ("as_state_unknown",)
    assert "AS_STATE 15" in rig.report.reason_details["as_state_unknown"]
    assert not rig.report.vehicle.status_known
    rig.alive = lambda rig: None
    rig.run_ms(150)
    assert rig.report.vehicle.status_known and rig.sent.torque_requested
    assert rig.report.reasons == () and rig.report.stopping is None


@pytest.mark.parametrize("raw", [5, 9, 15])
@pytest.mark.parametrize(("name", "byte", "shift"), [("OP_STATE", 0, 4), ("TS_STATE", 3, 4), ("EBS_STATE", 4, 4)])
def test_a_state_of_fault_or_of_no_table_stops_the_car(name: str, byte: int, shift: int, raw: int) -> None:
    rig = driven()
    rig.alive = lambda rig: say_raw(rig, byte, shift, raw)
    rig.step()
    assert not rig.sent.torque_requested
    assert rig.report.stopping is not None and rig.report.stopping.endswith(f"FAULT in AS_DRIVING: {name}")


def test_an_ami_of_no_table_counts_as_none() -> None:
    rig = driven()
    say_raw(rig, *AMI, 12)
    assert rig.report.stopping is not None and rig.report.stopping.endswith("TRACKDRIVE to NOT_SELECTED")


def test_a_vcu_that_never_sets_its_states_is_not_stopped() -> None:
    """The official simulator leaves OP_STATE, TS_STATE and EBS_STATE at 0."""
    rig = Rig()
    rig.status = replace(rig.status, op_state=OpState.OP_INIT, ts_state=TsState.TS_INIT, ebs_state=EbsState.EBS_INIT)
    rig.driving()
    rig.run_ms(1000)
    assert rig.sent.torque_requested and dict(rig.report.reason_counts) == {}


def test_a_command_ages_from_arrival_not_from_its_datas_stamp() -> None:
    """A cycle that acts on data of 499 ms has a command of 10 ms."""
    rig = driven()
    asks, rig.command = rig.command, None
    assert asks is not None
    for _ in range(50):
        old = replace(asks, t_sensor_ns=rig.now_ns - 489 * MS, run_id=rig.bridge.run.run_id)
        assert rig.bridge.on_command(old, rig.now_ns) == ()
        rig.step()
    assert rig.sent.torque_requested and dict(rig.report.reason_counts) == {}


def test_a_mission_never_sent_whole_is_not_acknowledged() -> None:
    rig = Rig()
    rig.complete = False
    rig.ready()
    rig.complete = True
    rig.say_state(DRIVING, go_signal=True)
    rig.step()
    assert rig.report.reason_counts == {"no_mission": 1} and "SELECTED" in (rig.report.stopping or "")


def test_wheel_speeds_not_believed_are_as_if_missing() -> None:
    rig, words = driven(rpm=200), "the rear right wheel reads more than 1250 rpm"
    speed_mps, since_ns = rig.report.motion.speed_mps, rig.now_ns
    data = struct.pack("<4H", 200, 200, 200, 1251)  # the codec refuses to encode it
    rig.mute = {WheelSpeeds}
    rig.alive = lambda rig: rig.receive(Frame(0x525, data, rig.now_ns))
    rig.run_ms(90)
    assert rig.report.vehicle.speeds == WheelSpeeds(200, 200, 200, 200, t_rx_ns=since_ns)
    assert rig.report.motion.speed_mps == speed_mps and dict(rig.report.reason_counts) == {}
    assert rig.report.problem_counts == {f"VCU2AI_Speeds is not believed: {words}": 9}
    assert rig.sent.torque_requested
    rig.run_ms(300)
    assert rig.latency_ns(since_ns, zero_torque) == 100 * MS and rig.latency_ns(since_ns, estop) == 300 * MS
    assert set(rig.report.reason_counts) == {"wheels_stale"} and words in (rig.report.stopping or "")


def test_wheels_that_read_0_while_their_counts_run_never_finish() -> None:
    rig = driven(rpm=200)
    rig.rpm, rig.pulse_rpm = (0, 0, 0, 0), (200, 200, 200, 200)
    rig.command = replace(rig.command, throttle=0.0, mission_finished=True)  # type: ignore[type-var]
    rig.run_ms(1000)
    assert all(asked.mission_status is MissionStatus.RUNNING for t, asked in rig.log[-100:])
    assert rig.sent.estop_request and "while its pulse count runs" in (rig.report.emergency or "")


@pytest.mark.parametrize(("age_ns", "told"), [(20 * MS - 1, False), (20 * MS, True), (675 * MS, True)])
@pytest.mark.parametrize("driving", [True, False])
def test_frames_that_waited_are_reported(driving: bool, age_ns: int, told: bool) -> None:
    rig = Rig()
    _ = rig.driving() if driving else rig.wake()
    rig.bridge.backlog(age_ns, rig.now_ns)
    rig.step()
    assert dict(rig.report.reason_counts) == ({"backlog": 1} if told else {})
    assert not told or rig.report.reason_details["backlog"] == f"the oldest was {age_ns // MS} ms old"
    assert rig.report.stopping is None and rig.report.emergency is None


@pytest.mark.parametrize("can_id", [0x510, 0x514])
def test_the_first_frame_of_an_intruder_is_an_emergency(can_id: int) -> None:
    rig = driven()
    rig.receive(Frame(can_id, b"\x01\x02", rig.now_ns))
    rig.step()
    assert rig.sent.estop_request and not rig.sent.torque_requested
    assert f"0x{can_id:03X} [01 02]" in (rig.report.emergency or "")
    assert rig.report.reason_counts["intruder"] == 1


def test_an_intruder_outside_as_driving_prevents_a_drive_for_5_s() -> None:
    rig, words = Rig().ready(), "a second sender uses the AI computer's ids: 0x512 [00 00 00 00]"
    at_ns = rig.now_ns
    rig.receive(Frame(0x512, bytes(4), at_ns))
    assert rig.report.emergency is None and rig.report.reason_details == {"intruder": "0x512 [00 00 00 00]"}
    assert words in rig.bridge.report(at_ns + 5 * S - 1).why_not_driving
    assert words not in rig.bridge.report(at_ns + 5 * S).why_not_driving


def test_the_report_says_what_the_database_lacks() -> None:
    codec = Codec(revision("2026"), [dbc_dir() / "ads_dv_2026.dbc"])
    assert "GPS_Status" in Bridge(codec, revision("2026"), ADS_DV_2026).report(0).unknown


def bridge_of(ours: str) -> Bridge:
    return Bridge(codec_of(ours), revision(ours), ADS_DV_2026)


def telling_of(theirs: str, t_ns: int) -> Frame:
    """A message or state that only a car of that revision has: VCU_STATUS, or a tractive system that runs."""
    if theirs == "2021":
        return codec_of(theirs).encode(VcuSystemStatus(t_rx_ns=t_ns))
    return codec_of(theirs).encode(VcuStatus(as_state=READY, ts_state=TsState.TS_RUNNING, t_rx_ns=t_ns))


def plain_status(as_state: AsState, t_ns: int) -> Frame:
    """OP_STATE, TS_STATE and EBS_STATE are 0: of a car of 2021, or of the official simulator of 2026."""
    return codec_of("2021").encode(VcuStatus(as_state=as_state, t_rx_ns=t_ns))


@pytest.mark.parametrize(("ours", "theirs"), [("2021", "2026"), ("2026", "2021")])
def test_another_revision_is_named_from_its_tenth_frame_on(ours: str, theirs: str) -> None:
    bridge, words = bridge_of(ours), f"the car uses interface revision {theirs}"

    def said(t_ns: int) -> bool:
        return any(each.startswith(words) for each in bridge.report(t_ns).why_not_driving)

    for frame in range(1, 11):
        assert not said(frame * CYCLE)
        bridge.on_frame(telling_of(theirs, frame * CYCLE))
        bridge.on_frame(plain_status(READY, frame * CYCLE))
    assert said(10 * CYCLE) and f"this bridge {ours}" in " ".join(bridge.report(10 * CYCLE).problem_counts)
    assert bridge.report(10 * CYCLE).reason_counts == {"other_revision": 1}, "and in the log"
    for n in range(11, 500):
        bridge.on_frame(telling_of(ours, n * CYCLE))
    assert said(10 * CYCLE + 5 * S - 1) and not said(10 * CYCLE + 5 * S)


@pytest.mark.parametrize("pause_ns", [1 * S - 1, 1 * S])
def test_after_1_s_frames_of_another_revision_count_from_0(pause_ns: int) -> None:
    bridge = bridge_of("2026")
    for n in range(9):
        bridge.on_frame(telling_of("2021", n * CYCLE))
    bridge.on_frame(telling_of("2021", 8 * CYCLE + pause_ns))
    assert bridge.report(10 * S).reason_counts == ({"other_revision": 1} if pause_ns < S else {})


def test_another_revision_that_begins_in_mid_run_is_logged() -> None:
    rig = driven()
    rig.alive = lambda rig: rig.bridge.on_frame(telling_of("2021", rig.now_ns))
    rig.run_ms(1100)
    assert rig.sent.torque_requested and rig.report.reason_counts == {"other_revision": 1}
    assert rig.report.reason_details["other_revision"].startswith("the car uses interface revision 2021")


@pytest.mark.parametrize("ours", ["2021", "2026"])
def test_what_either_revision_may_say_names_none(ours: str) -> None:
    """States that are 0, nine frames of another revision, and frames of another length."""
    bridge, other = bridge_of(ours), bridge_of("2026")
    theirs = "2021" if ours == "2026" else "2026"
    for n in range(1, 100):
        bridge.on_frame(telling_of(theirs if n < 10 else ours, n * CYCLE))
        bridge.on_frame(plain_status(READY if n < 50 else DRIVING, n * CYCLE + 1))
        for can_id in (0x120, 0x520):
            for data in (bytes(7), b""):
                other.on_frame(Frame(can_id, data, n * CYCLE))
    assert not bridge.report(100 * CYCLE).problem_counts
    assert not any("speaks" in each for each in other.report(100 * CYCLE).problem_counts)


@pytest.mark.parametrize(
    "frame",
    [Frame(0x512, bytes(4), error=True), Frame(0x512, bytes(4), extended=True), Frame(0x501, bytes(6))],
)
def test_what_is_no_frame_of_ours_is_no_intruder(frame: Frame) -> None:
    rig = driven()
    rig.receive(replace(frame, t_ns=rig.now_ns))
    rig.step()
    assert rig.report.emergency is None and rig.sent.torque_requested


@pytest.mark.parametrize("back", [AsState.AS_OFF, AsState.AS_READY])
def test_a_rebooted_vcu_gets_zeros_and_is_named(back: AsState) -> None:
    rig = driven()
    rig.say_state(back)
    rig.step()
    assert not rig.sent.torque_requested and rig.sent.steer_deg == 0.0
    assert rig.sent.direction is Direction.NEUTRAL
    assert rig.report.reason_details["vcu_reboot"] == f"AS_DRIVING to {back.label}"


def test_gaps_of_0x520_are_counted() -> None:
    rig = Rig().wake()
    for gap_ms, gaps in ((49, 0), (50, 1)):
        rig.now_ns += gap_ms * MS
        rig.say(rig.status)
        assert rig.report.vcu_gaps == gaps


# ---------------------------------------------------------------- the loop and the bus


def test_a_loop_fault_is_an_emergency_in_as_driving_only() -> None:
    rig = Rig().ready()
    rig.bridge.loop_fault("60 ms late", rig.now_ns)
    rig.step()
    assert rig.report.emergency is None and dict(rig.report.reason_counts) == {} and rig.report.loop_faults == 1
    rig = driven()
    rig.bridge.loop_fault("60 ms late", rig.now_ns)
    rig.step()
    assert rig.sent.estop_request
    assert rig.report.emergency == "the loop failed or missed its deadline by 50 ms: 60 ms late"


def test_50_ms_without_a_complete_cycle_counts_as_bus_loss() -> None:
    rig = driven()
    last_complete_ns = rig.now_ns
    rig.complete = False
    rig.run_ms(40)
    assert rig.sent.torque_requested and rig.report.stopping is None and rig.report.incomplete_cycles == 4
    in_time = rig.copied()
    in_time.complete = True
    in_time.run_ms(100)
    assert in_time.sent.torque_requested and dict(in_time.report.reason_counts) == {}
    rig.now_ns = last_complete_ns + 50 * MS - 1
    rig.speak()
    rig.cycle()
    assert rig.report.stopping is None
    rig.now_ns += 1
    rig.cycle()
    assert rig.report.stopping == "the bus was lost: no complete cycle sent for 50 ms"


def test_a_bus_that_takes_nothing_in_as_ready_breaks_nothing() -> None:
    rig = Rig().ready()
    rig.complete = False
    rig.run_ms(200)
    rig.complete = True
    rig.say_state(DRIVING, go_signal=True)
    rig.command = VehicleCommand(0, 0, throttle=0.5, speed_limit_mps=5.0)
    rig.run_ms(3100)
    assert rig.sent.torque_requested and dict(rig.report.reason_counts) == {}


def test_a_bus_lost_in_as_driving_brakes_the_car_once_back() -> None:
    rig = driven()
    rig.bridge.bus_lost("can0 is down", rig.now_ns)
    assert rig.bridge.on_command(VehicleCommand(rig.now_ns, rig.bridge.run.run_id), rig.now_ns) == (
        "the bus is lost: can0 is down",
    )
    for _ in range(100):
        rig.now_ns += CYCLE
        assert rig.cycle() is None
    assert rig.report.bus_lost == "can0 is down"
    for _ in range(2):  # though told twice
        rig.bridge.bus_back(rig.now_ns)
    without_car = rig.copied()
    assert rig.cycle() is None  # nothing received yet
    rig.step()
    assert (rig.sent.direction, rig.sent.torque_requested) == (Direction.FORWARD, False)
    without_car.now_ns += 100 * MS - 1
    assert without_car.cycle() is None
    without_car.now_ns += 1
    assert without_car.cycle() is not None and without_car.sent.estop_request


# ---------------------------------------------------------------- people


def test_an_emergency_latches_until_reset_in_as_off() -> None:
    rig = driven()
    assert rig.bridge.emergency_brake("cone in the way", rig.now_ns) == (True, "ESTOP_REQUEST is latched")
    rig.step()
    assert rig.sent.estop_request and not rig.sent.torque_requested
    assert rig.bridge.emergency_brake("again", rig.now_ns) == (
        True,
        "already latched because the emergency brake was asked for: cone in the way",
    )
    assert not rig.bridge.reset(rig.now_ns)[0]
    rig.say_state(AsState.AS_OFF)
    rig.step()
    assert rig.sent.estop_request and rig.bridge.reset(rig.now_ns)[0]
    rig.step()
    assert not rig.sent.estop_request


def test_an_emergency_requested_on_a_lost_bus_is_sent_when_back() -> None:
    rig = Rig().autonomous()
    rig.off = True
    rig.bridge.bus_lost("unplugged", rig.now_ns)
    rig.run_ms(1500)
    rig.bridge.bus_lost("still unplugged", rig.now_ns)
    assert rig.bridge.emergency_brake("now", rig.now_ns) == (
        True,
        "ESTOP_REQUEST is latched, but the bus is lost: unplugged",
    )
    rig.run_ms(1500)
    rig.bridge.bus_back(rig.now_ns)
    rig.off = False
    rig.step(2)
    assert rig.sent.estop_request


@pytest.mark.parametrize("lost_ms", [350, 4000])
def test_back_in_as_driving_it_brakes_before_wheel_speeds_return(lost_ms: int) -> None:
    rig = driven(rpm=300)
    rig.off = True
    rig.bridge.bus_lost("unplugged", rig.now_ns)
    rig.run_ms(lost_ms)
    rig.bridge.bus_back(rig.now_ns)
    rig.now_ns += CYCLE
    rig.say(rig.status)  # 0x520 comes first and is answered at once; wheel speeds and steering come after it
    rig.cycle()
    rig.off = False
    rig.alive = brake_to_rest
    rig.run_ms(2900)
    assert (rig.report.emergency, rig.sent.mission_status) == (None, MissionStatus.FINISHED)


@pytest.mark.parametrize("rpm", [0, 200])
def test_as_driving_entered_during_shutdown_is_never_unbraked(rpm: int) -> None:
    """Orderly stop: at rest zeros and NEUTRAL; moving, FORWARD with torque 0, brake and ESTOP_REQUEST."""
    rig = Rig().ready()
    rig.run_ms(600)
    rig.bridge.begin_stop(rig.now_ns)
    rig.step()
    rig.rpm = rpm
    rig.say_state(DRIVING, go_signal=True)
    rig.step()
    assert rig.sent.direction is (Direction.FORWARD if rpm else Direction.NEUTRAL)
    assert (rig.sent.brake_requested, rig.sent.estop_request) == (rpm > 0, rpm > 0)
    assert (rig.sent.torque_requested, rig.sent.steer_deg) == (False, 0.0)


@pytest.mark.parametrize("role", ["planner", "controller"])
def test_a_restarted_planner_or_controller_does_not_resume(role: str) -> None:
    """Safety rule 10: however quickly it is back, the run it knew nothing of is over."""
    rig = driven()
    rig.bridge.on_reset_confirmed(role, rig.bridge.run.run_id)
    rig.step(2)
    assert not rig.sent.torque_requested and rig.sent.brake_requested
    assert rig.report.stopping is not None and role in rig.report.stopping
    assert rig.report.reason_counts == {"stack_restarted": 1}


def test_a_reset_confirmed_by_an_unknown_role_is_only_reported() -> None:
    rig = Rig()
    rig.confirming = False
    rig.wake()
    rig.bridge.on_reset_confirmed("driver", rig.bridge.run.run_id)
    assert rig.report.confirmed == ()
    assert "reset confirmed by 'driver': the roles are planner, controller" in rig.report.problem_counts


# ---------------------------------------------------------------- commands (rule 7)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"throttle": math.nan}, "throttle is nan, not a finite number"),
        ({"steering_rad": math.inf}, "steering_rad is inf, not a finite number"),
        ({"brake": -math.inf}, "brake is -inf, not a finite number"),
        ({"speed_limit_mps": math.nan}, "speed_limit_mps is nan, not a finite number"),
        ({"steering_rad": math.radians(30.1)}, "steering_rad 0.5253 is outside"),
        ({"throttle": 1.01}, "throttle 1.0100 is outside"),
        ({"brake": -0.01}, "brake -0.0100 is outside"),
        ({"t_sensor_ns": 10**15}, "ms in the future"),
    ],
)
def test_an_invalid_command_is_refused_whole_and_reported(changes: dict[str, Any], words: str) -> None:
    rig = driven()
    before, rig.command = rig.sent, None
    command = VehicleCommand(rig.now_ns, rig.bridge.run.run_id)
    assert words in rig.bridge.on_command(replace(command, **changes), rig.now_ns)[0]
    rig.step()
    assert replace(rig.sent, handshake=False) == replace(before, handshake=False)  # the command before still counts
    assert rig.report.reason_counts == {"command_refused": 1} and words in rig.report.reason_details["command_refused"]


def test_a_sensor_stamp_may_lie_a_little_ahead() -> None:
    rig = driven()
    run_id = rig.bridge.run.run_id
    assert rig.bridge.on_command(VehicleCommand(rig.now_ns + 20 * MS, run_id), rig.now_ns) == ()
    assert rig.bridge.on_command(VehicleCommand(rig.now_ns + 20 * MS + 1, run_id), rig.now_ns) != ()


def test_a_command_of_another_run_is_a_reason_only_in_as_driving() -> None:
    rig = Rig().ready()
    assert rig.bridge.on_command(VehicleCommand(rig.now_ns, 1), rig.now_ns) == ("run_id 1 is not the present run (2)",)
    assert dict(rig.report.reason_counts) == {}
    rig = driven()
    assert rig.bridge.on_command(VehicleCommand(rig.now_ns, 1), rig.now_ns) != ()
    assert rig.report.reason_counts == {"command_other_run": 1}


# ---------------------------------------------------------------- the end


def test_on_stop_at_rest_five_cycles_of_zeros_then_silence() -> None:
    rig = Rig().ready()
    rig.bridge.begin_stop(rig.now_ns)
    rig.bridge.begin_stop(rig.now_ns)
    for _ in range(5):
        assert not rig.bridge.stopped
        rig.step()
        assert replace(rig.sent, handshake=False) == AiCommand()
    assert rig.bridge.stopped and rig.step() is None
    assert rig.bridge.emergency_brake("late", rig.now_ns) == (
        False,
        "this software was stopped: it sends nothing any more",
    )


def test_on_stop_while_moving_the_car_is_left_to_its_own_brake() -> None:
    rig = driven(rpm=400)
    rig.bridge.begin_stop(rig.now_ns)
    seen = []
    for _ in range(5):
        rig.step()
        assert (rig.sent.estop_request, rig.sent.torque_requested) == (True, False)
        assert (rig.sent.direction, rig.sent.mission_status) == (Direction.FORWARD, MissionStatus.RUNNING)
        seen.append(rig.sent.brake_requested)
    assert seen == [False, True, True, True, True]  # rule 1: a cycle of zeros first
    assert rig.bridge.stopped and rig.step() is None


@pytest.mark.parametrize("config", [BridgeConfig(), BridgeConfig(listen_only=True)])
def test_what_has_not_sent_yet_ends_in_silence(config: BridgeConfig) -> None:
    rig = Rig(config)
    assert rig.bridge.config is config
    rig.run_ms(100)
    rig.bridge.begin_stop(rig.now_ns)
    assert rig.bridge.stopped


# ---------------------------------------------------------------- frames and the snapshot


def test_frames_and_their_problems_are_counted() -> None:
    rig = Rig().wake()
    for _ in range(2):
        rig.receive(Frame(0x525, b"\x01", rig.now_ns))
    rig.receive(Frame(0x7FF, b"", rig.now_ns))
    assert rig.report.rx_counts[0x525] == 32 and rig.report.rx_counts[0x7FF] == 1
    assert list(rig.report.problem_counts.values()) == [2]


def test_a_fuzzed_bus_does_not_fill_the_memory() -> None:
    rig = Rig().wake()
    for n in range(300):
        rig.bridge.on_reset_confirmed(f"role {n}", 1)
        rig.bridge.on_frame(Frame(0x680 + n, b"", rig.now_ns))
    assert len(rig.report.problem_counts) == 101 and rig.report.problem_counts["other problems"] == 200
    assert len(rig.report.rx_counts) == IDS_KEPT


def test_the_snapshot_tells_ages_and_cannot_be_changed() -> None:
    rig = Rig().wake()
    rig.mute = {WheelSpeeds}
    rig.run_ms(50)
    report = rig.report
    assert report.ages_ns["speeds"] == 50 * MS and report.ages_ns["status"] == 0
    assert report.ages_ns["log_status"] is None
    with pytest.raises(TypeError):
        report.reason_counts["x"] = 1  # type: ignore[index]
    with pytest.raises(AttributeError):
        report.mode = "autonomous"  # type: ignore[misc]


def test_a_shutdown_request_is_passed_on_at_rest() -> None:
    rig = driven()
    rig.status = replace(rig.status, shutdown_request=True)
    rig.step()
    assert not rig.report.shutdown_requested
    rig.rpm = 0
    rig.run_ms(600)
    assert rig.report.shutdown_requested


def test_gps_frames_are_kept_beside_the_cars() -> None:
    rig = Rig().wake()
    frame = rig.codec.encode(RotationB(z_degps=3.5))
    rig.receive(replace(frame, t_ns=rig.now_ns))
    assert rig.report.gps.rotation_b == RotationB(z_degps=3.5, t_rx_ns=rig.now_ns)
