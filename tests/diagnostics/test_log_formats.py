"""Logs of every tool are read by their content; what is in them beside frames is told, and no loss is hidden."""

from __future__ import annotations

import base64
import bz2
import codecs
import gzip
import io
import lzma
import random
import sqlite3
import struct
import tarfile
import zipfile
import zlib
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given as drawing
from hypothesis import settings
from hypothesis import strategies as st

from fsai_vcu.cli.main import main
from fsai_vcu.diagnostics.log import blocks
from fsai_vcu.diagnostics.log.asc import AscRows
from fsai_vcu.diagnostics.log.blocks import parse_block
from fsai_vcu.diagnostics.log.formats import FORMATS
from fsai_vcu.diagnostics.log.frames import LogFrame
from fsai_vcu.diagnostics.log.problems import Problems
from fsai_vcu.diagnostics.log.reader import Log, open_log
from fsai_vcu.diagnostics.log.rows import Rows
from fsai_vcu.diagnostics.log.trc import TrcRows

ROWS = [(0x520, bytes(range(n % 3, n % 3 + 8))) if n % 2 else (0x514, bytes((n, 255 - n))) for n in range(24)]
T0_S = 1_732_400_020
DATE = "Sat Nov 23 02:15:00.000 pm 2024"


def hexes(data: bytes, separator: str = " ") -> str:
    return data.hex(separator).upper()


def time_s(number: int) -> str:
    return f"{number * 0.01:.6f}"


def candump() -> str:
    return "".join(f"({T0_S}.{n:02d}0000) can0 {i:03X}#{d.hex().upper()}\n" for n, (i, d) in enumerate(ROWS))


def asc(head: str = f"date {DATE}\nbase hex  timestamps absolute\n", begin: str = "", end: str = "") -> str:
    rows = (f"   {time_s(n)} 1  {i:X}             Rx   d {len(d)} {hexes(d)}\n" for n, (i, d) in enumerate(ROWS))
    return head + begin + "".join(rows) + end


def trc(version: str) -> str:
    head = f";$FILEVERSION={version}\n;$STARTTIME=45619.59375\n;\n" if version != "1.0" else ";" + "#" * 40 + "\n;\n"
    head += ";$COLUMNS=N,O,T,B,I,d,R,V,S,A,r,s,L,D\n" if version == "3.0" else ""
    row = {
        "1.0": "{n:6}) {ms:10} {i:04X} {l} {d}\n",
        "1.1": "{n:6}) {ms:10.1f} Rx {i:04X} {l} {d}\n",
        "1.2": "{n:6}) {ms:10.3f} 1 Rx {i:04X} {l} {d}\n",
        "1.3": "{n:6}) {ms:10.3f} 1 Rx {i:04X} - {l} {d}\n",
        "2.0": "{n:6} {ms:10.3f} DT {i:04X} Rx {l} {d}\n",
        "2.1": "{n:6} {ms:10.3f} DT 1 {i:04X} Rx - {l} {d}\n",
        "3.0": "{n:6} {ms:10.3f} DT 1 {i:9X} Rx - - - -          - - {l:<4} {d}\n",
    }[version]
    return head + "".join(row.format(n=n, ms=n * 10, i=i, l=len(d), d=hexes(d)) for n, (i, d) in enumerate(ROWS, 1))


def table(head: str, row: str) -> str:
    each = ((n, i, d) for n, (i, d) in enumerate(ROWS))
    return head + "".join(
        row.format(t=f"{T0_S}.{n:02d}0000", ms=n * 10, i=f"{i:X}", l=len(d), x=d.hex(), b=base64.b64encode(d).decode())
        for n, i, d in each
    )


def blf(objects: list[bytes] | None = None, *, closed: bool = True, packed: bool = True) -> bytes:
    objects = blf_frames() if objects is None else objects
    inner = b"".join(objects)
    content = zlib.compress(inner) if packed else inner
    container = struct.pack("<H6xL4x", 2 if packed else 0, len(inner)) + content
    container = struct.pack("<4sHHLL", b"LOBJ", 16, 1, 16 + len(container), 10) + container
    container += bytes(len(container) % 4)
    began = struct.pack("<8H", 2024, 11, 6, 23, 14, 15, 0, 0)
    size = 144 + len(container) if closed else 144
    counts = struct.pack("<QQLL", size, 144 + len(inner), len(objects) if closed else 0, 0)
    return struct.pack("<4sL8x", b"LOGG", 144) + counts + began + bytes(88) + container


def blf_object(kind: int, number: int, body: bytes) -> bytes:
    whole = struct.pack("<4sHHLL", b"LOBJ", 32, 1, 32 + len(body), kind)
    whole += struct.pack("<LHHQ", 2, 0, 0, number * 10_000_000) + body
    return whole + bytes(-len(whole) % 4)


def blf_frame(number: int, can_id: int, data: bytes) -> bytes:
    return blf_object(1, number, struct.pack("<HBBL8s", 1, 0, len(data), can_id, data))


def blf_frames() -> list[bytes]:
    return [blf_frame(n, i, d) for n, (i, d) in enumerate(ROWS)]


def packets() -> list[bytes]:
    return [struct.pack(">LBBxx", i, len(d), 0) + d.ljust(8, b"\0") for i, d in ROWS]


HEADS = {227: b"", 113: struct.pack(">HHHQH", 0, 280, 0, 0, 12), 276: struct.pack(">HHLHBBQ", 12, 0, 3, 280, 0, 0, 0)}
"""Bytes before each packet of a capture: none, or on `any` the head of a cooked one."""


def pcap(link: int = 227, order: str = "<") -> bytes:
    """On `any`, identifiers are in the computer's own order."""
    whole = struct.pack(f"{order}LHHLLLL", 0xA1B2C3D4, 2, 4, 0, 0, 65535, link)
    for n, packet in enumerate(packets()):
        can_id = packet[:4] if link == 227 or order == ">" else packet[3::-1]
        body = HEADS[link] + can_id + packet[4:]
        whole += struct.pack(f"{order}LLLL", T0_S, n * 10_000, len(body), len(body)) + body
    return whole


def pcapng() -> bytes:
    def block(kind: int, body: bytes) -> bytes:
        body += bytes(-len(body) % 4)
        size = struct.pack("<L", len(body) + 12)
        return struct.pack("<L", kind) + size + body + size

    begin = block(0x0A0D0D0A, struct.pack("<LHHq", 0x1A2B3C4D, 1, 0, -1))
    begin += block(1, struct.pack("<HHLHH4s", 227, 0, 0, 2, 4, b"can0"))
    stamps = (T0_S * 1_000_000 + n * 10_000 for n in range(len(ROWS)))
    return begin + b"".join(
        block(6, struct.pack("<LLLLL", 0, us >> 32, us & 0xFFFFFFFF, 16, 16) + packet)
        for us, packet in zip(stamps, packets(), strict=True)
    )


def sqlite_db(folder: Path) -> bytes:
    path = folder / "made.db"
    with sqlite3.connect(path) as database:
        database.execute(
            "CREATE TABLE messages (ts REAL, arbitration_id INTEGER, extended INTEGER, remote INTEGER, "
            "error INTEGER, dlc INTEGER, data BLOB)"
        )
        rows = [(T0_S + n * 0.01, i, 0, 0, 0, len(d), d) for n, (i, d) in enumerate(ROWS)]
        database.executemany("INSERT INTO messages VALUES (?, ?, ?, ?, ?, ?, ?)", rows)
    database.close()
    return path.read_bytes()


TRC_VERSIONS = ("1.0", "1.1", "1.2", "1.3", "2.0", "2.1", "3.0")
BUSMASTER_HEAD = (
    "***BUSMASTER Ver 3.2.2***\n***START DATE AND TIME 23:11:2024 14:15:00:000***\n***HEX***\n***SYSTEM MODE***\n"
)
MADE: dict[str, Callable[[], str | bytes]] = {
    "candump": candump,
    "ASC": asc,
    "ASC without a head": lambda: asc(""),
    **{f"TRC {version}": (lambda v: lambda: trc(v))(version) for version in TRC_VERSIONS},
    "GVRET": lambda: "Time Stamp,ID,Extended,Dir,Bus,LEN,D1,D2,D3,D4,D5,D6,D7,D8\n"
    + "".join(f"{n * 10_000},{i:08X},false,Rx,0,{len(d)},{hexes(d, ',')},\n" for n, (i, d) in enumerate(ROWS)),
    "python-can CSV": lambda: table(
        "timestamp,arbitration_id,extended,remote,error,dlc,data\n", "{t},0x{i},0,0,0,{l},{b}\n"
    ),
    "cabana CSV": lambda: table("time,addr,bus,data\n", "{t},0x{i},0,0x{x}\n"),
    "CANedge CSV": lambda: table(
        "TimestampEpoch;BusChannel;ID;IDE;DLC;DataLength;Dir;EDL;BRS;DataBytes\n", "{t};0;{i};0;{l};{l};0;0;0;{x}\n"
    ),
    "CL2000": lambda: table("# Logger type: CL2000\nTimestamp;Type;ID;Data\n", "{ms:0>5};0;{i};{x}\n"),
    "BusMaster": lambda: BUSMASTER_HEAD
    + "".join(f"14:15:00:{n:02d}00 Rx 1 0x{i:X} s {len(d)} {hexes(d)} \n" for n, (i, d) in enumerate(ROWS)),
    "Kvaser": lambda: " Chn Identifier Flg   DLC  D0...1...2...3...4...5...6..D7       Time     Dir\n"
    + "".join(f" 0    {i:X}     {len(d)}  {d.hex(' ')}   {time_s(n)} R\n" for n, (i, d) in enumerate(ROWS)),
    "CRTD": lambda: "".join(f"{T0_S}.{n:02d}0000 1R11 {i:03X} {hexes(d)}\n" for n, (i, d) in enumerate(ROWS)),
    "BLF": blf,
    "BLF not packed": lambda: blf(packed=False),
    "pcap": pcap,
    "pcapng": pcapng,
    "pcap of any": lambda: pcap(113),
    "pcap of any, big-endian": lambda: pcap(113, ">"),
    "pcap of any, with interfaces": lambda: pcap(276),
}  # fmt: skip


def as_bytes(content: str | bytes) -> bytes:
    return content.encode() if isinstance(content, str) else content


def given(path: Path, content: str | bytes) -> tuple[list[LogFrame], Log]:
    path.write_bytes(as_bytes(content))
    with open_log(path) as log:
        return list(log.frames()), log


def of(frames: list[LogFrame]) -> list[tuple[int, bytes]]:
    return [(frame.can_id, frame.data) for frame in frames if not frame.error]


def assert_whole(frames: list[LogFrame], log: Log) -> None:
    assert (log.problems.texts, of(frames)) == ([], ROWS)
    assert [frame.t_ns - frames[0].t_ns for frame in frames] == [n * 10_000_000 for n in range(len(ROWS))]


@pytest.mark.parametrize("what", MADE)
def test_a_log_of_each_format_is_read_whole_and_in_time(what: str, tmp_path: Path) -> None:
    assert_whole(*given(tmp_path / "run.any", MADE[what]()))


def test_a_database_of_python_can_is_read_whole(tmp_path: Path) -> None:
    assert_whole(*given(tmp_path / "run.db", sqlite_db(tmp_path)))


def bag(folder: Path, kind: str = "can_msgs/msg/Frame") -> bytes:
    """A bag of ROS 2 in SQLite, with one topic of that type, its messages as CDR."""
    path = folder / "made.db3"
    with sqlite3.connect(path) as database:
        database.execute("CREATE TABLE topics (id INTEGER, name TEXT, type TEXT, serialization_format TEXT)")
        database.execute("CREATE TABLE messages (id INTEGER, topic_id INTEGER, timestamp INTEGER, data BLOB)")
        database.execute("INSERT INTO topics VALUES (1, '/from_can_bus', ?, 'cdr')", (kind,))
        for n, (can_id, data) in enumerate(ROWS):
            head = struct.pack("<iII4s", T0_S, n * 10_000_000, 4, b"can\0")
            body = head + struct.pack("<IBBBB8s", can_id, 0, 0, 0, len(data), data)
            database.execute("INSERT INTO messages VALUES (?, 1, ?, ?)", (n, 1, b"\0\1\0\0" + body))
    database.close()
    return path.read_bytes()


def test_a_bag_of_ros_2_is_read_whole_or_named(tmp_path: Path) -> None:
    assert_whole(*given(tmp_path / "run.db3", bag(tmp_path)))
    (tmp_path / "made.db3").unlink()
    frames, log = given(tmp_path / "run.db3", bag(tmp_path, "std_msgs/msg/String"))
    assert frames == [] and "without a topic of can_msgs/Frame: record the bus itself" in log.problems.texts[0]


def test_a_bag_whose_topic_has_no_name_loses_its_rows_only(tmp_path: Path) -> None:
    bag(tmp_path)
    with sqlite3.connect(tmp_path / "made.db3") as database:
        database.execute("ALTER TABLE topics RENAME TO named")
        database.execute("CREATE TABLE topics (id INTEGER, name, type TEXT)")
        database.execute("INSERT INTO topics SELECT id, 5, type FROM named")
    database.close()
    frames, log = given(tmp_path / "run.db3", (tmp_path / "made.db3").read_bytes())
    assert frames == [] and log.problems.count == len(ROWS)


@pytest.mark.parametrize("times", ["absolute", "relative"])
def test_a_year_that_no_clock_has_is_a_date_not_read(times: str, tmp_path: Path) -> None:
    rows = "".join(f"   {n / 100:.6f} 1  520             Rx   d 1 01\n" for n in range(200))
    head = f"date Mon Sep 4 10:00:00.000 am 2917\nbase hex  timestamps {times}\n"
    frames, log = given(tmp_path / "run.asc", (head + rows).encode())
    assert len(frames) == 200 and "the date in the head cannot be read" in log.problems.note_line()


@pytest.mark.parametrize("make", [sqlite_db, bag])
def test_a_database_cut_or_changed_hides_no_loss(make: Callable[[Path], bytes], tmp_path: Path) -> None:
    content = bytearray(make(tmp_path))
    chance = random.Random(1)
    for number in range(40):
        at = chance.randrange(100, len(content))
        spoilt = (
            content[:at] if number % 2 else content[:at] + bytes([content[at] ^ 1 << number % 8]) + content[at + 1 :]
        )
        frames, log = given(tmp_path / "run.db", bytes(spoilt))
        assert len(frames) <= len(ROWS) and (len(frames) == len(ROWS) or log.problems), at


def test_each_format_has_a_row_in_the_documentation() -> None:
    page = (Path(__file__).parents[2] / "docs/logs.md").read_text()
    assert [each.name for each in FORMATS if f"\n| {each.name}" not in page] == []


# ---------------------------------------------------------------- packed, marked


def tar_of(content: bytes) -> bytes:
    packed = io.BytesIO()
    with tarfile.open(fileobj=packed, mode="w:gz") as archive:
        info = tarfile.TarInfo("run.log")
        info.size = len(content)
        archive.addfile(info, io.BytesIO(content))
    return packed.getvalue()


def zip_of(*contents: bytes) -> bytes:
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        for number, content in enumerate(contents):
            archive.writestr(f"run{number}.log", content)
    return packed.getvalue()


def zstd_of(content: bytes) -> bytes:
    return pytest.importorskip("backports.zstd", reason="backports.zstd is not installed").compress(content)


PACKINGS: dict[str, Callable[[bytes], bytes]] = {
    "gz": gzip.compress,
    "gz in two parts": lambda content: gzip.compress(content[:100]) + gzip.compress(content[100:]),
    "xz": lzma.compress,
    "bz2": bz2.compress,
    "zst": zstd_of,
    "zip": zip_of,
}


@pytest.mark.parametrize("what", ["candump", "BLF", "TRC 2.1"])
@pytest.mark.parametrize("how", PACKINGS)
def test_a_packed_log_is_read_like_the_log_itself(how: str, what: str, tmp_path: Path) -> None:
    content = PACKINGS[how](as_bytes(MADE[what]()))
    assert_whole(*given(tmp_path / "run.log", content))
    for cut in (len(content) // 2, len(content) - 1):
        assert given(tmp_path / "run.log", content[:cut])[1].problems


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: tar_of(candump().encode()), "a tar archive: unpack it first"),
        (lambda: zip_of(b"x", b"y"), "a zip archive of 2 files: unpack it first"),
        (lambda: b"\x89MCAP0\r\n" + bytes(50), "an MCAP"),
        (lambda: b"MDF     3.30    " + bytes(50), "an MDF older than version 4"),
        (lambda: b"SQLite format 3\0" + bytes(84), "not readable as SQLite"),
        (lambda: trc("3.0").replace("3.0", "4.0"), "TRC version 4.0 is not read: save it as 2.1"),
        (lambda: b"\x00\x01\x02" * 50, "no format of a log that is read"),
    ],
)
def test_what_is_not_read_is_named_with_the_way(make: Callable[[], str | bytes], words: str, tmp_path: Path) -> None:
    frames, log = given(tmp_path / "run.log", make())
    assert frames == [] and words in log.problems.texts[0]


TEXTS = ["candump", "ASC", "TRC 2.1", "GVRET"]
SAVED: dict[str, Callable[[str], bytes]] = {
    "UTF-8 with a mark": lambda text: codecs.BOM_UTF8 + text.encode(),
    "UTF-16": lambda text: text.replace("\n", "\r\n").encode("utf-16"),
    "UTF-16 without a mark": lambda text: text.encode("utf-16-be"),
    "old Mac": lambda text: text.replace("\n", "\r").encode(),
    "blank lines first": lambda text: b"\r\n  \r\n" + text.encode(),
    "no line end last": lambda text: text.removesuffix("\n").encode(),
}


@pytest.mark.parametrize("what", TEXTS)
@pytest.mark.parametrize("how", SAVED)
def test_a_text_is_read_however_it_was_saved(how: str, what: str, tmp_path: Path) -> None:
    text = MADE[what]()
    assert isinstance(text, str)
    assert_whole(*given(tmp_path / "run.txt", SAVED[how](text)))


# ---------------------------------------------------------------- ASC


@pytest.mark.parametrize(
    ("date", "since_1970_s"),
    [
        ("Sat Nov 23 02:15:00.000 pm 2024", 1732371300),
        ("Sat Nov 23 14:15:00 2024", 1732371300),
        ("11 23 14:15:00.000 pm 2024", 1732371300),
        ("Sam Nov 23 14:15:00.500 2024", 1732371300),
        ("Mit M\udce4r 06 02:15:00.000 pm 2024", 1709734500),
        ("Mo Dez 2 02:15:00 am 2024", 1733105700),
        ("Di 23.11.2024 14:15:00", 1732371300),
        ("Sat Nov 23 14:15:00", None),
        ("yesterday", None),
    ],
)
def test_a_date_in_any_language_costs_no_frame(
    date: str, since_1970_s: int | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    content = asc(f"date {date}\nbase hex  timestamps absolute\n").encode("utf-8", "surrogateescape")
    frames, log = given(tmp_path / "run.asc", content)
    assert_whole(frames, log)
    assert frames[0].t_ns // 1_000_000_000 in (
        (0,) if since_1970_s is None else range(since_1970_s - 50400, since_1970_s + 50400)
    )
    assert bool(log.problems.notes) == (since_1970_s is None)


def test_relative_times_of_asc_are_added_up(tmp_path: Path) -> None:
    rows = [f"   {0.0 if n % 2 else 0.02:.6f} 1  {i:X} Rx d {len(d)} {hexes(d)}\n" for n, (i, d) in enumerate(ROWS)]
    begin = f"Begin Triggerblock {DATE}\n   0.000000 Start of measurement\n"
    head = f"date {DATE}\nbase hex  timestamps relative\n"
    frames, log = given(tmp_path / "run.asc", head + begin + "".join(rows) + "End TriggerBlock\n")
    assert (log.problems.texts, of(frames)) == ([], ROWS)
    assert [frame.t_ns - frames[0].t_ns for frame in frames] == [n // 2 * 20_000_000 for n in range(len(ROWS))]


@pytest.mark.parametrize(
    ("row", "words"),
    [
        ("   0.1 1  EngineData Rx   d 8 01 02 03 04 05 06 07 08", "no identifier: EngineData"),
        ("   0.1 1  123  Rx   d 8 01 02 ZZ 04 05 06 07 08", "no data bytes"),
        ("   0.1 1  123  Rx   d 6 1A 07", "2 data bytes where 6 are announced"),
        ("   0.1 1  923  Rx   d 1 1A", "no 11-bit identifier: 923"),
        ("   0.1 1  something else", "not a row of ASC"),
        ("what is this", "not a row of ASC"),
    ],
)
def test_one_bad_row_of_asc_is_named_and_costs_itself(row: str, words: str, tmp_path: Path) -> None:
    frames, log = given(tmp_path / "run.asc", asc().replace("\n", f"\n{row}\n", 5).replace(f"{row}\n", "", 4))
    assert of(frames) == ROWS
    assert len(log.problems.texts) == 1 and f"line 6: {words}" in log.problems.texts[0]


@pytest.mark.parametrize("row", ["1 0520 ZZ", "1 0520 Rx - 8 01 02 0", "1 0820 Rx - 1 01", "1 0520 Rx - 2 01", "Q"])
@pytest.mark.parametrize("kind", ["DT", "XX"])
def test_one_bad_row_of_trc_is_named_and_costs_itself(row: str, kind: str, tmp_path: Path) -> None:
    text = trc("2.1")
    frames, log = given(tmp_path / "run.trc", text + f"  25  250.000 {kind} {row}\n")
    assert of(frames) == ROWS and len(log.problems.texts) == 1 and "line 28: " in log.problems.texts[0]


def test_what_is_usual_in_other_tools_rows_is_read(tmp_path: Path) -> None:
    rows = """\
  -0.5 1  511  Rx d 2 00 01
  0,010 2  18FF0001x  Tx   d 1 7F  Length = 0 BitCount = 67 ID = 291
  0.020 1  123  Rx   r 4
  0.030 CANFD   1 Rx        300         1 0 9 12 01 02 03 04 05 06 07 08 09 0a 0b 0c 0 0 3000 0 0
  0.040 1  124  TxRq   d 1 01
  0.050 1  Statistic: D 1 R 0 XD 0 XR 0 E 0 O 0 B 1.5%
"""
    frames, log = given(tmp_path / "run.asc", "date Sat Nov 23 14:15:00 2024\nbase hex  timestamps absolute\n" + rows)
    assert log.problems.texts == [] and sum(log.problems.notes.values()) == 2
    plain, wide, remote, fd = frames
    assert (plain.data, wide.extended, wide.channel, wide.sent) == (b"\x00\x01", True, "can1", True)
    assert (remote.remote, remote.length, fd.fd, fd.brs, fd.esi, len(fd.data)) == (True, 4, True, True, False, 12)
    assert wide.t_ns - plain.t_ns == 510_000_000


# ---------------------------------------------------------------- errors of the bus


ASC_ERRORS = ["1  ErrorFrame", "CAN 1 Status:chip status error busoff", "1  OverloadFrame", "1 123 TxErr d 1 00"]
ASC_ERRORS += [
    "CANFD 1 Rx ErrorFrame x",
    "CAN 1 Status:chip status warning level",
    "CAN 2 Status:chip status error passive",
]
BAD_BUS: dict[str, Callable[[], str | bytes]] = {
    **{f"ASC {row}": (lambda r: lambda: asc() + f"   0.300000 {r}\n")(row) for row in ASC_ERRORS},
    **{
        f"BLF {kind}": (lambda k, b: lambda: blf([*blf_frames(), blf_object(k, 30, b)]))(kind, body)
        for kind, body in (
            (2, struct.pack("<HHL", 1, 0, 0)),
            (3, struct.pack("<HHL", 1, 0, 0)),
            (31, struct.pack("<HBBL", 1, 255, 0, 0x68)),
            (73, struct.pack("<HHLBBBxLLH2x8s", 1, 0, 1, 0x80, 0, 0, 0, 0, 0, b"")),
            (104, bytes(40)),
        )
    },
    "TRC ER": lambda: trc("2.1") + "  25  250.000 ER 1 Rx - 5 04 00 02 00 00\n",
    "TRC ST": lambda: trc("2.1") + "  25  250.000 ST 1 Rx - 4 00 00 00 10\n",
    "TRC Warng": lambda: trc("1.1") + "  25)  250.0 Warng FFFFFFFF 4 00 00 00 08 BUSHEAVY\n",
    "TRC Error": lambda: trc("1.1") + "  25)  250.0 Error 0008 4 00 19 08 08\n",
    "BusMaster": lambda: MADE["BusMaster"]() + "14:15:00:3000 Rx 1 0x0 err\n",  # type: ignore[operator]
    "pcap": lambda: pcap()
    + struct.pack("<LLLL", T0_S, 300_000, 16, 16)
    + struct.pack(">LBBxx8s", 0x20000040, 8, 0, b""),
}  # fmt: skip


@pytest.mark.parametrize("what", BAD_BUS)
def test_errors_of_the_bus_reach_the_verdict_from_each_format(
    what: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    frames, log = given(tmp_path / "run.any", BAD_BUS[what]())
    assert (log.problems.texts, of(frames), sum(frame.error for frame in frames)) == ([], ROWS, 1)
    main(["check", str(tmp_path / "run.any")])
    assert "1 error frame" in capsys.readouterr().out


def test_what_is_no_frame_is_counted_by_kind_and_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    others = [*[blf_object(4, 30, bytes(32))] * 3, blf_object(96, 30, b"")]
    assert_whole(*given(tmp_path / "run.blf", blf([*blf_frames(), *others])))
    main(["check", str(tmp_path / "run.blf")])
    said = capsys.readouterr().err
    assert "note: 3 times: an object of type 4 (statistics)" in said and "type 96 (marker)" in said


@pytest.mark.parametrize("odd", [None, (0, 9), (0x800, 8), (0x20000000 | 1 << 31, 8), "request", "version"])
def test_frames_of_a_blf_that_are_alike_are_read_together(odd: tuple[int, int] | str | None, tmp_path: Path) -> None:
    """One that is not like the others, wherever it is, is read as it is alone."""
    objects, expected = [], []
    for n in range(120):
        wide, sent, length = n % 5 == 0, n % 3 == 0, n % 9
        can_id = 0x18FF0000 + n if wide else 0x500 + n
        data = bytes(range(n, n + 8))
        body = struct.pack("<HBBL8s", 1 + n % 2, sent, length, can_id | wide << 31, data)
        objects.append(blf_object(1, n, body))
        t_ns = 1_732_371_300_000_000_000 + n * 10_000_000
        expected.append(LogFrame(t_ns, f"can{n % 2}", can_id, data[:length], wide, sent=sent))
    if isinstance(odd, tuple):
        objects[60] = blf_object(1, 60, struct.pack("<HBBL8s", 1, 0, odd[1], odd[0], b""))
    elif odd == "request":
        objects[60] = blf_object(1, 60, struct.pack("<HBBL8s", 1, 2, 8, 0x510, b""))
    elif odd:
        objects[60] = objects[60].replace(struct.pack("<HHL", 32, 1, 48), struct.pack("<HHL", 32, 7, 48))
    if odd:
        del expected[60]
    frames, log = given(tmp_path / "run.blf", blf(objects))
    began_ns = frames[0].t_ns - expected[0].t_ns
    if odd == (0, 9):  # as many bytes as a classic frame has
        assert frames.pop(60).data == bytes(8)
    assert [replace(each, t_ns=each.t_ns - began_ns) for each in frames] == expected
    assert len(log.problems.texts) == (odd in ("version", (0x800, 8), (0x20000000 | 1 << 31, 8)))


# ---------------------------------------------------------------- cut off, changed


CUT: dict[str, tuple[Callable[[], str | bytes], str]] = {
    "BLF of a logger that died": (lambda: blf(closed=False), "did not close it"),
    "BLF with an object of length 0": (
        lambda: blf([blf_frame(0, *ROWS[0]), struct.pack("<4sHHLL", b"LOBJ", 32, 1, 0, 1) + bytes(60)]),
        "after frame 1: an object of length 0",
    ),
    "BLF with fewer objects than announced": (
        lambda: blf()[:32] + struct.pack("<L", 99) + blf()[36:], "24 of 99 objects are there"
    ),
    "BLF with an object of no version": (
        lambda: blf([blf_frame(0, *ROWS[0]), struct.pack("<4sHHLL", b"LOBJ", 32, 9, 48, 1) + bytes(32)]), "version 9"
    ),
    "ASC without its block's end": (lambda: asc(begin=f"Begin Triggerblock {DATE}\n"), "trigger block has no end"),
    "pcap cut in a packet": (lambda: pcap()[:-3], "cut off"),
    "pcapng with a block of length 0": (lambda: pcapng() + bytes(8), "a block of length 0"),
}  # fmt: skip


@pytest.mark.parametrize("what", CUT)
def test_what_a_file_announces_and_has_not_is_said(what: str, tmp_path: Path) -> None:
    make, words = CUT[what]
    frames, log = given(tmp_path / "run.any", make())
    assert of(frames) == ROWS[: len(frames)] and len(frames)
    assert words in " ".join(log.problems.texts)


@pytest.mark.parametrize("what", MADE)
def test_a_log_cut_anywhere_has_no_other_frame(what: str, tmp_path: Path) -> None:
    made = MADE[what]()
    content = as_bytes(made)
    chance = random.Random(what)
    for cut in [chance.randrange(len(content)) for _ in range(25)]:
        frames, log = given(tmp_path / "run.any", content[:cut])
        assert of(frames) == ROWS[: len(frames)]
        if isinstance(made, bytes) and cut > 200 and not what.startswith("pcap"):
            assert log.problems
        if isinstance(made, str) and not content[:cut].endswith(b"\n"):
            behind = content[:cut].rpartition(b"\n")[2]
            assert (
                log.problems or behind.strip() == b"" or behind.strip() in content[cut - len(behind) :].split(b"\n")[0]
            )


@pytest.mark.parametrize("what", MADE)
def test_a_log_with_a_changed_byte_ends_in_frames_and_words(what: str, tmp_path: Path) -> None:
    content = bytearray(as_bytes(MADE[what]()))
    chance = random.Random(what)
    for _ in range(25):
        at = chance.randrange(len(content))
        before, content[at] = content[at], chance.randrange(256)
        frames, log = given(tmp_path / "run.any", bytes(content))
        content[at] = before
        assert len(frames) <= len(ROWS) + 1
        assert all("\n" not in text for text in log.problems.texts)
        if len(frames) < len(ROWS) and at > 144:
            assert log.problems or log.problems.notes, at


# ---------------------------------------------------------------- read together, or one by one


WIDE: dict[str, tuple[type[Rows], str, list[str]]] = {
    "ASC": (
        AscRows,
        f"date {DATE}\nbase hex  timestamps absolute\n",
        [
            "   0.010000 1  520             Rx   d 8 01 02 03 04 05 06 07 08\n",
            "  12.345678 2  18FF0001x       Tx   d 3 01 02 03  Length = 240015 BitCount = 124 ID = 291\n",
            "   0.5 1  7 Rx d 0\n",
            "   0.020000 1  521             Rx   d 2 0A 0B \r\n",
            f"Begin Triggerblock {DATE}\n",
            "base dec\n",
            "base hex  timestamps relative\n",
            "date Sun Nov 24 02:15:00.000 pm 2024\n",
            "   0.030000 1  ErrorFrame\n",
        ],
    ),
    "TRC": (
        TrcRows,
        ";$FILEVERSION=2.1\n;$STARTTIME=45619.59375\n",
        [
            "      1         1.059 DT 1      0300 Rx -  7    00 00 00 00 04 00 00\n",
            "      2         1.283 DT  2 00000300 Tx -  8    00 01 02 03 04 05 06 07\n",
            "     33       298.945 ST 1         - Rx -  5    00 00 00 08 00\n",
            "     34       300.000 DT 1      0301 Rx -  0\n",
            ";$STARTTIME=45620.5\n",
            ";$FILEVERSION=1.1\n",
            ";$FILEVERSION=1.3\n",
            ";$COLUMNS=N,O,T,I,d,l,D\n",
            "     1)      1841 0001 8 00 00 00 00 00 00 00 00\n",
            "     2)      1842.5  Rx        0007  3  00 00 00 \n",
            "     3)      1843.25 1  Tx        18FF0001 -  2    00 00\n",
        ],
    ),
}


@settings(max_examples=80)
@drawing(st.data())
def test_rows_read_together_are_what_they_are_one_by_one(data: st.DataObject) -> None:
    kind, head, rows = WIDE[data.draw(st.sampled_from(sorted(WIDE)))]
    drawn = st.lists(st.tuples(st.sampled_from(rows), st.integers(1, 60)), max_size=6)
    text = head + "".join(row * often for row, often in data.draw(drawn))
    for place, letter in data.draw(
        st.lists(st.tuples(st.integers(0, 5000), st.sampled_from(" 0aFx.-T;\n\t\0é")), max_size=5)
    ):
        text = text[: place % (len(text) + 1)] + letter + text[place % (len(text) + 1) + 1 :]
    block = np.frombuffer(text.encode() + b"\n", np.uint8)

    class OneByOne(kind):  # type: ignore[misc,valid-type]
        def pattern(self) -> None:
            return None

    (together, *of_one), (alone, *of_other) = (parse_block(block, [], each(Problems())) for each in (kind, OneByOne))
    assert list(together) == list(alone) and of_one == of_other


@pytest.mark.parametrize(
    "what", ["candump", "ASC", *(f"TRC {version}" for version in ("1.0", "1.1", "1.3", "2.1", "3.0"))]
)
def test_rows_of_a_usual_file_are_read_together(what: str, monkeypatch: pytest.MonkeyPatch) -> None:
    text = str(MADE[what]()).splitlines(True)
    head, row_texts = text[: -len(ROWS)], text[-len(ROWS) :]
    block = np.frombuffer("".join([*head, *row_texts * 5]).encode(), np.uint8)
    kind = next(each.rows for each in FORMATS if each.rows and what.startswith(each.name))
    assert kind is not None
    singly: list[int] = []
    one_by_one = blocks.read_lines

    def read_lines(lines: Iterator[tuple[int, bytes]], *more: Any) -> None:
        one_by_one(((singly.append(line[0]), line)[1] for line in lines), *more)

    monkeypatch.setattr(blocks, "read_lines", read_lines)
    frames, unreadable, lines = parse_block(block, [], kind(Problems()))
    assert of(list(frames)) == ROWS * 5 and not unreadable
    assert len(singly) <= 64 < lines


# ---------------------------------------------------------------- candump's side lines


@pytest.mark.parametrize(
    "around",
    [
        lambda line: f"Nov 23 14:15:00 car-pc candump[812]: {line}",
        lambda line: f"Nov 23 14:15:00 {line}",
        lambda line: line.replace("can0", "\x1b[31mcan0\x1b[0m"),
        lambda line: f"{line}\n\tcontroller-problem{{rx-error-warning}}\n\terror-counter-tx-rx{{{{0}}{{96}}}}",
        lambda line: f"interface = can0, family = 29, type = 3, proto = 1\n{line}",
    ],
)
def test_what_stands_around_lines_of_candump_is_taken_off(around: Callable[[str], str], tmp_path: Path) -> None:
    lines = candump().splitlines()
    assert_whole(*given(tmp_path / "run.log", "".join(around(line) + "\n" for line in lines)))


def test_frames_that_candump_dropped_make_the_verdict_unknown(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lost = "DROPCOUNT: dropped 37 CAN frames on 'can0' socket (total drops 37)\n"
    frames, log = given(tmp_path / "run.log", candump() + lost + lost.replace("37", "1").replace("frames", "frame"))
    assert_whole(frames, log)
    assert main(["check", str(tmp_path / "run.log")]) == 1
    assert "unknown: 38 frames lost in this machine's receive buffer" in capsys.readouterr().out


@pytest.mark.parametrize("line", [" ({t})  can0  520   [2]  01 A5", "({t}) can0 520#01A5"])
def test_differences_of_candump_are_added_up(line: str, tmp_path: Path) -> None:
    steps_us = [0, 0, 0, 0, 0, 0, 0, 10_000] * 50
    text = "".join(line.format(t=f"{us // 1_000_000:03d}.{us % 1_000_000:06d}") + "\n" for us in steps_us)
    frames, log = given(tmp_path / "run.log", text)
    assert [frame.t_ns for frame in frames] == (np.cumsum(steps_us) * 1000).tolist()
    assert "differences" in log.problems.note_line()


def test_a_clock_that_is_set_back_is_no_sign_of_differences(tmp_path: Path) -> None:
    text = "".join(f"({900 - 880 * (n > 50)}.{n:06d}) can0 520#01A5\n" for n in range(100))
    frames, log = given(tmp_path / "run.log", text)
    assert (frames[0].t_ns, frames[-1].t_ns, log.problems.note_line()) == (900_000_000_000, 20_000_099_000, "")


# ---------------------------------------------------------------- MF4


def mf4(tmp_path: Path, *, virtual: dict[str, float], unfinished: bool = False) -> Path:
    """Frames whose fields of these names are no bits of the record, but always of these values."""
    import asammdf  # slow to import
    from asammdf.blocks import v4_constants
    from asammdf.blocks.conversion_utils import from_dict

    kinds = {
        "BusChannel": "u1",
        "ID": "<u4",
        "IDE": "u1",
        "DLC": "u1",
        "DataLength": "u1",
        "DataBytes": "(8,)u1",
        "Dir": "u1",
    }
    frames = np.zeros(len(ROWS), [(f"CAN_DataFrame.{name}", kind) for name, kind in kinds.items()])
    for n, (can_id, data) in enumerate(ROWS):
        frames[n] = (1, can_id, 0, len(data), len(data), list(data.ljust(8, b"\0")), 0)
    path = tmp_path / "run.mf4"
    with asammdf.MDF(version="4.10") as mdf:
        source = asammdf.Source("CAN", "CAN", "", 2, 2)
        mdf.append([asammdf.Signal(frames, np.arange(len(ROWS)) / 100, name="CAN_DataFrame", source=source)])
        for channel in mdf.groups[0].channels:
            name = channel.name.removeprefix("CAN_DataFrame.")
            if name in virtual:
                channel.channel_type, channel.data_type = v4_constants.CHANNEL_TYPE_VIRTUAL, 0
                channel.bit_count = channel.byte_offset = 0
                channel.conversion = from_dict({"a": 0.0, "b": virtual[name]})
        mdf.save(path, overwrite=True, compression=2)
    if unfinished:
        content = bytearray(path.read_bytes())
        content[:8] = b"UnFinMF "
        content[60:62] = struct.pack("<H", 1 | 1 << 2)  # counts, and the length of the last data block
        path.write_bytes(content)
    return path


@pytest.mark.parametrize(  # none and finalized: those of test_logs.py
    ("virtual", "unfinished"),
    [({}, True), ({"IDE": 0.0, "Dir": 1.0, "BusChannel": 3.0}, False)],
    ids=["none, not finalized", "three, finalized"],
)
def test_mf4_frames_are_what_their_own_conversions_say(
    virtual: dict[str, float], unfinished: bool, tmp_path: Path
) -> None:
    path = mf4(tmp_path, virtual=virtual, unfinished=unfinished)
    frames, log = given(path, path.read_bytes())
    assert_whole(frames, log)
    assert {(frame.channel, frame.extended, frame.sent) for frame in frames} == {
        (f"can{int(virtual.get('BusChannel', 1))}", False, bool(virtual.get("Dir", 0)))
    }


# ---------------------------------------------------------------- folders


def test_a_folder_of_logs_of_many_kinds_is_one_log(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "a.LOG").write_text(candump())
    (tmp_path / "b.blf").write_bytes(blf())
    (tmp_path / "c.TRC").write_text(trc("2.1"))
    (tmp_path / "d.txt").write_text(str(MADE["Kvaser"]()))
    (tmp_path / "README.txt").write_text("what we did\n")
    (tmp_path / "results.csv").write_text("lap,time\n1,2\n")
    main(["check", "--figures", str(tmp_path), "--json"])
    said = capsys.readouterr()
    assert said.err == "" and said.out.count('"channel"') >= 2
    main(["dump", "-L", "--no-signals", str(tmp_path)])
    assert len(capsys.readouterr().out.splitlines()) == 4 * len(ROWS)


def test_check_of_a_folder_is_a_line_for_each_log_and_a_verdict(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "a.log").write_text(candump())
    (tmp_path / "b.blf").write_bytes(blf(closed=False))
    (tmp_path / "c.trc").write_text("")
    for name in ("notes.md", ".a.lock", "a.json", "run.png"):  # all but the first are what a recording leaves
        (tmp_path / name).write_text("what we did")
    assert main(["check", str(tmp_path)]) == 1
    said = capsys.readouterr()
    of_logs = {
        name: [line for line in said.out.splitlines() if f"/{name}: " in line] for name in ("a.log", "b.blf", "c.trc")
    }
    assert said.err == "" and [*map(len, of_logs.values())] == [1, 1, 1]
    assert of_logs["a.log"][0].endswith("a.log: candump, 24 frames")
    assert "BLF, 24 frames; not readable as BLF after frame 24: its logger did not close it" in of_logs["b.blf"][0]
    assert of_logs["c.trc"][0].endswith("c.trc: no frames in it")
    assert "no logs, and left out: notes.md\n" in said.out
    assert sum(line.startswith("verdict: ") for line in said.out.splitlines()) == 1
    main(["check", str(tmp_path), "--json"])
    assert capsys.readouterr().out.count('"type": "log"') == 3
