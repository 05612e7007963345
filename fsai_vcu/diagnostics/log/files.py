"""What can be known of a log without reading its frames, and what is reported of the parts that cannot be read."""

from __future__ import annotations

from typing import Final

_KEPT_PROBLEMS: Final = 1000  # kept as text; all are counted
_GZIP, _BLF, _MF4 = b"\x1f\x8b", b"LOGG", b"MDF "
_ASC_STARTS = (b"date ", b"base hex", b"base dec", b"// version")
_TRC_STARTS = (b";$FILEVERSION=", b";##############")  # the latter: version 1.0
_GVRET = b"time stamp,id,"


class Problems:
    """What could not be read in a log. `texts` are whole lines for people, each with its place; all are counted."""

    def __init__(self) -> None:
        self.count = 0
        self.texts: list[str] = []

    def add(self, text: str) -> None:
        self.count += 1
        if len(self.texts) < _KEPT_PROBLEMS:
            self.texts.append(text)

    def __bool__(self) -> bool:
        return self.count > 0

    def summary(self) -> str:
        """One line."""
        more = f" (and {self.count - 1} more like it or worse)" if self.count > 1 else ""
        return self.texts[0] + more if self.count else ""


def kind_of(head: bytes) -> str:
    """The format of a log, from its first bytes; 'gzip' is still to be unpacked."""
    if is_gzip(head):
        return "gzip"
    if head.startswith(_BLF):
        return "BLF"
    if head.startswith(_MF4):
        return "MF4"
    if head.lower().startswith(_ASC_STARTS):
        return "ASC"
    if head.startswith(_TRC_STARTS):
        return "TRC"
    if head.lower().startswith(_GVRET):
        return "GVRET"
    return "candump"


def is_gzip(head: bytes) -> bool:
    return head.startswith(_GZIP)
