"""Finding and loading signal databases: the project's own, or an official file made fit for use.

Official files of 2026 declare one-bit flags signed, so that a set bit would read -1: such signals become unsigned here.
Signals that are absent are the codec's business.
"""

from __future__ import annotations

import logging
import re
from collections import OrderedDict
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import fsai_vcu.lean_cantools  # noqa: F401  # isort: skip
from cantools.database.can import Database, Message, Node
from cantools.database.namedsignalvalue import NamedSignalValue

from fsai_vcu.interface.bus_table import BY_ID, BY_NAME
from fsai_vcu.interface.database_text import loaded_without_orphans, read_database_text
from fsai_vcu.interface.errors import UserError
from fsai_vcu.interface.revisions import dbc_dir as dbc_dir

_UNIT_SUFFIXES = ("_Nm", "_rpm", "_deg", "_kmh", "_pct")
_NAME_LENGTH = 32  # longer names are cut by the tools that official files come from

# The parser passes over an unfinished last statement in silence, and with it over all that a file cut off there has
# lost: half the signals of a message, or the line that says that a signal is a float. Without a semicolon only its line
# end shows that a list of receivers is whole.
_WHOLE_MESSAGE = re.compile(r"BO_ \d+ \w+ *: *\d+ +\w+\s*")
_WHOLE_LIST = re.compile(r"(BU_|BS_) *:.*\n")
_NODES = re.compile(r"^[ \t]*BU_[ \t]*:([^\n]*)", re.MULTILINE)
_LONGEST_BYTES = 1785  # SAE J1939-21: the most that a message has, sent in many frames
_LONGEST_NAME = 500
_LARGEST = 1e30  # more than 64 bits hold, in any unit
_GAP = r"(?:\s|//[^\n]*(?:\n|\Z))"
_MESSAGE_LENGTH = re.compile(rf"\bBO_{_GAP}+\d+{_GAP}+\w+{_GAP}*:{_GAP}*(\d+)")
_MODEST_CHARACTERS = 128 << 10
_IMMODEST = re.compile(rf"SG_MUL_VAL_{_GAP}+\d|\d{{400}}")
_MULTIPLEXED = re.compile(rf"\bSG_{_GAP}+\w+{_GAP}+m\d")
_SIGNAL_PLACE = re.compile(rf":{_GAP}*(\d+){_GAP}*\|{_GAP}*(\d+){_GAP}*@")

logging.getLogger("cantools").addHandler(logging.NullHandler())  # else it says on stderr what a file has twice


class DatabaseError(UserError, ValueError):
    """A signal database that is missing, malformed or not this car's. The message is one line for a person."""


def load_database(paths: Iterable[Path | str]) -> Database:
    """Load DBC files into one database, this interface's messages strictly: no signals that overlap or leave the frame.

    Where two files describe the same identifier, the first one counts. Raises DatabaseError.
    """
    messages: dict[tuple[int, bool], Message] = {}
    nodes: dict[str, Node] = {}
    for path in paths:
        single = _load_one(Path(path))
        for message in single.messages:
            messages.setdefault((message.frame_id, message.is_extended_frame), message)
        for node in single.nodes:
            nodes.setdefault(node.name, node)
    if not messages:
        raise DatabaseError("no DBC file given that describes a message")
    return Database(messages=list(messages.values()), nodes=list(nodes.values()), strict=False)


def _load_one(path: Path) -> Database:
    """Load one DBC file, its messages of this interface strictly. Raises DatabaseError."""

    def load(text: str) -> Database:
        database = Database(strict=False)
        database.add_dbc_string(text)
        for message in database.messages:
            if message.frame_id in BY_ID or message.name in BY_NAME:
                message.refresh(strict=True)
        return database

    try:
        text = read_database_text(path, "dbc")
        check_lengths(path, text)
        if not is_modest(text):
            raise DatabaseError(f"{path}: not a valid DBC file: larger than any of this car's, or more multiplexed")
        database, _ = loaded_without_orphans(load, text)
    except FileNotFoundError:
        raise DatabaseError(f"{path}: no such DBC file") from None
    except OSError as error:
        raise DatabaseError(f"{path}: cannot be read: {error.strerror or error}") from error
    except DatabaseError:
        raise
    except Exception as error:  # the parser has no common base class for what a broken file makes it raise
        raise DatabaseError(f"{path}: not a valid DBC file: {_one_line(error)}") from error
    if not database.messages:
        raise DatabaseError(f"{path}: not a valid DBC file: it describes no message")
    check_bounds(path, database)
    check_whole(path, text)
    make_flags_unsigned(database)
    return database


def check_whole(path: Path, text: str, *, by_nodes: bool = False) -> None:
    """Raise DatabaseError for a DBC file that was cut off in its last statement.

    by_nodes: one without a line end is whole if it ends in the whole name of a node.
    """
    lines = (line.lstrip() for line in text.splitlines(keepends=True))
    statements = [line for line in lines if line and not line.startswith("//")]
    nodes = {"Vector__XXX", *(name for line in _NODES.findall(text) for name in line.split())} if by_nodes else set()
    if not statements or not _is_whole(statements[-1], nodes):
        raise DatabaseError(
            f"{path}: not a valid DBC file: it ends in the middle of a statement, or without a line end"
        )


def _is_whole(statement: str, nodes: set[str]) -> bool:
    if statement.rstrip().endswith(";") or _WHOLE_LIST.fullmatch(statement):
        return True
    ended = statement.endswith("\n") or re.split(r"[\s,]+", statement.rstrip())[-1] in nodes
    head, _, behind = statement.partition('"')
    _, _, receivers = behind.partition('"')
    if statement.startswith("SG_ ") and "[" in head and head.rstrip().endswith("]"):
        return ended and re.match(r" *\w", receivers) is not None
    return ended and _WHOLE_MESSAGE.fullmatch(statement) is not None


def check_lengths(path: Path, text: str) -> None:
    """Raise DatabaseError for a DBC file of messages or signals so long that the parser would make room for them."""
    for found in _MESSAGE_LENGTH.finditer(text):
        if _too_large(found[1], _LONGEST_BYTES):
            raise DatabaseError(f"{path}: not a valid DBC file: a message of more than {_LONGEST_BYTES} bytes")
    for found in _SIGNAL_PLACE.finditer(text):
        if any(_too_large(number, 8 * _LONGEST_BYTES) for number in found.groups()):
            raise DatabaseError(f"{path}: not a valid DBC file: a signal beyond {_LONGEST_BYTES} bytes")


def check_bounds(path: Path, database: Database) -> None:
    """Raise DatabaseError for a database, of any kind, whose messages, names or numbers are larger than any real one.

    Every frame of a log is taken apart by them: what is large here is large as many times as there are frames.
    """
    for message in database.messages:
        if not 0 <= message.length <= _LONGEST_BYTES:
            raise DatabaseError(f"{path}: a message of less than 0 or more than {_LONGEST_BYTES} bytes")
        if not 0 <= message.frame_id < 1 << 29:
            raise DatabaseError(f"{path}: a message whose identifier has not 29 bits at most")
        _check_texts(path, message.name, *message.senders)
        for signal in message.signals:
            _check_texts(path, signal.name, signal.unit or "", *map(str, (signal.choices or {}).values()))
            numbers = signal.scale, signal.offset, *(signal.choices or ())
            if not all(-_LARGEST < number < _LARGEST for number in numbers):
                raise DatabaseError(f"{path}: a number is invalid, or beyond {_LARGEST:g}")


def _check_texts(path: Path, *texts: object) -> None:
    for text in texts:
        if not isinstance(text, str):
            raise DatabaseError(f"{path}: a message, a signal or a node without a name")
        if len(text) > _LONGEST_NAME:
            raise DatabaseError(f"{path}: a name, a unit or a word of more than {_LONGEST_NAME} characters")


def is_modest(text: str) -> bool:
    """Return true where the parser's work on a DBC file is bounded: small texts can name millions of values."""
    if len(text) > _MODEST_CHARACTERS or _IMMODEST.search(text):
        return False
    return sum(1 for _ in _MULTIPLEXED.finditer(text)) <= 500


def _too_large(digits: str, most: int) -> bool:
    return len(digits.lstrip("0")) > len(str(most)) or int(digits[-18:]) > most


def make_flags_unsigned(database: Database) -> None:
    """Make one-bit signals 0 and 1, whatever their sign."""
    for message in database.messages:
        for signal in message.signals:
            if signal.length == 1 and signal.is_signed:
                signal.is_signed = False
                signal.minimum, signal.maximum = 0, 1
                if signal.choices:  # a table written for the signed reading names -1
                    names = {abs(raw): str(name) for raw, name in signal.choices.items()}
                    signal.choices = OrderedDict((raw, NamedSignalValue(raw, name)) for raw, name in names.items())
    database.refresh()


def find_named(things: Sequence[Any], name: str) -> Any:
    """The message or signal that the interface calls `name`, by any spelling seen in official files, or None."""
    bare = name
    for suffix in _UNIT_SUFFIXES:
        bare = bare.removesuffix(suffix)
    by_name = {thing.name: thing for thing in things}
    spellings = (name, name[:_NAME_LENGTH], bare, *(bare + suffix for suffix in _UNIT_SUFFIXES))
    return next((by_name[spelling] for spelling in spellings if spelling in by_name), None)


def _one_line(error: Exception) -> str:
    text = " ".join(str(error)[:2000].split())[:300]
    return text or type(error).__name__
