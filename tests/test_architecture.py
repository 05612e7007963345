"""The rooms of the house and the arrows between them: what a module may import, and that no imports go in a circle."""

from __future__ import annotations

import ast
import re
from collections import Counter
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

from fsai_hil import CHECKOUT

PACKAGES = {
    "fsai_vcu": CHECKOUT / "fsai_vcu",
    "fsai_hil": CHECKOUT / "hil" / "fsai_hil",
    "fsai_nodes": CHECKOUT / "nodes" / "fsai_nodes" / "fsai_nodes",
}

# room -> the rooms that its modules may import, besides itself. A module belongs to the longest name that fits.
DIAGNOSTICS = "fsai_vcu.diagnostics"
LEAN = "fsai_vcu.lean_can"
LEAN_CANTOOLS = "fsai_vcu.lean_cantools"
FILES = "fsai_vcu.files"
PRINTABLE = "fsai_vcu.printable"
ARGUMENTS = "fsai_vcu.arguments"
ARROWS: dict[str, set[str]] = {
    "fsai_vcu": set(),
    LEAN: set(),
    LEAN_CANTOOLS: set(),
    FILES: set(),
    PRINTABLE: set(),
    "fsai_vcu.interface": {LEAN_CANTOOLS, FILES},
    "fsai_vcu.core": {"fsai_vcu.interface"},
    "fsai_vcu.runtime": {"fsai_vcu.core", "fsai_vcu.interface", LEAN, FILES},
    DIAGNOSTICS: set(),
    f"{DIAGNOSTICS}.log": {"fsai_vcu.interface", "fsai_vcu.runtime", LEAN, FILES, PRINTABLE},
    f"{DIAGNOSTICS}.decode": {f"{DIAGNOSTICS}.log", "fsai_vcu.interface", "fsai_vcu.runtime", FILES, PRINTABLE},
    f"{DIAGNOSTICS}.statistics": {f"{DIAGNOSTICS}.{room}" for room in ("decode", "log")} | {"fsai_vcu.interface"},
    f"{DIAGNOSTICS}.finding": {"fsai_vcu.interface"},
    f"{DIAGNOSTICS}.remedies": {"fsai_vcu.core"},
    f"{DIAGNOSTICS}.explain": {f"{DIAGNOSTICS}.{room}" for room in ("decode", "log", "remedies", "statistics")}
    | {"fsai_vcu.core", "fsai_vcu.interface"},
    f"{DIAGNOSTICS}.verdict": {
        f"{DIAGNOSTICS}.{room}" for room in ("decode", "explain", "finding", "log", "remedies", "statistics")
    }
    | {"fsai_vcu.interface"},
    f"{DIAGNOSTICS}.export": {f"{DIAGNOSTICS}.{room}" for room in ("decode", "log")}
    | {"fsai_vcu.interface", PRINTABLE},
    f"{DIAGNOSTICS}.transmit": {f"{DIAGNOSTICS}.{room}" for room in ("decode", "log")}
    | {"fsai_vcu.interface", "fsai_vcu.runtime"},
    f"{DIAGNOSTICS}.doctor": {f"{DIAGNOSTICS}.{room}" for room in ("decode", "finding", "log")}
    | {"fsai_vcu.interface", "fsai_vcu.runtime", FILES},
    f"{DIAGNOSTICS}.recorder": {f"{DIAGNOSTICS}.{room}" for room in ("decode", "export", "log")}
    | {"fsai_vcu.interface", "fsai_vcu.runtime", FILES},
    f"{DIAGNOSTICS}.monitor": {f"{DIAGNOSTICS}.{room}" for room in ("decode", "explain", "log", "statistics")}
    | {"fsai_vcu.core", "fsai_vcu.interface", PRINTABLE},
    f"{DIAGNOSTICS}.serving": {"fsai_vcu.interface"},
    f"{DIAGNOSTICS}.foxglove": {f"{DIAGNOSTICS}.serving"},
    f"{DIAGNOSTICS}.page": {
        f"{DIAGNOSTICS}.{room}" for room in ("explain", "log", "monitor", "serving", "statistics", "verdict")
    }
    | {"fsai_vcu.core", "fsai_vcu.interface"},
    f"{DIAGNOSTICS}.stack": {"fsai_vcu.core", f"{DIAGNOSTICS}.finding", PRINTABLE},
    "fsai_vcu.cli": {
        ARGUMENTS,
        "fsai_vcu.core",
        "fsai_vcu.interface",
        "fsai_vcu.runtime",
        FILES,
        PRINTABLE,
        DIAGNOSTICS,
    },
    ARGUMENTS: {"fsai_vcu.interface"},
    "fsai_nodes": {
        "fsai_vcu.core",
        "fsai_vcu.interface",
        "fsai_vcu.runtime",
        FILES,
        PRINTABLE,
        f"{DIAGNOSTICS}.explain",
    },
    "fsai_nodes.pitwall": {"fsai_nodes", "fsai_vcu.core", "fsai_vcu.interface", f"{DIAGNOSTICS}.monitor"},
    "fsai_nodes.recorder": {"fsai_nodes", "fsai_vcu.runtime", f"{DIAGNOSTICS}.export"},
    "fsai_nodes.sensor_simulator": {"fsai_nodes", "fsai_hil.simulator"},
    "fsai_nodes.launch": {
        "fsai_nodes",
        "fsai_hil.rehearsal",
        "fsai_hil.simulator",
        "fsai_hil.vcan",
        f"{DIAGNOSTICS}.log",
        f"{DIAGNOSTICS}.transmit",
        "fsai_vcu.interface",
    },
    "fsai_hil": set(),
    "fsai_hil.vcan": {"fsai_hil"},
    "fsai_hil.rules": {"fsai_vcu.core", "fsai_vcu.interface", f"{DIAGNOSTICS}.log", f"{DIAGNOSTICS}.statistics"},
    "fsai_hil.simulator": {
        "fsai_hil.rules",
        ARGUMENTS,
        "fsai_vcu.core",
        "fsai_vcu.interface",
        "fsai_vcu.runtime",
        FILES,
        PRINTABLE,
    },
    "fsai_hil.evidence": {"fsai_hil", "fsai_hil.rules", "fsai_hil.simulator", "fsai_vcu"},
    "fsai_hil.rehearsal": {"fsai_hil", "fsai_hil.rules", "fsai_hil.simulator", "fsai_hil.vcan", "fsai_vcu"},
    "fsai_hil.bench": {"fsai_hil", "fsai_hil.rehearsal", "fsai_hil.simulator", "fsai_vcu"},
    "fsai_hil.cli": {"fsai_hil", "fsai_vcu"},
}

CLOCKS_AND_IO = {"can", "time", "threading", "socket", "asyncio", "selectors", "subprocess", "multiprocessing"}
ROS = {"rclpy", "fsai_msgs", "fsai_nodes"}
# room, with all that is in it -> what it must not import besides
FORBIDDEN = {
    "fsai_vcu.interface": CLOCKS_AND_IO | ROS,
    "fsai_vcu.core": CLOCKS_AND_IO | ROS | {"os", "pathlib", "random"},
    "fsai_vcu.runtime": ROS,
    "fsai_vcu.runtime.turns": CLOCKS_AND_IO,
    # Of the runtime the diagnostics know the bus and the log's writer.
    DIAGNOSTICS: ROS | {f"fsai_vcu.runtime.{name}" for name in ("loop", "loop_handle", "turns", "configuration")},
    "fsai_hil.rules": CLOCKS_AND_IO | ROS | {"fsai_vcu.core.supervision", "fsai_vcu.core.bridge"},
    "fsai_hil.simulator": ROS | {"fsai_vcu.core.supervision.supervisor", "fsai_vcu.core.supervision.gate"},
    "fsai_hil.rehearsal": {"fsai_vcu.core.supervision.supervisor", "fsai_vcu.core.supervision.gate"},
    "fsai_hil.bench": {"fsai_vcu.core.supervision.supervisor", "fsai_vcu.core.supervision.gate"},
    "fsai_hil.evidence": ROS | {"fsai_vcu.cli"},
}

# class name that more than one module defines -> what tells its classes apart, a word for each
NAMED_ALIKE = {
    "Bounds": ("process", "recording"),
    "Format": ("log", "track"),
    "Listener": ("bus", "topics"),
    "Server": ("any", "foxglove", "page"),
    "Signal": ("interface", "explanation"),
    "Verdict": ("log", "item"),
    "View": ("bus", "animation"),
    "_Table": ("columns", "slots"),
}


@cache
def modules() -> dict[str, Path]:
    """Every module of ours and its file."""
    found = {}
    for package, folder in PACKAGES.items():
        for path in folder.rglob("*.py"):
            parts = (package, *path.relative_to(folder).with_suffix("").parts)
            found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


@cache
def imports_of(module: str) -> frozenset[str]:
    """What a module imports, wherever in it: modules and names of ours, and other packages."""

    def names() -> Iterator[str]:
        for node in ast.walk(ast.parse(modules()[module].read_text())):
            if isinstance(node, ast.Import):
                yield from (alias.name for alias in node.names)
            elif isinstance(node, ast.ImportFrom) and node.module:
                yield node.module
                yield from (f"{node.module}.{alias.name}" for alias in node.names)

    return frozenset(names())


def arrows_from(module: str) -> set[str]:
    """The modules of ours that it imports; a package counts only where a name of its own is taken."""
    found = set()
    for name in imports_of(module):
        parent = name.rpartition(".")[0]
        if name in modules() and not any(other.startswith(name + ".") for other in imports_of(module)):
            found.add(name)
        elif name not in modules() and parent in modules():
            found.add(parent)
    return found - {module}


def below(name: str, room: str) -> bool:
    return name == room or name.startswith(room + ".")


def room_of(module: str) -> str:
    return max((room for room in ARROWS if below(module, room)), key=len)


@pytest.mark.parametrize("room", ARROWS)
def test_each_arrow_between_rooms_is_in_the_table(room: str) -> None:
    inside = [module for module in modules() if room_of(module) == room]
    assert inside, f"the room {room} is empty: this test would see nothing"
    wide = {to for to in ARROWS[room] if to in (DIAGNOSTICS, "fsai_vcu", "fsai_hil") and room != "fsai_hil.vcan"}
    for module in inside:
        for target in arrows_from(module):
            allowed = room_of(target) in ARROWS[room] | {room} or any(below(target, to) for to in wide)
            assert allowed, f"{module} imports {target}"


@pytest.mark.parametrize("room", FORBIDDEN)
def test_no_room_imports_what_it_must_not_know(room: str) -> None:
    for module in modules():
        if below(module, room):
            for name in imports_of(module):
                assert not any(below(name, wall) for wall in FORBIDDEN[room]), f"{module} imports {name}"


def test_no_imports_run_in_a_circle() -> None:
    done: set[str] = set()
    for start in modules():
        path: list[str] = []
        walk: list[tuple[str, Iterator[str]]] = [(start, iter(sorted(arrows_from(start))))] if start not in done else []
        path.extend(module for module, _ in walk)
        while walk:
            module, rest = walk[-1]
            following = next(rest, None)
            if following is None:
                done.add(module)
                walk.pop()
                path.pop()
            elif following in path:
                raise AssertionError(" -> ".join([*path[path.index(following) :], following]))
            elif following not in done:
                path.append(following)
                walk.append((following, iter(sorted(arrows_from(following)))))


def test_only_the_command_line_and_the_nodes_know_ros() -> None:
    knowing = {
        module
        for module in modules()
        if below(module, "fsai_vcu") and any(n.split(".")[0] in ROS for n in imports_of(module))
    }
    assert all(below(module, "fsai_vcu.cli") for module in knowing)


def test_every_verb_has_its_file_and_an_example() -> None:
    from fsai_vcu.cli.main import all_verbs, module_of

    assert set(all_verbs()) >= {"drive", "vcu", "hil", "campaign", "scrutineering", "decode", "explain"}
    for verb in all_verbs():
        assert module_of(verb).EXAMPLE


def test_a_class_name_stands_in_one_module_only() -> None:
    found: dict[str, set[str]] = {}
    for module, path in modules().items():
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ClassDef):
                found.setdefault(node.name, set()).add(module)
    alike = {name: sorted(places) for name, places in found.items() if len(places) > 1}
    surplus = {name: places for name, places in alike.items() if len(places) > len(NAMED_ALIKE.get(name, ()))}
    assert surplus == {}, "give the new class the name of its own meaning"
    stale = {name for name, words in NAMED_ALIKE.items() if len(alike.get(name, ())) < len(words)}
    assert stale == set(), "these classes are no longer named alike: take them from NAMED_ALIKE"


def test_no_import_has_a_name_of_one_letter() -> None:
    letters = {
        (module, alias.asname)
        for module, path in modules().items()
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, (ast.Import, ast.ImportFrom))
        for alias in node.names
        if alias.asname and len(alias.asname) == 1
    }
    assert letters == set()


@cache
def named_tests() -> dict[str, list[str]]:
    """The names of the test functions of each test file, as often as they are defined."""
    tests = CHECKOUT / "tests"
    return {
        str(path.relative_to(tests)): re.findall(r"^(?:async )?def (test_\w+)", path.read_text(), re.MULTILINE)
        for path in tests.rglob("test_*.py")
    }


def test_test_names_have_at_most_60_characters() -> None:
    assert {name for names in named_tests().values() for name in names if len(name) > 60} == set()


def test_no_test_name_is_defined_twice_in_a_file() -> None:
    twice = {
        file: [name for name, times in Counter(names).items() if times > 1] for file, names in named_tests().items()
    }
    assert {file: names for file, names in twice.items() if names} == {}


def test_no_test_counts_on_a_path_that_a_machine_lacks() -> None:
    """A machine may have it, so what must be absent is a path under `tmp_path`."""
    absent = re.compile(r"(?<![\w}/.])/(?:absent|nowhere|nonexist[ae]nt|missing|gone)\b")
    tests = CHECKOUT / "tests"
    found = [
        f"{path.relative_to(tests)}:{number}: {line.strip()}"
        for path in sorted(tests.rglob("*.py"))
        for number, line in enumerate(path.read_text().splitlines(), 1)
        if absent.search(line)
    ]
    assert not found
