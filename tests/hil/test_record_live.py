"""Recording on a real interface: what passes is on the disk, whatever happens to interface and disk."""

from __future__ import annotations

import re
import signal
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path

from conftest import FRAMES, VERB
from fsai_hil.rehearsal.bus_watch import BusWatch, listeners
from fsai_hil.rehearsal.stack import await_condition
from fsai_vcu.interface.frames import Frame
from fsai_vcu.runtime.bus import CanBus, open_bus

WITHIN_S = 20.0
_STAMP = re.compile(r"\(\d+\.\d+\) ")


class Recorder:
    """`fsai-vcu record`, listening; `printed` is what it has printed."""

    def __init__(self, interface: str, output: Path, *options: str) -> None:
        before = listeners(interface)
        argv = [*VERB, "record", "-i", interface, "-o", str(output), *options]
        self._errors = Path(tempfile.mkdtemp()) / "stderr"
        with self._errors.open("wb") as errors:
            self.process = subprocess.Popen(argv, stdin=subprocess.DEVNULL, stderr=errors)
        await_condition(lambda: listeners(interface) > before, WITHIN_S, "the recorder listens")

    def printed(self) -> str:
        return self._errors.read_text()

    def await_words(self, words: str) -> None:
        await_condition(lambda: words in self.printed(), WITHIN_S, f"the recorder prints '{words}'")

    def stop(self) -> int:
        self.process.send_signal(signal.SIGTERM)
        return self.process.wait(WITHIN_S)


def lines(*logs: Path) -> list[str]:
    """Without their times."""
    return [_STAMP.sub("", line) for log in logs for line in log.read_text().splitlines()]


def test_a_recording_has_the_lines_of_candump(
    interface: str, listen: Callable[..., CanBus], bus_log: BusWatch, tmp_path: Path
) -> None:
    log = tmp_path / "run.log"
    recorder = Recorder(interface, log)
    bus = listen()
    assert all(bus.send(frame) for frame in FRAMES)
    await_condition(lambda: log.exists() and len(lines(log)) == len(FRAMES), WITHIN_S, "every frame is on the disk")
    assert recorder.stop() == 0
    await_condition(lambda: bus_log.path.read_text().count("\n") == len(FRAMES), WITHIN_S, "candump has them too")
    # candump says how long an answer a remote frame asks for; python-can keeps no payload of one.
    assert lines(log) == [re.sub(r"#R\d$", "#R", line) for line in lines(bus_log.path)]


def test_a_recording_outlives_an_interface_that_goes_down(other: str, tmp_path: Path) -> None:
    folder = tmp_path / "run"
    recorder = Recorder(other, folder)
    with open_bus(other) as bus:
        assert bus.send(Frame(0x520, b"\x01"))
    log = folder / f"{other}-000001.log"
    await_condition(lambda: log.exists() and log.stat().st_size > 0, WITHIN_S, "the first frame is on the disk")
    subprocess.run(["ip", "link", "set", other, "down"], check=True)
    recorder.await_words("waiting for it to come back")
    subprocess.run(["ip", "link", "set", other, "up"], check=True)
    recorder.await_words(f"{other} is back after")
    with open_bus(other) as bus:
        assert bus.send(Frame(0x520, b"\x02"))
    await_condition(lambda: len(lines(log)) == 2, WITHIN_S, "the second frame is on the disk")
    assert recorder.stop() == 0
    assert lines(log) == [f"{other} 520#01", f"{other} 520#02"]
    assert recorder.printed().count("\n") == 3
