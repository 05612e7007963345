"""A log's tables written in one of the formats, whole or not at all."""

from __future__ import annotations

import os
import re
import shutil
import tempfile
from collections.abc import Callable, Iterable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Final, Protocol

import numpy as np

from fsai_vcu.diagnostics.decode.decoder import Decoder
from fsai_vcu.diagnostics.export.tables import LeftOut, Rows, Table, Tables, buses_in
from fsai_vcu.diagnostics.export.wide import WideTable
from fsai_vcu.diagnostics.log.frames import Frames
from fsai_vcu.interface.errors import UserError

NEEDS: Final[Mapping[str, str]] = {"parquet": "pyarrow", "mcap": "mcap", "mf4": "asammdf"}
"""What has to be installed for a format; the extra has the format's name."""
_A_FILE_EACH: Final = ("csv", "parquet")
_AT_ONCE: Final = 200_000  # frames


class ExportError(UserError):
    """What cannot be written; the message is one clear line."""


class _Sink(Protocol):
    def write(self, rows: Rows) -> None: ...
    def finish(self) -> None: ...
    def close(self) -> None: ...


@dataclass(frozen=True, slots=True)
class Written:
    """What became of an export. notes: lines for people."""

    tables: int
    rows: int
    left_out: LeftOut
    notes: tuple[str, ...] = ()


def check_format(form: str) -> None:
    """Raises ExportError with the line that installs what is missing."""
    package = NEEDS.get(form)
    if package is None:
        return
    try:
        import_module(package)
    except ImportError:
        raise ExportError(f"{form} needs {package}: pip install 'fsai-vcu[{form}]'") from None


def export(
    frames: Frames,
    decoder: Decoder,
    form: str,
    path: Path,
    *,
    step_ns: int | None = None,
    words: bool = False,
    progress: Callable[[int, int], None] = lambda done, of: None,
) -> Written:
    """Write all tables to `path`: a folder of files for CSV and Parquet, else a file. With `step_ns` one wide table.

    What is at `path` is replaced when all is written, unless it is a folder with something in it. `progress` gets
    frames (of a wide table, rows) done and in all. Raises ExportError, and OSError where writing fails.
    """
    check_format(form)
    folder = form in _A_FILE_EACH and step_ns is None
    if folder and path.exists() and not (path.is_dir() and not any(path.iterdir())):
        what = "a folder with something in it" if path.is_dir() else "a file"
        raise ExportError(f"{path} is {what} already; name a new folder for the tables")
    if not folder and path.is_dir():
        raise ExportError(f"{path} is a folder; name a file")
    if path.exists() and not path.is_dir() and not path.is_file():
        raise ExportError(f"{path} is a device or a pipe, which a file would replace; name a file")
    # Beside its place, so that it can be moved there in one step.
    work = Path(tempfile.mkdtemp(prefix=f".{path.name}.", dir=path.resolve().parent))
    try:
        whole = work / f"whole.{form}"
        if folder:
            whole.mkdir()
        tables = Tables(decoder, several_buses=len(buses_in(frames)) > 1)
        wide = WideTable(tables, frames, step_ns) if step_ns is not None else None
        seen: set[str] = set()
        parts = wide if wide is not None else _parts(tables, frames, progress)
        path_of: Callable[[Table], Path] = _FileNames(whole, form) if folder else lambda _: whole
        count = 0
        with ExitStack() as opened:
            sink = _sink(form, path_of, whole, frames, words, opened)
            opened.callback(sink.close)
            for rows in parts:
                sink.write(rows)
                seen.add(rows.table.name)
                count += len(rows)
                if wide is not None:
                    progress(count, wide.rows)
            sink.finish()
        whole.chmod((0o777 if folder else 0o666) & ~_umask())
        whole.replace(path)
        return Written(
            1 if wide is not None else len(seen),
            count,
            tables.left_out,
            tuple(_notes(wide)) if wide is not None else (),
        )
    finally:
        shutil.rmtree(work, ignore_errors=True)


def _sink(
    form: str, path_of: Callable[[Table], Path], whole: Path, frames: Frames, words: bool, opened: ExitStack
) -> _Sink:
    """Of each format only the module that is asked for is imported."""
    if form == "csv":
        from fsai_vcu.diagnostics.export.csv_files import CsvFiles

        return CsvFiles(path_of, words=words)
    if form == "parquet":
        from fsai_vcu.diagnostics.export.parquet_files import ParquetFiles

        return ParquetFiles(path_of, words=words)
    if form == "mcap":
        from fsai_vcu.diagnostics.export.mcap_file import McapTables

        return McapTables(opened.enter_context(whole.open("wb")))
    from fsai_vcu.diagnostics.export.mf4_file import Mf4File

    return Mf4File(whole, int(frames.t_ns.min()), {"made by": "fsai-vcu export"})


def _parts(tables: Tables, frames: Frames, progress: Callable[[int, int], None]) -> Iterable[Rows]:
    for begin in range(0, len(frames), _AT_ONCE):
        end = min(begin + _AT_ONCE, len(frames))
        yield from tables.rows(frames.only(np.arange(begin, end, dtype=np.int64)))
        progress(end, len(frames))


class _FileNames:
    """A file for each table, whatever its name has in it."""

    def __init__(self, folder: Path, form: str) -> None:
        self._folder = folder
        self._form = form
        self._used: set[str] = set()

    def __call__(self, table: Table) -> Path:
        stem = re.sub(r"[^\w.+-]+", "_", table.name).lstrip(".") or "table"
        name, number = stem, 2
        while name.lower() in self._used:  # also where a file system does not tell capitals
            name, number = f"{stem}-{number}", number + 1
        self._used.add(name.lower())
        return self._folder / f"{name}.{self._form}"


def _notes(wide: WideTable) -> Iterable[str]:
    if wide.backwards_ns:
        yield f"time goes back in it, by up to {wide.backwards_ns / 1e9:.3f} s: the rows are in order of time"
    if wide.silences:
        yield f"no rows for {wide.silences} silences of more than a minute"


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
