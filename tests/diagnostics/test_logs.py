"""Every log of a bus is read, whoever wrote it; and of a broken one everything that can be read."""

from __future__ import annotations

import gzip
import re
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from importlib import reload
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fsai_vcu.diagnostics.log.blocks import parse_block
from fsai_vcu.diagnostics.log.candump import log_lines
from fsai_vcu.diagnostics.log.candump_line import date_text, parse_line, screen_line, time_text
from fsai_vcu.diagnostics.log.candump_rows import CandumpRows
from fsai_vcu.diagnostics.log.frames import LogFrame, frames_of, joined, straightened
from fsai_vcu.diagnostics.log.problems import Problems
from fsai_vcu.diagnostics.log.reader import LogError, open_log, read_log

T0_NS = 1_436_509_053_850_870_000


def frame(can_id: int = 0x520, data: bytes = b"\x01\xa5", **other: Any) -> LogFrame:
    return LogFrame(other.pop("t_ns", T0_NS), other.pop("channel", "can0"), can_id, data, **other)


MIXED = [
    frame(0x520, bytes(range(8))),
    frame(0x514, b"\x0a\xff", t_ns=T0_NS + 1_000_000),
    frame(0x080, b"", t_ns=T0_NS + 2_000_000),
    frame(0x18FF0001, b"\x7f", t_ns=T0_NS + 3_000_000, extended=True),
    frame(0x001, b"\x11\x22\x33", t_ns=T0_NS + 4_000_000, extended=True),
]


def plainly(frames: Sequence[LogFrame]) -> list[tuple[int, int, bytes, bool]]:
    return [(f.t_ns, f.can_id, f.data, f.extended) for f in frames]


def read(path: Path) -> list[LogFrame]:
    with open_log(path) as log:
        found = list(log.frames())
    assert log.problems.texts == []
    return found


def write_with_python_can(path: Path, frames: Sequence[LogFrame]) -> None:
    # Its writer of MF4 is switched off in this process (fsai_vcu.lean_can).
    with can.Logger(path) if path.suffix != ".mf4" else reload(can.io.mf4).MF4Writer(path) as writer:
        for f in frames:
            writer.on_message_received(
                can.Message(
                    timestamp=f.t_ns / 1e9,
                    arbitration_id=f.can_id,
                    data=f.data,
                    dlc=f.length,
                    channel=int(f.channel[-1]),
                    is_extended_id=f.extended,
                    is_remote_frame=f.remote,
                    is_error_frame=f.error,
                    is_fd=f.fd,
                    bitrate_switch=f.brs,
                    is_rx=not f.sent,
                )
            )


# ---------------------------------------------------------------- formats


@pytest.mark.parametrize("end", ["\n", "\r\n"], ids=["unix", "windows"])
@pytest.mark.parametrize("suffix", ["", " R", " T"])
def test_a_candump_log_is_read_with_and_without_directions(tmp_path: Path, suffix: str, end: str) -> None:
    path = tmp_path / "run.log"
    path.write_bytes("".join(line.decode() + suffix + end for line in log_lines(frames_of(MIXED))).encode())
    found = read(path)
    assert plainly(found) == plainly(MIXED)
    assert {f.sent for f in found} == {{"": None, " R": False, " T": True}[suffix]}
    assert {f.channel for f in found} == {"can0"}


@pytest.mark.parametrize("suffix", [".blf", ".asc", ".trc"])
def test_binary_and_vector_formats_are_read_to_the_microsecond(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"run{suffix}"
    write_with_python_can(path, MIXED)
    found = read(path)
    # An ASC file names its beginning to the millisecond only, PCAN-View's trace not at all; then times are exact.
    late_ns = MIXED[0].t_ns - found[0].t_ns
    assert suffix == ".trc" or late_ns == (870_000 if suffix == ".asc" else 0)
    assert plainly([replace(f, t_ns=f.t_ns + late_ns) for f in found]) == plainly(MIXED)


def test_mf4_is_read_packed_with_frames_of_every_kind_in_time(tmp_path: Path) -> None:
    expected = [
        frame(0x510, bytes(range(12)), fd=True, brs=True, channel="can1", sent=True),
        frame(0x511, b"", remote=True, length=4, t_ns=T0_NS + 1_000_000, channel="can2", sent=False),
        frame(0x004, b"\x01\x02", error=True, t_ns=T0_NS + 2_000_000, channel="can1", sent=False),
        frame(0x18FF0001, b"\x7f", extended=True, t_ns=T0_NS + 3_000_000, channel="can2", sent=False),
    ]
    path, packed = tmp_path / "run.mf4", tmp_path / "run.mf4.gz"
    write_with_python_can(path, expected)
    packed.write_bytes(gzip.compress(path.read_bytes()))
    assert read(packed) == expected


def test_mf4_frames_marked_as_invalid_are_read_too(tmp_path: Path) -> None:
    import asammdf  # slow to import

    fields = {"BusChannel": "u1", "ID": "<u4", "DataLength": "u1", "DataBytes": "(8,)u1"}
    frames = np.zeros(3, [(f"CAN_DataFrame.{name}", kind) for name, kind in fields.items()])
    frames["CAN_DataFrame.ID"] = 0x520
    invalid = np.array([False, True, False])
    with asammdf.MDF(version="4.11") as mdf:
        source = asammdf.Source("CAN", "CAN", "", 2, 2)
        mdf.append(
            [asammdf.Signal(frames, np.arange(3.0), name="CAN_DataFrame", source=source, invalidation_bits=invalid)]
        )
        mdf.save(tmp_path / "run.mf4")
    assert len(read(tmp_path / "run.mf4")) == 3


def test_an_mf4_of_signals_is_not_taken_for_an_empty_log(tmp_path: Path) -> None:
    import asammdf  # slow to import

    path = tmp_path / "run.mf4"
    with asammdf.MDF(version="4.10") as mdf:
        mdf.append(asammdf.Signal(np.arange(3), np.arange(3.0), name="ANGLE"))
        mdf.save(path)
    frames, problems = problems_of(path, path.read_bytes())
    assert (frames, problems) == ([], [f"{path}: an MF4 of signals, not of a bus's frames"])


def test_mf4_without_its_package_names_what_installs_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "asammdf", None)
    frames, problems = problems_of(tmp_path / "run.mf4", b"MDF     4.10    ")
    assert (frames, problems) == ([], [f"{tmp_path / 'run.mf4'}: MF4 needs asammdf: pip install 'fsai-vcu[mf4]'"])


def test_the_csv_of_savvycan_is_read_in_both_versions(tmp_path: Path) -> None:
    head, now = "Time Stamp,ID,Extended,{}Bus,LEN,D1,D2,D3,D4,D5,D6,D7,D8", "{},{:08X},{},{}1,{},{},\n"
    for dir_head, dir_word, sent in (("", "", None), ("Dir,", "Rx,", False), ("Dir,", "Tx,", True)):
        lines = [
            now.format(f.t_ns // 1000, f.can_id, str(f.extended).lower(), dir_word, len(f.data), f.data.hex(","))
            for f in MIXED
        ]
        path = tmp_path / "run.csv"
        path.write_text(head.format(dir_head) + "\n" + "".join(lines))
        assert read(path) == [replace(f, channel="can1", sent=sent) for f in MIXED]
        with open_log(path) as log:
            assert list(joined(log.chunks())) == read(path)


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("1,00000520,false,Rx,0,2,01\n", "1 data bytes where 2 are announced"),
        ("1,00000800,false,Rx,0,1,01\n", "no 11-bit identifier: 00000800"),
        ("1,20000000,true,Rx,0,1,01\n", "no 29-bit identifier: 20000000"),
        ("-1,00000520,false,Rx,0,1,01\n", "invalid time: -1"),
        ("1,00000520,false,Rx,0,9,1,2,3,4,5,6,7,8,9\n", "9 data bytes"),
        ("1,00000520,false,Rx\n", "not a line of GVRET"),
        ("1,00000520,false,Rx,0,1,100\n", "not a line of GVRET"),
        ("1,00000520,false,Rx,0,2,01", "1 data bytes where 2 are announced"),
        ("1,00000520,false,Rx,0,2,01,0", "cut off, without a line end; its frame is left out"),
    ],
)
def test_an_invalid_line_of_savvycan_is_named(tmp_path: Path, line: str, words: str) -> None:
    head = "Time Stamp,ID,Extended,Dir,Bus,LEN,D1,D2,D3,D4,D5,D6,D7,D8\n1,00000520,false,Rx,0,2,01,A5,\n"
    frames, problems = problems_of(tmp_path / "run.csv", (head + line).encode())
    assert (len(frames), len(problems)) == (1, 1)
    assert f"line 3: {words}" in problems[0]


@pytest.mark.parametrize("end", ["", ","])
def test_a_whole_last_line_of_savvycan_needs_no_line_end(tmp_path: Path, end: str) -> None:
    path = tmp_path / "run.csv"
    path.write_text("Time Stamp,ID,Extended,Dir,Bus,LEN,D1,D2\n1,00000520,false,Rx,0,2,01,A5" + end)
    assert [frame.data.hex() for frame in read(path)] == ["01a5"]


def test_what_log2asc_makes_of_a_candump_log_is_the_same_log(tmp_path: Path) -> None:
    log, asc = tmp_path / "run.log", tmp_path / "run.asc"
    log.write_bytes(b"\n".join(log_lines(frames_of(MIXED))) + b"\n")
    subprocess.run(["log2asc", "-I", str(log), "-O", str(asc), "can0"], check=True)
    found = read(asc)
    assert [(f.can_id, f.data, f.extended) for f in found] == [(f.can_id, f.data, f.extended) for f in MIXED]
    since = [f.t_ns - found[0].t_ns for f in found]
    assert since == [f.t_ns - MIXED[0].t_ns for f in MIXED]


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("  can0  520   [2]  01 A5", frame(t_ns=0)),
        (" (1436509053.850870)  can0  520   [2]  01 A5", frame()),
        (" (000.001000)  can0  18FF0001   [1]  7F", frame(0x18FF0001, b"\x7f", t_ns=1_000_000, extended=True)),
        ("  can0  520   [2]  01 A5   '..'", frame(t_ns=0)),
        ("  can0  RX - -  520   [2]  01 A5", frame(t_ns=0, sent=False)),
        ("  can0  TX B E  520  [02]  01 A5", frame(t_ns=0, sent=True, fd=True, brs=True, esi=True)),
        ("  can0  520   [4]  remote request", frame(data=b"", t_ns=0, remote=True, length=4)),
        ("  can0  20000004   [2]  01 A5   ERRORFRAME", frame(4, t_ns=0, error=True)),
        ("(1436509053.850870) can0 520#R", frame(data=b"", remote=True)),
        ("(1436509053.850870) can0 520#R4 T", frame(data=b"", remote=True, length=4, sent=True)),
        ("(1436509053.850870) can0 520##301A5", frame(fd=True, brs=True, esi=True)),
        ("(1436509053.850870) can0 20000004#01A5", frame(4, error=True)),
        ("(1436509053.850870123) can0 520#01a5", frame(t_ns=T0_NS + 123)),
        ("(1436509053.850870) can0 520#0102030405060708_E", frame(data=bytes(range(1, 9)))),
    ],
)
def test_each_manner_of_candump_is_understood(line: str, expected: LogFrame) -> None:
    assert parse_line(line) == expected


@given(
    st.lists(
        st.builds(
            lambda t_us, channel, extended, can_id, data, sent: LogFrame(
                t_us * 1000, channel, can_id % (0x2000_0000 if extended else 0x800), data, extended, sent=sent
            ),
            t_us=st.integers(86_400_000_000, 9_223_372_035_000_000),  # short ones may be differences
            channel=st.sampled_from(["can0", "vcan12", "c", "slcan-with-a-15"]),
            extended=st.booleans(),
            can_id=st.integers(0, 0x1FFF_FFFF),
            data=st.binary(max_size=8),
            sent=st.sampled_from([None, True, False]),
        ),
        max_size=30,
    )
)
def test_reading_many_lines_at_once_is_reading_each_line(
    tmp_path_factory: pytest.TempPathFactory, frames: list[LogFrame]
) -> None:
    words = {None: "", True: " T", False: " R"}
    text = [line.decode() + words[f.sent] for line, f in zip(log_lines(frames_of(frames)), frames, strict=True)]
    path = tmp_path_factory.mktemp("log") / "run.log"
    path.write_text("\n".join(text) + "\n")
    assert read(path) == frames == [parse_line(line) for line in text]


@given(
    st.lists(st.sampled_from(list(" ()#.:[]-0123456789ABCDEFabcdefgRTXcan\t\r\n\0\xff")), max_size=80).map("".join),
    st.sampled_from(
        [
            "(1.000000) can0 520#01A5\n(1.000000) can0 {0}\n(1.000001) can0 520#{0}\n{0}\n",
            " (1.000000)  can0  520   [2]  01 A5\n (1.000000)  can0{0}\n (1.000000)  can0  520   [2]  {0}\n{0}\n",
            "  can0  RX - -  520   [2]  01 A5\n  can0  RX - -  520   [2{0}\n  can0{0}\n",
        ]
    ),
)
@settings(max_examples=150)
def test_the_fast_reader_reads_what_the_careful_one_reads(text: str, template: str) -> None:
    lines = template.format(text).encode("latin-1")
    frames, unreadable, _ = parse_block(np.frombuffer(lines, np.uint8), [], CandumpRows(Problems()))
    careful, wrong = [], []
    for number, line in enumerate(lines.split(b"\n")[:-1]):
        try:
            found = CandumpRows(Problems())(line.removesuffix(b"\r").decode("ascii"))
            careful += [found] if found is not None else []
        except ValueError:
            wrong += [number] if line.strip() else []
    assert list(frames) == careful
    assert [each.line for each in unreadable] == wrong


@pytest.mark.parametrize("way", ["", "RX - -  ", "TX - -  "])
@pytest.mark.parametrize("time", ["", " (1436509053.850870)", " (000.000010)"])
def test_lines_of_candumps_screen_are_read_together(time: str, way: str) -> None:
    """Not one by one: a line of each length and kind, all in one block."""
    frames = [frame(n, bytes(range(240, 240 + n)), channel="can1", extended=wide) for n in range(9) for wide in (0, 1)]
    lines = [f"{time}{screen_line(each).replace('can1  ', 'can1  ' + way)}" for each in frames]
    text = "".join(f"{line}\n" for line in lines).encode()
    found, unreadable, _ = parse_block(np.frombuffer(text, np.uint8), [], CandumpRows(Problems()))
    assert not unreadable
    assert list(found) == [parse_line(line) for line in lines]
    assert [(f.can_id, f.data, f.sent) for f in found] == [
        (f.can_id, f.data, {"": None, "R": False, "T": True}[way[:1]]) for f in frames
    ]


def test_an_fd_payload_stays_whole_and_with_its_frame() -> None:
    long = frame(0x510, bytes(range(12)), fd=True)
    columns = frames_of([frame(), long, frame(0x511)])
    assert list(columns) == [frame(), long, frame(0x511)]
    chosen = columns.only(np.array([False, True, True]))
    assert list(joined([chosen, columns])) == [long, frame(0x511), frame(), long, frame(0x511)]


# ---------------------------------------------------------------- broken logs


def problems_of(path: Path, content: bytes) -> tuple[list[LogFrame], list[str]]:
    path.write_bytes(content)
    with open_log(path) as log:
        return list(log.frames()), log.problems.texts


GOOD = b"(1.000000) can0 520#01A5\n"


@pytest.mark.parametrize(
    ("bad", "words"),
    [
        (b"what is this\n", "line 2: not a line of candump: 'what is this'"),
        (b"(1.000000) can0 520#01A\n", "line 2: not a line of candump"),
        (b"(1.000000) can0 FFF#01\n", "line 2: no 11-bit identifier: FFF"),
        (b"(1.000000) can0 FFFFFFFF#01\n", "line 2: no 29-bit identifier: FFFFFFFF"),
        (b"(1.000000) can0 520#112233445566778899\n", "line 2: 9 data bytes"),
        (b"(99999999999.000000) can0 520#01\n", "line 2: invalid time"),
        (b"\xff\xfe\x00\x9c#\xb0\n", "line 2: not text"),
        (b"  can0  520   [8]  01 A5\n", "line 2: 2 data bytes where 8 are announced"),
    ],
)
def test_an_invalid_line_is_named_and_all_others_are_read(tmp_path: Path, bad: bytes, words: str) -> None:
    frames, problems = problems_of(tmp_path / "run.log", GOOD + bad + GOOD)
    assert len(frames) == 2
    assert len(problems) == 1
    assert words in problems[0]
    assert "\n" not in problems[0]


def test_empty_lines_are_no_problem(tmp_path: Path) -> None:
    assert problems_of(tmp_path / "run.log", GOOD + b"\n  \n" + GOOD)[1] == []


@pytest.mark.parametrize("cut", range(1, len(GOOD)))
def test_a_possibly_cut_last_frame_is_left_out_and_reported(tmp_path: Path, cut: int) -> None:
    frames, problems = problems_of(tmp_path / "run.log", GOOD + GOOD[:-cut])
    assert len(frames) == 1
    assert problems == [f"{tmp_path / 'run.log'}: line 2: cut off, without a line end; its frame is left out"]


@pytest.mark.parametrize("last", [b"(1.000000) can0 520#0011223344556677", b"(1.000000) can0 520#01A5 R"])
def test_a_last_line_without_line_end_counts_if_complete(tmp_path: Path, last: bytes) -> None:
    frames, problems = problems_of(tmp_path / "run.log", GOOD + last)
    assert (len(frames), problems) == (2, [])


def test_line_numbers_are_right_far_into_a_log_of_many_blocks(tmp_path: Path) -> None:
    frames, problems = problems_of(tmp_path / "run.log", GOOD * 50_000 + b"garbage\n" + GOOD)
    assert len(frames) == 50_001
    assert [re.findall(r"line (\d+)", text) for text in problems] == [["50001"]]


def test_a_cut_gzip_file_is_read_up_to_the_cut(tmp_path: Path) -> None:
    text = b"".join(
        b"(%d.%06d) can0 520#%016X\n" % (n // 100, n * 7919 % 1_000_000, n * 0x9E3779B97F4A7C15 % 2**64)
        for n in range(30_000)
    )
    packed = gzip.compress(text)
    frames, problems = problems_of(tmp_path / "run.log.gz", packed[: len(packed) // 2])
    assert 10_000 < len(frames) < 20_000
    assert len(problems) == 1 and "cannot be read to its end" in problems[0]


@pytest.mark.parametrize("suffix", [".blf", ".asc"])
def test_a_broken_binary_log_is_read_up_to_the_break(tmp_path: Path, suffix: str) -> None:
    whole, path = tmp_path / f"whole{suffix}", tmp_path / f"run{suffix}"
    many = [
        frame(t_ns=T0_NS + n * 1_000_000, data=(n * 0x9E3779B97F4A7C15 % 2**64).to_bytes(8, "big"))
        for n in range(20_000)
    ]
    write_with_python_can(whole, many)
    content = whole.read_bytes()
    frames, problems = problems_of(path, content[: len(content) // 2])
    assert 1000 < len(frames) < 20_000
    assert [(f.can_id, f.data) for f in frames] == [(f.can_id, f.data) for f in many[: len(frames)]]
    assert len(problems) == 1, problems
    assert "\n" not in problems[0]


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda path: None, "No such file or directory"),
        (lambda path: path.mkdir(), "Is a directory"),
    ],
    ids=["absent", "a folder"],
)
def test_a_log_that_cannot_be_opened_is_one_line(tmp_path: Path, make: Callable[[Path], None], words: str) -> None:
    path = tmp_path / "run.log"
    make(path)
    with pytest.raises(LogError, match=words) as refused:
        open_log(path)
    assert str(path) in str(refused.value)


# ---------------------------------------------------------------- reading all of it


def test_the_whole_of_a_log_is_one_set_of_columns(tmp_path: Path) -> None:
    path = tmp_path / "run.log"
    path.write_bytes(GOOD * 40_000 + b"(2.000000) can1 510##111223344556677889900\n")
    frames, problems = read_log(path)
    assert not problems
    assert len(frames) == 40_001
    assert list(frames.channels) == ["can0", "can1"]
    assert frames.frame(40_000).data == bytes.fromhex("11223344556677889900")
    assert frames.data.shape == (40_001, 8)


def test_lines_on_a_screen_are_read_back_from_what_is_shown() -> None:
    frames = [
        *MIXED,
        frame(0x510, bytes(range(12)), fd=True),
        frame(data=b"", remote=True, length=4),
        frame(4, error=True),
    ]
    assert [parse_line(screen_line(each, time_text(each.t_ns))) for each in frames] == frames
    received = [replace(each, sent=bool(each.sent)) for each in frames]
    lines = [screen_line(each, date_text(each.t_ns), extra=True, indented=True, ascii_=True) for each in received]
    assert [parse_line(line) for line in lines] == received


@pytest.mark.parametrize("wrong_s", [-1.0, 1.0])
@pytest.mark.parametrize("rows", [[2], [40], [40, 41], [97]])
def test_a_wrong_stamp_is_no_clock_that_was_set(wrong_s: float, rows: list[int]) -> None:
    sound_ns = np.arange(100) * 10_000_000
    t_ns = sound_ns.copy()
    t_ns[rows] += int(wrong_s * 1e9)
    moved_ns, steps_ns = straightened(t_ns)
    assert not steps_ns.any()
    assert (np.diff(moved_ns) >= 0).all()


@pytest.mark.parametrize("row", [1, 40, 99])
def test_what_follows_a_clock_that_was_set_back_goes_on(row: int) -> None:
    t_ns = np.arange(100) * 10_000_000
    t_ns[row:] -= 1_000_000_000
    moved_ns, steps_ns = straightened(t_ns)
    assert np.flatnonzero(steps_ns).tolist() == [row]
    assert moved_ns[-1] - moved_ns[0] == 980_000_000  # the frame after the step is at the time of the one before
