"""What the codec will not encode and what it will not believe."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from fsai_vcu.interface.codec import Codec, Decoded, EncodeError, command_of
from fsai_vcu.interface.enums import (
    Ami,
    AsState,
    Direction,
    EbsState,
    MissionStatus,
    OpState,
    ShutdownCause,
    SteeringStatus,
    TsState,
)
from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.messages import (
    AiBrake,
    AiCommand,
    AiDriveFront,
    AiDriveRear,
    AiImage,
    AiStatus,
    AiSteer,
    Faults,
    GpsAltitude,
    Image,
    LogDynamics1,
    LogDynamics2,
    LogStatus,
    RotationB,
    VcuBrake,
    VcuStatus,
    VcuSteer,
    VcuSystemStatus,
    WheelSpeeds,
)
from fsai_vcu.interface.revisions import revision

CODEC_2021 = Codec(revision("2021"))
CODEC_2026 = Codec(revision("2026"))
BOTH = pytest.mark.parametrize("codec", [CODEC_2021, CODEC_2026], ids=["2021", "2026"])


def status(codec: Codec, text: str) -> Decoded:
    return codec.decode(Frame(0x520, bytes.fromhex(text)))


# ---------------------------------------------------------------- encoding


@pytest.mark.parametrize(
    ("image", "words"),
    [
        (AiSteer(30.04), "STEER_REQUEST 30.04 is out of range -30 … 30 deg"),
        (AiSteer(-30.04), "out of range"),
        (AiSteer(math.nan), "STEER_REQUEST is nan, not a number"),
        (AiSteer(math.inf), "out of range"),
        (AiSteer("1.0"), "not a number"),  # type: ignore[arg-type]
        (AiSteer(None), "not a number"),  # type: ignore[arg-type]
        (AiDriveFront(torque_nm=195.04), "FRONT_AXLE_TRQ_REQUEST 195.04 is out of range 0 … 195 Nm"),
        (AiDriveRear(torque_nm=-0.04), "out of range"),
        (AiDriveRear(motor_speed_max_rpm=4001), "out of range"),
        (AiDriveRear(motor_speed_max_rpm=-1), "out of range"),
        (AiBrake(front_pct=100.2), "out of range"),
        (AiBrake(rear_pct=-math.inf), "out of range"),
        (AiStatus(mission_status=4), "MISSION_STATUS 4 is not in the interface's table"),  # type: ignore[arg-type]
        (AiStatus(direction=3), "not in the interface's table"),  # type: ignore[arg-type]
        (AiStatus(direction=None), "not in the interface's table"),  # type: ignore[arg-type]
        (AiStatus(handshake=2), "HANDSHAKE is 2, not a flag"),  # type: ignore[arg-type]
        (AiStatus(estop_request=None), "not a flag"),  # type: ignore[arg-type]
        (AiStatus(lap_counter=math.nan), "not a number"),  # type: ignore[arg-type]
        (WheelSpeeds(fl_rpm=1251), "out of range"),
        (VcuSteer(angle_max_deg=30.1), "out of range"),
        (VcuStatus(faults=Faults(bms="yes")), "BMS_FAULT is 'yes', not a flag"),  # type: ignore[arg-type]
        (VcuStatus(as_state=6), "AS_STATE 6 is not in the interface's table"),  # type: ignore[arg-type]
        (RotationB(math.nan), "not a number"),
        (GpsAltitude(1e39), "out of range"),
        (LogStatus(assi=8), "out of range"),
    ],
    ids=str,
)
def test_a_value_that_the_wire_cannot_carry_is_refused(image: Image, words: str) -> None:
    with pytest.raises(EncodeError, match=words):
        CODEC_2026.encode(image)


def test_the_steering_limit_is_that_of_the_revision() -> None:
    assert CODEC_2021.encode(AiSteer(21.0)).data == bytes.fromhex("D200")
    for steer_deg in (21.04, 21.1, -21.04):
        with pytest.raises(EncodeError):
            CODEC_2021.encode(AiSteer(steer_deg))
    assert CODEC_2026.encode(AiSteer(21.1)).data == bytes.fromhex("D300")


def test_an_edge_value_with_a_rounding_error_is_in_range() -> None:
    assert CODEC_2021.encode(AiSteer(0.1 * 3 * 70)).data == bytes.fromhex("D200")
    assert CODEC_2026.encode(AiDriveFront(torque_nm=195.00000000000003)).data[:2] == bytes.fromhex("9E07")
    assert CODEC_2026.encode(AiDriveFront(torque_nm=-1e-12)).data[:2] == bytes.fromhex("0000")


def test_values_are_rounded_to_the_nearest_step() -> None:
    assert CODEC_2026.encode(AiSteer(1.04)).data == bytes.fromhex("0A00")
    assert CODEC_2026.encode(AiSteer(-1.06)).data == bytes.fromhex("F5FF")
    assert CODEC_2026.encode(AiBrake(front_pct=12.6, rear_pct=12.8)).data == bytes.fromhex("191A")
    assert CODEC_2026.encode(AiDriveFront(motor_speed_max_rpm=10.6)).data[2:] == bytes.fromhex("0B00")  # type: ignore[arg-type]


def test_numbers_of_numpy_are_numbers() -> None:
    image = AiStatus(
        handshake=np.bool_(True),  # type: ignore[arg-type]
        cones_count_all=np.uint16(65535),  # type: ignore[arg-type]
        speed_actual_kmh=np.int64(200),  # type: ignore[arg-type]
        speed_demand_kmh=np.int32(255),  # type: ignore[arg-type]
    )
    assert str(CODEC_2026.encode(image)) == "510#01000000FFFFC8FF"
    assert CODEC_2026.encode(AiSteer(np.float64(-1.5))).data == bytes.fromhex("F1FF")
    assert CODEC_2026.encode(AiSteer(np.float32(-1.5))).data == bytes.fromhex("F1FF")  # type: ignore[arg-type]


def test_logging_fields_saturate() -> None:
    far = AiStatus(
        lap_counter=16, cones_count_actual=256, cones_count_all=70_000, speed_actual_kmh=-1, speed_demand_kmh=1_000
    )
    assert str(CODEC_2021.encode(far)) == "510#00000FFFFFFF00FF"
    assert str(CODEC_2021.encode(LogDynamics1(speed_actual_kmh=300, steer_actual_deg=-90.0))) == "500#FF00800000000000"
    assert str(CODEC_2021.encode(LogDynamics2(100.0, -100.0, 300.0))) == "501#FF7F0080FF7F"
    assert str(CODEC_2021.encode(LogStatus(cones_count_all=131_072))) == "502#000080FFFF"


def test_a_command_with_one_bad_value_yields_no_frame_at_all() -> None:
    with pytest.raises(EncodeError):
        CODEC_2026.encode_command(AiCommand(front_brake_pct=math.nan))
    with pytest.raises(EncodeError, match="STEER_REQUEST"):
        CODEC_2021.encode_command(AiCommand(steer_deg=30.0))


def test_a_message_that_the_revision_lacks_is_refused() -> None:
    with pytest.raises(EncodeError, match="VcuSystemStatus is not a message of the loaded database"):
        CODEC_2026.encode(VcuSystemStatus())


def test_something_that_is_no_image_is_refused() -> None:
    thing: Any = AiCommand()
    with pytest.raises(EncodeError, match="AiCommand is not a message"):
        CODEC_2026.encode(thing)


def test_states_that_2021_lacks_leave_no_trace_in_its_frame() -> None:
    image = VcuStatus(op_state=OpState.OP_FAULT, ts_state=TsState.TS_FAULT, ebs_state=EbsState.EBS_FAULT)
    assert CODEC_2021.encode(image).data == CODEC_2021.encode(VcuStatus()).data


def test_what_is_none_leaves_its_bits_at_0() -> None:
    assert str(CODEC_2026.encode(VcuStatus(as_state=AsState.AS_INIT))) == "520#0000000000000000"
    assert str(CODEC_2026.encode(VcuBrake())) == "524#0000000000"


def test_an_encoded_image_keeps_its_time() -> None:
    assert CODEC_2026.encode(AiSteer(1.0, t_rx_ns=123)).t_ns == 123


# ---------------------------------------------------------------- decoding


@BOTH
@pytest.mark.parametrize("length", [0, 1, 7, 9, 64])
def test_a_frame_of_the_wrong_length_is_not_believed(codec: Codec, length: int) -> None:
    decoded = codec.decode(Frame(0x520, bytes(length)))
    assert decoded.image is None
    assert decoded.handshake is None
    assert decoded.problems == (f"0x520: {length} bytes where 8 belong",)


@BOTH
def test_a_frame_that_is_not_known_says_nothing(codec: Codec) -> None:
    for can_id in (0x000, 0x080, 0x301, 0x601, 0x631, 0x7FF):
        assert not codec.knows(can_id)
        assert codec.decode(Frame(can_id, bytes(8))) == Decoded(None)


@BOTH
def test_error_remote_and_extended_frames_are_no_messages(codec: Codec) -> None:
    assert codec.decode(Frame(0x520, bytes(8), error=True)) == Decoded(None)
    for frame in (Frame(0x520, b"", remote=True), Frame(0x520, bytes(8), extended=True)):
        decoded = codec.decode(frame)
        assert decoded.image is None
        assert decoded.handshake is None
        assert len(decoded.problems) == 1


@BOTH
@pytest.mark.parametrize("bit", [0, 1])
@pytest.mark.parametrize("raw", [6, 7, 9, 15])
def test_an_unknown_as_state_leaves_its_handshake_valid(codec: Codec, raw: int, bit: int) -> None:
    decoded = status(codec, f"0{bit}000{raw:X}0000000000")
    assert decoded.image is None
    assert decoded.handshake is bool(bit)
    assert decoded.problems == (f"VCU2AI_Status: AS_STATE {raw} is not in the interface's table",)


@BOTH
def test_only_a_valid_0x520_gives_a_handshake(codec: Codec) -> None:
    assert status(codec, "0100010000000000").handshake is True
    assert status(codec, "0000010000000000").handshake is False
    assert codec.decode(Frame(0x510, bytes.fromhex("0100000000000000"))).handshake is None


@BOTH
def test_as_state_0_is_as_init_in_both_revisions(codec: Codec) -> None:
    image = status(codec, "0000000000000000").image
    assert isinstance(image, VcuStatus)
    assert image.as_state is AsState.AS_INIT


@BOTH
def test_an_unknown_mission_counts_as_none_selected(codec: Codec) -> None:
    decoded = status(codec, "0000820000000000")
    assert isinstance(decoded.image, VcuStatus)
    assert decoded.image.ami is Ami.NOT_SELECTED
    assert decoded.image.as_state is AsState.AS_READY
    assert decoded.problems == ("VCU2AI_Status: AMI_STATE 8 is not in the interface's table",)


@BOTH
def test_an_unknown_steering_status_is_not_active(codec: Codec) -> None:
    decoded = status(codec, "0030010000000000")
    assert isinstance(decoded.image, VcuStatus)
    assert decoded.image.steering_status is SteeringStatus.OFF
    assert len(decoded.problems) == 1


@BOTH
def test_an_unknown_shutdown_cause_is_none_and_reported(codec: Codec) -> None:
    decoded = status(codec, "000001000000000C")
    assert isinstance(decoded.image, VcuStatus)
    assert decoded.image.shutdown_cause is None
    assert decoded.problems == ("VCU2AI_Status: SHUTDOWN_CAUSE 12 is not in the interface's table",)


@BOTH
def test_shutdown_cause_11_is_the_brake_plausibility_fault(codec: Codec) -> None:
    decoded = status(codec, "000001000000000B")
    assert isinstance(decoded.image, VcuStatus)
    assert decoded.image.shutdown_cause is ShutdownCause.BRAKE_PLAUSIBILITY_FAULT
    assert decoded.problems == ()


@pytest.mark.parametrize("raw", [5, 9, 14, 15])
def test_15_or_an_unknown_op_ts_or_ebs_state_is_a_fault(raw: int) -> None:
    decoded = status(CODEC_2026, f"{raw:X}00001{raw:X}0{raw:X}0000000")
    assert isinstance(decoded.image, VcuStatus)
    assert decoded.image.op_state is OpState.OP_FAULT
    assert decoded.image.ts_state is TsState.TS_FAULT
    assert decoded.image.ebs_state is EbsState.EBS_FAULT
    assert len(decoded.problems) == (0 if raw == 15 else 3)


def test_2021_has_no_op_ts_or_ebs_state() -> None:
    image = status(CODEC_2021, "F00001F0F0000000").image
    assert isinstance(image, VcuStatus)
    assert (image.op_state, image.ts_state, image.ebs_state) == (None, None, None)


@BOTH
def test_an_unknown_brake_status_is_none_and_reported(codec: Codec) -> None:
    decoded = codec.decode(Frame(0x524, bytes.fromhex("0000000025")))
    assert isinstance(decoded.image, VcuBrake)
    assert decoded.image.brake_status is None
    assert decoded.problems == ("VCU2AI_Brake: STATUS_BRK 5 is not in the interface's table",)


@BOTH
def test_an_unknown_ebs_status_is_none_and_0_is_not_worth_a_word(codec: Codec) -> None:
    decoded = codec.decode(Frame(0x524, bytes.fromhex("0000000041")))
    assert isinstance(decoded.image, VcuBrake)
    assert decoded.image.ebs_status is None
    assert len(decoded.problems) == 1
    decoded = codec.decode(Frame(0x524, bytes.fromhex("0000000001")))
    assert isinstance(decoded.image, VcuBrake)
    assert decoded.image.ebs_status is None
    assert decoded.problems == ()


@BOTH
def test_an_unknown_direction_of_the_ai_computer_is_not_believed(codec: Codec) -> None:
    decoded = codec.decode(Frame(0x510, bytes.fromhex("00C0000000000000")))
    assert decoded.image is None
    assert len(decoded.problems) == 1


@BOTH
@pytest.mark.parametrize("text", ["0000C07F", "0000807F", "000080FF"], ids=["nan", "inf", "-inf"])
def test_a_float_that_is_no_number_is_not_believed(codec: Codec, text: str) -> None:
    for can_id, data in (
        (0x611, text),
        (0x610, "00000000" + text),
        (0x622, text + "0D0045"),
        (0x625, text + "00000000"),
    ):
        decoded = codec.decode(Frame(can_id, bytes.fromhex(data)))
        assert decoded.image is None
        assert len(decoded.problems) == 1
        assert "not a finite number" in decoded.problems[0]


@BOTH
def test_an_image_carries_the_time_of_its_frame(codec: Codec) -> None:
    image = codec.decode(Frame(0x525, bytes(8), t_ns=42)).image
    assert image == WheelSpeeds(t_rx_ns=42)
    image = codec.decode(Frame(0x524, bytes.fromhex("0000000045"), t_ns=43)).image
    assert image is not None
    assert image.t_rx_ns == 43


# ---------------------------------------------------------------- the VCU's view


def test_five_frames_make_the_command_that_was_sent() -> None:
    command = AiCommand(
        handshake=True,
        mission_status=MissionStatus.RUNNING,
        direction=Direction.FORWARD,
        steer_deg=-12.3,
        rear_torque_nm=80.5,
        rear_motor_speed_max_rpm=2000,
        front_brake_pct=1.5,
        lap_counter=3,
    )
    heard: dict[type, AiImage] = {}
    for frame in CODEC_2026.encode_command(command):
        image = CODEC_2026.decode(frame).image
        assert isinstance(image, AiStatus | AiDriveFront | AiDriveRear | AiSteer | AiBrake)
        heard[type(image)] = image
    assert command_of(heard) == command


def test_a_command_of_which_little_was_heard_is_safe_in_the_rest() -> None:
    assert command_of({}) == AiCommand()
    assert command_of({AiSteer: AiSteer(5.0)}) == AiCommand(steer_deg=5.0)
