"""`fsai-vcu compare`: what differs between two logs: messages and their periods, values of signals, the verdicts."""

from __future__ import annotations

import argparse
import json
import sys
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby
from typing import Any, Final

import numpy as np

from fsai_vcu.cli.decoding import Decoding, add_database_arguments
from fsai_vcu.cli.sources import Sources, add_part_arguments, judged
from fsai_vcu.diagnostics.decode.layouts import MessageLayout
from fsai_vcu.diagnostics.explain.record import Record, Series
from fsai_vcu.diagnostics.explain.signals import Signal
from fsai_vcu.diagnostics.finding import Finding
from fsai_vcu.diagnostics.statistics.measure import BusStatistics
from fsai_vcu.diagnostics.verdict.verdict import Verdict
from fsai_vcu.interface.errors import UserError

EXAMPLE = "fsai-vcu compare yesterday.log today.log"
ABOUT = """\
Prints the problems that check finds in each log; states that differ; numbers
whose least, greatest or mean value differs by more than 10 % of their range (the
first log's values, then the second's); messages that only one log has; and mean
periods that differ by more than 10 %.
Exit status: 0 nothing differs, 1 something differs or could not be read, 2 wrong
use. --from and --to count from each log's own first frame; with --messages or
--signals no problems are printed."""
SHARE: Final = 0.1
SHOWN: Final = 4  # words of a signal, the most frequent ones
TOLD: Final = ("missing", "period")
Difference = tuple[str, dict[str, Any]]  # in words, and what --json prints of it


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("logs", nargs=2, metavar="LOG", help="any log that decode reads")
    add_part_arguments(parser, signals=True)
    add_database_arguments(parser)
    parser.add_argument("--json", action="store_true", help="one JSON object per difference")


def run(args: argparse.Namespace) -> int:
    """Read both logs, judge them and print what differs."""
    decoding = Decoding("compare", args)
    patterns = decoding.patterns(args.signals)
    found, status = [], 0
    for name in args.logs:
        sources = Sources("compare", [name])
        if sources.live:
            raise UserError(f"{name} is a bus; compare takes two logs")
        one = judged(args, sources, decoding)
        if one is None:
            return 1
        status |= sources.status
        if (one.record.decoder.which(one.record.frames) < 0).all():
            print(f"fsai-vcu compare: the databases name no frame of {name}: no values are compared", file=sys.stderr)
            status = 1
        found.append(one)
    first, second = (one.record for one in found)
    differences: list[Difference] = []
    if not (patterns or args.messages):  # some messages alone have no story
        for name, here, there in zip(args.logs, found, reversed(found), strict=True):
            for line in _problems(here.verdict, there.verdict):
                differences.append((f"only in {name}: {line}", {"problem": line, "only_in": name}))
    if first.revision.name != second.revision.name:
        revisions = {"first": first.revision.name, "second": second.revision.name}
        differences.append(
            ("interface revision: first {first}, second {second}".format(**revisions), {"revision": revisions})
        )
    states, numbers = _signals(first, second, patterns or ["*"])
    differences += states
    layouts = first.decoder.databases.layouts
    differences += [] if patterns else _messages(args.logs, layouts, *(one.bus for one in found))
    differences += numbers
    if args.json:
        print("".join(f"{json.dumps({**facts, 'words': words})}\n" for words, facts in differences), end="")
    else:
        print("\n".join(_for_people(args.logs, differences)) if differences else "nothing differs")
    return 1 if differences else status


def _for_people(logs: Sequence[str], differences: Sequence[Difference]) -> Iterator[str]:
    """The lines: which log is which, then the differences, with the messages of one log only in one line."""
    yield f"first: {logs[0]}, second: {logs[1]}"
    for alone, some in groupby(differences, lambda one: one[1].get("only_in", "") if "message" in one[1] else ""):
        if alone:
            yield f"only in {alone}: {', '.join(_alone(list(some), f'only in {alone}: '))}"
        else:
            yield from (words for words, _ in some)


def _alone(some: Sequence[Difference], begin: str) -> Iterator[str]:
    """The messages of one log only; those of a sender that the other log lacks together."""
    senders = Counter(facts.get("all_of") for _, facts in some)
    for words, facts in some:
        sender = facts.get("all_of")
        if not sender or senders[sender] == 1:
            yield words.removeprefix(begin)
        elif senders.pop(sender, 0):
            ids = ", ".join(f"0x{other['id']:03X}" for _, other in some if other.get("all_of") == sender)
            yield f"all of {sender} ({ids})"


def _problems(here: Verdict, there: Verdict) -> Iterator[str]:
    """Sentences on what is unknown or a problem in a log and not in the other, but for what `_messages` tells."""
    yield from (f"unknown: {why}" for why in here.unknown if why not in there.unknown)

    def kind_of(finding: Finding) -> tuple[object, ...]:
        return finding.severity, finding.kind, finding.can_ids, finding.remedy  # and not its figures

    known = Counter(map(kind_of, there.findings))
    for finding in here.findings:
        known[kind_of(finding)] -= 1
        if finding.severity == "problem" and finding.kind not in TOLD and known[kind_of(finding)] < 0:
            yield f"{here.moment(finding)}{finding.words}"


def _messages(
    logs: Sequence[str], layouts: Mapping[int, MessageLayout], first: BusStatistics, second: BusStatistics
) -> Iterator[Difference]:
    """The messages of one log only, those of a log together, then other periods."""
    periods_differ: list[Difference] = []
    alone: tuple[list[Difference], list[Difference]] = [], []
    ours, theirs = ({(m.extended, m.can_id): m for m in bus.messages} for bus in (first, second))
    sender = {(one.extended, one.can_id): ", ".join(one.senders) for one in layouts.values()}
    heard = [{sender.get(key, "") for key in log} for log in (ours, theirs)]
    for key in sorted({*ours, *theirs}):
        before, after = ours.get(key), theirs.get(key)
        there = before or after
        assert there is not None
        name = f"0x{there.can_id:03X} {there.name or 'unknown'}"
        periods = {"first": before and before.mean_ms, "second": after and after.mean_ms}
        facts = {"message": there.name, "id": there.can_id, "mean_ms": periods}
        if before is None or after is None:
            where, of = logs[before is None], sender.get(key, "")
            facts |= {"only_in": where} | ({"all_of": of} if of and of not in heard[after is None] else {})
            alone[before is None].append((f"only in {where}: {name}", facts))
        elif before.mean_ms and after.mean_ms and abs(after.mean_ms / before.mean_ms - 1.0) > SHARE:
            words = f"{name}: first every {before.mean_ms:.1f} ms, second every {after.mean_ms:.1f} ms"
            periods_differ.append((words, facts))
    yield from (*alone[0], *alone[1], *periods_differ)


def _signals(first: Record, second: Record, patterns: list[str]) -> tuple[list[Difference], list[Difference]]:
    """The signals that differ: states, then numbers."""
    states: list[Difference] = []
    numbers: list[Difference] = []
    for layout in first.decoder.databases.layouts.values():
        for signal in layout.signals_like(patterns):
            before, after = (record.series(Signal(layout.name, signal.name)) for record in (first, second))
            if not len(before) or not len(after):
                continue
            ranges = [(float(s.values.min()), float(s.values.mean()), float(s.values.max())) for s in (before, after)]
            width = max(ranges[0][2], ranges[1][2]) - min(ranges[0][0], ranges[1][0])
            if any(abs(new - old) > SHARE * width for old, new in zip(*ranges, strict=True)):
                words = ", ".join(
                    f"{which} {_shares(series, signal.choices)}"
                    if signal.choices
                    else f"{which} {low:g} to {high:g} (mean {mean:.4g})"
                    for which, series, (low, mean, high) in zip(
                        ("first", "second"), (before, after), ranges, strict=True
                    )
                )
                facts: dict[str, Any] = {"signal": f"{layout.name}.{signal.name}", "unit": signal.unit}
                for log, (low, mean, high) in zip(("first", "second"), ranges, strict=True):
                    facts[log] = {"min": low, "mean": mean, "max": high}
                found = f"{layout.name}.{signal.name}: {words} {signal.unit}".rstrip(), facts
                (states if signal.choices else numbers).append(found)
    return states, numbers


def _shares(series: Series, choices: Mapping[int, str]) -> str:
    """The words that a signal had, and in which share of its frames."""
    values, counts = np.unique(series.values, return_counts=True)
    most = np.argsort(-counts, kind="stable")[:SHOWN]
    shares = (f"{choices.get(int(values[at]), f'{values[at]:g}')} {counts[at] / len(series):.0%}" for at in most)
    others = 1.0 - counts[most].sum() / len(series)
    return " ".join((*shares, *([f"others {others:.0%}"] if len(counts) > SHOWN else [])))
