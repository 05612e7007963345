"""Does a long run stay as it began? Memory, file descriptors and threads of each process, and the handshake's answer.

A run is cut into three equal parts, after a warm-up that the caller leaves out (imports, first messages, caches). It is
flat when of each process judged, from the first part to the last:

- the median of its memory (resident set) has grown by no more than 1 MiB of noise and 4 MiB an hour,
- the median number of its file descriptors, and of its threads, has not grown at all,

and when the handshake's answer at p99 is in the last part no longer than half as long again as in the first and 2 ms.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import median_high
from typing import Any, Final, NamedTuple

from fsai_hil.rehearsal.bus_watch import responses_in
from fsai_hil.rules.checker import read_candump
from fsai_hil.rules.response import ResponseTimes
from fsai_vcu.interface.codec import Codec
from fsai_vcu.interface.reserved import AI_IDS, STATUS_ID

NOISE_KIB: Final = 1024
GROWTH_KIB_PER_HOUR: Final = 4096
SLOWER_FACTOR: Final = 1.5
SLOWER_MS: Final = 2.0
PARTS: Final = 3
_LEAST_SAMPLES: Final = 2 * PARTS


class ProcessSample(NamedTuple):
    """One process at one instant of the monotonic clock."""

    t_s: float
    rss_kib: int
    fds: int
    threads: int


def look(pid: int, t_s: float) -> ProcessSample | None:
    """The process as /proc shows it; None when it has ended."""
    proc = Path(f"/proc/{pid}")
    try:
        status = dict(line.split(":", 1) for line in (proc / "status").read_text().splitlines())
        fds = sum(1 for _ in (proc / "fd").iterdir())
        return ProcessSample(t_s, int(status["VmRSS"].split()[0]), fds, int(status["Threads"]))
    except (OSError, KeyError):
        return None


class Sampler:
    """Looks at processes again and again, in a thread of its own."""

    def __init__(self, pids: Mapping[str, int], period_s: float) -> None:
        self.samples: dict[str, list[ProcessSample]] = {name: [] for name in pids}
        self._pids = dict(pids)
        self._period_s = period_s
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._watch, name="soak", daemon=True)

    def _watch(self) -> None:
        while not self._ended.wait(self._period_s):
            t_s = time.monotonic()
            for name, pid in self._pids.items():
                sample = look(pid, t_s)
                if sample is not None:
                    self.samples[name].append(sample)

    def __enter__(self) -> Sampler:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join()

    def since(self, t_s: float, without: Sequence[tuple[float, float]] = ()) -> dict[str, list[ProcessSample]]:
        """Return what was seen after the warm-up, but not in the periods `without` (from, to; monotonic clock, s)."""
        return {
            name: [each for each in samples if each.t_s >= t_s and not _within(each.t_s, without)]
            for name, samples in self.samples.items()
        }


@dataclass(frozen=True, slots=True)
class Flatness:
    """The verdict."""

    minutes: float
    trends: tuple[dict[str, Any], ...]  # by `_trend`
    response_p99_ms: tuple[float | None, ...]
    reasons: tuple[str, ...]

    @property
    def flat(self) -> bool:
        return not self.reasons

    def as_dict(self) -> dict[str, Any]:
        return {"flat": self.flat, **asdict(self)}

    def __str__(self) -> str:
        """Print a line for each process, then the response times and what was not flat."""
        lines = [f"{'process':<20} {'memory MiB':>17} {'MiB/h':>8} {'descriptors':>13} {'threads':>9}"]
        for trend in self.trends:
            rss = " -> ".join(f"{mib:.1f}" for mib in trend["rss_mib"])
            fds, threads = (f"{first} -> {last}" for first, last in (trend["fds"], trend["threads"]))
            growth, note = (
                trend["growth_mib_per_hour"],
                "" if trend["judged"] else "  not judged: it keeps all of its run",
            )
            lines.append(f"{trend['name']:<20} {rss:>17} {growth:>8.1f} {fds:>13} {threads:>9}{note}")
        p99 = ", ".join("none" if value is None else f"{value:.2f} ms" for value in self.response_p99_ms)
        lines.append(f"handshake answered at p99, in each third: {p99}")
        verdict = "FLAT" if self.flat else "NOT FLAT: " + "; ".join(self.reasons)
        lines.append(f"{verdict} over {self.minutes:.1f} min after the warm-up")
        return "\n".join(lines)


def _within(t: float, periods: Sequence[tuple[float, float]]) -> bool:
    return any(began <= t <= ended for began, ended in periods)


def response_parts(
    log: Path, codec: Codec, since_ns: int, without: Sequence[tuple[float, float]] = ()
) -> list[ResponseTimes]:
    """Return how long each toggle of the handshake waited for its echo, on the bus, in each part of the time.

    `since_ns`, and from and to of the periods that are left out, `without`: ns of the log's clock.
    """
    handshake = {AI_IDS[0], STATUS_ID}  # all others are most of a log, and say nothing here
    frames = [
        frame
        for frame in read_candump(log)
        if frame.can_id in handshake and frame.t_ns >= since_ns and not _within(frame.t_ns, without)
    ]
    part_ns = (max((frame.t_ns for frame in frames), default=since_ns) - since_ns) / PARTS
    windows = {f"{part}": (since_ns + part * part_ns, since_ns + (part + 1) * part_ns) for part in range(PARTS)}
    return [times for times, _ in responses_in(frames, codec, windows).values()]


def judge(
    samples: Mapping[str, Sequence[ProcessSample]], responses: Sequence[ResponseTimes], *, unjudged: Sequence[str] = ()
) -> Flatness:
    """The verdict on a run. `responses`: the handshake's times in its three parts. `unjudged`: only shown."""
    trends = tuple(_trend(name, seen, judged=name not in unjudged) for name, seen in samples.items())
    reasons = [f"{trend['name']}: {words}" for trend in trends for words in trend["broken"]]
    p99_ms = tuple(times.quantile_ms(0.99) for times in responses)
    first_ms, last_ms = p99_ms[0], p99_ms[-1]
    if first_ms is None or last_ms is None:
        reasons.append("too few handshakes were seen to judge them")
    elif last_ms > SLOWER_FACTOR * first_ms + SLOWER_MS:
        reasons.append(f"the handshake is answered later: p99 {first_ms:.2f} ms, and {last_ms:.2f} ms in the end")
    times_s = [each.t_s for seen in samples.values() for each in seen]
    minutes = (max(times_s) - min(times_s)) / 60.0 if times_s else 0.0
    return Flatness(minutes, trends, p99_ms, tuple(reasons))


def _trend(name: str, samples: Sequence[ProcessSample], *, judged: bool) -> dict[str, Any]:
    """One process, the medians of its first part against those of its last; over a short run growth is mostly noise."""
    part = len(samples) // PARTS
    broken: list[str] = []
    first = last = ProcessSample(0.0, 0, 0, 0)
    if len(samples) < _LEAST_SAMPLES:
        broken.append(f"only {len(samples)} samples: it was not there all the time")
    else:
        first, last = (
            ProcessSample(*map(median_high, zip(*seen, strict=True))) for seen in (samples[:part], samples[-part:])
        )
    hours, grown_kib = (last.t_s - first.t_s) / 3600.0, last.rss_kib - first.rss_kib
    if judged and grown_kib > NOISE_KIB + GROWTH_KIB_PER_HOUR * hours:
        broken.append(f"memory grew by {grown_kib / 1024:.1f} MiB in {60 * hours:.1f} min")
    if judged and last.fds > first.fds:
        broken.append(f"file descriptors grew from {first.fds} to {last.fds}")
    if judged and last.threads > first.threads:
        broken.append(f"threads grew from {first.threads} to {last.threads}")
    return {
        "name": name,
        "judged": judged,
        "samples": len(samples),
        "rss_mib": (first.rss_kib / 1024, last.rss_kib / 1024),
        "growth_mib_per_hour": grown_kib / 1024 / hours if hours else 0.0,
        "fds": (first.fds, last.fds),
        "threads": (first.threads, last.threads),
        "broken": tuple(broken),
    }
