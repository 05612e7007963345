"""Values: they never change, and what is copied, pickled or hashed of them behaves as the whole project takes it to."""

from __future__ import annotations

import copy
import pickle

import pytest
from msgspec.structs import replace

from fsai_vcu.interface import messages
from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.values import Value

IMAGES = sorted(
    (
        one
        for one in vars(messages).values()
        if isinstance(one, type) and issubclass(one, Value) and one.__struct_fields__
    ),
    key=lambda one: one.__name__,
)


class Checked(Value, frozen=True):
    share: float

    def __post_init__(self) -> None:
        if not 0.0 <= self.share <= 1.0:
            raise ValueError("a share is 0 to 1")


@pytest.mark.parametrize(
    "kind", [one for one in IMAGES if one.__module__ == messages.__name__], ids=lambda one: one.__name__
)
def test_no_field_of_an_image_can_be_set_or_deleted(kind: type[Value]) -> None:
    image = kind()
    for name in kind.__struct_fields__:
        with pytest.raises(AttributeError, match="immutable"):
            setattr(image, name, 1)
        with pytest.raises(AttributeError, match="immutable"):
            delattr(image, name)


def test_a_copy_changes_the_named_fields_and_is_checked() -> None:
    frame = Frame(0x520, b"\x01\x02", 7)
    assert replace(frame, t_ns=8) == Frame(0x520, b"\x01\x02", 8)
    assert frame.t_ns == 7
    with pytest.raises(TypeError, match="no field"):
        replace(frame, fourth=4)
    with pytest.raises(ValueError, match="a share is 0 to 1"):
        replace(Checked(0.5), share=2.0)


def test_copies_and_pickles_are_equal_a_deep_copy_identical() -> None:
    frame = Frame(0x520, b"\x01\x02", 7)
    assert copy.copy(frame) == frame
    assert pickle.loads(pickle.dumps(frame)) == frame
    assert hash(frame) == hash(Frame(0x520, b"\x01\x02", 7))
    assert copy.deepcopy([frame])[0] is frame
