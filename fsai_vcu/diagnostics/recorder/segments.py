"""Place of a recording: one file, or a folder of numbered segments whose oldest give way to the newest."""

from __future__ import annotations

import fcntl
import os
import re
import shutil
import stat
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Final

from fsai_vcu.files import bytes_on_disk, open_lock
from fsai_vcu.interface.errors import UserError

_DIGITS: Final = 6
_KINDS: Final = (".log", ".mcap", ".json")
_RANGE: Final = 10**_DIGITS - 1  # segments are numbered from 1 to it, and then from 1 again
_PARTS: Final = 4  # a segment is at most such a part of all: what is deleted is never most of what there is


@dataclass(frozen=True, slots=True)
class Bounds:
    """Bounds of a recording on the disk. None: no bound. keep_free_bytes: what is always left free, for all else."""

    segment_bytes: int | None = None
    segment_ns: int | None = None
    total_bytes: int | None = None
    keep_free_bytes: int = 0


class SegmentFolder:
    """Names the files of each segment, and makes room for what comes."""

    def __init__(self, path: Path, prefix: str, bounds: Bounds) -> None:
        """A path with a suffix is one file, which must not be there; any other a folder, which is gone on with.

        Raises UserError and OSError.
        """
        self.single = path.suffix != "" and not path.is_dir()
        self.path = path
        self.bounds = bounds
        self._prefix = re.sub(r"[^\w.-]+", "_", prefix) or "bus"
        self._pattern = re.compile(rf"{re.escape(self._prefix)}-([0-9]{{{_DIGITS}}})(\.log|\.mcap|\.json)")
        self._lock: IO[bytes] | None = None
        self.number = 0
        if self.single:
            for kind in _KINDS:
                if os.path.lexists(self.file(kind)):
                    raise UserError(f"{self.file(kind)} exists already; name another file, or a folder to continue in")
        else:
            path.mkdir(parents=True, exist_ok=True)
            self._lock = open_lock(path / f".{self._prefix}.lock")
            try:
                fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError as error:
                self._lock.close()
                raise UserError(f"another program records '{self._prefix}' in {path} already") from error
            self.number = self._newest()

    @property
    def segment_bytes(self) -> int | None:
        if self.bounds.total_bytes is None or self.bounds.segment_bytes is None:
            return self.bounds.segment_bytes
        return min(self.bounds.segment_bytes, self.bounds.total_bytes // _PARTS)

    def file(self, kind: str, number: int | None = None) -> Path:
        """The file of that kind ('.log') of a segment: the one in hand, unless another is named."""
        if self.single:
            return self.path if kind == ".log" else self.path.with_suffix(kind)
        return self.path / f"{self._prefix}-{self.number if number is None else number:0{_DIGITS}d}{kind}"

    def all_files(self, kind: str) -> list[Path]:
        """List the files of every segment, the oldest first."""
        found = [(self._age(number), path) for number, path in self._files() if path.suffix == kind]
        return [path for _, path in sorted(found, reverse=True)]

    def begin_segment(self) -> None:
        """The next number is the one in hand: of none is there anything."""
        if not self.single:
            self.number = self._newest() % _RANGE + 1

    def _newest(self) -> int:
        """The number behind which the largest gap begins, numbers going round; 0 where there is none.

        A number far off, at the end of the range or beyond what was recorded, is thereby no end of recording.
        """
        taken = sorted({number for number, _ in self._files()} | {self.number} - {0})
        behind = [*taken[1:], taken[0] + _RANGE] if taken else []
        gaps = [later - number for number, later in zip(taken, behind, strict=True)]
        if gaps and max(gaps) == 1:
            raise OSError(f"all {_RANGE} numbers of segments are taken")
        return taken[gaps.index(max(gaps))] if gaps else 0

    def delete(self, number: int | None = None) -> None:
        """All files of a segment: the one in hand, unless another is named."""
        for kind in _KINDS:
            with suppress(IsADirectoryError):  # no file of a recorder
                self.file(kind, number).unlink(missing_ok=True)

    def make_room(self, bytes_to_come: int) -> None:
        """Delete the oldest segments until there is room. Raises OSError where that is not enough."""
        folder = self.path.parent if self.single else self.path
        segments = {} if self.single else self._segments()
        older = sorted((number for number in segments if number != self.number), key=self._age, reverse=True)
        total = sum(segments.values()) + bytes_to_come
        most = None if self.single else self.bounds.total_bytes
        wanted = self.bounds.keep_free_bytes + bytes_to_come
        for number in older:
            if (most is None or total <= most) and shutil.disk_usage(folder).free >= wanted:
                return
            self.delete(number)
            total -= segments[number]
        free = shutil.disk_usage(folder).free
        if self.bounds.keep_free_bytes and free < wanted:
            raise OSError(
                f"only {free >> 20} MB free on the disk, but {self.bounds.keep_free_bytes >> 20} MB must stay free"
            )
        if most is not None and total > most and len(segments) > 1:
            raise OSError(f"more than {most >> 20} MB in one segment")

    def _age(self, number: int) -> int:
        """Return how many numbers a segment is before the one in hand."""
        return (self.number - number) % _RANGE

    def _segments(self) -> dict[int, int]:
        """Bytes of each segment on the disk, by number. What is no regular file is none of a segment."""
        found: dict[int, int] = {}
        for number, path in self._files():
            try:
                entry = path.lstat()
            except OSError:
                continue  # deleted meanwhile
            if stat.S_ISREG(entry.st_mode):
                found[number] = found.get(number, 0) + bytes_on_disk(entry)
        return found

    def _files(self) -> Iterator[tuple[int, Path]]:
        for path in self.path.iterdir():
            match = self._pattern.fullmatch(path.name)
            if match and (number := int(match[1])):
                yield number, path

    def close(self) -> None:
        if self._lock is not None:
            self._lock.close()
