"""What the bridge's reports become in the log: each change once, and by how grave it is."""

from __future__ import annotations

from types import MappingProxyType

import pytest
from msgspec.structs import replace

from fsai_nodes.report_log import Culprit, News, ReportLine
from fsai_vcu.core.bridge import Bridge
from fsai_vcu.core.driving import Run
from fsai_vcu.core.report import BridgeReport
from fsai_vcu.core.supervision.config import words_of
from fsai_vcu.core.vehicle.parameters import CARS
from fsai_vcu.interface.codec import Codec
from fsai_vcu.interface.enums import AsState, ShutdownCause
from fsai_vcu.interface.messages import VcuStatus, VehicleState
from fsai_vcu.interface.revisions import revision
from fsai_vcu.interface.units import S

REPORT = Bridge(Codec(revision("2026")), revision("2026"), CARS["2026"], now_ns=0).report(0)


def car(as_state: AsState, cause: ShutdownCause | None = ShutdownCause.NO_SHUTDOWN) -> BridgeReport:
    status = VcuStatus(as_state=as_state, shutdown_cause=cause)
    return replace(REPORT, run=Run(1, as_state=as_state), vehicle=VehicleState(status=status))


def counted(t_ns: int, **counts: int) -> BridgeReport:
    return replace(REPORT, t_ns=t_ns, reason_counts=MappingProxyType(counts))


def started() -> News:
    news = News()
    news.of(REPORT)
    return news


@pytest.mark.parametrize("cause", [each for each in ShutdownCause if each is not ShutdownCause.NO_SHUTDOWN])
def test_emergency_brake_is_an_error_with_its_cause_in_words(cause: ShutdownCause) -> None:
    news = started()
    news.of(car(AsState.AS_DRIVING))
    (line,) = news.of(car(AsState.EMERGENCY_BRAKE, cause))
    assert line.level == "error"
    assert line.text.startswith(f"AS state EMERGENCY_BRAKE: SHUTDOWN_CAUSE {cause.label}, ")
    assert len(line.text.partition(f"{cause.label}, ")[2].split()) > 3
    assert news.of(car(AsState.EMERGENCY_BRAKE, cause)) == []


def test_a_cause_that_comes_later_or_is_unknown_is_said_too() -> None:
    news = started()
    (first,) = news.of(car(AsState.EMERGENCY_BRAKE))
    assert first == ReportLine("AS state EMERGENCY_BRAKE: SHUTDOWN_CAUSE NO_SHUTDOWN", "error")
    (second,) = news.of(car(AsState.EMERGENCY_BRAKE, ShutdownCause.BMS_FAULT))
    assert "BMS_FAULT" in second.text
    (third,) = news.of(car(AsState.EMERGENCY_BRAKE, None))
    assert third.text.endswith("SHUTDOWN_CAUSE is unknown")


def test_other_states_are_no_errors() -> None:
    news = started()
    for as_state in (AsState.AS_OFF, AsState.AS_READY, AsState.AS_DRIVING, AsState.AS_FINISHED):
        (line,) = news.of(car(as_state))
        assert line == ReportLine(f"AS state {as_state.label}", "info")


def test_a_missed_deadline_is_an_error_in_any_as_state() -> None:
    news = started()
    (line,) = news.of(replace(REPORT, t_ns=S, loop_faults=1))
    assert line == ReportLine("the loop failed or missed its deadline by 50 ms", "error")
    assert news.of(replace(REPORT, t_ns=3 * S, loop_faults=1)) == []


def test_a_deadline_missed_while_driving_is_one_line_with_detail() -> None:
    driving = replace(
        counted(S, loop_fault=2),
        loop_faults=2,
        reason_details=MappingProxyType({"loop_fault": "the loop was 60 ms late"}),
    )
    (line,) = started().of(driving)
    assert line.level == "error"
    assert line.text.endswith("(the loop was 60 ms late) [2 times]")


STALE = words_of("command_stale")


def test_a_stale_command_is_an_error_that_names_the_silent_node() -> None:
    stale = replace(counted(S, command_stale=1), reasons=("command_stale",), reason_details={"command_stale": "100 ms"})
    named = Culprit().named(stale, lambda: "/vehicle_cmd of driver: nothing received for 60 ms")
    (line,) = started().of(named)
    assert line == ReportLine(f"{STALE} (/vehicle_cmd of driver: nothing received for 60 ms)", "error")
    assert named.sentences == (line.text,)


def test_the_stop_that_follows_keeps_the_silent_nodes_name() -> None:
    words = iter(["driver: 60 ms", "driver: 250 ms"])
    culprit = Culprit()
    stale = replace(counted(S, command_stale=1), reasons=("command_stale",))
    stopping = f"{STALE}: no command for 300 ms"
    stopped = replace(
        stale, stopping=stopping, why_not_driving=(f"stopping for the rest of the run because {stopping}", "no mission")
    )
    assert culprit.named(stale, lambda: next(words)).reason_details["command_stale"] == "driver: 60 ms"
    for report in (stopped, replace(stopped, reasons=())):
        named = culprit.named(report, lambda: next(words))
        assert named.stopping == f"{STALE}: driver: 250 ms"
        assert named.why_not_driving == (
            f"stopping for the rest of the run because {STALE}: driver: 250 ms",
            "no mission",
        )


def test_nobody_is_named_where_no_command_is_stale() -> None:
    report = replace(counted(S, steer_clamped=1), stopping="manual mode was asked for")
    assert Culprit().named(report, lambda: "nobody") is report


def test_another_reason_is_a_warning_once_a_second_with_count() -> None:
    news = started()
    (line,) = news.of(counted(S, steer_clamped=1))
    assert line.level == "warning"
    assert news.of(counted(S + S // 2, steer_clamped=5)) == []
    (line,) = news.of(counted(2 * S, steer_clamped=7))
    assert line.text.endswith("[6 times]")
