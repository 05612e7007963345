"""Our signal databases: complete, strict, and with the traps of the official ones taken out."""

from __future__ import annotations

import subprocess
import sys
from contextlib import nullcontext
from pathlib import Path

import pytest
from cantools.database.can import Database, Message

from fsai_vcu.interface.database import DatabaseError, check_bounds, dbc_dir
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


@pytest.mark.parametrize("database", DATABASES.values(), ids=DATABASES)
def test_every_message_and_signal_is_described_whole(database: Database) -> None:
    """Sender, receivers, period and meaning; little-endian, flags unsigned, and room for every named value."""
    for message in database.messages:
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


def test_a_database_is_loaded_without_python_can() -> None:
    code = "import sys, fsai_vcu.interface.database; sys.exit('can' in sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.parametrize(
    ("line", "words"),
    [
        (f"{'S' * 501} : 0|8@1+ (1,0) [0|0] ", "a name, a unit or a word of more than 500 characters"),
        ("S : 0|8@1+ (1e31,0) [0|0] ", "a number is invalid, or beyond 1e\\+30"),
        (f"S : 0|8@1+ (1,-{'9' * 40}) [0|0] ", "a number is invalid, or beyond 1e\\+30"),
        ("S : 0|8@1+ (1e999,0) [0|0] ", "a number is invalid, or beyond 1e\\+30"),
        ("S : 0|8@1+ (1e-30,1e29) [-1e300|1e999] ", ""),
    ],
)
def test_names_and_numbers_larger_than_any_real_one_are_refused(line: str, words: str) -> None:
    database = Database()
    database.add_dbc_string(f'VERSION ""\nBU_: A\nBO_ 1 M: 8 A\n SG_ {line}"" A\n\n')
    with pytest.raises(DatabaseError, match=words) if words else nullcontext():
        check_bounds(Path("x.dbc"), database)


@pytest.mark.parametrize(
    ("can_id", "length", "sender", "words"),
    [
        (1, 8, None, "without a name"),
        (-1, 8, "A", "identifier has not 29 bits"),
        (1, 1786, "A", "more than 1785 bytes"),
        (1, -8, "A", "less than 0"),
    ],
)
def test_messages_that_no_bus_has_are_refused(can_id: int, length: int, sender: str | None, words: str) -> None:
    """Which cantools reads from KCD files."""
    database = Database(messages=[Message(can_id, "M", length, [], senders=[sender])])  # type: ignore[list-item]
    with pytest.raises(DatabaseError, match=words):
        check_bounds(Path("x.kcd"), database)
