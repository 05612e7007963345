"""What is done to the car is what explain names first, with its time: each end brought about in the simulated car."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import pytest
from msgspec.structs import replace
from story_runs import Act, Run, branch, driving, off, parked, ready, tell

from fsai_hil.simulator.car_signals import Actuation, CarFeedback
from fsai_hil.simulator.faults import Drop, FrameFault, Freeze, WrongLength, WrongValues
from fsai_vcu.diagnostics.explain import IncidentKind, Record, explained
from fsai_vcu.interface.enums import Ami, Direction, EbsState
from fsai_vcu.interface.enums import MissionStatus as Status
from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.reserved import AI_IDS
from fsai_vcu.interface.units import MS, S


@dataclass(frozen=True)
class End:
    """One thing that goes wrong. `near_ns`: how far before and behind it the first step of the chain may lie."""

    name: str
    run: Callable[[], Run]
    act: Act
    slug: str
    kind: IncidentKind = IncidentKind.EMERGENCY
    seconds: float = 0.2
    near_ns: tuple[int, int] = (15 * MS, 15 * MS)
    also: str = ""


def refusal(name: str, run: Callable[[], Run], act: Act, slug: str, **others: Any) -> End:
    """A car that does not start; where nothing else is named, for as long as it has to be waited for."""
    return End(name, run, act, slug, IncidentKind.REFUSAL, **{"seconds": 5.2, **others})


def switch(**values: object) -> Act:
    return lambda run: run.switch(**values)


def spoil(*faults: FrameFault) -> Act:
    return lambda run: run.spoil(*faults)


def drop(*ids: int) -> Act:
    return spoil(Drop(frozenset(ids)))


def say(can_id: int, **values: object) -> Act:
    return lambda run: run.spoil(WrongValues(frozenset({can_id}), run.lockstep.world.codec, values))


def says(**values: object) -> Act:
    """In the AI computer's 0x510."""
    return say(0x510, **values)


def mission(status: Status) -> Act:
    return says(mission_status=status)


def car_drops(*ids: int) -> Act:
    return lambda run: run.lockstep.world.vcu.outgoing.faults.append(Drop(frozenset(ids)))


def car_says(**values: object) -> Act:
    """In 0x520."""

    def act(run: Run) -> None:
        vcu = run.lockstep.world.vcu
        vcu.outgoing.faults.append(WrongValues(frozenset({0x520}), run.lockstep.world.codec, values))

    return act


def car_is_silent_for_300_ms(run: Run) -> None:
    wire, silence = run.lockstep.world.vcu.outgoing, Drop(frozenset({0x520, 0x181}))
    wire.faults.append(silence)
    run.go_on(0.3)
    wire.faults.remove(silence)


def status_repeats_itself_for_400_ms(run: Run) -> None:
    wire, repeats = run.lockstep.world.vcu.outgoing, Freeze(frozenset({0x520}))
    wire.faults.append(repeats)
    run.go_on(0.4)
    wire.faults.remove(repeats)


def remote_falls_silent(run: Run) -> None:
    car_drops(0x181)(run)
    run.go_on(0.12)
    run.switch(remote_radio_ok=False)


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


def kill_bridge(run: Run) -> None:
    run.lockstep.computer.kill_bridge()


def hang_for_80_ms(run: Run) -> None:
    run.lockstep.computer.hang_bridge(run.now_ns + 80 * MS)


def nothing(run: Run) -> None:
    """The run goes on as it was."""


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
    return switch(**{"lvms": True, "asms": True, "tsms": True, "ami": Ami.AUTONOMOUS_DEMO, **switches})


def manual(run: Run) -> None:
    assert run.lockstep.bridge.set_mode("manual", run.now_ns)[0]


def operator(run: Run) -> None:
    assert run.lockstep.bridge.emergency_brake("somebody at the laptop", run.now_ns)[0]


def turned(feedback: CarFeedback) -> CarFeedback:
    return replace(feedback, steer_deg=feedback.steer_deg + 8.0)


def spinning(feedback: CarFeedback) -> CarFeedback:
    fl, fr, rl, rr = feedback.wheel_rpm
    return replace(feedback, wheel_rpm=(1.5 * fl + 100.0, fr, rl, rr))


def creeping(feedback: CarFeedback) -> CarFeedback:
    fl, fr, rl, rr = feedback.wheel_rpm
    return replace(feedback, wheel_rpm=(fl + 18.0, fr, rl, rr))


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


A, P = IncidentKind.ABORT, IncidentKind.STOP
EDGE = 60 * MS  # an AI computer's gate moves in cycles
EDGES, SECOND = (25 * MS, 25 * MS), (1 * S, 1 * S)
demo, forward = switch(ami=Ami.AUTONOMOUS_DEMO), says(direction=Direction.FORWARD)
brake_alone = both(say(0x512, torque_nm=0.0), say(0x511, torque_nm=0.0), say(0x514, front_pct=10.0))

ENDS = [
    # ---- what people do
    End("an E-stop button on the car", driving, switch(car_estop=True), "sdc_open"),
    End("the remote's E-stop", driving, switch(remote_estop=True), "remote_estop"),
    End("the dongle is pulled", driving, switch(dongle=False), "sdc_open"),
    End("the crash sensor", driving, switch(crash=True), "sdc_open"),
    End("the remote's radio is lost", driving, switch(remote_radio_ok=False), "radio_lost"),
    End("the remote's receiver falls silent", driving, remote_falls_silent, "radio_lost"),
    End("Go off", driving, switch(go=False), "go_off"),
    End("ASMS off", driving, switch(asms=False), "asms_off"),
    End("TSMS off", driving, switch(tsms=False), "tsms_off"),
    End("an E-stop button in AS_READY", ready, switch(car_estop=True), "sdc_open"),
    End("the operator's emergency brake", driving, operator, "not_on_the_bus"),
    # ---- what breaks in the car
    End("the interlock opens", driving, switch(hvil_open=True), "hvil_open"),
    End("the interlock is shorted", driving, switch(hvil_short=True), "hvil_short"),
    End("EBS fault", driving, switch(ebs_fault=True), "ebs_fault"),
    End("EBS fault of a 2021 car", car_2021, switch(ebs_fault=True), "ebs_fault"),
    End("charger fault", driving, switch(offboard_charger_fault=True), "offboard_charger"),
    End("charge procedure fault", driving, switch(charge_procedure_fault=True), "charge_procedure"),
    End("BMS fault", driving, switch(bms_fault=True), "bms"),
    End("the VCU reboots", driving, reboot, "vcu_reboot", A, seconds=3.0),
    End("the car is switched off", driving, switch(lvms=False), "power_off", A, seconds=3.0),
    # ---- what the AI computer says
    End("FINISHED while moving", driving, mission(Status.FINISHED), "finished_while_moving"),
    End("NEUTRAL while moving", driving, says(direction=Direction.NEUTRAL), "neutral_while_moving"),
    End("torque with brake", driving, say(0x514, front_pct=20.0), "torque_with_brake"),
    # ---- the link
    *(End(f"0x{can_id:03X} is missing", driving, drop(can_id), "ai_message_missing") for can_id in AI_IDS),
    End("0x513 is missing, 2021", car_2021, drop(0x513), "ai_message_missing"),
    End("0x512 has a wrong length", driving, spoil(WrongLength(frozenset({0x512}), 3)), "ai_message_length"),
    End("the bridge is killed", driving, kill_bridge, "ai_silent"),
    End("the bridge is killed in AS_READY", ready, kill_bridge, "ai_silent"),
    End("bus-off", driving, bus_off, "ai_bus_off"),
    End("the echo is frozen", driving, spoil(Freeze(frozenset({0x510}))), "handshake_lost", near_ns=EDGES),
    End("the VCU does not hear 0x514", driving, vcu_misses(0x514), "ai_unheard", near_ns=(0, 130 * MS)),
    End("0x520 repeats itself", driving, status_repeats_itself_for_400_ms, "status_frozen", near_ns=EDGES),
    # ---- what the AI side supervises
    End("an intruder", driving, intrude, "intruder"),
    End("0x520 is missing", driving, car_drops(0x520), "vcu_silent", A, seconds=1.0),
    End("0x520 is missing for 0.3 s", driving, car_is_silent_for_300_ms, "vcu_silent", seconds=0.7),
    End("wheel speeds are missing", driving, car_drops(0x525), "wheels_stale", seconds=1.0),
    End("steering feedback is missing", driving, car_drops(0x523), "steering_stale", seconds=1.0),
    End("the steering is elsewhere", driving, sense(turned), "steering_implausible", seconds=1.2, near_ns=(0, 60 * MS)),
    End("one wheel does not fit the others", driving, sense(spinning), "wheel_implausible", seconds=1.2),
    End("the loop hangs for 80 ms", driving, hang_for_80_ms, "loop_fault"),
    End("the brake does not work", driving, brakeless, "stop_ineffective", seconds=3.0, near_ns=(0, 400 * MS)),
    End(
        "one wheel never stands",
        driving,
        both(sense(creeping), silent_controller),
        "wheel_implausible",
        seconds=5.0,
        near_ns=(0, 400 * MS),
    ),
    End("the controller falls silent", driving, silent_controller, "command_stale", P, seconds=3.0, near_ns=EDGES),
    End("the planner falls silent", driving, silent_planner, "command_stale", P, seconds=4.0, near_ns=(0, 600 * MS)),
    End("manual while driving", driving, manual, "stop_asked", P, seconds=3.0, near_ns=(0, EDGE)),
    End("EBS_STATE becomes FAULT", driving, car_says(ebs_state=EbsState.EBS_FAULT), "state_fault", P, seconds=3.0),
    End("the AMI is turned", driving, switch(ami=Ami.SKIDPAD), "ami_changed", P, seconds=3.0),
    End("AMI_STATE becomes none", driving, car_says(ami=Ami.NOT_SELECTED), "ami_changed", P, seconds=3.0),
    # ---- the official simulator
    End("simulator: a brake is asked for", simulator, brake_alone, "brake_request_simulator"),
    End("simulator: ASMS off", simulator, switch(asms=False), "asms_off", A, seconds=0.5),
    End("simulator: NOT_SELECTED", simulator, mission(Status.NOT_SELECTED), "not_selected_simulator", A, seconds=0.5),
    End("simulator: 0x512 is missing", simulator, drop(0x512), "ai_message_missing"),
    # ---- refusals to get ready
    refusal("ASMS stays off", parked, up(asms=False), "asms", seconds=6.5, near_ns=(0, 1 * S)),
    refusal("TSMS stays off", parked, up(tsms=False), "tsms", seconds=6.5, near_ns=(0, 1 * S)),
    refusal("nobody sends AI data", parked, both(drop(*AI_IDS), up()), "no_ai_data", seconds=6.5, near_ns=SECOND),
    refusal("0x514 never comes", parked, both(drop(0x514), up()), "ai_data_incomplete", seconds=6.5, near_ns=SECOND),
    refusal("no mission", off, nothing, "no_mission", near_ns=(10 * S, 0)),
    refusal("the AI computer stays manual", off, both(manual, demo), "status_not_selected", near_ns=(10 * S, 0)),
    refusal("RUNNING too early", off, both(mission(Status.RUNNING), demo), "status_running"),
    refusal("FINISHED still", off, both(mission(Status.FINISHED), demo), "status_finished"),
    refusal("ESTOP_REQUEST is latched", off, both(operator, demo), "estop_latched"),
    refusal("an E-stop button is pressed", off, both(switch(car_estop=True), demo), "ts_not_running"),
    refusal("an EBS fault in AS_OFF", off, switch(ebs_fault=True, ami=Ami.AUTONOMOUS_DEMO), "ebs_fault"),
    refusal("no power cycle after an emergency", ready, run_and_forget, "power_cycle", near_ns=(0, 17 * S)),
    # ---- refusals to drive
    refusal("Go after 2 s", ready, go_after(1.5), "go_too_early", seconds=1.0, near_ns=(0, 0)),
    refusal("Go is never given", ready, nothing, "no_go", seconds=5.8, near_ns=(0, 0)),
    refusal("Go is on from before", off, switch(go=True, ami=Ami.AUTONOMOUS_DEMO), "go_held", seconds=8.0),
    refusal("torque in AS_READY", ready, go_after(5.0, say(0x512, torque_nm=20.0)), "torque_requested", seconds=0.5),
    refusal("steering in AS_READY", ready, go_after(5.0, say(0x513, steer_deg=3.0)), "steering_requested", seconds=0.5),
    refusal("the wheels are turned", ready, go_after(5.0, sense(turned)), "steering_turned", seconds=0.5),
    refusal("FORWARD in AS_READY", ready, go_after(5.0, forward), "direction_not_neutral", seconds=0.5),
    refusal("ASMS off in AS_READY", ready, switch(asms=False), "given_up", seconds=0.5),
]


# What another end of the same cause shows in short: each drives on for a while.
REPEATED = {f"0x{can_id:03X} is missing" for can_id in AI_IDS[1:]} | {
    "0x513 is missing, 2021",
    "EBS fault of a 2021 car",
}


@pytest.mark.parametrize(
    "end",
    [pytest.param(end, marks=pytest.mark.long) if end.name in REPEATED else end for end in ENDS],
    ids=lambda end: end.name,
)
def test_the_action_on_the_car_is_named_first_with_its_time(end: End) -> None:
    log = branch(end.run(), end.act, end.seconds)
    story = tell(log.frames)
    incidents = [incident for incident in story.incidents if incident.kind is end.kind]
    assert incidents, [(i.kind, i.what) for i in story.incidents]
    first = incidents[-1].candidates[0]
    assert first.slug == end.slug, [(c.slug, c.sureness, c.steps) for c in incidents[-1].candidates]
    if any(end.near_ns):
        assert -end.near_ns[0] <= first.t_ns - log.injected_ns <= end.near_ns[1], first.steps
    if end.also:
        assert end.also in [one.slug for one in incidents[-1].candidates]
    assert not story.clean


def test_what_stops_the_car_is_not_told_as_a_mismatch_too() -> None:
    stopped = branch(driving(), sense(spinning), 1.2).frames
    assert [incident.kind for incident in tell(stopped).incidents] == [IncidentKind.EMERGENCY]


def test_a_service_brake_before_the_emergency_brake_is_told() -> None:
    story = explained(Record(branch(driving(), sense(turned), 2.0).frames))
    (incident,) = story.incidents
    words = [step.words for step in incident.candidates[0].steps]
    braked = next(at for at, each in enumerate(words) if "the brake goes to 80 %" in each)
    assert "implausible" in words[braked - 1] and "ESTOP_REQUEST" in words[braked + 1]
    assert any("the brake goes to 80 %" in event.text for event in story.events), "in the timeline too"
