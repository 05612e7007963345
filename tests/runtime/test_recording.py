"""A recorded log is a candump log, as every CAN tool reads it."""

from __future__ import annotations

import gc
from pathlib import Path

import can
import pytest

from fsai_vcu.cli.main import main
from fsai_vcu.interface.frames import Frame
from fsai_vcu.runtime.recording import CandumpWriter, candump_line


def test_a_line_is_what_candump_writes() -> None:
    frame = Frame(0x513, bytes.fromhex("9CFF"))
    assert candump_line(frame, "vcan0", 1_436_509_053_850_870_999) == "(1436509053.850870) vcan0 513#9CFF"


def test_python_can_reads_back_what_was_written(tmp_path: Path) -> None:
    frames = [
        Frame(0x520, bytes(range(8)), 1_000_000_000),
        Frame(0x18FF0001, b"\x01", 1_010_000_000, extended=True),
        Frame(0x080, b"", 1_020_000_000),
    ]
    with CandumpWriter(tmp_path / "run.log", "vcan0", offset_ns=5_000_000_000) as writer:
        for frame in frames:
            writer.write(frame)
    with can.LogReader(tmp_path / "run.log") as reader:
        read = list(reader)
    assert [(m.arbitration_id, bytes(m.data), m.is_extended_id) for m in read] == [
        (f.can_id, f.data, f.extended) for f in frames
    ]
    assert [round(m.timestamp, 6) for m in read] == [6.0, 6.01, 6.02]


@pytest.mark.parametrize("seconds", ["nan", "inf", "-1"])
def test_a_time_to_record_that_is_none_is_refused_in_one_line(
    seconds: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = tmp_path / "run.log"
    assert main(["record", "-i", "loopback:record", "-o", str(log), "--seconds", seconds]) == 1
    assert capsys.readouterr().err == f"fsai-vcu record: --seconds is {float(seconds):g}, not a time\n"
    assert not log.exists()


def test_a_log_that_cannot_be_written_is_one_line_and_leaves_no_bus_open(
    capsys: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
    assert main(["record", "-i", "loopback:record", "-o", "/nonexistent/run.log"]) == 1
    assert capsys.readouterr().err == (
        "fsai-vcu record: cannot write /nonexistent/run.log: No such file or directory\n"
    )
    gc.collect()
    assert "not properly shut down" not in caplog.text
