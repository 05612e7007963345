"""What is printed without numpy is, to the byte, what LineWriter prints, and whatever is unusual is left to it."""

from __future__ import annotations

import random
import struct
import subprocess
import sys
from pathlib import Path

import cantools.database
import numpy as np
import pytest
from cantools.database.can import Database
from hypothesis import given, settings
from hypothesis import strategies as st

from fsai_vcu.diagnostics.decode.databases import Databases, databases_of, load_databases
from fsai_vcu.diagnostics.decode.decoder import Decoder
from fsai_vcu.diagnostics.decode.lines import LineWriter
from fsai_vcu.diagnostics.decode.printing import Printer
from fsai_vcu.diagnostics.decode.quick_lines import QuickWriter, payloads
from fsai_vcu.diagnostics.log.candump import log_lines, parse_block
from fsai_vcu.diagnostics.log.frames import LogFrame, frames_of

TEXT = """VERSION ""

BU_: AI

BO_ 1 Big: 8 AI
 SG_ Motorola : 7|16@0+ (1,0) [0|0] "" AI

BO_ 2 Whole: 8 AI
 SG_ Percent : 0|12@1+ (1,0) [0|0] "%" AI
 SG_ Signed : 12|12@1- (1,0) [0|0] "100%s" AI
 SG_ Scaled : 24|8@1- (0.1,-40) [0|0] "" AI
 SG_ Doubled : 32|8@1- (2,1) [0|0] "" AI
 SG_ Word : 40|2@1+ (5,0) [0|0] "V" AI

BO_ 3 Long: 8 AI
 SG_ L : 0|64@1- (1,0) [0|0] "" AI

BO_ 4 Float: 8 AI
 SG_ F : 16|32@1- (0.1,1) [0|0] "N" AI

BO_ 5 Double: 8 AI
 SG_ D : 0|64@1- (1,0) [0|0] "" AI

BO_ 6 Empty: 0 AI

BO_ 2147483655 Extended: 2 AI
 SG_ Low : 3|7@1+ (0.5,0) [0|0] "" AI

VAL_ 2 Word 0 "OFF" 2 "VERY %d ON" ;
SIG_VALTYPE_ 4 F : 1;
SIG_VALTYPE_ 5 D : 2;
"""
LINES = b"(1.000000) can0 002#0102030405060708\n(1.000010) can0 00000007#FFFF\n"


@pytest.fixture(scope="module")
def other() -> Databases:
    database = cantools.database.load_string(TEXT, "dbc")
    assert isinstance(database, Database)
    return databases_of([database])


def slowly(databases: Databases, block: bytes, *, words: bool = True) -> bytes:
    return LineWriter(Decoder(databases), words=words).block(parse_block(np.frombuffer(block, np.uint8), [])[0])


def quickly(databases: Databases, block: bytes, *, words: bool = True) -> bytes | None:
    def never(frame: bytes) -> bytes:
        raise AssertionError(f"{frame!r} is nothing unusual")

    found = QuickWriter(databases, never, words=words).block(block)
    return None if found is None else found[0]


def written(databases: Databases, seed: int) -> bytes:
    """Payloads at random of every message, from 7 s to 12 s."""
    chance = random.Random(seed)
    layouts = list(databases.layouts.values())
    special = [
        bytes(8),
        b"\xff" * 8,
        *(struct.pack("<d", x) for x in (float("nan"), float("-inf"), -0.0, 5e-324, 1e300)),
    ]
    frames = []
    for n in range(4000):
        layout = layouts[n % len(layouts)]
        data = chance.choice(special) if chance.random() < 0.1 else chance.randbytes(8)
        data = data.ljust(layout.length, b"\0")[: layout.length]
        frames.append(LogFrame(7_000_000_000 + n * 1_250_000, "vcan0", layout.can_id, data, layout.extended))
    return b"\n".join(log_lines(frames_of(frames))) + b"\n"


@pytest.mark.parametrize("revision", ["2021", "2026"])
@pytest.mark.parametrize("words", [True, False])
def test_quick_lines_of_all_car_messages_are_as_the_full_writers(revision: str, words: bool) -> None:
    databases = load_databases(revision=revision)
    block = written(databases, 3)
    assert quickly(databases, block, words=words) == slowly(databases, block, words=words)


@pytest.mark.parametrize("words", [True, False])
def test_any_database_is_printed_alike(other: Databases, words: bool) -> None:
    block = written(other, 4)
    printed = Printer(other, words=words)(block)
    assert printed.text == slowly(other, block, words=words)
    assert (printed.frames, printed.lines, printed.problems) == (4000, 4000, [])


@pytest.mark.parametrize(
    ("ordinary", "otherwise"),
    [
        (b"#0102", b"#01a2"),
        (b"#FFFF", b"#ffff"),
        (b"00000007", b"00000abc"),
        (b"08\n", b"08 R\n"),
        (b"08\n", b"08\r\n"),
        (b"08\n", b"08\n\n"),
        (b"08\n", b"08\nno frame\n"),
        (b"08\n", b"0809\n"),
        (b"08\n", b"0\n"),
        (b"(1.000000)", b"(01.000000)"),
        (b"(1.000000)", b"(9999999999.000000)"),
        (b"(1.000010)", b"(9999999999.000010)"),
        (b"(1.000010)", b"(1.00001)"),
        (b"(1.000010)", b"(x.000010)"),
        (b"002#0102030405060708", b"002#R"),
        (b"002#0102030405060708", b"002##10102"),
        (b"002#0102030405060708", b"802#01"),
        (b"00000007#", b"E0000007#"),
        (b"can0 002", b"c\xe4n0 002"),
        (b"can0 002", b"can0\t002"),
    ],
)
def test_unusual_logs_are_left_to_the_general_reader(ordinary: bytes, otherwise: bytes, other: Databases) -> None:
    block = LINES.replace(ordinary, otherwise, 1)
    assert block != LINES
    assert quickly(other, LINES) == slowly(other, LINES)
    assert quickly(other, block) is None
    printed = Printer(other)(block)
    _, unreadable, lines = parse_block(np.frombuffer(block, np.uint8), [])
    assert printed.text == slowly(other, block)
    assert (printed.lines, printed.problems) == (lines, [tuple(each) for each in unreadable])


@pytest.mark.parametrize(
    "frame", [b"002#01", b"001#0102030405060708", b"20000040#0000000000000000", b"7FE#00", b"006#"]
)
def test_frames_that_are_no_plain_messages_are_said_alike(frame: bytes, other: Databases) -> None:
    block = LINES + b"(1.000020) can0 " + frame + b"\n"
    assert Printer(other)(block).text == slowly(other, block)


def test_longer_times_and_names_of_buses_may_come_in_one_block(other: Databases) -> None:
    block = b"".join(
        b"(%d.000000) %s 002#0102030405060708\n" % (t, bus)
        for t in (1, 9, 10, 1_700_000_000)
        for bus in (b"can0", b"can1")
    )
    assert quickly(other, block) == slowly(other, block)
    many = b"".join(b"(1.%06d) %s 006#\n" % (n, b"can0" if n % 2 else b"vcan0") for n in range(100))
    assert quickly(other, many) is None
    assert Printer(other)(many).text == slowly(other, many)


@given(st.lists(st.sampled_from(list(" ()#.:0123456789ABCDEFabcdefgRTXcan\t\r\n\0\xff")), max_size=60).map("".join))
@settings(max_examples=100, deadline=None)
def test_any_line_is_printed_as_by_the_full_writer(text: str) -> None:
    databases = load_databases()
    block = f"(1.000000) can0 520#01A5\n(1.000000) can0 {text}\n(1.000001) can0 520#{text}\n".encode("latin-1")
    assert Printer(databases)(block).text == slowly(databases, block)


def test_payloads_are_those_of_frames_with_11_bit_identifiers() -> None:
    assert payloads(LINES + b"(1.0) x 523#0000d200\n(1.0) x 523##1AB\n(1.0) x 523#R\n") == {
        (2, 8, 0x0807060504030201),
        (0x523, 4, 0x00D20000),
    }


def test_a_usual_log_is_decoded_without_slow_imports(tmp_path: Path) -> None:
    log = tmp_path / "run.log"
    log.write_text("(1.000000) can0 523#640064006400\n(1.000000) can0 7FE#00\n")
    load_databases()  # and what is made of its files is remembered
    program = (
        "import sys; from fsai_vcu.cli.main import main; "
        f"assert main(['decode', {str(log)!r}]) == 0; assert not {{'numpy', 'cantools', 'can'}} & set(sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.count("\n") == 2
