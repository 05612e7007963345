"""Opening a bus, and what may be sent on it."""

from __future__ import annotations

import pytest

from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.reserved import AI_IDS, RESERVED_IDS
from fsai_vcu.runtime.bus import BusError, open_bus


def test_an_absent_interface_is_one_clear_line_that_names_it() -> None:
    with pytest.raises(BusError) as error:
        open_bus("can99")
    assert "no CAN interface 'can99'" in str(error.value)
    assert "\n" not in str(error.value)


def test_an_interface_that_is_not_can_is_refused_by_name() -> None:
    with pytest.raises(BusError, match="'lo' is a network interface but not a CAN interface"):
        open_bus("lo")


def test_an_unknown_kind_of_bus_is_one_clear_line() -> None:
    with pytest.raises(BusError, match="cannot open CAN interface 'nonsense:1'"):
        open_bus("nonsense:1")


@pytest.mark.parametrize("can_id", sorted(RESERVED_IDS | {0x501, 0x520, 0x515}))
def test_a_bus_opened_for_the_ai_computer_refuses_every_other_id_before_the_wire(can_id: int) -> None:
    with (
        open_bus("loopback:refusals", may_send=AI_IDS) as bus,
        pytest.raises(ValueError, match="must never be transmitted"),
    ):
        bus.send(Frame(can_id, b"\x00"))
