"""The AS supervisor, held to the safety rules: pure steps, with the clock at T - 1 ns and at T."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from fsai_vcu.core.command import VehicleCommand
from fsai_vcu.core.supervision import supervisor
from fsai_vcu.core.supervision.config import BridgeConfig, official_simulator
from fsai_vcu.core.supervision.reasons import Reason, words_of
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

CONFIG = BridgeConfig()
T0 = 1000 * S  # an arbitrary instant of the monotonic clock

OFF, READY, DRIVING = AsState.AS_OFF, AsState.AS_READY, AsState.AS_DRIVING
INIT, EMERGENCY, FINISHED = AsState.AS_INIT, AsState.EMERGENCY_BRAKE, AsState.AS_FINISHED


def status(as_state: AsState, t_ns: int, **changes: Any) -> VcuStatus:
    values: dict[str, Any] = {"ami": Ami.TRACKDRIVE, "go_signal": as_state is DRIVING, **changes}
    return VcuStatus(as_state=as_state, t_rx_ns=t_ns, **values)


def hear(
    state: SupervisorState, as_state: AsState, t_ns: int, config: BridgeConfig = CONFIG, **changes: Any
) -> SupervisorState:
    return supervisor.on_status(config, state, status(as_state, t_ns, **changes))


def roll(state: SupervisorState, rpm: int, t_ns: int) -> SupervisorState:
    return supervisor.on_speeds(CONFIG, state, WheelSpeeds(rpm, rpm, rpm, rpm, t_rx_ns=t_ns))


def confirmed(state: SupervisorState) -> SupervisorState:
    for role in supervisor.ROLES:
        if role not in state.confirmed:
            state = supervisor.confirm(state, role, state.run_id)
    return state


def chosen(at_ns: int = T0) -> SupervisorState:
    """AS_OFF, mission chosen, everybody has confirmed, autonomous."""
    state = confirmed(hear(SupervisorState(), OFF, at_ns))
    state, done, _ = supervisor.set_mode(CONFIG, state, "autonomous", at_ns)
    assert done
    return state


def ready(at_ns: int, state: SupervisorState | None = None, wait_ns: int = 5 * S, **changes: Any) -> SupervisorState:
    """AS_READY with Go off, and SELECTED sent, until `at_ns`."""
    begin_ns = at_ns - wait_ns
    state = chosen(begin_ns - 10 * MS) if state is None else state
    for t_ns in (*range(begin_ns, at_ns, 500 * MS), at_ns):
        state = hear(state, READY, t_ns, **changes)
    return supervisor.on_selected_sent(state, state.run_id)


def launched(at_ns: int = T0 + 10 * S) -> SupervisorState:
    """The first frame of AS_DRIVING came at `at_ns`, with the whole sequence seen."""
    return hear(ready(at_ns - 10 * MS), DRIVING, at_ns)


LAUNCH = T0 + 10 * S
NOW = LAUNCH + 5 * S  # some time into driving


def driving(now_ns: int = NOW, rpm: int = 200) -> tuple[SupervisorState, Inputs]:
    """Driving by command for a while; everything was heard just now."""
    state = roll(launched(), rpm, now_ns)
    state = replace(state, status_ns=now_ns, heard_ns=now_ns)
    return state, Inputs(now_ns, VehicleCommand(now_ns, state.run_id, throttle=0.5), now_ns, steer_ns=now_ns)


def refreshed(state: SupervisorState, inputs: Inputs, now_ns: int) -> tuple[SupervisorState, Inputs]:
    """Everything heard anew at `now_ns`: the tests below then age one thing alone."""
    state = roll(replace(state, status_ns=now_ns, heard_ns=now_ns), state.fastest_rpm, now_ns)
    command = inputs.command and replace(inputs.command, t_sensor_ns=now_ns)
    return state, replace(inputs, now_ns=now_ns, command=command, command_ns=now_ns, steer_ns=now_ns)


def decide(state: SupervisorState, inputs: Inputs, config: BridgeConfig = CONFIG) -> Decision:
    return supervise(config, state, inputs)[1]


# ---------------------------------------------------------------- the tables


def test_every_phase_has_a_row_in_the_output_table() -> None:
    assert set(OUTPUT) == set(Phase)


def test_a_process_that_starts_has_waited_for_and_sent_nothing() -> None:
    state = SupervisorState()
    assert (state.ready_waited_ns, state.selected_sent) == (0, False)


@pytest.mark.parametrize(
    "reason",
    [
        Reason.AS_SWITCH_OFF,
        Reason.TS_SWITCH_OFF,
        Reason.SHUTDOWN_REQUESTED,
        Reason.FAULT_BIT,
        Reason.SHUTDOWN_CAUSE,
    ],
)
def test_an_edge_in_0x520_while_driving_stops_at_once(reason: Reason) -> None:
    assert REACTIONS[reason] == (Step(None, Consequence.STOP),)
    state = supervisor.strike(driving()[0], reason, "as told", NOW)
    assert (state.stop, state.emergency, state.mode) == (Latch(reason, NOW, "as told"), None, Mode.AUTONOMOUS)


def test_a_backlog_of_20_ms_is_reported_and_no_more() -> None:
    assert REACTIONS[Reason.BACKLOG] == (Step("backlog_ns", Consequence.REPORT),)
    state = driving()[0]
    assert supervisor.strike(state, Reason.BACKLOG, "20 ms", NOW) == state


@pytest.mark.parametrize(
    ("phase", "row"),
    [
        (Phase.IDLE, "as acknowledged, NEUTRAL, steering ZERO, brake ZERO"),
        (Phase.READY, "as acknowledged, NEUTRAL, steering ZERO, brake HOLDING"),
        (Phase.LAUNCH_WAIT, "RUNNING, FORWARD, steering ZERO, brake HOLDING"),
        (Phase.DRIVING, "RUNNING, FORWARD, steering COMMAND, brake COMMAND"),
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
    assert f"{status}, {out.direction.name}, steering {out.steer.name}, brake {out.brake.name}" == row
    assert isinstance(out.steer, Steer) and isinstance(out.brake, Brake)


def test_the_words_of_every_phase_begin_with_its_as_state() -> None:
    begins = {
        Phase.IDLE: "no AS state yet, AS_INIT or AS_OFF",
        Phase.READY: "AS_READY",
        Phase.FINISHED: "AS_FINISHED",
        Phase.EMERGENCY_MOVING: "EMERGENCY_BRAKE, ",
        Phase.EMERGENCY_STANDING: "EMERGENCY_BRAKE, ",
    }
    assert len(Phase) == 11  # two with the same words would be one
    for phase in Phase:
        assert phase.value.startswith(begins.get(phase, "AS_DRIVING, ")), phase


def test_every_requested_stop_and_emergency_has_a_sentence() -> None:
    assert len(Asked) == 5
    for cause in Asked:
        assert len(cause.value.split()) >= 4, cause


def test_torque_is_let_through_in_one_phase_only() -> None:
    assert [phase for phase in Phase if OUTPUT[phase].torque] == [Phase.DRIVING]


def test_every_reaction_gets_graver_with_time() -> None:
    for reason, steps in REACTIONS.items():
        after = [0 if step.after is None else getattr(CONFIG, step.after) for step in steps]
        assert after == sorted(after), reason
        assert [step.consequence for step in steps] == sorted(step.consequence for step in steps), reason


def test_only_a_command_that_is_lost_makes_the_mode_manual() -> None:
    takes_over = {
        reason for reason, steps in REACTIONS.items() for step in steps if step.consequence is Consequence.STOP_MANUAL
    }
    assert takes_over == {Reason.COMMAND_STALE}


def test_a_decision_that_nobody_has_made_is_safe_and_of_no_run() -> None:
    nobodys = Decision()
    assert not (nobodys.torque or nobodys.may_move or nobodys.estop)
    assert (nobodys.mission_status, nobodys.direction) == (MissionStatus.NOT_SELECTED, Direction.NEUTRAL)
    assert (nobodys.phase, nobodys.steer, nobodys.brake) == (Phase.IDLE, Steer.ZERO, Brake.ZERO)
    assert nobodys.run_id == 0 < SupervisorState().run_id


def test_a_process_that_has_heard_nothing_begins_with_nothing() -> None:
    state, inputs = SupervisorState(), Inputs(T0)
    assert not (state.go or state.fault or state.was_silent or state.driving or state.is_confirmed)
    assert (state.mode, state.sequence, state.mission) == (Mode.MANUAL, Sequence.NONE, Ami.NOT_SELECTED)
    assert (state.stop, state.emergency, state.fastest_rpm, state.stop_window_ns) == (None, None, 0, 0)
    assert (inputs.command, inputs.command_ns, inputs.steer_ns, inputs.wheel_detail) == (None, 0, None, "")
    assert supervisor.Latch(Reason.GO_OFF, T0).words == Reason.GO_OFF.words


def test_every_reason_is_found_by_its_short_name() -> None:
    assert all(words_of(reason.slug) == reason.words and len(reason.words) > 10 for reason in Reason)
    assert Reason("go_off") is Reason.GO_OFF


def test_the_states_are_hashable_so_that_a_search_can_visit_them() -> None:
    state, inputs = driving()
    state, decision = supervise(CONFIG, state, inputs)
    assert len({state, launched(), decision}) == 3


@pytest.mark.parametrize(
    ("as_state", "mission_status", "direction", "steer", "brake"),
    [
        (None, MissionStatus.NOT_SELECTED, Direction.NEUTRAL, Steer.ZERO, Brake.ZERO),
        (INIT, MissionStatus.SELECTED, Direction.NEUTRAL, Steer.ZERO, Brake.ZERO),
        (OFF, MissionStatus.SELECTED, Direction.NEUTRAL, Steer.ZERO, Brake.ZERO),
        (READY, MissionStatus.SELECTED, Direction.NEUTRAL, Steer.ZERO, Brake.HOLDING),
        (DRIVING, MissionStatus.RUNNING, Direction.FORWARD, Steer.ZERO, Brake.HOLDING),
        (FINISHED, MissionStatus.FINISHED, Direction.NEUTRAL, Steer.ZERO, Brake.HOLDING),
        (EMERGENCY, MissionStatus.RUNNING, Direction.FORWARD, Steer.ZERO, Brake.ZERO),
    ],
)
def test_each_as_state_is_answered_with_its_row(
    as_state: AsState | None, mission_status: MissionStatus, direction: Direction, steer: Steer, brake: Brake
) -> None:
    state = SupervisorState()
    if as_state is not None:
        state = chosen(T0) if as_state in (INIT, OFF) else ready(T0)
        path = {DRIVING: (DRIVING,), FINISHED: (DRIVING, FINISHED), EMERGENCY: (EMERGENCY,)}
        for step in path.get(as_state, (as_state,)):
            state = hear(state, step, T0)
    decision = decide(state, Inputs(T0))
    assert (decision.mission_status, decision.direction) == (mission_status, direction)
    assert (decision.steer, decision.brake, decision.torque, decision.estop) == (steer, brake, False, False)


# ---------------------------------------------------------------- SELECTED


@pytest.mark.parametrize("as_state", [INIT, OFF])
def test_selected_needs_autonomous_a_mission_and_both_resets(as_state: AsState) -> None:
    good = hear(chosen(), as_state, T0)
    assert decide(good, Inputs(T0)).mission_status is MissionStatus.SELECTED
    for lacking in (
        replace(good, mode=Mode.MANUAL),
        replace(good, mission=Ami.NOT_SELECTED),
        replace(good, confirmed=frozenset({"planner"})),
        replace(good, confirmed=frozenset({"controller"})),
        supervisor.ask_emergency(good, Asked.OPERATOR, "", T0),
    ):
        assert decide(lacking, Inputs(T0)).mission_status is MissionStatus.NOT_SELECTED


def test_in_as_ready_selected_waits_for_another_missions_resets() -> None:
    state = hear(chosen(), READY, T0)
    assert decide(state, Inputs(T0)).mission_status is MissionStatus.SELECTED
    state = hear(state, READY, T0, ami=Ami.AUTOCROSS)
    assert decide(state, Inputs(T0)).mission_status is MissionStatus.NOT_SELECTED
    assert decide(confirmed(state), Inputs(T0)).mission_status is MissionStatus.SELECTED


def test_a_reset_of_another_run_or_unknown_role_does_not_count() -> None:
    state = hear(SupervisorState(), OFF, T0)
    assert supervisor.confirm(state, "planner", state.run_id - 1) == state
    assert supervisor.confirm(state, "planner", state.run_id + 1) == state
    assert supervisor.confirm(state, "driver", state.run_id) == state
    assert supervisor.confirm(state, "planner", state.run_id).confirmed == {"planner"}


# ---------------------------------------------------------------- runs


def test_each_ami_change_in_as_off_or_as_ready_begins_a_run() -> None:
    state = hear(SupervisorState(), OFF, T0, ami=Ami.NOT_SELECTED)
    assert (state.run_id, state.mission) == (1, Ami.NOT_SELECTED)
    state = confirmed(hear(state, OFF, T0, ami=Ami.SKIDPAD))
    assert (state.run_id, state.mission) == (2, Ami.SKIDPAD)
    state = hear(state, INIT, T0, ami=Ami.ACCELERATION)
    assert (state.run_id, state.mission, state.confirmed) == (3, Ami.ACCELERATION, frozenset())
    state = hear(state, READY, T0, ami=Ami.AUTOCROSS)
    assert (state.run_id, state.mission) == (4, Ami.AUTOCROSS)


@pytest.mark.parametrize("as_state", [DRIVING, EMERGENCY, FINISHED])
def test_the_ami_is_latched_from_as_driving_on(as_state: AsState) -> None:
    before = hear(launched(), as_state, T0)
    state = hear(before, as_state, T0, ami=Ami.ACCELERATION)
    assert (state.run_id, state.mission) == (before.run_id, Ami.TRACKDRIVE)


@pytest.mark.parametrize("before", [READY, DRIVING, EMERGENCY, FINISHED])
@pytest.mark.parametrize("off", [OFF, INIT])
def test_each_entry_into_as_off_begins_a_new_run(before: AsState, off: AsState) -> None:
    state = confirmed(hear(chosen(), before, T0))
    entered = hear(state, off, T0)
    assert (entered.run_id, entered.confirmed) == (state.run_id + 1, frozenset())
    assert hear(entered, off, T0).run_id == entered.run_id


def test_as_init_and_as_off_count_as_one_state() -> None:
    state = hear(SupervisorState(), INIT, T0)
    assert hear(state, OFF, T0).run_id == state.run_id


def test_a_power_cycle_from_as_off_to_as_off_begins_a_new_run() -> None:
    state = hear(SupervisorState(), OFF, T0)
    assert hear(state, OFF, T0 + 1 * S - 1).run_id == state.run_id
    assert hear(state, OFF, T0 + 1 * S).run_id == state.run_id + 1


# ---------------------------------------------------------------- the sequence


def test_the_whole_sequence_lets_the_car_drive() -> None:
    assert launched().sequence is Sequence.COMPLETE


@pytest.mark.parametrize("frames", [1, 2, 3])
def test_however_often_each_state_is_said_the_sequence_is_seen(frames: int) -> None:
    state = SupervisorState()
    for as_state in (INIT, OFF, READY, DRIVING):
        for _ in range(frames):
            state = hear(state, as_state, T0)
    assert state.sequence is Sequence.COMPLETE


@pytest.mark.parametrize(
    "path",
    [
        (DRIVING,),
        (READY, DRIVING),
        (OFF, DRIVING),
        (OFF, READY, DRIVING, EMERGENCY, DRIVING),
        (OFF, READY, DRIVING, FINISHED, DRIVING),
        (OFF, READY, DRIVING, READY, DRIVING),
        (OFF, READY, EMERGENCY, READY, DRIVING),
        (FINISHED, READY, DRIVING),
    ],
)
def test_without_the_whole_sequence_the_car_is_stopped(path: tuple[AsState, ...]) -> None:
    state = SupervisorState()
    for as_state in path:
        state = confirmed(hear(state, as_state, T0))
    state = replace(state, mode=Mode.AUTONOMOUS)
    state, decision = supervise(CONFIG, state, Inputs(T0))
    assert decision.phase is Phase.STOPPING and state.stop is not None and state.stop.cause is Reason.NOT_SEEN
    assert decision.reasons == {Reason.NOT_SEEN}


@pytest.mark.parametrize("back", [OFF, INIT])
def test_after_a_fall_back_the_sequence_counts_anew_and_drives(back: AsState) -> None:
    state = launched()
    for as_state in (back, READY, DRIVING):
        state = hear(state, as_state, LAUNCH)
    assert state.sequence is Sequence.COMPLETE and state.stop is None


def test_a_silence_of_a_power_cycle_breaks_the_sequence() -> None:
    ready = hear(chosen(), READY, T0)
    assert hear(ready, DRIVING, T0 + 1 * S - 1).sequence is Sequence.COMPLETE
    assert hear(ready, DRIVING, T0 + 1 * S).sequence is Sequence.NONE
    assert hear(ready, READY, T0 + 1 * S).sequence is Sequence.NONE


def test_a_silence_in_as_driving_restarts_the_3_s_of_rest() -> None:
    state = hear(launched(), DRIVING, LAUNCH + 1 * S)
    assert (state.sequence, state.driving_since_ns) == (Sequence.NONE, LAUNCH + 1 * S)


def test_a_bus_loss_breaks_the_sequence() -> None:
    ready = supervisor.bus_lost(CONFIG, hear(chosen(), READY, T0), "unplugged", T0)
    assert ready.stop is None
    assert hear(ready, READY, T0).sequence is Sequence.NONE
    assert hear(ready, DRIVING, T0).sequence is Sequence.NONE
    assert hear(ready, OFF, T0).sequence is Sequence.OFF_SEEN


def test_a_mission_changed_on_entering_as_driving_is_not_driven() -> None:
    state = hear(hear(chosen(), READY, T0), DRIVING, T0, ami=Ami.ACCELERATION)
    assert (state.sequence, state.mission) == (Sequence.NONE, Ami.TRACKDRIVE)


def entered(state: SupervisorState, t_ns: int, config: BridgeConfig = CONFIG) -> tuple[SupervisorState, Decision]:
    """The first cycle of AS_DRIVING after `state`."""
    return supervise(config, hear(state, DRIVING, t_ns), Inputs(t_ns))


@pytest.mark.parametrize(("wait_ns", "short"), [(4900 * MS - 1, True), (4900 * MS, False), (5 * S, False)])
def test_as_driving_needs_5_s_in_as_ready_less_lost_frames(wait_ns: int, short: bool) -> None:
    decision = entered(ready(T0, wait_ns=wait_ns), T0 + 10 * MS)[1]
    assert (decision.phase is Phase.STOPPING) == short
    assert decision.reasons == ({Reason.SEQUENCE_SHORT} if short else frozenset())


def test_too_short_a_stay_in_as_ready_is_told_in_seconds() -> None:
    state, _ = entered(ready(T0, wait_ns=20 * MS), T0 + 10 * MS)
    assert state.stop is not None
    assert state.stop.detail == "AS_DRIVING, but the car was in AS_READY with Go off for only 0.02 s"
    state, _ = entered(ready(T0, wait_ns=375 * MS), T0 + 10 * MS)
    assert state.stop is not None and state.stop.detail.endswith("only 0.38 s")


@pytest.mark.parametrize(("off_ns", "short"), [(4900 * MS - 1, True), (4900 * MS, False)])
def test_go_must_come_after_the_5_s_in_as_ready(off_ns: int, short: bool) -> None:
    state = ready(T0, wait_ns=off_ns)
    for n in range(1, 20):  # the car stays in AS_READY for 9.5 s more, with Go on
        state = hear(state, READY, T0 + n * 500 * MS, go_signal=True)
    assert (entered(state, T0 + 10 * S)[1].phase is Phase.STOPPING) == short


def test_a_go_that_goes_off_again_in_as_ready_counts_from_then() -> None:
    state = hear(ready(T0, wait_ns=3 * S), READY, T0 + 500 * MS, go_signal=True)
    assert entered(state, T0 + 510 * MS)[1].reasons == {Reason.SEQUENCE_SHORT}
    state = ready(T0 + 2 * S, state, 1 * S)
    assert entered(state, T0 + 2010 * MS)[1].reasons == frozenset()


@pytest.mark.parametrize("between", [OFF, FINISHED, EMERGENCY])
def test_each_stay_in_as_ready_counts_for_itself(between: AsState) -> None:
    state = hear(ready(T0), between, T0 + 10 * MS)
    state = confirmed(hear(state, OFF, T0 + 20 * MS))
    state = ready(T0 + 130 * MS, state, 100 * MS)
    assert entered(state, T0 + 140 * MS)[1].reasons == {Reason.SEQUENCE_SHORT}


def test_a_power_cycle_ends_the_stay_in_as_ready() -> None:
    assert hear(ready(T0), READY, T0 + 1 * S).ready_waited_ns == 0
    assert hear(ready(T0), READY, T0 + 1 * S, go_signal=True).ready_waited_ns == 0


def test_a_stay_in_as_ready_begun_with_go_has_not_waited() -> None:
    state = confirmed(hear(ready(T0), OFF, T0 + 10 * MS))
    state = ready(T0 + 10 * S, state, 9 * S, go_signal=True)
    assert entered(state, T0 + 10 * S)[1].reasons == {Reason.SEQUENCE_SHORT}


def test_where_a_short_sequence_is_allowed_it_stops_nothing() -> None:
    config = official_simulator()
    decision = entered(ready(T0, wait_ns=20 * MS), T0 + 10 * MS, config)[1]
    assert config.short_sequence_allowed and not CONFIG.short_sequence_allowed
    assert decision.phase is Phase.LAUNCH_WAIT and decision.reasons == frozenset()


def test_without_a_mission_on_the_ami_there_is_no_torque() -> None:
    state = confirmed(hear(SupervisorState(), OFF, T0, ami=Ami.NOT_SELECTED))
    state, done, _ = supervisor.set_mode(CONFIG, state, "autonomous", T0)
    state = ready(T0 + 6 * S, replace(state, heard_ns=T0 + 1 * S), ami=Ami.NOT_SELECTED)
    t_ns = T0 + 6 * S + 10 * MS
    state, decision = supervise(CONFIG, hear(state, DRIVING, t_ns, ami=Ami.NOT_SELECTED), Inputs(t_ns))
    assert done and decision.phase is Phase.STOPPING and decision.reasons == {Reason.NO_MISSION}
    assert state.stop is not None and state.stop.detail == "none is chosen on the AMI"


def test_a_mission_that_was_never_acknowledged_is_none() -> None:
    state, decision = entered(replace(ready(T0), selected_sent=False), T0 + 10 * MS)
    assert decision.phase is Phase.STOPPING and decision.reasons == {Reason.NO_MISSION}
    assert state.stop is not None and state.stop.detail == "SELECTED was not sent for TRACKDRIVE"


def test_each_run_is_acknowledged_for_itself() -> None:
    state = ready(T0)
    assert state.selected_sent and supervisor.on_selected_sent(state, state.run_id) is state
    other = hear(state, READY, T0 + 10 * MS, ami=Ami.AUTOCROSS)
    assert other.run_id != state.run_id and not other.selected_sent
    assert not supervisor.on_selected_sent(other, state.run_id).selected_sent
    assert supervisor.on_selected_sent(other, other.run_id).selected_sent


@pytest.mark.parametrize("age_ns", [0, 49 * MS])
def test_an_unknown_as_state_takes_torque_away_at_once(age_ns: int) -> None:
    state, inputs = driving()
    unknown = replace(inputs, status_doubt="AS_STATE 9 is not in the interface's table")
    after, decision = supervise(CONFIG, replace(state, status_ns=NOW - age_ns), unknown)
    assert decision.phase is Phase.HOLDING and decision.reasons == {Reason.AS_STATE_UNKNOWN}
    assert dict(decision.details) == {Reason.AS_STATE_UNKNOWN: "AS_STATE 9 is not in the interface's table"}
    assert after.stop is None and decide(after, inputs).phase is Phase.DRIVING


@pytest.mark.parametrize(("age_ns", "stands"), [(500 * MS - 1, False), (500 * MS, True)])
def test_a_car_whose_counts_advance_does_not_stand(age_ns: int, stands: bool) -> None:
    state = replace(hear(SupervisorState(), OFF, NOW), speeds_ns=NOW, still_since_ns=NOW - 1 * S)
    assert supervisor.standing(CONFIG, state, NOW)
    state = supervisor.on_pulses(state, NOW - age_ns)
    assert supervisor.standing(CONFIG, state, NOW) == stands
    assert supervisor.on_pulses(state, NOW - age_ns) is state


def test_as_driving_without_confirmed_resets_is_stopped() -> None:
    state, inputs = driving()
    state, decision = supervise(CONFIG, replace(state, confirmed=frozenset({"planner"})), inputs)
    assert decision.phase is Phase.STOPPING and decision.reasons == {Reason.NOT_CONFIRMED}
    assert state.stop is not None and "by the controller" in state.stop.words


# ---------------------------------------------------------------- standing still


def test_standing_needs_half_a_second_under_ten_rpm() -> None:
    state = roll(SupervisorState(), 9, T0)
    for n in range(1, 6):
        state = roll(state, 9, T0 + n * 90 * MS)
    assert not supervisor.standing(CONFIG, state, T0 + 450 * MS)
    almost = roll(state, 9, T0 + 500 * MS - 1)
    assert not supervisor.standing(CONFIG, almost, T0 + 500 * MS)
    assert supervisor.standing(CONFIG, roll(state, 9, T0 + 500 * MS), T0 + 500 * MS)


def stood(now_ns: int) -> SupervisorState:
    return replace(launched(), speeds_ns=now_ns, still_since_ns=now_ns - 500 * MS, fastest_rpm=0)


def test_one_wheel_at_ten_rpm_is_not_standing() -> None:
    for wheel in range(4):
        rpm = [0, 0, 0, 0]
        rpm[wheel] = 10
        state = supervisor.on_speeds(CONFIG, stood(NOW), WheelSpeeds(*rpm, t_rx_ns=NOW))
        assert not supervisor.standing(CONFIG, state, NOW)


def test_wheel_speeds_100_ms_old_do_not_prove_standstill() -> None:
    assert supervisor.standing(CONFIG, stood(NOW), NOW + 100 * MS - 1)
    assert not supervisor.standing(CONFIG, stood(NOW), NOW + 100 * MS)
    assert not supervisor.standing(CONFIG, SupervisorState(), NOW)
    assert not supervisor.standing(CONFIG, replace(stood(NOW), speeds_ns=None), NOW)
    assert not supervisor.standing(CONFIG, replace(stood(NOW), still_since_ns=None), NOW)


def test_wheel_speeds_are_fresh_for_less_than_100_ms() -> None:
    assert supervisor.wheels_fresh(CONFIG, stood(NOW), NOW + 100 * MS - 1)
    assert not supervisor.wheels_fresh(CONFIG, stood(NOW), NOW + 100 * MS)
    assert not supervisor.wheels_fresh(CONFIG, SupervisorState(), NOW)


def test_standstill_is_not_joined_across_a_gap() -> None:
    assert roll(stood(NOW), 0, NOW + 100 * MS - 1).still_since_ns == NOW - 500 * MS
    assert roll(stood(NOW), 0, NOW + 100 * MS).still_since_ns == NOW + 100 * MS


# ---------------------------------------------------------------- launch and command


def test_the_car_must_not_move_for_three_seconds() -> None:
    for now_ns, phase, may_move in (
        (LAUNCH + 3 * S - 1, Phase.LAUNCH_WAIT, False),
        (LAUNCH + 3 * S, Phase.DRIVING, True),
    ):
        state, inputs = driving(now_ns, rpm=0)
        decision = decide(state, inputs)
        assert (decision.phase, decision.may_move, decision.torque) == (phase, may_move, may_move)


def test_driving_by_command_gives_no_reason() -> None:
    state, inputs = driving()
    decision = decide(state, inputs)
    assert (decision.phase, decision.reasons) == (Phase.DRIVING, frozenset())
    assert (decision.steer, decision.brake, decision.torque) == (Steer.COMMAND, Brake.COMMAND, True)


def aged_command(age_ns: int) -> tuple[SupervisorState, Inputs]:
    state, inputs = driving()
    return state, replace(inputs, command_ns=NOW - age_ns)


def test_a_command_100_ms_old_blocks_torque_until_a_fresh_one() -> None:
    assert decide(*aged_command(100 * MS - 1)).phase is Phase.DRIVING
    state, decision = supervise(CONFIG, *aged_command(100 * MS))
    assert (decision.phase, decision.reasons) == (Phase.HOLDING, {Reason.COMMAND_STALE})
    assert (decision.torque, decision.steer, decision.brake) == (False, Steer.HELD, Brake.KEPT)
    assert decide(state, driving()[1]).phase is Phase.DRIVING


def test_a_command_of_300_ms_stops_the_car_for_good_in_manual() -> None:
    state, decision = supervise(CONFIG, *aged_command(300 * MS - 1))
    assert (decision.phase, state.mode) == (Phase.HOLDING, Mode.AUTONOMOUS)
    state, decision = supervise(CONFIG, *aged_command(300 * MS))
    assert (decision.phase, state.mode) == (Phase.STOPPING, Mode.MANUAL)
    assert state.stop is not None and state.stop.cause is Reason.COMMAND_STALE
    assert decide(state, driving()[1]).phase is Phase.STOPPING  # a fresh command does not resume any more


def test_data_of_500_ms_makes_a_command_stale_and_of_700_ms_lost() -> None:
    for age_ns, phase in (
        (500 * MS - 1, Phase.DRIVING),
        (500 * MS, Phase.HOLDING),
        (700 * MS - 1, Phase.HOLDING),
        (700 * MS, Phase.STOPPING),
    ):
        state, inputs = driving()
        assert inputs.command is not None
        aged = replace(inputs, command=replace(inputs.command, t_sensor_ns=NOW - age_ns))
        assert decide(state, aged).phase is phase, age_ns


def test_a_command_of_another_run_counts_as_none() -> None:
    state, inputs = driving()
    assert inputs.command is not None
    other = replace(inputs, command=replace(inputs.command, run_id=state.run_id - 1))
    assert decide(state, other).phase is Phase.STOPPING


def test_without_any_command_the_reaction_counts_from_3_s_on() -> None:
    for after_ns, phase, mode in (
        (0, Phase.HOLDING, Mode.AUTONOMOUS),
        (300 * MS - 1, Phase.HOLDING, Mode.AUTONOMOUS),
        (300 * MS, Phase.STOPPING, Mode.MANUAL),
    ):
        state, inputs = driving(LAUNCH + 3 * S + after_ns)
        state, decision = supervise(CONFIG, state, replace(inputs, command=None))
        assert (decision.phase, state.mode) == (phase, mode)


# ---------------------------------------------------------------- modes


@pytest.mark.parametrize("as_state", [INIT, OFF, READY])
def test_autonomous_is_accepted_in(as_state: AsState) -> None:
    state, done, message = supervisor.set_mode(CONFIG, hear(SupervisorState(), as_state, T0), "autonomous", T0)
    assert (done, message, state.mode) == (True, "mode is autonomous", Mode.AUTONOMOUS)


@pytest.mark.parametrize("as_state", [DRIVING, EMERGENCY, FINISHED])
def test_autonomous_is_refused_by_name_in(as_state: AsState) -> None:
    before = hear(SupervisorState(), as_state, T0)
    state, done, message = supervisor.set_mode(CONFIG, before, "autonomous", T0)
    assert (done, state) == (False, before)
    assert message == f"autonomous refused in {as_state.label}: accepted in AS_INIT, AS_OFF and AS_READY only"


def test_autonomous_is_refused_while_nobody_knows_the_as_state() -> None:
    _, done, message = supervisor.set_mode(CONFIG, SupervisorState(), "autonomous", T0)
    assert not done and "no 0x520" in message
    state = hear(SupervisorState(), OFF, T0)
    assert supervisor.set_mode(CONFIG, state, "autonomous", T0 + 100 * MS - 1)[1]
    _, done, message = supervisor.set_mode(CONFIG, state, "autonomous", T0 + 100 * MS)
    assert not done and "the car is silent: the last 0x520 (AS_OFF) is 0.1 s old" in message


def test_autonomous_is_refused_by_a_process_that_only_listens() -> None:
    config = BridgeConfig(listen_only=True)
    _, done, message = supervisor.set_mode(config, hear(SupervisorState(), OFF, T0), "autonomous", T0)
    assert not done and "listen_only" in message


def test_an_unknown_mode_is_refused_with_the_valid_ones() -> None:
    state = hear(SupervisorState(), OFF, T0)
    assert supervisor.set_mode(CONFIG, state, "auto", T0) == (
        state,
        False,
        "unknown mode 'auto': the modes are manual, autonomous",
    )


@pytest.mark.parametrize("as_state", list(AsState))
def test_manual_is_accepted_at_any_time(as_state: AsState) -> None:
    state = replace(hear(chosen(), as_state, T0), mode=Mode.AUTONOMOUS)
    state, done, _ = supervisor.set_mode(CONFIG, state, "manual", T0 + 99 * S)
    assert done and state.mode is Mode.MANUAL


def test_manual_while_driving_is_a_controlled_stop_and_no_fault() -> None:
    state, inputs = driving()
    state, _, message = supervisor.set_mode(CONFIG, state, "manual", NOW)
    assert "is being stopped" in message
    state, decision = supervise(CONFIG, state, inputs)
    assert (decision.phase, decision.reasons, decision.estop) == (Phase.STOPPING, frozenset(), False)
    assert state.stop is not None and state.stop.cause is Asked.MANUAL
    assert decision.steer is Steer.HELD  # the planner's commands no longer reach the car


def test_the_mode_survives_as_finished_and_a_power_cycle() -> None:
    state = hear(launched(), FINISHED, LAUNCH)
    assert state.mode is Mode.AUTONOMOUS
    assert hear(state, OFF, LAUNCH + 60 * S).mode is Mode.AUTONOMOUS


def test_a_latched_emergency_is_named_when_autonomous_is_chosen() -> None:
    state = supervisor.ask_emergency(hear(SupervisorState(), OFF, T0), Asked.OPERATOR, "smoke", T0)
    _, done, message = supervisor.set_mode(CONFIG, state, "autonomous", T0)
    assert done and message.endswith("the emergency brake is latched because the emergency brake was asked for: smoke")


# ---------------------------------------------------------------- autonomous at power-up

POWER_UP = BridgeConfig(autonomous_at_power_up=True)


def at_rest(as_state: AsState, t_ns: int) -> SupervisorState:
    state = hear(SupervisorState(), as_state, t_ns)
    return replace(state, speeds_ns=t_ns, still_since_ns=t_ns - 500 * MS)


@pytest.mark.parametrize("as_state", [INIT, OFF])
def test_autonomous_at_power_up_waits_for_standstill(as_state: AsState) -> None:
    state = at_rest(as_state, T0)
    moving = replace(state, still_since_ns=T0 - 500 * MS + 1)
    assert supervise(POWER_UP, moving, Inputs(T0))[0].mode is Mode.MANUAL
    assert supervise(POWER_UP, state, Inputs(T0))[0].mode is Mode.AUTONOMOUS
    assert supervise(CONFIG, state, Inputs(T0))[0].mode is Mode.MANUAL


@pytest.mark.parametrize("as_state", [READY, EMERGENCY, FINISHED])
def test_autonomous_at_power_up_acts_nowhere_else(as_state: AsState) -> None:
    assert supervise(POWER_UP, at_rest(as_state, T0), Inputs(T0))[0].mode is Mode.MANUAL


def test_a_listener_never_becomes_autonomous_by_itself() -> None:
    config = BridgeConfig(autonomous_at_power_up=True, listen_only=True)
    assert supervise(config, at_rest(OFF, T0), Inputs(T0))[0].mode is Mode.MANUAL


def test_manual_asked_for_stays_manual_until_the_next_power_up() -> None:
    state, _ = supervise(POWER_UP, at_rest(OFF, T0), Inputs(T0))
    state, _, _ = supervisor.set_mode(POWER_UP, state, "manual", T0)
    assert supervise(POWER_UP, state, Inputs(T0))[0].mode is Mode.MANUAL
    state = replace(hear(state, OFF, T0 + 2 * S), speeds_ns=T0 + 2 * S)
    assert supervise(POWER_UP, state, Inputs(T0 + 2 * S))[0].mode is Mode.AUTONOMOUS


# ---------------------------------------------------------------- the emergency latch


def latched(as_state: AsState) -> SupervisorState:
    return hear(supervisor.ask_emergency(chosen(), Asked.OPERATOR, "smoke", T0), as_state, T0)


@pytest.mark.parametrize("as_state", list(AsState))
def test_an_emergency_request_is_sent_in_every_as_state(as_state: AsState) -> None:
    assert decide(latched(as_state), Inputs(T0)).estop


def test_the_first_cause_of_an_emergency_stays() -> None:
    state = supervisor.ask_emergency(latched(OFF), Reason.INTRUDER, "0x512", T0)
    assert state.emergency is not None and state.emergency.words == "the emergency brake was asked for: smoke"


@pytest.mark.parametrize("as_state", [INIT, OFF])
def test_reset_clears_the_emergency_in(as_state: AsState) -> None:
    state, done, message = supervisor.reset(CONFIG, latched(as_state), T0)
    assert done and state.emergency is None
    assert message == "cleared the emergency brake latched because the emergency brake was asked for: smoke"
    assert supervisor.reset(CONFIG, state, T0) == (state, True, "nothing was latched")


@pytest.mark.parametrize("as_state", [READY, DRIVING, EMERGENCY, FINISHED])
def test_reset_is_refused_by_name_in(as_state: AsState) -> None:
    before = latched(as_state)
    state, done, message = supervisor.reset(CONFIG, before, T0)
    assert (done, state) == (False, before)
    assert message == f"reset refused in {as_state.label}: accepted in AS_INIT and AS_OFF only"


def test_reset_is_refused_while_nobody_knows_the_as_state() -> None:
    assert not supervisor.reset(CONFIG, SupervisorState(), T0)[1]
    assert not supervisor.reset(CONFIG, latched(OFF), T0 + 100 * MS)[1]


@pytest.mark.parametrize(
    ("as_state", "silence_ns", "cleared"),
    [
        (OFF, 1 * S, True),
        (INIT, 1 * S, True),
        (OFF, 1 * S - 1, False),
        (READY, 1 * S, False),
        (DRIVING, 1 * S, False),
        (EMERGENCY, 1 * S, False),
        (FINISHED, 1 * S, False),
    ],
)
def test_the_cars_own_power_cycle_clears_the_emergency(as_state: AsState, silence_ns: int, cleared: bool) -> None:
    state = hear(latched(EMERGENCY), as_state, T0 + silence_ns)
    assert (state.emergency is None) is cleared


def test_a_power_cycle_to_another_state_clears_no_emergency() -> None:
    state = hear(hear(latched(EMERGENCY), EMERGENCY, T0 + 5 * S), OFF, T0 + 5 * S)
    assert state.emergency is not None


def test_0x520_of_any_content_is_no_silence() -> None:
    state = supervisor.heard(CONFIG, latched(EMERGENCY), T0 + 600 * MS)
    assert hear(state, OFF, T0 + 1200 * MS).emergency is not None


def test_a_power_cycle_is_remembered_past_invalid_frames() -> None:
    state = supervisor.heard(CONFIG, latched(EMERGENCY), T0 + 2 * S)
    state = supervisor.heard(CONFIG, state, T0 + 2 * S + 10 * MS)
    assert hear(state, OFF, T0 + 2 * S + 20 * MS).emergency is None


def test_the_first_0x520_ever_is_no_power_cycle() -> None:
    state = supervisor.ask_emergency(SupervisorState(), Asked.OPERATOR, "", T0)
    assert hear(state, OFF, T0).emergency is not None


def test_in_as_driving_an_emergency_brakes_as_well() -> None:
    state, inputs = driving()
    decision = decide(supervisor.ask_emergency(state, Asked.OPERATOR, "", NOW), inputs)
    assert (decision.phase, decision.mission_status) == (Phase.ESTOP_ASKED, MissionStatus.RUNNING)
    assert (decision.direction, decision.brake, decision.steer) == (Direction.FORWARD, Brake.SERVICE, Steer.HELD)
    assert not decision.torque


def test_in_emergency_brake_neutral_waits_for_standstill() -> None:
    state = hear(launched(), EMERGENCY, NOW)
    assert decide(roll(state, 10, NOW), Inputs(NOW)).direction is Direction.FORWARD
    still = replace(state, speeds_ns=NOW, still_since_ns=NOW - 500 * MS)
    assert decide(still, Inputs(NOW)).phase is Phase.EMERGENCY_STANDING


# ---------------------------------------------------------------- graded reactions


def test_0x520_silence_blocks_torque_and_then_is_an_emergency() -> None:
    for age_ns, phase in (
        (50 * MS - 1, Phase.DRIVING),
        (50 * MS, Phase.HOLDING),
        (100 * MS - 1, Phase.HOLDING),
        (100 * MS, Phase.ESTOP_ASKED),
    ):
        state, inputs = driving()
        state, decision = supervise(CONFIG, replace(state, status_ns=NOW - age_ns), inputs)
        assert decision.phase is phase, age_ns
        assert (Reason.VCU_SILENT in decision.reasons) is (phase is not Phase.DRIVING)
    assert state.emergency is not None and state.emergency.cause is Reason.VCU_SILENT


@pytest.mark.parametrize("as_state", [INIT, OFF, READY, FINISHED, EMERGENCY])
def test_outside_as_driving_a_silent_car_latches_nothing(as_state: AsState) -> None:
    state = hear(chosen(), as_state, T0)
    after, decision = supervise(CONFIG, state, Inputs(T0 + 5 * S))
    assert (after.emergency, after.stop, decision.estop, decision.reasons) == (None, None, False, frozenset())


@pytest.mark.parametrize(
    ("reason", "age"),
    [
        (Reason.WHEELS_STALE, lambda state, inputs, ns: (replace(state, speeds_ns=NOW - ns), inputs)),
        (Reason.STEERING_STALE, lambda state, inputs, ns: (state, replace(inputs, steer_ns=NOW - ns))),
        (
            Reason.STEERING_IMPLAUSIBLE,
            lambda state, inputs, ns: (state, replace(inputs, steer_implausible_since_ns=NOW - ns)),
        ),
        (
            Reason.WHEEL_IMPLAUSIBLE,
            lambda state, inputs, ns: (state, replace(inputs, wheel_implausible_since_ns=NOW - ns)),
        ),
    ],
)
def test_failing_feedback_stops_the_car_and_then_is_an_emergency(reason: Reason, age: Any) -> None:
    stale = reason in (Reason.WHEELS_STALE, Reason.STEERING_STALE)
    stop_ns, estop_ns = (100 * MS, 300 * MS) if stale else (300 * MS, 600 * MS)
    for age_ns, phase in (
        (stop_ns - 1, Phase.DRIVING),
        (stop_ns, Phase.STOPPING),
        (estop_ns - 1, Phase.STOPPING),
        (estop_ns, Phase.ESTOP_ASKED),
    ):
        state, decision = supervise(CONFIG, *age(*driving(), age_ns))
        assert decision.phase is phase, age_ns
        assert (decision.reasons == {reason}) is (phase is not Phase.DRIVING)
    assert state.emergency is not None and state.emergency.cause is reason


@pytest.mark.parametrize("field", ["speeds_ns", "steer_ns"])
def test_feedback_never_received_is_an_emergency_once_supervised(field: str) -> None:
    for now_ns, phase in ((LAUNCH + 3 * S - 1, Phase.LAUNCH_WAIT), (LAUNCH + 3 * S, Phase.ESTOP_ASKED)):
        state, inputs = driving(now_ns)
        if field == "speeds_ns":
            state = replace(state, speeds_ns=None)
        else:
            inputs = replace(inputs, steer_ns=None)
        assert decide(state, inputs).phase is phase


def test_a_stop_by_failed_feedback_is_latched_but_the_mode_stays() -> None:
    state, inputs = driving()
    state, _ = supervise(CONFIG, replace(state, speeds_ns=NOW - 150 * MS), inputs)
    assert state.mode is Mode.AUTONOMOUS
    assert decide(*refreshed(state, inputs, NOW)).phase is Phase.STOPPING


def test_throttle_with_brake_for_100_ms_is_an_emergency() -> None:
    state, inputs = driving()
    assert inputs.command is not None
    both = replace(inputs, command=replace(inputs.command, brake=0.1))
    state, decision = supervise(CONFIG, state, both)
    assert (decision.phase, decision.reasons) == (Phase.DRIVING, {Reason.BOTH_PEDALS})
    for after_ns, phase in ((100 * MS - 1, Phase.DRIVING), (100 * MS, Phase.ESTOP_ASKED)):
        assert decide(*refreshed(state, both, NOW + after_ns)).phase is phase


def test_throttle_and_brake_in_turn_are_no_fault() -> None:
    state, inputs = driving()
    assert inputs.command is not None
    both = replace(inputs, command=replace(inputs.command, brake=0.1))
    state, _ = supervise(CONFIG, state, both)
    state, decision = supervise(CONFIG, *refreshed(state, inputs, NOW + 50 * MS))
    assert decision.reasons == frozenset()
    assert decide(*refreshed(state, both, NOW + 100 * MS)).phase is Phase.DRIVING


def test_both_pedals_in_the_first_3_s_count_from_3_s_on() -> None:
    for after_ns, phase in ((99 * MS, Phase.DRIVING), (100 * MS, Phase.ESTOP_ASKED)):
        state, inputs = driving(LAUNCH + 2 * S)
        assert inputs.command is not None
        both = replace(inputs, command=replace(inputs.command, brake=0.1))
        state, _ = supervise(CONFIG, state, both)
        state, _ = supervise(CONFIG, *refreshed(state, both, LAUNCH + 3 * S))
        assert decide(*refreshed(state, both, LAUNCH + 3 * S + after_ns)).phase is phase


@pytest.mark.parametrize(
    ("changes", "reason"), [({"go_signal": False}, Reason.GO_OFF), ({"fault": True}, Reason.FAULT_STATUS)]
)
def test_the_car_stopping_itself_stops_the_torque_at_once(changes: dict[str, bool], reason: Reason) -> None:
    state, inputs = driving()
    state = hear(state, DRIVING, NOW, **changes)
    state, decision = supervise(CONFIG, state, inputs)
    assert (decision.phase, decision.reasons, decision.estop) == (Phase.STOPPING, {reason}, False)
    assert decision.steer is Steer.COMMAND  # the planner did not fail
    assert decide(hear(state, DRIVING, NOW), inputs).phase is Phase.STOPPING


@pytest.mark.parametrize("reason", [Reason.INTRUDER, Reason.LOOP_FAULT])
def test_intruder_and_loop_fault_are_emergencies_when_driving(reason: Reason) -> None:
    state, inputs = driving()
    struck = supervisor.strike(state, reason, "what", NOW)
    assert struck.emergency is not None and struck.emergency.words == f"{reason.words}: what"
    assert decide(struck, inputs).estop
    for as_state in (INIT, OFF, READY, FINISHED, EMERGENCY):
        assert supervisor.strike(hear(chosen(), as_state, T0), reason, "", T0).emergency is None


def test_a_bus_loss_in_as_driving_brakes_to_rest() -> None:
    state, inputs = driving()
    state = supervisor.bus_lost(CONFIG, state, "unplugged", NOW)
    state, decision = supervise(CONFIG, state, inputs)
    assert (decision.phase, decision.estop) == (Phase.STOPPING, False)
    assert state.stop is not None and state.stop.cause is Reason.BUS_LOST


# ---------------------------------------------------------------- the stop itself


def stopping(rpm: int = 400) -> tuple[SupervisorState, Inputs]:
    """A controlled stop began at NOW with this wheel speed."""
    state, inputs = driving(rpm=rpm)
    state, _, _ = supervisor.set_mode(CONFIG, state, "manual", NOW)
    state, decision = supervise(CONFIG, state, inputs)
    assert decision.phase is Phase.STOPPING
    state, _ = supervise(CONFIG, state, inputs)
    return state, inputs


def after_stop(rpm: int, after_ns: int, state: SupervisorState | None = None) -> tuple[SupervisorState, Decision]:
    begun, inputs = stopping()
    return supervise(CONFIG, *refreshed(roll(state or begun, rpm, NOW), inputs, NOW + after_ns))


def test_a_stop_without_deceleration_is_an_emergency() -> None:
    assert after_stop(400, 500 * MS - 1)[1].phase is Phase.STOPPING
    _, decision = after_stop(400, 500 * MS)
    assert (decision.phase, decision.reasons) == (Phase.ESTOP_ASKED, {Reason.STOP_INEFFECTIVE})
    assert after_stop(392, 500 * MS)[1].phase is Phase.ESTOP_ASKED
    assert after_stop(391, 500 * MS)[1].phase is Phase.STOPPING


def test_the_deceleration_must_go_on() -> None:
    state, _ = after_stop(300, 500 * MS)
    assert after_stop(300, 1000 * MS - 1, state)[1].phase is Phase.STOPPING
    assert after_stop(300, 1000 * MS, state)[1].phase is Phase.ESTOP_ASKED


def test_a_stop_still_moving_after_3_s_is_an_emergency() -> None:
    state, _ = stopping()
    slow = replace(state, stop_window_ns=NOW + 2900 * MS, stop_window_rpm=100)
    assert after_stop(10, 3 * S - 1, slow)[1].phase is Phase.STOPPING
    assert after_stop(10, 3 * S, slow)[1].phase is Phase.ESTOP_ASKED
    assert after_stop(9, 3 * S, slow)[1].phase is Phase.STOPPING


def test_a_stop_without_wheel_speeds_is_an_emergency_after_3_s() -> None:
    state, inputs = stopping()
    silent = replace(state, speeds_ns=None, stop_window_rpm=None, driving_since_ns=NOW + 1 * S)
    for after_ns, phase in ((3 * S - 1, Phase.STOPPING), (3 * S, Phase.ESTOP_ASKED)):
        fresh = replace(silent, status_ns=NOW + after_ns)
        assert decide(fresh, replace(inputs, now_ns=NOW + after_ns)).phase is phase


def test_a_wheel_speed_before_the_stop_is_not_its_first() -> None:
    state = replace(launched(), sequence=Sequence.NONE, driving_since_ns=NOW)
    state, _ = supervise(CONFIG, replace(state, status_ns=NOW), Inputs(NOW))
    for ms in range(100, 700, 100):  # the first wheel speeds come after the stop has begun
        state = roll(replace(state, status_ns=NOW + ms * MS), 500 - ms // 4, NOW + ms * MS)
        state, decision = supervise(CONFIG, state, Inputs(NOW + ms * MS))
        assert decision.phase is Phase.STOPPING


def test_finished_needs_half_a_second_of_standstill_and_stays() -> None:
    begun, inputs = stopping()
    at_ns = NOW + 500 * MS
    begun, inputs = refreshed(replace(begun, fastest_rpm=0, still_since_ns=NOW, speeds_ns=at_ns - 1), inputs, at_ns)
    assert decide(replace(begun, still_since_ns=NOW + 1), inputs).phase is Phase.STOPPING
    state, decision = supervise(CONFIG, begun, inputs)
    assert (decision.phase, decision.mission_status) == (Phase.STOPPED, MissionStatus.FINISHED)
    assert (decision.direction, decision.brake, decision.torque) == (Direction.NEUTRAL, Brake.HOLDING, False)
    for _ in range(1000):
        state, decision = supervise(CONFIG, *refreshed(state, inputs, inputs.now_ns + 10 * MS))
        inputs = replace(inputs, now_ns=inputs.now_ns + 10 * MS)
        assert decision.phase is Phase.STOPPED
    assert decide(hear(state, FINISHED, inputs.now_ns), inputs).mission_status is MissionStatus.FINISHED


def test_rolling_after_finished_is_braked_in_forward_again() -> None:
    state, inputs = stopping()
    at_ns = NOW + 600 * MS
    state = replace(state, fastest_rpm=0, still_since_ns=NOW, speeds_ns=at_ns - 1)
    state, inputs = refreshed(state, inputs, at_ns)
    state, decision = supervise(CONFIG, state, inputs)
    assert decision.phase is Phase.STOPPED
    decision = decide(roll(state, 10, NOW + 600 * MS), inputs)
    assert (decision.phase, decision.direction) == (Phase.STOPPING, Direction.FORWARD)


def test_a_finished_mission_stops_with_steering_and_keeps_mode() -> None:
    state, inputs = driving()
    assert inputs.command is not None
    state, decision = supervise(CONFIG, state, replace(inputs, command=replace(inputs.command, mission_finished=True)))
    assert (decision.phase, decision.steer, decision.reasons) == (Phase.STOPPING, Steer.COMMAND, frozenset())
    assert state.mode is Mode.AUTONOMOUS and state.stop is not None and state.stop.cause is Asked.MISSION_DONE
    # the planner may fall silent now: that is no fault any more
    silent = refreshed(state, replace(inputs, command=None), NOW + 400 * MS)
    decision = decide(*silent)
    assert (decision.phase, decision.steer, decision.reasons) == (Phase.STOPPING, Steer.HELD, frozenset())


def test_a_mission_is_not_done_before_it_may_begin() -> None:
    state, inputs = driving(LAUNCH + 1 * S)
    assert inputs.command is not None
    done = replace(inputs, command=replace(inputs.command, mission_finished=True))
    assert decide(state, done).phase is Phase.LAUNCH_WAIT


def test_a_stop_in_the_first_three_seconds_does_not_steer() -> None:
    for now_ns, steer in ((LAUNCH + 3 * S - 1, Steer.HELD), (LAUNCH + 3 * S, Steer.COMMAND)):
        state, inputs = driving(now_ns, rpm=0)
        assert decide(hear(state, DRIVING, now_ns, go_signal=False), inputs).steer is steer


def test_the_mission_may_end_with_an_emergency_brake() -> None:
    state, inputs = driving()
    assert inputs.command is not None
    wish = replace(inputs, command=replace(inputs.command, estop_request=True))
    state_after, decision = supervise(CONFIG, state, wish)
    assert (decision.estop, decision.reasons) == (True, frozenset())
    assert state_after.emergency is not None and state_after.emergency.cause is Asked.MISSION
    stale = replace(wish, command_ns=NOW - 100 * MS)
    assert not decide(state, stale).estop
    manual, _, _ = supervisor.set_mode(CONFIG, state, "manual", NOW)
    assert not decide(manual, wish).estop


def test_a_stop_ends_with_as_driving_and_the_next_run_is_free() -> None:
    state, _ = stopping()
    for as_state in (FINISHED, OFF, READY, DRIVING):
        state = hear(state, as_state, NOW)
    assert state.stop is None and state.sequence is Sequence.COMPLETE


# ---------------------------------------------------------------- the end of the process


def test_an_orderly_end_at_rest_says_zeros_and_neutral() -> None:
    for state in (chosen(), hear(chosen(), READY, T0)):
        assert supervisor.begin_end(CONFIG, state, T0) == state
        decision = supervisor.ending(decide(state, Inputs(T0)))
        assert (decision.mission_status, decision.direction) == (MissionStatus.NOT_SELECTED, Direction.NEUTRAL)
        assert (decision.steer, decision.brake) == (Steer.ZERO, Brake.ZERO)


def test_an_orderly_end_at_rest_in_as_driving_finishes_the_run() -> None:
    state, inputs = driving(rpm=0)
    state = supervisor.begin_end(CONFIG, replace(state, still_since_ns=NOW - 500 * MS), NOW)
    assert state.emergency is None
    decision = supervisor.ending(decide(state, inputs))
    assert (decision.mission_status, decision.direction) == (MissionStatus.FINISHED, Direction.NEUTRAL)
    assert decision.brake is Brake.ZERO
    assert (decision.steer, decision.torque, decision.estop) == (Steer.ZERO, False, False)
    assert state.stop is not None and state.stop.words == "this software was stopped"


def test_an_orderly_end_while_moving_leaves_the_car_to_its_brake() -> None:
    state, inputs = driving()
    decision = supervisor.ending(decide(supervisor.begin_end(CONFIG, state, NOW), inputs))
    assert (decision.estop, decision.direction, decision.brake) == (True, Direction.FORWARD, Brake.SERVICE)


# ---------------------------------------------------------------- what a valid command is


@pytest.mark.parametrize(
    "age",
    [
        lambda inputs, ns: replace(inputs, command_ns=NOW - 100 * MS + ns),
        lambda inputs, ns: replace(inputs, command=replace(inputs.command, t_sensor_ns=NOW - 500 * MS + ns)),
        lambda inputs, ns: replace(inputs, command=replace(inputs.command, run_id=inputs.command.run_id + 1 - ns)),
    ],
)
def test_a_command_that_is_not_valid_any_more_asks_for_nothing(age: Any) -> None:
    """Of 100 ms, with data of 500 ms, or of another run."""
    state, inputs = driving()
    assert inputs.command is not None
    estop = replace(inputs, command=replace(inputs.command, estop_request=True))
    done = replace(inputs, command=replace(inputs.command, mission_finished=True))
    for ns, obeyed in ((1, True), (0, False)):
        assert decide(state, age(estop, ns)).estop is obeyed
        after, _ = supervise(CONFIG, state, age(done, ns))
        assert (after.stop is not None and after.stop.cause is Asked.MISSION_DONE) is obeyed


def test_a_command_of_another_run_blocks_torque_from_3_s_on() -> None:
    state, inputs = driving(LAUNCH + 3 * S)
    assert inputs.command is not None
    other = replace(inputs, command=replace(inputs.command, run_id=state.run_id - 1))
    assert decide(state, other).phase is Phase.HOLDING
    assert decide(state, inputs).phase is Phase.DRIVING


def test_a_command_lost_before_3_s_counts_as_lost_from_3_s_on() -> None:
    for after_ns, phase in ((0, Phase.HOLDING), (300 * MS - 1, Phase.HOLDING), (300 * MS, Phase.STOPPING)):
        state, inputs = driving(LAUNCH + 3 * S + after_ns)
        assert decide(state, replace(inputs, command_ns=LAUNCH + 1 * S)).phase is phase


def test_manual_asked_for_while_the_command_is_stale_is_no_fault() -> None:
    state, inputs = aged_command(300 * MS)
    state, _, _ = supervisor.set_mode(CONFIG, state, "manual", NOW)
    state, decision = supervise(CONFIG, state, inputs)
    assert (decision.phase, decision.reasons) == (Phase.STOPPING, frozenset())
    assert state.stop is not None and state.stop.words == "manual mode was asked for"


def test_the_brake_alone_is_not_both_pedals() -> None:
    state, inputs = driving()
    assert inputs.command is not None
    for throttle, brake in ((0.0, 0.5), (0.5, 0.0), (0.0, 0.0)):
        one = replace(inputs, command=replace(inputs.command, throttle=throttle, brake=brake))
        assert decide(state, one).reasons == frozenset()


def both_pedals(inputs: Inputs) -> Inputs:
    assert inputs.command is not None
    return replace(inputs, command=replace(inputs.command, throttle=0.5, brake=0.1))


def test_both_pedals_of_a_command_before_3_s_count_from_3_s_on() -> None:
    for after_ns, phase in ((100 * MS - 1, Phase.DRIVING), (100 * MS, Phase.ESTOP_ASKED)):
        state, inputs = driving(LAUNCH + 3 * S)
        state, _ = supervise(CONFIG, state, replace(both_pedals(inputs), command_ns=LAUNCH + 3 * S - 50 * MS))
        assert decide(*refreshed(state, both_pedals(inputs), LAUNCH + 3 * S + after_ns)).phase is phase


def test_both_pedals_are_timed_across_the_frames_of_the_car() -> None:
    state, inputs = driving()
    for n in range(10):
        now_ns = NOW + n * 10 * MS
        state, decision = supervise(CONFIG, *refreshed(hear(state, DRIVING, now_ns), both_pedals(inputs), now_ns))
        assert decision.phase is Phase.DRIVING
    assert decide(*refreshed(state, both_pedals(inputs), NOW + 100 * MS)).phase is Phase.ESTOP_ASKED


def test_both_pedals_of_the_last_run_do_not_count_in_the_next() -> None:
    state, inputs = driving()
    state, _ = supervise(CONFIG, state, both_pedals(inputs))
    state = confirmed(hear(state, OFF, NOW))
    again_ns = NOW + 10 * S
    state = ready(again_ns, replace(state, heard_ns=again_ns - 5 * S))
    state = hear(state, DRIVING, again_ns)
    _, late = driving(again_ns + 3 * S)
    assert late.command is not None
    late = replace(late, command=replace(late.command, run_id=state.run_id))
    decision = decide(*refreshed(state, both_pedals(late), again_ns + 3 * S))
    assert (decision.phase, decision.reasons) == (Phase.DRIVING, {Reason.BOTH_PEDALS})


def test_both_pedals_do_not_release_torque_that_others_block() -> None:
    state, inputs = driving()
    decision = decide(replace(state, status_ns=NOW - 60 * MS), both_pedals(inputs))
    assert (decision.phase, decision.reasons) == (Phase.HOLDING, {Reason.VCU_SILENT, Reason.BOTH_PEDALS})


# ---------------------------------------------------------------- the words of what latched


@pytest.mark.parametrize(
    ("reason", "happens"),
    [
        (Reason.VCU_SILENT, lambda state, inputs: (replace(state, status_ns=NOW - 100 * MS), inputs)),
        (Reason.WHEELS_STALE, lambda state, inputs: (replace(state, speeds_ns=NOW - 100 * MS), inputs)),
        (Reason.STEERING_STALE, lambda state, inputs: (state, replace(inputs, steer_ns=NOW - 100 * MS))),
        (
            Reason.STEERING_IMPLAUSIBLE,
            lambda state, inputs: (state, replace(inputs, steer_implausible_since_ns=NOW - 300 * MS)),
        ),
        (Reason.GO_OFF, lambda state, inputs: (replace(state, go=False), inputs)),
        (Reason.FAULT_STATUS, lambda state, inputs: (replace(state, fault=True), inputs)),
        (Reason.NOT_SEEN, lambda state, inputs: (replace(state, sequence=Sequence.NONE), inputs)),
        (
            Reason.BOTH_PEDALS,
            lambda state, inputs: (replace(state, both_pedals_since_ns=NOW - 100 * MS), both_pedals(inputs)),
        ),
    ],
)
def test_what_says_all_by_itself_is_told_in_its_own_words(reason: Reason, happens: Any) -> None:
    state, _ = supervise(CONFIG, *happens(*driving()))
    latch = state.stop or state.emergency
    assert latch is not None and latch.words == reason.words


@pytest.mark.parametrize(
    ("silent_ns", "data_ns", "detail"),
    [
        (300 * MS, 310 * MS, "no command for 300 ms"),
        (100 * MS, 700 * MS, "no command for 100 ms"),
        (10 * MS, 700 * MS, "commands keep coming, but the data behind them is 700 ms old"),
        (None, None, "no command has come in run 2"),
    ],
)
def test_a_stale_command_is_told_by_what_is_missing(silent_ns: int | None, data_ns: int | None, detail: str) -> None:
    state, inputs = driving()
    assert inputs.command is not None
    if silent_ns is None or data_ns is None:
        inputs = replace(inputs, command=None)
    else:
        command = replace(inputs.command, t_sensor_ns=NOW - data_ns)
        inputs = replace(inputs, command=command, command_ns=NOW - silent_ns)
    state, decision = supervise(CONFIG, state, inputs)
    assert dict(decision.details) == {Reason.COMMAND_STALE: detail}
    assert state.stop is not None and state.stop.words == f"{Reason.COMMAND_STALE.words}: {detail}"


def test_a_command_of_an_earlier_run_is_none_in_words_too() -> None:
    state, inputs = driving()
    assert inputs.command is not None
    inputs = replace(inputs, command=replace(inputs.command, run_id=state.run_id - 1))
    assert dict(decide(state, inputs).details) == {Reason.COMMAND_STALE: "no command has come in run 2"}


def test_wheel_speeds_not_believed_are_told_with_the_stop() -> None:
    state, inputs = driving()
    doubted = replace(inputs, speeds_doubt="the front left wheel reads more than 1250 rpm")
    state, _ = supervise(CONFIG, replace(state, speeds_ns=NOW - 100 * MS), doubted)
    assert state.stop is not None and state.stop.words.endswith(
        "believed: the front left wheel reads more than 1250 rpm"
    )


def test_what_was_asked_for_is_told_in_its_own_words() -> None:
    state, inputs = driving()
    assert inputs.command is not None
    for changes, words in (
        ({"mission_finished": True}, "the mission is done"),
        ({"estop_request": True}, "the mission or its controller asked for the emergency brake"),
    ):
        after, _ = supervise(CONFIG, state, replace(inputs, command=replace(inputs.command, **changes)))
        latch = after.stop or after.emergency
        assert latch is not None and latch.words == words


def test_who_has_not_confirmed_is_named() -> None:
    state, inputs = driving()
    for lacking, names in (
        ({"planner"}, "controller"),
        ({"controller"}, "planner"),
        (set[str](), "planner and controller"),
    ):
        after, _ = supervise(CONFIG, replace(state, confirmed=frozenset(lacking)), inputs)
        assert after.stop is not None and after.stop.words.endswith(f": run {state.run_id} by the {names}")


def test_a_stop_without_effect_reports_the_wheel_speed() -> None:
    state, _ = after_stop(400, 500 * MS)
    assert state.emergency is not None
    assert state.emergency.words == "the service brake does not stop the car: 400 rpm"


def test_an_end_while_moving_reports_unknown_standstill() -> None:
    state = supervisor.begin_end(CONFIG, driving()[0], NOW)
    assert state.emergency is not None
    assert state.emergency.words == "this software was stopped: the car was in AS_DRIVING and not known to stand"


def test_the_answer_to_manual_says_what_happens() -> None:
    off, (moving, _) = hear(SupervisorState(), OFF, T0), driving()
    assert supervisor.set_mode(CONFIG, off, "manual", T0)[2] == "mode is manual"
    assert supervisor.set_mode(CONFIG, moving, "manual", NOW)[2] == "mode is manual: the car is being stopped"


def test_a_refusal_to_reset_says_why_nobody_knows_the_as_state() -> None:
    assert supervisor.reset(CONFIG, SupervisorState(), T0)[2] == (
        "reset refused: the car has not said its AS state yet (no 0x520)"
    )


# ---------------------------------------------------------------- what ends with a state, and what does not


def test_what_led_to_a_stop_is_not_found_again_in_it() -> None:
    for changes in ({"sequence": Sequence.NONE}, {"confirmed": frozenset[str]()}):
        state, inputs = driving()
        state, decision = supervise(CONFIG, replace(state, **changes), inputs)
        assert decision.phase is Phase.STOPPING and len(decision.reasons) == 1
        assert decide(state, inputs).reasons == frozenset()


def test_started_in_as_driving_it_knows_the_mission_of_the_car() -> None:
    state = hear(SupervisorState(), DRIVING, T0, ami=Ami.SKIDPAD)
    assert (state.mission, state.run_id) == (Ami.SKIDPAD, 2)


def test_an_ami_that_is_turned_while_driving_disturbs_nothing() -> None:
    state, inputs = driving()
    state = hear(state, DRIVING, NOW, ami=Ami.ACCELERATION)
    assert decide(state, inputs).phase is Phase.DRIVING


def test_the_times_of_a_state_end_with_it() -> None:
    ready = hear(chosen(), READY, T0)
    assert (ready.ready_since_ns, ready.driving_since_ns) == (T0, None)
    assert hear(ready, READY, T0 + 1).ready_since_ns == T0
    begun = hear(ready, DRIVING, T0 + 2)
    assert (begun.ready_since_ns, begun.driving_since_ns) == (None, T0 + 2)
    assert hear(begun, DRIVING, T0 + 3).driving_since_ns == T0 + 2
    assert hear(begun, FINISHED, T0 + 3).driving_since_ns is None


def test_outside_as_driving_nothing_may_move() -> None:
    assert not supervisor.may_move(CONFIG, SupervisorState(), T0)
    for as_state in (FINISHED, EMERGENCY, OFF):
        state = hear(launched(), as_state, LAUNCH)
        assert not decide(state, Inputs(LAUNCH + 5 * S)).may_move


def test_manual_before_the_car_was_seen_at_rest_stays_manual() -> None:
    state, _, _ = supervisor.set_mode(POWER_UP, at_rest(OFF, T0), "manual", T0)
    state = hear(state, OFF, T0)
    assert supervise(POWER_UP, state, Inputs(T0))[0].mode is Mode.MANUAL


@pytest.mark.parametrize("by_whom", ["itself", "somebody"])
def test_a_lost_mode_returns_only_at_the_next_power_up(by_whom: str) -> None:
    state = at_rest(OFF, T0)
    if by_whom == "itself":
        state, _ = supervise(POWER_UP, state, Inputs(T0))
    else:
        state, _, _ = supervisor.set_mode(POWER_UP, state, "autonomous", T0)
    assert state.mode is Mode.AUTONOMOUS
    lost = replace(state, mode=Mode.MANUAL)  # as the loss of a command does
    assert supervise(POWER_UP, lost, Inputs(T0))[0].mode is Mode.MANUAL


def test_in_as_ready_selected_stays_in_any_mode_and_emergency() -> None:
    ready = hear(chosen(), READY, T0)
    for state in (replace(ready, mode=Mode.MANUAL), supervisor.ask_emergency(ready, Asked.OPERATOR, "", T0)):
        assert decide(state, Inputs(T0)).mission_status is MissionStatus.SELECTED


# ---------------------------------------------------------------- steering while stopping


@pytest.mark.parametrize(
    ("cause", "steer"),
    [
        (Asked.MISSION_DONE, Steer.COMMAND),
        (Reason.GO_OFF, Steer.COMMAND),
        (Reason.FAULT_STATUS, Steer.COMMAND),
        (Reason.WHEELS_STALE, Steer.COMMAND),
        (Reason.WHEEL_IMPLAUSIBLE, Steer.COMMAND),
        (Reason.STEERING_STALE, Steer.HELD),
        (Reason.STEERING_IMPLAUSIBLE, Steer.HELD),
        (Reason.COMMAND_STALE, Steer.HELD),
        (Reason.BUS_LOST, Steer.HELD),
        (Reason.AS_SWITCH_OFF, Steer.COMMAND),
        (Reason.TS_SWITCH_OFF, Steer.COMMAND),
        (Reason.SHUTDOWN_REQUESTED, Steer.COMMAND),
        (Reason.FAULT_BIT, Steer.COMMAND),
        (Reason.SHUTDOWN_CAUSE, Steer.COMMAND),
        (Reason.SEQUENCE_SHORT, Steer.HELD),
        (Reason.NO_MISSION, Steer.HELD),
        (Reason.NOT_SEEN, Steer.HELD),
        (Reason.NOT_CONFIRMED, Steer.HELD),
        (Reason.STACK_RESTARTED, Steer.HELD),
        (Asked.MANUAL, Steer.HELD),
        (Asked.SHUTDOWN, Steer.HELD),
    ],
)
def test_a_stop_steers_unless_planner_or_steering_failed(cause: Reason | Asked, steer: Steer) -> None:
    state, inputs = driving()
    state = replace(state, stop=supervisor.Latch(cause, NOW))
    assert decide(state, inputs).steer is steer
    assert decide(replace(state, mode=Mode.MANUAL), inputs).steer is Steer.HELD
    assert decide(state, replace(inputs, command=None)).steer is Steer.HELD


# ---------------------------------------------------------------- standing still, and a stop that shows no effect


def test_standstill_is_seen_half_a_second_after_coming_to_rest() -> None:
    state = roll(roll(SupervisorState(), 100, T0), 0, T0 + 10 * MS)
    for n in range(1, 51):
        assert not supervisor.standing(CONFIG, state, state.speeds_ns or 0)
        state = roll(state, 0, T0 + 10 * MS + n * 10 * MS)
    assert supervisor.standing(CONFIG, state, T0 + 510 * MS)


def test_a_stop_that_loses_speeds_is_an_emergency_after_3_s() -> None:
    state, inputs = stopping()
    silent = replace(state, fastest_rpm=0, driving_since_ns=NOW + 1 * S)
    for after_ns, phase in ((3 * S - 1, Phase.STOPPING), (3 * S, Phase.ESTOP_ASKED)):
        fresh = replace(silent, status_ns=NOW + after_ns)
        assert decide(fresh, replace(inputs, now_ns=NOW + after_ns)).phase is phase


def test_stale_wheel_speeds_prove_no_missing_deceleration() -> None:
    state, inputs = stopping()
    later_ns = NOW + 500 * MS
    silent = replace(state, driving_since_ns=NOW + 1 * S, status_ns=later_ns, speeds_ns=later_ns - 100 * MS)
    assert decide(silent, replace(inputs, now_ns=later_ns)).reasons == frozenset()
    heard_ns = later_ns - 100 * MS + 1
    assert decide(replace(silent, speeds_ns=heard_ns), replace(inputs, now_ns=later_ns)).reasons == {
        Reason.STOP_INEFFECTIVE
    }


def test_the_deceleration_of_a_stop_counts_from_its_own_start() -> None:
    state, inputs = driving(rpm=400)
    state = replace(state, stop_window_ns=NOW - 60 * S, stop_window_rpm=100)  # of a stop in an earlier run
    state, _, _ = supervisor.set_mode(CONFIG, state, "manual", NOW)
    for n in range(50):
        state, decision = supervise(CONFIG, *refreshed(state, inputs, NOW + n * 10 * MS))
        assert decision.phase is Phase.STOPPING


# ---------------------------------------------------------------- the bus goes and comes back


def test_a_silence_of_1_s_before_a_bus_loss_is_a_power_cycle() -> None:
    for silence_ns, cleared in ((1 * S - 1, False), (1 * S, True)):
        state = supervisor.bus_lost(CONFIG, latched(EMERGENCY), "unplugged", T0 + silence_ns)
        state = supervisor.bus_back(state, T0 + silence_ns)
        assert (hear(state, OFF, T0 + silence_ns).emergency is None) is cleared


def test_the_time_without_a_bus_is_no_silence_of_the_car() -> None:
    state = supervisor.bus_lost(CONFIG, latched(EMERGENCY), "unplugged", T0)
    back_ns = T0 + 60 * S
    assert hear(supervisor.bus_back(state, back_ns), OFF, back_ns + 1 * S - 1).emergency is not None
    assert hear(supervisor.bus_back(state, back_ns), OFF, back_ns + 1 * S).emergency is None
    never = supervisor.bus_back(supervisor.ask_emergency(SupervisorState(), Asked.OPERATOR, "", T0), back_ns)
    assert hear(never, OFF, back_ns + 60 * S).emergency is not None


def test_the_time_without_a_bus_is_no_part_of_a_stop() -> None:
    state, inputs = stopping(rpm=1000)
    back_ns = NOW + 60 * S
    state = supervisor.bus_back(supervisor.bus_lost(CONFIG, state, "unplugged", NOW), back_ns)
    assert state.stop is not None and (state.stop.cause, state.stop.since_ns) == (Asked.MANUAL, back_ns)
    later = refreshed(roll(state, 1000, back_ns), inputs, back_ns)
    state, decision = supervise(CONFIG, *later)
    assert decision.phase is Phase.STOPPING  # the wheels did not slow down while nothing could be said
    assert decide(*refreshed(state, inputs, back_ns + 500 * MS - 1)).phase is Phase.STOPPING
    assert decide(*refreshed(state, inputs, back_ns + 500 * MS)).phase is Phase.ESTOP_ASKED


def test_after_a_bus_loss_the_feedback_has_3_s_to_return() -> None:
    state, _ = driving()
    back_ns = NOW + 60 * S
    state = supervisor.bus_back(supervisor.bus_lost(CONFIG, state, "unplugged", NOW), back_ns)
    for after_ns, phase in ((3 * S - 1, Phase.STOPPING), (3 * S, Phase.ESTOP_ASKED)):
        now_ns = back_ns + after_ns
        waiting = replace(state, status_ns=now_ns, stop=supervisor.Latch(Reason.BUS_LOST, now_ns))
        assert decide(waiting, Inputs(now_ns)).phase is phase
    idle = supervisor.bus_back(hear(chosen(), OFF, T0), T0 + 60 * S)
    assert (idle.driving_since_ns, idle.stop) == (None, None)


# ---------------------------------------------------------------- a process that is restarted (rule 10)


@pytest.mark.parametrize("role", supervisor.ROLES)
def test_a_reset_confirmed_again_in_as_driving_stops_the_car(role: str) -> None:
    state, inputs = driving()
    state = supervisor.confirm(state, role, state.run_id)
    state, decision = supervise(CONFIG, state, inputs)
    assert (decision.phase, state.mode) == (Phase.STOPPING, Mode.AUTONOMOUS)
    assert state.stop is not None and state.stop.cause is Reason.STACK_RESTARTED
    assert (state.stop.detail, state.stop.since_ns) == (role, NOW)


def test_a_first_confirmation_or_one_elsewhere_stops_nothing() -> None:
    for state in (SupervisorState(), chosen(), hear(chosen(), READY, T0), hear(launched(), EMERGENCY, LAUNCH)):
        assert supervisor.confirm(confirmed(state), "planner", state.run_id) == confirmed(state)
    late, _ = driving()
    assert confirmed(replace(late, confirmed=frozenset())).stop is None


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
    config = official_simulator()
    assert config.motor_brakes and config.held_brake_pct == 0.0
    assert official_simulator(BridgeConfig(autonomous_at_power_up=True)).autonomous_at_power_up
    assert not CONFIG.motor_brakes and CONFIG.held_brake_pct == CONFIG.holding_brake_pct


def test_the_numbers_of_the_safety_rules_are_the_defaults() -> None:
    assert Consequence.ESTOP > Consequence.STOP > Consequence.HOLD
    assert (CONFIG.listen_first_ns, CONFIG.launch_wait_ns, CONFIG.power_cycle_ns) == (200 * MS, 3 * S, 1 * S)
    assert (CONFIG.command_stale_ns, CONFIG.command_lost_ns, CONFIG.sensor_stale_ns) == (100 * MS, 300 * MS, 500 * MS)
    assert (CONFIG.vcu_stale_ns, CONFIG.vcu_lost_ns) == (50 * MS, 100 * MS)
    assert (CONFIG.feedback_stale_ns, CONFIG.feedback_lost_ns) == (100 * MS, 300 * MS)
    assert (CONFIG.implausible_ns, CONFIG.implausible_lost_ns) == (300 * MS, 600 * MS)
    assert (CONFIG.stop_timeout_ns, CONFIG.standstill_ns, CONFIG.standstill_rpm) == (3 * S, 500 * MS, 10)
    assert (CONFIG.both_pedals_ns, CONFIG.send_lost_ns, CONFIG.stop_cycles) == (100 * MS, 50 * MS, 5)
