"""The evidence's own copy of the rules' numbers against what the bridge is delivered with."""

from __future__ import annotations

from fsai_hil.rules import numbers as numbers
from fsai_vcu.core.supervision.config import BridgeConfig
from fsai_vcu.core.supervision.gate import constant_power_nm
from fsai_vcu.interface.specification import AXLE_TORQUE_MAX_NM, MOTOR_SPEED_MAX_RPM


def test_the_bridge_has_the_times_of_the_evidence() -> None:
    config = BridgeConfig()
    times = (
        (config.listen_first_ns, numbers.LISTEN_FIRST_NS),
        (config.launch_wait_ns, numbers.LAUNCH_NS),
        (config.standstill_ns, numbers.STILL_NS),
        (config.power_cycle_ns, numbers.POWER_CYCLE_NS),
        (config.command_stale_ns, numbers.COMMAND_FRESH_NS),
        (config.command_lost_ns, numbers.COMMAND_LOST_NS),
        (config.sensor_stale_ns, numbers.DATA_FRESH_NS),
        (config.sensor_future_ns, numbers.FUTURE_NS),
        (config.both_pedals_ns, numbers.PEDALS_NS),
        (config.stop_timeout_ns, numbers.STOP_TIMEOUT_NS),
        (config.vcu_stale_ns, numbers.STATUS_FRESH_NS),
        (config.vcu_lost_ns, numbers.STATUS_LOST_NS),
        (config.as_state_known_ns, numbers.AS_STATE_KNOWN_NS),
        (config.feedback_stale_ns, numbers.FEEDBACK_STALE_NS),
        (config.feedback_stale_ns, numbers.SPEEDS_FRESH_NS),
        (config.feedback_lost_ns, numbers.FEEDBACK_LOST_NS),
        (config.implausible_ns, numbers.ODD_NS),
        (config.implausible_lost_ns, numbers.ODD_LOST_NS),
        (config.send_lost_ns, numbers.SEND_LOST_NS),
        (config.ready_wait_ns, numbers.READY_SEEN_NS),
        (config.standstill_ns, numbers.COUNTED_NS),
        (config.backlog_ns, numbers.BACKLOG_NS),
    )
    assert [ours for ours, _ in times] == [theirs for _, theirs in times]
    assert (config.stop_cycles, config.standstill_rpm) == (numbers.STOP_CYCLES, numbers.STILL_RPM)
    assert config.wheel_max_rpm == numbers.SPEED_MOST_RPM
    assert config.wheel_change_max_rpm == numbers.SPEED_CHANGE_MOST_RPM
    assert config.wheel_jump_ns == numbers.SPEED_JUMP_NS
    assert numbers.DOUBT_OPEN_TURNS < config.wheel_doubt_turns < numbers.DOUBT_SURE_TURNS


def test_the_gate_has_the_limits_of_the_evidence() -> None:
    assert (AXLE_TORQUE_MAX_NM, MOTOR_SPEED_MAX_RPM) == (numbers.MOST_TORQUE_NM, numbers.MOST_MOTOR_RPM)
    for rpm in range(1251):
        assert constant_power_nm(rpm) == numbers.constant_power_nm(rpm)
