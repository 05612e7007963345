"""Values are cantools' values, to the last bit, for every signal of every frame; and printed lines are its lines."""

from __future__ import annotations

import json
import math
import random
import re
import struct
from pathlib import Path
from typing import Any

import cantools.database
import numpy as np
import pytest
from cantools.database.can import Database
from hypothesis import given, settings
from hypothesis import strategies as st

from fsai_vcu.diagnostics.decode.databases import databases_of, load_databases
from fsai_vcu.diagnostics.decode.decoder import Decoder
from fsai_vcu.diagnostics.decode.layouts import EXTENDED_KEY
from fsai_vcu.diagnostics.decode.lines import LineWriter
from fsai_vcu.diagnostics.log.characters import Texts, lines_of, number_texts, texts_of
from fsai_vcu.diagnostics.log.frames import Frames, LogFrame, frames_of
from fsai_vcu.interface.errors import UserError
from fsai_vcu.interface.revisions import REVISIONS, dbc_dir


def same(ours: Any, theirs: Any) -> bool:
    if isinstance(theirs, float) and math.isnan(theirs):
        return isinstance(ours, float) and math.isnan(ours)
    return type(ours) is type(theirs) and ours == theirs and math.copysign(1, ours) == math.copysign(1, theirs)


def assert_like_cantools(decoder: Decoder, frames: Frames) -> int:
    """Every signal of every frame; returns how many values were compared."""
    found: dict[tuple[int, str], tuple[Any, str]] = {}
    for table in decoder.tables(frames).values():
        for series in table.series.values():
            values = series.values.tolist()
            for index, row in enumerate(series.rows.tolist()):
                assert series.t_ns[index] == frames.t_ns[row]
                found[row, series.name] = values[index], series.label(index)
    compared = 0
    for row, frame in enumerate(frames):
        layout = decoder.databases.layouts.get(frame.can_id | (EXTENDED_KEY if frame.extended else 0))
        if layout is None or len(frame.data) != layout.length:
            continue
        message = decoder.databases.message(layout.key)
        try:
            numbers: Any = message.decode(frame.data, decode_choices=False)
            words: Any = message.decode(frame.data, decode_choices=True)
        except Exception:
            continue
        for name, theirs in numbers.items():
            ours, label = found.pop((row, name))
            assert same(ours, theirs), f"{message.name}.{name} of {frame.data.hex()}: {ours!r}, cantools: {theirs!r}"
            assert label == str(words[name])
            compared += 1
    assert not found, "values that cantools does not give"
    return compared


def random_frames(databases: list[Database], count: int, seed: int) -> Frames:
    """Payloads at random, and those with all bits alike, of every message."""
    chance = random.Random(seed)
    records = []
    messages = [message for database in databases for message in database.messages]
    for n in range(count):
        message = messages[n % len(messages)]
        pattern = chance.random()
        if pattern < 0.1:
            data = bytes([0xFF if pattern < 0.05 else 0x00]) * message.length
        else:
            data = chance.randbytes(message.length)
        records.append(LogFrame(n * 1000, "can0", message.frame_id, data, message.is_extended_frame))
    return frames_of(records)


@pytest.mark.parametrize("revision", REVISIONS)
def test_every_signal_of_the_cars_databases_is_as_in_cantools(revision: str) -> None:
    decoder = Decoder(load_databases(revision=revision))
    raw = [cantools.database.load_file(dbc_dir() / name) for name in REVISIONS[revision].dbc_files]
    assert all(layout.plain for layout in decoder.databases.layouts.values())
    assert assert_like_cantools(decoder, random_frames(raw, 8000, 1)) > 20_000  # type: ignore[arg-type]


# ---------------------------------------------------------------- any database


@st.composite
def signal_lines(draw: st.DrawFn, name: str, start: int, length: int, big: bool) -> tuple[str, str]:
    """An SG_ line and what must stand at the end of the file for it."""
    kind = draw(st.sampled_from(["+", "-"]))
    extra = ""
    if length in (32, 64) and draw(st.booleans()):
        extra = f"SIG_VALTYPE_ {{id}} {name} : {1 if length == 32 else 2};\n"
        kind = "-"
    scale = draw(
        st.sampled_from(["1", "1", "2", "-3", "0.1", "0.5", "0.00390625", "-0.01", "1.0", "1000000", "1E-9", "7.25"])
    )
    offset = draw(st.sampled_from(["0", "0", "-40", "0.5", "100", "-327.68", "1E9"]))
    unit = draw(st.sampled_from(["", "rpm", "°/s", "%"]))
    if not extra and draw(st.integers(0, 3)) == 0:
        values = draw(st.lists(st.integers(-3 if kind == "-" else 0, 9), unique=True, min_size=1, max_size=4))
        words = " ".join(f'{value} "word {value}"' for value in values)
        extra = f"VAL_ {{id}} {name} {words} ;\n"
    if big:
        start = start // 8 * 8 + 7 - start % 8
    return f' SG_ {name} : {start}|{length}@{0 if big else 1}{kind} ({scale},{offset}) [0|0] "{unit}" AI\n', extra


@st.composite
def plain_databases(draw: st.DrawFn) -> str:
    """A DBC file of messages of both byte orders: whole-range, odd widths, signed, float, scaled, with words."""
    body, end = "", ""
    for number in range(draw(st.integers(1, 3))):
        extended, big = draw(st.booleans()), draw(st.booleans())
        can_id = 0x100 + number | (0x8000_0000 if extended else 0)
        length = draw(st.integers(1, 8))
        body += f"\nBO_ {can_id} Message{number}: {length} AI\n"
        at, index = 0, 0
        while at < 8 * length:
            at += draw(st.sampled_from([0, 0, 0, 1, 3]))
            room = 8 * length - at
            if room < 1:
                break
            widths = [width for width in (1, 3, 8, 12, 16, 17, 32, 33, 63, 64) if width <= room]
            wide = draw(st.sampled_from([*widths, room]))
            line, extra = draw(signal_lines(f"S{number}_{index}", at, wide, big))
            body += line
            end += extra.replace("{id}", str(can_id))
            at, index = at + wide, index + 1
    return f'VERSION ""\n\nBU_: AI\n{body}\n{end}'


@given(plain_databases(), st.integers(0, 2**32))
@settings(max_examples=60)
def test_any_plain_database_is_decoded_as_cantools_decodes_it(text: str, seed: int) -> None:
    database = cantools.database.load_string(text, "dbc", strict=True)
    assert isinstance(database, Database)
    decoder = Decoder(databases_of([database]))
    frames = random_frames([database], 60, seed)
    assert assert_like_cantools(decoder, frames) > 0
    assert_printed_like_cantools(decoder, frames)


UNUSUAL = """VERSION ""

BU_: AI

BO_ 256 BigEndian: 8 AI
 SG_ Motor : 7|16@0- (0.1,0) [0|0] "Nm" AI
 SG_ Odd : 22|13@0+ (1,-5) [0|0] "" AI

BO_ 257 Multiplexed: 8 AI
 SG_ Which M : 0|8@1+ (1,0) [0|3] "" AI
 SG_ First m0 : 8|16@1- (0.5,0) [0|0] "A" AI
 SG_ Second m1 : 8|8@1+ (1,0) [0|0] "V" AI

BO_ 2566844672 Extended: 8 AI
 SG_ Speed : 24|16@1+ (0.125,0) [0|0] "rpm" AI

BO_ 258 Long: 64 AI
 SG_ Far : 480|32@1- (1,0) [0|0] "" AI
 SG_ Near : 0|9@1- (2,1) [0|0] "" AI

BO_ 259 Half: 4 AI
 SG_ Small : 0|16@1- (1,0) [0|0] "" AI

BO_ 260 Huge: 8 AI
 SG_ Product : 0|64@1+ (1000000,3) [0|0] "" AI

BO_ 262 Wide: 8 AI
 SG_ Product : 0|63@1+ (1000000,3) [0|0] "" AI

BO_ 263 SignedWide: 8 AI
 SG_ Product : 0|64@1- (3,0) [0|0] "" AI

BO_ 261 Empty: 0 AI

BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN",FORMATS,"StandardCAN_FD","ExtendedCAN_FD";
BA_DEF_DEF_ "VFrameFormat" "StandardCAN";
BA_ "VFrameFormat" BO_ 258 14;
""".replace("FORMATS", ",".join(f'"r{number}"' for number in range(2, 14)))


def test_unusual_layouts_are_decoded_right() -> None:
    database = cantools.database.load_string(UNUSUAL, "dbc")
    assert isinstance(database, Database)
    decoder = Decoder(databases_of([database]))
    plain = {layout.name for layout in decoder.databases.layouts.values() if layout.plain}
    assert plain == {"BigEndian", "Extended", "Half", "Empty"}
    chance = random.Random(5)
    frames = []
    for n in range(700):
        message = database.messages[n % len(database.messages)]
        data = bytearray(chance.randbytes(message.length))
        if message.name == "Multiplexed":
            data[0] = chance.choice([0, 1, 1, 0, 7])
        frames.append(LogFrame(n, "can0", message.frame_id, bytes(data), message.is_extended_frame, fd=len(data) > 8))
    columns = frames_of(frames)
    assert assert_like_cantools(decoder, columns) > 700
    assert_printed_like_cantools(decoder, columns)


def test_a_64_bit_number_and_special_floats_keep_every_bit() -> None:
    text = 'VERSION ""\n\nBU_: AI\n'
    text += '\nBO_ 1 U: 8 AI\n SG_ U : 0|64@1+ (1,0) [0|0] "" AI\n'
    text += '\nBO_ 2 I: 8 AI\n SG_ I : 0|64@1- (1,0) [0|0] "" AI\n'
    text += '\nBO_ 3 D: 8 AI\n SG_ D : 0|64@1- (1,0) [0|0] "" AI\n'
    text += '\nBO_ 4 F: 8 AI\n SG_ F : 16|32@1- (0.1,1) [0|0] "" AI\n'
    text += "\nSIG_VALTYPE_ 3 D : 2;\nSIG_VALTYPE_ 4 F : 1;\n"
    database = cantools.database.load_string(text, "dbc")
    assert isinstance(database, Database)
    doubles = [0.0, -0.0, math.inf, -math.inf, math.nan, 5e-324, 0.1, 1e300]
    payloads = [struct.pack("<d", number) for number in doubles] + [
        b"\xff" * 8,
        b"\xff" * 7 + b"\x7f",
        bytes(7) + b"\x80",
    ]
    frames = frames_of([LogFrame(n, "c", can_id, data) for can_id in (1, 2, 3, 4) for n, data in enumerate(payloads)])
    decoder = Decoder(databases_of([database]))
    assert assert_like_cantools(decoder, frames) == 4 * len(payloads)
    assert decoder.tables(frames)["U"].series["U"].values[8] == 2**64 - 1


# ---------------------------------------------------------------- printed


def written_by(texts: Texts) -> list[str]:
    return bytes(lines_of([texts], len(texts.items))).decode().splitlines()


def test_numbers_are_written_as_repr_writes_them() -> None:
    decimals = [
        float(f"{digits}e{power}") for power in range(-325, 309) for digits in ("1", "1.7", "9.999999999999999")
    ]
    borders = np.array([*(2.0**power for power in range(-1074, 1024)), *decimals])
    near = np.concatenate([np.nextafter(borders, way) for way in (-np.inf, np.inf)])
    whole = 2.0**53 + np.arange(-500, 500)
    chance = np.random.default_rng(3)
    any_bits = chance.integers(0, 1 << 64, 10_000, dtype=np.uint64)
    singles = (any_bits & np.uint64(0xFFFF_FFFF)).astype(np.uint32).view(np.float32)
    scaled = np.concatenate([np.arange(0, 65536, 19) * scale for scale in (0.1, 0.001, 3.91, 0.00195313, 1e-7)])
    with np.errstate(invalid="ignore"):  # of signalling NaNs
        floats = np.concatenate([borders, near, whole, any_bits.view(np.float64), singles.astype(np.float64), scaled])
    for numbers in (floats, -floats, any_bits, any_bits.view(np.int64), np.array([0, -(1 << 63)])):
        expected = [*map(repr, numbers.tolist())]
        assert written_by(number_texts(numbers, lambda others: [*map(repr, others)])) == expected


@given(st.lists(st.lists(st.text(st.characters(exclude_characters="\n\0", codec="utf-8"), max_size=40), min_size=6)))
@settings(max_examples=25)
def test_texts_of_any_lengths_stand_beside_each_other(rows: list[list[str]]) -> None:
    rows = [row[:6] for row in rows]
    parts = [part for column in range(6) for part in (texts_of([row[column] for row in rows]), b"," * (column // 2))]
    expected = "".join("".join(t + "," * (n // 2) for n, t in enumerate(row)) + "\n" for row in rows)
    assert bytes(lines_of(parts, len(rows))).decode() == expected


def lines(decoder: Decoder, frames: Frames, **options: bool) -> list[bytearray]:
    """The lines of many frames, each with its line end."""
    return LineWriter(decoder, **options).block(frames).splitlines(keepends=True)


def tails(decoder: Decoder, frames: Frames) -> list[bytes]:
    """What stands beside each frame."""
    found = LineWriter(decoder).tails(frames)
    for line, tail in zip(lines(decoder, frames), found, strict=True):
        assert line.endswith(tail) and tail.startswith(b" :: ")
    return found


def assert_printed_like_cantools(decoder: Decoder, frames: Frames) -> None:
    """The text beside each frame is what `cantools decode --single-line` writes, frame by frame."""
    from cantools.subparsers.__utils__ import format_message  # type: ignore[attr-defined]

    for frame, line in zip(frames, tails(decoder, frames), strict=True):
        layout = decoder.databases.layouts.get(frame.can_id | (EXTENDED_KEY if frame.extended else 0))
        assert layout is not None
        message = decoder.databases.message(layout.key)
        try:
            expected = format_message(message, message.decode_simple(frame.data), True)
        except Exception as error:
            expected = f" {error}"
        assert line.decode() == f" ::{expected}\n"


def test_each_line_of_json_is_one_object_with_cantools_values() -> None:
    decoder = Decoder(load_databases())
    raw = [cantools.database.load_file(dbc_dir() / name) for name in REVISIONS["2026"].dbc_files]
    frames = random_frames(raw, 5_000, 7)  # type: ignore[arg-type]
    for frame, line in zip(frames, lines(decoder, frames, as_json=True), strict=True):
        entry = json.loads(line)
        layout = decoder.databases.layouts.get(frame.can_id)
        assert layout is not None
        words: Any = decoder.databases.message(layout.key).decode(frame.data)
        signals = {name: value if isinstance(value, int | float) else str(value) for name, value in words.items()}
        numberless = {name: None for name, value in signals.items() if value in (math.inf, -math.inf) or value != value}
        assert entry == {
            "t": frame.t_ns / 1e9,
            "channel": frame.channel,
            "id": frame.can_id,
            "extended": False,
            "data": frame.data.hex().upper(),
            "message": layout.name,
            "signals": signals | numberless,
        }


def test_json_stays_valid_for_any_name_and_for_nan_and_infinity() -> None:
    text = 'VERSION ""\n\nBU_: AI\n\nBO_ 1 F: 8 AI\n SG_ F : 0|32@1- (1,0) [0|0] "" AI\n'
    text += ' SG_ W : 32|8@1+ (1,0) [0|0] "" AI\n'
    text += "\nSIG_VALTYPE_ 1 F : 1;\n" + 'VAL_ 1 W 0 "back\\slash, °" ;\n'
    database = cantools.database.load_string(text, "dbc")
    assert isinstance(database, Database)
    frames = [
        LogFrame(n, 'ca"n0', 1, struct.pack("<f", number) + bytes(4))
        for n, number in enumerate([math.nan, math.inf, 1.5])
    ]
    frames += [
        LogFrame(9, 'ca"n0', 1, b"\x00"),
        LogFrame(9, "c", 2, b"\x00"),
        LogFrame(9, "c", 2, extended=True, remote=True, length=4),
        LogFrame(9, "c", 0x44, bytes(8), error=True),
        LogFrame(9, "c", 1, bytes(12), fd=True),
    ]
    written = lines(Decoder(databases_of([database])), frames_of(frames), as_json=True)
    entries = [json.loads(line) for line in written]
    assert [entry["signals"].get("F") for entry in entries[:3]] == [None, None, 1.5]
    assert {entry["signals"]["W"] for entry in entries[:3]} == {"back\\slash, °"}
    assert entries[0]["channel"] == 'ca"n0'
    assert entries[3]["problem"] == "Wrong data size: 1 instead of 8 bytes"
    assert entries[4]["message"] is None
    assert (entries[5]["remote"], entries[5]["extended"]) == (True, True)
    assert entries[6]["error"] == ["controller", "bus-off"]
    assert entries[7]["problem"] == "Wrong data size: 12 instead of 8 bytes"


def test_a_frame_of_wrong_length_is_shown_but_never_counts_whole() -> None:
    decoder = Decoder(load_databases())
    frames = frames_of(
        [LogFrame(0, "c", 0x523, bytes.fromhex(data)) for data in ("640064006400", "6400", "6400640064000000")]
    )
    written = tails(decoder, frames)
    assert written[1] == b" :: Wrong data size: 2 instead of 6 bytes: VCU2AI_Steer(ANGLE: 10.0 deg)\n"
    assert written[2].startswith(b" :: Wrong data size: 8 instead of 6 bytes: VCU2AI_Steer(ANGLE: 10.0 deg, ")
    chosen = tails(Decoder(load_databases().with_signals(["ANGLE"])), frames)
    assert chosen[2] == b" :: Wrong data size: 8 instead of 6 bytes: VCU2AI_Steer(ANGLE: 10.0 deg)\n"
    table = decoder.tables(frames)["VCU2AI_Steer"]
    assert table.rows.tolist() == [0]
    assert table.wrong_length.tolist() == [1, 2]


def test_error_frames_remote_frames_and_unknown_ids_are_named() -> None:
    frames = frames_of(
        [
            LogFrame(0, "c", 0x040, bytes(8), error=True),
            LogFrame(0, "c", 0x004, bytes([0, 0x20, 0, 0, 0, 0, 0, 0]), error=True),
            LogFrame(0, "c", 0x520, remote=True, length=8),
            LogFrame(0, "c", 0x7A1, b"\x01"),
            LogFrame(0, "c", 0x520, b"\x01", extended=True),
        ]
    )
    assert [line.decode() for line in tails(Decoder(load_databases()), frames)] == [
        " :: error frame: bus-off\n",
        " :: error frame: controller (transmit error-passive)\n",
        " :: remote request for VCU2AI_Status\n",
        " :: Unknown frame id 1953 (0x7a1)\n",
        " :: Unknown frame id 1312 (0x520)\n",
    ]


# ---------------------------------------------------------------- databases


def test_of_several_files_the_first_one_counts_for_an_id(tmp_path: Path) -> None:
    first, second = tmp_path / "first.dbc", tmp_path / "second.dbc"
    first.write_text('VERSION ""\n\nBU_: AI\n\nBO_ 1 First: 1 AI\n SG_ A : 0|8@1+ (1,0) [0|0] "" AI\n')
    second.write_text(
        'VERSION ""\n\nBU_: AI\n\nBO_ 1 Second: 1 AI\n SG_ B : 0|8@1+ (1,0) [0|0] "" AI\n'
        '\nBO_ 2 Other: 1 AI\n SG_ C : 0|8@1+ (1,0) [0|0] "" AI\n'
    )
    decoder = Decoder(load_databases([first, second]))
    written = tails(decoder, frames_of([LogFrame(0, "c", can_id, b"\x05") for can_id in (1, 2)]))
    assert written == [b" :: First(A: 5)\n", b" :: Other(C: 5)\n"]


def test_only_an_official_file_has_its_flags_corrected(tmp_path: Path) -> None:
    official, part, team = (tmp_path / name for name in ("official.dbc", "part.dbc", "team.dbc"))
    text = (dbc_dir() / "ads_dv_2026.dbc").read_text(encoding="cp1252")
    text = text.replace("SG_ GO_SIGNAL : 11|1@1+", "SG_ GO_SIGNAL : 11|1@1-")
    official.write_text(text, encoding="cp1252")
    status = re.search(r"BO_ \d+ VCU2AI_Status.*?\n\n", text, re.DOTALL)
    assert status is not None
    part.write_text(f'VERSION ""\n\nBU_: VCU AI\n\n{status[0]}// the state alone\n', encoding="cp1252")
    team.write_text('VERSION ""\n\nBU_: AI\n\nBO_ 1 Team: 1 AI\n SG_ A : 0|1@1- (1,0) [0|0] "" AI\n')
    go = frames_of([LogFrame(0, "c", 0x520, bytes([0, 0x08, 0, 0, 0, 0, 0, 0]))])
    for path in (official, part):
        databases = load_databases([path])
        assert databases.signed_flags == (str(path),)
        assert Decoder(databases).tables(go)["VCU2AI_Status"].series["GO_SIGNAL"].values.tolist() == [1]
        assert databases.decoded(databases.layouts[0x520], bytes([0, 0x08, 0, 0, 0, 0, 0, 0]))["GO_SIGNAL"] == 1
    assert load_databases().signed_flags == load_databases([team]).signed_flags == ()
    flag = frames_of([LogFrame(0, "c", 1, b"\x01")])
    assert Decoder(load_databases([team])).tables(flag)["Team"].series["A"].values.tolist() == [-1]


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("gone.dbc", None, "gone.dbc: cannot be read: No such file or directory"),
        ("bad.dbc", b"\x00\xff garbage", "not a database that cantools can read"),
        ("empty.dbc", b'VERSION ""\n', "describes no message"),
        ("readme.md", b"# hello", "not a database that cantools can read"),
    ],
)
def test_a_database_that_cannot_be_used_is_one_clear_line(
    tmp_path: Path, name: str, content: bytes | None, words: str
) -> None:
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(UserError) as refused:
        load_databases([tmp_path / name])
    assert words in str(refused.value)
    assert "\n" not in str(refused.value)
