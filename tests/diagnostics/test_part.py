"""The part of a log that --from and --to mean: times into the log, and times of day where the log has them."""

from __future__ import annotations

from datetime import datetime, timezone

import pytest

from fsai_vcu.diagnostics.log.part import Part
from fsai_vcu.interface.errors import WrongUse
from fsai_vcu.interface.units import S

FIRST_NS = int(datetime(2026, 7, 18, 14, 3, 20, tzinfo=timezone.utc).timestamp()) * S
HOUR_S = 3600.0


@pytest.mark.parametrize(
    ("words", "length_s", "since_s"),
    [
        ("12.5", 60.0, 12.5),
        ("1:00", 300.0, 60.0),  # at 1 o'clock there was no log
        ("1:30.5", 300.0, 90.5),
        ("125:00", 300.0, 7500.0),  # after its end: minutes all the same
        ("14:04", 300.0, 40.0),  # the log has it
        ("14:04", 30.0, 844.0),  # it ended before
        ("14:03", 300.0, -20.0),  # it began within that minute
        ("14:02", 300.0, 842.0),  # … and after that one
        ("15:00", 2 * HOUR_S, 3400.0),
        ("0:10", 12 * HOUR_S, 36400.0),  # a log over midnight
        ("14:03:30", 5.0, 10.0),  # a time of day in any case
    ],
)
def test_a_time_means_what_the_log_has(words: str, length_s: float, since_s: float) -> None:
    part = Part(words)
    part.ends_at(FIRST_NS + int(length_s * S))
    assert part.bounds(FIRST_NS)[0] == FIRST_NS + since_s * S


def test_a_log_that_counts_from_zero_has_no_time_of_day() -> None:
    part = Part("0:30")
    part.ends_at(3600 * S)
    assert part.bounds(0)[0] == 30 * S


def test_of_a_log_without_a_known_end_minutes_are_meant() -> None:
    part = Part("14:04")
    assert part.needs_the_end
    assert part.bounds(FIRST_NS)[0] == FIRST_NS + 844 * S
    assert not any(Part(words).needs_the_end for words in ("12.5", "14:03:30", None))


def test_a_part_that_ends_before_it_begins_is_wrong_use() -> None:
    with pytest.raises(WrongUse, match="--from 1:30 is after --to 1:00"):
        Part("1:30", "1:00").bounds(FIRST_NS)


@pytest.mark.parametrize("words", ["soon", "nan", "-3", "1:60", "1:99.5", "1:-3", "1:2:3:4", ":", "24:00:00", "1e400"])
def test_what_is_no_time_is_refused_in_one_line(words: str) -> None:
    with pytest.raises(ValueError, match=r"^--to is .*: neither seconds .* 14:03:30$"):
        Part(None, words)
