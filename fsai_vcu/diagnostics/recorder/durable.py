"""A file to which bytes are added, safe on the disk after every `push`."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path

from fsai_vcu.files import move_aside, open_new


class DurableFile:
    """File whose text waits in memory until `push` has it on the disk.

    After a `push` that failed (a full disk), the file ends where the last good one left it, nothing of what waits is
    lost, and `push` may be tried again.
    """

    def __init__(self, path: Path) -> None:
        """A new file, in the folder's directory on the disk. Raises OSError, also where there is one already."""
        self.path = path
        self._descriptor = open_new(path)
        self._waiting = bytearray()
        self._safe = 0
        sync_folder(path.parent)

    @property
    def waiting(self) -> int:
        return len(self._waiting)

    @property
    def removed(self) -> bool:
        """Return true where the file was deleted: what is written now would be nowhere."""
        return os.fstat(self._descriptor).st_nlink == 0

    def push(self) -> None:
        """All that waits is on the disk. Raises OSError."""
        if not self._waiting:
            return
        try:
            with memoryview(self._waiting) as waiting:
                at = 0
                while at < len(waiting):
                    at += os.pwrite(self._descriptor, waiting[at:], self._safe + at)
            os.fdatasync(self._descriptor)
        except OSError:
            with contextlib.suppress(OSError):
                os.ftruncate(self._descriptor, self._safe)
            raise
        self._safe += len(self._waiting)
        self._waiting.clear()

    def close(self) -> None:
        """Close the file without a `push`."""
        os.close(self._descriptor)

    # Methods that a writer of a format needs of a stream.

    def write(self, data: bytes | bytearray | memoryview) -> int:
        self._waiting += data
        return len(data)

    def tell(self) -> int:
        """Return how many bytes there are, on the disk and waiting."""
        return self._safe + len(self._waiting)

    def flush(self) -> None:
        """Do nothing: only what `push` has written is kept through a loss of power."""


def sync_folder(folder: Path) -> None:
    """Make what was created, renamed or deleted in the folder outlast a power cut."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def replace_durably(path: Path, text: str) -> None:
    """`path` has this text, or the one before, but never half of it. Raises OSError."""
    beside = path.with_name(path.name + ".new")
    for place in (beside, path):
        if place.is_dir() and not place.is_symlink():
            move_aside(place)
    beside.unlink(missing_ok=True)  # of a power cut, or of somebody else
    try:
        with os.fdopen(open_new(beside), "w", encoding="utf-8") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        beside.replace(path)
        sync_folder(path.parent)
    except OSError:
        beside.unlink(missing_ok=True)
        raise
