"""Log files as a command line names them: a folder as the logs in it, and when each begins."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Final

from fsai_vcu.diagnostics.log.filters import name_and_filters
from fsai_vcu.diagnostics.log.formats import format_of
from fsai_vcu.diagnostics.log.frames import EPOCH_NS
from fsai_vcu.diagnostics.log.reader import NO_LOGS, LogError, open_log
from fsai_vcu.diagnostics.log.stream import HEAD_BYTES
from fsai_vcu.files import open_named
from fsai_vcu.interface.errors import UserError
from fsai_vcu.interface.units import S

LOG_SUFFIXES: Final = frozenset({".log", ".blf", ".asc", ".mf4", ".trc", ".pcap", ".pcapng", ".crtd"})
_MAY_BE_LOGS: Final = frozenset({".csv", ".txt", ".db", ".db3", ".sqlite"})  # their content tells
NOTHING_READ: Final = 1 << 63  # later than any log begins


def first_stamp(path: Path) -> tuple[int, str]:
    """Return when a log begins (ns), and its name. A log that cannot be read comes last; its opening reports that."""
    try:
        with open_log(str(path)) as log:
            return next((frame.t_ns for frame in log.frames()), NOTHING_READ), path.name
    except LogError:
        return NOTHING_READ, path.name


def goes_on(before_ns: int, first_ns: int) -> bool:
    """True where a log may go on by the clock of one that began at `before_ns`: both have dates, or one counter."""
    dated = before_ns >= EPOCH_NS, first_ns >= EPOCH_NS
    return all(dated) or (not any(dated) and first_ns - before_ns > S)


def last_stamp(name: str) -> int:
    """Return when a log ends (ns); 0 where nothing of it can be read, which is reported when it is opened again."""
    last_ns = 0
    try:
        with open_log(name) as log:
            for frames in log.chunks():
                last_ns = int(frames.t_ns[-1]) if len(frames) else last_ns
    except LogError:
        pass
    return last_ns


def unfolded(name: str, left_out: list[Path]) -> list[str]:
    """A folder as the logs in it, in the order of time; anything else as it is. left_out: gets its other files."""
    folder, filters = name_and_filters(name)
    if folder == "-" or not _holds(folder, Path.is_dir):
        return [name]
    files = sorted(path for path in Path(folder).iterdir() if path.is_file())
    logs = [path for path in files if _log_like(path)]
    left_out += [path for path in files if path not in logs and not _beside_logs(path)]
    logs.sort(key=first_stamp)
    if not logs:
        raise UserError(f"{folder}: no log in this folder")
    return [f"{path},{filters}" if filters else str(path) for path in logs]


def _beside_logs(path: Path) -> bool:
    """True for a file that a recording or a drive leaves beside its log, and that nobody takes for a log."""
    return path.name.startswith(".") or path.suffix.lower() in NO_LOGS


def _log_like(path: Path) -> bool:
    """Tell by its name whether a file may be a log; tables and other texts are looked into."""
    suffixes = {suffix.lower() for suffix in path.suffixes}
    if suffixes & _MAY_BE_LOGS and not suffixes & LOG_SUFFIXES:
        try:
            with open_named(path) as file:
                return format_of(file.read(HEAD_BYTES)) is not None
        except OSError:
            return False
    return bool(suffixes & LOG_SUFFIXES)


def _holds(name: str, condition: Callable[[Path], bool]) -> bool:
    """Return whether the condition holds for a file of that name; raise UserError for a name too long for one."""
    try:
        return condition(Path(name))
    except OSError as error:
        raise UserError(f"{name}: {error.strerror}") from error


def is_log(name: str) -> bool:
    """Tell a log from an interface, which is no file and does not look like one: can0, vcan0, loopback:NAME."""
    path = Path(name)
    if name == "-" or _holds(name, Path.exists):
        return True
    return ":" not in name and ("/" in name or path.suffix != "")
