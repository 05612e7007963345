"""The graded reactions as a table, and what is due by them: the stops and emergencies that a process must ask for.

Written apart from the core's supervisor, in the safety rules' own words: a wrong time or a forgotten row there shows
here. What a message of the car shows is in `shown.py`. What a reaction does to the frames is said in `frame_rules.py`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final, NamedTuple

from fsai_hil.rules.bus_view import BRAKE_STEP_PCT, OFF, ROLES, WHOLE, BusView
from fsai_hil.rules.numbers import (
    CERTAINLY_NS,
    COMMAND_FRESH_NS,
    COMMAND_LOST_NS,
    FEEDBACK_LOST_NS,
    FEEDBACK_STALE_NS,
    LAUNCH_NS,
    MS,
    ODD_LOST_NS,
    ODD_NS,
    PEDALS_NS,
    STATUS_LOST_NS,
    STILL_RPM,
    S,
)
from fsai_hil.rules.shown import SHOWN
from fsai_vcu.interface.enums import Ami, AsState


class Lasting(NamedTuple):
    """A condition that stops a run once it has lasted for so long, and asks for the emergency brake once for longer."""

    what: str
    lasts_ns: Callable[[Reactions], int]  # below 0 where it is not there
    stop_ns: float = math.inf
    alarm_ns: float = math.inf
    supervised: bool = True  # in AS_DRIVING after its first 3 s only


class Reactions(BusView):
    """The view, and what is due by it."""

    def on_cycle(self, now_ns: int, mode: str, steer_odd_ns: int | None, wheel_odd_ns: int | None) -> None:
        """The process has decided what to send, and what is due by now is due in these frames.

        `mode` is what it reports; since when (ns) it takes steering and a wheel for implausible counts from the next
        cycle on.
        """
        may_turn_manual, must_turn_manual = self._look(now_ns)
        self._on_mode(mode, may_turn_manual, must_turn_manual)
        self.seen.steer_odd_ns, self.seen.wheel_odd_ns = steer_odd_ns, wheel_odd_ns

    def _look(self, now_ns: int) -> tuple[bool, bool]:
        """Find what is due; return whether the mode may and must become manual."""
        s, process = self.seen, self.process
        assert process is not None
        self.now_ns = now_ns
        self.order = None
        waits = s.reopening and s.back_ns is not None and now_ns - s.back_ns < STATUS_LOST_NS
        if s.bus_gone or waits or (s.ended is not None and s.ended >= process.stop_cycles):
            return False, False
        if s.began_ns is None:
            s.began_ns = now_ns
        self.over = s.stopped is not None
        age_ns = None if s.command_ns is None else now_ns - s.command_ns
        self.order = s.order if age_ns is not None and age_ns < COMMAND_FRESH_NS else None
        if s.as_state is AsState.AS_DRIVING and s.driving_ns is not None:
            return self._look_at_the_run(age_ns, s.driving_ns + LAUNCH_NS)
        if (
            process.autonomous_at_power_up
            and not process.listen_only
            and s.power_up
            and s.as_state in OFF
            and self.wheels.may_stand(now_ns)
        ):
            s.autonomous, s.power_up = True, False
        return False, False

    def _look_at_the_run(self, age_ns: int | None, launched_ns: int) -> tuple[bool, bool]:
        """Find what stops a run in AS_DRIVING by now, and what asks for the emergency brake; return the same."""
        s, now_ns = self.seen, self.now_ns
        for why, holds in AT_ONCE:
            if holds(self):
                self._stop(why)
        if s.ended is not None and not self.wheels.may_stand(now_ns):
            self._alarm("the software ends, and the car is not known to stand")
        supervised = now_ns >= launched_ns
        shown = (
            (row, self.since_ns(t_ns) if row.shows else self.missing_ns(t_ns))
            for row, t_ns in zip(SHOWN, self.shown_ns, strict=True)
        )
        for row, lasts_ns in (*((row, row.lasts_ns(self)) for row in GRADED), *shown):
            if supervised or not row.supervised:
                if lasts_ns >= row.stop_ns:
                    self._stop(f"{row.what} for {row.stop_ns / MS:.0f} ms" if row.stop_ns else row.what)
                if lasts_ns >= row.alarm_ns:
                    self._alarm(f"{row.what} for {row.alarm_ns / MS:.0f} ms")
        lost = runs = False
        if supervised:
            lost = s.autonomous and self._without_command_ns(now_ns - launched_ns, age_ns) >= COMMAND_LOST_NS
            runs = not self.over and not s.latched
            if not self.nothing_hidden:  # no stop or emergency has begun for another reason: there would be a brake
                unbraked = self.whole_in_a_row > 2 and s.braked_pct == 0.0 and not self.motor_brakes
                runs = unbraked and s.stopped is None and not s.latched and s.alarm is None
            if lost:
                self._stop("no valid command for 300 ms")
            self._look_at_wishes(launched_ns)
        if not s.autonomous:
            self._stop("the mode is manual")
        if not self.nothing_hidden and s.stopped is not None:
            self._look_at_the_stop()
        # Once an emergency is latched nobody asks what becomes of commands.
        return lost or s.latched, lost and runs

    def _look_at_the_stop(self) -> None:
        """Find a stop without effect. It began no later than it is known here; what began it may be a cycle older."""
        wheels, process = self.wheels, self.process
        assert process is not None
        slow = (
            wheels.rpm is not None
            and (max(wheels.rpm) < STILL_RPM or wheels.open)
            and wheels.may_count_ns is not None
            and self.now_ns - wheels.may_count_ns < FEEDBACK_STALE_NS
        )
        if self.now_ns - self.seen.stopped_ns >= process.stop_timeout_ns + 100 * MS and not slow:
            self._alarm("the car still moves long after the stop began")

    def _without_command_ns(self, supervised_ns: int, age_ns: int | None) -> int:
        """Return for how long no cycle has had a fresh command: one on old data ends nothing."""
        s = self.seen
        without_ns = supervised_ns if age_ns is None else min(supervised_ns, age_ns)
        if without_ns < COMMAND_FRESH_NS:
            s.stale_ns = None
        elif s.stale_ns is None:
            s.stale_ns = self.now_ns
        return without_ns if s.stale_ns is None else max(without_ns, self.now_ns - s.stale_ns)

    def missing_ns(self, t_ns: int | None) -> int:
        """Return for how long something has not been received that could have been."""
        if t_ns is None:
            return S
        return self.now_ns - (t_ns if self.seen.back_ns is None else max(t_ns, self.seen.back_ns))

    def since_ns(self, t_ns: int | None) -> int:
        return -1 if t_ns is None else self.now_ns - t_ns

    def certain_since_ns(self, *, steering: bool) -> int:
        """Return for how long the process can have known what is certainly implausible; -1 where nothing is."""
        plausibility, driving_ns = self._plausibility, self.seen.driving_ns
        if plausibility is None or driving_ns is None:
            return -1
        t_ns = (plausibility.steering_since if steering else plausibility.wheel_since)(self.now_ns)
        if t_ns is None:
            return -1
        self.certain_ns[t_ns] = self.now_ns
        return self.now_ns - max(t_ns, driving_ns + LAUNCH_NS) - CERTAINLY_NS

    def _look_at_wishes(self, launched_ns: int) -> None:
        """Find what the planner asks for besides driving: the end of the mission, the emergency brake, both pedals."""
        s, order, now_ns = self.seen, self.order, self.now_ns
        both = order is not None and order.throttle > 0.0 and order.brake > 0.0
        if both and order is not None and not self.nothing_hidden:
            # The planner still brakes, not a stop for a reason that cannot be seen here.
            follows = s.braked_pct == 0.0 or abs(s.braked_pct - 100.0 * order.brake) <= BRAKE_STEP_PCT / 2
            both = follows and s.stopped is None and not self.motor_brakes
        if not both or s.command_ns is None:
            s.pedals_ns = None  # for as long as no command counts, none asks for both
        elif s.pedals_ns is None:
            s.pedals_ns = max(s.command_ns, launched_ns) if self.nothing_hidden else now_ns
        listens = not self.over if self.nothing_hidden else s.stopped is None
        if order is not None and s.autonomous and listens and not s.latched:
            if s.pedals_ns is not None and now_ns - s.pedals_ns >= PEDALS_NS:
                self._alarm("throttle and brake together for 100 ms")
            if order.estop:
                self._alarm("the mission asks for the emergency brake")
            if order.finished:
                self._stop("mission complete: braking to a stop")

    def _on_mode(self, mode: str, may_turn_manual: bool, must_turn_manual: bool) -> None:
        s = self.seen
        if mode == "autonomous":
            if s.autonomous and must_turn_manual:
                self.wrong("modes", "the mode is autonomous after 300 ms without a command")
            elif not s.autonomous:
                self.wrong("modes", f"the mode is autonomous in {self.where}, and nobody chose that")
        elif s.autonomous and not may_turn_manual and self.nothing_hidden:
            self.wrong("modes", "the mode has become manual, and nothing asked for that")
        if must_turn_manual or (mode != "autonomous" and (may_turn_manual or not self.nothing_hidden)):
            s.autonomous = False
            self._stop("the mode is manual")


# ---------------------------------------------------------------- the table

AT_ONCE: Final[tuple[tuple[str, Callable[[Reactions], bool]], ...]] = (
    ("AS_OFF, AS_READY and AS_DRIVING were not seen in turn", lambda v: v.seen.path != WHOLE),
    ("AS_READY did not last 5 s before Go", lambda v: not v.seen.waited and not v.short_sequence),
    ("no mission was acknowledged", lambda v: v.seen.mission is Ami.NOT_SELECTED or not v.seen.acknowledged),
    ("not both resets are confirmed", lambda v: len(v.seen.confirmed) < len(ROLES)),
    ("Go is off", lambda v: not v.seen.go),
    ("the software was stopped", lambda v: v.seen.ended is not None),
)
"""Conditions that stop a run in the cycle in which they are seen."""

STALE: Final = FEEDBACK_STALE_NS, FEEDBACK_LOST_NS
ODD: Final = ODD_NS, ODD_LOST_NS
GRADED: Final = (
    Lasting("0x520 is lost", lambda v: v.missing_ns(v.seen.status_ns), alarm_ns=STATUS_LOST_NS, supervised=False),
    Lasting("wheel speeds missing", lambda v: v.missing_ns(v.wheels.may_count_ns), *STALE),
    Lasting("the steering implausible", lambda v: v.since_ns(v.seen.steer_odd_ns), *ODD),
    Lasting("a wheel implausible", lambda v: v.since_ns(v.seen.wheel_odd_ns), *ODD),
    Lasting("the steering certainly implausible", lambda v: v.certain_since_ns(steering=True), *ODD),
    Lasting("a wheel certainly implausible", lambda v: v.certain_since_ns(steering=False), *ODD),
)
