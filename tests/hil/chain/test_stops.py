"""A person ends a run by the bridge's services."""

from __future__ import annotations

import pytest

from chain.conftest import STOP_S, Chain, rules_kept
from fsai_hil.rehearsal.bus_watch import BusWatch
from fsai_vcu.interface.enums import AsState


def test_the_emergency_brake_service_is_sent_and_latched(chain: Chain) -> None:
    """In AS_READY, which costs no drive."""
    chain.make_ready(chain.shared_car())
    accepted, message = chain.operator.trigger("/emergency_brake")
    assert accepted, message
    state = chain.operator.await_state(lambda s: s.sent_estop_request, STOP_S, "ESTOP_REQUEST")
    assert state.emergency and state.as_state == AsState.AS_READY
    accepted, message = chain.operator.trigger("/reset")
    assert not accepted and "AS_READY" in message
    chain.operator.await_new_state(STOP_S, "the bridge goes on")
    assert chain.state.emergency and chain.state.sent_estop_request


@pytest.mark.long  # as in tests/nodes, where a cancelled drive ends in order, too
def test_manual_while_driving_is_a_controlled_stop(chain: Chain, drive: BusWatch) -> None:
    accepted, message = chain.operator.set_mode("manual")
    assert accepted, message
    state = chain.operator.await_state(lambda s: s.as_state != AsState.AS_DRIVING, STOP_S, "the run ends")
    assert state.as_state == AsState.AS_FINISHED, chain.operator.describe()
    assert state.mode == "manual"
    rules_kept(drive)


@pytest.mark.long  # an ESTOP_REQUEST in a drive, and what the car does: test_a_foreign_0x511_is_an_emergency
def test_the_emergency_brake_service_stops_and_stays_latched(chain: Chain, drive: BusWatch) -> None:
    accepted, message = chain.operator.trigger("/emergency_brake")
    assert accepted, message
    state = chain.operator.await_state(lambda s: s.as_state == AsState.EMERGENCY_BRAKE, STOP_S, "an emergency")
    assert state.shutdown_cause_label == "AI_COMPUTER_REQUEST"
    assert state.emergency and state.sent_estop_request
    accepted, message = chain.operator.trigger("/reset")
    assert not accepted and "EMERGENCY_BRAKE" in message
    rules_kept(drive)
