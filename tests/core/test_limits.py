"""Operational limits: what an official allows at a venue."""

from __future__ import annotations

import math

import pytest

from fsai_vcu.core.limits import UNLIMITED, LimitsError, OperationalLimits, parse_limits


def test_given_limits_are_taken_and_missing_ones_do_not_limit() -> None:
    limits = parse_limits({"max_speed_mps": 5, "max_steer_deg": 12.5})
    assert limits == OperationalLimits(max_speed_mps=5.0, max_axle_torque_nm=math.inf, max_steer_deg=12.5)
    assert parse_limits({}) == UNLIMITED


@pytest.mark.parametrize(
    ("mapping", "words"),
    [
        (
            {"max_speed": 5.0},
            "unknown limit max_speed: the limits are max_speed_mps, max_axle_torque_nm, max_steer_deg",
        ),
        ({"max_speed_mps": "5"}, "max_speed_mps is '5': a limit is a number"),
        ({"max_speed_mps": True}, "max_speed_mps is True: a limit is a number"),
        ({"max_speed_mps": math.nan}, "max_speed_mps is nan: a limit is a finite number of 0 or more"),
        ({"max_speed_mps": math.inf}, "max_speed_mps is inf: a limit is a finite number of 0 or more"),
        ({"max_speed_mps": 10**400}, "max_speed_mps is inf: a limit is a finite number of 0 or more"),
        ({"max_axle_torque_nm": -1}, "max_axle_torque_nm is -1.0: a limit is a finite number of 0 or more"),
    ],
)
def test_a_limit_that_cannot_be_used_is_refused_in_one_line(mapping: dict[str, object], words: str) -> None:
    with pytest.raises(LimitsError) as refused:
        parse_limits(mapping)
    assert str(refused.value) == words


@pytest.mark.parametrize("value", [math.nan, -0.1])
def test_limits_made_in_code_are_held_to_the_same_sense(value: float) -> None:
    with pytest.raises(LimitsError, match="max_speed_mps is"):
        OperationalLimits(max_speed_mps=value)


def test_limits_can_be_confirmed_on_the_screen() -> None:
    assert OperationalLimits(max_speed_mps=5.0).described() == (
        "max_speed_mps = 5",
        "max_axle_torque_nm = not limited",
        "max_steer_deg = not limited",
    )
