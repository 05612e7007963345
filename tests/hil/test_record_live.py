"""Recording on a real interface: what passes is on the disk, whatever happens to interface and disk."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

from conftest import FRAMES, VERB, ip, listening
from fsai_hil.rehearsal.bus_watch import BusWatch
from fsai_hil.rehearsal.stack import RunningProcess, await_condition
from fsai_vcu.interface.frames import Frame
from fsai_vcu.runtime.bus import CanBus, open_bus

WITHIN_S = 60.0
_STAMP = re.compile(r"\(\d+\.\d+\) ")


def recorder_of(interface: str, output: Path, errors: Path) -> RunningProcess:
    """`fsai-vcu record`, listening."""
    return listening(interface, [*VERB, "record", "-i", interface, "-o", str(output)], errors)


def lines(*logs: Path) -> list[str]:
    """Without their times."""
    return [_STAMP.sub("", line) for log in logs for line in log.read_text().splitlines()]


def test_a_recording_has_the_lines_of_candump(
    interface: str, listen: Callable[..., CanBus], bus_log: BusWatch, tmp_path: Path
) -> None:
    log = tmp_path / "run.log"
    recorder = recorder_of(interface, log, tmp_path / "printed")
    bus = listen()
    assert all(bus.send(frame) for frame in FRAMES)
    await_condition(lambda: log.exists() and len(lines(log)) == len(FRAMES), WITHIN_S, "every frame is on the disk")
    assert recorder.stop() == 0
    await_condition(lambda: bus_log.path.read_text().count("\n") == len(FRAMES), WITHIN_S, "candump has them too")
    # candump says how long an answer a remote frame asks for; python-can keeps no payload of one.
    assert lines(log) == [re.sub(r"#R\d$", "#R", line) for line in lines(bus_log.path)]


def test_a_recording_outlives_an_interface_that_goes_down(other: str, tmp_path: Path) -> None:
    folder = tmp_path / "run"
    recorder = recorder_of(other, folder, tmp_path / "printed")
    with open_bus(other) as bus:
        assert bus.send(Frame(0x520, b"\x01"))
    log = folder / f"{other}-000001.log"
    await_condition(lambda: log.exists() and log.stat().st_size > 0, WITHIN_S, "the first frame is on the disk")
    ip("link", "set", other, "down")
    recorder.await_log("waiting for it to come back", WITHIN_S)
    ip("link", "set", other, "up")
    recorder.await_log(f"{other} is back after", WITHIN_S)
    with open_bus(other) as bus:
        assert bus.send(Frame(0x520, b"\x02"))
    await_condition(lambda: len(lines(log)) == 2, WITHIN_S, "the second frame is on the disk")
    assert recorder.stop() == 0
    assert lines(log) == [f"{other} 520#01", f"{other} 520#02"]
    assert recorder.log().count("\n") == 3
