"""What changes in 0x520 while the car drives: each edge is named, and nothing that does not change is one."""

from __future__ import annotations

from itertools import product
from typing import Any

import pytest
from msgspec.structs import replace

from fsai_vcu.core.supervision.changes import changes
from fsai_vcu.core.supervision.config import Reason
from fsai_vcu.interface.enums import Ami, EbsState, OpState, ShutdownCause, TsState
from fsai_vcu.interface.messages import FAULT_NAMES, Faults, VcuStatus

WELL = VcuStatus(as_switch=True, ts_switch=True, shutdown_cause=ShutdownCause.NO_SHUTDOWN)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"as_switch": False}, Reason.AS_SWITCH_OFF),
        ({"ts_switch": False}, Reason.TS_SWITCH_OFF),
        ({"shutdown_request": True}, Reason.SHUTDOWN_REQUESTED),
    ],
)
def test_an_edge_is_found_in_one_direction_only(change: dict[str, Any], reason: Reason) -> None:
    odd = replace(WELL, **change)
    assert changes(WELL, odd) == [(reason, "")]
    assert changes(odd, odd) == changes(odd, WELL) == changes(WELL, WELL) == []


@pytest.mark.parametrize(("field", "name"), FAULT_NAMES.items())
@pytest.mark.parametrize("before", [False, None])
def test_each_fault_bit_is_named_as_in_the_database(field: str, name: str, before: bool | None) -> None:
    clear, risen = (replace(WELL, faults=Faults(**{field: bit})) for bit in (before, True))
    assert changes(clear, risen) == [(Reason.FAULT_BIT, name)]
    assert changes(risen, risen) == changes(risen, clear) == []


def test_a_fault_that_rises_beside_an_old_one_is_named_alone() -> None:
    before, now = Faults(bms=True, ebs=False, hvil_open=False), Faults(bms=True, ebs=True, hvil_open=True)
    assert changes(replace(WELL, faults=before), replace(WELL, faults=now)) == [
        (Reason.FAULT_BIT, "HVIL_OPEN_FAULT, EBS_FAULT")
    ]


@pytest.mark.parametrize("cause", [cause for cause in ShutdownCause if cause is not ShutdownCause.NO_SHUTDOWN])
def test_a_shutdown_cause_that_rises_is_told_by_its_label(cause: ShutdownCause) -> None:
    odd = replace(WELL, shutdown_cause=cause)
    assert changes(WELL, odd) == [(Reason.SHUTDOWN_CAUSE, cause.label)]
    assert changes(odd, odd) == changes(odd, WELL) == []
    assert changes(odd, replace(WELL, shutdown_cause=ShutdownCause.EBS_FAULT)) == []


def test_a_shutdown_cause_outside_the_table_is_one_too() -> None:
    odd = replace(WELL, shutdown_cause=None)
    assert changes(WELL, odd) == [(Reason.SHUTDOWN_CAUSE, "a value that no table knows")]
    assert changes(odd, odd) == changes(odd, WELL) == []


STATES: list[tuple[str, type[EbsState | TsState | OpState], int]] = [
    ("ebs_state", EbsState, EbsState.EBS_FAULT),
    ("ts_state", TsState, TsState.TS_FAULT),
    ("op_state", OpState, OpState.OP_FAULT),
]


@pytest.mark.parametrize(("field", "kind", "fault"), STATES)
def test_a_state_that_becomes_fault_is_named(field: str, kind: Any, fault: int) -> None:
    odd = replace(WELL, **{field: fault})
    for sound in (*(state for state in kind if state is not fault), None):
        before = replace(WELL, **{field: sound})
        assert changes(before, odd) == [(Reason.STATE_FAULT, field.upper())]
        assert changes(odd, before) == changes(before, before) == []
    assert changes(odd, odd) == []


@pytest.mark.parametrize(("field", "kind", "fault"), STATES)
def test_states_that_become_anything_else_say_nothing(field: str, kind: Any, fault: int) -> None:
    """The official simulator leaves them 0, and a car of 2021 has none."""
    for before in kind:
        for now in (*(state for state in kind if state is not fault), None):
            assert changes(replace(WELL, **{field: before}), replace(WELL, **{field: now})) == []


def test_states_that_become_fault_together_are_named_together() -> None:
    before = replace(WELL, ts_state=TsState.TS_FAULT)
    now = replace(before, ebs_state=EbsState.EBS_FAULT, op_state=OpState.OP_FAULT)
    assert changes(before, now) == [(Reason.STATE_FAULT, "EBS_STATE, OP_STATE")]


def test_an_ami_that_turns_to_another_mission_or_none_is_named() -> None:
    for before, now in product(Ami, Ami):
        turned = [] if before is now else [(Reason.AMI_CHANGED, f"{before.label} to {now.label}")]
        assert changes(replace(WELL, ami=before), replace(WELL, ami=now)) == turned


def test_edges_that_come_together_are_all_told() -> None:
    odd = VcuStatus(
        shutdown_request=True,
        faults=Faults(bms=True),
        shutdown_cause=ShutdownCause.BMS_FAULT,
        ts_state=TsState.TS_FAULT,
        ami=Ami.SKIDPAD,
    )
    assert [reason for reason, _ in changes(WELL, odd)] == [
        Reason.AS_SWITCH_OFF,
        Reason.TS_SWITCH_OFF,
        Reason.SHUTDOWN_REQUESTED,
        Reason.FAULT_BIT,
        Reason.SHUTDOWN_CAUSE,
        Reason.STATE_FAULT,
        Reason.AMI_CHANGED,
    ]
