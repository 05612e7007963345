"""`fsai-vcu export`: what a person gets, also of broken input; and never half a file."""

from __future__ import annotations

import csv
import os
import resource
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from fsai_vcu.cli.main import main
from fsai_vcu.diagnostics.export.writing import NEEDS

GOOD = "(1.000000) can0 523#640064006400\n"


@pytest.fixture
def log(tmp_path: Path) -> Path:
    path = tmp_path / "run.log"
    path.write_text(GOOD * 3)
    return path


def columns(path: Path) -> list[list[str]]:
    with path.open(newline="") as file:
        return list(csv.reader(file))


def test_tables_are_written_and_counted(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = log.with_name("tables")
    assert main(["export", str(log), "--format", "csv", "-o", str(out)]) == 0
    assert capsys.readouterr().err == f"1 table, 3 rows of 3 frames in {out}\n"
    assert columns(out / "VCU2AI_Steer.csv")[1] == ["1.000000", "0.000000", "10.0", "10.0", "10.0"]


def test_times_count_from_the_logs_first_frame_in_every_format(log: Path) -> None:
    """As explain and report count, whatever part is exported; the time in the log is beside it."""
    import asammdf  # slow to import
    import pyarrow.parquet as pq  # type: ignore[import-untyped]

    log.write_text("(5.250000) can0 514#0000\n(6.000000) can0 523#640064006400\n(7.500000) can0 523#640064006400\n")
    for form, name in (("csv", "tables"), ("parquet", "frames"), ("mf4", "run.mf4")):
        assert main(["export", str(log), "--from", "1", "--format", form, "-o", str(log.with_name(name))]) == 0
    head, row = columns(log.with_name("tables") / "VCU2AI_Steer.csv")
    assert head[:2] == ["time [s]", "time since first frame [s]"]
    assert row[:2] == ["7.500000", "2.250000"]
    table = pq.read_table(log.with_name("frames") / "VCU2AI_Steer.parquet")
    assert table["time since first frame"].to_pylist() == [2.25]
    assert table.schema.field("time since first frame").metadata == {b"unit": b"s"}
    with asammdf.MDF(log.with_name("run.mf4")) as mdf:
        assert mdf.get("ANGLE").timestamps.tolist() == [2.25]


def test_times_before_the_first_frame_are_below_zero(log: Path) -> None:
    log.write_text("(5.250000) can0 523#640064006400\n(5.000000) can0 523#640064006400\n")
    assert main(["export", str(log), "--format", "csv", "-o", str(log.with_name("tables"))]) == 0
    rows = columns(log.with_name("tables") / "VCU2AI_Steer.csv")[1:]
    assert [row[:2] for row in rows] == [["5.250000", "0.000000"], ["5.000000", "-0.250000"]]


def test_a_csv_file_is_one_wide_table_without_being_asked(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = log.with_name("run.csv")
    assert main(["export", str(log), "-o", str(path), "--raster", "20ms"]) == 0
    assert capsys.readouterr().err == f"1 table, 1 rows (one every 20ms) of 3 frames in {path}\n"
    assert columns(path)[0][2] == "VCU2AI_Steer.ANGLE [deg]"


def test_filters_leave_frames_out_and_other_databases_are_used(log: Path, tmp_path: Path) -> None:
    log.write_text(GOOD + "(1.100000) can0 520#0000030000000000\n")
    other = tmp_path / "team.dbc"
    other.write_text('VERSION ""\n\nBU_: AI\n\nBO_ 1315 Ours: 6 AI\n SG_ A : 0|8@1+ (1,0) [0|0] "" AI\n')
    out = tmp_path / "tables"
    own = Path(__file__).parents[2] / "dbc" / "ads_dv_2026.dbc"
    databases = ["--dbc", str(other), "--dbc", str(own)]
    assert main(["export", f"{log},523:7FF", "--format", "csv", "-o", str(out), *databases]) == 0
    assert [path.name for path in out.iterdir()] == ["Ours.csv"]


def test_the_former_names_of_format_and_end_work_and_say_the_new(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log.write_text(GOOD + GOOD.replace("1.0", "3.0", 1))
    out = log.with_name("former")
    assert main(["export", str(log), "--to", "csv", "--until", "1", "-o", str(out)]) == 0
    assert capsys.readouterr().err.splitlines()[:2] == [
        "fsai-vcu export: --to is now called --format",
        "fsai-vcu export: --until is now called --to",
    ]
    assert len(columns(out / "VCU2AI_Steer.csv")) == 2


def test_a_broken_log_is_exported_up_to_the_break_and_fails(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log.write_bytes(b"".join([GOOD.encode(), b"\xff\x00\xfe\n" * 7, GOOD.encode(), GOOD[:-3].encode()]))
    out = log.with_name("tables")
    assert main(["export", str(log), "--format", "csv", "-o", str(out)]) == 1
    lines = capsys.readouterr().err.splitlines()
    assert lines[0] == f"fsai-vcu export: {log}: line 2: not text: '\\xff\\x00\\xfe'"
    assert lines[-1] == f"1 table, 2 rows of 2 frames in {out}"
    assert len(columns(out / "VCU2AI_Steer.csv")) == 3


def test_segments_of_a_recording_are_one_log(log: Path) -> None:
    second = log.with_name("second.log")
    second.write_text("(2.000000) can1 523#000000000000\n(3.000000) can0 523#C80064006400\n")
    out = log.with_name("wide.csv")
    argv = ["export", str(log), str(second), "--format", "csv", "-o", str(out), "--wide", "--raster", "1s"]
    assert main(argv) == 0
    rows = columns(out)
    assert rows[0][2] == "can0.VCU2AI_Steer.ANGLE [deg]"
    assert [row[2] for row in rows[1:]] == ["10.0", "10.0", "20.0"]


def test_what_is_there_is_not_mixed_with_what_is_new(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = log.with_name("tables")
    assert main(["export", str(log), "--format", "csv", "-o", str(out)]) == 0
    assert main(["export", str(log), "--format", "csv", "-o", str(out)]) == 1
    assert "is a folder with something in it already; name a new folder" in capsys.readouterr().err
    assert main(["export", str(log), "--format", "mcap", "-o", str(out)]) == 1
    assert capsys.readouterr().err.endswith("is a folder; name a file\n")


def only_so_large() -> None:
    resource.setrlimit(resource.RLIMIT_FSIZE, (10_000, 10_000))


def test_a_file_that_cannot_be_finished_leaves_nothing_behind(log: Path) -> None:
    log.write_text(GOOD * 20_000)
    out = log.with_name("wide.csv")
    out.write_text("what was there before")
    argv = ["-m", "fsai_vcu.cli.main", "export", str(log), "--format", "csv", "--wide", "-o", str(out)]
    for extra, form in ((["--raster", "100us"], "csv"), ([], "mcap")):
        log.write_text("".join(f"({1 + n / 1000:.6f}) can0 523#{n & 0xFF:02X}0064006400\n" for n in range(3000)))
        command = [sys.executable, *[form if word == "csv" else word for word in argv], *extra]
        done = subprocess.run(command, stderr=subprocess.PIPE, text=True, preexec_fn=only_so_large)
        assert done.returncode == 1
        assert done.stderr == f"fsai-vcu export: cannot write {out}: File too large\n"
        assert out.read_text() == "what was there before"
        assert {path.name for path in log.parent.iterdir()} == {"run.log", "wide.csv"}


def test_ctrl_c_leaves_nothing_behind(tmp_path: Path) -> None:
    out = tmp_path / "tables"
    process = subprocess.Popen(
        [sys.executable, "-m", "fsai_vcu.cli.main", "export", "-", "--format", "csv", "-o", str(out)],
        stdin=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stdin is not None and process.stderr is not None
    process.stdin.write(GOOD * 100_000)  # more than a pipe holds: when this returns, it is being read
    process.send_signal(signal.SIGINT)
    assert process.wait(60.0) == 130
    assert process.stderr.read() == "fsai-vcu export: interrupted\n"
    assert list(tmp_path.iterdir()) == []
    process.stdin.close()
    process.stderr.close()


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_who_ends_an_export_finds_nothing_half_made(
    number: signal.Signals, log: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def ended(*_: object, **__: object) -> None:
        os.kill(os.getpid(), number)
        raise AssertionError("went on")

    monkeypatch.setattr("fsai_vcu.diagnostics.export.writing.Tables", ended)
    monkeypatch.setattr(signal, "getsignal", lambda _: signal.SIG_DFL)
    before = signal.signal(number, lambda *_: None)  # that would end pytest
    try:
        assert main(["export", str(log), "--format", "csv", "-o", str(log.with_name("tables"))]) == 130
        assert signal.signal(number, signal.SIG_DFL) == signal.SIG_DFL, "as it was taken to be"
    finally:
        signal.signal(number, before)
    assert capsys.readouterr().err == "fsai-vcu export: interrupted\n" and list(log.parent.iterdir()) == [log]


@pytest.mark.parametrize("name", ["-rf", "N" * 300, "ü" * 300])
def test_a_table_of_any_name_has_a_file_of_its_own(name: str, log: Path) -> None:
    dbc, out = log.with_name("x.dbc"), log.with_name("tables")
    dbc.write_text(
        'VERSION ""\n\nBU_: A\n\nBO_ 1315 M: 6 A\n SG_ S : 0|16@1+ (1,0) [0|0] "" A\n\n'
        'BA_DEF_ BO_ "SystemMessageLongSymbol" STRING ;\nBA_DEF_DEF_ "SystemMessageLongSymbol" "";\n'
        f'BA_ "SystemMessageLongSymbol" BO_ 1315 "{name}";\n',
        encoding="cp1252",
    )
    assert main(["export", str(log), "--dbc", str(dbc), "--format", "csv", "-o", str(out)]) == 0
    (made,) = out.iterdir()
    assert made.name[0] != "-" and made.stem in name


@pytest.mark.parametrize(("form", "package"), [("parquet", "pyarrow"), ("mcap", "mcap"), ("mf4", "asammdf")])
def test_a_missing_extra_is_the_line_that_installs_it(
    form: str, package: str, log: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, package, None)
    assert main(["export", str(log), "--format", form, "-o", str(log.with_name("out"))]) == 1
    assert capsys.readouterr().err == (f"fsai-vcu export: {form} needs {package}: pip install 'fsai-vcu[{form}]'\n")
    assert not log.with_name("out").exists()


def test_a_pipe_or_a_device_is_not_replaced(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pipe = log.with_name("pipe")
    os.mkfifo(pipe)
    assert main(["export", str(log), "--format", "csv", "--wide", "-o", str(pipe)]) == 1
    assert f"{pipe} is a device or a pipe" in capsys.readouterr().err
    assert pipe.is_fifo()


@pytest.mark.parametrize("target", ["victim.csv", "nowhere/out.csv", "link.csv"])
def test_a_link_is_neither_followed_nor_replaced(log: Path, capsys: pytest.CaptureFixture[str], target: str) -> None:
    link, victim = log.with_name("link.csv"), log.with_name("victim.csv")
    victim.write_text("of somebody else")
    link.symlink_to(target)
    assert main(["export", str(log), "--wide", "-o", str(link)]) == 1
    assert f"{link} is a link" in capsys.readouterr().err
    assert link.is_symlink() and victim.read_text() == "of somebody else"


@pytest.mark.parametrize("form", ["csv", "parquet", "mcap", "mf4"])
def test_a_file_may_have_any_name_its_system_has(log: Path, form: str) -> None:
    pytest.importorskip(NEEDS.get(form, "numpy"), reason=f"not installed: pip install 'fsai-vcu[{form}]'")
    out = log.with_name("o\udcff")
    assert main(["export", str(log), "--format", form, "-o", str(out)]) == 0
    assert out.exists()


def test_words_are_for_tables_that_have_only_one_of_both(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["export", str(log), "--format", "mcap", "--words", "-o", str(log.with_name("out"))]) == 2
    assert "--words does not go with mcap" in capsys.readouterr().err


@pytest.mark.parametrize("kind", ["csv", "parquet", "mcap"])
def test_only_the_signals_asked_for_are_exported(log: Path, kind: str, capsys: pytest.CaptureFixture[str]) -> None:
    log.write_text(GOOD + "(1.100000) can0 520#0000030000000000\n")
    out = log.with_name(f"tables.{kind}")
    assert main(["export", str(log), "--format", kind, "-o", str(out), "--signals", "ANGLE"]) == 0
    assert capsys.readouterr().err.startswith("1 table, 1 rows of 1 frames")
    if kind == "csv":
        assert columns(out / "VCU2AI_Steer.csv")[0][2:] == ["ANGLE [deg]"]
