"""The driving chain as ROS 2 nodes: cones in, CAN frames out."""

import signal
import sys
from pathlib import Path

_module = sys.orig_argv[sys.orig_argv.index("-m") + 1 :][:1] if "-m" in sys.orig_argv else []
_ours = "".join(_module).startswith(f"{__name__}.") or Path(sys.argv[0]).parent.name == __name__
if _ours and signal.getsignal(signal.SIGINT) is signal.default_int_handler:
    # While its modules still load, a node that is started ends by Ctrl-C without a word; then process.py answers it.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
