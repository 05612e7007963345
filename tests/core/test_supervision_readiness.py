"""*Why not driving?*: every condition on both sides is named while it is unmet, and nothing is named while driving."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from supervision_rig import Rig

from fsai_vcu.core.bridge import BridgeConfig
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
from fsai_vcu.interface.images import Faults, VcuBrake


def said(rig: Rig, words: str) -> bool:
    return any(words in sentence for sentence in rig.report.why_not_driving)


def in_off(**changes: object) -> Callable[[], Rig]:
    def make() -> Rig:
        rig = Rig().autonomous()
        rig.say_state(AsState.AS_OFF, **changes)
        rig.step()
        return rig

    return make


def in_ready(after_ms: int = 5010, **changes: object) -> Callable[[], Rig]:
    def make() -> Rig:
        rig = Rig().autonomous()
        rig.say_state(AsState.AS_READY, **changes)
        rig.run_ms(after_ms)
        return rig

    return make


def manual() -> Rig:
    return Rig().wake()


def unconfirmed() -> Rig:
    rig = Rig()
    rig.confirming = False
    return rig.wake()


def listening() -> Rig:
    rig = Rig()
    rig.step()
    return rig


def only_listening() -> Rig:
    return Rig(BridgeConfig(listen_only=True)).wake()


def silent() -> Rig:
    rig = Rig().wake()
    rig.off = True
    rig.run_ms(100)
    return rig


def never_heard() -> Rig:
    rig = Rig()
    rig.off = True
    return rig.wake()


def emergency() -> Rig:
    rig = Rig().autonomous()
    rig.bridge.emergency_brake("smoke", rig.now_ns)
    return rig


def ended() -> Rig:
    rig = Rig().autonomous()
    rig.bridge.begin_stop(rig.now_ns)
    rig.step(6)
    return rig


def unplugged() -> Rig:
    rig = Rig().autonomous()
    rig.bridge.bus_lost("no such device", rig.now_ns)
    return rig


def intruded() -> Rig:
    rig = Rig().autonomous()
    for frame in rig.codec.encode_command(rig.sent)[2:3]:
        rig.bridge.on_frame(frame)
    return rig


def started_late(as_state: AsState) -> Callable[[], Rig]:
    def make() -> Rig:
        rig = Rig()
        rig.say_state(as_state, go_signal=True)
        return rig.wake()

    return make


def stopping() -> Rig:
    rig = Rig().driving()
    rig.bridge.set_mode("manual", rig.now_ns)
    rig.step()
    return rig


def held() -> Rig:
    rig = Rig().driving()
    rig.command = None
    rig.run_ms(150)
    return rig


def in_driving_at(milliseconds: int) -> Callable[[], Rig]:
    def make() -> Rig:
        rig = Rig().launched()
        rig.run_ms(milliseconds)
        return rig

    return make


def braked_badly() -> Rig:
    """An official database without EBS_STATE: STATUS_EBS of 0x524 says it."""
    rig = Rig(revision_name="2021").autonomous()
    rig.say_state(AsState.AS_READY)
    rig.step()
    rig.say(VcuBrake(brake_status=BrakeStatus.FAULT, ebs_status=EbsStatus.UNAVAILABLE))
    return rig


def finished() -> Rig:
    rig = Rig().driving()
    rig.say_state(AsState.AS_FINISHED)
    rig.step()
    return rig


def braked() -> Rig:
    rig = Rig().driving()
    rig.say_state(
        AsState.EMERGENCY_BRAKE, shutdown_cause=ShutdownCause.AI_COMPUTER_REQUEST, faults=Faults(ai_estop_request=True)
    )
    rig.step()
    return rig


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (never_heard, "no 0x520 from the car yet"),
        (silent, "0x520 is missing for 0.1 s"),
        (listening, "listening before the first cycle is sent"),
        (only_listening, "listen_only: this process never sends"),
        (manual, "mode is manual: set autonomous in AS_INIT, AS_OFF or AS_READY"),
        (unconfirmed, "the planner has not confirmed its reset for run 2 (TRACKDRIVE)"),
        (unconfirmed, "the controller has not confirmed its reset for run 2 (TRACKDRIVE)"),
        (in_off(ami=Ami.NOT_SELECTED), "no mission is chosen on the AMI"),
        (in_off(as_switch=False), "ASMS is off (AS_SWITCH_STATUS 0)"),
        (in_off(ts_switch=False), "TSMS is off (TS_SWITCH_STATUS 0)"),
        (in_off(ebs_state=EbsState.EBS_CHARGING), "EBS is not armed (EBS_CHARGING)"),
        (in_off(ts_state=TsState.TS_PRECHARGE), "the tractive system does not run (TS_PRECHARGE)"),
        (in_off(op_state=OpState.OP_FAULT), "OP_STATE is OP_FAULT"),
        (in_off(fault=True, faults=Faults(bms=True)), "FAULT_STATUS is 1: BMS_FAULT"),
        (in_off(fault=True), "FAULT_STATUS is 1"),
        (in_off(shutdown_request=True), "the car asks for shutdown (SHUTDOWN_REQUEST)"),
        (in_off(), "waiting for AS_READY: the car is in AS_OFF, SELECTED is being sent"),
        (manual, "the car is in AS_OFF"),
        (emergency, "ESTOP_REQUEST is latched because the emergency brake was asked for: smoke"),
        (ended, "this software was stopped and sends nothing any more"),
        (unplugged, "the bus is lost: no such device"),
        (intruded, "an intruder sends on our ids: 0x512 [00 00 00 00]"),
        (in_ready(1010), "waiting in AS_READY: 4.0 s of 5 s left"),
        (in_ready(), "waiting for Go"),
        (in_ready(go_signal=True), "Go is already on: it must go off and on again"),
        (in_ready(steering_status=SteeringStatus.OFF), "the steering is not active (STEERING_STATUS 0)"),
        (braked_badly, "the brakes are not ready (STATUS_BRK FAULT)"),
        (braked_badly, "EBS is not armed (STATUS_EBS UNAVAILABLE)"),
        (started_late(AsState.AS_READY), "this process did not see AS_OFF, AS_READY and AS_DRIVING follow one another"),
        (
            started_late(AsState.AS_DRIVING),
            "stopping for good in this run because AS_DRIVING, but this process did not",
        ),
        (in_driving_at(1000), "standing still after AS_DRIVING: 2.0 s of 3 s left"),
        (stopping, "stopping for good in this run because manual mode was asked for"),
        (held, "no fresh command from the controller, or 0x520 is late: torque is held at 0"),
        (finished, "the mission is finished (AS_FINISHED): ASMS off ends the run"),
        (braked, "the car is in EMERGENCY_BRAKE: AI_ESTOP_REQUEST, SHUTDOWN_CAUSE AI_COMPUTER_REQUEST: wait 15 s"),
    ],
)
def test_what_is_unmet_is_named(make: Callable[[], Rig], words: str) -> None:
    rig = make()
    assert said(rig, words), rig.report.why_not_driving


def test_a_steering_that_stands_turned_is_named_from_5_deg_on() -> None:
    rig = Rig().ready()
    for angle_deg, named in ((4.9, False), (5.0, True), (-5.0, True)):
        rig.steer_deg = angle_deg
        rig.step()
        assert said(rig, "under 5 deg is needed") is named


def test_the_5_s_in_as_ready_are_over_at_5_s() -> None:
    for milliseconds, waits in ((5000, True), (5010, False)):
        assert said(in_ready(milliseconds)(), "waiting in AS_READY") is waits


def test_nothing_is_named_that_is_met() -> None:
    assert in_off()().report.why_not_driving == ("waiting for AS_READY: the car is in AS_OFF, SELECTED is being sent",)
    assert in_ready()().report.why_not_driving == ("waiting for Go",)


def test_a_go_that_falls_in_as_driving_is_named() -> None:
    rig = Rig().driving()
    rig.say_state(AsState.AS_DRIVING, go_signal=False)
    rig.step()
    assert said(rig, "Go is off (GO_SIGNAL 0)")


def test_brake_states_that_the_official_simulator_leaves_at_zero_stop_nothing() -> None:
    rig = Rig(revision_name="2021").autonomous()
    rig.say(VcuBrake(brake_status=None, ebs_status=None))
    assert not said(rig, "EBS")


def test_nothing_is_unmet_while_driving() -> None:
    rig = Rig().driving()
    assert rig.report.why_not_driving == ()
