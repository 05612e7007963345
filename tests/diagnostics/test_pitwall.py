"""The pit wall without a browser: what the page shows, the driven path, and the server with its viewers."""

from __future__ import annotations

import json
import socket
import time
from collections.abc import Iterator
from contextlib import ExitStack, closing, suppress
from http.client import HTTPConnection, HTTPResponse
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from story_runs import twice

from fsai_vcu.diagnostics import serving
from fsai_vcu.diagnostics.explain import Record
from fsai_vcu.diagnostics.log import live
from fsai_vcu.diagnostics.log.frames import Frames, LogFrame, frames_of
from fsai_vcu.diagnostics.log.reader import read_log
from fsai_vcu.diagnostics.monitor.snapshot import Freshness, MessagePicture, Picture
from fsai_vcu.diagnostics.monitor.state_history import LONG_NS
from fsai_vcu.diagnostics.monitor.view import View
from fsai_vcu.diagnostics.page.board import EVENTS, events_of, state_of, states_of
from fsai_vcu.diagnostics.page.curves import way_of
from fsai_vcu.diagnostics.page.server import Server
from fsai_vcu.diagnostics.page.trace import POINTS, Trace
from fsai_vcu.diagnostics.serving import MOST_CONNECTIONS, MOST_OF_ONE
from fsai_vcu.interface.enums import AsState
from fsai_vcu.interface.errors import UserError
from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.lights import LIGHTS
from fsai_vcu.interface.units import MS, S
from fsai_vcu.runtime.bus import BusLost

DRIVING = bytes.fromhex("211E433020000000")  # AS_DRIVING, TRACKDRIVE, Go, ASMS and TSMS on, everything up


@pytest.fixture(scope="module")
def run() -> Frames:
    """Bends at speed, then a service-brake stop (see test_golden_run.py)."""
    return read_log(str(Path(__file__).parent / "golden" / "bends.log.gz"))[0]


def seen(frames: Frames, now_ns: int | None = None) -> Picture:
    view = View("can0")
    view.update(frames)
    return view.picture(int(frames.t_ns[-1]) if now_ns is None else now_ns)


def status(payload: bytes) -> Frames:
    return frames_of(LogFrame(n * 10 * MS, "can0", 0x520, payload) for n in range(100))


# ---------------------------------------------------------------- what the page shows


def test_a_state_is_json_without_messages_that_come(run: Frames) -> None:
    driving = run.only(run.t_ns < run.t_ns[0] + 20 * S)
    state = state_of(seen(driving))
    assert len(json.dumps(state, allow_nan=False)) < 2500
    assert (state["as_state"], state["light"]) == ("AS_DRIVING", LIGHTS[AsState.AS_DRIVING]._asdict())
    assert (state["driving"], state["why_not_driving"], state["faults"], state["missing"]) == (True, [], [], [])
    assert state["received"] >= 14 and "messages" not in state
    assert (state["lap"], state["laps"], state["lap_times_s"]) == (0, 1, []) and state["bitrate"] == 500_000
    assert state["lap"] == 0 and state["cones"] > 0 and state["speed_mps"] > 3.0
    assert state["silent_s"] < 0.1


@pytest.mark.parametrize(
    ("code", "colour", "flashes"),
    [(0, "off", False), (1, "off", False), (2, "yellow", False), (4, "blue", True), (5, "blue", False)],
)
def test_each_as_state_has_the_lights_of_the_car(code: int, colour: str, flashes: bool) -> None:
    payload = bytearray(DRIVING)
    payload[2] = payload[2] & 0xF0 | code
    light = state_of(seen(status(bytes(payload))))["light"]
    assert (light["colour"], light["flashes"]) == (colour, flashes)


def test_nothing_received_is_no_state_and_unknown_lights() -> None:
    state = state_of(View("can0").picture(5 * S))
    assert (state["as_state"], state["silent_s"], state["light"]["colour"]) == (None, None, "unknown")
    assert state["link"] == ["nothing is received on this bus"]


def test_values_of_a_silent_car_are_gone_and_its_age_is_told() -> None:
    state = state_of(seen(status(DRIVING), 4 * S))
    assert (state["as_state"], state["as_state_heard"], state["speed_mps"]) == (None, "AS_DRIVING", None)
    assert (state["light"]["colour"], state["driving"], state["silent_s"]) == ("unknown", False, pytest.approx(3.01))
    assert state["missing"][0] == "0x520 VCU2AI_Status lost: 3.0 s old"
    assert state["missing"][-1].startswith("never received: 0x510, 0x511")


def test_the_lost_messages_of_a_silent_bus_are_one_line() -> None:
    messages = [MessagePicture(0x520 + n, False, None, 0.0, 100.0, 3.0, Freshness.LOST, False) for n in range(7)]
    state = state_of(Picture(0, "can0", "2026", "", 1, messages=tuple(messages)))
    assert state["missing"] == ["lost: 0x520, 0x521, 0x522, 0x523, 0x524, 0x525, 0x526"]


def test_a_fault_comes_with_its_cause_and_what_to_do() -> None:
    payload = bytearray(DRIVING)
    payload[5] = 0xFF  # every fault bit of that byte
    faults = state_of(seen(status(bytes(payload))))["faults"]
    assert len(faults) > 3 and all(fault["text"] and fault["remedy"] for fault in faults)
    (ebs,) = (fault for fault in faults if fault["names"] == ["EBS_FAULT"])
    assert ebs["text"] == "the emergency brake system failed (EBS_FAULT)"


def test_bits_of_one_cause_are_one_fault() -> None:
    state = state_of(Picture(0, "can0", "2026", "", 1, faults=("AI_COMMS_LOST",), shutdown_cause="AI_COMMS_FAULT"))
    (fault,) = state["faults"]
    assert fault["names"] == ["AI_COMMS_LOST", "SHUTDOWN_CAUSE AI_COMMS_FAULT"] and fault["remedy"]


def test_events_are_the_newest_first_and_none_of_later(run: Frames) -> None:
    view = View("can0")
    view.update(run)
    at_ns = int(run.t_ns[0]) + 20 * S
    events = events_of(view.events(), at_ns, lambda t_ns: f"{(t_ns - run.t_ns[0]) / S:.3f}")
    assert "AS_STATE AS_READY → AS_DRIVING" in [one["text"] for one in events[:3]]
    times = [float(one["at"]) for one in events]
    assert times == sorted(times, reverse=True) and times[0] <= 20.0 and len(events) <= EVENTS


def test_states_of_a_log_are_those_of_its_moments_but_for_curves(run: Frames) -> None:
    driven_ns = int(run.t_ns[0]) + 18 * S
    told = list(states_of(run, View("can0", "2026"), [driven_ns], 0))
    shown: dict[str, Any] = {}
    for t_s, changes in told:
        shown |= changes
        if t_s == driven_ns / S:
            break
    whole = state_of(seen(run.only(run.t_ns <= driven_ns), driven_ns))
    numbers = {"speed_mps", "load", "actuators"}
    assert len(told) > 25 and {name: shown[name] for name in whole if name not in numbers} == {
        name: value for name, value in whole.items() if name not in numbers
    }
    assert set(shown["actuators"]["steering"]) == {"limit", "unit"} and "speed_mps" not in shown


# ---------------------------------------------------------------- the driven path


def traced(frames: Frames, step_ns: int) -> Trace:
    """As the frames come, looked at so often."""
    view, trace = View("can0"), Trace()
    view.update(frames.head(1))
    trace.update(view.memory, "2026")
    for begin_ns in range(int(frames.t_ns[0]) + 1, int(frames.t_ns[-1]) + 1, step_ns):
        view.update(frames.only((frames.t_ns >= begin_ns) & (frames.t_ns < begin_ns + step_ns)))
        trace.update(view.memory, "2026")
    return trace


@pytest.mark.parametrize("step_ns", [200 * MS, 7 * S, LONG_NS])
def test_the_way_is_that_of_the_log_however_seldom_one_looks(run: Frames, step_ns: int) -> None:
    trace, way = traced(run, step_ns), way_of(Record(run, "2026"))
    assert way is not None and way.length_m > 40.0
    assert trace.pose[:2] == (pytest.approx(way.x_m[-1], abs=0.01), pytest.approx(way.y_m[-1], abs=0.01))
    steps = np.hypot(*np.diff(np.array(trace.line.points), axis=0).T)
    assert len(trace.line.points) < POINTS and steps.min() >= 0.5 and steps.max() < 1.0


def test_a_run_begins_at_its_frame_whenever_one_looks(run: Frames) -> None:
    driven_ns = run.t_ns[0] + 17 * S
    pushed = run.only((run.can_id == 0x525) & (run.t_ns > driven_ns) & (run.t_ns < driven_ns + 3 * S))
    both = twice(run, pushed, -10 * S - 5 * MS)  # in AS_READY, between those that say 0
    trace, alone = traced(both, LONG_NS), traced(run, 200 * MS)
    assert trace.pose == pytest.approx(alone.pose, abs=1e-6)
    assert len(trace.line.points) == len(alone.line.points)


def test_the_way_begins_anew_with_a_log_and_after_missing_frames(run: Frames) -> None:
    start, end, later = View("can0"), View("can0"), View("can0")
    start.update(run.head(1))
    end.update(run)
    later.update(run.at(run.t_ns + 2 * LONG_NS))
    trace = Trace()
    for view, begins in ((start, True), (end, False), (later, True), (end, True), (start, True), (end, False)):
        trace.update(view.memory, "2026")
        assert ((len(trace.line.points), trace.pose) == (1, (0.0, 0.0, 0.0))) is begins


# ---------------------------------------------------------------- a bus that goes away


def test_a_bus_that_goes_away_is_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    class Bus:
        """One frame, and then it is lost, or silent."""

        def __init__(self, can_id: int, *, lost: bool) -> None:
            self.frames, self.lost = [(Frame(can_id, b""), can_id)], lost

        def recv_stamped(self, timeout_s: float, *, bus_off_is_lost: bool) -> tuple[Frame, int] | None:
            if self.lost and not self.frames:
                raise BusLost("can0 is gone")
            return self.frames.pop() if self.frames else None

        def dropped(self) -> int:
            return 0

        def close(self) -> None: ...

    buses = iter([Bus(1, lost=True), Bus(2, lost=False)])
    monkeypatch.setattr(live, "_open", lambda spec: next(buses))
    seen: list[int] = []
    with closing(live.LiveSource(["can0"], waits=True)) as source:
        for frames in source.chunks():
            seen += frames.can_id.tolist()
            if 2 in seen:
                break
        gone, back = source.news()
    assert seen == [1, 2] and source.lost is None
    assert gone == "can0 is gone; waiting for it to come back" and back.startswith("can0 is back after")


# ---------------------------------------------------------------- the server


@pytest.fixture
def server() -> Iterator[Server]:
    with Server("127.0.0.1", 0) as started:
        yield started


def asked(
    server: Server, method: str, path: str, host: str | None = None, origin: str | None = None, to: str = "127.0.0.1"
) -> HTTPResponse:
    """The whole answer, or the beginning of a stream."""
    client = HTTPConnection(to, server.server_address[1], timeout=60)
    given = {"Host": host, "Origin": origin}
    client.request(method, path, headers={name: value for name, value in given.items() if value is not None})
    return client.getresponse()


def event(stream: HTTPResponse) -> tuple[str, dict[str, object]]:
    """The next one."""
    lines: list[str] = []
    while not (lines and lines[-1].startswith("data: ")):
        line = stream.readline().decode()
        assert line, "the stream has ended"
        lines.append(line.strip())
    return lines[-2].removeprefix("event: "), json.loads(lines[-1].removeprefix("data: "))


def publish_to_nobody(server: Server) -> None:
    """Until no viewer is left; with room for the server's thread, which an endless stream of events would hold up."""
    while server.viewers:
        server.publish("state", {"ballast": "x" * 100_000})
        time.sleep(0.01)


@pytest.mark.parametrize(
    ("path", "kind"), [("/", "text/html"), ("/page.css", "text/css"), ("/page.js?x=1", "text/javascript")]
)
def test_the_page_and_its_parts_are_served_with_a_policy(server: Server, path: str, kind: str) -> None:
    answer = asked(server, "GET", path)
    assert (answer.status, answer.headers.get_content_type()) == (200, kind)
    assert "default-src 'self'" in answer.headers["Content-Security-Policy"]
    assert answer.headers["X-Content-Type-Options"] == "nosniff" and answer.headers["Cache-Control"] == "no-store"
    assert answer.headers["Server"] == "fsai-vcu"
    assert b"http" not in answer.read()  # nothing of other machines


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "PATCH", "OPTIONS", "HEAD", "TRACE"])
def test_every_method_but_get_is_refused(server: Server, method: str) -> None:
    assert asked(server, method, "/").status == 405


def test_what_is_no_request_gets_one_plain_line_and_the_policy(
    server: Server, capfd: pytest.CaptureFixture[str]
) -> None:
    answer = asked(server, "<b>", "/")
    assert (answer.status, answer.headers.get_content_type()) == (400, "text/plain")
    assert answer.headers["Server"] == "fsai-vcu" and "default-src 'self'" in answer.headers["Content-Security-Policy"]
    assert answer.read() == b"400 Bad Request\n" and capfd.readouterr() == ("", "")


@pytest.mark.parametrize("path", ["/x", "/server.py", "/../server.py", "//etc/passwd", "/page.js/../../server.py"])
def test_there_is_nothing_beyond_the_page(server: Server, path: str) -> None:
    assert asked(server, "GET", path).status == 404


@pytest.mark.parametrize("host", ["127.0.0.1", "127.0.0.2", "0.0.0.0", "::1", "localhost"])
def test_a_foreign_name_that_leads_here_is_refused(host: str) -> None:
    """On every address that is listened on; and a page of another site is refused by where it is from."""
    with Server(host, 0) as server:
        port = server.server_address[1]
        foreign = ("evil.example", "localhost.evil.example", "127.0.0.1.evil.example", "192.0.2.1", "[2001:db8::1]", "")
        for name in foreign:
            for path in ("/", "/events"):
                assert asked(server, "GET", path, f"{name}:{port}", to=host).status == 421, name
        ours = ("localhost", "LOCALHOST", "0.0.0.0", "[::]", "127.0.0.1", "[::1]")
        for name in (*(f"{own}:{port}" for own in ours), "localhost"):
            assert asked(server, "GET", "/", name, to=host).status == 200, name
        for origin in ("https://evil.example", "null", "file://", f"http://localhost:{port + 1}", "http://[::1"):
            assert asked(server, "GET", "/", f"localhost:{port}", origin, to=host).status == 403, origin
        assert asked(server, "GET", "/", f"localhost:{port}", f"http://localhost:{port}", to=host).status == 200


@pytest.mark.parametrize("host", ["", "a\udcffb"])
def test_what_can_be_no_name_of_a_host_is_an_error_of_the_system(host: str) -> None:
    with pytest.raises(OSError, match="no name of a host"):
        Server(host, 0)


@pytest.mark.parametrize(("host", "beyond"), [("127.0.0.1", False), ("127.0.0.2", False), ("0.0.0.0", True)])
def test_it_is_known_whether_a_network_can_watch(host: str, beyond: bool) -> None:
    with Server(host, 0) as server:
        assert bool(server.beyond) is beyond


def test_a_server_whose_thread_has_ended_is_an_error_in_words() -> None:
    with Server("127.0.0.1", 0) as server:
        server.loop.call_soon_threadsafe(server._stop.set)
        server._thread.join()
        with pytest.raises(UserError, match=r"nobody listens on 127\.0\.0\.1:\d+ any more"):
            server.publish("state", {})


def test_ten_viewers_get_the_same_and_a_late_one_the_last(server: Server) -> None:
    server.publish("state", {"n": 1})
    with ExitStack() as open_streams:
        streams = [open_streams.enter_context(closing(asked(server, "GET", "/events"))) for _ in range(10)]
        assert [event(stream)[1]["n"] for stream in streams] == [1] * 10
        assert server.viewers == 10
        server.publish("story", {"n": 2})
        assert [event(stream)[0] for stream in streams] == ["story"] * 10
        late = open_streams.enter_context(closing(asked(server, "GET", "/events")))
        assert [event(late)[1]["n"] for _ in range(2)] == [1, 2]


def test_a_viewer_that_reads_nothing_holds_up_nobody(server: Server) -> None:
    with closing(asked(server, "GET", "/events")), closing(asked(server, "GET", "/events")) as reads:
        for number in range(300):
            server.publish("state", {"n": number, "ballast": "x" * 100_000})
        shown = -1
        while shown < 299:
            shown = int(str(event(reads)[1]["n"]))


def test_a_viewer_that_takes_nothing_is_dropped_in_time(server: Server, monkeypatch: pytest.MonkeyPatch) -> None:
    with closing(asked(server, "GET", "/events")) as stream:
        assert stream.readline() == b"retry: 1000\n" and server.viewers == 1
        monkeypatch.setattr(serving, "TIMEOUT_S", 0.1)
        publish_to_nobody(server)


def test_a_connection_that_asks_nothing_is_closed_in_time(server: Server, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(serving, "TIMEOUT_S", 0.1)
    # A reset is an end too: of what was closed before that is sent, or read.
    with suppress(ConnectionError), socket.create_connection(server.server_address[:2], timeout=60) as idle:
        idle.sendall(b"GET / HTTP/1.1\r\nHost: ")
        assert idle.recv(1) == b""


def test_a_viewer_that_goes_away_is_counted_no_more(server: Server, capfd: pytest.CaptureFixture[str]) -> None:
    with closing(asked(server, "GET", "/events")) as stream:
        assert stream.readline() == b"retry: 1000\n"
    publish_to_nobody(server)
    assert capfd.readouterr() == ("", "")


def test_a_client_that_is_gone_before_the_answer_is_no_error(
    server: Server, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    async def nobody(*_: object) -> None:
        raise ConnectionResetError("Cannot write to closing transport")

    monkeypatch.setattr(server, "answer", nobody)
    assert asked(server, "GET", "/events").status == 500
    assert not caplog.records


@pytest.mark.parametrize("headers", [b"Content-Length: 5\r\nContent-Encoding: gzip\r\n", b"Content-Length: 9\r\n"])
def test_a_body_is_neither_unpacked_nor_waited_for(
    server: Server, headers: bytes, caplog: pytest.LogCaptureFixture
) -> None:
    with socket.create_connection(server.server_address[:2], timeout=5) as client, client.makefile("rb") as answer:
        client.sendall(b"GET /x HTTP/1.1\r\nHost: localhost\r\n" + headers + b"\r\nhello")
        assert answer.read().endswith(b"404 Not Found\n"), "and the connection has ended"
    assert not caplog.records


def test_more_connections_than_are_allowed_are_closed(server: Server, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(serving, "TIMEOUT_S", 1000.0)  # not for being idle
    with ExitStack() as connections:

        def connect(own: str) -> socket.socket:
            where = server.server_address[:2]
            return connections.enter_context(socket.create_connection(where, timeout=60, source_address=(own, 0)))

        for number in range(MOST_CONNECTIONS):
            connect(f"127.0.0.{2 + number // MOST_OF_ONE}")
        assert connect("127.0.0.1").recv(1) == b""


def test_one_address_cannot_hold_all_places(server: Server, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(serving, "TIMEOUT_S", 1000.0)
    with ExitStack() as connections:
        for _ in range(MOST_OF_ONE):
            connections.enter_context(
                socket.create_connection(server.server_address[:2], timeout=60, source_address=("127.0.0.2", 0))
            )
        with socket.create_connection(server.server_address[:2], source_address=("127.0.0.2", 0)) as one_more:
            one_more.settimeout(60)
            assert one_more.recv(1) == b""
        assert asked(server, "GET", "/").status == 200


def test_the_end_of_the_server_ends_the_streams() -> None:
    with Server("127.0.0.1", 0) as server:
        stream = asked(server, "GET", "/events")
        assert stream.readline() == b"retry: 1000\n"
    assert stream.read() == b"\n"
