"""Remedies for whatever the diagnostics find: one table, by the slug of a cause or the kind of a finding.

Where the AI computer's frames are not this software's, a remedy speaks of your AI computer: this software cannot
name its commands, services and logs. Where the bus is virtual it speaks of programs, for there is no plug.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final, NamedTuple

from fsai_vcu.core.supervision.config import TO_DO, Reason

_CAR_RESTART: Final = "wait 15 s, ASMS off, then TSMS and LVMS off and on again"
_SENDER: Final = "check the sender: its supply, its CAN plug, its program"
_BUSY: Final = "nothing is wrong with car or software: drive again with less running on this computer"
_BETWEEN: Final = "between torque and brake, in either order, send a whole cycle with both at zero"

REMEDIES: Final[Mapping[str, str]] = {
    # Causes of an emergency brake, of a stop, and of a car that does not start (explain/causes.py has their words)
    "ai_computer_request": (
        f"find out why the AI computer asked, then {_CAR_RESTART}; the software's latch is cleared by /reset "
        "in AS_OFF or by "
        "that power cycle"
    ),
    "hvil_open": "tractive system off, then look for a high-voltage connector or cover that is not closed",
    "hvil_short": "tractive system off, then check the interlock loop for a short circuit to its supply or to ground",
    "ebs_fault": (
        "check EBS air pressure and valves (accumulators, 0x301 on 2026 cars), then power-cycle for a new EBS test"
    ),
    "offboard_charger": "unplug the charger, close its socket, power-cycle",
    "ai_comms_lost": ("check that the AI computer runs and its CAN plug sits, then the load of its processor"),
    "neutral_while_moving": (
        "keep FORWARD until all wheels have been under 10 rpm for 0.5 s; brake with 0x514, not with NEUTRAL"
    ),
    "finished_while_moving": "say FINISHED only when all wheels have been under 10 rpm for 0.5 s",
    "charge_procedure": "end charging in the order of the manual, unplug, power-cycle",
    "bms": ("read the BMS (cell voltages and temperatures, current) before driving again; charge or cool the battery"),
    "torque_with_brake": (
        "between torque and brake send a whole cycle with both at zero; a safety gate must let the brake win"
    ),
    "asms_off": f"nothing is broken: leave ASMS on until the car has finished; {_CAR_RESTART}",
    "tsms_off": f"nothing is broken: leave TSMS on until ASMS is off; {_CAR_RESTART}",
    "remote_estop": f"release the E-stop when the reason for it is gone; {_CAR_RESTART}",
    "radio_lost": "check the remote's battery, antenna and distance; test the range before the next run",
    "ts_fault": "look at the battery, the HVIL and the inverters, then switch the car off and on",
    "pushbar_in_driving": f"unplug the pushbar before a run; {_CAR_RESTART}",
    "sdc_open": (
        f"look which button is pressed, at the remote, the crash sensor and the dongle; put it right; {_CAR_RESTART}"
    ),
    "brake_request_simulator": (
        "against the official simulator hold and stop by torque with a low MOTOR_SPEED_MAX (service_brake: "
        "motor), and keep 0x514 at zero"
    ),
    "before_the_log": "look at what happened before the log, or record from power-up on",
    "unknown": f"{_CAR_RESTART}; record the next run whole",
    "planned_end": (
        "nothing is wrong: static inspection B and the autonomous demo end like this; for the next mission "
        f"{_CAR_RESTART}"
    ),
    "not_on_the_bus": "look in the software's own log for the emergency's cause",
    **{reason.slug: to_do for reason, to_do in TO_DO.items()},
    "vcu_hung": "check the VCU's supply and connectors; if it happens again have its software looked at",
    "status_frozen": (
        "have the VCU's software looked at; look for a gateway or a replay that repeats old frames; if 0x520 "
        "repeats itself from the first frame on, check whether the VCU receives the AI computer (its CAN plug)"
    ),
    "frames_wrong": "look for a second sender of 0x520 (a simulator, a replay); else have the VCU's software looked at",
    "ai_silent": (
        "the AI computer's program ended or hung, its adapter went bus-off, or it lost its CAN plug or power: look at "
        "its log (journalctl -b -u 'fsai-bridge@*'), at ip -details -statistics link show can0, and at the plug"
    ),
    "ai_message_missing": "send all five of 0x510 to 0x514 every 10 ms: ten missing in a row stop the car",
    "ai_message_length": "send 0x510 with 8 bytes, 0x511 and 0x512 with 4, 0x513 and 0x514 with 2",
    "handshake_lost": "send back in 0x510 the HANDSHAKE bit of the last 0x520, in every cycle",
    "echo_wrong": "send back in 0x510 the HANDSHAKE bit of the newest 0x520 as it is, in every cycle",
    "handshake_stands": "check the VCU's CAN plug and its wiring; if it happens again have its software looked at",
    "ai_bus_off": (
        "find out why the AI computer's frames fail: its CAN plug, termination, bit rate, another node with the same"
        " ids; have its interface restart by itself (ip link set can0 type can restart-ms 100)"
    ),
    "ai_unheard": (
        "the fault lies between this log's plug and the VCU: wiring, termination, the VCU's own plug; where the"
        " VCU is simulated, its computer may have been too busy"
    ),
    "not_selected_simulator": "keep RUNNING while driving, then FINISHED at rest",
    "not_driven": (
        "see what the planner says: lost, and why; no cones; no path through them; or a mission of another track"
    ),
    "stop_asked": "look in the software's own log for the stop's cause",
    "power_off": "switch off in the order ASMS, TSMS, LVMS, after the car has stopped",
    "no_ai_data": "start the bridge on this bus (2021: AIMS on), and check its CAN plug",
    "ai_data_incomplete": "send all five of 0x510 to 0x514 every 10 ms: the VCU waits for valid data",
    "link_lost": "look at the AI computer's echo of HANDSHAKE, and at the periods of 0x510 to 0x514",
    "asms": "turn ASMS on",
    "tsms": "turn TSMS on",
    "pushbar": "unplug the pushbar and switch the car off and on",
    "charging": "end charging, unplug, and switch the car off and on",
    "ts_not_running": "check TSMS, the shutdown circuit (E-stops, dongle, remote) and the battery",
    "ebs_not_armed": "check the shutdown circuit (E-stops, dongle, remote) and the EBS air pressure; ASMS must be on",
    "status_not_selected": "fsai-vcu mode autonomous; then see which of planner and controller does not confirm",
    "status_running": "send SELECTED in AS_OFF and AS_READY, and RUNNING only once AS_DRIVING is seen",
    "status_finished": "in AS_OFF reset the mission state and send SELECTED",
    "estop_latched": "remove the cause of the request, then clear it by /reset in AS_OFF",
    "power_cycle": (
        "ASMS, TSMS and LVMS off, and on again: 2026 cars need it after every mission, all after an emergency brake"
    ),
    "fault": TO_DO[Reason.FAULT_STATUS],
    "op_fault": "look at the other faults that 0x520 names; TSMS and LVMS off and on again",
    "shutting_down": "TSMS was turned off: let the car shut down, then LVMS off and on",
    "steering_inactive": "check that ASMS is on and the tractive system runs; then the steering controller's fault",
    "brakes_not_ready": "check the brake controller; power-cycle",
    "go_held": "Go off and on again",
    "torque_requested": "send zero torque in 0x511 and 0x512 until AS_DRIVING",
    "steering_requested": "send STEER_REQUEST 0 until AS_DRIVING",
    "steering_turned": "straighten the wheels; check the angle sensor",
    "direction_not_neutral": "send NEUTRAL until AS_DRIVING, then FORWARD",
    "ready_not_selected": "send SELECTED until AS_DRIVING is seen",
    "vcu_unheard": "LVMS on; then check the CAN plug, the bit rate and the interface (ip -details link show)",
    "braked": f"remove the cause of the emergency brake, then {_CAR_RESTART}",
    "no_go": "give Go on the remote after 5 s in AS_READY (ASSI yellow and blue)",
    "go_too_early": "Go off, wait until the ASSI shows yellow and blue, Go on again",
    "given_up": "turn ASMS on to start again",
    "go_not_taken": "check the remote's receiver and its wiring to the VCU; then the VCU's own reading of it",
    "mission_changed": "leave the display alone once the car is in AS_READY; wait for AS_READY of the new mission",
    "deselected": "keep SELECTED in 0x510 until AS_DRIVING is seen",
    "start_unclear": "look at the display and the ASSI; record both directions of the bus",
    "start_unknown": "look at the display and the ASSI; EBS test and shutdown circuit are not all on the bus",
    "status_length": "compare the VCU's interface revision with the database",
    "no_as_state": "use the car's own database (no --dbc), or --revision",
    "torque_not_given": (
        "check inverter and motor faults and the tractive system's voltage; compare TRQ_MAX in 0x521 and 0x522"
    ),
    "torque_limit_zero": (
        "look at the inverters and the tractive system (TS_STATE, HVIL, motor temperature): they allow no torque"
    ),
    "neutral_in_driving": "say FORWARD in 0x510 once AS_DRIVING is seen, before the first torque",
    "never-running": "say RUNNING as soon as AS_STATE is AS_DRIVING, and not before",
    "speed_limit_zero": "send MOTOR_SPEED_MAX with the torque: the highest motor speed with torque, 4000 rpm at most",
    "torque-brake": _BETWEEN,
    "axle": "request the torque from the driven axle (2026: rear, 0x512), and 0 from the other axle",
    "brake_held": ("see what the planner waits for while the brake is held: no cones, no path, or another mission"),
    "no_torque_asked": "see why planner and controller ask for no torque: no path, speed 0, or the mission's end",
    "finished_not_taken": "turn ASMS off to end the run; if it does not end, find out why the VCU does not read 0x510",
    "stands": "look at the car: brakes, drive shafts, what the display says; record both directions from power-up on",
    "derated_hot": "let the battery cool; until then ask for no more than AXLE_TRQ_MAX",
    "derated_empty": "charge the battery; until then ask for no more than AXLE_TRQ_MAX",
    "derated": "ask for no more than AXLE_TRQ_MAX; find out why the car allows so little: inverter, motor, battery",
    "torque_unasked": (
        "do not drive: press an E-stop, then have inverter and torque request looked at with the car on stands"
    ),
    "no_motion": (
        "check that the brakes are released and drive shafts and coupling are whole; then the wheel-speed sensors"
    ),
    "brake_not_following": "do not drive: check air, brake fluid and the pressure sensor by static inspection A",
    "brake_unasked": "check that the EBS is not triggered, and the pressure sensors and valves",
    "steering_not_following": TO_DO[Reason.STEERING_IMPLAUSIBLE],
    "wheel_unlike": TO_DO[Reason.WHEEL_IMPLAUSIBLE],
    "wheels_swapped": "turn each wheel by hand and compare 0x525: plugs of left and right; or the sign of 0x523",
    "stood_still": _BUSY,
    "frames_lost_here": "record again with less running on this computer; the log cannot tell more",
    # Kinds of findings on a log (verdict/)
    "silent": "check that the car is on and the bit rate is right; check the CAN plug",
    "missing": _SENDER,
    "gap": _SENDER,
    "stopped": _SENDER,
    "echo": "send back in 0x510 the HANDSHAKE bit of the last 0x520 as it is, in every cycle",
    "handshake": "look at the load of the AI computer and of the bus, and at the log of vcu_bridge",
    "pulses_stand": "check the pulse sensor of that wheel, and its plug",
    "wrong-length": "check that --revision is the car's; find the sender",
    "remote_frames": "find the sender: only the AI computer may use 0x510 to 0x514, and it sends no remote frames",
    "reserved": "end the program on this computer that sends it",
    "period": "check that --revision is the car's, and that the message has one sender, which is not held up",
    "second_car": "stop the simulated car or the replay (fsai-vcu vcu, canplayer), or take one of two cars off the bus",
    "lossy": "find out which: the recording computer is too slow, the bus is too full, or the bus has errors",
    "recorder": "check whether the recording computer was too busy",
    "steering-sign": "see which of the two has its sign swapped: positive turns left (ISO 8855), in 0x513 and in 0x523",
    "one-call": _BETWEEN,
}

_THEIRS: Final[Mapping[str, str]] = {
    "ai_computer_request": (
        f"find out from your AI computer's log why it asked, then {_CAR_RESTART}; have it set ESTOP_REQUEST to 0"
    ),
    "loop_fault": "find out what kept the processor of your AI computer busy",
    "command_stale": "find out from your AI computer's log why it stopped sending commands",
    "not_seen": "start your AI computer before the car leaves AS_OFF, then start again from AS_OFF",
    "not_on_the_bus": "find out from your AI computer's log why it asked",
    "ai_silent": (
        "your AI computer's program ended or hung, its adapter went bus-off, or it lost its CAN plug or power: look at"
        " its log, at the state of its CAN interface, and at the plug"
    ),
    "stop_asked": "find out from your AI computer's log why it stopped the car",
    "not_driven": "find out from your AI computer's log what it waits for, and whether its mission is the car's",
    "brake_held": "find out from your AI computer's log why it holds the car with the brake",
    "no_torque_asked": "find out from your AI computer's log why it steers and does not drive",
    "no_ai_data": "start your AI computer on this bus (2021: AIMS on), and check its CAN plug",
    "status_not_selected": "have your AI computer send SELECTED once it has the mission of AMI_STATE and is ready",
    "estop_latched": "remove the cause, then have your AI computer set ESTOP_REQUEST to 0 in AS_OFF",
    "brake_request_simulator": (
        "against the official simulator your AI computer holds and stops by torque with a low MOTOR_SPEED_MAX, and"
        " keeps 0x514 at zero"
    ),
    "handshake": "look at the load of your AI computer and of the bus, and at its log",
}
"""Remedies in the same form where the AI computer's frames are not this software's."""


_PROGRAM: Final = (
    "the bus is virtual: see whether the sender's program ended or hung (its log), and what else ran on that computer"
)
_VIRTUAL: Final[Mapping[str, str]] = {
    **dict.fromkeys(("ai_silent", "ai_comms_lost", "ai_unheard", "ai_bus_off", "no_ai_data", "missing"), _PROGRAM),
    **dict.fromkeys(("vcu_silent", "vcu_reboot", "vcu_hung", "vcu_unheard", "handshake_stands", "gap"), _PROGRAM),
    **dict.fromkeys(("wheels_stale", "steering_stale", "silent", "stopped", "bus_lost", "lossy"), _PROGRAM),
}
"""Remedies on a virtual bus (vcan, loopback), which has no plug, no termination and no supply."""


class Setting(NamedTuple):
    """The circumstances of a log that choose among remedies.

    theirs: the AI computer's frames are not this software's. virtual: the bus is inside a computer.
    """

    theirs: bool = False
    virtual: bool = False


OURS: Final = Setting()  # this software's frames, on the car's bus


def remedy_of(slug: str, setting: Setting = OURS) -> str:
    """Return what to do about a cause or a kind of finding; empty where nothing is to be done."""
    return (setting.virtual and _VIRTUAL.get(slug)) or (setting.theirs and _THEIRS.get(slug)) or REMEDIES.get(slug, "")
