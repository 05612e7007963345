"""Problems of a log beside its frames: unreadable rows, lost frames, and rows that are no frames."""

from __future__ import annotations

from collections import Counter
from typing import Final

_KEPT: Final = 1000  # texts; all are counted
_KINDS: Final = 100  # of rows that are no frames


class Problems:
    """Collects what could not be read in a log. `texts` are whole lines for people, each with its place.

    All are counted. `lost`: frames that the recording machine says it lost. `notes`: how many rows of each kind are no
    frames and were left out; no frame is missing because of them.
    """

    def __init__(self) -> None:
        self.count = 0
        self.texts: list[str] = []
        self.lost = 0
        self.notes: Counter[str] = Counter()

    def add(self, text: str) -> None:
        self.count += 1
        if len(self.texts) < _KEPT:
            self.texts.append(text)

    def note(self, kind: str) -> None:
        """One more row of that kind; a file may name kinds without end."""
        self.notes[kind if kind in self.notes or len(self.notes) < _KINDS else "others"] += 1

    def __bool__(self) -> bool:
        return self.count > 0

    def summary(self) -> str:
        """One line."""
        more = f" (and {self.count - 1} more of this kind or worse)" if self.count > 1 else ""
        return self.texts[0] + more if self.count else ""

    def note_line(self) -> str:
        """One line on the rows that are no frames; '' without any."""
        return "; ".join(kind if count == 1 else f"{count} times: {kind}" for kind, count in self.notes.items())


class ReadingEnds(Exception):
    """Reason why a log cannot be read on, as the end of a sentence."""
