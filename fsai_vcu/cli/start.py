"""`fsai-vcu` from its first line on: Ctrl-C is answered in one line while the modules of the verb still load."""

from __future__ import annotations

import os  # nothing that Python has not loaded itself: until the handler is there, Ctrl-C is a traceback
import signal
import sys


def interrupted(_number: int, _frame: object) -> None:
    """Ends the process, in which nothing has been done yet: of an import that is interrupted much may be left."""
    verb = "".join(sys.argv[1:2])
    said = f"fsai-vcu {verb}: interrupted" if verb.replace("-", "").isalnum() else "fsai-vcu: interrupted"
    os.write(2, f"{said}\n".encode("ascii", "replace"))
    os._exit(130)


def main() -> int:
    """The command. Once its verb is at work, Ctrl-C is what it is in Python: the verb may have something to end."""
    ours = signal.getsignal(signal.SIGINT) is signal.default_int_handler  # a script's background job ignores it
    if ours:
        signal.signal(signal.SIGINT, interrupted)
    open_streams()
    from fsai_vcu.cli.main import main as run

    try:
        return run(at_work=(lambda: signal.signal(signal.SIGINT, signal.default_int_handler)) if ours else None)
    finally:
        if ours:
            signal.signal(signal.SIGINT, signal.SIG_IGN)  # the rest is Python's own end


def open_streams() -> None:
    """Standard streams that were closed lead nowhere: else the next file that is opened would take their place."""
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)
    if sys.stdout is None:
        sys.stdout = open(1, "w", encoding="utf-8", closefd=False)  # noqa: SIM115
    if sys.stderr is None:
        sys.stderr = open(2, "w", encoding="utf-8", closefd=False)  # noqa: SIM115
    if sys.stdin is None:
        sys.stdin = open(0, encoding="utf-8", closefd=False)  # noqa: SIM115


if __name__ == "__main__":
    sys.exit(main())
