"""The reference, and the helps it is made from: complete, up to date, and with examples that can be typed."""

from __future__ import annotations

import argparse
import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from fsai_vcu.cli.main import all_verbs, main, module_of, parser_of
from fsai_vcu.cli.reference import examples_of, manual, markdown

BUFFERED = {name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"}  # as a user's output is
ROOT = Path(__file__).resolve().parents[2]


def test_committed_reference_is_current_on_any_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "37")
    committed = (ROOT / "docs" / "reference.md").read_text(encoding="utf-8")
    assert committed == markdown(), "write it again with: fsai-vcu reference -o docs/reference.md"


def test_the_reference_explains_every_verb_and_option() -> None:
    text = markdown()
    for verb in all_verbs():
        _, _, chapter = text.partition(f"\n### fsai-vcu {verb}\n")
        chapter = re.split(r"\n##+ ", chapter)[0]
        for action in parser_of(verb)._actions:
            assert action.help, f"{verb} {action.dest}"
            if action.help is argparse.SUPPRESS:
                continue  # a former name
            for name in action.option_strings:
                assert name in ("-h", "--help") or f"{name}" in chapter, f"{verb} {name}"
        for line in examples_of(parser_of(verb)):
            assert line in chapter


def commands(line: str) -> list[list[str]]:
    """The commands of one line of shell, without what is redirected."""
    words = shlex.shlex(line, posix=True, punctuation_chars=";|&>")
    words.whitespace_split = True
    words.commenters = ""
    found: list[list[str]] = [[]]
    for word in words:
        if set(word) <= set(";|&"):
            found.append([])
        else:
            found[-1].append(word)
    return [words[: words.index(">")] if ">" in words else words for words in found if words]


@pytest.mark.parametrize("verb", all_verbs())
def test_every_example_is_one_that_its_own_parser_takes(verb: str) -> None:
    parser, module = parser_of(verb), module_of(verb)
    examples = examples_of(parser)
    assert examples
    for example in examples:
        ours = [words for words in commands(example) if words[0] == "fsai-vcu"]
        assert ours and verb in [words[1] for words in ours], example
        for words in ours:
            if words[1] == verb:
                parse = getattr(module, "parse", argparse.ArgumentParser.parse_intermixed_args)
                assert parse(parser, words[2:]) is not None


@pytest.mark.parametrize("verb", all_verbs())
def test_every_help_has_an_example_at_any_terminal_width(
    verb: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for columns in ("40", "200"):
        monkeypatch.setenv("COLUMNS", columns)
        with pytest.raises(SystemExit) as ended:
            main([verb, "--help"])
        assert ended.value.code == 0
        assert f"example:\n  fsai-vcu {verb}" in capsys.readouterr().out


def test_it_is_written_where_it_is_asked_for(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "new" / "reference.md"
    assert main(["reference", "-o", str(path)]) == 0
    assert capsys.readouterr().out == f"saved {path}\n"
    assert path.read_text(encoding="utf-8") == markdown()
    assert main(["reference", "-o", "/proc/nowhere/reference.md"]) == 1
    said = capsys.readouterr().err
    assert said.startswith("fsai-vcu reference: /proc/nowhere/reference.md cannot be written") and said.count("\n") == 1


def test_the_manual_page_has_what_a_manual_page_has() -> None:
    text = manual()
    for heading in (".TH FSAI-VCU 1", ".SH NAME", ".SH SYNOPSIS", ".SH DESCRIPTION", ".SH VERBS", ".SH EXIT STATUS"):
        assert heading in text
    for verb in all_verbs():
        assert f".SS {verb}".replace("-", r"\-") in text


@pytest.mark.skipif(shutil.which("groff") is None, reason="groff is not installed here")
def test_the_manual_page_is_taken_by_roff_without_a_warning() -> None:
    argv = ["groff", "-man", "-Tutf8", "-Kutf8", "-ww"]
    done = subprocess.run(argv, input=manual(), capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    assert "emergency" in done.stdout


# Of every verb and every output: test_every_verb.py.
def test_a_reader_that_has_gone_is_no_error() -> None:
    reader, writer = os.pipe()
    os.close(reader)
    try:
        process = [sys.executable, "-m", "fsai_vcu.cli.main", "--help"]
        done = subprocess.run(process, stdout=writer, stderr=subprocess.PIPE, text=True, env=BUFFERED)
    finally:
        os.close(writer)
    assert (done.returncode, done.stderr) == (0, "")


def test_a_full_disk_is_one_clear_line() -> None:
    with Path("/dev/full").open("w") as full:
        process = [sys.executable, "-m", "fsai_vcu.cli.main", "--help"]
        done = subprocess.run(process, stdout=full, stderr=subprocess.PIPE, text=True, env=BUFFERED)
    said = "fsai-vcu --help: cannot write the output: No space left on device\n"
    assert (done.returncode, done.stderr) == (1, said)
