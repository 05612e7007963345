"""Which code a campaign drives, as one short word: runs of different code must not be mixed in one record.

What counts is every module that a run uses, found by following the imports from the scenario on, and the signal
databases. The runner, the command line and what only real processes need change no run, and are left out.
"""

from __future__ import annotations

import ast
import hashlib
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Final

import fsai_hil
import fsai_vcu
from fsai_vcu.interface.revisions import dbc_dir

ROOT: Final = "fsai_hil.evidence.campaign.scenario"  # drives and judges a case; `cases` is imported by it
DIGITS: Final = 12


@cache
def digest() -> str:
    """The word for the code of this installation."""
    return digest_of({name: path.read_bytes() for name, path in files().items()})


def digest_of(contents: Mapping[str, bytes]) -> str:
    """The word for files of these names and contents."""
    found = hashlib.sha256()
    for name in sorted(contents):
        found.update(f"{name}\0{len(contents[name])}\0".encode())
        found.update(contents[name])
    return found.hexdigest()[:DIGITS]


def files() -> dict[str, Path]:
    """What the digest is made of, by names that are the same wherever it is installed."""
    found: dict[str, Path] = {}
    waiting = [ROOT]
    while waiting:
        name = waiting.pop()
        if name in found:
            continue
        path = _path_of(name)
        if path is None:
            continue  # a name in a module
        found[name] = path
        waiting += _imported(path)
        waiting += [name.rsplit(".", count)[0] for count in range(1, name.count(".") + 1)]
    return found | {path.name: path for path in sorted(dbc_dir().glob("*.dbc"))}


def _path_of(module: str) -> Path | None:
    package, _, rest = module.partition(".")
    base = {"fsai_vcu": fsai_vcu, "fsai_hil": fsai_hil}.get(package)
    if base is None or base.__file__ is None:
        return None
    inside = Path(base.__file__).parent.joinpath(*filter(None, rest.split(".")))
    return next((path for path in (inside.with_suffix(".py"), inside / "__init__.py") if path.is_file()), None)


def _imported(path: Path) -> Iterator[str]:
    for node in ast.walk(ast.parse(path.read_bytes())):
        if isinstance(node, ast.Import):
            yield from (one.name for one in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module is not None:
            yield node.module
            yield from (f"{node.module}.{one.name}" for one in node.names)
