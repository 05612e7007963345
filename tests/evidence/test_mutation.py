"""A sample of mutants on every run of the tests, full coverage of what is mutated, and the list of explained survivors.

All mutants are tried by `make mutation`.
"""

from __future__ import annotations

import ast
import math
import subprocess
import sys
from dataclasses import dataclass
from enum import Enum

import pytest
from msgspec.structs import replace

from fsai_hil.evidence.mutation.__main__ import main, table
from fsai_hil.evidence.mutation.mutants import Mutant, Walk
from fsai_hil.evidence.mutation.trial import mutants

SAMPLE = 5  # of some 2,000 that `make mutation` tries


@pytest.fixture(scope="module")
def everything() -> list[Mutant]:
    return mutants()


def test_no_mutant_of_a_sample_survives() -> None:
    """The sample changes with the code and the tests, and with nothing else; every explained survivor is a mutant."""
    command = [sys.executable, "-m", "fsai_hil.evidence.mutation", "--sample", str(SAMPLE)]
    run = subprocess.run(command, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stdout[-6000:] + run.stderr[-6000:]
    assert run.stdout.splitlines()[-1] == f"| in all | {SAMPLE} | {SAMPLE} | 0 | 0 | 100.00 % |"


def test_every_mutant_is_a_program_and_has_its_own_key(everything: list[Mutant]) -> None:
    assert len({mutant.key for mutant in everything}) == len(everything) > 2000
    for mutant in everything[::100]:
        mutant.code("mutated")


def test_the_figures_set_explained_survivors_apart(everything: list[Mutant]) -> None:
    known, other, third = everything[:3]
    figures = table([(known, True), (other, False), (third, True)], {known.key})
    assert figures[-1] == "| in all | 3 | 1 | 1 | 1 | 50.00 % |"


def test_a_sample_of_none_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--sample", "0"]) == 2
    assert capsys.readouterr().err == "--jobs and --sample take 1 or more\n"


# ---------------------------------------------------------------- each kind of mistake


class Gear(Enum):
    FIRST = 1
    SECOND = 2
    THIRD = 3


@dataclass
class Car:
    gear: Gear = Gear.FIRST
    rpm: int = 0


NAMES = {"Gear": Gear, "Car": Car, "replace": replace, "math": math}


def made(line: str, returns: str = "int") -> set[str]:
    """What a function's only line becomes, in all its mutants."""
    source = f"def drive(car: Car, rpm: int) -> {returns}:\n    {line}\n"
    found = list(Walk("made", source, NAMES).mutants())
    for mutant in found:
        mutant.code("made")
        assert mutant.key[:2] == ("made.drive", ast.unparse(ast.parse(line)))
    return {mutant.key[2] for mutant in found}


@pytest.mark.parametrize(
    ("line", "mistakes"),
    [
        ("return rpm < 3", {"return rpm <= 3", "return True", "return False", "return rpm < 4", "return rpm < 2"}),
        ("return 1 <= rpm < 3", {"return 1 < rpm < 3", "return 1 <= rpm <= 3"}),
        ("return rpm is not None", {"return True", "return False"}),
        ("return rpm not in (1, 2)", {"return rpm not in (2,)", "return rpm not in (1,)"}),
        ("return (rpm + 1) * rpm", {"return (rpm - 1) * rpm", "return (rpm + 1) / rpm"}),
        ("return rpm + 1.5", {"return rpm - 1.5", "return rpm + 2.5", "return rpm + -1.5"}),
        ("return -rpm", {"return rpm"}),
        ("return not (rpm or car)", {"return not (False or car)", "return not (rpm or False)", "return True"}),
        ("return rpm and car and 3", {"return True and car and 3", "return rpm and True and 3"}),
        ("return min(rpm, 3)", {"return rpm", "return 3", "return min(rpm, 4)"}),
        ("return math.floor(abs(rpm))", {"return math.ceil(abs(rpm))", "return math.floor(rpm)"}),
        ("return Gear.SECOND", {"return Gear.THIRD", "return Gear.FIRST"}),
        ("return replace(car, rpm=rpm)", {"return replace(car)"}),
        ("return Car(car, rpm)", {"return Car(rpm, car)"}),
        ("return 1 if car else rpm", {"return 1 if True else rpm", "return 1 if False else rpm"}),
        ("return [a for a in car if a]", {"return [a for a in car if True]", "return [a for a in car if False]"}),
        ("rpm = 3", {"pass", "rpm = 4", "rpm = 2"}),
        ("rpm += rpm", {"rpm -= rpm", "pass"}),
        ("raise ValueError('no')", {"pass", "raise ValueError('')"}),
        ("return f'{rpm} rpm'", {"return ''"}),
        ("return {1: car, **rpm}", {"return {**rpm}", "return {1: car}"}),
        ("rpm = rpm, car, (1 if car else 2)", {"rpm = (rpm, car)", "rpm = (car, 1 if car else 2)"}),
        ("assert rpm > 3", set()),
        ('"""One or 2."""', set()),
        ("here: dict[int, Literal[3]]", set()),
    ],
)  # fmt: skip
def test_each_kind_of_mistake_is_made(line: str, mistakes: set[str]) -> None:
    found = made(line)
    assert mistakes <= found if mistakes else not found


def test_what_is_returned_is_forced_by_its_type() -> None:
    assert {"return True", "return False"} <= made("return rpm", "bool")
    assert made("return rpm", "int") == set()
    assert made("return rpm", "int | None") == {"return None"}


def test_a_match_is_mistaken_in_pattern_and_guard() -> None:
    source = "def f(g, on):\n    match g:\n        case Gear.FIRST if on:\n            return 1\n"
    plus = "".join(mutant.key[2] for mutant in Walk("made", source, NAMES).mutants())
    assert all(f"case Gear.{case}:" in plus for case in ("SECOND if on", "THIRD if on", "FIRST if False"))


def test_tables_and_defaults_are_mistaken() -> None:
    found = list(Walk("made", "TABLE = {Gear.FIRST: 10}\n\nclass A:\n    rpm: int = 5\n", NAMES).mutants())
    assert {mutant.key for mutant in found} >= {
        ("made", "TABLE = {Gear.FIRST: 10}", "TABLE = {}", 1),
        ("made.A", "rpm: int = 5", "rpm: int = 6", 1),
    }


def test_a_key_outlives_lines_that_come_and_go_above() -> None:
    source = "def f(a):\n    if a:\n        a = g(a, 1)\n    else:\n        a = g(a, 1)\n    return a\n"
    here = list(Walk("made", source, NAMES).mutants())
    below = Walk("made", "import math\n\n\n" + source, NAMES).mutants()
    assert [mutant.key for mutant in here] == [mutant.key for mutant in below]
    assert ("made.f", "a = g(a, 1)", "a = g(a, 2)", 2) in [mutant.key for mutant in here]
