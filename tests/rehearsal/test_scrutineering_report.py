"""The report says whether the VCU was answered in time, by the VCU's own limits and no others."""

from __future__ import annotations

import pytest
from measured_rows import measured, reported, row

from fsai_hil.rehearsal.scrutineering.report import failures, markdown, not_measured, summary, verdict
from fsai_hil.rules.response import ResponseTimes
from fsai_vcu.interface.units import MS


def test_echoes_within_the_vcus_limit_pass_however_slow_they_are() -> None:
    slow = measured(row(response_ns=[99 * MS] * 10))
    assert failures(slow) == []
    assert verdict(slow).startswith("PASS") and "99.00 ms" in verdict(slow) and "100 ms" in verdict(slow)


def test_the_verdict_names_the_slowest_echo_of_all_conditions() -> None:
    words = verdict(measured(row("idle"), row("driving", [2 * MS, 41 * MS]), row("driving-busy", [30 * MS])))
    assert "41.00 ms (driving)" in words and "of 2003 echoes" in words


def test_an_echo_that_takes_as_long_as_the_vcu_waits_fails() -> None:
    (reason,) = failures(measured(row("idle"), row("driving", [MS, 100 * MS])))
    assert reason == "driving: an echo took 100.0 ms, and the VCU allows 100 ms"


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"comms_losses": 1}, "idle: the VCU raised AI_COMMS_LOST once"),
        ({"comms_losses": 3}, "idle: the VCU raised AI_COMMS_LOST 3 times"),
        ({"response_ns": []}, "idle: the VCU saw no echo at all"),
        ({"ended_early": "the car went to EMERGENCY_BRAKE"}, "idle: the car went to EMERGENCY_BRAKE before"),
    ],
)
def test_a_condition_that_did_not_go_well_fails_with_its_reason(changes: dict[str, object], words: str) -> None:
    whole = measured(row(**changes))  # type: ignore[arg-type]
    (reason,) = failures(whole)
    assert reason.startswith(words)
    assert verdict(whole).startswith("FAIL") and words in verdict(whole)


def test_an_unmeasured_condition_is_no_pass_and_spoils_no_other() -> None:
    why = "the car does not come as far as AS_DRIVING"
    whole = reported(row("idle"), not_measured={"driving": why, "driving-busy": why})
    assert failures(whole) == [] and not_measured(whole) == [f"driving, driving-busy ({why})"]
    assert verdict(whole).startswith("INCOMPLETE. ") and verdict(whole).endswith(f"driving, driving-busy ({why}).")
    assert "| idle | 2000 |" in markdown(whole)


def test_a_condition_that_ended_early_is_no_pass() -> None:
    whole = measured(row("driving-busy", ended_early="the car went to AS_OFF"))
    assert failures(whole) == []
    (left_out,) = not_measured(whole)
    assert left_out == "driving-busy after 20 s (the car went to AS_OFF)"
    assert verdict(whole).startswith("INCOMPLETE")


def test_a_car_braked_to_rest_is_measured_on_and_it_is_said() -> None:
    whole = reported(row("driving-busy", stood="drove 6 s, then stood: the command is stale"))
    assert verdict(whole).startswith("PASS") and not_measured(whole) == []
    assert "(drove 6 s, then stood: the command is stale)" in markdown(whole)


@pytest.mark.parametrize(
    ("name", "ours_ns", "peer_ns", "words"),
    [
        ("idle", [2 * MS], [9 * MS], "idle: p50 is 2.00 ms, above 1 ms"),
        ("idle", [MS] * 95 + [4 * MS] * 5, [9 * MS], "idle: p99 is 4.00 ms, above 3 ms"),
        ("driving", [4 * MS] * 200 + [12 * MS], [9 * MS], "driving: the maximum is 12.00 ms, the C loop's 9.00 ms"),
        ("driving", [5 * MS], [9 * MS], "driving: p99 is 5.00 ms, more than half of the C loop's 9.00 ms"),
        ("driving", [MS], [], "driving: the log of the bus shows no echo"),
    ],
)
def test_on_the_bus_it_is_judged_against_limits_and_the_c_loop(
    name: str, ours_ns: list[int], peer_ns: list[int], words: str
) -> None:
    ours, peer = ResponseTimes(ours_ns).as_dict(), ResponseTimes(peer_ns).as_dict()
    whole = measured(row(name, wire=ours, peer={"response": peer, "wire": peer, "comms_losses": 0}))
    assert failures(whole) == [words] and verdict(whole).startswith("FAIL")


def test_what_is_as_good_as_it_must_be_passes() -> None:
    ours = ResponseTimes([MS] * 99 + [3 * MS] * 2).as_dict()
    peer = ResponseTimes([6 * MS]).as_dict()
    assert failures(measured(row(wire=ours, peer={"response": peer, "wire": peer, "comms_losses": 0}))) == []


def test_a_log_with_gaps_is_not_compared_and_passes_nothing() -> None:
    (reason,) = failures(measured(row(log_complete=False)))
    assert reason == "idle: the log of the bus misses frames, so nothing can be compared"


def test_a_stalled_machine_is_named_and_excuses_no_failure() -> None:
    (reason,) = failures(measured(row(comms_losses=1, machine_stalls_ms=[31.0, 120.4])))
    assert "up to 120 ms" in reason and "measure again" in reason
    assert failures(measured(row(machine_stalls_ms=[120.4]))) == []


def test_each_condition_is_a_row_with_every_required_figure() -> None:
    text = markdown(reported(row("idle", [MS] * 990 + [11 * MS] * 10), row("driving-loaded", [2 * MS])))
    assert "| idle | 1000 | 1.00 | 1.00 | 11.00 | 11.00 | 1.00 % | 200.00 | 200.00 | 200.00 | 100.00 % |" in text
    assert "| driving-loaded | 1 | 2.00 | 2.00 | 2.00 | 2.00 | 0.00 % | 200.00 |" in text
    assert "| idle | 1000 | 0.50 | 0.50 | 0.50 | 0.50 | 0.00 % | 200.00 |" in text
    assert "fewer than 1000 echoes, p99.9 is no more than the maximum" in text
    for fact in ("abcdef", "SCHED_FIFO with priority 45, memory locked", "2026-06-01 12:00 UTC", "fsai-vcu 0.1.0"):
        assert fact in text


def test_what_falsifies_or_flatters_a_figure_is_said() -> None:
    plain = markdown(reported())
    assert "every rule kept" in plain and "User-Mode Linux" not in plain and "held up" not in plain
    assert "misses frames" not in plain and "Between the measurements" not in plain
    gaps = markdown(reported(row("idle"), row("driving", rules_broken=["1.000 s: rule 9"], log_complete=False)))
    assert "misses frames in driving" in gaps and "rule 9" not in gaps
    text = markdown(
        reported(
            row(held_up_ms=75.0, machine_stalls_ms=[22.0], rules_broken=["1.000 s: rule 9: handshake 1"]),
            place="uml",
            decimation={"gps": 20, "log": 10},
            comms_losses_between=2,
            scheduling={"bridge": {"policy": "ordinary", "priority": 0, "memory_locked": False}},
        )
    )
    assert "75 ms in all" in text and "1, up to 22 ms" in text and "rule 9: handshake 1" in text
    assert "Between the measurements" in text and "AI_COMMS_LOST 2 times" in text
    assert "each 20th" in text and "User-Mode Linux" in text
    assert "real-time scheduling was refused), memory not locked" in text


def test_the_terminal_shows_table_and_verdict_even_without_data() -> None:
    whole = measured(row("idle", []), row("driving"))
    lines = summary(whole).splitlines()
    assert lines[1].split() == ["idle", "0", "-", "-", "-", "200.00", "200.00", "200.00"]
    assert lines[2].split()[:5] == ["driving", "2000", "0.50", "0.50", "0.50"]
    assert lines[-1] == verdict(whole)
