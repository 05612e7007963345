"""A sample of mutants on every run of the tests, full coverage of what is mutated, and the list of explained survivors.

All mutants are tried by `make mutation`.
"""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from fsai_hil.evidence.mutation import document, explained
from fsai_hil.evidence.mutation.__main__ import main
from fsai_hil.evidence.mutation.explained import Key, ListError, judge, load, stale
from fsai_hil.evidence.mutation.operators import Mutant
from fsai_hil.evidence.mutation.trial import KILLED, SURVIVED, TIMED_OUT, UNREACHED, Verdict, mutants, root, sources

SAMPLE = 60


@pytest.fixture(scope="module")
def everything() -> list[Mutant]:
    return mutants(sources())


# ---------------------------------------------------------------- the code of the core


def test_every_branch_of_the_core_is_taken_and_no_mutant_of_a_sample_survives(tmp_path: Path) -> None:
    """The sample changes with the code and the tests, and with nothing else."""
    record = tmp_path / "record.jsonl"
    command = [sys.executable, "-m", "fsai_hil.evidence.mutation", "--sample", str(SAMPLE), "--record", str(record)]
    run = subprocess.run(command, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stdout[-6000:] + run.stderr[-6000:]
    assert "every line and branch of supervision/*, bridge.py, limits.py is reached" in run.stdout
    verdicts = [json.loads(line)["verdict"]["outcome"] for line in record.read_text().splitlines()[1:]]
    assert len(verdicts) == SAMPLE and set(verdicts) <= {KILLED, TIMED_OUT}


def test_every_explained_survivor_is_a_mutant_of_the_code_as_it_is(everything: list[Mutant]) -> None:
    assert stale(load(), everything) == []


def test_the_documentation_lists_the_survivors_that_are_explained() -> None:
    text = (root() / document.DOCUMENT).read_text()
    assert text.endswith(document.listed(load())), "run `make mutation`"


# ---------------------------------------------------------------- the judgement


@pytest.fixture
def mutant(everything: list[Mutant]) -> Mutant:
    return everything[0]


def test_a_survivor_that_nobody_explains_fails(mutant: Mutant) -> None:
    for outcome in (SURVIVED, UNREACHED):
        judgement = judge([(mutant, Verdict(outcome))], {})
        assert not judgement.holds and judgement.unexplained == [mutant]


def test_a_survivor_that_is_explained_holds_and_counts_as_equivalent(mutant: Mutant) -> None:
    judgement = judge([(mutant, Verdict(SURVIVED))], {mutant.key: "nobody can tell"})
    assert judgement.holds and judgement.explained == [mutant] and judgement.caught == 0


def test_a_mutant_that_is_explained_and_killed_fails(mutant: Mutant) -> None:
    judgement = judge([(mutant, Verdict(KILLED, "a test"))], {mutant.key: "nobody can tell"})
    assert not judgement.holds and judgement.wrongly_explained == [mutant]


def test_a_mutant_that_never_ends_is_caught(mutant: Mutant) -> None:
    judgement = judge([(mutant, Verdict(TIMED_OUT))], {})
    assert judgement.holds and (judgement.caught, judgement.killed, judgement.timed_out) == (1, 0, 1)


def test_the_score_counts_only_what_can_be_killed(mutant: Mutant) -> None:
    other = replace(mutant, nth=9)
    judgement = judge([(mutant, Verdict(KILLED)), (other, Verdict(SURVIVED))], {other.key: "nobody can tell"})
    assert document.score(judgement) == "100.00 %"


def test_an_entry_that_names_no_mutant_is_stale(mutant: Mutant) -> None:
    place, minus, plus, nth = mutant.key
    gone: Key = (place, minus, plus + " and more", nth)
    assert stale({mutant.key: "", gone: ""}, [mutant]) == [gone]


# ---------------------------------------------------------------- the list

ENTRY = """
[[survivor]]
where = "gate.f"
minus = "a = 1"
plus = ["a = 2", "a = 0"]
why = "a is read by nobody who could tell."
"""


def listed(tmp_path: Path, text: str) -> dict[Key, str]:
    path = tmp_path / "survivors.toml"
    path.write_text(text)
    return load(path)


def test_mutants_of_one_line_may_share_a_reason(tmp_path: Path) -> None:
    why = "a is read by nobody who could tell."
    assert listed(tmp_path, ENTRY) == {
        ("gate.f", "a = 1", "a = 2", 1): why,
        ("gate.f", "a = 1", "a = 0", 1): why,
    }


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (ENTRY + ENTRY, "survivor 2: .* is listed twice"),
        (ENTRY.replace("read by nobody who could tell.", ""), "a reason is a sentence"),
        (ENTRY.replace("minus", "mimus"), r"unknown \['mimus'\], missing \['minus'\]"),
    ],
)
def test_a_list_that_cannot_be_used_is_refused_in_one_line(tmp_path: Path, text: str, words: str) -> None:
    with pytest.raises(ListError, match=words):
        listed(tmp_path, text)


# ---------------------------------------------------------------- the command


def test_options_that_make_no_sense_are_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--sample", "0"]) == 2
    assert capsys.readouterr().err == "--jobs and --sample take 1 or more\n"


def test_the_help_shows_an_example(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["--help"])
    assert "example: python -m fsai_hil.evidence.mutation --only gate._steering" in capsys.readouterr().out


def test_the_list_is_where_the_command_looks() -> None:
    assert (root() / explained.LIST).is_file()
