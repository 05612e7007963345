"""A log's tables written in one of the formats, whole or not at all."""

from __future__ import annotations

import re
import shutil
import tempfile
from collections.abc import Callable, Iterable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from itertools import chain, count
from pathlib import Path
from typing import Final

import numpy as np

from fsai_vcu.diagnostics.decode.decoder import Decoder
from fsai_vcu.diagnostics.export.tables import Table, TablePart, Tables
from fsai_vcu.diagnostics.export.wide import WideTable
from fsai_vcu.diagnostics.log.frames import Frames
from fsai_vcu.interface.errors import UserError

NEEDS: Final = {"parquet": "pyarrow", "mcap": "mcap", "mf4": "asammdf"}
"""Package that must be installed for a format; the extra has the format's name."""
_A_FILE_EACH: Final = ("csv", "parquet")
_AT_ONCE: Final = 200_000  # frames
_NAME_BYTES: Final = 200  # of a table's file: a file system takes 255


@dataclass(frozen=True, slots=True)
class Written:
    """Result of an export. left_out: frames that are in no table, and why. notes: lines for people."""

    tables: int
    rows: int
    left_out: str
    notes: tuple[str, ...]


def check_format(form: str) -> None:
    """Raise UserError with the line that installs what is missing."""
    package = NEEDS.get(form)
    if package is None:
        return
    try:
        import_module(package)
    except ImportError:
        raise UserError(f"{form} needs {package}: pip install 'fsai-vcu[{form}]'") from None


def export(
    frames: Frames,
    decoder: Decoder,
    form: str,
    path: Path,
    *,
    first_ns: int | None = None,
    step_ns: int | None = None,
    words: bool = False,
    progress: Callable[[int, int], None] = lambda done, of: None,
) -> Written:
    """Write all tables to `path`: a folder of files for CSV and Parquet, else a file. With `step_ns` one wide table.
    first_ns: the log's first frame, from which times count (default: that of `frames`).

    What is at `path` is replaced when all is written, unless it is a folder with something in it. `progress` gets
    frames (of a wide table, rows) done and in all. Raises UserError, and OSError where writing fails.
    """
    check_format(form)
    folder = form in _A_FILE_EACH and step_ns is None
    if folder and path.exists() and not (path.is_dir() and not any(path.iterdir())):
        what = "a folder with something in it" if path.is_dir() else "a file"
        raise UserError(f"{path} is {what} already; name a new folder for the tables")
    if not folder and path.is_dir():
        raise UserError(f"{path} is a folder; name a file")
    if path.is_symlink() or (path.exists() and not path.is_dir() and not path.is_file()):
        what = "a link" if path.is_symlink() else "a device or a pipe"
        raise UserError(f"{path} is {what}, which a file would replace; name a file")
    # Beside its place, so that it can be moved there in one step.
    work = Path(tempfile.mkdtemp(prefix=f".{path.name}.", dir=path.parent))
    try:
        whole = work / f"whole.{form}"
        if folder:
            whole.mkdir()
        tables = Tables(decoder, several_buses=len(np.unique(frames.channel)) > 1)
        wide = WideTable(tables, frames, step_ns) if step_ns is not None else None
        seen: set[str] = set()
        done = 0
        if first_ns is None:
            first_ns = int(frames.t_ns[0])
        with _writer(form, partial(_new_file, whole, form) if folder else lambda _: whole, first_ns, words) as write:
            for rows in wide or _parts(tables, frames, progress):
                write(rows)
                seen.add(rows.table.name)
                done += len(rows)
                if wide is not None:
                    progress(done, wide.rows)
        whole.replace(path)
        left_out = ", ".join(f"{number} {why}" for why, number in tables.left_out.items() if number)
        return Written(1 if wide else len(seen), done, left_out, tuple(wide.notes if wide else ()))
    finally:
        shutil.rmtree(work, ignore_errors=True)


def _writer(
    form: str, path_of: Callable[[Table | None], Path], first_ns: int, words: bool
) -> AbstractContextManager[Callable[[TablePart], None]]:
    """Return the writer that takes the rows; what it wrote is whole when it ends without an error."""
    if form == "csv":
        from fsai_vcu.diagnostics.export.csv_files import csv_files

        return csv_files(path_of, first_ns, words=words)
    if form == "parquet":
        from fsai_vcu.diagnostics.export.parquet_files import parquet_files

        return parquet_files(path_of, first_ns, words=words)
    if form == "mcap":
        from fsai_vcu.diagnostics.export.mcap_file import mcap_file

        return mcap_file(path_of(None))
    from fsai_vcu.diagnostics.export.mf4_file import mf4_file

    return mf4_file(path_of(None), first_ns)


def _parts(tables: Tables, frames: Frames, progress: Callable[[int, int], None]) -> Iterable[TablePart]:
    for begin in range(0, len(frames), _AT_ONCE):
        end = min(begin + _AT_ONCE, len(frames))
        yield from tables.rows(frames.only(np.arange(begin, end, dtype=np.int64)))
        progress(end, len(frames))


def _new_file(folder: Path, form: str, table: Table) -> Path:
    """A file for each table, whatever its name has in it."""
    stem = re.sub(r"[^\w.+-]+", "_", table.name).lstrip(".-") or "table"  # what begins with '-' other programs obey
    stem = stem.encode()[:_NAME_BYTES].decode(errors="ignore")
    names = chain([stem], (f"{stem}-{number}" for number in count(2)))
    return next(path for name in names if not (path := folder / f"{name}.{form}").exists())
