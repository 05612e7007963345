"""Tables as Parquet, with units and words in the metadata of the columns."""

from __future__ import annotations

import json
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from fsai_vcu.diagnostics.export.tables import Column, Rows, Table, Values

pa: Any = import_module("pyarrow")  # it ships no types
pq: Any = import_module("pyarrow.parquet")


class ParquetFiles:
    """Writes each table to the file that `path_of` names."""

    def __init__(self, path_of: Callable[[Table], Path], *, words: bool) -> None:
        """words: the database's words instead of numbers, where it has them."""
        self._path_of = path_of
        self._words = words
        self._writers: dict[str, Any] = {}

    def write(self, rows: Rows) -> None:
        writer = self._writers.get(rows.table.name)
        if writer is None:
            schema = self._schema(rows.table)
            writer = pq.ParquetWriter(str(self._path_of(rows.table)), schema, compression="zstd")
            self._writers[rows.table.name] = writer
        arrays = [pa.array(rows.t_ns, pa.timestamp("ns", tz="UTC"))]
        arrays += [self._array(c, values) for c, values in zip(rows.table.columns, rows.values, strict=True)]
        writer.write_batch(pa.record_batch(arrays, schema=writer.schema))

    def _schema(self, table: Table) -> Any:
        fields = [pa.field("time", pa.timestamp("ns", tz="UTC"), nullable=False)]
        for column in table.columns:
            metadata = {"unit": column.unit} if column.unit else {}
            if column.choices:
                metadata["choices"] = json.dumps(dict(column.choices))
            fields.append(pa.field(column.name, self._type(column), column.optional, metadata or None))
        return pa.schema(fields, {"about": table.about, "bus": table.channel})

    def _type(self, column: Column) -> Any:
        if column.kind == "text" or (self._words and column.choices):
            return pa.string()
        return {"int64": pa.int64(), "uint64": pa.uint64(), "float64": pa.float64()}[column.kind]

    def _array(self, column: Column, values: Values) -> Any:
        absent = None if values.present is None else ~values.present
        if column.kind == "text" or (self._words and column.choices):
            distinct, where = np.unique(values.numbers, return_inverse=True)
            texts = np.array([column.choices.get(value, str(value)) for value in distinct.tolist()], object)
            return pa.array(texts[where], pa.string(), mask=absent)
        return pa.array(values.numbers, self._type(column), mask=absent)

    def finish(self) -> None:
        self.close()

    def close(self) -> None:
        for writer in self._writers.values():
            writer.close()
        self._writers.clear()
