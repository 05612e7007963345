"""Header stamps become monotonic times, and steps of the wall clock change nothing."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fsai_vcu.runtime.clocks import AHEAD_NS, SAME_OFFSET_NS, WINDOW_NS, StampConverter

MS, S = 1_000_000, 1_000_000_000
WALL = 1_800_000_000 * S  # what a wall clock shows
NOW = 5_000 * S  # what the monotonic clock shows


def converter_at(offset_ns: int, steady_ns: int) -> StampConverter:
    stamps = StampConverter()
    stamps.observe(offset_ns + steady_ns, steady_ns)
    return stamps


def test_there_and_back_is_the_same_instant() -> None:
    stamps = converter_at(WALL, NOW)
    assert stamps.to_steady(stamps.to_ros(NOW - 123_456_789), NOW) == NOW - 123_456_789


@pytest.mark.parametrize("step_ns", [3600 * S, -3600 * S, 10 * S, -10 * S, 2 * S, -2 * S])
@pytest.mark.parametrize("began_ns", [NOW, NOW - 60 * S])
def test_stamps_before_and_after_a_clock_step_keep_their_age(step_ns: int, began_ns: int) -> None:
    """However long the clock had been as it was."""
    stamps = converter_at(WALL, began_ns)
    stamps.observe(WALL + step_ns + NOW, NOW)
    assert stamps.to_steady(WALL + NOW - 20 * MS, NOW) == NOW - 20 * MS
    later = NOW + 50 * MS
    stamps.observe(WALL + step_ns + later, later)
    assert stamps.to_steady(WALL + step_ns + later - 5 * MS, later) == later - 5 * MS


def test_the_offset_before_a_step_is_kept_for_the_window_only() -> None:
    stamps = converter_at(WALL, NOW)
    new = WALL + 10 * S
    stamps.observe(new + NOW, NOW)
    stamp_ns = WALL + NOW  # made just before the step
    within = NOW + WINDOW_NS
    stamps.observe(new + within, within)
    assert stamps.to_steady(stamp_ns, within) == NOW
    after = within + 1
    stamps.observe(new + after, after)
    assert stamps.to_steady(stamp_ns, after) == NOW - 10 * S  # by the new clock: old, thus stale


def test_a_stamp_more_than_20_ms_ahead_stays_ahead() -> None:
    stamps = converter_at(WALL, NOW)
    assert AHEAD_NS == 20 * MS
    assert stamps.to_steady(WALL + NOW + AHEAD_NS, NOW) == NOW
    assert stamps.to_steady(WALL + NOW + AHEAD_NS + 1, NOW) == NOW + AHEAD_NS + 1
    assert stamps.to_steady(WALL + NOW + 3600 * S, NOW) == NOW + 3600 * S


def test_a_fixed_stamp_never_becomes_younger_than_it_was() -> None:
    """A sensor clock that is ahead and stands still: its data are refused, and then grow old."""
    stamps = converter_at(WALL, NOW)
    stamp_ns = WALL + NOW + 300 * MS
    for later_ns in range(0, 2000 * MS, 10 * MS):
        now_ns = NOW + later_ns
        stamps.observe(WALL + now_ns, now_ns)
        t_ns = stamps.to_steady(stamp_ns, now_ns)
        assert t_ns == (now_ns if 280 * MS <= later_ns <= 300 * MS else NOW + 300 * MS)


@pytest.mark.parametrize("step_ns", [3600 * S, -3600 * S, 50 * MS, -50 * MS])
def test_a_stamp_ahead_by_both_clocks_of_a_step_stays_ahead(step_ns: int) -> None:
    stamps = converter_at(WALL, NOW)
    stamps.observe(WALL + step_ns + NOW, NOW)
    ahead_by_both_ns = WALL + max(step_ns, 0) + NOW + 100 * MS
    assert stamps.to_steady(ahead_by_both_ns, NOW) == NOW + 100 * MS


def test_a_stamp_slightly_ahead_is_now_and_not_old() -> None:
    stamps = converter_at(WALL, NOW)
    stamps.observe(WALL - 10 * S + NOW, NOW)  # the clock was set back
    assert stamps.to_steady(WALL - 10 * S + NOW + 2 * MS, NOW) == NOW


def test_slewing_is_no_step() -> None:
    stamps = StampConverter()
    for second in range(100):
        # 500 ppm, the most that a clock is slewed by
        stamps.observe(WALL + second * S + second * 500_000, second * S)
    assert stamps.to_steady(WALL + 99 * S + 99 * 500_000, 99 * S) == 99 * S


def test_an_instant_before_the_epoch_becomes_the_epoch() -> None:
    assert converter_at(0, 10 * S).to_ros(-5 * S) == 0


@given(
    step_ns=st.integers(-(10**14), 10**14),
    age_ns=st.integers(0, 900 * MS),
    since_step_ns=st.integers(0, 900 * MS),
)
def test_no_step_makes_a_stamp_older_than_noise_or_in_the_future(step_ns: int, age_ns: int, since_step_ns: int) -> None:
    stamps = converter_at(WALL, NOW)
    stamps.observe(WALL + step_ns + NOW, NOW)
    now_ns = NOW + since_step_ns
    stamps.observe(WALL + step_ns + now_ns, now_ns)
    made_ns = now_ns - age_ns
    stamp_ns = made_ns + WALL + (step_ns if made_ns >= NOW else 0)
    assert now_ns - age_ns - SAME_OFFSET_NS <= stamps.to_steady(stamp_ns, now_ns) <= now_ns
