"""Tables as CSV: text that every tool reads, each value written as `decode` writes it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import IO, Final

import numpy as np

from fsai_vcu.diagnostics.export.tables import SINCE, Column, Table, TablePart, Values
from fsai_vcu.diagnostics.log.candump import time_text
from fsai_vcu.diagnostics.log.characters import Part, Texts, lines_of, number_texts, texts_of
from fsai_vcu.diagnostics.log.frames import Ints
from fsai_vcu.printable import cell

_QUOTED: Final = ('"', ",", "\n", "\r")


@contextmanager
def csv_files(path_of: Callable[[Table], Path], first_ns: int, *, words: bool) -> Iterator[Callable[[TablePart], None]]:
    """Writes each table to the file that `path_of` names. first_ns: the log's first frame. words: instead of numbers,
    where the database has them.
    """
    files: dict[str, IO[bytes]] = {}
    with ExitStack() as opened:

        def write(rows: TablePart) -> None:
            table = rows.table
            if table.name not in files:
                files[table.name] = opened.enter_context(path_of(table).open("wb"))
                signals = (f"{c.name} [{c.unit}]" if c.unit else c.name for c in table.columns)
                names = ("time [s]", f"{SINCE} [s]", *signals)
                files[table.name].write((",".join(_quoted(cell(name)) for name in names) + "\n").encode())
            parts: list[Part] = [time_text(rows.t_ns), b",", _since_text(rows.t_ns, first_ns)]
            for column, values in zip(table.columns, rows.values, strict=True):
                parts += [b",", _texts(column, values, words=words)]
            files[table.name].write(lines_of(parts, len(rows)))

        yield write


def _since_text(t_ns: Ints, first_ns: int) -> Texts:
    """Seconds from the log's first frame on: as the difference of the times written, below 0 where a clock was set."""
    since_ns = t_ns // 1000 * 1000 - first_ns // 1000 * 1000
    if not len(t_ns) or int(since_ns.min()) >= 0:
        return time_text(since_ns)
    items, lengths = texts_of([f"{each / 1e9:.6f}" for each in since_ns.tolist()])
    return Texts(items, lengths)


def _texts(column: Column, values: Values, *, words: bool) -> Texts:
    """One text for each row."""
    numbers = values.data
    choices = column.choices if words else {}
    if choices:
        # Floats by their bits: -0.0 is not 0.0 for a reader of the text.
        keys = numbers.view(np.int64) if numbers.dtype == np.float64 else numbers
        _, first, where = np.unique(keys, return_index=True, return_inverse=True)
        words_of = {value: _quoted(cell(word)) for value, word in choices.items()}
        texts = [words_of.get(value) or repr(value) for value in numbers[first].tolist()]
        items, lengths = texts_of(texts).at(where)
    else:
        items, lengths = number_texts(numbers, lambda others: [*map(repr, others)])
    return Texts(items, np.where(np.ma.getmaskarray(values), 0, lengths))


def _quoted(text: str) -> str:
    text = text.replace("\0", "")
    return '"' + text.replace('"', '""') + '"' if any(mark in text for mark in _QUOTED) else text
