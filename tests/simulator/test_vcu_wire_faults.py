"""Faults on the wire, by themselves and between the VCU and the AI computer."""

from __future__ import annotations

import pytest
from vcu_bench import Bench, codec

from fsai_hil.simulator.faults import (
    Delay,
    Drop,
    FaultyWire,
    FlipBits,
    FrameFault,
    Freeze,
    Repeat,
    WrongLength,
    WrongValues,
)
from fsai_vcu.interface.enums import AsState
from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.messages import VcuStatus, WheelSpeeds
from fsai_vcu.interface.units import MS, S

ALL: frozenset[int] = frozenset()
SPEEDS = frozenset({0x525})


def frames(can_id: int, count: int, period_ns: int = 10 * MS) -> list[Frame]:
    return [Frame(can_id, bytes([n]), n * period_ns) for n in range(count)]


def test_a_fault_meets_only_the_ids_that_it_names_or_all() -> None:
    sent = [*frames(0x520, 2), *frames(0x525, 2)]
    named = FaultyWire([Drop(SPEEDS)]).through(sent, S)
    assert {frame.can_id for frame in named} == {0x520}
    assert FaultyWire([Drop(ALL)]).through(sent, S) == []


def test_dropping_by_chance_follows_its_seed() -> None:
    sent = frames(0x520, 200)
    one, same, other = (FaultyWire([Drop(ALL, probability=0.3, seed=seed)]).through(sent, 10 * S) for seed in (1, 1, 2))
    assert one == same != other
    assert 100 < len(one) < 180


def test_a_delayed_frame_is_not_overtaken_by_its_id() -> None:
    wire = FaultyWire([late := Delay(ALL, delay_ns=30 * MS)])
    assert wire.through(frames(0x520, 3), 20 * MS) == []
    late.delay_ns = 0
    later = wire.through([Frame(0x520, b"\x03", 30 * MS)], 30 * MS)
    assert [(frame.t_ns // MS, frame.data[0]) for frame in later] == [(30, 0)]
    rest = wire.through([], S)
    assert [(frame.t_ns // MS, frame.data[0]) for frame in rest] == [(40, 1), (50, 2), (50, 3)]


def test_jitter_stays_within_its_bound_and_keeps_the_order() -> None:
    wire = FaultyWire([Delay(ALL, delay_ns=MS, jitter_ns=20 * MS, seed=3)])
    arrived = wire.through(frames(0x520, 100), 10 * S)
    assert [frame.data[0] for frame in arrived] == list(range(100))
    assert all(MS <= frame.t_ns - n * 10 * MS <= 21 * MS for n, frame in enumerate(arrived))


@pytest.mark.parametrize(
    ("faults", "payloads"),
    [
        ([], [b"\x0f\xf0"]),
        ([FlipBits(ALL, mask=b"\x01")], [b"\x0e\xf0"]),
        ([FlipBits(ALL, mask=b"\xff\xff\xff")], [b"\xf0\x0f"]),
        ([WrongLength(ALL, length=1)], [b"\x0f"]),
        ([WrongLength(ALL, length=4)], [b"\x0f\xf0\0\0"]),
        ([Repeat(ALL, times=3)], [b"\x0f\xf0"] * 3),
    ],
)
def test_bits_flip_lengths_change_and_frames_repeat(faults: list[FrameFault], payloads: list[bytes]) -> None:
    assert [frame.data for frame in FaultyWire(faults).through([Frame(0x520, b"\x0f\xf0", 0)], 0)] == payloads


def test_wrong_values_are_written_by_the_fields_of_the_image() -> None:
    wire = FaultyWire([WrongValues(SPEEDS, codec("2021"), {"fl_rpm": 999})])
    sent = codec("2021").encode(WheelSpeeds(1, 2, 3, 4, 5))
    (arrived,) = wire.through([sent], S)
    assert codec("2021").decode(arrived).image == WheelSpeeds(999, 2, 3, 4, 5)


def test_faults_add_up_in_their_order_and_can_be_taken_away() -> None:
    wire = FaultyWire()
    freeze, flip = Freeze(ALL), FlipBits(ALL, mask=b"\x80")
    wire.faults.append(freeze)
    wire.faults.append(flip)
    assert [frame.data[0] for frame in wire.through(frames(0x520, 3), S)] == [0x80] * 3
    wire.faults.remove(freeze)
    assert [frame.data[0] for frame in wire.through(frames(0x520, 2), S)] == [0x80, 0x81]
    wire.faults.remove(flip)
    assert [frame.data[0] for frame in wire.through(frames(0x520, 2), S)] == [0, 1]


# ---------------------------------------------------------------- on the VCU


@pytest.mark.parametrize("late_ms", [0, 7])
def test_each_cycle_has_a_response_time_with_the_wires_delay(late_ms: int) -> None:
    bench = Bench().power_up()
    bench.answer_ns = 2 * MS
    bench.vcu.incoming.faults.append(Delay(ALL, delay_ns=late_ms * MS))
    bench.run(100 * MS)
    del bench.vcu.response_times_ns[:]
    bench.run(S)
    assert bench.vcu.response_times_ns == [(2 + late_ms) * MS] * 100


def test_a_frozen_status_freezes_the_handshake_and_stops_the_car() -> None:
    bench = Bench().to_driving()
    bench.vcu.outgoing.faults.append(Freeze(frozenset({0x520})))
    bench.run(S)
    assert bench.state is AsState.EMERGENCY_BRAKE
    assert bench.images(VcuStatus)[-1].as_state is AsState.AS_DRIVING
