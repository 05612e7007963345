"""Wheel sensors that are wired to the wrong inputs."""

from __future__ import annotations

import pytest

from fsai_vcu.interface.codec import Codec
from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.messages import WheelCounts, WheelSpeeds
from fsai_vcu.interface.revisions import revision
from fsai_vcu.interface.wheels import STRAIGHT, WheelMapping

CROSSED = WheelMapping(fl="rr", fr="fl", rl="fr", rr="rl")


@pytest.mark.parametrize("name", ["2021", "2026"])
def test_the_documented_wiring_is_the_default(name: str) -> None:
    codec = Codec(revision(name))
    assert codec.mapping is STRAIGHT
    assert codec.decode(Frame(0x525, bytes.fromhex("0100020003000400"))).image == WheelSpeeds(1, 2, 3, 4)


@pytest.mark.parametrize("name", ["2021", "2026"])
def test_a_mapping_assigns_each_wheel_its_signal(name: str) -> None:
    codec = Codec(revision(name), mapping=CROSSED)
    assert codec.decode(Frame(0x525, bytes.fromhex("0100020003000400"))).image == WheelSpeeds(
        fl_rpm=4, fr_rpm=1, rl_rpm=2, rr_rpm=3
    )
    assert codec.decode(Frame(0x526, bytes.fromhex("0100020003000400"))).image == WheelCounts(fl=4, fr=1, rl=2, rr=3)


def test_a_car_that_is_wired_wrongly_can_be_simulated_and_undone() -> None:
    car, ai = Codec(revision("2026"), mapping=CROSSED), Codec(revision("2026"), mapping=CROSSED)
    speeds = WheelSpeeds(10, 20, 30, 40)
    frame = car.encode(speeds)
    assert frame.data == bytes.fromhex("14001E0028000A00")
    assert ai.decode(frame).image == speeds
    assert Codec(revision("2026")).decode(frame).image == WheelSpeeds(20, 30, 40, 10)


@pytest.mark.parametrize("wrong", [{"fl": "fr"}, {"fl": "xx"}, {"fl": "fr", "fr": "fr", "rl": "rl", "rr": "rr"}])
def test_a_mapping_that_loses_a_wheel_is_refused(wrong: dict[str, str]) -> None:
    with pytest.raises(ValueError, match="must name each of fl, fr, rl, rr once"):
        WheelMapping.of(wrong)


def test_a_mapping_is_made_from_what_a_configuration_says() -> None:
    assert WheelMapping.of({}) == STRAIGHT
    assert WheelMapping.of({"fl": "FR", "fr": "fl"}) == WheelMapping(fl="fr", fr="fl")
    with pytest.raises(ValueError, match="names spare: the wheels are"):
        WheelMapping.of({"spare": "fl"})


def test_a_mapping_is_written_wheel_by_wheel() -> None:
    assert str(CROSSED) == "fl=rr,fr=fl,rl=fr,rr=rl"
