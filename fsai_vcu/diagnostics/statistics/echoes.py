"""Echoes of the HANDSHAKE that an AI computer sends: the bit of the last 0x520, its inverse, the bit before it, …

Each 0x510 is held against the newest 0x520 before it, and against the one before that. Where the VCU's bit has just
changed, an inverse and an echo one frame late are the same; where it has stayed they differ.
"""

from __future__ import annotations

from enum import Enum
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from fsai_vcu.diagnostics.log.frames import Ints
from fsai_vcu.interface.specification import COMMS_LOST_NS
from fsai_vcu.interface.units import MS

IN_FLIGHT_NS: Final = 2 * MS  # so soon after a 0x520 its sender may not have read it
ENOUGH: Final = 20  # echoes, before anything is said of them
SOME: Final = 5  # of one kind
NEARLY_ALL: Final = 0.9
OFTEN: Final = 0.25  # a bit that never changes is wrong about half of the time


class EchoFault(Enum):
    """Fault of the bit that comes back; the value completes "the AI computer sends back …"."""

    INVERTED = "the inverse of the HANDSHAKE bit"
    LATE = "the HANDSHAKE bit one 0x520 late"
    INVERTED_OR_LATE = (
        "the inverse of the HANDSHAKE bit, or the bit of the 0x520 before (the VCU's bit changed with each frame, so"
        " both look the same)"
    )
    STUCK = "always the same HANDSHAKE bit, whatever 0x520 has"
    INVERTED_OR_STUCK = (
        "the inverse of the HANDSHAKE bit, or always the same bit (the VCU waited, so both look the same)"
    )


class Echoes(NamedTuple):
    """Counts of the 0x510 held against a 0x520 whose bit had changed, or had stayed, and of those that agreed."""

    changed: int
    changed_right: int
    same: int
    same_right: int
    constant: bool  # the bit that came back never changed

    @property
    def judged(self) -> int:
        return self.changed + self.same

    @property
    def wrong(self) -> int:
        return self.judged - self.changed_right - self.same_right

    @property
    def fault(self) -> EchoFault | None:
        """Fault of the echoes; None where they are right, or show nothing clearly."""
        if self.judged < ENOUGH:
            return None
        few_right = self.judged - self.wrong <= (1.0 - NEARLY_ALL) * self.judged
        if self.constant:
            # Frames that an adapter handed over in batches have one time, and show one bit of each batch.
            if self.changed >= SOME and self.wrong >= OFTEN * self.judged:
                return EchoFault.STUCK
            return EchoFault.INVERTED_OR_STUCK if few_right else None
        if few_right:
            return EchoFault.INVERTED if self.same >= SOME else EchoFault.INVERTED_OR_LATE
        late = (
            self.changed >= SOME
            and self.changed_right <= (1.0 - NEARLY_ALL) * self.changed
            and self.same_right >= NEARLY_ALL * self.same
        )
        return EchoFault.LATE if late else None


def echoes_of(asked_ns: Ints, asked_bits: npt.NDArray[Any], answer_ns: Ints, answer_bits: npt.NDArray[Any]) -> Echoes:
    """Count the echoes of the HANDSHAKE bits in 0x520 by those in 0x510; neither's times (ns) may go backwards."""
    newest = np.searchsorted(asked_ns, answer_ns, side="right") - 1
    known = newest >= 1
    newest, answer_ns, answer_bits = newest[known], answer_ns[known], answer_bits[known]
    age_ns = answer_ns - asked_ns[newest]
    alive = age_ns < COMMS_LOST_NS
    newest, age_ns, answer_bits = newest[alive], age_ns[alive], answer_bits[alive]
    right = answer_bits == asked_bits[newest]
    changed = asked_bits[newest] != asked_bits[newest - 1]
    unread = changed & ~right & (age_ns < IN_FLIGHT_NS)
    if (right & changed).sum() > (1.0 - NEARLY_ALL) * changed.sum():
        changed, right, answer_bits = changed[~unread], right[~unread], answer_bits[~unread]
    return Echoes(
        int(changed.sum()),
        int((changed & right).sum()),
        int((~changed).sum()),
        int((~changed & right).sum()),
        bool(len(answer_bits)) and bool((answer_bits == answer_bits[0]).all()),
    )
