"""`fsai-vcu completion`: what a shell offers is what the parsers take."""

from __future__ import annotations

import contextlib
import os
import pty
import select
import shutil
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from fsai_vcu.cli import completing
from fsai_vcu.cli.grammar import Verb, verbs
from fsai_vcu.cli.main import all_verbs, main, parser_of
from fsai_vcu.interface.enums import Ami

MISSIONS = [ami.name.lower() for ami in Ami if ami is not Ami.NOT_SELECTED]
WITHIN_S = 20.0


@pytest.fixture(scope="module")
def grammar() -> tuple[Verb, ...]:
    return verbs()


@pytest.fixture(scope="module")
def script(tmp_path_factory: pytest.TempPathFactory, grammar: tuple[Verb, ...]) -> Path:
    path = tmp_path_factory.mktemp("completion") / "fsai-vcu.bash"
    path.write_text(completing.bash(grammar))
    return path


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name in ("run.log", "run two.log", "old.dbc"):
        (tmp_path / name).touch()
    (tmp_path / "runs").mkdir()
    return tmp_path


_ASK = """\
source "$1"
COMP_LINE="$2"; COMP_POINT=${#2}
_fsai_vcu
printf '%s\\n' "${COMPREPLY[@]}"
"""


def offered(script: Path, line: str, folder: Path = Path("/")) -> list[str]:
    """What bash offers for a line with the cursor at its end."""
    argv = ["bash", "--noprofile", "--norc", "-c", _ASK, "bash", str(script), line]
    done = subprocess.run(argv, capture_output=True, text=True, cwd=folder, check=True)
    assert done.stderr == ""
    return sorted(filter(None, done.stdout.splitlines()))


def options_of(verb: str) -> list[str]:
    return sorted(name for action in parser_of(verb)._actions for name in action.option_strings)


def test_behind_the_command_all_verbs_are_offered(script: Path) -> None:
    assert offered(script, "fsai-vcu ") == sorted(all_verbs())
    assert offered(script, "fsai-vcu d") == sorted(verb for verb in all_verbs() if verb.startswith("d"))
    assert offered(script, "fsai-vcu --") == ["--help", "--version"]
    assert offered(script, "fsai-vcu nonsense ") == []


@pytest.mark.parametrize("verb", all_verbs())
def test_behind_a_verb_all_of_its_options_are_offered_and_no_others(verb: str, script: Path) -> None:
    assert offered(script, f"fsai-vcu {verb} -") == options_of(verb)


def test_choices_are_offered_as_values_however_the_option_is_written(script: Path) -> None:
    assert offered(script, "fsai-vcu drive --mission ") == sorted(MISSIONS)
    assert offered(script, "fsai-vcu drive --laps 2 --mission a") == [m for m in sorted(MISSIONS) if m.startswith("a")]
    # Readline replaces only what stands behind the "=".
    assert offered(script, "fsai-vcu drive --mission=track") == ["trackdrive"]
    assert offered(script, "fsai-vcu dump -t ") == ["a", "d", "z"]
    assert offered(script, "fsai-vcu vcu --profile s") == ["specification"]
    assert offered(script, "fsai-vcu explain run.log --revision ") == ["2021", "2026"]
    assert offered(script, "fsai-vcu mode ") == ["autonomous", "manual"]
    assert offered(script, "fsai-vcu mode manual ") == []
    assert offered(script, "fsai-vcu completion ") == ["bash", "fish", "zsh"]
    assert "AI2VCU_Brake" in offered(script, "fsai-vcu send --count 3 AI2")


def test_files_and_folders_are_offered_where_they_belong(script: Path, folder: Path) -> None:
    everything = ["old.dbc", "run two.log", "run.log", "runs"]
    assert offered(script, "fsai-vcu explain ", folder) == everything
    assert offered(script, "fsai-vcu dump --dbc ol", folder) == ["old.dbc"]
    assert offered(script, "fsai-vcu dump run.log run", folder) == ["run two.log", "run.log", "runs"]
    assert offered(script, "fsai-vcu explain run.log ", folder) == []
    assert offered(script, "fsai-vcu hil --results ", folder) == ["runs"]
    assert offered(script, "fsai-vcu explain run\\ t", folder) == ["run two.log"]
    assert offered(script, "fsai-vcu explain 'run t", folder) == ["run two.log"]
    assert offered(script, "fsai-vcu explain 'run two.log' ", folder) == []
    assert offered(script, "fsai-vcu explain -- ru", folder) == ["run two.log", "run.log", "runs"]


def test_numbers_are_left_to_the_one_who_types(script: Path, folder: Path) -> None:
    assert offered(script, "fsai-vcu drive --laps ", folder) == []
    assert offered(script, "fsai-vcu drive --laps 2 ", folder) == []


def test_sub_verbs_are_offered_with_their_own_options(tmp_path: Path) -> None:
    nested = (
        Verb("log", "look at logs", "", (), (), ("cut", "join"), ()),
        Verb("log cut", "cut one", "", (), (), (), ()),
        Verb("log join", "join them", "", (), (), (), ()),
    )
    path = tmp_path / "nested.bash"
    path.write_text(completing.bash(nested))
    assert offered(path, "fsai-vcu ") == ["log"]
    assert offered(path, "fsai-vcu log ") == ["cut", "join"]
    assert offered(path, "fsai-vcu log cut ") == []


def test_a_tab_in_a_real_bash_completes(script: Path, folder: Path) -> None:
    with interactive_bash(folder) as (type_, read):
        type_(f"PS1='ready> '; source {script}\n")
        read("ready> ")
        type_("fsai-vcu emer\t")
        read("fsai-vcu emergency-brake ")
        type_("\x15fsai-vcu explain run\\ t\t")  # ^U: begin the line anew
        read("fsai-vcu explain run\\ two.log ")
        type_("\x15fsai-vcu drive --mission=track\t")
        read("fsai-vcu drive --mission=trackdrive ")


@contextlib.contextmanager
def interactive_bash(folder: Path) -> Iterator[tuple[Callable[[str], None], Callable[[str], None]]]:
    """(type something, read until something was shown)."""
    master, slave = pty.openpty()
    argv = ["bash", "--noprofile", "--norc", "-i"]
    environment = {**os.environ, "TERM": "dumb", "INPUTRC": "/dev/null", "HISTFILE": ""}
    process = subprocess.Popen(
        argv, stdin=slave, stdout=slave, stderr=slave, cwd=folder, env=environment, start_new_session=True
    )
    os.close(slave)
    seen = ""

    def type_(text: str) -> None:
        os.write(master, text.encode())

    def read(text: str) -> None:
        nonlocal seen
        until_s = time.monotonic() + WITHIN_S
        while text not in seen:
            assert time.monotonic() < until_s, f"{text!r} never came: {seen!r}"
            if select.select([master], [], [], 0.1)[0]:
                seen += os.read(master, 65536).decode()
        seen = seen.partition(text)[2]

    try:
        yield type_, read
    finally:
        process.kill()
        process.wait()
        os.close(master)


# ---------------------------------------------------------------- the other shells


@pytest.mark.parametrize("shell", ["zsh", "fish"])
def test_the_other_shells_scripts_name_every_verb_and_option(
    shell: str, grammar: tuple[Verb, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["completion", shell]) == 0
    text = capsys.readouterr().out
    for verb in grammar:
        assert verb.words in text
        for option in verb.options:
            for name in option.names:
                spelt = name if shell == "zsh" else f"-l {name[2:]}" if name.startswith("--") else f"-s {name[1:]}"
                assert spelt in text, f"{verb.words} {name}"


@pytest.mark.skipif(shutil.which("zsh") is None, reason="zsh is not installed here")
def test_zsh_takes_its_script(tmp_path: Path, grammar: tuple[Verb, ...]) -> None:
    (tmp_path / "_fsai-vcu").write_text(completing.zsh(grammar))
    done = subprocess.run(["zsh", "-n", str(tmp_path / "_fsai-vcu")], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.skipif(shutil.which("fish") is None, reason="fish is not installed here")
def test_fish_offers_what_its_script_says(tmp_path: Path, grammar: tuple[Verb, ...]) -> None:
    (tmp_path / "fsai-vcu.fish").write_text(completing.fish(grammar))
    ask = f"source {tmp_path}/fsai-vcu.fish; complete -C 'fsai-vcu drive --mission '"
    done = subprocess.run(["fish", "-c", ask], capture_output=True, text=True, check=True)
    assert sorted(line.split("\t")[0] for line in done.stdout.splitlines()) == sorted(MISSIONS)


def test_an_unknown_shell_is_refused_in_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["completion", "tcsh"])
    assert ended.value.code == 2
    said = capsys.readouterr().err
    assert "invalid choice: 'tcsh'" in said and said.count("\n") == 1
