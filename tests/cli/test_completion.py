"""`fsai-vcu completion`: what a shell offers is what the parsers take."""

from __future__ import annotations

import argparse
import os
import pty
import re
import select
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest

from fsai_vcu.cli.main import all_verbs, main, parser_of
from fsai_vcu.interface.enums import Ami

MISSIONS = sorted(ami.name.lower() for ami in Ami if ami is not Ami.NOT_SELECTED)
WITHIN_S = 90.0


def script(shell: str, folder: Path, capsys: pytest.CaptureFixture[str]) -> Path:
    assert main(["completion", shell]) == 0
    path = folder / f"completion.{shell}"
    path.write_text(capsys.readouterr().out)
    return path


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name in ("run.log", "run two.log", "old.dbc"):
        (tmp_path / name).touch()
    (tmp_path / "runs").mkdir()
    return tmp_path


def offered(script: Path, *lines: str, folder: Path = Path("/")) -> list[list[str]]:
    """What bash offers for each line with the cursor at its end."""
    asked = [f"source {script}", "compopt() { :; }"]
    for line in lines:
        words = re.findall(r"=|[^\s=]+", line) + ([""] if line.endswith(" ") else [])  # as readline breaks them
        asked += [f"COMP_WORDS=({' '.join(map(repr, words))}); COMP_CWORD={len(words) - 1}; _fsai_vcu"]
        asked += ["printf '%s\\n' \"${COMPREPLY[@]}\" =="]
    argv = ["bash", "--noprofile", "--norc", "-c", "\n".join(asked)]
    done = subprocess.run(argv, capture_output=True, text=True, cwd=folder, check=True)
    assert done.stderr == ""
    return [sorted(filter(None, part.splitlines())) for part in done.stdout.split("==\n")[:-1]]


def test_all_verbs_and_all_their_options_are_offered(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    verbs = all_verbs()
    found = offered(script("bash", tmp_path, capsys), "fsai-vcu ", *(f"fsai-vcu {verb} -" for verb in verbs))
    shown = [[action for action in parser_of(verb)._actions if action.help is not argparse.SUPPRESS] for verb in verbs]
    options = [sorted(name for action in actions for name in action.option_strings) for actions in shown]
    assert found == [sorted(verbs), *options]


def test_values_are_offered_where_they_belong(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    logs = ["run two.log", "run.log", "runs"]
    expected = {
        "--": ["--help", "--version"],
        "drive --mission ": MISSIONS,
        "drive --laps 2 --mission a": [mission for mission in MISSIONS if mission.startswith("a")],
        "drive --mission=track": ["trackdrive"],
        "drive --mission=": MISSIONS,
        "drive --laps ": [],
        "explain run.log --revision ": ["2021", "2026"],
        "mode ": ["autonomous", "manual"],
        "mode manual ": [],
        "send --count 3 can0 AI2VCU_B": ["AI2VCU_Brake"],
        "explain ru": logs,
        "replay run.log ": ["old.dbc", *logs],
        "dump run.log run": logs,
        "dump --dbc ol": ["old.dbc"],
        "hil --results ru": ["runs"],
        "vcu -i nosuch": [],
    }
    path = script("bash", folder.parent, capsys)
    found = offered(path, *(f"fsai-vcu {line}" for line in expected), folder=folder)
    assert dict(zip(expected, found, strict=True)) == expected


def test_a_tab_in_a_real_bash_completes(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = script("bash", folder.parent, capsys)
    master, slave = pty.openpty()
    environment = {**os.environ, "TERM": "dumb", "INPUTRC": "/dev/null", "HISTFILE": "", "PS1": "ready> "}
    argv = ["bash", "--noprofile", "--norc", "-i"]
    bash = subprocess.Popen(
        argv, stdin=slave, stdout=slave, stderr=slave, cwd=folder, env=environment, start_new_session=True
    )
    os.close(slave)
    typed = (
        (f"source {path}; echo rea''dy\n", "\nready"),
        ("fsai-vcu emer\t", "fsai-vcu emergency-brake "),
        ("\x15fsai-vcu explain run\\ t\t", "fsai-vcu explain run\\ two.log "),  # ^U: begin the line again
        ("\x15fsai-vcu drive --mission=track\t", "fsai-vcu drive --mission=trackdrive "),
    )
    try:
        for text, shown in typed:
            os.write(master, text.encode())
            seen, until_s = "", time.monotonic() + WITHIN_S
            while shown not in seen:
                assert time.monotonic() < until_s, f"{shown!r} never came: {seen!r}"
                if select.select([master], [], [], 0.1)[0]:
                    seen += os.read(master, 65536).decode()
    finally:
        bash.kill()
        bash.wait()
        os.close(master)


@pytest.mark.parametrize("shell", ["zsh", "fish"])
def test_other_shells_scripts_name_every_option(shell: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = script(shell, tmp_path, capsys).read_text()
    for verb in all_verbs():
        options = [name for action in parser_of(verb)._actions for name in action.option_strings]
        assert all(name.strip("-") in text for name in [verb, *options])


def test_where_shtab_is_missing_one_line_says_so(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "shtab", None)
    assert main(["completion", "bash"]) == 1
    assert capsys.readouterr().err == (
        "fsai-vcu completion: shtab is not installed; install it with: pip install shtab\n"
    )


@pytest.mark.skipif(shutil.which("zsh") is None, reason="zsh is not installed here")
def test_zsh_takes_its_script(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    done = subprocess.run(["zsh", "-n", str(script("zsh", tmp_path, capsys))], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.skipif(shutil.which("fish") is None, reason="fish is not installed here")
def test_fish_offers_what_its_script_says(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    ask = f"source {script('fish', tmp_path, capsys)}; complete -C 'fsai-vcu drive --mission '"
    done = subprocess.run(["fish", "-c", ask], capture_output=True, text=True, check=True)
    assert sorted(line.split("\t")[0] for line in done.stdout.splitlines()) == MISSIONS
