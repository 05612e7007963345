"""Values that never change: what their quick constructors must have in common with those of every frozen dataclass."""

from __future__ import annotations

import copy
import inspect
import pickle
from dataclasses import FrozenInstanceError, dataclass, field, fields, is_dataclass, replace

import pytest

from fsai_vcu.interface import messages
from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.immutable import Immutable
from fsai_vcu.interface.immutable import replace as quick_replace

IMAGES = sorted(
    (
        one
        for one in vars(messages).values()
        if isinstance(one, type) and issubclass(one, Immutable) and is_dataclass(one)
    ),
    key=lambda one: one.__name__,
)


@dataclass(frozen=True, slots=True)
class Quick(Immutable):
    first: int
    second: str = "two"
    third: tuple[int, ...] = field(default_factory=tuple)


@dataclass(frozen=True, slots=True)
class Ordinary:
    first: int
    second: str = "two"
    third: tuple[int, ...] = field(default_factory=tuple)


@dataclass(frozen=True, slots=True)
class Checked(Immutable):
    share: float

    def __post_init__(self) -> None:
        if not 0.0 <= self.share <= 1.0:
            raise ValueError("a share is 0 to 1")


@pytest.mark.parametrize("made", [Frame(0x520, b"12", 3, error=True), Quick(1, third=(3,))], ids=str)
def test_what_is_made_of_all_values_equals_the_constructors(made: Immutable) -> None:
    again = type(made).of(tuple(getattr(made, one.name) for one in fields(made)))  # type: ignore[arg-type]
    assert again == made and type(again) is type(made)
    with pytest.raises(ValueError, match="unpack"):
        type(made).of(())


def test_a_copy_changes_the_named_fields_and_is_checked() -> None:
    value = Quick(1, third=(3,))
    assert quick_replace(value, second="x") == Quick(1, "x", (3,))
    assert value == Quick(1, "two", (3,))
    with pytest.raises(FrozenInstanceError):
        quick_replace(value, first=2).first = 3  # type: ignore[misc]
    with pytest.raises(AttributeError):
        quick_replace(value, fourth=4)  # type: ignore[call-arg]
    for copied in (quick_replace, replace):
        with pytest.raises(ValueError, match="a share is 0 to 1"):
            copied(Checked(0.5), share=2.0)


@pytest.mark.parametrize(
    "arguments", [((1,), {}), ((1, "x"), {}), ((), {"first": 1, "third": (3,)}), ((1, "x", ()), {})]
)
def test_a_value_is_made_as_an_ordinary_frozen_dataclass_is(arguments: tuple[tuple[int, ...], dict[str, int]]) -> None:
    args, kwargs = arguments
    quick, ordinary = Quick(*args, **kwargs), Ordinary(*args, **kwargs)  # type: ignore[arg-type]
    assert [getattr(quick, one.name) for one in fields(quick)] == [
        getattr(ordinary, one.name) for one in fields(ordinary)
    ]
    assert repr(quick) == repr(ordinary).replace("Ordinary", "Quick")
    assert type(quick) is Quick
    assert quick == Quick(*args, **kwargs)  # type: ignore[arg-type]
    assert hash(quick) == hash(ordinary)


def test_the_signature_is_the_dataclass_s() -> None:
    theirs, ours = inspect.signature(Ordinary), inspect.signature(Quick)
    assert [(p.name, p.kind, p.annotation) for p in ours.parameters.values()] == [
        (p.name, p.kind, p.annotation) for p in theirs.parameters.values()
    ]


@pytest.mark.parametrize(
    ("args", "kwargs"), [((), {}), ((1, "x", (), 4), {}), ((1,), {"fourth": 4}), ((1,), {"first": 1})]
)
def test_wrong_arguments_are_refused(args: tuple[int, ...], kwargs: dict[str, int]) -> None:
    with pytest.raises(TypeError, match=r"Quick\.__init__\(\)"):
        Quick(*args, **kwargs)  # type: ignore[arg-type]


@pytest.mark.parametrize("kind", IMAGES, ids=lambda kind: kind.__name__)
def test_no_field_of_an_image_can_be_set_or_deleted(kind: type) -> None:
    image = kind()
    for one in fields(kind):
        with pytest.raises(FrozenInstanceError):
            setattr(image, one.name, 1)
        with pytest.raises(FrozenInstanceError):
            delattr(image, one.name)


def test_copies_and_pickles_are_equal_a_deep_copy_identical() -> None:
    frame = Frame(0x520, b"\x01\x02", 7)
    assert replace(frame, t_ns=8) == Frame(0x520, b"\x01\x02", 8)
    assert copy.copy(frame) == frame
    assert pickle.loads(pickle.dumps(frame)) == frame
    assert copy.deepcopy([frame])[0] is frame
