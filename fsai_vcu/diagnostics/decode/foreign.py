"""The process in which cantools reads a database that may take much more than its size: `python -m`, file and kind."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

from fsai_vcu.files import DATABASE_BYTES, MIB, read_named
from fsai_vcu.interface.database import ENCODING
from fsai_vcu.runtime.bounded import Bounds, send_results

import cantools.database  # isort: skip
from cantools.database.errors import UnsupportedDatabaseFormatError  # isort: skip

# cantools takes five seconds and 100 MiB for each MiB of a DBC file.
BOUNDS: Final = Bounds(memory_bytes=256 * MIB, memory_times=150, seconds=10, seconds_per_mib=20.0)


def main(path: Path, kind: str) -> None:
    """kind: as cantools names it; '' where it is to find out."""

    def read(send: Callable[[Any], None]) -> None:
        text = read_named(path, DATABASE_BYTES, ENCODING if kind in ("dbc", "sym") else "utf-8", "replace")
        try:
            send(cantools.database.load_string(text, kind or None, strict=False))
        except UnsupportedDatabaseFormatError as error:  # what each parser raised is in it
            if any(isinstance(each, MemoryError) for each in vars(error).values()):
                raise MemoryError from error
            raise

    send_results(path, BOUNDS, read)


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2])
