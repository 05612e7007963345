"""Every message that has a class against bytes written out by hand."""

from __future__ import annotations

import pytest
from msgspec.structs import replace

from fsai_vcu.interface.codec import Codec
from fsai_vcu.interface.enums import (
    Ami,
    AsState,
    BrakeStatus,
    Direction,
    EbsState,
    EbsStatus,
    MissionStatus,
    OpState,
    ShutdownCause,
    SteeringStatus,
    TsState,
)
from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.messages import (
    Acceleration,
    AiBrake,
    AiCommand,
    AiDriveFront,
    AiDriveRear,
    AiStatus,
    AiSteer,
    Faults,
    GpsAltitude,
    GpsDilutionA,
    GpsDilutionB,
    GpsLatitude,
    GpsLongitude,
    GpsStatus,
    Image,
    LogDynamics1,
    LogDynamics2,
    LogStatus,
    RotationA,
    RotationB,
    VcuBrake,
    VcuDriveFront,
    VcuDriveRear,
    VcuStatus,
    VcuSteer,
    VcuSystemStatus,
    WheelCounts,
    WheelSpeeds,
)
from fsai_vcu.interface.revisions import revision

CODECS = {name: Codec(revision(name)) for name in ("2021", "2026")}

STATUS_FAULTS = Faults(
    ai_estop_request=True,
    hvil_open=False,
    hvil_short=False,
    ebs=False,
    offboard_charger=False,
    ai_comms_lost=True,
    autonomous_braking=False,
    mission_status=False,
    charge_procedure=False,
    bms=False,
    brake_plausibility=True,
)
STATUS_2021 = VcuStatus(
    handshake=True,
    shutdown_request=True,
    as_switch=True,
    ts_switch=True,
    go_signal=True,
    steering_status=SteeringStatus.ACTIVE,
    as_state=AsState.AS_DRIVING,
    ami=Ami.TRACKDRIVE,
    fault=True,
    warning=True,
    warn_batt_temp_high=True,
    warn_batt_soc_low=True,
    faults=STATUS_FAULTS,
    shutdown_cause=ShutdownCause.BRAKE_PLAUSIBILITY_FAULT,
)
STATUS_2026 = replace(STATUS_2021, op_state=OpState.OP_AUTO, ts_state=TsState.TS_RUNNING, ebs_state=EbsState.EBS_ARMED)

IN_BOTH: list[tuple[Image, str]] = [
    (AiStatus(), "510#0000000000000000"),
    (
        AiStatus(
            handshake=True,
            estop_request=True,
            mission_status=MissionStatus.RUNNING,
            direction=Direction.FORWARD,
            lap_counter=5,
            cones_count_actual=42,
            cones_count_all=0x1234,
            speed_actual_kmh=10,
            speed_demand_kmh=20,
        ),
        "510#0161052A34120A14",
    ),
    (AiStatus(mission_status=MissionStatus.SELECTED), "510#0010000000000000"),
    (AiStatus(mission_status=MissionStatus.FINISHED), "510#0030000000000000"),
    (AiStatus(direction=Direction.REVERSE), "510#0080000000000000"),
    (AiDriveFront(torque_nm=195.0, motor_speed_max_rpm=4000), "511#9E07A00F"),
    (AiDriveRear(torque_nm=0.1, motor_speed_max_rpm=300), "512#01002C01"),
    (AiSteer(steer_deg=-21.0), "513#2EFF"),
    (AiSteer(steer_deg=21.0), "513#D200"),
    (AiSteer(steer_deg=0.1), "513#0100"),
    (AiBrake(front_pct=12.5, rear_pct=100.0), "514#19C8"),
    (VcuDriveFront(torque_nm=-19.5, torque_request_nm=10.0, torque_max_nm=195.0), "521#3DFF64009E07"),
    (VcuDriveRear(torque_nm=19.5, torque_request_nm=0.5, torque_max_nm=100.0), "522#C3000500E803"),
    (VcuSteer(angle_deg=-21.0, angle_max_deg=21.0, angle_request_deg=1.5), "523#2EFFD2000F00"),
    (
        VcuBrake(6.5, 12.5, 0.0, 100.0, BrakeStatus.READY, EbsStatus.ARMED),
        "524#0D1900C821",
    ),
    (WheelSpeeds(1, 256, 1250, 0), "525#01000001E2040000"),
    (WheelCounts(65535, 1, 2, 3), "526#FFFF010002000300"),
    (LogDynamics1(36, 40, -10.5, 11.0, 5, 10, 50, 60), "500#2428EB16050A323C"),
    # the cone total is 17 bits wide and starts in the middle of a byte
    (LogStatus(3, 2, 4, 1, 2, 9, 171, 131071), "502#93CDD5FFFF"),
    (LogStatus(cones_count_all=1), "502#0000800000"),
    (LogStatus(cones_count_all=65536), "502#0000000080"),
    (Acceleration(391.0, -3.91, 1000.96, 30.0, 3, 1), "600#6400FFFF00010C07"),
    (Acceleration(temperature_degc=24.0), "600#0000000000000000"),
    (Acceleration(temperature_degc=-40.0), "600#0000000000008000"),
    (RotationA(1.0, -2.5), "610#0000803F000020C0"),
    (RotationB(0.5), "611#0000003F"),
    (GpsStatus(antenna=2, satellites=7, navigation_method=3), "620#020703"),
    (GpsLongitude(minutes=30.5, degrees=13, indicator=ord("E")), "622#0000F4410D0045"),
    (GpsLatitude(minutes=30.5, degrees=52, indicator=ord("N")), "623#0000F44134004E"),
    (GpsLongitude(indicator=0), "622#00000000000000"),  # before a fix
    (GpsLatitude(indicator=0), "623#00000000000000"),
    (GpsAltitude(0.5), "624#0000003F"),
    (GpsDilutionA(pdop=1.5, hdop=0.75), "625#0000C03F0000403F"),
    (GpsDilutionB(1.5), "626#0000C03F"),
]


def frame(text: str) -> Frame:
    can_id, data = text.split("#")
    return Frame(int(can_id, 16), bytes.fromhex(data))


@pytest.mark.parametrize("codec", CODECS.values(), ids=CODECS)
@pytest.mark.parametrize(("image", "wire"), IN_BOTH, ids=[wire for _, wire in IN_BOTH])
def test_a_message_has_these_bytes_and_reads_back(codec: Codec, image: Image, wire: str) -> None:
    assert str(codec.encode(image)) == wire
    decoded = codec.decode(frame(wire))
    assert decoded.problems == ()
    assert decoded.image == image


@pytest.mark.parametrize(
    ("name", "image", "wire"),
    [
        ("2021", STATUS_2021, "520#011F43030321040B"),
        ("2026", STATUS_2026, "520#211F43332321040B"),
        ("2026", AiSteer(30.0), "513#2C01"),
        ("2026", AiSteer(-30.0), "513#D4FE"),
        ("2026", VcuSteer(-30.0, 30.0, 1.5), "523#D4FE2C010F00"),
        ("2026", VcuSteer(0.3, 30.0, 0.3), "523#03002C010300"),  # a tenth reads as the decimal that was meant
        (
            "2021",
            VcuSystemStatus(
                sm_sys=4,
                sm_as=3,
                sys_action_state=2,
                status_timeout=True,
                handshake_timeout=True,
                warn_ai_comms_lost=True,
            ),
            "120#0430000001200220",
        ),
        (
            "2021",
            VcuSystemStatus(
                sm_sys=8,
                sm_as=5,
                sys_action_state=4,
                drive_front_timeout=True,
                drive_rear_timeout=True,
                steer_timeout=True,
                brake_timeout=True,
                warn_brake_plausibility=True,
                warn_kl15_under_v=True,
                warn_ai_estop_req=True,
                warn_auto_braking=True,
                warn_mission_status=True,
            ),
            "120#08500000C0C004DC",
        ),
    ],
    ids=str,
)
def test_what_only_one_revision_has_keeps_its_bytes(name: str, image: Image, wire: str) -> None:
    codec = CODECS[name]
    assert str(codec.encode(image)) == wire
    assert codec.decode(frame(wire)).image == image


@pytest.mark.parametrize("codec", CODECS.values(), ids=CODECS)
def test_a_command_goes_out_as_510_to_514_in_that_order(codec: Codec) -> None:
    command = AiCommand(
        handshake=True,
        mission_status=MissionStatus.RUNNING,
        direction=Direction.FORWARD,
        steer_deg=-1.5,
        front_torque_nm=10.0,
        rear_torque_nm=195.0,
        front_motor_speed_max_rpm=1,
        rear_motor_speed_max_rpm=4000,
        front_brake_pct=0.5,
        rear_brake_pct=50.0,
        lap_counter=1,
        cones_count_actual=2,
        cones_count_all=3,
        speed_actual_kmh=4,
        speed_demand_kmh=5,
    )
    frames = codec.encode_command(command, t_ns=77)
    assert [str(one) for one in frames] == [
        "510#0160010203000405",
        "511#64000100",
        "512#9E07A00F",
        "513#F1FF",
        "514#0164",
    ]
    assert {one.t_ns for one in frames} == {77}


@pytest.mark.parametrize("codec", CODECS.values(), ids=CODECS)
def test_logged_acceleration_and_yaw_rate_have_their_own_scales(codec: Codec) -> None:
    assert str(codec.encode(LogDynamics2(1.0, -1.0, 90.0))) == "501#000200FE002D"
    image = codec.decode(frame("501#000200FE002D")).image
    assert isinstance(image, LogDynamics2)
    assert image.accel_longitudinal_mps2 == pytest.approx(1.0, abs=1e-5)
    assert image.accel_lateral_mps2 == pytest.approx(-1.0, abs=1e-5)
    assert image.yaw_rate_degps == 90.0
