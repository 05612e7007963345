"""The AS supervisor, held to the safety rules: pure steps, with the clock at T - 1 ns and at T."""

from __future__ import annotations

from functools import cache
from typing import Any

import pytest
from msgspec.structs import fields, replace

from fsai_vcu.core.command import VehicleCommand
from fsai_vcu.core.supervision import gate, plausibility, readiness, start_conditions, supervisor, wheel_speeds
from fsai_vcu.core.supervision.config import BridgeConfig, Reason, official_simulator, words_of
from fsai_vcu.core.supervision.supervisor import (
    OUTPUT,
    REACTIONS,
    Asked,
    Brake,
    Consequence,
    Decision,
    Inputs,
    Latch,
    Mode,
    Phase,
    Sequence,
    Steer,
    Step,
    SupervisorState,
    supervise,
)
from fsai_vcu.interface.enums import Ami, AsState, Direction, MissionStatus
from fsai_vcu.interface.messages import VcuStatus, WheelSpeeds
from fsai_vcu.interface.units import MS, S
from fsai_vcu.interface.values import Value

CONFIG = BridgeConfig()
T0 = 1000 * S  # an arbitrary instant of the monotonic clock

OFF, READY, DRIVING = AsState.AS_OFF, AsState.AS_READY, AsState.AS_DRIVING
INIT, EMERGENCY, FINISHED = AsState.AS_INIT, AsState.EMERGENCY_BRAKE, AsState.AS_FINISHED


def receive(state: SupervisorState, as_state: AsState, t_ns: int, **changes: Any) -> SupervisorState:
    """A 0x520 of this AS state."""
    values: dict[str, Any] = {"ami": Ami.TRACKDRIVE, "go_signal": as_state is DRIVING, **changes}
    return supervisor.on_status(CONFIG, state, VcuStatus(as_state=as_state, t_rx_ns=t_ns, **values))


def doubted(state: SupervisorState, t_ns: int) -> SupervisorState:
    """A 0x520 that is not believed."""
    return supervisor.received(CONFIG, state, t_ns)


def follow(state: SupervisorState, path: tuple[AsState, ...], t_ns: int) -> SupervisorState:
    """One 0x520 of each AS state, everybody confirms each run."""
    for as_state in path:
        state = confirmed(receive(state, as_state, t_ns))
    return state


def roll(state: SupervisorState, rpm: int, t_ns: int) -> SupervisorState:
    return supervisor.on_speeds(CONFIG, state, WheelSpeeds(rpm, rpm, rpm, rpm, t_rx_ns=t_ns))


def confirmed(state: SupervisorState) -> SupervisorState:
    for role in supervisor.ROLES:
        if role not in state.confirmed:
            state = supervisor.confirm(state, role, state.run_id)
    return state


def chosen(at_ns: int = T0) -> SupervisorState:
    """AS_OFF, mission chosen, everybody has confirmed, autonomous."""
    state, done, _ = supervisor.set_mode(CONFIG, follow(SupervisorState(), (OFF,), at_ns), "autonomous", at_ns)
    assert done
    return state


def emergency(state: SupervisorState) -> SupervisorState:
    """The operator has asked for the emergency brake."""
    return supervisor.ask_emergency(state, Asked.OPERATOR, "smoke", T0)


def manual() -> SupervisorState:
    """The same, but nobody has chosen autonomous."""
    return replace(chosen(), mode=Mode.MANUAL)


def ready(at_ns: int, state: SupervisorState | None = None, wait_ns: int = 5 * S, **changes: Any) -> SupervisorState:
    """AS_READY with Go off, and SELECTED sent, until `at_ns`."""
    begin_ns = at_ns - wait_ns
    state = chosen(begin_ns - 10 * MS) if state is None else state
    for t_ns in (*range(begin_ns, at_ns, 500 * MS), at_ns):
        state = receive(state, READY, t_ns, **changes)
    return supervisor.on_selected_sent(state, state.run_id)


LAUNCH = T0 + 10 * S
NOW = LAUNCH + 5 * S  # some time into driving


@cache
def launched() -> SupervisorState:
    """The first frame of AS_DRIVING came at `LAUNCH`, with the whole sequence seen."""
    return receive(ready(LAUNCH - 10 * MS), DRIVING, LAUNCH)


Situation = tuple[SupervisorState, Inputs]


def driving(now_ns: int = NOW, rpm: int = 200, **changes: Any) -> Situation:
    """Driving by command for a while, with everything received just now, but for what `changes` says (see `but`)."""
    state = replace(roll(launched(), rpm, now_ns), status_ns=now_ns, received_ns=now_ns)
    command = VehicleCommand(now_ns, state.run_id, throttle=0.5)
    return but((state, Inputs(now_ns, command, now_ns, steer_ns=now_ns)), **changes)


def but(situation: Situation, **changes: Any) -> Situation:
    """The same with `changes` by the names of the state's, the inputs' or the command's fields (its run: `of_run`)."""
    state, inputs = situation
    command = inputs.command
    if command is not None:
        given = {name: changes.pop(name) for name in set(changes) & COMMAND_FIELDS}
        inputs = replace(inputs, command=replace(command, **given, run_id=changes.pop("of_run", command.run_id)))
    supplied = {name: changes.pop(name) for name in set(changes) & INPUT_FIELDS}
    return replace(state, **changes), replace(inputs, **supplied)


INPUT_FIELDS = {each.name for each in fields(Inputs)}
COMMAND_FIELDS = {each.name for each in fields(VehicleCommand)} - {"run_id"}


def refreshed(situation: Situation, now_ns: int, **changes: Any) -> Situation:
    """Everything received again at `now_ns`: the tests then age one thing alone."""
    state, inputs = situation
    state = roll(replace(state, status_ns=now_ns, received_ns=now_ns), state.fastest_rpm, now_ns)
    if inputs.command is not None:
        inputs = replace(inputs, command=replace(inputs.command, t_sensor_ns=now_ns))
    return but((state, replace(inputs, now_ns=now_ns, command_ns=now_ns, steer_ns=now_ns)), **changes)


def cycle(situation: Situation) -> tuple[Situation, Decision]:
    """One cycle with the situation as it is."""
    state, decision = supervise(CONFIG, *situation)
    return (state, situation[1]), decision


def decide(state: SupervisorState, inputs: Inputs) -> Decision:
    return supervise(CONFIG, state, inputs)[1]


def phases_at(t_ns: int, situation: Situation) -> tuple[Phase, Phase]:
    """The phases 1 ns before `t_ns` and at it, everything received again."""
    before, at = (decide(*refreshed(situation, now_ns)).phase for now_ns in (t_ns - 1, t_ns))
    return before, at


# ---------------------------------------------------------------- the tables


@pytest.mark.parametrize(
    ("phase", "row"),
    [
        (Phase.IDLE, "as acknowledged, NEUTRAL, steering ZERO, brake ZERO"),
        (Phase.READY, "as acknowledged, NEUTRAL, steering ZERO, brake HOLDING"),
        (Phase.LAUNCH_WAIT, "RUNNING, FORWARD, steering ZERO, brake HOLDING"),
        (Phase.DRIVING, "RUNNING, FORWARD, steering COMMAND, brake COMMAND, torque"),
        (Phase.HOLDING, "RUNNING, FORWARD, steering HELD, brake KEPT"),
        (Phase.STOPPING, "RUNNING, FORWARD, steering HELD_OR_COMMAND, brake SERVICE"),
        (Phase.STOPPED, "FINISHED, NEUTRAL, steering HELD, brake HOLDING"),
        (Phase.ESTOP_ASKED, "RUNNING, FORWARD, steering HELD, brake SERVICE"),
        (Phase.FINISHED, "FINISHED, NEUTRAL, steering ZERO, brake HOLDING"),
        (Phase.EMERGENCY_MOVING, "RUNNING, FORWARD, steering ZERO, brake ZERO"),
        (Phase.EMERGENCY_STANDING, "RUNNING, NEUTRAL, steering ZERO, brake ZERO"),
    ],
)
def test_the_output_table_is_that_of_the_safety_rules(phase: Phase, row: str) -> None:
    out = OUTPUT[phase]
    status = "as acknowledged" if out.mission_status is None else out.mission_status.name
    torque = ", torque" if out.torque else ""
    assert f"{status}, {out.direction.name}, steering {out.steer.name}, brake {out.brake.name}{torque}" == row
    assert isinstance(out.steer, Steer) and isinstance(out.brake, Brake)
    assert len(Phase) == len(OUTPUT) == 11  # two phases with the same words would be one
    assert all(phase.value.startswith(("no AS state", *(state.label for state in AsState))) for phase in Phase)


def test_every_reason_and_request_has_a_sentence() -> None:
    assert len(Asked) == 5 and all(len(cause.value.split()) >= 4 for cause in Asked)
    assert all(words_of(reason.slug) == reason.words and len(reason.words) > 10 for reason in Reason)
    assert Reason("go_off") is Reason.GO_OFF
    assert Latch(Reason.GO_OFF, T0).words == Reason.GO_OFF.words


def test_every_reaction_gets_graver_with_time() -> None:
    assert Consequence.ESTOP > Consequence.STOP > Consequence.HOLD
    for reason, steps in REACTIONS.items():
        after = [0 if step.after is None else getattr(CONFIG, step.after) for step in steps]
        assert after == sorted(after), reason
        assert [step.consequence for step in steps] == sorted(step.consequence for step in steps), reason


def test_a_process_that_starts_knows_and_does_nothing() -> None:
    state, inputs, decision = SupervisorState(), Inputs(T0), Decision()
    assert not (state.go or state.fault or state.was_silent or state.driving or state.is_confirmed)
    assert (state.mode, state.sequence, state.mission) == (Mode.MANUAL, Sequence.NONE, Ami.NOT_SELECTED)
    assert (state.stop, state.emergency, state.fastest_rpm, state.stop_window_ns) == (None, None, 0, 0)
    assert (state.ready_waited_ns, state.selected_sent) == (0, False)
    assert (inputs.command, inputs.command_ns, inputs.steer_ns, inputs.wheel_detail) == (None, 0, None, "")
    assert not (decision.torque or decision.may_move or decision.estop)
    assert (decision.mission_status, decision.direction) == (MissionStatus.NOT_SELECTED, Direction.NEUTRAL)
    assert (decision.phase, decision.steer, decision.brake) == (Phase.IDLE, Steer.ZERO, Brake.ZERO)
    assert decision.run_id == 0 < state.run_id


@pytest.mark.parametrize(
    ("path", "phase", "mission_status"),
    [
        ((), Phase.IDLE, MissionStatus.NOT_SELECTED),
        ((INIT,), Phase.IDLE, MissionStatus.SELECTED),
        ((OFF,), Phase.IDLE, MissionStatus.SELECTED),
        ((READY,), Phase.READY, MissionStatus.SELECTED),
        ((DRIVING,), Phase.LAUNCH_WAIT, MissionStatus.RUNNING),
        ((DRIVING, FINISHED), Phase.FINISHED, MissionStatus.FINISHED),
        ((EMERGENCY,), Phase.EMERGENCY_MOVING, MissionStatus.RUNNING),
    ],
)
def test_each_as_state_is_answered_with_its_row(
    path: tuple[AsState, ...], phase: Phase, mission_status: MissionStatus
) -> None:
    begun = chosen(T0) if path in ((INIT,), (OFF,)) else ready(T0) if path else SupervisorState()
    decision = decide(follow(begun, path, T0), Inputs(T0))
    assert (decision.phase, decision.mission_status) == (phase, mission_status)
    row = OUTPUT[phase]
    assert (decision.direction, decision.steer, decision.brake) == (row.direction, row.steer, row.brake)
    assert (decision.torque, decision.estop, decision.may_move) == (False, False, False)


# ---------------------------------------------------------------- SELECTED


@pytest.mark.parametrize("as_state", [INIT, OFF, READY])
def test_selected_needs_a_mission_and_both_resets(as_state: AsState) -> None:
    """Before AS_READY it needs the autonomous mode as well, and no emergency."""
    good = receive(chosen(), as_state, T0)
    for state, sent in (
        (good, True),
        (replace(good, mission=Ami.NOT_SELECTED), False),
        (replace(good, confirmed=frozenset({"planner"})), False),
        (replace(good, confirmed=frozenset({"controller"})), False),
        (replace(good, mode=Mode.MANUAL), as_state is READY),
        (emergency(good), as_state is READY),
    ):
        assert (decide(state, Inputs(T0)).mission_status is MissionStatus.SELECTED) is sent


def test_a_reset_of_another_run_or_unknown_role_does_not_count() -> None:
    state = receive(SupervisorState(), OFF, T0)
    for role, run_id in (("planner", state.run_id - 1), ("planner", state.run_id + 1), ("driver", state.run_id)):
        assert supervisor.confirm(state, role, run_id) == state
    assert supervisor.confirm(state, "planner", state.run_id).confirmed == {"planner"}


# ---------------------------------------------------------------- runs


def test_each_ami_change_in_as_off_or_as_ready_begins_a_run() -> None:
    state = receive(SupervisorState(), OFF, T0, ami=Ami.NOT_SELECTED)
    assert (state.run_id, state.mission) == (1, Ami.NOT_SELECTED)
    for run_id, as_state, ami in ((2, OFF, Ami.SKIDPAD), (3, INIT, Ami.ACCELERATION), (4, READY, Ami.AUTOCROSS)):
        state = receive(confirmed(state), as_state, T0, ami=ami)
        assert (state.run_id, state.mission, state.confirmed) == (run_id, ami, frozenset())


@pytest.mark.parametrize("as_state", [DRIVING, EMERGENCY, FINISHED])
def test_the_ami_is_latched_from_as_driving_on(as_state: AsState) -> None:
    before = receive(launched(), as_state, LAUNCH + 10 * MS)
    state = receive(before, as_state, LAUNCH + 20 * MS, ami=Ami.ACCELERATION)
    assert (state.run_id, state.mission, state.sequence) == (before.run_id, Ami.TRACKDRIVE, before.sequence)


@pytest.mark.parametrize("before", [READY, DRIVING, EMERGENCY, FINISHED])
@pytest.mark.parametrize("off", [OFF, INIT])
def test_each_entry_into_as_off_begins_a_new_run(before: AsState, off: AsState) -> None:
    state = confirmed(receive(chosen(), before, T0))
    entered = receive(state, off, T0)
    assert (entered.run_id, entered.confirmed) == (state.run_id + 1, frozenset())
    assert receive(receive(entered, INIT, T0), OFF, T0).run_id == entered.run_id  # they count as one


def test_a_power_cycle_from_as_off_to_as_off_begins_a_new_run() -> None:
    state = receive(SupervisorState(), OFF, T0)
    assert receive(state, OFF, T0 + 1 * S - 1).run_id == state.run_id
    assert receive(state, OFF, T0 + 1 * S).run_id == state.run_id + 1


def test_started_in_as_driving_it_knows_the_mission_of_the_car() -> None:
    state = receive(SupervisorState(), DRIVING, T0, ami=Ami.SKIDPAD)
    assert (state.mission, state.run_id) == (Ami.SKIDPAD, 2)


def test_the_times_of_a_state_end_with_it() -> None:
    ready = receive(chosen(), READY, T0)
    assert (ready.ready_since_ns, ready.driving_since_ns) == (T0, None)
    assert receive(ready, READY, T0 + 1).ready_since_ns == T0
    begun = receive(ready, DRIVING, T0 + 2)
    assert (begun.ready_since_ns, begun.driving_since_ns) == (None, T0 + 2)
    assert receive(begun, DRIVING, T0 + 3).driving_since_ns == T0 + 2
    assert receive(begun, FINISHED, T0 + 3).driving_since_ns is None


# ---------------------------------------------------------------- the sequence


@pytest.mark.parametrize(
    ("path", "complete"),
    [
        ((INIT, OFF, READY, DRIVING), True),
        ((INIT, INIT, OFF, OFF, READY, READY, READY, DRIVING, DRIVING), True),
        ((OFF, READY, DRIVING, OFF, READY, DRIVING), True),
        ((OFF, READY, DRIVING, INIT, READY, DRIVING), True),
        ((DRIVING,), False),
        ((READY, DRIVING), False),
        ((OFF, DRIVING), False),
        ((OFF, READY, DRIVING, EMERGENCY, DRIVING), False),
        ((OFF, READY, DRIVING, FINISHED, DRIVING), False),
        ((OFF, READY, DRIVING, READY, DRIVING), False),
        ((OFF, READY, EMERGENCY, READY, DRIVING), False),
        ((FINISHED, READY, DRIVING), False),
    ],
)
def test_without_the_whole_sequence_the_car_is_stopped(path: tuple[AsState, ...], complete: bool) -> None:
    state = replace(follow(SupervisorState(), path, T0), mode=Mode.AUTONOMOUS)
    assert (state.sequence is Sequence.COMPLETE) == complete and state.stop is None
    (state, _), decision = cycle((state, Inputs(T0)))
    assert decision.phase is Phase.STOPPING and state.stop is not None
    assert (decision.reasons == {Reason.NOT_SEEN}) == (state.stop.cause is Reason.NOT_SEEN) == (not complete)


def test_a_power_cycle_breaks_sequence_and_stay_in_as_ready() -> None:
    assert receive(ready(T0), DRIVING, T0 + 1 * S - 1).sequence is Sequence.COMPLETE
    assert receive(ready(T0), DRIVING, T0 + 1 * S).sequence is Sequence.NONE
    for go in (False, True):
        state = receive(ready(T0), READY, T0 + 1 * S, go_signal=go)
        assert (state.sequence, state.ready_waited_ns) == (Sequence.NONE, 0)
    state = receive(launched(), DRIVING, LAUNCH + 1 * S)  # and restarts the 3 s of rest
    assert (state.sequence, state.driving_since_ns) == (Sequence.NONE, LAUNCH + 1 * S)


def test_a_bus_loss_breaks_the_sequence() -> None:
    ready = supervisor.bus_lost(CONFIG, receive(chosen(), READY, T0), "unplugged", T0)
    assert ready.stop is None
    for as_state, sequence in ((READY, Sequence.NONE), (DRIVING, Sequence.NONE), (OFF, Sequence.OFF_SEEN)):
        assert receive(ready, as_state, T0).sequence is sequence


def test_a_mission_changed_on_entering_as_driving_is_not_driven() -> None:
    state = receive(receive(chosen(), READY, T0), DRIVING, T0, ami=Ami.ACCELERATION)
    assert (state.sequence, state.mission) == (Sequence.NONE, Ami.TRACKDRIVE)


def entered(state: SupervisorState, t_ns: int, config: BridgeConfig = CONFIG, **changes: Any) -> Decision:
    """The first cycle of AS_DRIVING after `state`."""
    return supervise(config, receive(state, DRIVING, t_ns, **changes), Inputs(t_ns))[1]


SHORT = frozenset({Reason.SEQUENCE_SHORT})


@pytest.mark.parametrize(("wait_ns", "short"), [(4900 * MS - 1, True), (4900 * MS, False), (5 * S, False)])
def test_as_driving_needs_5_s_in_as_ready_less_lost_frames(wait_ns: int, short: bool) -> None:
    state = ready(T0, wait_ns=wait_ns)
    decision = entered(state, T0 + 10 * MS)
    assert (decision.phase, decision.reasons) == ((Phase.STOPPING, SHORT) if short else (Phase.LAUNCH_WAIT, set()))
    allowed = entered(state, T0 + 10 * MS, official_simulator())
    assert (allowed.phase, allowed.reasons) == (Phase.LAUNCH_WAIT, set())
    for n in range(1, 20):  # Go must come after them, however long the car stays in AS_READY with Go on
        state = receive(state, READY, T0 + n * 500 * MS, go_signal=True)
    assert (entered(state, T0 + 10 * S).reasons == SHORT) == short


def test_too_short_a_stay_in_as_ready_is_reported_in_seconds() -> None:
    for wait_ns, words in ((20 * MS, "only 0.02 s"), (375 * MS, "only 0.38 s")):
        details = dict(entered(ready(T0, wait_ns=wait_ns), T0 + 10 * MS).details)
        assert details == {Reason.SEQUENCE_SHORT: f"AS_DRIVING, but the car was in AS_READY with Go off for {words}"}


def test_a_go_that_goes_off_again_in_as_ready_counts_from_then() -> None:
    state = receive(ready(T0, wait_ns=3 * S), READY, T0 + 500 * MS, go_signal=True)
    assert entered(state, T0 + 510 * MS).reasons == SHORT
    assert entered(ready(T0 + 2 * S, state, 1 * S), T0 + 2010 * MS).reasons == frozenset()


@pytest.mark.parametrize("between", [OFF, FINISHED, EMERGENCY])
def test_each_stay_in_as_ready_counts_for_itself(between: AsState) -> None:
    state = follow(receive(ready(T0), between, T0 + 10 * MS), (OFF,), T0 + 20 * MS)
    assert entered(ready(T0 + 130 * MS, state, 100 * MS), T0 + 140 * MS).reasons == SHORT


def test_a_stay_in_as_ready_begun_with_go_has_not_waited() -> None:
    state = follow(ready(T0), (OFF,), T0 + 10 * MS)
    assert entered(ready(T0 + 10 * S, state, 9 * S, go_signal=True), T0 + 10 * S).reasons == SHORT


def test_a_drive_needs_a_mission_that_was_acknowledged() -> None:
    never_sent = replace(ready(T0), selected_sent=False)
    unchosen = replace(chosen(T0 - 5010 * MS), mission=Ami.NOT_SELECTED)
    for state, ami, words in (
        (never_sent, Ami.TRACKDRIVE, "SELECTED was not sent for TRACKDRIVE"),
        (ready(T0, unchosen, ami=Ami.NOT_SELECTED), Ami.NOT_SELECTED, "none is chosen on the AMI"),
    ):
        decision = entered(state, T0 + 10 * MS, ami=ami)
        assert (decision.phase, dict(decision.details)) == (Phase.STOPPING, {Reason.NO_MISSION: words})


def test_each_run_is_acknowledged_for_itself() -> None:
    state = ready(T0)
    assert state.selected_sent and supervisor.on_selected_sent(state, state.run_id) is state
    other = receive(state, READY, T0 + 10 * MS, ami=Ami.AUTOCROSS)
    assert other.run_id != state.run_id and not other.selected_sent
    assert not supervisor.on_selected_sent(other, state.run_id).selected_sent
    assert supervisor.on_selected_sent(other, other.run_id).selected_sent


# ---------------------------------------------------------------- standing still


def test_standing_needs_half_a_second_under_ten_rpm() -> None:
    state = roll(roll(SupervisorState(), 100, T0 - 10 * MS), 9, T0)
    for n in range(1, 6):
        state = roll(state, 9, T0 + n * 90 * MS)
    assert not supervisor.standing(CONFIG, state, T0 + 450 * MS)
    almost = roll(state, 9, T0 + 500 * MS - 1)
    assert not supervisor.standing(CONFIG, almost, T0 + 500 * MS)
    assert supervisor.standing(CONFIG, roll(state, 9, T0 + 500 * MS), T0 + 500 * MS)


def stood(now_ns: int) -> SupervisorState:
    return replace(launched(), speeds_ns=now_ns, still_since_ns=now_ns - 500 * MS, fastest_rpm=0)


@pytest.mark.parametrize("wheel", range(4))
def test_one_wheel_at_ten_rpm_is_not_standing(wheel: int) -> None:
    rpm = [10 if n == wheel else 0 for n in range(4)]
    state = supervisor.on_speeds(CONFIG, stood(NOW), WheelSpeeds(*rpm, t_rx_ns=NOW))
    assert not supervisor.standing(CONFIG, state, NOW)


def test_wheel_speeds_100_ms_old_are_not_fresh_and_prove_nothing() -> None:
    for age_ns, fresh in ((100 * MS - 1, True), (100 * MS, False)):
        assert supervisor.standing(CONFIG, stood(NOW), NOW + age_ns) is fresh
        assert supervisor.wheels_fresh(CONFIG, stood(NOW), NOW + age_ns) is fresh
    assert not supervisor.wheels_fresh(CONFIG, SupervisorState(), NOW)
    for unknown in (SupervisorState(), replace(stood(NOW), speeds_ns=None), replace(stood(NOW), still_since_ns=None)):
        assert not supervisor.standing(CONFIG, unknown, NOW)


def test_standstill_is_not_joined_across_a_gap() -> None:
    assert roll(stood(NOW), 0, NOW + 100 * MS - 1).still_since_ns == NOW - 500 * MS
    assert roll(stood(NOW), 0, NOW + 100 * MS).still_since_ns == NOW + 100 * MS


@pytest.mark.parametrize(("age_ns", "stands"), [(500 * MS - 1, False), (500 * MS, True)])
def test_a_car_whose_counts_advance_does_not_stand(age_ns: int, stands: bool) -> None:
    assert supervisor.standing(CONFIG, stood(NOW), NOW)
    state = supervisor.on_pulses(stood(NOW), NOW - age_ns)
    assert supervisor.standing(CONFIG, state, NOW) == stands
    assert supervisor.on_pulses(state, NOW - age_ns) is state


# ---------------------------------------------------------------- launch and command


@pytest.mark.parametrize(
    ("after_ns", "phase", "may_move"),
    [(3 * S - 1, Phase.LAUNCH_WAIT, False), (3 * S, Phase.DRIVING, True), (5 * S, Phase.DRIVING, True)],
)
def test_the_car_must_not_move_for_three_seconds(after_ns: int, phase: Phase, may_move: bool) -> None:
    decision = decide(*driving(LAUNCH + after_ns))
    assert (decision.phase, decision.may_move, decision.torque) == (phase, may_move, may_move)
    assert decision.reasons == frozenset()
    assert not may_move or (decision.steer, decision.brake) == (Steer.COMMAND, Brake.COMMAND)
    finished = decide(*driving(LAUNCH + after_ns, mission_finished=True))  # a mission is not done before it may begin
    assert (finished.phase is Phase.STOPPING) is may_move


@pytest.mark.parametrize(
    ("after_ns", "phase"), [(0, Phase.HOLDING), (300 * MS - 1, Phase.HOLDING), (300 * MS, Phase.STOPPING)]
)
@pytest.mark.parametrize("lack", [{"command": None}, {"of_run": 1}, {"command_ns": LAUNCH + 1 * S}])
def test_a_command_missing_before_3_s_is_missing_from_3_s_on(after_ns: int, phase: Phase, lack: dict[str, Any]) -> None:
    """None at all, one of another run, or one lost before."""
    (state, _), decision = cycle(driving(LAUNCH + 3 * S + after_ns, **lack))
    assert decision.phase is phase
    assert (state.mode is Mode.MANUAL) is (phase is Phase.STOPPING)


@pytest.mark.parametrize(
    ("valid", "invalid"),
    [
        ({"command_ns": NOW - 100 * MS + 1}, {"command_ns": NOW - 100 * MS}),
        ({"t_sensor_ns": NOW - 500 * MS + 1}, {"t_sensor_ns": NOW - 500 * MS}),
        ({}, {"of_run": 1}),
        ({}, {"mode": Mode.MANUAL}),
    ],
)
def test_a_command_that_is_not_valid_any_more_asks_for_nothing(valid: dict[str, Any], invalid: dict[str, Any]) -> None:
    """It is 100 ms old, its data are 500 ms old, it is of another run, or the mode is manual."""
    for changes, obeyed in ((valid, True), (invalid, False)):
        assert decide(*driving(estop_request=True, **changes)).estop is obeyed
        (state, _), _ = cycle(driving(mission_finished=True, **changes))
        assert (state.stop is not None and state.stop.cause is Asked.MISSION_DONE) is obeyed


# ---------------------------------------------------------------- modes


@pytest.mark.parametrize("as_state", list(AsState))
def test_modes_are_accepted_or_refused_by_as_state(as_state: AsState) -> None:
    before = receive(SupervisorState(), as_state, T0)
    state, done, message = supervisor.set_mode(CONFIG, before, "autonomous", T0)
    if as_state in (INIT, OFF, READY):
        assert (done, message, state.mode) == (True, "mode is autonomous", Mode.AUTONOMOUS)
        at_power_up = supervisor.set_mode(CONFIG, replace(before, power_up=True), "autonomous", T0)[0]
        assert not at_power_up.power_up, "a person has chosen"
    else:
        assert (done, state) == (False, before)
        assert message == f"autonomous refused in {as_state.label}: accepted in AS_INIT, AS_OFF and AS_READY only"
    autonomous = replace(before, mode=Mode.AUTONOMOUS)
    state, done, message = supervisor.set_mode(CONFIG, autonomous, "autonomous", T0)
    assert (done, message, state) == (True, "mode is autonomous already", replace(autonomous, power_up=False))
    state, done, message = supervisor.set_mode(CONFIG, autonomous, "manual", T0 + 99 * S)
    assert done and state.mode is Mode.MANUAL
    assert message == ("mode is manual: the car is being stopped" if as_state is DRIVING else "mode is manual")


STOP = Latch(Asked.MANUAL, T0)
STOPPED = f"but the car is being stopped because {STOP.words}"
LATCHED = "but the emergency brake is latched because the emergency brake was asked for: smoke"


@pytest.mark.parametrize(
    ("state", "after_ns", "mode", "config", "done", "words"),
    [
        (SupervisorState(), 0, "autonomous", CONFIG, False, "(no 0x520)"),
        (manual(), 100 * MS - 1, "autonomous", CONFIG, True, "mode is autonomous"),
        (manual(), 100 * MS, "autonomous", CONFIG, False, "is silent: the last 0x520 (AS_OFF) is 0.1 s old"),
        (chosen(), 100 * MS, "autonomous", CONFIG, True, "mode is autonomous already"),
        (chosen(), 0, "autonomous", BridgeConfig(listen_only=True), False, "only listens (listen_only)"),
        (chosen(), 0, "auto", CONFIG, False, "unknown mode 'auto': the modes are manual, autonomous"),
        (replace(chosen(), stop=STOP), 0, "autonomous", CONFIG, True, f"mode is autonomous already, {STOPPED}"),
        *(
            (emergency(state), 0, "autonomous", CONFIG, True, LATCHED)
            for state in (manual(), chosen(), replace(chosen(), stop=STOP))
        ),
    ],
)
def test_the_answer_to_a_mode_says_what_stands_against_it(
    state: SupervisorState, after_ns: int, mode: str, config: BridgeConfig, done: bool, words: str
) -> None:
    after, accepted, message = supervisor.set_mode(config, state, mode, T0 + after_ns)
    assert accepted is done and message.endswith(words)
    assert done or after is state


def test_manual_while_driving_is_a_controlled_stop_and_no_fault() -> None:
    for changes in ({}, {"command_ns": NOW - 300 * MS}):  # though the command be lost
        (state, _), decision = cycle(driving(mode=Mode.MANUAL, **changes))
        assert (decision.phase, decision.reasons, decision.estop) == (Phase.STOPPING, frozenset(), False)
        assert state.stop is not None and state.stop.words == "manual mode was asked for"
        assert decision.steer is Steer.HELD  # the planner's commands no longer reach the car


def test_the_mode_survives_as_finished_and_a_power_cycle() -> None:
    state = receive(launched(), FINISHED, LAUNCH)
    assert state.mode is receive(state, OFF, LAUNCH + 60 * S).mode is Mode.AUTONOMOUS


# ---------------------------------------------------------------- autonomous at power-up

POWER_UP = BridgeConfig(autonomous_at_power_up=True)


def at_rest(as_state: AsState, t_ns: int, config: BridgeConfig = POWER_UP, **changes: Any) -> SupervisorState:
    """After a cycle in this AS state with the car known to stand."""
    state = receive(SupervisorState(), as_state, t_ns)
    state = replace(state, **{"speeds_ns": t_ns, "still_since_ns": t_ns - 500 * MS, **changes})
    return supervise(config, state, Inputs(t_ns))[0]


@pytest.mark.parametrize("as_state", list(AsState))
def test_autonomous_at_power_up_waits_for_standstill_in_as_off(as_state: AsState) -> None:
    assert (at_rest(as_state, T0).mode is Mode.AUTONOMOUS) is (as_state in (INIT, OFF))
    assert at_rest(as_state, T0, still_since_ns=T0 - 500 * MS + 1).mode is Mode.MANUAL
    for config in (CONFIG, BridgeConfig(autonomous_at_power_up=True, listen_only=True)):
        assert at_rest(as_state, T0, config).mode is Mode.MANUAL


@pytest.mark.parametrize("lost_by", ["a request", "an early request", "itself", "itself, chosen by a person"])
def test_a_lost_mode_returns_only_at_the_next_power_up(lost_by: str) -> None:
    state = at_rest(OFF, T0, CONFIG if lost_by == "an early request" else POWER_UP)
    if lost_by == "itself, chosen by a person":
        state, _, _ = supervisor.set_mode(POWER_UP, replace(state, power_up=True), "autonomous", T0)
    if "itself" in lost_by:  # as the loss of a command does
        state = replace(state, mode=Mode.MANUAL)
    else:
        state, _, _ = supervisor.set_mode(POWER_UP, state, "manual", T0)
    assert supervise(POWER_UP, state, Inputs(T0))[0].mode is Mode.MANUAL
    for t_ns, mode in ((T0 + S - 1, Mode.MANUAL), (T0 + S, Mode.AUTONOMOUS)):  # a power cycle takes a second
        later = replace(receive(state, OFF, t_ns), speeds_ns=t_ns)
        assert supervise(POWER_UP, later, Inputs(t_ns))[0].mode is mode


# ---------------------------------------------------------------- the emergency latch


def latched(as_state: AsState) -> SupervisorState:
    return receive(emergency(chosen()), as_state, T0)


@pytest.mark.parametrize("as_state", list(AsState))
def test_an_emergency_is_sent_in_every_as_state_and_reset_in_off(as_state: AsState) -> None:
    before = latched(as_state)
    assert decide(before, Inputs(T0)).estop
    state, done, message = supervisor.reset(CONFIG, before, T0)
    if as_state in (INIT, OFF):
        assert done and state.emergency is None
        assert message == "cleared the emergency brake latched because the emergency brake was asked for: smoke"
        assert supervisor.reset(CONFIG, state, T0) == (state, True, "nothing was latched")
    else:
        assert (done, state) == (False, before)
        assert message == f"reset refused in {as_state.label}: accepted in AS_INIT and AS_OFF only"


def test_the_first_cause_of_an_emergency_stays() -> None:
    state = supervisor.ask_emergency(latched(OFF), Reason.INTRUDER, "0x512", T0)
    assert state.emergency is not None and state.emergency.words == "the emergency brake was asked for: smoke"


def test_reset_is_refused_while_nobody_knows_the_as_state() -> None:
    assert not supervisor.reset(CONFIG, latched(OFF), T0 + 100 * MS)[1]
    assert supervisor.reset(CONFIG, SupervisorState(), T0)[1:] == (
        False,
        "reset refused: the car has not reported its AS state yet (no 0x520)",
    )


@pytest.mark.parametrize(
    ("as_state", "silence_ns", "cleared"),
    [(OFF, 1 * S - 1, False), *((each, 1 * S, each in (INIT, OFF)) for each in AsState)],
)
def test_the_cars_own_power_cycle_clears_the_emergency(as_state: AsState, silence_ns: int, cleared: bool) -> None:
    state = receive(latched(EMERGENCY), as_state, T0 + silence_ns)
    assert (state.emergency is None) is cleared
    assert (receive(state, OFF, T0 + silence_ns).emergency is None) is cleared  # only at the end of the silence


@pytest.mark.parametrize(
    ("doubted_ms", "cleared"),
    [
        ([600, 1200], False),  # 0x520 of any content is no silence
        ([2000, 2010], True),  # a silence is remembered past frames that are not believed
    ],
)
def test_a_0x520_not_believed_is_heard_but_clears_nothing(doubted_ms: list[int], cleared: bool) -> None:
    state = latched(EMERGENCY)
    for ms in doubted_ms:
        state = doubted(state, T0 + ms * MS)
    assert state.emergency is not None and state.was_silent is cleared
    state = receive(state, OFF, T0 + doubted_ms[-1] * MS + 10 * MS)
    assert (state.emergency is None) is cleared
    assert not state.was_silent, "the power cycle is over with the first believed status"


def test_the_first_0x520_ever_is_no_power_cycle() -> None:
    assert receive(emergency(SupervisorState()), OFF, T0).emergency is not None


def test_in_as_driving_an_emergency_brakes_as_well() -> None:
    situation = driving(emergency=Latch(Asked.OPERATOR, NOW))
    assert decide(*situation).phase is decide(*but(situation, stop=Latch(Asked.MANUAL, NOW))).phase is Phase.ESTOP_ASKED


def test_in_emergency_brake_neutral_waits_for_standstill() -> None:
    state = receive(stood(NOW), EMERGENCY, NOW)
    assert decide(state, Inputs(NOW)).phase is Phase.EMERGENCY_STANDING
    assert decide(roll(state, 10, NOW), Inputs(NOW)).phase is Phase.EMERGENCY_MOVING


# ---------------------------------------------------------------- graded reactions


FEEDBACK = {100 * MS: Phase.STOPPING, 300 * MS: Phase.ESTOP_ASKED}
IMPLAUSIBLE = {300 * MS: Phase.STOPPING, 600 * MS: Phase.ESTOP_ASKED}


@pytest.mark.parametrize(
    ("reason", "name", "steps"),
    [
        (Reason.COMMAND_STALE, "command_ns", {100 * MS: Phase.HOLDING, 300 * MS: Phase.STOPPING}),
        (Reason.COMMAND_STALE, "t_sensor_ns", {500 * MS: Phase.HOLDING, 700 * MS: Phase.STOPPING}),
        (Reason.VCU_SILENT, "status_ns", {50 * MS: Phase.HOLDING, 100 * MS: Phase.ESTOP_ASKED}),
        (Reason.WHEELS_STALE, "speeds_ns", FEEDBACK),
        (Reason.STEERING_STALE, "steer_ns", FEEDBACK),
        (Reason.STEERING_IMPLAUSIBLE, "steer_implausible_since_ns", IMPLAUSIBLE),
        (Reason.WHEEL_IMPLAUSIBLE, "wheel_implausible_since_ns", IMPLAUSIBLE),
    ],
)
def test_what_ages_is_answered_in_its_time(reason: Reason, name: str, steps: dict[int, Phase]) -> None:
    before = Phase.DRIVING
    for age_ns, phase in steps.items():
        assert decide(*driving(**{name: NOW - age_ns + 1})).phase is before
        (state, _), decision = cycle(driving(**{name: NOW - age_ns}))
        assert (decision.phase, decision.reasons) == (phase, {reason})
        latch = {Phase.HOLDING: None, Phase.STOPPING: state.stop, Phase.ESTOP_ASKED: state.emergency}[phase]
        assert (None if latch is None else latch.cause) is (None if phase is Phase.HOLDING else reason)
        # Only a command that is lost makes the mode manual; what is fresh again ends nothing that latched.
        lost = reason is Reason.COMMAND_STALE and phase is Phase.STOPPING
        assert state.mode is (Mode.MANUAL if lost else Mode.AUTONOMOUS)
        fresh = decide(*refreshed((state, driving()[1]), NOW))
        assert fresh.phase is (Phase.DRIVING if phase is Phase.HOLDING else phase)
        before = phase


@pytest.mark.parametrize("as_state", [INIT, OFF, READY, FINISHED, EMERGENCY])
def test_outside_as_driving_a_silent_car_latches_nothing(as_state: AsState) -> None:
    for begun in (chosen(), launched()):
        (after, _), decision = cycle((receive(begun, as_state, T0), Inputs(T0 + 5 * S)))
        assert (after.emergency, after.stop, decision.estop, decision.reasons) == (None, None, False, frozenset())
        assert not decision.may_move


@pytest.mark.parametrize("name", ["speeds_ns", "steer_ns"])
def test_feedback_never_received_is_an_emergency_once_supervised(name: str) -> None:
    for after_ns, phase in ((3 * S - 1, Phase.LAUNCH_WAIT), (3 * S, Phase.ESTOP_ASKED)):
        assert decide(*driving(LAUNCH + after_ns, **{name: None})).phase is phase


def on_data(age_ns: int, at_ns: int, situation: Situation) -> Situation:
    """A command has just come, its data are `age_ns` old, and everything else is fresh."""
    return refreshed(situation, at_ns, t_sensor_ns=at_ns - age_ns)


@pytest.mark.parametrize("data_ns", [500 * MS, 600 * MS, 699 * MS])
def test_commands_on_old_data_end_the_drive_after_300_ms(data_ns: int) -> None:
    situation, decision = cycle(on_data(data_ns, NOW, driving()))
    assert (decision.phase, decision.reasons) == (Phase.HOLDING, {Reason.COMMAND_STALE})
    for after_ns in (*range(10 * MS, 300 * MS, 10 * MS), 300 * MS - 1):
        situation, decision = cycle(on_data(data_ns, NOW + after_ns, situation))
        assert decision.phase is Phase.HOLDING
    (state, _), decision = cycle(on_data(data_ns, NOW + 300 * MS, situation))
    assert (decision.phase, state.mode) == (Phase.STOPPING, Mode.MANUAL)
    assert state.stop is not None and state.stop.cause is Reason.COMMAND_STALE
    assert "the data behind them is" in state.stop.detail


def test_old_data_count_anew_after_a_command_on_fresh_data() -> None:
    situation, _ = cycle(on_data(600 * MS, NOW, driving()))
    situation, decision = cycle(on_data(500 * MS - 1, NOW + 290 * MS, situation))
    assert decision.phase is Phase.DRIVING
    situation, _ = cycle(on_data(600 * MS, NOW + 300 * MS, situation))
    assert decide(*on_data(600 * MS, NOW + 600 * MS - 1, situation)).phase is Phase.HOLDING
    assert decide(*on_data(600 * MS, NOW + 600 * MS, situation)).phase is Phase.STOPPING


@pytest.mark.parametrize("age_ns", [0, 49 * MS])
def test_an_unknown_as_state_takes_torque_away_at_once(age_ns: int) -> None:
    doubt = "AS_STATE 9 is not in the interface's table"
    state, inputs = driving(status_ns=NOW - age_ns, status_doubt=doubt)
    (after, _), decision = cycle((doubted(state, NOW), inputs))
    assert (decision.phase, dict(decision.details)) == (Phase.HOLDING, {Reason.AS_STATE_UNKNOWN: doubt})
    assert after.stop is None and after.emergency is None
    state, inputs = driving(status_ns=NOW - age_ns)
    assert dict(decide(doubted(state, NOW), inputs).details) == {Reason.AS_STATE_UNKNOWN: ""}, "no doubt has no words"


def test_torque_returns_after_100_ms_of_known_as_states() -> None:
    state, inputs = driving()
    known = receive(doubted(state, NOW), DRIVING, NOW + 10 * MS)
    for after_ns, phase in ((10 * MS, Phase.HOLDING), (110 * MS - 1, Phase.HOLDING), (110 * MS, Phase.DRIVING)):
        decision = decide(*refreshed((known, inputs), NOW + after_ns))
        assert decision.phase is phase
        assert decision.reasons == (set() if phase is Phase.DRIVING else {Reason.AS_STATE_UNKNOWN})
    words = dict(decide(*refreshed((known, inputs), NOW + 60 * MS)).details)
    assert words == {Reason.AS_STATE_UNKNOWN: "known again for 50 ms"}


def test_an_as_state_that_flickers_gives_no_torque() -> None:
    state, inputs = driving()
    for after_ns in range(0, 2000 * MS, 20 * MS):
        state = receive(doubted(state, NOW + after_ns), DRIVING, NOW + after_ns + 10 * MS)
        assert decide(*refreshed((state, inputs), NOW + after_ns + 10 * MS)).phase is Phase.HOLDING
    state = receive(state, DRIVING, NOW + 2 * S)  # what was known before goes on being counted
    assert decide(*refreshed((state, inputs), NOW + 2 * S - 10 * MS + 100 * MS)).phase is Phase.DRIVING


@pytest.mark.parametrize(("throttle", "brake", "both"), [(0.5, 0.1, True), (0, 0.5, False), (0.5, 0, False)])
def test_throttle_with_brake_for_100_ms_is_an_emergency(throttle: float, brake: float, both: bool) -> None:
    pedals = {"throttle": throttle, "brake": brake}
    situation, decision = cycle(driving(**pedals))
    assert (decision.phase, decision.reasons) == (Phase.DRIVING, {Reason.BOTH_PEDALS} if both else set())
    for n in range(1, 10):  # timed across the frames of the car
        situation = receive(situation[0], DRIVING, NOW + n * 10 * MS), situation[1]
        situation, decision = cycle(refreshed(situation, NOW + n * 10 * MS))
        assert decision.phase is Phase.DRIVING
    assert phases_at(NOW + 100 * MS, situation) == (Phase.DRIVING, Phase.ESTOP_ASKED if both else Phase.DRIVING)
    # In turn they are no fault
    situation, decision = cycle(refreshed(situation, NOW + 99 * MS, brake=0.0))
    assert decision.reasons == frozenset()
    assert decide(*refreshed(situation, NOW + 100 * MS, **pedals)).phase is Phase.DRIVING


@pytest.mark.parametrize("since_ns", [3 * S, 3 * S - 50 * MS])
def test_both_pedals_in_the_first_3_s_count_from_3_s_on(since_ns: int) -> None:
    begun, _ = cycle(driving(LAUNCH + 2 * S, brake=0.1))
    begun, _ = cycle(refreshed(begun, LAUNCH + 3 * S, command_ns=LAUNCH + since_ns))
    assert phases_at(LAUNCH + 3 * S + 100 * MS, begun) == (Phase.DRIVING, Phase.ESTOP_ASKED)


@pytest.mark.parametrize(
    ("wrong", "since"),
    [({"brake": 0.1}, "both_pedals_since_ns"), ({"t_sensor_ns": NOW - 600 * MS}, "command_stale_since_ns")],
)
def test_what_began_in_the_last_run_does_not_count_in_the_next(wrong: dict[str, Any], since: str) -> None:
    (state, _), _ = cycle(driving(**wrong))
    for as_state, since_ns in ((DRIVING, NOW), (READY, None), (OFF, None), (FINISHED, None)):
        assert getattr(receive(state, as_state, NOW), since) == since_ns


def test_both_pedals_do_not_release_torque_that_others_block() -> None:
    decision = decide(*driving(status_ns=NOW - 60 * MS, brake=0.1))
    assert (decision.phase, decision.reasons) == (Phase.HOLDING, {Reason.VCU_SILENT, Reason.BOTH_PEDALS})


@pytest.mark.parametrize(
    ("changes", "reason"), [({"go_signal": False}, Reason.GO_OFF), ({"fault": True}, Reason.FAULT_STATUS)]
)
def test_the_car_stopping_itself_stops_the_torque_at_once(changes: dict[str, bool], reason: Reason) -> None:
    state, inputs = driving()
    (state, _), decision = cycle((receive(state, DRIVING, NOW, **changes), inputs))
    assert (decision.phase, decision.reasons, decision.estop) == (Phase.STOPPING, {reason}, False)
    assert decide(receive(state, DRIVING, NOW), inputs).phase is Phase.STOPPING


@pytest.mark.parametrize(
    ("reason", "consequence"),
    [
        (Reason.INTRUDER, Consequence.ESTOP),
        (Reason.LOOP_FAULT, Consequence.ESTOP),
        (Reason.BUS_LOST, Consequence.STOP),
        (Reason.AS_SWITCH_OFF, Consequence.STOP),
        (Reason.TS_SWITCH_OFF, Consequence.STOP),
        (Reason.SHUTDOWN_REQUESTED, Consequence.STOP),
        (Reason.FAULT_BIT, Consequence.STOP),
        (Reason.SHUTDOWN_CAUSE, Consequence.STOP),
        (Reason.STATE_FAULT, Consequence.STOP),
        (Reason.AMI_CHANGED, Consequence.STOP),
        (Reason.BACKLOG, Consequence.REPORT),
    ],
)
def test_what_happens_at_one_instant_acts_in_as_driving_only(reason: Reason, consequence: Consequence) -> None:
    assert REACTIONS[reason] == (Step("backlog_ns" if reason is Reason.BACKLOG else None, consequence),)
    state, inputs = driving()
    struck = supervisor.strike(state, reason, "what", NOW)
    latch = Latch(reason, NOW, "what")
    assert (struck.stop is not None, struck.emergency is not None) == (
        consequence is Consequence.STOP,
        consequence is Consequence.ESTOP,
    )
    assert latch in (struck.stop, struck.emergency) or struck == state
    assert (struck.mode, decide(struck, inputs).estop) == (Mode.AUTONOMOUS, consequence is Consequence.ESTOP)
    for as_state in (INIT, OFF, READY, FINISHED, EMERGENCY):
        outside = receive(chosen(), as_state, T0)
        assert supervisor.strike(outside, reason, "", T0) == outside


# ---------------------------------------------------------------- the stop itself


def stopping(rpm: int = 400) -> Situation:
    """A controlled stop began at NOW with this wheel speed."""
    situation, decision = cycle(driving(rpm=rpm, mode=Mode.MANUAL))
    assert decision.phase is Phase.STOPPING
    return cycle(situation)[0]


def after_stop(rpm: int, after_ns: int, **changes: Any) -> tuple[Situation, Decision]:
    state, inputs = but(stopping(), **changes)
    return cycle(refreshed((roll(state, rpm, NOW), inputs), NOW + after_ns))


@pytest.mark.parametrize(
    ("rpm", "after_ns", "phase"),
    [
        (400, 500 * MS - 1, Phase.STOPPING),
        (400, 500 * MS, Phase.ESTOP_ASKED),
        (392, 500 * MS, Phase.ESTOP_ASKED),
        (391, 500 * MS, Phase.STOPPING),
    ],
)
def test_a_stop_without_deceleration_is_an_emergency(rpm: int, after_ns: int, phase: Phase) -> None:
    (state, _), decision = after_stop(rpm, after_ns)
    assert decision.phase is phase
    ineffective = phase is Phase.ESTOP_ASKED
    assert dict(decision.details) == ({Reason.STOP_INEFFECTIVE: f"{rpm} rpm"} if ineffective else {})
    latch = Latch(Reason.STOP_INEFFECTIVE, NOW + after_ns, f"{rpm} rpm")
    assert state.emergency == (latch if ineffective else None)


def test_the_deceleration_must_go_on() -> None:
    situation, _ = after_stop(300, 500 * MS)
    assert phases_at(NOW + 1000 * MS, situation) == (Phase.STOPPING, Phase.ESTOP_ASKED)


def test_a_stop_still_moving_after_3_s_is_an_emergency() -> None:
    slow = {"stop_window_ns": NOW + 2900 * MS, "stop_window_rpm": 100}
    assert after_stop(10, 3 * S - 1, **slow)[1].phase is Phase.STOPPING
    assert after_stop(10, 3 * S, **slow)[1].phase is Phase.ESTOP_ASKED
    assert after_stop(9, 3 * S, **slow)[1].phase is Phase.STOPPING


@pytest.mark.parametrize("changes", [{"speeds_ns": None, "stop_window_rpm": None}, {"fastest_rpm": 0}])
def test_a_stop_without_wheel_speeds_is_an_emergency_after_3_s(changes: dict[str, Any]) -> None:
    silent = but(stopping(), driving_since_ns=NOW + 1 * S, **changes)
    for after_ns, phase in ((3 * S - 1, Phase.STOPPING), (3 * S, Phase.ESTOP_ASKED)):
        assert decide(*but(silent, status_ns=NOW + after_ns, now_ns=NOW + after_ns)).phase is phase


def test_stale_wheel_speeds_prove_no_missing_deceleration() -> None:
    now_ns = NOW + 500 * MS
    later = but(stopping(), driving_since_ns=NOW + 1 * S, status_ns=now_ns, now_ns=now_ns)
    assert decide(*but(later, speeds_ns=now_ns - 100 * MS)).reasons == frozenset()
    assert decide(*but(later, speeds_ns=now_ns - 100 * MS + 1)).reasons == {Reason.STOP_INEFFECTIVE}


def test_a_wheel_speed_before_the_stop_is_not_its_first() -> None:
    state = replace(launched(), sequence=Sequence.NONE, driving_since_ns=NOW)
    state, _ = supervise(CONFIG, replace(state, status_ns=NOW), Inputs(NOW))
    for ms in range(100, 700, 100):  # the first wheel speeds come after the stop has begun
        state = roll(replace(state, status_ns=NOW + ms * MS), 500 - ms // 4, NOW + ms * MS)
        state, decision = supervise(CONFIG, state, Inputs(NOW + ms * MS))
        assert decision.phase is Phase.STOPPING


def test_the_deceleration_of_a_stop_counts_from_its_own_start() -> None:
    earlier = {"stop_window_ns": NOW - 60 * S, "stop_window_rpm": 100}  # of a stop in an earlier run
    situation = driving(rpm=400, mode=Mode.MANUAL, **earlier)
    for n in range(50):
        situation, decision = cycle(refreshed(situation, NOW + n * 10 * MS))
        assert decision.phase is Phase.STOPPING


def test_finished_needs_half_a_second_of_standstill_and_stays() -> None:
    at_ns = NOW + 500 * MS
    still = refreshed(but(stopping(), fastest_rpm=0, still_since_ns=NOW, speeds_ns=at_ns - 1), at_ns)
    assert decide(*but(still, still_since_ns=NOW + 1)).phase is Phase.STOPPING
    situation, decision = cycle(still)
    assert decision.phase is Phase.STOPPED
    # Rolling again is braked in FORWARD again
    assert decide(roll(situation[0], 10, at_ns), situation[1]).phase is Phase.STOPPING
    for n in range(400):
        situation, decision = cycle(refreshed(situation, at_ns + n * 10 * MS))
        assert decision.phase is Phase.STOPPED


def test_a_finished_mission_stops_with_steering_and_keeps_mode() -> None:
    situation, decision = cycle(driving(mission_finished=True))
    assert (decision.phase, decision.steer, decision.reasons) == (Phase.STOPPING, Steer.COMMAND, frozenset())
    assert situation[0].mode is Mode.AUTONOMOUS
    # the planner may fall silent now: that is no fault any more
    decision = decide(*refreshed(situation, NOW + 400 * MS, command=None))
    assert (decision.phase, decision.steer, decision.reasons) == (Phase.STOPPING, Steer.HELD, frozenset())


def test_a_stop_in_the_first_three_seconds_does_not_steer() -> None:
    for after_ns, steer in ((3 * S - 1, Steer.HELD), (3 * S, Steer.COMMAND)):
        assert decide(*driving(LAUNCH + after_ns, go=False)).steer is steer


@pytest.mark.parametrize("changes", [{"sequence": Sequence.NONE}, {"confirmed": frozenset[str]()}])
def test_what_led_to_a_stop_is_not_found_again_in_it(changes: dict[str, Any]) -> None:
    situation, decision = cycle(driving(**changes))
    assert decision.phase is Phase.STOPPING and len(decision.reasons) == 1
    assert decide(*situation).reasons == frozenset()


STEERED = {
    Asked.MISSION_DONE,
    Reason.GO_OFF,
    Reason.FAULT_STATUS,
    Reason.WHEELS_STALE,
    Reason.WHEEL_IMPLAUSIBLE,
    Reason.AS_SWITCH_OFF,
    Reason.TS_SWITCH_OFF,
    Reason.SHUTDOWN_REQUESTED,
    Reason.FAULT_BIT,
    Reason.SHUTDOWN_CAUSE,
    Reason.STATE_FAULT,
    Reason.AMI_CHANGED,
}


@pytest.mark.parametrize("cause", [*Asked, *REACTIONS])
def test_a_stop_steers_unless_planner_or_steering_failed(cause: Reason | Asked) -> None:
    situation = driving(stop=Latch(cause, NOW))
    assert decide(*situation).steer is (Steer.COMMAND if cause in STEERED else Steer.HELD)
    assert decide(*but(situation, mode=Mode.MANUAL)).steer is Steer.HELD
    assert decide(*but(situation, command=None)).steer is Steer.HELD


# ---------------------------------------------------------------- the end of the process


def test_an_orderly_end_at_rest_says_zeros_and_neutral() -> None:
    for state in (chosen(), receive(chosen(), READY, T0)):
        assert supervisor.begin_end(CONFIG, state, T0) == state
        decision = supervisor.ending(decide(state, Inputs(T0)))
        assert (decision.mission_status, decision.direction) == (MissionStatus.NOT_SELECTED, Direction.NEUTRAL)
        assert (decision.steer, decision.brake) == (Steer.ZERO, Brake.ZERO)


def test_an_orderly_end_at_rest_in_as_driving_finishes_the_run() -> None:
    state, inputs = driving(rpm=0, still_since_ns=NOW - 500 * MS)
    state = supervisor.begin_end(CONFIG, state, NOW)
    decision = supervisor.ending(decide(state, inputs))
    assert (decision.mission_status, decision.direction) == (MissionStatus.FINISHED, Direction.NEUTRAL)
    assert (decision.brake, decision.steer) == (Brake.ZERO, Steer.ZERO)
    assert (decision.torque, decision.estop, state.emergency) == (False, False, None)
    assert state.stop is not None and state.stop.words == "this software was stopped"


def test_an_orderly_end_while_moving_leaves_the_car_to_its_brake() -> None:
    state, inputs = driving()
    state = supervisor.begin_end(CONFIG, state, NOW)
    decision = supervisor.ending(decide(state, inputs))
    assert (decision.estop, decision.direction, decision.brake) == (True, Direction.FORWARD, Brake.SERVICE)
    assert state.emergency is not None
    assert (
        state.emergency.words
        == "this software was stopped: the car was in AS_DRIVING, and its standstill was not confirmed"
    )


# ---------------------------------------------------------------- the words of what latched


@pytest.mark.parametrize(
    ("changes", "cause", "detail"),
    [
        ({"status_ns": NOW - 100 * MS}, Reason.VCU_SILENT, ""),
        ({"speeds_ns": NOW - 100 * MS}, Reason.WHEELS_STALE, ""),
        ({"speeds_ns": NOW - 100 * MS, "speeds_doubt": "too fast"}, Reason.WHEELS_STALE, "too fast"),
        ({"steer_ns": NOW - 100 * MS}, Reason.STEERING_STALE, ""),
        ({"steer_implausible_since_ns": NOW - 300 * MS}, Reason.STEERING_IMPLAUSIBLE, ""),
        ({"wheel_implausible_since_ns": 0, "wheel_detail": "odd"}, Reason.WHEEL_IMPLAUSIBLE, "odd"),
        ({"go": False}, Reason.GO_OFF, ""),
        ({"fault": True}, Reason.FAULT_STATUS, ""),
        ({"sequence": Sequence.NONE}, Reason.NOT_SEEN, ""),
        ({"both_pedals_since_ns": NOW - 100 * MS, "brake": 0.1}, Reason.BOTH_PEDALS, ""),
        ({"confirmed": frozenset({"planner"})}, Reason.NOT_CONFIRMED, "run 2 by the controller"),
        ({"confirmed": frozenset({"controller"})}, Reason.NOT_CONFIRMED, "run 2 by the planner"),
        ({"confirmed": frozenset[str]()}, Reason.NOT_CONFIRMED, "run 2 by the planner and controller"),
        ({"command_ns": NOW - 300 * MS}, Reason.COMMAND_STALE, "no command for 300 ms"),
        (
            {"command_ns": NOW - 100 * MS, "t_sensor_ns": NOW - 700 * MS},
            Reason.COMMAND_STALE,
            "no command for 100 ms",
        ),
        (
            {"command_ns": NOW - 10 * MS, "t_sensor_ns": NOW - 700 * MS},
            Reason.COMMAND_STALE,
            "commands keep coming, but the data behind them is 700 ms old",
        ),
        ({"command": None}, Reason.COMMAND_STALE, "no command has come in run 2"),
        ({"of_run": 1}, Reason.COMMAND_STALE, "no command has come in run 2"),
        ({"mission_finished": True}, Asked.MISSION_DONE, ""),
        ({"estop_request": True}, Asked.MISSION, ""),
    ],
)
def test_what_latched_is_told_with_its_detail(changes: dict[str, Any], cause: Reason | Asked, detail: str) -> None:
    (state, _), decision = cycle(driving(**changes))
    latch = state.emergency or state.stop
    assert latch is not None and (latch.cause, latch.since_ns, latch.detail) == (cause, NOW, detail)
    words = cause.words if isinstance(cause, Reason) else cause.value
    assert latch.words == (f"{words}: {detail}" if detail else words)
    assert dict(decision.details) == ({cause: detail} if isinstance(cause, Reason) else {})


# ---------------------------------------------------------------- the bus goes and comes back


def test_a_silence_of_1_s_before_a_bus_loss_is_a_power_cycle() -> None:
    for silence_ns, cleared in ((1 * S - 1, False), (1 * S, True)):
        state = supervisor.bus_lost(CONFIG, latched(EMERGENCY), "unplugged", T0 + silence_ns)
        state = supervisor.bus_back(state, T0 + silence_ns)
        assert (receive(state, OFF, T0 + silence_ns).emergency is None) is cleared


def test_the_time_without_a_bus_is_no_silence_of_the_car() -> None:
    back_ns = T0 + 60 * S
    state = supervisor.bus_back(supervisor.bus_lost(CONFIG, latched(EMERGENCY), "unplugged", T0), back_ns)
    assert receive(state, OFF, back_ns + 1 * S - 1).emergency is not None
    assert receive(state, OFF, back_ns + 1 * S).emergency is None
    never = supervisor.bus_back(emergency(SupervisorState()), back_ns)
    assert receive(never, OFF, back_ns + 60 * S).emergency is not None


def test_the_time_without_a_bus_is_no_part_of_a_stop() -> None:
    state, inputs = stopping(rpm=1000)
    back_ns = NOW + 60 * S
    state = supervisor.bus_back(supervisor.bus_lost(CONFIG, state, "unplugged", NOW), back_ns)
    assert state.stop is not None and (state.stop.cause, state.stop.since_ns) == (Asked.MANUAL, back_ns)
    situation, decision = cycle(refreshed((roll(state, 1000, back_ns), inputs), back_ns))
    assert decision.phase is Phase.STOPPING  # the wheels did not slow down while nothing could be said
    assert phases_at(back_ns + 500 * MS, situation) == (Phase.STOPPING, Phase.ESTOP_ASKED)


def test_after_a_bus_loss_the_feedback_has_3_s_to_return() -> None:
    state, _ = driving()
    back_ns = NOW + 60 * S
    state = supervisor.bus_back(supervisor.bus_lost(CONFIG, state, "unplugged", NOW), back_ns)
    assert state.stop is not None and state.stop.cause is Reason.BUS_LOST
    for after_ns, phase in ((3 * S - 1, Phase.STOPPING), (3 * S, Phase.ESTOP_ASKED)):
        now_ns = back_ns + after_ns
        waiting = replace(state, status_ns=now_ns, stop=Latch(Reason.BUS_LOST, now_ns))
        assert decide(waiting, Inputs(now_ns)).phase is phase
    idle = supervisor.bus_back(receive(chosen(), OFF, T0), T0 + 60 * S)
    assert (idle.driving_since_ns, idle.stop) == (None, None)


# ---------------------------------------------------------------- a process that is restarted (rule 10)


@pytest.mark.parametrize("role", supervisor.ROLES)
def test_a_reset_confirmed_again_in_as_driving_stops_the_car(role: str) -> None:
    state, inputs = driving()
    (state, _), decision = cycle((supervisor.confirm(state, role, state.run_id), inputs))
    assert (decision.phase, state.mode) == (Phase.STOPPING, Mode.AUTONOMOUS)
    assert state.stop == Latch(Reason.STACK_RESTARTED, NOW, role)


def test_a_first_confirmation_or_one_elsewhere_stops_nothing() -> None:
    for state in (SupervisorState(), chosen(), receive(chosen(), READY, T0), receive(launched(), EMERGENCY, LAUNCH)):
        assert supervisor.confirm(confirmed(state), "planner", state.run_id) == confirmed(state)
    assert confirmed(driving(confirmed=frozenset())[0]).stop is None


# ---------------------------------------------------------------- configuration


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"service_brake": "hand"}, "service_brake is 'hand': hydraulic or motor"),
        ({"stop_brake_pct": 100.5}, "stop_brake_pct is 100.5: 100 at most"),
        ({"holding_brake_pct": float("nan")}, "holding_brake_pct is nan: a finite number of 0 or more"),
        ({"vcu_stale_ns": -1}, "vcu_stale_ns is -1: a finite number of 0 or more"),
    ],
)
def test_a_configuration_that_makes_no_sense_is_refused(values: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError) as refused:
        BridgeConfig(**values)
    assert str(refused.value) == words


def test_the_official_simulator_is_braked_by_the_motors_only() -> None:
    config = official_simulator(BridgeConfig(autonomous_at_power_up=True))
    assert config.motor_brakes and config.held_brake_pct == 0.0 and config.autonomous_at_power_up
    assert config.short_sequence_allowed and not CONFIG.short_sequence_allowed
    assert not CONFIG.motor_brakes and CONFIG.held_brake_pct == CONFIG.holding_brake_pct


def test_no_value_of_the_supervision_can_be_changed() -> None:
    """Its state is shared by copies of a simulation, and by the search through all states."""
    modules = (supervisor, gate, plausibility, readiness, start_conditions, wheel_speeds)
    values = [
        kind
        for module in modules
        for kind in vars(module).values()
        if isinstance(kind, type) and issubclass(kind, Value) and kind.__module__ == module.__name__
    ]
    assert len(values) > 10
    assert [kind for kind in values if not kind.__struct_config__.frozen] == []
