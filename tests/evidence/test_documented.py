"""The documented table is of this catalogue, and of a campaign in which nothing was worse than the rules allow."""

from __future__ import annotations

import re
from pathlib import Path

from fsai_hil.evidence.campaign.catalogue import ROWS

DOCUMENT = Path(__file__).resolve().parents[2] / "docs" / "evidence" / "faults.md"


def test_every_row_of_the_catalogue_is_in_the_documented_table() -> None:
    rows = [line.split(" | ") for line in DOCUMENT.read_text().splitlines() if line.startswith("| `")]
    documented = {row[0].strip("| `"): (row[1], row[2]) for row in rows}
    assert set(documented) == {kind.name for kind in ROWS}
    for kind in ROWS:
        what, demanded = documented[kind.name]
        assert what.startswith(kind.what) and demanded == kind.must.demanded, (
            f"make the table again: {kind.name} has changed"
        )


def test_the_documented_campaign_has_its_origin_and_no_finding() -> None:
    text = DOCUMENT.read_text()
    assert re.search(r"Made by `fsai-vcu campaign --runs \d+ --full \d+ --seed \d+", text)
    assert re.search(r"\*\*Worse than the rules allow: 0 of \d+ runs\.\*\*", text)
