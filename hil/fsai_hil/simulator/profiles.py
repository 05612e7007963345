"""The profiles of a VCU: the specification's behaviour, and the official simulator's with its quirks.

A profile is a list of named differences. The defaults are the interface specification's.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

from fsai_vcu.interface.specification import COMMS_LOST_NS, EMERGENCY_TIMER_NS, READY_WAIT_NS
from fsai_vcu.interface.values import Value


class Profile(Value, frozen=True, kw_only=True):
    """One way in which a VCU behaves. Each field is a difference that somebody can meet."""

    name: str

    # the link to the AI computer (interface specification v4.0: handshake and loss of communication)
    handshake_waits_for_echo: bool = True  # else it alternates with every 0x520, whatever comes back
    echo_timeout_ns: int | None = COMMS_LOST_NS  # None: any echo is taken for the right one

    # the autonomous-system state machine
    ready_wait_ns: int = READY_WAIT_NS
    emergency_timer_ns: int = EMERGENCY_TIMER_NS
    start_needs_selected: bool = False  # AS_DRIVING begins only while MISSION_STATUS is SELECTED
    # The messages arrive one after another, 0x511 and 0x512 before 0x514: a change from brake to torque in one call
    # shows both for a moment. The specification does not say whether that is judged by the frame or by a VCU's cycle.
    pedals_judged_by_frame: bool = True
    brake_request_is_emergency: bool = False
    estop_request_in_as_off: bool = False
    neutral_fault_needs_all_wheels: bool = False
    asms_off_resets: bool = False  # ASMS off leads to AS_OFF from everywhere, and clears what was latched
    go_off_ignored_in_driving: bool = False
    ready_without_acknowledgement: bool = False  # AS_READY with any MISSION_STATUS
    not_selected_is_as_off: bool = False

    # what is sent and done
    as_state_zero_without_asms: bool = False
    sends_brake_and_ebs_status: bool = True  # else STATUS_BRK and STATUS_EBS are 0
    brakes_fully_when_neutral: bool = False
    whole_degree_steering: bool = False
    rear_torque_only: bool = False
    simulators_car: bool = False  # the car under it is the official simulator's (mass, wheel radius 0.15 m, pulses)


SPECIFICATION: Final = Profile(name="specification")

OFFICIAL_SIMULATOR: Final = Profile(
    name="official-simulator",
    handshake_waits_for_echo=False,
    echo_timeout_ns=None,  # its published source overrides the check: an inverted echo passes there, and not on the car
    start_needs_selected=True,
    brake_request_is_emergency=True,
    estop_request_in_as_off=True,
    neutral_fault_needs_all_wheels=True,
    asms_off_resets=True,
    go_off_ignored_in_driving=True,
    not_selected_is_as_off=True,
    as_state_zero_without_asms=True,
    sends_brake_and_ebs_status=False,
    brakes_fully_when_neutral=True,
    whole_degree_steering=True,
    rear_torque_only=True,
    simulators_car=True,
)

PROFILES: Final[Mapping[str, Profile]] = MappingProxyType(
    {profile.name: profile for profile in (SPECIFICATION, OFFICIAL_SIMULATOR)}
)
