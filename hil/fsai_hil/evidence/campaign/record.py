"""The campaign's record: JSON lines, one per run, after one line that says what the campaign is.

Lines are appended whole and flushed, so a campaign that is killed goes on where it was; a line cut short by the kill
is left out when the record is read.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager
from functools import cache
from pathlib import Path
from typing import IO, Any, Final

import fsai_hil
import fsai_vcu
from fsai_hil.evidence.work import digest_of
from fsai_vcu.interface.revisions import dbc_dir

NAME: Final = "record.jsonl"
DRIVEN: Final = {
    fsai_vcu: ("core/**/*", "interface/**/*", "runtime/**/*", "diagnostics/log/*", "diagnostics/statistics/quantiles"),
    fsai_hil: ("rules/**/*", "simulator/**/*", "evidence/campaign/**/*"),
}
"""Where the code is that decides a run: what is driven, the rules, and what these import of the diagnostics. The
command line, the nodes and the rest of the evidence change none."""


Header = Mapping[str, Any]
"""What decides every case of a campaign, and its verdict: records with the same header hold the same runs."""


class RecordError(ValueError):
    """A record that cannot be used; the message is one clear line."""


def files() -> dict[str, Path]:
    """What decides a run, by names that are the same wherever it is installed: code and signal databases."""
    found = {path.name: path for path in dbc_dir().glob("*.dbc")}
    for package, parts in DRIVEN.items():
        root = Path(str(package.__file__)).parent
        found |= {str(path.relative_to(root.parent)): path for part in parts for path in root.glob(f"{part}.py")}
    return found


@cache
def digest() -> str:
    """One short word for the code of this installation: runs of different code must not be mixed in one record."""
    return digest_of(files())


def read(path: Path) -> tuple[Header, list[dict[str, Any]]]:
    """Header and runs of a record. Raises RecordError, OSError."""
    lines = _lines(path)
    first = next(lines, None)
    if first is None or first.pop("campaign", None) != 1:
        raise RecordError(f"{path} is not the record of a fault campaign")
    # A case that was driven twice (two campaigns at once) counts once.
    runs = {(run["full"], run["index"]): run for run in lines}
    return {"sources": "unknown", **first}, list(runs.values())


def _lines(path: Path) -> Iterator[dict[str, Any]]:
    with path.open() as file:
        for number, line in enumerate(file, start=1):
            if not line.endswith("\n"):
                return  # the campaign was killed while it wrote this one
            try:
                yield json.loads(line)
            except json.JSONDecodeError:
                raise RecordError(f"{path}:{number}: not a line of a fault campaign's record") from None


def put_aside(path: Path) -> Path | None:
    """Give the record at `path` a name by which it is kept; None: there is none. Raises OSError."""
    if not path.exists() or not path.stat().st_size:
        return None
    number = 1
    while (kept := path.with_name(f"{path.stem}-before-{number}{path.suffix}")).exists():
        number += 1
    return path.rename(kept)


def of_other_sources(path: Path, header: Header) -> bool:
    """Whether the record at `path` was driven by other code than `header` names. Raises RecordError, OSError."""
    return path.exists() and path.stat().st_size > 0 and read(path)[0]["sources"] != header["sources"]


class Writer(AbstractContextManager["Writer"]):
    """Appends to a record, or begins it. `done` are the (full, index) pairs that it holds already."""

    def __init__(self, path: Path, header: Header) -> None:
        """Raises RecordError where the record that is there is another campaign's or other code's."""
        self.path = path
        self.runs: list[dict[str, Any]] = []
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.exists() and path.stat().st_size:
            before, self.runs = read(path)
            if before["sources"] != header["sources"]:
                raise RecordError(
                    f"{path} is of other sources ({before['sources']}, these are {header['sources']}):"
                    " without --resume, or with a new --out DIR, the campaign begins anew"
                )
            if before != header:
                raise RecordError(
                    f"{path} is the record of another campaign (seed {before['seed']}): --out DIR begins one"
                )
            self._cut_broken_line()
        self._file: IO[str] = path.open("a")
        if not self._file.tell():
            self._put({"campaign": 1, **header})

    @property
    def done(self) -> frozenset[tuple[bool, int]]:
        return frozenset((run["full"], run["index"]) for run in self.runs)

    def add(self, run: dict[str, Any]) -> None:
        self.runs.append(run)
        self._put(run)

    def _put(self, line: Mapping[str, Any]) -> None:
        self._file.write(json.dumps(line, ensure_ascii=False) + "\n")
        self._file.flush()

    def _cut_broken_line(self) -> None:
        data = self.path.read_bytes()
        if not data.endswith(b"\n"):
            self.path.write_bytes(data[: data.rfind(b"\n") + 1])

    def close(self) -> None:
        self._file.close()

    def __exit__(self, *_: object) -> None:
        self.close()
