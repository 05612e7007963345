"""Declarations of the supervision: its times and limits, with the safety rules' defaults, and why a guard acts.

A new reaction has its times in `BridgeConfig`, its words in `Reason`, and what to do about it in `TO_DO`; when which
time is up, and what follows, is a row of `REACTIONS` in supervisor.py. Times are integer nanoseconds.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from enum import Enum
from types import MappingProxyType
from typing import Final, Literal

from msgspec.structs import replace

from fsai_vcu.interface.specification import COMMS_LOST_NS, WHEEL_SPEED_MAX_RPM
from fsai_vcu.interface.units import MS, S
from fsai_vcu.interface.values import Value


class BridgeConfig(Value, frozen=True):
    """Behaviour of the AI side of one car. A timer has run out *at* its value: T - 1 ns is still in time."""

    # Permissions
    autonomous_at_power_up: bool = False  # enter autonomous by itself: no link to the car is allowed in staging
    listen_only: bool = False  # never send: sending energises the tractive system and arms the EBS
    service_brake: Literal["hydraulic", "motor"] = "hydraulic"  # motor: never a hydraulic request (see below)

    # Life of a run
    listen_first_ns: int = 200 * MS  # on start a process listens, then sends
    launch_wait_ns: int = 3 * S  # the car must not move after entering AS_DRIVING
    ready_wait_ns: int = 4900 * MS  # of the 5 s in AS_READY, less the 100 ms that 0x520 may be missing
    short_sequence_allowed: bool = False  # AS_DRIVING may come sooner, and without an edge of Go
    standstill_rpm: int = 10  # interface specification v4.0: a wheel under 10 rpm stands
    standstill_ns: int = 500 * MS
    power_cycle_ns: int = 1 * S  # no 0x520 for so long: the car was switched off
    stop_cycles: int = 5  # cycles sent on an orderly stop before the silence

    # Vehicle command
    command_stale_ns: int = 100 * MS
    command_lost_ns: int = 300 * MS
    sensor_stale_ns: int = 500 * MS  # age of the oldest data behind a command
    sensor_future_ns: int = 20 * MS  # a stamp further ahead would hide old data
    both_pedals_ns: int = 100 * MS

    # The service-brake stop
    stop_timeout_ns: int = 3 * S
    stop_window_ns: int = 500 * MS  # over which a deceleration must show
    stop_min_drop_rpm: int = 9  # 0.5 m/s2 over the window, on a rolling radius of 0.2535 m
    stop_brake_pct: float = 80.0  # from the car's top speed to rest in under 3 s
    holding_brake_pct: float = 30.0

    # Messages of the car
    vcu_stale_ns: int = 50 * MS
    vcu_lost_ns: int = COMMS_LOST_NS
    as_state_known_ns: int = 100 * MS  # so long known again before torque returns: a state that flickers gives none
    feedback_stale_ns: int = 100 * MS  # wheel speeds, steering feedback, torque limits
    feedback_lost_ns: int = 300 * MS
    implausible_ns: int = 300 * MS
    implausible_lost_ns: int = 600 * MS

    # Wheel speeds that are not believed
    wheel_max_rpm: int = WHEEL_SPEED_MAX_RPM
    wheel_change_max_rpm: int = 300  # no tyre speeds a wheel up, or slows it down, by more from one frame to the next
    wheel_jump_ns: int = 350 * MS  # a jump is not believed for so long: what stays is reacted to as a missing speed
    wheel_doubt_turns: float = 0.5  # of a wheel: by so much speed and pulse count may contradict each other

    # Our own loop and bus
    backlog_ns: int = 20 * MS  # frames that waited so long are reported
    send_lost_ns: int = 50 * MS  # without one complete cycle counts as bus loss

    # Plausibility of steering and wheels
    steer_rate_spread: float = 0.25  # the actuator's true rate lies within this share of the car's parameter
    steer_margin_deg: float = 2.0  # beyond delay and backlash: rounding, tyres, the model's own error
    wheel_margin_rpm: float = 60.0
    wheel_margin_fraction: float = 0.30
    slip_memory_ns: int = 1 * S  # torque or brake so long ago still explains a slipping wheel

    # The gate
    steer_rate_degps: float | None = None  # None: the car's own steering rate

    def __post_init__(self) -> None:
        if self.service_brake not in ("hydraulic", "motor"):
            raise ValueError(f"service_brake is {self.service_brake!r}: hydraulic or motor")
        for name in self.__struct_fields__:
            value = getattr(self, name)
            if isinstance(value, (int, float)) and (not math.isfinite(value) or value < 0):
                raise ValueError(f"{name} is {value}: a finite number of 0 or more")
        for name in ("stop_brake_pct", "holding_brake_pct"):
            if getattr(self, name) > 100.0:
                raise ValueError(f"{name} is {getattr(self, name)}: 100 at most")

    @property
    def motor_brakes(self) -> bool:
        return self.service_brake == "motor"

    @property
    def held_brake_pct(self) -> float:
        """The holding brake, which a car that takes every brake request for an emergency does without."""
        return 0.0 if self.motor_brakes else self.holding_brake_pct


def official_simulator(config: BridgeConfig | None = None) -> BridgeConfig:
    """The configuration for the official simulator, which takes any hydraulic request for an emergency brake.

    The motors alone hold and stop the car there, so a stop may last longer and decelerates less. Its VCU does not keep
    to the 5 s in AS_READY.
    """
    return replace(
        config or BridgeConfig(),
        service_brake="motor",
        short_sequence_allowed=True,
        stop_brake_pct=100.0,
        stop_timeout_ns=20 * S,
        stop_window_ns=2 * S,
        stop_min_drop_rpm=5,
    )


# ---------------------------------------------------------------- reasons


class Reason(Enum):
    """Reason for which a guard acted: the short name that is counted and logged, and the sentence for a person.

    It means that something is wrong: in nominal driving there is none. What the gate does as a matter of course
    (holding brake, the 3 s wait, steering at the actuator's rate, less torque at speed, a cycle of zeros between brake
    and torque) is no reason.
    """

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
    WHEELS_STALE = "wheels_stale", "wheel speeds (0x525) are missing or implausible"
    STEERING_STALE = "steering_stale", "steering feedback (0x523) is missing"
    STEERING_IMPLAUSIBLE = "steering_implausible", "the steering does not follow STEER_REQUEST"
    WHEEL_IMPLAUSIBLE = "wheel_implausible", "one wheel speed does not fit the other three"
    GO_OFF = "go_off", "GO_SIGNAL is 0 in AS_DRIVING: the car is stopping itself"
    FAULT_STATUS = "fault_status", "FAULT_STATUS is 1 in AS_DRIVING: the car is stopping itself"
    AS_STATE_UNKNOWN = (
        "as_state_unknown",
        "AS_STATE in 0x520 is unknown, or has been known again for less than 100 ms",
    )
    AS_SWITCH_OFF = "as_switch_off", "AS_SWITCH_STATUS fell to 0 in AS_DRIVING: ASMS was switched off"
    TS_SWITCH_OFF = "ts_switch_off", "TS_SWITCH_STATUS fell to 0 in AS_DRIVING: TSMS was switched off"
    SHUTDOWN_REQUESTED = "shutdown_requested", "SHUTDOWN_REQUEST rose in AS_DRIVING: the car is about to switch off"
    FAULT_BIT = "fault_bit", "a fault bit of 0x520 rose in AS_DRIVING"
    SHUTDOWN_CAUSE = "shutdown_cause", "SHUTDOWN_CAUSE rose from 0 in AS_DRIVING"
    STATE_FAULT = "state_fault", "EBS_STATE, TS_STATE or OP_STATE became FAULT in AS_DRIVING"
    AMI_CHANGED = "ami_changed", "AMI_STATE changed in AS_DRIVING: another mission than this run's, or none"
    INTRUDER = "intruder", "a second sender uses the AI computer's ids 0x510 to 0x514"
    LOOP_FAULT = "loop_fault", "the loop failed or missed its deadline by 50 ms"
    BUS_LOST = "bus_lost", "the bus was lost"
    BACKLOG = "backlog", "frames of the car waited 20 ms or more before they were read"
    OTHER_REVISION = "other_revision", "frames of another interface revision are received"
    NOT_SEEN = "not_seen", "AS_DRIVING, but this process did not see AS_OFF, AS_READY and AS_DRIVING follow one another"
    SEQUENCE_SHORT = "sequence_short", "AS_DRIVING came without 5 s in AS_READY and then Go"
    NO_MISSION = "no_mission", "AS_DRIVING, but no mission was acknowledged in this run"
    NOT_CONFIRMED = "not_confirmed", "AS_DRIVING, but planner or controller never confirmed their reset for this run"
    STACK_RESTARTED = "stack_restarted", "planner or controller was restarted in AS_DRIVING: this run is over"
    VCU_REBOOT = "vcu_reboot", "AS_STATE fell back out of AS_DRIVING: the VCU restarted or ASMS went off"

    # Guards of the gate
    COMMAND_REFUSED = (
        "command_refused",
        "a vehicle command was refused: not finite, out of range, or its stamp is ahead of the clock",
    )
    COMMAND_OTHER_RUN = "command_other_run", "a vehicle command belongs to another run"
    STEER_CLAMPED = "steer_clamped", "the steering asked for is beyond ANGLE_MAX or the operational limit"
    TORQUE_LIMIT_UNKNOWN = "torque_limit_unknown", "the car's live torque limit (0x521, 0x522) is missing: no torque"
    TORQUE_BLOCKED = "torque_blocked", "the gate held back torque that the supervisor had let through"
    STILLNESS_UNPROVEN = "stillness_unproven", "the gate held back NEUTRAL or FINISHED while a wheel may turn"


_SEE_FAULT: Final = "remove the fault that 0x520 names, then switch the car off and on"
TO_DO: Final[Mapping[Reason, str]] = MappingProxyType(
    {
        Reason.COMMAND_STALE: "find out why planner or controller stopped sending: their logs, cones seen, CPU load",
        Reason.STOP_INEFFECTIVE: "check the service brake: pressure in 0x524 against the request, air, pads",
        Reason.VCU_SILENT: "check the VCU's supply and the CAN wiring: 0x520 stopped while other messages continued",
        Reason.WHEELS_STALE: "check why 0x525 stopped: VCU, wiring, bus load; else compare it with 0x526",
        Reason.STEERING_STALE: "check why 0x523 stopped: steering controller, VCU, wiring",
        Reason.STEERING_IMPLAUSIBLE: (
            "test the steering by hand, then with static inspection A (a mission on the AMI): column, motor, angle "
            "sensor"
        ),
        Reason.WHEEL_IMPLAUSIBLE: "turn each wheel by hand and compare 0x525: sensor, connector, wheel mapping",
        Reason.GO_OFF: (
            "leave Go on for the whole run; if nobody touched it, check the remote's battery, range and receiver"
        ),
        Reason.FAULT_STATUS: _SEE_FAULT,
        Reason.AS_STATE_UNKNOWN: (
            "compare the VCU's interface revision with the database; look for a second sender of 0x520"
        ),
        Reason.AS_SWITCH_OFF: "find out who switched ASMS off; if nobody did, check the switch and its wiring",
        Reason.TS_SWITCH_OFF: "find out who switched TSMS off; if nobody did, check the switch and its wiring",
        Reason.SHUTDOWN_REQUESTED: "find out who switched the car off; if nobody did, check TSMS and LVMS",
        Reason.FAULT_BIT: _SEE_FAULT,
        Reason.SHUTDOWN_CAUSE: _SEE_FAULT,
        Reason.STATE_FAULT: (
            "check the system whose state is FAULT: EBS (air pressure, 0x301), tractive system (battery, HVIL), the VCU"
        ),
        Reason.AMI_CHANGED: (
            "leave the display alone once the car is in AS_READY; else look for a second sender of 0x520"
        ),
        Reason.INTRUDER: (
            "only one program may send 0x510 to 0x514: stop the other one (a second stack, canplayer, a script, a "
            "logger that replays)"
        ),
        Reason.LOOP_FAULT: (
            "find out what kept the processor busy; check real-time priority and CPU load of the AI computer"
        ),
        Reason.BUS_LOST: "check CAN plugs, termination and bit rate; ip -details link show can0",
        Reason.NOT_SEEN: "start the software before the car leaves AS_OFF, then start again from AS_OFF",
        Reason.SEQUENCE_SHORT: "keep Go off for 5 s in AS_READY; if AS_DRIVING came by itself, check the VCU",
        Reason.NO_MISSION: "choose the mission on the display",
        Reason.VCU_REBOOT: "check the VCU's supply: low-voltage battery, LVMS, connectors",
    }
)
"""Remedies for reasons that a log of the bus can show."""

TO_DO_UNSEEN: Final[Mapping[Reason, str]] = MappingProxyType(
    {
        Reason.BOTH_PEDALS: "have the controller send throttle or brake, the other one 0",
        Reason.BACKLOG: "find out what kept the processor busy (`fsai-vcu doctor`: scheduling)",
        Reason.OTHER_REVISION: "set `[can] revision` to the car's; else look for a second car, a replay or a gateway",
        Reason.NOT_CONFIRMED: "start planner and controller before AS_READY; each confirms every new `run_id`",
        Reason.STACK_RESTARTED: "find out from the node's log why it ended; the next run begins in AS_OFF",
        Reason.COMMAND_REFUSED: "`fsai-vcu check-stack` names the field, or the clock that is ahead",
        Reason.COMMAND_OTHER_RUN: "put the `run_id` of the newest `/run_state` into each command",
        Reason.STEER_CLAMPED: "plan with `steering_max_rad` of `/vehicle_state`, and the official's limit",
        Reason.TORQUE_LIMIT_UNKNOWN: "check why 0x521 or 0x522 stopped (`fsai-vcu check --figures`)",
        Reason.TORQUE_BLOCKED: "gate and supervisor disagree: keep the log of bus and bridge, and report it",
        Reason.STILLNESS_UNPROVEN: "gate and supervisor disagree: keep the log of bus and bridge, and report it",
    }
)
"""Remedies for those that no log of the bus shows, but `fsai-vcu status` and the log of vcu_bridge do."""

_BY_SLUG = {reason.slug: reason for reason in Reason}


def words_of(slug: str) -> str:
    """The sentence for a reason's short name."""
    return _BY_SLUG[slug].words
