"""The tables behind explain are whole: whatever the car can say, and whatever its state machine asks, has its words."""

from __future__ import annotations

import re

import pytest

from fsai_hil.simulator.as_machine import ROWS, Row
from fsai_vcu.core.supervision.config import Reason
from fsai_vcu.core.supervision.start_conditions import CONDITIONS
from fsai_vcu.core.supervision.supervisor import REACTIONS, Consequence
from fsai_vcu.diagnostics.explain.causes import CAUSES, FAULT_BITS, SHUTDOWN
from fsai_vcu.diagnostics.explain.signals import FAULTS
from fsai_vcu.diagnostics.remedies import REMEDIES, Setting, remedy_of
from fsai_vcu.interface.enums import AsState, ShutdownCause
from fsai_vcu.interface.messages import FAULT_NAMES

# What brings a simulated car from one state to another, and the causes that name it. A row of its state machine that is
# not here is a condition that explain knows nothing of.
CAUSES_OF = {
    "the AI computer requests an emergency stop": {"ai_computer_request"},
    "mission FINISHED while a wheel turns": {"finished_while_moving"},
    "direction NEUTRAL while a wheel turns": {"neutral_while_moving"},
    "direction NEUTRAL while all wheels turn": {"neutral_while_moving"},
    "the AI computer's messages or echo are missing": {"ai_comms_lost"},
    "torque and brake requested together": {"torque_with_brake"},
    "high-voltage interlock open": {"hvil_open"},
    "high-voltage interlock shorted": {"hvil_short"},
    "EBS fault": {"ebs_fault"},
    "off-board charger fault": {"offboard_charger"},
    "charge procedure fault": {"charge_procedure"},
    "BMS fault": {"bms"},
    "the EBS is no longer available": {"ebs_fault", "tsms_off"},
    "shutdown circuit open": {"sdc_open", "remote_estop", "radio_lost"},
    "ASMS off": {"asms_off", "given_up"},
    "Go off": {"go_off"},
    "hydraulic brake requested": {"brake_request_simulator"},
    "mission status NOT_SELECTED": {"not_selected_simulator"},
    # transitions of a start: each condition is one of these
    "tractive system and EBS are up": {"no_ai_data", "ai_data_incomplete", "tsms", "ts_not_running", "ebs_not_armed"},
    "mission chosen and acknowledged, EBS armed": {
        "asms",
        "tsms",
        "ebs_not_armed",
        "no_mission",
        "status_not_selected",
        "status_running",
        "status_finished",
        "power_cycle",
    },
    "mission chosen, EBS armed": {"asms", "tsms", "ebs_not_armed", "no_mission", "power_cycle"},
    "Go": {
        "go_too_early",
        "torque_requested",
        "steering_requested",
        "steering_turned",
        "direction_not_neutral",
        "ready_not_selected",
    },
}
REGULAR = {"mission FINISHED at rest", "emergency-brake timer over, then ASMS off"}


def test_every_shutdown_cause_has_a_row() -> None:
    assert set(SHUTDOWN) == set(ShutdownCause) - {ShutdownCause.NO_SHUTDOWN}
    assert set(SHUTDOWN.values()) <= set(CAUSES)


def test_every_fault_bit_has_a_row() -> None:
    assert set(FAULT_BITS) == set(FAULT_NAMES.values()) == {signal.name for signal in FAULTS}
    assert set(FAULT_BITS.values()) <= set(CAUSES)


@pytest.mark.parametrize("row", ROWS, ids=lambda row: f"{row.sources[0].label} {row.why}")
def test_every_transition_of_the_as_state_machine_has_its_causes(row: Row) -> None:
    if row.why in REGULAR:
        return
    assert CAUSES_OF[row.why] <= set(CAUSES)
    if row.fault is not None:
        assert SHUTDOWN[row.fault.cause] in CAUSES_OF[row.why]


def test_every_condition_of_a_start_is_looked_for() -> None:
    looked_for = {condition.slug for condition in CONDITIONS} | {"go_too_early"}
    on_the_way = {
        (AsState.AS_INIT, AsState.AS_OFF),
        (AsState.AS_OFF, AsState.AS_READY),
        (AsState.AS_READY, AsState.AS_DRIVING),
    }
    wanted = set().union(
        *(CAUSES_OF[row.why] for row in ROWS for source in row.sources if (source, row.target) in on_the_way)
    )
    assert wanted <= looked_for


def test_conditions_wait_only_for_conditions_that_there_are() -> None:
    slugs = {condition.slug for condition in CONDITIONS}
    assert set().union(*(condition.after for condition in CONDITIONS)) <= slugs <= set(CAUSES)


def test_every_cause_and_condition_has_a_remedy_in_the_table() -> None:
    assert {cause.slug for cause in CAUSES.values()} <= set(REMEDIES)
    assert all(REMEDIES[slug] for slug in CAUSES)


OURS = re.compile(
    r"fsai-bridge|/reset|fsai-vcu (mode|status)|vcu_bridge|the bridge|the software|this software|service_brake"
)


def test_no_remedy_sends_to_a_verb_that_says_it() -> None:
    settings = (Setting(), Setting(theirs=True), Setting(virtual=True))
    for remedy in (remedy_of(slug, setting) for slug in REMEDIES for setting in settings):
        assert not re.search(r"fsai-vcu (check|explain|status|monitor|report|compare)", remedy)


def test_of_another_program_no_remedy_names_this_softwares_parts() -> None:
    for slug in REMEDIES:
        theirs, ours = remedy_of(slug, Setting(theirs=True)), remedy_of(slug)
        assert not OURS.search(theirs)
        assert theirs == ours or "your AI computer" in theirs
        assert theirs == ours or OURS.search(ours) or "AI computer" in ours or "planner" in ours or "processor" in ours


def test_a_condition_has_the_same_words_whoever_names_it() -> None:
    assert {one.slug: CAUSES[one.slug].words for one in CONDITIONS} == {one.slug: one.words for one in CONDITIONS}


def test_every_braking_reason_of_the_supervisor_has_its_words() -> None:
    graver = {reason for reason, steps in REACTIONS.items() if any(s.consequence >= Consequence.STOP for s in steps)}
    # what is decided inside the AI computer leaves no trace of its own on the bus
    inside = {Reason.BOTH_PEDALS, Reason.NOT_CONFIRMED, Reason.STACK_RESTARTED}
    told = {Reason.GO_OFF, Reason.NO_MISSION}  # of Go the car says more, of a missing mission the way to AS_READY
    for reason in graver - inside - told:
        assert reason.slug in CAUSES, (
            f"{reason} has no row in TO_DO of fsai_vcu/core/supervision/config.py, and is not named here among those "
            "that leave no trace on the bus"
        )
        assert CAUSES[reason.slug].words == reason.words


def test_every_cause_says_what_to_do() -> None:
    for cause in CAUSES.values():
        assert cause.words and cause.remedy
        assert not cause.words.endswith(".") and not cause.remedy.endswith("."), cause.slug
