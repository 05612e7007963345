"""Reasons for which a guard acted.

A reason means that something is wrong: in nominal driving there is none. What the gate does as a matter of course
(holding brake, the 3 s wait, steering at the actuator's rate, less torque at speed, a cycle of zeros between brake and
torque) is no reason.
"""

from __future__ import annotations

from enum import Enum


class Reason(Enum):
    """Value: the short name that is counted and logged; `words`: the sentence for a person."""

    def __new__(cls, slug: str, words: str) -> Reason:
        member = object.__new__(cls)
        member._value_ = slug
        return member

    def __init__(self, slug: str, words: str) -> None:
        self.slug = slug
        self.words = words

    # Reactions of the supervisor
    COMMAND_STALE = "command_stale", "the vehicle command is stale: it stopped coming, or the data behind it is too old"
    STOP_INEFFECTIVE = "stop_ineffective", "the service brake does not stop the car"
    BOTH_PEDALS = "both_pedals", "one command asks for throttle and brake together: the brake wins"
    VCU_SILENT = "vcu_silent", "0x520 from the VCU is missing"
    WHEELS_STALE = "wheels_stale", "wheel speeds (0x525) are missing or not believed"
    STEERING_STALE = "steering_stale", "steering feedback (0x523) is missing"
    STEERING_IMPLAUSIBLE = "steering_implausible", "the steering does not follow what it is asked for"
    WHEEL_IMPLAUSIBLE = "wheel_implausible", "one wheel speed does not fit the other three"
    GO_OFF = "go_off", "GO_SIGNAL is 0 in AS_DRIVING: the car is stopping itself"
    FAULT_STATUS = "fault_status", "FAULT_STATUS is 1 in AS_DRIVING: the car is stopping itself"
    AS_STATE_UNKNOWN = (
        "as_state_unknown",
        "0x520 has no AS_STATE that is known, or has not had one for 100 ms again",
    )
    AS_SWITCH_OFF = "as_switch_off", "AS_SWITCH_STATUS fell to 0 in AS_DRIVING: ASMS was switched off"
    TS_SWITCH_OFF = "ts_switch_off", "TS_SWITCH_STATUS fell to 0 in AS_DRIVING: TSMS was switched off"
    SHUTDOWN_REQUESTED = "shutdown_requested", "SHUTDOWN_REQUEST rose in AS_DRIVING: the car is about to switch off"
    FAULT_BIT = "fault_bit", "a fault bit of 0x520 rose in AS_DRIVING"
    SHUTDOWN_CAUSE = "shutdown_cause", "SHUTDOWN_CAUSE rose from 0 in AS_DRIVING"
    STATE_FAULT = "state_fault", "EBS_STATE, TS_STATE or OP_STATE became FAULT in AS_DRIVING"
    AMI_CHANGED = "ami_changed", "AMI_STATE changed in AS_DRIVING: another mission than this run's, or none"
    INTRUDER = "intruder", "somebody else sends on the AI computer's ids 0x510 to 0x514"
    LOOP_FAULT = "loop_fault", "the loop failed or missed its deadline by 50 ms"
    BUS_LOST = "bus_lost", "the bus was lost"
    BACKLOG = "backlog", "frames of the car waited 20 ms or more before they were read"
    OTHER_REVISION = "other_revision", "frames of another interface revision are received"
    NOT_SEEN = "not_seen", "AS_DRIVING, but this process did not see AS_OFF, AS_READY and AS_DRIVING follow one another"
    SEQUENCE_SHORT = "sequence_short", "AS_DRIVING did not follow 5 s in AS_READY and a Go that came after them"
    NO_MISSION = "no_mission", "AS_DRIVING, but no mission was acknowledged in this run"
    NOT_CONFIRMED = "not_confirmed", "AS_DRIVING, but planner or controller never confirmed their reset for this run"
    STACK_RESTARTED = "stack_restarted", "planner or controller was restarted in AS_DRIVING: this run is over"
    VCU_REBOOT = "vcu_reboot", "AS_STATE fell back out of AS_DRIVING: the VCU restarted or ASMS went off"

    # Guards of the gate
    COMMAND_REFUSED = (
        "command_refused",
        "a vehicle command was refused whole: not finite, out of range or from the future",
    )
    COMMAND_OTHER_RUN = "command_other_run", "a vehicle command belongs to another run"
    STEER_CLAMPED = "steer_clamped", "the steering asked for is beyond ANGLE_MAX or the operational limit"
    TORQUE_LIMIT_UNKNOWN = "torque_limit_unknown", "the car's live torque limit (0x521, 0x522) is missing: no torque"
    TORQUE_BLOCKED = "torque_blocked", "the gate held back torque that the supervisor had let through"
    STILLNESS_UNPROVEN = "stillness_unproven", "the gate held back NEUTRAL or FINISHED while a wheel may turn"


_BY_SLUG = {reason.slug: reason for reason in Reason}


def words_of(slug: str) -> str:
    """The sentence for a reason's short name."""
    return _BY_SLUG[slug].words
