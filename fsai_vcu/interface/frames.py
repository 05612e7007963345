"""One classic CAN frame as the project passes it around."""

from __future__ import annotations

from fsai_vcu.interface.values import Value


class Frame(Value, frozen=True):
    """A CAN 2.0 frame.

    `t_ns` is the integer monotonic time at which it was received (or is to be sent); 0 where it has no meaning.
    """

    can_id: int
    data: bytes = b""
    t_ns: int = 0
    extended: bool = False
    remote: bool = False
    error: bool = False

    def __str__(self) -> str:
        return f"{self.can_id:03X}#{self.data.hex().upper()}"
