"""The compiled codec against cantools, for every message and any content."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fsai_vcu.interface.codec import Codec
from fsai_vcu.interface.enums import MissionStatus
from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.images import AiCommand, AiStatus, Faults, VcuStatus
from fsai_vcu.interface.revisions import revision
from fsai_vcu.interface.signals import Field, Kind, Row, rows
from fsai_vcu.interface.wheels import STRAIGHT

CODECS = {name: Codec(revision(name)) for name in ("2021", "2026")}
CASES = [
    pytest.param(codec, row, id=f"{name}-{row.message}")
    for name, codec in CODECS.items()
    for row in rows(STRAIGHT)
    if row.message in {message.name for message in codec.database.messages}
]


def signals_of(codec: Codec, row: Row, data: bytes) -> dict[str, Any]:
    """Physical values as cantools reads them, by the names that the table of fields has."""
    message = codec.database.get_message_by_name(row.message)
    values = message.decode(data, decode_choices=False)
    assert isinstance(values, dict)
    return {name.removesuffix("_Nm"): value for name, value in values.items()}


def expected(field: Field, value: Any) -> Any:
    if field.kind is Kind.FLAG:
        return bool(value)
    if field.kind is Kind.CHOICE:
        assert field.choices is not None
        return field.choices(value) if value in set(field.choices) else field.unknown
    return pytest.approx(value, rel=1e-9, abs=1e-12)


@pytest.mark.parametrize(("codec", "row"), CASES)
@settings(max_examples=60, deadline=None)
@given(content=st.data())
def test_every_frame_decodes_as_cantools_decodes_it(codec: Codec, row: Row, content: st.DataObject) -> None:
    message = codec.database.get_message_by_name(row.message)
    data = content.draw(st.binary(min_size=message.length, max_size=message.length))
    decoded = codec.decode(Frame(message.frame_id, data, t_ns=5))
    values = signals_of(codec, row, data)
    if decoded.image is None:
        assert decoded.problems
        return
    assert type(decoded.image) is row.image
    assert decoded.image.t_rx_ns == 5
    for field in row.fields:
        found = getattr(decoded.image, field.name)
        if field.signal in values:
            assert found == expected(field, values[field.signal])
        else:
            assert field.optional
    if isinstance(decoded.image, VcuStatus):
        assert decoded.handshake is decoded.image.handshake
        for field in row.faults:
            assert getattr(decoded.image.faults, field.name) is bool(values[field.signal])


def in_range(codec: Codec, row: Row, field: Field) -> st.SearchStrategy[Any]:
    signals = {
        signal.name.removesuffix("_Nm"): signal for signal in codec.database.get_message_by_name(row.message).signals
    }
    signal = signals.get(field.signal)
    if field.kind is Kind.FLAG:
        return st.booleans()
    if field.kind is Kind.CHOICE:
        assert field.choices is not None
        return st.sampled_from(list(field.choices)) if signal else st.none()
    assert signal is not None
    if signal.is_float:
        return st.floats(width=32, allow_nan=False, allow_infinity=False)
    low, high = signal.minimum or 0, signal.maximum or 0
    if field.kind is Kind.WHOLE:
        return st.integers(math.ceil(low), math.floor(high))
    return st.floats(float(low), float(high))


@pytest.mark.parametrize(("codec", "row"), CASES)
@settings(max_examples=40, deadline=None)
@given(content=st.data())
def test_every_value_in_range_survives_the_wire_within_half_a_step(
    codec: Codec, row: Row, content: st.DataObject
) -> None:
    values = {field.name: content.draw(in_range(codec, row, field), label=field.name) for field in row.fields}
    if row.faults:
        values["faults"] = Faults(**{field.name: content.draw(st.booleans()) for field in row.faults})
    image = row.image(**values)
    frame = codec.encode(image)
    decoded = codec.decode(frame)
    assert decoded.problems == ()
    message = codec.database.get_message_by_name(row.message)
    steps = {signal.name.removesuffix("_Nm"): signal.scale for signal in message.signals}
    for field in dataclasses.fields(image):
        sent, heard = values.get(field.name), getattr(decoded.image, field.name)
        if field.name in values and isinstance(sent, float):
            signal = next(one.signal for one in row.fields if one.name == field.name)
            assert heard == pytest.approx(sent, rel=1e-6, abs=steps[signal] * 0.5001)
        elif field.name in values:
            assert heard == sent
    # What has been on the wire once is exact from then on, and cantools writes the same bytes.
    assert decoded.image is not None
    again = codec.encode(decoded.image)
    assert again.data == frame.data
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
@settings(max_examples=150, deadline=None)
@given(command=COMMANDS)
def test_a_command_goes_out_as_its_five_images_would_or_is_refused_as_they_are(
    codec: Codec, command: AiCommand
) -> None:
    def attempt(encode: Any) -> Any:
        try:
            return list(encode())
        except ValueError as error:
            return str(error)

    assert attempt(lambda: codec.encode_command(command)) == attempt(
        lambda: [codec.encode(image) for image in command.images()]
    )


@settings(max_examples=300, deadline=None)
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


def test_the_property_covers_every_message_that_has_an_image() -> None:
    covered = {case.values[1].image for case in CASES}  # type: ignore[union-attr]
    assert AiStatus in covered
    assert covered == {row.image for row in rows(STRAIGHT)}
