"""cantools without its tester, which nobody here uses: that brings python-can in, a fifth of a short verb's time.

Import it before anything of cantools.
"""

from __future__ import annotations

import sys
from types import ModuleType

if "cantools" not in sys.modules:
    sys.modules["cantools.tester"] = ModuleType("cantools.tester")
    try:
        import cantools
    finally:
        del sys.modules["cantools.tester"]
    del cantools.tester  # a program that wants it imports the real one
