"""`fsai-vcu reference`: every verb, argument and option on one page, made from the parsers."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from fsai_vcu.cli.grammar import Option, Value, Verb

EXAMPLE = "fsai-vcu reference -o docs/reference.md\n  fsai-vcu reference --man | man -l -"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("-o", "--output", type=Path, metavar="FILE", help="write it there (default: the terminal)")
    parser.add_argument("--man", action="store_true", help="a manual page (roff) instead of Markdown")


def run(args: argparse.Namespace) -> int:
    from fsai_vcu.cli.grammar import verbs
    from fsai_vcu.cli.main import UserError

    text = manual(verbs()) if args.man else markdown(verbs())
    if args.output is None:
        sys.stdout.write(text)
        return 0
    try:
        args.output.parent.mkdir(parents=True, exist_ok=True)
        args.output.write_text(text, encoding="utf-8")
    except OSError as error:
        raise UserError(f"{args.output} cannot be written: {error.strerror or error}") from error
    print(f"saved {args.output}")
    return 0


_INTRODUCTION = """\
One command, a verb, its arguments. `fsai-vcu --help` lists the verbs, `fsai-vcu VERB --help` says what is said here.
Wrong use and bad input are answered with one clear line."""
_STATUSES = (
    ("0", "done, and all is well"),
    ("1", "failed, refused, not wholly readable, or what was looked at is not well"),
    ("2", "wrong use"),
    ("130", "interrupted with Ctrl-C"),
)


def markdown(verbs: Sequence[Verb]) -> str:
    """The page as Markdown."""
    lines = [
        "# fsai-vcu: reference",
        "",
        "Made from the command line's own parsers by `fsai-vcu reference -o docs/reference.md`: not to be edited.",
        "",
        _INTRODUCTION,
        "",
        "| exit status | meaning |",
        "|---|---|",
        *(f"| {status} | {meaning} |" for status, meaning in _STATUSES),
        "",
        "| verb | what it does |",
        "|---|---|",
        *(f"| [{v.words}](#fsai-vcu-{v.words.replace(' ', '-')}) | {_cell(v.summary)} |" for v in verbs),
    ]
    for verb in verbs:
        lines += ["", f"## fsai-vcu {verb.words}", "", *_paragraphs(verb.description), "", f"    {synopsis(verb)}"]
        rows = list(_rows(verb))
        if rows:
            lines += ["", "| argument | meaning |", "|---|---|"]
            lines += [f"| `{_cell(name)}` | {_cell(meaning)} |" for name, meaning in rows]
        if verb.examples:
            lines += ["", "Example:", "", *(f"    {line}" for line in verb.examples)]
    return "\n".join(lines) + "\n"


def manual(verbs: Sequence[Verb]) -> str:
    """The page as roff with the man macros, for man(1)."""
    lines = [
        '.TH FSAI-VCU 1 "" "fsai-vcu" "User Commands"',
        ".SH NAME",
        r"fsai-vcu \- the software between a Formula Student AI stack and the ADS-DV's VCU",
        ".SH SYNOPSIS",
        r".B fsai-vcu",
        r"\fIVERB\fR [\fIoptions\fR]",
        ".SH DESCRIPTION",
        _roff(_INTRODUCTION.replace("`", "")),
        ".SH VERBS",
    ]
    for verb in verbs:
        lines += [f".SS {_roff(verb.words)}", *(_roff(line) for line in _paragraphs(verb.description))]
        lines += [".PP", f".B {_roff(synopsis(verb))}"]
        for name, meaning in _rows(verb):
            lines += [".TP", f".B {_roff(name)}", _roff(meaning)]
        if verb.examples:
            lines += [".PP", ".nf", *(_roff(line) for line in verb.examples), ".fi"]
    lines.append(".SH EXIT STATUS")
    for status, meaning in _STATUSES:
        lines += [".TP", f".B {status}", _roff(meaning)]
    return "\n".join(line if line else ".PP" for line in lines) + "\n"


def synopsis(verb: Verb) -> str:
    """How a verb is typed, in one line."""
    words = [f"fsai-vcu {verb.words}"]
    required = [option for option in verb.options if option.required and option.value is not None]
    words += [f"{option.names[0]} {option.value.metavar}" for option in required if option.value is not None]
    words.append("[options]")
    if verb.subverbs:
        words.append("{" + "|".join(verb.subverbs) + "}")
    words += [_typed(positional.value) for positional in verb.positionals]
    return " ".join(words)


def _typed(value: Value) -> str:
    name = "|".join(value.words) if value.words and len(value.words) < 6 else value.metavar
    many = f"{name} …" if value.many else name
    return many if value.required else f"[{many}]"


def _rows(verb: Verb) -> Iterator[tuple[str, str]]:
    """(what is typed, what it means) of each argument and option but --help."""
    for positional in verb.positionals:
        yield _typed(positional.value), positional.help
    for option in verb.options:
        if "--help" not in option.names:
            yield _spelt(option), option.help


def _spelt(option: Option) -> str:
    names = ", ".join(option.names)
    if option.value is None:
        return names
    value = option.value
    shown = "|".join(value.words) if value.words and len(value.words) < 6 else value.metavar
    return f"{names} {shown}"


def _paragraphs(text: str) -> list[str]:
    return [line.rstrip() for line in text.strip().splitlines()]


def _cell(text: str) -> str:
    return text.replace("|", "\\|")


def _roff(text: str) -> str:
    """Text that roff takes for nothing else."""
    escaped = text.replace("\\", r"\e").replace("-", r"\-")
    return "\n".join(rf"\&{line}" if line.startswith((".", "'")) else line for line in escaped.split("\n"))
