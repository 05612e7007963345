"""One turn of the loop in virtual time: what is answered, and what becomes of a cycle that does not go out whole."""

from __future__ import annotations

import pytest

from fsai_vcu.core.bridge import Bridge
from fsai_vcu.core.vehicle.parameters import CARS
from fsai_vcu.interface.codec import Codec
from fsai_vcu.interface.enums import AsState
from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.messages import VcuStatus
from fsai_vcu.interface.revisions import revision
from fsai_vcu.interface.units import MS
from fsai_vcu.runtime.bus import BusLost
from fsai_vcu.runtime.engine import Engine

REVISION = revision("2026")
CODEC = Codec(REVISION)
STATUS = CODEC.encode(VcuStatus(as_state=AsState.AS_OFF))


class Wire:
    """Where the frames go: takes `takes` more of them, then drops one after another or breaks."""

    def __init__(self) -> None:
        self.sent: list[int] = []
        self.takes: int | None = None
        self.breaks = False

    def send(self, frame: Frame) -> bool:
        if self.takes == 0:
            if self.breaks:
                raise BusLost("Network is down")
            self.sent.append(-frame.can_id)
            return False
        if self.takes is not None:
            self.takes -= 1
        self.sent.append(frame.can_id)
        return True


@pytest.fixture
def wire() -> Wire:
    return Wire()


@pytest.fixture
def bridge() -> Bridge:
    return Bridge(CODEC, REVISION, CARS["2026"])


@pytest.fixture
def engine(bridge: Bridge, wire: Wire) -> Engine:
    """One that has listened for its 200 ms and has just answered a 0x520 at 300 ms."""
    made = Engine(bridge, CODEC, wire.send, 0)
    for now_ns in range(0, 301 * MS, 10 * MS):
        made.on_frame(Frame(0x520, STATUS.data, now_ns))
        made.poll(now_ns)
    assert wire.sent[-5:] == [0x510, 0x511, 0x512, 0x513, 0x514]
    wire.sent.clear()
    return made


@pytest.mark.parametrize("kind", ["", "extended", "remote", "error"])
def test_a_0x520_is_answered_at_once_what_only_looks_so_is_not(engine: Engine, wire: Wire, kind: str) -> None:
    data = b"" if kind == "remote" else STATUS.data
    engine.on_frame(Frame(0x520, data, 310 * MS, **({kind: True} if kind else {})))  # type: ignore[arg-type]
    assert engine.poll(310 * MS) is not bool(kind)
    assert wire.sent == ([] if kind else [0x510, 0x511, 0x512, 0x513, 0x514])


def test_the_rest_of_a_cycle_that_lost_a_frame_is_not_sent(engine: Engine, bridge: Bridge, wire: Wire) -> None:
    wire.takes = 2
    assert engine.poll(315 * MS)
    assert wire.sent == [0x510, 0x511, -0x512]
    assert engine.incomplete_cycles == bridge.report(315 * MS).incomplete_cycles == 1


def test_time_without_a_complete_cycle_ends_with_the_next_one(engine: Engine, wire: Wire) -> None:
    assert engine.unsent_ns(300 * MS) == 0
    wire.takes = 0
    for now_ns in range(315 * MS, 346 * MS, 10 * MS):
        assert engine.poll(now_ns)
        assert engine.unsent_ns(now_ns) == now_ns - 300 * MS
    wire.takes = None
    assert engine.poll(355 * MS)
    assert engine.unsent_ns(355 * MS) == 0


def test_a_bus_that_never_took_a_cycle_counts_from_the_first_try(bridge: Bridge, wire: Wire) -> None:
    made = Engine(bridge, CODEC, wire.send, 0)
    wire.takes = 0
    for now_ns in range(0, 201 * MS, 10 * MS):
        made.poll(now_ns)
        assert made.unsent_ns(now_ns) == 0, "it only listens so far"
    made.poll(210 * MS)
    assert made.unsent_ns(250 * MS) == 50 * MS


def test_a_bus_that_breaks_in_the_middle_of_a_cycle_is_told_on(engine: Engine, wire: Wire) -> None:
    wire.takes, wire.breaks = 3, True
    with pytest.raises(BusLost):
        engine.poll(315 * MS)


def test_the_next_cycle_keeps_its_gap_from_the_actual_send(bridge: Bridge, wire: Wire) -> None:
    engine = Engine(bridge, CODEC, wire.send, 0, lambda: 304 * MS)
    for now_ns in range(0, 301 * MS, 10 * MS):
        engine.on_frame(Frame(0x520, STATUS.data, now_ns))
        engine.poll(now_ns)
    engine.on_frame(Frame(0x520, STATUS.data, 310 * MS))
    assert engine.due_ns() == 312 * MS
