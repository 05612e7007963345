"""Blocks of a candump log as text: quickly what is usual, and with numpy or cantools what is not."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

from fsai_vcu.diagnostics.decode.quick_lines import QuickWriter

if TYPE_CHECKING:
    from fsai_vcu.diagnostics.decode.databases import Databases
    from fsai_vcu.diagnostics.decode.lines import LineWriter


class Printed(NamedTuple):
    """A block with its signals. problems: (number of a line in the block, from 0; what is wrong with it)."""

    text: bytes
    frames: int
    lines: int
    problems: list[tuple[int, str]]


class Printer:
    """Prints with the messages of `databases`. as_json, words: as for LineWriter."""

    def __init__(self, databases: Databases, *, as_json: bool = False, words: bool = True) -> None:
        self._databases = databases
        self._json = as_json
        self._words = words
        self._quick = QuickWriter(databases, self._careful, words=words)
        self._channels: list[str] = []
        if as_json:
            _ = self._writer  # it will be needed: loaded once, before several processes share it

    def __call__(self, block: bytes) -> Printed:
        """Whole lines, each with its line end."""
        quick = None if self._json else self._quick.block(block)
        if quick is not None:
            return Printed(quick[0], quick[1], quick[1], [])
        import numpy as np

        from fsai_vcu.diagnostics.log.candump import parse_block

        frames, unreadable, lines = parse_block(np.frombuffer(block, np.uint8), self._channels)
        return Printed(self._writer.block(frames), len(frames), lines, [(line, words) for line, words in unreadable])

    @cached_property
    def _writer(self) -> LineWriter:
        from fsai_vcu.diagnostics.decode.decoder import Decoder
        from fsai_vcu.diagnostics.decode.lines import LineWriter

        return LineWriter(Decoder(self._databases), as_json=self._json, words=self._words)

    def _careful(self, frame: bytes) -> bytes:
        from fsai_vcu.diagnostics.log.candump import parse_line
        from fsai_vcu.diagnostics.log.frames import frames_of

        return self._writer.tails(frames_of([parse_line(f"(0.000000) can0 {frame.decode()}")]))[0]
