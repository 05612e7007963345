"""One turn of the loop without a clock or a thread: frames in, five frames out at the right instants.

The real-time loop and the lockstep simulation drive this same object, so what is rehearsed is what runs.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from fsai_vcu.core.bridge import Bridge
from fsai_vcu.interface.codec import Codec
from fsai_vcu.interface.frames import Frame
from fsai_vcu.interface.reserved import STATUS_ID
from fsai_vcu.runtime.pacing import Pacing

DEADLINE_MISS_NS = 50_000_000  # safety: a deadline missed by 50 ms is a fault of the loop


class Engine:
    """Paces a Bridge: answers each 0x520 with the five frames, and keeps its own clock when there is none."""

    def __init__(
        self,
        bridge: Bridge,
        codec: Codec,
        send: Callable[[Frame], bool],
        now_ns: int,
        clock: Callable[[], int] | None = None,
    ) -> None:
        """`send` returns False when the frame was dropped (a full transmit queue).

        `clock` tells when a frame really left; without one it leaves at the instant of the poll.
        """
        self._clock = clock
        self._bridge = bridge
        self._codec = codec
        self._send = send
        self._pacing = Pacing(now_ns)
        self.cycles = 0
        self.incomplete_cycles = 0
        self._whole_ns: int | None = None  # the last cycle that was sent whole, or the first that was tried

    def on_frames(self, frames: Sequence[Frame], now_ns: int) -> None:
        """Everything that waited on the bus at `now_ns`, oldest first: all of it is received before the next answer.

        `t_ns` of each is when the kernel received it: what has waited is as old as it is, and a backlog is named.
        """
        receive = self._bridge.on_frame
        for frame in frames:
            receive(frame)
            if frame.can_id == STATUS_ID and not (frame.error or frame.extended or frame.remote):
                self._pacing.on_status(frame.t_ns)
        if frames:
            self._bridge.backlog(now_ns - frames[0].t_ns, now_ns)

    def on_frame(self, frame: Frame) -> None:
        """A frame of somebody else's, received at `frame.t_ns`."""
        self.on_frames((frame,), frame.t_ns)

    def due_ns(self) -> int:
        """When `poll` next has something to do, as things stand."""
        return self._pacing.due_ns()

    def unsent_ns(self, now_ns: int) -> int:
        """For how long no cycle has been sent whole, though each was tried; 0 if the last one was."""
        return 0 if self._whole_ns is None else now_ns - self._whole_ns

    def poll(self, now_ns: int) -> bool:
        """Send what is due at `now_ns`. True if a cycle was due, sent whole or not."""
        if now_ns < self._pacing.due_ns():
            return False
        command = self._bridge.cycle(now_ns)
        left_ns = now_ns
        if command is None:
            self._whole_ns = None
        else:
            status, *others = self._codec.encode_command(command, now_ns)
            complete = self._send(status)
            if self._clock is not None:
                # The next cycle keeps its distance from the frame, not from the wish to send it.
                left_ns = self._clock()
            # The rest of a broken cycle would be a mixture of two commands.
            complete = complete and all(self._send(frame) for frame in others)
            self._bridge.on_sent(complete, now_ns)
            self.cycles += 1
            self.incomplete_cycles += not complete
            if complete or self._whole_ns is None:
                self._whole_ns = now_ns
        self._pacing.on_sent(left_ns)
        return True
