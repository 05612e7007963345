"""What holds for all tests."""

from __future__ import annotations

import gc
import os
import signal
import sys

import pytest
from hypothesis import HealthCheck, settings

# pytest writes each test module again, with words for its assertions, and every worker does so for all of them: what it
# has written is kept, also where Python is told to keep nothing.
sys.dont_write_bytecode = False

# A shell that starts pytest in the background lets it ignore Ctrl-C, and every program that is tested.
signal.signal(signal.SIGINT, signal.default_int_handler)


gc.disable()  # until all is collected: modules and tests stay, and looking through them is a quarter of collecting them


def pytest_configure(config: pytest.Config) -> None:
    config.addinivalue_line("markers", "long: only with FSAI_LONG_TESTS=1 (make test-long, fsai-vcu hil --all)")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """What takes long and repeats in full what another test shows in short has a run of its own."""
    if "FSAI_LONG_TESTS" not in os.environ:
        left_out = [item for item in items if item.get_closest_marker("long")]
        config.hook.pytest_deselected(items=left_out)
        items[:] = [item for item in items if item not in left_out]


def pytest_collection_finish() -> None:
    """Modules and tests stay to the end: no garbage collection looks through them again, and after each test of nodes
    there is one."""
    gc.collect()
    gc.freeze()
    gc.enable()


# How fast an example runs is the machine's affair.
settings.register_profile("fsai-vcu", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("fsai-vcu")
