"""Tables as MF4 (ASAM MDF 4.10), a group per table, through asammdf."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import datetime, timezone
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from fsai_vcu.diagnostics.export.tables import Column, TablePart, Values

_DIGITS = 200  # more than 512 bits have, times a factor


@contextmanager
def mf4_file(path: Path, begin_ns: int) -> Iterator[Callable[[TablePart], None]]:
    """Writes one file. Times are seconds since its start, which is in its header. `begin_ns`: of its first frame."""
    asammdf: Any = import_module("asammdf")
    mdf: Any = asammdf.MDF(version="4.10")
    mdf.header.start_time = datetime.fromtimestamp(begin_ns / 1e9, timezone.utc)
    mdf.header.comment = "made by: fsai-vcu export"
    kept_ns = int(mdf.header.abs_time)  # what the header keeps is what the times are relative to
    groups: dict[str, int] = {}

    def write(rows: TablePart) -> None:
        """The rows of a table come together or one part after another."""
        table = rows.table
        order = np.argsort(rows.t_ns, kind="stable")  # the format wants times that grow
        times = (rows.t_ns[order] - kept_ns) / 1e9
        columns = [(column, values[order]) for column, values in zip(table.columns, rows.values, strict=True)]
        if table.name in groups:
            parts = [(_samples(column, values), np.ma.getmaskarray(values)) for column, values in columns]
            mdf.extend(groups[table.name], [(times, None), *parts])
            return
        signals = [
            asammdf.Signal(
                _samples(column, values),
                times,
                name=column.name,
                unit=column.unit,
                conversion=_conversion(column),
                encoding="utf-8" if column.kind == "object" else None,
                invalidation_bits=np.ma.getmaskarray(values) if column.optional else None,
            )
            for column, values in columns
        ]
        groups[table.name] = mdf.append(signals, acq_name=table.name, comment=table.about, common_timebase=True)

    try:
        yield write
        mdf.save(path, overwrite=True, compression=2)
    finally:
        mdf.close()


def _conversion(column: Column) -> dict[str, object] | None:
    """A number's words."""
    if not column.choices or column.kind == "float64":
        return None
    conversion: dict[str, object] = {}
    for at, (value, word) in enumerate(column.choices.items()):
        conversion[f"val_{at}"], conversion[f"text_{at}"] = value, word
    return conversion


def _samples(column: Column, values: Values) -> Any:
    if column.kind == "object":
        return np.array([str(value).encode() for value in values.data.tolist()], f"S{_DIGITS}")
    return values.data
