"""One frame of a log or a live bus. It needs no numpy: to load it takes as long as to print a thousand frames."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

# Bits of `flags`.
EXTENDED: Final = 0x01
REMOTE: Final = 0x02
ERROR: Final = 0x04
FD: Final = 0x08
BRS: Final = 0x10
ESI: Final = 0x20
RECEIVED: Final = 0x40  # the log says that its computer received the frame …
SENT: Final = 0x80  # … or sent it; where neither is set the log does not say

CLASSIC_BYTES: Final = 8


@dataclass(frozen=True, slots=True)
class LogFrame:
    """One frame. `t_ns`: nanoseconds of the log's clock. `sent`: by the computer that logged; None: not recorded.

    `length` is the number of data bytes; for a remote frame the number asked for. `can_id` is without flags: for an
    error frame, SocketCAN's error class bits (linux/can/error.h).
    """

    t_ns: int
    channel: str
    can_id: int
    data: bytes = b""
    extended: bool = False
    remote: bool = False
    error: bool = False
    fd: bool = False
    brs: bool = False
    esi: bool = False
    sent: bool | None = None
    length: int = -1

    def __post_init__(self) -> None:
        if self.length < 0:
            object.__setattr__(self, "length", len(self.data))

    @property
    def flags(self) -> int:
        direction = 0 if self.sent is None else SENT if self.sent else RECEIVED
        return (
            direction
            | (EXTENDED if self.extended else 0)
            | (REMOTE if self.remote else 0)
            | (ERROR if self.error else 0)
            | (FD if self.fd else 0)
            | (BRS if self.brs else 0)
            | (ESI if self.esi else 0)
        )
