"""What this machine had no room or no time for is told as its own fault, by every verb that listens."""

from __future__ import annotations

import json
import os
import shutil
import signal
import threading
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from talking_bus import talking

from fsai_vcu.cli.main import main
from fsai_vcu.diagnostics.log.live import Listener, LiveSource
from fsai_vcu.diagnostics.monitor.sources import Live
from fsai_vcu.diagnostics.monitor.view import View
from fsai_vcu.interface.frames import Frame
from fsai_vcu.runtime.bus import CanBus, open_bus

BUS = f"loopback:lost-{os.getpid()}"
WORDS = "7 frames lost in this machine's receive buffer: not a fault of the bus or the car"


@pytest.mark.parametrize("verb", ["dump", "check", "explain", "monitor", "record"])
def test_what_the_kernel_threw_away_is_one_line(
    verb: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(Listener, "dropped", 7)
    log = tmp_path / "run.log"
    words = {"record": ["-i", BUS, "-o", str(log), "--seconds", "0.7"], "dump": [BUS, "-n", "3"]}
    with talking(BUS, Frame(0x520, bytes(8))):
        assert main([verb, *words.get(verb, [BUS, "--seconds", "0.3"])]) == 1
    said = capsys.readouterr()
    assert said.err.splitlines()[-1] == f"fsai-vcu {verb}: {WORDS}"
    if verb == "check":
        assert f"unknown: {WORDS}" in said.out
    if verb == "monitor":
        assert f"| {WORDS} |" in said.out
    if verb == "record":
        assert json.loads(log.with_suffix(".json").read_text())["lost_in_receive_buffer"] == 7
        assert main(["check", str(log)]) == 1
        assert f"unknown: {WORDS}" in capsys.readouterr().out


def test_a_log_without_a_loss_is_judged_by_its_frames(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = shutil.copy(Path(__file__).parents[1] / "diagnostics/golden/bends.log.gz", tmp_path / "run.log.gz")
    before = main(["check", str(log)]), capsys.readouterr()
    for lost in ("{}", '{"lost_in_receive_buffer": 0}', '{"lost_in_receive_buffer": null}', "no JSON"):
        (tmp_path / "run.json").write_text(lost)
        assert (main(["check", str(log)]), capsys.readouterr()) == before, lost


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM], ids=lambda number: number.name)
def test_all_that_passed_before_the_end_is_received(
    number: signal.Signals, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    listens = threading.Event()
    receive = CanBus.recv_stamped

    def slowly(bus: CanBus, *args: Any, **options: Any) -> Any:
        listens.set()
        received = receive(bus, *args, **options)
        threading.Event().wait(0.01)
        return received

    def send_and_end() -> None:
        listens.wait()
        with open_bus(BUS) as bus:
            for _ in range(20):
                bus.send(Frame(0x523, bytes(6)))
        os.kill(os.getpid(), number)

    monkeypatch.setattr(CanBus, "recv_stamped", slowly)
    sender = threading.Thread(target=send_and_end)
    sender.start()
    assert main(["check", BUS, "--figures", "--json"]) in (0, 1)
    sender.join()
    assert json.loads(capsys.readouterr().out.splitlines()[0])["count"] == 20


def test_frames_that_are_not_taken_yet_are_no_silence(monkeypatch: pytest.MonkeyPatch) -> None:
    has_time = threading.Event()
    has_time.set()
    receive = CanBus.recv_stamped
    last: Any = None

    def when_there_is_time(bus: CanBus, *args: Any, **options: Any) -> Any:
        nonlocal last
        if last is not None:  # where none came in time, the car was silent before the display lagged
            has_time.wait()
        last = receive(bus, *args, **options)
        return last

    monkeypatch.setattr(CanBus, "recv_stamped", when_there_is_time)
    with talking(BUS, Frame(0x520, bytes(8))), closing(source := LiveSource([BUS])):
        live = Live(source.chunks(60.0), View(BUS), heard_ns=lambda: source.heard_ns)

        def shown(lags: bool) -> str | None:
            """The AS state at the first look at which the display lags, or does not."""
            while True:
                picture = live.look().picture
                if picture.as_state and any("this display lags by" in text for text in picture.link) == lags:
                    return picture.as_state
                live.wait(0.01)

        try:
            assert shown(lags=False) == "AS_INIT"
            has_time.clear()
            assert shown(lags=True) == "AS_INIT"
        finally:
            has_time.set()  # the listener waits for it, and whoever closes waits for the listener
        assert shown(lags=False) == "AS_INIT"
        live.close()
