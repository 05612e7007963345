"""The simulated car as a process: commands that people type, a bus that goes and comes, results and pictures."""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

import pytest

from fsai_hil.simulator import process
from fsai_hil.simulator.ground_truth import TruthReceiver
from fsai_hil.simulator.plot import plotted
from fsai_hil.simulator.process import VcuProcess, add_arguments, run
from fsai_hil.simulator.tracks import load_track
from fsai_hil.simulator.world import World, WorldSetup
from fsai_vcu.interface.enums import Ami, AsState
from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.units import MS, S
from fsai_vcu.runtime.bus import BusLost, open_bus


def arguments(*argv: str) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    add_arguments(parser)
    return parser.parse_args(argv)


class FakeBus:
    """A bus nobody else is on; it breaks on demand."""

    def __init__(self) -> None:
        self.sent: list[Frame] = []
        self.broken = False
        self.closed = False

    def send(self, frame: Frame) -> bool:
        if self.broken:
            raise BusLost("interface down")
        self.sent.append(frame)
        return True

    def recv(self, timeout_s: float) -> Frame | None:
        if self.broken:
            raise BusLost("interface down")
        time.sleep(min(timeout_s, 0.01))
        return None

    def close(self) -> None:
        self.closed = True


def made(bus: FakeBus, *argv: str) -> VcuProcess:
    args = arguments("-i", "fake", "--quiet", *argv)
    setup = WorldSetup(missions=[Ami.TRACKDRIVE], auto=args.auto, gps=False, start_ns=time.monotonic_ns())
    return VcuProcess(World(setup), bus, args)  # type: ignore[arg-type]


# ------------------------------------------------------------ people


def test_typed_commands_move_switches_and_answer_in_words() -> None:
    vcu = made(FakeBus())
    switches = vcu.world.vcu.switches
    assert vcu.command("on") == "lvms, asms, tsms: on"
    assert (switches.lvms, switches.asms, switches.tsms) == (True, True, True)
    assert vcu.command("asms off") == "asms: off"
    assert not switches.asms
    assert "skidpad" in vcu.command("ami skidpad")
    assert switches.ami is Ami.SKIDPAD
    vcu.command("go")
    assert switches.go
    assert vcu.command("go") == "go: off and on again", "only a rising edge starts the car"
    assert not switches.go
    vcu.command("estop")
    assert switches.remote_estop
    vcu.command("estop off")
    assert not switches.remote_estop
    vcu.command("off")
    assert not (switches.lvms or switches.tsms or switches.go)
    assert "ASSI" in vcu.command("status")
    assert "quit" in vcu.command("help")
    vcu.command("quit")
    assert vcu.interrupted == "asked to quit"


def test_go_typed_into_a_car_that_drives_leaves_it_on() -> None:
    vcu = made(FakeBus())
    vcu.command("go")
    vcu.world.vcu.state = AsState.AS_DRIVING
    assert vcu.command("go") == "go: on"
    assert vcu.world.vcu.switches.go


@pytest.mark.parametrize("line", ["fly", "asms maybe", "ami rally", "torque_limit_nm on", "__class__"])
def test_an_unknown_command_is_reported_and_changes_nothing(line: str) -> None:
    vcu = made(FakeBus())
    before = str(vcu.world.vcu.switches)
    assert "unknown" in vcu.command(line)
    assert str(vcu.world.vcu.switches) == before


# ------------------------------------------------------------ the bus


def test_a_lost_bus_is_waited_for_while_the_car_lives_on(monkeypatch: pytest.MonkeyPatch) -> None:
    first, second = FakeBus(), FakeBus()
    monkeypatch.setattr(process, "open_bus", lambda *args, **kwargs: second)
    vcu = made(first)
    vcu._stdin = None
    vcu.command("on")
    sends = second.send

    def last_words(frame: Frame) -> bool:
        vcu.stop("received enough")
        return sends(frame)

    monkeypatch.setattr(second, "send", last_words)
    first.broken = True
    vcu.loop()
    assert first.closed
    assert vcu.bus_losses == 1
    assert len(vcu.status_late_ns) == len([frame for frame in second.sent if frame.can_id == 0x520]) > 0
    assert min(vcu.status_late_ns) >= 0, "how late each one was"


def test_a_held_up_process_lets_the_cars_time_stand_still(monkeypatch: pytest.MonkeyPatch) -> None:
    vcu = made(FakeBus(), "--auto", "--timeout", "0.3")
    start = vcu.world.now_ns
    monotonic_ns = time.monotonic_ns
    jumped = {"ns": 0}
    monkeypatch.setattr(time, "monotonic_ns", lambda: monotonic_ns() + jumped["ns"])
    speak = vcu._speak

    def hang(now: int) -> None:
        speak(now)
        if now - start > 100_000_000:
            jumped["ns"] = 5_000_000_000

    monkeypatch.setattr(vcu, "_speak", hang)
    vcu.loop()
    assert vcu.held_up_ns > 4_900_000_000
    assert vcu.world.now_ns - start < 1_000_000_000
    result = process.result_of(vcu)
    assert result["result"] == result["missions"][0]["result"] == "not judged"
    assert "this computer was too busy" in result["reasons"][0] and len(result["reasons"]) > 1
    vcu.held_up_in_ns = Counter({1: 51 * MS})  # in another mission
    assert process.result_of(vcu)["result"] == "fail"


@pytest.mark.parametrize(
    ("argv", "words"),
    [
        (["-i", "vcan-absent"], "vcan-absent"),
        (["-i", "loopback:t", "--track", "gone.csv"], "gone.csv: cannot be read"),
        (["-i", "loopback:t", "--mission", "rally"], "unknown mission 'rally'"),
        (["-i", "loopback:t", "--mission", "skidpad", "--track", "autocross"], "needs a track of kind skidpad"),
        (["-i", "loopback:t", "--truth", "70000"], "--truth is 70000"),
        (["-i", "loopback:t", "--timeout", "nan"], "--timeout is nan"),
        (["-i", "loopback:t", "--timeout", "inf"], "--timeout is inf"),
        (["-i", "loopback:t", "--seed", "-1"], "seed is -1"),
        (["-i", "loopback:t", "--log", "absent/bus.log"], "absent/bus.log cannot be written"),
    ],
)
def test_bad_input_gets_one_clear_line(
    argv: list[str], words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run(arguments(*argv)) == 1
    printed = capsys.readouterr().err
    assert words in printed
    assert printed.count("\n") == 1


def test_a_run_out_of_time_fails_and_is_printed_if_not_saved(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(process, "go_real_time", lambda *_: ())  # every later test would be scheduled so
    monkeypatch.setattr(process, "HELD_UP_NS", 60 * S)
    path = tmp_path / "absent/verdict.json"
    argv = ["-i", "loopback:t", "--auto", "--quiet", "--timeout", "0.1", "--json", "--result", str(path)]
    assert run(arguments(*argv)) == 1
    printed = capsys.readouterr()
    assert f"{path} cannot be written" in printed.err
    result = json.loads(printed.out.splitlines()[-1])
    assert (result["result"], result["ended"], result["handshake"]) == ("fail", "the time is up", {"echoes": 0})


def test_the_process_sends_frames_and_truth_and_ends_cleanly(tmp_path: Path) -> None:
    channel = f"loopback:sim-{os.getpid()}"
    result = tmp_path / "result.json"
    log = tmp_path / "bus.log"
    with TruthReceiver(0) as receiver, open_bus(channel) as bus:
        argv = [
            sys.executable, "-m", "fsai_vcu.cli.main", "vcu", "-i", channel, "--mission", "skidpad",
            "--truth", str(receiver.port), "--result", str(result), "--log", str(log), "--json", "--quiet",
        ]  # fmt: skip
        child = subprocess.Popen(argv, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        try:
            assert child.stdin is not None
            child.stdin.write("on\nami skidpad\n")
            child.stdin.flush()
            received: set[int] = set()
            until = time.monotonic() + 90.0
            while not {0x520, 0x525} <= received and time.monotonic() < until:
                frame = bus.recv(0.5)
                if frame is not None:
                    received.add(frame.can_id)
            assert {0x520, 0x525} <= received
            truth = receiver.latest()
            assert truth is not None
            assert truth.track == "skidpad"
        finally:
            child.send_signal(signal.SIGTERM)
            out, _ = child.communicate(timeout=60.0)
    assert child.returncode == 0  # an interactive session that was ended is no failure
    assert json.loads(out.splitlines()[-1])["ended"] == "ended by SIGTERM"
    saved = json.loads(result.read_text())
    assert saved["path"]
    assert len(saved["cones"]) == len(load_track("skidpad").cones_xy_m)
    assert " 520#" in log.read_text()


def test_a_measurement_covers_one_mark_to_the_next() -> None:
    vcu = made(FakeBus())
    assert process.result_of(vcu)["measurements"] == []
    answered, late = vcu.world.vcu.response_times_ns, vcu.status_late_ns
    answered += [90 * MS]  # before anybody measured
    assert vcu.command("measure idle") == "measuring: idle"
    answered += [1 * MS, 2 * MS]
    late += [3 * MS]
    vcu.held_up_ns += 60 * MS
    assert vcu.command("measure") == "measuring: 2"
    answered += [40 * MS]
    vcu.world.vcu.comms_losses += 1
    idle, second = process.result_of(vcu)["measurements"]
    assert (idle["name"], idle["response"]["count"], idle["response"]["max_ms"]) == ("idle", 2, 2.0)
    assert (idle["status_late"]["max_ms"], idle["held_up_ms"], idle["comms_losses"]) == (3.0, 60.0, 0)
    assert (second["name"], second["response"]["max_ms"], second["comms_losses"]) == ("2", 40.0, 1)
    assert second["held_up_ms"] == 0.0


# ------------------------------------------------------------ pictures


def test_a_picture_is_a_png_or_one_line_says_why_there_is_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("matplotlib")
    world = World(WorldSetup(missions=[Ami.ACCELERATION], gps=False))
    world.advance(5_000_000_000)
    path = tmp_path / "run.png"
    assert plotted("drive", path, world.run)
    assert path.read_bytes().startswith(b"\x89PNG")
    assert plotted("drive", path, World(WorldSetup(missions=[Ami.STATIC_INSPECTION_A])).run)
    assert not plotted("drive", tmp_path / "absent" / "run.png", world.run)
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    assert not plotted("drive", path, world.run)
    absent, missing = capsys.readouterr().err.splitlines()
    assert "absent/run.png cannot be written" in absent
    assert missing == "drive: no plot: matplotlib is not installed; install it with: pip install 'fsai-vcu[plot]'"
