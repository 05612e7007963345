"""Filters let through what candump's let through."""

from __future__ import annotations

import pytest

from fsai_vcu.diagnostics.log.filters import FrameFilter, filtered, split_source
from fsai_vcu.diagnostics.log.frames import LogFrame, frames_of

HEARD = frames_of(
    [
        LogFrame(0, "can0", 0x520, bytes(8)),
        LogFrame(0, "can0", 0x521, bytes(6)),
        LogFrame(0, "can0", 0x123, b""),
        LogFrame(0, "can0", 0x123, b"", extended=True),
        LogFrame(0, "can0", 0x12345678, b"", extended=True),
        LogFrame(0, "can0", 0x123, remote=True),
        LogFrame(0, "can0", 0x040, bytes(8), error=True),
        LogFrame(0, "can0", 0x004, bytes(8), error=True),
    ]
)


@pytest.mark.parametrize(
    ("text", "rows"),
    [
        ("", [0, 1, 2, 3, 4, 5, 6, 7]),
        ("520:7FF", [0]),
        ("520:7F0", [0, 1]),
        ("520~7F0", [2, 3, 4, 5]),
        ("123:7FF", [2, 3, 5]),  # as candump's own help says: 29-bit and remote frames too
        ("123:C00007FF", [2]),
        ("00000123:DFFFFFFF", [3]),
        ("12345678:DFFFFFFF", [4]),
        ("520:7FF,123:C00007FF", [0, 2]),
        ("520~7FF,521~7FF,j", [2, 3, 4, 5]),
        ("520~7FF,521~7FF", [0, 1, 2, 3, 4, 5]),
        ("#FFFFFFFF", [0, 1, 2, 3, 4, 5, 6, 7]),
        ("0~0,#FFFFFFFF", [6, 7]),
        ("520:7FF,#00000040", [0, 6]),
    ],
)
def test_a_filter_lets_through_what_candump_lets_through(text: str, rows: list[int]) -> None:
    assert [row for row, passes in enumerate(FrameFilter.parse(text).passes(HEARD)) if passes] == rows


@pytest.mark.parametrize("text", ["520", "520:", ":7FF", "xyz:7FF", "#", "123456789:7FF", "520:7FF;1:1"])
def test_what_is_no_filter_is_refused_by_its_name(text: str) -> None:
    with pytest.raises(ValueError, match="' is not a filter; ") as refused:
        FrameFilter.parse(text)
    assert "\n" not in str(refused.value)


def test_each_interface_has_its_own_filter() -> None:
    heard = frames_of([LogFrame(0, name, can_id) for name in ("can0", "can1") for can_id in (1, 2)])
    rules = [split_source("can0,1:7FF"), split_source("can1")]
    assert [(f.channel, f.can_id) for f in filtered(heard, rules)] == [("can0", 1), ("can1", 1), ("can1", 2)]
