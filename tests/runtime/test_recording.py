"""A recorded log is a candump log, as every CAN tool reads it."""

from __future__ import annotations

import gc
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import can
import pytest

from fsai_vcu.cli.main import main
from fsai_vcu.diagnostics.log.reader import open_log, read_log
from fsai_vcu.interface.frames import Frame
from fsai_vcu.runtime.bus import CanBus, open_bus
from fsai_vcu.runtime.recording import CandumpWriter, candump_line


def test_a_line_is_what_candump_writes() -> None:
    frame = Frame(0x513, bytes.fromhex("9CFF"))
    assert candump_line(frame, "vcan0", 1_436_509_053_850_870_999) == "(1436509053.850870) vcan0 513#9CFF"


@pytest.mark.parametrize("name", ["run.log", "run.log.gz"])
def test_python_can_reads_back_what_was_written(name: str, tmp_path: Path) -> None:
    frames = [
        Frame(0x520, bytes(range(8)), 1_000_000_000),
        Frame(0x18FF0001, b"\x01", 1_010_000_000, extended=True),
        Frame(0x080, b"", 1_020_000_000),
    ]
    with CandumpWriter(tmp_path / name, "vcan0", offset_ns=5_000_000_000) as writer:
        for frame in frames:
            writer.write(frame)
    with can.LogReader(tmp_path / name) as reader:
        read = list(reader)
    assert [(m.arbitration_id, bytes(m.data), m.is_extended_id) for m in read] == [
        (f.can_id, f.data, f.extended) for f in frames
    ]
    assert [round(m.timestamp, 6) for m in read] == [6.0, 6.01, 6.02]


def test_an_unwritable_log_is_one_line_with_the_bus_closed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "absent/run.log"
    assert main(["record", "-i", "loopback:record", "-o", str(path)]) == 1
    assert capsys.readouterr().err == f"fsai-vcu record: cannot write {path}: No such file or directory\n"
    gc.collect()
    assert "not properly shut down" not in caplog.text


# ---------------------------------------------------------------- a recorder as a process

BUS = f"record-{os.getpid()}"
WITHIN_S = 90.0
LOSS_MOST_S = 1.0  # a power cut loses at most a second


@pytest.fixture
def bus() -> Iterator[CanBus]:
    with open_bus(f"loopback:{BUS}") as opened:
        yield opened


@pytest.fixture
def recorder() -> Iterator[Callable[..., subprocess.Popen[str]]]:
    """Starts `fsai-vcu record` on the stand-in bus; whatever the test does, it is ended after it."""
    started: list[subprocess.Popen[str]] = []

    def start(*arguments: str) -> subprocess.Popen[str]:
        argv = [sys.executable, "-m", "fsai_vcu.cli.main", "record", "-i", f"loopback:{BUS}", *arguments]
        started.append(subprocess.Popen(argv, stderr=subprocess.PIPE, text=True))
        return started[-1]

    yield start
    for process in started:
        process.kill()
        process.communicate()


def talk(bus: CanBus, condition: Callable[[], bool], first: int = 0) -> list[tuple[int, float]]:
    """A numbered frame every five milliseconds until the condition holds: (number, when it was sent)."""
    sent: list[tuple[int, float]] = []
    until_s = time.monotonic() + WITHIN_S
    while not condition():
        assert time.monotonic() < until_s, "waited in vain"
        number = first + len(sent)
        bus.send(Frame(0x523, number.to_bytes(6, "little")))
        sent.append((number, time.monotonic()))
        time.sleep(0.005)
    return sent


def numbers(*paths: Path) -> list[int]:
    found: list[int] = []
    for path in paths:
        frames, _ = read_log(path)
        found += [int.from_bytes(frame.data, "little") for frame in frames]
    return found


def test_a_killed_recorder_loses_at_most_1_s_and_resumes(
    bus: CanBus, recorder: Callable[..., subprocess.Popen[str]], tmp_path: Path
) -> None:
    folder = tmp_path / "run"
    first_log, first_mcap = folder / f"{BUS}-000001.log", folder / f"{BUS}-000001.mcap"
    process = recorder("-o", str(folder), "--mcap")
    sent = talk(bus, lambda: first_log.exists() and first_log.stat().st_size > 10_000)
    written: list[tuple[int, float]] = []  # to which size, and when that was seen

    def written_a_while_ago() -> bool:
        """Twice in time, and not just now: that would show nothing."""
        now_s, size = time.monotonic(), first_log.stat().st_size
        if not written or size > written[-1][0]:
            written.append((size, now_s))
        in_time = len(written) > 2 and written[-1][1] - written[-2][1] < 0.8 * LOSS_MOST_S
        return in_time and now_s - written[-1][1] > 0.3 * LOSS_MOST_S

    sent += talk(bus, written_a_while_ago, first=len(sent))
    killed_s = time.monotonic()
    process.send_signal(signal.SIGKILL)
    process.wait()
    kept = numbers(first_log)
    assert kept == list(range(kept[0], kept[-1] + 1)), "there is a hole in it"
    assert kept[-1] >= max((number for number, at_s in sent if at_s < killed_s - LOSS_MOST_S), default=0)
    with first_log.open("ab") as file:
        file.write(b"(17000")  # what a power cut may do besides
    process = recorder("-o", str(folder), "--mcap")
    second_log = folder / f"{BUS}-000002.log"
    talk(bus, lambda: second_log.exists() and second_log.stat().st_size > 0, first=100_000)
    process.send_signal(signal.SIGTERM)
    said = process.communicate(timeout=WITHIN_S)[1]
    assert process.returncode == 0, said
    assert f"{first_log} was cut off in its last line: 6 bytes removed" in said
    assert f"{first_mcap} had no end; an end was added" in said
    assert numbers(first_log) == kept
    with open_log(first_log) as log:
        assert sum(1 for _ in log.frames()) == len(kept) and not log.problems


@pytest.mark.parametrize("ending", [signal.SIGINT, signal.SIGTERM], ids=lambda number: number.name)
def test_a_recorder_asked_to_end_has_everything_on_disk(
    ending: signal.Signals, bus: CanBus, recorder: Callable[..., subprocess.Popen[str]], tmp_path: Path
) -> None:
    path, limits = tmp_path / "run.log", tmp_path / "limits.toml"
    limits.write_text("max_speed_mps = 5.0  # the paddock\n")
    process = recorder("-o", str(path), "--limits", str(limits), "--revision", "2021")
    sent = talk(bus, lambda: path.exists() and path.stat().st_size > 0)
    process.send_signal(ending)
    said = process.communicate(timeout=WITHIN_S)[1]
    assert process.returncode == 0
    kept = numbers(path)
    assert kept == list(range(kept[0], sent[-1][0] + 1))
    assert said == f"{len(kept)} frames in {path}, about it in {path.with_suffix('.json')}\n"
    about = json.loads(path.with_suffix(".json").read_text())
    assert (about["frames"], about["revision"]) == (len(kept), "2021")
    assert about["operational_limits"]["content"] == "max_speed_mps = 5.0  # the paddock\n"
    assert any("5" in line for line in about["operational_limits"]["in_force"])


def test_a_recorder_of_a_silent_bus_is_stopped_without_failure(
    recorder: Callable[..., subprocess.Popen[str]], tmp_path: Path
) -> None:
    process = recorder("-o", str(tmp_path / "run"))
    until_s = time.monotonic() + WITHIN_S
    while not list(tmp_path.glob("run/*.log")):
        assert time.monotonic() < until_s, "waited in vain"
        time.sleep(0.05)
    process.send_signal(signal.SIGTERM)
    said = process.communicate(timeout=WITHIN_S)[1]
    assert process.returncode == 0 and f"nothing was received on loopback:{BUS}" in said


def test_silence_fails_and_leaves_no_files(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    argv = ["record", "-i", f"loopback:{BUS}", "-o", str(tmp_path / "run.log"), "--seconds", "0", "--mcap"]
    assert main(argv) == 1, "the bus is silent"
    words = f"fsai-vcu record: nothing was received on loopback:{BUS}: {tmp_path / 'run.log'} was not made\n"
    assert capsys.readouterr().err.endswith(words)
    assert list(tmp_path.iterdir()) == [], "an empty log keeps the next one from its name"


def test_without_ros_one_line_says_what_is_needed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "fsai_nodes.recorder", None)
    argv = ["record", "-i", f"loopback:{BUS}", "-o", str(tmp_path / "run.log"), "--mcap", "--ros"]
    assert main(argv) == 1
    said = capsys.readouterr().err
    assert "--ros needs ROS 2 and the project's nodes" in said and said.count("\n") == 1


def test_without_mcap_one_line_installs_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "mcap", None)
    assert main(["record", "-i", f"loopback:{BUS}", "-o", str(tmp_path / "run.log"), "--mcap"]) == 1
    assert capsys.readouterr().err == "fsai-vcu record: mcap needs mcap: pip install 'fsai-vcu[mcap]'\n"
    assert list(tmp_path.iterdir()) == []
