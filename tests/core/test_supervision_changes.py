"""What changes in 0x520 while the car drives: each edge is named, and nothing that does not change is one."""

from __future__ import annotations

from typing import Any

import pytest
from msgspec.structs import replace

from fsai_vcu.core.supervision.changes import changes
from fsai_vcu.core.supervision.reasons import Reason
from fsai_vcu.interface.enums import ShutdownCause
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


def test_edges_that_come_together_are_all_told() -> None:
    odd = VcuStatus(shutdown_request=True, faults=Faults(bms=True), shutdown_cause=ShutdownCause.BMS_FAULT)
    assert [reason for reason, _ in changes(WELL, odd)] == [
        Reason.AS_SWITCH_OFF,
        Reason.TS_SWITCH_OFF,
        Reason.SHUTDOWN_REQUESTED,
        Reason.FAULT_BIT,
        Reason.SHUTDOWN_CAUSE,
    ]
