"""The databases by which a verb decodes: chosen by arguments, or told by the frames themselves."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from typing import Final

from fsai_vcu.diagnostics.decode.databases import Databases, load_databases
from fsai_vcu.diagnostics.decode.decoder import Decoder
from fsai_vcu.diagnostics.decode.layouts import MessageLayout
from fsai_vcu.diagnostics.decode.lines import LineWriter
from fsai_vcu.diagnostics.decode.revision import told_revision
from fsai_vcu.diagnostics.log.frames import Frames
from fsai_vcu.interface.errors import UserError, WrongUse, did_you_mean
from fsai_vcu.interface.revisions import REVISIONS
from fsai_vcu.interface.revisions import revision as revision_named
from fsai_vcu.printable import printable

_MESSAGES: Final = 3  # whose signals an error names …
_SIGNALS: Final = 4  # … and how many of each


def add_database_arguments(parser: argparse.ArgumentParser, revision: str | None = None) -> None:
    """Add --dbc and --revision. `revision`: the revision that counts where none is named; None: the frames tell."""
    parser.add_argument(
        "--dbc",
        action="append",
        default=[],
        type=Path,
        metavar="FILE",
        help="decode with this database instead of the car's own; may be given several times, the first one counts",
    )
    default = revision or "known from the frames"
    parser.add_argument("--revision", default=revision, help=f"interface revision: 2021 or 2026 (default: {default})")


class Decoding:
    """Decodes as the arguments ask for. Where they name neither a revision nor databases, the frames tell.

    `revision` is the name of the revision in force: the given one, else the one told so far, else the latest.
    """

    def __init__(self, verb: str, args: argparse.Namespace) -> None:
        """Read the arguments. Raises UserError."""
        self._verb = verb
        self._args = args
        self._files: Sequence[Path] = args.dbc
        self.told: bool = args.revision is not None  # nothing more to be learned from frames
        try:
            self.revision = revision_named(args.revision or list(REVISIONS)[-1]).name
        except ValueError as error:
            raise WrongUse(str(error)) from error
        self._shown: tuple[str, ...] | None = None
        # What is wrong with given files is reported before anything is read.
        for name in self.databases.signed_flags if self._files else ():
            print(f"fsai-vcu {verb}: {name}: one-bit flags, signed there, are read as 0 and 1", file=sys.stderr)
        for text in self.databases.left_out:
            print(f"fsai-vcu {verb}: {printable(text)}", file=sys.stderr)

    @cached_property
    def databases(self) -> Databases:
        """Databases by what is known so far: others once frames have told more."""
        databases = load_databases(self._files, self.revision)
        return databases if self._shown is None else databases.with_signals(self._shown)

    @cached_property
    def decoder(self) -> Decoder:
        """Decoder with the present databases."""
        return Decoder(self.databases)

    @cached_property
    def writer(self) -> LineWriter:
        """Writer that prints as --json and --numbers ask for, with the present decoder."""
        args = self._args
        short = getattr(args, "short", False)
        rounded = self._verb == "dump" and not args.json  # decode's lines are cantools' to the last byte
        return LineWriter(self.decoder, as_json=args.json, words=not args.numbers, short=short, rounded=rounded)

    def possible(self) -> list[Databases]:
        """The databases that may be meant: the given ones, or those of each revision while none is named."""
        if self._files or self.told:
            return [self.databases]
        return [load_databases((), name) for name in REVISIONS]

    def patterns(self, names: str | None) -> list[str]:
        """The signals asked for. Raises UserError where a database knows none of them."""
        patterns = list(filter(None, (names or "").split(",")))
        layouts = [layout for databases in self.possible() for layout in databases.layouts.values()] if patterns else []
        for pattern in patterns:
            if not any(layout.signals_like([pattern]) for layout in layouts):
                known = (signal.name for layout in layouts for signal in layout.signals)
                meant, inside = did_you_mean(pattern.rpartition(".")[2], known), _in_messages_like(pattern, layouts)
                lists = "lists all" if meant or inside else "lists them"
                raise UserError(f"no signal {pattern}{meant or ';'}{inside} fsai-vcu dbc show {lists}")
        return patterns

    def show_signals(self, names: str | None) -> None:
        """Show only these signals from now on, by name or pattern, and the messages that have them. May raise
        UserError.
        """
        if names is None:
            return
        self._shown = tuple(self.patterns(names))
        self._forget()

    def chosen(self, frames: Frames) -> Frames:
        """Return the frames of those messages that have the signals asked for."""
        if self._shown is None or not len(frames):
            return frames
        import numpy as np

        return frames.only(np.isin(frames.can_id, np.fromiter(self.databases.layouts, np.int64) & 0x1FFF_FFFF))

    def hear(self, frames: Frames) -> None:
        """Learn from frames which revision is spoken, and say so where another one is assumed."""
        found = None if self.told or not len(frames) else told_revision(frames)
        if found is None:
            return
        self.told = True
        revision, reason = found
        if revision.name == self.revision:
            return
        self.revision = revision.name
        if not self._files:
            self._forget()
            print(f"fsai-vcu {self._verb}: interface revision {revision.name} ({reason})", file=sys.stderr)

    def _forget(self) -> None:
        """Drop the databases, the decoder and the writer that were made by what was known before."""
        for name in ("databases", "decoder", "writer"):
            self.__dict__.pop(name, None)


def _in_messages_like(word: str, layouts: Sequence[MessageLayout]) -> str:
    """The signals of the messages that have that word in their names, for an error about an unknown signal."""
    found = {layout.name: layout for layout in layouts if layout.has_in_name(word)}
    return "".join(
        f" {name} has {', '.join(signal.name for signal in layout.signals[:_SIGNALS])};"
        for name, layout in list(found.items())[:_MESSAGES]
    )
