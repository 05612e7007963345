"""Common parts of the diagnostic verbs: logs or interfaces to read, databases, and the way out for lines."""

from __future__ import annotations

import argparse
import re
import signal
import sys
import time
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import AbstractContextManager, closing, nullcontext, suppress
from copy import copy
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from fsai_vcu.cli.ending import ending
from fsai_vcu.diagnostics.decode.layouts import EXTENDED_KEY
from fsai_vcu.diagnostics.log.filters import FrameFilter, filtered, split_source
from fsai_vcu.diagnostics.log.frames import EXTENDED, Frames, joined
from fsai_vcu.diagnostics.log.part import Part
from fsai_vcu.diagnostics.log.reader import open_log
from fsai_vcu.diagnostics.log.recorded import IN_ORDER, Recorded, is_virtual, lost_words, recorded
from fsai_vcu.files import is_file
from fsai_vcu.interface.errors import UserError, WrongUse, did_you_mean
from fsai_vcu.interface.reserved import AI_IDS, VCU_IDS
from fsai_vcu.printable import printable

if TYPE_CHECKING:
    from fsai_vcu.diagnostics.log.reader import Log
    from fsai_vcu.diagnostics.verdict.judging import Judged
from fsai_vcu.cli.decoding import Decoding, add_database_arguments
from fsai_vcu.cli.log_files import NOTHING_READ, first_stamp, goes_on, is_log, last_stamp, unfolded
from fsai_vcu.cli.output import Progress

LOG_HELP: Final = (
    "a log (candump, BLF, ASC, MF4, TRC, CSV, pcap and others, packed or not; - is standard input), a folder of logs"
)
SOURCE_HELP: Final = f"{LOG_HELP} or a CAN interface"
_PROBLEMS_SHOWN = 5


def add_sources_argument(parser: argparse.ArgumentParser, name: str = "sources") -> None:
    """Add the argument for sources: several logs, or folders of them, count as one log (a recording's segments)."""
    parser.add_argument(
        name,
        nargs="+",
        metavar="LOG|FOLDER|INTERFACE[,FILTER…]",
        help=SOURCE_HELP + "; several logs, or a folder of them, are read as one; filters as for dump",
    )
    add_bus_mark(parser)


def add_bus_mark(parser: argparse.ArgumentParser) -> None:
    """Let -i stand before a source, as it does for the verbs that send: it says nothing that is not known."""
    parser.add_argument("-i", "--interface", action="store_true", help=argparse.SUPPRESS)


def add_part_arguments(parser: argparse.ArgumentParser, *, messages: bool = True, signals: bool = False) -> None:
    """Add the arguments that choose a part of a log: times, messages, and `signals` for a verb that shows them."""
    parser.add_argument(
        "--from",
        dest="begin",
        metavar="TIME",
        help="begin at this time: seconds or minutes (90 or 1:30) after the log's first frame, or a time of day "
        "(UTC, 14:03:30; 14:03 where the log has it)",
    )
    parser.add_argument("--to", dest="end", metavar="TIME", help="end at this time")
    if messages:
        parser.add_argument(
            "--messages",
            metavar="NAME,…",
            help="only these: names with * and ?, or identifiers (0x520)",
        )
    if signals:
        parser.add_argument(
            "--signals", metavar="NAME,…", help="only these, and the messages that have them; with * and ?"
        )


def add_log_arguments(parser: argparse.ArgumentParser, *, messages: bool = True) -> None:
    """Add the arguments of every verb that looks at a whole log, or listens for a while."""
    add_sources_argument(parser)
    add_seconds_argument(parser)
    add_part_arguments(parser, messages=messages)
    add_database_arguments(parser)


def judged(args: argparse.Namespace, sources: Sources, decoding: Decoding) -> Judged | None:
    """The frames of all sources, or of the part that is asked for, measured and judged.

    None without a frame at all, which was reported then. Raises UserError where no frame is in the part, or the logs
    are several runs.
    """
    if len(runs := sources.runs()) > 1:
        names = " | ".join(run.name for run in runs)
        raise UserError(f"the clocks of these logs differ: they are {len(runs)} runs; name the logs of one: {names}")
    from fsai_vcu.diagnostics.explain.record import NoFrames
    from fsai_vcu.diagnostics.verdict.judging import judged as judged_frames

    part, progress = part_of(args, decoding), Progress()
    frames = sources.everything(getattr(args, "seconds", None), progress.reading)
    progress.end()
    if not len(frames):
        return None
    part.ends_at(int(frames.t_ns.max()))
    rate = getattr(args, "bitrate", None)
    try:
        found = judged_frames(
            frames,
            args.revision,
            decoding.databases if args.dbc else None,
            part,
            bitrate=rate,
            begin_ns=sources.first_ns,
            recorded=sources.recorded,
            left_out=sources.left_out_keys(part, decoding),
        )
    except NoFrames as error:
        raise UserError(f"no frame of {sources.name} is in the chosen part") from error
    return found._replace(verdict=found.verdict.unread(sources.unread))


def part_of(args: argparse.Namespace, decoding: Decoding | None = None) -> Part:
    """The part of the log that the arguments ask for; `decoding` knows the messages they name. Raises UserError."""
    ids: frozenset[int] | None = None
    if decoding is not None and getattr(args, "messages", None) is not None:
        layouts = [layout for databases in decoding.possible() for layout in databases.layouts.values()]
        chosen: set[int] = set()
        for name in filter(None, args.messages.split(",")):
            found = {layout.can_id for layout in layouts if layout.is_called(name)}
            if not found and not re.fullmatch("0x[0-9a-f]+", name, re.IGNORECASE):
                meant = did_you_mean(name, (layout.name for layout in layouts))
                raise UserError(f"no message {name}{meant or '; fsai-vcu dbc list names them'}")
            chosen |= found or {int(name, 16)}
        ids = frozenset(chosen)
    try:
        return Part(getattr(args, "begin", None), getattr(args, "end", None), ids)
    except ValueError as error:
        raise WrongUse(str(error)) from error


class LogRead(NamedTuple):
    """The reading of one log of several. problems, notes: one line each, or ''."""

    name: str
    kind: str
    frames: int
    problems: str
    notes: str

    def line(self) -> str:
        """Line on the log, for a person."""
        read = f"{self.kind}, {self.frames} frames" if self.frames else "no frames in it"
        if self.problems and not self.frames:
            read = "nothing could be read"
        said = "; ".join(filter(None, (read, self.problems.removeprefix(f"{self.name}: "), self.notes)))
        return f"{self.name}: {said}"

    def as_dict(self) -> dict[str, Any]:
        names = {"name": self.name, "format": self.kind if self.frames else None, "frames": self.frames}
        return {"type": "log", **names, "problems": self.problems or None, "notes": self.notes or None}


class Sources:
    """Logs or live interfaces named on a command line, as one stream of columns.

    `live` tells which, `name` what they are called. `status` is 1 once something could not be read; what it
    was is printed on stderr.
    """

    def __init__(
        self,
        verb: str,
        names: Sequence[str],
        decoding: Decoding | None = None,
        part: Part | None = None,
        each: Callable[[LogRead], None] | None = None,
    ) -> None:
        """Open the sources. Raises UserError.

        names: `NAME[,filter…]` each. decoding: receives every frame, those too that no filter lets through. each: gets
        what was read of each of several logs, and nothing of it is said on stderr.
        """
        self.verb = verb
        self.status = 0
        self._unread = False
        self._several = False  # logs on the command line; one of them alone has its troubles told in full
        self._decoding = decoding
        self._part = part
        self._each = each
        left_out: list[Path] = []
        try:
            self._rules = [split_source(each) for name in names for each in unfolded(name, left_out)]
        except ValueError as error:
            raise WrongUse(str(error)) from error
        self.left_out = [printable(path.name) for path in left_out]  # of what is in folders
        self._several = len(self._rules) > 1
        self._name_them()
        kinds = {is_log(name) for name, _ in self._rules}
        if len(kinds) > 1:
            raise WrongUse("logs and live interfaces cannot be read together")
        self.live = kinds == {False}
        self.files = all(Path(name).is_file() for name, _ in self._rules)
        self.first_ns: int | None = None  # of the whole log, whatever the part
        self._recorded: Callable[[], Recorded] = Recorded  # of what was read, or heard, up to now
        self.heard_ns: Callable[[], int] = time.monotonic_ns  # live: the last of `chunks` holds everything until then
        if part is not None:
            self.tell_the_end(part)

    def _name_them(self) -> None:
        self.names = ["standard input" if name == "-" else printable(name) for name, _ in self._rules]
        self.name = ", ".join(self.names)

    def runs(self) -> list[Sources]:
        """The sources by clock: a log with a clock of its own is another run, without a common axis with the others."""
        if self.live or len(self._rules) < 2 or not self.files:
            return [self]
        runs: list[list[tuple[str, FrameFilter]]] = [[]]
        last_ns: int | None = None  # first stamp of the last log that can be read: those that cannot begin no run
        for rule in self._rules:
            first_ns, _ = first_stamp(Path(rule[0]))
            if first_ns != NOTHING_READ:
                if last_ns is not None and not goes_on(last_ns, first_ns):
                    runs.append([])
                last_ns = first_ns
            runs[-1].append(rule)
        return [self] if len(runs) == 1 else [self._with(rules) for rules in runs]

    def left_out_keys(self, part: Part, decoding: Decoding) -> frozenset[int]:
        """The keys of the messages that neither any of the filters nor the part lets through."""
        rules = [rule for _, rule in self._rules]
        if not part.chooses_messages and not all(rules):
            return frozenset()
        import numpy as np

        known = {key for databases in decoding.possible() for key in databases.layouts}
        keys = np.array(sorted({*known, *AI_IDS, *VCU_IDS}), np.uint32)
        zeros = np.zeros(len(keys), np.int64)
        extended = keys & np.uint32(EXTENDED_KEY) != 0
        can_ids, flags = keys & np.uint32(EXTENDED_KEY - 1), np.where(extended, EXTENDED, 0).astype(np.uint8)
        one_each = Frames(zeros, can_ids, flags, flags, zeros.astype(np.uint64), zeros.astype(np.int32))
        passes = np.logical_or.reduce([rule.passes(one_each) for rule in rules]) & part.has(can_ids)
        return frozenset(keys[~passes].tolist())

    def _with(self, rules: list[tuple[str, FrameFilter]]) -> Sources:
        one = copy(self)
        one._rules = rules
        one._name_them()
        return one

    def chunks(
        self, seconds: float | None = None, *, announced: bool = False, waits: bool = False
    ) -> Generator[Frames, None, None]:
        """Frames that pass the filters; of a live bus also empty columns, so that the caller can look at the clock.

        announced: a person who would see nothing for long sees that this is listening. waits: for a bus that goes away.
        """
        yield from self._live_chunks(seconds, announced, waits) if self.live else self._log_chunks()

    @property
    def lost_here(self) -> str:
        """A sentence on the frames that this machine received too late, now or while the logs were recorded; or ''."""
        return lost_words(self.recorded.lost)

    @property
    def recorded(self) -> Recorded:
        """Traces that the computers which recorded the logs, or this listening one, left in them."""
        return self._recorded()

    @property
    def unread(self) -> bool:
        """True where something could not be read or received, other than frames that this machine lost itself."""
        return self._unread

    def everything(self, seconds: float | None = None, received: Callable[[int], None] = lambda _: None) -> Frames:
        """All frames of all logs; of live buses, those of so long or until Ctrl-C.

        `received` gets again and again how many frames there are.
        """
        if seconds is not None and not self.live:
            raise WrongUse("--seconds is for live buses; --from and --to choose a part of a log")

        def chunks() -> Iterator[Frames]:
            count = 0
            for chunk in self.chunks(seconds, announced=True):
                count += len(chunk)
                received(count)
                yield chunk

        if not self.live:
            return joined(chunks())
        parts: list[Frames] = []
        with suppress(KeyboardInterrupt):
            for chunk in chunks():
                parts.append(chunk)
        if not any(map(len, parts)):
            self._say(f"nothing was received on {self.name}")
            self.status = 1
        return joined(parts)

    def tell_the_end(self, *parts: Part) -> None:
        """Tell those parts that must know it when the logs end. They are read for it."""
        asking = [part for part in parts if part.needs_the_end] if self.files else []
        ends_ns = [last_stamp(name) for name, _ in self._rules] if asking else []
        for part in asking:
            part.ends_at(max(ends_ns))

    def check_output(self, path: Path) -> None:
        """Raise WrongUse where a log would be written over with what is made of it."""
        if is_file(path) and any(is_file(name) and path.samefile(name) for name, _ in self._rules):
            raise WrongUse(f"{path} is the log that is read, and would be overwritten")

    def learn(self) -> None:
        """Decode by what the logs tell of their revision from their beginnings on: as much of them as it takes."""
        for name, _ in self._rules if self.files else ():
            with open_log(name) as log:
                for frames in log.chunks():
                    if self._decoding is None or self._decoding.told:
                        return
                    self._decoding.hear(frames)

    def _log_chunks(self) -> Iterator[Frames]:
        """Yield the frames of the logs, one log after the other, that the filters let through."""
        inside = 0
        found: Recorded | None = None
        for name, rule in self._rules:
            count = 0
            with open_log(name) as log:
                for frames in log.chunks():
                    count += len(frames)
                    if self._decoding is not None:
                        self._decoding.hear(frames)
                    passing = self._passing(frames, rule)
                    inside += len(passing)
                    yield passing
            self._report(log, count)
            one = IN_ORDER if name == "-" else recorded(Path(name))
            one = one._replace(lost=one.lost + log.problems.lost)
            found = one if found is None else found.joined(one)
        self._recorded = lambda: found or IN_ORDER
        if self._part and self.first_ns is not None and not inside:
            raise UserError(f"no frame of {self.name} is in the chosen part")

    def _report(self, log: Log, frames: int) -> None:
        """Say what could not be read of a log of so many frames: of one of several in one line."""
        name, problems = log.name, log.problems
        if self._each is not None and self._several:
            self._each(LogRead(name, log.kind, frames, problems.summary(), problems.note_line()))
            self._unread |= bool(problems) or not frames
            self.status |= self._unread
            return
        texts = problems.texts[:_PROBLEMS_SHOWN]
        if not frames:
            why = problems.texts[0].removeprefix(name) if problems else ""
            texts = [f"{name}: nothing could be read{why}" if why else f"{name}: no frames in it"]
        elif self._several and problems:
            texts = [problems.summary()]
        elif problems.count > _PROBLEMS_SHOWN:
            texts.append(f"{name}: {problems.count - _PROBLEMS_SHOWN} more lines or frames that cannot be read")
        for text in texts:
            self._say(text)
            self.status = 1
            self._unread = True
        if problems.notes:
            self._say(f"{name}: note: {problems.note_line()}")

    def _passing(self, frames: Frames, rule: FrameFilter) -> Frames:
        if self.first_ns is None and len(frames):
            self.first_ns = int(frames.t_ns[0])
        shown = self._chosen(frames)
        return shown.only(rule.passes(shown)) if rule else shown

    def _chosen(self, frames: Frames) -> Frames:
        """Return the frames of the part, and with the signals, that are asked for."""
        shown = frames if self._part is None else self._part.of(frames)
        return shown if self._decoding is None else self._decoding.chosen(shown)

    def _live_chunks(self, seconds: float | None, announced: bool, waits: bool) -> Iterator[Frames]:
        """Yield the frames of live buses that the filters let through, until the time is over or Ctrl-C."""
        from fsai_vcu.diagnostics.log.live import LiveSource

        signal.signal(signal.SIGTERM, signal.default_int_handler)  # ended by a script as by Ctrl-C
        # A verb that shows nothing before the end shows all of it then, whenever the end is asked for.
        how_it_ends: AbstractContextManager[list[int]] = ending() if announced else nullcontext([])
        rules = [(name.partition(":")[2] or name, rule) for name, rule in self._rules]
        with how_it_ends as asked, closing(LiveSource([name for name, _ in self._rules], waits=waits)) as source:
            virtual = any(is_virtual(name) for name, _ in self._rules)
            self._recorded = lambda: Recorded(source.dropped, virtual=virtual)
            self.heard_ns = lambda: source.heard_ns
            if announced and seconds is None:
                self._say(f"listening to {self.name} until Ctrl-C")
            try:
                for frames in source.chunks(seconds, asked):
                    for text in source.news():
                        self._say(text)
                    if self._decoding is not None:
                        self._decoding.hear(frames)
                    yield self._chosen(filtered(frames, rules))
            finally:
                missing = list(source.missing())
                self._unread |= bool(missing)
                for text in filter(None, [*missing, self.lost_here]):
                    self._say(text)
                    self.status = 1

    def _say(self, text: str) -> None:
        print(f"fsai-vcu {self.verb}: {text}", file=sys.stderr)


def add_seconds_argument(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--seconds", type=float, metavar="S", help="listen for S seconds (live; default: until Ctrl-C)")


def check_seconds(args: argparse.Namespace) -> None:
    """Raise WrongUse where --seconds is not a time."""
    if args.seconds is not None and not 0.0 < args.seconds < float("inf"):
        raise WrongUse(f"--seconds is {args.seconds:g}, not a time")


def add_server_arguments(parser: argparse.ArgumentParser, port: int) -> None:
    """Add the arguments of a verb that shows one source on the network."""
    parser.add_argument("--host", default="127.0.0.1", help="address to listen on (default: this machine only)")
    parser.add_argument("--port", type=int, default=port, help=f"default: {port}; 0: any that is free")
    add_seconds_argument(parser)
    add_database_arguments(parser)


def check_server(args: argparse.Namespace) -> None:
    """Raise WrongUse where the port, or the time, cannot be."""
    if not 0 <= args.port < 65536:
        raise WrongUse(f"--port is {args.port}, but must be 0 to 65535")
    check_seconds(args)
