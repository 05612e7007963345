"""Logs as other cars and other AI computers would have written them, and what has to be said of each.

Good runs are changed frame by frame (edits.py): no fault was driven, and no rule of the explanation had a part in it. A
new one is a row.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from fsai_hil.evidence.edits import (
    AFTER_S,
    BARE,
    BEGIN,
    Act,
    added,
    again,
    asks,
    batched,
    before_a_good_one,
    driving,
    echo,
    edited,
    error,
    gone,
    good_run,
    held,
    never_moves,
    off,
    only,
    ordered,
    paced,
    parks,
    put,
    puts,
    ready,
    scaled,
    sent,
    short,
    stays,
    stops,
    swapped,
    turned_away,
    whole,
)
from fsai_hil.rules.checker import checker_for, on_wire
from fsai_vcu.diagnostics.explain import signals as sig
from fsai_vcu.diagnostics.explain.incident import Incident
from fsai_vcu.diagnostics.log.frames import Frames
from fsai_vcu.diagnostics.verdict.judging import judged
from fsai_vcu.diagnostics.verdict.verdict import Verdict
from fsai_vcu.interface.codec import Codec
from fsai_vcu.interface.enums import AsState, Direction, EbsState, MissionStatus, OpState, ShutdownCause, TsState
from fsai_vcu.interface.reserved import AI_IDS
from fsai_vcu.interface.revisions import revision
from fsai_vcu.interface.values import Value

OK: Final = ""
A: Final = "acceleration"
DIRECTIONS: Final = (float(Direction.NEUTRAL), float(Direction.FORWARD))
COMMS: Final = float(ShutdownCause.AI_COMMS_FAULT)
ASKED: Final = float(ShutdownCause.AI_COMPUTER_REQUEST)
EBS: Final = float(ShutdownCause.EBS_FAULT)
BRAKED: Final = driving(6.0)
BEFORE: Final = driving(5.97)
LOST: Final = driving(5.88)
FAST: Final = driving(4.5)


class Edit(Value, frozen=True):
    """One edited log. named: what has to be named as a first cause or a problem (any of them); OK: nothing is wrong.

    cites: a part of a sentence that has to be among the evidence, or in the finding. also: what may be named besides.
    breaks: rules that hold for this project's process alone: another AI computer may break them, and the car bears it.
    """

    name: str
    acts: tuple[Act, ...]
    named: tuple[str, ...] = (OK,)
    cites: str = ""
    also: tuple[str, ...] = ()
    breaks: tuple[str, ...] = ()
    run: str = A

    def frames(self) -> Frames:
        return edited(good_run(self.run), *self.acts).frames


def _one(name: str, *acts: Act, named: str | Sequence[str] = OK, **others: object) -> Edit:
    slugs = (named,) if isinstance(named, str) else tuple(named)
    return Edit(name, acts, slugs, **others)  # type: ignore[arg-type]


def ai_falls_silent(*acts: Act) -> tuple[Act, ...]:
    return (*acts, gone(AI_IDS, LOST))


def _voltage(seconds: float) -> bytes:
    volts = 24.3 if seconds < 5.2 or seconds > 5.7 else 9.6
    return round(volts * 1000).to_bytes(2, "little") * 2 + bytes(4)


def _pressure(seconds: float) -> bytes:
    bar = max(2.4, 8.0 - 2.0 * max(0.0, seconds - 3.0))
    return round(bar * 100).to_bytes(2, "little") * 4


def _low_pressure(seconds: float) -> bytes:
    return (210).to_bytes(2, "little") * 4


EDITS: Final = (
    # ---- nothing is wrong: other AI computers, other cars, other ways to record
    _one("as it was"),
    _one("the bends of an autocross", run="bends"),
    _one("a car of 2021", run="acceleration 2021"),
    _one("an AI computer that sends in another order", ordered((0x514, 0x513, 0x512, 0x511, 0x510)), breaks=("1", "2")),
    _one("an AI computer that spreads its messages", ordered(AI_IDS, apart_us=1700)),
    _one(
        "an AI computer that answers one cycle late",
        put(sig.HANDSHAKE, lambda values, seconds: seconds // 0.02 % 2),
        echo("late"),
        cites="one 0x520 late",
        breaks=("9",),
    ),
    _one("a car without fault bits", BARE),
    _one("a log without the remote's and other devices' messages", gone((0x181, 0x500, 0x502))),
    _one("an adapter's batches", batched(10), breaks=("interval",)),
    _one("a log from AS_DRIVING on", only(driving(1.0), whole(-0.1))),
    _one("a log up to the drive", only(BEGIN, driving(5.0))),
    _one(
        "a battery that is low and gives all the same", put(sig.WARNINGS[1], 1.0, FAST), cites="WARN_BATT_SOC_LOW is 1"
    ),
    _one("two runs with the car off between them", again(8.0), cites="switched off and on"),
    _one("two runs, and the AI computer goes on", again(5.0, ai_goes_on=True), cites="switched off and on"),
    _one("two runs with a long night between them", again(600.0), cites="switched off and on"),
    _one("two runs of a car without fault bits", BARE, again(20.0), cites="switched off and on"),
    _one("an AI computer with a jitter of 3 ms", paced(10.0, 3.0), breaks=("interval",)),
    _one("an AI computer of its own period and phase", paced(9.6)),
    # ---- other things that are no cause of a stop
    _one("an AI computer that sends every 20 ms", paced(20.0), named="period", also=("handshake",)),
    _one(
        "an emergency brake, the car off, and a good run", BARE, stops(BRAKED), before_a_good_one(8.0), named="sdc_open"
    ),
    _one(
        "a restart in 2 s, in AS_OFF",
        gone((*range(0x520, 0x527), 0x181, 0x500, 0x502), off(0.2), off(0.5)),
        named=("gap",),
    ),
    _one("a bus that is dead for 300 ms in the drive", gone(range(0x7FF), driving(5.0), driving(5.3)), named="gap"),
    _one("0x523 is missing for 300 ms", gone(0x523, driving(5.0), driving(5.3)), named="gap"),
    _one(
        "a second program sends 0x514",
        sent(0x514, 50, lambda seconds: bytes(2), driving(2.0), driving(6.0)),
        named=("intruder", "period"),
    ),
    # ---- the car stands in AS_DRIVING
    _one(
        "the car allows no torque, and is asked for none",
        never_moves(),
        puts(dict.fromkeys((sig.CAR_TORQUE_MAX[1], sig.TORQUE_R), 0.0), driving(0.0)),
        named="torque_limit_zero",
        cites="REAR_AXLE_TRQ_MAX is 0 Nm",
    ),
    _one(
        "the car allows no torque, and is asked for some",
        never_moves(12.0),
        put(sig.CAR_TORQUE_MAX[1], 0.0, driving(0.0)),
        asks(120.0),
        named="torque_limit_zero",
    ),
    _one(
        "the AI computer limits the motors' speed to 0",
        never_moves(),
        asks(60.0),
        put(sig.SPEED_MAX_R, 0.0),
        named="speed_limit_zero",
        cites="REAR_MOTOR_SPEED_MAX is 0 rpm",
    ),
    _one(
        "the AI computer limits the motors' speed to a creep",
        never_moves(15.0),
        asks(60.0),
        put(sig.SPEED_MAX_R, 20.0),
        named="speed_limit_zero",
    ),
    _one("nobody asks for anything", never_moves(), put(sig.STEER, 0.0), named="not_driven"),
    _one("the AI computer steers only", never_moves(11.0), named="no_torque_asked"),
    _one(
        "the AI computer holds the brake",
        never_moves(),
        puts(dict.fromkeys((sig.BRAKE_REQ_F, sig.BRAKE_REQ_R, sig.BRAKE_F, sig.BRAKE_R), 40.0), driving(0.0)),
        named="brake_held",
        cites="40 % of brake are asked for",
    ),
    _one(
        "a brake that nobody asks for holds the car",
        never_moves(),
        asks(80.0),
        puts(dict.fromkeys((sig.BRAKE_F, sig.BRAKE_R), 60.0), driving(0.0)),
        named="brake_unasked",
        also=("torque_not_given",),
    ),
    _one(
        "the AI computer stays in NEUTRAL",
        never_moves(),
        asks(70.0),
        put(sig.DIRECTION, DIRECTIONS[0]),
        named="neutral_in_driving",
        cites="DIRECTION_REQUEST is NEUTRAL",
    ),
    _one(
        "the AI computer never says RUNNING",
        never_moves(),
        asks(70.0),
        put(sig.MISSION_STATUS, float(MissionStatus.SELECTED)),
        named="never-running",
    ),
    _one(
        "the AI computer never says RUNNING, and the car drives",
        put(sig.MISSION_STATUS, float(MissionStatus.SELECTED)),
        only(BEGIN, driving(7.0)),
        named="never-running",
    ),
    _one(
        "torque and brake are asked for together",
        never_moves(),
        asks(70.0),
        puts(dict.fromkeys((sig.BRAKE_REQ_F, sig.BRAKE_REQ_R, sig.BRAKE_F, sig.BRAKE_R), 30.0), driving(3.3)),
        named="torque-brake",
    ),
    _one(
        "torque is asked of the axle that has none",
        never_moves(),
        put(sig.TORQUE_F, 90.0, driving(3.2)),
        put(sig.SPEED_MAX_F, 3000.0),
        named="axle",
    ),
    _one(
        "torque is given and no wheel turns",
        never_moves(),
        asks(80.0),
        put(sig.CAR_TORQUE[1], 78.0, driving(3.2)),
        named="no_motion",
    ),
    _one("torque is asked for and none is given", never_moves(), asks(80.0), named="torque_not_given"),
    _one("a torque that is too small to move", never_moves(), asks(8.0), named=("torque_not_given", "no_motion")),
    _one(
        "TSMS goes off in AS_DRIVING, and the state stays",
        never_moves(),
        asks(80.0),
        put(sig.TS_SWITCH, 0.0, driving(0.5)),
        named="tsms",
    ),
    _one(
        "it drove, and then nobody asks",
        parks(driving(8.0), 9.0),
        named=("not_driven", "no_torque_asked"),
        cites="after it drove",
        also=("stop_asked", "frozen"),
    ),
    # ---- the car does not do what it is asked
    _one(
        "the torque is halved between two axles",
        scaled(sig.TORQUE_R, 0.5),
        put(sig.TORQUE_F, lambda values, seconds: values * 0.0 + 40.0, driving(3.5), driving(8.0)),
        named="axle",
        also=("torque_unasked",),
    ),
    _one(
        "a steering that does not move",
        put(sig.ANGLE, 0.0),
        named="steering_not_following",
        run="bends",
        also=("steering_implausible", "stop_asked"),
    ),
    _one(
        "a steering that turns the other way",
        scaled(sig.ANGLE, -1.0),
        named=("steering-sign", "steering_not_following"),
        run="bends",
        also=("steering_implausible", "stop_asked"),
    ),
    _one(
        "brakes that do not come",
        puts(dict.fromkeys((sig.BRAKE_F, sig.BRAKE_R), 0.0), driving(3.5)),
        named="brake_not_following",
        also=("stop_ineffective",),
    ),
    _one(
        "half of the brake",
        scaled(sig.BRAKE_F, 0.5),
        scaled(sig.BRAKE_R, 0.5),
        named="brake_not_following",
        also=("stop_ineffective",),
    ),
    _one("half of the torque", scaled(sig.CAR_TORQUE[1], 0.5), only(BEGIN, driving(8.0)), named="torque_not_given"),
    _one("two fifths of the torque", scaled(sig.CAR_TORQUE[1], 0.4), named="torque_not_given"),
    _one("three fifths of the torque", scaled(sig.CAR_TORQUE[1], 0.6), named="torque_not_given"),
    _one(
        "a car of 2021 with half of it",
        scaled(sig.CAR_TORQUE[1], 0.5),
        named="torque_not_given",
        run="acceleration 2021",
    ),
    _one(
        "a hot battery",
        puts({sig.WARNING_STATUS: 1.0, sig.WARNINGS[0]: 1.0, sig.CAR_TORQUE_MAX[1]: 20.0}, driving(1.0)),
        put(sig.CAR_TORQUE[1], lambda values, seconds: values.clip(max=20.0), driving(1.0)),
        named="derated_hot",
        cites="WARN_BATT_TEMP_HIGH",
    ),
    _one(
        "an empty battery",
        puts({sig.WARNING_STATUS: 1.0, sig.WARNINGS[1]: 1.0, sig.CAR_TORQUE_MAX[1]: 60.0}, driving(1.0)),
        put(sig.CAR_TORQUE[1], lambda values, seconds: values.clip(max=60.0), driving(1.0)),
        named="derated_empty",
    ),
    _one(
        "a limit without a warning",
        put(sig.CAR_TORQUE_MAX[1], 30.0, driving(1.0)),
        put(sig.CAR_TORQUE[1], lambda values, seconds: values.clip(max=30.0), driving(1.0)),
        named="derated",
        cites="REAR_AXLE_TRQ_MAX is 30.0 Nm",
    ),
    _one(
        "left and right wheels exchanged",
        swapped(*sig.WHEELS[:2]),
        swapped(*sig.WHEELS[2:]),
        swapped(*sig.PULSES[:2]),
        swapped(*sig.PULSES[2:]),
        named="wheels_swapped",
        run="bends",
    ),
    _one("the front wheels exchanged", swapped(*sig.WHEELS[:2]), named="wheels_swapped", run="bends"),
    _one("the rear wheels exchanged", swapped(*sig.WHEELS[2:]), named="wheels_swapped", run="bends"),
    _one(
        "a motor that goes on",
        put(sig.CAR_TORQUE[1], lambda values, seconds: values.clip(min=70.0), driving(8.0), driving(9.0)),
        puts({sig.TORQUE_R: 0.0}, driving(8.0), driving(9.0)),
        named="torque_unasked",
    ),
    _one(
        "a motor that brakes by itself",
        put(sig.CAR_TORQUE[1], -80.0, driving(8.2), driving(8.9)),
        puts({sig.TORQUE_R: 0.0}, driving(8.0), driving(9.0)),
        named="torque_unasked",
        cites="-80.0 Nm measured",
    ),
    _one(
        "a motor that turns in AS_READY", put(sig.CAR_TORQUE[1], 35.0, ready(2.0), ready(3.0)), named="torque_unasked"
    ),
    _one(
        "one wheel that reads 250 rpm too much",
        added(sig.WHEELS[3], 250.0, driving(3.0)),
        named="wheel_unlike",
        also=("wheel_implausible", "wheels_stale", "stop_asked"),
    ),
    _one("a pulse counter that is stuck", held(sig.PULSES[2], FAST), named="frozen", also=("restart",)),
    # ---- it brakes, and names no reason
    _one("TSMS off", BARE, put(sig.TS_SWITCH, 0.0, BEFORE), stops(BRAKED), named="tsms_off"),
    _one("TSMS off in the same frame", BARE, put(sig.TS_SWITCH, 0.0, BRAKED), stops(BRAKED), named="tsms_off"),
    _one("TSMS off 10 ms before", BARE, put(sig.TS_SWITCH, 0.0, driving(5.99)), stops(BRAKED), named="tsms_off"),
    _one("TSMS off, shown 20 ms later", BARE, stops(BRAKED), put(sig.TS_SWITCH, 0.0, driving(6.02)), named="tsms_off"),
    _one("ASMS off, shown 50 ms later", BARE, stops(BRAKED), put(sig.AS_SWITCH, 0.0, driving(6.05)), named="asms_off"),
    _one(
        "the remote's E-stop, shown 40 ms later",
        BARE,
        stops(BRAKED),
        put(sig.REMOTE_ESTOP, 1.0, driving(6.04)),
        named="remote_estop",
    ),
    _one(
        "switches that go off when the car has braked",
        BARE,
        stops(BRAKED),
        puts({sig.TS_SWITCH: 0.0, sig.AS_SWITCH: 0.0}, driving(6.3)),
        named="sdc_open",
    ),
    _one(
        "0x520 is missing before an E-stop",
        BARE,
        gone(0x520, driving(5.9), driving(6.0)),
        stops(BRAKED),
        named="sdc_open",
        also=("gap",),
    ),
    _one("ASMS off", BARE, put(sig.AS_SWITCH, 0.0, BEFORE), stops(BRAKED), named="asms_off"),
    _one("Go off", BARE, puts({sig.GO: 0.0, sig.REMOTE_GO: 0.0}, BEFORE), stops(BRAKED), named="go_off"),
    _one("an E-stop button on the car", BARE, stops(BRAKED), named="sdc_open"),
    _one("the remote's E-stop", BARE, put(sig.REMOTE_ESTOP, 1.0, driving(5.98)), stops(BRAKED), named="remote_estop"),
    _one("EBS_STATE shows the fault", BARE, stops(BRAKED, EBS_STATE=float(EbsState.EBS_FAULT)), named="ebs_fault"),
    _one(
        "the pushbar is put in",
        BARE,
        put(sig.OP_STATE, float(OpState.OP_PUSHBAR), BEFORE),
        stops(BRAKED),
        named="pushbar_in_driving",
    ),
    _one("TS_STATE shows the fault", BARE, stops(BRAKED, TS_STATE=float(TsState.TS_FAULT)), named="ts_fault"),
    _one("the AI computer falls silent", BARE, *ai_falls_silent(stops(BRAKED)), named="ai_silent"),
    _one(
        "the AI computer says NEUTRAL",
        BARE,
        put(sig.DIRECTION, 0.0, BEFORE),
        stops(BRAKED),
        named="neutral_while_moving",
    ),
    _one(
        "the AI computer says FINISHED at speed",
        BARE,
        put(sig.MISSION_STATUS, 3.0, BEFORE),
        stops(BRAKED),
        put(sig.MISSION_STATUS, 3.0, BEFORE),
        named="finished_while_moving",
    ),
    _one(
        "the AI computer asks, and no bit says so",
        BARE,
        put(sig.ESTOP, 1.0, driving(5.98)),
        stops(BRAKED),
        named=("not_on_the_bus", "ai_computer_request"),
    ),
    _one(
        "the remote's radio is lost",
        BARE,
        put(sig.RADIO_STRENGTH, 0.0, driving(5.5)),
        stops(BRAKED),
        named="radio_lost",
    ),
    _one(
        "torque and brake together",
        BARE,
        puts({sig.TORQUE_R: 30.0, sig.BRAKE_REQ_F: 20.0}, driving(5.95), driving(6.02)),
        stops(BRAKED),
        named="torque_with_brake",
    ),
    _one(
        "a car of 2021, TSMS off",
        BARE,
        put(sig.TS_SWITCH, 0.0, BEFORE),
        stops(BRAKED),
        named="tsms_off",
        run="acceleration 2021",
    ),
    _one(
        "a fault bit that comes 50 ms later, without a cause",
        BARE,
        stops(BRAKED),
        put(sig.FAULTS[3], 1.0, driving(6.05)),
        named="ebs_fault",
    ),
    _one("a fault bit of the interlock", BARE, stops(BRAKED, HVIL_OPEN_FAULT=1.0), named="hvil_open"),
    _one("the battery management", BARE, stops(BRAKED, SHUTDOWN_CAUSE=10.0), named="bms"),
    # ---- it brakes, and names a link that was lost, or a request
    _one(
        "an inverted echo",
        echo("inverted", LOST),
        stops(BRAKED, SHUTDOWN_CAUSE=COMMS, AI_COMMS_LOST=1.0),
        named=("echo_wrong", "handshake_lost"),
        also=("echo",),
    ),
    _one(
        "an echo one cycle late from then on",
        echo("late", LOST),
        stops(BRAKED, SHUTDOWN_CAUSE=COMMS, AI_COMMS_LOST=1.0),
        named=("echo_wrong", "handshake_lost"),
    ),
    _one(
        "a constant echo",
        echo("constant", LOST),
        stops(BRAKED, SHUTDOWN_CAUSE=COMMS, AI_COMMS_LOST=1.0),
        named=("handshake_lost", "echo_wrong"),
    ),
    _one(
        "a VCU whose HANDSHAKE stands",
        held(sig.HANDSHAKE, driving(5.89)),
        echo("as asked", driving(5.89)),
        stops(BRAKED, SHUTDOWN_CAUSE=COMMS, AI_COMMS_LOST=1.0),
        named=("handshake_stands", "status_frozen"),
        cites="HANDSHAKE of 0x520 stands at",
    ),
    _one(
        "a VCU that does not hear",
        stops(BRAKED, SHUTDOWN_CAUSE=COMMS, AI_COMMS_LOST=1.0),
        named="ai_unheard",
        cites="all in this log, in time",
    ),
    _one(
        "0x513 has 3 bytes",
        short(0x513, 1, LOST),
        stops(BRAKED, SHUTDOWN_CAUSE=COMMS, AI_COMMS_LOST=1.0),
        named="ai_message_length",
        cites="1 bytes, and must have 2",
    ),
    _one(
        "0x512 is missing",
        gone(0x512, LOST),
        stops(BRAKED, SHUTDOWN_CAUSE=COMMS, AI_COMMS_LOST=1.0),
        named="ai_message_missing",
    ),
    _one(
        "the AI computer's adapter goes bus-off",
        stops(BRAKED, SHUTDOWN_CAUSE=COMMS, AI_COMMS_LOST=1.0),
        gone(AI_IDS, LOST),
        error(0x40, "00" * 8, LOST),
        named="ai_bus_off",
        cites="an error frame: bus-off",
    ),
    _one(
        "the AI computer asks and ends",
        put(sig.ESTOP, 1.0, BEFORE),
        stops(BRAKED, SHUTDOWN_CAUSE=ASKED, AI_ESTOP_REQUEST=1.0),
        put(sig.COMMS_LOST, 1.0, driving(6.14)),
        gone(AI_IDS, driving(6.02)),
        named=("not_on_the_bus", "ai_computer_request"),
        cites="it falls silent",
    ),
    _one(
        "the EBS loses its pressure",
        sent(0x301, 10, _pressure, driving(0.0), driving(6.0 + AFTER_S)),
        stops(BRAKED, SHUTDOWN_CAUSE=EBS, EBS_FAULT=1.0),
        named="ebs_fault",
        cites="EBS_FRONT_ACC_PRESS falls from 8.0 to 2.4 bar",
    ),
    _one(
        "the battery sags and the VCU restarts",
        sent(0x300, 10, _voltage, driving(0.0), driving(8.0)),
        gone((*range(0x520, 0x527), 0x500, 0x502), driving(5.5), driving(6.0)),
        puts({sig.AS_STATE: 0.0, sig.GO: 0.0, sig.TS_STATE: 0.0, sig.EBS_STATE: 0.0}, driving(6.0)),
        only(BEGIN, driving(8.0)),
        named="vcu_reboot",
        cites="VBAT_ADC falls from 24.3 to 9.6 V",
        also=("not_as_asked", "torque_unasked"),
    ),
    # ---- it does not start
    _one("ASMS is off", stays(AsState.AS_OFF, 9.0), put(sig.AS_SWITCH, 0.0), named="asms"),
    _one("ASMS goes off in AS_OFF", stays(AsState.AS_OFF, 9.0), put(sig.AS_SWITCH, 0.0, off(1.0)), named="asms"),
    _one("ASMS goes off late in AS_OFF", stays(AsState.AS_OFF, 13.0), put(sig.AS_SWITCH, 0.0, off(6.5)), named="asms"),
    _one("TSMS goes off in AS_OFF", stays(AsState.AS_OFF, 9.0), put(sig.TS_SWITCH, 0.0, off(0.5)), named="tsms"),
    _one(
        "the car is on the pushbar",
        stays(AsState.AS_OFF, 9.0),
        put(sig.OP_STATE, float(OpState.OP_PUSHBAR)),
        named="pushbar",
        cites="OP_STATE is OP_PUSHBAR",
    ),
    _one(
        "the car is on the pushbar, and ASMS off",
        stays(AsState.AS_OFF, 9.0),
        put(sig.OP_STATE, float(OpState.OP_PUSHBAR), off(0.1)),
        put(sig.AS_SWITCH, 0.0, off(0.1)),
        named=("asms", "pushbar"),
        cites="pushbar",
    ),
    _one(
        "the car is charged", stays(AsState.AS_OFF, 9.0), put(sig.OP_STATE, float(OpState.OP_CHARGE)), named="charging"
    ),
    _one("no mission is chosen", stays(AsState.AS_OFF, 9.0), put(sig.AMI, 0.0), named="no_mission"),
    _one("0x510 is too short", stays(AsState.AS_OFF, 9.0), short(0x510, 6), named="ai_message_length", cites="6 bytes"),
    _one("0x514 is too short", stays(AsState.AS_OFF, 9.0), short(0x514, 1), named="ai_message_length", cites="1 bytes"),
    _one(
        "the EBS has no pressure",
        stays(AsState.AS_OFF, 9.0),
        put(sig.EBS_STATE, float(EbsState.EBS_CHARGING)),
        sent(0x301, 10, _low_pressure, off(0.0), off(9.0)),
        named="ebs_not_armed",
        cites="EBS_FRONT_ACC_PRESS is 2.1 bar",
    ),
    _one(
        "all is met and the car does not go on",
        stays(AsState.AS_OFF, 9.0),
        named="start_unknown",
        cites="AS_SWITCH_STATUS is 1",
    ),
    _one(
        "all is met but what is not recorded",
        stays(AsState.AS_OFF, 9.0),
        gone(0x510, off(8.2)),
        named=("start_unclear", "ai_message_missing", "ai_data_incomplete"),
        also=("stopped",),
    ),
    _one(
        "an interlock that is shorted in AS_OFF",
        stays(AsState.AS_OFF, 9.0),
        put(sig.FAULTS[2], 1.0),
        named="hvil_short",
        cites="HVIL_SHORT_FAULT is 1",
    ),
    _one(
        "the remote's E-stop is pressed in AS_OFF",
        stays(AsState.AS_OFF, 9.0),
        put(sig.REMOTE_ESTOP, 1.0, off(1.0)),
        named="remote_estop",
    ),
    _one(
        "TSMS goes off in AS_READY, shown 20 ms later",
        turned_away(ready(3.0)),
        put(sig.TS_SWITCH, 0.0, ready(3.02)),
        named="tsms",
    ),
    _one(
        "the mission is changed in AS_READY",
        turned_away(ready(3.0)),
        put(sig.AMI, 2.0, ready(2.98)),
        named="mission_changed",
        cites="ACCELERATION → SKIDPAD",
    ),
    _one(
        "the mission is taken back in AS_READY",
        turned_away(ready(3.0)),
        put(sig.AMI, 0.0, ready(2.97)),
        named=("mission_changed", "no_mission"),
    ),
    _one("TSMS goes off in AS_READY", turned_away(ready(3.0)), put(sig.TS_SWITCH, 0.0, ready(2.96)), named="tsms"),
    _one(
        "the AI computer deselects in AS_READY",
        turned_away(ready(3.0)),
        put(sig.MISSION_STATUS, 0.0, ready(2.97)),
        named="deselected",
        also=("status_not_selected",),
    ),
    _one(
        "the AI computer falls silent in AS_READY",
        turned_away(ready(3.0)),
        gone(AI_IDS, ready(2.8)),
        named="ai_silent",
        also=("no_ai_data",),
    ),
    _one(
        "the AI computer falls silent in AS_READY, and the state stays",
        stays(AsState.AS_READY, 9.0),
        gone(AI_IDS, ready(4.0)),
        named="ai_silent",
        also=("stopped",),
    ),
    _one(
        "Go is pressed and not taken",
        stays(AsState.AS_READY, 12.0),
        *(put(sig.REMOTE_GO, 1.0, ready(at), ready(at + 0.5)) for at in (6.0, 7.5, 9.0)),
        named="go_not_taken",
        cites="3 times",
    ),
    _one(
        "Go is held and not taken",
        stays(AsState.AS_READY, 12.0),
        put(sig.REMOTE_GO, 1.0, ready(5.8)),
        named="go_not_taken",
    ),
    _one(
        "Go is pressed too early only",
        stays(AsState.AS_READY, 12.0),
        put(sig.REMOTE_GO, 1.0, ready(2.0), ready(2.6)),
        named="go_too_early",
    ),
    _one(
        "Go is not pressed",
        stays(AsState.AS_READY, 12.0),
        named="no_go",
        cites="K2_SWITCH_GO_STATUS of the remote stays 0",
    ),
    _one("Go is not pressed, without the remote's messages", stays(AsState.AS_READY, 12.0), gone(0x181), named="no_go"),
    _one("Go is held from before", stays(AsState.AS_READY, 12.0), put(sig.GO, 1.0, off(0.0)), named="go_held"),
    _one(
        "Go comes early, and GO_SIGNAL shows it",
        stays(AsState.AS_READY, 12.0),
        puts({sig.GO: 1.0, sig.REMOTE_GO: 1.0}, ready(2.0)),
        named="go_too_early",
    ),
    _one(
        "torque is asked for in AS_READY",
        stays(AsState.AS_READY, 12.0),
        put(sig.TORQUE_R, 12.0, ready(1.0)),
        put(sig.GO, 1.0, ready(6.0)),
        named="torque_requested",
    ),
    _one("ASMS goes off in AS_READY", turned_away(ready(3.0)), put(sig.AS_SWITCH, 0.0, ready(2.97)), named="given_up"),
    _one(
        "the AI computer is not there in AS_OFF",
        stays(AsState.AS_OFF, 9.0),
        gone(AI_IDS, off(0.3)),
        named=("no_ai_data", "ai_silent"),
        also=("stopped",),
    ),
    _one(
        "the AI computer says NOT_SELECTED",
        stays(AsState.AS_OFF, 9.0),
        put(sig.MISSION_STATUS, 0.0),
        named="status_not_selected",
    ),
    _one(
        "the steering is turned",
        stays(AsState.AS_READY, 12.0),
        puts({sig.ANGLE: 9.0}, ready(1.0)),
        put(sig.GO, 1.0, ready(6.0)),
        named="steering_turned",
    ),
)


class Told(Value, frozen=True):
    """The judgement of an edited log beside what was expected of it.

    falsely_green: it is called OK, and something is wrong, or a rule is broken that the edit does not name.
    """

    edit: str
    grade: str  # right, partly (and something else), wrong
    falsely_green: bool
    named: tuple[str, ...]
    expected: tuple[str, ...]


def said(verdict: Verdict) -> tuple[str, ...]:
    """The first causes, and kinds of problems that are no incident's."""
    incidents = [incident for incident in verdict.explanation.incidents if not incident.planned]
    kinds = {incident.kind.slug for incident in incidents}
    others = (one.kind for one in verdict.findings if one.severity == "problem" and one.kind not in kinds)
    return tuple(dict.fromkeys((*(incident.candidates[0].slug for incident in incidents), *others)))


def sentences(verdict: Verdict) -> list[str]:
    """Everything that is said: findings, and the evidence of first causes."""

    def steps(incident: Incident) -> list[str]:
        return [step.words for step in incident.candidates[0].steps]

    return [
        *(one.words for one in verdict.findings),
        *(words for incident in verdict.explanation.incidents for words in steps(incident)),
    ]


def told(edit: Edit) -> Told:
    """Judge an edited log; one that is called OK is judged by the checker of the rules as well."""
    frames, name = edit.frames(), good_run(edit.run).run.revision.name
    verdict = judged(frames, name).verdict
    named = said(verdict) or (OK,)
    cited = not edit.cites or any(edit.cites in words for words in sentences(verdict))
    hit = bool(set(named) & set(edit.named)) and cited
    clean = {*named} <= {*edit.named, *edit.also}
    grade = "right" if hit and clean else "partly" if hit or set(named) & set(edit.named) else "wrong"
    green = verdict.ok and (OK not in edit.named or rules_broken(frames, name) != {*edit.breaks})
    return Told(edit.name, grade, green, named, edit.named)


def rules_broken(frames: Frames, revision_name: str) -> set[str]:
    """Return the rules that the checker finds broken on the wire of a log."""
    checker = checker_for(Codec(revision(revision_name)), busy_machine=False)
    checker.on_frames(on_wire(frames.frame(row)) for row in range(len(frames)))
    return {violation.rule for _, violation in checker.found}


def told_at(row: int) -> Told:
    """Judge the edited log of a row of the table: acts do not go from process to process."""
    return told(EDITS[row])
