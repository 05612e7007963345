"""Any AI-side program put through what scrutineering asks: a C program and this project's own, in virtual time."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path

import pytest
from c_node import CNode, compiled

from fsai_hil.cli.rehearse import add_arguments, parse, run
from fsai_hil.rehearsal.inspection.items import ITEMS, SILENCES
from fsai_hil.rehearsal.inspection.judge import Result, Verdict, items_named
from fsai_hil.rehearsal.inspection.rehearsal import RehearsalWorld
from fsai_hil.rehearsal.inspection.report import as_dict, line, page, passed, text
from fsai_hil.rehearsal.inspection.scenes import PATTERN, SCENES
from fsai_hil.rehearsal.stack import await_condition
from fsai_hil.simulator.ai_computer import OnboardComputer
from fsai_vcu.cli.main import Parser
from fsai_vcu.core.bridge import Bridge
from fsai_vcu.core.control.controller import Controller
from fsai_vcu.core.planning.planner import Planner
from fsai_vcu.core.supervision.config import BridgeConfig
from fsai_vcu.core.vehicle.parameters import CARS
from fsai_vcu.interface.codec import Codec
from fsai_vcu.interface.errors import WrongUse
from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.revisions import revision
from fsai_vcu.interface.units import MS

CYCLE_NS = 10 * MS
PHASE_NS = 4 * MS  # of a program that polls, after the car's frames
Program = Callable[[Sequence[Frame], int], list[Frame]]


def rehearsed(
    program: Program, *only: str, ends: bool = True, until: str = "", step_ns: int = CYCLE_NS, **options: object
) -> dict[str, Result]:
    """The results by item. `until`: it is enough when something is wrong with that one."""
    rehearsal = RehearsalWorld(items_named(only), gps=False, **options)  # type: ignore[arg-type]
    now_ns = PHASE_NS if step_ns == CYCLE_NS else 0
    while not rehearsal.done and not (until and rehearsal.inspector.is_wrong(until)):
        now_ns += step_ns
        frames = rehearsal.advance(now_ns)
        if rehearsal.end_wanted_ns is None or not ends:
            for frame in program(frames, now_ns):
                rehearsal.on_frame(frame)
        elif not rehearsal.program_is_gone:
            rehearsal.program_ended(0)
        if rehearsal.overdue and not rehearsal.program_is_gone:
            rehearsal.program_was_killed()
    return {result.item.slug: result for result in rehearsal.results()}


def wrong(results: dict[str, Result]) -> dict[str, tuple[str, ...]]:
    """What is not as asked, in words."""
    return {slug: result.seen for slug, result in results.items() if result.verdict is not Verdict.PASS}


# ---------------------------------------------------------------- programs that do what is asked


NO_REACTION_ASKED = {f"silence-{can_id:x}" for can_id, (_, within_ms) in SILENCES.items() if within_ms is None}


def test_a_c_program_as_of_the_cars_library_passes_every_item(library: Path) -> None:
    results = rehearsed(CNode(library).cycle, *({item.slug for item in ITEMS} - NO_REACTION_ASKED | {"silence-522"}))
    assert not wrong(results)
    assert "driven in" in results["static-a"].seen[0]
    assert results["silence-522"].seen[0].startswith("torque for")


def test_it_passes_on_the_car_of_2021_too(library: Path) -> None:
    assert not wrong(rehearsed(CNode(library).cycle, "selected", "static-b", revision="2021"))


def own_side() -> Program:
    """This project's bridge, planner and controller."""
    car, codec = CARS["2026"], Codec(revision("2026"))
    bridge = Bridge(codec, revision("2026"), car, BridgeConfig())
    computer = OnboardComputer(bridge, codec, Planner(car), Controller(car), 0)
    autonomous = False

    def cycle(received: Sequence[Frame], now_ns: int) -> list[Frame]:
        nonlocal autonomous
        autonomous = autonomous or bridge.set_mode("autonomous", now_ns)[0]
        if received:
            computer.on_frames(received)
        return computer.advance(now_ns)

    return cycle


def test_this_projects_own_ai_side_passes_too() -> None:
    shown = {"handshake", "static-b"}  # all of it takes minutes; silences: tests/core/test_bridge.py
    assert not wrong(rehearsed(own_side(), *(item.slug for item in ITEMS if item.scene in shown), step_ns=MS))


# ---------------------------------------------------------------- each mistake by its name


MISTAKES: dict[str, tuple[str, str]] = {
    "inverted-echo": ("handshake", "the inverse of the HANDSHAKE bit: .* the car raises AI_COMMS_LOST within 100 ms"),
    "late-echo": ("handshake", "the HANDSHAKE bit one 0x520 late"),
    "stuck-echo": ("handshake", "always the same HANDSHAKE bit"),
    "slow-period": ("messages", "0x510 comes every 20.0 ms"),
    "no-brake-message": ("messages", "0x514 was never received"),
    "short-steering": ("messages", "0x513: 1 bytes where 2 belong"),
    "reserved-id": ("messages", "0x120 was sent, which is the car's"),
    "reverse-order": ("order", "514 513 512 511 510, where the car's library sends 510 first"),
    "selected-without-mission": ("selected", "SELECTED in AS_OFF while the AMI shows no mission"),
    "never-selected": ("selected", "the car stayed in AS_OFF: never AS_READY: MISSION_STATUS was NOT_SELECTED"),
    "running-too-early": ("before-go", "MISSION_STATUS RUNNING in AS_READY"),
    "never-running": ("running", "MISSION_STATUS SELECTED in AS_DRIVING"),
    "torque-before-go": ("before-go", "0x512 asks for 10.0 Nm in AS_READY"),
    "steering-before-go": ("ready", "never AS_DRIVING after Go: steering was requested"),
    "early-launch": ("launch", "0x512 asks for .* Nm 0.0. s after AS_DRIVING began"),
    "torque-and-brake": ("torque-brake", "Nm and 5.0 % of brake together for 10.0 ms"),
    "one-call": ("torque-brake", "changed in one call; a cycle with both at 0 has to lie between them"),
    "finished-rolling": ("rest", "FINISHED with a wheel at"),
    "neutral-rolling": ("rest", "NEUTRAL with a wheel at"),
    "front-axle": ("axle", "0x511 asks for .* nothing of the driven one: 100% of the torque is lost"),
    "torque-halved": ("axle", "97.5 Nm of the driven one: 50% of the torque is lost"),
    "steering-too-far": ("limits", "0x513 asks for 33.0 deg, and ANGLE_MAX is 30.0 deg"),
    "steering-swapped": ("demo", "is the sign of STEER_REQUEST swapped"),
    "blind-to-status": ("silence-520", "no reaction: torque went only when AXLE_TRQ_MAX fell to 0"),
    "blind-to-wheels": ("silence-525", "torque is still asked for 15.. ms after the last 0x525"),
    "torque-in-emergency": ("estop", "0x512 asks for 50.0 Nm in EMERGENCY_BRAKE"),
    "keeps-mission": ("ami", "the drive ended as that of the mission before it"),
    "keeps-estop": ("power-cycle", "ESTOP_REQUEST 1 in AS_READY"),
    "never-ends": ("end", "still ran 5 s after SIGTERM, and was killed"),
}
# Of several that one item shows, the first is shown in short.
REPEATED = [
    fault for fault, (slug, _) in MISTAKES.items() if fault != next(f for f, (s, _) in MISTAKES.items() if s == slug)
]
LASTING = {"torque-and-brake", "never-ends"}  # for how long is known at the end; of the others nothing more is learnt


@pytest.mark.parametrize(
    "fault", [pytest.param(fault, marks=pytest.mark.long) if fault in REPEATED else fault for fault in MISTAKES]
)
def test_each_mistake_of_the_c_program_is_named(library: Path, fault: str) -> None:
    slug, words = MISTAKES[fault]
    node = CNode(library, fault)
    results = rehearsed(node.cycle, slug, ends=fault != "never-ends", until="" if fault in LASTING else slug)
    found = results[slug]
    assert found.verdict is (Verdict.NOTE if fault == "reverse-order" else Verdict.FAIL), results
    assert re.search(words, "\n".join(found.seen)), found.seen


def test_every_mistake_of_the_c_program_is_among_them(tmp_path: Path) -> None:
    try:
        program = compiled(tmp_path)
    except FileNotFoundError:
        pytest.skip("needs a C compiler (cc)")
    listed = subprocess.run([program, "--faults"], capture_output=True, text=True, check=True).stdout.split()
    assert listed == list(MISTAKES)


def test_a_change_in_one_call_is_a_note_where_cycles_are_judged(library: Path) -> None:
    results = rehearsed(CNode(library, "one-call").cycle, "torque-brake", pedals_by_frame=False)
    assert results["torque-brake"].verdict is Verdict.NOTE
    assert "a VCU that judges once a cycle may not see it" in results["torque-brake"].seen[0]


# ---------------------------------------------------------------- what cannot be seen is not called passed


def test_a_program_that_says_nothing_passes_nothing() -> None:
    results = rehearsed(lambda received, now_ns: [], "handshake", "messages", "static-a", "torque-brake")
    assert {result.verdict for result in results.values()} == {Verdict.NOT_SEEN}
    assert results["static-a"].seen == ("no frame of the program was received",)
    assert not passed([*results.values()])


def test_a_program_that_ends_by_itself_ends_the_rehearsal(library: Path) -> None:
    node = CNode(library)
    rehearsal = RehearsalWorld(items_named(["handshake", "static-b", "end"]), gps=False)
    for now_ns in range(PHASE_NS, 4_000 * MS, CYCLE_NS):
        for frame in node.cycle(rehearsal.advance(now_ns), now_ns):
            rehearsal.on_frame(frame)
    rehearsal.program_ended(139)
    while not rehearsal.done:
        now_ns += CYCLE_NS
        rehearsal.advance(now_ns)
    results = {result.item.slug: result for result in rehearsal.results()}
    assert results["end"].verdict is Verdict.FAIL
    assert results["end"].seen[0].startswith("the program ended by itself with status 139")
    assert results["static-b"].verdict is Verdict.NOT_SEEN


def test_the_pattern_tells_an_inverse_from_an_echo_a_frame_late() -> None:
    changes = [before != after for before, after in pairwise((*PATTERN, PATTERN[0]))]
    assert 0.3 < sum(changes) / len(changes) < 0.7


def test_every_item_has_a_scene_and_every_scene_an_item() -> None:
    assert {item.scene for item in ITEMS} == set(SCENES)
    assert len({item.slug for item in ITEMS}) == len(ITEMS)


# ---------------------------------------------------------------- for people and programs


@pytest.fixture(scope="module")
def some(library: Path) -> list[Result]:
    """Results of all four kinds."""
    right = rehearsed(CNode(library).cycle, "messages", "handshake")
    wrong = rehearsed(CNode(library, "selected-without-mission").cycle, "selected", until="selected")
    note = rehearsed(CNode(library, "reverse-order").cycle, "order")
    return [right["messages"], wrong["selected"], right["handshake"], note["order"]]


def test_the_page_is_whole_and_needs_nothing_from_elsewhere(some: list[Result]) -> None:
    made = page(some, {"program": "<node> & co", "ended": ""})
    assert "&lt;node&gt; &amp; co" in made and "<br>ended" not in made and "ended: " not in made
    assert all(result.item.title in made for result in some)
    assert not re.search(r"src=|href=|http:|https:|<script", made)


def test_text_and_json_say_what_was_asked_where_it_is_wrong(some: list[Result]) -> None:
    said = text(some)
    assert "FAIL      SELECTED" in said and "asked (interface specification v4.0):" in said
    assert said.splitlines()[-1] == line(some) == "NOT PASSED: 2 as asked, 1 with notes, 1 not as asked"
    found = as_dict(some, {"bus": "vcan0"})
    assert json.loads(json.dumps(found))["result"] == "fail"
    assert [item["result"] for item in found["items"]] == ["pass", "fail", "pass", "note"]


def test_what_follows_the_dashes_is_the_programs(capsys: pytest.CaptureFixture[str]) -> None:
    parser = Parser()
    add_arguments(parser)
    args = parse(parser, ["-i", "vcan7", "--only", "end", "--", "./node", "--only", "x"])
    assert (args.interface, args.only, args.command) == ("vcan7", "end", ["./node", "--only", "x"])
    with pytest.raises(WrongUse, match="no item 'handshak'; did you mean handshake"):
        run(parse(parser, ["--only", "handshak"]))
    assert run(parse(parser, ["--list", "--json"])) == 0
    assert [item["slug"] for item in json.loads(capsys.readouterr().out)] == [item.slug for item in ITEMS]


def test_ctrl_c_ends_the_program_too_and_leaves_a_result(tmp_path: Path) -> None:
    pid, out = tmp_path / "pid", tmp_path / "out"
    bus = f"loopback:rehearse-{os.getpid()}"
    own = (sys.executable, "-m", "fsai_vcu.cli.main", "rehearse", "-i", bus, "-o", str(out))
    rehearse = subprocess.Popen(
        (*own, "--", "sh", "-c", f"echo $$ > {pid}; exec sleep 600"),
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    await_condition(lambda: pid.exists() and bool(pid.read_text()), 60.0, "the program has been started")
    rehearse.send_signal(signal.SIGINT)
    said, _ = rehearse.communicate(timeout=60.0)
    assert rehearse.returncode == 130, said
    assert not Path(f"/proc/{int(pid.read_text())}").exists()
    assert json.loads((out / "result.json").read_text())["ended"] == "ended by SIGINT"
