"""What the bridge's reports become in the log: each change once, and by how grave it is."""

from __future__ import annotations

from dataclasses import replace
from types import MappingProxyType

import pytest

from fsai_nodes.report_log import News, ReportLine
from fsai_vcu.core.bridge import Bridge
from fsai_vcu.core.driving import Run
from fsai_vcu.core.report import BridgeReport
from fsai_vcu.core.vehicle.parameters import CARS
from fsai_vcu.interface.codec import Codec
from fsai_vcu.interface.enums import AsState, ShutdownCause
from fsai_vcu.interface.messages import VcuStatus, VehicleState
from fsai_vcu.interface.revisions import revision
from fsai_vcu.interface.units import S

REPORT = Bridge(Codec(revision("2026")), revision("2026"), CARS["2026"], now_ns=0).report(0)


def nobody() -> str:
    raise AssertionError("asked for the silent one although no command is stale")


def car(as_state: AsState, cause: ShutdownCause | None = ShutdownCause.NO_SHUTDOWN) -> BridgeReport:
    status = VcuStatus(as_state=as_state, shutdown_cause=cause)
    return replace(REPORT, run=Run(1, as_state=as_state), vehicle=VehicleState(status=status))


def counted(t_ns: int, **counts: int) -> BridgeReport:
    return replace(REPORT, t_ns=t_ns, reason_counts=MappingProxyType(counts))


def started() -> News:
    news = News()
    news.of(REPORT, nobody)
    return news


@pytest.mark.parametrize("cause", [each for each in ShutdownCause if each is not ShutdownCause.NO_SHUTDOWN])
def test_emergency_brake_is_an_error_with_its_cause_in_words(cause: ShutdownCause) -> None:
    news = started()
    news.of(car(AsState.AS_DRIVING), nobody)
    (line,) = news.of(car(AsState.EMERGENCY_BRAKE, cause), nobody)
    assert line.level == "error"
    assert line.text.startswith(f"AS state EMERGENCY_BRAKE: SHUTDOWN_CAUSE {cause.label}, ")
    assert len(line.text.partition(f"{cause.label}, ")[2].split()) > 3
    assert news.of(car(AsState.EMERGENCY_BRAKE, cause), nobody) == []


def test_a_cause_that_comes_later_or_is_unknown_is_said_too() -> None:
    news = started()
    (first,) = news.of(car(AsState.EMERGENCY_BRAKE), nobody)
    assert first == ReportLine("AS state EMERGENCY_BRAKE: SHUTDOWN_CAUSE NO_SHUTDOWN", "error")
    (second,) = news.of(car(AsState.EMERGENCY_BRAKE, ShutdownCause.BMS_FAULT), nobody)
    assert "BMS_FAULT" in second.text
    (third,) = news.of(car(AsState.EMERGENCY_BRAKE, None), nobody)
    assert third.text.endswith("SHUTDOWN_CAUSE is unknown")


def test_other_states_are_no_errors() -> None:
    news = started()
    for as_state in (AsState.AS_OFF, AsState.AS_READY, AsState.AS_DRIVING, AsState.AS_FINISHED):
        (line,) = news.of(car(as_state), nobody)
        assert line == ReportLine(f"AS state {as_state.label}", "info")


def test_a_missed_deadline_is_an_error_in_any_as_state() -> None:
    news = started()
    (line,) = news.of(replace(REPORT, t_ns=S, loop_faults=1), nobody)
    assert line == ReportLine("the loop failed or missed its deadline by 50 ms", "error")
    assert news.of(replace(REPORT, t_ns=3 * S, loop_faults=1), nobody) == []


def test_a_deadline_missed_while_driving_is_one_line_with_detail() -> None:
    driving = replace(
        counted(S, loop_fault=2),
        loop_faults=2,
        reason_details=MappingProxyType({"loop_fault": "the loop was 60 ms late"}),
    )
    (line,) = started().of(driving, nobody)
    assert line.level == "error"
    assert line.text.endswith("(the loop was 60 ms late) [2 times]")


def test_a_stale_command_is_an_error_that_names_the_silent_node() -> None:
    (line,) = started().of(counted(S, command_stale=1), lambda: "/vehicle_cmd of driver has been silent for 120 ms")
    assert line.level == "error"
    assert line.text.endswith("(/vehicle_cmd of driver has been silent for 120 ms)")


def test_another_reason_is_a_warning_once_a_second_with_count() -> None:
    news = started()
    (line,) = news.of(counted(S, steer_clamped=1), nobody)
    assert line.level == "warning"
    assert news.of(counted(S + S // 2, steer_clamped=5), nobody) == []
    (line,) = news.of(counted(2 * S, steer_clamped=7), nobody)
    assert line.text.endswith("[6 times]")
