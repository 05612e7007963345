"""Text, or records, as columns of bytes: what is written of many rows at once."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

Characters = npt.NDArray[np.uint8]
Part = bytes | Characters


def characters_of(texts: Sequence[str]) -> Characters:
    """One text a row, NUL behind."""
    try:
        array = np.array(texts, "S")
    except UnicodeEncodeError:  # it takes ASCII alone
        array = np.array([text.encode() for text in texts])
    return array.view(np.uint8).reshape(len(texts), array.itemsize)


def matrix_of(parts: Sequence[Part], count: int) -> Characters:
    """Rows of text from columns of text, each column a constant or a matrix of characters; NUL characters pad."""
    template = b"".join(part if isinstance(part, bytes) else bytes(part.shape[1]) for part in parts)
    matrix = np.empty((count, len(template)), np.uint8)
    matrix[:] = np.frombuffer(template, np.uint8)
    at = 0
    for part in parts:
        if isinstance(part, bytes):
            at += len(part)
        else:
            matrix[:, at : at + part.shape[1]] = part
            at += part.shape[1]
    return matrix


def lines_of(parts: Sequence[Part], count: int) -> bytes:
    """The same as lines, without the padding."""
    return matrix_of([*parts, b"\n"], count).tobytes().translate(None, b"\0")


def put(out: bytearray, places: npt.NDArray[np.int64], rows: Characters) -> None:
    """Copy each row of characters to its place."""
    width = rows.shape[1]
    if width and len(rows):
        # An item of the width of a row at every byte.
        window = np.ndarray((len(out) - width + 1,), f"V{width}", buffer=out, strides=(1,))
        window[places] = np.ascontiguousarray(rows).view(f"V{width}").ravel()
