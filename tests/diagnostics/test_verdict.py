"""One verdict of a log: a second sender, what is not as asked, what cannot be known, and pauses as one finding."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from story_runs import Act, Run, after, branch, driving, in_order, of_ids, off, twice, without

from fsai_hil.simulator.faults import Drop
from fsai_vcu.cli.main import main
from fsai_vcu.diagnostics.decode.databases import load_databases
from fsai_vcu.diagnostics.explain import IncidentKind, Record, explained, render
from fsai_vcu.diagnostics.explain.signals import AS_STATE
from fsai_vcu.diagnostics.finding import Finding
from fsai_vcu.diagnostics.log.candump import log_lines
from fsai_vcu.diagnostics.log.frames import ERROR, Frames, joined
from fsai_vcu.diagnostics.log.part import Part
from fsai_vcu.diagnostics.verdict.judging import judged as judged_frames
from fsai_vcu.diagnostics.verdict.verdict import Verdict
from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.reserved import AI_IDS, VCU_IDS
from fsai_vcu.interface.specification import PERIOD_NS
from fsai_vcu.interface.units import MS, S

ALL = 2**64 - 1  # bits of a payload


@pytest.fixture(scope="module")
def drive() -> Frames:
    """A drive that goes on: nothing is wrong with it."""
    return branch(driving(), lambda run: None, 2.0).frames


def judged(frames: Frames) -> Verdict:
    return judged_frames(frames).verdict


def problems(frames: Frames) -> list[Finding]:
    return [finding for finding in judged(frames).findings if finding.severity == "problem"]


def kinds(frames: Frames) -> list[str]:
    return [finding.kind for finding in problems(frames)]


def found(frames: Frames, kind: str) -> list[Finding]:
    """All findings of a kind, notes too."""
    return [finding for finding in judged(frames).findings if finding.kind == kind]


def ago(frames: Frames, ms: int) -> int:
    """The time so long before the last frame."""
    return int(frames.t_ns[-1]) - ms * MS


def stopped(frames: Frames, *ids: int) -> Frames:
    """Without these in the last second."""
    return frames.only(~np.isin(frames.can_id, ids) | (frames.t_ns < ago(frames, 1000)))


def paused(frames: Frames, begin_ns: int, ms: int) -> Frames:
    """Without all that came within so long."""
    return frames.only((frames.t_ns <= begin_ns) | (frames.t_ns > begin_ns + ms * MS))


def patched(frames: Frames, can_id: int, mask: int, bits: int, begin_ns: int = 0, length_ns: int = 2**62) -> Frames:
    """With these bits of that message's little-endian payload for so long."""
    rows = (frames.can_id == can_id) & (frames.t_ns >= begin_ns) & (frames.t_ns < begin_ns + length_ns)
    return replace(frames, word=np.where(rows, frames.word & np.uint64(~mask & ALL) | np.uint64(bits), frames.word))


def repeating(frames: Frames, can_id: int, begin_ns: int, all_along: bool = False) -> Frames:
    """With the last payload before that time from then on, or in all frames of that identifier."""
    word = int(frames.word[(frames.can_id == can_id) & (frames.t_ns < begin_ns)][-1])
    return patched(frames, can_id, ALL, word, 0 if all_along else begin_ns)


@pytest.mark.parametrize("batch_ns", [1, 5 * MS, 20 * MS, 50 * MS, 100 * MS, 300 * MS])
def test_a_sound_drive_in_an_adapters_batches_has_only_pauses(drive: Frames, batch_ns: int) -> None:
    in_batches = replace(drive, t_ns=(drive.t_ns // batch_ns + 1) * batch_ns)
    verdict = judged(in_batches)
    pauses = batch_ns >= 100 * MS
    assert set(kinds(in_batches)) == ({"gap"} if pauses else set())
    assert (verdict.ok, verdict.status) == (not pauses, int(pauses)), list(verdict.lines())


def test_verbs_that_judge_a_log_have_one_exit_status(drive: Frames, tmp_path: Path) -> None:
    for frames, status in ((drive, 0), (stopped(drive, 0x525), 1)):
        path, page = tmp_path / "run.log", tmp_path / "run.html"
        path.write_bytes(b"\n".join(log_lines(frames)) + b"\n")
        assert [main([verb, str(path)]) for verb in ("check", "explain")] == [status] * 2
        assert [main(["monitor", str(path), *how]) for how in (["--json"], ["--rate", "0"], [])] == [status] * 3
        assert main(["report", str(path), "-o", str(page)]) == status
        assert page.exists()


@pytest.fixture(scope="module")
def spoilt_drives(drive: Frames) -> dict[str, tuple[Frames, float]]:
    """Logs with something wrong in them, and when it begins, in seconds since their first frame."""
    silent = branch(driving(), lambda run: run.spoil(Drop(frozenset(AI_IDS))), 3.0)
    end_s = (int(drive.t_ns[-1]) - int(drive.t_ns[0])) / S
    silent_s = (silent.injected_ns - int(silent.frames.t_ns[0])) / S
    return {
        "braked": (silent.frames, silent_s),
        "two senders": (twice(drive, of_ids(drive, AI_IDS, ago(drive, 3000))), end_s - 3.0),
        "frozen": (repeating(drive, 0x520, ago(drive, 3000)), end_s - 3.0),
        "a pause": (paused(drive, ago(drive, 3000), 200), end_s - 3.0),
    }


@pytest.mark.parametrize("log", ["braked", "two senders", "frozen", "a pause"])
def test_of_a_part_all_verbs_give_one_verdict(
    spoilt_drives: dict[str, tuple[Frames, float]], log: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    frames, at_s = spoilt_drives[log]
    path, page = tmp_path / "run.log", tmp_path / "run.html"
    path.write_bytes(b"\n".join(log_lines(frames)) + b"\n")
    for begin_s, end_s, found in (
        (-5.0, -1.0, False),
        (-0.1, 1.4, True),
        (1.5, 2.8, log != "a pause"),  # what lasts into the part counts
        (-2.0, 1.5, True),
    ):
        part = ["--from", f"{at_s + begin_s}", "--to", f"{at_s + end_s}"]
        told = []
        for verb in ("check", "explain"):
            status = main([verb, str(path), *part, "--json"])
            entries = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
            told.append((status, [one for one in entries if one["type"] in ("finding", "verdict")]))
        assert told[0] == told[1]
        assert told[0][0] == found, part
    assert main(["report", str(path), *part, "-o", str(page)]) == told[0][0]
    assert f"verdict: {told[0][1][-1]['words']}\n" in capsys.readouterr().out
    low, high = json.loads(page.read_text().partition('id="data">')[2].partition("</script>")[0])["extent"]
    assert at_s + begin_s <= low < high <= at_s + end_s, "of the log's own time"


@pytest.mark.parametrize("can_id", [*range(0x510, 0x515), *range(0x521, 0x527)])
def test_a_message_that_stops_is_a_problem_and_no_mismatch(drive: Frames, can_id: int) -> None:
    assert "stopped" in kinds(stopped(drive, can_id))
    assert "not_as_asked" not in kinds(without(drive, can_id))


def test_a_database_that_is_not_the_cars_is_unknown(drive: Frames, tmp_path: Path) -> None:
    text = 'VERSION ""\n\nBU_: A\n\nBO_ 1312 Engine: 8 A\n SG_ Rpm : 0|16@1+ (1,0) [0|0] "" A\n'
    (tmp_path / "other.dbc").write_text(text)
    other = load_databases([tmp_path / "other.dbc"])
    verdict = judged_frames(drive, databases=other).verdict
    (named,) = [one.words for one in verdict.findings if one.kind == "unknown"]
    assert "identifiers are in no database: " in named and "0x510, 0x511" in named, "one line"
    (note,) = verdict.explanation.problems
    assert note.startswith("the database does not name 0x510, 0x511"), "they are in the log"
    assert verdict.line().startswith("UNKNOWN: the database has no AS_STATE")


@pytest.mark.parametrize("held_ms", [200, 600, 2000])
def test_a_sender_that_catches_up_after_a_pause_is_one_sender(drive: Frames, held_ms: int) -> None:
    end_ns = drive.t_ns[-1] - 800 * MS
    held = (drive.t_ns > end_ns - held_ms * MS) & (drive.t_ns < end_ns)
    late = end_ns - held.sum() + np.arange(held.sum())  # all at once, before those that were not held
    t_ns = drive.t_ns.copy()
    t_ns[held] = late
    moved = replace(drive, t_ns=t_ns)
    assert "intruder" not in kinds(moved.only(np.argsort(t_ns, kind="stable")))


def test_a_log_without_times_has_no_second_sender(drive: Frames) -> None:
    assert "intruder" not in kinds(replace(drive, t_ns=np.zeros_like(drive.t_ns)))


def test_two_bridges_at_once_are_one_finding(drive: Frames) -> None:
    two = twice(drive, of_ids(drive, AI_IDS))
    (intruder,) = found(two, "intruder")
    assert intruder.can_ids == AI_IDS and "200 frames a second" in intruder.words
    assert not found(two, "period")


def test_what_two_senders_say_by_turns_is_one_line(drive: Frames) -> None:
    ours = of_ids(drive, AI_IDS)
    events = explained(Record(twice(drive, replace(ours, word=np.zeros_like(ours.word))))).events
    (told,) = [event for event in events if "more changes of it" in event.text and event.signal == "MISSION_STATUS"]
    assert " SELECTED; " in told.text and len(events) < 60


@pytest.mark.parametrize(("period_ms", "rate"), [(10, "200"), (20, "150"), (50, "120"), (100, "110")])
def test_one_who_repeats_our_own_frames_is_told_by_rate(drive: Frames, period_ms: int, rate: str) -> None:
    begin_ns = int(drive.t_ns[0]) + 2 * S
    then = (drive.t_ns >= begin_ns) & (drive.t_ns < begin_ns + 3 * S)
    spoilt = drive
    for can_id in AI_IDS:
        copied = drive.only(np.flatnonzero(then & (drive.can_id == can_id))[:: period_ms // 10])
        spoilt = twice(spoilt, copied, 3 * MS)
    (intruder,) = found(spoilt, "intruder")
    assert intruder.can_ids == AI_IDS and f": {rate} frames a second" in intruder.words
    assert intruder.t_ns is not None and abs(intruder.t_ns - begin_ns) <= PERIOD_NS


def test_one_who_repeats_our_frames_all_along_is_a_wrong_rate(drive: Frames) -> None:
    again = drive.only(np.flatnonzero(drive.can_id == 0x514)[::5])
    (problem,) = problems(twice(drive, again, 3 * MS))
    assert "comes at 120 Hz instead of 100 Hz: a wrong period, or a second sender" in problem.words


@pytest.mark.parametrize(("can_id", "data"), [(0x510, "0500"), (0x511, "f401"), (0x513, "9cff"), (0x514, "6464")])
def test_one_frame_that_contradicts_its_neighbours_is_told(drive: Frames, can_id: int, data: str) -> None:
    row = int(np.flatnonzero(drive.can_id == can_id)[-50])
    stranger = drive.only(np.array([row]))
    word = np.array([int.from_bytes(bytes.fromhex(data), "little")], np.uint64)
    (intruder,) = found(twice(drive, replace(stranger, word=word)), "intruder")
    assert intruder.can_ids == (can_id,)


@pytest.mark.parametrize(
    ("ids", "words"),
    [
        ([0x520], "no 0x520 was received"),
        (VCU_IDS, "no 0x520 was received"),
        (AI_IDS, "no frame of the AI computer"),
    ],
)
def test_what_cannot_be_known_is_not_ok(drive: Frames, ids: Sequence[int], words: str) -> None:
    verdict = judged(without(drive, *ids))
    assert verdict.status == 1
    assert verdict.line().startswith(f"UNKNOWN: {words}")


def test_a_status_that_repeats_itself_is_no_quiet_car(drive: Frames) -> None:
    begin_ns = ago(drive, 1000)
    (problem,) = problems(repeating(drive, 0x520, begin_ns))
    assert problem.words.startswith("0x520 repeats itself for 1.00 s in AS_DRIVING") and problem.remedy
    assert problem.t_ns is not None and abs(problem.t_ns - begin_ns) <= 10 * MS
    assert kinds(paused(drive, ago(drive, 1500), 1000)) == ["gap"], "a bus that is silent says nothing of the VCU"
    assert "frozen" in kinds(repeating(drive, 0x520, begin_ns, all_along=True))


def test_a_status_that_repeats_itself_before_a_drive_is_told() -> None:
    waiting = branch(off(), lambda run: None, 1.0)
    frozen = repeating(waiting.frames, 0x520, waiting.injected_ns)
    assert ("frozen" in kinds(frozen), "frozen" in kinds(waiting.frames)) == (True, False)


@cache
def waiting() -> Frames:
    """8 s in AS_OFF and what came before them."""
    return branch(off(), lambda run: None, 8.0).frames


@pytest.mark.parametrize("bit", [0, 1])
@pytest.mark.parametrize(("length_s", "kind"), [(2, "frozen"), (7, "refusal_to_start")])
def test_a_status_frozen_from_the_first_frame_on_is_told(length_s: int, kind: str, bit: int) -> None:
    sound = after(waiting(), int(waiting().t_ns[-1]) - length_s * S)
    word = next(int(word) for word in sound.word[sound.can_id == 0x520] if int(word) & 1 == bit)
    frozen = patched(sound, 0x520, ALL, word)
    for frames in (frozen, patched(frozen, 0x510, 1, bit)):
        (problem,) = problems(frames)
        assert problem.kind == kind and "the VCU hung" in problem.words
    comes_up = patched(frozen, 0x520, 0xF << 16, 0)
    for allowed in (
        sound,
        patched(frozen, 0x510, 1, 1 - bit),  # the VCU waits for an echo
        patched(frozen, 0x520, 1 << 45, 1 << 45),  # it says that it misses it
        without(frozen, *AI_IDS),
        *([comes_up] if bit == 0 else []),  # the first HANDSHAKE that it sets is 1
    ):
        assert not [one for one in judged(allowed).findings if "the VCU hung" in one.words]


@pytest.mark.parametrize("every", [2, 4])
def test_toggles_that_were_not_recorded_are_no_frozen_status(drive: Frames, every: int) -> None:
    places = np.flatnonzero(drive.can_id == 0x520)
    thinned = drive.only(np.delete(np.arange(len(drive)), np.setdiff1d(places, places[::every])))
    assert kinds(thinned) == ["period"]


@pytest.mark.parametrize("seen", ["from the end of the bridge on", "with its end"])
def test_a_vcu_alone_is_no_frozen_one(seen: str) -> None:
    alone = branch(off(), lambda run: run.spoil(Drop(frozenset(AI_IDS))), 2.0)
    frames = alone.frames if seen == "with its end" else after(alone.frames, alone.injected_ns + 100 * MS)
    handshake = of_ids(frames, [0x520], alone.injected_ns + 100 * MS).word & np.uint64(1)
    assert len(handshake) > 100 and len(np.unique(handshake)) == 1, "it waits for an echo"
    assert not found(frames, "frozen")


@pytest.mark.parametrize("toggles_s", [0.0, 1.0])
def test_a_manual_drive_is_no_frozen_vcu(drive: Frames, toggles_s: float) -> None:
    """ASMS off, AS_OFF, 0x520 repeats itself and its HANDSHAKE is echoed: it froze, or the car is driven by hand."""
    begin_ns = int(drive.t_ns[drive.can_id == 0x520][0] + toggles_s * S)
    by_hand = patched(drive, 0x520, 1 << 9 | 0xF << 16, 1 << 16)
    by_hand = patched(by_hand, 0x520, ALL, 1 << 16, begin_ns)
    by_hand = patched(by_hand, 0x510, 1, 0, begin_ns)
    (unknown,) = judged(by_hand).unknown
    assert not problems(by_hand) and "the VCU froze, or" in unknown
    alone = judged(without(by_hand, *AI_IDS))
    assert not [words for words in alone.unknown if "froze" in words], "it waits for an echo"


def test_a_pause_of_everybody_is_one_finding_of_its_moment(drive: Frames) -> None:
    begin_ns = ago(drive, 1000)
    (pause,) = found(paused(drive, begin_ns, 40), "gap")
    assert 40 <= int(pause.words.removeprefix("a pause of ").split()[0]) <= 50, "not that of the slowest message"
    assert pause.t_ns is not None and abs(pause.t_ns - begin_ns) < 20 * MS


def intrude(run: Run) -> None:
    run.lockstep.intrude(Frame(0x513, bytes.fromhex("6400"), run.now_ns))


@pytest.mark.parametrize("act", [lambda run: run.spoil(Drop(frozenset(AI_IDS))), intrude])
def test_what_a_cause_names_is_not_a_second_problem(act: Act) -> None:
    assert kinds(branch(driving(), act, 1.0).frames) == ["emergency_brake"]


def test_a_gap_that_lasts_into_a_part_is_measured_whole(drive: Frames) -> None:
    begin_ns, end_s = ago(drive, 2000), (int(drive.t_ns[-1]) - int(drive.t_ns[0])) / S
    verdict = judged_frames(paused(drive, begin_ns, 500), part=Part(f"{end_s - 1.8}")).verdict
    (finding,) = [finding for finding in verdict.findings if finding.severity == "problem"]
    assert 500 <= int(finding.words.removeprefix("a pause of ").split()[0]) <= 520
    assert finding.t_ns is not None and abs(finding.t_ns - begin_ns) <= PERIOD_NS


def test_the_end_of_a_part_is_not_called_the_logs(drive: Frames) -> None:
    silent = stopped(drive, *VCU_IDS)
    assert "stopped" in kinds(silent)
    end_s = (int(drive.t_ns[-1]) - int(drive.t_ns[0])) / S - 0.2
    verdict = judged_frames(silent, part=Part(None, f"{end_s}")).verdict
    (told,) = [finding.words for finding in verdict.findings if finding.kind == "stopped"]
    assert told == "the car is silent for the last 0.8 s"
    explanation = verdict.explanation
    assert explanation.closing == "the part ends with the car in AS_DRIVING"
    assert explanation.end_ns == pytest.approx(drive.t_ns[-1] - 200 * MS, abs=1)


def test_a_dead_bus_and_its_error_frames_are_one_finding(drive: Frames) -> None:
    dead = paused(drive, ago(drive, 1000), 500)
    row = int(np.searchsorted(dead.t_ns, ago(drive, 1000), side="right")) - 1
    dead.can_id[row], dead.flags[row] = 0x40, ERROR
    (problem,) = problems(dead)
    assert problem.words.startswith("a pause of ") and problem.words.endswith(", and 1 error frame: bus-off")


def test_every_problem_says_what_to_do(drive: Frames, spoilt_drives: dict[str, tuple[Frames, float]]) -> None:
    late = drive.t_ns > drive.t_ns[-1] - S
    spoilt = [frames for frames, _ in spoilt_drives.values()]
    spoilt += [stopped(drive, *ids) for ids in (AI_IDS, VCU_IDS, [0x525])]
    spoilt += [without(drive, 0x525), replace(drive, length=np.where(late, 3, drive.length).astype(np.uint8))]
    for frames in spoilt:
        assert problems(frames) and all(finding.remedy for finding in problems(frames)), problems(frames)
    lacking = judged(without(drive, 0x523, 0x525))
    first, second, remedy, *_ = lacking.lines()
    assert "0x523" in first and "0x525" in second and remedy.startswith("    what to do: ")


def test_error_frames_are_one_finding_with_their_moment(drive: Frames) -> None:
    rows = [-900, -500]
    drive = replace(drive, can_id=drive.can_id.copy(), flags=drive.flags.copy())
    drive.can_id[rows], drive.flags[rows] = (0x40, 0x80), ERROR
    (problem,) = problems(drive)
    assert problem.words.startswith("2 error frames: 1 bus-off; 1 ")
    assert problem.t_ns == drive.t_ns[-900] and problem.remedy


@pytest.mark.parametrize(("share", "severity"), [(0.1, "problem"), (0.004, "note")])
def test_a_recording_that_loses_frames_is_one_finding(drive: Frames, share: float, severity: str) -> None:
    verdict = judged(drive.only(np.random.default_rng(0).random(len(drive)) > share))
    assert [f.severity for f in verdict.findings if f.kind in ("lossy", "handshake", "gap")] == [severity]
    assert not [finding for finding in verdict.findings if "AI_COMMS_LOST" in finding.words], "no echo took 100 ms"


def test_pauses_of_everybody_are_no_lost_frames(drive: Frames) -> None:
    of_run_s = (drive.t_ns - drive.t_ns[0]) / S
    t_ns = drive.t_ns + np.searchsorted([3.0, 4.0, 5.0, 6.0], of_run_s, side="right") * 5 * S
    assert not found(drive.at(t_ns), "lossy")


def test_a_clock_set_back_is_no_second_car(drive: Frames) -> None:
    middle = len(drive) // 2
    back_ns = (drive.t_ns[middle] - drive.t_ns[0]) * (np.arange(len(drive)) >= middle)
    verdict = judged(replace(drive, t_ns=drive.t_ns - back_ns))
    assert verdict.ok, list(verdict.lines())
    assert "clock" in {finding.kind for finding in verdict.findings}


@pytest.mark.parametrize("count", [30, 100, 300])
def test_a_short_log_accuses_no_second_car(drive: Frames, count: int) -> None:
    head = drive.only(drive.t_ns > drive.t_ns[-1] - S).head(count)
    squeezed = replace(head, t_ns=head.t_ns[0] + (head.t_ns - head.t_ns[0]) // 3)
    assert "intruder" not in kinds(squeezed)


@pytest.mark.parametrize("ids", [(0x520,), VCU_IDS])
@pytest.mark.parametrize("content", ["the same", "AS_OFF"])
@pytest.mark.parametrize("late_s", [0.0, 8.0])
def test_two_cars_are_one_finding_and_no_cause(
    drive: Frames, ids: tuple[int, ...], content: str, late_s: float
) -> None:
    other = of_ids(drive, ids, int(drive.t_ns[0] + late_s * S))
    begin_ns = int(other.t_ns[0])
    if content == "AS_OFF":
        idle = np.uint64(int.from_bytes(bytes.fromhex("2010013020"), "little"))
        other = replace(other, word=np.where(other.can_id == 0x520, idle, np.uint64(0)))
    verdict = judged(twice(drive, other))
    (problem,) = [finding for finding in verdict.findings if finding.severity == "problem"]
    assert problem.words.startswith("a second sender sends the car's messages: 0x520") and problem.can_ids == ids
    assert problem.t_ns is not None and -100 * MS <= problem.t_ns - begin_ns <= 10 * MS
    assert f"200 frames a second for {(drive.t_ns[-1] - problem.t_ns) / S:.1f} s" in problem.words
    assert not verdict.explanation.incidents and "two cars" in render.verdict(verdict.explanation)
    assert any("two cars were on the bus from" in note for note in verdict.explanation.problems)


def test_a_cause_before_or_between_looks_of_a_second_car_is_told() -> None:
    frames = branch(driving(), lambda run: run.spoil(Drop(frozenset(AI_IDS))), 4.0).frames
    since_s = (frames.t_ns - frames.t_ns[0]) / S
    late = since_s > since_s[-1] - 1.0
    both = late | ((since_s > 8.0) & (since_s < 8.5))
    status = frames.can_id == 0x520
    assert kinds(twice(frames, frames.only(status & late))) == ["emergency_brake", "intruder"]
    assert kinds(twice(frames, frames.only(status & both))) == ["intruder", "emergency_brake", "intruder"]


def test_what_an_adapter_held_back_is_no_second_car(drive: Frames) -> None:
    begun_ns = drive.t_ns[0] + 5 * S
    assert "intruder" not in kinds(replace(drive, t_ns=np.maximum(drive.t_ns, begun_ns)))


def test_many_incidents_of_one_cause_are_one_line() -> None:
    silent = branch(driving(), lambda run: run.spoil(Drop(frozenset(AI_IDS))), 1.0).frames
    length_ns = int(silent.t_ns[-1] - silent.t_ns[0])
    many = joined([silent.at(silent.t_ns + number * (length_ns + S)) for number in range(7)])
    assert [f.words for f in judged(many).findings if "; 6 more like it up to " in f.words]


def test_of_two_who_ask_no_mismatch_is_told(drive: Frames) -> None:
    ours = of_ids(drive, AI_IDS)
    assert kinds(twice(drive, replace(ours, word=np.zeros_like(ours.word)), 1)) == ["intruder"]


def test_columns_can_be_compared_without_an_error(drive: Frames) -> None:
    one, other = (Record(drive).series(AS_STATE) for _ in range(2))
    assert one != other and one.spans != other.spans


def test_frames_out_of_order_do_not_move_what_follows(drive: Frames) -> None:
    rng = np.random.default_rng(0)
    record = Record(replace(drive, t_ns=drive.t_ns + rng.integers(0, 5 * MS, len(drive))))
    assert abs(record.end_ns - int(drive.t_ns[-1])) < 10 * MS
    assert not record.clock_set and (np.diff(record.frames.t_ns) >= 0).all()


def changed(drive: Frames, can_id: int, data: str, since_ns: int) -> Frames:
    """From then on all frames of that id say this."""
    return patched(drive, can_id, ALL, int.from_bytes(bytes.fromhex(data), "little"), since_ns)


@pytest.mark.parametrize(
    ("can_id", "data", "slug"),
    [
        (0x522, "0000000079ff", "torque_not_given"),  # 0 Nm given
        (0x523, "2c012c01", "steering_not_following"),  # 30 degrees measured
        (0x524, "8080", "brake_unasked"),
        (0x525, "00000000c8000000", "wheel_unlike"),
    ],
)
def test_what_the_car_does_not_do_as_asked_is_named(drive: Frames, can_id: int, data: str, slug: str) -> None:
    story = explained(Record(changed(drive, can_id, data, ago(drive, 1900))))
    assert slug in {i.candidates[0].slug for i in story.incidents if i.kind is IncidentKind.MISMATCH}


def test_while_the_status_is_frozen_no_mismatch_is_told(spoilt_drives: dict[str, tuple[Frames, float]]) -> None:
    frozen, _ = spoilt_drives["frozen"]
    assert kinds(changed(frozen, 0x524, "8080", ago(frozen, 1900))) == ["frozen"]


@pytest.mark.parametrize(
    ("can_id", "mask", "words"),
    [
        (0x522, 0xFFFF << 32, "REAR_AXLE_TRQ_MAX falls to 0 in AS_DRIVING for 40 ms, and AS_STATE does not change"),
        (0x520, 1 << 11, "GO_SIGNAL falls to 0 in AS_DRIVING for 40 ms, and AS_STATE does not change"),
        (0x526, 0xFFFF, "the VCU started again: FL_PULSE_COUNT"),
    ],
)
def test_what_the_car_does_in_passing_is_noted(drive: Frames, can_id: int, mask: int, words: str) -> None:
    verdict = judged(patched(drive, can_id, mask, 0, ago(drive, 1000), 40 * MS))
    (finding,) = (one for one in verdict.findings if words in one.words)
    assert finding.severity == "note" and verdict.ok
    assert 0 <= (finding.t_ns or 0) - (drive.t_ns[-1] - S) < 10 * MS


def test_without_wheel_speeds_no_pulse_count_is_judged(drive: Frames) -> None:
    since_ns = ago(drive, 1500)
    held = repeating(drive, 0x526, since_ns)
    assert "frozen" in kinds(held)
    assert "frozen" not in kinds(held.only((held.can_id != 0x525) | (held.t_ns < since_ns)))


@pytest.mark.parametrize("steps", [1, 2])
def test_frames_out_of_order_are_no_restart(drive: Frames, steps: int) -> None:
    word = drive.word.copy()
    for can_id in (0x520, 0x526):
        rows = np.flatnonzero(drive.can_id == can_id)
        swapped = np.arange(len(rows) - len(rows) % (steps + 1)).reshape(-1, steps + 1)[:, ::-1].ravel()
        word[rows[: len(swapped)]] = drive.word[rows[swapped]]
    assert not found(replace(drive, word=word), "restart")


def test_a_wheel_that_rolls_back_is_no_restart(drive: Frames) -> None:
    back = patched(drive, 0x526, 0xFFFF, 15, ago(drive, 500))
    back = patched(back, 0x526, 0xFFFF, 16, int(drive.t_ns[0]), drive.t_ns[-1] - drive.t_ns[0] - S // 2)
    assert not found(back, "restart")


def test_a_car_on_another_bus_is_not_called_ok(drive: Frames) -> None:
    other = replace(drive, channel=np.ones_like(drive.channel), channels=["can0", "can1"])
    first = replace(drive, channels=["can0", "can1"])
    verdict = judged(in_order(first, other.only(other.t_ns > drive.t_ns[0] + S)))
    assert verdict.line().startswith("UNKNOWN: 0x520 is on can1 too: only the car on can0 was judged")
    assert not judged(in_order(first, without(other, *VCU_IDS))).unknown
    devices = judged(in_order(first, without(other, *AI_IDS, *VCU_IDS)))
    assert devices.ok, "a bus of sensors lacks nothing of the car's"
    gone = in_order(first.only(first.t_ns < drive.t_ns[-1] - 2 * S), other.only(other.t_ns > drive.t_ns[-1] - 2 * S))
    seconds = (int(drive.t_ns[-1]) - int(drive.t_ns[0])) / S
    part = judged_frames(gone, part=Part(f"{seconds - 1.5}")).verdict
    assert part.line().startswith("UNKNOWN: 0x520 is on can1 too"), "the log's car was on can0"


def test_a_car_that_starts_anew_in_as_init_is_noted(drive: Frames) -> None:
    begin_ns = int(drive.t_ns[0]) + 3 * S
    early = patched(drive, 0x520, 0xF << 16, 1 << 16, begin_ns, 300 * MS)  # AS_OFF, then AS_INIT again
    texts = [one.words for one in judged(early).findings if one.severity == "note"]
    assert "the VCU started again: AS_STATE AS_OFF → AS_INIT" in texts


def test_a_car_that_was_switched_off_has_not_restarted(drive: Frames) -> None:
    ended = drive.only(drive.t_ns < drive.t_ns[-1] - S)
    again = ended.at(ended.t_ns + (ended.t_ns[-1] - ended.t_ns[0]) + 10 * S)
    assert not found(joined([ended, again]), "restart")


@pytest.mark.parametrize("chosen", [",520:7F8", " --messages VCU2AI_*", " --messages AI2VCU_*", " --messages 0x525"])
def test_what_a_filter_leaves_out_is_not_missing(
    drive: Frames, chosen: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "run.log"
    path.write_bytes(b"\n".join(log_lines(drive)) + b"\n")
    whole = judged(drive)
    assert main(["check", *f"{path}{chosen}".split()]) == 0
    said = capsys.readouterr().out
    assert said.endswith("verdict: OK, of the chosen messages alone\n") and "never received" not in said
    assert whole.ok and "chosen" not in whole.line()


def test_a_message_that_is_chosen_is_missing(drive: Frames, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "run.log"
    path.write_bytes(b"\n".join(log_lines(without(drive, 0x523))) + b"\n")
    assert main(["check", str(path), "--messages", "VCU2AI_*"]) == 1
    assert "problem: VCU2AI_Steer (0x523) was never received" in capsys.readouterr().out
