"""Exported tables say what `decode` says, in every format, with units, and never more than a frame has."""

from __future__ import annotations

import csv
import json
import math
import random
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader

from fsai_vcu.diagnostics.decode.databases import load_databases
from fsai_vcu.diagnostics.decode.decoder import Decoder
from fsai_vcu.diagnostics.decode.lines import LineWriter
from fsai_vcu.diagnostics.export.writing import export
from fsai_vcu.diagnostics.log.frames import Frames, LogFrame, frames_of

UNUSUAL = """VERSION ""

BU_: ECU

BO_ 1790 Turns: 8 ECU
 SG_ Which M : 0|8@1+ (1,0) [0|0] "" ECU
 SG_ First m0 : 8|16@1+ (0.1,0) [0|0] "V" ECU
 SG_ Second m1 : 8|16@1- (1,0) [0|0] "A" ECU

BO_ 1791 Big: 8 ECU
 SG_ Torque : 7|16@0- (0.5,-10) [0|0] "Nm" ECU
 SG_ Huge : 23|48@0+ (1,0) [0|0] "" ECU

BO_ 1792 Wide: 8 ECU
 SG_ All : 0|64@1+ (1,0) [0|0] "" ECU

BO_ 2566849536 Far: 4 ECU
 SG_ Real : 0|32@1- (1,0) [0|0] "m/s" ECU

SIG_VALTYPE_ 2566849536 Real : 1;
VAL_ 1790 Which 0 "FIRST, ONE" 1 "SECOND" ;
"""

Row = dict[str, Any]


@pytest.fixture(scope="module")
def decoder(tmp_path_factory: pytest.TempPathFactory) -> Decoder:
    """The car's own database, and one with everything unusual in it."""
    path = tmp_path_factory.mktemp("dbc") / "unusual.dbc"
    path.write_text(UNUSUAL)
    own = Path(__file__).parents[2] / "dbc" / "ads_dv_2026.dbc"
    return Decoder(load_databases([own, path]))


@pytest.fixture(scope="module")
def frames(decoder: Decoder) -> Frames:
    """Random payloads of every message, and frames that belong into no table."""
    chance = random.Random(4)
    layouts = list(decoder.databases.layouts.values())
    made = []
    for number in range(3000):
        layout = chance.choice(layouts)
        data = chance.randbytes(layout.length)
        if layout.name == "Turns":
            data = bytes([chance.choice((0, 1, 1, 7))]) + data[1:]
        made.append(
            LogFrame(1_700_000_000_000_000_000 + number * 1_234_000, "can0", layout.can_id, data, layout.extended)
        )
    made[100:100] = [
        LogFrame(made[99].t_ns, "can0", 0x7AB, b"\x01"),
        LogFrame(made[99].t_ns, "can0", 0x523, b"\x01\x02"),
        LogFrame(made[99].t_ns, "can0", 0x40, bytes(8), error=True),
        LogFrame(made[99].t_ns, "can0", 0x523, b"", remote=True, length=6),
    ]
    return frames_of(made)


@pytest.fixture(scope="module")
def decoded(decoder: Decoder, frames: Frames) -> dict[str, list[Row]]:
    """What `decode --json --numbers` says: by message, its frames with time and signals."""
    said: dict[str, list[Row]] = defaultdict(list)
    for line in LineWriter(decoder, as_json=True, words=False).block(frames).splitlines():
        entry = json.loads(line)
        if entry["message"] is not None and "problem" not in entry and "remote" not in entry:
            said[entry["message"]].append({"time": round(entry["t"] * 1e6), **entry["signals"]})
    assert len(said) > 20 and {"Turns", "Big", "Wide", "Far"} <= set(said)
    return said


def same(ours: Row, theirs: Row) -> bool:
    """Equal where decode has a value; nothing where it has none. What JSON cannot say (NaN) is null there."""
    for name, value in ours.items():
        other = theirs.get(name)
        if value is None or (isinstance(value, float) and not math.isfinite(value)):
            if other is not None:
                return False
        elif value != other or isinstance(value, float) != isinstance(other, float):
            return False
    return set(theirs) <= set(ours)


def assert_same(tables: dict[str, list[Row]], decoded: dict[str, list[Row]]) -> None:
    assert set(tables) == set(decoded)
    for name, rows in decoded.items():
        assert len(tables[name]) == len(rows), name
        for ours, theirs in zip(tables[name], rows, strict=True):
            assert same(ours, theirs), (name, ours, theirs)


def of_csv(text: str) -> Any:
    return None if text == "" else float(text) if any(c in text for c in ".en") else int(text)


def test_csv_is_a_file_per_message_with_units_in_the_names(
    tmp_path: Path, decoder: Decoder, frames: Frames, decoded: dict[str, list[Row]]
) -> None:
    written = export(frames, decoder, "csv", tmp_path / "tables")
    assert (written.tables, written.rows) == (len(decoded), sum(map(len, decoded.values())))
    assert written.left_out.startswith("1 of unknown ids, 1 of the wrong length, 2 error or remote frames")
    tables: dict[str, list[Row]] = {}
    for path in (tmp_path / "tables").iterdir():
        with path.open(newline="") as file:
            head, *rows = csv.reader(file)
        names = [name.partition(" [")[0] for name in head]
        tables[path.stem] = [
            {"time": round(float(row[0]) * 1e6), **dict(zip(names[2:], map(of_csv, row[2:]), strict=True))}
            for row in rows
        ]
        if path.stem == "VCU2AI_Steer":
            assert head[2:] == ["ANGLE [deg]", "ANGLE_MAX [deg]", "ANGLE_REQUEST [deg]"]
    assert_same(tables, decoded)


def test_words_stand_for_numbers_where_they_are_asked_for(tmp_path: Path, decoder: Decoder, frames: Frames) -> None:
    export(frames, decoder, "csv", tmp_path / "tables", words=True)
    with (tmp_path / "tables" / "Turns.csv").open(newline="") as file:
        kinds = {row["Which"] for row in csv.DictReader(file)}
    assert kinds == {"FIRST, ONE", "SECOND"}


def test_parquet_has_the_same_values_and_units_in_its_metadata(
    tmp_path: Path, decoder: Decoder, frames: Frames, decoded: dict[str, list[Row]]
) -> None:
    import pyarrow.parquet as pq  # type: ignore[import-untyped]

    export(frames, decoder, "parquet", tmp_path / "tables")
    tables: dict[str, list[Row]] = {}
    for path in (tmp_path / "tables").iterdir():
        table = pq.read_table(path)
        columns = {name: table[name].to_pylist() for name in table.column_names if not name.startswith("time")}
        times = (table["time"].cast("int64").to_numpy() // 1000).tolist()
        tables[path.stem] = [
            {"time": times[row], **{name: values[row] for name, values in columns.items()}}
            for row in range(table.num_rows)
        ]
    assert_same(tables, decoded)
    schema = pq.read_schema(tmp_path / "tables" / "VCU2AI_Status.parquet")
    choices = json.loads(schema.field("AS_STATE").metadata[b"choices"])
    assert choices["3"] == "AS_DRIVING"
    assert pq.read_schema(tmp_path / "tables" / "Big.parquet").field("Torque").metadata[b"unit"] == b"Nm"


def of_mcap(path: Path) -> Iterator[tuple[str, int, Any]]:
    """(topic, time, message) as rosbags' own decoder reads it by the definitions in the file."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.EMPTY)
    with path.open("rb") as file:
        for schema, channel, message in make_reader(file).iter_messages():
            assert schema is not None and (schema.encoding, channel.message_encoding) == ("ros2msg", "cdr")
            if schema.name not in store.fielddefs:
                store.register(get_types_from_msg(schema.data.decode(), schema.name))
            yield channel.topic, message.log_time, store.deserialize_cdr(message.data, schema.name)


def test_mcap_has_a_channel_per_message_with_the_same_values(
    tmp_path: Path, decoder: Decoder, frames: Frames, decoded: dict[str, list[Row]]
) -> None:
    path = tmp_path / "run.mcap"
    export(frames, decoder, "mcap", path)
    found: dict[str, list[Row]] = defaultdict(list)
    for topic, log_ns, message in of_mcap(path):
        assert message.stamp.sec * 1_000_000_000 + message.stamp.nanosec == log_ns
        name = topic.removeprefix("/can0/")
        names = {field.lower(): field for field in decoded[name][0]} | {"first": "First", "second": "Second"}
        values = {names[field]: getattr(message, field) for field in message.__dataclass_fields__ if field in names}
        found[name].append({"time": log_ns // 1000, **values})
    assert set(found) == set(decoded)
    for name, rows in decoded.items():
        assert len(found[name]) == len(rows)
        for ours, theirs in zip(found[name], rows, strict=True):
            for field, value in theirs.items():
                other = ours[field]
                assert other == value or (value is None and not math.isfinite(other)), (name, field, ours, theirs)


def test_mcap_definitions_name_the_units_and_the_words(decoder: Decoder, frames: Frames, tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    export(frames, decoder, "mcap", path)
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None and summary.statistics is not None
    assert summary.statistics.chunk_count > 0
    texts = {schema.name: schema.data.decode() for schema in summary.schemas.values()}
    assert "# ANGLE_MAX, deg\nfloat64 angle_max\n" in texts["fsai_can/msg/VCU2AISteer"]
    assert "int64 AS_STATE_AS_DRIVING=3\n" in texts["fsai_can/msg/VCU2AIStatus"]
    assert texts["fsai_can/msg/VCU2AIStatus"].count("int64 as_state\n") == 1


# ---------------------------------------------------------------- wide


def test_the_wide_table_holds_the_last_value_and_its_age(tmp_path: Path, decoder: Decoder) -> None:
    frames = frames_of(
        [
            LogFrame(1_000_500_000, "can0", 0x523, bytes.fromhex("640000000000")),
            LogFrame(1_010_000_000, "can0", 0x523, bytes.fromhex("C80000000000")),
            LogFrame(1_012_000_000, "can0", 0x6FE, bytes.fromhex("000A00FFFFFFFFFF")),
            LogFrame(1_022_000_000, "can0", 0x6FE, bytes.fromhex("01FEFFFFFFFFFFFF")),
            LogFrame(1_041_000_000, "can0", 0x523, bytes.fromhex("2C0100000000")),
        ]
    )
    path = tmp_path / "wide.csv"
    written = export(frames, decoder, "csv", path, step_ns=10_000_000)
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert written.rows == 5
    assert [row["time [s]"] for row in rows] == ["1.010000", "1.020000", "1.030000", "1.040000", "1.050000"]
    assert [row["VCU2AI_Steer.ANGLE [deg]"] for row in rows] == ["20.0", "20.0", "20.0", "20.0", "30.0"]
    assert [row["VCU2AI_Steer.age [s]"] for row in rows] == ["0.0", "0.01", "0.02", "0.03", "0.009"]
    assert [row["Turns.First [V]"] for row in rows] == ["", "1.0", "1.0", "1.0", "1.0"]
    assert [row["Turns.Second [A]"] for row in rows] == ["", "", "-2", "-2", "-2"]
    assert [row["Turns.age [s]"] for row in rows] == ["", "0.008", "0.008", "0.018", "0.028"]


def test_every_cell_of_the_wide_table_is_the_last_frames_value(
    tmp_path: Path, decoder: Decoder, frames: Frames, decoded: dict[str, list[Row]]
) -> None:
    path = tmp_path / "wide.csv"
    export(frames, decoder, "csv", path, step_ns=7_000_000)
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) > 400
    for name in ("VCU2AI_Steer", "VCU2AI_Status", "Big", "Wide"):
        times = [row["time"] for row in decoded[name]]
        for row in rows:
            newest = int(np.searchsorted(times, round(float(row["time [s]"]) * 1e6), side="right")) - 1
            for key, text in row.items():
                message, _, signal = key.partition(".")
                signal = signal.partition(" [")[0]
                if message == name and signal != "age":
                    assert of_csv(text) == (None if newest < 0 else decoded[name][newest][signal])


def test_a_long_silence_or_a_clock_jump_makes_no_endless_table(tmp_path: Path, decoder: Decoder) -> None:
    steer = bytes(6)
    frames = frames_of(
        [
            LogFrame(1_000_000_000, "can0", 0x523, steer),
            LogFrame(1_100_000_000, "can0", 0x523, steer),
            LogFrame(1_700_000_000_000_000_000, "can0", 0x523, steer),
            LogFrame(1_699_999_999_900_000_000, "can0", 0x523, steer),
        ]
    )
    written = export(frames, decoder, "csv", tmp_path / "wide.csv", step_ns=10_000_000)
    assert written.rows == 22
    assert written.notes == (
        "time goes back in the log, by up to 0.100 s: the rows are sorted by time",
        "no rows for 1 silences of more than a minute",
    )


def test_the_wide_table_is_the_same_in_parquet_and_mcap(tmp_path: Path, decoder: Decoder, frames: Frames) -> None:
    import pyarrow.parquet as pq

    export(frames, decoder, "csv", tmp_path / "wide.csv", step_ns=10_000_000)
    export(frames, decoder, "parquet", tmp_path / "wide.parquet", step_ns=10_000_000)
    export(frames, decoder, "mcap", tmp_path / "wide.mcap", step_ns=10_000_000)
    with (tmp_path / "wide.csv").open(newline="") as file:
        texts = list(csv.DictReader(file))
    table = pq.read_table(tmp_path / "wide.parquet")
    angles = [of_csv(row["VCU2AI_Steer.ANGLE [deg]"]) for row in texts]
    assert table["VCU2AI_Steer.ANGLE"].to_pylist() == angles
    messages = [message for _, _, message in of_mcap(tmp_path / "wide.mcap")]
    assert [None if math.isnan(m.vcu2ai_steer_angle) else m.vcu2ai_steer_angle for m in messages] == angles


# ---------------------------------------------------------------- several buses, and MF4


def test_several_buses_have_tables_of_their_own(tmp_path: Path, decoder: Decoder) -> None:
    frames = frames_of(
        [LogFrame(1_000_000_000, "can0", 0x523, bytes(6)), LogFrame(1_010_000_000, "can1", 0x523, b"\x64" + bytes(5))]
    )
    export(frames, decoder, "csv", tmp_path / "tables")
    assert sorted(path.name for path in (tmp_path / "tables").iterdir()) == [
        "can0.VCU2AI_Steer.csv",
        "can1.VCU2AI_Steer.csv",
    ]
    export(frames, decoder, "mcap", tmp_path / "run.mcap")
    assert {topic for topic, _, _ in of_mcap(tmp_path / "run.mcap")} == {"/can0/VCU2AI_Steer", "/can1/VCU2AI_Steer"}
    export(frames, decoder, "csv", tmp_path / "wide.csv", step_ns=10_000_000)
    with (tmp_path / "wide.csv").open(newline="") as file:
        last = list(csv.DictReader(file))[-1]
    assert (last["can0.VCU2AI_Steer.ANGLE [deg]"], last["can1.VCU2AI_Steer.ANGLE [deg]"]) == ("0.0", "10.0")


def test_mf4_has_a_group_per_message(
    tmp_path: Path, decoder: Decoder, frames: Frames, decoded: dict[str, list[Row]]
) -> None:
    import asammdf  # slow to import

    path = tmp_path / "run.mf4"
    export(frames, decoder, "mf4", path)
    with asammdf.MDF(path) as mdf:
        groups = {group.channel_group.acq_name: number for number, group in enumerate(mdf.groups)}
        with_signals = {name: rows for name, rows in decoded.items() if len(rows[0]) > 1}
        assert set(groups) == set(with_signals)
        for name, rows in with_signals.items():
            for signal in rows[0]:
                if signal == "time":
                    continue
                found = mdf.get(signal, group=groups[name], raw=True, ignore_invalidation_bits=True)
                absent = found.invalidation_bits
                assert len(found.samples) == len(rows)
                for at, row in enumerate(rows):
                    if absent is not None and absent[at]:
                        assert signal not in row
                    elif row.get(signal) is not None:
                        assert found.samples[at] == row[signal], (name, signal)
                shown = [round((mdf.header.abs_time / 1e9 + t) * 1e6) for t in found.timestamps[:5]]
                assert shown == pytest.approx([row["time"] for row in rows[:5]], abs=1)
        assert mdf.get("ANGLE", group=groups["VCU2AI_Steer"]).unit == "deg"


def test_integers_beyond_64_bits_are_texts_in_mf4(tmp_path: Path) -> None:
    import asammdf  # slow to import

    (tmp_path / "x.dbc").write_text(
        'VERSION ""\nBU_: A\nBO_ 1 M: 8 A\n SG_ S : 0|64@1+ (1000000000000000000000000000,0) [0|0] "" A\n\n'
    )
    frames = frames_of([LogFrame(n * 1_000_000, "can0", 1, b"\xff" * 8) for n in range(1, 4)])
    export(frames, Decoder(load_databases([tmp_path / "x.dbc"])), "mf4", tmp_path / "run.mf4")
    with asammdf.MDF(tmp_path / "run.mf4") as mdf:
        assert mdf.get("S").samples.tolist() == [str((2**64 - 1) * 10**27).encode()] * 3
