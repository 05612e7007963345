"""*Why not driving?*: every condition on both sides is named while it is unmet, and nothing is named while driving."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from msgspec.structs import fields, replace
from supervision_rig import WELL, Rig, driven

from fsai_vcu.core.bridge import BridgeConfig
from fsai_vcu.core.supervision.config import official_simulator
from fsai_vcu.core.supervision.readiness import Circumstances, why_not_driving
from fsai_vcu.core.supervision.supervisor import ROLES, Asked, Latch, Mode, Phase, Sequence, SupervisorState
from fsai_vcu.interface.enums import (
    Ami,
    AsState,
    BrakeStatus,
    EbsState,
    EbsStatus,
    OpState,
    ShutdownCause,
    SteeringStatus,
    TsState,
)
from fsai_vcu.interface.messages import Faults, VcuBrake, VcuSteer, VehicleState
from fsai_vcu.interface.units import MS, S

# ---------------------------------------------------------------- what the bridge adds


def intruded(rig: Rig) -> None:
    for frame in rig.codec.encode_command(rig.sent)[2:3]:
        rig.receive(frame)


def ended(rig: Rig) -> None:
    rig.bridge.begin_stop(rig.now_ns)
    rig.step(6)


@pytest.mark.parametrize(
    ("happens", "words"),
    [
        (ended, "this software was stopped and sends nothing any more"),
        (lambda rig: rig.bridge.bus_lost("no such device", rig.now_ns), "the bus is lost: no such device"),
        (intruded, "an intruder sends on our ids: 0x512 [00 00 00 00]"),
    ],
)
def test_what_happens_to_the_bridge_is_named(happens: Callable[[Rig], None], words: str) -> None:
    rig = Rig().autonomous()
    happens(rig)
    assert words in rig.report.why_not_driving


def test_before_its_first_cycle_a_bridge_says_that_it_listens() -> None:
    rig = Rig()
    rig.step()
    assert "listening before the first cycle is sent" in rig.report.why_not_driving


def test_nothing_is_unmet_while_driving() -> None:
    assert driven().report.why_not_driving == ()


def test_what_the_controller_reports_is_told_in_as_driving() -> None:
    said = "the controller reports: no path: no cones"
    for phase, told in ((Phase.DRIVING, [said]), (Phase.HOLDING, [NO_COMMAND, said]), (Phase.STOPPING, [NO_COMMAND])):
        assert list(answer(AsState.AS_DRIVING, now=Circumstances(phase, note="no path: no cones"))) == told


# ---------------------------------------------------------------- the whole answer, condition by condition

NOW = 1000 * S
BOTH = frozenset(ROLES)
NO_COMMAND = "no fresh command from the controller, or 0x520 is late: torque is held at 0"


def answer(
    as_state: AsState = AsState.AS_READY,
    *,
    status: dict[str, Any] | None = None,
    vehicle: dict[str, Any] | None = None,
    state: dict[str, Any] | None = None,
    now: Circumstances | None = None,
    config: BridgeConfig | None = None,
) -> tuple[str, ...]:
    """Asked of a car and a process of which all is as it should be, but for what the test changes."""
    go = as_state is AsState.AS_DRIVING
    seen: dict[str, Any] = {
        "status": replace(WELL, **{"as_state": as_state, "go_signal": go, "t_rx_ns": NOW, **(status or {})}),
        "brake": VcuBrake(brake_status=BrakeStatus.READY, ebs_status=EbsStatus.ARMED, t_rx_ns=NOW),
        "steer": VcuSteer(0.0, 30.0, 0.0, NOW),
        **(vehicle or {}),
    }
    known: dict[str, Any] = {
        "as_state": as_state,
        "status_ns": NOW,
        "sequence": Sequence.COMPLETE if as_state is AsState.AS_DRIVING else Sequence.READY_SEEN,
        "ready_since_ns": NOW - 5 * S,
        "driving_since_ns": NOW - 3 * S,
        "run_id": 2,
        "mission": Ami.TRACKDRIVE,
        "confirmed": BOTH,
        "mode": Mode.AUTONOMOUS,
        **(state or {}),
    }
    return why_not_driving(
        config or BridgeConfig(),
        SupervisorState(**known),
        VehicleState(**seen),
        now or Circumstances(Phase.READY),
        NOW,
    )


GO = "waiting for Go"


def test_what_the_database_lacks_is_not_said_to_be_off() -> None:
    assert answer(status={"as_switch": None, "ts_switch": None, "steering_status": None}) == (GO,)


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
        (NOW - 3 * S + 1, "standing still after AS_DRIVING: 0.0 s of 3 s left"),
        (NOW - 1 * S, "standing still after AS_DRIVING: 2.0 s of 3 s left"),
        (None, "standing still after AS_DRIVING: 3.0 s of 3 s left"),
    ):
        assert answer(AsState.AS_DRIVING, state={"driving_since_ns": since_ns}) == (held,)
    assert answer(AsState.AS_DRIVING, status={"go_signal": False}) == ("Go is off (GO_SIGNAL 0)", NO_COMMAND)


def test_a_stop_and_an_emergency_say_all_about_the_torque() -> None:
    stop, emergency = Latch(Asked.MANUAL, NOW), Latch(Asked.OPERATOR, NOW)
    assert answer(AsState.AS_DRIVING, state={"stop": stop}) == (
        "stopping for good in this run because manual mode was asked for",
    )
    latched = (
        "ESTOP_REQUEST is latched because the emergency brake was asked for: "
        "reset in AS_INIT or AS_OFF, or switch the car off and on"
    )
    assert answer(AsState.AS_DRIVING, state={"emergency": emergency}) == (latched,)


@pytest.mark.parametrize("as_state", [AsState.AS_READY, AsState.AS_DRIVING])
def test_a_sequence_not_seen_is_named_in_as_ready_and_as_driving(as_state: AsState) -> None:
    unseen = (
        f"this process did not see AS_OFF, AS_READY and AS_DRIVING follow one another (the car is in "
        f"{as_state.label}): it takes AS_OFF first"
    )
    assert answer(as_state, state={"sequence": Sequence.NONE})[0] == unseen
    assert unseen not in answer(as_state)


def test_a_sequence_that_may_be_short_is_told_in_as_ready() -> None:
    relaxed = "AS_DRIVING is accepted without these 5 s and an edge of Go (short_sequence_allowed)"
    assert relaxed in answer(AsState.AS_READY, config=official_simulator())
    assert relaxed not in answer(AsState.AS_READY)
    assert relaxed not in answer(AsState.AS_DRIVING, config=official_simulator())


def test_in_as_off_what_is_waited_for_depends_on_what_is_said() -> None:
    for as_state in (AsState.AS_INIT, AsState.AS_OFF):
        name = as_state.label
        assert answer(as_state) == (f"waiting for AS_READY: the car is in {name}, SELECTED is being sent",)
        assert answer(as_state, state={"sequence": Sequence.NONE}) == answer(as_state)
        assert answer(as_state, state={"mode": Mode.MANUAL}) == (
            "mode is manual: set autonomous in AS_INIT, AS_OFF or AS_READY",
            f"the car is in {name}",
        )


def test_without_a_mission_nobody_is_asked_to_confirm() -> None:
    assert answer(AsState.AS_OFF, state={"mission": Ami.NOT_SELECTED, "confirmed": frozenset()}) == (
        "no mission is chosen on the AMI",
        "the car is in AS_OFF",
    )
    for mission in (ami for ami in Ami if ami is not Ami.NOT_SELECTED):
        assert answer(state={"mission": mission, "confirmed": frozenset({"planner"})}) == (
            f"the controller has not confirmed its reset for run 2 ({mission.label})",
            GO,
        )


EMERGENCY = AsState.EMERGENCY_BRAKE
BRAKED = {
    "shutdown_cause": ShutdownCause.AI_COMPUTER_REQUEST,
    "fault": True,
    "faults": Faults(ai_estop_request=True),
}
CAUSES = "AI_ESTOP_REQUEST, SHUTDOWN_CAUSE AI_COMPUTER_REQUEST"


@pytest.mark.parametrize(
    ("status", "words"),
    [
        ({"as_switch": False}, "ASMS is off (AS_SWITCH_STATUS 0)"),
        ({"ts_switch": False}, "TSMS is off (TS_SWITCH_STATUS 0)"),
        ({"op_state": OpState.OP_FAULT}, "OP_STATE is OP_FAULT"),
        ({"shutdown_request": True}, "the car asks for shutdown (SHUTDOWN_REQUEST)"),
        ({"steering_status": SteeringStatus.OFF}, "the steering is not active (STEERING_STATUS 0)"),
    ],
)
def test_what_0x520_lacks_is_named(status: dict[str, Any], words: str) -> None:
    assert answer(status=status) == (words, GO)


def test_in_as_ready_a_go_that_is_on_must_go_off_again() -> None:
    assert answer(status={"go_signal": True}) == ("Go is already on: it must go off and on again",)


@pytest.mark.parametrize(
    ("angle_deg", "named"),
    [
        (4.9, ()),
        (5.0, ("the steering is measured at 5.0 deg: under 5 deg is needed",)),
        (-5.0, ("the steering is measured at -5.0 deg: under 5 deg is needed",)),
    ],
)
def test_a_steering_that_stands_turned_is_named_from_5_deg_on(angle_deg: float, named: tuple[str, ...]) -> None:
    assert answer(vehicle={"steer": VcuSteer(angle_deg, 30.0, 0.0, NOW)}) == (*named, GO)


def test_a_run_that_has_ended_is_said_to_have_ended() -> None:
    assert answer(AsState.AS_FINISHED) == ("the mission is finished (AS_FINISHED): ASMS off ends the run",)
    assert answer(EMERGENCY, status=BRAKED) == (
        f"FAULT_STATUS is 1: {CAUSES}",
        f"the car is in EMERGENCY_BRAKE: {CAUSES}: wait 15 s, ASMS off, then switch the car off and on",
    )


def test_what_was_never_received_is_not_taken_for_received() -> None:
    assert answer(vehicle={"status": None}) == ("no 0x520 from the car yet",)
    assert answer(state={"status_ns": None}) == ("no 0x520 from the car yet",)
    assert answer(vehicle={"brake": None, "steer": None}) == (GO,)
    assert answer(status={"ebs_state": None}, vehicle={"brake": None}) == (GO,)


def test_a_silence_is_named_from_100_ms_on() -> None:
    assert answer(state={"status_ns": NOW - 100 * MS + 1}) == (GO,)
    assert answer(state={"status_ns": NOW - 100 * MS}) == ("0x520 is missing for 0.1 s", GO)


def test_the_driving_phase_is_driving_only_if_frames_go_out() -> None:
    driving = Circumstances(Phase.DRIVING)
    assert answer(AsState.AS_DRIVING, now=driving) == ()
    for now, config, words in (
        (replace(driving, stopped=True), BridgeConfig(), "this software was stopped and sends nothing any more"),
        (replace(driving, bus_lost="gone"), BridgeConfig(), "the bus is lost: gone"),
        (driving, BridgeConfig(listen_only=True), "listen_only: this process never sends"),
    ):
        assert answer(AsState.AS_DRIVING, now=now, config=config) == (words, NO_COMMAND)


def test_a_process_that_was_stopped_does_not_say_that_it_listens() -> None:
    assert answer(now=Circumstances(Phase.READY, listening=True)) == ("listening before the first cycle is sent", GO)
    assert answer(now=Circumstances(Phase.READY, listening=True, stopped=True)) == (
        "this software was stopped and sends nothing any more",
        GO,
    )


@pytest.mark.parametrize("attribute", [spec.name for spec in fields(Faults)])
def test_every_fault_of_the_car_is_named_as_its_signal_is(attribute: str) -> None:
    signal = attribute.upper() if attribute.startswith("ai_") else f"{attribute.upper()}_FAULT"
    faults = Faults(**{attribute: True})
    assert answer(status={"fault": True, "faults": faults}) == (f"FAULT_STATUS is 1: {signal}", GO)


@pytest.mark.parametrize("cause", [None, *ShutdownCause])
def test_the_cause_of_a_shutdown_is_named_if_there_is_one(cause: ShutdownCause | None) -> None:
    named = cause is not None and cause is not ShutdownCause.NO_SHUTDOWN
    assert answer(status={"fault": True, "shutdown_cause": cause}) == (
        f"FAULT_STATUS is 1: SHUTDOWN_CAUSE {cause.label}" if named and cause is not None else "FAULT_STATUS is 1",
        GO,
    )


@pytest.mark.parametrize("status", [None, *EbsStatus])
def test_where_0x520_says_nothing_of_the_ebs_0x524_does(status: EbsStatus | None) -> None:
    brake = VcuBrake(brake_status=BrakeStatus.READY, ebs_status=status)
    told = status is not None and status is not EbsStatus.ARMED
    unarmed = (f"EBS is not armed (STATUS_EBS {status.label})",) if told and status is not None else ()
    assert answer(status={"ebs_state": None}, vehicle={"brake": brake}) == (*unarmed, GO)
    assert answer(vehicle={"brake": brake}) == (GO,)


@pytest.mark.parametrize("status", [None, *BrakeStatus])
def test_brakes_that_are_not_ready_are_named(status: BrakeStatus | None) -> None:
    words = "an unknown value" if status is None else status.label
    unready = () if status is BrakeStatus.READY else (f"the brakes are not ready (STATUS_BRK {words})",)
    assert answer(vehicle={"brake": VcuBrake(brake_status=status, ebs_status=EbsStatus.ARMED)}) == (*unready, GO)


@pytest.mark.parametrize("ts_state", [None, *TsState])
def test_a_tractive_system_off_is_named_where_it_is_reported(ts_state: TsState | None) -> None:
    runs = ts_state in (None, TsState.TS_RUNNING)
    stands = () if runs or ts_state is None else (f"the tractive system does not run ({ts_state.label})",)
    assert answer(status={"ts_state": ts_state}) == (*stands, GO)


@pytest.mark.parametrize("ebs_state", list(EbsState))
def test_an_ebs_that_is_not_armed_is_named(ebs_state: EbsState) -> None:
    unarmed = () if ebs_state is EbsState.EBS_ARMED else (f"EBS is not armed ({ebs_state.label})",)
    assert answer(status={"ebs_state": ebs_state}) == (*unarmed, GO)
