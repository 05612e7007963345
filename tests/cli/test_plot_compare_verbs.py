"""`fsai-vcu plot` and `compare`."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from fsai_vcu.cli.main import main
from fsai_vcu.interface.enums import AsState
from fsai_vcu.interface.lights import LIGHTS


def log(path: Path, *, period_ms: int = 10, angle: int = 50) -> Path:
    """0x523 for two seconds; its measured angle in steps of 0.1 deg."""
    value = angle.to_bytes(2, "little").hex()
    frames = range(0, 2000, period_ms)
    path.write_text("".join(f"({1 + ms / 1000:.6f}) can0 523#{value}2c010000\n" for ms in frames))
    return path


def test_chosen_signals_are_drawn_into_the_file_that_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Whatever its name ends in."""
    pytest.importorskip("matplotlib", reason="matplotlib is not installed: pip install 'fsai-vcu[plot]'")
    run, picture = str(log(tmp_path / "a.log")), tmp_path / "angle"
    assert main(["plot", run, "ANGLE", "*.ANGLE_MAX", "-o", str(picture)]) == 0
    assert capsys.readouterr().out == f"saved {picture}: VCU2AI_Steer.ANGLE, VCU2AI_Steer.ANGLE_MAX\n"
    assert picture.read_bytes().startswith(b"\x89PNG")
    nowhere = tmp_path / "absent/angle.png"
    assert main(["plot", run, "ANGLE", "-o", str(nowhere)]) == 1
    assert capsys.readouterr().err == f"fsai-vcu plot: cannot write {nowhere}: No such file or directory\n"


def test_several_logs_are_plotted_as_one(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    logs = [str(log(tmp_path / "a.log")), str(tmp_path / "b.log")]
    Path(logs[1]).write_text("(3.000000) can0 524#0000000000\n")
    picture = tmp_path / "both.png"
    assert main(["plot", *logs, "ANGLE", "HYD_PRESS_F_pct", "-o", str(picture)]) == 0
    assert capsys.readouterr().out == f"saved {picture}: VCU2AI_Steer.ANGLE, VCU2AI_Brake.HYD_PRESS_F_pct\n"
    assert main(["plot", *logs]) == 2
    assert "no signal is named" in capsys.readouterr().err


def test_a_page_of_signals_is_the_reports(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    page = tmp_path / "angle.html"
    assert main(["plot", str(log(tmp_path / "a.log")), "ANGLE", "*.ANGLE_MAX", "-o", str(page)]) == 1
    assert "verdict: NOT OK" in capsys.readouterr().out, "the page's own verdict"
    html = page.read_text()
    places = [html.index(part) for part in ('id="legend-signals0"', 'id="lanes"', "<main>")]
    assert places == sorted(places) and "VCU2AI_Steer.ANGLE_MAX" in html, "the signals come first"


def test_as_states_are_bands_of_their_colours_behind_signals(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib", reason="matplotlib is not installed: pip install 'fsai-vcu[plot]'")
    run, picture = log(tmp_path / "a.log"), tmp_path / "angle.svg"
    with run.open("a") as file:
        file.writelines(f"({3 + n / 100:.6f}) can0 520#211E433020000000\n" for n in range(100))  # AS_DRIVING
    assert main(["plot", str(run), "ANGLE", "-o", str(picture)]) == 0
    drawn = picture.read_text()
    assert f"fill: {LIGHTS[AsState.AS_DRIVING].fill}" in drawn and "AS_DRIVING" in drawn
    assert LIGHTS[AsState.AS_READY].fill not in drawn


def test_a_signal_that_the_log_lacks_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["plot", str(log(tmp_path / "a.log")), "STEER_REQUEST"]) == 1
    assert "no signal STEER_REQUEST" in capsys.readouterr().err


def test_two_equal_logs_do_not_differ(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["compare", str(log(tmp_path / "a.log")), str(log(tmp_path / "b.log"))]) == 0
    assert capsys.readouterr().out == "nothing differs\n"


def test_other_periods_and_values_are_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    other = log(tmp_path / "b.log", period_ms=20, angle=80)
    assert main(["compare", str(log(tmp_path / "a.log")), str(other)]) == 1
    assert capsys.readouterr().out.splitlines() == [
        f"first: {tmp_path}/a.log, second: {tmp_path}/b.log",
        "0x523 VCU2AI_Steer: first every 10.0 ms, second every 20.0 ms",
        "VCU2AI_Steer.ANGLE: first 5 to 5 (mean 5), second 8 to 8 (mean 8) deg",
    ]


def test_problems_come_first_and_states_in_words(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    logs = [tmp_path / "a.log", tmp_path / "b.log"]
    for path, states in zip(logs, ("2222", "2244"), strict=True):
        lines = (
            f"({n}.{place}) can0 520#00{0:02X}0{state}0000000000\n" for n, state in enumerate(states) for place in "024"
        )
        path.write_text("".join(lines))
    assert main(["compare", *map(str, logs)]) == 1
    said = capsys.readouterr().out.splitlines()
    assert said[1].startswith(f"only in {logs[1]}: at ") and "EMERGENCY_BRAKE" in said[1]
    assert said[-1] == "VCU2AI_Status.AS_STATE: first AS_READY 100%, second AS_READY 50% EMERGENCY_BRAKE 50%"


def test_shares_are_whole_and_messages_of_one_log_a_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    logs = [tmp_path / "a.log", tmp_path / "b.log"]
    for path, states, more in zip(
        logs, ("22222", "23456"), ("", "(9.9) can0 513#0500\n(9.9) can0 525#\n"), strict=True
    ):
        path.write_text("".join(f"({n}.0) can0 520#00000{s}0000000000\n" for n, s in enumerate(states)) + more)
    assert main(["compare", *map(str, logs)]) == 1
    said = capsys.readouterr().out.splitlines()
    (state,) = [line for line in said if line.startswith("VCU2AI_Status.AS_STATE: ")]
    assert state.endswith(" others 20%")
    alone = f"only in {logs[1]}: 0x513 AI2VCU_Steer, 0x525 VCU2AI_Speeds"
    assert said.index(state) < said.index(alone), "states first"


@pytest.mark.parametrize("also", ["", "(9.9) can0 640#0000000000000000\n"])
def test_a_sender_that_one_log_lacks_is_one_entry(
    also: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    logs, gps = [tmp_path / "a.log", tmp_path / "b.log"], "(9.9) can0 621#0000000000000000\n(9.9) can0 630#00\n"
    for path, more in zip(logs, (gps, also), strict=True):
        path.write_text("".join(f"({n}.0) can0 520#0000020000000000\n" for n in range(5)) + more)
    assert main(["compare", *map(str, logs)]) == 1
    last = next(line for line in capsys.readouterr().out.splitlines() if "0x621" in line)
    heard = "0x621 GPS_CourseSpeed, 0x630 IO" if also else "all of PCAN_GPS (0x621, 0x630)"
    assert last == f"only in {logs[0]}: {heard}"


def test_each_difference_is_an_object_for_programs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    other = log(tmp_path / "b.log", period_ms=20, angle=80)
    assert main(["compare", str(log(tmp_path / "a.log")), str(other), "--json"]) == 1
    period, angle = map(json.loads, capsys.readouterr().out.splitlines())
    assert (period["message"], period["id"], period["mean_ms"]) == (
        "VCU2AI_Steer",
        0x523,
        {"first": pytest.approx(10.0), "second": pytest.approx(20.0)},
    )
    assert (angle["signal"], angle["unit"], angle["second"]) == (
        "VCU2AI_Steer.ANGLE",
        "deg",
        {"min": 8.0, "mean": 8.0, "max": 8.0},
    )


def test_problems_of_one_log_alone_are_check_lines(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    first, second = log(tmp_path / "a.log"), log(tmp_path / "b.log")
    lines = second.read_text().splitlines()
    second.write_text("\n".join([*lines[:50], lines[50][:-2], *lines[51:]]) + "\n")
    assert main(["compare", str(first), str(second)]) == 1
    words = "VCU2AI_Steer (0x523) must have 6 bytes: 1 of 5 bytes"
    assert capsys.readouterr().out.splitlines()[1:] == [f"only in {second}: at 0.500 s: {words}"]


def test_values_that_no_database_names_are_not_called_equal(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    first, second, foreign = log(tmp_path / "a.log"), log(tmp_path / "b.log"), tmp_path / "foreign.dbc"
    foreign.write_text('VERSION ""\n\nBU_: A\n\nBO_ 291 Engine: 8 A\n SG_ Rpm : 0|16@1+ (1,0) [0|0] "rpm" A\n')
    assert main(["compare", str(first), str(second), "--dbc", str(foreign)]) == 1
    assert f"the databases name no frame of {first}: no values are compared" in capsys.readouterr().err


def test_parts_messages_and_signals_alone_are_compared(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    first, second = log(tmp_path / "a.log"), log(tmp_path / "b.log", angle=80)
    added = [f"({2.6 + ms / 1000:.6f}) can0 513#0500" for ms in range(0, 400, 10)]
    second.write_text("\n".join(sorted([*second.read_text().splitlines(), *added])) + "\n")
    argv = ["compare", str(first), str(second)]
    angle = "VCU2AI_Steer.ANGLE: first 5 to 5 (mean 5), second 8 to 8 (mean 8) deg"
    new = f"only in {second}: 0x513 AI2VCU_Steer"
    for part, lines in (
        ([], [new, angle]),
        (["--to", "1.5"], [angle]),
        (["--messages", "AI2VCU_*"], None),
        (["--signals", "ANGLE"], [angle]),
        (["--signals", "*_MAX"], ["nothing differs"]),
    ):
        main([*argv, *part])
        shown = capsys.readouterr()
        assert shown.out.splitlines()[lines != ["nothing differs"] :] == lines if lines else "no frame of" in shown.err
    assert main([*argv, "--signals", "NO_SUCH"]) == 1
    assert "no signal NO_SUCH" in capsys.readouterr().err
    assert main([*argv, "--signals", "ANGEL"]) == 1
    assert "no signal ANGEL; did you mean ANGLE" in capsys.readouterr().err
    assert main([*argv, "--signals", "steering"]) == 1
    said = capsys.readouterr().err
    assert (
        "STEERING_STATUS" in said and "VCU2AI_Steer has ANGLE, " in said and "AI2VCU_Steer has STEER_REQUEST;" in said
    )
