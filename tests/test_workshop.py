"""Each exercise of docs/workshop.md names a test that there is."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def test_every_exercise_of_the_workshop_is_held_by_a_test() -> None:
    rows = [line for line in (ROOT / "docs/workshop.md").read_text().splitlines() if line.startswith("| ")][1:]
    assert len(rows) > 20
    for row in rows:
        held = re.search(r"`([\w/]+\.py)::(\w+)` \|$", row)
        assert held, f"names no test: {row}"
        file, name = held.groups()
        assert f"\ndef {name}(" in (ROOT / "tests" / file).read_text(), f"{file} has no {name}"
