"""Since when something is surely implausible, worked out from the frames on the bus and nothing else.

Sure means: by more than the rules' own margin, so that a correct supervisor cannot overlook it.
"""

from __future__ import annotations

import math
from typing import Final

from fsai_hil.evidence.campaign.observation import Observation
from fsai_hil.rules.wheels import Belief, Wheels
from fsai_vcu.core.vehicle.parameters import VehicleParameters
from fsai_vcu.interface.enums import AsState
from fsai_vcu.interface.units import MS

# The official simulator's steering: 50 ms dead time, 40 deg/s (the true rate was never published), 0.9 deg play.
STEER_DEAD_NS: Final = 50 * MS
STEER_RATES_DEGPS: Final = (30.0, 50.0)
STEER_SURE_DEG: Final = 0.9 + 2.0 + 0.6

WHEEL_SURE_RPM: Final = 80.0
WHEEL_SURE_SHARE: Final = 0.40
SLIP_NS: Final = 1050 * MS  # torque or brake so long ago still explains a slipping wheel

Streak = tuple[int, int]


def steering_streaks(seen: Observation, car: VehicleParameters, from_ns: int) -> list[Streak]:
    """When, in AS_DRIVING, the measured angle was surely not where the requests can have brought it."""
    streaks: list[Streak] = []
    slow = fast = None
    target = 0.0
    index = 0
    before_ns = from_ns
    for t_ns, angle in seen.angles:
        while index < len(seen.requests) and seen.requests[index][0] + STEER_DEAD_NS <= t_ns:
            target = seen.requests[index][1]
            index += 1
        if slow is None or fast is None or t_ns < from_ns or t_ns - before_ns > 50 * MS:
            slow = fast = angle
            before_ns = t_ns
            continue
        step_s = (t_ns - before_ns) / 1e9
        before_ns = t_ns
        slow = _toward(slow, target, STEER_RATES_DEGPS[0] * step_s)
        fast = _toward(fast, target, STEER_RATES_DEGPS[1] * step_s)
        off = not min(slow, fast) - STEER_SURE_DEG <= angle <= max(slow, fast) + STEER_SURE_DEG
        if off and seen.state_at(t_ns) is AsState.AS_DRIVING:
            _extend(streaks, t_ns)
    return streaks


def wheel_streaks(seen: Observation, car: VehicleParameters, from_ns: int) -> list[Streak]:
    """When one wheel was surely off the other three, and neither wheelspin nor locking could explain it."""
    driven = (car.driven_front, car.driven_front, car.driven_rear, car.driven_rear)
    odd: dict[tuple[int, bool], list[Streak]] = {}
    angles = iter(seen.angles)
    angle_ns, angle = next(angles, (0, 0.0))
    upcoming = next(angles, None)
    for t_ns, rpm in seen.wheels:
        while upcoming is not None and upcoming[0] <= t_ns:
            angle_ns, angle = upcoming
            upcoming = next(angles, None)
        if t_ns < from_ns or seen.state_at(t_ns) is not AsState.AS_DRIVING or angle_ns > t_ns:
            continue
        rolling = [value / factor for value, factor in zip(rpm, _factors(car, angle), strict=True)]
        for wheel in range(4):
            middle = sorted(rolling[:wheel] + rolling[wheel + 1 :])[1]
            beyond = rolling[wheel] - middle
            if abs(beyond) > WHEEL_SURE_RPM + WHEEL_SURE_SHARE * middle:
                _extend(odd.setdefault((wheel, beyond > 0), []), t_ns)
    found: list[Streak] = []
    for (wheel, too_fast), streaks in odd.items():
        for start_ns, end_ns in streaks:
            sure_ns = start_ns
            for cycle in seen.cycles:
                if cycle.t_ns > sure_ns:
                    break  # what is asked for once a wheel is odd explains nothing any more
                torque = cycle.torque_nm > 0.0 and driven[wheel]  # spins it, or drags it at its speed limit
                if torque or (cycle.brake_pct > 0.0 and not too_fast):
                    sure_ns = max(sure_ns, cycle.t_ns + SLIP_NS)
            if sure_ns < end_ns:
                found.append((sure_ns, end_ns))
    return sorted(found)


def count_streaks(seen: Observation, car: VehicleParameters, from_ns: int) -> list[Streak]:
    """When, in AS_DRIVING, wheel speeds came that surely may not be believed."""
    wheels = Wheels(car.wheel_pulses_per_rev)
    streaks: list[Streak] = []
    frames = [(t_ns, 0, rpm) for t_ns, rpm in seen.wheels] + [(t_ns, 1, counts) for t_ns, counts in seen.counts]
    for t_ns, kind, values in sorted(frames):
        if kind:
            wheels.on_counts(values, t_ns)
        elif (
            wheels.on_speeds(values, t_ns) is Belief.NO
            and t_ns >= from_ns
            and (seen.state_at(t_ns) is AsState.AS_DRIVING)
        ):
            _extend(streaks, t_ns)
    return streaks


def _factors(car: VehicleParameters, steer_deg: float) -> tuple[float, float, float, float]:
    """How fast each wheel rolls on its own circle, against the middle of the rear axle."""
    curvature = math.tan(math.radians(steer_deg)) / car.wheelbase_m
    left, right = 1.0 - curvature * car.track_m / 2.0, 1.0 + curvature * car.track_m / 2.0
    ahead = curvature * car.wheelbase_m
    return math.hypot(left, ahead), math.hypot(right, ahead), left, right


def _extend(streaks: list[Streak], t_ns: int) -> None:
    if streaks and t_ns - streaks[-1][1] <= 15 * MS:
        streaks[-1] = (streaks[-1][0], t_ns)
    else:
        streaks.append((t_ns, t_ns))


def _toward(value: float, target: float, most: float) -> float:
    return max(value - most, min(value + most, target))
