"""Interface revision under which a log was written, told from its frames, with the reason."""

from __future__ import annotations

from typing import Final

import numpy as np

from fsai_vcu.diagnostics.log.frames import ERROR, EXTENDED, REMOTE, Frames
from fsai_vcu.interface.bus_table import BY_ID, BY_NAME
from fsai_vcu.interface.revisions import REVISIONS, Revision, revision_by_init, revision_by_status, revision_by_steer

_STATUS: Final = (BY_NAME["VCU2AI_Status"].can_id, 8)
_STEER: Final = (BY_NAME["VCU2AI_Steer"].can_id, 6)
_NOT_PLAIN: Final = ERROR | EXTENDED | REMOTE


def guess_revision(frames: Frames) -> tuple[Revision, str]:
    """The revision that fits the frames best, and the observation that says so; the latest where nothing does."""
    latest = list(REVISIONS)[-1]
    return told_revision(frames) or (REVISIONS[latest], f"the log does not show it: the latest, {latest}, is assumed")


def told_revision(frames: Frames) -> tuple[Revision, str] | None:
    """The revision that the frames tell, and the observation; None if they are the same in all."""
    status = _words(frames, *_STATUS)
    told = next((found for word in status if (found := revision_by_status(word)) is not None), None)
    if told is not None:
        return REVISIONS[told[0]], told[1]
    present = np.unique(frames.can_id[(frames.flags & _NOT_PLAIN) == 0]).tolist()
    for name in REVISIONS:
        only = [i for i in present if i in BY_ID and set(BY_ID[i].period_ns) == {name}]
        if only:
            return REVISIONS[name], f"{BY_ID[only[0]].name} (0x{only[0]:03X}) is only in {name}"
    last = revision_by_steer(_words(frames, *_STEER)) or revision_by_init(status)
    return None if last is None else (REVISIONS[last[0]], last[1])


def _words(frames: Frames, can_id: int, length: int) -> list[int]:
    """The distinct payloads of that message."""
    rows = np.flatnonzero(frames.can_id == can_id)
    rows = rows[((frames.flags[rows] & _NOT_PLAIN) == 0) & (frames.length[rows] == length)]
    words: list[int] = np.unique(frames.word[rows]).tolist()
    return words
