"""What is done to the car is what explain names first, with its time: each end brought about in the simulated car."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import pytest
from story_runs import Act, Run, branch, driving, off, parked, ready

from fsai_hil.simulator.car_signals import Actuation, CarFeedback
from fsai_hil.simulator.faults import Drop, Freeze, WrongLength, WrongValues
from fsai_vcu.diagnostics.explain import IncidentKind, tell
from fsai_vcu.interface.enums import Ami, Direction, MissionStatus
from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.units import MS, S


@dataclass(frozen=True)
class End:
    """One thing that goes wrong. `before_ns`, `after_ns`: how far from it the first step of the chain may lie."""

    name: str
    run: Callable[[], Run]
    act: Act
    seconds: float
    kind: IncidentKind
    slug: str
    before_ns: int = 15 * MS
    after_ns: int = 15 * MS
    also: str = ""


def switch(**values: object) -> Act:
    return lambda run: run.switch(**values)


def drop(*ids: int) -> Act:
    return lambda run: run.spoil(Drop(frozenset(ids)))


def say(can_id: int, **values: object) -> Act:
    return lambda run: run.spoil(WrongValues(frozenset({can_id}), run.lockstep.world.codec, values))


def car_drops(*ids: int) -> Act:
    return lambda run: run.lockstep.world.vcu.outgoing.faults.append(Drop(frozenset(ids)))


def car_is_silent_for_300_ms(run: Run) -> None:
    wire, silence = run.lockstep.world.vcu.outgoing, Drop(frozenset({0x520}))
    wire.faults.append(silence)
    run.go_on(0.3)
    wire.faults.remove(silence)


def vcu_misses(*ids: int) -> Act:
    return lambda run: run.lockstep.world.vcu.incoming.faults.append(Drop(frozenset(ids)))


def sense(change: Callable[[CarFeedback], CarFeedback]) -> Act:
    return lambda run: run.lockstep.world.sensor_faults.append(lambda feedback, now_ns: change(feedback))


def no_brake(order: Actuation, now_ns: int) -> Actuation:
    return replace(order, front_brake_pct=0.0, rear_brake_pct=0.0)


def silent_controller(run: Run) -> None:
    run.lockstep.computer.command_filter = lambda command, now_ns: None


def silent_planner(run: Run) -> None:
    run.lockstep.computer.on_cones = lambda observation: None  # type: ignore[method-assign]


def brakeless(run: Run) -> None:
    run.lockstep.world.actuator_faults.append(no_brake)
    silent_controller(run)


def intrude(run: Run) -> None:
    run.lockstep.intrude(Frame(0x513, bytes.fromhex("6400"), run.now_ns))


def reboot(run: Run) -> None:
    run.switch(lvms=False)
    run.go_on(0.1)
    run.switch(lvms=True)


def bus_off(run: Run) -> None:
    assert run.lockstep.on_frame is not None
    run.lockstep.on_frame(Frame(0x040, bytes(8), run.now_ns, error=True))
    run.lockstep.computer.lose_bus("bus-off", run.now_ns)


def go_after(seconds: float, then: Act | None = None) -> Act:
    """Something is done, and Go is given so much later."""

    def act(run: Run) -> None:
        if then is not None:
            then(run)
        run.go_on(seconds)
        run.switch(go=True)

    return act


def up(**switches: object) -> Act:
    """The switches that are turned on; the others are forgotten."""
    return switch(**{"lvms": True, "asms": True, "tsms": True, "ami": Ami.ACCELERATION, **switches})


def manual(run: Run) -> None:
    assert run.lockstep.bridge.set_mode("manual", run.now_ns)[0]


def operator(run: Run) -> None:
    assert run.lockstep.bridge.emergency_brake("somebody at the laptop", run.now_ns)[0]


def turned(feedback: CarFeedback) -> CarFeedback:
    return replace(feedback, steer_deg=feedback.steer_deg + 8.0)


def spinning(feedback: CarFeedback) -> CarFeedback:
    fl, fr, rl, rr = feedback.wheel_rpm
    return replace(feedback, wheel_rpm=(1.5 * fl + 100.0, fr, rl, rr))


def both(*acts: Act) -> Act:
    def act(run: Run) -> None:
        for one in acts:
            one(run)

    return act


def run_and_forget(run: Run) -> None:
    """An emergency brake, ASMS off and on again after it, and never the whole power cycle."""
    run.switch(car_estop=True)
    run.go_on(16.0)
    run.switch(car_estop=False, asms=False)
    run.go_on(0.5)
    run.switch(asms=True)


def car_2021() -> Run:
    return driving("2021")


def simulator() -> Run:
    return driving("2026", "official-simulator")


E, A, R, P = IncidentKind.EMERGENCY, IncidentKind.ABORT, IncidentKind.REFUSAL, IncidentKind.STOP
EDGE = 60 * MS  # an AI computer's gate moves in cycles

ENDS = [
    # ---- what people do
    End("an E-stop button on the car", driving, switch(car_estop=True), 0.1, E, "sdc_open"),
    End("the remote's E-stop", driving, switch(remote_estop=True), 0.1, E, "sdc_open"),
    End("the dongle is pulled", driving, switch(dongle=False), 0.1, E, "sdc_open"),
    End("the crash sensor", driving, switch(crash=True), 0.1, E, "sdc_open"),
    End("the remote's radio is lost", driving, switch(remote_radio_ok=False), 0.2, E, "go_off", also="radio_lost"),
    End("Go off", driving, switch(go=False), 0.1, E, "go_off"),
    End("ASMS off", driving, switch(asms=False), 0.1, E, "asms_off"),
    End("TSMS off", driving, switch(tsms=False), 0.1, E, "tsms_off"),
    End("an E-stop button in AS_READY", ready, switch(car_estop=True), 0.1, E, "sdc_open"),
    End("the operator's emergency brake", driving, operator, 0.1, E, "not_on_the_bus"),
    # ---- what breaks in the car
    End("the interlock opens", driving, switch(hvil_open=True), 0.1, E, "hvil_open"),
    End("the interlock is shorted", driving, switch(hvil_short=True), 0.1, E, "hvil_short"),
    End("EBS fault", driving, switch(ebs_fault=True), 0.1, E, "ebs_fault"),
    End("EBS fault of a 2021 car", car_2021, switch(ebs_fault=True), 0.1, E, "ebs_fault"),
    End("charger fault", driving, switch(offboard_charger_fault=True), 0.1, E, "offboard_charger"),
    End("charge procedure fault", driving, switch(charge_procedure_fault=True), 0.1, E, "charge_procedure"),
    End("BMS fault", driving, switch(bms_fault=True), 0.1, E, "bms"),
    End("the VCU reboots", driving, reboot, 3.0, A, "vcu_reboot"),
    End("the car is switched off", driving, switch(lvms=False), 3.0, A, "power_off"),
    # ---- what the AI computer says
    End(
        "FINISHED while moving",
        driving,
        say(0x510, mission_status=MissionStatus.FINISHED),
        0.2,
        E,
        "finished_while_moving",
    ),
    End("NEUTRAL while moving", driving, say(0x510, direction=Direction.NEUTRAL), 0.2, E, "neutral_while_moving"),
    End("torque with brake", driving, say(0x514, front_pct=20.0), 0.2, E, "torque_with_brake"),
    # ---- the link
    *(
        End(f"0x{can_id:03X} is missing", driving, drop(can_id), 0.1, E, "ai_message_missing")
        for can_id in (0x510, 0x511, 0x512, 0x513, 0x514)
    ),
    End("0x513 is missing, 2021", car_2021, drop(0x513), 0.2, E, "ai_message_missing"),
    End(
        "0x512 has a wrong length",
        driving,
        lambda run: run.spoil(WrongLength(frozenset({0x512}), 3)),
        0.2,
        E,
        "ai_message_length",
    ),
    End("the bridge is killed", driving, lambda run: run.lockstep.computer.kill_bridge(), 0.2, E, "ai_silent"),
    End(
        "the bridge is killed in AS_READY", ready, lambda run: run.lockstep.computer.kill_bridge(), 0.2, E, "ai_silent"
    ),
    End("bus-off", driving, bus_off, 0.2, E, "bus_lost"),
    End(
        "the echo is frozen",
        driving,
        lambda run: run.spoil(Freeze(frozenset({0x510}))),
        0.2,
        E,
        "handshake_lost",
        25 * MS,
        25 * MS,
    ),
    End("the VCU does not hear 0x514", driving, vcu_misses(0x514), 0.2, E, "ai_unheard", 0, 130 * MS),
    # ---- what the AI side supervises
    End("an intruder", driving, intrude, 0.1, E, "intruder"),
    End("0x520 is missing", driving, car_drops(0x520), 1.0, A, "vcu_silent"),
    End("0x520 is missing for 0.3 s", driving, car_is_silent_for_300_ms, 0.7, E, "vcu_silent"),
    End("wheel speeds are missing", driving, car_drops(0x525), 1.0, E, "wheels_stale"),
    End("steering feedback is missing", driving, car_drops(0x523), 1.0, E, "steering_stale"),
    End("the steering is where it should not be", driving, sense(turned), 1.2, E, "steering_implausible", 0, 60 * MS),
    End("one wheel does not fit the others", driving, sense(spinning), 1.2, E, "wheel_implausible"),
    End(
        "the loop hangs for 80 ms",
        driving,
        lambda run: run.lockstep.computer.hang_bridge(run.now_ns + 80 * MS),
        0.2,
        E,
        "loop_fault",
    ),
    End("the brake does not work", driving, brakeless, 3.0, E, "stop_ineffective", 0, 400 * MS),
    End("the controller falls silent", driving, silent_controller, 3.0, P, "command_stale", 25 * MS, 25 * MS),
    End("the planner falls silent", driving, silent_planner, 4.0, P, "command_stale", 0, 600 * MS),
    End("manual while driving", driving, manual, 3.0, P, "stop_asked", 0, EDGE),
    # ---- the official simulator
    End(
        "simulator: a brake is asked for",
        simulator,
        both(say(0x512, torque_nm=0.0), say(0x511, torque_nm=0.0), say(0x514, front_pct=10.0)),
        0.2,
        E,
        "brake_request_simulator",
    ),
    End("simulator: ASMS off", simulator, switch(asms=False), 0.5, A, "asms_off"),
    End(
        "simulator: NOT_SELECTED",
        simulator,
        say(0x510, mission_status=MissionStatus.NOT_SELECTED),
        0.5,
        A,
        "not_selected_simulator",
    ),
    End("simulator: 0x512 is missing", simulator, drop(0x512), 0.2, E, "ai_message_missing"),
    # ---- refusals to get ready
    End("ASMS stays off", parked, up(asms=False), 6.5, R, "asms", 0, 1 * S),
    End("TSMS stays off", parked, up(tsms=False), 6.5, R, "tsms", 0, 1 * S),
    End(
        "nobody sends AI data",
        parked,
        both(drop(0x510, 0x511, 0x512, 0x513, 0x514), up()),
        6.5,
        R,
        "no_ai_data",
        1 * S,
        1 * S,
    ),
    End("0x514 never comes", parked, both(drop(0x514), up()), 6.5, R, "ai_data_incomplete", 1 * S, 1 * S),
    End("no mission", off, lambda run: None, 5.2, R, "no_mission", 10 * S, 0),
    End(
        "the AI computer stays manual",
        off,
        both(manual, switch(ami=Ami.SKIDPAD)),
        5.2,
        R,
        "status_not_selected",
        10 * S,
        0,
    ),
    End(
        "RUNNING too early",
        off,
        both(say(0x510, mission_status=MissionStatus.RUNNING), switch(ami=Ami.SKIDPAD)),
        5.2,
        R,
        "status_running",
    ),
    End(
        "FINISHED still",
        off,
        both(say(0x510, mission_status=MissionStatus.FINISHED), switch(ami=Ami.SKIDPAD)),
        5.2,
        R,
        "status_finished",
    ),
    End("ESTOP_REQUEST is latched", off, both(operator, switch(ami=Ami.SKIDPAD)), 5.2, R, "estop_latched"),
    End(
        "an E-stop button is pressed",
        off,
        both(switch(car_estop=True), switch(ami=Ami.SKIDPAD)),
        5.2,
        R,
        "ts_not_running",
    ),
    End("an EBS fault in AS_OFF", off, switch(ebs_fault=True, ami=Ami.SKIDPAD), 5.2, R, "fault"),
    End("no power cycle after an emergency", ready, run_and_forget, 5.2, R, "power_cycle", 0, 17 * S),
    # ---- refusals to drive
    End("Go after 2 s", ready, go_after(1.5), 1.0, R, "go_too_early", 0, 0),
    End("Go is never given", ready, lambda run: None, 5.8, R, "no_go", 0, 0),
    End("Go is on from before", off, switch(go=True, ami=Ami.SKIDPAD), 8.0, R, "go_held"),
    End("torque in AS_READY", ready, go_after(5.0, say(0x512, torque_nm=20.0)), 0.5, R, "torque_requested"),
    End("steering in AS_READY", ready, go_after(5.0, say(0x513, steer_deg=3.0)), 0.5, R, "steering_requested"),
    End("the wheels are turned", ready, go_after(5.0, sense(turned)), 0.5, R, "steering_turned"),
    End(
        "FORWARD in AS_READY",
        ready,
        go_after(5.0, say(0x510, direction=Direction.FORWARD)),
        0.5,
        R,
        "direction_not_neutral",
    ),
    End("ASMS off in AS_READY", ready, switch(asms=False), 0.5, R, "given_up"),
]


@pytest.mark.parametrize("end", ENDS, ids=lambda end: end.name)
def test_the_action_on_the_car_is_named_first_with_its_time(end: End) -> None:
    log = branch(end.run(), end.act, end.seconds)
    story = tell(log.frames)
    incidents = [incident for incident in story.incidents if incident.kind is end.kind]
    assert incidents, [(i.kind, i.what) for i in story.incidents]
    first = incidents[-1].candidates[0]
    assert first.slug == end.slug, [(c.slug, c.sureness, c.steps) for c in incidents[-1].candidates]
    if end.before_ns or end.after_ns:
        apart_ms = (first.t_ns - log.injected_ns) / 1e6
        assert -end.before_ns / 1e6 <= apart_ms <= end.after_ns / 1e6, first.steps
    if end.also:
        assert end.also in [one.slug for one in incidents[-1].candidates]
    assert not story.clean
