"""What a bus did is measured as it was, and what is wrong is said; what is well is not called wrong."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from story_runs import driving, log_of

from fsai_hil.rules.checker import WireChecker
from fsai_vcu.diagnostics.decode.databases import load_databases
from fsai_vcu.diagnostics.decode.decoder import Decoder
from fsai_vcu.diagnostics.finding import Finding
from fsai_vcu.diagnostics.log.frames import LogFrame, frames_of
from fsai_vcu.diagnostics.statistics.measure import BusStatistics, measure
from fsai_vcu.diagnostics.statistics.quantiles import quantile
from fsai_vcu.diagnostics.verdict.of_bus import judge
from fsai_vcu.interface.bus_table import BUS_TABLE, Flow
from fsai_vcu.interface.codec import Codec
from fsai_vcu.interface.reserved import AI_IDS
from fsai_vcu.interface.revisions import revision
from fsai_vcu.interface.units import MS, S

DECODER = Decoder(load_databases())


def nominal(seconds: float = 3.0) -> list[LogFrame]:
    """A bus as it should be: each message at its period, the handshake answered after 1 ms, wheels that turn."""
    frames = []
    for message in BUS_TABLE:
        period_ns = message.period_ns.get("2026")
        if period_ns is None or message.flow is Flow.OTHER:
            continue
        late_ns = MS if message.can_id in AI_IDS else 0
        for step in range(int(seconds * 1e9) // period_ns):
            data = bytearray(message.dlc)
            if message.can_id in (0x510, 0x520):
                data[0] = step & 1
            if message.can_id == 0x525:
                data[0::2] = bytes([100] * 4)
            if message.can_id == 0x526:
                data[0::2] = bytes([step * 3 & 0xFF] * 4)
            frames.append(LogFrame(step * period_ns + late_ns, "can0", message.can_id, bytes(data)))
    return sorted(frames, key=lambda frame: frame.t_ns)


NOMINAL = nominal()


def measured(frames: Sequence[LogFrame]) -> BusStatistics:
    (bus,) = measure(frames_of(frames), DECODER, revision="2026")
    return bus


def problems(frames: Sequence[LogFrame]) -> list[Finding]:
    return [finding for finding in judge(measured(frames)) if finding.severity == "problem"]


def only(frames: Sequence[LogFrame], kind: str) -> Finding:
    """The one problem there is, of this kind."""
    found = problems(frames)
    assert [finding.kind for finding in found] == [kind], found
    return found[0]


def test_a_bus_as_it_should_be_is_well() -> None:
    assert problems(NOMINAL) == []


def test_periods_jitter_and_gaps_are_those_of_the_times() -> None:
    rng = np.random.default_rng(3)
    times = np.cumsum(np.full(1000, 10 * MS) + rng.integers(-MS, MS, 1000))
    times[500:] += 45 * MS
    frames = [LogFrame(int(t_ns), "can0", 0x523, bytes(6)) for t_ns in times]
    bus = measured(frames)
    (message,) = bus.messages
    intervals = np.sort(np.diff(times))
    jitter = np.sort(np.abs(np.diff(times) - 10 * MS))
    assert message.expected_ms == 10
    assert message.interval_ms.p50_ms == intervals[499] / MS
    assert message.jitter_ms.p99_ms == jitter[989] / MS  # nearest rank of 999
    assert message.jitter_ms.max_ms == jitter[-1] / MS
    assert message.gaps == 1
    assert message.longest_gap_ms == intervals[-1] / MS
    assert message.longest_gap_at_s == times[499] / 1e9
    assert message.frozen_ms == (times[-1] - times[0]) / MS


@pytest.mark.parametrize(("share", "rank"), [(0.0, 1), (0.5, 50), (0.501, 51), (0.99, 99), (0.991, 100), (1.0, 100)])
def test_a_quantile_is_a_value_that_was_measured(share: float, rank: int) -> None:
    assert quantile(range(1, 101), share) == rank
    assert quantile(np.arange(1, 101), share) == rank  # type: ignore[arg-type]


def test_there_is_no_quantile_of_nothing_and_none_beyond_all() -> None:
    assert quantile([], 0.5) is None
    with pytest.raises(ValueError, match="0 to 1"):
        quantile([1], 1.1)


def test_a_silence_of_the_timeout_is_a_loss_a_shorter_one_a_note() -> None:
    def without(for_ms: int) -> list[LogFrame]:
        return [f for f in NOMINAL if f.can_id != 0x523 or not 1000 * MS < f.t_ns < (1000 + for_ms) * MS]

    found = only(without(100), "gap")
    assert (found.can_ids, found.t_ns) == ((0x523,), S)
    assert "silent for 100.0 ms" in found.words
    assert problems(without(99)) == [] or "silent for 100.0" in problems(without(99))[0].words
    assert problems(without(90)) == []
    assert [f.kind for f in judge(measured(without(50))) if f.can_ids == (0x523,)] == ["gap"]


def test_a_message_that_never_comes_is_missed() -> None:
    found = only([f for f in NOMINAL if f.can_id != 0x524], "missing")
    assert found.words == "VCU2AI_Brake (0x524) was never received"


def test_a_message_at_the_wrong_rate_is_named_with_both_periods() -> None:
    frames = [f for f in NOMINAL if f.can_id != 0x521 or f.t_ns // (10 * MS) % 2]
    found = only(frames, "period")
    assert "comes every 20.00 ms instead of every 10 ms" in found.words


def test_a_frame_of_the_wrong_length_is_a_problem_with_its_count() -> None:
    spoilt = [replace(f, data=f.data[:-1], length=5) if f.can_id == 0x522 and f.t_ns < 50 * MS else f for f in NOMINAL]
    found = only(spoilt, "wrong-length")
    assert found.words == "VCU2AI_Drive_R (0x522) must have 6 bytes: 5 of 5 bytes"
    assert found.t_ns == next(f.t_ns for f in spoilt if f.can_id == 0x522)


def test_a_reserved_id_sent_by_this_computer_is_a_problem() -> None:
    frames = sorted([*NOMINAL, LogFrame(5 * MS, "can0", 0x700, b"\x00", sent=True)], key=lambda f: f.t_ns)
    found = only(frames, "reserved")
    assert "sent 1 times by this computer" in found.words and found.t_ns == 5 * MS


def test_a_remote_frame_is_a_problem_of_its_moment() -> None:
    asked = LogFrame(55 * MS, "can0", 0x513, remote=True, length=2)
    found = only(sorted([*NOMINAL, asked], key=lambda f: f.t_ns), "remote-frames")
    assert "1 remote frames" in found.words and found.t_ns == 55 * MS


def test_an_unknown_id_is_noted_and_does_not_change_the_verdict() -> None:
    frames = [*NOMINAL, LogFrame(NOMINAL[-1].t_ns, "can0", 0x7A1, b"\x01")]
    assert [f.words for f in judge(measured(frames)) if f.kind == "unknown"] == ["0x7A1 is in no database: 1 frames"]
    assert not problems(frames)


def test_error_frames_are_a_problem_in_words() -> None:
    errors = [LogFrame(NOMINAL[-1].t_ns, "can0", 0x040, bytes(8), error=True)] * 3
    assert only([*NOMINAL, *errors], "error-frames").words == "3 error frames: bus-off"


def test_a_standing_pulse_counter_of_a_turning_wheel_is_frozen() -> None:
    def stuck(f: LogFrame) -> LogFrame:
        return replace(f, data=f.data[:4] + b"\x07\x00" + f.data[6:]) if f.can_id == 0x526 and f.t_ns > 1000 * MS else f

    found = only([stuck(f) for f in NOMINAL], "frozen")
    assert "RL_PULSE_COUNT stood still for 2.0 s while its wheel turned" in found.words
    at_rest = [replace(stuck(f), data=bytes(8)) if f.can_id == 0x525 else stuck(f) for f in NOMINAL]
    assert problems(at_rest) == []


def test_the_response_ends_with_the_first_frame_of_the_new_bit() -> None:
    handshake = measured(NOMINAL).handshake
    assert handshake is not None
    assert (handshake.answered, handshake.unanswered) == (299, 0)
    assert (handshake.response_ms.p50_ms, handshake.response_ms.max_ms) == (1.0, 1.0)


def test_an_echo_that_takes_100_ms_is_a_problem_and_99_is_not() -> None:
    def late(by_ns: int) -> list[LogFrame]:
        """The VCU waits for each echo, which comes late once."""
        frames = [f for f in NOMINAL if f.can_id not in (0x510, 0x520)]
        for step in range(300):
            t_ns = step * 10 * MS
            waiting = t_ns > 1000 * MS
            toggled = t_ns >= 1010 * MS
            answer_ns = t_ns + (by_ns % (10 * MS) if toggled else MS)
            echoed = answer_ns >= 1010 * MS + by_ns
            bit = step & 1 if not waiting else int(toggled)
            answer = bit if not toggled else int(echoed)
            frames.append(LogFrame(t_ns, "can0", 0x520, bytes([bit]) + bytes(7)))
            frames.append(LogFrame(answer_ns, "can0", 0x510, bytes([answer]) + bytes(7)))
        return sorted(frames, key=lambda f: f.t_ns)

    found = only(late(100 * MS), "handshake")
    assert "1 answered after 100 ms or more" in found.words
    assert found.t_ns == 1010 * MS
    assert "handshake" not in {finding.kind for finding in problems(late(99 * MS))}


def test_an_echo_that_is_a_cycle_late_has_its_real_time() -> None:
    late = [replace(f, data=bytes([1 - f.data[0]]) + f.data[1:]) if f.can_id == 0x510 else f for f in NOMINAL]
    bus = measured(late)
    assert bus.handshake is not None and bus.handshake.answered == 298
    assert (bus.handshake.response_ms.p50_ms, bus.handshake.response_ms.max_ms) == (11.0, 11.0)
    # The bit changes with each frame: that may as well be its inverse, which no car takes.
    (said,) = (f.words for f in judge(bus) if f.kind in ("handshake", "echo"))
    assert said.startswith(
        "the AI computer sends back the inverse of the HANDSHAKE bit, or the bit of the 0x520 before"
    )


def test_the_load_is_the_share_of_the_possible_bits() -> None:
    frames = [LogFrame(step * MS, "can0", 0x555, b"\x55" * 8) for step in range(1001)]
    bus = measured(frames)
    assert bus.bitrate == 500_000
    bits = bus.messages[0].bits
    assert bus.load == pytest.approx(bits / 500_000)
    assert bus.peak_load == pytest.approx(bits / 1001 * 100 / 50_000)


def test_each_channel_is_measured_by_itself() -> None:
    both = [f for pair in zip(NOMINAL, [replace(f, channel="can1") for f in NOMINAL], strict=True) for f in pair]
    buses = measure(frames_of(both), DECODER, revision="2026")
    assert [bus.channel for bus in buses] == ["can0", "can1"]
    assert [bus.frames for bus in buses] == [len(NOMINAL)] * 2
    assert not any(found.severity == "problem" for bus in buses for found in judge(bus))


def test_a_log_without_times_is_counted_and_not_timed() -> None:
    bus = measured([replace(f, t_ns=0) for f in NOMINAL])
    assert not bus.duration_s
    assert {m.interval_ms.p50_ms for m in bus.messages} == {None}
    assert "no-times" in {finding.kind for finding in judge(bus)}


def test_times_that_go_backwards_are_said() -> None:
    frames = [*NOMINAL[:2000], replace(NOMINAL[2000], t_ns=0), *NOMINAL[2001:]]
    (found,) = [finding for finding in judge(measured(frames)) if finding.kind == "clock"]
    assert found.words.startswith("times go backwards once") and found.t_ns == NOMINAL[1999].t_ns


def test_a_simulated_drive_is_well_with_the_checkers_times() -> None:
    frames = driving().frames
    (bus,) = measure(log_of(frames), DECODER, revision="2026")
    assert [finding for finding in judge(bus) if finding.severity == "problem"] == []
    checker = WireChecker(Codec(revision("2026")))
    for frame in frames:
        checker.on_frame(frame)
    responses, handshake = checker.responses, bus.handshake
    assert handshake is not None
    assert handshake.answered == len(responses)
    assert handshake.response_ms.p50_ms == responses.quantile_ms(0.5)
    assert handshake.response_ms.p99_ms == responses.quantile_ms(0.99)
    assert handshake.response_ms.max_ms == responses.quantile_ms(1.0)
