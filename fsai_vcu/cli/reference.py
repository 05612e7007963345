"""`fsai-vcu reference`: every verb, argument and option on one page, made from the parsers."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from itertools import chain
from pathlib import Path

from fsai_vcu.cli.completion import metavar_of, words_of
from fsai_vcu.cli.main import GROUPS, all_verbs, parser_of
from fsai_vcu.files import write_whole
from fsai_vcu.interface.errors import UserError

EXAMPLE = "fsai-vcu reference -o docs/reference.md\n  fsai-vcu reference --man | man -l -"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("-o", "--output", type=Path, metavar="FILE", help="write it there (default: the terminal)")
    parser.add_argument("--man", action="store_true", help="a manual page (roff) instead of Markdown")


def run(args: argparse.Namespace) -> int:
    text = manual() if args.man else markdown()
    if args.output is None:
        sys.stdout.write(text)
        return 0
    try:
        args.output.parent.mkdir(parents=True, exist_ok=True)
        write_whole(args.output, text.encode())
    except OSError as error:
        raise UserError(f"{args.output} cannot be written: {error.strerror or error}") from error
    print(f"saved {args.output}")
    return 0


_INTRODUCTION = """\
One command, a verb, its arguments. `fsai-vcu --help` lists the verbs, `fsai-vcu VERB --help` shows what stands here.
Wrong use and bad input are answered with one clear line."""
_STATUSES = (
    ("0", "done, and all is well"),
    ("1", "failed, refused, not wholly readable, or what was looked at is not well"),
    ("2", "wrong use"),
    ("130", "interrupted with Ctrl-C"),
)


def examples_of(parser: argparse.ArgumentParser) -> list[str]:
    """The command lines in a parser's epilog."""
    return [line.strip() for line in (parser.epilog or "").splitlines()[1:] if line.strip()]


def markdown() -> str:
    """The page as Markdown."""
    groups = _groups()
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
        "| group | verbs |",
        "|---|---|",
        *(f"| {group} | {', '.join(f'[{verb}](#fsai-vcu-{verb})' for verb, _, _ in of)} |" for group, of in groups),
    ]
    for group, verbs in groups:
        lines += ["", f"## {group[0].upper()}{group[1:]}"]
        for verb, _, parser in verbs:
            lines += ["", f"### fsai-vcu {verb}", "", *_paragraphs(parser), "", f"    {_synopsis(parser)}"]
            if rows := list(_rows(parser)):
                lines += ["", "| argument | meaning |", "|---|---|"]
                lines += [f"| `{_cell(name)}` | {_cell(meaning)} |" for name, meaning in rows]
            lines += ["", "Example:", "", *(f"    {line}" for line in examples_of(parser))]
    return "\n".join(lines) + "\n"


def manual() -> str:
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
    for verb, _, parser in chain.from_iterable(verbs for _, verbs in _groups()):
        lines += [f".SS {_roff(verb)}", *(_roff(line) for line in _paragraphs(parser))]
        lines += [".PP", f".B {_roff(_synopsis(parser))}"]
        for name, meaning in _rows(parser):
            lines += [".TP", f".B {_roff(name)}", _roff(meaning)]
        lines += [".PP", ".nf", *(_roff(line) for line in examples_of(parser)), ".fi"]
    lines.append(".SH EXIT STATUS")
    for status, meaning in _STATUSES:
        lines += [".TP", f".B {status}", _roff(meaning)]
    return "\n".join(line if line else ".PP" for line in lines) + "\n"


def _groups() -> list[tuple[str, list[tuple[str, str, argparse.ArgumentParser]]]]:
    """(group, its (verb, what it does, its parser)), in the order of the help."""
    return [
        (group, [(verb, summary, parser_of(verb)) for verb, (_, summary, of) in all_verbs().items() if of == group])
        for group in GROUPS
    ]


def _synopsis(parser: argparse.ArgumentParser) -> str:
    """Return the line that shows how a verb is typed."""
    options, positionals = parser._get_optional_actions(), parser._get_positional_actions()
    required = [f"{option.option_strings[0]} {metavar_of(option)}" for option in options if option.required]
    return " ".join([parser.prog, *required, "[options]", *map(_typed, positionals)])


def _typed(action: argparse.Action) -> str:
    """Return the text that shows how an argument is typed."""
    names = ", ".join(action.option_strings)
    if action.nargs == 0:
        return names
    words = words_of(action) or ()
    value = "|".join(words) if 0 < len(words) < 6 else metavar_of(action)
    if names:
        return f"{names} {value}"
    value += " …" if action.nargs in ("+", "*") else ""
    return f"[{value}]" if action.nargs in ("*", "?") else value


def _rows(parser: argparse.ArgumentParser) -> Iterator[tuple[str, str]]:
    """(what is typed, what it means) of each argument and option but --help."""
    formatter = parser._get_formatter()
    for action in [*parser._get_positional_actions(), *parser._get_optional_actions()]:
        if "--help" not in action.option_strings and action.help is not argparse.SUPPRESS:
            yield _typed(action), " ".join(formatter._expand_help(action).split())


def _paragraphs(parser: argparse.ArgumentParser) -> list[str]:
    return [line.rstrip() for line in (parser.description or "").strip().splitlines()]


def _cell(text: str) -> str:
    return text.replace("|", "\\|")


def _roff(text: str) -> str:
    """Text that roff takes for nothing else."""
    escaped = text.replace("\\", r"\e").replace("-", r"\-")
    return "\n".join(rf"\&{line}" if line.startswith((".", "'")) else line for line in escaped.split("\n"))
