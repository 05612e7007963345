"""What can be typed after `fsai-vcu`, as plain data read from the parsers: for completion and for the reference."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Final


class Kind(Enum):
    """What a value is, for who completes it."""

    NOTHING = "nothing"  # a number, a name that nobody can guess
    WORDS = "words"
    FILE = "file"
    FOLDER = "folder"
    INTERFACE = "interface"
    SOURCE = "source"  # a file or an interface


@dataclass(frozen=True, slots=True)
class Value:
    """A value that is typed. `metavar`: how the help calls it. `many`: it may be repeated."""

    metavar: str
    kind: Kind
    words: tuple[str, ...] = ()
    many: bool = False
    required: bool = True


@dataclass(frozen=True, slots=True)
class Option:
    """An option with all its spellings; `value` None: a switch."""

    names: tuple[str, ...]
    help: str
    value: Value | None
    required: bool = False


@dataclass(frozen=True, slots=True)
class Positional:
    help: str
    value: Value


@dataclass(frozen=True, slots=True)
class Verb:
    """A verb, or a verb and its sub-verb. `words`: as typed."""

    words: str
    summary: str
    description: str
    options: tuple[Option, ...]
    positionals: tuple[Positional, ...]
    subverbs: tuple[str, ...]
    examples: tuple[str, ...]


_FOLDER_WORDS: Final = ("DIR", "FOLDER")
_FILE_WORDS: Final = ("FILE", "LOG", "RECORD", "PATH")


def verbs() -> tuple[Verb, ...]:
    """Every verb of the command line, in the order of its help."""
    from fsai_vcu.cli.main import all_verbs, parser_of

    return tuple(
        verb for name, (_, summary) in all_verbs().items() for verb in _verbs_of(name, summary, parser_of(name))
    )


def examples_of(parser: argparse.ArgumentParser) -> tuple[str, ...]:
    """The command lines in a parser's epilog."""
    _, _, text = (parser.epilog or "").partition("example:\n")
    return tuple(line.strip() for line in text.splitlines() if line.strip())


def _verbs_of(words: str, summary: str, parser: argparse.ArgumentParser) -> Iterator[Verb]:
    options: list[Option] = []
    positionals: list[Positional] = []
    below: list[Verb] = []
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            said = {choice.dest: choice.help or "" for choice in action._choices_actions}
            for name, sub in action.choices.items():
                below += _verbs_of(f"{words} {name}", said.get(name, ""), sub)
        elif action.help is argparse.SUPPRESS:
            continue
        elif action.option_strings:
            value = None if action.nargs == 0 else _value(action)
            options.append(Option(tuple(action.option_strings), _help(parser, action), value, action.required))
        else:
            positionals.append(Positional(_help(parser, action), _value(action)))
    yield Verb(
        words,
        summary,
        parser.description or "",
        tuple(options),
        tuple(positionals),
        tuple(verb.words.removeprefix(f"{words} ") for verb in below),
        examples_of(parser),
    )
    yield from below


def _help(parser: argparse.ArgumentParser, action: argparse.Action) -> str:
    """An argument's help with what it quotes put in."""
    return " ".join(parser._get_formatter()._expand_help(action).split()) if action.help else ""


def _value(action: argparse.Action) -> Value:
    metavar = action.metavar
    if isinstance(metavar, tuple):
        metavar = " ".join(metavar)
    if metavar is None:
        metavar = action.dest.upper().replace("_", "-")
    kind, words = _kind(action, metavar)
    many = action.nargs in ("+", "*") or (isinstance(action.nargs, int) and action.nargs > 1)
    return Value(metavar, kind, words, many, action.nargs not in ("*", "?"))


def _kind(action: argparse.Action, metavar: str) -> tuple[Kind, tuple[str, ...]]:
    words = tuple(map(str, action.choices)) if action.choices is not None else _known_words(action.dest)
    if words:
        return Kind.WORDS, words
    parts = metavar.partition("[")[0].partition(",")[0].replace("=", "|").split("|")
    files = any(part.partition(".")[0] in _FILE_WORDS for part in parts) or action.type is Path
    if action.dest == "interface" or "INTERFACE" in parts or metavar.startswith("SOURCE"):
        return (Kind.SOURCE if files or metavar.startswith("SOURCE") else Kind.INTERFACE), ()
    if any(part.partition(".")[0] in _FOLDER_WORDS for part in parts):
        return Kind.FOLDER, ()
    return (Kind.FILE if files else Kind.NOTHING), ()


def _known_words(dest: str) -> tuple[str, ...]:
    """What an argument of this name takes, where its parser leaves that to the code behind it."""
    if dest == "revision":
        from fsai_vcu.interface.revisions import REVISIONS

        return tuple(REVISIONS)
    if dest == "mission":
        from fsai_vcu.interface.enums import Ami

        return tuple(ami.name.lower() for ami in Ami if ami is not Ami.NOT_SELECTED)
    if dest == "mode":
        from fsai_vcu.core.supervision.supervisor import Mode

        return tuple(mode.value for mode in Mode)
    if dest == "message":
        from fsai_vcu.diagnostics.decode.databases import load_databases

        return tuple(sorted(layout.name for layout in load_databases().layouts.values()))
    return ()
