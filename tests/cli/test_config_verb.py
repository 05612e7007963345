"""The configuration as a person asks for it: is it right, what does it come to, what does another program need."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from fsai_vcu.cli.main import main


@pytest.fixture
def file(tmp_path: Path) -> Path:
    (tmp_path / "limits.toml").write_text("max_speed_mps = 3.5\n")
    path = tmp_path / "fsai.toml"
    path.write_text(f'[can]\nrevision = "2021"\n[limits]\nfile = "{tmp_path}/limits.toml"\n[ros]\ndomain_id = 7\n')
    return path


def test_a_valid_file_is_confirmed_with_its_limits(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["config", "check", str(file)]) == 0
    shown = capsys.readouterr().out.splitlines()
    assert shown[:2] == [f"{file}: right", "operational limits: max_speed_mps = 3.5"]


def test_each_problem_of_a_file_is_one_line_with_its_place(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file.write_text('[can]\nrevison = "2021"\n[ros]\ndomain_id = 400\n')
    assert main(["config", "check", str(file)]) == 1
    said = capsys.readouterr()
    assert [line.partition(":")[0] for line in said.err.splitlines()] == [f"{file}, line 2", f"{file}, line 4"]
    assert said.out == ""
    for arguments in ([str(file), "--json"], ["--json", str(file)]):
        assert main(["config", "check", *arguments]) == 1
        answer = json.loads(capsys.readouterr().out)
        assert answer["right"] is False and len(answer["problems"]) == 2


def test_effective_values_include_defaults_and_node_parameters(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["config", "show", str(file)]) == 0
    shown = capsys.readouterr().out
    assert '[can] revision = "2021"' in shown and '[can] interface = "' in shown
    assert "parameters of vcu_bridge:" in shown and '  revision: "2021"' in shown


def test_without_a_file_the_defaults_are_shown_and_called_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("fsai_vcu.cli.config.USUAL_PATH", tmp_path / "absent.toml")
    assert main(["config", "show"]) == 0
    said = capsys.readouterr()
    assert said.err == f"fsai-vcu config: {tmp_path}/absent.toml is not there: these are the defaults\n"
    assert "[can] revision = " in said.out
    for argv in (["check"], ["environment"], ["show", str(tmp_path / "absent.toml")]):
        assert main(["config", *argv]) == 1, "nothing is taken for a file that must be there"


def test_the_ros_environment_is_printed_as_systemd_reads_it(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["config", "environment", str(file)]) == 0
    lines = dict(line.split("=", 1) for line in capsys.readouterr().out.splitlines())
    assert lines["ROS_DOMAIN_ID"] == "7"
    assert Path(lines["FASTRTPS_DEFAULT_PROFILES_FILE"]).is_file(), "the loopback alone"
    assert not any(" " in value or '"' in value for value in lines.values())
