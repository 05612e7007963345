"""`fsai-vcu dump`: candump's lines and options, and the signals beside."""

from __future__ import annotations

import json
import os
import re
import sys
from pathlib import Path

import pytest
from msgspec.structs import replace
from talking_bus import talking

from fsai_vcu.cli.main import main
from fsai_vcu.interface.codec import Codec
from fsai_vcu.interface.enums import Ami, AsState, EbsState, OpState, ShutdownCause, SteeringStatus, TsState
from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.messages import FAULT_NAMES, Faults, VcuStatus
from fsai_vcu.interface.revisions import revision

LOG = """\
(1436509053.850870) can0 523#640064006400
(1436509053.850970) can0 18FF0001#7F
(1436509054.950870) can0 514#0A14
(1436509054.950871) can0 20000040#0000000000000000
"""


@pytest.fixture
def log(tmp_path: Path) -> str:
    path = tmp_path / "run.log"
    path.write_text(LOG)
    return str(path)


def shown(capsys: pytest.CaptureFixture[str], *argv: str) -> list[str]:
    assert main(["dump", *argv]) == 0
    return capsys.readouterr().out.splitlines()


def test_a_log_dumped_as_a_log_is_the_log(log: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert shown(capsys, log, "-L") == LOG.splitlines()


def test_lines_are_those_of_candumps_screen(log: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert shown(capsys, log, "--no-signals") == [
        "  can0  523   [6]  64 00 64 00 64 00",
        "  can0  18FF0001   [1]  7F",
        "  can0       514   [2]  0A 14",  # candump indents once it has seen a 29-bit identifier
        "  can0  20000040   [8]  00 00 00 00 00 00 00 00   ERRORFRAME",
    ]


def test_direction_and_ascii_stand_where_candump_has_them(log: str, capsys: pytest.CaptureFixture[str]) -> None:
    Path(log).write_text("(1.000000) can0 18FF0001#41007E7F R\n(1.000000) can0 514#0A42 T\n(1.000000) can0 123##3AA\n")
    assert shown(capsys, log, "--no-signals", "-x", "-a") == [
        "  can0  RX - -  18FF0001   [4]  41 00 7E 7F               'A.~.'",
        "  can0  TX - -       514   [2]  0A 42                     '.B'",
        "  can0  RX B E       123  [01]  AA                        '.'",
    ]
    assert [line[-2:] for line in shown(capsys, log, "-L", "-x")] == [" R", " T", " R"]


@pytest.mark.parametrize(
    ("style", "times"),
    [
        ("a", ["1436509053.850870", "1436509053.850970", "1436509054.950870", "1436509054.950871"]),
        ("z", ["000.000000", "000.000100", "001.100000", "001.100001"]),
        ("d", ["000.000000", "000.000100", "001.099900", "000.000001"]),
    ],
)
def test_times_are_absolute_from_zero_or_since_the_line_before(
    style: str, times: list[str], log: str, capsys: pytest.CaptureFixture[str]
) -> None:
    lines = shown(capsys, log, "-t", style, "--no-signals")
    assert [line.split()[0].strip("()") for line in lines] == times
    assert [line.split()[0].strip("()") for line in shown(capsys, log, "-t", style, "-L")] == times


def test_signals_stand_beside_all_in_one_column(log: str, capsys: pytest.CaptureFixture[str]) -> None:
    lines = shown(capsys, log)
    assert len({line.index(" :: ") for line in lines}) == 1
    assert [line.partition(" :: ")[2] for line in lines] == [
        "VCU2AI_Steer(ANGLE: 10.0 deg, ANGLE_MAX: 10.0 deg, ANGLE_REQUEST: 10.0 deg)",
        "Unknown frame id 419364865 (0x18ff0001)",
        "AI2VCU_Brake(HYD_PRESS_F_REQ_pct: 5.0 %, HYD_PRESS_R_REQ_pct: 10.0 %)",
        "error frame: bus-off",
    ]


@pytest.mark.parametrize(
    ("options", "ids"),
    [
        (["-n", "2"], [0x523, 0x18FF0001]),
        ([",514:7FF"], [0x514]),
        ([",514:7FF,#00000040"], [0x514, 0x40]),
    ],
)
def test_filters_and_the_count_choose_frames(
    options: list[str], ids: list[int], log: str, capsys: pytest.CaptureFixture[str]
) -> None:
    argv = [log + options[0]] if options[0].startswith(",") else [log, *options]
    assert [json.loads(line)["id"] for line in shown(capsys, *argv, "--json")] == ids


def test_colour_is_for_terminals_or_for_who_asks(log: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert "\x1b" not in "".join(shown(capsys, log))
    lines = shown(capsys, log, "-c")
    assert lines[3].startswith("\x1b[31m") and lines[3].endswith("\x1b[0m")
    assert len({line[:5] for line in lines}) == 4, "the VCU, the AI computer, the unknown and errors look alike"


def test_changes_of_chosen_signals_are_shown_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = tmp_path / "run.log"
    words = ("0000", "0100", "0102", "0002")  # 0x520: HANDSHAKE toggles, then GO_SIGNAL and HANDSHAKE change
    log.write_text("".join(f"(1.{n}) can0 520#00{word}0000000000\n" for n, word in enumerate(words)))
    assert main(["dump", str(log), "--changes", "--signals", "AS_STATE", "--no-signals"]) == 0
    assert len(capsys.readouterr().out.splitlines()) == 2


def test_the_handshake_alone_is_no_change(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = tmp_path / "run.log"
    words = ("00", "01", "00", "11", "10")  # 0x520: HANDSHAKE toggles; then OP_STATE changes once
    log.write_text("".join(f"(1.{n}) can0 520#{word}00000000000000\n" for n, word in enumerate(words)))
    assert len(shown(capsys, str(log), "--changes", "--no-signals")) == 2
    assert len(shown(capsys, str(log), "--changes", "--signals", "HANDSHAKE", "--no-signals")) == 5


def test_a_logs_times_count_from_its_first_frame(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = tmp_path / "run.log"
    log.write_text("(1.000000) can0 510#0000000000000000\n(3.500000) can0 520#0000000000000000\n")
    for part in ([str(log), "--from", "2"], [str(log), "--messages", "0x520"], [f"{log},520:7FF"]):
        assert shown(capsys, *part, "-t", "z", "--no-signals")[0].startswith(" (002.500000)"), part


def test_a_logs_lines_have_explains_times_without_being_asked(log: str, capsys: pytest.CaptureFixture[str]) -> None:
    lines = shown(capsys, log)
    assert [line.split()[0] for line in lines] == ["(000.000000)", "(000.000100)", "(001.100000)", "(001.100001)"]
    assert shown(capsys, log, "-t", "z") == lines and shown(capsys, log, "-t", "a") != lines
    assert shown(capsys, log, "--short")[2].startswith(" (001.100000) ")


def test_a_bus_has_no_times_until_they_are_asked_for(capsys: pytest.CaptureFixture[str]) -> None:
    name = f"loopback:timeless-{os.getpid()}"
    with talking(name, Frame(0x520, bytes(8))):
        assert shown(capsys, name, "-n", "1")[0].lstrip().startswith("timeless-")
        assert shown(capsys, name, "-n", "1", "-t", "z")[0].startswith(" (000.000000) ")


def test_signals_are_those_of_the_logs_own_revision(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = tmp_path / "run.log"  # SM_SYS is only in 2021, and nothing before 0x120 tells the revision
    log.write_text("(1.000000) can0 513#0000\n(1.100000) can0 120#0000000000000000\n")
    assert main(["dump", str(log), "--signals", "SM_*"]) == 0
    assert "VCU_STATUS(SM_SYS: " in capsys.readouterr().out


def test_in_short_lines_0x520_fits_150_columns(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "run.log"
    path.write_text("(1.000000) vcan0 520#211E333020000000\n(1.010000) vcan0 510#0000000000000000\n")
    assert main(["dump", "--short", str(path)]) == 0
    status, nothing = capsys.readouterr().out.splitlines()
    assert status.split("  ")[-1].split("00 00 00 ")[1] == (
        "HS OP_AUTO ASMS TSMS GO STEERING AS_DRIVING AUTOX TS_RUNNING EBS_ARMED"
    )
    assert nothing.endswith(" 00")
    assert main(["dump", "--short", "--json", str(path)]) == 2


def test_0x520_of_every_state_and_fault_fits_150_columns(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """As the simulated car sends it: with everything up, and in an emergency with each fault and what goes with it."""
    on = {"handshake": True, "as_switch": True, "ts_switch": True, "go_signal": True}
    up = {"op_state": OpState.OP_AUTO, "ts_state": TsState.TS_PRECHARGE, "ebs_state": EbsState.EBS_CHARGING}
    low = {"warning": True, "warn_batt_temp_high": True, "warn_batt_soc_low": True}
    steering = {"steering_status": SteeringStatus.ACTIVE}
    sent = [VcuStatus(**on, **up, **low, **steering, as_state=state) for state in AsState]  # type: ignore[arg-type]
    down = {"op_state": OpState.OP_FAULT, "ts_state": TsState.TS_FAULT, "ebs_state": EbsState.EBS_TRIGGERED}
    for cause, fault in enumerate(FAULT_NAMES, start=1):
        broken = {"as_state": AsState.EMERGENCY_BRAKE, "fault": True, "faults": Faults(**{fault: True})}
        sent.append(VcuStatus(**on, **down, **broken, **low, shutdown_cause=ShutdownCause(cause)))  # type: ignore[arg-type]
    codec = Codec(revision("2026"))
    frames = [codec.encode(replace(each, ami=ami)) for each in sent for ami in Ami]
    (tmp_path / "run.log").write_text("".join(f"(1.0) vcan0 520#{frame.data.hex()}\n" for frame in frames))
    assert main(["dump", "--short", "--revision", "2026", str(tmp_path / "run.log")]) == 0
    lines = [line.partition(")")[2] for line in capsys.readouterr().out.splitlines()]
    assert len(lines) == len(frames) and max(map(len, lines)) <= 150, max(lines, key=len)
    assert not [line for line in lines if "+" in line], "all of it is there"


@pytest.mark.parametrize("times", [[], ["-t", "a"]])
def test_0x520_with_many_flags_is_cut_to_150_columns(
    tmp_path: Path, times: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    """Every combination of faults; with and without everything else that a flag can say."""
    words = [others | faults << 40 for others in (0, 0x3_FF33_FF33) for faults in range(1 << 11)]
    payloads = [word.to_bytes(8, "little").hex() for word in words]
    (tmp_path / "run.log").write_text("".join(f"(1.0) vcan0 520#{payload}\n" for payload in [*payloads, 16 * "F"]))
    assert main(["dump", "--short", "--revision", "2026", *times, str(tmp_path / "run.log")]) == 0
    lines = [line.partition(")")[2] for line in capsys.readouterr().out.splitlines()]
    assert len(lines) == len(payloads) + 1 and 140 < max(map(len, lines)) <= 150, max(lines, key=len)
    for faults, line in enumerate(lines[: 1 << 11]):
        words = line.partition("[8]")[2].split()[8:]
        left_out = int(words.pop()) if words and words[-1].startswith("+") else 0
        assert len(words) + left_out == faults.bit_count()


def test_times_with_the_date_are_local_and_read_back(log: str, capsys: pytest.CaptureFixture[str]) -> None:
    text = "\n".join(shown(capsys, log, "-t", "A", "--no-signals"))
    assert re.match(r" \(2015-07-1\d \d\d:\d\d:33\.850870\)  can0  523 ", text)
    Path(log).write_text(text + "\n")
    assert shown(capsys, log, "-L", "--no-signals") == LOG.splitlines()


def test_a_part_of_a_log_is_by_seconds_clock_and_message(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = tmp_path / "run.log"
    log.write_text("".join(f"(17{n:02}.000000) can0 {can_id}#00\n" for n in range(10) for can_id in ("513", "523")))
    for part in (["--from", "2", "--to", "3"], ["--from", "00:28:22", "--to", "00:28:23"]):
        assert main(["dump", str(log), *part, "--messages", "*_Steer,0x513", "-L", "--no-signals"]) == 0
        assert len(capsys.readouterr().out.splitlines()) == 4
    assert main(["dump", str(log), "--from", "noon"]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_frames_lost_to_a_slow_reader_are_reported(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("fsai_vcu.diagnostics.log.live._MOST_WAITING", 1)
    name = f"loopback:slow-{os.getpid()}"
    with talking(name, Frame(0x520, bytes(8)), Frame(0x521, bytes(8))):
        assert main(["dump", name, "-n", "3"]) == 1
    lost = capsys.readouterr().err
    assert re.fullmatch(
        r"fsai-vcu dump: \d+ frames were lost: the program that reads the output is too slow for the bus\n", lost
    )


@pytest.mark.parametrize("how", [[], ["--short"]])
def test_numbers_have_the_decimals_of_their_scale(
    tmp_path: Path, how: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    log = tmp_path / "run.log"
    log.write_text("(1.000000) can0 522#9B0779069E07\n(1.100000) can0 513#FAFF\n(1.200000) can0 621#0000003F00000042\n")
    assert main(["dump", str(log), *how]) == 0
    shown = capsys.readouterr().out
    for value in ("194.7 Nm", "165.7 Nm", "195.0 Nm", "-0.6 deg", "32.0"):
        assert value in shown
    assert main(["decode", str(log)]) == 0
    assert "194.70000000000002 Nm" in capsys.readouterr().out  # as cantools writes it


@pytest.mark.parametrize("verb", ["dump", "decode"])
def test_a_terminal_shows_the_first_hundred_frames_of_a_log(
    verb: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    log = tmp_path / "run.log"
    log.write_text("".join(f"({number}.000000) can0 7FF#00\n" for number in range(150)))
    assert main([verb, str(log), "--no-signals"]) == 0
    assert capsys.readouterr().out.count("\n") == 150, "a pipe gets all of them"
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    assert main([verb, str(log), "--no-signals"]) == 0
    out, err = capsys.readouterr()
    assert out.count("\n") == 100 and err.count("\n") == 1 and "| less" in err
    log.write_text("\n".join(log.read_text().splitlines()[:100]) + "\n")
    assert main([verb, str(log), "--no-signals"]) == 0
    out, err = capsys.readouterr()
    assert (out.count("\n"), err) == (100, ""), "nothing is left out of a log of a hundred frames"
    log.write_text("".join(f"({number}.000000) can0 7FF#00\n" for number in range(150)))
    assert main([verb, str(log), "--no-signals", "-n", "120"]) == 0
    assert capsys.readouterr().out.count("\n") == 120
