"""Lines of candump with all that candump, a terminal and a journal write beside and around them."""

from __future__ import annotations

import re
from typing import Final

from fsai_vcu.diagnostics.log.candump_line import parse_line, whole_line
from fsai_vcu.diagnostics.log.frames import LogFrame
from fsai_vcu.diagnostics.log.rows import Pattern, Rows
from fsai_vcu.printable import printable

_COLOUR = re.compile(r"\x1b\[[0-9;]*[A-Za-z]")
HEAD: Final = re.compile(
    r"(?:\x1b\[[0-9;]*m|[^#\[\]]|\[\d{2,}\])*?(?:\(\d{1,11}\.\d{1,9}\)\s+\S+\s+[0-9A-F]{3,8}#|"
    r"\s[0-9A-F]{3,8}(?:\x1b\[[0-9;]*m)?\s+\[\d+\](?:\s|$)|DROPCOUNT: dropped)",
    re.IGNORECASE,
)
"""A line that tells this format."""

_DROPPED = re.compile(r"DROPCOUNT: dropped (\d{1,18}) CAN frame")
_ERROR_TEXT = re.compile(r"\t[a-z][a-z-]*(\{.*\})?\s*")  # what -e writes below an error frame
_SAID = re.compile(
    r"interface = \S+, family = .*|disabled standard output while logging\.?|Warning: console output active.*|"
    r"Enabling Logfile '.*'|new index \d+ \(\S+\)"
)
_SHORTEST: Final = 15  # of what is said in full sentences, or stands before a frame
_BEHIND_PREFIX = re.compile(r"(?:[^()#\[\]]|\[\d+\])*?\s(\(\d[\d.]*\)\s+\S+\s+\S.*)")


_ROW = Pattern(
    re.compile(
        rb" {0,8}(?:\((?P<time>\d{1,10})\.(?P<decimals>\d{6})\) {1,8})?(?P<channel>[^\s()\0]{1,15}) {1,8}"
        rb"(?:(?P<way>[RT])X - -  )?(?P<id>[0-9A-Fa-f]{8}|[0-9A-Fa-f]{3})"
        rb"(?:(?(way)(?!))(?(time)|(?!))#| {1,8}\[(?P<length>[0-8])\] )"  # a log has times, and its marks at the end
    ),
    lambda found: printable(found["channel"].decode("ascii", "replace")),
    lambda found: len(found["id"]) > 3,
    marked=True,
    tail=None,
)


class CandumpRows(Rows):
    """Reads the lines of one log, or of a screen."""

    encoding = "ascii"

    def pattern(self) -> Pattern:
        return _ROW

    def is_whole(self, line: str) -> bool:
        return whole_line(line)

    def __call__(self, line: str) -> LogFrame | None:
        """Return the frame on a line; count lost frames that candump tells, and skip what is beside the frames."""
        try:
            return parse_line(line)
        except ValueError as error:
            if len(line) < _SHORTEST and not line.startswith("\t"):
                raise  # a file of lines of nothing is done with soon
            plain = _COLOUR.sub("", line)
            if dropped := _DROPPED.search(plain):
                self.told.lost += int(dropped[1])
                return None
            if _ERROR_TEXT.fullmatch(plain) or _SAID.fullmatch(plain.strip()):
                return None
            behind = _BEHIND_PREFIX.fullmatch(plain)
            if behind is None and plain == line:
                raise error
        return parse_line(behind[1] if behind else plain)
