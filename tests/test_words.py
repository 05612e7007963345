"""Messages and pages keep to plain words: CONTRIBUTING.md lists what to write instead."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

CHECKOUT = Path(__file__).parents[1]
LISTED = "CONTRIBUTING.md"
REFUSED = re.compile(r"\b(anew|for good|of ours|surely|the way driven|one beside the bus)\b", re.IGNORECASE)


def messages(path: Path) -> Iterator[tuple[int, str]]:
    """The texts of a module that somebody may read, docstrings too, with their lines."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node.lineno, node.value


@pytest.mark.parametrize("folder", ["fsai_vcu", "hil/fsai_hil", "nodes/fsai_nodes/fsai_nodes"])
def test_messages_keep_to_plain_words(folder: str) -> None:
    found = [
        f"{path.relative_to(CHECKOUT)}:{line}: {refused[0]}"
        for path in sorted((CHECKOUT / folder).rglob("*.py"))
        for line, text in messages(path)
        for refused in REFUSED.finditer(text)
    ]
    assert not found


ON_PAGES = re.compile(
    r"\b(what it comes to|that is none|that are none|lets? the car stand|lastingly|affair|who sends)\b", re.IGNORECASE
)


def test_pages_keep_to_plain_words() -> None:
    pages = [*CHECKOUT.glob("*.md"), *CHECKOUT.glob("docs/**/*.md"), *CHECKOUT.glob("nodes/*.md")]
    found = [
        f"{page.relative_to(CHECKOUT)}:{number}: {refused[0]}"
        for page in pages
        if page.name != LISTED
        for number, line in enumerate(page.read_text(encoding="utf-8").splitlines(), 1)
        for pattern in (REFUSED, ON_PAGES)
        for refused in pattern.finditer(line)
    ]
    assert not found


def test_each_word_refused_on_pages_is_listed_with_what_to_write() -> None:
    rows = [line.split("|")[2] for line in (CHECKOUT / LISTED).read_text().splitlines() if line.startswith("| ")]
    listed = " ".join(word[0] for row in rows for word in ON_PAGES.finditer(row))
    words = ON_PAGES.pattern.partition("(")[2].partition(")")[0].split("|")
    assert [word for word in words if not re.search(word, listed)] == []


def test_each_refused_word_is_listed_with_what_to_write() -> None:
    rows = [line.split("|")[2] for line in (CHECKOUT / LISTED).read_text().splitlines() if line.startswith("| ")]
    words = REFUSED.pattern.partition("(")[2].partition(")")[0].split("|")
    assert [word for word in words if not any(word in row for row in rows)] == []
