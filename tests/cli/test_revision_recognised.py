"""A log or a bus of another revision than the latest is recognised and reported, by every verb alike."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest
from talking_bus import talking

from fsai_vcu.cli.main import main
from fsai_vcu.interface.frames import Frame

STATUS = "520#0000010000000000"  # OP_STATE is a signal of it in 2026
OF_2021, OF_2026 = "523#0000D2000000", "523#00002C010000"  # ANGLE_MAX is 21 and 30 deg
SAID = "interface revision 2021 (ANGLE_MAX is 21 deg)"


def written(path: Path, *frames: str, times: int = 1) -> str:
    lines = "".join(f"(1.{n * 10_000:06d}) can0 {frame}\n" for n, frame in enumerate(frames))
    path.write_text(lines * times)
    return str(path)


@pytest.mark.parametrize("verb", ["dump", "decode"])
@pytest.mark.parametrize("option", [[], ["--json"]])
def test_a_log_of_2021_is_decoded_as_one_and_reported(
    verb: str, option: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([verb, written(tmp_path / "run.log", STATUS, OF_2021), *option]) == 0
    said = capsys.readouterr()
    assert "OP_STATE" not in said.out and "AS_STATE" in said.out
    assert said.err == f"fsai-vcu {verb}: {SAID}\n"


@pytest.mark.parametrize("verb", ["dump", "decode"])
def test_the_latest_or_a_named_revision_is_not_reported(
    verb: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for argv in (
        [written(tmp_path / "new.log", STATUS, OF_2026)],
        [written(tmp_path / "old.log", STATUS, OF_2021), "--revision", "2026"],
        [written(tmp_path / "dumb.log", STATUS.replace("01", "04"))],
    ):
        assert main([verb, *argv]) == 0
        said = capsys.readouterr()
        assert "OP_STATE" in said.out and said.err == ""


def test_filtered_out_frames_show_the_revision_too(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["dump", written(tmp_path / "run.log", OF_2021, STATUS) + ",520:7FF"]) == 0
    said = capsys.readouterr()
    assert "OP_STATE" not in said.out and SAID in said.err


def test_a_log_is_checked_for_its_revision_before_it_is_split(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    log = tmp_path / "run.log"
    log.write_text(Path(written(log, STATUS, times=120_000)).read_text() + f"(9.000000) can0 {OF_2021}\n")
    assert main(["decode", str(log)]) == 0
    said = capfd.readouterr()
    assert "OP_STATE" not in said.out and said.out.count("\n") == 120_001
    assert said.err == f"fsai-vcu decode: {SAID}\n"


def test_figures_and_tables_are_those_of_the_revision(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = written(tmp_path / "run.log", STATUS, OF_2021)
    assert main(["export", log, "--format", "csv", "-o", str(tmp_path / "tables")]) == 0
    assert "OP_STATE" not in (tmp_path / "tables" / "VCU2AI_Status.csv").read_text()
    assert SAID in capsys.readouterr().err
    assert main(["check", log, "--json"]) == 1
    said = capsys.readouterr()
    bus = next(entry for entry in map(json.loads, said.out.splitlines()) if entry["type"] == "bus")
    assert "AI2LOG_Dynamics1" not in bus["missing"] and bus["missing"]
    assert SAID in said.err


def test_given_databases_decode_frames_of_any_revision(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    own = Path(__file__).parents[2] / "dbc" / "ads_dv_2026.dbc"
    assert main(["decode", written(tmp_path / "run.log", STATUS, OF_2021), "--dbc", str(own)]) == 0
    said = capsys.readouterr()
    assert "OP_STATE" in said.out and said.err == ""


def test_a_live_bus_shows_its_revision_as_it_goes(capsys: pytest.CaptureFixture[str]) -> None:
    name = f"loopback:told-{os.getpid()}"
    with talking(name, Frame(0x523, bytes.fromhex(OF_2021[4:])), Frame(0x520, bytes.fromhex(STATUS[4:]))):
        assert main(["dump", name, "-n", "20"]) == 0
    said = capsys.readouterr()
    assert "OP_STATE" not in said.out and "AS_STATE" in said.out
    assert said.err == f"fsai-vcu dump: {SAID}\n"
