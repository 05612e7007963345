"""The fuzz: no rule is broken on the wire, it goes deep, it can find something, and what it finds can be read."""

from __future__ import annotations

import copy
from functools import cache
from multiprocessing import get_context

import pytest

from fsai_hil.evidence import fuzz as command
from fsai_hil.evidence.fuzz_drive import kept
from fsai_vcu.core.bridge import Bridge
from fsai_vcu.interface import messages as m
from fsai_vcu.interface.units import MS


@cache
def short_form() -> command.Done:
    """Play the short form in a process of its own: Hypothesis also draws constants of the modules loaded around it."""
    with get_context("spawn").Pool(1) as fresh:
        return fresh.apply(command.batch, (2026,), {"examples": 100})


def test_no_rule_is_broken_on_the_wire() -> None:
    assert not short_form().failure


def test_the_short_form_goes_deep() -> None:
    """Else the fuzz could become shallow and nobody would notice; a few scripts need not reach all."""
    assert len(command.REACHED - short_form().reached) <= 30, sorted(command.REACHED - short_form().reached)


def test_the_same_seed_is_the_same_run() -> None:
    first, second = command.batch(7, examples=4), command.batch(7, examples=4)
    assert first == second and first.reached


@pytest.mark.parametrize(
    "name", ["torque rises right after the brake", "SELECTED whatever the mode", "a stop by the holding brake"]
)
def test_a_fault_put_into_the_rules_is_found_on_the_wire(name: str) -> None:
    assert "RuleBroken" in command.sought(name)[1]


@pytest.mark.parametrize("ahead_ns", [1 * MS, 50 * MS, 2000 * MS])
@pytest.mark.parametrize("station", ["ready", "moving"])
def test_frames_stamped_in_the_future_break_no_rule(station: str, ahead_ns: int) -> None:
    drive = copy.deepcopy(kept("2026", station))
    frames = [drive.codec.encode(image) for image in drive.images()]
    drive.play([("frame", {"frame": frame, "ahead_ns": ahead_ns}) for frame in frames])
    drive.play([("run", {"cycles": 130})])
    torque_nm = drive.asked[m.AiDriveRear].torque_nm
    assert (torque_nm > 0.0) is (station == "moving" and ahead_ns < 100 * MS)


def test_a_loop_told_to_stop_without_a_bus_ends_its_turns() -> None:
    drive = copy.deepcopy(kept("2026", "moving"))
    drive.play([("ask", {"what": "deactivate", "words": ""}), ("lose", {"ms": 5.0}), ("run", {"cycles": 9})])
    assert drive.ended


def test_an_exception_is_shrunk_to_a_readable_script(monkeypatch: pytest.MonkeyPatch) -> None:
    def breaks(bridge: Bridge, now_ns: int) -> None:
        raise ZeroDivisionError("seeded")

    monkeypatch.setattr(Bridge, "begin_stop", breaks)
    failure = next(words for seed in range(1, 30) if (words := command.batch(seed, examples=50).failure))
    setup_and_steps = failure.partition(", ")[2].splitlines()
    assert setup_and_steps == [
        "2026, from start:",
        "  ask(what='deactivate', words='')",
        "  ZeroDivisionError: seeded",
    ]


def test_too_few_seeded_faults_found_is_a_failure(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A third may be left to the search and the unit tests; nothing may be found where there is no fault."""
    names = [seed.name for seed in command.SEEDS]
    least = -(-2 * len(names) // 3)
    for found, status in ((names[:least], 0), (names[: least - 1], 1), (["", *names], 1)):
        monkeypatch.setattr(command, "sought", lambda name, found=found: (name, "broken" * (name in found)))
        assert command.main(["--seeded", "--jobs", "1"]) == status
    assert f"at least {least} must be" in capsys.readouterr().out


def test_the_command_reports_and_exits_by_what_it_finds(capsys: pytest.CaptureFixture[str]) -> None:
    assert command.main(["--minutes", "0.001", "--jobs", "1"]) == 0
    assert capsys.readouterr().out.endswith("Every rule held on the wire.\n")


@pytest.mark.parametrize("arguments", [["--jobs", "0"], ["--minutes", "-1"]])
def test_wrong_use_is_one_clear_line(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert command.main(arguments) == 2
    assert len(capsys.readouterr().err.strip().splitlines()) == 1
