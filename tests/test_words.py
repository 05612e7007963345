"""Messages and pages keep to plain words: CONTRIBUTING.md lists what to write instead."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

CHECKOUT = Path(__file__).parents[1]
LISTED = "CONTRIBUTING.md"
DESCRIBED = ("fsai_vcu", "hil", "nodes", "docs", "scripts", "examples")  # docstrings name the thing, or what it does
# Most docstrings that begin so are no sentences; the others can begin with their subject.
FRAGMENT = re.compile(
    r"\s*(As|At|Between|By|For|From|How|If|In|Of|On|That|Those|To|Until|What|When|Where|Whether|Which|Who|Why|With)\b"
)
LONG = 15  # lines: a caller should not have to read a function of that length
REFUSED = re.compile(
    r"\b(anew|for good|of ours|surely|the way driven|one beside the bus|who sends|that is none|that are none)\b",
    re.IGNORECASE,
)


@cache
def nodes_in(path: Path) -> list[ast.AST]:
    return [*ast.walk(ast.parse(path.read_text(encoding="utf-8")))]


def messages(path: Path) -> Iterator[tuple[int, str]]:
    """The texts of a module that somebody may read, docstrings too, with their lines."""
    for node in nodes_in(path):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node.lineno, node.value


def programs(folder: Path) -> list[Path]:
    """The Python files below a folder, those without a suffix too."""
    others = (path for path in folder.rglob("*") if not path.suffix and path.is_file())
    by_first_line = (path for path in others if re.match(rb"#!.*python", path.read_bytes()))
    return sorted([*folder.rglob("*.py"), *by_first_line])


@cache
def nodes_of(folders: tuple[str, ...]) -> list[tuple[str, ast.AST]]:
    """The expressions, classes and functions of the modules in these folders, each with its module's place."""
    return [
        (str(path.relative_to(CHECKOUT)), node)
        for folder in folders
        for path in programs(CHECKOUT / folder)
        for node in nodes_in(path)
        if isinstance(node, (ast.Expr, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef))
    ]


@pytest.mark.parametrize("folder", ["fsai_vcu", "hil/fsai_hil", "nodes/fsai_nodes/fsai_nodes"])
def test_messages_keep_to_plain_words(folder: str) -> None:
    found = [
        f"{path.relative_to(CHECKOUT)}:{line}: {refused[0]}"
        for path in sorted((CHECKOUT / folder).rglob("*.py"))
        for line, text in messages(path)
        for refused in REFUSED.finditer(text)
    ]
    assert not found


ON_PAGES = re.compile(r"\b(what it comes to|lets? the car stand|lastingly|affair)\b", re.IGNORECASE)


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


def test_a_docstring_names_its_thing_or_says_what_it_does() -> None:
    found = [
        f"{place}:{node.lineno}: {begin[0].strip()}"
        for place, node in nodes_of(DESCRIBED)
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)
        if (begin := FRAGMENT.match(node.value.value))
    ]
    assert not found


def test_a_long_public_function_has_a_docstring() -> None:
    found = [
        f"{place}:{node.lineno}: {node.name}"
        for place, node in nodes_of(DESCRIBED)
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)) and not node.name.startswith("_")
        if (node.end_lineno or node.lineno) - node.lineno + 1 >= LONG and not ast.get_docstring(node)
    ]
    assert not found


def test_a_public_class_has_a_docstring() -> None:
    found = [
        f"{place}:{node.lineno}: {node.name}"
        for place, node in nodes_of(DESCRIBED)
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_") and not ast.get_docstring(node)
    ]
    assert not found
