"""The fuzz: no rule is broken on the wire, it goes deep, it can find something, and what it finds can be read."""

from __future__ import annotations

from functools import cache
from multiprocessing import get_context

import pytest

from fsai_hil.evidence import fuzz as command
from fsai_hil.evidence.fuzz_run import at_station
from fsai_vcu.core.bridge import Bridge
from fsai_vcu.interface.units import MS


@cache
def short_form() -> command.Done:
    """In a process of its own: Hypothesis also draws constants that it finds in the modules loaded around it."""
    with get_context("spawn").Pool(1) as fresh:
        return fresh.apply(command.batch, (2026,), {"examples": 160})


def test_no_rule_is_broken_on_the_wire() -> None:
    assert not short_form().failures, short_form().failures[0][1]


def test_the_short_form_goes_deep() -> None:
    """Else the fuzz could become shallow and nobody would notice; a few examples need not reach all."""
    most = {"AS state": 1, "phase": 2, "reason": 28}
    assert {kind: short_form().missing(kind) for kind in most if len(short_form().missing(kind)) > most[kind]} == {}


def test_the_same_seed_is_the_same_run() -> None:
    first, second = command.batch(7, examples=4), command.batch(7, examples=4)
    assert first == second and first.cycles > 0


@pytest.mark.parametrize(
    "name", ["torque rises right after the brake", "rest is proven after 400 ms", "a stop by the holding brake"]
)
def test_a_fault_put_into_the_rules_is_found_on_the_wire(name: str) -> None:
    assert "RuleBroken" in command.sought(name)[1]


@pytest.mark.parametrize("ahead_ns", [1 * MS, 50 * MS, 2000 * MS])
@pytest.mark.parametrize("station", ["ready", "moving"])
def test_frames_stamped_in_the_future_break_no_rule(station: str, ahead_ns: int) -> None:
    run = at_station("2026", station)
    for image in run.images():
        run.frame(run.codec.encode(image), ahead_ns)
    run.run(130)
    run.judge()
    assert (max(run.torque_nm) > 0.0) is (station == "moving" and ahead_ns < 100 * MS)


def test_an_exception_is_shrunk_to_readable_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    def breaks(bridge: Bridge, now_ns: int) -> None:
        raise ZeroDivisionError("seeded")

    monkeypatch.setattr(Bridge, "begin_stop", breaks)
    done = command.batch(1, examples=50)
    ((_, words),) = done.failures
    steps = [line for line in words.splitlines() if line.startswith("state.")]
    assert steps == ["state.begin(setup='2026', station='start')", "state.end(then=0)", "state.teardown()"]
    assert words.endswith("ZeroDivisionError: seeded")


def test_the_command_reports_and_exits_by_what_it_finds(capsys: pytest.CaptureFixture[str]) -> None:
    assert command.main(["--minutes", "0.001", "--jobs", "1"]) == 0
    assert capsys.readouterr().out.endswith("Every rule held on the wire.\n")


@pytest.mark.parametrize("arguments", [["--jobs", "0"], ["--minutes", "-1"]])
def test_wrong_use_is_one_clear_line(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert command.main(arguments) == 2
    assert len(capsys.readouterr().err.strip().splitlines()) == 1
