"""The benchmark runs, compares like with like, and leaves figures that a program can read. It judges none of them."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from fsai_hil.bench import (
    REVISION,
    assert_same_values,
    cantools_database,
    car_frames,
    command_values,
    main,
    some_command,
)
from fsai_vcu.interface.codec import Codec, Decoded
from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.revisions import revision


def test_quick_prints_a_table_and_writes_every_figure(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--quick", "-o", str(tmp_path)]) == 0
    found = json.loads((tmp_path / "bench.json").read_text())
    assert found["quick"] is True and found["machine"]["python"] and found["versions"]["cantools"]
    by_name = {each["name"]: each for each in found["results"]}
    compared = ["decode a frame", "encode a frame", "answer a 0x520", "start to a first frame"]
    assert list(by_name) == [*compared, "drive acceleration"]
    for name in compared:
        each = by_name[name]
        for figure in (each["ours"], each["peer"], each["ratio"]):
            assert 0 < figure["least"] <= figure["median"] <= figure["most"]
    assert by_name["drive acceleration"]["ours"]["median"] > 0 and by_name["drive acceleration"]["peer"] is None
    printed = capsys.readouterr().out
    assert all(name in printed for name in by_name)


def test_what_is_compared_has_the_same_values_and_a_difference_would_be_seen() -> None:
    codec, database = Codec(revision(REVISION)), cantools_database()
    frames = car_frames(codec, database, count=5)
    assert {frame.can_id for frame in frames} == set(range(0x520, 0x527))
    assert len({frame.data for frame in frames}) > 20, "the frames hardly differ"
    assert assert_same_values(codec, database, frames) > 150

    class Altered(Codec):
        def decode(self, frame: Frame) -> Decoded:
            return super().decode(Frame(frame.can_id, bytes([frame.data[0] ^ 1, *frame.data[1:]]), frame.t_ns))

    with pytest.raises(AssertionError):
        assert_same_values(Altered(revision(REVISION)), database, frames)


def test_an_encoding_that_differs_from_cantools_is_not_compared() -> None:
    codec, database = Codec(revision(REVISION)), cantools_database()
    frames = list(codec.encode_command(some_command()))
    assert len(command_values(database, frames)) == 5
    frames[0] = Frame(frames[0].can_id, bytes([frames[0].data[0] | 0x80, *frames[0].data[1:]]))  # a bit of no signal
    with pytest.raises(AssertionError, match="0x510 differs"):
        command_values(database, frames)


def test_a_folder_that_cannot_be_made_is_one_clear_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--quick", "-o", "/proc/absent"]) == 1
    assert capsys.readouterr().err == "fsai_hil.bench: /proc/absent: No such file or directory\n"
