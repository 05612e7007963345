"""What tests of the runtime share."""

from __future__ import annotations

import uuid

import pytest


@pytest.fixture
def spec() -> str:
    """A stand-in bus that nobody else is on."""
    return f"loopback:{uuid.uuid4()}"
