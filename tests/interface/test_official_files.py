"""Signal databases that are not ours: official files with their quirks, unusual layouts, and files that are wrong."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest
from msgspec.structs import replace

from fsai_vcu.interface.codec import Codec, EncodeError
from fsai_vcu.interface.database import DatabaseError, check_whole, dbc_dir, load_database
from fsai_vcu.interface.enums import (
    AsState,
    Direction,
    EbsState,
    MissionStatus,
    OpState,
    ShutdownCause,
    TsState,
)
from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.messages import (
    FAULT_NAMES,
    AiBrake,
    AiCommand,
    AiStatus,
    AiSteer,
    Faults,
    GpsAltitude,
    GpsStatus,
    Image,
    VcuDriveFront,
    VcuDriveRear,
    VcuStatus,
    WheelSpeeds,
)
from fsai_vcu.interface.revisions import revision

REVISION = revision("2026")
OURS = (dbc_dir() / "ads_dv_2026.dbc").read_text(encoding="cp1252")
GPS = dbc_dir() / "pcan_gps.dbc"
FAULTS = list(FAULT_NAMES.values())
LOGGED = ("LAP_COUNTER", "CONES_COUNT_ACTUAL", "CONES_COUNT_ALL", "VEH_SPEED_ACTUAL", "VEH_SPEED_DEMAND")


def without_signal(text: str, frame_id: int, signal: str) -> str:
    """The database without one signal, its comment and its table."""
    start = text.index(f"BO_ {frame_id} ")
    end = text.index("\n\n", start)
    block = re.sub(rf"^ SG_ {signal} :.*\n", "", text[start:end] + "\n", flags=re.MULTILINE).rstrip("\n")
    text = text[:start] + block + text[end:]
    return re.sub(rf"^(CM_ SG_|VAL_) {frame_id} {signal} .*\n", "", text, flags=re.MULTILINE)


def without_signals(text: str, frame_id: int, *signals: str) -> str:
    for signal in signals:
        text = without_signal(text, frame_id, signal)
    return text


def with_signed_flags(text: str) -> str:
    """As the official files of 2026 declare them."""
    return re.sub(r"\|1@1\+ \(1,0\) \[0\|1\]", "|1@1- (1,0) [0|1]", text)


def with_names(text: str, old: str, new: str) -> str:
    return re.sub(rf"\b{old}\b", new, text)


@pytest.fixture
def codec_of(tmp_path: Path) -> Callable[[str], Codec]:
    def load(text: str) -> Codec:
        path = tmp_path / "official.dbc"
        path.write_text(text, encoding="cp1252")
        return Codec(REVISION, [path, GPS])

    return load


# ---------------------------------------------------------------- official files


def test_signed_flags_are_unsigned_after_loading(codec_of: Callable[[str], Codec]) -> None:
    text = with_signed_flags(OURS)
    assert text.count("|1@1- ") > 20
    codec = codec_of(text)
    for message in codec.database.messages:
        for signal in message.signals:
            if signal.length == 1:
                assert not signal.is_signed
                assert (signal.minimum, signal.maximum) == (0, 1)
    assert str(codec.encode(AiStatus(handshake=True, estop_request=True))) == "510#0101000000000000"
    image = codec.decode(Frame(0x520, bytes.fromhex("010E010300008000"))).image
    assert isinstance(image, VcuStatus)
    assert image.handshake is True
    assert image.go_signal is True
    message = codec.database.get_message_by_name("VCU2AI_Status")
    assert message.decode(bytes.fromhex("0100000000000000"), decode_choices=False)["HANDSHAKE"] == 1  # type: ignore[call-overload]
    assert message.encode(dict.fromkeys((signal.name for signal in message.signals), 1), strict=True)


def test_a_table_for_a_signed_flag_names_1_after_loading(codec_of: Callable[[str], Codec]) -> None:
    text = with_signed_flags(OURS).replace(
        'VAL_ 1312 GO_SIGNAL 0 "NO GO" 1 "GO" ;', 'VAL_ 1312 GO_SIGNAL 0 "NO GO" -1 "GO" ;'
    )
    message = codec_of(text).database.get_message_by_name("VCU2AI_Status")
    values = message.decode(bytes.fromhex("0008000000000000"))
    assert isinstance(values, dict)
    assert str(values["GO_SIGNAL"]) == "GO"
    assert values["GO_SIGNAL"].value == 1  # type: ignore[union-attr]


EVERY_FAULT = Faults(**dict.fromkeys(Faults.__struct_fields__, True))


@pytest.mark.parametrize("fault", [None, "HVIL_OPEN_FAULT"])
def test_the_official_hil_file_with_all_its_quirks_at_once(codec_of: Callable[[str], Codec], fault: str | None) -> None:
    """It lacks fault bits, the shutdown's cause and the logging fields, and its flags are signed."""
    text = without_signals(OURS, 0x520, *(name for name in FAULTS if name != fault), "SHUTDOWN_CAUSE")
    codec = codec_of(with_signed_flags(without_signals(text, 0x510, *LOGGED)))
    said = VcuStatus(
        handshake=True,
        go_signal=True,
        as_state=AsState.AS_DRIVING,
        faults=Faults(hvil_open=True if fault else None),
        op_state=OpState.OP_AUTO,
        ts_state=TsState.TS_RUNNING,
        ebs_state=EbsState.EBS_ARMED,
    )
    assert codec.decode(codec.encode(said)).image == said
    assert codec.decode(codec.encode(AiSteer(-1.5))).image == AiSteer(-1.5)
    decoded = codec.decode(Frame(0x520, bytes.fromhex("000001010002070B")))
    assert isinstance(decoded.image, VcuStatus) and decoded.problems == ()
    assert (decoded.image.faults, decoded.image.fault, decoded.image.shutdown_cause) == (said.faults, True, None)
    every = VcuStatus(faults=EVERY_FAULT, shutdown_cause=ShutdownCause.BMS_FAULT)
    assert codec.encode(every).data == bytes.fromhex("0000010000020000" if fault else "0000010000000000")
    asked = AiCommand(handshake=True, direction=Direction.FORWARD, lap_counter=3, speed_actual_kmh=20)
    assert str(codec.encode_command(asked)[0]) == "510#0140000000000000"
    image = codec.decode(Frame(0x510, bytes.fromhex("0160FFFFFFFFFFFF"))).image
    assert image == AiStatus(True, False, MissionStatus.RUNNING, Direction.FORWARD)


def test_a_file_without_21_signals_is_taken_and_they_are_named(codec_of: Callable[[str], Codec]) -> None:
    missing = [*FAULTS, "SHUTDOWN_CAUSE", "FAULT_STATUS", "WARNING_STATUS", "WARN_BATT_TEMP_HIGH", "WARN_BATT_SOC_LOW"]
    codec = codec_of(without_signals(without_signals(OURS, 0x510, *LOGGED), 0x520, *missing))
    assert len([*LOGGED, *missing]) == 21
    assert all(re.search(rf"\b{name}\b", codec.unknown) for name in [*LOGGED, *missing])
    assert "that the VCU has found a fault is not seen (FAULT_STATUS)" in codec.unknown
    assert "not sent (LAP_COUNTER, " in codec.unknown
    assert "\n" not in codec.unknown and codec.unknown.count("official.dbc") == 1
    assert not any(name in codec.unknown for name in ("HANDSHAKE", "OP_STATE", "GPS", "VCU_STATUS"))


TOLD = ("SHUTDOWN_REQUEST", "AS_SWITCH_STATUS", "TS_SWITCH_STATUS", "STEERING_STATUS", "FAULT_STATUS", "WARNING_STATUS")


def test_what_a_file_lacks_is_decoded_as_idle_or_as_none(codec_of: Callable[[str], Codec]) -> None:
    """Also where cantools finds the bits, as it does with a big-endian signal."""
    text = without_signals(OURS, 0x520, *TOLD)
    by_cantools = text.replace("SG_ WARN_BATT_SOC_LOW : 33|1@1+", "SG_ WARN_BATT_SOC_LOW : 33|1@0+")
    for codec in (codec_of(text), codec_of(by_cantools)):
        image = codec.decode(Frame(0x520, bytes.fromhex("013F030300000000"))).image
        assert isinstance(image, VcuStatus)
        assert (image.handshake, image.go_signal, image.as_state) == (True, True, AsState.AS_DRIVING)
        assert (image.shutdown_request, image.fault, image.warning) == (False, False, False)
        assert (image.as_switch, image.ts_switch, image.steering_status) == (None, None, None)


@pytest.mark.parametrize("name", ["2021", "2026"])
def test_nothing_is_unknown_with_the_revisions_own_signals(name: str) -> None:
    """What a revision never had is not missing: 2021 has no OP_STATE, 2026 no VCU_STATUS."""
    assert Codec(revision(name)).unknown == ""
    assert Codec(revision(name), [dbc_dir() / file for file in revision(name).dbc_files]).unknown == ""


@pytest.mark.parametrize(
    ("name", "spelt", "image"),
    [
        ("FRONT_AXLE_TRQ", "FRONT_AXLE_TRQ_Nm", VcuDriveFront(-3.5, 1.0, 2.0)),
        ("FL_WHEEL_SPEED", "FL_WHEEL_SPEED_rpm", WheelSpeeds(1, 2, 3, 4)),
        ("HYD_PRESS_F_REQ_pct", "HYD_PRESS_F_REQ", AiBrake(front_pct=50.0)),
        ("VCU2AI_Drive_R", "VCU2AI_Drive_R_Nm", VcuDriveRear(1.5, 2.5, 3.5)),
    ],
)
def test_names_are_found_with_or_without_a_unit(
    codec_of: Callable[[str], Codec], name: str, spelt: str, image: Image
) -> None:
    codec = codec_of(with_names(OURS, name, spelt))
    assert codec.decode(codec.encode(image)).image == image


def test_the_first_of_two_files_that_describe_an_identifier_wins(tmp_path: Path) -> None:
    first = tmp_path / "first.dbc"
    first.write_text(OURS.replace('(0.1,0) [-30|30] "deg" VCU', '(0.2,0) [-30|30] "deg" VCU'))
    codec = Codec(REVISION, [first, dbc_dir() / "ads_dv_2026.dbc"])
    assert codec.encode(AiSteer(2.0)).data == bytes.fromhex("0A00")


def test_without_the_pcan_gps_file_its_messages_are_unknown() -> None:
    codec = Codec(REVISION, [dbc_dir() / "ads_dv_2026.dbc"])
    assert not codec.knows(0x620)
    assert re.fullmatch(r".*ads_dv_2026\.dbc: lacks .*: these messages are not read \(.*GPS_Status.*\)", codec.unknown)
    assert codec.decode(Frame(0x620, bytes(3))).image is None
    with pytest.raises(EncodeError, match="GpsStatus"):
        codec.encode(GpsStatus())


# ---------------------------------------------------------------- unusual layouts


def test_big_endian_signals_are_left_to_cantools(codec_of: Callable[[str], Codec]) -> None:
    text = OURS.replace("SG_ STEER_REQUEST : 0|16@1- ", "SG_ STEER_REQUEST : 7|16@0- ")
    assert text != OURS
    codec = codec_of(text)
    assert str(codec.encode(AiSteer(-30.0))) == "513#FED4"
    assert codec.decode(Frame(0x513, bytes.fromhex("012C"))).image == AiSteer(30.0)
    with pytest.raises(EncodeError, match="out of range"):
        codec.encode(AiSteer(30.1))
    assert codec.encode_command(AiCommand(steer_deg=1.0))[3].data == bytes.fromhex("000A")


def test_floats_with_a_scale_and_an_offset_are_scaled(tmp_path: Path) -> None:
    path = tmp_path / "gps.dbc"
    text = GPS.read_text(encoding="cp1252")
    path.write_text(text.replace("GPS_Altitude : 0|32@1- (1,0)", "GPS_Altitude : 0|32@1- (2,-1)"), encoding="cp1252")
    codec = Codec(REVISION, [dbc_dir() / "ads_dv_2026.dbc", path])
    assert str(codec.encode(GpsAltitude(0.0))) == "624#0000003F"  # the float 0.5
    assert codec.decode(Frame(0x624, bytes.fromhex("0000003F"))).image == GpsAltitude(0.0)
    with pytest.raises(EncodeError):
        codec.encode(GpsAltitude(1e39))


def test_signals_with_an_offset_are_shifted_both_ways(codec_of: Callable[[str], Codec]) -> None:
    codec = codec_of(OURS.replace("STEER_REQUEST : 0|16@1- (0.1,0)", "STEER_REQUEST : 0|16@1+ (0.1,-30)"))
    assert str(codec.encode(AiSteer(0.0))) == "513#2C01"
    assert codec.decode(Frame(0x513, bytes.fromhex("2C01"))).image == AiSteer(0.0)
    assert codec.decode(Frame(0x513, bytes.fromhex("0000"))).image == AiSteer(-30.0)


def test_whole_numbers_on_a_coarse_scale_stay_whole(codec_of: Callable[[str], Codec]) -> None:
    codec = codec_of(OURS.replace("FL_WHEEL_SPEED : 0|16@1+ (1,0)", "FL_WHEEL_SPEED : 0|16@1+ (0.5,0)"))
    image = codec.decode(codec.encode(WheelSpeeds(fl_rpm=7))).image
    assert image == WheelSpeeds(fl_rpm=7)
    assert isinstance(image, WheelSpeeds)
    assert type(image.fl_rpm) is int


def test_multiplexed_messages_are_left_to_cantools(codec_of: Callable[[str], Codec]) -> None:
    text = OURS.replace(
        'SG_ HYD_PRESS_F_REQ_pct : 0|8@1+ (0.5,0) [0|100] "%" VCU',
        'SG_ HYD_PRESS_F_REQ_pct M : 0|8@1+ (0.5,0) [0|100] "%" VCU',
    )
    text = text.replace(
        'SG_ HYD_PRESS_R_REQ_pct : 8|8@1+ (0.5,0) [0|100] "%" VCU',
        'SG_ HYD_PRESS_R_REQ_pct m0 : 8|8@1+ (0.5,0) [0|100] "%" VCU',
    )
    codec = codec_of(text)
    assert codec.decode(Frame(0x514, bytes.fromhex("0064"))).image == AiBrake(0.0, 50.0)
    assert str(codec.encode(AiBrake(0.0, 50.0))) == "514#0064"
    assert codec.decode(Frame(0x514, bytes.fromhex("0164"))).image is None
    with pytest.raises(EncodeError, match="AI2VCU_Brake: cannot be encoded"):
        codec.encode(AiBrake(0.5, 50.0))


# ---------------------------------------------------------------- wrong files


@pytest.mark.parametrize("wrong", ["0|16@1- (0,0) [-30|30]", "0|80@1+ (1,0) [0|30]"], ids=["scale 0", "80 bits"])
def test_a_signal_that_cannot_be_read_is_named_with_its_file(codec_of: Callable[[str], Codec], wrong: str) -> None:
    text = OURS.replace("BO_ 1299 AI2VCU_Steer: 2", "BO_ 1299 AI2VCU_Steer: 10")
    with pytest.raises(DatabaseError, match=r"official\.dbc.*: AI2VCU_Steer cannot be read: "):
        codec_of(text.replace("SG_ STEER_REQUEST : 0|16@1- (0.1,0) [-30|30]", f"SG_ STEER_REQUEST : {wrong}"))


def test_what_is_no_file_is_refused_in_one_line(tmp_path: Path) -> None:
    for paths, words in (
        ([absent := tmp_path / "absent.dbc"], rf"^{re.escape(str(absent))}: no such DBC file$"),
        ([tmp_path], "cannot be read"),
        ([], "no DBC file"),
    ):
        with pytest.raises(DatabaseError, match=words):
            load_database(paths)


@pytest.mark.parametrize(
    "content",
    [
        "",
        "rubbish",
        'VERSION ""\n',
        OURS[: OURS.index("SG_ ANGLE_MAX") + 20],
        "\x00\x01\x02",
        OURS.replace("0|16@1- (0.1,0) [-30", "8|16@1- (0.1,0) [-30"),
    ],
    ids=["empty", "rubbish", "no message", "cut off", "binary", "beyond its frame"],
)
def test_a_malformed_file_gets_one_line_with_its_name(tmp_path: Path, content: str) -> None:
    path = tmp_path / "bad.dbc"
    path.write_text(content)
    with pytest.raises(DatabaseError, match=r"bad\.dbc: not a valid DBC file: ") as caught:
        load_database([path])
    assert "\n" not in str(caught.value)


def test_a_file_that_was_cut_off_is_refused_wherever_the_cut_is(tmp_path: Path) -> None:
    path = tmp_path / "cut.dbc"
    whole = GPS.read_text(encoding="cp1252")
    lines = whole.splitlines(keepends=True)
    for number, line in enumerate(lines):
        if line.startswith(("BA_ ", "VAL_ ", "SIG_VALTYPE_ ")):
            path.write_text("".join(lines[:number]) + line[: len(line) // 2], encoding="cp1252")
            with pytest.raises(DatabaseError, match="not a valid DBC file"):
                load_database([path])


@pytest.mark.parametrize(
    "file", [GPS, dbc_dir() / "ads_dv_2021.dbc", dbc_dir() / "ads_dv_2026.dbc"], ids=lambda path: path.name
)
def test_a_cut_within_a_signals_line_is_refused(tmp_path: Path, file: Path) -> None:
    path = tmp_path / "cut.dbc"
    text = file.read_text(encoding="cp1252")
    check_whole(path, text)
    check_whole(path, text.rstrip())  # its last statement has a semicolon
    begin = text.rindex("\n SG_ ") + 2
    end = text.index("\n", begin)
    for cut in range(begin + 1, end + 1):
        with pytest.raises(DatabaseError, match="it ends in the middle of a statement"):
            check_whole(path, text[:cut])
    check_whole(path, text[: end + 1])


def test_a_file_may_end_with_its_last_signal(tmp_path: Path) -> None:
    path = tmp_path / "short.dbc"
    path.write_text('VERSION ""\n\nBU_: A B\n\nBO_ 1 M: 1 A\n SG_ S : 0|8@1+ (1,0) [0|255] "" B\n')
    assert [message.name for message in load_database([path]).messages] == ["M"]


def test_another_cars_database_is_refused() -> None:
    with pytest.raises(DatabaseError, match="no message AI2VCU_Status"):
        Codec(REVISION, [GPS])


@pytest.mark.parametrize(
    ("can_id", "signal"),
    [
        *((0x510, name) for name in ("HANDSHAKE", "ESTOP_REQUEST", "MISSION_STATUS", "DIRECTION_REQUEST")),
        *((0x511, name) for name in ("FRONT_AXLE_TRQ_REQUEST", "FRONT_MOTOR_SPEED_MAX")),
        *((0x512, name) for name in ("REAR_AXLE_TRQ_REQUEST", "REAR_MOTOR_SPEED_MAX")),
        (0x513, "STEER_REQUEST"),
        *((0x514, name) for name in ("HYD_PRESS_F_REQ_pct", "HYD_PRESS_R_REQ_pct")),
        *((0x520, name) for name in ("HANDSHAKE", "AS_STATE", "AMI_STATE", "GO_SIGNAL")),
        *((0x523, name) for name in ("ANGLE", "ANGLE_MAX")),
        *((0x525, name) for name in ("FL_WHEEL_SPEED", "FR_WHEEL_SPEED", "RL_WHEEL_SPEED", "RR_WHEEL_SPEED")),
    ],
)
def test_a_database_without_a_needed_signal_is_refused(
    codec_of: Callable[[str], Codec], can_id: int, signal: str
) -> None:
    with pytest.raises(DatabaseError, match=rf"^[^\n]*official\.dbc[^\n]*: \w+ has no signal {signal}$"):
        codec_of(without_signal(OURS, can_id, signal))


@pytest.mark.parametrize("can_id", [0x501, 0x080, 0x123, 0x7FF, 0x515])
def test_no_database_changes_the_ids_of_the_ai_computer(codec_of: Callable[[str], Codec], can_id: int) -> None:
    text = OURS
    for message in load_database([dbc_dir() / "ads_dv_2026.dbc"]).messages:
        if message.frame_id == can_id:
            text = text.replace(f" {can_id} ", " 1999 ")
    with pytest.raises(DatabaseError, match=f"AI2VCU_Steer has identifier 0x{can_id:03X}, not 0x513"):
        codec_of(re.sub(r"\b1299\b", str(can_id), text))


def test_a_message_that_cantools_reads_keeps_its_time(codec_of: Callable[[str], Codec]) -> None:
    codec = codec_of(OURS.replace("SG_ STEER_REQUEST : 0|16@1- ", "SG_ STEER_REQUEST : 7|16@0- "))
    assert codec.decode(replace(codec.encode(AiSteer(1.0)), t_ns=9)).image == AiSteer(1.0, t_rx_ns=9)
