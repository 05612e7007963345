"""Layouts of messages, remembered between two runs of a command, by the content of the files they come from.

A cache that cannot be read or written is no cache: nothing fails for it.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

from fsai_vcu.diagnostics.decode.layouts import MessageLayout, SignalLayout

_FORMAT: Final = 3  # counts up when what is remembered, or how it is made of a file, changes


def digest(paths: Sequence[Path]) -> str:
    """Of the files' contents, in their order. Raises OSError."""
    found = hashlib.sha256(f"{_FORMAT}".encode())
    for path in paths:
        content = path.read_bytes()
        found.update(f"{path.suffix.lower()} {len(content)} ".encode() + content)
    return found.hexdigest()


def recall(key: str) -> tuple[list[MessageLayout], int | None] | None:
    """What was kept under `key`: (layouts, baud rate)."""
    try:
        layouts, baudrate = json.loads(_file(key).read_bytes())  # named tuples have become lists
        return [_layout(*entry) for entry in layouts], baudrate
    except (OSError, ValueError, TypeError, AttributeError, RuntimeError):
        return None


def keep(key: str, layouts: Sequence[MessageLayout], baudrate: int | None) -> None:
    import tempfile  # here, and not for every command that finds what it needs

    text = json.dumps([layouts, baudrate])
    with suppress(OSError, RuntimeError):  # no home, no room, no right: then the next run loads the files again
        file = _file(key)
        file.parent.mkdir(parents=True, exist_ok=True)
        handle, unfinished = tempfile.mkstemp(dir=file.parent, prefix=".unfinished-")
        with os.fdopen(handle, "w") as out:
            out.write(text)
        Path(unfinished).replace(file)


def _file(key: str) -> Path:
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "fsai-vcu" / f"layouts-{key[:32]}.json"


def _layout(*entry: Any) -> MessageLayout:
    *head, senders, signals, plain = entry
    read = (
        SignalLayout._make([*rest, {int(raw): word for raw, word in choices.items()}]) for *rest, choices in signals
    )
    return MessageLayout._make([*head, tuple(senders), tuple(read), plain])
