"""Attacks made of the definitions of ROS messages: each field with each bad value there is for its type.

for attack in attacks(VehicleState, good): publish(attack.data)
"""

from __future__ import annotations

import math
import random
import re
import sys
from collections.abc import Callable, Iterator, Sequence
from copy import deepcopy
from dataclasses import dataclass
from importlib import import_module
from typing import Any

from rclpy.serialization import serialize_message

FLOAT32_MAX = 3.402823466e38  # what the messages' own checks let through
MEGABYTE = 1_000_000
MANY = 100_000
MANY_NESTED = 2_000  # of messages that hold messages: to make 100,000 of them takes minutes
_MARK = "NOTUTF8!"
_CONTROL = "\x00\x07\x1b[2J\r\n\t\x7f"


@dataclass(frozen=True)
class Attack:
    """`field` by its dotted path, `what` is put into it; `message`, or the bytes of what no message can hold."""

    field: str
    what: str
    message: Any
    raw: bytes | None = None
    not_finite: bool = False
    huge: bool = False

    @property
    def data(self) -> bytes:
        return serialize_message(self.message) if self.raw is None else self.raw

    def __str__(self) -> str:
        return f"{type(self.message).__name__}.{self.field} = {self.what}"


def class_of(name: str) -> type[Any]:
    """The class of 'fsai_msgs/ConeArray', 'fsai_msgs/SetMode_Request' or 'fsai_msgs/RunMission_Goal'."""
    package, _, kind = name.partition("/")
    outer, _, part = kind.partition("_")
    if not part:
        found: type[Any] = getattr(import_module(f"{package}.msg"), kind)
        return found
    module = "action" if part == "Goal" else "srv"
    return getattr(getattr(import_module(f"{package}.{module}"), outer), part)  # type: ignore[no-any-return]


def floats(big: float, *, few: bool) -> dict[str, float]:
    values = {"nan": math.nan, "inf": math.inf, "the largest": big, "-0.0": -0.0}
    if not few:
        small = 5e-324 if big > FLOAT32_MAX else 1e-45
        values |= {"-inf": -math.inf, "the most negative": -big, "a denormal": small, "1e30": 1e30}
    return values


def values_of(kind: str, *, few: bool) -> dict[str, Any]:
    """Bad values by their name, of a field of that type."""
    if kind in ("double", "float"):
        return floats(sys.float_info.max if kind == "double" else FLOAT32_MAX, few=few)
    if match := re.fullmatch(r"(u?)int(\d+)", kind):
        unsigned, bits = bool(match[1]), int(match[2])
        low, high = (0, 2**bits - 1) if unsigned else (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)
        return {str(low): low, str(high): high} | ({} if few else {"1": 1, str(high // 2): high // 2})
    if kind == "string":
        texts = {"empty": "", "control characters": _CONTROL, "1 MB": "A" * MEGABYTE}
        return texts | ({} if few else {"a line": "a line like any other", "300 kB": "\x01" * 300_000, "🏎": "🏎" * 300})
    if kind == "boolean":
        return {"true": True, "false": False}
    if kind == "octet":
        return {"0xff": b"\xff"}
    raise NotImplementedError(kind)


def attacks(kind: type[Any], good: Callable[[], Any] | None = None, *, few: bool = True) -> Iterator[Attack]:
    """Each field alone, in a message that is otherwise as `good` makes it."""
    make = good or kind
    for path, type_name in paths(kind):
        field = ".".join(each for each in path if each != "0")
        if type_name.startswith(("sequence<", "[")):
            yield from _arrays(make, path, field, type_name)
            continue
        for what, value in values_of(type_name, few=few).items():
            message = _with(make(), path, value)
            finite = not isinstance(value, float) or math.isfinite(value)
            huge = isinstance(value, str) and len(value) > 100_000
            yield Attack(field, what, message, not_finite=not finite, huge=huge)
        if type_name == "string":
            data = serialize_message(_with(make(), path, _MARK)).replace(
                _MARK.encode(), b"\xff\xfe\xc0\x80\xed\xa0\x80\xff"
            )
            yield Attack(field, "not UTF-8", make(), data)
    whole = serialize_message(make())
    yield Attack("", "cut in two", make(), whole[: len(whole) // 2])
    yield Attack("", "nothing", make(), b"")
    yield Attack("", "nothing but ones", make(), b"\x00\x01\x00\x00" + b"\xff" * 64)


def together(kind: type[Any], good: Callable[[], Any] | None, seed: int, count: int) -> Iterator[Attack]:
    """`count` messages in which several fields are bad."""
    rng = random.Random(seed)
    make = good or kind
    leaves = [(path, name) for path, name in paths(kind) if not name.startswith(("sequence<", "["))]
    for _ in range(count if leaves else 0):
        message = make()
        for path, name in rng.sample(leaves, rng.randint(1, len(leaves))):
            _, value = rng.choice([each for each in values_of(name, few=False).items() if each[0] != "1 MB"])
            _with(message, path, value)
        yield Attack("several", f"seed {seed}", message)


def paths(kind: type[Any], before: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], str]]:
    """Every field, nested ones and one item of arrays too ('0'), with its type; arrays as such besides."""
    for name, type_name in kind.get_fields_and_field_types().items():
        path = (*before, name)
        item = item_of(type_name)
        if item is not None:
            if type_name.startswith("sequence<"):
                yield path, type_name
            path, type_name = (*path, "0"), item
        if "/" in type_name:
            yield from paths(class_of(type_name), path)
        else:
            yield path, type_name


def item_of(type_name: str) -> str | None:
    """The type of an array's items; None where it is none."""
    if match := re.fullmatch(r"sequence<([^,>]+)(?:, \d+)?>", type_name):
        return match[1]
    if match := re.fullmatch(r"([^\[]+)\[\d+\]", type_name):
        return match[1]
    return None


def _arrays(make: Callable[[], Any], path: Sequence[str], field: str, type_name: str) -> Iterator[Attack]:
    item = item_of(type_name)
    assert item is not None
    yield Attack(field, "empty", _with(make(), path, []))
    if "/" in item:
        one = class_of(item)()
        nested = any("/" in each for each in type(one).get_fields_and_field_types().values())
        items = [one] * (MANY_NESTED if nested else MANY)
    else:
        plain: Any = next(iter(values_of(item, few=True).values()))
        items = [plain] * MANY
    yield Attack(field, f"{len(items)} items", _with(make(), path, items), huge=True)


def _with(message: Any, path: Sequence[str], value: Any) -> Any:
    """The message with that field changed; an array that is empty gets an item."""
    at = message
    for index, name in enumerate(path):
        last = index == len(path) - 1
        if name == "0":
            if last:
                at[0] = value
                return message
            at = at[0]
            continue
        if last:
            setattr(at, name, value)
            return message
        at = _items(at, name) if path[index + 1] == "0" else getattr(at, name)
    return message


def _items(message: Any, name: str) -> Any:
    """The array, which has an item of its own in front."""
    items = getattr(message, name)
    item = item_of(message.get_fields_and_field_types()[name])
    assert item is not None
    if isinstance(items, list):  # of messages or texts
        items = [deepcopy(each) for each in items] or [class_of(item)() if "/" in item else ""]
        setattr(message, name, items)
        return getattr(message, name)
    if not len(items):
        setattr(message, name, [0])
    return getattr(message, name)
