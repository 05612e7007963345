"""`fsai-vcu dump` and `decode`: frames as candump shows or logs them, with their signals beside."""

from __future__ import annotations

import argparse
import os
import sys
import time
from typing import Final

from fsai_vcu.cli.decoding import Decoding, add_database_arguments
from fsai_vcu.cli.output import write_out
from fsai_vcu.cli.sources import SOURCE_HELP, Sources, add_bus_mark, add_part_arguments, part_of
from fsai_vcu.diagnostics.decode.layouts import EXTENDED_KEY, MessageLayout
from fsai_vcu.diagnostics.log.candump import log_lines
from fsai_vcu.diagnostics.log.candump_line import date_text, screen_line, time_text
from fsai_vcu.diagnostics.log.frames import ERROR, EXTENDED, REMOTE, Frames
from fsai_vcu.interface.bus_table import BY_ID, Flow
from fsai_vcu.interface.errors import WrongUse

EXAMPLE = (
    "fsai-vcu VERB can0\n"
    "  fsai-vcu VERB can0,520:7FF,510:7FF,#FFFFFFFF -t z\n"
    "  fsai-vcu VERB run.log.gz --json | jq 'select(.message==\"VCU2AI_Steer\") | [.t, .signals.ANGLE]'"
)
_ON_SCREEN: Final = 100  # frames of a log: more of them would only flood a terminal
_COLUMNS = 150  # of a short line, beside its time
_TIME_DIGITS: Final = {"a": 10, "d": 3, "z": 3}  # as candump pads its seconds
_COLORS: Final = {"error": b"\x1b[31m", "ai": b"\x1b[32m", "vcu": b"\x1b[36m", "unknown": b"\x1b[33m"}
_NO_COLOR: Final = b"\x1b[0m"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of dump and decode, which are one verb with two names."""
    parser.set_defaults(verb=parser.prog.split()[-1])  # of the two names
    add = parser.add_argument
    add(
        "sources",
        nargs="+",
        metavar="SOURCE[,FILTER…]",
        help=SOURCE_HELP + "; 'any' is every CAN interface. Filters are candump's: ID:MASK (frames with "
        "id & MASK == ID & MASK), ID~MASK (all others), #ERRORMASK (error frames), j (all filters must match). Eight "
        "digits mean a 29-bit id. Without a filter all frames are shown, error frames too",
    )
    add_bus_mark(parser)
    add(
        "-t",
        dest="times",
        choices=("a", "A", "d", "z"),
        help="times: a absolute, A absolute with the date, d since the line before, z since the first frame (of a log: "
        "as check and explain count). Default: none for a bus, as candump; z for dump of a log; a for decode and -L",
    )
    add("-x", dest="extra", action="store_true", help="direction (RX, TX) and FD flags of each frame")
    add("-a", dest="ascii_column", action="store_true", help="the data as ASCII too")
    add(
        "-n",
        dest="count",
        type=int,
        metavar="COUNT",
        help="end after COUNT frames (default for a log on a terminal: 100)",
    )
    add("-T", dest="idle_ms", type=float, metavar="MS", help="end after MS milliseconds without a frame (live)")
    add(
        "-L",
        dest="log_format",
        action="store_true",
        help="print candump's log format; signals only with --signals or --short",
    )
    add("-c", dest="color", action="store_true", help="colour even where the output is no terminal")
    add(
        "--changes",
        action="store_true",
        help="only frames that differ from the previous frame of their message in more than HANDSHAKE",
    )
    add(
        "--short",
        action="store_true",
        help="only signals that are not 0, in 150 columns beside the time; X! is X_FAULT, +N: N more signals",
    )
    add("--no-signals", action="store_true", help="the frames only, exactly as candump shows them")
    add_database_arguments(parser)
    add_part_arguments(parser, signals=True)
    add("--numbers", action="store_true", help="print numbers instead of the database's words")
    add("--json", action="store_true", help="one JSON object per frame")


def run(args: argparse.Namespace) -> int:
    """Check the arguments, then print the frames of the sources until they end."""
    if args.count is not None and args.count < 1:
        raise WrongUse(f"-n is {args.count}, but must be at least 1")
    if args.idle_ms is not None and not 0.0 < args.idle_ms < float("inf"):
        raise WrongUse(f"-T is {args.idle_ms:g}, not a time")
    if (args.log_format or args.verb == "decode") and (args.ascii_column or args.times == "A"):
        raise WrongUse("-a and -t A work only with dump, and not with -L")
    if args.short and (args.json or args.no_signals):
        raise WrongUse("--short does not go with --json or --no-signals")
    decoding = Decoding(args.verb, args)
    decoding.show_signals(args.signals)
    sources = Sources(args.verb, args.sources, decoding, part_of(args, decoding))
    if args.times is None and args.verb == "dump" and not (sources.live or args.no_signals or args.log_format):
        args.times = "z"
    sources.learn()
    lines = _Lines(args, decoding)
    on_screen = args.count is None and sys.stdout.isatty() and not sources.live
    left = _ON_SCREEN if on_screen else args.count
    if sources.live and args.count is None and args.idle_ms is None and sys.stderr.isatty():
        print(f"fsai-vcu {args.verb}: listening to {sources.name} until Ctrl-C", file=sys.stderr)
    received_at, silent = time.monotonic(), True
    try:
        for frames in map(lines.chosen, sources.chunks()):
            if left == 0:  # all that fit on the screen are shown, and there are more
                if len(frames):
                    _say_more(args.verb)
                    break
                continue
            if len(frames):
                received_at, silent = time.monotonic(), False
                lines.zero_ns = None if sources.live else sources.first_ns
                shown = frames if left is None else frames.head(left)
                write_out(lines.block(shown))
                if left is not None:
                    left -= len(shown)
                    if left == 0 and (not on_screen or len(shown) < len(frames)):
                        if on_screen:
                            _say_more(args.verb)
                        break
            elif args.idle_ms is not None and (time.monotonic() - received_at) * 1000 >= args.idle_ms:
                if silent:
                    print(f"fsai-vcu {args.verb}: no frame on {sources.name} in {args.idle_ms:g} ms", file=sys.stderr)
                break
    except KeyboardInterrupt:
        if not sources.live:
            raise
        if silent:
            print(f"fsai-vcu {args.verb}: no frame to show was received on {sources.name}", file=sys.stderr)
    return sources.status


def _say_more(verb: str) -> None:
    """Tell how to see the rest of a log of which a terminal has shown the beginning."""
    more = "for more: -n COUNT, --from TIME; for all: the same command with | less"
    print(f"fsai-vcu {verb}: the first {_ON_SCREEN} frames are shown; {more}", file=sys.stderr)


class _Lines:
    """Frames as lines, in the style that the arguments ask for."""

    def __init__(self, args: argparse.Namespace, decoding: Decoding) -> None:
        self._args = args
        self._decoding = decoding
        self._color = args.color or (sys.stdout.isatty() and not os.environ.get("NO_COLOR"))
        self._log_format = args.log_format or args.verb == "decode"
        # A line of a log with signals behind it is none that canplayer or check would read.
        self._bare = args.no_signals or (args.log_format and args.signals is None and not args.short)
        own = (args.times, args.extra, args.log_format, args.color, args.short, args.no_signals)
        self._plain = args.json or (args.verb == "decode" and not any(own))
        self._indented = False
        self._newest: dict[tuple[str, int, int], tuple[int, int | bytes]] = {}  # length and payload of each message
        self.zero_ns: int | None = None  # -t z counts from here; None: from the first frame that is shown
        self._last_ns: int | None = None

    def chosen(self, frames: Frames) -> Frames:
        """The frames that --changes leaves."""
        import numpy as np

        if not self._args.changes or not len(frames):
            return frames
        masks = {key: self._compared(layout) for key, layout in self._decoding.databases.layouts.items()}
        changed = []
        for row, word in enumerate(frames.word.tolist()):
            flags, can_id = int(frames.flags[row]), int(frames.can_id[row])
            mask = masks.get(can_id | (EXTENDED_KEY if flags & EXTENDED else 0), ~0)
            said = (int(frames.length[row]), frames.long.get(row, word & mask))
            key = (frames.channels[frames.channel[row]], can_id, flags & (EXTENDED | REMOTE | ERROR))
            changed.append(self._newest.get(key) != said)
            self._newest[key] = said
        return frames.only(np.array(changed, np.bool_))

    def _compared(self, layout: MessageLayout) -> int:
        """The bits of a payload that tell a change: of the signals asked for, else all but HANDSHAKE's."""
        if self._args.signals is not None:
            return layout.mask
        return ~sum(1 << signal.start for signal in layout.signals if signal.name == "HANDSHAKE")

    def block(self, frames: Frames) -> bytes | bytearray:
        """Return all lines of `frames` as bytes, in the style that the arguments ask for."""
        if not len(frames):
            return b""
        if self._plain:
            return self._decoding.writer.block(frames)
        frames = self._shifted(frames)
        if self._log_format:
            heads = log_lines(frames, _TIME_DIGITS[self._args.times or "a"], marks=self._args.extra)
        else:
            heads = self._screen_lines(frames)
        tails = [b"\n"] * len(frames) if self._bare else self._decoding.writer.tails(frames)
        if self._args.short:
            timed = self._log_format or self._args.times is not None
            heads_columns = [len(head) - (head.index(b")") + 1 if timed else 0) for head in heads]
            tails = [_fitting(tail, _COLUMNS - columns) for columns, tail in zip(heads_columns, tails, strict=True)]
        if self._color:
            colors = self._colors(frames)
            heads = [color + head if color else head for color, head in zip(colors, heads, strict=True)]
            tails = [
                tail[:-1] + _NO_COLOR + b"\n" if color else tail for color, tail in zip(colors, tails, strict=True)
            ]
        both = [b""] * (2 * len(frames))
        both[0::2], both[1::2] = heads, tails
        return b"".join(both)

    def _screen_lines(self, frames: Frames) -> list[bytes]:
        """Return the lines as candump shows them, padded to one width where signals stand beside."""
        lines = []
        width, digits = max(map(len, frames.channels)), _TIME_DIGITS.get(self._args.times)
        for frame in frames:
            self._indented = self._indented or frame.extended
            time = date_text(frame.t_ns) if self._args.times == "A" else time_text(frame.t_ns, digits) if digits else ""
            extra, ascii_ = self._args.extra, self._args.ascii_column
            line = screen_line(frame, time, width=width, indented=self._indented, extra=extra, ascii_=ascii_)
            lines.append(line.encode("utf-8", "replace"))
        padded = 0 if self._args.no_signals else max(map(len, lines))
        return [line.ljust(padded) for line in lines]

    def _shifted(self, frames: Frames) -> Frames:
        """Return the frames with the times that -t asks for; like candump's, none goes below zero."""
        import numpy as np

        style = self._args.times
        if style not in ("d", "z"):
            return frames
        t_ns = frames.t_ns // 1000 * 1000  # differences of what is shown
        first = int(t_ns[0])
        if self.zero_ns is None:
            self.zero_ns = first
        before = first if self._last_ns is None else self._last_ns
        self._last_ns = int(t_ns[-1])
        shown = np.diff(t_ns, prepend=before) if style == "d" else t_ns - self.zero_ns // 1000 * 1000
        return frames.at(np.maximum(shown, 0))

    def _colors(self, frames: Frames) -> list[bytes]:
        kinds = {Flow.TO_VCU: "ai", Flow.FROM_VCU: "vcu"}
        own = {can_id: _COLORS.get(kinds.get(message.flow, ""), b"") for can_id, message in BY_ID.items()}
        which = self._decoding.decoder.which(frames).tolist()
        return [
            _COLORS["error" if flags & ERROR else "unknown"] if flags & ERROR or known == -1 else own.get(can_id, b"")
            for known, can_id, flags in zip(which, frames.can_id.tolist(), frames.flags.tolist(), strict=True)
        ]


def _fitting(tail: bytes, columns: int) -> bytes:
    """A line's end with so many of its words as there is room for, and how many more there are."""
    if len(tail) <= columns + 1:
        return tail
    words = tail.split()
    ends = (b" " + b" ".join(words[:count]) + b" +%d\n" % (len(words) - count) for count in range(len(words), -1, -1))
    return next((end for end in ends if len(end) <= columns + 1), b"\n")
