"""Causes of brakes and of starts that fail: from each to its words, and to what to record where the bus tells no more.

Causes that the AI side knows as well have its words: what the supervisor found (core/supervision/config.py), and what
a start waits for (start_conditions.py). A cause is found by the rules of `endings.py` and `starting.py`; what to do
about it is in `remedies.py`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from fsai_vcu.core.supervision.config import Reason
from fsai_vcu.core.supervision.start_conditions import WORDS
from fsai_vcu.diagnostics.remedies import OURS, REMEDIES, Setting, remedy_of
from fsai_vcu.interface.enums import ShutdownCause
from fsai_vcu.interface.messages import FAULT_NAMES


@dataclass(frozen=True, slots=True)
class Cause:
    """One cause. `words` completes "because …".

    `record` says what to record next time where the bus alone cannot tell more. `setting` chooses the remedy.
    """

    slug: str
    words: str
    record: str = ""
    setting: Setting = OURS

    @property
    def remedy(self) -> str:
        """Remedy, as the user manual would say it."""
        return remedy_of(self.slug, self.setting)


_TEAM_LOG: Final = (
    "the log of vcu_bridge (journalctl -b -u 'fsai-bridge@*', or /diagnostics in a bag): it names who asked and why"
)

_RECORD: Final[Mapping[str, str]] = {
    "ai_computer_request": _TEAM_LOG,
    "ebs_fault": "0x301 and 0x302 on 2026 cars: EBS pressures and the bits of its self-test",
    "bms": "the BMS's own log",
    "go_off": "0x181 (RES_TPDO): the remote's switches and RADIO_STRENGTH",
    "radio_lost": "0x181 (RES_TPDO): RADIO_STRENGTH",
    "sdc_open": "0x181 (RES_TPDO, 2026): it tells the remote's E-stop and radio from the car's own; otherwise a video",
    "before_the_log": "everything from power-up: start recording before LVMS",
    "unknown": "both directions (0x510-0x514 and 0x520-0x526), error frames, and from power-up on",
    "not_on_the_bus": _TEAM_LOG,
    "vcu_hung": "the VCU's own log",
    "status_frozen": "the VCU's own log",
    "ai_silent": _TEAM_LOG,
    "ai_unheard": "a log taken at the VCU's end of the bus",
    "not_driven": _TEAM_LOG,
    "stop_asked": _TEAM_LOG,
    "status_not_selected": "fsai-vcu status beside the log",
    "start_unknown": "0x120 (2021), 0x181, 0x301 and 0x302 (2026), from power-up on",
    "start_unclear": "both directions (0x510-0x514 and 0x520-0x526), from power-up on",
    "handshake_stands": "a log taken at the VCU's end of the bus",
    "torque_limit_zero": "the VCU's and the inverters' own logs",
    "stands": "both directions (0x510-0x514 and 0x520-0x526), from power-up on",
}
"""Frames to record next time."""

_OWN: Final[Mapping[str, str]] = {
    "stood_still": "a processor of this computer stood still: it was too busy for real time",
    "frames_lost_here": "this computer lost frames while it recorded: the log does not have every frame",
    "ai_computer_request": "the AI computer asked for it (ESTOP_REQUEST 1)",
    "hvil_open": "the high-voltage interlock is open (HVIL_OPEN_FAULT)",
    "hvil_short": "the high-voltage interlock is shorted (HVIL_SHORT_FAULT)",
    "ebs_fault": "the emergency brake system failed (EBS_FAULT)",
    "offboard_charger": "an off-board charger fault (OFFBOARD_CHARGER_FAULT)",
    "ai_comms_lost": "the AI computer's messages or its handshake echo were missing (AI_COMMS_LOST)",
    "neutral_while_moving": (
        "DIRECTION_REQUEST was NEUTRAL while a wheel turned above 10 rpm (AUTONOMOUS_BRAKING_FAULT)"
    ),
    "finished_while_moving": "MISSION_STATUS was FINISHED while a wheel turned above 10 rpm (MISSION_STATUS_FAULT)",
    "charge_procedure": "the charge procedure was broken (CHARGE_PROCEDURE_FAULT)",
    "bms": "the battery management reports a fault (BMS_FAULT)",
    "torque_with_brake": "axle torque and brake were requested together (BRAKE_PLAUSIBILITY_FAULT)",
    "asms_off": "ASMS was turned off while the car was driving",
    "tsms_off": "TSMS was turned off: the tractive system shuts down, and the EBS is no longer available",
    "remote_estop": "the E-stop of the remote was pressed",
    "radio_lost": "the remote's radio was lost",
    "ts_fault": "the tractive system failed (TS_STATE TS_FAULT)",
    "pushbar_in_driving": "the car was put into pushbar mode (OP_STATE OP_PUSHBAR) while it was driving",
    "sdc_open": (
        "the shutdown circuit (SDC) was opened by something that the bus does not name: an E-stop button on the "
        "car, the remote's E-stop or its radio, the crash sensor, or the autonomous dongle"
    ),
    "brake_request_simulator": (
        "a hydraulic brake was requested, which this VCU (like the official simulator) takes for an emergency"
    ),
    "before_the_log": "the emergency brake began before the log",
    "unknown": "the log does not show why",
    "planned_end": "the mission ends with the emergency brake",
    "not_on_the_bus": (
        "the AI computer asked for it, and no frame says why: the operator's emergency brake, both pedals in one "
        "command, the mission itself, or this software being stopped"
    ),
    "vcu_reboot": "the VCU restarted",
    "vcu_hung": "the VCU itself stood still: it sent nothing and received nothing",
    "frames_wrong": "0x520 showed a state that the car cannot have been in",
    "ai_silent": "the AI computer fell silent: none of its five messages came any more",
    "ai_bus_off": "the AI computer's CAN adapter went bus-off (an error frame says so), and other senders went on",
    "ai_message_missing": "one of the AI computer's five messages was missing",
    "ai_message_length": "a message of the AI computer had the wrong length, which the VCU takes for missing",
    "handshake_lost": "the AI computer did not echo the handshake within 100 ms",
    "echo_wrong": "the AI computer did not send back the HANDSHAKE bit of the last 0x520, but the other one",
    "handshake_stands": (
        "HANDSHAKE of 0x520 stood still though its echo came: the VCU has hung, or does not receive the echo"
    ),
    "ai_unheard": "the AI computer's messages are in this log, but the VCU did not receive them all",
    "not_selected_simulator": (
        "MISSION_STATUS became NOT_SELECTED, which this VCU (like the official simulator) takes as AS_OFF at once"
    ),
    "torque_limit_zero": "the car allows no torque: AXLE_TRQ_MAX of 0x521 and 0x522 is 0",
    "neutral_in_driving": "the AI computer says NEUTRAL (DIRECTION_REQUEST) while it asks for torque",
    "never-running": "the AI computer never says RUNNING: MISSION_STATUS stays as it was in AS_READY",
    "speed_limit_zero": "the AI computer asks for torque and limits the motors' speed to 0 (MOTOR_SPEED_MAX)",
    "torque-brake": "the AI computer asks for torque and brake together",
    "axle": "the torque is requested from an axle that cannot give any",
    "brake_held": "the AI computer holds the brake and asks for no torque",
    "no_torque_asked": "the AI computer steers and asks for no torque",
    "finished_not_taken": "the AI computer says FINISHED at rest, and the car does not take it",
    "stands": "the frames do not show why",
    "not_driven": "the car stands in AS_DRIVING, and no torque or steering was requested",
    "stop_asked": (
        "nothing on the bus explains it: manual mode was asked for, or this software's own supervision stopped the car"
    ),
    "power_off": "the car was switched off (LVMS) while it was driving, or the log lost it",
    "no_go": "Go was not given",
    "go_too_early": "Go came before 5 s in AS_READY had passed",
    "given_up": "ASMS was turned off in AS_READY: the start was given up",
    "mission_changed": "the mission was changed on the AMI in AS_READY",
    "deselected": "MISSION_STATUS left SELECTED in AS_READY",
    "go_not_taken": "Go was pressed on the remote (0x181), and 0x520 does not show it (GO_SIGNAL 0)",
    "start_unknown": "every condition that the bus shows was met, but the car did not go on",
    "start_unclear": "the conditions that were seen on the bus were met, but not all conditions were seen",
    "status_length": "0x520 has the wrong length: it counts as missing",
    "no_as_state": "the database has no AS_STATE in 0x520",
    "torque_not_given": "the motors do not give the torque that is asked for",
    "derated_hot": "the car limits its torque, and warns that its battery is hot (WARN_BATT_TEMP_HIGH)",
    "derated_empty": "the car limits its torque, and warns that its battery is empty (WARN_BATT_SOC_LOW)",
    "derated": "the car limits its torque to less than is asked for (AXLE_TRQ_MAX), and gives no warning",
    "torque_unasked": "the motors give torque that nobody asks for",
    "no_motion": "torque is given and no wheel turns",
    "brake_not_following": "the brake pressure does not come as asked",
    "brake_unasked": "there is brake pressure that nobody asks for",
    "steering_not_following": "the steering does not go where it is asked to",
    "wheel_unlike": "one wheel's speed is unlike the others'",
    "wheels_swapped": "left and right wheel speeds are exchanged: in a turn the inner wheel reads faster",
}

_WORDS: Final[Mapping[str, str]] = {**{reason.slug: reason.words for reason in Reason}, **WORDS, **_OWN}
CAUSES: Final[Mapping[str, Cause]] = {
    slug: Cause(slug, _WORDS[slug], _RECORD.get(slug, "")) for slug in REMEDIES if slug in _WORDS
}

SHUTDOWN: Final[Mapping[ShutdownCause, str]] = {
    ShutdownCause.AI_COMPUTER_REQUEST: "ai_computer_request",
    ShutdownCause.HVIL_OPEN_FAULT: "hvil_open",
    ShutdownCause.HVIL_SHORT_FAULT: "hvil_short",
    ShutdownCause.EBS_FAULT: "ebs_fault",
    ShutdownCause.OFFBOARD_CHARGER_FAULT: "offboard_charger",
    ShutdownCause.AI_COMMS_FAULT: "ai_comms_lost",
    ShutdownCause.AUTONOMOUS_BRAKING_FAULT: "neutral_while_moving",
    ShutdownCause.MISSION_STATUS_FAULT: "finished_while_moving",
    ShutdownCause.CHARGE_PROCEDURE_FAULT: "charge_procedure",
    ShutdownCause.BMS_FAULT: "bms",
    ShutdownCause.BRAKE_PLAUSIBILITY_FAULT: "torque_with_brake",
}
"""SHUTDOWN_CAUSE of 0x520 -> cause. Every value but NO_SHUTDOWN has a row."""

FAULT_BITS: Final[Mapping[str, str]] = {
    "AI_ESTOP_REQUEST": SHUTDOWN[ShutdownCause.AI_COMPUTER_REQUEST],
    "AI_COMMS_LOST": SHUTDOWN[ShutdownCause.AI_COMMS_FAULT],
    **{cause.name: slug for cause, slug in SHUTDOWN.items() if cause.name in FAULT_NAMES.values()},
}
"""Fault bit of 0x520 -> cause. Every bit has a row."""
