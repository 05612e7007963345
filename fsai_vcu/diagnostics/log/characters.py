"""Text of many rows at once, as columns of characters."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Final, NamedTuple

import msgspec
import numpy as np
import numpy.typing as npt

_LONGEST: Final = 32  # no number has so many characters

Items = npt.NDArray[np.void]
Places = npt.NDArray[np.integer]


class Texts(NamedTuple):
    """One text a row: the last `lengths` bytes of its item. What stands in front of them is of no account."""

    items: Items
    lengths: Places | int

    def at(self, rows: Places) -> Texts:
        return Texts(self.items.take(rows), self.lengths if isinstance(self.lengths, int) else self.lengths.take(rows))

    def put(self, rows: Places, new: Texts) -> Texts:
        """Return the texts with the new texts in these rows; those that were there are written over."""
        items = widened(self.items, new.items.itemsize)
        items[rows] = widened(new.items, items.itemsize)
        self.lengths[rows] = new.lengths  # type: ignore[index]
        return Texts(items, self.lengths)


Part = bytes | Texts


def characters(items: npt.NDArray[Any]) -> npt.NDArray[np.uint8]:
    """Return a row of characters for each item."""
    return items.view(np.uint8).reshape(len(items), items.itemsize)


def items_of(rows: npt.NDArray[Any]) -> Items:
    """Return an item for each row."""
    rows = np.ascontiguousarray(rows)
    return rows.view(f"V{rows.itemsize * rows.shape[1]}").ravel()


def widened(items: Items, width: int) -> Items:
    """Return the items with zeros in front, where they are not so wide."""
    more = width - items.itemsize
    return items_of(np.pad(characters(items), ((0, 0), (more, 0)))) if more > 0 else items


def texts_of(texts: Sequence[str]) -> Texts:
    encoded = [text.encode("utf-8", "replace") for text in texts]
    lengths = np.array([*map(len, encoded)])
    width = max(1, lengths.max(initial=0))
    return Texts(np.array([text.rjust(width) for text in encoded], f"S{width}").view(f"V{width}"), lengths)


def number_texts(numbers: npt.NDArray[Any], singly: Callable[[Sequence[Any]], Sequence[str]]) -> Texts:
    """Return numbers, at least one, as `repr` writes them; `singly` writes very large and small ones, and objects."""
    if numbers.dtype == np.object_:
        return texts_of(singly(numbers.tolist()))
    text = bytes(_LONGEST) + msgspec.json.encode(numbers.tolist())
    ends = np.append(np.flatnonzero(np.frombuffer(text, np.uint8) == ord(",")), len(text) - 1)
    lengths = np.diff(ends, prepend=_LONGEST) - 1
    width = int(lengths.max())
    found = Texts(window(text, width)[ends - width], lengths)
    if numbers.dtype != np.float64:
        return found
    # It writes 0.00001 and 1e-9 where repr has 1e-05 and 1e-09; and before 3.11.7, 1e16 where that has 1e+16.
    size = np.abs(numbers)
    other = np.flatnonzero(~(size < 1e16) | (size >= 1e-9) & (size < 1e-4))
    return found.put(other, texts_of(singly(numbers[other].tolist()))) if len(other) else found


def length_of(parts: Sequence[Part]) -> Places | int:
    """Return the length of all the parts together, in each row."""
    return sum((len(part) if isinstance(part, bytes) else part.lengths for part in parts), start=0)


def put_parts(out: bytearray, ends: Places, parts: Sequence[Part], before: int = 0) -> None:
    """Write in each row the parts one behind the other, so that they end there.

    before: so many bytes in front of each row are written later. The last part comes first, for what stands in front
    of a text goes where other parts will be.
    """
    room = before + sum(_certain(part) for part in parts)
    for part in reversed(parts):
        room -= _certain(part)
        if isinstance(part, bytes):
            if part:
                ends = ends - len(part)
                window(out, len(part))[ends] = np.void(part)
        else:
            _put_texts(out, ends, part, room)
            ends = ends - part.lengths


def _certain(part: Part) -> int:
    """Return the part's length, if it has one in every row, else 0."""
    return len(part) if isinstance(part, bytes) else part.lengths if isinstance(part.lengths, int) else 0


def _put_texts(out: bytearray, ends: Places, texts: Texts, room: int) -> None:
    """Put the texts into their places, with at most `room` bytes in front of each."""
    items, lengths = texts
    width = items.itemsize
    if width <= room or isinstance(lengths, int):
        window(out, width)[ends - width] = items
        return
    for done in range(0, width, room + 1):
        rows = np.flatnonzero(lengths > done)
        piece = characters(items[rows])[:, max(0, width - done - room - 1) : width - done]
        window(out, piece.shape[1])[ends[rows] - done - piece.shape[1]] = items_of(piece)


def lines_of(parts: Sequence[Part], count: int) -> bytearray:
    """A line of each row."""
    lengths = np.broadcast_to(length_of(parts) + 1, count)
    out = bytearray(int(lengths.sum()))
    if count:
        put_parts(out, np.cumsum(lengths), [*parts, b"\n"])
    return out


def window(buffer: bytes | bytearray, width: int) -> Items:
    """An item of so many bytes at every byte."""
    return np.ndarray((len(buffer) - width + 1,), f"V{width}", buffer=buffer, strides=(1,))
