"""Tables as CSV: text that every tool reads, each value written as `decode` writes it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import IO, Final

import numpy as np
import numpy.typing as npt

from fsai_vcu.diagnostics.export.tables import Column, Rows, Table, Values
from fsai_vcu.diagnostics.log.candump import time_text
from fsai_vcu.diagnostics.log.characters import Part, assembled

_QUOTED: Final = ('"', ",", "\n", "\r")


class CsvFiles:
    """Writes each table to the file that `path_of` names."""

    def __init__(self, path_of: Callable[[Table], Path], *, words: bool) -> None:
        """words: the database's words instead of numbers, where it has them."""
        self._path_of = path_of
        self._words = words
        self._files: dict[str, IO[bytes]] = {}

    def write(self, rows: Rows) -> None:
        file = self._files.get(rows.table.name)
        if file is None:
            file = self._files[rows.table.name] = self._path_of(rows.table).open("wb")
            names = ["time [s]", *(f"{c.name} [{c.unit}]" if c.unit else c.name for c in rows.table.columns)]
            file.write((",".join(map(_quoted, names)) + "\n").encode())
        parts: list[Part] = [time_text(rows.t_ns)]
        for column, values in zip(rows.table.columns, rows.values, strict=True):
            parts += [b",", self._texts(column, values)]
        file.write(b"\n".join([*assembled(parts, len(rows)), b""]))

    def _texts(self, column: Column, values: Values) -> npt.NDArray[np.uint8]:
        """One text for each row, NUL behind; a value that comes again is written once."""
        numbers = values.numbers
        choices = column.choices if self._words else {}
        # Floats by their bits: -0.0 is not 0.0 for who reads the text.
        keys = numbers.view(np.int64) if numbers.dtype == np.float64 else numbers
        _, first, where = np.unique(keys, return_index=True, return_inverse=True)
        texts = [
            _quoted(choices.get(value, repr(value))) if choices else repr(value) for value in numbers[first].tolist()
        ]
        table = np.array([*(text.encode() for text in texts), b""])
        if values.present is not None:
            where = np.where(values.present, where, len(texts))
        width = table.dtype.itemsize
        if not width:
            return np.zeros((len(numbers), 1), np.uint8)
        return table.view(np.uint8).reshape(-1, width)[where]

    def finish(self) -> None:
        self.close()

    def close(self) -> None:
        for file in self._files.values():
            file.close()
        self._files.clear()


def _quoted(text: str) -> str:
    text = text.replace("\0", "")
    return '"' + text.replace('"', '""') + '"' if any(mark in text for mark in _QUOTED) else text
