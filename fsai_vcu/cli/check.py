"""`fsai-vcu check`: what is wrong on a bus or in a log, and what it did, in figures."""

from __future__ import annotations

import argparse
import json
from typing import TYPE_CHECKING

from fsai_vcu.cli.decoding import Decoding
from fsai_vcu.cli.output import write_out
from fsai_vcu.cli.sources import LogRead, Sources, add_log_arguments, check_seconds, judged
from fsai_vcu.diagnostics.statistics.measure import BusStatistics, MessageStatistics
from fsai_vcu.diagnostics.verdict.of_bus import periods_kept
from fsai_vcu.diagnostics.verdict.own_faults import impossible
from fsai_vcu.interface.errors import WrongUse

if TYPE_CHECKING:
    from fsai_vcu.diagnostics.verdict.judging import Judged

EXAMPLE = "fsai-vcu check run.log && echo the bus was well\n  fsai-vcu check can0 --seconds 10 --figures"
_NAMED = 8  # files that are left out
ABOUT = """\
Exit status: 0 the verdict is OK (it may have notes), 1 it is NOT OK or UNKNOWN: a
problem was found, too little is known, or not everything could be read; 2 wrong
use. Several logs, or the logs of a folder, get a line each and one verdict on
all; logs whose clocks differ are several runs.
Times in a log are seconds since its first frame."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_log_arguments(parser)
    parser.add_argument(
        "--figures",
        action="store_true",
        help="also print each message's period, jitter, gaps and load, and the handshake",
    )
    parser.add_argument("--bitrate", type=int, metavar="BIT/S", help="default: the database's, or 500000")
    parser.add_argument(
        "--json",
        action="store_true",
        help="print one JSON object per finding and bus, with --figures also per message; the last one is the verdict",
    )


def run(args: argparse.Namespace) -> int:
    """Read, measure, print. 0 if all is well and was readable."""
    check_seconds(args)
    if args.bitrate is not None and args.bitrate < 1:
        raise WrongUse(f"--bitrate is {args.bitrate}, not a bit rate")
    decoding = Decoding("check", args)
    read: list[LogRead] = []
    sources = Sources("check", args.sources, decoding, each=read.append)
    runs = sources.runs()
    found = [judged(args, each, decoding) for each in runs]
    lines = [json.dumps(each.as_dict()) if args.json else each.line() for each in read]
    if sources.left_out and not args.json:
        more = ", …" if len(sources.left_out) > _NAMED else ""
        lines.append(f"left out, as they are not logs: {', '.join(sources.left_out[:_NAMED])}{more}")
    write_out("".join(f"{line}\n" for line in lines).encode())
    log = "" if sources.live or len(sources.names) > 1 else sources.name
    wrong = [
        number for number, one in enumerate(found) if not _say(args, one, runs[number].name if found[1:] else "", log)
    ]
    if found[1:]:
        words = f"NOT OK: {len(wrong)} of {len(found)} runs" if wrong else f"OK: {len(found)} runs"
        whole = {"type": "verdict", "verdict": "not ok" if wrong else "ok", "runs": len(found), "words": words}
        write_out((json.dumps(whole) if args.json else f"verdict: {words}").encode() + b"\n")
    return 1 if wrong else 0


def _say(args: argparse.Namespace, found: Judged | None, run: str, log: str) -> bool:
    """Print the figures and the verdict of a run; True where it is OK.

    run: its logs, where there are several runs. log: its name, where it is the only one.
    """
    if run and not args.json:
        write_out(f"run {run}\n".encode())
    if found is None:
        write_out(b"verdict: NOT OK: no frames\n" if not args.json else b'{"type": "verdict", "verdict": "not ok"}\n')
        return False
    for bus in found.buses:
        figures = args.figures
        shown = _as_json(bus, figures=figures) if args.json else _for_people(bus, log, figures=figures)
        write_out(shown.encode())
    verdict = found.verdict
    of_run = {"run": run} if run else {}
    doubted = verdict.problems or impossible(found.buses) or len(found.buses) > 1
    right = [] if doubted else [periods_kept(bus) for bus in found.buses]
    told = [json.dumps(each | of_run) for each in verdict.as_dicts()]
    if not args.json:
        told = [*filter(None, right), *verdict.lines(), f"{'of this run' if run else 'verdict'}: {verdict.line()}"]
    write_out("".join(f"{line}\n" for line in told).encode())
    return verdict.ok


def _as_json(bus: BusStatistics, *, figures: bool) -> str:
    objects = [message.as_dict() | {"channel": bus.channel} for message in bus.messages] if figures else []
    return "".join(json.dumps(entry) + "\n" for entry in (*objects, bus.as_dict()))


_COLUMNS = (  # title and unit
    *(("id", ""), ("message", ""), ("frames", ""), ("period", "ms"), ("median", "ms")),
    *(("jitter p50", "ms"), ("jitter p99", "ms"), ("jitter max", "ms")),
    *(("gaps", ""), ("longest gap", "ms"), ("unchanged", "ms"), ("load", "")),
)


def _for_people(bus: BusStatistics, log: str, *, figures: bool) -> str:
    """Return the figures of a bus, received or in the log of that name, as text; `figures`: with one row a message."""
    where, what = (log, f"frames on {bus.channel}") if log else (bus.channel, "frames")
    lines = [
        f"{where}: {bus.frames} {what} in {bus.duration_s:.3f} s,"
        f" load {bus.load:.1%} of {bus.bitrate // 1000} kbit/s ({bus.peak_load:.1%} in the busiest 100 ms)"
    ]
    if figures:
        rows = [*zip(*_COLUMNS, strict=True), *(_row(message) for message in bus.messages)]
        widths = [max(len(row[column]) for row in rows) for column in range(len(_COLUMNS))]
        for row in rows:
            cells = [
                cell.ljust(width) if column < 2 else cell.rjust(width)
                for column, (cell, width) in enumerate(zip(row, widths, strict=True))
            ]
            lines.append("  ".join(cells).rstrip())
        lines.append("period: expected; median: of the intervals received; jitter: how far they are from the period")
        lines.append("unchanged: the longest time without a change of the payload")
        handshake = bus.handshake
        if handshake is not None and handshake.response_ms.p50_ms is not None:
            lines.append(
                f"handshake: {handshake.answered} answers, response time p50 {handshake.response_ms.p50_ms:.2f} ms,"
                f" p99 {handshake.response_ms.p99_ms:.2f} ms, max {handshake.response_ms.max_ms:.2f} ms"
            )
    return "\n".join(lines) + "\n"


def _row(message: MessageStatistics) -> tuple[str, ...]:
    """Return the cells of a message's row in the table of figures."""
    return (
        f"{message.can_id:08X}" if message.extended else f"{message.can_id:03X}",
        message.name or "?",
        str(message.count),
        "" if message.expected_ms is None else f"{message.expected_ms:g}",
        _ms(message.interval_ms.p50_ms),
        _ms(message.jitter_ms.p50_ms),
        _ms(message.jitter_ms.p99_ms),
        _ms(message.jitter_ms.max_ms),
        str(message.gaps),
        _ms(message.longest_gap_ms),
        f"{message.frozen_ms:.0f}",
        f"{message.load:.2%}",
    )


def _ms(value: float | None) -> str:
    return "" if value is None else f"{value:.2f}"
