"""python-can without its MF4 files: with asammdf installed they bring pandas in, 0.5 s and 100 MB in every process.

MF4 logs are read through asammdf itself (diagnostics.log.mf4). Import `can` from here wherever it is used.
"""

from __future__ import annotations

import sys
from typing import Any

_modules: dict[str, Any] = sys.modules
_here = _modules.get("asammdf")
_modules["asammdf"] = None  # as if it were not installed: python-can goes on without
try:
    import can as can
finally:
    del _modules["asammdf"]
    if _here is not None:
        _modules["asammdf"] = _here
