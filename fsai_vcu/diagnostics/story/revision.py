"""Which interface revision a log was written under, told from its frames, with the reason."""

from __future__ import annotations

import numpy as np

from fsai_vcu.diagnostics.frames import ERROR, EXTENDED, REMOTE, Frames
from fsai_vcu.interface.bus_table import BY_ID, BY_NAME
from fsai_vcu.interface.revisions import REVISIONS, Revision

# Bits of 0x520 that only one revision names: OP_STATE, TS_STATE and EBS_STATE are four bits each (2026).
_STATES_2026 = np.uint64(0xF << 4 | 0xF << 28 | 0xF << 36)
_TENTHS = 0.1  # interface specification v4.0: angles in 0x523 are tenths of a degree


def guess_revision(frames: Frames) -> tuple[Revision, str]:
    """The revision that fits the frames best, and the observation that says so."""
    plain = (frames.flags & (ERROR | EXTENDED | REMOTE)) == 0
    ids = frames.can_id[plain]
    present = set(np.unique(ids).tolist())
    status = frames.word[plain & (frames.can_id == BY_NAME["VCU2AI_Status"].can_id) & (frames.length == 8)]
    if (status & _STATES_2026).any():
        return REVISIONS["2026"], "0x520 carries OP_STATE, TS_STATE or EBS_STATE"
    for name in REVISIONS:
        only = sorted(i for i in present if i in BY_ID and set(BY_ID[i].period_ns) == {name})
        if only:
            return REVISIONS[name], f"{BY_ID[only[0]].name} (0x{only[0]:03X}) is only in {name}"
    steer = frames.word[plain & (frames.can_id == BY_NAME["VCU2AI_Steer"].can_id) & (frames.length == 6)]
    if len(steer):
        most = float(((steer >> np.uint64(16)) & np.uint64(0xFFFF)).max()) * _TENTHS
        if most > REVISIONS["2021"].steer_limit_deg:
            return REVISIONS["2026"], f"ANGLE_MAX is {most:g} deg"
        if most == REVISIONS["2021"].steer_limit_deg:
            return REVISIONS["2021"], f"ANGLE_MAX is {most:g} deg"
    if len(status) and (((status >> np.uint64(16)) & np.uint64(0xF)) == 0).any():
        return REVISIONS["2026"], "AS_STATE is 0 (AS_INIT) at times"
    latest = list(REVISIONS)[-1]
    return REVISIONS[latest], f"nothing in the log tells: the latest, {latest}, is taken"
