"""Faults of the log itself are told as such: a clock that was set, stamps that are wrong, frames that are there twice.

Nobody is accused for them; and a pause, a dead bus and a second sender stay what they are.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from story_runs import branch, driving, in_order, of_ids, twice, without

from fsai_vcu.diagnostics.explain import explained
from fsai_vcu.diagnostics.log.frames import RECEIVED, SENT, Frames, joined, set_right
from fsai_vcu.diagnostics.verdict.judging import judged as judged_frames
from fsai_vcu.diagnostics.verdict.verdict import Verdict
from fsai_vcu.interface.reserved import AI_IDS
from fsai_vcu.interface.units import MS, S

HOUR, YEAR = 3600 * S, 31_536_000 * S


@pytest.fixture(scope="module")
def drive() -> Frames:
    """A drive that goes on: nothing is wrong with it, its wheels turn in its last seconds, it is of a day in 2024."""
    frames = branch(driving(), lambda run: None, 2.0).frames
    return replace(frames, t_ns=frames.t_ns + 1_732_400_020 * S)


def judged(frames: Frames) -> Verdict:
    return judged_frames(frames).verdict


def kinds(verdict: Verdict) -> list[str]:
    return [finding.kind for finding in verdict.findings if finding.severity == "problem"]


def stepped(frames: Frames, *steps: tuple[float, int]) -> Frames:
    """Before so many seconds before the end, the clock is set by so many ns."""
    t_ns = frames.t_ns.copy()
    for before_end_s, by_ns in steps:
        t_ns[frames.t_ns > frames.t_ns[-1] - before_end_s * S] += by_ns
    return frames.at(t_ns)


def clock_notes(verdict: Verdict) -> list[str]:
    return [finding.words for finding in verdict.findings if finding.kind == "clock"]


# ---------------------------------------------------------------- a clock that was set


@pytest.mark.parametrize(
    "steps",
    [
        [(1.0, HOUR)],
        [(1.0, 2 * S)],
        [(1.0, 300 * MS)],
        [(1.0, 90 * 24 * HOUR)],
        [(1.5, 2 * S), (0.5, HOUR)],
        [(1.5, HOUR), (0.5, -HOUR)],
        [(1.5, -HOUR), (0.5, HOUR)],
        [(0.0095, HOUR)],
    ],
    ids=["+1 h", "+2 s", "+0.3 s", "+90 days", "two", "forward and back", "back and forward", "at the very end"],
)
def test_a_clock_set_either_way_while_the_car_moves_is_a_note(drive: Frames, steps: list[tuple[float, int]]) -> None:
    verdict = judged(stepped(drive, *steps))
    assert verdict.ok and len(clock_notes(verdict)) == len(steps), list(verdict.lines())
    record = judged_frames(stepped(drive, *steps)).record
    assert abs((record.end_ns - record.begin_ns) - int(drive.t_ns[-1] - drive.t_ns[0])) < 50 * MS
    story = explained(record)
    assert sum("the log's clock was set" in event.text for event in story.events) == len(steps)


@pytest.mark.parametrize("frames_before", [1, 12, 500])
def test_a_clock_that_gets_its_date_after_the_start_is_a_note(drive: Frames, frames_before: int) -> None:
    """At the very beginning too, where the car stands and nothing is counted."""
    t_ns = drive.t_ns.copy()
    t_ns[:frames_before] -= t_ns[0] - 100 * S
    verdict = judged(drive.at(t_ns))
    assert verdict.ok and len(clock_notes(verdict)) == 1, list(verdict.lines())


@pytest.mark.parametrize("by_ns", [YEAR, 10 * S, -YEAR, -10 * S])
@pytest.mark.parametrize("rows", [[700], [700, 701], [-30]])
def test_a_stamp_that_is_far_off_is_no_dead_bus(drive: Frames, rows: list[int], by_ns: int) -> None:
    t_ns = drive.t_ns.copy()
    t_ns[rows] += by_ns
    found = judged_frames(drive.at(t_ns))
    assert found.verdict.ok, list(found.verdict.lines())
    assert found.bus.duration_s < 60


@pytest.mark.parametrize("rows", [[2], [40], [40, 41], [97]])
@pytest.mark.parametrize("wrong_s", [-1.0, 1.0, 1e8])
def test_a_wrong_stamp_moves_no_other(wrong_s: float, rows: list[int]) -> None:
    sound_ns = np.arange(100) * 10 * MS + 2 * 100_000_000 * S
    t_ns = sound_ns.copy()
    t_ns[rows] += int(wrong_s * 1e9)
    assert np.abs(set_right(t_ns)[0] - sound_ns).max() <= 20 * MS


# ---------------------------------------------------------------- what is no clock


def test_a_log_whose_stamps_are_whole_seconds_is_judged(drive: Frames) -> None:
    verdict = judged(replace(drive, t_ns=drive.t_ns // S * S))
    assert "two cars" not in " ".join(verdict.lines()) and verdict.lines()


@pytest.mark.parametrize("pause_ms", [200, 500, 1230])
def test_a_pause_of_the_recording_stays_a_pause(drive: Frames, pause_ms: int) -> None:
    at_ns = drive.t_ns[-1] - 700 * MS
    verdict = judged(drive.only((drive.t_ns < at_ns - pause_ms * MS) | (drive.t_ns > at_ns)))
    assert "gap" in kinds(verdict) and not clock_notes(verdict), list(verdict.lines())
    assert not any("clock was set" in line for line in verdict.lines())


def test_a_pause_of_a_car_that_stands_may_be_either(drive: Frames) -> None:
    """Nothing counts there, and a whole number of periods is missing: both are said, and it is no note."""
    for at_s, whose in ((0.5, "the AI computer's five messages"), (4.0, "the bus was dead, or the recording paused")):
        for by_ns in (2 * S, HOUR):
            verdict = judged(drive.at(drive.t_ns + by_ns * (drive.t_ns > drive.t_ns[0] + at_s * S)))
            (words,) = (finding.words for finding in verdict.findings if finding.kind == "gap")
            assert words.endswith(f"{whose}, or the log's clock was set forward")


@pytest.mark.parametrize(("by_ms", "moved_before"), [(303.7, False), (2003.7, True), (-2003.7, True)])
def test_a_step_of_no_whole_number_of_periods_is_a_set_clock(drive: Frames, by_ms: float, moved_before: bool) -> None:
    """The car's own clock goes on, and its counters, if it moved before: it was not switched off meanwhile."""
    pulses = np.where(drive.can_id == 0x526, np.uint64(0x0101_0101_0101_0101), np.uint64(0))
    stands = drive.t_ns < drive.t_ns[0] + 8 * S
    frames = replace(drive, word=drive.word + pulses if moved_before else drive.word).only(stands)
    after = frames.t_ns > drive.t_ns[0] + 7 * S
    verdict = judged(frames.at(frames.t_ns + np.int64(by_ms * MS) * after))
    assert "gap" not in kinds(verdict) and len(clock_notes(verdict)) == 1, list(verdict.lines())


def test_a_bus_that_was_dead_stays_dead(drive: Frames) -> None:
    """The car's handshake waits meanwhile, and goes on another way."""
    at_ns = drive.t_ns[0] + 4 * S
    after = drive.t_ns > at_ns
    word = drive.word.copy()
    word[after & (drive.can_id == 0x520)] ^= np.uint64(1)
    word[after & (drive.can_id == 0x510)] ^= np.uint64(1)
    verdict = judged(replace(drive, t_ns=drive.t_ns + 2 * S * after, word=word))
    assert "gap" in kinds(verdict) and not any("clock was set" in line for line in verdict.lines())


def test_two_runs_in_one_log_are_no_clock_that_was_set(drive: Frames) -> None:
    again = drive.at(drive.t_ns + 24 * HOUR)
    verdict = judged(joined([drive, again]))
    assert not any("set forward" in line for line in verdict.lines())


# ---------------------------------------------------------------- frames that are there twice


def marked(frames: Frames, mark: int) -> Frames:
    return replace(frames, flags=frames.flags | np.uint8(mark))


@pytest.fixture(scope="module")
def of_ai(drive: Frames) -> Frames:
    return of_ids(drive, AI_IDS)


def test_a_log_with_each_frame_twice_accuses_nobody(drive: Frames) -> None:
    verdict = judged(twice(drive, drive, 100_000))
    assert verdict.ok and "twice" in {finding.kind for finding in verdict.findings}, list(verdict.lines())


def test_an_adapters_echo_is_no_second_stack(drive: Frames, of_ai: Frames) -> None:
    sent_once = in_order(marked(without(drive, *AI_IDS), RECEIVED), marked(of_ai, SENT))
    verdict = judged(twice(sent_once, marked(of_ai, RECEIVED), 200_000))
    assert verdict.ok, list(verdict.lines())
    (note,) = (finding for finding in verdict.findings if finding.kind == "twice")
    assert note.words.endswith("its adapter's echo; each counts once")


def test_what_may_be_an_echo_or_a_second_program_is_not_known(drive: Frames, of_ai: Frames) -> None:
    verdict = judged(twice(drive, of_ai, 200_000))
    assert kinds(verdict) == [] and not verdict.ok
    assert "an adapter's echo, or a second program" in verdict.unknown[0].replace("its adapter", "an adapter")


def test_a_second_stack_that_only_waits_is_no_echo(drive: Frames, of_ai: Frames) -> None:
    """It sends zeros as the first one does, and its HANDSHAKE is right as well."""
    waiting = drive.only(drive.t_ns < drive.t_ns[0] + 3 * S)
    ours = of_ai.only(of_ai.t_ns < drive.t_ns[0] + 3 * S)
    zeros = replace(ours, word=np.where(ours.can_id == 0x510, ours.word, np.uint64(0)))
    verdict = judged(twice(in_order(without(waiting, *AI_IDS), zeros), zeros, 200_000))
    assert "intruder" in kinds(verdict)


# ---------------------------------------------------------------- times that cannot be true


def test_times_that_cannot_be_true_accuse_nobody(drive: Frames) -> None:
    verdict = judged(drive.at(drive.t_ns[0] + (drive.t_ns - drive.t_ns[0]) // 1000))
    assert verdict.line().startswith("UNKNOWN: the times cannot be true: "), list(verdict.lines())
    assert not {"intruder", "gap", "period", "handshake"} & {finding.kind for finding in verdict.findings}
