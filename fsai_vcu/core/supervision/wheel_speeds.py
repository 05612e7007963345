"""Belief in the wheel speeds (0x525), and what the pulse counts (0x526) say of standing still.

Pure: `pulses_of` and `on_counts` take frames of 0x526, `on_speeds` those of 0x525 and says why a frame is not believed;
it is then treated as if it never came. A wheel's two messages are compared in turns of the wheel: what it has turned by
its count while its reading says that it stands, and what it has turned by its reading while its count stands still.
Counts that are missing, or start again, contradict nothing.
"""

from __future__ import annotations

from fsai_vcu.core.supervision.config import BridgeConfig
from fsai_vcu.core.supervision.plausibility import WHEEL_NAMES
from fsai_vcu.core.vehicle.parameters import VehicleParameters
from fsai_vcu.interface.messages import WheelCounts, WheelSpeeds
from fsai_vcu.interface.units import MS
from fsai_vcu.interface.values import Value

_PERIOD_NS = 10 * MS  # of 0x525 and 0x526: two frames may be read closer together than they were measured
_COUNTS = 1 << 16  # interface specification v4.0: 16-bit counters that wrap
_SLACK = 2  # pulses more than the highest speed explains: an edge to either side of the period
_CLEARLY = 2  # times the speed under which a wheel stands

Wheels = tuple[int, ...]  # FL, FR, RL, RR
_ZEROS: Wheels = (0, 0, 0, 0)
_LEVEL = (0.0, 0.0, 0.0, 0.0)


# ---------------------------------------------------------------- pulses


class Pulses(Value, frozen=True):
    """Last advances of the wheels' pulse counts. Times are of the monotonic clock, None: never."""

    counts: WheelCounts | None = None
    steps: Wheels | None = None  # pulses between the last two frames; None: not to be compared
    newest_ns: tuple[int | None, ...] = (None, None, None, None)
    turning_ns: int | None = None  # of the newest two pulses of one wheel the older; the latest of all four wheels


def pulses_per_s(config: BridgeConfig, car: VehicleParameters) -> float:
    """Pulses of one wheel in a second at the highest speed that is believed."""
    return config.wheel_max_rpm / 60.0 * car.wheel_pulses_per_rev


def pulses_of(most_per_s: float, pulses: Pulses, counts: WheelCounts) -> Pulses:
    """A frame of 0x526. A count that moves by more than `most_per_s` explains has started again: no wheel turned so."""
    before = pulses.counts
    if before is None:
        return Pulses(counts)
    if before.fl == counts.fl and before.fr == counts.fr and before.rl == counts.rl and before.rr == counts.rr:
        return Pulses(counts, _ZEROS, pulses.newest_ns, pulses.turning_ns)
    steps = (
        (counts.fl - before.fl) % _COUNTS,
        (counts.fr - before.fr) % _COUNTS,
        (counts.rl - before.rl) % _COUNTS,
        (counts.rr - before.rr) % _COUNTS,
    )
    t_ns = counts.t_rx_ns
    if max(steps) > most_per_s * max(t_ns - before.t_rx_ns, _PERIOD_NS) / 1e9 + _SLACK:
        return Pulses(counts, None, pulses.newest_ns, pulses.turning_ns)
    newest, turning_ns = list(pulses.newest_ns), pulses.turning_ns
    for wheel, step in enumerate(steps):
        if step:
            older_ns = t_ns if step > 1 else newest[wheel]
            newest[wheel] = t_ns
            if older_ns is not None:
                turning_ns = older_ns if turning_ns is None else max(older_ns, turning_ns)
    return Pulses(counts, steps, tuple(newest), turning_ns)


def turning(standstill_ns: int, turning_ns: int | None, now_ns: int) -> bool:
    """Return true where a wheel's count advanced by 2 or more in the last `standstill_ns`: 1 may be an edge at rest."""
    return turning_ns is not None and now_ns - turning_ns < standstill_ns


NO_PULSES = Pulses()
"""Pulses before the first frame of 0x526."""


# ---------------------------------------------------------------- belief


class WheelBelief(Value, frozen=True):
    """State that is needed to believe the next frame of 0x525."""

    speeds: WheelSpeeds | None = None  # the last frame that was believed
    reading_ns: int | None = None  # the last frame within the database's range, believed or not
    least_rpm: Wheels = _ZEROS  # readings since the last 0x526, with the one before it
    most_rpm: Wheels = _ZEROS
    newest_rpm: Wheels = _ZEROS
    pulses: Pulses = NO_PULSES
    has_counted: tuple[bool, ...] = (False, False, False, False)
    # By how many turns the count is ahead of a reading that says standing; below 0 the reading is ahead of the count.
    ahead: tuple[float, ...] = _LEVEL
    # Wheels whose count is ahead (1) or behind (-1) by too much, until it is ahead no more.
    doubted: Wheels = _ZEROS


def on_counts(config: BridgeConfig, car: VehicleParameters, belief: WheelBelief, counts: WheelCounts) -> WheelBelief:
    """A frame of 0x526: compare it with the readings since the frame before."""
    before, t_ns = belief.pulses, counts.t_rx_ns
    pulses = pulses_of(pulses_per_s(config, car), before, counts)
    newest = belief.newest_rpm
    if (
        pulses.steps is None
        or before.counts is None
        or t_ns - before.counts.t_rx_ns >= config.feedback_stale_ns
        or belief.reading_ns is None
        or t_ns - belief.reading_ns >= config.feedback_stale_ns
    ):
        return WheelBelief(
            belief.speeds, belief.reading_ns, newest, newest, newest, pulses, belief.has_counted, _LEVEL, _ZEROS
        )
    stands_rpm = config.standstill_rpm
    has_counted, ahead, doubted = belief.has_counted, belief.ahead, belief.doubted
    if pulses.steps is not _ZEROS or ahead is not _LEVEL or max(belief.most_rpm) >= stands_rpm:
        dt_s = (t_ns - before.counts.t_rx_ns) / 1e9
        explained = _CLEARLY * stands_rpm / 60.0 * dt_s
        limit = config.wheel_doubt_turns
        levels, doubts, counted = list(ahead), list(doubted), list(has_counted)
        for wheel, step in enumerate(pulses.steps):
            level = levels[wheel]
            least_rpm = belief.least_rpm[wheel]
            counted[wheel] = counted[wheel] or step > 1 or (step == 1 and before.newest_ns[wheel] is not None)
            if belief.most_rpm[wheel] < stands_rpm:
                turned = step / car.wheel_pulses_per_rev
                level = max(0.0, min(limit, level + turned - explained))
            elif step == 0 and counted[wheel] and least_rpm >= _CLEARLY * stands_rpm:
                level -= least_rpm / 60.0 * dt_s
            else:
                level = 0.0
            levels[wheel] = level
            doubts[wheel] = 1 if level >= limit else -1 if level <= -limit else doubts[wheel] if level else 0
        has_counted, doubted = tuple(counted), tuple(doubts)
        ahead = tuple(levels) if any(levels) else _LEVEL
    return WheelBelief(belief.speeds, belief.reading_ns, newest, newest, newest, pulses, has_counted, ahead, doubted)


def on_speeds(config: BridgeConfig, belief: WheelBelief, speeds: WheelSpeeds) -> tuple[WheelBelief, str]:
    """A frame of 0x525: what is known after it, and why it is not believed; empty when it is."""
    rpm, t_ns = speeds.all_rpm, speeds.t_rx_ns
    if max(rpm) > config.wheel_max_rpm:
        return belief, f"the {WHEEL_NAMES[rpm.index(max(rpm))]} wheel reads more than {config.wheel_max_rpm} rpm"
    least, most = belief.least_rpm, belief.most_rpm
    if rpm != belief.newest_rpm:
        least, most = tuple(map(min, least, rpm)), tuple(map(max, most, rpm))
    doubt = _contradicted(config, belief, rpm, t_ns) or _too_fast(config, belief.speeds, speeds)
    believed = belief.speeds if doubt else speeds
    pulses, has_counted = belief.pulses, belief.has_counted
    return WheelBelief(believed, t_ns, least, most, rpm, pulses, has_counted, belief.ahead, belief.doubted), doubt


def _too_fast(config: BridgeConfig, before: WheelSpeeds | None, speeds: WheelSpeeds) -> str:
    """A wheel whose speed is further from the last one believed than a tyre can follow.

    What stays there is believed again after `wheel_jump_ns`, when it has been reacted to as a missing frame.
    """
    if before is None or speeds.all_rpm == before.all_rpm or speeds.t_rx_ns - before.t_rx_ns >= config.wheel_jump_ns:
        return ""
    for wheel, (now, then) in enumerate(zip(speeds.all_rpm, before.all_rpm, strict=True)):
        if abs(now - then) > config.wheel_change_max_rpm:
            return f"the {WHEEL_NAMES[wheel]} wheel changed faster than a tyre can follow"
    return ""


def _contradicted(config: BridgeConfig, belief: WheelBelief, rpm: Wheels, t_ns: int) -> str:
    """A wheel whose pulse count says the opposite."""
    counts = belief.pulses.counts
    if belief.doubted == _ZEROS or counts is None or t_ns - counts.t_rx_ns >= config.feedback_stale_ns:
        return ""
    for wheel, doubt in enumerate(belief.doubted):
        if doubt == 1 and rpm[wheel] < config.standstill_rpm:
            return f"the {WHEEL_NAMES[wheel]} wheel reads under {config.standstill_rpm} rpm while its pulse count runs"
        if doubt == -1 and rpm[wheel] >= _CLEARLY * config.standstill_rpm:
            return f"the {WHEEL_NAMES[wheel]} wheel reads a speed while its pulse count stands still"
    return ""
