"""`fsai-vcu decode`: what a person or a script gets, also of broken input."""

from __future__ import annotations

import json
import os
import random
import re
import subprocess
import sys
import threading
from pathlib import Path
from threading import Thread

import pytest

from fsai_vcu.cli.main import main
from fsai_vcu.diagnostics.decode.databases import load_databases
from fsai_vcu.diagnostics.log import reader
from fsai_vcu.interface.revisions import dbc_dir

GOOD = "(1.000000) can0 523#640064006400\n"
LINE = (
    "(1.000000) can0 523#640064006400 :: VCU2AI_Steer(ANGLE: 10.0 deg, ANGLE_MAX: 10.0 deg, ANGLE_REQUEST: 10.0 deg)\n"
)


@pytest.fixture
def log(tmp_path: Path) -> Path:
    path = tmp_path / "run.log"
    path.write_text(GOOD * 3)
    return path


def test_each_frame_is_one_line_as_cantools_writes_it(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["decode", str(log)]) == 0
    assert capsys.readouterr().out == LINE * 3


@pytest.fixture
def small_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Logs are read in blocks of 64 KiB, so that a short one has several."""
    monkeypatch.setattr(reader, "_BLOCK_BYTES", 1 << 16)


@pytest.mark.usefixtures("small_blocks")
def test_a_long_log_is_decoded_like_many_short_ones(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    chance = random.Random(3)
    ids = [layout.can_id for layout in load_databases().layouts.values()]
    lines = [
        f"({n / 1000:.6f}) can{n % 2} {chance.choice(ids):03X}#{chance.randbytes(chance.randint(0, 8)).hex().upper()}\n"
        for n in range(2_500)  # the second block begins at about 1_800
    ]
    lines[500] = lines[2_400] = "garbage\n"
    whole, part = tmp_path / "whole.log", tmp_path / "part.log"
    whole.write_text("".join(lines))
    assert main(["decode", str(whole), "--revision", "2026"]) == 1
    found = capsys.readouterr()
    assert re.findall(r"line (\d+)", found.err) == ["501", "2401"]
    shown = found.out.splitlines()
    assert len(shown) == 2_498
    for at in (0, 500, 1_500, 1_898):  # of the log; behind what is no frame one line further in what is printed
        part.write_text("".join(lines[at + 1 : at + 500]))
        assert main(["decode", str(part), "--revision", "2026"]) == 0
        first = at + 1 - sum(bad <= at for bad in (500, 2_400))
        assert capsys.readouterr().out.splitlines() == shown[first : first + 499]


def test_filters_choose_frames_as_for_dump(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log.write_text(GOOD + "(1.100000) can0 520#0000030000000000\n")
    assert main(["decode", f"{log},523:7FF"]) == 0
    assert capsys.readouterr().out == LINE


def test_numbers_stand_for_words_where_they_are_asked_for(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "run.log"
    path.write_text("(1.000000) can0 520#0000030000000000\n")
    assert main(["decode", str(path), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["signals"]["AS_STATE"] == "AS_DRIVING"
    assert main(["decode", str(path), "--json", "--numbers"]) == 0
    assert json.loads(capsys.readouterr().out)["signals"]["AS_STATE"] == 3


def test_a_named_revision_or_database_is_used(tmp_path: Path, log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    other = tmp_path / "team.dbc"
    other.write_text('VERSION ""\n\nBU_: AI\n\nBO_ 1315 Ours: 6 AI\n SG_ A : 0|8@1+ (1,0) [0|0] "" AI\n')
    assert main(["decode", str(log), "--dbc", str(other)]) == 0
    assert ":: Ours(A: 100)\n" in capsys.readouterr().out
    assert main(["decode", str(log), "--revision", "2021"]) == 0
    assert "VCU2AI_Steer" in capsys.readouterr().out


def test_signed_flags_of_an_official_file_are_said_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log, official = tmp_path / "run.log", tmp_path / "official.dbc"
    log.write_text("(1.000000) can0 520#0008030000000000\n" * 3)
    text = (dbc_dir() / "ads_dv_2026.dbc").read_text(encoding="cp1252")
    official.write_text(text.replace("SG_ GO_SIGNAL : 11|1@1+", "SG_ GO_SIGNAL : 11|1@1-"), encoding="cp1252")
    assert main(["decode", str(log), "--dbc", str(official), "--numbers", "--json"]) == 0
    said = capsys.readouterr()
    assert said.out.count('"GO_SIGNAL":1,') == 3
    assert said.err == f"fsai-vcu decode: {official}: one-bit flags, signed there, are read as 0 and 1\n"


def test_a_broken_log_is_decoded_up_to_the_break_and_fails(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "run.log"
    path.write_bytes(b"".join([GOOD.encode(), b"\xff\x00\xfe\n" * 7, GOOD.encode(), GOOD[:-3].encode()]))
    assert main(["decode", str(path)]) == 1
    said = capsys.readouterr()
    assert said.out == LINE * 2
    lines = said.err.splitlines()
    assert lines[0] == f"fsai-vcu decode: {path}: line 2: not text: '\\xff\\x00\\xfe'"
    assert lines[-1] == f"fsai-vcu decode: {path}: 3 more lines or frames that cannot be read"
    assert len(lines) == 6


def test_each_line_of_a_pipe_is_shown_before_the_next_one() -> None:
    process = subprocess.Popen(
        [sys.executable, "-m", "fsai_vcu.cli.main", "decode", "-"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdin is not None and process.stdout is not None
    giving_up = threading.Timer(180.0, process.kill)
    giving_up.start()
    try:
        for _ in range(3):
            process.stdin.write(GOOD)
            process.stdin.flush()
            assert process.stdout.readline() == LINE
        process.stdin.close()
        assert process.wait() == 0
    finally:
        giving_up.cancel()
        process.kill()
        process.stdout.close()


def test_a_pipe_is_read_to_its_end(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pipe = tmp_path / "run.log"
    os.mkfifo(pipe)
    text = "".join(f"({1000 + n / 1000:.6f}) can0 513#3200\n" for n in range(20_000))
    writer = Thread(target=pipe.write_text, args=(text,))
    writer.start()
    assert main(["decode", str(pipe)]) == 0
    writer.join()
    assert capsys.readouterr().out.count("\n") == 20_000


@pytest.mark.usefixtures("small_blocks")
def test_a_part_of_a_log_of_many_blocks_is_that_part(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = tmp_path / "run.log"
    log.write_text("".join(f"({1000 + n / 1000:.6f}) can0 513#3200\n" for n in range(10_000)))
    assert main(["decode", str(log), "--from", "9", "--to", "9.002"]) == 0
    stamps = [line.split()[0] for line in capsys.readouterr().out.splitlines()]
    assert stamps == ["(1009.000000)", "(1009.001000)", "(1009.002000)"]


def test_a_folder_is_one_log_in_the_order_of_time(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for number in (10, 2):
        (tmp_path / f"run_{number}.log").write_text(f"({number}.000000) can0 513#3200\n")
    assert main(["decode", str(tmp_path)]) == 0
    stamps = [line.split()[0] for line in capsys.readouterr().out.splitlines()]
    assert stamps == ["(2.000000)", "(10.000000)"]


def test_signals_by_pattern_leave_the_others_out(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log.write_text(GOOD + "(1.100000) can0 520#0000030000000000\n")
    assert main(["decode", str(log), "--signals", "angle,VCU2AI_Steer.*_MAX"]) == 0
    shown = "VCU2AI_Steer(ANGLE: 10.0 deg, ANGLE_MAX: 10.0 deg)"
    assert capsys.readouterr().out == f"(1.000000) can0 523#640064006400 :: {shown}\n"


def test_decode_and_dump_are_one_program(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = tmp_path / "run.log"
    log.write_text("(1.000000) can0 513#0A00\n(1.100000) can0 513#0A00\n(1.200000) can0 513#0000\n")

    def shown(*words: str) -> list[str]:
        assert main([*words, str(log)]) == 0
        return capsys.readouterr().out.splitlines()

    assert [line.partition(" ")[0] for line in shown("decode", "--changes")] == ["(1.000000)", "(1.200000)"]
    assert len(shown("decode", "-n", "1")) == 1
    for style in (["-t", "z"], ["--short", "-c"], ["--no-signals"]):
        signals = [] if style == ["--no-signals"] else ["--signals", "*"]
        assert shown("decode", *style) == shown("dump", "-L", *signals, *style)
