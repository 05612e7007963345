"""Words for what an error frame of SocketCAN says (linux/can/error.h)."""

from __future__ import annotations

from typing import Final

# The words of each bit, from the lowest on.
_CLASSES: Final = (
    "transmit timeout; lost arbitration; controller; protocol violation; transceiver; "
    "no acknowledge: nobody else is on the bus, or the wiring is broken; bus-off; bus error; controller restarted"
)
_CONTROLLER: Final = (
    "receive buffer overflow; transmit buffer overflow; receive warning level; transmit warning level; "
    "receive error-passive; transmit error-passive; error-active again"
)
_PROTOCOL: Final = (
    "single bit; frame format; bit stuffing; dominant bit not sent; recessive bit not sent; overload; "
    "active error announced; in transmission"
)
_DETAILS: Final = {  # which data byte, and its bits
    "controller": (1, _CONTROLLER),
    "protocol violation": (2, _PROTOCOL),
}


def error_words(can_id: int, data: bytes) -> list[str]:
    """The classes of an error frame with what its data add to them; never empty."""
    words = []
    for word in _named(can_id, _CLASSES):
        at, names = _DETAILS.get(word, (0, ""))
        details = _named(data[at], names) if len(data) > at else []
        words.append(f"{word} ({', '.join(details)})" if details else word)
    return words or [f"unspecified (class 0x{can_id:X})"]


def _named(bits: int, names: str) -> list[str]:
    return [name for place, name in enumerate(names.split("; ")) if name and bits >> place & 1]
