"""An observer's view of steering and wheels: since when one of them is certainly implausible.

Written apart from the core, and coarser: certain means by more than the rules' own margin, so a correct supervisor
cannot overlook it.
"""

from __future__ import annotations

import math
from collections import deque
from typing import Final

from fsai_hil.rules.numbers import MS, S
from fsai_vcu.core.vehicle.parameters import VehicleParameters

_RATES: Final = (0.75, 1.25)  # shares of the car's steering rate: of the 2021 and 2026 cars it was never published
_STEER_SURE_DEG: Final = 2.0 + 0.6  # beyond the car's backlash

_WHEEL_SURE_RPM: Final = 80.0
_WHEEL_SURE_SHARE: Final = 0.40
_SLIP_NS: Final = 1050 * MS  # torque or brake so long ago still explains a slipping wheel
_GAP_NS: Final = 15 * MS  # frames of one message come every 10 ms: what is missed for longer begins again


class Streak:
    """One thing that is implausible in each frame since `since_ns`, as far as nothing explains it."""

    def __init__(self) -> None:
        self.since_ns = 0
        self.last_ns = -S

    def extend(self, t_ns: int, explained_until_ns: int = 0) -> None:
        """It is implausible at `t_ns` too, and from then on nothing that is asked for explains it any more."""
        if t_ns - self.last_ns > _GAP_NS:
            self.since_ns = max(t_ns, explained_until_ns)
        self.last_ns = t_ns

    def certain_since(self, now_ns: int) -> int | None:
        return self.since_ns if self.since_ns <= now_ns <= self.last_ns + _GAP_NS else None


class Plausibility:
    """Feed it with requests and measurements in the order of time. `judges`: the car drives, and is supervised."""

    def __init__(self, car: VehicleParameters) -> None:
        """Begin with a car of which nothing is known."""
        self._car = car
        self._dead_ns = round(car.steer_dead_time_s * S)
        self._rates_degps = [share * math.degrees(car.steer_rate_radps) for share in _RATES]
        self._steer_sure_deg = math.degrees(car.steer_backlash_rad) + _STEER_SURE_DEG
        self._driven = (car.driven_front, car.driven_front, car.driven_rear, car.driven_rear)
        self._requests: deque[tuple[int, float]] = deque()
        self._target_deg = self._angle_deg = 0.0
        self._band_deg: tuple[float, float] | None = None  # where the slowest and the fastest steering can be by now
        self._angle_ns = 0
        self._steering = Streak()
        self._torque_ns = self._brake_ns = -_SLIP_NS  # when asked for last
        self._wheels: dict[tuple[int, bool], Streak] = {}

    # ------------------------------------------------------------ what is asked for

    def on_steer_request(self, deg: float, t_ns: int) -> None:
        self._requests.append((t_ns, deg))

    def on_cycle(self, *, torque: bool, brake: bool, t_ns: int) -> None:
        """A cycle went out: what it asks for explains slip, but not that of a wheel which is certainly odd already."""
        self._torque_ns = t_ns if torque else self._torque_ns
        self._brake_ns = t_ns if brake else self._brake_ns
        for (wheel, fast), streak in self._wheels.items():
            if t_ns <= streak.since_ns:
                streak.since_ns = max(streak.since_ns, self._explained_until_ns(wheel, fast))

    def _explained_until_ns(self, wheel: int, fast: bool) -> int:
        """Torque spins a driven wheel, or drags it at its speed limit; the brake locks any."""
        asked_ns = self._torque_ns if self._driven[wheel] else -_SLIP_NS
        return max(asked_ns, -_SLIP_NS if fast else self._brake_ns) + _SLIP_NS

    # ------------------------------------------------------------ what is measured

    def on_angle(self, deg: float, t_ns: int, *, judges: bool) -> None:
        """Compare a measured angle with where the requests can have brought it."""
        while self._requests and self._requests[0][0] + self._dead_ns <= t_ns:
            self._target_deg = self._requests.popleft()[1]
        step_ns, self._angle_ns, self._angle_deg = t_ns - self._angle_ns, t_ns, deg
        if self._band_deg is None or not judges or step_ns > 5 * _GAP_NS:
            self._band_deg = deg, deg
            return
        slow, fast = (
            max(one - most, min(one + most, self._target_deg))
            for one, most in zip(self._band_deg, (rate * step_ns / S for rate in self._rates_degps), strict=True)
        )
        self._band_deg = slow, fast
        sure_deg = self._steer_sure_deg
        if not min(slow, fast) - sure_deg <= deg <= max(slow, fast) + sure_deg:
            self._steering.extend(t_ns)

    def on_speeds(self, rpm: tuple[int, int, int, int], t_ns: int) -> None:
        """Compare each wheel with the other three, of a car that is supervised on the road."""
        rolling = [value / factor for value, factor in zip(rpm, self._factors(), strict=True)]
        for wheel in range(4):
            middle = sorted(rolling[:wheel] + rolling[wheel + 1 :])[1]
            beyond = rolling[wheel] - middle
            if abs(beyond) > _WHEEL_SURE_RPM + _WHEEL_SURE_SHARE * middle:
                key = wheel, beyond > 0
                self._wheels.setdefault(key, Streak()).extend(t_ns, self._explained_until_ns(*key))

    def _factors(self) -> tuple[float, float, float, float]:
        """Return by how much faster each wheel rolls on its own circle than the middle of the rear axle."""
        curvature = math.tan(math.radians(self._angle_deg)) / self._car.wheelbase_m
        left, right = 1.0 - curvature * self._car.track_m / 2.0, 1.0 + curvature * self._car.track_m / 2.0
        ahead = curvature * self._car.wheelbase_m
        return math.hypot(left, ahead), math.hypot(right, ahead), left, right

    # ------------------------------------------------------------ what is certain

    def steering_since(self, now_ns: int) -> int | None:
        return self._steering.certain_since(now_ns)

    def wheel_since(self, now_ns: int) -> int | None:
        since = (streak.certain_since(now_ns) for streak in self._wheels.values())
        return min((one for one in since if one is not None), default=None)
