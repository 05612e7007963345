"""The command that runs a module of this package in a process of its own."""

from __future__ import annotations

import sys
from typing import Final

# With no regard to files of the module's name in the folder where this was started. Python 3.11 has -P for it.
_RUN: Final = (
    "import sys; del sys.path[0], sys.argv[0]; import runpy; runpy.run_module(sys.argv[0], run_name='__main__')"
)


def module_command(module: str, *words: str) -> list[str]:
    """The words of the command. `words` are the module's own, `sys.argv[1:]` there."""
    return [sys.executable, "-c", _RUN, module, *words]
