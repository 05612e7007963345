"""The autonomous-system state machine of the VCU, as a table.

Rules:
- The rows of a state are tried in order; the first whose condition holds is taken, one per look.
- Emergencies stand before everything else, and those that carry a fault name it: the fault bit and SHUTDOWN_CAUSE
  follow from the row, never from elsewhere.
- A row may belong to a profile's quirk (`only`) or give way to one (`unless`); both name a field of `Profile`.

Source: the vehicle's interface specification v4.0 and the documents of 2026.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, Final

from msgspec import Struct

from fsai_hil.simulator.profiles import Profile
from fsai_vcu.interface.enums import Ami, AsState, Direction, MissionStatus
from fsai_vcu.interface.enums import ShutdownCause as Cause
from fsai_vcu.interface.specification import READY_STEER_DEG, STANDING_RPM
from fsai_vcu.interface.values import Value


class Situation(Struct):
    """The inputs of the state machine at one instant. The defaults are a car at rest with everything switched off."""

    # people
    asms: bool = False
    tsms: bool = False
    go: bool = False
    go_rising: bool = False  # Go was off when the machine last looked
    ami: Ami = Ami.NOT_SELECTED

    # the car
    sdc_open: bool = False
    ebs_armed: bool = False
    tractive_system_running: bool = False
    power_cycle_needed: bool = False
    slowest_wheel_rpm: float = 0.0
    fastest_wheel_rpm: float = 0.0
    steer_deg: float = 0.0
    hvil_open: bool = False
    hvil_short: bool = False
    ebs_fault: bool = False
    offboard_charger_fault: bool = False
    charge_procedure_fault: bool = False
    bms_fault: bool = False

    # the AI computer
    comms_lost: bool = False
    estop_request: bool = False
    mission_status: MissionStatus = MissionStatus.NOT_SELECTED
    direction: Direction = Direction.NEUTRAL
    torque_requested: bool = False
    brake_requested: bool = False
    steer_requested: bool = False

    # timers
    ready_wait_over: bool = False
    emergency_timer_over: bool = False


Condition = Callable[[Any], bool]  # of a Situation, or of the Switches where it looks at these only
INIT, OFF, READY, DRIVING = AsState.AS_INIT, AsState.AS_OFF, AsState.AS_READY, AsState.AS_DRIVING
FINISHED, EMERGENCY = AsState.AS_FINISHED, AsState.EMERGENCY_BRAKE


class Fault(Value, frozen=True):
    """A fault bit of 0x520: what raises it, and the SHUTDOWN_CAUSE of the stop that it brings."""

    name: str  # a field of fsai_vcu.interface.messages.Faults
    cause: Cause
    when: Condition
    why: str
    only: str | None = None
    unless: str | None = None


# In AS_DRIVING these stop the car; elsewhere they are warnings of 0x120. Order: the first one names the cause.
AI_COMMS_LOST: Final = Fault(
    "ai_comms_lost",
    Cause.AI_COMMS_FAULT,
    lambda s: s.comms_lost,
    "the AI computer's messages or echo are missing",
)
AI_FAULTS: Final[tuple[Fault, ...]] = (
    Fault(
        "ai_estop_request",
        Cause.AI_COMPUTER_REQUEST,
        lambda s: s.estop_request,
        "the AI computer requests an emergency stop",
    ),
    Fault(
        "mission_status",
        Cause.MISSION_STATUS_FAULT,
        lambda s: s.mission_status is MissionStatus.FINISHED and s.fastest_wheel_rpm > STANDING_RPM,
        "mission FINISHED while a wheel turns",
    ),
    Fault(
        "autonomous_braking",
        Cause.AUTONOMOUS_BRAKING_FAULT,
        lambda s: s.direction is Direction.NEUTRAL and s.fastest_wheel_rpm > STANDING_RPM,
        "direction NEUTRAL while a wheel turns",
        unless="neutral_fault_needs_all_wheels",
    ),
    Fault(
        "autonomous_braking",
        Cause.AUTONOMOUS_BRAKING_FAULT,
        lambda s: s.direction is Direction.NEUTRAL and s.slowest_wheel_rpm > STANDING_RPM,
        "direction NEUTRAL while all wheels turn",
        only="neutral_fault_needs_all_wheels",
    ),
    AI_COMMS_LOST,
    Fault(
        "brake_plausibility",
        Cause.BRAKE_PLAUSIBILITY_FAULT,
        lambda s: s.torque_requested and s.brake_requested,
        "torque and brake requested together",
    ),
)

# Critical faults of the VCU and the battery: they open the shutdown circuit.
CAR_FAULTS: Final[tuple[Fault, ...]] = (
    Fault("hvil_open", Cause.HVIL_OPEN_FAULT, lambda s: s.hvil_open, "high-voltage interlock open"),
    Fault("hvil_short", Cause.HVIL_SHORT_FAULT, lambda s: s.hvil_short, "high-voltage interlock shorted"),
    Fault("ebs", Cause.EBS_FAULT, lambda s: s.ebs_fault, "EBS fault"),
    Fault(
        "offboard_charger", Cause.OFFBOARD_CHARGER_FAULT, lambda s: s.offboard_charger_fault, "off-board charger fault"
    ),
    Fault(
        "charge_procedure", Cause.CHARGE_PROCEDURE_FAULT, lambda s: s.charge_procedure_fault, "charge procedure fault"
    ),
    Fault("bms", Cause.BMS_FAULT, lambda s: s.bms_fault, "BMS fault"),
)

_EBS_UNAVAILABLE: Final = Fault("ebs", Cause.EBS_FAULT, lambda s: not s.ebs_armed, "the EBS is no longer available")


class Row(Value, frozen=True):
    """One transition. `fault` is set where it raises a fault bit; `reset` clears everything latched."""

    sources: tuple[AsState, ...]
    target: AsState
    why: str
    when: Condition
    fault: Fault | None = None
    reset: bool = False
    only: str | None = None
    unless: str | None = None


def _may_get_ready(s: Situation) -> bool:
    return s.asms and s.tsms and s.ebs_armed and s.ami is not Ami.NOT_SELECTED and not s.power_cycle_needed


def _acknowledged_and_may_get_ready(s: Situation) -> bool:
    return s.mission_status is MissionStatus.SELECTED and _may_get_ready(s)


def _may_start(s: Situation) -> bool:
    return (
        s.ready_wait_over
        and not s.torque_requested
        and not s.steer_requested
        and abs(s.steer_deg) < READY_STEER_DEG
        and s.direction is Direction.NEUTRAL
        and s.go_rising
    )


def _by_fault(faults: Iterable[Fault], *sources: AsState) -> tuple[Row, ...]:
    return tuple(Row(sources, EMERGENCY, f.why, f.when, fault=f, only=f.only, unless=f.unless) for f in faults)


def _asms_off(s: Situation) -> bool:
    return not s.asms


def _deselected(*sources: AsState) -> Row:
    return Row(
        sources,
        OFF,
        "mission status NOT_SELECTED",
        lambda s: s.mission_status is MissionStatus.NOT_SELECTED and not s.comms_lost,
        only="not_selected_is_as_off",
    )


UNDER_WAY: Final = (READY, DRIVING, FINISHED)
ROWS: Final[tuple[Row, ...]] = (
    Row((INIT,), OFF, "tractive system and EBS are up", lambda s: s.tractive_system_running and s.ebs_armed),  # 2026
    Row((OFF,), EMERGENCY, AI_FAULTS[0].why, AI_FAULTS[0].when, fault=AI_FAULTS[0], only="estop_request_in_as_off"),
    Row((OFF,), READY, "mission chosen and acknowledged, EBS armed", _acknowledged_and_may_get_ready),
    Row((OFF,), READY, "mission chosen, EBS armed", _may_get_ready, only="ready_without_acknowledgement"),
    Row((*UNDER_WAY, EMERGENCY), OFF, "ASMS off", _asms_off, reset=True, only="asms_off_resets"),
    _deselected(DRIVING, FINISHED),
    *_by_fault(CAR_FAULTS, *UNDER_WAY),
    Row(UNDER_WAY, EMERGENCY, "shutdown circuit open", lambda s: s.sdc_open),
    Row((DRIVING,), EMERGENCY, "ASMS off", _asms_off),
    Row((DRIVING,), EMERGENCY, "Go off", lambda s: not s.go, unless="go_off_ignored_in_driving"),
    *_by_fault(AI_FAULTS, DRIVING),
    *_by_fault((AI_COMMS_LOST,), READY, FINISHED),
    *_by_fault((_EBS_UNAVAILABLE,), DRIVING),
    Row(
        UNDER_WAY,
        EMERGENCY,
        "hydraulic brake requested",
        lambda s: s.brake_requested,
        only="brake_request_is_emergency",
    ),
    _deselected(READY),
    Row((READY, FINISHED), OFF, "ASMS off", _asms_off),
    Row((READY,), DRIVING, "Go", _may_start, unless="start_needs_selected"),
    Row(
        (READY,),
        DRIVING,
        "Go",
        lambda s: _may_start(s) and s.mission_status is MissionStatus.SELECTED,
        only="start_needs_selected",
    ),
    Row(
        (DRIVING,),
        FINISHED,
        "mission FINISHED at rest",
        lambda s: s.mission_status is MissionStatus.FINISHED and s.fastest_wheel_rpm < STANDING_RPM,
    ),
    Row(
        (EMERGENCY,), OFF, "emergency-brake timer over, then ASMS off", lambda s: s.emergency_timer_over and not s.asms
    ),
)

Table = dict[AsState, tuple[Row, ...]]


def _in_force(item: Row | Fault, profile: Profile) -> bool:
    return (item.only is None or bool(getattr(profile, item.only))) and (
        item.unless is None or not getattr(profile, item.unless)
    )


def transition_table(profile: Profile) -> Table:
    """The rows in force under a profile, by the state they leave. Every state has an entry."""
    return {state: tuple(row for row in ROWS if state in row.sources and _in_force(row, profile)) for state in AsState}


def ai_faults(profile: Profile) -> tuple[Fault, ...]:
    """The AI computer's faults in force under a profile."""
    return tuple(fault for fault in AI_FAULTS if _in_force(fault, profile))


def taken(table: Table, state: AsState, situation: Situation) -> Row | None:
    """The transition to take now, if any."""
    for row in table[state]:
        if row.when(situation):
            return row
    return None
