"""One turn of the loop without a clock or a thread: frames in, five frames out at the right instants.

The real-time loop and the lockstep simulation drive this same object, so what is rehearsed is what runs.
"""

from __future__ import annotations

from collections.abc import Callable

from fsai_vcu.core.bridge import Bridge
from fsai_vcu.interface.codec import Codec
from fsai_vcu.interface.frames import Frame
from fsai_vcu.runtime.pacing import Pacing

_STATUS_ID = 0x520  # VCU2AI_Status, which carries the handshake


class Engine:
    """Paces a Bridge: answers each 0x520 with the five frames, and keeps its own clock when there is none."""

    def __init__(self, bridge: Bridge, codec: Codec, send: Callable[[Frame], bool], now_ns: int) -> None:
        """`send` returns False when the frame was dropped (a full transmit queue)."""
        self._bridge = bridge
        self._codec = codec
        self._send = send
        self._pacing = Pacing(now_ns)
        self.cycles = 0
        self.incomplete_cycles = 0

    def on_frame(self, frame: Frame) -> None:
        """A frame of somebody else's, at `frame.t_ns`."""
        self._bridge.on_frame(frame)
        if frame.can_id == _STATUS_ID and not frame.error:
            self._pacing.on_status(frame.t_ns)

    def due_ns(self) -> int:
        """When `poll` next has something to do, as things stand."""
        return self._pacing.due_ns()

    def poll(self, now_ns: int) -> bool:
        """Send what is due at `now_ns`. True if a cycle was due, sent whole or not."""
        if now_ns < self._pacing.due_ns():
            return False
        command = self._bridge.cycle(now_ns)
        if command is not None:
            complete = True
            for frame in self._codec.encode_command(command):
                if not self._send(frame):
                    complete = False
                    break  # the rest of a broken cycle would be a mixture of two commands
            self._bridge.on_sent(complete, now_ns)
            self.cycles += 1
            self.incomplete_cycles += not complete
        self._pacing.on_sent(now_ns)
        return True
