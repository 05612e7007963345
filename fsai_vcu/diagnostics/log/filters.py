"""candump's filters on columns: `520:7FF`, `520~7FF`, `#FFFFFFFF`, and `j` to join them by "and"."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from fsai_vcu.diagnostics.log.frames import ERROR, EXTENDED, REMOTE, Frames, Mask

# linux/can.h
_EFF_FLAG: Final = 0x8000_0000
_RTR_FLAG: Final = 0x4000_0000
_ERR_FLAG: Final = 0x2000_0000

_ID_FILTER = re.compile(r"([0-9A-Fa-f]{1,8})([:~])([0-9A-Fa-f]{1,8})")
_ERROR_FILTER = re.compile(r"#([0-9A-Fa-f]{1,8})")


@dataclass(frozen=True, slots=True)
class FrameFilter:
    """Filter that lets through what candump would.

    ids: (id, mask, inverted) with SocketCAN's flag bits; none: every data and remote frame. joined: all of them must
    match, not any. error_mask: classes of error frames to let through; None: not given.
    """

    ids: tuple[tuple[int, int, bool], ...] = ()
    joined: bool = False
    error_mask: int | None = None

    @classmethod
    def parse(cls, text: str) -> FrameFilter:
        """Parse what stands behind the interface on candump's command line. Raises ValueError with one clear line."""
        ids: list[tuple[int, int, bool]] = []
        join, error_mask = False, None
        for word in filter(None, text.split(",")):
            if word in ("j", "J"):
                join = True
            elif found := _ERROR_FILTER.fullmatch(word):
                error_mask = int(found[1], 16)
            elif found := _ID_FILTER.fullmatch(word):
                number = int(found[1], 16) | (_EFF_FLAG if len(found[1]) == 8 else 0)
                ids.append((number, int(found[3], 16) & ~_ERR_FLAG, found[2] == "~"))
            else:
                raise ValueError(f"'{word}' is not a filter; a filter is ID:MASK, ID~MASK or #ERRORMASK, as in 520:7FF")
        return cls(tuple(ids), join, error_mask)

    def __bool__(self) -> bool:
        """Return true where anything was asked for at all; without a filter everything is shown, error frames too."""
        return bool(self.ids) or self.error_mask is not None

    def passes(self, frames: Frames) -> Mask:
        """Select the frames that candump would show."""
        if not self:
            return np.ones(len(frames), np.bool_)
        error = (frames.flags & ERROR) != 0
        number = frames.can_id.astype(np.uint32)
        number |= np.where(frames.flags & EXTENDED, np.uint32(_EFF_FLAG), np.uint32(0))
        number |= np.where(frames.flags & REMOTE, np.uint32(_RTR_FLAG), np.uint32(0))
        matches = [
            ((number & np.uint32(mask)) == np.uint32(can_id & mask)) != inverted for can_id, mask, inverted in self.ids
        ]
        shown: Mask = np.ones(len(frames), np.bool_)
        if matches:
            shown = np.logical_and.reduce(matches) if self.joined else np.logical_or.reduce(matches)
        passed: Mask = (shown & ~error) | (error & ((frames.can_id & np.uint32(self.error_mask or 0)) != 0))
        return passed


def split_source(text: str) -> tuple[str, FrameFilter]:
    """`can0,520:7FF` as (interface or file, filter). Raises ValueError."""
    name, filters = name_and_filters(text)
    return name, FrameFilter.parse(filters)


def name_and_filters(text: str) -> tuple[str, str]:
    """The longest name in front of a comma, or without one, that is a file's; without any what is before the first."""
    ends = [len(text), *(found.start() for found in re.finditer(",", text))]
    there = [end for end in ends if os.path.exists(text[:end])]  # noqa: PTH110  a name that can be none is none
    end = max(there, default=min(ends))
    return text[:end], text[end + 1 :]


def filtered(frames: Frames, filters: Sequence[tuple[str, FrameFilter]]) -> Frames:
    """The frames that the filter of their channel lets through."""
    if not any(rule for _, rule in filters):
        return frames
    shown = np.zeros(len(frames), np.bool_)
    for name, rule in filters:
        ours = [index for index, channel in enumerate(frames.channels) if channel == name]
        shown |= rule.passes(frames) & np.isin(frames.channel, ours)
    return frames.only(shown)
