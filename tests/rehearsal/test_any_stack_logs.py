"""What `check` and `explain` say of logs of other stacks: each mistake by its name."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest
from c_node import CNode

from fsai_hil.rehearsal.inspection.judge import items_named
from fsai_hil.rehearsal.inspection.rehearsal import RehearsalWorld
from fsai_vcu.diagnostics.log.frames import LogFrame, frames_of
from fsai_vcu.diagnostics.verdict.judging import judged
from fsai_vcu.diagnostics.verdict.verdict import Verdict
from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.units import MS, S

CYCLE_NS = 10 * MS
PHASE_NS = 4 * MS
ON_THE_BUS_NS = 200_000  # from one frame to the next
Change = Callable[[Frame], Frame]


def verdict_on(
    node: CNode,
    item: str,
    *,
    change: Change = lambda frame: frame,
    seconds: float = 60.0,
    **options: object,
) -> Verdict:
    """Of the log of a rehearsal of that item. change: what the log has instead of a frame."""
    rehearsal = RehearsalWorld(items_named([item]), gps=False, **options)  # type: ignore[arg-type]
    now_ns, log = PHASE_NS, list[Frame]()
    while not rehearsal.done and now_ns < seconds * S:
        now_ns += CYCLE_NS
        frames = rehearsal.advance(now_ns)
        log += frames
        for number, frame in enumerate(node.cycle(frames, now_ns)):
            sent = Frame(frame.can_id, frame.data, now_ns + number * ON_THE_BUS_NS)
            rehearsal.on_frame(sent)
            log.append(sent)
    log.sort(key=lambda frame: frame.t_ns)
    changed = map(change, log)
    return judged(
        frames_of([LogFrame(frame.t_ns, "can0", frame.can_id, frame.data) for frame in changed]), "2026"
    ).verdict


def said(verdict: Verdict) -> str:
    return "\n".join(f"{one.severity}: {one.words}" for one in verdict.findings)


def negated_angle(frame: Frame) -> Frame:
    if frame.can_id != 0x523:
        return frame
    angle = -int.from_bytes(frame.data[:2], "little", signed=True)
    return Frame(frame.can_id, angle.to_bytes(2, "little", signed=True) + frame.data[2:], frame.t_ns)


def test_nothing_is_wrong_with_the_log_of_a_right_program(library: Path) -> None:
    """Boxes that are not on the bus are one note: a few messages by their names, many by their sender."""
    verdict = verdict_on(CNode(library), "static-b")
    assert not verdict.problems, said(verdict)
    (absent,) = (one.words for one in verdict.findings if one.kind == "missing")
    assert "VCU2OPUS_1 (0x300)" in absent and "15 messages of PCAN_GPS" in absent and len(absent) < 300


def test_an_inverted_echo_that_the_simulator_took_is_named(library: Path) -> None:
    verdict = verdict_on(CNode(library, "inverted-echo"), "messages", profile="official-simulator")
    assert re.search(
        r"problem: the AI computer sends back the inverse of the HANDSHAKE bit, or the bit of the 0x520 before .*"
        r"(\d+) of \1 echoes are wrong; the official simulator takes any, the car raises AI_COMMS_LOST within 100 ms",
        said(verdict),
    ), said(verdict)
    assert "slow" not in said(verdict)


def test_cycles_whose_bit_stays_tell_an_inverse_from_a_late_echo(library: Path) -> None:
    for fault, words in (
        ("inverted-echo", "problem: the AI computer sends back the inverse of the HANDSHAKE bit: "),
        ("late-echo", "note: the AI computer sends back the HANDSHAKE bit one 0x520 late: "),
    ):
        verdict = verdict_on(CNode(library, fault), "handshake", seconds=6.0)
        assert words in said(verdict)


def test_an_inverted_echo_that_keeps_a_car_asleep_is_named(library: Path) -> None:
    verdict = verdict_on(CNode(library, "inverted-echo"), "messages", seconds=8.0)
    assert "problem: the AI computer sends back the inverse of the HANDSHAKE bit, or always the same" in said(verdict)


@pytest.mark.parametrize(
    ("fault", "item", "words"),
    [
        ("never-running", "static-b", "MISSION_STATUS never becomes RUNNING in AS_DRIVING: it stays SELECTED"),
        (
            "torque-halved",
            "demo",
            r"50% of the torque is requested from an axle that cannot give any .* halved it between two",
        ),
        ("front-axle", "static-b", r"FRONT_AXLE_TRQ_REQUEST is \d+ Nm, .* requested from an axle that cannot give any"),
        ("one-call", "demo", r"torque and brake change in one call, \w+.*: .* up to 0.\d ms"),
    ],
)
def test_a_mistake_that_the_car_bore_is_named(library: Path, fault: str, item: str, words: str) -> None:
    verdict = verdict_on(CNode(library, fault), item, seconds=30.0, pedals_by_frame=False)
    assert re.search(words, said(verdict)), said(verdict)


def test_a_swapped_sign_of_steering_is_named(library: Path) -> None:
    verdict = verdict_on(CNode(library), "static-a", seconds=28.0, change=negated_angle)
    assert "the steering turns the other way than asked: STEER_REQUEST" in said(verdict)
