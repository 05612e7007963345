"""The catalogue is data: every row is whole, can be drawn, written down and read again."""

from __future__ import annotations

import random
from dataclasses import replace

import pytest

from fsai_hil.campaign.cases import LEGS_MS, Selection, Since, case_from_spec, case_of, drawn
from fsai_hil.campaign.catalogue import KINDS, ROWS, FaultKind
from fsai_hil.campaign.demands import Demand, End
from fsai_vcu.interface.enums import Ami

every_kind = pytest.mark.parametrize("kind", ROWS, ids=lambda kind: kind.name)


def test_there_are_more_than_forty_kinds_each_with_a_name_of_its_own() -> None:
    assert len(KINDS) == len(ROWS) > 40


@every_kind
def test_every_row_says_what_it_is_what_is_demanded_and_where_it_applies(kind: FaultKind) -> None:
    assert kind.what and kind.demanded and kind.missions and kind.revisions
    assert "|" not in kind.what + kind.demanded, "it would break the table"


@every_kind
def test_a_demand_follows_from_whatever_is_drawn(kind: FaultKind) -> None:
    rng = random.Random(5)
    for _ in range(50):
        demand = kind.demand(drawn(kind, rng))
        assert isinstance(demand, Demand) and demand.ends and End.UNDECIDED not in demand.ends


@every_kind
def test_a_case_can_be_written_down_and_read_again(kind: FaultKind) -> None:
    index = ROWS.index(kind)
    case = case_of(3, index, Selection())
    assert case.fault == kind.name
    again = case_from_spec(case.spec, mission=case.mission, revision=case.revision, seed=case.seed, full=False)
    assert again == replace(case, index=0)
    assert f"--fault {case.spec}" in case.replay


def test_a_case_follows_from_seed_and_index_alone() -> None:
    forward = [case_of(9, index, Selection()) for index in range(400)]
    backward = [case_of(9, index, Selection()) for index in reversed(range(400))]
    assert forward == backward[::-1]
    assert forward != [case_of(10, index, Selection()) for index in range(400)]


def test_every_kind_takes_its_turn_and_no_case_comes_twice() -> None:
    cases = [case_of(1, index, Selection()) for index in range(3 * len(ROWS))]
    assert {case.fault for case in cases[: len(ROWS)]} == set(KINDS)
    assert len({(case.fault, case.spec, case.mission, case.revision) for case in cases}) == len(cases)


def test_cases_keep_to_the_missions_and_revisions_of_their_kind() -> None:
    for index in range(10 * len(ROWS)):
        case = case_of(2, index, Selection())
        assert case.mission in case.kind.missions and case.revision in case.kind.revisions
        assert case.leg_ms in LEGS_MS[case.mission]
        assert case.leg_ms < case.after_ms


def test_full_length_cases_begin_their_faults_in_every_phase() -> None:
    cases = [case_of(1, index, Selection(), full=True) for index in range(400)]
    assert {case.since for case in cases} == set(Since)
    assert any(case.since is Since.DRIVING and case.after_ms < 3000 for case in cases)


def test_a_selection_narrows_faults_missions_and_revisions() -> None:
    selection = Selection(("go_off", "planner_silent"), (Ami.SKIDPAD,), ("2021",), 1)
    cases = [case_of(1, index, selection) for index in range(20)]
    assert {(case.mission, case.revision, case.seed) for case in cases} == {(Ami.SKIDPAD, "2021", 0)}
    assert {case.fault for case in cases} == {"go_off", "planner_silent"}


@pytest.mark.parametrize(
    ("spec", "complaint"),
    [
        ("no_such_fault", "unknown fault 'no_such_fault'"),
        ("status_lost:duration", "is not NAME=VALUE"),
        ("status_lost:colour=red", "has no parameter 'colour'"),
        ("status_lost:duration=long", "must be a whole number"),
        ("status_lost:since=tuesday", "choose one of start"),
        ("status_lost:after=-5", "must be a whole number of 0 or more"),
        ("wheel_dead:wheel=fifth", "choose one of fl"),
    ],
)
def test_what_cannot_be_meant_is_refused_in_one_clear_line(spec: str, complaint: str) -> None:
    with pytest.raises(ValueError, match=complaint):
        case_from_spec(spec, mission=None, revision="2026", seed=0, full=False)


def test_a_fault_by_hand_draws_what_is_not_given_and_keeps_what_is() -> None:
    case = case_from_spec("status_lost:duration=70", mission=None, revision="2026", seed=4, full=False)
    same = case_from_spec("status_lost:duration=70", mission=None, revision="2026", seed=4, full=False)
    other = case_from_spec("status_lost:duration=70", mission=None, revision="2026", seed=5, full=False)
    assert case == same != other
    assert case.params["duration"] == 70 and case.mission is Ami.AUTOCROSS


def test_a_fault_is_refused_where_it_does_not_apply() -> None:
    with pytest.raises(ValueError, match="does not apply to static_inspection_a"):
        case_from_spec("planner_silent", mission=Ami.STATIC_INSPECTION_A, revision="2026", seed=0, full=False)
    with pytest.raises(ValueError, match="does not apply to revision 2026"):
        case_from_spec("motor_one_axle", mission=None, revision="2026", seed=0, full=False)
