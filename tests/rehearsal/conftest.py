"""The C program of examples/own_can_node, for the tests that drive it."""

from __future__ import annotations

from pathlib import Path

import pytest
from c_node import compiled


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    try:
        return compiled(tmp_path_factory.mktemp("c"), "-shared", "-fPIC")
    except FileNotFoundError:
        pytest.skip("the C program of the examples needs a C compiler (cc)")
