"""Identifiers that an AI computer sends, that it may send on some cars, and that it must never send."""

from __future__ import annotations

AI_IDS = (0x510, 0x511, 0x512, 0x513, 0x514)
"""The five messages of the AI computer, in the order in which they go out."""

VCU_IDS = tuple(range(0x520, 0x527))
"""The messages of the VCU to the AI computer, VCU2AI_Status first; each comes every 10 ms."""

STATUS_ID = VCU_IDS[0]
"""VCU2AI_Status, which carries the handshake and the AS state."""

OPTIONAL_AI_ID = 0x501
"""AI2LOG_Dynamics2: the PCAN-GPS sends it; an AI computer only on a car that has none."""

# Interface specification v4.0: identifiers of the VCU, the remote E-stop, the battery, the display and the sensors.
_RESERVED_RANGES = (
    (0x000, 0x000),
    (0x080, 0x084),
    (0x120, 0x124),
    (0x181, 0x184),
    (0x284, 0x284),
    (0x301, 0x301),
    (0x410, 0x41F),
    (0x450, 0x470),
    (0x4E2, 0x4E2),
    (0x4FD, 0x4FF),
    (0x550, 0x550),
    (0x581, 0x584),
    (0x600, 0x640),
    (0x650, 0x660),
    (0x700, 0x705),
)

RESERVED_IDS: frozenset[int] = frozenset(
    can_id for first, last in _RESERVED_RANGES for can_id in range(first, last + 1)
)
"""Identifiers that an AI computer must never transmit."""
