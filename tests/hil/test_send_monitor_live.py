"""`monitor` and `send` on a live bus: one only hears, the other sends as cansend does, never beside a bridge."""

from __future__ import annotations

import contextlib
import json
import subprocess
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from conftest import VERB, BusLog
from fsai_hil.rehearsal.stack import await_condition
from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.reserved import AI_IDS
from fsai_vcu.runtime.bus import CanBus

WITHIN_S = 20.0
DRIVING = Frame(0x520, bytes.fromhex("211E433020000000"))
Run = Callable[..., "subprocess.CompletedProcess[str]"]

BENCH = """\
VERSION ""

BU_: AI LAMP

BO_ 419 BenchLamp: 2 AI
 SG_ COLOUR : 0|4@1+ (1,0) [0|15] "" LAMP
 SG_ LEVEL : 8|8@1+ (0.5,0) [0|100] "%" LAMP

BO_ 2566848767 BenchWide: 1 AI
 SG_ ANY : 0|8@1+ (1,0) [0|255] "" LAMP

VAL_ 419 COLOUR 0 "OFF" 1 "RED";
"""


@pytest.fixture
def bench(tmp_path: Path) -> str:
    path = tmp_path / "bench.dbc"
    path.write_text(BENCH)
    return str(path)


@contextlib.contextmanager
def beating(bus: CanBus, frame: Frame) -> Iterator[None]:
    """Somebody sends this every 10 ms."""
    ended = threading.Event()

    def send() -> None:
        while not ended.wait(0.01):
            bus.send(frame)

    thread = threading.Thread(target=send)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


def test_monitor_shows_what_is_on_the_bus_and_sends_nothing(
    interface: str, listen: Callable[..., CanBus], bus_log: BusLog, verb: Run
) -> None:
    with beating(listen(), DRIVING):
        done = verb("monitor", interface, "--json", "--seconds", "3", "--every", "0.5")
    assert done.returncode == 0, done.stderr
    entries = [json.loads(line) for line in done.stdout.splitlines()]
    last = entries[-1]
    assert (last["as_state"], last["mission"], last["go"], last["driving"]) == ("AS_DRIVING", "TRACKDRIVE", True, True)
    (status,) = (message for message in last["messages"] if message["id"] == 0x520)
    assert status["freshness"] == "ok" and status["rate_hz"] > 10
    assert {str(frame) for frame in bus_log.frames()} == {str(DRIVING)}


def test_an_interface_that_goes_down_ends_monitor_with_one_line(tmp_path: Path) -> None:
    subprocess.run(["ip", "link", "add", "dev", "vcan2", "type", "vcan"], check=True)
    try:
        subprocess.run(["ip", "link", "set", "vcan2", "up"], check=True)
        out = tmp_path / "monitor.txt"
        with out.open("wb") as file:
            argv = [*VERB, "monitor", "vcan2", "--plain", "--every", "0.1"]
            process = subprocess.Popen(argv, stdout=file, stderr=subprocess.PIPE, text=True)
            await_condition(lambda: out.stat().st_size > 0, WITHIN_S, "monitor listens")
            subprocess.run(["ip", "link", "set", "vcan2", "down"], check=True)
            _, said = process.communicate(timeout=WITHIN_S)
        assert process.returncode == 1
        assert said.startswith("fsai-vcu monitor: vcan2: ") and said.count("\n") == 1
    finally:
        subprocess.run(["ip", "link", "del", "vcan2"], check=True)


@pytest.mark.parametrize(
    ("argv", "frame"),
    [
        (("BenchLamp", "COLOUR=RED", "LEVEL=12.5"), "1A3#0119"),
        (("BenchWide", "ANY=255"), "18FF00FF#FF"),
    ],
)
def test_send_and_cansend_of_its_dry_run_send_the_same_frame(
    argv: tuple[str, ...], frame: str, interface: str, bench: str, bus_log: BusLog, verb: Run
) -> None:
    dry = verb("send", *argv, "--dbc", bench, "--dry-run")
    assert (dry.returncode, dry.stdout) == (0, f"{frame}\n"), dry.stderr
    subprocess.run(["cansend", interface, dry.stdout.strip()], check=True)
    done = verb("send", *argv, "--dbc", bench, "-i", interface, "--count", "3", "--period", "20")
    assert done.returncode == 0, done.stderr
    assert done.stderr.splitlines()[-1] == f"3 frames sent on {interface}"
    await_condition(lambda: len(bus_log.frames()) == 4, WITHIN_S, "candump wrote every frame")
    assert len({str(each) for each in bus_log.frames()}) == 1
    assert bus_log.path.read_text().split()[2] == frame


def test_send_refuses_a_bus_on_which_a_live_bridge_is_heard(
    interface: str, bench: str, listen: Callable[..., CanBus], bus_log: BusLog, verb: Run
) -> None:
    can_id = AI_IDS[-1]
    with beating(listen(), Frame(can_id, bytes(8))):
        done = verb("send", "BenchLamp", "--dbc", bench, "-i", interface)
        ours = verb("send", "AI2VCU_Steer", "STEER_REQUEST=5", "--as-ai", "-i", interface)
    for refused in (done, ours):
        assert refused.returncode == 1 and refused.stdout == ""
        assert refused.stderr == (
            f"fsai-vcu send: a live bridge is heard on {interface} (0x{can_id:03X}): stop it first\n"
        )
    assert {frame.can_id for frame in bus_log.frames()} == {can_id}


def test_an_ai_frame_is_sent_if_asked_for_and_no_bridge_sends(interface: str, bus_log: BusLog, verb: Run) -> None:
    refused = verb("send", "AI2VCU_Steer", "STEER_REQUEST=5", "-i", interface)
    assert refused.returncode == 1 and "--as-ai" in refused.stderr
    done = verb("send", "AI2VCU_Steer", "STEER_REQUEST=5", "--as-ai", "-i", interface)
    assert done.returncode == 0, done.stderr
    await_condition(lambda: len(bus_log.frames()) == 1, WITHIN_S, "candump wrote the frame")
    assert str(bus_log.frames()[0]) == "513#3200"
