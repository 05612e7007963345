"""`fsai-vcu send`: what goes out is what was asked for, and what must never go out is refused."""

from __future__ import annotations

import json
import os
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from talking_bus import talking

from fsai_vcu.cli.main import main
from fsai_vcu.diagnostics.decode.databases import load_databases
from fsai_vcu.diagnostics.transmit.sending import outgoing
from fsai_vcu.interface.bus_table import BUS_TABLE
from fsai_vcu.interface.errors import UserError
from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.reserved import AI_IDS, OPTIONAL_AI_ID, RESERVED_IDS
from fsai_vcu.interface.revisions import REVISIONS
from fsai_vcu.runtime.bus import CanBus, open_bus
from fsai_vcu.runtime.lock import InterfaceLock

BENCH = """\
VERSION ""

BU_: AI VCU LAMP

BO_ 419 BenchLamp: 8 AI
 SG_ COLOUR : 0|4@1+ (1,0) [0|15] "" LAMP
 SG_ LEVEL : 8|8@1+ (0.5,0) [0|100] "%" LAMP
 SG_ TRIM : 16|16@1- (0.1,0) [-30|30] "deg" LAMP
 SG_ HEAT : 32|8@1+ (1,20) [20|90] "degC" LAMP
 SG_ GAIN : 40|8@1+ (1,0) [5|50] "" LAMP

BO_ 420 BenchMotor: 3 AI
 SG_ WHICH M : 0|8@1+ (1,0) [0|2] "" LAMP
 SG_ SPEED m0 : 8|16@1+ (1,0) [0|4000] "rpm" LAMP
 SG_ TORQUE m1 : 8|16@1- (0.1,0) [-195|195] "Nm" LAMP

BO_ 421 BenchBig: 2 AI
 SG_ WORD : 7|16@0+ (1,0) [0|65535] "" LAMP

BO_ 422 BenchFromVcu: 1 VCU
 SG_ ANY : 0|8@1+ (1,0) [0|255] "" LAMP

BO_ 2566848767 BenchWide: 4 AI
 SG_ REAL : 0|32@1- (1,0) [0|0] "" LAMP

BO_ 423 BenchLong: 12 AI
 SG_ ANY : 0|8@1+ (1,0) [0|255] "" LAMP

BO_ 2147485220 BenchWideReserved: 1 AI
 SG_ ANY : 0|8@1+ (1,0) [0|255] "" LAMP

BA_DEF_ SG_ "GenSigStartValue" FLOAT 0 65535;
BA_DEF_DEF_ "GenSigStartValue" 0;
BA_ "GenSigStartValue" SG_ 419 LEVEL 40;
BA_ "GenSigStartValue" SG_ 419 GAIN 7;
VAL_ 419 COLOUR 0 "OFF" 1 "RED" 2 "DEEP BLUE";
SIG_VALTYPE_ 2566848767 REAL : 1;
"""


@pytest.fixture
def bench(tmp_path: Path) -> str:
    path = tmp_path / "bench.dbc"
    path.write_text(BENCH)
    return str(path)


def dry(capsys: pytest.CaptureFixture[str], *argv: str) -> str:
    assert main(["send", *argv, "--dry-run"]) == 0
    return capsys.readouterr().out.strip()


def refused(capsys: pytest.CaptureFixture[str], *argv: str, status: int = 1) -> str:
    assert main(["send", *argv]) == status
    said = capsys.readouterr()
    assert said.out == "" and said.err.count("\n") == 1
    return said.err.removeprefix("fsai-vcu send: ").strip()


# ---------------------------------------------------------------- what goes out


@pytest.mark.parametrize(
    ("argv", "frame"),
    [
        (["BenchLamp"], "1A3#0028000000070000"),
        (["BenchLamp", "COLOUR=RED"], "1A3#0128000000070000"),
        (["BenchLamp", "colour=deep_blue", "LEVEL=12.5", "TRIM=-0.3", "HEAT=21"], "1A3#0219FDFF01070000"),
        (["0x1A3", "COLOUR=0x2", "GAIN=50"], "1A3#0228000000320000"),
        (["benchlamp", "LEVEL=100", "TRIM=30"], "1A3#00C82C0100070000"),
        (["BenchMotor", "WHICH=0", "SPEED=4000"], "1A4#00A00F"),
        (["BenchMotor", "WHICH=1", "TORQUE=-195"], "1A4#0162F8"),
        (["BenchBig", "WORD=258"], "1A5#0102"),
        (["BenchWide", "REAL=1.5"], "18FF00FF#0000C03F"),
    ],
)
def test_signals_become_the_bits_of_the_database(
    argv: list[str], frame: str, bench: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert dry(capsys, *argv, "--dbc", bench) == frame


def test_the_cars_own_messages_are_those_of_the_revision(capsys: pytest.CaptureFixture[str]) -> None:
    assert dry(capsys, "AI2VCU_Steer", "STEER_REQUEST=25", "--as-ai") == "513#FA00"
    said = refused(capsys, "AI2VCU_Steer", "STEER_REQUEST=25", "--as-ai", "--revision", "2021", "--dry-run")
    assert said == "STEER_REQUEST 25 is out of range -21 … 21 deg"


def test_json_says_what_the_wire_carries_and_what_was_not_named(bench: str, capsys: pytest.CaptureFixture[str]) -> None:
    entry = json.loads(dry(capsys, "BenchLamp", "COLOUR=RED", "LEVEL=0.7", "--dbc", bench, "--json"))
    assert entry == {
        "message": "BenchLamp",
        "id": 0x1A3,
        "extended": False,
        "frame": "1A3#0101000000070000",
        "signals": {"COLOUR": "RED", "LEVEL": 0.5, "TRIM": 0.0, "HEAT": 20, "GAIN": 7},
        "filled": ["TRIM", "HEAT", "GAIN"],
    }


# ---------------------------------------------------------------- what is refused


@pytest.mark.parametrize(
    ("argv", "words"),
    [
        (["BenchLmap"], "no message 'BenchLmap'; did you mean BenchLamp"),
        (["0x7AB"], "no message has the identifier 0x7AB"),
        (["BenchLamp", "COLOR=1"], "BenchLamp has no signal 'COLOR'; did you mean COLOUR?"),
        (["BenchLamp", "COLOUR"], "'COLOUR' is not SIGNAL=VALUE"),
        (["BenchLamp", "COLOUR="], "'COLOUR=' is not SIGNAL=VALUE"),
        (["BenchLamp", "COLOUR=1", "colour=2"], "COLOUR is given twice"),
        (["BenchLamp", "COLOUR=GREEN"], "COLOUR has no value 'GREEN': it may be OFF, RED, DEEP BLUE"),
        (["BenchLamp", "COLOUR=16"], "COLOUR 16 is out of range 0 … 15"),
        (["BenchLamp", "LEVEL=100.5"], "LEVEL 100.5 is out of range 0 … 100 %"),
        (["BenchLamp", "LEVEL=bright"], "LEVEL: 'bright' is not a number"),
        (["BenchLamp", "LEVEL=nan"], "LEVEL is nan, not a finite number"),
        (["BenchLamp", "TRIM=-inf"], "TRIM is -inf, not a finite number"),
        (["BenchLamp", "TRIM=-30.1"], "TRIM -30.1 is out of range -30 … 30 deg"),
        (["BenchLamp", "HEAT=0"], "HEAT 0 is out of range 20 … 90 degC"),
        (["BenchLamp", "GAIN=51"], "GAIN 51 is out of range 5 … 50"),
        (["BenchMotor", "WHICH=2"], "WHICH 2 selects nothing: it may be 0, 1"),
        (["BenchMotor", "WHICH=0", "TORQUE=1"], "TORQUE is not in the part of BenchMotor that its multiplexer selects"),
        (["BenchWide", "REAL=1e39"], "REAL 1e+39 is out of range"),
        (["BenchFromVcu"], "BenchFromVcu (0x1A6) is the VCU's, as its database says"),
        (["BenchWideReserved"], "BenchWideReserved (0x624) is reserved for the car: it must never be sent from here"),
        (["BenchLong"], "BenchLong has 12 bytes, and a classic CAN frame at most 8"),
        (["BenchLamp", "-i", "nowhere0"], "no CAN interface 'nowhere0'"),
    ],
)
def test_what_cannot_or_must_not_be_sent_is_one_clear_line(
    argv: list[str], words: str, bench: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert refused(capsys, *argv, "--dbc", bench).startswith(words)


@pytest.mark.parametrize(
    ("argv", "words"),
    [
        (["--count", "-1"], "--count is -1, but must be 0 or more"),
        (["--listen", "0"], "--listen is 0, but must be 0.2 or more"),
        ([], "the bus is missing: fsai-vcu send can0 BenchLamp …; --dry-run sends nothing"),
    ],
)
def test_options_that_make_no_sense_are_wrong_use(
    argv: list[str], words: str, bench: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert refused(capsys, "BenchLamp", *argv, "--dbc", bench, status=2).startswith(words)


@pytest.mark.parametrize(
    ("end", "words"),
    [
        (
            BENCH.index("TRIM") + 12,
            "{path}: not a valid DBC file: it ends in the middle of a statement, or without a line end",
        ),
        (BENCH.index("BA_DEF_"), "GAIN must be given: it has no initial value, and 0 is not in 5 … 50"),
    ],
)
def test_a_database_cut_off_or_without_a_default_is_refused(
    end: int, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "bench.dbc"
    path.write_text(BENCH[:end])
    assert refused(capsys, "BenchLamp", "--dbc", str(path), "--dry-run") == words.format(path=path)


@pytest.mark.parametrize("revision", REVISIONS)
@pytest.mark.parametrize("as_ai", [False, True])
def test_only_ai_messages_are_sent_and_only_on_demand(revision: str, as_ai: bool) -> None:
    databases = load_databases(revision=revision)
    allowed = set()
    for layout in databases.layouts.values():
        try:
            allowed.add(outgoing(databases, layout.name, [], as_ai=as_ai).frame.can_id)
        except UserError:
            continue
    assert allowed == ({*AI_IDS, OPTIONAL_AI_ID} if as_ai else set())


def test_reserved_and_foreign_ids_are_refused_under_any_name(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "disguise.dbc"
    for can_id in sorted(RESERVED_IDS | {m.can_id for m in BUS_TABLE} - {*AI_IDS, OPTIONAL_AI_ID}):
        message = f'BO_ {can_id} Harmless: 1 AI\n SG_ A : 0|8@1+ (1,0) [0|255] "" AI\n'
        path.write_text(f'VERSION ""\n\nBU_: AI\n\n{message}')
        said = refused(capsys, "Harmless", "--dbc", str(path), "--as-ai", "--dry-run")
        assert said.startswith(f"Harmless (0x{can_id:03X}) is ") and "must never be sent from here" in said


# ---------------------------------------------------------------- on a bus


@pytest.fixture
def name(request: pytest.FixtureRequest) -> str:
    return f"loopback:send-{os.getpid()}-{request.node.name[:40]}"


@pytest.fixture
def bus(name: str) -> Iterator[CanBus]:
    with open_bus(name) as opened:
        yield opened


def received(bus: CanBus) -> list[Frame]:
    frames = []
    while (frame := bus.recv(0.05)) is not None:
        frames.append(frame)
    return frames


def test_a_frame_goes_out_as_often_as_asked_and_as_far_apart(
    name: str, bus: CanBus, bench: str, capsys: pytest.CaptureFixture[str]
) -> None:
    argv = [name, "BenchLamp", "COLOUR=RED", "--dbc", bench, "--listen", "0.2"]
    begun_s = time.monotonic()
    assert main(["send", *argv, "--count", "5", "--period", "20"]) == 0
    assert time.monotonic() - begun_s >= 0.2 + 4 * 0.02
    assert [str(frame) for frame in received(bus)] == ["1A3#0128000000070000"] * 5
    said = capsys.readouterr()
    assert said.out == "1A3#0128000000070000\n"
    assert said.err.splitlines()[-1] == f"5 frames sent on {name}"


@pytest.mark.parametrize(
    ("can_id", "message"),
    [
        *((can_id, ["BenchLamp"]) for can_id in AI_IDS),
        (0x510, ["AI2VCU_Steer", "--as-ai"]),
        (OPTIONAL_AI_ID, ["AI2LOG_Dynamics2", "--as-ai"]),
    ],
)
def test_a_bus_of_another_sender_of_ai_ids_is_refused(
    can_id: int, message: list[str], name: str, bus: CanBus, bench: str, capsys: pytest.CaptureFixture[str]
) -> None:
    database = ["--dbc", bench] if message[0] == "BenchLamp" else []
    with talking(name, Frame(can_id, bytes(8))):
        said = refused(capsys, *message, *database, "-i", name, "--listen", "60")  # at most
    who = "a PCAN-GPS" if can_id == OPTIONAL_AI_ID else "a live bridge"
    assert said == f"{who} is on {name} (0x{can_id:03X}): stop it first"
    assert {frame.can_id for frame in received(bus)} == {can_id}


def test_a_bridge_that_begins_later_ends_the_sending(
    name: str, bus: CanBus, bench: str, capsys: pytest.CaptureFixture[str]
) -> None:
    ended = threading.Event()

    def begin_at_the_third_frame() -> None:
        with open_bus(name) as bridge:
            for _ in range(3):
                while not ended.is_set() and bridge.recv(0.1) is None:
                    continue
            while not ended.wait(0.01):
                bridge.send(Frame(0x510, bytes(8)))

    thread = threading.Thread(target=begin_at_the_third_frame)
    thread.start()
    try:
        argv = ["BenchLamp", "--dbc", bench, "-i", name, "--count", "6000", "--period", "10", "--listen", "0.2"]
        assert main(["send", *argv]) == 1
    finally:
        ended.set()
        thread.join()
    assert "a live bridge is on" in capsys.readouterr().err.splitlines()[-1]
    assert 3 <= len([frame for frame in received(bus) if frame.can_id == 0x1A3]) < 6000


def test_a_car_alone_is_no_bridge(name: str, bus: CanBus, bench: str) -> None:
    with talking(name, Frame(0x520, bytes(8))):
        assert main(["send", "BenchLamp", "--dbc", bench, "-i", name]) == 0


def test_ai_frames_are_refused_while_a_silent_bridge_has_the_bus(
    name: str, bus: CanBus, capsys: pytest.CaptureFixture[str]
) -> None:
    lock = InterfaceLock(name)
    try:
        said = refused(capsys, "AI2VCU_Steer", "--as-ai", "-i", name)
    finally:
        lock.release()
    assert "another bridge" in said
    assert received(bus) == []
