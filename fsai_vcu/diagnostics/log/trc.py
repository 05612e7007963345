"""PEAK's text format TRC, versions 1.0 to 3.0: comments that name version, start and columns, then numbered rows."""

from __future__ import annotations

import re
from functools import cache
from typing import Final

from fsai_vcu.diagnostics.log.candump_line import MAX_NS
from fsai_vcu.diagnostics.log.frames import LogFrame
from fsai_vcu.diagnostics.log.problems import Problems
from fsai_vcu.diagnostics.log.rows import (
    BUS_ERROR,
    BUS_OFF,
    CONTROLLER,
    FD_BYTES,
    FORM,
    PASSIVE,
    PROTOCOL,
    SINGLE_BIT,
    STUFFING,
    WARNING,
    WAYS,
    Pattern,
    Rows,
    bytes_of,
    error_frame,
    frame_of,
    ns_of,
)
from fsai_vcu.interface.units import MS

HEAD: Final = re.compile(r";\$FILEVERSION=|;#{14}|\d+\)\s+\d+(\.\d+)?\s", re.IGNORECASE)
"""A line that tells this format."""

# Patterns of most rows: by the letter of their column in versions 2 and 3, and in the order of each version 1.
_ROW: Final = {
    "N": rb" *(?P<number>\d{1,9})",
    "O": rb"(?P<time>\d{1,12})(?:\.(?P<decimals>\d{1,6}))?",
    "T": rb"DT",
    "B": rb"(?P<channel>\d{1,3})",
    "I": rb"(?P<id>[0-9A-Fa-f]{1,8})",
    "d": rb"(?P<way>[RT])x",
    **dict.fromkeys("RVSArs", rb"-"),
    **dict.fromkeys("Ll", rb"(?P<length>[0-8])"),
    "D": rb"(?: *(?= [0-9A-Fa-f]{2})|)",  # the spaces before the one with which each byte begins
    ")": rb" *(?P<number>\d{1,9})\)",
}
_VERSIONS_1: Final = {(1, 0): ")OILD", (1, 1): ")OdILD", (1, 2): ")OBdILD", (1, 3): ")OBdIRLD"}

_OLDEST, _NEWEST = (1, 0), (3, 0)
_DAYS_TO_1970: Final = 25569  # from 1899-12-30
_DAY_NS: Final = 86_400_000_000_000
_COLUMNS: Final = {(2, 0): "NOTIdlD", (2, 1): "NOTBIdRLD"}
_FD: Final = {"FD": (False, False), "FB": (True, False), "FE": (False, True), "BI": (True, True)}  # BRS, ESI
_STATES: Final = (
    (0x10, BUS_OFF, 0),
    (0x04_0000, CONTROLLER, PASSIVE),
    (0x08, CONTROLLER, PASSIVE),
    (0x04, CONTROLLER, WARNING),
)
_LOST: Final = 0x42  # the controller, or the queue behind it, was read too late
_VIOLATIONS: Final = {1: SINGLE_BIT, 2: FORM, 4: STUFFING}


class TrcRows(Rows):
    """Reads the rows of one file. Raises ValueError for every row of a version that is not known."""

    def __init__(self, told: Problems) -> None:
        super().__init__(told)
        self._version = (1, 0)
        self._start_ns = 0
        self._columns = ""

    def pattern(self) -> Pattern | None:
        expression = _expression(_VERSIONS_1.get(self._version, self._columns))
        if expression is None or not _OLDEST <= self._version <= _NEWEST or self._start_ns > MAX_NS:
            return None
        return Pattern(expression, _channel_of, lambda found: len(found["id"]) > 4, MS, self._start_ns)

    def state(self) -> object:
        return self._version, self._start_ns, self._columns

    def __call__(self, line: str) -> LogFrame | None:
        """Return the frame on a line, by the version of the file; None for comments, which are read as the head."""
        text = line.strip()
        if line.startswith(";"):
            self._head(text[1:].strip())
            return None
        if not _OLDEST <= self._version <= _NEWEST:
            raise ValueError(f"TRC version {_dotted(self._version)} is not read: save it as 2.1")
        words = text.split()
        if not words:
            return None
        if len(words) < 4:
            raise ValueError("not a row of TRC")
        if self._version >= (2, 0):
            return self._of_columns(words)
        return self._of_version_1(words)

    def _head(self, text: str) -> None:
        """Take in a comment of the head: version, columns, or start."""
        name, _, value = text.partition("=")
        name, value = name.upper().strip(), value.strip()
        if name == "$FILEVERSION":
            found = re.fullmatch(r"(\d{1,3})\.(\d{1,3})", value)
            if found is None:
                raise ValueError(f"no version of TRC: {value[:40]}")
            self._version = (int(found[1]), int(found[2]))
            self._columns = _COLUMNS.get(self._version, self._columns)
        elif name == "$STARTTIME":
            try:
                self._start_ns = ns_of(value, _DAY_NS) - _DAYS_TO_1970 * _DAY_NS
            except ValueError:
                self.told.note(f"the time in the head cannot be read, and times count from 0: '{value[:60]}'")
            self._start_ns = max(self._start_ns, 0)
        elif name == "$COLUMNS":
            self._columns = value.replace(",", "")

    def _of_version_1(self, words: list[str]) -> LogFrame | None:
        """Return the frame of a row of the versions 1."""
        if not words[0].endswith(")"):
            raise ValueError("not a row of TRC")
        t_ns = self._start_ns + ns_of(words[1], MS)
        rest = words[2:]
        channel = "can1"
        if self._version >= (1, 2):
            channel, rest = _channel(rest[0]), rest[1:]
        if self._version >= (1, 1):
            kind, rest = rest[0], rest[1:]
        else:
            kind = ""
        if kind.lower() in ("warng", "error"):
            return self._bad(t_ns, channel, kind, rest)
        if self._version >= (1, 3) and len(rest) > 1 and rest[1] == "-":
            del rest[1]
        if len(rest) < 2 or (kind and kind.lower() not in WAYS):
            raise ValueError("not a row of TRC")
        return self._data(t_ns, channel, rest[0], WAYS.get(kind.lower()), _number(rest[1]), rest[2:])

    def _bad(self, t_ns: int, channel: str, kind: str, rest: list[str]) -> LogFrame | None:
        """A row of a status (an identifier of FFFFFFFF, four bytes) or of an error (its kind for an identifier)."""
        data = [word for word in rest[2:6] if re.fullmatch("[0-9A-Fa-f]{2}", word)]
        if kind.lower() == "warng":
            return self._state(t_ns, channel, data)
        protocol = _VIOLATIONS.get(_number(rest[0], 16) if rest else 0, 0)
        return error_frame(t_ns, channel, PROTOCOL | BUS_ERROR, protocol=protocol)

    def _of_columns(self, words: list[str]) -> LogFrame | None:
        """Return the frame of a row whose columns the head names."""
        columns = self._columns
        at = columns.find("T")
        if at < 0 or "D" not in columns or not -1 < columns.find("O") < at < len(words):
            raise ValueError("not a row of TRC")
        t_ns = self._start_ns + ns_of(words[columns.index("O")], MS)
        kind = words[at]
        channel = "can1"
        if "B" in columns and columns.index("B") < columns.find("I"):
            channel = _channel(words[columns.index("B")])
        if kind in ("ER", "ST", "EC", "EV"):
            return self._event(t_ns, channel, kind, words[at + 1 :])
        if kind == "XL":
            self.told.note("a row of type XL, which is not a frame of CAN or CAN FD")
            return None
        if kind not in ("DT", "RR", *_FD):
            raise ValueError(f"no row of TRC's: {kind[:20]}")
        if len(words) < len(columns) - 1:
            raise ValueError("not a row of TRC")
        named = dict(zip(columns, words, strict=False))
        number = _number(named.get("L", named.get("l", "")))
        length = number
        if "L" in named and kind in _FD:
            if number >= len(FD_BYTES):
                raise ValueError(f"no DLC: {number}")
            length = FD_BYTES[number]
        fd, (brs, esi) = kind in _FD, _FD.get(kind, (False, False))
        sent = WAYS.get(named.get("d", "").lower())
        data = words[columns.index("D") :]
        return self._data(t_ns, channel, named.get("I", ""), sent, length, data, kind == "RR", fd, brs, esi)

    def _event(self, t_ns: int, channel: str, kind: str, words: list[str]) -> LogFrame | None:
        """A row that is no frame: of these columns some are empty, and the data are what ends the row."""
        hexes = [word for word in words if re.fullmatch("[0-9A-Fa-f]{2}", word)]
        if kind == "ST":
            return self._state(t_ns, channel, hexes[-4:])
        if kind == "ER":
            kind_of_error, _, _, received, sent = ([int(each, 16) for each in hexes] + [0] * 5)[:5]
            protocol = _VIOLATIONS.get(kind_of_error, 0)
            kinds = PROTOCOL | BUS_ERROR
            return error_frame(t_ns, channel, kinds, protocol=protocol, received=received, sent=sent)
        self.told.note(f"a row of type {kind}, which is not a frame")
        return None

    def _state(self, t_ns: int, channel: str, data: list[str]) -> LogFrame | None:
        status = int("".join(data) or "0", 16)
        for bit, kinds, controller in _STATES:
            if status & bit:
                return error_frame(t_ns, channel, kinds, controller=controller)
        if status & _LOST:
            raise ValueError("frames were lost here: the recording computer was too slow")
        self.told.note("a row of a controller's status that is no error")
        return None

    def _data(
        self, t_ns: int, channel: str, id_text: str, sent: bool | None, length: int, words: list[str],
        remote: bool = False, fd: bool = False, brs: bool = False, esi: bool = False,
    ) -> LogFrame:  # fmt: skip
        remote = remote or words[:1] == ["RTR"]
        if not remote and words and len(words[-1]) != 2:  # it may have been cut off
            raise ValueError(f"no data bytes: {' '.join(words)[:40]}")
        data = b"" if remote else bytes_of(words)
        extended = len(id_text) > 4
        return frame_of(
            t_ns, channel, id_text, data, length, extended=extended, remote=remote, fd=fd, brs=brs, esi=esi, sent=sent
        )


@cache
def _expression(columns: str) -> re.Pattern[bytes] | None:
    """The pattern of rows with these columns; None where they are to be read one by one."""
    if not columns.endswith("D") or len(set(columns)) < len(columns) or not {"O", "I"} <= set(columns) <= set(_ROW):
        return None
    if len({"L", "l"} & set(columns)) != 1 or columns[-2] not in "Ll":
        return None
    return re.compile(b" +".join(_ROW[column] for column in columns[:-1]) + _ROW["D"])


def _channel_of(found: re.Match[bytes]) -> str:
    return _channel(found["channel"].decode()) if "channel" in found.re.groupindex else "can1"


def _number(text: str, base: int = 10) -> int:
    try:
        return int(text[:20], base)
    except ValueError:
        raise ValueError(f"no number: {text[:40]}") from None


def _channel(text: str) -> str:
    if not text.isdigit() or len(text) > 5:
        raise ValueError(f"invalid bus: {text[:40]}")
    return f"can{int(text)}"


def _dotted(version: tuple[int, int]) -> str:
    return ".".join(map(str, version))
