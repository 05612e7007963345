"""When the five frames go out: requirements of the loop's timing, in virtual time."""

from __future__ import annotations

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fsai_vcu.interface.specification import PERIOD_NS
from fsai_vcu.interface.units import MS
from fsai_vcu.runtime.pacing import FALLBACK_AFTER_NS, MIN_GAP_NS, Pacing


def settled(now_ns: int = 0) -> Pacing:
    """A pacing that has just sent at `now_ns`, in answer to a 0x520."""
    pacing = Pacing(now_ns)
    pacing.on_status(now_ns)
    pacing.on_sent(now_ns)
    return pacing


@pytest.mark.parametrize(
    ("status_ms", "due_ns"),
    [
        ((), FALLBACK_AFTER_NS),
        ((10,), 10 * MS),  # answered at once,
        ((3,), MIN_GAP_NS),  # but not sooner than 8 ms after the last send;
        ((3, 7), MIN_GAP_NS),  # a second one does not delay the answer
    ],
)
def test_a_status_frame_is_answered_as_soon_as_the_gap_allows(status_ms: tuple[int, ...], due_ns: int) -> None:
    pacing = settled(0)
    for at_ms in status_ms:
        pacing.on_status(at_ms * MS)
    assert pacing.due_ns() == due_ns


def test_fallback_keeps_its_10_ms_grid_in_spite_of_lateness() -> None:
    pacing = settled(0)
    pacing.on_sent(FALLBACK_AFTER_NS + MS)  # 1 ms late
    assert pacing.due_ns() == FALLBACK_AFTER_NS + PERIOD_NS
    pacing.on_sent(pacing.due_ns())
    assert pacing.due_ns() == FALLBACK_AFTER_NS + 2 * PERIOD_NS


def test_fallback_does_not_burst_after_a_long_delay() -> None:
    pacing = settled(0)
    pacing.on_sent(200 * MS)
    assert pacing.due_ns() == 210 * MS


def test_the_first_status_frame_ends_the_fallback() -> None:
    pacing = settled(0)
    pacing.on_sent(15 * MS)
    pacing.on_sent(25 * MS)
    pacing.on_status(34 * MS)
    assert pacing.due_ns() == 34 * MS


@given(st.lists(st.tuples(st.integers(0, 30 * MS), st.booleans()), max_size=200))
def test_sends_are_8_to_15_ms_apart(
    events: list[tuple[int, bool]],
) -> None:
    """Whatever arrives when, a loop that polls on time sends neither too often nor too seldom."""
    now_ns, pacing, sends = 0, Pacing(0), []
    for wait_ns, is_status in events:
        until_ns = now_ns + wait_ns
        while pacing.due_ns() <= until_ns:
            now_ns = max(now_ns, pacing.due_ns())
            sends.append(now_ns)
            pacing.on_sent(now_ns)
        now_ns = until_ns
        if is_status:
            pacing.on_status(now_ns)
    gaps = [later - earlier for earlier, later in itertools.pairwise(sends)]
    assert all(MIN_GAP_NS <= gap <= FALLBACK_AFTER_NS for gap in gaps)
