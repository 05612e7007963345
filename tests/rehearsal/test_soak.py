"""The soak's rule: what counts as growing, and what does not."""

from __future__ import annotations

import gc
import os
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from fsai_hil.rehearsal.soak import (
    GROWTH_KIB_PER_HOUR,
    NOISE_KIB,
    Flatness,
    ProcessSample,
    Sampler,
    judge,
    look,
    response_parts,
)
from fsai_hil.rules.response import ResponseTimes
from fsai_vcu.interface.codec import Codec
from fsai_vcu.interface.messages import AiCommand, VcuStatus
from fsai_vcu.interface.revisions import revision
from fsai_vcu.interface.units import MS

CODEC = Codec(revision("2026"))
STEADY = [ResponseTimes([2 * MS] * 100)] * 3


def run_of(
    rss_kib: Callable[[float], float] = lambda hour: 50_000, fds: int = 20, threads: int = 9
) -> list[ProcessSample]:
    """Two hours of a process, sampled each minute. Medians of first and last third lie 80 minutes apart."""
    return [ProcessSample(60.0 * minute, int(rss_kib(minute / 60.0)), fds, threads) for minute in range(120)]


def verdict(samples: list[ProcessSample], responses: list[ResponseTimes] = STEADY) -> Flatness:
    return judge({"bridge": samples}, responses)


def test_a_run_that_stays_as_it_was_is_flat() -> None:
    assert verdict(run_of()).flat


def test_memory_may_grow_by_noise_and_an_hourly_rate_only() -> None:
    allowed_kib = NOISE_KIB + GROWTH_KIB_PER_HOUR * 80 / 60

    def grown(by_kib: float) -> list[ProcessSample]:
        return run_of(lambda hour: 50_000 + (by_kib if hour > 1 else 0))

    assert verdict(grown(allowed_kib - 1)).flat
    reasons = verdict(grown(allowed_kib + 1)).reasons
    assert len(reasons) == 1 and reasons[0].startswith("bridge: memory grew by 6.3 MiB in 80.0 min")


def test_a_slow_leak_is_found() -> None:
    assert not verdict(run_of(lambda hour: 50_000 + 6 * 1024 * hour)).flat


def test_a_peak_is_no_growth() -> None:
    assert verdict(run_of(lambda hour: 90_000 if 1.9 < hour < 1.95 else 50_000)).flat


@pytest.mark.parametrize(("what", "words"), [("fds", "file descriptors"), ("threads", "threads")])
def test_one_descriptor_or_thread_that_stays_is_growth(what: str, words: str) -> None:
    more = run_of(fds=21) if what == "fds" else run_of(threads=21)
    leaking = [*run_of()[:60], *more[60:]]
    reasons = verdict(leaking).reasons
    assert len(reasons) == 1 and words in reasons[0] and reasons[0].endswith("to 21")


@pytest.mark.parametrize(("last_ms", "flat"), [(5.0, True), (5.1, False)])
def test_the_response_may_slow_by_half_and_2_ms_and_no_more(last_ms: float, flat: bool) -> None:
    last = ResponseTimes([int(last_ms * MS)] * 100)
    assert verdict(run_of(), [*STEADY[:2], last]).flat is flat


def test_missing_handshakes_or_a_missing_process_are_not_flat() -> None:
    assert "too few handshakes" in verdict(run_of(), [*STEADY[:2], ResponseTimes()]).reasons[0]
    assert "not there all the time" in verdict(run_of()[:5]).reasons[0]


def test_what_is_only_shown_is_not_judged_and_says_so() -> None:
    growing = run_of(lambda hour: 50_000 + 100_000 * hour, fds=20)
    flatness = judge({"bridge": run_of(), "car": growing}, STEADY, unjudged=("car",))
    assert flatness.flat
    assert "not judged" in next(line for line in str(flatness).splitlines() if line.startswith("car"))
    assert str(flatness).splitlines()[-1] == "FLAT over 119.0 min after the warm-up"


def test_a_process_is_as_proc_shows_it_and_an_ended_one_is_none() -> None:
    gc.collect()  # not meanwhile, of files that earlier tests have left
    before = look(os.getpid(), 0.0)
    with open(os.devnull):  # noqa: PTH123
        during = look(os.getpid(), 0.0)
    assert before is not None and during is not None
    assert during.fds == before.fds + 1 and during.rss_kib > 1000 and during.threads >= 1
    assert look(1 << 30, 0.0) is None


def test_the_sampler_samples_repeatedly_but_not_the_warm_up() -> None:
    with Sampler({"own": os.getpid(), "gone": 1 << 30}, 0.01) as sampler:
        until = time.monotonic() + 60.0
        while len(sampler.samples["own"]) < 5 and time.monotonic() < until:
            time.sleep(0.01)
    seen = sampler.samples["own"]
    assert len(seen) >= 5 and sampler.samples["gone"] == []
    assert sampler.since(seen[2].t_s)["own"] == seen[2:]


def test_an_excluded_period_is_in_no_sample_and_no_response(tmp_path: Path) -> None:
    sampler = Sampler({"bridge": 1}, 1.0)
    sampler.samples["bridge"] = run_of()
    seen = sampler.since(600.0, [(1200.0, 1800.0), (3000.0, 3000.0)])["bridge"]
    left_out = {*range(10), *range(20, 31), 50}
    assert [each.t_s / 60 for each in seen] == [minute for minute in range(120) if minute not in left_out]

    def answers_late(cycle: int) -> bool:
        return 500 <= cycle < 600

    lines = []
    for cycle in range(1, 3001):
        t_ns = cycle * 10 * MS
        toggle = bool(cycle % 2)
        status = CODEC.encode(VcuStatus(handshake=toggle))
        echo = CODEC.encode_command(AiCommand(handshake=toggle), t_ns)[0]
        late_ns = 8 * MS if answers_late(cycle) else MS
        for frame, at_ns in ((status, t_ns), (echo, t_ns + late_ns)):
            lines.append(f"({at_ns / 1e9:.6f}) vcan0 {frame.can_id:03X}#{frame.data.hex().upper()}")
    log = tmp_path / "bus.log"
    log.write_text("\n".join(lines) + "\n")

    def p99_ms(*without: tuple[float, float]) -> list[float]:
        return [round(times.quantile_ms(0.99) or 0.0, 1) for times in response_parts(log, CODEC, 0, without)]

    assert p99_ms() == [8.0, 1.0, 1.0]
    assert p99_ms((5000 * MS, 5999 * MS)) == [1.0, 1.0, 1.0]
