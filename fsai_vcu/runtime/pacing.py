"""Pacing of the sends: an answer to each 0x520, never two sends too close, its own clock when the car is silent.

Pure; times are integer monotonic nanoseconds.
"""

from __future__ import annotations

from fsai_vcu.interface.specification import PERIOD_NS

MIN_GAP_NS = 8_000_000  # two sends are never closer
FALLBACK_AFTER_NS = 15_000_000  # nothing sent for so long: do not wait for 0x520 any more


class Pacing:
    """Decides the instants of sending from the arrivals of 0x520."""

    def __init__(self, now_ns: int) -> None:
        self._last_ns = now_ns - PERIOD_NS
        self._due_ns = now_ns
        self._own_clock = True  # nothing has arrived to answer since the last send

    def on_status(self, now_ns: int) -> None:
        """A 0x520 has arrived: answer at once, or as soon as the gap allows."""
        self._own_clock = False
        self._due_ns = min(self._due_ns, max(now_ns, self._last_ns + MIN_GAP_NS))

    def on_sent(self, now_ns: int) -> None:
        """A cycle has been sent (or deliberately not sent) at `now_ns`."""
        next_on_grid_ns = self._due_ns + PERIOD_NS
        if not self._own_clock:
            self._due_ns = now_ns + FALLBACK_AFTER_NS
        elif next_on_grid_ns >= now_ns + MIN_GAP_NS:
            self._due_ns = next_on_grid_ns  # lateness of one send does not shift the next
        else:
            self._due_ns = now_ns + PERIOD_NS
        self._own_clock = True
        self._last_ns = now_ns

    def due_ns(self) -> int:
        """The instant of the next send, as things stand."""
        return self._due_ns
