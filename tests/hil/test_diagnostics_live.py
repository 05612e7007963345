"""The diagnostics on a live bus: what they show is what candump shows there."""

from __future__ import annotations

import json
import re
import signal
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from conftest import FRAMES, VERB, ip, listening
from fsai_hil.rehearsal.bus_watch import BusWatch
from fsai_hil.rehearsal.stack import RunningProcess, await_condition
from fsai_vcu.interface.frames import Frame
from fsai_vcu.runtime.bus import CanBus, open_bus

WITHIN_S = 60.0
FLOOD = 40_000  # frames: twice what the kernel keeps
LOST = re.compile(r"(\d+) frames lost in this machine's receive buffer")
_STAMP = re.compile(r"\(\d+\.\d+\)")


def lines_of(shown: RunningProcess, count: int) -> list[str]:
    """What it has printed, once there are so many lines."""
    await_condition(lambda: shown.log().count("\n") >= count, WITHIN_S, f"{count} lines are shown")
    return shown.log().splitlines()


@pytest.mark.parametrize(
    ("options", "filters"),
    [
        (["-t", "a"], ",520:7FF,18FF0001:9FFFFFFF"),
        pytest.param(["-t", "z"], ",510~7FF", marks=pytest.mark.long),
        pytest.param(["-L", "-n", "3"], "", marks=pytest.mark.long),
    ],
    ids=lambda part: "".join(part),
)
def test_dump_shows_the_lines_of_candump(
    interface: str, listen: Callable[..., CanBus], tmp_path: Path, options: list[str], filters: str
) -> None:
    """By the kernel's filters; lines of every style are held to candump's in the tests of the verb."""
    source = interface + filters
    theirs = listening(interface, ["candump", *options, source], tmp_path / "candump.txt")
    dump = [*VERB, "dump", "--no-signals", *options, source]
    ours = listening(interface, dump, tmp_path / "dump.txt")
    bus = listen()
    assert all(bus.send(frame) for frame in FRAMES)
    count = 3 if "-n" in options else sum(passes(frame, filters) for frame in FRAMES)
    shown, expected = lines_of(ours, count), lines_of(theirs, count)
    assert [_STAMP.sub("(*)", line) for line in shown] == [_STAMP.sub("(*)", line) for line in expected]
    for ours_s, theirs_s in zip(_STAMP.findall("\n".join(shown)), _STAMP.findall("\n".join(expected)), strict=True):
        assert len(ours_s) == len(theirs_s)
        # Each socket has its own stamp of a frame, and python-can gives it as a float.
        assert abs(float(ours_s[1:-1]) - float(theirs_s[1:-1])) < 0.01
    theirs.stop()
    assert (ours.wait(WITHIN_S) if "-n" in options else ours.stop()) == 0


def passes(frame: Frame, filters: str) -> bool:
    if "~" in filters:
        return frame.can_id & 0x7FF != 0x510
    return not filters or frame.can_id in (0x520, 0x18FF0001)


@pytest.mark.parametrize(
    ("options", "shown"),
    [
        pytest.param("--signals AS_STATE -t z", {"520": "AS_STATE: AS_DRIVING"}, marks=pytest.mark.long),
        ("--messages AI2VCU_Brake,0x123", {"514": "HYD_PRESS", "00000123": "Unknown frame id"}),
        pytest.param(
            "--from 0 --to 30 --changes --short --messages 0x520", {"520": "AS_DRIVING"}, marks=pytest.mark.long
        ),
    ],
)
def test_dump_of_a_live_bus_shows_what_is_chosen(
    interface: str, listen: Callable[..., CanBus], tmp_path: Path, options: str, shown: dict[str, str]
) -> None:
    dump = listening(interface, [*VERB, "dump", interface, *options.split()], tmp_path / "dump.txt")
    bus = listen()
    assert all(bus.send(frame) for frame in FRAMES)
    found = lines_of(dump, len(shown))
    assert dump.stop() == 0
    assert len(found) == len(shown)
    for line, (can_id, words) in zip(found, shown.items(), strict=True):
        assert f" {can_id} " in line and words in line


def test_a_live_check_ends_after_its_time_with_a_verdict(
    interface: str, listen: Callable[..., CanBus], tmp_path: Path
) -> None:
    check = listening(interface, [*VERB, "check", interface, "--seconds", "2"], tmp_path / "check.txt")
    bus = listen()
    assert all(bus.send(frame) for frame in FRAMES)
    assert check.wait(WITHIN_S) == 1, "too little is known"
    assert f"{interface}: {len(FRAMES)} frames" in check.log() and check.log().count("verdict: ") == 1


def test_stats_of_a_live_bus_are_those_of_its_log(
    interface: str,
    listen: Callable[..., CanBus],
    bus_log: BusWatch,
    tmp_path: Path,
    verb: Callable[..., subprocess.CompletedProcess[str]],
) -> None:
    argv = [*VERB, "check", "--figures", "--json", interface]
    live = listening(interface, argv, tmp_path / "stats.json", tmp_path / "errors")
    bus = listen()
    assert all(bus.send(frame) for frame in FRAMES)
    await_condition(
        lambda: bus_log.path.read_bytes().count(b"\n") == len(FRAMES), WITHIN_S, "candump wrote every frame"
    )
    live.stop()
    ours = [json.loads(line) for line in (tmp_path / "stats.json").read_text().splitlines()]
    logged = [json.loads(line) for line in verb("check", "--figures", "--json", str(bus_log.path)).stdout.splitlines()]
    kept = ("id", "extended", "message", "count", "wrong_lengths", "bits", "remote")
    assert [tuple(e[k] for k in kept) for e in ours if e["type"] == "message"] == [
        tuple(e[k] for k in kept) for e in logged if e["type"] == "message"
    ]
    assert len([e for e in ours if e["type"] == "message"]) == len(FRAMES)


def test_frames_that_find_no_room_are_counted_by_all(other: str, tmp_path: Path) -> None:
    """Those who listen stand still while more comes than the kernel keeps for them."""
    log = tmp_path / "run.log"
    listeners = {
        "dump": [other, "--no-signals"],
        "check": [other],
        "monitor": [other, "--json"],
        "record": ["-i", other, "-o", str(log)],
    }
    running = {
        verb: listening(other, [*VERB, verb, *words], tmp_path / f"{verb}.txt", tmp_path / f"{verb}.errors")
        for verb, words in listeners.items()
    }
    for process in running.values():
        process.signal(signal.SIGSTOP)
    with open_bus(other) as bus:
        for number in range(FLOOD):
            assert bus.send(Frame(0x520, number.to_bytes(8, "little")))
        for process in running.values():
            process.signal(signal.SIGCONT)
        await_condition(lambda: LOST.search(running["monitor"].log()), WITHIN_S, "the monitor says what is lost")
        shown = running["dump"].log, lambda: log.read_text() if log.exists() else ""
        await_condition(lambda: all(text() for text in shown), WITHIN_S, "there is room again")
        assert bus.send(Frame(0x7FF))
        await_condition(lambda: all("7FF" in text() for text in shown), WITHIN_S, "all that was kept is shown")
    lost = {}
    for verb, process in running.items():
        assert process.stop() == 1
        (lost[verb],) = (int(found) for found in LOST.findall((tmp_path / f"{verb}.errors").read_text())[-1:])
    for verb, text in zip(("dump", "record"), shown, strict=True):
        assert lost[verb] + text().count("\n") == FLOOD + 1
    assert json.loads(log.with_suffix(".json").read_text())["lost_in_receive_buffer"] == lost["record"]
    assert f"unknown: {lost['check']} frames lost" in running["check"].log()


@pytest.mark.parametrize("words", [pytest.param("dump", marks=pytest.mark.long), "monitor --plain --every 0.1"])
def test_a_bus_that_goes_away_ends_the_listening_with_one_line(words: str, other: str, tmp_path: Path) -> None:
    verb, *options = words.split()
    ours = listening(other, [*VERB, verb, other, *options], tmp_path / "shown.txt", tmp_path / "errors")
    ip("link", "set", other, "down")
    assert ours.wait(WITHIN_S) == 1
    errors = (tmp_path / "errors").read_text()
    assert errors.startswith(f"fsai-vcu {verb}: {other}: ") and errors.count("\n") == 1
