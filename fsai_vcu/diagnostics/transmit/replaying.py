"""A log sent onto a bus again, in its own rhythm: which of its frames may be sent, where, and when each is due."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable, Iterator
from typing import Final

import numpy as np

from fsai_vcu.diagnostics.log.frames import ERROR, EXTENDED, FD, REMOTE, Frames, Mask
from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.reserved import AI_IDS, RESERVED_IDS
from fsai_vcu.runtime.bus import split_spec

LAP_GAP_NS: Final = 10_000_000  # between the last frame and the first again: a cycle of the bus
RETRY_NS: Final = 1_000_000  # a full transmit queue is tried again so soon …
GIVE_UP_NS: Final = 1_000_000_000  # … for so long
_LONGEST_SLEEP_S: Final = 3600.0  # a log may jump by a lifetime, and the system's sleep has an end
_STAND_INS: Final = frozenset({"fsai_loopback", "virtual", "udp_multicast"})  # python-can's kinds without a wire
_VIRTUAL_LINKS: Final = frozenset({"vcan", "vxcan"})


def is_physical(spec: str) -> bool:
    """Return true where `spec` may be a real bus: anything that is not known to be none.

    Neither the name shows it, nor the place where sysfs keeps it (a serial adapter is 'virtual' there): the kernel
    tells the kind of a link.
    """
    kind, channel = split_spec(spec)
    if kind in _STAND_INS:
        return False
    if kind != "socketcan":
        return True
    try:
        shown = subprocess.run(
            ["ip", "-details", "-json", "link", "show", "dev", channel], capture_output=True, timeout=5.0, check=True
        )
        links = json.loads(shown.stdout)
        return links[0]["linkinfo"]["info_kind"] not in _VIRTUAL_LINKS
    except (OSError, subprocess.SubprocessError, ValueError, LookupError, TypeError):
        return True


def choose(frames: Frames, *, with_ai_ids: bool, physical: bool) -> tuple[Frames, str]:
    """Choose the frames of a log that may be sent at all, in order of time; and say what may not, '' if all may.

    A physical bus never gets reserved ids (safety rule 8), the sensors' among them. The AI computer's own ids are sent
    only where that is asked for: the bridge on the bus would take them for an intruder's. 0x501 is the PCAN-GPS's,
    unless the car has none.
    """
    not_sent: list[tuple[str, Mask]] = [
        ("error frames", (frames.flags & ERROR) != 0),
        ("CAN FD frames", (frames.flags & FD) != 0),
    ]
    if physical:
        not_sent.append(("frames of reserved ids", np.isin(frames.can_id, list(RESERVED_IDS))))
    if not with_ai_ids:
        standard = (frames.flags & EXTENDED) == 0
        own = f"frames of 0x{AI_IDS[0]:X} to 0x{AI_IDS[-1]:X}, the AI computer's own (--with-ai-ids: send them too)"
        not_sent.append((own, standard & np.isin(frames.can_id, AI_IDS)))
    sent: Mask = np.ones(len(frames), np.bool_)
    left_out = []
    for what, mask in not_sent:
        if count := int((sent & mask).sum()):
            left_out.append(f"{count} {what}")
        sent &= ~mask
    frames = frames.only(sent)
    return frames.only(np.argsort(frames.t_ns, kind="stable")), ", ".join(left_out)


class Player:
    """Sends frames when they are due by a clock: each counted from the beginning, so that nothing adds up."""

    def __init__(
        self,
        frames: Frames,
        send: Callable[[Frame], bool],
        clock_ns: Callable[[], int],
        sleep_s: Callable[[float], None],
        *,
        rate: float = 1.0,
        laps: int | None = 1,
    ) -> None:
        """`frames` in order of time. laps: None is for ever. `send` returns False for a full transmit queue."""
        self.sent = 0
        self.laps = 0
        self.refused = 0  # the transmit queue stayed full for too long
        self.late_max_ns = 0  # the latest that a frame left after it was due
        self._frames = frames
        self._send = send
        self._clock_ns = clock_ns
        self._sleep_s = sleep_s
        self._rate = rate
        self._laps = laps

    def play(self) -> Iterator[None]:
        """Sends one frame after the other; a caller that stops asking stops it."""
        frames = self._frames
        if not len(frames):
            return
        begin_ns = int(frames.t_ns[0])
        lap_ns = int(frames.t_ns[-1]) - begin_ns + LAP_GAP_NS
        ready = [
            (t_ns - begin_ns, Frame(can_id, frames.payload(row), 0, bool(flags & EXTENDED), bool(flags & REMOTE)))
            for row, (t_ns, can_id, flags) in enumerate(
                zip(frames.t_ns.tolist(), frames.can_id.tolist(), frames.flags.tolist(), strict=True)
            )
        ]
        start_ns = self._clock_ns()
        while self._laps is None or self.laps < self._laps:
            lap_begin_ns = self.laps * lap_ns
            for since_ns, frame in ready:
                due_ns = start_ns + round((lap_begin_ns + since_ns) / self._rate)
                while (left_ns := due_ns - self._clock_ns()) > 0:
                    self._sleep_s(min(left_ns / 1e9, _LONGEST_SLEEP_S))
                self._one(frame, due_ns)
                yield
            self.laps += 1

    def _one(self, frame: Frame, due_ns: int) -> None:
        give_up_ns = self._clock_ns() + GIVE_UP_NS
        while not self._send(frame):
            if self._clock_ns() >= give_up_ns:
                self.refused += 1
                return
            self._sleep_s(RETRY_NS / 1e9)
        self.sent += 1
        self.late_max_ns = max(self.late_max_ns, self._clock_ns() - due_ns)
