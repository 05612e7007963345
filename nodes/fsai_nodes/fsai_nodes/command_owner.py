"""Owner of a run's vehicle commands: two controllers must not be obeyed in turn. Pure.

A run belongs to the publisher that confirmed its reset, or, where no publisher of commands has, to the first to speak.
It is free again once its owner has sent nothing for so long that the command counts as lost: in AS_DRIVING the car has
been stopped by then, and elsewhere a controller that was started again takes its place.
"""

from __future__ import annotations

from collections.abc import Callable

from fsai_nodes.middleware import process_of

_MOST_CONFIRMED = 10


class CommandOwner:
    """Fed with confirmations and commands of one run after another, each with its publisher's GID."""

    def __init__(self, lost_ns: int) -> None:
        """lost_ns: after so long without a command of the owner the run is free."""
        self._lost_ns = lost_ns
        self._run_id: int | None = None
        self._confirmed: list[bytes] = []  # by which processes, in order
        self._spoke_ns = 0
        self.gid: bytes | None = None  # the owner's

    def _of_run(self, run_id: int) -> None:
        if run_id != self._run_id:
            self._run_id, self._confirmed, self.gid = run_id, [], None

    def confirmed(self, run_id: int, gid: bytes) -> None:
        """A controller has confirmed its reset for the run."""
        self._of_run(run_id)
        if process_of(gid) not in self._confirmed and len(self._confirmed) < _MOST_CONFIRMED:
            self._confirmed.append(process_of(gid))

    def takes(self, run_id: int, gid: bytes, now_ns: int, present: Callable[[], frozenset[bytes]]) -> bool:
        """Return true where a command of the run counts. present: the GIDs of all that publish commands now."""
        self._of_run(run_id)
        if self.gid is None or (gid != self.gid and now_ns - self._spoke_ns >= self._lost_ns):
            if self._confirmed and process_of(gid) not in self._confirmed:
                there = {process_of(each): each for each in present()}
                better = [there[each] for each in self._confirmed if each in there]
                if better:
                    self.gid, self._spoke_ns = better[0], now_ns
                    return False
            self.gid = gid
        if gid != self.gid:
            return False
        self._spoke_ns = now_ns
        return True
