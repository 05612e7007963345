"""How a person ends a run by the bridge's services."""

from __future__ import annotations

import pytest

from chain.conftest import STOP_S, Chain, rules_kept
from fsai_hil.rehearsal.bus_watch import BusWatch
from fsai_vcu.interface.enums import AsState


def brakes_and_stays_latched(chain: Chain) -> None:
    accepted, message = chain.operator.trigger("/emergency_brake")
    assert accepted, message
    state = chain.operator.await_state(lambda s: s.as_state == AsState.EMERGENCY_BRAKE, STOP_S, "an emergency")
    assert state.shutdown_cause_label == "AI_COMPUTER_REQUEST"
    assert state.emergency and state.sent_estop_request
    accepted, message = chain.operator.trigger("/reset")
    assert not accepted and "EMERGENCY_BRAKE" in message


def test_the_emergency_brake_service_takes_as_ready_and_latches(chain: Chain) -> None:
    chain.make_ready(chain.shared_car())
    brakes_and_stays_latched(chain)


@pytest.mark.long  # each needs a drive of its own; a cancelled one ends in order in tests/nodes
def test_manual_while_driving_is_a_controlled_stop(chain: Chain, drive: BusWatch) -> None:
    accepted, message = chain.operator.set_mode("manual")
    assert accepted, message
    state = chain.operator.await_state(lambda s: s.as_state != AsState.AS_DRIVING, STOP_S, "the run ends")
    assert state.as_state == AsState.AS_FINISHED, chain.operator.describe()
    assert state.mode == "manual"
    rules_kept(drive)


@pytest.mark.long
def test_the_emergency_brake_service_stops_and_stays_latched(chain: Chain, drive: BusWatch) -> None:
    brakes_and_stays_latched(chain)
    rules_kept(drive)
