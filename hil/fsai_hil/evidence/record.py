"""Results on disk as JSON lines, one for each, after a header that says what they are results of.

Lines are appended whole and flushed, so that work that is killed goes on where it was; a line cut short by the kill is
left out when the record is read, and written over.
"""

from __future__ import annotations

import fcntl
import hashlib
import json
from collections.abc import Mapping
from contextlib import AbstractContextManager
from functools import cache
from pathlib import Path
from typing import Any, Final

import fsai_hil
import fsai_vcu
from fsai_vcu.interface.revisions import dbc_dir

DRIVEN: Final = {
    fsai_vcu: ("core/**/*", "interface/**/*", "runtime/**/*", "diagnostics/log/*", "diagnostics/statistics/quantiles"),
    fsai_hil: ("rules/**/*", "simulator/**/*", "evidence/campaign/**/*"),
}
"""Where the code is that decides a run: what is driven, the rules, and what these import of the diagnostics. The
command line, the nodes and the rest of the evidence change none."""

Header = Mapping[str, Any]
"""What decides every result: records with the same header hold the same. Its first key is the record's kind."""


class RecordError(ValueError):
    """A record that cannot be used; the message is one clear line."""


def digest_of(files: Mapping[str, Path]) -> str:
    """One short word for these files, by names that are the same wherever they are installed."""
    found = hashlib.sha256()
    for name, path in sorted(files.items()):
        found.update(f"{name}\0".encode() + path.read_bytes() + b"\0")
    return found.hexdigest()[:12]


def driven_files() -> dict[str, Path]:
    """What decides a run, by names that are the same wherever it is installed: code and signal databases."""
    found = {path.name: path for path in dbc_dir().glob("*.dbc")}
    for package, parts in DRIVEN.items():
        root = Path(str(package.__file__)).parent
        found |= {str(path.relative_to(root.parent)): path for part in parts for path in root.glob(f"{part}.py")}
    return found


@cache
def digest() -> str:
    """One short word for the code of this installation: runs of different code must not be mixed in one record."""
    return digest_of(driven_files())


def read(path: Path, kind: str) -> tuple[Header, list[Any]]:
    """Header and results of a record. Raises RecordError, OSError."""
    found = []
    for number, line in enumerate(path.read_text().splitlines(keepends=True), 1):
        if line.endswith("\n"):
            try:
                found.append(json.loads(line))
            except json.JSONDecodeError:
                raise RecordError(f"{path}:{number}: not a line of a record") from None
    if not found or not isinstance(found[0], dict) or kind not in found[0]:
        raise RecordError(f"{path} is not a record of the kind {kind!r}")
    return found[0], found[1:]


class Record(AbstractContextManager["Record"]):
    """A record that is appended to, or begun. `results`: what it holds; `kept_as`: what its place held before."""

    def __init__(self, path: Path, header: Header, *, resume: bool = True) -> None:
        """One with another header is kept by another name, and without `resume` any is.

        Raises RecordError where the file is no record of this kind, or is written to by another process, OSError.
        """
        self.path, self.results, self.kept_as = path, list[Any](), None
        path.parent.mkdir(parents=True, exist_ok=True)
        self._file = path.open("a")
        try:
            self._lock()
            whole_bytes = path.read_bytes().rfind(b"\n") + 1
            if whole_bytes:
                before, results = read(path, next(iter(header)))
                if resume and before == header:
                    self.results = results
                    self._file.truncate(whole_bytes)
                    return
                self.kept_as = _put_aside(path)
                self._file.close()
                self._file = path.open("a")
                self._lock()
            else:
                self._file.truncate(0)
        except BaseException:
            self._file.close()
            raise
        self._put(header)

    def _lock(self) -> None:
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise RecordError(f"{self.path} is being written by another process") from None

    def add(self, result: Any) -> None:
        self.results.append(result)
        self._put(result)

    def _put(self, line: Any) -> None:
        print(json.dumps(line, ensure_ascii=False), file=self._file, flush=True)

    def __exit__(self, *_: object) -> None:
        self._file.close()


def _put_aside(path: Path) -> Path:
    number = 1
    while (kept := path.with_name(f"{path.stem}-before-{number}{path.suffix}")).exists():
        number += 1
    return path.rename(kept)
