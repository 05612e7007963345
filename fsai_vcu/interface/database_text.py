"""The text of a database file: its encoding told by its bytes, and without the entries that belong to nothing."""

from __future__ import annotations

import codecs
import re
from collections.abc import Callable
from pathlib import Path
from typing import Final, TypeVar

from fsai_vcu.files import DATABASE_BYTES, read_named

_Loaded = TypeVar("_Loaded")

_STRING: Final = r'"(?:[^"\\]|\\.)*"'
_MESSAGE: Final = re.compile(r"^[ \t]*BO_\s+(\d{1,10})\s+(\w+)[^\n]*(?:\n[ \t]*SG_[^\n]*)*", re.MULTILINE)
_SIGNAL: Final = re.compile(r"^[ \t]*SG_\s+(\w+)", re.MULTILINE)
_DEFINED: Final = re.compile(r'^[ \t]*BA_DEF_(?:REL_)?\s+(?:\w+_\s+)?"(\w+)"', re.MULTILINE)
# Statements that say something of a signal, of a message, of an attribute.
_OF_SIGNAL: Final = re.compile(
    rf"^[ \t]*(VAL_|SIG_VALTYPE_|SG_MUL_VAL_)\s+(\d{{1,10}})\s+(\w+)[^;\"]*(?:{_STRING}[^;\"]*)*;", re.MULTILINE
)
_OF_MESSAGE: Final = re.compile(r"^[ \t]*(BO_TX_BU_|SIG_GROUP_)\s+(\d{1,10})\b[^;\"]*;", re.MULTILINE)
_OF_ATTRIBUTE: Final = re.compile(
    rf'^[ \t]*(BA_|BA_REL_|BA_DEF_DEF_|BA_DEF_DEF_REL_)\s+"(\w+)"[^;"]*(?:{_STRING}[^;"]*)*;', re.MULTILINE
)
_ENUM: Final = re.compile(
    rf'^[ \t]*BA_DEF_\s+(?:\w+_\s+)?"(\w+)"\s+ENUM\s+({_STRING}(?:\s*,\s*{_STRING})*)', re.MULTILINE
)
_CHOSEN: Final = re.compile(r"\s(\d{1,10})\s*;\Z")  # the number of a word of such an attribute
_WORDS: Final = {
    "VAL_": "value tables",
    "SIG_VALTYPE_": "types",
    "SG_MUL_VAL_": "multiplexing",
    "BO_TX_BU_": "senders",
    "SIG_GROUP_": "groups",
    "BA_": "values",
    "BA_REL_": "values",
    "BA_DEF_DEF_": "defaults",
    "BA_DEF_DEF_REL_": "defaults",
}
_INDEPENDENT: Final = "VECTOR__INDEPENDENT_SIG_MSG"  # a place for signals that are in no message
_EXTENDED: Final = 1 << 31
_MAX_STANDARD_ID: Final = 0x7FF
_DOS_END: Final = b"\x1a"  # as DOS ended a text
_NAMED: Final = 5


def read_database_text(path: Path | str, kind: str) -> str:
    """A database's text. Without a mark UTF-8 where it is, else what the tools that write DBC and SYM files use.

    Raises OSError as `read_named`.
    """
    content = read_named(path, DATABASE_BYTES, "latin-1").encode("latin-1").removesuffix(_DOS_END)
    for mark, encoding in (
        (codecs.BOM_UTF8, "utf-8"),
        (codecs.BOM_UTF16_LE, "utf-16-le"),
        (codecs.BOM_UTF16_BE, "utf-16-be"),
    ):
        if content.startswith(mark):
            return content[len(mark) :].decode(encoding, "replace")
    if kind not in ("dbc", "sym"):
        return content.decode("utf-8", "replace")
    try:
        return content.decode("utf-8")
    except UnicodeDecodeError:
        return content.decode("cp1252", "replace")


def loaded_without_orphans(load: Callable[[str], _Loaded], text: str) -> tuple[_Loaded, str]:
    """Load a DBC file's text by `load`; if that refuses it, load the text without entries that belong to nothing.

    Returns what `load` returned, and a sentence on what was left out, or ''. Raises what `load` raises of the text as
    it is.
    """
    try:
        return load(text), ""
    except Exception as refused:  # cantools' parsers have no common base class for what they raise
        pruned, left_out = without_orphans(text)
        if not left_out:
            raise
        try:
            return load(pruned), left_out
        except Exception:
            raise refused from None


def without_orphans(text: str) -> tuple[str, str]:
    """The text of a DBC file without entries of signals, messages and attributes that it does not describe.

    Also a sentence on what was left out, or ''.
    """
    signals: dict[int, set[str]] = {}
    attributes = set(_DEFINED.findall(text))
    orphans: dict[str, list[str]] = {}

    def message(found: re.Match[str]) -> str:
        number = int(found[1])
        if found[2] != _INDEPENDENT:
            if _MAX_STANDARD_ID < number < _EXTENDED:
                orphans.setdefault("messages with identifiers of more than 11 bits", []).append(found[2])
                return ""
            signals.setdefault(number, set()).update(_SIGNAL.findall(found[0]))
        return found[0]

    def checked(what: str, is_known: Callable[[re.Match[str]], bool]) -> Callable[[re.Match[str]], str]:
        def kept(found: re.Match[str]) -> str:
            if is_known(found):
                return found[0]
            orphans.setdefault(f"{_WORDS[found[1]]} of unknown {what}", []).append(found[found.lastindex or 2])
            return ""

        return kept

    text = _MESSAGE.sub(message, text)
    text = _OF_SIGNAL.sub(checked("signals", lambda found: found[3] in signals.get(int(found[2]), ())), text)
    text = _OF_MESSAGE.sub(checked("messages", lambda found: int(found[2]) in signals), text)
    words = {found[1]: len(re.findall(_STRING, found[2])) for found in _ENUM.finditer(text)}

    def is_chosen(found: re.Match[str]) -> bool:
        number = _CHOSEN.search(found[0]) if found[1] == "BA_" and found[2] in words else None
        return number is None or int(number[1]) < words[found[2]]

    text = _OF_ATTRIBUTE.sub(checked("attributes", lambda found: found[2] in attributes), text)
    text = _OF_ATTRIBUTE.sub(checked("words of attributes", is_chosen), text)
    parts = []
    for what, names in orphans.items():
        more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
        parts.append(f"{what} left out: {', '.join(name[:40] for name in names[:_NAMED])}{more}")
    return text, "; ".join(parts)
