"""The catalogue is data: every row is whole, can be drawn, written down and read again, and is in the documents."""

from __future__ import annotations

import math
import random
import re
from itertools import product
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from msgspec.structs import replace

from fsai_hil.evidence.campaign.cases import LEGS_MS, CampaignPlan, Since, case_from_spec, drawn
from fsai_hil.evidence.campaign.catalogue import KINDS, ROWS
from fsai_hil.evidence.campaign.endings import End
from fsai_hil.evidence.campaign.faults.computer import no_number
from fsai_hil.evidence.campaign.faults.kind import At, FaultKind, Ongoing
from fsai_hil.simulator.faults import Delay, Drop, FaultyWire, FlipBits, Freeze, Repeat, WrongLength
from fsai_vcu.core.command import VehicleCommand
from fsai_vcu.interface.enums import Ami


def test_every_row_has_its_own_name_its_fault_and_its_demand() -> None:
    assert len(KINDS) == len(ROWS) > 200
    for kind in ROWS:
        assert kind.what and kind.must.demanded and kind.missions and kind.revisions, kind.name
        assert "|" not in kind.what + kind.must.demanded, f"{kind.name}: it would break the table"


def test_a_demand_follows_from_whatever_is_drawn() -> None:
    rng = random.Random(5)
    for kind in ROWS:
        for _ in range(20):
            demand = kind.must.of_drawn(drawn(kind, rng))
            assert demand.ends and End.UNSAFE not in demand.ends, kind.name


def test_a_case_can_be_written_down_and_read_again() -> None:
    for index, kind in enumerate(ROWS):
        case = CampaignPlan(3).case(index)
        assert case.fault == kind.name
        again = case_from_spec(case.spec, mission=case.mission, revision=case.revision, seed=case.seed, full=False)
        assert again == replace(case, index=0)
        assert f"--fault {case.spec}" in case.replay


def test_a_case_follows_from_seed_and_index_alone() -> None:
    forward = [CampaignPlan(9).case(index) for index in range(400)]
    backward = [CampaignPlan(9).case(index) for index in reversed(range(400))]
    assert forward == backward[::-1]
    assert forward != [CampaignPlan(10).case(index) for index in range(400)]


def test_every_kind_takes_its_turn_and_no_case_comes_twice() -> None:
    cases = [CampaignPlan(1).case(index) for index in range(3 * len(ROWS))]
    assert {case.fault for case in cases[: len(ROWS)]} == set(KINDS)
    assert len({(case.fault, case.spec, case.mission, case.revision) for case in cases}) == len(cases)


def test_cases_keep_to_the_missions_and_revisions_of_their_kind() -> None:
    for index in range(10 * len(ROWS)):
        case = CampaignPlan(2).case(index)
        assert case.mission in case.kind.missions and case.revision in case.kind.revisions
        if case.kind.from_start:
            assert (case.since, case.after_ms, case.leg_ms) == (Since.START, 0, None)
            continue
        assert case.leg_ms in LEGS_MS[case.mission]
        assert case.leg_ms < case.after_ms


def test_full_length_cases_begin_their_faults_in_every_phase() -> None:
    cases = [CampaignPlan(1).case(index, full=True) for index in range(400)]
    assert {case.since for case in cases} == set(Since)
    assert any(case.since is Since.DRIVING and case.after_ms < 3000 for case in cases)


def on_the_wire(kind: FaultKind) -> list[tuple[type, frozenset[int], bool]]:
    """What a kind does to messages: how, which, and whether as the car receives them."""
    sent, received = FaultyWire(), FaultyWire()
    vcu = SimpleNamespace(outgoing=sent, incoming=received)
    try:
        kind.begin(Ongoing(), SimpleNamespace(world=SimpleNamespace(vcu=vcu)), drawn(kind, random.Random(1)), 0)  # type: ignore[arg-type]
    except AttributeError:
        return []  # it is done to something else than messages
    faults = [(fault, wire is received) for wire in (sent, received) for fault in wire.faults]
    return [(type(fault), fault.ids, car) for fault, car in faults]


@pytest.mark.parametrize("can_id", [*range(0x510, 0x515), *range(0x520, 0x527)], ids=hex)
def test_every_message_gets_every_kind_of_bus_fault(can_id: int) -> None:
    done = {
        how
        for kind in ROWS
        for how, ids, by_car in on_the_wire(kind)
        if ids == frozenset({can_id}) and by_car is (can_id < 0x520)
    }
    assert {Drop, Delay, Freeze, Repeat, FlipBits, WrongLength} <= done


def test_drawn_out_of_range_values_are_so_for_every_car() -> None:
    kind = KINDS["controller_nan"]
    rng = random.Random(3)
    seen = {(values["field"], values["value"]) for values in (drawn(kind, rng) for _ in range(300))}
    assert seen == set(product(("steering_rad", "throttle", "brake"), ("nan", "inf", "beyond", "negative")))
    command = VehicleCommand(0, 1, 0.1, 0.2)
    for field, value in seen:
        changed: Any = no_number(command, At({"field": field, "value": value}, rng, 0, 0, {}))
        assert replace(command, **changed).problems(math.radians(30.0)), (field, value)


def test_each_drawn_clock_step_changes_the_age_of_50_ms_old_data() -> None:
    kind = KINDS["clock_stepped"]
    rng = random.Random(3)
    for _ in range(50):
        values = drawn(kind, rng)
        computer = SimpleNamespace(command_filter=None)
        kind.begin(Ongoing(), SimpleNamespace(computer=computer), values, 0)  # type: ignore[arg-type]
        command = VehicleCommand(0, 1)
        assert computer.command_filter(command, 50_000_000).t_sensor_ns == abs(values["step"]) * 1_000_000 > 0


def test_a_selection_narrows_faults_missions_and_revisions() -> None:
    plan = CampaignPlan(1, 0, 0, ("go_off", "planner_silent"), (Ami.SKIDPAD,), ("2021",), 1)
    cases = [plan.case(index) for index in range(20)]
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
        ("planner_silent", "does not apply to static_inspection_a"),
        ("motor_one_axle", "does not apply to revision 2026"),
    ],
)
def test_what_cannot_be_meant_is_refused_in_one_clear_line(spec: str, complaint: str) -> None:
    with pytest.raises(ValueError, match=complaint):
        case_from_spec(spec, mission=Ami.STATIC_INSPECTION_A, revision="2026", seed=0, full=False)


def test_a_fault_by_hand_keeps_what_is_given_and_draws_the_rest() -> None:
    case = case_from_spec("status_lost:duration=70", mission=None, revision="2026", seed=4, full=False)
    same = case_from_spec("status_lost:duration=70", mission=None, revision="2026", seed=4, full=False)
    other = case_from_spec("status_lost:duration=70", mission=None, revision="2026", seed=5, full=False)
    assert case == same != other
    assert case.params["duration"] == 70 and case.mission is Ami.AUTOCROSS


DOCUMENT = Path(__file__).resolve().parents[2] / "docs" / "evidence" / "faults.md"


def test_every_row_of_the_catalogue_is_in_the_documented_table() -> None:
    text = DOCUMENT.read_text()
    command = re.search(r"Made by `([^`]+)`", text)
    assert command, "docs/evidence/faults.md does not begin with its command: make campaign"
    renew = "docs/evidence/faults.md is renewed by " + re.sub(r"--runs \d+", f"--runs {len(ROWS)}", command[1])
    rows = [line.split(" | ") for line in text.splitlines() if line.startswith("| `")]
    documented = {row[0].strip("| `"): (row[1], row[2]) for row in rows}
    assert set(documented) == {kind.name for kind in ROWS}, renew
    for kind in ROWS:
        what, demanded = documented[kind.name]
        assert what.startswith(kind.what) and demanded == kind.must.demanded, f"{kind.name} has changed: {renew}"


def test_the_documented_campaign_has_its_origin_and_no_finding() -> None:
    text = DOCUMENT.read_text()
    assert re.search(r"Made by `fsai-vcu campaign --runs \d+ --full \d+ --seed \d+", text)
    assert re.search(r"\*\*Worse than the rules allow: 0 of \d+ runs\.\*\*", text)
