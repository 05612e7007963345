"""*Why not driving?*: every condition on both sides is named while it is unmet, and nothing is named while driving."""

from __future__ import annotations

from collections.abc import Set
from typing import Any

import pytest
from msgspec.structs import replace
from supervision_rig import Rig, driven

from fsai_hil.evidence.small_car import WELL
from fsai_vcu.core.bridge import BridgeConfig
from fsai_vcu.core.supervision.config import official_simulator, words_of
from fsai_vcu.core.supervision.readiness import Circumstances, why_not_driving
from fsai_vcu.core.supervision.start_conditions import CONDITIONS, WORDS, Moment, seen_met, unmet
from fsai_vcu.core.supervision.start_conditions import why_not_driving as shown_by_the_bus
from fsai_vcu.core.supervision.supervisor import ROLES, Asked, Latch, Mode, Phase, Sequence, SupervisorState
from fsai_vcu.interface.enums import (
    OFF_LIKE,
    Ami,
    AsState,
    BrakeStatus,
    Direction,
    EbsState,
    EbsStatus,
    MissionStatus,
    OpState,
    ShutdownCause,
    SteeringStatus,
    TsState,
)
from fsai_vcu.interface.messages import AiCommand, Faults, VcuBrake, VcuStatus, VcuSteer, VehicleState
from fsai_vcu.interface.units import MS, S

# ---------------------------------------------------------------- what the bridge adds


STOPPED = "this software was stopped and sends nothing any more"
LISTENING = "listening before the first cycle is sent"


def test_what_happens_to_the_bridge_is_named() -> None:
    rig = Rig()
    rig.step()
    assert LISTENING in rig.report.why_not_driving
    rig.autonomous()
    rig.bridge.bus_lost("no such device", rig.now_ns)
    assert "the bus is lost: no such device" in rig.report.why_not_driving
    rig.bridge.bus_back(rig.now_ns)
    rig.bridge.begin_stop(rig.now_ns)
    rig.step(6)
    assert STOPPED in rig.report.why_not_driving


def test_nothing_is_unmet_while_driving() -> None:
    assert driven().report.why_not_driving == ()


def test_what_the_controller_reports_is_told_in_as_driving() -> None:
    said = "the controller reports: no path: no cones"
    for phase, told in ((Phase.DRIVING, [said]), (Phase.HOLDING, [NO_COMMAND, said]), (Phase.STOPPING, [NO_COMMAND])):
        assert list(answer(AsState.AS_DRIVING, now=Circumstances(phase, note="no path: no cones"))) == told


# ---------------------------------------------------------------- the whole answer, condition by condition

NOW = 1000 * S
INIT, OFF, READY, DRIVING = AsState.AS_INIT, AsState.AS_OFF, AsState.AS_READY, AsState.AS_DRIVING
GO = "waiting for Go"
NOT_SELECTED = WORDS["status_not_selected"]
NO_COMMAND = "no fresh command from the controller, or 0x520 is late or not known: torque is held at 0"


def car(as_state: AsState, status: dict[str, Any] | None = None, vehicle: dict[str, Any] | None = None) -> VehicleState:
    """All is as it should be, but for these fields of 0x520 and these messages."""
    go = as_state is DRIVING
    said: dict[str, Any] = {
        "status": replace(WELL, **{"as_state": as_state, "go_signal": go, **(status or {})}),
        "brake": VcuBrake(brake_status=BrakeStatus.READY, ebs_status=EbsStatus.ARMED),
        "steer": VcuSteer(0.0, 30.0, 0.0),
        **(vehicle or {}),
    }
    return VehicleState(**said)


def answer(
    as_state: AsState = READY,
    *,
    status: dict[str, Any] | None = None,
    vehicle: dict[str, Any] | None = None,
    state: dict[str, Any] | None = None,
    now: Circumstances | None = None,
    config: BridgeConfig | None = None,
) -> tuple[str, ...]:
    """Asked of a car and a process of which all is as it should be, but for what the test changes."""
    known: dict[str, Any] = {
        "as_state": as_state,
        "status_ns": NOW,
        "sequence": Sequence.COMPLETE if as_state is DRIVING else Sequence.READY_SEEN,
        "ready_since_ns": NOW - 5 * S,
        "driving_since_ns": NOW - 3 * S,
        "run_id": 2,
        "mission": Ami.TRACKDRIVE,
        "confirmed": frozenset(ROLES),
        "mode": Mode.AUTONOMOUS,
        **(state or {}),
    }
    return why_not_driving(
        config or BridgeConfig(),
        SupervisorState(**known),
        car(as_state, status, vehicle),
        now or Circumstances(Phase.READY),
        NOW,
    )


@pytest.mark.parametrize(
    "unknown",
    [
        {"vehicle": {"brake": VcuBrake(ebs_status=EbsStatus.UNAVAILABLE)}},  # 0x520 says that the EBS is armed
        {"status": {"ebs_state": None}, "vehicle": {"brake": None, "steer": None}},
        {"status": {"as_switch": None, "ts_switch": None, "steering_status": None}},
    ],
)
def test_unknown_values_and_0x524_beside_0x520_are_not_named(unknown: dict[str, Any]) -> None:
    assert answer(**unknown) == (GO,)


def test_in_as_ready_the_rest_of_5_s_is_told() -> None:
    for since_ns, left in (
        (NOW - 5 * S, ()),
        (NOW - 5 * S + 1, ("waiting in AS_READY: 0.0 s of 5 s left",)),
        (NOW - 1 * S, ("waiting in AS_READY: 4.0 s of 5 s left",)),
        (None, ("waiting in AS_READY: 5.0 s of 5 s left",)),
    ):
        assert answer(state={"ready_since_ns": since_ns}) == (*left, GO)


def test_in_as_driving_the_rest_of_3_s_is_reported_first() -> None:
    for since_ns, held in (
        (NOW - 3 * S, NO_COMMAND),
        (NOW - 3 * S + 1, "waiting 3 s at standstill after AS_DRIVING: 0.0 s left"),
        (NOW - 1 * S, "waiting 3 s at standstill after AS_DRIVING: 2.0 s left"),
        (None, "waiting 3 s at standstill after AS_DRIVING: 3.0 s left"),
    ):
        assert answer(DRIVING, state={"driving_since_ns": since_ns}) == (held,)
    assert answer(DRIVING, status={"go_signal": False}) == (OTHERWISE["go_off"][2], NO_COMMAND)


def test_a_stop_and_an_emergency_say_all_about_the_torque() -> None:
    stopping = "stopping for the rest of this run because manual mode was asked for"
    assert answer(DRIVING, state={"stop": Latch(Asked.MANUAL, NOW)}) == (stopping,)
    latched = (
        "ESTOP_REQUEST is latched because the emergency brake was asked for: "
        "reset in AS_INIT or AS_OFF, or switch the car off and on"
    )
    assert answer(DRIVING, state={"emergency": Latch(Asked.OPERATOR, NOW)}) == (latched,)


@pytest.mark.parametrize("as_state", [READY, DRIVING])
def test_a_sequence_not_seen_is_named_in_as_ready_and_as_driving(as_state: AsState) -> None:
    unseen = (
        f"this process did not see AS_OFF, AS_READY and AS_DRIVING follow one another (the car is in "
        f"{as_state.label}): the car must go through AS_OFF first"
    )
    assert answer(as_state, state={"sequence": Sequence.NONE})[0] == unseen
    assert unseen not in answer(as_state)


def test_a_sequence_that_may_be_short_is_told_in_as_ready() -> None:
    relaxed = "AS_DRIVING is accepted without the 5 s and an edge of Go (short_sequence_allowed)"
    assert relaxed in answer(READY, config=official_simulator())
    assert relaxed not in answer(READY)
    assert relaxed not in answer(DRIVING, config=official_simulator())


def test_in_as_off_what_is_waited_for_depends_on_what_is_said() -> None:
    for as_state in (INIT, OFF):
        selected = Circumstances(Phase.READY, SELECTED)
        waiting = f"waiting for AS_READY: the car is in {as_state.label}, and every condition that the bus shows is met"
        assert answer(as_state, now=selected) == (waiting,)
        assert answer(as_state, state={"sequence": Sequence.NONE}, now=selected) == (waiting,)
        manual = "mode is manual: set autonomous in AS_INIT, AS_OFF or AS_READY"
        assert answer(as_state, state={"mode": Mode.MANUAL}) == (manual, NOT_SELECTED)


def test_without_a_mission_nobody_is_asked_to_confirm() -> None:
    none = {"mission": Ami.NOT_SELECTED, "confirmed": frozenset()}
    assert answer(OFF, status={"ami": Ami.NOT_SELECTED}, state=none) == (OTHERWISE["no_mission"][2], NOT_SELECTED)
    for mission in (ami for ami in Ami if ami is not Ami.NOT_SELECTED):
        missing = f"the controller has not confirmed its reset for run 2 ({mission.label})"
        assert answer(state={"mission": mission, "confirmed": frozenset({"planner"})}) == (missing, GO)


def test_a_run_that_has_ended_is_said_to_have_ended() -> None:
    assert answer(AsState.AS_FINISHED) == ("the mission is finished (AS_FINISHED): ASMS off ends the run",)
    braked = {"shutdown_cause": ShutdownCause.AI_COMPUTER_REQUEST, "faults": Faults(ai_estop_request=True)}
    assert answer(AsState.EMERGENCY_BRAKE, status=braked) == (
        "EMERGENCY_BRAKE: wait 15 s, ASMS off, then switch the car off and on "
        "(AI_ESTOP_REQUEST, SHUTDOWN_CAUSE AI_COMPUTER_REQUEST)",
    )


def test_a_0x520_that_never_came_or_is_100_ms_old_is_named() -> None:
    silent = "0x520 is missing for 100 ms: the car is silent (its last AS state was AS_READY)"
    assert answer(state={"status_ns": NOW - 100 * MS + 1}) == (GO,)
    assert answer(state={"status_ns": NOW - 100 * MS}) == (silent,)
    assert answer(state={"status_ns": None}) == answer(vehicle={"status": None}) == ("no 0x520 from the car yet",)


def test_the_driving_phase_is_driving_only_if_frames_go_out() -> None:
    driving = Circumstances(Phase.DRIVING)
    assert answer(DRIVING, now=driving) == ()
    for now, config, words in (
        (replace(driving, stopped=True), BridgeConfig(), STOPPED),
        (replace(driving, bus_lost="gone"), BridgeConfig(), "the bus is lost: gone"),
        (driving, BridgeConfig(listen_only=True), "listen_only: this process never sends"),
    ):
        assert answer(DRIVING, now=now, config=config) == (words, NO_COMMAND)


def test_a_process_that_was_stopped_does_not_say_that_it_listens() -> None:
    assert answer(now=Circumstances(Phase.READY, listening=True)) == (LISTENING, GO)
    assert answer(now=Circumstances(Phase.READY, listening=True, stopped=True)) == (STOPPED, GO)


FAULT_SIGNALS = {
    field: field.upper() if field.startswith("ai_") else f"{field.upper()}_FAULT" for field in Faults.__struct_fields__
}


@pytest.mark.parametrize(
    ("said", "named"),
    [
        ({"shutdown_cause": None}, ""),
        ({"shutdown_cause": ShutdownCause.NO_SHUTDOWN}, ""),
        *(({"shutdown_cause": cause}, f": SHUTDOWN_CAUSE {cause.label}") for cause in ShutdownCause if cause),
        *(({"faults": Faults(**{field: True})}, f": {signal}") for field, signal in FAULT_SIGNALS.items()),
    ],
)
def test_each_fault_and_cause_is_named_as_its_signal_is(said: dict[str, Any], named: str) -> None:
    link = (LOST,) if "AI_COMMS_LOST" in named else ()
    fault = f"the car reports a fault (FAULT_STATUS is 1{named})"
    assert answer(status={"fault": True, **said}) == (*link, fault, GO)


@pytest.mark.parametrize(
    ("message", "field", "well", "words"),
    [
        ("brake", "brake_status", BrakeStatus.READY, "the brakes are not ready (STATUS_BRK is {})"),
        ("brake", "ebs_status", EbsStatus.ARMED, "EBS is not armed (STATUS_EBS is {})"),
        ("status", "ebs_state", EbsState.EBS_ARMED, "EBS is not armed (EBS_STATE is {})"),
        ("status", "ts_state", TsState.TS_RUNNING, "the tractive system does not run (TS_STATE is {})"),
    ],
)
def test_every_other_state_is_named_and_an_unknown_one_is_not(message: str, field: str, well: Any, words: str) -> None:
    for state in (None, *type(well)):
        said: dict[str, Any] = {"status": {field: state}}
        if message == "brake":
            said = {"status": {"ebs_state": None}, "vehicle": {"brake": VcuBrake(**{field: state})}}
        named = () if state in (None, well) else (words.format(state.label),)
        assert answer(**said) == (*named, GO), state


# ---------------------------------------------------------------- what the bus shows

SELECTED = AiCommand(mission_status=MissionStatus.SELECTED)
RUNNING = AiCommand(mission_status=MissionStatus.RUNNING, direction=Direction.FORWARD)


def shown(
    as_state: AsState,
    *,
    status: dict[str, Any] | None = None,
    said: dict[str, Any] | None = None,
    vehicle: dict[str, Any] | None = None,
    **moment: Any,
) -> list[tuple[str, str, bool]]:
    """Slug, sentence and whether it follows, of a car of which all is well but for what the test changes."""
    command = replace(RUNNING if as_state is DRIVING else SELECTED, **(said or {}))
    known = {"command": command, "waited_ns": 5 * S, **moment}
    found = list(shown_by_the_bus(Moment(car(as_state, status, vehicle), **known)))
    assert {one.remedy for one in found} <= {""}, "what to do is looked up by who asks"
    return [(one.slug, one.sentence, one.follows) for one in found]


MET = "and every condition that the bus shows is met"
WAITS = {
    INIT: [("start_unknown", f"waiting for AS_READY: the car is in AS_INIT, {MET}", False)],
    OFF: [("start_unknown", f"waiting for AS_READY: the car is in AS_OFF, {MET}", False)],
    READY: [("no_go", GO, False)],
    DRIVING: [],
}


@pytest.mark.parametrize("as_state", WAITS)
def test_a_car_that_is_well_waits_for_what_its_state_asks(as_state: AsState) -> None:
    assert shown(as_state) == WAITS[as_state]
    assert shown(as_state, command=None) == WAITS[as_state]


def vcu(**fields: Any) -> dict[str, Any]:
    """Fields of 0x520, as `shown` takes them."""
    return {"status": fields}


def ai(**fields: Any) -> dict[str, Any]:
    """Fields of the AI computer's command, as `shown` takes them."""
    return {"said": fields}


LOST = "AI_COMMS_LOST: the AI computer's messages or echo are missing"
ANY = {*OFF_LIKE, READY, DRIVING}
OTHERWISE: dict[str, tuple[Set[AsState], dict[str, Any], str]] = {
    "torque_requested": (
        {READY},
        ai(front_torque_nm=0.5),
        "axle torque is requested in AS_READY (FRONT_AXLE_TRQ_REQUEST is 0.5)",
    ),
    "steering_requested": ({READY}, ai(steer_deg=-0.5), "steering is requested in AS_READY (STEER_REQUEST is -0.5)"),
    "steering_turned": (
        {READY},
        {"vehicle": {"steer": VcuSteer(-5.0, 30.0, 0.0)}},
        "the steering is measured at 5 deg or more (ANGLE is -5)",
    ),
    "direction_not_neutral": (
        {READY},
        ai(direction=Direction.FORWARD),
        "DIRECTION_REQUEST is not NEUTRAL in AS_READY (DIRECTION_REQUEST is FORWARD)",
    ),
    "asms": (ANY, vcu(as_switch=False), "ASMS is off (AS_SWITCH_STATUS 0)"),
    "tsms": (ANY, vcu(ts_switch=False), "TSMS is off (TS_SWITCH_STATUS 0)"),
    "pushbar": ({*OFF_LIKE, READY}, vcu(op_state=OpState.OP_PUSHBAR), WORDS["pushbar"]),
    "charging": ({*OFF_LIKE, READY}, vcu(op_state=OpState.OP_CHARGE), WORDS["charging"]),
    "shutting_down": (ANY, vcu(shutdown_request=True), "the car asks for shutdown (SHUTDOWN_REQUEST)"),
    "link_lost": (ANY, vcu(faults=Faults(ai_comms_lost=True)), LOST),
    "fault": (
        ANY,
        vcu(fault=True, shutdown_cause=ShutdownCause.BMS_FAULT),
        "the car reports a fault (FAULT_STATUS is 1: SHUTDOWN_CAUSE BMS_FAULT)",
    ),
    "op_fault": (ANY, vcu(op_state=OpState.OP_FAULT), "OP_STATE is OP_FAULT"),
    "estop_latched": (OFF_LIKE, ai(estop_request=True), "the AI computer requests an emergency stop (ESTOP_REQUEST 1)"),
    "no_mission": (ANY, vcu(ami=Ami.NOT_SELECTED), "no mission is chosen on the AMI (AMI_STATE is NOT_SELECTED)"),
    "status_not_selected": (OFF_LIKE, ai(mission_status=MissionStatus.NOT_SELECTED), WORDS["status_not_selected"]),
    "status_running": (
        OFF_LIKE,
        ai(mission_status=MissionStatus.RUNNING),
        "the AI computer says RUNNING too early: the VCU waits for SELECTED (MISSION_STATUS is RUNNING)",
    ),
    "status_finished": (
        OFF_LIKE,
        ai(mission_status=MissionStatus.FINISHED),
        "the AI computer still says FINISHED from the run before: the VCU waits for SELECTED"
        " (MISSION_STATUS is FINISHED)",
    ),
    "ts_not_running": (
        ANY,
        vcu(ts_state=TsState.TS_PRECHARGE),
        "the tractive system does not run (TS_STATE is TS_PRECHARGE)",
    ),
    "ebs_not_armed": (ANY, vcu(ebs_state=EbsState.EBS_INIT), "EBS is not armed (EBS_STATE is EBS_INIT)"),
    "steering_inactive": (
        {READY, DRIVING},
        vcu(steering_status=SteeringStatus.OFF),
        "the steering is not active (STEERING_STATUS 0)",
    ),
    "brakes_not_ready": (
        {READY, DRIVING},
        {"vehicle": {"brake": VcuBrake(brake_status=BrakeStatus.FAULT)}},
        "the brakes are not ready (STATUS_BRK is FAULT)",
    ),
    "go_off": ({DRIVING}, vcu(go_signal=False), "the remote's Go went off (GO_SIGNAL 0) in AS_DRIVING"),
    **{
        slug: (states, {"history": {slug: "as the frames before show"}}, f"{words} (as the frames before show)")
        for slug, states, words in (
            (
                "status_frozen",
                {*OFF_LIKE, READY},
                "the VCU hung or its 0x520 froze: 0x520 repeated itself, so the real state of the car is not known",
            ),
            (
                "no_ai_data",
                {*OFF_LIKE, READY},
                "no message of the AI computer comes: tractive system and EBS wait for it",
            ),
            ("ai_data_incomplete", OFF_LIKE, "not all five messages of the AI computer come"),
            ("power_cycle", OFF_LIKE, "the car has not been switched off since its last run"),
            (
                "ready_not_selected",
                {READY},
                "MISSION_STATUS is not SELECTED in AS_READY: the official simulator does not start then",
            ),
        )
    },
}
"""Each condition: the states in which it is of interest, a change by which it is not met, and the sentence."""
HINTS = {"steering_inactive", "brakes_not_ready"}


def test_each_condition_is_tried_alone() -> None:
    assert set(OTHERWISE) == {condition.slug for condition in CONDITIONS}
    for condition in CONDITIONS:
        assert condition.states == OTHERWISE[condition.slug][0], condition.slug


@pytest.mark.parametrize("as_state", WAITS)
@pytest.mark.parametrize("slug", OTHERWISE)
def test_a_condition_is_named_in_its_states_and_in_no_other(slug: str, as_state: AsState) -> None:
    states, change, sentence = OTHERWISE[slug]
    found = shown(as_state, **change)
    if as_state not in states:
        assert found == WAITS[as_state]
    else:
        rest = [] if as_state in OFF_LIKE else WAITS[as_state]
        assert found == [(slug, sentence, slug in HINTS), *rest]


LINK = {"no_ai_data", "ai_data_incomplete", "link_lost"}
POWER = {*LINK, "tsms", "pushbar", "charging", "power_cycle", "fault", "shutting_down"}
AFTER = {
    "shutting_down": {"tsms"},
    "link_lost": {"no_ai_data", "ai_data_incomplete"},
    "fault": LINK,
    "op_fault": {"fault"},
    "estop_latched": {"no_ai_data"},
    "status_not_selected": {"no_ai_data", "no_mission", "estop_latched"},
    "status_running": {"no_ai_data"},
    "status_finished": {"no_ai_data"},
    "ts_not_running": POWER,
    "ebs_not_armed": {*POWER, "asms", "ts_not_running"},
}


def test_what_must_be_put_right_before_a_condition() -> None:
    assert {one.slug: set(one.after) for one in CONDITIONS if one.after} == AFTER


@pytest.mark.parametrize(("slug", "other"), [(slug, other) for slug in AFTER for other in sorted(AFTER[slug])])
def test_what_waits_for_another_condition_follows_it(slug: str, other: str) -> None:
    (states, change, _), (other_states, other_change, _) = OTHERWISE[slug], OTHERWISE[other]
    as_state = next(state for state in WAITS if state in states and state in other_states)
    both = {key: {**change.get(key, {}), **other_change.get(key, {})} for key in {*change, *other_change}}
    found = {name: follows for name, _, follows in shown(as_state, **both)}
    assert (found[other], found[slug]) == (False, True)
    assert next(iter(found)) == other


def test_the_field_that_shows_a_condition_is_told() -> None:
    sources = {"asms": "status.as_switch", "ebs_not_armed": "status.ebs_state", "no_ai_data": "", "power_cycle": ""}
    status = replace(WELL, as_state=OFF, as_switch=False, ebs_state=EbsState.EBS_INIT)
    history = {"no_ai_data": "none came", "power_cycle": "a run ended"}
    rows = unmet(Moment(VehicleState(status=status), history=history), OFF)
    assert {condition.slug: source for condition, source, _, _ in rows} == sources


def test_faults_are_named_with_fault_status_alone() -> None:
    faults = {"faults": Faults(bms=True), "ebs_state": EbsState.EBS_INIT}
    assert shown(OFF, status=faults) == [("ebs_not_armed", "EBS is not armed (EBS_STATE is EBS_INIT)", False)]


@pytest.mark.parametrize(("angle_deg", "named"), [(4.9, []), (-4.9, []), (5.0, ["steering_turned"])])
def test_a_steering_that_stands_turned_is_named_from_5_deg_on(angle_deg: float, named: list[str]) -> None:
    found = shown(READY, vehicle={"steer": VcuSteer(angle_deg, 30.0, 0.0)})
    assert [slug for slug, _, _ in found] == [*named, "no_go"]


def test_rear_torque_counts_as_front_torque_does() -> None:
    assert shown(READY, said={"rear_torque_nm": 1.0, "front_torque_nm": 2.0})[0][1] == (
        "axle torque is requested in AS_READY (FRONT_AXLE_TRQ_REQUEST is 2)"
    )
    assert shown(READY, said={"rear_torque_nm": 1.0})[0][1] == (
        "axle torque is requested in AS_READY (REAR_AXLE_TRQ_REQUEST is 1)"
    )


def test_go_is_waited_for_after_the_5_s() -> None:
    left = ("ready_wait", "waiting in AS_READY: 1.0 s of 5 s left", False)
    assert shown(READY, waited_ns=4 * S) == [left, ("no_go", GO, True)]
    assert shown(READY, waited_ns=None) == [("no_go", GO, False)]
    held = ("go_held", "Go was on already: only a rising edge counts")
    assert shown(READY, status={"go_signal": True}) == [(*held, False)]
    assert shown(READY, status={"go_signal": True}, waited_ns=4 * S) == [left, (*held, True)]
    assert shown(READY, waited_ns=5 * S - 1)[-1] == ("no_go", GO, True)


def test_of_a_status_never_heard_or_unknown_nothing_else_is_told() -> None:
    assert shown(OFF, vehicle={"status": None}) == [("vcu_unheard", WORDS["vcu_unheard"], False)]
    unknown = [("as_state_unknown", words_of("as_state_unknown"), False)]
    assert shown(READY, vehicle={"status_known": False}) == unknown
    assert shown(READY, vehicle={"status": None, "status_known": False}) == unknown


@pytest.mark.parametrize("as_state", list(AsState))
def test_a_silent_car_is_told_with_its_last_state_alone(as_state: AsState) -> None:
    words = f"0x520 is missing for 1.50 s: the car is silent (its last AS state was {as_state.label})"
    assert shown(as_state, silent_ns=1500 * MS) == [("vcu_silent", words, False)]


def test_what_is_seen_as_met_is_told_apart_from_what_is_not_seen() -> None:
    status = VcuStatus(as_switch=True, ts_switch=False, ami=Ami.TRACKDRIVE, go_signal=True)
    shown, unseen = seen_met(Moment(VehicleState(status=status), command=None), READY)
    assert shown["status.as_switch"] == "AS_SWITCH_STATUS is 1" and shown["status.ami"] == "AMI_STATE is TRACKDRIVE"
    assert "status.ts_switch" not in shown, "what is seen as not met is neither"
    assert "ANGLE" in unseen and "DIRECTION_REQUEST" in unseen and "TS_SWITCH_STATUS" not in unseen
    assert "STATUS_BRK" not in unseen and "status.go_signal" not in shown, "hints and other states are left out"
