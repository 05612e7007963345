"""`fsai-vcu hil` runs the suite where there is a vcan0, and its exit status is the suite's."""

from __future__ import annotations

import signal
from pathlib import Path
from typing import Any

import pytest

from fsai_hil.vcan import VcanError, VcanHost
from fsai_vcu.cli.main import main

CHECKOUT = Path(__file__).parents[2]


class FakePlace:
    """Notes what it was asked to run."""

    def __init__(self, status: int) -> None:
        self.status = status
        self.argv: list[str] = []
        self.options: dict[str, Any] = {}

    def run(self, argv: list[str], **options: Any) -> int:
        self.argv, self.options = argv, options
        return self.status


@pytest.fixture
def place(monkeypatch: pytest.MonkeyPatch) -> FakePlace:
    fake = FakePlace(status=0)
    monkeypatch.setattr(
        "fsai_hil.vcan.choose_place",
        lambda wanted: VcanHost("uml", f"wanted {wanted}", lambda *words, **options: fake.run(*words, **options)),
    )
    monkeypatch.setattr("compileall.compile_dir", lambda *_, **__: True)
    return fake


def pytest_arguments(place: FakePlace) -> list[str]:
    return place.argv[place.argv.index("no:cacheprovider") + 1 :]


def test_it_says_which_place_and_why_and_runs_the_whole_suite(
    place: FakePlace, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["hil", "--results", str(tmp_path)]) == 0
    assert capsys.readouterr().out.splitlines()[0] == "fsai-vcu hil: uml vcan0: wanted auto"
    assert pytest_arguments(place) == ["tests/hil"]
    assert place.options["env"]["FSAI_CAN_INTERFACE"] == "vcan0"
    assert place.options["env"]["FSAI_HIL_RESULTS"] == str(tmp_path) == str(place.options["results_dir"])


def test_what_is_not_its_own_option_is_pytests_in_the_same_order(place: FakePlace, tmp_path: Path) -> None:
    part = "tests/hil/test_vcan.py::test_ones_own_frames_do_not_come_back"
    assert main(["hil", "--results", str(tmp_path), part]) == 0
    assert pytest_arguments(place) == [part], "instead of the whole suite"
    assert main(["hil", "-x", "--uml", "-k", "killed", "--timeout", "30", "--results", str(tmp_path), "-v"]) == 0
    assert pytest_arguments(place) == ["tests/hil", "-x", "-k", "killed", "-v"]
    assert place.options["timeout_s"] == 30.0 * place.options["pace"], "by the clock inside"


def test_an_option_that_pytest_refuses_is_answered_at_once(
    place: FakePlace, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["hil", "--no-such-option", "--results", str(tmp_path)]) == 2
    assert capsys.readouterr().err == "fsai-vcu hil: unrecognized arguments: --no-such-option\n"
    assert place.argv == []


def test_the_long_tests_are_asked_for_by_name_and_get_more_time(place: FakePlace, tmp_path: Path) -> None:
    assert main(["hil", "--results", str(tmp_path)]) == 0
    usual_s = place.options["timeout_s"]
    assert "FSAI_LONG_TESTS" not in place.options["env"]
    assert main(["hil", "--all", "--results", str(tmp_path)]) == 0
    assert place.options["env"]["FSAI_LONG_TESTS"] == "1" and place.options["timeout_s"] == 6 * usual_s
    assert pytest_arguments(place) == ["tests/hil"]


def test_a_soak_runs_its_own_test_for_so_many_minutes(place: FakePlace, tmp_path: Path) -> None:
    assert main(["hil", "--soak", "30", "--results", str(tmp_path)]) == 0
    assert pytest_arguments(place)[0] == "tests/hil/chain/test_soak.py"
    assert (CHECKOUT / pytest_arguments(place)[0]).exists()
    assert place.options["env"]["FSAI_HIL_SOAK_MINUTES"] == "30"
    assert place.options["timeout_s"] == (1.5 * 30 * 60.0 + 600.0) * place.options["pace"]


@pytest.mark.parametrize("minutes", ["0", "-1", "nan"])
def test_a_soak_of_no_time_is_refused_with_one_line(
    place: FakePlace, tmp_path: Path, minutes: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["hil", "--soak", minutes, "--results", str(tmp_path)]) == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert place.argv == []


def test_sigterm_ends_it_as_ctrl_c_does(place: FakePlace, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    handlers: list[object] = []
    before = signal.getsignal(signal.SIGTERM)
    run = place.run

    def noting(argv: list[str], **options: Any) -> int:
        handlers.append(signal.getsignal(signal.SIGTERM))
        return run(argv, **options)

    monkeypatch.setattr("fsai_hil.vcan.choose_place", lambda wanted: VcanHost("uml", "", noting))
    assert main(["hil", "--results", str(tmp_path)]) == 0
    assert handlers == [signal.default_int_handler]
    assert signal.getsignal(signal.SIGTERM) is before


@pytest.mark.parametrize("status", [1, 5, 124])
def test_a_suite_that_fails_or_runs_no_test_fails_the_command(place: FakePlace, tmp_path: Path, status: int) -> None:
    place.status = status
    assert main(["hil", "--results", str(tmp_path)]) == status


def test_this_kernels_own_vcan_goes_by_this_machines_clock(
    place: FakePlace, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("fsai_hil.vcan.choose_place", lambda wanted: VcanHost("native", "", place.run))
    assert main(["hil", "--results", str(tmp_path)]) == 0
    assert "pace" not in place.options


def test_secrets_of_the_callers_environment_stay_outside(
    place: FakePlace, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SOME_TOKEN", "secret")
    monkeypatch.setenv("LANG", "C.UTF-8")
    main(["hil", "--results", str(tmp_path)])
    assert "SOME_TOKEN" not in place.options["env"]
    assert place.options["env"]["LANG"] == "C.UTF-8"


@pytest.mark.parametrize("words", [["hil"], ["scrutineering", "--native"]])
def test_where_no_vcan_can_be_had_it_fails_with_one_line(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str], words: list[str]
) -> None:
    def no_place(wanted: str) -> VcanHost:
        raise VcanError("no vcan here; as root: install it")

    monkeypatch.setattr("fsai_hil.vcan.choose_place", no_place)
    monkeypatch.chdir(tmp_path)
    assert main(words) == 1
    assert capsys.readouterr().err == f"fsai-vcu {words[0]}: no vcan here; as root: install it\n"
