"""`fsai-vcu foxglove`: the real server, and a client of it."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
from base64 import b64encode
from pathlib import Path

import pytest

from fsai_vcu.cli.main import main

pytest.importorskip("foxglove", reason="foxglove-sdk is not installed: pip install 'fsai-vcu[foxglove]'")


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """Two minutes of 0x513, played as fast as they were recorded."""
    path = tmp_path / "run.log"
    path.write_text("".join(f"({1000 + n / 100:.6f}) can0 513#3200\n" for n in range(12_000)))
    return path


def test_a_client_receives_each_message_as_a_topic(log: Path) -> None:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    command = [sys.executable, "-m", "fsai_vcu.cli.main", "foxglove", str(log), "--port", str(port)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server:
        try:
            assert server.stdout is not None
            assert f"ws://127.0.0.1:{port}" in server.stdout.readline()
            with socket.create_connection(("127.0.0.1", port), timeout=30) as client:
                key = b64encode(os.urandom(16)).decode()
                client.sendall(
                    f"GET / HTTP/1.1\r\nHost: here\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
                    f"Sec-WebSocket-Key: {key}\r\nSec-WebSocket-Version: 13\r\n"
                    f"Sec-WebSocket-Protocol: foxglove.sdk.v1\r\n\r\n".encode()
                )
                received = b""
                while b"/can/AI2VCU_Steer" not in received:
                    part = client.recv(65536)
                    assert part, received
                    received += part
        finally:
            server.send_signal(signal.SIGINT)
        assert server.wait(30) == 0


@pytest.mark.parametrize(("text", "words"), [(None, "No such file or directory"), ("", "no frames in it")])
def test_a_log_without_frames_is_one_line_and_no_server(
    text: str | None, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = tmp_path / "run.log"
    if text is not None:
        log.write_text(text)
    assert main(["foxglove", str(log), "--port", "0"]) == 1
    said = capsys.readouterr()
    assert (said.out, said.err) == ("", f"fsai-vcu foxglove: {log}: {words}\n")


def test_the_layout_names_topics_of_the_car(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["foxglove", "--layout"]) == 0
    assert "/can/VCU2AI_Steer.ANGLE" in json.dumps(json.loads(capsys.readouterr().out))
