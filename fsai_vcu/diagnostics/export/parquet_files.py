"""Tables as Parquet, with units and words in the metadata of the columns."""

from __future__ import annotations

import json
import os
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from importlib import import_module
from pathlib import Path
from typing import Any, Final

import numpy as np

from fsai_vcu.diagnostics.export.tables import SINCE, Column, Table, TablePart, Values

pa: Any = import_module("pyarrow")  # it ships no types
pq: Any = import_module("pyarrow.parquet")
_WAITING: Final = 8  # batches
_DICTIONARY_BYTES: Final = 4096  # columns of more different values are smaller, and written faster, without one


@contextmanager
def parquet_files(
    path_of: Callable[[Table], Path], first_ns: int, *, words: bool
) -> Iterator[Callable[[TablePart], None]]:
    """Writes each table to the file that `path_of` names. first_ns: the log's first frame. words: instead of numbers,
    where the database has them.
    """
    writers: dict[str, Any] = {}
    pending: deque[Future[None]] = deque()
    with ExitStack() as opened, ThreadPoolExecutor(1) as behind:  # packing needs no Python

        def write(rows: TablePart) -> None:
            table = rows.table
            if table.name not in writers:
                options = {"compression": "zstd", "dictionary_pagesize_limit": _DICTIONARY_BYTES}
                file = opened.enter_context(pa.OSFile(os.fsencode(path_of(table)), "wb"))  # whatever its name
                writer = pq.ParquetWriter(file, _schema(table, words=words), **options)
                writers[table.name] = opened.enter_context(writer)
            schema = writers[table.name].schema
            columns = zip(table.columns, rows.values, schema.types[2:], strict=True)
            since = _numbers((rows.t_ns - first_ns) / 1e9, schema.types[1])
            arrays = [_numbers(rows.t_ns, schema.types[0]), since, *(_array(*column) for column in columns)]
            pending.append(behind.submit(writers[table.name].write_batch, pa.record_batch(arrays, schema=schema)))
            while len(pending) > _WAITING:
                pending.popleft().result()

        yield write
        for each in pending:
            each.result()


def _schema(table: Table, *, words: bool) -> Any:
    fields = [
        pa.field("time", pa.timestamp("ns", tz="UTC"), nullable=False),
        pa.field(SINCE, pa.float64(), nullable=False, metadata={"unit": "s"}),
    ]
    for column in table.columns:
        metadata = {"unit": column.unit} if column.unit else {}
        if column.choices:
            metadata["choices"] = json.dumps(dict(column.choices))
        as_text = column.kind == "object" or (words and column.choices)
        kind = pa.string() if as_text else pa.from_numpy_dtype(column.kind)
        fields.append(pa.field(column.name, kind, column.optional, metadata or None))
    return pa.schema(fields, {"about": table.about, "bus": table.channel})


def _array(column: Column, values: Values, kind: Any) -> Any:
    if kind != pa.string():
        return _numbers(values.data, kind, np.ma.getmask(values))
    distinct, where = np.unique(values.data, return_inverse=True)
    texts = np.array([column.choices.get(value, str(value)) for value in distinct.tolist()], object)
    return pa.array(texts[where], kind, mask=np.ma.getmaskarray(values))


def _numbers(numbers: Any, kind: Any, mask: Any = np.ma.nomask) -> Any:
    """Return the numbers as an array of their own memory.

    `pa.array` would import pandas to ask whether they are of it: 0.3 s where there is one.
    """
    present = pa.py_buffer(np.packbits(~mask, bitorder="little")) if np.any(mask) else None
    return pa.Array.from_buffers(kind, len(numbers), [present, pa.py_buffer(np.ascontiguousarray(numbers))])
