"""Distributions of times: how long the AI computer took to answer, how late a frame was. Exact, not sampled.

Every time is kept, in eight bytes: a million of them, three hours of handshakes, are eight megabytes.
"""

from __future__ import annotations

from array import array
from collections.abc import Iterable
from typing import Any, Final

import numpy as np

from fsai_vcu.diagnostics.statistics.quantiles import quantile

NS_PER_MS: Final = 1_000_000
THRESHOLDS_MS: Final = (1, 2, 5, 10, 50, 100)
# Upper edges of the bins that people are shown; the last bin is open. Half milliseconds where an answer belongs.
BINS_MS: Final = (0.25, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 7.5, 10.0, 15.0, 20.0, 30.0, 50.0, 100.0)


class ResponseTimes:
    """A growing set of times in whole nanoseconds."""

    def __init__(self, times_ns: Iterable[int] = ()) -> None:
        self._times_ns = array("q", times_ns)

    def add(self, time_ns: int) -> None:
        self._times_ns.append(time_ns)

    def __len__(self) -> int:
        return len(self._times_ns)

    def quantile_ms(self, share: float) -> float | None:
        """The smallest time that at least `share` (0 to 1) of all do not exceed; None while there is none."""
        time_ns = quantile(np.sort(self._times_ns), share)  # type: ignore[arg-type]
        return None if time_ns is None else time_ns / NS_PER_MS

    def count_above(self, limit_ns: int) -> int:
        """Return how many are longer than `limit_ns`."""
        return int(np.count_nonzero(np.asarray(self._times_ns) > limit_ns))

    def histogram(self) -> list[tuple[float | None, int]]:
        """(upper edge in ms, how many are up to it and above the edge before); the last bin has no upper edge."""
        above = [len(self), *(self.count_above(int(edge_ms * NS_PER_MS)) for edge_ms in BINS_MS), 0]
        return [(edge, more - less) for edge, more, less in zip([*BINS_MS, None], above, above[1:], strict=False)]

    def as_dict(self) -> dict[str, Any]:
        """Return the figures as an object for JSON; times in ms are null while there is none."""
        percentiles = {"p50_ms": 0.5, "p99_ms": 0.99, "p999_ms": 0.999, "max_ms": 1.0}
        times_ms = {name: self.quantile_ms(share) for name, share in percentiles.items()}
        return {
            "count": len(self),
            **{name: None if time_ms is None else round(time_ms, 3) for name, time_ms in times_ms.items()},
            "above_ms": {str(limit): self.count_above(limit * NS_PER_MS) for limit in THRESHOLDS_MS},
            "histogram_ms": self.histogram(),
        }
