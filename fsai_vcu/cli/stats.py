"""`fsai-vcu stats`: what a bus did, in figures, with a verdict."""

from __future__ import annotations

import argparse
import json
import sys
import time
from typing import TYPE_CHECKING

from fsai_vcu.cli.sources import (
    Decoding,
    Output,
    Sources,
    add_database_arguments,
    add_seconds_argument,
    add_source_argument,
    check_seconds,
)

if TYPE_CHECKING:
    from fsai_vcu.diagnostics.statistics.measure import BusFinding, BusStatistics, MessageStatistics

EXAMPLE = "fsai-vcu stats can0 --seconds 10"
ABOUT = """\
Exit status: 0 all is well (notes count as well), 1 a problem was found or not
everything could be read, 2 wrong use."""
_PROGRESS_S = 2.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.description = f"{parser.description}\n\n{ABOUT}"
    add_source_argument(parser)
    add_database_arguments(parser)
    add_seconds_argument(parser)
    parser.add_argument("--bitrate", type=int, metavar="BIT/S", help="default: the database's, or 500000")
    parser.add_argument(
        "--json", action="store_true", help="one JSON object per message, finding and bus; verdict last"
    )


def run(args: argparse.Namespace) -> int:
    return measured("stats", args, table=True)


def measured(verb: str, args: argparse.Namespace, *, table: bool) -> int:
    """Read, measure, print; `table`: the figures too, not the findings only. 0 if all is well and was readable."""
    from fsai_vcu.cli.main import WrongUse
    from fsai_vcu.diagnostics.statistics.measure import judge, measure, verdict

    check_seconds(args)
    if args.bitrate is not None and args.bitrate < 1:
        raise WrongUse(f"--bitrate is {args.bitrate}, not a bit rate")
    decoding = Decoding(verb, args)
    sources = Sources(verb, [args.source], decoding)
    frames = sources.everything(args.seconds, _Progress())
    buses = measure(frames, decoding.decoder, revision=decoding.revision, bitrate=args.bitrate)
    found = [(bus, judge(bus)) for bus in buses]
    well = bool(found) and all(verdict(findings) for _, findings in found)
    output = Output()
    for bus, findings in found:
        text = _as_json(bus, findings, table=table) if args.json else _for_people(bus, findings, table=table)
        output.write(text.encode())
    findings = [finding for _, several in found for finding in several]
    output.write(_verdict(well, findings, as_json=args.json, frames=len(frames)).encode(), at_once=True)
    return sources.status or (0 if well else 1)


class _Progress:
    """Says on a terminal, every two seconds, how many frames there are."""

    def __init__(self) -> None:
        self._printed_at = time.monotonic()

    def __call__(self, frames: int) -> None:
        if sys.stderr.isatty() and time.monotonic() - self._printed_at > _PROGRESS_S:
            self._printed_at = time.monotonic()
            print(f"{frames} frames …", file=sys.stderr)


def _verdict(well: bool, findings: list[BusFinding], *, as_json: bool, frames: int) -> str:
    problems = sum(finding.severity.value == "problem" for finding in findings)
    notes = len(findings) - problems
    if as_json:
        word = "ok" if well else "not ok"
        return json.dumps({"type": "verdict", "verdict": word, "problems": problems, "notes": notes}) + "\n"
    if not frames:
        return "verdict: NOT OK: no frames\n"
    end = f" ({notes} note{'s' * (notes > 1)})" if notes else ""
    return f"verdict: {'OK' if well else f'NOT OK: {problems} problem' + 's' * (problems > 1)}{end}\n"


def _as_json(bus: BusStatistics, findings: list[BusFinding], *, table: bool) -> str:
    objects = [message.as_dict() | {"channel": bus.channel} for message in bus.messages] if table else []
    objects += [finding.as_dict() | {"channel": bus.channel} for finding in findings]
    objects.append(bus.as_dict())
    return "".join(json.dumps(entry) + "\n" for entry in objects)


_HEAD = ("id", "message", "frames", "period", "p50", "jitter p50", "p99", "max", "gaps", "longest", "frozen", "load")


def _for_people(bus: BusStatistics, findings: list[BusFinding], *, table: bool) -> str:
    lines = [
        f"{bus.channel}: {bus.frames} frames in {bus.duration_s:.3f} s,"
        f" load {bus.load:.1%} of {bus.bitrate // 1000} kbit/s ({bus.peak_load:.1%} in the busiest 100 ms)"
    ]
    if table:
        rows = [_HEAD, *(_row(message) for message in bus.messages)]
        widths = [max(len(row[column]) for row in rows) for column in range(len(_HEAD))]
        for row in rows:
            cells = [
                cell.ljust(width) if column < 2 else cell.rjust(width)
                for column, (cell, width) in enumerate(zip(row, widths, strict=True))
            ]
            lines.append("  ".join(cells).rstrip())
        lines.append("times in ms; frozen: the longest time with one and the same payload")
        handshake = bus.handshake
        if handshake is not None and handshake.response.p50_ms is not None:
            lines.append(
                f"handshake: {handshake.answered} answers, response time p50 {handshake.response.p50_ms:.2f} ms,"
                f" p99 {handshake.response.p99_ms:.2f} ms, max {handshake.response.max_ms:.2f} ms"
            )
    lines += [f"{finding.severity.value}: {finding.text}" for finding in findings]
    return "\n".join(lines) + "\n"


def _row(message: MessageStatistics) -> tuple[str, ...]:
    return (
        f"{message.can_id:08X}" if message.extended else f"{message.can_id:03X}",
        message.name or "?",
        str(message.count),
        "" if message.expected_ms is None else f"{message.expected_ms:g}",
        _ms(message.interval.p50_ms),
        _ms(message.jitter.p50_ms),
        _ms(message.jitter.p99_ms),
        _ms(message.jitter.max_ms),
        str(message.gaps),
        _ms(message.longest_gap_ms),
        f"{message.frozen_ms:.0f}",
        f"{message.load:.2%}",
    )


def _ms(value: float | None) -> str:
    return "" if value is None else f"{value:.2f}"
