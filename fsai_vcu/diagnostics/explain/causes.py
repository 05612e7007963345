"""Why a car brakes or does not start: one table from the cause to its words and to what to do about it.

Causes that the AI side's supervisor knows as well have its words (core/supervision/reasons.py); the car's own have the
names of the interface. A cause is found by the rules of `endings.py` and `starting.py`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from fsai_vcu.core.supervision.reasons import Reason
from fsai_vcu.core.supervision.start_conditions import WORDS
from fsai_vcu.interface.enums import ShutdownCause
from fsai_vcu.interface.messages import FAULT_NAMES


@dataclass(frozen=True, slots=True)
class Cause:
    """One cause. `words` completes "because …"; `remedy` says what to do, as the user manual would.

    `record` says what to record next time where the bus alone cannot tell more.
    """

    slug: str
    words: str
    remedy: str
    record: str = ""


_TEAM_LOG = (
    "the log of vcu_bridge (journalctl -b -u 'fsai-bridge@*', or /diagnostics in a bag): it names who asked and why"
)
_CAR_RESTART = "wait 15 s, ASMS off, then TSMS and LVMS off and on again"

_MOVE_STEERING = "move the steering by hand and by command (static inspection A): column, motor, angle sensor"
_TURN_WHEELS = "turn each wheel by hand and compare 0x525: sensor, connector, wheel mapping"
_SEE_FAULT = "see in 0x520 which fault it is (fsai-vcu explain LOG names it), and put that right first"

# What to do about what the supervisor found
_REMEDIES: Final = {
    Reason.VCU_SILENT: "check the VCU's supply and the CAN wiring: its 0x520 stopped while others went on",
    Reason.WHEELS_STALE: (
        "check why 0x525 stopped: VCU, wiring, bus load (fsai-vcu stats LOG); else compare it with 0x526"
    ),
    Reason.STEERING_STALE: "check why 0x523 stopped: steering controller, VCU, wiring",
    Reason.STEERING_IMPLAUSIBLE: _MOVE_STEERING,
    Reason.WHEEL_IMPLAUSIBLE: _TURN_WHEELS,
    Reason.INTRUDER: (
        "only one program may send 0x510 to 0x514: stop the other one (a second stack, canplayer, a script, a logger"
        " that replays)"
    ),
    Reason.LOOP_FAULT: "look what kept the processor busy; real-time priority and CPU load of the AI computer",
    Reason.BUS_LOST: "check CAN plugs, termination and bit rate; ip -details link show can0",
    Reason.STOP_INEFFECTIVE: "check the service brake: pressure in 0x524 against the request, air, pads",
    Reason.COMMAND_STALE: "look why planner or controller fell silent: their logs, cones seen, CPU load",
    Reason.FAULT_STATUS: _SEE_FAULT,
    Reason.AS_SWITCH_OFF: "ask who switched ASMS off; else check the switch and its wiring",
    Reason.TS_SWITCH_OFF: "ask who switched TSMS off; else check the switch and its wiring",
    Reason.SHUTDOWN_REQUESTED: "ask who switched the car off; else check TSMS and LVMS",
    Reason.FAULT_BIT: _SEE_FAULT,
    Reason.SHUTDOWN_CAUSE: _SEE_FAULT,
    Reason.STATE_FAULT: "look at what it names: EBS (air pressure, 0x301), tractive system (battery, HVIL), the VCU",
    Reason.AMI_CHANGED: "leave the display alone once the car is in AS_READY; else look for a second sender of 0x520",
    Reason.SEQUENCE_SHORT: "keep Go off for 5 s in AS_READY; if AS_DRIVING came by itself, check the VCU",
    Reason.NOT_SEEN: "start the software before the car leaves AS_OFF, then start anew from AS_OFF",
    Reason.NO_MISSION: "choose a mission on the AMI before Go",
    Reason.AS_STATE_UNKNOWN: (
        "compare the VCU's interface revision with the database; look for a second sender of 0x520"
    ),
}

# What to do about a condition that is not met between power-up and driving; and what to record where that helps
_STARTING: Final[Mapping[str, tuple[str, ...]]] = {
    "no_ai_data": ("start the bridge on this bus (2021: AIMS on), and check its CAN plug",),
    "ai_data_incomplete": ("send all five of 0x510 to 0x514 every 10 ms: the VCU waits for valid data",),
    "link_lost": ("see the handshake and gaps above; fsai-vcu check LOG measures them",),
    "asms": ("turn ASMS on",),
    "tsms": ("turn TSMS on",),
    "ts_not_running": ("check TSMS, the shutdown circuit (E-stops, dongle, remote) and the battery",),
    "ebs_not_armed": (
        "check the shutdown circuit (E-stops, dongle, remote) and the EBS air pressure; ASMS must be on",
    ),
    "no_mission": ("choose the mission on the display",),
    "status_not_selected": (
        "fsai-vcu status says what it waits for; fsai-vcu mode autonomous",
        "fsai-vcu status beside the log",
    ),
    "status_running": ("send SELECTED in AS_OFF and AS_READY, and RUNNING only once AS_DRIVING is seen",),
    "status_finished": ("reset the mission state in AS_OFF and say SELECTED",),
    "estop_latched": ("clear it by /reset in AS_OFF, after its cause is gone",),
    "power_cycle": (
        "ASMS, TSMS and LVMS off, and on again: 2026 cars need it after every mission, all after an emergency brake",
    ),
    "fault": (_SEE_FAULT,),
    "op_fault": ("look at the other faults that 0x520 names; TSMS and LVMS off and on again",),
    "shutting_down": ("TSMS was turned off: let it shut down, then LVMS off and on",),
    "steering_inactive": ("check that ASMS is on and the tractive system runs; then the steering controller's fault",),
    "brakes_not_ready": ("check the brake controller; power-cycle",),
    "go_held": ("Go off and on again",),
    "torque_requested": ("send zero torque in 0x511 and 0x512 until AS_DRIVING",),
    "steering_requested": ("send STEER_REQUEST 0 until AS_DRIVING",),
    "steering_turned": ("straighten the wheels; check the angle sensor",),
    "direction_not_neutral": ("send NEUTRAL until AS_DRIVING, then FORWARD",),
    "ready_not_selected": ("send SELECTED until AS_DRIVING is seen",),
    "vcu_unheard": ("LVMS on; then check the CAN plug, the bit rate and the interface (ip -details link show)",),
    "braked": (f"put its cause right, then {_CAR_RESTART}",),
}

_CAUSES: Final[Mapping[str, tuple[str, ...]]] = {
    "ai_computer_request": (
        "the AI computer asked for it (ESTOP_REQUEST 1)",
        f"find out why the AI computer asked, then {_CAR_RESTART}; the software's latch is cleared by /reset in AS_OFF"
        " or by that power cycle",
        _TEAM_LOG,
    ),
    "hvil_open": (
        "the high-voltage interlock is open (HVIL_OPEN_FAULT)",
        "tractive system off, then look for a high-voltage connector or cover that is not closed",
    ),
    "hvil_short": (
        "the high-voltage interlock is shorted (HVIL_SHORT_FAULT)",
        "tractive system off, then check the interlock loop for a short circuit to its supply or to ground",
    ),
    "ebs_fault": (
        "the emergency brake system failed (EBS_FAULT)",
        "check EBS air pressure and valves (accumulators, 0x301 on 2026 cars), then power-cycle for a new EBS test",
        "0x301 and 0x302 on 2026 cars: EBS pressures and the bits of its self-test",
    ),
    "offboard_charger": (
        "an off-board charger fault (OFFBOARD_CHARGER_FAULT)",
        "unplug the charger, close its socket, power-cycle",
    ),
    "ai_comms_lost": (
        "the AI computer's messages or its handshake echo were missing (AI_COMMS_LOST)",
        "check that the AI computer runs and its CAN plug sits, then the load of its processor (fsai-vcu check LOG)",
    ),
    "neutral_while_moving": (
        "DIRECTION_REQUEST was NEUTRAL while a wheel turned above 10 rpm (AUTONOMOUS_BRAKING_FAULT)",
        "keep FORWARD until all wheels have been under 10 rpm for 0.5 s; brake with 0x514, not with NEUTRAL",
    ),
    "finished_while_moving": (
        "MISSION_STATUS was FINISHED while a wheel turned above 10 rpm (MISSION_STATUS_FAULT)",
        "say FINISHED only when all wheels have been under 10 rpm for 0.5 s",
    ),
    "charge_procedure": (
        "the charge procedure was broken (CHARGE_PROCEDURE_FAULT)",
        "end charging in the order of the manual, unplug, power-cycle",
    ),
    "bms": (
        "the battery management reports a fault (BMS_FAULT)",
        "read the BMS (cell voltages and temperatures, current) before driving again; charge or cool the battery",
        "the BMS's own log",
    ),
    "torque_with_brake": (
        "axle torque and brake were requested together (BRAKE_PLAUSIBILITY_FAULT)",
        "send a whole cycle with both at zero between torque and brake; a safety gate must let the brake win",
    ),
    "asms_off": (
        "ASMS was turned off while the car was driving",
        f"nothing is broken: leave ASMS on until the car has finished; {_CAR_RESTART}",
    ),
    "tsms_off": (
        "TSMS was turned off: the tractive system shuts down and the EBS goes",
        f"nothing is broken: leave TSMS on until ASMS is off; {_CAR_RESTART}",
    ),
    "go_off": (
        WORDS["go_off"],
        "leave Go on for the whole run; if nobody touched it, check the remote's battery, range and receiver",
        "0x181 (RES_TPDO): the remote's switches and RADIO_STRENGTH",
    ),
    "remote_estop": (
        "the E-stop of the remote was pressed",
        f"release it when the reason is gone; {_CAR_RESTART}",
    ),
    "radio_lost": (
        "the remote's radio was lost",
        "check the remote's battery, antenna and distance; test the range before the next run",
        "0x181 (RES_TPDO): RADIO_STRENGTH",
    ),
    "sdc_open": (
        "the shutdown circuit (SDC) was opened by something that the bus does not name: an E-stop button on the car,"
        " the remote's E-stop or its radio, the crash sensor, or the autonomous dongle",
        f"look which button is pressed, at the remote, the crash sensor and the dongle; put it right; {_CAR_RESTART}",
        "0x181 (RES_TPDO, 2026): it tells the remote's E-stop and radio from the car's own; otherwise a video",
    ),
    "brake_request_simulator": (
        "a hydraulic brake was requested, which this VCU (like the official simulator) takes for an emergency",
        "against the official simulator hold and stop by torque with a low MOTOR_SPEED_MAX (service_brake: motor), and"
        " keep 0x514 at zero",
    ),
    "before_the_log": (
        "it began before the log did",
        "look at what was before, or record from power-up on",
        "everything from power-up: start recording before LVMS",
    ),
    "unknown": (
        "the log does not show why",
        f"{_CAR_RESTART}; record the next run whole",
        "both directions (0x510-0x514 and 0x520-0x526), error frames, and from power-up on",
    ),
    # Behind an ESTOP_REQUEST or a lost link
    "planned_end": (
        "the mission ends with the emergency brake",
        f"nothing: static inspection B and the autonomous demo end like this; for the next mission {_CAR_RESTART}",
    ),
    "not_on_the_bus": (
        "the AI computer asked for it, and no frame says why: the operator's emergency brake, both pedals in one"
        " command, the mission itself, or this software being stopped",
        "look in the software's own log for the emergency's cause",
        _TEAM_LOG,
    ),
    **{reason.slug: (reason.words, remedy) for reason, remedy in _REMEDIES.items()},
    Reason.VCU_REBOOT.slug: (
        "the VCU restarted",
        "check its supply: low-voltage battery, LVMS, connectors",
    ),
    "vcu_hung": (
        "the VCU itself stood still: it sent nothing and received nothing",
        "check the VCU's supply and connectors; if it happens again have its software looked at",
        "the VCU's own log",
    ),
    "status_frozen": (
        WORDS["status_frozen"],
        "have the VCU's software looked at; look for a gateway or a replay that repeats old frames; where it"
        " has been so from the first frame on, see whether the VCU hears the AI computer (its CAN plug)",
        "the VCU's own log",
    ),
    "frames_wrong": (
        "0x520 showed a state that the car cannot have been in",
        "look for a second sender of 0x520 (a simulator, a replay); else have the VCU's software looked at",
    ),
    "ai_silent": (
        "the AI computer fell silent: none of its five messages came any more",
        "the program ended or hung, its adapter went bus-off, or its CAN plug or power went: look at its log"
        " (journalctl -b -u 'fsai-bridge@*'), at ip -details -statistics link show can0, and at the plug",
        _TEAM_LOG,
    ),
    "ai_message_missing": (
        "one of the AI computer's five messages was missing",
        "send all five of 0x510 to 0x514 every 10 ms: ten missing in a row stop the car",
    ),
    "ai_message_length": (
        "a message of the AI computer had the wrong length, which the VCU takes for missing",
        "send 0x510 with 8 bytes, 0x511 and 0x512 with 4, 0x513 and 0x514 with 2",
    ),
    "handshake_lost": (
        "the AI computer did not echo the handshake within 100 ms",
        "send back in 0x510 the HANDSHAKE bit of the last 0x520, in every cycle",
    ),
    "ai_unheard": (
        "the AI computer's messages are in this log, but the VCU did not receive them all",
        "the fault lies between this log's plug and the VCU: wiring, termination, the VCU's own plug; where the VCU is"
        " simulated, its computer may have been too busy",
        "a log taken at the VCU's end of the bus",
    ),
    "not_selected_simulator": (
        "MISSION_STATUS became NOT_SELECTED, which this VCU (like the official simulator) takes as AS_OFF at once",
        "keep RUNNING while driving, then FINISHED at rest",
    ),
    "not_driven": (
        "the car stands in AS_DRIVING; nothing was asked of it",
        "see what the planner says: no cones, no path among them, or another mission than this track's"
        " (fsai-vcu status: why not driving)",
        _TEAM_LOG,
    ),
    "stop_asked": (
        "nothing on the bus explains it: manual mode was asked for, or this software's own supervision stopped the car",
        "look in the software's own log for the stop's cause",
        _TEAM_LOG,
    ),
    "power_off": (
        "the car was switched off (LVMS) while it was driving, or the log lost it",
        "switch off in the order ASMS, TSMS, LVMS, after the car has stopped",
    ),
    # Between power-up and driving
    **{slug: (WORDS[slug], *rest) for slug, rest in _STARTING.items()},
    "no_go": ("Go was not given", "give Go on the remote after 5 s in AS_READY (ASSI yellow and blue)"),
    "go_too_early": (
        "Go came before 5 s in AS_READY had passed",
        "Go off, wait until the ASSI shows yellow and blue, Go on again",
    ),
    "given_up": ("ASMS was turned off in AS_READY: the start was given up", "turn ASMS on to start anew"),
    "start_unknown": (
        "every condition that the bus shows was met, and yet the car did not go on",
        "look at the display and the ASSI; EBS test and shutdown circuit are not all on the bus",
        "0x120 (2021), 0x181, 0x301 and 0x302 (2026), from power-up on",
    ),
    "status_length": (
        "0x520 has the wrong length: it counts as missing",
        "compare the VCU's interface revision with the database",
    ),
    "no_as_state": ("the database has no AS_STATE in 0x520", "use the car's own (no --dbc), or --revision"),
    # In a drive that goes on
    "torque_not_given": (
        "the motors do not give the torque that is asked for",
        "check inverter and motor faults and the tractive system's voltage; compare TRQ_MAX in 0x521 and 0x522",
    ),
    "torque_unasked": (
        "the motors give torque that nobody asks for",
        "do not drive: press an E-stop, then have inverter and torque request looked at with the car on stands",
    ),
    "no_motion": (
        "torque is given and no wheel turns",
        "check that the brakes are released and drive shafts and coupling are whole; then the wheel-speed sensors",
    ),
    "brake_not_following": (
        "the brake pressure does not come as asked",
        "do not drive: check air, brake fluid and the pressure sensor by static inspection A",
    ),
    "brake_unasked": (
        "there is brake pressure that nobody asks for",
        "check that the EBS is not triggered, and the pressure sensors and valves",
    ),
    "steering_not_following": (
        "the steering does not go where it is asked to",
        _MOVE_STEERING,
    ),
    "wheel_unlike": (
        "one wheel's speed is unlike the others'",
        _TURN_WHEELS,
    ),
}

CAUSES: Final[Mapping[str, Cause]] = {slug: Cause(slug, *row) for slug, row in _CAUSES.items()}

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
