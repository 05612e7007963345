"""What an error frame of SocketCAN says (linux/can/error.h), in words."""

from __future__ import annotations

from typing import Final

BUS_OFF: Final = 0x040

_CLASSES: Final = (
    (0x001, "transmit timeout"),
    (0x002, "lost arbitration"),
    (0x004, "controller"),
    (0x008, "protocol violation"),
    (0x010, "transceiver"),
    (0x020, "no acknowledge: nobody else is on the bus, or the wiring is broken"),
    (BUS_OFF, "bus-off"),
    (0x080, "bus error"),
    (0x100, "controller restarted"),
)
_CONTROLLER: Final = (  # data byte 1
    (0x01, "receive buffer overflow"),
    (0x02, "transmit buffer overflow"),
    (0x04, "receive warning level"),
    (0x08, "transmit warning level"),
    (0x10, "receive error-passive"),
    (0x20, "transmit error-passive"),
    (0x40, "error-active again"),
)
_PROTOCOL: Final = (  # data byte 2
    (0x01, "single bit"),
    (0x02, "frame format"),
    (0x04, "bit stuffing"),
    (0x08, "dominant bit not sent"),
    (0x10, "recessive bit not sent"),
    (0x20, "overload"),
    (0x40, "active error announced"),
    (0x80, "in transmission"),
)


def error_words(can_id: int, data: bytes) -> list[str]:
    """The classes of an error frame with what its data add to them; never empty."""
    words = []
    for bit, word in _CLASSES:
        if can_id & bit:
            details: list[str] = []
            if bit == 0x004 and len(data) > 1:
                details = [detail for mask, detail in _CONTROLLER if data[1] & mask]
            if bit == 0x008 and len(data) > 2:
                details = [detail for mask, detail in _PROTOCOL if data[2] & mask]
            words.append(f"{word} ({', '.join(details)})" if details else word)
    return words or [f"unspecified (class 0x{can_id:X})"]
