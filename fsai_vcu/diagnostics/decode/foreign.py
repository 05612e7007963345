"""The process in which cantools reads a database that may take much more than its size: `python -m`, file and kind."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

from fsai_vcu.files import MIB
from fsai_vcu.interface.database_text import loaded_without_orphans, read_database_text
from fsai_vcu.runtime.bounded import Bounds, send_results

import cantools.database  # isort: skip
from cantools.database.errors import UnsupportedDatabaseFormatError  # isort: skip

# cantools takes five seconds and 100 MiB for each MiB of a DBC file.
BOUNDS: Final = Bounds(memory_bytes=256 * MIB, memory_times=150, seconds=10, seconds_per_mib=20.0)


def main(path: Path, kind: str) -> None:
    """Read the database and send it. kind: as cantools names it; '' where it is to find out."""

    def read(send: Callable[[Any], None]) -> None:
        def load(text: str) -> Any:
            return cantools.database.load_string(text, kind or None, strict=False)

        text = read_database_text(path, kind)
        try:
            send(loaded_without_orphans(load, text) if kind == "dbc" else (load(text), ""))
        except UnsupportedDatabaseFormatError as error:  # what each parser raised is in it
            if any(isinstance(each, MemoryError) for each in vars(error).values()):
                raise MemoryError from error
            raise

    send_results(path, BOUNDS, read)


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2])
