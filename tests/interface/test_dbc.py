"""Our signal databases: complete, strict, and with the traps of the official ones taken out."""

from __future__ import annotations

from pathlib import Path

import pytest
from cantools.database.can import Database, Message

from fsai_vcu.interface.database import dbc_dir
from fsai_vcu.interface.enums import (
    Ami,
    AsState,
    BrakeStatus,
    CarEnum,
    Direction,
    EbsState,
    EbsStatus,
    MissionStatus,
    OpState,
    ShutdownCause,
    SteeringStatus,
    TsState,
)
from fsai_vcu.interface.revisions import REVISIONS, Revision

CAR_FILES = {"2021": "ads_dv_2021.dbc", "2026": "ads_dv_2026.dbc"}


def load(*names: str) -> Database:
    """As any user of cantools loads them: strictly, with its default encoding."""
    database = Database(strict=True)
    for name in names:
        database.add_dbc_file(dbc_dir() / name)
    return database


DATABASES = {name: load(*revision.dbc_files) for name, revision in REVISIONS.items()}
EVERY_MESSAGE = [
    pytest.param(message, id=f"{name}-{message.name}")
    for name, database in DATABASES.items()
    for message in database.messages
]


@pytest.mark.parametrize("path", sorted(dbc_dir().glob("*.dbc")), ids=lambda path: path.name)
def test_each_file_loads_strictly_by_itself(path: Path) -> None:
    assert load(path.name).messages


def test_the_files_hold_all_messages_of_the_interface() -> None:
    assert sorted(message.frame_id for message in load("ads_dv_2021.dbc").messages) == [
        0x120,
        *range(0x500, 0x503),
        *range(0x510, 0x515),
        *range(0x520, 0x527),
    ]
    assert sorted(message.frame_id for message in load("ads_dv_2026.dbc").messages) == [
        *(0x000, 0x080, 0x081, 0x084, 0x123, 0x181, 0x184, 0x284, 0x300, 0x301, 0x302),
        *range(0x500, 0x503),
        *range(0x510, 0x515),
        *range(0x520, 0x527),
    ]
    assert sorted(message.frame_id for message in load("pcan_gps.dbc").messages) == [
        *(0x600, 0x610, 0x611),
        *range(0x620, 0x629),
        *(0x630, 0x640),
    ]


@pytest.mark.parametrize("message", EVERY_MESSAGE)
def test_every_message_and_signal_is_described_whole(message: Message) -> None:
    """Sender, receivers, period and meaning; little-endian, flags unsigned, and room for every named value."""
    (sender,) = message.senders
    assert message.cycle_time is not None and message.cycle_time >= 5 and message.comment
    for signal in message.signals:
        assert signal.receivers and signal.receivers != ["Vector__XXX"] and sender not in signal.receivers
        assert signal.byte_order == "little_endian"
        if signal.length == 1:
            assert (signal.is_signed, signal.minimum, signal.maximum) == (False, 0, 1)
        for raw in signal.choices or {}:
            assert 0 <= raw < 1 << signal.length
            assert signal.maximum is None or raw <= signal.maximum


@pytest.mark.parametrize("database", DATABASES.values(), ids=DATABASES)
def test_senders_and_receivers_are_among_the_nodes_of_the_files(database: Database) -> None:
    nodes = {node.name for name in (*CAR_FILES.values(), "pcan_gps.dbc") for node in load(name).nodes}
    for message in database.messages:
        assert set(message.senders) <= nodes
        assert message.receivers <= nodes


ENUMS: list[tuple[str, str, type[CarEnum], tuple[str, ...]]] = [
    ("AI2VCU_Status", "MISSION_STATUS", MissionStatus, ("2021", "2026")),
    ("AI2VCU_Status", "DIRECTION_REQUEST", Direction, ("2021", "2026")),
    ("VCU2AI_Status", "STEERING_STATUS", SteeringStatus, ("2021", "2026")),
    ("VCU2AI_Status", "AMI_STATE", Ami, ("2021", "2026")),
    ("VCU2AI_Status", "AS_STATE", AsState, ("2026",)),
    ("VCU2AI_Status", "SHUTDOWN_CAUSE", ShutdownCause, ("2021", "2026")),
    ("VCU2AI_Status", "OP_STATE", OpState, ("2026",)),
    ("VCU2AI_Status", "TS_STATE", TsState, ("2026",)),
    ("VCU2AI_Status", "EBS_STATE", EbsState, ("2026",)),
    ("VCU2AI_Brake", "STATUS_BRK", BrakeStatus, ("2021", "2026")),
    ("VCU2AI_Brake", "STATUS_EBS", EbsStatus, ("2021", "2026")),
]


@pytest.mark.parametrize(("message", "signal", "members", "names"), ENUMS, ids=[signal for _, signal, _, _ in ENUMS])
def test_the_enumerations_are_those_of_the_databases(
    message: str, signal: str, members: type[CarEnum], names: tuple[str, ...]
) -> None:
    for name in names:
        choices = DATABASES[name].get_message_by_name(message).get_signal_by_name(signal).choices
        assert choices is not None
        written = {
            raw: str(text).replace(" ", "_").replace("TRACK_DRIVE", "TRACKDRIVE") for raw, text in choices.items()
        }
        assert written == {member.value: member.name for member in members}


def test_2021_has_no_as_init() -> None:
    choices = DATABASES["2021"].get_message_by_name("VCU2AI_Status").get_signal_by_name("AS_STATE").choices
    assert {raw: str(text) for raw, text in (choices or {}).items()} == {
        state.value: state.name for state in AsState if state is not AsState.AS_INIT
    }


def test_0x522_keeps_the_names_of_each_revision() -> None:
    def names(revision: str) -> list[str]:
        return [signal.name for signal in DATABASES[revision].get_message_by_name("VCU2AI_Drive_R").signals]

    assert names("2021") == ["REAR_AXLE_TRQ", "REAR_AXLE_TRQ_REQUEST", "REAR_AXLE_TRQ_MAX"]
    assert names("2026") == ["REAR_AXLE_TRQ_Nm", "REAR_AXLE_TRQ_REQUEST_Nm", "REAR_AXLE_TRQ_MAX_Nm"]


def test_a_name_too_long_for_dbc_is_whole_after_loading() -> None:
    names = [signal.name for signal in DATABASES["2021"].get_message_by_name("VCU_STATUS").signals]
    assert "R1_AI2VCU_STATUS_HANDSHAKE_TIMEOUT_ERROR" in names


@pytest.mark.parametrize("revision", REVISIONS.values(), ids=REVISIONS)
def test_the_steering_range_is_the_limit_of_the_revision(revision: Revision) -> None:
    database = DATABASES[revision.name]
    request = database.get_message_by_name("AI2VCU_Steer").get_signal_by_name("STEER_REQUEST")
    assert (request.minimum, request.maximum) == (-revision.steer_limit_deg, revision.steer_limit_deg)
    live = database.get_message_by_name("VCU2AI_Steer").get_signal_by_name("ANGLE_MAX")
    assert live.maximum == revision.steer_limit_deg


def test_the_pcan_gps_file_reads_in_the_encoding_of_dbc_files() -> None:
    database = load("pcan_gps.dbc")

    def unit(message: str, signal: str) -> str | None:
        return database.get_message_by_name(message).get_signal_by_name(signal).unit

    assert unit("BMC_Acceleration", "Temperature") == "°C"
    assert unit("L3GD20_Rotation_B", "Rotation_Z") == "°/s"
    assert unit("BMC_MagneticField", "MagneticField_X") == "µT"


@pytest.mark.parametrize(
    ("revision", "message", "signal", "scale", "offset", "low", "high"),
    [
        ("2021", "AI2VCU_Drive_F", "FRONT_AXLE_TRQ_REQUEST", 0.1, 0, 0, 195),
        ("2026", "AI2VCU_Drive_R", "REAR_MOTOR_SPEED_MAX", 1, 0, 0, 4000),
        ("2026", "AI2VCU_Brake", "HYD_PRESS_F_REQ_pct", 0.5, 0, 0, 100),
        ("2021", "VCU2AI_Speeds", "RL_WHEEL_SPEED", 1, 0, 0, 1250),
        ("2021", "VCU2LOG_Dynamics1", "Steer_actual", 0.5, 0, -64, 63.5),
        ("2026", "BMC_Acceleration", "Temperature", 0.5, 24, -40, 87.5),
        ("2026", "BMC_Acceleration", "Acceleration_X", 3.91, 0, -20000, 20000),
        ("2026", "VCU2OPUS_1", "LEM_500A_ADC", 0.25, -625, -625, 15758.75),
        ("2026", "AI2LOG_Dynamics2", "Yaw_rate_degps", 0.0078125, 0, -256, 255.992),
    ],
)
def test_scales_offsets_and_ranges(
    revision: str, message: str, signal: str, scale: float, offset: float, low: float, high: float
) -> None:
    found = DATABASES[revision].get_message_by_name(message).get_signal_by_name(signal)
    assert (found.scale, found.offset, found.minimum, found.maximum) == (scale, offset, low, high)
