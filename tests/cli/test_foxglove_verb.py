"""`fsai-vcu foxglove`: the real server, and a client of it."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack
from http.client import HTTPConnection, HTTPResponse
from pathlib import Path
from subprocess import PIPE

import pytest
from talking_bus import talking

from fsai_vcu.cli.main import main
from fsai_vcu.diagnostics.decode.databases import load_databases
from fsai_vcu.diagnostics.foxglove import Server, _Client
from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.revisions import REVISIONS

pytest.importorskip("aiohttp", reason="aiohttp is not installed: pip install 'fsai-vcu[foxglove]'")


SENT = (
    Frame(0x510, bytes.fromhex("0060000000000000")),
    Frame(0x513, bytes.fromhex("3200")),
    Frame(0x520, bytes.fromhex("211E133020000000")),
)


@pytest.mark.parametrize("live", [False, True])
def test_a_client_receives_signals_and_states(tmp_path: Path, live: bool) -> None:
    """Of two minutes of a log, played as fast as they were recorded, and of a bus that was silent at first."""
    websocket = pytest.importorskip("websocket", reason="websocket-client is not installed: it comes with selenium")
    path = tmp_path / "run.log"
    lines = (f"({1000 + n / 100:.6f}) can0 {f.can_id:X}#{f.data.hex()}\n" for n in range(12_000) for f in SENT)
    path.write_text("".join(lines))
    source = f"loopback:foxglove-{os.getpid()}" if live else str(path)
    command = [sys.executable, "-m", "fsai_vcu.cli.main", "foxglove", source, "--port", "0"]
    with ExitStack() as stack, subprocess.Popen(command, stdout=PIPE, text=True) as server:
        try:
            assert server.stdout is not None
            where = server.stdout.readline().split()[0]
            assert where.startswith("ws://127.0.0.1:")
            client = websocket.create_connection(where, timeout=120, subprotocols=["foxglove.sdk.v1"])
            topics: dict[int, str] = {}
            said: dict[str, dict[str, object]] = {}
            while len(said) < 5:
                message = client.recv()
                if isinstance(message, bytes):  # a byte for its kind, the subscription, the time, the message
                    said[topics[int.from_bytes(message[1:5], "little")]] = json.loads(message[13:])
                    continue
                words = json.loads(message)
                assert words["op"] != "status", words
                topics |= (new := {channel["id"]: channel["topic"] for channel in words.get("channels", [])})
                wanted = [{"id": number, "channelId": number} for number in new]
                client.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))
                if live and new:
                    stack.enter_context(talking(source, *SENT))
            client.close()
        finally:
            server.send_signal(signal.SIGINT)
        assert server.wait(120) == 0
    assert said["/can/AI2VCU_Steer"] == {"STEER_REQUEST": 5.0}
    assert said["/can/VCU2AI_Status"]["AS_STATE"] == 3
    assert said["/can/state"]["AS_STATE"] == "AS_DRIVING" and said["/can/state"]["AMI_STATE"] == "ACCELERATION"
    assert said["/can/bridge"]["MISSION_STATUS"] == "RUNNING" and said["/can/bridge"]["DIRECTION_REQUEST"] == "FORWARD"


@pytest.fixture
def served() -> Iterator[Server]:
    with Server("127.0.0.1", 0, "test", ["/can/A", "/can/B"]) as server:
        yield server


def handshake(server: Server, **headers: str) -> int:
    """The status with which a client is answered."""
    return answered(server, **headers).status


def answered(server: Server, **headers: str) -> HTTPResponse:
    """The answer to a client's handshake."""
    port = server.server_address[1]
    client = HTTPConnection("127.0.0.1", port, timeout=60)
    usual = {"Host": f"localhost:{port}", "Connection": "Upgrade", "Upgrade": "websocket"}
    usual |= {"Sec-WebSocket-Version": "13", "Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ=="}
    client.request("GET", "/", headers=usual | {"Sec-WebSocket-Protocol": "foxglove.sdk.v1"} | headers)
    return client.getresponse()


@pytest.mark.parametrize(
    ("origin", "status"),
    [
        ("https://app.foxglove.dev", 101),
        ("file://", 101),
        ("http://localhost:8080", 101),
        ("https://evil.example", 403),
        ("https://app.foxglove.dev.evil.example", 403),
        ("https://localhost.evil.example:8080", 403),
        ("http://localhost", 101),
        ("http://localhost:1, https://evil.example", 403),
        ("http://evil@localhost:1", 403),
        ("null", 403),
    ],
)
def test_only_pages_of_foxglove_and_this_machine_get_in(served: Server, origin: str, status: int) -> None:
    assert handshake(served, Origin=origin) == status
    assert handshake(served, Origin=origin, Host="evil.example:8765") == 421


def test_who_speaks_no_foxglove_is_refused(served: Server) -> None:
    assert handshake(served, **{"Sec-WebSocket-Protocol": "chat"}) == 426
    assert handshake(served, Upgrade="h2c") == 426


@pytest.mark.parametrize(
    ("header", "value"),
    [("Key", "short"), ("Key", "\xff" * 24), ("Version", "99"), ("Version", "<b>"), ("Version", "")],
)
def test_a_handshake_that_is_none_gets_a_plain_line(
    served: Server, header: str, value: str, caplog: pytest.LogCaptureFixture
) -> None:
    answer = answered(served, **{f"Sec-WebSocket-{header}": value})
    assert (answer.status, answer.read()) == (400, b"400 Bad Request\n")
    assert answer.headers["Server"] == "fsai-vcu" and not caplog.records


def test_a_topic_goes_to_a_client_a_few_times_at_most() -> None:
    """Each subscription is sent every message: with thousands the server would have no time for anybody else."""
    server, client = Server("127.0.0.1", 0, "bus", ["/can/A", "/can/B"]), _Client()
    server.socket.close()
    wanted = [{"id": number, "channelId": 1 + number % 2} for number in range(10_000)]
    assert server._take(client, json.dumps({"op": "subscribe", "subscriptions": wanted})) == "too many subscriptions"
    assert [len(held) for held in client.subscribed.values()] == [4, 4]
    server.loop.close()


def test_nonsense_of_a_client_is_answered_and_ends_nothing(served: Server) -> None:
    websocket = pytest.importorskip("websocket", reason="websocket-client is not installed: it comes with selenium")
    where = f"ws://127.0.0.1:{served.server_address[1]}"
    client = websocket.create_connection(
        where, timeout=60, subprotocols=["foxglove.websocket.v1"], suppress_origin=True
    )
    assert json.loads(client.recv())["op"] == "serverInfo"
    channels = json.loads(client.recv())["channels"]
    assert [(each["id"], each["topic"], each["encoding"]) for each in channels] == [
        (1, "/can/A", "json"),
        (2, "/can/B", "json"),
    ]
    for nonsense in ("[" * 50_000, "{}", '{"op": "subscribe"}', '{"op": "advertise"}', '{"op": 1e999}', "\x00"):
        client.send(nonsense)
        assert json.loads(client.recv())["op"] == "status"
    for each in ({"id": -1, "channelId": 1}, {"id": 1, "channelId": 3}, {"id": 1e999, "channelId": 1}):
        client.send(json.dumps({"op": "subscribe", "subscriptions": [each]}))
        assert json.loads(client.recv())["op"] == "status"
    client.send(
        json.dumps({"op": "subscribe", "subscriptions": [{"id": 7, "channelId": 1}, {"id": 8, "channelId": 2}]})
    )
    client.send(json.dumps({"op": "unsubscribe", "subscriptionIds": [8]}))
    client.send("?")  # its answer comes when all before it is done
    assert json.loads(client.recv())["op"] == "status"
    served.publish([("/can/A", 123, {"x": 1.5}), ("/can/B", 123, {"x": 2.5})])
    assert client.recv() == b'\x01\x07\0\0\0{\0\0\0\0\0\0\0{"x":1.5}'
    served.publish([("/can/B", 123, {"x": 2.5}), ("/can/A", 124, {"x": 1.5})])
    assert client.recv()[5] == 124
    client.close()


def test_a_part_of_a_log_is_played_from_its_begin_on(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "run.log"
    path.write_text("".join(f"({t_s}.000000) can0 513#3200\n" for t_s in (1000, 1001, 4600)))
    part = ["--from", "3600", "--messages", "AI2VCU_Steer"]
    assert main(["foxglove", str(path), "--port", "0", *part]) == 0, "not an hour later"
    assert capsys.readouterr().out.startswith("ws://127.0.0.1:")


def test_ctrl_c_as_soon_as_it_is_there_ends_it_well(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "run.log"
    path.write_text("(1000.000000) can0 513#3200\n(4600.000000) can0 513#3200\n")
    monkeypatch.setattr("builtins.print", lambda *_, **__: signal.raise_signal(signal.SIGINT))
    assert main(["foxglove", str(path), "--port", "0"]) == 0


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


@pytest.mark.parametrize("revision", REVISIONS)
def test_each_plot_of_the_layout_has_curves(revision: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["foxglove", "--layout"]) == 0
    panels = json.loads(capsys.readouterr().out)["configById"].values()
    layouts = load_databases((), revision).layouts.values()
    known = {f"/can/{layout.name}.{signal.name}" for layout in layouts for signal in layout.signals}
    for panel in panels:
        curves = [path["value"] for path in panel.get("paths", [])]
        assert not curves or len(known.intersection(curves)) >= 2, panel["title"]
