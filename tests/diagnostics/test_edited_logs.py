"""Logs as other cars and other AI computers would have written them: each has its cause named, or is OK.

The short form of the second half of `make explanations`: every third edit, and those of one run.
"""

from __future__ import annotations

from functools import cache

import pytest
from msgspec.structs import replace

from fsai_hil.evidence.edited_logs import EDITS, Edit, sentences, told
from fsai_hil.evidence.edits import EditedLog, asks, driving, edited, good_run, never_moves, put
from fsai_vcu.diagnostics.explain import Record, explained
from fsai_vcu.diagnostics.explain import signals as sig
from fsai_vcu.diagnostics.explain.conditions import all_met
from fsai_vcu.diagnostics.explain.incident import ALWAYS, Claim, Incident, IncidentKind, Sureness, shown
from fsai_vcu.diagnostics.explain.proof import denied, proved
from fsai_vcu.diagnostics.verdict.judging import judged
from fsai_vcu.interface.enums import AsState

SHORT = [edit for edit in EDITS if edit.run == "acceleration"][::4]


@cache
def good() -> EditedLog:
    return good_run("acceleration")


@pytest.mark.parametrize("edit", SHORT, ids=lambda edit: edit.name)
def test_what_other_cars_and_ai_computers_show_is_named(edit: Edit) -> None:
    found = told(edit)
    assert (found.grade, found.falsely_green) == ("right", False), found


@pytest.mark.long
@pytest.mark.parametrize("edit", [edit for edit in EDITS if edit not in SHORT], ids=lambda edit: edit.name)
def test_what_all_others_show_is_named(edit: Edit) -> None:
    test_what_other_cars_and_ai_computers_show_is_named(edit)


def test_an_edit_that_says_something_else_is_not_called_right() -> None:
    edit = next(edit for edit in EDITS if edit.name == "nobody asks for anything")
    assert told(replace(edit, named=("brake_held",))).grade == "wrong"
    assert told(replace(edit, cites="a sentence that nobody says")).grade == "partly"
    assert told(replace(edit, named=("",))).grade == "wrong"


def test_no_log_is_called_ok_that_breaks_a_rule() -> None:
    batches = next(edit for edit in EDITS if edit.name == "an adapter's batches")
    assert not told(batches).falsely_green
    assert told(replace(batches, breaks=())).falsely_green
    assert told(replace(batches, breaks=("9", "interval"))).falsely_green


def test_names_of_edits_are_different() -> None:
    assert len({edit.name for edit in EDITS}) == len(EDITS) >= 40


# ---------------------------------------------------------------- sentences against frames


def test_a_sentence_that_the_frames_deny_is_not_said() -> None:
    record = good().run
    at_ns = good().at(driving(1.0))
    true = sig.GO.step(at_ns, "Go is on", sig.GO.was(1.0, at_ns, at_ns + 10**9))
    false = sig.GO.step(at_ns, "Go stays off", sig.GO.was(0.0, at_ns, at_ns + 10**9))
    absent = sig.SUPPLY.step(at_ns, "the supply is at 24 V", Claim(sig.SUPPLY, 23.0, 25.0, at_ns, at_ns))
    incident = Incident(
        IncidentKind.STAND,
        at_ns,
        "the car stands",
        (shown("no_go", false), shown("go_held", true), shown("vcu_reboot", absent)),
    )
    assert [one.slug for one in proved(record, incident).candidates] == ["go_held"]
    (left,) = proved(record, Incident(IncidentKind.STAND, at_ns, "the car stands", (shown("no_go", false),))).candidates
    assert (left.slug, left.sureness) == ("unknown", Sureness.POSSIBLE)


@pytest.mark.parametrize("edit", SHORT, ids=lambda edit: edit.name)
def test_every_sentence_is_borne_out_by_the_frames_it_cites(edit: Edit) -> None:
    record = Record(edit.frames(), good().run.revision.name)
    for incident in explained(record, ALWAYS).incidents:
        for one in incident.candidates:
            assert not [*denied(record, one.steps)]
            for step in one.steps:
                assert record.begin_ns <= step.t_ns <= record.end_ns, step
                if step.signal:
                    assert step.can_id is not None and record.has(step.can_id), step


def test_every_condition_is_called_met_only_where_it_was_seen() -> None:
    record, at_ns = good().run, good().at(driving(-0.5))
    met = all_met(AsState.AS_READY, record, at_ns)
    assert met.slug == "start_unknown"
    assert {"AS_SWITCH_STATUS", "TS_STATE", "EBS_STATE", "AMI_STATE", "DIRECTION_REQUEST"} <= {
        s.signal for s in met.steps
    }
    silent = edited(good(), lambda log: log.said(log.frames.only(log.frames.can_id != 0x510)))
    unclear = all_met(AsState.AS_READY, silent.record, at_ns)
    assert unclear.slug == "start_unclear" and "DIRECTION_REQUEST" in unclear.steps[-1].words


def test_a_drive_that_asks_in_vain_is_one_problem() -> None:
    log = edited(good(), never_moves(), asks(80.0), put(sig.DIRECTION, 0.0))
    verdict = judged(log.frames).verdict
    assert [one.kind for one in verdict.findings if one.severity == "problem"] == ["not_driving"]
    assert any("DIRECTION_REQUEST is NEUTRAL, and 80 Nm are asked for" in words for words in sentences(verdict))
