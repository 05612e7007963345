"""The house has one direction: nodes -> runtime -> core -> interface. Nothing imports anything to its left."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

CHECKOUT = Path(__file__).parents[1]
ROOMS = {
    "interface": CHECKOUT / "fsai_vcu" / "interface",
    "core": CHECKOUT / "fsai_vcu" / "core",
    "runtime": CHECKOUT / "fsai_vcu" / "runtime",
    "diagnostics": CHECKOUT / "fsai_vcu" / "diagnostics",
    "cli": CHECKOUT / "fsai_vcu" / "cli",
    "hil": CHECKOUT / "hil" / "fsai_hil",
    "evidence": CHECKOUT / "hil" / "fsai_hil" / "evidence",
    "nodes": CHECKOUT / "nodes" / "fsai_nodes",
}

# room -> what its modules must not import
CLOCKS_AND_IO = {"can", "rclpy", "time", "threading", "socket", "asyncio", "selectors", "subprocess", "multiprocessing"}
ROS = {"rclpy", "fsai_msgs", "fsai_nodes"}
OUTER = {"fsai_vcu.runtime", "fsai_vcu.diagnostics", "fsai_vcu.cli", "fsai_hil"}
FORBIDDEN = {
    "interface": CLOCKS_AND_IO | ROS | {"fsai_vcu.core", *OUTER},
    "core": CLOCKS_AND_IO | ROS | {"os", "pathlib", "random", *OUTER},
    "runtime": ROS | {"fsai_vcu.diagnostics", "fsai_vcu.cli", "fsai_hil"},
    "diagnostics": ROS | {"fsai_vcu.cli", "fsai_hil"},
    "hil": {"fsai_vcu.core.supervision.supervisor", "fsai_vcu.core.supervision.gate", "fsai_nodes"},
    # The evidence searches the supervisor and the gate from within; nothing else in hil may know them.
    "evidence": ROS | {"fsai_vcu.runtime", "fsai_vcu.cli"},
}
APART = {"hil": "evidence"}  # a room within the room, with rules of its own


def imports_of(path: Path) -> Iterator[str]:
    """Every module that the file at `path` imports, wherever in it."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield node.module
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def violations(room: str) -> list[str]:
    return sorted(
        {
            f"{path.relative_to(CHECKOUT)} imports {name}"
            for path in ROOMS[room].rglob("*.py")
            if "evidence" not in path.parts  # proofs stand beside both sides and look into each
            for name in imports_of(path)
            if any(name == wall or name.startswith(wall + ".") for wall in FORBIDDEN[room])
        }
    )


@pytest.mark.parametrize("room", sorted(FORBIDDEN))
def test_no_room_imports_what_it_must_not_know(room: str) -> None:
    assert list(ROOMS[room].rglob("*.py")), f"the room {room} is empty: this test would see nothing"
    assert violations(room) == []


def test_of_the_runtime_the_diagnostics_know_the_bus_and_the_log_writer_only() -> None:
    known = {
        name
        for path in ROOMS["diagnostics"].rglob("*.py")
        for name in imports_of(path)
        if name.startswith("fsai_vcu.runtime.") and name.count(".") == 2
    }
    assert known <= {"fsai_vcu.runtime.bus", "fsai_vcu.runtime.recording"}


def test_only_the_command_line_and_the_nodes_know_ros() -> None:
    knowing = {
        path.relative_to(CHECKOUT).parts[:2]
        for path in (CHECKOUT / "fsai_vcu").rglob("*.py")
        if any(name.split(".")[0] in ROS for name in imports_of(path))
    }
    assert knowing <= {("fsai_vcu", "cli")}


def test_every_verb_of_the_command_line_has_its_file_and_an_example() -> None:
    from fsai_vcu.cli.main import VERBS

    for module, _ in VERBS.values():
        text = (ROOMS["cli"] / f"{module}.py").read_text()
        assert "EXAMPLE =" in text, f"{module}.py has no example"
