"""What 0x520 must not change while the car drives, though FAULT_STATUS stays 0.

Edges only: a bit that this VCU never sets, or that was set before AS_DRIVING, says nothing.
"""

from __future__ import annotations

from fsai_vcu.core.supervision.reasons import Reason
from fsai_vcu.interface.enums import ShutdownCause
from fsai_vcu.interface.messages import VcuStatus


def changes(before: VcuStatus, now: VcuStatus) -> list[tuple[Reason, str]]:
    """The edges between two frames of 0x520 that end a drive, each with its detail."""
    found: list[tuple[Reason, str]] = []
    if before.as_switch and not now.as_switch:
        found.append((Reason.AS_SWITCH_OFF, ""))
    if before.ts_switch and not now.ts_switch:
        found.append((Reason.TS_SWITCH_OFF, ""))
    if now.shutdown_request and not before.shutdown_request:
        found.append((Reason.SHUTDOWN_REQUESTED, ""))
    if now.faults != before.faults:
        risen = [name for name in now.faults.names if name not in before.faults.names]
        if risen:
            found.append((Reason.FAULT_BIT, ", ".join(risen)))
    if before.shutdown_cause is ShutdownCause.NO_SHUTDOWN and now.shutdown_cause is not ShutdownCause.NO_SHUTDOWN:
        cause = now.shutdown_cause
        found.append((Reason.SHUTDOWN_CAUSE, "a value that no table knows" if cause is None else cause.label))
    return found
