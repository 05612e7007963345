"""Traces of the computer that recorded a log, by the file beside it: lost frames, times at which it stood still.

A gap in such a log may be that computer's own. It is named then, and neither the car nor its plugs are blamed.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any, Final, NamedTuple, TypeGuard

from fsai_vcu.files import SETTINGS_BYTES, open_found, read_found
from fsai_vcu.interface.specification import COMMS_LOST_NS
from fsai_vcu.interface.units import ms

LOST_HERE: Final = "lost_in_receive_buffer"
"""Key in a segment's JSON file: frames for which the recording machine had no room; null where that is not known."""
STOOD_STILL: Final = "stood_still_ns"
"""Key in a segment's JSON file: [from, to] in ns since 1970 of each time at which the recording machine stood still."""
UNEXPLAINED_NS: Final = COMMS_LOST_NS // 2
"""The rest of a silence beside the stalls from which on it has another cause."""
_MOST_LOST: Final = 1 << 63  # no counter of a kernel goes further
_MOST_STALLS: Final = 1000
_VIRTUAL: Final = ("vcan", "loopback:", "virtual:", "udp_multicast:")


class Recorded(NamedTuple):
    """Traces that the recording computer left in its log.

    lost: frames that came and found no room. stalls_ns: from and to of each time at which it stood still, on the log's
    clock. virtual: the bus was inside the computer.
    """

    lost: int = 0
    stalls_ns: tuple[tuple[int, int], ...] = ()
    virtual: bool = False

    def joined(self, other: Recorded) -> Recorded:
        """The same of both logs together."""
        both = (*self.stalls_ns, *other.stalls_ns)
        return Recorded(self.lost + other.lost, both, self.virtual and other.virtual)

    def within(self, begin_ns: float, end_ns: float) -> Recorded:
        """The same, with the stalls that have a moment in that time."""
        kept = (each for each in self.stalls_ns if each[0] <= end_ns and each[1] >= begin_ns)
        return self._replace(stalls_ns=tuple(kept))

    def stall(self, begin_ns: int, end_ns: int) -> tuple[int, int] | None:
        """The longest stall that has a moment in that time."""
        return max(self.within(begin_ns, end_ns).stalls_ns, key=lambda each: each[1] - each[0], default=None)

    def explains(self, begin_ns: int, end_ns: int) -> bool:
        """True where the silence of that time is that of the stalls: next to nothing of it is left beside them."""
        left_ns, at_ns = end_ns - begin_ns, begin_ns
        for stall in sorted(self.stalls_ns):  # the logs of a folder tell the same stall more than once
            left_ns -= max(0, min(stall[1], end_ns) - max(stall[0], at_ns))
            at_ns = max(at_ns, stall[1])
        return left_ns < UNEXPLAINED_NS

    @property
    def standstill(self) -> str:
        """The clause on the stalls; '' where there was none."""
        if not self.stalls_ns:
            return ""
        longest = max(end_ns - begin_ns for begin_ns, end_ns in self.stalls_ns)
        more = f" (the longest of {len(self.stalls_ns)} times)" if len(self.stalls_ns) > 1 else ""
        return f"a processor of this computer stood still for {ms(longest)}{more}"


IN_ORDER: Final = Recorded()


def is_virtual(bus: str) -> bool:
    """Return true for the name of a bus inside a computer, where nobody can pull a plug."""
    return bus.startswith(_VIRTUAL)


def lost_words(frames: int) -> str:
    """The sentence on frames that a listening machine lost itself; '' for none."""
    which = f"{frames} frame{'s' * (frames > 1)}"
    return f"{which} lost in this machine's receive buffer: not a fault of the bus or the car" if frames else ""


def recorded(log: Path) -> Recorded:
    """Return what the file beside `log` says; nothing where there is none, or one that is not a recorder's."""
    try:
        about = json.loads(read_found(beside(log, ".json"), SETTINGS_BYTES))
    except (OSError, ValueError, RecursionError):
        return Recorded()
    if not isinstance(about, dict):
        return Recorded()
    lost, bus = about.get(LOST_HERE), about.get("interface")
    virtual = isinstance(bus, str) and is_virtual(bus)
    return Recorded(lost if _is_count(lost) else 0, tuple(_stalls(about.get(STOOD_STILL))), virtual)


def note_stalls(folder: Path, stalls_ns: Iterable[tuple[int, int]]) -> None:
    """Add to the file beside each log of a folder when this computer stood still; [] where it never did.

    stalls_ns: from and to, in ns since 1970. A file that cannot be changed is left as it is.
    """
    new = list(stalls_ns)
    for log in folder.glob("*.log"):
        with suppress(OSError, ValueError, RecursionError), open_found(beside(log, ".json"), write=True) as file:
            about = json.loads(file.read(SETTINGS_BYTES))
            if isinstance(about, dict) and LOST_HERE in about:
                noted = sorted({*_stalls(about.get(STOOD_STILL)), *new})[-_MOST_STALLS:]
                text = json.dumps(about | {STOOD_STILL: noted}, indent=2) + "\n"
                file.seek(0)
                file.write(text.encode())
                file.truncate()


def beside(log: Path, ending: str) -> Path:
    """Return the place beside a log, packed or not, of a file with its name and another ending."""
    return Path(str(log).removesuffix(".gz")).with_suffix(ending)


def _is_count(value: Any) -> TypeGuard[int]:
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value < _MOST_LOST


def _stalls(noted: Any) -> Iterator[tuple[int, int]]:
    for each in noted[:_MOST_STALLS] if isinstance(noted, list) else ():
        if isinstance(each, list) and len(each) == 2 and all(map(_is_count, each)) and each[0] < each[1]:
            yield each[0], each[1]
