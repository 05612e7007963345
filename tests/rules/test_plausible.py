"""The observer's own view of the steering takes the numbers of the car that it looks at."""

from __future__ import annotations

import math

import pytest
from msgspec.structs import replace

from fsai_hil.rules.numbers import MS
from fsai_hil.rules.plausible import Plausibility
from fsai_vcu.core.vehicle.parameters import ADS_DV_2026


@pytest.mark.parametrize(("rate_degps", "certain"), [(20.0, False), (40.0, True)])
def test_a_rack_is_slow_by_its_own_cars_rate(rate_degps: float, certain: bool) -> None:
    """It swings over 42 deg at 20 deg/s: in order for the one car, stuck for the other."""
    plausible = Plausibility(replace(ADS_DV_2026, steer_rate_radps=math.radians(rate_degps)))
    plausible.on_angle(-21.0, 0, judges=True)
    plausible.on_steer_request(21.0, 0)
    found = False
    for t_ns in range(10 * MS, 2000 * MS, 10 * MS):
        seconds = max(0.0, (t_ns - 50 * MS) / 1e9)
        plausible.on_angle(min(21.0, -21.0 + 20.0 * seconds), t_ns, judges=True)
        found = found or plausible.steering_since(t_ns) is not None
    assert found is certain
