"""The bridge's report as diagnostic_msgs: levels, and every number that a person looks for first."""

from __future__ import annotations

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from fsai_vcu.core.report import BridgeReport, loop_fault_words
from fsai_vcu.runtime.loop_handle import NOT_DECODED


def _status(name: str, level: bytes, message: str, values: dict[str, object]) -> DiagnosticStatus:
    return DiagnosticStatus(
        level=level,
        name=f"vcu_bridge: {name}",
        message=message,
        hardware_id="ADS-DV",
        values=[KeyValue(key=key, value=str(value)) for key, value in values.items()],
    )


def _ms(value_ns: int | None) -> str:
    return "never" if value_ns is None else f"{value_ns / 1e6:.1f}"


def diagnostics_of(report: BridgeReport, stamp: Time, more: dict[str, object]) -> DiagnosticArray:
    """Make a DiagnosticArray of the report. `more`: what the runtime adds about its loop."""
    message = DiagnosticArray()
    message.header.stamp = stamp
    message.status = [_link(report), _supervision(report), _car(report), _loop(report, more)]
    return message


def _link(report: BridgeReport) -> DiagnosticStatus:
    """Return the status of the link: gaps, response times, and ages and counts of messages."""
    values: dict[str, object] = {
        "gaps of 0x520": report.vcu_gaps,
        "response time ms": _ms(report.response_ns),
        "response time max ms": _ms(report.response_max_ns),
        **{f"age of {name} ms": _ms(age_ns) for name, age_ns in report.ages_ns.items()},
        **{f"received 0x{can_id:03X}": count for can_id, count in sorted(report.rx_counts.items())},
        **report.problem_counts,
        **({"not known": report.unknown} if report.unknown else {}),
    }
    if report.bus_lost is not None:
        return _status("link", DiagnosticStatus.ERROR, f"bus lost: {report.bus_lost}", values)
    if report.vcu_lost:
        return _status("link", DiagnosticStatus.ERROR, "nothing is received from the VCU (0x520)", values)
    if report.problem_counts:
        return _status("link", DiagnosticStatus.WARN, "frames were received that are not believed", values)
    return _status("link", DiagnosticStatus.OK, "the VCU's messages are received", values)


def _supervision(report: BridgeReport) -> DiagnosticStatus:
    """Return the status of the supervision: mode, phase and run, and what was wrong how often."""
    values: dict[str, object] = {
        "mode": report.mode,
        "phase": report.phase,
        "run_id": report.run.run_id,
        "mission": report.run.mission.label,
        "reset confirmed by": ", ".join(report.confirmed) or "nobody",
        "listen_only": report.listen_only,
        "emergency": report.emergency or "",
        "stopping": report.stopping or "",
        **{f"why not driving {index}": words for index, words in enumerate(report.why_not_driving, 1)},
        **{f"count of {slug}": count for slug, count in sorted(report.reason_counts.items())},
        **{f"last detail of {slug}": detail for slug, detail in sorted(report.reason_details.items()) if detail},
        **dict(line.split(" = ", 1) for line in report.limits.described()),
    }
    if report.emergency is not None:
        return _status("supervision", DiagnosticStatus.ERROR, f"ESTOP_REQUEST: {report.emergency}", values)
    if report.stopping is not None:
        return _status("supervision", DiagnosticStatus.WARN, f"stopping: {report.stopping}", values)
    if report.reasons:
        return _status("supervision", DiagnosticStatus.WARN, "; ".join(report.sentences), values)
    if report.run.may_move and report.why_not_driving:
        return _status("supervision", DiagnosticStatus.WARN, "; ".join(report.why_not_driving), values)
    words = "listening only: nothing is sent" if report.listen_only else report.phase
    return _status("supervision", DiagnosticStatus.OK, words, values)


def _car(report: BridgeReport) -> DiagnosticStatus:
    """Return the status of the car: its states, switches and faults."""
    status = report.vehicle.status
    if status is None:
        return _status("car", DiagnosticStatus.STALE, "nothing received yet", {})
    faults = status.faults.names
    cause = "" if status.shutdown_cause is None else status.shutdown_cause.label
    values: dict[str, object] = {
        "AS state": status.as_state.label,
        "AMI": status.ami.label,
        "ASMS": "unknown" if status.as_switch is None else status.as_switch,
        "TSMS": "unknown" if status.ts_switch is None else status.ts_switch,
        "Go": status.go_signal,
        "steering": "unknown" if status.steering_status is None else status.steering_status.label,
        "shutdown cause": cause,
        "battery temperature high": status.warn_batt_temp_high,
        "battery low": status.warn_batt_soc_low,
    }
    for name in ("op_state", "ts_state", "ebs_state"):
        value = getattr(status, name)
        if value is not None:
            values[name] = value.label
    brake = report.vehicle.brake
    if brake is not None:
        values["STATUS_BRK"] = "unknown" if brake.brake_status is None else brake.brake_status.label
        values["STATUS_EBS"] = "unknown" if brake.ebs_status is None else brake.ebs_status.label
    if status.fault or faults:
        words = ", ".join(faults) or "FAULT_STATUS"
        return _status("car", DiagnosticStatus.ERROR, words + (f" (shutdown cause {cause})" if cause else ""), values)
    if status.warning:
        return _status("car", DiagnosticStatus.WARN, "WARNING_STATUS", values)
    return _status("car", DiagnosticStatus.OK, status.as_state.label, values)


def _loop(report: BridgeReport, more: dict[str, object]) -> DiagnosticStatus:
    values: dict[str, object] = {
        "cycles": report.cycles,
        "incomplete cycles": report.incomplete_cycles,
        "loop faults": report.loop_faults,
        **more,
    }
    if any(count for key, count in more.items() if key.endswith(NOT_DECODED)):
        words = "messages between the node and its CAN loop were not understood"
        return _status("loop", DiagnosticStatus.WARN, words, values)
    if busy := loop_fault_words(report.loop_faults):
        return _status("loop", DiagnosticStatus.WARN, busy, values)
    return _status("loop", DiagnosticStatus.OK, "in time", values)
