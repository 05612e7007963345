"""Whatever a file holds, reading it takes memory and time as its bytes do, and ends in frames or in words."""

from __future__ import annotations

import gzip
import json
import os
import pickle
import random
import resource
import select
import signal
import struct
import sys
import tempfile
import time
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zstandard

from fsai_hil.simulator.tracks import TrackError, load_track
from fsai_vcu.cli.main import main
from fsai_vcu.diagnostics.decode.databases import load_databases
from fsai_vcu.diagnostics.log.mf4 import read_mf4
from fsai_vcu.diagnostics.log.reader import open_log
from fsai_vcu.diagnostics.recorder.repair import repair_mcap
from fsai_vcu.interface.database import load_database
from fsai_vcu.interface.errors import UserError
from fsai_vcu.interface.revisions import dbc_dir
from fsai_vcu.runtime.bounded import BoundedError, Bounds, send_results
from fsai_vcu.runtime.configuration import read_configuration
from fsai_vcu.runtime.limits_file import read_limits

MIB = 1 << 20
MEMORY_BYTES = 200 * MIB  # above what the process has
TIMES = 50.0  # as long as plain content of as many bytes takes
WITHIN_S = 300.0  # for a child on the busiest machine
LEAST_S = 5.0  # of the processor; whoever takes time by powers of the length takes hours
LINE = "(1700000000.123456) can0 520#0102030405060708\n"
GVRET = "Time Stamp,ID,Extended,Dir,Bus,LEN,D1,D2,D3,D4,D5,D6,D7,D8\n" + "166064000,00000520,false,Rx,0,2,64,00,\n" * 30
ASC = "date Mon Jan 1 00:00:00.000 2024\nbase hex  timestamps absolute\n" + " 0.010000 1  520  Rx   d 2 64 00\n" * 30
TRC = ";$FILEVERSION=1.1\n;\n" + "  1)      10.0  Rx     0520  2    64 00\n" * 30
TOML = "[can]\nrevision = '2026'\n[limits]\nfile = ''\n[missions]\ntrackdrive_laps = 10\n"
LIMITS = "max_speed_mps = 5.0\nmax_axle_torque_nm = 100\n"
CSV = "tag,x,y,direction\n" + "".join(f"blue,{x},1.5,0\nyellow,{x},-1.5,0\n" for x in range(40)) + "car_start,0,0,0\n"
YAML = "track:\n  left:\n" + "".join(f"  - {{class: blue, position: [{x}.0, 1.5, 0.0]}}\n" for x in range(20))
YAML += "  right:\n" + "".join(f"  - {{class: yellow, position: [{x}.0, -1.5, 0.0]}}\n" for x in range(20))
JSON = json.dumps({"x": [*range(40)] * 2, "y": [1.5] * 40 + [-1.5] * 40, "color": [2] * 40 + [1] * 40})


@pytest.fixture(scope="module", autouse=True)
def parser() -> None:
    """Load the parser of databases once, and not in each process that is forked."""
    load_databases()


def in_little_memory(work: Callable[[], Any]) -> Any:
    """What `work` returns in a process that may take `MEMORY_BYTES` more than this one has."""
    read_end, write_end = os.pipe()
    child = os.fork()
    if child == 0:
        try:  # whatever happens, it must not go on as a second pytest
            pages = int(Path("/proc/self/statm").read_text().split()[0])
            most = pages * resource.getpagesize() + MEMORY_BYTES
            resource.setrlimit(resource.RLIMIT_AS, (most, most))
            with os.fdopen(write_end, "wb") as pipe:
                pickle.dump(_returned_or_raised(work), pipe)
        finally:
            os._exit(0)
    os.close(write_end)
    with os.fdopen(read_end, "rb") as pipe:
        # A fork of a process with threads may find a lock that nobody gives back.
        ended = select.select([pipe], [], [], WITHIN_S)[0]
        if not ended:
            os.kill(child, signal.SIGKILL)
        sent = pipe.read()
    os.waitpid(child, 0)
    assert ended, f"it did not end within {WITHIN_S:g} s"
    assert sent, "it was ended by the limit"
    result = pickle.loads(sent)
    if isinstance(result, AssertionError | BoundedError):
        raise result
    return result


def _returned_or_raised(work: Callable[[], Any]) -> Any:
    try:
        return work()
    except BoundedError as error:
        return error
    except BaseException as error:
        return AssertionError(f"{type(error).__name__}: {error}"[:500])


def frames_and_problems(path: Path) -> tuple[int, list[str]]:
    """A log read through, without keeping it."""
    with open_log(path) as log:
        return sum(len(frames) for frames in log.chunks()), log.problems.texts


def spent_s(work: Callable[[], Any]) -> tuple[Any, float]:
    """What it returns, and the time of the processor it took."""
    began_s = time.process_time()
    return work(), time.process_time() - began_s


def blf_of(container: bytes, objects: int = 1) -> bytes:
    """A BLF whose containers unpack to what is given."""
    packed = zlib.compress(container)
    body = struct.pack("<H6xL4x", 2, len(container)) + packed
    entry = struct.pack("<4sHHLL", b"LOBJ", 16, 1, 16 + len(body), 10) + body
    entry += bytes(len(entry) % 4)
    return struct.pack("<4sL", b"LOGG", 144) + bytes(136) + entry * objects


@pytest.fixture(scope="module")
def plain_s_per_mib(tmp_path_factory: pytest.TempPathFactory) -> float:
    path = tmp_path_factory.mktemp("plain") / "plain.log"
    path.write_text(LINE * (4 * MIB // len(LINE)))
    return spent_s(lambda: frames_and_problems(path))[1] / 4


LOGS: dict[str, Callable[[], bytes]] = {
    "zeros behind frames": lambda: LINE.encode() * 1000 + bytes(32 * MIB),
    "one line": lambda: b"(" * (32 * MIB),
    "lines too long": lambda: (b"x" * 100_000 + b"\n" + LINE.encode()) * 300,
    "lines of nothing": lambda: b"x\n" * (MIB // 8),
    "packed zeros": lambda: gzip.compress(bytes(100 * MIB), 1),
    "packed zeros of GVRET": lambda: gzip.compress(GVRET.encode() + bytes(80 * MIB), 1),
    "packed frames all alike": lambda: gzip.compress(LINE.encode() * (80 * MIB // len(LINE)), 1),
    "one line of ASC": lambda: ASC.encode() + b"9" * (32 * MIB),
    "packed line of ASC": lambda: gzip.compress(ASC.encode() + bytes(80 * MIB), 1),
    "packed line of TRC": lambda: gzip.compress(TRC.encode() + bytes(80 * MIB), 1),
    "packed line of BLF": lambda: gzip.compress(blf_of(b"")[:16] + bytes(80 * MIB), 1),
    "a container of BLF": lambda: blf_of(bytes(80 * MIB)),
    "an object of BLF": lambda: blf_of(struct.pack("<4sHHLL", b"LOBJ", 16, 1, 1 << 31, 1) + bytes(100_000), 2000),
}


@pytest.mark.parametrize("what", LOGS)
def test_a_log_takes_memory_and_time_as_its_bytes_do(what: str, plain_s_per_mib: float, tmp_path: Path) -> None:
    path = tmp_path / "run.log"
    path.write_bytes(LOGS[what]())
    if what == "zeros behind frames":
        os.truncate(path, 512 * MIB)  # as a disk that was to be filled leaves it
    (_, problems), taken_s = in_little_memory(lambda: spent_s(lambda: frames_and_problems(path)))
    assert problems and all(len(problem) < 400 + len(str(path)) for problem in problems)
    assert taken_s < max(LEAST_S, TIMES * plain_s_per_mib * path.stat().st_size / MIB)


@pytest.mark.parametrize(
    "words", [["check", "--figures"], ["explain"], ["report", "-o", "r.html"]], ids=lambda words: words[0]
)
def test_a_log_that_jumps_by_lifetimes_takes_no_room_for_them(
    words: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "run.log"
    path.write_text("".join(f"({second}.000000) can0 520#0102030405060708\n" for second in (1, 2, 9_000_000_000)))
    assert in_little_memory(lambda: main([words[0], str(path), *words[1:]])) == 1


def test_of_a_line_without_end_the_frames_around_it_are_kept(tmp_path: Path) -> None:
    path = tmp_path / "run.log"
    for length in (5_000, 3 * MIB, 6 * MIB):
        path.write_bytes(LINE.encode() * 3 + b"\0" * length + b"\n" + LINE.encode() * 2 + b"?\n")
        count, problems = frames_and_problems(path)
        assert count == 5
        assert [problem.partition(": ")[2].partition(": '")[0] for problem in problems] == [
            "line 4: longer than 4096 characters",
            "line 7: not a line of candump",
        ]


def mf4_of(frames: int, compression: int) -> bytes:
    """An MF4 of frames that are all zeros."""
    asammdf = pytest.importorskip("asammdf", reason="asammdf is not installed (pip install 'fsai-vcu[mf4]')")
    kinds = {"BusChannel": "u1", "ID": "<u4", "DataLength": "u1", "DataBytes": "(64,)u1"}
    samples = np.zeros(frames, [(f"CAN_DataFrame.{name}", kind) for name, kind in kinds.items()])
    with tempfile.TemporaryDirectory() as folder, asammdf.MDF(version="4.10") as mdf:
        mdf.append(asammdf.Signal(samples, np.arange(frames) / 1000, name="CAN_DataFrame"))
        return Path(mdf.save(Path(folder) / "given.mf4", compression=compression)).read_bytes()


def in_a_circle(content: bytes, kind: bytes) -> bytes:
    """The MF4 with the first of its blocks of that kind followed by itself."""
    at = content.index(kind)
    return content[: at + 24] + struct.pack("<Q", at) + content[at + 32 :]


def test_an_mf4_takes_memory_and_time_as_its_bytes_do(tmp_path: Path) -> None:
    path = tmp_path / "run.log"
    content = mf4_of(1_000_000, 2)
    assert len(content) < MIB
    path.write_bytes(content)
    (_, problems), taken_s = in_little_memory(lambda: spent_s(lambda: frames_and_problems(path)))
    assert len(problems) == 1
    assert problems[0].startswith(f"{path}: not readable as MF4 after frame ")
    assert problems[0].endswith(": it unpacks to more than 100 times its size, as no log does")
    assert taken_s < LEAST_S


def test_a_list_in_an_mf4_that_never_ends_is_given_up(tmp_path: Path) -> None:
    path = tmp_path / "run.mf4"
    path.write_bytes(in_a_circle(mf4_of(10, 0), b"##CG"))
    with pytest.raises(BoundedError, match="more memory or time than a file of its size"):
        in_little_memory(lambda: list(read_mf4(path, print, seconds=1)))


def test_what_cannot_be_sent_is_said_and_not_sent_in_part() -> None:
    read_end, write_end = os.pipe()
    child = os.fork()
    if child == 0:
        try:  # whatever happens, it must not go on as a second pytest
            sys.stdout = os.fdopen(write_end, "w")
            bounds = Bounds(MEMORY_BYTES, 1, 10, 1.0)
            send_results(Path(__file__), bounds, lambda send: send(["x" * MIB, lambda: None]))
        finally:
            os._exit(1)
    os.close(write_end)
    with os.fdopen(read_end, "rb") as pipe:
        end = pickle.load(pipe)
    os.waitpid(child, 0)
    assert "lambda" in end.why  # each Python says in its own words that a function has no place to be found at


def test_an_mf4_with_less_than_it_announces_is_said_so(tmp_path: Path) -> None:
    path = tmp_path / "run.mf4"
    content = bytearray(mf4_of(10, 0))
    at = content.index(b"##CG") + 24 + 6 * 8 + 8
    assert content[at : at + 8] == struct.pack("<Q", 10)
    content[at : at + 8] = struct.pack("<Q", 1 << 40)
    path.write_bytes(content)
    assert frames_and_problems(path) == (10, [f"{path}: cut off: 10 of {1 << 40} frames are there"])


def records_of_mcap(*parts: bytes) -> bytes:
    """Its beginning: magic and header, then what is given."""
    return b"\x89MCAP0\r\n" + struct.pack("<BQLL", 1, 8, 0, 0) + b"".join(parts)


def chunk_of_mcap(compression: bytes, unpacked_bytes: int, data: bytes) -> bytes:
    body = struct.pack("<QQQLL", 0, 0, unpacked_bytes, 0, len(compression)) + compression
    body += struct.pack("<Q", len(data)) + data
    return struct.pack("<BQ", 6, len(body)) + body


MCAPS: dict[str, Callable[[], bytes]] = {
    "zeros": lambda: b"",
    "a chunk that unpacks": lambda: chunk_of_mcap(b"zstd", 1000, zstandard.compress(bytes(300 * MIB))),
    "a chunk that says so": lambda: chunk_of_mcap(b"zstd", 1 << 40, zstandard.compress(b"")),
    "a chunk of a kind that has no bound": lambda: chunk_of_mcap(b"lz4", 1000, b""),
    "a long attachment": lambda: struct.pack("<BQQQLLQ", 9, 100, 0, 0, 0, 0, 1 << 33),
    "a long record": lambda: struct.pack("<BQ", 0x80, 1 << 31),
}


@pytest.mark.parametrize("what", MCAPS)
def test_an_mcap_is_repaired_in_memory_and_time_of_its_bytes(what: str, tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    path.write_bytes(records_of_mcap(MCAPS[what]()))
    length = 10 << 30  # as a disk that was to be filled leaves it
    os.truncate(path, length)
    cut, taken_s = in_little_memory(lambda: spent_s(lambda: repair_mcap(path)))
    assert cut == length - len(records_of_mcap()) and path.stat().st_size < 1000
    assert taken_s < LEAST_S


def _expanding_yaml(last: str) -> str:
    lists = ["a0: &a0 [" + ",".join("x" * 9) + "]"]
    lists += [f"a{n}: &a{n} [" + ",".join([f"*a{n - 1}"] * 9) + "]" for n in range(1, 9)]
    return "\n".join([*lists, last])


def _merging_yaml() -> str:
    maps = ["a0: &a0 {x: 1}", *(f"a{n}: &a{n} {{<<: [{','.join([f'*a{n - 1}'] * 9)}]}}" for n in range(1, 9))]
    return "\n".join([*maps, "track: {left: [*a8]}"])


def _expanding_xml(root: str) -> str:
    entities = "".join(f'<!ENTITY a{n} "{f"&a{n - 1};" * 9}">' for n in range(1, 12))
    return f'<?xml version="1.0"?><!DOCTYPE k [<!ENTITY a0 "x">{entities}]><{root}>&a11;</{root}>'


TABLES: dict[str, tuple[str, Callable[[], str | bytes]]] = {
    "a class that expands": ("yaml", lambda: _expanding_yaml("track: {left: [{class: *a8, position: [1, 2]}]}")),
    "a place that expands": ("yaml", lambda: _expanding_yaml("track: {left: [{class: blue, position: *a8}]}")),
    "a point that expands": ("yaml", lambda: _expanding_yaml("cones_left: [*a8]")),
    "maps that merge": ("yaml", _merging_yaml),
    "deep lists": ("yaml", lambda: "track: " + "[" * 100_000),
    "a number of base 60": ("yaml", lambda: "track: {left: [{class: blue, position: [" + ":1" * 200_000 + "]}]}"),
    "digits": ("yaml", lambda: "cones_left: [[" + "9" * 500_000 + ", 1]]"),
    "deep lists of JSON": ("json", lambda: '{"x": ' + "[" * 100_000),
    "digits of JSON": ("json", lambda: '{"x": [' + "9" * 500_000 + '], "y": [1], "color": [1]}'),
    "digits of a cone": ("csv", lambda: "tag,x,y\nblue," + "9" * 500_000 + ",1\n"),
    "many cones": ("csv", lambda: "tag,x,y\n" + "blue,1,1\n" * 100_000),
    "many names": ("csv", lambda: "tag,x,y\n" + "".join(f"{'n' * 50}{n},1,1\n" for n in range(15_000))),
    "a quoted column": ("csv", lambda: 'tag,x,y\n"' + "x" * 900_000),
    "too large a track": ("csv", lambda: "tag,x,y\n" + "blue,1,1\n" * 200_000),
    "a long message": ("dbc", lambda: 'VERSION ""\nBU_: A\nBO_ 1 M: 99999999 A\n SG_ S : 0|1@1+ (1,0) [0|0] "" A\n\n'),
    "a long message in a comment": ("dbc", lambda: "BU_: A\nBO_ // x\n 1 M // y\n: 99999999 A\n\n"),
    "a long signal": ("dbc", lambda: 'BU_: A\nBO_ 1 M: 8 A\n SG_ S : 0|999999999999@1+ (1,0) [0|0] "" A\n\n'),
    "digits of a message": ("dbc", lambda: "BU_: A\nBO_ " + "9" * 500_000 + " M: 8 A\n"),
    "a million signals": ("dbc", lambda: "BO_ 1 M: 8 A\n" + ' SG_ S : 0|1@1+ (1,0) [0|0] "" A\n' * 1_000_000),
    "an open text": ("dbc", lambda: 'VERSION "' + '"\\' * 200_000),
    "brackets": ("dbc", lambda: 'BU_: A\nBO_ 1 M: 8 A\n SG_ S : 0|1@1+ (1,0) [0|0] "" A\nSG_ ' + "[" * 100_000),
    "a range of values": (
        "dbc",
        lambda: (
            'BU_: A\nBO_ 1 M: 8 A\n SG_ X M : 0|8@1+ (1,0) [0|0] "" A\n SG_ Y m1 : 8|8@1+ (1,0) [0|0] "" A\n\n'
            "SG_MUL_VAL_ 1 Y X 0-999999999 ;\n"
        ),
    ),
    "a message of SYM": (
        "sym",
        lambda: 'FormatVersion=6.0 // x\nTitle="t"\n\n{SENDRECEIVE}\n\n[M]\nID=123h\nLen=99999999\n',
    ),
    "a signal of KCD": (
        "kcd",
        lambda: (
            '<NetworkDefinition xmlns="http://kayak.2codeornot2code.org/1.0"><Bus name="b"><Message id="0x1" '
            'name="M" length="8"><Signal name="S" offset="0" length="99999999"/></Message></Bus></NetworkDefinition>'
        ),
    ),
    "a long message of KCD": (
        "kcd",
        lambda: (
            '<NetworkDefinition xmlns="http://kayak.2codeornot2code.org/1.0"><Bus name="b"><Message id="0x1" '
            'name="M" length="99999"><Signal name="S" offset="0" length="8"/></Message></Bus></NetworkDefinition>'
        ),
    ),
    "entities": ("kcd", lambda: _expanding_xml("NetworkDefinition")),
    "entities of ARXML": ("arxml", lambda: _expanding_xml("AUTOSAR")),
    "entities of CDD": ("cdd", lambda: _expanding_xml("CANDELA")),
    "deep elements": ("arxml", lambda: "<AUTOSAR>" + "<a>" * 100_000),
    "a long name": ("dbc", lambda: f'BU_: A\nBO_ 1 {"M" * 100_000}: 8 A\n SG_ S : 0|1@1+ (1,0) [0|0] "" A\n\n'),
    "digits of a factor": (
        "dbc",
        lambda: f'BU_: A\nBO_ 1 M: 8 A\n SG_ S : 0|1@1+ ({"9" * 399},0) [0|0] "" A\n\n',
    ),
}
READERS: dict[str, tuple[Callable[[Path], object], ...]] = {
    "yaml": (load_track,),
    "json": (load_track,),
    "csv": (load_track,),
    "dbc": (lambda path: load_databases([path]), lambda path: load_database([path])),
    "kcd": (lambda path: load_databases([path]),),
    "sym": (lambda path: load_databases([path]),),
    "arxml": (lambda path: load_databases([path]),),
    "cdd": (lambda path: load_databases([path]),),
    "toml": (read_configuration, read_limits),
    "log": (frames_and_problems,),
}


def refusals(path: Path, kind: str) -> Iterator[str]:
    """What the readers of that kind say of a file that they do not take."""
    for read in READERS[kind]:
        try:
            read(path)
        except (UserError, TrackError) as error:
            yield str(error)


# The same refusal of the same parser of XML, or of the same length, as another one shows.
REPEATED = ("a long message of KCD", "entities of ARXML", "entities of CDD")


@pytest.mark.parametrize("what", [pytest.param(what, marks=[pytest.mark.long] * (what in REPEATED)) for what in TABLES])
def test_a_table_that_expands_is_refused_in_one_line(what: str, tmp_path: Path) -> None:
    kind, content = TABLES[what]
    path = tmp_path / f"given.{kind}"
    made = content()
    path.write_bytes(made if isinstance(made, bytes) else made.encode())
    said, taken_s = in_little_memory(lambda: spent_s(lambda: list(refusals(path, kind))))
    assert len(said) == len(READERS[kind])
    for line in said:
        assert str(path) in line and "\n" not in line and len(line) < 500 + len(str(path)), line[:1000]
    assert taken_s < 4 * LEAST_S
    if what.startswith(("a long message", "a long signal")):
        assert all("1785 bytes" in line for line in said), said


PLAIN: dict[str, tuple[str, bytes]] = {
    "candump": ("log", LINE.encode() * 40),
    "packed": ("log", gzip.compress(LINE.encode() * 40)),
    "GVRET": ("log", GVRET.encode()),
    "ASC": ("log", ASC.encode()),
    "TRC": ("log", TRC.encode()),
    "MF4": ("log", b""),  # made in the test: it needs a package, and a second
    "BLF": ("log", blf_of(struct.pack("<4sHHLL", b"LOBJ", 16, 1, 48, 1) + bytes(32))),
    "DBC": ("dbc", (dbc_dir() / "pcan_gps.dbc").read_bytes()),
    "configuration": ("toml", TOML.encode()),
    "limits": ("toml", LIMITS.encode()),
    "CSV": ("csv", CSV.encode()),
    "YAML": ("yaml", YAML.encode()),
    "JSON": ("json", JSON.encode()),
}


def torn(content: bytes, chance: random.Random) -> bytes:
    """As a disk or a person may have left it: cut off, a part many times over, bytes replaced, a long run within."""
    begin, end = sorted(chance.randrange(len(content) + 1) for _ in range(2))
    match chance.randrange(4):
        case 0:
            return content[:end]
        case 1:
            return content[:begin] + content[begin:end] * min(200, 1 + 60_000 // (1 + end - begin)) + content[end:]
        case 2:
            return content[:begin] + bytes(chance.randrange(256) for _ in range(chance.randrange(9))) + content[end:]
        case _:
            run = chance.choice([b"\0", b"9", b"[", b"{", b"(", b" ", b"a.", b'"', b"\\", b"- ", b"\xff", b"*a"])
            return content[:begin] + run * (30_000 // len(run)) + content[begin:]


@pytest.mark.parametrize("seeds", [range(8), pytest.param(range(8, 50), marks=pytest.mark.long)], ids=["8", "all"])
@pytest.mark.parametrize("kind", PLAIN)
def test_a_torn_file_is_read_or_refused_in_words(kind: str, seeds: range, tmp_path: Path) -> None:
    suffix, content = PLAIN[kind]
    path = tmp_path / f"given.{suffix}"
    content = content or mf4_of(30, 0)

    def all_torn() -> int:
        refused = 0
        for seed in seeds[: 2 if kind == "MF4" else None]:  # it starts a process for each
            path.write_bytes(torn(content, random.Random(seed)))
            refused += len(list(refusals(path, suffix)))
        return refused

    refused, taken_s = in_little_memory(lambda: spent_s(all_torn))
    assert refused or suffix == "log"
    assert taken_s < len(seeds) * LEAST_S
