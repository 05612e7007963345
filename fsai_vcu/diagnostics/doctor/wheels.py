"""The commissioning check of the wheels: each is turned by hand, and the bus shows whose sensor moved."""

from __future__ import annotations

from dataclasses import dataclass

from fsai_vcu.interface.wheels import WHEELS, WheelMapping

NAMES = {"fl": "front left", "fr": "front right", "rl": "rear left", "rr": "rear right"}

_WRAP = 1 << 16  # the counters of 0x526 have 16 bits
_STILL_NS = 1_500_000_000  # so long without a pulse, a turn is over
_FEW = 5  # pulses: a wheel that was leaned on, not one that is turned
_OTHERS_SHARE = 0.25  # of the pulses of the wheel that turns: more of another one is ambiguous
_TOLERANCE = 2  # pulses by which a turn by hand may miss

Four = tuple[int, ...]
"""Numbers of fl, fr, rl, rr."""


@dataclass(frozen=True, slots=True)
class Turn:
    """Signals seen while `wheel` was turned once: pulses and highest speed by signal position."""

    wheel: str
    pulses: Four
    speed_max_rpm: Four

    @property
    def source(self) -> str | None:
        """The position whose signal counted; None when that is ambiguous."""
        others, most = sorted(self.pulses)[-2:]
        if most < _FEW or others > _OTHERS_SHARE * most:
            return None
        return WHEELS[self.pulses.index(most)]

    @property
    def counted(self) -> int:
        return max(self.pulses)

    def problem(self, pulses_per_rev: int) -> str | None:
        """Say in words what is wrong with the turn; None: nothing."""
        if self.source is None:
            moved = ", ".join(f"{w} {n}" for w, n in zip(WHEELS, self.pulses, strict=True) if n)
            return f"more than one signal counted ({moved}): turn one wheel alone"
        fastest = WHEELS[self.speed_max_rpm.index(max(self.speed_max_rpm))]
        if max(self.speed_max_rpm) == 0:
            return f"pulses come ({self.counted}), but no speed (0x525)"
        if fastest != self.source:
            return f"the pulses are those of {self.source}, the speed is that of {fastest}: wired differently"
        if abs(self.counted - pulses_per_rev) > _TOLERANCE:
            return f"{self.counted} pulses for one turn instead of {pulses_per_rev}"
        return None


class WheelWiringCheck:
    """Asks for each wheel in turn. Fed with what is on the bus, by signal position (fl, fr, rl, rr)."""

    def __init__(self) -> None:
        self.turns: list[Turn] = []
        self._counts: Four | None = None
        self._pulses = [0, 0, 0, 0]
        self._fastest = [0, 0, 0, 0]
        self._moved_ns: int | None = None

    @property
    def asked(self) -> str | None:
        """The wheel to be turned now; None when all have been."""
        return WHEELS[len(self.turns)] if len(self.turns) < len(WHEELS) else None

    def on_counts(self, counts: Four, t_ns: int) -> Turn | None:
        """A 0x526. The turn that has just ended with it, if one has."""
        before, self._counts = self._counts, counts
        if before is None or self.asked is None:
            return None
        steps = [(new - old) % _WRAP for new, old in zip(counts, before, strict=True)]
        if any(steps):
            self._moved_ns = t_ns
            self._pulses = [sum(pair) for pair in zip(self._pulses, steps, strict=True)]
        if self._moved_ns is None or t_ns - self._moved_ns < _STILL_NS:
            return None
        turn = Turn(self.asked, tuple(self._pulses), tuple(self._fastest))
        self._pulses, self._fastest, self._moved_ns = [0] * 4, [0] * 4, None
        if turn.counted < _FEW:
            return None
        if turn.source is not None:
            self.turns.append(turn)
        return turn

    def on_speeds(self, speeds_rpm: Four) -> None:
        """A 0x525."""
        self._fastest = [max(pair) for pair in zip(self._fastest, speeds_rpm, strict=True)]

    def mapping(self) -> WheelMapping | None:
        """Mapping that the turns show; None when two wheels were found in one signal."""
        found = {turn.wheel: turn.source for turn in self.turns if turn.source is not None}
        try:
            return WheelMapping.of(found)
        except ValueError:
            return None
