"""Every verb answers without a traceback, whatever the names of files, the output, the moment of a Ctrl-C, or ROS."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from fsai_vcu.cli.main import all_verbs, main

# A process for each situation, in which every verb runs in a fork of its own: Python is started once.
RUNNER = """
import io, json, os, resource, signal, sys
import fsai_vcu.cli.start as start
from fsai_vcu.cli.main import all_verbs, module_of

uses = json.loads(sys.argv[1])
if not any(after for _, after, _ in uses):
    for verb in all_verbs():
        module_of(verb)

class Interrupts:
    def __init__(self, after):
        self.left = after

    def find_spec(self, name, path=None, target=None):
        self.left -= 1
        if self.left == 0:
            os.kill(os.getpid(), signal.SIGINT)

def told(words, after, how):
    read, write = os.pipe()
    child = os.fork()
    if not child:
        os.close(read)
        os.dup2(write, 2)
        if how == "reader gone":
            reader, gone = os.pipe()
            os.close(reader)
            os.dup2(gone, 1)
        elif how == "disk full":
            os.dup2(os.open("/dev/full", os.O_WRONLY), 1)
        elif how.startswith("disk takes a part"):
            resource.setrlimit(resource.RLIMIT_FSIZE, (100, 100))
            os.dup2(os.open("out.txt", os.O_WRONLY | os.O_CREAT | os.O_TRUNC), 1)
            if how.endswith("unbuffered"):
                sys.stdout = io.TextIOWrapper(open(1, "wb", 0), write_through=True)
        elif how == "stdout closed":
            os.close(1)
            sys.stdout = None
        elif how == "stderr closed":
            os.dup2(write, 1)
            os.close(2)
            sys.stderr = None
        else:
            os.dup2(write, 1)
        sys.argv = ["fsai-vcu", *words]
        sys.meta_path.insert(0, Interrupts(after))
        status = 99
        try:
            status = start.main()
        except SystemExit as ended:
            status = ended.code
        except BaseException as error:
            import traceback
            os.write(write, traceback.format_exc().encode("utf-8", "replace"))
        finally:
            os._exit(status)
    os.close(write)
    with os.fdopen(read, "rb") as pipe:
        said = pipe.read().decode("utf-8", "replace")
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), said

print(json.dumps([told(*use) for use in uses]))
"""
LOG = "".join(
    f"(1.{n:03d}000) can0 520#0{n % 2}00000000000000\n(1.{n:03d}500) can0 510#0{n % 2}00000000000000\n"
    for n in range(0, 1000, 10)
)
USES = {
    "check": "check run.log --figures",
    "explain": "explain run.log",
    "dump": "dump run.log",
    "decode": "decode run.log",
    "report": "report run.log -o run.html",
    "plot": "plot run.log AS_STATE -o run.html",
    "compare": "compare run.log run.log",
    "export": "export run.log --to csv -o tables",
    "monitor": "monitor run.log --rate 0",
    "dbc": "dbc show",
    "completion": "completion bash",
    "reference": "reference",
    "track": "track small_oval",
}
"""Uses that end at once, without a car; of other verbs the help is asked for."""


CLOSED = ("stdout", "stderr")
GONE = [
    *("--help", "reference", "completion bash", "explain --help", "campaign --list"),
    *("dump run.log", "track small_oval", "monitor run.log --rate 0 --json"),
]
"""With a reader that has gone."""
DISKS = {
    "disk full": ["--help", "reference", "completion bash"],
    "disk takes a part": ["decode run.log", "dump run.log", "check run.log --figures", "explain run.log --timeline"],
    "disk takes a part, unbuffered": ["decode run.log"],
}

Use = tuple[list[str], int, str]
"""Its words, after how many imports it is interrupted (0: it is not), and what its output is."""


def run_each(uses: list[Use], folder: Path, **environment: str) -> list[tuple[Use, int, str]]:
    """(use, status, all that was said) of each."""
    (folder / "run.log").write_text(LOG)
    argv = [sys.executable, "-c", RUNNER, json.dumps(uses)]
    done = subprocess.run(argv, cwd=folder, env={**os.environ, **environment}, stdout=subprocess.PIPE, check=True)
    found = json.loads(done.stdout.splitlines()[-1])
    return [(use, status, said) for use, (status, said) in zip(uses, found, strict=True)]


POOR = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0", "PYTHONIOENCODING": "ascii"}


def test_no_verb_answers_an_output_with_a_traceback(tmp_path: Path) -> None:
    """ASCII alone, an output that is closed, a reader that has gone, a full disk, one that takes a part of it."""
    every = [USES[verb].split() if verb in USES else [verb, "--help"] for verb in all_verbs()]
    uses = [(words, 0, "ascii") for words in every]
    uses += [(USES[verb].split(), 0, f"{name} closed") for verb in ("check", "dump", "track") for name in CLOSED]
    uses += [(words.split(), 0, "reader gone") for words in GONE]
    uses += [(words.split(), 0, how) for how, many in DISKS.items() for words in many]
    for use, status, said in run_each(uses, tmp_path, **POOR):
        words, _, how = use
        assert "Traceback" not in said and "Exception ignored" not in said and status in (0, 1), (use, status, said)
        if how == "reader gone":
            assert (status, said) == (0, ""), (use, status, said)
        elif how.startswith("disk"):
            why = "No space left on device" if how == "disk full" else "File too large"
            told = f"fsai-vcu {words[0]}: cannot write the output: {why}\n"
            assert (status, said) == (1, told), (use, status, said)


def test_ctrl_c_while_a_verb_loads_is_answered_in_a_line(tmp_path: Path) -> None:
    """At its first import, and in the midst of them; after the last one it is at work, which ends as it ever does."""
    uses = [([verb, "--help"], after, "") for verb in all_verbs() for after in (1, 12)]
    for use, status, said in run_each(uses, tmp_path):
        if status == 130 or use[1] == 1:
            assert (status, said) == (130, f"fsai-vcu {use[0][0]}: interrupted\n"), use
        else:
            assert status == 0 and "Traceback" not in said, (use, said)


INTERRUPTED = {verb: USES[verb].split() for verb in ("check", "explain", "plot")}


@pytest.mark.parametrize(
    "after",
    [
        {"check": (150,), "explain": (300,), "plot": (500,)},
        pytest.param(dict.fromkeys(INTERRUPTED, (150, 300, 500)), marks=pytest.mark.long),
    ],
    ids=["one moment of each", "all"],
)
def test_ctrl_c_while_a_verb_works_is_answered_in_a_line(after: dict[str, tuple[int, ...]], tmp_path: Path) -> None:
    uses = [(INTERRUPTED[verb], imports, "") for verb, many in after.items() for imports in many]
    for use, status, said in run_each(uses, tmp_path):
        assert "Traceback" not in said, (use, said)
        assert status in (0, 1) or (status, said) == (130, f"fsai-vcu {use[0][0]}: interrupted\n"), (use, status, said)


# ---------------------------------------------------------------- names of files


NAMES = ("run 12,5 kmh.log", "day 1, wet/a,b.log", "-dash.log")


def words_of(use: str, log: str) -> list[str]:
    """The use with that log: one whose name begins with a dash stands behind two of them, with what follows it."""
    words = [word.format(log) for word in use.split()]
    if not log.startswith("-"):
        return words
    behind = [word for word in words if word in (log, "AS_STATE")]
    return [*(word for word in words if word not in behind), "--", *behind]


@pytest.mark.parametrize("use", [
    "check {}", "explain {}", "dump {}", "decode {}", "report {} -o x.html", "plot {} AS_STATE -o x.html",
    "compare {} {}", "export {} --to csv -o tables", "monitor {} --rate 0", "replay {} -i loopback:names --rate 1000",
])  # fmt: skip
def test_a_log_is_found_by_its_name_whatever_is_in_it(
    use: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    said = {}
    for name in ("plain.log", *NAMES):
        Path(name).parent.mkdir(exist_ok=True)
        Path(name).write_text(LOG.replace("510", "514"))
        status = main(words_of(use, name))
        out = capsys.readouterr()
        said[name] = status, "is not a filter" in out.err, "No such file" in out.err
        shutil.rmtree("tables", ignore_errors=True)
    assert said == dict.fromkeys(said, (said["plain.log"][0], False, False))


def test_filters_are_looked_for_behind_the_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("a,520.log").write_text(LOG)
    assert main(["dump", "--no-signals", "a,520.log,510:7FF"]) == 0
    shown = capsys.readouterr().out.splitlines()
    assert len(shown) == 100 and all(" 510 " in line for line in shown)
    assert main(["dump", "a,520"]) == 2
    assert "'520' is not a filter" in capsys.readouterr().err


# ---------------------------------------------------------------- ROS that cannot start


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        *(
            ("ROS_DOMAIN_ID", value, f"ROS_DOMAIN_ID is '{value}', not a number from 0 to 232")
            for value in ("abc", "9999", "233", "7.5", "-1")
        ),
        (
            "RMW_IMPLEMENTATION",
            "rmw_that_is_not_there",
            "RMW_IMPLEMENTATION is 'rmw_that_is_not_there', which is not installed",
        ),
    ],
)
@pytest.mark.parametrize("use", [
    "emergency-brake", "mode manual", "reset", "status", "check-stack", "pitwall loopback:ros --ros --port 0",
    "record -i loopback:ros -o new --mcap --ros",
])  # fmt: skip
def test_a_ros_that_would_not_start_is_named_in_one_line(
    use: str,
    name: str,
    value: str,
    words: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv(name, value)
    assert main(use.split()) == 1
    line = capsys.readouterr().err.splitlines()[-1]
    assert line.startswith(f"fsai-vcu {use.split()[0]}: ROS 2 does not start: {words}"), line
    assert line.endswith("Press the remote's E-stop meanwhile") == (use == "emergency-brake")
