"""*Why is it not driving?* Bridge, status, monitor, pit wall and explain say the same words of the same frames."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterable
from copy import deepcopy
from types import SimpleNamespace

import numpy as np
import pytest
from story_runs import Act, Run, driving, log_of, off, parked, ready

from fsai_hil.evidence.campaign.catalogue import KINDS
from fsai_hil.evidence.campaign.faults.kind import Ongoing
from fsai_vcu.cli.status import _as_text
from fsai_vcu.core.report import BridgeReport
from fsai_vcu.core.supervision.start_conditions import CONDITIONS, WORDS
from fsai_vcu.diagnostics.explain import Record, explained
from fsai_vcu.diagnostics.explain.causes import CAUSES, FAULT_BITS
from fsai_vcu.diagnostics.explain.incident import IncidentKind
from fsai_vcu.diagnostics.log.frames import Frames, joined
from fsai_vcu.diagnostics.monitor.snapshot import Picture
from fsai_vcu.diagnostics.monitor.view import View
from fsai_vcu.diagnostics.page.board import state_of
from fsai_vcu.interface.enums import Ami
from fsai_vcu.interface.reserved import AI_IDS

HISTORY = {condition.slug for condition in CONDITIONS if not condition.sources}
CHUNK_NS = 250_000_000


def campaigns(name: str) -> Act:
    """A fault of the campaign, for as long as the run goes on."""

    def act(run: Run) -> None:
        kind, rng = KINDS[name], random.Random(name)
        params = {draw.name: draw.drawn(rng) for draw in kind.draws} | {"duration": 60_000}
        fault = Ongoing()
        kind.begin(fault, run.lockstep, params, run.now_ns)
        step = run.lockstep.step

        def faulty() -> None:
            for tick in fault.ticks:
                tick(run.now_ns)
            step()

        run.lockstep.step = faulty  # type: ignore[method-assign]

    return act


def switch(**values: object) -> Act:
    return lambda run: run.switch(**values)


def manual(run: Run) -> None:
    run.lockstep.computer.bridge.set_mode("manual", run.now_ns)
    run.switch(ami=Ami.AUTONOMOUS_DEMO)


def nothing(run: Run) -> None:
    pass


FAULTS = {
    off: ("status_one_fault_bit", "status_state_fault", "status_shutdown_request", "status_lost"),
    ready: ("status_as_switch_off", "status_undefined_as_state", "status_old_marks", "status_go_off", "brakes_lost"),
    driving: ("status_lost", "car_silent", "vcu_hangs"),
}
CASES: list[tuple[str, Callable[[], Run], Act, float]] = [
    *((f"{name} in {run.__name__}", run, campaigns(name), 0.6) for run, names in FAULTS.items() for name in names),
    ("nothing is switched on", parked, nothing, 0.5),
    ("LVMS alone", parked, switch(lvms=True), 2.0),
    ("no mission", off, nothing, 0.5),
    ("an E-stop button", off, switch(car_estop=True), 1.0),
    ("an EBS fault", off, switch(ebs_fault=True), 1.0),
    ("manual mode", off, manual, 0.5),
    ("Go early", ready, switch(go=True), 0.5),
    ("the 5 s run", ready, nothing, 0.5),
    ("Go is waited for", ready, nothing, 5.0),
    ("an emergency brake", driving, switch(car_estop=True), 1.0),
]


def told(sentences: Iterable[str]) -> list[str]:
    """Those of what the bus shows: not what only this process knows, nor what only earlier frames show."""
    words = [text for slug, text in WORDS.items() if slug not in HISTORY]
    begins = (
        *words,
        "0x520 is missing for",
        "waiting in AS_READY",
        "waiting for AS_READY",
        CAUSES["as_state_unknown"].words,
    )
    return [sentence for sentence in sentences if sentence.startswith(tuple(begins))]


def watched(run: Run, frames: Frames) -> Picture:
    """What the monitor has at the end of the run, after it watched all of it."""
    view = View("can0")
    for begin_ns in range(int(frames.t_ns[0]), int(frames.t_ns[-1]) + 1, CHUNK_NS):
        view.update(frames.only((frames.t_ns >= begin_ns) & (frames.t_ns < begin_ns + CHUNK_NS)))
    return view.picture(run.now_ns)


def on_the_screen(report: BridgeReport, loop_faults: int = 0) -> str:
    """What `fsai-vcu status` prints of that report."""
    nan = float("nan")
    state = SimpleNamespace(
        mode=report.mode,
        listen_only=False,
        as_state_label="",
        mission_label="",
        speed_mps=0.0,
        laps=0,
        steering_rad=0.0,
        as_switch=False,
        ts_switch=False,
        go_signal=False,
        operational_limits=[],
        status_age_s=nan,
        faults=[],
        emergency="",
        stopping="",
        loop_faults=loop_faults,
        gate_reasons=[],
        why_not_driving=list(report.why_not_driving),
    )
    return _as_text(state)


@pytest.mark.parametrize(("begin", "act", "seconds"), [case[1:] for case in CASES], ids=[case[0] for case in CASES])
def test_everybody_answers_in_the_same_words(begin: Callable[[], Run], act: Act, seconds: float) -> None:
    run = Run(deepcopy(begin().lockstep))
    act(run)
    run.go_on(seconds)
    frames = joined([log_of(begin().frames), log_of(run.frames)])
    report = run.lockstep.computer.report()
    picture = watched(run, frames)
    bridge = told(report.why_not_driving)
    assert bridge, report.why_not_driving
    monitor = [one.sentence for one in picture.why_not_driving]
    assert told(monitor) == bridge
    assert [one["text"] for one in state_of(picture)["why_not_driving"]] == monitor
    assert all(f"  - {sentence}\n" in on_the_screen(report) + "\n" for sentence in bridge)
    assert "too busy" not in on_the_screen(report)
    assert "3 times so far: is this computer too busy?" in on_the_screen(report, 3)


def last_first(frames: Frames) -> Frames:
    """The same of a program that sends 0x514 first and 0x510 last."""
    of_ai = np.flatnonzero(np.isin(frames.can_id, AI_IDS))
    cycles = of_ai[: len(of_ai) // len(AI_IDS) * len(AI_IDS)].reshape(-1, len(AI_IDS))
    rows = np.arange(len(frames))
    rows[cycles] = cycles[:, ::-1]
    return frames.only(rows).at(frames.t_ns)


def test_of_another_program_a_remedy_speaks_of_your_ai_computer() -> None:
    run = Run(deepcopy(off().lockstep))
    manual(run)
    run.go_on(5.2)
    ours = joined([log_of(off().frames), log_of(run.frames)])
    theirs = last_first(ours)
    for frames, other in ((ours, False), (theirs, True)):
        assert Record(frames).ai_is_theirs is other
        (first, *_), *_ = [one.candidates for one in explained(Record(frames)).incidents]
        named = [one.remedy for one in watched(run, frames).why_not_driving if one.slug == first.slug]
        assert named == [first.cause.remedy]
        assert ("your AI computer" in first.cause.remedy) is other
        assert ("fsai-vcu mode autonomous" in first.cause.remedy) is not other


@pytest.mark.parametrize(
    ("begin", "act", "slug"),
    [
        (off, nothing, "no_mission"),
        (off, manual, "status_not_selected"),
        (off, switch(car_estop=True, ami=Ami.AUTONOMOUS_DEMO), "ts_not_running"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_explain_names_a_refusal_with_the_words_of_the_bridge(begin: Callable[[], Run], act: Act, slug: str) -> None:
    run = Run(deepcopy(begin().lockstep))
    act(run)
    run.go_on(5.2)
    record = Record(joined([log_of(begin().frames), log_of(run.frames)]))
    refused = [one for one in explained(record).incidents if one.kind is IncidentKind.REFUSAL]
    first = refused[-1].candidates[0]
    assert first.slug == slug
    said = run.lockstep.computer.report().why_not_driving
    for one in refused[-1].candidates:
        if one.slug not in (*HISTORY, *FAULT_BITS.values()):
            assert any(sentence.startswith(one.cause.words) for sentence in said), (one.slug, said)
