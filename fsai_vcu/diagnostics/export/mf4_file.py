"""Tables as MF4 (ASAM MDF 4.10), a group per table, through asammdf."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from fsai_vcu.diagnostics.export.tables import Column, Rows, Values


class Mf4File:
    """Writes one file. Times are seconds since its start, which is in its header."""

    def __init__(self, path: Path, begin_ns: int, metadata: Mapping[str, str]) -> None:
        """`begin_ns`: the log's first time."""
        self._asammdf: Any = import_module("asammdf")
        self._mdf: Any = self._asammdf.MDF(version="4.10")
        self._mdf.header.start_time = datetime.fromtimestamp(begin_ns / 1e9, UTC)
        # What the header keeps is what the times are relative to.
        self._begin_ns = int(self._mdf.header.abs_time)
        self._mdf.header.comment = "; ".join(f"{name}: {value}" for name, value in metadata.items())
        self._path = path
        self._groups: dict[str, int] = {}

    def write(self, rows: Rows) -> None:
        """The rows of a table come together or one part after another."""
        order = np.argsort(rows.t_ns, kind="stable")  # the format wants times that grow
        times = (rows.t_ns[order] - self._begin_ns) / 1e9
        values = [each.at(order) for each in rows.values]
        group = self._groups.get(rows.table.name)
        if group is None:
            signals = [
                self._signal(column, each, times) for column, each in zip(rows.table.columns, values, strict=True)
            ]
            self._groups[rows.table.name] = self._mdf.append(
                signals, acq_name=rows.table.name, comment=rows.table.about, common_timebase=True
            )
            return
        parts = [
            (_samples(column, each), _invalid(each)) for column, each in zip(rows.table.columns, values, strict=True)
        ]
        self._mdf.extend(group, [(times, None), *parts])

    def _signal(self, column: Column, values: Values, times: Any) -> Any:
        conversion: dict[str, object] | None = None
        if column.choices and column.kind != "float64":
            conversion = {}
            for at, (value, word) in enumerate(column.choices.items()):
                conversion[f"val_{at}"], conversion[f"text_{at}"] = value, word
        return self._asammdf.Signal(
            _samples(column, values),
            times,
            name=column.name,
            unit=column.unit,
            conversion=conversion,
            invalidation_bits=_invalid(values) if column.optional else None,
        )

    def finish(self) -> None:
        self._mdf.save(self._path, overwrite=True, compression=2)

    def close(self) -> None:
        self._mdf.close()


def _samples(column: Column, values: Values) -> Any:
    if column.kind == "text":
        return np.array([str(value).encode() for value in values.numbers.tolist()], "S24")
    return values.numbers


def _invalid(values: Values) -> Any:
    return np.zeros(len(values.numbers), np.bool_) if values.present is None else ~values.present
