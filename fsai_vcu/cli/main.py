"""`fsai-vcu`: one command, one thin file per verb, imported only when it is asked for."""

from __future__ import annotations

import argparse
import errno
import gc
import importlib
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from types import ModuleType
from typing import Any, NoReturn, TextIO, cast

from fsai_vcu.interface.errors import UserError as UserError
from fsai_vcu.interface.errors import WrongUse as WrongUse
from fsai_vcu.interface.errors import did_you_mean
from fsai_vcu.printable import PrintableStream, printable

Verbs = dict[str, tuple[str, str, str]]
"""Verb -> (module, as `import_module` takes it within this package, what it does in one line, its group)."""

GROUPS: tuple[str, ...] = ("simulate", "your stack", "watch", "recordings", "running car", "machine", "other")
"""The groups of verbs in the order of the help; the last one is shown by `help --all` alone."""

OWN_VERBS: Verbs = {
    "mode": (".mode", "set the mode: autonomous or manual", "running car"),
    "emergency-brake": (".emergency_brake", "request an emergency brake", "running car"),
    "reset": (".reset", "clear a latched emergency request, in AS_OFF and AS_INIT", "running car"),
    "check-stack": (".check_stack", "watch a running stack over ROS 2, and list what it does wrong", "your stack"),
    "status": (".status", "show mode, AS state, and why the car is not driving yet, over ROS 2", "watch"),
    "config": (
        ".config",
        "check the car's configuration, /etc/fsai/fsai.toml, or show every setting in force",
        "machine",
    ),
    "doctor": (".doctor", "say what is right and what is wrong on this machine, and check the wheels", "machine"),
    "enclaves": (".enclaves", "make the keys and permissions with which the nodes' DDS is encrypted (SROS2)", "other"),
    "dump": (".dump", "show the frames of a bus or a log as candump does, with their signals", "watch"),
    "decode": (".dump", "decode every frame of a log: dump in candump's log format, with signals", "recordings"),
    "check": (".check", "say what is wrong on a bus or in a log; with --figures what each message did", "recordings"),
    "monitor": (
        ".monitor",
        "watch a bus or a log in the terminal: AS state, why the car is not driving, requests and measurements",
        "watch",
    ),
    "pitwall": (
        ".pitwall",
        "show a bus live, or play a log, on a web page for everybody around the car; never sends",
        "watch",
    ),
    "foxglove": (".foxglove", "show a bus live in Foxglove, decoded; never sends", "watch"),
    "explain": (
        ".explain",
        "explain a recorded run: what happened, why the car braked or did not start",
        "recordings",
    ),
    "report": (".report", "turn a recorded run into one page: plots, explanation and figures", "recordings"),
    "plot": (".plot", "draw any signals of a log over time, as a picture", "recordings"),
    "compare": (".compare", "say what differs between two logs: periods, values, problems", "recordings"),
    "dbc": (".dbc", "show messages and signals of a database (DBC), and how two of them differ", "machine"),
    "send": (".send", "send a frame by its signals, for the bench; never beside a live bridge", "machine"),
    "record": (".record", "record a bus, safe on the disk within a second; also as MCAP", "recordings"),
    "export": (".export", "turn a log into tables: CSV, Parquet, MCAP, MF4", "recordings"),
    "replay": (".replay", "send the frames of a log onto a bus (to look at a log: pitwall LOG)", "recordings"),
    "completion": (".completion", "print a script with which bash, zsh or fish complete this command", "other"),
    "reference": (".reference", "write the reference of all verbs, as Markdown or as a manual page", "other"),
}

OLD_NAMES: dict[str, tuple[str, ...]] = {"stats": ("check", "--figures"), "recorder": ("record", "--service")}
"""Verbs of an earlier release, and what they are now; each works for one release more."""


@cache
def all_verbs() -> Verbs:
    """All verbs: this package's, and those that others add by an entry point `fsai_vcu.verbs`, a table like it."""
    from importlib.metadata import entry_points

    added: Verbs = {}
    for entry in entry_points(group="fsai_vcu.verbs"):
        added |= entry.load()
    return added | OWN_VERBS


def _entry(verb: str) -> tuple[str, str, str]:
    """The table's entry of a verb; one of this package is found without looking for the others."""
    return OWN_VERBS.get(verb) or all_verbs()[verb]


class Parser(argparse.ArgumentParser):
    """Says what is wrong in one line, without the whole usage before it."""

    def error(self, message: str) -> NoReturn:
        _, unknown, words = message.partition("unrecognized arguments: ")
        if unknown and words.startswith("--"):
            options = (each for action in self._actions if action.help != argparse.SUPPRESS for each in _long(action))
            message += did_you_mean(words.split()[0].partition("=")[0], options, few=0)
        said = "; did you mean " in message or "; there are: " in message
        more = "" if said else f"; {self.prog} --help shows the arguments"
        if " are required: " in message and self.epilog:
            more = f", as in {self.epilog.splitlines()[1].strip()}{more}"
        self.exit(2, f"{self.prog}: {message}{more}\n")

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        """Raise ArgumentError for a word that is no choice, with those that were perhaps meant."""
        if action.choices is not None and value not in action.choices:
            named = action if action.option_strings else None  # the metavar of a position is no name
            meant = did_you_mean(str(value), map(str, action.choices), few=0)
            meant = meant or f"; there are: {', '.join(map(str, action.choices))}"
            raise argparse.ArgumentError(named, f"invalid choice: '{value}'{meant}")


def _long(action: argparse.Action) -> list[str]:
    return [each for each in action.option_strings if each.startswith("--")]


def module_of(verb: str) -> ModuleType:
    """The module of a verb: EXAMPLE, add_arguments(parser), run(args); ABOUT and parse(parser, argv) where needed."""
    return importlib.import_module(_entry(verb)[0], __package__)


def parser_of(verb: str) -> Parser:
    """The parser of a verb, whole: help, completion and the reference are all made from it."""
    module, summary = module_of(verb), _entry(verb)[1]
    parser = Parser(
        prog=f"fsai-vcu {verb}",
        description=f"{summary[0].upper()}{summary[1:]}.\n\n{getattr(module, 'ABOUT', '')}".rstrip(),
        epilog=f"example:\n  {module.EXAMPLE.replace('VERB', verb)}",  # of a program with two names
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    module.add_arguments(parser)
    return parser


def main(argv: Sequence[str] | None = None, at_work: Callable[[], object] | None = None) -> int:
    """Run one verb. Exit status: 0 done, 1 failed, 2 wrong use, 130 interrupted.

    at_work: called when its modules are loaded.
    """
    arguments = list(sys.argv[1:] if argv is None else argv)
    gc.set_threshold(100_000)  # what a verb loads stays: looking through it for garbage again and again takes long
    bytes(8 << 20)  # after this the C library keeps what is freed for the next columns (mallopt(3), M_MMAP_THRESHOLD)
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # matrices here are small: other threads would only spin
    try:
        try:
            with printable_output():
                return _run(arguments, at_work or (lambda: None))
        except KeyboardInterrupt:
            print(f"{_named(arguments)}: interrupted", file=sys.stderr)
            return 130
        finally:
            # Python kills itself by SIGINT at its end when Ctrl-C came in an exec (a dataclass is made in one), even if
            # that was answered; only another exec makes it forget.
            exec("")
            sys.stdout.flush()  # not at the end of the process, where nobody could say what went wrong
    except OSError as error:
        if error.errno not in _OF_OUTPUT:
            raise
        # What is still waiting to be written has nowhere to go, at the end of the process either.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        if error.errno == errno.EPIPE:  # the reader (a pager, `head`) has gone: that is its good right
            return 0
        print(f"{_named(arguments)}: cannot write {error.filename or 'the output'}: {error.strerror}", file=sys.stderr)
        return 1


def _named(arguments: Sequence[str]) -> str:
    return printable(" ".join(["fsai-vcu", *arguments[:1]]))


@contextmanager
def printable_output() -> Iterator[None]:
    """Keep printed text from doing more to a terminal than to be seen, from wherever the names in it are."""
    streams = sys.stdout, sys.stderr
    sys.stdout, sys.stderr = (cast("TextIO", PrintableStream(stream)) for stream in streams)
    try:
        yield
    finally:
        sys.stdout, sys.stderr = streams


_OF_OUTPUT = (errno.EPIPE, errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)


def _run(arguments: list[str], at_work: Callable[[], object]) -> int:
    """Find the verb in the arguments, parse the rest with its parser and run it; return the exit status."""
    if not arguments or arguments[0] in ("-h", "--help") or arguments in (["help"], ["help", "--all"]):
        _print_help("--all" in arguments)
        return 0 if arguments else 2
    if arguments[0] == "help":
        arguments = [*arguments[1:2], "--help"]
    if arguments[0] == "--version":
        from importlib.metadata import version

        print(f"fsai-vcu {version('fsai-vcu')}")
        return 0
    if now := OLD_NAMES.get(arguments[0]):
        print(f"fsai-vcu: {arguments[0]} is now called {' '.join(now)}", file=sys.stderr)
        arguments = [*now, *arguments[1:]]
    verb = arguments[0]
    if verb not in OWN_VERBS and verb not in all_verbs():
        from fsai_vcu.cli.guesses import meant

        near = " or ".join(meant(verb, all_verbs()))
        more = f"did you mean {near}?" if near else "fsai-vcu --help lists the verbs"
        print(f"fsai-vcu: no verb '{printable(verb)}'; {more}", file=sys.stderr)
        return 2
    module = module_of(verb)
    parser = parser_of(verb)
    parse = getattr(module, "parse", Parser.parse_intermixed_args)  # options may stand between arguments
    words = arguments[1:]
    if parse is Parser.parse_intermixed_args and "--" in words:  # which that would read as if it were not there
        at = words.index("--")
        words = words[:at] + [f"./{word}" if word.startswith("-") and word != "-" else word for word in words[at + 1 :]]
    args = parse(parser, words)
    at_work()
    try:
        return int(module.run(args))
    except UserError as error:
        if isinstance(error.__cause__, BrokenPipeError):  # of the output, whatever else the verb was about
            raise error.__cause__ from None
        print(f"fsai-vcu {verb}: {printable(str(error))}", file=sys.stderr)
        return 2 if isinstance(error, WrongUse) else 1


def _print_help(everything: bool) -> None:
    width = max(len(verb) for verb in all_verbs())
    print("usage: fsai-vcu VERB [options]\n\nThe software between a Formula Student AI stack and the ADS-DV's VCU.")
    for group in GROUPS if everything else GROUPS[:-1]:
        print(f"\n{group}:")
        for verb, (_, summary, of) in all_verbs().items():
            if of == group:
                print(f"  {verb:<{width}}  {summary}")
    print("\n`fsai-vcu help VERB` shows the options and an example:\n  fsai-vcu drive --mission trackdrive --laps 2")
    print("\nWith ROS 2, in the checkout: `make drive` drives, records and shows the pit wall, until Ctrl-C.")
    if not everything:
        print("Seldom used verbs: fsai-vcu help --all")
    print("\nThe field's words (AS state, AMI, ASMS, RES, EBS, Go) are in docs/glossary.md.")


if __name__ == "__main__":
    # Run as `python -m`, this file is another module than the one from which the verbs import UserError.
    sys.exit(importlib.import_module("fsai_vcu.cli.main").main())
