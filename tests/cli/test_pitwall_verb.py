"""`fsai-vcu pitwall`: the real process on a bus and on a log, and clients of it; it never sends."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from http.client import HTTPConnection
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from talking_bus import talking

from fsai_vcu.cli.main import main
from fsai_vcu.interface.codec import Codec
from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.messages import WheelSpeeds
from fsai_vcu.interface.revisions import revision
from fsai_vcu.runtime.bus import CanBus

NAME = f"loopback:pitwall-{os.getpid()}"
DRIVING = bytes.fromhex("211E433020000000")  # AS_DRIVING, TRACKDRIVE, Go, ASMS and TSMS on, everything up


@contextmanager
def watching(*argv: str, typed: str = "") -> Iterator[tuple[int, list[str]]]:
    """The port, and what it says at its start; ended by Ctrl-C it has status 0 and says no more."""
    command = [sys.executable, "-m", "fsai_vcu.cli.main", "pitwall", *argv, "--port", "0"]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=pipe, text=True) as process:
        assert process.stdin is not None and process.stdout is not None
        try:
            process.stdin.write(typed)
            process.stdin.close()
            process.stdin = None  # communicate would flush it
            said = [process.stdout.readline()]
            if "0.0.0.0" in argv:
                said.append(process.stdout.readline())
            yield int(said[0].split(" ")[0].rpartition(":")[2]), said
        finally:
            process.send_signal(signal.SIGINT)
            out, err = process.communicate(timeout=60)
    assert (process.returncode, out, err) == (0, "", "")


def events(port: int) -> Iterator[tuple[str, dict[str, Any]]]:
    """Names and data as they come, over one connection."""
    client = HTTPConnection("127.0.0.1", port, timeout=60)
    client.request("GET", "/events")
    answer = client.getresponse()
    assert answer.headers.get_content_type() == "text/event-stream"
    name = ""
    for line in map(bytes.decode, answer):
        if line.startswith("event: "):
            name = line.removeprefix("event: ").strip()
        elif line.startswith("data: "):
            yield name, json.loads(line.removeprefix("data: "))


def states(port: int) -> Iterator[dict[str, Any]]:
    return (data for name, data in events(port) if name == "state")


def test_a_bus_is_shown_again_and_again_and_nothing_is_sent() -> None:
    with talking(NAME, Frame(0x520, DRIVING)) as received, watching(NAME) as (port, said):
        assert said == [f"http://127.0.0.1:{port} shows {NAME} until Ctrl-C\n"]
        for _ in range(2):  # a viewer that comes back is a new connection
            first, second = (state for state, _ in zip(states(port), range(2), strict=False))
            assert second["sent_s"] > first["sent_s"]
        state = next(state for state in states(port) if state["as_state"])
        assert (state["as_state"], state["mission"], state["channel"]) == ("AS_DRIVING", "TRACKDRIVE", NAME)
        client = HTTPConnection("127.0.0.1", port, timeout=60)
        client.request("POST", "/events", body="x")
        assert client.getresponse().status == 405
        assert received == []


@pytest.fixture
def log(tmp_path: Path) -> str:
    """Two seconds of AS_DRIVING."""
    path = tmp_path / "run.log"
    lines = (f"({1_700_000_000 + n / 100:.6f}) can0 520#{DRIVING.hex().upper()}\n" for n in range(200))
    path.write_text("".join(lines))
    return str(path)


def test_a_log_is_a_page_that_a_network_gets_if_it_is_named(log: str) -> None:
    """With all its moments in it."""
    with watching(log, "--rate", "50", "--loop", "--host", "0.0.0.0") as (port, said):
        assert said[1] == "everybody who reaches 0.0.0.0 of this machine over a network can watch\n"
        client = HTTPConnection("127.0.0.1", port, timeout=60)
        client.request("GET", "/", headers={"Host": f"{socket.gethostname()}:8650"})
        answer = client.getresponse()
        html = answer.read().decode()
        assert answer.status == 200
        client.request("GET", "/", headers={"Host": "evil.example:8650"})
        assert client.getresponse().status == 421
    assert '<h1 id="channel">run.log</h1>' in html and '<script src="page.js">' in html and "<style>" not in html
    data = json.loads(html.split('id="data">')[1].split("</script>")[0])
    assert (data["rate"], data["loop"], data["extent"]) == (50.0, True, [0.0, 1.99])
    assert data["states"][0][1]["as_state"] == "AS_DRIVING"


def test_a_pipe_is_played_to_its_end_without_gaps_in_the_path() -> None:
    wheels = Codec(revision("2026")).encode(WheelSpeeds(40, 40, 40, 40)).data.hex()
    lines = "".join(f"({n / 10:.6f}) can0 525#{wheels}\n" for n in range(1000, 2000))  # 100 s
    with watching("-", "--rate", "2000", typed=lines) as (port, _):
        ended = False
        for name, event in events(port):
            ended = ended or (name == "state" and event["clock"] == "99.9 s into the log: its end")
            if ended and name == "story":
                break
        assert next(states(port))["clock"] == "99.9 s into the log: its end"
    steps_cm = [after - before for before, after in pairwise(event["way_cm"][::2])]
    assert len(steps_cm) > 150 and max(steps_cm) < 100


def test_a_port_in_use_is_one_line(log: str, capsys: pytest.CaptureFixture[str]) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        assert main(["pitwall", log, "--port", str(taken.getsockname()[1])]) == 1
    said = capsys.readouterr()
    assert said.out == "" and said.err.endswith(": Address already in use\n") and said.err.count("\n") == 1


def test_without_aiohttp_one_line_says_how_to_get_it(
    log: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "aiohttp", None)
    monkeypatch.delitem(sys.modules, "fsai_vcu.diagnostics.page.server", raising=False)
    assert main(["pitwall", log]) == 1
    missing = "aiohttp is not installed; install it with: pip install 'fsai-vcu[pitwall]'"
    assert capsys.readouterr() == ("", f"fsai-vcu pitwall: {missing}\n")


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_a_listener_that_fails_ends_it_with_the_reason(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fails(*_: object, **__: object) -> None:
        raise ArithmeticError("of the test")

    monkeypatch.setattr(CanBus, "recv_stamped", fails)
    assert main(["pitwall", NAME, "--port", "0", "--seconds", "60"]) == 1
    assert "is not received any more: ArithmeticError('of the test')\n" in capsys.readouterr().err
