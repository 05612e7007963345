"""Faults between the simulated car and the AI computer: frames that vanish, freeze, lie or come late.

A fault looks at one frame and says what becomes of it: nothing, itself, something else, several, some of them later.
New kinds are one class each, in force while they are on a wire. Faults of switches,
sensors and people are elsewhere (`switches.py`): these are the wire's.

Pure: time is the frames' own, chance comes from a seed.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from msgspec.structs import replace

from fsai_vcu.interface.codec import Codec
from fsai_vcu.interface.frames import Frame


@dataclass
class FrameFault:
    """One thing that goes wrong on the wire, for frames of these ids (none named: for all)."""

    ids: frozenset[int]

    def frames(self, frame: Frame) -> Iterable[Frame]:
        """Return what arrives instead of `frame`; frames with a later `t_ns` arrive then."""
        return self.met(frame) if not self.ids or frame.can_id in self.ids else (frame,)

    def met(self, frame: Frame) -> Iterable[Frame]:
        """The same, of a frame that the fault is about."""
        raise NotImplementedError


@dataclass
class Drop(FrameFault):
    """Frames vanish: all of them, or each by chance."""

    probability: float = 1.0
    seed: int = 0

    def __post_init__(self) -> None:
        self._chance = random.Random(self.seed)

    def met(self, frame: Frame) -> Iterable[Frame]:
        return () if self.probability >= 1.0 or self._chance.random() < self.probability else (frame,)


@dataclass
class Freeze(FrameFault):
    """Frames go on, but with the payload that each id had first."""

    def __post_init__(self) -> None:
        self._frozen: dict[int, bytes] = {}

    def met(self, frame: Frame) -> Iterable[Frame]:
        return (replace(frame, data=self._frozen.setdefault(frame.can_id, frame.data)),)


@dataclass
class Delay(FrameFault):
    """Frames come later, by `delay_ns` and at most `jitter_ns` more; those of one id keep their order."""

    delay_ns: int = 0
    jitter_ns: int = 0
    seed: int = 0

    def __post_init__(self) -> None:
        self._chance = random.Random(self.seed)
        self._latest_ns: dict[int, int] = {}

    def met(self, frame: Frame) -> Iterable[Frame]:
        late_ns = self.delay_ns + (self._chance.randint(0, self.jitter_ns) if self.jitter_ns else 0)
        arrival_ns = max(frame.t_ns + late_ns, self._latest_ns.get(frame.can_id, 0))
        self._latest_ns[frame.can_id] = arrival_ns
        return (replace(frame, t_ns=arrival_ns),)


@dataclass
class Changed(FrameFault):
    """Frames are what `change` makes of them."""

    change: Callable[[Frame], Frame]

    def met(self, frame: Frame) -> Iterable[Frame]:
        return (self.change(frame),)


@dataclass
class FlipBits(FrameFault):
    """Bits of the payload are flipped; a mask shorter than the payload leaves the rest alone."""

    mask: bytes = b"\x01"

    def met(self, frame: Frame) -> Iterable[Frame]:
        mask = self.mask[: len(frame.data)].ljust(len(frame.data), b"\0")
        return (replace(frame, data=bytes(value ^ flip for value, flip in zip(frame.data, mask, strict=True))),)


@dataclass
class WrongLength(FrameFault):
    """The payload is cut or padded with zeros to `length` bytes."""

    length: int = 0

    def met(self, frame: Frame) -> Iterable[Frame]:
        return (replace(frame, data=frame.data[: self.length].ljust(self.length, b"\0")),)


@dataclass
class Overwrite(FrameFault):
    """Bytes of the payload from `at` on are replaced by `data`; what lies beyond the payload's end is left out."""

    at: int = 0
    data: bytes = b""

    def met(self, frame: Frame) -> Iterable[Frame]:
        changed = (frame.data[: self.at] + self.data + frame.data[self.at + len(self.data) :])[: len(frame.data)]
        return (replace(frame, data=changed),)


@dataclass
class WrongValues(FrameFault):
    """Fields of a message say something else: `values` by the field names of its image."""

    codec: Codec
    values: Mapping[str, Any]

    def met(self, frame: Frame) -> Iterable[Frame]:
        image = self.codec.decode(frame).image
        if image is None:
            return (frame,)
        changed = self.codec.encode(replace(image, **self.values))
        return (replace(frame, data=changed.data),)


@dataclass
class Repeat(FrameFault):
    """Each frame arrives `times` times in all."""

    times: int = 2

    def met(self, frame: Frame) -> Iterable[Frame]:
        return (frame,) * self.times


class FaultyWire:
    """A wire with faults on it, in the order in which a frame meets them."""

    def __init__(self, faults: Sequence[FrameFault] = ()) -> None:
        self.faults = list(faults)  # what one has delayed arrives even when it is taken away
        self._waiting: list[Frame] = []

    def through(self, frames: Iterable[Frame], now_ns: int) -> list[Frame]:
        """Return what arrives up to `now_ns`, in the order of time, when `frames` are sent."""
        under_way = list(frames)
        if not self.faults and not self._waiting:
            return under_way
        for fault in self.faults:
            under_way = [out for frame in under_way for out in fault.frames(frame)]
        under_way = self._waiting + under_way
        self._waiting = [frame for frame in under_way if frame.t_ns > now_ns]
        return sorted((frame for frame in under_way if frame.t_ns <= now_ns), key=lambda frame: frame.t_ns)
