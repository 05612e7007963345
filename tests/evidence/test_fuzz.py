"""The fuzzer: no rule is broken on the wire, it goes deep, what it finds can be replayed, and it can find something."""

from __future__ import annotations

import math
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fsai_hil.evidence import fuzz as command
from fsai_hil.evidence.fuzz_cases import changed, fresh, make, shortened, some_events
from fsai_hil.evidence.fuzz_drives import Drive
from fsai_hil.evidence.fuzz_events import EVENTS, SETUPS, STATIONS, CaseError, FuzzCase, FuzzEvent, event, read_case
from fsai_hil.evidence.fuzz_run import Played, at_station, forget_stations, play
from fsai_hil.evidence.fuzz_search import Failure, Tally, described, fuzz, minimised, unreached
from fsai_hil.evidence.model import patched
from fsai_hil.rules.violation import Violation
from fsai_vcu.core.bridge import Bridge
from fsai_vcu.core.supervision import gate as gating
from fsai_vcu.core.supervision.reasons import Reason

CASES = 80  # of the short form: each kind of happening once, and as many others; seconds


@cache
def short_form() -> Tally:
    return fuzz("2026", cases=CASES)


def told(tally: Tally) -> str:
    return "\n".join(line for failure in tally.failures for line in described(failure))


def test_no_rule_is_broken_on_the_wire() -> None:
    assert not short_form().failures, told(short_form())


def test_the_short_form_goes_deep() -> None:
    """Else the fuzzer could become shallow and nobody would notice."""
    reached = short_form().reached
    assert not unreached(reached, "AS state")
    assert not unreached(reached, "phase")
    # Two are the gate's second look, which the supervisor leaves nothing to; frames wait in no queue here; the others
    # are too rare for seconds.
    rare = {
        "backlog",
        "as_switch_off",
        "stillness_unproven",
        "torque_blocked",
        "not_confirmed",
        "torque_limit_unknown",
        "steering_implausible",
    }
    assert unreached(reached, "reason") <= rare
    assert short_form().count("change") >= 25
    assert short_form().count("together") >= 20


def test_the_same_seed_is_the_same_run() -> None:
    first, second = fuzz("twice", cases=6), fuzz("twice", cases=6)
    assert first.reached == second.reached
    assert (first.cycles, first.frames, first.corpus) == (second.cycles, second.frames, second.corpus)


# Every way of spoiling something, with hypothesis choosing the chance: it shrinks by itself.
@settings(max_examples=12, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow])
@given(
    st.sampled_from(sorted(SETUPS)),
    st.sampled_from(sorted(STATIONS)),
    st.lists(st.randoms(use_true_random=False).map(some_events), min_size=1, max_size=8),
)
def test_whatever_happens_from_any_station_on_no_rule_is_broken(
    setup: str, station: str, happenings: list[list[FuzzEvent]]
) -> None:
    case = FuzzCase(setup, station, tuple(one for happening in happenings for one in happening))
    _, problems = play(case)
    assert not problems, "\n".join(described(Failure(case, problems[0])))


def test_a_mission_with_repeated_faults_breaks_no_rule() -> None:
    drive = Drive("ci")
    assert drive.run() == [], drive.notes


# ---------------------------------------------------------------- known doubts


def played(*events: FuzzEvent, setup: str = "2026", station: str = "moving") -> Played:
    found, problems = play(FuzzCase(setup, station, events))
    assert not problems, problems
    return found


@pytest.mark.parametrize("role", ["planner", "controller"])
def test_a_planner_or_controller_back_in_700_ms_does_not_resume(role: str) -> None:
    after = played(
        event("command", age_ms=550.0),
        event("run", cycles=5),
        event("confirm", role=role, offset=0),
        event("command", age_ms=0.0),
        event("run", cycles=30),
    )
    assert after.torque_nm == [0.0, 0.0] and after.brake_pct[0] > 0.0


@pytest.mark.parametrize("age_ms", [-20.000001, -50.0, -1e9])
def test_commands_with_stamps_of_the_future_move_nothing(age_ms: float) -> None:
    assert played(event("command", age_ms=age_ms), event("run", cycles=12)).torque_nm == [0.0, 0.0]


@pytest.mark.parametrize("ms", [10.0, 400.0, 1500.0])
def test_an_emergency_requested_on_a_lost_bus_is_sent_when_back(ms: float) -> None:
    told_of: list[str] = []
    run = at_station("2026", "moving")
    run.say = told_of.append
    assert not run.play([event("lost", ms=ms), event("service", name="emergency"), event("run", cycles=200)])
    assert any("sent:" in line and "estop_request True" in line for line in told_of)


@pytest.mark.parametrize("station", sorted(STATIONS))
def test_a_reset_at_any_moment_breaks_nothing(station: str) -> None:
    reset = event("service", name="reset")
    asked = event("service", name="emergency")
    played(reset, event("run", cycles=2), asked, reset, event("run", cycles=2), reset, event("run", cycles=2),
           station=station)  # fmt: skip


def test_the_first_0x520_may_come_at_any_moment() -> None:
    for ns in (1, 4_999_999, 8_000_000, 9_999_999):
        played(event("quiet", ms=205 + ns / 1e6), event("run", cycles=5), station="start")


# ---------------------------------------------------------------- files and lineages


def test_a_case_is_made_anew_from_its_lineage_alone() -> None:
    assert make("7.31.4") == make("7.31.4")
    assert make("7.31.4").events != make("7.31").events
    with pytest.raises(ValueError, match="no lineage"):
        make("7..4")


def test_a_case_is_written_and_read_without_loss() -> None:
    for seed in range(30):
        case = make(str(seed))
        assert repr(read_case(case.text(["of a person's interest", ""])).events) == repr(case.events)


def test_a_number_that_is_none_survives_the_file() -> None:
    (back,) = read_case("once throttle=NaN steering_rad=-Infinity\n").events
    assert math.isnan(back.values["throttle"]) and back.values["steering_rad"] == -math.inf


@pytest.mark.parametrize("line", ["setup 1999", "station moon", "fly cycles=1", "run cycles", "run cycles=x"])
def test_a_file_that_is_no_case_is_refused_with_its_line(line: str) -> None:
    with pytest.raises(CaseError, match="line 2: "):
        read_case(f"# a case\n{line}\n")


def test_every_word_of_the_vocabulary_can_be_played() -> None:
    assert all(callable(getattr(Played, f"_do_{name}")) for name in EVENTS)


def test_the_generator_speaks_the_whole_vocabulary() -> None:
    spoken = {one.name for seed in range(400) for one in make(str(seed)).events}
    assert spoken == set(EVENTS)


def test_delta_debugging_leaves_only_what_is_needed() -> None:
    events = [event("run", cycles=n) for n in range(1, 30)]
    kept = shortened(events, lambda some: {7, 20} <= {one.values["cycles"] for one in some})
    assert [one.values["cycles"] for one in kept] == [7, 20]


def test_generated_cases_use_known_setups_and_stations() -> None:
    from random import Random

    for seed in range(50):
        case = changed(fresh(Random(seed)), Random(-seed))
        assert case.setup in SETUPS and case.station in STATIONS


# ---------------------------------------------------------------- it can fail

# A handful that seconds are enough for; `--seeded` seeks them all.
HANDFUL = (
    "torque rises right after the brake",
    "the driving row is taken from the start",
    "no constant-power steps",
    "FORWARD in AS_READY",
    "an intruder is only reported",
    "rest is proven after 400 ms",
    "a process that only listens sends",
    "the fifth frame has an id that is not ours",
    "a stop by the holding brake",
    "ESTOP_REQUEST without the brake",
)


@pytest.mark.parametrize("name", HANDFUL)
def test_a_fault_put_into_the_rules_is_found_on_the_wire(name: str) -> None:
    problem, tally = command.sought(name, cases=400, seconds=600.0)
    assert problem is not None, f"not found in {tally.cases} cases"


def test_an_exception_is_found_reduced_reported_and_stored(tmp_path: Path) -> None:
    def breaks(bridge: Bridge, command: Any, now_ns: int) -> tuple[str, ...]:
        if command.throttle == 1.0:
            raise ZeroDivisionError("seeded")
        return ()

    events = (event("run", cycles=9), event("car", fault=True), event("once", throttle=1.0), event("run", cycles=3))
    with patched(Bridge, "on_command", breaks):
        forget_stations()
        case = FuzzCase("2026", "off", events, "made-by-hand")
        _, problems = play(case)
        assert problems == [Violation("never an exception", "ZeroDivisionError: seeded")]
        small = minimised(Failure(case, problems[0]))
        assert small.case.events == (event("once", throttle=1.0),)
        path = command.keep(small, tmp_path)
    forget_stations()
    text = path.read_text()
    assert "breaks rule never an exception: ZeroDivisionError: seeded" in text
    assert read_case(text).events == small.case.events


def test_replay_reports_and_exits_by_whether_a_rule_is_broken(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "case.txt"
    path.write_text(FuzzCase("2026", "moving", (event("mute", ids=[0x520], cycles=99), event("run", cycles=20))).text())
    assert command.main(["--replay", str(path)]) == 0
    assert "estop_request True" in capsys.readouterr().out
    with patched(gating, "constant_power_nm", lambda rpm: 195.0):  # wheels that speed up as fast as a tyre follows
        path.write_text(
            FuzzCase("2026", "moving", (event("wheels", rpm=[290] * 4), event("run", cycles=2),
                                    event("wheels", rpm=[580] * 4), event("command", throttle=1.0),
                                    event("run", cycles=5))).text()
        )  # fmt: skip
        assert command.main(["--replay", str(path)]) == 1
    assert "BROKEN, rule 4: rear torque" in capsys.readouterr().out


@pytest.mark.parametrize(
    "arguments", [["--replay", "/nowhere"], ["--case", "1..2"], ["--cases", "0"], ["--jobs", "0"], ["--minutes", "-1"]]
)
def test_wrong_use_is_one_clear_line(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert command.main(arguments) == 2
    assert len(capsys.readouterr().err.strip().splitlines()) == 1


def test_every_reason_there_is_counts_as_something_to_reach() -> None:
    assert unreached((), "reason") == {reason.slug for reason in Reason}
