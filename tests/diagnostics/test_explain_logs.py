"""Any log gets a story: other stacks' logs, pieces of logs, logs of one direction, logs that are none."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from msgspec import structs
from story_runs import Run, after, branch, cut, driving, hand_made, log_of, of_ids, ready, setup, tell, without

from fsai_hil.evidence.edits import good_run
from fsai_hil.simulator.faults import Drop, WrongValues
from fsai_vcu.cli.main import main
from fsai_vcu.diagnostics.decode.databases import load_databases
from fsai_vcu.diagnostics.decode.revision import guess_revision
from fsai_vcu.diagnostics.explain import IncidentKind, Record, explained
from fsai_vcu.diagnostics.explain import signals as sig
from fsai_vcu.diagnostics.explain.causes import CAUSES
from fsai_vcu.diagnostics.explain.incident import Sureness
from fsai_vcu.diagnostics.explain.render import verdict
from fsai_vcu.diagnostics.log.candump import log_lines
from fsai_vcu.diagnostics.log.frames import RECEIVED, SENT, Frames
from fsai_vcu.interface.codec import Codec
from fsai_vcu.interface.database import dbc_dir
from fsai_vcu.interface.enums import Ami, AsState, Direction, EbsStatus, MissionStatus, ShutdownCause, SteeringStatus
from fsai_vcu.interface.messages import (
    AiBrake,
    AiDriveFront,
    AiDriveRear,
    AiStatus,
    AiSteer,
    Faults,
    VcuBrake,
    VcuStatus,
    VcuSteer,
    WheelSpeeds,
)
from fsai_vcu.interface.reserved import AI_IDS
from fsai_vcu.interface.revisions import revision
from fsai_vcu.interface.units import MS, S


@cache
def stopped() -> Frames:
    """A drive that an E-stop button ended."""
    return branch(driving(), lambda run: run.switch(car_estop=True), 1.0).frames


@cache
def faulty() -> Frames:
    """A drive that ended with a fault which the car names."""
    finished = {"mission_status": MissionStatus.FINISHED}
    return branch(
        driving(), lambda run: run.spoil(WrongValues(frozenset({0x510}), run.lockstep.world.codec, finished)), 1.0
    ).frames


@cache
def inspected() -> Frames:
    """A static inspection B, whose end is the emergency brake."""
    run = Run.of(setup(missions=[Ami.STATIC_INSPECTION_B]))
    run.until(lambda: run.lockstep.world.done)
    return log_of(run.frames)


class Phase(NamedTuple):
    """So many cycles of 10 ms, after a pause, in which a car of 2021 and somebody else's AI computer send this."""

    cycles: int
    car: VcuStatus
    ai: AiStatus
    torque: float = 0.0
    rpm: int = 0
    pause_ms: int = 0


def other_stack(*phases: Phase) -> Frames:
    codec = Codec(revision("2021"))
    lines: list[tuple[float, int, str]] = []
    t_ms = 0
    for cycles, car, ai, torque, rpm, pause_ms in phases:
        t_ms += pause_ms
        for _ in range(cycles):
            bit = bool(t_ms // 20 % 2)
            for image in (
                structs.replace(car, handshake=bit),
                VcuSteer(0.0, 21.0, 0.0),
                VcuBrake(ebs_status=EbsStatus.ARMED),
                WheelSpeeds(rpm, rpm, rpm, rpm),
                structs.replace(ai, handshake=bit),
                AiDriveFront(torque),
                AiDriveRear(torque),
                AiSteer(),
                AiBrake(),
            ):
                frame = codec.encode(image)
                lines.append((t_ms / 1000 + 1e-5 * len(lines) % 0.004, frame.can_id, frame.data.hex()))
            t_ms += 10
    return hand_made(sorted(lines))


ON = VcuStatus(
    as_switch=True, ts_switch=True, steering_status=SteeringStatus.ACTIVE, as_state=AsState.AS_OFF, ami=Ami.ACCELERATION
)
SELECTED = AiStatus(mission_status=MissionStatus.SELECTED)
RUNNING = AiStatus(mission_status=MissionStatus.RUNNING, direction=Direction.FORWARD)


def car(as_state: AsState = AsState.AS_OFF, **changes: object) -> VcuStatus:
    return structs.replace(ON, as_state=as_state, **changes)


def braked(pause_ms: int = 0, **changes: object) -> Frames:
    """Half a second in AS_DRIVING, then EMERGENCY_BRAKE with a fault and these changes."""
    emergency = car(AsState.EMERGENCY_BRAKE, go_signal=True, fault=True, **changes)
    return other_stack(
        Phase(50, car(AsState.AS_DRIVING, go_signal=True), RUNNING, rpm=100),
        Phase(30, emergency, RUNNING, rpm=50, pause_ms=pause_ms),
    )


# ---------------------------------------------------------------- other stacks


BEGINS = Phase(20, car(), SELECTED)


@pytest.mark.parametrize(
    ("phases", "slugs", "signals"),
    [
        ([Phase(700, car(), RUNNING)], ["status_running"], ["MISSION_STATUS"]),
        ([Phase(700, car(fault=True, faults=Faults(hvil_open=True)), SELECTED)], ["hvil_open"], ["FAULT_STATUS"]),
        (
            [BEGINS, Phase(700, car(AsState.AS_READY, ts_switch=False), SELECTED)],
            ["tsms", "no_go"],
            ["TS_SWITCH_STATUS"],
        ),
        (
            [
                BEGINS,
                Phase(520, car(AsState.AS_READY), SELECTED, torque=12.0),
                Phase(60, car(AsState.AS_READY, go_signal=True), SELECTED, torque=12.0),
            ],
            ["torque_requested"],
            ["FRONT_AXLE_TRQ_REQUEST", "GO_SIGNAL"],
        ),
    ],
    ids=["RUNNING in AS_OFF", "a fault before the start", "TSMS off comes before Go off", "torque in AS_READY"],
)
def test_another_stacks_log_shows_why_the_car_waits(phases: list[Phase], slugs: list[str], signals: list[str]) -> None:
    story = tell(other_stack(*phases))
    assert story.heading["revision"] == "2021"
    assert [incident.kind for incident in story.incidents] == [IncidentKind.REFUSAL]
    first, *others = story.incidents[0].candidates
    assert [first.slug, *(one.slug for one in others)][: len(slugs)] == slugs
    assert (first.sureness, [step.signal for step in first.steps]) == (Sureness.SHOWN, signals)


@pytest.mark.parametrize("cause", [c for c in ShutdownCause if c])
def test_every_shutdown_cause_has_its_row_or_what_led_to_it(cause: ShutdownCause) -> None:
    first = tell(braked(shutdown_cause=cause)).incidents[0].candidates[0]
    assert first.sureness is Sureness.SAID
    assert f"SHUTDOWN_CAUSE {cause.label}" in first.steps[-1].words


@pytest.mark.parametrize("bit", Faults.__struct_fields__)
def test_every_fault_bit_is_enough_where_the_cause_is_not_sent(bit: str) -> None:
    first = tell(braked(faults=Faults(**{bit: True}))).incidents[0].candidates[0]
    assert first.sureness is Sureness.SAID
    assert first.slug not in ("sdc_open", "unknown")


def test_a_log_of_the_cars_frames_only_says_so_without_a_guess() -> None:
    story = tell(without(stopped(), *AI_IDS))
    assert any("no frame of the AI computer" in problem for problem in story.problems)
    emergency = [i for i in story.incidents if i.kind is IncidentKind.EMERGENCY]
    assert emergency[0].candidates[0].slug == "sdc_open"


def test_what_to_record_is_what_the_log_lacks_and_the_car_sends() -> None:
    """0x181 tells an E-stop on the remote from one on the car; only 2026 cars send it."""
    assert (stopped().can_id == 0x181).any()
    for frames, asked in ((stopped(), False), (without(stopped(), 0x181), True)):
        story = tell(frames)
        first = story.incidents[0].candidates[0]
        assert first.slug == "sdc_open" and bool(story.to_record(first.cause)) is asked
        assert ("remote's E-stop and radio did not change" in first.steps[0].words) is not asked
    other = tell(braked())
    assert other.heading["revision"] == "2021" and not other.to_record(CAUSES["go_off"])


def test_a_lost_link_without_logged_ai_frames_blames_no_message() -> None:
    run = branch(driving(), lambda run: run.spoil(Drop(frozenset({0x513}))), 0.3).frames
    story = tell(without(run, *AI_IDS))
    first = next(i for i in story.incidents if i.kind is IncidentKind.EMERGENCY).candidates[0]
    assert first.slug == "ai_comms_lost"
    assert "only one direction" in first.steps[0].words


def test_where_the_state_is_unknown_no_brake_is_denied() -> None:
    unknown, known = (verdict(explained(Record(frames))) for frames in (without(stopped(), 0x520), stopped()))
    assert unknown == "without the AS state it is unknown whether the car braked or did not start"
    assert "emergency brake" in known


def test_a_log_of_the_ai_direction_alone_says_what_it_lacks() -> None:
    story = tell(of_ids(stopped(), AI_IDS))
    assert any("no 0x520" in problem for problem in story.problems)
    assert story.incidents == ()


def test_a_stranger_is_known_by_who_sent_where_the_log_says_it() -> None:
    """The AI computer's own log (R and T): one received 0x513 among its sent ones, at no odd time."""
    driven = without(stopped(), 0x514)
    driven.flags[:] = np.where(np.isin(driven.can_id, AI_IDS), SENT, RECEIVED)
    assert not [e for e in tell(driven).events if e.topic == "intruder"]
    row = int(np.flatnonzero(driven.can_id == 0x513)[500])
    driven.flags[row] = RECEIVED
    told = [e for e in tell(driven).events if e.topic == "intruder"]
    assert [e.t_ns for e in told] == [int(driven.t_ns[row])]
    assert "received, not sent" in told[0].text


def test_without_fault_bits_and_cause_the_frames_are_explained(tmp_path: Path) -> None:
    """One official database has no fault bit but HVIL_OPEN_FAULT, and no SHUTDOWN_CAUSE."""
    text = (dbc_dir() / "ads_dv_2026.dbc").read_text(encoding="cp1252").splitlines(keepends=True)
    gone = ("SHUTDOWN_CAUSE", "MISSION_STATUS_FAULT")
    bare = [line for line in text if not any(f"{word} " in line for word in gone) or line.startswith("CM_ BO_")]
    path = tmp_path / "bare.dbc"
    path.write_text("".join(bare), encoding="cp1252")
    first = tell(faulty(), databases=load_databases([path])).incidents[0].candidates[0]
    assert (first.slug, first.sureness) == ("finished_while_moving", Sureness.SHOWN)


def test_a_pause_of_all_senders_blames_the_bus_or_the_recording() -> None:
    story = tell(braked(300, shutdown_cause=ShutdownCause.AI_COMMS_FAULT))
    assert story.incidents[0].candidates[0].slug == "bus_lost"
    told = [event.text for event in story.events if "nothing at all" in event.text or "silent" in event.text]
    assert len(told) == 1 and told[0].startswith("nothing at all is received for 3")


def test_a_car_that_toggles_on_is_one_missing_echo() -> None:
    frames = branch(driving(), lambda run: None, 2.0).frames
    ai = np.isin(frames.can_id, AI_IDS)
    gone = (frames.t_ns > frames.t_ns[-1] - 1500 * MS) & (frames.t_ns < frames.t_ns[-1] - 500 * MS)
    assert len([event for event in tell(frames.only(~(ai & gone))).events if "echo is missing" in event.text]) == 1


# ---------------------------------------------------------------- pieces of logs


@pytest.mark.parametrize(
    ("drive", "last_s", "slug"),
    [
        (stopped, 0.5, "before_the_log"),
        (faulty, 0.5, "finished_while_moving"),  # its fault is latched
        (stopped, 2.0, "sdc_open"),
        (faulty, 2.0, "finished_while_moving"),
    ],
)
def test_the_last_piece_of_a_drive_has_its_cause(drive: Callable[[], Frames], last_s: float, slug: str) -> None:
    story = tell(after(drive(), int(drive().t_ns[-1] - last_s * S)))
    assert any("begins in AS_DRIVING" in problem for problem in story.problems) == (last_s > 1.0)
    assert [incident.candidates[0].slug for incident in story.incidents] == [slug]


def test_a_log_that_ends_in_mid_drive_has_no_incident() -> None:
    story = tell(cut(stopped(), tell(stopped()).incidents[0].t_ns - 1 * MS))
    assert story.incidents == ()
    assert story.closing.endswith("AS_DRIVING")


def test_the_end_of_a_mission_is_told_with_its_time_and_laps() -> None:
    lines = [
        (2.0, 0x520, "0000010000000000"),
        (2.01, 0x510, "0020000000000000"),
        (30.0, 0x520, "0000030000000000"),
        (30.01, 0x510, "0020010000000000"),
        (31.0, 0x520, "0000050000000000"),
        (31.01, 0x510, "0030010000000000"),
    ]
    ends = "the log ends with the car in AS_FINISHED"
    assert tell(hand_made(lines)).closing == f"{ends}: mission complete at 29.0 s after lap 1"
    assert tell(hand_made(lines[::2])).closing == ends


@pytest.mark.parametrize("share", [0.05, 0.3, 0.5, 0.7, 0.9])
def test_no_piece_of_a_drive_is_told_a_wrong_emergency(share: float) -> None:
    length = int(stopped().t_ns[-1] - stopped().t_ns[0])
    begin = int(stopped().t_ns[0]) + int(share * length)
    story = tell(cut(after(stopped(), begin), begin + length // 20))
    assert [i for i in story.incidents if i.kind is not IncidentKind.EMERGENCY] == []


def test_a_log_whose_clock_is_set_back_keeps_its_order() -> None:
    t_ns = stopped().t_ns.copy()
    t_ns[len(t_ns) // 2 :] -= 5 * S
    story = tell(replace(stopped(), t_ns=t_ns))
    assert [i.candidates[0].slug for i in story.incidents] == ["sdc_open"]
    assert any("clock was set back by 5" in event.text for event in story.events)


# ---------------------------------------------------------------- regular ends


def test_a_mission_meant_to_end_in_emergency_brake_is_planned() -> None:
    story = tell(inspected())
    assert [(i.kind, i.planned, i.candidates[0].slug) for i in story.incidents] == [
        (IncidentKind.EMERGENCY, True, "planned_end")
    ]
    assert story.clean


def acceleration() -> Frames:
    return good_run("acceleration").frames


def inspection(profile: str, rev: str) -> Frames:
    run = Run.of(setup(missions=[Ami.STATIC_INSPECTION_A], profile=profile, revision=rev))
    run.until(lambda: run.lockstep.world.done, 120.0)
    run.go_on(1.0)
    return log_of(run.frames)


@pytest.mark.parametrize(
    ("can_id", "mask", "data"),
    [
        (0x525, 0xFFFF, 0),  # a wheel that reads 0,
        (0x525, 0, 1 << 48),  # twice as much,
        (0x523, 0xFFFF, 100),  # 10 degrees all along
    ],
)
def test_the_regular_end_is_not_blamed_on_what_lasted_long(can_id: int, mask: int, data: int) -> None:
    frames = acceleration()
    rows = (frames.can_id == can_id) & (frames.t_ns > frames.t_ns[0] + 16 * S)
    word = np.where(rows, frames.word & ~np.uint64(mask) | np.uint64(data & mask), frames.word)
    if not mask:
        word[rows] += (word[rows] >> np.uint64(48)) * np.uint64(data)
    assert {i.kind for i in tell(replace(frames, word=word)).incidents} == {IncidentKind.MISMATCH}


@pytest.mark.parametrize(
    ("good", "rev"),
    [
        (acceleration, "2026"),
        (lambda: inspection("specification", "2021"), "2021"),
        pytest.param(lambda: inspection("official-simulator", "2026"), "2026", marks=pytest.mark.long),
    ],
)
def test_a_good_run_has_no_incident_and_no_warning(good: Callable[[], Frames], rev: str) -> None:
    story = tell(good())
    assert story.incidents == ()
    assert story.clean
    assert [e.text for e in story.events if e.weight > 1] == []
    assert story.heading["revision"] == rev


def test_a_wait_in_as_ready_that_is_not_over_is_no_refusal() -> None:
    frames = branch(ready(), lambda run: None, 3.0).frames
    assert tell(frames).incidents == ()


# ---------------------------------------------------------------- revision


@pytest.mark.parametrize(
    ("rev", "can_id", "data", "reason"),
    [
        ("2026", 0x520, "0000010030000000", "0x520 carries"),
        ("2026", 0x520, "1000010000000000", "0x520 carries"),
        ("2021", 0x120, "0000000000000000", "VCU_STATUS (0x120) is only in 2021"),
        ("2026", 0x181, "0000000000000000", "RES_TPDO (0x181) is only in 2026"),
        ("2026", 0x523, "00002c010000", "ANGLE_MAX is 30 deg"),
        ("2021", 0x523, "0000d2000000", "ANGLE_MAX is 21 deg"),
        # States of 0 are no sign of 2021: the official simulator sends them so.
        ("2026", 0x520, "0000020000000000", "the log does not show it"),
        ("2026", 0x520, "0000030000000000", "the log does not show it"),
        ("2026", 0x510, "0000000000000000", "the log does not show it"),
    ],
)
def test_each_sign_of_a_revision_counts_by_itself(rev: str, can_id: int, data: str, reason: str) -> None:
    found, said = guess_revision(hand_made([(0.0, can_id, data)]))
    assert (found.name, said[: len(reason)]) == (rev, reason)


# ---------------------------------------------------------------- the verb


Explain = Callable[..., tuple[int, str]]


@pytest.fixture
def explain(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Explain:
    def run(frames: Frames, *argv: object, end: int | None = None) -> tuple[int, str]:
        """Status and output for a log of these frames, up to that byte of it."""
        path = tmp_path / "run.log"
        path.write_bytes((b"\n".join(log_lines(frames)) + b"\n")[:end])
        status = main(["explain", str(path), *(str(part) for part in argv)])
        captured = capsys.readouterr()
        assert captured.err == "" or end is not None
        return status, captured.out

    return run


def test_a_log_that_cannot_be_read_whole_is_not_called_ok(explain: Explain) -> None:
    assert explain(inspected())[0] == 0
    status, out = explain(inspected(), end=-5)
    assert status == 1
    assert out.splitlines()[-1].startswith("verdict: UNKNOWN: not everything could be read")


def test_the_answer_comes_last_with_cause_chain_and_remedy(explain: Explain) -> None:
    status, out = explain(faulty())
    assert status == 1
    story = out[out.index("EMERGENCY BRAKE at") :].splitlines()
    assert "because MISSION_STATUS was FINISHED while a wheel turned" in story[1]
    assert "0x510 AI2VCU_Status" in story[2] and "RUNNING → FINISHED" in story[2]
    assert "0 ms  0x520 VCU2AI_Status" in story[3] and "SHUTDOWN_CAUSE MISSION_STATUS_FAULT" in story[3]
    assert any(line.strip().startswith("what to do: say FINISHED only when") for line in story)
    assert story[-2:] == ["1 emergency brake", "verdict: NOT OK: 1 problem (1 note)"]
    assert "\033" not in out, "no colours where nobody sees them"


def test_the_cause_fills_a_screen_and_the_timeline_is_asked_for(explain: Explain) -> None:
    short, whole = (explain(faulty(), *words)[1].splitlines() for words in ((), ("--timeline",)))
    assert len(short) <= 14 and "AS_STATE AS_READY → AS_DRIVING" not in "\n".join(short)
    more = f"what happened until then, {len(tell(faulty()).events)} lines, and the notes"
    short.remove(f"(--timeline adds {more})")
    assert "AS_STATE AS_READY → AS_DRIVING" in "\n".join(whole) and set(short[2:-1]) <= set(whole)
    (absent,) = [line for line in whole if line.startswith("note: never received: ")]
    assert "UMB_PDO1 (0x184), UMB_PDO2 (0x284) of JOYSTICK" in absent, "few messages are named"


def test_what_makes_it_not_ok_is_named_beside_the_story(explain: Explain) -> None:
    _, out = explain(without(inspected(), 0x523))
    problem, remedy, verdict = out.splitlines()[-3:]
    assert problem == "problem: VCU2AI_Steer (0x523) was never received"
    assert remedy.startswith("    what to do: check the sender: its supply")
    assert verdict == "verdict: NOT OK: 1 problem (1 note)"


def test_a_status_of_wrong_length_is_not_called_absent(explain: Explain) -> None:
    lengths = np.where(inspected().can_id == 0x520, 7, inspected().length).astype(np.uint8)
    _, out = explain(replace(inspected(), length=lengths))
    assert "no 0x520" not in out and out.count("every 0x520") == 2


def test_without_wheel_speeds_no_speed_is_told() -> None:
    frames = branch(driving(), lambda run: run.lockstep.bridge.set_mode("manual", run.now_ns), 1.0).frames
    what = [tell(each).incidents[0].what for each in (frames, without(frames, 0x525))]
    assert what[0].startswith("service-brake stop from 1") and what[1] == "service-brake stop"


def test_a_car_that_steers_at_rest_is_asked_for_something() -> None:
    states = ((20, AsState.AS_READY), (1000, AsState.AS_DRIVING), (20, AsState.AS_FINISHED))
    frames = other_stack(*(Phase(cycles, car(state, go_signal=True), RUNNING) for cycles, state in states))
    swept = np.where(frames.can_id == 0x513, np.arange(len(frames)) % 200, frames.word).astype(np.uint64)
    told = [tell(each).incidents[0].candidates for each in (frames, replace(frames, word=swept))]
    assert ["not_driven" in [one.slug for one in candidates] for candidates in told] == [True, False]


def test_json_is_one_object_a_line(explain: Explain) -> None:
    status, out = explain(faulty(), "--json")
    objects = [json.loads(line) for line in out.splitlines()]
    assert status == 1
    assert [o["type"] for o in (objects[0], objects[-1])] == ["log", "verdict"]
    incident = next(o for o in objects if o["type"] == "incident")
    chain = incident["causes"][0]["chain"]
    assert incident["causes"][0]["cause"] == "finished_while_moving"
    assert (chain[0]["frame"], chain[0]["signal"]) == ("0x510 AI2VCU_Status", "MISSION_STATUS")
    assert chain[-1]["before_ms"] == 0
    assert objects[-1]["verdict"] == "not ok"


def test_a_part_of_the_log_is_told_with_causes_from_the_whole(explain: Explain) -> None:
    status, out = explain(faulty(), "--to", 5, "--json")
    assert status == 0
    assert max(json.loads(line).get("t_s") or 0 for line in out.splitlines()) <= 5
    status, out = explain(faulty(), "--from", 15, "--json")
    assert status == 1
    assert '"finished_while_moving"' in out


def test_a_part_in_emergency_brake_is_not_ok(explain: Explain) -> None:
    states = Record(stopped()).series(sig.AS_STATE)
    braked_s = (int(states.t_ns[states.values == sig.EMERGENCY][0]) - int(stopped().t_ns[0])) / S
    status, out = explain(stopped(), "--from", braked_s + 0.05)
    assert status == 1 and out.splitlines()[-1].startswith("verdict: ")
    assert f"EMERGENCY BRAKE at {braked_s:.3f} s" in out and "the emergency brake began before the log" not in out


def test_a_part_with_an_incident_is_not_ok_though_it_begins_late(explain: Explain) -> None:
    """The part alone does not show that the car drove before it was stopped."""
    frames = branch(driving(), lambda run: run.lockstep.bridge.set_mode("manual", run.now_ns), 2.0).frames
    (stop,) = tell(frames).incidents
    status, out = explain(frames, "--from", (stop.t_ns - int(frames.t_ns[0])) / S - 0.02)
    assert "\n1 early stop\nverdict: NOT OK: 1 problem" in out and status == 1


def test_colours_are_for_terminals_and_no_color_is_obeyed(explain: Explain, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stdout.isatty", lambda: True, raising=False)
    monkeypatch.delenv("NO_COLOR", raising=False)
    assert "\033[31;1m" in explain(stopped())[1]
    monkeypatch.setenv("NO_COLOR", "1")
    assert "\033" not in explain(stopped())[1]
