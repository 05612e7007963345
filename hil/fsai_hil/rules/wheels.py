"""An observer's view of the wheels: which speeds (0x525) may be believed, and whether they stand.

Written apart from the core. Three answers are possible for a frame: it may be believed, it may not, or the rules leave
it open: how many pulses are "clearly more" than a reading explains is the core's to choose within a margin. What is
left open breaks no rule either way.
"""

from __future__ import annotations

from collections import deque
from enum import Enum, auto
from typing import Annotated, Final

from msgspec import Struct

from fsai_hil.rules.numbers import (
    COUNT_SLACK,
    COUNTED_NS,
    CYCLE_NS,
    DOUBT_OPEN_TURNS,
    DOUBT_SURE_TURNS,
    FEEDBACK_LOST_NS,
    FEEDBACK_STALE_NS,
    SPEED_CHANGE_MOST_RPM,
    SPEED_JUMP_NS,
    SPEED_MOST_RPM,
    SPEEDS_FRESH_NS,
    STILL_NS,
    STILL_RPM,
    TURNING_PULSES,
)
from fsai_vcu.core.ages import Ages

Rpm = tuple[int, int, int, int]
_COUNTS: Final = 1 << 16
_CREEP_RPM: Final = 2 * STILL_RPM  # a reading under 10 rpm and a wheel that truly turns at no more agree


class Belief(Enum):
    """An answer to whether a frame of 0x525 counts."""

    YES = auto()
    OPEN = auto()
    NO = auto()


class _Stillness:
    """All four wheels under 10 rpm for 0.5 s, seen without a gap (safety rule 3)."""

    def __init__(self) -> None:
        self.since_ns: int | None = None
        self.newest_ns: int | None = None
        self.ended: tuple[int, int] | None = None  # when standing ended, and since when it had lasted

    def on_speeds(self, rpm: Rpm, t_ns: int, slack_ns: int) -> None:
        if self.newest_ns is not None and t_ns - self.newest_ns >= SPEEDS_FRESH_NS + slack_ns:
            self.since_ns = None
        self.newest_ns = t_ns
        if max(rpm) >= STILL_RPM:
            if self.since_ns is not None:
                self.ended = t_ns, self.since_ns
            self.since_ns = None
        elif self.since_ns is None:
            self.since_ns = t_ns

    def proven(self, now_ns: int, in_flight_ns: int, slack_ns: int) -> bool:
        if self.newest_ns is None or now_ns - self.newest_ns >= SPEEDS_FRESH_NS + slack_ns:
            return False
        since_ns, until_ns = self.since_ns, self.newest_ns
        if since_ns is None and self.ended is not None and now_ns - self.ended[0] < in_flight_ns:
            since_ns = self.ended[1]
        return since_ns is not None and (now_ns if slack_ns else until_ns) - since_ns >= STILL_NS - slack_ns


class WheelAges(Struct):
    """The times of `Wheels.saved`, as ages in ns, below 0 for never; each says where it matters to a rule."""

    believed_ns: Annotated[int, Ages(gap=(SPEED_JUMP_NS,))] = -1  # of the last speeds that certainly count
    may_count_ns: Annotated[int, Ages(FEEDBACK_LOST_NS, gap=(SPEEDS_FRESH_NS,))] = -1  # of the last that may count
    still_ns: Annotated[int, Ages(STILL_NS)] = -1  # for how long the wheels had stood then
    turning_ns: Annotated[int, Ages(COUNTED_NS)] = -1


class Wheels:
    """Feed it with 0x525 and 0x526 in the order of time. `in_flight_ns`, `slack_ns`: see `checker.WireChecker`."""

    def __init__(self, pulses_per_rev: int, in_flight_ns: int = 0, slack_ns: int = 0) -> None:
        """Begin with wheels of which nothing is known."""
        self.rpm: Rpm | None = None  # the last that surely counts
        self.believed_ns: int | None = None
        self.may_count_ns: int | None = None  # the last that may count
        self.open = False  # the last that may count is left open
        self.turned = False  # a wheel has turned, by its speed
        self.turning_ns: int | None = None  # of the last two pulses of a wheel the older
        self._pulses_per_rev = pulses_per_rev
        self._in_flight_ns, self._slack_ns = in_flight_ns, slack_ns
        self._surely, self._perhaps = _Stillness(), _Stillness()
        self._counts: Rpm | None = None
        self._counts_ns = 0
        self._pulse_ns: list[int | None] = [None] * 4  # each wheel's last
        self._turnings: deque[tuple[int, int]] = deque()  # `turning_ns`, and when it was seen
        self._has_counted = [False] * 4
        self._readings: list[Rpm] = []  # since the last 0x526, and the one before it
        self._reading_ns = 0
        self._ahead = [0.0] * 4  # turns by the count that the reading does not explain; below 0 the other way round
        self._doubt = [Belief.YES] * 4

    # ------------------------------------------------------------ frames

    def on_counts(self, counts: Rpm, t_ns: int) -> None:
        """Compare the pulses since the last 0x526 with the speeds that came meanwhile."""
        before, before_ns = self._counts, self._counts_ns
        self._counts, self._counts_ns = counts, t_ns
        if before is None:
            return
        steps = [(now - then) % _COUNTS for now, then in zip(counts, before, strict=True)]
        most = SPEED_MOST_RPM / 60.0 * self._pulses_per_rev * max(t_ns - before_ns, CYCLE_NS) / 1e9 + COUNT_SLACK
        anew = max(steps) > most
        if not anew:
            for wheel, step in enumerate(steps):
                if step:
                    self._on_pulses(wheel, step, t_ns)
        readings, self._readings = self._readings, self._readings[-1:]
        apart = t_ns - before_ns >= FEEDBACK_STALE_NS or t_ns - self._reading_ns >= FEEDBACK_STALE_NS
        if anew or apart or not readings:
            self._ahead, self._doubt = [0.0] * 4, [Belief.YES] * 4
            return
        dt_s = (t_ns - before_ns) / 1e9
        for wheel in range(4):
            seen = [rpm[wheel] for rpm in readings]
            self._compare(wheel, steps[wheel], min(seen), max(seen), dt_s)

    def _on_pulses(self, wheel: int, step: int, t_ns: int) -> None:
        older_ns = t_ns if step >= TURNING_PULSES else self._pulse_ns[wheel]
        self._pulse_ns[wheel] = t_ns
        if older_ns is not None and t_ns - older_ns < COUNTED_NS + self._in_flight_ns:
            self._has_counted[wheel] = True
            if self.turning_ns is None or older_ns > self.turning_ns:
                self.turning_ns = older_ns
                self._turnings.append((t_ns, older_ns))
                while len(self._turnings) > 1 and t_ns - self._turnings[1][0] >= self._in_flight_ns:
                    self._turnings.popleft()

    def _compare(self, wheel: int, step: int, least_rpm: int, most_rpm: int, dt_s: float) -> None:
        """Add up by how much a wheel's pulses are ahead of its speeds, and doubt it where that is too much."""
        ahead = self._ahead[wheel]
        if most_rpm < STILL_RPM:
            ahead = max(0.0, max(0.0, ahead) + step / self._pulses_per_rev - _CREEP_RPM / 60.0 * dt_s)
        elif step == 0 and least_rpm >= _CREEP_RPM:
            ahead = min(0.0, ahead) - least_rpm / 60.0 * dt_s
        else:
            ahead = 0.0
        self._ahead[wheel] = ahead = max(-DOUBT_SURE_TURNS, min(DOUBT_SURE_TURNS, ahead))
        if abs(ahead) >= DOUBT_SURE_TURNS and (ahead > 0.0 or self._has_counted[wheel]):
            self._doubt[wheel] = Belief.NO
        elif self._doubt[wheel] is Belief.NO and abs(ahead) >= DOUBT_SURE_TURNS - DOUBT_OPEN_TURNS:
            pass  # a pause between two pulses dispels no doubt
        elif abs(ahead) >= DOUBT_OPEN_TURNS:
            self._doubt[wheel] = Belief.OPEN
        elif ahead == 0.0:
            self._doubt[wheel] = Belief.YES
        elif self._doubt[wheel] is Belief.NO:
            self._doubt[wheel] = Belief.OPEN

    def on_speeds(self, rpm: Rpm, t_ns: int) -> Belief:
        """Take the wheel speeds of a 0x525; return whether they count."""
        belief = self._belief(rpm, t_ns)
        if max(rpm) <= SPEED_MOST_RPM:
            if self._counts is None:
                self._readings.clear()
            self._readings.append(rpm)
            self._reading_ns = t_ns
        if belief is Belief.NO:
            return belief
        self.may_count_ns, self.open = t_ns, belief is Belief.OPEN
        stands = max(rpm) < STILL_RPM
        if belief is Belief.YES:
            self.rpm, self.believed_ns = rpm, t_ns
            self.turned = self.turned or not stands
        if belief is Belief.YES or stands:
            self._perhaps.on_speeds(rpm, t_ns, self._slack_ns)
        if belief is Belief.YES or not stands:
            self._surely.on_speeds(rpm, t_ns, self._slack_ns)
        return belief

    def _belief(self, rpm: Rpm, t_ns: int) -> Belief:
        """Return whether these speeds count, by their size, the pulses and their change."""
        if max(rpm) > SPEED_MOST_RPM:
            return Belief.NO
        worst = Belief.YES
        if self._counts is not None and t_ns - self._counts_ns < FEEDBACK_STALE_NS:
            for wheel, doubt in enumerate(self._doubt):
                contradicts = rpm[wheel] < STILL_RPM if self._ahead[wheel] >= 0.0 else rpm[wheel] >= _CREEP_RPM
                if contradicts and doubt is not Belief.YES:
                    if doubt is Belief.NO:
                        return Belief.NO
                    worst = Belief.OPEN
        if self.rpm is not None and self.believed_ns is not None:
            jump_rpm = max([abs(now - then) for now, then in zip(rpm, self.rpm, strict=True)])
            if jump_rpm > SPEED_CHANGE_MOST_RPM and t_ns - self.believed_ns < SPEED_JUMP_NS + self._slack_ns:
                # What it is compared with may be another frame where the last one was left open, or not yet received.
                return Belief.OPEN if self.open or self._in_flight_ns else Belief.NO
        return worst

    # ------------------------------------------------------------ rest

    def counting(self, now_ns: int) -> bool:
        """A count has advanced by two pulses or more within the last 0.5 s: its wheel turns."""
        turning_ns = self.turning_ns
        if self._in_flight_ns and self._turnings:
            while len(self._turnings) > 1 and now_ns - self._turnings[1][0] >= self._in_flight_ns:
                self._turnings.popleft()
            seen_ns, turning_ns = self._turnings[0]
            if now_ns - seen_ns < self._in_flight_ns:
                return False
        return turning_ns is not None and now_ns - turning_ns < COUNTED_NS - self._slack_ns

    def may_stand(self, now_ns: int) -> bool:
        """Return whether a careful reader may take the car to stand (safety rule 3)."""
        return self._perhaps.proven(now_ns, self._in_flight_ns, self._slack_ns) and not self.counting(now_ns)

    def surely_stand(self, now_ns: int) -> bool:
        """Return whether every reader knows that it does."""
        return self._surely.proven(now_ns, 0, 0) and not self.counting(now_ns)

    # ------------------------------------------------------------ as a value

    def saved(self, now_ns: int) -> tuple[Rpm | None, WheelAges]:
        """The last speeds and the ages. Of the pulse counts `turning_ns` is all."""
        turning_ns = -1 if self.turning_ns is None else now_ns - self.turning_ns
        if turning_ns >= COUNTED_NS:
            turning_ns = -1
        if self.believed_ns is None or self.may_count_ns is None:
            return None, WheelAges(turning_ns=turning_ns)
        since_ns, age_ns = self._surely.since_ns, now_ns - self.may_count_ns
        still_ns = -1 if since_ns is None or age_ns >= SPEEDS_FRESH_NS else self.may_count_ns - since_ns
        return self.rpm, WheelAges(now_ns - self.believed_ns, age_ns, still_ns, turning_ns)

    def load(self, rpm: Rpm | None, ages: WheelAges, now_ns: int) -> None:
        """Put back what was saved."""
        self.rpm = rpm
        self.believed_ns = None if ages.believed_ns < 0 else now_ns - ages.believed_ns
        self.may_count_ns = None if ages.may_count_ns < 0 else now_ns - ages.may_count_ns
        self.turning_ns = None if ages.turning_ns < 0 else now_ns - ages.turning_ns
        for stillness in (self._surely, self._perhaps):
            stillness.newest_ns = self.may_count_ns
            stillness.since_ns = None if ages.still_ns < 0 else now_ns - ages.may_count_ns - ages.still_ns
