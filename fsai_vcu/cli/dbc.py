"""`fsai-vcu dbc`: what a signal database says: its messages, their signals, and how two databases differ."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path

from fsai_vcu.diagnostics.decode.databases import Databases, load_databases
from fsai_vcu.diagnostics.decode.layouts import MessageLayout, SignalLayout
from fsai_vcu.interface.errors import UserError, WrongUse, did_you_mean
from fsai_vcu.interface.revisions import REVISIONS
from fsai_vcu.printable import printable

EXAMPLE = (
    "fsai-vcu dbc show 0x520\n  fsai-vcu dbc show ANGLE\n  fsai-vcu dbc show steering\n  fsai-vcu dbc diff 2021 2026"
)
ABOUT = """\
A database is a file that cantools reads, or the name of an interface revision
(2021 or 2026). list: its messages; show: signals by message name (or a word of
it), pattern or identifier, or by a signal's name; diff: what differs. Exit
status: 0 done (diff: no difference), 1 a name is not found, or a difference, 2
wrong use."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("what", metavar="list|show|diff", help="what to print; show may be left out")
    add("names", nargs="*", metavar="NAME", help="show: messages, or signals; diff: two databases")
    add("--dbc", metavar="FILE|REVISION", default="2026", help="list, show: the database (default: 2026)")
    add("--json", action="store_true", help="one JSON object per message, or per difference")


def run(args: argparse.Namespace) -> int:
    """Print the messages of a database, or the differences between two, and return the exit status."""
    if args.what not in ("list", "show", "diff"):
        args.what, args.names = "show", [args.what, *args.names]
    if args.what == "diff":
        if len(args.names) != 2:
            raise WrongUse("diff takes two databases: fsai-vcu dbc diff 2021 2026")
        lines = list(_differences(*(_load(name).layouts for name in args.names)))
        if args.json:
            lines = [json.dumps({"only_in": args.names["-+".index(line[0])], "words": line[2:]}) for line in lines]
        for line in lines or ([] if args.json else ["no difference"]):
            print(line)
        return 1 if lines else 0
    layouts = sorted(_load(args.dbc).layouts.values(), key=lambda layout: (layout.extended, layout.can_id))
    found = {
        name: [one for one in layouts if _asked(one, name)] or [one for one in layouts if one.has_in_name(name)]
        for name in args.names
    }
    chosen = [one for one in layouts if not args.names or any(one in each for each in found.values())]
    unknown = [name for name, each in found.items() if not each]
    for layout in chosen:
        if args.json:
            print(json.dumps(_as_dict(layout, args.what == "show")))
            continue
        print(_head(layout))
        if args.what == "show":
            print(f"    {printable(layout.comment)}\n" if layout.comment else "", end="")
            print("".join(f"    {_shown(signal)}\n" for signal in layout.signals), end="")
    if unknown:
        names = (layout.name for layout in layouts)
        signals = (signal.name for layout in layouts for signal in layout.signals)
        meant = did_you_mean(unknown[0], (*names, *signals))
        raise UserError(f"no message or signal {' or '.join(unknown)} in {args.dbc}{meant}")
    return 0


def _asked(layout: MessageLayout, name: str) -> bool:
    """Return true for the name of the message, or of a signal in it."""
    return layout.is_called(name) or any(signal.name.casefold() == name.casefold() for signal in layout.signals)


def _load(name: str) -> Databases:
    databases = load_databases((), name) if name in REVISIONS else load_databases([Path(name)])
    for text in databases.left_out:
        print(f"fsai-vcu dbc: {printable(text)}", file=sys.stderr)
    return databases


def _head(layout: MessageLayout) -> str:
    period = "" if layout.period_ms is None else f", every {layout.period_ms} ms"
    length = "1 byte" if layout.length == 1 else f"{layout.length} bytes"
    return f"{_number(layout)} {layout.name}: {length}{period}, from {', '.join(layout.senders) or 'nobody'}"


def _as_dict(layout: MessageLayout, with_signals: bool) -> dict[str, object]:
    names = {"can_id": "id", "name": "message", "senders": "from"}
    found = {names.get(name, name): value for name, value in layout._asdict().items() if name != "plain"}
    if not with_signals:
        return found | {"signals": [signal.name for signal in layout.signals]}
    return found | {"signals": [signal._asdict() for signal in layout.signals]}


def _number(layout: MessageLayout) -> str:
    return f"0x{layout.can_id:08X}" if layout.extended else f"0x{layout.can_id:03X}"


def _signal(signal: SignalLayout) -> str:
    kind = "float" if signal.is_float else "signed" if signal.signed else "unsigned"
    unit = f" {signal.unit}" if signal.unit else ""
    scale = f", x {signal.scale:g}" if signal.scale != 1 else ""
    offset = f" {signal.offset:+g}" if signal.offset else ""
    words = ", ".join(f"{value} {word}" for value, word in sorted(signal.choices.items()))
    bits = "1 bit" if signal.length == 1 else f"{signal.length} bits"
    return f"{signal.name}: bit {signal.start}, {bits} {kind}{scale}{offset}{unit}{': ' + words if words else ''}"


def _shown(signal: SignalLayout) -> str:
    """The signal with its range, byte order and comment; what is told at once by one bit or by words is left out."""
    found = _signal(signal)
    if not signal.choices and signal.length > 1:
        if signal.minimum is not None and signal.maximum is not None:
            found += f", {signal.minimum:g} to {signal.maximum:g}"
        if signal.length > 8 or signal.big_endian:
            found += ", big-endian" if signal.big_endian else ", little-endian"
    return f"{found}\n        {printable(signal.comment)}" if signal.comment else found


def _differences(ours: Mapping[int, MessageLayout], theirs: Mapping[int, MessageLayout]) -> Iterator[str]:
    """Yield a line for each message or signal that only one of the databases has, or has otherwise."""
    for key in sorted({*ours, *theirs}):
        mine, other = ours.get(key), theirs.get(key)
        if mine is None or other is None:
            there = mine or other
            assert there is not None
            yield f"{'-' if other is None else '+'} {_head(there)}"
            continue
        if _head(mine) != _head(other):
            yield f"- {_head(mine)}"
            yield f"+ {_head(other)}"
        before, after = ({signal.name: _signal(signal) for signal in each.signals} for each in (mine, other))
        for name in dict.fromkeys((*before, *after)):
            if before.get(name) != after.get(name):
                where = f"{_number(other)} {other.name}"
                yield from (
                    f"{sign} {where}: {each[name]}" for sign, each in (("-", before), ("+", after)) if name in each
                )
