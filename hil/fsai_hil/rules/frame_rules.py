"""The rules, a function each, as safety rules and output table have them; the numbers are in `numbers.py`.

What a function yields is wrong. What is on the wire at an instant was decided a little earlier: a value that the car
sent less than `in_flight_ns` ago may not have been seen yet, so a rule is broken only when it is broken for every value
that the sender can have seen (`BusView.possible`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, Final

from fsai_hil.rules.bus_view import BRAKE_STEP_PCT, OFF, ROLES, WHOLE, BusView
from fsai_hil.rules.numbers import (
    CYCLE_GAP_NS,
    CYCLE_NS,
    FEEDBACK_STALE_NS,
    LAUNCH_NS,
    MS,
    STATUS_FRESH_NS,
    S,
    constant_power_nm,
)
from fsai_vcu.interface.enums import Ami, AsState, Direction, MissionStatus
from fsai_vcu.interface.messages import AiBrake, AiDriveFront, AiDriveRear, AiStatus, AiSteer

RULES: Final = {
    "1": "torque and brake never meet at the VCU",
    "2": "torque only with everything that allows it",
    "3": "NEUTRAL or FINISHED in AS_DRIVING only at proven rest",
    "4": "steering, torque and motor speed within every limit",
    "5": "before AS_DRIVING: zeros, NEUTRAL, at most SELECTED",
    "6": "an emergency request latches",
    "7": "invalid commands are refused whole",
    "8": "the five frames and no other, and only of a process that may send",
    "9": "the handshake echoes the last bit received",
    "10": "no drive goes on after a restart",
    "output table": "status, direction, steering and brake are those of the AS state and of what is due",
    "modes": "autonomous only as it was chosen, manual after a lost command",
    "reactions": "graded reactions come in time",
    "interval": "two cycles are never closer than 8 ms",
    "safe end": "a safe end is reached from every state",
}


UNBRAKED: Final = (*OFF, AsState.EMERGENCY_BRAKE)  # output table: the car holds or brakes itself there
STEER_STEP_DEG: Final = 0.1  # interface specification v4.0: the signal's resolution
LONGEST_TURN_NS: Final = 2 * CYCLE_NS  # after a longer pause nobody turns by all that was missed
TINY: Final = 1e-6  # of a float

Axle = AiDriveFront | AiDriveRear
Check = Callable[[BusView, Any], Iterator[str]]
CHECKS: Final[dict[bool, dict[str, list[tuple[str, Check]]]]] = {
    process: {kind: [] for kind in ("0x510", "drive", "torque", "0x513", "0x514")} for process in (False, True)
}
"""The rules by kind of frame, without (False) and with (True) knowledge of what the process is given."""


def rule(name: str, *kinds: str, of_process: bool = False) -> Callable[[Check], Check]:
    """The function holds rule `name` against each frame of these kinds; what it yields is wrong.

    "drive" is 0x511 and 0x512, "torque" those of them that ask for some. `of_process`: it can be checked only where it
    is known what the process is given.
    """

    def registered(check: Check) -> Check:
        for process in (True,) if of_process else (False, True):
            for kind in kinds:
                CHECKS[process][kind].append((name, check))
        return check

    return registered


# ---------------------------------------------------------------- 0x510


@rule("interval", "0x510")
def _apart(v: BusView, ai: AiStatus) -> Iterator[str]:
    """Two sends are never closer than 8 ms."""
    if v.interval_ns is not None and v.interval_ns < CYCLE_GAP_NS - v.slack_ns:
        yield f"two cycles only {v.interval_ns / MS:.2f} ms apart"


@rule("8", "0x510", of_process=True)
def _ends(v: BusView, ai: AiStatus) -> Iterator[str]:
    """The process sends five cycles on stop, then nothing."""
    ended, process = v.seen.ended, v.process
    if ended is not None and process is not None and ended > process.stop_cycles:
        yield "frames are sent after the orderly end"


@rule("9", "0x510")
def _echoes(v: BusView, ai: AiStatus) -> Iterator[str]:
    """The handshake echo equals the last received handshake bit."""
    if v.seen.handshake is None:
        if v.from_start and ai.handshake:
            yield "handshake 1 where nothing was received"
    elif ai.handshake not in v.possible("bit", v.seen.handshake, v.handshake_in_flight_ns):
        yield f"handshake {int(ai.handshake)} where {int(not ai.handshake)} was received"


@rule("6", "0x510")
def _latches(v: BusView, ai: AiStatus) -> Iterator[str]:
    """ESTOP_REQUEST stays 1 until it is cleared by a reset in AS_INIT or AS_OFF, or by the car's power cycle."""
    if not v.seen.latched or ai.estop_request:
        return
    if v.process is not None:
        yield "ESTOP_REQUEST is 0 though it was asked for, and nobody cleared it"
    elif not v.was_off and not any(state in OFF for state in v.states):
        yield f"ESTOP_REQUEST released in {v.states[-1].label if v.states else 'no state'}"


@rule("3", "0x510")
def _stands(v: BusView, ai: AiStatus) -> Iterator[str]:
    """NEUTRAL or FINISHED is never sent in AS_DRIVING unless all wheels have been under 10 rpm for 0.5 s."""
    if v.driving and not v.wheels.may_stand(v.now_ns):
        if ai.direction is Direction.NEUTRAL:
            yield "NEUTRAL in AS_DRIVING before standstill"
        if ai.mission_status is MissionStatus.FINISHED:
            yield "FINISHED in AS_DRIVING before standstill"


@rule("5", "0x510")
def _waits(v: BusView, ai: AiStatus) -> Iterator[str]:
    """NEUTRAL and MISSION_STATUS at most SELECTED are sent in AS_INIT, AS_OFF and AS_READY, as in the output table."""
    if not v.idle:
        return
    s = v.seen
    where = v.states[-1].label if v.states else "no AS state yet"
    if ai.direction is not Direction.NEUTRAL:
        yield f"direction {ai.direction.label} in {where}"
    if ai.mission_status not in (MissionStatus.NOT_SELECTED, MissionStatus.SELECTED):
        yield f"MISSION_STATUS {ai.mission_status.label} in {where}"
    if ai.mission_status is MissionStatus.SELECTED and v.process is not None:
        if s.mission is Ami.NOT_SELECTED:
            yield "SELECTED without a mission on the AMI"
        if len(s.confirmed) < len(ROLES):
            yield "SELECTED before planner and controller have confirmed their reset"
        if s.as_state is not AsState.AS_READY and not s.autonomous:
            yield "SELECTED though autonomous was not chosen"
        if s.as_state is not AsState.AS_READY and s.latched:
            yield "SELECTED with an emergency latched"


@rule("output table", "0x510")
def _says(v: BusView, ai: AiStatus) -> Iterator[str]:
    """MISSION_STATUS and direction of each AS state: what is wrong whatever the reason for a stop."""
    if not v.states or any(state is not v.states[-1] for state in v.states):
        return
    state, mission, direction = v.states[-1], ai.mission_status, ai.direction
    right_status = right_direction = True
    if state is AsState.AS_DRIVING:
        right_status = mission in (MissionStatus.RUNNING, MissionStatus.FINISHED)
        right_direction = direction is not Direction.REVERSE
    elif state is AsState.AS_FINISHED:
        right_status = mission is MissionStatus.FINISHED
        right_direction = direction is Direction.NEUTRAL
    elif state is AsState.EMERGENCY_BRAKE:
        right_status = mission is MissionStatus.RUNNING
        if direction is Direction.FORWARD:
            right_direction = v.in_flight_ns > 0 or not v.wheels.surely_stand(v.now_ns)
        else:
            right_direction = direction is Direction.NEUTRAL and (v.wheels.may_stand(v.now_ns) or v.stood_before)
    if not right_status:
        yield f"MISSION_STATUS {mission.label} in {state.label}"
    if not right_direction:
        yield f"direction {direction.label} in {state.label}"


@rule("output table", "0x510", of_process=True)
def _says_exactly(v: BusView, ai: AiStatus) -> Iterator[str]:
    """MISSION_STATUS and direction as what is due has them, where no reason for a stop is hidden."""
    if not v.nothing_hidden:
        return
    s = v.seen
    if ai.mission_status is MissionStatus.NOT_SELECTED and v.idle:
        chosen = s.mission is not Ami.NOT_SELECTED and len(s.confirmed) == len(ROLES) and s.ended is None
        if chosen and (s.as_state is AsState.AS_READY or (s.autonomous and not s.latched)):
            yield "NOT_SELECTED, and a mission is chosen and confirmed"
    if s.as_state is not AsState.AS_DRIVING:
        return
    rest = v.wheels.may_stand(v.now_ns)
    runs = ai.mission_status is MissionStatus.RUNNING and ai.direction is Direction.FORWARD
    finished = ai.mission_status is MissionStatus.FINISHED and ai.direction is Direction.NEUTRAL
    if s.latched or ai.estop_request:
        if not runs and not (rest and finished):
            yield "an emergency is asked for, and it is not RUNNING and FORWARD"
    elif s.stopped is not None and rest:
        if not finished:
            yield "a stop is due, the car stands, and it is not FINISHED and NEUTRAL"
    elif not runs:
        yield "not RUNNING and FORWARD in AS_DRIVING, and no stop is over"


@rule("reactions", "0x510", of_process=True)
def _asks_for_the_emergency(v: BusView, ai: AiStatus) -> Iterator[str]:
    """Graded reactions: ESTOP_REQUEST when it is due; and not otherwise, where no reason for it is hidden."""
    s = v.seen
    if not ai.estop_request and s.as_state is AsState.AS_DRIVING:
        if s.alarm is not None and ai.direction is not Direction.NEUTRAL:
            yield f"no ESTOP_REQUEST: {s.alarm}"
        elif s.ended is not None and ai.direction is not Direction.NEUTRAL:
            yield "the software ends in AS_DRIVING, neither at rest nor with ESTOP_REQUEST"
    # A stop that goes on may turn out to be without effect, which is not judged here, nor what did not go out.
    asked = s.latched or s.alarm is not None or v.over or not s.whole
    asked = asked or (v.order is not None and v.order.estop)
    if v.nothing_hidden and ai.estop_request and not asked:
        yield "ESTOP_REQUEST, and nothing that happened asks for it"


# ---------------------------------------------------------------- 0x511 and 0x512


@rule("1", "torque", "0x514")
def _meet(v: BusView, image: Any) -> Iterator[str]:
    """Axle torque above 0 and brake above 0 never meet at the VCU, which sees the frames one after another."""
    if max(v.seen.torque_nm) > 0.0 and max(v.seen.brake_pct) > 0.0:
        torque_nm, brake_pct = max(v.seen.torque_nm), max(v.seen.brake_pct)
        yield f"torque {torque_nm:.1f} Nm and brake {brake_pct:.1f} % together"


@rule("1", "torque")
def _rises(v: BusView, axle: Any) -> Iterator[str]:
    """Torque rises only after a whole cycle with both at zero and a 0x524 that echoes it, or two such cycles."""
    if not v.seen.torque_runs and not v.may_rise:
        yield f"torque rose after {v.seen.zeros} complete cycles without torque and brake"


@rule("2", "torque")
def _may_drive(v: BusView, axle: Axle) -> Iterator[str]:
    """Torque only with AS_DRIVING in a 0x520 not older than 50 ms, FORWARD, and no emergency; and it must drive.

    Against a motor speed limit of zero it may be a brake: that needs no Go, no 3 s and no command.
    """
    s, t_ns, name = v.seen, v.now_ns, _name(axle)
    if not v.states:
        if v.from_start or t_ns - (v.start_ns or 0) >= STATUS_FRESH_NS:
            yield f"{name} torque before any 0x520"
        return
    if AsState.AS_DRIVING not in v.states:
        yield f"{name} torque in {v.states[-1].label}"
    if not v.state_settled:
        yield f"{name} torque after a 0x520 with an undefined AS_STATE, and not 100 ms of known ones since"
    age_ns = t_ns - (s.status_ns or 0)
    if age_ns >= STATUS_FRESH_NS + v.in_flight_ns:  # stale after 50 ms is stale at 50 ms
        yield f"{name} torque with a 0x520 {age_ns / MS:.0f} ms old"
    if v.ai.direction is not Direction.FORWARD and v.cycles:
        yield f"{name} torque with direction {v.ai.direction.label}"
    if v.ai.estop_request or s.latched:
        yield f"{name} torque with an emergency asked for"
    if not _brakes_by(v, axle):
        yield from _may_move(v, name, t_ns)


def _may_move(v: BusView, name: str, t_ns: int) -> Iterator[str]:
    """Go, the sequence and the mission behind it, 3 s in AS_DRIVING, the mode, and a command that asks for it."""
    s, order = v.seen, v.order
    if not any(v.possible("go", s.go)):
        yield f"{name} torque without the Go signal"
    if s.as_state is AsState.AS_DRIVING:
        if s.path != WHOLE:
            yield f"{name} torque without AS_OFF, AS_READY and AS_DRIVING seen in turn by this process"
        if not s.waited and not v.short_sequence:
            yield f"{name} torque without 5 s in AS_READY before Go"
        if s.mission is Ami.NOT_SELECTED or not s.acknowledged:
            yield f"{name} torque without a mission that was acknowledged"
        if s.driving_ns is not None and t_ns - s.driving_ns < LAUNCH_NS - v.slack_ns:
            yield f"{name} torque {(t_ns - s.driving_ns) / S:.3f} s after AS_DRIVING began"
    if v.process is None:
        return
    if not s.autonomous:
        yield f"{name} torque though the mode is not autonomous"
    if order is None:
        yield f"{name} torque without a command younger than 100 ms, on data younger than 500 ms"
    elif order.throttle <= 0.0 or order.brake > 0.0:
        yield f"{name} torque though the command does not ask for it"


@rule("10", "torque")
def _resumes(v: BusView, axle: Axle) -> Iterator[str]:
    """After a restart the car never resumes driving by itself: AS_OFF must be seen again."""
    if v.seen.restarted and not _brakes_by(v, axle):
        yield f"{_name(axle)} torque of a process that has not seen AS_OFF"


@rule("reactions", "torque")
def _goes_on(v: BusView, axle: Axle) -> Iterator[str]:
    """No torque in a run that is over: by a switch, a fault bit or what else stops it."""
    s = v.seen
    seen = s.stopped is not None and (v.process is not None or v.now_ns - s.stopped_ns >= v.in_flight_ns)
    if seen and not _brakes_by(v, axle):
        yield f"{_name(axle)} torque in a run that is over: {s.stopped}"


@rule("4", "torque")
def _within_torque(v: BusView, axle: Axle) -> Iterator[str]:
    """Torque at most 195 Nm, a live TRQ_MAX, the constant-power schedule, the operational limit, and its share."""
    s, front = v.seen, isinstance(axle, AiDriveFront)
    most_nm = v.torque_limit_nm if v.driven[0 if front else 1] else 0.0
    newest, max_ns = (s.front_max_nm, s.front_ns) if front else (s.rear_max_nm, s.rear_ns)
    if newest is not None:
        most_nm = min(most_nm, max(v.possible("front" if front else "rear", newest)))
    elif v.from_start:
        most_nm = 0.0  # the car has not sent yet what it takes
    speeds = v.possible("rpm", v.wheels.rpm)
    if speeds and not v.wheels.open:
        fastest = min(max(rpm[:2] if front else rpm[2:]) for rpm in speeds)
        most_nm = min(most_nm, constant_power_nm(fastest))
    elif v.from_start and not speeds:
        most_nm = 0.0
    if v.order is not None and not _brakes_by(v, axle):
        most_nm *= v.order.throttle
    if axle.torque_nm > most_nm + TINY:
        yield f"{_name(axle)} torque {axle.torque_nm:.1f} Nm above its limit {most_nm:.1f}"
    age_ns = 0 if max_ns is None else v.now_ns - max_ns
    if age_ns >= FEEDBACK_STALE_NS + v.in_flight_ns:
        yield f"{_name(axle)} torque by a live limit {age_ns / MS:.0f} ms old"


@rule("4", "drive")
def _within_speed(v: BusView, axle: Axle) -> Iterator[str]:
    """Motor speed limit at most the operational speed limit, and what the command allows."""
    most_rpm = v.motor_limit_rpm
    if axle.torque_nm > 0.0 and v.order is not None:
        most_rpm = min(most_rpm, v.order.speed_limit_mps * v.rpm_per_mps)
    if axle.motor_speed_max_rpm > most_rpm + TINY:
        yield f"{_name(axle)} motor speed limit {axle.motor_speed_max_rpm} rpm above {most_rpm:.0f} rpm"


def _brakes_by(v: BusView, axle: Axle) -> bool:
    """The official simulator: torque against a motor speed limit of zero is a brake."""
    return v.motor_brakes and axle.motor_speed_max_rpm == 0


# ---------------------------------------------------------------- 0x513


@rule("5", "0x513")
def _steers_idle(v: BusView, steer: AiSteer) -> Iterator[str]:
    """Steering is zero in AS_INIT, AS_OFF and AS_READY."""
    if steer.steer_deg != 0.0 and v.idle:
        yield f"steering {steer.steer_deg:.1f} deg in {v.states[-1].label if v.states else 'no AS state'}"


@rule("4", "0x513")
def _steers_outside(v: BusView, steer: AiSteer) -> Iterator[str]:
    """Outside AS_DRIVING steering is zero at once."""
    if steer.steer_deg != 0.0 and v.states and AsState.AS_DRIVING not in v.states and not v.idle:
        yield f"steering {steer.steer_deg:.1f} deg in {v.states[-1].label}"


def _angles(v: BusView) -> tuple[float, float]:
    """The most steering by the limits that the sender can have seen: the widest, and the narrowest."""
    live = v.possible("angle", v.seen.angle_max_deg)
    if not live:
        return (0.0, 0.0) if v.from_start else (v.steer_limit_deg, v.steer_limit_deg)
    return min(v.steer_limit_deg, max(live)), min(v.steer_limit_deg, min(live))


@rule("4", "0x513")
def _within_angle(v: BusView, steer: AiSteer) -> Iterator[str]:
    """Steering at most the revision's limit, the live ANGLE_MAX and the operational limit."""
    most_deg, _ = _angles(v)
    if abs(steer.steer_deg) > most_deg + TINY:
        yield f"steering {steer.steer_deg:.1f} deg beyond its limit {most_deg:.1f}"


@rule("4", "0x513")
def _within_rate(v: BusView, steer: AiSteer) -> Iterator[str]:
    """Steering turns no faster than the car; a limit that the car lowers is obeyed at once.

    So is zero at the orderly end of a car at rest, and where AS_DRIVING begins.
    """
    s, deg = v.seen, steer.steer_deg
    if s.steered_ns is None or not all(state is AsState.AS_DRIVING for state in v.states):
        return
    begins = s.driving_ns is not None and s.steered_ns < s.driving_ns
    if (deg == 0.0 and (begins or v.ai.direction is Direction.NEUTRAL)) or not s.whole:
        return
    step_ns = v.now_ns - s.steered_ns
    if v.process is not None:
        step_ns = min(step_ns, LONGEST_TURN_NS)
    step_ns += v.in_flight_ns
    most_deg = v.steer_rate_degps * step_ns / S + STEER_STEP_DEG
    turned_deg = abs(deg - s.steer_deg)
    if turned_deg > most_deg + TINY and abs(s.steer_deg) <= _angles(v)[1] + TINY:
        yield f"steering turned by {turned_deg:.1f} deg in {step_ns / MS:.1f} ms"


@rule("output table", "0x513", of_process=True)
def _steers(v: BusView, steer: AiSteer) -> Iterator[str]:
    """Steering follows the command in AS_DRIVING, or is held; it is zero in the first 3 s and at the end."""
    s, deg, order = v.seen, steer.steer_deg, v.order
    if s.as_state is not AsState.AS_DRIVING or s.driving_ns is None:
        return
    if s.ended is not None and v.ai.direction is Direction.NEUTRAL:
        if deg != 0.0:
            yield "the software ends at rest, and not with zeros"
        return
    stopping = s.stopped is not None or s.latched
    if v.now_ns - s.driving_ns < LAUNCH_NS and not stopping:
        if deg != 0.0:
            yield f"steering {deg} deg in the first 3 s of AS_DRIVING"
        return
    begins = s.steered_ns is not None and s.steered_ns < s.driving_ns
    if not s.whole or (begins and deg == 0.0):
        return
    _, most_deg = _angles(v)
    held_deg = max(-most_deg, min(most_deg, s.steer_deg))  # a limit that was lowered is obeyed at once
    held = abs(deg - held_deg) <= STEER_STEP_DEG / 2
    if order is None or not s.autonomous:
        if abs(deg - held_deg) > (STEER_STEP_DEG / 2 if v.nothing_hidden else STEER_STEP_DEG + TINY):
            yield f"steering from {s.steer_deg} to {deg} deg, and no command counts"
        return
    if not v.nothing_hidden:  # it may be held for a reason that cannot be seen: it never turns elsewhere
        target_deg = max(-most_deg, min(most_deg, order.steer_deg))
        low, high = min(held_deg, target_deg) - STEER_STEP_DEG, max(held_deg, target_deg) + STEER_STEP_DEG
        if not low - TINY <= deg <= high + TINY:
            yield f"steering from {s.steer_deg} to {deg} deg, and the command asks for {target_deg:.2f}"
        return
    step_ns = 0 if s.steered_ns is None else min(v.now_ns - s.steered_ns, LONGEST_TURN_NS)
    most_turn_deg = v.steer_rate_degps * step_ns / S
    turn_deg = max(-most_turn_deg, min(most_turn_deg, order.steer_deg - s.steer_deg))
    wanted_deg = max(-most_deg, min(most_deg, s.steer_deg + turn_deg))
    if abs(deg - wanted_deg) > STEER_STEP_DEG + TINY and not (held and (stopping or not v.commands_count)):
        yield f"steering {deg} deg, and the command asks for {order.steer_deg:.2f}"


# ---------------------------------------------------------------- 0x514


@rule("1", "0x514")
def _brake_rises(v: BusView, brake: AiBrake) -> Iterator[str]:
    """Brake rises only after a complete cycle with zero torque."""
    if any(v.seen.brake_pct) and v.seen.braked_pct == 0.0 and v.seen.torque_may_be_there:
        yield "brake rose before a complete cycle without torque"


@rule("output table", "0x514")
def _brakes_where_the_car_does(v: BusView, brake: AiBrake) -> Iterator[str]:
    """Front and rear alike; no brake in AS_INIT, AS_OFF and EMERGENCY_BRAKE, and none where the motors brake."""
    if brake.front_pct != brake.rear_pct:
        yield f"brake {brake.front_pct} % in front and {brake.rear_pct} % at the rear"
    none = not v.states and v.from_start
    if any(v.seen.brake_pct) and (none or (v.states and all(one in UNBRAKED for one in v.states))):
        yield f"brake {max(v.seen.brake_pct):.1f} % in {'no AS state yet' if none else v.states[-1].label}"
    if any(v.seen.brake_pct) and v.motor_brakes:
        yield "a hydraulic brake on a car that brakes by its motors"


@rule("output table", "0x514", of_process=True)
def _brakes(v: BusView, brake: AiBrake) -> Iterator[str]:
    """The brake that the output table and the reactions ask for, as soon as rule 1 lets it rise."""
    s, process, order, pct = v.seen, v.process, v.order, brake.front_pct
    assert process is not None
    if v.motor_brakes or s.as_state is None or s.as_state in UNBRAKED:
        return
    if s.ended is not None and v.ai.direction is Direction.NEUTRAL:
        if pct > 0.0:
            yield "the software ends at rest, and not with zeros"
        return
    if s.torque_may_be_there or not s.whole:  # what did not go out may have asked for torque
        return
    rest = v.wheels.may_stand(v.now_ns)
    if s.as_state is not AsState.AS_DRIVING:
        if pct <= 0.0:
            yield f"no holding brake in {s.as_state.label}"
    elif s.latched or (s.stopped is not None and not rest):
        if pct != process.service_brake_pct:
            why = "an emergency is asked for" if s.latched else s.stopped
            yield f"brake {pct} %, not the service brake: {why}"
    elif s.stopped is not None or (s.driving_ns is not None and v.now_ns - s.driving_ns < LAUNCH_NS):
        if pct <= 0.0:
            yield f"no holding brake: {s.stopped or 'the first 3 s of AS_DRIVING'}"
    elif order is None:
        falls = pct < s.braked_pct
        if falls and (v.nothing_hidden or (pct == 0.0 and v.whole_in_a_row > 0)):
            yield f"the brake falls from {s.braked_pct} % to {pct} %, and no command counts"
    elif v.nothing_hidden and v.commands_count and abs(pct - 100.0 * order.brake) > BRAKE_STEP_PCT / 2:
        yield f"brake {pct} %, and the command asks for {100.0 * order.brake:g} %"


@rule("output table", "0x514", of_process=True)
def _brakes_by_motors(v: BusView, brake: AiBrake) -> Iterator[str]:
    """A car that must never be asked for a hydraulic brake stops by torque against a speed limit of zero."""
    s, now_ns, wheels = v.seen, v.now_ns, v.wheels
    if not (v.nothing_hidden and v.motor_brakes) or s.as_state is not AsState.AS_DRIVING:
        return
    times = wheels.believed_ns, s.front_ns, s.rear_ns
    known = v.status_fresh and all(t is not None and now_ns - t < FEEDBACK_STALE_NS for t in times)
    due = s.stopped is not None and not s.latched and not wheels.may_stand(now_ns)
    if due and known and (s.torque_runs or v.may_rise) and not (v.cycle.torque and not v.cycle.motor_rpm):
        yield "the motors do not brake, and a stop is due"


def _name(axle: Axle) -> str:
    return "front" if isinstance(axle, AiDriveFront) else "rear"
