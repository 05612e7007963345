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

_FORMAT: Final = 4  # counts up when what is remembered, or how it is made of a file, changes


def recall(contents: Sequence[tuple[str, bytes]]) -> tuple[list[MessageLayout], int | None] | None:
    """What was kept of files with these (suffix, content): (layouts, baud rate)."""
    try:
        layouts, baudrate = json.loads(_file(contents).read_bytes())  # named tuples have become lists
        return [_layout(*entry) for entry in layouts], baudrate
    except (OSError, ValueError, TypeError, AttributeError, RuntimeError):
        return None


def keep(contents: Sequence[tuple[str, bytes]], layouts: Sequence[MessageLayout], baudrate: int | None) -> None:
    with suppress(OSError, RuntimeError):  # no home, no room, no right: then the next run loads the files again
        file = _file(contents)
        file.parent.mkdir(parents=True, exist_ok=True)
        unfinished = file.with_suffix(f".{os.getpid()}")
        unfinished.write_text(json.dumps([layouts, baudrate]))
        unfinished.replace(file)


def _file(contents: Sequence[tuple[str, bytes]]) -> Path:
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    digest = hashlib.sha256(repr((_FORMAT, contents)).encode()).hexdigest()
    return Path(base) / "fsai-vcu" / f"layouts-{digest[:32]}.json"


def _layout(*entry: Any) -> MessageLayout:
    *head, senders, signals, plain = entry
    read = (
        SignalLayout._make([*rest, {int(raw): word for raw, word in choices.items()}]) for *rest, choices in signals
    )
    return MessageLayout._make([*head, tuple(senders), tuple(read), plain])
