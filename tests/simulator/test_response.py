"""Distributions of response times: exact percentiles, shares and bins, and what the simulated car tells of them."""

from __future__ import annotations

import math

from hypothesis import given
from hypothesis import strategies as st
from vcu_bench import Bench

from fsai_hil.rules.response import BINS_MS, THRESHOLDS_MS, ResponseTimes
from fsai_vcu.interface.units import MS, S

TIMES = st.lists(st.integers(min_value=0, max_value=10 * S), max_size=300)


def test_the_longest_time_of_all_is_never_hidden_by_a_percentile() -> None:
    times = ResponseTimes([1] * 999_999)
    times.add(500 * MS)
    assert (times.as_dict()["p999_ms"], times.as_dict()["max_ms"]) == (0.0, 500.0)


@given(TIMES)
def test_each_time_is_in_exactly_one_bin(times_ns: list[int]) -> None:
    bins = ResponseTimes(times_ns).histogram()
    assert [edge for edge, _ in bins] == [*BINS_MS, None]
    assert sum(count for _, count in bins) == len(times_ns)
    lower = -1.0
    for edge, count in bins:
        upper = math.inf if edge is None else edge * MS
        assert count == sum(lower < time_ns <= upper for time_ns in times_ns)
        lower = upper


def test_a_time_at_the_limit_is_kept_and_1_ns_more_is_above() -> None:
    times = ResponseTimes([10 * MS - 1, 10 * MS, 10 * MS + 1])
    assert times.count_above(10 * MS) == 1
    assert times.as_dict()["above_ms"] == {
        str(limit): 3 if limit < 10 else 1 if limit == 10 else 0 for limit in THRESHOLDS_MS
    }


def test_no_times_have_no_percentiles() -> None:
    nothing = ResponseTimes()
    assert nothing.as_dict()["p50_ms"] is None and nothing.as_dict()["max_ms"] is None


# ------------------------------------------------------------ what the simulated VCU counts


def test_each_loss_of_the_ai_computer_is_counted_once() -> None:
    bench = Bench().power_up()
    bench.run(S)
    assert bench.vcu.comms_losses == 0
    for losses in (1, 2):
        bench.silent_ids = {0x513}
        bench.run(S)
        assert bench.vcu.comms_losses == losses
        bench.silent_ids = set()
        bench.run(S)
    assert bench.vcu.comms_losses == 2
