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
import tempfile
import zipfile
import zlib
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing
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
ASC_HEAD = f"date {DATE}\nbase hex  timestamps absolute\n"


def rows(row: str, head: str = "") -> str:
    """Each of ROWS as a row of text, behind a head."""
    return head + "".join(
        row.format(
            n=n,
            number=n + 1,
            t=f"{T0_S}.{n:02d}0000",
            s=n / 100,
            ms=n * 10,
            us=n * 10_000,
            i=i,
            l=len(d),
            x=d.hex(),
            X=d.hex().upper(),
            lower=d.hex(" "),
            d=d.hex(" ").upper(),
            b=base64.b64encode(d).decode(),
        )
        for n, (i, d) in enumerate(ROWS)
    )


def asc(head: str = ASC_HEAD, end: str = "") -> str:
    return rows("   {s:.6f} 1  {i:X}             Rx   d {l} {d}\n", head) + end


TRC_ROWS = {
    "1.0": "{number:6}) {ms:10} {i:04X} {l} {d}\n",
    "1.1": "{number:6}) {ms:10.1f} Rx {i:04X} {l} {d}\n",
    "1.2": "{number:6}) {ms:10.3f} 1 Rx {i:04X} {l} {d}\n",
    "1.3": "{number:6}) {ms:10.3f} 1 Rx {i:04X} - {l} {d}\n",
    "2.0": "{number:6} {ms:10.3f} DT {i:04X} Rx {l} {d}\n",
    "2.1": "{number:6} {ms:10.3f} DT 1 {i:04X} Rx - {l} {d}\n",
    "3.0": "{number:6} {ms:10.3f} DT 1 {i:9X} Rx - - - -          - - {l:<4} {d}\n",
}


def trc(version: str, end: str = "") -> str:
    head = f";$FILEVERSION={version}\n;$STARTTIME=45619.59375\n;\n" if version != "1.0" else ";" + "#" * 40 + "\n;\n"
    head += ";$COLUMNS=N,O,T,B,I,d,R,V,S,A,r,s,L,D\n" if version == "3.0" else ""
    return rows(TRC_ROWS[version], head) + end


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


def blf_frame(
    number: int, can_id: int, data: bytes, length: int | None = None, *, channel: int = 1, flags: int = 0
) -> bytes:
    length = len(data) if length is None else length
    return blf_object(1, number, struct.pack("<HBBL8s", channel, flags, length, can_id, data))


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


def pcapng_block(kind: int, body: bytes) -> bytes:
    body += bytes(-len(body) % 4)
    size = struct.pack("<L", len(body) + 12)
    return struct.pack("<L", kind) + size + body + size


def pcapng() -> bytes:
    begin = pcapng_block(0x0A0D0D0A, struct.pack("<LHHq", 0x1A2B3C4D, 1, 0, -1))
    begin += pcapng_block(1, struct.pack("<HHLHH4s", 227, 0, 0, 2, 4, b"can0"))
    stamps = (T0_S * 1_000_000 + n * 10_000 for n in range(len(ROWS)))
    return begin + b"".join(
        pcapng_block(6, struct.pack("<LLLLL", 0, us >> 32, us & 0xFFFFFFFF, 16, 16) + packet)
        for us, packet in zip(stamps, packets(), strict=True)
    )


def database(script: str, messages: Iterable[tuple[object, ...]]) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "made.db")
        with closing(sqlite3.connect(path)) as made, made:
            made.executescript(script)
            for message in messages:
                made.execute(f"INSERT INTO messages VALUES ({', '.join('?' * len(message))})", message)
        return path.read_bytes()


def sqlite_db(*more: tuple[object, ...]) -> bytes:
    return database(
        "CREATE TABLE messages (ts REAL, arbitration_id INTEGER, extended INTEGER, remote INTEGER, "
        "error INTEGER, dlc INTEGER, data BLOB)",
        [*((T0_S + n * 0.01, i, 0, 0, 0, len(d), d) for n, (i, d) in enumerate(ROWS)), *more],
    )


def bag(kind: str = "can_msgs/msg/Frame", name: str = "'/from_can_bus'") -> bytes:
    """A bag of ROS 2 in SQLite, with one topic of that type, its messages as CDR."""
    cdr = [
        struct.pack("<4sIII4sIBBBB8s", b"\0\1\0\0", T0_S, n * 10_000_000, 4, b"can\0", i, 0, 0, 0, len(d), d)
        for n, (i, d) in enumerate(ROWS)
    ]
    return database(
        "CREATE TABLE topics (id INTEGER, name, type TEXT, serialization_format TEXT);"
        "CREATE TABLE messages (id INTEGER, topic_id INTEGER, timestamp INTEGER, data BLOB);"
        f"INSERT INTO topics VALUES (1, {name}, '{kind}', 'cdr')",
        [(n, 1, n, body) for n, body in enumerate(cdr)],
    )


BUSMASTER_HEAD = (
    "***BUSMASTER Ver 3.2.2***\n***START DATE AND TIME 23:11:2024 14:15:00:000***\n***HEX***\n***SYSTEM MODE***\n"
)
TEXTS: dict[str, str] = {
    "candump": rows("({t}) can0 {i:X}#{X}\n"),
    "ASC": asc(),
    "ASC without a head": asc(""),
    **{f"TRC {version}": trc(version) for version in TRC_ROWS},
    "GVRET": "Time Stamp,ID,Extended,Dir,Bus,LEN,D1,D2,D3,D4,D5,D6,D7,D8\n"
    + rows("{us},{i:08X},false,Rx,0,{l},{d},\n").replace(" ", ","),
    "GVRET of a spreadsheet": '"Time Stamp";"ID";"Extended";"Dir";"Bus";"LEN";D1;D2;D3;D4;D5;D6;D7;D8\n'
    + rows('"{us}";"{i:X}";"false";"Rx";"0";"{l}";{d}\n').replace(" ", ";").replace("Time;Stamp", "Time Stamp"),
    "python-can CSV": rows("{t},0x{i:X},0,0,0,{l},{b}\n", "timestamp,arbitration_id,extended,remote,error,dlc,data\n"),
    "cabana CSV": rows("{t},0x{i:X},0,0x{x}\n", "time,addr,bus,data\n"),
    "CANedge CSV": rows(
        "{t};0;{i:X};0;{l};{l};0;0;0;{x}\n", "TimestampEpoch;BusChannel;ID;IDE;DLC;DataLength;Dir;EDL;BRS;DataBytes\n"
    ),
    "CL2000": rows("{ms:0>5};0;{i:X};{x}\n", "# Logger type: CL2000\nTimestamp;Type;ID;Data\n"),
    "BusMaster": rows("14:15:00:{n:02d}00 Rx 1 0x{i:X} s {l} {d} \n", BUSMASTER_HEAD),
    "Kvaser": rows(
        " 0    {i:X}     {l}  {lower}   {s:.6f} R\n",
        " Chn Identifier Flg   DLC  D0...1...2...3...4...5...6..D7       Time     Dir\n",
    ),
    "CRTD": rows("{t} 1R11 {i:03X} {d}\n"),
}
BINARY: dict[str, bytes] = {
    "BLF": blf(),
    "BLF not packed": blf(packed=False),
    "pcap": pcap(),
    "pcapng": pcapng(),
    "pcap of any": pcap(113),
    "pcap of any, big-endian": pcap(113, ">"),
    "pcap of any, with interfaces": pcap(276),
}
MADE: dict[str, str | bytes] = {**TEXTS, **BINARY}
DATABASES = {"python-can": sqlite_db(), "ROS 2": bag()}


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


@pytest.mark.parametrize("what", [*MADE, *DATABASES])
def test_a_log_of_each_format_is_read_whole_and_in_time(what: str, tmp_path: Path) -> None:
    assert_whole(*given(tmp_path / "run.any", {**MADE, **DATABASES}[what]))


def test_a_bag_whose_topic_has_no_name_loses_its_rows_only(tmp_path: Path) -> None:
    frames, log = given(tmp_path / "run.db3", bag(name="5"))
    assert frames == [] and log.problems.count == len(ROWS)


@pytest.mark.parametrize("times", ["absolute", "relative"])
def test_a_year_that_no_clock_has_is_a_date_not_read(times: str, tmp_path: Path) -> None:
    head = f"date Mon Sep 4 10:00:00.000 am 2917\nbase hex  timestamps {times}\n"
    frames, log = given(tmp_path / "run.asc", asc(head) + asc("") * 8)
    assert len(frames) == 9 * len(ROWS) and "the date in the head cannot be read" in log.problems.note_line()


def test_each_format_has_a_row_in_the_documentation() -> None:
    page = (Path(__file__).parents[2] / "docs/logs.md").read_text()
    assert [each.name for each in FORMATS if f"\n| {each.name}" not in page] == []


# ---------------------------------------------------------------- packed, marked


def tar_of_one() -> bytes:
    packed = io.BytesIO()
    with tarfile.open(fileobj=packed, mode="w:gz") as archive:
        archive.addfile(tarfile.TarInfo("run.log"))
    return packed.getvalue()


def zip_of(*contents: bytes, beside: Iterable[str] = ()) -> bytes:
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        for number, content in enumerate(contents):
            archive.writestr(f"run{number}.log", content)
        for name in beside:
            archive.writestr(name, b"of the Finder")
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
    "zip of a Mac": lambda content: zip_of(content, beside=("__MACOSX/._run0.log", ".DS_Store")),
}


@pytest.mark.parametrize("what", ["candump", "BLF", "TRC 2.1"])
@pytest.mark.parametrize("how", PACKINGS)
def test_a_packed_log_is_read_like_the_log_itself(how: str, what: str, tmp_path: Path) -> None:
    content = PACKINGS[how](as_bytes(MADE[what]))
    assert_whole(*given(tmp_path / "run.log", content))
    for cut in (len(content) // 2, len(content) - 1):
        assert given(tmp_path / "run.log", content[:cut])[1].problems


SAVED: dict[str, Callable[[str], bytes]] = {
    "UTF-8 with a mark": lambda text: codecs.BOM_UTF8 + text.encode(),
    "UTF-16": lambda text: text.replace("\n", "\r\n").encode("utf-16"),
    "UTF-16 without a mark": lambda text: text.encode("utf-16-be"),
    "old Mac": lambda text: text.replace("\n", "\r").encode(),
    "blank lines first": lambda text: b"\r\n  \r\n" + text.encode(),
    "no line end last": lambda text: text.removesuffix("\n").encode(),
}


@pytest.mark.parametrize("what", ["candump", "ASC", "TRC 2.1", "GVRET"])
@pytest.mark.parametrize("how", SAVED)
def test_a_text_is_read_however_it_was_saved(how: str, what: str, tmp_path: Path) -> None:
    assert_whole(*given(tmp_path / "run.txt", SAVED[how](TEXTS[what])))


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
    head = f"date {DATE}\nbase hex  timestamps relative\nBegin Triggerblock {DATE}\n   0.000000 Start of measurement\n"
    times = ["0.020000", "0.000000"] * (len(ROWS) // 2)
    pairs = "".join(
        f"   {t} 1  {i:X} Rx d {len(d)} {d.hex(' ').upper()}\n" for (i, d), t in zip(ROWS, times, strict=True)
    )
    frames, log = given(tmp_path / "run.asc", head + pairs + "End TriggerBlock\n")
    assert (log.problems.texts, of(frames)) == ([], ROWS)
    assert [frame.t_ns - frames[0].t_ns for frame in frames] == [n // 2 * 20_000_000 for n in range(len(ROWS))]


def test_any_name_of_a_channel_is_one_short_word(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    frames, _ = given(tmp_path / "run.log", TEXTS["candump"].replace("can0", "c" * 3000))
    assert {frame.channel for frame in frames} == {"c" * 64}
    (tmp_path / "run.pcapng").write_bytes(pcapng().replace(b"can0", b"c 0\x1b"))
    for verb in (["dump", "-L"], ["decode"]):
        assert main([*verb, str(tmp_path / "run.log")]) == main([*verb, str(tmp_path / "run.pcapng")]) == 0
    assert " c_0\\x1b 514#" in capsys.readouterr().out


def test_times_of_day_of_busmaster_go_on_past_midnight(tmp_path: Path) -> None:
    night = "".join(f"{time} Rx 1 0x520 s 1 00 \n" for time in ("23:59:59:9900", "0:00:00:0000", "0:00:00:0100"))
    frames, log = given(tmp_path / "run.log", BUSMASTER_HEAD + night)
    assert [frame.t_ns - frames[0].t_ns for frame in frames] == [0, 10_000_000, 20_000_000] and not log.problems


def test_what_is_usual_in_other_tools_rows_is_read(tmp_path: Path) -> None:
    rows = """\
  -0.5 1  511  Rx d 2 00 01
  0,010 2  18FF0001x  Tx   d 1 7F  Length = 0 BitCount = 67 ID = 291
  0.020 1  123  Rx   r 4
  0.030 CANFD   1 Rx        300         1 0 9 12 01 02 03 04 05 06 07 08 09 0a 0b 0c 0 0 3000 0 0
  0.040 1  124  TxRq   d 1 01
  0.050 1  Statistic: D 1 R 0 XD 0 XR 0 E 0 O 0 B 1.5%
"""
    frames, log = given(tmp_path / "run.asc", ASC_HEAD + rows)
    assert log.problems.texts == [] and sum(log.problems.notes.values()) == 2
    plain, wide, remote, fd = frames
    assert (plain.data, wide.extended, wide.channel, wide.sent) == (b"\x00\x01", True, "can1", True)
    assert (remote.remote, remote.length, fd.fd, fd.brs, fd.esi, len(fd.data)) == (True, 4, True, True, False, 12)
    assert wide.t_ns - plain.t_ns == 510_000_000


# ---------------------------------------------------------------- errors of the bus


ASC_ERRORS = (
    "1  ErrorFrame",
    "1  OverloadFrame",
    "1 123 TxErr d 1 00",
    "CANFD 1 Rx ErrorFrame x",
    "CAN 1 Status:chip status error busoff",
    "CAN 1 Status:chip status warning level",
    "CAN 2 Status:chip status error passive",
    "1  Statistic: D 1 R 0 XD 0 XR 0 E 12 O 0 B 1.5%",
    "1  Statistic: D 1 R 0 XD 0 XR 0 E 0 O 1 B 1.5%",
)
BLF_ERRORS = {
    2: struct.pack("<HHL", 1, 0, 0),
    3: struct.pack("<HHL", 1, 0, 0),
    4: struct.pack("<HH6L4x", 1, 100, 9, 0, 0, 0, 12, 0),
    31: struct.pack("<HBBL", 1, 255, 0, 0x68),
    73: struct.pack("<HHLBBBxLLH2x8s", 1, 0, 1, 0x80, 0, 0, 0, 0, 0, b""),
    104: bytes(40),
}
BUS_OFF = struct.pack(">LBBxx8s", 0x20000040, 8, 0, b"")
PCAP_ERROR = struct.pack("<LLLL", T0_S, 300_000, 16, 16) + BUS_OFF
BAD_BUS: dict[str, str | bytes] = {
    **{f"ASC {row}": asc(end=f"   0.300000 {row}\n") for row in ASC_ERRORS},
    **{f"BLF {kind}": blf([*blf_frames(), blf_object(kind, 30, body)]) for kind, body in BLF_ERRORS.items()},
    "TRC ER": trc("2.1", "  25  250.000 ER 1 Rx - 5 04 00 02 00 00\n"),
    "TRC ST": trc("2.1", "  25  250.000 ST 1 Rx - 4 00 00 00 10\n"),
    "TRC Warng": trc("1.1", "  25)  250.0 Warng FFFFFFFF 4 00 00 00 08 BUSHEAVY\n"),
    "TRC Error": trc("1.1", "  25)  250.0 Error 0008 4 00 19 08 08\n"),
    "BusMaster": TEXTS["BusMaster"] + "14:15:00:3000 Rx 1 0x0 err\n",
    "pcap": pcap() + PCAP_ERROR,
    "CRTD": TEXTS["CRTD"] + f"{T0_S}.300000 1CER Error intr=5 rxpkt=7 errflags=0x1 rxerr=130 txerr=0 rxovr=0\n",
    "CRTD sent in vain": TEXTS["CRTD"] + f"{T0_S}.300000 1CER TX_Fail T11 510 01 02\n",
}


@pytest.mark.parametrize("what", BAD_BUS)
def test_errors_of_the_bus_reach_the_verdict_from_each_format(
    what: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    frames, log = given(tmp_path / "run.any", BAD_BUS[what])
    assert (log.problems.texts, of(frames), sum(frame.error for frame in frames)) == ([], ROWS, 1)
    main(["check", str(tmp_path / "run.any")])
    assert "1 error frame" in capsys.readouterr().out


def test_what_is_no_frame_is_counted_by_kind_and_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    others = [*[blf_object(4, 30, bytes(32))] * 3, blf_object(96, 30, b"")]
    assert_whole(*given(tmp_path / "run.blf", blf([*blf_frames(), *others])))
    main(["check", str(tmp_path / "run.blf")])
    said = capsys.readouterr().err
    assert "note: 3 times: an object of type 4 (statistics)" in said and "type 96 (marker)" in said


@pytest.mark.parametrize(
    ("odd", "data", "problems"),
    [
        (b"", None, 0),
        (blf_frame(60, 0, bytes(8), 9), bytes(8), 0),  # as many bytes as a classic frame has
        (blf_frame(60, 0x800, bytes(8)), None, 1),
        (blf_frame(60, 0x20000000 | 1 << 31, bytes(8)), None, 1),
        (blf_frame(60, 0x510, bytes(8), flags=2), None, 0),
        (blf_frame(60, 0x510, bytes(8)).replace(b"\x20\0\1\0", b"\x20\0\7\0"), None, 1),
    ],
    ids=["none", "9 bytes", "12-bit identifier", "30-bit identifier", "request", "version"],
)
def test_frames_of_a_blf_that_are_alike_are_read_together(
    odd: bytes, data: bytes | None, problems: int, tmp_path: Path
) -> None:
    """One that is not like the others, wherever it is, is read as it is alone."""
    objects, expected = [], []
    for n in range(120):
        wide, sent, length = n % 5 == 0, n % 3 == 0, n % 9
        can_id = 0x18FF0000 + n if wide else 0x500 + n
        content = bytes(range(n, n + 8))
        objects.append(blf_frame(n, can_id | wide << 31, content, length, channel=1 + n % 2, flags=sent))
        expected.append(LogFrame(n * 10_000_000, f"can{n % 2}", can_id, content[:length], wide, sent=sent))
    if odd:
        objects[60] = odd
        expected[60:61] = [] if data is None else [LogFrame(600_000_000, "can0", 0, data, sent=False)]
    frames, log = given(tmp_path / "run.blf", blf(objects))
    assert [replace(each, t_ns=each.t_ns - frames[0].t_ns) for each in frames] == expected
    assert len(log.problems.texts) == problems


# ---------------------------------------------------------------- cut off, changed


ASC_BAD_ROWS = {
    "   0.1 1  EngineData Rx   d 8 01 02 03 04 05 06 07 08": "invalid identifier: EngineData",
    "   0.1 1  123  Rx   d 8 01 02 ZZ 04 05 06 07 08": "no data bytes",
    "   0.1 1  123  Rx   d 6 1A 07": "2 data bytes where 6 are announced",
    "   0.1 1  123  Rx   d 2 1A 07 11": "more data bytes than the 2 that are announced",
    "   0.1 1  923  Rx   d 1 1A": "no 11-bit identifier: 923",
    "   0.1 1  something else": "not a row of ASC",
    "what is this": "not a row of ASC",
}
TRC_BAD_ROWS = ("1 0520 ZZ", "1 0520 Rx - 8 01 02 0", "1 0820 Rx - 1 01", "1 0520 Rx - 2 01", "Q")
FIRST = blf_frame(0, *ROWS[0])
LENGTH_0 = FIRST[:8] + bytes(4) + FIRST[12:]
VERSION_9 = FIRST[:6] + b"\x09\0" + FIRST[8:]
LOSSES: dict[str, tuple[str | bytes, int, str]] = {  # the content, how many frames are read, what is said
    "tar": (tar_of_one(), 0, "a tar archive: unpack it first"),
    "zip of two": (zip_of(b"x", b"y"), 0, "a zip archive of 2 files: unpack it first"),
    "gzip in gzip": (gzip.compress(gzip.compress(b"x" * 50)), 0, "packed twice: unpack it once more"),
    "lz4": (b"\x04\x22\x4d\x18" + bytes(50), 0, "packed with lz4: unpack it first"),
    "compress": (b"\x1f\x9d" + bytes(50), 0, "packed with compress: unpack it first"),
    "lzma": (lzma.compress(b"x" * 50, lzma.FORMAT_ALONE), 0, "packed with lzma: unpack it first"),
    "UTF-32": (TEXTS["candump"].encode("utf-32"), 0, "text in UTF-32: save it as UTF-8"),
    "zip cut off": (zip_of(b"x" * 500)[:-30], 0, "cut off, or broken"),
    "MCAP": (b"\x89MCAP0\r\n" + bytes(50), 0, "an MCAP"),
    "MDF 3": (b"MDF     3.30    " + bytes(50), 0, "an MDF older than version 4"),
    "SQLite without pages": (b"SQLite format 3\0" + bytes(84), 0, "not readable as SQLite"),
    "bag of texts": (bag("std_msgs/msg/String"), 0, "without a topic of can_msgs/Frame: record the bus itself"),
    "TRC 4.0": (";$FILEVERSION=4.0\n 1 0.0 DT 1 0520 Rx - 1 00\n", 0, "TRC version 4.0 is not read: save it as 2.1"),
    "candump with more data than it announces": (
        TEXTS["candump"] + f" ({T0_S}.300000)  can0  520   [2]  01 02 03\n",
        24,
        "3 data bytes where 2 are announced",
    ),
    "python-can CSV with a flag that is none": (
        TEXTS["python-can CSV"] + "5.0,0x40,0,0,2,8,AAAAAAAAAAA=\n",
        24,
        "line 26: not a row of this table",
    ),
    "TRC overrun": (trc("2.1", "  25  250.000 ST 1 Rx - 4 00 00 00 02\n"), 24, "line 28: frames were lost here"),
    "no log": (b"\x00\x01\x02" * 50, 0, "not a log format that can be read"),
    "BLF of a logger that died": (blf(closed=False), 24, "did not close"),
    "BLF with an object of length 0": (blf([FIRST, LENGTH_0]), 1, "after frame 1: an object of length 0"),
    "BLF with an object of no version": (blf([FIRST, VERSION_9]), 1, "version 9"),
    "BLF with less than it announces": (blf()[:32] + b"\x63\0\0\0" + blf()[36:], 24, "24 of 99 objects are there"),
    "ASC without its block's end": (asc(f"{ASC_HEAD}Begin Triggerblock {DATE}\n"), 24, "trigger block has no end"),
    **{
        f"{what} with an error at a time that is none": (content, 24, "invalid time")
        for what, content in {
            "python-can CSV": TEXTS["python-can CSV"] + "999999999999999999.0,0x40,0,0,1,8,AAAAAAAAAAA=\n",
            "python-can CSV, negative,": TEXTS["python-can CSV"] + "-9.0,0x40,0,0,1,8,AAAAAAAAAAA=\n",
            "pcapng": pcapng() + pcapng_block(6, struct.pack("<LLLLL", 0, 1 << 31, 0, 16, 16) + BUS_OFF),
            "BLF": blf(
                [
                    *blf_frames(),
                    blf_object(73, 1 << 40, struct.pack("<HHLBBBxLLH2x8s", 1, 0, 0, 0, 0, 0, 0, 64, 0, b"")),
                ]
            ),
        }.items()
    },
    "SQLite with a number for data": (sqlite_db((0.5, 0x520, 0, 0, 0, 8, 1 << 40)), 24, "row 25 is left out: no data"),
    "SQLite without a time": (sqlite_db((None, 0x520, 0, 0, 0, 8, b"")), 24, "row 25 is left out: invalid time: None"),
    "pcap cut in a packet": (pcap()[:-3], 23, "cut off"),
    "pcapng with a block of length 0": (pcapng() + bytes(8), 24, "a block of length 0"),
    **{
        f"ASC {row}": (asc().replace("   0.03", f"{row}\n   0.03"), 24, f"line 6: {words}")
        for row, words in ASC_BAD_ROWS.items()
    },
    **{
        f"TRC {kind} {row}": (trc("2.1", f"  25  250.000 {kind} {row}\n"), 24, "line 28: ")
        for row in TRC_BAD_ROWS
        for kind in ("DT", "XX")
    },
}


@pytest.mark.parametrize("what", LOSSES)
def test_a_loss_is_named_and_costs_no_other_frame(what: str, tmp_path: Path) -> None:
    content, count, words = LOSSES[what]
    frames, log = given(tmp_path / "run.any", content)
    assert of(frames) == ROWS[:count]
    assert len(log.problems.texts) == 1 and words in log.problems.texts[0]


@pytest.mark.parametrize("what", MADE)
def test_a_log_cut_anywhere_has_no_other_frame(what: str, tmp_path: Path) -> None:
    made = MADE[what]
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
    content = bytearray(as_bytes(MADE[what]))
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


@pytest.mark.parametrize("what", DATABASES)
def test_a_database_cut_or_changed_hides_no_loss(what: str, tmp_path: Path) -> None:
    content = DATABASES[what]
    chance = random.Random(1)
    for number in range(40):
        at = chance.randrange(100, len(content))
        behind = b"" if number % 2 else bytes([content[at] ^ 1 << number % 8]) + content[at + 1 :]
        frames, log = given(tmp_path / "run.db", content[:at] + behind)
        assert len(frames) <= len(ROWS) and (len(frames) == len(ROWS) or log.problems), at


@pytest.mark.parametrize("what", DATABASES)
def test_a_database_that_is_cut_says_so_wherever_it_is(what: str, tmp_path: Path) -> None:
    content = DATABASES[what]
    for length in (*range(100, len(content), 97), 4097, 4098, 8191, len(content) - 36, len(content) - 1):
        assert given(tmp_path / "run.db", content[:length])[1].problems, length
    assert not given(tmp_path / "run.db", content)[1].problems


# ---------------------------------------------------------------- read together, or one by one


WIDE: dict[str, tuple[type[Rows], str, list[str]]] = {
    "ASC": (
        AscRows,
        ASC_HEAD,
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
    lines = TEXTS[what].splitlines(True)
    block = np.frombuffer("".join(lines[: -len(ROWS)] + lines[-len(ROWS) :] * 5).encode(), np.uint8)
    kind = next(each.rows for each in FORMATS if each.rows and what.startswith(each.name))
    assert kind is not None
    singly: list[tuple[int, bytes]] = []
    one_by_one = blocks.read_lines

    def read_lines(lines: Iterator[tuple[int, bytes]], *more: Any) -> None:
        taken = list(lines)
        singly.extend(taken)
        one_by_one(iter(taken), *more)

    monkeypatch.setattr(blocks, "read_lines", read_lines)
    frames, unreadable, count = parse_block(block, [], kind(Problems()))
    assert of(list(frames)) == ROWS * 5 and not unreadable
    assert len(singly) <= 64 < count


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
    assert_whole(*given(tmp_path / "run.log", "".join(around(line) + "\n" for line in TEXTS["candump"].splitlines())))


def test_frames_that_candump_dropped_make_the_verdict_unknown(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lost = "".join(
        f"DROPCOUNT: dropped {frames} on 'can0' socket (total drops 37)\n"
        for frames in ("37 CAN frames", "1 CAN frame")
    )
    assert_whole(*given(tmp_path / "run.log", TEXTS["candump"] + lost))
    assert main(["check", str(tmp_path / "run.log")]) == 1
    assert "unknown: 38 frames lost in this machine's receive buffer" in capsys.readouterr().out


BLF_LOST = [blf_object(125, 30, bytes(4)), blf_object(126, 31, struct.pack("<LQL", 0, 0, 37))]
DROPPED = [pcapng_block(5, struct.pack("<LLLHHQHHQ", 0, 0, 0, 5, 8, few, 7, 8, 30)) for few in (3, 7)]
OVERRUNS = "".join(f"{T0_S}.300000 1CST Status rxpkt=7 rxovr={count} txovr=0\n" for count in (30, 37))
TOLD_LOST: dict[str, tuple[str | bytes, int]] = {  # by the logger: how many
    "BLF": (blf([*blf_frames(), *BLF_LOST]), 37),
    "BLF without the loss's end": (blf([*blf_frames(), BLF_LOST[0]]), 1),
    "BLF overrun": (blf([*blf_frames(), blf_object(91, 30, bytes(8))]), 1),
    "pcapng": (pcapng() + b"".join(DROPPED), 37),
    "CRTD": (TEXTS["CRTD"] + OVERRUNS, 37),
}


@pytest.mark.parametrize("what", TOLD_LOST)
def test_a_logger_that_lost_frames_makes_the_verdict_unknown(
    what: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    content, lost = TOLD_LOST[what]
    assert_whole(*given(tmp_path / "run.any", content))
    assert main(["check", str(tmp_path / "run.any")]) == 1
    assert f"unknown: {lost} frame" in capsys.readouterr().out


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


MF4_FIELDS = "BusChannel u1, ID <u4, IDE u1, DLC u1, DataLength u1, DataBytes (8,)u1, Dir u1"


@pytest.mark.parametrize(  # none and finalized: those of test_logs.py
    ("virtual", "unfinished"),
    [({}, True), ({"IDE": 0.0, "Dir": 1.0, "BusChannel": 3.0}, False)],
    ids=["none, not finalized", "three, finalized"],
)
def test_mf4_frames_are_what_their_own_conversions_say(
    virtual: dict[str, float], unfinished: bool, tmp_path: Path
) -> None:
    """`virtual`: fields that are no bits of the record, but always of these values."""
    import asammdf  # slow to import
    from asammdf.blocks import v4_constants
    from asammdf.blocks.conversion_utils import from_dict

    fields = (field.split() for field in MF4_FIELDS.split(", "))
    records = np.zeros(len(ROWS), [(f"CAN_DataFrame.{name}", kind) for name, kind in fields])
    for n, (can_id, data) in enumerate(ROWS):
        records[n] = (1, can_id, 0, len(data), len(data), list(data.ljust(8, b"\0")), 0)
    path = tmp_path / "run.mf4"
    with asammdf.MDF(version="4.10") as mdf:
        source = asammdf.Source("CAN", "CAN", "", 2, 2)
        mdf.append([asammdf.Signal(records, np.arange(len(ROWS)) / 100, name="CAN_DataFrame", source=source)])
        for channel in mdf.groups[0].channels:
            name = channel.name.removeprefix("CAN_DataFrame.")
            if name in virtual:
                channel.channel_type, channel.data_type = v4_constants.CHANNEL_TYPE_VIRTUAL, 0
                channel.bit_count = channel.byte_offset = 0
                channel.conversion = from_dict({"a": 0.0, "b": virtual[name]})
        mdf.save(path, overwrite=True, compression=2)
    content = bytearray(path.read_bytes())
    if unfinished:
        content[:8] = b"UnFinMF "
        content[60:62] = struct.pack("<H", 1 | 1 << 2)  # counts, and the length of the last data block
    frames, log = given(path, bytes(content))
    assert_whole(frames, log)
    assert {(frame.channel, frame.extended, frame.sent) for frame in frames} == {
        (f"can{int(virtual.get('BusChannel', 1))}", False, bool(virtual.get("Dir", 0)))
    }


def mf4(path: Path, **groups: dict[str, Any]) -> tuple[list[LogFrame], Log]:
    """Groups of ROWS by their kinds, each with fields that are changed: another column, or none."""
    import asammdf  # slow to import

    with asammdf.MDF(version="4.10") as made:
        for kind, changed in groups.items():
            lengths = [len(data) for _, data in ROWS]
            columns: dict[str, Any] = {
                "ID": np.array([can_id for can_id, _ in ROWS], "<u4"),
                "DLC": np.array(lengths, "u1"),
                "DataLength": np.array(lengths, "u1"),
                "DataBytes": np.array([list(data.ljust(8, b"\0")) for _, data in ROWS], "u1"),
                "BusChannel": np.ones(len(ROWS), "u1"),
            } | changed
            fields = {f"{kind}.{name}": column for name, column in columns.items() if column is not None}
            kinds = [(name, column.dtype, column.shape[1:]) for name, column in fields.items()]
            records = np.zeros(len(ROWS), kinds)
            for name, column in fields.items():
                records[name] = column
            made.append([asammdf.Signal(records, np.arange(len(ROWS)) / 100, name=kind)])
        made.save(path, overwrite=True)
    with open_log(path) as log:
        return list(log.frames()), log


def test_mf4_errors_and_overloads_are_errors_of_the_bus(tmp_path: Path) -> None:
    frames, log = mf4(tmp_path / "run.mf4", CAN_DataFrame={}, CAN_ErrorFrame={}, CAN_OverloadFrame={})
    assert (log.problems.texts, of(frames)) == ([], ROWS)
    errors = [frame for frame in frames if frame.error]
    assert [frame.can_id for frame in errors] == [0x80, 0x08] * len(ROWS)  # bus error, protocol violation
    assert {frame.data[2] for frame in errors if frame.can_id == 0x08} == {0x20}  # overload


def test_mf4_frames_that_cannot_be_are_left_out_and_said(tmp_path: Path) -> None:
    ids, lengths = np.full(len(ROWS), 0x514, "<u4"), np.full(len(ROWS), 2, "u1")
    ids[3], lengths[5] = 0x900, 200
    frames, log = mf4(tmp_path / "run.mf4", CAN_DataFrame={"ID": ids, "DataLength": lengths})
    assert (len(frames), log.problems.count) == (len(ROWS) - 2, 2)
    assert "frame 4, 0x900 of 2 bytes, cannot be one" in log.problems.texts[0]


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"DataLength": None}, ""),
        ({"ID": None}, "its frames have no ID"),
        ({"DataBytes": None}, "its frames have no DataBytes"),
        ({"BusChannel": np.full(len(ROWS), 1 << 31, "<u4")}, "an invalid number of a bus"),
    ],
    ids=["DataLength", "ID", "DataBytes", "BusChannel"],
)
def test_mf4_without_a_field_is_read_or_refused(changed: dict[str, Any], words: str, tmp_path: Path) -> None:
    frames, log = mf4(tmp_path / "run.mf4", CAN_DataFrame=changed)
    assert of(frames) == ([] if words else ROWS)
    assert words in log.problems.summary() and bool(words) == bool(log.problems)


# ---------------------------------------------------------------- folders


def test_a_folder_of_logs_of_many_kinds_is_one_log(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    logs = {"a.LOG": "candump", "b.blf": "BLF", "c.TRC": "TRC 2.1", "d.txt": "Kvaser"}
    for name, what in logs.items():
        (tmp_path / name).write_bytes(as_bytes(MADE[what]))
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
    (tmp_path / "a.log").write_text(TEXTS["candump"])
    (tmp_path / "b.blf").write_bytes(blf(closed=False))
    (tmp_path / "c.trc").write_text("")
    for name in ("notes.md", ".a.lock", "a.json", "run.png"):  # all but the first are what a recording leaves
        (tmp_path / name).write_text("what we did")
    assert main(["check", str(tmp_path)]) == 1
    said = capsys.readouterr()
    died = "BLF, 24 frames; not readable as BLF after frame 24: the logger did not close the file"
    for name, words in (("a.log", "candump, 24 frames\n"), ("b.blf", died), ("c.trc", "no frames in it\n")):
        assert said.out.count(f"/{name}: ") == 1 and f"/{name}: {words}" in said.out
    assert said.err == ""
    assert "left out, as they are not logs: notes.md\n" in said.out
    assert sum(line.startswith("verdict: ") for line in said.out.splitlines()) == 1
    main(["check", str(tmp_path), "--json"])
    assert capsys.readouterr().out.count('"type": "log"') == 3
