"""Files that somebody else may have put where they are: opened only as what they are meant to be, read only so far.

A file that a person *named* (a log, a configuration) may be a link to another. What is *found* in a folder that others
may write is opened only if it is a regular file with one name: no link leads the program to a file of somebody else,
no pipe keeps it waiting, no device is touched. All of it raises OSError, whose `strerror` ends a sentence.
"""

from __future__ import annotations

import errno
import os
import stat
import time
from contextlib import suppress
from pathlib import Path
from typing import BinaryIO, Final

MIB: Final = 1 << 20
SETTINGS_BYTES: Final = 64 << 10
"""Most that is read of a configuration, of operational limits, of what lies beside a log. None takes a tenth of it."""
TRACK_BYTES: Final = MIB
"""Most that is read of a track; the longest ones have 100 KiB."""
DATABASE_BYTES: Final = 4 * MIB
"""Most that is read of a signal database. cantools takes five seconds and 100 MiB for each MiB of it."""
UNPACKED_TIMES: Final = 100
"""Most that a packed log unpacks to, in its size. gzip makes one 10 to 17 times smaller."""
UNPACKED_BYTES: Final = 64 * MIB
"""Below it a log may unpack to anything."""
TOO_MUCH_PACKED: Final = f"it unpacks to more than {UNPACKED_TIMES} times its size, as no log does"

_KINDS: Final = {
    stat.S_IFIFO: "it is a pipe, not a file",
    stat.S_IFSOCK: "it is a socket, not a file",
    stat.S_IFCHR: "it is a device, not a file",
    stat.S_IFBLK: "it is a device, not a file",
    stat.S_IFLNK: "it is a link, not a file",
}
_CAREFUL: Final = os.O_CLOEXEC | os.O_NOCTTY | os.O_NONBLOCK
_NEW: Final = os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC


def is_there(path: Path | str) -> bool:
    """Return true where there is something, also if this user may not look: opening it says so."""
    try:
        return Path(path).exists()
    except PermissionError:
        return True
    except OSError:  # such as a name that is too long for any file
        return False


def is_file(path: Path | str) -> bool:
    """Return true where this user sees a file; what else is wrong with the place, opening it says."""
    try:
        return Path(path).is_file()
    except OSError:
        return False


def is_folder(path: Path | str) -> bool:
    """Return true where this user sees a folder; what else is wrong with the place, opening it says."""
    try:
        return Path(path).is_dir()
    except OSError:
        return False


def open_named(path: Path | str, *, pipes: bool = False) -> BinaryIO:
    """The file that a person named, for reading. pipes: one may be named as well, and is waited for."""
    kind = Path(path).stat().st_mode  # before it is opened: with some devices that alone does something
    if pipes and stat.S_ISFIFO(kind):
        return Path(path).open("rb")
    return os.fdopen(_opened(path, os.O_RDONLY, kind), "rb")


def open_found(path: Path | str, *, write: bool = False) -> BinaryIO:
    """A file found in a folder that others may write, for reading and, if asked, for changing it."""
    flags = (os.O_RDWR if write else os.O_RDONLY) | os.O_NOFOLLOW
    descriptor = _opened(path, flags, Path(path).lstat().st_mode)
    if os.fstat(descriptor).st_nlink > 1:
        os.close(descriptor)
        raise OSError(errno.EMLINK, "it has another name elsewhere (a hard link)", str(path))
    return os.fdopen(descriptor, "r+b" if write else "rb")


def open_new(path: Path | str) -> int:
    """The descriptor of a new file, for writing; what is there already, a link to nowhere too, is never opened."""
    return os.open(path, _NEW | os.O_WRONLY, 0o644)


def write_whole(path: Path | str, content: bytes) -> None:
    """Write the file that a person named, whole or not at all: what was there stays until all is written.

    A pipe or a device is written as it is, and so is what a link leads to. Who may read it stays as it was. Raises
    OSError.
    """
    place = Path(path)
    there = place.exists()
    if place.is_symlink() or (there and not place.is_file()):
        with place.open("wb") as file:
            file.write(content)
        return
    if there and not os.access(place, os.W_OK):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(path))
    mode = stat.S_IMODE(place.stat().st_mode) if there else 0o666
    beside = place.with_name(f".fsai-vcu.{time.time_ns()}")
    try:
        with os.fdopen(os.open(beside, _NEW | os.O_WRONLY, mode), "wb") as file:
            file.write(content)
        beside.replace(place)
    except BaseException as error:  # Ctrl-C too
        with suppress(OSError):  # it was never made
            beside.unlink()
        if isinstance(error, OSError):
            error.filename = str(path)
        raise


def open_lock(path: Path | str) -> BinaryIO:
    """The lock file in a folder that others may write: the one there, or a new one in place of what cannot be one."""
    try:
        return open_found(path, write=True)
    except FileNotFoundError:
        pass
    except IsADirectoryError:
        move_aside(path)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.ELOOP, errno.EMLINK):
            raise
        Path(path).unlink()
    try:
        return os.fdopen(os.open(path, _NEW | os.O_RDWR, 0o644), "r+b")
    except FileExistsError:  # another program was quicker
        return open_found(path, write=True)


def move_aside(path: Path | str) -> None:
    """A folder in the place of a file gets another name: it may hold something."""
    Path(path).rename(f"{path}.{time.time_ns()}")


def bytes_on_disk(status: os.stat_result) -> int:
    """Return how many bytes of a file are on the disk: a file with holes has less than its size."""
    return min(status.st_size, status.st_blocks * 512)  # the unit of st_blocks, whatever the file system's is


def read_named(path: Path | str, most_bytes: int, encoding: str = "utf-8", errors: str = "strict") -> str:
    """The text of a file that a person named, every line end in it a newline.

    Also raises OSError where it is larger than `most_bytes`, and UnicodeDecodeError.
    """
    with open_named(path) as file:
        text = _read(file, path, most_bytes).decode(encoding, errors)
    return text.replace("\r\n", "\n").replace("\r", "\n")


def read_found(path: Path | str, most_bytes: int) -> bytes:
    """The content of a file found in a folder that others may write. Raises OSError as `read_named`."""
    with open_found(path) as file:
        return _read(file, path, most_bytes)


def _read(file: BinaryIO, path: Path | str, most_bytes: int) -> bytes:
    content = file.read(most_bytes + 1)
    if len(content) > most_bytes:
        size = f"{most_bytes // MIB} MiB" if most_bytes >= MIB else f"{most_bytes >> 10} KiB"
        raise OSError(errno.EFBIG, f"it is larger than {size}", str(path))
    return content


def _opened(path: Path | str, flags: int, kind: int) -> int:
    """A descriptor of a regular file. kind: what it was a moment ago."""
    _check(path, kind)
    try:
        descriptor = os.open(path, flags | _CAREFUL)
    except OSError as error:
        if error.errno == errno.ELOOP:  # became a link meanwhile
            _check(path, stat.S_IFLNK)
        raise
    try:
        _check(path, os.fstat(descriptor).st_mode)
    except OSError:
        os.close(descriptor)
        raise
    return descriptor


def _check(path: Path | str, mode: int) -> None:
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    if not stat.S_ISREG(mode):
        raise OSError(errno.EINVAL, _KINDS.get(stat.S_IFMT(mode), "it is no file"), str(path))
