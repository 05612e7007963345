"""What the codec will not encode and what it will not believe."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from fsai_vcu.interface.codec import Codec, Decoded, EncodeError
from fsai_vcu.interface.enums import (
    Ami,
    AsState,
    EbsState,
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
    command_of,
)
from fsai_vcu.interface.revisions import revision

CODEC_2021 = Codec(revision("2021"))
CODEC_2026 = Codec(revision("2026"))
BOTH = pytest.mark.parametrize("codec", [CODEC_2021, CODEC_2026], ids=["2021", "2026"])


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


@BOTH
@pytest.mark.parametrize(
    ("image", "wire"),
    [
        # An edge value with a rounding error is in range; others are rounded to the nearest step.
        (AiSteer(0.1 * 3 * 70), "513#D200"),
        (AiDriveFront(torque_nm=195.00000000000003), "511#9E070000"),
        (AiDriveFront(torque_nm=-1e-12), "511#00000000"),
        (AiSteer(1.04), "513#0A00"),
        (AiSteer(-1.06), "513#F5FF"),
        (AiBrake(front_pct=12.6, rear_pct=12.8), "514#191A"),
        (AiDriveFront(motor_speed_max_rpm=10.6), "511#00000B00"),  # type: ignore[arg-type]
        # Numbers of numpy are numbers.
        (AiSteer(np.float64(-1.5)), "513#F1FF"),
        (AiSteer(np.float32(-1.5)), "513#F1FF"),  # type: ignore[arg-type]
        (AiDriveFront(torque_nm=np.uint8(100)), "511#E8030000"),  # type: ignore[arg-type]
        (AiStatus(handshake=np.bool_(True), cones_count_all=np.uint16(65535)), "510#01000000FFFF0000"),  # type: ignore[arg-type]
        # Logging fields saturate.
        (AiStatus(lap_counter=16, cones_count_actual=256, speed_actual_kmh=-1), "510#00000FFF00000000"),
        (AiStatus(cones_count_all=70_000, speed_demand_kmh=1_000), "510#00000000FFFF00FF"),
        (LogDynamics1(speed_actual_kmh=300, steer_actual_deg=-90.0), "500#FF00800000000000"),
        (LogDynamics2(100.0, -100.0, 300.0), "501#FF7F0080FF7F"),
        (LogStatus(cones_count_all=131_072), "502#000080FFFF"),
        # What is None, or not of the revision, leaves its bits at 0.
        (VcuStatus(as_state=AsState.AS_INIT), "520#0000000000000000"),
        (VcuBrake(), "524#0000000000"),
    ],
    ids=str,
)
def test_what_the_wire_can_carry_is_encoded(codec: Codec, image: Image, wire: str) -> None:
    assert str(codec.encode(image)) == wire


@BOTH
def test_the_two_zeros_of_a_float_are_told_apart(codec: Codec) -> None:
    assert [str(codec.encode(RotationB(zero))) for zero in (0.0, -0.0, 0.0)] == [
        "611#00000000",
        "611#00000080",
        "611#00000000",
    ]


@BOTH
def test_a_value_is_refused_whatever_went_out_before(codec: Codec) -> None:
    for _ in range(2):
        assert str(codec.encode(AiSteer(1.0))) == "513#0A00"
        with pytest.raises(EncodeError, match="STEER_REQUEST is nan, not a number"):
            codec.encode(AiSteer(math.nan))
        with pytest.raises(EncodeError, match="out of range"):
            codec.encode(AiSteer(31.0))


@BOTH
def test_a_payload_said_again_has_its_own_time_and_its_problems(codec: Codec) -> None:
    """However many others came in between."""
    frames = [Frame(0x520, bytes.fromhex(f"0000{raw:02X}0000000000"), t_ns=raw) for raw in range(256)]
    first = [codec.decode(frame) for frame in frames]
    assert [codec.decode(frame) for frame in frames] == first
    later = [codec.decode(Frame(0x520, frame.data, t_ns=1000)) for frame in frames]
    assert [one.problems for one in later] == [one.problems for one in first]
    assert {one.image.t_rx_ns for one in later if one.image} == {1000}


def test_what_a_revision_has_less_is_refused_or_left_out() -> None:
    assert CODEC_2026.encode(AiSteer(21.1)).data == bytes.fromhex("D300")
    for steer_deg in (21.04, 21.1, -21.04):
        with pytest.raises(EncodeError):
            CODEC_2021.encode(AiSteer(steer_deg))
    image = VcuStatus(op_state=OpState.OP_FAULT, ts_state=TsState.TS_FAULT, ebs_state=EbsState.EBS_FAULT)
    assert CODEC_2021.encode(image).data == CODEC_2021.encode(VcuStatus()).data


def test_a_message_that_the_revision_lacks_is_refused() -> None:
    with pytest.raises(EncodeError, match="VcuSystemStatus is not a message of the loaded database"):
        CODEC_2026.encode(VcuSystemStatus())
    thing: Any = AiCommand()
    with pytest.raises(EncodeError, match="AiCommand is not a message"):
        CODEC_2026.encode(thing)


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


OFF_TABLE = "{} is not in the interface's table"


@BOTH
@pytest.mark.parametrize(
    ("wire", "values", "problems"),
    [
        ("520#0000000000000000", {"as_state": AsState.AS_INIT}, ()),
        ("520#0000820000000000", {"ami": Ami.NOT_SELECTED, "as_state": AsState.AS_READY}, ("AMI_STATE 8",)),
        ("520#0030010000000000", {"steering_status": SteeringStatus.OFF}, ("STEERING_STATUS 3",)),
        ("520#000001000000000C", {"shutdown_cause": None}, ("SHUTDOWN_CAUSE 12",)),
        ("520#000001000000000B", {"shutdown_cause": ShutdownCause.BRAKE_PLAUSIBILITY_FAULT}, ()),
        ("524#0000000025", {"brake_status": None}, ("STATUS_BRK 5",)),
        ("524#0000000041", {"ebs_status": None}, ("STATUS_EBS 4",)),
        ("524#0000000001", {"ebs_status": None}, ()),  # 0 is not worth a word
        ("510#00C0000000000000", None, ("DIRECTION_REQUEST 3",)),
    ],
)
def test_a_value_outside_its_table_is_safe_and_reported(
    codec: Codec, wire: str, values: dict[str, Any] | None, problems: tuple[str, ...]
) -> None:
    can_id, data = wire.split("#")
    decoded = codec.decode(Frame(int(can_id, 16), bytes.fromhex(data)))
    assert (decoded.image is None) == (values is None)
    assert {name: getattr(decoded.image, name) for name in values or {}} == (values or {})
    assert [problem.partition(": ")[2] for problem in decoded.problems] == [OFF_TABLE.format(each) for each in problems]


@BOTH
@pytest.mark.parametrize("bit", [0, 1])
@pytest.mark.parametrize("raw", [1, 6, 7, 9, 15])
def test_an_unknown_as_state_leaves_its_handshake_valid(codec: Codec, raw: int, bit: int) -> None:
    decoded = codec.decode(Frame(0x520, bytes.fromhex(f"0{bit}000{raw:X}0000000000")))
    assert (decoded.image is not None) == (raw == 1)
    assert decoded.handshake is bool(bit)
    assert decoded.problems == (() if raw == 1 else (f"VCU2AI_Status: {OFF_TABLE.format(f'AS_STATE {raw}')}",))


@pytest.mark.parametrize("raw", [5, 9, 14, 15])
def test_15_or_an_unknown_op_ts_or_ebs_state_is_a_fault(raw: int) -> None:
    """Where there are such states."""
    faults = {CODEC_2026: (OpState.OP_FAULT, TsState.TS_FAULT, EbsState.EBS_FAULT), CODEC_2021: (None, None, None)}
    for codec, states in faults.items():
        decoded = codec.decode(Frame(0x520, bytes.fromhex(f"{raw:X}00001{raw:X}0{raw:X}0000000")))
        assert isinstance(decoded.image, VcuStatus)
        assert (decoded.image.op_state, decoded.image.ts_state, decoded.image.ebs_state) == states
        assert len(decoded.problems) == (0 if raw == 15 or codec is CODEC_2021 else 3)


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


def test_an_image_has_the_time_of_its_frame_both_ways() -> None:
    assert CODEC_2026.encode(AiSteer(1.0, t_rx_ns=123)).t_ns == 123
    for can_id, data in ((0x525, bytes(8)), (0x524, bytes.fromhex("0000000045"))):
        image = CODEC_2026.decode(Frame(can_id, data, t_ns=42)).image
        assert image is not None and image.t_rx_ns == 42


# ---------------------------------------------------------------- the VCU's view


def test_a_command_of_which_little_was_heard_is_safe_in_the_rest() -> None:
    assert command_of({}) == AiCommand()
    assert command_of({AiSteer: AiSteer(5.0)}) == AiCommand(steer_deg=5.0)
