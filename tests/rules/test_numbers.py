"""The evidence's own copy of the rules' numbers against what the bridge is delivered with."""

from __future__ import annotations

from fsai_hil.rules import numbers, shown
from fsai_vcu.core.supervision.config import BridgeConfig
from fsai_vcu.core.supervision.gate import constant_power_nm
from fsai_vcu.interface.specification import AXLE_TORQUE_MAX_NM, MOTOR_SPEED_MAX_RPM

# Times and limits of the configuration that have another name in the rules; each name there is for a rule of its own.
NAMES = {
    "launch_wait_ns": ("LAUNCH_NS",),
    "ready_wait_ns": ("READY_SEEN_NS",),
    "standstill_ns": ("STILL_NS", "COUNTED_NS"),
    "command_stale_ns": ("COMMAND_FRESH_NS",),
    "sensor_stale_ns": ("DATA_FRESH_NS",),
    "sensor_future_ns": ("FUTURE_NS",),
    "both_pedals_ns": ("PEDALS_NS",),
    "vcu_stale_ns": ("STATUS_FRESH_NS",),
    "vcu_lost_ns": ("STATUS_LOST_NS",),
    "feedback_stale_ns": ("FEEDBACK_STALE_NS", "SPEEDS_FRESH_NS"),
    "implausible_ns": ("ODD_NS",),
    "implausible_lost_ns": ("ODD_LOST_NS",),
    "wheel_jump_ns": ("SPEED_JUMP_NS",),
    "standstill_rpm": ("STILL_RPM",),
    "wheel_max_rpm": ("SPEED_MOST_RPM",),
    "wheel_change_max_rpm": ("SPEED_CHANGE_MOST_RPM",),
}
NOT_OF_THE_RULES = {
    "stop_window_ns": "a stop without effect is due by stop_timeout_ns; the core may find it sooner",
    "slip_memory_ns": "what is certain is not explained by the longer memory of hil/fsai_hil/rules/plausible.py either",
}


def test_the_bridge_has_the_times_of_the_evidence() -> None:
    config = BridgeConfig()
    times = [name for name in config.__struct_fields__ if name.endswith("_ns")]
    assert {*NAMES, *NOT_OF_THE_RULES} <= {*config.__struct_fields__}
    for name in times:
        for theirs in () if name in NOT_OF_THE_RULES else NAMES.get(name, (name.upper(),)):
            number = getattr(numbers, theirs, getattr(shown, theirs, None))
            assert number is not None, (
                f"BridgeConfig.{name} has no number of the rules: write {theirs} down in hil/fsai_hil/rules, in "
                "numbers.py or beside its row in shown.py, by the requirement and not by the core; if no rule can have "
                "one, say why in NOT_OF_THE_RULES of tests/rules/test_numbers.py"
            )
            assert getattr(config, name) == number, (name, theirs)


def test_the_bridge_has_the_limits_of_the_evidence() -> None:
    """A limit of the rules has the name of the configuration's, in capitals, or one of `NAMES`."""
    config = BridgeConfig()
    limits = [name for name in config.__struct_fields__ if not name.endswith("_ns")]
    pairs = [(name, theirs) for name in limits for theirs in NAMES.get(name, (name.upper(),))]
    compared = [(name, theirs) for name, theirs in pairs if hasattr(numbers, theirs) or hasattr(shown, theirs)]
    for name, theirs in compared:
        assert getattr(config, name) == getattr(numbers, theirs, getattr(shown, theirs, None)), (name, theirs)
    assert {"stop_cycles", "standstill_rpm", "wheel_max_rpm", "wheel_change_max_rpm"} <= {name for name, _ in compared}
    assert numbers.DOUBT_OPEN_TURNS < config.wheel_doubt_turns < numbers.DOUBT_SURE_TURNS


def test_the_gate_has_the_limits_of_the_evidence() -> None:
    assert (AXLE_TORQUE_MAX_NM, MOTOR_SPEED_MAX_RPM) == (numbers.MOST_TORQUE_NM, numbers.MOST_MOTOR_RPM)
    for rpm in range(1251):
        assert constant_power_nm(rpm) == numbers.constant_power_nm(rpm)
