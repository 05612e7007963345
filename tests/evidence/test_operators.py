"""The mistakes themselves: each operator makes what it says, shown on a line of code."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import Enum
from pathlib import Path

import pytest

from fsai_hil.evidence.mutation.operators import mutants_of, mutated
from fsai_vcu.core.supervision import gate


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
    found = mutants_of("made", source, NAMES)
    for mutant in found:
        compile(mutated(source, mutant), "made", "exec")
        assert mutant.minus == (line,) and mutant.where == "drive" and not mutant.at_import
    return {" ".join(mutant.plus) for mutant in found}


@pytest.mark.parametrize(
    ("line", "mistakes"),
    [
        ("return rpm < 3", {"return rpm <= 3", "return rpm >= 3", "return rpm < 4", "return rpm < 2"}),
        ("return rpm >= 3", {"return rpm > 3", "return rpm < 3"}),
        ("return rpm == 3", {"return rpm != 3"}),
        ("return 1 <= rpm < 3", {"return 1 < rpm < 3", "return 1 <= rpm <= 3", "return 1 <= rpm >= 3"}),
        ("return rpm is not None", {"return rpm is None", "return True", "return False"}),
        ("return rpm not in (1, 2)", {"return rpm in (1, 2)", "return rpm not in (2,)", "return rpm not in (1,)"}),
        ("return rpm + 1.5", {"return rpm - 1.5", "return rpm + 2.5", "return rpm + -1.5"}),
        ("return rpm * rpm", {"return rpm / rpm"}),
        ("return (rpm + 1) * rpm", {"return (rpm - 1) * rpm", "return (rpm + 1) / rpm"}),
        ("return -rpm", {"return rpm"}),
        ("return not (rpm or car)", {"return (rpm or car)", "return not (rpm and car)", "return not (False or car)"}),
        (
            "return rpm and car and 3",
            {"return rpm or car and 3", "return rpm and car or 3", "return rpm and True and 3"},
        ),
        ("return min(rpm, 3)", {"return max(rpm, 3)", "return (rpm)", "return (3)", "return min(rpm, 4)"}),
        ("return max(rpm, 1, 2)", {"return max(rpm, 1)", "return max(rpm, 2)", "return max(1, 2)"}),
        ("return math.floor(rpm)", {"return math.ceil(rpm)"}),
        ("return abs(rpm)", {"return (rpm)"}),
        ("return Gear.SECOND", {"return Gear.THIRD", "return Gear.FIRST"}),
        ("return replace(car, rpm=rpm)", {"return replace(car, )"}),
        ("return Car(car, rpm)", {"return Car(rpm, car)"}),
        ("return 1 if car else rpm", {"return 1 if True else rpm", "return 1 if False else rpm"}),
        ("return [a for a in car if a]", {"return [a for a in car if True]", "return [a for a in car if False]"}),
        ("rpm = 3", {"pass", "rpm = 4", "rpm = 2"}),
        ("car.start()", {"pass"}),
        ("rpm += rpm", {"rpm -= rpm", "pass"}),
        ("raise ValueError('no')", {"pass", 'raise ValueError("")'}),
        ("return f'{rpm} rpm'", {'return ""'}),
        ("return {1: car, 2: rpm}", {"return {2: rpm}", "return {1: car, }"}),
        ("return frozenset((car, rpm))", {"return frozenset((rpm,))", "return frozenset((car,))"}),
    ],
)
def test_each_kind_of_mistake_is_made(line: str, mistakes: set[str]) -> None:
    assert mistakes <= made(line)


def test_where_a_bool_is_returned_both_are() -> None:
    assert {"return True", "return False"} <= made("return rpm", "bool")
    assert made("return rpm", "int") == set()
    assert made("return rpm", "int | None") == {"return None"}


@pytest.mark.parametrize(
    "line", ["assert rpm > 3", '"""One or 2."""', "here: dict[int, Literal[3]]", "return other(car, rpm)"]
)
def test_what_does_nothing_is_left_alone(line: str) -> None:
    assert made(line) == set()


def test_a_condition_of_a_match_and_its_pattern_are_mistaken_too() -> None:
    source = "def f(g, on):\n    match g:\n        case Gear.FIRST if on:\n            return 1\n"
    plus = {" ".join(mutant.plus) for mutant in mutants_of("made", source, NAMES)}
    assert {"case Gear.SECOND if on:", "case Gear.THIRD if on:", "case Gear.FIRST if False:"} <= plus


def test_tables_and_defaults_act_on_import() -> None:
    source = "TABLE = {Gear.FIRST: 10, **OTHER, Gear.THIRD: 30}\n\nclass A:\n    rpm: int = 5\n"
    found = mutants_of("made", source, NAMES)
    assert all(mutant.at_import for mutant in found)
    texts = {mutated(source, mutant).splitlines()[0] for mutant in found}
    assert {"TABLE = {**OTHER, Gear.THIRD: 30}", "TABLE = {Gear.FIRST: 10, Gear.THIRD: 30}"} <= texts
    assert {mutant.key for mutant in found if mutant.where == "A"} == {
        ("made.A", "rpm: int = 5", "rpm: int = 6", 1),
        ("made.A", "rpm: int = 5", "rpm: int = 4", 1),
    }


def test_a_mutant_keeps_its_key_when_lines_above_it_come_and_go() -> None:
    source = "def f(a):\n    return a < 3\n"
    here = mutants_of("made", source, NAMES)
    below = mutants_of("made", "import math\n\n\n" + source, NAMES)
    assert [mutant.key for mutant in here] == [mutant.key for mutant in below]
    assert [mutant.start for mutant in here] != [mutant.start for mutant in below]


def test_the_same_line_twice_in_a_function_has_two_keys() -> None:
    source = "def f(a):\n    if a:\n        a = g(a, 1)\n    else:\n        a = g(a, 1)\n    return a\n"
    keys = [mutant.key for mutant in mutants_of("made", source, NAMES)]
    assert len(keys) == len(set(keys))
    assert ("made.f", "a = g(a, 1)", "a = g(a, 2)", 2) in keys


def test_a_statement_no_operator_knows_is_not_passed_over_in_silence() -> None:
    with pytest.raises(NotImplementedError, match="line 1: no operator knows With"):
        mutants_of("made", "with a:\n    pass\n", NAMES)


def test_a_mutant_is_shown_as_the_lines_that_change() -> None:
    source = "def f(a):\n    return g(\n        a,\n        1,\n    )\n"
    shown = [mutant.shown() for mutant in mutants_of("made", source, NAMES)]
    assert "made.f, line 2: constant\n    - 1,\n    + 2," in shown


def test_every_mutant_of_the_core_is_one_change_and_a_program() -> None:
    source = Path(gate.__file__).read_text()

    found = mutants_of("gate", source, vars(gate))
    assert len(found) > 500 and len({mutant.key for mutant in found}) == len(found)
    for mutant in found[::10]:
        assert mutated(source, mutant) != source
        compile(mutated(source, mutant), "gate", "exec")
