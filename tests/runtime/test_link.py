"""The link between edge and loop: whatever is said on it ends nothing, holds up nothing, and the brake arrives."""

from __future__ import annotations

import enum
import math
import os
import select
import socket
from collections.abc import Callable, Iterator
from itertools import product
from pathlib import Path
from types import UnionType
from typing import Any

import msgspec
import pytest
from loop_rig import CODEC, REVISION, WAIT_S, ThreadedLoop, eventually
from msgspec import inspect

from fsai_vcu.core.bridge import Bridge
from fsai_vcu.core.command import VehicleCommand
from fsai_vcu.core.supervision.config import BridgeConfig
from fsai_vcu.core.supervision.supervisor import SupervisorState, set_mode
from fsai_vcu.core.vehicle.parameters import CARS
from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.values import Value, shortened
from fsai_vcu.runtime.link import (
    LARGEST_BYTES,
    Alive,
    Answer,
    Ask,
    Ended,
    LinkEnd,
    LogLine,
    LoopReport,
    LoopSettings,
    Message,
    ResetConfirmed,
    _datagram,
    link_pair,
)
from fsai_vcu.runtime.loop_handle import LoopError, start_loop_process

WIDEST = "\U0010ffff"  # four bytes in UTF-8
EMERGENCY = Ask(7, "emergency_brake", "smoke", 0, True)
ODD_TEXTS = {
    "huge": "m" * 300_000,
    "control characters": "\x02" * 90_000,
    "lone surrogate": "\ud800",
    "null": "\0",
    "widest": WIDEST * 100_000,
}


@pytest.fixture
def ends() -> Iterator[tuple[LinkEnd, LinkEnd]]:
    edge, loop = (LinkEnd(lanes) for lanes in link_pair())
    yield edge, loop
    edge.close()
    loop.close()


def test_the_last_word_of_an_end_that_closes_is_read(ends: tuple[LinkEnd, LinkEnd]) -> None:
    edge, loop = ends

    class Before:
        """The urgent lane; when it has been read, the far end says its last word and closes."""

        def __init__(self, lane: socket.socket) -> None:
            self._lane = lane

        def __getattr__(self, name: str) -> Any:
            return getattr(self._lane, name)

        def recv_into(self, buffer: Any) -> int:
            try:
                return self._lane.recv_into(buffer)
            finally:
                loop.send(Ended("RuntimeError: a bug"))
                loop.close()

    lanes: Any = edge._lanes
    edge._lanes = lanes._replace(urgent=Before(lanes.urgent))
    assert edge.receive() == [Ended("RuntimeError: a bug")]
    assert edge.closed


@pytest.fixture
def loop(spec: str) -> Iterator[ThreadedLoop]:
    running = ThreadedLoop(spec)
    running.start()
    yield running
    running.stop()


def report() -> LoopReport:
    return LoopReport(Bridge(CODEC, REVISION, CARS["2026"]).report(0))


def fill(end: LinkEnd, message: Message) -> int:
    """Send until there is no room; how many were sent."""
    sent = 0
    while end.send(message):
        sent += 1
    return sent


# ---------------------------------------------------------------- bounds


def largest(kind: inspect.Type, path: str) -> Any:
    """The largest legal value of a type; an assertion names the field that has no bound."""
    match kind:
        case inspect.StrType(max_length=length):
            assert length is not None, f"{path}: a text without a bound"
            return WIDEST * length
        case inspect.IntType(le=most):
            return 2**63 - 1 if most is None else most
        case inspect.FloatType():
            return math.pi
        case inspect.BoolType():
            return True
        case inspect.NoneType():
            return None
        case inspect.EnumType(cls=members):
            return max(members, key=lambda member: member.value)
        case inspect.LiteralType(values=values):
            return max(values, key=len)
        case inspect.VarTupleType(item_type=item, max_length=length):
            assert length is not None, f"{path}: a list without a bound"
            return (largest(item, f"{path}[]"),) * length
        case inspect.DictType(key_type=key, value_type=value, max_length=length):
            assert length is not None, f"{path}: a mapping without a bound"
            entry, widest = largest(value, f"{path}{{}}"), largest(key, f"{path} key")
            if isinstance(widest, int):
                return {widest - n: entry for n in range(length)}
            return {widest[:-1] + chr(0x10000 + n): entry for n in range(length)}
        case inspect.UnionType(types=types):
            return max((largest(each, path) for each in types), key=lambda value: len(msgspec.msgpack.encode(value)))
        case inspect.StructType(cls=cls, fields=fields):
            return bare(cls, {field.name: largest(field.type, f"{path}.{field.name}") for field in fields})
    raise AssertionError(f"{path}: {kind} has no bound that this test knows")


class _Checks(enum.Enum):
    WHEELS = "WheelMapping"
    CONFIG = "BridgeConfig"


def bare(cls: type, values: dict[str, Any]) -> Any:
    """A value with these fields, whatever its own constructor would say to them: its bytes are what counts."""
    if cls.__name__ in (_Checks.WHEELS.value, _Checks.CONFIG.value):
        return cls()
    return cls(**values)


MESSAGES = sorted(Message.__args__, key=lambda kind: kind.__name__) if isinstance(Message, UnionType) else []


@pytest.mark.parametrize("kind", MESSAGES, ids=lambda kind: kind.__name__)
def test_the_largest_legal_message_of_each_kind_arrives(kind: type[Value], ends: tuple[LinkEnd, LinkEnd]) -> None:
    message = largest(inspect.type_info(kind), kind.__name__)
    edge, loop = ends
    assert loop.send(message), loop.refusal
    assert edge.receive() == [message]
    assert len(msgspec.msgpack.encode(message)) < LARGEST_BYTES


def test_the_bounds_hold_whatever_the_core_is_told() -> None:
    bridge = Bridge(CODEC, REVISION, CARS["2026"])
    for number in range(300):
        for odd in ODD_TEXTS.values():
            bridge.tally.problem(f"{number} {odd}")
            bridge.on_reset_confirmed(odd, number)
        bridge.on_frame(Frame(number, b"\xff" * 9, number))
        bridge.on_frame(Frame(0x510 + number % 5, b"\xff" * 8, number))
    for odd in ODD_TEXTS.values():
        bridge.loop_fault(odd, 1)
        bridge.on_command(VehicleCommand(0, 1, 1e308, -1e308, math.nan, math.inf, note=odd), 1)
        bridge.on_command(VehicleCommand(2**62, 1, 1e308, -1e308, 1e308, -1e308), 1)
        assert len(bridge.set_mode(odd, 1)[1]) < 1000
        bridge.emergency_brake(odd, 1)
        bridge.bus_lost(odd, 1)
    edge, loop = (LinkEnd(lanes) for lanes in link_pair())
    assert loop.send(LoopReport(bridge.report(2)))
    (arrived,) = edge.receive()
    assert isinstance(arrived, LoopReport) and arrived.bridge == bridge.report(2)
    assert edge.trouble.undecoded == 0


@pytest.mark.parametrize("odd", ODD_TEXTS.values(), ids=ODD_TEXTS)
def test_what_is_kept_of_a_text_is_short_and_can_be_sent(odd: str) -> None:
    kept = shortened(odd, 20)
    assert len(kept) <= 20
    assert kept.encode()
    assert shortened("as it was, ä", 20) == "as it was, ä"


# ---------------------------------------------------------------- what cannot be sent


@pytest.mark.parametrize("odd", [text for text in ODD_TEXTS.values() if len(text) != 1 or text == "\ud800"])
@pytest.mark.parametrize(
    "made",
    [
        lambda text: Ask(1, "set_mode", text, 0, False),
        lambda text: ResetConfirmed(text, 1),
        lambda text: VehicleCommand(0, 1, note=text),
        lambda text: Answer(1, False, text),
    ],
    ids=["set_mode", "ResetConfirmed", "VehicleCommand", "Answer"],
)
def test_what_cannot_be_sent_is_refused_and_nothing_waits_for_it(
    made: Callable[[str], Message], odd: str, ends: tuple[LinkEnd, LinkEnd]
) -> None:
    edge, loop = ends
    assert not edge.send(made(odd))
    assert "cannot be sent" in edge.refusal and len(edge.refusal) < 200
    assert edge.trouble.refused == 1
    assert edge.send(EMERGENCY) and edge.send(Alive())
    assert loop.receive() == [EMERGENCY, Alive()]


@pytest.mark.parametrize("number", [2**63, 2**64, 10**30, -(2**63) - 1])
def test_an_integer_beyond_64_bits_is_refused(number: int, ends: tuple[LinkEnd, LinkEnd]) -> None:
    edge, loop = ends
    assert not edge.send(ResetConfirmed("planner", number)) and edge.refusal
    assert not edge.send(VehicleCommand(number, 1)) and edge.refusal
    assert not edge.send(Ask(1, "activate", number, 0, True)) and edge.refusal
    assert loop.receive() == []


def test_something_that_is_no_message_is_refused(ends: tuple[LinkEnd, LinkEnd]) -> None:
    edge, loop = ends
    for odd in (
        object(),
        None,
        3,
        "text",
        Frame(1),
        Ask(1, "dance", None, 0, True),
        Ask(1, "reset", object(), 0, True),
    ):  # type: ignore[arg-type]
        assert not edge.send(odd)  # type: ignore[arg-type]
    assert loop.receive() == [] and loop.trouble.undecoded == 0


def test_numbers_that_are_none_arrive_for_the_core_to_refuse(ends: tuple[LinkEnd, LinkEnd]) -> None:
    edge, loop = ends
    assert edge.send(VehicleCommand(0, 1, math.nan, math.inf, -math.inf))
    (command,) = loop.receive()
    assert isinstance(command, VehicleCommand) and len(command.problems(1.0)) == 3


def test_an_answer_does_not_repeat_a_mode_without_a_bound(ends: tuple[LinkEnd, LinkEnd]) -> None:
    edge, loop = ends
    for odd in ODD_TEXTS.values():
        _, done, words = set_mode(BridgeConfig(), SupervisorState(), odd, 0)
        assert not done and words.startswith("unknown mode")
        assert loop.send(Answer(1, done, shortened(words)))
        assert isinstance(edge.receive()[0], Answer)


# ---------------------------------------------------------------- what cannot be decoded


def junk() -> Iterator[bytes]:
    for size in (0, 1, 2, 50, 5000, 190_000, 200_500):
        yield os.urandom(size)
    report_bytes = _datagram(report())
    yield report_bytes[:-3]
    yield b"R"
    yield b"M"
    yield b"M" + b"\x91" * 100_000  # deep
    yield b"M\xdd\xff\xff\xff\xff"  # a list of four thousand million
    yield b"M" + msgspec.msgpack.encode({"type": "Ask", "number": 1, "what": "set_mode", "argument": "m" * 100_000})
    yield b"M" + msgspec.msgpack.encode({"type": "ResetConfirmed", "role": "\x01" * 65, "run_id": 1})
    yield b"M" + msgspec.msgpack.encode({"type": "Ended", "failure": None})
    yield b"M" + msgspec.msgpack.encode(Answer(1, True, "x")).replace(b"\xa1x", b"\xa1\xff")  # not UTF-8


def put(lane: socket.socket, datagram: bytes, then: Callable[[], object] = lambda: None) -> None:
    """Put it on the lane as soon as there is room for it."""

    def sent() -> bool:
        try:
            lane.send(datagram)
        except BlockingIOError:
            return False
        finally:
            then()
        return True

    assert eventually(sent)


def test_what_is_no_message_is_dropped_counted_and_named(ends: tuple[LinkEnd, LinkEnd]) -> None:
    edge, loop = ends
    for number, (lane, datagram) in enumerate(product(edge._lanes, junk()), 1):
        put(lane, datagram, then=loop.receive)
        assert edge.send(EMERGENCY) and edge.send(Alive())
        assert loop.receive() == [EMERGENCY, Alive()], datagram[:40]
        assert not loop.closed
        assert loop.trouble.undecoded == number
        assert loop.trouble.words and len(loop.trouble.words) <= 160
    assert loop.send(LoopReport(report().bridge, link=loop.trouble)), "the count reaches the other end"
    (arrived,) = edge.receive()
    assert isinstance(arrived, LoopReport) and arrived.link == loop.trouble


def test_a_running_loop_survives_every_datagram_and_reports_it(loop: ThreadedLoop) -> None:
    for lane, datagram in product(loop._link._lanes, junk()):
        put(lane, datagram)
    # Of several that look like reports only the newest is looked at.
    assert eventually(lambda: loop.loop_report().link.undecoded >= len(list(junk())))
    assert loop.running and not loop.failure
    assert loop.link_trouble()["loop: messages not understood"] and loop.link_trouble()["loop: newest trouble"]
    assert loop.emergency_brake("smoke") == (True, "ESTOP_REQUEST is latched")


def test_an_edge_survives_every_datagram_of_its_loop(loop: ThreadedLoop) -> None:
    for lane, datagram in product(loop.far_end._lanes, junk()):
        put(lane, datagram, then=lambda: loop.running)
    assert loop.emergency_brake("smoke") == (True, "ESTOP_REQUEST is latched")
    # The answer comes by the urgent lane: what lies on the other one may still have to be read.
    assert eventually(lambda: loop.link_trouble()["node: messages not understood"] == 2 * len(list(junk())))
    assert loop.running


def test_the_loops_process_survives_every_datagram(tmp_path: Path) -> None:
    handle = start_loop_process("loopback:junk")
    try:
        for lane, datagram in product(handle._link._lanes, junk()):
            put(lane, datagram)
        for strange in (
            LoopSettings("loopback:junk", "1999", "2026"),
            LoopSettings("loopback:junk", "2026", "2026", dbc_files=(str(tmp_path / "absent"),)),
            LoopSettings("loopback:junk", "2026", "2026", dbc_files=("x" * 5000,)),
        ):
            with pytest.raises(LoopError):
                handle.configure(strange)
        handle.configure(LoopSettings("loopback:junk", "2026", "1999", real_time=False))
        with pytest.raises(LoopError, match="1999"):
            handle.activate(1)
        handle.configure(LoopSettings("loopback:junk", "2026", "2026", real_time=False))
        handle.activate(1)
        assert handle.running
    finally:
        handle.close()


# ---------------------------------------------------------------- a full lane, and a blocked one


@pytest.mark.parametrize("what", ["emergency_brake", "reset", "deactivate"])
def test_what_stops_the_car_arrives_before_a_lane_that_is_full(what: Any, ends: tuple[LinkEnd, LinkEnd]) -> None:
    edge, loop = ends
    assert fill(edge, VehicleCommand(0, 1, note="n" * 160)) > 10
    assert not edge.send(Ask(1, "set_mode", "manual", 0, False)) and edge.refusal == ""
    asked = Ask(2, what, None, 0, True)
    assert edge.send(asked)
    assert fill(loop, report()) > 2
    assert loop.send(Answer(2, True, "done")), "the loop's reports are blocked; its answer is not"
    assert loop.send(Ended("it broke"))
    assert loop.receive()[0] == asked
    assert edge.receive()[:2] == [Answer(2, True, "done"), Ended("it broke")]
    assert edge.trouble.dropped == 2 and loop.trouble.dropped == 1


def test_the_emergency_brake_is_answered_past_blocked_lanes(
    loop: ThreadedLoop, monkeypatch: pytest.MonkeyPatch
) -> None:
    # The edge does not read: its lane fills with reports.
    assert eventually(lambda: loop.far_end.trouble.dropped > 0)
    # The loop does not get at the other lane either: it is always full.
    filler = Ask(99, "set_mode", "nonsense", 0, False)
    monkeypatch.setattr(loop._link, "receive", _full_again(loop._link, filler))
    assert loop.emergency_brake("smoke") == (True, "ESTOP_REQUEST is latched")
    assert loop.reset()[1] != "the CAN loop does not answer"
    assert loop.deactivate()


def _full_again(link: LinkEnd, message: Message) -> Callable[[], list[Message]]:
    receive = link.receive

    def full() -> list[Message]:
        while link._lanes.ordinary.fileno() >= 0 and link.send(message):
            pass
        return receive()

    return full


def test_a_flood_is_read_turn_by_turn(ends: tuple[LinkEnd, LinkEnd]) -> None:
    edge, loop = ends
    sent = fill(edge, Alive())
    found = []
    while messages := loop.receive():
        assert len(messages) <= 256
        found += messages
    assert len(found) == sent


def test_the_other_sides_end_is_seen_after_what_had_come(ends: tuple[LinkEnd, LinkEnd]) -> None:
    edge, loop = ends
    loop.send(report())
    loop.send(Ended("it broke"))
    loop.close()
    select.select(edge.descriptors, [], [], WAIT_S)
    first, last = edge.receive()
    assert (first, type(last)) == (Ended("it broke"), LoopReport)
    assert edge.closed and not edge.send(Alive())


def test_a_log_line_of_any_length_arrives(loop: ThreadedLoop) -> None:
    assert loop.far_end.send(LogLine("fsai_vcu.test", 30, shortened("x" * 100_000, 8000)))
    assert loop.running
