"""What holds for all tests."""

from __future__ import annotations

import signal
import sys

from hypothesis import HealthCheck, settings

# pytest writes each test module anew, with words for its assertions, and every worker does so for all of them: what it
# has written is kept, also where Python is told to keep nothing.
sys.dont_write_bytecode = False

# A shell that starts pytest in the background lets it ignore Ctrl-C, and every program that is tested.
signal.signal(signal.SIGINT, signal.default_int_handler)

# How fast an example runs is the machine's affair.
settings.register_profile("fsai-vcu", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("fsai-vcu")
