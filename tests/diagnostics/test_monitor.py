"""The monitor without a terminal: what it shows of a moment, what it remembers, how it moves in a log. No bus."""

from __future__ import annotations

import io
import re
import signal
import threading
import time
from collections.abc import Iterator
from concurrent.futures import Future, wait
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console
from story_runs import Ended, after, branch, driving, of_ids, twice

from fsai_vcu.diagnostics.decode.databases import load_databases
from fsai_vcu.diagnostics.explain import Record
from fsai_vcu.diagnostics.explain import signals as sig
from fsai_vcu.diagnostics.explain.causes import CAUSES
from fsai_vcu.diagnostics.log.frames import Frames, LogFrame, frames_of, joined
from fsai_vcu.diagnostics.monitor import sources
from fsai_vcu.diagnostics.monitor.drawing import head, history_row, instruments, message_row, overview
from fsai_vcu.diagnostics.monitor.snapshot import Freshness, History, MessagePicture, Picture, plain_line
from fsai_vcu.diagnostics.monitor.sources import Live, PlayedLog
from fsai_vcu.diagnostics.monitor.state_history import LONG_NS
from fsai_vcu.diagnostics.monitor.view import EXPECTED, TREND_NS, View
from fsai_vcu.interface.enums import Ami, AsState
from fsai_vcu.interface.reserved import AI_IDS
from fsai_vcu.interface.units import MS, S

CYCLE = 10 * MS
STEER = bytes.fromhex("7B002C017B00")  # ANGLE 12.3, ANGLE_MAX 30, ANGLE_REQUEST 12.3


def status(
    state: AsState, *, go: bool = False, asms: bool = True, tsms: bool = True, ami: Ami = Ami.TRACKDRIVE, bits: int = 0
) -> bytes:
    """A 0x520 of a 2026 car with everything up."""
    switches = (asms << 9) | (tsms << 10) | (go << 11) | (1 << 12)
    word = switches | (state << 16) | (ami << 20) | (2 << 4) | (3 << 28) | (2 << 36) | bits
    return word.to_bytes(8, "little")


def every_cycle(begin_ns: int, end_ns: int, *sent: tuple[int, bytes | str]) -> Frames:
    """The same frames every 10 ms, half a millisecond apart."""
    return frames_of(
        LogFrame(t_ns + place * MS // 2, "can0", can_id, bytes.fromhex(data) if isinstance(data, str) else data)
        for t_ns in range(begin_ns, end_ns, CYCLE)
        for place, (can_id, data) in enumerate(sent)
    )


OFF = (0x520, status(AsState.AS_OFF))
DRIVING = (0x520, status(AsState.AS_DRIVING, go=True))
AI = [(0x510, "0010000000000000"), (0x511, "00000000"), (0x512, "00000000"), (0x513, "0000"), (0x514, "0000")]
GOOD = every_cycle(0, S, OFF, *AI)
TOGGLED = (0x520, status(AsState.AS_OFF, bits=1))
ERROR = LogFrame(S, "can0", 0x004, bytes.fromhex("0010000000000000"), error=True)


def later(*sent: tuple[int, bytes | str]) -> Frames:
    """A second of these frames after GOOD."""
    return every_cycle(S, 2 * S, *sent)


def many(begin_ns: int, count: int, data: bytes) -> Frames:
    """That many 0x520, made at once."""
    one = frames_of([LogFrame(begin_ns, "can0", 0x520, data)])
    return one.only(np.zeros(count, np.int64)).at(begin_ns + CYCLE * np.arange(count, dtype=np.int64))


def in_chunks(frames: Frames, length_ns: int = 50 * MS) -> list[Frames]:
    """As a live bus gives them, in the last of which nothing came."""
    begins = range(int(frames.t_ns[0]), int(frames.t_ns[-1]) + 1 + length_ns, length_ns)
    return [frames.only((frames.t_ns >= t_ns) & (frames.t_ns < t_ns + length_ns)) for t_ns in begins]


def watching(*parts: Frames) -> View:
    view = View("can0")
    for part in parts:
        view.update(part)
    return view


def newest(view: View) -> Picture:
    """The picture at its newest frame."""
    assert view.memory.newest_ns is not None
    return view.picture(view.memory.newest_ns)


def seen(*parts: Frames) -> Picture:
    return newest(watching(*parts))


def message(picture: Picture, can_id: int) -> MessagePicture:
    return next(one for one in picture.messages if one.can_id == can_id)


def words(picture: Picture) -> list[str]:
    return [one.words for one in picture.why_not_driving]


# ---------------------------------------------------------------- runs of the simulated car


@pytest.fixture(scope="module")
def go_off() -> Ended:
    return branch(driving(), lambda run: run.switch(go=False), 2.0)


def test_a_driving_car_shows_what_is_asked_and_what_is_given() -> None:
    picture = seen(*in_chunks(branch(driving(), lambda run: None, 0.5).frames))
    assert picture.driving and picture.why_not_driving == ()
    assert (picture.as_state, picture.mission, picture.mode) == ("AS_DRIVING", "ACCELERATION", "autonomous")
    assert (picture.mission_status, picture.direction) == ("RUNNING", "FORWARD")
    assert picture.go and picture.as_switch and picture.ts_switch
    assert picture.speed_mps is not None and picture.speed_mps > 3.0
    assert set(picture.wheels_rpm) == {"FL", "FR", "RL", "RR"}
    rear = picture.actuators["torque rear"]
    assert rear.asked and rear.given and rear.limit and 0.5 * rear.asked < rear.given <= rear.limit
    assert (picture.faults, picture.link, picture.shutdown_cause) == ((), (), None)
    assert picture.handshake is not None and picture.handshake.unanswered == 0
    assert picture.load is not None and 0.1 < picture.load < 0.9
    assert picture.revision == "2026"
    assert {m.freshness for m in picture.messages if m.can_id in EXPECTED} == {Freshness.FRESH}


def test_an_emergency_shows_cause_and_remedy_while_it_lasts(go_off: Ended) -> None:
    view = View("can0")
    for chunk in in_chunks(go_off.frames, 250 * MS):
        view.update(chunk)
        picture = newest(view)
    assert picture.as_state == "EMERGENCY_BRAKE"
    assert "Go went off" in words(picture)[0] and picture.why_not_driving[0].remedy
    # Long after the frames around it are forgotten, it is still known.
    last = go_off.frames.only(go_off.frames.t_ns > go_off.frames.t_ns[-1] - CYCLE)
    for step in range(0, 2 * LONG_NS, 250 * MS):
        view.update(last.at(last.t_ns + CYCLE + step))
    assert "Go went off" in words(newest(view))[0]


def test_an_emergency_brake_from_before_is_reported_as_such() -> None:
    picture = seen(every_cycle(0, S, (0x520, status(AsState.EMERGENCY_BRAKE)), *AI))
    assert words(picture) == ["EMERGENCY_BRAKE: wait 15 s, ASMS off, then switch the car off and on"]


@pytest.mark.parametrize(
    ("ami", "acknowledged", "mode"),
    [
        (Ami.NOT_SELECTED, [(0x510, "00" * 8)], "unknown before a mission"),
        (Ami.TRACKDRIVE, [(0x510, "00" * 8)], "manual or unconfirmed"),
        (Ami.TRACKDRIVE, AI, "autonomous"),
        (Ami.TRACKDRIVE, [], "unknown"),
    ],
)
def test_the_mode_is_known_by_what_the_ai_computer_says(
    ami: Ami, acknowledged: list[tuple[int, str]], mode: str
) -> None:
    picture = seen(GOOD, later((0x520, status(AsState.AS_OFF, ami=ami)), *acknowledged))
    assert (picture.mode, picture.mission_status is None) == (mode, not acknowledged)


# ---------------------------------------------------------------- ages


@pytest.mark.parametrize(
    ("before_ns", "values", "freshness"), [(1, (12.3, 30.0), Freshness.LATE), (0, (None, None), Freshness.LOST)]
)
def test_a_value_disappears_exactly_when_its_message_is_lost(
    before_ns: int, values: tuple[float | None, ...], freshness: Freshness
) -> None:
    frames = every_cycle(0, S, DRIVING, (0x523, STEER), *AI)
    last_ns = int(frames.t_ns[frames.can_id == 0x523][-1])
    picture = watching(frames, later(DRIVING, *AI)).picture(last_ns + 100 * MS - before_ns)
    assert (picture.actuators["steering"].given, picture.actuators["steering"].limit) == values
    assert message(picture, 0x523).freshness is freshness


def test_a_silent_car_shows_no_values_but_its_last_state() -> None:
    view = watching(frames := every_cycle(0, S, DRIVING, *AI))
    last_ns = int(frames.t_ns[frames.can_id == 0x520][-1])
    fresh, lost = (view.picture(last_ns + age_ns) for age_ns in (100 * MS - 1, 100 * MS))
    assert fresh.as_state == "AS_DRIVING" and fresh.driving
    assert (lost.as_state, lost.go, lost.mission, lost.driving) == (None, None, None, False)
    assert lost.as_state_heard == "AS_DRIVING" and lost.status_age_s == pytest.approx(0.1)
    assert words(lost) == ["0x520 is missing for 100 ms: the car is silent"]


AGAIN = later(OFF, *AI)
LINK = {
    "the AI computer is silent for 998 ms: to the VCU that is AI_COMMS_LOST": later(OFF),
    "AI2VCU_Steer (0x513) is missing for 1.00 s: to the VCU that is AI_COMMS_LOST": later(OFF, *AI[:3], AI[4]),
    "AI2VCU_Brake (0x514) has the wrong length: it counts as missing": later(OFF, *AI[:4], (0x514, "000000")),
    "VCU2AI_Wheel_counts (0x526) has the wrong length: it counts as missing": later(OFF, *AI, (0x526, "00")),
    "the handshake's echo is missing for 72 ms (100 ms are a loss)": every_cycle(S, S + 80 * MS, TOGGLED, *AI),
    "a second sender uses the AI computer's ids: 0x510, ": twice(AGAIN, of_ids(AGAIN, AI_IDS), 3 * MS),
    "a second sender sends the car's messages: 0x520: 182 frames a second": twice(AGAIN, of_ids(AGAIN, [0x520])),
    "1 error frame in 3 s, the last: controller (receive error-passive)": frames_of([ERROR]),
}


@pytest.mark.parametrize("sentence", LINK)
def test_each_fault_of_the_link_has_its_sentence_alone(sentence: str) -> None:
    (told,) = seen(GOOD, LINK[sentence]).link
    assert told.startswith(sentence)


def test_rates_are_recent_and_missing_messages_are_named() -> None:
    frames = every_cycle(0, 5 * S, OFF, (0x7AA, "01"))
    picture = seen(*in_chunks(frames))
    status_sent, foreign = message(picture, 0x520), message(picture, 0x7AA)
    assert status_sent.rate_hz == pytest.approx(100, abs=1) and status_sent.expected_hz == 100
    assert foreign.rate_hz == pytest.approx(100, abs=1) and (foreign.name, foreign.expected_hz) == (None, None)
    assert {message(picture, can_id).freshness for can_id in AI_IDS} == {Freshness.NEVER}
    gone = message(seen(frames, every_cycle(5 * S, 9 * S, OFF)), 0x7AA)
    assert (gone.rate_hz, gone.freshness) == (0.0, Freshness.LOST)


def test_an_extended_identifier_is_another_message() -> None:
    picture = seen(GOOD, frames_of([LogFrame(S, "can0", 0x520, b"\x01", extended=True)]))
    assert [(m.number, m.name) for m in picture.messages if m.extended] == [("00000520", None)]
    assert picture.as_state == "AS_OFF"


def test_faults_and_warnings_have_the_specifications_names() -> None:
    bits = (1 << 24) | (1 << 49) | (1 << 33) | (10 << 56)
    picture = seen(every_cycle(0, S, (0x520, status(AsState.AS_OFF, bits=bits)), *AI))
    assert (picture.faults, picture.shutdown_cause) == (("BMS_FAULT",), "BMS_FAULT")
    assert picture.warnings == ("WARN_BATT_SOC_LOW",)
    told = {one.sentence: one.remedy for one in picture.why_not_driving}
    fault = "the car reports a fault (FAULT_STATUS is 1: BMS_FAULT, SHUTDOWN_CAUSE BMS_FAULT)"
    assert told[fault] == CAUSES["bms"].remedy


# ---------------------------------------------------------------- memory


NOT_SWITCHED_OFF = "the car has not been switched off since its last run"


def test_a_missing_power_cycle_is_known_an_hour_after_the_run() -> None:
    run = every_cycle(0, S, (0x520, status(AsState.AS_FINISHED)), *AI)
    hour = many(S, 360_000, OFF[1])
    view = watching(run, *in_chunks(hour, 10 * S))
    now_ns = int(hour.t_ns[-1])
    assert NOT_SWITCHED_OFF in words(view.picture(now_ns))
    window = view.memory.window(now_ns)
    assert len(view.memory.condensed(window)) - len(window) < 8000
    switched = seen(run, many(S, 100, OFF[1]), many(4 * S, 360_000, OFF[1]))
    assert NOT_SWITCHED_OFF not in words(switched)


@pytest.mark.parametrize("shift_ns", range(0, 500 * MS, 50 * MS))
def test_a_silence_of_less_than_1_s_is_never_a_power_cycle(shift_ns: int) -> None:
    run = every_cycle(0, S + shift_ns, (0x520, status(AsState.AS_FINISHED)), *AI)
    before = many(S + shift_ns, 43, OFF[1])
    after_it = many(int(before.t_ns[-1]) + 990 * MS, 2000, OFF[1])
    assert NOT_SWITCHED_OFF in words(seen(run, before, after_it))


def test_times_that_step_back_do_not_make_old_frames_new() -> None:
    frames = every_cycle(100 * S, 101 * S, (0x520, status(AsState.AS_READY)), *AI)
    view = watching(frames, *in_chunks(every_cycle(0, S, DRIVING, *AI)))
    assert view.memory.newest_ns == 101 * S - CYCLE + 2 * (5 * MS // 2) + 99 * CYCLE
    picture = newest(view)
    assert picture.as_state == "AS_DRIVING" and picture.as_state_s == pytest.approx(0.99, abs=0.02)


def test_chunks_of_any_size_give_the_same_picture() -> None:
    frames = branch(driving(), lambda run: None, 0.2).frames
    now_ns = int(frames.t_ns[-1])
    frames = after(frames, now_ns - 3 * S)
    small, large = seen(*in_chunks(frames, 7 * MS)), seen(frames)
    assert small.t_ns == large.t_ns == now_ns
    assert small.as_dict() == large.as_dict()


def test_the_revision_is_recognised_or_as_given() -> None:
    status_2021, steer, system = bytes.fromhex("0016110000000000"), "0000d2000000", "0400010000000000"
    old = every_cycle(0, S, (0x520, status_2021), (0x523, steer), (0x120, system))
    assert seen(old).revision == "2021"
    assert "TS_STATE" not in seen(old).states
    given = View("can0", "2026")
    given.update(old)
    assert given.picture(S).revision == "2026"


# ---------------------------------------------------------------- what changed


def test_a_byte_says_when_and_how_often_it_changed() -> None:
    view = watching(every_cycle(0, 2 * S, (0x7AA, "0102")), every_cycle(2 * S, 3 * S, (0x7AA, "0107")))
    assert message(view.picture(2 * S + 500 * MS), 0x7AA).changed == (1,)
    assert message(view.picture(3 * S + 1), 0x7AA).changed == ()
    first, second = view.bytes(0x7AA, 3 * S)
    assert (first.value, first.changes, first.changed_s) == ("01", 0, None)
    assert (second.value, second.before, second.changes, second.changed_s) == ("07", "02", 1, 1.0)


def test_signals_are_picked_by_name_or_message_in_any_case(go_off: Ended) -> None:
    view = watching(go_off.frames)
    now_ns = int(go_off.frames.t_ns[-1])
    assert view.signals(["*"], now_ns) == []  # by which database nobody knows yet
    view.picture(now_ns)
    (state,) = view.signals(["as_state"], now_ns)
    assert (state.name, state.value, state.before) == ("VCU2AI_Status.AS_STATE", "EMERGENCY_BRAKE", "AS_DRIVING")
    assert state.changed_s == pytest.approx(2.0, abs=0.05)
    rears = view.signals(["vcu2ai_drive_r.rear_axle_trq_[nm]*", "nothing"], now_ns)
    assert [one.name for one in rears] == ["VCU2AI_Drive_R.REAR_AXLE_TRQ_Nm", "VCU2AI_Drive_R.REAR_AXLE_TRQ_MAX_Nm"]
    assert re.fullmatch(r"0 … [\d.]+", rears[0].extent) and rears[0].value.endswith(" Nm")


def test_signals_of_a_foreign_database_have_its_words(tmp_path: Path) -> None:
    path = tmp_path / "lamp.dbc"
    path.write_text(
        'VERSION ""\n\nBU_: A\n\nBO_ 419 Lamp: 2 A\n SG_ COLOUR : 0|4@1+ (1,0) [0|15] "" A\n'
        ' SG_ LEVEL : 8|8@1+ (0.5,0) [0|100] "%" A\n\nVAL_ 419 COLOUR 0 "OFF" 1 "RED";\n'
    )
    view = View("can0", databases=load_databases([path]))
    view.update(every_cycle(0, S, (0x1A3, "0032"), OFF))
    view.update(later((0x1A3, "0119"), OFF))
    view.picture(2 * S)
    found = {one.name: (one.value, one.before, one.extent) for one in view.signals(["*"], 2 * S)}
    assert found == {"Lamp.COLOUR": ("RED", "OFF", ""), "Lamp.LEVEL": ("12.5 %", "25 %", "12.5 … 25")}


def test_events_are_remembered_an_hour_later_with_times() -> None:
    run = [
        GOOD,
        later((0x520, status(AsState.AS_READY)), *AI),
        every_cycle(2 * S, 3 * S, DRIVING, *AI),
        every_cycle(3 * S, 4 * S, (0x520, status(AsState.EMERGENCY_BRAKE, bits=1 << 24 | 1 << 49)), *AI),
    ]
    view = watching(*run, *in_chunks(many(4 * S, 360_000, OFF[1]), 10 * S))
    found = {one.text: one.t_ns for one in view.events()}
    assert found["AS_STATE AS_OFF → AS_READY"] == S
    assert found["AS_STATE AS_READY → AS_DRIVING"] == found["Go on"] == 2 * S
    assert found["Go off"] == found["BMS_FAULT 1"] == 3 * S
    assert found["AMI_STATE TRACKDRIVE"] == 0
    assert not any("silent" in text or "missing" in text for text in found)


# ---------------------------------------------------------------- a log


def test_any_moment_of_a_log_is_as_if_it_had_just_come(go_off: Ended) -> None:
    frames = go_off.frames
    log = PlayedLog(iter(in_chunks(frames, 700 * MS)), View("can0"), 0.0, None)
    begin_ns, end_ns = int(frames.t_ns[0]), int(frames.t_ns[-1])
    assert (log.begin_ns, log.end_ns, log.position_ns) == (begin_ns, end_ns, begin_ns)
    for t_ns in (end_ns, begin_ns + S // 3, begin_ns + 700 * MS, end_ns - S, begin_ns + 5 * S):
        log.seek(t_ns)
        fresh = watching(frames.only(frames.t_ns <= t_ns))
        assert log.look().picture.as_dict() == fresh.picture(t_ns).as_dict()
    log.seek(end_ns + S)
    assert log.position_ns == end_ns and log.ended
    log.seek(begin_ns - S)
    assert log.position_ns == begin_ns and not log.ended


def test_an_old_emergency_brake_in_a_log_keeps_its_cause() -> None:
    frames = branch(driving(), lambda run: run.switch(asms=False), 2.0).frames
    last = frames.only(frames.t_ns > frames.t_ns[-1] - CYCLE)
    after = [last.at(last.t_ns + step) for step in range(CYCLE, 2 * LONG_NS, CYCLE)]
    log = PlayedLog(iter([*in_chunks(frames), joined(after)]), View("can0"), None, None)
    assert "ASMS was turned off" in log.look().picture.why_not_driving[0].words


def test_a_log_plays_and_pauses_and_begins_again_at_its_end() -> None:
    log = PlayedLog(iter([every_cycle(0, 3 * S, OFF)]), View("can0"), None, 2.0)
    positions = []
    for seconds in (0.5, 0.5, 1.0):
        log.advance(seconds)
        positions.append(log.position_ns)
    assert positions == [S, 2 * S, 3 * S - CYCLE] and not log.playing
    log.pause()
    assert (log.position_ns, log.playing) == (0, True)
    log.pause()
    log.advance(1.0)
    assert (log.position_ns, log.playing) == (0, False)
    assert log.clock(1_234 * MS) == "1.234 s"


def test_a_log_is_read_only_as_far_as_is_looked() -> None:
    chunks = iter(in_chunks(every_cycle(0, 60 * S, OFF), 700 * MS))
    log = PlayedLog(chunks, View("can0"), None, 1.0)
    log.advance(1.0)
    assert not log.ended and next(chunks).t_ns[0] < 4 * S


# ---------------------------------------------------------------- a bus


@pytest.fixture
def standing(monkeypatch: pytest.MonkeyPatch) -> tuple[int, int]:
    """Both clocks, wall and monotonic, stand: however long this machine takes, nothing gets older meanwhile."""
    wall_ns, now_ns = time.time_ns(), time.monotonic_ns()
    monkeypatch.setattr(time, "time_ns", lambda: wall_ns)
    monkeypatch.setattr(time, "monotonic_ns", lambda: now_ns)
    return wall_ns, now_ns


def test_a_held_picture_stays_and_nothing_is_lost_meanwhile(standing: tuple[int, int]) -> None:
    go_on = threading.Event()
    now_ns, heard_ns = standing[0], [standing[1]]

    def chunks() -> Iterator[Frames]:
        yield every_cycle(now_ns - S, now_ns, OFF)
        go_on.wait()
        heard_ns.append(heard_ns[0] + 200 * MS)
        yield every_cycle(now_ns, now_ns + 200 * MS, (0x520, status(AsState.AS_READY)))

    live = Live(chunks(), View("can0"), heard_ns=lambda: heard_ns[-1])
    while live.look().picture.as_state is None:
        pass
    live.pause()
    held = live.look()
    go_on.set()
    live.wait(60.0)
    assert live.ended and live.look() is held and held.words.startswith("paused at ")
    live.pause()
    assert live.look().picture.as_state == "AS_READY"
    assert [one.text for one in live.events() if one.topic == "AS state"][-1] == "AS_STATE AS_OFF → AS_READY"
    live.close()


@pytest.mark.parametrize("lags", [True, False])
def test_a_display_that_lags_does_not_call_the_car_silent(standing: tuple[int, int], lags: bool) -> None:
    wall_ns, now_ns = standing
    before = every_cycle(wall_ns - 3 * S, wall_ns - 2 * S, (0x520, status(AsState.AS_DRIVING)))
    live = Live(iter([before]), View("can0"), heard_ns=lambda: now_ns - (2 * S if lags else 0))
    live.wait(60.0)
    picture = live.look().picture
    assert (message(picture, 0x520).freshness, picture.as_state) == (
        (Freshness.FRESH, "AS_DRIVING") if lags else (Freshness.LOST, None)
    )
    assert any(text.startswith("this display lags by ") for text in picture.link) == lags
    live.close()


def test_what_ends_the_reading_of_a_bus_is_raised_at_close() -> None:
    def chunks() -> Iterator[Frames]:
        yield every_cycle(0, S, OFF)
        raise OSError("no such bus any more")

    live = Live(chunks(), View("can0"))
    live.wait(60.0)
    assert live.ended
    with pytest.raises(OSError, match="no such bus"):
        live.close()


def test_a_second_ctrl_c_waits_for_the_chunk_that_is_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    go_on, pressed = threading.Event(), []

    def chunks() -> Iterator[Frames]:
        go_on.wait()
        yield every_cycle(0, S, OFF)

    def interrupted(waited: list[Future[None]]) -> None:
        pressed.append(not go_on.is_set())
        go_on.set()
        wait(waited) if len(pressed) > 1 else signal.raise_signal(signal.SIGINT)

    live = Live(reading := chunks(), View("can0"))
    monkeypatch.setattr(sources, "wait", interrupted)
    live.close()
    reading.close()  # raises ValueError while it is still read
    assert live.ended and pressed[0]


# ---------------------------------------------------------------- laps and trends


def test_lap_times_between_the_counters_steps_are_remembered() -> None:
    moved, ends = 3 * S, (40 * S, 75 * S)
    view = watching(
        every_cycle(-S, 0, (0x520, status(AsState.AS_READY)), (0x525, "00" * 8), (0x510, "0010040000000000"))
    )
    edges = [0, moved, *ends, 80 * S]
    for lap, rpm, begin_ns, end_ns in zip((0, 0, 1, 2), ("0000", *["2800"] * 3), edges, edges[1:], strict=False):
        view.update(every_cycle(begin_ns, end_ns, DRIVING, (0x525, rpm * 4), (0x510, f"00200{lap}0000000000")))
    picture = view.picture(80 * S)
    assert (picture.lap, picture.laps, picture.lap_times_s) == (2, 10, pytest.approx((37.0, 35.0), abs=0.011))
    assert view.picture(20 * S).lap_times_s == ()


def test_trends_are_the_last_ten_seconds_of_the_bus(go_off: Ended) -> None:
    view = watching(go_off.frames)
    end_ns = int(go_off.frames.t_ns[-1])
    view.picture(end_ns)
    trends, record = view.trends(end_ns), Record(go_off.frames)
    given = record.series(sig.ANGLE).between(end_ns - TREND_NS + 1, end_ns)
    assert trends["steering given"].values.tolist() == given.values.tolist() and len(given) > 900
    fastest_mps = record.car.speed_of_wheel_rpm(float(record.middle_wheel.values.max()))
    assert trends["speed"].values.max() == pytest.approx(fastest_mps, 0.1)
    text = instruments(view.picture(end_ns), trends, 46)
    assert max(map(len, text.plain.splitlines())) <= 46 and "of 500 kbit/s" in text.plain
    assert set(text.plain.splitlines()[1].strip()) >= {"▁", "█"}, "the car drove and stands"


# ---------------------------------------------------------------- drawing


def drawn(picture: Picture, width: int, height: int, *, dark_phase: bool = False, color: bool = False) -> list[str]:
    out = io.StringIO()
    console = Console(file=out, width=width, highlight=False, color_system="standard" if color else None)
    console.print(head(picture, "12:34:56", width))
    console.print(overview(picture, width, height, dark_phase=dark_phase))
    return [line.rstrip() for line in out.getvalue().splitlines()]


@pytest.mark.parametrize(("width", "height"), [(80, 24), (40, 10), (20, 5), (132, 43)])
def test_a_picture_never_is_wider_than_the_terminal(width: int, height: int, go_off: Ended) -> None:
    strange = frames_of([LogFrame(int(go_off.frames.t_ns[-1]), "can0", can_id) for can_id in range(0x700, 0x740)])
    for picture in (
        seen(go_off.frames, strange),
        watching(go_off.frames).picture(int(go_off.frames.t_ns[-1]) + 4000 * S),
        View("can0").picture(0),
    ):
        assert max(map(len, drawn(picture, width, height))) <= width
        for row in (message_row(one, width) for one in picture.messages):
            assert len(row) <= width and "\n" not in row.plain


def test_80_by_24_shows_everything_at_once(go_off: Ended) -> None:
    text = "\n".join(drawn(seen(go_off.frames), 79, 24)[:23])
    for part in (
        "● EMERGENCY_BRAKE for 2.0 s  Go off  ASMS on  TSMS on  mode autonomous\n",
        "mission ACCELERATION",
        "why not driving:\n  - the remote's Go went off",
        "steering        0.0",
        "torque rear     0.0",
        "brake front     0.0  100.0        %",
        "speed       0.0 m/s, 0 km/h   rpm  FL 0",
        "handshake   answered in",
        "faults      none",
        "510 AI2VCU_Status          100/s",
        "514 AI2VCU_Brake           100/s",
    ):
        assert part in text, part


def test_a_small_screen_keeps_the_reasons_before_the_figures() -> None:
    picture = seen(every_cycle(0, S, (0x520, status(AsState.AS_OFF, asms=False, ami=Ami.NOT_SELECTED)), *AI))
    lines = drawn(picture, 39, 14)[:13]
    text = re.sub(r"\s+", " ", "\n".join(lines[lines.index("why not driving:") :]))
    assert len(words(picture)) > 1 and all(f"- {reason}" in text for reason in words(picture)), text
    empty = drawn(View("can0").picture(0), 39, 14)
    assert empty[-1] == "! nothing is received on this bus" and len(empty) < 8


def test_messages_that_are_not_well_are_shown_first() -> None:
    others = [(can_id, "01") for can_id in range(0x700, 0x715)]
    lines = drawn(seen(every_cycle(0, S, OFF, *others, (0x7FF, "")), every_cycle(S, 5 * S, OFF, *others)), 80, 24)
    assert any(re.search(r"7FF in no database .* LOST", line) for line in lines[:24])


@pytest.mark.parametrize(
    ("state", "light", "flashes"),
    [
        (AsState.AS_READY, "30;43", False),
        (AsState.AS_DRIVING, "30;43", True),
        (AsState.EMERGENCY_BRAKE, "37;44", True),
        (AsState.AS_FINISHED, "37;44", False),
        (AsState.AS_OFF, "", False),
    ],
)
def test_a_state_has_the_colour_of_the_cars_lights(state: AsState, light: str, flashes: bool) -> None:
    picture = seen(every_cycle(0, S, (0x520, status(state)), *AI))
    bright, dark = (drawn(picture, 80, 24, color=True, dark_phase=phase)[1] for phase in (False, True))
    for shown in (bright, dark):  # the colour stays, a lamp flashes
        assert (light in shown.split("m")[0]) and ("4" in shown.split("m")[0]) == bool(light)
    assert (bright != dark) == flashes and bool(light) == ("● " in bright) and flashes == ("○ " in dark)


def test_changed_bytes_and_values_are_highlighted() -> None:
    view = watching(every_cycle(0, S, (0x7AA, "0102")), later((0x7AA, "0107")))
    row = message_row(message(view.picture(S + 100 * MS), 0x7AA), 80)
    assert [row.plain[span.start : span.end] for span in row.spans if "reverse" in str(span.style)] == ["07"]
    now, old = (history_row(view.bytes(0x7AA, t_ns)[1], 80) for t_ns in (S + 100 * MS, 3 * S))
    marked = [[span for span in each.spans if "reverse" in str(span.style)] for each in (now, old)]
    assert list(map(len, marked)) == [1, 0] and "100 ms ago, 1×, was 02" in now.plain


def test_a_value_that_does_not_fit_ends_in_a_mark() -> None:
    moved = History("VCU2AI_Steer.ANGLE", "12.5 deg", 0.0, 12, 0.03, "12.4 deg", "-21.4321 … 17.1234")
    wide, narrow = (history_row(moved, width).plain for width in (79, 39))
    assert wide.endswith("30 ms ago, 12×, -21.432…") and len(wide) <= 79
    assert narrow.endswith("12.5 deg  30 ms") and len(narrow) <= 39


def test_control_characters_in_names_never_reach_the_terminal(go_off: Ended) -> None:
    view = View("\x1b]0;evil\x07bus")
    view.update(go_off.frames)
    assert all(line.isprintable() for line in [*drawn(newest(view), 80, 24), plain_line(newest(view), "\x1b[2J")])


def test_the_plain_line_is_one_line_with_the_reasons(go_off: Ended) -> None:
    line = plain_line(seen(go_off.frames), "12:34:56")
    assert "\n" not in line
    assert line.startswith("12:34:56 | EMERGENCY_BRAKE | ACCELERATION | mode autonomous | Go off | 0.0 m/s")
    assert "why not driving: the remote's Go went off" in line
