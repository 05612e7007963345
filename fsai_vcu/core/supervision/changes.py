"""Changes that 0x520 must not show while the car drives, though FAULT_STATUS stays 0.

Only edges count: what this VCU never sets, or what was so before AS_DRIVING, says nothing.
"""

from __future__ import annotations

from fsai_vcu.core.supervision.config import Reason
from fsai_vcu.interface.enums import EbsState, OpState, ShutdownCause, TsState
from fsai_vcu.interface.messages import VcuStatus

_STATES = (
    ("EBS_STATE", "ebs_state", EbsState.EBS_FAULT),
    ("TS_STATE", "ts_state", TsState.TS_FAULT),
    ("OP_STATE", "op_state", OpState.OP_FAULT),
)
"""States in 0x520 (2026), each with its fault. A value that no table knows is decoded as the fault."""


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
    states = [name for name, field, fault in _STATES if getattr(now, field) is fault is not getattr(before, field)]
    if states:
        found.append((Reason.STATE_FAULT, ", ".join(states)))
    if now.ami is not before.ami:
        found.append((Reason.AMI_CHANGED, f"{before.ami.label} to {now.ami.label}"))
    return found
