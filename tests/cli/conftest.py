"""What holds for tests of the command line."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator

import pytest


@pytest.fixture(autouse=True)
def process_as_before(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A verb has its process for itself, but here the next tests, and the programs that they start, come after it.

    Niceness only ever grows: after a few pit walls everything here would wait for every other program.
    """
    monkeypatch.setattr(os, "nice", lambda _more: 0)
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)
