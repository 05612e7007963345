"""A run's commands come from one publisher."""

from __future__ import annotations

from fsai_nodes.command_owner import CommandOwner

LOST_NS = 300
PROCESS_A, PROCESS_B = b"A" * 12, b"B" * 12
A, B, ALSO_A = PROCESS_A + b"\x00\x00\x01\x03", PROCESS_B + b"\x00\x00\x01\x03", PROCESS_A + b"\x00\x00\x02\x03"


def both() -> frozenset[bytes]:
    return frozenset({A, B})


def test_a_run_belongs_to_the_first_that_speaks() -> None:
    owner = CommandOwner(LOST_NS)
    assert owner.takes(1, A, 0, both)
    assert not owner.takes(1, B, 1, both)
    assert owner.takes(1, A, 2, both) and owner.gid == A


def test_it_belongs_to_the_one_that_confirmed_its_reset() -> None:
    owner = CommandOwner(LOST_NS)
    owner.confirmed(1, A)
    assert not owner.takes(1, B, 0, both)
    assert owner.takes(1, A, 1, both)


def test_who_confirmed_but_never_commands_does_not_have_it() -> None:
    """A team's planner may confirm for its controller, or somebody by hand."""
    owner = CommandOwner(LOST_NS)
    owner.confirmed(1, A)
    assert owner.takes(1, B, 0, lambda: frozenset({B}))


def test_of_two_that_confirmed_the_first_that_speaks_has_it() -> None:
    owner = CommandOwner(LOST_NS)
    owner.confirmed(1, B)
    owner.confirmed(1, A)
    assert owner.takes(1, A, 0, both) and not owner.takes(1, B, 1, both)


def test_of_two_publishers_in_one_process_one_is_obeyed() -> None:
    owner = CommandOwner(LOST_NS)
    owner.confirmed(1, ALSO_A)
    assert owner.takes(1, A, 0, both) and not owner.takes(1, ALSO_A, 1, both)


def test_it_is_free_once_its_owner_has_been_lost() -> None:
    owner = CommandOwner(LOST_NS)
    assert owner.takes(1, A, 0, both)
    assert not owner.takes(1, B, LOST_NS - 1, both)
    assert owner.takes(1, B, LOST_NS, both) and not owner.takes(1, A, LOST_NS + 1, both)


def test_a_new_run_is_free() -> None:
    owner = CommandOwner(LOST_NS)
    assert owner.takes(1, A, 0, both)
    assert owner.takes(2, B, 1, both) and not owner.takes(2, A, 2, both)
