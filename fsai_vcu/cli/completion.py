"""`fsai-vcu completion`: a script with which a shell completes this command, made from the parsers by shtab."""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, Final

from fsai_vcu.cli.main import Parser, all_verbs, parser_of
from fsai_vcu.core.supervision.supervisor import Mode
from fsai_vcu.diagnostics.decode.databases import load_databases
from fsai_vcu.interface.enums import Ami
from fsai_vcu.interface.errors import UserError
from fsai_vcu.interface.revisions import REVISIONS

EXAMPLE = (
    "fsai-vcu completion bash > ~/.local/share/bash-completion/completions/fsai-vcu\n"
    "  fsai-vcu completion zsh > ~/.zfunc/_fsai-vcu\n"
    "  fsai-vcu completion fish > ~/.config/fish/completions/fsai-vcu.fish"
)
ABOUT = """\
The script knows every verb, option and choice of this version: print it again
after an update. For the running shell only: eval "$(fsai-vcu completion bash)".
zsh looks in the folders of $fpath, set before compinit runs."""
SHELLS = ("bash", "zsh", "fish")

# A CAN interface has type 280 (linux/if_arp.h).
_INTERFACES: Final = "grep -lsx 280 /sys/class/net/*/type | cut -d/ -f5"
_PREAMBLE: Final = {
    "bash": f"""\
_fsai_vcu_interfaces() {{ compgen -W "$({_INTERFACES})" -- "$1"; }}
_fsai_vcu_files() {{ compgen -f -- "$1"; }}
_fsai_vcu_dirs() {{ compgen -d -- "$1"; }}
_fsai_vcu_sources_or_files() {{ _fsai_vcu_interfaces "$1"; _fsai_vcu_files "$1"; }}""",
    "zsh": f"""\
_fsai_vcu_interfaces() {{ compadd -- $({_INTERFACES}) }}
_fsai_vcu_sources_or_files() {{ _fsai_vcu_interfaces; _files }}""",
    "fish": f"""\
function _fsai_vcu_interfaces; {_INTERFACES}; end
function _fsai_vcu_files; __fish_complete_path (commandline -ct); end
function _fsai_vcu_sources_or_files; _fsai_vcu_interfaces; _fsai_vcu_files; end""",
}
# Bash breaks words at "=" too: the parts of --option=value are offered to shtab's function as two words.
_BASH_EQUALS: Final = """
_fsai_vcu() {
  local -a words=("${COMP_WORDS[@]:0:COMP_CWORD}") COMP_WORDS_KEPT=()
  local cur="${COMP_WORDS[COMP_CWORD]}" word
  for word in "${words[@]}"; do [[ $word == "=" ]] || COMP_WORDS_KEPT+=("$word"); done
  [[ $cur == "=" ]] && cur=""
  local -a COMP_WORDS=("${COMP_WORDS_KEPT[@]}" "$cur")
  local COMP_CWORD=${#COMP_WORDS_KEPT[@]}
  _shtab_fsai_vcu
}
complete -F _fsai_vcu fsai-vcu"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("shell", choices=SHELLS, help="for which shell")


def run(args: argparse.Namespace) -> int:
    try:
        import shtab
    except ImportError:  # no distribution's package of ROS brings it
        raise UserError("shtab is not installed; install it with: pip install shtab") from None
    text = shtab.complete(whole_parser(), args.shell, preamble=_PREAMBLE[args.shell])
    if args.shell == "bash":
        text += _BASH_EQUALS
    elif args.shell == "zsh":  # shtab knows neither --option=value nor a second value of an argument that takes many
        text = re.sub(r'^(  \S*--[\w-]+)(\}?"?\[.*\]:\w)', r"\1=\2", text, flags=re.MULTILINE)
        text = text.replace('"(*):', '"*:')
    print(text)
    return 0


def whole_parser() -> argparse.ArgumentParser:
    """One parser of the whole command line; each argument has what shtab offers for it."""
    root = Parser(prog="fsai-vcu")
    root.add_argument("--version", action="version", help="show the version")
    verbs = root.add_subparsers()
    for verb, (_, summary, _) in all_verbs().items():
        parser = verbs.add_parser(verb, help=summary, parents=[parser_of(verb)], add_help=False)
        for action in parser._actions:
            metavar = metavar_of(action)
            action.choices = action.choices or words_of(action)
            action.metavar = re.sub(r"\W+", " ", metavar)  # zsh gives a meaning to : and [
            if action.choices is None and action.nargs != 0 and (complete := _completer(action, metavar)):
                action.complete = complete  # type: ignore[attr-defined]
    return root


def metavar_of(action: argparse.Action) -> str:
    """Return the name that the help gives to an argument's value."""
    if action.metavar is None:
        return action.dest.upper().replace("_", "-")
    return action.metavar if isinstance(action.metavar, str) else " ".join(action.metavar)


def words_of(action: argparse.Action) -> tuple[str, ...] | None:
    """Return the words that an argument takes: its choices, or those that its name stands for; None: any word.

    A name stands for words where the parser leaves the choice to the code behind it.
    """
    if action.choices is not None:
        return tuple(map(str, action.choices))
    words: dict[str, Callable[[], Iterable[str]]] = {
        "revision": lambda: REVISIONS,
        "mission": lambda: (ami.name.lower() for ami in Ami if ami is not Ami.NOT_SELECTED),
        "mode": lambda: (mode.value for mode in Mode),
        "message": lambda: sorted(layout.name for layout in load_databases().layouts.values()),
    }
    return tuple(words[action.dest]()) if action.dest in words else None


def _completer(action: argparse.Action, metavar: str) -> dict[str, Any] | None:
    """Return what shtab takes for a file, a folder, a CAN interface or either; None: a number, or a free name."""
    parts = {part.partition(".")[0] for part in re.split(r"[|=]", re.split(r"[\[,]", metavar)[0])}
    files = not parts.isdisjoint({"FILE", "LOG", "RECORD", "PATH"}) or action.type is Path
    if "SOURCE" in parts or (files and "INTERFACE" in parts):
        name = "_fsai_vcu_sources_or_files"
    elif action.dest == "interface":
        name = "_fsai_vcu_interfaces"
    elif not parts.isdisjoint({"DIR", "FOLDER"}):
        return {"bash": "_fsai_vcu_dirs", "zsh": "_files -/", "fish": "(__fish_complete_directories)"}
    elif files:
        return {"bash": "_fsai_vcu_files", "zsh": "_files", "fish": "(_fsai_vcu_files)"}
    else:
        return None
    return {"bash": name, "zsh": name, "fish": f"({name})"}
