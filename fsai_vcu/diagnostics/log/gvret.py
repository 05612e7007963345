"""SavvyCAN's own CSV, GVRET: a head that names the columns, times in microseconds, all else in hexadecimal."""

from __future__ import annotations

import re
from typing import Final

from fsai_vcu.diagnostics.log.candump_line import MAX_CLASSIC_DLC, MAX_EXTENDED_ID, MAX_SECONDS, MAX_STANDARD_ID
from fsai_vcu.diagnostics.log.frames import LogFrame
from fsai_vcu.diagnostics.log.problems import Problems
from fsai_vcu.diagnostics.log.rows import WAYS, Rows

HEAD: Final = re.compile(r'"?time stamp"?([,;\t])"?id"?\1', re.IGNORECASE)
"""A line that tells this format."""

_BUS: Final = "can"


class GvretRows(Rows):
    """Reads the lines of one file: the head first, which older versions write without `Dir`.

    A spreadsheet that saved it again has put quotes around the words, or another separator between them.
    """

    def __init__(self, told: Problems) -> None:
        super().__init__(told)
        self._columns: list[str] = []
        self._separator = ","

    def is_whole(self, line: str) -> bool:
        return re.fullmatch(r'.*[,;\t]"?[0-9A-Fa-f]{2}"?[,;\t]*\s*', line) is not None

    def __call__(self, line: str) -> LogFrame | None:
        """Return the frame on a line; None for the head, which names the columns."""
        if head := HEAD.match(line):
            self._separator = head[1]
        words = [word.strip().strip('"') for word in line.split(self._separator)]
        if head:
            self._columns = [word.lower() for word in words]
            return None
        if len(words) > max(len(self._columns), 1) + 1:  # a comma ends each row
            raise ValueError("not a line of GVRET")
        named = dict(zip(self._columns, words, strict=False))
        try:
            t_us, length = int(named["time stamp"]), int(named["len"])
            extended = named["extended"].lower() == "true"
            can_id = int(named["id"], 16)
            first = self._columns.index("d1")
            data = bytes(int(word, 16) for word in words[first : first + length])
        except (KeyError, ValueError):
            raise ValueError("not a line of GVRET") from None
        if not 0 <= t_us <= MAX_SECONDS * 1_000_000:
            raise ValueError(f"invalid time: {t_us}")
        if not 0 <= length <= MAX_CLASSIC_DLC:
            raise ValueError(f"{length} data bytes")
        if len(data) < length:
            raise ValueError(f"{len(data)} data bytes where {length} are announced")
        if not 0 <= can_id <= (MAX_EXTENDED_ID if extended else MAX_STANDARD_ID):
            raise ValueError(f"no {29 if extended else 11}-bit identifier: {named['id']}")
        sent = WAYS.get(named.get("dir", "").lower())
        return LogFrame(t_us * 1000, f"{_BUS}{named.get('bus', '0')}", can_id, data, extended, sent=sent)
