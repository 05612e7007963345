"""Which interface revision a log was written under, told from its frames, with the reason."""

from __future__ import annotations

from typing import Final

import numpy as np

from fsai_vcu.diagnostics.log.frames import ERROR, EXTENDED, REMOTE, Frames
from fsai_vcu.interface.bus_table import BY_ID, BY_NAME
from fsai_vcu.interface.revisions import REVISIONS, Revision, revision_by_init, revision_by_status, revision_by_steer

_STATUS: Final = (BY_NAME["VCU2AI_Status"].can_id, 8)
_STEER: Final = (BY_NAME["VCU2AI_Steer"].can_id, 6)


def guess_revision(frames: Frames) -> tuple[Revision, str]:
    """The revision that fits the frames best, and the observation that says so; the latest where nothing does."""
    latest = list(REVISIONS)[-1]
    return told_revision(frames) or (REVISIONS[latest], f"nothing in the log tells: the latest, {latest}, is taken")


def told_revision(frames: Frames) -> tuple[Revision, str] | None:
    """The revision that the frames tell, and the observation; None if they are the same in all."""
    plain = (frames.flags & (ERROR | EXTENDED | REMOTE)) == 0
    status, steer = (
        np.unique(frames.word[plain & (frames.can_id == can_id) & (frames.length == length)]).tolist()
        for can_id, length in (_STATUS, _STEER)
    )
    told = next((found for word in status if (found := revision_by_status(word)) is not None), None)
    if told is not None:
        return REVISIONS[told[0]], told[1]
    present = np.unique(frames.can_id[plain]).tolist()
    for name in REVISIONS:
        only = [i for i in present if i in BY_ID and set(BY_ID[i].period_ns) == {name}]
        if only:
            return REVISIONS[name], f"{BY_ID[only[0]].name} (0x{only[0]:03X}) is only in {name}"
    last = revision_by_steer(steer) or revision_by_init(status)
    return None if last is None else (REVISIONS[last[0]], last[1])
