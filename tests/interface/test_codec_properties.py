"""The codec against cantools, for every message and any content."""

from __future__ import annotations

import math
from enum import IntEnum
from operator import attrgetter
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fsai_vcu.interface.codec import Codec
from fsai_vcu.interface.enums import MissionStatus
from fsai_vcu.interface.fields import Field, Message, fields_of
from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.messages import COMMAND_FIELDS, MESSAGES, AiCommand, Faults, VcuStatus
from fsai_vcu.interface.revisions import revision

CODECS = {name: Codec(revision(name)) for name in ("2021", "2026")}
CASES = [
    pytest.param(codec, kind, id=f"{name}-{kind.dbc_name}")
    for name, codec in CODECS.items()
    for kind in MESSAGES
    if kind.dbc_name in {message.name for message in codec.database.messages}
]


def test_the_cases_cover_every_declared_message() -> None:
    assert {case.values[1] for case in CASES} == set(MESSAGES)


def expected(field: Field, value: Any) -> Any:
    if field.holds is bool:
        return bool(value)
    if issubclass(field.holds, IntEnum):
        return field.holds(value) if value in set(field.holds) else field.unknown
    return pytest.approx(value, rel=1e-9, abs=1e-12)


@pytest.mark.parametrize(("codec", "kind"), CASES)
@settings(max_examples=25)
@given(content=st.data())
def test_every_frame_decodes_as_cantools_decodes_it(codec: Codec, kind: type[Message], content: st.DataObject) -> None:
    message = codec.database.get_message_by_name(kind.dbc_name)
    data = content.draw(st.binary(min_size=message.length, max_size=message.length))
    decoded = codec.decode(Frame(message.frame_id, data, t_ns=5))
    by_cantools: Any = message.decode(data, decode_choices=False)
    values = {name.removesuffix("_Nm"): value for name, value in by_cantools.items()}
    if decoded.image is None:
        assert decoded.problems
        return
    assert type(decoded.image) is kind
    assert decoded.image.t_rx_ns == 5
    for field in fields_of(kind):
        if field.signal in values:
            assert attrgetter(field.name)(decoded.image) == expected(field, values[field.signal])
        else:
            assert field.absent is not None
    if isinstance(decoded.image, VcuStatus):
        assert decoded.handshake is decoded.image.handshake


def in_range(codec: Codec, kind: type[Message], field: Field) -> st.SearchStrategy[Any]:
    message = codec.database.get_message_by_name(kind.dbc_name)
    signal = {one.name.removesuffix("_Nm"): one for one in message.signals}.get(field.signal)
    if field.holds is bool:
        return st.booleans()
    if issubclass(field.holds, IntEnum):
        return st.sampled_from(list(field.holds)) if signal else st.none()
    assert signal is not None
    if signal.is_float:
        return st.floats(width=32, allow_nan=False, allow_infinity=False)
    low, high = signal.minimum or 0, signal.maximum or 0
    if field.holds is int:
        return st.integers(math.ceil(low), math.floor(high))
    return st.floats(float(low), float(high))


@pytest.mark.parametrize(("codec", "kind"), CASES)
@settings(max_examples=20)
@given(content=st.data())
def test_every_value_in_range_survives_the_wire(codec: Codec, kind: type[Message], content: st.DataObject) -> None:
    """To half a step; what has been on the wire once is exact from then on, and cantools writes the same bytes."""
    fields = fields_of(kind)
    values = {field.name: content.draw(in_range(codec, kind, field), label=field.name) for field in fields}
    own = {name: value for name, value in values.items() if "." not in name}
    if kind is VcuStatus:
        own["faults"] = Faults(**{name[7:]: value for name, value in values.items() if name.startswith("faults.")})
    image: Any = kind(**own)
    frame = codec.encode(image)
    decoded = codec.decode(frame)
    assert decoded.problems == ()
    message = codec.database.get_message_by_name(kind.dbc_name)
    steps = {signal.name.removesuffix("_Nm"): signal.scale for signal in message.signals}
    for field in fields:
        sent, received = values[field.name], attrgetter(field.name)(decoded.image)
        if isinstance(sent, float):
            assert received == pytest.approx(sent, rel=1e-6, abs=steps[field.signal] * 0.5001)
        else:
            assert received == sent
    assert decoded.image is not None
    assert codec.encode(decoded.image).data == frame.data
    by_cantools = message.encode(message.decode(frame.data, decode_choices=False), strict=False, padding=False)
    assert by_cantools == frame.data


COMMANDS = st.builds(
    AiCommand,
    handshake=st.booleans(),
    estop_request=st.booleans(),
    mission_status=st.sampled_from(MissionStatus),
    steer_deg=st.floats(-35.0, 35.0) | st.just(math.nan),
    front_torque_nm=st.floats(-1.0, 200.0),
    rear_torque_nm=st.floats(0.0, 195.0),
    front_motor_speed_max_rpm=st.integers(0, 4100),
    rear_brake_pct=st.floats(0.0, 101.0) | st.just(math.inf),
    cones_count_all=st.integers(0, 100_000),
)


@pytest.mark.parametrize("codec", CODECS.values(), ids=CODECS)
@settings(max_examples=75)
@given(command=COMMANDS)
def test_a_command_is_encoded_or_refused_as_its_messages_are(codec: Codec, command: AiCommand) -> None:
    def attempt(encode: Any) -> Any:
        try:
            return list(encode())
        except ValueError as error:
            return str(error)

    messages: list[Any] = [
        kind(**{ours: getattr(command, theirs) for ours, theirs in names.items()})
        for kind, names in COMMAND_FIELDS.items()
    ]
    assert attempt(lambda: codec.encode_command(command)) == attempt(lambda: [codec.encode(one) for one in messages])


@settings(max_examples=150)
@given(
    frame=st.builds(
        Frame,
        can_id=st.sampled_from([*range(0x500, 0x530), *range(0x600, 0x650), 0x120]) | st.integers(0, 0x1FFF_FFFF),
        data=st.binary(max_size=64),
        t_ns=st.integers(0, 2**62),
        extended=st.booleans(),
        remote=st.booleans(),
        error=st.booleans(),
    )
)
def test_no_frame_whatever_makes_the_decoder_raise(frame: Frame) -> None:
    for codec in CODECS.values():
        decoded = codec.decode(frame)
        assert decoded.image is None or not decoded.problems or frame.can_id in (0x520, 0x524)
