"""The pages people read: links lead somewhere, commands exist, code compiles, tables are those of the code."""

from __future__ import annotations

import ast
import re
import runpy
import shlex
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from importlib.util import find_spec
from pathlib import Path

import pytest

from fsai_hil.evidence.campaign.catalogue import ROWS
from fsai_hil.rules.checker import RULES
from fsai_vcu.cli.main import all_verbs, parser_of
from fsai_vcu.runtime.toml_lines import tomllib

ROOT = Path(__file__).resolve().parents[1]
PAGES = [
    page
    for place in (".", "docs", "docs/evidence", "nodes", "examples/*")
    for page in sorted(ROOT.glob(f"{place}/*.md"))
]
TARGETS = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
BLOCK = re.compile(r"^ *```(\w*)\n(.*?)^ *```", re.MULTILINE | re.DOTALL)
PLACEHOLDER = re.compile(r"…|<|\bNAME\b|\bVERB\b")
each_page = pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))


def anchors(page: Path) -> set[str]:
    """The names by which a page's headings can be linked to."""
    heads = re.findall(r"^#+ (.*)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", head.lower()).replace(" ", "-") for head in heads}


@each_page
def test_every_link_leads_to_a_file_and_a_heading(page: Path) -> None:
    for target in re.findall(r"\]\(([^)\s]+)\)", page.read_text(encoding="utf-8")):
        if target.startswith(("http://", "https://")):
            continue
        name, _, anchor = target.partition("#")
        other = page.parent / name if name else page
        assert other.exists(), f"{page.name} links to {target}"
        assert not anchor or anchor in anchors(other), f"{page.name} links to {target}"


def commands_of(text: str) -> Iterator[list[str]]:
    """The commands in the text's blocks and in its `code`, as words; what is only a part or a pattern is left out."""
    blocks = [block for language, block in BLOCK.findall(text) if not language]
    lines = [line for block in blocks for line in block.replace("\\\n", " ").splitlines()]
    for line in lines + re.findall(r"`([^`\n]+)`", BLOCK.sub("", text)):
        code = re.split(r"\s#\s", line)[0]
        if code.strip().startswith("#") or PLACEHOLDER.search(code):
            continue
        for part in re.split(r"&&|\|\||[|;&](?!\d)", code) if "'" not in code else [code]:
            try:
                words = shlex.split(re.sub(r"\d?>\S* ?\S+", "", part))
            except ValueError:
                continue
            while words and (words[0] in ("sudo", "eval") or re.fullmatch(r"[A-Z_]+=.*", words[0])):
                words = words[1:]
            if words:
                yield words


def wrong_with(words: list[str]) -> str | None:
    """What no such program, target, verb, option or module there is."""
    words = words[: words.index("--")] if "--" in words else words  # what follows is another program's
    program = words[0].removeprefix(".venv/bin/")
    if program == "make":
        unknown = {word for word in words[1:] if re.fullmatch(r"[a-z-]+", word)} - TARGETS
        return f"no target {unknown}" if unknown else None
    if program == "fsai-vcu" and len(words) > 1 and not words[1].startswith("-"):
        return wrong_verb(words[1], words[2:])
    if program in ("python", "python3") and words[1:2] == ["-m"]:
        return wrong_module(words[2], words[3:])
    if program in ("python", "python3") and len(words) > 1:
        return None if (ROOT / words[1]).exists() else "no such file"
    return None


def wrong_verb(verb: str, words: list[str]) -> str | None:
    if verb not in all_verbs():
        return "no such verb"
    options = {option for action in parser_of(verb)._actions for option in action.option_strings}
    unknown = {word.partition("=")[0] for word in words if re.match(r"--?[a-z]", word)} - options
    if unknown:
        return f"no such option: {unknown}"
    if len(words) < 2 or any(word.endswith(("…", "/")) for word in words):
        return None  # a verb that is only named
    try:
        parser_of(verb).parse_args(words)
    except SystemExit:
        return "it is refused"
    return None


def source_of(name: str) -> str | None:
    """Of a module, or of what runs for a package."""
    spec = find_spec(name)
    if spec is None or spec.origin is None:
        return None
    path = Path(spec.origin)
    main = path.with_name("__main__.py")
    return (main if path.name == "__init__.py" and main.exists() else path).read_text()


def wrong_module(name: str, words: list[str]) -> str | None:
    if name.partition(".")[0] not in ("fsai_hil", "fsai_vcu", "fsai_nodes"):
        return None
    source = source_of(name)
    if source is None:
        return "no such module"
    imported = re.findall(r"^from (fsai_[\w.]+) import", source, re.MULTILINE)  # options may be shared
    source += "".join(filter(None, map(source_of, imported)))
    ours = words[: words.index("--ros-args")] if "--ros-args" in words else words
    options = [word for word in ours if word.startswith("--")]
    shared = {"--config"}  # of every node
    missing = [word for word in options if f'"{word}"' not in source and word not in shared]
    return f"no such option: {missing}" if missing else None


@each_page
def test_every_command_is_one_that_exists(page: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = page.read_text(encoding="utf-8")
    found = [(words, wrong_with(words)) for words in commands_of(text)]
    assert not [f"{shlex.join(words)}: {wrong}" for words, wrong in found if wrong], capsys.readouterr().err


@each_page
def test_every_block_of_python_and_toml_can_be_read(page: Path) -> None:
    for language, block in BLOCK.findall(page.read_text(encoding="utf-8")):
        if language == "python":
            ast.parse(block)
        elif language == "toml":
            tomllib.loads(block)


@cache
def tables() -> dict[str, object]:
    return runpy.run_path(str(ROOT / "docs" / "pages.py"))


def test_tables_in_pages_are_those_of_code_and_evidence() -> None:
    made = tables()
    old = [page.name for page in made["pages"]() if made["renewed"](page) != page.read_text(encoding="utf-8")]
    assert not old, f"run: make pages (renews {', '.join(old)})"


def test_the_site_is_built_and_no_link_in_it_is_broken(tmp_path: Path) -> None:
    site = [sys.executable, str(ROOT / "docs" / "site.py"), str(tmp_path)]
    built = subprocess.run(site, capture_output=True, text=True)
    assert built.returncode == 0, built.stderr
    assert 'alt="diagram"' in (tmp_path / "docs" / "docs" / "architecture.html").read_text()


def test_each_hazards_rules_tests_and_faults_exist() -> None:
    for hazard in tomllib.loads((ROOT / "docs" / "hazards.toml").read_text())["hazard"]:
        assert hazard["prevented_by"] and hazard["rules"] and hazard["tests"] and hazard["faults"], hazard["name"]
        assert set(hazard["rules"]) <= set(RULES), hazard["name"]
        assert set(hazard["faults"]) <= {kind.name for kind in ROWS}, hazard["name"]
        for test in hazard["tests"]:
            file, _, function = test.partition("::")
            assert f"def {function}(" in (ROOT / "tests" / file).read_text(), test


def test_each_safety_rule_belongs_to_a_hazard() -> None:
    hazards = tomllib.loads((ROOT / "docs" / "hazards.toml").read_text())["hazard"]
    assert {rule for hazard in hazards for rule in hazard["rules"]} >= set(RULES) - {"output table", "interval"}
