"""What the diagnostic verbs have in common: logs or interfaces to read, databases, and how lines leave."""

from __future__ import annotations

import argparse
import os
import signal
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from fsai_vcu.diagnostics.decode import Decoder
    from fsai_vcu.diagnostics.filters import FrameFilter
    from fsai_vcu.diagnostics.frames import Frames
    from fsai_vcu.diagnostics.logs import Problems

SOURCE_HELP: Final = "a log (candump, BLF, ASC, MF4, each also gzipped; - is standard input) or a CAN interface"
_PROBLEMS_SHOWN = 5


def add_database_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--dbc",
        action="append",
        default=[],
        type=Path,
        metavar="FILE",
        help="decode with this database instead of the car's own; may be given several times, the first one counts",
    )
    parser.add_argument("--revision", default="2026", help="interface revision: 2021 or 2026 (default: 2026)")


def decoder_of(args: argparse.Namespace) -> Decoder:
    """The decoder that the arguments ask for. Raises UserError."""
    from fsai_vcu.cli.main import UserError
    from fsai_vcu.diagnostics.databases import DatabasesError, load_databases
    from fsai_vcu.diagnostics.decode import Decoder

    try:
        return Decoder(load_databases(args.dbc, args.revision))
    except DatabasesError as error:
        raise UserError(str(error)) from error


class Sources:
    """Logs or live interfaces named on a command line, as one stream of columns.

    `live` tells which. `status` is 1 once something could not be read; `report` says it on stderr.
    """

    def __init__(self, verb: str, names: Sequence[str], *, keep_waiting: bool = True) -> None:
        """names: `NAME[,filter…]` each. Raises UserError."""
        from fsai_vcu.cli.main import UserError
        from fsai_vcu.diagnostics.filters import split_source

        self.verb = verb
        self.status = 0
        try:
            self._rules = [split_source(name) for name in names]
        except ValueError as error:
            raise UserError(str(error)) from error
        kinds = {_is_log(name) for name, _ in self._rules}
        if len(kinds) > 1:
            raise UserError("logs and live interfaces cannot be read together")
        self.live = kinds == {False}

    def chunks(self, seconds: float | None = None) -> Iterator[Frames]:
        """Frames that pass the filters; of a live bus also empty columns, so that the caller can look at the clock."""
        yield from self._live_chunks(seconds) if self.live else self._log_chunks()

    def _log_chunks(self) -> Iterator[Frames]:
        from fsai_vcu.cli.main import UserError
        from fsai_vcu.diagnostics.logs import LogError, open_log

        for name, rule in self._rules:
            try:
                log = open_log(name)
            except LogError as error:
                raise UserError(str(error)) from error
            count = 0
            with log:
                for frames in log.chunks():
                    count += len(frames)
                    yield _passing(frames, rule)
            self.report(log.name, count, log.problems)

    def report(self, name: str, frames: int, problems: Problems) -> None:
        """Say what could not be read of a log of so many frames."""
        if not frames:
            problems.add(f"{name}: no frames in it")
        for text in problems.texts[:_PROBLEMS_SHOWN]:
            self._say(text)
        if problems.count > _PROBLEMS_SHOWN:
            self._say(f"{name}: {problems.count - _PROBLEMS_SHOWN} more lines or frames that cannot be read")
        if problems:
            self.status = 1

    def _live_chunks(self, seconds: float | None) -> Iterator[Frames]:
        from fsai_vcu.cli.main import UserError
        from fsai_vcu.diagnostics.filters import filtered
        from fsai_vcu.diagnostics.live import LiveSource
        from fsai_vcu.runtime.bus import BusError

        signal.signal(signal.SIGTERM, signal.default_int_handler)  # ended by a script as by Ctrl-C
        try:
            source = LiveSource([name for name, _ in self._rules])
        except BusError as error:
            raise UserError(str(error)) from error
        rules = [(name.partition(":")[2] or name, rule) for name, rule in self._rules]
        with source:
            for frames in source.chunks(seconds):
                yield filtered(frames, rules)
            if source.lost is not None:
                self._say(source.lost)
                self.status = 1

    def _say(self, text: str) -> None:
        print(f"fsai-vcu {self.verb}: {text}", file=sys.stderr)


def _passing(frames: Frames, rule: FrameFilter) -> Frames:
    return frames.only(rule.passes(frames)) if rule else frames


def _is_log(name: str) -> bool:
    """An interface is what is no file and does not look like one: can0, vcan0, loopback:NAME."""
    path = Path(name)
    if name == "-" or path.exists():
        return True
    return ":" not in name and ("/" in name or path.suffix != "")


class Output:
    """Standard output for many lines. What it cannot take is one clear line (UserError), not a traceback."""

    def __init__(self) -> None:
        sys.stdout.flush()
        self._out = sys.stdout.buffer

    def write(self, block: bytes, *, at_once: bool = False) -> None:
        from fsai_vcu.cli.main import UserError

        try:
            self._out.write(block)
            if at_once:
                self._out.flush()
        except BrokenPipeError:
            raise
        except OSError as error:
            # What is still waiting to be written has nowhere to go, at the end of the process either.
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            raise UserError(f"cannot write the output: {error.strerror or error}") from error

    def flush(self) -> None:
        self.write(b"", at_once=True)
