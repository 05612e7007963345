"""`fsai-vcu completion`: a script with which a shell completes this command, made from the parsers."""

from __future__ import annotations

import argparse

EXAMPLE = (
    "fsai-vcu completion bash > ~/.local/share/bash-completion/completions/fsai-vcu\n"
    "  fsai-vcu completion zsh > ~/.zfunc/_fsai-vcu\n"
    "  fsai-vcu completion fish > ~/.config/fish/completions/fsai-vcu.fish"
)
ABOUT = """\
The script knows every verb, option and choice of this version: print it anew
after an update. For the running shell only: eval "$(fsai-vcu completion bash)".
zsh looks in the folders of $fpath, set before compinit runs."""
SHELLS = ("bash", "zsh", "fish")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.description = f"{parser.description}\n\n{ABOUT}"
    parser.add_argument("shell", choices=SHELLS, help="for which shell")


def run(args: argparse.Namespace) -> int:
    from fsai_vcu.cli import completing
    from fsai_vcu.cli.grammar import verbs

    print({"bash": completing.bash, "zsh": completing.zsh, "fish": completing.fish}[args.shell](verbs()), end="")
    return 0
